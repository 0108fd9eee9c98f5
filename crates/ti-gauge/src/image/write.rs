// SPDX-License-Identifier: MIT

//! Writes an image as a file, and says what the file lacks.

use super::{Format, Image, flashstream, ggcsv, is_written, listed, toml};
use crate::error::Result;

impl Image {
    /// The image in a format. A FlashStream also needs the bytes between parameters: `stored` reads a subclass.
    pub fn write(&self, format: Format, stored: impl Fn(u8) -> Result<Vec<u8>>) -> Result<String> {
        match format {
            Format::Toml => Ok(toml::write(self)),
            Format::GgCsv => Ok(ggcsv::write(self)),
            Format::FlashStream => flashstream::write(self, stored),
        }
    }

    /// What a file in this format lacks, besides keys and bytes between parameters: a line each.
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
