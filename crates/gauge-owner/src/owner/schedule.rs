// SPDX-License-Identifier: MIT

//! When a gauge is polled, and which polls read the slow tier.

use std::time::Duration;

/// The slow tier comes with every tenth poll, first with the second: a mount waits only for its attributes.
const SLOW_EVERY: u64 = 10;
/// Consecutive failed polls after which a gauge counts as gone.
pub(super) const FAILURES: u32 = 3;
/// Delay before the first failed poll is repeated; further failures wait for the interval.
pub(super) const RETRY: Duration = Duration::from_secs(1);
/// Least time between polls: a watchdog may reset a gauge with more than two standard commands a second.
pub(super) const SHORTEST: Duration = Duration::from_millis(500);

#[derive(Debug)]
pub(super) struct Schedule {
    /// Successful polls. Skips numbers to move the next poll of the slow tier.
    number: u64,
    /// Consecutive polls that failed.
    failures: u32,
    /// When the last poll began, or failed; before the first one, when the gauge was last identified.
    last: Duration,
    /// When the registers were read before that.
    before: Duration,
    /// The next poll comes early: the second one, after a change of registers, or to try something again.
    soon: Option<Duration>,
    /// See [`super::Run::phase`]; zero once it has been used.
    phase: Duration,
}

impl Schedule {
    pub(super) fn new(phase: Duration, now: Duration) -> Self {
        Self { number: 0, failures: 0, last: now, before: Duration::ZERO, soon: None, phase }
    }

    pub(super) fn due(&self, interval: Duration) -> Duration {
        (self.last + self.pause(interval)).max(self.earliest())
    }

    /// When the registers may be read again: never more than twice a second.
    fn earliest(&self) -> Duration {
        match self.before {
            Duration::ZERO => self.last + SHORTEST,
            before => (self.last + SHORTEST).max(before + 2 * SHORTEST),
        }
    }

    /// The registers are read, to identify the gauge.
    pub(super) fn reads(&mut self, now: Duration) {
        (self.before, self.last) = (self.last, now);
    }

    pub(super) fn pause(&self, interval: Duration) -> Duration {
        match (self.failures, self.soon) {
            (0, Some(soon)) => soon,
            (0, None) => interval.saturating_sub(self.phase).max(SHORTEST.min(interval)),
            (1, _) => interval.min(RETRY),
            _ => interval,
        }
    }

    /// How long to wait before a poll that somebody asks for.
    pub(super) fn wait(&self, now: Duration) -> Duration {
        self.earliest().saturating_sub(now)
    }

    pub(super) fn is_newer_than(&self, moment: Duration) -> bool {
        self.failures == 0 && moment < self.last
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    pub(super) fn has_failed(&self) -> bool {
        self.failures > 0
    }

    pub(super) fn is_gone(&self) -> bool {
        self.failures >= FAILURES
    }

    /// Marks the gauge as gone: it did not answer when it was opened.
    pub(super) fn set_gone(&mut self, now: Duration) {
        (self.failures, self.last) = (FAILURES, now);
    }

    /// Polls again soon: what the registers hold has changed.
    pub(super) fn hurry(&mut self) {
        self.soon = Some(SHORTEST);
    }

    /// Polls again after a pause from now on, which doubles with each attempt up to the interval.
    pub(super) fn try_again(&mut self, now: Duration, attempts: u32, interval: Duration) {
        let pause = SHORTEST.saturating_mul(1_u32.checked_shl(attempts).unwrap_or(u32::MAX));
        self.soon = Some(now.saturating_sub(self.last) + pause.min(interval));
    }

    /// The next poll is the first of a gauge; the one after it reads the slow tier.
    pub(super) fn begin_anew(&mut self) {
        self.number = self.number.next_multiple_of(SLOW_EVERY);
    }

    pub(super) fn read_slow_tier(&mut self) {
        self.number = self.number.next_multiple_of(SLOW_EVERY) + 1;
    }

    pub(super) fn has_read_slow_tier(&self) -> bool {
        self.number % SLOW_EVERY == 2
    }

    pub(super) fn reads_slow_tier(&self) -> bool {
        self.number % SLOW_EVERY == 1
    }

    pub(super) fn succeeded(&mut self, begun: Duration) -> u64 {
        self.number += 1;
        self.reads(begun);
        self.failures = 0;
        if self.soon.is_none() && self.number > 1 {
            self.phase = Duration::ZERO;
        }
        self.soon = None;
        self.number
    }

    pub(super) fn failed(&mut self, now: Duration) {
        self.failures = self.failures.saturating_add(1);
        self.reads(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slow_tier_is_read_with_the_second_poll_and_every_tenth_after_it() {
        let mut schedule = Schedule::new(Duration::ZERO, Duration::ZERO);
        let mut polls = |count| -> Vec<usize> {
            let slow = (1..=count).filter(|_| {
                let slow = schedule.reads_slow_tier();
                schedule.succeeded(Duration::ZERO);
                slow
            });
            slow.collect()
        };
        assert_eq!(polls(25), [2, 12, 22]);
    }

    #[test]
    fn a_gauge_that_comes_back_is_polled_as_at_first() {
        let mut schedule = Schedule::new(Duration::ZERO, Duration::ZERO);
        let last = (0..5).map(|_| schedule.succeeded(Duration::ZERO)).last();
        schedule.begin_anew();
        assert!(!schedule.reads_slow_tier());
        assert!(Some(schedule.succeeded(Duration::ZERO)) > last, "numbers are not used twice");
        assert!(schedule.reads_slow_tier());
    }
}
