// SPDX-License-Identifier: MIT

//! Texas Instruments fuel gauges: what each part's manual says, as tables, and what can safely be done with a gauge
//! on an I2C bus.
//!
//! A [`Gauge`](gauge::Gauge) is a table ([`chip`]) on a [`gauge_bus::Bus`]: it reads standard commands, sends Control()
//! subcommands and changes the seal state. [`DataFlash`](dataflash::DataFlash) is the only way to read and write data
//! flash: one write is one whole transaction, verified, and put back when it fails. With a
//! [`Journal`](journal::Journal) it survives a power cut of the host. What a failure leaves to do is
//! [owed](dataflash::DataFlash::owed), and the caller tries it again. [`image`] reads and writes configurations as
//! TOML, gg.csv and FlashStream; [`probe`] finds a gauge without disturbing other devices.
//!
//! It polls nothing, has no threads, no FUSE. It programs no chemistry, and firmware only in ROM mode ([`rom`]).
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use gauge_bus::clock::{Clock, SimClock};
//! use gauge_sim::{Options, Sim};
//! use ti_gauge::chip::Chip;
//! use ti_gauge::dataflash::{Change, DataFlash, Outcome};
//! use ti_gauge::gauge::Gauge;
//! use ti_gauge::keys::Keys;
//!
//! let clock = Arc::new(SimClock::new());
//! let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a simulated gauge");
//! clock.sleep(Duration::from_secs(1)); // from power to the first voltage
//!
//! let chip = Chip::by_name("bq34z100-g1").expect("a table");
//! let mut gauge = Gauge::new(chip, Box::new(sim.bus()), clock, Keys::default());
//! let mut dataflash = DataFlash::default();
//!
//! let row = chip.row("80", "53").expect("Cell Terminate Voltage");
//! let change = Change::parse(chip, row, b"3100", false).expect("a value in range");
//! let outcome = dataflash.write(&mut gauge, &[change], Duration::ZERO)?;
//! let old = vec![3000_u16.to_be_bytes().to_vec()];
//! assert_eq!(outcome, Outcome::Written { reset: true, old });
//! # Ok::<(), ti_gauge::error::Error>(())
//! ```

pub mod authentication;
pub mod calibration;
pub mod check;
pub mod chip;
pub mod codec;
pub mod dataflash;
pub mod date;
pub mod epoch;
pub mod error;
pub mod gauge;
pub mod image;
pub mod journal;
pub mod keys;
pub mod learning;
pub mod notation;
pub mod probe;
pub mod quantity;
pub mod registers;
pub mod rom;
pub mod text;
pub mod unit;
pub mod value;
