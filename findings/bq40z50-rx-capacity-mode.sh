#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: bq40z50-rx gives RemainingCapacity() as mAh or as 10 mWh, depending on the CAPACITY_MODE bit of BatteryMode(), as
#   the document of the trait SmartBattery says.
# Happens:  it depends on what this object of the driver wrote last. The bit lives in the pack: where the firmware set it, or
#   the same program before its restart, 22.20 Wh come as 2220 mAh, even after battery_mode() has read the bit.
# Version:  bq40z50-rx 0.9.0 from crates.io, src/common.rs, capacity_mode_state; embedded-batteries-async 0.3.4. The bus is an
#   object of its user, so no gauge is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2024"
[dependencies]
bq40z50-rx = { version = "=0.9.0", features = ["r5"] }
embedded-batteries-async = "=0.3.4"
embedded-hal-async = "=1.0.0"
pollster = "=0.4.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_batteries_async::smart_battery::SmartBattery;
use embedded_hal_async::{delay::DelayNs, i2c};

/// A pack with CAPACITY_MODE (bit 15 of the word at 0x03) set, and 22.20 Wh left (word at 0x0f).
struct Pack;

impl i2c::ErrorType for Pack {
    type Error = std::convert::Infallible;
}

impl i2c::I2c for Pack {
    async fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), Self::Error> {
        let [i2c::Operation::Write(command), i2c::Operation::Read(answer)] = operations else { unreachable!() };
        let word: u16 = match command[0] {
            0x03 => 0x8000,
            0x0f => 2220,
            other => panic!("{other:#x}"),
        };
        answer.copy_from_slice(&word.to_le_bytes());
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}

fn main() {
    pollster::block_on(async {
        let mut pack = bq40z50_rx::Bq40z50R5::new(Pack, NoDelay);
        println!("{} {:?}", pack.battery_mode().await.unwrap().capacity_mode(), pack.remaining_capacity().await.unwrap());
    });
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq40z50-rx 0.9.0, CAPACITY_MODE as read, and the unit of 22.20 Wh: $seen"
[ "$seen" = "true MilliAmpUnsigned(2220)" ]
