//! Settles interrupted writes: those cut short by a power loss of the host or by a gauge that did not
//! return in time. The journal holds the seal state and the blocks from before the write.

use std::path::PathBuf;
use std::time::Duration;

use super::DataFlash;
use super::blocks::{Dirty, Window, locate};
use super::io::verify_written;
use super::preflight::read_word;
use super::schemes::sequence;
use super::session::{Session, in_time};
use crate::chip::{Chip, FLAT, Kind, Role, Word};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Identity, OpenJournal, Plan, PlannedBlock};

/// Which content a block has.
enum Held {
    Old,
    New,
    /// Some of both, or neither.
    Torn,
}

impl DataFlash {
    /// Identity of the gauge for the journal, read on first use after the gauge was connected.
    pub(super) fn identity(&mut self, gauge: &mut Gauge) -> Result<Identity> {
        if let Some(identity) = self.identity {
            return Ok(identity);
        }
        let firmware = match self.known_pack {
            Some(known_pack) => known_pack.firmware_version,
            None => gauge.firmware_version()?,
        };
        let chip = gauge.chip;
        let identity = Identity {
            chip: chip.name,
            device_type: chip.identity.device_type,
            firmware,
            serial: serial_number(gauge)?,
        };
        self.identity = Some(identity);
        Ok(identity)
    }

    /// Settles an interrupted write: data flash then holds all old values or all new ones, and the gauge is
    /// sealed at least as it was before the write. Returns a message for the log; `None` if there was
    /// nothing to settle.
    pub fn settle(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let Some(journal) = self.journal.clone() else { return Ok(None) };
        let identity = self.identity(gauge)?;
        let Some((path, entry)) = journal.pending(identity)? else { return Ok(None) };
        let settled = in_time(gauge, waited, |gauge| {
            gauge.claim()?;
            gauge.confirm_identity()?;
            let now = gauge.seal()?;
            // A gauge that was unsealed and has been sealed since stays sealed.
            let mut session = Session::new(if entry.found == Seal::Sealed { Seal::Sealed } else { now });
            session.now = None;
            session.journal = Some(OpenJournal::reopen(path)?);
            let outcome = if now == Seal::Sealed { gauge.unseal() } else { Ok(()) };
            let outcome = outcome
                .and_then(|()| sequence(gauge).enable(gauge))
                .and_then(|()| settle(gauge, &mut session, entry.plan.as_ref()));
            if outcome.is_err() {
                // The file stays: nothing has been settled.
                session.journal = None;
            }
            session.close(gauge, outcome)
        });
        // The settled write may have changed the serial number.
        self.identity = None;
        settled.map(Some).map_err(|error| error.within("cannot settle an interrupted write"))
    }

    /// Settles an interrupted write before a new one and logs it. Returns the time since the new write was
    /// requested.
    pub(super) fn settle_first(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Duration> {
        let begun = gauge.clock.now();
        if let Some(message) = self.settle(gauge, waited)? {
            log::warn!("{}: {message}", gauge.chip.name);
        }
        Ok(waited + (gauge.clock.now() - begun))
    }

    /// Journals of other gauges that were connected here before; they are not touched.
    pub fn journals_of_others(&mut self, gauge: &mut Gauge) -> Result<Vec<PathBuf>> {
        let Some(journal) = self.journal.clone() else { return Ok(Vec::new()) };
        Ok(journal.others(self.identity(gauge)?))
    }
}

/// What the next start needs to settle this write, without keys.
pub(super) fn plan(gauge: &Gauge, reset: bool, dirty: &[Dirty]) -> Plan {
    let blocks = dirty.iter().map(|block| {
        let (mut old, mut new) = (block.old, block.new);
        for at in (0..WINDOW).filter(|&at| is_secret(gauge, block.place, at)) {
            (old[at], new[at]) = (0, 0);
        }
        let Window { subclass, base } = block.place;
        PlannedBlock { subclass, base, written: (block.written.start, block.written.end), old, new }
    });
    let serial = serial(gauge.chip).and_then(|(_, (subclass, offset))| {
        let (place, at) = locate(subclass, 0, offset);
        let block = dirty.iter().find(|block| block.place == place)?;
        Some(u16::from_be_bytes([block.new[at], block.new[at + 1]]))
    });
    Plan { reset, serial, blocks: blocks.collect() }
}

/// The register that distinguishes packs, and the row it shows. A chemistry ID is no serial number.
fn serial(chip: &Chip) -> Option<(u8, (u8, u16))> {
    let pack = chip.preflight.pack.as_ref()?;
    match pack.word {
        Word::Register(code) => Some((code, *pack.rows.first()?)),
        Word::ControlStatus | Word::Answer(_) => None,
    }
}

/// The serial number, read until two reads agree because I2C has no error detection.
fn serial_number(gauge: &mut Gauge) -> Result<u16> {
    let Some((register, _)) = serial(gauge.chip) else { return Ok(0) };
    let mut read = || read_word(gauge, Word::Register(register));
    let mut last = read()?;
    for _ in 0..3 {
        let next = read()?;
        if next == last {
            return Ok(next);
        }
        last = next;
    }
    let why = "the serial number reads differently each time: check the bus".to_string();
    Err(Error::new("SerialNumber()", Cause::Protocol(why)).at(Step::Identify))
}

fn settle(gauge: &mut Gauge, session: &mut Session, plan: Option<&Plan>) -> Result<String> {
    let Some(plan) = plan else {
        return Ok("a write was interrupted before anything was written".into());
    };
    if has_lost_memory(gauge)? {
        return Ok(
            "a write was interrupted, and the gauge has since lost power and with it its data memory".into()
        );
    }
    let (mut torn, mut old, mut new) = (Vec::new(), Vec::new(), Vec::new());
    for block in &plan.blocks {
        let place = Window { subclass: block.subclass, base: block.base };
        let stored = sequence(gauge).load(gauge, place)?;
        let mut block =
            Dirty { place, old: block.old, new: block.new, written: block.written.0..block.written.1 };
        for at in (0..WINDOW).filter(|&at| is_secret(gauge, place, at)) {
            (block.old[at], block.new[at]) = (stored[at], stored[at]);
        }
        match classify(gauge, &block, &stored) {
            Held::Old => old.push(block),
            Held::New => new.push(block),
            Held::Torn => torn.push(block),
        }
    }
    // The mode that the write started may still be on; `begin` detects that.
    if sequence(gauge).always_finishes() {
        session.begin(gauge)?;
    }
    let finishes = plan.reset || sequence(gauge).always_finishes();
    if torn.is_empty() && new.is_empty() {
        return Ok("a write was interrupted; data flash holds the old values".into());
    }
    if torn.is_empty() && old.is_empty() {
        if finishes {
            session.finish(gauge)?;
            new.iter().try_for_each(|block| verify_written(gauge, block))?;
        }
        return Ok("a write was interrupted after its last block; it has been finished and verified".into());
    }
    let unknown =
        |error: Error| Error::new("", Cause::StateUnknown(format!("{error}: data flash contents unknown")));
    // Torn blocks are restored as a whole; of the others only the written bytes, which keeps what the gauge
    // has learned since.
    session.restore(gauge, &torn, false).map_err(unknown)?;
    session.restore(gauge, &new, true).map_err(unknown)?;
    if finishes {
        session.finish(gauge).map_err(unknown)?;
    }
    for block in torn.into_iter().chain(new).chain(old) {
        let back = Dirty { new: block.old, ..block };
        verify_written(gauge, &back).map_err(|error| unknown(error.at(Step::Restore)))?;
    }
    Ok("a write was interrupted half way; the old values were restored and verified".into())
}

fn classify(gauge: &Gauge, block: &Dirty, stored: &[u8; WINDOW]) -> Held {
    let Dirty { place, old, new, .. } = block;
    let (mut all_old, mut all_new) = (true, true);
    for at in 0..WINDOW {
        if old[at] != new[at] {
            all_old &= stored[at] == old[at];
            all_new &= stored[at] == new[at];
        } else if stored[at] != old[at] && !is_learned(gauge, *place, at) {
            return Held::Torn;
        }
    }
    match (all_old, all_new) {
        (true, _) => Held::Old,
        (_, true) => Held::New,
        _ => Held::Torn,
    }
}

/// Whether the gauge's data memory is RAM and was lost.
fn has_lost_memory(gauge: &mut Gauge) -> Result<bool> {
    let chip = gauge.chip;
    let Some((lost, flags)) = chip.volatile.zip(chip.register(Role::Flags)) else { return Ok(false) };
    Ok(read_word(gauge, Word::Register(flags.code))? & lost != 0)
}

/// Whether a byte of a window belongs to a key. Only a flat window can extend beyond its own subclass.
fn is_secret(gauge: &Gauge, place: Window, at: usize) -> bool {
    let address = usize::from(place.base) + at;
    gauge.chip.subclasses.iter().filter(|row| row.kind == Kind::Security && row.id == place.subclass).any(
        |row| {
            let start = if row.id == FLAT { usize::from(row.start()) } else { 0 };
            (start..start + usize::from(row.length)).contains(&address)
        },
    )
}

/// Whether the gauge itself updates a byte of a window.
fn is_learned(gauge: &Gauge, place: Window, at: usize) -> bool {
    let offset = usize::from(place.base) + at;
    let rows = gauge.chip.subclasses.iter().filter(|row| row.id == place.subclass);
    rows.flat_map(|row| row.parameters).filter(|parameter| parameter.learned).any(|parameter| {
        let start = usize::from(parameter.offset);
        (start..start + parameter.kind.size()).contains(&offset)
    })
}
