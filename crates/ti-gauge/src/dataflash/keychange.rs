// SPDX-License-Identifier: MIT

//! Key changes: the only write to the Security subclass.
//!
//! A gauge whose key is lost cannot be recovered. The old key is proven by using it; the stored keys are compared with
//! those the gauge accepted, so the table's place and byte order are right; the block is read back while FULL ACCESS
//! still allows a correction; only then is the gauge sealed, and opened with the new key.
//!
//! Until the block is committed an error means that no key was changed. From then on the answer is success,
//! [`Cause::RolledBack`] (the old key was used) or [`Cause::StateUnknown`], which says what is known of the keys.
//!
//! A loss of power may leave each word of the block old, new or erased, also of other keys. The journal says how far a
//! change came, but has no key: a change that was cut short is settled by the process that still knows the keys, or when
//! somebody makes it once more with the same two keys. Until then nothing else is written.

use std::cell::OnceCell;
use std::fmt;
use std::time::Duration;

use zeroize::Zeroizing;

use super::DataFlash;
use super::io::COMMITTED;
use super::keyrow::quietly;
use super::pack::Match;
use super::planned;
use super::schemes::{Care, sequence};
use super::session::{Left, Patience, RESTORES, Session, report_mishap};
use super::verdict::Verdict;
use super::window::{Planned, Window, learned, locate};
use crate::authentication::Order;
use crate::chip::{FLAT, KeyBlock, KeyStorage};
use crate::codec::{Bytes, WINDOW};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal, Statistics};
use crate::journal::{Identity, KEYS_WRITTEN, KeyPlan, Plan};
use crate::keys::{KeyChange, Name, Secret, wipe_stack};

mod allowed;
mod back;
mod beside;
mod probe;
mod remedy;
mod ring;
mod row;
mod used;

use allowed::{block_of, check_new};
use beside::{restore_rows, same_pack};
use probe::probe;
use remedy::still_lost;
pub(super) use remedy::way_out;
use ring::{LENGTH_OF_KEY, Ring, SEALS, shows_order};

/// Time for the change, and again for undoing it, without the pauses that a gauge needs after a refused key.
const WAY: Duration = Duration::from_secs(8);
const SILENCES: u32 = 14;
/// Time that a gauge may take to restart before it answers.
const START: Duration = Duration::from_secs(3);

#[derive(Debug, Default)]
pub(super) struct Begun(Option<Unfinished>);

struct Unfinished {
    change: KeyChange,
    ring: Ring,
    /// The key that has to answer a challenge when the old keys are back.
    authentication: Option<Secret>,
    before: Zeroizing<[u8; WINDOW]>,
    order: Order,
}

impl fmt::Debug for Unfinished {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Unfinished { hidden }")
    }
}

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

impl Begun {
    pub(super) fn is_none(&self) -> bool {
        self.0.is_none()
    }

    pub(super) fn forget(&mut self) {
        self.0 = None;
    }

    fn row_before(&self) -> Option<&[u8; WINDOW]> {
        self.0.as_ref().map(|kept| &*kept.before)
    }

    /// What a gauge has of a change that was cut short, by using this process's keys. Writes only if this process began it.
    pub(super) fn settle(
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
        gauge.wait(COMMITTED);
        let found = gauge.seal()?;
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * SILENCES));
        let verdict = match self.0.take() {
            Some(unfinished) => {
                let mut task = Task::new(gauge, block, &unfinished.change, unfinished.order, found);
                task.torn = true;
                task.mine = SEALS.map(|name| Some(unfinished.ring.get(name).clone()));
                let verdict = task.undo(gauge, plan, identities, watched, &unfinished, session);
                if !matches!(verdict, Ok(Verdict::Done(_))) {
                    self.0 = Some(unfinished);
                }
                verdict
            }
            None => probe(gauge, block, plan, key, identities, watched, found, session),
        };
        wipe_stack();
        verdict
    }
}

pub(super) fn change(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    change: &KeyChange,
    order: Order,
    waited: Duration,
) -> Result<()> {
    let name = change.name.as_str();
    let outcome = prepare(flash, gauge, change, waited).and_then(|(block, left, waited)| {
        let before = Statistics::read(&gauge.statistics.flash_writes);
        let outcome = change_unnamed(flash, gauge, (block, change, order), left, waited);
        flash.rules.count(gauge, before);
        report_mishap(gauge, outcome)
    });
    gauge.limit(None);
    wipe_stack();
    flash.noted(outcome).map_err(|error| error.within(&format!("{name} key")))
}

/// Refuses what may not be changed, and settles all but a key change that was cut short, which is returned.
fn prepare(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    change: &KeyChange,
    waited: Duration,
) -> Result<(&'static KeyBlock, Option<Plan>, Duration)> {
    let block = block_of(gauge.chip, change.name)?;
    gauge.check_writes()?;
    check_new(gauge, change)?;
    // Making a change once more settles it, if it was cut short.
    let left = pending_keys(flash);
    let waited = match left {
        Some(_) => waited,
        None => flash.settle_first(gauge, waited)?,
    };
    Ok((block, left, waited))
}

fn change_unnamed(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    (block, change, order): (&KeyBlock, &KeyChange, Order),
    left: Option<Plan>,
    waited: Duration,
) -> Result<()> {
    let asked = gauge.clock.now().saturating_sub(waited);
    gauge.limit(Some((WAY + gauge.chip.security.key_silence * SILENCES).saturating_sub(waited)));
    gauge.claim()?;
    let found = flash.knowledge.preflight(gauge, &[])?;
    let mut session = Session::new(found.seal, asked);
    session.pack.begin(gauge);
    match &left {
        Some(_) => flash.adopt(gauge, &mut session)?,
        None => flash.owe(gauge, &mut session, 0, None)?,
    }
    session.patience =
        Some(Patience { silence: START, refusals: WAY + gauge.chip.security.key_silence * 2 * RESTORES });
    let mut task = Task::new(gauge, block, change, order, found.seal);
    task.torn = left.is_some();
    let known = OnceCell::new();
    let run = |this: &mut DataFlash, gauge: &mut Gauge, session: &mut Session| {
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
    flash.guard(gauge, session, run, |this, mut session, gauge, outcome, owed| {
        let lost = known.get().cloned().flatten();
        match owed {
            Some(owed) if owed.data => this.leave(gauge, session, owed),
            // A change that was cut short before is as it was.
            _ if left.is_some() && lost.is_none() => {}
            owed => {
                this.debts.settled();
                this.unfinished.forget();
                let lost = lost.unwrap_or_default();
                if !lost.is_empty() {
                    for &name in &lost {
                        session.note_keys(|key| key.begin(name), &keys_line(name));
                    }
                    let why = still_lost(&lost);
                    log::warn!("{}: {why}", gauge.chip.name);
                    this.leave(gauge, session, Left::of(true, why));
                    this.debts.leave_to_person();
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

fn pending_keys(flash: &mut DataFlash) -> Option<Plan> {
    let plan = flash.find_pending()?.plan()?;
    plan.key.as_ref().filter(|key| !key.is_over())?;
    Some(plan)
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
        let left = session.entry.as_ref().and_then(|entry| entry.plan.clone());
        self.check_open(dataflash, gauge, voltage_mv, session)?;
        let before = self.read(gauge)?;
        let ring = self.ring_of(&before, taken)?;
        let held = match name {
            Name::Authentication => self.held_authentication(gauge, &before)?,
            _ => ring.get(*name).clone(),
        };
        let key = left.as_ref().and_then(|plan| plan.key.as_ref());
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
        dataflash.knowledge.refer(gauge, session);
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
        let unfinished = Unfinished {
            change: self.change.clone(),
            ring: before_ring,
            authentication: proof(old),
            before: back,
            order: self.order,
        };
        Err(self.give_up(dataflash, gauge, session, unfinished, &error))
    }

    fn check_open(
        &self,
        dataflash: &mut DataFlash,
        gauge: &mut Gauge,
        voltage_mv: u16,
        session: &mut Session,
    ) -> Result<()> {
        sequence(gauge).enable(gauge)?;
        if let Some(row) = dataflash.knowledge.learn_marks(gauge)? {
            return Err(dataflash.knowledge.other_pack(gauge, row));
        }
        let left =
            session.entry.as_ref().and_then(|entry| Some((entry.identity.clone(), entry.plan.clone()?)));
        if let Some((then, plan)) = &left {
            let now = dataflash.knowledge.identity(gauge)?;
            self.check_pack(gauge, [then, &now], plan)?;
            // What shows that the table fits may have been erased with the keys. It was checked before.
            restore_rows(gauge, session, plan)?;
        }
        dataflash.knowledge.check_signature(gauge)?;
        dataflash.knowledge.check_gate(gauge, voltage_mv)
    }

    fn give_up(
        &mut self,
        dataflash: &mut DataFlash,
        gauge: &mut Gauge,
        session: &mut Session,
        unfinished: Unfinished,
        failed: &Error,
    ) -> Error {
        let name = self.change.name;
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * SILENCES));
        self.torn = true;
        session.note_keys(|key| key.begin(name), &keys_line(name));
        let mut error = self.back(gauge, &unfinished, failed);
        if matches!(error.cause(), Cause::RolledBack)
            && let Some(plan) = session.entry.as_ref().and_then(|entry| entry.plan.clone())
            && let Err(second) = restore_rows(gauge, session, &plan)
        {
            error = Error::of("", Reason::KeyUnknown { failed: error, what: format!("but {second}") });
        }
        dataflash.unfinished.0 = Some(unfinished);
        error
    }

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

    /// Records which key is about to be written, and what is beside the keys in their row and the rows next to it.
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
                    false => quietly(gauge, |gauge| sequence(gauge).load(gauge, place, Care::Sure))?,
                };
                let learned = learned(gauge.chip, place);
                rows.push(Planned { place, old: content, new: content, written: Bytes::default(), learned });
            }
        }
        let marks = dataflash.knowledge.known().marks(gauge.chip);
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
}

fn keys_line(name: Name) -> String {
    format!("key {}\n", name.as_str())
}
