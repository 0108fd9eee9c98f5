#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: is_battery_charging() of the crate axp20x says whether the battery is being charged.
# Happens:  it is true on a watch that runs from its battery with no cable connected: it reads bit 7 of register 0x33, which permits
#   charging and is set after power-up. Whether current flows into the battery is bit 6 of 0x01.
# Version:  axp20x 0.0.3 from crates.io, src/lib.rs, is_battery_charging(); AXP202 data sheet, REG 01H and REG 33H. The bus is an object
#   of its user, so no part is needed.
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
axp20x = "=0.0.3"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{ErrorType, I2c, Operation};

/// An AXP202 that discharges its battery: neither ACIN nor VBUS (0x00), a battery that is not being charged (0x01), and charging
/// permitted (0x33).
struct Part(u8);

impl ErrorType for Part {
    type Error = std::convert::Infallible;
}

impl I2c for Part {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            match operation {
                Operation::Write([register]) => self.0 = *register,
                Operation::Read(answer) => {
                    answer[0] = match self.0 {
                        0x00 => 0x00,
                        0x01 => 0x20,
                        0x33 => 0xc6,
                        other => panic!("0x{other:02x}"),
                    }
                }
                other => panic!("{other:?}"),
            }
        }
        Ok(())
    }
}

fn main() {
    let mut driver = axp20x::Axpxx::new(Part(0));
    println!("supply {:?} {:?}, charging {:?}", driver.is_acin_present(), driver.is_vbus_present(), driver.is_battery_charging());
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "axp20x 0.0.3, a battery without a supply: $seen"
[ "$seen" = "supply Ok(false) Ok(false), charging Ok(true)" ]
