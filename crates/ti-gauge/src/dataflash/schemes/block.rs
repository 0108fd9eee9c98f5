// SPDX-License-Identifier: MIT

//! Unsealed block access (SLUSBZ5D 7.3.3.1): BlockDataControl, DataFlashClass, DataFlashBlock, a window
//! of 32 bytes, and a checksum that commits them.

use std::time::Duration;

use super::{
    Before, Care, Early, FIRST_LOOK, NEXT_LOOK, SECOND_LOOK, Sequence, early_looks, look_early, look_twice,
    note_shown, settle,
};
use crate::chip::Kind;
use crate::codec::{WINDOW, checksum};
use crate::dataflash::window::{Planned, Window, holds_keys};
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
/// In which the words of a block are programmed (SLUSBZ5D 6.12).
const WORDS: Duration = Duration::from_millis(32);

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
        let mut before = before(gauge, place, care)?;
        let (mut failed, mut others) = (false, Vec::new());
        while others.len() < SELECTIONS {
            match load_once(gauge, place, before.take().as_ref(), care) {
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

    fn glance(&self, gauge: &mut Gauge, place: Window, sent: Option<&[u8; WINDOW]>) -> Result<[u8; WINDOW]> {
        if gauge.chip.volatile.is_none() && !holds_keys(gauge.chip, place) {
            let sent = sent.map(|content| Before::of(Some(place), *content));
            if let Some(window) = glance_early(gauge, place, sent) {
                return Ok(window);
            }
        }
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
                gauge.wait_until(selected + look.max(gauge.chip.access.select));
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
        gauge.wait(commit_time(gauge, block.place));
        sent.map_err(|bus| Error::bus("BlockDataChecksum()", bus).at(Step::WriteBlock))
    }

    fn always_finishes(&self) -> bool {
        false
    }
}

/// When the first look at a commit is worth its transfers: after the time of the words alone, until one has come too early;
/// then after as long as it took to be seen, but no later than is usual. A look that does not show it is repeated.
fn commit_time(gauge: &Gauge, place: Window) -> Duration {
    let (usual, seen) = (gauge.chip.access.commit, &gauge.statistics.commits);
    if gauge.chip.volatile.is_some() || holds_keys(gauge.chip, place) {
        return usual;
    }
    usual.min(if seen.unseen_ms() == 0 { WORDS } else { Duration::from_millis(seen.seen_ms()) })
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

/// What the window shows before a load, if the load can be told from it.
fn before(gauge: &mut Gauge, place: Window, care: Care) -> Result<Option<Before>> {
    if care == Care::Sure && holds_keys(gauge.chip, place) {
        return Ok(None);
    }
    match gauge.chip.volatile {
        Some(_) if care == Care::Quick => before_ram(gauge, place),
        Some(_) => Ok(None),
        None => Ok(before_flash(gauge, place, None)),
    }
}

/// Where it is not known it is read. A block that is not told from it comes after another one.
fn before_flash(gauge: &mut Gauge, place: Window, sent: Option<Before>) -> Option<Before> {
    let known = sent.or_else(|| Before::shown(gauge));
    let before = if known.is_none() && gauge.window_rests() { read_before(gauge, place) } else { known }?;
    before.or_landmark(gauge, place, |gauge, other, landmark| {
        let selection = [other.subclass, block_of(other)?];
        select(gauge, other)?;
        let is_there = |now: &Shown| now.echo == selection && landmark.is(&now.window);
        let seen = look_early(gauge, is_there, |gauge: &mut Gauge| read_window(gauge, other));
        Ok(seen.map(|seen| seen.window))
    })
}

fn glance_early(gauge: &mut Gauge, place: Window, sent: Option<Before>) -> Option<[u8; WINDOW]> {
    if early_looks(gauge).is_empty() {
        return None;
    }
    let (selection, chip) = ([place.subclass, block_of(place).ok()?], gauge.chip);
    let before = before_flash(gauge, place, sent)?;
    select(gauge, place).ok()?;
    let is_there = |now: &Shown| now.echo == selection && before.is_far(chip, &now.window);
    let seen = look_early(gauge, is_there, |gauge: &mut Gauge| read_window(gauge, place))?;
    note_shown(gauge, place, seen.window);
    Some(seen.window)
}

fn read_before(gauge: &mut Gauge, place: Window) -> Option<Before> {
    let (Shown { echo: [subclass, block], window }, _) = read_window(gauge, place).ok()?;
    let base = u16::from(block) * WINDOW as u16;
    Some(Before::of(Some(Window { subclass, base }), window))
}

/// Of RAM it is read where it is not known. If that is the block already, another one goes first, so that the load shows.
fn before_ram(gauge: &mut Gauge, place: Window) -> Result<Option<Before>> {
    let Some(before) = Before::shown(gauge).or_else(|| read_before(gauge, place)) else { return Ok(None) };
    if before.place != Some(place) {
        return Ok(Some(before));
    }
    let mut rows = gauge.chip.subclasses.iter().filter(|row| row.kind != Kind::Security);
    let Some(other) = rows.find(|row| row.id != place.subclass) else { return Ok(None) };
    let other = Window { subclass: other.id, base: 0 };
    let loaded = load_once(gauge, other, Some(&before), Care::Quick).ok();
    let loaded = loaded.filter(|loaded| loaded.echo == [other.subclass, 0]);
    Ok(loaded.map(|loaded| Before::of(Some(other), loaded.window)))
}

fn load_once(gauge: &mut Gauge, place: Window, before: Option<&Before>, care: Care) -> Result<Shown> {
    let (selection, chip) = ([place.subclass, block_of(place)?], gauge.chip);
    select(gauge, place)?;
    let sum = |gauge: &mut Gauge| {
        let mut sum = [0];
        gauge.read(CHECKSUM, &mut sum).map(|()| sum[0])
    };
    let whole = |gauge: &mut Gauge| read_window(gauge, place);
    let seen = match before {
        None => look_twice(gauge, care, None, sum, whole),
        Some(before) => {
            let stale = before.sums(|_, content| checksum(content));
            let is_new = |now: &Shown| now.echo == selection && !before.is_shown(chip, &now.window);
            let is_far = |now: &Shown| now.echo == selection && before.is_far(chip, &now.window);
            let is_apart = |now: &Shown| now.echo == selection && before.is_apart(chip, &now.window);
            let early = Early { stale, is_new: &is_new, is_far: &is_far, is_apart: &is_apart };
            look_twice(gauge, care, Some(&early), sum, whole)
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
