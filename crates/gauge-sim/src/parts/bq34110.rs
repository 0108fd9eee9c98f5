// SPDX-License-Identifier: MIT

//! The bq34110: its data flash in bytes, its subcommands, and the model of a CEDV gauge.
//!
//! It was written without SLUUBF7, the part's manual. Bytes are those that owners have read from parts (E2E
//! 834655, 846947, FRED's) and the defaults of public drivers. The others are from similar gauges or those of
//! a small pack, so that the gauge works. Registers that no document describes are as in similar gauges.

use super::battery::Battery;
use super::flash::{Flash, Image};
use super::flat::{BASE, DATA_FLASH, PRIVATE, SIZE, i16_at, image, offset, u8_at, u16_at};
use super::model::{
    AVERAGE_S, Calibration, FREEZING, Kept, MacModel, Model, Registers, Reply, bits, registers, signed,
    times, whole,
};
use super::part::{MacPart, Part, Scheme};
use super::seal::Level;
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq34110",
    image: IMAGE,
    timing: Timing::MAC,
    scheme: Scheme::Mac(&MacPart {
        base: BASE,
        data_memory: None,
        gate: Some(0x4157),
        // [VEN_EN]. No source says by how much Voltage() changes: as in the bq34z100-G1.
        divider: Some((0x4010, (0x413D, 0x10))),
        // No source has its bit.
        thermistor: None,
        keys: (PRIVATE, 0),
        seal: 0x0030,
        reset: 0x0041,
        is_little: false,
        advances: false,
        answers_elsewhere: true,
        predicted: &[0x10, 0x12, 0x2C, 0x2E],
        initialized: (0, 0),
        model: |flash| Box::new(Cedv::new(flash)),
    }),
    // CC Offset, Board Offset, Learned Full Charge Capacity.
    rewrites: &[
        (DATA_FLASH, offset(0x4008), 2),
        (DATA_FLASH, offset(0x400C), 1),
        (DATA_FLASH, offset(0x40C0), 2),
    ],
};

static IMAGE: Image = &[(DATA_FLASH, &DATA), (PRIVATE, &KEYS)];

/// Keys in the order in which they are sent, the authentication key, and the cycle count.
#[rustfmt::skip]
static KEYS: [u8; 26] = [
    0x04, 0x14, 0x36, 0x72, 0xFF, 0xFF, 0xFF, 0xFF,
    0x01, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF, 0xFE, 0xDC, 0xBA, 0x98, 0x76, 0x54, 0x32, 0x10,
    0x00, 0x00,
];
const CYCLES: usize = 24;

#[rustfmt::skip]
static DATA: [u8; SIZE] = image(&[
    // CC Gain, CC Delta, CC Offset, AD I Offset, Board Offset
    (0x4000, &[0x7F, 0x71, 0x20, 0x5C, 0x94, 0x0A, 0x9C, 0x09, 0xFB, 0x50, 0x00, 0x00, 0x00]),
    // Voltage Divider
    (0x4010, &[0x13, 0x88]),
    // Learned Full Charge Capacity
    (0x40C0, &[0x08, 0x98]),
    // Last Charge Voltage
    (0x40C7, &[0x10, 0x68, 0x10, 0x68, 0x10, 0x68]),
    // Charging Current and Voltage
    (0x410E, &[0x04, 0x4C, 0x04, 0x4C, 0x04, 0x4C, 0x10, 0x68, 0x10, 0x68, 0x10, 0x68]),
    // Maintenance Current, Taper Current, Minimum Taper Capacity, Taper Voltage, Current Taper Window
    (0x411A, &[0x00, 0x00, 0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28]),
    // Operation Config A, Pin Control Config
    (0x413A, &[0x00, 0x04]),
    (0x413D, &[0x00]),
    // Number of Series Cells
    (0x4155, &[0x01]),
    // Flash Update OK Voltage
    (0x4157, &[0x0A, 0xF0]),
    // Dsg Current Threshold, Chg Current Threshold, Quit Current
    (0x4162, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28]),
    // Accumulated Charge Thresholds
    (0x416C, &[0x00, 0x64, 0xFF, 0x9C]),
    // Battery Low
    (0x4184, &[0x0A, 0xF0, 0x0A, 0x0B, 0x54]),
    // SOC Low
    (0x418E, &[0x0A, 0x0F]),
    // Int Coeff 1 to 4, Int Min AD, Int Max Temp
    (0x41C1, &[0x00, 0x00, 0x00, 0x00, 0xCF, 0xDC, 0x17, 0xF3, 0x00, 0x00, 0x16, 0x7A]),
    // Design Capacity mAh, a gap, Design Voltage
    (0x41F5, &[0x08, 0x98, 0x03, 0x18, 0x0E, 0x10]),
    // SOC Flag Config A and B
    (0x41FD, &[0x0C, 0x8C, 0x8C]),
    // CEDV Profile: EMF, C0, R0, T0, R1, TC, C1, Age Factor
    (0x424D, &[0x0E, 0x9F, 0x00, 0x95, 0x03, 0x63, 0x0F, 0xBE, 0x01, 0x3C, 0x09, 0x00, 0x00]),
    // Fixed EDV 0 to 2 with their hold times
    (0x425A, &[0x0B, 0xD7, 0x02, 0x0D, 0x39, 0x02, 0x0D, 0xAD, 0x02]),
    // Voltage 0% DOD to 100% DOD
    (0x4263, &[0x10, 0x4D, 0x0F, 0xCB, 0x0F, 0x55, 0x0E, 0xED, 0x0E, 0x8D, 0x0E, 0x48, 0x0E, 0x23, 0x0D, 0xFE,
               0x0D, 0xBB, 0x0D, 0x6E, 0x0A, 0x99]),
    // Near Full
    (0x4298, &[0x00, 0xC8]),
    // RemCap Init Percent
    (0x429E, &[0x64]),
]);

/// Temperatures in degrees at which the pack is too warm or too cold, for charge and for discharge, and the
/// hysteresis. The parameters that hold them are not known.
const WARM: (f64, f64) = (55.0, 60.0);
const COLD: (f64, f64) = (0.0, -20.0);
const RECOVERY: f64 = 5.0;
/// A full pack is no longer full at this state of charge, in percent, and an empty one no longer empty above.
const NOT_FULL: f64 = 95.0;
const NOT_EMPTY: f64 = 5.0;
/// Current below which a gauge sleeps, in mA.
const SLEEP_MA: f64 = 10.0;

// BatteryStatus().
const DSG: u16 = 0x0001;
const CHG: u16 = 0x0002;
const TDA: u16 = 0x0004;
const TCA: u16 = 0x0008;
const FC: u16 = 0x0010;
const FD: u16 = 0x0020;
const CHGINH: u16 = 0x0040;
const SLEEP: u16 = 0x0080;
const BATLOW: u16 = 0x0100;
const OTD: u16 = 0x0400;
const OTC: u16 = 0x0800;
const UTD: u16 = 0x1000;
const UTC: u16 = 0x2000;
const SOCLOW: u16 = 0x4000;
// Operation Config A and the bits of ManufacturingStatus().
const SLEEPS: u16 = 0x0200;
const CAL_EN: u16 = 0x8000;

struct Settings {
    design_mah: f64,
    charge: (u16, u16),
    taper_ma: f64,
    taper_mv: f64,
    taper_s: f64,
    dsg_ma: f64,
    chg_ma: f64,
    low_mv: (f64, f64, f64),
    soc_low: (f64, f64),
    edv: [f64; 3],
    config: u16,
}

impl Settings {
    fn read(flash: &Flash) -> Self {
        let number = |address| f64::from(i16_at(flash, address));
        let byte = |address| f64::from(u8_at(flash, address));
        Self {
            design_mah: number(0x41F5),
            charge: (u16_at(flash, 0x4116), u16_at(flash, 0x4110)),
            taper_ma: number(0x411C),
            taper_mv: number(0x4120),
            taper_s: byte(0x4122),
            dsg_ma: number(0x4162),
            chg_ma: number(0x4164),
            low_mv: (number(0x4184), byte(0x4186), number(0x4187)),
            soc_low: (byte(0x418E), byte(0x418F)),
            edv: [number(0x425A), number(0x425D), number(0x4260)],
            config: u16_at(flash, 0x413A),
        }
    }
}

struct Cedv {
    battery: Battery,
    settings: Settings,
    average_ma: f64,
    cycle_mah: f64,
    ram: Ram,
}

/// Everything that a reset clears.
#[derive(Default)]
struct Ram {
    calibration: Calibration,
    /// ManufacturingStatus() without `[CAL_EN]`.
    manufacturing: u16,
    flags: u16,
    low_s: f64,
    taper_s: f64,
    cycles: u16,
    /// AccumulatedCharge() and AccumulatedTime(), and the last ones.
    accumulated: (f64, f64),
    accumulated_last: (f64, f64),
}

impl Ram {
    fn new(flash: &Flash) -> Self {
        Self {
            manufacturing: u16_at(flash, 0x40D7) & !CAL_EN,
            cycles: flash.u16(PRIVATE, CYCLES),
            ..Self::default()
        }
    }
}

/// Cells and capacity.
fn pack(flash: &Flash) -> (f64, f64) {
    (f64::from(u8_at(flash, 0x4155)).max(1.0), f64::from(i16_at(flash, 0x40C0)).max(1.0))
}

impl Cedv {
    fn new(flash: &Flash) -> Self {
        let (cells, capacity) = pack(flash);
        let mut new = Self {
            battery: Battery::new(cells, capacity, 60.0),
            settings: Settings::read(flash),
            average_ma: 0.0,
            cycle_mah: 0.0,
            ram: Ram::new(flash),
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

    fn cell_mv(&self) -> f64 {
        self.battery.cell_mv()
    }

    /// Updates the flags, after the present measurements have lasted for `seconds`.
    fn update(&mut self, seconds: f64) {
        let current = self.battery.current_ma();
        let (cell, percent, degrees) = (self.cell_mv(), self.percent(), self.battery.temperature());
        let (s, calm) = (&self.settings, self.average_ma.abs() <= SLEEP_MA);
        let (discharging, charging) = (-current > s.dsg_ma, current > s.chg_ma);
        let tapering =
            current > 0.0 && self.average_ma < s.taper_ma && cell >= f64::from(s.charge.0) - s.taper_mv;
        self.ram.taper_s = if tapering { self.ram.taper_s + seconds } else { 0.0 };
        let full = percent >= 100.0 || tapering && self.ram.taper_s >= 2.0 * s.taper_s;
        let (low, low_time, low_clear) = s.low_mv;
        self.ram.low_s = if cell < low { self.ram.low_s + seconds } else { 0.0 };
        let is_low = cell < low && self.ram.low_s >= low_time;
        let (soc_low, soc_clear) = s.soc_low;
        let empty = percent <= 0.0 || discharging && cell <= s.edv[0];
        let sleeps = s.config & SLEEPS != 0 && calm;
        if full {
            self.battery.charge_mah = self.battery.capacity_mah;
        }
        self.flag(DSG, discharging, true);
        self.flag(CHG, charging, true);
        self.flag(FC | TCA, full, percent <= NOT_FULL);
        self.flag(FD | TDA, empty, percent > NOT_EMPTY);
        self.flag(BATLOW, is_low, cell > low_clear);
        self.flag(SOCLOW, percent <= soc_low, percent >= soc_clear);
        self.flag(SLEEP, sleeps, true);
        self.flag(OTC, degrees >= WARM.0, degrees <= WARM.0 - RECOVERY);
        self.flag(OTD, degrees >= WARM.1, degrees <= WARM.1 - RECOVERY);
        self.flag(UTC, degrees <= COLD.0, degrees >= COLD.0 + RECOVERY);
        self.flag(UTD, degrees <= COLD.1, degrees >= COLD.1 + RECOVERY);
        let inhibited = self.ram.flags & (OTC | UTC) != 0;
        self.flag(CHGINH, inhibited, true);
    }

    /// OperationStatus().
    fn operation(&self, level: Level) -> u16 {
        let security = match level {
            Level::Sealed => 3,
            Level::Unsealed => 2,
            Level::FullAccess => 1,
        };
        // [INITCOMP], which a gauge that answers always has.
        let edv2 = self.cell_mv() <= self.settings.edv[2];
        0x0200 | u16::from(edv2) << 3 | security << 1 | u16::from(self.ram.calibration.mode)
    }

    /// CEDV gauging status in the layout of the bq78350, which fits 0x054A of an owner's part at rest after
    /// a full charge (E2E 616405).
    fn gauging(&self) -> u16 {
        let cell = self.cell_mv();
        let [edv0, edv1, edv2] = self.settings.edv.map(|edv| cell <= edv);
        let flag = |bit| self.ram.flags & bit != 0;
        bits(&[
            (0x4000, edv2),
            (0x2000, edv1),
            (0x0020, edv0),
            (0x0400, true),
            (0x0100, !flag(DSG) && !flag(CHG)),
            (0x0040, !flag(CHG)),
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
        self.ram = Ram::new(flash);
        self.configure(flash);
    }

    fn configure(&mut self, flash: &Flash) {
        self.settings = Settings::read(flash);
        let (cells, capacity) = pack(flash);
        self.battery.resize(cells, capacity);
        self.update(0.0);
    }

    fn step(&mut self, seconds: f64) -> Vec<Kept> {
        let before = self.battery.charge_mah;
        self.battery.step(seconds);
        let moved = self.battery.charge_mah - before;
        let current = self.battery.current_ma();
        self.average_ma += (current - self.average_ma) * (1.0 - libm::exp(-seconds / AVERAGE_S));
        let enabled = if moved < 0.0 { 0x0001 } else { 0x0002 };
        if self.ram.manufacturing & enabled != 0 {
            self.ram.accumulated.0 += moved;
        }
        self.ram.accumulated.1 += seconds;
        self.cycle_mah += (-moved).max(0.0);
        let mut kept: Vec<Kept> = self.ram.calibration.step(seconds, current).into_iter().collect();
        let cycle = self.settings.design_mah.max(1.0) * 0.9;
        if self.cycle_mah >= cycle {
            self.cycle_mah -= cycle;
            self.ram.cycles = self.ram.cycles.saturating_add(1);
            kept.push(Kept::new(PRIVATE, CYCLES, &self.ram.cycles.to_be_bytes()));
        }
        self.update(seconds);
        kept
    }
}

impl MacModel for Cedv {
    fn voltage_mv(&self) -> u16 {
        whole(self.cell_mv() * self.battery.cells)
    }

    fn calibrating(&self) -> bool {
        self.ram.calibration.mode
    }

    /// Only the bits of calibration are known.
    fn control_status(&self, _: Level) -> u16 {
        let calibration = &self.ram.calibration;
        bits(&[(0x0020, calibration.cc_running()), (0x0010, calibration.board_running())])
    }

    fn registers(&self, level: Level, voltage_mv: u16) -> Registers {
        let (s, b, ram) = (&self.settings, &self.battery, &self.ram);
        let (to_empty, to_full) = times(&self.battery, self.average_ma.round());
        let kelvin = whole(b.temperature() * 10.0 + FREEZING);
        let health = (100.0 * b.capacity_mah / s.design_mah.max(1.0)).min(100.0);
        let power = self.average_ma * f64::from(voltage_mv) / 1000.0;
        let mut out = registers(&[
            (0x06, kelvin),
            (0x08, voltage_mv),
            (0x0A, ram.flags),
            (0x0C, signed(b.current_ma())),
            (0x10, whole(b.charge_mah)),
            (0x12, whole(b.capacity_mah)),
            (0x14, signed(self.average_ma)),
            (0x16, to_empty),
            (0x18, to_full),
            (0x1A, signed(ram.accumulated.0)),
            (0x1C, whole(ram.accumulated.1 / 300.0)),
            (0x1E, signed(ram.accumulated_last.0)),
            (0x20, whole(ram.accumulated_last.1 / 300.0)),
            (0x24, signed(power)),
            (0x28, kelvin),
            (0x2A, ram.cycles),
            (0x2C, whole(self.percent())),
            (0x2E, whole(health)),
            (0x30, if ram.flags & CHGINH == 0 { s.charge.0 } else { 0 }),
            (0x32, if ram.flags & (CHGINH | FC) == 0 { s.charge.1 } else { 0 }),
            (0x3A, self.operation(level)),
            (0x3C, whole(s.design_mah)),
            (0x7A, signed(b.current_ma() * 2.0)),
            (0x7C, voltage_mv),
            (0x7E, kelvin),
        ]);
        out[0x79] = ram.calibration.count;
        out
    }

    fn subcommand(&mut self, word: u16, level: Level, flash: &Flash) -> Option<Reply> {
        // A sealed gauge accepts only what some document says it accepts.
        match word {
            0x0001 => return Reply::word(0x0110),
            0x0002 => return Reply::bytes(&[0x01, 0x10, 0x01, 0x00, 0x00, 0x01]),
            0x0003 => return Reply::word(0x00A8),
            0x0004 => return Reply::word(0x0000),
            0x0005 | 0x0010 => {
                let sum = flash.bytes().iter().map(|&byte| u16::from(byte)).fold(0, u16::wrapping_add);
                return Reply::word(sum);
            }
            0x004A => return Reply::bytes(b"\x07bq34110"),
            0x0054 => return Reply::word(self.operation(level)),
            _ if level == Level::Sealed => return None,
            _ => {}
        }
        let ram = &mut self.ram;
        match word {
            0x0009 => ram.calibration.board_offset(),
            0x000A => ram.calibration.cc_offset(),
            0x000B => return Some(Reply::Keep(vec![Calibration::save()])),
            0x001E..=0x0024 => ram.manufacturing ^= 1 << (word - 0x001E),
            0x002D => ram.calibration.mode = !ram.calibration.mode,
            0x0035 => return Reply::bytes(&swapped(&flash.get::<8>(PRIVATE, 0))),
            0x0037 => return Reply::bytes(&flash.get::<16>(PRIVATE, 8)),
            0x004B => {
                ram.accumulated_last = ram.accumulated;
                ram.accumulated = (0.0, 0.0);
            }
            0x0056 => return Reply::word(self.gauging()),
            0x0057 => {
                let mode = if ram.calibration.mode { CAL_EN } else { 0 };
                return Reply::word(ram.manufacturing | mode);
            }
            0x0051 | 0x005E | 0x005F => return Reply::word(0),
            0x0060 | 0x0070 | 0x007A | 0x007B => return Reply::bytes(&[0; 32]),
            0x003E | 0x003F => return Reply::word(0),
            0x0013 | 0x0014 | 0x0039..=0x003C | 0x0044 | 0x0045 => {}
            // The pins are not connected.
            0x0068..=0x006F => {}
            _ => return None,
        }
        Some(Reply::Done)
    }

    /// Keys change in FULL ACCESS only.
    fn parameters(&mut self, word: u16, data: &[u8], level: Level) -> Vec<Kept> {
        match (word, data.len()) {
            (0x0035, 8) if level == Level::FullAccess => vec![Kept::new(PRIVATE, 0, &swapped(data))],
            (0x0037, 16) if level == Level::FullAccess => vec![Kept::new(PRIVATE, 8, data)],
            _ => Vec::new(),
        }
    }
}

/// The words with their bytes swapped.
fn swapped(words: &[u8]) -> Vec<u8> {
    words.chunks(2).flat_map(|word| word.iter().rev().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::flat::offset;
    use super::*;

    /// Read from parts by the owners of E2E 834655 and E2E-FRED. The address of the second is the manual's.
    #[test]
    fn bytes_are_where_owners_read_them() {
        let flash = Flash::new(IMAGE);
        assert_eq!(flash.get(DATA_FLASH, offset(0x4000)), [0x7F, 0x71, 0x20, 0x5C]);
        assert_eq!(flash.get(DATA_FLASH, offset(0x41C5)), [0xCF, 0xDC, 0x17]);
        assert_eq!(swapped(&KEYS[..8]), [0x14, 0x04, 0x72, 0x36, 0xFF, 0xFF, 0xFF, 0xFF]);
    }
}
