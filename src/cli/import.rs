//! `gaugefs import`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::print;
use crate::error::Result;
use crate::mounted;
use ti_gauge::image::Group;

mod progress;

const IMPORT: &str = "\
It writes the differences through df/transaction and prints them. It never writes keys, nor
parameters whose address or range is uncertain. A FlashStream that would change undocumented
bytes is refused, unless --raw writes them or --exclude undocumented skips them.

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
    /// Also write bytes that no manual documents
    #[arg(long)]
    raw: bool,
}

/// The groups of parameters that an import can skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum GroupName {
    /// The class Calibration: values measured for each circuit
    Calibration,
    /// Serial number, date and lot codes
    Serial,
    /// Values that the gauge has learned about its pack
    Learned,
    /// Bytes that no manual documents
    Undocumented,
}

impl Import {
    pub(super) fn run(self) -> Result<ExitCode> {
        let gauge = mounted::of_mounted(&self.gauge)?;
        let file = mounted::open(&self.file, Some(gauge.chip))?;
        let groups: Vec<Group> = self.exclude.iter().map(|&name| name.into()).collect();
        let named = |error: ti_gauge::error::Error| error.within(&self.file.display().to_string());
        let changes = gauge.changes(&file, &groups).map_err(named)?;
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
        Ok(ExitCode::SUCCESS)
    }
}

impl From<GroupName> for Group {
    fn from(name: GroupName) -> Self {
        match name {
            GroupName::Calibration => Group::Calibration,
            GroupName::Serial => Group::Serial,
            GroupName::Learned => Group::Learned,
            GroupName::Undocumented => Group::Undocumented,
        }
    }
}
