// SPDX-License-Identifier: MIT

//! Files that say which host has saved them: several may share a folder, with places of the same names.

use std::path::Path;

use gauge_bus::regular;
use ti_gauge::image;
use ti_gauge::journal::Machine;

/// The text with this host in its first line, which is a comment.
pub(super) fn signed(text: &str) -> String {
    format!("# {}\n{text}", Machine::this())
}

pub(super) fn unsigned(text: &str) -> &str {
    text.split_once('\n').filter(|(line, _)| machine(line).is_some()).map_or(text, |(_, rest)| rest)
}

/// Whether this host has saved a file. A file of an earlier version, which names no host, may be its own.
pub(super) fn is_own(path: &Path) -> bool {
    let text = regular::read_text(path, image::LONGEST).unwrap_or_default();
    let line = text.split_once('\n').map_or(text.as_str(), |(line, _)| line);
    machine(line).is_none_or(|machine| machine.is(Machine::this()))
}

fn machine(line: &str) -> Option<Machine> {
    Machine::parse(line.strip_prefix("# ")?)
}

/// A name for a file that is being written, which no other host has.
pub(super) fn temporary(key: &str, what: &str) -> String {
    format!("{key}.{}.{what}.new", Machine::this().id())
}
