// SPDX-License-Identifier: MIT

//! A gauge as everything but its owner sees it: what the owner has published, and the queue of requests.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;
use std::sync::atomic::{AtomicU16, AtomicU64, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use jiff::Timestamp;

use super::crew::Member;
use super::now::{self, Content, Presence};
use super::operation::Request;
use super::{Attempt, Done, Operation, Origin, Report};
use crate::error::{Details, Error, Result};
use crate::options::GaugeOptions;
use gauge_bus::clock::Clock;
use ti_gauge::authentication::{Message, Order};
use ti_gauge::calibration::Measured;
use ti_gauge::check::Summary;
use ti_gauge::chip::sbs::failures::{Defect, failures};
use ti_gauge::chip::{Chip, Limited, Parameter, Register, Role, Scheme, Subclass};
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::epoch::{Epoch, Fact};
use ti_gauge::gauge::{Answers, Asked, Gauge, Pec, Phase, Seal, Statistics};
use ti_gauge::registers::Registers;
use ti_gauge::value::{Type, Value};

/// A write that takes longer shows in `gauge/last_error` how far it is.
const LONG_WRITE: Duration = Duration::from_secs(3);

/// All registers of one poll.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The clock when the poll's first transfer began.
    pub taken: Duration,
    /// Rises with every poll; two snapshots of one number are the same snapshot.
    pub number: u64,
    pub(super) registers: Registers,
    /// CONTROL_STATUS when it was last read, by a slow poll or after a request.
    pub control_status: u32,
    /// Whether the gauge has measured since its power-up or reset: before that its registers are 0, or old.
    pub is_valid: bool,
    /// Whether its data memory is what its profile says: a gauge that has lost it predicts with TI's defaults.
    pub is_configured: bool,
    /// What this poll and earlier ones have shown of the pack, for a check.
    pub history: Summary,
    /// Whether the gauge measured the current: that of a primary cell only between GAUGE_START and GAUGE_STOP.
    pub has_current: bool,
}

impl Snapshot {
    /// All registers.
    pub fn registers(&self) -> &Registers {
        &self.registers
    }

    /// The register's value, sign applied; `None` if it has not been read.
    pub fn value(&self, register: &Register) -> Option<i64> {
        self.registers.value(register)
    }

    /// The register's text; `None` if it has not been read, or is a number.
    pub fn text(&self, register: &Register) -> Option<&Arc<str>> {
        self.registers.text(register)
    }
}

/// The knowledge about a gauge at one moment; replaced as a whole.
#[derive(Clone, Debug)]
pub struct Published {
    /// The last poll; `None` while the gauge is gone.
    pub snapshot: Option<Arc<Snapshot>>,
    /// A poll has failed since.
    pub(super) is_failing: bool,
    /// A new one whenever the gauge was away, or may have been exchanged.
    pub presence: Epoch<Presence>,
    /// The answers of the gauge when it was identified.
    pub answers: Answers,
    /// A relative of the table's part, or another version: nothing but standard commands, which mean the same, is sent.
    pub limited: Option<Limited>,
    /// Its seal state when it was last read.
    pub seal: Seal,
    /// See [`Self::digest`].
    pub(super) digest: Fact<(Message, Message), Presence>,
    /// See [`Self::control`].
    pub(super) control: Fact<(u16, u16), Presence>,
    /// Time between polls.
    pub interval: Duration,
    /// The last failure, one line; empty for none.
    pub last_error: Arc<str>,
    /// The facts about it; `None` without a failure.
    pub failed: Option<Failure>,
    /// See [`Self::waiting`].
    pub(super) waiting: Fact<BTreeSet<(u8, u16)>, Presence>,
    /// What is wrong with the gauge as long as it answers, one line, and since when.
    pub amiss: Option<(Timestamp, Arc<str>)>,
    /// The work that a failed access has left, one line; empty for none.
    pub owed: Arc<str>,
    /// Since when that has been owed.
    pub owed_since: Timestamp,
    /// What is known of an interrupted write, since somebody last asked; empty until then.
    pub settling: Arc<str>,
    /// What is kept of what the gauge has learned, since somebody last asked; empty until then.
    pub learned: Arc<str>,
    /// The steps of the last calibration, and what it has reached; empty for none.
    pub calibration: Arc<str>,
    /// What the last calibration has measured; empty for none.
    pub measured: Arc<[Measured]>,
    /// The last report that somebody has asked for.
    pub report: Option<Arc<Report>>,
}

/// A failure that `gauge/last_error` shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// When it was.
    pub at: Timestamp,
    /// What has failed.
    pub attempt: Attempt,
    /// The attempt has left what is owed, or was refused because of it.
    pub owed: bool,
    /// The facts, as one line of JSON.
    pub facts: Arc<str>,
}

impl Published {
    /// The last challenge and its answer; `None` while this gauge has given none.
    pub fn digest(&self) -> Option<&(Message, Message)> {
        self.digest.get(self.presence)
    }

    /// The values that this gauge has stored and uses from its next start on, as a JSON object; `None` if there are none.
    pub fn waiting(&self) -> Option<String> {
        let places = self.waiting.get(self.presence)?.iter();
        let places: Vec<_> = places.map(|(id, offset)| format!("\"{id}/{offset}\"")).collect();
        Some(format!("{{\"waits_for\":\"next-start\",\"places\":[{}]}}", places.join(",")))
    }

    /// The last subcommand that was asked for, and the answer; `None` while this gauge has given none.
    pub fn control(&self) -> Option<(u16, u16)> {
        self.control.get(self.presence).copied()
    }

    /// Why the profile could not be written; empty if it was, or for a gauge without a profile.
    pub fn unwritten(&self) -> &str {
        let is_it = |failed: &Failure| failed.attempt == Attempt::RESTORE;
        if self.failed.as_ref().is_some_and(is_it) { &self.last_error } else { "" }
    }

    /// The reason to send nothing but standard commands to the gauge, if there is one.
    pub fn limitation(&self, chip: &Chip) -> Option<Error> {
        let limited = self.limited?;
        Some(Error::new(limited.name(chip), limited.cause(), limited.why(chip, &self.answers)))
    }
}

pub(super) struct Shared {
    pub(super) chip: &'static Chip,
    options: GaugeOptions,
    pub(super) origin: Origin,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) statistics: Arc<Statistics>,
    published: Mutex<Arc<Published>>,
    /// What has been read of subclasses, by their index in the table.
    kept: Mutex<Cache>,
    /// The scales in data flash that have been read, by their places; 0 for a scale that may have changed since.
    flash_scales: Mutex<BTreeMap<(u8, u16), u8>>,
    signal: Arc<Signal>,
    /// See [`Handle::revision`].
    revision: AtomicU64,
    /// See [`Handle::show_as`].
    index: AtomicU16,
    /// The beginning of each line of the log: empty if there is only one gauge.
    pub(super) prefix: String,
}

struct Cache {
    now: Epoch<Content>,
    /// The readings of each that has any, the latest one last.
    readings: Fact<BTreeMap<usize, Vec<Reading>>, Content>,
}

impl Cache {
    /// The latest reading of these bytes; with a poll, one that was read since.
    fn get(&self, subclass: usize, offsets: &Range<u16>, poll: Option<u64>) -> Option<&Reading> {
        let readings = self.readings.get(self.now)?.get(&subclass)?;
        let is_it =
            |reading: &&Reading| reading.covers(offsets) && poll.is_none_or(|poll| reading.poll == poll);
        readings.iter().rev().find(is_it)
    }

    fn is_empty(&self) -> bool {
        self.readings.get(self.now).is_none_or(BTreeMap::is_empty)
    }
}

/// A subclass, or a part of it, as it was read at once.
struct Reading {
    /// The offset of its first byte.
    start: u16,
    bytes: Arc<[u8]>,
    /// The last poll before it was read. Learned values are valid until the next one.
    poll: u64,
}

impl Reading {
    fn offsets(&self) -> Range<u16> {
        self.start..self.start + self.bytes.len() as u16
    }

    fn covers(&self, Range { start, end }: &Range<u16>) -> bool {
        self.start <= *start && *end <= self.offsets().end
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Whatever is behind a lock is replaced as a whole, so a thread that has panicked leaves the old value.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(super) fn new(
        gauge: &Gauge,
        options: GaugeOptions,
        interval: Duration,
        name: String,
        origin: Origin,
        signal: Arc<Signal>,
    ) -> Self {
        let published = Published {
            snapshot: None,
            is_failing: false,
            presence: now::presence(),
            answers: Answers::default(),
            limited: (!gauge.chip.has_table()).then_some(Limited::NoTable),
            seal: Seal::Sealed,
            digest: Fact::default(),
            control: Fact::default(),
            interval,
            last_error: "".into(),
            failed: None,
            waiting: Fact::default(),
            amiss: None,
            owed: "".into(),
            owed_since: Timestamp::UNIX_EPOCH,
            settling: "".into(),
            learned: "".into(),
            calibration: "".into(),
            measured: Arc::default(),
            report: None,
        };
        Self {
            chip: gauge.chip,
            options,
            origin,
            clock: gauge.clock.clone(),
            statistics: gauge.statistics.clone(),
            published: Mutex::new(Arc::new(published)),
            kept: Mutex::new(Cache { now: Epoch::default(), readings: Fact::default() }),
            flash_scales: Mutex::default(),
            signal,
            revision: AtomicU64::new(0),
            index: AtomicU16::new(NOWHERE),
            prefix: if name.is_empty() { name } else { name + ": " },
        }
    }

    pub(super) fn challenge_order(&self) -> Order {
        self.options.auth_order.unwrap_or_default()
    }

    pub(super) fn published(&self) -> Arc<Published> {
        lock(&self.published).clone()
    }

    /// Replaces what is published by a copy with some of it changed.
    pub(super) fn publish(&self, change: impl FnOnce(&mut Published)) {
        {
            let mut published = lock(&self.published);
            let mut next = Published::clone(&published);
            change(&mut next);
            *published = Arc::new(next);
        }
        self.raise();
    }

    /// Whether the gauge answers and has a battery. An old poll counts unless others failed since: accesses may take long.
    pub(super) fn is_present(&self) -> bool {
        let published = self.published();
        let Some(last) = &published.snapshot else { return false };
        let flags = self.chip.register(Role::Flags).and_then(|flags| last.value(flags));
        let is_old = || self.clock.now().saturating_sub(last.taken) > published.interval * 3;
        self.chip.condition.shows_battery(flags) && !(published.is_failing && is_old())
    }

    fn raise(&self) {
        self.revision.fetch_add(1, Ordering::SeqCst);
        self.signal.raise_for(self.index.load(Ordering::SeqCst));
    }

    /// Puts a failure into the log and into `gauge/last_error`.
    pub(super) fn report(&self, attempt: Attempt, error: &Error) {
        log::warn!("{}{error}", self.prefix);
        self.record(attempt, error);
    }

    /// Puts a failure into `gauge/last_error` only, but not in place of a more important one while something is owed.
    pub(super) fn record(&self, attempt: Attempt, error: &Error) {
        let line = error.to_string();
        let facts = Details::of(error).to_string().into();
        let failure = Failure { at: Timestamp::now(), attempt, owed: error.is_owed(), facts };
        self.publish(|published| {
            let shown = published.failed.as_ref().filter(|_| !published.owed.is_empty());
            if shown.is_none_or(|shown| shown.attempt.importance() <= failure.attempt.importance()) {
                (published.last_error, published.failed) = (line.into(), Some(failure));
            }
        });
    }

    /// Clears `gauge/last_error` if it shows a failure of what has now succeeded.
    pub(super) fn succeeded(&self, attempt: &Attempt) {
        if self.published().failed.as_ref().is_some_and(|failed| attempt.includes(&failed.attempt)) {
            self.clear_error();
        }
    }

    /// Notes what this gauge has stored and uses from its next start on.
    pub(super) fn note_waiting(&self, changes: &[Change]) {
        let waits = changes.iter().filter(|change| change.waits(self.chip));
        let places: Vec<(u8, u16)> = waits.map(|change| change.place().into()).collect();
        if !places.is_empty() {
            self.publish(|published| published.waiting.in_epoch(published.presence).extend(places));
        }
    }

    pub(super) fn clear_error(&self) {
        self.publish(|published| (published.last_error, published.failed) = ("".into(), None));
    }

    /// Reports an error, or clears the failure of an earlier attempt, and passes the outcome on.
    pub(super) fn logged<T>(&self, attempt: Attempt, outcome: Result<T>) -> Result<T> {
        match outcome {
            Ok(done) => {
                self.succeeded(&attempt);
                Ok(done)
            }
            Err(error) => {
                self.report(attempt, &error);
                Err(error)
            }
        }
    }

    /// Another presence begins: whatever was read of the gauge is read again before anything follows from it.
    pub(super) fn begin_presence(&self) {
        self.publish(|published| published.presence = now::presence());
    }

    /// Whether subcommands are sent to it.
    pub(super) fn is_asked(&self) -> bool {
        !self.published().limited.is_some_and(Limited::is_never_asked)
    }

    pub(super) fn limitation(&self) -> Option<Error> {
        self.published().limitation(self.chip)
    }

    /// The gauge's name in messages: the chip's if there is only one gauge.
    pub(super) fn name(&self) -> &str {
        self.prefix.strip_suffix(": ").unwrap_or(self.chip.name)
    }

    pub(super) fn kept(&self, subclass: usize) -> Option<Arc<[u8]>> {
        let row = self.chip.subclasses.get(subclass)?;
        self.reading(subclass, row.start()..row.start() + row.stored(), |reading| reading.bytes.clone())
    }

    /// A parameter's value, if its bytes are kept and still valid.
    pub(super) fn kept_parameter(&self, subclass: usize, parameter: &Parameter) -> Option<Value> {
        self.kept_at(subclass, parameter.offset, parameter.kind)
    }

    /// What was read at once of some bytes, if that is still valid: a poll puts only those out of date that the gauge rewrites.
    fn reading<T>(&self, subclass: usize, offsets: Range<u16>, of: impl FnOnce(&Reading) -> T) -> Option<T> {
        let overlaps = |parameter: &Parameter| {
            parameter.offset < offsets.end && offsets.start < parameter.offset + parameter.kind.size() as u16
        };
        let mut parameters = self.chip.subclasses[subclass].parameters.iter();
        let poll = match parameters.any(|parameter| parameter.learned && overlaps(parameter)) {
            true => Some(self.published().snapshot.as_ref()?.number),
            false => None,
        };
        lock(&self.kept).get(subclass, &offsets, poll).map(of)
    }

    fn kept_at(&self, subclass: usize, offset: u16, kind: Type) -> Option<Value> {
        let size = kind.size();
        self.reading(subclass, offset..offset + size as u16, |reading| {
            let at = usize::from(offset - reading.start);
            self.chip.layout.decode(kind, &reading.bytes[at..at + size])
        })
    }

    /// A value of data flash, given by its subclass (or `FLAT`) and offset, if its bytes are kept and still valid.
    pub(super) fn kept_value(&self, (id, offset): (u8, u16), kind: Type) -> Option<Value> {
        // A check of the configuration asks for hundreds of values, and of most gauges nothing is read.
        if lock(&self.kept).is_empty() {
            return None;
        }
        self.kept_at(self.index((id, offset))?, offset, kind)
    }

    pub(super) fn kept_byte(&self, place: (u8, u16)) -> Option<u8> {
        match self.kept_value(place, Type::U(1))? {
            Value::Int(byte) => u8::try_from(byte).ok(),
            Value::Float(_) | Value::Text(_) => None,
        }
    }

    fn index(&self, (id, offset): (u8, u16)) -> Option<usize> {
        let holds =
            |row: &Subclass| row.id == id && (row.start()..row.start() + row.length).contains(&offset);
        self.chip.subclasses.iter().position(holds)
    }

    /// The subclasses with what attributes and messages need of data flash and what is not kept.
    pub(super) fn unread_places(&self) -> Vec<usize> {
        let indices: BTreeSet<_> = self.chip.places().filter_map(|place| self.index(place)).collect();
        let kept = lock(&self.kept);
        let is_unread = |index: &usize| {
            let row = &self.chip.subclasses[*index];
            kept.get(*index, &(row.start()..row.start() + row.stored()), None).is_none()
        };
        indices.into_iter().filter(is_unread).collect()
    }

    /// Keeps bytes of a subclass from that offset on, read at once after that poll, in place of what was read of them before.
    pub(super) fn keep(&self, subclass: usize, start: u16, bytes: Arc<[u8]>, poll: u64) {
        self.note_scales(self.chip.subclasses[subclass].id, start, &bytes);
        let reading = Reading { start, bytes, poll };
        let mut kept = lock(&self.kept);
        let now = kept.now;
        let readings = kept.readings.in_epoch(now).entry(subclass).or_default();
        readings.retain(|before| !reading.covers(&before.offsets()));
        readings.push(reading);
        drop(kept);
        self.raise();
    }

    pub(super) fn note_scales(&self, id: u8, start: u16, bytes: &[u8]) {
        for (subclass, offset) in self.chip.scaling.in_flash().filter(|&(subclass, _)| subclass == id) {
            let at = offset.checked_sub(start).map(usize::from);
            let Some(&byte) = at.and_then(|at| bytes.get(at)) else { continue };
            // Drivers take 0 for none.
            let scale = byte.max(1);
            let before = lock(&self.flash_scales).insert((subclass, offset), scale);
            if before.unwrap_or(1) != scale {
                let name = self.chip.parameter(subclass, offset).map_or("scale", |row| row.name);
                let place = Place::from((subclass, offset));
                log::info!("{}{name} ({place}) is {scale}, and applies to the attributes", self.prefix);
            }
        }
    }

    /// The scale at a place; 1, the default, until it has been read; `None` if it may have changed since.
    fn flash_scale(&self, place: (u8, u16)) -> Option<u32> {
        let scale = lock(&self.flash_scales).get(&place).copied().unwrap_or(1);
        (scale > 0).then_some(scale.into())
    }

    /// After a failed write, the scales it would have changed are unknown.
    pub(super) fn doubt_scales_of(&self, changes: &[Change]) {
        for (subclass, offset) in self.chip.scaling.in_flash() {
            let holds = |change: &Change| {
                let Place { subclass: id, offset: start } = change.place();
                id == subclass && (start..).take(change.bytes().len()).any(|at| at == offset)
            };
            if changes.iter().any(holds) {
                lock(&self.flash_scales).insert((subclass, offset), 0);
            }
        }
    }

    /// The scales in data flash may be others now.
    pub(super) fn doubt_scales(&self) {
        for scale in lock(&self.flash_scales).values_mut().filter(|scale| **scale != 1) {
            *scale = 0;
        }
    }

    /// Data memory has reverted to its defaults.
    pub(super) fn forget_scales(&self) {
        lock(&self.flash_scales).clear();
    }

    pub(super) fn forget(&self, changed: impl Fn(&Subclass) -> bool) {
        let mut kept = lock(&self.kept);
        let now = kept.now;
        kept.readings.in_epoch(now).retain(|&subclass, _| !changed(&self.chip.subclasses[subclass]));
        drop(kept);
        // Attributes follow from them.
        self.raise();
    }

    /// Data flash may hold something else from now on, but its scales are the same.
    pub(super) fn next_content(&self) {
        lock(&self.kept).now.next();
        self.raise();
    }

    /// Forgets what was read of data flash, and its copies in registers: another pack may be there.
    pub(super) fn forget_dataflash(&self) {
        self.next_content();
        self.doubt_scales();
    }

    /// Since when data flash holds what it does.
    pub(super) fn content(&self) -> Epoch<Content> {
        lock(&self.kept).now
    }
}

/// A gauge, as all but its owner see it; nothing here blocks or touches the bus. The owner ends with the last clone.
#[derive(Clone)]
pub struct Handle {
    shared: Arc<Shared>,
    queue: Arc<Queue>,
}

/// Requests, each with the time at which it was submitted.
pub(super) type Requests = VecDeque<(Duration, Request)>;

pub(super) enum Queue {
    Crew(Member),
    /// To the holder of the owner.
    Direct(Weak<Mutex<Requests>>),
}

impl Handle {
    pub(super) fn new(shared: Arc<Shared>, queue: Queue) -> Self {
        Self { shared, queue: Arc::new(queue) }
    }

    /// The gauge's table.
    pub fn chip(&self) -> &'static Chip {
        self.shared.chip
    }

    /// The place of the gauge.
    pub fn origin(&self) -> &Origin {
        &self.shared.origin
    }

    /// Whether parameters may be written whose address or range is not certain.
    pub fn allows_unproven(&self) -> bool {
        self.shared.options.allow_unproven
    }

    /// The byte order in which challenges are sent.
    pub fn challenge_order(&self) -> Order {
        self.shared.challenge_order()
    }

    /// The present knowledge about the gauge.
    pub fn published(&self) -> Arc<Published> {
        self.shared.published()
    }

    /// The bytes of a subclass (by its index in the table), if they are kept and still valid.
    pub fn kept(&self, subclass: usize) -> Option<Arc<[u8]>> {
        self.shared.kept(subclass)
    }

    /// A parameter's value, given by its subclass's index, if its bytes are kept and still valid.
    pub fn kept_parameter(&self, subclass: usize, parameter: &Parameter) -> Option<Value> {
        self.shared.kept_parameter(subclass, parameter)
    }

    /// A byte of data flash, given by its subclass (or `FLAT`) and offset, if it is kept and still valid.
    pub fn kept_byte(&self, place: (u8, u16)) -> Option<u8> {
        self.shared.kept_byte(place)
    }

    /// A value of data flash, given in the same way.
    pub fn kept_value(&self, place: (u8, u16), kind: Type) -> Option<Value> {
        self.shared.kept_value(place, kind)
    }

    /// The scale at a place of data flash; `None` while it is in doubt.
    pub fn flash_scale(&self, place: (u8, u16)) -> Option<u32> {
        self.shared.flash_scale(place)
    }

    /// Age of the published snapshot; `None` while the gauge is gone.
    pub fn age(&self) -> Option<Duration> {
        let taken = self.published().snapshot.as_ref()?.taken;
        Some(self.shared.clock.now().saturating_sub(taken))
    }

    /// Whether the gauge answers and has a battery.
    pub fn is_present(&self) -> bool {
        self.shared.is_present()
    }

    /// The owner's clock.
    pub fn now(&self) -> Duration {
        self.shared.clock.now()
    }

    /// Another number after each change of what is published, or kept of data flash.
    pub fn revision(&self) -> u64 {
        self.shared.revision.load(Ordering::SeqCst)
    }

    /// Raises the signal as if something had been published.
    pub fn raise(&self) {
        self.shared.raise();
    }

    /// Gives the gauge an index, by which [`Signal::take_changed`] names it from now on, as one that has changed.
    pub fn show_as(&self, index: u16) {
        self.shared.index.store(index, Ordering::SeqCst);
        self.raise();
    }

    /// Name and value of each file of `gauge/statistics`.
    pub fn statistics(&self) -> Vec<(&'static str, u64)> {
        self.shared.statistics.list()
    }

    /// What is known of the packet error codes of a Smart Battery; `None` of another gauge.
    pub fn pec(&self) -> Option<Pec> {
        Some(self.shared.statistics.pec()).filter(|_| self.shared.chip.access.scheme == Scheme::Smbus)
    }

    /// Whether its user lets it be asked, and what came of it; `None` of a gauge without questions that is not to be asked.
    pub fn asked(&self) -> Option<(bool, Asked)> {
        let is_agreed = self.shared.options.ask_the_pack;
        let asked = self.shared.statistics.asked();
        (is_agreed || self.shared.chip.asks.is_some()).then_some((is_agreed, asked))
    }

    /// Why its pack is out of use for good, as its last poll has shown.
    pub fn failures(&self) -> Vec<Defect> {
        let published = self.published();
        let Some(last) = &published.snapshot else { return Vec::new() };
        failures(self.shared.chip, |row| last.value(row))
    }

    /// What the current write is at, such as `committing 3/4`; `None` while nothing is written.
    pub fn progress(&self) -> Option<String> {
        let (phase, done, all) = self.shared.statistics.progress.get()?;
        let phase = if phase == Phase::Saving { "saving" } else { "committing" };
        Some(format!("{phase} {done}/{all}"))
    }

    /// The progress of a write that takes unusually long.
    pub fn long_progress(&self) -> Option<String> {
        let progress = self.progress()?;
        let since = self.shared.statistics.progress.since();
        let taken = self.shared.clock.now().saturating_sub(since);
        (taken >= LONG_WRITE).then(|| format!("writing for {} s: {progress} blocks", taken.as_secs()))
    }

    /// Puts the failure of an attempt that was refused before a request into the log and into `gauge/last_error`.
    pub fn report(&self, attempt: Attempt, error: &Error) {
        self.shared.report(attempt, error);
    }

    /// Clears `gauge/last_error` if it shows a failure of this attempt, which has now succeeded without a request.
    pub fn succeeded(&self, attempt: &Attempt) {
        self.shared.succeeded(attempt);
    }

    /// Refuses something without asking the gauge, with the log and `gauge/last_error` as after a request that fails.
    pub fn refuse<T>(&self, attempt: Attempt, error: Error, done: Done<T>) {
        self.report(attempt, &error);
        done(Err(error));
    }

    /// Asks for an operation. `done` gets the outcome, of a write within 30 s; at once if the owner has ended.
    pub fn ask<A: Send, T>(&self, operation: &'static Operation<A, T>, argument: A, done: Done<T>) {
        self.ask_as(operation, argument, None, done);
    }

    /// Asks for an operation with a number by which the caller knows the answer.
    pub(super) fn ask_as<A: Send, T>(
        &self,
        operation: &'static Operation<A, T>,
        argument: A,
        name: Option<u64>,
        done: Done<T>,
    ) {
        let request = Request::new(operation, argument, name, self.shared.name(), done);
        let now = self.shared.clock.now();
        // What cannot be sent is dropped, and answers.
        match &*self.queue {
            Queue::Crew(member) => member.submit(now, request),
            Queue::Direct(requests) => {
                if let Some(requests) = requests.upgrade() {
                    lock(&requests).push_back((now, request));
                }
            }
        }
    }

    /// Asks for an operation, and waits for its outcome.
    pub fn wait_for<A: Send, T: Send + 'static>(
        &self,
        operation: &'static Operation<A, T>,
        argument: A,
    ) -> Result<T> {
        let (done, outcome) = mpsc::channel();
        self.ask(operation, argument, Box::new(move |answer| drop(done.send(answer))));
        outcome.recv().unwrap_or_else(|_| unreachable!("a request that is dropped answers"))
    }
}

/// Raised by owners whenever something published has changed; waited for by what shows it.
#[derive(Debug, Default)]
pub struct Signal {
    state: Mutex<Raised>,
    raised: Condvar,
}

#[derive(Debug, Default)]
struct Raised {
    count: u64,
    changed: Vec<u16>,
}

/// The index of a gauge that nobody shows.
const NOWHERE: u16 = u16::MAX;

impl Signal {
    /// Something has changed.
    pub fn raise(&self) {
        self.raise_for(NOWHERE);
    }

    fn raise_for(&self, index: u16) {
        let mut state = lock(&self.state);
        state.count += 1;
        if index != NOWHERE && !state.changed.contains(&index) {
            state.changed.push(index);
        }
        drop(state);
        self.raised.notify_all();
    }

    /// The indices of the gauges that have changed since this was last asked.
    pub fn take_changed(&self) -> Vec<u16> {
        std::mem::take(&mut lock(&self.state).changed)
    }

    /// Waits until the count differs from `seen` or the limit has passed, and returns the count.
    pub fn wait(&self, seen: u64, limit: Option<Duration>) -> u64 {
        let state = lock(&self.state);
        let unchanged = |state: &mut Raised| state.count == seen;
        match limit {
            None => self.raised.wait_while(state, unchanged).unwrap_or_else(PoisonError::into_inner).count,
            Some(limit) => {
                let waited = self.raised.wait_timeout_while(state, limit, unchanged);
                waited.unwrap_or_else(PoisonError::into_inner).0.count
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::operations as op;
    use super::super::rig::{INTERVAL, Rig};
    use super::*;
    use crate::error::Cause;

    #[test]
    fn a_published_snapshot_is_replaced_as_a_whole() {
        let mut rig = Rig::open();
        let register = rig.handle.chip().register(Role::VoltageNow).expect("it has one");
        let voltage = |published: &Published| {
            let snapshot = published.snapshot.as_ref().expect("it was polled");
            (snapshot.number, snapshot.taken, snapshot.value(register))
        };
        rig.sim.set("voltage_mv", "12000").expect("a knob");
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        let (before, old) = (rig.handle.published(), voltage(&rig.handle.published()));

        rig.sim.set("voltage_mv", "11000").expect("a knob");
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        let (after, new) = (rig.handle.published(), voltage(&rig.handle.published()));
        assert!(new.0 > old.0 && new.1 > old.1 && new.2 < old.2, "{old:?}, then {new:?}");
        assert_eq!(voltage(&before), old, "whoever holds the old one sees the old poll");
        assert!(!Arc::ptr_eq(&before, &after));
        // Most of it has not changed, and yet all of it is new.
        rig.owner.access.shared().publish(|published| published.interval *= 2);
        assert_eq!(after.interval, INTERVAL);
        assert_eq!(rig.handle.published().interval, INTERVAL * 2);
    }

    #[test]
    fn a_request_changes_the_status_in_a_new_snapshot() {
        let mut rig = Rig::open();
        let before = rig.handle.published();
        rig.ask(&op::SEAL, Seal::Unsealed).expect("the default key");
        let after = rig.handle.published();
        assert_eq!((before.seal, after.seal), (Seal::Sealed, Seal::Unsealed));
        let status = |published: &Published| published.snapshot.as_ref().expect("a poll").control_status;
        assert_ne!(status(&before), status(&after));
        assert_eq!(status(&after), rig.owner.access.control_status());
    }

    #[test]
    fn learned_values_are_kept_until_the_next_poll() {
        let mut rig = Rig::open();
        // Data holds learned values, Discharge does not.
        let (learned, configured) = (rig.index(82), rig.index(80));
        rig.ask(&op::READ, vec![learned, configured]).expect("the default key");
        assert!(rig.handle.kept(learned).is_some() && rig.handle.kept(configured).is_some());
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert!(rig.handle.kept(learned).is_none() && rig.handle.kept(configured).is_some());
        rig.ask(&op::REFRESH, ()).expect("it answers");
        assert!(rig.handle.kept(configured).is_none());
    }

    #[test]
    fn a_report_is_the_last_error_and_raises_the_signal() {
        let rig = Rig::open();
        let signal = &rig.owner.access.shared().signal;
        rig.handle.show_as(3);
        let seen = signal.wait(u64::MAX, Some(Duration::ZERO));
        assert_eq!((signal.take_changed(), signal.take_changed()), (vec![3], vec![]));
        rig.handle.report(
            super::super::operations::CONTROL.itself(),
            &Error::new("control", Cause::Invalid, "no such subcommand"),
        );
        assert_eq!(&*rig.handle.published().last_error, "control: no such subcommand");
        assert_eq!(signal.wait(seen, None), seen + 1);
        assert_eq!(signal.take_changed(), [3]);
    }
}
