// SPDX-License-Identifier: MIT

//! `gaugefs top`: a live screen of all mounted gauges, or the same as JSON lines.
//!
//! It reads only files that cause no transfer. It reads data flash when a key asks for it, and once a minute
//! while the gauge is unsealed anyway and the screen shows the learned values.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use nix::errno::Errno;
use serde::Serialize;
use serde_json::Value;

use gaugefs_client::names::attribute;
use gaugefs_client::sample::Sample;
use gaugefs_client::watch::{Report, Seen, Watch};
use gaugefs_client::{check, mounts};
use gaugefs_host::error::{Error, Result};
use gaugefs_host::output::{self, print_json};

use history::Past;

mod draw;
mod history;
mod model;
#[cfg(test)]
pub(crate) mod picture;
pub(crate) mod terminal;
#[cfg(test)]
pub(crate) mod tests;

const TOP: &str = "\
Keys: q quit, arrows or tab select a gauge, v i c t a quantity, + - time span, l learning,
p pause, r poll now, d read data flash, ? help.

Charge, voltage, current and temperature are shown together from 100 columns and 24 lines or so on,
and v i c t show one of them. The charge is yellow or red where the gauge itself calls it low or
critical, as `capacity_level` does.

Watching causes no bus traffic: the values come from the polls of the mount. Only the learned
values are read from data flash: when d is pressed, which unseals a sealed gauge and seals it
again, and once a minute while l shows them and the gauge is unsealed anyway.

Examples:
  gaugefs top
  gaugefs top /run/gauges/BAT0
  gaugefs top --history history.csv     while gaugefs log goes on, or after it
  gaugefs top --json --interval 10 --count 6";

/// Show mounted gauges and their history on a live screen
#[derive(Args, Debug)]
#[command(after_help = TOP)]
pub struct Top {
    /// Mount point, or folder of a mounted gauge [default: all mounted gauges]
    gauge: Option<PathBuf>,
    /// Print JSON instead, one object per line for each gauge and interval
    #[arg(long)]
    json: bool,
    /// CSV file of `gaugefs log`, whose history the charts begin with
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    history: Option<PathBuf>,
    /// Time between two updates
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = super::seconds)]
    interval: Duration,
    /// Stop after this many objects for each gauge
    #[arg(long, value_name = "N", requires = "json", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

impl Top {
    pub(super) fn run(self) -> Result<ExitCode> {
        let terminal = output::is_terminal() && io::stdin().is_terminal();
        if !(self.json || terminal) {
            let why = "not a terminal; use --json in a program";
            return Err(Error::host("standard output", Errno::ENOTTY, why));
        }
        let logs = match &self.history {
            Some(file) => Past::of(super::plot::recorded(file)?),
            None => Vec::new(),
        };
        let watch = Watch::start(self.gauge.as_deref(), Some(self.interval))?;
        if self.json {
            return self.stream(watch);
        }
        terminal::run(watch, self.interval, logs)?;
        Ok(ExitCode::SUCCESS)
    }

    fn stream(&self, mut watch: Watch) -> Result<ExitCode> {
        let mut printed: Vec<(PathBuf, u64)> = Vec::new();
        // Indices of the roots that have reported all their gauges.
        let mut complete = BTreeSet::new();
        let mut searched = Instant::now();
        loop {
            let report = watch.next(self.interval);
            if report.is_none() || searched.elapsed() >= self.interval {
                searched = Instant::now();
                watch.find_mounts()?;
            }
            let Some(report) = report else { continue };
            if report.left == 0 {
                complete.insert(report.root);
            }
            // A mount's trouble is the trouble of each gauge that was there.
            let is_root = watch.roots.contains(&report.gauge);
            let below: Vec<PathBuf> = printed
                .iter()
                .map(|(gauge, _)| gauge)
                .filter(|gauge| is_root && gauge.starts_with(&report.gauge))
                .cloned()
                .collect();
            if let (Seen::Trouble(why), [_, ..]) = (&report.seen, &*below) {
                for gauge in below {
                    let report = Report { gauge, seen: Seen::Trouble(why.clone()), ..report };
                    self.print(&report, &mut printed)?;
                }
            } else {
                self.print(&report, &mut printed)?;
            }
            if output::is_unread() {
                return Ok(ExitCode::SUCCESS);
            }
            // Every mount has reported all its gauges, and every gauge often enough.
            let enough = self.count.is_some_and(|count| printed.iter().all(|(_, done)| *done >= count));
            if enough && complete.len() == watch.roots.len() {
                return Ok(ExitCode::SUCCESS);
            }
        }
    }

    /// Prints a report, unless its gauge was printed often enough.
    fn print(&self, report: &Report, printed: &mut Vec<(PathBuf, u64)>) -> Result<()> {
        let known = printed.iter().position(|(gauge, _)| *gauge == report.gauge);
        let path = report.gauge.display().to_string();
        match &report.seen {
            Seen::Trouble(why) if known.is_none() && self.gauge.is_some() && printed.is_empty() => {
                return Err(Error::host(path, Errno::ENOENT, why));
            }
            Seen::Sample(_) | Seen::Trouble(_) => {}
            Seen::Learned(_) | Seen::Limits(_) | Seen::Refused(_) => return Ok(()),
        }
        let at = known.unwrap_or_else(|| {
            printed.push((report.gauge.clone(), 0));
            printed.len() - 1
        });
        if self.count.is_some_and(|count| printed[at].1 >= count) {
            return Ok(());
        }
        printed[at].1 += 1;
        match &report.seen {
            Seen::Sample(sample) => print_json(&Line::new(&path, sample)),
            Seen::Trouble(why) => {
                let (gauge, mountpoint) = match mounts::is_gaugefs(&report.gauge) {
                    true => (None, Some(&*path)),
                    false => (Some(&*path), None),
                };
                print_json(&Trouble { gauge, mountpoint, error: why })
            }
            Seen::Learned(_) | Seen::Limits(_) | Seen::Refused(_) => Ok(()),
        }
    }
}

/// A sample of a gauge; attributes have the kernel's names and units.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    gauge: &'a str,
    part: Option<&'a str>,
    serial: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    age_ms: Option<u64>,
    #[serde(flatten)]
    attributes: BTreeMap<&'a str, Value>,
    bits: BTreeMap<&'a str, Vec<&'a str>>,
    registers: BTreeMap<&'a str, i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seal: Option<&'a str>,
    last_error: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    check: Option<String>,
}

/// What `gauge/check` finds wrong and doubtful.
fn found(sample: &Sample) -> Option<String> {
    let found = [check::wrong(&sample.check), check::doubtful(&sample.check)];
    let found: Vec<String> = found.into_iter().flatten().collect();
    (!found.is_empty()).then(|| found.join("; "))
}

/// Why there is no sample.
#[derive(Serialize)]
struct Trouble<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    gauge: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mountpoint: Option<&'a str>,
    error: &'a str,
}

impl<'a> Line<'a> {
    fn new(gauge: &'a str, sample: &'a Sample) -> Self {
        let attributes = sample.attributes.iter().map(|(name, value)| {
            let is_number = attribute(name).is_some_and(|attribute| attribute.is_number());
            let number = value.parse::<i64>().ok().filter(|_| is_number);
            (name.as_str(), number.map_or_else(|| Value::from(value.as_str()), Value::from))
        });
        let bits = sample.words.iter().map(|(name, bits)| (name.as_str(), bits.split_whitespace().collect()));
        let (part, serial) = sample.pack();
        Self {
            time: format!("{:.3}", sample.time),
            gauge,
            part,
            serial,
            age_ms: sample.age.map(|age| age.as_millis() as u64),
            attributes: attributes.collect(),
            bits: bits.collect(),
            registers: sample.registers.iter().map(|(name, value)| (name.as_str(), *value)).collect(),
            seal: sample.seal.as_deref(),
            last_error: &sample.last_error,
            check: found(sample),
        }
    }
}
