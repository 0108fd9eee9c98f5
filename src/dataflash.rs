//! The transaction: the only way to read or write data flash.
//!
//! A change runs whole: identity, flash voltage, seal state, unseal and confirm, read each block with
//! its checksum, stop if nothing changes, write, checksum, read back, reset where the table says so,
//! unseal and verify once more, seal as found and confirm. Every way out passes through the close. The
//! gauge rejects nothing that it is sent, so what is checked here is safety, not courtesy.
//!
//! Until the first block is committed an error means that nothing has changed. From then on the answer
//! is success, [`Cause::RolledBack`] (the old bytes were put back and verified) or [`Cause::Unknown`].

use std::time::Duration;

use crate::chip::{Access, Kind, Parameter, Role, Safe, Subclass};
use crate::codec::{self, WINDOW};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal, Statistics};
use crate::value::Value;

mod block;

/// A write(2) answers within 30 s: so much for the way forward ...
const FORWARD: Duration = Duration::from_secs(16);
/// ... so much for putting back what was there, and as much again for the seal.
const BACK: Duration = Duration::from_secs(6);
/// How often putting the old bytes back is tried.
const RESTORES: u32 = 3;

/// New bytes for one parameter.
#[derive(Clone, Debug)]
pub struct Change {
    /// Where it stands.
    pub subclass: &'static Subclass,
    /// Which one it is.
    pub parameter: &'static Parameter,
    /// Its bytes in data flash, as many as its type has.
    pub bytes: Vec<u8>,
}

impl Change {
    fn subject(&self) -> String {
        format!("{} ({}/{})", self.parameter.name, self.subclass.id, self.parameter.offset)
    }
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
struct Place {
    subclass: u8,
    block: u8,
}

/// A block that a change touches.
struct Dirty {
    place: Place,
    /// As it was read.
    old: [u8; WINDOW],
    /// As it shall be.
    new: [u8; WINDOW],
    /// Where in the window the changed parameters stand.
    written: std::ops::Range<usize>,
}

/// What has to be known about a gauge's data flash from one transaction to the next.
#[derive(Debug, Default)]
pub struct DataFlash {
    /// Limit and divider of the flash-voltage gate, read while the gauge was unsealed.
    gate: Option<(u16, u16)>,
}

impl DataFlash {
    /// Nothing known: after a gauge's return, or when somebody asks for everything anew.
    pub fn forget(&mut self) {
        self.gate = None;
    }

    /// Reads whole subclasses in one go, and leaves the gauge sealed as it was.
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
                .and_then(|()| block::enable(gauge))
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
            block::enable(gauge)?;
            self.learn_gate(gauge)
        })
    }

    /// Makes the changes, all or none, in one transaction.
    pub fn write(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<Outcome> {
        if let Some(change) = changes.iter().find(|change| change.subclass.kind == Kind::Security) {
            let why = "keys cannot be changed like other parameters";
            return Err(Error::new(change.subject(), Cause::NotPermitted(why.into())).at(Step::Check));
        }
        let outcome = in_time(gauge, waited, |gauge| {
            gauge.claim()?;
            gauge.confirm_identity()?;
            let voltage_mv = voltage(gauge)?;
            let found = gauge.seal()?;
            let mut visit = Visit::new(found);
            let outcome =
                visit.open(gauge).and_then(|()| self.change(gauge, changes, voltage_mv, &mut visit));
            visit.close(gauge, outcome)
        });
        let subject = changes.first().map(Change::subject).unwrap_or_default();
        outcome.map_err(|error| error.within(&subject))
    }

    /// The unsealed part of a write.
    fn change(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        voltage_mv: u16,
        visit: &mut Visit,
    ) -> Result<Outcome> {
        block::enable(gauge)?;
        self.check_gate(gauge, voltage_mv)?;
        let mut dirty = gather(gauge, changes)?;
        // The window holds the block that was read last; where there was only one, it is still there.
        let selected = dirty.len() == 1;
        for change in changes {
            self.check_safe(gauge, change, &dirty, voltage_mv)?;
        }
        dirty.retain(|block| block.old != block.new);
        if dirty.is_empty() {
            return Ok(Outcome::Unchanged);
        }
        let reset = changes.iter().any(|change| change.subclass.kind == Kind::Reset);
        if changes.iter().any(|change| self.is_gate(gauge, change)) {
            self.gate = None;
        }
        let mut touched = 0;
        let forward = dirty.iter().try_for_each(|block| {
            if !selected {
                block::select(gauge, block.place)?;
            }
            store(gauge, block, &mut touched)
        });
        let forward = forward.and_then(|()| {
            if !reset {
                return Ok(());
            }
            visit.now = None;
            block::reset(gauge)?;
            visit.now = Some(reopen(gauge, visit.found)?);
            block::enable(gauge)?;
            dirty.iter().try_for_each(|block| verify_written(gauge, block))
        });
        let Err(error) = forward else { return Ok(Outcome::Written { reset }) };
        if touched == 0 {
            return Err(error);
        }
        visit.now = None;
        gauge.limit(Some(BACK));
        match restore(gauge, &dirty[..touched]) {
            Ok(()) => {
                let why = format!("{error}; the old value was put back and verified");
                Err(Error::new("", Cause::RolledBack(why)))
            }
            Err(second) => {
                let why = format!("{error}; then {second}: what data flash holds is not known");
                Err(Error::new("", Cause::Unknown(why)))
            }
        }
    }

    fn is_gate(&self, gauge: &Gauge, change: &Change) -> bool {
        gauge.chip.gate.as_ref().is_some_and(|gate| {
            let at = (change.subclass.id, change.parameter.offset);
            at == gate.limit || gate.divider.is_some_and(|(subclass, offset, _)| at == (subclass, offset))
        })
    }

    /// Reads what decides whether the gauge stores a block, unless it is known. UNSEALED only.
    fn learn_gate(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(gate) = &gauge.chip.gate else { return Ok(()) };
        if self.gate.is_none() {
            let limit_mv = read_word(gauge, gate.limit.0, gate.limit.1)?;
            let divider = match gate.divider {
                Some((subclass, offset, _)) => read_word(gauge, subclass, offset)?,
                None => 0,
            };
            self.gate = Some((limit_mv, divider));
        }
        Ok(())
    }

    /// Voltage() as the gate compares it: scaled back to one cell where there is a divider.
    fn gate_voltage(&self, gauge: &Gauge, voltage_mv: u16) -> Option<(u32, u16)> {
        let (limit_mv, divider) = self.gate?;
        let scaled = match gauge.chip.gate.as_ref()?.divider {
            Some((_, _, full)) if divider != 0 => u32::from(voltage_mv) * full / u32::from(divider),
            Some(_) | None => u32::from(voltage_mv),
        };
        Some((scaled, limit_mv))
    }

    fn check_gate(&mut self, gauge: &mut Gauge, voltage_mv: u16) -> Result<()> {
        self.learn_gate(gauge)?;
        let Some(gate) = &gauge.chip.gate else { return Ok(()) };
        let Some((scaled_mv, limit_mv)) = self.gate_voltage(gauge, voltage_mv) else { return Ok(()) };
        if scaled_mv >= u32::from(limit_mv) {
            return Ok(());
        }
        let why = format!(
            "the gauge measures {scaled_mv} mV a cell and stores nothing below {limit_mv} mV ({}/{}): charge the \
             pack, or check Voltage Divider",
            gate.limit.0, gate.limit.1
        );
        Err(Error::new("", Cause::NotNow(why)).at(Step::Check))
    }

    /// The limits that are narrower than the manual's.
    fn check_safe(&self, gauge: &Gauge, change: &Change, dirty: &[Dirty], voltage_mv: u16) -> Result<()> {
        let refuse = |why: String| Err(Error::new(change.subject(), Cause::OutOfRange(why)).at(Step::Check));
        let number = integer(change.parameter, &change.bytes);
        match &change.parameter.safe {
            None => Ok(()),
            Some(Safe::AtLeast(least, why)) if number < *least => {
                refuse(format!("{number} is below {least}: {why}"))
            }
            Some(Safe::BelowPresentVoltage(why)) => {
                let present =
                    i64::from(self.gate_voltage(gauge, voltage_mv).map_or(0, |(scaled_mv, _)| scaled_mv));
                if number > present {
                    refuse(format!("{number} is above the present {present} mV: {why}"))
                } else {
                    Ok(())
                }
            }
            Some(Safe::Keep(mask, why)) => {
                let old = integer(change.parameter, &old_bytes(change, dirty));
                let differ = (old ^ number) & i64::from(*mask);
                if differ == 0 {
                    return Ok(());
                }
                refuse(format!("bits 0x{differ:x} must stay as they are: {why}; the word is now 0x{old:x}"))
            }
            Some(Safe::AtLeast(..)) => Ok(()),
        }
    }
}

/// The number that a parameter's bytes stand for; the safe limits are all about integers.
fn integer(parameter: &Parameter, bytes: &[u8]) -> i64 {
    match codec::decode(parameter.kind, bytes) {
        Value::Int(number) => number,
        Value::Float(_) | Value::Text(_) => 0,
    }
}

/// Voltage() in mV, where the part's flash gate asks for it.
fn voltage(gauge: &mut Gauge) -> Result<u16> {
    let register = gauge.chip.register(Role::VoltageNow).filter(|_| gauge.chip.gate.is_some());
    let Some(register) = register else { return Ok(u16::MAX) };
    let mut word = [0; 2];
    gauge.read(register.code, &mut word)?;
    Ok(u16::from_le_bytes(word))
}

fn read_word(gauge: &mut Gauge, subclass: u8, offset: u16) -> Result<u16> {
    let (place, at) = locate(subclass, offset);
    let mut word = [0; 2];
    block::select(gauge, place)?;
    block::read_part(gauge, at, &mut word)?;
    Ok(u16::from_be_bytes(word))
}

fn locate(subclass: u8, offset: u16) -> (Place, usize) {
    let block = u8::try_from(usize::from(offset) / WINDOW).expect("a subclass has few blocks");
    (Place { subclass, block }, usize::from(offset) % WINDOW)
}

fn read_subclass(gauge: &mut Gauge, subclass: &Subclass) -> Result<Vec<u8>> {
    let length = usize::from(subclass.length);
    let mut bytes = Vec::with_capacity(length);
    for start in (0..subclass.length).step_by(WINDOW) {
        let (place, _) = locate(subclass.id, start);
        let window = block::load(gauge, place)?;
        bytes.extend_from_slice(&window[..WINDOW.min(length - bytes.len())]);
    }
    Ok(bytes)
}

/// Reads every block that the changes touch, and patches a copy.
fn gather(gauge: &mut Gauge, changes: &[Change]) -> Result<Vec<Dirty>> {
    let mut dirty: Vec<Dirty> = Vec::new();
    for change in changes {
        for (offset, &byte) in (change.parameter.offset..).zip(&change.bytes) {
            let (place, at) = locate(change.subclass.id, offset);
            let index = match dirty.iter().position(|block| block.place == place) {
                Some(index) => index,
                None => {
                    let old = block::load(gauge, place)?;
                    dirty.push(Dirty { place, old, new: old, written: at..at });
                    dirty.len() - 1
                }
            };
            let block = &mut dirty[index];
            block.new[at] = byte;
            block.written = block.written.start.min(at)..block.written.end.max(at + 1);
        }
    }
    Ok(dirty)
}

fn old_bytes(change: &Change, dirty: &[Dirty]) -> Vec<u8> {
    let places =
        (change.parameter.offset..).take(change.bytes.len()).map(|offset| locate(change.subclass.id, offset));
    places.filter_map(|(place, at)| Some(dirty.iter().find(|block| block.place == place)?.old[at])).collect()
}

/// Writes one block, commits it and reads it back. `touched` counts the blocks that may have been
/// committed: from that moment on the block's content has to be found out, not assumed.
fn store(gauge: &mut Gauge, block: &Dirty, touched: &mut usize) -> Result<()> {
    block::fill(gauge, &block.old, &block.new)?;
    *touched += 1;
    Statistics::count(&gauge.statistics.flash_writes);
    let committed = block::commit(gauge, &block.new);
    // A checksum whose acknowledgement was lost may have done its work all the same.
    verify(gauge, block).map_err(|error| committed.err().unwrap_or(error))
}

/// Selects and reads the block again: the window right after a write shows the buffer, not flash.
fn verify(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let stored = block::load(gauge, block.place).map_err(|error| error.at(Step::Verify))?;
    if stored == block.new {
        return Ok(());
    }
    Err(mismatch(block, &stored))
}

/// After a reset only the written bytes count: the gauge rewrites others itself.
fn verify_written(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let range = block.written.clone();
    let mut stored = block.new;
    block::select(gauge, block.place).map_err(|error| error.at(Step::Verify))?;
    block::read_part(gauge, range.start, &mut stored[range]).map_err(|error| error.at(Step::Verify))?;
    if stored == block.new {
        return Ok(());
    }
    Err(mismatch(block, &stored))
}

fn mismatch(block: &Dirty, stored: &[u8; WINDOW]) -> Error {
    let Place { subclass, block: number } = block.place;
    let why = if *stored == block.old {
        format!("subclass {subclass} block {number}: the gauge acknowledged the write and stored nothing")
    } else {
        let at = (0..WINDOW).find(|&at| stored[at] != block.new[at]).unwrap_or_default();
        let offset = usize::from(number) * WINDOW + at;
        format!(
            "subclass {subclass} offset {offset} reads 0x{:02x}, wrote 0x{:02x}",
            stored[at], block.new[at]
        )
    };
    Error::new("", Cause::Protocol(why)).at(Step::Verify)
}

/// One visit to an unsealed gauge: how it was found, and what is known of its seal state now.
struct Visit {
    found: Seal,
    /// `None` from the moment on in which something may have changed it until it is confirmed.
    now: Option<Seal>,
}

impl Visit {
    fn new(found: Seal) -> Self {
        Self { found, now: Some(found) }
    }

    /// Makes data flash readable.
    fn open(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.found == Seal::Sealed {
            self.now = None;
            gauge.unseal()?;
            self.now = Some(Seal::Unsealed);
        }
        Ok(())
    }

    /// The way out of every transaction: seals as found, confirms it, and reports both failures if there
    /// are two.
    fn close<T>(self, gauge: &mut Gauge, outcome: Result<T>) -> Result<T> {
        gauge.limit(Some(BACK));
        // After a failure nothing is taken for granted: a gauge that lost its power comes back sealed.
        let closed = match self.now.filter(|_| outcome.is_ok()) {
            Some(now) => gauge.go(now, self.found),
            None => gauge.seal().and_then(|now| gauge.go(now, self.found)),
        };
        let found = self.found.as_str();
        match (outcome, closed) {
            (outcome, Ok(())) => outcome,
            (Ok(_), Err(error)) => {
                let why = format!("done, but the gauge could not be left {found} as it was: {error}");
                Err(Error::new("", Cause::Unknown(why)))
            }
            // It does not answer, and nothing was sent that could have changed its state.
            (Err(first), Err(_)) if self.now == Some(self.found) => Err(first),
            (Err(first), Err(second)) => {
                let why = format!("{first}; then the gauge could not be left {found} as it was: {second}");
                Err(Error::new("", Cause::Unknown(why)))
            }
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

/// Waits for the end of a reset and goes back to a state in which data flash can be read.
fn reopen(gauge: &mut Gauge, found: Seal) -> Result<Seal> {
    let Access::Block(times) = &gauge.chip.access;
    let goal = if found == Seal::Sealed { Seal::Unsealed } else { found };
    gauge.wait(times.reset);
    // A part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11): no need to ask first.
    if found == Seal::Sealed && gauge.unseal().is_ok() {
        return Ok(goal);
    }
    let limit = gauge.clock.now() + times.reset_limit;
    loop {
        match gauge.seal() {
            Ok(now) => return gauge.go(now, goal).map(|()| goal),
            Err(_) if gauge.clock.now() < limit => gauge.wait(times.reset),
            Err(error) => return Err(error.at(Step::Reset)),
        }
    }
}

/// Puts the old bytes back where they were written, and nothing else: what the gauge learned meanwhile
/// stays.
fn restore(gauge: &mut Gauge, touched: &[Dirty]) -> Result<()> {
    let mut outcome = Ok(());
    for _ in 0..RESTORES {
        outcome = gauge
            .seal()
            .and_then(|now| if now == Seal::Sealed { gauge.unseal() } else { Ok(()) })
            .and_then(|()| block::enable(gauge))
            .and_then(|()| touched.iter().try_for_each(|block| restore_block(gauge, block)));
        if outcome.is_ok() {
            break;
        }
        gauge.wait(Duration::from_millis(200));
    }
    outcome.map_err(|error| error.at(Step::Restore))
}

fn restore_block(gauge: &mut Gauge, block: &Dirty) -> Result<()> {
    let present = block::load(gauge, block.place)?;
    let mut wanted = present;
    wanted[block.written.clone()].copy_from_slice(&block.old[block.written.clone()]);
    if wanted == present {
        return Ok(());
    }
    let back = Dirty { place: block.place, old: present, new: wanted, written: block.written.clone() };
    store(gauge, &back, &mut 0)
}
