// SPDX-License-Identifier: MIT

//! What one poll alone does not show: values that jump, that stand still, and that contradict each other over time.

use super::{Lacking, Role};
use crate::chip::{Chip, Source};
use crate::learning::{Bits, Cycle, Learned, Learns, Limits, Reading, Spoiled};
use crate::registers::Registers;

/// Polls in a row without a measurement, half a second to some seconds apart, after which it will not come.
pub(super) const FOR_GOOD: u32 = 5;
/// A resistance shows in a step of the current of a tenth of the design capacity per hour and of so many mV.
const STEP: f64 = 0.1;
const STEP_MV: f64 = 10.0;
/// A jump of the state of charge in percent between two polls that are at most so many seconds apart.
const JUMP: f64 = 20.0;
const JUMP_S: f64 = 300.0;
/// The time in seconds in which resets belong together.
const DAY_S: f64 = 86_400.0;

/// A poll.
#[derive(Clone, Copy, Debug)]
pub struct Poll<'a> {
    /// When it was, in seconds on a clock of the host's.
    pub time: f64,
    /// What it has read.
    pub registers: &'a Registers,
    /// CONTROL_STATUS when it was last read.
    pub control_status: u32,
    /// Whether the gauge has measured since its power-up or reset.
    pub is_measured: bool,
    /// A count that changes with what this program itself writes to the gauge, or resets.
    pub own: u64,
}

/// What the polls of one pack have shown so far.
#[derive(Clone, Debug, Default)]
pub struct History {
    last: Option<Seen>,
    cycle: Option<Cycle>,
    resets: Vec<f64>,
    summary: Summary,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    time: f64,
    own: u64,
    is_measured: bool,
    voltage: Option<f64>,
    current: Option<f64>,
    percent: Option<f64>,
    design: Option<f64>,
    /// Design capacity, or the full charge capacity of a part that shows none.
    size: Option<f64>,
}

/// What a rule needs of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Polls in a row that have found no measurement.
    pub(super) unmeasured: u32,
    /// Resets within a day that this program has not sent.
    pub(super) resets: usize,
    /// Steps of the current with which the voltage has gone, and against which.
    pub(super) agreeing: u32,
    pub(super) opposed: u32,
    /// Since when the current is 0, until when, and the least and greatest voltage in that time.
    pub(super) still: Option<(f64, f64, f64, f64)>,
    /// The last jump: from and to.
    pub(super) jump: Option<(f64, f64)>,
    /// A change of Design Capacity that this program has not made.
    pub(super) redesigned: Option<(f64, f64)>,
    /// What disturbs a learning cycle, and for how many seconds.
    pub(super) spoiled: Option<(Spoiled, f64)>,
}

impl Summary {
    /// Whether the last poll has found no measurement.
    pub(super) fn has_not_measured(&self) -> bool {
        self.unmeasured > 0
    }

    /// How many polls in a row have found none, once it is certain that none will come.
    pub(super) fn never_measures(&self) -> Option<u32> {
        Some(self.unmeasured).filter(|&count| count >= FOR_GOOD)
    }
}

impl History {
    /// What it comes to.
    pub fn summary(&self) -> Summary {
        self.summary
    }

    /// Another pack may be there, or the gauge was away.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Takes the next poll.
    pub fn note(&mut self, chip: &'static Chip, poll: &Poll<'_>) {
        let read = |role| {
            let register = chip.register(role)?;
            Some(register.in_unit(poll.registers.value(register)?, 1) as f64)
        };
        let now = Seen {
            time: poll.time,
            own: poll.own,
            is_measured: poll.is_measured,
            voltage: read(Role::VoltageNow).filter(|_| poll.is_measured),
            current: read(Role::CurrentNow).or_else(|| read(Role::CurrentAvg)).filter(|_| poll.is_measured),
            percent: read(Role::Capacity).filter(|_| poll.is_measured),
            design: read(Role::ChargeFullDesign).filter(|&design| design > 0.0),
            size: read(Role::ChargeFullDesign).or_else(|| read(Role::ChargeFull)).filter(|&size| size > 0.0),
        };
        let summary = &mut self.summary;
        summary.unmeasured = if poll.is_measured { 0 } else { summary.unmeasured.saturating_add(1) };
        if let Some(last) = self.last.replace(now) {
            self.compare(&last, &now);
        }
        self.watch_rest(&now);
        self.watch_learning(chip, poll, &now, read(Role::Temp));
    }

    fn compare(&mut self, last: &Seen, now: &Seen) {
        let summary = &mut self.summary;
        if last.is_measured && !now.is_measured && last.own == now.own {
            self.resets.push(now.time);
        }
        self.resets.retain(|&at| now.time - at < DAY_S);
        summary.resets = self.resets.len();
        if last.own == now.own
            && let Some((before, after)) =
                last.design.zip(now.design).filter(|(before, after)| before != after)
        {
            summary.redesigned = Some((before, after));
        }
        if last.own != now.own {
            (summary.redesigned, summary.agreeing, summary.opposed) = (None, 0, 0);
        }
        let volts = last.voltage.zip(now.voltage).map(|(before, after)| after - before);
        let steps = last.current.zip(now.current).map(|(before, after)| after - before);
        let passed = last.current.unwrap_or(0.0).abs().max(now.current.unwrap_or(0.0).abs())
            * (now.time - last.time)
            / 3600.0;
        let Some(design) = now.size.or(last.size) else { return };
        if let Some((volts, step)) = volts.zip(steps)
            && step.abs() >= STEP * design
            && volts.abs() >= STEP_MV
        {
            let count =
                if (volts > 0.0) == (step > 0.0) { &mut summary.agreeing } else { &mut summary.opposed };
            *count = count.saturating_add(1);
        }
        if let Some((before, after)) = last.percent.zip(now.percent)
            && now.time - last.time <= JUMP_S
            && last.own == now.own
            && (after - before).abs() >= JUMP + 400.0 * passed / design
        {
            summary.jump = Some((before, after));
        }
    }

    fn watch_rest(&mut self, now: &Seen) {
        let still = &mut self.summary.still;
        *still = match (now.current, now.voltage) {
            (Some(0.0), Some(mv)) => {
                let (since, _, low, high) = still.unwrap_or((now.time, now.time, mv, mv));
                Some((since, now.time, low.min(mv), high.max(mv)))
            }
            // A poll without a measurement says nothing.
            (None, _) | (_, None) => *still,
            _ => None,
        };
    }

    fn watch_learning(&mut self, chip: &'static Chip, poll: &Poll<'_>, now: &Seen, kelvins: Option<f64>) {
        let Some(learns) = Learns::of(chip).filter(|_| now.is_measured) else { return };
        let Some(current_ma) = now.current else { return };
        let words = chip.registers.iter().filter_map(|row| Some((row.bits, poll.registers.value(row)?)));
        let words = words.chain([(chip.control_status, i64::from(poll.control_status))]);
        let set = words.flat_map(|(bits, word)| {
            bits.iter().filter(move |bit| word & i64::from(bit.mask) != 0).map(|bit| bit.name)
        });
        let reading = Reading {
            time: now.time,
            bits: Bits::named(set),
            current_ma,
            voltage_mv: now.voltage,
            degrees: kelvins.map(|tenths| (tenths - 2731.0) / 10.0),
            design_mah: now.design,
            percent: now.percent,
            has_learned_status: learned_status(chip).is_some_and(|at| poll.registers.value(at).is_some()),
        };
        let cycle = self.cycle.get_or_insert_with(|| Cycle::new(learns, Limits::default()));
        let state = cycle.update(&reading);
        let spoiled = state.spoiled.filter(|_| state.learned != Learned::All);
        self.summary.spoiled = spoiled.map(|why| (why, state.time - state.since.time));
    }
}

fn learned_status(chip: &'static Chip) -> Option<&'static crate::chip::Register> {
    chip.registers.iter().find(|register| register.name == "LearnedStatus")
}

/// What the gauge has learned by the bits that show it; `Never` for a part that shows none.
pub(super) fn learned(facts: &super::Facts<'_>) -> Result<Learned, Lacking> {
    let named = |name: &str| facts.chip.control_status.iter().find(|bit| bit.name == name);
    let (word, qmax, all) = match (learned_status(facts.chip), named("QMAX_UP"), named("RES_UP")) {
        (Some(register), ..) => {
            let bit =
                |name: &str| register.bits.iter().find(|bit| bit.name == name).map_or(0, |bit| bit.mask);
            (facts.word(register.source)?, bit("CF0"), bit("CF1"))
        }
        (None, Some(qmax), Some(all)) => (facts.word(Source::Status)?, qmax.mask, qmax.mask | all.mask),
        _ => return Err(Lacking::Never),
    };
    Ok(match (word & all == all, word & qmax != 0) {
        (true, _) => Learned::All,
        (false, true) => Learned::Qmax,
        (false, false) => Learned::Nothing,
    })
}
