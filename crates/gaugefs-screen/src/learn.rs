// SPDX-License-Identifier: MIT

//! `gaugefs learn`: what a learning cycle waits for.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use nix::errno::Errno;
use serde::Serialize;

use super::learning;
use gaugefs_client::sample::{Moment, Sample};
use gaugefs_client::watch::{INTERVAL, Order, Seen, Watch};
use gaugefs_host::error::{Error, Result};
use gaugefs_host::output::{self, print, print_json};
use ti_gauge::learning::{Cycle, Learned, State};

const LEARN: &str = "\
Prints a line now and after each poll that changes the state of the cycle, until all is learned.
The line has Update Status, what the cycle waits for, rest or current, the slope of the voltage at
rest, the temperature, the bits of CONTROL_STATUS (-VOK: it is clear), and since when the cycle is
qualified or disqualified, and why.

All of this comes from the polls of the mount. Only Quit Current and the other thresholds are read
from data flash, once, if the gauge is unsealed; else the manual's defaults are used.
LearnedStatus() is read with every tenth poll, so Update Status may be that late. What happened
before the first poll that was watched is not known: start it before the cycle.

Exit code 0: learned. With --once, also 3: the cycle goes on, 4: it is disqualified.

Examples:
  gaugefs learn /run/gauges/BAT0
  gaugefs learn --once --json /run/gauges/BAT0";

/// Exit codes of --once.
const GOES_ON: u8 = 3;
const DISQUALIFIED: u8 = 4;

/// Watch a learning cycle: what it waits for, and what has spoiled it
#[derive(Args, Debug)]
#[command(after_help = LEARN)]
pub struct Learn {
    /// Folder of a mounted gauge
    gauge: PathBuf,
    /// Print one line and exit
    #[arg(long)]
    once: bool,
    /// Print JSON, one object per line for each poll
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Row<'a> {
    time: String,
    gauge: String,
    part: Option<&'a str>,
    serial: Option<String>,
    learned: &'static str,
    update_status: Option<u8>,
    waits_for: &'a str,
    phase: &'static str,
    phase_since: String,
    rate: Option<f64>,
    slope_uv_s: Option<f64>,
    temperature: Option<f64>,
    bits: &'a str,
    qualified: bool,
    since: String,
    /// It was so before the first watched poll.
    since_before: bool,
    why: Option<String>,
}

/// The last printed state.
struct Watched {
    cycle: Cycle,
    moment: Option<Moment>,
    state: Option<State>,
}

impl Learn {
    pub(super) fn run(self) -> Result<ExitCode> {
        let name = self.gauge.display().to_string();
        let watch = Watch::start(Some(&self.gauge), None)?;
        let mut watched: Option<(PathBuf, Watched)> = None;
        loop {
            if output::is_unread() {
                break;
            }
            let Some(report) = watch.next(INTERVAL) else { continue };
            let sample = match report.seen {
                Seen::Sample(_) if report.left > 0 => {
                    let why = "more than one gauge is mounted here; name the folder of one";
                    return Err(Error::host(name, Errno::EINVAL, why));
                }
                Seen::Sample(sample) => sample,
                Seen::Limits(limits) => {
                    if let Some((_, watched)) = &mut watched {
                        watched.cycle.set_limits(limits);
                    }
                    continue;
                }
                Seen::Trouble(why) if self.once || watched.is_none() => {
                    return Err(Error::host(name, Errno::ENOENT, why));
                }
                // A gauge that has gone may come back.
                Seen::Trouble(_) | Seen::Learned(_) | Seen::Refused(_) => continue,
            };
            let (gauge, watched) = match &mut watched {
                Some(found) => found,
                None => {
                    watch.order(report.root, Order::ReadLimits(report.gauge.clone()));
                    let why = "no learning cycle of this part is known";
                    let cycle = learning::cycle(&sample);
                    let cycle = cycle.ok_or_else(|| Error::host(name.clone(), Errno::EOPNOTSUPP, why))?;
                    watched.insert((report.gauge, Watched { cycle, moment: None, state: None }))
                }
            };
            let Some(state) = watched.update(&sample) else {
                if self.once && watched.state.is_none() {
                    let why = "the gauge is absent, or has not been measured yet";
                    return Err(Error::host(name, Errno::ENODEV, why));
                }
                continue;
            };
            let changed = watched.state.as_ref().is_none_or(|before| differ(before, &state));
            if self.json || changed {
                if self.json { print_json(&row(gauge, &sample, &state)) } else { print(&text(&state)) }?;
            }
            match (state.learned, state.spoiled) {
                (Learned::All, _) => break,
                (_, None) if self.once => return Ok(GOES_ON.into()),
                (_, Some(_)) if self.once => return Ok(DISQUALIFIED.into()),
                _ => watched.state = Some(state),
            }
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl Watched {
    /// The state after a new poll.
    fn update(&mut self, sample: &Sample) -> Option<State> {
        let same = self.moment.zip(sample.moment).is_some_and(|(before, now)| before.is_same_poll(now));
        let reading = learning::reading(sample).filter(|_| !same)?;
        self.moment = sample.moment;
        Some(self.cycle.update(&reading))
    }
}

/// Whether more than measured values has changed.
fn differ(before: &State, now: &State) -> bool {
    let kind = |state: &State| {
        (
            state.learned,
            state.update_status,
            state.waits_for,
            state.phase,
            state.bits.clone(),
            state.since.time,
        )
    };
    kind(before) != kind(now)
}

fn text(state: &State) -> String {
    format!("{}  {}\n", learning::clock(state.time), learning::line(state))
}

fn row<'a>(gauge: &std::path::Path, sample: &'a Sample, state: &'a State) -> Row<'a> {
    let (part, serial) = sample.pack();
    Row {
        time: learning::clock(state.time),
        gauge: gauge.display().to_string(),
        part,
        serial,
        learned: match state.learned {
            Learned::Nothing => "nothing",
            Learned::Qmax => "qmax",
            Learned::All => "all",
        },
        update_status: state.update_status,
        waits_for: state.waits_for,
        phase: state.phase.as_str(),
        phase_since: learning::clock(state.phase_since.time),
        rate: state.rate,
        slope_uv_s: state.slope_uv_s,
        temperature: state.degrees,
        bits: &state.bits,
        qualified: state.spoiled.is_none(),
        since: learning::clock(state.since.time),
        since_before: state.since.before,
        why: state.spoiled.map(|why| why.to_string()),
    }
}
