// SPDX-License-Identifier: MIT

//! Where a pack shows what it is, besides its gauge: in a file, or in what a program prints.
//!
//! Either may hang, and SIGKILL does not end a process that waits for a file system: a child looks, a thread waits for it.

use std::fmt;
use std::io::{self, ErrorKind, PipeReader, Read as _};
use std::os::fd::AsFd as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, killpg};
use nix::unistd::{AccessFlags, Pid, access};

use crate::error::{Error, Result};
use gauge_bus::regular;

/// How long a look may take.
const LIMIT: Duration = Duration::from_secs(if cfg!(test) { 60 } else { 5 });
/// How long a look is waited for. A mount waits for 5 s for its gauges.
const PATIENCE: Duration = Duration::from_secs(if cfg!(test) { 60 } else { 2 });
/// How much a program may print, and how long a file may be. sysfs shows a page as the length of each file.
const LONGEST: usize = 4096;
/// How long what was found may be to be compared or shown.
const TEXT: usize = 64;
/// How often a file is read, and the pause in between: one reading of a converter may be wrong.
const READINGS: u32 = 3;
const PAUSE: Duration = Duration::from_millis(10);
/// All that a program finds in its environment, besides the name of the gauge.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";
/// Reads a regular file. Anything else is not even opened.
const READ: &str = r#"if [ -e "$1" ] && [ ! -f "$1" ]; then echo "it is not a regular file"; exit 1; fi; exec cat -- "$1" 2>&1"#;

/// Where a pack shows what it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// In a file, read three times.
    File(PathBuf),
    /// In what a program prints: its path, and its arguments.
    Command(Vec<String>),
}

impl Evidence {
    /// Whether it can be looked at, as far as that can be seen without running a program of the configuration.
    pub fn check(&self) -> Result<()> {
        let failed = |path: &Path, error| {
            Error::io(path.display().to_string(), "cannot be used to choose a profile", &error)
        };
        match self {
            Self::File(path) => Looker::new(LIMIT).read(path).map(drop).map_err(|error| failed(path, error)),
            Self::Command(words) => {
                let path = Path::new(&words[0]);
                access(path, AccessFlags::X_OK).map_err(|errno| failed(path, errno.into()))
            }
        }
    }
}

impl fmt::Display for Evidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Command(words) => write!(f, "{}", words.join(" ")),
        }
    }
}

/// The looks for one gauge, at most one at each piece: one that cannot be ended is left behind, without another one.
#[derive(Debug)]
pub(crate) struct Looks {
    begun: Vec<Look>,
    limit: Duration,
    patience: Duration,
}

#[derive(Debug)]
struct Look {
    evidence: Evidence,
    begun: Instant,
    /// What it shows is of a pack that may have been exchanged since.
    is_stale: bool,
    /// What was found, and when. Its other end is closed when the child process has ended.
    found: Receiver<(Instant, io::Result<Vec<String>>)>,
    group: Arc<Mutex<Group>>,
}

#[derive(Debug, Default)]
struct Group {
    /// While it has not been waited for, so that its number is its own.
    running: Option<Pid>,
    /// Nobody wants to know any more.
    is_over: bool,
}

impl Default for Looks {
    fn default() -> Self {
        Self { begun: Vec::new(), limit: LIMIT, patience: PATIENCE }
    }
}

impl Looks {
    /// The end of the time in which looks that are begun or asked for now are waited for.
    pub(crate) fn deadline(&self) -> Instant {
        Instant::now() + self.patience
    }

    /// The pack may have been exchanged since they were begun.
    pub(crate) fn forget(&mut self) {
        self.begun.iter_mut().for_each(|look| look.is_stale = true);
    }

    /// What a piece of evidence shows, as often as it is looked at. `WouldBlock`: the look goes on, to be asked for again.
    pub(crate) fn at(
        &mut self,
        evidence: &Evidence,
        gauge: &str,
        deadline: Instant,
    ) -> io::Result<Vec<String>> {
        loop {
            let at = match self.begun.iter().position(|look| look.evidence == *evidence) {
                Some(at) => at,
                None => {
                    self.begun.push(Look::begin(evidence, gauge, self.limit)?);
                    self.begun.len() - 1
                }
            };
            let look = &mut self.begun[at];
            // One look is waited for once.
            let deadline = deadline.min(look.begun + self.patience);
            match look.found.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok((when, found)) if !look.is_stale && when.elapsed() <= self.patience => return found,
                Ok(_) => look.is_stale = true,
                Err(RecvTimeoutError::Timeout) if look.begun.elapsed() < self.limit => {
                    return Err(io::Error::new(ErrorKind::WouldBlock, "has not answered yet"));
                }
                Err(RecvTimeoutError::Timeout) => {
                    let why = "does not answer, and what waits for it cannot be ended";
                    return Err(io::Error::new(ErrorKind::TimedOut, why));
                }
                Err(RecvTimeoutError::Disconnected) => drop(self.begun.swap_remove(at)),
            }
        }
    }
}

impl Look {
    fn begin(evidence: &Evidence, gauge: &str, limit: Duration) -> io::Result<Self> {
        let (sender, found) = mpsc::channel();
        let mut looker = Looker::new(limit);
        let group = looker.group.clone();
        let (at, gauge) = (evidence.clone(), gauge.to_string());
        let run = move || {
            let found = looker.look(&at, &gauge);
            // Whoever has asked may be gone.
            let _ = sender.send((Instant::now(), found));
            drop(looker.left.take().map(|mut child| child.wait()));
        };
        std::thread::Builder::new().name("look".into()).stack_size(256 * 1024).spawn(run)?;
        Ok(Self { evidence: evidence.clone(), begun: Instant::now(), is_stale: false, found, group })
    }
}

impl Drop for Look {
    fn drop(&mut self) {
        let mut group = lock(&self.group);
        group.is_over = true;
        group.kill();
    }
}

impl Group {
    fn kill(&mut self) {
        if let Some(group) = self.running.take() {
            let _ = killpg(group, Signal::SIGKILL);
        }
    }
}

fn lock(group: &Mutex<Group>) -> MutexGuard<'_, Group> {
    group.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Looker {
    end: Instant,
    group: Arc<Mutex<Group>>,
    /// A process that was killed, and may not end before what it waits for answers.
    left: Option<Child>,
}

impl Looker {
    fn new(limit: Duration) -> Self {
        Self { end: Instant::now() + limit, group: Arc::default(), left: None }
    }

    fn look(&mut self, evidence: &Evidence, gauge: &str) -> io::Result<Vec<String>> {
        match evidence {
            Evidence::File(path) => (0..READINGS)
                .map(|number| {
                    if number > 0 {
                        std::thread::sleep(PAUSE);
                    }
                    word(self.read(path)?)
                })
                .collect(),
            Evidence::Command(words) => {
                let mut command = command(&words[0]);
                command.args(&words[1..]).env("GAUGEFS_GAUGE", gauge);
                let (text, status) = self.printed(command)?;
                let failed = || io::Error::other(format!("it has failed ({status})"));
                Ok(vec![word(status.success().then_some(text).ok_or_else(failed)?)?])
            }
        }
    }

    fn read(&mut self, path: &Path) -> io::Result<Vec<u8>> {
        let mut command = command("/bin/sh");
        command.args(["-c", READ, "sh"]).arg(path);
        let (text, status) = self.printed(command)?;
        if status.success() {
            return Ok(text);
        }
        let why = String::from_utf8_lossy(&text);
        let why = why.trim().trim_start_matches("cat: ");
        let why = why.strip_prefix(&format!("{}: ", path.display())).unwrap_or(why);
        Err(io::Error::other(why.to_string()))
    }

    /// What a program prints, and how it ends. Too much time or text kills it, with what it has started.
    fn printed(&mut self, mut command: Command) -> io::Result<(Vec<u8>, ExitStatus)> {
        let (out, into) = io::pipe()?;
        command.stdout(into);
        let mut child = command.spawn()?;
        // The pipe ends with the program.
        drop(command);
        let mut group = lock(&self.group);
        group.running = Some(Pid::from_raw(child.id().cast_signed()));
        if group.is_over {
            group.kill();
        }
        drop(group);
        let ended = read_until(out, self.end).and_then(|text| Ok((text, self.end_of(&mut child)?)));
        ended.inspect_err(|_| {
            lock(&self.group).kill();
            self.left = Some(child);
        })
    }

    fn end_of(&self, child: &mut Child) -> io::Result<ExitStatus> {
        loop {
            let mut group = lock(&self.group);
            if let Some(status) = child.try_wait()? {
                group.running = None;
                return Ok(status);
            }
            drop(group);
            if Instant::now() >= self.end {
                return Err(too_late());
            }
            std::thread::sleep(PAUSE);
        }
    }
}

/// A program with the rights of this process, no input, and little environment.
fn command(program: &str) -> Command {
    let mut command = Command::new(program);
    command.env_clear().env("PATH", PATH).current_dir("/").stdin(Stdio::null()).process_group(0);
    command
}

fn word(bytes: Vec<u8>) -> io::Result<String> {
    let text = regular::text(bytes)?.trim().to_string();
    match text.len() {
        1..=TEXT if !text.contains(char::is_control) => Ok(text),
        0 => Err(io::Error::other("shows nothing")),
        _ => Err(io::Error::other(format!("shows more than one line of {TEXT} characters"))),
    }
}

fn too_late() -> io::Error {
    io::Error::new(ErrorKind::TimedOut, "it has not ended in time and was killed")
}

fn read_until(mut out: PipeReader, deadline: Instant) -> io::Result<Vec<u8>> {
    let mut text = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let mut waited = [PollFd::new(out.as_fd(), PollFlags::POLLIN)];
        match poll(&mut waited, PollTimeout::try_from(left).unwrap_or(PollTimeout::ZERO)) {
            Ok(0) => return Err(too_late()),
            Err(Errno::EINTR) => continue,
            ready => drop(ready?),
        }
        let mut part = [0; 512];
        match out.read(&mut part)? {
            0 => return Ok(text),
            length => text.extend_from_slice(&part[..length]),
        }
        if text.len() > LONGEST {
            return Err(io::Error::other(format!("it has more than {LONGEST} bytes")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn path(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("gaugefs-evidence-{name}-{}", std::process::id()))
    }

    fn program(script: &str) -> Evidence {
        Evidence::Command(["/bin/sh", "-c", script].map(String::from).to_vec())
    }

    fn seen(evidence: &Evidence) -> io::Result<Vec<String>> {
        let mut looks = Looks::default();
        looks.at(evidence, "BAT0", looks.deadline())
    }

    fn why(evidence: &Evidence) -> String {
        seen(evidence).expect_err("a reason").to_string()
    }

    #[test]
    fn a_program_prints_one_word() {
        assert_eq!(seen(&program("echo SN-1234")).expect("a word"), ["SN-1234"]);
        assert!(why(&program("echo A; exit 3")).contains("it has failed (exit status: 3)"));
        assert!(why(&program("cat /dev/zero")).contains("more than 4096 bytes"));
        // Nothing of the daemon's environment, no input, no descriptor of the daemon's.
        assert_eq!(seen(&program("cat; env | grep -cv '^PWD=\\|^_=\\|^SHLVL='")).expect("a count"), ["2"]);
        assert_eq!(seen(&program("echo $GAUGEFS_GAUGE")).expect("a name"), ["BAT0"]);
        assert!(why(&Evidence::Command(vec!["/nowhere/none".into()])).contains("No such file"));
    }

    #[test]
    fn a_file_is_read_three_times_and_nothing_else_is_opened() {
        let file = path("file");
        fs::write(&file, "150\n").expect("a file");
        assert_eq!(seen(&Evidence::File(file.clone())).expect("a number"), ["150"; 3]);
        Evidence::File(file.clone()).check().expect("it can be read");
        for (text, expected) in [("", "shows nothing"), ("1\n2", "more than one line")] {
            fs::write(&file, text).expect("a file");
            assert!(why(&Evidence::File(file.clone())).contains(expected), "{text}");
        }
        fs::remove_file(&file).expect("it is there");
        let missing = Evidence::File(file);
        assert_eq!(why(&missing), "No such file or directory");
        missing.check().expect_err("it is not there");
        for other in ["/dev/zero", "/tmp"] {
            assert_eq!(why(&Evidence::File(other.into())), "it is not a regular file");
        }
    }

    #[test]
    fn regression_who_asked_for_what_hangs_hung_as_well() {
        let file = path("hangs");
        let _ = fs::remove_file(&file);
        let evidence = program(&format!("until [ -e {} ]; do sleep 0.01; done; echo A", file.display()));
        let mut looks = Looks { patience: Duration::ZERO, ..Looks::default() };
        let ask = |looks: &mut Looks| looks.at(&evidence, "BAT0", looks.deadline());
        for _ in 0..3 {
            assert_eq!(ask(&mut looks).expect_err("it hangs").kind(), ErrorKind::WouldBlock);
            assert_eq!(looks.begun.len(), 1, "one process at a time");
        }
        fs::write(&file, "").expect("a file");
        looks.patience = Duration::from_secs(300);
        assert_eq!(ask(&mut looks).expect("it answers"), ["A"]);
        assert_eq!(ask(&mut looks).expect("it answers again"), ["A"]);
        fs::remove_file(file).expect("it is there");
    }

    /// The pack was exchanged in between.
    #[test]
    fn what_was_found_before_does_not_count() {
        let [file, begun, goes_on] = ["exchanged", "begun", "goes-on"].map(path);
        let [name, begins, waits] = [&file, &begun, &goes_on].map(|path| path.display());
        let evidence =
            program(&format!("cat {name}; echo > {begins}; until [ -e {waits} ]; do sleep 0.01; done"));
        for path in [&begun, &goes_on] {
            let _ = fs::remove_file(path);
        }
        fs::write(&file, "A").expect("a file");
        let mut looks = Looks { patience: Duration::ZERO, ..Looks::default() };
        looks.at(&evidence, "BAT0", looks.deadline()).expect_err("it takes longer");
        while !begun.exists() {
            std::thread::sleep(PAUSE);
        }
        fs::write(&file, "B").expect("a file");
        looks.forget();
        fs::write(&goes_on, "").expect("a file");
        looks.patience = Duration::from_secs(300);
        assert_eq!(looks.at(&evidence, "BAT0", looks.deadline()).expect("it answers"), ["B"]);
        for path in [file, begun, goes_on] {
            fs::remove_file(path).expect("it is there");
        }
    }

    #[test]
    fn a_program_that_does_not_end_is_killed_with_what_it_has_started() {
        let (started, waits) = (path("started"), program("sleep 600 & echo $! > $0; sleep 600"));
        let Evidence::Command(mut words) = waits else { unreachable!() };
        words.push(started.display().to_string());
        let evidence = Evidence::Command(words);
        for is_left in [false, true] {
            let _ = fs::remove_file(&started);
            let mut looks = Looks {
                patience: Duration::ZERO,
                // It has to be started first, also on a machine that is busy.
                limit: Duration::from_secs(if is_left { 300 } else { 15 }),
                ..Looks::default()
            };
            looks.at(&evidence, "BAT0", looks.deadline()).expect_err("it hangs");
            let process = loop {
                match fs::read_to_string(&started) {
                    Ok(process) if process.ends_with('\n') => break process,
                    _ => std::thread::sleep(PAUSE),
                }
            };
            let status = format!("/proc/{}/stat", process.trim());
            // Process 1 may not wait for it.
            let is_alive = || fs::read_to_string(&status).is_ok_and(|status| !status.contains(") Z "));
            if is_left {
                assert!(is_alive());
                drop(looks);
            } else {
                looks.patience = Duration::from_secs(300);
                let error = looks.at(&evidence, "BAT0", looks.deadline()).expect_err("it hangs");
                assert_eq!(error.to_string(), "it has not ended in time and was killed");
            }
            while is_alive() {
                std::thread::sleep(PAUSE);
            }
        }
        fs::remove_file(started).expect("it is there");
    }
}
