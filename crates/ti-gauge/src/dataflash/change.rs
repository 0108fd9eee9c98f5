// SPDX-License-Identifier: MIT

//! What is about to be written. A [`Change`] is made here only, from a value that was checked. So none has
//! a value out of the manual's range, a row that nobody has confirmed, a key, or bytes of somebody else's parameter.

use std::io::ErrorKind;

use super::Place;
use super::checks::integer;
pub use crate::chip::Row;
use crate::chip::{Chip, FLAT, Kind, Parameter, Range, Safe};
use crate::codec::{Layout, WINDOW};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::notation;
use crate::value::Value;

/// New bytes for one place in data flash.
///
/// It cannot be put together from parts:
///
/// ```compile_fail
/// use ti_gauge::codec::Layout;
/// use ti_gauge::dataflash::Change;
///
/// let place = (80, 53).into();
/// let change = Change { place, bytes: vec![0xff, 0xff], row: None, saved: false, layout: Layout::TI };
/// ```
#[derive(Clone, Debug)]
pub struct Change {
    pub(super) place: Place,
    pub(super) bytes: Vec<u8>,
    /// The parameter whose value this is; `None` for undocumented bytes.
    pub(super) row: Option<Row>,
    /// The bytes come from a saved configuration: bits that must not change keep their present value.
    pub(super) saved: bool,
    pub(super) layout: Layout,
}

impl Change {
    /// A new value as its file takes it; `also_unproven` allows rows that no second source confirms (EACCES otherwise).
    pub fn parse(chip: &Chip, row: Row, text: &[u8], also_unproven: bool) -> Result<Self> {
        let value = check_row(chip, row, also_unproven).and_then(|()| notation::parse(row.1, text));
        let value = value.map_err(|error| error.at_place(Place::of(row).into()))?;
        Self::of_value(chip, row, &value, also_unproven)
    }

    /// A new value of a parameter. It must be of its type, in the manual's range and above the safe minimum.
    pub fn of_value(chip: &Chip, row: Row, value: &Value, also_unproven: bool) -> Result<Self> {
        Self::checked(chip, row, value, also_unproven).map_err(|error| error.at_place(Place::of(row).into()))
    }

    fn checked(chip: &Chip, row: Row, value: &Value, also_unproven: bool) -> Result<Self> {
        let parameter = row.1;
        check_row(chip, row, also_unproven)?;
        notation::check(parameter, value)?;
        let bytes = chip.layout.encode(parameter.kind, value).ok_or_else(|| {
            Error::new(parameter.name, Cause::Invalid, format!("does not fit type {}", parameter.kind))
        })?;
        let place = Place::of(row);
        let change = Self { place, bytes, row: Some(row), saved: false, layout: chip.layout };
        change.check_limits()?;
        Ok(change)
    }

    /// Bytes that no manual documents, all in one block: no key, no limit and no unproven row can be bypassed with them.
    pub fn raw(chip: &Chip, place: Place, bytes: Vec<u8>) -> Result<Self> {
        check_raw(chip, place, bytes.len()).map_err(|error| error.at_place(place.into()))?;
        Ok(Self { place, bytes, row: None, saved: false, layout: chip.layout })
    }

    /// Makes it part of a saved configuration: bits that must not change keep their present value.
    #[must_use]
    pub fn saved(self) -> Self {
        Self { saved: true, ..self }
    }

    /// Place of the first byte.
    pub fn place(&self) -> Place {
        self.place
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The parameter whose value this is; `None` for undocumented bytes.
    pub fn row(&self) -> Option<Row> {
        self.row
    }

    /// The value that bytes in its place are; `None` for undocumented ones.
    pub fn value_of(&self, bytes: &[u8]) -> Option<Value> {
        self.row.map(|(_, parameter)| self.layout.decode(parameter.kind, bytes))
    }

    /// The bytes as stored over `old`: a saved configuration leaves bits alone that must not change.
    pub fn stored_over(&self, old: &[u8]) -> Vec<u8> {
        let bytes = self.bytes.iter().zip(old).enumerate();
        bytes.map(|(at, (new, old))| new & !self.kept_bits(at) | old & self.kept_bits(at)).collect()
    }

    pub(super) fn kept_bits(&self, number: usize) -> u8 {
        match self.row {
            Some((_, Parameter { safe: Some(Safe::Keep(mask, _)), .. })) if self.saved => {
                (mask >> self.layout.shift(self.bytes.len(), number)) as u8
            }
            _ => 0,
        }
    }

    /// Checks the safe limits that need no gauge.
    pub(super) fn check_limits(&self) -> Result<()> {
        let Some((_, parameter)) = self.row else { return Ok(()) };
        let Some((least, greatest, why)) = parameter.safe.as_ref().and_then(Safe::limits) else {
            return Ok(());
        };
        let number = integer(self.layout, parameter, &self.bytes);
        let reason = match number {
            _ if number < least => Reason::Unsafe { number, least, why },
            _ if number > greatest => Reason::UnsafeAbove { number, greatest, why },
            _ => return Ok(()),
        };
        Err(Error::of(self.subject(), reason).at(Step::Check))
    }

    /// Checks that the bits which must keep their values do. `stored` are the parameter's bytes on the gauge.
    pub fn check_reserved(&self, stored: &[u8]) -> Result<()> {
        let Some((_, parameter @ Parameter { safe: Some(Safe::Keep(mask, why)), .. })) = self.row else {
            return Ok(());
        };
        let old = integer(self.layout, parameter, stored);
        let differ = (old ^ integer(self.layout, parameter, &self.bytes)) & i64::from(*mask);
        if differ == 0 {
            return Ok(());
        }
        let why = format!("bits 0x{differ:x} must not change: {why}; the word is now 0x{old:x}");
        Err(Error::new(self.subject(), Cause::OutOfRange, why).at(Step::Check))
    }

    /// Whether these bytes, in its place, are what the part has there by itself.
    pub fn is_default(&self, bytes: &[u8]) -> bool {
        let Some((_, parameter)) = self.row else { return true };
        let printed = match parameter.range {
            Range::Int { default, .. } => default.map(Value::Int),
            Range::Float { default, .. } => default.map(Value::Float),
            Range::Text { default } => default.map(|text| Value::Text(text.into())),
        };
        let flavour = parameter.flavour.map(|(_, default)| Value::Int(default.into()));
        let is = |default: Value| {
            self.layout.encode(parameter.kind, &default).is_some_and(|default| default == bytes)
        };
        // Where none is printed, nothing can be told.
        printed.is_none() || [printed, flavour].into_iter().flatten().any(is)
    }

    /// Whether the gauge rewrites it itself.
    pub fn is_learned(&self) -> bool {
        self.row.is_some_and(|(_, parameter)| parameter.learned)
    }

    /// Name for the log: the parameter's name, or the place of undocumented bytes.
    pub fn name(&self) -> String {
        match self.row {
            Some((_, parameter)) => parameter.name.to_string(),
            None => format!("undocumented bytes at {}", self.place),
        }
    }

    pub(super) fn subject(&self) -> String {
        match self.row {
            Some((_, parameter)) => format!("{} ({})", parameter.name, self.place),
            None => self.name(),
        }
    }

    /// What a write of it needs. A part that is never reset needs none.
    pub(super) fn kind(&self, chip: &Chip) -> Kind {
        match self.needs(chip) {
            Kind::Reset if chip.is_never_reset() => Kind::Plain,
            kind => kind,
        }
    }

    /// Whether it counts from the gauge's next start on only.
    pub fn waits(&self, chip: &Chip) -> bool {
        self.needs(chip) == Kind::Reset && chip.is_never_reset()
    }

    /// What its subclass needs; an undocumented subclass is assumed to need a reset.
    fn needs(&self, chip: &Chip) -> Kind {
        let table = self.row.map(|(subclass, _)| subclass).or_else(|| chip.subclass(self.place.subclass));
        table.map_or(Kind::Reset, |subclass| subclass.kind)
    }
}

fn check_row(chip: &Chip, (subclass, parameter): Row, also_unproven: bool) -> Result<()> {
    if subclass.kind == Kind::Security {
        let why = "keys cannot be changed like other parameters";
        return Err(Error::new(parameter.name, Cause::NotPermitted, why));
    }
    if let Some(never) = parameter.check_never() {
        return Err(never);
    }
    chip.check_proven()?;
    if parameter.unproven && !also_unproven {
        let why = "its address or range is not sure; mount with --allow-unproven to write it";
        return Err(Error::new(parameter.name, Cause::Io(ErrorKind::PermissionDenied), why));
    }
    Ok(())
}

fn check_raw(chip: &Chip, Place { subclass: id, offset }: Place, length: usize) -> Result<()> {
    chip.check_proven()?;
    if chip.is_never_reset() {
        let why = "bytes that nobody has documented are not written to this part, which drives the pack's FETs; leave them \
                   out (gaugefs import --exclude undocumented)";
        return Err(Error::new("", Cause::NotPermitted, why));
    }
    if chip.access.scheme.is_flat() || id == FLAT {
        return Err(invalid("bytes without a parameter are written in subclasses only".into()));
    }
    let table = chip.subclass(id);
    if table.is_some_and(|subclass| subclass.kind == Kind::Security) {
        let why = "keys cannot be changed like other bytes";
        return Err(Error::new("", Cause::NotPermitted, why));
    }
    let end = usize::from(offset) + length;
    if length == 0 || usize::from(offset) / WINDOW != (end - 1) / WINDOW {
        return Err(invalid("the bytes of a line must be in one block of 32 bytes; write two lines".into()));
    }
    // DataFlashBlock() is a byte.
    let stored = table.map_or(WINDOW << 8, |subclass| usize::from(subclass.stored()));
    if end > stored {
        return Err(invalid(format!("subclass {id} ends with offset {}", stored - 1)));
    }
    let overlaps = |row: &&Parameter| {
        let start = usize::from(row.offset);
        start < end && usize::from(offset) < start + row.kind.size()
    };
    match table.and_then(|subclass| subclass.parameters.iter().find(overlaps)) {
        None => Ok(()),
        Some(row) => {
            let at = row.offset;
            Err(invalid(format!("{} is stored there; write it as `{id}/{at} VALUE`", row.name)))
        }
    }
}

fn invalid(why: String) -> Error {
    Error::new("", Cause::Invalid, why)
}
