//! `gaugefs export`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::batch::{Batch, FAILED, Report, TROUBLE};
use super::folder_name;
use crate::error::Result;
use crate::mounted;
use crate::output::{print_file, say, write_file};
use gauge_bus::regular::Replace;
use ti_gauge::image::Format;

const EXPORT: &str = "\
toml suits version control, gg.csv is bqStudio's format, and flashstream is what TI's tools send
to a gauge. A .df.fs is not offered: nobody could check an image for ROM mode. Keys are never
exported. The gauge is polled and its configuration read first. Exit code 0: done, 3: values that
the gauge does not show are missing in the file, 1: failed. Each of several gauges is exported for
itself; the exit code is the worst.

Examples:
  gaugefs export /run/gauges/BAT0 -o pack.toml
  gaugefs export /run/gauges/BAT0 --format flashstream -o pack.gm.fs
  gaugefs export /run/gauges/BAT* -o packs/";

/// Write the configuration of mounted gauges to files
#[derive(Args, Debug)]
#[command(after_help = EXPORT)]
pub(super) struct Export {
    /// Folders of mounted gauges, such as /run/gauges/BAT0
    #[arg(required = true, value_name = "GAUGE")]
    gauges: Vec<PathBuf>,
    /// Format of the file
    #[arg(long, value_enum, default_value = "toml")]
    format: FormatName,
    /// File to write, or a folder for files such as BAT0.toml [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    batch: Batch,
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
        let folder = self.output.as_deref().filter(|output| output.is_dir());
        if folder.is_none() && self.gauges.len() > 1 {
            return misuse(
                "several gauges need a folder for their files; name one that is there with --output",
            );
        }
        if self.output.is_none() && self.batch.json {
            return misuse("--json needs --output: standard output cannot have the file as well");
        }
        let mut names: Vec<String> = self.gauges.iter().map(|gauge| folder_name(gauge)).collect();
        names.sort();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return misuse(&format!("two gauges are named {}; export them one by one", twice[0]));
        }
        Ok(self.batch.run(&self.gauges, FAILED, |gauge, report| {
            let file = match folder {
                Some(folder) => Some(folder.join(format!("{}.{}", folder_name(gauge), self.format.ending()))),
                None => self.output.clone(),
            };
            self.export(gauge, file.as_deref(), report)
        }))
    }

    fn export(&self, gauge: &Path, file: Option<&Path>, report: &mut Report) -> Result<u8> {
        let image = mounted::now(gauge)?;
        report.identify(gauge);
        let text = image.write(self.format.into(), |id| mounted::raw_of(gauge, id))?;
        match file {
            None => print_file(text.as_bytes())?,
            Some(file) => {
                let name = file.display().to_string();
                write_file(file, text.as_bytes(), Replace::Kept)?;
                report.file = Some(name);
            }
        }
        report.passed_over = image.left_out.into_iter().map(|left| left.text).collect();
        for line in &report.passed_over {
            say(format_args!("{}: {line}", gauge.display()));
        }
        Ok(report.read())
    }
}

/// A command line that cannot be carried out.
fn misuse(why: &str) -> Result<ExitCode> {
    say(why);
    Ok(TROUBLE.into())
}

impl FormatName {
    /// How the name of its files ends.
    fn ending(self) -> &'static str {
        match self {
            Self::Toml => "toml",
            Self::GgCsv => "gg.csv",
            Self::Flashstream => "gm.fs",
        }
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
