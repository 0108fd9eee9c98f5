// SPDX-License-Identifier: MIT

//! `gaugefs diff`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;
use serde_json::Value as Json;

use super::import::GroupName;
use super::{batch, counted, mounted, trouble};
use crate::config::chip_names;
use crate::error::{Cause, Error, Result};
use crate::output::{print, print_json, say};
use gaugefs_client::Gauge;
use ti_gauge::chip::Chip;
use ti_gauge::image::Group;
use ti_gauge::{text, unit};

const DIFF: &str = "\
Files are TOML, gg.csv or FlashStream, recognised by their content. Only parameters that both
sides have, and the bytes of a chemistry, are compared; standard error says what one side lacks. A
mounted gauge is polled and its configuration read first. Exit code 0: no difference, 1:
differences, 2: they could not be compared.

Examples:
  gaugefs diff --exclude serial golden.toml /run/gauges/BAT0
  gaugefs diff pack.toml pack.gm.fs";

/// Compare two configurations, parameter by parameter
#[derive(Args, Debug)]
#[command(after_help = DIFF)]
pub(super) struct Diff {
    /// Folder of a mounted gauge, or a configuration file; - is standard input
    a: PathBuf,
    /// The folder or file to compare it with
    b: PathBuf,
    /// Do not compare these groups of parameters
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUPS")]
    exclude: Vec<GroupName>,
    /// Chip to assume if a file does not name one
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Compare only the data flash of a .bq.fs, which also holds firmware
    #[arg(long)]
    data_flash: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A difference, for --json.
#[derive(Serialize)]
struct Row<'a> {
    name: &'a str,
    a: Option<Json>,
    b: Json,
    unit: &'static str,
}

impl Diff {
    /// Exit codes are diff(1)'s: scripts must be able to tell a difference from a failure.
    pub(super) fn run(self) -> Result<ExitCode> {
        trouble(self.compare())
    }

    fn compare(mut self) -> Result<ExitCode> {
        if [&self.a, &self.b].iter().all(|side| side.as_os_str() == "-") {
            let why = "it has one file only; give a folder or a file for the other side";
            return Err(Error::new("standard input", Cause::Invalid, why));
        }
        for side in [&mut self.a, &mut self.b] {
            *side = Gauge::named(side)?;
            if side.is_dir() {
                *side = Gauge::open(&*side)?.folder().into();
            }
        }
        let named = self.chip.as_deref().and_then(Chip::by_name);
        // A mounted gauge tells the chip of a file that names none.
        let chip_of = |path: &Path| match path.is_dir() {
            true => Gauge::open(path)?.chip().map(Some),
            false => Ok(None),
        };
        // Files first: a refused file leaves the gauge alone.
        let (a, mut b) = if self.b.is_dir() {
            let a = mounted::open(&self.a, named.or(chip_of(&self.b)?), self.data_flash)?;
            (a, mounted::whole(&Gauge::open(&self.b)?)?)
        } else {
            let b = mounted::open(&self.b, named.or(chip_of(&self.a)?), self.data_flash)?;
            (mounted::open(&self.a, named.or(Some(b.chip)), self.data_flash)?, b)
        };
        let exclude: Vec<Group> = self.exclude.iter().map(|&name| name.into()).collect();
        if exclude.contains(&Group::Undocumented) {
            b.keep_reserved(&a);
        }
        let comparison = a.compare(&b, &exclude)?;
        let differences = &comparison.differences;
        let raw_names: Vec<String> = comparison.raw.iter().map(|raw| raw.new.name()).collect();
        if self.json {
            let rows = differences.iter().map(|difference| Row {
                name: &difference.name,
                a: Some(batch::json(difference.old)),
                b: batch::json(difference.new),
                unit: unit::shown(difference.new.parameter),
            });
            let raw = comparison.raw.iter().zip(&raw_names).map(|(difference, name)| Row {
                name,
                a: difference.old.as_deref().map(|bytes| text::hex(bytes).into()),
                b: difference.new.text().into(),
                unit: "",
            });
            print_json(&rows.chain(raw).collect::<Vec<_>>())?;
        } else {
            let rows = differences.iter().map(|difference| format!("{difference}\n"));
            print(&rows.chain(comparison.raw.iter().map(|raw| format!("{raw}\n"))).collect::<String>())?;
        }
        let sides = [
            (&a, &self.a, &comparison.only_first, &comparison.raw_only_first),
            (&b, &self.b, &comparison.only_second, &comparison.raw_only_second),
        ];
        for (image, path, only, raw) in sides {
            for left in image.left_out.iter().filter(|left| left.counts(&exclude)) {
                say(format_args!("{}: {}", path.display(), left.text));
            }
            if !only.is_empty() {
                let count = counted(only.len());
                say(format_args!("{}: {count} that the other side lacks", path.display()));
            }
            if !raw.is_empty() {
                let names: Vec<_> =
                    raw.iter().map(|subclass| format!("{} ({})", subclass.name, subclass.id)).collect();
                let names = names.join(", ");
                say(format_args!("{}: not compared: {names}, which the other side lacks", path.display()));
            }
        }
        let is_same = differences.is_empty() && comparison.raw.is_empty();
        Ok(if is_same { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}
