// SPDX-License-Identifier: MIT

//! `gaugefs report`: one file about a gauge, for a bug report.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{ArgGroup, Args};
use nix::errno::Errno;

use super::PASSED_OVER;
use super::unmounted::Unmounted;
use crate::error::{Error, Result};
use crate::output::{check_file, is_standard_output, print, say, write_file};
use crate::{daemon, report};
use gauge_bus::regular::Replace;
use gaugefs_client::Gauge;

const REPORT: &str = "\
The file has the gauge's identity and registers, kernel and adapter, and a trace of what a mount
does: the gauge is identified and polled, and a few blocks of data flash are read that belong to no one.
For that a sealed gauge is unsealed and sealed again. Nothing is written to data flash. Keys are not
in the file, nor are serial numbers, dates, lots and texts. `gaugefs mount --replay` mounts it.
Of a mounted gauge it also has the times of writes and the last calibration since the mount.

A gauge that is mounted is named by its folder, any other by --bus. Exit code 0: done, 3: data flash
could not be read, as of a sealed gauge without a key, and the file has the rest, 1: failed.

Examples:
  gaugefs report /run/gauges/BAT0
  gaugefs report --bus /dev/i2c-1 -o report.txt";

/// Write a file about a gauge, for a bug report
#[derive(Args, Debug)]
#[command(after_help = REPORT, group = ArgGroup::new("source").required(true).args(["gauges", "bus", "sim"]))]
pub(super) struct Report {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    #[arg(id = "gauges", value_name = "GAUGE", conflicts_with = "chip")]
    gauge: Option<PathBuf>,
    #[command(flatten)]
    unmounted: Unmounted,
    /// File to write, - for standard output [default: gaugefs-report-CHIP.txt]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace the file if there is one
    #[arg(long)]
    force: bool,
}

impl Report {
    pub(super) fn run(self) -> Result<ExitCode> {
        let refused = |file: &Path, error: Error| match Errno::from_raw(error.errno()) {
            Errno::EEXIST => exists(file),
            _ => error,
        };
        if let Some(file) = &self.output {
            // Problems of the file matter less than those of the gauge.
            match check_file(file, how(self.force)) {
                Err(error) if error.errno() == Errno::EEXIST as i32 => return Err(exists(file)),
                _ => {}
            }
        }
        let text = match &self.gauge {
            Some(gauge) => of_mounted(gauge)?,
            None => daemon::report(&self.unmounted.options())?,
        };
        let name = || format!("gaugefs-report-{}.txt", report::chip(&text).unwrap_or("gauge")).into();
        let file = self.output.clone().unwrap_or_else(name);
        write_file(&file, text.as_bytes(), how(self.force)).map_err(|error| refused(&file, error))?;
        if !is_standard_output(&file) {
            print(&format!("{}\n", file.display()))?;
        }
        Ok(match report::without_data_flash(&text) {
            None => ExitCode::SUCCESS,
            Some(why) => {
                say(format_args!("{}: data flash was not read: {why}", file.display()));
                PASSED_OVER.into()
            }
        })
    }
}

/// Asks the daemon of a mounted gauge for a report.
fn of_mounted(path: &Path) -> Result<String> {
    const FILE: &str = "gauge/report";
    let name = path.display().to_string();
    let gauge = Gauge::open(path).map_err(|error| match error.errno().map(Errno::from_raw) {
        Some(errno @ Errno::ENOENT) => {
            Error::host(&name, errno, format!("{}; or give a bus with --bus", error.text()))
        }
        _ => error.into(),
    })?;
    gauge.send(FILE, b"1\n").map_err(|error| match error.errno().map(Errno::from_raw) {
        Some(errno @ Errno::EROFS) if error.is_unopened() => {
            let why = "the mount is read-only; unmount it, and give the gauge's bus with --bus";
            Error::host(&name, errno, why)
        }
        _ => error.doing("the gauge cannot be polled for a report").into(),
    })?;
    let text = gauge.text(FILE).map_err(|error| error.doing("cannot read the report"))?;
    if text.is_empty() {
        return Err(Error::host(name, Errno::EAGAIN, "another request has failed meanwhile; try again"));
    }
    Ok(text)
}

fn how(force: bool) -> Replace {
    if force { Replace::Kept } else { Replace::Never }
}

fn exists(file: &Path) -> Error {
    let why = "it exists; name another file with --output, or replace it with --force";
    Error::host(file.display().to_string(), Errno::EEXIST, why)
}
