#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: write_flash_stream_i2c() of the crate bq34z100 waits as long as a line `X:` of a FlashStream file says, which is
#   a decimal number of milliseconds (SLUA801, section 5).
# Happens:  the number is read as hexadecimal: `X: 170` waits 368 ms, `X: 4000` 16.384 s. No digit of a decimal number is an
#   error there, so nothing tells; a wait of two digits is 1.6 times as long, one of four digits 4.1 times.
# Version:  bq34z100 0.4.0 from crates.io, src/lib.rs, with its feature flashstream. Bus and delay are objects of its user.
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
bq34z100 = { version = "=0.4.0", features = ["flashstream"] }
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use bq34z100::{Bq34z100g1, Bq34z100g1Driver};
use embedded_hal::{delay::DelayNs, i2c};

struct NoBus;

impl i2c::ErrorType for NoBus {
    type Error = i2c::ErrorKind;
}

impl i2c::I2c for NoBus {
    fn transaction(&mut self, _: u8, _: &mut [i2c::Operation<'_>]) -> Result<(), i2c::ErrorKind> {
        Err(i2c::ErrorKind::Other)
    }
}

struct Waited(u64);

impl DelayNs for Waited {
    fn delay_ns(&mut self, ns: u32) {
        self.0 += u64::from(ns);
    }
}

fn main() {
    for line in ["X: 170", "X: 1000", "X: 4000"] {
        let mut gauge = Bq34z100g1Driver { i2c: NoBus, delay: Waited(0), flash_block_data: [0; 32] };
        gauge.write_flash_stream_i2c(line, false).unwrap();
        print!("{} ", gauge.delay.0 / 1_000_000);
    }
}
END
export CARGO_TARGET_DIR=$folder/target
seen=$(cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq34z100 0.4.0, milliseconds of X: 170, X: 1000 and X: 4000: $seen"
[ "$seen" = "368 4096 16384 " ]
