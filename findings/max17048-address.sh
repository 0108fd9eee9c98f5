#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: the crate max17048 reads the gauge at 0x36, its only address; the traits of embedded-hal take addresses of 7 bits.
# Happens:  it asks for 0x6c, which is that address with the bit for reading and writing. Nothing is there, on Linux
#   (linux-embedded-hal) as on a microcontroller whose bus takes the traits at their word. Another device at 0x6c is configured
#   in its place: new() writes.
# Version:  max17048 0.1.0 from crates.io, src/lib.rs, MAX17048_ADDR; embedded-hal 0.2.7. The bus is an object of its user.
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

/// A bus that tells which address each transfer is for.
struct Bus;

impl WriteRead for Bus {
    type Error = std::convert::Infallible;
    fn write_read(&mut self, address: u8, _: &[u8], _: &mut [u8]) -> Result<(), Self::Error> {
        print!("read {address:#x} ");
        Ok(())
    }
}

impl Write for Bus {
    type Error = std::convert::Infallible;
    fn write(&mut self, address: u8, _: &[u8]) -> Result<(), Self::Error> {
        print!("write {address:#x} ");
        Ok(())
    }
}

fn main() {
    let Ok(_) = max17048::Max17048::new(Bus).vcell();
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "max17048 0.1.0, transfers of new() and of vcell(): $seen"
[ "$seen" = "read 0x6c write 0x6c write 0x6c read 0x6c " ]
