// SPDX-License-Identifier: MIT

//! The description of a part: everything that differs between simulated gauges.

use super::flash::{Flash, Image};
use super::gauging::Map;
use super::model::{Host, MacModel, Place};
use super::protector::Protector;
use super::rom::{Firmware, Layout};
use super::seal::Level;
use super::timing::Timing;
use super::update::Exit;
use gauge_bus::GAUGE_ADDRESS;

/// The address of a Smart Battery.
pub(super) const SMART_BATTERY: u8 = 0x0B;

pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) image: Image,
    pub(super) timing: Timing,
    pub(super) scheme: Scheme,
    /// Values that the gauge itself rewrites: area, offset, and length (1 or 2).
    pub(super) rewrites: &'static [(u16, usize, usize)],
}

impl Part {
    /// Whether commits are programmed into flash; otherwise data memory is RAM.
    pub(super) fn has_flash(&self) -> bool {
        match self.scheme {
            Scheme::Block(part) => part.data_memory.is_none(),
            Scheme::Mac(part) => part.data_memory.is_none(),
            Scheme::Registers(_) | Scheme::Smbus(_) => false,
        }
    }
}

impl Part {
    /// Its address on the bus.
    pub(super) fn address(&self) -> u8 {
        if matches!(self.scheme, Scheme::Smbus(_)) { SMART_BATTERY } else { GAUGE_ADDRESS }
    }

    fn layout(&self) -> Option<Layout> {
        match self.scheme {
            Scheme::Block(part) => part.rom,
            Scheme::Mac(_) | Scheme::Registers(_) | Scheme::Smbus(_) => None,
        }
    }

    /// The firmware of a new part, if its boot loader is simulated.
    pub(super) fn firmware(&self) -> Option<Firmware> {
        self.layout()?;
        let Scheme::Block(part) = self.scheme else { return None };
        part.subcommands.iter().find_map(|subcommand| match subcommand {
            (0x0002, _, Action::Answer(version)) => Some(Firmware::new(*version)),
            _ => None,
        })
    }

    pub(super) fn rom_data(&self, flash: &Flash) -> Vec<u8> {
        let mut data = flash.firmware.as_ref().map(|firmware| firmware.rest.to_vec()).unwrap_or_default();
        for &(id, at, length) in self.layout().unwrap_or_default() {
            data[at..at + length].copy_from_slice(flash.bytes_at(id, 0, length));
        }
        data
    }

    pub(super) fn set_rom_data(&self, flash: &mut Flash, data: Vec<u8>) {
        for &(id, at, length) in self.layout().unwrap_or_default() {
            flash.set(id, 0, &data[at..at + length]);
        }
        if let Some(firmware) = &mut flash.firmware {
            firmware.rest = data.into();
        }
    }
}

#[derive(Clone, Copy)]
pub(super) enum Scheme {
    Block(&'static BlockPart),
    Mac(&'static MacPart),
    Registers(&'static RegisterPart),
    /// A Smart Battery, which has no registers, and the gauge of TI's in it.
    Smbus(Option<&'static TiPart>),
}

/// A bit of the word at a place.
pub(super) type Flag = (u16, usize, u16);

#[derive(Debug)]
pub(super) struct BlockPart {
    /// DM_CODE, the only difference between some parts.
    pub(super) code: u16,
    pub(super) map: Map,
    /// Subcommands of Control(): code, lowest level, action. All other codes do nothing.
    pub(super) subcommands: &'static [(u16, Level, Action)],
    pub(super) status: &'static [(Status, u16)],
    /// PREV_MACWRITE shows only subcommands below this one.
    pub(super) remembered: u16,
    /// Higher registers are not acknowledged.
    pub(super) last_register: u8,
    pub(super) flags_register: u8,
    pub(super) voltage_register: u8,
    pub(super) host_registers: &'static [(u8, Host)],
    /// Offsets in class 112 of the keys to UNSEALED and, if there is that level, to FULL ACCESS.
    pub(super) keys: &'static [usize],
    /// For a part whose data memory is RAM.
    pub(super) data_memory: Option<DataMemory>,
    pub(super) gate: Option<Gate>,
    pub(super) authentication: Option<Place>,
    /// Blocks that a sealed gauge shows, with their classes.
    pub(super) sealed_blocks: &'static [(u8, u16)],
    /// The class that a sealed gauge lets the host write.
    pub(super) sealed_writes: Option<u16>,
    pub(super) detection: Detection,
    pub(super) own: Own,
    /// Places of the classes in the boot loader's data flash, if the boot loader is simulated.
    pub(super) rom: Option<Layout>,
    /// For a part that drives the pack's FETs.
    pub(super) protector: Option<Protector>,
}

/// How the gauge learns that a battery is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Detection {
    /// Not at all.
    None,
    /// A pin.
    Pin,
    /// A pin, with this bit of a class and offset; BAT_INSERT then has no effect. Without the bit BAT_INSERT.
    PinIf(u16, usize, u8),
}

/// Data memory in RAM, filled from ROM when power comes.
#[derive(Debug)]
pub(super) struct DataMemory {
    /// Class and offset of a byte, and its bit that seals.
    pub(super) seals: (u16, usize, u8),
    /// The byte whose bit 7 is the sign of CC Gain, where ROMs differ in it.
    pub(super) gain_sign: Option<Place>,
}

/// Data flash that the gauge itself uses, besides gauging.
#[derive(Debug)]
pub(super) struct Own {
    pub(super) update_status: Option<Place>,
    pub(super) cc_offset: Option<Place>,
    pub(super) board_offset: Option<Place>,
    /// The byte that selects the constant-power model unless it is 0.
    pub(super) load_mode: Option<Place>,
    /// The bit that lifts the gate.
    pub(super) calibration: Option<Flag>,
    /// The bit that allows SLEEP, and the current below which the gauge sleeps.
    pub(super) sleep: Option<(Flag, Place)>,
    /// Seconds of silence before FULL SLEEP.
    pub(super) settle: Option<Place>,
    /// The class whose checksum is the chemistry's.
    pub(super) chemistry: Option<u16>,
}

#[derive(Debug)]
pub(super) struct Gate {
    pub(super) limit: Place,
    /// Voltage Divider, and the bit that switches off the internal divider.
    pub(super) divider: Option<(Place, Flag)>,
    /// The Voltage Divider of a single cell, for parts that also compare Voltage() scaled back to a cell.
    pub(super) cell_divider: Option<u16>,
}

/// The scale of Voltage(): proportional to Voltage Divider, the voltage at the converter's full scale, and 5 times as
/// large without the internal divider (SLUSBZ5D 7.3.8).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Scale {
    pub(super) divider: u16,
    pub(super) external: bool,
}

impl Scale {
    fn factor(self) -> u64 {
        u64::from(self.divider) * if self.external { 5 } else { 1 }
    }

    /// What Voltage() shows with this scale, where the board's own scale would show `voltage_mv`. It overflows; beyond
    /// the converter's range it is 0, as owners read it (E2E 255438).
    pub(super) fn shows(self, board: Self, voltage_mv: u16) -> u16 {
        if self == board && self.divider > 0 {
            return voltage_mv;
        }
        let board = board.factor().max(1);
        let shown = (u64::from(voltage_mv) * self.factor() + board / 2) / board;
        if self.external && shown > u64::from(self.divider) { 0 } else { shown as u16 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    ControlStatus,
    Answer(u16),
    AnswerCode,
    AnswerFrom(u16, usize),
    /// Answers with the chosen chemistry, or with this one.
    AnswerChemistry(u16),
    AnswerOffset,
    ResetData,
    Previous,
    BoardOffset,
    CcOffset,
    WriteCcOffset,
    FlashChecksum,
    ChemistryChecksum,
    FullSleep,
    Set(Status),
    Clear(Status),
    BatteryInsert(bool),
    Seal,
    ItEnable,
    ItDisable,
    CalEnable,
    EnterCalibration,
    ExitCalibration,
    Reset,
    ConfigUpdate,
    Leave(Exit),
    /// Selects a chemistry, in CONFIG UPDATE only.
    Chemistry(u16),
    /// If armed: off until power is switched off and on.
    Shutdown,
    Rom,
    Hdq,
    ProtectorChecksum,
    /// Opens both FETs, for this reason.
    OpenFets(&'static str),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    NotFullAccess,
    Sealed,
    CcOffset,
    BoardOffset,
    Initialized,
    Sleep,
    LoadMode,
    Enabled,
    VoltageOk,
    RaOff,
    ChemistryChanged,
    // Marks, which only subcommands set and clear.
    Calibrating,
    ChecksumValid,
    DataLog,
    Hibernate,
    OcvDone,
    ShutdownArmed,
    Snooze,
    WatchdogReset,
}

/// Data memory in RAM, filled from ROM when power comes, and written in FULL ACCESS between two subcommands.
#[derive(Debug)]
pub(super) struct MacMemory {
    /// The address of a byte, and the bit that makes the gauge seal itself when power comes.
    pub(super) default_seal: (u16, u8),
    /// Register and bit that show CONFIG UPDATE.
    pub(super) shows: (u8, u16),
}

pub(super) struct MacPart {
    pub(super) base: u16,
    /// For a part whose data memory is RAM.
    pub(super) data_memory: Option<MacMemory>,
    pub(super) gate: Option<u16>,
    /// Address of Voltage Divider, and the bit of a byte that switches off the internal divider.
    pub(super) divider: Option<(u16, (u16, u8))>,
    /// The bit of a byte that chooses the thermistor; without one the part always measures with it.
    pub(super) thermistor: Option<(u16, u8)>,
    /// Area and offset of the keys: four words in their order on the wire.
    pub(super) keys: Place,
    pub(super) seal: u16,
    pub(super) reset: u16,
    /// Numbers in data flash have their least significant byte first.
    pub(super) is_little: bool,
    /// After a read from 0x3E to 0x61 in one message, the next read from 0x3E shows the following block.
    pub(super) advances: bool,
    /// Control() reads 0xFFA5 once after DEVICE_TYPE or FW_VERSION.
    pub(super) answers_elsewhere: bool,
    /// Predicted registers of one word, and the bit that says so: of a register, or 0 for CONTROL_STATUS.
    pub(super) predicted: &'static [u8],
    pub(super) initialized: (u8, u16),
    pub(super) model: fn(&Flash) -> Box<dyn MacModel>,
}

/// A gauge of TI's in a Smart Battery, with ManufacturerAccess().
#[derive(Debug)]
pub(super) struct TiPart {
    pub(super) device_name: &'static str,
    pub(super) device_type: u16,
    /// BCD, two digits behind the point.
    pub(super) version: u16,
    pub(super) build: u16,
    /// The command codes of the answers: 0x44 has the command before it, and 0x00 is a word.
    pub(super) answers_at: &'static [u8],
    /// Commands that answer, and the length of the answer.
    pub(super) answers: &'static [(u16, usize)],
    /// Commands that do something.
    pub(super) does: &'static [u16],
}

/// A part known by its standard commands only.
#[derive(Debug)]
pub(super) struct RegisterPart {
    pub(super) map: Map,
    /// Charge and current are counted as the voltage of the sense resistor, without sign.
    pub(super) in_volts: bool,
    /// Answers to DEVICE_TYPE and FW_VERSION; `None` for a part without Control().
    pub(super) control: Option<(u16, u16)>,
}
