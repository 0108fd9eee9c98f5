// SPDX-License-Identifier: MIT

//! `gaugefs calibrate`: calibrates a mounted gauge against a meter. The daemon does it in one request.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::mounted;
use crate::config;
use crate::error::Result;
use crate::output::{print, say};
use gaugefs_client::{Gauge, Name};

/// Exit code of a calibration whose result could not be read.
const UNKNOWN: u8 = 2;
/// Interval of looks at the steps, which cause no bus traffic.
const INTERVAL: Duration = Duration::from_millis(200);

const CALIBRATE: &str = "\
Polls stop while the gauge is calibrated. It is read several times; a spread that is too large, or a
correction that no tolerance explains, is refused. The new values go through one transaction, are kept in
the journal until the gauge has been measured again, and are put back if the error has become larger.
Takes up to half a minute. Exit code 0: calibrated; 1: refused, or put back; 2: calibrated, and
another program has at once begun another calibration, so that the result is not shown.

Examples:
  gaugefs calibrate /run/gauges/BAT0 board-offset               no load
  gaugefs calibrate /run/gauges/BAT0 voltage --actual 25.2V     as a meter shows
  gaugefs calibrate /run/gauges/BAT0 current --actual -2000mA   a load of 2 A
  gaugefs calibrate /run/gauges/BAT0 temperature --actual 23.5C";

/// Calibrate a mounted gauge against a meter
#[derive(Args, Debug)]
#[command(after_help = CALIBRATE)]
pub(super) struct Calibrate {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Offset of the board and the converter; no current may flow
    BoardOffset,
    /// Offset of the converter; no current may flow
    CcOffset,
    /// Voltage Divider
    Voltage {
        /// Voltage of the pack that a meter shows, such as 25.2V; without a unit, mV
        #[arg(long, value_name = "VOLTAGE", allow_hyphen_values = true, value_parser = config::pack_voltage)]
        actual: f64,
    },
    /// CC Gain and CC Delta
    Current {
        /// Current that a meter shows, such as -2A; without a unit, mA; negative while discharging
        #[arg(long, value_name = "CURRENT", allow_hyphen_values = true, value_parser = config::meter_current)]
        actual: f64,
    },
    /// Offset of the temperature sensor that Temperature() shows
    Temperature {
        /// Temperature of that sensor, in degrees Celsius
        #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, value_parser = config::celsius)]
        actual: f64,
    },
    /// Leave calibration mode, in which a program has left the gauge
    Leave,
}

impl Calibrate {
    pub(super) fn run(self) -> Result<ExitCode> {
        let line = match self.what {
            What::BoardOffset => "board-offset".into(),
            What::CcOffset => "cc-offset".into(),
            What::Voltage { actual } => format!("voltage {actual}"),
            What::Current { actual } => format!("current {actual}"),
            What::Temperature { actual } => format!("temperature {actual}"),
            What::Leave => "leave".into(),
        };
        let gauge = Gauge::open(&self.gauge)?;
        mounted::poll(&gauge)?;
        request(&gauge, &line, "cannot be calibrated")
    }
}

/// Writes a line to `gauge/calibrate`, and prints the daemon's steps, without those of other requests.
pub(super) fn request(gauge: &Gauge, line: &str, failure: &str) -> Result<ExitCode> {
    gauge.check_has("gauge/calibrate", "calibration")?;
    let asked = gauge.clone();
    let name = Name::draw();
    let (end, ended) = mpsc::channel::<()>();
    // Whether all steps were seen and printed.
    let follow = thread::spawn(move || {
        let (mut shown, mut printed) = (String::new(), Ok(()));
        let mut last = false;
        loop {
            let text = asked.text("gauge/calibration").unwrap_or_default();
            let own = name.answer(&text);
            if let Some(rest) = own.and_then(|steps| steps.strip_prefix(&*shown)) {
                printed = printed.and_then(|()| print(rest));
                shown += rest;
            }
            if last {
                return printed.map(|()| own.is_some());
            }
            last = ended.recv_timeout(INTERVAL) != Err(RecvTimeoutError::Timeout);
        }
    });
    let sent = gauge.send("gauge/calibrate", name.on(line).as_bytes());
    drop(end);
    let followed = follow.join();
    sent.map_err(|refused| refused.doing(failure))?;
    // A panic there has been reported.
    let is_whole =
        followed.unwrap_or(Ok(true)).map_err(|error| error.within("done, but its steps were not printed"))?;
    if is_whole {
        return Ok(ExitCode::SUCCESS);
    }
    let folder = gauge.folder().display();
    say(format_args!(
        "{folder}: done, but another program calibrates now, and its steps have replaced the last of these"
    ));
    Ok(UNKNOWN.into())
}
