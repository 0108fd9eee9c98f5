// SPDX-License-Identifier: MIT

//! File system calls of a journal, one method each, so that tests can lose what was not synced.

use std::fmt::Debug;
use std::fs::{self, DirBuilder};
use std::io::{self, ErrorKind, Write as _};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, fchown};
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use rustix::fs::{CWD, FallocateFlags, FlockOperation, RenameFlags, fallocate, flock, renameat_with};
use rustix::io::Errno;
use rustix::process::geteuid;

use super::Trusted;

const LOCKS: u32 = 100;
/// Larger than any journal, backup or record of gaugefs.
const LONGEST: u64 = 256 << 20;

/// A file system.
pub trait Disk: Debug + Send + Sync {
    /// Creates a folder in an existing one.
    fn create_folder(&self, folder: &Path) -> io::Result<()>;
    /// Whether there is a file or folder of that name.
    fn exists(&self, path: &Path) -> bool;
    /// The content of a file.
    fn read(&self, path: &Path) -> io::Result<String>;
    /// Creates or empties a file for writing.
    fn create(&self, path: &Path) -> io::Result<Box<dyn File>>;
    /// Opens a file to append to.
    fn open(&self, path: &Path) -> io::Result<Box<dyn File>>;
    /// Renames a file, replacing an existing one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Renames a file, or fails without a change if the new name exists.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        if self.exists(to) { Err(ErrorKind::AlreadyExists.into()) } else { self.rename(from, to) }
    }
    /// The files of a folder.
    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>>;
    /// Whether a process has locked a file.
    fn is_locked(&self, _path: &Path) -> io::Result<bool> {
        Ok(false)
    }
    /// Checks that a file or folder is this account's, root's or a trusted one's, and that no other may write to it.
    fn check(&self, _path: &Path, _trusted: Trusted) -> io::Result<()> {
        Ok(())
    }
    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Returns once the folder's names are on disk.
    fn sync(&self, folder: &Path) -> io::Result<()>;
}

/// An open file.
pub trait File: Debug + Send {
    /// Writes at the end.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Reserves room for a length, if the file system can.
    fn reserve(&mut self, length: u64) -> io::Result<()>;
    /// Returns once the content is on disk.
    fn sync(&mut self) -> io::Result<()>;
    /// Removes what is beyond a length. Not every disk can do that.
    fn truncate(&mut self, _: u64) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }

    /// Locks it until it is closed. `false` if another process has locked or removed it.
    fn lock(&mut self) -> io::Result<bool> {
        Ok(true)
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum How {
    /// In place of an existing file.
    Plain,
    /// Locked, with room to append; with `is_new` only if there is no such file.
    Journal { is_new: bool, room: usize },
}

/// Stores a file as a whole, named when its content is on disk. On return all is on disk, with the folders above.
pub(super) fn store(
    disk: &dyn Disk,
    path: &Path,
    temporary: &Path,
    text: &str,
    how: How,
) -> io::Result<Box<dyn File>> {
    let folder = path.parent().unwrap_or(Path::new(""));
    create_folder(disk, folder)?;
    let stored = disk.create(temporary).and_then(|mut file| {
        file.append(text.as_bytes())?;
        if let How::Journal { room, .. } = how {
            if !file.lock()? {
                return Err(ErrorKind::WouldBlock.into());
            }
            file.reserve((text.len() + room) as u64)?;
        }
        file.sync()?;
        match how {
            How::Journal { is_new: true, .. } => disk.rename_new(temporary, path)?,
            How::Journal { .. } | How::Plain => disk.rename(temporary, path)?,
        }
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

fn create_folder(disk: &dyn Disk, folder: &Path) -> io::Result<()> {
    let Some(above) = folder.parent().filter(|_| !disk.exists(folder)) else { return Ok(()) };
    create_folder(disk, above)?;
    match disk.create_folder(folder) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    disk.sync(above)
}

/// [`save_on`] for the host's disk. Only its owner can read the file; root's files get the folder's owner.
pub fn save(path: &Path, temporary: &Path, text: &str) -> io::Result<()> {
    save_on(&Host, path, temporary, text)
}

/// Stores a file as a whole, through a temporary name in the same folder. On return it is on disk.
pub fn save_on(disk: &dyn Disk, path: &Path, temporary: &Path, text: &str) -> io::Result<()> {
    store(disk, path, temporary, text, How::Plain).map(drop)
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
        let file = regular::open(fs::File::options().read(true), path)?;
        regular::text(regular::read_file(file, LONGEST)?)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        let mut options = fs::File::options();
        options.write(true).create(true).truncate(true).mode(0o600);
        let file = regular::open(&options, path)?;
        // A service must be able to settle what root leaves in its folder.
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

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            // Not every file system can do that in one step.
            Err(Errno::INVAL | Errno::NOSYS) if self.exists(to) => Err(ErrorKind::AlreadyExists.into()),
            Err(Errno::INVAL | Errno::NOSYS) => self.rename(from, to),
            renamed => Ok(renamed?),
        }
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
    }

    fn is_locked(&self, path: &Path) -> io::Result<bool> {
        let file = regular::open(fs::File::options().read(true), path)?;
        match flock(&file, FlockOperation::NonBlockingLockShared) {
            Ok(()) => Ok(false),
            Err(Errno::WOULDBLOCK) => Ok(true),
            Err(error) => Err(error.into()),
        }
    }

    fn check(&self, path: &Path, trusted: Trusted) -> io::Result<()> {
        let status = path.symlink_metadata()?;
        let (uid, mode) = (status.uid(), status.mode());
        let wrong = |why: String| Err(io::Error::new(ErrorKind::PermissionDenied, why));
        if ![0, geteuid().as_raw()].contains(&uid) && trusted() != Some(uid) {
            return wrong(format!("it belongs to another account (uid {uid})"));
        }
        // A link has every mode, and is not opened.
        if mode & 0o022 != 0 && !status.is_symlink() {
            return wrong(format!("others may write to it (mode {:03o})", mode & 0o7777));
        }
        Ok(())
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

    fn lock(&mut self) -> io::Result<bool> {
        // Another gaugefs that looks at it holds it for a moment.
        for _ in 0..LOCKS {
            match flock(&*self, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Ok(self.metadata()?.nlink() > 0),
                Err(Errno::WOULDBLOCK) => std::thread::yield_now(),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(false)
    }
}
