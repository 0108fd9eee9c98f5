//! `gaugefs diff`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::{counted, print, print_json};
use crate::chip::Chip;
use crate::config::chip_names;
use crate::error::Result;
use crate::mounted;

const DIFF: &str = "\
Files are TOML, gg.csv or FlashStream, told apart by what is in them. A file need not hold
all parameters: those that both have are compared. Exit code 0: no difference, 1: some,
2: they could not be compared.

Examples:
  gaugefs diff pack.toml /run/gauges/BAT0
  gaugefs diff pack.toml pack.gm.fs";

/// Compare two configurations, parameter by parameter
#[derive(Args, Debug)]
#[command(after_help = DIFF)]
pub(super) struct Diff {
    /// A mounted gauge's folder, or a file of any format
    a: PathBuf,
    /// Another
    b: PathBuf,
    /// What a file is for that does not tell
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
    /// As diff(1): whoever asks for a difference has to tell "none" from "cannot say".
    pub(super) fn run(self) -> Result<ExitCode> {
        self.compare().or_else(|error| {
            eprintln!("gaugefs: {error}");
            Ok(ExitCode::from(2))
        })
    }

    fn compare(self) -> Result<ExitCode> {
        let told = self.chip.as_deref().and_then(Chip::by_name);
        // A gauge tells what a file beside it is for.
        let first = if self.a.is_dir() { Some(mounted::open(&self.a, None)?) } else { None };
        let b = mounted::open(&self.b, told.or(first.as_ref().map(|image| image.chip)))?;
        let a = match first {
            Some(image) => image,
            None => mounted::open(&self.a, told.or(Some(b.chip)))?,
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
                eprintln!("gaugefs: {}: {count} that the other does not have", name.display());
            }
        }
        Ok(if differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}
