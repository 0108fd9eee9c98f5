// SPDX-License-Identifier: MIT

//! What a Smart Battery measures and holds: each word of the specification from its cells, in the pack's own scales.

use crate::battery::Battery;
use crate::flash::Flash;
use crate::model::{FREEZING, Kept, Model, NO_TIME, signed, whole};

pub(super) const BATTERY_MODE: u8 = 0x03;
/// CAPACITY_MODE: capacities are in 10 mWh.
const IN_ENERGY: u16 = 0x8000;
const DESIGN_MAH: f64 = 5200.0;
const FULL_MAH: f64 = 5050.0;
/// Of a cell, in mV.
const NOMINAL_MV: f64 = 3600.0;
const CHARGING_MV: f64 = 4200.0;
const CHARGING_MA: u16 = 2600;
/// From 2021-03-14: day, 32 months, 512 years since 1980.
const MANUFACTURED: u16 = 14 + 3 * 32 + 41 * 512;
const SERIAL: u16 = 0x1A2B;
const AVERAGE_S: f64 = 60.0;
const CYCLE_MAH: f64 = 0.9 * DESIGN_MAH;
/// The lower half of OperationStatus() of a sealed part of TI, and the type of that part.
const OPERATION_STATUS: u16 = 0x8306;
const DEVICE_TYPE: u16 = 0x4500;

const OVER_TEMPERATURE: u16 = 0x1000;
const TERMINATE_CHARGE: u16 = 0x4000;
const TERMINATE_DISCHARGE: u16 = 0x0800;
const REMAINING_CAPACITY: u16 = 0x0200;
const REMAINING_TIME: u16 = 0x0100;
const INITIALIZED: u16 = 0x0080;
const DISCHARGING: u16 = 0x0040;
const FULLY_CHARGED: u16 = 0x0020;
const FULLY_DISCHARGED: u16 = 0x0010;

pub(super) struct Pack {
    battery: Battery,
    average_ma: f64,
    pub(super) specification: u16,
    /// Words 0x00 to 0x04, as they were written.
    words: [u16; 5],
    cycles: u16,
    discharged_mah: f64,
    is_full: bool,
    is_empty: bool,
    /// Its switches are open for good.
    pub(super) has_failed: bool,
}

impl Pack {
    pub(super) fn new() -> Self {
        let battery = Battery::new(4.0, FULL_MAH, 60.0);
        let words = [0, 520, 10, 0, 0];
        Self {
            battery,
            average_ma: 0.0,
            specification: 0x0031,
            words,
            cycles: 57,
            discharged_mah: 0.0,
            is_full: false,
            is_empty: false,
            has_failed: false,
        }
    }

    pub(super) fn set_series(&mut self, cells: f64) {
        self.battery.cells = cells;
    }

    pub(super) fn mode(&self) -> u16 {
        self.words[usize::from(BATTERY_MODE)]
    }

    pub(super) fn set(&mut self, code: u8, word: u16) {
        self.words[usize::from(code)] = word;
    }

    /// Version 3 in SpecificationInfo().
    pub(super) fn says_pec(&self) -> bool {
        self.specification >> 4 & 0xF == 3
    }

    fn current_ma(&self) -> f64 {
        if self.has_failed { 0.0 } else { self.battery.current_ma() }
    }

    fn scaled(&self, value: f64, shifts: &[u16]) -> f64 {
        let power: u16 = shifts.iter().map(|shift| self.specification >> shift & 0xF).sum();
        value / 10_f64.powi(power.into())
    }

    fn volts(&self, mv: f64) -> u16 {
        whole(self.scaled(mv, &[8]))
    }

    fn amperes(&self, ma: f64) -> u16 {
        signed(self.scaled(ma, &[12]))
    }

    fn capacity(&self, mah: f64) -> u16 {
        match self.mode() & IN_ENERGY {
            0 => whole(self.scaled(mah, &[12])),
            _ => whole(self.scaled(mah * NOMINAL_MV * self.battery.cells / 1e4, &[8, 12])),
        }
    }

    fn to_empty(&self, current_ma: f64) -> u16 {
        if current_ma >= 0.0 { NO_TIME } else { minutes(self.battery.charge_mah, -current_ma) }
    }

    fn to_full(&self, current_ma: f64) -> u16 {
        let missing = self.battery.capacity_mah - self.battery.charge_mah;
        if current_ma <= 0.0 { NO_TIME } else { minutes(missing, current_ma) }
    }

    fn status(&self) -> u16 {
        let (battery, current) = (&self.battery, self.current_ma());
        let is_low = battery.charge_mah < f64::from(self.words[1]);
        let is_late = self.to_empty(self.average_ma) < self.words[2];
        crate::model::bits(&[
            (OVER_TEMPERATURE, battery.temperature() > 60.0),
            (TERMINATE_CHARGE, self.is_full || self.has_failed),
            (TERMINATE_DISCHARGE, self.is_empty || self.has_failed),
            (REMAINING_CAPACITY, is_low),
            (REMAINING_TIME, is_late),
            (INITIALIZED, true),
            (DISCHARGING, current <= 0.0),
            (FULLY_CHARGED, self.is_full),
            (FULLY_DISCHARGED, self.is_empty),
        ])
    }

    fn pack_mv(&self) -> f64 {
        let battery = &self.battery;
        battery.forced_mv.map_or_else(|| battery.cell_mv() * battery.cells, f64::from)
    }

    /// DAStatus1(): cells, the pack twice, and the current and the power of each and of all.
    pub(super) fn measured(&self) -> Vec<u8> {
        let cell = whole(self.pack_mv() / self.battery.cells);
        let (pack, current) = (whole(self.pack_mv()), self.current_ma());
        let power = |mv: f64| signed(mv * current / 1e4);
        let cells = (1..=4).map(|at| f64::from(at) <= self.battery.cells);
        let of_cells = |value: u16| cells.clone().map(move |is_there| if is_there { value } else { 0 });
        let all = power(self.pack_mv());
        let words = of_cells(cell).chain([pack, pack]).chain(of_cells(signed(current)));
        let words = words.chain(of_cells(power(self.pack_mv() / self.battery.cells))).chain([all, all]);
        words.flat_map(u16::to_le_bytes).collect()
    }

    /// The voltage of a cell by its number; 0 where none is.
    pub(super) fn cell_mv(&self, number: u8) -> u16 {
        let is_there = f64::from(number) <= self.battery.cells;
        if is_there { whole(self.pack_mv() / self.battery.cells) } else { 0 }
    }

    /// In 0.1 K.
    pub(super) fn kelvin(&self) -> u16 {
        whole(self.battery.temperature() * 10.0 + FREEZING)
    }

    /// The word of a command code; `None` where the pack has no word.
    pub(super) fn word(&self, code: u8) -> Option<u16> {
        let battery = &self.battery;
        let (current, charge) = (self.current_ma(), battery.charge_mah);
        let charges = if self.is_full || self.has_failed { 0.0 } else { 1.0 };
        let at_rate = f64::from(self.words[4] as i16);
        Some(match code {
            0x00 => OPERATION_STATUS,
            0x01..=0x04 => self.words[usize::from(code)],
            0x05 => self.to_full(at_rate),
            0x06 => self.to_empty(at_rate),
            0x07 => 1,
            0x08 => self.kelvin(),
            0x09 => self.volts(self.pack_mv()),
            0x0A => self.amperes(current),
            0x0B => self.amperes(self.average_ma),
            0x0C => 2,
            0x0D => whole(battery.percent()),
            0x0E => whole(100.0 * charge / DESIGN_MAH),
            0x0F => self.capacity(charge),
            0x10 => self.capacity(battery.capacity_mah),
            0x11 => self.to_empty(current),
            0x12 => self.to_empty(self.average_ma),
            0x13 => self.to_full(self.average_ma),
            0x14 => (f64::from(CHARGING_MA) * charges) as u16,
            0x15 => whole(CHARGING_MV * battery.cells * charges),
            0x16 => self.status(),
            0x17 => self.cycles,
            0x18 => self.capacity(DESIGN_MAH),
            0x19 => self.volts(NOMINAL_MV * battery.cells),
            0x1A => self.specification,
            0x1B => MANUFACTURED,
            0x1C => SERIAL,
            0x3C..=0x3F => self.cell_mv(0x40 - code),
            _ => return None,
        })
    }

    /// The text of a command code; `None` where the pack has no block.
    pub(super) fn block(&self, code: u8) -> Option<Vec<u8>> {
        Some(match code {
            // Bytes after a NUL, as a pack of 2004 has them.
            0x20 => b"Sim Cells\x0002".to_vec(),
            0x21 => b"SIM-4S2P".to_vec(),
            0x22 => b"LION".to_vec(),
            0x23 if self.words[0] == 0x0001 => DEVICE_TYPE.to_le_bytes().to_vec(),
            0x23 => b"LOT 0042".to_vec(),
            0x2F => b"SIM0000042".to_vec(),
            _ => return None,
        })
    }
}

fn minutes(mah: f64, ma: f64) -> u16 {
    whole((mah / ma * 60.0).min(65534.0))
}

impl Model for Pack {
    fn battery(&self) -> &Battery {
        &self.battery
    }

    fn battery_mut(&mut self) -> &mut Battery {
        &mut self.battery
    }

    fn measure(&mut self) {
        let percent = self.battery.percent();
        self.is_full = percent > 99.9 || self.is_full && percent > 95.0;
        self.is_empty = percent < 0.5 || self.is_empty && percent < 20.0;
    }

    fn restart(&mut self, _: &Flash) {}

    fn step(&mut self, seconds: f64) -> Vec<Kept> {
        let before = self.battery.charge_mah;
        let current = self.current_ma();
        let load_ma = self.battery.load_ma;
        if self.has_failed {
            self.battery.load_ma = 0.0;
        }
        self.battery.step(seconds);
        self.battery.load_ma = load_ma;
        self.average_ma += (current - self.average_ma) * (1.0 - libm::exp(-seconds / AVERAGE_S));
        if self.average_ma.abs() < 0.5 {
            self.average_ma = 0.0;
        }
        self.discharged_mah += (before - self.battery.charge_mah).max(0.0);
        if self.discharged_mah >= CYCLE_MAH {
            self.discharged_mah -= CYCLE_MAH;
            self.cycles = self.cycles.saturating_add(1);
        }
        self.measure();
        Vec::new()
    }

    /// Its average current still moves.
    fn at_rest(&self) -> bool {
        self.current_ma() == 0.0 && self.average_ma == 0.0
    }
}
