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
use std::time::Duration;

use crate::chip::{Chip, FLAT, Kind, Parameter, Safe, Subclass};
use crate::codec;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Identity, Journal};
use crate::value::Value;

mod blocks;
mod checks;
mod io;
mod keychange;
mod preflight;
mod schemes;
mod session;
mod settle;
mod wear;

use blocks::{blocks, gather};
use checks::{integer, is_gate};
use io::{read_subclass, store, verify_written};
use preflight::{Found, KnownPack};
use schemes::sequence;
use session::{BACK, Session, in_time};
use wear::Wear;

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
    known_pack: Option<KnownPack>,
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
            let mut session = Session::new(found);
            let read = session
                .open(gauge)
                .and_then(|()| {
                    wanted.iter().map(|subclass| read_subclass(gauge, subclass)).collect::<Result<_>>()
                })
                .and_then(|bytes| self.learn_gate(gauge).map(|()| bytes));
            session.close(gauge, read)
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

    /// One session, after whatever an earlier one has left behind.
    fn transact(&mut self, gauge: &mut Gauge, changes: &[Change], waited: Duration) -> Result<Outcome> {
        let waited = self.settle_first(gauge, waited)?;
        in_time(gauge, waited, |gauge| {
            gauge.claim()?;
            let found = self.preflight(gauge, changes)?;
            let mut session = Session::new(found.seal);
            if let Some(journal) = self.journal.clone() {
                let identity = self.identity(gauge)?;
                session.journal = Some(journal.begin(identity, session.found, blocks(changes))?);
            }
            let outcome =
                session.open(gauge).and_then(|()| self.change(gauge, changes, &found, &mut session));
            session.close(gauge, outcome)
        })
    }

    /// The unsealed part of a write.
    fn change(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        found: &Found,
        session: &mut Session,
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
        if let Some(journal) = &mut session.journal {
            let plan = settle::plan(gauge, reset, &dirty);
            journal.plan(&plan)?;
            self.identity = self.identity.filter(|_| plan.serial.is_none());
        }
        gauge.statistics.progress.begin(dirty.len());
        session.begin(gauge)?;
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
            session.finish(gauge)?;
            dirty.iter().try_for_each(|block| verify_written(gauge, block))
        });
        let Err(error) = forward else { return Ok(Outcome::Written { reset }) };
        if touched == 0 {
            return Err(error);
        }
        session.now = None;
        gauge.limit(Some(BACK));
        match session.restore(gauge, &dirty[..touched], finished) {
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
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.subclass {
            FLAT => write!(f, "flash/0x{:04x}", self.offset),
            id => write!(f, "{id}/{}", self.offset),
        }
    }
}
