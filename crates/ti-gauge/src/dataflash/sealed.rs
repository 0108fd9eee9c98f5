// SPDX-License-Identifier: MIT

//! Subclasses that a SEALED gauge shows without a key (SLUSBZ5D 7.3.2.16): DataFlashBlock() selects one in the window.

use super::schemes::look_twice;
use crate::chip::{Chip, Subclass};
use crate::codec::{WINDOW, checksum};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal};

/// DataFlashBlock(); the window and its checksum follow it.
const DATA_FLASH_BLOCK: u8 = 0x3f;
/// BlockDataChecksum().
const CHECKSUM: u8 = 0x60;

/// Reads subclasses of a gauge that is SEALED; `None` unless it shows all of them. Without any, the access is for what the pack
/// is known by, which it does not show.
pub(super) fn read(gauge: &mut Gauge, wanted: &[&'static Subclass]) -> Option<Result<Vec<Vec<u8>>>> {
    if wanted.is_empty() {
        return None;
    }
    let blocks: Vec<_> = wanted.iter().map(|row| shown(gauge.chip, row)).collect::<Option<_>>()?;
    let read = wanted.iter().zip(blocks).map(|(row, block)| {
        let window = block_of(gauge, block).map_err(|error| error.within(row.name).at(Step::ReadBlock))?;
        Ok(window[..usize::from(row.stored())].to_vec())
    });
    let read: Result<Vec<_>> = read.collect();
    Some(read.and_then(|read| {
        // One that was opened meanwhile has shown other blocks of those numbers.
        match gauge.seal_anew()? {
            Seal::Sealed => Ok(read),
            Seal::Unsealed | Seal::FullAccess => Err(protocol("the gauge is no longer SEALED")),
        }
    }))
}

fn shown(chip: &Chip, row: &Subclass) -> Option<u8> {
    let found = chip.security.shown_sealed.iter().find(|(_, id)| *id == row.id);
    found.filter(|_| usize::from(row.stored()) <= WINDOW).map(|(block, _)| *block)
}

fn block_of(gauge: &mut Gauge, block: u8) -> Result<[u8; WINDOW]> {
    gauge.write(DATA_FLASH_BLOCK, &[block])?;
    let sum = |gauge: &mut Gauge| {
        let mut sum = [0];
        gauge.read(CHECKSUM, &mut sum).map(|()| sum[0])
    };
    look_twice(gauge, sum, |gauge| {
        let mut bytes = [0; 1 + WINDOW + 1];
        gauge.read(DATA_FLASH_BLOCK, &mut bytes)?;
        let mut window = [0; WINDOW];
        window.copy_from_slice(&bytes[1..=WINDOW]);
        let (sum, reported) = (checksum(&window), bytes[1 + WINDOW]);
        match bytes[0] {
            _ if sum != reported => {
                let reason =
                    Reason::Checksum { found: reported.into(), expected: sum.into(), of: "checksum" };
                Err(Error::of("", reason))
            }
            shown if shown != block => Err(protocol("another block is selected")),
            _ => Ok((window, sum)),
        }
    })
}

fn protocol(why: &'static str) -> Error {
    Error::new("", Cause::Protocol, why)
}
