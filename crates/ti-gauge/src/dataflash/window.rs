// SPDX-License-Identifier: MIT

//! The pieces in which data flash is read and written: what a window shows, and what a write changes in it.

use std::ops::Range;

use super::Place;
use crate::chip::{Chip, FLAT, Kind};
use crate::codec::{Bytes, WINDOW};

/// A 32-byte piece of data flash, as the gauge shows it in its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Subclass id, or [`FLAT`].
    pub(super) subclass: u8,
    /// Offset, or flat address, of the window's first byte.
    pub(super) base: u16,
}

#[derive(Clone)]
pub(super) struct Planned {
    pub(super) place: Window,
    pub(super) old: [u8; WINDOW],
    pub(super) new: [u8; WINDOW],
    /// What the changed parameters occupy.
    pub(super) written: Bytes,
    /// What the gauge itself may rewrite at any moment, and no change touches, or it has rewritten since.
    pub(super) learned: Bytes,
}

impl Planned {
    /// The runs of bytes to send, from one that differs to another, without learned bytes, which may have moved.
    pub(super) fn runs(&self) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for at in (0..WINDOW).filter(|&at| self.old[at] != self.new[at]) {
            match runs.last_mut() {
                Some(run) if (run.end..at).all(|between| !self.learned.has(between)) => run.end = at + 1,
                _ => runs.push(at..at + 1),
            }
        }
        runs
    }

    pub(super) fn only(&self, run: Range<usize>) -> Self {
        let mut new = self.old;
        new[run.clone()].copy_from_slice(&self.new[run]);
        Self { new, ..self.clone() }
    }

    /// Makes a block change from `present` to `new`. A learned byte that goes back is written like any other.
    pub(super) fn replacing(&self, present: [u8; WINDOW], new: [u8; WINDOW]) -> Self {
        let learned = Bytes::of(|at| self.learned.has(at) && present[at] == new[at]);
        Self { old: present, new, learned, ..self.clone() }
    }

    /// Whether a loss of power has erased the row, or a part of it: its learned bytes are lost then.
    pub(super) fn is_erased(&self, present: &[u8; WINDOW]) -> bool {
        let lost = |at| present[at] == 0xff && self.old[at] != 0xff && self.new[at] != 0xff;
        (0..WINDOW).any(|at| lost(at) && !self.learned.has(at))
    }

    /// Written bytes that the gauge has rewritten since: neither the write nor a loss of power explains them.
    pub(super) fn rewritten(&self, chip: &Chip, stored: &[u8; WINDOW]) -> Bytes {
        let is_own = |at: usize| ![self.old[at], self.new[at], 0xff].contains(&stored[at]);
        let values = learned_values(chip, self.place).filter(|value| value.without(self.written) != *value);
        values.filter(|value| value.iter().any(is_own)).fold(Bytes::default(), Bytes::with)
    }

    /// The block with that left to the gauge, as what no change touches.
    pub(super) fn as_rewritten(&self, chip: &Chip, stored: &[u8; WINDOW]) -> Self {
        Self { learned: self.learned.with(self.rewritten(chip, stored)), ..self.clone() }
    }

    pub(super) fn is_neighbour(&self) -> bool {
        self.written.0 == 0
    }

    /// Whether a loss of power while one of two blocks is programmed may disturb the other.
    pub(super) fn is_beside(&self, other: &Self) -> bool {
        let (one, other) = (self.place, other.place);
        one.subclass == other.subclass && one.base.abs_diff(other.base) <= WINDOW as u16
    }

    /// The first byte that differs from `wanted`, learned ones left out.
    pub(super) fn differs(&self, stored: &[u8; WINDOW], wanted: &[u8; WINDOW]) -> Option<usize> {
        (0..WINDOW).find(|&at| stored[at] != wanted[at] && !self.learned.has(at))
    }
}

impl Window {
    fn covers(self, offset: u16, count: usize) -> Bytes {
        let (base, start) = (usize::from(self.base), usize::from(offset));
        Bytes::of(|at| (start..start + count).contains(&(base + at)))
    }

    pub(super) fn name(self, at: usize) -> String {
        let offset = usize::from(self.base) + at;
        match self.subclass {
            FLAT => Place { subclass: FLAT, offset: offset as u16 }.to_string(),
            subclass => format!("subclass {subclass} offset {offset}"),
        }
    }
}

/// The window of an offset, and the position in it. Windows are rows of flash: a loss of power may damage all of one.
pub(super) fn locate(subclass: u8, offset: u16) -> (Window, usize) {
    let at = usize::from(offset) % WINDOW;
    (Window { subclass, base: offset - at as u16 }, at)
}

pub(super) fn learned(chip: &Chip, place: Window) -> Bytes {
    learned_values(chip, place).fold(Bytes::default(), Bytes::with)
}

fn learned_values(chip: &Chip, place: Window) -> impl Iterator<Item = Bytes> {
    let rows = chip.subclasses.iter().filter(move |row| row.id == place.subclass);
    let learned = rows.flat_map(|row| row.parameters).filter(|parameter| parameter.learned);
    learned.map(move |parameter| place.covers(parameter.offset, parameter.kind.size()))
}

/// Whether flat data flash has that row. Beyond its ends the word is a subcommand, or nothing that a manual names.
pub(super) fn has_address(chip: &Chip, base: u16) -> bool {
    if !chip.flat.is_empty() {
        return chip.flat.contains(&base);
    }
    chip.subclasses.iter().filter(|row| row.id == FLAT).any(|row| {
        let end = row.start() + row.length;
        base < end && row.start() < base.saturating_add(WINDOW as u16)
    })
}

/// The bytes of a window that belong to keys. Only a flat window can extend beyond its own subclass.
pub(super) fn secrets(chip: &Chip, place: Window) -> Bytes {
    let rows = chip.subclasses.iter().filter(|row| row.kind == Kind::Security && row.id == place.subclass);
    rows.map(|row| place.covers(row.start(), row.length.into())).fold(Bytes::default(), Bytes::with)
}

/// Whether a window holds keys: of a flat part, also one that is read for what is beside them.
pub(super) fn holds_keys(chip: &Chip, place: Window) -> bool {
    secrets(chip, place) != Bytes::default()
}
