// SPDX-License-Identifier: MIT

//! Settles interrupted writes by their entry: seal state and blocks from before the write, and what distinguishes the pack.
//!
//! A wrong belief does more harm here than the fault: 32 bytes of one pack's configuration in another pack. Nothing is
//! written unless the pack is certainly the one, and every byte of its blocks is old, new, erased or rewritten by the
//! gauge itself. Anything else is left as it is for a person to decide.

use std::cell::OnceCell;
use std::path::Path;
use std::time::Duration;

use super::DataFlash;
use super::debts::{Owed, OwedSeal, Pending, Where, interrupted};
use super::pack::{Match, compare};
use super::schemes::{Care, sequence};
use super::session::{Reference, Session};
use super::state::has_lost_memory;
use super::verdict::Verdict;
use super::window::holds_keys;
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Entry, Identity, Journal, OpenJournal, Plan};

mod decide;
mod search;
mod task;

pub(super) use search::search_waiting;
use search::{may_be_of, search};
use task::Task;

const ERASED_KEY: [u16; 2] = [0xffff; 2];

/// How often a block that does not read back as it was stored is put back. Each time programs it three times.
const TRIES: u32 = 3;
/// So soon after a session that has left something nobody exchanges a gauge that has answered since.
const SOON: Duration = Duration::from_secs(1);

/// How long another gaugefs may take to judge the same journal: each gauge that comes looks at one that waits.
const TURN: Duration = Duration::from_secs(6);

/// A person's decision about an interrupted write. Another pack than its own is named by its SerialNumber().
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Write the old values.
    Undo(Option<u16>),
    /// Write the new values.
    Finish(Option<u16>),
    /// Leave the gauge as it is, and put the journal aside.
    Discard,
}

impl Decision {
    fn pack(self) -> Option<u16> {
        match self {
            Self::Undo(pack) | Self::Finish(pack) => pack,
            Self::Discard => None,
        }
    }
}

fn owed(subject: &str, what: String, decision: bool) -> Error {
    Error::of(subject, Reason::Owed { decision, what })
}

/// Waits a little for a journal that another gaugefs judges, unless its turn has taken too long.
fn waits_for_turn(gauge: &Gauge, begun: Duration) -> bool {
    let is_in_time = gauge.clock.now() < begun + TURN;
    if is_in_time {
        gauge.wait(Duration::from_millis(100));
    }
    is_in_time
}

fn open_in_turn(journal: &Journal, file: &Path, gauge: &Gauge) -> Result<Option<OpenJournal>> {
    let begun = gauge.clock.now();
    loop {
        let opened = journal.open(file);
        let is_in_use = |error: &Error| matches!(error.reason(), Reason::InUse { .. });
        if !opened.as_ref().is_err_and(is_in_use) || !waits_for_turn(gauge, begun) {
            return opened;
        }
    }
}

impl DataFlash {
    /// What is owed to the gauge, if anything is.
    pub fn owed(&self) -> Option<Owed<'_>> {
        self.debts.owed()
    }

    /// Shows what is known of an interrupted write, for a person who has to decide. Nothing is written.
    pub fn examine(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<String> {
        decide::examine(self, gauge, waited)
    }

    /// Settles an interrupted write as a person has decided. Returns a message for the log.
    pub fn decide(&mut self, gauge: &mut Gauge, decision: Decision, waited: Duration) -> Result<String> {
        decide::decide(self, gauge, decision, waited)
    }

    pub(super) fn withdraw(&mut self, gauge: &mut Gauge, pending: Pending, waited: Duration) -> Result<()> {
        decide::withdraw(self, gauge, pending, waited)
    }

    pub(super) fn find_pending(&mut self) -> Option<Pending> {
        self.debts.find(&self.records, self.knowledge.arrival())
    }

    fn find_seal(&mut self) -> Option<&OwedSeal> {
        self.debts.find_seal(&self.records)
    }

    fn forget_seal(&mut self) {
        self.debts.forget_seal(&self.records);
    }

    /// Seals a gauge to which that is owed. Returns a message for the log; `None` if none is owed.
    fn pay_seal(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let Some(OwedSeal { entry, .. }) = self.find_seal().cloned() else { return Ok(None) };
        let sealed = self.access(gauge, waited, |_, gauge, asked| {
            gauge.claim()?;
            gauge.confirm_identity()?;
            let part = |entry: &Entry| entry.identity.chip == gauge.chip.name;
            if !entry.as_ref().is_none_or(part) {
                let why =
                    "the gauge that was left open was another part; discard what is owed with gaugefs settle";
                return Err(Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Seal));
            }
            gauge.wait(gauge.chip.security.shows);
            let mut session = Session::new(Seal::Sealed, asked);
            session.pack.pack = entry.as_ref().map(Reference::of);
            session.seal(gauge)
        });
        match sealed {
            Ok(()) => {
                self.forget_seal();
                Ok(Some("a gauge that had been left open is sealed again".into()))
            }
            Err(error) => {
                let error = error.within("cannot seal a gauge that was found sealed");
                self.debts.note_unsealed(error.to_string());
                Err(error)
            }
        }
    }

    pub(super) fn seal_was_chosen(&mut self, goal: Seal) {
        if self.find_seal().is_some() {
            log::info!("the gauge is {} as somebody has asked for: no seal is owed any more", goal.as_str());
            self.forget_seal();
        }
    }

    /// Adopts what is left of a change of keys, for somebody who makes it once more.
    pub(super) fn adopt(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        self.knowledge.forget_name();
        self.knowledge.identity(gauge)?;
        session.decided = true;
        session.entry = self.debts.pending().and_then(|pending| pending.entry.clone());
        session.pack.pack = session.entry.as_ref().map(Reference::of);
        if session.entry.as_ref().is_some_and(|entry| entry.found == Seal::Sealed) {
            session.found = Seal::Sealed;
        }
        let file = self.debts.pending().and_then(|pending| pending.file.clone());
        session.journal = match (self.debts.take_held(), self.records.journal().zip(file)) {
            (Some(held), _) => Some(held),
            (None, Some((journal, file))) => journal.open(&file)?,
            (None, None) => None,
        };
        Ok(())
    }

    /// Pays what is owed: data flash then holds all old values or all new ones, and the gauge is sealed at least as before.
    /// Also looks for what was begun elsewhere. Returns a message; `None` if there was nothing to settle.
    pub fn settle(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let begun = gauge.clock.now();
        let owes_seal = self.find_seal().is_some();
        let settled = match self.find_pending() {
            // Only the seal is tried again by itself.
            Some(Pending { why, undecided: true, .. }) if owes_seal => Err(owed("", why, true)),
            _ => self.settle_writes(gauge, waited),
        };
        let sealed = self.pay_seal(gauge, waited + (gauge.clock.now() - begun));
        match (settled, sealed) {
            (Ok(Some(settled)), Ok(Some(sealed))) => Ok(Some(format!("{settled}; {sealed}"))),
            (Ok(one), Ok(other)) => Ok(one.or(other)),
            (Ok(settled), Err(error)) => {
                settled.iter().for_each(|settled| log::warn!("{}: {settled}", gauge.chip.name));
                Err(error)
            }
            (Err(error), sealed) => {
                sealed.iter().flatten().for_each(|sealed| log::warn!("{}: {sealed}", gauge.chip.name));
                Err(error)
            }
        }
    }

    fn settle_writes(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let begun = gauge.clock.now();
        let mut told = self.settle_here(gauge, waited)?;
        let waited = waited + (gauge.clock.now() - begun);
        match search(self, gauge, Where::Places, waited) {
            Ok(found) => told.extend(found),
            Err(_) if self.debts.pending().is_some() => {}
            // A write looks again.
            Err(error) => log::warn!("{}: {error}", gauge.chip.name),
        }
        if self.debts.pending().is_some_and(|pending| pending.undecided) {
            told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
            let why = self.debts.pending().map_or(String::new(), |pending| pending.why.clone());
            return Err(owed("", why, true));
        }
        Ok((!told.is_empty()).then(|| told.join("; ")))
    }

    fn settle_here(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Vec<String>> {
        let (begun, mut told, mut last) = (gauge.clock.now(), Vec::new(), None);
        while let Some(pending) = self.find_pending() {
            // One that could not be removed is settled again before the next write.
            if last.is_some() && pending.file == last {
                self.debts.settled();
                break;
            }
            let waited = waited + (gauge.clock.now() - begun);
            let settled = self.resolve(gauge, &pending, None, waited);
            told.extend(settled.inspect_err(|_| {
                told.iter().for_each(|told: &String| log::warn!("{}: {told}", gauge.chip.name));
            })?);
            last = pending.file;
        }
        Ok(told)
    }

    fn resolve(
        &mut self,
        gauge: &mut Gauge,
        pending: &Pending,
        decision: Option<Decision>,
        waited: Duration,
    ) -> Result<Option<String>> {
        let verdict = match &pending.entry {
            Some(_) => {
                let patience = gauge.chip.security.key_silence + Duration::from_secs(3);
                let watched = pending.watched && gauge.longest_silence() <= patience;
                let certain = pending.certain.filter(|(_, left)| gauge.clock.now() < *left + SOON);
                let pending = Pending { watched, certain, ..pending.clone() };
                self.access(gauge, waited, |this, gauge, asked| this.act(gauge, &pending, decision, asked))
            }
            None if pending.undecided => Ok(Verdict::Undecided(pending.why.clone())),
            None => Err(owed("", pending.why.clone(), false)),
        };
        self.knowledge.forget_name();
        let reads_wrong = verdict.as_ref().is_err_and(|error| {
            matches!(error.cause(), Cause::StateUnknown) && error.step() == Some(Step::Restore)
        });
        let tries = pending.tries + u32::from(reads_wrong);
        let what = pending.entry.as_ref().map_or("a write".into(), Entry::subject);
        let (error, undecided) = match verdict {
            Ok(Verdict::Done(message) | Verdict::Plausible(message)) => {
                self.debts.settled();
                self.knowledge.note_settled();
                return Ok(Some(message));
            }
            Ok(Verdict::Another) => {
                self.debts.settled();
                return Ok(None);
            }
            Ok(Verdict::Undecided(why)) => {
                self.debts.hold(None);
                let file = pending.file.as_ref().filter(|_| pending.elsewhere);
                let file = file.map_or(String::new(), |file| format!(" (journal {})", file.display()));
                let why = format!(
                    "{what} was interrupted and is not settled: {why}{file}; nothing was touched and nothing is \
                     written to this gauge until you decide: gaugefs settle GAUGE shows what to type"
                );
                (owed(gauge.chip.name, why, true), true)
            }
            Err(error) if pending.elsewhere => {
                self.debts.settled();
                self.debts.hold(None);
                let file = pending.file.as_ref().map_or(String::new(), |file| file.display().to_string());
                let what =
                    format!("cannot tell whether the interrupted write of {file} was begun on this gauge");
                return Err(error.within(&what));
            }
            Err(error) if reads_wrong && tries >= TRIES => {
                let why = format!(
                    "{what} was interrupted and is not settled: {error}; that was tried {tries} times, and nothing \
                     more is written to this gauge until you decide: gaugefs settle GAUGE shows what to type"
                );
                (owed(gauge.chip.name, why, true), true)
            }
            Err(error) => {
                let next = pending.entry.as_ref().map(interrupted);
                (error.within(next.as_deref().unwrap_or("cannot settle an interrupted write")), false)
            }
        };
        let why = error.to_string();
        self.debts.wait(Pending { why, undecided, tries, ..pending.clone() });
        Err(error)
    }

    fn act(
        &mut self,
        gauge: &mut Gauge,
        pending: &Pending,
        decision: Option<Decision>,
        asked: Duration,
    ) -> Result<Verdict> {
        let Some(entry) = &pending.entry else { return Ok(Verdict::Another) };
        let elsewhere = pending.elsewhere && decision.is_none();
        gauge.claim()?;
        gauge.confirm_identity()?;
        self.knowledge.forget_name();
        let identity = self.knowledge.identity(gauge)?;
        if !entry.identity.is_of_part(&identity, gauge.chip) {
            let Identity { chip, firmware, .. } = &entry.identity;
            let why = format!("it was begun on another part, a {chip} with firmware 0x{firmware:04x}");
            return Ok(if elsewhere { Verdict::Another } else { Verdict::Undecided(why) });
        }
        let now = gauge.seal_anew()?;
        if elsewhere && !may_be_of(gauge.chip, entry, &identity) {
            return Ok(Verdict::Another);
        }
        let mut session = Session::new(now, asked);
        (session.now, session.decided) = (None, decision.is_some());
        session.entry = Some(entry.clone());
        session.pack.pack = Some(Reference::of(entry));
        session.journal = match self.debts.take_held() {
            Some(held) => Some(held),
            None => match self.records.journal().zip(pending.file.as_ref()) {
                Some((journal, file)) => match open_in_turn(journal, file, gauge)? {
                    Some(opened) => Some(opened),
                    // It has been settled elsewhere.
                    None => return Ok(Verdict::Another),
                },
                None => None,
            },
        };
        // The entry may be another gauge's; that this one was found sealed is owed for itself.
        let own = match elsewhere && now == Seal::Sealed {
            true => Some(self.record_seal(gauge, identity.clone())?),
            false => None,
        };
        let undecided = OnceCell::new();
        let run = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
            if !elsewhere {
                this.take_over(gauge, entry, session)?;
            }
            let outcome = this.judge(gauge, session, (entry, pending), decision, (&identity, now));
            if let Ok(Verdict::Undecided(why)) = &outcome {
                undecided.get_or_init(|| why.clone());
            }
            if elsewhere && !matches!(outcome, Ok(Verdict::Another | Verdict::Undecided(_))) {
                let taken = this.take_over(gauge, entry, session);
                return outcome.and_then(|verdict| taken.map(|()| verdict));
            }
            outcome
        };
        self.guard(gauge, session, run, |this, mut session, _, outcome, left| {
            this.knowledge.left_calibration(session.calibrating.is_some());
            if let Some((entry, record)) = own {
                this.debts.seal_ends(entry, record, left.as_ref());
            }
            let mut held = || session.journal.take().filter(|_| pending.watched);
            if let Some(left_open) = session.pack.left_open.take() {
                this.debts.hold(held());
                return Ok(Verdict::Undecided(undecided.get().cloned().unwrap_or(left_open)));
            }
            match (&outcome, left) {
                (Ok(Verdict::Done(_)), None) => session.remove_journal(),
                (Ok(Verdict::Plausible(message)), None) => {
                    let opened = session.journal.take();
                    let Some((journal, opened)) = this.records.journal().zip(opened.as_ref()) else {
                        return outcome;
                    };
                    let kept = journal.wait(opened.path())?;
                    let message = format!("{message}; its journal waits for its pack as {}", kept.display());
                    this.debts.note_judged(this.knowledge.arrival(), [kept]);
                    return Ok(Verdict::Plausible(message));
                }
                _ => this.debts.hold(held()),
            }
            outcome
        })
    }

    /// What has become of an interrupted access, as far as the gauge shows; what can be settled is.
    fn judge(
        &mut self,
        gauge: &mut Gauge,
        session: &mut Session,
        (entry, pending): (&Entry, &Pending),
        decision: Option<Decision>,
        (identity, now): (&Identity, Seal),
    ) -> Result<Verdict> {
        let elsewhere = pending.elsewhere && decision.is_none();
        let nothing = || Ok(Verdict::Done("an access was interrupted before anything was written".into()));
        match &entry.plan {
            _ if entry.owes_seal() => {
                if decision.is_none() && session.is_plainly_another(gauge, now)? {
                    let why = "another pack was left open, and is not here";
                    return Ok(if elsewhere { Verdict::Another } else { Verdict::Undecided(why.into()) });
                }
                nothing()
            }
            None => nothing(),
            Some(plan) if plan.key.is_some() => {
                let identities = [&entry.identity, identity];
                match elsewhere && !is_certainly(gauge, identities, plan, session) {
                    true => Ok(Verdict::Another),
                    false => self.unfinished.settle(gauge, plan, identities, pending.watched, session),
                }
            }
            Some(plan) => {
                session.pack.was_opened = now == Seal::Sealed;
                let open = if now == Seal::Sealed { self.unseal(gauge, plan) } else { Ok(()) };
                gauge.learn_selection();
                open?;
                sequence(gauge).enable(gauge)?;
                if has_lost_memory(gauge)? {
                    if elsewhere {
                        return Ok(Verdict::Another);
                    }
                    // It may be on its way into CONFIG UPDATE, which its flags show up to a second later.
                    self.knowledge.note_mode_left_on();
                    let why = format!(
                        "{} was interrupted, and the gauge has since lost power and with it its data memory",
                        entry.subject()
                    );
                    return Ok(Verdict::Done(why));
                }
                let then = &entry.identity;
                let (watched, certain) = (pending.watched, pending.certain.map(|(moment, _)| moment));
                let shown = self.debts.shown_of(entry);
                let subject = entry.subject();
                let task =
                    Task { plan, subject, then, now: identity, watched, certain, decision, shown, elsewhere };
                task.run(gauge, session)
            }
        }
    }

    /// The gauge is the one of an entry: the session leaves it as the entry demands.
    fn take_over(&self, gauge: &mut Gauge, entry: &Entry, session: &mut Session) -> Result<()> {
        // A gauge that was unsealed and has been sealed since stays sealed.
        if entry.found == Seal::Sealed {
            session.found = Seal::Sealed;
        }
        let may_calibrate = entry.plan.as_ref().is_some_and(|plan| !plan.blocks.is_empty());
        if self.knowledge.may_calibrate() || may_calibrate {
            session.inherit_modes(gauge)?;
        }
        Ok(())
    }

    /// Unseals the gauge, also if its keys were erased with a row of the plan.
    fn unseal(&mut self, gauge: &mut Gauge, plan: &Plan) -> Result<()> {
        let refused = match gauge.unseal() {
            Err(error) if matches!(error.cause(), Cause::NotPermitted | Cause::NotNow) => error,
            done => return done,
        };
        // No journal has the keys. Each wrong one locks the gauge for a while, so it is tried once.
        if !self.knowledge.refuses_erased_key()
            && plan.blocks.iter().any(|block| holds_keys(gauge.chip, block.place()))
        {
            if gauge.takes(&ERASED_KEY.into(), Seal::Unsealed)? {
                return Ok(());
            }
            self.knowledge.note_refused_erased_key();
        }
        Err(refused)
    }

    /// Settles an interrupted write before a new one and logs it. Returns the time since the new one was requested.
    pub(super) fn settle_first(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Duration> {
        self.pay_first(gauge, waited).map_err(|error| error.owing(self.owed().is_some()))
    }

    fn pay_first(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Duration> {
        let begun = gauge.clock.now();
        if let Some(Pending { why, undecided: true, .. }) = self.find_pending() {
            return Err(owed("", why, true));
        }
        let told = self.settle_here(gauge, waited)?;
        told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
        for place in [Where::Places, Where::Waiting] {
            let told = search(self, gauge, place, waited + (gauge.clock.now() - begun))?;
            told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
        }
        if let Some(told) = self.pay_seal(gauge, waited + (gauge.clock.now() - begun))? {
            log::warn!("{}: {told}", gauge.chip.name);
        }
        Ok(waited + (gauge.clock.now() - begun))
    }
}

/// Whether it is certainly the gauge of a key change from another place. Only keys that this host has are sent.
fn is_certainly(gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan, session: &mut Session) -> bool {
    let same = session.open(gauge).and_then(|()| {
        compare(gauge.chip, then, now, plan, |place| sequence(gauge).load(gauge, place, Care::Sure))
    });
    same == Ok(Match::Certain)
}
