#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: charge_rate() of the crate max17048 is the rate in percent per hour, and a discharge is negative: CRATE (0x16) is a
#   signed word.
# Happens:  the word is taken as unsigned: a cell that is charged with 2.08 %/h has 2.08, one that is discharged with 2.08 %/h
#   has 13629.4. No rate is ever below 0.
# Version:  max17048 0.1.0 from crates.io, src/lib.rs, charge_rate(). The bus is an object of its user, so no gauge is needed.
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
max17048 = "=0.1.0"
embedded-hal = "=0.2.7"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::blocking::i2c::{Write, WriteRead};

/// A gauge whose CRATE (0x16, high byte first) is this number of 0.208 %/h.
struct Gauge(i16);

impl WriteRead for Gauge {
    type Error = std::convert::Infallible;
    fn write_read(&mut self, _: u8, bytes: &[u8], answer: &mut [u8]) -> Result<(), Self::Error> {
        answer.copy_from_slice(&if bytes == [0x16] { self.0.to_be_bytes() } else { [0x97, 0x1c] });
        Ok(())
    }
}

impl Write for Gauge {
    type Error = std::convert::Infallible;
    fn write(&mut self, _: u8, _: &[u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}

fn main() {
    for rate in [10, -10] {
        let mut driver = max17048::Max17048::new(Gauge(rate));
        let Ok(rate) = driver.charge_rate();
        print!("{rate:.2} ");
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "max17048 0.1.0, rates of 2.08 and of -2.08 % per hour: $seen"
[ "$seen" = "2.08 13629.41 " ]
