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
use ti_gauge::journal::{Disk, File, Host, Journal};
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

mod attacks;
mod mux;
mod protector;
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

    fn check(&self, path: &Path, trusted: Option<u32>) -> io::Result<()> {
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
fn a_new_board_is_brought_up_and_calibrated() {
    let folder = Folder::new("new");
    let image = format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n");
    fs::write(folder.file("golden.toml"), image).expect("a file");
    let plan = folder.plan(&format!(
        "{PLAIN}\ncells = 7\ndivider = 33000\npack-voltage = 26985\nboard-offset = true\ntemperature = 25"
    ));
    let clock = Arc::new(SimClock::new());
    let line = Line::start(plan, &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    for (knob, text) in
        [("cells", "7"), ("board_divider", "33000"), ("board_offset_ma", "6"), ("temperature_error", "30")]
    {
        sim.set(knob, text).expect("a knob");
    }
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert_eq!(pass.calibration.len(), 3, "{:?}", pass.calibration);
    assert!(pass.calibration[0].contains("limit"), "{:?}", pass.calibration);
    assert!(pass.calibration[2].contains("the error was"), "{:?}", pass.calibration);
    let new = |name: &str| {
        pass.changes.iter().find(|change| change.name.ends_with(name)).map(|change| &*change.new)
    };
    assert_eq!(new("/ext-temp-offset"), Some("-30"));
    assert_eq!(new("/cell-terminate-voltage"), Some("3100"));
    assert_eq!((sim.get("seal").as_deref(), sim.get("mode").as_deref()), (Some("sealed"), Some("normal")));

    // Without a load, a gain is not calibrated.
    drop(line);
    let line = Line::start(folder.plan(&format!("{PLAIN}\ncurrent = -2000")), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
    assert!(said[0].contains("switch on the current of -2000 mA"), "{said:?}");
    assert!(line.said.all().contains(&"? BAT0: switch on the current of -2000 mA".to_string()));
}

#[test]
fn an_image_that_contradicts_the_station_is_refused() {
    let folder = Folder::new("contradicts");
    let refuse = |lines: &str| folder.try_plan(lines).err().map_or(String::new(), |error| error.to_string());
    for (lines, says) in [
        ("cells = 7\ndivider = 33000", "the image has 1"),
        ("serial-parameter = 'it-cfg/nothing'\nserial = 'counter'", "has no parameter it-cfg/nothing"),
        ("serial = 'counter'\nfirst-serial = 70000", "first-serial"),
        ("pack-lot = 70000", "pack-lot"),
        ("divider = 33000", "divider: set cells too"),
        ("new-key-file = 'missing'", "missing"),
    ] {
        let error = refuse(lines);
        assert!(error.contains(says), "{lines}: {error}");
    }
    assert_eq!(refuse(""), "");
    let of = |chips: &[&str]| {
        let gauges = chips.iter().map(|chip| (chip.to_string(), simulated(chip))).collect();
        let setup = Setup::new(&folder.file("line1.toml"), Options::default(), gauges);
        Plan::read(&folder.file("golden.toml"), setup).err().expect("another part").to_string()
    };
    assert!(of(&[CHIP, "bq27441-g1"]).contains("golden.toml"), "{}", of(&[CHIP, "bq27441-g1"]));
    // RAM is lost with the power.
    fs::write(folder.file("golden.toml"), "chip = \"bq27441-g1\"\n[state]\ntaper-rate = 90\n")
        .expect("a file");
    assert!(of(&["bq27441-g1"]).contains("--profile"), "{}", of(&["bq27441-g1"]));
}

/// A rack on which the pack is exchanged while somebody scans its number.
struct Exchange(Sim, Arc<Mutex<Option<Sim>>>);

impl Scanner for Exchange {
    fn line(&mut self, _: &str) -> Option<String> {
        *self.1.lock().expect("nobody panics") = Some(self.0.clone());
        Some("7".into())
    }
}

/// A bus to the pack that was put in its place, or else to the first one.
struct Exchanged(SimBus, Arc<Mutex<Option<Sim>>>);

impl Bus for Exchanged {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        match &*self.1.lock().expect("nobody panics") {
            Some(sim) => sim.bus().transfer(write, read),
            None => self.0.transfer(write, read),
        }
    }
}

struct OnBus(Arc<SimClock>, Sim, Arc<Mutex<Option<Sim>>>, u32);

impl Slot for OnBus {
    fn clock(&self) -> Arc<dyn Clock> {
        self.0.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        Box::new(Exchanged(self.1.bus(), self.2.clone()))
    }

    fn is_there(&mut self) -> Option<bool> {
        (self.3 == 0).then_some(true)
    }

    fn done(&mut self) {
        self.3 = 1;
    }
}

/// Images of real packs have 0 in bits that the manual reserves and prints as 1.
#[test]
fn reserved_bits_stay_as_the_pack_has_them_if_the_file_says_so() {
    let folder = Folder::new("reserved");
    let image = golden().replace("pack-configuration-b = 0xff", "pack-configuration-b = 0xaf");
    fs::write(folder.file("golden.toml"), &image).expect("a file");
    let clock = Arc::new(SimClock::new());
    let sim = new_pack(&clock, 1, None);
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    assert!(refused(&folder, &line, &clock, &sim, "none").contains("Pack Configuration B"));
    drop(line);
    let plan =
        folder.plan("serial = 'counter'\nexclude = ['serial', 'calibration', 'learned', 'undocumented']");
    let line = Line::start(plan, &[], None).expect("a record");
    let said = line.run(&clock, [(sim, "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert!(pass.changes.iter().any(|change| change.name == "it-cfg/cell-terminate-voltage"));
    assert!(pass.changes.iter().all(|change| change.name != "registers/pack-configuration-b"));
}

#[test]
fn a_pack_that_is_exchanged_while_its_number_is_scanned_is_not_touched() {
    let folder = Folder::new("exchanged");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let (one, other) = (new_pack(&clock, 1, None), new_pack(&clock, 2, None));
    other.set_flash(48, 11, &[0x12, 0x34]);
    clock.sleep(Duration::from_secs(3));
    let now = Arc::new(Mutex::new(None));
    let mut line = Line::start(plan, &[], None).expect("a record");
    line.station.desk.scanner = Mutex::new(Box::new(Exchange(other.clone(), now.clone())));
    let flash = [one.flash(), other.flash()];
    line.station.run(&line.bench, &mut OnBus(clock, one.clone(), now, 0));
    let last = folder.lines().pop().expect("a line");
    let reason = last.reason.expect("a reason");
    assert!(last.event == Event::Fail && reason.contains("nothing was changed"), "{reason}");
    assert!([one.flash(), other.flash()] == flash && folder.lines().len() == 1);
}

#[test]
fn a_scanned_number_is_asked_for_until_it_is_right() {
    let folder = Folder::new("scan");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let typed = ["", "70000", "serial", "7", "7", " 0x0008 "];
    let line = Line::start(plan, &typed, None).expect("a record");
    let packs: Vec<_> = (0..2).map(|seed| (new_pack(&clock, seed, None), "none".to_string())).collect();
    let said = line.run(&clock, packs);
    assert!(
        said[0].starts_with("PASS BAT0 serial 7 (0x0007) (pack 1,")
            && said[1].starts_with("PASS BAT0 serial 0x0008 (pack 2,"),
        "{said:?}"
    );
    let told = line.said.all();
    assert!(told.contains(&"? BAT0: 7 (0x0007)".to_string()), "{told:?}");
    assert!(told.contains(&"? BAT0: programming, do not remove (1 of 2: image)".to_string()), "{told:?}");
    assert_eq!(folder.lines().pop().expect("a line").scanned, None);
    let said = refused(&folder, &line, &clock, &new_pack(&clock, 3, None), "none");
    assert!(said.contains("the input has ended"), "{said}");
    check_record(&folder);
}

#[test]
fn regression_a_serial_number_was_shown_in_another_base_than_in_the_file() {
    let list = PLAIN.replace("'counter'\nfirst-serial = 1000", "'list'\nserial-list = 'serials.txt'");
    for (name, lines, serials) in [
        ("base-10", PLAIN.to_string(), ["1000", "1001"]),
        ("base-16", format!("{PLAIN}\nserial-is-hex = true"), ["0x03e8", "0x03e9"]),
        ("base-list", list, ["258", "0x1F"]),
    ] {
        let folder = Folder::new(name);
        fs::write(folder.file("serials.txt"), "258\n0x1F\n").expect("a file");
        let told = folder.file("told");
        let exec = format!("exec = ['sh', '-c', 'echo $GAUGEFS_SERIAL >> {}']", told.display());
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(&format!("{lines}\n{exec}")), &[], None).expect("a record");
        let packs = [1, 2].map(|seed| new_pack(&clock, seed, None));
        let again = packs[0].clone();
        let said = line.run(&clock, packs.into_iter().chain([again]).map(|pack| (pack, "none".into())));
        for (said, serial) in said.iter().zip(serials) {
            assert!(said.starts_with(&format!("PASS BAT0 serial {serial} (pack ")), "{said}");
        }
        let seen = format!("it was programmed before as serial number {},", serials[0]);
        assert!(said[2].contains(&seen), "{}", said[2]);
        let told = fs::read_to_string(told).expect("it was told");
        assert!(told.starts_with(&format!("{}\n{}\n", serials[0], serials[1])), "{told}");
        check_record(&folder);
    }
}

#[test]
fn a_list_is_given_once_and_has_no_number_twice() {
    let folder = Folder::new("list");
    let lines = PLAIN.replace("'counter'\nfirst-serial = 1000", "'list'\nserial-list = 'serials.txt'");
    fs::write(folder.file("serials.txt"), "0x0101 # first\n\n258\n0x0102\n").expect("a file");
    let error = folder.try_plan(&lines).err().expect("one is there twice").to_string();
    assert!(error.contains("serials.txt: line 4") && error.contains("also in line 3"), "{error}");
    fs::write(folder.file("serials.txt"), "0x0101 # first\n\n258\n").expect("a file");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    // The number of a pack that fails is not given again.
    let packs = [
        (new_pack(&clock, 1, None), "silence 300 900000".to_string()),
        (new_pack(&clock, 2, None), "none".into()),
    ];
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("FAIL BAT0 serial 0x0101"), "{said:?}");
    drop(line);
    let line =
        Line::start(folder.plan(&format!("{lines}\nunsettled = 'discard'")), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
    let last = folder.lines().pop().expect("a line");
    assert!(
        said.len() == 1 && last.serial.as_deref() == Some("0x0102") || said[0].contains("all serial numbers"),
        "{said:?}"
    );
    let said = refused(&folder, &line, &clock, &new_pack(&clock, 4, None), "none");
    assert!(said.contains("all serial numbers were given"), "{said}");
    check_record(&folder);
}

#[test]
fn without_room_for_the_record_nothing_is_touched() {
    let folder = Folder::new("full");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    line.power.disk_is_full.store(true, Ordering::SeqCst);
    let flash = sim.flash();
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("nothing was changed"), "{said:?}");
    assert!(sim.flash() == flash && folder.lines().is_empty());
    line.power.disk_is_full.store(false, Ordering::SeqCst);
    let said = line.run(&clock, [(sim, "none".into())]);
    assert!(said[1].starts_with("PASS"), "{said:?}");
}

#[test]
fn a_wrong_part_and_another_chemistry_are_refused() {
    let folder = Folder::new("wrong");
    let clock = Arc::new(SimClock::new());
    let mut plan = folder.plan(PLAIN);
    plan.image.chemistry = Some(ti_gauge::image::Chemistry::Sum(0x1234));
    let line = Line::start(plan, &[], None).expect("a record");
    for (part, says) in
        [("bq27441-g1", "BAT0"), ("bq34z100-r2", "this is a bq34z100-R2"), (CHIP, "another chemistry")]
    {
        let sim = Sim::new(part, &gauge_sim::Options::default(), clock.clone()).expect("it is simulated");
        let said = refused(&folder, &line, &clock, &sim, "none");
        assert!(said.contains(says), "{part}: {said}");
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
fn keys_are_changed_and_are_nowhere_in_the_record() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new("keys");
    let keys = folder.file("new.keys");
    fs::write(&keys, "unseal = 8d3e b7c5\nfull_access = 6fa1 92d4\n").expect("a file");
    fs::set_permissions(&keys, fs::Permissions::from_mode(0o600)).expect("its mode");
    let lines = format!("{PLAIN}\nnew-key-file = 'new.keys'");
    let plan = folder.plan(&lines);
    let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
    let line = Line::start(plan, &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let before = sim.flash();
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    map.check(&sim, &before, "0x03e8", "new keys");
    let mut gauge = opened(&sim, &clock, Run::default());
    assert!(Flash::read(&mut gauge).is_err(), "the default key is gone");
    for file in fs::read_dir(folder.file("line1.images")).expect("a folder").flatten().map(|file| file.path())
    {
        let text = fs::read_to_string(&file).expect("text").to_lowercase();
        assert!(!text.contains("8d3e") && !text.contains("92d4"), "{}", file.display());
    }
    let text = fs::read_to_string(folder.file("line1.jsonl")).expect("a record").to_lowercase();
    assert!(!text.contains("8d3e b7c5") && !text.contains("6fa1 92d4") && !text.contains("8d3eb7c5"));

    // It is recognised with its new keys.
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[1].contains("it was programmed before as serial number 1000"), "{said:?}");
    drop(line);
    let line = Line::start(folder.plan(&format!("{lines}\nseen = 'redo'")), &[], None).expect("a record");
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS BAT0 serial 1000"), "{said:?}");
    assert_eq!(sim.get("seal").as_deref(), Some("sealed"));
}

/// Gauges come from the factory open, and an interrupted pack may be open, too.
#[test]
fn a_pack_that_is_found_open_is_sealed_at_the_end() {
    let folder = Folder::new("open");
    let plan = folder.plan(PLAIN);
    let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
    let line = Line::start(plan, &[], None).expect("a record");
    for (number, seal) in [Seal::Unsealed, Seal::FullAccess].into_iter().enumerate() {
        let sim = new_pack(&clock, 1, None);
        clock.sleep(Duration::from_secs(3));
        let mut gauge = opened(&sim, &clock, Run::default());
        gauge.ask(&op::SEAL, seal).expect("the default keys");
        let before = sim.flash();
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        assert!(said[number].starts_with("PASS"), "{said:?}");
        let pass = folder.lines().pop().expect("a line");
        map.check(&sim, &before, pass.serial.as_deref().expect("a number"), "open");
    }
}

/// A station that was stopped between two keys leaves one of them.
#[test]
fn keys_of_which_one_was_changed_before_are_completed() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new("some-keys");
    let lines = format!("{PLAIN}\nnew-key-file = 'new.keys'\nseen = 'redo'");
    let clock = Arc::new(SimClock::new());
    let sim = new_pack(&clock, 1, None);
    let mut keys = String::new();
    for key in ["unseal = 8d3e b7c5\n", "full_access = 6fa1 92d4\n", ""] {
        keys += key;
        fs::write(folder.file("new.keys"), &keys).expect("a file");
        fs::set_permissions(folder.file("new.keys"), fs::Permissions::from_mode(0o600)).expect("its mode");
        let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        assert!(said[0].starts_with("PASS BAT0 serial 1000"), "{said:?}");
        assert_eq!(sim.get("seal").as_deref(), Some("sealed"));
    }
    let new = ti_gauge::keys::Keys::parse("new.keys", keys.as_bytes(), "BAT0").expect("keys");
    let run = Run { keys: new, ..Run::default() };
    let mut gauge = opened(&sim, &clock, run);
    gauge.ask(&op::SEAL, Seal::FullAccess).expect("both keys are new");

    // Nobody knows the key that another pack has.
    let line = Line::start(folder.plan(&format!("{lines}\nname = 'other'")), &[], None).expect("a record");
    let other = new_pack(&clock, 2, None);
    clock.sleep(Duration::from_secs(3));
    let mut gauge = opened(&other, &clock, Run::default());
    let change = b"full-access ffff ffff 1234 5678";
    let change = ti_gauge::keys::KeyChange::parse(change).expect("two keys");
    gauge.ask(&op::KEYS, change).expect("the default keys");
    let said = line.run(&clock, [(other, "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("full-access key"), "{said:?}");
}

/// Whatever becomes of the record while the station waits: no number is given twice.
#[test]
fn regression_a_record_that_is_removed_between_packs_goes_unnoticed() {
    type Change = fn(&Path);
    let changes: [(&str, Change); 5] = [
        ("removed", |path| fs::remove_file(path).expect("it is there")),
        ("replaced", |path| {
            let copy = path.with_extension("copy");
            fs::copy(path, &copy).and_then(|_| fs::rename(&copy, path)).expect("a copy");
        }),
        ("emptied", |path| drop(fs::File::create(path).expect("a file"))),
        ("continued", |path| {
            let text = fs::read_to_string(path).expect("text");
            fs::OpenOptions::new()
                .append(true)
                .open(path)
                .and_then(|mut file| {
                    use std::io::Write;
                    file.write_all(text.as_bytes())
                })
                .expect("more of it");
        }),
        ("moved", |path| fs::rename(path, path.with_extension("old")).expect("it is there")),
    ];
    for (what, change) in changes {
        let folder = Folder::new("removed");
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
        assert!(said[0].starts_with("PASS"), "{what}: {said:?}");
        change(&folder.file("line1.jsonl"));
        let sim = new_pack(&clock, 2, None);
        let flash = sim.flash();
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        assert_eq!(said.len(), 1, "{what}: {said:?}");
        assert!(sim.flash() == flash && !line.station.all_passed(), "{what}");
        let why = line.said.all().pop().expect("a reason");
        assert!(why.contains("line1.jsonl") && why.contains("record was"), "{what}: {why}");
        drop(line);
        // Its images show that there was one.
        if !folder.file("line1.jsonl").exists() {
            let error = Line::start(folder.plan(PLAIN), &[], None).err().expect("it is missing").to_string();
            assert!(error.contains("images"), "{what}: {error}");
        }
    }
}

/// Nor while a pack is programmed.
#[test]
fn a_record_that_is_removed_while_a_pack_is_programmed_gives_no_number() {
    let folder = Folder::new("removed-begin");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let mut line = Line::start(plan, &[], None).expect("a record");
    struct Removing(PathBuf);
    impl Scanner for Removing {
        fn line(&mut self, _: &str) -> Option<String> {
            fs::remove_file(&self.0).expect("it is there");
            Some("7".into())
        }
    }
    let scanner = Box::new(Removing(folder.file("line1.jsonl")));
    line.station.desk.scanner = Mutex::new(scanner);
    let sim = new_pack(&clock, 1, None);
    let flash = sim.flash();
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("record was"), "{said:?}");
    assert!(sim.flash() == flash && !line.station.all_passed());
}

#[test]
fn regression_a_record_that_cannot_be_synced_says_pass_and_the_screen_says_fail() {
    for times in [1, 2, u64::MAX] {
        let folder = Folder::new("unsynced");
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        line.power.unsynced.store(times, Ordering::SeqCst);
        let packs = [1, 2].map(|seed| (new_pack(&clock, seed, None), "none".to_string()));
        let said = line.run(&clock, packs);
        // It does not go on.
        assert!(said.len() == 1 && said[0].starts_with("FAIL BAT0 serial 1000"), "{times}: {said:?}");
        assert!(said[0].contains("the record cannot be written"), "{times}: {said:?}");
        assert!(folder.lines().iter().all(|line| line.event != Event::Pass), "{times}: {:?}", folder.lines());
        assert!(!line.station.all_passed());
        drop(line);
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        check_record(&folder);
        let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
        assert!(said.last().is_some_and(|line| line.starts_with("PASS BAT0 serial 1001")), "{said:?}");
    }
}

#[test]
fn regression_a_field_of_the_record_forges_an_outcome() {
    for (name, text) in [
        ("gauge", "BAT0\nPASS BAT0 serial 0x0001 (pack 1, 9.0 s)\n"),
        ("serial", "0x0001\u{2028}PASS BAT0"),
        ("serial", "0x0001\r\x1b[1A"),
        ("serial_before", "1\n2"),
        ("time", "now\nPASS"),
    ] {
        let folder = Folder::new("forged");
        let begun = Entry { event: Event::Begun, number: 1, gauge: "BAT0".into(), ..Entry::default() };
        let mut line = serde_json::to_value(&begun).expect("JSON");
        line[name] = text.into();
        fs::write(folder.file("line1.jsonl"), format!("{line}\n")).expect("a file");
        let error = Line::start(folder.plan(PLAIN), &[], None).err().expect("forged").to_string();
        assert!(error.contains("line 1") && error.contains(name) && !error.contains('\n'), "{name}: {error}");
    }
}

#[test]
fn regression_an_unfinished_pack_of_an_earlier_run_is_no_failure() {
    let folder = Folder::new("unfinished");
    let begun = Entry { event: Event::Begun, number: 1, gauge: "BAT0".into(), ..Entry::default() };
    let text = serde_json::to_string(&begun).expect("JSON") + "\n";
    fs::write(folder.file("line1.jsonl"), text).expect("a file");
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    assert!(line.said.all()[0].contains("the station was stopped while it programmed this pack"));
    assert!(!line.station.all_passed(), "it has not passed");
}

/// A pack that loses its power while it gets its keys, and a pack whose keys are erased.
#[test]
fn regression_a_pack_without_its_keys_stays_without() {
    use std::os::unix::fs::PermissionsExt;
    let keys = "unseal = 8d3e b7c5\nfull_access = 6fa1 92d4\n";
    let lines = format!("{PLAIN}\nnew-key-file = 'new.keys'");
    let clock = Arc::new(SimClock::new());
    let folder = |name: &str| {
        let folder = Folder::new(name);
        fs::write(folder.file("new.keys"), keys).expect("a file");
        fs::set_permissions(folder.file("new.keys"), fs::Permissions::from_mode(0o600)).expect("its mode");
        folder
    };
    let opens = |sim: &Sim| {
        let keys = ti_gauge::keys::Keys::parse("new.keys", keys.as_bytes(), "BAT0").expect("keys");
        let mut gauge = opened(sim, &clock, Run { keys, ..Run::default() });
        gauge.ask(&op::SEAL, Seal::FullAccess).is_ok()
    };
    let erased = new_pack(&clock, 1, None);
    erased.set_flash(112, 0, &[0xff; 8]);
    let of_erased = folder("erased");
    let line = Line::start(of_erased.plan(&lines), &[], None).expect("a record");
    let said = line.run(&clock, [(erased.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS") && opens(&erased), "{said:?}");

    let (mut passed, mut lost) = (0, 0);
    let all = {
        let folder = folder("all-keys");
        let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
        line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
        folder.lines().pop().and_then(|last| last.transfers).expect("they are counted")
    };
    // The commits of the image come before those of the keys.
    for at in (all / 2..all).step_by(4) {
        let folder = folder("pulled-keys");
        let sim = new_pack(&clock, 2, None);
        sim.set("tear", "erased").expect("a knob");
        let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
        let said = line.run(&clock, [(sim.clone(), format!("power-cut-after {at} 900000"))]);
        drop(line);
        if !(said[0].contains("a change of the") || said[0].contains("keys change")) {
            continue;
        }
        clock.sleep(Duration::from_secs(1000));
        sim.set("power", "on").expect("a knob");
        let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        let last = said.last().expect("an outcome");
        // One that the station does not have may be in the row that was erased: then a person has to decide.
        let is_lost = last.contains("the authentication key may have been lost");
        assert!(
            last.starts_with("PASS") && opens(&sim) || last.starts_with("FAIL") && is_lost,
            "{at}: {said:?}"
        );
        (passed, lost) = (passed + u32::from(!is_lost), lost + u32::from(is_lost));
    }
    assert!(passed > 5 && lost < passed / 4, "{passed} {lost}");
}

/// A gate that would shut at the packs' voltage.
fn wrong_image() -> String {
    let chip = Chip::by_name(CHIP).expect("it has a table");
    let (subclass, row) = chip.row("68", "0").expect("Flash Update OK Voltage");
    format!(
        "chip = \"{CHIP}\"\n[{}]\n{} = 4200\n",
        chip.class_dir(subclass),
        ti_gauge::chip::kebab_case(row.name)
    )
}

#[test]
fn a_wrong_image_stops_the_station_and_takes_no_serial_number() {
    let folder = Folder::new("stops");
    fs::write(folder.file("golden.toml"), wrong_image()).expect("a file");
    let lines = format!("{PLAIN}\nstop-after-failures = 3");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let packs: Vec<_> = (0..6).map(|seed| new_pack(&clock, seed, None)).collect();
    let flash: Vec<_> = packs.iter().map(Sim::flash).collect();
    let said = line.run(&clock, packs.iter().map(|sim| (sim.clone(), "none".into())));
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(said.iter().all(|line| line.starts_with("FAIL BAT0 (pack ")), "{said:?}");
    assert!(said.iter().all(|line| line.ends_with("nothing was changed")), "{said:?}");
    let told = line.said.all();
    assert!(
        told.iter().any(|line| line.starts_with("? failures in a row: 3, the last one at checks")),
        "{told:?}"
    );
    assert!(packs.iter().zip(flash).all(|(sim, flash)| sim.flash() == flash));
    assert!(!line.station.all_passed());
    assert!(
        folder.lines().iter().all(|line| line.serial.is_none() && line.step.as_deref() == Some("checks"))
    );
    drop(line);
    // With the right image they pass, and the first number is still there. A failure between two others is none in a row.
    fs::write(folder.file("golden.toml"), golden()).expect("a file");
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let faults = ["none", "silence 1 900000", "silence 1 900000", "none", "silence 1 900000", "none"];
    let said = line.run(&clock, packs.into_iter().zip(faults).map(|(sim, fault)| (sim, fault.to_string())));
    assert_eq!(said.len(), 6, "{said:?}");
    let passed: Vec<_> = said.iter().filter(|line| line.starts_with("PASS")).collect();
    assert!(passed.len() == 3 && passed[2].starts_with("PASS BAT0 serial 1002"), "{said:?}");
    let totals = line.station.tally().totals.clone();
    assert_eq!((totals.passed, totals.failures(), totals.in_a_row), (3, 3, 0));
    assert_eq!(totals.failed.get("identification"), Some(&3), "{totals:?}");
    let lines = totals.lines();
    assert!(
        lines[0].starts_with("packs: 6, passed: 3, failed: 3, first-pass yield: 50.0 %, seconds a pack: "),
        "{lines:?}"
    );
    assert_eq!(lines[1], "failed at identification: 3");
}

#[test]
fn a_pack_that_comes_again_is_no_first_try() {
    let clock = Arc::new(SimClock::new());
    let folder = Folder::new("again");
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let said = line.run(&clock, [(sim.clone(), "drop-seal".into()), (sim, "none".into())]);
    let totals = line.station.tally().totals.clone();
    if said[0].starts_with("PASS") {
        assert_eq!((totals.first_tries, totals.first_passes), (1, 1), "{said:?}");
    } else {
        assert_eq!((totals.first_tries, totals.first_passes, totals.passed), (1, 0, 1), "{said:?}");
    }
}

#[test]
fn the_first_pack_of_a_run_is_confirmed_before_the_next_one() {
    let run = |typed: &[&str], faults: &[&str]| {
        let clock = Arc::new(SimClock::new());
        let folder = Folder::new("confirm");
        let line = Line::start(folder.plan(&format!("{PLAIN}\nconfirm-first = true")), typed, None)
            .expect("a record");
        let packs = (1..).zip(faults).map(|(seed, fault)| (new_pack(&clock, seed, None), fault.to_string()));
        let packs: Vec<_> = packs.collect();
        let said = line.run(&clock, packs);
        (said, line.said.all(), line.station.all_passed())
    };
    let (said, _, passed) = run(&["perhaps", "YES"], &["none", "none"]);
    assert!(said.len() == 2 && passed, "{said:?}");
    // Neither an answer nor its absence lets another pack be begun.
    for typed in [&["no"][..], &[]] {
        let (said, told, passed) = run(typed, &["none", "none"]);
        assert!(said.len() == 1 && said[0].starts_with("PASS") && !passed, "{told:?}");
    }
    // One that fails is not the first one.
    let (said, _, passed) = run(&["yes"], &["silence 1 900000", "none", "none"]);
    assert!(said.len() == 3 && said[2].starts_with("PASS") && !passed, "{said:?}");
    let (said, ..) = run(&["no"], &["silence 1 900000", "none", "none"]);
    assert!(said.len() == 2 && said[1].starts_with("PASS"), "{said:?}");
}

#[test]
fn a_scan_for_another_pack_than_the_one_that_is_there_is_refused() {
    let folder = Folder::new("scan-other");
    let lines = PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'") + "\nseen = 'redo'";
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &["1000", "1001", "BAT0: 1000"], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let said = line.run(&clock, [(sim.clone(), "none".into()), (sim, "none".into())]);
    assert!(said.len() == 2 && said[1].starts_with("PASS BAT0 serial 1000 (0x03e8) (pack 2"), "{said:?}");
    assert!(line.station.all_passed() && line.station.tally().totals.first_tries == 1);
}

#[test]
fn a_label_is_kept_in_the_record_and_in_the_pack() {
    let folder = Folder::new("label");
    let lines = format!("{PLAIN}\nlabel = true\nlabel-parameter = 'configuration-data/device-name'");
    let typed = ["a label that is too long for it", "SN00123", "SN00123", "SN\u{1b}", "SN00124"];
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &typed, None).expect("a record");
    let packs = [1, 2].map(|seed| (new_pack(&clock, seed, None), "none".to_string()));
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("PASS BAT0 SN00123 serial 1000 (pack 1") && said.len() == 2, "{said:?}");
    assert!(said[1].starts_with("PASS BAT0 SN00124 serial 1001"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert_eq!(pass.label.as_deref(), Some("SN00124"));
    let name = pass.changes.iter().find(|change| change.name == "configuration-data/device-name");
    assert_eq!(name.map(|change| &*change.new), Some("SN00124"), "{:?}", pass.changes);
    // A failure sets its label free, and an interrupted pack, too.
    drop(line);
    let line = Line::start(folder.plan(&lines), &["SN7", "SN7", "SN00124"], None).expect("a record");
    let sim = new_pack(&clock, 3, None);
    // After its number is given, and before the first commit.
    let said = line.run(&clock, [(sim.clone(), "silence 280 900000".into())]);
    assert!(said[0].starts_with("FAIL BAT0 SN7"), "{said:?}");
    clock.sleep(Duration::from_secs(1000));
    let said = line.run(&clock, [(sim, "none".into()), (new_pack(&clock, 4, None), "none".into())]);
    assert!(said[1].starts_with("PASS BAT0 SN7 serial 1003") && said[2].starts_with("FAIL"), "{said:?}");
    check_record(&folder);
    for (lines, says) in [
        ("label-parameter = 'configuration-data/device-name'", "label-parameter: set label = true too"),
        ("label = true\nlabel-parameter = 'it-cfg/cell-terminate-voltage'", "a label needs a parameter"),
        ("label = true\nlabel-parameter = 'it-cfg/nothing'", "has no parameter it-cfg/nothing"),
    ] {
        let error = folder.try_plan(lines).err().expect("refused").to_string();
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn a_program_gets_every_outcome_and_its_failure_is_one() {
    let folder = Folder::new("exec");
    let (told, refuses) = (folder.file("told"), folder.file("refuses"));
    let script = format!(
        "cat >> {}; echo $GAUGEFS_EVENT $GAUGEFS_SERIAL >> {0}; if test -e {}; then echo no paper >&2; exit 3; fi",
        told.display(),
        refuses.display()
    );
    let lines = format!("{PLAIN}\nexec = ['sh', '-c', '{script}']");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let packs = ["none", "silence 1 900000"].map(|fault| (new_pack(&clock, 1, None), fault.to_string()));
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("PASS") && said[1].starts_with("FAIL"), "{said:?}");
    let text = fs::read_to_string(&told).expect("it was told");
    let lines_of: Vec<_> = text.lines().collect();
    let [pass, pass_facts, fail, fail_facts] = lines_of[..] else { panic!("{text}") };
    let record = fs::read_to_string(folder.file("line1.jsonl")).expect("a record");
    assert!(record.lines().any(|line| line == pass) && record.lines().any(|line| line == fail), "{text}");
    assert_eq!((pass_facts, fail_facts), ("pass 1000", "fail"));
    // The label was not printed: the pack has not passed.
    fs::write(&refuses, "").expect("a file");
    let said = line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
    let last = said.last().expect("an outcome");
    assert!(
        last.starts_with(
            "FAIL BAT0 serial 1001 (pack 3): exec: sh has failed: exit status: 3; it says: no paper"
        ),
        "{last}"
    );
    let last = folder.lines().pop().expect("a line");
    assert_eq!((last.event, last.step.as_deref()), (Event::Fail, Some("exec")));
    check_record(&folder);
    drop(line);
    // What an interrupted pack has become is told by the next start.
    let begun = Entry { event: Event::Begun, number: 9, gauge: "BAT0".into(), ..Entry::default() };
    let mut text = fs::read_to_string(folder.file("line1.jsonl")).expect("a record");
    text += &(serde_json::to_string(&begun).expect("JSON") + "\n");
    fs::write(folder.file("line1.jsonl"), text).expect("a file");
    fs::remove_file(&refuses).expect("it is there");
    drop(Line::start(folder.plan(&lines), &[], None).expect("a record"));
    let text = fs::read_to_string(&told).expect("it was told");
    assert!(text.contains("\"number\":9") && text.ends_with("\nfail\n"), "{text}");
    // A program that is missing is no reason for PASS either.
    let printer = folder.file("printer");
    fs::copy("/bin/true", &printer).expect("a program");
    let plan = folder.plan(&format!("{PLAIN}\nexec = ['{}']", printer.display()));
    fs::remove_file(&printer).expect("it is there");
    let line = Line::start(plan, &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("/printer"), "{said:?}");
}

#[test]
fn a_calibration_outside_of_its_limits_fails_and_the_record_becomes_a_table() {
    let folder = Folder::new("table");
    let image = format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n");
    fs::write(folder.file("golden.toml"), image).expect("a file");
    let clock = Arc::new(SimClock::new());
    let sims = [1, 2].map(|seed| new_pack(&clock, seed, None));
    let mut gauge = opened(&sims[0], &clock, Run::default());
    gauge.ask(&op::REFRESH, ()).expect("it answers");
    let register = gauge.handle.chip().register(ti_gauge::chip::Role::VoltageNow).expect("a voltage");
    let shown =
        gauge.handle.published().snapshot.as_ref().and_then(|all| all.value(register)).expect("it is read");
    let lines = |tolerance: &str| {
        format!(
            "{PLAIN}\nboard-offset = true\noffset-tolerance = 3\nvoltage = {}.4\nvoltage-tolerance = {tolerance}",
            shown + 9
        )
    };
    // Nothing shows a fraction of a millivolt.
    let line = Line::start(folder.plan(&lines("0.1")), &[], None).expect("a record");
    let said = line.run(&clock, [(sims[0].clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("mV are allowed"), "{said:?}");
    drop(line);
    let line = Line::start(folder.plan(&lines("5")), &[], None).expect("a record");
    sims[1].set("board_offset_ma", "6").expect("a knob");
    let said = line.run(&clock, [(sims[1].clone(), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let records = super::Records::read(&folder.file("line1.jsonl")).expect("a record");
    let text = String::from_utf8(records.csv()).expect("text");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3, "{text}");
    let column = |name: &str| {
        rows[0].iter().position(|head| *head == name).unwrap_or_else(|| panic!("{name}: {text}"))
    };
    let last = &rows[2];
    assert_eq!(last[column("outcome")], "pass");
    assert_eq!(last[column("board_offset_before")], "0");
    assert_ne!(last[column("board_offset_after")], "0");
    assert_eq!([last[column("current_mA_low")], last[column("current_mA_high")]], ["-3", "3"]);
    assert_eq!(last[column("current_mA_before")], "6");
    let after: f64 = last[column("voltage_mV_after")].parse().expect("a number");
    assert!((after - (shown + 9) as f64).abs() < 5.0, "{text}");
    assert_eq!(last[column("temperature_celsius_low")], "", "{text}");
    assert!(last[column("temperature_celsius_after")].parse::<f64>().is_ok(), "{text}");
    let failures = records.failures();
    assert!(
        failures.len() == 1 && failures[0].step == "calibration" && failures[0].count == 1,
        "{failures:?}"
    );
    let days = records.groups(super::By::Day);
    assert!(days.iter().map(|day| day.totals.passed).sum::<u64>() == 1, "{days:?}");
}

/// Lines that earlier versions have written are still read.
#[test]
fn an_older_record_is_read() {
    let folder = Folder::new("older");
    let lines = concat!(
        "{\"event\":\"begun\",\"number\":1,\"time\":\"2026-03-01T10:00:00Z\",\"station\":\"line1\",\"gauge\":\"BAT0\",",
        "\"who\":\"a@b\",\"chip\":\"bq34z100-g1\",\"image\":\"golden.toml\",\"image_sha256\":\"00\",",
        "\"serial\":\"0x03e8\",\"serial_before\":\"0x0001\",\"before\":\"000001-BAT0-before.toml\"}\n",
        "{\"event\":\"fail\",\"number\":1,\"time\":\"2026-03-01T10:00:09Z\",\"station\":\"line1\",\"gauge\":\"BAT0\",",
        "\"who\":\"a@b\",\"chip\":\"bq34z100-g1\",\"image\":\"golden.toml\",\"image_sha256\":\"00\",",
        "\"serial\":\"0x03e8\",\"reason\":\"=cmd, seal: verify\",\"seconds\":9.5}\n"
    );
    fs::write(folder.file("line1.jsonl"), lines).expect("a file");
    let records = super::Records::read(&folder.file("line1.jsonl")).expect("a record");
    let text = String::from_utf8(records.csv()).expect("text");
    // It is no formula, and stays one cell.
    assert!(text.contains(",\"'=cmd, seal: verify\","), "{text}");
    assert_eq!(records.failures()[0].step, "");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
    assert!(said[0].starts_with("PASS BAT0 serial 1001 (pack 2"), "{said:?}");
}

/// Each pack has files of its own, so a full disk was as many reasons as it had failures.
#[test]
fn regression_one_reason_was_counted_once_for_each_pack() {
    let folder = Folder::new("reasons");
    let lines = [
        "/line/000005-LEFT-before.toml: cannot be saved: No space left on device; nothing was changed",
        "/line/000006-LEFT-before.toml: cannot be saved: No space left on device; nothing was changed",
        "/line/000007-LEFT-before.toml: cannot be saved: Read-only file system; nothing was changed",
        "bq34z100-G1: identify: device type 0x0100, firmware 0x0202: this is a bq34z100-R2",
    ];
    let text = (1..).zip(lines).map(|(number, reason)| {
        let (step, reason) = (Some("checks".into()), Some(reason.into()));
        let entry = Entry { event: Event::Fail, number, step, reason, ..Entry::default() };
        serde_json::to_string(&entry).expect("JSON") + "\n"
    });
    fs::write(folder.file("line1.jsonl"), text.collect::<String>()).expect("a file");
    let failures = super::Records::read(&folder.file("line1.jsonl")).expect("a record").failures();
    let mut failures: Vec<_> = failures.iter().map(|one| (one.count, one.reason.as_str())).collect();
    failures.sort_unstable();
    let expected = [
        (1, "/line/000007-LEFT-before.toml: cannot be saved: Read-only file system"),
        (1, "bq34z100-G1: identify: device type 0x0100, firmware 0x0202"),
        (2, "... cannot be saved: No space left on device"),
    ];
    assert_eq!(failures, expected);
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
