//! The transaction: the only way to read or write data flash.
//!
//! A change runs whole: wear, identity and state of the gauge (`preflight`), unseal and confirm, flash
//! voltage, read each block with its checksum, stop if nothing changes, write, checksum, read back, reset
//! where the table says so, unseal and verify once more, seal as found and confirm. Every way out passes
//! through the close. The gauge rejects nothing that it is sent, so what is checked here is safety, not
//! courtesy.
//!
//! Until the first block is committed an error means that nothing has changed. From then on the answer
//! is success, [`Cause::RolledBack`] (the old bytes were put back and verified) or [`Cause::Unknown`].

use std::fmt;
use std::ops::Range;
use std::time::Duration;

use crate::chip::{Chip, FLAT, Kind, Parameter, Safe, Scheme, Subclass};
use crate::codec::{self, WINDOW};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal, Statistics};
use crate::journal::{Identity, Journal, Open};
use crate::value::Value;

mod block;
mod cfgupdate;
mod keychange;
mod mac;
mod preflight;
mod settle;
mod wear;

use preflight::{Found, Met};
use wear::Wear;

/// A write(2) answers within 30 s: so much for the way forward ...
const FORWARD: Duration = Duration::from_secs(16);
/// ... so much for putting back what was there, and as much again for the seal.
const BACK: Duration = Duration::from_secs(6);
/// How often putting the old bytes back is tried.
const RESTORES: u32 = 3;

/// A place in data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Subclass id, or [`FLAT`].
    pub subclass: u8,
    /// Offset in the subclass, or address.
    pub offset: u16,
}

/// A parameter and the subclass that it belongs to.
pub type Row = (&'static Subclass, &'static Parameter);

/// New bytes for one place in data flash.
#[derive(Clone, Debug)]
pub struct Change {
    /// Where its first byte is.
    pub place: Place,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// The parameter that they are the value of; `None` for bytes that no manual documents.
    pub row: Option<Row>,
    /// Of a saved configuration: bits that must stay as they are do, whatever was saved.
    pub saved: bool,
}

/// What a change did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Data flash held the values already: no flash write, no reset.
    Unchanged,
    /// Written and verified; the gauge was reset if `reset`.
    Written {
        /// Whether the gauge was reset.
        reset: bool,
    },
}

/// A 32-byte piece of data flash, as the window shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    /// Subclass id, or [`FLAT`].
    subclass: u8,
    /// Offset, or flat address, of the window's first byte.
    base: u16,
}

/// A block that a change touches.
struct Dirty {
    place: Window,
    /// As it was read.
    old: [u8; WINDOW],
    /// As it shall be.
    new: [u8; WINDOW],
    /// Where in the window the changed parameters stand.
    written: Range<usize>,
}

/// What the access schemes do differently. Each step is straight-line code, to be read beside the manual.
trait Sequence {
    /// Lets data flash be read.
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Lets data flash be written, where that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Brings a block into the window and reads it whole, with its checksum.
    fn load(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]>;
    /// Brings a block into the window and reads some of its bytes.
    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()>;
    /// Whether the block has to be in the window before its bytes are changed. Not where they go out with their
    /// address, and the sum that commits them is over both.
    fn fills_window(&self) -> bool;
    /// Changes the bytes that differ, in the gauge's buffer only.
    fn fill(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Sends what makes the gauge store the block. Never sent twice: whoever calls finds out what the
    /// block holds instead.
    fn commit(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Makes new data flash take effect: a reset, or the end of the mode that `begin` began.
    fn finish(&self, gauge: &mut Gauge) -> Result<()>;
    /// Whether `finish` has to follow every `begin`.
    fn always_finishes(&self) -> bool;
}

fn sequence(gauge: &Gauge) -> &'static dyn Sequence {
    match gauge.chip.access.scheme {
        Scheme::Block => &block::Block,
        Scheme::CfgUpdate => &cfgupdate::CfgUpdate,
        Scheme::Mac => &mac::Mac,
    }
}

/// What a careful person may overrule.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Write in the middle of a learning cycle too, which ends it.
    pub allow_learning: bool,
    /// So many blocks of flash may be programmed within an hour; 0 for any number.
    pub writes_per_hour: u32,
}

/// A script that runs wild from Friday evening to Monday morning, 66 h, does not use up the 20,000 cycles of a
/// block (SLUSBZ5D 6.12); and each parameter of the largest table can be written once.
pub const WRITES_PER_HOUR: u32 = 300;

impl Default for Limits {
    fn default() -> Self {
        Self { allow_learning: false, writes_per_hour: WRITES_PER_HOUR }
    }
}

/// What has to be known about a gauge's data flash from one transaction to the next.
#[derive(Debug, Default)]
pub struct DataFlash {
    limits: Limits,
    wear: Wear,
    /// The gauge whose values were read.
    met: Option<Met>,
    /// Another one has answered in its place.
    doubts: bool,
    /// A transaction of ours may have left its mode on: the next write ends it.
    ours: bool,
    /// Limit and divider of the flash-voltage gate, read while the gauge was unsealed.
    gate: Option<(u16, u16)>,
    /// The rows that tell whether the table's addresses are this firmware's have been compared.
    signed: bool,
    /// Where it is put down what a write is about to do.
    journal: Option<Journal>,
    /// Whose journal that is; `None` until it is asked for.
    identity: Option<Identity>,
}

impl DataFlash {
    /// Nothing known, and nothing written yet. With a journal, writes survive a power cut of the host.
    pub fn new(limits: Limits, journal: Option<Journal>) -> Self {
        Self { limits, journal, ..Self::default() }
    }

    /// Nothing known of what it holds: after a gauge's return, or when somebody asks for everything anew.
    pub fn forget(&mut self) {
        (self.gate, self.signed) = (None, false);
    }

    /// Reads whole subclasses in one go, and leaves the gauge sealed as it was. `waited` is how long ago
    /// this was asked for.
    pub fn read(
        &mut self,
        gauge: &mut Gauge,
        wanted: &[&'static Subclass],
        waited: Duration,
    ) -> Result<Vec<Vec<u8>>> {
        in_time(gauge, waited, |gauge| {
            let found = gauge.seal()?;
            let mut visit = Visit::new(found);
            let read = visit
                .open(gauge)
                .and_then(|()| {
                    wanted.iter().map(|subclass| read_subclass(gauge, subclass)).collect::<Result<_>>()
                })
                .and_then(|bytes| self.learn_gate(gauge).map(|()| bytes));
            visit.close(gauge, read)
        })
    }

    /// Goes to a seal state on request.
    pub fn go_to(&mut self, gauge: &mut Gauge, goal: Seal, waited: Duration) -> Result<()> {
        in_time(gauge, waited, |gauge| {
            gauge.go_to(goal)?;
            if goal == Seal::Sealed {
                return Ok(());
            }
            sequence(gauge).enable(gauge)?;
            self.learn_gate(gauge)
        })
    }

    /// Makes the changes, all or none, in one transaction.
    pub fn write(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<Outcome> {
        if let Some(change) = changes.iter().find(|change| change.kind(gauge.chip) == Kind::Security) {
            let why = "keys cannot be changed like other parameters";
            return Err(Error::new(change.subject(), Cause::NotPermitted(why.into())).at(Step::Check));
        }
        let outcome = self.check_wear(gauge).and_then(|()| {
            self.counted(gauge, |dataflash, gauge| dataflash.transact(gauge, changes, waited))
        });
        self.learn_from(gauge, changes, &outcome);
        gauge.statistics.progress.end();
        match changes {
            [change] => outcome.map_err(|error| error.within(&change.subject())),
            _ => outcome,
        }
    }

    /// One visit, after whatever an earlier one has left behind.
    fn transact(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<Outcome> {
        let waited = self.settle_first(gauge, waited)?;
        in_time(gauge, waited, |gauge| {
            gauge.claim()?;
            let found = self.preflight(gauge, changes)?;
            let mut visit = Visit::new(found.seal);
            if let Some(journal) = self.journal.clone() {
                let identity = self.identity(gauge)?;
                visit.journal = Some(journal.begin(identity, visit.found, blocks(changes))?);
            }
            let outcome = visit.open(gauge).and_then(|()| self.change(gauge, changes, &found, &mut visit));
            visit.close(gauge, outcome)
        })
    }

    /// The unsealed part of a write.
    fn change(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: &Found,
        visit: &mut Visit,
    ) -> Result<Outcome> {
        let voltage_mv = found.voltage_mv;
        self.check_signature(gauge)?;
        self.check_gate(gauge, voltage_mv)?;
        preflight::check_unsealed(gauge)?;
        let learning = self.learning(gauge, found.status, changes)?;
        let mut dirty = gather(gauge, changes)?;
        // The window holds the block that was read last; where there was only one, it is still there.
        let in_window = dirty.len() == 1 && !sequence(gauge).always_finishes();
        for change in changes {
            self.check_safe(gauge, change, &dirty, voltage_mv)?;
        }
        dirty.retain(|block| block.old != block.new);
        if dirty.is_empty() {
            return Ok(Outcome::Unchanged);
        }
        match learning {
            Some(error) if !self.limits.allow_learning => return Err(error),
            Some(_) => log::warn!("{}: this write ends a learning cycle", gauge.chip.name),
            None => {}
        }
        let reset = changes.iter().any(|change| change.kind(gauge.chip) == Kind::Reset);
        if changes.iter().any(|change| is_gate(gauge, change)) {
            self.gate = None;
        }
        if let Some(journal) = &mut visit.journal {
            let plan = settle::plan(gauge, reset, &dirty);
            journal.plan(&plan)?;
            self.identity = self.identity.filter(|_| plan.serial.is_none());
        }
        gauge.statistics.progress.begin(dirty.len());
        visit.begin(gauge)?;
        let (mut touched, mut finished) = (0, false);
        let forward = dirty.iter().try_for_each(|block| {
            if !in_window && sequence(gauge).fills_window() {
                sequence(gauge).load(gauge, block.place)?;
            }
            store(gauge, block, &mut touched).map(|()| gauge.statistics.progress.step())
        });
        let forward = forward.and_then(|()| {
            if !reset && !sequence(gauge).always_finishes() {
                return Ok(());
            }
            finished = true;
            visit.finish(gauge)?;
            dirty.iter().try_for_each(|block| verify_written(gauge, block))
        });
        let Err(error) = forward else { return Ok(Outcome::Written { reset }) };
        if touched == 0 {
            return Err(error);
        }
        visit.now = None;
        gauge.limit(Some(BACK));
        match visit.restore(gauge, &dirty[..touched], finished) {
            Ok(()) => {
                let why = format!("{error}; the old value was put back and verified");
                Err(Error::new("", Cause::RolledBack(why)))
            }
            Err(second) => {
                let why = format!("{error}; then {second}: what data flash holds is not known");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
        }
    }

    /// Before the first write: rows of which it is known what they must hold tell whether this firmware
    /// keeps its data flash where the table says.
    fn check_signature(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.signed {
            return Ok(());
        }
        for row in gauge.chip.signature {
            let size = row.kind.size();
            let (start, offset) = (if row.subclass == FLAT { row.offset } else { 0 }, row.offset);
            let (place, at) = locate(row.subclass, start, offset);
            let window = sequence(gauge).load(gauge, place)?;
            let Value::Int(found) = codec::decode(row.kind, &window[at..at + size]) else { continue };
            if !(row.min..=row.max).contains(&found) {
                let why = format!(
                    "{} holds {found}, which cannot be: this firmware keeps its data flash elsewhere, and nothing \
                     is written to it",
                    place.name(at)
                );
                return Err(Error::new("", Cause::Gone(why)).at(Step::Check));
            }
        }
        self.signed = true;
        Ok(())
    }

    /// Reads what decides whether the gauge stores a block, unless it is known. UNSEALED only.
    fn learn_gate(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(gate) = &gauge.chip.gate else { return Ok(()) };
        if self.gate.is_none() {
            let limit_mv = read_word(gauge, gate.limit)?;
            let divider = match gate.divider {
                Some((subclass, offset, _)) => read_word(gauge, (subclass, offset))?,
                None => 0,
            };
            self.gate = Some((limit_mv, divider));
        }
        Ok(())
    }

    /// Voltage() as the gate compares it, scaled back to one cell where there is a divider, and the limit.
    fn gate_voltage(&self, gauge: &Gauge, voltage_mv: u16) -> Option<(u32, u16)> {
        let (limit_mv, divider) = self.gate?;
        let scaled_mv = match gauge.chip.gate.as_ref()?.divider {
            Some((_, _, full)) if divider != 0 => u32::from(voltage_mv) * full / u32::from(divider),
            Some(_) | None => u32::from(voltage_mv),
        };
        Some((scaled_mv, limit_mv))
    }

    fn check_gate(&mut self, gauge: &mut Gauge, voltage_mv: u16) -> Result<()> {
        self.learn_gate(gauge)?;
        let (Some(gate), Some((scaled_mv, limit_mv))) =
            (&gauge.chip.gate, self.gate_voltage(gauge, voltage_mv))
        else {
            return Ok(());
        };
        if scaled_mv >= u32::from(limit_mv) {
            return Ok(());
        }
        let (subclass, offset) = gate.limit;
        let why = format!(
            "the gauge measures {scaled_mv} mV a cell and stores nothing below {limit_mv} mV ({subclass}/{offset}): \
             charge the pack, or check Voltage Divider"
        );
        Err(Error::new("", Cause::NotNow(why)).at(Step::Check))
    }

    /// The limits that are narrower than the manual's.
    fn check_safe(&self, gauge: &Gauge, change: &Change, dirty: &[Dirty], voltage_mv: u16) -> Result<()> {
        let refuse = |why: String| Err(Error::new(change.subject(), Cause::OutOfRange(why)).at(Step::Check));
        let Some((_, parameter)) = change.row else { return Ok(()) };
        let number = integer(parameter, &change.bytes);
        match &parameter.safe {
            Some(Safe::AtLeast(..)) => change.check_least(),
            Some(Safe::BelowPresentVoltage(why)) => {
                let present_mv =
                    i64::from(self.gate_voltage(gauge, voltage_mv).map_or(0, |(scaled_mv, _)| scaled_mv));
                if number <= present_mv {
                    return Ok(());
                }
                refuse(format!("{number} is above the present {present_mv} mV a cell: {why}"))
            }
            Some(Safe::Keep(..)) if change.saved => Ok(()),
            Some(Safe::Keep(mask, why)) => {
                let old = integer(parameter, &old_bytes(change, dirty));
                let differ = (old ^ number) & i64::from(*mask);
                if differ == 0 {
                    return Ok(());
                }
                refuse(format!("bits 0x{differ:x} must stay as they are: {why}; the word is now 0x{old:x}"))
            }
            None => Ok(()),
        }
    }
}

impl Change {
    /// A new value of a parameter; `None` where it does not fit the parameter's type.
    pub fn of_value((subclass, parameter): Row, value: &Value) -> Option<Self> {
        let place = Place { subclass: subclass.id, offset: parameter.offset };
        let bytes = codec::encode(parameter.kind, value)?;
        Some(Self { place, bytes, row: Some((subclass, parameter)), saved: false })
    }

    /// The only one of the narrower limits that can be checked without the gauge.
    pub fn check_least(&self) -> Result<()> {
        let Some((_, parameter)) = self.row else { return Ok(()) };
        let number = integer(parameter, &self.bytes);
        match &parameter.safe {
            Some(Safe::AtLeast(least, why)) if number < *least => {
                let why = format!("{number} is below {least}: {why}");
                Err(Error::new(self.subject(), Cause::OutOfRange(why)).at(Step::Check))
            }
            _ => Ok(()),
        }
    }

    /// What to call it in a log: the parameter's name, or the place of bytes without one.
    pub fn name(&self) -> String {
        match self.row {
            Some((_, parameter)) => parameter.name.to_string(),
            None => format!("undocumented bytes at {}", self.place),
        }
    }

    fn subject(&self) -> String {
        match self.row {
            Some((_, parameter)) => format!("{} ({})", parameter.name, self.place),
            None => self.name(),
        }
    }

    /// What its subclass needs. Of one that no table has, nobody says that it would do without a reset.
    fn kind(&self, chip: &Chip) -> Kind {
        let table = self.row.map(|(subclass, _)| subclass).or_else(|| chip.subclass(self.place.subclass));
        table.map_or(Kind::Reset, |subclass| subclass.kind)
    }

    /// The windows that hold its bytes, a byte each, and where in them.
    fn windows(&self) -> impl Iterator<Item = (Window, usize)> {
        let start = self.row.map_or(0, |(subclass, _)| subclass.start());
        let offsets = (self.place.offset..).take(self.bytes.len());
        offsets.map(move |offset| locate(self.place.subclass, start, offset))
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

impl Dirty {
    /// The bytes from the first to the last that differ.
    fn differing(&self) -> Option<Range<usize>> {
        let differs = |&at: &usize| self.old[at] != self.new[at];
        Some((0..WINDOW).find(differs)?..(0..WINDOW).rfind(differs)? + 1)
    }
}

impl Window {
    /// The byte at a position of the window, for a message.
    fn name(self, at: usize) -> String {
        let offset = usize::from(self.base) + at;
        match self.subclass {
            FLAT => format!("address 0x{offset:04x}"),
            subclass => format!("subclass {subclass} offset {offset}"),
        }
    }
}

/// The window that shows an offset of a subclass which begins at `start`, and where in it.
fn locate(subclass: u8, start: u16, offset: u16) -> (Window, usize) {
    let at = usize::from(offset - start) % WINDOW;
    (Window { subclass, base: offset - at as u16 }, at)
}

fn is_gate(gauge: &Gauge, change: &Change) -> bool {
    let at = (change.place.subclass, change.place.offset);
    gauge.chip.gate.as_ref().is_some_and(|gate| {
        at == gate.limit || gate.divider.is_some_and(|(subclass, offset, _)| at == (subclass, offset))
    })
}

/// The number that a parameter's bytes stand for; the safe limits are all about integers.
fn integer(parameter: &Parameter, bytes: &[u8]) -> i64 {
    match codec::decode(parameter.kind, bytes) {
        Value::Int(number) => number,
        Value::Float(_) | Value::Text(_) => 0,
    }
}

fn read_word(gauge: &mut Gauge, (subclass, offset): (u8, u16)) -> Result<u16> {
    let start = if subclass == FLAT { offset } else { 0 };
    let (place, at) = locate(subclass, start, offset);
    let mut word = [0; 2];
    sequence(gauge).read_part(gauge, place, at, &mut word)?;
    Ok(u16::from_be_bytes(word))
}

fn read_byte(gauge: &mut Gauge, (subclass, offset): (u8, u16)) -> Result<u8> {
    let start = if subclass == FLAT { offset } else { 0 };
    let (place, at) = locate(subclass, start, offset);
    let mut byte = [0];
    sequence(gauge).read_part(gauge, place, at, &mut byte)?;
    Ok(byte[0])
}

fn read_subclass(gauge: &mut Gauge, subclass: &Subclass) -> Result<Vec<u8>> {
    let length = usize::from(subclass.stored());
    let mut bytes = Vec::with_capacity(length);
    while bytes.len() < length {
        let base = subclass.start() + bytes.len() as u16;
        let window = sequence(gauge).load(gauge, Window { subclass: subclass.id, base })?;
        bytes.extend_from_slice(&window[..WINDOW.min(length - bytes.len())]);
    }
    Ok(bytes)
}

/// Reads every block that the changes touch, and patches a copy.
fn gather(gauge: &mut Gauge, changes: &[Change]) -> Result<Vec<Dirty>> {
    let mut dirty: Vec<Dirty> = Vec::new();
    for change in changes {
        for (number, ((place, at), &byte)) in change.windows().zip(&change.bytes).enumerate() {
            let index = match dirty.iter().position(|block| block.place == place) {
                Some(index) => index,
                None => {
                    let old = sequence(gauge).load(gauge, place)?;
                    dirty.push(Dirty { place, old, new: old, written: at..at });
                    dirty.len() - 1
                }
            };
            let block = &mut dirty[index];
            let kept = if change.saved { kept_bits(change, number) } else { 0 };
            block.new[at] = byte & !kept | block.old[at] & kept;
            block.written = block.written.start.min(at)..block.written.end.max(at + 1);
        }
    }
    // Windows of a flat part may overlap: each is verified before the next one's bytes change.
    dirty.sort_by_key(|block| (block.place.subclass, block.place.base));
    Ok(dirty)
}

/// The bits of one of its bytes that a write must leave alone.
fn kept_bits(change: &Change, number: usize) -> u8 {
    let Some((_, Parameter { safe: Some(Safe::Keep(mask, _)), .. })) = change.row else { return 0 };
    let behind = change.bytes.len() - 1 - number;
    (mask >> (8 * behind)) as u8
}

/// How many blocks the changes touch.
fn blocks(changes: &[Change]) -> usize {
    let places: Vec<Window> = changes.iter().flat_map(Change::windows).map(|(place, _)| place).collect();
    (0..places.len()).filter(|&at| !places[..at].contains(&places[at])).count()
}

fn old_bytes(change: &Change, dirty: &[Dirty]) -> Vec<u8> {
    let byte = |(place, at)| Some(dirty.iter().find(|block| block.place == place)?.old[at]);
    change.windows().filter_map(byte).collect()
}

/// Writes one block, commits it and reads it back. `touched` counts the blocks that may have been
/// committed: from that moment on the block's content has to be found out, not assumed.
fn store(gauge: &mut Gauge, block: &Dirty, touched: &mut usize) -> Result<()> {
    sequence(gauge).fill(gauge, block)?;
    *touched += 1;
    Statistics::count(&gauge.statistics.flash_writes);
    let committed = sequence(gauge).commit(gauge, block);
    // A checksum whose acknowledgement was lost may have done its work all the same.
    verify(gauge, block).map_err(|error| committed.err().unwrap_or(error))
}

/// Selects and reads the block again: the window right after a write shows the buffer, not flash.
fn verify(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let stored = sequence(gauge).load(gauge, block.place).map_err(|error| error.at(Step::Verify))?;
    compare(block, &stored)
}

/// After a reset only the written bytes count: the gauge rewrites others itself.
fn verify_written(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let range = block.written.clone();
    let mut stored = block.new;
    let read = sequence(gauge).read_part(gauge, block.place, range.start, &mut stored[range]);
    read.map_err(|error| error.at(Step::Verify))?;
    compare(block, &stored)
}

fn compare(block: &Dirty, stored: &[u8; WINDOW]) -> Result<()> {
    let Some(at) = (0..WINDOW).find(|&at| stored[at] != block.new[at]) else { return Ok(()) };
    let place = block.place.name(at);
    let why = if *stored == block.old {
        format!("{place}: the gauge acknowledged the write and stored nothing")
    } else {
        format!("{place} reads 0x{:02x}, wrote 0x{:02x}", stored[at], block.new[at])
    };
    Err(Error::new("", Cause::Protocol(why)).at(Step::Verify))
}

/// One visit to an unsealed gauge: how it was found, and what is known of its state now.
struct Visit {
    found: Seal,
    /// `None` from the moment on in which something may have changed it until it is confirmed.
    now: Option<Seal>,
    /// A mode was begun that has to be finished on every way out.
    begun: bool,
    /// What is done is put down there first, and removed when the visit has ended as it should.
    journal: Option<Open>,
}

impl Visit {
    fn new(found: Seal) -> Self {
        Self { found, now: Some(found), begun: false, journal: None }
    }

    /// The visit has ended as it should; there is nothing to settle any more.
    fn over(&mut self) {
        // What stays is settled before the next write, or at the next start: nothing is lost by it.
        if let Some(Err(error)) = self.journal.take().map(Open::over) {
            log::warn!("{error}");
        }
    }

    /// Makes data flash readable.
    fn open(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.found == Seal::Sealed {
            self.now = None;
            gauge.unseal()?;
            self.now = Some(Seal::Unsealed);
        }
        sequence(gauge).enable(gauge)
    }

    /// Makes data flash writable.
    fn begin(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.begun = sequence(gauge).always_finishes();
        sequence(gauge).begin(gauge)
    }

    /// Makes what was written take effect, and data flash readable again.
    fn finish(&mut self, gauge: &mut Gauge) -> Result<()> {
        self.now = None;
        sequence(gauge).finish(gauge)?;
        self.begun = false;
        self.now = Some(reopen(gauge, self.found)?);
        sequence(gauge).enable(gauge)
    }

    /// Puts the old bytes back. Once the gauge has begun to work with new data flash that is what was
    /// written and nothing else, so that what it learned meanwhile stays; before, it is the whole block: a
    /// bit lost in a register's address puts a byte in the wrong place, and the checksum, a sum, does not
    /// see it.
    fn restore(&mut self, gauge: &mut Gauge, touched: &[Dirty], finished: bool) -> Result<()> {
        let mut outcome = Ok(());
        for _ in 0..RESTORES {
            outcome = gauge
                .seal()
                .and_then(|now| if now == Seal::Sealed { gauge.unseal() } else { Ok(()) })
                .and_then(|()| sequence(gauge).enable(gauge))
                .and_then(|()| {
                    touched.iter().try_for_each(|block| self.restore_block(gauge, block, finished))
                });
            if outcome.is_ok() {
                break;
            }
            gauge.wait(Duration::from_millis(200));
        }
        outcome.map_err(|error| error.at(Step::Restore))
    }

    fn restore_block(&mut self, gauge: &mut Gauge, block: &Dirty, finished: bool) -> Result<()> {
        let range = if finished { block.written.clone() } else { 0..WINDOW };
        let present = sequence(gauge).load(gauge, block.place)?;
        let mut wanted = present;
        wanted[range.clone()].copy_from_slice(&block.old[range]);
        if wanted == present {
            return Ok(());
        }
        self.begin(gauge)?;
        if sequence(gauge).fills_window() {
            sequence(gauge).load(gauge, block.place)?;
        }
        let back = Dirty { place: block.place, old: present, new: wanted, written: block.written.clone() };
        store(gauge, &back, &mut 0)
    }

    /// The way out of every transaction: seals as found, confirms it, and reports both failures if there
    /// are two.
    fn close<T>(mut self, gauge: &mut Gauge, outcome: Result<T>) -> Result<T> {
        gauge.limit(Some(BACK));
        let finished = if self.begun { self.finish(gauge) } else { Ok(()) };
        // After a failure nothing is taken for granted: a gauge that lost its power comes back sealed.
        let closed = match self.now.filter(|_| outcome.is_ok()) {
            Some(now) => gauge.go(now, self.found),
            None => gauge.go_to(self.found),
        };
        let found = self.found.as_str();
        match (outcome, finished.and(closed)) {
            (outcome, Ok(())) => {
                if !outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::StateUnknown(_))) {
                    self.over();
                }
                outcome
            }
            (Ok(_), Err(error)) => {
                let why = format!("done, but the gauge could not be left {found} as it was: {error}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
            // It does not answer, and nothing was sent that could have changed its state.
            (Err(first), Err(_)) if self.now == Some(self.found) => Err(first),
            (Err(first), Err(second)) => {
                let why = format!("{first}; then the gauge could not be left {found} as it was: {second}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
        }
    }
}

/// Waits for the end of a reset and goes back to a state in which data flash can be read.
fn reopen(gauge: &mut Gauge, found: Seal) -> Result<Seal> {
    let access = &gauge.chip.access;
    let goal = if found == Seal::Sealed { Seal::Unsealed } else { found };
    gauge.wait(access.reset);
    // A part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11): no need to ask first.
    if found == Seal::Sealed && gauge.unseal().is_ok() {
        return Ok(goal);
    }
    let limit = gauge.clock.now() + access.reset_limit;
    loop {
        match gauge.seal() {
            Ok(now) => return gauge.go(now, goal).map(|()| goal),
            Err(_) if gauge.clock.now() < limit => gauge.wait(access.reset.max(Duration::from_millis(50))),
            Err(error) => return Err(error.at(Step::Reset)),
        }
    }
}

/// Runs a transaction so that it answers within 30 s of being asked for, `waited` ago, and lifts the
/// limit again.
fn in_time<T>(gauge: &mut Gauge, waited: Duration, run: impl FnOnce(&mut Gauge) -> Result<T>) -> Result<T> {
    gauge.limit(Some(FORWARD.saturating_sub(waited)));
    let outcome = run(gauge);
    gauge.limit(None);
    outcome
}
