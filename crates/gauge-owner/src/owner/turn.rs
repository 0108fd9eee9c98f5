// SPDX-License-Identifier: MIT

//! The turns in which an owner works: who waits for the first one, when the last one ended, and whether there is another.

use std::sync::mpsc::{SendError, Sender};
use std::time::{Duration, Instant};

use super::Attempt;
use super::handle::Shared;
use crate::error::Result;

/// Longest time without a look at the clock: that counts while the host is asleep, and a wait does not.
const NAP: Duration = Duration::from_secs(30);
/// Longest time without a look at the clock for a gauge that may have lost its memory while the host was asleep.
const NAP_OF_RAM: Duration = Duration::from_secs(1);
/// Time by which the gauge's clock may be ahead of one that stops with the host, although the host was awake.
const AWAKE: Duration = Duration::from_millis(500);

#[derive(Debug, Default)]
pub(super) struct Turn {
    opening: Option<Opening>,
    /// The owner was asked to end: from then on it does nothing.
    is_last: bool,
    /// The end of the last turn, by the gauge's clock and by one that stops while the host is asleep.
    ended: Option<(Duration, Instant)>,
}

#[derive(Debug)]
pub(super) struct Opening(Sender<Result<()>>);

impl Opening {
    /// Sends the outcome. If nobody waits any more, it goes to the log.
    pub(super) fn answer(self, shared: &Shared, outcome: Result<()>) {
        match self.0.send(outcome) {
            Ok(()) => {}
            Err(SendError(Ok(()))) => log::info!("{}: the gauge answers", shared.name()),
            Err(SendError(Err(error))) => shared.report(Attempt::Poll, &error),
        }
    }
}

impl Turn {
    pub(super) fn begin_with(&mut self, opening: Sender<Result<()>>) {
        self.opening = Some(Opening(opening));
    }

    pub(super) fn take_opening(&mut self) -> Option<Opening> {
        self.opening.take()
    }

    /// Whether the host was asleep since the last turn. A sleep that stops no clock shows in a nap that was too long.
    pub(super) fn was_asleep(&self, now: Duration) -> bool {
        self.ended
            .is_some_and(|(then, awake)| now.saturating_sub(then) > awake.elapsed().min(NAP_OF_RAM) + AWAKE)
    }

    pub(super) fn make_last(&mut self) {
        self.is_last = true;
    }

    /// Ends a turn. Returns how long nothing is due; `None` after the last one.
    pub(super) fn end(&mut self, now: Duration, due: Duration, is_watched: bool) -> Option<Duration> {
        self.ended = Some((now, Instant::now()));
        let nap = if is_watched { NAP_OF_RAM } else { NAP };
        (!self.is_last).then(|| due.saturating_sub(now).min(nap))
    }

    /// For tests: when the last turn ended; `None` as before the first one.
    #[cfg(test)]
    pub(super) fn pretend_ended(&mut self, ended: Option<(Duration, Instant)>) {
        self.ended = ended;
    }
}
