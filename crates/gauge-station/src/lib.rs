// SPDX-License-Identifier: MIT

//! A production line for battery packs with Texas Instruments fuel gauges. A station waits for a pack, identifies it, writes
//! an image, serial number, date and lot, calibrates it, changes its keys, seals it, reads all of it back, and records
//! that it has passed, or why it has failed. Then it waits for the next one.
//!
//! A [`Setup`] is what the station's file says, and a [`Plan`] that together with the image, checked before any gauge is
//! touched. [`run`] programs packs at all of its places. The record is a file with a line of JSON when a pack is begun
//! and one with its outcome; complete images of each pack are beside it.
//!
//! ```
//! # use std::fs;
//! use std::sync::Arc;
//! use std::sync::atomic::AtomicBool;
//!
//! use gauge_bus::clock::{Clock, SimClock};
//! use gauge_owner::GaugeOptions;
//! use gauge_station::{Options, Plan, Scanner, Screen, SerialFrom, Setup};
//! use ti_gauge::chip::Chip;
//!
//! struct Printed;
//!
//! impl Screen for Printed {
//!     fn outcome(&self, line: &str) {
//!         println!("{line}");
//!     }
//!
//!     fn prompt(&self, line: &str) {
//!         eprintln!("{line}");
//!     }
//! }
//!
//! /// Serial numbers come from a counter.
//! struct Nobody;
//!
//! impl Scanner for Nobody {
//!     fn line(&mut self, _: &str) -> Option<String> {
//!         None
//!     }
//! }
//!
//! let folder = std::env::temp_dir().join(format!("gauge-station-{}", std::process::id()));
//! # fs::create_dir_all(&folder).expect("a folder");
//! let image = folder.join("golden.toml");
//! let golden = "chip = 'bq34z100-g1'\n[it-cfg]\ncell-terminate-voltage = 3100\n";
//! fs::write(&image, golden).expect("an image");
//!
//! // A place with one simulated pack.
//! let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
//! let simulated = GaugeOptions { sim: Some(chip), ..GaugeOptions::default() };
//! let options = Options { serial: Some(SerialFrom::Counter), ..Options::default() };
//! let setup = Setup::new(&folder.join("line1.toml"), options, vec![("BAT0".into(), simulated)]);
//!
//! let plan = Plan::read(&image, setup)?;
//! // A simulated pack can have simulated time.
//! let clock = || -> Arc<dyn Clock> { Arc::new(SimClock::new()) };
//! let stops = Arc::new(AtomicBool::new(false));
//! let passed = gauge_station::run(plan, clock, Box::new(Printed), Box::new(Nobody), None, stops)?;
//! assert!(passed);
//! let record = fs::read_to_string(folder.join("line1.jsonl")).expect("a record");
//! assert!(record.lines().last().is_some_and(|line| line.contains("\"event\":\"pass\"")));
//! # fs::remove_dir_all(&folder).expect("it is there");
//! # Ok::<(), gauge_station::error::Error>(())
//! ```

#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

pub use gaugefs_host::error;
pub use gaugefs_host::sign::Sign;

mod options;
mod setup;
mod station;

pub use options::{Options, Refused, Rehearsed, Seen, SerialFrom, Unsettled};
pub use setup::Setup;
pub use station::{By, Failures, Plan, RecordGroup, Records, Scanner, Screen, Totals, run};
