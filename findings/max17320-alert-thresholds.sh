#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: the crate max17320 sets a lower and an upper threshold and reads them as (min, max), as its document says.
# Happens:  the two bytes are exchanged twice. Words are read with the low byte first, as the gauge sends them, and written with
#   the high byte first; and the upper threshold, the high byte, is read as the lower. So the gauge's default reads as
#   (127, -128) degrees, against the document. Thresholds of -10 and 60 come back as such, but the gauge has -10 as the upper
#   and 60 as the lower: the alert is on at any temperature.
# Version:  max17320 0.1.0 from crates.io, src/lib.rs and src/i2c_interface.rs. The bus is an object of its user, so no gauge is
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
use std::{cell::Cell, rc::Rc};

/// A gauge with TAlrtTh (0x02): the upper threshold in the high byte, the lower in the low byte, low byte first on the bus.
#[derive(Clone)]
struct Gauge(Rc<Cell<u16>>);

impl WriteRead for Gauge {
    type Error = std::convert::Infallible;
    fn write_read(&mut self, _: u8, bytes: &[u8], answer: &mut [u8]) -> Result<(), Self::Error> {
        if let [0x02, low, high] = bytes {
            self.0.set(u16::from_le_bytes([*low, *high]));
        }
        let length = answer.len();
        answer.copy_from_slice(&self.0.get().to_le_bytes()[..length]);
        Ok(())
    }
}

impl Write for Gauge {
    type Error = std::convert::Infallible;
    fn write(&mut self, _: u8, bytes: &[u8]) -> Result<(), Self::Error> {
        self.write_read(0, bytes, &mut [])
    }
}

impl Read for Gauge {
    type Error = std::convert::Infallible;
    fn read(&mut self, _: u8, _: &mut [u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}

fn main() {
    let gauge = Gauge(Rc::new(Cell::new(0x7f80)));
    let Ok(mut driver) = max17320::MAX17320::new(gauge.clone(), 5.0) else { unreachable!() };
    let Ok(default) = driver.read_temperature_alert_threshold() else { unreachable!() };
    let Ok(()) = driver.set_temperature_alert_threshold(-10, 60) else { unreachable!() };
    let Ok(read) = driver.read_temperature_alert_threshold() else { unreachable!() };
    let [upper, lower] = gauge.0.get().to_be_bytes();
    println!("default {default:?}, read {read:?}, in the gauge: upper {} lower {}", upper as i8, lower as i8);
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml")
echo "max17320 0.1.0, the default of -128 and 127 degrees, then -10 and 60: $seen"
[ "$seen" = "default (127, -128), read (-10, 60), in the gauge: upper -10 lower 60" ]
