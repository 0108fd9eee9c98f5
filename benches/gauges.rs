// SPDX-License-Identifier: MIT

//! What the daemon costs the machine: one gauge whose whole tree has been read; then 1, 8, 64 and 512 gauges in one mount,
//! before and after everything in their trees is read: memory, processor time and wake-ups.
//!
//!     cargo bench --bench gauges
//!
//! The gauges are simulated, so the figures include the daemon's work for the battery behind each. The promises are a limit
//! of memory, and that the daemon sleeps between polls.

#![allow(clippy::disallowed_methods, reason = "it reads what it has made, and /proc")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

mod report;
use report::Report;

/// How many readers read the trees of many gauges.
const READERS: usize = 48;
const SETTLE: Duration = Duration::from_secs(4);
const WINDOW: Duration = Duration::from_secs(12);
/// Resident memory of a daemon with one gauge, at most: all of it, most of which is the program, and its own.
const MEMORY_MIB: f64 = 8.5;
const OWN_MIB: f64 = 2.0;
/// What one gauge more costs, everything in its tree read, at most: of each value that was read the table of nodeids keeps which
/// one showed it, so that the kernel's own copy is found again.
const ANOTHER_KIB: f64 = 176.0;
/// What 512 gauges cost, polled every 3 s, before and after everything in their trees is read, at most.
const ALL_MB: f64 = 40.0;
const ALL_PERCENT: f64 = 2.0;
/// Between polls that are so far apart, the daemon has nothing to do.
const LONG: &str = "600";

/// What a daemon has used up so far.
struct Used {
    /// The milliseconds on a processor of each thread, and how often it was switched.
    threads: BTreeMap<PathBuf, (f64, u64)>,
    rss_kib: u64,
    own_kib: u64,
}

impl Used {
    fn now(pid: u32) -> Self {
        let field = |text: &str, name: &str| -> u64 {
            let line = text.lines().find(|line| line.starts_with(name)).expect("a line of status");
            line.split_ascii_whitespace().nth(1).and_then(|word| word.parse().ok()).expect("a number")
        };
        let tasks = fs::read_dir(format!("/proc/{pid}/task")).expect("the daemon runs");
        // One that has ended meanwhile is left out.
        let thread = |task: PathBuf| -> Option<(PathBuf, (f64, u64))> {
            let ran = fs::read_to_string(task.join("schedstat")).ok()?;
            let status = fs::read_to_string(task.join("status")).ok()?;
            let ns: f64 = ran.split(' ').next()?.parse().ok()?;
            let switches =
                field(&status, "voluntary_ctxt_switches") + field(&status, "nonvoluntary_ctxt_switches");
            Some((task, (ns / 1e6, switches)))
        };
        let threads = tasks.filter_map(|task| thread(task.expect("an entry").path())).collect();
        let status = fs::read_to_string(format!("/proc/{pid}/status")).expect("the daemon runs");
        Self { threads, rss_kib: field(&status, "VmRSS:"), own_kib: field(&status, "RssAnon:") }
    }

    /// Milliseconds on a processor and switches since then.
    fn since(&self, before: &Self) -> (f64, u64) {
        self.threads.iter().fold((0.0, 0), |(ms, switches), (task, now)| {
            let before = before.threads.get(task).copied().unwrap_or_default();
            (ms + now.0 - before.0, switches + now.1 - before.1)
        })
    }
}

struct Daemon(Child, PathBuf);

impl Daemon {
    fn new(gauges: usize, poll: &str) -> Self {
        let folder = folder();
        let config = folder.join("gauges.toml");
        let text = format!("[mount]\nmountpoint = 'm'\n[defaults]\npoll = {poll}\n")
            + &"[[gauge]]\nsim = 'bq34z100-g1'\n".repeat(gauges);
        fs::write(&config, text).expect("a file");
        let mut command = Command::new(env!("CARGO_BIN_EXE_gaugefs"));
        command.args(["mount", "-f", "--config"]).arg(&config).stderr(Stdio::null());
        // As in the packaged service, and in the background.
        let tunables = include_str!("../udev/service.conf")
            .lines()
            .find_map(|line| line.strip_prefix("Environment=")?.strip_prefix("GLIBC_TUNABLES="));
        command.env("GLIBC_TUNABLES", tunables.expect("a line of the service"));
        let child = command.spawn().expect("gaugefs runs");
        let last = folder.join(format!("m/BAT{}/present", gauges - 1));
        let start = Instant::now();
        while !last.exists() {
            assert!(start.elapsed() < Duration::from_secs(30), "mounted");
            std::thread::sleep(Duration::from_millis(50));
        }
        Self(child, folder)
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = nix::sys::signal::kill(
            nix::unistd::Pid::from_raw(self.0.id() as i32),
            nix::sys::signal::Signal::SIGTERM,
        );
        let _ = self.0.wait();
        let _ = fs::remove_dir_all(&self.1);
    }
}

/// Reads every file of a folder and those below it; returns how many. What cannot be read is left out.
fn read_all(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).expect("a folder of the mount").flatten();
    let read = |entry: fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => read_all(&entry.path()),
        Ok(kind) if kind.is_file() => fs::read(entry.path()).is_ok().into(),
        _ => 0,
    };
    entries.map(read).sum()
}

/// Reads everything in the trees of that many gauges, several at a time. Reading data flash takes a gauge its time.
fn read_gauges(mount: &Path, gauges: usize) -> usize {
    let next = AtomicUsize::new(0);
    let read = || -> usize {
        std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed))
            .take_while(|&gauge| gauge < gauges)
            .map(|gauge| read_all(&mount.join(format!("BAT{gauge}"))))
            .sum()
    };
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..READERS.min(gauges)).map(|_| scope.spawn(read)).collect();
        readers.into_iter().map(|reader| reader.join().expect("a reader")).sum()
    })
}

/// A folder of this run.
fn folder() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("gaugefs-bench-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn main() -> ExitCode {
    if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
        println!("SKIPPED: /dev/fuse cannot be opened");
        return ExitCode::SUCCESS;
    }
    let mut report = Report::default();
    one(&mut report);
    whole(&mut report);
    report.finish()
}

fn one(report: &mut Report) {
    let daemon = Daemon::new(1, LONG);
    let files = read_all(&daemon.1.join("m"));
    let used = || Used::now(daemon.0.id());
    // What the reading has left to do, such as forgetting names, is over when nothing happens for a while.
    let begun = Instant::now();
    let mut before = used();
    loop {
        std::thread::sleep(SETTLE);
        let now = used();
        if now.since(&before).1 == 0 || begun.elapsed() > 10 * SETTLE {
            break;
        }
        before = now;
    }
    let before = used();
    std::thread::sleep(WINDOW);
    let after = used();
    let (mib, own) = (after.rss_kib as f64 / 1024.0, after.own_kib as f64 / 1024.0);
    let (_, wakeups) = after.since(&before);
    println!(
        "one gauge, {files} files read: {mib:.1} MiB resident, {own:.1} MiB of them its own, {wakeups} wake-ups in \
         {WINDOW:?} between polls"
    );
    report.row(
        "resident memory of the daemon, everything in its tree read",
        &format!("{mib:.1} MiB, {own:.1} MiB of them its own"),
        &format!("the limits: {MEMORY_MIB} and {OWN_MIB} MiB"),
    );
    report.row("wake-ups of the daemon between polls", &wakeups.to_string(), "");
    report.promise(files > 200, || format!("only {files} files of the tree could be read"));
    report.promise(mib <= MEMORY_MIB, || format!("{mib:.1} MiB resident; the limit is {MEMORY_MIB}"));
    report.promise(own <= OWN_MIB, || format!("{own:.1} MiB of its own; the limit is {OWN_MIB}"));
    report.promise(wakeups == 0, || format!("{wakeups} wake-ups between polls, not 0"));
}

/// Resident memory in KiB, percent of a processor, and wake-ups a second.
fn cost(pid: u32) -> [f64; 3] {
    std::thread::sleep(SETTLE);
    let (before, start) = (Used::now(pid), Instant::now());
    std::thread::sleep(WINDOW);
    let after = Used::now(pid);
    let ((ms, switches), seconds) = (after.since(&before), start.elapsed().as_secs_f64());
    [after.rss_kib as f64, ms / 10.0 / seconds, switches as f64 / seconds]
}

/// Many gauges polled every 3 s, before and after everything in their trees is read.
fn whole(report: &mut Report) {
    println!("\ngauges  files read  RSS MB   after  processor %   after  wake-ups/s   after");
    let mb = |kib: f64| kib * 1024.0 / 1e6;
    let mut one = None;
    for gauges in [1, 8, 64, 512] {
        let daemon = Daemon::new(gauges, "3.0");
        let [rss, busy, woken] = cost(daemon.0.id());
        let files = read_gauges(&daemon.1.join("m"), gauges);
        let [read_rss, read_busy, read_woken] = cost(daemon.0.id());
        println!(
            "{gauges:6}  {files:10}  {:6.1}  {:6.1}  {busy:11.2}  {read_busy:6.2}  {woken:10.1}  {read_woken:6.1}",
            mb(rss),
            mb(read_rss)
        );
        report
            .promise(files > 200 * gauges, || format!("only {files} files of {gauges} gauges could be read"));
        let first = *one.get_or_insert(read_rss);
        if gauges == 64 {
            let another = (read_rss - first) / 63.0;
            report.row(
                "resident memory of one gauge more, everything in its tree read",
                &format!("{another:.0} KiB"),
                &format!("the limit: {ANOTHER_KIB} KiB"),
            );
            report.promise(another <= ANOTHER_KIB, || {
                format!("{another:.1} KiB for one gauge more; the limit is {ANOTHER_KIB}")
            });
        }
        if gauges == 512 {
            let (most, busiest) = (mb(rss.max(read_rss)), busy.max(read_busy));
            report.promise(most <= ALL_MB, || format!("{most:.1} MB for {gauges}; the limit is {ALL_MB}"));
            report.promise(busiest <= ALL_PERCENT, || {
                format!("{busiest:.1} % of a processor for {gauges}; the limit is {ALL_PERCENT}")
            });
        }
        report.row(
            &format!("simulated gauges in one mount, {gauges} of them polled every 3 s"),
            &format!("{:.1} MB, {busy:.1} % of a processor, {woken:.0} wake-ups a second", mb(rss)),
            &format!(
                "everything in their trees read: {:.1} MB, {read_busy:.1} %, {read_woken:.0} wake-ups",
                mb(read_rss)
            ),
        );
    }
}
