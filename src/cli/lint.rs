// SPDX-License-Identifier: MIT

//! `gaugefs lint`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::import::GroupName;
use super::{align, batch, counted, mounted};
use crate::config::chip_names;
use crate::error::Result;
use crate::output::{print, print_json};
use gaugefs_host::input;
use ti_gauge::chip::Chip;
use ti_gauge::image::{Faults, Group, Image, Reading};
use ti_gauge::{quantity, unit};

const LINT: &str = "\
No gauge is needed. A FlashStream is interpreted as a gauge would do it. A line that writes
firmware, or anything else that is not a documented parameter, is reported as an error. Of a file
with several mistakes the first 20 are listed, in the order of the lines, and the others counted.

Examples:
  gaugefs lint golden.gm.fs
  gaugefs lint --exclude undocumented golden.gm.fs
  gaugefs lint --chip bq27441-g1 golden.gm.fs";

/// Check a configuration file and show what it would set
#[derive(Args, Debug)]
#[command(after_help = LINT)]
pub(super) struct Lint {
    /// Configuration file in any format that export writes; - is standard input
    file: PathBuf,
    /// Chip to assume if the file does not name one
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Leave out these groups of parameters, as an import with the same option does
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUPS")]
    exclude: Vec<GroupName>,
    /// Also accept bytes that no manual documents
    #[arg(long)]
    raw: bool,
    /// Check only the data flash of a .bq.fs, which also holds firmware
    #[arg(long)]
    data_flash: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The values that a file would set, for --json.
#[derive(Serialize)]
struct Report<'a> {
    chip: &'static str,
    parameters: Vec<Row>,
    raw: Vec<RawRow>,
    notes: Vec<&'a str>,
}

#[derive(Serialize)]
struct Row {
    #[serde(flatten)]
    value: batch::Value,
    line: usize,
}

#[derive(Serialize)]
struct RawRow {
    name: String,
    bytes: String,
    line: usize,
}

impl<'a> Report<'a> {
    fn new(image: &'a Image) -> Self {
        let rows = image
            .entries
            .iter()
            .map(|entry| Row { value: batch::Value::new(image.name(entry), entry), line: entry.line });
        let raw = image.raw.iter().map(|raw| RawRow { name: raw.name(), bytes: raw.text(), line: raw.line });
        Self {
            chip: image.chip.name,
            parameters: rows.collect(),
            raw: raw.collect(),
            notes: notes(image).collect(),
        }
    }
}

/// The notes about a file, and its contents that the image leaves out.
fn notes(image: &Image) -> impl Iterator<Item = &str> {
    let left_out = image.left_out.iter().map(|left| left.text.as_str());
    image.notes.iter().map(String::as_str).chain(left_out)
}

impl Lint {
    pub(super) fn run(self) -> Result<ExitCode> {
        let chip = self.chip.as_deref().and_then(Chip::by_name);
        let Reading { mut image, mut faults } = mounted::examine(&self.file, chip, self.data_flash)?;
        let is_whole = faults.is_empty();
        if let Some(image) = &mut image {
            image.exclude(&self.exclude.iter().map(|&name| name.into()).collect::<Vec<Group>>());
            self.check(image, &mut faults);
            match (is_whole, self.json) {
                (false, _) => {}
                (true, true) => print_json(&Report::new(image))?,
                (true, false) => print(&self.text(image))?,
            }
        }
        match faults.error() {
            Some(error) => Err(error.within(&input::name(&self.file))),
            None => Ok(ExitCode::SUCCESS),
        }
    }

    /// Adds the faults of the values and bytes in a readable file.
    fn check(&self, image: &Image, faults: &mut Faults) {
        let values = image.entries.iter();
        let values = values.filter_map(|entry| Some((entry.line, entry.not_imported(false).err()?)));
        let raw = image.raw.chunk_by(|one, other| one.line == other.line);
        let raw = raw.filter_map(|line| Some((line[0].line, image.refused(&line[0], self.raw)?)));
        for (line, error) in values.chain(raw) {
            faults.add(line, error);
        }
    }

    fn text(&self, image: &Image) -> String {
        let mut text = format!("{}: {}\n", image.chip.model, counted(image.entries.len()));
        let rows = image.entries.iter().map(|entry| {
            let mark = if matches!(entry.not_imported(false), Ok(Some(_))) { "not imported" } else { "" };
            let value = quantity::with_unit(&entry.shown(), unit::shown(entry.parameter));
            [image.name(entry), value, format!("line {}", entry.line), mark.to_string()]
        });
        let raw = image.raw.iter().filter(|_| self.raw);
        let raw = raw.map(|raw| [raw.name(), raw.text(), format!("line {}", raw.line), String::new()]);
        text += &align(&rows.chain(raw).collect::<Vec<_>>());
        text.extend(notes(image).map(|note| format!("{note}\n")));
        if !self.raw {
            text += &image.undocumented();
        }
        text
    }
}
