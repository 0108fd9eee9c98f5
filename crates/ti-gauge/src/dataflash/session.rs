// SPDX-License-Identifier: MIT

//! A session with an unsealed gauge, which always restores the seal state when it ends.

use std::time::Duration;

use gauge_bus::BusError;

use super::calmode;
use super::schemes::{Care, sequence};
use super::state::{Copied, has_kept};
use super::window::{Planned, locate};
use crate::chip::{Bit, Calibration, Chip};
use crate::codec::Bytes;
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Moment, Seal};

mod assure;
mod store;

use crate::journal::{Entry, KeyPlan, OpenJournal, Plan};
use assure::Assurance;
pub(super) use assure::Reference;
pub(super) use store::{ByKeys, put, store};

/// From a request to its last block. A write that takes longer is undone.
const FORWARD: Duration = Duration::from_secs(18);
/// From a request to the end of the way back, and least time for it, however long the way forward has taken.
const BACK: Duration = Duration::from_secs(24);
const LEAST_BACK: Duration = Duration::from_secs(5);
/// From a request to its answer, and least time for the seal; the rest is owed. On a disturbed bus each ends 1.6 s late.
const ANSWER: Duration = Duration::from_secs(28);
const LEAST_CLOSE: Duration = Duration::from_secs(2);
const TRY_AGAIN: Duration = Duration::from_millis(200);
pub(super) const RESTORES: u32 = 3;
/// Times that RESET is sent, and how long it may take: up to 500 ms without an answer, or with answers as before.
const RESETS: u32 = 3;
const RESET_SHOWS: Duration = Duration::from_millis(650);

/// A session with an unsealed gauge: its seal state at the start, and what is known of it now.
pub(super) struct Session {
    pub(super) found: Seal,
    /// `None` while the state may have changed and is not yet confirmed.
    pub(super) now: Option<Seal>,
    asked: Duration,
    /// A person has decided, so a neighbour goes back whatever it holds.
    pub(super) decided: bool,
    /// A mode was started that must be ended on every exit.
    begun: bool,
    /// The gauge does not seal itself at the end of that mode: what makes it do so was lost with its memory.
    pub(super) stays_open: bool,
    /// Calibration mode was entered and must be left on every exit.
    pub(super) calibrating: Option<&'static Calibration>,
    /// How long the seal state is restored; `None` while a short time is enough.
    pub(super) patience: Option<Patience>,
    pub(super) pack: Assurance,
    /// What would have to be settled if the session ended now.
    pub(super) entry: Option<Entry>,
    pub(super) journal: Option<OpenJournal>,
    /// The plan that the journal has from its beginning; `None` once it is known which one counts.
    pub(super) foreseen: Option<Plan>,
    /// For so many blocks the journal of a gauge that was found open has room. It is made with the plan.
    pub(super) room: Option<usize>,
}

/// How long the seal state of a gauge is restored whose keys have been tried.
#[derive(Clone, Copy)]
pub(super) struct Patience {
    /// Time in which a gauge that does not answer may restart.
    pub(super) silence: Duration,
    /// Time for it all, with the pauses after keys that were refused.
    pub(super) refusals: Duration,
}

pub(super) struct Left {
    /// Data flash is not known; otherwise only the seal is owed.
    pub(super) data: bool,
    pub(super) why: String,
    /// The gauge holds the new values, if data flash is known.
    pub(super) is_new: bool,
    /// When it was certain that the gauge is the one, if it still is.
    pub(super) certain: Option<Moment>,
}

impl Left {
    pub(super) fn of(data: bool, why: String) -> Self {
        Self { data, why, is_new: false, certain: None }
    }

    /// What a gauge is about to store that it has measured itself.
    pub(super) fn to_be_judged(certain: Option<Moment>) -> Self {
        let why = "the gauge measures and stores values of its own that are not judged yet";
        Self { certain, ..Self::of(true, why.into()) }
    }
}

impl Session {
    pub(super) fn new(found: Seal, asked: Duration) -> Self {
        Self {
            found,
            now: Some(found),
            asked,
            decided: false,
            begun: false,
            stays_open: false,
            calibrating: None,
            patience: None,
            pack: Assurance::default(),
            entry: None,
            journal: None,
            foreseen: None,
            room: None,
        }
    }

    /// Removes the journal. One that remains is settled before the next write or at the next start.
    pub(super) fn remove_journal(&mut self) {
        if let Some(Err(error)) = self.journal.take().map(OpenJournal::remove) {
            log::warn!("{error}");
        }
    }

    /// The gauge is in that seal state and stays in it: nobody may be able to open it again.
    pub(super) fn stays(&mut self, now: Seal) {
        (self.found, self.now) = (now, Some(now));
    }

    pub(super) fn open(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.found == Seal::Sealed {
            self.now = None;
            gauge.unseal()?;
            self.pack.was_opened = true;
            self.now = Some(Seal::Unsealed);
            // It is sealed again only if it is certain to be the same one.
            gauge.learn_selection();
        }
        sequence(gauge).enable(gauge)
    }

    pub(super) fn enter_calibration(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(calibration) = gauge.chip.calibration else {
            let why = "no document describes the calibration mode of this part";
            return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Check));
        };
        self.calibrating = Some(calibration);
        calmode::enter(gauge, calibration)
    }

    pub(super) fn leave_calibration(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(calibration) = self.calibrating else { return Ok(()) };
        let left = calmode::leave(gauge, calibration)
            .map_err(|failed| Error::of("", Reason::Calibrating { failed }).at(Step::Restore));
        if left != Ok(false) {
            // The gauge may have been unsealed for it.
            self.now = None;
        }
        left.map(|_| self.calibrating = None)
    }

    pub(super) fn begin(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.begun = sequence(gauge).always_finishes();
        sequence(gauge).begin(gauge)
    }

    fn end_mode(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.begun { self.finish(gauge, Care::Sure, None).map(drop) } else { Ok(()) }
    }

    /// The mode has ended with the gauge's power.
    pub(super) fn forget_mode(&mut self) {
        self.begun = false;
    }

    /// From the first commit on a write is not given up for want of time before this.
    pub(super) fn go_forward(&self, gauge: &mut Gauge) {
        gauge.limit_until(Some(self.asked + FORWARD));
    }

    /// The way back has its own time.
    pub(super) fn go_back(&mut self, gauge: &mut Gauge) {
        self.now = None;
        self.assure_anew(gauge);
        gauge.limit_until(Some((self.asked + BACK).max(gauge.clock.now() + LEAST_BACK)));
    }

    /// Makes the gauge use the new values and data flash readable again. With [`Care::Quick`] RAM is used as looked at in
    /// CONFIG UPDATE: a gauge that seals itself takes no key for 4 s, and data memory is unreadable for 2 s. Registers such
    /// as that of `copied` show whether RAM was lost since. Returns whether it was not: no block needs a further look then.
    pub(super) fn finish(&mut self, gauge: &mut Gauge, care: Care, copied: Option<&Copied>) -> Result<bool> {
        self.now = None;
        if sequence(gauge).always_finishes() {
            let readable = sequence(gauge).leave(gauge)?;
            self.begun = false;
            let is_shut = self.found == Seal::Sealed || gauge.clock.now() < readable;
            if care == Care::Quick && is_shut && has_kept(gauge, copied).unwrap_or(false) {
                self.now = Some(gauge.seal_anew()?);
                return Ok(true);
            }
            gauge.wait_until(readable);
            self.reopen(gauge)?;
        } else {
            let (state, goal) = (self.reset(gauge)?, self.open_as_found());
            self.pack.was_opened |= state == Seal::Sealed;
            gauge.go(state, goal)?;
            self.now = Some(goal);
            sequence(gauge).enable(gauge)?;
        }
        // What it shows from now on is to be that of the gauge that was reset.
        if gauge.chip.volatile.is_none() && self.is_another(gauge) {
            let why = "another pack answers since the reset";
            return Err(Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Identify));
        }
        Ok(false)
    }

    /// A gauge that was found sealed seals itself at the end of CONFIG UPDATE, and takes no key for seconds then. The block with
    /// the bit that makes it do so is written without it: SEALED, with which it is left, sets it again.
    pub(super) fn keep_open(&self, chip: &Chip, block: &mut Planned) {
        let bit = chip.security.seals_itself.filter(|_| self.found == Seal::Sealed);
        let Some((subclass, offset, mask)) = bit else { return };
        let (place, at) = locate(subclass, offset);
        // Somebody may write it as well.
        if block.place == place && !block.written.has(at) {
            block.new[at] &= !mask;
            block.learned = block.learned.without(Bytes::of(|byte| byte == at));
        }
    }

    fn reopen(&mut self, gauge: &mut Gauge) -> Result<()> {
        let goal = self.open_as_found();
        reopen(gauge, goal, self.stays_open)?;
        self.now = Some(goal);
        sequence(gauge).enable(gauge)
    }

    /// The state in which data memory can be read, and which is the one that the gauge was found in where that is possible.
    fn open_as_found(&self) -> Seal {
        if self.found == Seal::Sealed { Seal::Unsealed } else { self.found }
    }

    /// Resets the gauge. One that did not acknowledge RESET is compared before it is sent once more.
    fn reset(&mut self, gauge: &mut Gauge) -> Result<Seal> {
        let mut outcome = Ok(self.found);
        for _ in 0..RESETS {
            let moment = self.assure(gauge)?;
            self.note_reset()?;
            outcome = reset(gauge, self.found, moment);
            if !outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::NotNow)) {
                break;
            }
            // It may have been taken all the same.
            gauge.wait(gauge.chip.access.reset);
            if gauge.seal_anew()? == Seal::Sealed {
                return Ok(Seal::Sealed);
            }
        }
        outcome
    }

    /// Takes over what an interrupted write may have left on: this session ends it, whatever else it does.
    pub(super) fn inherit_modes(&mut self, gauge: &mut Gauge) -> Result<()> {
        // No write is begun in calibration mode, but one may have entered it.
        self.calibrating = gauge.chip.calibration;
        self.begun = sequence(gauge).is_begun(gauge)?;
        Ok(())
    }

    fn note_reset(&mut self) -> Result<()> {
        let Some(plan) = self.entry.as_mut().and_then(|entry| entry.plan.as_mut()) else { return Ok(()) };
        if plan.reset_sent {
            return Ok(());
        }
        plan.reset_sent = true;
        self.journal.as_mut().map_or(Ok(()), OpenJournal::reset_sent)
    }

    /// Has it on disk that the gauge may use the new content, before old content goes back: when all of that is back, data
    /// flash shows no longer that a reset is due. On the way forward it shows that by itself, in its new blocks.
    pub(super) fn keep_reset(&mut self) {
        let noted = self.note_reset();
        let kept = noted.and_then(|()| self.journal.as_mut().map_or(Ok(()), OpenJournal::sync));
        if let Err(error) = kept {
            log::warn!("{error}");
        }
    }

    /// Records how far a key change has come. If that fails the journal says less than is known, and the change goes on.
    pub(super) fn note_keys(&mut self, change: impl FnOnce(&mut KeyPlan), line: &str) {
        if let Some(key) = self.entry.as_mut().and_then(|entry| entry.plan.as_mut()?.key.as_mut()) {
            change(key);
        }
        if let Some(Err(error)) = self.journal.as_mut().map(|journal| journal.note(line)) {
            log::warn!("{error}");
        }
    }

    /// Opens a gauge that is SEALED in the middle of the way back: it has lost its power, or is another one.
    pub(super) fn open_again(&mut self, gauge: &mut Gauge) -> Result<()> {
        if gauge.seal_anew()? != Seal::Sealed {
            return Ok(());
        }
        gauge.lose_sight();
        gauge.unseal()?;
        self.pack.was_opened = true;
        Ok(())
    }

    /// Restores the seal state, confirms it, and reports both errors if there are two. Returns what is left to settle.
    pub(super) fn close<T>(&mut self, gauge: &mut Gauge, outcome: Result<T>) -> (Result<T>, Option<Left>) {
        let begun = gauge.clock.now();
        let least = self.patience.map_or(LEAST_CLOSE, |patience| patience.refusals);
        gauge.limit_until(Some((self.asked + ANSWER).max(begun + least)));
        // A mode that is still on is not that of another pack, which is left as it was found.
        let is_another = outcome.is_err() && self.is_another(gauge);
        let left = if is_another { Ok(()) } else { self.leave_calibration(gauge) };
        let finished = left.and_then(|()| self.end_mode(gauge));
        let unfinished = finished.is_err();
        let mut closed = self.restore_seal(gauge, outcome.is_ok());
        while closed.is_err()
            && self.patience.is_some_and(|patience| gauge.may_try_until(begun + patience.silence))
        {
            gauge.wait(TRY_AGAIN);
            gauge.forget_refusal();
            closed = self.restore_seal(gauge, false);
        }
        let unknown = outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::StateUnknown));
        // To a recording nothing is owed.
        let recorded = [&finished, &closed].into_iter().any(|end| {
            end.as_ref().is_err_and(|error| {
                matches!(error.cause(), Cause::Bus(BusError::NotRecorded | BusError::ReadOnly))
            })
        });
        let is_new = outcome.is_ok();
        let certain = self.pack.since().filter(|&moment| !is_another && gauge.is_unbroken_since(moment));
        let left = |data: bool, error: &Error| {
            (!recorded).then(|| Left { data, why: error.to_string(), is_new, certain })
        };
        let seal = self.found.as_str();
        match (outcome, finished.and(closed)) {
            (Err(error), Ok(())) => {
                let is_owed = unknown || self.pack.has_come(gauge) && self.found == Seal::Sealed;
                let left = is_owed.then(|| left(unknown, &error)).flatten();
                (Err(error), left)
            }
            (Ok(done), Ok(())) => (Ok(done), None),
            (Ok(_), Err(failed)) => {
                let error = Error::of("", Reason::NotClosed { seal, failed });
                let owed = unfinished || self.found == Seal::Sealed;
                let left = if owed { left(unfinished, &error) } else { None };
                (Err(error), left)
            }
            // The gauge does not answer, and nothing was sent that could have changed its state.
            (Err(first), Err(_)) if self.now == Some(self.found) => (Err(first), None),
            (Err(failed), Err(then)) => {
                let error = Error::of("", Reason::FailedOpen { failed, seal, then });
                let data = unknown || unfinished;
                let left = if data || self.found == Seal::Sealed { left(data, &error) } else { None };
                (Err(error), left)
            }
        }
    }

    fn restore_seal(&mut self, gauge: &mut Gauge, is_done: bool) -> Result<()> {
        // After a failure the state is read again: a gauge that lost its power comes back sealed.
        match self.now.filter(|_| is_done) {
            Some(now) if now == self.found => Ok(()),
            Some(_) if self.found == Seal::Sealed => self.seal(gauge),
            Some(now) => gauge.go(now, self.found),
            // CONTROL_STATUS may still show the state before the last key.
            None if self.now != Some(self.found) && self.found == Seal::Sealed => {
                gauge.wait(gauge.chip.security.shows);
                self.seal(gauge)
            }
            None => self.go_to_found(gauge),
        }
    }
}

pub(super) fn reads_wrong(error: &Error) -> bool {
    matches!(error.cause(), Cause::Protocol) && error.step() == Some(Step::Verify)
}

/// Resets the gauge until there is a sign of it: a part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11).
/// If found open it may never have been sealed; then it was silent, [INITCOMP] is clear, or the selection is forgotten.
/// An acknowledgement is no sign. Returns the seal state.
fn reset(gauge: &mut Gauge, found: Seal, moment: Moment) -> Result<Seal> {
    let access = &gauge.chip.access;
    let incomplete = gauge.chip.control_status.iter().find(|bit| bit.name == "INITCOMP");
    let incomplete = |status: u32| incomplete.is_some_and(|&Bit { mask, .. }| status & mask == 0);
    for attempt in 0..RESETS {
        gauge.reset_since(moment)?;
        let sent = gauge.clock.now();
        let mut silent = false;
        match found {
            Seal::Sealed => gauge.await_reset(sent),
            Seal::Unsealed | Seal::FullAccess if attempt == 0 => gauge.wait(access.reset),
            Seal::Unsealed | Seal::FullAccess => {}
        }
        loop {
            let failures = gauge.failures();
            match gauge.control_status() {
                Ok((Seal::Sealed, _)) => return Ok(Seal::Sealed),
                Ok((_, status)) if found != Seal::Sealed => {
                    // One failed transfer is a disturbance.
                    silent |= gauge.failures() > failures + 1;
                    if silent || incomplete(status) || gauge.has_forgotten_selection() {
                        gauge.wait(gauge.chip.security.shows);
                        return gauge.seal();
                    }
                    if gauge.clock.now() >= sent + access.reset + RESET_SHOWS {
                        break;
                    }
                }
                Ok(_) if gauge.clock.now() >= sent + access.reset + RESET_SHOWS => break,
                Ok(_) => {}
                Err(error) if !gauge.may_try_until(sent + access.reset_limit) => {
                    return Err(error.at(Step::Reset));
                }
                Err(_) => silent = true,
            }
            let is_soon = gauge.clock.now() < sent + access.reset;
            gauge.wait(Duration::from_millis(if found == Seal::Sealed && !is_soon { 80 } else { 40 }));
        }
    }
    let unseen = Reason::NoEffect { command: "RESET".into(), times: RESETS.into() };
    Err(Error::of(gauge.chip.model, unseen).at(Step::Reset))
}

/// Waits for an answer after the end of CONFIG UPDATE, then goes to a state in which data memory can be read.
fn reopen(gauge: &mut Gauge, goal: Seal, stays_open: bool) -> Result<()> {
    let access = &gauge.chip.access;
    let limit = gauge.clock.now() + access.reset_limit;
    // The gauge may have sealed itself, and show it late.
    if !stays_open {
        gauge.wait(gauge.chip.security.shows);
    }
    loop {
        match gauge.seal_anew() {
            Ok(now) => return gauge.go(now, goal),
            Err(_) if gauge.may_try_until(limit) => gauge.wait(access.reset.max(Duration::from_millis(50))),
            Err(error) => return Err(error.at(Step::Reset)),
        }
    }
}

/// The outcome of an access. What it has done by mistake is reported as what it is, whatever else has become of it.
pub(super) fn report_mishap<T>(gauge: &mut Gauge, outcome: Result<T>) -> Result<T> {
    let Some(mishap) = gauge.take_mishap() else { return outcome };
    let why = match outcome {
        Ok(_) => format!("done; but {mishap}"),
        Err(error) => format!("{error}; {mishap}"),
    };
    Err(Error::new("", Cause::StateUnknown, why))
}
