// SPDX-License-Identifier: MIT

//! What the pack of a gauge with RAM learns: when it is looked at, whose it is, and what of it belongs into the profile.

use std::time::Duration;

use jiff::Timestamp;

use super::access::Access;
use super::claim::Claim;
use super::handle::Shared;
use super::learned::{EVERY, implausible, is_design};
use super::{Attempt, Learned, Version};
use crate::error::{Cause, Error, Result};
use ti_gauge::chip::{Chip, Row, Stays, Subclass};
use ti_gauge::dataflash::{self, Change};
use ti_gauge::gauge::Seal;
use ti_gauge::image::{Entry, Image};
use ti_gauge::value::Value;

/// Least time between two looks at a gauge that is SEALED, which is opened for it.
pub(super) const EVERY_SEALED: Duration = Duration::from_secs(60 * 60);
/// The first look comes early: a gauge learns while the host is off, too, and not every host is on for long.
pub(super) const FIRST: Duration = Duration::from_secs(60);

#[derive(Debug)]
pub(super) struct Learning {
    /// See [`super::Run::learned`], of a gauge with RAM.
    store: Option<Learned>,
    /// Says whose pack the gauge has, while it is certain that it has it.
    claim: Option<Claim>,
    /// Another gauge has that pack as well.
    is_contested: bool,
    /// It was not restored, because another gauge has the pack as well.
    is_owed: bool,
    next_look: Option<Duration>,
    /// What was found there first since the gauge has come, or was written.
    first: Option<Vec<Change>>,
}

pub(super) enum Due {
    Nothing,
    /// It was not restored, and can be.
    Restoration,
    Look,
}

pub(super) enum Look {
    /// Nothing was learned, or no plausible value.
    Nothing,
    Learned(Image),
    /// The gauge has lost its memory unnoticed.
    Lost,
}

impl Learning {
    pub(super) fn new(store: Option<Learned>) -> Self {
        Self { store, claim: None, is_contested: false, is_owed: false, next_look: None, first: None }
    }

    #[cfg(test)]
    pub(super) fn store(&self) -> Option<Learned> {
        self.store.clone()
    }

    pub(super) fn is_stored(&self) -> bool {
        self.store.is_some()
    }

    pub(super) fn pack_name(&self) -> Option<&str> {
        self.store.as_ref()?.pack_name()
    }

    /// The gauge has a pack of another name, or of none. One that shows its name itself may have learned `anywhere`.
    pub(super) fn belongs_to(&mut self, pack: Option<String>, anywhere: bool) {
        self.store = self.store.take().map(|store| match anywhere {
            true => store.of_pack_anywhere(pack),
            false => store.of_pack(pack),
        });
    }

    /// A gauge has come, or come back.
    pub(super) fn arrives(&mut self) {
        (self.first, self.is_owed) = (None, false);
    }

    /// The gauge may have lost its power, or another pack may be there.
    pub(super) fn doubt(&mut self) {
        self.claim = None;
    }

    pub(super) fn note_written(&mut self) {
        (self.first, self.next_look) = (None, None);
    }

    pub(super) fn note_restored(&mut self) {
        self.is_owed = false;
    }

    pub(super) fn is_look_due(&self, now: Duration) -> bool {
        self.next_look.is_some_and(|due| due <= now)
    }

    pub(super) fn due(&mut self, shared: &Shared, is_good: bool) -> Due {
        if self.store.is_none() || !is_good {
            self.next_look = None;
            return Due::Nothing;
        }
        if self.is_contested(shared) {
            return Due::Nothing;
        }
        if self.is_owed {
            return Due::Restoration;
        }
        let now = shared.clock.now();
        let pause = if shared.published().seal == Seal::Sealed { EVERY_SEALED } else { EVERY };
        if now < *self.next_look.get_or_insert(now + FIRST) {
            return Due::Nothing;
        }
        self.next_look = Some(now + pause);
        Due::Look
    }

    /// The profile with what the pack has learned in the place of the profile's own, and until when that was learned.
    pub(super) fn add_to(
        &mut self,
        shared: &Shared,
        profile: &[Change],
        is_of_another_pack: bool,
    ) -> (Vec<Change>, Option<Version>) {
        let (chip, design) = (shared.chip, design_capacity(profile));
        let profile = match is_of_another_pack {
            true => over(unlearned(chip, shared.published().answers.dm_code), profile.to_vec()),
            false => profile.to_vec(),
        };
        if self.store.is_none() {
            return (profile, None);
        }
        self.is_owed = self.is_contested(shared);
        let Some(store) = self.store.as_ref().filter(|_| !self.is_owed) else { return (profile, None) };
        if store.pack_name().is_none() {
            if !store.files(chip).is_empty() {
                let why = "what it had learned is kept and not restored, because its pack has no name; see \
                           `gaugefs learned`";
                log::info!("{}: {why}", shared.name());
            }
            return (profile, None);
        }
        let (newest, dropped) = store.newest(chip, design);
        for why in dropped {
            log::warn!("{}: {why}; it is not restored", shared.name());
        }
        let Some((time, image)) = newest else { return (profile, None) };
        match restored(&image) {
            Ok(learned) => (over(profile, learned), Some(time)),
            Err(error) => {
                log::warn!("{}: what it has learned is not restored: {error}", shared.name());
                (profile, None)
            }
        }
    }

    fn is_contested(&mut self, shared: &Shared) -> bool {
        let before = self.claim.take();
        self.claim = self.store.as_ref().and_then(|store| store.claim(shared.chip, before));
        let is_contested = self.claim.as_ref().is_some_and(Claim::is_contested);
        if std::mem::replace(&mut self.is_contested, is_contested) != is_contested {
            match self.contested() {
                Some(error) => shared.report(Attempt::LEARNED, &error),
                None => shared.succeeded(&Attempt::LEARNED),
            }
        }
        is_contested
    }

    fn contested(&self) -> Option<Error> {
        let pack = self.pack_name().filter(|_| self.is_contested)?;
        let why = format!(
            "another gauge has the pack {pack} as well, and no pack is in two places: what either of them learns is not saved, \
             and nothing is restored; give each pack a name of its own"
        );
        Some(Error::new("learned", Cause::NotNow, why))
    }

    pub(super) fn check_contested(&mut self, shared: &Shared) -> Result<()> {
        match self.is_contested(shared) {
            true => self.contested().map_or(Ok(()), Err),
            false => Ok(()),
        }
    }

    pub(super) fn look(&mut self, access: &mut Access, profile: &[Change]) -> Result<Look> {
        let chip = access.chip();
        let mut indices = learning(chip);
        if indices.is_empty() {
            return Ok(Look::Nothing);
        }
        // Where no flag shows a loss of memory, what the profile has set does.
        if chip.volatile == Some(0) {
            indices.extend(profile.iter().filter_map(|change| index_of(chip, change)));
            indices.sort_unstable();
            indices.dedup();
        }
        let rows: Vec<&'static Subclass> = indices.iter().map(|&index| &chip.subclasses[index]).collect();
        let read = access.run(|dataflash, gauge| dataflash.read(gauge, &rows, Duration::ZERO))?;
        let bytes = |change: &Change| {
            let (subclass, row) = change.row()?;
            let at = rows.iter().position(|other| std::ptr::eq(*other, subclass))?;
            let begin = usize::from(row.offset - subclass.start());
            read[at].get(begin..begin + row.kind.size())
        };
        let is_kept = |change: &Change| {
            let is_learned = change.row().is_none_or(|(_, row)| row.learned);
            is_learned || bytes(change).is_some_and(|bytes| change.stored_over(bytes) == bytes)
        };
        let is_lost = match chip.volatile {
            Some(0) => !profile.iter().all(is_kept),
            _ => dataflash::has_lost_memory(access.gauge())?,
        };
        // Unnoticed, since the poll: these are the part's defaults, or some of them.
        if is_lost {
            return Ok(Look::Lost);
        }
        let firmware = access.shared().published().answers.firmware_version;
        let read = indices.iter().zip(&read).map(|(&index, bytes)| (index, &**bytes));
        let mut image = Image::of_flash(chip, Some(firmware), read);
        image.entries.retain(|entry| {
            let is_of_pack = chip.stays((entry.subclass, entry.parameter)) == Stays::Pack;
            !entry.parameter.unproven && (is_of_pack || is_design(entry.parameter))
        });
        self.judge(access.shared(), image, profile)
    }

    /// Judges what a look has found: only plausible values that neither the part nor the profile has were learned.
    fn judge(&mut self, shared: &Shared, image: Image, profile: &[Change]) -> Result<Look> {
        let changes = restored(&image)?;
        // Where no default is printed, only a change shows that something was learned.
        let first = self.first.get_or_insert_with(|| changes.clone());
        if let Some(why) = implausible(&image, design_capacity(profile)) {
            log::warn!("{}: what it has learned is not saved: {why}", shared.name());
            return Ok(Look::Nothing);
        }
        // What the profile has is nothing that was learned.
        let is_written = |change: &Change| {
            let mut written = profile.iter().filter(|wrote| wrote.place() == change.place());
            written.any(|wrote| wrote.stored_over(change.bytes()) == change.bytes())
        };
        // Bits that are never restored say nothing.
        let is_default = |change: &Change| change.is_default(&change.stored_over(&[0; 8]));
        let has_changed = |change: &Change| {
            first.iter().any(|first| first.place() == change.place() && first.bytes() != change.bytes())
        };
        let is_new = |change: &Change| !is_written(change) && (!is_default(change) || has_changed(change));
        Ok(if changes.iter().any(is_new) { Look::Learned(image) } else { Look::Nothing })
    }

    pub(super) fn save(&self, image: &Image) -> Result<bool> {
        self.store.as_ref().map_or(Ok(false), |store| store.save(image, Timestamp::now()))
    }

    pub(super) fn forget(&self, chip: &Chip) -> Result<usize> {
        self.store.as_ref().map_or(Ok(0), |store| store.forget(chip))
    }

    /// The version of that name, or the newest one that can be restored.
    pub(super) fn version(
        &self,
        chip: &'static Chip,
        profile: &[Change],
        named: Option<Version>,
    ) -> Result<(Version, Image)> {
        let not_now = |why| Error::new("learned", Cause::NotNow, why);
        let nothing = || not_now("nothing is kept of it".to_string());
        let (store, design) = (self.store.as_ref().ok_or_else(nothing)?, design_capacity(profile));
        match named {
            Some(version) => {
                let image = store.named(&version, chip, design).map_err(not_now)?;
                Ok((version, image))
            }
            None => {
                let (newest, dropped) = store.newest(chip, design);
                newest.ok_or_else(|| dropped.into_iter().next().map_or_else(nothing, not_now))
            }
        }
    }

    /// What is kept of the pack, as a text, after why the profile is the chosen one.
    pub(super) fn told(&self, chip: &'static Chip, profile: &[Change], why: &str) -> String {
        let mut text = why.to_string();
        if !text.is_empty() {
            text.push('\n');
        }
        if let Some(store) = &self.store {
            let (design, contested) = (design_capacity(profile), self.contested());
            text += &store.told(chip, design, !profile.is_empty(), contested.as_ref());
        }
        text
    }
}

fn design_capacity(profile: &[Change]) -> Option<i64> {
    let is_it = |change: &&Change| change.row().is_some_and(|(_, row)| is_design(row));
    let change = profile.iter().find(is_it)?;
    Some(change.bytes().iter().fold(0, |word, &byte| word << 8 | i64::from(byte)))
}

fn index_of(chip: &'static Chip, change: &Change) -> Option<usize> {
    let (subclass, _) = change.row()?;
    chip.subclasses.iter().position(|other| std::ptr::eq(other, subclass))
}

/// The subclasses, by their indices in the table, that hold what a gauge learns.
pub(super) fn learning(chip: &'static Chip) -> Vec<usize> {
    let rows = chip.subclasses.iter().enumerate();
    let learns = |subclass: &'static Subclass| {
        subclass.parameters.iter().any(|row| !row.unproven && chip.stays((subclass, row)) == Stays::Pack)
    };
    rows.filter(|(_, row)| learns(row)).map(|(index, _)| index).collect()
}

/// The changes that restore what was learned. The image has Design Capacity besides, for comparison.
pub(super) fn restored(image: &Image) -> Result<Vec<Change>> {
    let mut changes = image.to_restore()?;
    changes.retain(|change| change.row().is_some_and(|row| image.chip.stays(row) == Stays::Pack));
    Ok(changes)
}

/// What a gauge that has learned nothing yet has in the place of that, where a source prints it.
fn unlearned(chip: &'static Chip, dm_code: Option<u16>) -> Vec<Change> {
    let rows = chip.rows().filter(|row| !row.1.unproven && chip.stays(*row) == Stays::Pack);
    let default = |(subclass, parameter): Row| {
        let value = Value::Int(parameter.int_default(dm_code)?);
        Some(Entry { subclass, parameter, value, line: 0 })
    };
    let mut image = Image::new(chip, None);
    image.entries = rows.filter_map(default).collect();
    restored(&image).unwrap_or_default()
}

/// Changes, with others in the place of those of the same parameters.
pub(super) fn over(mut changes: Vec<Change>, others: Vec<Change>) -> Vec<Change> {
    changes.retain(|change| others.iter().all(|other| other.place() != change.place()));
    changes.extend(others);
    changes
}
