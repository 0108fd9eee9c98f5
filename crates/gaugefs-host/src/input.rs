// SPDX-License-Identifier: MIT

//! Files named on a command line; `-` is standard input.

use std::io;
use std::path::Path;

use gauge_bus::regular;
use ti_gauge::chip::Chip;
use ti_gauge::image::{self, Image, Reading};

use crate::error::{Error, Result};

const STANDARD_INPUT: &str = "-";

/// A configuration file, read once for any number of gauges.
pub struct Source {
    /// The file's name in messages.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl Source {
    /// Reads a file, or standard input for `-`.
    pub fn read(path: &Path) -> Result<Self> {
        Self::of(name(path), read_file(path, image::LONGEST))
    }

    fn of(name: String, bytes: io::Result<Vec<u8>>) -> Result<Self> {
        let bytes = bytes.map_err(|error| Error::io(&name, "cannot be read", &error))?;
        Ok(Self { name, bytes })
    }

    /// Decodes the content, of `chip` unless it names one. An image with firmware needs `data_flash`.
    pub fn image(&self, chip: Option<&'static Chip>, data_flash: bool) -> Result<Image> {
        let reading = self.examine(chip, data_flash);
        match reading.faults.error() {
            Some(error) => Err(error.within(&self.name)),
            None => Ok(reading.whole()?),
        }
    }

    /// Decodes the content as far as possible, and lists all mistakes.
    pub fn examine(&self, chip: Option<&'static Chip>, data_flash: bool) -> Reading {
        let mut reading = Image::examine(&self.name, &self.bytes, chip);
        if let Some(Err(error)) = reading.image.as_ref().map(|image| image.check_firmware(data_flash)) {
            let line = reading.image.as_ref().and_then(|image| image.firmware_line);
            reading.faults.add(line.unwrap_or(0), error);
        }
        reading
    }
}

/// The bytes of a file, or of standard input for `-`.
pub fn read_file(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    match path == Path::new(STANDARD_INPUT) {
        true => regular::read_from(io::stdin().lock(), limit),
        false => regular::read(path, limit),
    }
}

/// The name of a file in messages.
pub fn name(path: &Path) -> String {
    match path == Path::new(STANDARD_INPUT) {
        true => "standard input".into(),
        false => path.display().to_string(),
    }
}
