// SPDX-License-Identifier: MIT

//! Changes as blocks: which windows of data flash they touch, and what those hold before and after.

use super::Change;
use super::window::{Planned, Window, learned, locate};
use crate::chip::Parameter;
use crate::codec::{Bytes, WINDOW};
use crate::error::Result;
use crate::gauge::Gauge;
use crate::value::Type;

impl Change {
    pub(super) fn windows(&self) -> impl Iterator<Item = (Window, usize)> {
        let offsets = (self.place.offset..).take(self.bytes.len());
        offsets.map(move |offset| locate(self.place.subclass, offset))
    }
}

/// Reads every block that the changes touch by `load`, and applies them to a copy.
pub(super) fn gather(
    gauge: &mut Gauge,
    changes: &[Change],
    load: impl Fn(&mut Gauge, Window) -> Result<[u8; WINDOW]>,
) -> Result<Vec<Planned>> {
    let mut planned: Vec<Planned> = Vec::new();
    for change in changes {
        for (number, ((place, at), &byte)) in change.windows().zip(&change.bytes).enumerate() {
            let index = match planned.iter().position(|block| block.place == place) {
                Some(index) => index,
                None => {
                    let old = load(gauge, place)?;
                    let learned = learned(gauge.chip, place);
                    planned.push(Planned { place, old, new: old, written: Bytes::default(), learned });
                    planned.len() - 1
                }
            };
            let block = &mut planned[index];
            let kept = change.kept_bits(number);
            block.new[at] = byte & !kept | block.old[at] & kept;
            block.written.insert(at);
            block.learned = block.learned.without(block.written);
        }
        if is_same_string(change, &planned) {
            for (place, at) in change.windows() {
                planned
                    .iter_mut()
                    .filter(|block| block.place == place)
                    .for_each(|block| block.new[at] = block.old[at]);
            }
        }
    }
    // In the order of the manual's table, which is that of the addresses.
    arrange(&mut planned, &|block| (block.place.subclass, block.place.base));
    Ok(planned)
}

/// Sorts blocks, which is one function whatever the key is.
pub(super) fn arrange(planned: &mut [Planned], key: &dyn Fn(&Planned) -> (u8, u16)) {
    planned.sort_by_key(key);
}

/// Whether a string keeps its value. Then its bytes stay, also those after its end, and a length larger than the field.
fn is_same_string(change: &Change, planned: &[Planned]) -> bool {
    let Some((_, Parameter { kind: Type::S(_), .. })) = change.row else { return false };
    change.value_of(&old_bytes(change, planned)) == change.value_of(&change.bytes)
}

pub(super) fn blocks(changes: &[Change]) -> usize {
    let places: Vec<Window> = changes.iter().flat_map(Change::windows).map(|(place, _)| place).collect();
    (0..places.len()).filter(|&at| !places[..at].contains(&places[at])).count()
}

pub(super) fn old_bytes(change: &Change, planned: &[Planned]) -> Vec<u8> {
    let byte = |(place, at)| Some(planned.iter().find(|block| block.place == place)?.old[at]);
    change.windows().filter_map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::FLAT;

    #[test]
    fn a_byte_is_named_as_its_file() {
        assert_eq!(Window { subclass: FLAT, base: 0x41a0 }.name(0x16), "flash/0x41b6");
        assert_eq!(Window { subclass: 80, base: 32 }.name(21), "subclass 80 offset 53");
    }
}
