// SPDX-License-Identifier: MIT

//! The block that the window shows, by which one that is selected next is told from it.

use std::time::Duration;

use crate::codec::{Bytes, WINDOW};
use crate::gauge::Gauge;
use gauge_bus::BusError;
use gauge_bus::replay::Touch;

/// A block by subclass and base, and its content.
pub(crate) type Block = ((u8, u16), [u8; WINDOW]);

/// By then a gauge has loaded what was selected.
const LOADED: Duration = Duration::from_millis(55);
/// A gauge that has a block by then is as quick the next time.
const QUICK: Duration = Duration::from_millis(1);

/// Later than that somebody else may have selected another block: the next one follows at once, unless the host was paused.
const FRESH: Duration = Duration::from_millis(20);

/// What is known of the window.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// The block that it shows, and when that was believed. Nothing was sent since then that may change the window.
    block: Option<(Block, Duration)>,
    /// How long a block takes to be shown; `None` where that is not known.
    load_time: Option<Duration>,
    /// When something was selected that was not seen since.
    selected: Option<Duration>,
    /// Two blocks that were believed, with the bytes that stay as they are: to be loaded before another one is.
    landmarks: [Option<Landmark>; 2],
}

/// A block that is told from any other by what it shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landmark {
    pub(crate) place: (u8, u16),
    content: [u8; WINDOW],
    steady: Bytes,
}

impl Landmark {
    /// Bytes that stay as they are, and are not those of a blank block.
    pub(crate) const STEADY: usize = 4;

    /// `None` of a block that may show anything, or as good as nothing.
    fn of((place, content): Block, moving: Bytes) -> Option<Self> {
        let steady = Bytes::of(|at| !moving.has(at) && content[at] != 0 && content[at] != 0xff);
        (steady.iter().count() >= Self::STEADY).then_some(Self { place, content, steady })
    }

    pub(crate) fn is(&self, now: &[u8; WINDOW]) -> bool {
        self.steady.iter().all(|at| now[at] == self.content[at])
    }

    /// Whether it is told from that content, whatever of it moves, by bytes from there on.
    pub(crate) fn differs_from(&self, other: &[u8; WINDOW], from: usize) -> bool {
        let differs = |at: &usize| *at >= from && other[*at] != self.content[*at];
        self.steady.iter().filter(differs).count() >= Self::STEADY
    }
}

impl Shown {
    /// A transfer. Selections, subcommands and bytes that are written may change the window, and a gauge that does not
    /// answer may be another one.
    pub(super) fn transfer(
        &mut self,
        touches: &[(Touch, u8)],
        outcome: Result<(), BusError>,
        (is_flat, now): (bool, Duration),
    ) {
        if !touches.is_empty() || outcome.is_err() {
            self.block = None;
        }
        let loads = |touch: &Touch| match touch {
            Touch::Selects(_) => true,
            // Its answer takes the place of a block.
            Touch::Subcommand(_) => is_flat,
            Touch::Fills(_) | Touch::Commits | Touch::Beside => false,
        };
        if touches.iter().any(|(touch, _)| loads(touch)) {
            self.selected = Some(now);
        }
    }

    /// The window may show anything.
    pub(super) fn forget(&mut self) {
        self.block = None;
    }

    fn rests(&self, now: Duration) -> bool {
        self.selected.is_none_or(|since| now >= since + LOADED)
    }

    fn note_landmark(&mut self, landmark: Landmark) {
        let [first, second] = &mut self.landmarks;
        let slot = match (&first, &second) {
            (Some(known), _) if known.place == landmark.place => first,
            (None, _) => first,
            (Some(_), Some(known)) if known.place != landmark.place => return,
            (Some(_), _) => second,
        };
        *slot = Some(landmark);
    }

    fn at(&self, now: Duration) -> Option<Block> {
        self.block.filter(|(_, since)| now < *since + FRESH).map(|(block, _)| block)
    }
}

impl Gauge {
    /// The block that the window certainly shows; `None` if it may show another one, now or soon.
    pub(crate) fn shown(&self) -> Option<Block> {
        self.wire.shown.at(self.clock.now())
    }

    /// Whether the window shows the same until something is selected: all that was selected is there by now.
    pub(crate) fn window_rests(&self) -> bool {
        self.wire.shown.rests(self.clock.now())
    }

    /// The answer to a subcommand has come: nothing is on its way into the window.
    pub(in crate::gauge) fn note_answered(&mut self) {
        self.wire.shown.selected = None;
    }

    /// A look at the block was believed. The gauge may rewrite its `moving` bytes.
    pub(crate) fn note_shown(&mut self, block: Block, moving: Bytes) {
        (self.wire.shown.block, self.wire.shown.selected) = (Some((block, self.clock.now())), None);
        if let Some(landmark) = Landmark::of(block, moving) {
            self.wire.shown.note_landmark(landmark);
        }
    }

    /// A landmark at another place than these.
    pub(crate) fn landmark(&self, others: [Option<(u8, u16)>; 2]) -> Option<Landmark> {
        let known = self.wire.shown.landmarks.iter().flatten();
        known.copied().find(|known| !others.contains(&Some(known.place)))
    }

    /// A landmark that does not show itself is forgotten: another program has written it, or it is another pack's.
    pub(crate) fn forget_landmark(&mut self, place: (u8, u16)) {
        let landmarks = self.wire.shown.landmarks.iter_mut();
        landmarks.for_each(|known| *known = known.filter(|known| known.place != place));
    }

    /// How long a block takes to be shown, if that is known.
    pub(crate) fn load_time(&self) -> Option<Duration> {
        self.wire.shown.load_time
    }

    pub(crate) fn note_load_time(&mut self, time: Duration) {
        self.wire.shown.load_time = self.wire.shown.load_time.max(Some(time));
    }

    /// An access begins, or ends: nothing is known of what the window shows. A gauge that was slow may have been busy.
    pub(in crate::gauge) fn forget_shown(&mut self) {
        self.wire.shown.block = None;
        self.wire.shown.load_time.take_if(|time| *time > QUICK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_may_change_the_window_forgets_it() {
        let is_kept = |touches: &[(Touch, u8)], outcome| {
            let block = Some((((80, 32), [7; WINDOW]), Duration::ZERO));
            let mut shown = Shown { block, ..Shown::default() };
            shown.transfer(touches, outcome, (false, Duration::ZERO));
            shown.at(Duration::ZERO).is_some()
        };
        assert!(is_kept(&[], Ok(())));
        assert!(!is_kept(&[], Err(BusError::NoAck)));
        for touch in [Touch::Selects(0), Touch::Subcommand(0), Touch::Fills(3), Touch::Commits, Touch::Beside]
        {
            assert!(!is_kept(&[(touch, 0)], Ok(())), "{touch:?}");
        }
    }

    /// Until then the window may show it at any moment, whatever it shows now.
    #[test]
    fn a_window_rests_when_what_was_selected_is_there() {
        let begun = Duration::from_secs(7);
        let rests = |touch: Touch, is_flat: bool, later: u64| {
            let mut shown = Shown::default();
            assert!(shown.rests(begun));
            shown.transfer(&[(touch, 0)], Err(BusError::NoAck), (is_flat, begun));
            shown.rests(begun + Duration::from_millis(later))
        };
        for (touch, is_flat) in
            [(Touch::Selects(0), false), (Touch::Selects(1), true), (Touch::Subcommand(0), true)]
        {
            assert!(!rests(touch, is_flat, 54) && rests(touch, is_flat, 55), "{touch:?}");
        }
        for touch in [Touch::Subcommand(0), Touch::Fills(3), Touch::Commits, Touch::Beside] {
            assert!(rests(touch, false, 0), "{touch:?}");
        }
    }

    /// A host that was paused finds the block that another program has selected.
    #[test]
    fn what_the_window_shows_is_known_for_a_moment() {
        let since = Duration::from_secs(7);
        let shown = Shown { block: Some((((80, 32), [7; WINDOW]), since)), ..Shown::default() };
        assert!(shown.at(since).is_some() && shown.at(since + FRESH).is_none());
    }
}
