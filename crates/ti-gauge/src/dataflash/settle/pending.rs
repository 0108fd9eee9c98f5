// SPDX-License-Identifier: MIT

//! What is owed to the gauge: an interrupted write that is not settled yet, and where it is on record.

use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Duration;

use crate::dataflash::owedseal::OwedSeal;
use crate::dataflash::pack;
use crate::dataflash::session::{Left, Reference, Session};
use crate::dataflash::{Change, DataFlash};
use crate::error::Result;
use crate::gauge::{Gauge, Moment, Seal};
use crate::journal::{Content, Entry, Found, OpenJournal, Plan};
use crate::keys::Name;

/// What is still to be settled.
#[derive(Clone, Debug)]
pub(in crate::dataflash) struct Pending {
    /// `None` if the journal cannot be read, or another process works on it.
    pub(super) entry: Option<Entry>,
    /// Its journal; `None` if there is none.
    pub(super) file: Option<PathBuf>,
    /// Its journal is of another place, or waits for its pack: this gauge is not the first one to think of.
    pub(super) elsewhere: bool,
    pub(super) why: String,
    /// This process has begun it: while the gauge has not been silent for long, nobody else has written to its pack.
    pub(super) watched: bool,
    /// When it was certain that the gauge is the one, and when its session ended.
    pub(super) certain: Option<(Moment, Duration)>,
    /// Only a person can decide.
    pub(super) undecided: bool,
    /// How often what was put back did not read back right, since the gauge has arrived.
    pub(super) tries: u32,
}

/// What is owed to a gauge, for everybody else.
#[derive(Clone, Debug)]
pub struct Owed<'a> {
    /// What happened and what to do, one line.
    pub why: Cow<'a, str>,
    /// Trying again does not help with any of it: a person has to decide.
    pub needs_decision: bool,
    /// A write is neither done nor undone; otherwise only the seal is owed.
    pub data: bool,
    /// The keys of which a change is neither done nor undone: it takes both keys, as in the change.
    pub keys: &'a [Name],
}

impl DataFlash {
    /// What is owed to the gauge, if anything is.
    pub fn owed(&self) -> Option<Owed<'_>> {
        let (pending, seal) = (self.pending.as_ref(), self.owed_seal.as_ref());
        let data =
            pending.is_some_and(|pending| pending.entry.as_ref().is_none_or(|entry| !entry.owes_seal()));
        let why = match (pending, seal) {
            (Some(pending), Some(seal)) => format!("{}; {}", pending.why, seal.why).into(),
            (Some(Pending { why, .. }), None) | (None, Some(OwedSeal { why, .. })) => why.as_str().into(),
            (None, None) => return None,
        };
        let needs_decision = seal.is_none() && pending.is_some_and(|pending| pending.undecided);
        let keys = pending.and_then(|pending| pending.entry.as_ref()?.plan.as_ref()?.key.as_ref());
        let keys = keys.filter(|key| !key.is_over()).map_or(&[][..], |key| &key.names);
        Some(Owed { why, needs_decision, data, keys })
    }

    /// Keeps what a session has left to be settled.
    pub(in crate::dataflash) fn keep(
        &mut self,
        gauge: &Gauge,
        entry: Option<Entry>,
        opened: Option<OpenJournal>,
        left: Left,
    ) {
        let Some(mut entry) = entry else { return };
        if self.pending.is_some() {
            // A read while a write waited to be settled: its record is there already.
            return self.keep_seal(entry, left.why);
        }
        self.held = opened;
        if !left.data
            && let Some(plan) = entry.plan.take_if(|plan| plan.key.is_some() || !plan.blocks.is_empty())
        {
            let has_key = plan.key.is_none();
            let marks = if has_key { pack::marks_after(&plan, left.is_new) } else { Vec::new() };
            // Data flash has been read back: only the seal is owed.
            if let Some(serial) = pack::serial(gauge.chip, &plan, left.is_new) {
                entry.identity.serial = serial;
            }
            // One whose key has changed is not opened to compare its marks.
            let owed = Plan { reset: !has_key, ..Plan::of_marks(marks) };
            let replaced = self.records.journal().zip(self.held.as_ref());
            let replaced = replaced.map(|(journal, held)| -> Result<OpenJournal> {
                let mut replaced = journal.replace(held.path(), &entry.identity, entry.found)?;
                replaced.plan(&owed)?;
                Ok(replaced)
            });
            entry.plan = Some(owed);
            match replaced {
                Some(Ok(replaced)) => self.held = Some(replaced),
                Some(Err(error)) => log::warn!("{error}"),
                None => {}
            }
        }
        let file = self.held.as_ref().map(|held| held.path().to_path_buf());
        let why = if left.data { format!("{}: {}", interrupted(&entry), left.why) } else { left.why };
        let certain = left.certain.map(|moment| (moment, gauge.clock.now()));
        let pending = Pending { file, watched: true, certain, ..Pending::of(Some(entry), why) };
        self.pending = Some(pending);
    }

    /// Adopts what is left of a change of keys, for somebody who makes it once more.
    pub(in crate::dataflash) fn adopt(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        self.knowledge.forget_name();
        self.knowledge.identity(gauge)?;
        session.decided = true;
        session.entry = self.pending.as_ref().and_then(|pending| pending.entry.clone());
        session.pack.pack = session.entry.as_ref().map(Reference::of);
        if session.entry.as_ref().is_some_and(|entry| entry.found == Seal::Sealed) {
            session.found = Seal::Sealed;
        }
        let file = self.pending.as_ref().and_then(|pending| pending.file.clone());
        session.journal = match (self.held.take(), self.records.journal().zip(file)) {
            (Some(held), _) => Some(held),
            (None, Some((journal, file))) => journal.open(&file)?,
            (None, None) => None,
        };
        Ok(())
    }

    /// Trying again does not help with what is owed.
    pub(in crate::dataflash) fn leave_to_person(&mut self) {
        if let Some(pending) = &mut self.pending {
            pending.undecided = true;
        }
    }

    /// Another gauge may be there now.
    pub(in crate::dataflash) fn look_again(&mut self) {
        // The pack may come back elsewhere, where its journal must not be taken for one in use.
        self.held = None;
        match &mut self.pending {
            Some(pending) if pending.elsewhere => self.pending = None,
            Some(pending) => {
                (pending.watched, pending.certain, pending.undecided, pending.tries) = (false, None, false, 0)
            }
            None => {}
        }
    }

    /// The files that need not be looked at: what they say of this gauge is known.
    pub(super) fn known_files(&self) -> Vec<PathBuf> {
        let held = self.held.iter().map(|held| held.path().to_path_buf());
        held.chain(self.judged.get(self.knowledge.arrival()).into_iter().flatten().cloned()).collect()
    }

    /// Whether what is pending has been settled at another place, or its journal was moved away.
    fn is_over(&self, pending: &Pending) -> bool {
        let Some((journal, file)) = self.records.journal().zip(pending.file.as_ref()) else {
            return pending.entry.is_none();
        };
        self.held.is_none() && (pending.entry.is_none() || journal.look(file).is_none())
    }

    /// Finds what an earlier process has left at this place.
    pub(in crate::dataflash) fn find_pending(&mut self) -> Option<Pending> {
        if self.pending.as_ref().is_some_and(|pending| self.is_over(pending)) {
            self.pending = None;
        }
        if self.pending.is_none()
            && let Some(journal) = self.records.journal()
        {
            self.pending = match journal.search(false, &self.known_files()) {
                Ok(found) => found.into_iter().find(|found| found.is_here).map(Pending::found),
                Err(error) => Some(Pending { undecided: true, ..Pending::of(None, error.to_string()) }),
            };
        }
        self.pending.clone()
    }

    /// The session that has left what is pending is going on: nobody has exchanged the gauge if it has answered since.
    pub(in crate::dataflash) fn still_certain(&mut self, gauge: &Gauge) {
        if let Some((_, left)) = self.pending.as_mut().and_then(|pending| pending.certain.as_mut()) {
            *left = gauge.clock.now();
        }
    }
}

/// What happened to a gauge, and what happens next.
pub(super) fn interrupted(entry: &Entry) -> String {
    let next = if entry.owes_seal() { "the gauge is sealed" } else { "it is finished or undone" };
    format!("{} was interrupted, and {next} as soon as that is possible", entry.subject())
}

impl Pending {
    pub(super) fn of(entry: Option<Entry>, why: String) -> Self {
        Self {
            entry,
            file: None,
            elsewhere: false,
            why,
            watched: false,
            certain: None,
            undecided: false,
            tries: 0,
        }
    }

    /// What an earlier process has left.
    pub(super) fn found(found: Found) -> Self {
        let file = Some(found.path);
        match found.content {
            Content::Entry(entry) => {
                let why = interrupted(&entry);
                Self { file, ..Self::of(Some(entry), why) }
            }
            Content::InUse(why) => Self { file, ..Self::of(None, why) },
            Content::Unreadable(error) => Self { file, undecided: true, ..Self::of(None, error.to_string()) },
        }
    }

    /// Whether a person has to decide about a write of which these changes write all, so that nothing is lost without one.
    pub(in crate::dataflash) fn is_written_again(&self, changes: &[Change]) -> bool {
        self.undecided && self.plan().is_some_and(|plan| plan.is_covered(changes))
    }

    /// What was about to be written.
    pub(in crate::dataflash) fn plan(&self) -> Option<Plan> {
        self.entry.as_ref()?.plan.clone()
    }
}
