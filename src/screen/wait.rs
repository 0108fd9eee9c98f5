//! `gaugefs wait`: waits until a condition is true.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use clap::Args;
use nix::errno::Errno;

use super::values::{self, Seen};
use crate::condition::Condition;
use crate::error::{Error, Result};
use crate::output::say;

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
pub(crate) struct Wait {
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
        let [gauge] = &values::gauges_at(&self.gauge)?[..] else {
            let why = "more than one gauge is mounted here; name the folder of one";
            return Err(Error::host(name, Errno::EINVAL, why));
        };
        let (sender, seen) = mpsc::channel::<Seen>();
        let names = self.condition.names().map(str::to_string).collect();
        values::follow(0, gauge.clone(), names, sender)?;
        let (mut next, mut told) = (Duration::ZERO, false);
        loop {
            // One look is taken, even if there is no time to wait.
            let left = self.timeout.map(|limit| limit.saturating_sub(begun.elapsed()));
            let silent = next + values::PATIENCE;
            let first = next.is_zero();
            let patience = left.filter(|_| !first).map_or(silent, |left| left.min(silent));
            let (texts, why) = match seen.recv_timeout(patience) {
                Ok(Seen { texts: Ok(texts), next: soon, .. }) => {
                    next = soon;
                    (Some(texts), None)
                }
                Ok(Seen { texts: Err(why), next: soon, .. }) => {
                    next = soon;
                    (None, Some(why))
                }
                Err(RecvTimeoutError::Timeout) if patience == silent => {
                    (None, Some(values::SILENT.to_string()))
                }
                Err(RecvTimeoutError::Timeout) => return Ok(TOO_LATE.into()),
                // The thread ends only with its receiver.
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Error::host(name, Errno::EIO, "a thread has ended"));
                }
            };
            if self.condition.holds(texts.as_ref()) == Some(true) {
                return Ok(ExitCode::SUCCESS);
            }
            if self.timeout.is_some_and(|limit| begun.elapsed() >= limit) {
                return Ok(TOO_LATE.into());
            }
            // Whoever waits for a value that is not there may have misunderstood something.
            if self.condition.holds(texts.as_ref()).is_none() && !std::mem::replace(&mut told, true) {
                let why = why.unwrap_or_else(|| self.condition.values(texts.as_ref()));
                say(format_args!("{name}: {why}; waiting"));
            }
        }
    }
}
