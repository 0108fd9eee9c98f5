// SPDX-License-Identifier: MIT

use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bq27xxx::{Bq27xx, ChemId, ChipError, memory::memory_subclass};
use embedded_hal::i2c::I2c as _;
use linux_embedded_hal::{I2CError, I2cdev};

use crate::{ADDRESS, Told, celsius, milli, show};

/// A bus that answers at once, for a library that would wait.
struct AtOnce(I2cdev);

impl embedded_hal::i2c::ErrorType for AtOnce {
    type Error = I2CError;
}

impl embedded_hal_async::i2c::I2c for AtOnce {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [embedded_hal::i2c::Operation<'_>],
    ) -> Result<(), I2CError> {
        self.0.transaction(address, operations)
    }
}

struct Sleep;

impl embedded_hal_async::delay::DelayNs for Sleep {
    async fn delay_ns(&mut self, ns: u32) {
        std::thread::sleep(Duration::from_nanos(ns.into()));
    }
}

type Gauge = Bq27xx<AtOnce, Sleep>;

/// What a future is, of a bus that answers at once.
fn done<T>(future: impl Future<Output = Result<T, ChipError<I2CError>>>) -> Told<T> {
    let Poll::Ready(result) = pin!(future).poll(&mut Context::from_waker(Waker::noop())) else {
        return Err("it waits for something".into());
    };
    result.map_err(|error| match error {
        ChipError::I2CError(error) => format!("{error}"),
        ChipError::PollTimeout => "PollTimeout".into(),
        ChipError::Checksum => "Checksum".into(),
        ChipError::Value => "Value".into(),
        ChipError::Usage => "Usage".into(),
    })
}

pub fn run(i2c: I2cdev, action: &str, numbers: &[i32]) -> Told<()> {
    let mut gauge = Bq27xx::new(AtOnce(i2c), Sleep, ADDRESS);
    match (action, numbers) {
        ("read", []) => read(&mut gauge),
        ("design-capacity", [mah]) => {
            let mut block = done(gauge.memblock_read(memory_subclass::STATE, 0))?;
            block.raw[6..8].copy_from_slice(&(*mah as u16).to_be_bytes());
            done(gauge.memblock_write(memory_subclass::STATE, 0, block))?;
        }
        ("chemistry", [voltage]) => {
            let id = match voltage {
                4350 => ChemId::A4350,
                4200 => ChemId::B4200,
                _ => ChemId::C4400,
            };
            done(gauge.write_chem_id(id))?;
        }
        _ => return Err(format!("no action {action} with {} numbers", numbers.len())),
    }
    Ok(())
}

fn read(gauge: &mut Gauge) {
    show("capacity", done(gauge.state_of_charge()));
    show("voltage_now", done(gauge.voltage()).map(milli));
    show("current_now", done(gauge.average_current()).map(milli));
    show("temp", done(gauge.temperature()).map(celsius));
    show("gauge/registers/flags", done(gauge.get_flags()).map(|flags| flags.bits()));
    show("gauge/firmware_version", done(gauge.fw_version()).map(|word| format!("{word:#06x}")));
    let chemistry = done(gauge.read_chem_id()).map(|id| match id {
        ChemId::A4350 => "0x3230",
        ChemId::B4200 => "0x1202",
        ChemId::C4400 => "0x3142",
        ChemId::Unknown => "unknown",
    });
    show("gauge/chem_id", chemistry);
}
