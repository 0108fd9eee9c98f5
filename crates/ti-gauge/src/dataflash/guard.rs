// SPDX-License-Identifier: MIT

//! The guard of every session: what would have to be settled is on record before anything is sent to the gauge, whatever
//! happens then the session is closed, and what it leaves is kept.

use std::time::Duration;

use super::DataFlash;
use super::session::{Left, Reference, Session};
use crate::chip::Chip;
use crate::error::Result;
use crate::gauge::{Gauge, Seal};
use crate::journal::{Entry, Mark, Plan};

impl DataFlash {
    /// Runs a session with a gauge that was found in a seal state, for a request made at the time `asked`. An error of
    /// `record` means that nothing was sent; from then on the session is closed on every exit.
    pub(super) fn session<T>(
        &mut self,
        gauge: &mut Gauge,
        (found, asked): (Seal, Duration),
        record: impl FnOnce(&mut Self, &mut Gauge, &mut Session) -> Result<()>,
        run: impl FnOnce(&mut Self, &mut Gauge, &mut Session) -> Result<T>,
    ) -> Result<T> {
        let mut session = Session::new(found, asked);
        session.pack.begin(gauge);
        record(self, gauge, &mut session)?;
        self.guard(gauge, session, run, Self::end)
    }

    /// Runs a session whose record is on disk already, closes it, and passes what it leaves to `end`.
    pub(super) fn guard<T>(
        &mut self,
        gauge: &mut Gauge,
        mut session: Session,
        run: impl FnOnce(&mut Self, &mut Gauge, &mut Session) -> Result<T>,
        end: impl FnOnce(&mut Self, Session, &Gauge, Result<T>, Option<Left>) -> Result<T>,
    ) -> Result<T> {
        let outcome = run(self, gauge, &mut session);
        let (outcome, left) = session.close(gauge, outcome);
        self.in_calibration |= session.calibrating.is_some();
        end(self, session, gauge, outcome, left)
    }

    /// Keeps what a session has left to be settled.
    pub(super) fn end<T>(
        &mut self,
        mut session: Session,
        gauge: &Gauge,
        outcome: Result<T>,
        left: Option<Left>,
    ) -> Result<T> {
        if session.pack.is_another {
            self.now.forget_pack();
            self.doubt_pack();
        }
        if left.is_some() && session.entry.as_ref().is_some_and(|entry| entry.plan.is_none()) {
            // Nothing was written: what its pack is known by is all that is left of it.
            let marks = session.pack.pack.take().map_or(Vec::new(), |pack| pack.plan.marks);
            if let Err(error) = self.note(&mut session, Plan::of_marks(marks)) {
                log::warn!("{error}");
            }
        }
        let plan = session.entry.as_ref().and_then(|entry| entry.plan.as_ref());
        let by_gauge = outcome.is_ok() && plan.is_some_and(|plan| plan.by_gauge);
        match left.or_else(|| by_gauge.then(|| Left::to_be_judged(session.pack.since()))) {
            None => session.remove_journal(),
            Some(left) => self.leave(gauge, session, left),
        }
        outcome
    }

    /// The record of a session that is about to change the gauge's state, and this many blocks.
    pub(super) fn owing(blocks: usize) -> impl FnOnce(&mut Self, &mut Gauge, &mut Session) -> Result<()> {
        move |this, gauge, session| this.owe(gauge, session, blocks)
    }

    /// Records that a session is about to change the gauge's state.
    pub(super) fn owe(&mut self, gauge: &mut Gauge, session: &mut Session, blocks: usize) -> Result<()> {
        let identity = self.identity(gauge)?;
        gauge.watch();
        let entry = Entry { identity: identity.clone(), machine: None, found: session.found, plan: None };
        session.entry = Some(entry);
        self.refer(gauge, session);
        if let Some(journal) = &self.journal {
            session.journal = Some(journal.begin(&identity, session.found, blocks)?);
        }
        Ok(())
    }

    pub(super) fn note(&self, session: &mut Session, plan: Plan) -> Result<()> {
        if let Some(journal) = &mut session.journal {
            journal.plan(&plan)?;
        }
        if let Some(entry) = &mut session.entry {
            entry.plan = Some(plan);
        }
        Ok(())
    }

    /// Records what is known of the pack of which only the seal will be owed.
    pub(super) fn note_marks(&mut self, gauge: &Gauge, session: &mut Session) -> Result<()> {
        let marks = self.marks(gauge.chip);
        if marks.is_empty() {
            return Ok(());
        }
        self.note(session, Plan::of_marks(marks))
    }

    /// What distinguishes the pack, as far as it is known.
    pub(super) fn marks(&self, chip: &'static Chip) -> Vec<Mark> {
        let known = if self.fingerprint().is_empty() { self.known() } else { self.fingerprint() };
        known.marks(chip)
    }

    /// From now on the session's pack is compared with what is known of it.
    pub(super) fn refer(&mut self, gauge: &Gauge, session: &mut Session) {
        let Some(entry) = &session.entry else { return };
        let mut reference = Reference::of(entry);
        if entry.owes_seal() {
            reference.plan.marks = self.marks(gauge.chip);
        }
        session.pack.pack = Some(reference);
    }

    /// Keeps what a session leaves, with its record.
    pub(super) fn leave(&mut self, gauge: &Gauge, mut session: Session, left: Left) {
        let journal = session.journal.take();
        self.keep(gauge, session.entry.take(), journal, left);
    }
}
