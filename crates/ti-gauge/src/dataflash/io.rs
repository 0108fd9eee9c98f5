//! Reads data flash, programs one block and verifies it.

use super::blocks::{Dirty, Window, locate};
use super::schemes::sequence;
use crate::chip::{FLAT, Subclass};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Statistics};

pub(super) fn read_byte(gauge: &mut Gauge, (subclass, offset): (u8, u16)) -> Result<u8> {
    let start = if subclass == FLAT { offset } else { 0 };
    let (place, at) = locate(subclass, start, offset);
    let mut byte = [0];
    sequence(gauge).read_part(gauge, place, at, &mut byte)?;
    Ok(byte[0])
}

pub(super) fn read_subclass(gauge: &mut Gauge, subclass: &Subclass) -> Result<Vec<u8>> {
    let length = usize::from(subclass.stored());
    let mut bytes = Vec::with_capacity(length);
    while bytes.len() < length {
        let base = subclass.start() + bytes.len() as u16;
        let window = sequence(gauge).load(gauge, Window { subclass: subclass.id, base })?;
        bytes.extend_from_slice(&window[..WINDOW.min(length - bytes.len())]);
    }
    Ok(bytes)
}

/// Writes one block, commits it and reads it back. `touched` counts the blocks that may have been
/// committed, whose content must be read back rather than assumed.
pub(super) fn store(gauge: &mut Gauge, block: &Dirty, touched: &mut usize) -> Result<()> {
    sequence(gauge).fill(gauge, block)?;
    *touched += 1;
    Statistics::count(&gauge.statistics.flash_writes);
    let committed = sequence(gauge).commit(gauge, block);
    // A checksum may take effect even if its acknowledgement was lost.
    verify(gauge, block).map_err(|error| committed.err().unwrap_or(error))
}

/// Selects and reads the block again: right after a write the window shows the buffer, not flash.
fn verify(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let stored = sequence(gauge).load(gauge, block.place).map_err(|error| error.at(Step::Verify))?;
    compare(block, &stored)
}

/// Compares the written bytes only: after a reset the gauge updates others itself.
pub(super) fn verify_written(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let range = block.written.clone();
    let mut stored = block.new;
    let read = sequence(gauge).read_part(gauge, block.place, range.start, &mut stored[range]);
    read.map_err(|error| error.at(Step::Verify))?;
    compare(block, &stored)
}

fn compare(block: &Dirty, stored: &[u8; WINDOW]) -> Result<()> {
    let Some(at) = (0..WINDOW).find(|&at| stored[at] != block.new[at]) else { return Ok(()) };
    let place = block.place.name(at);
    let why = if *stored == block.old {
        format!("{place}: the gauge acknowledged the write and stored nothing")
    } else {
        format!("{place} reads 0x{:02x}, wrote 0x{:02x}", stored[at], block.new[at])
    };
    Err(Error::new("", Cause::Protocol(why)).at(Step::Verify))
}
