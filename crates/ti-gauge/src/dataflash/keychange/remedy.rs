// SPDX-License-Identifier: MIT

//! What a person does about a change of keys that was cut short.

use super::ring::LENGTH_OF_KEY;
use crate::keys::Name;

pub(in crate::dataflash) fn way_out(names: &[Name]) -> String {
    let commands: Vec<String> = names
        .iter()
        .map(|name| format!("gaugefs keys change GAUGE {} --key-file OLD --new-key-file NEW", name.as_str()))
        .collect();
    format!(
        "make the same change once more, with the same two keys ({}); to undo it, exchange the two files. Keys of the \
         mount's key file that were erased with it are put back, too",
        commands.join(", then ")
    )
}

/// What is told of keys that a change which is over otherwise has not put back.
pub(super) fn still_lost(names: &[Name]) -> String {
    let names: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
    let name = names.join(" and ");
    format!(
        "a change of keys was cut short, and the {name} key may have been lost with it; put it back with gaugefs keys \
         change GAUGE {name} --key-file OLD --new-key-file NEW, where OLD has `authentication = {}` if it was erased, or \
         give it up: gaugefs settle GAUGE --discard",
        "f".repeat(2 * LENGTH_OF_KEY)
    )
}
