// SPDX-License-Identifier: MIT

//! What is known of the gauge and its pack, and for how long each of that holds. Nothing is written here.

use super::identity::{identify, serial_number};
use super::io;
use super::keyrow::keeps_unseal_key;
use super::pack::{self, Known, Match, NOTHING, compare};
use super::part::Part;
use super::schemes::{Care, sequence};
use super::session::{Reference, Session};
use super::window::{Planned, Window, learned};
use super::{Change, Place, Row};
use crate::chip::{Chip, FLAT, Kind};
use crate::codec::{Bytes, WINDOW};
use crate::epoch::{Epoch, Fact};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal, agreed};
use crate::journal::{Identity, Mark, Plan};

mod gate;
mod now;
mod preflight;

pub(super) use now::Arrival;
use now::{Name, Now, Pack, Values};
use preflight::KnownPack;
pub(super) use preflight::{Found, check_unsealed, learning};

#[derive(Debug, Default)]
pub(super) struct Knowledge {
    now: Now,
    known_pack: Option<KnownPack>,
    doubts: Fact<(), Arrival>,
    identity: Fact<Identity, Name>,
    /// Blocks of this gauge as they were last read or written.
    known: Fact<Known, Pack>,
    /// What distinguishes the pack, from before a time in which it may have been exchanged; empty once compared.
    fingerprint: Fact<Known, Pack>,
    /// Limit and divider of the flash-voltage gate, read while the gauge was unsealed.
    gate: Fact<(i16, u16), Values>,
    /// The signature rows, which show whether the table fits this firmware, have been checked.
    signed: Fact<(), Pack>,
    no_erased_key: Fact<(), Arrival>,
    /// A failed write left its mode on; the next write ends it.
    mode_left_on: bool,
    in_calibration: bool,
}

impl Knowledge {
    pub(super) fn arrival(&self) -> Epoch<Arrival> {
        self.now.arrival
    }

    pub(super) fn forget_pack(&mut self) {
        self.now.forget_pack();
    }

    pub(super) fn forget_values(&mut self) {
        self.now.forget_values();
    }

    pub(super) fn forget_name(&mut self) {
        self.now.forget_name();
    }

    pub(super) fn forget_block(&mut self, place: Window) {
        self.known.in_epoch(self.now.pack).forget(place);
    }

    /// The gauge is about to rewrite these blocks, which may hold marks: those count until they are compared.
    pub(super) fn expect_rewritten(&mut self, chip: &'static Chip, blocks: &[Planned]) {
        let fingerprint = self.fingerprint_now(chip);
        blocks.iter().for_each(|block| self.forget_block(block.place));
        self.fingerprint.learn(self.now.pack, fingerprint);
    }

    pub(super) fn note_settled(&mut self) {
        self.now.forget_pack();
        if let Some(known_pack) = &mut self.known_pack {
            known_pack.rewritten();
        }
    }

    pub(super) fn note_another(&mut self) {
        self.now.forget_pack();
        self.doubt_pack();
    }

    pub(super) fn note_mode_left_on(&mut self) {
        self.mode_left_on = true;
    }

    pub(super) fn note_calibration(&mut self, is_on: bool) {
        self.in_calibration |= is_on;
    }

    pub(super) fn left_calibration(&mut self, is_on: bool) {
        self.in_calibration &= is_on;
    }

    pub(super) fn may_calibrate(&self) -> bool {
        self.in_calibration
    }

    pub(super) fn refuses_erased_key(&self) -> bool {
        self.no_erased_key.is_known(self.now.arrival)
    }

    pub(super) fn note_refused_erased_key(&mut self) {
        self.no_erased_key.learn(self.now.arrival, ());
    }

    /// Forgets what was read of a pack that may have been exchanged, but for what distinguishes it.
    pub(super) fn suspect(&mut self, chip: &'static Chip) {
        let fingerprint = self.fingerprint_now(chip);
        self.now.forget_pack();
        // An exchange of a gauge with RAM is a loss of power, which it reports.
        if chip.volatile.is_none() {
            self.fingerprint.learn(self.now.pack, fingerprint);
        }
    }

    pub(super) fn fingerprint_now(&self, chip: &'static Chip) -> Known {
        let mut fingerprint = self.fingerprint().clone();
        for place in pack::mark_windows(chip) {
            if let Some(content) = self.known().get(place) {
                fingerprint.note(chip, place, content);
            }
        }
        fingerprint
    }

    pub(super) fn compare(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.fingerprint().is_empty() || gauge.seal()? == Seal::Sealed {
            return Ok(());
        }
        sequence(gauge).enable(gauge)?;
        self.learn_marks(gauge).map(drop)
    }

    /// Reads, once after an arrival, what distinguishes the pack. Returns what shows another one, which is then in doubt.
    pub(super) fn learn_marks(&mut self, gauge: &mut Gauge) -> Result<Option<Row>> {
        let mut other = None;
        for place in self.unread_marks(gauge.chip) {
            let content = sequence(gauge).load(gauge, place, Care::Quick)?;
            other = other.or(self.fingerprint().contradicts(gauge.chip, place, &content));
            self.note_block(gauge, place, content);
        }
        self.fingerprint = Fact::default();
        if other.is_some() {
            self.doubt_pack();
        }
        Ok(other)
    }

    /// The blocks that [`Self::learn_marks`] is about to read.
    pub(super) fn unread_marks(&self, chip: &'static Chip) -> Vec<Window> {
        let windows = pack::mark_windows(chip).into_iter();
        windows.filter(|place| self.known().get(*place).is_none()).collect()
    }

    /// Reads a part of a subclass. Blocks of it that this session has just `read` are taken as they were then; subclasses of a
    /// flat part share some. Also returns what shows that it is another pack, which is in doubt then.
    pub(super) fn read_part(
        &mut self,
        gauge: &mut Gauge,
        part: &Part,
        read: &mut Vec<Window>,
    ) -> Result<(Vec<u8>, Option<Row>)> {
        let (chip, known, mut other) = (gauge.chip, self.known().only(read), None);
        let bytes = io::read(gauge, part, &known, |place, content| {
            read.push(place);
            let row = self.contradicted_mark(chip, place, content).filter(|_| chip.volatile.is_none());
            if let Some(row) = row {
                other = other.or(Some(row));
                self.now.forget_pack();
                self.doubt_pack();
            }
            self.known.in_epoch(self.now.pack).note(chip, place, *content);
        });
        bytes.map(|bytes| (bytes, other))
    }

    pub(super) fn note_block(&mut self, gauge: &Gauge, place: Window, content: [u8; WINDOW]) {
        self.known.in_epoch(self.now.pack).note(gauge.chip, place, content);
    }

    pub(super) fn known(&self) -> &Known {
        self.known.get(self.now.pack).unwrap_or(&NOTHING)
    }

    fn fingerprint(&self) -> &Known {
        self.fingerprint.get(self.now.pack).unwrap_or(&NOTHING)
    }

    pub(super) fn recognise(&mut self, gauge: &Gauge, place: Window, content: &[u8; WINDOW]) -> Result<()> {
        let Some(row) = self.contradicted_mark(gauge.chip, place, content) else {
            self.note_block(gauge, place, *content);
            return Ok(());
        };
        Err(self.other_pack(gauge, row))
    }

    /// The mark in a block just read that contradicts this pack, or what a suspected pack was known by, not yet compared.
    fn contradicted_mark(&self, chip: &'static Chip, place: Window, content: &[u8; WINDOW]) -> Option<Row> {
        [self.known(), self.fingerprint()].iter().find_map(|before| before.contradicts(chip, place, content))
    }

    pub(super) fn other_pack(&mut self, gauge: &Gauge, row: Row) -> Error {
        let why = format!(
            "{} ({}) is not what it was when it was read: another pack answers, or another program has written to \
             it; check its values before you write",
            row.1.name,
            Place::of(row)
        );
        self.now.forget_pack();
        self.doubt_pack();
        Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Identify)
    }

    /// The blocks beside those that change, where known. With flat addresses they are read: bytes may have no name there.
    pub(super) fn neighbours(&mut self, gauge: &mut Gauge, planned: &[Planned]) -> Result<Vec<Planned>> {
        for place in planned.iter().flat_map(|block| pack::neighbours(gauge.chip, block.place)) {
            if place.subclass == FLAT && self.known().get(place).is_none() {
                // Beyond the end of data flash there is none.
                if let Ok(content) = sequence(gauge).load(gauge, place, Care::Sure) {
                    self.note_block(gauge, place, content);
                }
            }
        }
        Ok(self.known_neighbours(gauge.chip, planned))
    }

    pub(super) fn known_neighbours(&self, chip: &'static Chip, planned: &[Planned]) -> Vec<Planned> {
        let mut found: Vec<Planned> = Vec::new();
        let apart = |one: Window, other: Window| {
            one.subclass != other.subclass || one.base.abs_diff(other.base) >= WINDOW as u16
        };
        for place in planned.iter().flat_map(|block| pack::neighbours(chip, block.place)) {
            let is_new = found.iter().all(|block| apart(block.place, place))
                && planned.iter().all(|block| apart(block.place, place));
            if let Some(content) = self.known().get(place).filter(|_| is_new) {
                let learned = learned(chip, place);
                found.push(Planned { place, old: content, new: content, written: Bytes::default(), learned });
            }
        }
        found
    }

    pub(super) fn marks(&self, chip: &'static Chip) -> Vec<Mark> {
        let known = if self.fingerprint().is_empty() { self.known() } else { self.fingerprint() };
        known.marks(chip)
    }

    pub(super) fn refer(&mut self, gauge: &Gauge, session: &mut Session) {
        let Some(entry) = &session.entry else { return };
        let mut reference = Reference::of(entry);
        if entry.owes_seal() {
            reference.plan.marks = self.marks(gauge.chip);
        }
        session.pack.pack = Some(reference);
    }

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

    pub(super) fn is_certain(&mut self, gauge: &mut Gauge) -> Result<bool> {
        let plan = Plan::of_marks(self.marks(gauge.chip));
        let Some(then) = self.identity.get(self.now.name).cloned() else { return Ok(false) };
        let now = identify(gauge)?;
        sequence(gauge).enable(gauge)?;
        let same =
            compare(gauge.chip, &then, &now, &plan, |place| sequence(gauge).load(gauge, place, Care::Sure))?;
        Ok(then.is_of_part(&now, gauge.chip) && same == Match::Certain)
    }

    /// Refuses a reset that may seal an open gauge for good: its key must have worked, or be what FULL ACCESS shows.
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
