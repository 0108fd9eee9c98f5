// SPDX-License-Identifier: MIT

//! Options of commands that open a gauge which is not mounted.

use std::path::PathBuf;

use clap::Args;

use crate::config::{address, chips};
use gauge_owner::GaugeOptions;
use ti_gauge::chip::Chip;

/// A gauge on a bus, or a simulated one. A command that has these has mounted gauges as `gauges`.
#[derive(Args, Debug)]
pub(super) struct Unmounted {
    /// I2C bus of a gauge that is not mounted, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE")]
    bus: Option<PathBuf>,
    /// 7-bit address of the gauge [default: 0x55]
    #[arg(long, value_name = "ADDRESS", value_parser = address, requires = "bus", conflicts_with_all = ["gauges", "sim"])]
    address: Option<u8>,
    /// Chip of the gauge [default: the gauge is asked, or the file says it]
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true, conflicts_with = "sim")]
    pub(super) chip: Option<&'static Chip>,
    /// Write one byte per transfer, as some gauges need above 100 kHz
    #[arg(long, requires = "bus", conflicts_with_all = ["gauges", "sim"])]
    byte_writes: bool,
    /// File with the gauge's keys; a mounted gauge has them already
    #[arg(long, value_name = "FILE", conflicts_with = "gauges")]
    key_file: Option<PathBuf>,
    /// Never try the manual's default key
    #[arg(long, conflicts_with = "gauges")]
    no_default_keys: bool,
    /// Simulate a gauge of this chip, to see what the command does
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true)]
    sim: Option<&'static Chip>,
}

impl Unmounted {
    /// As options of a mount.
    pub(super) fn options(&self) -> GaugeOptions {
        GaugeOptions {
            sim: self.sim,
            bus: self.bus.clone(),
            address: self.address,
            chip: self.chip,
            byte_writes: self.byte_writes,
            key_file: self.key_file.clone(),
            no_default_keys: self.no_default_keys,
            ..GaugeOptions::default()
        }
    }
}
