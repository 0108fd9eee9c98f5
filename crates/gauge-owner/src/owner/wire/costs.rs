// SPDX-License-Identifier: MIT

//! What a write costs: transfers, and calls that wait for a disk.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use super::{CASES, KNOBS, options};
use crate::owner::backup::Backup;
use crate::owner::rig::{INTERVAL, Rig};
use crate::owner::{Handle, Run, operations as op};
use gauge_bus::clock::{Clock as _, SimClock};
use gauge_bus::{Bus, BusError, Reach, wire_bits};
use gauge_sim::SimBus;
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, Row};
use ti_gauge::gauge::Seal;
use ti_gauge::journal::{Disk, File, Host, Journal};
use ti_gauge::value::Value;

/// A disk that counts how often it is waited for.
#[derive(Clone, Debug, Default)]
struct Counting(Arc<AtomicU64>);

#[derive(Debug)]
struct CountingFile(Box<dyn File>, Counting);

impl Counting {
    fn count(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    fn counted(&self, file: io::Result<Box<dyn File>>) -> io::Result<Box<dyn File>> {
        Ok(Box::new(CountingFile(file?, self.clone())))
    }
}

impl Disk for Counting {
    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        Host.create_folder(folder)
    }

    fn exists(&self, path: &Path) -> bool {
        Host.exists(path)
    }

    fn read(&self, path: &Path) -> io::Result<String> {
        Host.read(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.counted(Host.create(path))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.counted(Host.open(path))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        Host.rename(from, to)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        Host.list(folder)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        Host.remove(path)
    }

    fn sync(&self, folder: &Path) -> io::Result<()> {
        self.count();
        Host.sync(folder)
    }
}

impl File for CountingFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.append(bytes)
    }

    fn reserve(&mut self, length: u64) -> io::Result<()> {
        self.0.reserve(length)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.1.count();
        self.0.sync()
    }
}

/// What a report of a bridge carries, and the reports of a transfer without data: a request, the state, the answer.
const REPORT: u16 = 60;
const REPORTS: u32 = 3;

/// How slow a bus is.
#[derive(Clone, Copy, Default)]
struct Pace {
    a_bit: Duration,
    /// Of a bridge behind USB.
    a_report: Duration,
}

/// A bus that takes its time, and notes what is shown of a write meanwhile.
struct Slow {
    bus: SimBus,
    pace: Pace,
    clock: Arc<OnceLock<Arc<SimClock>>>,
    shown: Arc<Shown>,
}

/// What was shown of a write at each transfer.
#[derive(Default)]
struct Shown {
    handle: OnceLock<Handle>,
    progress: Mutex<Vec<(Option<String>, Option<String>)>>,
}

impl Bus for Slow {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if let Some(clock) = self.clock.get() {
            let bits = wire_bits(write.len(), read.len()) as u32;
            clock.sleep(self.pace.a_bit * bits + self.pace.a_report * REPORTS);
        }
        if let Some(handle) = self.shown.handle.get() {
            let shown = (handle.progress(), handle.long_progress());
            self.shown.progress.lock().expect("nobody panics").push(shown);
        }
        self.bus.transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}

/// A part whose journals and backups are in a folder.
struct Bench {
    rig: Rig,
    disk: Counting,
    folder: PathBuf,
    row: Row,
    shown: Arc<Shown>,
    /// Transfers, milliseconds and calls that wait for the disk of each write.
    costs: Vec<[u64; 3]>,
}

impl Bench {
    fn new(chip: &'static Chip, parameter: &str) -> Self {
        Self::on(chip, parameter, Pace::default())
    }

    fn on(chip: &'static Chip, parameter: &str, pace: Pace) -> Self {
        let folder = std::env::temp_dir().join(format!("gaugefs-costs-{}-{}", chip.name, std::process::id()));
        let disk = Counting::default();
        fs::create_dir(&folder).expect("a folder");
        let journal = Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
        let run = Run {
            options: options(),
            backup: Some(Backup::new(folder.clone(), "i2c-1-55".into())),
            journal: Some(journal.on(Arc::new(disk.clone()))),
            ..Run::default()
        };
        let (clock, shown) = (Arc::new(OnceLock::new()), Arc::new(Shown::default()));
        let slow = |bus| Slow { bus, pace, clock: clock.clone(), shown: shown.clone() };
        let mut rig = Rig::on(chip.name, run, |bus| Box::new(slow(bus)));
        clock.set(rig.clock.clone()).expect("it was not set");
        if pace.a_report > Duration::ZERO {
            rig.sim.set_reach(Reach::of_data(REPORT));
        }
        for (knob, setting) in KNOBS {
            rig.sim.set(knob, setting).unwrap_or_else(|error| panic!("{}: {error}", chip.name));
        }
        rig.start().expect("it answers");
        let all = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |found| (row, found)));
        let row = all.into_iter().find(|(_, found)| found.name == parameter).expect("a parameter");
        Self { rig, disk, folder, row, shown, costs: Vec::new() }
    }

    /// Adds to the parameter's value, as it was at first.
    fn write(&mut self, value: i64) {
        let chip = self.rig.handle.chip();
        let change = Change::of_value(chip, self.row, &Value::Int(value), true).expect("it is in range");
        let now = |bench: &Self| {
            let milliseconds = bench.rig.clock.now().as_millis().try_into().expect("not so long");
            [bench.rig.transfers(), milliseconds, bench.disk.0.load(Ordering::Relaxed)]
        };
        let before = now(self);
        self.rig.ask(&op::WRITE, vec![change]).expect("written");
        let after = now(self);
        self.costs.push(std::array::from_fn(|at| after[at] - before[at]));
        self.rig.poll_after(INTERVAL);
    }

    /// The parameter's value.
    fn value(&mut self) -> i64 {
        let (subclass, parameter) = self.row;
        let at = self.rig.handle.chip().subclasses.iter().position(|one| std::ptr::eq(one, subclass));
        let read = self.rig.ask(&op::READ, vec![at.expect("it is of the table")]).expect("the default key");
        let at = usize::from(parameter.offset - subclass.start());
        let bytes = &read[0][at..at + parameter.kind.size()];
        match self.rig.handle.chip().layout.decode(parameter.kind, bytes) {
            Value::Int(number) => number,
            Value::Float(_) | Value::Text(_) => unreachable!("it is a whole number"),
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// The most transfers and calls that wait for the disk, besides two for the backup: of a first write with its backup, of a
/// later one, and of one that changes nothing. Most of those of a part with RAM wait for CONFIG UPDATE.
const CEILINGS: [(&str, [(u64, u64); 3]); 15] = [
    ("bq34z100-g1", [(120, 4), (40, 2), (21, 2)]),
    ("bq34z100-r2", [(128, 4), (40, 2), (21, 2)]),
    ("bq27520-g3", [(130, 4), (42, 2), (25, 2)]),
    ("bq27500", [(129, 4), (42, 2), (25, 2)]),
    ("bq27500-v130", [(129, 4), (42, 2), (25, 2)]),
    ("bq27742-g1", [(137, 4), (42, 2), (25, 2)]),
    ("bq27441-g1", [(190, 4), (134, 3), (26, 2)]),
    ("bq27421-g1", [(190, 4), (134, 3), (26, 2)]),
    ("bq27426", [(163, 4), (94, 3), (26, 2)]),
    ("bq27427", [(146, 4), (94, 3), (26, 2)]),
    ("bq27621-g1", [(195, 4), (112, 2), (26, 2)]),
    ("bq27220", [(192, 4), (155, 2), (30, 2)]),
    ("bq34110", [(118, 4), (52, 2), (41, 2)]),
    ("bq35100", [(137, 4), (50, 2), (41, 2)]),
    // Its backup has 90 groups.
    ("bq28z610", [(205, 4), (60, 2), (50, 2)]),
];

/// No write fails by time alone where gauge and bus work.
#[test]
fn every_part_can_be_written_to_on_a_slow_bus() {
    let slow = Pace { a_bit: Duration::from_micros(100), ..Pace::default() };
    let bridge = Pace { a_report: Duration::from_millis(5), ..Pace::default() };
    for (name, pace) in [("10 kHz", slow), ("5 ms a report", bridge)] {
        for (chip, parameter, _) in &CASES {
            let chip = Chip::by_name(chip).expect("it has a table");
            let value = Bench::new(chip, parameter).value();
            let mut bench = Bench::on(chip, parameter, pace);
            for value in [value ^ 1, value] {
                bench.write(value);
            }
            println!("{name}, {}: {:?}", chip.name, bench.costs);
        }
    }
}

#[test]
fn a_write_costs_no_more_than_that() {
    let mut over = Vec::new();
    for ((chip, parameter, _), (_, ceilings)) in CASES.iter().zip(CEILINGS) {
        let chip = Chip::by_name(chip).expect("it has a table");
        let value = Bench::new(chip, parameter).value();
        let mut bench = Bench::new(chip, parameter);
        for value in [value ^ 1, value, value] {
            bench.write(value);
        }
        for (&[transfers, milliseconds, syncs], (most, most_syncs)) in bench.costs.iter().zip(ceilings) {
            println!("{}: {transfers} transfers, {milliseconds} ms, {syncs} fsyncs", chip.name);
            if transfers > most || syncs > most_syncs {
                over.push(format!("{}: {transfers} transfers, {syncs} fsyncs", chip.name));
            }
        }
    }
    assert!(over.is_empty(), "{over:#?}");
}

/// A gauge that was found open is owed nothing before it is known what is written.
#[test]
fn a_gauge_that_is_open_has_a_journal_for_what_is_written_only() {
    for (chip, parameter, _) in &CASES {
        let chip = Chip::by_name(chip).expect("it has a table");
        let mut bench = Bench::new(chip, parameter);
        bench.rig.ask(&op::SEAL, Seal::Unsealed).expect("the default key");
        let value = bench.value();
        for value in [value ^ 1, value, value] {
            bench.write(value);
        }
        let syncs: Vec<u64> = bench.costs.iter().map(|&[.., syncs]| syncs).collect();
        // The file, its name, and its end; then the file only.
        assert_eq!(syncs, [3, 2, 0], "{}", chip.name);
    }
}

#[test]
fn a_write_shows_how_far_it_is() {
    let pace = Pace { a_report: Duration::from_millis(20), ..Pace::default() };
    let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
    let mut bench = Bench::on(chip, "Cell Terminate Voltage", pace);
    let handle = bench.rig.handle.clone();
    assert!(bench.shown.handle.set(handle).is_ok());
    bench.write(3100);
    let shown = std::mem::take(&mut *bench.shown.progress.lock().expect("nobody panics"));
    let blocks = shown.iter().filter_map(|(progress, _)| progress.as_deref());
    let mut blocks: Vec<&str> = blocks.collect();
    blocks.dedup();
    // The block with the marks was read before, so that two are done at once.
    let saved: Vec<String> = (0..=24).map(|done| format!("saving {done}/24")).collect();
    let (first, rest) = blocks.split_at(blocks.len().saturating_sub(2));
    assert_eq!((first.first(), first.last()), (Some(&"saving 0/24"), Some(&"saving 24/24")));
    assert!(first.len() > 20 && first.iter().all(|one| saved.iter().any(|saved| saved == one)), "{first:?}");
    assert_eq!(rest, ["committing 0/1", "committing 1/1"]);
    let long: Vec<&str> = shown.iter().filter_map(|(_, long)| long.as_deref()).collect();
    assert!(long[0].starts_with("writing for 3 s: saving "), "{}", long[0]);
    assert!(long.iter().any(|text| text.ends_with(" s: committing 0/1 blocks")), "{long:?}");
    assert_eq!((bench.rig.handle.progress(), bench.rig.handle.long_progress()), (None, None));
}
