#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: get_flags_decoded() of the crate bq34z100 names the bits of Flags(): discharge is DSG, bit 0 of the word, and
#   fast_charge_allowed is CHG, bit 8 (SLUSBZ5D, table 7-6).
# Happens:  the two bytes are exchanged. A discharging pack (0x0001) has discharge false and fast_charge_allowed true; one that
#   is too hot to discharge (0x4000) has no bit set at all, and one with a state of charge below SOC1 (0x0004) is
#   charging_not_allowed.
# Version:  bq34z100 0.4.0 from crates.io, src/lib.rs, get_flags_decoded(). Bus and delay are objects of its user.
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
bq34z100 = "=0.4.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use bq34z100::{Bq34z100g1, Bq34z100g1Driver};
use embedded_hal::{delay::DelayNs, i2c};

/// A gauge whose Flags() (0x0e, low byte first) has this value.
struct Gauge(u16);

impl i2c::ErrorType for Gauge {
    type Error = i2c::ErrorKind;
}

impl i2c::I2c for Gauge {
    fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), i2c::ErrorKind> {
        if let [i2c::Operation::Write(&[0x0e]), i2c::Operation::Read(answer)] = operations {
            answer.copy_from_slice(&self.0.to_le_bytes());
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

fn main() {
    for word in [0x0001, 0x4000, 0x0004] {
        let mut gauge = Bq34z100g1Driver { i2c: Gauge(word), delay: NoDelay, flash_block_data: [0; 32] };
        let flags = format!("{:?}", gauge.get_flags_decoded().unwrap());
        let set = flags.split(['{', ',', '}']).filter_map(|field| field.trim().strip_suffix(": true"));
        println!("{word:#06x}: {}", set.collect::<Vec<_>>().join(" "));
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq34z100 0.4.0, flags of DSG, OTD and SOC1:"
echo "$seen"
[ "$seen" = $'0x0001: fast_charge_allowed\n0x4000: \n0x0004: charging_not_allowed' ]
