// SPDX-License-Identifier: MIT

//! Subclasses that a SEALED gauge shows without a key (SLUSBZ5D 7.3.2.16): DataFlashBlock() selects one in the window.

use super::part::Part;
use super::schemes::shown_sealed;
use crate::chip::{Chip, Subclass};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal};

/// Reads parts of subclasses of a SEALED gauge, if it shows all. Without any, the access is for marks, which it does not show.
pub(super) fn read(gauge: &mut Gauge, wanted: &[Part]) -> Option<Result<Vec<Vec<u8>>>> {
    if wanted.is_empty() {
        return None;
    }
    let blocks: Vec<_> = wanted.iter().map(|part| shown(gauge.chip, part.subclass)).collect::<Option<_>>()?;
    let read = wanted.iter().zip(blocks).map(|(part, block)| {
        let name = part.subclass.name;
        let window = shown_sealed(gauge, block).map_err(|error| error.within(name).at(Step::ReadBlock))?;
        Ok(window[part.within()].to_vec())
    });
    let read: Result<Vec<_>> = read.collect();
    Some(read.and_then(|read| {
        // One that was opened meanwhile has shown other blocks of those numbers.
        match gauge.seal_anew()? {
            Seal::Sealed => Ok(read),
            Seal::Unsealed | Seal::FullAccess => {
                Err(Error::new("", Cause::Protocol, "the gauge is no longer SEALED"))
            }
        }
    }))
}

fn shown(chip: &Chip, row: &Subclass) -> Option<u8> {
    let found = chip.security.shown_sealed.iter().find(|(_, id)| *id == row.id);
    found.filter(|_| usize::from(row.stored()) <= WINDOW).map(|(block, _)| *block)
}
