// SPDX-License-Identifier: MIT

//! `gaugefs get`.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, ValueHint};

use super::batch::{Batch, FAILED, Report, Value};
use super::{assignment, mounted, trouble};
use crate::error::Result;
use crate::output::say;
use gaugefs_client::Gauge;
use ti_gauge::chip::Row;
use ti_gauge::{quantity, unit};

const GET: &str = "\
NAME is a parameter's name in df/by-name, without its class if no other class has one of that
name, or its place, such as 80/53. Without a name, all parameters are shown. The gauge is polled
first, and data flash read anew. Exit code 0: done, 1: failed, 3: a value that the gauge does not
show is missing.

Examples:
  gaugefs get /run/gauges/BAT0 it-cfg/cell-terminate-voltage
  gaugefs get --json /run/gauges/BAT0 serial-number manufacture-date";

/// Show parameters of mounted gauges by name
#[derive(Args, Debug)]
#[command(after_help = GET)]
pub(super) struct Get {
    /// Folders of mounted gauges, then the parameters
    #[arg(required = true, num_args = 1.., value_names = ["GAUGE", "NAME"], value_hint = ValueHint::Hostname)]
    words: Vec<OsString>,
    #[command(flatten)]
    batch: Batch,
}

impl Get {
    pub(super) fn run(self) -> Result<ExitCode> {
        let (gauges, names) = match assignment::split(self.words) {
            Ok(split) => split,
            Err(error) => return trouble(Err(error)),
        };
        Ok(self.batch.run(&gauges, FAILED, |gauge, report| get(gauge, &names, report)))
    }
}

fn get(gauge: &Gauge, names: &[String], report: &mut Report) -> Result<u8> {
    let chip = gauge.chip()?;
    let rows: Vec<Row> =
        names.iter().map(|name| gaugefs_client::row(chip, name)).collect::<Result<_, _>>()?;
    let image = if rows.is_empty() {
        mounted::now(gauge)?
    } else {
        mounted::poll(gauge)?;
        gauge.values(chip, &rows)?
    };
    report.identify(gauge);
    let mut values = Vec::new();
    for entry in &image.entries {
        let name = image.name(entry);
        report.say(format!("{name}: {}", quantity::with_unit(&entry.shown(), unit::shown(entry.parameter))));
        values.push(Value::new(name, entry));
    }
    report.values = Some(values);
    report.passed_over = image.left_out.into_iter().map(|left| left.text).collect();
    for line in &report.passed_over {
        say(format_args!("{}: {line}", gauge.folder().display()));
    }
    Ok(report.read())
}
