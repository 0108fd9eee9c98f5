// SPDX-License-Identifier: MIT

//! What a reading of data flash covers: all of a subclass, or the blocks that hold one parameter.

use std::ops::Range;

use super::Row;
use super::window::locate;
use crate::chip::Subclass;
use crate::codec::WINDOW;

/// A run of bytes of one subclass, which are read in one session.
#[derive(Clone, Debug)]
pub struct Part {
    pub(super) subclass: &'static Subclass,
    offsets: Range<u16>,
}

impl Part {
    /// All of a subclass.
    pub fn whole(subclass: &'static Subclass) -> Self {
        let start = subclass.start();
        Self { subclass, offsets: start..start + subclass.stored() }
    }

    /// The blocks that hold a parameter, as far as they are of its subclass: two where it crosses a border.
    pub fn of((subclass, parameter): Row) -> Self {
        let Range { start, end } = Self::whole(subclass).offsets;
        let (first, _) = locate(subclass.id, parameter.offset);
        let (last, _) = locate(subclass.id, parameter.offset + parameter.kind.size() as u16 - 1);
        Self { subclass, offsets: first.base.max(start)..end.min(last.base.saturating_add(WINDOW as u16)) }
    }

    /// The offset, or address, of its first byte.
    pub fn start(&self) -> u16 {
        self.offsets.start
    }

    pub(super) fn length(&self) -> usize {
        self.offsets.len()
    }

    pub(super) fn blocks(&self) -> usize {
        let (_, at) = locate(self.subclass.id, self.offsets.start);
        (at + self.length()).div_ceil(WINDOW)
    }

    pub(super) fn holds(&self, (id, offset): (u8, u16)) -> bool {
        self.subclass.id == id && self.offsets.contains(&offset)
    }

    /// Where it is in the bytes of its subclass.
    pub(super) fn within(&self) -> Range<usize> {
        let at = usize::from(self.offsets.start - self.subclass.start());
        at..at + self.length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Chip;

    #[test]
    fn a_parameter_is_in_one_block_or_in_two_beside_each_other() {
        let mut borders = 0;
        for chip in Chip::all().filter(|chip| chip.has_table()) {
            for subclass in chip.subclasses {
                let whole = Part::whole(subclass);
                for parameter in subclass.parameters {
                    let part = Part::of((subclass, parameter));
                    let end = parameter.offset + parameter.kind.size() as u16 - 1;
                    let is_in = |part: &Part, offset: u16| part.holds((subclass.id, offset));
                    let name = format!("{} {}", chip.name, parameter.name);
                    assert!(is_in(&part, parameter.offset) && is_in(&part, end), "{name}");
                    assert!(is_in(&whole, part.start()) && is_in(&whole, part.offsets.end - 1), "{name}");
                    let crosses = locate(subclass.id, parameter.offset).0 != locate(subclass.id, end).0;
                    assert_eq!(part.blocks(), 1 + usize::from(crosses), "{name}");
                    borders += usize::from(crosses);
                }
            }
        }
        assert!(borders > 0, "some parameter crosses a border");
    }
}
