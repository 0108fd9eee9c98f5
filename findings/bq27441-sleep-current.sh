#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: the crate bq27441 reads Sleep Current (82/31) of a new BQ27441 as 10 mA, and configure_battery() with its default
#   of 10 mA leaves it so.
# Happens:  it reads 0 and writes 2570 mA, over the maximum of 1000 (SLUUAC9A, Table 6-3): a pack is asleep then under
#   any load. The parameter has two bytes, of which the second is the first of block 1; the crate takes byte 31 of block 0, the
#   high one, for all of it.
# Version:  bq27441 0.3.0 from crates.io, src/bq27441.yaml, DM_SLEEP_CURRENT (size_bits: 8); src/config.rs. The bus is an object
#   of its user, so no gauge is needed.
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
bq27441 = "=0.3.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use bq27441::{BatteryConfig, Bq27441, ConfigureOptions};
use embedded_hal::i2c;

/// An unsealed gauge whose data memory holds what is written to it; Sleep Current (82/31) is 10 mA at first.
struct Gauge {
    memory: [[u8; 64]; 256],
    class: usize,
    block: usize,
    updating: bool,
    asked: u8,
}

impl i2c::ErrorType for Gauge {
    type Error = i2c::ErrorKind;
}

impl i2c::I2c for Gauge {
    fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), i2c::ErrorKind> {
        let mut register = 0;
        for operation in operations {
            match operation {
                i2c::Operation::Write([at, data @ ..]) => {
                    register = usize::from(*at);
                    match (register, data) {
                        (0x00, [asked @ (0x00 | 0x01), 0x00]) => self.asked = *asked,
                        // SET_CFGUPDATE, and the ways out.
                        (0x00, [0x13, 0x00]) => self.updating = true,
                        (0x00, [0x42..=0x44, 0x00]) => self.updating = false,
                        (0x3e, [class]) => self.class = usize::from(*class),
                        (0x3f, [block]) => self.block = usize::from(*block) % 2,
                        (0x40..0x60, data) => self.window()[register - 0x40..][..data.len()].copy_from_slice(data),
                        _ => {}
                    }
                }
                i2c::Operation::Read(answer) => {
                    answer.fill(0);
                    match register {
                        // DEVICE_TYPE, and no bit of CONTROL_STATUS.
                        0x00 if self.asked == 1 => answer.copy_from_slice(&[0x21, 0x04]),
                        0x06 => answer[0] = u8::from(self.updating) << 4,
                        0x40..0x60 => answer.copy_from_slice(&self.window()[register - 0x40..][..answer.len()]),
                        0x60 => answer[0] = !self.window().iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)),
                        _ => {}
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl Gauge {
    fn window(&mut self) -> &mut [u8] {
        &mut self.memory[self.class][32 * self.block..][..32]
    }
}

fn main() {
    let mut gauge = Gauge { memory: [[0; 64]; 256], class: 0, block: 0, updating: false, asked: 0 };
    gauge.memory[82][31..33].copy_from_slice(&10_u16.to_be_bytes());
    let mut driver = Bq27441::new(gauge).unwrap();
    print!("reads {}", driver.read_battery_config().unwrap().sleep_current_ma);
    driver.configure_battery_default(&BatteryConfig::G1A_DEFAULT, ConfigureOptions::default()).unwrap();
    let memory = driver.destroy().memory[82];
    println!(", writes {}", u16::from_be_bytes([memory[31], memory[32]]));
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "bq27441 0.3.0, Sleep Current of 10 mA: $seen"
[ "$seen" = 'reads 0, writes 2570' ]
