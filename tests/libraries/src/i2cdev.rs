// SPDX-License-Identifier: MIT

//! The ways of reading a word that this crate has, each of a bq34z100-g1: `by-WAY FILE VALUE`.

use i2cdev::core::{I2CDevice, I2CMessage, I2CTransfer};
use i2cdev::linux::{LinuxI2CBus, LinuxI2CDevice, LinuxI2CMessage};

use crate::{ADDRESS, Told, milli, show, told};

/// Voltage() of the bq34z100.
const VOLTAGE: u8 = 0x08;

pub fn run(path: &str) -> Told<()> {
    let mut device = told(LinuxI2CDevice::new(path, ADDRESS.into()))?;
    let word = |low: u8, high: u8| u16::from_le_bytes([low, high]);
    let volts = |way: &str, value: Told<u16>| show(&format!("{way} voltage_now"), value.map(milli));
    volts("smbus_read_word_data", told(device.smbus_read_word_data(VOLTAGE)));
    volts(
        "smbus_read_byte_data",
        told(device.smbus_read_byte_data(VOLTAGE)).and_then(|low| {
            let high = told(device.smbus_read_byte_data(VOLTAGE + 1))?;
            Ok(word(low, high))
        }),
    );
    volts(
        "smbus_read_i2c_block_data",
        told(device.smbus_read_i2c_block_data(VOLTAGE, 2)).map(|bytes| word(bytes[0], bytes[1])),
    );
    volts(
        "smbus_write_byte",
        told(device.smbus_write_byte(VOLTAGE)).and_then(|()| {
            let low = told(device.smbus_read_byte())?;
            told(device.smbus_write_byte(VOLTAGE + 1))?;
            Ok(word(low, told(device.smbus_read_byte())?))
        }),
    );
    let mut bytes = [0; 2];
    volts(
        "read",
        told(device.write(&[VOLTAGE])).and_then(|()| {
            told(device.read(&mut bytes))?;
            Ok(word(bytes[0], bytes[1]))
        }),
    );
    let mut messages = [LinuxI2CMessage::write(&[VOLTAGE]), LinuxI2CMessage::read(&mut bytes)];
    let transferred = told(device.transfer(&mut messages));
    volts("transfer", transferred.map(|_| word(bytes[0], bytes[1])));
    let mut bus = told(LinuxI2CBus::new(path))?;
    let mut messages = [
        LinuxI2CMessage::write(&[VOLTAGE]).with_address(ADDRESS.into()),
        LinuxI2CMessage::read(&mut bytes).with_address(ADDRESS.into()),
    ];
    let transferred = told(bus.transfer(&mut messages));
    volts("bus.transfer", transferred.map(|_| word(bytes[0], bytes[1])));
    // A subcommand and its answer.
    let kind = told(device.smbus_write_word_data(0, 1)).and_then(|()| told(device.smbus_read_word_data(0)));
    show("smbus_write_word_data gauge/device_type", kind.map(|word| format!("{word:#06x}")));
    let kind = told(device.smbus_write_i2c_block_data(0, &[1, 0]))
        .and_then(|()| told(device.smbus_read_word_data(0)));
    show("smbus_write_i2c_block_data gauge/device_type", kind.map(|word| format!("{word:#06x}")));
    // What SMBus has and these gauges have not.
    show("smbus_write_quick -", told(device.smbus_write_quick(false)).map(|()| "done"));
    show("smbus_read_block_data -", told(device.smbus_read_block_data(VOLTAGE)).map(|_| "done"));
    Ok(())
}
