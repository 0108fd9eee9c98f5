// SPDX-License-Identifier: MIT

//! `raw SUBCLASS/OFFSET HEX`: bytes that no manual documents.

use ti_gauge::chip::Chip;
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::text;

use crate::error::{Cause, Error, Result};

/// The change in a line `raw PLACE HEX`.
pub(super) fn change(chip: &'static Chip, line: &str) -> Result<Change> {
    let mut words = line.split_whitespace();
    let (place, digits) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let numbers =
        place.split_once('/').and_then(|(id, offset)| Some((text::unsigned(id)?, text::unsigned(offset)?)));
    let bytes = text::unhex(digits.as_bytes()).filter(|bytes| (1..=WINDOW).contains(&bytes.len()));
    let ((Some((subclass, offset)), Some(bytes)), None) = ((numbers, bytes), words.next()) else {
        let why = "write raw SUBCLASS/OFFSET HEX, 1 to 32 bytes of two digits each";
        return Err(Error::new("", Cause::Invalid, why));
    };
    Change::raw(chip, Place { subclass, offset }, bytes)
}
