// SPDX-License-Identifier: MIT

//! Daemons that are ended at random moments of writes that take several write(2), while others read. A daemon
//! must end, no reader or writer may hang, and what a writer is told must be true.
//!
//! GAUGEFS_ENDS sets how many are ended, GAUGEFS_SEED where the random numbers start.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::mount::{MntFlags, umount2};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::minor;
use nix::unistd::{Pid, geteuid};

use super::room::{CHIP, command, gaugefs, in_real_time};
use crate::rig::Random;
use crate::room;
use crate::room::{Connections, LONG};

/// How many daemons are ended at the same time.
const ABREAST: u64 = 8;

/// A daemon with a simulated gauge whose flash is in a file.
struct Daemon {
    folder: PathBuf,
    process: Child,
    /// Written to, it aborts the daemon's connection.
    abort: PathBuf,
}

impl Daemon {
    fn start(name: &str, connections: &Connections) -> Self {
        let folder = room::folder_named(&format!("-{name}"));
        let mut mount = Self::mount(&folder);
        let process = mount.arg("--foreground").stderr(File::create(folder.join("log")).expect("a log"));
        let mut daemon =
            Self { process: process.spawn().expect("gaugefs runs"), folder, abort: PathBuf::new() };
        let present = daemon.file("present");
        within("the mount", || present.exists());
        let device = fs::metadata(daemon.place()).expect("a folder").dev();
        daemon.abort = connections.0.join(minor(device).to_string()).join("abort");
        assert!(daemon.abort.exists(), "{}", daemon.abort.display());
        daemon
    }

    /// The command that mounts the gauge.
    fn mount(folder: &Path) -> std::process::Command {
        // A daemon is ended while it waits, too.
        let _time = in_real_time();
        let mut mount =
            command(&["mount", "--sim", CHIP, "--poll", "0.5", "--writes-per-hour", "0", "--no-backup"]);
        mount.arg("--sim-state").arg(folder.join("flash"));
        mount.arg("--state-dir").arg(folder.join("journal")).arg(folder.join("tree"));
        mount
    }

    fn place(&self) -> PathBuf {
        self.folder.join("tree")
    }

    fn file(&self, name: &str) -> PathBuf {
        self.place().join("BAT0").join(name)
    }

    fn send(&self, signal: Signal) {
        kill(Pid::from_raw(self.process.id() as i32), signal).expect("it runs");
    }

    fn is_mounted(&self) -> bool {
        let table = fs::read_to_string("/proc/self/mountinfo").expect("a table");
        table.contains(self.place().to_str().expect("a path in UTF-8"))
    }

    /// Fails with what each thread of the daemon waits for in the kernel.
    fn hangs(&self, what: &str) -> ! {
        let mut stacks = String::new();
        for thread in
            fs::read_dir(format!("/proc/{}/task", self.process.id())).into_iter().flatten().flatten()
        {
            for file in ["comm", "wchan", "stack"] {
                stacks += &fs::read_to_string(thread.path().join(file)).unwrap_or_default();
                stacks.push('\n');
            }
        }
        panic!("{}: {what}\n{stacks}", self.folder.display());
    }
}

impl Drop for Daemon {
    /// Also ends what hangs: everything that waits for the daemon fails when its connection is aborted.
    fn drop(&mut self) {
        if thread::panicking() {
            let _ = fs::write(&self.abort, "1");
        }
        while self.is_mounted() && umount2(&self.place(), MntFlags::MNT_FORCE | MntFlags::MNT_DETACH).is_ok()
        {
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
        if !thread::panicking() {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

#[track_caller]
fn within(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < LONG, "{what} does not come");
        thread::sleep(Duration::from_millis(5));
    }
}

fn errno(error: &std::io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or_default())
}

/// Whether an errno means that the daemon is gone. Once it is unmounted, its files do not exist.
fn is_over(errno: Errno) -> bool {
    matches!(errno, Errno::ENOTCONN | Errno::ECONNABORTED | Errno::ENOENT)
}

/// What a writer has written to one parameter.
#[derive(Default)]
struct Written {
    /// The last value that was written with success.
    last: Option<String>,
    /// A value with whose write the daemon has ended.
    pending: Option<String>,
    successes: u64,
    errors: Vec<Errno>,
}

impl Written {
    /// Returns whether to go on.
    fn note(&mut self, value: &str, outcome: std::io::Result<()>) -> bool {
        match outcome.map_err(|error| errno(&error)) {
            Ok(()) => {
                self.last = Some(value.to_string());
                self.successes += 1;
            }
            Err(errno) => {
                self.errors.push(errno);
                if is_over(errno) {
                    self.pending = (errno == Errno::ECONNABORTED).then(|| value.to_string());
                    return false;
                }
            }
        }
        true
    }
}

fn open(path: &Path) -> std::io::Result<File> {
    File::options().append(true).open(path)
}

/// Writes Cell Terminate Voltage in transactions of several write(2).
fn transactions(path: &Path) -> Written {
    let mut written = Written::default();
    for value in (3001..3600).cycle().map(|value: u32| value.to_string()) {
        let attempt = || {
            let mut file = open(path)?;
            file.write_all(b"begin\n")?;
            file.write_all(format!("80/53 {value}\n").as_bytes())?;
            file.write_all(b"commit\n")
        };
        if !written.note(&value, attempt()) {
            break;
        }
    }
    written
}

/// Writes lines to the file of Manufacturer Name, two through each opened file.
fn lines(path: &Path) -> Written {
    let mut written = Written::default();
    'all: for number in (0..1000).step_by(2).cycle() {
        let mut file = match open(path) {
            Ok(file) => file,
            Err(error) => {
                written.note("", Err(error));
                break;
            }
        };
        for value in [number, number + 1].map(|number| format!("N{number}")) {
            if !written.note(&value, file.write_all(format!("{value}\n").as_bytes())) {
                break 'all;
            }
        }
    }
    written
}

/// Repeats something until the daemon has ended, and returns the errnos.
fn repeats(place: &Path, mut work: impl FnMut() -> std::io::Result<()>) -> Written {
    let mut found = Written::default();
    loop {
        match work() {
            // The file of a value may disappear before it is opened.
            Err(error) if errno(&error) == Errno::ENOENT && place.join("BAT0").exists() => {}
            outcome => {
                if !found.note("", outcome) {
                    return found;
                }
            }
        }
        thread::sleep(Duration::from_micros(200));
    }
}

fn every_attribute(gauge: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(gauge)? {
        let entry = entry?;
        if entry.file_type()?.is_file() {
            fs::read(entry.path())?;
        }
    }
    Ok(())
}

fn run(work: impl FnOnce() -> Written + Send + 'static) -> Receiver<Written> {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || sender.send(work()));
    receiver
}

/// Ends one daemon.
fn end(number: u64, random: &mut Random, connections: &Connections) {
    let mut daemon = Daemon::start(&number.to_string(), connections);
    // A terminal that is closed ends it as gently as SIGTERM.
    let signal = match random.below(4) {
        0 => Signal::SIGTERM,
        1 => Signal::SIGHUP,
        _ => Signal::SIGKILL,
    };
    fs::write(daemon.file("sim/load_ma"), "500").expect("a knob");
    fs::write(daemon.file("sim/speed"), "100").expect("a knob");
    let (transaction, name, voltage) =
        (daemon.file("df/transaction"), daemon.file("df/48/43"), daemon.file("df/80/53"));
    let (gauge, refresh) = (daemon.file(""), daemon.file("gauge/refresh"));
    let [first, second, third] = [(); 3].map(|()| daemon.place());
    let mut held = File::open(&voltage).expect("opens");
    let writers = [run(move || transactions(&transaction)), run(move || lines(&name))];
    let mut read = move || held.seek(SeekFrom::Start(0)).and_then(|_| held.read(&mut [0; 64])).map(drop);
    let others = [
        run(move || repeats(&first, || every_attribute(&gauge))),
        run(move || repeats(&second, &mut read)),
        run(move || repeats(&third, || fs::write(&refresh, "1"))),
    ];
    let after = Duration::from_micros(random.below(3_000_000));
    thread::sleep(after);
    let what = format!("{number}: {signal} after {after:?}");
    daemon.send(signal);

    let start = Instant::now();
    while daemon.process.try_wait().expect("a child").is_none() {
        if start.elapsed() > LONG {
            daemon.hangs(&format!("{what}: the daemon does not end"));
        }
        thread::sleep(Duration::from_millis(5));
    }
    if signal != Signal::SIGKILL {
        assert!(!daemon.is_mounted(), "{what}: still mounted");
    }
    let finished = |work: &Receiver<Written>| match work.recv_timeout(LONG) {
        Ok(written) => written,
        Err(RecvTimeoutError::Timeout) => daemon.hangs(&format!("{what}: a reader or writer hangs")),
        Err(RecvTimeoutError::Disconnected) => panic!("{what}: a reader or writer has panicked"),
    };
    let writers = writers.each_ref().map(finished);
    let others = others.each_ref().map(finished);
    for errno in others.iter().chain(&writers).flat_map(|work| &work.errors) {
        let documented = matches!(errno, Errno::EBUSY | Errno::EAGAIN | Errno::ENODEV) || is_over(*errno);
        assert!(documented, "{what}: {errno}");
    }

    let errors =
        |errno| writers.iter().flat_map(|work| &work.errors).filter(|&&found| found == errno).count();
    println!(
        "{what}: {:?} writes, {:?} reads, {} EBUSY, {} EAGAIN, {} ECONNABORTED",
        writers.each_ref().map(|work| work.successes),
        others.each_ref().map(|work| work.successes),
        errors(Errno::EBUSY),
        errors(Errno::EAGAIN),
        errors(Errno::ECONNABORTED)
    );

    // The gauge can be mounted again, its lock is free, and it has what the writers were told.
    if daemon.is_mounted() {
        gaugefs(&["umount", daemon.place().to_str().expect("a path in UTF-8")]).done();
    }
    let mut again = Daemon::mount(&daemon.folder);
    let again = again.stdout(Stdio::null()).stderr(Stdio::null()).status().expect("gaugefs runs");
    assert!(again.success(), "{what}: it cannot be mounted again");
    for (name, written) in ["80/53", "48/43"].into_iter().zip(&writers) {
        let path = daemon.file("df").join(name);
        let mut now = String::new();
        // An interrupted write is settled first.
        within("the value", || fs::read_to_string(&path).map(|text| now = text).is_ok());
        let initial = if name == "80/53" { "3000" } else { "Texas Inst." };
        let last = written.last.as_deref().unwrap_or(initial);
        let pending = written.pending.as_deref().filter(|_| signal == Signal::SIGKILL);
        let is_true = now.trim_end() == last || Some(now.trim_end()) == pending;
        assert!(
            is_true,
            "{what}: {name} is {now:?}, after {last} was written and {pending:?} was not answered"
        );
    }
    gaugefs(&["umount", daemon.place().to_str().expect("a path in UTF-8")]).done();
    assert!(!daemon.is_mounted(), "{what}: mounted");
    let files = fs::read_dir(daemon.folder.join("journal"))
        .expect("a folder")
        .map(|file| file.expect("a file").path());
    let left: Vec<_> = files.filter(|path| path.extension().is_some_and(|kind| kind == "journal")).collect();
    assert!(left.is_empty(), "{what}: {left:?} are left");
}

fn may_abort() -> bool {
    let may = geteuid().is_root() && File::options().read(true).write(true).open("/dev/fuse").is_ok();
    if !may {
        eprintln!("SKIPPED: only root can abort the mount of a daemon that hangs; none was ended");
    }
    may
}

/// The kernel ends the session of a detached mount only when the last file is closed.
#[test]
fn a_daemon_ends_on_sigterm_although_its_detached_mount_is_in_use() {
    if !may_abort() {
        return;
    }
    let connections = Connections::mount().expect("connections can be aborted");
    let mut daemon = Daemon::start("detached", &connections);
    let held = File::open(daemon.file("present")).expect("opens");
    umount2(&daemon.place(), MntFlags::MNT_DETACH).expect("detached");
    daemon.send(Signal::SIGTERM);
    let mut ended = None;
    within("the end", || {
        ended = daemon.process.try_wait().expect("a child");
        ended.is_some()
    });
    assert!(ended.is_some_and(|status| status.success()), "{ended:?}");
    drop(held);
}

#[test]
fn a_daemon_ended_at_any_moment_ends_and_was_truthful() {
    if !may_abort() {
        return;
    }
    let connections = Connections::mount().expect("connections can be aborted");
    let number = |name: &str, usual| {
        std::env::var(name).map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{name}: {text}")))
    };
    let (ends, seed): (u64, u64) = (number("GAUGEFS_ENDS", 6), number("GAUGEFS_SEED", 1));
    let (next, failed) = (Mutex::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..ABREAST.min(ends) {
            scope.spawn(|| {
                loop {
                    let number = {
                        let mut next = next.lock().expect("no panic");
                        *next += 1;
                        *next - 1
                    };
                    if number >= ends {
                        return;
                    }
                    let ended = std::panic::catch_unwind(|| {
                        end(number, &mut Random(seed ^ (number << 32)), &connections)
                    });
                    if ended.is_err() {
                        failed.lock().expect("no panic").push(number);
                    }
                }
            });
        }
    });
    let failed = failed.into_inner().expect("no panic");
    println!("{ends} ends from seed {seed}, {} failed", failed.len());
    assert!(failed.is_empty(), "{failed:?}");
}
