// SPDX-License-Identifier: MIT

//! Rows that a loss of power has erased. Erased flash reads 0xff, which most parameters cannot hold.

use super::window::Window;
use super::window::{holds_keys, locate};
use super::{Place, Row};
use crate::chip::{Chip, Kind, Range};
use crate::codec::{Layout, WINDOW};
use crate::error::{Cause, Error};
use crate::value::Value;

const ERASED: u8 = 0xff;

/// The parameters erased with the end of their row: all from there on are 0xff, and these cannot be. RAM has no rows.
pub fn erased(chip: &'static Chip, bytes: impl Fn(Row) -> Option<Vec<u8>>) -> Vec<Row> {
    let mut lost = Vec::new();
    for (_, rows) in rows(chip) {
        let ends = erased_end(&rows, &bytes);
        lost.extend(ends.into_iter().filter(|row| is_forbidden(chip.layout, *row)));
    }
    lost
}

/// The parameters erased since an earlier reading, whatever they can hold: at least two of them, or four bytes.
pub fn erased_since(
    chip: &'static Chip,
    before: impl Fn(Row) -> Option<Vec<u8>>,
    bytes: impl Fn(Row) -> Option<Vec<u8>>,
) -> Vec<Row> {
    let mut lost = Vec::new();
    for (_, rows) in rows(chip) {
        let was = |row: &Row| before(*row).is_some_and(|bytes| bytes.iter().any(|&byte| byte != ERASED));
        let ends: Vec<Row> = erased_end(&rows, &bytes).into_iter().filter(was).collect();
        let size: usize = ends.iter().map(|(_, parameter)| parameter.kind.size()).sum();
        if ends.len() >= 2 || size >= 4 {
            lost.extend(ends);
        }
    }
    lost
}

/// The error for a pack with erased parameters. `remedy` names what they can be written from.
pub fn says_erased(lost: &[Row], remedy: &str) -> Error {
    let Some((row, more)) = lost.split_first() else {
        return Error::new("", Cause::BadChecksum, String::new());
    };
    let place = locate(row.0.id, row.1.offset).0;
    let others = match more.len() {
        0 => String::new(),
        1 => " and another parameter".into(),
        count => format!(" and {count} other parameters"),
    };
    let remedy = if remedy.is_empty() {
        "write all of them in one transaction, from a backup for example"
    } else {
        remedy
    };
    let why = format!(
        "{} ({}){others} read 0xff to the end of their row ({}), as flash does that a loss of power has erased, and nothing \
         else is written: {remedy}",
        row.1.name,
        Place::of(*row),
        place.name(0)
    );
    Error::new("", Cause::BadChecksum, why)
}

pub(super) fn erased_in(chip: &'static Chip, place: Window, content: &[u8; WINDOW]) -> Vec<Row> {
    let inside = |(subclass, parameter): Row| {
        let start = parameter.offset.checked_sub(place.base).filter(|_| subclass.id == place.subclass)?;
        let start = usize::from(start);
        content.get(start..start + parameter.kind.size()).map(<[u8]>::to_vec)
    };
    let rows = rows(chip).into_iter().find(|(window, _)| *window == place).map(|(_, rows)| rows);
    let rows: Vec<Row> = rows.into_iter().flatten().filter(|row| inside(*row).is_some()).collect();
    erased_end(&rows, inside).into_iter().filter(|row| is_forbidden(chip.layout, *row)).collect()
}

/// The rows of flash without keys, and the parameters that end in each of them, by their places.
fn rows(chip: &'static Chip) -> Vec<(Window, Vec<Row>)> {
    let mut found: Vec<(Window, Vec<Row>)> = Vec::new();
    if chip.volatile.is_some() {
        return found;
    }
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        for parameter in subclass.parameters {
            let (place, _) = locate(subclass.id, parameter.offset + parameter.kind.size() as u16 - 1);
            match found.iter_mut().find(|(window, _)| *window == place) {
                _ if holds_keys(chip, place) => {}
                Some((_, rows)) => rows.push((subclass, parameter)),
                None => found.push((place, vec![(subclass, parameter)])),
            }
        }
    }
    for (_, rows) in &mut found {
        rows.sort_by_key(|(_, parameter)| parameter.offset);
    }
    found
}

fn erased_end(rows: &[Row], bytes: impl Fn(Row) -> Option<Vec<u8>>) -> Vec<Row> {
    let erased = |row: &&Row| bytes(**row).is_some_and(|bytes| bytes.iter().all(|&byte| byte == ERASED));
    let mut ends: Vec<Row> = rows.iter().rev().take_while(erased).copied().collect();
    ends.reverse();
    ends
}

fn is_forbidden(layout: Layout, (_, parameter): Row) -> bool {
    let value = layout.decode(parameter.kind, &vec![ERASED; parameter.kind.size()]);
    match (&parameter.range, value) {
        (Range::Int { min, max, .. }, Value::Int(value)) => !(*min..=*max).contains(&value),
        (Range::Float { min, max, .. }, Value::Float(value)) => !(*min..=*max).contains(&value),
        // Its length does not fit.
        (Range::Text { .. }, _) => true,
        _ => false,
    }
}
