// SPDX-License-Identifier: MIT

//! Key changes: the only write to the Security subclass.
//!
//! A gauge whose key is lost cannot be recovered, so every step is verified. The old key is proven by using
//! it. The stored keys are compared with those the gauge accepted, which shows on this very gauge that the
//! table has the right place and byte order. The block is read back while FULL ACCESS still allows a
//! correction, and only then is the gauge sealed and opened with the new key.
//!
//! Until the block is committed an error means that no key was changed. From then on the answer is
//! success, [`Cause::RolledBack`] (the old key is back, and was used) or [`Cause::StateUnknown`], which says what
//! is known of the keys.
//!
//! A loss of power may leave each word of the block old, new or erased, also those of keys that are not changed. The
//! journal says that a change was about to be written, and how far it came, but has no key. So a change that was cut
//! short is undone by the process that has begun it and still knows the keys, or made or undone by whoever makes it
//! once more with the same two keys; until then nothing else is written.

use std::cell::OnceCell;
use std::fmt;
use std::time::Duration;

use zeroize::{Zeroize, Zeroizing};

use super::io::COMMITTED;
use super::job::Job;
use super::keyrow::{keeps_unseal_key, quietly, stored};
use super::pack::{Match, compare};
use super::planned::{self, Held, look};
use super::schemes::sequence;
use super::session::{ByKeys, Left, Patience, RESTORES, Session, own_up, store};
use super::verdict::{Verdict, unrestored};
use super::window::{Dirty, Window};
use super::window::{learned, locate, secrets};
use super::{Change, DataFlash};
use crate::authentication::{self, LENGTH, Order};
use crate::chip::{Chip, FLAT, KeyBlock, KeyOrder, KeyStorage, Kind};
use crate::codec::Bytes;
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{DEFAULT_FULL_ACCESS, Gauge, Seal};
use crate::journal::{Identity, KEYS_WRITTEN, KeyPlan, Plan};
use crate::keys::{KeyChange, Name, Secret, wipe_stack};

/// Time for the change, and again for undoing it, without the pauses that a gauge needs after a refused key.
const WAY: Duration = Duration::from_secs(8);
/// Most pauses that are needed in either direction.
const SILENCES: u32 = 14;
/// Time that a gauge may take to restart before it answers.
const START: Duration = Duration::from_secs(3);
/// After a start Voltage() is valid about 1 s later (E2E 1059347).
const MEASURED: Duration = Duration::from_secs(1);
/// Time between attempts while a gauge does not answer or did not follow a command.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Words below this are, or may become, subcommands of any part.
const SUBCOMMANDS: u16 = 0x0100;
/// Words that ManufacturerAccessControl() takes for addresses.
const ADDRESSES: std::ops::Range<u16> = 0x4000..0x4400;
/// Content of erased flash.
const ERASED: u16 = 0xffff;
/// Bytes of an authentication key.
const LENGTH_OF_KEY: usize = 16;

/// The keys of a gauge, from SEALED up.
#[derive(Clone)]
struct Ring {
    unseal: Secret,
    full_access: Secret,
}

impl Ring {
    /// The keys in their order, where each leads, and whether a gauge in that state needs it no more.
    fn rungs(&self, from: Seal) -> [(Name, &Secret, Seal, bool); 2] {
        [
            (Name::Unseal, &self.unseal, Seal::Unsealed, from != Seal::Sealed),
            (Name::FullAccess, &self.full_access, Seal::FullAccess, from == Seal::FullAccess),
        ]
    }

    fn get(&self, name: Name) -> &Secret {
        if name == Name::Unseal { &self.unseal } else { &self.full_access }
    }

    fn set(&mut self, name: Name, key: &Secret) {
        let place = if name == Name::Unseal { &mut self.unseal } else { &mut self.full_access };
        place.clone_from(key);
    }
}

/// The keys that lead from SEALED up.
const SEALS: [Name; 2] = [Name::Unseal, Name::FullAccess];

/// A change that this process has begun and that is neither done nor undone. What is in memory ends with the process.
pub(super) struct Unfinished {
    change: KeyChange,
    ring: Ring,
    /// The key that has to answer a challenge when the old keys are back.
    authentication: Option<Secret>,
    /// The row with the old keys.
    before: Zeroizing<[u8; WINDOW]>,
    order: Order,
}

impl fmt::Debug for Unfinished {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Unfinished { hidden }")
    }
}

/// One change on its way.
struct Task<'a> {
    block: &'a KeyBlock,
    change: &'a KeyChange,
    /// The row with the keys, and the position of their block in it.
    place: Window,
    start: usize,
    /// In which order challenges are sent.
    order: Order,
    found: Seal,
    /// The mount's keys that lead from SEALED up.
    mine: [Option<Secret>; 2],
    /// Something was sent that may have changed the seal.
    moved: bool,
    /// A loss of power may have left any word of the keys old, new or erased.
    torn: bool,
    /// A key of the gauge is ffff ffff, so others may be, too.
    erased: bool,
    /// The order of bytes is not known of this gauge: no key of its own shows it.
    unordered: bool,
    /// Keys that may have been lost and could not be put back.
    lost: Vec<Name>,
    /// The row of keys was written and did not read back right: it may hold a key that nobody has.
    is_unknown: bool,
}

impl DataFlash {
    /// Changes a key. `waited` is the time since the request was made.
    pub fn change_key(
        &mut self,
        gauge: &mut Gauge,
        change: &KeyChange,
        order: Order,
        waited: Duration,
    ) -> Result<()> {
        let name = change.name.as_str();
        let outcome = self.counted(gauge, |dataflash, gauge| {
            own_up(gauge, |gauge| dataflash.change_key_unnamed(gauge, change, order, waited))
        });
        gauge.limit(None);
        wipe_stack();
        self.noted(outcome).map_err(|error| error.within(&format!("{name} key")))
    }

    fn change_key_unnamed(
        &mut self,
        gauge: &mut Gauge,
        change: &KeyChange,
        order: Order,
        waited: Duration,
    ) -> Result<()> {
        let block = block_of(gauge.chip, change.name)?;
        check_new(gauge, change)?;
        // Whoever makes a change that was cut short once more settles it.
        let left = self.pending_keys();
        let waited = match left {
            Some(_) => waited,
            None => self.settle_first(gauge, waited)?,
        };
        let asked = gauge.clock.now().saturating_sub(waited);
        gauge.limit(Some((WAY + gauge.chip.security.key_silence * SILENCES).saturating_sub(waited)));
        gauge.claim()?;
        let found = self.preflight(gauge, &[])?;
        let mut session = Session::new(found.seal, asked);
        session.pack.begin(gauge);
        match &left {
            Some(_) => self.adopt(gauge, &mut session)?,
            None => self.owe(gauge, &mut session, 0)?,
        }
        session.patience =
            Some(Patience { silence: START, refusals: WAY + gauge.chip.security.key_silence * 2 * RESTORES });
        let mut task = Task::new(gauge, block, change, order, found.seal);
        task.torn = left.is_some();
        let known = OnceCell::new();
        let run = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
            let outcome = task.run(this, gauge, found.voltage_mv, session);
            let is_known = match outcome.as_ref().map_err(Error::cause) {
                Ok(()) | Err(Cause::RolledBack) => true,
                Err(_) => false,
            };
            // All keys but those that are lost have been used.
            known.get_or_init(|| is_known.then(|| std::mem::take(&mut task.lost)));
            if task.moved {
                session.now = None;
            }
            if session.found == Seal::Sealed && task.is_to_stay_open(gauge) {
                session.stays(Seal::FullAccess);
            }
            outcome
        };
        self.guard(gauge, session, run, |this, mut session, gauge, outcome, owed| {
            let lost = known.get().cloned().flatten();
            match owed {
                // Which keys it has is not known.
                Some(owed) if owed.data => this.leave(gauge, session, owed),
                // A change that was cut short before is as it was.
                _ if left.is_some() && lost.is_none() => {}
                owed => {
                    (this.pending, this.unfinished) = (None, None);
                    let lost = lost.unwrap_or_default();
                    if !lost.is_empty() {
                        for &name in &lost {
                            session.note_keys(|key| key.begin(name), &keys_line(name));
                        }
                        let why = still_lost(&lost);
                        log::warn!("{}: {why}", gauge.chip.name);
                        this.leave(gauge, session, Left::of(true, why));
                        this.leave_to_person();
                    } else if let Some(owed) = owed {
                        this.leave(gauge, session, owed);
                    } else {
                        session.remove_journal();
                    }
                }
            }
            outcome
        })
    }

    /// The change of keys that was cut short and is to be settled, if there is one.
    fn pending_keys(&mut self) -> Option<Plan> {
        let plan = self.find_pending()?.plan()?;
        plan.key.as_ref().filter(|key| !key.is_over())?;
        Some(plan)
    }

    /// What a gauge has of a change that was cut short, found out by using the keys that this process has. Nothing is
    /// written but by the process that has begun it.
    pub(super) fn settle_keys(
        &mut self,
        gauge: &mut Gauge,
        plan: &Plan,
        identities: [&Identity; 2],
        watched: bool,
        session: &mut Session,
    ) -> Result<Verdict> {
        let (Some(key), KeyStorage::Flash(block)) = (&plan.key, &gauge.chip.security.storage) else {
            return Ok(Verdict::Undecided("it is of a part whose keys cannot be changed".into()));
        };
        if key.is_over() {
            return Ok(Verdict::Done(format!(
                "a change of the {} key was interrupted after the new key was written and read back: the gauge has the \
                 new key, which belongs into {}",
                key.names(),
                gauge.key_file
            )));
        }
        // The commit may be at work still.
        gauge.wait(COMMITTED);
        let found = gauge.seal()?;
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * SILENCES));
        let verdict = match self.unfinished.take() {
            Some(unfinished) => {
                let mut task = Task::new(gauge, block, &unfinished.change, unfinished.order, found);
                task.torn = true;
                task.mine = SEALS.map(|name| Some(unfinished.ring.get(name).clone()));
                let verdict = task.undo(gauge, plan, identities, watched, &unfinished, session);
                if !matches!(verdict, Ok(Verdict::Done(_))) {
                    self.unfinished = Some(unfinished);
                }
                verdict
            }
            None => probe(gauge, block, plan, key, identities, watched, found, session),
        };
        wipe_stack();
        verdict
    }

    /// Refuses a write whose reset would seal a gauge that was found open and may not open again: its key must have
    /// been used, or be the one that it keeps, which only FULL ACCESS lets one read.
    pub(super) fn check_key(&mut self, gauge: &mut Gauge, found: Seal, changes: &[Change]) -> Result<()> {
        let resets = changes.iter().any(|change| change.kind(gauge.chip) == Kind::Reset);
        let volatile = gauge.chip.volatile.is_some();
        if found == Seal::Sealed || !resets || volatile || gauge.key_is_proven() {
            return Ok(());
        }
        if found == Seal::FullAccess && keeps_unseal_key(gauge)? {
            return Ok(());
        }
        // It has worked, and the pack that it has worked on is still there.
        if gauge.key_has_worked() && self.is_certain(gauge)? {
            gauge.prove_key();
            return Ok(());
        }
        let why = format!(
            "found {}, and the reset that this write needs may seal it, but its unseal key has not been tried; seal \
             and unseal it once (echo sealed > gauge/seal, then echo unsealed), with the right key in {}",
            found.as_str(),
            gauge.key_file
        );
        Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Check))
    }
}

/// The block of keys with one of that name, or why it cannot be changed.
fn block_of(chip: &'static Chip, name: Name) -> Result<&'static KeyBlock> {
    let refuse = |why: &str| {
        let why = format!("cannot be changed here: {why}");
        Err(Error::new(chip.model, Cause::NotPermitted, why).at(Step::Check))
    };
    match &chip.security.storage {
        KeyStorage::Fixed(why) => refuse(why),
        KeyStorage::Flash(block) if name == Name::Authentication => {
            match block.authentication.filter(|_| chip.authentication.is_some()) {
                Some(_) => Ok(block),
                None => refuse(
                    "this part has no authentication that gaugefs knows, so a new key could not be tried",
                ),
            }
        }
        KeyStorage::Flash(block) => Ok(block),
    }
}

/// Refuses keys that would leave a gauge open or be taken for something else. The manual's defaults are
/// allowed, so that a pack can be handed on with them.
fn check_new(gauge: &Gauge, change: &KeyChange) -> Result<()> {
    let refuse = |why: &'static str| {
        Err(Error::new("", Cause::OutOfRange, format!("the new key {why}")).at(Step::Check))
    };
    if change.new == change.old {
        let why = "the new key is the old one";
        return Err(Error::new("", Cause::Invalid, why).at(Step::Check));
    }
    let (default, other) = match change.name {
        Name::Unseal => (gauge.chip.security.default_unseal, gauge.key(Name::FullAccess)),
        Name::FullAccess => (DEFAULT_FULL_ACCESS, gauge.key(Name::Unseal)),
        Name::Authentication => {
            let bytes = change.new.bytes();
            return if bytes.iter().all(|byte| *byte == bytes[0]) {
                refuse("is one byte sixteen times, which is the first that anybody tries")
            } else {
                Ok(())
            };
        }
    };
    let words = change.new.words();
    if other.is_some_and(|other| other == change.new) {
        return refuse("is the other key as well: sent twice it would open the gauge wide");
    }
    if words == default {
        return Ok(());
    }
    if words.contains(&0) || words.contains(&ERASED) {
        return refuse("has a word of zeros or ones, as a bus or a flash has that fails");
    }
    if words[0] == words[1] {
        return refuse("is one word twice: a transfer that is repeated would open the gauge");
    }
    let known = |word: &u16| gauge.chip.subcommands.iter().any(|subcommand| subcommand.code == *word);
    if words.iter().any(|word| *word < SUBCOMMANDS || known(word)) {
        return refuse("has a word that is a subcommand, which the manual forbids");
    }
    if gauge.chip.access.scheme.is_flat() && words.iter().any(|word| ADDRESSES.contains(word)) {
        return refuse("has a word that is an address of data flash (0x4000 to 0x43ff)");
    }
    Ok(())
}

impl<'a> Task<'a> {
    fn new(gauge: &Gauge, block: &'a KeyBlock, change: &'a KeyChange, order: Order, found: Seal) -> Self {
        let (place, start) = locate(block.subclass, block.start);
        Self {
            block,
            change,
            place,
            start,
            order,
            found,
            mine: SEALS.map(|name| gauge.key(name)),
            moved: false,
            torn: false,
            erased: change.old.is_erased(),
            unordered: false,
            lost: Vec::new(),
            is_unknown: false,
        }
    }

    fn run(
        &mut self,
        dataflash: &mut DataFlash,
        gauge: &mut Gauge,
        voltage_mv: u16,
        session: &mut Session,
    ) -> Result<()> {
        let KeyChange { name, old, new } = self.change;
        let taken = self.enter(gauge)?;
        sequence(gauge).enable(gauge)?;
        if let Some(row) = dataflash.learn_marks(gauge)? {
            return Err(dataflash.other_pack(gauge, row));
        }
        let left =
            session.entry.as_ref().and_then(|entry| Some((entry.identity.clone(), entry.plan.clone()?)));
        if let Some((then, plan)) = &left {
            let now = dataflash.identity(gauge)?;
            self.check_pack(gauge, [then, &now], plan)?;
            // What shows that the table fits may have been erased with the keys. It was checked before.
            restore_rows(gauge, session, plan)?;
        }
        dataflash.check_signature(gauge)?;
        dataflash.check_gate(gauge, voltage_mv)?;
        let before = self.read(gauge)?;
        let ring = self.ring_of(&before, taken)?;
        let held = match name {
            Name::Authentication => self.held_authentication(gauge, &before)?,
            _ => ring.get(*name).clone(),
        };
        let key = left.as_ref().and_then(|(_, plan)| plan.key.as_ref());
        self.compare_with(gauge, &before, &ring, &held, key)?;
        // Restoring the seal state needs these keys.
        gauge.set_key(*name, &held);
        if self.torn || self.erased {
            SEALS.into_iter().for_each(|name| gauge.set_key(name, ring.get(name)));
        }
        if !self.torn && *name != Name::Authentication && self.found != Seal::Sealed {
            self.moved = true;
            gauge.go_to(Seal::Sealed)?;
            self.climb(gauge, &ring, Seal::Sealed)?;
        }
        sequence(gauge).enable(gauge)?;
        let (mut after, mut wanted) = (before.clone(), ring);
        let mine = gauge.key(Name::Authentication);
        let authentication = key.and_then(|key| self.complete(dataflash, mine, &mut after, &mut wanted, key));
        let mut back = after.clone();
        self.put(&mut after, *name, new);
        self.put(&mut back, *name, old);
        let mut before_ring = wanted.clone();
        if *name != Name::Authentication {
            wanted.set(*name, new);
            before_ring.set(*name, old);
        }
        let proof = |key: &'a Secret| {
            if *name == Name::Authentication { Some(key.clone()) } else { authentication.clone() }
        };
        self.announce(dataflash, gauge, session, &before, &before_ring)?;
        dataflash.refer(gauge, session);
        let mut touched = 0;
        let written = self.write(gauge, &after, &mut touched);
        let proven = written.and_then(|()| {
            // While another key may be lost, the journal stays.
            if self.lost.is_empty() {
                session.note_keys(|key| key.written = true, KEYS_WRITTEN);
            }
            self.prove(gauge, &wanted, proof(new).as_ref())
        });
        let Err(error) = proven else {
            SEALS.into_iter().for_each(|name| gauge.set_key(name, wanted.get(name)));
            gauge.set_key(*name, new);
            return Ok(());
        };
        if touched == 0 {
            return Err(error);
        }
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * SILENCES));
        self.torn = true;
        session.note_keys(|key| key.begin(*name), &keys_line(*name));
        let unfinished = Unfinished {
            change: self.change.clone(),
            ring: before_ring.clone(),
            authentication: proof(old),
            before: back,
            order: self.order,
        };
        let mut error = self.back(gauge, &unfinished, &error);
        if matches!(error.cause(), Cause::RolledBack)
            && let Some(plan) = session.entry.as_ref().and_then(|entry| entry.plan.clone())
            && let Err(second) = restore_rows(gauge, session, &plan)
        {
            error = Error::of("", Reason::KeyUnknown { failed: error, what: format!("but {second}") });
        }
        dataflash.unfinished = Some(unfinished);
        Err(error)
    }

    /// Position of a key in the row.
    fn at(&self, name: Name) -> usize {
        self.start
            + match name {
                Name::Unseal => self.block.unseal,
                Name::FullAccess => self.block.full_access,
                Name::Authentication => self.block.authentication.unwrap_or_default(),
            }
    }

    /// The mount's key of that name, which is not the one that is changed.
    fn mine(&self, name: Name) -> Option<&Secret> {
        self.mine[usize::from(name == Name::FullAccess)].as_ref()
    }

    /// The key of that name that the gauge had before the change was begun, as far as is known.
    fn expected(&self, gauge: &Gauge, name: Name) -> Result<Secret> {
        if name == self.change.name {
            return Ok(self.change.old.clone());
        }
        self.mine(name).cloned().ok_or_else(|| {
            let (name, place) = (name.as_str(), &gauge.key_file);
            let why = format!("the {name} key is needed too; put it into {place} and mount again");
            Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Check)
        })
    }

    fn ring(&self, gauge: &Gauge) -> Result<Ring> {
        Ok(Ring {
            unseal: self.expected(gauge, Name::Unseal)?,
            full_access: self.expected(gauge, Name::FullAccess)?,
        })
    }

    /// Goes to FULL ACCESS from the seal state in which the gauge was found, with the keys that it has. Returns those
    /// that were needed.
    fn enter(&mut self, gauge: &mut Gauge) -> Result<[Option<Secret>; 2]> {
        let ring = self.ring(gauge)?;
        let mut taken = [None, None];
        for ((name, key, goal, above), taken) in ring.rungs(self.found).into_iter().zip(&mut taken) {
            if above {
                continue;
            }
            self.moved = true;
            let found = self.find(gauge, name, key, goal)?;
            let why = || match (name == self.change.name, self.torn || self.erased) {
                (true, false) => "the gauge takes neither the old key nor the new one".to_string(),
                (true, true) => {
                    "the gauge takes neither of the two keys, nor a part of each, nor ffff ffff".to_string()
                }
                (false, false) => format!("the gauge refused the mount's {} key", name.as_str()),
                (false, true) => {
                    format!("the gauge refused the mount's {} key, parts of it, and ffff ffff", name.as_str())
                }
            };
            let found = found
                .ok_or_else(|| Error::new(gauge.chip.model, Cause::NotPermitted, why()).at(Step::Unseal))?;
            *taken = Some(found);
        }
        Ok(taken)
    }

    /// The keys that the gauge has: those that it took, and of the others those that are stored.
    fn ring_of(&self, window: &[u8; WINDOW], taken: [Option<Secret>; 2]) -> Result<Ring> {
        let of = |name: Name, taken: Option<Secret>| {
            if let Some(key) = taken {
                return Ok(key);
            }
            let known: Vec<&Secret> = match name == self.change.name {
                true => vec![&self.change.old, &self.change.new],
                false => self.mine(name).into_iter().collect(),
            };
            if let Some(key) = known.iter().find(|key| self.is_stored(window, key, name)) {
                return Ok((*key).clone());
            }
            let at = self.at(name);
            let present = unstored(&window[at..at + 4], self.block.order);
            let erased = ERASED.to_be_bytes();
            let is_left = (0..4).step_by(2).all(|word| {
                let word = word..word + 2;
                present.bytes()[word.clone()] == erased
                    || self.torn
                        && known.iter().any(|key| key.bytes()[word.clone()] == present.bytes()[word.clone()])
            });
            match (is_left && (self.torn || self.erased), known.first()) {
                (true, _) => Ok(present),
                // The comparison refuses it.
                (false, Some(key)) if name != self.change.name => Ok((*key).clone()),
                _ => Err(neither()),
            }
        };
        let [unseal, full_access] = taken;
        Ok(Ring { unseal: of(Name::Unseal, unseal)?, full_access: of(Name::FullAccess, full_access)? })
    }

    /// The authentication key that the gauge has: the old one, the new one, or what a change left behind that was cut
    /// short.
    fn held_authentication(&self, gauge: &mut Gauge, window: &[u8; WINDOW]) -> Result<Secret> {
        let KeyChange { name, old, new } = self.change;
        for key in [old, new] {
            if self.is_stored(window, key, *name) && self.challenge(gauge, key)? {
                return Ok(key.clone());
            }
        }
        let at = self.at(*name);
        let present = &window[at..at + LENGTH_OF_KEY];
        let word = |at: usize| {
            let word = at..at + 2;
            [&old.bytes()[word.clone()], &new.bytes()[word.clone()], &ERASED.to_be_bytes()]
                .contains(&&present[word])
        };
        if (0..present.len()).step_by(2).all(word) && !self.is_stored(window, old, *name) {
            return Ok(Secret::of_bytes(present));
        }
        Err(neither())
    }

    /// Puts back what a loss of power has taken of the keys that are not changed. Returns the authentication key that
    /// has to be proven then, and notes what cannot be put back.
    fn complete(
        &mut self,
        dataflash: &DataFlash,
        mine: Option<Secret>,
        window: &mut [u8; WINDOW],
        ring: &mut Ring,
        key: &KeyPlan,
    ) -> Option<Secret> {
        for name in SEALS.into_iter().filter(|name| *name != self.change.name) {
            if let Some(mine) = self.mine(name).filter(|mine| *mine != ring.get(name)).cloned() {
                ring.set(name, &mine);
                self.put(window, name, &mine);
            }
        }
        let name = Name::Authentication;
        if self.change.name == name || self.block.authentication.is_none() {
            return None;
        }
        let at = self.at(name);
        let present = Secret::of_bytes(&window[at..at + LENGTH_OF_KEY]);
        let is_damaged = present.has_erased_word() && !key.erased.contains(&name);
        let kept =
            dataflash.unfinished.as_ref().map(|kept| Secret::of_bytes(&kept.before[at..at + LENGTH_OF_KEY]));
        match kept.or(mine) {
            Some(known) if is_damaged || known == present => {
                self.put(window, name, &known);
                Some(known)
            }
            _ if is_damaged || key.names.contains(&name) => {
                self.lost.push(name);
                None
            }
            _ => None,
        }
    }

    /// Records what is about to be written: which key, and what is beside the keys in their row and in the rows next
    /// to it.
    fn announce(
        &self,
        dataflash: &mut DataFlash,
        gauge: &mut Gauge,
        session: &mut Session,
        before: &[u8; WINDOW],
        ring: &Ring,
    ) -> Result<()> {
        let name = self.change.name;
        let Some(entry) = &mut session.entry else { return Ok(()) };
        if let Some(key) = entry.plan.as_mut().and_then(|plan| plan.key.as_mut()) {
            if !key.names.contains(&name) {
                key.begin(name);
                if let Some(journal) = &mut session.journal {
                    journal.note(&keys_line(name))?;
                }
            }
            return Ok(());
        }
        let mut rows = Vec::new();
        if self.place.subclass == FLAT {
            let step = WINDOW as u16;
            for base in [self.place.base, self.place.base - step, self.place.base + step] {
                let place = Window { base, ..self.place };
                let content = match base == self.place.base {
                    true => *before,
                    false => quietly(gauge, |gauge| sequence(gauge).load(gauge, place))?,
                };
                let learned = learned(gauge.chip, place);
                rows.push(Dirty { place, old: content, new: content, written: Bytes::default(), learned });
            }
        }
        let marks = dataflash.known().marks(gauge.chip);
        let mut plan = planned::plan(gauge, false, &[], &rows, marks);
        let is_erased = |name: &Name| match name {
            Name::Authentication => {
                self.block.authentication.is_some() && {
                    let at = self.at(*name);
                    Secret::of_bytes(&before[at..at + LENGTH_OF_KEY]).has_erased_word()
                }
            }
            name => ring.get(*name).is_erased(),
        };
        let erased = Name::ALL.into_iter().filter(is_erased).collect();
        let ordered = SEALS.into_iter().any(|name| shows_order(ring.get(name)));
        plan.key = Some(KeyPlan { names: vec![name], erased, ordered, written: false });
        if let Some(journal) = &mut session.journal {
            journal.plan(&plan)?;
        }
        entry.plan = Some(plan);
        Ok(())
    }

    /// Refuses a pack that is not the one on which a change was begun.
    fn check_pack(&self, gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan) -> Result<()> {
        match same_pack(gauge, [then, now], plan)? {
            Match::Other(name) => {
                let why = format!(
                    "{name} is not what it was when a change of keys was cut short: this is another pack; nothing was \
                     changed. Connect the right pack, or give that change up: gaugefs settle GAUGE --discard"
                );
                Err(Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Identify))
            }
            Match::Certain | Match::Weak => Ok(()),
        }
    }

    /// Goes from a seal state to FULL ACCESS with these keys.
    fn climb(&mut self, gauge: &mut Gauge, ring: &Ring, from: Seal) -> Result<()> {
        for (name, key, goal, above) in ring.rungs(from) {
            if above {
                continue;
            }
            self.moved = true;
            if !gauge.takes(key, goal)? {
                let which = if name == self.change.name { "this" } else { "the mount's" };
                let why = format!("the gauge refused {which} {} key", name.as_str());
                return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Unseal));
            }
        }
        Ok(())
    }

    /// Whether the gauge answers a random challenge as only this key does. An error is one of the bus, and says nothing
    /// about the key.
    fn challenge(&self, gauge: &mut Gauge, key: &Secret) -> Result<bool> {
        answers(gauge, key, self.order)
    }

    /// Whether the gauge takes the keys, found out by using them. Sealed and opened again.
    fn prove(&mut self, gauge: &mut Gauge, ring: &Ring, authentication: Option<&Secret>) -> Result<()> {
        if let Some(key) = authentication
            && !self.challenge(gauge, key)?
        {
            let why = "the answer to a challenge does not match this key";
            return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Verify));
        }
        if self.change.name == Name::Authentication && !self.torn {
            return Ok(());
        }
        gauge.go_to(Seal::Sealed)?;
        self.climb(gauge, ring, Seal::Sealed)
    }

    /// The row as it is now. Only what is keys counts: beside them may be what the gauge rewrites.
    fn read(&self, gauge: &mut Gauge) -> Result<Zeroizing<[u8; WINDOW]>> {
        quietly(gauge, |gauge| sequence(gauge).load(gauge, self.place).map(Zeroizing::new))
    }

    /// Whether a key is stored in its place, in the byte order of the table.
    fn is_stored(&self, window: &[u8; WINDOW], key: &Secret, name: Name) -> bool {
        let (at, bytes) = (self.at(name), stored(key, self.block.order));
        window[at..at + bytes.len()] == **bytes
    }

    fn put(&self, window: &mut [u8; WINDOW], name: Name, key: &Secret) {
        let (at, bytes) = (self.at(name), stored(key, self.block.order));
        window[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    /// Checks that the keys the gauge accepted are stored where, and in the byte order, the table says, and that
    /// at least one of them would look different in another order. Where all keys are erased none does. Then the change
    /// that was cut short has checked it, or the new key is written and tried, and found again in whatever order.
    fn compare_with(
        &mut self,
        gauge: &Gauge,
        window: &[u8; WINDOW],
        ring: &Ring,
        held: &Secret,
        left: Option<&KeyPlan>,
    ) -> Result<()> {
        let refuse = |why: &str| {
            let why = format!("{why}; nothing was changed");
            Err(Error::new("", Cause::NotPermitted, why).at(Step::Check))
        };
        let name = self.change.name;
        let places = [(&ring.unseal, Name::Unseal), (&ring.full_access, Name::FullAccess), (held, name)];
        if !places.into_iter().all(|(key, name)| self.is_stored(window, key, name)) {
            return refuse("this gauge does not keep the keys it takes where and how its manual says");
        }
        let is_shown = SEALS.into_iter().any(|name| shows_order(ring.get(name)));
        if is_shown || left.is_some_and(|left| left.ordered) || name == Name::Authentication && left.is_none()
        {
            return Ok(());
        }
        if !SEALS.into_iter().all(|name| ring.get(name).is_erased()) {
            return refuse("neither of its keys shows in which order of bytes this gauge keeps them");
        }
        self.unordered = true;
        let written = SEALS.map(|one| if one == name { Some(&self.change.new) } else { self.mine(one) });
        let are_safe =
            written.into_iter().flatten().all(|key| turned(key).iter().all(|key| is_harmless(gauge, key)));
        if are_safe {
            return Ok(());
        }
        refuse(
            "all its keys are erased, so that none shows in which order of bytes it keeps them, and in another order a \
             word of the new key is a command; change it to some other key first",
        )
    }

    /// Writes the keys and reads them back. `touched` counts the commits.
    fn write(&self, gauge: &mut Gauge, keys: &[u8; WINDOW], touched: &mut usize) -> Result<()> {
        quietly(gauge, |gauge| {
            let present = Zeroizing::new(sequence(gauge).load(gauge, self.place)?);
            let of_keys = Bytes::of(|at| (self.start..self.start + self.block.length).contains(&at));
            // Beside the keys a byte goes back only if it was erased: other keys, and parameters of a flat row.
            let goes = Bytes::of(|at| {
                of_keys.has(at) || present[at] == 0xff && secrets(gauge.chip, self.place).has(at)
            });
            if goes.iter().all(|at| present[at] == keys[at]) {
                return Ok(());
            }
            let learned = Bytes::of(|at| !goes.has(at));
            let mut block = Dirty { place: self.place, old: *present, new: *present, written: goes, learned };
            goes.iter().for_each(|at| block.new[at] = keys[at]);
            // The keys that it has taken show that it is the one.
            let stored = store(gauge, &mut ByKeys, &block, touched);
            block.old.zeroize();
            block.new.zeroize();
            stored
        })
    }

    /// After a failure following the commit: finds out which keys open the gauge, puts the old block back and
    /// tries it. Always an error, which says what is known.
    fn back(&mut self, gauge: &mut Gauge, unfinished: &Unfinished, error: &Error) -> Error {
        let (mut state, mut known) = (Keyhole::Silent, Worked::Neither);
        for _ in 0..RESTORES {
            state = self.open_again(gauge);
            match state {
                Keyhole::Open(Worked::Neither) => {}
                Keyhole::Open(worked) => known = worked,
                Keyhole::Shut(_) => break,
                Keyhole::Silent => continue,
            }
            let mut touched = 0;
            if self.put_back(gauge, unfinished, &mut touched).is_ok() {
                let what = "the old key was restored, and the gauge takes it".into();
                return Error::of("", Reason::RolledBack { failed: error.clone(), what });
            }
            if touched > 0 {
                known = Worked::Neither;
            }
            // A gauge that has just started stores nothing before it has measured its voltage.
            gauge.wait(MEASURED);
        }
        self.is_unknown = matches!((state, known), (Keyhole::Open(_), Worked::Neither));
        let KeyChange { name, new, .. } = self.change;
        let known = match (state, known) {
            (Keyhole::Open(_), Worked::Old) => {
                "the gauge took the old key, but what it keeps could not be put in order and tried again".to_string()
            }
            (Keyhole::Open(_), Worked::New) => {
                // Lets the daemon continue even if the key file has the old key.
                gauge.set_key(*name, new);
                "the gauge takes the new key, and the old one could not be restored".to_string()
            }
            (Keyhole::Open(_), Worked::Neither) => {
                "the gauge is open, but the old key could not be restored: which key it takes is unknown, so it is left \
                 open; do not cut its power and do not seal it"
                    .to_string()
            }
            (Keyhole::Shut(shut), _) if shut == *name => {
                "the gauge takes neither the old key nor the new one, nor a part of each, nor ffff ffff".to_string()
            }
            (Keyhole::Shut(shut), _) => {
                format!("the gauge takes neither its {} key, nor a part of it, nor ffff ffff", shut.as_str())
            }
            (Keyhole::Silent, _) => {
                "the gauge does not answer: it has the old key, the new one, a part of each, or ffff ffff".to_string()
            }
        };
        let way = way_out(&[*name]);
        let what = format!("{known}; this mount undoes the change when it can, as long as it runs; or {way}");
        Error::of("", Reason::KeyUnknown { failed: error.clone(), what })
    }

    /// Whether nobody may be able to open the gauge again once it is SEALED: what it keeps is no key that was tried.
    fn is_to_stay_open(&self, gauge: &mut Gauge) -> bool {
        self.is_unknown && gauge.seal() == Ok(Seal::FullAccess)
    }

    /// Puts the old keys back and tries them.
    fn put_back(&mut self, gauge: &mut Gauge, unfinished: &Unfinished, touched: &mut usize) -> Result<()> {
        sequence(gauge).enable(gauge)?;
        self.write(gauge, &unfinished.before, touched)?;
        self.prove(gauge, &unfinished.ring, unfinished.authentication.as_ref())?;
        SEALS.into_iter().for_each(|name| gauge.set_key(name, unfinished.ring.get(name)));
        gauge.set_key(self.change.name, &self.change.old);
        Ok(())
    }

    /// Undoes a change that this process has begun, now that the gauge may answer again.
    fn undo(
        &mut self,
        gauge: &mut Gauge,
        plan: &Plan,
        identities: [&Identity; 2],
        watched: bool,
        unfinished: &Unfinished,
        session: &mut Session,
    ) -> Result<Verdict> {
        let way = way_out(&[self.change.name]);
        match self.open_again(gauge) {
            Keyhole::Silent => {
                let why = "the gauge does not answer while its keys are tried";
                return Err(Error::new(gauge.chip.model, Cause::TimedOut, why).at(Step::Restore));
            }
            Keyhole::Shut(name) => {
                let name = name.as_str();
                return Ok(Verdict::Undecided(format!(
                    "a change of keys was cut short, and the gauge takes no {name} key that this mount knows, nor ffff \
                     ffff: it may be another pack; otherwise {way}"
                )));
            }
            Keyhole::Open(_) => {}
        }
        sequence(gauge).enable(gauge)?;
        match same_pack(gauge, identities, plan)? {
            Match::Other(name) => return Ok(Verdict::Undecided(another(&name))),
            Match::Weak if !watched => {
                return Ok(Verdict::Undecided(format!(
                    "a change of keys was cut short, and this gauge has the serial number and the calibration of every new \
                     one, so it may be another pack; if it is the one, {way}"
                )));
            }
            Match::Certain | Match::Weak => {}
        }
        if let Err(error) = self.put_back(gauge, unfinished, &mut 0) {
            self.is_unknown = true;
            if self.is_to_stay_open(gauge) {
                session.stays(Seal::FullAccess);
            }
            return Err(unrestored(error));
        }
        restore_rows(gauge, session, plan)?;
        let name = self.change.name.as_str();
        Ok(Verdict::Done(format!(
            "a change of the {name} key was interrupted; the old key was restored, and the gauge takes it"
        )))
    }

    /// Goes to FULL ACCESS with any key that works.
    fn open_again(&mut self, gauge: &mut Gauge) -> Keyhole {
        let limit = gauge.clock.now() + START;
        let now = loop {
            match gauge.seal() {
                Ok(now) => break now,
                Err(_) if gauge.may_try_until(limit) => gauge.wait(POLL_INTERVAL),
                Err(_) => return Keyhole::Silent,
            }
        };
        let Ok(ring) = self.ring(gauge) else { return Keyhole::Silent };
        let mut worked = Worked::Neither;
        for (name, key, goal, above) in ring.rungs(now) {
            if above {
                continue;
            }
            match self.find(gauge, name, key, goal) {
                Ok(Some(found)) if name == self.change.name => worked = self.which(&found),
                Ok(Some(_)) => {}
                Ok(None) => return Keyhole::Shut(name),
                Err(_) => return Keyhole::Silent,
            }
        }
        if self.change.name == Name::Authentication {
            for key in [&self.change.new, &self.change.old] {
                match self.challenge(gauge, key) {
                    Ok(true) => worked = self.which(key),
                    Ok(false) => {}
                    Err(_) => return Keyhole::Silent,
                }
            }
        }
        Keyhole::Open(worked)
    }

    fn which(&self, key: &Secret) -> Worked {
        match key {
            key if *key == self.change.old => Worked::Old,
            key if *key == self.change.new => Worked::New,
            _ => Worked::Neither,
        }
    }

    /// The key that leads to a seal state: the expected one, or what may be left of it.
    fn find(&mut self, gauge: &mut Gauge, name: Name, key: &Secret, goal: Seal) -> Result<Option<Secret>> {
        if gauge.takes(key, goal)? {
            self.erased |= key.is_erased() && name == self.change.name;
            return Ok(Some(key.clone()));
        }
        for candidate in self.candidates(name, key) {
            gauge.wait(gauge.chip.security.key_silence);
            if gauge.try_key(&candidate, goal)? {
                self.erased |= candidate.is_erased();
                return Ok(Some(candidate));
            }
        }
        Ok(None)
    }

    /// What may be in place of a key, the likelier first. Flash is programmed word by word, in ascending order, after the
    /// row was erased.
    fn candidates(&self, name: Name, key: &Secret) -> Vec<Secret> {
        let erased = Secret::from([ERASED; 2]);
        let is_changed = name == self.change.name;
        let mut found: Vec<Secret> = Vec::new();
        if is_changed {
            found.push(self.change.new.clone());
        }
        // Without anything that shows that the row was erased it would be a key that nobody has given.
        if self.torn || self.erased {
            found.push(erased);
        }
        if is_changed || self.torn {
            let new = if is_changed { self.change.new.words() } else { key.words() };
            let [first, second] = new;
            let [old_first, old_second] = key.words();
            found.extend(
                match self.block.order {
                    KeyOrder::Reversed => [[old_first, second], [ERASED, second]],
                    KeyOrder::AsSent => [[first, old_second], [first, ERASED]],
                }
                .map(Secret::from),
            );
            if self.torn {
                let words = [[old_first, first, ERASED], [old_second, second, ERASED]];
                for (first, second) in
                    words[0].into_iter().flat_map(|first| words[1].map(|second| (first, second)))
                {
                    found.push(Secret::from([first, second]));
                }
            }
        }
        if self.unordered {
            let keys = if is_changed { &self.change.new } else { key };
            found.extend(turned(keys));
        }
        let mut candidates: Vec<Secret> = Vec::with_capacity(found.len());
        for candidate in found {
            if candidate != *key && !candidates.contains(&candidate) {
                candidates.push(candidate);
            }
        }
        candidates
    }
}

fn neither() -> Error {
    let why = "the gauge has neither the old key nor the new one; nothing was changed";
    Error::new("", Cause::NotPermitted, why).at(Step::Check)
}

/// Restores what a loss of power has erased beside the keys.
fn restore_rows(gauge: &mut Gauge, session: &mut Session, plan: &Plan) -> Result<()> {
    if plan.blocks.is_empty() {
        return Ok(());
    }
    let seen = quietly(gauge, |gauge| look(gauge, plan))?;
    if seen.iter().any(|seen| seen.held == Held::Unexplained) && !session.decided {
        let why = "a row next to the keys has changed, which the change of keys does not touch";
        return Err(Error::new("", Cause::Protocol, why).at(Step::Restore));
    }
    let mut job = Job::interrupted(seen, false);
    if job.is_intact() {
        return Ok(());
    }
    // The keys that it took have shown that it is the one.
    session.pack.begin(gauge);
    gauge.learn_selection();
    quietly(gauge, |gauge| job.back(gauge, session, true))
}

/// Whether the gauge answers a random challenge as only this key does.
fn answers(gauge: &mut Gauge, key: &Secret, order: Order) -> Result<bool> {
    let mut challenge = [0; LENGTH];
    getrandom::fill(&mut challenge).map_err(|error| {
        Error::new("random numbers", Cause::Io(std::io::ErrorKind::Other), error.to_string())
    })?;
    let digest = authentication::answered(gauge, &challenge, order)?;
    let key = key.bytes().try_into().expect("an authentication key has 16 bytes");
    Ok(authentication::fits(key, &challenge, &digest, order).is_some())
}

/// A key in the other orders in which a gauge might keep it.
fn turned(key: &Secret) -> [Secret; 3] {
    let [a, b, c, d] = [0, 1, 2, 3].map(|at| key.bytes()[at]);
    [[c, d, a, b], [b, a, d, c], [d, c, b, a]].map(|bytes| Secret::of_bytes(&bytes))
}

/// Whether a key would look different in another order of bytes.
fn shows_order(key: &Secret) -> bool {
    !turned(key).contains(key)
}

/// Whether the words of a key may be sent although the gauge may not have it.
fn is_harmless(gauge: &Gauge, key: &Secret) -> bool {
    let is_command = |word: &u16| {
        *word < SUBCOMMANDS
            || gauge.chip.subcommands.iter().any(|subcommand| subcommand.code == *word)
            || gauge.chip.access.scheme.is_flat() && ADDRESSES.contains(word)
    };
    !key.words().iter().any(is_command)
}

/// Whether the gauge, whose data flash is open, is the one of a plan.
fn same_pack(gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan) -> Result<Match> {
    compare(gauge.chip, then, now, plan, |place| sequence(gauge).load(gauge, place))
}

fn another(name: &str) -> String {
    format!("{name} is not what it was when a change of keys was cut short: this is another pack")
}

/// What a person does about a change that was cut short.
pub(super) fn way_out(names: &[Name]) -> String {
    let commands: Vec<String> = names
        .iter()
        .map(|name| format!("gaugefs keys change GAUGE {} --key-file OLD --new-key-file NEW", name.as_str()))
        .collect();
    format!(
        "make the same change once more, with the same two keys ({}); to undo it, exchange the two files. Keys of the \
         mount's key file that were erased with it are put back, too",
        commands.join(", then ")
    )
}

/// What is told of keys that a change which is over otherwise has not put back.
fn still_lost(names: &[Name]) -> String {
    let names: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
    let name = names.join(" and ");
    format!(
        "a change of keys was cut short, and the {name} key may have been lost with it; put it back with gaugefs keys \
         change GAUGE {name} --key-file OLD --new-key-file NEW, where OLD has `authentication = {}` if it was erased, or \
         give it up: gaugefs settle GAUGE --discard",
        "f".repeat(2 * LENGTH_OF_KEY)
    )
}

/// Which of the keys that are known the gauge took.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Has {
    /// The mount's.
    Mine,
    Erased,
    Neither,
    /// It was not asked.
    Unknown,
}

/// Finds out which keys a gauge has on which another process has begun a change, with the keys of this one. Only reads,
/// but for what was erased beside the keys of what is certainly the same pack.
#[expect(clippy::too_many_arguments, reason = "all that is known of an interrupted change")]
fn probe(
    gauge: &mut Gauge,
    block: &KeyBlock,
    plan: &Plan,
    key: &KeyPlan,
    identities: [&Identity; 2],
    watched: bool,
    found: Seal,
    session: &mut Session,
) -> Result<Verdict> {
    let (erased, mut has, mut now) = (Secret::from([ERASED; 2]), [Has::Unknown; 2], found);
    for (at, (name, goal)) in
        [(Name::Unseal, Seal::Unsealed), (Name::FullAccess, Seal::FullAccess)].into_iter().enumerate()
    {
        if now != [Seal::Sealed, Seal::Unsealed][at] {
            continue;
        }
        let mine = gauge.key(name);
        has[at] = match &mine {
            Some(mine) if gauge.takes(mine, goal)? => {
                if mine.is_erased() && !key.erased.contains(&name) {
                    Has::Erased
                } else {
                    Has::Mine
                }
            }
            _ => {
                gauge.wait(gauge.chip.security.key_silence);
                if gauge.takes(&erased, goal)? { Has::Erased } else { Has::Neither }
            }
        };
        if has[at] == Has::Neither {
            break;
        }
        now = gauge.seal()?;
    }
    let (mut lost, mut same) = (None, Match::Weak);
    if now != Seal::Sealed {
        sequence(gauge).enable(gauge)?;
        same = same_pack(gauge, identities, plan)?;
        if let Match::Other(name) = &same {
            return Ok(Verdict::Undecided(another(name)));
        }
    }
    if now == Seal::FullAccess {
        let (place, start) = locate(block.subclass, block.start);
        let row = quietly(gauge, |gauge| sequence(gauge).load(gauge, place).map(Zeroizing::new))?;
        for (has, (name, at)) in
            has.iter_mut().zip([(Name::Unseal, block.unseal), (Name::FullAccess, block.full_access)])
        {
            let stored = unstored(&row[start + at..start + at + 4], block.order);
            *has = match gauge.key(name) {
                Some(mine) if mine == stored && (!stored.is_erased() || key.erased.contains(&name)) => {
                    Has::Mine
                }
                _ if stored.is_erased() => Has::Erased,
                _ => Has::Neither,
            };
        }
        lost = Some(
            match block
                .authentication
                .map(|at| Secret::of_bytes(&row[start + at..start + at + LENGTH_OF_KEY]))
            {
                None => Has::Mine,
                Some(stored) => match gauge.key(Name::Authentication) {
                    Some(mine) if mine == stored => Has::Mine,
                    _ if stored.has_erased_word() && !key.erased.contains(&Name::Authentication) => {
                        Has::Erased
                    }
                    _ if key.names.contains(&Name::Authentication) => Has::Unknown,
                    _ => Has::Mine,
                },
            },
        );
        if has == [Has::Mine; 2] && lost == Some(Has::Mine) {
            restore_rows(gauge, session, plan)?;
            let message = format!(
                "a change of the {} key was interrupted; the gauge has the keys of this mount",
                key.names()
            );
            return Ok(if same == Match::Certain || watched {
                Verdict::Done(message)
            } else {
                Verdict::Plausible(message)
            });
        }
        // What was begun is over, but for what was lost with it.
        let is_over = key.names.len() > 1 && key.names.contains(&Name::Authentication);
        if has == [Has::Mine; 2] && lost == Some(Has::Erased) && is_over {
            return Ok(Verdict::Undecided(still_lost(&[Name::Authentication])));
        }
        if found != Seal::Sealed && has.contains(&Has::Neither) {
            // Nobody knows whether it could be opened again.
            session.stays(now);
        }
    } else if now == Seal::Unsealed && found != Seal::Sealed {
        session.stays(now);
    }
    let tell = |name: Name, has: Has| {
        let what = match has {
            Has::Mine => "the mount's",
            Has::Erased => "ffff ffff (erased)",
            Has::Neither => "neither the mount's nor ffff ffff",
            Has::Unknown => "not known",
        };
        format!("{} key {what}", name.as_str())
    };
    let mut keys: Vec<String> = SEALS.into_iter().zip(has).map(|(name, has)| tell(name, has)).collect();
    if block.authentication.is_some() {
        keys.push(match lost {
            Some(Has::Erased) => "authentication key erased, in part or as a whole".into(),
            _ => tell(Name::Authentication, if lost == Some(Has::Mine) { Has::Mine } else { Has::Unknown })
                .replace("the mount's", "as it was"),
        });
    }
    let keep = match session.found {
        Seal::Sealed => "",
        _ if found != Seal::Sealed => "; do not cut its power and do not seal it before",
        _ => "",
    };
    Ok(Verdict::Undecided(format!(
        "a change of the {} key was cut short while it was written; the gauge has now: {}{keep}; {}",
        key.names(),
        keys.join(", "),
        way_out(&key.names)
    )))
}

/// A key of which a gauge keeps these bytes.
fn unstored(bytes: &[u8], order: KeyOrder) -> Secret {
    Secret::of_bytes(&stored(&Secret::of_bytes(bytes), order))
}

/// The line of the journal about the keys that are written.
fn keys_line(name: Name) -> String {
    format!("key {}\n", name.as_str())
}

/// What a gauge does that may have one key or another.
#[derive(Clone, Copy)]
enum Keyhole {
    /// It is in FULL ACCESS, and this was the key.
    Open(Worked),
    /// No key of that name fits.
    Shut(Name),
    /// It does not answer.
    Silent,
}

#[derive(Clone, Copy)]
enum Worked {
    Old,
    New,
    /// Neither was needed, or a mixture of both led there.
    Neither,
}
