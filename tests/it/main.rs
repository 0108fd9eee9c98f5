//! One test binary for everything that needs more than one module.

mod cli;
mod config;
mod doctor;
mod faults;
mod gauge;
mod input;
mod journal;
mod keychange;
mod keys;
mod manual;
mod mount;
mod over;
mod preflight;
mod probe;
mod rig;
mod semantics;
mod service;
mod sim;
mod sim2;
mod sim_mac;
mod tables;
mod transaction;
mod write;
