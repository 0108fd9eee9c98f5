// SPDX-License-Identifier: MIT

//! The commands of gaugefs that show, record and watch mounted gauges: `top`, `learn`, `log`, `plot`, `wait`, `metrics`
//! and `events`, with their options, what `watch` does, and the [screen](mod@line) of a production line. The program
//! `gaugefs` has them with its feature `screen`.
//!
//! They use gauges only through `gaugefs-client`.
//!
//! ```
//! use clap::Parser;
//! use gaugefs_screen::Command;
//!
//! #[derive(Parser)]
//! struct Program {
//!     #[command(subcommand)]
//!     command: Command,
//! }
//!
//! let program = Program::parse_from(["gauges", "wait", "/run/gauges/BAT0", "capacity<20"]);
//! assert!(matches!(program.command, Command::Wait(_)));
//! ```

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

use std::process::ExitCode;
use std::time::Duration;

use clap::Subcommand;

use gaugefs_host::error::Result;

mod decimal;
mod events;
mod learn;
mod learning;
pub mod line;
mod log;
mod metrics;
mod plot;
mod thin;
mod ticks;
mod top;
mod wait;
pub mod watch;
mod wrap;

/// The commands of this crate.
#[derive(Debug, Subcommand)]
#[command(defer = true)]
#[allow(missing_docs, reason = "clap would take it for the description of the subcommand")]
pub enum Command {
    Top(top::Top),
    Learn(learn::Learn),
    Log(log::Log),
    Plot(plot::Plot),
    Wait(wait::Wait),
    Metrics(metrics::Metrics),
    Events(events::Events),
}

impl Command {
    /// Runs the command.
    pub fn run(self) -> Result<ExitCode> {
        match self {
            Self::Top(top) => top.run(),
            Self::Learn(learn) => learn.run(),
            Self::Log(log) => log.run(),
            Self::Plot(plot) => plot.run(),
            Self::Wait(wait) => wait.run(),
            Self::Metrics(metrics) => metrics.run(),
            Self::Events(events) => events.run(),
        }
    }
}

/// Names of a history's columns.
pub fn columns() -> impl Iterator<Item = &'static str> {
    log::columns::names()
}

/// The value of `--interval`.
fn seconds(text: &str) -> Result<Duration, String> {
    gaugefs_host::seconds(text, (0.1, 86400.0))
}
