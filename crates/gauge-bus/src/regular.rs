// SPDX-License-Identifier: MIT

//! Files of the host that gaugefs keeps, writes or reads. Where another user can create files, such as in `/tmp`, a name
//! may be a symbolic link, or a FIFO, whose open waits: gaugefs keeps and writes no such files. It reads only regular
//! files of a sensible length, also inside a mount. `clippy.toml` allows no other way to read a whole file.

use std::fs::{self, File, Metadata, OpenOptions, Permissions};
use std::io::{self, BufRead, ErrorKind, Read, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use rustix::fs::{
    AtFlags, CWD, FileType, OFlags, RenameFlags, StatxFlags, fcntl_setfl, major, minor, renameat_with,
    statvfs, statx,
};
use rustix::io::Errno;
use rustix::process::geteuid;

/// Largest size of a file that the system keeps: in `/proc`, `/sys`, and the tables of `/etc`.
pub const SYSTEM: u64 = 16 << 20;
/// Most files are smaller.
const SMALL: u64 = 4096;

/// Opens a regular file, without waiting. A symbolic link as the last component is not followed.
pub fn open(options: &OpenOptions, path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = options.clone().custom_flags(flags.bits() as i32).open(path).map_err(|error| {
        match Errno::from_io_error(&error) {
            Some(Errno::LOOP) => link(),
            // A FIFO without a reader, or a socket.
            Some(Errno::NXIO) => irregular(),
            _ => error,
        }
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(irregular()) }
}

/// Reads a regular file of at most `limit` bytes, behind links, or a pipe that is inherited, as `<(command)`.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_file(follow(File::options().read(true), path, is_inherited(path))?, limit)
}

/// Whether a path stands for what this process has inherited open.
pub fn is_inherited(path: &Path) -> bool {
    ["/dev/fd", "/proc/self/fd", "/dev/stdin"].iter().any(|place| path.starts_with(place))
}

/// Opens an existing regular file to read or write, as [`read`] does: symbolic links are followed.
pub fn open_linked(options: &OpenOptions, path: &Path) -> io::Result<File> {
    follow(options, path, false)
}

fn follow(options: &OpenOptions, path: &Path, pipe: bool) -> io::Result<File> {
    let check = |mode: u32| match FileType::from_raw_mode(mode) {
        FileType::RegularFile => Ok(()),
        FileType::Directory => Err(io::Error::from(ErrorKind::IsADirectory)),
        FileType::Fifo if pipe => Ok(()),
        _ => Err(irregular()),
    };
    check(fs::metadata(path)?.mode())?;
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = options.clone().custom_flags(flags.bits() as i32).open(path)?;
    // What kind of file it is needs no question to a file system that would answer how long it is.
    let status = statx(&file, c"", AtFlags::EMPTY_PATH | AtFlags::STATX_DONT_SYNC, StatxFlags::TYPE)?;
    check(status.stx_mode.into())?;
    fcntl_setfl(&file, OFlags::empty())?;
    Ok(file)
}

/// Reads an open file of at most `limit` bytes.
pub fn read_file(file: File, limit: u64) -> io::Result<Vec<u8>> {
    if file.metadata()?.len() > limit { Err(too_long(limit)) } else { read_from(file, limit) }
}

/// Reads a text as [`read`] does.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    text(read(path, limit)?)
}

/// Reads a source to its end, which must come within `limit` bytes.
#[expect(clippy::disallowed_methods, reason = "here is the limit")]
pub fn read_from(from: impl Read, limit: u64) -> io::Result<Vec<u8>> {
    // Without room the first calls of many would read 32 bytes each.
    let mut bytes = Vec::with_capacity(limit.min(SMALL) as usize);
    from.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_long(limit)) } else { Ok(bytes) }
}

/// The lines of a source that may have no end, of at most `limit` bytes each; more, or no text, is an error.
pub fn lines(mut from: impl BufRead, limit: u64) -> impl Iterator<Item = io::Result<String>> {
    std::iter::from_fn(move || {
        let mut line = Vec::new();
        #[expect(clippy::disallowed_methods, reason = "here is the limit")]
        let read = from.by_ref().take(limit + 1).read_until(b'\n', &mut line);
        match read {
            Ok(0) => return None,
            Ok(_) => {}
            Err(error) => return Some(Err(error)),
        }
        let end = line.strip_suffix(b"\n").map(|line| line.strip_suffix(b"\r").unwrap_or(line).len());
        if end.is_none() && line.len() as u64 > limit {
            return Some(Err(too_long(limit)));
        }
        line.truncate(end.unwrap_or(line.len()));
        Some(text(line))
    })
}

fn too_long(limit: u64) -> io::Error {
    let most = if limit < 1 << 20 { format!("{} KiB", limit >> 10) } else { format!("{} MiB", limit >> 20) };
    io::Error::new(ErrorKind::FileTooLarge, format!("it is longer than {most}; is it the right one?"))
}

/// Converts bytes to text. Other bytes are an error.
pub fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|_| io::Error::new(ErrorKind::InvalidData, "it is not a text in UTF-8"))
}

/// How to treat an existing file, and who may read the new one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replace {
    /// It is replaced. The new one has its mode and, as far as this process may give that, its owner and group.
    Kept,
    /// It is replaced. Only its owner may read the new one.
    Private,
    /// It remains, and the call fails.
    Never,
}

/// Writes a file as a whole: it has the old content or the new one, whenever this process or the machine ends, and the
/// new one is on disk when the call returns. Its folder must be writable.
///
/// A symbolic link is refused. `/dev/null`, a terminal or a pipe is written to; other devices may be a disk or a bus.
pub fn replace(path: &Path, bytes: &[u8], how: Replace) -> io::Result<()> {
    let old = match target(path)? {
        Target::Stream(mut stream) => return stream.write_all(bytes),
        Target::File(_) if how == Replace::Never => return Err(ErrorKind::AlreadyExists.into()),
        Target::File(status) => Some(status),
        Target::New => None,
    };
    let (mut file, temporary) = temporary(path, how == Replace::Private || old.is_some())?;
    let written = file
        .write_all(bytes)
        .and_then(|()| old.as_ref().filter(|_| how == Replace::Kept).map_or(Ok(()), |old| like(&file, old)))
        .and_then(|()| file.sync_all())
        .and_then(|()| match how {
            Replace::Never => rename_new(&temporary, path),
            Replace::Kept | Replace::Private => fs::rename(&temporary, path),
        });
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
        return written;
    }
    // A folder that may not be listed cannot be opened, and so not synced.
    match File::open(folder(path)) {
        Err(error) if error.kind() == ErrorKind::PermissionDenied => Ok(()),
        folder => folder?.sync_all(),
    }
}

/// Opens a file to add to it, created if it is missing. Targets that keep no text are as for [`replace`].
pub fn append(path: &Path) -> io::Result<File> {
    match target(path)? {
        Target::Stream(stream) => Ok(stream),
        Target::File(_) | Target::New => open(File::options().read(true).append(true).create(true), path),
    }
}

/// Whether [`replace`] would be allowed, as far as that can be seen without a change.
pub fn check_replace(path: &Path, how: Replace) -> io::Result<()> {
    match target(path)? {
        Target::Stream(_) => return Ok(()),
        Target::File(_) if how == Replace::Never => return Err(ErrorKind::AlreadyExists.into()),
        Target::File(_) | Target::New => {}
    }
    may_create(path)?;
    // The last blocks of some file systems are for root.
    let room = statvfs(folder(path))?;
    let left = if geteuid().is_root() { room.f_bfree } else { room.f_bavail };
    if room.f_blocks > 0 && left == 0 { Err(Errno::NOSPC.into()) } else { Ok(()) }
}

/// Whether [`open`] with these options, which create a file that is not there, would be allowed.
pub fn check_open(options: &OpenOptions, path: &Path) -> io::Result<()> {
    match path.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => may_create(path),
        Err(error) => Err(error),
        Ok(_) => open(options.clone().create(false).create_new(false).truncate(false), path).map(drop),
    }
}

fn may_create(path: &Path) -> io::Result<()> {
    use rustix::fs::{Access, AtFlags, accessat};
    if path.file_name().is_none() {
        return Err(ErrorKind::IsADirectory.into());
    }
    let folder = folder(path);
    if !fs::metadata(folder)?.is_dir() {
        return Err(ErrorKind::NotADirectory.into());
    }
    Ok(accessat(CWD, folder, Access::WRITE_OK | Access::EXEC_OK, AtFlags::EACCESS)?)
}

enum Target {
    New,
    File(Metadata),
    /// A target that takes text and keeps none.
    Stream(File),
}

fn target(path: &Path) -> io::Result<Target> {
    let status = match path.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Target::New),
        status => status?,
    };
    if status.is_file() {
        // To rename another file over it only needs the folder's permission.
        open(File::options().write(true), path)?;
        return Ok(Target::File(status));
    }
    // /dev/stderr and a shell's >(command) are links to what this process has inherited.
    let whole = if status.is_symlink() { fs::metadata(path).map_err(|_| link())? } else { status.clone() };
    let (kind, device) = (whole.file_type(), (major(whole.rdev()), minor(whole.rdev())));
    let takes_text = match device {
        _ if kind.is_fifo() => true,
        // null, zero and full; consoles and terminals.
        (1, 3 | 5 | 7) | (4 | 5 | 136..=143, _) => kind.is_char_device(),
        _ => false,
    };
    match (takes_text, status.is_symlink(), kind.is_dir()) {
        (true, ..) => {}
        (false, true, _) => return Err(link()),
        (false, false, true) => return Err(ErrorKind::IsADirectory.into()),
        (false, false, false) => return Err(irregular()),
    }
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let opened = File::options().write(true).custom_flags(flags.bits() as i32).open(path);
    let file = opened.map_err(|error| match Errno::from_io_error(&error) {
        Some(Errno::NXIO) => io::Error::new(ErrorKind::InvalidInput, "it is a FIFO that nobody reads"),
        _ => error,
    })?;
    fcntl_setfl(&file, OFlags::empty())?;
    Ok(Target::Stream(file))
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A new file beside that path. Its name does not grow with the path's, which may be as long as a name can be.
fn temporary(path: &Path, private: bool) -> io::Result<(File, PathBuf)> {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    if path.file_name().is_none() {
        return Err(ErrorKind::IsADirectory.into());
    }
    let mut options = File::options();
    options.write(true).create_new(true).mode(if private { 0o600 } else { 0o666 });
    loop {
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = folder(path).join(format!(".gaugefs-{}-{count}.tmp", std::process::id()));
        match open(&options, &name) {
            // Left by an earlier process of that number.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            file => return Ok((file?, name)),
        }
    }
}

/// Gives a file the mode of another and, as far as this process may, its owner and group.
fn like(file: &File, old: &Metadata) -> io::Result<()> {
    let new = file.metadata()?;
    let mut mode = old.mode() & 0o777;
    if (new.uid(), new.gid()) != (old.uid(), old.gid())
        && fchown(file, Some(old.uid()), Some(old.gid())).is_err()
        && fchown(file, None, Some(old.gid())).is_err()
    {
        // What its group was allowed is not for another group.
        mode &= !0o070;
    }
    file.set_permissions(Permissions::from_mode(mode))
}

fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // A file system without that.
        Err(Errno::INVAL | Errno::NOSYS) if to.symlink_metadata().is_err() => fs::rename(from, to),
        Err(Errno::INVAL | Errno::NOSYS) => Err(ErrorKind::AlreadyExists.into()),
        outcome => Ok(outcome?),
    }
}

fn link() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "it is a symbolic link; name the file itself")
}

fn irregular() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "it is not a regular file")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_of_a_test(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("gauge-bus-regular-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        folder
    }

    fn make_fifo(path: &Path) {
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(CWD, path, rustix::fs::FileType::Fifo, mode, 0).expect("a FIFO");
    }

    #[test]
    fn only_regular_files_are_opened() {
        let folder = folder_of_a_test("open");
        let [file, link, fifo] = ["file", "link", "fifo"].map(|name| folder.join(name));
        let append = || File::options().append(true).create(true).clone();
        open(&append(), &file).expect("it is created").write_all(b"one\n").expect("written");
        open(&append(), &file).expect("it exists").write_all(b"two\n").expect("written");
        let mut text = String::new();
        open(File::options().read(true), &file).expect("opens").read_to_string(&mut text).expect("text");
        assert_eq!(text, "one\ntwo\n");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        make_fifo(&fifo);
        for (path, why) in [(&link, "a symbolic link"), (&fifo, "not a regular file")] {
            for options in [append(), File::options().read(true).clone()] {
                let error = open(&options, path).expect_err("not a regular file");
                assert!(error.to_string().contains(why), "{}: {error}", path.display());
            }
        }
        open(&append(), Path::new("/dev/null")).expect_err("not a regular file");
        fs::remove_dir_all(&folder).expect("it was made here");
    }

    #[test]
    fn a_file_is_replaced_as_a_whole_and_keeps_its_mode() {
        let folder = folder_of_a_test("replace");
        let [file, link, fifo] = ["file", "link", "fifo"].map(|name| folder.join(name));
        let content = |path: &Path| fs::read_to_string(path).expect("its text");
        replace(&file, b"one", Replace::Never).expect("it is new");
        assert_eq!(
            replace(&file, b"two", Replace::Never).expect_err("it is there").kind(),
            ErrorKind::AlreadyExists
        );
        fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("its mode");
        replace(&file, b"two", Replace::Kept).expect("it is replaced");
        let mode = || fs::metadata(&file).expect("it is there").mode() & 0o777;
        assert_eq!((content(&file).as_str(), mode()), ("two", 0o640));
        replace(&file, b"three", Replace::Private).expect("it is replaced");
        assert_eq!((content(&file).as_str(), mode()), ("three", 0o600));

        std::os::unix::fs::symlink(&file, &link).expect("a link");
        make_fifo(&fifo);
        for (path, why) in [(&link, "a symbolic link"), (&fifo, "nobody reads"), (&folder, "directory")] {
            for outcome in [replace(path, b"four", Replace::Kept), check_replace(path, Replace::Kept)] {
                let error = outcome.expect_err("not a regular file").to_string();
                assert!(error.contains(why), "{}: {error}", path.display());
            }
        }
        check_replace(&file, Replace::Kept).expect("it may be replaced");
        check_replace(&folder.join("new"), Replace::Kept).expect("it may be made");
        check_replace(&folder.join("none/new"), Replace::Kept).expect_err("its folder is missing");
        replace(Path::new("/dev/null"), b"four", Replace::Kept).expect("it takes all");
        replace(Path::new("/dev/full"), b"four", Replace::Kept).expect_err("it takes nothing");
        assert!(fs::metadata("/dev/null").expect("it is there").file_type().is_char_device());
        assert_eq!(content(&file), "three");
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 3, "nothing else is left");
        fs::remove_dir_all(&folder).expect("it was made here");
    }

    #[test]
    fn a_line_is_read_up_to_a_limit() {
        let all = |text: &[u8]| lines(text, 4).collect::<io::Result<Vec<_>>>();
        assert_eq!(all(b"one\n\r\nfour\r\nfour").ok(), None, "with its end it is longer");
        assert_eq!(all(b"one\n\r\nfour\nlast").expect("lines"), ["one", "", "four", "last"]);
        assert_eq!(all(b"").expect("lines"), [""; 0]);
        assert!(all(b"fives").is_err() && all(b"ok\n\xff\n").is_err());
        let endless = io::BufReader::new(File::open("/dev/zero").expect("a device"));
        assert!(lines(endless, 1 << 16).next().expect("a line").is_err());
    }

    #[test]
    fn a_file_is_read_up_to_a_limit() {
        let folder = folder_of_a_test("read");
        let [file, link, fifo] = ["file", "link", "fifo"].map(|name| folder.join(name));
        fs::write(&file, [b'x'; 2048]).expect("a file");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        make_fifo(&fifo);
        assert_eq!(read(&link, 2048).expect("it fits").len(), 2048);
        assert!(read(&file, 2047).expect_err("too long").to_string().contains("longer than 1 KiB"));
        for path in [&fifo, Path::new("/dev/zero"), Path::new("/dev/null")] {
            let error = read(path, 2048).expect_err("no file").to_string();
            assert!(error.contains("not a regular file"), "{}: {error}", path.display());
        }
        assert_eq!(read(&folder, 2048).expect_err("a folder").kind(), ErrorKind::IsADirectory);
        // A pipe that this process has, as a shell's <(command) is.
        let (from, mut to) = std::io::pipe().expect("a pipe");
        to.write_all(b"text").expect("it takes a few bytes");
        drop(to);
        let number = std::os::fd::AsRawFd::as_raw_fd(&from);
        assert_eq!(read(Path::new(&format!("/dev/fd/{number}")), 2048).expect("its bytes"), b"text");
        // What is there may be written through a link, but nothing else is opened.
        open_linked(File::options().write(true), &link).expect("opens").write_all(b"new").expect("written");
        assert!(read(&file, 2048).expect("its bytes").starts_with(b"newx"));
        for path in [&fifo, Path::new("/dev/null"), Path::new("/dev/zero")] {
            for options in [File::options().write(true), File::options().read(true)] {
                let error = open_linked(options, path).expect_err("not a regular file").to_string();
                assert!(error.contains("not a regular file"), "{}: {error}", path.display());
            }
        }
        assert!(read(Path::new("/proc/self/mountinfo"), SYSTEM).is_ok_and(|table| !table.is_empty()));
        fs::remove_dir_all(&folder).expect("it was made here");
    }
}
