#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: charge_overflow of the crate ina228 says whether the accumulated charge has overflowed, and `latch` of its
#   configure_alerts() makes alerts stay.
# Happens:  charge_overflow is true on every healthy part, from power-up on, and memory_status is false: the two have each other's
#   bits and more (MEMSTAT is bit 0, which is 1 while the memory is good; ALATCH is bit 15, CHARGEOF 10, ENERGYOF 11, MATHOF 9).
#   A charge that has overflowed shows in none of the flags, and `latch` sets ENERGYOF, which is read-only.
# Version:  ina228 0.2.0 from crates.io, src/lib.rs, diagnostic_flags() and configure_alerts(); the bits are those of DIAG_ALRT
#   (0x0B) in SBOSA20A. The bus is an object of its user, so no part is needed.
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
ina228 = "=0.2.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{ErrorType, I2c, Operation};

/// A part with this DIAG_ALRT; what is written to it stays.
struct Part(u16);

impl ErrorType for Part {
    type Error = std::convert::Infallible;
}

impl I2c for Part {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            match operation {
                Operation::Write([0x0b]) => {}
                Operation::Write([0x0b, high, low]) => self.0 = u16::from_be_bytes([*high, *low]),
                Operation::Read(answer) => answer.copy_from_slice(&self.0.to_be_bytes()),
                other => panic!("{other:?}"),
            }
        }
        Ok(())
    }
}

fn main() {
    let (healthy, overflowed) = (0x0001, 0x0401);
    for word in [healthy, overflowed] {
        let mut driver = ina228::Ina228::new(Part(word), 0x40);
        let Ok(flags) = driver.diagnostic_flags();
        print!("0x{word:04x}: memory {} charge {} energy {}; ", flags.memory_status, flags.charge_overflow, flags.energy_overflow);
    }
    let mut driver = ina228::Ina228::new(Part(healthy), 0x40);
    let latch = ina228::AlertConfig { latch: true, ..Default::default() };
    let Ok(()) = driver.configure_alerts(latch);
    println!("latch: 0x{:04x}", driver.release().0);
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "ina228 0.2.0, DIAG_ALRT after power-up, with CHARGEOF, and with the alert latched: $seen"
[ "$seen" = "0x0001: memory false charge true energy false; 0x0401: memory false charge true energy false; latch: 0x0801" ]
