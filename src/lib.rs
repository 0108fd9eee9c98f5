// SPDX-License-Identifier: MIT

//! gaugefs mounts TI fuel gauges as a Linux power_supply tree.
//!
//! This library is the program's own: what is useful elsewhere is in the crates `gauge-bus`, `gauge-sim`,
//! `ti-gauge`, `gauge-owner`, `gauge-station` and `gaugefs-client`. `docs/ARCHITECTURE.md` has the picture.

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

pub use gaugefs_host::error;
use gaugefs_host::{folders, output};

mod bus;
pub mod cli;
mod config;
pub mod daemon;
pub mod fs;
pub mod fuse;
mod report;
