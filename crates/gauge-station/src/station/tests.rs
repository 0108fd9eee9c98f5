// SPDX-License-Identifier: MIT

//! Stations with simulated packs.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use std::{fs, io};

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError, Reach};
use gauge_sim::{Sim, SimBus};
use sha2::{Digest, Sha256};
use ti_gauge::chip::{Chip, Kind};
use ti_gauge::dataflash::Change;
use ti_gauge::image::{Image, toml};
use ti_gauge::journal::{Disk, File, Host, Journal, Trusted};
use ti_gauge::value::Value;
use ti_gauge::{codec, text};

use super::record::{Entry, Event};
use super::target::Flash;
use super::{Bench, Plan, STEADY, Scanner, Screen, Slot, Station, serial, take};
use crate::error::Result;
use crate::options::Options;
use crate::setup::Setup;
use gauge_owner::{Direct, GaugeOptions, Run, Seal, operations as op};
use ti_gauge::notation;

mod asked;
mod attacks;
mod keys;
mod mux;
mod numbers;
mod protector;
mod recorded;
mod waits;

/// A station's folder, which is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gaugefs-program-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// The station of a file with these lines, and an image of other values than a new pack has.
    fn plan(&self, lines: &str) -> Plan {
        self.try_plan(lines).unwrap_or_else(|error| panic!("{error}"))
    }

    fn try_plan(&self, lines: &str) -> Result<Plan> {
        self.try_plan_of(CHIP, lines)
    }

    fn try_plan_of(&self, chip: &str, lines: &str) -> Result<Plan> {
        let text = format!("no-backup = true\nstate-dir = 'journals'\n{lines}\n");
        let mut options: Options = ::toml::from_str(&text).expect("options");
        let Options { record, images, state_dir, serial_list, new_key_file, .. } = &mut options;
        let paths = [record, images, state_dir, serial_list, new_key_file].into_iter().flatten();
        paths.for_each(|path| *path = self.0.join(&*path));
        let image = self.file("golden.toml");
        if !image.exists() {
            fs::write(&image, golden()).expect("a file");
        }
        let gauges = vec![("BAT0".into(), simulated(chip))];
        Plan::read(&image, Setup::new(&self.file("line1.toml"), options, gauges))
    }

    fn lines(&self) -> Vec<Entry> {
        let text = fs::read_to_string(self.file("line1.jsonl")).expect("a record");
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn simulated(chip: &str) -> GaugeOptions {
    let chip = Chip::by_name(chip).expect("it has a table");
    GaugeOptions { sim: Some(chip), ..GaugeOptions::default() }
}

const CHIP: &str = "bq34z100-g1";
/// The name of the journal.
const KEY: &str = "i2c-1-55";
/// Learned values are the gauge's own.
const PLAIN: &str =
    "exclude = ['calibration', 'serial', 'learned', 'keys']\nserial = 'counter'\nfirst-serial = 1000";

/// Values that a new pack does not have.
const OTHERS: [(&str, &str); 5] =
    [("48/11", "2200"), ("80/53", "3100"), ("48/32", "golden pack"), ("49/0", "70"), ("64/0", "0x0171")];

/// An image of a new pack with some other values.
fn golden() -> String {
    let chip = Chip::by_name(CHIP).expect("it has a table");
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(CHIP, &gauge_sim::Options::default(), clock.clone()).expect("it is simulated");
    clock.sleep(Duration::from_secs(2));
    let mut gauge = opened(&sim, &clock, Run::default());
    let mut image = Flash::read(&mut gauge).expect("the default key").image();
    for (place, text) in OTHERS {
        let (id, offset) = place.split_once('/').expect("a place");
        let Some(row) = chip.row(id, offset) else { continue };
        if let Ok(value) = notation::parse(row.1, text.as_bytes()) {
            image.set(row.0, row.1, value);
        }
    }
    // In the table's order.
    Image::parse(&toml::write(&image), None).map(|image| toml::write(&image)).expect("an image")
}

/// A pack's gauge, asked past any station.
fn opened(sim: &Sim, clock: &Arc<SimClock>, run: Run) -> Direct {
    let chip = Chip::by_name(CHIP).expect("it has a table");
    let mut gauge = Direct::new(chip, Box::new(sim.bus()), clock.clone(), run);
    gauge.open().expect("it answers");
    gauge
}

/// The power of the station's computer: after that many calls and transfers nothing that it does has an effect.
#[derive(Debug, Default)]
struct Power {
    done: AtomicU64,
    cut: Option<u64>,
    disk_is_full: AtomicBool,
    /// How often the record cannot be synced after the line `pass`, once there is such a line.
    unsynced: AtomicU64,
    has_pass: AtomicBool,
}

impl Power {
    fn is_on(&self) -> bool {
        let number = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        self.cut.is_none_or(|cut| number < cut)
    }

    fn call<T>(&self, work: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
        if self.is_on() { work() } else { Err(io::Error::other("no power")) }
    }
}

struct Powered(SimBus, Arc<Power>);

impl Bus for Powered {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        if self.1.is_on() { self.0.transfer(write, read) } else { Err(BusError::NoAck) }
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.0)
    }
}

/// The disk of that computer. It does not sync, which takes time; a line that is being written when the power is lost
/// is cut short.
#[derive(Clone, Debug)]
struct Memory(Arc<Power>);

#[derive(Debug)]
struct Opened(Box<dyn File>, Arc<Power>);

impl Disk for Memory {
    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        self.0.call(|| Host.create_folder(folder))
    }

    fn exists(&self, path: &Path) -> bool {
        Host.exists(path)
    }

    fn read(&self, path: &Path) -> io::Result<String> {
        Host.read(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.0.call(|| Ok(Box::new(Opened(Host.create(path)?, self.0.clone())) as Box<dyn File>))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.0.call(|| Ok(Box::new(Opened(Host.open(path)?, self.0.clone())) as Box<dyn File>))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.0.call(|| Host.rename(from, to))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.0.call(|| Host.rename_new(from, to))
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        Host.list(folder)
    }

    fn is_locked(&self, path: &Path) -> io::Result<bool> {
        Host.is_locked(path)
    }

    fn check(&self, path: &Path, trusted: Trusted) -> io::Result<()> {
        Host.check(path, trusted)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.0.call(|| Host.remove(path))
    }

    fn sync(&self, _: &Path) -> io::Result<()> {
        self.0.call(|| Ok(()))
    }
}

impl File for Opened {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let had_power = self.1.cut.is_none_or(|cut| self.1.done.load(Ordering::SeqCst) + 1 < cut);
        let at_cut = self.1.cut == Some(self.1.done.load(Ordering::SeqCst) + 1);
        if at_cut && !had_power {
            let part = self.1.done.load(Ordering::SeqCst) as usize % bytes.len().max(1);
            let _ = self.0.append(&bytes[..part]);
        }
        if bytes.windows(14).any(|part| part == b"\"event\":\"pass\"") {
            self.1.has_pass.store(true, Ordering::SeqCst);
        }
        self.1.call(|| self.0.append(bytes))
    }

    fn reserve(&mut self, _: u64) -> io::Result<()> {
        match self.1.disk_is_full.load(Ordering::SeqCst) {
            true => Err(io::ErrorKind::StorageFull.into()),
            false => self.1.call(|| Ok(())),
        }
    }

    fn sync(&mut self) -> io::Result<()> {
        if self.1.has_pass.load(Ordering::SeqCst) && take(&self.1.unsynced) {
            return Err(io::Error::from_raw_os_error(nix::libc::EIO));
        }
        self.1.call(|| Ok(()))
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.1.call(|| self.0.truncate(length))
    }

    fn lock(&mut self) -> io::Result<bool> {
        self.0.lock()
    }
}

/// Simulated packs, each with the fault that it gets when it is connected.
struct Rack {
    clock: Arc<SimClock>,
    power: Arc<Power>,
    packs: VecDeque<(Sim, String)>,
    now: Option<Sim>,
    looks: u32,
}

impl Rack {
    fn new(
        clock: &Arc<SimClock>,
        power: &Arc<Power>,
        packs: impl IntoIterator<Item = (Sim, String)>,
    ) -> Self {
        let packs = packs.into_iter().collect();
        Self { clock: clock.clone(), power: power.clone(), packs, now: None, looks: STEADY }
    }
}

impl Slot for Rack {
    fn clock(&self) -> Arc<dyn Clock> {
        self.clock.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        let sim = self.now.as_ref().expect("a pack is there");
        Box::new(Powered(sim.bus(), self.power.clone()))
    }

    fn is_there(&mut self) -> Option<bool> {
        if self.now.is_some() {
            return Some(true);
        }
        self.looks += 1;
        if self.looks <= STEADY {
            return Some(false);
        }
        let (sim, fault) = self.packs.pop_front()?;
        // From the power-up until it has measured.
        self.clock.sleep(Duration::from_secs(3));
        sim.set("fault", &fault).unwrap_or_else(|error| panic!("{fault}: {error}"));
        self.now = Some(sim);
        Some(true)
    }

    fn done(&mut self) {
        (self.now, self.looks) = (None, 0);
    }
}

#[derive(Clone, Default)]
struct Said(Arc<Mutex<Vec<String>>>);

impl Said {
    fn all(&self) -> Vec<String> {
        self.0.lock().expect("nobody panics").clone()
    }
}

impl Screen for Said {
    fn outcome(&self, line: &str) {
        self.0.lock().expect("nobody panics").push(line.into());
    }

    fn prompt(&self, line: &str) {
        self.0.lock().expect("nobody panics").push(format!("? {line}"));
    }
}

struct Lines(VecDeque<String>);

impl Lines {
    fn of(lines: &[&str]) -> Box<Self> {
        Box::new(Self(lines.iter().map(ToString::to_string).collect()))
    }
}

impl Scanner for Lines {
    fn line(&mut self, _: &str) -> Option<String> {
        self.0.pop_front()
    }
}

/// A station and what it says.
struct Line {
    station: Station,
    bench: Bench,
    said: Said,
    power: Arc<Power>,
}

impl Line {
    fn start(plan: Plan, typed: &[&str], cut: Option<u64>) -> Result<Self> {
        let said = Said::default();
        let power = Arc::new(Power { cut, ..Power::default() });
        let bench = plan.bench(0, "i2c-1 address 0x55".into(), Reach::FULL, Some(KEY.into()))?;
        let disk = Arc::new(Memory(power.clone()));
        let stops = Arc::new(AtomicBool::new(false));
        let station = Station::start(plan, disk, Box::new(said.clone()), Lines::of(typed), None, stops)?;
        station.close_unfinished(&[&bench])?;
        Ok(Self { station, bench, said, power })
    }

    /// Programs packs one after the other.
    fn run(&self, clock: &Arc<SimClock>, packs: impl IntoIterator<Item = (Sim, String)>) -> Vec<String> {
        let mut rack = Rack::new(clock, &self.power, packs);
        self.station.run(&self.bench, &mut rack);
        self.said.all().into_iter().filter(|line| !line.starts_with('?')).collect()
    }
}

fn new_pack(clock: &Arc<SimClock>, seed: u64, envelope: Option<u64>) -> Sim {
    let options = gauge_sim::Options { seed, envelope, ..gauge_sim::Options::default() };
    Sim::new(CHIP, &options, clock.clone()).expect("it is simulated")
}

/// What every byte of a pack's flash is, found by changing it: what is asked for it, that the gauge may rewrite it, or
/// neither. Nothing of the station is used.
struct Map {
    asked: BTreeMap<usize, u8>,
    free: BTreeSet<usize>,
}

impl Map {
    fn of(plan: &Plan) -> Self {
        let chip = plan.chip();
        let sim = new_pack(&Arc::new(SimClock::new()), 1, None);
        let place = |id: u8, offset: u16| {
            let before = sim.flash();
            for probe in [0x00, 0xa5] {
                sim.set_flash(id.into(), offset.into(), &[probe]);
                let after = sim.flash();
                if let Some(at) = (0..before.len()).find(|&at| before[at] != after[at]) {
                    return at;
                }
            }
            panic!("{id}/{offset} is not in flash")
        };
        let (mut asked, mut free) = (BTreeMap::new(), BTreeSet::new());
        for subclass in chip.subclasses {
            for row in subclass.parameters.iter().filter(|row| row.learned || subclass.kind == Kind::Security)
            {
                free.extend((row.offset..).take(row.kind.size()).map(|offset| place(subclass.id, offset)));
            }
        }
        for entry in &plan.image.entries {
            let bytes = codec::Layout::TI.encode(entry.parameter.kind, &entry.value).expect("it fits");
            for (offset, byte) in (entry.parameter.offset..).zip(bytes) {
                asked.insert(place(entry.subclass.id, offset), byte);
            }
        }
        Self { asked, free }
    }

    /// The serial number's bytes.
    fn serial(&self, sim: &Sim) -> (usize, [u8; 2]) {
        let chip = Chip::by_name(CHIP).expect("it has a table");
        let (subclass, row) = serial::called(chip, "Serial Number").expect("it has one");
        let (before, other) = (sim.flash(), new_pack(&Arc::new(SimClock::new()), 1, None));
        let old = other.flash();
        other.set_flash(subclass.id.into(), row.offset.into(), &[0xa5]);
        let at = (0..old.len()).find(|&at| old[at] != other.flash()[at]).expect("it has changed");
        (at, [before[at], before[at + 1]])
    }

    /// Compares the flash of a pack that has passed with what was asked, to the bit, and the rest with what it was.
    fn check(&self, sim: &Sim, before: &[u8], serial: &str, at: &str) {
        let (serial_at, stored) = self.serial(sim);
        let number: u16 = text::unsigned(serial).expect("a number");
        assert_eq!(u16::from_be_bytes(stored), number, "{at}: another serial number");
        for (index, &byte) in sim.flash().iter().enumerate() {
            match self.asked.get(&index) {
                Some(&asked) => assert_eq!(byte, asked, "{at}: byte {index}"),
                None if self.free.contains(&index) || (serial_at..serial_at + 2).contains(&index) => {}
                None => assert_eq!(byte, before[index], "{at}: byte {index}, which nobody has asked for"),
            }
        }
        assert_eq!(sim.get("seal").as_deref(), Some("sealed"), "{at}");
        assert_eq!(sim.get("mode").as_deref(), Some("normal"), "{at}");
    }
}

/// xorshift64
struct Drawn(u64);

impl Drawn {
    fn new(seed: u64) -> Self {
        Self((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn below(&mut self, end: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % end
    }
}

/// What goes wrong with a pack.
fn fault(seed: u64) -> String {
    let mut drawn = Drawn::new(seed);
    let at = drawn.below(900) + 1;
    match drawn.below(14) {
        0 => "none".into(),
        1..=3 => format!("random {}", drawn.below(12) + 1),
        4 => format!("silence {at} 900000"),
        5 => format!("silence {at} {}", drawn.below(4000)),
        6 => format!("power-cut {at} {}", drawn.below(3000) + 100),
        7 => format!("power-cut-after {at} {}", drawn.below(3000) + 100),
        8 => "drop-commit".into(),
        9 => "corrupt-commit".into(),
        10 => format!("torn-commit {}", drawn.below(16)),
        11 => format!("flip {at} {} {}", drawn.below(8), drawn.below(8)),
        12 => format!("burst {at} 0 32 255"),
        _ => ["drop-seal", "drop-reset", "drop-key"][drawn.below(3) as usize].into(),
    }
}

/// Every pack that was begun has an outcome, and no two that were begun share a serial number.
fn check_record(folder: &Folder) {
    let lines = folder.lines();
    let of = |event: Event| lines.iter().filter(move |line| line.event == event);
    let mut serials = BTreeMap::new();
    for begun in of(Event::Begun) {
        let ends = lines.iter().filter(|line| line.number == begun.number && line.event != Event::Begun);
        assert_eq!(ends.count(), 1, "pack {}", begun.number);
        // One that must be sealed or brought up before it can be checked gets its number later.
        if let Some(serial) = begun.serial.clone() {
            let other = serials.insert(serial.clone(), begun.number);
            assert!(other.is_none_or(|other| other == begun.number), "{serial} was given twice");
        }
    }
    for pass in of(Event::Pass) {
        let given = |begun: &Entry| begun.number == pass.number && begun.serial == pass.serial;
        assert!(pass.serial.is_some() && of(Event::Begun).any(given), "pack {}", pass.number);
    }
}

#[test]
fn no_pack_passes_that_is_not_what_was_asked() {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    let usual = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { 1000 } else { 40 };
    let (first, packs) = (number("GAUGEFS_SEED").unwrap_or(0), number("GAUGEFS_PACKS").unwrap_or(usual));
    let folder = Folder::new("faults");
    let plan = folder.plan(&format!("{PLAIN}\nunsettled = 'discard'"));
    let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
    assert!(map.asked.len() > 100);
    let line = Line::start(plan, &[], None).expect("a record");
    let (mut passed, mut reasons) = (0, BTreeMap::<String, u32>::new());
    let (mut seconds, mut transfers) = (0.0, 0);
    for seed in first..first + packs {
        let sim = new_pack(&clock, seed, (seed % 4 != 0).then_some(seed));
        if seed % 8 != 7 {
            // Other versions are refused, and nothing more is learned from that.
            sim.set("firmware", "printed").and_then(|()| sim.set("hardware", "printed")).expect("knobs");
        }
        let (before, fault) = (sim.flash(), fault(seed));
        let at = format!("seed {seed}, {fault}, {}", sim.envelope());
        line.run(&clock, [(sim.clone(), fault)]);
        let last = folder.lines().pop().expect("a line");
        match last.event {
            Event::Begun => panic!("{at}: no outcome"),
            Event::Pass => {
                passed += 1;
                // Its power may have been lost right after its last transfer.
                clock.sleep(Duration::from_secs(5));
                seconds += last.seconds.expect("it is measured");
                transfers += last.transfers.expect("they are counted");
                map.check(&sim, &before, last.serial.as_deref().expect("a number"), &at);
            }
            Event::Fail => {
                let reason = last.reason.expect("a reason");
                *reasons.entry(reason.split(": ").take(2).collect::<Vec<_>>().join(": ")).or_default() += 1;
            }
        }
        clock.sleep(Duration::from_secs(1000));
    }
    check_record(&folder);
    let each = f64::from(passed).max(1.0);
    // A row of benches/run.
    println!(
        "| simulated packs programmed by a station, drawn gauges and faults | {packs} packs, {passed} passed, each with \
         every bit that was asked for; {:.1} s and {:.0} transfers each | |\n{reasons:#?}",
        seconds / each,
        f64::from(transfers as u32) / each
    );
    assert!(passed > packs as u32 / 4, "{passed} of {packs} pass");
    assert!(!reasons.is_empty());
}

#[test]
fn a_pack_without_faults_passes_and_is_documented() {
    let folder = Folder::new("plain");
    let plan = folder.plan(&format!("{PLAIN}\ndate = '2026-11-22'\npack-lot = 0x12"));
    let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
    let line = Line::start(plan, &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS BAT0 serial 1000 (pack 1, "), "{said:?}");
    let lines = folder.lines();
    let [begun, pass] = &lines[..] else { panic!("{lines:?}") };
    assert_eq!((begun.event, pass.event), (Event::Begun, Event::Pass));
    assert_eq!(pass.image_sha256, text::hex(&Sha256::digest(golden())));
    assert!(
        pass.changes
            .iter()
            .any(|change| change.name == "it-cfg/cell-terminate-voltage" && change.new == "3100")
    );
    // Day 22, month 11, 46 years after 1980.
    let date = pass.changes.iter().find(|change| change.name.ends_with("/manufacture-date")).expect("a date");
    assert_eq!(date.new, (22 + 11 * 32 + 46 * 512).to_string());
    let after = folder.file("line1.images").join(pass.after.as_ref().expect("an image"));
    let image = Image::open(&after, None).expect("an image");
    let all = image.chip.subclasses.iter().filter(|row| row.kind != Kind::Security);
    assert_eq!(image.entries.len(), all.map(|row| row.parameters.len()).sum::<usize>());
    assert!(map.asked.len() > 100);
    println!(
        "{:.1} s and {} transfers",
        pass.seconds.expect("it is measured"),
        pass.transfers.expect("they are counted")
    );
    check_record(&folder);

    // It is recognised, and refused or programmed again.
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[1].contains("it was programmed before as serial number 1000"), "{said:?}");
    drop(line);
    let plan = folder.plan(&format!("{PLAIN}\ndate = '2026-11-22'\npack-lot = 0x12\nseen = 'redo'"));
    let line = Line::start(plan, &[], None).expect("a record");
    let said = line.run(&clock, [(sim, "none".into()), (new_pack(&clock, 2, None), "none".into())]);
    assert!(said[0].starts_with("PASS BAT0 serial 1000 (pack 3"), "{said:?}");
    assert!(said[1].starts_with("PASS BAT0 serial 1001 (pack 4"), "{said:?}");
}

#[test]
fn a_station_that_loses_its_power_leaves_no_pack_without_an_outcome() {
    let folder = Folder::new("count");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let calls = line.power.done.load(Ordering::SeqCst);
    let runs = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { calls } else { 25 };
    let mut drawn = Drawn::new(7);
    let (mut begun, mut again) = (0, 0);
    for run in 1..=runs {
        let cut = if runs == calls { run } else { drawn.below(calls) + 1 };
        let at = format!("power lost at {cut} of {calls}");
        let folder = Folder::new("cut");
        let plan = folder.plan(PLAIN);
        let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
        let sim = new_pack(&clock, 1, None);
        let before = sim.flash();
        if let Ok(line) = Line::start(plan, &[], Some(cut)) {
            let said = line.run(&clock, [(sim.clone(), "none".into())]);
            assert!(said.iter().all(|line| !line.starts_with("PASS")), "{at}: {said:?}");
        }
        begun += u32::from(folder.file("line1.jsonl").exists() && !folder.lines().is_empty());
        clock.sleep(Duration::from_secs(5));
        let line = Line::start(folder.plan(PLAIN), &[], None).unwrap_or_else(|error| panic!("{at}: {error}"));
        check_record(&folder);
        // What was begun is not forgotten, and the pack can be programmed again.
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        check_record(&folder);
        let last = folder.lines().pop().expect("a line");
        let is_refused = last
            .reason
            .as_ref()
            .is_some_and(|why| why.contains("gaugefs settle") || why.contains("it was programmed before"));
        assert!(last.event == Event::Pass || is_refused, "{at}: {said:?}");
        if last.event == Event::Pass {
            again += 1;
            map.check(&sim, &before, last.serial.as_deref().expect("a number"), &at);
        }
    }
    // A row of benches/run.
    println!(
        "| power of a station lost at its system calls and transfers | {runs} runs, {begun} packs begun, each with an \
         outcome on record; {again} passed afterwards | |"
    );
    assert!(begun > runs as u32 / 4 && again > runs as u32 / 2, "{begun} begun, {again} passed");
}

/// A pack that is not touched.
fn refused(folder: &Folder, line: &Line, clock: &Arc<SimClock>, sim: &Sim, fault: &str) -> String {
    let flash = sim.flash();
    let begun = folder.lines().iter().filter(|line| line.event == Event::Begun).count();
    let said = line.run(clock, [(sim.clone(), fault.into())]).pop().expect("an outcome");
    assert!(said.starts_with("FAIL") && said.contains("nothing was changed"), "{said}");
    assert!(sim.flash() == flash, "{said}");
    assert_eq!(folder.lines().iter().filter(|line| line.event == Event::Begun).count(), begun, "{said}");
    said
}

#[test]
fn the_comparison_finds_every_bit() {
    let folder = Folder::new("bits");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    line.run(&clock, [(sim.clone(), "none".into())]);
    let mut gauge = opened(&sim, &clock, Run::default());
    let good = Flash::read(&mut gauge).expect("the default key");
    super::target::check(&line.station.plan.image, &good, &[]).expect("it has passed");
    for entry in line.station.plan.image.entries.iter().step_by(7) {
        let area = entry.subclass.id;
        let at = usize::from(entry.parameter.offset) + entry.parameter.kind.size() - 1;
        let bytes = entry.bytes(line.station.plan.image.chip).expect("it fits");
        let last = bytes[bytes.len() - 1];
        sim.set_flash(area.into(), at, &[last ^ 1]);
        let now = Flash::read(&mut gauge).expect("the default key");
        let error = super::target::check(&line.station.plan.image, &now, &[]).expect_err("one bit");
        assert!(error.to_string().contains("when read back"), "{error}");
        let error = now.check_same(&good, &[]).expect_err("one bit");
        assert!(error.to_string().starts_with(entry.parameter.name), "{error}");
        sim.set_flash(area.into(), at, &[last]);
    }
}

#[test]
fn a_pack_that_is_pulled_out_fails_and_the_next_waits_for_a_decision() {
    let clock = Arc::new(SimClock::new());
    // While it is written.
    let pull = |at: u32| {
        let folder = Folder::new("pulled");
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        let pack = new_pack(&clock, 1, None);
        let said = line.run(&clock, [(pack.clone(), format!("silence {at} 60000"))]);
        said[0].contains("contents unknown").then_some((folder, line, pack, said))
    };
    let (folder, line, pulled, said) = (150..400).step_by(10).find_map(pull).expect("a write");
    assert!(said[0].starts_with("FAIL BAT0 serial 1000") && said[0].contains("its journal is "), "{said:?}");
    // A pack whose values the interrupted write does not explain.
    let other = new_pack(&clock, 2, None);
    other.set_flash(48, 11, &[0x12, 0x34]);
    let said = refused(&folder, &line, &clock, &other, "none");
    assert!(said.contains("gaugefs settle") && said.contains("unsettled"), "{said}");
    drop(line);
    let plan = folder.plan(&format!("{PLAIN}\nunsettled = 'discard'"));
    let map = Map::of(&plan);
    let line = Line::start(plan, &[], None).expect("a record");
    clock.sleep(Duration::from_secs(100));
    let (new, before) = (new_pack(&clock, 3, None), new_pack(&clock, 3, None).flash());
    let packs = [other, new.clone(), pulled].map(|sim| (sim, "none".to_string()));
    let said = line.run(&clock, packs);
    assert!(said.len() == 3 && said.iter().all(|line| line.starts_with("PASS")), "{said:?}");
    let lines = folder.lines();
    let passed: Vec<_> = lines.iter().filter(|line| line.event == Event::Pass).collect();
    map.check(&new, &before, passed[1].serial.as_deref().expect("a number"), "the next pack");
    let images = fs::read_dir(folder.file("line1.images")).expect("a folder");
    let kept = images.flatten().filter(|file| file.path().extension().is_some_and(|end| end == "journal"));
    assert_eq!(kept.count(), 1);
    check_record(&folder);
}

/// A pack whose power was cut while a row was programmed, and another one like it on the bench meanwhile.
#[test]
fn regression_a_pack_with_an_erased_row_passed() {
    for with_journal in [true, false] {
        let folder = Folder::new("erased");
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        let torn = new_pack(&clock, 1, None);
        if with_journal {
            let journal = Journal::new(folder.file("journals"), "i2c-9-55".into(), "another bench".into());
            let run = Run { journal: Some(journal), ..Run::default() };
            let mut gauge = opened(&torn, &clock, run);
            torn.set("tear", "erased").and_then(|()| torn.set("fault", "torn-commit 5")).expect("knobs");
            let row = torn_row();
            let change =
                Change::of_value(gauge.handle.chip(), row, &Value::Int(3100), false).expect("it fits");
            gauge.ask(&op::WRITE, vec![change]).expect_err("it is torn");
            torn.set("power", "on").expect("a knob");
        } else {
            torn.set_flash(80, 32, &[0xff; 32]);
        }
        clock.sleep(Duration::from_secs(5));
        let flash = torn.flash();
        let said = line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
        assert!(said[0].starts_with("PASS"), "{said:?}");
        let said = refused(&folder, &line, &clock, &torn, "none");
        assert!(said.contains(if with_journal { "gaugefs settle" } else { "0xff" }), "{said}");
        assert!(torn.flash() == flash);
    }
}

fn torn_row() -> ti_gauge::dataflash::Row {
    Chip::by_name(CHIP).and_then(|chip| chip.row("80", "53")).expect("Cell Terminate Voltage")
}

#[test]
fn what_is_rehearsed_goes_wrong_as_it_is_called() {
    let folder = Folder::new("rehearse");
    let lines =
        format!("{PLAIN}\nrehearse = ['pulled 250', 'other-part', 'other-key', 'dead-meter', 'good']");
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    let said = Said::default();
    let stops = Arc::new(AtomicBool::new(false));
    let run = super::run(
        folder.plan(&lines),
        || clock.clone(),
        Box::new(said.clone()),
        Lines::of(&[]),
        None,
        stops,
    );
    assert!(!run.expect("it runs"));
    let steps: Vec<_> = folder.lines().into_iter().filter(|line| line.event != Event::Begun).collect();
    let steps: Vec<_> = steps.iter().map(|line| line.step.as_deref().unwrap_or("pass")).collect();
    // The transfer is one of the write, or one of those after it.
    assert!(["image", "verification"].contains(&steps[0]), "{:?}", said.all());
    assert_eq!(steps[1..], ["identification", "reading", "checks", "pass"], "{:?}", said.all());
    check_record(&folder);
    let told = said.all();
    assert!(told.iter().any(|line| line.starts_with("? packs: 5, passed: 1, failed: 4,")), "{told:?}");
    for (word, why) in [
        ("'bad'", "use good, pulled N"),
        ("'pulled'", "is not an event"),
        ("'pulled 0'", "expected a transfer"),
    ] {
        let error =
            folder.try_plan(&format!("{PLAIN}\nrehearse = [{word}]")).err().expect("refused").to_string();
        assert!(error.contains("rehearse") && error.contains(why), "{error}");
    }
}
