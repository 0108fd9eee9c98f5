// SPDX-License-Identifier: MIT

//! Data flash as the manual lists it: subclasses and their parameters.

use super::{Bit, Role};
use crate::codec::WINDOW;
use crate::date;
use crate::error::{Cause, Error, Step};
use crate::value::Type;

/// The id of every group on a part with a flat address space, where offsets are addresses.
pub const FLAT: u8 = 0;

/// A subclass of data flash.
#[derive(Debug)]
pub struct Subclass {
    /// The manual's class, such as `Configuration`.
    pub class: &'static str,
    /// The manual's name, such as `IT Cfg`.
    pub name: &'static str,
    /// Subclass id; [`FLAT`] for a group on a part that addresses data flash directly.
    pub id: u8,
    /// Bytes from [`Subclass::start`] to the end of its last documented parameter, or to its last known byte.
    pub length: u16,
    /// Requirements of a write to its parameters.
    pub kind: Kind,
    /// Its documented parameters, by offset; empty if only the subclass is known.
    pub parameters: &'static [Parameter],
}

impl Subclass {
    /// A subclass known by name and length only: its bytes are read and written as a whole.
    pub const fn opaque(class: &'static str, name: &'static str, id: u8, length: u16) -> Self {
        Self { class, name, id, length, kind: Kind::Reset, parameters: &[] }
    }

    /// Whether only its name and length are known.
    pub fn is_opaque(&self) -> bool {
        self.parameters.is_empty()
    }

    /// Whether a pack's maker keeps there what it likes.
    pub fn is_makers(&self) -> bool {
        self.name.starts_with("Manufacturer")
    }

    /// Whether it contains the chemistry.
    pub fn is_chemistry(&self) -> bool {
        self.class == "Chemistry" || self.name == "Chem Data"
    }

    /// Offset of its first byte: 0, or the first address of a flat group.
    pub fn start(&self) -> u16 {
        if self.id == FLAT { self.parameters.first().map_or(0, |parameter| parameter.offset) } else { 0 }
    }

    /// Bytes read and committed with it: whole blocks, with what follows its parameters; of a flat group its own bytes.
    pub fn stored(&self) -> u16 {
        if self.id == FLAT { self.length } else { self.length.next_multiple_of(WINDOW as u16) }
    }

    /// The parameter at an offset.
    pub fn parameter(&self, offset: u16) -> Option<&'static Parameter> {
        self.parameters.iter().find(|parameter| parameter.offset == offset)
    }
}

/// What a value belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stays {
    /// The board that was calibrated.
    Board,
    /// The type of cell: its chemistry.
    Cell,
    /// One pack, whose gauge has learned it.
    Pack,
    /// All packs of a design.
    Design,
}

/// Requirements of a write to a subclass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A reset: without it the change may not take effect.
    Reset,
    /// No reset.
    Plain,
    /// Keys: never read, exported or shown; only the guarded key change writes them.
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
    /// No source prints the range: it is the type's, or a sibling's.
    pub unprinted: bool,
    /// Unit as the manual prints it; empty for none.
    pub unit: &'static str,
    /// Names of its bits, for a word of flags.
    pub bits: &'static [Bit],
    /// A different default for parts with this DM_CODE: (code, default).
    pub flavour: Option<(u16, i16)>,
    /// Rewritten by the gauge itself: cycle counts, lifetime data, learned Qmax and Ra.
    pub learned: bool,
    /// Limits narrower than the manual's, whose range allows values that ruin a pack.
    pub safe: Option<Safe>,
    /// Address or range is uncertain: read-only unless the user insists.
    pub unproven: bool,
    /// Why it is never written, whatever the user insists on; nor is the block that it is in, where blocks are written whole.
    pub never: Option<&'static str>,
    /// What shows that it is where it is; empty if the table's documents do.
    pub source: &'static str,
    /// The property that it feeds.
    pub role: Option<Role>,
}

impl Parameter {
    const fn new(offset: u16, kind: Type, name: &'static str, range: Range, unit: &'static str) -> Self {
        Self {
            offset,
            kind,
            name,
            range,
            unprinted: false,
            unit,
            bits: &[],
            flavour: None,
            learned: false,
            safe: None,
            unproven: false,
            never: None,
            source: "",
            role: None,
        }
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

    /// An integer row without a known default.
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

    /// An integer row without a printed range or default: any value of the type.
    pub const fn any(offset: u16, kind: Type, name: &'static str, unit: &'static str) -> Self {
        let (min, max) = kind.bounds().expect("an integer type");
        Self::new(offset, kind, name, Range::Int { min, max, default: None }, unit).unprinted()
    }

    /// Whether it distinguishes packs: serial number, date and lots.
    pub fn names_pack(&self) -> bool {
        ["Serial Number", "Manufacture Date", "Pack Lot Code", "PCB Lot Code"].contains(&self.name)
    }

    /// Whether it is a date.
    pub fn is_date(&self) -> bool {
        self.unit == date::UNIT
    }

    /// No source prints its range.
    #[must_use]
    pub const fn unprinted(mut self) -> Self {
        self.unprinted = true;
        self
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

    /// Parts with that DM_CODE have another default.
    #[must_use]
    pub const fn flavour(mut self, dm_code: u16, default: i16) -> Self {
        self.flavour = Some((dm_code, default));
        self
    }

    /// The default of an integer on a part with that DM_CODE; `None` if it depends on an unknown one.
    pub fn int_default(&self, dm_code: Option<u16>) -> Option<i64> {
        let Range::Int { default, .. } = self.range else { return None };
        match self.flavour {
            None => default,
            Some((other, other_default)) => {
                dm_code.and_then(|code| if code == other { Some(other_default.into()) } else { default })
            }
        }
    }

    /// Names of the bits. Bits without a name are reserved, and writes must not change them.
    #[must_use]
    pub const fn bits(mut self, bits: &'static [Bit]) -> Self {
        assert!(self.kind.size() <= 4, "a flag word has at most four bytes");
        let mut reserved = u32::MAX >> (32 - 8 * self.kind.size());
        let mut at = 0;
        while at < bits.len() {
            reserved &= !bits[at].mask;
            at += 1;
        }
        if reserved != 0 {
            self.safe = Some(Safe::Keep(reserved, "the manual reserves them"));
        }
        self.bits = bits;
        self
    }

    /// The gauge itself rewrites it.
    #[must_use]
    pub const fn learned(mut self) -> Self {
        self.learned = true;
        self
    }

    /// Narrower limits than the manual's.
    #[must_use]
    pub const fn safe(mut self, safe: Safe) -> Self {
        assert!(self.safe.is_none(), "a parameter has at most one safe limit");
        self.safe = Some(safe);
        self
    }

    /// Address or range is uncertain.
    #[must_use]
    pub const fn unproven(mut self) -> Self {
        self.unproven = true;
        self
    }

    /// It is never written, nor is its block where blocks are written whole. Whatever leaves unproven rows out leaves it out.
    #[must_use]
    pub const fn never(mut self, why: &'static str) -> Self {
        (self.unproven, self.never) = (true, Some(why));
        self
    }

    /// What shows that it is where it is.
    #[must_use]
    pub const fn by(mut self, source: &'static str) -> Self {
        self.source = source;
        self
    }

    /// The refusal of a row that is never written.
    pub(crate) fn check_never(&self) -> Option<Error> {
        let why = format!("never written: {}", self.never?);
        Some(Error::new(self.name, Cause::NotPermitted, why).at(Step::Check))
    }

    /// The property it feeds.
    #[must_use]
    pub const fn role(mut self, role: Role) -> Self {
        self.role = Some(role);
        self
    }
}

/// A parameter and its subclass. Subclasses may share their parameters.
pub type Row = (&'static Subclass, &'static Parameter);

/// Range and default of a parameter.
#[derive(Debug)]
pub enum Range {
    /// Of an integer or bit field; `default` is `None` if sources disagree or none is known.
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

/// A limit narrower than the manual's range, to protect the pack, with its reason.
#[derive(Debug)]
pub enum Safe {
    /// A minimum.
    AtLeast(i32, &'static str),
    /// A minimum and a maximum.
    Within(i32, i32, &'static str),
    /// Not above the voltage that the gauge will measure with the transaction's values, as its flash gate compares it.
    BelowVoltage(&'static str),
    /// At least so much below the row at that offset of its subclass, with the transaction's values.
    Under(u16, i32, &'static str),
    /// At least so much above the row at that offset of its subclass, with the transaction's values.
    Over(u16, i32, &'static str),
    /// At least so much above what the register of that property shows now.
    AboveNow(Role, i32, &'static str),
    /// At least so much below what the register of that property shows now.
    BelowNow(Role, i32, &'static str),
    /// The bits of this mask must keep their values.
    Keep(u32, &'static str),
    /// All of these.
    All(&'static [Safe]),
}

impl Safe {
    /// The limits that it consists of.
    pub fn each(&self) -> &[Self] {
        match self {
            Self::All(all) => all,
            one => std::slice::from_ref(one),
        }
    }

    /// The smallest and the largest number that it allows by itself, and the reason. A row has one limit of this kind.
    pub fn limits(&self) -> Option<(i64, i64, &'static str)> {
        self.each().iter().find_map(|one| match *one {
            Self::AtLeast(least, why) => Some((least.into(), i64::MAX, why)),
            Self::Within(least, most, why) => Some((least.into(), most.into(), why)),
            _ => None,
        })
    }
}
