#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: get_shunt_voltage() of the crate ina3221 gives the shunt voltage with its sign: the register is in two's complement,
#   and a battery's shunt is negative in one of its directions.
# Happens:  the conversion returns the magnitude: -40 mV and 40 mV are the same, so a battery that is charged cannot be told from
#   one that is discharged. An alert limit below 0 is written as one above it.
# Version:  ina3221 0.4.5 from crates.io, src/helpers.rs. The registers hold 40 uV in bits 15 to 3, in two's complement: SBOS576,
#   "Channel 1 Shunt-Voltage Register". The bus is an object of its user, so no device is needed.
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
ina3221 = "=0.4.5"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{self, Operation};
use ina3221::{INA3221, Voltage};

/// A monitor whose first shunt register (0x01, high byte first) has this value; it prints the words that are written.
struct Monitor(i16);

impl i2c::ErrorType for Monitor {
    type Error = std::convert::Infallible;
}

impl i2c::I2c for Monitor {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            match operation {
                Operation::Read(answer) => answer.copy_from_slice(&self.0.to_be_bytes()),
                Operation::Write([_, high, low]) => print!("{:02x}{:02x} ", high, low),
                Operation::Write(_) => {}
            }
        }
        Ok(())
    }
}

fn main() {
    for microvolts in [40_000, -40_000] {
        let word = (microvolts / 40) << 3;
        let monitor = INA3221::new(Monitor(word as i16), 0x40);
        let shown = monitor.get_shunt_voltage(0).expect("no error exists");
        print!("{} ", shown.micro_volts());
    }
    for microvolts in [40_000, -40_000] {
        let mut monitor = INA3221::new(Monitor(0), 0x40);
        monitor.set_warning_alert_limit(0, Voltage::from_micro_volts(microvolts)).expect("no error exists");
    }
}
END
export CARGO_TARGET_DIR=$folder/target
seen=$(cargo run -q --manifest-path "$folder/Cargo.toml")
echo "ina3221 0.4.5, shunt of 40 mV and of -40 mV, and their limits: $seen"
[ "$seen" = "40000 40000 1f40 1f40 " ]
