// SPDX-License-Identifier: MIT

//! Whether the gauge that answers is still the pack of the session. Nothing is programmed, reset or sealed otherwise.
//!
//! While the presence of the gauge is unbroken it is the same one. After a break its marks are compared: a calibration or
//! serial number of its own shows the pack. Packs as from the factory cannot be told apart by that; of these only a block
//! with a part of what this write was about to store is a sign. Without one flash is left alone, and a person decides.

use std::time::Duration;

use super::{RESTORES, Session};
use crate::chip::KeyStorage;
use crate::dataflash::identity::identify;
use crate::dataflash::io::still_open;
use crate::dataflash::keyrow::keeps_unseal_key;
use crate::dataflash::pack::{self, Match};
use crate::dataflash::planned::{Held, look_at};
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::state::has_lost_memory;
use crate::dataflash::window::Planned;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Moment, Seal};
use crate::journal::{Entry, Identity, Plan};

/// Attempts to send SEALED between two moments without an answer, and their interval: half of what a row takes.
const SEALS: u32 = 6;
const BUSY: Duration = Duration::from_millis(100);

pub(in crate::dataflash) struct Reference {
    pub(in crate::dataflash) identity: Identity,
    pub(in crate::dataflash) plan: Plan,
}

impl Reference {
    pub(in crate::dataflash) fn of(entry: &Entry) -> Self {
        let nothing = || Plan::of_marks(Vec::new());
        Self { identity: entry.identity.clone(), plan: entry.plan.clone().unwrap_or_else(nothing) }
    }
}

#[derive(Default)]
pub(in crate::dataflash) struct Assurance {
    pub(in crate::dataflash) pack: Option<Reference>,
    /// When it was certain that the gauge is the one of the session.
    since: Option<Moment>,
    /// How often it was compared, for which other blocks are loaded.
    pub(in crate::dataflash) compared: u32,
    /// It has to be compared once more, even if its presence is unbroken.
    anew: bool,
    /// That was certain once before.
    was_broken: bool,
    pub(in crate::dataflash) is_another: bool,
    is_unsure: bool,
    /// It was SEALED, and opened by this session with its key.
    pub(in crate::dataflash) was_opened: bool,
    /// Why the gauge that answers is left open: its owner could not open it again.
    pub(in crate::dataflash) left_open: Option<String>,
}

impl Assurance {
    pub(in crate::dataflash) fn begin(&mut self, gauge: &Gauge) {
        self.was_broken |= self.since.is_some() && !self.is_unbroken(gauge);
        self.since = Some(gauge.moment());
    }

    pub(in crate::dataflash) fn has_come(&self, gauge: &Gauge) -> bool {
        self.is_another && (self.was_broken || !self.is_unbroken(gauge))
    }

    pub(in crate::dataflash) fn certain_since(&mut self, moment: Moment) {
        self.since = Some(moment);
    }

    pub(in crate::dataflash) fn since(&self) -> Option<Moment> {
        self.since
    }

    /// Whatever is known of the gauge does not apply to the one that answers now.
    pub(in crate::dataflash) fn mark_exchanged(&mut self) {
        self.is_another = true;
    }

    pub(in crate::dataflash) fn is_lost(&self) -> bool {
        self.is_another || self.is_unsure
    }

    fn is_unbroken(&self, gauge: &Gauge) -> bool {
        self.since.is_some_and(|moment| gauge.is_unbroken_since(moment))
    }
}

impl Session {
    /// Looks at the pack before the first byte goes back: what has failed may be that it is another one.
    pub(in crate::dataflash) fn assure_anew(&mut self, gauge: &mut Gauge) {
        self.pack.anew = true;
        gauge.doubt();
    }

    /// Makes sure that the open gauge is still the session's pack. What changes it is bound to the moment returned.
    pub(in crate::dataflash) fn assure(&mut self, gauge: &mut Gauge) -> Result<Moment> {
        if !self.pack.anew
            && let Some(moment) = self.pack.since
            && gauge.is_unbroken_since(moment)
        {
            return Ok(moment);
        }
        for _ in 0..RESTORES {
            still_open(gauge)?;
            let unbroken = self.pack.is_unbroken(gauge);
            if unbroken && !self.pack.anew {
                return Ok(gauge.moment());
            }
            let (compared, moment) = self.compare_since(gauge)?;
            let certain = match &compared {
                Match::Certain => true,
                Match::Weak => unbroken && self.pack.is_unbroken(gauge) || self.holds_a_part(gauge)?,
                Match::Other(_) => false,
            };
            if !gauge.is_unbroken_since(moment) {
                continue;
            }
            if certain {
                (self.pack.since, self.pack.anew) = (Some(moment), false);
                return Ok(moment);
            }
            return Err(self.other_pack_error(gauge, compared));
        }
        let why = "it falls silent again and again, so its pack cannot be compared with the one before";
        Err(Error::new(gauge.chip.model, Cause::NotNow, why).at(Step::Identify))
    }

    fn other_pack_error(&mut self, gauge: &Gauge, compared: Match) -> Error {
        let error = |cause, why: String| Error::new(gauge.chip.model, cause, why).at(Step::Identify);
        match compared {
            Match::Other(name) => {
                self.pack.is_another = true;
                let why = format!(
                    "{name} is not what it was a moment ago: another pack answers, and nothing was written to it"
                );
                error(Cause::Gone, why)
            }
            Match::Certain | Match::Weak => {
                self.pack.is_unsure = true;
                let why = "it was away for a moment, and has the serial number and the calibration of every new pack, \
                           so it may be another one: nothing more was written";
                error(Cause::NotNow, why.into())
            }
        }
    }

    fn compare(&mut self, gauge: &mut Gauge) -> Result<Match> {
        self.compare_since(gauge).map(|(compared, _)| compared)
    }

    fn compare_since(&mut self, gauge: &mut Gauge) -> Result<(Match, Moment)> {
        self.pack.compared += 1;
        let mut moment = gauge.moment();
        let Some(Reference { identity, plan }) = &self.pack.pack else { return Ok((Match::Weak, moment)) };
        let now = match identify(gauge) {
            Err(error) if matches!(error.cause(), Cause::Gone) => {
                return Ok((Match::Other("the part".into()), moment));
            }
            now => now?,
        };
        if !identity.is_of_part(&now, gauge.chip) {
            return Ok((Match::Other("the part or its firmware".into()), moment));
        }
        if gauge.chip.access.scheme.is_flat() && gauge.chip.serial_register().is_none() {
            // Only marks tell packs of these parts apart, and a subcommand hides what was selected.
            gauge.learn_selection();
            moment = gauge.moment();
        }
        if !plan.marks.is_empty() {
            sequence(gauge).enable(gauge)?;
        }
        let same = pack::compare(gauge.chip, identity, &now, plan, |place| {
            sequence(gauge).load(gauge, place, Care::Sure)
        })?;
        // What it was known by is lost with its memory.
        let is_lost = matches!(same, Match::Other(_)) && has_lost_memory(gauge)?;
        Ok((if is_lost { Match::Weak } else { same }, moment))
    }

    /// Whether a block holds a part of what was about to be stored, and none holds anything else: no other pack does.
    fn holds_a_part(&self, gauge: &mut Gauge) -> Result<bool> {
        let Some(Reference { plan, .. }) = &self.pack.pack else { return Ok(false) };
        let seen = look_at(gauge, plan)?;
        let changed = |block: &Planned| !block.is_neighbour();
        let torn = seen.iter().any(|seen| seen.held == Held::Torn && changed(&seen.block));
        Ok(torn && seen.iter().all(|seen| seen.held != Held::Unexplained))
    }

    pub(in crate::dataflash) fn is_another(&mut self, gauge: &mut Gauge) -> bool {
        if !self.pack.is_another
            && self.pack.since.is_some()
            && !self.pack.is_unbroken(gauge)
            && gauge.seal().is_ok_and(|now| now != Seal::Sealed)
            && !self.pack.is_unbroken(gauge)
        {
            self.pack.is_another = matches!(self.compare(gauge), Ok(Match::Other(_)));
        }
        self.pack.is_another
    }

    /// Seals the gauge, if it is the session's or is known to open again: else its owner may not be able to open it.
    pub(in crate::dataflash) fn seal(&mut self, gauge: &mut Gauge) -> Result<()> {
        let mut outcome = Ok(());
        for attempt in 0..SEALS {
            // It is busy with a row of its own.
            if attempt > 0 {
                gauge.wait(BUSY);
            }
            outcome = match self.may_seal(gauge) {
                // It has just taken the keys, and is silent for seconds after some of them.
                Ok(Some(_)) if self.patience.is_some() => gauge.close(),
                Ok(Some(moment)) => gauge.close_since(moment),
                Ok(None) => return Ok(()),
                Err(error) => Err(error),
            };
            // A break between the permission and the command; otherwise everything was tried.
            if !outcome.as_ref().is_err_and(|error| matches!(error.cause(), Cause::NotNow)) {
                break;
            }
        }
        outcome
    }

    /// Since when it is known that the gauge may be sealed; `None` if it is SEALED, and nothing has to be sent.
    fn may_seal(&mut self, gauge: &mut Gauge) -> Result<Option<Moment>> {
        if !self.pack.is_another && self.pack.is_unbroken(gauge) {
            return Ok(self.pack.since);
        }
        // A key in ROM fits every gauge of its kind.
        let is_in_rom = gauge.chip.volatile.is_some();
        let is_allowed = is_in_rom || !self.pack.is_another || self.pack.was_opened;
        if is_in_rom || is_allowed && gauge.was_opened() {
            return Ok(Some(gauge.moment()));
        }
        let now = gauge.seal_anew().map_err(|error| error.at(Step::Seal))?;
        let moment = gauge.moment();
        if is_allowed && gauge.was_opened() {
            return Ok(Some(moment));
        }
        if now == Seal::Sealed {
            gauge.wait(gauge.chip.security.shows);
            if gauge.seal()? == Seal::Sealed {
                return self.assure_sealed(gauge).map(|()| None);
            }
        }
        let compared = match self.pack.is_another {
            true => Match::Other("its pack".into()),
            false => match self.compare(gauge) {
                // Another pack that is open could be read.
                Err(_) if self.pack.was_opened && gauge.key_has_worked() && self.is_alike(gauge) => {
                    return Ok(Some(gauge.moment()));
                }
                compared => compared?,
            },
        };
        let why = match compared {
            Match::Certain => {
                self.pack.since = Some(moment);
                return Ok(Some(moment));
            }
            Match::Other(name) => {
                self.pack.is_another = true;
                format!("{name} is another one, so another pack answers; it is open and is left as it is")
            }
            // Keys in ROM are those of the manual; where they are kept otherwise no document says how to change them.
            Match::Weak if matches!(gauge.chip.security.storage, KeyStorage::Fixed(_)) => {
                return Ok(Some(moment));
            }
            Match::Weak if self.goes_by_keys() => return Ok(Some(moment)),
            Match::Weak if self.is_known_to_open(gauge)? => return Ok(Some(gauge.moment())),
            Match::Weak => {
                let place = &gauge.key_file;
                format!(
                    "it is open and may be another pack, whose key is not known, so it is left open; seal it (echo sealed \
                     > gauge/seal) if the key in {place} is its own"
                )
            }
        };
        self.pack.left_open = Some(why.clone());
        Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Seal))
    }

    pub(in crate::dataflash) fn is_plainly_another(&mut self, gauge: &mut Gauge, now: Seal) -> Result<bool> {
        // What a gauge with RAM was known by may be lost with its power.
        if gauge.chip.volatile.is_some()
            && let Some(pack) = &mut self.pack.pack
        {
            pack.plan.marks.clear();
        }
        let marks = self.pack.pack.as_ref().is_some_and(|pack| !pack.plan.marks.is_empty());
        let has_key = !self.goes_by_keys();
        if now == Seal::Sealed && !has_key {
            return Ok(false);
        }
        if marks && now == Seal::Sealed {
            gauge.unseal()?;
            self.pack.was_opened = true;
        }
        self.pack.is_another = matches!(self.compare(gauge)?, Match::Other(_));
        Ok(self.pack.is_another)
    }

    /// Goes to the seal state in which the gauge was found, which was open. Another pack is left as it is now.
    pub(in crate::dataflash) fn go_to_found(&mut self, gauge: &mut Gauge) -> Result<()> {
        let now = gauge.seal_anew()?;
        if !self.pack.is_another && (self.pack.is_unbroken(gauge) || now == self.found) {
            return gauge.go(now, self.found);
        }
        if now == Seal::Sealed && !self.pack.is_another {
            gauge.unseal()?;
            self.pack.was_opened = true;
        }
        let compared = match self.pack.is_another {
            true => Match::Other("its pack".into()),
            false => self.compare(gauge)?,
        };
        match compared {
            Match::Certain => gauge.go_to(self.found),
            // The way from FULL ACCESS to UNSEALED leads through SEALED.
            Match::Weak if now == Seal::Sealed || gauge.chip.volatile.is_some() || self.goes_by_keys() => {
                gauge.go_to(self.found)
            }
            Match::Weak => Ok(()),
            Match::Other(_) => {
                self.pack.is_another = true;
                gauge.seal()?;
                if self.pack.was_opened && gauge.was_opened() { gauge.close() } else { Ok(()) }
            }
        }
    }

    /// Whether it is of keys, which themselves show whether the gauge is the one.
    fn goes_by_keys(&self) -> bool {
        self.patience.is_some() || self.entry.as_ref().is_some_and(Entry::changes_keys)
    }

    fn is_alike(&self, gauge: &mut Gauge) -> bool {
        let pack = self.pack.pack.as_ref();
        pack.is_some_and(|pack| identify(gauge).is_ok_and(|now| now == pack.identity))
    }

    /// Makes sure that a gauge which is SEALED without our doing is not another pack while that of the session is open.
    fn assure_sealed(&mut self, gauge: &mut Gauge) -> Result<()> {
        if !(self.pack.was_opened || gauge.key_has_worked()) || self.pack.pack.is_none() {
            return Ok(());
        }
        gauge.unseal()?;
        let compared = self.compare(gauge);
        let moment = gauge.moment();
        gauge.close_since(moment)?;
        match compared? {
            Match::Certain | Match::Weak => Ok(()),
            Match::Other(name) => {
                self.pack.is_another = true;
                let why = format!("{name} is another one, so another pack answers, and this one may be open");
                Err(Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Seal))
            }
        }
    }

    fn is_known_to_open(&mut self, gauge: &mut Gauge) -> Result<bool> {
        if gauge.seal()? != Seal::FullAccess {
            match gauge.full_access() {
                Err(error) if matches!(error.cause(), Cause::NotPermitted) => return Ok(false),
                opened => opened?,
            }
        }
        keeps_unseal_key(gauge)
    }
}
