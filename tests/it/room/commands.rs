// SPDX-License-Identifier: MIT

//! gaugefs as a command: what it prints, and mounts that it serves.

use std::cell::Cell;
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::{Connections, Folder};

pub(crate) const CHIP: &str = "bq34z100-g1";

/// The result of a run.
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
    /// The lines of standard error that say which gauge it is.
    pub(crate) gauges: Vec<String>,
}

thread_local! {
    static IMPATIENT: Cell<bool> = const { Cell::new(false) };
    static IN_REAL_TIME: Cell<bool> = const { Cell::new(false) };
}

/// The commands of this test from now on take a daemon that does not answer for some seconds for one that hangs, as they do
/// outside of tests. Otherwise the machine may only be busy.
pub(crate) fn impatient() {
    IMPATIENT.set(true);
}

/// While it lives, the mounts of this test let time pass.
pub(crate) struct RealTime(());

/// Mounts of simulated gauges skip the gauge's waits, unless a test looks at what happens during one.
pub(crate) fn in_real_time() -> RealTime {
    IN_REAL_TIME.set(true);
    RealTime(())
}

impl Drop for RealTime {
    fn drop(&mut self) {
        IN_REAL_TIME.set(false);
    }
}

pub(super) fn is_in_real_time() -> bool {
    IN_REAL_TIME.get()
}

/// Whether these arguments mount simulated gauges only, whose waits can be skipped.
fn may_skip_time(arguments: &[&str]) -> bool {
    const OTHERS: &[&str] = &["--config", "--check", "--bus", "--replay", "--help", "--service", "--fast"];
    let has = |names: &[&str]| {
        arguments.iter().any(|word| names.contains(&word.split_once('=').map_or(*word, |(name, _)| name)))
    };
    arguments.first() == Some(&"mount") && has(&["--sim"]) && !has(OTHERS)
}

/// The program `gaugefs-station`.
pub(crate) const STATION: &str = env!("CARGO_BIN_EXE_gaugefs-station");

pub(crate) fn command(arguments: &[&str]) -> Command {
    command_of(env!("CARGO_BIN_EXE_gaugefs"), arguments)
}

pub(crate) fn command_of(program: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(program);
    command
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("COLUMNS", "100")
        .env_remove("RUST_LOG")
        .stdin(Stdio::null());
    if may_skip_time(arguments) && !is_in_real_time() {
        command.arg("--fast");
    }
    if !IMPATIENT.get() {
        command.env("GAUGEFS_PATIENCE", LONG.as_secs().to_string());
    }
    command
}

pub(crate) fn gaugefs(arguments: &[&str]) -> Ran {
    run(command(arguments))
}

pub(crate) fn gaugefs_station(arguments: &[&str]) -> Ran {
    run(command_of(STATION, arguments))
}

/// gaugefs as the user nobody runs it, which takes root: a copy, because the checkout may be in a home that only its owner
/// may enter.
pub(crate) fn as_nobody(folder: &Folder, arguments: &[&str]) -> Command {
    use std::os::unix::process::CommandExt;
    let program = folder.file("gaugefs");
    if !Path::new(&program).exists() {
        fs::copy(env!("CARGO_BIN_EXE_gaugefs"), &program).expect("a copy that any user may run");
    }
    fs::set_permissions(folder.file(""), fs::Permissions::from_mode(0o755)).expect("its mode");
    let mut command = Command::new(program);
    command.args(arguments).current_dir("/").uid(65534).gid(65534).env_remove("XDG_RUNTIME_DIR");
    command
}

pub(crate) fn run(mut command: Command) -> Ran {
    Ran::of(command.output().expect("gaugefs runs"))
}

impl Ran {
    pub(crate) fn of(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("it prints text");
        let (mut code, out, mut err) = (output.status.code(), text(output.stdout), text(output.stderr));
        // The mount namespace of another test has the mounts of this one, too.
        if code == Some(3) && err.contains("unmounted here") && err.contains("in the mount namespace of") {
            (code, err) = (Some(0), String::new());
        }
        let (gauges, err): (Vec<&str>, Vec<&str>) =
            err.split_inclusive('\n').partition(|line| line.starts_with("gaugefs: gauge "));
        Self { code, out, err: err.concat(), gauges: gauges.into_iter().map(str::to_string).collect() }
    }

    #[track_caller]
    pub(crate) fn done(self) -> String {
        assert_eq!(self.code, Some(0), "{}{}", self.out, self.err);
        assert_eq!(self.err, "");
        self.out
    }

    /// What a comparison prints that has found a difference.
    #[track_caller]
    pub(crate) fn differs(self) -> String {
        assert_eq!((self.code, self.err.as_str()), (Some(1), ""), "{}", self.out);
        self.out
    }

    /// Checks for exit code 1 and one line that begins with `gaugefs: ` and contains all of `words`.
    #[track_caller]
    pub(crate) fn failed(self, words: &[&str]) {
        self.failed_with(1, words);
    }

    /// Checks for exit code 2, which says that the question could not be answered, and one such line.
    #[track_caller]
    pub(crate) fn troubled(self, words: &[&str]) {
        self.failed_with(2, words);
    }

    #[track_caller]
    fn failed_with(self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "{}{}", self.out, self.err);
        assert_eq!(self.out, "");
        assert_eq!(self.err.lines().count(), 1, "{}", self.err);
        let program = self.err.split_once(": ").map(|(program, _)| program);
        assert!(
            program.is_some_and(|program| ["gaugefs", "gaugefs-station"].contains(&program)),
            "{}",
            self.err
        );
        for word in words {
            assert!(self.err.contains(word), "`{word}` is not in: {}", self.err);
        }
    }
}

/// Compares a text with a file of `golden/`.
#[track_caller]
pub(crate) fn same_as_golden(name: &str, now: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden").join(name);
    if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
        fs::write(&path, now).expect("the golden file");
    }
    let then = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        now == then,
        "{}: the output differs; if that is intended, GAUGEFS_GOLDEN=write cargo test\n{now}",
        path.display()
    );
}

/// Whether this machine can mount FUSE.
pub(crate) fn can_mount() -> bool {
    let can = fs::File::options().read(true).write(true).open("/dev/fuse").is_ok();
    if !can {
        eprintln!("SKIPPED: /dev/fuse cannot be opened; no test of the mount command ran");
    }
    can
}

/// Whether users other than root can mount FUSE here.
pub(crate) fn users_can_mount() -> bool {
    if !can_mount() {
        return false;
    }
    let can = Command::new("fusermount3").arg("-V").output().is_ok_and(|ran| ran.status.success());
    if !can {
        eprintln!("SKIPPED: fusermount3 is missing; to run all tests: sudo apt-get install fuse3");
    }
    can
}

/// A guard against what hangs, and no measurement: however busy the machine is, what comes at all comes sooner.
pub(crate) const LONG: Duration = Duration::from_secs(300);

#[track_caller]
pub(crate) fn within(what: &str, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < LONG, "{what}: not within {LONG:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Stops a daemon while it has no request: whoever waits for the answer to one that a daemon has taken cannot be ended,
/// not even by SIGKILL. Without root, where the kernel's list of connections is not mounted, that is left to chance.
pub(crate) fn stop(daemon: u32, at: &str) {
    impatient();
    let pid = Pid::from_raw(daemon as i32);
    let device = fs::metadata(at).expect("a mount").dev();
    let connections = Connections::mount().ok();
    let connections = connections.as_ref().map_or(Path::new("/sys/fs/fuse/connections"), |own| &own.0);
    let waiting = connections.join(nix::sys::stat::minor(device).to_string()).join("waiting");
    for _ in 0..1000 {
        kill(pid, Signal::SIGSTOP).expect("it runs");
        within("stopped", || is_stopped(daemon));
        if fs::read_to_string(&waiting).map_or(true, |count| count.trim() == "0") {
            return;
        }
        kill(pid, Signal::SIGCONT).expect("it runs");
        std::thread::sleep(Duration::from_millis(3));
    }
    panic!("{at}: the daemon is never without a request");
}

/// Whether each thread of a process is stopped.
fn is_stopped(process: u32) -> bool {
    let Ok(threads) = fs::read_dir(format!("/proc/{process}/task")) else { return true };
    threads.flatten().all(|thread| {
        let status = fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        status.rsplit(") ").next().is_some_and(|rest| rest.starts_with(['T', 'Z', 'X']) || rest.is_empty())
    })
}

/// A mount in the foreground, killed when the test ends.
pub(crate) struct Foreground(pub(crate) Child);

impl Foreground {
    pub(crate) fn new(mountpoint: &str, more: &[&str]) -> Self {
        let arguments = [&["mount", "-f", "--sim", CHIP, mountpoint], more].concat();
        let child = command(&arguments).stderr(Stdio::null()).spawn().expect("gaugefs runs");
        let present = Path::new(mountpoint).join("BAT0/present");
        within("mounted", || present.exists());
        Self(child)
    }

    pub(crate) fn send(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("it runs");
    }

    #[track_caller]
    pub(crate) fn ends(&mut self) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().expect("a child") {
                return status.code();
            }
            assert!(start.elapsed() < LONG, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Foreground {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub(crate) fn read(mountpoint: &str, name: &str) -> String {
    let path = Path::new(mountpoint).join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).trim().to_string()
}

/// Every file of a gauge's folder that does not depend on this test's own accesses.
pub(crate) fn shown(gauge: &str) -> Vec<(String, String)> {
    let own = [
        "authenticate",
        "presence",
        "age_ms",
        "last_error",
        "last_error_facts",
        "progress",
        "control",
        "refresh",
        "report",
        "seal",
        "values",
        "owner_values",
    ];
    let mut files = Vec::new();
    for folder in [".", "gauge", "gauge/registers"] {
        for entry in fs::read_dir(Path::new(gauge).join(folder)).expect("a folder") {
            let entry = entry.expect("an entry");
            let name = entry.file_name().into_string().expect("a name");
            if entry.file_type().expect("a kind").is_file() && !own.contains(&name.as_str()) {
                // A value that is not known yet is listed, but cannot be read.
                let text = fs::read_to_string(entry.path()).unwrap_or_default();
                files.push((format!("{folder}/{name}"), text));
            }
        }
    }
    files.sort();
    files
}
