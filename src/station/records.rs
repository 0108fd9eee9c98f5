// SPDX-License-Identifier: MIT

//! `gaugefs-station records`: what the record of a station says.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use crate::command::align;
use crate::error::Result;
use crate::output::{print, print_file, say};
use gauge_station::{By, Records, Totals};

const RECORDS: &str = "\
Without an option: the outcomes of each day, and the failures by their reasons. The record is only
read, also while a station writes to it.

With --csv, a row has the outcome of a pack, and of each quantity that was measured what it had to
be, its limits, and what was measured before and after: the columns of a process-capability sheet.
A cell that a spreadsheet would take for a formula begins with an apostrophe.

Examples:
  gaugefs-station records line1.jsonl
  gaugefs-station records --by slot line1.jsonl
  gaugefs-station records --csv line1.jsonl > line1.csv";

/// Show what the record of a station says
#[derive(Args, Debug)]
#[command(after_help = RECORDS)]
pub(super) struct Show {
    /// The record; - is standard input
    file: PathBuf,
    /// Print a table for a spreadsheet
    #[arg(long, conflicts_with = "by")]
    csv: bool,
    /// Count by this only
    #[arg(long, value_enum, value_name = "WHAT")]
    by: Option<What>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    /// Days, in UTC
    Day,
    /// The slots of the station
    Slot,
    /// Images
    Image,
    /// Failures by their reasons
    Reason,
}

impl Show {
    pub(super) fn run(self) -> Result<ExitCode> {
        let records = Records::read(&self.file)?;
        if self.csv {
            print_file(&records.csv())?;
            return Ok(ExitCode::SUCCESS);
        }
        match self.by {
            Some(What::Day) => print(&groups(&records, By::Day, "day"))?,
            Some(What::Slot) => print(&groups(&records, By::Slot, "slot"))?,
            Some(What::Image) => print(&groups(&records, By::Image, "image"))?,
            Some(What::Reason) => print(&reasons(&records))?,
            None => {
                let failures = reasons(&records);
                let gap = if failures.is_empty() { "" } else { "\n" };
                print(&format!("{}{gap}{failures}", groups(&records, By::Day, "day")))?;
            }
        }
        if records.unfinished() > 0 {
            let what = "packs that were begun and have no outcome";
            say(format_args!(
                "{}: {what}: {}; a station that runs is at work on them, and the next start records that the others have \
                 failed",
                self.file.display(),
                records.unfinished()
            ));
        }
        Ok(ExitCode::SUCCESS)
    }
}

fn groups(records: &Records, by: By, name: &str) -> String {
    let row = |name: String, totals: &Totals| {
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let (passed, failed) = (totals.passed, totals.failures());
        [
            name,
            (passed + failed).to_string(),
            passed.to_string(),
            failed.to_string(),
            number(totals.first_pass_yield()),
            number(totals.mean_seconds()),
        ]
    };
    let head = [name, "packs", "passed", "failed", "first-pass %", "seconds a pack"].map(String::from);
    let mut rows = vec![head];
    rows.extend(records.groups(by).into_iter().map(|group| row(group.name, &group.totals)));
    rows.push(row("all".into(), &records.totals()));
    align(&rows)
}

fn reasons(records: &Records) -> String {
    let failures = records.failures();
    if failures.is_empty() {
        return String::new();
    }
    let head = ["failed", "step", "reason"].map(String::from);
    let rows = failures.into_iter().map(|one| [one.count.to_string(), one.step, one.reason]);
    align(&[head].into_iter().chain(rows).collect::<Vec<_>>())
}
