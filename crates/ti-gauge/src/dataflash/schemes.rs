// SPDX-License-Identifier: MIT

//! The access schemes: how blocks are read from a gauge and written to it.

use std::time::Duration;

use super::window::{Planned, Window, holds_keys, learned};
use crate::chip::{Chip, Scheme};
use crate::codec::{Bytes, WINDOW};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{APART, Gauge, Landmark};

mod block;
mod cfgupdate;
mod mac;
mod sealed;

pub(super) use sealed::shown_sealed;

/// From selecting a block until the first look, and until the look that counts. The gauge has it within 50 ms (drivers
/// wait 10 to 30 ms, and some read zeros). Until then the window has another block with a checksum that fits.
const FIRST_LOOK: Duration = Duration::from_millis(30);
const SECOND_LOOK: Duration = Duration::from_millis(55);
/// From selecting a block of flash until looks are worth their transfers that show by themselves whether the window was loaded.
const EARLY_LOOKS: [Duration; 4] = [
    Duration::from_millis(1),
    Duration::from_millis(4),
    Duration::from_millis(10),
    Duration::from_millis(18),
];
/// Time between two looks that must agree, where the first two did not.
const NEXT_LOOK: Duration = Duration::from_millis(25);
const LOOKS: u32 = 4;
/// Bytes that are not wrong in the same way in two looks which agree.
const APART_BYTES: usize = 3;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Care {
    /// As much as flash needs: what is wrong there stays.
    #[default]
    Sure,
    /// Looks at checksum and whole that show a loaded window, as soon as they do. Enough for what is not about to be
    /// written, and for RAM, which the next brown-out empties. A doubtful block is looked at late, as for `Sure`.
    Quick,
}

/// The steps in which access schemes differ. Each is straight-line code that follows the manual.
pub(super) trait Sequence {
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Enables writing data flash, if that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Loads a block until looks show that it was loaded; with [`Care::Sure`] until two agree as well, some time apart.
    fn load(&self, gauge: &mut Gauge, place: Window, care: Care) -> Result<[u8; WINDOW]>;
    /// Loads a block whose content is known: one look, with its checksum, when it must be ready, in flash as soon as it shows
    /// that it is. After a commit the window holds what was `sent`.
    fn glance(&self, gauge: &mut Gauge, place: Window, sent: Option<&[u8; WINDOW]>) -> Result<[u8; WINDOW]>;
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

/// A block that was in the window when another one was selected.
struct Before {
    /// `None` where only its content was read.
    place: Option<Window>,
    content: [u8; WINDOW],
    /// Bytes before it may be those of an answer that is on its way.
    from: usize,
}

impl Before {
    fn of(place: Option<Window>, content: [u8; WINDOW]) -> Self {
        Self { place, content, from: 0 }
    }

    fn shown(gauge: &Gauge) -> Option<Self> {
        let ((subclass, base), content) = gauge.shown()?;
        Some(Self::of(Some(Window { subclass, base }), content))
    }

    /// The bytes of it that a window may show otherwise as soon as the gauge has rewritten them.
    fn moving(&self, chip: &Chip) -> Bytes {
        let place = self.place.filter(|_| chip.volatile.is_none());
        place.map_or(Bytes::default(), |place| learned(chip, place))
    }

    /// Until it is loaded, a window may show this block, in flash with what the gauge has rewritten, or a blank one.
    fn is_shown(&self, chip: &Chip, now: &[u8; WINDOW]) -> bool {
        let moving = self.moving(chip);
        let is_blank = |blank: u8| now.iter().all(|&byte| byte == blank);
        is_blank(0) || is_blank(0xff) || (0..WINDOW).all(|at| moving.has(at) || now[at] == self.content[at])
    }

    /// Whether the block at that place is not told from it: it is the same one, or it may show anything.
    fn hides(&self, chip: &Chip, place: Window) -> bool {
        let moving = self.moving(chip);
        self.from > 0 || self.place == Some(place) || (0..WINDOW).all(|at| moving.has(at))
    }

    /// The sums of these: only bit errors in three places turn a look at them into one at another block.
    fn sums(&self, sum: impl Fn(Option<Window>, &[u8; WINDOW]) -> u8) -> [u8; 4] {
        let contents = [&self.content, &[0; WINDOW], &[0xff; WINDOW]].map(|content| sum(None, content));
        [contents[0], contents[1], contents[2], sum(self.place, &self.content)]
    }

    /// Whether a look shows neither, nor with wrong bits: no disturbance changes so many bytes and the sum to fit.
    fn is_far(&self, chip: &Chip, now: &[u8; WINDOW]) -> bool {
        self.distance(chip, now) >= Landmark::STEADY
    }

    fn is_apart(&self, chip: &Chip, now: &[u8; WINDOW]) -> bool {
        self.distance(chip, now) >= APART_BYTES
    }

    /// In how many bytes a look differs from what the window may show until the block is loaded.
    fn distance(&self, chip: &Chip, now: &[u8; WINDOW]) -> usize {
        let moving = self.moving(chip);
        let contents = [&self.content, &[0; WINDOW], &[0xff; WINDOW]];
        let differs = |content: &[u8; WINDOW]| {
            (0..WINDOW).filter(|&at| !moving.has(at) && now[at] != content[at]).count()
        };
        contents.into_iter().map(differs).min().unwrap_or_default()
    }

    /// What the window shows before the block at `place` is loaded: this one, or where that is not told from it a known block,
    /// which `load` brings as soon as it shows itself.
    fn or_landmark(
        self,
        gauge: &mut Gauge,
        place: Window,
        load: impl FnOnce(&mut Gauge, Window, &Landmark) -> Result<Option<[u8; WINDOW]>>,
    ) -> Option<Self> {
        if !self.hides(gauge.chip, place) {
            return Some(self);
        }
        let (other, landmark) = self.landmark(gauge, place)?;
        let Some(content) = load(gauge, other, &landmark).ok()? else {
            gauge.forget_landmark(landmark.place);
            return None;
        };
        note_shown(gauge, other, content);
        Some(Self::of(Some(other), content))
    }

    /// A known block that is told from this one and from that at `place`, to be loaded between them.
    fn landmark(&self, gauge: &Gauge, place: Window) -> Option<(Window, Landmark)> {
        let others = [Some(place), self.place].map(|at| at.map(|at| (at.subclass, at.base)));
        let landmark =
            gauge.landmark(others).filter(|landmark| landmark.differs_from(&self.content, self.from))?;
        let (subclass, base) = landmark.place;
        Some((Window { subclass, base }, landmark))
    }
}

/// How a look at a loaded window is told from one at what it showed before.
struct Early<'a, T> {
    stale: [u8; 4],
    is_new: &'a dyn Fn(&T) -> bool,
    /// [`Self::is_new`] by many bytes.
    is_far: &'a dyn Fn(&T) -> bool,
    /// [`Self::is_new`] by so many bytes that two looks which agree are at a new block, although its sum is that of the one before.
    is_apart: &'a dyn Fn(&T) -> bool,
}

/// The early looks that are worth their transfers. A gauge that has shown how long it takes is looked at once.
fn early_looks(gauge: &Gauge) -> Vec<Duration> {
    match gauge.load_time() {
        Some(usual) => EARLY_LOOKS.into_iter().filter(|&time| time >= usual).take(1).collect(),
        None => EARLY_LOOKS.to_vec(),
    }
}

/// The first early look at the whole that shows by itself what was loaded.
fn look_early<T>(
    gauge: &mut Gauge,
    is_loaded: impl Fn(&T) -> bool,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> Option<T> {
    let looks = early_looks(gauge);
    let (now, time) = look_until(gauge, looks, is_loaded, whole)?;
    gauge.note_load_time(time);
    Some(now)
}

/// Looks at the whole at these times after the selection. Returns the first look that is believed, and its time.
fn look_until<T>(
    gauge: &mut Gauge,
    times: impl IntoIterator<Item = Duration>,
    is_loaded: impl Fn(&T) -> bool,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> Option<(T, Duration)> {
    let selected = gauge.clock.now();
    times.into_iter().find_map(|time| {
        gauge.wait_until(selected + time);
        let (now, _) = whole(gauge).ok().filter(|(now, _)| is_loaded(now))?;
        Some((now, time))
    })
}

/// Looks until two agree. The first is at the checksum only, which differs with another block, for an eighth of the cost.
/// With `early`, these two count as soon as both show a block that was loaded since; for [`Care::Sure`] two looks at the
/// whole do, some time apart, and of RAM one does.
fn look_twice<T: PartialEq>(
    gauge: &mut Gauge,
    care: Care,
    early: Option<&Early<'_, T>>,
    sum: impl Fn(&mut Gauge) -> Result<u8>,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> Result<T> {
    let selected = gauge.clock.now();
    let is_ram = gauge.chip.volatile.is_some();
    let (seen, first) = match early {
        Some(Early { is_new, .. }) if is_ram => {
            let looks = [gauge.chip.access.soonest, gauge.chip.access.select];
            (look_until(gauge, looks, is_new, &whole).map(|(now, _)| now), None)
        }
        Some(Early { is_far, .. }) if care == Care::Sure => {
            let now = look_early(gauge, is_far, &whole);
            (now.filter(|now| is_same_again(gauge, now, &whole)), None)
        }
        Some(early) => look_quickly(gauge, early, &sum, &whole),
        None => (None, None),
    };
    if let Some(seen) = seen {
        return Ok(seen);
    }
    let (first, first_at) = if first.is_some() {
        (first, gauge.load_time().unwrap_or(FIRST_LOOK))
    } else {
        gauge.wait_until(selected + FIRST_LOOK);
        (sum(gauge).ok(), FIRST_LOOK)
    };
    gauge.wait_until(selected + SECOND_LOOK.max(first_at + gauge.chip.access.select));
    let mut before = whole(gauge);
    // What does not differ enough to count early says nothing of how long a load takes.
    if let (Some(Early { stale, is_new, is_far, .. }), Ok((now, sum))) = (early.filter(|_| !is_ram), &before)
        && !stale.contains(sum)
        && (if care == Care::Sure { is_far } else { is_new })(now)
    {
        gauge.note_load_time(later_than(gauge.load_time()));
    }
    if let (Some(first), Ok((_, sum))) = (&first, &before)
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

/// The time of the next early look.
fn later_than(usual: Option<Duration>) -> Duration {
    let later = EARLY_LOOKS.into_iter().find(|&time| usual.is_some_and(|usual| time > usual));
    later.unwrap_or(SECOND_LOOK)
}

/// Looks at the checksum, and at the whole as soon as it is another one. If nothing shows that the window was loaded, the
/// latest checksum is the first of two looks that must agree.
fn look_quickly<T: PartialEq>(
    gauge: &mut Gauge,
    Early { stale, is_new, is_apart, .. }: &Early<'_, T>,
    sum: impl Fn(&mut Gauge) -> Result<u8>,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> (Option<T>, Option<u8>) {
    let selected = gauge.clock.now();
    let mut first = None;
    let usual = gauge.load_time();
    for time in early_looks(gauge).into_iter().chain([FIRST_LOOK]) {
        // It is as what was there before: later looks show no more.
        if time == FIRST_LOOK && first.is_some() && usual.is_some() {
            break;
        }
        gauge.wait_until(selected + time);
        first = sum(gauge).ok();
        if first.is_some_and(|sum| !stale.contains(&sum))
            && let Ok((now, reported)) = whole(gauge)
            && first == Some(reported)
        {
            gauge.note_load_time(time);
            // If not, it cannot be told from the block before, however long it is looked at.
            return (Some(now).filter(|now| is_new(now)), first);
        }
        // The sum of a blank block says that the window is blank.
        if usual.is_some()
            && first == Some(stale[0])
            && !stale[1..3].contains(&stale[0])
            && let Ok((now, _)) = whole(gauge)
            && is_apart(&now)
            && is_same_again(gauge, &now, &whole)
        {
            return (Some(now), first);
        }
    }
    (None, first)
}

fn is_same_again<T: PartialEq>(
    gauge: &mut Gauge,
    now: &T,
    whole: impl Fn(&mut Gauge) -> Result<(T, u8)>,
) -> bool {
    gauge.wait(APART);
    whole(gauge).is_ok_and(|(again, _)| again == *now)
}

fn note_shown(gauge: &mut Gauge, place: Window, content: [u8; WINDOW]) {
    if !holds_keys(gauge.chip, place) {
        let moving = learned(gauge.chip, place);
        gauge.note_shown(((place.subclass, place.base), content), moving);
    }
}

fn settle(gauge: &Gauge) {
    gauge.wait(SECOND_LOOK.max(FIRST_LOOK + gauge.chip.access.select));
}

pub(super) fn sequence(gauge: &Gauge) -> &'static dyn Sequence {
    match gauge.chip.access.scheme {
        // A gauge without a table is never written to, and its first transfer of this sequence refused.
        Scheme::Block | Scheme::None | Scheme::Smbus => &block::Block,
        Scheme::CfgUpdate => &cfgupdate::BLOCK,
        Scheme::Mac => &mac::Mac,
        Scheme::MacUpdate => &cfgupdate::MAC,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two wrong bits leave a sum as it is.
    #[test]
    fn a_look_that_differs_in_few_bytes_is_no_look_at_another_block() {
        let chip = Chip::by_name("bq34z100-g1").expect("a table");
        let far = |content: [u8; WINDOW], changed: usize| {
            let mut now = content;
            now[..changed].iter_mut().for_each(|byte| *byte ^= 1);
            Before::of(None, content).is_far(chip, &now)
        };
        for content in [[7; WINDOW], [0; WINDOW], [0xff; WINDOW]] {
            assert!(!far(content, 0) && !far(content, 3) && far(content, 4), "{content:?}");
        }
        // Nor is a blank one, with wrong bits.
        for blank in [0, 0xff] {
            let mut now = [blank; WINDOW];
            now[..2].fill(5);
            assert!(!Before::of(None, [7; WINDOW]).is_far(chip, &now));
        }
    }
}
