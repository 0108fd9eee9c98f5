// SPDX-License-Identifier: MIT

//! Looks at paths that may be in the mount of a hanging daemon.
//!
//! A call into a FUSE mount waits for the daemon, and once the daemon has taken the request, not even SIGKILL ends the
//! waiting process. So a child process makes the call, and is left behind if it does not return in time.

use std::ffi::{CStr, OsStr};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf, absolute};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::sys::statvfs::statvfs;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::{ForkResult, Pid, chdir, dup2_stderr, dup2_stdin, dup2_stdout, fork};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use gauge_bus::regular;
use gaugefs_client::{Gauge, check, mounts};

/// Looks that must find a process in the same call: 5 s. A look needs no gauge, so a working daemon answers at once.
const LIMIT: u32 = 20;
/// Interval between looks at the process.
const STEP: Duration = Duration::from_millis(250);
/// Limit for a process that goes on but says nothing. A busy machine may need most of it to start one.
const PATIENCE: Duration = Duration::from_secs(60);
/// Longest output of a child, even with very many gauges.
const LONGEST: usize = 4 << 20;

/// Name of a process that looks. It ends by itself, so it does not keep a mount from being removed.
pub(super) const NAME: &CStr = c"gaugefs-look";

/// Findings of a look within its time limit.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// The full path.
    pub(crate) path: Option<PathBuf>,
    /// Whether the daemon of a gaugefs mounted there is gone; false without a gaugefs mount.
    pub(crate) dead: Option<bool>,
    /// The time limit has passed.
    pub(crate) late: bool,
    /// The gauges there, if requested.
    pub(crate) gauges: Vec<Seen>,
}

/// A mounted gauge, with notes for a person.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Seen {
    pub(crate) listed: Listed,
    /// A line for each.
    pub(crate) notes: Vec<String>,
    /// The notes are about what is owed.
    pub(crate) is_owed: bool,
    /// What is certainly wrong by `gauge/check`.
    pub(crate) wrong: Option<String>,
    /// What a person has to decide by it.
    pub(crate) doubtful: Option<String>,
}

impl Seen {
    fn read(gauge: &Gauge) -> Self {
        let (is_owed, error) = (gauge.is_owed(), gauge.last_error().unwrap_or_default());
        let facts = gauge.text("gauge/last_error_facts").unwrap_or_default();
        let error = if is_owed || !is_mistake(&facts) { Some(error) } else { standing(&error) };
        let notes = error.filter(|error| is_owed || !error.is_empty());
        let found = gauge.text("gauge/check").unwrap_or_default();
        let (wrong, doubtful) = (check::wrong(&found), check::doubtful(&found));
        Self { listed: Listed::read(gauge), notes: notes.into_iter().collect(), is_owed, wrong, doubtful }
    }
}

/// Whether an error is about a person's input, which says nothing of the gauge.
fn is_mistake(facts: &str) -> bool {
    let facts: serde_json::Value = serde_json::from_str(facts).unwrap_or_default();
    ["EINVAL", "ERANGE", "ENOENT", "EFBIG"].iter().any(|errno| facts["errno"] == *errno)
}

/// The lines about the gauge in `gauge/last_error`, after its last error.
fn standing(error: &str) -> Option<String> {
    error.split_once("; since ").map(|(_, since)| format!("since {since}"))
}

#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Listed {
    /// Its folder; characters that are no text are replaced.
    pub(crate) gauge: String,
    pub(crate) part: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) capacity: Option<i64>,
    pub(crate) status: Option<String>,
    pub(crate) age_ms: Option<u64>,
}

impl Listed {
    fn read(gauge: &Gauge) -> Self {
        let text = |name: &str| Some(gauge.text(name).ok()?.trim().to_string());
        let (part, serial) = gauge.pack();
        let capacity = text("capacity").and_then(|text| text.parse().ok());
        let (status, age_ms) = (text("status"), text("gauge/age_ms").and_then(|text| text.parse().ok()));
        Self { part, serial, capacity, status, age_ms, gauge: gauge.folder().to_string_lossy().into_owned() }
    }
}

/// A look in progress.
pub(super) enum Look {
    /// It was not necessary to ask anybody.
    Known(Found),
    /// A process looks.
    Asked { process: Pid, said: File },
}

impl Look {
    /// Begins to look at a path.
    pub(super) fn begin(path: &Path) -> Result<Self> {
        in_local(path).map_or_else(|| Self::ask(path, false), |found| Ok(Self::Known(found)))
    }

    /// Begins to look at a path, and at its gauges too.
    fn ask(path: &Path, gauges: bool) -> Result<Self> {
        let failed =
            |error| Error::io(path.display().to_string(), "cannot start a process to examine it", &error);
        let nowhere = File::options().read(true).write(true).open("/dev/null").map_err(failed)?;
        let (said, mut say) = io::pipe().map_err(failed)?;
        let absolute = absolute(path);
        // Another start of the program would take longer than all else of an unmount.
        // SAFETY: only this thread goes on in the child, where nothing may be used that another one held. There is none
        // but the daemon's that waits for signals, which holds nothing, and the C library keeps its heap usable.
        #[allow(unsafe_code)]
        let process = match unsafe { fork() }.map_err(|errno| failed(errno.into()))? {
            ForkResult::Parent { child } => child,
            ForkResult::Child => {
                // Not even a panic may go on with the work of the parent.
                let _ = catch_unwind(AssertUnwindSafe(|| {
                    leave(&nowhere, absolute.is_ok())?;
                    answer(absolute.as_deref().unwrap_or(path), gauges, &mut say)
                }));
                // SAFETY: it always is; it ends the process without the parent's handlers.
                #[allow(unsafe_code)]
                unsafe {
                    nix::libc::_exit(0)
                }
            }
        };
        Ok(Self::Asked { process, said: OwnedFd::from(said).into() })
    }

    /// Waits for its end or its time limit.
    pub(super) fn end(self) -> Found {
        match self {
            Self::Known(found) => found,
            Self::Asked { process, said } => {
                let (bytes, late) = read(said, process);
                stop(process, late);
                Found::read(&bytes, late)
            }
        }
    }
}

/// In the child: leaves what others wait for, as it may be left behind itself.
fn leave(nowhere: &File, folder: bool) -> io::Result<()> {
    dup2_stdin(nowhere)?;
    dup2_stdout(nowhere)?;
    dup2_stderr(nowhere)?;
    if folder {
        chdir("/")?;
    }
    Ok(())
}

impl Found {
    /// From the child's output.
    fn read(bytes: &[u8], late: bool) -> Self {
        let mut words = bytes.split_inclusive(|&byte| byte == 0).filter_map(|word| word.strip_suffix(&[0]));
        let path = words.next().map(|path| PathBuf::from(OsStr::from_bytes(path)));
        let dead = words.next().map(|word| word == b"dead");
        let gauges = words.filter_map(|word| serde_json::from_slice(word).ok()).collect();
        Self { path, dead, late, gauges }
    }
}

/// Whether a process goes on, by occasional looks at /proc.
struct Pulse {
    process: Pid,
    begun: Instant,
    /// The wait in which it was last seen, and how often it was seen there.
    seen: Option<String>,
    again: u32,
}

impl Pulse {
    fn new(process: Pid) -> Self {
        Self { process, begun: Instant::now(), seen: None, again: 0 }
    }

    /// It has said something: of very many gauges, each is told by itself.
    fn beats(&mut self) {
        self.begun = Instant::now();
    }

    /// Whether it has waited in one call for too long. Time does not count while it could run and a busy machine does
    /// not let it.
    fn is_stuck(&mut self) -> bool {
        let path = format!("/proc/{}/status", self.process);
        let now = waits(&regular::read_text(Path::new(&path), regular::SYSTEM).unwrap_or_default());
        self.again = if now.is_some() && now == self.seen { self.again + 1 } else { 0 };
        self.seen = now;
        self.again >= LIMIT || self.begun.elapsed() > PATIENCE
    }
}

/// Identifies a process's wait by its status in /proc; `None` if it can run.
fn waits(status: &str) -> Option<String> {
    let state = status.lines().find_map(|line| line.strip_prefix("State:\t"))?;
    let switches = status.lines().filter(|line| line.contains("ctxt_switches"));
    (!state.starts_with('R')).then(|| switches.collect())
}

/// The gauges mounted at these paths.
pub(crate) fn gauges(paths: &[PathBuf]) -> Result<Vec<(PathBuf, Found)>> {
    together(paths, true)
}

/// What is at each of these paths. All are looked at together, so it takes no longer than one look.
pub(super) fn together(paths: &[PathBuf], gauges: bool) -> Result<Vec<(PathBuf, Found)>> {
    let looks = paths.iter().map(|path| Look::ask(path, gauges)).collect::<Result<Vec<_>>>()?;
    let wait = |look: Look| thread::Builder::new().stack_size(128 * 1024).spawn(|| look.end());
    let waits = looks.into_iter().map(wait).collect::<io::Result<Vec<_>>>();
    let waits = waits.map_err(|error| Error::io("gaugefs", "cannot start a thread", &error))?;
    Ok(paths.iter().cloned().zip(waits.into_iter().map(|wait| wait.join().unwrap_or_default())).collect())
}

/// File systems that wait for no other process and no server.
const LOCAL: [&str; 11] =
    ["bcachefs", "btrfs", "devtmpfs", "erofs", "ext4", "f2fs", "overlay", "ramfs", "rootfs", "tmpfs", "xfs"];

/// What a look finds, if no call on the way to the path can hang: without a process. `None` if there may be such a call.
fn in_local(path: &Path) -> Option<Found> {
    let plain: PathBuf = absolute(path).ok()?.components().collect();
    let mounts = mounts::all().ok()?;
    let mut on_the_way: Vec<_> = plain.ancestors().collect();
    on_the_way.reverse();
    for folder in on_the_way {
        let mount = mounts::containing(mounts.iter().cloned(), folder)?;
        // A link may lead anywhere, and so may a path up from it.
        if !LOCAL.contains(&&*mount.kind) || folder.ends_with("..") {
            return None;
        }
        match fs::symlink_metadata(folder) {
            Ok(status) if status.is_symlink() => return None,
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => break,
            Err(_) => return None,
        }
    }
    Some(Found { path: Some(plain), dead: Some(false), ..Found::default() })
}

/// In the child: tells the full path, whether its daemon is gone, and the gauges if requested, each as soon as it is
/// known.
fn answer(path: &Path, gauges: bool, to: &mut impl Write) -> io::Result<()> {
    // Before anything is open in the mount. Without the name it would only be taken for a user of the mount.
    let _ = nix::sys::prctl::set_name(NAME);
    let mut tell = |word: &[u8]| to.write_all(&[word, &[0]].concat());
    let path = resolve(path).map_err(io::Error::other)?;
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
            tell(&serde_json::to_vec(&Seen::read(&gauge)).expect("keys are strings, so it cannot fail"))?;
        }
    }
    Ok(())
}

/// Runs a program. Returns whether it succeeded and its standard output; `None` if it waits for too long.
pub(super) fn run(command: &mut Command) -> io::Result<Option<(bool, String)>> {
    let command = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // A closed terminal signals the whole group, possibly while the mount is being removed.
    let mut child = command.process_group(0).spawn()?;
    let process = id(&child);
    let (bytes, late) = child.stderr.take().map(|err| read(err, process)).unwrap_or_default();
    if late {
        stop(process, late);
        return Ok(None);
    }
    Ok(Some((child.wait()?.success(), String::from_utf8_lossy(&bytes).into_owned())))
}

/// Reads a pipe until its end, until the process behind it waits for too long, or until the text is too long. Returns
/// the bytes, and whether it stopped early.
fn read(mut pipe: impl Read + AsFd, process: Pid) -> (Vec<u8>, bool) {
    let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
    let mut pulse = Pulse::new(process);
    let step = PollTimeout::try_from(STEP).unwrap_or(PollTimeout::MAX);
    loop {
        match poll(&mut [PollFd::new(pipe.as_fd(), PollFlags::POLLIN)], step) {
            Ok(0) if pulse.is_stuck() => return (bytes, true),
            Ok(0) | Err(Errno::EINTR) => {}
            Ok(_) => match pipe.read(&mut piece) {
                Ok(0) => return (bytes, false),
                Ok(_) if bytes.len() > LONGEST => return (bytes, true),
                Ok(length) => {
                    bytes.extend_from_slice(&piece[..length]);
                    pulse.beats();
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return (bytes, false),
            },
            Err(_) => return (bytes, false),
        }
    }
}

/// The number of a child that nobody has waited for.
fn id(child: &Child) -> Pid {
    Pid::from_raw(child.id() as i32)
}

/// Ends a child. A child that not even SIGKILL ends is left to process 1.
fn stop(process: Pid, late: bool) {
    if late {
        // It may have just ended.
        let _ = kill(process, Signal::SIGKILL);
    }
    let _ = waitpid(process, late.then_some(WaitPidFlag::WNOHANG));
}

/// The full path, found without access to mounted file systems. The folders above it may be in a hanging mount, so only
/// a child process calls this, or a process whose child has.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_path_through_local_folders_needs_no_process() {
        let folder = std::env::temp_dir().join(format!("gaugefs-local-{}", std::process::id()));
        let link = folder.join("link");
        fs::create_dir(&folder).expect("a folder");
        std::os::unix::fs::symlink("/", &link).expect("a link");
        let found = |path: PathBuf| in_local(&path).and_then(|found| found.path);
        let is_local = found(folder.clone()) == Some(folder.clone());
        for missing in ["missing", "missing/too"].map(|name| folder.join(name)) {
            assert_eq!(found(missing.clone()), is_local.then_some(missing));
        }
        for other in
            [link.clone(), link.join("etc"), folder.join("../x"), "/proc".into(), "/sys/class".into()]
        {
            assert_eq!(found(other.clone()), None, "{}", other.display());
        }
        fs::remove_dir_all(folder).expect("removed");
    }

    /// A busy machine does not let it run: `mount` said that a plain folder was in a mount whose process is stopped.
    #[test]
    fn regression_a_process_that_could_run_was_taken_for_one_that_waits() {
        let mut busy = Command::new("sh").args(["-c", "while :; do :; done"]).spawn().expect("a shell");
        let mut pulse = Pulse::new(id(&busy));
        assert!((0..5 * LIMIT).all(|_| !pulse.is_stuck()));
        busy.kill().and_then(|()| busy.wait()).expect("it ends");
        let mut waits = Command::new("sleep").arg("600").spawn().expect("sleep runs");
        let mut pulse = Pulse::new(id(&waits));
        let start = Instant::now();
        // It first has to reach its wait.
        while !pulse.is_stuck() {
            assert!(start.elapsed() < Duration::from_secs(300), "it does not come to it");
            thread::sleep(Duration::from_millis(1));
        }
        waits.kill().and_then(|()| waits.wait()).expect("it ends");
    }

    /// `list` said on a busy machine that the daemon of 512 gauges does not answer, while it told one after the other.
    #[test]
    fn regression_what_goes_on_to_speak_was_taken_for_silent() {
        let long_ago = Instant::now().checked_sub(PATIENCE * 2).expect("up for minutes");
        let mut pulse = Pulse { begun: long_ago, ..Pulse::new(Pid::this()) };
        assert!(pulse.is_stuck());
        pulse.beats();
        assert!(!pulse.is_stuck());
    }

    #[test]
    fn a_wait_is_told_from_the_next_one() {
        let status = |state: &str, switches: u32| {
            format!(
                "Name:\tx\nState:\t{state}\nvoluntary_ctxt_switches:\t{switches}\nnonvoluntary_ctxt_switches:\t0\n"
            )
        };
        assert_eq!(waits(&status("R (running)", 1)), None);
        assert_eq!(waits(""), None);
        let wait = waits(&status("S (sleeping)", 1));
        assert!(wait.is_some() && wait == waits(&status("S (sleeping)", 1)));
        assert_ne!(wait, waits(&status("D (disk sleep)", 2)));
    }

    #[test]
    fn what_somebody_has_typed_is_no_trouble_of_the_gauge() {
        for (facts, is_typed) in [
            (r#"{"cause":"out-of-range","errno":"ERANGE","greatest":3700}"#, true),
            (r#"{"cause":"io","errno":"ENOENT"}"#, true),
            (r#"{"cause":"no-answer","errno":"ENXIO"}"#, false),
            ("", false),
        ] {
            assert_eq!(is_mistake(facts), is_typed, "{facts}");
        }
        let both =
            "2026-11-22T05:40:12Z: no such parameter; since 2026-11-22T05:39:10Z: Voltage() stays 0 mV";
        assert_eq!(standing(both).as_deref(), Some("since 2026-11-22T05:39:10Z: Voltage() stays 0 mV"));
        assert_eq!(standing("2026-11-22T05:40:12Z: no such parameter"), None);
    }
}
