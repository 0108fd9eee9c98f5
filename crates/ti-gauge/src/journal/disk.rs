//! The calls of a file system that a journal needs, one method each, so that tests can lose what was not synced.

use std::fmt::Debug;
use std::fs::{self, DirBuilder};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, fchown};
use std::path::Path;

use gauge_bus::regular;
use rustix::fs::{FallocateFlags, fallocate};
use rustix::process::geteuid;

/// A file system.
pub trait Disk: Debug + Send + Sync {
    /// Creates a folder in one that is there.
    fn create_folder(&self, folder: &Path) -> io::Result<()>;
    /// Whether there is a file or folder of that name.
    fn exists(&self, path: &Path) -> bool;
    /// The content of a file.
    fn read(&self, path: &Path) -> io::Result<String>;
    /// Creates an empty file, or empties it, to write to.
    fn create(&self, path: &Path) -> io::Result<Box<dyn File>>;
    /// Opens a file to append to.
    fn open(&self, path: &Path) -> io::Result<Box<dyn File>>;
    /// Renames a file, in place of one that has the new name already.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Returns once the names in a folder are on disk.
    fn sync(&self, folder: &Path) -> io::Result<()>;
}

/// An open file.
pub trait File: Debug + Send {
    /// Writes at its end.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Makes sure that it can grow to a length, as far as the file system supports that.
    fn reserve(&mut self, length: u64) -> io::Result<()>;
    /// Returns once its content is on disk.
    fn sync(&mut self) -> io::Result<()>;
    /// Removes what is beyond a length. Not every disk can do that.
    fn truncate(&mut self, _: u64) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

/// Stores a file as a whole: it gets its name when its content is on disk. Reserves `room` more bytes to append.
/// On return all of it is on disk, the folders above it included.
pub(super) fn store(
    disk: &dyn Disk,
    path: &Path,
    temporary: &Path,
    text: &str,
    room: usize,
) -> io::Result<Box<dyn File>> {
    let folder = path.parent().unwrap_or(Path::new(""));
    create_folder(disk, folder)?;
    let stored = disk.create(temporary).and_then(|mut file| {
        file.append(text.as_bytes())?;
        file.reserve((text.len() + room) as u64)?;
        file.sync()?;
        disk.rename(temporary, path)?;
        Ok(file)
    });
    if stored.is_err() {
        // The rest would only take up space on a disk that may be full.
        let _ = disk.remove(temporary);
        return stored;
    }
    disk.sync(folder)?;
    stored
}

/// Creates a folder and those above it. On return they are on disk.
fn create_folder(disk: &dyn Disk, folder: &Path) -> io::Result<()> {
    let Some(above) = folder.parent().filter(|_| !disk.exists(folder)) else { return Ok(()) };
    create_folder(disk, above)?;
    match disk.create_folder(folder) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    disk.sync(above)
}

/// Stores a file as a whole on the host's disk, by way of a temporary name in the same folder. On return it is on
/// disk. Only its owner can read it; if root writes it, that is the owner of the folder.
pub fn save(path: &Path, temporary: &Path, text: &str) -> io::Result<()> {
    save_on(&Host, path, temporary, text)
}

/// The same on another disk.
pub fn save_on(disk: &dyn Disk, path: &Path, temporary: &Path, text: &str) -> io::Result<()> {
    store(disk, path, temporary, text, 0).map(drop)
}

/// The file system of the host.
#[derive(Debug)]
pub struct Host;

impl Disk for Host {
    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        DirBuilder::new().mode(0o700).create(folder)
    }

    fn exists(&self, path: &Path) -> bool {
        path.symlink_metadata().is_ok()
    }

    fn read(&self, path: &Path) -> io::Result<String> {
        let mut text = String::new();
        regular::open(fs::File::options().read(true), path)?.read_to_string(&mut text)?;
        Ok(text)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        let mut options = fs::File::options();
        options.write(true).create(true).truncate(true).mode(0o600);
        let file = regular::open(&options, path)?;
        // If the folder belongs to a service, that service must be able to settle what root leaves there.
        if geteuid().is_root()
            && let Some(folder) = path.parent()
        {
            let owner = fs::metadata(folder)?;
            fchown(&file, Some(owner.uid()), Some(owner.gid()))?;
        }
        Ok(Box::new(file))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn File>> {
        Ok(Box::new(regular::open(fs::File::options().append(true), path)?))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn sync(&self, folder: &Path) -> io::Result<()> {
        let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        fs::File::open(here)?.sync_all()
    }
}

impl File for fs::File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn reserve(&mut self, length: u64) -> io::Result<()> {
        // File systems that cannot reserve space report a full disk later, still before the first block.
        match fallocate(&*self, FallocateFlags::KEEP_SIZE, 0, length) {
            Err(error) if io::Error::from(error).kind() != ErrorKind::Unsupported => Err(error.into()),
            _ => Ok(()),
        }
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)
    }
}
