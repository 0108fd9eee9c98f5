#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: update_q_max() of the crate bq34z100 writes Qmax (82/0) and clears Cycle Count (82/2), on any gauge.
# Happens:  the fourth byte, the low one of Cycle Count, is cleared in the checksum and not in the gauge: the loop that sends
#   the bytes ends one too early. The gauge drops the block for its wrong checksum, so a new pack can be set and a pack of 37
#   cycles cannot; the error says "Qmax not updated", and each further try ends the same.
# Version:  bq34z100 0.4.0 from crates.io, src/lib.rs, update_q_max(), with its feature write. Bus and delay are objects of its
#   user; the gauge below takes a block only with the complement of the sum of its 32 bytes, as SLUSBZ5D says.
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
bq34z100 = { version = "=0.4.0", features = ["write"] }
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use bq34z100::{Bq34Z100Error, Bq34z100g1, Bq34z100g1Driver};
use embedded_hal::{delay::DelayNs, i2c};

/// A gauge with block 0 of the class 82: what is stored, and the window at 0x40 that is written before its checksum.
struct Gauge {
    stored: [u8; 32],
    window: [u8; 32],
}

impl i2c::ErrorType for Gauge {
    type Error = i2c::ErrorKind;
}

impl i2c::I2c for Gauge {
    fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), i2c::ErrorKind> {
        for operation in operations {
            match operation {
                i2c::Operation::Write(&[0x3f, 0]) => self.window = self.stored,
                i2c::Operation::Write(&[register @ 0x40..=0x5f, value]) => self.window[usize::from(register - 0x40)] = value,
                i2c::Operation::Write(&[0x60, checksum]) => {
                    if self.window.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) == !checksum {
                        self.stored = self.window;
                    }
                }
                i2c::Operation::Read(answer) if answer.len() == 32 => answer.copy_from_slice(&self.window),
                _ => {}
            }
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

fn main() {
    for cycles in [0, 37] {
        let mut stored = [0; 32];
        (stored[0], stored[1], stored[3]) = (0x03, 0xe8, cycles);
        let mut gauge = Bq34z100g1Driver { i2c: Gauge { stored, window: stored }, delay: NoDelay, flash_block_data: [0; 32] };
        let said = match gauge.update_q_max(2200) {
            Ok(()) => "stored",
            Err(Bq34Z100Error::NotStored { error }) => error,
            Err(_) => "another error",
        };
        print!("{said} {}, ", u16::from_be_bytes([gauge.i2c.stored[0], gauge.i2c.stored[1]]));
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq34z100 0.4.0, Qmax from 1000 to 2200 mAh at 0 and at 37 cycles: $seen"
[ "$seen" = "stored 2200, Qmax not updated 1000, " ]
