//! `raw SUBCLASS/OFFSET HEX`: bytes that no manual documents.
//!
//! A line reaches only bytes without a parameter: no key, no limit and no unproven row can be bypassed with it.

use ti_gauge::chip::{Chip, FLAT, Kind, Parameter};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::Place;
use ti_gauge::text;

use crate::error::{Cause, Error, Result};

/// The bytes that a line `raw PLACE HEX` asks for, all in one block, and the place of the first.
pub(crate) fn bytes(chip: &'static Chip, line: &str) -> Result<(Place, Vec<u8>)> {
    let mut words = line.split_whitespace();
    let (place, digits) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let numbers =
        place.split_once('/').and_then(|(id, offset)| Some((text::unsigned(id)?, text::unsigned(offset)?)));
    let bytes = text::unhex(digits.as_bytes()).filter(|bytes| (1..=WINDOW).contains(&bytes.len()));
    let ((Some((subclass, offset)), Some(bytes)), None) = ((numbers, bytes), words.next()) else {
        return Err(invalid("write raw SUBCLASS/OFFSET HEX, 1 to 32 bytes of two digits each".into()));
    };
    if chip.access.scheme.is_flat() || subclass == FLAT {
        return Err(invalid("bytes without a parameter are written in subclasses only".into()));
    }
    let place = Place { subclass, offset };
    check(chip, place, bytes.len())?;
    Ok((place, bytes))
}

fn check(chip: &Chip, Place { subclass: id, offset }: Place, length: usize) -> Result<()> {
    let table = chip.subclass(id);
    if table.is_some_and(|subclass| subclass.kind == Kind::Security) {
        let why = "keys cannot be changed like other bytes";
        return Err(Error::new("", Cause::NotPermitted(why.into())));
    }
    let end = usize::from(offset) + length;
    if usize::from(offset) / WINDOW != (end - 1) / WINDOW {
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
    Error::new("", Cause::Invalid(why))
}
