// SPDX-License-Identifier: MIT

//! gaugefs mounts TI fuel gauges as a Linux power_supply tree, and gaugefs-station programs them on a production line.
//!
//! This library is the two programs' own: what is useful elsewhere is in the crates `gauge-bus`, `gauge-sim`,
//! `ti-gauge`, `gauge-owner`, `gauge-station` and `gaugefs-client`. `docs/ARCHITECTURE.md` has the picture.
//!
//! ```
//! // The program, called as a function: 0 if it succeeded.
//! let code = gaugefs::cli::run(["gaugefs".into(), "chips".into(), "bq34z100-g1".into()]);
//! assert_eq!(code, std::process::ExitCode::SUCCESS);
//! ```
//!
//! # Features
//!
//! `screen`, on by default: the commands `top`, `learn`, `log`, `plot`, `wait`, `watch`, `metrics` and `events`, by the
//! crate `gaugefs-screen`.
//!
//! `rescue`, on by default: the command `rescue`, which brings back a gauge that is left in ROM mode.

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

pub use gaugefs_host::error;
use gaugefs_host::{folders, output};

mod bus;
mod check;
pub mod cli;
mod command;
mod config;
pub mod daemon;
pub mod fs;
pub mod fuse;
mod report;
pub mod station;
mod vhci;
