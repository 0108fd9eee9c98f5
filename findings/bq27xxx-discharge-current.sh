#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: average_current() of the crate bq27xxx gives AverageCurrent(), an i16, which is negative for a discharge.
# Happens:  the word is read as a u16 and then converted with a check, so every negative current is an error of the kind
#   "Value": the driver knows the current only while the pack is charged.
# Version:  bq27xxx 0.0.2 from crates.io, src/lib.rs, Bq27xx::read(). The bus is an object of its user, so no gauge is needed.
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
bq27xxx = "=0.0.2"
embedded-hal-async = "=1.0.0"
pollster = "=0.4.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal_async::{delay::DelayNs, i2c};

/// A gauge whose AverageCurrent() (0x10, low byte first) has this value.
struct Gauge(i16);

impl i2c::ErrorType for Gauge {
    type Error = std::convert::Infallible;
}

impl i2c::I2c for Gauge {
    async fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), Self::Error> {
        if let [i2c::Operation::Write(&[0x10]), i2c::Operation::Read(answer)] = operations {
            answer.copy_from_slice(&self.0.to_le_bytes());
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}

fn main() {
    for current in [300, -300] {
        let mut gauge = bq27xxx::Bq27xx::new(Gauge(current), NoDelay, 0x55);
        match pollster::block_on(gauge.average_current()) {
            Ok(current) => print!("{current} "),
            Err(bq27xxx::ChipError::Value) => print!("Value "),
            Err(_) => print!("another error "),
        }
    }
}
END
export CARGO_TARGET_DIR=$folder/target
seen=$(cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq27xxx 0.0.2, average current of 300 mA and of -300 mA: $seen"
[ "$seen" = "300 Value " ]
