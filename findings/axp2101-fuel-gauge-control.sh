#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: gauge_module_enable and cell_battery_charge_enable of the crate axp2101 switch the fuel gauge and the charger of an
#   AXP2101.
# Happens:  they are the bits of register 0x18 (charger, fuel gauge and watchdog), but the crate reads and writes 0xA2, the access to
#   the gauge's battery model. A gauge that runs reads as off, and switching the charger on leaves it as it was and writes to
#   the access of the model.
# Version:  axp2101 0.1.0 from crates.io, src/lib.rs, FuelGaugeControl and Register; AXP2101 data sheet 1.0, REG 18 and REG A2. The bus
#   is an object of its user, so no part is needed.
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
axp2101 = "=0.1.0"
embedded-hal = "=1.0.0"
END
cat >"$folder/src/main.rs" <<'END'
use embedded_hal::i2c::{ErrorType, I2c, Operation};

/// A part whose registers these are; the last pointer is the register that is read.
struct Part<'a>(&'a mut [u8; 256], u8);

impl ErrorType for Part<'_> {
    type Error = std::convert::Infallible;
}

impl I2c for Part<'_> {
    fn transaction(&mut self, _: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        for operation in operations {
            match operation {
                Operation::Write([register]) => self.1 = *register,
                Operation::Write([register, byte]) => self.0[usize::from(*register)] = *byte,
                Operation::Read(answer) => answer[0] = self.0[usize::from(self.1)],
                other => panic!("{other:?}"),
            }
        }
        Ok(())
    }
}

fn main() {
    let mut registers = [0; 256];
    registers[0x18] = 0x08; // The gauge runs, the charger is off.
    let mut driver = axp2101::Axp2101::new(Part(&mut registers, 0));
    let Ok(control) = driver.get_fuel_gauge_control();
    print!("gauge runs: {}; ", control.gauge_module_enable());
    let Ok(()) = driver.set_fuel_gauge_control(&control.with_cell_battery_charge_enable(true));
    println!("after switching the charger on: 0x18 = 0x{:02x}, 0xa2 = 0x{:02x}", registers[0x18], registers[0xa2]);
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "axp2101 0.1.0, the gauge runs and the charger is off: $seen"
[ "$seen" = "gauge runs: false; after switching the charger on: 0x18 = 0x08, 0xa2 = 0x02" ]
