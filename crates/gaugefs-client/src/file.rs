// SPDX-License-Identifier: MIT

//! A file of a mounted gauge's folder, and why a request to it failed.
//!
//! The daemon has not heard of a failed open. `gauge/last_error` is quoted only if it is about this request.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use jiff::Timestamp;
use nix::errno::Errno;

use crate::error::{Error, Result};
use crate::place::{EVERY, not_a_gauge, with_path};

/// Limit for a file in a gauge's folder, whatever made that folder.
pub(crate) const LONGEST: u64 = 16 << 20;

/// The file that changes keys. A mount's group may not write to it.
const KEYS: &str = "gauge/keys";

/// An open file of a gauge's folder, for writing.
#[derive(Debug)]
pub struct GaugeFile {
    gauge: PathBuf,
    file: File,
    opened: Timestamp,
}

impl GaugeFile {
    pub(crate) fn to_write(gauge: &Path, name: &str) -> Result<Self> {
        Self::open(gauge, name, true)
    }

    fn to_read(gauge: &Path, name: &str) -> Result<Self> {
        Self::open(gauge, name, false)
    }

    fn open(gauge: &Path, name: &str, write: bool) -> Result<Self> {
        let (path, opened) = (gauge.join(name), Timestamp::now());
        match regular::open_linked(File::options().read(!write).write(write), &path) {
            Ok(file) => Ok(Self { gauge: gauge.into(), file, opened }),
            Err(error) => {
                let hint = match error.raw_os_error().map(Errno::from_raw) {
                    Some(Errno::EACCES | Errno::EPERM) if name == KEYS => "; only the mount's owner may",
                    Some(Errno::EACCES | Errno::EPERM) => "; only the mount's owner and group may",
                    Some(Errno::EROFS) => "; it is mounted read-only",
                    _ if is_dead(&error) => return Err(not_a_gauge(gauge)),
                    _ => "",
                };
                Err(Error::unopened(gauge, name, hint, error))
            }
        }
    }

    /// Writes a request: one write(2) is one request. Returns how many bytes were taken.
    pub fn send(&mut self, request: &[u8]) -> Result<usize> {
        self.file.write(request).map_err(|error| self.refused(error))
    }

    fn text(&self) -> Result<String> {
        regular::read_from(&self.file, LONGEST).and_then(regular::text).map_err(|error| self.refused(error))
    }

    fn refused(&self, error: io::Error) -> Error {
        if is_dead(&error) {
            return not_a_gauge(&self.gauge);
        }
        let read = |name: &str| content(&self.gauge.join(name)).unwrap_or_default();
        let told = read(EVERY);
        let time = told.split_once(": ").and_then(|(time, _)| time.parse::<Timestamp>().ok());
        // File times have whole seconds. What is owed is never too old.
        let is_new = time.is_some_and(|time| time.as_second() >= self.opened.as_second());
        let is_owed = || is_set(&read(OWED));
        match told.trim() {
            told if !told.is_empty() && (is_new || is_owed()) => {
                let facts = read(FACTS);
                // Another failure may have come in between.
                let facts = if read(EVERY).trim() == told { facts } else { String::new() };
                Error::told(&self.gauge, with_path(told, &self.gauge), facts, error)
            }
            _ => Error::failed(&self.gauge, error),
        }
    }
}

/// The failure in `gauge/last_error` for programs.
const FACTS: &str = "gauge/last_error_facts";

/// Contains 1 while a seal is owed, or a write that is neither done nor undone.
pub(crate) const OWED: &str = "gauge/owed";

pub(crate) fn is_set(flag: &str) -> bool {
    flag.trim() == "1"
}

pub(crate) fn is_dead(error: &io::Error) -> bool {
    [Errno::ENOTCONN, Errno::ECONNABORTED].iter().any(|dead| error.raw_os_error() == Some(*dead as i32))
}

pub(crate) fn send(gauge: &Path, name: &str, request: &[u8]) -> Result<()> {
    GaugeFile::to_write(gauge, name)?.send(request).map(drop)
}

pub(crate) fn text(gauge: &Path, name: &str) -> Result<String> {
    GaugeFile::to_read(gauge, name)?.text()
}

/// Plain text of a file, for callers that report no error.
pub(crate) fn content(path: &Path) -> io::Result<String> {
    regular::read_text(path, LONGEST)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use nix::sys::stat::Mode;
    use nix::unistd::mkfifo;

    use super::*;

    #[test]
    fn regression_an_old_failure_is_not_told_as_the_cause() {
        let gauge = std::env::temp_dir().join(format!("gaugefs-told.{}", std::process::id()));
        let file = |name: &str, text: &str| fs::write(gauge.join("gauge").join(name), text).expect("a file");
        fs::create_dir_all(gauge.join("gauge")).expect("a folder");
        symlink("/proc/self/oom_score_adj", gauge.join("gauge/settle"))
            .expect("a file that refuses what is written");
        let told = |name: &str| {
            let failure = send(&gauge, name, b"undo").expect_err("refused");
            (failure.errno(), failure.doing("cannot be settled").to_string())
        };
        let name = gauge.display();
        let alone = (Some(Errno::EINVAL as i32), format!("{name}: cannot be settled: Invalid argument"));
        assert_eq!(told("gauge/settle"), alone);
        let now = Timestamp::now();
        let before = now - jiff::SignedDuration::from_secs(2);
        file("last_error", &format!("{before:.0}: of somebody else\n"));
        assert_eq!(told("gauge/settle"), alone);
        let missing = (
            Some(Errno::ENOENT as i32),
            format!("{name}: cannot be settled: gauge/none: No such file or directory"),
        );
        assert_eq!(told("gauge/none"), missing);
        // What is owed does not become old.
        file("owed", "1\n");
        assert!(told("gauge/settle").1.ends_with("Z: of somebody else"));
        assert_eq!(told("gauge/none"), missing);
        file("owed", "0\n");
        file("last_error", &format!("{:.0}: of this request\n", now + jiff::SignedDuration::from_secs(5)));
        assert!(told("gauge/settle").1.ends_with("Z: of this request"));
        fs::remove_dir_all(&gauge).expect("a folder");
    }

    #[test]
    fn regression_no_file_of_a_folder_keeps_its_reader() {
        let gauge = std::env::temp_dir().join(format!("gaugefs-endless.{}", std::process::id()));
        fs::create_dir_all(&gauge).expect("a folder");
        mkfifo(&gauge.join("pipe"), Mode::S_IRWXU).expect("a FIFO");
        symlink("/dev/zero", gauge.join("zeroes")).expect("a file without an end");
        let long = fs::File::create(gauge.join("long")).expect("a file");
        long.set_len(LONGEST + 1).expect("a file system with holes");
        for (name, why) in
            [("pipe", "not a regular file"), ("zeroes", "not a regular file"), ("long", "16 MiB")]
        {
            let failure = text(&gauge, name).expect_err("refused").doing("cannot be read").to_string();
            assert!(failure.contains(why), "{name}: {failure}");
            assert!(content(&gauge.join(name)).expect_err("refused").to_string().contains(why), "{name}");
        }
        for name in ["pipe", "zeroes"] {
            let failure = send(&gauge, name, b"1").expect_err("refused").doing("cannot be asked").to_string();
            assert!(failure.contains("not a regular file"), "{name}: {failure}");
        }
        fs::remove_dir_all(&gauge).expect("a folder");
    }
}
