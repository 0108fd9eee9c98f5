// SPDX-License-Identifier: MIT

//! Whether a gauge has the chemistry of an image.

use crate::error::{Cause, Error, Result};
use ti_gauge::chip::Chip;
use ti_gauge::image::Chemistry;

/// Checks that a gauge has the chemistry of an image, which an import cannot write. With `told` a person vouches for it.
pub fn check(
    name: &str,
    chip: &Chip,
    expected: Chemistry,
    (chem_id, told): (&str, &str),
    ask: impl FnOnce(u16) -> Result<u16>,
) -> Result<String> {
    /// Set if the chemistry's data does not match its stored sum.
    const DIFFERS: u16 = 0x8000;
    let chem_id = match chem_id {
        "" => "CHEM_ID unknown".to_string(),
        id => format!("CHEM_ID {id}"),
    };
    let refuse = |why: String| {
        let why = format!(
            "{why}. An import does not write the chemistry: program it with TI's tools, or {told} if \
             the image was made from a gauge with that CHEM_ID"
        );
        Err(Error::new(name, Cause::Invalid, why))
    };
    let sum = chip.subcommands.iter().find(|row| row.name == "STATIC_CHEM_DF_CHKSUM");
    let (Some(sum), Chemistry::Sum(expected)) = (sum, expected) else {
        return refuse(format!("whether it has the image's chemistry is unknown ({chem_id})"));
    };
    match ask(sum.code)? {
        sum if sum == expected => Ok(format!("same chemistry ({chem_id}, checksum 0x{sum:04x})")),
        sum if sum & DIFFERS != 0 => {
            refuse(format!("it reports that its own chemistry is damaged ({chem_id}, checksum 0x{sum:04x})"))
        }
        sum => refuse(format!(
            "another chemistry: {chem_id}, checksum 0x{sum:04x}, but the image has checksum 0x{expected:04x}"
        )),
    }
}
