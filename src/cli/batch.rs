// SPDX-License-Identifier: MIT

//! A command for several gauges: each gets its own run, and the worst exit code counts.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;
use serde_json::{Number, Value as Json};

use super::PASSED_OVER;
use crate::error::{Details, Result};
use crate::output::{print, print_json, say, say_error};
use gaugefs_client::Gauge;
use ti_gauge::image::{Difference, Entry, RawDifference};
use ti_gauge::unit;
use ti_gauge::value::Type;

/// Exit code of a failure where 1 has another meaning.
pub(super) const TROUBLE: u8 = 2;
/// Exit code of other failures, and of a difference.
pub(super) const FAILED: u8 = 1;

#[derive(Args, Clone, Copy, Debug)]
pub(super) struct Batch {
    /// Print JSON, one object per line for each gauge
    #[arg(long)]
    pub(super) json: bool,
    /// Leave out the gauges after the first one that fails
    #[arg(long)]
    pub(super) fail_fast: bool,
}

/// The result for a gauge, as lines or as an object of --json.
#[derive(Debug, Default, Serialize)]
pub(super) struct Report {
    gauge: String,
    part: Option<String>,
    serial: Option<String>,
    outcome: &'static str,
    /// Old and new values.
    #[serde(skip_serializing_if = "Option::is_none")]
    changes: Option<Vec<Row>>,
    /// The values that were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) values: Option<Vec<Value>>,
    /// The file that was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) file: Option<String>,
    /// Values that the format of `file` cannot hold.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) left_out: Vec<String>,
    pub(super) passed_over: Vec<String>,
    error: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error_details: Option<Details>,
    exit_code: u8,
    /// The lines printed without --json.
    #[serde(skip)]
    lines: Vec<String>,
}

/// A changed value, or one that would change.
#[derive(Debug, Serialize)]
struct Row {
    name: String,
    old: Option<Json>,
    new: Json,
    unit: &'static str,
}

#[derive(Debug, Serialize)]
pub(super) struct Value {
    name: String,
    value: Json,
    unit: &'static str,
}

impl Value {
    pub(super) fn new(name: String, entry: &Entry) -> Self {
        Self { name, value: json(entry), unit: unit::shown(entry.parameter) }
    }
}

/// A value for --json: a number if shown in decimal, otherwise its text.
pub(super) fn json(entry: &Entry) -> Json {
    let shown = entry.shown();
    let is_number =
        matches!(entry.parameter.kind, Type::I(_) | Type::U(_) | Type::F4) && !entry.parameter.is_date();
    match shown.parse::<Number>() {
        Ok(number) if is_number => number.into(),
        _ => shown.into(),
    }
}

impl Report {
    pub(super) fn change(&mut self, changes: &[Difference<'_>], raw: &[RawDifference]) {
        let rows = changes.iter().map(|change| Row {
            name: change.name.clone(),
            old: Some(json(change.old)),
            new: json(change.new),
            unit: unit::shown(change.new.parameter),
        });
        let bytes = raw.iter().map(|change| Row {
            name: change.new.name(),
            old: change.old.as_deref().map(|bytes| ti_gauge::text::hex(bytes).into()),
            new: change.new.text().into(),
            unit: "",
        });
        self.changes.get_or_insert_default().extend(rows.chain(bytes));
        self.lines.extend(changes.iter().map(ToString::to_string));
        self.lines.extend(raw.iter().map(ToString::to_string));
    }

    /// Notes the gauge as the last poll has shown it, because a write may change its serial number.
    pub(super) fn identify(&mut self, gauge: &Gauge) {
        (self.part, self.serial) = gauge.pack();
    }

    pub(super) fn say(&mut self, line: String) {
        self.lines.push(line);
    }

    /// Sets the outcome of a gauge without a failure, and returns its exit code.
    pub(super) fn done(&mut self, dry_run: bool) -> u8 {
        let changes = !self.lines.is_empty();
        let (outcome, code) = match (dry_run, changes, self.passed_over.is_empty()) {
            (true, false, true) => ("unchanged", 0),
            (true, ..) => ("differs", FAILED),
            (false, true, true) => ("written", 0),
            (false, true, false) => ("written", PASSED_OVER),
            (false, false, true) => ("unchanged", 0),
            (false, false, false) => ("unchanged", PASSED_OVER),
        };
        self.outcome = outcome;
        code
    }

    /// The exit code of a read-only command.
    pub(super) fn read(&mut self) -> u8 {
        self.outcome = "read";
        if self.passed_over.is_empty() { 0 } else { PASSED_OVER }
    }
}

impl Batch {
    /// Runs `act` for each gauge, which returns that gauge's exit code. A failed gauge has the exit code `failure`.
    pub(super) fn run(
        self,
        gauges: &[PathBuf],
        failure: u8,
        mut act: impl FnMut(&Gauge, &mut Report) -> Result<u8>,
    ) -> ExitCode {
        let several = gauges.len() > 1;
        let mut worst = 0;
        for (at, path) in gauges.iter().enumerate() {
            let mut report = Report { gauge: path.display().to_string(), ..Report::default() };
            let outcome = Gauge::open(path).map_err(Into::into).and_then(|gauge| {
                report.gauge = gauge.folder().display().to_string();
                act(&gauge, &mut report).inspect_err(|_| {
                    if report.part.is_none() {
                        report.identify(&gauge);
                    }
                })
            });
            report.exit_code = outcome.unwrap_or_else(|error| {
                say_error(&error);
                (report.outcome, report.error) = ("failed", Some(error.to_string()));
                report.error_details = Some(Details::of(&error));
                failure
            });
            let failed = report.error.is_some();
            let printed = match self.json {
                true => print_json(&report),
                false if failed => Ok(()),
                false => print(&text(&report, several)),
            };
            if worst_of(worst, report.exit_code) {
                worst = report.exit_code;
            }
            let left = gauges.len() - at - 1;
            if let Err(error) = printed {
                // Nobody would know the outcome of the other gauges.
                say(error.within(&format!("{}: {}", report.gauge, report.outcome)));
                if left > 0 {
                    say(format_args!("{left} more not tried"));
                }
                return failure.into();
            }
            if failed && self.fail_fast && left > 0 {
                say(format_args!("{left} more not tried, because of --fail-fast"));
                break;
            }
        }
        worst.into()
    }
}

/// Lines of a gauge. Among several gauges they begin with its folder and serial number.
fn text(report: &Report, several: bool) -> String {
    let head = match (&report.serial, several) {
        (_, false) => String::new(),
        (Some(serial), true) => format!("{} serial {serial}: ", report.gauge),
        (None, true) => format!("{}: ", report.gauge),
    };
    let mut text: String = report.lines.iter().map(|line| format!("{head}{line}\n")).collect();
    if several && report.lines.is_empty() && report.outcome == "unchanged" {
        text = format!("{head}unchanged\n");
    }
    text
}

/// Whether an exit code is worse: a failure is worse than something left out, which is worse than success.
fn worst_of(worst: u8, code: u8) -> bool {
    let rank = |code: u8| [0, PASSED_OVER, FAILED, TROUBLE].iter().position(|known| *known == code);
    rank(code) > rank(worst)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_exit_code_counts() {
        for (codes, worst) in [
            (&[0, 0][..], 0),
            (&[0, PASSED_OVER, 0], PASSED_OVER),
            (&[PASSED_OVER, FAILED, 0], FAILED),
            (&[FAILED, PASSED_OVER], FAILED),
            (&[FAILED, TROUBLE, 0], TROUBLE),
        ] {
            let found = codes.iter().fold(0, |worst, &code| if worst_of(worst, code) { code } else { worst });
            assert_eq!(found, worst, "{codes:?}");
        }
    }
}
