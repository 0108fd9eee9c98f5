// SPDX-License-Identifier: MIT

//! `gaugefs-vm-client`: a program of the guest that uses a bus.
//!
//! ```text
//! words BUS COUNT           reads a word of the gauge at 0x55 so many times, and prints what one took, in microseconds
//! plain BUS                 the same by write(2) and read(2), once; prints its bytes
//! ioctls BUS COUNT [SEED]   so many calls by chance; prints how many were carried out
//! ```

#![allow(clippy::disallowed_methods, reason = "it speaks to the person that runs it")]

#[path = "../../it/room/ioctls.rs"]
mod ioctls;

use std::env;
use std::error::Error;
use std::fs::File;
use std::time::Instant;

use i2cdev::core::I2CDevice;
use i2cdev::linux::LinuxI2CDevice;

const ADDRESS: u16 = 0x55;
/// Voltage().
const REGISTER: u8 = 0x08;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["words", bus, count] => println!("{:.0}", words(bus, count.parse()?)?),
        ["plain", bus] => {
            let mut gauge = LinuxI2CDevice::new(bus, ADDRESS)?;
            let mut word = [0; 2];
            gauge.write(&[REGISTER])?;
            gauge.read(&mut word)?;
            println!("{:02x} {:02x}", word[0], word[1]);
        }
        ["ioctls", bus, count] => storm(bus, count.parse()?, 1)?,
        ["ioctls", bus, count, seed] => storm(bus, count.parse()?, seed.parse()?)?,
        _ => return Err("usage: gaugefs-vm-client words BUS COUNT | ioctls BUS COUNT [SEED]".into()),
    }
    Ok(())
}

fn words(bus: &str, count: u32) -> Result<f64, Box<dyn Error>> {
    let mut gauge = LinuxI2CDevice::new(bus, ADDRESS)?;
    let begun = Instant::now();
    for _ in 0..count {
        gauge.smbus_read_word_data(REGISTER)?;
    }
    Ok(begun.elapsed().as_secs_f64() * 1e6 / f64::from(count))
}

fn storm(bus: &str, count: u64, seed: u64) -> Result<(), Box<dyn Error>> {
    let open = || File::options().read(true).write(true).open(bus).expect("the bus");
    let answered = ioctls::by_chance(&open, count, seed);
    println!("{answered} of {count} were carried out");
    if ioctls::funcs(&open()) { Ok(()) } else { Err("it does not answer any more".into()) }
}
