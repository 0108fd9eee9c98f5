// SPDX-License-Identifier: MIT

//! Reads or writes the gauge at 0x55, or reads the pack at 0x0b, with a library: `libraries LIBRARY ACTION BUS [NUMBER...]`. What it
//! reads is printed as lines of a file's name in a gauge's folder and the value in that file's unit, by the units in the library's
//! documentation.

mod bq27441;
mod bq27xxx;
mod bq34z100;
mod bq40z50;
mod i2cdev;

use std::fmt::Debug;

use linux_embedded_hal::I2cdev;

const ADDRESS: u8 = 0x55;

/// A library's error as a line that the comparison shows.
type Told<T> = Result<T, String>;

fn told<T, E: Debug>(result: Result<T, E>) -> Told<T> {
    result.map_err(|error| format!("{error:?}"))
}

fn open(bus: &str) -> Told<I2cdev> {
    told(I2cdev::new(bus))
}

/// Prints a file's name and its value, or a library's error in place of it.
fn show<V: std::fmt::Display>(file: &str, value: Told<V>) {
    match value {
        Ok(value) => println!("{file} {value}"),
        Err(error) => println!("{file} error {error}"),
    }
}

/// What a kernel's file shows of a word in thousandths of its unit.
fn milli(value: impl Into<i64>) -> i64 {
    1000 * value.into()
}

fn celsius(kelvins: u16) -> i32 {
    i32::from(kelvins) - 2731
}

fn main() -> Result<(), String> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [library, action, bus, numbers @ ..] = words.as_slice() else {
        return Err("libraries LIBRARY ACTION BUS [NUMBER...]".into());
    };
    let numbers = told(numbers.iter().map(|number| number.parse()).collect::<Result<Vec<i32>, _>>())?;
    match library.as_str() {
        "bq34z100" => bq34z100::run(open(bus)?, action, &numbers),
        "bq27441" => bq27441::run(open(bus)?, action, &numbers),
        "bq27xxx" => bq27xxx::run(open(bus)?, action, &numbers),
        "bq40z50" => bq40z50::run(open(bus)?, action),
        "i2cdev" => i2cdev::run(bus),
        _ => Err(format!("no library {library}")),
    }
}
