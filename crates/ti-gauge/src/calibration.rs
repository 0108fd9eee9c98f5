// SPDX-License-Identifier: MIT

//! Calibration of a gauge: readings, their spread, new values, and the remaining error. If that error grows, the
//! transaction puts the old values back before its journal is removed. The gauge must not be polled meanwhile.
//! Voltages and currents are in the registers' units, temperatures in degrees Celsius.

use std::time::Duration;

use crate::chip::{Calibration, Chip, Offset, Parameter, Role, Subclass};
use crate::codec::FREEZING;
use crate::dataflash::{
    BEGINS, Change, DataFlash, Outcome, Place, Row, WriteOptions, accept_measured, assure_same,
    expect_measured, read_bits, read_word, undo_measured,
};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Moment, agreed};
use crate::notation;
use crate::unit;
use crate::value::Value;

/// Most readings for a mean, and their interval. Gauges measure once a second, and the watchdog of some resets them after
/// more than two standard commands a second.
const READINGS: usize = 8;
const INTERVAL: Duration = Duration::from_millis(600);
/// From the first to the last of three measurements: readings of that time that agree within a count are enough.
const MEASURES: Duration = Duration::from_secs(1);
const AGREED: Duration = MEASURES.saturating_mul(2);
/// Comparisons of a gauge that was silent for a moment: if another one has taken its place, that one must answer.
const RECOGNITIONS: usize = 3;
/// Readings before and after an offset measurement, which itself takes up to 16 s.
const FEW_READINGS: usize = 4;
/// Until the first reading after a reset. What a gauge still shows of the time before it does not agree with what follows.
const AFTER_RESET: Duration = Duration::from_secs(1);
/// A request has 16 s until its first commit; the readings leave some of them.
const READ_LIMIT: Duration = Duration::from_secs(12);
/// Longest offset measurement.
const ENDS: Duration = Duration::from_secs(22);
const LOOK: Duration = Duration::from_millis(100);
/// Largest current for an offset measurement, in mA: a real load's shunt voltage does not fit Board Offset's 8 bits.
const NO_CURRENT_MA: f64 = 10.0;
/// Smallest current for calibrating a gain, in mA.
const LEAST_CURRENT_MA: i32 = 100;
/// Largest change of a gain or divider.
const LARGEST_CHANGE: f64 = 0.2;
/// Tolerance of Voltage() with a divider computed from its resistors.
const DIVIDER_TOLERANCE: f64 = 0.1;
/// The °C of a step of Temperature().
const CELSIUS_STEP: f64 = 0.1;
/// A cell's voltage in mV, if nobody has measured it.
const CELL_MV: (f64, f64) = (1500.0, 4600.0);
/// Lowest voltage of a cell, in mV. A voltage typed in volts is below it with any number of cells.
const LEAST_CELL_MV: f64 = 100.0;
/// Flash Update OK Cell Volt of a cell (SLUSBZ5D 8.2.2.1.3).
const UPDATE_OK_MV: i64 = 2800;

/// The calibration, and a meter's reading.
#[derive(Clone, Debug, PartialEq)]
pub enum Job {
    /// The offset of the board and the converter, while no current flows.
    BoardOffset,
    /// The offset of the converter.
    CcOffset,
    /// Voltage(), in mV.
    Voltage(f64),
    /// Current(), in mA; negative while discharging.
    Current(f64),
    /// Temperature(), in degrees Celsius.
    Temperature(f64),
    /// Leaves calibration mode.
    Leave,
    /// A new board of several cells with an external divider.
    BringUp {
        /// Cells in series.
        cells: u8,
        /// Voltage Divider: the voltage at the full scale of the converter, in mV.
        divider: u16,
        /// The pack's voltage in mV, if it was measured.
        voltage_mv: Option<f64>,
    },
}

/// The result of a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reached {
    /// The result in words.
    pub text: String,
    /// Quantities before and after.
    pub measured: Vec<Measured>,
}

/// A quantity before and after a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// The register or the parameter.
    pub name: &'static str,
    /// Unit; empty for none.
    pub unit: &'static str,
    /// The target; `None` if unknown.
    pub wanted: Option<f64>,
    /// Mean of the readings before.
    pub before: f64,
    /// Mean of the readings after.
    pub after: f64,
}

/// Carries out a job. Each step is reported before it starts.
pub fn run(
    dataflash: &mut DataFlash,
    gauge: &mut Gauge,
    job: &Job,
    waited: Duration,
    tell: &mut dyn FnMut(&str),
) -> Result<Reached> {
    let Some(calibration) = gauge.chip.calibration else {
        return Err(not_documented(gauge.chip));
    };
    let began = gauge.clock.now();
    if *job == Job::Leave {
        tell("leaving calibration mode");
        let text = match dataflash.leave_calibration(gauge, waited)? {
            true => "calibration mode was on; it is off now",
            false => "calibration mode was off already",
        };
        return Ok(Reached { text: text.into(), ..Reached::default() });
    }
    let since = gauge.moment();
    dataflash.ready(gauge, waited)?;
    let asked = began.saturating_sub(waited);
    let mut task = Task { dataflash, gauge, calibration, asked, since, measured: Vec::new(), tell };
    let text = match *job {
        Job::BoardOffset => task.offset(&calibration.board_offset),
        Job::CcOffset => task.offset(&calibration.cc_offset),
        Job::Voltage(actual) => task.voltage(actual),
        Job::Current(actual) => task.current(actual),
        Job::Temperature(actual) => task.temperature(actual),
        Job::BringUp { cells, divider, voltage_mv } => task.bring_up(cells, divider, voltage_mv),
        Job::Leave => Ok(String::new()),
    }?;
    Ok(Reached { text, measured: task.measured })
}

/// Whether CONTROL_STATUS shows calibration mode.
pub fn is_on(chip: &Chip, control_status: u32) -> bool {
    chip.calibration.is_some_and(|calibration| control_status & calibration.mode != 0)
}

/// The error for a part whose calibration is not documented.
pub fn not_documented(chip: &Chip) -> Error {
    let why = "no document describes the calibration of this part";
    Error::new(chip.model, Cause::NotPermitted, why).at(Step::Check)
}

#[derive(Clone, Copy)]
struct Target {
    role: Role,
    wanted: f64,
    spread: f64,
}

#[derive(Clone, Copy, Debug)]
struct Readings {
    mean: f64,
    least: f64,
    most: f64,
    count: usize,
}

impl Readings {
    fn spread(&self) -> f64 {
        self.most - self.least
    }

    fn show(&self, unit: &str) -> String {
        let Self { mean, least, most, count } = self;
        let digits = if unit == "°C" { 1 } else { 0 };
        format!("{mean:.1} {unit} ({count} readings, {least:.digits$} to {most:.digits$})")
    }
}

struct Task<'a> {
    dataflash: &'a mut DataFlash,
    gauge: &'a mut Gauge,
    calibration: &'static Calibration,
    asked: Duration,
    /// It must be the same gauge from then on.
    since: Moment,
    measured: Vec<Measured>,
    tell: &'a mut dyn FnMut(&str),
}

impl Task<'_> {
    fn waited(&self) -> Duration {
        self.gauge.clock.now().saturating_sub(self.asked)
    }

    fn refuse<T>(&self, subject: &str, why: String) -> Result<T> {
        Err(Error::new(subject, Cause::OutOfRange, why).at(Step::Check))
    }

    fn steady(&mut self, target: Target, count: usize) -> Result<Readings> {
        let (name, unit) = naming(self.gauge.chip, target.role);
        (self.tell)(&format!("reading {name} up to {count} times"));
        self.gauge.limit(Some(READ_LIMIT.saturating_sub(self.waited())));
        let readings = self.undisturbed(target.role, count);
        self.gauge.limit(None);
        let readings = readings?;
        if readings.spread() > target.spread {
            let noisy = Reason::Noisy {
                least: format!("{:.1}", readings.least),
                greatest: format!("{:.1}", readings.most),
                spread: target.spread.round() as i64,
                unit,
                shown: readings.show(unit),
            };
            return Err(Error::of(name, noisy).at(Step::Check));
        }
        Ok(readings)
    }

    /// Reads a register, and again after a moment's silence. It must be the same gauge from then on.
    fn undisturbed(&mut self, role: Role, count: usize) -> Result<Readings> {
        self.since = self.gauge.moment();
        let first = readings(self.gauge, role, count);
        if first.is_ok() && self.gauge.is_unbroken_since(self.since) {
            return first;
        }
        self.since = self.gauge.moment();
        readings(self.gauge, role, count)
    }

    fn value(&mut self, place: (u8, u16)) -> Result<(Row, Value)> {
        let row = row(self.gauge.chip, place)?;
        Ok((row, self.values(row.0, &[row.1])?.remove(0)))
    }

    fn values(&mut self, subclass: &'static Subclass, parameters: &[&Parameter]) -> Result<Vec<Value>> {
        let waited = self.waited();
        let bytes = self.dataflash.read(self.gauge, &[subclass], waited)?.remove(0);
        let layout = self.gauge.chip.layout;
        let value = |parameter: &&Parameter| {
            let at = usize::from(parameter.offset - subclass.start());
            layout.decode(parameter.kind, &bytes[at..at + parameter.kind.size()])
        };
        Ok(parameters.iter().map(value).collect())
    }

    fn number(&mut self, place: (u8, u16)) -> Result<f64> {
        Ok(match self.value(place)?.1 {
            Value::Int(number) => number as f64,
            Value::Float(number) => number,
            Value::Text(_) => 0.0,
        })
    }

    /// Writes new values. They are put back if the register ends up further from its target than before.
    fn write(
        &mut self,
        target: Target,
        before: Readings,
        new: &[((u8, u16), f64)],
        calibrate: bool,
    ) -> Result<String> {
        let chip = self.gauge.chip;
        let (name, unit) = naming(chip, target.role);
        let changes: Result<Vec<Change>> =
            new.iter().map(|&(place, value)| change(chip, place, value)).collect();
        let changes = changes?;
        let list: Vec<_> = changes
            .iter()
            .zip(new)
            .map(|(change, (_, value))| format!("{} = {value}", change.name()))
            .collect();
        (self.tell)(&format!("writing {}, and measuring again", list.join(", ")));
        let first = before.mean - target.wanted;
        let mut after = before;
        let mut accept = |gauge: &mut Gauge| {
            gauge.wait(AFTER_RESET);
            after = readings(gauge, target.role, READINGS)?;
            let error = after.mean - target.wanted;
            let step = if target.role == Role::Temp { CELSIUS_STEP } else { 1.0 };
            if error.abs() > first.abs() + step || after.spread() > 2.0 * target.spread {
                let (before, now) = (format!("{first:+.1}"), format!("{error:+.1}"));
                let worse = Reason::Worse { before, after: now, unit, shown: after.show(unit) };
                return Err(Error::of(name, worse).at(Step::Verify));
            }
            Ok(())
        };
        let waited = self.waited();
        let since = Some(self.since);
        let options = WriteOptions { calibrate, accept: Some(&mut accept), since, ..WriteOptions::default() };
        let outcome = self.dataflash.write_with(self.gauge, &changes, options, waited)?;
        self.note(target, before, after);
        if outcome == Outcome::Unchanged {
            return Ok(format!("{name}: {}: the calibration is right as it is", before.show(unit)));
        }
        let error = after.mean - target.wanted;
        Ok(format!(
            "{name}: {} before, {} after; {}; the error was {first:+.1} {unit} and is {error:+.1} {unit}",
            before.show(unit),
            after.show(unit),
            list.join(", "),
        ))
    }

    fn note(&mut self, target: Target, before: Readings, after: Readings) {
        let (name, unit) = naming(self.gauge.chip, target.role);
        let wanted = Some(target.wanted);
        self.measured.push(Measured { name, unit, wanted, before: before.mean, after: after.mean });
    }

    fn voltage(&mut self, actual: f64) -> Result<String> {
        let spread = (actual.abs() * 0.01).max(20.0);
        let target = Target { role: Role::VoltageNow, wanted: actual, spread };
        let before = self.steady(target, READINGS)?;
        self.check_ratio(before.mean, actual, "gaugefs bringup sets a divider that is far off")?;
        let place = self.calibration.divider;
        let new = (self.number(place)? * actual / before.mean).round();
        self.write(target, before, &[(place, new)], false)
    }

    fn current(&mut self, actual: f64) -> Result<String> {
        let name = naming(self.gauge.chip, Role::CurrentNow).0;
        if actual.abs() < f64::from(LEAST_CURRENT_MA) {
            let why = format!("a gain needs a current of {LEAST_CURRENT_MA} mA at least, and better of 1 A");
            return self.refuse(name, why);
        }
        let spread = (actual.abs() * 0.02).max(10.0);
        let target = Target { role: Role::CurrentNow, wanted: actual, spread };
        let before = self.steady(target, READINGS)?;
        if before.mean * actual <= 0.0 {
            let why = format!(
                "the gauge measures {:.0} mA and the meter {actual} mA: a current that discharges is negative",
                before.mean
            );
            return self.refuse(name, why);
        }
        let Calibration { gain, delta, ratio, .. } = *self.calibration;
        let hint =
            "write 4.768 / milliohms of the shunt to CC Gain first, and 5677445 / milliohms to CC Delta";
        self.check_ratio(before.mean, actual, hint)?;
        let new = self.number(gain)? * actual / before.mean;
        self.write(target, before, &[(gain, new), (delta, new * ratio)], false)
    }

    fn temperature(&mut self, actual: f64) -> Result<String> {
        let Calibration { thermistor: (source, mask), internal, external, .. } = *self.calibration;
        let target = Target { role: Role::Temp, wanted: actual, spread: 1.0 };
        if !(-40.0..=125.0).contains(&actual) {
            return self
                .refuse(naming(self.gauge.chip, Role::Temp).0, "give degrees Celsius, -40 to 125".into());
        }
        let before = self.steady(target, READINGS)?;
        let place = match agreed("the selection of the temperature sensor", || read_bits(self.gauge, source))?
            & mask
        {
            0 => internal,
            _ => external,
        };
        let new = self.number(place)? + ((actual - before.mean) / CELSIUS_STEP).round();
        self.write(target, before, &[(place, new)], false)
    }

    fn check_ratio(&self, read: f64, actual: f64, hint: &str) -> Result<()> {
        let ratio = if read == 0.0 { f64::INFINITY } else { actual / read };
        if (1.0 - LARGEST_CHANGE..=1.0 + LARGEST_CHANGE).contains(&ratio) {
            return Ok(());
        }
        let why = format!(
            "the gauge reads {read:.0} and {actual:.0} is meant: a calibration changes {:.0} % at most; {hint}",
            LARGEST_CHANGE * 100.0
        );
        self.refuse("calibration", why)
    }

    fn offset(&mut self, offset: &'static Offset) -> Result<String> {
        let target = Target { role: Role::CurrentNow, wanted: 0.0, spread: NO_CURRENT_MA };
        let before = self.steady(target, FEW_READINGS)?;
        if before.mean.abs() > NO_CURRENT_MA {
            let flows = Reason::CurrentFlows {
                value: before.mean.round() as i64,
                greatest: NO_CURRENT_MA as i64,
                shown: before.show("mA"),
            };
            return Err(Error::of("Current()", flows).at(Step::Check));
        }
        // CC_OFFSET_SAVE stores the converter's offset in either case.
        let mut rows = vec![row(self.gauge.chip, offset.row)?];
        if offset.row != self.calibration.cc_offset.row {
            rows.push(row(self.gauge.chip, self.calibration.cc_offset.row)?);
        }
        let waited = self.waited();
        let values = expect_measured(self.dataflash, self.gauge, &rows, waited)?;
        let olds: Vec<(Row, Value)> = rows.into_iter().zip(values).collect();
        let (kind, name) = (olds[0].0.1.kind, olds[0].0.1.name);
        let was = notation::render(kind, &olds[0].1);
        (self.tell)(&format!("the gauge measures {name}, which is {was}; this may take 16 s"));
        let measured = self.measure_offset(offset);
        self.gauge.limit(None);
        let measured = measured.and_then(|()| self.save_again(&olds));
        let error = match measured.and_then(|()| self.judge(&olds, before)) {
            Ok((after, new)) if after.mean.abs() <= before.mean.abs() + 1.0 => {
                accept_measured(self.dataflash);
                self.note(target, before, after);
                if let (Value::Int(old), Value::Int(new)) = (&olds[0].1, &new) {
                    let (before, after) = (*old as f64, *new as f64);
                    self.measured.push(Measured { name, unit: "", wanted: None, before, after });
                }
                return Ok(format!(
                    "{name} {was} -> {}; Current(): {} before, {} after",
                    notation::render(kind, &new),
                    before.show("mA"),
                    after.show("mA")
                ));
            }
            Ok((after, _)) => {
                let error = |readings: &Readings| format!("{:+.1}", readings.mean);
                let worse = Reason::Worse {
                    before: error(&before),
                    after: error(&after),
                    unit: "mA",
                    shown: after.show("mA"),
                };
                Error::of(name, worse).at(Step::Verify)
            }
            Err(error) => error,
        };
        (self.tell)(&format!("putting {name} {was} back"));
        self.put_back(&olds, error)
    }

    /// The value after the gauge may have changed it in its own time.
    fn value_now(&mut self, place: (u8, u16)) -> Result<(Row, Value)> {
        self.asked = self.gauge.clock.now();
        self.value(place)
    }

    fn measure_offset(&mut self, offset: &Offset) -> Result<()> {
        self.recognise()?;
        let gauge = &mut *self.gauge;
        gauge.limit_until(Some(self.asked + ENDS));
        gauge.command_since(offset.start, self.since)?;
        let started = gauge.clock.now();
        let mut seen = false;
        loop {
            gauge.wait(LOOK);
            let running = is_running(gauge, offset.running)?;
            match (seen, running) {
                (true, false) => break,
                (false, false) if gauge.clock.now() > started + BEGINS => {
                    let command = gauge.subcommand_name(offset.start).into();
                    let unseen = Reason::NoEffect { command, times: 1 };
                    return Err(Error::of(gauge.chip.model, unseen).at(Step::Control));
                }
                _ => seen |= running,
            }
        }
        self.save()
    }

    /// A gauge may be silent while it stores something; after that it must show the marks of the same pack.
    fn recognise(&mut self) -> Result<()> {
        for _ in 0..RECOGNITIONS {
            if self.gauge.is_unbroken_since(self.since) {
                return Ok(());
            }
            self.dataflash.suspect(self.gauge.chip);
            self.since = self.gauge.moment();
            self.value_now(self.calibration.cc_offset.row)?;
            if self.dataflash.doubts() {
                let why = "another pack answers, which was not told to measure anything";
                return Err(Error::new(self.gauge.chip.model, Cause::Gone, why).at(Step::Identify));
            }
        }
        assure_same(self.gauge, self.since)
    }

    fn save(&mut self) -> Result<()> {
        self.recognise()?;
        self.gauge.command_since(self.calibration.save, self.since)?;
        self.gauge.wait(AFTER_RESET);
        Ok(())
    }

    fn judge(&mut self, olds: &[(Row, Value)], before: Readings) -> Result<(Readings, Value)> {
        let after = readings(self.gauge, Role::CurrentNow, FEW_READINGS)?;
        let ((subclass, _), _) = olds[0];
        debug_assert!(
            olds.iter().all(|((other, _), _)| std::ptr::eq(*other, subclass)),
            "the tables have both in one"
        );
        let parameters: Vec<&Parameter> = olds.iter().map(|((_, parameter), _)| *parameter).collect();
        self.asked = self.gauge.clock.now();
        let mut news = self.values(subclass, &parameters)?;
        self.recognise()?;
        // A correct offset leaves nothing to store.
        let has_stored = olds.iter().zip(&news).any(|((_, old), new)| old != new);
        if !has_stored && before.mean.abs() > 1.0 {
            let why =
                "the gauge has measured its offset and stored nothing, as after a loss of power in between";
            return Err(Error::new(olds[0].0.1.name, Cause::TimedOut, why).at(Step::Verify));
        }
        Ok((after, news.swap_remove(0)))
    }

    /// Repeats CC_OFFSET_SAVE if nothing was stored: the command may have been lost.
    fn save_again(&mut self, olds: &[(Row, Value)]) -> Result<()> {
        let place = self.calibration.cc_offset.row;
        let (row, new) = self.value_now(place)?;
        match olds.iter().any(|((_, old), value)| old.offset == row.1.offset && *value == new) {
            true => self.save(),
            false => Ok(()),
        }
    }

    fn put_back(&mut self, olds: &[(Row, Value)], error: Error) -> Result<String> {
        let show = |((_, parameter), old): &(Row, Value)| {
            format!("{} {}", parameter.name, notation::render(parameter.kind, old))
        };
        let was = olds.iter().map(show).collect::<Vec<_>>().join(", ");
        // A running measurement would store its result later.
        let wait = Duration::from_secs(1);
        for _ in 0..20 {
            if !is_running(self.gauge, self.calibration.board_offset.running).unwrap_or(false) {
                break;
            }
            self.gauge.wait(wait);
        }
        match undo_measured(self.dataflash, self.gauge) {
            Ok(()) => {
                let what = format!("the old value was restored and verified: {was}");
                Err(Error::of("", Reason::RolledBack { failed: error, what }))
            }
            Err(then) => {
                let what = format!("the gauge may have stored other values than {was}");
                Err(Error::of("", Reason::NotRestored { failed: error, then, what }))
            }
        }
    }

    /// Refuses a divider or a voltage that does not fit so many cells, before the gauge is set up with them.
    fn check_pack(&self, cells: u8, divider: u16, voltage_mv: Option<f64>) -> Result<()> {
        for (name, given) in [("Voltage Divider", Some(divider.into())), ("Voltage()", voltage_mv)] {
            if let Some(given) = given.filter(|given| *given < LEAST_CELL_MV * f64::from(cells)) {
                let likely = unit::likely(given, "mV").unwrap_or_default();
                let why = format!(
                    "{given} mV is too little for {cells} cells; if it means {likely}, write that in mV; nothing was \
                     changed"
                );
                return self.refuse(name, why);
            }
        }
        if voltage_mv.is_some_and(|voltage| voltage > f64::from(divider)) {
            let why = format!("the converter ends at {divider} mV, and the pack has more");
            return self.refuse("Voltage Divider", why);
        }
        Ok(())
    }

    /// Makes a new board of several cells writable: in calibration mode the limit can be set to 0, with the divider.
    fn bring_up(&mut self, cells: u8, divider: u16, voltage_mv: Option<f64>) -> Result<String> {
        let chip = self.gauge.chip;
        let gate = chip.gate.as_ref().and_then(|gate| {
            let (external, cells) = (gate.external.as_ref()?, gate.cells?);
            Some((gate.limit, gate.divider?, external, cells, gate.cell_divider))
        });
        let Some((limit, divider_row, external, cells_row, cell_divider)) = gate else {
            return Err(not_documented(chip));
        };
        self.check_pack(cells, divider, voltage_mv)?;
        let ((subclass, parameter), old) = self.value(external.byte)?;
        let Value::Int(word) = old else { return Err(not_documented(chip)) };
        let shift = chip.layout.shift(parameter.kind.size(), 0);
        let selected = word | i64::from(external.mask) << shift;
        let set = Change::of_value(chip, (subclass, parameter), &Value::Int(selected), false)?;
        let mut changes = vec![
            change(chip, limit, 0.0)?,
            change(chip, cells_row, cells.into())?,
            change(chip, divider_row, divider.into())?,
        ];
        changes.push(set);
        let (name, unit) = naming(chip, Role::VoltageNow);
        (self.tell)(&format!(
            "calibration mode, in which flash is open: limit {} 0, {}, {cells} cells, divider {divider} mV; then the \
             gauge leaves it and is reset",
            Place::from(limit),
            external.name
        ));
        let (low, high) = match voltage_mv {
            Some(voltage) => (voltage * (1.0 - DIVIDER_TOLERANCE), voltage * (1.0 + DIVIDER_TOLERANCE)),
            None => (CELL_MV.0 * f64::from(cells), CELL_MV.1 * f64::from(cells)),
        };
        let mut found = None;
        let mut accept = |gauge: &mut Gauge| {
            gauge.wait(AFTER_RESET);
            let read = readings(gauge, Role::VoltageNow, READINGS)?;
            if read.least < low || read.most > high {
                let off = Reason::Implausible {
                    value: format!("{:.1}", read.mean),
                    least: low.round() as i64,
                    greatest: high.round() as i64,
                    unit,
                    shown: read.show(unit),
                };
                return Err(Error::of(name, off).at(Step::Verify));
            }
            found = Some(read);
            Ok(())
        };
        let waited = self.waited();
        let since = Some(self.since);
        let options =
            WriteOptions { calibrate: true, accept: Some(&mut accept), since, ..WriteOptions::default() };
        self.dataflash.write_with(self.gauge, &changes, options, waited)?;
        // It was accepted as the same gauge, whatever its reset did.
        self.since = self.gauge.moment();
        let read = match found {
            Some(read) => read,
            None => readings(self.gauge, Role::VoltageNow, FEW_READINGS)?,
        };
        let first = format!("{name}: {}", read.show(unit));
        (self.tell)(&first);
        let rows = (limit, divider_row);
        self.refine((cells, divider), voltage_mv, rows, cell_divider, read, &first)
    }

    /// The second transaction of a new board: the divider for the measured voltage, and its limit.
    fn refine(
        &mut self,
        (cells, divider): (u8, u16),
        voltage_mv: Option<f64>,
        (limit, divider_row): ((u8, u16), (u8, u16)),
        cell_divider: Option<u32>,
        read: Readings,
        first: &str,
    ) -> Result<String> {
        let chip = self.gauge.chip;
        // A new time limit: flash is open and the pack is measured.
        self.asked = self.gauge.clock.now();
        let refined = voltage_mv.map(|voltage| (f64::from(divider) * voltage / read.mean).round());
        let ends = refined.unwrap_or(divider.into());
        let scaled = |cell: u32| UPDATE_OK_MV as f64 * f64::from(cells) * f64::from(cell) / ends;
        let ok = cell_divider.map_or(UPDATE_OK_MV as f64, scaled).round();
        let mut new = vec![(limit, ok)];
        new.extend(
            refined.filter(|refined| *refined != f64::from(divider)).map(|refined| (divider_row, refined)),
        );
        let spread = (read.mean * 0.01).max(20.0);
        let target = Target { role: Role::VoltageNow, wanted: voltage_mv.unwrap_or(read.mean), spread };
        match self.write(target, read, &new, false) {
            Ok(done) => Ok(format!("flash can be written; limit {} is {ok} mV; {done}", Place::from(limit))),
            Err(error) => {
                // The first transaction stays: with it the gauge measures its pack, which can be charged now.
                let left = match error.cause() {
                    Cause::StateUnknown => "limit and divider are unknown".to_string(),
                    _ => format!(
                        "its limit stays 0, with which it is open at any voltage, and the divider {divider} mV"
                    ),
                };
                let why = format!(
                    "not complete: {first}, and flash can be written, but {left}: {error}; run the same command again, \
                     or write a limit of your own to df/{}",
                    Place::from(limit)
                );
                Err(Error::new(chip.model, Cause::StateUnknown, why))
            }
        }
    }
}

fn row(chip: &'static Chip, (id, offset): (u8, u16)) -> Result<Row> {
    let mut alike = chip.subclasses.iter().filter(|subclass| subclass.id == id);
    let found = alike.find_map(|subclass| Some((subclass, subclass.parameter(offset)?)));
    found.ok_or_else(|| not_documented(chip))
}

fn change(chip: &'static Chip, place: (u8, u16), value: f64) -> Result<Change> {
    let row = row(chip, place)?;
    Change::parse(chip, row, value.to_string().as_bytes(), false)
}

fn naming(chip: &'static Chip, role: Role) -> (&'static str, &'static str) {
    match role {
        Role::VoltageNow => ("Voltage()", "mV"),
        Role::Temp => ("Temperature()", "°C"),
        Role::CurrentNow => ("Current()", "mA"),
        _ => (chip.model, ""),
    }
}

/// Whether the gauge measures an offset. A bit error is neither its start nor its end.
fn is_running(gauge: &mut Gauge, bits: u32) -> Result<bool> {
    agreed("CONTROL_STATUS", || Ok(gauge.control_status()?.1 & bits != 0))
}

/// Reads a register that often, or until three of the gauge's measurements agree, which alone count then.
fn readings(gauge: &mut Gauge, role: Role, count: usize) -> Result<Readings> {
    let chip = gauge.chip;
    let register = chip.register(role).ok_or_else(|| not_documented(chip))?;
    let mut read: Vec<(Duration, f64)> = Vec::with_capacity(count);
    for number in 0..count {
        if number > 0 {
            // Two seconds in as few readings as show three measurements, then at the pace of many.
            gauge.wait(if count > FEW_READINGS && number <= 2 { MEASURES } else { INTERVAL });
        }
        let now = gauge.clock.now();
        let word = read_word(gauge, register.source)?;
        read.push((now, if register.signed { f64::from(word as i16) } else { f64::from(word) }));
        let alike = agreeing(&read);
        if alike.first().is_some_and(|(since, _)| now.saturating_sub(*since) >= AGREED) {
            read = alike.to_vec();
            break;
        }
    }
    let values = read.iter().map(|&(_, value)| match role {
        Role::Temp => (value - FREEZING as f64) * CELSIUS_STEP,
        _ => value,
    });
    let count = read.len();
    let mean = values.clone().sum::<f64>() / count.max(1) as f64;
    let least = values.clone().fold(f64::INFINITY, f64::min);
    let most = values.fold(f64::NEG_INFINITY, f64::max);
    Ok(Readings { mean, least, most, count })
}

/// The last readings that lie within a count of each other.
fn agreeing(read: &[(Duration, f64)]) -> &[(Duration, f64)] {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    let alike = read.iter().rev().take_while(|(_, value)| {
        (least, most) = (least.min(*value), most.max(*value));
        most - least <= 1.0
    });
    &read[read.len() - alike.count()..]
}
