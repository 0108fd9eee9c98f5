// SPDX-License-Identifier: MIT

//! A station that programs pack after pack.
//!
//! `pack` is a pack's way, `target` its goal, `record` the file of outcomes, and `serial` the source of numbers. Each
//! bus has its own thread; they share the record.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use jiff::Timestamp;
use nix::unistd::{User, geteuid};
use sha2::{Digest, Sha256};
use ti_gauge::calibration::Job;
use ti_gauge::chip::{Chip, Kind};
use ti_gauge::dataflash::Row;
use ti_gauge::image::{Group, Image};
use ti_gauge::journal::{Disk, Host, Journal};
use ti_gauge::keys::{Keys, Name};
use ti_gauge::text;
use ti_gauge::value::Value;

use crate::error::{Cause, Error, Result};
use crate::options::Date;
use crate::setup::Setup;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, Reach, regular};
use gauge_owner::{GaugeOptions, Run, Source, journal_dir, key_file};
use gaugefs_host::sign::Sign;
use gaugefs_host::{input, program};
use ti_gauge::notation;

mod contact;
mod desk;
mod exec;
mod first;
mod pack;
mod record;
mod records;
mod serial;
mod slot;
mod tally;
mod target;
#[cfg(test)]
mod tests;

use desk::Desk;
use first::First;
use record::{Entry, Event, Record};
pub use records::{By, Failures, Group as RecordGroup, Records};
use serial::Serials;
use slot::Place;
use tally::Tally;
pub use tally::Totals;

/// Interval of looks for a pack: shorter than any exchange.
const LOOK: Duration = Duration::from_millis(200);
/// Consecutive looks that must agree: contacts bounce.
const STEADY: u32 = 7;
/// The warning after a short break of the contact to a finished pack.
const MAYBE_ANOTHER: &str =
    "the contact was broken, so another pack may be there, which was not programmed: take it off";

/// Programs packs at all places of a station at the same time, until `packs` have been begun, there are no more, or
/// `stops` is set. Returns whether all have passed; an unfinished pack of an earlier run has not.
///
/// Each place gets a clock of its own: with one simulated clock, the waits of one place would be silence of the others.
pub fn run(
    plan: Plan,
    clock: impl Fn() -> Arc<dyn Clock>,
    screen: Box<dyn Screen>,
    scanner: Box<dyn Scanner>,
    packs: Option<u64>,
    stops: Arc<AtomicBool>,
) -> Result<bool> {
    let mut places = Place::all(&plan, clock)?;
    let station = Station::start(plan, Arc::new(Host), screen, scanner, packs, stops)?;
    station.close_unfinished(&places.iter().map(|place| &place.bench).collect::<Vec<_>>())?;
    thread::scope(|scope| {
        for place in &mut places {
            let station = &station;
            scope.spawn(move || station.run(&place.bench, &mut *place.slot));
        }
    });
    station.sum_up();
    Ok(station.all_passed())
}

/// A place where packs are connected, one after the other.
trait Slot: Send {
    fn clock(&self) -> Arc<dyn Clock>;
    fn bus(&mut self) -> Box<dyn Bus>;
    /// Whether a pack is connected; `None` if none will ever be connected again.
    fn is_there(&mut self) -> Option<bool>;
    fn done(&mut self) {}
    /// Why no pack will be connected again, if that is a failure.
    fn error(&mut self) -> Option<Error> {
        None
    }
}

/// The source of typed or scanned lines; `None` at their end.
pub trait Scanner: Send {
    /// Asks for a line; the text says for what.
    fn line(&mut self, what: &str) -> Option<String>;
}

/// Shows people what happens.
pub trait Screen: Send + Sync {
    /// The outcome of a pack, one line.
    fn outcome(&self, line: &str);
    /// Tells somebody what to do, or what the station is doing.
    fn prompt(&self, line: &str);
    /// Sets a slot's sign, with a line about it.
    fn sign(&self, _slot: &str, _sign: Sign, _what: &str) {}
    /// The outcomes of this run so far.
    fn totals(&self, _totals: &Totals) {}
}

/// How far a pack is that must not be removed.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Progress {
    /// From 1 on.
    step: usize,
    steps: usize,
    name: &'static str,
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { step, steps, name } = self;
        write!(f, "programming, do not remove ({step} of {steps}: {name})")
    }
}

struct Bench {
    name: String,
    options: GaugeOptions,
    keys: Keys,
    new_keys: Option<Keys>,
    subject: String,
    /// The folder of its journal and backups, and its name there.
    place: (PathBuf, String),
    /// What packs take at the clock of the bus.
    reach: Reach,
}

struct Station {
    plan: Plan,
    serials: Serials,
    disk: Arc<dyn Disk>,
    record: Mutex<Record>,
    desk: Desk,
    who: String,
    left: AtomicU64,
    failures: AtomicU64,
    tally: Mutex<Tally>,
    first: First,
    stops: Arc<AtomicBool>,
    halted: AtomicBool,
}

/// A station's file and its image, checked without a gauge or a record.
pub struct Plan {
    setup: Setup,
    /// The values that every pack must have.
    image: Image,
    image_name: String,
    image_sum: String,
    serial_row: Option<Row>,
    label_row: Option<Row>,
    date_row: Option<Row>,
    date: Option<Date>,
    keys: Vec<(Keys, Option<Keys>)>,
}

impl Plan {
    /// The station's name.
    pub fn name(&self) -> &str {
        &self.setup.name
    }

    /// The names of its slots.
    pub fn slots(&self) -> impl Iterator<Item = &str> {
        self.setup.gauges.iter().map(|(name, _)| name.as_str())
    }

    /// Whether undocumented bytes of packs stay.
    fn leaves_undocumented(&self) -> bool {
        self.setup.options.groups().is_ok_and(|groups| groups.contains(&Group::Undocumented))
    }

    /// Reads and checks the image and the station's file.
    pub fn read(image_path: &Path, setup: Setup) -> Result<Self> {
        let name = input::name(image_path);
        let source = input::Source::read(image_path)?;
        let image_sum = text::hex(&Sha256::digest(&source.bytes));
        let sources = setup.gauges.iter().map(|(_, gauge)| Source::of(gauge)).collect::<Result<Vec<_>>>()?;
        let chip = sources.iter().find_map(Source::chip);
        let mut image = source.image(chip, setup.options.data_flash)?;
        let refuse = |why: String| Err(Error::new(&name, Cause::Invalid, why));
        image.exclude(&setup.options.groups().map_err(of_key)?);
        if let Some(left) = image.left_out.first() {
            return refuse(format!("{}; exclude its group in the station's file, or remove it", left.text));
        }
        for source in &sources {
            if source.chip().is_some_and(|one| !std::ptr::eq(one, image.chip)) {
                return refuse(format!("it is for a {}, and {source} is none", image.chip.model));
            }
        }
        for entry in &image.entries {
            entry.not_imported(true).map_err(|error| error.within(&name))?;
        }
        let image_name = image_path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let file = setup.file.clone();
        Self::of(image, image_name, image_sum, setup).map_err(|error| error.within(&file))
    }

    /// The plan for packs with this image.
    fn of(mut image: Image, image_name: String, image_sum: String, setup: Setup) -> Result<Self> {
        let invalid = |subject: &str, why: String| Error::new(subject, Cause::Invalid, why);
        let chip = image.chip;
        if chip.access.scheme.is_ram() {
            let why = format!(
                "a {} loses its configuration with its power; gaugefs mount --profile writes it again",
                chip.model
            );
            return Err(invalid("image", why));
        }
        let station = &setup.options;
        station.check().map_err(of_key)?;
        program::check(&station.exec).map_err(|error| error.within(exec::EXEC))?;
        let serial_row = serial::row(chip, station)?;
        let label_row = serial::label_row(chip, station)?;
        let lots =
            [("pack-lot", "Pack Lot Code", station.pack_lot), ("pcb-lot", "PCB Lot Code", station.pcb_lot)];
        for (key, parameter, number) in lots {
            if let Some(number) = number {
                let row = own_row(chip, key, parameter)?;
                let value = notation::parse(row.1, number.to_string().as_bytes())
                    .map_err(|error| error.within(key))?;
                image.set(row.0, row.1, value);
            }
        }
        let date = station.date().map_err(of_key)?;
        let date_row = date.map(|_| own_row(chip, "date", "Manufacture Date")).transpose()?;
        if date_row.is_some_and(|(_, row)| !row.is_date()) {
            return Err(invalid("date", format!("how a {} stores it is not known", chip.model)));
        }
        for row in [station.serial.and(serial_row), label_row, date_row].into_iter().flatten() {
            if row.0.kind == Kind::Security {
                return Err(invalid(
                    "serial-parameter",
                    "keys cannot be changed like other parameters".into(),
                ));
            }
        }
        if !jobs(&setup).is_empty() && chip.calibration.is_none() {
            return Err(ti_gauge::calibration::not_documented(chip));
        }
        if let Some(cells) = station.cells {
            let at = chip.gate.as_ref().and_then(|gate| gate.external.as_ref().and(gate.cells));
            let Some(at) = at else {
                return Err(invalid(
                    "cells",
                    format!("no document describes how a {} is set up", chip.model),
                ));
            };
            let of_image =
                image.entries.iter().find(|entry| (entry.subclass.id, entry.parameter.offset) == at);
            if let Some(entry) = of_image.filter(|entry| entry.value != Value::Int(cells.into())) {
                let why = format!("{cells} cells in series, but the image has {}", entry.text());
                return Err(invalid("cells", why));
            }
        }
        let keys = setup.gauges.iter().map(|(name, gauge)| {
            let keys = gauge.keys(name)?;
            let new =
                station.new_key_file.as_ref().map(|path| key_file::from_file(path, name)).transpose()?;
            if new.as_ref().is_some_and(|new| Name::ALL.iter().all(|name| new.secret(*name).is_none())) {
                return Err(invalid("new-key-file", format!("it has no key for {name}")));
            }
            Ok((keys, new))
        });
        let keys = keys.collect::<Result<Vec<_>>>()?;
        let plan = Self { setup, image, image_name, image_sum, serial_row, label_row, date_row, date, keys };
        // The list's content is checked too.
        Serials::of(&plan.setup.options, plan.serial_row)?;
        Ok(plan)
    }

    /// The steps of a run, as lines.
    pub fn describe(&self) -> String {
        let Self { setup, image, .. } = self;
        let mut text = format!(
            "image {} for a {}, values: {}, SHA-256 {}\nrecord {}, images in {}\n",
            self.image_name,
            image.chip.model,
            image.entries.len(),
            self.image_sum,
            setup.record.display(),
            setup.images.display()
        );
        for (name, gauge) in &setup.gauges {
            let source =
                Source::of(gauge).map_or_else(|error| error.to_string(), |source| source.to_string());
            text += &format!("{name}: {source}\n");
        }
        text
    }

    /// Obstacles at the station's places, as far as they show without a transfer.
    pub fn check(&self, clock: &Arc<dyn Clock>) -> Vec<Error> {
        let check = |(name, gauge): &(String, GaugeOptions)| {
            let checked = Source::of(gauge).and_then(|source| source.check(Path::new(""), clock));
            checked.err().map(|error| error.within(name))
        };
        self.setup.gauges.iter().filter_map(check).collect()
    }

    /// Refuses a new record where images of these gauges exist: the lost one has the given serial numbers.
    fn check_images(&self) -> Result<()> {
        let images = &self.setup.images;
        // The image from before is saved before the pack is on record.
        let of_gauge = |name: &str| {
            let Some((number, rest)) = name.split_once('-') else { return false };
            let is_number = number.len() >= 6 && number.bytes().all(|byte| byte.is_ascii_digit());
            let after = |gauge: &str| rest.strip_prefix(gauge).and_then(|rest| rest.strip_prefix('-'));
            let mut of_names = self.setup.gauges.iter().filter_map(|(gauge, _)| after(gauge));
            is_number && of_names.any(|rest| !rest.starts_with("before."))
        };
        let found = std::fs::read_dir(images).into_iter().flatten().flatten();
        match found.map(|file| file.file_name().to_string_lossy().into_owned()).find(|name| of_gauge(name)) {
            None => Ok(()),
            Some(name) => {
                let why = format!(
                    "there is no record, but {name} in {} is of a pack that had one; put the record back, so that no \
                     serial number is given twice, or move the images away",
                    images.display()
                );
                Err(Error::new(self.setup.record.display().to_string(), Cause::Gone, why))
            }
        }
    }

    fn chip(&self) -> &'static Chip {
        self.image.chip
    }

    /// The bench of a gauge. `reach` and `journal_key` are properties of its bus.
    fn bench(&self, at: usize, subject: String, reach: Reach, journal_key: Option<String>) -> Result<Bench> {
        let (keys, new_keys) = self.keys[at].clone();
        let folder = self.setup.options.state_dir.as_deref().or(Some(&self.setup.images));
        // A mount looks for journals of packs on a bus there.
        let folder = if journal_key.is_some() { self.setup.options.state_dir.as_deref() } else { folder };
        let place = journal_dir::place(folder, journal_key)?.unwrap_or_default();
        let (name, options) = self.setup.gauges[at].clone();
        Ok(Bench { name, options, keys, new_keys, subject, place, reach })
    }
}

fn of_key((key, why): (&str, String)) -> Error {
    Error::new(key, Cause::Invalid, why)
}

fn own_row(chip: &'static Chip, key: &str, parameter: &str) -> Result<Row> {
    serial::called(chip, parameter).ok_or_else(|| {
        let why = format!("a {} has no parameter {parameter}", chip.model);
        Error::new(key, Cause::Invalid, why)
    })
}

fn jobs(setup: &Setup) -> Vec<(Job, Option<f64>)> {
    let station = &setup.options;
    let offsets = [(station.board_offset, Job::BoardOffset), (station.cc_offset, Job::CcOffset)];
    let offsets = offsets.into_iter().filter(|(wanted, _)| *wanted).map(|(_, job)| (job, Some(0.0)));
    let voltage = station.voltage.map(|actual| (Job::Voltage(actual), None));
    let temperature = station.temperature.map(|actual| (Job::Temperature(actual), None));
    let current = station.current.map(|actual| (Job::Current(actual), Some(actual)));
    offsets.chain(voltage).chain(temperature).chain(current).collect()
}

impl Bench {
    /// Nothing that writes is sent before the registers read like a gauge's.
    fn run(&self, station: &Station) -> Result<Run> {
        let chip = station.plan.image.chip;
        let no_backup = station.plan.setup.options.no_backup;
        let place = Some(self.place.clone());
        let keys = self.keys.clone();
        let run = self.options.run(keys, chip, &self.subject, place, no_backup)?;
        Ok(Run {
            reach: run.reach.narrowed(self.reach),
            journal: run.journal.map(|journal| journal.on(station.disk.clone())),
            name: self.name.clone(),
            unverified: true,
            ..run
        })
    }

    fn journals(&self, disk: &Arc<dyn Disk>) -> Journal {
        let (folder, key) = self.place.clone();
        Journal::new(folder, key, self.subject.clone()).on(disk.clone())
    }
}

impl Station {
    fn start(
        plan: Plan,
        disk: Arc<dyn Disk>,
        screen: Box<dyn Screen>,
        scanner: Box<dyn Scanner>,
        packs: Option<u64>,
        stops: Arc<AtomicBool>,
    ) -> Result<Self> {
        let record = Record::open(&*disk, &plan.setup.record)?;
        if record.is_new() {
            plan.check_images()?;
        }
        if let Some(date) = plan.date {
            pack::day(date, &pack::today(), record.last())?;
        }
        let serials = Serials::of(&plan.setup.options, plan.serial_row)?;
        let slots = plan.slots().map(String::from).collect();
        let account = || User::from_uid(geteuid()).ok().flatten().map(|user| user.name);
        // Buses often belong to root, who is not the person.
        let user = std::env::var("SUDO_USER").ok().or_else(account).unwrap_or_default();
        let host =
            regular::read_text(Path::new("/proc/sys/kernel/hostname"), regular::SYSTEM).unwrap_or_default();
        Ok(Self {
            who: format!("{user}@{}", host.trim()),
            plan,
            serials,
            disk,
            record: Mutex::new(record),
            desk: Desk::new(screen, scanner, slots),
            left: AtomicU64::new(packs.unwrap_or(u64::MAX)),
            failures: AtomicU64::new(0),
            tally: Mutex::default(),
            first: First::default(),
            stops,
            halted: AtomicBool::new(false),
        })
    }

    fn close_unfinished(&self, benches: &[&Bench]) -> Result<()> {
        let mut record = self.record();
        for entry in record.unfinished() {
            let bench = benches.iter().find(|bench| bench.name == entry.gauge);
            let journals = bench.map(|bench| bench.journals(&self.disk).unsettled()).unwrap_or_default();
            let state = match journals.first() {
                Some(path) => format!(
                    "its write is in the journal {}, and is settled when that pack answers",
                    path.display()
                ),
                None => "no write was under way, or it has been settled".to_string(),
            };
            let why =
                format!("the station was stopped while it programmed this pack; {state}; program it again");
            let why = text::printable(&why);
            let step = Some("interrupted".into());
            let mut entry = Entry { event: Event::Fail, time: self.time(), step, reason: Some(why), ..entry };
            self.hand_over(&mut entry);
            record.append(&entry)?;
            self.failures.fetch_add(1, Ordering::SeqCst);
            self.desk.outcome(&entry.gauge, false, &self.line(&entry), &self.tally().totals);
        }
        Ok(())
    }

    fn record(&self) -> MutexGuard<'_, Record> {
        self.record.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn time(&self) -> String {
        format!("{:.0}", Timestamp::now())
    }

    fn tally(&self) -> MutexGuard<'_, Tally> {
        self.tally.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn prompt(&self, bench: &str, what: &str) {
        self.desk.prompt(bench, what);
    }

    fn is_stopping(&self) -> bool {
        self.stops.load(Ordering::SeqCst)
    }

    fn seals(&self) -> bool {
        self.plan.setup.options.seal.unwrap_or(true)
    }

    /// A serial number of the record as people write it.
    fn told_serial(&self, recorded: &str) -> String {
        let row = self.plan.serial_row;
        row.map_or_else(|| recorded.into(), |row| self.serials.as_written(row, recorded))
    }

    fn line(&self, entry: &Entry) -> String {
        let serial = match (&entry.serial, &entry.scanned) {
            (Some(serial), Some(scanned)) => format!(" serial {scanned} ({serial})"),
            (Some(serial), None) => format!(" serial {}", self.told_serial(serial)),
            (None, _) => String::new(),
        };
        let label = entry.label.as_ref().map_or(String::new(), |label| format!(" {label}"));
        let number = entry.number;
        let line = match (&entry.event, &entry.reason) {
            (Event::Pass, _) => {
                let seconds = entry.seconds.unwrap_or_default();
                format!("PASS {}{label}{serial} (pack {number}, {seconds:.1} s)", entry.gauge)
            }
            (_, reason) => {
                let reason = reason.as_deref().unwrap_or("unknown");
                format!("FAIL {}{label}{serial} (pack {number}): {reason}", entry.gauge)
            }
        };
        text::printable(&line)
    }

    fn gives_serials(&self) -> bool {
        !matches!(self.serials, Serials::None)
    }

    fn jobs(&self) -> Vec<(Job, Option<f64>)> {
        jobs(&self.plan.setup)
    }

    fn entry(&self, bench: &Bench) -> Entry {
        Entry {
            number: self.record().number(),
            time: self.time(),
            station: self.plan.setup.name.clone(),
            gauge: bench.name.clone(),
            who: self.who.clone(),
            chip: self.plan.image.chip.name.into(),
            image: self.plan.image_name.clone(),
            image_sha256: self.plan.image_sum.clone(),
            ..Entry::default()
        }
    }

    /// Records the outcome. `look_again`, after the program of `exec` got PASS, may turn the line into a failure.
    fn end(&self, mut entry: Entry, look_again: impl FnOnce(&mut Entry)) -> Entry {
        entry.time = self.time();
        // It is read back, and printed as one line.
        entry.reason = entry.reason.map(|reason| text::printable(&reason));
        let was_told = self.hand_over(&mut entry);
        if was_told {
            look_again(&mut entry);
            entry.reason = entry.reason.map(|reason| text::printable(&reason));
        }
        let mut record = self.record();
        if let Err(error) = record.append(&entry) {
            let reason = entry.reason.take().map_or(String::new(), |reason| format!("{reason}; "));
            entry.event = Event::Fail;
            entry.step.get_or_insert_with(|| "record".into());
            entry.reason = Some(text::printable(&format!("{reason}{error}")));
            if record.is_broken()
                && let Err(error) = record.supersede(&entry)
            {
                let reason = entry.reason.take().unwrap_or_default();
                entry.reason = Some(format!("{reason}; do not rely on the record for this pack: {error}"));
            }
        }
        drop(record);
        if was_told && entry.event != Event::Pass {
            // The program got PASS.
            self.hand_over(&mut entry);
        }
        let has_passed = entry.event == Event::Pass;
        if !has_passed {
            self.failures.fetch_add(1, Ordering::SeqCst);
        }
        let mut tally = self.tally();
        tally.count(&entry);
        let totals = tally.totals.clone();
        drop(tally);
        self.desk.outcome(&entry.gauge, has_passed, &self.line(&entry), &totals);
        if self.plan.setup.options.stop_after_failures.is_some_and(|most| totals.in_a_row >= most)
            && !self.halted.swap(true, Ordering::SeqCst)
        {
            let (count, step) = (totals.in_a_row, entry.step.as_deref().unwrap_or("start"));
            self.desk.tell(&format!(
                "failures in a row: {count}, the last one at {step}: the station ends; find the reason before the next pack"
            ));
        }
        entry
    }

    /// Passes an outcome to the program of `exec`, whose refusal is a failure. Returns whether it took a PASS.
    fn hand_over(&self, entry: &mut Entry) -> bool {
        let has_passed = entry.event == Event::Pass;
        let known = || Some(self.told_serial(entry.serial.as_ref()?));
        let serial = entry.scanned.clone().or_else(known);
        let Err(error) = exec::run(&self.plan.setup.options.exec, entry, serial.as_deref()) else {
            return has_passed;
        };
        let reason = entry.reason.take().map_or(String::new(), |reason| format!("{reason}; "));
        entry.event = Event::Fail;
        entry.step.get_or_insert_with(|| exec::EXEC.into());
        entry.reason = Some(text::printable(&format!("{reason}{error}")));
        false
    }

    fn sum_up(&self) {
        for line in self.tally().totals.lines() {
            self.desk.tell(&line);
        }
    }

    fn all_passed(&self) -> bool {
        self.failures.load(Ordering::SeqCst) == 0
    }

    fn run(&self, bench: &Bench, slot: &mut dyn Slot) {
        self.packs(bench, slot);
        if let Some(error) = slot.error() {
            self.failures.fetch_add(1, Ordering::SeqCst);
            self.prompt(&bench.name, &error.to_string());
        }
        self.desk.sign(&bench.name, Sign::Over, "no further pack");
    }

    fn packs(&self, bench: &Bench, slot: &mut dyn Slot) {
        let mut what = "connect a pack";
        while !self.is_over()
            && self.wait(bench, slot, true, what)
            && self.may_begin(&bench.name, slot)
            && take(&self.left)
        {
            if let Err(error) = self.record().check() {
                self.failures.fetch_add(1, Ordering::SeqCst);
                return self.prompt(&bench.name, &error.to_string());
            }
            let entry = pack::program(self, bench, slot);
            slot.done();
            if !self.first.is_done() && !self.confirm(&entry) {
                self.failures.fetch_add(1, Ordering::SeqCst);
                self.halted.store(true, Ordering::SeqCst);
            }
            what = "connect the next pack";
            if self.is_over() || !self.wait(bench, slot, false, "take the pack off") {
                return;
            }
        }
    }

    fn is_over(&self) -> bool {
        self.is_stopping()
            || self.halted.load(Ordering::SeqCst)
            || self.left.load(Ordering::SeqCst) == 0
            || self.desk.has_ended()
            || self.record().is_broken()
    }

    /// Whether a pack may be begun. With `confirm-first` there is only one until one has been confirmed.
    fn may_begin(&self, name: &str, slot: &dyn Slot) -> bool {
        if !self.plan.setup.options.confirm_first {
            return true;
        }
        let mut told = false;
        while !self.is_over() {
            if self.first.may_begin() {
                return true;
            }
            if !std::mem::replace(&mut told, true) {
                self.desk.sign(name, Sign::Wait, "the first pack of the run is not confirmed yet");
            }
            slot.clock().sleep(LOOK);
        }
        false
    }

    /// Asks whether the run's first pack is right. Returns whether the station may go on.
    fn confirm(&self, entry: &Entry) -> bool {
        // No pack is left.
        if !self.plan.setup.options.confirm_first || self.left.load(Ordering::SeqCst) == 0 {
            return true;
        }
        if entry.event != Event::Pass {
            self.first.begin_again();
            return true;
        }
        let what = "the first pack has passed; check it, then type yes, or no to end";
        let answer = self.desk.ask(&entry.gauge, what, |line| match line.to_lowercase().as_str() {
            "yes" | "y" => Ok(true),
            "no" | "n" => Ok(false),
            _ => Err("that is neither yes nor no".into()),
        });
        let is_right = answer.unwrap_or_else(|error| {
            self.prompt(&entry.gauge, &error.to_string());
            false
        });
        if is_right {
            self.first.confirm();
        }
        is_right
    }

    /// Waits until a pack is there, or not, and asks for that. Returns whether it can ever happen.
    fn wait(&self, bench: &Bench, slot: &mut dyn Slot, there: bool, what: &str) -> bool {
        let (mut steady, mut told) = (0, false);
        loop {
            match slot.is_there() {
                None => return false,
                Some(found) if found == there => steady += 1,
                Some(_) => {
                    // After a quick exchange the first pack's outcome must not show for the second one.
                    if !there && std::mem::take(&mut steady) > 0 {
                        self.prompt(&bench.name, MAYBE_ANOTHER);
                        self.desk.sign(&bench.name, Sign::Look, MAYBE_ANOTHER);
                    }
                    steady = 0;
                    if !std::mem::replace(&mut told, true) {
                        self.prompt(&bench.name, what);
                        if there {
                            self.desk.sign(&bench.name, Sign::Connect, what);
                        }
                    }
                }
            }
            if steady >= STEADY {
                return true;
            }
            if self.is_over() {
                return false;
            }
            slot.clock().sleep(LOOK);
        }
    }
}

fn take(left: &AtomicU64) -> bool {
    let mut now = left.load(Ordering::SeqCst);
    while let Some(less) = now.checked_sub(1) {
        match left.compare_exchange(now, less, Ordering::SeqCst, Ordering::SeqCst) {
            Ok(_) => return true,
            Err(other) => now = other,
        }
    }
    false
}
