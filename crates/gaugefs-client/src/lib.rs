// SPDX-License-Identifier: MIT

//! TI fuel gauges that gaugefs has mounted, for programs: values, changes, parameters, interrupted writes.
//!
//! A [`Gauge`] is the folder of a gauge. It takes no privilege and no bus traffic beyond those of its files. A value:
//!
//! ```no_run
//! use gaugefs_client::Gauge;
//!
//! let gauge = Gauge::open("/run/gauges/BAT0")?;
//! let voltage = gauge.value("voltage_now")?;
//! println!("{voltage}, that is {:.3} V", voltage.in_unit("V").unwrap_or_default());
//! // All values of one poll.
//! let sample = gauge.sample()?;
//! println!("{} at {} %", sample.status(), sample.attribute("capacity").unwrap_or("?"));
//! # Ok::<(), gaugefs_client::Error>(())
//! ```
//!
//! Changes. The files are read after each poll of the mount, from a thread of their own:
//!
//! ```no_run
//! # let gauge = gaugefs_client::Gauge::open("/run/gauges/BAT0")?;
//! use gaugefs_client::condition::Condition;
//!
//! let low: Condition = "capacity<20 && status==Discharging".parse().expect("a condition");
//! let mut follow = gauge.follow(low.names())?;
//! while let Some(seen) = follow.next(None) {
//!     match seen {
//!         Ok(texts) if low.holds(Some(&texts)) == Some(true) => break,
//!         Ok(texts) => println!("{}", low.values(Some(&texts))),
//!         Err(why) => println!("nothing to see: {why}"),
//!     }
//! }
//! # Ok::<(), gaugefs_client::Error>(())
//! ```
//!
//! A parameter. What is written is verified before [`set`](Gauge::set) returns:
//!
//! ```no_run
//! # let gauge = gaugefs_client::Gauge::open("/run/gauges/BAT0")?;
//! gauge.set("Cell Terminate Voltage", "3100 mV")?;
//! println!("{}", gauge.parameter("Cell Terminate Voltage")?);
//! # Ok::<(), gaugefs_client::Error>(())
//! ```
//!
//! Several parameters, all or none. An [`Error`] has the errno, and what the daemon says of it:
//!
//! ```no_run
//! # let gauge = gaugefs_client::Gauge::open("/run/gauges/BAT0")?;
//! let mut transaction = gauge.transaction()?;
//! transaction.set("design-capacity", "2.2 Ah")?.set("80/53", "3100")?;
//! match transaction.commit() {
//!     Ok(changes) => println!("{} changed", changes.len()),
//!     Err(error) if error.last_error().is_some() => println!("the gauge has refused it: {error}"),
//!     Err(error) => println!("errno {:?}: {error}", error.errno()),
//! }
//! # Ok::<(), gaugefs_client::Error>(())
//! ```
//!
//! A write that was interrupted and that only a person can decide about:
//!
//! ```no_run
//! # let gauge = gaugefs_client::Gauge::open("/run/gauges/BAT0")?;
//! use gaugefs_client::Decision;
//!
//! if let Some(what) = gauge.unsettled()? {
//!     println!("{what}");
//!     gauge.settle(Decision::Undo, None)?;
//! }
//! # Ok::<(), gaugefs_client::Error>(())
//! ```
//!
//! # Daemons that hang
//!
//! A call into a mount waits for its daemon. A program that has to go on lets a [`Follow`](follow::Follow) or a
//! [`Watch`](watch::Watch) read, whose threads are left behind if it hangs, or calls with a time limit:
//!
//! ```no_run
//! # let gauge = gaugefs_client::Gauge::open("/run/gauges/BAT0")?;
//! let charge = gaugefs_client::within(gaugefs_client::follow::PATIENCE, move || gauge.value("charge_now"))??;
//! # Ok::<(), gaugefs_client::Error>(())
//! ```

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

mod asked;
pub mod check;
pub mod condition;
mod error;
mod file;
pub mod follow;
mod gauge;
mod hang;
pub mod mounts;
pub mod names;
mod parameter;
mod place;
pub mod sample;
pub mod supplies;
mod value;
pub mod watch;

pub use asked::{Name, TRIES};
pub use error::{Error, Result};
pub use file::GaugeFile;
pub use gauge::{Decision, Gauge, Polled, Presence, folder_name};
pub use hang::within;
pub use parameter::{Changed, Transaction, Wanted, row};
pub use place::{died, gauges_at, last_name};
pub use value::Value;
