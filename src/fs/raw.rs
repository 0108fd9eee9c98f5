//! `raw SUBCLASS/OFFSET HEX`: bytes that no manual documents, as changes like any other.
//!
//! A line reaches only bytes without a parameter: no key, no limit and no unproven row can be bypassed with it.
//! Each byte is a change of its own, so that a line staged later replaces exactly the bytes that it names.

use ti_gauge::chip::{Chip, FLAT, Kind, Parameter};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::text;

use crate::error::{Cause, Error, Result};

/// The changes that a line `raw PLACE HEX` asks for.
pub(super) fn changes(chip: &'static Chip, line: &str) -> Result<Vec<Change>> {
    let mut words = line.split_whitespace();
    let (place, digits) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let numbers =
        place.split_once('/').and_then(|(id, offset)| Some((id.parse().ok()?, offset.parse().ok()?)));
    let ((Some((id, offset)), Some(bytes)), None) = ((numbers, bytes(digits)), words.next()) else {
        return Err(invalid("write raw SUBCLASS/OFFSET HEX, 1 to 32 bytes of two digits each".into()));
    };
    if chip.access.scheme.is_flat() || id == FLAT {
        return Err(invalid("bytes without a parameter are written in subclasses only".into()));
    }
    check(chip, Place { subclass: id, offset }, bytes.len())?;
    let change = |(offset, byte)| Change {
        place: Place { subclass: id, offset },
        bytes: vec![byte],
        row: None,
        saved: false,
    };
    Ok((offset..).zip(bytes).map(change).collect())
}

fn check(chip: &Chip, Place { subclass: id, offset }: Place, length: usize) -> Result<()> {
    let table = chip.subclass(id);
    if table.is_some_and(|subclass| subclass.kind == Kind::Security) {
        let why = "keys cannot be changed like other bytes";
        return Err(Error::new("", Cause::NotPermitted(why.into())));
    }
    let end = usize::from(offset) + length;
    if usize::from(offset) / WINDOW != (end - 1) / WINDOW {
        return Err(invalid(format!("a line stays in one block, which ends at offset {}", offset | 31)));
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

/// Whether one such change follows another in data flash.
pub(super) fn follows(before: &Change, change: &Change) -> bool {
    before.row.is_none()
        && change.row.is_none()
        && before.place.subclass == change.place.subclass
        && before.place.offset.checked_add(1) == Some(change.place.offset)
}

fn bytes(digits: &str) -> Option<Vec<u8>> {
    text::unhex(digits.as_bytes()).filter(|bytes| (1..=WINDOW).contains(&bytes.len()))
}

fn invalid(why: String) -> Error {
    Error::new("", Cause::Invalid(why))
}
