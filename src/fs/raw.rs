//! `raw SUBCLASS/OFFSET HEX`: bytes that no manual documents, as changes like any other.
//!
//! A line reaches what has no parameter and nothing else: no key, no limit and no row that is not proven
//! can be got around by it. Each byte becomes a change of its own, so that the transaction need not know
//! of them.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use crate::chip::{Chip, FLAT, Kind, Parameter, Scheme, Subclass};
use crate::codec::WINDOW;
use crate::dataflash::Change;
use crate::error::{Cause, Error, Result};
use crate::text;
use crate::value::types::H1;

/// Rows for bytes without one, made when they are first asked for and kept: a gauge has only so many, and
/// a change refers to rows that outlive it.
static BYTES: Mutex<BTreeMap<(u8, u16), &'static Parameter>> = Mutex::new(BTreeMap::new());
/// Likewise subclasses that no table has.
static SUBCLASSES: Mutex<BTreeMap<u8, &'static Subclass>> = Mutex::new(BTreeMap::new());

/// The changes that a line `raw PLACE HEX` asks for.
pub(super) fn changes(chip: &'static Chip, line: &str) -> Result<Vec<Change>> {
    let mut words = line.split_whitespace();
    let (place, digits) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let numbers =
        place.split_once('/').and_then(|(id, offset)| Some((id.parse().ok()?, offset.parse().ok()?)));
    let ((Some((id, offset)), Some(bytes)), None) = ((numbers, bytes(digits)), words.next()) else {
        return Err(invalid("write raw SUBCLASS/OFFSET HEX, 1 to 32 bytes of two digits each".into()));
    };
    if chip.access.scheme == Scheme::Mac || id == FLAT {
        return Err(invalid("bytes without a parameter are written in subclasses only".into()));
    }
    let subclass = chip.subclass(id).unwrap_or_else(|| unknown(id));
    check(subclass, offset, bytes.len())?;
    let change = |(offset, byte)| Change {
        subclass,
        parameter: row(subclass.id, offset),
        bytes: vec![byte],
        saved: false,
    };
    Ok((offset..).zip(bytes).map(change).collect())
}

fn check(subclass: &Subclass, offset: u16, length: usize) -> Result<()> {
    if subclass.kind == Kind::Security {
        let why = "keys cannot be changed like other bytes";
        return Err(Error::new("", Cause::NotPermitted(why.into())));
    }
    let end = usize::from(offset) + length;
    if usize::from(offset) / WINDOW != (end - 1) / WINDOW {
        return Err(invalid(format!("a line stays in one block, which ends at offset {}", offset | 31)));
    }
    // DataFlashBlock() is a byte.
    let stored = if subclass.parameters.is_empty() { WINDOW << 8 } else { usize::from(subclass.stored()) };
    if end > stored {
        return Err(invalid(format!("subclass {} ends with offset {}", subclass.id, stored - 1)));
    }
    let overlaps = |row: &&Parameter| {
        let start = usize::from(row.offset);
        start < end && usize::from(offset) < start + row.kind.size()
    };
    match subclass.parameters.iter().find(overlaps) {
        None => Ok(()),
        Some(row) => {
            let (id, at) = (subclass.id, row.offset);
            Err(invalid(format!("{} stands there; write it as `{id}/{at} VALUE`", row.name)))
        }
    }
}

/// Whether a change is of a byte without a parameter.
pub(super) fn is_raw(change: &Change) -> bool {
    !change.subclass.parameters.iter().any(|row| std::ptr::eq(row, change.parameter))
}

/// Whether one such change follows another in data flash.
pub(super) fn follows(before: &Change, change: &Change) -> bool {
    is_raw(before)
        && is_raw(change)
        && before.subclass.id == change.subclass.id
        && before.parameter.offset.checked_add(1) == Some(change.parameter.offset)
}

fn row(id: u8, offset: u16) -> &'static Parameter {
    let mut rows = BYTES.lock().unwrap_or_else(PoisonError::into_inner);
    rows.entry((id, offset)).or_insert_with(|| {
        let name = String::leak(format!("undocumented byte {id}/{offset}"));
        Box::leak(Box::new(Parameter::any(offset, H1, name, "")))
    })
}

fn unknown(id: u8) -> &'static Subclass {
    let mut subclasses = SUBCLASSES.lock().unwrap_or_else(PoisonError::into_inner);
    subclasses.entry(id).or_insert_with(|| {
        let name = String::leak(format!("subclass {id}"));
        // Nobody says that it would do without a reset.
        Box::leak(Box::new(Subclass { class: "", name, id, length: 0, kind: Kind::Reset, parameters: &[] }))
    })
}

fn bytes(digits: &str) -> Option<Vec<u8>> {
    text::unhex(digits.as_bytes()).filter(|bytes| (1..=WINDOW).contains(&bytes.len()))
}

fn invalid(why: String) -> Error {
    Error::new("", Cause::Invalid(why))
}
