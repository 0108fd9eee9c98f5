// SPDX-License-Identifier: MIT

//! The model of the parts with block access: measurements, coulomb counting, states and flags, and their registers. As
//! in the parts, thresholds come from data flash at a reset. [`Map`] has what differs between parts: the places of
//! parameters and the contents of registers.

use std::mem;

use super::analog::Analog;
use super::battery::Battery;
use super::flash::Flash;
use super::learning::{LEARNED, Learning, Lesson, Ocv, QMAX_AND_RA, settled};
use super::model::{AVERAGE_S, FREEZING, Kept, Model, NO_TIME, Registers, lasting, signed, whole};
use super::model::{Host, Place};

const OCV_S: f64 = 1800.0;

// Conditions as Flags() of the bq34z100-G1 shows them (SLUSBZ5D table 7-6) ...
pub(super) const OTC: u32 = 0x8000;
pub(super) const OTD: u32 = 0x4000;
pub(super) const BATHI: u32 = 0x2000;
pub(super) const BATLOW: u32 = 0x1000;
pub(super) const CHG_INH: u32 = 0x0800;
pub(super) const XCHG: u32 = 0x0400;
pub(super) const FC: u32 = 0x0200;
pub(super) const CHG: u32 = 0x0100;
pub(super) const OCVTAKEN: u32 = 0x0080;
pub(super) const CF: u32 = 0x0010;
pub(super) const SOC1: u32 = 0x0004;
pub(super) const SOCF: u32 = 0x0002;
pub(super) const DSG: u32 = 0x0001;
// ... and two more: too warm and too cold, with or without a current.
pub(super) const OT: u32 = 0x0001_0000;
pub(super) const UT: u32 = 0x0002_0000;
// FlagsB(), table 7-7.
const FIRSTDOD: u16 = 0x2000;
const DODEOC: u16 = 0x0400;

/// Where a part keeps the parameters of gauging, and what its registers show.
#[derive(Debug)]
pub(super) struct Map {
    /// Reads the thresholds.
    pub(super) settings: fn(&Flash) -> Settings,
    /// Address, number of bytes, quantity.
    pub(super) registers: &'static [(u8, usize, Quantity)],
    pub(super) flags: &'static [(u32, u16)],
    pub(super) cycles: Option<Place>,
    /// Classes of the lifetime data and of their sample count.
    pub(super) lifetime: Option<(u16, u16)>,
    /// Where Impedance Track stores what it learns.
    pub(super) learned: Option<Learns>,
}

/// Places of learned values.
#[derive(Debug)]
pub(super) struct Learns {
    pub(super) qmax: Place,
    /// Qmax is a share of Design Capacity, 16384 for all of it, instead of mAh.
    pub(super) of_design: bool,
    pub(super) count: Option<Place>,
    pub(super) status: Option<Place>,
}

/// Largest learned Qmax as a share of Design Capacity (Max % Default Qmax).
const MOST_QMAX: f64 = 1.2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    AtRate,
    AtRateTimeToEmpty,
    AverageCurrent,
    AveragePower,
    AverageCentiwatts,
    AvailableEnergy,
    ChargeCurrent,
    ChargeVoltage,
    ConstantPowerTimeToEmpty,
    Current,
    /// The factor by which the host multiplies currents and charges.
    CurrentScale,
    CycleCount,
    DesignCapacity,
    Dod,
    DodTime,
    /// DOD0Time() in sixteenths of an hour.
    DodTimeHours,
    EndDod,
    EnergyScale,
    Flags,
    FlagsB,
    Full,
    Grid,
    Health,
    HealthStatus,
    InternalTemperature,
    LearnedStatus,
    MaxError,
    MaxLoadCurrent,
    MaxLoadTimeToEmpty,
    NominalFull,
    NominalRemaining,
    PackConfiguration,
    PassedCharge,
    Percent,
    PowerDrawn,
    QmaxPassed,
    Remaining,
    SerialNumber,
    StandbyCurrent,
    StandbyTimeToEmpty,
    StartCharge,
    StateTime,
    Temperature,
    TimeToEmpty,
    TimeToFull,
    Voltage,
    VoltageScale,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Settings {
    pub(super) ot_charge: (f64, f64, f64),
    pub(super) ot_discharge: (f64, f64, f64),
    /// Limits of OT and UT, and the hysteresis.
    pub(super) over: (f64, f64),
    pub(super) under: (f64, f64),
    pub(super) inhibit: (f64, f64, f64),
    pub(super) suspend: (f64, f64),
    pub(super) taper_ma: f64,
    pub(super) taper_mv: f64,
    pub(super) taper_s: f64,
    pub(super) charge_alert: (i8, i8),
    pub(super) full: (i8, i8),
    pub(super) serial: u16,
    pub(super) cycle_mah: f64,
    pub(super) cycles: u16,
    pub(super) max_error_limit: u8,
    pub(super) design_mah: u16,
    pub(super) charge_mv: [u16; 3],
    pub(super) charge_percent: [u8; 3],
    /// Limits of the temperature ranges.
    pub(super) jeita: Option<[f64; 4]>,
    /// mWh per step of an energy.
    pub(super) energy_scale: f64,
    /// Factors for voltages, currents and energies that the host applies, as registers show them.
    pub(super) scales: [u8; 3],
    pub(super) soc1: (u16, u16),
    pub(super) socf: (u16, u16),
    pub(super) low_mv: (f64, f64, f64),
    pub(super) high_mv: (f64, f64, f64),
    pub(super) pack: u16,
    pub(super) full_at_taper: bool,
    pub(super) thermistor: bool,
    /// The host writes Temperature().
    pub(super) host_temperature: bool,
    pub(super) reserve_mah: f64,
    pub(super) discharge_ma: f64,
    pub(super) charge_ma: f64,
    pub(super) quit_ma: f64,
    pub(super) relax_s: (f64, f64),
    pub(super) internal_offset: f64,
    pub(super) external_offset: f64,
    /// CC Gain, and the counts of Board Offset and CC Offset.
    pub(super) gain: f64,
    pub(super) board_offset: f64,
    pub(super) cc_offset: f64,
    pub(super) deadband_ma: f64,
    pub(super) standby_ma: f64,
    pub(super) max_load_ma: f64,
    pub(super) inverted: bool,
    pub(super) cells: f64,
    pub(super) qmax_mah: f64,
    pub(super) enabled: bool,
    /// Update Status without the bit of IT_ENABLE.
    pub(super) learned: u8,
    pub(super) lifetime_s: f64,
    pub(super) lifetime_step: [f64; 3],
    pub(super) lifetime: [f64; 6],
}

impl Settings {
    pub(super) fn none() -> Self {
        Self {
            ot_charge: (f64::INFINITY, 0.0, f64::INFINITY),
            ot_discharge: (f64::INFINITY, 0.0, f64::INFINITY),
            over: (f64::INFINITY, 0.0),
            under: (f64::NEG_INFINITY, 0.0),
            inhibit: (f64::NEG_INFINITY, f64::INFINITY, 0.0),
            suspend: (f64::NEG_INFINITY, f64::INFINITY),
            taper_s: 40.0,
            charge_alert: (99, 95),
            full: (-1, 98),
            cycle_mah: f64::INFINITY,
            max_error_limit: 100,
            charge_mv: [4200; 3],
            energy_scale: 1.0,
            high_mv: (f64::INFINITY, 0.0, f64::INFINITY),
            discharge_ma: 60.0,
            charge_ma: 75.0,
            quit_ma: 40.0,
            relax_s: (60.0, 60.0),
            gain: 1.0,
            deadband_ma: 5.0,
            cells: 1.0,
            qmax_mah: 1000.0,
            enabled: true,
            ..Self::default()
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Rest,
    Charge,
    Discharge,
}

#[derive(Clone, Debug)]
pub(super) struct Gauging {
    map: &'static Map,
    battery: Battery,
    pub(super) analog: Analog,
    settings: Settings,
    measured: bool,
    /// The full charge capacity does not follow Design Capacity.
    pub(super) keeps_full: bool,
    pub(super) ram: Ram,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Ram {
    /// AtRate(), and Temperature() where the host may write it.
    at_rate_ma: i16,
    host_temperature: Option<u16>,
    drift_mah: f64,
    pub(super) enabled: bool,
    max_error: u8,
    average_ma: f64,
    state: State,
    state_s: f64,
    quiet_s: f64,
    flags: u32,
    flags_b: u16,
    over_s: [f64; 2],
    low_s: f64,
    high_s: f64,
    taper_s: f64,
    tapered: bool,
    cycle_mah: f64,
    cycles: u16,
    passed_mah: f64,
    qmax_passed_mah: f64,
    start_mah: f64,
    dod: f64,
    dod_s: f64,
    end_dod: f64,
    /// Extremes of temperature, charge and discharge current, and voltage, in the units of data flash.
    lifetime: [f64; 6],
    lifetime_kept: [f64; 6],
    lifetime_s: f64,
    pub(super) learning: Learning,
    /// Cycle count, lifetime data or learned values have changed since they were stored.
    cycles_changed: bool,
    lifetime_changed: bool,
    learned_changed: bool,
}

impl Gauging {
    pub(super) fn new(map: &'static Map, flash: &Flash, soc: f64) -> Self {
        let settings = (map.settings)(flash);
        let battery = Battery::new(settings.cells, settings.qmax_mah, soc);
        let ram = Ram { max_error: 2, state_s: 3600.0, dod_s: 1800.0, flags: OCVTAKEN, ..Ram::default() };
        let analog = Analog::fitting(settings.gain);
        let mut new = Self { map, battery, analog, settings, measured: true, keeps_full: false, ram };
        new.load(flash);
        new.begin_learning();
        new
    }

    pub(super) fn write(&mut self, register: Host, word: u16) {
        match register {
            Host::AtRate => self.ram.at_rate_ma = word as i16,
            Host::Temperature => self.ram.host_temperature = Some(word),
        }
    }

    /// Loads data flash and takes an open-circuit voltage.
    pub(super) fn load(&mut self, flash: &Flash) {
        self.apply(flash);
        self.ram.lifetime = self.settings.lifetime;
        self.ram.lifetime_kept = self.ram.lifetime;
        self.take_ocv();
        self.update(0.0);
    }

    /// Loads data flash and continues counting.
    pub(super) fn apply(&mut self, flash: &Flash) {
        let qmax_mah = self.settings.qmax_mah;
        self.settings = (self.map.settings)(flash);
        if self.keeps_full {
            self.settings.qmax_mah = qmax_mah;
        }
        self.battery.resize(self.settings.cells, self.settings.qmax_mah);
        self.ram.enabled = self.settings.enabled;
        self.ram.cycles = self.settings.cycles;
        self.update(0.0);
    }

    pub(super) fn first_voltage(&mut self) {
        if !self.measured {
            self.measured = true;
            self.update(0.0);
        }
    }

    fn take_ocv(&mut self) {
        let percent = self.ocv_percent();
        self.ram.dod = 16384.0 * (1.0 - percent / 100.0);
        (self.ram.dod_s, self.ram.drift_mah) = (0.0, 0.0);
        if self.battery.is_own {
            self.ram.drift_mah = self.capacity() * percent / 100.0 - self.battery.charge_mah;
        }
        self.simulate();
    }

    /// The state of charge by the present voltage, if the pack is at rest. The gauge knows no more of a pack with a
    /// capacity of its own.
    fn ocv_percent(&self) -> f64 {
        if self.battery.is_own {
            self.battery.percent_at(self.battery.cell_mv())
        } else {
            self.battery.percent()
        }
    }

    /// The capacity as the gauge believes it.
    fn capacity(&self) -> f64 {
        if self.battery.is_own { self.settings.qmax_mah } else { self.battery.capacity_mah }
    }

    /// The pack's real capacity, where data flash has another one.
    pub(super) fn own_capacity(&self) -> Option<f64> {
        self.battery.is_own.then_some(self.battery.capacity_mah)
    }

    pub(super) fn set_capacity(&mut self, own: Option<f64>) {
        self.battery.is_own = own.is_some();
        self.battery.set_capacity(own.unwrap_or(self.settings.qmax_mah));
        // The counted charge is kept.
        let counted = self.ram.start_mah + self.ram.passed_mah + self.settings.reserve_mah;
        self.ram.drift_mah = if own.is_some() { counted - self.battery.charge_mah } else { 0.0 };
    }

    /// Enables Impedance Track. A pack at rest shows its depth of discharge at once.
    pub(super) fn enable(&mut self) {
        self.ram.enabled = true;
        self.begin_learning();
    }

    fn begin_learning(&mut self) {
        self.ram.learning = Learning::after_reset();
        if self.ram.flags & OCVTAKEN != 0 {
            self.learn();
        }
    }

    fn learn(&mut self) {
        if !self.ram.enabled {
            return;
        }
        let degrees = (self.temperature() - FREEZING) / 10.0;
        let ocv = Ocv { dod: 1.0 - self.ocv_percent() / 100.0, cell_mv: self.cell_mv(), degrees };
        let s = &mut self.settings;
        let design_mah = f64::from(s.design_mah);
        let lesson = self.ram.learning.take(&ocv, design_mah, s.learned);
        if let Some(Lesson { qmax_mah, learned }) = lesson {
            s.learned = s.learned & !LEARNED | learned;
            let of_design = self.map.learned.as_ref().is_some_and(|learns| learns.of_design);
            let most = if of_design { design_mah * MOST_QMAX } else { 32_767.0 };
            s.qmax_mah = qmax_mah.round().clamp(1.0, most.max(1.0));
            self.ram.max_error = if learned == QMAX_AND_RA { 1 } else { 3 };
            self.ram.learned_changed = true;
            if self.battery.is_own {
                self.take_ocv();
            }
        }
    }

    /// Predicts anew, and counts from here.
    fn simulate(&mut self) {
        self.ram.passed_mah = 0.0;
        self.ram.start_mah = self.remaining();
    }

    fn remaining(&self) -> f64 {
        (self.counted() - self.settings.reserve_mah).max(0.0)
    }

    fn counted(&self) -> f64 {
        (self.battery.charge_mah + self.ram.drift_mah).clamp(0.0, self.capacity())
    }

    fn full(&self) -> f64 {
        (self.capacity() - self.settings.reserve_mah).max(0.0)
    }

    pub(super) fn voltage_mv(&self) -> u16 {
        let pack = self.battery.cell_mv() * self.battery.cells;
        let there = self.battery.forced_mv.map_or(pack, f64::from);
        if self.measured { whole(self.analog.voltage_mv(there)) } else { 0 }
    }

    fn cell_mv(&self) -> f64 {
        f64::from(self.voltage_mv()) / self.battery.cells
    }

    /// 0 within the deadband.
    fn current_ma(&self) -> f64 {
        let s = &self.settings;
        let current = self.battery.current_ma();
        let current = self.analog.current_ma(current, s.gain, s.board_offset, s.cc_offset);
        let current = if self.settings.inverted { -current } else { current };
        if current.abs() < self.settings.deadband_ma { 0.0 } else { current }
    }

    /// Loads the offsets that the gauge has just measured and stored.
    pub(super) fn take_offsets(&mut self, flash: &Flash) {
        let settings = (self.map.settings)(flash);
        (self.settings.board_offset, self.settings.cc_offset) = (settings.board_offset, settings.cc_offset);
    }

    pub(super) fn set_series(&mut self, series: Option<f64>) {
        self.battery.series = series;
        self.battery.cells = series.unwrap_or(self.settings.cells);
    }

    pub(super) fn is_quiet(&self, sleep_ma: f64) -> bool {
        self.ram.state == State::Rest && self.ram.average_ma.abs() <= sleep_ma
    }

    /// Updates states and flags after `seconds` of the present measurements.
    fn update(&mut self, seconds: f64) {
        self.change_state(seconds);
        self.terminate(seconds);
        let temperature = self.temperature() - FREEZING;
        let (cell, remaining) = (self.cell_mv(), whole(self.remaining()));
        // The exact value decides: a rounded percentage does not make a pack full.
        let (exact, percent) = (self.percent(), self.percent().round() as i8);
        let (s, ram) = (&self.settings, &mut self.ram);
        let (charging, discharging) = (ram.state == State::Charge, ram.state == State::Discharge);

        let (limit, otc_time, otc_clear) = s.ot_charge;
        let otc_s = lasting(&mut ram.over_s[0], charging && temperature >= limit, seconds);
        let (limit, otd_time, otd_clear) = s.ot_discharge;
        let otd_s = lasting(&mut ram.over_s[1], discharging && temperature >= limit, seconds);
        let ((over, back), (under, up)) = (s.over, s.under);
        let (low, high, hysteresis) = s.inhibit;
        let inhibited = temperature < low || temperature > high;
        let allowed = temperature >= low + hysteresis && temperature <= high - hysteresis;
        let suspended = temperature < s.suspend.0 || temperature > s.suspend.1;
        let (low_mv, low_time, low_clear) = s.low_mv;
        let low_s = lasting(&mut ram.low_s, cell < low_mv, seconds);
        let low_clear = if low_clear < DISTANCE { low_mv + low_clear } else { low_clear };
        let (high_mv, high_time, high_clear) = s.high_mv;
        let high_s = lasting(&mut ram.high_s, cell > high_mv, seconds);
        let high_clear = if high_clear < DISTANCE { high_mv - high_clear } else { high_clear };
        let full = if s.full.0 < 0 { ram.tapered } else { exact >= f64::from(s.full.0) };
        for (bit, set, clear) in [
            // A time of 0 switches the protection off.
            (OTC, otc_time > 0.0 && otc_s >= otc_time, temperature <= otc_clear),
            (OTD, otd_time > 0.0 && otd_s >= otd_time, temperature <= otd_clear),
            (OT, temperature >= over, temperature < over - back),
            (UT, temperature <= under, temperature > under + up),
            (CHG_INH, !charging && inhibited, charging || allowed),
            (XCHG, charging && suspended, !charging || allowed),
            (BATLOW, cell < low_mv && low_s >= low_time, cell > low_clear),
            (BATHI, cell > high_mv && high_s >= high_time, cell < high_clear),
            (SOC1, remaining <= s.soc1.0, remaining >= s.soc1.1),
            (SOCF, remaining <= s.socf.0, remaining >= s.socf.1),
            (FC, full, percent <= s.full.1),
            (CF, ram.max_error > s.max_error_limit, true),
            (DSG, discharging, true),
        ] {
            if set {
                ram.flags |= bit;
            } else if clear {
                ram.flags &= !bit;
            }
        }
        let (alert, clear) = s.charge_alert;
        let stop = if alert < 0 { ram.tapered } else { exact >= f64::from(alert) };
        let stopped = stop || ram.flags & CHG == 0 && percent > clear;
        let allowed = !stopped && ram.flags & (OTC | BATHI | CHG_INH | XCHG | OT | UT) == 0;
        ram.flags = if allowed { ram.flags | CHG } else { ram.flags & !CHG };
    }

    fn change_state(&mut self, seconds: f64) {
        let current = self.current_ma();
        let s = &self.settings;
        self.ram.quiet_s = if current.abs() < s.quit_ma { self.ram.quiet_s + seconds } else { 0.0 };
        let next = if -current > s.discharge_ma {
            State::Discharge
        } else if current > s.charge_ma {
            State::Charge
        } else {
            match self.ram.state {
                State::Discharge if self.ram.quiet_s >= s.relax_s.0 => State::Rest,
                State::Charge if self.ram.quiet_s >= s.relax_s.1 => State::Rest,
                same => same,
            }
        };
        self.ram.state_s += seconds;
        if next != self.ram.state {
            self.ram.state = next;
            self.ram.state_s = 0.0;
            self.ram.learning.change();
            self.simulate();
            if next == State::Rest {
                self.ram.flags &= !OCVTAKEN;
                self.ram.flags_b |= FIRSTDOD;
            } else {
                self.ram.flags_b &= !FIRSTDOD;
            }
        }
        let rested = self.ram.state == State::Rest && self.ram.state_s >= OCV_S;
        let settled = || settled(self.battery.slope_mv_s(), self.ram.state_s);
        if rested && self.ram.flags & OCVTAKEN == 0 && settled() {
            self.take_ocv();
            self.learn();
            self.ram.flags |= OCVTAKEN;
            self.ram.flags_b &= !FIRSTDOD;
        }
    }

    /// While discharging, compares the voltage with the open-circuit voltage for the counted charge.
    fn measure_resistance(&mut self, seconds: f64) {
        if !self.ram.enabled || self.ram.state != State::Discharge {
            return;
        }
        let current = self.current_ma().abs();
        if current == 0.0 {
            return;
        }
        let open = self.battery.open_circuit(100.0 * self.counted() / self.capacity());
        let (rate, cell) = (current / f64::from(self.settings.design_mah.max(1)), self.cell_mv());
        self.ram.learning.discharge(seconds, rate, cell, open);
    }

    /// Primary charge termination: two windows below the taper current near the full voltage.
    fn terminate(&mut self, seconds: f64) {
        let s = &self.settings;
        let near = self.cell_mv() >= f64::from(s.charge_mv[1]) - s.taper_mv;
        let low = self.ram.average_ma > 0.0 && self.ram.average_ma < s.taper_ma;
        let tapering = self.ram.state == State::Charge && near && low;
        self.ram.taper_s = if tapering { self.ram.taper_s + seconds } else { 0.0 };
        if tapering && !self.ram.tapered && self.ram.taper_s >= 2.0 * s.taper_s {
            self.ram.tapered = true;
            if s.full_at_taper {
                self.ram.drift_mah = self.capacity() - self.battery.charge_mah;
            }
            self.ram.end_dod = 16384.0 * (1.0 - self.battery.percent() / 100.0);
            self.ram.flags_b |= DODEOC;
            if self.ram.enabled {
                self.ram.max_error = self.ram.max_error.min(3);
            }
        } else if self.ram.state == State::Discharge {
            self.ram.tapered = false;
            self.ram.flags_b &= !DODEOC;
        }
    }

    /// Tracks the extremes. Returns whether they are worth a flash write (SLUSBZ5D 7.3.6.17).
    fn track(&mut self, seconds: f64) -> bool {
        let s = &self.settings;
        if !self.ram.enabled || s.lifetime_s == 0.0 {
            return false;
        }
        let (degrees, current) = (self.temperature() - FREEZING, self.current_ma());
        let volts = f64::from(self.voltage_mv()) / 20.0;
        for (at, value) in [(0, degrees), (2, current), (4, volts)] {
            self.ram.lifetime[at] = self.ram.lifetime[at].max(value);
        }
        for (at, value) in [(1, degrees), (3, current), (5, volts)] {
            self.ram.lifetime[at] = self.ram.lifetime[at].min(value);
        }
        self.ram.lifetime_s += seconds;
        let grown = (0..6).any(|i| {
            (self.ram.lifetime[i] - self.ram.lifetime_kept[i]).abs()
                >= self.settings.lifetime_step[i / 2].max(1.0)
        });
        if !grown || self.ram.lifetime_s < s.lifetime_s {
            return false;
        }
        self.ram.lifetime_s = 0.0;
        self.ram.lifetime_kept = self.ram.lifetime;
        true
    }

    fn sensed(&self) -> f64 {
        self.battery.temperature() * 10.0 + FREEZING + self.analog.temperature
    }

    fn die(&self) -> f64 {
        self.sensed() + self.settings.internal_offset
    }

    pub(super) fn temperature(&self) -> f64 {
        if self.settings.host_temperature {
            return self.ram.host_temperature.map_or(self.die(), f64::from);
        }
        if !self.settings.thermistor {
            return self.die();
        }
        self.analog.thermistor.shows(self.sensed()) + self.settings.external_offset
    }

    /// ChargeVoltage() and ChargeCurrent() for the present temperature.
    fn charge_advice(&self) -> (u16, u16) {
        let s = &self.settings;
        let temperature = self.temperature() - FREEZING;
        let range = match s.jeita {
            None => 1,
            Some([t1, _, _, t4]) if temperature < t1 || temperature > t4 => return (0, 0),
            Some([_, t2, t3, _]) => usize::from(temperature >= t2) + usize::from(temperature >= t3),
        };
        let current = f64::from(s.design_mah) * f64::from(s.charge_percent[range]) / 100.0;
        (s.charge_mv[range], whole(current))
    }

    /// Minutes to empty and to full at the average current; the second allows for the taper.
    fn times(&self) -> (u16, u16) {
        let average = self.ram.average_ma.round();
        let minutes = |mah: f64| whole((mah / average.abs() * 60.0).min(65534.0));
        match self.ram.state {
            State::Discharge if average < 0.0 => (minutes(self.remaining()), NO_TIME),
            State::Charge if average > 0.0 => {
                (NO_TIME, minutes((self.full() - self.remaining()).max(0.0) * 1.1))
            }
            _ => (NO_TIME, NO_TIME),
        }
    }

    fn minutes_at(&self, load_ma: f64) -> u16 {
        if load_ma < 0.0 { whole((self.remaining() / -load_ma * 60.0).min(65534.0)) } else { NO_TIME }
    }

    pub(super) fn predicted(&self) -> impl Iterator<Item = u8> {
        let predicted = self.map.registers.iter().filter(|(_, _, quantity)| quantity.is_predicted());
        predicted.flat_map(|&(register, size, _)| register..register + size as u8)
    }

    /// The registers, with 0 for those that the host writes, and for predictions while no battery is `present`.
    pub(super) fn registers(&self, calibration: bool, present: bool) -> Registers {
        let mut out = [0; 0x80];
        for &(register, size, quantity) in self.map.registers {
            let word = if present || !quantity.is_predicted() { self.show(quantity, calibration) } else { 0 };
            let at = usize::from(register);
            out[at..at + size].copy_from_slice(&word.to_le_bytes()[..size]);
        }
        out
    }

    fn show(&self, quantity: Quantity, calibration: bool) -> u16 {
        let s = &self.settings;
        match quantity {
            Quantity::AtRate => self.ram.at_rate_ma as u16,
            Quantity::AtRateTimeToEmpty => self.minutes_at(f64::from(self.ram.at_rate_ma)),
            Quantity::AverageCurrent => signed(self.ram.average_ma),
            Quantity::AveragePower => signed(self.ram.average_ma * f64::from(self.voltage_mv()) / 1000.0),
            Quantity::AverageCentiwatts => {
                signed(self.ram.average_ma * f64::from(self.voltage_mv()) / 10_000.0)
            }
            Quantity::AvailableEnergy => {
                let counted = self.counted();
                let reserve = self.battery.energy_mwh(counted - self.remaining());
                whole((self.battery.energy_mwh(counted) - reserve) / s.energy_scale)
            }
            Quantity::ChargeCurrent => self.charge_advice().1,
            Quantity::ChargeVoltage => self.charge_advice().0,
            Quantity::ConstantPowerTimeToEmpty | Quantity::TimeToEmpty => self.times().0,
            Quantity::Current => signed(self.current_ma()),
            Quantity::CurrentScale => s.scales[1].into(),
            Quantity::CycleCount => self.ram.cycles,
            Quantity::DesignCapacity => s.design_mah,
            Quantity::Dod => whole(self.ram.dod),
            Quantity::DodTime => whole(self.ram.dod_s / 60.0),
            Quantity::DodTimeHours => whole(self.ram.dod_s * 16.0 / 3600.0),
            Quantity::EndDod => whole(self.ram.end_dod),
            Quantity::EnergyScale => s.scales[2].into(),
            Quantity::Flags => {
                let set = self.map.flags.iter().filter(|(condition, _)| self.ram.flags & condition != 0);
                set.fold(0, |word, (_, bit)| word | bit)
            }
            Quantity::FlagsB => self.ram.flags_b,
            Quantity::Full => whole(self.full()),
            Quantity::Grid => ((100.0 - self.percent()) / 100.0 * 14.0) as u16,
            Quantity::Health => match s.design_mah {
                0 => 0,
                design => whole((100.0 * self.full() / f64::from(design)).min(100.0)),
            },
            Quantity::HealthStatus => 3,
            Quantity::InternalTemperature => whole(self.die()),
            Quantity::LearnedStatus => u16::from(s.learned) | u16::from(self.ram.enabled) << 2,
            Quantity::MaxError => u16::from(self.ram.max_error),
            Quantity::MaxLoadCurrent => signed(s.max_load_ma),
            Quantity::MaxLoadTimeToEmpty => self.minutes_at(s.max_load_ma),
            Quantity::NominalFull => whole(self.capacity()),
            Quantity::NominalRemaining => whole(self.counted()),
            // CAL_ENABLE toggles the bit in the running copy.
            Quantity::PackConfiguration if calibration => s.pack | 0x4000,
            Quantity::PackConfiguration => s.pack,
            Quantity::PassedCharge => signed(self.ram.passed_mah),
            Quantity::Percent => whole(self.percent()),
            Quantity::PowerDrawn => {
                let power = (-self.ram.average_ma).max(0.0) * f64::from(self.voltage_mv()) / 1000.0;
                whole(power / s.energy_scale)
            }
            Quantity::QmaxPassed => signed(self.ram.qmax_passed_mah),
            Quantity::Remaining => whole(self.remaining()),
            Quantity::SerialNumber => s.serial,
            Quantity::StandbyCurrent => signed(s.standby_ma),
            Quantity::StandbyTimeToEmpty => self.minutes_at(s.standby_ma),
            Quantity::StartCharge => whole(self.ram.start_mah),
            Quantity::StateTime => whole(self.ram.state_s),
            Quantity::Temperature => whole(self.temperature()),
            Quantity::TimeToFull => self.times().1,
            Quantity::Voltage => self.voltage_mv(),
            Quantity::VoltageScale => s.scales[0].into(),
        }
    }
}

impl Model for Gauging {
    fn battery(&self) -> &Battery {
        &self.battery
    }

    fn battery_mut(&mut self) -> &mut Battery {
        &mut self.battery
    }

    fn percent(&self) -> f64 {
        if self.full() > 0.0 { 100.0 * self.remaining() / self.full() } else { 0.0 }
    }

    fn set_percent(&mut self, percent: f64) {
        if self.battery.is_own {
            self.battery.set_percent(percent);
            self.battery.rest();
            return self.take_ocv();
        }
        let reserve = self.settings.reserve_mah.min(self.battery.capacity_mah);
        self.battery.charge_mah = reserve + self.full() * percent / 100.0;
        self.battery.rest();
        self.ram.drift_mah = 0.0;
        self.simulate();
    }

    fn measure(&mut self) {
        self.update(0.0);
    }

    fn power_up(&mut self) {
        self.measured = false;
    }

    /// After a full reset the error is not known (table 7-4).
    fn restart(&mut self, flash: &Flash) {
        let Self { battery, analog, measured, keeps_full, .. } = self.clone();
        *self = Self { battery, analog, measured, keeps_full, ..Self::new(self.map, flash, 0.0) };
        (self.ram.max_error, self.ram.state_s, self.ram.dod_s) = (100, 0.0, 0.0);
        self.load(flash);
        // The voltage measured now may not be one at rest.
        self.ram.learning = Learning::after_reset();
        self.ram.flags &= !OCVTAKEN;
    }

    fn at_rest(&self) -> bool {
        self.battery.current_ma() == 0.0 && self.ram.state == State::Rest
    }

    fn step(&mut self, seconds: f64) -> Vec<Kept> {
        let before = self.battery.charge_mah;
        self.analog.measure();
        self.battery.step(seconds);
        let mut moved = self.battery.charge_mah - before;
        let ratio = self.analog.ratio(self.settings.gain) * if self.settings.inverted { -1.0 } else { 1.0 };
        if ratio != 1.0 {
            // The counter stops at the ends of its scale.
            let (low, high) = (-self.battery.charge_mah, self.battery.capacity_mah - self.battery.charge_mah);
            self.ram.drift_mah = (self.ram.drift_mah + (ratio - 1.0) * moved).clamp(low, high);
            moved *= ratio;
        }
        if self.battery.is_own {
            // The counter stops at empty and at full.
            self.ram.drift_mah = self.counted() - self.battery.charge_mah;
        }
        let current = self.current_ma();
        self.ram.average_ma += (current - self.ram.average_ma) * (1.0 - libm::exp(-seconds / AVERAGE_S));
        self.ram.passed_mah += moved;
        self.ram.qmax_passed_mah += moved;
        self.ram.learning.pass(moved);
        self.measure_resistance(seconds);
        self.ram.cycle_mah += (-moved).max(0.0);
        while self.ram.cycle_mah >= self.settings.cycle_mah {
            self.ram.cycle_mah -= self.settings.cycle_mah;
            self.ram.cycles = self.ram.cycles.saturating_add(1);
            self.ram.cycles_changed = true;
        }
        self.ram.dod_s += seconds;
        self.update(seconds);
        self.ram.lifetime_changed |= self.track(seconds);
        Vec::new()
    }

    fn learned(&mut self, flash: &Flash) -> Vec<Kept> {
        let mut kept = Vec::new();
        let cycles = mem::take(&mut self.ram.cycles_changed);
        if let Some((id, offset)) = self.map.cycles.filter(|_| cycles) {
            kept.push(Kept::new(id, offset, &self.ram.cycles.to_be_bytes()));
        }
        let learned = mem::take(&mut self.ram.learned_changed);
        if let Some(learns) = self.map.learned.as_ref().filter(|_| learned) {
            let word = |(id, offset): Place, word: u16| Kept::new(id, offset, &word.to_be_bytes());
            let (qmax, design) = (self.settings.qmax_mah, f64::from(self.settings.design_mah.max(1)));
            kept.push(word(
                learns.qmax,
                whole(if learns.of_design { qmax * 16_384.0 / design } else { qmax }),
            ));
            kept.extend(learns.count.map(|count| word(count, self.ram.cycles)));
            kept.extend(learns.status.map(|(id, offset)| {
                let bits = flash.u8(id, offset) & !LEARNED | self.settings.learned & LEARNED;
                Kept::new(id, offset, &[bits])
            }));
        }
        let lifetime = mem::take(&mut self.ram.lifetime_changed);
        if let Some((data, samples)) = self.map.lifetime.filter(|_| lifetime) {
            let words = self.ram.lifetime.map(|value| (value.round() as i32 as u16).to_be_bytes());
            kept.push(Kept::new(data, 0, words.as_flattened()));
            let count = flash.u16(samples, 0).saturating_add(1);
            kept.push(Kept::new(samples, 0, &count.to_be_bytes()));
        }
        kept
    }
}

impl Quantity {
    fn is_predicted(self) -> bool {
        use Quantity::*;
        matches!(
            self,
            Remaining
                | Full
                | NominalRemaining
                | NominalFull
                | Percent
                | AvailableEnergy
                | Health
                | HealthStatus
        )
    }
}

/// TI prints the clear voltages of BATLOW and BATHI once as absolute voltages and once as a default of 5 mV, which must
/// be a distance from the voltage that sets the flag.
const DISTANCE: f64 = 1000.0;
