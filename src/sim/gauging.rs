//! What the bq34z100-G1 makes of its pack: measurements, counting, states and flags, and the registers
//! that show them. Thresholds are read from data flash at a reset, as the part does.

use std::array;

use super::battery::Battery;
use super::flash::Flash;

/// Registers that can be read, 0x00 to 0x7F.
pub(super) const REGISTERS: usize = 0x80;
/// 0 degrees Celsius in 0.1 K.
const FREEZING: f64 = 2731.0;
/// Time constant of AverageCurrent().
const AVERAGE_S: f64 = 15.0;
/// Rest after which an open-circuit voltage is taken.
const OCV_S: f64 = 1800.0;
const NO_TIME: u16 = 0xFFFF;

// Flags(), SLUSBZ5D table 7-6.
const OTC: u16 = 0x8000;
const OTD: u16 = 0x4000;
const BATHI: u16 = 0x2000;
const BATLOW: u16 = 0x1000;
const CHG_INH: u16 = 0x0800;
const XCHG: u16 = 0x0400;
const FC: u16 = 0x0200;
const CHG: u16 = 0x0100;
const OCVTAKEN: u16 = 0x0080;
const CF: u16 = 0x0010;
const SOC1: u16 = 0x0004;
const SOCF: u16 = 0x0002;
const DSG: u16 = 0x0001;
// FlagsB(), table 7-7.
const FIRSTDOD: u16 = 0x2000;
const DODEOC: u16 = 0x0400;
// Pack Configuration, table 7-17, and Pack Configuration B, table 7-18.
const RMFCC: u16 = 0x0020;
const TEMPS: u16 = 0x0001;
const JEITA: u8 = 0x08;

/// Data flash as it was at the last reset.
#[derive(Clone, Debug)]
struct Settings {
    ot_charge: (f64, f64, f64),
    ot_discharge: (f64, f64, f64),
    inhibit: (f64, f64, f64),
    suspend: (f64, f64),
    taper_ma: f64,
    taper_mv: f64,
    taper_s: f64,
    charge_alert: (i8, i8),
    full: (i8, i8),
    serial: u16,
    cycle_mah: f64,
    max_error_limit: u8,
    design_mah: u16,
    charge_mv: [u16; 3],
    charge_percent: [u8; 3],
    jeita: [f64; 4],
    energy_scale: f64,
    soc1: (u16, u16),
    socf: (u16, u16),
    low_mv: (f64, f64, f64),
    high_mv: (f64, f64, f64),
    pack: u16,
    pack_b: u8,
    reserve_mah: f64,
    discharge_ma: f64,
    charge_ma: f64,
    quit_ma: f64,
    relax_s: (f64, f64),
    internal_offset: f64,
    external_offset: f64,
    deadband_ma: f64,
    cells: f64,
    qmax_mah: f64,
    lifetime_s: f64,
    lifetime_step: [f64; 3],
}

impl Settings {
    fn read(flash: &Flash) -> Self {
        let i16 = |id, offset| f64::from(flash.i16(id, offset));
        let u8 = |id, offset| f64::from(flash.u8(id, offset));
        let i8 = |id, offset| flash.u8(id, offset) as i8;
        let u16 = |id, offset| flash.u16(id, offset);
        Self {
            ot_charge: (i16(2, 0), u8(2, 2), i16(2, 3)),
            ot_discharge: (i16(2, 5), u8(2, 7), i16(2, 8)),
            inhibit: (i16(32, 0), i16(32, 2), i16(32, 4)),
            suspend: (i16(34, 0), i16(34, 2)),
            taper_ma: i16(36, 0),
            taper_mv: i16(36, 4),
            taper_s: u8(36, 6),
            charge_alert: (i8(36, 7), i8(36, 8)),
            full: (i8(36, 9), i8(36, 10)),
            serial: u16(48, 4),
            cycle_mah: i16(48, 8).max(1.0),
            max_error_limit: flash.u8(48, 10),
            design_mah: u16(48, 11),
            charge_mv: [u16(48, 17), u16(48, 19), u16(48, 21)],
            charge_percent: [flash.u8(48, 23), flash.u8(48, 24), flash.u8(48, 25)],
            jeita: array::from_fn(|i| f64::from(i8(48, 26 + i)) * 10.0),
            energy_scale: u8(48, 30).max(1.0),
            soc1: (u16(49, 0), u16(49, 2)),
            socf: (u16(49, 4), u16(49, 6)),
            low_mv: (i16(49, 8), u8(49, 10), i16(49, 11)),
            high_mv: (i16(49, 13), u8(49, 15), i16(49, 16)),
            pack: u16(64, 0),
            pack_b: flash.u8(64, 2),
            reserve_mah: i16(80, 66).max(0.0),
            discharge_ma: i16(81, 0),
            charge_ma: i16(81, 2),
            quit_ma: i16(81, 4),
            relax_s: (f64::from(u16(81, 6)), u8(81, 8)),
            internal_offset: f64::from(i8(104, 11)),
            external_offset: f64::from(i8(104, 12)),
            deadband_ma: u8(107, 1),
            cells: u8(64, 7).max(1.0),
            qmax_mah: i16(82, 0).max(1.0),
            lifetime_s: f64::from(u16(66, 3)),
            lifetime_step: [u8(66, 0), u8(66, 1), u8(66, 2)],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Rest,
    Charge,
    Discharge,
}

/// What the gauge wants to keep in flash after some time has passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Learned {
    pub(super) cycles: bool,
    pub(super) lifetime: bool,
}

/// The measuring and counting half of the gauge.
#[derive(Clone, Debug)]
pub(super) struct Gauging {
    pub(super) battery: Battery,
    settings: Settings,
    /// What Voltage() is made to say instead of the model's.
    pub(super) forced_mv: Option<u16>,
    /// Voltage() has been measured since power came.
    pub(super) measured: bool,
    /// Impedance Track runs.
    pub(super) enabled: bool,
    pub(super) max_error: u8,
    average_ma: f64,
    state: State,
    state_s: f64,
    quiet_s: f64,
    flags: u16,
    flags_b: u16,
    over_s: [f64; 2],
    low_s: f64,
    high_s: f64,
    taper_s: f64,
    tapered: bool,
    cycle_mah: f64,
    pub(super) cycles: u16,
    passed_mah: f64,
    qmax_passed_mah: f64,
    start_mah: f64,
    dod: f64,
    dod_s: f64,
    end_dod: f64,
    /// Warmest, coldest, largest charge and discharge current, highest and lowest voltage, as stored.
    pub(super) lifetime: [f64; 6],
    lifetime_kept: [f64; 6],
    lifetime_s: f64,
}

impl Gauging {
    /// A gauge that has long been at rest with its pack.
    pub(super) fn new(flash: &Flash, soc: f64) -> Self {
        let settings = Settings::read(flash);
        let battery = Battery::new(settings.cells, settings.qmax_mah, soc);
        let mut new = Self {
            battery,
            settings,
            forced_mv: None,
            measured: true,
            enabled: false,
            max_error: 2,
            average_ma: 0.0,
            state: State::Rest,
            state_s: 3600.0,
            quiet_s: 0.0,
            flags: OCVTAKEN,
            flags_b: 0,
            over_s: [0.0; 2],
            low_s: 0.0,
            high_s: 0.0,
            taper_s: 0.0,
            tapered: false,
            cycle_mah: 0.0,
            cycles: 0,
            passed_mah: 0.0,
            qmax_passed_mah: 0.0,
            start_mah: 0.0,
            dod: 0.0,
            dod_s: 1800.0,
            end_dod: 0.0,
            lifetime: [0.0; 6],
            lifetime_kept: [0.0; 6],
            lifetime_s: 0.0,
        };
        new.load(flash);
        new
    }

    fn load(&mut self, flash: &Flash) {
        self.settings = Settings::read(flash);
        self.battery.resize(self.settings.cells, self.settings.qmax_mah);
        self.enabled = flash.u8(82, 4) & 0x04 != 0;
        self.cycles = flash.u16(48, 6);
        self.lifetime = array::from_fn(|i| match i {
            4 | 5 => f64::from(flash.u16(59, 2 * i)),
            _ => f64::from(flash.i16(59, 2 * i)),
        });
        self.lifetime_kept = self.lifetime;
        self.take_ocv();
        self.update(0.0);
    }

    /// RAM is built anew from flash; the pack itself goes on. A full reset knows nothing of the error
    /// it makes (table 7-4).
    pub(super) fn reset(&mut self, flash: &Flash) {
        let (battery, forced, measured) = (self.battery.clone(), self.forced_mv, self.measured);
        *self = Self::new(flash, 0.0);
        (self.battery, self.forced_mv, self.measured) = (battery, forced, measured);
        (self.max_error, self.state_s, self.dod_s) = (100, 0.0, 0.0);
        self.load(flash);
    }

    fn take_ocv(&mut self) {
        self.dod = 16384.0 * (1.0 - self.battery.percent() / 100.0);
        self.dod_s = 0.0;
        self.simulate();
    }

    /// The gauge predicts anew, and counts from here.
    fn simulate(&mut self) {
        self.passed_mah = 0.0;
        self.start_mah = self.remaining();
    }

    pub(super) fn remaining(&self) -> f64 {
        (self.battery.charge_mah - self.settings.reserve_mah).max(0.0)
    }

    pub(super) fn full(&self) -> f64 {
        (self.battery.capacity_mah - self.settings.reserve_mah).max(0.0)
    }

    pub(super) fn percent(&self) -> f64 {
        if self.full() > 0.0 { 100.0 * self.remaining() / self.full() } else { 0.0 }
    }

    /// Puts the pack at a state of charge.
    pub(super) fn set_percent(&mut self, percent: f64) {
        let reserve = self.settings.reserve_mah.min(self.battery.capacity_mah);
        self.battery.charge_mah = reserve + self.full() * percent / 100.0;
        self.simulate();
    }

    /// Voltage() of the whole stack.
    pub(super) fn voltage_mv(&self) -> u16 {
        let model = self.battery.cell_mv() * self.battery.cells;
        if self.measured { self.forced_mv.unwrap_or(whole(model)) } else { 0 }
    }

    fn cell_mv(&self) -> f64 {
        f64::from(self.voltage_mv()) / self.battery.cells
    }

    /// What the coulomb counter shows: nothing within the deadband.
    fn current_ma(&self) -> f64 {
        let current = self.battery.current_ma();
        if current.abs() < self.settings.deadband_ma { 0.0 } else { current }
    }

    /// No more than the current of SLEEP, given in mA, on average.
    pub(super) fn is_quiet(&self, sleep_ma: f64) -> bool {
        self.state == State::Rest && self.average_ma.abs() <= sleep_ma
    }

    /// Lets `seconds` of the gauge's time pass, in steps that are short against everything modelled.
    pub(super) fn advance(&mut self, seconds: f64) -> Learned {
        let mut learned = Learned::default();
        let mut left = seconds;
        while left > 0.0 {
            // A pack at rest changes in ways that are exact over any time; a long run is coarser.
            let step = match self.battery.current_ma() {
                0.0 if self.state == State::Rest => left.min(60.0_f64.max(left / 100.0)),
                _ => left.min((seconds / 3600.0).clamp(1.0, 15.0)),
            };
            let now = self.step(step);
            learned.cycles |= now.cycles;
            learned.lifetime |= now.lifetime;
            left -= step;
        }
        learned
    }

    fn step(&mut self, seconds: f64) -> Learned {
        let before = self.battery.charge_mah;
        self.battery.step(seconds);
        let moved = self.battery.charge_mah - before;
        let current = self.current_ma();
        self.average_ma += (current - self.average_ma) * (1.0 - (-seconds / AVERAGE_S).exp());
        self.passed_mah += moved;
        self.qmax_passed_mah += moved;
        self.cycle_mah += (-moved).max(0.0);
        let mut learned = Learned::default();
        while self.cycle_mah >= self.settings.cycle_mah {
            self.cycle_mah -= self.settings.cycle_mah;
            self.cycles = self.cycles.saturating_add(1);
            learned.cycles = true;
        }
        self.dod_s += seconds;
        self.update(seconds);
        learned.lifetime = self.track(seconds);
        learned
    }

    /// States and flags as they are with the present measurements, after `seconds` of them.
    pub(super) fn update(&mut self, seconds: f64) {
        self.change_state(seconds);
        let charging = self.state == State::Charge;
        let temperature = self.temperature() - FREEZING;
        self.terminate(seconds);
        let s = &self.settings;

        for (index, bit, (limit, time, recovery), state) in
            [(0, OTC, s.ot_charge, State::Charge), (1, OTD, s.ot_discharge, State::Discharge)]
        {
            let timer = &mut self.over_s[index];
            *timer = if self.state == state && temperature >= limit { *timer + seconds } else { 0.0 };
            // A time of 0 switches the protection off.
            if time > 0.0 && *timer >= time {
                self.flags |= bit;
            } else if temperature <= recovery {
                self.flags &= !bit;
            }
        }
        let (low, high, hysteresis) = s.inhibit;
        let allowed = temperature >= low + hysteresis && temperature <= high - hysteresis;
        if !charging && (temperature < low || temperature > high) {
            self.flags |= CHG_INH;
        } else if charging || allowed {
            self.flags &= !CHG_INH;
        }
        if charging && (temperature < s.suspend.0 || temperature > s.suspend.1) {
            self.flags |= XCHG;
        } else if !charging || allowed {
            self.flags &= !XCHG;
        }

        let cell = self.cell_mv();
        let (set, time, clear) = s.low_mv;
        self.low_s = if cell < set { self.low_s + seconds } else { 0.0 };
        if cell < set && self.low_s >= time {
            self.flags |= BATLOW;
        } else if cell > if clear < DISTANCE { set + clear } else { clear } {
            self.flags &= !BATLOW;
        }
        let (set, time, clear) = s.high_mv;
        self.high_s = if cell > set { self.high_s + seconds } else { 0.0 };
        if cell > set && self.high_s >= time {
            self.flags |= BATHI;
        } else if cell < if clear < DISTANCE { set - clear } else { clear } {
            self.flags &= !BATHI;
        }

        let remaining = whole(self.remaining());
        for (bit, (set, clear)) in [(SOC1, s.soc1), (SOCF, s.socf)] {
            if remaining <= set {
                self.flags |= bit;
            } else if remaining >= clear {
                self.flags &= !bit;
            }
        }
        // Nothing is full by rounding up.
        let (exact, percent) = (self.percent(), self.percent().round() as i8);
        let full = if s.full.0 < 0 { self.tapered } else { exact >= f64::from(s.full.0) };
        let stop = if s.charge_alert.0 < 0 { self.tapered } else { exact >= f64::from(s.charge_alert.0) };
        if full {
            self.flags |= FC;
        } else if percent <= s.full.1 {
            self.flags &= !FC;
        }
        let stopped = stop || self.flags & CHG == 0 && percent > s.charge_alert.1;
        let allowed = !stopped && self.flags & (OTC | BATHI | CHG_INH | XCHG) == 0;
        self.flags = if allowed { self.flags | CHG } else { self.flags & !CHG };
        let worn = self.max_error > s.max_error_limit;
        self.flags = if worn { self.flags | CF } else { self.flags & !CF };
        let discharging = self.state == State::Discharge;
        self.flags = if discharging { self.flags | DSG } else { self.flags & !DSG };
    }

    fn change_state(&mut self, seconds: f64) {
        let current = self.current_ma();
        let s = &self.settings;
        self.quiet_s = if current.abs() < s.quit_ma { self.quiet_s + seconds } else { 0.0 };
        let next = if -current > s.discharge_ma {
            State::Discharge
        } else if current > s.charge_ma {
            State::Charge
        } else {
            match self.state {
                State::Discharge if self.quiet_s >= s.relax_s.0 => State::Rest,
                State::Charge if self.quiet_s >= s.relax_s.1 => State::Rest,
                same => same,
            }
        };
        self.state_s += seconds;
        if next != self.state {
            self.state = next;
            self.state_s = 0.0;
            self.simulate();
            if next == State::Rest {
                self.flags &= !OCVTAKEN;
                self.flags_b |= FIRSTDOD;
            } else {
                self.flags_b &= !FIRSTDOD;
            }
        }
        if self.state == State::Rest && self.state_s >= OCV_S && self.flags & OCVTAKEN == 0 {
            self.take_ocv();
            self.flags |= OCVTAKEN;
            self.flags_b &= !FIRSTDOD;
        }
    }

    /// Primary charge termination: twice the taper window below the taper current near the full voltage.
    fn terminate(&mut self, seconds: f64) {
        let s = &self.settings;
        let near = self.cell_mv() >= f64::from(s.charge_mv[1]) - s.taper_mv;
        let low = self.average_ma > 0.0 && self.average_ma < s.taper_ma;
        let tapering = self.state == State::Charge && near && low;
        self.taper_s = if tapering { self.taper_s + seconds } else { 0.0 };
        if tapering && !self.tapered && self.taper_s >= 2.0 * s.taper_s {
            self.tapered = true;
            if s.pack & RMFCC != 0 {
                self.battery.charge_mah = self.battery.capacity_mah;
            }
            self.end_dod = 16384.0 * (1.0 - self.battery.percent() / 100.0);
            self.flags_b |= DODEOC;
            if self.enabled {
                self.max_error = self.max_error.min(3);
            }
        } else if self.state == State::Discharge {
            self.tapered = false;
            self.flags_b &= !DODEOC;
        }
    }

    /// Keeps the extremes; tells when they are worth a flash write (SLUSBZ5D 7.3.6.17).
    fn track(&mut self, seconds: f64) -> bool {
        let s = &self.settings;
        if !self.enabled || s.lifetime_s == 0.0 {
            return false;
        }
        let (degrees, current) = (self.temperature() - FREEZING, self.current_ma());
        let volts = f64::from(self.voltage_mv()) / 20.0;
        for (at, value) in [(0, degrees), (2, current), (4, volts)] {
            self.lifetime[at] = self.lifetime[at].max(value);
        }
        for (at, value) in [(1, degrees), (3, current), (5, volts)] {
            self.lifetime[at] = self.lifetime[at].min(value);
        }
        self.lifetime_s += seconds;
        let grown = (0..6).any(|i| {
            (self.lifetime[i] - self.lifetime_kept[i]).abs() >= self.settings.lifetime_step[i / 2].max(1.0)
        });
        if !grown || self.lifetime_s < s.lifetime_s {
            return false;
        }
        self.lifetime_s = 0.0;
        self.lifetime_kept = self.lifetime;
        true
    }

    fn die(&self) -> f64 {
        self.battery.temperature() * 10.0 + FREEZING + self.settings.internal_offset
    }

    /// Temperature() in 0.1 K, before rounding.
    fn temperature(&self) -> f64 {
        if self.settings.pack & TEMPS == 0 {
            return self.die();
        }
        self.battery.temperature() * 10.0 + FREEZING + self.settings.external_offset
    }

    /// ChargeVoltage() and ChargeCurrent() for the present temperature.
    fn charge_advice(&self) -> (u16, u16) {
        let s = &self.settings;
        let temperature = self.temperature() - FREEZING;
        let range = if s.pack_b & JEITA == 0 {
            1
        } else if temperature < s.jeita[0] || temperature > s.jeita[3] {
            return (0, 0);
        } else {
            usize::from(temperature >= s.jeita[1]) + usize::from(temperature >= s.jeita[2])
        };
        let current = f64::from(s.design_mah) * f64::from(s.charge_percent[range]) / 100.0;
        (s.charge_mv[range], whole(current))
    }

    /// Minutes to empty and to full at the average current; the second allows for the taper.
    fn times(&self) -> (u16, u16) {
        let average = self.average_ma.round();
        let minutes = |mah: f64| whole((mah / average.abs() * 60.0).min(65534.0));
        match self.state {
            State::Discharge if average < 0.0 => (minutes(self.remaining()), NO_TIME),
            State::Charge if average > 0.0 => {
                (NO_TIME, minutes((self.full() - self.remaining()).max(0.0) * 1.1))
            }
            _ => (NO_TIME, NO_TIME),
        }
    }

    /// The registers that show all this; the host's own ones are left 0.
    pub(super) fn registers(&self, calibration: bool) -> [u8; REGISTERS] {
        let mut out = [0; REGISTERS];
        let s = &self.settings;
        let (remaining, full) = (whole(self.remaining()), whole(self.full()));
        let (to_empty, to_full) = self.times();
        let (charge_mv, charge_ma) = self.charge_advice();
        let reserve = self.battery.energy_mwh(self.battery.charge_mah - self.remaining());
        let energy = self.battery.energy_mwh(self.battery.charge_mah) - reserve;
        let power = (-self.average_ma).max(0.0) * f64::from(self.voltage_mv()) / 1000.0;
        let health = match s.design_mah {
            0 => 0.0,
            design => (100.0 * self.full() / f64::from(design)).min(100.0),
        };
        // CAL_ENABLE toggles the bit of the running copy.
        let pack = if calibration { s.pack | 0x4000 } else { s.pack & !0x4000 };
        out[0x02] = self.percent().round() as u8;
        out[0x03] = self.max_error;
        for (register, word) in [
            (0x04, remaining),
            (0x06, full),
            (0x08, self.voltage_mv()),
            (0x0A, signed(self.average_ma)),
            (0x0C, whole(self.temperature())),
            (0x0E, self.flags),
            (0x10, signed(self.current_ma())),
            (0x12, self.flags_b),
            (0x18, to_empty),
            (0x1A, to_full),
            (0x1C, signed(self.passed_mah)),
            (0x1E, whole(self.dod_s / 60.0)),
            (0x24, whole(energy / s.energy_scale)),
            (0x26, whole(power / s.energy_scale)),
            (0x28, s.serial),
            (0x2A, whole(self.die())),
            (0x2C, self.cycles),
            (0x2E, whole(health)),
            (0x30, charge_mv),
            (0x32, charge_ma),
            (0x3A, pack),
            (0x3C, s.design_mah),
            (0x64, whole(self.end_dod)),
            (0x66, whole(self.start_mah)),
            (0x68, remaining),
            (0x6A, full),
            (0x6C, whole(self.state_s)),
            (0x6E, signed(self.qmax_passed_mah)),
            (0x70, whole(self.dod)),
            (0x72, whole(self.dod)),
            (0x74, whole(self.dod_s * 16.0 / 3600.0)),
        ] {
            out[register..register + 2].copy_from_slice(&word.to_le_bytes());
        }
        out[0x62] = ((100.0 - self.percent()) / 100.0 * 14.0) as u8;
        out[0x63] = if self.enabled { 0x04 } else { 0 };
        out
    }
}

/// TI prints the clear voltages of BATLOW and BATHI once as absolute voltages and once as a default of
/// 5 mV, which can only be a distance from the voltage that sets the flag.
const DISTANCE: f64 = 1000.0;

fn whole(value: f64) -> u16 {
    value.round().clamp(0.0, 65535.0) as u16
}

fn signed(value: f64) -> u16 {
    value.round().clamp(-32768.0, 32767.0) as i16 as u16
}
