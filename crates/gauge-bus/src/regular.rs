//! Opening files of the host that gaugefs keeps: its log, traces, journals, backups and locks.
//!
//! Where another user can create files in the same folder, such as `/tmp`, the name may already be a symbolic
//! link to some other file, or a FIFO, whose open waits for the other end. Both are refused.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;
use rustix::io::Errno;

/// Opens a regular file. The last component of the path is not followed if it is a symbolic link, and the call
/// never waits. The folders above it are trusted.
pub fn open(options: &OpenOptions, path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = options.clone().custom_flags(flags.bits() as i32).open(path).map_err(|error| {
        match Errno::from_io_error(&error) {
            Some(Errno::LOOP) => {
                io::Error::new(ErrorKind::InvalidInput, "it is a symbolic link; name the file itself")
            }
            // A FIFO without a reader, or a socket.
            Some(Errno::NXIO) => irregular(),
            _ => error,
        }
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(irregular()) }
}

fn irregular() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "it is not a regular file")
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{Read, Write};

    use super::*;

    #[test]
    fn only_regular_files_are_opened() {
        let folder = std::env::temp_dir().join(format!("gauge-bus-regular-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let [file, link, fifo] = ["file", "link", "fifo"].map(|name| folder.join(name));
        let append = || File::options().append(true).create(true).clone();
        open(&append(), &file).expect("it is created").write_all(b"one\n").expect("written");
        open(&append(), &file).expect("it exists").write_all(b"two\n").expect("written");
        let mut text = String::new();
        open(File::options().read(true), &file).expect("opens").read_to_string(&mut text).expect("text");
        assert_eq!(text, "one\ntwo\n");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, mode, 0).expect("a FIFO");
        for (path, why) in [(&link, "a symbolic link"), (&fifo, "not a regular file")] {
            for options in [append(), File::options().read(true).clone()] {
                let error = open(&options, path).expect_err("not a regular file");
                assert!(error.to_string().contains(why), "{}: {error}", path.display());
            }
        }
        open(&append(), Path::new("/dev/null")).expect_err("not a regular file");
        fs::remove_dir_all(&folder).expect("it was made here");
    }
}
