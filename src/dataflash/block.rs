//! Unsealed block access (SLUSBZ5D 7.3.3.1): BlockDataControl, DataFlashClass, DataFlashBlock, a window
//! of 32 bytes, and a checksum that commits them.

use super::Place;
use crate::chip::{Access, BlockTimes};
use crate::codec::{WINDOW, checksum};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Statistics};

/// DataFlashClass(); DataFlashBlock() follows it.
const DATA_FLASH_CLASS: u8 = 0x3e;
/// First byte of the window BlockData().
const BLOCK_DATA: u8 = 0x40;
/// BlockDataChecksum().
const CHECKSUM: u8 = 0x60;
/// BlockDataControl().
const BLOCK_DATA_CONTROL: u8 = 0x61;
/// Control(RESET).
const RESET: u16 = 0x0041;

fn times(gauge: &Gauge) -> &'static BlockTimes {
    let Access::Block(times) = &gauge.chip.access;
    times
}

/// Lets the window show general data flash.
pub(super) fn enable(gauge: &mut Gauge) -> Result<()> {
    gauge.write(BLOCK_DATA_CONTROL, &[0]).map_err(|error| error.at(Step::ReadBlock))
}

/// Brings a block into the window.
pub(super) fn select(gauge: &mut Gauge, place: Place) -> Result<()> {
    gauge
        .write(DATA_FLASH_CLASS, &[place.subclass, place.block])
        .map_err(|error| error.at(Step::ReadBlock))?;
    gauge.wait(times(gauge).select);
    Ok(())
}

/// Reads some bytes of the window.
pub(super) fn read_part(gauge: &mut Gauge, at: usize, into: &mut [u8]) -> Result<()> {
    gauge.read(BLOCK_DATA + at as u8, into).map_err(|error| error.at(Step::ReadBlock))
}

/// Brings a block into the window and reads it whole, with the checksum behind it.
pub(super) fn load(gauge: &mut Gauge, place: Place) -> Result<[u8; WINDOW]> {
    let mut outcome = read_whole(gauge, place);
    // A window that is read too early shows the block before; it is asked for once more.
    if outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::BadChecksum(_))) {
        Statistics::count(&gauge.statistics.retries);
        gauge.wait(times(gauge).select * 4);
        outcome = read_whole(gauge, place);
    }
    outcome
}

fn read_whole(gauge: &mut Gauge, place: Place) -> Result<[u8; WINDOW]> {
    select(gauge, place)?;
    let mut bytes = [0; WINDOW + 1];
    gauge.read(BLOCK_DATA, &mut bytes).map_err(|error| error.at(Step::ReadBlock))?;
    let mut window = [0; WINDOW];
    window.copy_from_slice(&bytes[..WINDOW]);
    let (sum, told) = (checksum(&window), bytes[WINDOW]);
    if sum == told {
        return Ok(window);
    }
    let Place { subclass, block } = place;
    let why = format!(
        "subclass {subclass} block {block}: checksum is 0x{told:02x}, the bytes add up to 0x{sum:02x}"
    );
    Err(Error::new("", Cause::BadChecksum(why)).at(Step::ReadBlock))
}

/// Changes the bytes that differ, in the gauge's buffer only. The block is in the window.
pub(super) fn fill(gauge: &mut Gauge, old: &[u8; WINDOW], new: &[u8; WINDOW]) -> Result<()> {
    let differs = |&at: &usize| old[at] != new[at];
    let (Some(first), Some(last)) = ((0..WINDOW).find(differs), (0..WINDOW).rfind(differs)) else {
        return Ok(());
    };
    gauge.write(BLOCK_DATA + first as u8, &new[first..=last]).map_err(|error| error.at(Step::WriteBlock))
}

/// Sends the checksum that makes the gauge program the block. Never sent twice: whoever calls finds out
/// what the block holds instead.
pub(super) fn commit(gauge: &mut Gauge, new: &[u8; WINDOW]) -> Result<()> {
    let sent = gauge.write_once(CHECKSUM, &[checksum(new)]);
    gauge.wait(times(gauge).commit);
    sent.map_err(|bus| Error::new("BlockDataChecksum()", Cause::Bus(bus)).at(Step::WriteBlock))
}

/// Resets the gauge, so that it works with the new data flash.
pub(super) fn reset(gauge: &mut Gauge) -> Result<()> {
    Statistics::count(&gauge.statistics.resets);
    gauge.command(RESET).map_err(|error| error.at(Step::Reset))
}
