// SPDX-License-Identifier: MIT

//! `gaugefs learned`: what the daemon keeps of a RAM gauge's learned values.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use clap::builder::NonEmptyStringValueParser;

use crate::error::Result;
use crate::output::print;
use gaugefs_client::Gauge;

const LEARNED: &str = "\
A gauge without flash loses with its power what Impedance Track has learned of the pack: Qmax, Ra and
more. gaugefs saves that in --state-dir, and writes it again with the profile if the pack was named
with --pack; no such gauge can tell its pack from another one after a loss of power. Values that
cannot be right are not written, and this command says which. The newest 10 versions are kept, and the
last one of each of 30 days.

Examples:
  gaugefs learned /run/gauges/BAT0             what is kept, and from when
  gaugefs learned /run/gauges/BAT0 --restore   write it now: this is the pack
  gaugefs learned BAT0 --restore=20261125T093000Z     an older version
  gaugefs learned /run/gauges/BAT0 --forget    another pack is there";

/// Show, restore or forget what a gauge without flash has learned
#[derive(Args, Debug)]
#[command(after_help = LEARNED)]
pub(super) struct Learned {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Write the newest version to the gauge, with its profile, or the one of that time
    #[arg(long, value_name = "VERSION", num_args = 0..=1, require_equals = true, conflicts_with = "forget")]
    #[arg(value_parser = NonEmptyStringValueParser::new())]
    #[expect(clippy::option_option, reason = "without the option, without a value, with one")]
    restore: Option<Option<String>>,
    /// Remove what is kept of this pack
    #[arg(long)]
    forget: bool,
}

impl Learned {
    pub(super) fn run(self) -> Result<ExitCode> {
        let gauge = Gauge::open(&self.gauge)?;
        let wish = match (self.restore, self.forget) {
            (Some(version), _) => format!("restore {}", version.unwrap_or_default()),
            (None, true) => "forget".into(),
            (None, false) => "show".into(),
        };
        let told = gauge.learned(&wish)?;
        // The request is done, printed or not.
        print(&told).map_err(|error| error.within(told.trim_end()))?;
        Ok(ExitCode::SUCCESS)
    }
}
