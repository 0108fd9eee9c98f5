// SPDX-License-Identifier: MIT

//! `gaugefs check`: is a gauge set up for its battery, and what is wrong if it is not.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::{ArgGroup, Args};
use nix::errno::Errno;
use serde::Serialize;

use super::PASSED_OVER;
use crate::config::{address, chips, standard_input};
use crate::error::{Error, Result};
use crate::output::{print, print_json, say_error};
use crate::{check, report};
use gauge_bus::clock::{Clock, RealClock};
use gauge_owner::{GaugeOptions, Opening, operations as op};
use gaugefs_client::check::Finding;
use gaugefs_client::{Gauge, mounts};
use gaugefs_host::input::Source;
use ti_gauge::check::{Checked, Facts, Rule};
use ti_gauge::chip::{Chip, Row};
use ti_gauge::dataflash::Place;
use ti_gauge::text::printable;

/// How often a gauge that is not mounted is polled at most: one that has measured nothing by then will not.
const POLLS: u32 = 5;

const CHECK: &str = "\
The rules look at the last poll, at what earlier polls have shown, and at data flash as far as it has
been read; with --read, it is read first. Nothing is written. A file is a report (gaugefs report), a
recording, or an image of a configuration, of which only data flash is checked.
Exit code 0: nothing is wrong; 1: something is, or it could not be checked; 3: nothing is wrong, but
values of a poll were missing. Doubts and notes, and rules that would need --read, do not change it.

Examples:
  gaugefs check /run/gauges/BAT0
  gaugefs check --read --json BAT0
  gaugefs check gaugefs-report-bq34z100-g1.txt
  gaugefs check golden.gm.fs";

/// Check that a gauge is set up for its battery, and show what is wrong if it is not
#[derive(Args, Debug)]
#[command(after_help = CHECK, group = ArgGroup::new("source").required(true).multiple(false).args(["gauges", "bus", "replay", "sim"]))]
pub(super) struct Check {
    /// Folders of mounted gauges, such as /run/gauges/BAT0, or files
    #[arg(value_name = "GAUGE")]
    gauges: Vec<PathBuf>,
    /// I2C bus of a gauge that is not mounted, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE")]
    bus: Option<PathBuf>,
    /// 7-bit address of the gauge [default: 0x55]
    #[arg(long, value_name = "ADDRESS", value_parser = address, requires = "bus", conflicts_with_all = ["gauges", "replay", "sim"])]
    address: Option<u8>,
    /// Chip of the gauge, or of a file that names none
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["replay", "sim"])]
    chip: Option<&'static Chip>,
    /// Write one byte per transfer, as some gauges need above 100 kHz
    #[arg(long, requires = "bus", conflicts_with_all = ["gauges", "replay", "sim"])]
    byte_writes: bool,
    /// File with the gauge's keys; a mounted gauge has them already
    #[arg(long, value_name = "FILE", requires = "bus", conflicts_with_all = ["gauges", "replay", "sim"])]
    key_file: Option<PathBuf>,
    /// Never try the manual's default key
    #[arg(long, requires = "bus", conflicts_with_all = ["gauges", "replay", "sim"])]
    no_default_keys: bool,
    /// File that --trace has written
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Simulate a gauge of this chip, to see what a check is like
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true)]
    sim: Option<&'static Chip>,
    /// Read data flash first, for the rules that need it
    #[arg(long)]
    read: bool,
    /// Print JSON, one object per line for each gauge
    #[arg(long)]
    json: bool,
}

/// What a check has found, for --json.
#[derive(Default, Serialize)]
struct Answer {
    gauge: String,
    findings: Vec<Line>,
    /// Rules that lack a value of a poll.
    missing: Vec<Line>,
    /// Rules that need data flash which was not read.
    not_looked_at: Vec<String>,
    error: Option<String>,
    exit_code: u8,
}

#[derive(Serialize)]
struct Line {
    severity: String,
    rule: String,
    values: String,
    means: String,
    remedy: String,
    source: &'static str,
}

impl Check {
    pub(super) fn run(self) -> Result<ExitCode> {
        let files: Vec<Option<&Path>> = match self.gauges.is_empty() {
            true => vec![None],
            false => self.gauges.iter().map(|path| Some(path.as_path())).collect(),
        };
        let mut worst = 0;
        for path in files {
            let mut answer = Answer::default();
            match path.map_or_else(|| self.unmounted(), |path| self.named(path)) {
                Ok((gauge, text)) => answer.take(gauge, &text),
                Err(error) => {
                    answer.gauge = path.map_or_else(String::new, |path| path.display().to_string());
                    (answer.error, answer.exit_code) = (Some(error.to_string()), 1);
                    say_error(&error);
                }
            }
            worst = match (worst, answer.exit_code) {
                // 1 is worse than 3.
                (1, _) | (_, 0) => worst,
                (_, code) => code,
            };
            match (self.json, &answer.error) {
                (true, _) => print_json(&answer)?,
                (false, None) => print(&answer.text())?,
                (false, Some(_)) => {}
            }
        }
        Ok(worst.into())
    }

    /// Checks a mounted gauge, or a file.
    fn named(&self, path: &Path) -> Result<(String, String)> {
        if path.is_dir() || mounts::of(&Gauge::named(path)?).is_some() || !path.exists() {
            return self.mounted(&Gauge::open(path)?);
        }
        let name = path.display().to_string();
        let source = Source::read(path)?;
        if report::chip(&String::from_utf8_lossy(&source.bytes)).is_some() {
            let replay = Some(path.to_path_buf());
            return self.opened(name, &GaugeOptions { replay, ..GaugeOptions::default() });
        }
        let image = source.image(self.chip, false)?;
        let stored = |row: Row| image.entry(row).map(|entry| entry.value.clone());
        Ok((name, check::text(&Checked::of(&Facts::of_flash(image.chip, &stored)))))
    }

    fn mounted(&self, gauge: &Gauge) -> Result<(String, String)> {
        const FILE: &str = "gauge/check";
        if self.read {
            let chip = gauge.chip()?;
            for row in readable(chip).map(|index| &chip.subclasses[index]) {
                let file = format!("df/{}", Place::of((row, &row.parameters[0])));
                gauge.text(&file).map_err(|error| error.doing("data flash cannot be read"))?;
            }
        }
        let absent = |error: gaugefs_client::Error| match error.errno() == Some(Errno::ENOENT as i32) {
            true => {
                Error::host(gauge.folder().display().to_string(), Errno::ENODEV, "the gauge does not answer")
            }
            false => error.doing("cannot be checked").into(),
        };
        Ok((gauge.folder().display().to_string(), gauge.text(FILE).map_err(absent)?))
    }

    fn unmounted(&self) -> Result<(String, String)> {
        let options = GaugeOptions {
            sim: self.sim,
            bus: self.bus.clone(),
            address: self.address,
            chip: self.chip,
            byte_writes: self.byte_writes,
            key_file: self.key_file.clone(),
            no_default_keys: self.no_default_keys,
            replay: self.replay.clone().map(standard_input),
            ..GaugeOptions::default()
        };
        self.opened(gauge_owner::Source::of(&options)?.to_string(), &options)
    }

    /// Checks a gauge that is opened for it, and polled until it has measured.
    fn opened(&self, name: String, options: &GaugeOptions) -> Result<(String, String)> {
        let clock = Arc::new(RealClock::new());
        let place = Path::new("/proc").join(std::process::id().to_string());
        let opening = Opening { read_only: true, no_backup: true, ..Opening::new(place, clock.clone()) };
        let ready = opening.one("check".into(), options)?;
        let handle = &ready.handle;
        let failed = |error: Error| error.within(&name);
        for _ in 0..POLLS {
            handle.wait_for(&op::REFRESH, ()).map_err(failed)?;
            if handle.published().snapshot.as_ref().is_some_and(|snapshot| snapshot.is_valid) {
                break;
            }
            clock.sleep(Duration::from_secs(1));
        }
        if self.read && options.replay.is_none() {
            handle.wait_for(&op::READ, readable(handle.chip()).collect()).map_err(failed)?;
        }
        let published = handle.published();
        let none = || Error::host(&name, Errno::ENODEV, "the gauge does not answer");
        let snapshot = published.snapshot.as_ref().ok_or_else(none)?;
        Ok((name.clone(), check::text(&check::of(handle, snapshot, 1.0))))
    }
}

/// The subclasses that a check reads, by their indices in the table.
fn readable(chip: &'static Chip) -> impl Iterator<Item = usize> {
    gauge_owner::readable(chip).into_iter().filter(|&index| !chip.subclasses[index].is_opaque())
}

impl Answer {
    /// Takes the text of `gauge/check`.
    fn take(&mut self, gauge: String, text: &str) {
        // A command takes a gauge that is mounted.
        let is_mounted = Path::new(&gauge).is_dir();
        let names = |text: String| if is_mounted { text.replace("GAUGE", &gauge) } else { text };
        for Finding { severity, rule, values, means, remedy } in Finding::all(text) {
            let source = Rule::by_name(&rule).map_or("", |rule| rule.source);
            match severity.as_str() {
                "unread" => self.not_looked_at.push(rule),
                "missing" => self.missing.push(Line { severity, rule, values, means, remedy, source }),
                _ => {
                    self.findings.push(Line { severity, rule, values, means, remedy: names(remedy), source })
                }
            }
        }
        let is_wrong = self.findings.iter().any(|line| line.severity == "wrong");
        self.exit_code = match (is_wrong, self.missing.is_empty()) {
            (true, _) => 1,
            (false, false) => PASSED_OVER,
            (false, true) => 0,
        };
        self.gauge = gauge;
    }

    fn text(&self) -> String {
        let count = |severity: &str| self.findings.iter().filter(|line| line.severity == severity).count();
        let counts = ["wrong", "doubtful", "note"].map(|word| (word, count(word)));
        let counts: Vec<_> = counts
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|(word, count)| format!("{word}: {count}"))
            .collect();
        let told = if counts.is_empty() { "nothing found".into() } else { counts.join(", ") };
        let mut text = format!("{}: {told}\n", printable(&self.gauge));
        // Writing to a String does not fail.
        for Line { severity, rule, values, means, remedy, .. } in &self.findings {
            let _ = writeln!(text, "{severity:8}  {rule}: {values}\n          {means}\n          {remedy}");
        }
        for Line { rule, values, .. } in &self.missing {
            let _ = writeln!(text, "missing   {rule}: {values} has no value now");
        }
        if !self.not_looked_at.is_empty() {
            let _ = writeln!(
                text,
                "not looked at without data flash (--read): {}",
                self.not_looked_at.join(", ")
            );
        }
        text
    }
}
