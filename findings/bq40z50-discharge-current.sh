#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: get_current() of the crate bq40z50 gives Current(), which is negative while a pack is discharged.
# Happens:  it returns the word without its sign: a discharge with 1500 mA is shown as 64036 mA of charge, without an error.
#   get_average_current() does the same.
# Version:  bq40z50 0.1.4 from crates.io, src/lib.rs. Current() is I2, -32767 to 32767 mA: SLUUBC1D, "0x0A Current()".
#   The bus is an object of its user, so no pack is needed.
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
bq40z50 = "=0.1.4"
embedded-hal = "=0.2.7"
END
cat >"$folder/src/main.rs" <<'END'
/// A pack whose Current() and AverageCurrent() (0x0a and 0x0b, low byte first) have this value.
struct Pack(i16);

impl embedded_hal::blocking::i2c::WriteRead for Pack {
    type Error = ();
    fn write_read(&mut self, _: u8, command: &[u8], answer: &mut [u8]) -> Result<(), ()> {
        assert!(command == [0x0a] || command == [0x0b]);
        answer.copy_from_slice(&self.0.to_le_bytes());
        Ok(())
    }
}

fn main() {
    for current in [1500, -1500] {
        let mut pack = bq40z50::BQ40Z50::new(Pack(current));
        let now = pack.get_current().unwrap_or_default();
        let average = pack.get_average_current().unwrap_or_default();
        print!("{now} {average} ");
    }
}
END
export CARGO_TARGET_DIR=$folder/target
seen=$(cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq40z50 0.1.4, current and average of 1500 mA and of -1500 mA: $seen"
[ "$seen" = "1500 1500 64036 64036 " ]
