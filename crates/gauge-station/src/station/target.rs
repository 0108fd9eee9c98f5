// SPDX-License-Identifier: MIT

//! What a pack is asked to have, and whether it has that, bit by bit.

use std::sync::Arc;

use sha2::{Digest, Sha256};
use ti_gauge::chip::{Chip, Subclass};
use ti_gauge::dataflash::{Change, Row};
use ti_gauge::image::{Changes, Entry, Image};
use ti_gauge::text;

use super::record::Changed;
use crate::error::{Cause, Error, Result};
use gauge_owner::{Direct, operations as op, readable};
use ti_gauge::notation;

pub(super) type Place = (u8, u16);

/// All data flash of a pack but its keys, as it was read.
pub(super) struct Flash {
    pub(super) chip: &'static Chip,
    firmware: u16,
    /// By the index in the table.
    rows: Vec<(usize, Arc<[u8]>)>,
}

impl Flash {
    pub(super) fn read(gauge: &mut Direct) -> Result<Self> {
        gauge.ask(&op::REFRESH, ())?;
        Self::of_new(gauge)
    }

    /// Reads it from a gauge that was opened just now: its registers were read then, and nothing else is known of it.
    pub(super) fn of_new(gauge: &mut Direct) -> Result<Self> {
        let chip = gauge.handle.chip();
        let wanted = readable(chip);
        let read = gauge.ask(&op::READ, wanted.clone())?;
        let firmware = gauge.handle.published().answers.firmware_version;
        Ok(Self { chip, firmware, rows: wanted.into_iter().zip(read).collect() })
    }

    pub(super) fn image(&self) -> Image {
        let rows = self.rows.iter().map(|(index, bytes)| (*index, &**bytes));
        Image::of_flash(self.chip, Some(self.firmware), rows)
    }

    fn subclass(&self, wanted: impl Fn(&Subclass) -> bool) -> Option<(&'static Subclass, &[u8])> {
        let rows = self.rows.iter().map(|(index, bytes)| (&self.chip.subclasses[*index], &**bytes));
        rows.into_iter().find(|(subclass, _)| wanted(subclass))
    }

    pub(super) fn bytes(&self, (subclass, parameter): Row) -> Option<&[u8]> {
        let (row, bytes) = self.subclass(|row| std::ptr::eq(row, subclass))?;
        let at = usize::from(parameter.offset - row.start());
        bytes.get(at..at + parameter.kind.size())
    }

    pub(super) fn text(&self, row: Row) -> Option<String> {
        let bytes = self.bytes(row)?;
        Some(notation::render(row.1.kind, &self.chip.layout.decode(row.1.kind, bytes)))
    }

    /// The number that a parameter holds, where it holds one.
    pub(super) fn number(&self, (id, offset): Place) -> Option<i64> {
        let rows = self.chip.subclasses.iter().filter(|subclass| subclass.id == id);
        let row = rows.into_iter().find_map(|subclass| Some((subclass, subclass.parameter(offset)?)))?;
        match self.chip.layout.decode(row.1.kind, self.bytes(row)?) {
            ti_gauge::value::Value::Int(number) => Some(number),
            _ => None,
        }
    }

    /// SHA-256 of all parameters that the gauge does not rewrite itself.
    pub(super) fn fingerprint(&self) -> String {
        let mut sum = Sha256::new();
        for row in self.lasting() {
            sum.update([row.0.id]);
            sum.update(row.1.offset.to_be_bytes());
            sum.update(self.bytes(row).unwrap_or_default());
        }
        text::hex(&sum.finalize())
    }

    /// The parameters that the gauge does not rewrite itself.
    fn lasting(&self) -> impl Iterator<Item = Row> + '_ {
        let rows = self.rows.iter().map(|(index, _)| &self.chip.subclasses[*index]);
        rows.flat_map(|subclass| subclass.parameters.iter().map(move |parameter| (subclass, parameter)))
            .filter(|(_, parameter)| !parameter.learned)
    }

    /// Makes sure that nothing differs but what the gauge rewrites itself, and the parameters at these places.
    pub(super) fn check_same(&self, before: &Self, but: &[Place]) -> Result<()> {
        for row in self.lasting().filter(|(subclass, row)| !but.contains(&(subclass.id, row.offset))) {
            if self.bytes(row) != before.bytes(row) {
                let show = |flash: &Self| flash.text(row).unwrap_or_default();
                let why = format!("{} when it was read before, and {} now", show(before), show(self));
                return Err(Error::new(row.1.name, Cause::Protocol, why));
            }
        }
        Ok(())
    }

    pub(super) fn changed_since(&self, before: &Self) -> Vec<Changed> {
        let (old, new) = (before.image(), self.image());
        let Ok(compared) = old.compare(&new, &[]) else { return Vec::new() };
        let changed = compared.differences.into_iter().map(|difference| Changed {
            old: difference.old.text(),
            new: difference.new.text(),
            name: difference.name,
        });
        changed.collect()
    }

    fn raw_of(&self, id: u8) -> Result<Vec<u8>> {
        let found = self.subclass(|subclass| subclass.id == id);
        found.map(|(_, bytes)| bytes.to_vec()).ok_or_else(|| {
            let why = "the gauge does not show it";
            Error::new(format!("subclass {id}"), Cause::Invalid, why)
        })
    }
}

/// The changes that give a pack what is asked for. What may not be written is an error.
pub(super) fn changes(asked: &Image, now: &Flash, also_unproven: bool) -> Result<Vec<Change>> {
    let gauge = now.image();
    let Changes { changes, passed_over } = gauge.changes(asked, &[], also_unproven)?;
    if let Some(first) = passed_over.first() {
        let why = format!(
            "{first} ({} that cannot be written); exclude them in the station's file",
            passed_over.len()
        );
        return Err(Error::new("image", Cause::NotPermitted, why));
    }
    let mut list = Vec::new();
    for difference in &changes {
        let Entry { subclass, parameter, .. } = difference.new;
        let change = Change::of_value(now.chip, (subclass, parameter), &difference.new.value, also_unproven)?;
        if let Some(stored) = now.bytes((*subclass, *parameter)) {
            change.check_reserved(stored)?;
        }
        list.push(change);
    }
    for difference in asked.raw_changes(|id| now.raw_of(id), false)? {
        let new = difference.new;
        let place = (new.subclass, new.offset).into();
        list.push(Change::raw(now.chip, place, new.bytes.clone())?);
    }
    Ok(list)
}

/// Makes sure that a pack has everything that is asked for, to the bit, but the parameters at these places.
pub(super) fn check(asked: &Image, now: &Flash, but: &[Place]) -> Result<()> {
    for entry in &asked.entries {
        let Entry { subclass, parameter, .. } = entry;
        if but.contains(&(subclass.id, parameter.offset)) {
            continue;
        }
        let row = (*subclass, *parameter);
        if entry.bytes(asked.chip).as_deref() != now.bytes(row) {
            let has = now.text(row).unwrap_or_else(|| "not shown".into());
            let hint = if parameter.learned { "; the gauge rewrites it itself: exclude learned" } else { "" };
            let why = format!("it is {has} when read back, and {} was asked for{hint}", entry.text());
            return Err(Error::new(asked.name(entry), Cause::Protocol, why));
        }
    }
    match asked.raw_changes(|id| now.raw_of(id), true)?.first() {
        Some(difference) => {
            let why = format!("undocumented bytes differ when read back: {difference}");
            Err(Error::new("image", Cause::Protocol, why))
        }
        None => Ok(()),
    }
}

/// Like [`check`], and nothing else may have changed: a row beside those that were written could have been lost.
pub(super) fn check_programmed(asked: &Image, now: &Flash, before: &Flash) -> Result<()> {
    check(asked, now, &[])?;
    let places: Vec<Place> =
        asked.entries.iter().map(|entry| (entry.subclass.id, entry.parameter.offset)).collect();
    now.check_same(before, &places)
}
