#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: read_current() of the crate max17320 is in ampere, as its document says, or in milliampere, as its example prints.
# Happens:  it is in microampere: 1 A through 5 mOhm is 1000000. The number of the register is 1.5625 uV each, which are divided
#   by ohms and by nothing else.
# Version:  max17320 0.1.0 from crates.io, src/lib.rs, convert_to_current(). The bus is an object of its user, so no gauge is
#   needed.
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
max17320 = "=0.1.0"
embedded-hal = "=0.2.7"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::blocking::i2c::{Read, Write, WriteRead};

/// A gauge whose Current (0x1c) is this number of 1.5625 uV.
struct Gauge(i16);

impl WriteRead for Gauge {
    type Error = std::convert::Infallible;
    fn write_read(&mut self, _: u8, bytes: &[u8], answer: &mut [u8]) -> Result<(), Self::Error> {
        assert_eq!(bytes, [0x1c]);
        answer.copy_from_slice(&self.0.to_le_bytes());
        Ok(())
    }
}

impl Write for Gauge {
    type Error = std::convert::Infallible;
    fn write(&mut self, _: u8, _: &[u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl Read for Gauge {
    type Error = std::convert::Infallible;
    fn read(&mut self, _: u8, _: &mut [u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}

fn main() {
    for microvolts in [5000.0, -2500.0] {
        let Ok(mut driver) = max17320::MAX17320::new(Gauge((microvolts / 1.5625) as i16), 5.0) else { unreachable!() };
        let Ok(current) = driver.read_current() else { unreachable!() };
        print!("{current} ");
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "max17320 0.1.0, 1 A and -0.5 A through 5 mOhm: $seen"
[ "$seen" = "1000000 -500000 " ]
