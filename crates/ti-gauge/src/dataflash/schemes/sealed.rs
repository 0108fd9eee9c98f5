// SPDX-License-Identifier: MIT

//! The blocks that a SEALED gauge shows (SLUSBZ5D 7.3.2.16): DataFlashBlock() selects one in the window.

use super::{Care, look_twice};
use crate::codec::{WINDOW, checksum};
use crate::error::{Cause, Error, Reason, Result};
use crate::gauge::Gauge;

/// DataFlashBlock(); the window and its checksum follow it.
const DATA_FLASH_BLOCK: u8 = 0x3f;
const CHECKSUM: u8 = 0x60;

pub(in crate::dataflash) fn shown_sealed(gauge: &mut Gauge, block: u8) -> Result<[u8; WINDOW]> {
    gauge.write(DATA_FLASH_BLOCK, &[block])?;
    let sum = |gauge: &mut Gauge| {
        let mut sum = [0];
        gauge.read(CHECKSUM, &mut sum).map(|()| sum[0])
    };
    look_twice(gauge, Care::Sure, None, sum, |gauge| {
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
