// SPDX-License-Identifier: MIT

//! The bq35100: its data flash in bytes, its subcommands, and the model of a gauge for primary cells.
//!
//! Defaults are from SLUUBH1C chapters 7 and 8, SLUA790 and SLUAAL7. The other bytes are from similar gauges
//! or those of a small cell, so that the gauge works.

use std::time::Duration;

use super::battery::Battery;
use super::flash::{Flash, Image};
use super::flat::{BASE, DATA_FLASH, PRIVATE, SIZE, i16_at, image, offset, u8_at, u16_at};
use super::model::{
    Calibration, FREEZING, Kept, MacModel, Model, Registers, Reply, bits, registers, signed, whole,
};
use super::part::{MacPart, Part, Scheme};
use super::seal::Level;
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq35100",
    image: IMAGE,
    timing: Timing { power_up: BOOT, reset: BOOT, ..Timing::MAC },
    scheme: Scheme::Mac(&MacPart {
        base: BASE,
        data_memory: None,
        gate: Some(0x41B6),
        divider: None,
        // Operation Config A [TEMPS].
        thermistor: Some((0x41B1, 0x80)),
        keys: (DATA_FLASH, offset(0x41CC)),
        seal: 0x0020,
        reset: 0x0041,
        is_little: false,
        advances: false,
        answers_elsewhere: false,
        predicted: &[0x02, 0x04, 0x2E],
        initialized: (0, INITCOMP),
        model: |flash| Box::new(Primary::new(flash)),
    }),
    // CC Offset, Board Offset, SOH.
    rewrites: &[
        (DATA_FLASH, offset(0x4008), 2),
        (DATA_FLASH, offset(0x400C), 1),
        (DATA_FLASH, offset(0x4209), 1),
    ],
};

/// A part was observed to hold the clock for this long after power-up.
const BOOT: Duration = Duration::from_micros(103_500);

/// The accumulated charge is stored at GAUGE_STOP. The format of the real accumulator tables is not known.
static IMAGE: Image = &[(DATA_FLASH, &DATA), (PRIVATE, &[0; 4])];

#[rustfmt::skip]
static DATA: [u8; SIZE] = image(&[
    // CC Gain, CC Delta, CC Offset
    (0x4000, &[0x7F, 0x71, 0x20, 0x5B, 0x94, 0x0A, 0x9C, 0x09, 0xFB, 0x50]),
    // Int Coeff 1 to 4
    (0x4012, &[0x00, 0x00, 0x00, 0x00, 0xCF, 0xDC, 0x17, 0xF3]),
    // Device Name, Data Flash Version
    (0x4060, &[0x07, 0x62, 0x71, 0x33, 0x35, 0x31, 0x30, 0x30, 0x00, 0x01]),
    // Operation Config A, ALERT Configuration
    (0x41B1, &[0x80, 0x00]),
    // Flash Update OK Voltage, Offset Cal Inhibit Temp Low and High
    (0x41B6, &[0x0A, 0xF0, 0x00, 0x32, 0x01, 0xC2]),
    // Authen Key3 to Key0
    (0x41BC, &[0x01, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF, 0xFE, 0xDC, 0xBA, 0x98, 0x76, 0x54, 0x32, 0x10]),
    // Unseal and Full Unseal
    (0x41CC, &[0x04, 0x14, 0x36, 0x72, 0xFF, 0xFF, 0xFF, 0xFF]),
    // Default Temperature, OT Dsg, its time and recovery
    (0x41D4, &[0x0B, 0xA6, 0x02, 0x58, 0x02, 0x02, 0x26]),
    // BatLow Voltage, a gap; Under Temperature; SOH Low
    (0x41DB, &[0x0A, 0xF0, 0x0A, 0x0B, 0x54, 0xFF, 0x38, 0x04, 0x00, 0x64, 0x0A]),
    // Cell Design Capacity mAh
    (0x41FE, &[0x08, 0x98]),
    // Cell Design Voltage, Cell Terminate Voltage, Series Cell Count, Max Load
    (0x4202, &[0x0E, 0x10, 0x07, 0xD0, 0x01, 0x00, 0x64]),
    // SOH, SOH Max Delta
    (0x4209, &[0x64, 0x05]),
    // R Data Seconds
    (0x4255, &[0x01]),
    // R Table Scale to EOS Trend Detection
    (0x4257, &[0xFF, 0xFF, 0x02, 0xFF, 0xFB, 0xFD, 0x14, 0x00, 0x78]),
]);

/// From GAUGE_STOP until everything is computed and stored.
const FINISHING_S: f64 = 1.0;

// CONTROL_STATUS, SLUUBH1C 11.2.1.
const CALMODE: u16 = 0x1000;
const BCA: u16 = 0x0800;
const CCA: u16 = 0x0400;
const LTEN: u16 = 0x0200;
const INITCOMP: u16 = 0x0080;
const G_DONE: u16 = 0x0040;
const GA: u16 = 0x0001;
// BatteryAlert(), 11.8.
const BATLOW: u8 = 0x80;
const TEMPLOW: u8 = 0x40;
const TEMPHIGH: u8 = 0x20;
const SOH_LOW: u8 = 0x10;
const EOS: u8 = 0x08;
const DONE_ALERT: u8 = 0x02;
const INIT_ALERT: u8 = 0x01;
/// Operation Config A `[WRTEMP]`.
const WRTEMP: u8 = 0x20;
/// A cell with less charge, in percent, is at the end of its service.
const END: f64 = 5.0;

#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Gauging {
    #[default]
    Idle,
    Active,
    Finishing,
    Done,
}

struct Settings {
    config: u8,
    alerts: u8,
    hot: (f64, f64, f64),
    low: (f64, f64),
    cold: (f64, f64, f64),
    soh_low: u8,
    design_mah: f64,
}

impl Settings {
    fn read(flash: &Flash) -> Self {
        let number = |address| f64::from(i16_at(flash, address));
        let byte = |address| f64::from(u8_at(flash, address));
        Self {
            config: u8_at(flash, 0x41B1),
            alerts: u8_at(flash, 0x41B2),
            hot: (number(0x41D6), byte(0x41D8), number(0x41D9)),
            low: (number(0x41DB), byte(0x41DD)),
            cold: (number(0x41E0), byte(0x41E2), number(0x41E3)),
            soh_low: u8_at(flash, 0x41E5),
            design_mah: number(0x41FE),
        }
    }

    /// `[GMSEL]`: 0 accumulates, 1 estimates the state of health, 2 detects the end of service.
    fn mode(&self) -> u8 {
        self.config & 0x03
    }
}

struct Primary {
    battery: Battery,
    settings: Settings,
    ram: Ram,
}

#[derive(Default)]
struct Ram {
    calibration: Calibration,
    lifetime: bool,
    gauging: Gauging,
    finishing_s: f64,
    /// µAh taken out, 0 or less.
    accumulated: f64,
    health: u8,
    /// Largest current since GAUGE_START, in mA.
    pulse_ma: f64,
    measured_z: u16,
    /// Alerts present now, alerts since BatteryAlert() was read, and the ALERT signal.
    present: u8,
    latched: u8,
    alert: bool,
    /// How long the conditions of the alerts have been met.
    seconds: [f64; 3],
    written_temperature: Option<[u8; 2]>,
}

impl Ram {
    fn new(flash: &Flash) -> Self {
        Self {
            lifetime: u8_at(flash, 0x41B1) & 0x10 != 0,
            accumulated: f64::from(i32::from_be_bytes(flash.get(PRIVATE, 0))),
            health: u8_at(flash, 0x4209),
            ..Self::default()
        }
    }
}

fn pack(flash: &Flash) -> (f64, f64) {
    (f64::from(u8_at(flash, 0x4206)).max(1.0), f64::from(i16_at(flash, 0x41FE)).max(1.0))
}

impl Primary {
    fn new(flash: &Flash) -> Self {
        let (cells, capacity) = pack(flash);
        let battery = Battery::primary(cells, capacity, 100.0);
        let mut new = Self { battery, settings: Settings::read(flash), ram: Ram::new(flash) };
        new.restart(flash);
        new
    }

    fn raise(&mut self, alerts: u8) {
        let new = alerts & self.settings.alerts & !self.ram.latched;
        self.ram.latched |= new;
        self.ram.alert |= new != 0;
    }

    fn update(&mut self, seconds: f64) {
        let tenths = self.battery.temperature() * 10.0;
        let millivolts = f64::from(self.voltage_mv());
        let s = &self.settings;
        let mut present = 0;
        let held = |bit: u8| self.ram.present & bit != 0;
        let conditions = [
            (BATLOW, millivolts < s.low.0, s.low.1, true),
            (TEMPHIGH, tenths >= s.hot.0, s.hot.1, tenths <= s.hot.2),
            (TEMPLOW, tenths <= s.cold.0, s.cold.1, tenths >= s.cold.2),
        ];
        for (at, (bit, set, after, clear)) in conditions.into_iter().enumerate() {
            self.ram.seconds[at] = if set { self.ram.seconds[at] + seconds } else { 0.0 };
            if set && self.ram.seconds[at] >= after || held(bit) && !set && !clear || held(bit) && set {
                present |= bit;
            }
        }
        if s.mode() != 0 && self.ram.health <= s.soh_low {
            present |= SOH_LOW;
        }
        if s.mode() == 2 && self.ram.gauging == Gauging::Done && self.percent() <= END {
            present |= EOS;
        }
        let new = present & !self.ram.present;
        self.ram.present = present;
        self.raise(new);
    }

    fn kept(&self) -> Kept {
        Kept::new(PRIVATE, 0, &(self.ram.accumulated.round() as i32).to_be_bytes())
    }

    fn finish(&mut self) -> Vec<Kept> {
        self.ram.gauging = Gauging::Done;
        let mut kept = Vec::new();
        if self.settings.mode() == 0 {
            kept.push(self.kept());
        } else {
            self.ram.health = self.percent().round() as u8;
            kept.push(Kept::new(DATA_FLASH, offset(0x4209), &[self.ram.health]));
            if self.settings.mode() == 2 && self.ram.pulse_ma > 0.0 {
                self.ram.measured_z = whole(self.battery.resistance() * 1000.0);
            }
        }
        self.raise(DONE_ALERT);
        kept
    }
}

impl Model for Primary {
    fn battery(&self) -> &Battery {
        &self.battery
    }

    fn battery_mut(&mut self) -> &mut Battery {
        &mut self.battery
    }

    fn measure(&mut self) {
        self.update(0.0);
    }

    /// Primary cells are not charged.
    fn charges(&self) -> bool {
        false
    }

    fn restart(&mut self, flash: &Flash) {
        self.ram = Ram::new(flash);
        self.configure(flash);
        self.raise(INIT_ALERT);
    }

    fn configure(&mut self, flash: &Flash) {
        self.settings = Settings::read(flash);
        let (cells, capacity) = pack(flash);
        self.battery.resize(cells, capacity);
        self.ram.latched &= self.settings.alerts;
        self.update(0.0);
    }

    fn step(&mut self, seconds: f64) -> Vec<Kept> {
        let before = self.battery.charge_mah;
        self.battery.step(seconds);
        let current = self.battery.current_ma();
        let mut kept: Vec<Kept> = self.ram.calibration.step(seconds, current).into_iter().collect();
        match self.ram.gauging {
            Gauging::Active => {
                self.ram.accumulated += (self.battery.charge_mah - before) * 1000.0;
                self.ram.pulse_ma = self.ram.pulse_ma.max(-current);
            }
            Gauging::Finishing => {
                self.ram.finishing_s += seconds;
                if self.ram.finishing_s >= FINISHING_S {
                    kept.extend(self.finish());
                }
            }
            Gauging::Idle | Gauging::Done => {}
        }
        self.update(seconds);
        kept
    }
}

impl MacModel for Primary {
    fn voltage_mv(&self) -> u16 {
        whole(self.battery.cell_mv() * self.battery.cells)
    }

    fn calibrating(&self) -> bool {
        self.ram.calibration.mode
    }

    fn may_calibrate(&self) -> bool {
        self.ram.calibration.enabled
    }

    fn control_status(&self, level: Level) -> u16 {
        let security = match level {
            Level::Sealed => 0x6000,
            Level::Unsealed => 0x4000,
            Level::FullAccess => 0x2000,
        };
        let ram = &self.ram;
        security
            | bits(&[
                (CALMODE, ram.calibration.mode),
                (BCA, ram.calibration.board_running()),
                (CCA, ram.calibration.cc_running()),
                (LTEN, ram.lifetime),
                (INITCOMP, true),
                (G_DONE, ram.gauging == Gauging::Done),
                (GA, ram.gauging == Gauging::Active),
            ])
    }

    fn registers(&self, _: Level, voltage_mv: u16) -> Registers {
        let ram = &self.ram;
        // Current is valid only while the gauge is active (11.9).
        let active = ram.gauging == Gauging::Active;
        let current = if active { self.battery.current_ma() } else { 0.0 };
        let kelvin = self.battery.temperature() * 10.0 + FREEZING;
        let ohms = if ram.measured_z == 0 { 0 } else { whole(self.battery.resistance() * 1000.0) };
        let mut out = registers(&[
            (0x06, whole(kelvin)),
            (0x08, voltage_mv),
            (0x0C, signed(current)),
            (0x16, ohms),
            (0x22, ram.measured_z),
            (0x28, whole(kelvin)),
            (0x3C, whole(self.settings.design_mah)),
            (0x7A, signed(self.battery.current_ma())),
            (0x7C, voltage_mv),
            (0x7E, whole(kelvin / 10.0)),
        ]);
        out[0x02..0x06].copy_from_slice(&(ram.accumulated.round() as i32).to_le_bytes());
        if let Some(written) = ram.written_temperature.filter(|_| self.settings.config & WRTEMP != 0) {
            out[0x06..0x08].copy_from_slice(&written);
        }
        out[0x0A] = u8::from(ram.alert) << 2 | u8::from(current < 0.0);
        out[0x0B] = (ram.latched | ram.present) & self.settings.alerts;
        out[0x2E] = ram.health;
        out[0x79] = ram.calibration.count;
        out
    }

    fn subcommand(&mut self, word: u16, level: Level, flash: &Flash) -> Option<Reply> {
        let open = level != Level::Sealed;
        match word {
            0x0001 => return Reply::word(0x0100),
            0x0002 => return Reply::bytes(&[0x01, 0x00, 0x00, 0x18, 0x00, 0x08]),
            0x0003 => return Reply::word(0x00A8),
            0x0005 => return Reply::word(u16_at(flash, 0x4056)),
            0x0006 => return Reply::word(0x0606),
            0x0009 => self.ram.calibration.board_offset(),
            0x000A => self.ram.calibration.cc_offset(),
            0x000B => return Some(Reply::Keep(vec![Calibration::save()])),
            0x000C => return Reply::word(u16_at(flash, 0x4068)),
            0x0011 => {
                self.ram.gauging = Gauging::Active;
                self.ram.pulse_ma = 0.0;
            }
            0x0012 if self.ram.gauging == Gauging::Active => {
                (self.ram.gauging, self.ram.finishing_s) = (Gauging::Finishing, 0.0);
            }
            0x0012 => {}
            0x002D if open => self.ram.calibration.enabled = !self.ram.calibration.enabled,
            0x002E if open => self.ram.lifetime = true,
            0x0080 if open => self.ram.calibration.mode = false,
            // github.com/pilotak/BQ35100 (01505a5f) sends it without CAL_ENABLE, and waits for [CALMODE].
            0x0081 if open => self.ram.calibration.mode = true,
            // NEW_BATTERY, which a sealed gauge accepts too.
            0xA613 => {
                self.battery.set_percent(100.0);
                (self.ram.accumulated, self.ram.health, self.ram.measured_z) = (0.0, 100, 0);
                let learned = Kept::new(DATA_FLASH, offset(0x4209), &[self.ram.health]);
                let scale = Kept::new(DATA_FLASH, offset(0x4257), &[0xFF, 0xFF]);
                return Some(Reply::Keep(vec![self.kept(), learned, scale]));
            }
            _ => return None,
        }
        Some(Reply::Done)
    }

    /// The host may write the temperature.
    fn write(&mut self, register: u8, byte: u8) -> bool {
        if !matches!(register, 0x06 | 0x07) || self.settings.config & WRTEMP == 0 {
            return false;
        }
        self.ram.written_temperature.get_or_insert([0; 2])[usize::from(register - 0x06)] = byte;
        true
    }

    /// Reading clears the signal, and the alerts that are no longer present.
    fn seen(&mut self, register: u8) {
        match register {
            0x0A => self.ram.alert = false,
            0x0B => (self.ram.alert, self.ram.latched) = (false, 0),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SLUA790 section 3 and SLUAAL7 tables 7-1 and 7-2.
    #[test]
    fn bytes_are_where_the_documents_have_them() {
        let flash = Flash::new(IMAGE);
        assert_eq!(u8_at(&flash, 0x41B1), 0x80);
        assert_eq!(i16_at(&flash, 0x4257), -1);
        assert_eq!(flash.get(DATA_FLASH, offset(0x4259)), [2, 0xFF, 251, 253, 20, 0, 120]);
        assert_eq!(flash.get(DATA_FLASH, offset(0x41E0)), [0xFF, 0x38, 4, 0, 100]);
    }
}
