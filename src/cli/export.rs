// SPDX-License-Identifier: MIT

//! `gaugefs export`.

use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::batch::{Batch, FAILED, Report, TROUBLE};
use super::mounted;
use crate::error::{Error, Result};
use crate::output::{is_standard_output, print_file, say, write_file};
use gauge_bus::regular::Replace;
use gaugefs_client::Gauge;
use ti_gauge::image::Format;

const EXPORT: &str = "\
toml suits version control, gg.csv is bqStudio's format, and flashstream is what TI's tools send
to a gauge. A .df.fs is not offered: nobody could check an image for ROM mode. Keys are never
exported. What else a format has no place for, such as a chemistry, is named on standard error. The
gauge is polled and its configuration read first. Exit code 0: done, 3: values that the gauge does
not show are missing in the file, 1: failed. Each of several gauges is exported for itself; the exit
code is the worst.

Examples:
  gaugefs export /run/gauges/BAT0 -o pack.toml
  gaugefs export /run/gauges/BAT0 -o pack.gm.fs
  gaugefs export /run/gauges/BAT* -o packs/";

/// Write the configuration of mounted gauges to files
#[derive(Args, Debug)]
#[command(after_help = EXPORT)]
pub(super) struct Export {
    /// Folders of mounted gauges, such as /run/gauges/BAT0
    #[arg(required = true, value_name = "GAUGE")]
    gauges: Vec<PathBuf>,
    /// Format of the file [default: by its ending .toml, .gg.csv or .gm.fs, otherwise toml]
    #[arg(long, value_enum)]
    format: Option<FormatName>,
    /// File to write, or a folder for files such as BAT0.toml, which is made if its name ends with /
    /// [default: -, standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    batch: Batch,
}

/// The names of the formats on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FormatName {
    Toml,
    #[value(name = "gg.csv")]
    GgCsv,
    Flashstream,
}

impl Export {
    pub(super) fn run(self) -> Result<ExitCode> {
        let output = self.output.as_deref();
        let is_new = output.is_some_and(|output| output.as_os_str().as_bytes().ends_with(b"/"));
        let folder = output.filter(|output| is_new || output.is_dir());
        if folder.is_none() && self.gauges.len() > 1 {
            return misuse(
                "several gauges need a folder for their files; name one with --output, such as packs/",
            );
        }
        let format = match self.format_of(output.filter(|_| folder.is_none())) {
            Ok(format) => format,
            Err(why) => return misuse(&why),
        };
        if output.is_none_or(is_standard_output) && self.batch.json {
            return misuse("--json needs --output: standard output cannot have the file as well");
        }
        let mut names: Vec<String> =
            self.gauges.iter().map(|gauge| gaugefs_client::folder_name(gauge)).collect();
        names.sort();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return misuse(&format!("two gauges are named {}; export them one by one", twice[0]));
        }
        if let Some(folder) = folder {
            let made = fs::create_dir_all(folder);
            made.map_err(|error| Error::io(folder.display().to_string(), "cannot make the folder", &error))?;
        }
        Ok(self.batch.run(&self.gauges, FAILED, |gauge, report| {
            let file = match folder {
                Some(folder) => Some(folder.join(format!("{}.{}", gauge.name(), format.ending()))),
                None => self.output.clone(),
            };
            export(gauge, format, file.as_deref(), report)
        }))
    }

    /// The format of a file's ending. A requested format has to be the same.
    fn format_of(&self, file: Option<&Path>) -> Result<FormatName, String> {
        let name = file.map_or_else(String::new, |file| file.display().to_string());
        let lower = name.to_ascii_lowercase();
        if lower.ends_with(".df.fs") || lower.ends_with(".bq.fs") {
            return Err(format!(
                "{name}: an image for ROM mode is not exported, because nobody could check it; name it .gm.fs for a \
                 FlashStream, which is sent to a gauge that runs"
            ));
        }
        let all = FormatName::value_variants();
        let by_name = all.iter().copied().find(|format| lower.ends_with(&format!(".{}", format.ending())));
        match (self.format, by_name) {
            (Some(asked), Some(found)) if asked != found => Err(format!(
                "{name}: --format is {}, but a file of that name is a {}; leave out --format, or name it .{}",
                asked.name(),
                found.name(),
                asked.ending()
            )),
            (asked, found) => Ok(asked.or(found).unwrap_or(FormatName::Toml)),
        }
    }
}

fn export(gauge: &Gauge, format: FormatName, file: Option<&Path>, report: &mut Report) -> Result<u8> {
    let image = mounted::whole(gauge)?;
    report.identify(gauge);
    let text = image.write(format.into(), |id| gauge.raw(id))?;
    report.left_out = image.omitted(format.into());
    match file {
        None => print_file(text.as_bytes())?,
        Some(file) => {
            let name = file.display().to_string();
            write_file(file, text.as_bytes(), Replace::Kept)?;
            report.file = Some(name);
        }
    }
    report.passed_over = image.left_out.into_iter().map(|left| left.text).collect();
    for line in &report.left_out {
        say(format_args!("gauge {}: exported {line}", gauge.folder().display()));
    }
    for line in &report.passed_over {
        say(format_args!("{}: {line}", gauge.folder().display()));
    }
    Ok(report.read())
}

/// Reports a command line that cannot be carried out.
fn misuse(why: &str) -> Result<ExitCode> {
    say(why);
    Ok(TROUBLE.into())
}

impl FormatName {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_string())
    }

    /// The file name's ending.
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
