// SPDX-License-Identifier: MIT

//! The guard of every session: records what would be owed before anything is sent, always closes, keeps what is left.

use std::time::Duration;

use super::blocks::{blocks, gather};
use super::session::{Left, Session, report_mishap};
use super::{Change, DataFlash, needs_reset, planned};
use crate::error::{Cause, Error, Result};
use crate::gauge::{Gauge, Seal, Statistics};
use crate::journal::{Entry, Identity, OpenJournal, Plan};

/// From a request to its first commit. Before that a write can be given up at any time.
const BEFORE: Duration = Duration::from_secs(16);

#[derive(Clone, Copy)]
pub(super) enum Record<'a> {
    /// The state that the gauge was found in, before it is changed so.
    Write(&'a [Change]),
    /// That state, before this many blocks are changed.
    Change(usize),
    /// That state, before RAM that was lost is written again, which goes on if no journal can be written.
    Restoration(usize),
    /// That a gauge was found sealed, before data flash is read. It goes on if no journal can be written.
    Read,
    /// Nothing: what would be owed is on record already, or the gauge was found open.
    Nothing,
}

impl DataFlash {
    /// Runs an access within its time, counts the blocks that it programs, and watches presence. `waited`: since the request.
    pub(super) fn access<T>(
        &mut self,
        gauge: &mut Gauge,
        waited: Duration,
        run: impl FnOnce(&mut Self, &mut Gauge, Duration) -> Result<T>,
    ) -> Result<T> {
        let asked = gauge.clock.now().saturating_sub(waited);
        let before = Statistics::read(&gauge.statistics.flash_writes);
        gauge.limit(Some(BEFORE.saturating_sub(waited)));
        gauge.attend(true);
        let outcome = run(self, gauge, asked);
        let outcome = report_mishap(gauge, outcome);
        gauge.attend(false);
        gauge.limit(None);
        self.rules.count(gauge, before);
        outcome
    }

    /// A session for a request made at the time `asked`, with its record on disk. After an error nothing was sent.
    pub(super) fn recorded(
        &mut self,
        gauge: &mut Gauge,
        found: Seal,
        asked: Duration,
        record: Record<'_>,
    ) -> Result<Session> {
        let mut session = Session::new(found, asked);
        session.pack.begin(gauge);
        match record {
            Record::Write(changes) => {
                let foreseen = self.foresee(gauge, &session, changes);
                self.owe(gauge, &mut session, blocks(changes), foreseen)?;
            }
            Record::Change(blocks) => self.owe(gauge, &mut session, blocks, None)?,
            Record::Restoration(blocks) => {
                let owed = self.owe(gauge, &mut session, blocks, None);
                self.records.go_on_without(gauge, owed)?;
            }
            Record::Read if found == Seal::Sealed => self.record_read(gauge, &mut session)?,
            Record::Read | Record::Nothing => {}
        }
        Ok(session)
    }

    /// Runs a session whose record is on disk already, closes it on every exit of `run`, and passes what it leaves to `end`.
    pub(super) fn guard<T>(
        &mut self,
        gauge: &mut Gauge,
        mut session: Session,
        run: impl FnOnce(&mut Self, &mut Gauge, &mut Session) -> Result<T>,
        end: impl FnOnce(&mut Self, Session, &Gauge, Result<T>, Option<Left>) -> Result<T>,
    ) -> Result<T> {
        let outcome = run(self, gauge, &mut session);
        let (outcome, left) = session.close(gauge, outcome);
        self.knowledge.note_calibration(session.calibrating.is_some());
        end(self, session, gauge, outcome, left)
    }

    pub(super) fn end<T>(
        &mut self,
        mut session: Session,
        gauge: &Gauge,
        outcome: Result<T>,
        left: Option<Left>,
    ) -> Result<T> {
        if session.pack.is_another {
            self.knowledge.note_another();
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

    /// Records what would be owed, with the plan that is foreseen for a gauge that was found sealed.
    pub(super) fn owe(
        &mut self,
        gauge: &mut Gauge,
        session: &mut Session,
        blocks: usize,
        foreseen: Option<Plan>,
    ) -> Result<()> {
        let identity = self.knowledge.identity(gauge)?;
        gauge.watch();
        let entry = Entry { identity: identity.clone(), machine: None, found: session.found, plan: None };
        session.entry = Some(entry);
        self.knowledge.refer(gauge, session);
        match self.records.journal() {
            Some(journal) if session.found == Seal::Sealed => {
                session.journal = Some(journal.begin(&identity, session.found, blocks, foreseen.as_ref())?);
                session.foreseen = foreseen;
            }
            Some(_) => session.room = Some(blocks),
            None => {}
        }
        Ok(())
    }

    /// The plan of a write to a gauge that was found sealed, by the blocks that are known before it is opened: mostly they
    /// are as they were.
    fn foresee(&self, gauge: &mut Gauge, session: &Session, changes: &[Change]) -> Option<Plan> {
        if session.found != Seal::Sealed {
            return None;
        }
        let known = self.knowledge.known();
        let unknown = || Error::new("", Cause::NotNow, "it is not read yet");
        let mut planned = gather(gauge, changes, |_, place| known.get(place).ok_or_else(unknown)).ok()?;
        planned.retain(|block| block.old != block.new);
        if planned.is_empty() {
            return None;
        }
        planned.iter_mut().for_each(|block| session.keep_open(gauge.chip, block));
        let neighbours = self.knowledge.known_neighbours(gauge.chip, &planned);
        let reset = needs_reset(gauge.chip, changes);
        Some(planned::plan(gauge, reset, &planned, &neighbours, known.marks(gauge.chip)))
    }

    fn record_read(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        let owed = match self.find_pending() {
            None => {
                let marks = self.knowledge.marks(gauge.chip);
                let plan = (!marks.is_empty()).then(|| Plan::of_marks(marks));
                let owed = self.owe(gauge, session, 0, plan.clone());
                owed.and_then(|()| plan.map_or(Ok(()), |plan| self.note(session, plan)))
            }
            Some(_) => self.owe_seal(gauge, session),
        };
        self.records.read_without(owed)
    }

    fn owe_seal(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        let identity = self.knowledge.identity(gauge)?;
        let (entry, record) = self.record_seal(gauge, identity)?;
        (session.entry, session.journal) = (Some(entry), record);
        self.knowledge.refer(gauge, session);
        Ok(())
    }

    /// Records beside another entry that a gauge which was found sealed is about to be opened.
    pub(super) fn record_seal(
        &self,
        gauge: &Gauge,
        identity: Identity,
    ) -> Result<(Entry, Option<OpenJournal>)> {
        let record = self.records.journal().map(|journal| journal.owe_seal(&identity)).transpose()?;
        let plan = Some(Plan::of_marks(self.knowledge.marks(gauge.chip)));
        Ok((Entry { identity, machine: None, found: Seal::Sealed, plan }, record))
    }

    pub(super) fn note(&self, session: &mut Session, plan: Plan) -> Result<()> {
        match (&mut session.journal, session.room.take(), self.records.journal(), &session.entry) {
            (Some(_), ..) if session.foreseen.take().as_ref() == Some(&plan) => {}
            (Some(journal), ..) => journal.plan(&plan)?,
            (None, Some(blocks), Some(journal), Some(Entry { identity, found, .. })) => {
                session.journal = Some(journal.begin(identity, *found, blocks, Some(&plan))?);
            }
            _ => {}
        }
        if let Some(entry) = &mut session.entry {
            entry.plan = Some(plan);
        }
        Ok(())
    }

    pub(super) fn leave(&mut self, gauge: &Gauge, mut session: Session, left: Left) {
        let journal = session.journal.take();
        self.debts.keep(&self.records, gauge, session.entry.take(), journal, left);
    }
}
