// SPDX-License-Identifier: MIT

//! Reads a file of any format, recognised by its first line.

use std::borrow::Cow;
use std::path::Path;

use gauge_bus::regular;

use super::target::{fits, instead, versions};
use super::{Entry, Faults, Format, Image, LONGEST, Reading, flashstream, ggcsv, toml, twice};
use crate::chip::Chip;
use crate::error::{Cause, Error, Result};

impl Image {
    /// Reads a regular file of any format. `chip` is for files that name none.
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

    /// Reads the bytes of a file as far as possible, and lists all mistakes.
    pub fn examine(name: &str, bytes: &[u8], chip: Option<&'static Chip>) -> Reading {
        let is_dfi =
            Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dfi"));
        if is_dfi || is_binary(bytes) {
            let why = format!(
                "a binary image of data flash (.dfi), which does not say what it is for; {}, or a .df.fs of a bq34z100",
                instead(None)
            );
            let mut faults = Faults::default();
            faults.add(0, Error::new("", Cause::Invalid, why));
            return Reading { image: None, faults };
        }
        Self::examine_text(&decoded(bytes), chip)
    }

    /// Reads a file's text. A file without parameters is refused, and so is one that sets a parameter twice.
    pub fn parse(text: &str, chip: Option<&'static Chip>) -> Result<Self> {
        Self::examine_text(text, chip).whole()
    }

    /// Reads a file's text as far as possible, and lists all its mistakes.
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
            let known = versions(&[image.chip]);
            let why = format!("it is for firmware 0x{firmware:04x}; gaugefs knows a {known}");
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
}

/// The text of a file. Other encodings, in comments and units, do not matter; spreadsheets also save UTF-16.
fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let units = |word: fn([u8; 2]) -> u16| -> Vec<u16> {
        bytes[2..].chunks_exact(2).map(|pair| word([pair[0], pair[1]])).collect()
    };
    match bytes {
        [0xff, 0xfe, ..] => String::from_utf16_lossy(&units(u16::from_le_bytes)).into(),
        [0xfe, 0xff, ..] => String::from_utf16_lossy(&units(u16::from_be_bytes)).into(),
        _ => String::from_utf8_lossy(bytes),
    }
}

/// Whether these bytes are no text in any tool's encoding, as in a .dfi. UTF-16 begins with a mark.
fn is_binary(bytes: &[u8]) -> bool {
    let is_utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    !is_utf16 && bytes.contains(&0)
}

fn format_of(text: &str) -> Format {
    let first = text.split(['\r', '\n']).map(str::trim).find(|line| !line.is_empty()).unwrap_or_default();
    let mut letters = first.chars();
    match (letters.next(), letters.next()) {
        _ if flashstream::is_meant(first) => Format::FlashStream,
        _ if ggcsv::sections::is_one(text) => Format::GgCsv,
        (Some('*'), _) | (Some('"'), Some('*')) => Format::GgCsv,
        (Some(';' | ':'), _) | (Some('A'..='Z' | 'a'..='z'), Some(':')) => Format::FlashStream,
        _ => Format::Toml,
    }
}
