// SPDX-License-Identifier: MIT

//! Images: a gauge's configuration as a file, in three formats, and how two of them differ.
//!
//! Nothing here accesses a gauge. Keys are never part of an image: they are not read, shown or written, even if a
//! file contains them.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use gauge_bus::regular;

use crate::chip::{CHIPS, Chip, FLAT, Kind, Parameter, SIBLINGS, Safe, Subclass};
use crate::codec::{self, WINDOW};
use crate::dataflash::{Change, Place};
use crate::error::{Cause, Error, Result};
use crate::notation;
use crate::text;
use crate::unit;
use crate::value::Value;

mod faults;
pub mod flashstream;
pub mod ggcsv;
pub mod toml;

pub use faults::{Faults, NAMED, Reading};

/// Longer than any file of a gauge's configuration, or of its firmware.
pub const LONGEST: u64 = 16 << 20;

/// The formats of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Named values, suited to version control.
    Toml,
    /// The table that bqStudio exports and imports.
    GgCsv,
    /// What a host sends to a gauge, transfer by transfer.
    FlashStream,
}

/// The configuration of a gauge, or a part of it.
#[derive(Clone, Debug)]
pub struct Image {
    /// The chip that it is for.
    pub chip: &'static Chip,
    /// Control(FW_VERSION) of the gauge that it was read from, if known.
    pub firmware: Option<u16>,
    /// Values, in the table's order.
    pub entries: Vec<Entry>,
    /// Bytes of a FlashStream that belong to no parameter.
    pub raw: Vec<Raw>,
    /// Notes for the reader, a line each.
    pub notes: Vec<String>,
    /// What the file or the gauge has, and this image has not.
    pub left_out: Vec<LeftOut>,
    /// Whether the file names the chip that it is for, or its device type.
    pub names_chip: bool,
    /// The checksum of the chemistry's data, of an image for ROM mode.
    pub chemistry_sum: Option<u16>,
    /// The first line that writes the gauge's firmware as a whole; `None` for an image of data flash only.
    pub firmware_line: Option<usize>,
}

/// Something that is not part of an image although its file or its gauge has it.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// What it is, where it is from, and why it is left out.
    pub text: String,
    /// The group that it belongs to; an import that excludes that group does not ask for it.
    pub group: Option<Group>,
}

impl LeftOut {
    /// Whether a comparison or an import without these groups asks for it.
    pub fn counts(&self, exclude: &[Group]) -> bool {
        !self.group.is_some_and(|group| exclude.contains(&group))
    }
}

/// Parameters that an import can leave as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The classes of calibration: measured for each circuit.
    Calibration,
    /// What distinguishes packs: serial number, date and lots.
    Serial,
    /// What the gauge itself rewrites.
    Learned,
    /// Bytes that no manual documents.
    Undocumented,
    /// Keys, which no image contains: a file that contains some is complete without them.
    Keys,
}

impl Group {
    /// All of them, each with its name in options.
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

/// One value of an image.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its subclass.
    pub subclass: &'static Subclass,
    /// The parameter.
    pub parameter: &'static Parameter,
    /// Its value, of the parameter's type but not necessarily in its range.
    pub value: Value,
    /// The line of the file that it is from; 0 for a value read from a gauge.
    pub line: usize,
}

/// A run of undocumented bytes from one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raw {
    /// Subclass, which may be missing from the table, or [`FLAT`].
    pub subclass: u8,
    /// Offset of the first, or its address.
    pub offset: u16,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// The line of the file that commits them.
    pub line: usize,
}

/// Undocumented bytes that a gauge and a file have different values for.
#[derive(Debug)]
pub struct RawDifference {
    /// The gauge's bytes; `None` where its files do not show them.
    pub old: Option<Vec<u8>>,
    /// The file's bytes.
    pub new: Raw,
}

/// One parameter that two images have different values for.
#[derive(Debug)]
pub struct Difference<'a> {
    /// Its name, as `df/by-name` has it.
    pub name: String,
    /// The value of the first.
    pub old: &'a Entry,
    /// The value of the second.
    pub new: &'a Entry,
}

/// How two images differ.
#[derive(Debug)]
pub struct Comparison<'a> {
    /// Parameters that both have, with different values.
    pub differences: Vec<Difference<'a>>,
    /// Parameters that only the first has.
    pub only_first: Vec<&'a Entry>,
    /// Parameters that only the second has.
    pub only_second: Vec<&'a Entry>,
    /// Different bytes of subclasses of which only name and length are known.
    pub raw: Vec<RawDifference>,
    /// Such subclasses of which only the first has bytes.
    pub raw_only_first: Vec<&'static Subclass>,
    /// Such subclasses of which only the second has bytes.
    pub raw_only_second: Vec<&'static Subclass>,
}

/// What an import does with a file.
#[derive(Debug)]
pub struct Changes<'a> {
    /// Parameters to write.
    pub changes: Vec<Difference<'a>>,
    /// What the file asks for and the gauge does not get, a line each, with the reason.
    pub passed_over: Vec<String>,
}

/// An error about a line of a file. What is quoted of the line may be very long.
pub(crate) fn at_line(line: usize, why: impl Into<String>) -> Error {
    const LONGEST: usize = 1000;
    let mut why = why.into();
    if let Some((end, _)) = why.char_indices().nth(LONGEST) {
        why.truncate(end);
        why += "...";
    }
    Error::new(format!("line {line}"), Cause::Invalid, why)
}

/// An error about a file that does not hold as much as its first lines say.
fn cut_short(why: impl fmt::Display) -> Error {
    Error::new("", Cause::Invalid, format!("{why}; the file is cut short, or lines were added or removed"))
}

/// Checks the count that gaugefs writes into the first lines of a file. A file that has one ends with a whole line.
fn check_count(text: &str, written: Option<usize>, found: usize, what: &str) -> Result<()> {
    match written {
        Some(count) if count != found => {
            Err(cut_short(format_args!("its first lines announce {count} {what}, but it has {found}")))
        }
        Some(_) if !text.ends_with('\n') => Err(cut_short("its last line has no end")),
        _ => Ok(()),
    }
}

impl Entry {
    /// Its bytes in data flash.
    pub fn bytes(&self) -> Option<Vec<u8>> {
        codec::encode(self.parameter.kind, &self.value)
    }

    /// The value as the parameter's file shows it.
    pub fn text(&self) -> String {
        notation::render(self.parameter.kind, &self.value)
    }

    /// The value for people: a date as `2026-11-22`.
    pub fn shown(&self) -> String {
        notation::show(self.parameter, &self.value)
    }

    /// Why an import does not write it: its address is uncertain, unless that is allowed, or it is a learned value outside the range. Any
    /// other value outside its range is an error, with line and parameter.
    pub fn not_imported(&self, allow_unproven: bool) -> Result<Option<&'static str>> {
        match notation::parse(self.parameter, self.text().as_bytes()) {
            _ if self.parameter.unproven && !allow_unproven => Ok(Some("its address or range is unproven")),
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

impl fmt::Display for Difference<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = unit::suffix(self.new.parameter);
        write!(f, "{}: {} -> {}{unit}", self.name, self.old.shown(), self.new.shown())
    }
}

impl Raw {
    /// The place as `df/transaction` has it.
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

impl fmt::Display for RawDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let old = self.old.as_deref().map_or("-".into(), text::hex);
        write!(f, "{}: {old} -> {}", self.new.name(), self.new.text())
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
            chemistry_sum: None,
            firmware_line: None,
        }
    }

    /// The configuration in whole subclasses, given by their indices in the table.
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
                let value = codec::decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
                image.add(subclass, parameter, value, 0);
            }
        }
        image
    }

    /// Gives a parameter a value, which takes the place of the one that it has.
    pub fn set(&mut self, subclass: &'static Subclass, parameter: &'static Parameter, value: Value) {
        let new = Entry { subclass, parameter, value, line: 0 };
        self.entries.retain(|entry| !entry.is(&new));
        self.entries.push(new);
    }

    /// Drops what belongs to these groups.
    pub fn exclude(&mut self, groups: &[Group]) {
        self.entries.retain(|entry| !entry.is_in(groups));
        self.left_out.retain(|left| left.counts(groups));
        if groups.contains(&Group::Undocumented) {
            self.raw.clear();
        }
    }

    /// Why these undocumented bytes are not written to any gauge. Those of a subclass that the table does not
    /// have are written if `allowed`.
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

    /// Whether these are bytes of the chemistry, in a file that is for this part and firmware: it was made to
    /// write them.
    fn is_chemistry(&self, raw: &Raw) -> bool {
        let is_for_part = self.names_chip && self.firmware.is_some();
        is_for_part && self.chip.subclass(raw.subclass).is_some_and(Subclass::is_chemistry)
    }

    /// The lines with undocumented bytes of known subclasses, and the number of bytes in each.
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

    /// What the undocumented bytes of a file would change on a gauge. `stored` returns a whole subclass of it, by
    /// id. Unless `allowed`, or of the chemistry of this part and firmware, the first such change is an error.
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

    /// The subclasses of a chemistry of which a gauge has other bytes than this file, as text; `None` if there are none.
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

    /// Refuses an image that holds the gauge's firmware as well, unless only its data flash is asked for.
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

    /// Reads a regular file of any format. `chip` is the chip that it is for, if the file does not name one.
    pub fn open(path: &Path, chip: Option<&'static Chip>) -> Result<Self> {
        let name = path.display().to_string();
        let bytes =
            regular::read(path, LONGEST).map_err(|error| Error::io(&name, "cannot be read", &error))?;
        Self::read(&name, &bytes, chip)
    }

    /// Reads an image from the bytes of a file with that name.
    pub fn read(name: &str, bytes: &[u8], chip: Option<&'static Chip>) -> Result<Self> {
        Self::examine(name, bytes, chip).whole().map_err(|error| error.within(name))
    }

    /// Reads the bytes of a file with that name as far as that is possible, and finds all that is wrong with it.
    pub fn examine(name: &str, bytes: &[u8], chip: Option<&'static Chip>) -> Reading {
        let is_dfi =
            Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dfi"));
        if is_dfi || is_binary(bytes) {
            let why = "a binary image of data flash (.dfi), which does not say what it is for; export a .gg.csv or .gm.fs \
                       with them, or a .df.fs for a bq34z100";
            let mut faults = Faults::default();
            faults.add(0, Error::new("", Cause::Invalid, why));
            return Reading { image: None, faults };
        }
        // Tools use other encodings in comments and units, which are not needed here.
        Self::examine_text(&String::from_utf8_lossy(bytes), chip)
    }

    /// Reads the text of a file. Its first line shows which format it has. A file without any parameter is refused,
    /// and so is one that has a parameter twice.
    pub fn parse(text: &str, chip: Option<&'static Chip>) -> Result<Self> {
        Self::examine_text(text, chip).whole()
    }

    /// Reads the text of a file as far as it goes, and lists all its mistakes.
    pub fn examine_text(text: &str, chip: Option<&'static Chip>) -> Reading {
        let mut faults = Faults::default();
        let image = Self::found(text, chip, &mut faults);
        Reading { image, faults }
    }

    fn found(text: &str, chip: Option<&'static Chip>, faults: &mut Faults) -> Option<Self> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let invalid = |why: String| Error::new("", Cause::Invalid, why);
        if text.trim().is_empty() {
            return faults.stop(0, invalid("the file is empty".into()));
        }
        let mut image = match format_of(text) {
            Format::Toml => toml::read(text, chip, faults),
            Format::GgCsv => ggcsv::read(text, chip, faults),
            Format::FlashStream => flashstream::read(text, chip, faults),
        }?;
        let place = |entry: &Entry| {
            image.chip.subclasses.iter().position(|row| std::ptr::eq(row, entry.subclass)).unwrap_or(0)
        };
        image.entries.sort_by_key(|entry| (place(entry), entry.parameter.offset));
        let identity = &image.chip.identity;
        image.firmware = image.firmware.filter(|version| !identity.is_device_number(*version));
        if let Some(firmware) = image.firmware
            && !fits(image.chip.identity.firmware, firmware)
        {
            let why = format!("firmware 0x{firmware:04x} is not known for a {}", image.chip.model);
            faults.add(0, invalid(why));
        }
        if image.entries.is_empty() && image.raw.is_empty() && faults.is_empty() {
            let reason = image.left_out.first().map_or(String::new(), |first| format!(" ({})", first.text));
            faults.add(0, invalid(format!("it has no parameter of a {}{reason}", image.chip.model)));
        }
        for pair in image.entries.windows(2) {
            if pair[0].is(&pair[1]) {
                faults.add(pair[1].line, twice(&image.name(&pair[0]), pair[0].line, pair[1].line));
            }
        }
        Some(image)
    }

    /// Gives reserved bits of this file the values that a gauge has: no document says what they do, and a gauge may
    /// hold others than the manual prints. What the file has in them is left out.
    pub fn keep_reserved(&mut self, gauge: &Image) {
        for entry in &mut self.entries {
            let Some(Safe::Keep(mask, why)) = entry.parameter.safe else { continue };
            // A bit with a name has a meaning that the file asks for: that is refused.
            let named = entry.parameter.bits.iter().fold(0, |all, bit| all | u32::from(bit.mask));
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

    /// What must be written to the gauge of this image to give it the values of a file, and what of the file is
    /// passed over. A value that may not be written is an error.
    pub fn changes<'a>(
        &'a self,
        file: &'a Image,
        exclude: &[Group],
        allow_unproven: bool,
    ) -> Result<Changes<'a>> {
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
            match difference.new.not_imported(allow_unproven)? {
                None => changes.push(difference),
                Some(why) => passed_over.push(format!("line {}: {difference}: {why}", difference.new.line)),
            }
        }
        Ok(Changes { changes, passed_over })
    }

    /// The names of the parameters that a file for all of the chip's configuration would have, and this image
    /// lacks. Keys and unproven parameters are never written and not demanded.
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

    /// The changes that restore this configuration on a gauge that has lost it with its power. Unproven rows are
    /// left out.
    pub fn to_restore(&self) -> Result<Vec<Change>> {
        let mut changes = Vec::new();
        for entry in &self.entries {
            let Entry { subclass, parameter, value, line } = entry;
            if parameter.unproven || subclass.kind == Kind::Security {
                continue;
            }
            let at = |error: Error| error.within(&format!("line {line}"));
            changes.push(Change::of_value((subclass, parameter), value, false).map_err(at)?.saved());
        }
        // The chemistry is lost with the power, too.
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

    /// The image in a format. A FlashStream also needs the bytes between parameters: `stored` returns a whole
    /// subclass, by id.
    pub fn write(&self, format: Format, stored: impl Fn(u8) -> Result<Vec<u8>>) -> Result<String> {
        match format {
            Format::Toml => Ok(toml::write(self)),
            Format::GgCsv => Ok(ggcsv::write(self)),
            Format::FlashStream => flashstream::write(self, stored),
        }
    }

    fn add(&mut self, subclass: &'static Subclass, parameter: &'static Parameter, value: Value, line: usize) {
        self.entries.push(Entry { subclass, parameter, value, line });
    }

    fn leave_out(&mut self, line: usize, why: impl fmt::Display, group: Option<Group>) {
        self.left_out.push(LeftOut { text: format!("line {line}: {why}"), group });
    }

    /// The name of a parameter as `df/by-name` has it.
    pub fn name(&self, entry: &Entry) -> String {
        self.chip.name_of((entry.subclass, entry.parameter))
    }

    /// Compares with another image of the same chip, except for some groups. A file need not hold everything:
    /// parameters that only one of the two has are no differences.
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
                Some(new) if old.bytes() != new.bytes() => {
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

    /// Compares the subclasses of which only name and length are known, as far as both have their bytes.
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

    /// The known bytes that this image has of a subclass, and their lines, by offset.
    fn bytes_of(&self, subclass: &Subclass) -> BTreeMap<u16, (u8, usize)> {
        let of_it = self.raw.iter().filter(|raw| raw.subclass == subclass.id);
        let bytes = of_it.flat_map(|raw| (raw.offset..).zip(raw.bytes.iter().map(|byte| (*byte, raw.line))));
        bytes.filter(|(offset, _)| *offset < subclass.length).collect()
    }

    /// Adds the bytes of the subclasses of which only name and length are known. `stored` returns a whole one, by id.
    pub fn add_opaque(&mut self, stored: impl Fn(u8) -> Result<Vec<u8>>) -> Result<()> {
        for subclass in self.chip.subclasses.iter().filter(|subclass| subclass.is_opaque()) {
            let mut bytes = stored(subclass.id)?;
            bytes.truncate(subclass.length.into());
            self.raw.push(Raw { subclass: subclass.id, offset: 0, bytes, line: 0 });
        }
        Ok(())
    }

    /// What a file of this image in a format lacks, beside keys and bytes between parameters: a line each.
    pub fn omitted(&self, format: Format) -> Vec<String> {
        let (chemistry, others): (Vec<_>, Vec<_>) = self
            .chip
            .subclasses
            .iter()
            .filter(|subclass| subclass.is_opaque())
            .partition(|row| row.is_chemistry());
        let is_stream = format == Format::FlashStream;
        let unproven =
            self.entries.iter().filter(|entry| entry.parameter.unproven && !is_written(entry, format));
        let mut unproven: Vec<_> = unproven.map(|entry| self.chip.class_dir(entry.subclass)).collect();
        let count = unproven.len();
        unproven.dedup();
        [
            (!chemistry.is_empty() && !is_stream).then(|| {
                let what = listed(&chemistry);
                format!(
                    "without the chemistry, {what}: bytes without parameters, which only a FlashStream has"
                )
            }),
            (!others.is_empty()).then(|| {
                let what = listed(&others);
                format!("without {what}: bytes of calibration without parameters, which no format has")
            }),
            (count > 0).then(|| {
                let (what, of) = (if count == 1 { "parameter" } else { "parameters" }, unproven.join(", "));
                format!("without {count} unproven {what} of {of}; TOML and gg.csv have them")
            }),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// Whether a format has a parameter of this kind.
fn is_written(entry: &Entry, format: Format) -> bool {
    // Other FlashStreams have whole blocks.
    !(format == Format::FlashStream && entry.subclass.id == FLAT && entry.parameter.unproven)
}

/// `subclasses 83, 84, 85 and 108`.
fn listed(subclasses: &[&Subclass]) -> String {
    let ids: Vec<_> = subclasses.iter().map(|subclass| subclass.id.to_string()).collect();
    match ids.as_slice() {
        [one] => format!("subclass {one}"),
        [others @ .., last] => format!("subclasses {} and {last}", others.join(", ")),
        [] => String::new(),
    }
}

/// An error about a parameter that a file has twice.
fn twice(name: &str, first: usize, second: usize) -> Error {
    at_line(second, also_in(name, first))
}

fn also_in(name: &str, first: usize) -> String {
    format!("{name} is also in line {first}; remove one of the two")
}

/// Whether these bytes are no text in any encoding that tools write, as those of a .dfi. UTF-16 begins with a mark.
fn is_binary(bytes: &[u8]) -> bool {
    let is_utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    !is_utf16 && bytes.contains(&0)
}

/// The format of a text, by its first line that is not blank.
fn format_of(text: &str) -> Format {
    let first = text.split(['\r', '\n']).map(str::trim).find(|line| !line.is_empty()).unwrap_or_default();
    let mut letters = first.chars();
    match (letters.next(), letters.next()) {
        _ if flashstream::is_meant(first) => Format::FlashStream,
        (Some('*'), _) => Format::GgCsv,
        (Some(';' | ':'), _) | (Some('A'..='Z' | 'a'..='z'), Some(':')) => Format::FlashStream,
        _ => Format::Toml,
    }
}

fn fits(known: &[u16], code: u16) -> bool {
    known.is_empty() || known.contains(&code)
}

/// A word in hexadecimal, with or without `0x`.
fn word(text: &str) -> Option<u16> {
    crate::text::unsigned(&format!("0x{}", text.strip_prefix("0x").unwrap_or(text)))
}

/// The chip that a file is for, by the device type and firmware in it and by the chip that is `told`. A
/// contradiction is an error.
fn chip_of(
    told: Option<&'static Chip>,
    device_type: Option<u16>,
    firmware: Option<u16>,
) -> Result<&'static Chip> {
    let invalid = |why: String| Err(Error::new("", Cause::Invalid, why));
    let is = |chip: &Chip| {
        device_type.is_none_or(|code| chip.identity.device_type == code)
            && firmware.is_none_or(|code| fits(chip.identity.firmware, code))
    };
    let codes = || {
        let code = |what: &str, code: Option<u16>| code.map(|code| format!("{what} 0x{code:04x}"));
        let codes = [code("device type", device_type), code("firmware", firmware)];
        codes.into_iter().flatten().collect::<Vec<_>>().join(", ")
    };
    if let Some(chip) = told {
        return if is(chip) {
            Ok(chip)
        } else {
            invalid(format!("it is for {}, which a {} is not", codes(), chip.model))
        };
    }
    if device_type.is_none() {
        return invalid("it does not say which gauge it is for; name it with --chip".into());
    }
    // A part whose identity names this firmware takes precedence over one without known firmware.
    let names = |known: &[u16]| firmware.is_some_and(|code| known.contains(&code));
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(|chip| is(chip)).collect();
    if chips.iter().any(|chip| names(chip.identity.firmware)) {
        chips.retain(|chip| names(chip.identity.firmware));
    }
    let relative = SIBLINGS.iter().find(|sibling| {
        let (of_type, known) = (device_type == Some(sibling.identity.device_type), sibling.identity.firmware);
        of_type && (names(known) || known.is_empty() && chips.is_empty())
    });
    if let ([], Some(relative)) = (chips.as_slice(), relative) {
        let name = relative.name;
        return invalid(format!(
            "it is for {}: a {name}, whose data flash gaugefs does not support",
            codes()
        ));
    }
    let names = chips.iter().map(|chip| chip.name).chain(relative.map(|relative| relative.name));
    match (chips.as_slice(), relative) {
        ([chip], None) => Ok(chip),
        ([], _) => invalid(format!("it is for {}: not a gauge that gaugefs knows", codes())),
        _ => {
            let names = names.collect::<Vec<_>>().join(" or ");
            invalid(format!("it is for {}: {names}; choose with --chip", codes()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Range;
    use crate::value::Type;
    use proptest::prelude::*;
    use proptest::sample::Index;

    /// The image of a gauge with the manual's defaults.
    pub(super) fn defaults(chip: &'static Chip) -> Image {
        let mut image = Image::new(chip, chip.identity.firmware.first().copied());
        for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
            for parameter in subclass.parameters {
                let value = match &parameter.range {
                    Range::Int { min, default, .. } => Value::Int(default.unwrap_or(*min)),
                    Range::Float { min, default, .. } => Value::Float(default.unwrap_or(*min)),
                    Range::Text { default } => Value::Text(default.unwrap_or_default().into()),
                };
                image.add(subclass, parameter, value, 0);
            }
        }
        image
    }

    /// The image as text; the bytes between parameters are 0xff.
    pub(super) fn written(image: &Image, format: Format) -> String {
        match format {
            Format::Toml => toml::write(image),
            Format::GgCsv => ggcsv::write(image),
            Format::FlashStream => flashstream::write(image, |id| {
                let length = image.chip.subclass(id).expect("a subclass").stored();
                let mut bytes = vec![0xff; length.into()];
                for entry in image.entries.iter().filter(|entry| entry.subclass.id == id) {
                    let at = usize::from(entry.parameter.offset);
                    bytes[at..at + entry.parameter.kind.size()]
                        .copy_from_slice(&entry.bytes().expect("it fits"));
                }
                Ok(bytes)
            })
            .expect("every value fits"),
        }
    }

    fn chip(name: &str) -> &'static Chip {
        Chip::by_name(name).expect("it has a table")
    }

    const FORMATS: [Format; 3] = [Format::Toml, Format::GgCsv, Format::FlashStream];

    #[test]
    fn every_format_reads_back_what_was_written() {
        for chip in CHIPS {
            let image = defaults(chip);
            for format in FORMATS {
                let text = written(&image, format);
                let again =
                    Image::parse(&text, None).unwrap_or_else(|error| panic!("{}: {error}", chip.name));
                assert!(std::ptr::eq(again.chip, *chip));
                let compared = image.compare(&again, &[]).expect("one chip");
                let differences: Vec<_> = compared.differences.iter().map(ToString::to_string).collect();
                assert!(differences.is_empty(), "{} {format:?}: {differences:?}", chip.name);
                // The FlashStream of a flat part leaves out unproven parameters.
                let may_lack = format == Format::FlashStream && chip.access.scheme.is_flat();
                assert!(compared.only_first.is_empty() || may_lack, "{} {format:?}", chip.name);
                assert!(compared.only_second.is_empty());
            }
        }
    }

    /// Every string parameter of every chip.
    fn string_rows() -> Vec<(&'static Chip, &'static Subclass, &'static Parameter)> {
        let rows =
            CHIPS.iter().flat_map(|&chip| chip.subclasses.iter().map(move |subclass| (chip, subclass)));
        let rows = rows
            .flat_map(|(chip, subclass)| subclass.parameters.iter().map(move |row| (chip, subclass, row)));
        rows.filter(|(_, _, row)| matches!(row.kind, Type::S(_))).collect()
    }

    /// Exports a string in a format, reads the file, and exports that again.
    fn assert_survives(
        (chip, subclass, parameter): (&'static Chip, &'static Subclass, &'static Parameter),
        string: &[u8],
        format: Format,
    ) {
        let mut image = defaults(chip);
        // A FlashStream has whole blocks.
        image.entries.retain(|entry| std::ptr::eq(entry.subclass, subclass));
        let is_it = |entry: &&mut Entry| entry.parameter.offset == parameter.offset;
        image.entries.iter_mut().find(is_it).expect("it has a default").value = Value::Text(string.into());
        let text = written(&image, format);
        let at = format!("{} {format:?} {:?} in\n{text}", parameter.name, string.escape_ascii().to_string());
        let again = Image::parse(&text, None).unwrap_or_else(|error| panic!("{error}: {at}"));
        let found = again.entries.iter().find(|entry| entry.parameter.offset == parameter.offset);
        let entry = found.unwrap_or_else(|| panic!("it is lost: {at}"));
        assert_eq!(entry.value, Value::Text(string.into()), "{at}");
        assert_eq!(written(&again, format), text, "{at}");
        // What an import writes to `df/transaction`, and a diff shows.
        let shown = entry.text();
        assert!(shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{at}");
        assert_eq!(notation::parse(parameter, shown.as_bytes()), Ok(entry.value.clone()), "{shown}: {at}");
    }

    #[test]
    fn a_string_comes_back_as_it_went() {
        let strings: [&[u8]; 29] = [
            b"AT&T (4S)",
            b"",
            b" ",
            b"   ",
            b" a ",
            b"a  b",
            b"-",
            b"_",
            b"#",
            b"*",
            b"'",
            b"\"",
            b"\"\"\"",
            b"\\",
            b"\\n",
            b"\\u0041",
            b"a,b",
            b",",
            b"a;b",
            b"\t",
            b"\r\n",
            b"\n",
            b"\0",
            b"\x7f",
            b"%",
            b"%41",
            b"%%41",
            b"0x41",
            b"\xff\xfe\xc3\xa9",
        ];
        for row in string_rows() {
            for format in FORMATS {
                if row.2.unproven && format == Format::FlashStream {
                    continue;
                }
                for string in strings {
                    // The chemistry has room for four characters.
                    let string = &string[..string.len().min(row.2.kind.size() - 1)];
                    assert_survives(row, string, format);
                }
            }
        }
    }

    #[test]
    fn a_string_of_any_byte_and_length_comes_back_as_it_went() {
        let rows = string_rows();
        let row = *rows.iter().find(|(_, _, row)| row.kind == Type::S(12)).expect("a Device Name");
        for format in FORMATS {
            for length in [1, 2, 11] {
                for byte in 0..=u8::MAX {
                    assert_survives(row, &vec![byte; length], format);
                }
            }
        }
        let config = ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() };
        proptest!(config, |(string in prop::collection::vec(any::<u8>(), 0..=11), format in prop::sample::select(FORMATS.to_vec()))| {
            assert_survives(row, &string, format);
        });
    }

    /// An edited value counts, and not the bytes that the file had for it.
    #[test]
    fn a_string_that_was_edited_in_a_gg_csv_has_its_new_value() {
        let (chip, subclass, row) = string_rows()[0];
        let mut image = Image::new(chip, None);
        image.add(subclass, row, Value::Text(b"AT&T \x01".into()), 0);
        let text = written(&image, Format::GgCsv);
        let value = |text: &str| Image::parse(text, None).map(|image| image.entries[0].value.clone());
        for (new, bytes) in
            [("AT&T _", &b"AT&T \x01"[..]), ("AT_T _", b"AT_T _"), ("", b""), ("AT&T", b"AT&T")]
        {
            let edited = text.replace("AT&T _", new);
            assert_eq!(value(&edited), Ok(Value::Text(bytes.into())), "{edited}");
        }
        let error = value(&text.replace("AT&T _", "more than eleven")).expect_err("too long").to_string();
        assert!(error.contains(": 16 characters, but only 11 fit"), "{error}");
        let error = value(&text.replace("AT&T _", "caf\u{e9}")).expect_err("not ASCII").to_string();
        assert!(error.contains("Data Flash Raw Value"), "{error}");
    }

    #[test]
    fn an_empty_string_in_a_gg_csv_is_a_value_and_an_empty_number_is_none() {
        for order in ["Parameter Value", "Parameter Value, Units"] {
            let end = if order.ends_with("Units") { ",-" } else { "" };
            let text = format!(
                "* Field Order: Class name, Subclass name, Parameter name, {order}\n\
                 Configuration,Data,Device Name,{end}\nGas Gauging,IT Cfg,Cell Terminate Voltage,{end}\n"
            );
            let image = Image::parse(&text, Some(CHIPS[0])).expect("an image");
            let values: Vec<_> =
                image.entries.iter().map(|entry| (image.name(entry), &entry.value)).collect();
            assert_eq!(values, [("configuration-data/device-name".into(), &Value::Text(Vec::new()))]);
        }
    }

    /// Which end of its range every parameter has.
    #[derive(Clone, Copy, Debug)]
    enum Limit {
        Least,
        Default,
        Most,
    }

    fn at_limit(chip: &'static Chip, limit: Limit) -> Image {
        let mut image = defaults(chip);
        for entry in &mut image.entries {
            entry.value = match (&entry.parameter.range, limit) {
                (_, Limit::Default) => continue,
                (Range::Int { min, .. }, Limit::Least) => Value::Int(*min),
                (Range::Int { max, .. }, Limit::Most) => Value::Int(*max),
                (Range::Float { min, .. }, Limit::Least) => Value::Float(*min),
                (Range::Float { max, .. }, Limit::Most) => Value::Float(*max),
                (Range::Text { .. }, Limit::Least) => Value::Text(Vec::new()),
                (Range::Text { .. }, Limit::Most) => Value::Text(vec![0xff; entry.parameter.kind.size() - 1]),
            };
        }
        image
    }

    #[test]
    fn an_export_of_what_was_imported_is_the_same_file() {
        for chip in CHIPS {
            for limit in [Limit::Least, Limit::Default, Limit::Most] {
                for format in FORMATS {
                    let image = at_limit(chip, limit);
                    let text = written(&image, format);
                    let again = Image::parse(&text, None);
                    let again =
                        again.unwrap_or_else(|error| panic!("{} {limit:?} {format:?}: {error}", chip.name));
                    let second = written(&again, format);
                    let differ = text.lines().zip(second.lines()).find(|(one, other)| one != other);
                    assert_eq!(differ, None, "{} {limit:?} {format:?}", chip.name);
                    assert_eq!(text.len(), second.len(), "{} {limit:?} {format:?}", chip.name);
                    for entry in &again.entries {
                        assert!(
                            entry.not_imported(false).is_ok(),
                            "{} {limit:?}: {}",
                            chip.name,
                            entry.text()
                        );
                    }
                }
            }
        }
    }

    /// A whole file twice, without the lines that count its parameters. A FlashStream is a sequence of writes.
    #[test]
    fn a_parameter_that_is_there_twice_is_refused_in_every_format_that_is_none_of_writes() {
        for chip in CHIPS {
            for format in [Format::Toml, Format::GgCsv] {
                let counts = ["parameters = ", "* gaugefs parameters"];
                let text = written(&defaults(chip), format);
                let is_count = |line: &str| counts.iter().any(|count| line.starts_with(count));
                let lines: Vec<&str> = text.lines().filter(|line| !is_count(line)).collect();
                // TOML does not allow a key outside of a table twice either.
                let start = if format == Format::Toml { 4 } else { 0 };
                let twice = [&lines[..], &lines[start..]].concat().join("\n") + "\n";
                let error = Image::parse(&twice, Some(chip)).map(drop).expect_err("twice").to_string();
                let (first, second) = error.split_once(" is also in line ").unwrap_or_default();
                let is_line = first.starts_with("line ") && second.ends_with("; remove one of the two");
                assert!(is_line, "{} {format:?}: {error}", chip.name);
            }
        }
    }

    #[test]
    fn a_difference_is_shown_by_name() {
        let old = defaults(CHIPS[0]);
        let text = written(&old, Format::Toml)
            .replace("cell-terminate-voltage = 3000", "cell-terminate-voltage = 3100");
        let new = Image::parse(&text, None).expect("an image");
        let compared = old.compare(&new, &[]).expect("one chip");
        let differences: Vec<_> = compared.differences.iter().map(ToString::to_string).collect();
        assert_eq!(differences, ["it-cfg/cell-terminate-voltage: 3000 -> 3100 mV"]);
    }

    #[test]
    fn gauges_of_two_kinds_are_not_compared() {
        let (one, other) = (defaults(CHIPS[0]), defaults(chip("bq27441-g1")));
        let error = one.compare(&other, &[]).expect_err("two chips").to_string();
        assert_eq!(error, "one is for a bq34z100-G1, the other for a bq27441-G1");
    }

    #[test]
    fn a_file_for_another_gauge_is_refused() {
        let text = written(&defaults(CHIPS[0]), Format::Toml);
        for (from, to, says) in [
            ("0x0016", "0x0017", "device type 0x0100, firmware 0x0017, which a bq34z100-G1 is not"),
            ("chip = \"bq34z100-g1\"", "chip = \"bq27441-g1\"", "which a bq27441-G1 is not"),
            ("chip = \"bq34z100-g1\"", "", ""),
        ] {
            let outcome = Image::parse(&text.replacen(from, to, 1), None).map(drop);
            let error = outcome.err().map_or(String::new(), |error| error.to_string());
            assert!(error.contains(says) && error.is_empty() == says.is_empty(), "{from}: {error}");
        }
        let why =
            "device type 0x0421, firmware 0x0109: bq27441-g1 or bq27421-g1 or bq27411-G1; choose with --chip";
        let ambiguous = Image::parse("device_type = 0x0421\nfirmware = 0x0109\n", None);
        assert!(ambiguous.expect_err("two chips").to_string().ends_with(why));
        let relative = Image::parse("device_type = 0x0520\nfirmware = 0x0329\n", None);
        let relative = relative.expect_err("no table").to_string();
        assert!(relative.contains("a bq27520-G4, whose data flash gaugefs does not support"), "{relative}");
    }

    /// The first versions wrote the device number of these parts for their firmware.
    #[test]
    fn regression_a_file_of_another_firmware_of_a_part_with_mac_data_is_refused() {
        for (name, number) in [("bq27220", "0x2002"), ("bq34110", "0x1001"), ("bq35100", "0x0001")] {
            let mut here = defaults(Chip::by_name(name).expect("a chip"));
            here.firmware = Some(0x0201);
            for format in FORMATS {
                let text = written(&here, format);
                let there = Image::parse(&text, Some(here.chip)).expect("an image");
                assert_eq!(there.firmware, Some(0x0201), "{name} {format:?}: {text}");
                here.changes(&there, &[], false).expect("the same firmware");
                let other = Image { firmware: Some(0x0202), ..here.clone() };
                let error = other.changes(&there, &[], false).expect_err("another firmware").to_string();
                assert!(error.contains("it is for firmware 0x0201, but the gauge has 0x0202"), "{error}");
            }
            let old = written(&here, Format::Toml).replacen(
                "firmware = 0x0201",
                &format!("firmware = {number}"),
                1,
            );
            let old = Image::parse(&old, None).expect("an old image");
            assert_eq!(old.firmware, None, "{name}");
            here.changes(&old, &[], false).expect("it does not say which firmware it is for");
        }
        let old = "W: AA 00 01 00\nC: AA 40 20 02\nW: AA 00 02 00\nC: AA 40 02 20\n\
                   W: AA 3E 9F 92\nW: AA 40 04 B0\nW: AA 60 1A 06\n";
        let old = Image::parse(old, None).expect("an old FlashStream");
        assert_eq!((old.chip.name, old.firmware), ("bq27220", None));
    }

    #[test]
    fn a_file_that_was_cut_short_is_refused() {
        for chip in CHIPS {
            for format in FORMATS {
                let text = written(&defaults(chip), format);
                let last = text.len() - 100..text.len();
                for length in (0..text.len()).step_by(211).chain(last) {
                    let cut = String::from_utf8_lossy(&text.as_bytes()[..length]);
                    let outcome = Image::parse(&cut, Some(chip));
                    assert!(outcome.is_err(), "{} {format:?}: {length} bytes are an image", chip.name);
                }
            }
        }
        let text =
            written(&defaults(CHIPS[0]), Format::Toml).replacen("\nra-filter = ", "\n# ra-filter = ", 1);
        let error = Image::parse(&text, None).expect_err("one is missing").to_string();
        assert!(error.contains("the file is cut short, or lines were added or removed"), "{error}");
        // As earlier exports and people write it.
        let text = text.lines().filter(|line| !line.starts_with("parameters")).collect::<Vec<_>>().join("\n");
        assert!(Image::parse(&text, None).is_ok());
    }

    /// The exports of other tools have no count.
    #[test]
    fn a_file_of_another_tool_that_was_cut_short_is_refused_where_it_shows() {
        let rows = "* Field Order: Class name, Subclass name, Parameter name, Parameter Value, Units\n\
                    Gas Gauging,IT Cfg,Cell Terminate Voltage,3100,mV\nGas Gauging,IT Cfg,Ra Filter,500";
        let error = Image::parse(rows, Some(CHIPS[0])).expect_err("the last value may be a part").to_string();
        assert!(error.starts_with("line 3: the last line has fewer fields"), "{error}");
        let stream = "W: AA 00 13 00\nW: AA 3E 44 00\nW: AA 47 00 03 08 98\nW: AA 60 5C\n";
        let chip = Chip::by_name("bq27441-g1");
        let error = Image::parse(stream, chip).expect_err("no end").to_string();
        assert!(
            error.starts_with("line 1: CONFIG UPDATE is entered, and no SOFT_RESET leaves it"),
            "{error}"
        );
        assert!(Image::parse(&format!("{stream}W: AA 00 42 00\n"), chip).is_ok());
    }

    #[test]
    fn a_file_without_parameters_is_refused() {
        let order = "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n";
        for (text, says) in [
            ("", "the file is empty"),
            ("\u{feff}\n \n", "the file is empty"),
            ("chip = \"bq34z100-g1\"\n", "it has no parameter of a bq34z100-G1"),
            ("[it-cfg]\n", "it has no parameter of a bq34z100-G1"),
            (order, "it has no parameter of a bq34z100-G1"),
            (
                &format!("{order}Gas Gauging,IT Cfg,Something,1\n"),
                "it has no parameter of a bq34z100-G1 (line 2: Gas Gauging/IT Cfg/Something: not in the table",
            ),
            ("; a comment\nW: AA 00 01 00\nC: AA 00 00 01\n", "it has no parameter of a bq34z100-G1"),
        ] {
            let error = Image::parse(text, Some(CHIPS[0])).expect_err(text).to_string();
            assert!(error.starts_with(says), "{text}: {error}");
        }
    }

    #[test]
    fn a_parameter_that_is_there_twice_is_refused_with_both_lines() {
        let row = "Gas Gauging,IT Cfg,Cell Terminate Voltage,";
        let text = format!(
            "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n\
             {row}3100\nGas Gauging,IT Cfg,Ra Filter,500\n{row}3200\n"
        );
        let error = Image::parse(&text, Some(CHIPS[0])).expect_err("two values").to_string();
        assert_eq!(error, "line 4: it-cfg/cell-terminate-voltage is also in line 2; remove one of the two");
    }

    #[test]
    fn what_an_import_passes_over_is_listed() {
        let parse = |text: &str| Image::parse(text, Some(CHIPS[0])).expect("an image");
        let gauge = parse("[it-cfg]\ncell-terminate-voltage = 3000\n");
        let file = parse(
            "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n\
             Gas Gauging,IT Cfg,Cell Terminate Voltage,3100\nGas Gauging,IT Cfg,Something,1\n\
             Gas Gauging,IT Cfg,Ra Filter,500\nSecurity,Codes,Sealed to Unsealed,36720414\n",
        );
        let passed_over = |exclude: &[Group]| {
            let Changes { changes, passed_over } = gauge.changes(&file, exclude, false).expect("one chip");
            assert_eq!(changes.len(), 1);
            passed_over
        };
        let unknown = "line 3: Gas Gauging/IT Cfg/Something: not in the table; left out";
        let unread = "line 4: it-cfg/ra-filter: the gauge does not show its value";
        let key = "line 5: Sealed to Unsealed: a key; left out";
        assert_eq!(passed_over(&[]), [unknown, key, unread]);
        assert_eq!(passed_over(&[Group::Keys]), [unknown, unread]);

        // An unproven value is passed over only if the gauge has another one.
        let chip = Chip::by_name("bq34110").expect("a chip");
        let (gauge, mut file) = (defaults(chip), defaults(chip));
        let entry = file.entries.iter_mut().find(|entry| entry.parameter.unproven).expect("an unproven row");
        let Value::Int(value) = &mut entry.value else { panic!("{}", entry.parameter.name) };
        *value += 1;
        let all = gauge.changes(&file, &[], true).expect("one chip");
        assert_eq!((all.changes.len(), all.passed_over.len()), (1, 0));
        let Changes { changes, passed_over } = gauge.changes(&file, &[], false).expect("one chip");
        assert!(changes.is_empty());
        assert_eq!(passed_over.len(), 1, "{passed_over:?}");
        assert!(passed_over[0].ends_with(": its address or range is unproven"), "{passed_over:?}");
    }

    /// Bits 6 and 4 of Pack Configuration B are reserved. Files of real packs have 0 in them, and the manual 1.
    #[test]
    fn reserved_bits_of_a_file_stay_as_the_gauge_has_them() {
        let chip = chip("bq34z100-g1");
        for (word, kept, left_out) in [(0xaf, 0xff, 1), (0xab, 0xfb, 1), (0x7f, 0x7f, 0), (0xff, 0xff, 0)] {
            let (gauge, mut file) = (defaults(chip), defaults(chip));
            let is_it = |entry: &&mut Entry| entry.parameter.name == "Pack Configuration B";
            file.entries.iter_mut().find(is_it).expect("a row").value = Value::Int(word);
            file.keep_reserved(&gauge);
            let Changes { changes, passed_over } = gauge.changes(&file, &[], false).expect("one chip");
            assert_eq!(passed_over.len(), left_out, "{word:x}: {passed_over:?}");
            let written: Vec<_> = changes.iter().map(|change| change.new.value.clone()).collect();
            let expected = if kept == 0xff { Vec::new() } else { vec![Value::Int(kept)] };
            assert_eq!(written, expected, "{word:x}");
            let excluded = gauge.changes(&file, &[Group::Undocumented], false).expect("one chip");
            assert!(excluded.passed_over.is_empty(), "{word:x}: {:?}", excluded.passed_over);
        }
    }

    #[test]
    fn a_complete_image_has_every_parameter_that_can_be_written() {
        for chip in CHIPS {
            let mut image = defaults(chip);
            assert!(image.missing(&[]).is_empty(), "{}", chip.name);
            image.entries.retain(|entry| !entry.parameter.learned);
            assert!(image.missing(&[Group::Learned]).is_empty(), "{}", chip.name);
        }
        let mut image = defaults(CHIPS[0]);
        image.entries.retain(|entry| entry.parameter.name != "Serial Number");
        assert_eq!(image.missing(&[]), ["configuration-data/serial-number"]);
        assert!(image.missing(&[Group::Serial]).is_empty());
    }

    /// Whatever a file holds, it is an image or an error.
    #[test]
    fn garbage_is_refused_without_a_panic() {
        let chips = ["bq34z100-g1", "bq27441-g1", "bq34110"].into_iter().map(chip);
        let whole: Vec<_> = chips
            .flat_map(|chip| FORMATS.map(|format| (chip, written(&defaults(chip), format).into_bytes())))
            .collect();
        let letter = prop::sample::select(b"\n\r\t ;:*=[]#\",.0xfFWCX-\xff\x00e9".to_vec());
        let edits = prop::collection::vec((any::<Index>(), letter), 1..=4);
        let end = prop::option::weighted(0.3, any::<Index>());
        let config = ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() };
        proptest!(config, |(file in prop::sample::select(whole), edits in edits, end in end)| {
            let (chip, mut bytes) = file;
            for (at, letter) in edits {
                let at = at.index(bytes.len());
                bytes[at] = letter;
            }
            if let Some(end) = end {
                bytes.truncate(end.index(bytes.len()));
            }
            let text = String::from_utf8_lossy(&bytes);
            let _ = Image::parse(&text, None);
            let _ = Image::parse(&text, Some(chip));
        });
        for text in ["", "\n", ";", "*", ":", "W:", "X:", "W: AA", "* Field Order:", "[", "\u{feff}"] {
            let _ = Image::parse(text, Some(CHIPS[0]));
        }
    }
}
