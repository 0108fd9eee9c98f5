// SPDX-License-Identifier: MIT

//! Looks at a path that may be in the mount of a daemon that does not answer.
//!
//! A call into a FUSE mount waits for its daemon, and if the daemon has already taken the request, not even
//! SIGKILL ends the process that waits. So a child process makes the call, and is left behind if it does not
//! return in time.

use std::ffi::{CStr, OsStr};
use std::fs;
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf, absolute};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::statvfs::statvfs;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::output::print_file;
use gaugefs_client::{Gauge, mounts};

/// Time limit for a look. A look needs no gauge, so a daemon that works answers at once; a slow machine that is
/// busy needs some seconds to start the process.
const LIMIT: Duration = Duration::from_secs(5);
/// Longest output of a child, even with very many gauges.
const LONGEST: usize = 4 << 20;

/// The name of a process that looks. It ends by itself, so it is none that keeps a mount from being removed.
pub(super) const NAME: &CStr = c"gaugefs-look";

/// The findings of a look within its time limit.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// The full path.
    pub(crate) path: Option<PathBuf>,
    /// Whether the daemon of a gaugefs that is mounted there is gone. A path where no gaugefs is mounted counts
    /// as answering.
    pub(crate) dead: Option<bool>,
    /// The time limit has passed.
    pub(crate) late: bool,
    /// The gauges there, if they were asked for.
    pub(crate) gauges: Vec<Listed>,
}

/// A mounted gauge at its last poll.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Listed {
    /// Its folder; characters that are no text are replaced.
    pub(crate) path: String,
    pub(crate) part: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) capacity: Option<i64>,
    pub(crate) status: Option<String>,
    pub(crate) age_ms: Option<u64>,
}

impl Listed {
    /// Reads what causes no transfer.
    fn read(gauge: &Gauge) -> Self {
        let text = |name: &str| Some(gauge.text(name).ok()?.trim().to_string());
        let (part, serial) = gauge.pack();
        let capacity = text("capacity").and_then(|text| text.parse().ok());
        let (status, age_ms) = (text("status"), text("gauge/age_ms").and_then(|text| text.parse().ok()));
        Self { part, serial, capacity, status, age_ms, path: gauge.folder().to_string_lossy().into_owned() }
    }
}

/// A look that has begun.
pub(crate) struct Look(Child, Instant);

impl Look {
    /// Begins to look at a path.
    pub(crate) fn begin(path: &Path) -> Result<Self> {
        Self::begin_with(path, &[])
    }

    fn begin_with(path: &Path, options: &[&str]) -> Result<Self> {
        let mut command = Command::new("/proc/self/exe");
        // One that is left behind must not stand in the mount.
        let path = match absolute(path) {
            Ok(absolute) => {
                command.current_dir("/");
                absolute
            }
            Err(_) => path.to_path_buf(),
        };
        command.arg("look").args(options).arg("--").arg(&path).stdin(Stdio::null()).stdout(Stdio::piped());
        let child = command.stderr(Stdio::null()).spawn().map_err(|error| {
            Error::io(path.display().to_string(), "cannot start a process to examine it", &error)
        })?;
        Ok(Self(child, Instant::now()))
    }

    /// Waits for its end, or for its time limit.
    pub(crate) fn end(mut self) -> Found {
        let answer = self.0.stdout.take().map(|out| read(out, self.1 + LIMIT));
        let (bytes, late) = answer.unwrap_or_default();
        stop(&mut self.0, late);
        let mut words = bytes.split_inclusive(|&byte| byte == 0).filter_map(|word| word.strip_suffix(&[0]));
        let path = words.next().map(|path| PathBuf::from(OsStr::from_bytes(path)));
        let dead = words.next().map(|word| word == b"dead");
        let gauges = words.filter_map(|word| serde_json::from_slice(word).ok()).collect();
        Found { path, dead, late, gauges }
    }
}

/// The gauges that are mounted at each of these paths, or that are at it. All are looked at together, so it takes no longer
/// than one look.
pub(crate) fn gauges(paths: &[PathBuf]) -> Result<Vec<(PathBuf, Found)>> {
    let looks = paths.iter().map(|path| Look::begin_with(path, &["--gauges"])).collect::<Result<Vec<_>>>()?;
    Ok(paths.iter().cloned().zip(looks.into_iter().map(Look::end)).collect())
}

/// Begins a look at a path, and waits for its end.
pub(crate) fn at(path: &Path) -> Result<Found> {
    Ok(Look::begin(path)?.end())
}

/// In the child: prints the full path, whether its daemon is gone, and if they are asked for, the gauges there, each as
/// soon as it is known.
pub(crate) fn answer(path: &Path, gauges: bool) -> Result<()> {
    // Before anything is open in the mount. Without a name it would be taken for any user of the mount, no more.
    let _ = nix::sys::prctl::set_name(NAME);
    let tell = |word: &[u8]| print_file(&[word, &[0]].concat());
    let path = resolve(path)?;
    tell(path.as_os_str().as_bytes())?;
    // Only STATFS is never answered from the kernel's cache.
    let dead =
        mounts::is_gaugefs(&path) && matches!(statvfs(&path), Err(Errno::ENOTCONN | Errno::ECONNABORTED));
    tell(if dead { b"dead" } else { b"alive" })?;
    if gauges && !dead {
        let below = match Gauge::below(&path) {
            none if none.is_empty() => Gauge::open(&path).into_iter().collect(),
            gauges => gauges,
        };
        for gauge in below {
            tell(&serde_json::to_vec(&Listed::read(&gauge)).expect("keys are strings, so it cannot fail"))?;
        }
    }
    Ok(())
}

/// Runs a program and returns whether it succeeded and what it printed to standard error; `None` after a time
/// limit.
pub(super) fn run(command: &mut Command, limit: Duration) -> io::Result<Option<(bool, String)>> {
    let end = Instant::now() + limit;
    let command = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // A terminal that is closed sends signals to the whole group, and again while the mount is being removed.
    let mut child = command.process_group(0).spawn()?;
    let (bytes, late) = child.stderr.take().map(|err| read(err, end)).unwrap_or_default();
    if late {
        stop(&mut child, late);
        return Ok(None);
    }
    Ok(Some((child.wait()?.success(), String::from_utf8_lossy(&bytes).into_owned())))
}

/// Reads a pipe until its end, until the deadline, or until the text is too long. Returns the bytes, and whether it
/// stopped before the end.
fn read(mut pipe: impl Read + AsFd, deadline: Instant) -> (Vec<u8>, bool) {
    let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let mut polled = [PollFd::new(pipe.as_fd(), PollFlags::POLLIN)];
        let timeout = PollTimeout::try_from(left).unwrap_or(PollTimeout::MAX);
        match poll(&mut polled, timeout) {
            Ok(0) => return (bytes, true),
            Ok(_) => match pipe.read(&mut piece) {
                Ok(0) => return (bytes, false),
                Ok(_) if bytes.len() > LONGEST => return (bytes, true),
                Ok(length) => bytes.extend_from_slice(&piece[..length]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return (bytes, false),
            },
            Err(Errno::EINTR) => {}
            Err(_) => return (bytes, false),
        }
    }
}

/// Ends a child. One that does not even end by SIGKILL is left to process 1.
fn stop(child: &mut Child, late: bool) {
    if late {
        // It may have ended just now.
        let _ = child.kill();
        let _ = child.try_wait();
    } else {
        let _ = child.wait();
    }
}

/// The full path, found without access to what is mounted there. The folders above it may be in a mount that
/// does not answer, so only a child process calls this, or a process whose child has.
pub(super) fn resolve(path: &Path) -> Result<PathBuf> {
    let failed = |error| Error::io(path.display().to_string(), "cannot be examined", &error);
    let absolute = std::path::absolute(path).map_err(failed)?;
    let plain = absolute.components().collect::<PathBuf>();
    let (Some(parent), Some(name)) = (plain.parent(), plain.file_name()) else {
        // The root folder, or a path that ends in `..`.
        return fs::canonicalize(&plain).map_err(failed);
    };
    // A missing parent is created later.
    let parent = fs::canonicalize(parent).unwrap_or_else(|_| parent.to_path_buf());
    let path = parent.join(name);
    match fs::read_link(&path) {
        Ok(_) => fs::canonicalize(&path).map_err(failed),
        Err(_) => Ok(path),
    }
}
