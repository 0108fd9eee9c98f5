// SPDX-License-Identifier: MIT

//! The access schemes: how blocks are read from a gauge and written to it.

use std::time::Duration;

use super::window::{Planned, Window};
use crate::chip::Scheme;
use crate::codec::WINDOW;
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
/// Time between two looks that must agree, where the first two did not.
const NEXT_LOOK: Duration = Duration::from_millis(25);
const LOOKS: u32 = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Care {
    /// As much as flash needs: what is wrong there stays.
    #[default]
    Sure,
    /// One look that shows a loaded window. Enough for RAM, which the next brown-out empties; a doubtful block costs a second
    /// look. A part with flash is looked at as for `Sure`.
    Quick,
}

/// The steps in which access schemes differ. Each is straight-line code that follows the manual.
pub(super) trait Sequence {
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Enables writing data flash, if that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Loads a block until two looks agree, some time apart; with [`Care::Quick`] until one shows that it was loaded.
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

/// Looks until two agree. The first is at the checksum only, which differs with another block, for an eighth of the cost.
fn look_twice<T: PartialEq>(
    gauge: &mut Gauge,
    sum: impl Fn(&mut Gauge) -> Result<u8>,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> Result<T> {
    let selected = gauge.clock.now();
    wait_until(gauge, selected, FIRST_LOOK);
    let first = sum(gauge);
    wait_until(gauge, selected, SECOND_LOOK.max(FIRST_LOOK + gauge.chip.access.select));
    let mut before = whole(gauge);
    if let (Ok(first), Ok((_, sum))) = (&first, &before)
        && first == sum
    {
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

/// Looks at RAM early, and at the table's time. `None` if neither shows that the window, which held `before`, was loaded.
fn look_early(
    gauge: &mut Gauge,
    before: &[u8; WINDOW],
    look: impl Fn(&mut Gauge) -> Option<[u8; WINDOW]>,
) -> Option<[u8; WINDOW]> {
    let selected = gauge.clock.now();
    [gauge.chip.access.soonest, gauge.chip.access.select].into_iter().find_map(|time| {
        wait_until(gauge, selected, time);
        look(gauge).filter(|now| is_loaded(before, now))
    })
}

/// Until a window is loaded it shows what it held, or a blank block, each with a checksum that fits.
fn is_loaded(before: &[u8; WINDOW], now: &[u8; WINDOW]) -> bool {
    now != before && now.iter().any(|&byte| byte != 0)
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
