//! Changes as blocks: which windows of data flash they touch, and what those hold before and after.

use std::ops::Range;

use super::schemes::sequence;
use super::{Change, Place};
use crate::chip::{Chip, FLAT, FLAT_FLASH, Kind, Parameter, Scheme};
use crate::codec::{self, WINDOW};
use crate::error::Result;
use crate::gauge::Gauge;
use crate::value::Type;

/// A 32-byte piece of data flash, as the gauge shows it in its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Subclass id, or [`FLAT`].
    pub(super) subclass: u8,
    /// Offset, or flat address, of the window's first byte.
    pub(super) base: u16,
}

/// A set of positions in a window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Bytes(pub(crate) u32);

impl Bytes {
    /// Those positions for which `is` holds.
    pub(crate) fn of(is: impl Fn(usize) -> bool) -> Self {
        Self((0..WINDOW).filter(|&at| is(at)).fold(0, |set, at| set | 1 << at))
    }

    pub(crate) fn has(self, at: usize) -> bool {
        self.0 >> at & 1 != 0
    }

    /// Its positions, in ascending order.
    pub(crate) fn iter(self) -> impl Iterator<Item = usize> {
        (0..WINDOW).filter(move |&at| self.has(at))
    }

    fn insert(&mut self, at: usize) {
        self.0 |= 1 << at;
    }

    pub(super) fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(super) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

/// A block that a change touches.
#[derive(Clone)]
pub(super) struct Dirty {
    pub(super) place: Window,
    /// Content as read.
    pub(super) old: [u8; WINDOW],
    /// Content to be written.
    pub(super) new: [u8; WINDOW],
    /// What the changed parameters occupy.
    pub(super) written: Bytes,
    /// What the gauge itself may rewrite at any moment, and no change touches.
    pub(super) learned: Bytes,
}

impl Dirty {
    /// The runs of bytes to send: from one that differs to another, but never a learned byte in between, which
    /// may have moved since it was read.
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

    /// Restricts a block to one run of its changes.
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

    /// A block next to those that change, whose content is known.
    pub(super) fn is_neighbour(&self) -> bool {
        self.written.0 == 0
    }

    /// The first byte that differs from `wanted`, learned ones left out.
    pub(super) fn differs(&self, stored: &[u8; WINDOW], wanted: &[u8; WINDOW]) -> Option<usize> {
        (0..WINDOW).find(|&at| stored[at] != wanted[at] && !self.learned.has(at))
    }
}

impl Window {
    /// The positions of `count` bytes from an offset on, as far as they are in the window.
    fn covers(self, offset: u16, count: usize) -> Bytes {
        let (base, start) = (usize::from(self.base), usize::from(offset));
        Bytes::of(|at| (start..start + count).contains(&(base + at)))
    }

    /// Names the byte at a position of the window, for a message.
    pub(super) fn name(self, at: usize) -> String {
        let offset = usize::from(self.base) + at;
        match self.subclass {
            FLAT => Place { subclass: FLAT, offset: offset as u16 }.to_string(),
            subclass => format!("subclass {subclass} offset {offset}"),
        }
    }
}

impl Change {
    /// For each byte, its window and its position there.
    pub(super) fn windows(&self) -> impl Iterator<Item = (Window, usize)> {
        let offsets = (self.place.offset..).take(self.bytes.len());
        offsets.map(move |offset| locate(self.place.subclass, offset))
    }
}

/// The window that shows an offset of a subclass, or an address, and the position in that window. Windows are rows
/// of flash on every part: a loss of power may damage the whole row that is being programmed.
pub(super) fn locate(subclass: u8, offset: u16) -> (Window, usize) {
    let at = usize::from(offset) % WINDOW;
    (Window { subclass, base: offset - at as u16 }, at)
}

/// Reads every block that the changes touch and applies them to a copy.
pub(super) fn gather(gauge: &mut Gauge, changes: &[Change]) -> Result<Vec<Dirty>> {
    let mut dirty: Vec<Dirty> = Vec::new();
    for change in changes {
        for (number, ((place, at), &byte)) in change.windows().zip(&change.bytes).enumerate() {
            let index = match dirty.iter().position(|block| block.place == place) {
                Some(index) => index,
                None => {
                    let old = sequence(gauge).load(gauge, place)?;
                    let learned = learned(gauge.chip, place);
                    dirty.push(Dirty { place, old, new: old, written: Bytes::default(), learned });
                    dirty.len() - 1
                }
            };
            let block = &mut dirty[index];
            let kept = change.kept_bits(number);
            block.new[at] = byte & !kept | block.old[at] & kept;
            block.written.insert(at);
            block.learned = block.learned.without(block.written);
        }
        if is_same_string(change, &dirty) {
            for (place, at) in change.windows() {
                dirty
                    .iter_mut()
                    .filter(|block| block.place == place)
                    .for_each(|block| block.new[at] = block.old[at]);
            }
        }
    }
    // In the order of the manual's table, which is that of the addresses.
    dirty.sort_by_key(|block| (block.place.subclass, block.place.base));
    Ok(dirty)
}

/// Whether a change gives a string the value that it has. Its bytes then remain as they are, also those after its end
/// and a length that is larger than the field: they are no part of the value.
fn is_same_string(change: &Change, dirty: &[Dirty]) -> bool {
    let Some((_, Parameter { kind: kind @ Type::S(_), .. })) = change.row else { return false };
    codec::decode(*kind, &old_bytes(change, dirty)) == codec::decode(*kind, &change.bytes)
}

/// The bytes of a window that the gauge itself updates.
pub(super) fn learned(chip: &Chip, place: Window) -> Bytes {
    let rows = chip.subclasses.iter().filter(|row| row.id == place.subclass);
    let learned = rows.flat_map(|row| row.parameters).filter(|parameter| parameter.learned);
    learned
        .map(|parameter| place.covers(parameter.offset, parameter.kind.size()))
        .fold(Bytes::default(), Bytes::with)
}

/// Whether data flash of a part with a flat address space has a row at an address. Beyond its ends the same word is a
/// subcommand, or nothing that a manual names.
pub(super) fn has_address(chip: &Chip, base: u16) -> bool {
    match chip.access.scheme {
        Scheme::Mac => FLAT_FLASH.contains(&base),
        // Where this data memory ends is not documented.
        _ => chip.subclasses.iter().filter(|row| row.id == FLAT).any(|row| {
            let end = row.start() + row.length;
            base < end && row.start() < base.saturating_add(WINDOW as u16)
        }),
    }
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

/// Number of blocks that the changes touch.
pub(super) fn blocks(changes: &[Change]) -> usize {
    let places: Vec<Window> = changes.iter().flat_map(Change::windows).map(|(place, _)| place).collect();
    (0..places.len()).filter(|&at| !places[..at].contains(&places[at])).count()
}

pub(super) fn old_bytes(change: &Change, dirty: &[Dirty]) -> Vec<u8> {
    let byte = |(place, at)| Some(dirty.iter().find(|block| block.place == place)?.old[at]);
    change.windows().filter_map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_is_named_as_its_file() {
        assert_eq!(Window { subclass: FLAT, base: 0x41a0 }.name(0x16), "flash/0x41b6");
        assert_eq!(Window { subclass: 80, base: 32 }.name(21), "subclass 80 offset 53");
    }
}
