// SPDX-License-Identifier: MIT

//! What is counted of a gauge's traffic, and the progress of a write.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::asked::Asked;
use super::effects::Effects;
use super::packets::Pec;

/// Counters since the gauge was opened.
#[derive(Debug, Default)]
pub struct Statistics {
    /// START...STOP transfers.
    pub transfers: AtomicU64,
    /// Bytes on the wire, address bytes included.
    pub bytes: AtomicU64,
    /// Transfers that were retried.
    pub retries: AtomicU64,
    /// Polls that succeeded.
    pub polls: AtomicU64,
    /// Polls that failed.
    pub failed_polls: AtomicU64,
    /// Blocks of data flash that were programmed.
    pub flash_writes: AtomicU64,
    /// Resets that were sent.
    pub resets: AtomicU64,
    /// Packet error codes that were compared, and those that were wrong.
    pub pec_checked: AtomicU64,
    /// See [`Self::pec_checked`].
    pub pec_wrong: AtomicU64,
    pec: AtomicU64,
    asked: AtomicU64,
    /// Keys that were sent.
    pub keys: AtomicU64,
    /// Writes whose values were already stored.
    pub unchanged_writes: AtomicU64,
    /// Times until a commit was seen.
    pub commits: Effects,
    /// Times until a RESET was seen, which seals.
    pub reset_seals: Effects,
    /// Times until the measurement of an offset was seen.
    pub offsets: Effects,
    /// Progress of the current write.
    pub progress: Progress,
}

/// What a write is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Blocks are read and saved before anything is written.
    Saving,
    /// Blocks are programmed.
    Committing,
}

/// What the current write is at: its phase, the blocks of that that are done, and their total.
#[derive(Debug, Default)]
pub struct Progress {
    /// Blocks done, above the number of blocks and [`Self::SAVES`]; 0 while nothing is written.
    blocks: AtomicU64,
    /// When it began, in milliseconds of the gauge's clock.
    since: AtomicU64,
}

impl Progress {
    const SAVES: u64 = 1 << 31;

    /// Starts a phase of `blocks` blocks, at that time.
    pub fn begin(&self, phase: Phase, blocks: usize, now: Duration) {
        if self.get().is_none() {
            self.since.store(now.as_millis().try_into().unwrap_or(u64::MAX), Ordering::Relaxed);
        }
        let saves = if phase == Phase::Saving { Self::SAVES } else { 0 };
        self.blocks.store(blocks as u64 | saves, Ordering::Relaxed);
    }

    /// Counts a block of that phase, while it is going on.
    pub fn step(&self, phase: Phase) {
        if self.get().is_some_and(|(now, ..)| now == phase) {
            self.blocks.fetch_add(1 << 32, Ordering::Relaxed);
        }
    }

    /// Ends the write, whatever its outcome.
    pub fn end(&self) {
        self.blocks.store(0, Ordering::Relaxed);
    }

    /// The phase, the blocks done and the total; `None` while no write is in progress.
    pub fn get(&self) -> Option<(Phase, u32, u32)> {
        let both = self.blocks.load(Ordering::Relaxed);
        let phase = if both & Self::SAVES == 0 { Phase::Committing } else { Phase::Saving };
        let total = both & (Self::SAVES - 1);
        (both != 0).then_some((phase, (both >> 32) as u32, total as u32))
    }

    /// When the write began, by the gauge's clock.
    pub fn since(&self) -> Duration {
        Duration::from_millis(self.since.load(Ordering::Relaxed))
    }
}

impl Statistics {
    /// Value of a counter.
    pub fn read(counter: &AtomicU64) -> u64 {
        counter.load(Ordering::Relaxed)
    }

    /// Adds one to a counter.
    pub fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn set_pec(&self, pec: Pec) {
        self.pec.store(pec.number(), Ordering::Relaxed);
    }

    /// What is known of a Smart Battery's packet error codes.
    pub fn pec(&self) -> Pec {
        Pec::of(Self::read(&self.pec))
    }

    pub(super) fn set_asked(&self, asked: Asked) {
        self.asked.store(asked.number(), Ordering::Relaxed);
    }

    /// What came of asking a gauge of TI's in a Smart Battery.
    pub fn asked(&self) -> Asked {
        Asked::of(Self::read(&self.asked))
    }

    /// Names and values, in the order of `gauge/statistics`.
    pub fn list(&self) -> Vec<(&'static str, u64)> {
        let read = Self::read;
        vec![
            ("transfers", read(&self.transfers)),
            ("bytes", read(&self.bytes)),
            ("retries", read(&self.retries)),
            ("polls", read(&self.polls)),
            ("failed_polls", read(&self.failed_polls)),
            ("pec_checked", read(&self.pec_checked)),
            ("pec_wrong", read(&self.pec_wrong)),
            ("flash_writes", read(&self.flash_writes)),
            ("resets", read(&self.resets)),
            ("unchanged_writes", read(&self.unchanged_writes)),
            ("commits_seen", self.commits.count()),
            ("commit_seen_ms", self.commits.seen_ms()),
            ("commit_unseen_ms", self.commits.unseen_ms()),
            ("resets_seen", self.reset_seals.count()),
            ("reset_seen_ms", self.reset_seals.seen_ms()),
            ("reset_unseen_ms", self.reset_seals.unseen_ms()),
            ("offsets_seen", self.offsets.count()),
            ("offset_seen_ms", self.offsets.seen_ms()),
            ("offset_unseen_ms", self.offsets.unseen_ms()),
        ]
    }
}
