// SPDX-License-Identifier: MIT

//! `gaugefs watch`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use crate::config::{self, AlertOptions, At, Given, names};
use crate::error::{Cause, Error, Result};
use gaugefs_screen::watch::Rule;

const WATCH: &str = "\
An alert is raised when its condition is true, as `gaugefs wait --help` explains it, and cleared
when the condition of --clear is true. Without --clear that is when the first condition is false; a
value that is missing clears nothing. Each change is printed as a line, and the program of --exec or
--exec-clear is run for it: without a shell, unless CMD is sh -c '...', and never two at a time for
one alert of one gauge. What follows CMD belongs to it, up to a `;`; an option of `gaugefs watch` is
refused there: write it before --exec, or behind the `;`. The environment of the program has:

  GAUGEFS_EVENT       raised or cleared
  GAUGEFS_ALERT       name of the alert
  GAUGEFS_CONDITION   its condition
  GAUGEFS_VALUE       text of the first file that it compares, if there is one
  GAUGEFS_GAUGE       folder of the gauge
  POWER_SUPPLY_*      the lines of its uevent

When it starts, it looks whether each program is there. --test runs each of them once, whatever the
gauges show and with GAUGEFS_TEST=1 in its environment, says which fails, and ends: a program that
turns the machine off does so.

A program that fails is reported, and nothing else happens. An alert that comes and goes while its
program runs is not reported to it again. Everything is read after each poll of the mount, which
causes no bus traffic.

Examples:
  gaugefs watch /run/gauges 'capacity<=5 && status==Discharging' --for 60 \\
    --exec systemctl poweroff
  gaugefs watch BAT0 'temp>50C' --clear 'temp<45C' --exec fan on \\; \\
    --exec-clear fan off
  gaugefs watch --config /etc/gaugefs/gaugefs.toml     its [[alert]] tables";

/// Run programs when conditions on gauges come true
#[derive(Args, Debug)]
#[command(after_help = WATCH)]
pub(super) struct Watch {
    /// Mount point, or folder of a mounted gauge, such as /run/gauges/BAT0
    #[arg(required_unless_present = "config")]
    gauge: Option<PathBuf>,
    /// Take the alerts, and the mount point if there is no other, from this file
    #[arg(long, value_name = "FILE", conflicts_with_all = of_alert())]
    config: Option<PathBuf>,
    /// Run the program of each alert once, now, and end
    #[arg(long)]
    test: bool,
    #[command(flatten)]
    alert: Given<AlertOptions>,
}

impl Watch {
    pub(super) fn run(self) -> Result<ExitCode> {
        let (place, alerts) = match self.config {
            Some(file) => {
                let (mountpoint, alerts) = config::alerts(&file)?;
                let place = self.gauge.or(mountpoint).ok_or_else(|| {
                    let why = "no mount point; give one on the command line, or set mountpoint below [mount]";
                    Error::new(file.display().to_string(), Cause::Invalid, why)
                })?;
                (place, alerts)
            }
            None => (self.gauge.expect("clap demands it"), vec![self.alert.options()]),
        };
        let rules: Vec<Rule> = alerts.into_iter().map(Rule::from).collect();
        match self.test {
            true => gaugefs_screen::watch::test(&place, &rules),
            false => gaugefs_screen::watch::run(&place, &rules),
        }
    }
}

/// The options of each alert in a file.
fn of_alert() -> impl Iterator<Item = &'static str> {
    names::<AlertOptions>(At::Argument).chain(names::<AlertOptions>(At::Line))
}

impl From<AlertOptions> for Rule {
    fn from(options: AlertOptions) -> Self {
        let AlertOptions { when, clear, hold, exec, exec_clear, name, gauge } = options;
        let when = when.expect("the command line and the file demand a condition");
        Self { when, clear, hold: hold.unwrap_or_default(), exec, exec_clear, name, gauge }
    }
}
