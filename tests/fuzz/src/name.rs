// SPDX-License-Identifier: MIT

//! The name of a parameter, as on the command line and in `df/transaction`: `ti_gauge::chip`.

use ti_gauge::chip::{CHIPS, Chip, Row, Unnamed};

pub(crate) fn run(input: &[u8]) {
    let Ok(name) = std::str::from_utf8(input) else { return };
    for chip in CHIPS {
        match chip.find(name) {
            Ok(row) => has_its_name(chip, row, name),
            Err(Unnamed::Several(names)) => {
                assert!(names.len() > 1, "{name}: one is not several");
                for full in names {
                    assert!(chip.find(&full).is_ok(), "{name}: {full} is no name");
                }
            }
            Err(Unnamed::Unknown) => {
                if let Some(row) = chip.nearest(name) {
                    has_its_name(chip, row, name);
                }
            }
        }
    }
}

/// What was found, or is suggested, is found by its full name.
fn has_its_name(chip: &'static Chip, row: Row, name: &str) {
    let full = chip.name_of(row);
    let found = chip.find(&full);
    assert!(found.is_ok_and(|found| std::ptr::eq(found.1, row.1)), "{}: {name}: {full}", chip.name);
}
