// SPDX-License-Identifier: MIT

//! What a user allows: writes per hour, and the end of a learning cycle. Gauges let a runaway script wear out their flash.

use std::collections::VecDeque;
use std::time::Duration;

use crate::error::{Error, Reason, Result, Step};
use crate::gauge::{Gauge, Statistics};

const HOUR: Duration = Duration::from_secs(3600);

/// Limits that a user may change.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Allow writes during a learning cycle, which end it.
    pub allow_learning: bool,
    /// Blocks of flash that may be programmed within an hour; 0 for no limit.
    pub writes_per_hour: u32,
}

/// At this rate a block's 20,000 cycles (SLUSBZ5D 6.12) last a weekend (66 h); the largest table can be written once.
pub const WRITES_PER_HOUR: u32 = 300;

impl Default for Limits {
    fn default() -> Self {
        Self { allow_learning: false, writes_per_hour: WRITES_PER_HOUR }
    }
}

#[derive(Debug, Default)]
pub(super) struct Rules {
    limits: Limits,
    wear: Wear,
}

impl Rules {
    pub(super) fn new(limits: Limits) -> Self {
        Self { limits, wear: Wear::default() }
    }

    /// Refuses a write while the limit is reached. RAM does not wear out, so parts with RAM have no limit.
    pub(super) fn check_wear(&mut self, gauge: &Gauge) -> Result<()> {
        match self.limits.writes_per_hour {
            0 => Ok(()),
            _ if gauge.chip.volatile.is_some() => Ok(()),
            limit => self.wear.check(gauge.clock.now(), limit),
        }
    }

    /// Counts the blocks that were programmed since the gauge had counted `before` of them.
    pub(super) fn count(&mut self, gauge: &Gauge, before: u64) {
        let blocks = Statistics::read(&gauge.statistics.flash_writes) - before;
        self.wear.record(gauge.clock.now(), blocks);
    }

    pub(super) fn check_learning(&self, gauge: &Gauge, learning: Option<Error>) -> Result<()> {
        match learning {
            Some(error) if !self.limits.allow_learning => Err(error),
            Some(_) => {
                log::warn!("{}: this write ends a learning cycle", gauge.chip.name);
                Ok(())
            }
            None => Ok(()),
        }
    }
}

#[derive(Debug, Default)]
struct Wear {
    spent: VecDeque<(Duration, u64)>,
}

impl Wear {
    fn record(&mut self, now: Duration, blocks: u64) {
        if blocks > 0 {
            self.spent.push_back((now, blocks));
        }
    }

    /// Refuses a transaction at the limit. Checked before a transaction only, so one of any size can complete.
    fn check(&mut self, now: Duration, limit: u32) -> Result<()> {
        while self.spent.front().is_some_and(|(at, _)| *at + HOUR <= now) {
            self.spent.pop_front();
        }
        let spent: u64 = self.spent.iter().map(|(_, blocks)| blocks).sum();
        let mut left = spent;
        let frees = self.spent.iter().find(|(_, blocks)| {
            left -= blocks;
            left < u64::from(limit)
        });
        let Some((at, _)) = frees.filter(|_| spent >= u64::from(limit)) else { return Ok(()) };
        let seconds = (*at + HOUR - now).as_secs() + 1;
        let reason = Reason::Wear { blocks: spent as i64, greatest: limit.into(), seconds: seconds as i64 };
        Err(Error::of("data flash", reason).at(Step::Check))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: Duration = Duration::from_secs(60);

    #[test]
    fn the_window_slides() {
        let mut wear = Wear::default();
        for minute in 0..3 {
            assert_eq!(wear.check(MINUTE * minute, 3), Ok(()));
            wear.record(MINUTE * minute, 1);
        }
        let refused = wear.check(MINUTE * 10, 3).expect_err("three of three").to_string();
        assert!(refused.contains("3 blocks") && refused.contains("in 50 min 1 s"), "{refused}");
        assert!(wear.check(MINUTE * 60 - Duration::from_secs(1), 3).is_err());
        assert_eq!(wear.check(MINUTE * 60, 3), Ok(()));
        wear.record(MINUTE * 60, 1);
        assert!(wear.check(MINUTE * 60, 3).is_err());
        assert_eq!(wear.check(MINUTE * 61, 3), Ok(()));
    }

    /// After a large transaction it takes until enough of what was there is an hour old.
    #[test]
    fn a_large_transaction_is_waited_for() {
        let mut wear = Wear::default();
        wear.record(Duration::ZERO, 2);
        wear.record(MINUTE, 40);
        wear.record(MINUTE * 2, 2);
        let refused = wear.check(MINUTE * 3, 10).expect_err("44 of 10").to_string();
        assert!(refused.contains("44 blocks") && refused.contains("in 58 min 1 s"), "{refused}");
        assert_eq!(wear.check(MINUTE * 61, 10), Ok(()));
    }
}
