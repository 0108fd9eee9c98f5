// SPDX-License-Identifier: MIT

//! What it costs to read an attribute, compared with the kernel's own sysfs in the same run, and whether what
//! is read is right while it changes.
//!
//!     cargo bench --bench attributes
//!
//! Three parts:
//!
//! - **speed**: one operation is open, pread and close of one small file; only its ratio to others of the same run means
//!   something, and that to tmpfs is a promise. `GAUGEFS_BENCH_PEERS` adds files of other file systems: `NAME=PATH`, separated by
//!   colons. `GAUGEFS_BENCH_BEFORE` is the folder of a gauge that an older build has mounted.
//! - **traffic**: a thousand readers read every attribute, and the transfers on the bus are counted. There must
//!   be none.
//! - **exactness**: 16 threads read while a gauge is polled up to 200 times a second, each poll with another
//!   number in its registers. Every text must be exactly that of a poll that was current at some moment of the
//!   read. One that is torn, truncated, padded or stale is not.
//!
//! The gauge's clock runs 100 times as fast as the machine's. The program's own limit of two polls a second
//! then allows 200, and no value reaches its age limit while it is read.

#![allow(clippy::disallowed_methods, reason = "it reads what it has made, and /proc")]

use std::collections::HashMap;
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::{Bus, BusError};
use gauge_owner::{self as owner, Handle, Run, Signal};
use gauge_sim::{Options, Sim, SimBus};
use gaugefs::fs::{Access, Fs, Supply};
use gaugefs::fuse;
use ti_gauge::chip::{Chip, Register, Role};

mod report;
use report::Report;

const CHIP: &str = "bq34z100-g1";
const ROUNDS: usize = 200;
/// So few that some rounds pass without an interruption by other load.
const READS_A_ROUND: usize = 500;
/// Time of a read, that of the same read of a tmpfs being 1, at most, where the kernel keeps the names of files.
const OF_TMPFS: f64 = 1.5;
/// Files whose text the kernel does not keep.
const UNCACHED: [&str; 2] = ["gauge/flags", "df/80/53"];
const READERS: u64 = 16;
const READS: u64 = 1_000_000;
/// How much faster than the machine's clock the gauge's runs.
const FASTER: u32 = 100;
/// The longest interval that the program accepts: every poll after the second is asked for by the bench.
const INTERVAL: Duration = Duration::from_secs(3600);
/// Serial numbers repeat after so many polls, to fit the registers.
const SERIALS: u64 = 3000;

/// The machine's clock, sped up.
struct Fast(RealClock);

impl Clock for Fast {
    fn now(&self) -> Duration {
        self.0.now() * FASTER
    }

    fn sleep(&self, time: Duration) {
        self.0.sleep(time / FASTER);
    }
}

/// What a register holds for a serial number.
type Value = fn(i64) -> i64;

/// The attributes that carry the serial number.
const NUMBERED: &[(&str, Role, Value)] = &[
    ("voltage_now", Role::VoltageNow, |serial| 2000 + serial),
    ("charge_now", Role::ChargeNow, |serial| 1 + serial),
    ("current_now", Role::CurrentNow, |serial| -1 - serial),
];

/// A simulated gauge whose registers stay as they were first read, except those of [`NUMBERED`].
struct Numbered {
    bus: SimBus,
    first: HashMap<(u8, usize), Vec<u8>>,
    serial: Arc<AtomicU64>,
    registers: Vec<(&'static Register, Value)>,
}

impl Bus for Numbered {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.bus.transfer(write, read)?;
        // Control() is a conversation and not a register.
        let &[start @ 2..=u8::MAX] = write else { return Ok(()) };
        read.copy_from_slice(self.first.entry((start, read.len())).or_insert_with(|| read.to_vec()));
        let serial = (self.serial.load(Ordering::SeqCst) % SERIALS) as i64;
        for (register, value) in &self.registers {
            let at = register.source.command().and_then(|code| code.checked_sub(start)).map(usize::from);
            let Some(at) = at else { continue };
            let size = usize::from(register.size);
            if let Some(bytes) = read.get_mut(at..at + size) {
                bytes.copy_from_slice(&value(serial).to_le_bytes()[..size]);
            }
        }
        Ok(())
    }
}

/// A gauge mounted for the bench.
struct Bench {
    folder: PathBuf,
    handle: Handle,
    serial: Arc<AtomicU64>,
    mounted: Option<fuse::Mounted>,
}

impl Bench {
    fn new() -> Self {
        let clock = Arc::new(Fast(RealClock::new()));
        let sim = Sim::new(CHIP, &Options::default(), clock.clone()).expect("a simulated gauge");
        // It measures nothing in its first second.
        clock.sleep(Duration::from_secs(2));
        let chip = Chip::by_name(CHIP).expect("a table");
        let serial = Arc::new(AtomicU64::new(0));
        let registers =
            NUMBERED.iter().map(|&(_, role, value)| (chip.register(role).expect("a register"), value));
        let bus = Numbered {
            bus: sim.bus(),
            first: HashMap::new(),
            serial: serial.clone(),
            registers: registers.collect(),
        };
        let signal = Arc::new(Signal::default());
        let run = Run { interval: INTERVAL, ..Run::default() };
        let handle = owner::spawn(chip, Box::new(bus), clock, run, signal.clone()).expect("a gauge");
        let folder = std::env::temp_dir().join(format!("gaugefs-bench-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let entry = Supply::new("BAT0".into(), handle.clone());
        let tree = Fs::new(vec![entry], Access { uid: 0, gid: 0, group: false });
        let mounted =
            fuse::mount(Arc::new(tree), &folder, fuse::Options::default(), signal).expect("a mount");
        // The second poll follows the first on its own, half a second later.
        std::thread::sleep(Duration::from_secs(1));
        Self { folder, handle, serial, mounted: Some(mounted) }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join("BAT0").join(name)
    }

    fn statistic(&self, wanted: &str) -> u64 {
        let list = self.handle.statistics();
        list.iter().find(|(name, _)| *name == wanted).expect("a statistic of that name").1
    }

    /// Has the gauge polled, and returns when readers see the new values.
    fn refresh(&self) {
        fs::write(self.file("gauge/refresh"), "1").expect("a poll");
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.mounted.take());
        let _ = nix::mount::umount2(&self.folder, nix::mount::MntFlags::MNT_DETACH);
        let _ = fs::remove_dir(&self.folder);
    }
}

fn main() -> ExitCode {
    if File::options().read(true).write(true).open("/dev/fuse").is_err() {
        println!("SKIPPED: /dev/fuse cannot be opened");
        return ExitCode::SUCCESS;
    }
    let (bench, mut report) = (Bench::new(), Report::default());
    speed(&bench, &mut report);
    traffic(&bench, &mut report);
    exactness(&bench, &mut report);
    drop(bench);
    report.finish()
}

fn read(path: &Path, buffer: &mut [u8; 4096]) -> std::io::Result<usize> {
    File::open(path)?.read_at(buffer, 0)
}

fn speed(bench: &Bench, report: &mut Report) {
    let tmpfs = PathBuf::from(format!("/dev/shm/gaugefs-bench-{}", std::process::id()));
    let _ = fs::write(&tmpfs, "62\n");
    let peers = std::env::var("GAUGEFS_BENCH_PEERS").unwrap_or_default();
    let mut files = vec![
        ("sysfs", PathBuf::from("/sys/devices/system/cpu/online")),
        ("gaugefs", bench.file("capacity")),
        ("tmpfs", tmpfs.clone()),
    ];
    files.extend(
        peers.split(':').filter_map(|peer| peer.split_once('=')).map(|(name, path)| (name, path.into())),
    );
    let attributes = files.len();
    let before = std::env::var_os("GAUGEFS_BENCH_BEFORE").map(PathBuf::from);
    for folder in [Some(bench.file("")), before].into_iter().flatten() {
        files.extend(UNCACHED.map(|name| (name, folder.join(name))));
    }
    let round = |path: &Path| {
        let mut buffer = [0; 4096];
        let start = Instant::now();
        for _ in 0..READS_A_ROUND {
            std::hint::black_box(read(path, &mut buffer).expect("a file that can be read"));
        }
        start.elapsed() / READS_A_ROUND as u32
    };
    // Interleaved, and the fastest round of each, so that other load on the machine matters least.
    let mut fastest = vec![Duration::MAX; files.len()];
    for _ in 0..ROUNDS {
        for (fastest, (_, path)) in fastest.iter_mut().zip(&files) {
            *fastest = round(path).min(*fastest);
        }
    }
    let ns: Vec<_> = fastest.iter().map(|time| time.as_nanos() as f64).collect();
    println!("open + pread + close      ns   of sysfs");
    for ((name, _), time) in files.iter().zip(&ns) {
        println!("{name:20} {time:7.0}   {:8.2}", time / ns[0]);
    }
    let others = files[..attributes].iter().zip(&ns).skip(2);
    let others: Vec<_> = others.map(|((name, _), time)| format!("{name} {:.2}", time / ns[0])).collect();
    report.row(
        "time to read an attribute again (open, pread, close), sysfs in the same run being 1 (Linux 6.16 or later)",
        &format!("{:.2}", ns[1] / ns[0]),
        &others.join(", "),
    );
    let uncached: Vec<_> = ns[attributes..].iter().map(|time| format!("{:.1}", time / ns[0])).collect();
    let of = uncached.chunks(UNCACHED.len()).map(|build| build.join("; ")).collect::<Vec<_>>();
    report.row(
        &format!("time to read {}, sysfs in the same run being 1", UNCACHED.join("; ")),
        &of[0],
        &format!("before: {}; the target: 8", of.get(1).map_or("not measured", String::as_str)),
    );
    let of_tmpfs = ns[1] / ns[2];
    report.row(
        "the same, tmpfs in the same run being 1",
        &format!("{of_tmpfs:.2}"),
        &format!("the limit: {OF_TMPFS} (Linux 6.16 or later)"),
    );
    // Before that the kernel sends a message for each open.
    if keeps_names() {
        report.promise(of_tmpfs <= OF_TMPFS, || {
            format!("a read takes {of_tmpfs:.2} of the time of tmpfs; the limit is {OF_TMPFS}")
        });
    }
    let _ = fs::remove_file(tmpfs);
}

/// Whether this kernel has the notification without which it may keep no names.
fn keeps_names() -> bool {
    let release = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let mut numbers = release.split(['.', '-']).map_while(|number| number.parse::<u32>().ok());
    (numbers.next(), numbers.next()) >= (Some(6), Some(16))
}

fn traffic(bench: &Bench, report: &mut Report) {
    let folder = fs::read_dir(bench.file("")).expect("the gauge's folder").flatten();
    let files = folder.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
    let files: Arc<[PathBuf]> = files.map(|entry| entry.path()).collect();
    let before = bench.statistic("transfers");
    let reader = |_| {
        let files = files.clone();
        std::thread::Builder::new().stack_size(64 * 1024).spawn(move || {
            for path in &*files {
                read(path, &mut [0; 4096]).expect("an attribute that can be read");
            }
        })
    };
    for thread in (0..1000).map(reader).collect::<Vec<_>>() {
        thread.expect("a thread").join().expect("a reader");
    }
    let transfers = bench.statistic("transfers") - before;
    println!("\ntransfers for 1000 readers of {} files: {transfers}", files.len());
    report.row("bus transfers for 1000 readers of all attributes", &transfers.to_string(), "");
    report.promise(transfers == 0, || format!("1000 readers caused {transfers} transfers, not 0"));
}

/// What readers have found.
#[derive(Default)]
struct Found {
    wrong: AtomicU64,
    changes: AtomicU64,
    /// Polls that have begun, and those whose values every reader sees: the numbers of the last of each.
    begun: AtomicU64,
    shown: AtomicU64,
}

fn exactness(bench: &Bench, report: &mut Report) {
    let (found, texts) = (Found::default(), Texts::new(bench));
    let before = bench.statistic("polls");
    let start = Instant::now();
    std::thread::scope(|scope| {
        let reader = |reader| {
            let name = Texts::NAMES[reader as usize % Texts::NAMES.len()];
            let path = bench.file(name);
            let (found, texts) = (&found, &texts);
            scope.spawn(move || {
                let mut buffer = [0; 4096];
                let mut last = Vec::new();
                for _ in 0..READS / READERS {
                    let oldest = found.shown.load(Ordering::SeqCst);
                    let length = read(&path, &mut buffer);
                    let newest = found.begun.load(Ordering::SeqCst);
                    let text = length.as_ref().map_or(&[][..], |&length| &buffer[..length]);
                    // The newest first: most reads find it.
                    if !(oldest..=newest).rev().any(|poll| texts.is(name, poll, text))
                        && found.wrong.fetch_add(1, Ordering::Relaxed) == 0
                    {
                        let text = length.map(|_| String::from_utf8_lossy(text));
                        eprintln!("first wrong text: {name}, polls {oldest} to {newest}: {text:?}");
                    }
                    if text != last {
                        found.changes.fetch_add(1, Ordering::Relaxed);
                        last = text.to_vec();
                    }
                }
            })
        };
        let readers: Vec<_> = (0..READERS).map(reader).collect();
        for poll in 1.. {
            found.begun.store(poll, Ordering::SeqCst);
            bench.serial.store(poll, Ordering::SeqCst);
            bench.refresh();
            found.shown.store(poll, Ordering::SeqCst);
            if readers.iter().all(|reader| reader.is_finished()) {
                break;
            }
        }
    });
    let seconds = start.elapsed().as_secs_f64();
    let polls = bench.statistic("polls") - before;
    let Found { wrong, changes, .. } = found;
    let (wrong, changes) = (wrong.into_inner(), changes.into_inner());
    println!(
        "\n{READS} reads by {READERS} readers in {seconds:.1} s, {:.0} polls a second, {changes} changes seen: \
         {wrong} wrong",
        polls as f64 / seconds
    );
    report.row(
        "wrong texts in a million reads by 16 readers while values change",
        &format!("{wrong}, {:.0} polls a second", polls as f64 / seconds),
        "",
    );
    report.promise(wrong == 0, || format!("{wrong} of {READS} texts were wrong, not 0"));
    report.promise(changes > READERS, || "the values did not change, so nothing was shown".to_string());
}

/// The exact text of each file for each poll.
struct Texts {
    /// The lines of the uevent; those of [`NUMBERED`] are replaced.
    uevent: String,
}

impl Texts {
    const NAMES: [&str; 4] = ["voltage_now", "charge_now", "current_now", "uevent"];

    /// From the uevent of a first poll, before anything changes.
    fn new(bench: &Bench) -> Self {
        let uevent = fs::read_to_string(bench.file("uevent")).expect("a uevent");
        for (name, ..) in NUMBERED {
            assert_eq!(uevent.matches(&key(name)).count(), 1, "one {name} in {uevent}");
        }
        Self { uevent }
    }

    fn is(&self, name: &str, poll: u64, text: &[u8]) -> bool {
        // The kernel counts in millionths, the gauge in thousandths.
        let millionths = |value: Value| value((poll % SERIALS) as i64) * 1000;
        match NUMBERED.iter().find(|(numbered, ..)| *numbered == name) {
            Some((_, _, value)) => text == format!("{}\n", millionths(*value)).as_bytes(),
            None => {
                let mut expected = String::with_capacity(self.uevent.len() + 16);
                for line in self.uevent.lines() {
                    let numbered = NUMBERED.iter().find(|(name, ..)| line.starts_with(&key(name)));
                    match numbered {
                        Some((name, _, value)) => {
                            expected += &format!("{}{}\n", key(name), millionths(*value));
                        }
                        None => {
                            expected += line;
                            expected.push('\n');
                        }
                    }
                }
                text == expected.as_bytes()
            }
        }
    }
}

/// What a uevent's line of an attribute begins with.
fn key(name: &str) -> String {
    format!("POWER_SUPPLY_{}=", name.to_uppercase())
}
