//! Unsealed block access (SLUSBZ5D 7.3.3.1): BlockDataControl, DataFlashClass, DataFlashBlock, a window
//! of 32 bytes, and a checksum that commits them.

use std::time::Duration;

use super::Sequence;
use crate::codec::{WINDOW, checksum};
use crate::dataflash::blocks::{Dirty, Window};
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
/// BlockDataControl() value that selects the blocks a sealed gauge shows.
const MANUFACTURER_BLOCKS: u8 = 1;

/// Time between two reads of the window that must agree. A window that is not ready yet still shows the
/// previous block, or a blank one, with a valid checksum.
const READ_INTERVAL: Duration = Duration::from_millis(20);
/// Time between two reads of a word, the last of which is at least 55 ms after the selection.
const WORD_INTERVAL: Duration = Duration::from_millis(25);
/// Reads after one selection before giving up.
const READINGS: u32 = 4;

pub(super) struct Block;

impl Sequence for Block {
    fn enable(&self, gauge: &mut Gauge) -> Result<()> {
        gauge.write(BLOCK_DATA_CONTROL, &[0]).map_err(|error| error.at(Step::ReadBlock))
    }

    fn begin(&self, _: &mut Gauge) -> Result<()> {
        Ok(())
    }

    fn load(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]> {
        let first = load_settled(gauge, place);
        if let Ok((window, true)) = first {
            return Ok(window);
        }
        if first.as_ref().is_err_and(|error| matches!(error.cause(), Cause::Protocol(_))) {
            self.enable(gauge)?;
        }
        // The window was read too early, or a bit error in the selection loaded another block. A block that
        // does not echo its selection is accepted if a second selection gives the same bytes.
        Statistics::count(&gauge.statistics.retries);
        gauge.wait(gauge.chip.access.select * 4);
        let (window, echoed) = load_settled(gauge, place)?;
        if echoed || first.is_ok_and(|(first, _)| first == window) {
            return Ok(window);
        }
        let why = format!("{}: the block reads differently when selected again", place.name(0));
        Err(Error::new("", Cause::Protocol(why)).at(Step::ReadBlock))
    }

    fn reload(&self, gauge: &mut Gauge, place: Window, known: &[u8; WINDOW]) -> Result<()> {
        select(gauge, place)?;
        match read_window(gauge, place) {
            Ok((window, true)) if window == *known => Ok(()),
            _ => self.load(gauge, place).map(drop),
        }
    }

    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()> {
        select(gauge, place)?;
        gauge.read(BLOCK_DATA + at as u8, into).map_err(|error| error.at(Step::ReadBlock))
    }

    fn word(&self, gauge: &mut Gauge, place: Window, at: usize) -> Result<u16> {
        for _ in 0..2 {
            select(gauge, place)?;
            let mut before = None;
            for _ in 0..READINGS {
                let mut bytes = [0; 2 + WINDOW];
                let wanted = &mut bytes[..2 + at + 2];
                gauge.read(DATA_FLASH_CLASS, wanted).map_err(|error| error.at(Step::ReadBlock))?;
                let echoed = wanted[..2] == [place.subclass, block_of(place)];
                let now = echoed.then(|| u16::from_be_bytes([wanted[2 + at], wanted[3 + at]]));
                match now {
                    Some(word) if now == before => return Ok(word),
                    _ => before = now,
                }
                gauge.wait(WORD_INTERVAL);
            }
            Statistics::count(&gauge.statistics.retries);
        }
        let why = format!("{}: the word reads differently each time", place.name(at));
        Err(Error::new("", Cause::Protocol(why)).at(Step::ReadBlock))
    }

    fn fills_window(&self) -> bool {
        true
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
        gauge.reset()
    }

    fn always_finishes(&self) -> bool {
        false
    }
}

fn block_of(place: Window) -> u8 {
    u8::try_from(usize::from(place.base) / WINDOW).expect("a subclass has few blocks")
}

fn select(gauge: &mut Gauge, place: Window) -> Result<()> {
    let selected = gauge.write(DATA_FLASH_CLASS, &[place.subclass, block_of(place)]);
    gauge.wait(gauge.chip.access.select);
    selected.map_err(|error| error.at(Step::ReadBlock))
}

/// Selects a block and reads it until two consecutive reads agree.
fn load_settled(gauge: &mut Gauge, place: Window) -> Result<([u8; WINDOW], bool)> {
    select(gauge, place)?;
    let mut before = read_window(gauge, place);
    for _ in 1..READINGS {
        gauge.wait(READ_INTERVAL);
        let now = read_window(gauge, place);
        if now.is_ok() && now == before {
            return now;
        }
        before = now;
    }
    let why = format!("{}: the block reads differently each time", place.name(0));
    before.and(Err(Error::new("", Cause::Protocol(why)).at(Step::ReadBlock)))
}

/// Reads the block, verifies its checksum, and returns whether the gauge echoes the selection.
/// BlockDataControl() is read too: a bit error can set it to 1, and the window then does not show data
/// flash although everything else looks valid.
fn read_window(gauge: &mut Gauge, place: Window) -> Result<([u8; WINDOW], bool)> {
    let mut bytes = [0; 2 + WINDOW + 2];
    gauge.read(DATA_FLASH_CLASS, &mut bytes).map_err(|error| error.at(Step::ReadBlock))?;
    let mut window = [0; WINDOW];
    window.copy_from_slice(&bytes[2..2 + WINDOW]);
    if bytes[2 + WINDOW + 1] == MANUFACTURER_BLOCKS {
        let why =
            format!("{}: BlockDataControl() is 1, so the window does not show data flash", place.name(0));
        return Err(Error::new("", Cause::Protocol(why)).at(Step::ReadBlock));
    }
    let (sum, reported) = (checksum(&window), bytes[2 + WINDOW]);
    if sum == reported {
        return Ok((window, bytes[..2] == [place.subclass, block_of(place)]));
    }
    let why = format!("{}: checksum is 0x{reported:02x}, the block adds up to 0x{sum:02x}", place.name(0));
    Err(Error::new("", Cause::BadChecksum(why)).at(Step::ReadBlock))
}
