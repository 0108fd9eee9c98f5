// SPDX-License-Identifier: MIT

//! One test binary for everything that needs more than one module.

#![allow(clippy::disallowed_methods, reason = "tests read what they have made")]

mod bus;
mod captures;
mod check;
mod cli;
mod client;
mod config;
mod copies;
mod costs;
mod doctor;
mod documents;
#[allow(dead_code, reason = "the tests of the engine use the rest")]
#[path = "../../crates/ti-gauge/tests/it/room/drawn.rs"]
mod drawn;
mod ends;
mod endurance;
#[cfg(feature = "screen")]
mod events;
#[allow(dead_code, reason = "the tests of the boot loader use the rest")]
#[path = "../../crates/ti-gauge/tests/it/firmware.rs"]
mod firmware;
mod fitting;
mod forgetful;
mod hangup;
mod house;
mod input;
mod keys;
mod listing;
mod manual;
mod messages;
mod model;
mod mount;
mod ordinary;
mod others;
mod output;
mod over;
mod packaging;
#[cfg(feature = "screen")]
mod packs;
mod pages;
mod production;
mod program;
mod protector;
mod readme;
mod reads;
mod refused;
mod report;
#[cfg(feature = "rescue")]
mod rescue;
#[allow(dead_code, reason = "the tests of the engine use the rest")]
#[path = "../../crates/ti-gauge/tests/it/rig.rs"]
mod rig;
mod romimage;
mod room;
mod roundtrip;
mod semantics;
mod service;
mod setting;
mod simulator;
mod smbus;
mod swapped;
#[allow(dead_code, reason = "a program has a main function")]
#[path = "../../crates/gaugefs-client/examples/terminate_voltage.rs"]
mod terminate_voltage;
mod threats;
mod transaction;
