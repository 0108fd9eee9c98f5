// SPDX-License-Identifier: MIT

//! The measuring half of a gauge: its view of the pack. The parts with block access share `gauging`; those with
//! ManufacturerAccessControl() have their models in their own files.

use super::battery::Battery;
use super::flash::Flash;
use super::flat::{DATA_FLASH, offset};
use super::seal::Level;

/// 0x00 to 0x7F.
pub(super) type Registers = [u8; 0x80];

/// 0 degrees Celsius in 0.1 K.
pub(super) const FREEZING: f64 = 2731.0;
pub(super) const AVERAGE_S: f64 = 15.0;
pub(super) const NO_TIME: u16 = 0xFFFF;
const OFFSET_S: f64 = 4.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Host {
    AtRate,
    Temperature,
}

pub(super) type Place = (u16, usize);

/// Bytes of data flash, and their place.
pub(super) struct Kept {
    pub(super) area: u16,
    pub(super) offset: usize,
    pub(super) bytes: Vec<u8>,
}

impl Kept {
    pub(super) fn new(area: u16, offset: usize, bytes: &[u8]) -> Self {
        Self { area, offset, bytes: bytes.to_vec() }
    }
}

pub(super) trait Model: Send {
    fn battery(&self) -> &Battery;
    fn battery_mut(&mut self) -> &mut Battery;
    /// State of charge as reported, before rounding.
    fn percent(&self) -> f64 {
        self.battery().percent()
    }
    fn set_percent(&mut self, percent: f64) {
        self.battery_mut().set_percent(percent);
        self.measure();
    }
    /// Updates states and flags by the present measurements.
    fn measure(&mut self);
    fn charges(&self) -> bool {
        true
    }
    /// Power has come: nothing has been measured yet.
    fn power_up(&mut self) {}
    /// Rebuilds RAM from flash. The pack itself goes on.
    fn restart(&mut self, flash: &Flash);
    /// Flash was programmed. A gauge that reads parameters only at a reset does nothing.
    fn configure(&mut self, _flash: &Flash) {}
    /// Whether the pack changes so slowly that steps may be long.
    fn at_rest(&self) -> bool {
        self.battery().current_ma() == 0.0
    }
    /// Lets a short time pass. Returns what is stored at once.
    fn step(&mut self, seconds: f64) -> Vec<Kept>;
    /// Values that are stored once after a run of steps.
    fn learned(&mut self, _flash: &Flash) -> Vec<Kept> {
        Vec::new()
    }
}

/// The model of a part with ManufacturerAccessControl() and subcommands of its own.
pub(super) trait MacModel: Model {
    /// The pack's voltage as Voltage() shows it.
    fn voltage_mv(&self) -> u16;
    fn calibrating(&self) -> bool;
    /// CAL_ENABLE was sent, or the part has no use for it.
    fn may_calibrate(&self) -> bool {
        true
    }
    fn control_status(&self, level: Level) -> u16;
    /// 0x00 to 0x7F, with 0 in registers that the host writes.
    fn registers(&self, level: Level, voltage_mv: u16) -> Registers;
    /// Takes a subcommand; `None` if the part refuses it at this level.
    fn subcommand(&mut self, word: u16, level: Level, flash: &Flash) -> Option<Reply>;
    /// Takes data committed to a subcommand instead of an address.
    fn parameters(&mut self, _word: u16, _data: &[u8], _level: Level) -> Vec<Kept> {
        Vec::new()
    }
    /// Takes a byte written to a standard command. Returns whether it is acknowledged.
    fn write(&mut self, _register: u8, _byte: u8) -> bool {
        false
    }
    /// A register was read.
    fn seen(&mut self, _register: u8) {}
}

/// The reply to a subcommand.
pub(super) enum Reply {
    /// The buffer stays as it was.
    Done,
    Answer(Vec<u8>),
    Keep(Vec<Kept>),
}

impl Reply {
    pub(super) fn word(word: u16) -> Option<Self> {
        Self::bytes(&word.to_le_bytes())
    }

    pub(super) fn bytes(bytes: &[u8]) -> Option<Self> {
        Some(Self::Answer(bytes.to_vec()))
    }
}

/// Offset calibration of the parts with ManufacturerAccessControl().
#[derive(Default)]
pub(super) struct Calibration {
    board_s: f64,
    cc_s: f64,
    pub(super) enabled: bool,
    pub(super) mode: bool,
    pub(super) count: u8,
    part_s: f64,
}

impl Calibration {
    pub(super) fn board_running(&self) -> bool {
        self.board_s > 0.0
    }

    pub(super) fn cc_running(&self) -> bool {
        self.cc_s > 0.0
    }

    /// BOARD_OFFSET also measures the counter's offset.
    pub(super) fn board_offset(&mut self) {
        (self.board_s, self.cc_s) = (OFFSET_S, OFFSET_S);
    }

    pub(super) fn cc_offset(&mut self) {
        self.cc_s = OFFSET_S;
    }

    pub(super) fn save() -> Kept {
        Kept::new(DATA_FLASH, offset(0x4008), &(-1180i16).to_be_bytes())
    }

    /// Lets time pass. A current that flows meanwhile counts as offset.
    pub(super) fn step(&mut self, seconds: f64, current_ma: f64) -> Option<Kept> {
        self.part_s += seconds;
        if self.part_s >= 1.0 {
            self.count = self.count.wrapping_add(self.part_s as u8);
            self.part_s = self.part_s.fract();
        }
        self.cc_s = (self.cc_s - seconds).max(0.0);
        if !self.board_running() {
            return None;
        }
        self.board_s = (self.board_s - seconds).max(0.0);
        let measured = (current_ma * 4.0).round().clamp(-128.0, 127.0) as i8;
        (!self.board_running()).then(|| Kept::new(DATA_FLASH, offset(0x400C), &[measured as u8]))
    }
}

/// Registers with these words, and 0 elsewhere.
pub(super) fn registers(words: &[(usize, u16)]) -> Registers {
    let mut out = [0; 0x80];
    for (register, word) in words {
        out[*register..register + 2].copy_from_slice(&word.to_le_bytes());
    }
    out
}

pub(super) fn bits(bits: &[(u16, bool)]) -> u16 {
    bits.iter().filter(|(_, on)| *on).fold(0, |word, (bit, _)| word | bit)
}

/// How long a condition has been met: `timer` after `seconds` more.
pub(super) fn lasting(timer: &mut f64, met: bool, seconds: f64) -> f64 {
    *timer = if met { *timer + seconds } else { 0.0 };
    *timer
}

/// Minutes to empty and to full at a current in mA; the second allows for the taper.
pub(super) fn times(battery: &Battery, current_ma: f64) -> (u16, u16) {
    let minutes = |mah: f64| whole((mah / current_ma.abs() * 60.0).min(65534.0));
    match current_ma {
        ..0.0 => (minutes(battery.charge_mah), NO_TIME),
        0.0 => (NO_TIME, NO_TIME),
        _ => (NO_TIME, minutes((battery.capacity_mah - battery.charge_mah) * 1.1)),
    }
}

pub(super) fn whole(value: f64) -> u16 {
    value.round().clamp(0.0, 65535.0) as u16
}

pub(super) fn signed(value: f64) -> u16 {
    value.round().clamp(-32768.0, 32767.0) as i16 as u16
}
