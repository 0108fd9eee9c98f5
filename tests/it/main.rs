//! One test binary for everything that needs more than one module.

mod cli;
mod config;
mod doctor;
mod ends;
mod input;
mod keys;
mod manual;
mod model;
mod mount;
mod others;
mod over;
mod program;
mod report;
#[allow(dead_code, reason = "the tests of the engine use the rest")]
#[path = "../../crates/ti-gauge/tests/it/rig.rs"]
mod rig;
mod romimage;
mod scratch;
mod semantics;
mod service;
mod swapped;
mod transaction;
