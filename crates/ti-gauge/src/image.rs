// SPDX-License-Identifier: MIT

//! Images: a gauge's configuration as a file, in three formats, and how two of them differ.
//!
//! Nothing here accesses a gauge. Keys are never part of an image, even if a file contains them.

use std::fmt;

use crate::chip::{Chip, FLAT, Kind, Parameter, Row, Subclass};
use crate::codec::WINDOW;
use crate::dataflash::{Change, Place};
use crate::error::{Cause, Error, Result};
use crate::notation;
use crate::text;
use crate::value::Value;

mod compare;
mod faults;
pub mod flashstream;
pub mod ggcsv;
mod read;
mod target;
pub mod toml;
mod write;

pub use compare::{Changes, Comparison, Difference, RawDifference};
pub use faults::{Faults, NAMED, Reading};
use target::chip_of;

/// Larger than any file of a gauge's configuration or firmware.
pub const LONGEST: u64 = 16 << 20;

/// The formats of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Named values, suited to version control.
    Toml,
    /// The table that bqStudio exports and imports.
    GgCsv,
    /// A host's transfers to a gauge.
    FlashStream,
}

/// A gauge's configuration, or a part of it.
#[derive(Clone, Debug)]
pub struct Image {
    /// The image's chip.
    pub chip: &'static Chip,
    /// Control(FW_VERSION) of its gauge, if known.
    pub firmware: Option<u16>,
    /// Values in the table's order.
    pub entries: Vec<Entry>,
    /// Bytes of a FlashStream outside all parameters.
    pub raw: Vec<Raw>,
    /// Notes for the reader, a line each.
    pub notes: Vec<String>,
    /// Contents of the file or the gauge that this image lacks.
    pub left_out: Vec<LeftOut>,
    /// Whether the file names its chip or device type.
    pub names_chip: bool,
    /// The chemistry in an image for ROM mode, which an import does not write.
    pub chemistry: Option<Chemistry>,
    /// The first line that writes the gauge's whole firmware; `None` for an image of data flash only.
    pub firmware_line: Option<usize>,
}

/// What an image for ROM mode tells of its chemistry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chemistry {
    /// Its checksum.
    Sum(u16),
    /// Nothing by which a gauge's could be compared.
    Unknown,
}

/// Something in a file or a gauge that the image leaves out.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// What it is, where it comes from, and why it is left out.
    pub text: String,
    /// Its group; an import that excludes the group does not ask for it.
    pub group: Option<Group>,
}

impl LeftOut {
    /// Whether a comparison or an import without these groups asks for it.
    pub fn counts(&self, exclude: &[Group]) -> bool {
        !self.group.is_some_and(|group| exclude.contains(&group))
    }
}

/// Groups of parameters that an import can leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Calibration classes, measured for each circuit.
    Calibration,
    /// What distinguishes packs: serial number, date and lots.
    Serial,
    /// What the gauge itself rewrites.
    Learned,
    /// Bytes that no manual documents.
    Undocumented,
    /// Keys. No image contains any, and a file with keys is complete without them.
    Keys,
}

impl Group {
    /// All groups with their names in options.
    pub const NAMES: [(&'static str, Group); 5] = [
        ("calibration", Group::Calibration),
        ("serial", Group::Serial),
        ("learned", Group::Learned),
        ("undocumented", Group::Undocumented),
        ("keys", Group::Keys),
    ];

    fn has(self, subclass: &Subclass, parameter: &Parameter) -> bool {
        match self {
            Group::Calibration => subclass.class == "Calibration",
            Group::Serial => parameter.names_pack(),
            Group::Learned => parameter.learned,
            Group::Undocumented | Group::Keys => false,
        }
    }
}

/// A value of an image.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its subclass.
    pub subclass: &'static Subclass,
    /// The parameter.
    pub parameter: &'static Parameter,
    /// A value of the parameter's type, not necessarily in its range.
    pub value: Value,
    /// Its line in the file; 0 for a value from a gauge.
    pub line: usize,
}

/// A run of undocumented bytes from one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raw {
    /// Subclass, possibly unknown to the table, or [`FLAT`].
    pub subclass: u8,
    /// Offset of the first byte, or its address.
    pub offset: u16,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// The line of the file that commits them.
    pub line: usize,
}

pub(crate) fn at_line(line: usize, why: impl Into<String>) -> Error {
    const LONGEST: usize = 1000;
    let mut why = why.into();
    if let Some((end, _)) = why.char_indices().nth(LONGEST) {
        why.truncate(end);
        why += "...";
    }
    Error::new(format!("line {line}"), Cause::Invalid, why)
}

fn cut_short(why: impl fmt::Display) -> Error {
    Error::new("", Cause::Invalid, format!("{why}; the file is cut short, or lines were added or removed"))
}

fn check_count(text: &str, written: Option<usize>, found: usize, what: &str) -> Result<()> {
    match written {
        Some(count) if count != found => {
            Err(cut_short(format_args!("its first lines announce {count} {what}, but it has {found}")))
        }
        Some(_) if !text.ends_with(['\r', '\n']) => Err(cut_short("its last line has no end")),
        _ => Ok(()),
    }
}

impl Entry {
    /// Its bytes in data flash.
    pub fn bytes(&self, chip: &Chip) -> Option<Vec<u8>> {
        chip.layout.encode(self.parameter.kind, &self.value)
    }

    /// The value as in the parameter's file.
    pub fn text(&self) -> String {
        notation::render(self.parameter.kind, &self.value)
    }

    /// The value for people: a date as `2026-11-22`.
    pub fn shown(&self) -> String {
        notation::show(self.parameter, &self.value)
    }

    /// Why an import skips the value: an uncertain address, or a learned value out of range; others are errors.
    pub fn not_imported(&self, also_unproven: bool) -> Result<Option<&'static str>> {
        if let Some(why) = self.parameter.never {
            return Ok(Some(why));
        }
        match notation::parse(self.parameter, self.text().as_bytes()) {
            _ if self.parameter.unproven && !also_unproven => Ok(Some("its address or range is unproven")),
            Ok(_) => Ok(None),
            Err(_) if self.parameter.learned => Ok(Some("learned, and outside its range")),
            Err(error) => Err(error.within(&format!("line {}", self.line))),
        }
    }

    /// Whether it is of the same parameter.
    pub fn is(&self, other: &Entry) -> bool {
        // Subclasses may share their rows.
        std::ptr::eq(self.subclass, other.subclass) && self.parameter.offset == other.parameter.offset
    }

    fn is_in(&self, groups: &[Group]) -> bool {
        groups.iter().any(|group| group.has(self.subclass, self.parameter))
    }
}

impl Raw {
    /// The place as in `df/transaction`.
    pub fn name(&self) -> String {
        format!("raw {}", Place { subclass: self.subclass, offset: self.offset })
    }

    /// The bytes in hexadecimal.
    pub fn text(&self) -> String {
        text::hex(&self.bytes)
    }

    fn ends_before(&self, subclass: u8, offset: u16) -> bool {
        self.subclass == subclass && usize::from(self.offset) + self.bytes.len() == usize::from(offset)
    }
}

impl Image {
    /// An image without values.
    pub fn new(chip: &'static Chip, firmware: Option<u16>) -> Self {
        Self {
            chip,
            firmware,
            entries: Vec::new(),
            raw: Vec::new(),
            notes: Vec::new(),
            left_out: Vec::new(),
            names_chip: false,
            chemistry: None,
            firmware_line: None,
        }
    }

    /// The configuration in whole subclasses, by their indices in the table.
    pub fn of_flash<'a>(
        chip: &'static Chip,
        firmware: Option<u16>,
        read: impl IntoIterator<Item = (usize, &'a [u8])>,
    ) -> Self {
        let mut image = Self::new(chip, firmware);
        for (index, bytes) in read {
            let subclass = &chip.subclasses[index];
            for parameter in subclass.parameters {
                let at = usize::from(parameter.offset - subclass.start());
                let value = chip.layout.decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
                image.add(subclass, parameter, value, 0);
            }
        }
        image
    }

    /// Sets a parameter's value, replacing an earlier one.
    pub fn set(&mut self, subclass: &'static Subclass, parameter: &'static Parameter, value: Value) {
        let new = Entry { subclass, parameter, value, line: 0 };
        self.entries.retain(|entry| !entry.is(&new));
        self.entries.push(new);
    }

    /// Drops the contents of these groups.
    pub fn exclude(&mut self, groups: &[Group]) {
        self.entries.retain(|entry| !entry.is_in(groups));
        self.left_out.retain(|left| left.counts(groups));
        if groups.contains(&Group::Undocumented) {
            self.raw.clear();
        }
    }

    /// Why these undocumented bytes are not written to any gauge. Bytes of unknown subclasses are written if `allowed`.
    pub fn refused(&self, raw: &Raw, allowed: bool) -> Option<Error> {
        let Raw { subclass, offset, line, .. } = *raw;
        if subclass == FLAT {
            let place = Place { subclass, offset };
            let why = format!("{place} is undocumented; skip it with --exclude undocumented");
            return Some(at_line(line, why));
        }
        if allowed || self.chip.subclass(subclass).is_some() {
            return None;
        }
        let model = self.chip.model;
        let why = format!("subclass {subclass} of a {model} is undocumented; write its bytes with --raw");
        Some(at_line(line, why))
    }

    fn is_chemistry(&self, raw: &Raw) -> bool {
        let is_for_part = self.names_chip && self.firmware.is_some();
        is_for_part && self.chip.subclass(raw.subclass).is_some_and(Subclass::is_chemistry)
    }

    /// The lines with undocumented bytes of known subclasses, and their numbers of bytes.
    pub fn undocumented(&self) -> String {
        let known = self.raw.iter().filter(|raw| self.refused(raw, false).is_none()).collect::<Vec<_>>();
        let told = known.chunk_by(|one, other| one.line == other.line).map(|line| {
            let count: usize = line.iter().map(|raw| raw.bytes.len()).sum();
            let (number, id) = (line[0].line, line[0].subclass);
            let bytes = if count == 1 { "byte" } else { "bytes" };
            let what = match self.chip.subclass(id) {
                Some(class) if class.is_opaque() => {
                    format!("{count} {bytes} of subclass {id}, {}", class.name)
                }
                _ => format!("{count} undocumented {bytes} of subclass {id}"),
            };
            let outcome = match self.is_chemistry(line[0]) {
                true => "written if the gauge has other values",
                false => "refused if the gauge has other values",
            };
            format!("line {number}: {what}; {outcome}\n")
        });
        told.collect()
    }

    /// Refuses an image with firmware, unless only its data flash is wanted.
    pub fn check_firmware(&self, data_flash_only: bool) -> Result<()> {
        match self.firmware_line {
            Some(line) if !data_flash_only => {
                let why = "it also holds the gauge's firmware, which gaugefs never writes; take only its data \
                           flash with --data-flash";
                Err(at_line(line, why))
            }
            _ => Ok(()),
        }
    }

    /// The entry of a row.
    pub fn entry(&self, (subclass, parameter): Row) -> Option<&Entry> {
        let is_it = |entry: &&Entry| {
            std::ptr::eq(entry.subclass, subclass) && std::ptr::eq(entry.parameter, parameter)
        };
        self.entries.iter().find(is_it)
    }

    /// The parameters missing from a complete configuration. Keys and unproven ones are never written or required.
    pub fn missing(&self, exclude: &[Group]) -> Vec<String> {
        let subclasses = self.chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
        let all = subclasses.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
        let missing = all.filter(|(subclass, row)| {
            let is_there = |entry: &Entry| {
                std::ptr::eq(entry.subclass, *subclass) && entry.parameter.offset == row.offset
            };
            let excluded = exclude.iter().any(|group| group.has(subclass, row));
            !row.unproven && !excluded && !self.entries.iter().any(is_there)
        });
        missing.map(|(subclass, row)| self.chip.name_of((subclass, row))).collect()
    }

    /// The changes that restore this configuration on a gauge that lost it with its power, without unproven rows.
    pub fn to_restore(&self) -> Result<Vec<Change>> {
        let mut changes = Vec::new();
        for entry in &self.entries {
            let Entry { subclass, parameter, value, line } = entry;
            if parameter.unproven || subclass.kind == Kind::Security {
                continue;
            }
            let at = |error: Error| error.within(&format!("line {line}"));
            changes
                .push(Change::of_value(self.chip, (subclass, parameter), value, false).map_err(at)?.saved());
        }
        // The chemistry is lost with the power too.
        for raw in self.raw.iter().filter(|raw| self.is_chemistry(raw)) {
            let mut at = 0;
            while at < raw.bytes.len() {
                let offset = raw.offset + at as u16;
                let end = (at + WINDOW - usize::from(offset) % WINDOW).min(raw.bytes.len());
                let place = Place { subclass: raw.subclass, offset };
                changes.push(Change::raw(self.chip, place, raw.bytes[at..end].to_vec())?.saved());
                at = end;
            }
        }
        Ok(changes)
    }

    fn add(&mut self, subclass: &'static Subclass, parameter: &'static Parameter, value: Value, line: usize) {
        self.entries.push(Entry { subclass, parameter, value, line });
    }

    fn leave_out(&mut self, line: usize, why: impl fmt::Display, group: Option<Group>) {
        self.left_out.push(LeftOut { text: format!("line {line}: {why}"), group });
    }

    /// The name of a parameter as in `df/by-name`.
    pub fn name(&self, entry: &Entry) -> String {
        self.chip.name_of((entry.subclass, entry.parameter))
    }

    /// Adds the bytes of subclasses that are known by name and length only. `stored` returns a whole subclass by id.
    pub fn add_opaque(&mut self, stored: impl Fn(u8) -> Result<Vec<u8>>) -> Result<()> {
        for subclass in self.chip.subclasses.iter().filter(|subclass| subclass.is_opaque()) {
            let mut bytes = stored(subclass.id)?;
            bytes.truncate(subclass.length.into());
            self.raw.push(Raw { subclass: subclass.id, offset: 0, bytes, line: 0 });
        }
        Ok(())
    }
}

fn is_written(entry: &Entry, format: Format) -> bool {
    // Other FlashStreams have whole blocks.
    let is_left_out =
        entry.subclass.id == FLAT && entry.parameter.unproven || entry.parameter.never.is_some();
    !(format == Format::FlashStream && is_left_out)
}

fn listed(subclasses: &[&Subclass]) -> String {
    let ids: Vec<_> = subclasses.iter().map(|subclass| subclass.id.to_string()).collect();
    match ids.as_slice() {
        [one] => format!("subclass {one}"),
        [others @ .., last] => format!("subclasses {} and {last}", others.join(", ")),
        [] => String::new(),
    }
}

fn twice(name: &str, first: usize, second: usize) -> Error {
    at_line(second, also_in(name, first))
}

fn also_in(name: &str, first: usize) -> String {
    format!("{name} is also in line {first}; remove one of the two")
}

fn word(text: &str) -> Option<u16> {
    crate::text::unsigned(&format!("0x{}", text.strip_prefix("0x").unwrap_or(text)))
}

#[cfg(test)]
mod tests;
