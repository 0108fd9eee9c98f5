// SPDX-License-Identifier: MIT

//! Reads one register of a device on a Linux I2C bus and prints its bytes.
//!
//! ```text
//! cargo run -p gauge-bus --example read_register -- /dev/i2c-1 0x55 0x08 2
//! ```

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use gauge_bus::Bus;
use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus};

fn number(text: &str) -> Result<u8, std::num::ParseIntError> {
    text.strip_prefix("0x").map_or_else(|| text.parse(), |digits| u8::from_str_radix(digits, 16))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bus, address, register, count] = arguments.as_slice() else {
        return Err("usage: read_register BUS ADDRESS REGISTER COUNT".into());
    };
    let adapter = Adapter::find(Path::new(bus))?;
    let mut target = LinuxBus::open(adapter, number(address)?, Arc::new(RealClock::new()))?;
    let mut bytes = vec![0; number(count)?.into()];
    target.transfer(&[number(register)?], &mut bytes)?;
    println!("{bytes:02x?}");
    Ok(())
}
