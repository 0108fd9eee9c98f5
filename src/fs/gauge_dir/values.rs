// SPDX-License-Identifier: MIT

//! `gauge/values` and `gauge/owner_values`: what a user may read of a gauge in one file, for programs that read hundreds of
//! gauges.

use std::fmt::Write;
use std::sync::Arc;

use super::{FILES, File, GROUPS, Mode, Supply};
use crate::fs::attribute;

pub(super) const ALL: &str = "values";
pub(super) const OWNER: &str = "owner_values";
/// What only the second one has.
const OWN: [&str; 2] = ["seal", "poll_interval"];
/// The folder whose files are not among them.
const REGISTERS: Option<&str> = Some("registers");

/// Whether a file is one of the two. They are always there, and are not rendered to find that out: they are long.
pub(super) fn is_here(file: &File) -> bool {
    [ALL, OWNER].contains(&file.name)
}

fn is_told(file: &File, mode: Mode) -> bool {
    (file.mode == Mode::Public && file.name != ALL) || (mode != Mode::Public && OWN.contains(&file.name))
}

/// Lines `FILE=TEXT`, all of one poll. A text of several lines has as many here, and a file that is not there has none.
pub(super) fn text(gauge: &Supply, mode: Mode) -> String {
    loop {
        let published = gauge.published();
        let text = lines(gauge, mode);
        // Else the rows may be of two polls.
        if Arc::ptr_eq(&published, &gauge.published()) {
            return text;
        }
    }
}

fn lines(gauge: &Supply, mode: Mode) -> String {
    let mut lines = String::new();
    let mut tell = |folder: &str, name: &str, text: &str| {
        for line in text.trim_end().split('\n') {
            // Writing to a String does not fail.
            let _ = writeln!(lines, "{folder}{name}={line}");
        }
    };
    let snapshot = gauge.fresh();
    for (attribute, text) in attribute::listed(&gauge.reading(snapshot.as_deref())) {
        tell("", attribute.name(), &text);
    }
    for file in FILES.iter().filter(|file| is_told(file, mode)) {
        if let Some(text) = (file.show)(gauge) {
            tell("gauge/", file.name, &text);
        }
    }
    for group in GROUPS.iter().filter(|group| group.folder != REGISTERS) {
        let folder = group.folder.map_or("gauge/".into(), |folder| format!("gauge/{folder}/"));
        for (number, name) in (group.list)(gauge) {
            if let Some(text) = (group.show)(gauge, number) {
                tell(&folder, &name, &text);
            }
        }
    }
    lines
}
