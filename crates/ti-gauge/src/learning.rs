// SPDX-License-Identifier: MIT

//! How far a learning cycle is, what it waits for, and whether something has spoiled it, from readings over time.
//!
//! Impedance Track: SLUA450, chapter 12 of SLUUBW5A, and TI's answers to owners. Qmax is learned from two open-circuit
//! voltages at rest with enough charge between them; Ra in a discharge between. CEDV: 2.1.3 of SLUUBD4A.

use std::collections::VecDeque;
use std::fmt;

use crate::chip::{Bit, Chip};

/// Temperatures in degrees at which an open-circuit voltage counts for Qmax.
const TEMPERATURE: (f64, f64) = (10.0, 40.0);
/// Voltages of a lithium-ion cell in mV at which it does not count, because the curve is too flat.
const FLAT_MV: (f64, f64) = (3737.0, 3800.0);
/// Charge that Qmax needs, as a share of the design capacity: for the first time, and later.
const FIRST_CHARGE: f64 = 0.9;
const LATER_CHARGE: f64 = 0.37;
/// Currents at which Ra is learned, as a share of the design capacity, with a margin for measured values.
const RATE: (f64, f64) = (0.097, 0.515);
/// Time in seconds for measuring a voltage's slope. One step of 1 mV in that time is 1.1 µV/s.
const SLOPE_S: f64 = 900.0;
/// After this time at rest, in seconds, [OCVTAKEN] no longer belongs to the rest before.
const ENTRY_S: f64 = 180.0;
/// Possible delay in seconds of a register that every tenth poll reads.
const LATE_S: f64 = 900.0;

/// How a part learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Learns {
    /// Qmax and Ra, by Impedance Track. IT_ENABLE starts it, and Update Status shows the progress.
    ImpedanceTrack,
    /// By Impedance Track in RAM: `[QMAX_UP]` and `[RES_UP]` show updates since power came.
    InRam,
    /// The full charge capacity, in a discharge from full down to EDV2 (CEDV).
    FullCharge,
}

impl Learns {
    /// How a chip learns, by its table; `None` if its bits do not show a learning cycle.
    pub fn of(chip: &Chip) -> Option<Self> {
        let has = |bits: &[Bit], name: &str| bits.iter().any(|bit| bit.name == name);
        if has(chip.control_status, "QMAX_UP") {
            Some(Self::InRam)
        } else if has(chip.control_status, "QEN") {
            Some(Self::ImpedanceTrack)
        } else if chip.registers.iter().any(|register| has(register.bits, "VDQ")) {
            Some(Self::FullCharge)
        } else {
            None
        }
    }
}

/// Thresholds of data flash; [`Limits::default`] has the manual's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Quit Current, the limit of a rest, in mA.
    pub quit_ma: f64,
    /// Dsg Current Threshold in mA.
    pub discharge_ma: f64,
    /// Chg Current Threshold in mA.
    pub charge_ma: f64,
    /// Number of series cells, if known.
    pub cells: Option<f64>,
}

impl Default for Limits {
    fn default() -> Self {
        Self { quit_ma: 40.0, discharge_ma: 60.0, charge_ma: 75.0, cells: None }
    }
}

/// Bits of the status registers about learning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bits(u16);

macro_rules! bits {
    ($($name:literal $method:ident $mask:literal),*) => {
        impl Bits {
            /// The bits with these names; other names are ignored.
            pub fn named<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
                let mask = |name| match name { $($name => $mask,)* "OCV_GD" => 0x0008, _ => 0 };
                Self(names.into_iter().fold(0, |bits, name| bits | mask(name)))
            }
            $(fn $method(self) -> bool { self.0 & $mask != 0 })*
        }
    };
}

bits! {
    "QEN" enabled 0x0001, "VOK" voltage_ok 0x0002, "RUP_DIS" ra_off 0x0004, "OCVTAKEN" ocv_taken 0x0008,
    "FC" full 0x0010, "CF0" qmax 0x0020, "CF1" both 0x0040, "ITEN" iten 0x0080, "Qmax" field 0x0100,
    "QMAX_UP" qmax_up 0x0200, "RES_UP" ra_up 0x0400, "VDQ" qualified 0x0800, "EDV2" edv2 0x1000
}

impl Bits {
    /// `[OCVTAKEN]`.
    pub(crate) fn has_open_circuit_voltage(self) -> bool {
        self.ocv_taken()
    }

    /// `[FC]`.
    pub(crate) fn is_full(self) -> bool {
        self.full()
    }

    /// Update Status, from LearnedStatus().
    pub fn update_status(self) -> u8 {
        let bits = [self.qmax(), self.both(), self.iten(), self.field()];
        (0..4).fold(0, |byte, at| byte | u8::from(bits[at]) << at)
    }
}

/// A reading of a gauge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Time of the reading, in seconds.
    pub time: f64,
    /// Its status bits.
    pub bits: Bits,
    /// Current() in mA.
    pub current_ma: f64,
    /// Voltage() in mV.
    pub voltage_mv: Option<f64>,
    /// Temperature() in degrees Celsius.
    pub degrees: Option<f64>,
    /// DesignCapacity() in mAh.
    pub design_mah: Option<f64>,
    /// StateOfCharge() in percent.
    pub percent: Option<f64>,
    /// Whether the part has LearnedStatus(), which shows Update Status.
    pub has_learned_status: bool,
}

/// What has been learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Learned {
    /// Nothing, or unknown.
    Nothing,
    /// Qmax.
    Qmax,
    /// Everything.
    All,
}

/// The pack's phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The current is below Quit Current.
    Rest,
    /// It charges.
    Charge,
    /// It discharges.
    Discharge,
}

impl Phase {
    /// Word for the line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Rest => "resting",
            Self::Charge => "charging",
            Self::Discharge => "discharging",
        }
    }
}

/// Why a cycle is disturbed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spoiled {
    /// `[QEN]` is clear.
    NotEnabled,
    /// A current ended a rest before an open-circuit voltage was taken: seconds, and mA.
    RestInterrupted(f64, f64),
    /// The open-circuit voltage was taken too cold or too warm, in degrees.
    Temperature(f64),
    /// The open-circuit voltage was in the flat part of the curve, in mV of a cell.
    Flat(f64),
    /// Too little charge between two open-circuit voltages, in percent of the design capacity, if watched; and the need.
    TooLittleCharge(Option<f64>, f64),
    /// The gauge was reset during the cycle.
    Reset,
    /// `[VOK]` is clear while a current flows: no earlier open-circuit voltage qualified.
    NoOpenCircuitVoltage,
    /// `[RUP_DIS]` is set during a discharge.
    RaOff,
    /// The discharge is too slow or too fast for Ra, as a share of the design capacity per hour.
    Rate(f64),
    /// Ra was not updated, although nothing else was wrong.
    RaNotLearned,
    /// A CEDV gauge has cleared `[VDQ]` before EDV2; whether it was being charged.
    DischargeDisqualified(bool),
}

impl Spoiled {
    fn same(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }
}

impl fmt::Display for Spoiled {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NotEnabled => write!(out, "Impedance Track is not enabled, [QEN] is clear"),
            Self::RestInterrupted(seconds, ma) => write!(
                out,
                "{:.0} mA ended the rest after {}, before an open-circuit voltage was taken",
                ma.abs(),
                hours(seconds)
            ),
            Self::Temperature(degrees) => {
                let (low, high) = TEMPERATURE;
                write!(
                    out,
                    "the open-circuit voltage was taken at {degrees:.1} °C, outside {low} to {high} °C"
                )
            }
            Self::Flat(mv) => {
                let (low, high) = FLAT_MV;
                write!(out, "the open-circuit voltage of {mv:.0} mV is in the flat range, {low} to {high} mV")
            }
            Self::TooLittleCharge(passed, needed) => {
                write!(out, "too little charge passed between two open-circuit voltages: ")?;
                passed.map_or(Ok(()), |passed| write!(out, "{passed:.0} % of the design capacity, "))?;
                write!(out, "{needed:.0} % needed")
            }
            Self::Reset => write!(out, "the gauge was reset; begin again with a rest"),
            Self::NoOpenCircuitVoltage => {
                write!(out, "[VOK] is clear: no open-circuit voltage qualified before this current")
            }
            Self::RaOff => write!(
                out,
                "[RUP_DIS] is set, Ra is not updated: no valid state of charge, or the chemistry is wrong"
            ),
            Self::Rate(rate) => write!(out, "Ra is learned between C/10 and C/2, not at {}", c_rate(rate)),
            Self::RaNotLearned => write!(
                out,
                "Qmax was updated but Ra was not; check chemistry and calibration, discharge at C/10 to C/5"
            ),
            Self::DischargeDisqualified(true) => {
                write!(out, "the pack was charged before EDV2, [VDQ] is clear")
            }
            Self::DischargeDisqualified(false) => {
                write!(out, "the gauge cleared [VDQ] before EDV2: too cold, too slow, or too long at rest")
            }
        }
    }
}

/// A start time, as far as known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Since {
    /// Seconds, on the clock of the readings.
    pub time: f64,
    /// It was so at the first reading already.
    pub before: bool,
}

/// Progress of a cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// What has been learned.
    pub learned: Learned,
    /// Update Status, if a register shows it.
    pub update_status: Option<u8>,
    /// What the cycle waits for; empty when it is over.
    pub waits_for: &'static str,
    /// The pack's phase.
    pub phase: Phase,
    /// Start of the phase.
    pub phase_since: Since,
    /// A flowing current as a share of the design capacity per hour.
    pub rate: Option<f64>,
    /// The slope of Voltage() at rest in µV/s, after some minutes of readings.
    pub slope_uv_s: Option<f64>,
    /// In degrees Celsius.
    pub degrees: Option<f64>,
    /// Bits that show the state, with `-` before clear ones.
    pub bits: String,
    /// The disturbance; `None` if the cycle is qualified, or over.
    pub spoiled: Option<Spoiled>,
    /// Start of being qualified, or not.
    pub since: Since,
    /// Time of the reading.
    pub time: f64,
}

impl State {
    /// The line of `gaugefs learn` and `gaugefs top`; `clock` prints a time.
    pub fn line(&self, clock: impl Fn(f64) -> String) -> String {
        let mut parts = Vec::new();
        if let Some(status) = self.update_status {
            parts.push(format!("update status {status:02x}"));
        }
        if self.learned == Learned::All {
            parts.push("learned".into());
        } else {
            parts.push(format!("waits for {}", self.waits_for));
        }
        let lasted = self.time - self.phase_since.time;
        let least = if self.phase_since.before { "at least " } else { "" };
        let mut now = format!("{} for {least}{}", self.phase.as_str(), hours(lasted));
        if let Some(rate) = self.rate {
            now += &format!(" at {}", c_rate(rate));
        }
        parts.push(now);
        if let Some(slope) = self.slope_uv_s {
            parts.push(format!("{slope:.1} µV/s"));
        }
        if let Some(degrees) = self.degrees {
            parts.push(format!("{degrees:.1} °C"));
        }
        parts.push(self.bits.clone());
        let before = if self.since.before { "before " } else { "" };
        let since = format!("since {before}{}", clock(self.since.time));
        match self.spoiled {
            Some(why) => parts.push(format!("disqualified {since}: {why}")),
            None if self.learned == Learned::All => parts.push(since),
            None => parts.push(format!("qualified {since}")),
        }
        parts.join("; ")
    }
}

fn hours(seconds: f64) -> String {
    let minutes = (seconds / 60.0).max(0.0) as u64;
    format!("{}:{:02} h", minutes / 60, minutes % 60)
}

fn c_rate(rate: f64) -> String {
    if rate < 1.0 { format!("C/{:.1}", 1.0 / rate.max(1e-3)) } else { format!("{rate:.1} C") }
}

/// A watched learning cycle.
#[derive(Clone, Debug)]
pub struct Cycle {
    learns: Learns,
    limits: Limits,
    before: Option<Reading>,
    phase: Phase,
    phase_since: Since,
    /// [OCVTAKEN] was clear in this rest, so it belongs to this rest once it is set.
    ocv_pending: bool,
    ocv_taken: bool,
    /// Charge since the last open-circuit voltage, if there was one.
    passed_mah: Option<f64>,
    /// Time of the open-circuit voltage after which Ra should be learned.
    due: Option<f64>,
    learned: Learned,
    /// A disturbance until the next open-circuit voltage.
    lasting: Option<Spoiled>,
    spoiled: Option<Spoiled>,
    since: Since,
    rest: VecDeque<(f64, f64)>,
}

impl Cycle {
    /// A cycle without readings.
    pub fn new(learns: Learns, limits: Limits) -> Self {
        let never = Since { time: 0.0, before: true };
        Self {
            learns,
            limits,
            before: None,
            phase: Phase::Rest,
            phase_since: never,
            ocv_pending: false,
            ocv_taken: false,
            passed_mah: None,
            due: None,
            learned: Learned::Nothing,
            lasting: None,
            spoiled: None,
            since: never,
            rest: VecDeque::new(),
        }
    }

    /// Sets thresholds once they are known.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// What has been learned by the last reading.
    pub fn learned(&self) -> Learned {
        self.learned
    }

    /// Takes a reading. Readings come in order of time.
    pub fn update(&mut self, reading: &Reading) -> State {
        let before = self.before.replace(*reading);
        let seconds = before.map_or(0.0, |before| (reading.time - before.time).max(0.0));
        if let Some(passed) = &mut self.passed_mah {
            *passed += reading.current_ma * seconds / 3600.0;
        }
        self.change_phase(before.as_ref(), reading);
        let had_learned = self.learned;
        self.learned = self.learned_now(reading);
        match self.learns {
            Learns::ImpedanceTrack | Learns::InRam => self.track(before.as_ref(), reading),
            Learns::FullCharge => self.full_charge(before.as_ref(), reading),
        }
        let spoiled = match self.learned {
            Learned::All => None,
            _ => self.passing(reading).or(self.lasting),
        };
        let same = match (self.spoiled, spoiled) {
            (None, None) => (had_learned == Learned::All) == (self.learned == Learned::All),
            (Some(a), Some(b)) => a.same(b),
            _ => false,
        };
        if before.is_none() || !same {
            self.since = Since { time: reading.time, before: before.is_none() };
        }
        self.spoiled = spoiled;
        self.state(reading)
    }

    fn learned_now(&self, reading: &Reading) -> Learned {
        let bits = reading.bits;
        match self.learns {
            Learns::ImpedanceTrack if bits.both() => Learned::All,
            Learns::ImpedanceTrack if bits.qmax() => Learned::Qmax,
            Learns::InRam if bits.qmax_up() && bits.ra_up() => Learned::All,
            Learns::InRam if bits.qmax_up() => Learned::Qmax,
            Learns::ImpedanceTrack | Learns::InRam => Learned::Nothing,
            // No bit shows it; only watching does.
            Learns::FullCharge => self.learned,
        }
    }

    fn change_phase(&mut self, before: Option<&Reading>, reading: &Reading) {
        let current = reading.current_ma;
        let flowing = if current < 0.0 { Phase::Discharge } else { Phase::Charge };
        let next = match () {
            () if current.abs() < self.limits.quit_ma => Phase::Rest,
            () if current <= -self.limits.discharge_ma || current >= self.limits.charge_ma => flowing,
            () if self.phase == Phase::Rest => flowing,
            () => self.phase,
        };
        if before.is_some() && next == self.phase {
            return;
        }
        let rested = reading.time - self.phase_since.time;
        let was_rest = self.phase == Phase::Rest && before.is_some();
        let tracks = self.learns != Learns::FullCharge;
        if was_rest && !self.ocv_taken && tracks && self.learned != Learned::All {
            self.lasting = Some(Spoiled::RestInterrupted(rested, current));
        }
        if next == Phase::Rest {
            // A pack at rest at the start may have rested for long.
            self.ocv_taken = before.is_none() && reading.bits.ocv_taken();
            self.ocv_pending = false;
        }
        self.phase = next;
        self.phase_since = Since { time: reading.time, before: before.is_none() };
        self.rest.clear();
    }

    fn track(&mut self, before: Option<&Reading>, reading: &Reading) {
        let bits = reading.bits;
        let held = before.is_some_and(|before| before.bits.voltage_ok());
        let mut taken = false;
        if self.phase == Phase::Rest {
            self.ocv_pending |= !bits.ocv_taken();
            // Distant polls see neither; a reset would set [RUP_DIS].
            let fell = held && !bits.voltage_ok() && !bits.ra_off();
            let new = self.ocv_pending || fell || reading.time - self.phase_since.time > ENTRY_S;
            taken = bits.ocv_taken() && new && !self.ocv_taken;
        }
        if taken {
            self.ocv_taken = true;
            self.take(reading, held);
        } else if held && !bits.voltage_ok() {
            // Only an open-circuit voltage clears it otherwise.
            self.lasting = Some(Spoiled::Reset);
            (self.passed_mah, self.due) = (None, None);
            if self.phase == Phase::Rest {
                (self.ocv_taken, self.ocv_pending) = (false, false);
                self.phase_since = Since { time: reading.time, before: false };
            }
        } else if !held && bits.voltage_ok() && self.phase == Phase::Rest && before.is_some() {
            // IT_ENABLE in a rested pack.
            (self.passed_mah, self.lasting) = (Some(0.0), None);
        }
        if self.learned == Learned::All {
            self.due = None;
        }
        if let Some(at) = self.due
            && (self.phase != Phase::Rest || reading.time - at > LATE_S)
        {
            self.due = None;
            self.lasting = Some(Spoiled::RaNotLearned);
        }
    }

    /// Takes an open-circuit voltage. `held` means that the gauge kept an earlier one.
    fn take(&mut self, reading: &Reading, held: bool) {
        let passed = self.passed_mah.zip(reading.design_mah.filter(|design| *design > 0.0));
        let passed = passed.map(|(passed, design)| passed.abs() / design);
        let cell = reading.voltage_mv.zip(self.limits.cells).map(|(voltage, cells)| voltage / cells);
        let first = self.learns == Learns::ImpedanceTrack
            && self.learned == Learned::Nothing
            && reading.has_learned_status;
        let needed = if first { FIRST_CHARGE } else { LATER_CHARGE };
        let degrees = reading.degrees.filter(|degrees| !(TEMPERATURE.0..=TEMPERATURE.1).contains(degrees));
        let flat = cell.filter(|mv| (FLAT_MV.0..=FLAT_MV.1).contains(mv));
        self.lasting = match (degrees, flat) {
            (Some(degrees), _) => Some(Spoiled::Temperature(degrees)),
            (None, Some(mv)) => Some(Spoiled::Flat(mv)),
            // The gauge still waits for the second one of two.
            (None, None) if held && reading.bits.voltage_ok() => {
                Some(Spoiled::TooLittleCharge(passed.map(|part| part * 100.0), needed * 100.0))
            }
            (None, None) => None,
        };
        match self.lasting {
            None => {
                let discharged = self.passed_mah.replace(0.0).is_some_and(|passed| passed < 0.0);
                let ra_is_due = discharged && self.learned == Learned::Qmax;
                self.due = Some(reading.time).filter(|_| ra_is_due);
            }
            // The gauge continues counting from the earlier one.
            Some(Spoiled::TooLittleCharge(..)) => {}
            Some(_) => self.passed_mah = None,
        }
    }

    fn passing(&self, reading: &Reading) -> Option<Spoiled> {
        let bits = reading.bits;
        if self.learns == Learns::FullCharge {
            return None;
        }
        if self.learns == Learns::ImpedanceTrack && !bits.enabled() {
            return Some(Spoiled::NotEnabled);
        }
        if self.phase == Phase::Rest || self.lasting.is_some() {
            return None;
        }
        if !bits.voltage_ok() {
            return Some(Spoiled::NoOpenCircuitVoltage);
        }
        if self.phase != Phase::Discharge || self.learned != Learned::Qmax {
            return None;
        }
        if bits.ra_off() {
            return Some(Spoiled::RaOff);
        }
        let rate = rate(reading).filter(|rate| !(RATE.0..=RATE.1).contains(rate))?;
        Some(Spoiled::Rate(rate))
    }

    /// CEDV: `[VDQ]` is set while a discharge from full is qualified, and clear when it is over.
    fn full_charge(&mut self, before: Option<&Reading>, reading: &Reading) {
        let held = before.is_some_and(|before| before.bits.qualified());
        if held && !reading.bits.qualified() {
            if reading.bits.edv2() {
                (self.learned, self.lasting) = (Learned::All, None);
            } else {
                self.lasting = Some(Spoiled::DischargeDisqualified(self.phase == Phase::Charge));
            }
        } else if reading.bits.qualified() {
            (self.learned, self.lasting) = (Learned::Nothing, None);
        }
    }

    fn waits_for(&self, reading: &Reading) -> &'static str {
        let bits = reading.bits;
        if self.learned == Learned::All {
            return "";
        }
        if self.learns == Learns::FullCharge {
            return match self.phase {
                Phase::Charge => "the end of the charge",
                _ if bits.qualified() => "the discharge down to EDV2",
                _ => "a charge to full, then a discharge down to EDV2 without a charge",
            };
        }
        if self.learns == Learns::ImpedanceTrack && !bits.enabled() {
            return "IT_ENABLE, in an empty pack that has rested for 5 h";
        }
        let full = bits.full() || reading.percent.is_some_and(|percent| percent >= 50.0);
        match self.phase {
            Phase::Charge => "the end of the charge, then a rest",
            Phase::Discharge => "the end of the discharge, then a rest",
            Phase::Rest if !self.ocv_taken => {
                "an open-circuit voltage: a rest at 10 to 40 °C until the voltage changes by less than 4 µV/s, or 5 h"
            }
            Phase::Rest if full => "a discharge to empty at C/10 to C/2",
            Phase::Rest => "a charge to full",
        }
    }

    fn state(&mut self, reading: &Reading) -> State {
        let bits = reading.bits;
        let on = |name: &str, set: bool| if set { name.to_string() } else { format!("-{name}") };
        let shown = match self.learns {
            Learns::ImpedanceTrack => {
                vec![on("VOK", bits.voltage_ok()), on("RUP_DIS", bits.ra_off()), on("QEN", bits.enabled())]
            }
            Learns::InRam => vec![
                on("VOK", bits.voltage_ok()),
                on("RUP_DIS", bits.ra_off()),
                on("QMAX_UP", bits.qmax_up()),
                on("RES_UP", bits.ra_up()),
            ],
            Learns::FullCharge => vec![on("VDQ", bits.qualified()), on("EDV2", bits.edv2())],
        };
        State {
            learned: self.learned,
            update_status: Some(bits.update_status()).filter(|_| reading.has_learned_status),
            waits_for: self.waits_for(reading),
            phase: self.phase,
            phase_since: self.phase_since,
            rate: rate(reading).filter(|_| self.phase != Phase::Rest),
            slope_uv_s: self.slope(reading),
            degrees: reading.degrees,
            bits: shown.join(" "),
            spoiled: self.spoiled,
            since: self.since,
            time: reading.time,
        }
    }

    fn slope(&mut self, reading: &Reading) -> Option<f64> {
        if self.phase != Phase::Rest {
            return None;
        }
        self.rest.push_back((reading.time, reading.voltage_mv?));
        // An older one stays, so that the span is never shorter.
        while self.rest.get(1).is_some_and(|(time, _)| reading.time - time >= SLOPE_S) {
            self.rest.pop_front();
        }
        let (time, voltage) = *self.rest.front()?;
        let span = reading.time - time;
        (span >= SLOPE_S / 3.0).then(|| (reading.voltage_mv.unwrap_or(voltage) - voltage) * 1000.0 / span)
    }
}

fn rate(reading: &Reading) -> Option<f64> {
    reading.design_mah.filter(|design| *design > 0.0).map(|design| reading.current_ma.abs() / design)
}
