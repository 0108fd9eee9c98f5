// SPDX-License-Identifier: MIT

//! `gaugefs import`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::assignment::{self, Assignment};
use super::batch::{Batch, FAILED, Report, TROUBLE};
use super::{capacity, counted, mounted, trouble};
use crate::config::chip_names;
use crate::error::{Cause, Error, Result};
use crate::output::say;
use gaugefs_client::{Gauge, Wanted};
use gaugefs_host::chemistry;
use gaugefs_host::input::Source;
use ti_gauge::chip::Chip;
use ti_gauge::image::{Changes, Chemistry, Group, Image};

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
everything already, 1: it has not, 2: they could not be compared. Each of several gauges is done for
itself; the exit code is the worst.

Examples:
  gaugefs import --dry-run /run/gauges/BAT0 pack.toml
  gaugefs import --set serial-number=42 /run/gauges/BAT0 golden.toml
  gaugefs import --json /run/gauges/BAT* golden.toml
  gaugefs import --exclude calibration,serial /run/gauges/BAT0 golden.gm.fs";

/// Write a configuration file to a mounted gauge, all of it or nothing
#[derive(Args, Debug)]
#[command(after_help = IMPORT)]
pub(super) struct Import {
    /// Folders of mounted gauges, such as /run/gauges/BAT0
    #[arg(required = true, value_name = "GAUGE")]
    gauges: Vec<PathBuf>,
    /// Configuration file in any format that export writes; - is standard input
    file: PathBuf,
    /// Write this value in place of the file's, with a name and a unit as `gaugefs set` takes them;
    /// --exclude does not apply to it
    #[arg(long, value_name = "NAME=VALUE")]
    set: Vec<Assignment>,
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
    #[command(flatten)]
    batch: Batch,
}

/// Groups of parameters that an import or a comparison can skip.
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
        let failure = if self.dry_run { TROUBLE } else { FAILED };
        let source = match Source::read(&self.file) {
            Err(error) if self.dry_run => return trouble(Err(error)),
            read => read?,
        };
        Ok(self.batch.run(&self.gauges, failure, |gauge, report| self.import(gauge, &source, report)))
    }

    fn import(&self, gauge: &Gauge, source: &Source, report: &mut Report) -> Result<u8> {
        let groups: Vec<Group> = self.exclude.iter().map(|&name| name.into()).collect();
        let named = |error: Error| error.within(&source.name);
        // A refused file leaves the gauge alone.
        let chip = gauge.chip()?;
        let set = assignment::wanted(chip, &self.set)?;
        let mut file = self.file(chip, source, &groups, &set)?;
        file.entries.retain(|entry| !set.image().entries.iter().any(|other| other.is(entry)));
        mounted::poll(gauge)?;
        let presence = gauge.presence()?;
        let (image, path) = (gauge.configuration()?, gauge.folder().display());
        report.identify(gauge);
        if let Some(chemistry) = file.chemistry.filter(|_| !self.same_chemistry) {
            let same = check_chemistry(gauge, chip, chemistry)?;
            say(format_args!("{path}: {same}"));
        }
        file.keep_reserved(&image);
        let Changes { mut changes, mut passed_over } =
            image.changes(&file, &groups, self.allow_unproven).map_err(named)?;
        // Groups that are left out do not concern values of the command line, and the mount decides whether unproven
        // ones may be written.
        let Changes { changes: more, passed_over: hidden } = image.changes(set.image(), &[], true)?;
        changes.extend(more);
        passed_over.extend(hidden);
        let raw = if groups.contains(&Group::Undocumented) {
            if let Some(what) = file.other_chemistry(|id| gauge.raw(id)).map_err(named)? {
                let name = &source.name;
                say(format_args!(
                    "gauge {path}: --exclude undocumented leaves out the chemistry of {name}, which differs: {what}"
                ));
            }
            Vec::new()
        } else {
            file.raw_changes(|id| gauge.raw(id), self.raw).map_err(named)?
        };
        if !self.dry_run {
            let bar = progress::Bar::start(gauge);
            let outcome = gauge.apply(&presence, &changes, &raw);
            bar.end();
            outcome?;
        }
        report.change(&changes, &raw);
        capacity::say_what_stays(gauge, &image, &[&file, set.image()], &changes);
        let head = if self.gauges.len() > 1 { format!("{path}: ") } else { String::new() };
        for line in &passed_over {
            say(format_args!("{head}{}: {line}", source.name));
        }
        if !passed_over.is_empty() {
            say(format_args!("{head}{}: {} passed over", source.name, passed_over.len()));
        }
        report.passed_over = passed_over;
        Ok(report.done(self.dry_run))
    }

    /// Reads the file, which must name the chip and, with `--complete`, contain everything writable that the command
    /// line does not set.
    fn file(&self, chip: &'static Chip, source: &Source, exclude: &[Group], set: &Wanted) -> Result<Image> {
        let named = self.chip.as_deref().and_then(Chip::by_name);
        let file = source.image(named.or(Some(chip)), self.data_flash)?;
        let refuse = |why: String| Err(Error::new(&source.name, Cause::Invalid, why));
        if named.is_none() && !file.names_chip {
            return refuse("it does not say which gauge it is for; name it with --chip".into());
        }
        let mut missing = if self.complete { file.missing(exclude) } else { Vec::new() };
        missing.retain(|name| !set.image().entries.iter().any(|entry| set.image().name(entry) == *name));
        if missing.is_empty() {
            return Ok(file);
        }
        let count = counted(missing.len());
        refuse(format!("not complete; it lacks {count}: {}", missing.join(", ")))
    }
}

/// Checks that the gauge has the chemistry of an image for ROM mode, which an import cannot write. Returns a line that
/// says so.
fn check_chemistry(gauge: &Gauge, chip: &Chip, expected: Chemistry) -> Result<String> {
    let chem_id = gauge.text("gauge/chem_id").unwrap_or_default();
    let name = gauge.folder().display().to_string();
    let told = (chem_id.trim(), "pass --same-chemistry");
    chemistry::check(&name, chip, expected, told, |code| Ok(gauge.ask(code)?))
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
