//! A chip is a table: the vocabulary in which one is written, and the list of them.
//!
//! Rows keep the manual's columns and order, so that a reviewer checks them with the manual open
//! alongside. No code asks which chip it has: a difference between chips is a field here.

use std::time::Duration;

use crate::codec::WINDOW;
use crate::value::Type;

pub mod bq27421_g1;
pub mod bq27427;
pub mod bq27441_g1;
pub mod bq27520_g3;
pub mod bq34110;
pub mod bq34z100_g1;
pub mod bq35100;

/// Every chip that gaugefs knows, in the order of the README.
pub static CHIPS: &[&Chip] = &[
    &bq34z100_g1::CHIP,
    &bq27520_g3::CHIP,
    &bq27441_g1::CHIP,
    &bq27421_g1::CHIP,
    &bq27427::CHIP,
    &bq34110::CHIP,
    &bq35100::CHIP,
];

/// Known parts that no table covers and that could be taken for one of [`CHIPS`].
pub static SIBLINGS: &[Sibling] = &[
    // The data flash of firmware 2.02 has other offsets from 31 of subclass 48 on (SLUUCO5A).
    Sibling::new("bq34z100-R2", 0x0100, &[0x0202], &[], Some(&bq34z100_g1::CHIP)),
    // The generations differ in firmware only, which can be exchanged. The first has no CycleCount() in
    // the kernel's driver, the last another map of commands; 6.04 is a product's build of it.
    Sibling::new("bq27520-G1", 0x0520, &[0x0302], &[], None),
    Sibling::new("bq27520-G2", 0x0520, &[0x0311], &[], Some(&bq27520_g3::CHIP)),
    Sibling::new("bq27520-G4", 0x0520, &[0x0329, 0x0604], &[], None),
    // Same State block in the kernel's driver, the rest of its data memory unknown.
    Sibling::new("bq27426", 0x0426, &[], &[], Some(&bq27427::CHIP)),
    // A shipped driver (Chromium's) knows the type; its State block is another.
    Sibling::new("bq27621-G1", 0x0621, &[], &[], None),
    // Firmware 1.09 like its sisters; codes from SLUSBN7D. Its configuration is in one-time programmable
    // memory.
    Sibling::new("bq27411-G1", 0x0421, &[0x0109], &[0x80, 0x90, 0xA0], Some(&bq27441_g1::CHIP)),
];

/// One fuel gauge: everything that tells it from another.
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
    /// What the gauge answers when asked who it is.
    pub identity: Identity,
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
    /// How seal, unseal and full access are told and reached.
    pub security: Security,
    /// How data flash is reached and committed, with its waits.
    pub access: Access,
    /// What a data-flash write needs first.
    pub gate: Option<Gate>,
    /// SHA-1 authentication at AuthenticateData(); `None` where no source has the part's sequence.
    pub authentication: Option<Authentication>,
    /// Data flash, in the manual's order.
    pub subclasses: &'static [Subclass],
    /// Single-byte writes only above this bus clock; `None` where the manual says nothing.
    pub byte_writes_above_hz: Option<u32>,
    /// What data flash looks like where offsets moved between firmwares: all of it has to fit before
    /// the first write. Empty where the answers to [`Identity`] are enough.
    pub signature: &'static [Signature],
    /// The flag that tells that data memory has its defaults again, where it is RAM: `[ITPOR]`.
    pub volatile: Option<u16>,
    /// What is wrong with some parts as they leave the factory, and what helps.
    pub quirks: &'static [Quirk],
    /// What is looked at before anything is written.
    pub preflight: Preflight,
}

/// How far anyone has checked a table or a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// Printed in TI's manual for this part.
    Manual,
    /// Seen in byte-level transcripts of this part as well.
    Transcript,
    /// Inferred from a sibling or from one driver only: read-only unless the user insists.
    Unproven,
}

/// The answers that identify a part.
#[derive(Debug)]
pub struct Identity {
    /// Control(DEVICE_TYPE).
    pub device_type: u16,
    /// Control(FW_VERSION) values the table was made for; empty where none is known and any is taken.
    pub firmware: &'static [u16],
    /// Control(HW_VERSION), where it tells colliding device types apart.
    pub hardware: Option<u16>,
    /// Control(DM_CODE) values, where they tell colliding device types apart; empty for any that no
    /// other part has.
    pub dm_codes: &'static [u16],
    /// Where the answers to DEVICE_TYPE and its like are read.
    pub answer: u8,
}

/// What a part answered when it was asked who it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Answers {
    /// Control(DEVICE_TYPE).
    pub device_type: u16,
    /// Control(FW_VERSION).
    pub firmware_version: u16,
    /// Control(HW_VERSION); 0 where the part does not have it.
    pub hardware_version: u16,
    /// Control(CHEM_ID), where the part has it.
    pub chem_id: Option<u16>,
    /// Control(DM_CODE), where the part has it.
    pub dm_code: Option<u16>,
}

/// A part without a table of its own, which answers to some of the same questions as one with.
#[derive(Debug)]
pub struct Sibling {
    /// TI's name.
    pub name: &'static str,
    /// What it answers.
    pub identity: Identity,
    /// The chip whose standard commands it shares; `None` where the same addresses mean something else,
    /// so that every number would be wrong.
    pub like: Option<&'static Chip>,
}

/// What follows from the answers of a part.
#[derive(Debug)]
pub enum Recognised {
    /// A chip with a table.
    Chip(&'static Chip),
    /// A known part without one: its standard commands may be read, its data flash is out of bounds.
    Sibling(&'static Sibling),
    /// Several chips answer so; only the user can tell.
    Ambiguous(Vec<&'static Chip>),
    /// No part that is known.
    Unknown,
}

/// A parameter that has to hold a plausible value before anything is written.
#[derive(Debug)]
pub struct Signature {
    /// Subclass id.
    pub subclass: u8,
    /// Offset in the subclass.
    pub offset: u16,
    /// Type; of an `F4` the bytes are compared, as an `H4`.
    pub kind: Type,
    /// Smallest plausible value.
    pub min: i64,
    /// Largest plausible value.
    pub max: i64,
}

/// A flaw of some parts that shows in a byte of data flash.
#[derive(Debug)]
pub struct Quirk {
    /// Subclass id.
    pub subclass: u8,
    /// Offset of the byte in the subclass.
    pub offset: u16,
    /// The bits that tell.
    pub mask: u8,
    /// Their value on a part with the flaw.
    pub wrong: u8,
    /// What the flaw does.
    pub effect: &'static str,
    /// What helps.
    pub remedy: &'static str,
}

/// What is looked at before anything is written, beside identity, gate and seal.
#[derive(Debug)]
pub struct Preflight {
    /// What tells a pack from another one with the same part; `None` where nothing is known that does.
    pub pack: Option<Pack>,
    /// Modes that somebody else may have left on.
    pub modes: &'static [Mode],
    /// How a cycle of learning shows that a reset would throw away; `None` where nothing tells for sure.
    pub learning: Option<Learning>,
    /// Voltage() between which the part works, where no [`Gate`] watches.
    pub voltage_mv: Option<(u16, u16)>,
}

/// A word of the gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// CONTROL_STATUS, which is read for the seal in any case.
    ControlStatus,
    /// A standard command of two bytes.
    Register(u8),
    /// What a subcommand answers.
    Answer(u16),
}

/// A word that differs from pack to pack.
#[derive(Debug)]
pub struct Pack {
    /// The word. A register, read alone, also tells parts of another type apart, which have something else
    /// at its address.
    pub word: Word,
    /// Its name in a message.
    pub name: &'static str,
    /// Subclass and offset of the rows that it follows from: whoever writes those changes it.
    pub rows: &'static [(u8, u16)],
}

/// A mode in which a write would be lost, or would disturb whoever began it.
#[derive(Debug)]
pub struct Mode {
    /// The word that shows it. A subcommand is asked only once the gauge is unsealed.
    pub word: Word,
    /// The bit that is set meanwhile.
    pub mask: u16,
    /// Where that stands, in a message.
    pub name: &'static str,
    /// What goes on.
    pub what: &'static str,
    /// What helps.
    pub remedy: &'static str,
    /// Whether our own transactions begin it too, so that one that was cut short can have left it on.
    pub ours: bool,
}

/// A cycle of learning.
#[derive(Debug)]
pub struct Learning {
    /// CONTROL_STATUS bits that are all set meanwhile.
    pub status: u16,
    /// Subclass and offset of Update Status, the byte that tells a first cycle from what goes on in a finished
    /// pack for ever. Writing it alone is how a cycle is begun and ended by hand.
    pub row: (u8, u16),
    /// A standard command that shows the same bits without unsealing.
    pub register: Option<u8>,
    /// Its bits that tell.
    pub mask: u8,
    /// Their value until the cycle has come to its end.
    pub value: u8,
    /// Both, in a message.
    pub name: &'static str,
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
    /// Never by itself: Control() and the block-access window.
    Window,
}

/// The power_supply property that a register feeds.
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
    /// `time_to_full_now`, min.
    TimeToFullNow,
    /// `energy_now`, mWh before the user's energy scale.
    EnergyNow,
    /// `power_avg`, mW before the same scale.
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
    /// Names of its bits, where it is a word of flags.
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
    /// Whether a sealed gauge takes it.
    pub sealed: bool,
    /// What sending it does.
    pub effect: Effect,
}

/// What a subcommand does, and so who may send it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Answers with a word and changes nothing.
    Answers,
    /// Changes the gauge's state in a way that the user may ask for through `gauge/control`.
    Safe,
    /// Has a guarded way of its own (seal, reset) and is refused in `gauge/control`.
    Guarded,
    /// Ruins, locks out or disturbs a gauge: never sent.
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
    /// Set while a battery is present; 0 where the gauge cannot tell.
    pub present: u16,
    /// A primary cell, which nobody charges: `status` is `Discharging` while a current flows, whatever its
    /// sign, and else `Not charging`; never `Charging` or `Full`.
    pub primary: bool,
}

/// Seal states and keys.
#[derive(Debug)]
pub struct Security {
    /// Where the seal state shows.
    pub status: SealStatus,
    /// The manual's default unseal key, in the order it is sent.
    pub default_unseal: [u16; 2],
    /// Whether there is a FULL ACCESS state above UNSEALED.
    pub full_access: bool,
    /// Subcommand that seals.
    pub seal: u16,
    /// Silence that the gauge wants before keys that it refused once.
    pub key_silence: Duration,
    /// Where the keys are kept, for whoever changes them.
    pub storage: KeyStorage,
}

/// Where and how a part keeps its keys.
#[derive(Debug)]
pub enum KeyStorage {
    /// They are not changed here, and why.
    Fixed(&'static str),
    /// Together in one block of data flash.
    Flash(KeyBlock),
}

/// The part of a block that holds keys and nothing else. Places count from its first byte.
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
    /// The authentication key, most significant byte first; `None` where there is none that can be tried.
    pub authentication: Option<usize>,
    /// How the two words of a key lie there.
    pub order: KeyOrder,
}

/// How two key words lie in data flash, beside the order in which they are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyOrder {
    /// All four bytes as they pass over the wire, reversed: the second word, then the first.
    Reversed,
    /// The first word, then the second, each with its most significant byte first.
    AsSent,
}

/// Where and how the seal state shows.
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
}

/// How data flash is reached, and the waits that go with it. None is optional; each names its source in
/// the table.
#[derive(Debug)]
pub struct Access {
    /// The sequence that reads and writes a block.
    pub scheme: Scheme,
    /// From selecting a block until its bytes stand in the window.
    pub select: Duration,
    /// From the checksum that commits until the gauge has stored the block.
    pub commit: Duration,
    /// From SET_CFGUPDATE until it is worth asking for `[CFGUPMODE]`, and how long to go on asking.
    pub enter: Duration,
    /// See `enter`.
    pub enter_limit: Duration,
    /// From RESET, or SOFT_RESET, until the gauge answers again, and how long to go on asking.
    pub reset: Duration,
    /// See `reset`.
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
}

/// The waits of SHA-1 authentication, each with its source in the table.
#[derive(Debug)]
pub struct Authentication {
    /// From the challenge until its checksum may follow.
    pub challenge: Duration,
    /// From the checksum until the digest stands in AuthenticateData().
    pub digest: Duration,
}

/// The voltage below which the gauge takes a flash write, acknowledges it and stores nothing.
#[derive(Debug)]
pub struct Gate {
    /// Parameter that holds the limit in mV a cell: subclass and offset.
    pub limit: (u8, u16),
    /// Parameter that holds the voltage divider, and the divider at which Voltage() is a cell's;
    /// `None` where the limit is compared with Voltage() itself.
    pub divider: Option<(u8, u16, u32)>,
}

/// The id of every group of a part with a flat address space, where offsets are addresses.
pub const FLAT: u8 = 0;

/// A subclass of data flash.
#[derive(Debug)]
pub struct Subclass {
    /// The manual's class, such as `Configuration`.
    pub class: &'static str,
    /// The manual's name, such as `IT Cfg`.
    pub name: &'static str,
    /// Subclass id; [`FLAT`] for a group of parameters of a part that addresses data flash directly.
    pub id: u8,
    /// Bytes from [`Subclass::start`] to the end of its last documented parameter.
    pub length: u16,
    /// What its parameters need and allow.
    pub kind: Kind,
    /// Its documented parameters, by offset.
    pub parameters: &'static [Parameter],
}

/// What a subclass needs and allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Takes effect for sure only after a reset.
    Reset,
    /// Only stored: no reset.
    Plain,
    /// Keys: never read, exported or shown; written only by a guarded way of its own.
    Security,
}

/// A documented data-flash parameter.
#[derive(Debug)]
pub struct Parameter {
    /// Offset in its subclass.
    pub offset: u16,
    /// Type.
    pub kind: Type,
    /// TI's name.
    pub name: &'static str,
    /// Range of the manual.
    pub range: Range,
    /// Unit as the manual prints it; empty for none.
    pub unit: &'static str,
    /// Names of its bits, where it is a word of flags.
    pub bits: &'static [Bit],
    /// Rewritten by the gauge itself: cycle counts, lifetime data, learned Qmax and Ra.
    pub learned: bool,
    /// Narrower limits than the manual's, where its range lets a pack be ruined.
    pub safe: Option<Safe>,
    /// Address or range is not sure: read-only unless the user insists.
    pub unproven: bool,
}

/// Range and default of a parameter.
#[derive(Debug)]
pub enum Range {
    /// Of an integer or bit field; `default` is `None` where sources disagree or none is known.
    Int {
        /// Smallest value.
        min: i64,
        /// Largest value.
        max: i64,
        /// The manual's default.
        default: Option<i64>,
    },
    /// Of an `F4`.
    Float {
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
        /// The manual's default.
        default: Option<f64>,
    },
    /// Of a string: any text that fits.
    Text {
        /// The manual's default.
        default: Option<&'static str>,
    },
}

/// A limit that keeps a pack alive, narrower than the manual's range. Each says why in its message.
#[derive(Debug)]
pub enum Safe {
    /// At least so much.
    AtLeast(i64, &'static str),
    /// Not above the voltage that the gauge measures now, scaled as its flash gate scales it.
    BelowPresentVoltage(&'static str),
    /// The bits of this mask must keep the value they have.
    Keep(u32, &'static str),
}

impl Register {
    /// A row of a manual's table: address, size and sign, name, unit, tier.
    pub const fn new(code: u8, kind: Type, name: &'static str, unit: &'static str, tier: Tier) -> Self {
        let signed = matches!(kind, Type::I(_));
        Self { code, size: kind.size() as u8, signed, name, unit, tier, role: None, bits: &[] }
    }

    /// The property it feeds.
    #[must_use]
    pub const fn role(mut self, role: Role) -> Self {
        self.role = Some(role);
        self
    }

    /// Names of its bits.
    #[must_use]
    pub const fn bits(mut self, bits: &'static [Bit]) -> Self {
        self.bits = bits;
        self
    }
}

impl Bit {
    /// A row of a manual's bit table.
    pub const fn new(mask: u16, name: &'static str) -> Self {
        Self { mask, name }
    }
}

impl Subcommand {
    /// A subcommand that a sealed gauge takes as well.
    pub const fn new(code: u16, name: &'static str, effect: Effect) -> Self {
        Self { code, name, sealed: true, effect }
    }

    /// A sealed gauge does not take it.
    #[must_use]
    pub const fn unsealed(mut self) -> Self {
        self.sealed = false;
        self
    }
}

impl Parameter {
    const fn new(offset: u16, kind: Type, name: &'static str, range: Range, unit: &'static str) -> Self {
        Self { offset, kind, name, range, unit, bits: &[], learned: false, safe: None, unproven: false }
    }

    /// An integer row of a manual's table: offset, type, name, min, max, default, unit.
    pub const fn int(
        offset: u16,
        kind: Type,
        name: &'static str,
        min: i64,
        max: i64,
        default: i64,
        unit: &'static str,
    ) -> Self {
        Self::new(offset, kind, name, Range::Int { min, max, default: Some(default) }, unit)
    }

    /// A floating-point row of a manual's table.
    pub const fn float(
        offset: u16,
        name: &'static str,
        min: f64,
        max: f64,
        default: f64,
        unit: &'static str,
    ) -> Self {
        Self::new(offset, Type::F4, name, Range::Float { min, max, default: Some(default) }, unit)
    }

    /// A string row of a manual's table.
    pub const fn text(offset: u16, size: u8, name: &'static str, default: &'static str) -> Self {
        Self::new(offset, Type::S(size), name, Range::Text { default: Some(default) }, "")
    }

    /// An integer row of which no default is known.
    pub const fn within(
        offset: u16,
        kind: Type,
        name: &'static str,
        min: i64,
        max: i64,
        unit: &'static str,
    ) -> Self {
        Self::new(offset, kind, name, Range::Int { min, max, default: None }, unit)
    }

    /// An integer row of which no range and no default are printed: whatever the type can hold.
    pub const fn any(offset: u16, kind: Type, name: &'static str, unit: &'static str) -> Self {
        let (min, max) = kind.bounds().expect("an integer type");
        Self::new(offset, kind, name, Range::Int { min, max, default: None }, unit)
    }

    /// Sources disagree about the default, or none is known.
    #[must_use]
    pub const fn no_default(mut self) -> Self {
        match &mut self.range {
            Range::Int { default, .. } => *default = None,
            Range::Float { default, .. } => *default = None,
            Range::Text { default } => *default = None,
        }
        self
    }

    /// Names of the bits. Those without a name are reserved, and a write must leave them alone.
    #[must_use]
    pub const fn bits(mut self, bits: &'static [Bit]) -> Self {
        assert!(self.kind.size() <= 2, "a flag word has one byte or two");
        let mut reserved: u32 = (1 << (8 * self.kind.size())) - 1;
        let mut at = 0;
        while at < bits.len() {
            reserved &= !(bits[at].mask as u32);
            at += 1;
        }
        if reserved != 0 {
            self.safe = Some(Safe::Keep(reserved, "the manual reserves them"));
        }
        self.bits = bits;
        self
    }

    /// The gauge rewrites this one itself.
    #[must_use]
    pub const fn learned(mut self) -> Self {
        self.learned = true;
        self
    }

    /// Narrower limits than the manual's.
    #[must_use]
    pub const fn safe(mut self, safe: Safe) -> Self {
        assert!(self.safe.is_none(), "one safe limit a parameter");
        self.safe = Some(safe);
        self
    }

    /// Address or range is not sure.
    #[must_use]
    pub const fn unproven(mut self) -> Self {
        self.unproven = true;
        self
    }
}

impl Signature {
    /// A row of [`Chip::signature`].
    pub const fn new(subclass: u8, offset: u16, kind: Type, min: i64, max: i64) -> Self {
        Self { subclass, offset, kind, min, max }
    }
}

impl Mode {
    /// A calibration that is running: a bit of CONTROL_STATUS that the gauge clears by itself.
    pub const fn measuring(mask: u16, name: &'static str, what: &'static str) -> Self {
        let remedy = "it ends by itself; try again in a minute";
        Self { word: Word::ControlStatus, mask, name, what, remedy, ours: false }
    }

    /// Calibration mode, which stays until somebody leaves it.
    pub const fn calibration(word: Word, mask: u16, name: &'static str, remedy: &'static str) -> Self {
        Self { word, mask, name, what: "somebody has left calibration mode on", remedy, ours: false }
    }
}

impl Sibling {
    const fn new(
        name: &'static str,
        device_type: u16,
        firmware: &'static [u16],
        dm_codes: &'static [u16],
        like: Option<&'static Chip>,
    ) -> Self {
        Self { name, identity: Identity { device_type, firmware, hardware: None, dm_codes, answer: 0 }, like }
    }
}

impl Identity {
    fn fits(&self, answers: &Answers) -> bool {
        let known = |codes: &[u16], code| codes.is_empty() || codes.contains(&code);
        self.device_type == answers.device_type
            && known(self.firmware, answers.firmware_version)
            && self.hardware.is_none_or(|hardware| hardware == answers.hardware_version)
            && answers.dm_code.is_none_or(|code| known(self.dm_codes, code))
    }
}

/// Tells from its answers which part it is. A part that names a code, hardware or DM_CODE, is meant
/// rather than one that does without.
pub fn recognise(answers: &Answers) -> Recognised {
    let names_hardware = |one: &Identity| one.hardware.is_some();
    let names_dm_code = |one: &Identity| answers.dm_code.is_some_and(|code| one.dm_codes.contains(&code));
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(|chip| chip.identity.fits(answers)).collect();
    let mut siblings: Vec<_> = SIBLINGS.iter().filter(|sibling| sibling.identity.fits(answers)).collect();
    let choices: [&dyn Fn(&Identity) -> bool; 2] = [&names_hardware, &names_dm_code];
    for named in choices {
        let in_chips = chips.iter().any(|chip| named(&chip.identity));
        if in_chips || siblings.iter().any(|sibling| named(&sibling.identity)) {
            chips.retain(|chip| named(&chip.identity));
            siblings.retain(|sibling| named(&sibling.identity));
        }
    }
    match (chips.as_slice(), siblings.as_slice()) {
        ([], []) => Recognised::Unknown,
        ([], [sibling, ..]) => Recognised::Sibling(sibling),
        ([chip], []) => Recognised::Chip(chip),
        _ => Recognised::Ambiguous(chips),
    }
}

impl Chip {
    /// The chip of that name on the command line.
    pub fn by_name(name: &str) -> Option<&'static Chip> {
        CHIPS.iter().copied().find(|chip| chip.name.eq_ignore_ascii_case(name))
    }

    /// The register that feeds a property.
    pub fn register(&self, role: Role) -> Option<&'static Register> {
        self.registers.iter().find(|register| register.role == Some(role))
    }

    /// The folder of a subclass in `df/by-name`: its name, and where two subclasses have the same one
    /// the manual's class in front of both.
    pub fn class_dir(&self, subclass: &Subclass) -> String {
        let name = kebab_case(subclass.name);
        let alike = self.subclasses.iter().filter(|other| kebab_case(other.name) == name).count();
        if alike > 1 { format!("{}-{name}", kebab_case(subclass.class)) } else { name }
    }

    /// The subclass of that id.
    pub fn subclass(&self, id: u8) -> Option<&'static Subclass> {
        self.subclasses.iter().find(|subclass| subclass.id == id)
    }

    /// The parameter that stands at `df/SUBCLASS/OFFSET`, and what it belongs to; with `flash` and an
    /// address in hexadecimal on a part without subclasses.
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

impl Subclass {
    /// Offset of its first byte: 0, or the address at which a flat group begins.
    pub fn start(&self) -> u16 {
        if self.id == FLAT { self.parameters.first().map_or(0, |parameter| parameter.offset) } else { 0 }
    }

    /// Bytes that are read and committed with it: its blocks, whole, behind the last documented parameter as
    /// well. Of a flat group it is its own bytes only.
    pub fn stored(&self) -> u16 {
        if self.id == FLAT { self.length } else { self.length.next_multiple_of(WINDOW as u16) }
    }

    /// The parameter at that offset.
    pub fn parameter(&self, offset: u16) -> Option<&'static Parameter> {
        self.parameters.iter().find(|parameter| parameter.offset == offset)
    }
}

/// TI's name as a file name of `gauge/`: words of lower-case letters and digits joined by `_`, an
/// upper-case letter after a lower-case one or a digit starting a new word (`StateOfCharge` is
/// `state_of_charge`, `DOD@EOC` is `dod_at_eoc`).
pub fn snake_case(name: &str) -> String {
    let mut words = String::new();
    let mut before = ' ';
    for letter in name.replace('@', "_at_").chars() {
        if !letter.is_ascii_alphanumeric() {
            words.push('_');
        } else {
            if letter.is_ascii_uppercase() && (before.is_ascii_lowercase() || before.is_ascii_digit()) {
                words.push('_');
            }
            words.push(letter.to_ascii_lowercase());
        }
        before = letter;
    }
    words.split('_').filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_")
}

/// A name of the manual's as a file name of `df/by-name`: lower case, `%` is `pct`, every other run of
/// characters `-`.
pub fn kebab_case(name: &str) -> String {
    let lower = name.to_lowercase().replace('%', " pct ");
    let words = lower.split(|letter: char| !letter.is_ascii_alphanumeric());
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a part of that type and firmware is taken for.
    fn seen(device_type: u16, firmware_version: u16, hardware_version: u16, dm_code: Option<u16>) -> String {
        let answers = Answers { device_type, firmware_version, hardware_version, chem_id: None, dm_code };
        match recognise(&answers) {
            Recognised::Chip(chip) => chip.name.to_string(),
            Recognised::Sibling(Sibling { name, like: Some(chip), .. }) => {
                format!("{name} like {}", chip.name)
            }
            Recognised::Sibling(Sibling { name, like: None, .. }) => format!("{name} like none"),
            Recognised::Ambiguous(chips) => {
                chips.iter().map(|chip| chip.name).collect::<Vec<_>>().join(" or ")
            }
            Recognised::Unknown => "unknown".to_string(),
        }
    }

    #[test]
    fn a_firmware_of_its_own_makes_a_sibling() {
        assert_eq!(seen(0x0100, 0x0016, 0x0008, None), "bq34z100-g1");
        assert_eq!(seen(0x0100, 0x0202, 0x0008, None), "bq34z100-R2 like bq34z100-g1");
        assert_eq!(seen(0x0100, 0x0202, 0x00a8, None), "bq35100");
        assert_eq!(seen(0x0110, 0x0100, 0x0000, None), "bq34110");
        assert_eq!(seen(0x0520, 0x0324, 0x0000, None), "bq27520-g3");
        assert_eq!(seen(0x0520, 0x0311, 0x0000, None), "bq27520-G2 like bq27520-g3");
        assert_eq!(seen(0x0520, 0x0329, 0x0000, None), "bq27520-G4 like none");
        assert_eq!(seen(0x0520, 0x0325, 0x0000, None), "unknown");
        assert_eq!(seen(0x0100, 0x0017, 0x0008, None), "unknown");
        assert_eq!(seen(0x0100, 0x0016, 0x0009, None), "unknown");
        assert_eq!(seen(0xffff, 0xffff, 0xffff, None), "unknown");
        assert_eq!(seen(0x0000, 0x0000, 0x0000, None), "unknown");
    }

    #[test]
    fn dm_code_tells_parts_of_one_type_apart() {
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x48)), "bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x58)), "bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x80)), "bq27411-G1 like bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x11)), "bq27421-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, None), "bq27441-g1 or bq27421-g1");
        assert_eq!(seen(0x0421, 0x0200, 0, Some(0x48)), "unknown");
    }

    #[test]
    fn a_type_of_its_own_is_enough_where_it_is_alone() {
        assert_eq!(seen(0x0427, 0x0202, 0, Some(0x9f)), "bq27427");
        assert_eq!(seen(0x0427, 0x0202, 0, None), "bq27427");
        assert_eq!(seen(0x0427, 0x0109, 0, None), "unknown");
        assert_eq!(seen(0x0426, 0x0202, 0, Some(0x9f)), "bq27426 like bq27427");
        assert_eq!(seen(0x0621, 0x0110, 0, None), "bq27621-G1 like none");
    }

    #[test]
    fn file_names_follow_from_the_manuals_names() {
        assert_eq!(snake_case("StateOfCharge"), "state_of_charge");
        assert_eq!(snake_case("DOD@EOC"), "dod_at_eoc");
        assert_eq!(snake_case("DOD0Time"), "dod0_time");
        assert_eq!(snake_case("FlagsB"), "flags_b");
        assert_eq!(snake_case("CONTROL_STATUS"), "control_status");
        assert_eq!(kebab_case("Cell Terminate Voltage"), "cell-terminate-voltage");
        assert_eq!(kebab_case("TCA Set %"), "tca-set-pct");
        assert_eq!(kebab_case("IT Cfg"), "it-cfg");
        assert_eq!(kebab_case("Cell Charge Voltage T1-T2"), "cell-charge-voltage-t1-t2");
    }
}
