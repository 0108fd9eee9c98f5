// SPDX-License-Identifier: MIT

//! Data flash transactions: the only way to read or write data flash.
//!
//! A write is one transaction: check wear, identity and state of the gauge (`preflight`), unseal and confirm, check the
//! flash voltage, read each block with its checksum, stop if nothing changes, write, commit with a checksum, read back,
//! reset if the table requires it, unseal and verify again, restore the seal state and confirm it. Every exit goes
//! through `Session::close`. The gauge accepts any value it is sent, so the checks here are the only protection.
//!
//! An error before the first block is committed means that nothing has changed. After that the result is
//! success, [`Cause::RolledBack`] (the old bytes were restored and verified) or [`Cause::StateUnknown`]. What is
//! then left to do, a seal or a write that is neither done nor undone, is owed: [`DataFlash::settle`] tries again,
//! and nothing else is written until it has succeeded or a person has decided ([`DataFlash::decide`]).
//!
//! The rules of every way back: a block is believed when two looks at it agree, some time apart; only what is
//! certain is undone; the journal stays until the outcome has been read back; in doubt nothing is touched.

use std::fmt;
use std::time::Duration;

use crate::authentication::Order;
use crate::chip::{Chip, FLAT, Kind, Source, Subclass};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Answers, Gauge, Moment, Phase, Seal};
use crate::journal::{Entry, Journal};
use crate::keys::KeyChange;

mod anonymous;
mod blocks;
mod calmode;
mod change;
mod checks;
mod debts;
mod erased;
mod guard;
mod identity;
mod io;
mod job;
mod keychange;
mod keyrow;
mod knowledge;
mod measured;
mod pack;
mod part;
mod planned;
mod records;
mod rules;
mod schemes;
mod sealed;
mod session;
mod settle;
mod state;
mod verdict;
mod window;

pub use anonymous::{anonymous, sample, samples};
use blocks::{blocks, gather, old_bytes};
pub use change::{Change, Row};
use checks::{check_now, check_safe};
use debts::Debts;
pub use debts::Owed;
use erased::erased_in;
pub use erased::{erased, erased_since, says_erased};
use guard::Record;
use job::{Job, Landed, Side, converge};
use keychange::Begun;
use knowledge::{Found, Knowledge, check_unsealed, learning};
pub(crate) use measured::{BEGINS, accept_measured, assure_same, expect_measured, undo_measured};
pub use pack::distinguishes;
pub use part::Part;
use records::Records;
use rules::Rules;
pub use rules::{Limits, WRITES_PER_HOUR};
use schemes::{Care, sequence};
use session::Session;
pub use settle::Decision;
use settle::search_waiting;
use state::Copied;
pub use state::has_lost_memory;
pub(crate) use state::{read_bits, read_word};
use window::{Planned, Window, learned};

/// A place in data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Subclass id, or [`FLAT`].
    pub subclass: u8,
    /// Offset in the subclass, or address.
    pub offset: u16,
}

/// Result of a successful write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Data flash already held the values: nothing was programmed and the gauge was not reset.
    Unchanged,
    /// Written and verified; the gauge was reset if `reset`.
    Written {
        /// Whether the gauge was reset.
        reset: bool,
        /// For each change, the bytes that it replaced.
        old: Vec<Vec<u8>>,
    },
}

/// Times that a block is loaded that is not as it was last seen.
const LOADS: u32 = 3;

/// State that is kept between transactions on one gauge.
#[derive(Debug, Default)]
pub struct DataFlash {
    rules: Rules,
    records: Records,
    knowledge: Knowledge,
    debts: Debts,
    /// A change of keys that is neither done nor undone, with the keys, for as long as this process runs.
    unfinished: Begun,
}

impl DataFlash {
    /// Starts with no knowledge of the gauge. With a journal, writes survive a power cut of the host.
    pub fn new(limits: Limits, journal: Option<Journal>) -> Self {
        Self { rules: Rules::new(limits), records: Records::new(journal), ..Self::default() }
    }

    /// Leaves nothing on disk that only makes the next write faster.
    pub fn tidy_up(&mut self) {
        if let Some(journal) = self.records.journal() {
            journal.remove_spare();
        }
    }

    /// Forgets what was read from data flash: the gauge has lost it, or is another one.
    pub fn forget(&mut self) {
        self.knowledge.forget_pack();
    }

    /// Forgets all but what distinguishes the pack, to be compared when data flash is next open: it may be another one.
    pub fn suspect(&mut self, chip: &'static Chip) {
        self.knowledge.suspect(chip);
    }

    /// Compares the pack with the suspected one, if the gauge is open. See [`Self::doubts`].
    pub fn compare(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.knowledge.compare(gauge)
    }

    /// Notes a gauge that was connected, or has returned, with its answers; its values are read again.
    pub fn meet(&mut self, chip: &Chip, answers: &Answers) {
        self.knowledge.meet(chip, answers);
        self.debts.look_again();
    }

    /// Whether another gauge has answered instead of the one whose values were read.
    pub fn doubts(&self) -> bool {
        self.knowledge.doubts()
    }

    /// The gauge has answered otherwise than when it was identified.
    pub fn doubt_pack(&mut self) {
        self.knowledge.doubt_pack();
    }

    /// Whether a poll shows another pack or count of cycles, and has to be repeated: I2C has no error detection.
    pub fn needs_second_poll(&self, chip: &Chip, value: impl Fn(Source) -> Option<u32>) -> bool {
        self.knowledge.needs_second_poll(chip, value)
    }

    /// Whether a poll's flags report a loss of data memory, or its end, which a second look does not confirm.
    pub fn misreads_loss(&self, gauge: &mut Gauge, value: impl Fn(Source) -> Option<u32>) -> Result<bool> {
        self.knowledge.misreads_loss(gauge, value)
    }

    /// The register of a poll that contradicts what is known of the pack, by its name; `value` returns what is read there.
    pub fn contradicted(&self, chip: &Chip, value: impl Fn(Source) -> Option<u32>) -> Option<&'static str> {
        self.knowledge.contradicted(chip, value)
    }

    /// Notes a poll; `value` returns what is read there. Returns whether another pack answers now.
    pub fn polled(&mut self, chip: &Chip, value: impl Fn(Source) -> Option<u32>) -> bool {
        self.knowledge.polled(chip, value)
    }

    /// Forgets everything, after an access that was not brought to its end. What it has left is found in the journal.
    pub fn start_over(&mut self) {
        let Self { rules, records, .. } = std::mem::take(self);
        *self = Self { rules, records: records.anew(), ..Self::default() };
    }

    /// Reads whole subclasses in one session. `waited` is the time since the request was made.
    pub fn read(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[&'static Subclass],
        waited: Duration,
    ) -> Result<Vec<Vec<u8>>> {
        self.read_parts(gauge, &whole(wanted), waited)
    }

    /// Reads parts of subclasses in one session.
    pub fn read_parts(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[Part],
        waited: Duration,
    ) -> Result<Vec<Vec<u8>>> {
        let read = self.read_found(gauge, wanted, waited, |_| true);
        read.map(Option::unwrap_or_default)
    }

    /// Reads what distinguishes the pack, unless that is known. A gauge with RAM reports what an exchange is to it.
    pub fn learn_pack(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<()> {
        let windows = pack::mark_windows(gauge.chip);
        if gauge.chip.volatile.is_some()
            || windows.iter().all(|place| self.knowledge.known().get(*place).is_some())
        {
            return Ok(());
        }
        self.read(gauge, &[], waited).map(drop)
    }

    /// Reads whole subclasses of a gauge that is open. `None` from one that is sealed: it is left alone.
    pub fn read_if_open(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[&'static Subclass],
    ) -> Result<Option<Vec<Vec<u8>>>> {
        self.read_found(gauge, &whole(wanted), Duration::ZERO, |found| found != Seal::Sealed)
    }

    fn read_found(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[Part],
        waited: Duration,
        allowed: impl Fn(Seal) -> bool,
    ) -> Result<Option<Vec<Vec<u8>>>> {
        let begun = gauge.clock.now();
        if !allowed(Seal::Sealed) && gauge.seal_anew()? == Seal::Sealed {
            return Ok(None);
        }
        search_waiting(self, gauge, waited);
        let waited = waited + (gauge.clock.now() - begun);
        let outcome = self.access(gauge, waited, |this, gauge, asked| {
            let found = gauge.seal_anew()?;
            if !allowed(found) {
                return Ok(None);
            }
            if found == Seal::Sealed
                && let Some(Ok(read)) = sealed::read(gauge, wanted)
            {
                return Ok(Some(read));
            }
            let session = this.recorded(gauge, found, asked, Record::Read)?;
            let run = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
                this.read_open(gauge, wanted, session)
            };
            this.guard(gauge, session, run, Self::end).map(Some)
        });
        self.noted(outcome)
    }

    fn read_open(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[Part],
        session: &mut Session,
    ) -> Result<Vec<Vec<u8>>> {
        session.open(gauge)?;
        let is_broken = !session.pack.since().is_some_and(|since| gauge.is_unbroken_since(since));
        if is_broken {
            self.knowledge.suspect(gauge.chip);
        }
        let mut known = self.knowledge.unread_marks(gauge.chip);
        // Marks for later comparison. Failing to read them must not fail the read.
        match self.knowledge.learn_marks(gauge) {
            Ok(Some(row)) if is_broken => {
                session.pack.mark_exchanged();
                return Err(self.knowledge.other_pack(gauge, row));
            }
            Ok(_) => {}
            Err(error) => log::debug!("{}: {error}", gauge.chip.name),
        }
        self.knowledge.refer(gauge, session);
        let mut read = Vec::with_capacity(wanted.len());
        for part in wanted {
            read.push(self.knowledge.read_part(gauge, part, &mut known)?.0);
        }
        self.knowledge.take_gate(gauge.chip, wanted);
        gauge.note_open();
        Ok(read)
    }

    /// Forgets the gate's values after any failure: the next write reads them again.
    fn noted<T>(&mut self, outcome: Result<T>) -> Result<T> {
        outcome.inspect_err(|_| self.knowledge.forget_values())
    }

    /// Changes the seal state on request.
    pub fn go_to(&mut self, gauge: &mut Gauge, goal: Seal, waited: Duration) -> Result<()> {
        let outcome = self.access(gauge, waited, |this, gauge, _| {
            gauge.go_to(goal)?;
            this.seal_was_chosen(goal);
            if goal == Seal::Sealed {
                return Ok(());
            }
            sequence(gauge).enable(gauge)
        });
        self.noted(outcome)
    }

    /// Changes a key. `waited` is the time since the request was made.
    pub fn change_key(
        &mut self,
        gauge: &mut Gauge,
        change: &KeyChange,
        order: Order,
        waited: Duration,
    ) -> Result<()> {
        keychange::change(self, gauge, change, order, waited)
    }

    /// Makes all changes, or none, in one transaction.
    pub fn write(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<Outcome> {
        self.write_with(gauge, changes, WriteOptions::default(), waited)
    }

    /// Writes after reading subclasses in the same session: nothing is written unless `first` takes what they hold.
    pub fn write_after(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        first: First<'_>,
        waited: Duration,
    ) -> Result<Outcome> {
        let options = WriteOptions { first: Some(first), ..WriteOptions::default() };
        self.write_with(gauge, changes, options, waited)
    }

    /// Makes every check of a write, with the gauge unsealed meanwhile, and programs nothing.
    pub fn try_write(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<()> {
        self.write_with(gauge, changes, WriteOptions { only_check: true, ..WriteOptions::default() }, waited)
            .map(drop)
    }

    /// Writes a saved configuration again to a gauge whose data memory is RAM and was lost, as `lost`, its flag, or a value
    /// that it does not rewrite itself shows. Otherwise nothing is written, and what it has learned stays. Quick where a
    /// doubt costs no more than a second look: what is stored there does not outlive the next brown-out.
    pub fn restore(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        lost: bool,
        waited: Duration,
    ) -> Result<Outcome> {
        if gauge.chip.volatile.is_none() {
            let why = "its data memory is flash, and nothing of it is lost with the power";
            return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Check));
        }
        // Whichever gauge it was begun on: nothing of it outlives the memory, and all of it is written now.
        if let Some(pending) = self.find_pending().filter(|pending| pending.is_written_again(changes)) {
            if pending.plan().is_some_and(|plan| plan.is_part_of(changes)) {
                self.withdraw(gauge, pending, waited)?;
            } else {
                let told = self.decide(gauge, Decision::Discard, waited)?;
                log::warn!("{}: {told}", gauge.chip.name);
            }
        }
        let outcome = self.write_with(
            gauge,
            changes,
            WriteOptions { care: Care::Quick, lost, ..WriteOptions::default() },
            waited,
        )?;
        self.drop_restorations(changes);
        Ok(outcome)
    }

    /// Removes interrupted restorations at this place: each loss begins a new one, and there would be more and more.
    fn drop_restorations(&mut self, changes: &[Change]) {
        let Some(journal) = self.records.journal() else { return };
        let is_over = |entry: &Entry| entry.plan.as_ref().is_some_and(|plan| plan.is_part_of(changes));
        let dropped = journal.waiting().and_then(|waiting| {
            let mut over = waiting.into_iter().filter(|(_, entry)| is_over(entry));
            over.try_for_each(|(path, _)| journal.withdraw(&path))
        });
        if let Err(error) = dropped {
            log::warn!("{error}");
        }
    }

    /// Makes all changes, or none, with what a calibration needs besides.
    pub(crate) fn write_with(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        options: WriteOptions<'_>,
        waited: Duration,
    ) -> Result<Outcome> {
        let allowed = gauge.check_writes().and_then(|()| self.rules.check_wear(gauge));
        let waited = allowed.and_then(|()| self.settle_first(gauge, waited));
        let outcome = waited.and_then(|waited| {
            self.access(gauge, waited, |this, gauge, asked| {
                let found = this.look_before(gauge, changes)?;
                let record = match options.care {
                    Care::Sure => Record::Write(changes),
                    Care::Quick => Record::Restoration(blocks(changes)),
                };
                let session = this.recorded(gauge, found.seal, asked, record)?;
                let run = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
                    this.change(gauge, changes, found, options, session)
                };
                this.guard(gauge, session, run, Self::end).and_then(|written| still_written(gauge, written))
            })
        });
        let outcome = self.noted(outcome);
        self.knowledge.learn_from(gauge, changes, &outcome);
        gauge.statistics.progress.end();
        match changes {
            [change] => {
                outcome.map_err(|error| error.within(&change.subject()).at_place(change.place().into()))
            }
            _ => outcome,
        }
    }

    /// Settles an interrupted write. Then the gauge must be the one that was read, in no mode that forbids writing.
    pub(crate) fn ready(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<()> {
        gauge.check_writes()?;
        let waited = self.settle_first(gauge, waited)?;
        self.access(gauge, waited, |this, gauge, _| {
            gauge.claim()?;
            this.knowledge.preflight(gauge, &[]).map(drop)
        })
    }

    /// Leaves calibration mode, even if another program has entered it, and restores the seal state. Returns whether it was on.
    pub(crate) fn leave_calibration(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<bool> {
        let Some(calibration) = gauge.chip.calibration else { return Ok(false) };
        let waited = self.settle_first(gauge, waited)?;
        self.access(gauge, waited, |this, gauge, asked| {
            gauge.claim()?;
            let found = gauge.seal_anew()?;
            let session = this.recorded(gauge, found, asked, Record::Change(0))?;
            let run = |this: &mut Self, gauge: &mut Gauge, session: &mut Session| {
                session.now = None;
                let left = calmode::leave(gauge, calibration);
                this.knowledge.left_calibration(left.is_err());
                left
            };
            this.guard(gauge, session, run, Self::end)
        })
    }

    /// Makes the checks that need no unsealed gauge. A gauge that was found sealed is opened by its second look.
    fn look_before(&mut self, gauge: &mut Gauge, changes: &[Change]) -> Result<Found> {
        gauge.claim()?;
        let mut found = self.knowledge.first_look(gauge, changes)?;
        if found.seal != Seal::Sealed {
            found = self.knowledge.next_look(gauge, &found, changes)?;
        }
        self.knowledge.check_key(gauge, found.seal, changes)?;
        Ok(found)
    }

    fn change(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: Found,
        options: WriteOptions<'_>,
        session: &mut Session,
    ) -> Result<Outcome> {
        let opened = match found.seal {
            Seal::Sealed => self.knowledge.look_while_opening(gauge, session, &found, changes),
            Seal::Unsealed | Seal::FullAccess => session.open(gauge).map(|()| found),
        };
        let outcome = opened.and_then(|found| self.change_open(gauge, changes, &found, options, session));
        if outcome.is_err() && self.doubts() {
            session.pack.mark_exchanged();
        }
        outcome
    }

    fn change_open(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: &Found,
        mut options: WriteOptions<'_>,
        session: &mut Session,
    ) -> Result<Outcome> {
        options.since.map_or(Ok(()), |since| assure_same(gauge, since))?;
        if !gauge.is_unbroken_since(found.moment) {
            self.confirm_anew(gauge, changes, found)?;
            session.pack.begin(gauge);
        }
        self.knowledge.check_signature(gauge)?;
        let found = &match options.first.take() {
            None => *found,
            Some(first) => {
                self.read_first(gauge, first, session)?;
                // What was found is from before, and some seconds old on a slow bus.
                self.knowledge.look_again(gauge, found, changes)?
            }
        };
        if options.calibrate {
            session.enter_calibration(gauge)?;
        }
        let learning = self.check_open(gauge, changes, found, &options)?;
        let Some(Prepared { planned, old, in_window }) = self.plan_blocks(gauge, changes, found, &options)?
        else {
            return Ok(Outcome::Unchanged);
        };
        self.rules.check_learning(gauge, learning)?;
        if options.only_check {
            return Ok(Outcome::Unchanged);
        }
        let reset = needs_reset(gauge.chip, changes);
        let mut job = self.record_plan(gauge, session, planned, reset, options.care)?;
        gauge.statistics.progress.begin(Phase::Committing, job.changed().count(), gauge.clock.now());
        (job.in_window, job.was_lost, job.care) = (in_window, found.lost, options.care);
        job.copied = Copied::of(gauge.chip, changes, &old);
        session.stays_open = options.is_restoration() && found.lost && found.seal != Seal::Sealed;
        let landed = converge(gauge, session, &mut job, Side::New, options.accept);
        for block in job.changed() {
            match landed {
                Landed::There => self.knowledge.note_block(gauge, block.place, block.new),
                Landed::Back(_) | Landed::Unknown(_) => self.knowledge.forget_block(block.place),
            }
        }
        match landed {
            Landed::There => Ok(Outcome::Written { reset, old }),
            Landed::Back(error) | Landed::Unknown(error) => Err(error),
        }
    }

    fn read_first(&mut self, gauge: &mut Gauge, first: First<'_>, session: &mut Session) -> Result<()> {
        let mut known = self.knowledge.unread_marks(gauge.chip);
        if let Some(row) = self.knowledge.learn_marks(gauge)? {
            return Err(self.knowledge.other_pack(gauge, row));
        }
        self.knowledge.refer(gauge, session);
        let wanted = whole(first.wanted);
        let count = wanted.iter().map(Part::blocks).sum();
        gauge.statistics.progress.begin(Phase::Saving, count, gauge.clock.now());
        let mut read = Vec::with_capacity(wanted.len());
        for part in &wanted {
            let (bytes, other) = self.knowledge.read_part(gauge, part, &mut known)?;
            if let Some(row) = other {
                return Err(self.knowledge.other_pack(gauge, row));
            }
            read.push(bytes);
        }
        self.knowledge.take_gate(gauge.chip, &wanted);
        (first.take)(read)
    }

    /// Confirms a gauge that may have been exchanged since it was confirmed. Nothing was written yet.
    fn confirm_anew(&mut self, gauge: &mut Gauge, changes: &[Change], found: &Found) -> Result<()> {
        if found.seal == Seal::Sealed && !gauge.was_opened() && !self.knowledge.is_certain(gauge)? {
            let why = "it was away for a moment after it was unsealed; nothing was written, try again";
            return Err(Error::new(gauge.chip.model, Cause::NotNow, why).at(Step::Check));
        }
        // The reset that this write needs may seal it.
        self.knowledge.check_key(gauge, found.seal, changes)?;
        self.knowledge.suspect(gauge.chip);
        self.knowledge.confirm(gauge)
    }

    /// The checks that need none of the blocks. Returns why a write with a reset waits for the end of a learning cycle.
    fn check_open(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: &Found,
        options: &WriteOptions<'_>,
    ) -> Result<Option<Error>> {
        self.knowledge.check_gate(gauge, found.voltage_mv)?;
        check_unsealed(gauge)?;
        let learning = learning(gauge, found.status, changes)?;
        // What a pack is known by is lost with its memory.
        if !(options.is_restoration() && found.lost)
            && let Some(row) = self.knowledge.learn_marks(gauge)?
        {
            return Err(self.knowledge.other_pack(gauge, row));
        }
        Ok(learning)
    }

    /// Reads the blocks and checks what the changes make of them. `None` if nothing is to be written.
    fn plan_blocks(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: &Found,
        options: &WriteOptions<'_>,
    ) -> Result<Option<Prepared>> {
        let is_restoration = options.is_restoration();
        let known = self.knowledge.known();
        let mut planned = gather(gauge, changes, |gauge, place| match options.care {
            Care::Quick => sequence(gauge).load(gauge, place, Care::Quick),
            Care::Sure => load_as_seen(gauge, place, known.get(place)),
        })?;
        planned.iter().try_for_each(|block| self.knowledge.recognise(gauge, block.place, &block.old))?;
        gauge.note_open();
        // The window holds the block that was read last, so a single block need not be loaded again.
        let in_window = planned.len() == 1 && !sequence(gauge).always_finishes() && !is_restoration;
        for change in changes {
            check_safe(gauge.chip, change, &planned)?;
            check_now(gauge, change, &planned)?;
        }
        let old: Vec<_> = changes.iter().map(|change| old_bytes(change, &planned)).collect();
        if is_restoration && !options.lost && !found.lost && !is_forgotten(gauge.chip, changes, &old) {
            return Ok(None);
        }
        planned.retain(|block| block.old != block.new);
        // The flag of a loss is cleared by the end of CONFIG UPDATE only, and would hide the next one.
        if planned.is_empty() && !(is_restoration && found.lost) {
            return Ok(None);
        }
        for block in &planned {
            let lost = erased_in(gauge.chip, block.place, &block.new);
            if !lost.is_empty() {
                return Err(says_erased(&lost, "").at(Step::Check));
            }
        }
        let loaded = self.knowledge.check_gate_after(gauge, changes, &mut planned, found.voltage_mv)?;
        Ok(Some(Prepared { planned, old, in_window: in_window && !loaded }))
    }

    fn record_plan(
        &mut self,
        gauge: &mut Gauge,
        session: &mut Session,
        mut planned: Vec<Planned>,
        reset: bool,
        care: Care,
    ) -> Result<Job> {
        if care == Care::Sure {
            planned.iter_mut().for_each(|block| session.keep_open(gauge.chip, block));
        }
        // A loss of power takes all of RAM, and disturbs no row beside the one that is written.
        let neighbours = match care {
            Care::Quick => Vec::new(),
            Care::Sure => self.knowledge.neighbours(gauge, &planned)?,
        };
        let marks = self.knowledge.known().marks(gauge.chip);
        let plan = planned::plan(gauge, reset, &planned, &neighbours, marks);
        if let Err(error) = self.note(session, plan.clone()) {
            match care {
                Care::Quick => self.records.go_on_without(gauge, Err(error))?,
                Care::Sure => return Err(error),
            }
            session.remove_journal();
            self.note(session, plan)?;
        }
        self.knowledge.refer(gauge, session);
        // The write may change the serial number.
        self.knowledge.forget_name();
        Ok(Job::write(planned, neighbours, reset))
    }
}

struct Prepared {
    planned: Vec<Planned>,
    /// For each change, the bytes that it replaces.
    old: Vec<Vec<u8>>,
    in_window: bool,
}

/// Loads a block to which a write may have to go back, until it is as it was last seen: the sum of one run of wrong bytes
/// in 256 is right. What moves by itself, although no table says so, is believed in the end.
fn load_as_seen(gauge: &mut Gauge, place: Window, mut before: Option<[u8; WINDOW]>) -> Result<[u8; WINDOW]> {
    let moving = learned(gauge.chip, place);
    for _ in 1..LOADS {
        let now = sequence(gauge).load(gauge, place, Care::Sure)?;
        let is_same = |before: [u8; WINDOW]| (0..WINDOW).all(|at| moving.has(at) || before[at] == now[at]);
        if before.is_none_or(is_same) {
            return Ok(now);
        }
        before = Some(now);
    }
    sequence(gauge).load(gauge, place, Care::Sure)
}

fn needs_reset(chip: &Chip, changes: &[Change]) -> bool {
    changes.iter().any(|change| change.kind(chip) == Kind::Reset)
}

fn whole(wanted: &[&'static Subclass]) -> Vec<Part> {
    wanted.iter().map(|subclass| Part::whole(subclass)).collect()
}

fn still_written(gauge: &mut Gauge, outcome: Outcome) -> Result<Outcome> {
    if matches!(outcome, Outcome::Written { .. }) && has_lost_memory(gauge) != Ok(false) {
        let why = "written and verified, but the gauge has lost its power since, or does not answer: its data memory may be \
                   lost";
        return Err(Error::new("", Cause::StateUnknown, why));
    }
    Ok(outcome)
}

/// Whether RAM without a flag of loss holds the part's defaults in place of these values. On a part without the flag they
/// are in one-time programmable memory, so any other value counts there. What the gauge rewrites itself shows nothing.
fn is_forgotten(chip: &Chip, changes: &[Change], old: &[Vec<u8>]) -> bool {
    let differs =
        |(change, old): &(&Change, &Vec<u8>)| !change.is_learned() && change.stored_over(old) != **old;
    let differing: Vec<_> = changes.iter().zip(old).filter(differs).collect();
    let others: Vec<_> = differing.iter().filter(|(change, old)| !change.is_default(old)).collect();
    if chip.volatile == Some(0) || others.is_empty() {
        return !differing.is_empty();
    }
    let names: Vec<String> = others.iter().map(|(change, _)| change.name()).collect();
    log::warn!(
        "{}: the gauge differs from its profile, and has not lost its memory: {}; write the profile with gaugefs import, or \
         take the values over with gaugefs export",
        chip.name,
        names.join(", ")
    );
    false
}

pub(crate) type Accept<'a> = &'a mut dyn FnMut(&mut Gauge) -> Result<()>;

/// What is read in the session of a write before anything is written.
pub struct First<'a> {
    /// The subclasses that are read.
    pub wanted: &'a [&'static Subclass],
    /// Gets their bytes. Nothing is written after an error.
    pub take: &'a mut dyn FnMut(Vec<Vec<u8>>) -> Result<()>,
}

/// What a write does besides, or otherwise.
#[derive(Default)]
pub(crate) struct WriteOptions<'a> {
    /// [`Care::Quick`] if the configuration of a gauge with RAM is written again: see [`DataFlash::restore`].
    pub(crate) care: Care,
    pub(crate) lost: bool,
    /// Enter calibration mode first, in which the gauge ignores its gate, and leave it before the reset.
    pub(crate) calibrate: bool,
    /// After the reset: if this fails, the old values go back. The write has to need a reset.
    pub(crate) accept: Option<Accept<'a>>,
    pub(crate) first: Option<First<'a>>,
    pub(crate) only_check: bool,
    /// What is written was measured on the gauge that has answered since then, and is for no other one.
    pub(crate) since: Option<Moment>,
}

impl WriteOptions<'_> {
    fn is_restoration(&self) -> bool {
        self.care == Care::Quick
    }
}

impl Place {
    /// Where a parameter is.
    pub fn of((subclass, parameter): Row) -> Self {
        Self { subclass: subclass.id, offset: parameter.offset }
    }
}

impl From<Place> for (u8, u16) {
    fn from(Place { subclass, offset }: Place) -> Self {
        (subclass, offset)
    }
}

impl From<(u8, u16)> for Place {
    fn from((subclass, offset): (u8, u16)) -> Self {
        Self { subclass, offset }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.subclass {
            FLAT => write!(f, "flash/0x{:04x}", self.offset),
            id => write!(f, "{id}/{}", self.offset),
        }
    }
}
