#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: set_table() of the crate max170xx writes the custom model of a MAX17048 to its TABLE registers, 0x40 to 0x7F.
# Happens:  it takes 64 words and writes them from 0x40 to 0xBF in one message. The addresses are those of bytes, so the model has 32
#   words; the other 32 go behind its end. Who gives the 64 bytes of Maxim's model as 64 words gets each second byte 0.
# Version:  max170xx 1.1.0 from crates.io, src/max170x8_x9.rs, set_table(); MAX17048 data sheet, register summary and "TABLE Registers";
#   Linux drivers write the model of the family as four blocks of 16 bytes. The bus is an object of its user, so no gauge is needed.
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
max170xx = "=1.1.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{ErrorType, I2c, Operation};

/// A gauge that keeps the first and the last address of its longest write.
struct Gauge(u8, u8);

impl ErrorType for Gauge {
    type Error = std::convert::Infallible;
}

impl I2c for Gauge {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            if let Operation::Write([first, bytes @ ..]) = operation {
                if bytes.len() > 2 {
                    *self = Gauge(*first, first + bytes.len() as u8 - 1);
                }
            }
        }
        Ok(())
    }
}

fn main() {
    let mut driver = max170xx::Max17048::new(Gauge(0, 0));
    assert!(driver.set_table(&[0; 64]).is_ok());
    let gauge = driver.destroy();
    println!("0x{:02x} to 0x{:02x}", gauge.0, gauge.1);
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "max170xx 1.1.0, a model goes to: $seen"
[ "$seen" = "0x40 to 0xbf" ]
