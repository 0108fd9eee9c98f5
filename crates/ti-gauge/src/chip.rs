//! A chip is a table: the types of its rows, and the list of all chips.
//!
//! Rows keep the manual's columns and order, so that a reviewer checks them with the manual open
//! alongside. No code asks which chip it has: a difference between chips is a field here.

use std::time::Duration;

use crate::value::Type;

pub mod bq27220;
pub mod bq27421_g1;
pub mod bq27426;
pub mod bq27427;
pub mod bq27441_g1;
pub mod bq27520_g3;
pub mod bq27621_g1;
pub mod bq34110;
pub mod bq34z100_g1;
pub mod bq34z100_r2;
pub mod bq35100;
pub mod kernel;

mod identity;
mod names;
mod parameter;
mod preflight;
mod recognise;

pub use identity::{Answers, Identity, SIBLINGS, Sibling, Signature};
pub use names::{kebab_case, snake_case};
pub use parameter::{FLAT, Kind, Parameter, Range, Safe, Subclass};
pub use preflight::{Learning, Mode, Pack, Preflight, Word};
pub use recognise::{Limited, Recognised, recognise};

/// Every chip that has a table, in the order of the README. The others are in [`kernel::GAUGES`].
pub static CHIPS: &[&Chip] = &[
    &bq34z100_g1::CHIP,
    &bq34z100_r2::CHIP,
    &bq27520_g3::CHIP,
    &bq27441_g1::CHIP,
    &bq27421_g1::CHIP,
    &bq27426::CHIP,
    &bq27427::CHIP,
    &bq27220::CHIP,
    &bq27621_g1::CHIP,
    &bq34110::CHIP,
    &bq35100::CHIP,
];

/// One fuel gauge: everything in which parts differ.
#[derive(Debug)]
pub struct Chip {
    /// Name on the command line: TI's, lower case.
    pub name: &'static str,
    /// Name as TI prints it, shown as `model_name`.
    pub model: &'static str,
    /// The documents behind the table, with revision.
    pub documents: &'static [&'static str],
    /// How far the table has been checked.
    pub evidence: Evidence,
    /// The answers that identify the part.
    pub identity: Identity,
    /// How a firmware file of the part is recognised, for a gauge that is left in ROM mode; `None` where no source shows
    /// a whole one.
    pub rom: Option<Rom>,
    /// Chemistry as the kernel names it, where the part allows only one; else `Unknown`.
    pub technology: &'static str,
    /// Standard commands, by address.
    pub registers: &'static [Register],
    /// Control() subcommands, by code.
    pub subcommands: &'static [Subcommand],
    /// CONTROL_STATUS bits.
    pub control_status: &'static [Bit],
    /// What the flags mean to a power_supply.
    pub condition: Condition,
    /// The registers that hold scales of measured values.
    pub scale_registers: ScaleRegisters,
    /// How the seal state is read and changed.
    pub security: Security,
    /// How data flash is read and written, with the delays.
    pub access: Access,
    /// The voltage that a data-flash write needs.
    pub gate: Option<Gate>,
    /// SHA-1 authentication at AuthenticateData(); `None` where no source has the part's sequence.
    pub authentication: Option<Authentication>,
    /// Data flash, in the manual's order.
    pub subclasses: &'static [Subclass],
    /// Single-byte writes only above this bus clock; `None` where the manual says nothing.
    pub byte_writes_above_hz: Option<u32>,
    /// Values that data flash must hold before the first write, for parts whose offsets differ between
    /// firmwares. Empty where [`Identity`] is enough.
    pub signature: &'static [Signature],
    /// `[ITPOR]`, the flag that is set after data memory in RAM has reverted to its defaults; 0 where no flag
    /// shows that, and `None` where it is flash.
    pub volatile: Option<u16>,
    /// Known defects of some parts as shipped, and their remedies.
    pub quirks: &'static [Quirk],
    /// What is checked before a write.
    pub preflight: Preflight,
}

/// How far a table or a row has been checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// Printed in TI's manual for this part.
    Manual,
    /// Also seen in byte-level transcripts of this part.
    Transcript,
    /// Inferred from a sibling or from one driver only: read-only unless the user insists.
    Unproven,
}

/// The Device Name in the data flash of a firmware file. Only that and the version of the firmware show which part a
/// file is for.
#[derive(Debug)]
pub struct Rom {
    /// Index of its length byte in the 32 rows.
    pub name: usize,
    /// What TI's files have there. A user may have changed it.
    pub names: &'static [&'static str],
}

/// A defect of some parts that a byte of data flash reveals.
#[derive(Debug)]
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
    /// With every tenth poll, for `gauge/registers`.
    Slow,
    /// When the gauge is opened: copies of data flash.
    Static,
    /// Only on request: Control() and the block-access window.
    Window,
}

/// The power_supply property that a register feeds. Units are those before [`ScaleRegisters`] apply.
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
    /// `energy_now`, mWh.
    EnergyNow,
    /// `power_avg`, mW.
    PowerAvg,
    /// `cycle_count`.
    CycleCount,
    /// `state_of_health`, %.
    StateOfHealth,
    /// The flags that `status`, `health` and `capacity_level` follow from.
    Flags,
}

/// A standard command.
#[derive(Debug)]
pub struct Register {
    /// Address of its least significant byte.
    pub code: u8,
    /// Bytes.
    pub size: u8,
    /// Whether the value is two's complement.
    pub signed: bool,
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
    /// The bit of the flags that is clear while the value is negative, where the register itself has no sign; else 0.
    pub positive: u16,
    /// The bit of the flags that is set while a reading of 0 is a value; 0 where it always is one.
    pub empty: u16,
    /// Names of its bits, if it is a flag word.
    pub bits: &'static [Bit],
}

/// A named bit of a flag word. Reserved bits have no entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bit {
    /// The bit's mask.
    pub mask: u16,
    /// TI's name.
    pub name: &'static str,
}

/// A Control() subcommand.
#[derive(Debug)]
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
#[derive(Debug)]
pub struct Condition {
    /// Fully charged.
    pub full: u16,
    /// Below the first, higher threshold of remaining capacity.
    pub low: u16,
    /// Below the final threshold.
    pub critical: u16,
    /// Over temperature.
    pub overheat: u16,
    /// Under temperature.
    pub cold: u16,
    /// Set while a battery is present; 0 where the gauge does not detect it.
    pub present: u16,
    /// Set while the gauge asks for an update of its capacity; 0 where no flag does.
    pub uncertain: u16,
    /// The bit of CONTROL_STATUS that is set once values are valid after power-up or a reset; 0 where none is
    /// documented.
    pub complete: u16,
    /// A gauge for primary cells.
    pub primary: Option<Primary>,
}

/// A gauge for primary cells, which are never charged: `status` is `Discharging` while a current flows, whatever
/// its sign, and otherwise `Not charging`; never `Charging` or `Full`.
#[derive(Debug)]
pub struct Primary {
    /// The bit of CONTROL_STATUS that is set between GAUGE_START and GAUGE_STOP. Current() is measured only then.
    pub active: u16,
    /// The byte of data flash (subclass and offset) whose bits let the flags of [`Condition`] through.
    pub alerts: (u8, u16),
    /// The byte of data flash that holds the mode.
    pub mode: (u8, u16),
    /// The mode's bits in it.
    pub mode_mask: u8,
    /// The modes in which the gauge computes StateOfHealth().
    pub health_modes: &'static [u8],
}

/// The polled registers by whose values the host multiplies those of others; `None` where the part has none. A
/// configured gauge has no 0 in them. Parameters of data flash are in the units of the registers.
#[derive(Debug)]
pub struct ScaleRegisters {
    /// Of voltages.
    pub voltage: Option<u8>,
    /// Of currents and charges.
    pub current: Option<u8>,
    /// Of energies and powers.
    pub energy: Option<u8>,
}

impl ScaleRegisters {
    /// The part has none.
    pub const NONE: Self = Self { voltage: None, current: None, energy: None };
}

/// Seal states and keys.
#[derive(Debug)]
pub struct Security {
    /// Where the seal state is read.
    pub status: SealStatus,
    /// The manual's default unseal key, in the order it is sent.
    pub default_unseal: [u16; 2],
    /// Whether there is a FULL ACCESS state above UNSEALED.
    pub full_access: bool,
    /// Subcommand that seals.
    pub seal: u16,
    /// Time without traffic that the gauge needs before it accepts keys after a refusal. The manuals print 4 s
    /// (10 s for the bq35100), which is measured by the gauge's clock, so there is a margin.
    pub key_silence: Duration,
    /// Where the keys are stored, for changing them.
    pub storage: KeyStorage,
}

/// Where and how a part stores its keys.
#[derive(Debug)]
pub enum KeyStorage {
    /// Changing them is not supported; the text gives the reason.
    Fixed(&'static str),
    /// Together in one block of data flash.
    Flash(KeyBlock),
}

/// The part of a block that holds only keys. Positions count from its first byte.
#[derive(Debug)]
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
    /// The authentication key, most significant byte first; `None` where there is none that can be tested.
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
#[derive(Debug)]
pub enum SealStatus {
    /// In CONTROL_STATUS: a bit that is set while SEALED, a bit that is set while not in FULL ACCESS.
    Bits {
        /// `[SS]`.
        sealed: u16,
        /// `[FAS]`; 0 where there is no FULL ACCESS.
        not_full_access: u16,
    },
    /// A two-bit field of the CONTROL_STATUS word or of a register: 11 SEALED, 10 UNSEALED, 01 FULL ACCESS.
    Field {
        /// Register that holds the field; `None` for CONTROL_STATUS.
        register: Option<u8>,
        /// The lower of the two bits.
        shift: u8,
    },
    /// Nowhere: the part has none, or no table says where.
    None,
}

/// How data flash is accessed, and the delays that this needs. No delay is optional; the table gives the
/// source of each.
#[derive(Debug)]
pub struct Access {
    /// The sequence that reads and writes a block.
    pub scheme: Scheme,
    /// From selecting a block until its bytes are in the window.
    pub select: Duration,
    /// From the checksum that commits until the gauge has stored the block.
    pub commit: Duration,
    /// From SET_CFGUPDATE until `[CFGUPMODE]` is first polled.
    pub enter: Duration,
    /// For how long `[CFGUPMODE]` is polled.
    pub enter_limit: Duration,
    /// From RESET, or SOFT_RESET, until the gauge is first polled for an answer.
    pub reset: Duration,
    /// For how long it is polled for an answer.
    pub reset_limit: Duration,
}

/// The sequences by which TI's gauges give access to data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Unsealed block access: BlockDataControl, DataFlashClass, DataFlashBlock, a 32-byte window, and a
    /// checksum that commits.
    Block,
    /// The same between SET_CFGUPDATE and SOFT_RESET; data memory is RAM.
    CfgUpdate,
    /// ManufacturerAccessControl: a flat address, data, MACDataSum and MACDataLen.
    Mac,
    /// The same in FULL ACCESS, between ENTER_CFG_UPDATE and EXIT_CFG_UPDATE_REINIT; data memory is RAM.
    MacUpdate,
    /// None: only the standard commands are known.
    None,
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
    /// No access to data flash, and so no delays.
    pub const NONE: Self = Self {
        scheme: Scheme::None,
        select: Duration::ZERO,
        commit: Duration::ZERO,
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        reset: Duration::ZERO,
        reset_limit: Duration::ZERO,
    };
}

impl Security {
    /// No seal state. [`Gauge`](crate::gauge::Gauge) sends neither keys nor the subcommand to a chip without a
    /// table.
    pub const NONE: Self = Self {
        status: SealStatus::None,
        default_unseal: [0; 2],
        full_access: false,
        seal: 0,
        key_silence: Duration::ZERO,
        storage: KeyStorage::Fixed("no table describes its keys"),
    };
}

/// The delays of SHA-1 authentication, each with its source in the table.
#[derive(Debug)]
pub struct Authentication {
    /// From the challenge until its checksum may follow.
    pub challenge: Duration,
    /// From the checksum until the digest is in AuthenticateData().
    pub digest: Duration,
}

/// The voltage below which the gauge acknowledges a flash write but stores nothing.
#[derive(Debug)]
pub struct Gate {
    /// Parameter that holds the limit in mV, two bytes and signed: subclass and offset. 0 opens the gate.
    pub limit: (u8, u16),
    /// Parameter of two bytes to which Voltage() is proportional: the voltage at the full scale of the converter.
    pub divider: Option<(u8, u16)>,
    /// The divider at which Voltage() is a cell's, if the limit applies to Voltage() scaled back to it as well;
    /// `None` where it applies to Voltage() only.
    pub cell_divider: Option<u32>,
    /// The bit that switches off the internal divider.
    pub external: Option<External>,
    /// Parameter of one byte that holds the number of cells in series, where the limit is a cell's by its name.
    pub cells: Option<(u8, u16)>,
    /// Register of two bytes and its bit that is set while calibration is enabled. The gate is open then.
    pub calibration: Option<(u8, u16)>,
}

/// A bit of data flash that selects the divider by which the pack's voltage reaches the converter.
#[derive(Debug)]
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
        let signed = matches!(kind, Type::I(_));
        let size = kind.size() as u8;
        Self {
            code,
            size,
            signed,
            name,
            unit,
            tier,
            role: None,
            step: (1, 1),
            positive: 0,
            empty: 0,
            bits: &[],
        }
    }

    /// The property it feeds.
    #[must_use]
    pub const fn role(mut self, role: Role) -> Self {
        self.role = Some(role);
        self
    }

    /// One step in the unit of its role.
    #[must_use]
    pub const fn step(mut self, numerator: i64, denominator: i64) -> Self {
        self.step = (numerator, denominator);
        self
    }

    /// The bit of the flags without which it is negative.
    #[must_use]
    pub const fn positive(mut self, bit: u16) -> Self {
        self.positive = bit;
        self
    }

    /// The bit of the flags without which a reading of 0 is no value.
    #[must_use]
    pub const fn empty(mut self, bit: u16) -> Self {
        self.empty = bit;
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
    /// A reading in that fraction of the unit of its role, without the rest.
    pub fn in_unit(&self, value: i64, fraction: i64) -> i64 {
        let (numerator, denominator) = self.step;
        value * fraction * numerator / denominator
    }
}

impl Bit {
    /// A row of a manual's bit table.
    pub const fn new(mask: u16, name: &'static str) -> Self {
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
    /// Whether it takes only one byte per write at that clock of the bus, where the clock is known.
    pub fn is_slower_than(&self, clock_hz: Option<u32>) -> bool {
        self.byte_writes_above_hz.zip(clock_hz).is_some_and(|(limit_hz, clock_hz)| clock_hz > limit_hz)
    }

    /// Every chip: those with a table, then those of which only the standard commands are known.
    pub fn all() -> impl Iterator<Item = &'static Chip> {
        CHIPS.iter().copied().chain(kernel::GAUGES.iter().copied())
    }

    /// The chip of that name on the command line, or else of that name in the kernel's driver.
    pub fn by_name(name: &str) -> Option<&'static Chip> {
        let found = Self::all().find(|chip| chip.name.eq_ignore_ascii_case(name));
        found.or_else(|| kernel::by_driver_name(name))
    }

    /// Whether a table describes more than its standard commands. Without one nothing is ever written to the
    /// gauge, not even a subcommand: there may be another register at the address of Control().
    pub fn has_table(&self) -> bool {
        self.access.scheme != Scheme::None
    }

    /// The register at an address.
    pub fn register_at(&self, code: u8) -> Option<&'static Register> {
        self.registers.iter().find(|register| register.code == code)
    }

    /// The register that feeds a property.
    pub fn register(&self, role: Role) -> Option<&'static Register> {
        self.registers.iter().find(|register| register.role == Some(role))
    }

    /// The folder of a subclass in `df/by-name`: its name, preceded by the manual's class if two subclasses
    /// have the same name.
    pub fn class_dir(&self, subclass: &Subclass) -> String {
        let name = kebab_case(subclass.name);
        let alike = self.subclasses.iter().filter(|other| kebab_case(other.name) == name).count();
        if alike > 1 { format!("{}-{name}", kebab_case(subclass.class)) } else { name }
    }

    /// The subclass of that id.
    pub fn subclass(&self, id: u8) -> Option<&'static Subclass> {
        self.subclasses.iter().find(|subclass| subclass.id == id)
    }

    /// The parameter at `df/SUBCLASS/OFFSET` and its subclass; on a part without subclasses, `flash` and an
    /// address in hexadecimal.
    pub fn row(&self, subclass: &str, offset: &str) -> Option<(&'static Subclass, &'static Parameter)> {
        let (id, offset) = match (subclass, offset.strip_prefix("0x")) {
            ("flash", Some(digits)) => (FLAT, u16::from_str_radix(digits, 16).ok()?),
            (id, _) => (id.parse().ok()?, offset.parse().ok()?),
        };
        let mut alike = self.subclasses.iter().filter(|row| row.id == id);
        alike.find_map(|row| Some((row, row.parameter(offset)?)))
    }

    /// The parameter at an offset of the subclass of that id, or with [`FLAT`] at an address.
    pub fn parameter(&self, id: u8, offset: u16) -> Option<&'static Parameter> {
        let alike = self.subclasses.iter().filter(|subclass| subclass.id == id);
        alike.filter_map(|subclass| subclass.parameter(offset)).next()
    }
}
