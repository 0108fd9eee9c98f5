// SPDX-License-Identifier: MIT

//! Multiplexers, as sysfs shows them. Each channel is an adapter of its own: its folder is in that of the adapter in
//! front of the mux, and its link `mux_device` leads to the mux.

use std::fs;
use std::path::Path;

/// The adapters in front of the muxes that lead to an adapter, in the system below `root`: the nearest first.
pub fn above(root: &Path, number: u64) -> Vec<u64> {
    std::iter::successors(parent(root, number), |&number| parent(root, number)).collect()
}

/// The adapter whose mux has this one as a channel.
fn parent(root: &Path, number: u64) -> Option<u64> {
    let device = root.join(format!("sys/bus/i2c/devices/i2c-{number}"));
    fs::read_link(device.join("mux_device")).ok()?;
    fs::canonicalize(device).ok()?.parent()?.file_name()?.to_str()?.strip_prefix("i2c-")?.parse().ok()
}
