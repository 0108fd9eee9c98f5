// SPDX-License-Identifier: MIT

//! The tables and the engine against simulated gauges.

#![allow(clippy::disallowed_methods, reason = "tests read what they have made")]

mod anonymous;
mod asked;
mod bq28z610;
mod calibration;
mod change;
mod check;
mod defaults;
mod early;
mod ensemble;
mod exchange;
mod faults;
mod firmware;
mod flips;
mod gate;
mod gauge;
mod image;
mod journal;
mod kept_open;
mod keychange;
mod layout;
mod learning;
mod only_names;
mod packs;
mod places;
mod power;
mod preflight;
mod probe;
mod protector;
mod reach;
mod recovery;
mod rescue;
mod restore;
mod rig;
mod room;
mod rules;
mod rules_gauge;
mod rules_kept;
mod rules_settling;
mod sealed;
mod slips;
mod tables;
mod write;
