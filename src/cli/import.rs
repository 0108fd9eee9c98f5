//! `gaugefs import`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::{PASSED_OVER, counted, print, trouble};
use crate::config::chip_names;
use crate::error::{Cause, Error, Result};
use crate::mounted;
use ti_gauge::chip::Chip;
use ti_gauge::image::{Changes, Group, Image};

mod progress;

const IMPORT: &str = "\
The gauge is polled and its configuration read first. The differences are written through
df/transaction, all of them or none, and printed. Keys are never written, nor, without
--allow-unproven, parameters whose address or range is uncertain. Reserved bits stay as the gauge
has them. What is passed over is listed on standard error. A FlashStream that would change
undocumented bytes is refused, unless --raw writes them or --exclude undocumented skips them.

A .df.fs or .bq.fs of a bq34z100 is read as its parameters, which are written like any others; ROM
mode is never entered. The chemistry in it is not written: the gauge must have the same one.

Exit code 0: the gauge has everything that the file asks for and no group excludes, 3: it has,
except for what was passed over, 1: failed. With --dry-run, as diff(1) has them: 0: the gauge has
everything already, 1: it has not, 2: they could not be compared.

Examples:
  gaugefs import --dry-run /run/gauges/BAT0 pack.toml
  gaugefs import --exclude calibration,serial /run/gauges/BAT0 golden.gm.fs";

/// Write a configuration file to a mounted gauge, all of it or nothing
#[derive(Args, Debug)]
#[command(after_help = IMPORT)]
pub(super) struct Import {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Configuration file in any format that export writes
    file: PathBuf,
    /// Show what would change, and write nothing
    #[arg(long)]
    dry_run: bool,
    /// Do not write these groups of parameters
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUPS")]
    exclude: Vec<GroupName>,
    /// Refuse a file that lacks a parameter of a group that is not excluded
    #[arg(long)]
    complete: bool,
    /// Chip to assume if the file does not name one
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Also write bytes that no manual documents
    #[arg(long)]
    raw: bool,
    /// Also write parameters whose address or range is uncertain, on a mount with --allow-unproven
    #[arg(long)]
    allow_unproven: bool,
    /// Take only the data flash of a .bq.fs, which also holds firmware
    #[arg(long)]
    data_flash: bool,
    /// The gauge has the chemistry of a .df.fs or .bq.fs, although its checksum does not prove that
    #[arg(long)]
    same_chemistry: bool,
}

/// The groups of parameters that an import or a comparison can skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum GroupName {
    /// The class Calibration: values measured for each circuit
    Calibration,
    /// Serial number, date and lot codes
    Serial,
    /// Values that the gauge has learned about its pack
    Learned,
    /// Bytes that no manual documents, and reserved bits
    Undocumented,
    /// Keys, which are never written: do not report them as passed over
    Keys,
}

impl Import {
    pub(super) fn run(self) -> Result<ExitCode> {
        if self.dry_run { trouble(self.import()) } else { self.import() }
    }

    fn import(&self) -> Result<ExitCode> {
        let groups: Vec<Group> = self.exclude.iter().map(|&name| name.into()).collect();
        let named = |error: ti_gauge::error::Error| error.within(&self.file.display().to_string());
        // A file that is refused leaves the gauge alone.
        let mut file = self.file(mounted::chip(&self.gauge)?, &groups)?;
        let gauge = mounted::now(&self.gauge)?;
        if let Some(sum) = file.chemistry_sum.filter(|_| !self.same_chemistry) {
            let same = mounted::check_chemistry(&self.gauge, gauge.chip, sum)?;
            eprintln!("gaugefs: {}: {same}", self.gauge.display());
        }
        file.keep_reserved(&gauge);
        let Changes { changes, passed_over } =
            gauge.changes(&file, &groups, self.allow_unproven).map_err(named)?;
        let raw = if groups.contains(&Group::Undocumented) {
            Vec::new()
        } else {
            file.raw_changes(|id| mounted::raw_of(&self.gauge, id), self.raw).map_err(named)?
        };
        if !self.dry_run {
            let bar = progress::Bar::start(&self.gauge);
            let outcome = mounted::apply(&self.gauge, &changes, &raw);
            bar.end();
            outcome?;
        }
        print(&changes.iter().map(|change| format!("{change}\n")).collect::<String>());
        print(&raw.iter().map(|change| format!("{change}\n")).collect::<String>());
        for line in &passed_over {
            eprintln!("gaugefs: {}: {line}", self.file.display());
        }
        if !passed_over.is_empty() {
            eprintln!("gaugefs: {}: {} passed over", self.file.display(), passed_over.len());
        }
        let is_equal = changes.is_empty() && raw.is_empty() && passed_over.is_empty();
        Ok(match self.dry_run {
            true if !is_equal => ExitCode::FAILURE,
            false if !passed_over.is_empty() => PASSED_OVER.into(),
            _ => ExitCode::SUCCESS,
        })
    }

    /// Reads the file, which must name the chip and, with `--complete`, hold everything that can be written.
    fn file(&self, chip: &'static Chip, exclude: &[Group]) -> Result<Image> {
        let named = self.chip.as_deref().and_then(Chip::by_name);
        let file = mounted::open(&self.file, named.or(Some(chip)), self.data_flash)?;
        let refuse = |why: String| Err(Error::new(self.file.display().to_string(), Cause::Invalid(why)));
        if named.is_none() && !file.names_chip {
            return refuse("it does not say which gauge it is for; name it with --chip".into());
        }
        let missing = if self.complete { file.missing(exclude) } else { Vec::new() };
        if missing.is_empty() {
            return Ok(file);
        }
        let count = counted(missing.len());
        refuse(format!("not complete; it lacks {count}: {}", missing.join(", ")))
    }
}

impl From<GroupName> for Group {
    fn from(name: GroupName) -> Self {
        match name {
            GroupName::Calibration => Group::Calibration,
            GroupName::Serial => Group::Serial,
            GroupName::Learned => Group::Learned,
            GroupName::Undocumented => Group::Undocumented,
            GroupName::Keys => Group::Keys,
        }
    }
}
