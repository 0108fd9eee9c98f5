// SPDX-License-Identifier: MIT

//! A chip is a table: the types of its rows, and the list of all chips.
//!
//! Rows keep the manual's columns and order, to be checked beside it. Parts differ in fields; no code asks for a name.

use std::time::Duration;

use crate::codec::Layout;
use crate::text;
use crate::value::Type;
use gauge_bus::Reach;

pub mod bq27220;
pub mod bq27421_g1;
pub mod bq27426;
pub mod bq27427;
pub mod bq27441_g1;
pub mod bq27500;
pub mod bq27520_g3;
pub mod bq27541_g1;
pub mod bq27542_g1;
pub mod bq27621_g1;
pub mod bq27742_g1;
pub mod bq28z610;
pub mod bq34110;
pub mod bq34z100_g1;
pub mod bq34z100_r2;
pub mod bq35100;
pub mod kernel;
pub mod sbs;

mod beliefs;
mod bursts;
mod calibration;
mod identity;
mod names;
mod parameter;
mod preflight;
mod proof;
mod question;
mod recognise;
mod source;
mod values;

pub use beliefs::{BELIEFS, Belief};
pub use bursts::bursts;
pub use calibration::{Calibration, Offset};
pub use identity::{Answers, Identity, SIBLINGS, Sibling, Signature};
pub use names::{Unnamed, kebab_case, snake_case};
pub use parameter::{FLAT, Kind, Parameter, Range, Row, Safe, Stays, Subclass};
pub use preflight::{Learning, Mode, Pack, Preflight};
pub use question::{Asks, Question, Way};
pub use recognise::{Limited, Recognised, recognise};
pub use source::Source;
pub use values::Values;

/// Every chip that has a table, in the order of the README. The others are in [`kernel::GAUGES`].
pub static CHIPS: &[&Chip] = &[
    &bq34z100_g1::CHIP,
    &bq34z100_r2::CHIP,
    &bq27520_g3::CHIP,
    &bq27500::CHIP,
    &bq27500::V130,
    &bq27541_g1::CHIP,
    &bq27542_g1::CHIP,
    &bq27541_g1::BQ27545_G1,
    &bq27742_g1::CHIP,
    &bq27441_g1::CHIP,
    &bq27421_g1::CHIP,
    &bq27426::CHIP,
    &bq27427::CHIP,
    &bq27220::CHIP,
    &bq27621_g1::CHIP,
    &bq34110::CHIP,
    &bq35100::CHIP,
    &bq28z610::CHIP,
];

/// One fuel gauge: everything in which parts differ.
#[derive(Clone, Debug)]
pub struct Chip {
    /// Name on the command line: TI's, lower case.
    pub name: &'static str,
    /// Name as TI prints it, shown as `model_name`.
    pub model: &'static str,
    /// The documents behind the table, with revision.
    pub documents: &'static [&'static str],
    /// What the table has been checked with.
    pub evidence: &'static [Evidence],
    /// The answers that identify the part.
    pub identity: Identity,
    /// How a firmware file of the part is recognised, for ROM mode; `None` where no source shows a whole one.
    pub firmware_file: Option<FirmwareFile>,
    /// Chemistry as the kernel names it, where the part allows only one; else `Unknown`.
    pub technology: &'static str,
    /// Its 7-bit address on the bus.
    pub address: u8,
    /// How it stores numbers in data flash.
    pub layout: Layout,
    /// Addresses of data flash on a part with a flat address space; empty on others, and where no document has the end.
    pub flat: std::ops::Range<u16>,
    /// Standard commands, by address.
    pub registers: &'static [Register],
    /// Control() subcommands, by code.
    pub subcommands: &'static [Subcommand],
    /// CONTROL_STATUS bits, or those of the answer that has its place.
    pub control_status: &'static [Bit],
    /// What the flags mean to a power_supply.
    pub condition: Condition,
    /// By what the host multiplies measured values.
    pub scaling: Scaling,
    /// How the seal state is read and changed.
    pub security: Security,
    /// How a gauge of TI's in a Smart Battery is asked; `None` of a part that is not asked so.
    pub asks: Option<&'static Asks>,
    /// How data flash is read and written, with the delays.
    pub access: Access,
    /// The voltage that a data-flash write needs.
    pub gate: Option<Gate>,
    /// How it is calibrated; `None` where no document has it whole.
    pub calibration: Option<&'static Calibration>,
    /// SHA-1 authentication at AuthenticateData(); `None` where no source has the part's sequence.
    pub authentication: Option<Authentication>,
    /// Data flash, in the manual's order.
    pub subclasses: &'static [Subclass],
    /// Single-byte writes only above this bus clock; `None` where the manual says nothing.
    pub byte_writes_above_hz: Option<u32>,
    /// Values of data flash that prove its layout before the first write; empty where [`Identity`] is enough.
    pub signature: &'static [Signature],
    /// `[ITPOR]`: data memory in RAM has reverted to its defaults; 0 where no flag shows that, `None` where it is flash.
    pub volatile: Option<u32>,
    /// Known defects of some parts as shipped, and their remedies.
    pub quirks: &'static [Quirk],
    /// Where images for ROM mode hold its data flash; `None` where no source has the layout.
    pub rom_image: Option<RomImage>,
    /// What is checked before a write.
    pub preflight: Preflight,
}

/// Something that a table was written from, or has been checked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// TI's documents for this part print what is not marked as unproven.
    Manual,
    /// Documents of a sibling were taken where those of this part are not public.
    Sibling,
    /// Drivers that were written for this part.
    Drivers,
    /// Byte-level transcripts: TI's worked transfers, or traces of parts that their owners have published.
    Transcript,
    /// Images of configurations, of packs or of TI, fit the table.
    Image,
    /// The kernel's driver, in a virtual machine, shows the same values of the simulated gauge.
    Kernel,
    /// A report of real hardware replays, and is one of the tests.
    RealPart,
}

impl Evidence {
    /// A word or two for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Evidence::Manual => "manual",
            Evidence::Sibling => "siblings",
            Evidence::Drivers => "drivers",
            Evidence::Transcript => "transcripts",
            Evidence::Image => "images",
            Evidence::Kernel => "kernel's driver",
            Evidence::RealPart => "real part",
        }
    }

    /// A list of kinds of evidence, with commas.
    pub fn list(all: &[Evidence]) -> String {
        all.iter().map(|one| one.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// What it proves.
    pub fn meaning(self) -> &'static str {
        match self {
            Evidence::Manual => "TI's documents for this part print what is not marked as uncertain",
            Evidence::Sibling => "documents of a sibling, where those of this part are not public",
            Evidence::Drivers => "drivers that were written for this part",
            Evidence::Transcript => "TI's worked transfers, or published traces of parts, byte for byte",
            Evidence::Image => "images of packs or of TI's tools fit the table",
            Evidence::Kernel => "the kernel's driver shows the same values of the simulated gauge",
            Evidence::RealPart => "seen on a real part: its report is one of the tests",
        }
    }
}

/// Data flash in images for ROM mode: 32 rows of 32 bytes, in which subclasses cross the blocks of normal mode.
#[derive(Clone, Debug)]
pub struct RomImage {
    /// For each firmware: the subclasses whose place is known, by id, and the index of their first byte. All of their length
    /// is there.
    pub layouts: &'static [(u16, &'static [(u8, u16)])],
    /// The data of the chemistry and private data around them: the first byte, and one behind the last.
    pub chemistry: (u16, u16),
    /// Index of the big-endian checksum of the chemistry. It is inferred, so it never proves that two of them differ. `None`
    /// where nothing shows it.
    pub chemistry_sum: Option<u16>,
}

/// A file with the whole firmware. Only the Device Name in its data flash and the firmware's version show its part.
#[derive(Clone, Debug)]
pub struct FirmwareFile {
    /// Index of its length byte in the 32 rows.
    pub name: usize,
    /// What TI's files have there. A user may have changed it.
    pub names: &'static [&'static str],
}

/// A defect of some parts that a byte of data flash reveals.
#[derive(Clone, Debug)]
pub struct Quirk {
    /// Subclass id.
    pub subclass: u8,
    /// Offset of the byte in the subclass.
    pub offset: u16,
    /// The bits to compare.
    pub mask: u8,
    /// Their value on a part with the defect.
    pub wrong: u8,
    /// What the defect does.
    pub effect: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

/// How often a register is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tier {
    /// With every poll.
    Poll,
    /// With every poll of a gauge whose type and version are the table's. In others its address may be something else's.
    Proven,
    /// With every tenth poll, for `gauge/registers`.
    Slow,
    /// When the gauge is opened: copies of data flash.
    Static,
    /// Only on request: Control() and the block-access window.
    Window,
}

/// The power_supply property that a register or a parameter feeds, in units before [`Scaling`] applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// `capacity`, %.
    Capacity,
    /// `capacity_error_margin`, %.
    CapacityErrorMargin,
    /// `charge_now`, mAh.
    ChargeNow,
    /// `charge_full`, mAh.
    ChargeFull,
    /// `charge_full_design`, mAh.
    ChargeFullDesign,
    /// `voltage_now`, mV.
    VoltageNow,
    /// `current_now`, mA.
    CurrentNow,
    /// `current_avg`, mA.
    CurrentAvg,
    /// `temp`, 0.1 K.
    Temp,
    /// `time_to_empty_now`, min.
    TimeToEmptyNow,
    /// `time_to_empty_avg`, min.
    TimeToEmptyAvg,
    /// `time_to_full_now`, min.
    TimeToFullNow,
    /// `time_to_full_avg`, min.
    TimeToFullAvg,
    /// `energy_now`, mWh.
    EnergyNow,
    /// `energy_full`, mWh.
    EnergyFull,
    /// `energy_full_design`, mWh.
    EnergyFullDesign,
    /// `power_avg`, mW.
    PowerAvg,
    /// `charge_counter`, mAh; rises while charging.
    ChargeCounter,
    /// `voltage_min_design`, mV: the voltage of an empty cell or pack.
    VoltageMinDesign,
    /// `voltage_max_design`, mV: the voltage to which a cell or pack is charged at moderate temperatures.
    VoltageMaxDesign,
    /// The number of cells in series. Where a parameter has it, design voltages are a cell's, and no document says
    /// whether [`Role::ChargeVoltage`] is a cell's or the pack's.
    Cells,
    /// `constant_charge_voltage`, mV.
    ChargeVoltage,
    /// `constant_charge_current`, mA.
    ChargeCurrent,
    /// `internal_resistance`, mΩ.
    InternalResistance,
    /// `cycle_count`.
    CycleCount,
    /// `state_of_health`, %.
    StateOfHealth,
    /// The flags that `status`, `health` and `capacity_level` follow from.
    Flags,
    /// `technology`: the short name of the chemistry as Smart Battery Data prints it, such as `LION`.
    Technology,
    /// `manufacture_year`, `manufacture_month` and `manufacture_day`: day + month * 32 + (year - 1980) * 512.
    ManufactureDate,
    /// `serial_number`.
    SerialNumber,
    /// `manufacturer`: a text.
    Manufacturer,
    /// `model_name`: a text.
    ModelName,
}

/// A standard command.
#[derive(Clone, Copy, Debug)]
pub struct Register {
    /// Where it is read.
    pub source: Source,
    /// Bytes.
    pub size: u8,
    /// Whether the value is two's complement.
    pub signed: bool,
    /// Whether it is a text. Its first byte is its length.
    pub text: bool,
    /// TI's name without the parentheses.
    pub name: &'static str,
    /// Unit of one step, as the manual prints it.
    pub unit: &'static str,
    /// How often it is read.
    pub tier: Tier,
    /// The property it feeds.
    pub role: Option<Role>,
    /// One step in the unit of its role, as numerator and denominator.
    pub step: (i64, i64),
    /// Whether it measures discharges only, without a sign, and is 0 while another current flows.
    pub discharge: bool,
    /// The bit of the flags that is clear while the value is negative, where the register itself has no sign; else 0.
    pub positive: u32,
    /// The bit of the flags that is set while a reading of 0 is a value; 0 where it needs none.
    pub empty: u32,
    /// The readings that are values of its property.
    pub values: Values,
    /// The register of one byte that is 0 while the reading is not valid.
    pub validity: Option<Source>,
    /// The property that it feeds in another mode of the part, in place of its own.
    pub other: Option<Other>,
    /// Names of its bits, if it is a flag word.
    pub bits: &'static [Bit],
    /// Bits without a name are told as well.
    pub tells_all: bool,
}

/// What a register feeds while a bit of another register is set.
#[derive(Clone, Copy, Debug)]
pub struct Other {
    /// The register with the bit, and the bit.
    pub bit: (Source, u32),
    /// The property.
    pub role: Role,
    /// One step in the unit of that role, as numerator and denominator.
    pub step: (i64, i64),
}

/// A named bit of a flag word. Reserved bits have no entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bit {
    /// The bit's mask.
    pub mask: u32,
    /// TI's name.
    pub name: &'static str,
}

/// A Control() subcommand.
#[derive(Clone, Debug)]
pub struct Subcommand {
    /// The word written to Control().
    pub code: u16,
    /// TI's name.
    pub name: &'static str,
    /// Whether a sealed gauge accepts it.
    pub sealed: bool,
    /// What sending it does.
    pub effect: Effect,
}

/// What a subcommand does, and so who may send it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Answers with a word and changes nothing.
    Answers,
    /// Changes the gauge's state in a way that the user may request through `gauge/control`.
    Safe,
    /// Has a guarded interface of its own (seal, reset) and is refused in `gauge/control`.
    Guarded,
    /// Can ruin, lock or disturb a gauge: never sent.
    Never,
}

/// What the flags register means to a power_supply. Masks of the [`Role::Flags`] register.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Fully charged.
    pub full: u32,
    /// Below the first, higher threshold of remaining capacity.
    pub low: u32,
    /// Below the final threshold.
    pub critical: u32,
    /// Over temperature.
    pub overheat: u32,
    /// Under temperature.
    pub cold: u32,
    /// The voltage is above the limit that the pack's maker has set; 0 where no flag shows that.
    pub over_voltage: u32,
    /// The voltage is below the limit that the pack's maker has set; 0 where no flag shows that.
    pub under_voltage: u32,
    /// Set while a battery is present; 0 where the gauge does not detect it.
    pub present: u32,
    /// What all flags read while no battery is behind them; 0 where no value says that.
    pub absent: u32,
    /// Set while the gauge asks for an update of its capacity; 0 where no flag does.
    pub uncertain: u32,
    /// Clear while the gauge's predictions are not to be trusted; 0 where no flag shows that.
    pub certain: u32,
    /// Empty, as it is in use: `capacity_level` is `Critical`, and nothing is wrong with the battery.
    pub empty: u32,
    /// The bit of CONTROL_STATUS or of a polled register that is set once values are valid after a reset, if documented.
    pub complete: Option<(Source, u32)>,
    /// A gauge for primary cells.
    pub primary: Option<Primary>,
}

impl Condition {
    /// Whether the flags show a battery. Without a flag for it there is one, unless all flags say that there is not.
    pub fn shows_battery(&self, flags: Option<i64>) -> bool {
        let is_set = |flags: i64| flags & i64::from(self.present) != 0;
        let is_absent = self.absent != 0 && flags == Some(self.absent.into());
        !is_absent && (self.present == 0 || flags.is_some_and(is_set))
    }
}

/// A gauge for primary cells: `status` is `Discharging` while a current of either sign flows, else `Not charging`.
#[derive(Clone, Debug)]
pub struct Primary {
    /// The bit of CONTROL_STATUS that is set between GAUGE_START and GAUGE_STOP. Current() is measured only then.
    pub active: u32,
    /// The byte of data flash (subclass and offset) whose bits let the flags of [`Condition`] through.
    pub alerts: (u8, u16),
    /// The byte of data flash that holds the mode.
    pub mode: (u8, u16),
    /// The mode's bits in it.
    pub mode_mask: u8,
    /// The modes in which the gauge computes StateOfHealth().
    pub health_modes: &'static [u8],
    /// The modes in which the gauge measures the cell's resistance.
    pub resistance_modes: &'static [u8],
}

/// By what the host multiplies a part's values. Parameters of data flash are in the units of the registers.
#[derive(Clone, Debug)]
pub struct Scaling {
    /// Voltages.
    pub voltage: Scale,
    /// Currents.
    pub current: Scale,
    /// Charges.
    pub charge: Scale,
    /// Energies and powers.
    pub energy: Scale,
    /// Register, read at opening, and bit: set if the host must multiply by a factor that the gauge does not have.
    pub scaled: Option<(Source, Bit)>,
}

/// Where a part has a scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Nowhere.
    None,
    /// In a polled register, which is not 0 in a configured gauge.
    Register(Source),
    /// A power of ten: the sum of some fields of four bits of a register, by their lowest bits.
    Power(Source, &'static [u8]),
    /// In a byte of data flash, by subclass and offset. Its default is 1.
    Flash(u8, u16),
}

/// Ten to the sum of these fields of four bits of a word.
pub fn power(word: u32, fields: &[u8]) -> u32 {
    10_u32.pow(fields.iter().map(|field| word >> field & 0xf).sum::<u32>().min(9))
}

impl Scaling {
    /// The part has none.
    pub const NONE: Self = Self {
        voltage: Scale::None,
        current: Scale::None,
        charge: Scale::None,
        energy: Scale::None,
        scaled: None,
    };

    /// The bytes of data flash that hold scales.
    pub fn in_flash(&self) -> impl Iterator<Item = (u8, u16)> + use<> {
        let scales = [self.voltage, self.current, self.charge, self.energy];
        let mut places: Vec<_> = scales
            .into_iter()
            .filter_map(|scale| match scale {
                Scale::Flash(subclass, offset) => Some((subclass, offset)),
                Scale::None | Scale::Register(_) | Scale::Power(..) => None,
            })
            .collect();
        places.dedup();
        places.into_iter()
    }
}

/// Seal states and keys.
#[derive(Clone, Debug)]
pub struct Security {
    /// Where the seal state is read.
    pub status: SealStatus,
    /// The manual's default unseal key, in the order it is sent.
    pub default_unseal: [u16; 2],
    /// Whether there is a FULL ACCESS state above UNSEALED.
    pub full_access: bool,
    /// Subcommand that seals.
    pub seal: u16,
    /// How late the gauge may show a new seal state.
    pub shows: Duration,
    /// Silence before keys after a refusal. The manuals print 4 s (bq35100: 10 s) by the gauge's clock; this has a margin.
    pub key_silence: Duration,
    /// The bit of data memory by which a gauge seals itself at the end of CONFIG UPDATE, if SEALED is known to set it:
    /// subclass, offset, mask.
    pub seals_itself: Option<(u8, u16, u8)>,
    /// The blocks that a SEALED gauge shows: DataFlashBlock(), and the subclass whose first bytes it is.
    pub shown_sealed: &'static [(u8, u8)],
    /// Where the keys are stored, for changing them.
    pub storage: KeyStorage,
}

/// Where and how a part stores its keys.
#[derive(Clone, Debug)]
pub enum KeyStorage {
    /// In ROM, or nobody knows where. Changing them is not supported; the text gives the reason.
    Fixed(&'static str),
    /// In data flash, where those of two packs may differ, and where changing them is not supported for this reason.
    Kept(KeyBlock, &'static str),
    /// Together in one block of data flash.
    Flash(KeyBlock),
}

impl KeyStorage {
    pub(crate) fn block(&self) -> Option<&KeyBlock> {
        match self {
            Self::Fixed(_) => None,
            Self::Kept(block, _) | Self::Flash(block) => Some(block),
        }
    }
}

/// The part of a block that holds only keys. Positions count from its first byte.
#[derive(Clone, Debug)]
pub struct KeyBlock {
    /// Subclass id, or [`FLAT`].
    pub subclass: u8,
    /// Offset, or address, of its first byte.
    pub start: u16,
    /// Bytes.
    pub length: usize,
    /// The unseal key.
    pub unseal: usize,
    /// The full-access key.
    pub full_access: usize,
    /// The authentication key, most significant byte first; `None` for a part whose key cannot be tested.
    pub authentication: Option<usize>,
    /// How the two words of a key are stored there.
    pub order: KeyOrder,
}

/// How two key words are stored in data flash, relative to the order in which they are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyOrder {
    /// The four bytes in the reverse of their order on the wire: the second word, then the first.
    Reversed,
    /// The first word, then the second, each with its most significant byte first.
    AsSent,
}

/// Where and how the seal state is read.
#[derive(Clone, Debug)]
pub enum SealStatus {
    /// In CONTROL_STATUS: a bit that is set while SEALED, a bit that is set while not in FULL ACCESS.
    Bits {
        /// `[SS]`.
        sealed: u32,
        /// `[FAS]`; 0 where there is no FULL ACCESS.
        not_full_access: u32,
    },
    /// A two-bit field of a word: 11 SEALED, 10 UNSEALED, 01 FULL ACCESS.
    Field {
        /// The word. The answer to a subcommand takes the place of CONTROL_STATUS.
        word: Source,
        /// The lower of the two bits.
        shift: u8,
    },
    /// Nowhere: the part has none, or no table says where.
    None,
}

impl SealStatus {
    /// Whether CONTROL_STATUS by itself shows SEALED.
    pub fn shows_sealed(&self, status: u32) -> bool {
        match *self {
            Self::Bits { sealed, .. } => status & sealed != 0,
            Self::Field { word: Source::Status, shift } => status >> shift & 3 == 3,
            Self::Field { .. } | Self::None => false,
        }
    }
}

/// How data flash is accessed, with the delays. No delay is optional; the table gives the source of each.
#[derive(Clone, Debug)]
pub struct Access {
    /// The sequence that reads and writes a block.
    pub scheme: Scheme,
    /// From selecting a block until its bytes are in the window.
    pub select: Duration,
    /// Like `select`, for the first look at a block in RAM: the least that drivers wait. The next one is at `select`.
    pub soonest: Duration,
    /// From the checksum that commits until the gauge has stored the block.
    pub commit: Duration,
    /// From SET_CFGUPDATE until `[CFGUPMODE]` is first polled.
    pub enter: Duration,
    /// For how long `[CFGUPMODE]` is polled.
    pub enter_limit: Duration,
    /// From RESET until the first poll for an answer; from the end of CONFIG UPDATE until data memory can be read.
    pub reset: Duration,
    /// For how long it is polled for an answer.
    pub reset_limit: Duration,
    /// Subcommand that resets.
    pub resets: u16,
    /// Whether a read of a whole block from its selection on makes the gauge show the next one.
    pub advances: bool,
}

/// The sequences by which TI's gauges give access to data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// BlockDataControl, DataFlashClass, DataFlashBlock, a 32-byte window, and a checksum that commits; unsealed only.
    Block,
    /// Block access between SET_CFGUPDATE and SOFT_RESET; data memory is RAM.
    CfgUpdate,
    /// ManufacturerAccessControl: a flat address, data, MACDataSum and MACDataLen.
    Mac,
    /// ManufacturerAccessControl() in FULL ACCESS, between ENTER_CFG_UPDATE and EXIT_CFG_UPDATE_REINIT; data memory is RAM.
    MacUpdate,
    /// None: only the standard commands are known.
    None,
    /// None: words and blocks of the Smart Battery Data Specification, which are only read.
    Smbus,
}

impl Scheme {
    /// Whether data flash is one flat address space, without subclasses.
    pub fn is_flat(self) -> bool {
        matches!(self, Scheme::Mac | Scheme::MacUpdate)
    }

    /// Whether data memory is RAM, which is written in CONFIG UPDATE.
    pub fn is_ram(self) -> bool {
        matches!(self, Scheme::CfgUpdate | Scheme::MacUpdate)
    }
}

impl Access {
    /// RESET of most of TI's gauges.
    pub const RESET: u16 = 0x0041;

    /// No access to data flash, and so no delays.
    pub const NONE: Self = Self {
        scheme: Scheme::None,
        select: Duration::ZERO,
        soonest: Duration::ZERO,
        commit: Duration::ZERO,
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        reset: Duration::ZERO,
        reset_limit: Duration::ZERO,
        resets: 0,
        advances: false,
    };
}

impl Security {
    /// How late a new seal state is shown: drivers wait 40 ms and try again (bq35100), or 100 ms after a key.
    pub const SHOWS: Duration = Duration::from_millis(240);

    /// No seal state: neither keys nor the subcommand are sent to a chip without a table.
    pub const NONE: Self = Self {
        status: SealStatus::None,
        default_unseal: [0; 2],
        full_access: false,
        seal: 0,
        shows: Duration::ZERO,
        key_silence: Duration::ZERO,
        seals_itself: None,
        shown_sealed: &[],
        storage: KeyStorage::Fixed("no table describes its keys"),
    };
}

/// The delays of SHA-1 authentication, each with its source in the table.
#[derive(Clone, Debug)]
pub struct Authentication {
    /// From the challenge until its checksum may follow.
    pub challenge: Duration,
    /// From the checksum until the digest is in AuthenticateData().
    pub digest: Duration,
}

/// The voltage below which the gauge acknowledges a flash write but stores nothing.
#[derive(Clone, Debug)]
pub struct Gate {
    /// Parameter that holds the limit in mV, two bytes and signed: subclass and offset. 0 opens the gate.
    pub limit: (u8, u16),
    /// Parameter of two bytes to which Voltage() is proportional: the voltage at the full scale of the converter.
    pub divider: Option<(u8, u16)>,
    /// Divider at which Voltage() is a cell's, if the limit also holds for Voltage() scaled to it; else `None`.
    pub cell_divider: Option<u32>,
    /// The bit that switches off the internal divider.
    pub external: Option<External>,
    /// Parameter of one byte that holds the number of cells in series, where the limit is a cell's by its name.
    pub cells: Option<(u8, u16)>,
    /// Register of two bytes and its bit that is set while calibration is enabled. The gate is open then.
    pub calibration: Option<(Source, u32)>,
}

/// A bit of data flash that selects the divider by which the pack's voltage reaches the converter.
#[derive(Clone, Debug)]
pub struct External {
    /// The byte: subclass and offset.
    pub byte: (u8, u16),
    /// Set for the external divider.
    pub mask: u8,
    /// TI's name of the bit.
    pub name: &'static str,
    /// By how much Voltage() is multiplied while the bit is set; `None` where no source gives it.
    pub factor: Option<u32>,
}

impl Register {
    /// A row of a manual's table: address, size and sign, name, unit, tier.
    pub const fn new(code: u8, kind: Type, name: &'static str, unit: &'static str, tier: Tier) -> Self {
        let source = Source::Command(code);
        let signed = matches!(kind, Type::I(_));
        let text = matches!(kind, Type::S(_));
        let size = kind.size() as u8;
        Self {
            source,
            size,
            signed,
            text,
            name,
            unit,
            tier,
            role: None,
            step: (1, 1),
            discharge: false,
            positive: 0,
            empty: 0,
            values: Values::ALL,
            validity: None,
            other: None,
            bits: &[],
            tells_all: false,
        }
    }

    /// A row that is the answer to a subcommand.
    pub const fn answer(code: u16, kind: Type, name: &'static str, unit: &'static str, tier: Tier) -> Self {
        Self { source: Source::Answer(code), ..Self::new(0, kind, name, unit, tier) }
    }

    /// A row that is some bytes of the answer to a subcommand.
    pub const fn within(
        code: u16,
        at: u8,
        kind: Type,
        name: &'static str,
        unit: &'static str,
        tier: Tier,
    ) -> Self {
        Self { source: Source::Within(code, at), ..Self::new(0, kind, name, unit, tier) }
    }

    /// The property it feeds.
    #[must_use]
    pub const fn role(mut self, role: Role) -> Self {
        self.role = Some(role);
        self.values = role.values();
        self
    }

    /// The readings that are values, where they are others than its property's.
    #[must_use]
    pub const fn values(mut self, least: i64, greatest: i64, source: &'static str) -> Self {
        self.values = Values { least, greatest, source };
        self
    }

    /// The register that is 0 while the reading is not valid.
    #[must_use]
    pub const fn valid_by(mut self, code: u8) -> Self {
        self.validity = Some(Source::Command(code));
        self
    }

    /// One step in the unit of its role.
    #[must_use]
    pub const fn step(mut self, numerator: i64, denominator: i64) -> Self {
        self.step = (numerator, denominator);
        self
    }

    /// It measures discharges only, and has no sign.
    #[must_use]
    pub const fn of_discharges(mut self) -> Self {
        self.discharge = true;
        self
    }

    /// The bit of the flags without which it is negative.
    #[must_use]
    pub const fn positive(mut self, bit: u32) -> Self {
        self.positive = bit;
        self
    }

    /// The bit of the flags without which a reading of 0 is no value.
    #[must_use]
    pub const fn empty(mut self, bit: u32) -> Self {
        self.empty = bit;
        self
    }

    /// What it feeds in its place while that bit of another register is set.
    #[must_use]
    pub const fn or(mut self, bit: (u8, u32), role: Role, step: (i64, i64)) -> Self {
        self.other = Some(Other { bit: (Source::Command(bit.0), bit.1), role, step });
        self
    }

    /// Its bits without a name are told by their numbers.
    #[must_use]
    pub const fn tells_all(mut self) -> Self {
        self.tells_all = true;
        self
    }

    /// Names of its bits.
    #[must_use]
    pub const fn bits(mut self, bits: &'static [Bit]) -> Self {
        self.bits = bits;
        self
    }
}

impl Register {
    /// The bits that are set in a word of flags, by name. Of the answers of a Smart Battery's gauge one without a name is
    /// told as well: firmware is newer than documents.
    pub fn set(&self, word: i64) -> Vec<String> {
        let is_set = |mask: u32| word & i64::from(mask) != 0;
        let mut set: Vec<_> =
            self.bits.iter().filter(|bit| is_set(bit.mask)).map(|bit| bit.name.to_string()).collect();
        if self.tells_all {
            let named = self.bits.iter().fold(0, |all, bit| all | i64::from(bit.mask));
            let others = (0..8 * u32::from(self.size)).filter(|number| word & !named & 1 << number != 0);
            set.splice(0..0, others.map(|number| format!("bit {number}")).collect::<Vec<_>>());
        }
        set
    }

    /// A reading in that fraction of the unit of its role, without the rest.
    pub fn in_unit(&self, value: i64, fraction: i64) -> i64 {
        in_steps(value, fraction, self.step)
    }

    /// A reading in that fraction of the unit of a role that it may feed in another mode, without the rest.
    pub fn in_unit_of(&self, role: Role, value: i64, fraction: i64) -> i64 {
        let other = self.other.filter(|other| other.role == role);
        in_steps(value, fraction, other.map_or(self.step, |other| other.step))
    }

    /// Whether it feeds a property now, as the register of its mode shows; `None` while that is not known.
    pub fn feeds(&self, role: Role, word: impl Fn(Source) -> Option<i64>) -> Option<bool> {
        let Some(Other { bit: (source, mask), role: other, .. }) = self.other else {
            return Some(self.role == Some(role));
        };
        let is_set = word(source)? & i64::from(mask) != 0;
        Some(if is_set { other == role } else { self.role == Some(role) })
    }
}

fn in_steps(value: i64, fraction: i64, (numerator, denominator): (i64, i64)) -> i64 {
    value * fraction * numerator / denominator
}

impl Bit {
    /// A row of a manual's bit table.
    pub const fn new(mask: u32, name: &'static str) -> Self {
        Self { mask, name }
    }
}

impl Subcommand {
    /// A subcommand that a sealed gauge also accepts.
    pub const fn new(code: u16, name: &'static str, effect: Effect) -> Self {
        Self { code, name, sealed: true, effect }
    }

    /// A sealed gauge does not accept it.
    #[must_use]
    pub const fn unsealed(mut self) -> Self {
        self.sealed = false;
        self
    }
}

impl Chip {
    /// What it takes at that clock of the bus, where the clock is known: above a limit one byte a write.
    pub fn reach_at(&self, clock_hz: Option<u32>) -> Reach {
        match self.byte_writes_above_hz.zip(clock_hz) {
            Some((limit_hz, clock_hz)) if clock_hz > limit_hz => Reach::ONE_BYTE_A_WRITE,
            _ => Reach::FULL,
        }
    }

    /// Every chip: those with a table, those with standard commands only, the Smart Battery, and TI's gauges in one.
    pub fn all() -> impl Iterator<Item = &'static Chip> {
        CHIPS
            .iter()
            .copied()
            .chain(kernel::GAUGES.iter().copied())
            .chain([&sbs::CHIP])
            .chain(sbs::ti::GAUGES.iter().copied())
    }

    /// The chip of that name on the command line, or else of that name in the kernel's driver or in TI's documents.
    pub fn by_name(name: &str) -> Option<&'static Chip> {
        let found = Self::all().find(|chip| chip.name.eq_ignore_ascii_case(name));
        found.or_else(|| kernel::by_driver_name(name)).or_else(|| kernel::by_whole_name(name))
    }

    /// Finds a chip by TI's name for it, as `model_name` shows it: `bq34z100-G1`.
    pub fn by_model(model: &str) -> Option<&'static Chip> {
        Self::all().find(|chip| chip.model == model)
    }

    /// Whether it has a full table. Without one nothing is written: Control()'s address may be another register's.
    pub fn has_table(&self) -> bool {
        !matches!(self.access.scheme, Scheme::None | Scheme::Smbus)
    }

    /// What brings the part back from ROM mode.
    pub fn way_out_of_rom(&self) -> &'static str {
        match self.firmware_file {
            Some(_) => "`gaugefs rescue` brings it back",
            None => {
                "gaugefs does not bring it back, because no whole firmware file of the part is known with which one could be \
                 compared before flash is erased; TI's tools do, with the .bq.fs of its firmware"
            }
        }
    }

    /// Why nothing is written to it, if it has no table.
    pub fn only_read(&self) -> &'static str {
        match self.access.scheme {
            Scheme::Smbus => "a Smart Battery is only read",
            _ => "only its standard commands are known, so nothing is written to it",
        }
    }

    /// The register that distinguishes packs. A chemistry ID is no serial number.
    pub fn serial_register(&self) -> Option<&'static Register> {
        self.register_at(self.preflight.pack.as_ref()?.word)
    }

    /// The register of a source.
    pub fn register_at(&self, source: Source) -> Option<&'static Register> {
        self.registers.iter().find(|register| register.source == source)
    }

    /// The register that feeds a property, at least in some mode.
    pub fn register(&self, role: Role) -> Option<&'static Register> {
        let feeds = |register: &&Register| {
            register.role == Some(role) || register.other.is_some_and(|other| other.role == role)
        };
        self.registers.iter().find(feeds)
    }

    /// The parameter that feeds a property, with its subclass.
    pub fn stored(&self, role: Role) -> Option<(&'static Subclass, &'static Parameter)> {
        let rows = |row: &'static Subclass| row.parameters.iter().map(move |parameter| (row, parameter));
        self.subclasses.iter().flat_map(rows).find(|(_, parameter)| parameter.role == Some(role))
    }

    /// The places in data flash (subclass, offset) of properties, signatures, quirks and scales.
    pub fn places(&self) -> impl Iterator<Item = (u8, u16)> + '_ {
        let rows = |row: &'static Subclass| row.parameters.iter().map(move |parameter| (row.id, parameter));
        let stored = self.subclasses.iter().flat_map(rows).filter(|(_, parameter)| parameter.role.is_some());
        let stored = stored.map(|(id, parameter)| (id, parameter.offset));
        let primary = self.condition.primary.iter().flat_map(|primary| [primary.alerts, primary.mode]);
        let signature = self.signature.iter().map(|row| (row.subclass, row.offset));
        let quirks = self.quirks.iter().map(|quirk| (quirk.subclass, quirk.offset));
        stored.chain(primary).chain(signature).chain(quirks).chain(self.scaling.in_flash())
    }

    /// The folder of a subclass in `df/by-name`: its name, after the manual's class if that name occurs in two classes.
    pub fn class_dir(&self, subclass: &Subclass) -> String {
        let name = kebab_case(subclass.name);
        let mut others = self.subclasses.iter().filter(|other| other.class != subclass.class);
        let is_shared = others.any(|other| names::is_named(other.name, &name));
        if is_shared { format!("{}-{name}", kebab_case(subclass.class)) } else { name }
    }

    /// The groups of a flat address space that share a folder, by address; a subclass with an id of its own alone.
    pub fn class_of(&self, subclass: &Subclass) -> impl Iterator<Item = (usize, &'static Subclass)> + use<> {
        let (class, name) = (subclass.class, subclass.name);
        let all = self.subclasses.iter().enumerate();
        all.filter(move |(_, other)| other.class == class && other.name == name)
    }

    /// The first group of each folder in `df/by-name`.
    pub fn classes(&'static self) -> impl Iterator<Item = (usize, &'static Subclass)> {
        let is_first = |(at, row): &(usize, &'static Subclass)| {
            self.class_of(row).next().is_some_and(|(first, _)| first == *at)
        };
        self.subclasses.iter().enumerate().filter(is_first)
    }

    /// The subclass of that id.
    pub fn subclass(&self, id: u8) -> Option<&'static Subclass> {
        self.subclasses.iter().find(|subclass| subclass.id == id)
    }

    /// The subcommand of that code.
    pub fn subcommand(&self, code: u16) -> Option<&'static Subcommand> {
        self.subcommands.iter().find(|subcommand| subcommand.code == code)
    }

    /// The row at `df/SUBCLASS/OFFSET`; on a part without subclasses, `flash` and an address in hexadecimal.
    pub fn row(&self, subclass: &str, offset: &str) -> Option<(&'static Subclass, &'static Parameter)> {
        let is_hex = |text: &str| text.starts_with("0x");
        let id = match subclass {
            "flash" if is_hex(offset) => FLAT,
            id if !is_hex(id) && !is_hex(offset) => text::unsigned(id)?,
            _ => return None,
        };
        let offset: u16 = text::unsigned(offset)?;
        let mut alike = self.subclasses.iter().filter(|row| row.id == id);
        alike.find_map(|row| Some((row, row.parameter(offset)?)))
    }

    /// With what a value stays when packs are exchanged, or a configuration is copied.
    pub fn stays(&self, (subclass, parameter): Row) -> Stays {
        match subclass.class {
            "Calibration" => Stays::Board,
            _ if subclass.is_chemistry() => Stays::Cell,
            _ if parameter.learned => Stays::Pack,
            _ => Stays::Design,
        }
    }

    /// The parameter at an offset of the subclass of that id, or with [`FLAT`] at an address.
    pub fn parameter(&self, id: u8, offset: u16) -> Option<&'static Parameter> {
        let alike = self.subclasses.iter().filter(|subclass| subclass.id == id);
        alike.filter_map(|subclass| subclass.parameter(offset)).next()
    }
}
