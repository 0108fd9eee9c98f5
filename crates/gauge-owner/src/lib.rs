// SPDX-License-Identifier: MIT

//! The owner of a Texas Instruments fuel gauge: it identifies the gauge, polls its registers, carries out requests one
//! after the other, and pays what a failed access has left. Nothing else touches the gauge's bus.
//!
//! An [`Opening`] starts the owner of the gauge that [`GaugeOptions`] name, which has a [`Run`]. A [`Handle`] shows the
//! values of the last poll, which cost no transfer, and asks for one of the [`operations`].
//!
//! ```
//! use std::sync::Arc;
//!
//! use gauge_bus::clock::RealClock;
//! use gauge_owner::{GaugeOptions, Opening, operations};
//! use ti_gauge::chip::{Chip, Role};
//! use ti_gauge::dataflash::Change;
//! use ti_gauge::value::Value;
//!
//! let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
//! let simulated = GaugeOptions { sim: Some(chip), ..GaugeOptions::default() };
//! let opening = Opening::new("/run/gauges".into(), Arc::new(RealClock::new()));
//! let gauge = opening.one("BAT0".into(), &simulated)?.handle;
//!
//! // A value of the last poll.
//! let voltage = chip.register(Role::VoltageNow).expect("it measures its voltage");
//! let published = gauge.published();
//! let millivolts = published.snapshot.as_ref().and_then(|snapshot| snapshot.value(voltage));
//! assert!(millivolts.is_some_and(|millivolts| millivolts > 2500));
//!
//! // An operation: Cell Terminate Voltage, verified before the answer.
//! let row = chip.row("80", "53").expect("a parameter of the table");
//! let change = Change::of_value(chip, row, &Value::Int(3100), false)?;
//! gauge.wait_for(&operations::WRITE, vec![change])?;
//! # Ok::<(), gauge_owner::error::Error>(())
//! ```
//!
//! A [`Direct`] is an owner that the caller drives, for a program that needs the gauge for one piece of work at a time.
//!
//! Here as well: the [`lock`] of a gauge, its [`key_file`], and the [folder of its journals](journal_dir).
//!
//! # Features
//!
//! `rig`, for tests: the owner of a simulated gauge on a simulated clock, which the test's own thread drives.

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

pub use gaugefs_host::error;
use gaugefs_host::folders;

mod choose;
mod evidence;
pub mod journal_dir;
pub mod key_file;
pub mod lock;
mod opening;
mod options;
mod owner;
mod setup;
mod source;

pub use choose::{Choice, Rule};
pub use evidence::Evidence;
pub use opening::{Opening, Outlook, Ready};
pub use options::{GaugeOptions, SimKey};
#[cfg(any(test, feature = "rig"))]
pub use owner::rig;
pub use owner::{
    Answers, Attempt, Backup, Context, Direct, Done, Effect, Failure, FileOperation, Handle, Learned,
    Operation, Origin, Presence, Published, Report, Run, Seal, Signal, Snapshot, Times, Version, Wish,
    operations, readable, spawn, start,
};
pub use source::{Opened, Script, Source, may_come, recorded};
