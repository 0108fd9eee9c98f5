// SPDX-License-Identifier: MIT

//! Reads data flash, programs one block and verifies it.

use std::time::Duration;

use super::pack::Known;
use super::part::Part;
use super::schemes::{Care, sequence};
use super::window::{Planned, Window, holds_keys, learned, locate};
use crate::chip::{Chip, Scheme};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Phase, Seal};

/// Looks at a block after its commit: programming takes up to 250 ms, with the old content or no answer meanwhile.
const VERIFIES: u32 = 8;
const VERIFY_INTERVAL: Duration = Duration::from_millis(80);
/// As long as these looks take: by then every commit has finished, even one that waited for a row of the gauge's own.
pub(super) const COMMITTED: Duration = VERIFY_INTERVAL.saturating_mul(VERIFIES);
pub(super) const STORES: u32 = 3;

pub(super) fn read_byte(gauge: &mut Gauge, (subclass, offset): (u8, u16)) -> Result<u8> {
    let (place, at) = locate(subclass, offset);
    let mut byte = [0];
    sequence(gauge).read_part(gauge, place, at, &mut byte)?;
    Ok(byte[0])
}

pub(super) fn read(
    gauge: &mut Gauge,
    part: &Part,
    read: &Known,
    mut note: impl FnMut(Window, &[u8; WINDOW]),
) -> Result<Vec<u8>> {
    let length = part.length();
    let mut bytes = Vec::with_capacity(length);
    while bytes.len() < length {
        let (place, at) = locate(part.subclass.id, part.start() + bytes.len() as u16);
        let window = match read.get(place) {
            Some(window) => window,
            None => sequence(gauge).load(gauge, place, Care::Quick)?,
        };
        note(place, &window);
        gauge.statistics.progress.step(Phase::Saving);
        bytes.extend_from_slice(&window[at..WINDOW.min(at + length - bytes.len())]);
    }
    Ok(bytes)
}

/// Loads a block of known content again, as it is now: learned bytes may have moved, and the checksum covers them.
pub(super) fn reload(gauge: &mut Gauge, block: &Planned, care: Care) -> Result<Planned> {
    if !sequence(gauge).fills_window() {
        return Ok(block.clone());
    }
    let own = learned(gauge.chip, block.place);
    let differs = |window: &[u8; WINDOW]| (0..WINDOW).find(|&at| window[at] != block.old[at] && !own.has(at));
    let look = match care {
        Care::Sure => sequence(gauge).glance(gauge, block.place, None),
        Care::Quick => sequence(gauge).load(gauge, block.place, Care::Quick),
    };
    let window = match look {
        Ok(window) if differs(&window).is_none() => window,
        _ => sequence(gauge).load(gauge, block.place, Care::Sure)?,
    };
    if let Some(at) = differs(&window) {
        let why = format!("{} has changed since it was read", block.place.name(at));
        return Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock));
    }
    let mut new = window;
    for at in (0..WINDOW).filter(|&at| !block.learned.has(at)) {
        new[at] = block.new[at];
    }
    Ok(Planned { old: window, new, ..block.clone() })
}

pub(super) fn is_passing(error: &Error) -> bool {
    matches!(error.cause(), Cause::Bus(bus) if bus.is_transient()) || matches!(error.cause(), Cause::NotNow)
}

/// A gauge that has lost its power is sealed: it ignores writes and may show what was sent to it as if it were in flash.
pub(super) fn still_open(gauge: &mut Gauge) -> Result<()> {
    match gauge.seal_anew()? {
        Seal::Sealed => {
            let why =
                "the gauge is SEALED in the middle of the write: it has been reset or has lost its power";
            Err(Error::new("", Cause::Protocol, why).at(Step::Verify))
        }
        Seal::Unsealed | Seal::FullAccess => Ok(()),
    }
}

/// The window shows the buffer after a write, so the block is selected again. Keys cannot be corrected later: two looks.
pub(super) fn verify(gauge: &mut Gauge, block: &Planned) -> Result<()> {
    let mut sent = Some(&block.new);
    patiently(gauge, |gauge| {
        let stored = match holds_keys(gauge.chip, block.place) {
            true => sequence(gauge).load(gauge, block.place, Care::Sure),
            false => sequence(gauge).glance(gauge, block.place, sent.take()),
        };
        compare(block, &stored.map_err(|error| error.at(Step::Verify))?)
    })
}

fn patiently(gauge: &mut Gauge, mut look: impl FnMut(&mut Gauge) -> Result<()>) -> Result<()> {
    let mut outcome = look(gauge);
    for _ in 1..VERIFIES {
        if outcome.is_ok() {
            break;
        }
        gauge.wait(VERIFY_INTERVAL);
        outcome = look(gauge);
    }
    outcome
}

/// Compares the written bytes only: the gauge updates others itself. What reads wrong is read again with its checksum.
pub(super) fn verify_written(gauge: &mut Gauge, block: &Planned, care: Care) -> Result<()> {
    let written = |at: &usize| block.written.has(*at);
    let (Some(first), Some(last)) = ((0..WINDOW).find(written), (0..WINDOW).rfind(written)) else {
        return Ok(());
    };
    // A whole block shows by itself that it was loaded.
    let is_whole = gauge.chip.access.scheme == Scheme::Block;
    let read = match care {
        Care::Sure if is_whole => sequence(gauge).glance(gauge, block.place, None),
        Care::Sure => {
            let mut stored = block.new;
            let part = &mut stored[first..last + 1];
            sequence(gauge).read_part(gauge, block.place, first, part).map(|()| stored)
        }
        Care::Quick => sequence(gauge).load(gauge, block.place, Care::Quick),
    };
    match read {
        Ok(stored) if wrong(gauge.chip, block, &stored).is_none() => Ok(()),
        _ => verify_whole(gauge, block),
    }
}

fn wrong(chip: &Chip, block: &Planned, stored: &[u8; WINDOW]) -> Option<usize> {
    let written = block.written.without(block.as_rewritten(chip, stored).learned);
    written.iter().find(|&at| stored[at] != block.new[at])
}

fn verify_whole(gauge: &mut Gauge, block: &Planned) -> Result<()> {
    let stored =
        sequence(gauge).load(gauge, block.place, Care::Sure).map_err(|error| error.at(Step::Verify))?;
    if let Some(at) = block.rewritten(gauge.chip, &stored).iter().next() {
        log::info!(
            "{}: {} was written, and the gauge has rewritten it since",
            gauge.chip.name,
            block.place.name(at)
        );
    }
    wrong(gauge.chip, block, &stored).map_or(Ok(()), |at| Err(mismatch(block, &stored, at)))
}

fn compare(block: &Planned, stored: &[u8; WINDOW]) -> Result<()> {
    match block.differs(stored, &block.new) {
        None => Ok(()),
        Some(at) => Err(mismatch(block, stored, at)),
    }
}

fn mismatch(block: &Planned, stored: &[u8; WINDOW], at: usize) -> Error {
    let place = block.place.name(at);
    let reason = if block.differs(stored, &block.old).is_none() {
        let why = format!("{place}: the gauge acknowledged the write and stored nothing");
        Reason::Text(Cause::Protocol, why.into())
    } else {
        Reason::Mismatch { read: stored[at].into(), wrote: block.new[at].into(), place }
    };
    Error::of("", reason).at(Step::Verify)
}
