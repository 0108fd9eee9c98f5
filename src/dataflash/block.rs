//! Unsealed block access (SLUSBZ5D 7.3.3.1): BlockDataControl, DataFlashClass, DataFlashBlock, a window
//! of 32 bytes, and a checksum that commits them.

use super::{Dirty, Place, Sequence};
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

pub(super) struct Block;

impl Sequence for Block {
    fn enable(&self, gauge: &mut Gauge) -> Result<()> {
        gauge.write(BLOCK_DATA_CONTROL, &[0]).map_err(|error| error.at(Step::ReadBlock))
    }

    fn begin(&self, _: &mut Gauge) -> Result<()> {
        Ok(())
    }

    fn load(&self, gauge: &mut Gauge, place: Place) -> Result<[u8; WINDOW]> {
        let mut outcome = load_once(gauge, place);
        // A window that is read too early shows the block before; it is asked for once more.
        if outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::BadChecksum(_))) {
            Statistics::count(&gauge.statistics.retries);
            gauge.wait(gauge.chip.access.select * 4);
            outcome = load_once(gauge, place);
        }
        outcome
    }

    fn read_part(&self, gauge: &mut Gauge, place: Place, at: usize, into: &mut [u8]) -> Result<()> {
        select(gauge, place)?;
        gauge.read(BLOCK_DATA + at as u8, into).map_err(|error| error.at(Step::ReadBlock))
    }

    fn fill(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()> {
        let Some(range) = block.differing() else { return Ok(()) };
        let at = BLOCK_DATA + range.start as u8;
        gauge.write(at, &block.new[range]).map_err(|error| error.at(Step::WriteBlock))
    }

    fn commit(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()> {
        let sent = gauge.write_once(CHECKSUM, &[checksum(&block.new)]);
        gauge.wait(gauge.chip.access.commit);
        sent.map_err(|bus| Error::new("BlockDataChecksum()", Cause::Bus(bus)).at(Step::WriteBlock))
    }

    fn finish(&self, gauge: &mut Gauge) -> Result<()> {
        Statistics::count(&gauge.statistics.resets);
        gauge.command(RESET).map_err(|error| error.at(Step::Reset))
    }

    fn always_finishes(&self) -> bool {
        false
    }
}

fn select(gauge: &mut Gauge, place: Place) -> Result<()> {
    let block = u8::try_from(usize::from(place.base) / WINDOW).expect("a subclass has few blocks");
    let selected = gauge.write(DATA_FLASH_CLASS, &[place.subclass, block]);
    gauge.wait(gauge.chip.access.select);
    selected.map_err(|error| error.at(Step::ReadBlock))
}

fn load_once(gauge: &mut Gauge, place: Place) -> Result<[u8; WINDOW]> {
    select(gauge, place)?;
    let mut bytes = [0; WINDOW + 1];
    gauge.read(BLOCK_DATA, &mut bytes).map_err(|error| error.at(Step::ReadBlock))?;
    let mut window = [0; WINDOW];
    window.copy_from_slice(&bytes[..WINDOW]);
    let (sum, told) = (checksum(&window), bytes[WINDOW]);
    if sum == told {
        return Ok(window);
    }
    let why = format!("{}: checksum is 0x{told:02x}, the block adds up to 0x{sum:02x}", place.name(0));
    Err(Error::new("", Cause::BadChecksum(why)).at(Step::ReadBlock))
}
