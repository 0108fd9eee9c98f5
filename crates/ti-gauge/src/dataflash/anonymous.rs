// SPDX-License-Identifier: MIT

//! A recording without what belongs to one pack or to its maker: serial numbers, dates, lots, texts and keys.
//!
//! A block of data flash with such a parameter is left out as a whole, so that its checksum gives nothing away
//! either and every block that is left adds up. A register that shows a serial number reads 0.

use std::ops::Range;

use super::window::Window;
use super::window::holds_keys;
use crate::chip::{Chip, FLAT, Kind, Scheme, Subclass};
use crate::codec::WINDOW;
use crate::gauge::dialect;
use crate::value::Type;
use gauge_bus::replay::Touch;
use gauge_bus::trace::Event;

/// Bytes that two readings have at least in common if they show the same block.
const ALIKE: usize = 8;

/// Index of the first subclass of one block without key, serial number or text: it shows whether data flash is readable.
pub fn sample(chip: &Chip) -> Option<usize> {
    chip.subclasses.iter().position(|subclass| {
        let places = windows(subclass);
        subclass.kind != Kind::Security
            && !subclass.parameters.is_empty()
            && places.len() == 1
            && !places.iter().any(|&place| is_private(chip, place))
    })
}

/// Registers, Power and Calibration Data: what decides which voltage flash needs, and how currents are measured.
const DECIDING: [u8; 3] = [64, 68, 104];
/// Where addresses begin that owners have found lower than printed.
const DOUBTED: u16 = 0x4100;

/// The subclasses of a report: the sample and what could confirm beliefs, without keys, serial numbers or texts. Where only
/// names are known every block could confirm them.
pub fn samples(chip: &Chip) -> Vec<usize> {
    let is_open = |subclass: &Subclass| {
        let places = windows(subclass);
        let is_anyones = !(chip.has_only_names() && subclass.is_makers());
        let is_shared = subclass.kind != Kind::Security && is_anyones;
        is_shared && !places.iter().any(|&place| is_private(chip, place))
    };
    let rows = || chip.subclasses.iter().enumerate().filter(|(_, row)| is_open(row));
    let decides = |row: &Subclass| DECIDING.contains(&row.id) || chip.has_only_names();
    let deciding = rows().filter(|(_, row)| decides(row) && !row.parameters.is_empty());
    let is_doubted = |row: &Subclass| chip.access.scheme == Scheme::Mac && row.start() >= DOUBTED;
    let doubted = rows().find(|(_, row)| is_doubted(row));
    let mut all: Vec<_> = sample(chip).into_iter().collect();
    all.extend(deciding.chain(doubted).map(|(index, _)| index));
    all.sort_unstable();
    all.dedup();
    all
}

fn windows(subclass: &Subclass) -> Vec<Window> {
    let first = subclass.start() / WINDOW as u16 * WINDOW as u16;
    let bases = (first..subclass.start() + subclass.length).step_by(WINDOW);
    bases.map(|base| Window { subclass: subclass.id, base }).collect()
}

fn is_private(chip: &Chip, place: Window) -> bool {
    let rows = chip.subclasses.iter().filter(|row| row.id == place.subclass).flat_map(|row| row.parameters);
    let base = usize::from(place.base);
    let mut inside = rows.filter(|parameter| {
        let start = usize::from(parameter.offset);
        start < base + WINDOW && base < start + parameter.kind.size()
    });
    holds_keys(chip, place)
        || inside.any(|parameter| parameter.names_pack() || matches!(parameter.kind, Type::S(_)))
}

struct Selected<'a> {
    chip: &'a Chip,
    bytes: [u8; 2],
    /// A subcommand has put its answer there instead.
    is_answer: bool,
}

impl Selected<'_> {
    fn note(&mut self, write: &[u8]) {
        for (touch, byte) in dialect::of(self.chip).touches(write) {
            match touch {
                Touch::Subcommand(_) => self.is_answer = self.chip.access.scheme.is_flat(),
                Touch::Selects(at) => (self.bytes[at], self.is_answer) = (byte, false),
                _ => {}
            }
        }
    }

    /// Follows which block is selected. If the event is about a private one, returns what it shows of that.
    fn private_part<'a>(&mut self, event: &'a Event) -> Option<&'a [u8]> {
        let Event::Transfer { write, read, answer, .. } = event else { return None };
        // A read without a register shows the one that was read before.
        let Some((&start, written)) = write.split_first() else { return Some(&[]) };
        self.note(write);
        let dialect = dialect::of(self.chip);
        if !dialect.is_of_window(start, written.len() + read) {
            return None;
        }
        let echo = match answer {
            Ok(bytes) if written.is_empty() => dialect.shows(start, bytes).selection,
            _ => None,
        };
        let is_private = !self.is_answer && self.shows_private(self.bytes)
            || echo.is_some_and(|echo| self.shows_private(echo));
        is_private.then(|| window(self.chip, event))
    }

    fn shows_private(&self, bytes: [u8; 2]) -> bool {
        let place = if self.chip.access.scheme.is_flat() {
            Window { subclass: FLAT, base: u16::from_le_bytes(bytes) }
        } else {
            Window { subclass: bytes[0], base: u16::from(bytes[1]) * WINDOW as u16 }
        };
        is_private(self.chip, place)
    }
}

/// Removes private blocks from a recording, and puts 0 for the serial number.
pub fn anonymous(chip: &Chip, mut events: Vec<Event>) -> Vec<Event> {
    let mut selected = Selected { chip, bytes: [0; 2], is_answer: true };
    let mut private: Vec<Vec<u8>> = Vec::new();
    events.retain(|event| match selected.private_part(event) {
        Some(bytes) => {
            private.push(bytes.to_vec());
            false
        }
        None => true,
    });
    events.retain(|event| !private.iter().any(|block| alike(block, window(chip, event))));
    if let Some(serial) = chip.serial_register().and_then(|register| register.source.command()) {
        events.iter_mut().for_each(|event| hide(serial..serial + 2, event));
    }
    events
}

/// What a read shows of the window, from its first byte on.
fn window<'a>(chip: &Chip, event: &'a Event) -> &'a [u8] {
    let Event::Transfer { write, answer: Ok(bytes), .. } = event else { return &[] };
    match write[..] {
        [start] => {
            let shown = dialect::of(chip).shows(start, bytes);
            if shown.at == 0 { shown.window } else { &[] }
        }
        _ => &[],
    }
}

/// Whether two readings are of one block, as far as both go. A gauge that loads blocks late shows the one before.
fn alike(one: &[u8], other: &[u8]) -> bool {
    let length = one.len().min(other.len()).min(WINDOW);
    length >= ALIKE && one[..length] == other[..length]
}

fn hide(registers: Range<u8>, event: &mut Event) {
    if let Event::Transfer { write, answer: Ok(bytes), .. } = event
        && let [start] = write[..]
    {
        for (_, byte) in (start..=u8::MAX).zip(bytes).filter(|(at, _)| registers.contains(at)) {
            *byte = 0;
        }
    }
}
