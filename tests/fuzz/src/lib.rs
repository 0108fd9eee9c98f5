// SPDX-License-Identifier: MIT

//! One target for each thing that gaugefs parses. A target takes any bytes as input, and panics if the code under test
//! panics or breaks a promise: what is accepted is written and read again as the same, what is refused changes nothing,
//! and no number becomes another one.
//!
//! `tests/corpus.rs` runs the kept inputs and a seeded slice of changed ones in every test run; `tests/fuzz/run` runs
//! the same targets under libFuzzer, guided by coverage.

use std::path::PathBuf;

mod bus;
mod command;
mod disk;
mod fuse;
mod image;
mod ioctl;
mod journal;
mod keys;
mod name;
mod replay;
mod script;
mod transaction;
mod usb;
mod value;

/// Something that parses.
#[derive(Debug)]
pub struct Target {
    /// Its name, and that of its folder in `corpus`.
    pub name: &'static str,
    /// Runs it on an input.
    pub run: fn(&[u8]),
    /// How many changed inputs `tests/run --all` tries, and each other test run an eighth of them.
    pub slice: u32,
}

/// All targets.
pub const TARGETS: &[Target] = &[
    Target { name: "image-toml", run: image::toml, slice: 2000 },
    Target { name: "image-ggcsv", run: image::ggcsv, slice: 2000 },
    Target { name: "image-gg", run: image::gg, slice: 2000 },
    Target { name: "image-flashstream", run: image::flashstream, slice: 2000 },
    Target { name: "value", run: value::run, slice: 2000 },
    Target { name: "name", run: name::run, slice: 1000 },
    Target { name: "transaction", run: transaction::run, slice: 2000 },
    Target { name: "keys", run: keys::run, slice: 2000 },
    Target { name: "journal", run: journal::run, slice: 500 },
    Target { name: "replay", run: replay::run, slice: 2000 },
    Target { name: "configuration", run: command::configuration, slice: 300 },
    Target { name: "station", run: command::station, slice: 300 },
    Target { name: "condition", run: command::condition, slice: 500 },
    Target { name: "csv", run: command::csv, slice: 300 },
    Target { name: "command-line", run: command::options, slice: 300 },
    Target { name: "bus", run: bus::run, slice: 500 },
    Target { name: "ioctl", run: ioctl::run, slice: 2000 },
    Target { name: "fuse", run: fuse::run, slice: 2000 },
    Target { name: "usb", run: usb::run, slice: 2000 },
];

impl Target {
    /// The folder with its kept inputs.
    pub fn corpus(&self) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus").join(self.name)
    }
}
