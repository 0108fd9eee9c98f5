#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: device_name() of the trait SmartBattery fills the buffer with a null-terminated name, as its document says, with
#   whichever driver is behind the trait.
# Happens:  bq40z50-rx hands over the SMBus block as it is on the wire: the count before the name, no null after it, and what
#   comes past its end (0xff, the idle bus) up to the end of the buffer. bq27441, of the same trait, does terminate.
# Version:  bq40z50-rx 0.9.0 and bq27441 0.3.0 from crates.io, each with embedded-batteries-async 0.3.4. The bus is an object of
#   its user, so no gauge is needed.
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
bq27441 = { version = "=0.3.0", features = ["async"] }
bq40z50-rx = { version = "=0.9.0", features = ["r5"] }
embedded-batteries-async = "=0.3.4"
embedded-hal-async = "=1.0.0"
pollster = "=0.4.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_batteries_async::smart_battery::SmartBattery;
use embedded_hal_async::{delay::DelayNs, i2c};

/// A pack whose DeviceName() (0x21) is the block "bq40z50"; as a bq27441 it answers the check of its type.
struct Pack;

impl i2c::ErrorType for Pack {
    type Error = std::convert::Infallible;
}

impl i2c::I2c for Pack {
    async fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), Self::Error> {
        if let [i2c::Operation::Write(command), i2c::Operation::Read(answer)] = operations {
            let sent: &[u8] = if command[0] == 0x21 { b"\x07bq40z50" } else { &[0x21, 0x04] };
            answer.fill(0xff);
            answer[..sent.len()].copy_from_slice(sent);
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}

async fn name(mut battery: impl SmartBattery) -> String {
    let mut name = [0; 10];
    battery.device_name(&mut name).await.unwrap();
    name.escape_ascii().to_string()
}

fn main() {
    pollster::block_on(async {
        println!("{} {}", name(bq40z50_rx::Bq40z50R5::new(Pack, NoDelay)).await, name(bq27441::Bq27441Async::new(Pack).await.unwrap()).await);
    });
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq40z50-rx 0.9.0 and bq27441 0.3.0, 10 bytes of the name: $seen"
[ "$seen" = '\x07bq40z50\xff\xff bq27441\x00\x00\x00' ]
