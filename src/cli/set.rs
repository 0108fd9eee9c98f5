// SPDX-License-Identifier: MIT

//! `gaugefs set`.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, ValueHint};

use super::assignment::{self, Assignment};
use super::batch::{Batch, FAILED, Report, TROUBLE};
use super::{capacity, mounted, trouble};
use crate::error::{Cause, Error, Result};
use gaugefs_client::Gauge;
use ti_gauge::chip::Row;
use ti_gauge::image::Changes;

const SET: &str = "\
NAME is a parameter's name in df/by-name, without its class if no other class has one of that
name, or its place, such as 80/53. VALUE is a number in the parameter's unit, or one with a unit
(3.1V, 2200mAh, 25degC) that gives exactly a value which can be stored; a date is 2026-11-22. All
values are written in one transaction, or none. Data flash has the numbers that the gauge stores:
--current-scale and the like do not apply to it.

Exit code 0: the gauge has these values, 1: failed. With --dry-run, as diff(1) has them: 0: the
gauge has them already, 1: it has not, 2: they could not be compared. Of several gauges, the
worst.

Examples:
  gaugefs set /run/gauges/BAT0 it-cfg/cell-terminate-voltage=3.1V
  gaugefs set /run/gauges/BAT0 design-capacity=2200mAh serial-number=0x0107
  gaugefs set --dry-run /run/gauges/BAT0 /run/gauges/BAT1 80/53=3100";

/// Write parameters of mounted gauges by name, all of them or none
#[derive(Args, Debug)]
#[command(after_help = SET)]
pub(super) struct Set {
    /// Folders of mounted gauges, then the parameters and their values
    #[arg(required = true, num_args = 1.., value_names = ["GAUGE", "NAME=VALUE"], value_hint = ValueHint::Hostname)]
    words: Vec<OsString>,
    /// Show old and new values, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    batch: Batch,
}

impl Set {
    pub(super) fn run(self) -> Result<ExitCode> {
        let Self { words, dry_run, batch } = self;
        let failure = if dry_run { TROUBLE } else { FAILED };
        let (gauges, rest) =
            match assignment::split(words).and_then(|(gauges, rest)| Ok((gauges, parsed(&rest)?))) {
                Ok(split) => split,
                Err(error) => return trouble(Err(error)),
            };
        Ok(batch.run(&gauges, failure, |gauge, report| set(gauge, &rest, dry_run, report)))
    }
}

fn parsed(words: &[String]) -> Result<Vec<Assignment>> {
    let parse = |word: &String| {
        let name = word.split('=').next().unwrap_or_default();
        word.parse().map_err(|why: String| Error::new(name, Cause::Invalid, why))
    };
    let assignments: Vec<Assignment> = words.iter().map(parse).collect::<Result<_>>()?;
    if assignments.is_empty() {
        return Err(Error::new("", Cause::Invalid, "nothing to set; write NAME=VALUE after the gauges"));
    }
    Ok(assignments)
}

fn set(gauge: &Gauge, assignments: &[Assignment], dry_run: bool, report: &mut Report) -> Result<u8> {
    let chip = gauge.chip()?;
    // A refused command line leaves the gauge alone.
    let wanted = assignment::wanted(chip, assignments)?;
    mounted::poll(gauge)?;
    report.identify(gauge);
    let presence = gauge.presence()?;
    let stored = gauge.values(chip, &wanted.rows())?;
    // The mount decides whether unproven parameters may be written.
    let Changes { changes, .. } = stored.changes(wanted.image(), &[], true)?;
    let energy: Vec<Row> = capacity::energy(chip, &[wanted.image()]).into_iter().collect();
    let beside = gauge.values(chip, &energy)?;
    if !dry_run {
        gauge.apply(&presence, &changes, &[])?;
    }
    report.change(&changes, &[]);
    capacity::say_what_stays(gauge, &beside, &[wanted.image()], &changes);
    Ok(report.done(dry_run))
}
