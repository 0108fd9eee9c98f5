// SPDX-License-Identifier: MIT

//! The BQ27220: its data memory as one-time programmable memory fills it, its subcommands, and the model of a CEDV
//! gauge.
//!
//! An owner read bytes 0x929F to 0x92BE from a part as shipped (E2E forum, "BQ27220: Design Capacity"); SLUUBD4A prints
//! those up to 0x91CB. Bytes 0x920D to 0x9213 and 0x9282 to 0x9299 are as TI's image for this part writes them. The
//! others are a configuration tool's defaults; voltages over depth of discharge are the bq34110's, which begin with the
//! same value. Undocumented registers are as in similar gauges.

use std::time::Duration;

use super::battery::Battery;
use super::flash::{Flash, Image};
use super::flat::{DATA_FLASH, PRIVATE, image_from};
use super::model::{
    AVERAGE_S, Calibration, FREEZING, Kept, MacModel, Model, NO_TIME, Registers, Reply, bits, registers,
    signed, times, whole,
};
use super::part::{MacMemory, MacPart, Part, Scheme};
use super::seal::Level;
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq27220",
    image: IMAGE,
    timing: TIMING,
    scheme: Scheme::Mac(&MacPart {
        base: BASE,
        // Operation Config B [Default Seal].
        data_memory: Some(MacMemory { default_seal: (0x9208, 0x08), shows: (0x3A, 0x0400) }),
        gate: None,
        divider: None,
        // Operation Config A [TEMPS].
        thermistor: Some((0x9206, 0x80)),
        keys: (PRIVATE, 0),
        seal: 0x0030,
        reset: 0x0041,
        is_little: false,
        advances: false,
        answers_elsewhere: true,
        predicted: &[0x10, 0x12, 0x2C, 0x2E],
        initialized: (0x3A, INITCOMP),
        model: |flash| Box::new(Cedv::new(flash)),
    }),
    // CC Offset, Board Offset, Full Charge Capacity.
    rewrites: &[(DATA_FLASH, at(0x9180), 2), (DATA_FLASH, at(0x91B4), 1), (DATA_FLASH, at(0x929D), 2)],
};

/// Drivers on many boards send the full-access key 5 to 50 ms after the unseal key, and it is accepted. CONFIG UPDATE
/// begins within 1 s (6.1); a driver found data memory unreadable for up to 2 s after its end.
const TIMING: Timing = Timing {
    full_access_quiet: Duration::ZERO,
    update_enter: Duration::from_millis(800),
    update_leave: Duration::from_millis(1000),
    ..Timing::MAC
};

/// OperationStatus() `[INITCOMP]`.
const INITCOMP: u16 = 0x0020;

/// Start of the data memory whose addresses are known.
const BASE: u16 = 0x9180;
const SIZE: usize = 0x180;

const fn at(address: u16) -> usize {
    (address - BASE) as usize
}

static IMAGE: Image = &[(DATA_FLASH, &DATA), (PRIVATE, &KEYS)];

/// Keys in their order on the wire.
static KEYS: [u8; 8] = [0x04, 0x14, 0x36, 0x72, 0xFF, 0xFF, 0xFF, 0xFF];

#[rustfmt::skip]
static DATA: [u8; SIZE] = image_from(BASE, &[
    // Internal Model Coefficient 3 and 4
    (0x91BC, &[0xCB, 0xD4, 0x1A, 0x05]),
    // External Model Coefficient 1 to 5, b 1
    (0x91C0, &[0xD4, 0x86, 0x4A, 0xC6, 0xB4, 0xC2, 0x6E, 0x2B, 0x03, 0x7C, 0x01, 0x48]),
    // Filter, Deadband, CC Deadband
    (0x91DD, &[0xEF, 0x05, 0x11]),
    // Chg Inhibit Temp Low and High, Temp Hys
    (0x91F5, &[0x00, 0x00, 0x01, 0xC2, 0x00, 0x32]),
    // Charging Current, Charging Voltage
    (0x91FB, &[0x00, 0xC8, 0x10, 0x68]),
    // Taper Current
    (0x9201, &[0x00, 0x64]),
    // Operation Config A and B
    (0x9206, &[0x04, 0x84, 0x10, 0x00]),
    // SOC Delta, Clk Ctl Reg, IO Config, Init Discharge Set, Init Charge Set, device type
    (0x920B, &[0x01, 0x09, 0x00, 0x00, 0x96, 0x00, 0xAF, 0x02, 0x20]),
    // Sleep Current, Bus Low Time, Offset Cal Inhibit, Sleep Times
    (0x9217, &[0x00, 0x0A, 0x05, 0x00, 0x32, 0x01, 0xC2, 0x14, 0x14]),
    // Dsg Current Threshold, Chg Current Threshold, Quit Current, relax times
    (0x9228, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28, 0x00, 0x3C, 0x3C, 0x01]),
    // OT Chg, OT Dsg, Initial Standby
    (0x9232, &[0x02, 0x26, 0x02, 0x01, 0xF4, 0x02, 0x58, 0x02, 0x02, 0x26, 0xF6]),
    // SysDown
    (0x9240, &[0x0C, 0x4E, 0x02, 0x0C, 0xB2]),
    // Battery Low %
    (0x9251, &[0x02, 0xBC]),
    // Learning Low Temp
    (0x925B, &[0x77]),
    // Overload Current
    (0x9264, &[0x05, 0xDC]),
    // Self Discharge Rate, Electronics Load, Near Full, Reserve Capacity, Chg Eff, Dsg Eff
    (0x9268, &[0x14, 0x00, 0x00, 0x00, 0xC8, 0x00, 0x00, 0x64, 0x64]),
    // Smoothing
    (0x9271, &[0x08, 0x0E, 0x74, 0x00, 0x64, 0x1F, 0x40]),
    // EOC Smooth Current and Time, Cycle Count %
    (0x927B, &[0x02, 0x3C, 0x5A]),
    // SOC Flag Config A and B
    (0x927F, &[0x0C, 0x8C, 0x8C]),
    // Voltages and percentages that set and clear FD, FC, TD and TC
    (0x9282, &[0x0A, 0xF0, 0x0B, 0x54, 0x00, 0x05, 0x10, 0x68, 0x10, 0x04, 0x64, 0x5F,
               0x0B, 0x54, 0x0B, 0xB8, 0x06, 0x08, 0x10, 0x68, 0x10, 0x04, 0x64, 0x5F]),
    // Gauging Configuration, Full Charge Capacity
    (0x929B, &[0x10, 0x2A, 0x0B, 0xB8]),
    // Design Capacity, a value without a name, Design Voltage, Charge Termination Voltage
    (0x929F, &[0x0B, 0xB8, 0x03, 0x84, 0x0E, 0x74, 0x00, 0x64]),
    // EMF, C0, R0, T0, R1, TC, C1, Age Factor
    (0x92A7, &[0x0E, 0x9F, 0x00, 0x95, 0x03, 0x63, 0x0F, 0xBE, 0x01, 0x3C, 0x09, 0x00, 0x00]),
    // Fixed EDV 0 to 2 with their hold times
    (0x92B4, &[0x0B, 0xD7, 0x01, 0x0D, 0x39, 0x01, 0x0D, 0xAD, 0x01]),
    // Voltage 0% DOD to 100% DOD
    (0x92BD, &[0x10, 0x4D, 0x0F, 0xCB, 0x0F, 0x55, 0x0E, 0xED, 0x0E, 0x8D, 0x0E, 0x48, 0x0E, 0x23, 0x0D, 0xFE,
               0x0D, 0xBB, 0x0D, 0x6E, 0x0A, 0x99]),
]);

/// Hysteresis of the temperature limits, in degrees.
const RECOVERY: f64 = 5.0;
/// State of charge in percent below which a full pack, and above which an empty one, is no longer so.
const NOT_FULL: f64 = 95.0;
const NOT_EMPTY: f64 = 5.0;
/// Two periods of 40 s below Taper Current end a charge (4.4.1).
const TAPER_S: f64 = 80.0;

// BatteryStatus().
const DSG: u16 = 0x0001;
const SYSDWN: u16 = 0x0002;
const TDA: u16 = 0x0004;
const BATTPRES: u16 = 0x0008;
const TCA: u16 = 0x0040;
const CHGINH: u16 = 0x0100;
const FC: u16 = 0x0200;
const OTD: u16 = 0x0400;
const OTC: u16 = 0x0800;
const SLEEP: u16 = 0x1000;
const FD: u16 = 0x8000;
// Operation Config A.
const SLEEPS: u16 = 0x0400;
const BI_ENABLE: u16 = 0x0080;

struct Settings {
    design_mah: f64,
    charge: (u16, u16),
    taper_ma: f64,
    taper_mv: f64,
    sleep_ma: f64,
    dsg_ma: f64,
    chg_ma: f64,
    inhibit: (f64, f64),
    warm: (f64, f64),
    down_mv: (f64, f64),
    edv: [f64; 3],
    config: u16,
}

fn word(flash: &Flash, address: u16) -> u16 {
    flash.u16(DATA_FLASH, at(address))
}

impl Settings {
    fn read(flash: &Flash) -> Self {
        let number = |address| f64::from(flash.i16(DATA_FLASH, at(address)));
        let degrees = |address| number(address) / 10.0;
        Self {
            design_mah: number(0x929F),
            charge: (word(flash, 0x91FD), word(flash, 0x91FB)),
            taper_ma: number(0x9201),
            taper_mv: number(0x92A5),
            sleep_ma: number(0x9217),
            dsg_ma: number(0x9228),
            chg_ma: number(0x922A),
            inhibit: (degrees(0x91F5), degrees(0x91F7)),
            warm: (degrees(0x9232), degrees(0x9237)),
            down_mv: (number(0x9240), number(0x9243)),
            edv: [number(0x92B4), number(0x92B7), number(0x92BA)],
            config: word(flash, 0x9206),
        }
    }
}

struct Cedv {
    battery: Battery,
    settings: Settings,
    average_ma: f64,
    ram: Ram,
}

/// Cycles are in RAM too: there is no flash to keep them.
#[derive(Default)]
struct Ram {
    calibration: Calibration,
    flags: u16,
    /// BAT_REMOVE came after the last BAT_INSERT.
    removed: bool,
    snooze: bool,
    /// Selected profile, from 0.
    profile: u16,
    taper_s: f64,
    cycle_mah: f64,
    cycles: u16,
    /// RawCoulombCount().
    passed_mah: f64,
}

fn capacity(flash: &Flash) -> f64 {
    f64::from(flash.i16(DATA_FLASH, at(0x929D))).max(1.0)
}

impl Cedv {
    fn new(flash: &Flash) -> Self {
        let mut new = Self {
            battery: Battery::new(1.0, capacity(flash), 60.0),
            settings: Settings::read(flash),
            average_ma: 0.0,
            ram: Ram::default(),
        };
        new.update(0.0);
        new
    }

    fn flag(&mut self, bit: u16, set: bool, clear: bool) {
        if set {
            self.ram.flags |= bit;
        } else if clear {
            self.ram.flags &= !bit;
        }
    }

    fn update(&mut self, seconds: f64) {
        let current = self.battery.current_ma();
        let (cell, percent, degrees) = (self.battery.cell_mv(), self.percent(), self.battery.temperature());
        let s = &self.settings;
        let (discharging, charging) = (-current > s.dsg_ma, current > s.chg_ma);
        let tapering =
            current > 0.0 && self.average_ma < s.taper_ma && cell >= f64::from(s.charge.0) - s.taper_mv;
        self.ram.taper_s = if tapering { self.ram.taper_s + seconds } else { 0.0 };
        let full = percent >= 100.0 || tapering && self.ram.taper_s >= TAPER_S;
        let empty = percent <= 0.0 || discharging && cell <= s.edv[0];
        let sleeps = s.config & SLEEPS != 0 && self.average_ma.abs() <= s.sleep_ma;
        let present = s.config & BI_ENABLE != 0 || !self.ram.removed;
        let (down, up) = (cell < s.down_mv.0, cell > s.down_mv.1);
        let ((cold, hot), (otc, otd)) = (s.inhibit, s.warm);
        if full {
            self.battery.charge_mah = self.battery.capacity_mah;
        }
        self.flag(DSG, discharging && !charging, true);
        self.flag(BATTPRES, present, true);
        self.flag(SLEEP, sleeps, true);
        self.flag(SYSDWN, down, up);
        self.flag(FC | TCA, full, percent <= NOT_FULL);
        self.flag(FD | TDA, empty, percent > NOT_EMPTY);
        self.flag(OTC, degrees >= otc, degrees <= otc - RECOVERY);
        self.flag(OTD, degrees >= otd, degrees <= otd - RECOVERY);
        self.flag(CHGINH, degrees < cold || degrees > hot, true);
    }

    /// OperationStatus() without `[CFGUPDATE]`.
    fn operation(&self, level: Level) -> u16 {
        let security = match level {
            Level::Sealed => 3,
            Level::Unsealed => 2,
            Level::FullAccess => 1,
        };
        let edv2 = self.battery.cell_mv() <= self.settings.edv[2];
        INITCOMP | u16::from(edv2) << 3 | security << 1 | u16::from(self.ram.calibration.mode)
    }

    /// GaugingStatus (3.2.18).
    fn gauging(&self) -> u16 {
        let cell = self.battery.cell_mv();
        let [edv0, edv1, edv2] = self.settings.edv.map(|edv| cell <= edv);
        let flag = |bit| self.ram.flags & bit != 0;
        bits(&[
            (0x4000, edv2),
            (0x2000, edv1),
            (0x0040, self.battery.current_ma() <= self.settings.chg_ma),
            (0x0020, edv0),
            (0x0008, flag(TCA)),
            (0x0004, flag(TDA)),
            (0x0002, flag(FC)),
            (0x0001, flag(FD)),
        ])
    }
}

impl Model for Cedv {
    fn battery(&self) -> &Battery {
        &self.battery
    }

    fn battery_mut(&mut self) -> &mut Battery {
        &mut self.battery
    }

    fn measure(&mut self) {
        self.update(0.0);
    }

    fn restart(&mut self, flash: &Flash) {
        self.ram = Ram::default();
        self.configure(flash);
    }

    fn configure(&mut self, flash: &Flash) {
        self.settings = Settings::read(flash);
        self.battery.resize(1.0, capacity(flash));
        self.update(0.0);
    }

    fn step(&mut self, seconds: f64) -> Vec<Kept> {
        let before = self.battery.charge_mah;
        self.battery.step(seconds);
        let moved = self.battery.charge_mah - before;
        let current = self.battery.current_ma();
        self.average_ma += (current - self.average_ma) * (1.0 - libm::exp(-seconds / AVERAGE_S));
        self.ram.passed_mah = if self.ram.flags & FC != 0 { 0.0 } else { self.ram.passed_mah - moved };
        self.ram.cycle_mah += (-moved).max(0.0);
        let cycle = self.settings.design_mah.max(1.0) * 0.9;
        if self.ram.cycle_mah >= cycle {
            self.ram.cycle_mah -= cycle;
            self.ram.cycles = self.ram.cycles.saturating_add(1);
        }
        let measured = self.ram.calibration.step(seconds, current);
        self.update(seconds);
        // This part has it at another place.
        measured.map(|kept| Kept::new(DATA_FLASH, at(0x91B4), &kept.bytes)).into_iter().collect()
    }
}

impl MacModel for Cedv {
    fn voltage_mv(&self) -> u16 {
        whole(self.battery.cell_mv())
    }

    fn calibrating(&self) -> bool {
        self.ram.calibration.mode
    }

    fn control_status(&self, _: Level) -> u16 {
        let (calibration, ram) = (&self.ram.calibration, &self.ram);
        let running =
            [(0x0020, calibration.cc_running()), (0x0010, calibration.board_running()), (0x0008, ram.snooze)];
        bits(&running) | ram.profile
    }

    fn registers(&self, level: Level, voltage_mv: u16) -> Registers {
        let (s, b, ram) = (&self.settings, &self.battery, &self.ram);
        let (to_empty, to_full) = times(&self.battery, self.average_ma.round());
        let kelvin = whole(b.temperature() * 10.0 + FREEZING);
        let health = (100.0 * b.capacity_mah / s.design_mah.max(1.0)).min(100.0);
        let power = self.average_ma * f64::from(voltage_mv) / 1000.0;
        registers(&[
            (0x04, NO_TIME),
            (0x06, kelvin),
            (0x08, voltage_mv),
            (0x0A, ram.flags),
            (0x0C, signed(b.current_ma())),
            (0x10, whole(b.charge_mah)),
            (0x12, whole(b.capacity_mah)),
            (0x14, signed(self.average_ma)),
            (0x16, to_empty),
            (0x18, to_full),
            (0x1A, signed(-10.0)),
            (0x1C, NO_TIME),
            (0x1E, signed(-500.0)),
            (0x20, NO_TIME),
            (0x22, whole(ram.passed_mah.max(0.0))),
            (0x24, signed(power)),
            (0x28, kelvin),
            (0x2A, ram.cycles),
            (0x2C, whole(self.percent())),
            (0x2E, whole(health)),
            (0x30, if ram.flags & CHGINH == 0 { s.charge.0 } else { 0 }),
            (0x32, if ram.flags & (CHGINH | FC) == 0 { s.charge.1 } else { 0 }),
            (0x3A, self.operation(level)),
            (0x3C, whole(s.design_mah)),
        ])
    }

    fn subcommand(&mut self, word: u16, level: Level, _: &Flash) -> Option<Reply> {
        let ram = &mut self.ram;
        // Table 3-2 has these as accepted by a sealed gauge.
        match word {
            0x0001 => return Reply::word(0x0220),
            0x0002 => return Reply::bytes(&[0x02, 0x20, 0x00, 0x03, 0x00, 0x01]),
            0x0003 => return Reply::word(0x00A8),
            0x0009 => ram.calibration.board_offset(),
            0x000A => ram.calibration.cc_offset(),
            0x000B => {
                let offset = Kept::new(DATA_FLASH, at(0x9180), &(-1180i16).to_be_bytes());
                return Some(Reply::Keep(vec![offset]));
            }
            0x000C => {}
            0x0054 => return Reply::word(self.operation(level)),
            0x0056 => return Reply::word(self.gauging()),
            _ if level == Level::Sealed => return None,
            0x000D => ram.removed = false,
            0x000E => ram.removed = true,
            0x0013 => ram.snooze = true,
            0x0014 => ram.snooze = false,
            // Only the first profile's content is known.
            0x0015..=0x001A => ram.profile = word - 0x0015,
            0x002D => ram.calibration.mode = !ram.calibration.mode,
            0x0080 | 0x0081 => {}
            _ => return None,
        }
        Some(Reply::Done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_where_an_owner_read_them() {
        let read = [
            0x0B, 0xB8, 0x03, 0x84, 0x0E, 0x74, 0x00, 0x64, 0x0E, 0x9F, 0x00, 0x95, 0x03, 0x63, 0x0F, 0xBE,
            0x01, 0x3C, 0x09, 0x00, 0x00, 0x0B, 0xD7, 0x01, 0x0D, 0x39, 0x01, 0x0D, 0xAD, 0x01, 0x10, 0x4D,
        ];
        assert_eq!(Flash::new(IMAGE).get(DATA_FLASH, at(0x929F)), read);
    }
}
