//! `gaugefs import`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::print;
use crate::error::Result;
use crate::image::Group;
use crate::mounted;

mod progress;

const IMPORT: &str = "\
What differs is written through df/transaction and shown. Keys are left out, and so are rows
whose address or range is not sure. Where a FlashStream has other bytes than the gauge and no
manual documents them it is refused, but for --raw or --exclude undocumented.

Examples:
  gaugefs import --dry-run /run/gauges/BAT0 pack.toml
  gaugefs import --exclude calibration,serial /run/gauges/BAT0 golden.gm.fs";

/// Give a mounted gauge the configuration of a file, all of it or nothing
#[derive(Args, Debug)]
#[command(after_help = IMPORT)]
pub(super) struct Import {
    /// A mounted gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// A file of any format
    file: PathBuf,
    /// Only show what would change
    #[arg(long)]
    dry_run: bool,
    /// Leave these as they are
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUPS")]
    exclude: Vec<GroupName>,
    /// Write bytes too that no manual documents
    #[arg(long)]
    raw: bool,
}

/// The groups of parameters that an import can leave alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum GroupName {
    /// The classes Calibration: measured for each circuit
    Calibration,
    /// Serial number, date and lots
    Serial,
    /// What the gauge has learned of its pack
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
