//! The commands that show, record and watch mounted gauges: `top`, `learn`, `log`, `plot`, `wait`, `watch` and
//! `metrics`. The cargo feature `screen` guards this module and its place in the command line.

use std::process::ExitCode;
use std::time::Duration;

use clap::Subcommand;

use crate::error::Result;

mod alert;
mod decimal;
mod learn;
mod learning;
mod log;
mod metrics;
mod plot;
mod thin;
mod ticks;
mod top;
mod wait;

/// The commands of this module.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Top(top::Top),
    Learn(learn::Learn),
    Log(log::Log),
    Plot(plot::Plot),
    Wait(wait::Wait),
    Metrics(metrics::Metrics),
    Watch(alert::Watch),
}

impl Command {
    pub(crate) fn run(self) -> Result<ExitCode> {
        match self {
            Self::Top(top) => top.run(),
            Self::Learn(learn) => learn.run(),
            Self::Log(log) => log.run(),
            Self::Plot(plot) => plot.run(),
            Self::Wait(wait) => wait.run(),
            Self::Metrics(metrics) => metrics.run(),
            Self::Watch(watch) => watch.run(),
        }
    }
}

/// The value of `--interval`.
fn seconds(text: &str) -> Result<Duration, String> {
    gaugefs_host::seconds(text, (0.1, 86400.0))
}
