//! `gaugefs export`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::{PASSED_OVER, print};
use crate::error::{Error, Result};
use crate::mounted;
use ti_gauge::image::Format;

const EXPORT: &str = "\
toml suits version control, gg.csv is bqStudio's format, and flashstream is what TI's tools send to
a gauge. A .df.fs is not offered: nobody could check an image for ROM mode. Keys are never exported.
The gauge is polled and its configuration read first. Exit code 0: done, 3: values that the gauge
does not show are missing in the file, 1: failed.

Examples:
  gaugefs export /run/gauges/BAT0 -o pack.toml
  gaugefs export /run/gauges/BAT0 --format flashstream -o pack.gm.fs";

/// Write a mounted gauge's configuration to a file
#[derive(Args, Debug)]
#[command(after_help = EXPORT)]
pub(super) struct Export {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Format of the file
    #[arg(long, value_enum, default_value = "toml")]
    format: FormatName,
    /// File to write [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// The names of the formats on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatName {
    Toml,
    #[value(name = "gg.csv")]
    GgCsv,
    Flashstream,
}

impl Export {
    pub(super) fn run(self) -> Result<ExitCode> {
        let image = mounted::now(&self.gauge)?;
        let text = image.write(self.format.into(), |id| mounted::raw_of(&self.gauge, id))?;
        match self.output {
            None => print(&text),
            Some(file) => std::fs::write(&file, text)
                .map_err(|error| Error::io(file.display().to_string(), "cannot write it", &error))?,
        }
        for left in &image.left_out {
            eprintln!("gaugefs: {}: {}", self.gauge.display(), left.text);
        }
        Ok(if image.left_out.is_empty() { ExitCode::SUCCESS } else { PASSED_OVER.into() })
    }
}

impl From<FormatName> for Format {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::Toml => Format::Toml,
            FormatName::GgCsv => Format::GgCsv,
            FormatName::Flashstream => Format::FlashStream,
        }
    }
}
