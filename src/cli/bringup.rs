// SPDX-License-Identifier: MIT

//! `gaugefs bringup`: makes a new board of several cells writable.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::calibrate::request;
use super::mounted;
use crate::config;
use crate::error::Result;
use gaugefs_client::Gauge;

const BRINGUP: &str = "\
A new bq34z100 behind an external divider measures too little: below Flash Update OK Cell Volt it
acknowledges what is written to data flash and stores nothing. In calibration mode it stores it all the
same. This command enters calibration mode, sets the limit to 0, the divider, [VOLTSEL] and the number of
cells in one transaction, leaves calibration mode, resets the gauge and reads Voltage(). If that is not
the pack's voltage, the old values are put back. Otherwise the divider is adjusted to the voltage that was
measured, and the limit is set as the datasheet has it, 2800 x cells x 5000 / divider. Where that
fails, flash stays open at any voltage: the message says so, and the same command completes it.
A number without a unit is in mV. Exit code 0: complete, 1: not, or put back.

Example:
  gaugefs bringup /run/gauges/BAT0 --cells 7 --divider 33V --voltage-now 26.985V";

/// Set up a new gauge for several cells and an external voltage divider
#[derive(Args, Debug)]
#[command(after_help = BRINGUP)]
pub(super) struct BringUp {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Cells in series
    #[arg(long, value_name = "N")]
    cells: u8,
    /// Voltage Divider: the pack voltage at the converter's full scale, such as 33V or 33000 mV
    #[arg(long, value_name = "VOLTAGE", allow_hyphen_values = true, value_parser = config::divider)]
    divider: u16,
    /// Voltage of the pack that a meter shows, such as 26.985V or 26985 mV [default: 1500 to 4600 mV for
    /// each cell]
    #[arg(long, value_name = "VOLTAGE", allow_hyphen_values = true, value_parser = config::pack_voltage)]
    voltage_now: Option<f64>,
}

impl BringUp {
    pub(super) fn run(self) -> Result<ExitCode> {
        let Self { gauge, cells, divider, voltage_now } = self;
        let gauge = Gauge::open(&gauge)?;
        mounted::poll(&gauge)?;
        let voltage = voltage_now.map_or(String::new(), |voltage| format!(" {voltage}"));
        request(&gauge, &format!("bringup {cells} {divider}{voltage}"), "cannot be set up")
    }
}
