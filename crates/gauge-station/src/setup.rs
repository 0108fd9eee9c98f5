// SPDX-License-Identifier: MIT

//! A station as a whole.

use std::path::{Path, PathBuf};

use crate::options::Options;
use gauge_owner::GaugeOptions;

/// A station, as its file describes it. All paths are absolute.
#[derive(Clone, Debug)]
pub struct Setup {
    /// What it does with each pack.
    pub options: Options,
    /// The places for packs, with their names.
    pub gauges: Vec<(String, GaugeOptions)>,
    /// Its name in the records.
    pub name: String,
    /// Its file, for messages.
    pub file: String,
    /// The file with a line for each pack.
    pub record: PathBuf,
    /// The folder for an image of each pack.
    pub images: PathBuf,
}

impl Setup {
    /// The station of a file with that absolute path. Its record is beside the file unless the options say otherwise.
    pub fn new(file: &Path, options: Options, gauges: Vec<(String, GaugeOptions)>) -> Self {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let record = options.record.clone().unwrap_or_else(|| file.with_extension("jsonl"));
        let images = options.images.clone().unwrap_or_else(|| record.with_extension("images"));
        let name = options.name.clone().unwrap_or(stem);
        Self { options, gauges, name, file: file.display().to_string(), record, images }
    }
}
