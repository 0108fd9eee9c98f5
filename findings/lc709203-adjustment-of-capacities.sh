#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: with_battery_capacity() of the crate lc709203 sets the adjustment parameter (APA) for a pack of that capacity, between two
#   capacities of the gauge's table in proportion: calc_apa() has the formula.
# Happens:  the proportion is a division of integers, so it is 0: a pack of 1900 mAh gets the parameter of 1000 mAh (0x2d), though
#   that of 2000 mAh is 0x3a, and its state of charge is computed for a pack of half the size.
# Version:  lc709203 0.3.0 from crates.io, src/lib.rs, calc_apa(). The bus is an object of its user, so no gauge is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2021"
[dependencies]
lc709203 = "=0.3.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{ErrorType, I2c, Operation};

/// A gauge that keeps what is written to APA (0x0b).
struct Gauge(Option<u8>);

impl ErrorType for Gauge {
    type Error = std::convert::Infallible;
}

impl I2c for Gauge {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            if let Operation::Write([0x0b, low, _high, _crc]) = operation {
                self.0 = Some(*low);
            }
        }
        Ok(())
    }
}

fn main() {
    for capacity in [1000, 1500, 1900, 2000] {
        let mut gauge = Gauge(None);
        let built = lc709203::Builder::default().with_battery_capacity(capacity).build(&mut gauge);
        assert!(built.is_ok());
        print!("{capacity} mAh 0x{:02x} ", gauge.0.expect("APA is written"));
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "lc709203 0.3.0, APA of packs of type 01: $seen"
[ "$seen" = "1000 mAh 0x2d 1500 mAh 0x2d 1900 mAh 0x2d 2000 mAh 0x3a " ]
