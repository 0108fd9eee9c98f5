// SPDX-License-Identifier: MIT

//! A pack, at 0x0b.

use bq40z50::BQ40Z50;
use embedded_hal::i2c::I2c as _;
use linux_embedded_hal::{I2CError, I2cdev};

use crate::{Told, milli, show, told};

/// A bus of the traits of before, which the library takes.
struct Before(I2cdev);

impl embedded_hal_before::blocking::i2c::WriteRead for Before {
    type Error = I2CError;

    fn write_read(&mut self, address: u8, bytes: &[u8], buffer: &mut [u8]) -> Result<(), I2CError> {
        self.0.write_read(address, bytes, buffer)
    }
}

pub fn run(i2c: I2cdev, action: &str) -> Told<()> {
    if action != "read" {
        return Err(format!("no action {action}"));
    }
    let mut pack = BQ40Z50::new(Before(i2c));
    show("voltage_now", told(pack.get_voltage()).map(milli));
    show("gauge/registers/current", told(pack.get_current()));
    show("gauge/registers/average_current", told(pack.get_average_current()));
    // From 273.15 K on, where the kernel's files are from 273.1 K on.
    show("temp", told(pack.get_temperature()).map(|celsius| (celsius * 10.0).ceil()));
    show("capacity", told(pack.get_relative_state_of_charge()));
    show("capacity_error_margin", told(pack.get_max_error()));
    show("gauge/registers/absolute_state_of_charge", told(pack.get_absolute_state_of_charge()));
    show("serial_number", told(pack.get_serial_number()).map(|number| format!("{number:04x}")));
    show("gauge/registers/cell_voltage1", told(pack.get_cell_voltage_1()));
    show("gauge/registers/cell_voltage2", told(pack.get_cell_voltage_2()));
    show("gauge/registers/cell_voltage3", told(pack.get_cell_voltage_3()));
    show("gauge/registers/cell_voltage4", told(pack.get_cell_voltage_4()));
    Ok(())
}
