// SPDX-License-Identifier: MIT

//! Files with whole firmware, as TI's tools write them, for a chip.

use gauge_sim::firmware;
pub(crate) use gauge_sim::firmware::Style;
use ti_gauge::chip::Chip;

/// What a file for a chip holds: its firmware, and data flash with its Device Name.
pub(crate) fn content(chip: &Chip) -> (Vec<[u8; 96]>, Vec<u8>) {
    let file = chip.firmware_file.as_ref().expect("it has one");
    firmware::named(chip.name, file.name, file.names[0]).expect("it has a boot loader")
}

pub(crate) fn file(chip: &Chip, style: Style) -> String {
    let (rows, data) = content(chip);
    firmware::file(rows, data, style)
}
