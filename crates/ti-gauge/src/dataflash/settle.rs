// SPDX-License-Identifier: MIT

//! Settles interrupted writes: those cut short by a power loss of the host, or by a gauge that did not answer in
//! time. The entry, which is also in the journal, holds the seal state and the blocks from before the write, and
//! what distinguishes the pack.
//!
//! A wrong belief does more harm here than the fault: 32 bytes of one pack's configuration in another pack. So
//! nothing is written unless the pack is certainly the one, and every byte of its blocks is old, new, erased or
//! rewritten by the gauge itself. Anything else is left as it is for a person to decide.

use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use super::io::COMMITTED;
use super::job::{Job, Landed, Side, converge};
use super::keychange::way_out;
use super::measured;
use super::owedseal::OwedSeal;
use super::pack::{self, Known, Match, compare, is_named, mark_windows, shows_another};
use super::planned::{Held, Seen, identify, look, look_by, serial_number};
use super::schemes::sequence;
use super::session::{Left, Reference, Session, in_time};
use super::state::has_lost_memory;
use super::verdict::{Verdict, unrestored};
use super::window::{Window, holds_keys, secrets};
use super::{Change, DataFlash, Place};
use crate::chip::{Chip, KeyStorage, Kind};
use crate::codec::{self, WINDOW};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Moment, Seal, agreed};
use crate::journal::{Content, Entry, Found, Identity, Mark, OpenJournal, Plan, PlannedBlock};
use crate::keys::Name;
use crate::notation;

/// The unseal key of a gauge whose row of keys has been erased.
const ERASED_KEY: [u16; 2] = [0xffff; 2];

/// What is still to be settled.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    /// `None` if the journal cannot be read, or another process works on it.
    entry: Option<Entry>,
    /// Its journal; `None` if there is none.
    file: Option<PathBuf>,
    /// Its journal is of another place, or waits for its pack: this gauge is not the first one to think of.
    elsewhere: bool,
    why: String,
    /// This process has begun it: while the gauge has not been silent for long, nobody else has written to its pack.
    watched: bool,
    /// When it was certain that the gauge is the one, and when its session ended.
    certain: Option<(Moment, Duration)>,
    /// Only a person can decide.
    undecided: bool,
    /// How often what was put back did not read back right, since the gauge has arrived.
    tries: u32,
}

/// How often a block that does not read back as it was stored is put back. Each time programs it three times.
const TRIES: u32 = 3;
/// So soon after a session that has left something nobody exchanges a gauge that has answered since.
const SOON: Duration = Duration::from_secs(1);

/// What of the folder of journals has been compared with this gauge since it arrived.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Searched {
    /// Those of other places.
    places: bool,
    /// Those that wait for their packs.
    waiting: bool,
}

/// Which journals of other gauges are compared with this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Where {
    Places,
    Waiting,
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

/// What a person may decide about an interrupted write. What is written to another pack than it was begun on takes that
/// pack's serial number, as SerialNumber() has it.
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
    /// The pack that it names.
    fn pack(self) -> Option<u16> {
        match self {
            Self::Undo(pack) | Self::Finish(pack) => pack,
            Self::Discard => None,
        }
    }
}

/// What a person was shown of an interrupted write, by which a decision is meant.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    entry: Entry,
    identity: Identity,
    blocks: Vec<[u8; WINDOW]>,
}

impl Shown {
    /// Whether a gauge is what was shown, but for what it has learned since.
    fn is(&self, identity: &Identity, seen: &[Seen]) -> bool {
        let same = |(shown, seen): (&[u8; WINDOW], &Seen)| {
            (0..WINDOW).all(|at| shown[at] == seen.stored[at] || seen.block.learned.has(at))
        };
        self.identity == *identity && self.blocks.iter().zip(seen).all(same)
    }
}

/// Why a person has to decide about an interrupted write.
enum Doubt {
    None,
    /// Nothing shows that this is another pack, and nothing that it is the one.
    Weak,
    /// The write was begun elsewhere, and nothing of it shows here.
    Another,
    /// Another pack answers.
    Exchanged(String),
    Because(String, Match),
}

/// Which gauge somebody has decided about.
enum Chosen {
    Itself,
    /// Another one, named for the message.
    Another(String),
    /// Not this one; the text says why.
    Not(String),
}

impl DataFlash {
    /// Identity of the gauge for the journal, read on first use after the gauge was connected.
    pub(super) fn identity(&mut self, gauge: &mut Gauge) -> Result<Identity> {
        if let Some(identity) = self.identity.get(self.now.name) {
            return Ok(identity.clone());
        }
        let firmware = match self.known_pack {
            Some(known_pack) => known_pack.firmware_version,
            None => agreed("Control(FW_VERSION)", || gauge.firmware_version())?,
        };
        let identity = Identity::of(gauge.chip, firmware, serial_number(gauge)?);
        self.identity.learn(self.now.name, identity.clone());
        Ok(identity)
    }

    /// Whether the gauge, which is open, is certainly the one whose values were read.
    pub(super) fn is_certain(&mut self, gauge: &mut Gauge) -> Result<bool> {
        let plan = Plan::of_marks(self.marks(gauge.chip));
        let Some(then) = self.identity.get(self.now.name).cloned() else { return Ok(false) };
        let now = identify(gauge)?;
        sequence(gauge).enable(gauge)?;
        let same = compare(gauge.chip, &then, &now, &plan, |place| sequence(gauge).load(gauge, place))?;
        Ok(then.is_of_part(&now, gauge.chip) && same == Match::Certain)
    }

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
    pub(super) fn keep(
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
            let replaced = self.journal.as_ref().zip(self.held.as_ref());
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
        let certain = left.certain.map(|moment| (moment, gauge.clock.now()));
        let pending = Pending { file, watched: true, certain, ..Pending::of(Some(entry), left.why) };
        self.pending = Some(pending);
    }

    /// Adopts what is left of a change of keys, for somebody who makes it once more.
    pub(super) fn adopt(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        self.now.may_be_renamed();
        self.identity(gauge)?;
        session.decided = true;
        session.entry = self.pending.as_ref().and_then(|pending| pending.entry.clone());
        session.pack.pack = session.entry.as_ref().map(Reference::of);
        if session.entry.as_ref().is_some_and(|entry| entry.found == Seal::Sealed) {
            session.found = Seal::Sealed;
        }
        let file = self.pending.as_ref().and_then(|pending| pending.file.clone());
        session.journal = match (self.held.take(), self.journal.as_ref().zip(file)) {
            (Some(held), _) => Some(held),
            (None, Some((journal, file))) => journal.open(&file)?,
            (None, None) => None,
        };
        Ok(())
    }

    /// Trying again does not help with what is owed.
    pub(super) fn leave_to_person(&mut self) {
        if let Some(pending) = &mut self.pending {
            pending.undecided = true;
        }
    }

    /// Another gauge may be there now.
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

    /// The files that need not be looked at: what they say of this gauge is known.
    fn known_files(&self) -> Vec<PathBuf> {
        let held = self.held.iter().map(|held| held.path().to_path_buf());
        held.chain(self.judged.get(self.now.arrival).into_iter().flatten().cloned()).collect()
    }

    /// Whether what is pending has been settled at another place, or its journal was moved away.
    fn is_over(&self, pending: &Pending) -> bool {
        let Some((journal, file)) = self.journal.as_ref().zip(pending.file.as_ref()) else {
            return pending.entry.is_none();
        };
        self.held.is_none() && (pending.entry.is_none() || journal.look(file).is_none())
    }

    /// Finds what an earlier process has left at this place.
    pub(super) fn find_pending(&mut self) -> Option<Pending> {
        if self.pending.as_ref().is_some_and(|pending| self.is_over(pending)) {
            self.pending = None;
        }
        if self.pending.is_none()
            && let Some(journal) = &self.journal
        {
            self.pending = match journal.search(false, &self.known_files()) {
                Ok(found) => found.into_iter().find(|found| found.is_here).map(Pending::found),
                Err(error) => Some(Pending { undecided: true, ..Pending::of(None, error.to_string()) }),
            };
        }
        self.pending.clone()
    }

    /// Pays what is owed: data flash then holds all old values or all new ones, and the gauge is sealed at least
    /// as it was before. Also looks for what was begun on this gauge at other places. Returns a message for the log;
    /// `None` if there was nothing to settle. After an error it is still owed.
    pub fn settle(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let begun = gauge.clock.now();
        let owes_seal = self.find_seal().is_some();
        let settled = match self.find_pending() {
            // Only the seal is tried again by itself.
            Some(Pending { why, undecided: true, .. }) if owes_seal => Err(Error::new("", Cause::Busy, why)),
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

    /// Settles the writes, here and at other places.
    fn settle_writes(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let begun = gauge.clock.now();
        let mut told = self.settle_here(gauge, waited)?;
        let waited = waited + (gauge.clock.now() - begun);
        match self.search(gauge, Where::Places, waited) {
            Ok(found) => told.extend(found),
            Err(_) if self.pending.is_some() => {}
            // A write looks again.
            Err(error) => log::warn!("{}: {error}", gauge.chip.name),
        }
        if self.pending.as_ref().is_some_and(|pending| pending.undecided) {
            told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
            let why = self.pending.as_ref().map_or(String::new(), |pending| pending.why.clone());
            return Err(Error::new("", Cause::Busy, why));
        }
        Ok((!told.is_empty()).then(|| told.join("; ")))
    }

    /// Settles what was begun at this place.
    fn settle_here(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Vec<String>> {
        let (begun, mut told, mut last) = (gauge.clock.now(), Vec::new(), None);
        while let Some(pending) = self.find_pending() {
            // One that could not be removed is settled again before the next write.
            if last.is_some() && pending.file == last {
                self.pending = None;
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

    /// Settles what was begun on this gauge at another place, or was set aside because it was not certain that the pack
    /// was the one.
    fn search(&mut self, gauge: &mut Gauge, place: Where, waited: Duration) -> Result<Vec<String>> {
        let (begun, mut told) = (gauge.clock.now(), Vec::new());
        let done = self.searched.get(self.now.arrival).is_some_and(|searched| match place {
            Where::Places => searched.places,
            Where::Waiting => searched.waiting,
        });
        let Some(journal) = self.journal.as_ref().filter(|_| !done && self.pending.is_none()) else {
            return Ok(told);
        };
        let mut found = journal.search(place == Where::Waiting, &self.known_files())?;
        found.retain(|found| !found.is_here);
        let others = self.rule_out(gauge, &found, waited)?;
        self.judged.in_epoch(self.now.arrival).extend(others.iter().cloned());
        found.retain(|found| !others.contains(&found.path));
        for found in found {
            let file = found.path.clone();
            let pending = Pending { elsewhere: true, ..Pending::found(found) };
            if pending.entry.is_none() {
                continue;
            }
            let waited = waited + (gauge.clock.now() - begun);
            let settled = self.resolve(gauge, &pending, None, waited);
            if self.pending.is_some() {
                return settled.map(|_| told);
            }
            told.extend(settled?);
            self.judged.in_epoch(self.now.arrival).push(file);
        }
        let searched = self.searched.in_epoch(self.now.arrival);
        match place {
            Where::Places => searched.places = true,
            Where::Waiting => searched.waiting = true,
        }
        Ok(told)
    }

    /// The journals that show nothing of this gauge. After a while a folder may have those of many packs, so what they
    /// have to be compared with is read once for all of them.
    fn rule_out(&mut self, gauge: &mut Gauge, found: &[Found], waited: Duration) -> Result<Vec<PathBuf>> {
        let entry = |found: &Found| match &found.content {
            Content::Entry(entry) => Some((found.path.clone(), entry.clone())),
            Content::InUse(_) | Content::Unreadable(_) => None,
        };
        let mut entries: Vec<(PathBuf, Entry)> = found.iter().filter_map(entry).collect();
        let has_blocks = |entry: &Entry| {
            entry.plan.as_ref().is_some_and(|plan| plan.key.is_none() && !plan.blocks.is_empty())
        };
        entries.retain(|(_, entry)| has_blocks(entry));
        if entries.len() < 2 {
            return Ok(Vec::new());
        }
        let ruled_out = in_time(gauge, waited, |gauge, asked| {
            gauge.claim()?;
            self.now.may_be_renamed();
            let now = self.identity(gauge)?;
            let (mut others, mut open) = (Vec::new(), Vec::new());
            for (path, entry) in entries {
                match entry.identity.is_of_part(&now, gauge.chip) && may_be_of(gauge.chip, &entry, &now) {
                    true => open.push((path, entry)),
                    false => others.push(path),
                }
            }
            if open.is_empty() {
                return Ok(others);
            }
            let found = gauge.seal_anew()?;
            let record = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
                if found == Seal::Sealed { this.owe(gauge, session, 0) } else { Ok(()) }
            };
            others.extend(self.session(gauge, (found, asked), record, |_, gauge, session| {
                session.open(gauge)?;
                others_of(gauge, &now, &open)
            })?);
            Ok(others)
        });
        match ruled_out {
            // Each of them is tried with what its plan knows of the keys.
            Err(error) if matches!(error.cause(), Cause::NotPermitted) => Ok(Vec::new()),
            ruled_out => ruled_out,
        }
    }

    /// Looks for a journal that waits for this pack, before data flash is read for the first time. What keeps it from
    /// that is no reason not to read: a write looks again.
    pub(super) fn search_waiting(&mut self, gauge: &mut Gauge, waited: Duration) {
        if self.find_pending().is_some() {
            return;
        }
        for place in [Where::Places, Where::Waiting] {
            match self.search(gauge, place, waited) {
                Ok(told) => told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name)),
                Err(error) => log::warn!("{}: {error}", gauge.chip.name),
            }
        }
    }

    /// Shows what is known of an interrupted write, for a person who has to decide. Nothing is written.
    pub fn examine(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<String> {
        let seal = self.find_seal().map_or(String::new(), |seal| format!("{}\n", seal.why));
        let Some(pending) = self.find_pending() else {
            return Ok(if seal.is_empty() { "nothing to settle\n".into() } else { seal });
        };
        let mut text = format!("{seal}{}\n", pending.why);
        let Some(entry) = pending.entry else { return Ok(text) };
        let Identity { chip, firmware, serial, .. } = &entry.identity;
        text += &format!(
            "begun on {chip}, firmware 0x{firmware:04x}, serial number 0x{serial:04x}, found {}\n",
            entry.found.as_str()
        );
        let plan = entry.plan.clone().filter(|_| !entry.owes_seal());
        let Some(plan) = plan else { return Ok(text + "nothing had been written\n") };
        if let Some(key) = &plan.key {
            // The keys that the gauge has were found out when it was tried to settle this.
            let names = key.names();
            let how = match key.is_over() {
                true => "was written and read back",
                false => "was about to be written",
            };
            return Ok(format!("{text}the {names} key {how}\n"));
        }
        in_time(gauge, waited, |gauge, asked| {
            self.now.may_be_renamed();
            let now = self.identity(gauge)?;
            let found = gauge.seal_anew()?;
            // The seal is owed already.
            let recorded = |_: &mut Self, _: &mut Gauge, _: &mut Session| Ok(());
            let (seen, same) = self.session(gauge, (found, asked), recorded, |_, gauge, session| {
                session.open(gauge)?;
                let seen = look(gauge, &plan)?;
                let same = compare_seen(gauge, [&entry.identity, &now], &plan, &seen)?;
                Ok((seen, same))
            })?;
            if let Match::Other(name) = same {
                text += &match number_of(gauge.chip, &now) {
                    Some(serial) => format!(
                        "{name} is not what it was then: this is another pack, serial number {serial}; to write to it all \
                         the same, add --serial {serial}\n"
                    ),
                    None => format!("{name} is not what it was then: this is another pack\n"),
                };
            }
            let blocks = seen.iter().map(|seen| seen.stored).collect();
            text += &table(gauge.chip, &seen);
            self.shown = Some(Shown { entry, identity: now, blocks });
            Ok(text)
        })
    }

    /// Settles an interrupted write as a person has decided. Returns a message for the log.
    pub fn decide(&mut self, gauge: &mut Gauge, decision: Decision, waited: Duration) -> Result<String> {
        let Some(pending) = self.find_pending() else {
            let sealed = self.pay_seal(gauge, waited);
            if decision == Decision::Discard {
                self.forget_seal();
            }
            let nothing = || Error::new(gauge.chip.name, Cause::Invalid, "there is nothing to settle");
            return sealed?.ok_or_else(nothing);
        };
        let key = pending.plan().and_then(|plan| plan.key).filter(|key| !key.is_over());
        let needs_keys = match decision {
            Decision::Finish(_) => true,
            Decision::Undo(_) => self.unfinished.is_none(),
            Decision::Discard => false,
        };
        if let Some(key) = key.filter(|_| needs_keys) {
            let why = format!("no journal has keys: {}", way_out(&key.names));
            return Err(Error::new(gauge.chip.name, Cause::NotPermitted, why));
        }
        if decision != Decision::Discard {
            let told = self.resolve(gauge, &pending, Some(decision), waited)?;
            return Ok(told.unwrap_or_else(|| "there is nothing to settle".into()));
        }
        let aside = match self.journal.as_ref().zip(pending.file.as_ref()) {
            Some((journal, file)) if journal.look(file).is_some() => Some(journal.dismiss(file)?),
            _ => None,
        };
        (self.pending, self.held, self.unfinished) = (None, None, None);
        let left = match pending.entry {
            Some(entry) => self.leave_as_it_is(gauge, entry, waited),
            None => Ok(()),
        };
        let kept = aside.map_or(String::new(), |path| format!("; the journal is kept as {}", path.display()));
        left.map(|()| format!("an interrupted write was dismissed and data flash left as it is{kept}"))
    }

    /// Ends the modes that an interrupted write may have left on and seals a gauge that was found sealed, whatever it
    /// holds.
    fn leave_as_it_is(&mut self, gauge: &mut Gauge, entry: Entry, waited: Duration) -> Result<()> {
        // A gauge whose keys nobody may know stays open, if it is.
        let of_keys =
            entry.plan.as_ref().and_then(|plan| plan.key.as_ref()).is_some_and(|key| !key.is_over());
        let wrote = !of_keys && !entry.owes_seal();
        let owes = entry.found == Seal::Sealed && !of_keys;
        let reference = Reference::of(&entry);
        let entry = Entry { plan: None, ..entry };
        let kept = entry.clone();
        let ended = in_time(gauge, waited, |gauge, asked| {
            let now = gauge.seal_anew()?;
            let mut session = Session::new(if owes { Seal::Sealed } else { now }, asked);
            if wrote {
                session.inherit_modes(gauge)?;
            }
            if let Some(journal) = self.journal.as_ref().filter(|_| owes) {
                session.journal = Some(journal.begin(&entry.identity, entry.found, 0)?);
            }
            (session.now, session.entry) = (None, Some(entry));
            session.pack.pack = Some(reference);
            self.guard(gauge, session, |_, _, _| Ok(()), Self::end)
        });
        if let Err(error) = &ended
            && self.pending.is_none()
        {
            // The next write ends a mode that may still be on.
            self.mode_left_on |= wrote;
            if owes {
                self.keep(gauge, Some(kept), None, Left::of(false, error.to_string()));
            }
        }
        ended
    }

    fn resolve(
        &mut self,
        gauge: &mut Gauge,
        pending: &Pending,
        decision: Option<Decision>,
        waited: Duration,
    ) -> Result<Option<String>> {
        let verdict = match &pending.entry {
            Some(_) => self.counted(gauge, |dataflash, gauge| {
                let patience = gauge.chip.security.key_silence + Duration::from_secs(3);
                let watched = pending.watched && gauge.longest_silence() <= patience;
                let certain = pending.certain.filter(|(_, left)| gauge.clock.now() < *left + SOON);
                in_time(gauge, waited, |gauge, asked| {
                    dataflash.act(gauge, &Pending { watched, certain, ..pending.clone() }, decision, asked)
                })
            }),
            None if pending.undecided => Ok(Verdict::Undecided(pending.why.clone())),
            None => Err(Error::new("", Cause::Busy, pending.why.clone())),
        };
        self.now.may_be_renamed();
        let reads_wrong = verdict.as_ref().is_err_and(|error| {
            matches!(error.cause(), Cause::StateUnknown) && error.step() == Some(Step::Restore)
        });
        let tries = pending.tries + u32::from(reads_wrong);
        let (error, undecided) = match verdict {
            Ok(Verdict::Done(message) | Verdict::Plausible(message)) => {
                self.pending = None;
                self.now.may_be_another();
                if let Some(known_pack) = &mut self.known_pack {
                    known_pack.rewritten();
                }
                return Ok(Some(message));
            }
            Ok(Verdict::Another) => {
                self.pending = None;
                return Ok(None);
            }
            Ok(Verdict::Undecided(why)) => {
                self.held = None;
                let file = pending.file.as_ref().filter(|_| pending.elsewhere);
                let file = file.map_or(String::new(), |file| format!(" (journal {})", file.display()));
                let why = format!(
                    "an interrupted write is not settled: {why}{file}; nothing was touched and nothing is written to \
                     this gauge until somebody decides: gaugefs settle"
                );
                (Error::new(gauge.chip.name, Cause::Busy, why), true)
            }
            Err(error) if pending.elsewhere => {
                (self.pending, self.held) = (None, None);
                let file = pending.file.as_ref().map_or(String::new(), |file| file.display().to_string());
                let what =
                    format!("cannot tell whether the interrupted write of {file} was begun on this gauge");
                return Err(error.within(&what));
            }
            Err(error) if reads_wrong && tries >= TRIES => {
                let why = format!(
                    "an interrupted write is not settled: {error}; that was tried {tries} times, and nothing more is \
                     written to this gauge until somebody decides: gaugefs settle"
                );
                (Error::new(gauge.chip.name, Cause::Busy, why), true)
            }
            Err(error) => (error.within("cannot settle an interrupted write"), false),
        };
        let why = error.to_string();
        self.pending = Some(Pending { why, undecided, tries, ..pending.clone() });
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
        self.now.may_be_renamed();
        let identity = self.identity(gauge)?;
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
        session.journal = match self.held.take() {
            Some(held) => Some(held),
            None => match self.journal.as_ref().zip(pending.file.as_ref()) {
                Some((journal, file)) => match journal.open(file)? {
                    Some(opened) => Some(opened),
                    // It has been settled elsewhere.
                    None => return Ok(Verdict::Another),
                },
                None => None,
            },
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
            this.in_calibration &= session.calibrating.is_some();
            let mut held = || session.journal.take().filter(|_| pending.watched);
            if let Some(left_open) = session.pack.left_open.take() {
                this.held = held();
                return Ok(Verdict::Undecided(undecided.get().cloned().unwrap_or(left_open)));
            }
            match (&outcome, left) {
                (Ok(Verdict::Done(_)), None) => session.remove_journal(),
                (Ok(Verdict::Plausible(message)), None) => {
                    let opened = session.journal.take();
                    let Some((journal, opened)) = this.journal.as_ref().zip(opened.as_ref()) else {
                        return outcome;
                    };
                    let kept = journal.wait(opened.path())?;
                    let message = format!("{message}; its journal waits for its pack as {}", kept.display());
                    this.judged.in_epoch(this.now.arrival).push(kept);
                    return Ok(Verdict::Plausible(message));
                }
                _ => this.held = held(),
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
                    false => self.settle_keys(gauge, plan, identities, pending.watched, session),
                }
            }
            Some(plan) => {
                session.pack.was_opened = now == Seal::Sealed;
                let open = if now == Seal::Sealed { self.unseal(gauge, plan) } else { Ok(()) };
                gauge.learn_selection();
                open?;
                sequence(gauge).enable(gauge)?;
                let then = &entry.identity;
                let (watched, certain) = (pending.watched, pending.certain.map(|(moment, _)| moment));
                let shown = self.shown.as_ref().filter(|shown| shown.entry == *entry);
                let task = Task { plan, then, now: identity, watched, certain, decision, shown, elsewhere };
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
        if self.in_calibration || may_calibrate {
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
        if !self.no_erased_key.is_known(self.now.arrival)
            && plan.blocks.iter().any(|block| holds_keys(gauge.chip, block.place()))
        {
            if gauge.takes(&ERASED_KEY.into(), Seal::Unsealed)? {
                return Ok(());
            }
            self.no_erased_key.learn(self.now.arrival, ());
        }
        Err(refused)
    }

    /// The session that has left what is pending is going on: nobody has exchanged the gauge if it has answered since.
    pub(super) fn still_certain(&mut self, gauge: &Gauge) {
        if let Some((_, left)) = self.pending.as_mut().and_then(|pending| pending.certain.as_mut()) {
            *left = gauge.clock.now();
        }
    }

    /// Settles an interrupted write before a new one and logs it. Returns the time since the new write was
    /// requested.
    pub(super) fn settle_first(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Duration> {
        self.pay_first(gauge, waited).map_err(|error| error.owing(self.owed().is_some()))
    }

    fn pay_first(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Duration> {
        let begun = gauge.clock.now();
        if let Some(Pending { why, undecided: true, .. }) = self.find_pending() {
            return Err(Error::new("", Cause::Busy, why));
        }
        let told = self.settle_here(gauge, waited)?;
        told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
        for place in [Where::Places, Where::Waiting] {
            let told = self.search(gauge, place, waited + (gauge.clock.now() - begun))?;
            told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name));
        }
        if let Some(told) = self.pay_seal(gauge, waited + (gauge.clock.now() - begun))? {
            log::warn!("{}: {told}", gauge.chip.name);
        }
        Ok(waited + (gauge.clock.now() - begun))
    }
}

impl Pending {
    fn of(entry: Option<Entry>, why: String) -> Self {
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
    fn found(found: Found) -> Self {
        let file = Some(found.path);
        match found.content {
            Content::Entry(entry) => {
                let why = "a write was interrupted and is not settled yet".to_string();
                Self { file, ..Self::of(Some(entry), why) }
            }
            Content::InUse(why) => Self { file, ..Self::of(None, why) },
            Content::Unreadable(error) => Self { file, undecided: true, ..Self::of(None, error.to_string()) },
        }
    }
}

/// Whether a gauge, by what it shows without a key, may be the one on which something was begun elsewhere.
fn may_be_of(chip: &'static Chip, entry: &Entry, now: &Identity) -> bool {
    let then = &entry.identity;
    match entry.plan.as_ref().filter(|_| !entry.owes_seal()) {
        Some(plan) => !shows_another(chip, then, now, plan),
        // Nobody seals a gauge that may have been opened on purpose.
        None => then.serial == now.serial && is_named(chip, now),
    }
}

impl Plan {
    /// Nothing but what is known of the pack.
    pub(super) fn of_marks(marks: Vec<Mark>) -> Self {
        Self { marks, ..Self::default() }
    }

    /// Whether these changes write all of what an interrupted write was about to change.
    pub(super) fn is_covered(&self, changes: &[Change]) -> bool {
        let is_written = |subclass: u8, offset: usize| {
            changes.iter().any(|change| {
                let begin = usize::from(change.place.offset);
                change.place.subclass == subclass && (begin..begin + change.bytes.len()).contains(&offset)
            })
        };
        let covers = |block: &PlannedBlock| {
            let mut written = (0..WINDOW).filter(|&at| block.written.has(at));
            written.all(|at| is_written(block.subclass, usize::from(block.base) + at))
        };
        self.key.is_none() && !self.blocks.is_empty() && self.blocks.iter().all(covers)
    }
}

impl Entry {
    /// Whether nothing but the seal is owed.
    pub(super) fn owes_seal(&self) -> bool {
        self.plan.as_ref().is_none_or(|plan| plan.blocks.is_empty() && plan.key.is_none())
    }

    /// Whether it is of a change of keys, after which the gauge may have another one than the mount.
    pub(super) fn changes_keys(&self) -> bool {
        self.plan.as_ref().is_some_and(|plan| plan.key.is_some() || plan.blocks.is_empty() && plan.reset)
    }
}

impl Pending {
    /// Whether a person has to decide about a write of which these changes write all, so that nothing is lost without one.
    pub(super) fn is_written_again(&self, changes: &[Change]) -> bool {
        self.undecided && self.plan().is_some_and(|plan| plan.is_covered(changes))
    }

    /// What was about to be written.
    pub(super) fn plan(&self) -> Option<Plan> {
        self.entry.as_ref()?.plan.clone()
    }
}

/// Whether a gauge is certainly the one on which a change of keys was begun at another place. Only keys that this host
/// has are sent to it.
fn is_certainly(gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan, session: &mut Session) -> bool {
    let same = session
        .open(gauge)
        .and_then(|()| compare(gauge.chip, then, now, plan, |place| sequence(gauge).load(gauge, place)));
    same == Ok(Match::Certain)
}

/// Those of the journals of which an open gauge shows nothing. Each block is read once.
fn others_of(gauge: &mut Gauge, now: &Identity, journals: &[(PathBuf, Entry)]) -> Result<Vec<PathBuf>> {
    // A commit may be at work still.
    gauge.wait(COMMITTED);
    let moment = gauge.moment();
    let is_lost = has_lost_memory(gauge)?;
    let (mut read, mut others) = (BTreeMap::new(), Vec::new());
    let mut load = |gauge: &mut Gauge, place: Window| match read.get(&(place.subclass, place.base)) {
        Some(content) => Ok(*content),
        None => {
            let content = sequence(gauge).load(gauge, place)?;
            read.insert((place.subclass, place.base), content);
            Ok(content)
        }
    };
    for (path, entry) in journals {
        let Some(plan) = &entry.plan else { continue };
        let seen = look_by(gauge, plan, &mut load)?;
        let same = compare(gauge.chip, &entry.identity, now, plan, |place| load(gauge, place))?;
        if is_lost || same != Match::Certain && !shows(&seen, &same) {
            others.push(path.clone());
        }
    }
    // What was read before it was away may be of another one.
    Ok(if gauge.is_unbroken_since(moment) { others } else { Vec::new() })
}

/// Whether a gauge that nothing proves to be the one shows what an interrupted write leaves: some of it new, or erased.
fn shows(seen: &[Seen], same: &Match) -> bool {
    let erased = seen.iter().any(|seen| seen.block.is_erased(&seen.stored));
    let explained = seen.iter().all(|seen| seen.held != Held::Unexplained);
    let all = |held: Held| seen.iter().all(|seen| seen.held == held || seen.block.is_neighbour());
    *same == Match::Weak && (erased || explained && !all(Held::Old) && !all(Held::New))
}

/// One interrupted write.
struct Task<'a> {
    plan: &'a Plan,
    then: &'a Identity,
    now: &'a Identity,
    watched: bool,
    /// See [`Pending::certain`].
    certain: Option<Moment>,
    decision: Option<Decision>,
    /// What was shown of it.
    shown: Option<&'a Shown>,
    /// It was begun at another place, or waits for its pack.
    elsewhere: bool,
}

impl Task<'_> {
    fn run(&self, gauge: &mut Gauge, session: &mut Session) -> Result<Verdict> {
        let chip = gauge.chip;
        if has_lost_memory(gauge)? {
            if self.elsewhere {
                return Ok(Verdict::Another);
            }
            let why =
                "a write was interrupted, and the gauge has since lost power and with it its data memory";
            return Ok(Verdict::Done(why.into()));
        }
        if self.plan.by_gauge {
            measured::is_over(gauge)?;
        }
        let moment = gauge.moment();
        let mut job = Job::interrupted(look(gauge, self.plan)?, self.plan.reset);
        let seen = &job.blocks;
        let (all_old, all_new, intact) = (job.all(Held::Old), job.all(Held::New), job.is_intact());
        let whole = intact && (all_old || all_new);
        let mut done: fn(String) -> Verdict = Verdict::Done;
        let mut another = None;
        if let Some(decision) = self.decision {
            another = match self.chosen(gauge, decision, seen)? {
                Chosen::Itself => None,
                Chosen::Another(pack) => Some(pack),
                Chosen::Not(why) => return Ok(Verdict::Undecided(why)),
            };
            session.pack.pack = Some(self.present(gauge)?);
            session.pack.certain_since(moment);
        } else {
            match self.doubt(gauge, seen)? {
                Doubt::None => session.pack.certain_since(moment),
                Doubt::Weak if self.plan.by_gauge && !all_old => {
                    let why = "it was not judged what the gauge has measured and stored, and this gauge has the serial \
                               number and the calibration of every new one, so it may be another pack";
                    return Ok(Verdict::Undecided(why.into()));
                }
                // Flash is not touched, whichever gauge it is. A reset may seal it.
                Doubt::Weak if whole && opens_again(gauge) => {
                    session.pack.certain_since(moment);
                    done = Verdict::Plausible;
                }
                Doubt::Weak if whole => {
                    let held = if all_old { "old" } else { "new" };
                    let why = format!("a write was interrupted; data flash holds the {held} values");
                    return Ok(Verdict::Plausible(why));
                }
                Doubt::Weak => {
                    let why = "this gauge has the serial number and the calibration of every new one, so it may be \
                               another pack";
                    return Ok(Verdict::Undecided(why.into()));
                }
                Doubt::Another => return Ok(Verdict::Another),
                Doubt::Exchanged(why) => {
                    session.pack.is_exchanged();
                    return Ok(Verdict::Undecided(why));
                }
                Doubt::Because(why, same) => {
                    if same == Match::Certain {
                        session.pack.certain_since(moment);
                    }
                    return Ok(Verdict::Undecided(why));
                }
            }
        }
        // The mode that the write started may still be on; `begin` detects that.
        if sequence(gauge).always_finishes() {
            session.begin(gauge)?;
        }
        let forward = match self.decision {
            Some(Decision::Finish(_)) => true,
            Some(Decision::Undo(_) | Decision::Discard) => false,
            None => intact && all_new && !self.plan.by_gauge,
        };
        if self.plan.by_gauge && forward && seen.iter().any(|seen| seen.held == Held::Torn) {
            let why = "what the gauge has measured was lost while it was stored: it can only be undone";
            return Ok(Verdict::Undecided(why.into()));
        }
        if !forward && intact && all_old && !self.plan.reset_sent {
            if let Some(pack) = another {
                let why = format!(
                    "another pack than an interrupted write was begun on, {pack}, has the old values already"
                );
                return Ok(Verdict::Plausible(why));
            }
            return Ok(done("a write was interrupted; data flash holds the old values".into()));
        }
        let erased = seen.iter().any(|seen| {
            let secrets = secrets(chip, seen.block.place);
            holds_keys(chip, seen.block.place) && secrets.iter().all(|at| seen.stored[at] == 0xff)
        });
        let side = if forward { Side::New } else { Side::Old };
        if let Landed::Unknown(error) = converge(gauge, session, &mut job, side, None) {
            return Err(unrestored(error));
        }
        let message = match (forward, self.plan.by_gauge) {
            (true, false) => {
                "a write was interrupted after its last block; it has been finished and verified"
            }
            (false, false) => "a write was interrupted half way; the old values were restored and verified",
            (true, true) => "what the gauge has measured and stored was kept",
            (false, true) => {
                "what the gauge has measured and stored was not judged; the old values were restored and verified"
            }
        };
        if let Some(pack) = another {
            let values = if forward { "new values" } else { "values from before" };
            let message = format!(
                "the {values} of an interrupted write were written to another pack than it was begun on, {pack}, and \
                 verified"
            );
            return Ok(Verdict::Plausible(message));
        }
        let keys = match erased {
            true => {
                "; the keys in the same row were erased, and no journal has them: they are ffff ffff now, change \
                     them with gaugefs keys"
            }
            false => "",
        };
        Ok(done(format!("{message}{keys}")))
    }

    /// Whether the gauge is the one about which a person has decided.
    fn chosen(&self, gauge: &mut Gauge, decision: Decision, seen: &[Seen]) -> Result<Chosen> {
        let look = "look at it with gaugefs settle GAUGE before you decide";
        if self.shown.is_some_and(|shown| !shown.is(self.now, seen)) {
            let why = format!("this is not what was shown: another pack, or it has changed since; {look}");
            return Ok(Chosen::Not(why));
        }
        let number = number_of(gauge.chip, self.now);
        if let Some(pack) = decision.pack()
            && (number.is_none() || pack != self.now.serial)
        {
            let number = number.unwrap_or("none".into());
            return Ok(Chosen::Not(format!(
                "the serial number of this pack is {number}, not 0x{pack:04x}; {look}"
            )));
        }
        let Match::Other(name) = compare_seen(gauge, [self.then, self.now], self.plan, seen)? else {
            return Ok(Chosen::Itself);
        };
        Ok(match (number, decision.pack(), self.shown) {
            (Some(number), Some(_), _) => Chosen::Another(format!("serial number {number}")),
            (None, _, Some(_)) => Chosen::Another("which was shown before".into()),
            (Some(number), None, _) => Chosen::Not(format!(
                "{name} is not what it was then: this is another pack, serial number {number}; to write to it all the same, \
                 add --serial {number}"
            )),
            (None, _, None) => {
                Chosen::Not(format!("{name} is not what it was then: this is another pack; {look}"))
            }
        })
    }

    /// Why nothing may be written without being told to.
    fn doubt(&self, gauge: &mut Gauge, seen: &[Seen]) -> Result<Doubt> {
        let same = compare_seen(gauge, [self.then, self.now], self.plan, seen)?;
        if self.elsewhere && same != Match::Certain {
            return Ok(if shows(seen, &same) { Doubt::Weak } else { Doubt::Another });
        }
        if let Match::Other(name) = &same {
            // RAM without a flag for its loss looks the same as another pack.
            let or_lost = match gauge.chip.volatile {
                Some(0) => ", or the gauge has lost its power and with it its data memory",
                _ => "",
            };
            return Ok(Doubt::Exchanged(format!(
                "{name} is not what it was then: this is another pack{or_lost}"
            )));
        }
        let certain =
            same == Match::Certain || self.certain.is_some_and(|moment| gauge.is_unbroken_since(moment));
        if !(self.watched && certain)
            && let Some(Seen { block, stored, .. }) = seen.iter().find(|seen| seen.held == Held::Unexplained)
        {
            let unlike = |&at: &usize| {
                ![block.old[at], block.new[at], 0xff].contains(&stored[at]) && !block.learned.has(at)
            };
            let at = (0..WINDOW).find(unlike).unwrap_or(0);
            let why = format!(
                "{} holds 0x{:02x}, which the write does not explain (old 0x{:02x}, new 0x{:02x})",
                block.place.name(at),
                stored[at],
                block.old[at],
                block.new[at]
            );
            return Ok(Doubt::Because(why, same));
        }
        Ok(if certain { Doubt::None } else { Doubt::Weak })
    }

    /// What the pack that is there now is compared with later.
    fn present(&self, gauge: &mut Gauge) -> Result<Reference> {
        let mut known = Known::default();
        for place in mark_windows(gauge.chip) {
            known.note(gauge.chip, place, sequence(gauge).load(gauge, place)?);
        }
        let plan = Plan { marks: known.marks(gauge.chip), ..self.plan.clone() };
        Ok(Reference { identity: self.now.clone(), plan })
    }
}

/// Compares a gauge with the one of a plan, whose blocks have been looked at.
fn compare_seen(gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan, seen: &[Seen]) -> Result<Match> {
    compare(gauge.chip, then, now, plan, |place| {
        let seen = seen.iter().find(|seen| seen.block.place == place);
        seen.map_or_else(|| sequence(gauge).load(gauge, place), |seen| Ok(seen.stored))
    })
}

/// The serial number of a gauge, if it has one, as it is shown.
fn number_of(chip: &Chip, identity: &Identity) -> Option<String> {
    chip.serial_register().map(|_| format!("0x{:04x}", identity.serial))
}

/// Whether the gauge can be opened again after it was sealed.
fn opens_again(gauge: &Gauge) -> bool {
    gauge.was_opened() || matches!(gauge.chip.security.storage, KeyStorage::Fixed(_))
}

/// The changed parameters of a plan, and others that are not what they were, one a line: place, name, old, new, and
/// what the gauge has. A person who decides sees everything that the decision may change.
fn table(chip: &Chip, seen: &[Seen]) -> String {
    let mut table = String::from("parameter\tname\told\tnew\tgauge\n");
    for Seen { block, stored, .. } in seen {
        let rows = chip.subclasses.iter().filter(|row| row.id == block.place.subclass);
        for row in rows.flat_map(|subclass| subclass.parameters.iter().map(move |one| (subclass, one))) {
            let (subclass, parameter) = row;
            let start = usize::from(parameter.offset).checked_sub(usize::from(block.place.base));
            let Some(start) = start.filter(|start| start + parameter.kind.size() <= WINDOW) else { continue };
            let range = start..start + parameter.kind.size();
            let differs = |at| stored[at] != block.old[at] && !block.learned.has(at);
            if subclass.kind == Kind::Security
                || !range.clone().any(|at| block.written.has(at) || differs(at))
            {
                continue;
            }
            let show = |bytes: &[u8; WINDOW]| {
                notation::render(parameter.kind, &codec::decode(parameter.kind, &bytes[range.clone()]))
            };
            table += &format!(
                "{}\t{}\t{}\t{}\t{}\n",
                Place::of(row),
                parameter.name,
                show(&block.old),
                show(&block.new),
                show(stored)
            );
        }
    }
    table
}
