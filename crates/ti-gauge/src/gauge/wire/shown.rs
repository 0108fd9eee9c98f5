// SPDX-License-Identifier: MIT

//! The block that the window shows, by which one that is selected next is told from it.

use std::time::Duration;

use crate::codec::WINDOW;
use crate::gauge::Gauge;
use gauge_bus::BusError;
use gauge_bus::replay::Touch;

/// A block by subclass and base, and its content.
pub(crate) type Block = ((u8, u16), [u8; WINDOW]);

/// Later than that somebody else may have selected another block: the next one follows at once, unless the host was paused.
const FRESH: Duration = Duration::from_millis(20);

/// What is known of the window.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// The block that it shows, and when that was believed. Nothing was sent since then that may change the window.
    block: Option<(Block, Duration)>,
    /// A block of this access was not there at the first look.
    late: bool,
}

impl Shown {
    /// A transfer. Selections, subcommands and bytes that are written may change the window, and a gauge that does not
    /// answer may be another one.
    pub(super) fn transfer(&mut self, touches: &[(Touch, u8)], outcome: Result<(), BusError>) {
        if !touches.is_empty() || outcome.is_err() {
            self.block = None;
        }
    }

    /// The window may show anything.
    pub(super) fn forget(&mut self) {
        self.block = None;
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

    /// A look at the block was believed.
    pub(crate) fn note_shown(&mut self, block: Block) {
        self.wire.shown.block = Some((block, self.clock.now()));
    }

    /// Whether a block of this access was late.
    pub(crate) fn loads_late(&self) -> bool {
        self.wire.shown.late
    }

    /// Whether a block was not there at the first look.
    pub(crate) fn note_late(&mut self, late: bool) {
        self.wire.shown.late |= late;
    }

    /// An access begins, or ends: nothing is known of the window.
    pub(in crate::gauge) fn forget_shown(&mut self) {
        self.wire.shown = Shown::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_may_change_the_window_forgets_it() {
        let is_kept = |touches: &[(Touch, u8)], outcome| {
            let mut shown = Shown { block: Some((((80, 32), [7; WINDOW]), Duration::ZERO)), late: false };
            shown.transfer(touches, outcome);
            shown.at(Duration::ZERO).is_some()
        };
        assert!(is_kept(&[], Ok(())));
        assert!(!is_kept(&[], Err(BusError::NoAck)));
        for touch in [Touch::Selects(0), Touch::Subcommand(0), Touch::Fills(3), Touch::Commits, Touch::Beside]
        {
            assert!(!is_kept(&[(touch, 0)], Ok(())), "{touch:?}");
        }
    }

    /// A host that was paused finds the block that another program has selected.
    #[test]
    fn what_the_window_shows_is_known_for_a_moment() {
        let since = Duration::from_secs(7);
        let shown = Shown { block: Some((((80, 32), [7; WINDOW]), since)), late: false };
        assert!(shown.at(since).is_some() && shown.at(since + FRESH).is_none());
    }
}
