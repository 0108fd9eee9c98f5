// SPDX-License-Identifier: MIT

//! What one poll alone does not show: values that jump, that stand still, and that contradict each other over time.

use std::collections::VecDeque;

use super::{Lacking, Role};
use crate::chip::{Chip, SealStatus, Source};
use crate::codec::FREEZING;
use crate::learning::{Bits, Cycle, Learned, Learns, Limits, Phase, Reading, Spoiled, State};
use crate::registers::Registers;

/// Polls in a row without a measurement, half a second to some seconds apart, after which it will not come.
pub(super) const FOR_GOOD: u32 = 5;
/// A resistance shows in a step of the current of a tenth of the design capacity per hour and of so many mV.
const STEP: f64 = 0.1;
const STEP_MV: f64 = 10.0;
/// A step says nothing where the voltage does not move by so many times what it moves without one, on the average of so many
/// polls. Only so many of the last steps are kept.
const LOUDER: f64 = 3.0;
const QUIET: u32 = 5;
const KEPT_STEPS: usize = 64;
/// A jump of the state of charge in percent between two polls that are at most so many seconds apart.
const JUMP: f64 = 20.0;
const JUMP_S: f64 = 300.0;
/// Between two polls that measure a resistance, or how the voltage moves by itself: so many seconds at most, that warm, and so
/// full, in 0.1 K and percent.
const LOSS_S: f64 = 60.0;
const WARM: f64 = 2831.0;
const HALF_FULL: std::ops::RangeInclusive<f64> = 20.0..=90.0;
/// How many of them agree.
const LOSSES: usize = 5;
/// What learning needs to see: SLUA450, chapter 12 of SLUUBW5A.
const NEEDS: [&str; 4] =
    ["a rest until [OCVTAKEN]", "10 to 40 °C", "a charge to its end ([FC])", "a discharge to 10 %"];
/// The time in seconds in which resets belong together.
const DAY_S: f64 = 86_400.0;
/// After a write of the configuration a gauge predicts anew with the next rest, end of charge or step of a discharge. For so
/// many seconds what it predicted before is no finding.
const CONFIGURED_S: f64 = 3600.0;

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
    /// How many keys this program has sent.
    pub keys: u64,
}

/// What the polls of one pack have shown so far.
#[derive(Clone, Debug, Default)]
pub struct History {
    last: Option<Seen>,
    cycle: Option<Cycle>,
    learned: Option<Learned>,
    /// Until when nothing of [`NEEDS`] was seen: its last time, or the first poll.
    met: Option<[f64; 4]>,
    losses: VecDeque<f64>,
    /// By how many mV the voltage went with the last steps of the current; negative against them.
    steps: VecDeque<f64>,
    /// By how many mV it went without one, in all, and between how many polls.
    quiet: (f64, u32),
    resets: Vec<f64>,
    summary: Summary,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    time: f64,
    own: u64,
    keys: u64,
    is_sealed: Option<bool>,
    is_measured: bool,
    tenths: Option<f64>,
    voltage: Option<f64>,
    current: Option<f64>,
    percent: Option<f64>,
    design: Option<f64>,
    /// Design capacity, or the full charge capacity of a part that shows none.
    size: Option<f64>,
    full: Option<f64>,
    remaining: Option<f64>,
}

/// A change of the configuration, and what the gauge predicted before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Configured {
    since: f64,
    /// How long ago it was at the last poll.
    pub(super) seconds: f64,
    /// What became of Design Capacity; `None` if it did not change.
    pub(super) design: Option<(f64, f64)>,
    /// The full and the remaining capacity before.
    pub(super) full: Option<f64>,
    pub(super) now: Option<f64>,
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
    /// Whether it is known how the voltage moves without a step.
    pub(super) knows_quiet: bool,
    /// Since when the current is 0, until when, and the least and greatest voltage in that time.
    pub(super) still: Option<(f64, f64, f64, f64)>,
    /// The last jump: from and to.
    pub(super) jump: Option<(f64, f64)>,
    /// A change of Design Capacity that this program has not made.
    pub(super) redesigned: Option<(f64, f64)>,
    /// A change of the configuration within an hour, of this program or another one.
    pub(super) configured: Option<Configured>,
    /// The last change of Design Capacity by anybody, as long as the gauge has learned nothing since.
    pub(super) resized: Option<Configured>,
    /// Whether the gauge was SEALED and was opened by somebody else.
    pub(super) opened: bool,
    /// What disturbs a learning cycle, and for how many seconds.
    pub(super) spoiled: Option<(Spoiled, f64)>,
    /// What learning needs, and for how many seconds it was not seen.
    pub(super) unmet: [Option<(&'static str, f64)>; 4],
    /// What was learned, and what is left of it.
    pub(super) unlearned: Option<(Learned, Learned)>,
    /// The least of the last losses of voltage, in mV of the pack at the current that empties it in an hour.
    pub(super) loss: Option<f64>,
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
        let read = |role| Some(poll.registers.property(role)? as f64);
        let now = Seen {
            time: poll.time,
            own: poll.own,
            keys: poll.keys,
            is_sealed: is_sealed(chip, poll),
            is_measured: poll.is_measured,
            tenths: read(Role::Temp),
            voltage: read(Role::VoltageNow).filter(|_| poll.is_measured),
            current: read(Role::CurrentNow).or_else(|| read(Role::CurrentAvg)).filter(|_| poll.is_measured),
            percent: read(Role::Capacity).filter(|_| poll.is_measured),
            design: read(Role::ChargeFullDesign).filter(|&design| design > 0.0),
            size: read(Role::ChargeFullDesign).or_else(|| read(Role::ChargeFull)).filter(|&size| size > 0.0),
            full: read(Role::ChargeFull).filter(|_| poll.is_measured),
            remaining: read(Role::ChargeNow).filter(|_| poll.is_measured),
        };
        let summary = &mut self.summary;
        summary.unmeasured = if poll.is_measured { 0 } else { summary.unmeasured.saturating_add(1) };
        if let Some(last) = self.last.replace(now) {
            self.compare(&last, &now);
            self.watch_seal(chip, &last, &now, read(Role::Flags));
        }
        self.watch_rest(&now);
        self.watch_learning(chip, poll, &now, read(Role::Temp));
    }

    /// A change of the configuration, whose traces are no finding for a while.
    fn watch_configuration(&mut self, last: &Seen, now: &Seen) {
        let design = last.design.zip(now.design).filter(|(before, after)| before != after);
        let configured = &mut self.summary.configured;
        let is_changed = design.is_some() || last.own != now.own;
        if is_changed {
            // A reset after a write belongs to it, and predictions may be missing between the two.
            let before = configured.filter(|_| design.is_none());
            *configured = Some(Configured {
                since: now.time,
                seconds: 0.0,
                design: design.or(before.and_then(|before| before.design)),
                full: last.full.or(configured.and_then(|before| before.full)),
                now: last.remaining.or(configured.and_then(|before| before.now)),
            });
        }
        if design.is_some() {
            self.summary.resized = *configured;
        }
        for before in [&mut self.summary.resized, configured].into_iter().flatten() {
            before.seconds = now.time - before.since;
        }
        *configured = configured.filter(|before| before.seconds < CONFIGURED_S);
        if is_changed {
            // They were measured with another design capacity, or another gain.
            self.losses.clear();
            self.summary.loss = None;
        }
    }

    fn compare(&mut self, last: &Seen, now: &Seen) {
        self.watch_configuration(last, now);
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
            summary.redesigned = None;
            self.steps.clear();
            self.quiet = (0.0, 0);
        }
        let volts = last.voltage.zip(now.voltage).map(|(before, after)| after - before);
        let steps = last.current.zip(now.current).map(|(before, after)| after - before);
        let passed = last.current.unwrap_or(0.0).abs().max(now.current.unwrap_or(0.0).abs())
            * (now.time - last.time)
            / 3600.0;
        let Some(design) = now.size.or(last.size) else { return };
        let is_short = now.time - last.time <= LOSS_S;
        if let Some((volts, step)) = volts.zip(steps) {
            if step.abs() >= STEP * design {
                self.steps.push_back(volts * step.signum());
                self.steps.drain(..self.steps.len().saturating_sub(KEPT_STEPS));
            } else if is_short {
                self.quiet = (self.quiet.0 + volts.abs(), self.quiet.1.saturating_add(1));
            }
        }
        // A voltage that moves by itself, as of a large pack, goes against some steps by chance.
        let (moved, polls) = self.quiet;
        let least = STEP_MV.max(LOUDER * moved / f64::from(polls.max(1)));
        let count = |sign: f64| self.steps.iter().filter(|volts| **volts * sign >= least).count() as u32;
        (summary.agreeing, summary.opposed) = (count(1.0), count(-1.0));
        summary.knows_quiet = polls >= QUIET;
        if let Some((volts, step)) = volts.zip(steps)
            && step.abs() >= STEP * design
            && volts.abs() >= STEP_MV
        {
            let is_usual = now.tenths.is_some_and(|tenths| tenths >= WARM)
                && now.percent.is_some_and(|percent| HALF_FULL.contains(&percent));
            if volts / step > 0.0 && is_usual && is_short {
                self.losses.push_back(volts / step * design);
                self.losses.drain(..self.losses.len().saturating_sub(LOSSES));
                let least = self.losses.iter().copied().reduce(f64::min);
                summary.loss = least.filter(|_| self.losses.len() == LOSSES);
            }
        }
        if let Some((before, after)) = last.percent.zip(now.percent)
            && now.time - last.time <= JUMP_S
            && summary.configured.is_none()
            && (after - before).abs() >= JUMP + 400.0 * passed / design
        {
            summary.jump = Some((before, after));
        }
    }

    /// A reset opens a gauge with RAM as well, and a lost configuration goes with it.
    fn watch_seal(&mut self, chip: &'static Chip, last: &Seen, now: &Seen, flags: Option<f64>) {
        let shows_resets = chip.volatile != Some(0);
        let was_reset = flags.is_some_and(|flags| flags as u32 & chip.volatile.unwrap_or(0) != 0);
        let is_anothers = last.keys == now.keys && last.own == now.own && last.is_measured && now.is_measured;
        let opened = &mut self.summary.opened;
        match (last.is_sealed, now.is_sealed) {
            (_, Some(true) | None) => *opened = false,
            (Some(true), Some(false)) => *opened = shows_resets && !was_reset && is_anothers,
            _ => {}
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
            degrees: kelvins.map(|tenths| (tenths - FREEZING as f64) / 10.0),
            design_mah: now.design,
            percent: now.percent,
            has_learned_status: learned_status(chip).is_some_and(|at| poll.registers.value(at).is_some()),
        };
        let cycle = self.cycle.get_or_insert_with(|| Cycle::new(learns, Limits::default()));
        let had_learned = cycle.learned();
        let state = cycle.update(&reading);
        if state.learned > had_learned {
            self.summary.resized = None;
        }
        let spoiled = state.spoiled.filter(|_| state.learned != Learned::All);
        self.summary.spoiled = spoiled.map(|why| (why, state.time - state.since.time));
        if learns == Learns::ImpedanceTrack && reading.has_learned_status {
            let before = self.learned.replace(state.learned).unwrap_or(state.learned);
            let (most, _) = self.summary.unlearned.unwrap_or((before, before));
            let most = most.max(before);
            self.summary.unlearned = Some((most, state.learned)).filter(|(most, now)| most > now);
        }
        if learns != Learns::FullCharge {
            self.watch_needs(&state, &reading);
        }
    }

    fn watch_needs(&mut self, state: &State, reading: &Reading) {
        let sees = [
            state.phase == Phase::Rest && reading.bits.has_open_circuit_voltage(),
            reading.degrees.is_none_or(|degrees| (10.0..=40.0).contains(&degrees)),
            reading.bits.is_full(),
            reading.percent.is_some_and(|percent| percent <= 10.0),
        ];
        let met = self.met.get_or_insert([reading.time; 4]);
        for (at, sees) in sees.into_iter().enumerate() {
            if sees {
                met[at] = reading.time;
            }
            self.summary.unmet[at] =
                Some((NEEDS[at], reading.time - met[at])).filter(|(_, seconds)| *seconds > 0.0);
        }
    }
}

/// Whether the gauge is SEALED; `None` if the part does not show it.
fn is_sealed(chip: &Chip, poll: &Poll<'_>) -> Option<bool> {
    match &chip.security.status {
        SealStatus::Bits { sealed, .. } => Some(poll.control_status & sealed != 0),
        SealStatus::Field { word, shift } => {
            let word = match word {
                Source::Status => i64::from(poll.control_status),
                source => poll.registers.value(chip.register_at(*source)?)?,
            };
            Some(word >> shift & 3 == 3)
        }
        SealStatus::None => None,
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
