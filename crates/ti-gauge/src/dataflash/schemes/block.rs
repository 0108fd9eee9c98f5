// SPDX-License-Identifier: MIT

//! Unsealed block access (SLUSBZ5D 7.3.3.1): BlockDataControl, DataFlashClass, DataFlashBlock, a window
//! of 32 bytes, and a checksum that commits them.

use super::{
    Before, Care, Early, FIRST_LOOK, NEXT_LOOK, SECOND_LOOK, Sequence, look_twice, note_shown, settle,
    wait_until,
};
use crate::chip::Kind;
use crate::codec::{WINDOW, checksum};
use crate::dataflash::window::{Planned, Window};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Statistics};

/// DataFlashClass(); DataFlashBlock() follows it.
const DATA_FLASH_CLASS: u8 = 0x3e;
/// First byte of the window BlockData().
const BLOCK_DATA: u8 = 0x40;
const CHECKSUM: u8 = 0x60;
const BLOCK_DATA_CONTROL: u8 = 0x61;
/// BlockDataControl() value that selects the blocks a sealed gauge shows.
const MANUFACTURER_BLOCKS: u8 = 1;

const SELECTIONS: usize = 3;

pub(super) struct Block;

impl Sequence for Block {
    fn enable(&self, gauge: &mut Gauge) -> Result<()> {
        gauge.write(BLOCK_DATA_CONTROL, &[0]).map_err(|error| error.at(Step::ReadBlock))
    }

    fn begin(&self, _: &mut Gauge) -> Result<()> {
        Ok(())
    }

    fn load(&self, gauge: &mut Gauge, place: Window, care: Care) -> Result<[u8; WINDOW]> {
        let selection = [place.subclass, block_of(place)?];
        let mut before = if care == Care::Quick { before(gauge, place)? } else { None };
        let (mut failed, mut others) = (false, Vec::new());
        while others.len() < SELECTIONS {
            match load_once(gauge, place, before.take().as_ref()) {
                Ok(Shown { echo, window }) if echo == selection => {
                    note_shown(gauge, place, window);
                    return Ok(window);
                }
                Ok(shown) => others.push(shown),
                Err(error) if failed => return Err(error),
                Err(error) => {
                    failed = true;
                    if matches!(error.cause(), Cause::Protocol) {
                        self.enable(gauge)?;
                    }
                }
            }
            Statistics::count(&gauge.statistics.retries);
        }
        // A bit error in the selection loads another block, or zeros. A gauge without echo shows the same each time.
        if let [first, rest @ ..] = &others[..]
            && rest.iter().all(|shown| shown == first)
        {
            return Ok(first.window);
        }
        let why = format!("{}: the block reads differently when selected again", place.name(0));
        Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock))
    }

    fn glance(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]> {
        select(gauge, place)?;
        settle(gauge);
        match read_window(gauge, place)?.0 {
            Shown { echo, window } if echo == [place.subclass, block_of(place)?] => Ok(window),
            Shown { .. } => {
                let why = format!("{}: the gauge does not echo the selection", place.name(0));
                Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock))
            }
        }
    }

    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()> {
        select(gauge, place)?;
        settle(gauge);
        gauge.read(BLOCK_DATA + at as u8, into).map_err(|error| error.at(Step::ReadBlock))
    }

    fn word(&self, gauge: &mut Gauge, place: Window, at: usize) -> Result<u16> {
        for _ in 0..2 {
            select(gauge, place)?;
            let selected = gauge.clock.now();
            let mut before = None;
            for look in [FIRST_LOOK, SECOND_LOOK, SECOND_LOOK + NEXT_LOOK, SECOND_LOOK + NEXT_LOOK * 2] {
                wait_until(gauge, selected, look.max(gauge.chip.access.select));
                let mut bytes = [0; 2 + WINDOW];
                let wanted = &mut bytes[..2 + at + 2];
                gauge.read(DATA_FLASH_CLASS, wanted).map_err(|error| error.at(Step::ReadBlock))?;
                let echoed = wanted[..2] == [place.subclass, block_of(place)?];
                let now = echoed.then(|| gauge.chip.layout.word([wanted[2 + at], wanted[3 + at]]));
                match now {
                    Some(word) if now == before => return Ok(word),
                    _ => before = now,
                }
            }
            Statistics::count(&gauge.statistics.retries);
        }
        let why = format!("{}: the word reads differently each time", place.name(at));
        Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock))
    }

    fn fills_window(&self) -> bool {
        true
    }

    fn pieces(&self, block: &Planned) -> Vec<Planned> {
        vec![block.clone()]
    }

    fn fill(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        block.runs().into_iter().try_for_each(|run| {
            let at = BLOCK_DATA + run.start as u8;
            gauge.write(at, &block.new[run]).map_err(|error| error.at(Step::WriteBlock))
        })
    }

    fn commit(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        let sent = gauge.write_once(CHECKSUM, &[checksum(&block.new)]);
        gauge.wait(gauge.chip.access.commit);
        sent.map_err(|bus| Error::bus("BlockDataChecksum()", bus).at(Step::WriteBlock))
    }

    fn always_finishes(&self) -> bool {
        false
    }
}

fn block_of(place: Window) -> Result<u8> {
    // Only a journal that was written for another kind of part can name one.
    u8::try_from(usize::from(place.base) / WINDOW).map_err(|_| {
        let why = format!("{}: there is no such block", place.name(0));
        Error::new("", Cause::Invalid, why).at(Step::ReadBlock)
    })
}

fn select(gauge: &mut Gauge, place: Window) -> Result<()> {
    let selected = gauge.write(DATA_FLASH_CLASS, &[place.subclass, block_of(place)?]);
    selected.map_err(|error| error.at(Step::ReadBlock))
}

#[derive(Clone, Copy, PartialEq, Eq)]
struct Shown {
    echo: [u8; 2],
    window: [u8; WINDOW],
}

/// What the window shows before a load; of RAM it is read where it is not known. If that is the block already, another one
/// goes first, so that the load shows.
fn before(gauge: &mut Gauge, place: Window) -> Result<Option<Before>> {
    let is_ram = gauge.chip.volatile.is_some();
    let mut shown = Before::shown(gauge);
    if shown.is_none() && is_ram {
        let read = read_window(gauge, place).ok();
        shown = read.map(|(Shown { echo: [subclass, block], window }, _)| {
            let base = u16::from(block) * WINDOW as u16;
            Before { place: Some(Window { subclass, base }), content: window }
        });
    }
    let Some(before) = shown else { return Ok(None) };
    if !is_ram || before.place != Some(place) {
        return Ok(Some(before));
    }
    let mut rows = gauge.chip.subclasses.iter().filter(|row| row.kind != Kind::Security);
    let Some(other) = rows.find(|row| row.id != place.subclass) else { return Ok(None) };
    let other = Window { subclass: other.id, base: 0 };
    let loaded = load_once(gauge, other, Some(&before)).ok();
    let loaded = loaded.filter(|loaded| loaded.echo == [other.subclass, 0]);
    Ok(loaded.map(|loaded| Before { place: Some(other), content: loaded.window }))
}

fn load_once(gauge: &mut Gauge, place: Window, before: Option<&Before>) -> Result<Shown> {
    let (selection, chip) = ([place.subclass, block_of(place)?], gauge.chip);
    select(gauge, place)?;
    let sum = |gauge: &mut Gauge| {
        let mut sum = [0];
        gauge.read(CHECKSUM, &mut sum).map(|()| sum[0])
    };
    let whole = |gauge: &mut Gauge| read_window(gauge, place);
    let seen = match before {
        None => look_twice(gauge, None, sum, whole),
        Some(before) => {
            let stale = before.sums(|_, content| checksum(content));
            let is_new = |now: &Shown| now.echo == selection && !before.is_shown(chip, &now.window);
            look_twice(gauge, Some(&Early { stale, is_new: &is_new }), sum, whole)
        }
    };
    seen.map_err(|error| error.within(&place.name(0)))
}

/// BlockDataControl() is read too: a bit error may set it to 1, and the window, looking valid, is not data flash.
fn read_window(gauge: &mut Gauge, place: Window) -> Result<(Shown, u8)> {
    let mut bytes = [0; 2 + WINDOW + 2];
    gauge.read(DATA_FLASH_CLASS, &mut bytes).map_err(|error| error.at(Step::ReadBlock))?;
    let mut window = [0; WINDOW];
    window.copy_from_slice(&bytes[2..2 + WINDOW]);
    if bytes[2 + WINDOW + 1] == MANUFACTURER_BLOCKS {
        let why =
            format!("{}: BlockDataControl() is 1, so the window does not show data flash", place.name(0));
        return Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock));
    }
    let (sum, reported) = (checksum(&window), bytes[2 + WINDOW]);
    if sum == reported {
        return Ok((Shown { echo: [bytes[0], bytes[1]], window }, sum));
    }
    let reason = Reason::Checksum { found: reported.into(), expected: sum.into(), of: "checksum" };
    Err(Error::of(place.name(0), reason).at(Step::ReadBlock))
}
