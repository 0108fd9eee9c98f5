//! `gaugefs diff`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::{counted, print, print_json};
use crate::config::chip_names;
use crate::error::Result;
use crate::mounted;
use ti_gauge::chip::Chip;

const DIFF: &str = "\
Files are TOML, gg.csv or FlashStream, recognised by their content. Only parameters that both
sides have are compared. Exit code 0: no difference, 1: differences, 2: they could not be compared.

Examples:
  gaugefs diff pack.toml /run/gauges/BAT0
  gaugefs diff pack.toml pack.gm.fs";

/// Compare two configurations, parameter by parameter
#[derive(Args, Debug)]
#[command(after_help = DIFF)]
pub(super) struct Diff {
    /// Folder of a mounted gauge, or a configuration file
    a: PathBuf,
    /// The folder or file to compare it with
    b: PathBuf,
    /// Chip to assume if a file does not name one
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A difference, for --json.
#[derive(Serialize)]
struct Row<'a> {
    name: &'a str,
    a: String,
    b: String,
    unit: &'static str,
}

impl Diff {
    /// Exit codes as diff(1) has them: a script must be able to distinguish a difference from a failure.
    pub(super) fn run(self) -> Result<ExitCode> {
        self.compare().or_else(|error| {
            eprintln!("gaugefs: {error}");
            Ok(ExitCode::from(2))
        })
    }

    fn compare(self) -> Result<ExitCode> {
        let named = self.chip.as_deref().and_then(Chip::by_name);
        // A mounted gauge says which chip a file without a name is for.
        let first = if self.a.is_dir() { Some(mounted::open(&self.a, None)?) } else { None };
        let b = mounted::open(&self.b, named.or(first.as_ref().map(|image| image.chip)))?;
        let a = match first {
            Some(image) => image,
            None => mounted::open(&self.a, named.or(Some(b.chip)))?,
        };
        let comparison = a.compare(&b)?;
        let differences = &comparison.differences;
        if self.json {
            let rows = differences.iter().map(|difference| Row {
                name: &difference.name,
                a: difference.old.text(),
                b: difference.new.text(),
                unit: difference.new.parameter.unit,
            });
            print_json(&rows.collect::<Vec<_>>());
        } else {
            print(&differences.iter().map(|difference| format!("{difference}\n")).collect::<String>());
        }
        for (count, name) in [(comparison.only_first, &self.a), (comparison.only_second, &self.b)] {
            if count > 0 {
                let count = counted(count);
                eprintln!("gaugefs: {}: {count} that the other side lacks", name.display());
            }
        }
        Ok(if differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}
