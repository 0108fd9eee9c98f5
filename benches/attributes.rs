//! What it costs to read an attribute, beside the kernel's own sysfs in the same run, and whether what is
//! read is right while it changes.
//!
//!     cargo bench --bench attributes
//!
//! One operation is open, pread and close of one small file. Figures are medians; what counts is the ratio.
//! The second part polls a simulated gauge a hundred times a second while 16 threads read, and counts texts
//! that no poll can have given.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use gauge_bus::clock::RealClock;
use gaugefs::fs::{Access, Fs, MountedGauge, Scales};
use gaugefs::fuse;
use gaugefs::owner::{self, Handle, Settings, Signal};
use gaugefs::sim::{Options, Sim};
use ti_gauge::chip::Chip;

const ROUNDS: usize = 20;
const A_ROUND: usize = 5_000;
const READERS: u64 = 16;
const READS: u64 = 1_000_000;

fn read(path: &Path, buffer: &mut [u8; 4096]) -> usize {
    let file = File::open(path).expect("opens");
    file.read_at(buffer, 0).expect("reads")
}

fn round(path: &Path) -> Duration {
    let mut buffer = [0; 4096];
    let start = Instant::now();
    for _ in 0..A_ROUND {
        std::hint::black_box(read(path, &mut buffer));
    }
    start.elapsed() / A_ROUND as u32
}

fn gauge(interval: Duration) -> (Sim, Handle, Arc<Signal>) {
    let clock = Arc::new(RealClock::new());
    let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a simulated gauge");
    std::thread::sleep(Duration::from_millis(1300));
    let signal = Arc::new(Signal::default());
    let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
    let settings = Settings { interval, ..Settings::default() };
    let handle = owner::spawn(chip, Box::new(sim.bus()), clock, settings, signal.clone()).expect("a gauge");
    (sim, handle, signal)
}

fn mount(folder: &Path, handle: Handle, signal: Arc<Signal>) -> fuse::Mounted {
    fs::create_dir_all(folder).expect("a folder");
    let entry = MountedGauge { name: "BAT0".into(), handle, scales: Scales::default(), knobs: None };
    let tree = Fs::new(vec![entry], Access { uid: 0, gid: 0, group: false });
    fuse::mount(Arc::new(tree), folder, fuse::Options::default(), signal).expect("a mount")
}

fn main() {
    if File::options().read(true).write(true).open("/dev/fuse").is_err() {
        println!("SKIPPED: /dev/fuse cannot be opened");
        return;
    }
    let folder = std::env::temp_dir().join(format!("gaugefs-bench-{}", std::process::id()));
    let (sim, handle, signal) = gauge(Duration::from_secs(30));
    let mounted = mount(&folder, handle.clone(), signal);
    speed(&folder);
    traffic(&folder, &handle);
    drop((mounted, sim, handle));
    let _ = nix::mount::umount2(&folder, nix::mount::MntFlags::MNT_DETACH);

    let (sim, handle, signal) = gauge(Duration::from_millis(5));
    let mounted = mount(&folder, handle.clone(), signal);
    exactness(&folder, &sim, &handle);
    drop((mounted, sim, handle));
    let _ = nix::mount::umount2(&folder, nix::mount::MntFlags::MNT_DETACH);
    let _ = fs::remove_dir(&folder);
}

fn speed(folder: &Path) {
    let shm = PathBuf::from("/dev/shm/gaugefs-bench");
    let _ = fs::write(&shm, "62\n");
    let candidates = [
        ("sysfs, cpu/online", PathBuf::from("/sys/devices/system/cpu/online")),
        ("sysfs, net/lo/mtu", PathBuf::from("/sys/class/net/lo/mtu")),
        ("tmpfs", shm.clone()),
        ("lxcfs, proc/uptime", PathBuf::from("/var/lib/lxcfs/proc/uptime")),
        ("gaugefs, capacity", folder.join("BAT0/capacity")),
    ];
    let there: Vec<_> = candidates.into_iter().filter(|(_, path)| path.exists()).collect();
    // Interleaved, so that whatever else the machine does falls on all.
    let mut times = vec![Vec::new(); there.len()];
    for _ in 0..ROUNDS {
        for (times, (_, path)) in times.iter_mut().zip(&there) {
            times.push(round(path));
        }
    }
    let median = |times: &mut Vec<Duration>| {
        times.sort();
        times[times.len() / 2].as_nanos() as f64
    };
    let medians: Vec<f64> = times.iter_mut().map(median).collect();
    println!("open + pread + close        ns   of sysfs");
    for ((name, _), ns) in there.iter().zip(&medians) {
        println!("{name:24} {ns:7.0}   {:5.2}", ns / medians[0]);
    }
    let _ = fs::remove_file(shm);
}

fn statistic(handle: &Handle, wanted: &str) -> u64 {
    handle.statistics().iter().find(|(name, _)| *name == wanted).expect("it is counted").1
}

fn traffic(folder: &Path, handle: &Handle) {
    let before = statistic(handle, "transfers");
    let reader = |_| {
        let path = folder.join("BAT0/voltage_now");
        std::thread::Builder::new().stack_size(64 * 1024).spawn(move || read(&path, &mut [0; 4096]))
    };
    for thread in (0..1000).map(reader).collect::<Vec<_>>() {
        thread.expect("a thread").join().expect("a reader");
    }
    println!("\ntransfers for 1000 readers: {}", statistic(handle, "transfers") - before);
}

fn exactness(folder: &Path, sim: &Sim, handle: &Handle) {
    sim.set("speed", "60").expect("a knob");
    sim.set("load_ma", "700").expect("a knob");
    let before = statistic(handle, "polls");
    let (wrong, changes) = (AtomicU64::new(0), AtomicU64::new(0));
    let start = Instant::now();
    std::thread::scope(|scope| {
        for reader in 0..READERS {
            let name = ["voltage_now", "charge_now", "current_now", "uevent"][reader as usize % 4];
            let path = folder.join("BAT0").join(name);
            let (wrong, changes) = (&wrong, &changes);
            scope.spawn(move || {
                let mut buffer = [0; 4096];
                let mut last = Vec::new();
                for _ in 0..READS / READERS {
                    let length = read(&path, &mut buffer);
                    let text = &buffer[..length];
                    if !is_whole(name, text) {
                        wrong.fetch_add(1, Ordering::Relaxed);
                    }
                    if text != last {
                        changes.fetch_add(1, Ordering::Relaxed);
                        last = text.to_vec();
                    }
                }
            });
        }
    });
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "\n{READS} reads by {READERS} readers in {seconds:.1} s, {:.0} polls a second, {} changes seen: {} wrong",
        (statistic(handle, "polls") - before) as f64 / seconds,
        changes.load(Ordering::Relaxed),
        wrong.load(Ordering::Relaxed)
    );
}

/// Whether a poll can have given that text, whole: nothing cut off, no padding.
fn is_whole(name: &str, text: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(text) else { return false };
    let Some(text) = text.strip_suffix('\n') else { return false };
    let number = |text: &str| text.parse::<i64>().ok();
    match name {
        "uevent" => {
            text.starts_with("POWER_SUPPLY_NAME=BAT0\n")
                && text.ends_with("POWER_SUPPLY_MODEL_NAME=bq34z100-G1")
                && text.lines().all(|line| line.starts_with("POWER_SUPPLY_") && line.contains('='))
        }
        "voltage_now" => number(text).is_some_and(|value| (2_000_000..5_000_000).contains(&value)),
        "current_now" => number(text).is_some_and(|value| (-2_000_000..1).contains(&value)),
        _ => number(text).is_some_and(|value| (0..2_000_000).contains(&value) && value % 1000 == 0),
    }
}
