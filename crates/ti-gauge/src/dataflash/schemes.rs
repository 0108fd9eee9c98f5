// SPDX-License-Identifier: MIT

//! The access schemes: how blocks are read from a gauge and written to it.

use std::time::Duration;

use super::window::{Planned, Window, holds_keys, learned};
use crate::chip::{Chip, Scheme};
use crate::codec::{Bytes, WINDOW};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;

mod block;
mod cfgupdate;
mod mac;
mod sealed;

pub(super) use sealed::shown_sealed;

/// From selecting a block until the first look, and until the look that counts. The gauge has it within 50 ms (drivers
/// wait 10 to 30 ms, and some read zeros). Until then the window has another block with a checksum that fits.
const FIRST_LOOK: Duration = Duration::from_millis(30);
const SECOND_LOOK: Duration = Duration::from_millis(55);
/// From selecting a block of flash until a look is worth its transfer that shows by itself whether the window was loaded.
const EARLY_LOOK: Duration = Duration::from_millis(5);
/// Time between two looks that must agree, where the first two did not.
const NEXT_LOOK: Duration = Duration::from_millis(25);
const LOOKS: u32 = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Care {
    /// As much as flash needs: what is wrong there stays.
    #[default]
    Sure,
    /// Looks at checksum and whole that show a loaded window, as soon as they do. Enough for what is not about to be
    /// written, and for RAM, which the next brown-out empties. A doubtful block is looked at as for `Sure`.
    Quick,
}

/// The steps in which access schemes differ. Each is straight-line code that follows the manual.
pub(super) trait Sequence {
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Enables writing data flash, if that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Loads a block until two looks agree, some time apart; with [`Care::Quick`] until looks show that it was loaded.
    fn load(&self, gauge: &mut Gauge, place: Window, care: Care) -> Result<[u8; WINDOW]>;
    /// Loads a block whose content is known: one look, when it must be ready, with its checksum.
    fn glance(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]>;
    /// Loads a block and reads some bytes, unchecked: what is not as expected has to be confirmed by `load`.
    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()>;
    /// Reads a word, believed when the selection is echoed and two readings agree, or its checksum is right.
    fn word(&self, gauge: &mut Gauge, place: Window, at: usize) -> Result<u16> {
        let window = self.load(gauge, place, Care::Sure)?;
        Ok(gauge.chip.layout.word([window[at], window[at + 1]]))
    }
    /// Whether the block must be in the window first. Not if the checksum covers bytes and address.
    fn fills_window(&self) -> bool;
    fn pieces(&self, block: &Planned) -> Vec<Planned>;
    /// Sends the bytes that differ to the gauge's buffer; flash is not changed yet.
    fn fill(&self, gauge: &mut Gauge, block: &Planned) -> Result<()>;
    /// Makes the gauge program the block. Never sent twice: after an error the caller reads what it holds.
    fn commit(&self, gauge: &mut Gauge, block: &Planned) -> Result<()>;
    /// Ends the mode of `begin`: new values are used. Returns when data memory can be read, as registers can before.
    fn leave(&self, gauge: &mut Gauge) -> Result<Duration> {
        Ok(gauge.clock.now())
    }
    fn always_finishes(&self) -> bool;
    fn is_begun(&self, _: &mut Gauge) -> Result<bool> {
        Ok(false)
    }
}

fn wait_until(gauge: &Gauge, begun: Duration, time: Duration) {
    gauge.wait((begun + time).saturating_sub(gauge.clock.now()));
}

/// A block that was in the window when another one was selected.
struct Before {
    /// `None` where only its content was read.
    place: Option<Window>,
    content: [u8; WINDOW],
}

impl Before {
    fn shown(gauge: &Gauge) -> Option<Self> {
        let ((subclass, base), content) = gauge.shown()?;
        Some(Self { place: Some(Window { subclass, base }), content })
    }

    /// Until it is loaded, a window may show this block, in flash with what the gauge has rewritten, or a blank one.
    fn is_shown(&self, chip: &Chip, now: &[u8; WINDOW]) -> bool {
        let place = self.place.filter(|_| chip.volatile.is_none());
        let moving = place.map_or(Bytes::default(), |place| learned(chip, place));
        let is_blank = |blank: u8| now.iter().all(|&byte| byte == blank);
        is_blank(0) || is_blank(0xff) || (0..WINDOW).all(|at| moving.has(at) || now[at] == self.content[at])
    }

    /// The sums of these: only bit errors in three places turn a look at them into one at another block.
    fn sums(&self, sum: impl Fn(Option<Window>, &[u8; WINDOW]) -> u8) -> [u8; 4] {
        let contents = [&self.content, &[0; WINDOW], &[0xff; WINDOW]].map(|content| sum(None, content));
        [contents[0], contents[1], contents[2], sum(self.place, &self.content)]
    }
}

/// How a look at a loaded window is told from one at what it showed before.
struct Early<'a, T> {
    stale: [u8; 4],
    is_new: &'a dyn Fn(&T) -> bool,
}

/// Looks until two agree. The first is at the checksum only, which differs with another block, for an eighth of the cost.
/// With `early`, these two count as soon as both show a block that was loaded since; of RAM the second alone does.
fn look_twice<T: PartialEq>(
    gauge: &mut Gauge,
    mut early: Option<&Early<'_, T>>,
    sum: impl Fn(&mut Gauge) -> Result<u8>,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> Result<T> {
    let selected = gauge.clock.now();
    if let Some(Early { is_new, .. }) = early.filter(|_| gauge.chip.volatile.is_some()) {
        for time in [gauge.chip.access.soonest, gauge.chip.access.select] {
            wait_until(gauge, selected, time);
            if let Some((now, _)) = whole(gauge).ok().filter(|(now, _)| is_new(now)) {
                return Ok(now);
            }
        }
        early = None;
    }
    let mut first = None;
    for time in [EARLY_LOOK, FIRST_LOOK] {
        // A block that is late costs a transfer, and the next one is probably late as well.
        if time == EARLY_LOOK && (early.is_none() || gauge.loads_late()) {
            continue;
        }
        wait_until(gauge, selected, time);
        first = sum(gauge).ok();
        if let Some(Early { stale, is_new }) = early
            && first.is_some_and(|sum| !stale.contains(&sum))
            && let Ok((now, reported)) = whole(gauge)
            && first == Some(reported)
        {
            gauge.note_late(time > EARLY_LOOK);
            if is_new(&now) {
                return Ok(now);
            }
            // It cannot be told from the block before, however long it is looked at.
            early = None;
        }
    }
    wait_until(gauge, selected, SECOND_LOOK.max(FIRST_LOOK + gauge.chip.access.select));
    let mut before = whole(gauge);
    if let (Some(first), Ok((now, sum))) = (&first, &before)
        && first == sum
    {
        gauge.note_late(early.is_some_and(|early| !early.stale.contains(sum) && (early.is_new)(now)));
        return before.map(|(seen, _)| seen);
    }
    for _ in 2..LOOKS {
        gauge.wait(NEXT_LOOK);
        let now = whole(gauge);
        if now.is_ok() && now == before {
            return now.map(|(seen, _)| seen);
        }
        before = now;
    }
    before?;
    let why = "the block reads differently each time";
    Err(Error::new("", Cause::Protocol, why).at(Step::ReadBlock))
}

fn note_shown(gauge: &mut Gauge, place: Window, content: [u8; WINDOW]) {
    if !holds_keys(gauge.chip, place) {
        gauge.note_shown(((place.subclass, place.base), content));
    }
}

fn settle(gauge: &Gauge) {
    gauge.wait(SECOND_LOOK.max(FIRST_LOOK + gauge.chip.access.select));
}

pub(super) fn sequence(gauge: &Gauge) -> &'static dyn Sequence {
    match gauge.chip.access.scheme {
        // A gauge without a table is never written to, and its first transfer of this sequence refused.
        Scheme::Block | Scheme::None => &block::Block,
        Scheme::CfgUpdate => &cfgupdate::BLOCK,
        Scheme::Mac => &mac::Mac,
        Scheme::MacUpdate => &cfgupdate::MAC,
    }
}
