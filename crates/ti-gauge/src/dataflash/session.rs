//! A session with an unsealed gauge, which always restores the seal state when it ends.

use std::time::Duration;

use super::blocks::Dirty;
use super::io::store;
use super::schemes::sequence;
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::journal::OpenJournal;

/// Time for writing. With `BACK` spent on restoring values and again on sealing, write(2) returns within 30 s.
const FORWARD: Duration = Duration::from_secs(16);
/// Time for restoring the old values, and again for restoring the seal state.
pub(super) const BACK: Duration = Duration::from_secs(6);
/// Attempts to restore the old bytes.
pub(super) const RESTORES: u32 = 3;

/// A session with an unsealed gauge: its seal state at the start, and what is known of it now.
pub(super) struct Session {
    pub(super) found: Seal,
    /// `None` while the state may have changed and is not yet confirmed.
    pub(super) now: Option<Seal>,
    /// A mode was started that must be ended on every exit.
    begun: bool,
    /// Records the write; removed when the session has ended properly.
    pub(super) journal: Option<OpenJournal>,
}

impl Session {
    pub(super) fn new(found: Seal) -> Self {
        Self { found, now: Some(found), begun: false, journal: None }
    }

    /// Removes the journal entry: nothing is left to settle.
    fn remove_journal(&mut self) {
        // An entry that remains is settled before the next write or at the next start, so no harm is done.
        if let Some(Err(error)) = self.journal.take().map(OpenJournal::remove) {
            log::warn!("{error}");
        }
    }

    /// Makes data flash readable.
    pub(super) fn open(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.found == Seal::Sealed {
            self.now = None;
            gauge.unseal()?;
            self.now = Some(Seal::Unsealed);
        }
        sequence(gauge).enable(gauge)
    }

    /// Makes data flash writable.
    pub(super) fn begin(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.begun = sequence(gauge).always_finishes();
        sequence(gauge).begin(gauge)
    }

    /// Makes the gauge use the new values and data flash readable again.
    pub(super) fn finish(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.now = None;
        sequence(gauge).finish(gauge)?;
        self.begun = false;
        self.now = Some(reopen(gauge, self.found)?);
        sequence(gauge).enable(gauge)
    }

    /// Restores the old bytes, the last block first: flash is then open after each of them as it was on the way
    /// here. Once the gauge uses the new values (`finished`) only the written bytes are
    /// restored, which keeps what it has learned since. Before that the whole block is: a bit error in a
    /// register address puts a byte in the wrong place, and the checksum, a plain sum, does not detect it.
    pub(super) fn restore(&mut self, gauge: &mut Gauge, touched: &[Dirty], finished: bool) -> Result<()> {
        let mut outcome = Ok(());
        for _ in 0..RESTORES {
            outcome = gauge
                .seal()
                .and_then(|now| if now == Seal::Sealed { gauge.unseal() } else { Ok(()) })
                .and_then(|()| sequence(gauge).enable(gauge))
                .and_then(|()| {
                    touched.iter().rev().try_for_each(|block| self.restore_block(gauge, block, finished))
                });
            if outcome.is_ok() {
                break;
            }
            gauge.wait(Duration::from_millis(200));
        }
        outcome.map_err(|error| error.at(Step::Restore))
    }

    fn restore_block(&mut self, gauge: &mut Gauge, block: &Dirty, finished: bool) -> Result<()> {
        let range = if finished { block.written.clone() } else { 0..WINDOW };
        let present = sequence(gauge).load(gauge, block.place)?;
        let mut wanted = present;
        wanted[range.clone()].copy_from_slice(&block.old[range]);
        if wanted == present {
            return Ok(());
        }
        self.begin(gauge)?;
        if sequence(gauge).fills_window() {
            sequence(gauge).reload(gauge, block.place, &present)?;
        }
        let back = Dirty { place: block.place, old: present, new: wanted, written: block.written.clone() };
        store(gauge, &back, &mut 0)
    }

    /// Ends every transaction: restores the seal state, confirms it, and reports both errors if there are
    /// two.
    pub(super) fn close<T>(mut self, gauge: &mut Gauge, outcome: Result<T>) -> Result<T> {
        gauge.limit(Some(BACK));
        let finished = if self.begun { self.finish(gauge) } else { Ok(()) };
        // After a failure the state is read again: a gauge that lost its power comes back sealed.
        let closed = match self.now.filter(|_| outcome.is_ok()) {
            Some(now) => gauge.go(now, self.found),
            None => gauge.go_to(self.found),
        };
        let found = self.found.as_str();
        match (outcome, finished.and(closed)) {
            (outcome, Ok(())) => {
                if !outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::StateUnknown(_))) {
                    self.remove_journal();
                }
                outcome
            }
            (Ok(_), Err(error)) => {
                let why = format!("write succeeded, but restoring the {found} state failed: {error}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
            // The gauge does not answer, and nothing was sent that could have changed its state.
            (Err(first), Err(_)) if self.now == Some(self.found) => Err(first),
            (Err(first), Err(second)) => {
                let why = format!("{first}; then restoring the {found} state failed: {second}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
        }
    }
}

/// Waits for the end of a reset and returns to a state in which data flash can be read.
fn reopen(gauge: &mut Gauge, found: Seal) -> Result<Seal> {
    let access = &gauge.chip.access;
    let goal = if found == Seal::Sealed { Seal::Unsealed } else { found };
    gauge.wait(access.reset);
    // A part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11): no need to read the state first.
    if found == Seal::Sealed && gauge.unseal().is_ok() {
        return Ok(goal);
    }
    let limit = gauge.clock.now() + access.reset_limit;
    loop {
        match gauge.seal() {
            Ok(now) => return gauge.go(now, goal).map(|()| goal),
            Err(_) if gauge.clock.now() < limit => gauge.wait(access.reset.max(Duration::from_millis(50))),
            Err(error) => return Err(error.at(Step::Reset)),
        }
    }
}

/// Runs a transaction with a time limit, so that it ends within 30 s of its request, which was made
/// `waited` ago.
pub(super) fn in_time<T>(
    gauge: &mut Gauge,
    waited: Duration,
    run: impl FnOnce(&mut Gauge) -> Result<T>,
) -> Result<T> {
    gauge.limit(Some(FORWARD.saturating_sub(waited)));
    let outcome = run(gauge);
    gauge.limit(None);
    outcome
}
