// SPDX-License-Identifier: MIT

//! Compares images, and finds what a file would change on a gauge.

use std::collections::BTreeMap;
use std::fmt;

use super::{Entry, Group, Image, LeftOut, Raw, at_line, listed};
use crate::chip::{Safe, Subclass};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result};
use crate::quantity;
use crate::text;
use crate::unit;
use crate::value::Value;

/// Undocumented bytes that differ between a gauge and a file.
#[derive(Debug)]
pub struct RawDifference {
    /// The gauge's bytes; `None` if its files do not show them.
    pub old: Option<Vec<u8>>,
    /// The file's bytes.
    pub new: Raw,
}

impl fmt::Display for RawDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let old = self.old.as_deref().map_or("-".into(), text::hex);
        write!(f, "{}: {old} -> {}", self.new.name(), self.new.text())
    }
}

/// A parameter with different values in two images.
#[derive(Debug)]
pub struct Difference<'a> {
    /// Name as in `df/by-name`.
    pub name: String,
    /// The first value.
    pub old: &'a Entry,
    /// The second value.
    pub new: &'a Entry,
}

impl fmt::Display for Difference<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = unit::shown(self.new.parameter);
        let change = quantity::change(&self.old.shown(), &self.new.shown(), unit);
        write!(f, "{}: {change}", self.name)
    }
}

/// The differences between two images.
#[derive(Debug)]
pub struct Comparison<'a> {
    /// Parameters of both with different values.
    pub differences: Vec<Difference<'a>>,
    /// Parameters of the first only.
    pub only_first: Vec<&'a Entry>,
    /// Parameters of the second only.
    pub only_second: Vec<&'a Entry>,
    /// Different bytes of subclasses that are known by name and length only.
    pub raw: Vec<RawDifference>,
    /// Such subclasses with bytes in the first only.
    pub raw_only_first: Vec<&'static Subclass>,
    /// Such subclasses with bytes in the second only.
    pub raw_only_second: Vec<&'static Subclass>,
}

/// The effect of importing a file.
#[derive(Debug)]
pub struct Changes<'a> {
    /// Parameters to write.
    pub changes: Vec<Difference<'a>>,
    /// Contents of the file that the gauge does not get, a line each, with the reason.
    pub passed_over: Vec<String>,
}

impl Image {
    /// Compares with another image of the chip, except for some groups. Parameters of only one are no differences.
    pub fn compare<'a>(&'a self, new: &'a Image, exclude: &[Group]) -> Result<Comparison<'a>> {
        if !std::ptr::eq(self.chip, new.chip) {
            let why = format!("one is for a {}, the other for a {}", self.chip.model, new.chip.model);
            return Err(Error::new("", Cause::Invalid, why));
        }
        let mut comparison = Comparison {
            differences: Vec::new(),
            only_first: Vec::new(),
            only_second: Vec::new(),
            raw: Vec::new(),
            raw_only_first: Vec::new(),
            raw_only_second: Vec::new(),
        };
        let compared = |image: &'a Image| image.entries.iter().filter(|entry| !entry.is_in(exclude));
        for old in compared(self) {
            match new.entries.iter().find(|entry| entry.is(old)) {
                None => comparison.only_first.push(old),
                Some(new) if old.bytes(self.chip) != new.bytes(self.chip) => {
                    comparison.differences.push(Difference { old, new, name: self.name(old) });
                }
                Some(_) => {}
            }
        }
        let is_new = |entry: &&Entry| !self.entries.iter().any(|old| old.is(entry));
        comparison.only_second = compared(new).filter(is_new).collect();
        if !exclude.contains(&Group::Undocumented) {
            self.compare_opaque(new, &mut comparison);
        }
        Ok(comparison)
    }

    fn compare_opaque(&self, new: &Image, comparison: &mut Comparison<'_>) {
        for subclass in self.chip.subclasses.iter().filter(|subclass| subclass.is_opaque()) {
            let (old, new) = (self.bytes_of(subclass), new.bytes_of(subclass));
            match (old.is_empty(), new.is_empty()) {
                (true, true) => {}
                (false, true) => comparison.raw_only_first.push(subclass),
                (true, false) => comparison.raw_only_second.push(subclass),
                (false, false) => {
                    let both = old.iter().filter_map(|(at, (byte, _))| Some((*at, *byte, *new.get(at)?)));
                    let differ = both.filter(|(_, old, (new, _))| old != new).collect::<Vec<_>>();
                    let runs = differ.chunk_by(|one, next| {
                        one.0 + 1 == next.0 && usize::from(one.0) / WINDOW == usize::from(next.0) / WINDOW
                    });
                    comparison.raw.extend(runs.map(|run| {
                        let bytes = run.iter().map(|(_, _, (new, _))| *new).collect();
                        let (offset, line) = (run[0].0, run[0].2.1);
                        let new = Raw { subclass: subclass.id, offset, bytes, line };
                        RawDifference { old: Some(run.iter().map(|(_, old, _)| *old).collect()), new }
                    }));
                }
            }
        }
    }

    fn bytes_of(&self, subclass: &Subclass) -> BTreeMap<u16, (u8, usize)> {
        let of_it = self.raw.iter().filter(|raw| raw.subclass == subclass.id);
        let bytes = of_it.flat_map(|raw| (raw.offset..).zip(raw.bytes.iter().map(|byte| (*byte, raw.line))));
        bytes.filter(|(offset, _)| *offset < subclass.length).collect()
    }

    /// The writes that give this gauge a file's values, and what is passed over. A forbidden value is an error.
    pub fn changes<'a>(
        &'a self,
        file: &'a Image,
        exclude: &[Group],
        also_unproven: bool,
    ) -> Result<Changes<'a>> {
        self.chip.check_proven()?;
        if let (Some(here), Some(there)) = (self.firmware, file.firmware)
            && here != there
        {
            let why = format!("it is for firmware 0x{there:04x}, but the gauge has 0x{here:04x}");
            return Err(Error::new("", Cause::Invalid, why));
        }
        let Comparison { differences, only_second, .. } = self.compare(file, exclude)?;
        let asked_for = file.left_out.iter().filter(|left| left.counts(exclude));
        let mut passed_over: Vec<_> = asked_for.map(|left| left.text.clone()).collect();
        for entry in only_second {
            let (line, name) = (entry.line, file.name(entry));
            passed_over.push(format!("line {line}: {name}: the gauge does not show its value"));
        }
        let mut changes = Vec::new();
        for difference in differences {
            match difference.new.not_imported(also_unproven)? {
                None => changes.push(difference),
                Some(why) => passed_over.push(format!("line {}: {difference}: {why}", difference.new.line)),
            }
        }
        Ok(Changes { changes, passed_over })
    }

    /// What undocumented bytes would change; an error unless `allowed` or this part's chemistry. `stored` reads by id.
    pub fn raw_changes(
        &self,
        stored: impl Fn(u8) -> Result<Vec<u8>>,
        allowed: bool,
    ) -> Result<Vec<RawDifference>> {
        let mut changes = Vec::new();
        for raw in &self.raw {
            if let Some(error) = self.refused(raw, allowed) {
                return Err(error);
            }
            let Some(subclass) = self.chip.subclass(raw.subclass) else {
                changes.push(RawDifference { old: None, new: raw.clone() });
                continue;
            };
            let stored = stored(subclass.id)?;
            let start = usize::from(raw.offset);
            let Some(stored) = stored.get(start..start + raw.bytes.len()) else {
                let why = format!("subclass {} ends with offset {}", subclass.id, stored.len() - 1);
                return Err(at_line(raw.line, why));
            };
            let allowed = allowed || self.is_chemistry(raw);
            let differs = |at: &usize| stored[*at] != raw.bytes[*at];
            let range = 0..raw.bytes.len();
            let (Some(from), Some(to)) = (range.clone().find(differs), range.clone().rfind(differs)) else {
                continue;
            };
            let offset = raw.offset + from as u16;
            let new = Raw { offset, bytes: raw.bytes[from..=to].to_vec(), ..*raw };
            let change = RawDifference { old: Some(stored[from..=to].to_vec()), new };
            if !allowed {
                let why = "these bytes are undocumented; write them with --raw or skip them with --exclude undocumented";
                return Err(at_line(raw.line, format!("{change}: {why}")));
            }
            changes.push(change);
        }
        Ok(changes)
    }

    /// The chemistry's subclasses that differ between a gauge and this file, as text; `None` without a difference.
    pub fn other_chemistry(&self, stored: impl Fn(u8) -> Result<Vec<u8>>) -> Result<Option<String>> {
        let mut found: Vec<&Subclass> = Vec::new();
        for raw in self.raw.iter().filter(|raw| self.is_chemistry(raw)) {
            let (here, start) = (stored(raw.subclass)?, usize::from(raw.offset));
            if here.get(start..start + raw.bytes.len()) != Some(&raw.bytes[..])
                && let Some(subclass) = self.chip.subclass(raw.subclass)
                && !found.iter().any(|other| other.id == subclass.id)
            {
                found.push(subclass);
            }
        }
        Ok((!found.is_empty()).then(|| listed(&found)))
    }

    /// Gives reserved bits a gauge's values: no document describes them, and a gauge may differ from the manual.
    pub fn keep_reserved(&mut self, gauge: &Image) {
        for entry in &mut self.entries {
            let Some(Safe::Keep(mask, why)) = entry.parameter.safe else { continue };
            // A named bit has a meaning that the file asks for: that is refused.
            let named = entry.parameter.bits.iter().fold(0, |all, bit| all | bit.mask);
            let mask = i64::from(mask & !named);
            let there =
                gauge.entries.iter().find(|there| there.is(entry)).map(|there| (there.text(), &there.value));
            let (Some((stored, Value::Int(old))), Value::Int(new)) = (there, &entry.value) else { continue };
            let differ = (old ^ new) & mask;
            if differ == 0 {
                continue;
            }
            let name = self.chip.name_of((entry.subclass, entry.parameter));
            let text = format!(
                "line {}: {name}: {} differs from the gauge's {stored} in bits 0x{differ:x}, which stay as they are: {why}",
                entry.line,
                entry.text(),
            );
            self.left_out.push(LeftOut { text, group: Some(Group::Undocumented) });
            entry.value = Value::Int(new & !mask | old & mask);
        }
    }
}
