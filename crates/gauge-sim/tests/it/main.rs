// SPDX-License-Identifier: MIT

//! The simulated gauges, compared byte by byte with the manuals, without the engine and the tables.

#![allow(clippy::disallowed_methods, reason = "tests read what they have made")]

mod bench;
mod block;
mod driver;
mod envelope;
mod libraries;
mod mac;
mod protector;
mod ram;
mod register;
mod sick;
mod smbus;
