// SPDX-License-Identifier: MIT

//! A mount of many days: a pack that is charged, rests, is discharged and learns; a write an hour; replugs, losses of
//! power in mid-write, a disturbed bus. What is shown stays what the gauge has, and the daemon does not grow.
//!
//! GAUGEFS_DAYS sets how many, GAUGEFS_SEED where the random numbers start.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use gauge_owner::Run;
use gaugefs::fs::Access;
use nix::errno::Errno;
use ti_gauge::chip::Chip;
use ti_gauge::journal::Journal;

use crate::rig::Random;
use crate::room::{Folder, Swift, can_mount};

const CHIP: &str = "bq34z100-g1";
const TICK: Duration = Duration::from_secs(600);
const TICKS_AN_HOUR: u64 = 6;
/// In the everyday test.
const DAYS: u64 = 1;
/// What is in use is measured anew from this day on.
const WARM: u64 = 1;
/// By how much the memory may differ between two days: what the allocator keeps is not the same each time.
const ROOM_KIB: u64 = 256;

/// Parameters, with and without a reset, and values of each.
const WRITTEN: &[(&str, &[&str])] = &[
    ("80/53", &["2900", "2950", "3000"]),
    ("58/3", &["0x11", "0x5a", "0x77"]),
    ("81/0", &["60", "61", "62"]),
    ("48/31", &["Pack 7", "Pack 8"]),
];

/// The current that is drawn at an hour of the day, in mA. The pack has 1000 mAh.
fn load(hour: u64) -> &'static str {
    match hour {
        0..6 => "-300",
        10..16 => "200",
        _ => "0",
    }
}

/// What this process has in use.
#[derive(Debug)]
struct Used {
    own_kib: u64,
    descriptors: usize,
    threads: usize,
}

impl Used {
    fn now() -> Self {
        let status = fs::read_to_string("/proc/self/status").expect("Linux");
        let own = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("a line of it");
        let own_kib =
            own.split_ascii_whitespace().next().and_then(|word| word.parse().ok()).expect("a number");
        let count = |folder: &str| fs::read_dir(folder).expect("Linux").count();
        Self { own_kib, descriptors: count("/proc/self/fd"), threads: count("/proc/self/task") }
    }
}

struct Days {
    seed: u64,
    random: Random,
    mount: Swift,
    journals: PathBuf,
    /// What each of [`WRITTEN`] may hold.
    values: Vec<BTreeSet<String>>,
    cycles: u64,
    counts: [u64; 5],
}

const WRITES: usize = 0;
const REFUSED: usize = 1;
const FAILED: usize = 2;
const REPLUGS: usize = 3;
const LOSSES: usize = 4;

impl Drop for Days {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.journals);
    }
}

impl Days {
    fn new(seed: u64) -> Self {
        let folder = Folder::new();
        // In memory if possible: each write is synced several times.
        let memory = Path::new("/dev/shm");
        let state = format!("gaugefs-days-{}-{seed}", std::process::id());
        let journals = if memory.is_dir() { memory.join(state) } else { PathBuf::from(folder.file("state")) };
        let journal = Journal::new(journals.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
        let run = Run { interval: TICK, journal: Some(journal), ..Run::default() };
        let chip = Chip::by_name(CHIP).expect("a chip of the tables");
        let (uid, gid) = (nix::unistd::geteuid().as_raw(), nix::unistd::getegid().as_raw());
        let access = Access { uid, gid, group: false };
        // A board that was calibrated, so that its pack can be told from others.
        let mount = Swift::new(chip, folder, run, access, |sim| sim.set_flash(104, 11, &[3]));
        let mut days = Self {
            seed,
            random: Random(seed),
            mount,
            journals,
            values: Vec::new(),
            cycles: 0,
            counts: [0; 5],
        };
        days.values = WRITTEN.iter().map(|(place, _)| [days.text(&format!("df/{place}"))].into()).collect();
        // It learns from now on.
        for (name, text) in [("seal", "unsealed"), ("control", "IT_ENABLE"), ("seal", "sealed")] {
            fs::write(days.mount.root.join("gauge").join(name), text).expect("it is safe");
        }
        days
    }

    fn text(&self, name: &str) -> String {
        let text = fs::read_to_string(self.mount.root.join(name));
        text.unwrap_or_else(|error| self.fail(&format!("{name}: {error}"))).trim_end().to_string()
    }

    #[track_caller]
    fn fail(&self, what: &str) -> ! {
        let error = self.mount.handle.published().last_error.clone();
        panic!(
            "GAUGEFS_SEED={}, at {:?}: {what}; gauge/last_error: {error}",
            self.seed,
            self.mount.clock.now()
        );
    }

    fn refresh(&self) -> std::io::Result<()> {
        fs::write(self.mount.root.join("gauge/refresh"), "1")
    }

    /// Lets a tick pass, and polls.
    fn tick(&self) -> std::io::Result<()> {
        self.mount.clock.sleep(TICK);
        self.refresh()
    }

    /// Everything is well again, and what is owed is paid.
    fn heal(&mut self) {
        self.mount.sim.set("fault", "none").expect("a knob");
        self.mount.sim.set("power", "on").expect("a knob");
        for attempt in 0.. {
            self.mount.clock.sleep(Duration::from_secs(31));
            let is_there = self.refresh().is_ok() && Path::exists(&self.mount.root.join("voltage_now"));
            if is_there && self.text("gauge/owed") == "0" && self.reads_back().is_ok() {
                break;
            }
            if attempt > 200 {
                self.fail("the gauge does not recover");
            }
        }
        // Where it was found open, its key has to be used once.
        for seal in ["sealed", "unsealed", "sealed"] {
            let sealed = fs::write(self.mount.root.join("gauge/seal"), seal);
            sealed.unwrap_or_else(|error| self.fail(&format!("{seal}: {error}")));
        }
    }

    /// Each parameter has a value that the answers allow.
    fn reads_back(&mut self) -> std::io::Result<()> {
        for (at, (place, _)) in WRITTEN.iter().enumerate() {
            let text = fs::read_to_string(self.mount.root.join("df").join(place))?.trim_end().to_string();
            if !self.values[at].contains(&text) {
                self.fail(&format!("{place} is {text}, not of {:?}", self.values[at]));
            }
            self.values[at] = [text].into();
        }
        Ok(())
    }

    fn write(&mut self, disturbed: bool) {
        let at = self.random.below(WRITTEN.len() as u64) as usize;
        let (place, texts) = WRITTEN[at];
        let text = *self.random.pick(texts);
        let is_low = self.word(0x08) < 2900;
        match fs::write(self.mount.root.join("df").join(place), text) {
            Ok(()) => {
                self.counts[WRITES] += 1;
                self.values[at] = [text.to_string()].into();
            }
            Err(error) => {
                let errno = Errno::from_raw(error.raw_os_error().unwrap_or_default());
                // It learns, or flash is shut.
                let is_refused = errno == Errno::EBUSY || errno == Errno::EAGAIN && is_low;
                if !disturbed && !is_refused {
                    self.fail(&format!("{place}: {error}"));
                }
                self.counts[if is_refused { REFUSED } else { FAILED }] += 1;
                if errno == Errno::ENOTRECOVERABLE {
                    self.values[at].insert(text.to_string());
                }
            }
        }
    }

    /// A register, past gaugefs.
    fn word(&self, code: u8) -> u64 {
        let mut bytes = [0; 2];
        // It may be without power.
        let _ = self.mount.sim.bus().transfer(&[code], &mut bytes);
        u16::from_le_bytes(bytes).into()
    }

    fn hour(&mut self, hour: u64) {
        self.mount.sim.set("load_ma", load(hour)).expect("a knob");
        let what = self.random.below(30);
        let number = 1 + self.random.below(40);
        let fault = match what {
            0 => Some(format!("torn-commit {}", self.random.below(17))),
            1 => Some(format!("power-cut {number} 3000")),
            2 => Some("random 20".into()),
            3 => Some(format!("silence {number} 40000")),
            4 => Some("off".into()),
            _ => None,
        };
        match &fault {
            Some(fault) if fault == "off" => {
                self.counts[REPLUGS] += 1;
                self.mount.sim.set("power", "off").expect("a knob");
            }
            Some(fault) => {
                self.counts[LOSSES] += u64::from(what < 2);
                self.mount.sim.set("fault", fault).expect("a fault");
            }
            None => {}
        }
        self.write(fault.is_some());
        for _ in 0..TICKS_AN_HOUR {
            if let (Err(error), None) = (self.tick(), &fault) {
                self.fail(&format!("refresh: {error}"));
            }
        }
        if fault.is_some() {
            self.heal();
        }
        self.compare();
    }

    /// What is shown is what the gauge has.
    fn compare(&mut self) {
        if let Err(error) = self.refresh().and_then(|()| self.reads_back()) {
            self.fail(&error.to_string());
        }
        for (name, code, unit) in
            [("voltage_now", 0x08, 1000), ("capacity", 0x02, 1), ("cycle_count", 0x2C, 1)]
        {
            let (shown, has) = (self.text(name).parse().unwrap_or(u64::MAX), self.word(code) * unit);
            let has = if code == 0x02 { has & 0xff } else { has };
            // The battery goes on between the poll and this.
            if shown.abs_diff(has) > 3 * unit {
                self.fail(&format!("{name} is {shown}, and the gauge has {has}"));
            }
        }
        let age: u64 = self.text("gauge/age_ms").parse().expect("a number");
        if age > 60_000 {
            self.fail(&format!("what is shown is {age} ms old"));
        }
        let cycles = self.text("cycle_count").parse().expect("a number");
        if cycles < self.cycles {
            self.fail(&format!("{} cycles, and then {cycles}", self.cycles));
        }
        self.cycles = cycles;
        let files = fs::read_dir(&self.journals).into_iter().flatten().flatten().map(|file| file.file_name());
        // Nothing is open in a spare one.
        let open = files.filter(|name| !name.to_string_lossy().ends_with(".spare")).count();
        if open > 0 {
            self.fail(&format!("{open} journals are left"));
        }
    }
}

#[test]
fn a_mount_of_many_days_does_not_drift_or_grow() {
    if !can_mount() {
        return;
    }
    let number = |name: &str, usual| {
        std::env::var(name).map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{name}: {text}")))
    };
    let (days, seed) = (number("GAUGEFS_DAYS", DAYS), number("GAUGEFS_SEED", 1));
    let (mut mount, start) = (Days::new(seed), Instant::now());
    let mut first: Option<Used> = None;
    for day in 0..days {
        (0..24).for_each(|hour| mount.hour(hour));
        let used = Used::now();
        match &first {
            None if day >= WARM.min(days / 3) => first = Some(used),
            // Other tests of the same process have threads and files of their own.
            Some(first) if std::env::var_os("NEXTEST").is_some() || days != DAYS => {
                let grows = used.own_kib > first.own_kib + ROOM_KIB;
                if grows || used.descriptors != first.descriptors || used.threads != first.threads {
                    mount.fail(&format!("day {day}: {used:?}, and at first {first:?}"));
                }
            }
            _ => {}
        }
    }
    let [writes, refused, failed, replugs, losses] = mount.counts;
    let status = mount.text("df/82/4");
    println!(
        "{days} days: {writes} writes, {refused} refused while the pack learned, {failed} failed and settled, {replugs} replugs, \
         {losses} losses of power in mid-write, {} cycles, Update Status {status}; {:?} at first, {:?} at last; {:.0} s",
        mount.cycles,
        first.unwrap_or_else(Used::now),
        Used::now(),
        start.elapsed().as_secs_f64()
    );
    assert!(writes > days && status != "0x00", "{writes} writes, Update Status {status}");
    assert!(days < 30 || status.ends_with('6'), "Update Status is {status} after {days} days");
}
