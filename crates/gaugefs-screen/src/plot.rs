// SPDX-License-Identifier: MIT

//! `gaugefs plot`: draws a history that `gaugefs log` has recorded.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use gauge_bus::regular::Replace;
use gaugefs_host::error::{Cause, Error, Result};
use gaugefs_host::input;
use gaugefs_host::output::{print_file, write_file};

mod scene;
mod svg;
mod table;

pub(super) use table::Series;

const PLOT: &str = "\
Columns with the same unit share a panel, and all panels share the time axis, with the clock in UTC
and the time since the first row. Below the title, a strip shows the status of each gauge, and
with one gauge its colours are behind the lines too. A line has a gap where the gauge was absent or
nothing was recorded. Charge and energy in the title are summed up from current and voltage.
The shaded part of the capacity is where the gauge has set [SOC1] or [SOCF].

Examples:
  gaugefs plot history.csv -o history.svg
  gaugefs plot history.csv --columns 'voltage,full charge' -o history.svg
  gaugefs plot history.csv --limit voltage=3.0..4.2 -o history.svg
  rsvg-convert history.svg -o history.png";

/// Longer than a history of a year.
const LONGEST: u64 = 512 << 20;

/// Draw a history that `gaugefs log` has recorded, as SVG
#[derive(Args, Debug)]
#[command(after_help = PLOT)]
pub struct Plot {
    /// CSV file to draw; - is standard input
    file: PathBuf,
    /// SVG file to write [default: -, standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Columns to draw, by their names in the first line of the file [default: voltage, current,
    /// capacity and temperature, if they were recorded]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    columns: Vec<String>,
    /// Shade what is outside of these limits of a column; one of the two numbers may be missing
    #[arg(long = "limit", value_name = "NAME=LOW..HIGH", value_parser = Limit::parse)]
    limits: Vec<Limit>,
    /// Width in pixels
    #[arg(long, value_name = "PIXELS", default_value = "960", value_parser = clap::value_parser!(u16).range(320..=8000))]
    width: u16,
    /// Height in pixels [default: depends on the number of panels]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u16).range(160..=8000))]
    height: Option<u16>,
}

impl Plot {
    pub(super) fn run(self) -> Result<ExitCode> {
        self.output.as_deref().map_or(Ok(()), check_extension)?;
        let name = input::name(&self.file);
        let history = history(&self.file, &self.columns)?;
        let scene = scene::lay_out(&history, &self.limits, self.width, self.height)
            .map_err(|error| error.within(&name))?;
        let svg = svg::render(&scene);
        match self.output {
            Some(file) => write_file(&file, svg.as_bytes(), Replace::Kept)?,
            None => print_file(svg.as_bytes())?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

fn history(file: &Path, columns: &[String]) -> Result<table::History> {
    let name = input::name(file);
    let text = input::read_file(file, LONGEST).map_err(|error| Error::io(&name, "cannot read it", &error))?;
    table::read(&text, columns).map_err(|error| error.within(&name))
}

/// The usual quantities of all gauges in a file.
pub(super) fn recorded(file: &Path) -> Result<Vec<Series>> {
    Ok(history(file, &[])?.panels.into_iter().flat_map(|panel| panel.series).collect())
}

#[derive(Clone, Debug, PartialEq)]
struct Limit {
    column: String,
    low: Option<f64>,
    high: Option<f64>,
}

impl Limit {
    fn parse(text: &str) -> Result<Self, String> {
        let expected = "expected a column and its limits, such as voltage=3.0..4.2 or temperature=..45";
        let (column, range) = text.split_once('=').ok_or(expected)?;
        let (low, high) = range.split_once("..").ok_or(expected)?;
        let number = |text: &str| match text.trim() {
            "" => Ok(None),
            text => text.parse().ok().filter(|number: &f64| number.abs() < 1e9).map(Some).ok_or(expected),
        };
        let limit = Self { column: column.trim().replace('_', " "), low: number(low)?, high: number(high)? };
        match (limit.low, limit.high) {
            (None, None) => Err(expected.into()),
            (Some(low), Some(high)) if low >= high => Err("the first limit is not below the second".into()),
            _ => Ok(limit),
        }
    }
}

/// Refuses a file name with the extension of another format.
fn check_extension(file: &Path) -> Result<()> {
    let extension = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let why = match extension.as_str() {
        "svg" | "" => return Ok(()),
        "png" => {
            let (svg, png) = (file.with_extension("svg"), file.display());
            let svg = svg.display();
            format!("plot writes SVG, not PNG; write {svg} and convert it: rsvg-convert {svg} -o {png}")
        }
        _ => "plot writes SVG; give a name that ends in .svg".into(),
    };
    Err(Error::new(file.display().to_string(), Cause::Invalid, why))
}
