// SPDX-License-Identifier: MIT

//! What is left to do on a gauge, where it is on record, and which journals were compared with it. Nothing is sent here.

use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Duration;

use super::Change;
use super::knowledge::Arrival;
use super::pack;
use super::planned::Seen;
use super::records::Records;
use super::session::Left;
use crate::codec::WINDOW;
use crate::epoch::{Epoch, Fact};
use crate::gauge::{Gauge, Moment};
use crate::journal::{Content, Entry, Found, Identity, OpenJournal, Plan};
use crate::keys::Name;

#[derive(Debug, Default)]
pub(super) struct Debts {
    /// A write that is neither done nor undone, or a seal that is owed.
    pending: Option<Pending>,
    shown: Option<Shown>,
    /// Its journal, locked while this process may go on with it.
    held: Option<OpenJournal>,
    owed_seal: Option<OwedSeal>,
    /// How far the journals of other gauges have been compared with this one, and those that are not of it.
    searched: Fact<Searched, Arrival>,
    judged: Fact<Vec<PathBuf>, Arrival>,
}

#[derive(Clone, Debug)]
pub(super) struct Pending {
    /// `None` if the journal cannot be read, or another process works on it.
    pub(super) entry: Option<Entry>,
    pub(super) file: Option<PathBuf>,
    /// Its journal is of another place, or waits for its pack: this gauge is not the first one to think of.
    pub(super) elsewhere: bool,
    pub(super) why: String,
    /// This process has begun it: while the gauge has not been silent for long, nobody else has written to its pack.
    pub(super) watched: bool,
    /// When it was certain that the gauge is the one, and when its session ended.
    pub(super) certain: Option<(Moment, Duration)>,
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
    /// The keys whose change is neither done nor undone: settling it takes both keys, as in the change.
    pub keys: &'a [Name],
}

#[derive(Clone, Debug)]
pub(super) struct OwedSeal {
    /// The gauge that was opened; `None` if the record cannot be read.
    pub(super) entry: Option<Entry>,
    pub(super) why: String,
}

/// What a person was shown of an interrupted write, by which a decision is meant.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    pub(super) entry: Entry,
    pub(super) identity: Identity,
    pub(super) blocks: Vec<[u8; WINDOW]>,
}

impl Shown {
    pub(super) fn is(&self, identity: &Identity, seen: &[Seen]) -> bool {
        let same = |(shown, seen): (&[u8; WINDOW], &Seen)| {
            (0..WINDOW).all(|at| shown[at] == seen.stored[at] || seen.block.learned.has(at))
        };
        self.identity == *identity && self.blocks.iter().zip(seen).all(same)
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Searched {
    places: bool,
    waiting: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Where {
    Places,
    Waiting,
}

impl Debts {
    pub(super) fn pending(&self) -> Option<&Pending> {
        self.pending.as_ref()
    }

    pub(super) fn wait(&mut self, pending: Pending) {
        self.pending = Some(pending);
    }

    pub(super) fn settled(&mut self) {
        self.pending = None;
    }

    pub(super) fn hold(&mut self, journal: Option<OpenJournal>) {
        self.held = journal;
    }

    pub(super) fn take_held(&mut self) -> Option<OpenJournal> {
        self.held.take()
    }

    pub(super) fn show(&mut self, shown: Shown) {
        self.shown = Some(shown);
    }

    pub(super) fn shown_of(&self, entry: &Entry) -> Option<&Shown> {
        self.shown.as_ref().filter(|shown| shown.entry == *entry)
    }

    pub(super) fn is_searched(&self, arrival: Epoch<Arrival>, place: Where) -> bool {
        self.searched.get(arrival).is_some_and(|searched| match place {
            Where::Places => searched.places,
            Where::Waiting => searched.waiting,
        })
    }

    pub(super) fn note_searched(&mut self, arrival: Epoch<Arrival>, place: Where) {
        let searched = self.searched.in_epoch(arrival);
        match place {
            Where::Places => searched.places = true,
            Where::Waiting => searched.waiting = true,
        }
    }

    pub(super) fn note_judged(&mut self, arrival: Epoch<Arrival>, files: impl IntoIterator<Item = PathBuf>) {
        self.judged.in_epoch(arrival).extend(files);
    }

    pub(super) fn note_unsealed(&mut self, why: String) {
        if let Some(owed) = &mut self.owed_seal {
            owed.why = why;
        }
    }

    pub(super) fn owed(&self) -> Option<Owed<'_>> {
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

    pub(super) fn keep(
        &mut self,
        records: &Records,
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
            let replaced = records.journal().zip(self.held.as_ref());
            let replaced = replaced.map(|(journal, held)| {
                journal.replace(held.path(), &entry.identity, entry.found, Some(&owed))
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

    pub(super) fn leave_to_person(&mut self) {
        if let Some(pending) = &mut self.pending {
            pending.undecided = true;
        }
    }

    pub(super) fn look_again(&mut self) {
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

    pub(super) fn known_files(&self, arrival: Epoch<Arrival>) -> Vec<PathBuf> {
        let held = self.held.iter().map(|held| held.path().to_path_buf());
        held.chain(self.judged.get(arrival).into_iter().flatten().cloned()).collect()
    }

    fn is_over(&self, records: &Records, pending: &Pending) -> bool {
        let Some((journal, file)) = records.journal().zip(pending.file.as_ref()) else {
            return pending.entry.is_none();
        };
        self.held.is_none() && (pending.entry.is_none() || journal.look(file).is_none())
    }

    pub(super) fn find(&mut self, records: &Records, arrival: Epoch<Arrival>) -> Option<Pending> {
        if self.pending.as_ref().is_some_and(|pending| self.is_over(records, pending)) {
            self.pending = None;
        }
        if self.pending.is_none()
            && let Some(journal) = records.journal()
        {
            self.pending = match journal.search(false, &self.known_files(arrival)) {
                Ok(found) => found.into_iter().find(|found| found.is_here).map(Pending::found),
                Err(error) => Some(Pending { undecided: true, ..Pending::of(None, error.to_string()) }),
            };
        }
        self.pending.clone()
    }

    /// The session that has left what is pending is going on: nobody has exchanged the gauge if it has answered since.
    pub(super) fn still_certain(&mut self, gauge: &Gauge) {
        if let Some((_, left)) = self.pending.as_mut().and_then(|pending| pending.certain.as_mut()) {
            *left = gauge.clock.now();
        }
    }

    /// What is `left` of a session with a record of its own for the seal.
    pub(super) fn seal_ends(&mut self, entry: Entry, record: Option<OpenJournal>, left: Option<&Left>) {
        match left {
            Some(left) => self.keep_seal(entry, left.why.clone()),
            None => {
                if let Some(Err(error)) = record.map(OpenJournal::remove) {
                    log::warn!("{error}");
                }
            }
        }
    }

    fn keep_seal(&mut self, entry: Entry, why: String) {
        self.owed_seal = Some(OwedSeal { entry: Some(entry), why });
    }

    pub(super) fn find_seal(&mut self, records: &Records) -> Option<&OwedSeal> {
        if self.owed_seal.is_none()
            && let Some(journal) = records.journal()
        {
            let why = || "a gauge that was found sealed may have been left open".to_string();
            self.owed_seal = match journal.seal_owed() {
                Ok(None) => None,
                Ok(Some(entry)) => Some(OwedSeal { entry: Some(entry), why: why() }),
                // Whatever gauge it was of, this one was not to be left open.
                Err(error) => Some(OwedSeal { entry: None, why: format!("{}: {error}", why()) }),
            };
        }
        self.owed_seal.as_ref()
    }

    pub(super) fn forget_seal(&mut self, records: &Records) {
        self.owed_seal = None;
        if let Some(Err(error)) = records.journal().map(|journal| journal.seal_paid()) {
            log::warn!("{error}");
        }
    }
}

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

    /// Whether these changes write all that a person would have to decide about, so that no decision is needed.
    pub(super) fn is_written_again(&self, changes: &[Change]) -> bool {
        self.undecided && self.plan().is_some_and(|plan| plan.is_covered(changes))
    }

    pub(super) fn plan(&self) -> Option<Plan> {
        self.entry.as_ref()?.plan.clone()
    }
}
