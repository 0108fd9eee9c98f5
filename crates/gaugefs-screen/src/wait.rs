// SPDX-License-Identifier: MIT

//! `gaugefs wait`: waits until a condition is true.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use nix::errno::Errno;

use gaugefs_client::condition::Condition;
use gaugefs_client::follow::{Follow, gauges_at};
use gaugefs_host::error::{Error, Result};
use gaugefs_host::output::say;

const WAIT: &str = "\
CONDITION compares files of the gauge's folder with < <= > >= == or !=, joined by &&: capacity<20,
voltage_now<3.1V, 'temp>45C && status==Charging', gauge/statistics/failed_polls>0. A number has its
unit (V, mA, mAh, C, s, min ...), except for percent and counts. 'gauge/flags has FC' asks for a
flag. A missing value makes no comparison true; the condition `missing` is true while the gauge does
not answer.

The files are read after each poll of the mount, which causes no bus traffic.

Exit code 0: it is true, 1: failed, 3: it was not within the time of --timeout.

Examples:
  gaugefs wait /run/gauges/BAT0 status==Full && echo charged
  gaugefs wait --timeout 0 /run/gauges/BAT0 'capacity<20' && echo low";

/// Exit code if the condition was not true in time.
const TOO_LATE: u8 = 3;

/// Wait until a condition on a gauge is true
#[derive(Args, Debug)]
#[command(after_help = WAIT)]
pub struct Wait {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// What to wait for, such as 'capacity<20'
    condition: Condition,
    /// Wait for at most this long; 0 looks once [default: no limit]
    #[arg(long, value_name = "SECONDS", value_parser = limit)]
    timeout: Option<Duration>,
}

/// The value of `--timeout`.
fn limit(text: &str) -> Result<Duration, String> {
    gaugefs_host::seconds(text, (0.0, 1e9))
}

impl Wait {
    pub(super) fn run(self) -> Result<ExitCode> {
        let begun = Instant::now();
        let name = self.gauge.display().to_string();
        let [gauge] = &gauges_at(&self.gauge)?[..] else {
            let why = "more than one gauge is mounted here; name the folder of one";
            return Err(Error::host(name, Errno::EINVAL, why));
        };
        let names = self.condition.names().map(str::to_string).collect();
        let mut follow = Follow::start(gauge, names)?;
        let (mut first, mut told) = (true, false);
        loop {
            // At least one look is taken, even without time to wait.
            let left = self.timeout.map(|limit| limit.saturating_sub(begun.elapsed()));
            let left = left.filter(|_| !std::mem::replace(&mut first, false));
            let (texts, why) = match follow.next(left) {
                Some(Ok(texts)) => (Some(texts), None),
                Some(Err(why)) => (None, Some(why)),
                None => return Ok(TOO_LATE.into()),
            };
            if self.condition.holds(texts.as_ref()) == Some(true) {
                return Ok(ExitCode::SUCCESS);
            }
            if self.timeout.is_some_and(|limit| begun.elapsed() >= limit) {
                return Ok(TOO_LATE.into());
            }
            // A condition on a missing value may be a misunderstanding.
            if self.condition.holds(texts.as_ref()).is_none() && !std::mem::replace(&mut told, true) {
                let why = why.unwrap_or_else(|| self.condition.values(texts.as_ref()));
                say(format_args!("{name}: {why}; waiting"));
            }
        }
    }
}
