// SPDX-License-Identifier: MIT

//! A pack, from the first look to the record's line.
//!
//! Everything is asked of the owner, as in a mount. Nothing is changed before `begun` is on disk. Only a complete final
//! reading, compared bit by bit, makes a pack pass.

use std::time::Duration;

use jiff::Timestamp;
use ti_gauge::calibration::Job;
use ti_gauge::chip::{Chip, Role};
use ti_gauge::dataflash::{Change, Decision};
use ti_gauge::date;
use ti_gauge::image::{Group, Image, toml};
use ti_gauge::journal;
use ti_gauge::keys::{KeyChange, Name};
use ti_gauge::text;
use ti_gauge::value::Value;

use super::contact::Watch;
use super::exec::EXEC;
use super::record::{Entry, Event, Measured, Record};
use super::serial::Serials;
use super::target::{self, Flash, Place};
use super::{Bench, Progress, Sign, Slot, Station, serial};
use crate::error::{Cause, Error, Result};
use crate::options::{Date, Seen, Unsettled};
use gauge_owner::{Direct, Run, Seal, operations as op};
use gaugefs_host::chemistry;

/// Tries for a newly connected pack, and readings with a breaking contact; the pause is for the former.
const TRIES: usize = 4;
const AGAIN: Duration = Duration::from_secs(1);
/// Limit for a gauge to settle what a failed access has left.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long a calibration waits for its load to be on or off, and the interval of looks.
const LOAD_PATIENCE: Duration = Duration::from_secs(120);
const LOAD_LOOK: Duration = Duration::from_secs(1);
/// Largest current, in mA, that counts as no load.
const NO_LOAD_MA: f64 = 10.0;
/// Year of the first gaugefs: a clock that was set cannot show an earlier day.
const FIRST_DAY: &str = "2026-01-01";
/// Share of a load that may be missing.
const LOAD_TOLERANCE: f64 = 0.25;

const LONGEST_LABEL: usize = 64;

struct Task<'a> {
    station: &'a Station,
    bench: &'a Bench,
    gauge: Direct,
    watch: Watch,
    entry: Entry,
    begun: bool,
    /// Transfers of an earlier owner.
    transfers: u64,
    has_new_keys: bool,
    step: Step,
    /// Steps at which the pack must not be removed.
    busy: Vec<Step>,
    /// The pack's data flash, if it may pass.
    last: Option<Flash>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Identify,
    Settle,
    Read,
    Scan,
    Check,
    BringUp,
    Image,
    Calibrate,
    Keys,
    Verify,
    Exec,
}

impl Step {
    fn name(self) -> &'static str {
        match self {
            Self::Identify => "identification",
            Self::Settle => "settling",
            Self::Read => "reading",
            Self::Scan => "scan",
            Self::Check => "checks",
            Self::BringUp => "bring-up",
            Self::Image => "image",
            Self::Calibrate => "calibration",
            Self::Keys => "keys",
            Self::Verify => "verification",
            Self::Exec => EXEC,
        }
    }
}

#[derive(Default)]
struct Given {
    serial: Option<Value>,
    /// For the parameter with the label.
    label: Option<Value>,
    /// The number that the pack keeps.
    own: Option<String>,
}

pub(super) fn program(station: &Station, bench: &Bench, slot: &mut dyn Slot) -> Entry {
    let clock = slot.clock();
    let since = clock.now();
    let mut entry = station.entry(bench);
    let run = match bench.run(station) {
        Ok(run) => run,
        Err(error) => {
            entry.reason = Some(error.to_string());
            return station.end(entry, |_| ());
        }
    };
    let watch = Watch::new(clock.clone());
    let mut task = Task {
        station,
        bench,
        gauge: connect(station, slot, &watch, run),
        watch,
        entry,
        begun: false,
        transfers: 0,
        has_new_keys: false,
        step: Step::Identify,
        busy: Vec::new(),
        last: None,
    };
    match task.run(slot) {
        Ok(()) => task.entry.event = Event::Pass,
        Err(error) => task.failed(&error),
    }
    let mut entry = std::mem::take(&mut task.entry);
    entry.transfers = Some(task.transfers + transfers(&task.gauge));
    entry.seconds = Some((clock.now() - since).as_millis() as f64 / 1000.0);
    station.end(entry, |entry| {
        std::mem::swap(entry, &mut task.entry);
        if let Err(error) = task.assure_not_swapped() {
            task.failed(&error);
        }
        std::mem::swap(entry, &mut task.entry);
    })
}

fn connect(station: &Station, slot: &mut dyn Slot, watch: &Watch, run: Run) -> Direct {
    let bus = Box::new(watch.over(slot.bus()));
    Direct::new(station.plan.image.chip, bus, slot.clock(), run)
}

fn transfers(gauge: &Direct) -> u64 {
    let list = gauge.handle.statistics();
    list.iter().find(|(name, _)| *name == "transfers").map_or(0, |(_, count)| *count)
}

fn refuse(subject: &str, why: String) -> Error {
    Error::new(subject, Cause::NotPermitted, why)
}

impl Task<'_> {
    fn chip(&self) -> &'static Chip {
        self.station.plan.image.chip
    }

    fn run(&mut self, slot: &mut dyn Slot) -> Result<()> {
        let before = self.identify(slot)?;
        let readings = self.readings();
        // Only an open gauge shows that a journal waits for it.
        self.at(Step::Settle);
        self.settle_before(slot)?;
        self.at(Step::Scan);
        let given = self.scan(&before)?;
        let (asked, brought_up) = self.prepare(&before, &given)?;
        let now = brought_up.as_ref().unwrap_or(&before);
        self.at(Step::Image);
        self.write(&asked, now)?;
        let (expected, calibrated) = self.calibrate_written(slot, &asked, now)?;
        if self.bench.new_keys.is_some() {
            self.at(Step::Keys);
        }
        self.change_keys()?;
        self.at(Step::Verify);
        self.seal()?;
        let last = self.verify(|last| match &expected {
            Some(expected) => {
                target::check(&asked, last, &calibrated)?;
                last.check_same(expected, &[])
            }
            None => target::check_programmed(&asked, last, now),
        })?;
        self.note_flash(&before, &last)?;
        self.note_readings(readings);
        self.last = Some(last);
        if !self.station.plan.setup.options.exec.is_empty() {
            self.at(Step::Exec);
        }
        Ok(())
    }

    /// Opens the gauge, settles what an earlier pack may have left, and reads data flash.
    fn identify(&mut self, slot: &mut dyn Slot) -> Result<Flash> {
        self.at(Step::Identify);
        self.open(slot)?;
        self.at(Step::Settle);
        let is_new = self.settle_before(slot)?;
        self.at(Step::Read);
        self.first_look(slot, is_new)
    }

    /// Checks everything, records that the pack is begun, and sets up a new board. Returns the wanted values, and the data
    /// flash of a new board.
    fn prepare(&mut self, before: &Flash, given: &Given) -> Result<(Image, Option<Flash>)> {
        self.at(Step::Check);
        let is_new_board = self.needs_bring_up(before)?;
        self.busy = self.busy_steps(is_new_board);
        // This pack's first record: a full disk must be noticed before anything is touched.
        self.entry.before = Some(self.save(&before.image(), "before")?);
        let mut asked = None;
        let is_unsealed = self.gauge.handle.published().seal == Seal::Unsealed;
        if is_new_board || is_unsealed {
            // Writes cannot be checked before the bring-up, or before its key has been tried. Until then it has no
            // serial number.
            target::changes(&self.wanted(before, given)?, before, self.gauge.handle.allows_unproven())?;
            self.record_begun(|_, _| Ok(()))?;
        } else {
            asked = Some(self.begin(before, given)?);
        }
        if is_unsealed {
            // A write may end with a reset, which seals the pack, so its key has to be tried first.
            self.seal()?;
        }
        let mut brought_up = None;
        if is_new_board {
            self.at(Step::BringUp);
            brought_up = Some(self.bring_up()?);
        }
        let asked = match asked {
            Some(asked) => asked,
            None => {
                self.at(Step::Check);
                self.begin(brought_up.as_ref().unwrap_or(before), given)?
            }
        };
        Ok((asked, brought_up))
    }

    /// Calibrates a pack with the image. Returns its data flash, if it is known before the end, and the places of the
    /// results.
    fn calibrate_written(
        &mut self,
        slot: &mut dyn Slot,
        asked: &Image,
        now: &Flash,
    ) -> Result<(Option<Flash>, Vec<Place>)> {
        // A complete reading takes longer than the write. It is made before other changes, and at the end.
        let mut expected = None;
        if !self.station.jobs().is_empty() || self.bench.new_keys.is_some() {
            let programmed = self.look()?;
            target::check_programmed(asked, &programmed, now)?;
            expected = Some(programmed);
        }
        if !self.station.jobs().is_empty() {
            self.at(Step::Calibrate);
        }
        let calibrated = self.calibrate(slot)?;
        if let Some(programmed) = expected.as_ref().filter(|_| !calibrated.is_empty()) {
            let flash = self.look()?;
            flash.check_same(programmed, &calibrated)?;
            expected = Some(flash);
        }
        Ok((expected, calibrated))
    }

    /// Records the data flash of a finished pack, and saves it under its serial number.
    fn note_flash(&mut self, before: &Flash, last: &Flash) -> Result<()> {
        self.entry.fingerprint = Some(last.fingerprint());
        self.entry.changes = last.changed_since(before);
        let name = self
            .entry
            .serial
            .as_deref()
            .unwrap_or("after")
            .replace(|letter: char| !letter.is_ascii_alphanumeric(), "_");
        self.entry.after = Some(self.save(&last.image(), &name)?);
        Ok(())
    }

    /// Goes to a step, and shows it if the pack must not be removed. A wait for a scan shows when it is asked for.
    fn at(&mut self, step: Step) {
        self.step = step;
        if step == Step::Scan {
            return;
        }
        let (desk, name) = (&self.station.desk, &self.bench.name);
        match self.busy.iter().position(|busy| *busy == step) {
            Some(at) => {
                let progress = Progress { step: at + 1, steps: self.busy.len(), name: step.name() };
                desk.progress(name, &progress);
            }
            None => desk.sign(name, Sign::Busy, step.name()),
        }
    }

    fn busy_steps(&self, is_new_board: bool) -> Vec<Step> {
        let steps = [
            (Step::BringUp, is_new_board),
            (Step::Image, true),
            (Step::Calibrate, !self.station.jobs().is_empty()),
            (Step::Keys, self.bench.new_keys.is_some()),
            (Step::Verify, true),
            (Step::Exec, !self.station.plan.setup.options.exec.is_empty()),
        ];
        steps.into_iter().filter(|(_, is_there)| *is_there).map(|(step, _)| step).collect()
    }

    fn open(&mut self, slot: &mut dyn Slot) -> Result<()> {
        let mut outcome = self.gauge.open();
        for _ in 1..TRIES {
            match &outcome {
                Err(error) if !matches!(error.cause(), Cause::NotPermitted | Cause::Io(_)) => {
                    slot.clock().sleep(AGAIN);
                    outcome = self.gauge.open();
                }
                _ => break,
            }
        }
        outcome?;
        let published = self.gauge.handle.published();
        match published.limited {
            Some(limited) => {
                Err(refuse(limited.name(self.chip()), limited.why(self.chip(), &published.answers)))
            }
            None => Ok(()),
        }
    }

    /// Settles what an earlier pack, or a stopped station, has left. Returns whether there was nothing.
    fn settle_before(&mut self, slot: &mut dyn Slot) -> Result<bool> {
        let Some(mut left) = self.gauge.settle(PATIENCE) else {
            self.keep_journals();
            return Ok(true);
        };
        if self.finish_keys(slot).is_ok() {
            // Another key may have been lost with the changed one.
            match self.gauge.settle(PATIENCE) {
                Some(other) => left = other,
                None => return Ok(false),
            }
        }
        let (why, needs_decision) = left;
        if !needs_decision
            || self.station.plan.setup.options.unsettled.unwrap_or_default() == Unsettled::Refuse
        {
            let what = format!(
                "{why}; connect the pack that was begun before, mount it and use gaugefs settle, or set unsettled = \
                 \"discard\" in the station's file"
            );
            return Err(Error::new("journal", Cause::Busy, what));
        }
        self.gauge.ask(&op::SETTLE, Some(Decision::Discard))?;
        self.keep_journals();
        Ok(false)
    }

    /// Completes an interrupted change of keys if this station knows both keys. Keys change in the order of their
    /// names, so earlier ones have changed already.
    fn finish_keys(&mut self, slot: &mut dyn Slot) -> Result<()> {
        let names = self.gauge.owed_keys();
        let unknown = || refuse("keys", "the keys of the interrupted change are not known".into());
        let (Some(new), Some(first)) = (&self.bench.new_keys, names.first()) else { return Err(unknown()) };
        let mut run = self.bench.run(self.station)?;
        for name in Name::ALL.into_iter().take_while(|name| name != first) {
            if let Some(key) = new.secret(name) {
                run.keys.set(name, &key);
            }
        }
        self.transfers += transfers(&self.gauge);
        self.gauge = connect(self.station, slot, &self.watch, run);
        self.open(slot)?;
        for name in self.gauge.owed_keys() {
            let old = self.bench.keys.secret(name).or_else(|| self.gauge.default_key(name));
            let (Some(old), Some(new)) = (old, new.secret(name)) else { return Err(unknown()) };
            let change = KeyChange { name, old, new };
            self.gauge.ask(&op::KEYS, change)?;
        }
        Ok(())
    }

    /// Moves dismissed journals beside the images, where they replace nothing.
    fn keep_journals(&self) {
        for (number, dismissed) in self.bench.journals(&self.station.disk).dismissed().iter().enumerate() {
            let number = if number == 0 { String::new() } else { format!("-{number}") };
            let name = format!("{}{number}.journal", self.name("found"));
            let kept = self.station.plan.setup.images.join(name);
            if let Err(error) = self.station.disk.rename_new(dismissed, &kept) {
                let what = format!("{} cannot be moved to {}: {error}", dismissed.display(), kept.display());
                self.station.prompt(&self.bench.name, &what);
            }
        }
    }

    /// Reads the pack, and refuses one that was programmed before. Without a transfer since the opening, registers are
    /// not read again: a gauge allows that only twice a second.
    fn first_look(&mut self, slot: &mut dyn Slot, is_new: bool) -> Result<Flash> {
        let is_new = is_new && self.watch.breaks() == 0 && !self.watch.may_be_exchanged();
        let look = if is_new { Flash::of_new(&mut self.gauge) } else { self.look() };
        let flash = match look {
            Err(error) if matches!(error.cause(), Cause::NotPermitted) => {
                let found = self.look_with_new_keys(slot);
                let found = found.or_else(|| self.look_with_erased_key(slot));
                found.ok_or_else(|| {
                    // Its serial number is not among the registers read first.
                    let _ = self.gauge.ask(&op::REFRESH, ());
                    self.with_number(&error)
                })?
            }
            read => read?,
        };
        self.gauge.check_erased()?;
        self.entry.serial_before = self.station.plan.serial_row.and_then(|row| flash.text(row));
        let fingerprint = flash.fingerprint();
        self.entry.found = Some(fingerprint.clone());
        let record = self.station.record();
        if let Some(seen) = record.seen(&fingerprint) {
            self.entry.seen = Some(seen.number);
            if self.station.plan.setup.options.seen.unwrap_or_default() == Seen::Refuse {
                let serial = seen.serial.as_ref().map_or(String::new(), |serial| {
                    format!(" as serial number {}", self.station.told_serial(serial))
                });
                let why = format!(
                    "it was programmed before{serial}, at {} (number {} of the record); nothing was changed. seen = \
                     \"redo\" in the station's file programs it again",
                    seen.time, seen.number
                );
                return Err(refuse("pack", why));
            }
        }
        drop(record);
        if let Some(chemistry) =
            self.station.plan.image.chemistry.filter(|_| !self.station.plan.setup.options.same_chemistry)
        {
            let id = self.gauge.handle.published().answers.chem_id;
            let id = id.map_or(String::new(), |id| format!("0x{id:04x}"));
            let gauge = &mut self.gauge;
            let told = "set same-chemistry = true in the station's file";
            chemistry::check("chemistry", flash.chip, chemistry, (&id, told), |code| {
                gauge.ask(&op::CONTROL, code)?;
                let answer = gauge.handle.published().control().filter(|(asked, _)| *asked == code);
                answer.map(|(_, answer)| answer).ok_or_else(|| refuse("chemistry", "no answer".into()))
            })?;
        }
        Ok(flash)
    }

    /// Opens a pack that was programmed before with the new keys.
    fn look_with_new_keys(&mut self, slot: &mut dyn Slot) -> Option<Flash> {
        let new = self.bench.new_keys.as_ref()?;
        let mut run = self.bench.run(self.station).ok()?;
        for name in Name::ALL {
            if let Some(key) = new.secret(name) {
                run.keys.set(name, &key);
            }
        }
        self.transfers += transfers(&self.gauge);
        self.gauge = connect(self.station, slot, &self.watch, run);
        self.open(slot).ok()?;
        self.has_new_keys = true;
        self.look().ok()
    }

    /// Opens a pack whose keys a loss of power has erased; it gets its keys again.
    fn look_with_erased_key(&mut self, slot: &mut dyn Slot) -> Option<Flash> {
        self.bench.new_keys.as_ref()?.secret(Name::Unseal)?;
        let mut run = self.bench.run(self.station).ok()?;
        run.keys.set(Name::Unseal, &[0xffff; 2].into());
        self.transfers += transfers(&self.gauge);
        self.gauge = connect(self.station, slot, &self.watch, run);
        self.has_new_keys = false;
        self.open(slot).ok()?;
        self.look().ok()
    }

    /// An error about keys, with the record's facts about a pack that shows its serial number.
    fn with_number(&self, error: &Error) -> Error {
        let chip = self.chip();
        let number = || {
            let register = chip.serial_register()?;
            let number = self.gauge.handle.published().snapshot.as_ref()?.value(register)?;
            let shown = serial::shown(self.station.plan.serial_row?, &Value::Int(number));
            let pack = self.station.record().passed(&shown)?;
            Some((self.station.told_serial(&shown), pack))
        };
        match number() {
            Some((serial, pack)) => refuse(
                "keys",
                format!(
                    "{error}; it shows the serial number {serial}, which pack number {pack} of the record has"
                ),
            ),
            None => error.clone(),
        }
    }

    fn scan(&mut self, before: &Flash) -> Result<Given> {
        let station = self.station;
        let own = self.entry.seen.and_then(|_| self.entry.serial_before.clone());
        let mut given = Given { own, ..Given::default() };
        if station.plan.setup.options.label {
            given.label = self.scan_label()?;
        }
        let row = station.plan.serial_row.filter(|_| station.serials.are_scanned());
        let Some(row) = row else {
            // The pack may have been exchanged during the scan.
            return match self.entry.label.clone() {
                None => Ok(given),
                Some(label) => self.assure_not_exchanged(before, &label).map(|()| given),
            };
        };
        let own = &given.own;
        let (value, line) = station.desk.ask(&self.bench.name, "scan the serial number", |line| {
            let value = Serials::scanned(row, line)?;
            let shown = serial::shown(row, &value);
            if let Some(own) = own.as_ref().filter(|own| **own != shown) {
                return Err(format!(
                    "{line} is for another pack: the one that is there has the serial number {own}"
                ));
            }
            let record = station.record();
            match record.taken(&shown).filter(|_| own.is_none()) {
                Some(pack) => Err(taken_by(&shown, pack)),
                None => Ok((value, line.to_string())),
            }
        })?;
        let shown = serial::shown(row, &value);
        station.prompt(&self.bench.name, &format!("{line} ({shown})"));
        self.entry.scanned = Some(line).filter(|line| *line != shown);
        given.serial = Some(value);
        self.assure_not_exchanged(before, &shown).map(|()| given)
    }

    /// Checks that the pack was not exchanged during a scan.
    fn assure_not_exchanged(&mut self, before: &Flash, scanned: &str) -> Result<()> {
        self.look().and_then(|now| now.check_same(before, &[])).map_err(|error| {
            refuse("pack", format!("it is not the one for which {scanned} was scanned: {error}"))
        })
    }

    fn scan_label(&mut self) -> Result<Option<Value>> {
        let station = self.station;
        let (row, seen) = (station.plan.label_row, self.entry.seen);
        let (value, label) = station.desk.ask(&self.bench.name, "scan the label", |line| {
            if text::printable(line) != *line || line.len() > LONGEST_LABEL {
                return Err(format!("a label has at most {LONGEST_LABEL} characters that can be printed"));
            }
            if let Some(pack) = station.record().labelled(line).filter(|pack| Some(*pack) != seen) {
                return Err(label_of(line, pack));
            }
            let value = row.map(|row| Serials::scanned(row, line)).transpose()?;
            Ok((value, line.to_string()))
        })?;
        station.prompt(&self.bench.name, &label);
        self.entry.label = Some(label);
        Ok(value)
    }

    /// The wanted values, without a serial number that nobody has scanned.
    fn wanted(&self, now: &Flash, given: &Given) -> Result<Image> {
        let station = self.station;
        let mut asked = station.plan.image.clone();
        if station.plan.leaves_undocumented() {
            asked.keep_reserved(&now.image());
            asked.exclude(&[Group::Undocumented]);
        }
        if let (Some(row), Some(value)) = (station.plan.serial_row, &given.serial) {
            asked.set(row.0, row.1, value.clone());
        }
        if let (Some(row), Some(value)) = (station.plan.label_row, &given.label) {
            asked.set(row.0, row.1, value.clone());
        }
        if let (Some(row), Some(date)) = (station.plan.date_row, station.plan.date) {
            let day = day(date, &today(), station.record().last())?;
            asked.set(row.0, row.1, Value::Int(day));
        }
        Ok(asked)
    }

    /// Makes every check of the writes, then gives the pack its serial number and records it. Returns the wanted
    /// values.
    fn begin(&mut self, now: &Flash, given: &Given) -> Result<Image> {
        let station = self.station;
        let mut asked = self.wanted(now, given)?;
        let changes = target::changes(&asked, now, self.gauge.handle.allows_unproven())?;
        if !changes.is_empty() {
            self.gauge.ask(&op::CHECK, changes)?;
        }
        let also_unproven = self.gauge.handle.allows_unproven();
        self.record_begun(|entry, record| {
            let Some(row) = station.plan.serial_row else { return Ok(()) };
            let number = match (&given.serial, &given.own) {
                (Some(value), _) => Some(value.clone()),
                (None, Some(_)) if station.gives_serials() => {
                    now.number((row.0.id, row.1.offset)).map(Value::Int)
                }
                (None, _) => station.serials.next(row, record)?,
            };
            let Some(value) = number else { return Ok(()) };
            let shown = serial::shown(row, &value);
            // Another bench may have taken it meanwhile.
            if let Some(pack) = record.taken(&shown).filter(|_| given.own.is_none()) {
                return Err(refuse("serial number", taken_by(&station.told_serial(&shown), pack)));
            }
            asked.set(row.0, row.1, value);
            entry.serial = Some(shown);
            // Writes that are not possible are refused first.
            target::changes(&asked, now, also_unproven).map(drop)
        })?;
        Ok(asked)
    }

    /// Records that the pack is begun. `give` runs while the record is this pack's alone.
    fn record_begun(&mut self, give: impl FnOnce(&mut Entry, &Record) -> Result<()>) -> Result<()> {
        let mut record = self.station.record();
        if let Some(label) = &self.entry.label
            && let Some(pack) = record.labelled(label)
            && pack != self.entry.number
            && Some(pack) != self.entry.seen
        {
            return Err(refuse("label", label_of(label, pack)));
        }
        give(&mut self.entry, &record).inspect_err(|_| self.entry.serial = None)?;
        self.entry.event = Event::Begun;
        self.entry.time = self.station.time();
        let appended = record.append(&self.entry);
        self.entry.event = Event::Fail;
        appended?;
        self.begun = true;
        Ok(())
    }

    fn needs_bring_up(&self, before: &Flash) -> Result<bool> {
        let station = &self.station.plan.setup.options;
        let (Some(cells), Some(_)) = (station.cells, station.divider) else { return Ok(false) };
        let gate = self.chip().gate.as_ref().and_then(|gate| Some((gate.external.as_ref()?, gate.cells?)));
        let Some((external, cells_at)) = gate else {
            return Err(refuse("bring-up", format!("no document describes that of a {}", self.chip().model)));
        };
        let size = self.chip().parameter(external.byte.0, external.byte.1).map_or(1, |row| row.kind.size());
        let bit = i64::from(external.mask) << self.chip().layout.shift(size, 0);
        let is_set = before.number(external.byte).is_some_and(|word| word & bit != 0);
        Ok(!is_set || before.number(cells_at) != Some(cells.into()))
    }

    fn bring_up(&mut self) -> Result<Flash> {
        let station = &self.station.plan.setup.options;
        let (cells, divider) = (station.cells.unwrap_or(1), station.divider.unwrap_or_default());
        let job = Job::BringUp { cells, divider, voltage_mv: station.pack_voltage };
        self.measure(job).map_err(|error| error.within("bring-up"))?;
        let flash = self.look()?;
        if self.chip().gate.as_ref().is_some_and(|gate| flash.number(gate.limit) == Some(0)) {
            let why = "the limit stays 0, with which flash is open at any voltage";
            return Err(Error::new("bring-up", Cause::StateUnknown, why));
        }
        Ok(flash)
    }

    fn write(&mut self, asked: &Image, now: &Flash) -> Result<()> {
        let changes: Vec<Change> = target::changes(asked, now, self.gauge.handle.allows_unproven())?;
        if changes.is_empty() { Ok(()) } else { self.gauge.ask(&op::WRITE, changes) }
    }

    fn calibrate(&mut self, slot: &mut dyn Slot) -> Result<Vec<Place>> {
        let mut places = Vec::new();
        let Some(calibration) = self.chip().calibration else { return Ok(places) };
        for (job, load) in self.station.jobs() {
            self.wait_for_load(slot, load)?;
            places.extend(match job {
                Job::BoardOffset => vec![calibration.board_offset.row, calibration.cc_offset.row],
                Job::CcOffset => vec![calibration.cc_offset.row],
                Job::Voltage(_) => vec![calibration.divider],
                Job::Current(_) => vec![calibration.gain, calibration.delta],
                Job::Temperature(_) => vec![calibration.internal, calibration.external],
                Job::Leave | Job::BringUp { .. } => Vec::new(),
            });
            self.measure(job).map_err(|error| error.within("calibration"))?;
        }
        Ok(places)
    }

    fn measure(&mut self, job: Job) -> Result<()> {
        let limits = self.limits(&job);
        let outcome = self.gauge.ask(&op::CALIBRATE, job);
        let published = self.gauge.handle.published();
        self.entry.calibration.extend(published.calibration.lines().next_back().map(String::from));
        outcome?;
        for found in published.measured.iter() {
            // An offset's register has to show 0.
            let (wanted, tolerance) = if found.wanted.is_some() { limits } else { (None, None) };
            let bound =
                |sign: f64| wanted.zip(tolerance).map(|(wanted, tolerance)| wanted + sign * tolerance);
            let (low, high) = (bound(-1.0), bound(1.0));
            let (before, after) = (round(found.before), round(found.after));
            let (name, unit) = (found.name.to_string(), found.unit.to_string());
            self.entry.measured.push(Measured { name, unit, wanted, low, high, before, after });
            if low.is_some_and(|low| after < low) || high.is_some_and(|high| after > high) {
                let (low, high) = (low.unwrap_or_default(), high.unwrap_or_default());
                let why = format!(
                    "{after} {unit} after the calibration, and {low} to {high} {unit} are allowed",
                    unit = found.unit
                );
                return Err(Error::new(found.name, Cause::OutOfRange, why));
            }
        }
        Ok(())
    }

    /// The wanted reading of a calibration's register, and its tolerance.
    fn limits(&self, job: &Job) -> (Option<f64>, Option<f64>) {
        let station = &self.station.plan.setup.options;
        match *job {
            Job::BoardOffset | Job::CcOffset => (Some(0.0), station.offset_tolerance),
            Job::Voltage(actual) => (Some(actual), station.voltage_tolerance),
            Job::BringUp { voltage_mv, .. } => (voltage_mv, station.voltage_tolerance),
            Job::Current(actual) => (Some(actual), station.current_tolerance),
            Job::Temperature(actual) => (Some(actual), station.temperature_tolerance),
            Job::Leave => (None, None),
        }
    }

    fn readings(&self) -> Vec<(&'static str, &'static str, f64)> {
        let published = self.gauge.handle.published();
        let value = |role| published.snapshot.as_ref()?.value(self.chip().register(role)?);
        let shown = [
            ("Voltage()", "mV", value(Role::VoltageNow).map(|value| value as f64)),
            ("Current()", "mA", value(Role::CurrentNow).map(|value| value as f64)),
            // In tenths of a kelvin.
            ("Temperature()", "°C", value(Role::Temp).map(|value| round(value as f64 / 10.0 - 273.1))),
        ];
        shown.into_iter().filter_map(|(name, unit, value)| Some((name, unit, value?))).collect()
    }

    /// Records first and present readings of quantities without a calibration.
    fn note_readings(&mut self, before: Vec<(&str, &str, f64)>) {
        let now = self.readings();
        for (name, unit, before) in before {
            let after = now.iter().find(|(other, ..)| *other == name).map(|(_, _, after)| *after);
            let is_new = self.entry.measured.iter().all(|measured| measured.name != name);
            if let Some(after) = after.filter(|_| is_new) {
                let (name, unit) = (name.into(), unit.into());
                let measured = Measured { name, unit, wanted: None, low: None, high: None, before, after };
                self.entry.measured.push(measured);
            }
        }
    }

    /// Waits for a load, or for its end.
    fn wait_for_load(&mut self, slot: &mut dyn Slot, load: Option<f64>) -> Result<()> {
        let Some(wanted) = load else { return Ok(()) };
        let clock = slot.clock();
        let (end, mut told) = (clock.now() + LOAD_PATIENCE, false);
        let tolerance = (wanted.abs() * LOAD_TOLERANCE).max(NO_LOAD_MA);
        loop {
            self.gauge.ask(&op::REFRESH, ())?;
            let register = self.chip().register(Role::CurrentNow);
            let published = self.gauge.handle.published();
            let now = register.and_then(|register| published.snapshot.as_ref()?.value(register));
            if now.is_some_and(|now| (now as f64 - wanted).abs() <= tolerance) {
                if told {
                    self.at(Step::Calibrate);
                }
                return Ok(());
            }
            let what = match wanted {
                0.0 => "disconnect load and charger".to_string(),
                _ => format!("switch on the current of {wanted} mA"),
            };
            if clock.now() > end || self.station.is_stopping() {
                let now = now.map_or("unknown".into(), |now| format!("{now} mA"));
                let why = format!("the current is {now} after {} s: {what}", LOAD_PATIENCE.as_secs());
                return Err(Error::new("calibration", Cause::NotNow, why));
            }
            if !std::mem::replace(&mut told, true) {
                self.station.prompt(&self.bench.name, &what);
                self.station.desk.sign(&self.bench.name, Sign::Look, &what);
            }
            clock.sleep(LOAD_LOOK);
        }
    }

    fn change_keys(&mut self) -> Result<()> {
        let Some(new) = &self.bench.new_keys else { return Ok(()) };
        for name in Name::ALL {
            let Some(key) = new.secret(name) else { continue };
            // An unchanged key must still be shown to work.
            let may_have = self.has_new_keys || self.gauge.key(name).as_ref() == Some(&key);
            if may_have && self.has_key(name)? {
                continue;
            }
            let old = match self.has_new_keys {
                true => self.bench.keys.secret(name).or_else(|| self.gauge.default_key(name)),
                false => self.gauge.key(name),
            };
            let old = old.ok_or_else(|| {
                refuse("keys", format!("the present {} key is not known; add it to key-file", name.as_str()))
            })?;
            let change = KeyChange { name, old, new: key };
            self.gauge.ask(&op::KEYS, change)?;
        }
        Ok(())
    }

    fn has_key(&mut self, name: Name) -> Result<bool> {
        match name {
            Name::Unseal => Ok(true),
            // A station may have been stopped between the two.
            Name::FullAccess => match self.gauge.ask(&op::SEAL, Seal::FullAccess) {
                Ok(()) => Ok(true),
                Err(error) if matches!(error.cause(), Cause::NotPermitted) => {
                    self.gauge.ask(&op::SEAL, Seal::Sealed).map(|()| false)
                }
                Err(error) => Err(error),
            },
            Name::Authentication => {
                let why = "whether a pack that was programmed before has the new one is not known; check it with gaugefs \
                           auth";
                Err(refuse("authentication key", why.into()))
            }
        }
    }

    fn seal(&mut self) -> Result<()> {
        if !self.station.seals() {
            return Ok(());
        }
        self.gauge.ask(&op::SEAL, Seal::Sealed)
    }

    /// Reads everything again: a sealed pack must have all of it. After a silence until the end, another pack may be
    /// there, and it is read again.
    fn verify(&mut self, check: impl Fn(&Flash) -> Result<()>) -> Result<Flash> {
        for _ in 0..TRIES {
            let breaks = self.watch.breaks();
            let last = self.look()?;
            check(&last)?;
            self.gauge.check_erased()?;
            self.assure_settled()?;
            if self.watch.breaks() == breaks {
                return Ok(last);
            }
        }
        let why = "contact was lost during every full read, so the pack may have been swapped; hold it still and \
                   connect it again";
        Err(Error::new("pack", Cause::StateUnknown, why))
    }

    /// Checks that the pack was not swapped during the program of `exec`, which may take a minute: PASS would show over
    /// another pack. A program quicker than any swap needs no look.
    fn assure_not_swapped(&mut self) -> Result<()> {
        match self.last.take().filter(|_| self.watch.may_be_exchanged()) {
            Some(last) => self.verify(|now| now.check_same(&last, &[])).map(drop).map_err(|error| {
                let why = format!("it may have been swapped while the program of exec ran: {error}");
                Error::new("pack", Cause::StateUnknown, why)
            }),
            None => Ok(()),
        }
    }

    fn assure_settled(&mut self) -> Result<()> {
        if let Some((why, _)) = self.gauge.settle(PATIENCE) {
            return Err(Error::new("pack", Cause::StateUnknown, why));
        }
        if let Some(journal) = self.bench.journals(&self.station.disk).unsettled().first() {
            let why = format!("{} is not settled", journal.display());
            return Err(Error::new("journal", Cause::StateUnknown, why));
        }
        if self.station.seals() {
            // The last reading may have unsealed it.
            self.seal()?;
            if self.gauge.handle.published().seal != Seal::Sealed {
                return Err(Error::new("seal", Cause::StateUnknown, "the pack is not sealed"));
            }
        }
        Ok(())
    }

    fn look(&mut self) -> Result<Flash> {
        Flash::read(&mut self.gauge)
    }

    fn name(&self, what: &str) -> String {
        format!("{:06}-{}-{what}", self.entry.number, self.bench.name)
    }

    fn save(&self, image: &Image, what: &str) -> Result<String> {
        let name = format!("{}.toml", self.name(what));
        let path = self.station.plan.setup.images.join(&name);
        let saved =
            journal::save_on(&*self.station.disk, &path, &path.with_extension("new"), &toml::write(image));
        saved.map_err(|error| Error::io(path.display().to_string(), "cannot be saved", &error))?;
        Ok(name)
    }

    fn failed(&mut self, error: &Error) {
        let mut reason = error.to_string();
        if !self.begun {
            reason += "; nothing was changed";
        } else if let Some((why, _)) = self.gauge.settle(PATIENCE) {
            let journals = self.bench.journals(&self.station.disk).unsettled();
            let journal = journals.first();
            let journal =
                journal.map_or(String::new(), |journal| format!("; its journal is {}", journal.display()));
            reason += &format!("; still to settle: {why}{journal}");
        } else if let Ok(flash) = self.look() {
            self.entry.fingerprint = Some(flash.fingerprint());
            self.entry.after = self.save(&flash.image(), "failed").ok();
        }
        (self.entry.event, self.entry.reason) = (Event::Fail, Some(reason));
        self.entry.step = Some(self.step.name().into());
    }
}

/// Rounds away what no gauge resolves.
fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

fn label_of(label: &str, pack: u64) -> String {
    format!("{label} is the label of pack number {pack} of the record")
}

fn taken_by(serial: &str, pack: u64) -> String {
    format!("{serial} is the serial number of pack number {pack} of the record")
}

pub(super) fn today() -> String {
    Timestamp::now().strftime("%F").to_string()
}

/// A date in data flash's format. A clock that was never set shows a date before the first gaugefs, or before the
/// record's last line, which begins with a date.
pub(super) fn day(date: Date, today: &str, last: &str) -> Result<i64> {
    if let Date::Day(stored) = date {
        return Ok(stored);
    }
    let refuse = |why: String| {
        Err(refuse(
            "date",
            format!(
                "this machine's clock shows {today}, {why}; set it, or give the date in the station's file"
            ),
        ))
    };
    let last = last.get(..today.len()).unwrap_or_default();
    match date::parse(today) {
        _ if today < FIRST_DAY => refuse("so it is not set".into()),
        _ if today < last => refuse(format!("and the last line of the record is of {last}")),
        Some(stored) => Ok(stored),
        None => refuse("which cannot be stored".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regression_packs_are_dated_by_a_clock_that_is_not_set() {
        let day = |today: &str, last: &str| day(Date::Today, today, last).map_err(|error| error.to_string());
        assert_eq!(day("2026-11-22", ""), Ok(46 << 9 | 11 << 5 | 22));
        assert_eq!(day("2026-11-22", "2026-11-22T23:59:59Z"), day("2026-11-22", ""));
        for today in ["1970-01-01", "1980-01-01", "2000-01-01", "2025-12-31", "-000001-01-01"] {
            let error = day(today, "").expect_err("it is not set");
            assert!(error.contains(today) && error.contains("it is not set"), "{error}");
        }
        let error = day("2026-11-21", "2026-11-22T00:00:00Z").expect_err("it went back");
        assert!(error.contains("the last line of the record is of 2026-11-22"), "{error}");
        assert!(day("2108-01-01", "").expect_err("no such year").contains("cannot be stored"));
        assert_eq!(super::day(Date::Day(7), "1970-01-01", "2026"), Ok(7));
    }
}
