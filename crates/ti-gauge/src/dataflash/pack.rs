// SPDX-License-Identifier: MIT

//! What is known of the pack: its blocks and its marks. From the factory all packs have the same serial number, so type,
//! firmware and serial number do not make two packs one. Calibration does: it is measured for each board.

use std::collections::BTreeMap;

use super::Row;
use super::window::Window;
use super::window::{holds_keys, learned, locate};
use crate::chip::{Chip, FLAT, Range};
use crate::codec::{Bytes, WINDOW};
use crate::journal::{Identity, Mark, Plan};
use crate::value::Value;

/// Blocks as they were last read or written, while the gauge has answered.
#[derive(Clone, Debug, Default)]
pub(super) struct Known(BTreeMap<(u8, u16), [u8; WINDOW]>);

pub(super) static NOTHING: Known = Known(BTreeMap::new());

impl Known {
    /// Notes a block. One that holds keys is not kept.
    pub(super) fn note(&mut self, chip: &Chip, place: Window, content: [u8; WINDOW]) {
        if !holds_keys(chip, place) {
            self.0.insert((place.subclass, place.base), content);
        }
    }

    pub(super) fn get(&self, place: Window) -> Option<[u8; WINDOW]> {
        self.0.get(&(place.subclass, place.base)).copied()
    }

    /// These blocks of them, as far as they are known.
    pub(super) fn only(&self, places: &[Window]) -> Self {
        let known = places.iter().filter_map(|place| Some(((place.subclass, place.base), self.get(*place)?)));
        Self(known.collect())
    }

    pub(super) fn forget(&mut self, place: Window) {
        self.0.remove(&(place.subclass, place.base));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn bytes(&self, (subclass, parameter): Row) -> Option<Vec<u8>> {
        let places = (parameter.offset..).take(parameter.kind.size());
        places
            .map(|offset| locate(subclass.id, offset))
            .map(|(place, at)| Some(self.get(place)?[at]))
            .collect()
    }

    pub(super) fn marks(&self, chip: &'static Chip) -> Vec<Mark> {
        let mark = |&(id, offset): &(u8, u16)| {
            let bytes = self.bytes(row(chip, id, offset)?)?;
            Some(Mark { subclass: id, offset, bytes })
        };
        chip.preflight.marks.iter().filter_map(mark).collect()
    }

    /// The first mark in a block that differs from what is known: another pack, or another program has written.
    pub(super) fn contradicts(&self, chip: &'static Chip, place: Window, now: &[u8; WINDOW]) -> Option<Row> {
        let before = self.get(place)?;
        let moving = learned(chip, place);
        let rows = chip.preflight.marks.iter().filter_map(|&(id, offset)| row(chip, id, offset));
        rows.filter(|(subclass, _)| subclass.id == place.subclass).find(|(_, parameter)| {
            let start = usize::from(parameter.offset);
            let inside = Bytes::of(|at| {
                (start..start + parameter.kind.size()).contains(&(usize::from(place.base) + at))
            });
            (0..WINDOW).any(|at| inside.has(at) && !moving.has(at) && before[at] != now[at])
        })
    }
}

#[derive(Debug, PartialEq, Eq)]
pub(super) enum Match {
    /// A value that differs from pack to pack is as it was.
    Certain,
    /// Nothing contradicts it, and nothing proves it: these are the values of every pack from the factory.
    Weak,
    /// The name of a value that is another one.
    Other(String),
}

/// Compares a plan's marks with a gauge; `stored` reads a window. A mark that the plan writes is one of two values.
pub(super) fn compare<E>(
    chip: &'static Chip,
    then: &Identity,
    now: &Identity,
    plan: &Plan,
    mut stored: impl FnMut(Window) -> Result<[u8; WINDOW], E>,
) -> Result<Match, E> {
    let planned = |place: Window| {
        plan.blocks.iter().find(|block| (block.subclass, block.base) == (place.subclass, place.base))
    };
    // Most marks share a window.
    let mut last: Option<(Window, [u8; WINDOW])> = None;
    let mut window = |place: Window| match last {
        Some((known, content)) if known == place => Ok(content),
        _ => stored(place).inspect(|content| last = Some((place, *content))),
    };
    let mut certain = false;
    for Mark { subclass: id, offset, bytes } in &plan.marks {
        let Some(row) = row(chip, *id, *offset) else { continue };
        // No gaugefs has written that.
        if row.1.kind.size() != bytes.len() {
            return Ok(Match::Other(row.1.name.into()));
        }
        let mut held = Vec::with_capacity(bytes.len());
        let mut torn = false;
        for (number, offset) in (*offset..).take(bytes.len()).enumerate() {
            let (place, at) = locate(*id, offset);
            let byte = window(place)?[at];
            // In a block of the plan each byte has been explained already.
            torn |= planned(place).is_some_and(|_| byte != bytes[number]);
            held.push(byte);
        }
        if torn {
            continue;
        }
        if row.1.learned {
            // A counter never goes back.
            if chip.layout.number(&held) < chip.layout.number(bytes) {
                return Ok(Match::Other(row.1.name.into()));
            }
        } else if held != *bytes {
            return Ok(Match::Other(row.1.name.into()));
        } else {
            certain |= distinguishes(chip, row, &held);
        }
    }
    if let Some(&(id, offset)) = chip.preflight.pack.as_ref().and_then(|pack| pack.rows.first())
        && let Some(row) = row(chip, id, offset)
    {
        let (place, _) = locate(id, offset);
        let serial = chip.layout.bytes_of(now.serial);
        if now.serial == then.serial {
            certain |= now.serial != 0 && distinguishes(chip, row, &serial);
        } else if planned(place).is_none() {
            return Ok(Match::Other("SerialNumber()".into()));
        }
    }
    Ok(if certain { Match::Certain } else { Match::Weak })
}

/// Whether the serial number that the gauge shows is not that of a plan, nor one that the plan may have left.
pub(super) fn shows_another(chip: &'static Chip, then: &Identity, now: &Identity, plan: &Plan) -> bool {
    let number = chip.preflight.pack.as_ref().and_then(|pack| pack.rows.first());
    let Some((place, _)) = number.map(|&(id, offset)| locate(id, offset)) else { return false };
    let is_planned =
        plan.blocks.iter().any(|block| (block.subclass, block.base) == (place.subclass, place.base));
    now.serial != then.serial && !is_planned
}

/// Whether the gauge shows a serial number that not every new pack has.
pub(super) fn is_named(chip: &'static Chip, now: &Identity) -> bool {
    let number = chip.preflight.pack.as_ref().and_then(|pack| pack.rows.first());
    let row = number.and_then(|&(id, offset)| row(chip, id, offset));
    row.is_some_and(|row| now.serial != 0 && distinguishes(chip, row, &chip.layout.bytes_of(now.serial)))
}

/// The marks of a pack after a plan was carried out or undone: some may be what it writes.
pub(super) fn marks_after(plan: &Plan, is_new: bool) -> Vec<Mark> {
    let after = |subclass: u8, offset: u16, byte: u8| {
        let (place, at) = locate(subclass, offset);
        let mut blocks = plan.blocks.iter();
        let block = blocks.find(|block| (block.subclass, block.base) == (place.subclass, place.base));
        block.map_or(byte, |block| if is_new { block.new[at] } else { block.old[at] })
    };
    let moved = |mark: &Mark| {
        let bytes =
            (mark.offset..).zip(&mark.bytes).map(|(offset, &byte)| after(mark.subclass, offset, byte));
        Mark { bytes: bytes.collect(), ..mark.clone() }
    };
    plan.marks.iter().map(moved).collect()
}

/// The serial number that a plan has, if it is in one of its blocks: the new one, or the old one.
pub(super) fn serial(chip: &'static Chip, plan: &Plan, is_new: bool) -> Option<u16> {
    let &(id, offset) = chip.preflight.pack.as_ref()?.rows.first()?;
    let (place, at) = locate(id, offset);
    let block =
        plan.blocks.iter().find(|block| (block.subclass, block.base) == (place.subclass, place.base))?;
    let bytes = if is_new { &block.new } else { &block.old };
    chip.serial_register().map(|_| chip.layout.word([bytes[at], bytes[at + 1]]))
}

/// Whether these are not the bytes of every pack from the factory, and not those of erased flash either.
pub fn distinguishes(chip: &Chip, (_, parameter): Row, bytes: &[u8]) -> bool {
    let default = match parameter.range {
        Range::Int { default, .. } => default.map(Value::Int),
        Range::Float { default, .. } => default.map(Value::Float),
        Range::Text { default } => default.map(|text| Value::Text(text.into())),
    };
    let blank = |blank: u8| bytes.iter().all(|&byte| byte == blank);
    match default.and_then(|default| chip.layout.encode(parameter.kind, &default)) {
        Some(default) => default != bytes && !blank(0) && !blank(0xff),
        // An offset is 0 until it has been measured; of a gain without a printed default nothing is known.
        None => matches!(parameter.range, Range::Int { .. }) && !blank(0) && !blank(0xff),
    }
}

fn row(chip: &'static Chip, id: u8, offset: u16) -> Option<Row> {
    let alike = chip.subclasses.iter().filter(|subclass| subclass.id == id);
    alike.into_iter().find_map(|subclass| Some((subclass, subclass.parameter(offset)?)))
}

/// The windows that hold the marks. The serial number is left out where a register shows it.
pub(super) fn mark_windows(chip: &'static Chip) -> Vec<Window> {
    let registered = chip.preflight.pack.as_ref().map_or(&[][..], |pack| pack.rows);
    let mut windows: Vec<Window> = Vec::new();
    for &(id, offset) in chip.preflight.marks.iter().filter(|mark| !registered.contains(mark)) {
        let Some((_, parameter)) = row(chip, id, offset) else { continue };
        let (place, _) = locate(id, offset);
        if !parameter.learned && !windows.contains(&place) {
            windows.push(place);
        }
    }
    windows
}

/// The windows beside one, in its subclass: a loss of power while flash is programmed may disturb them.
pub(super) fn neighbours(chip: &Chip, place: Window) -> Vec<Window> {
    let step = WINDOW as u16;
    let sides = [place.base.checked_sub(step), place.base.checked_add(step)];
    let inside = |base: &u16| {
        let mut alike = chip.subclasses.iter().filter(|row| row.id == place.subclass);
        place.subclass == FLAT || alike.any(|row| *base < row.stored())
    };
    let sides = sides.into_iter().flatten().filter(inside);
    let sides = sides.map(|base| Window { base, ..place });
    sides.filter(|place| !holds_keys(chip, *place)).collect()
}
