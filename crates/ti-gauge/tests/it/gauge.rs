// SPDX-License-Identifier: MIT

//! Subcommands of the parts that answer in MACData(), on a minimal simulated bus.

use std::sync::Arc;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::{Chip, Register, Tier};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;
use ti_gauge::value::Type;

use crate::rig::Rig;

/// UNSEALED, with CONTROL_STATUS 0x4080 and OperationStatus() 0x0004. After DEVICE_TYPE and FW_VERSION,
/// Control() reads 0xFFA5 once, according to an underwater vehicle's bq34110 driver.
struct Wire {
    device_type: u16,
    /// The answer to FW_VERSION.
    firmware: [u8; 6],
    /// How often MACData() still shows the answer to DEVICE_TYPE.
    stale: u32,
    last: u16,
    elsewhere: bool,
}

impl Bus for Wire {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if let &[0x00, low, high] = write {
            self.last = u16::from_le_bytes([low, high]);
            self.elsewhere |= matches!(self.last, 1 | 2);
            return Ok(());
        }
        let is_stale = write == [0x40] && self.last == 2 && self.stale > 0;
        self.stale -= u32::from(is_stale);
        let word: u16 = match write {
            [0x00] if std::mem::take(&mut self.elsewhere) => 0xffa5,
            [0x00] => 0x4080,
            [0x3a] => 0x0004,
            [0x40] if self.last == 2 && !is_stale => {
                read.copy_from_slice(&self.firmware[..read.len()]);
                return Ok(());
            }
            [0x40] if self.last == 1 || is_stale => self.device_type,
            [0x40] => 0x0001,
            _ => return Err(BusError::NoAck),
        };
        let mut bytes = [0; 6];
        bytes[..2].copy_from_slice(&word.to_le_bytes());
        read.copy_from_slice(&bytes[..read.len()]);
        Ok(())
    }
}

/// A gauge that answers so to FW_VERSION.
fn answering(name: &str, firmware: [u8; 6], stale: u32) -> Gauge {
    let chip = Chip::by_name(name).expect("a chip in the tables");
    let wire = Wire { device_type: chip.identity.device_type, firmware, stale, last: 0, elsewhere: false };
    Gauge::new(chip, Box::new(wire), Arc::new(SimClock::new()), Keys::default())
}

#[test]
fn an_invalid_control_status_is_not_taken_for_a_seal_state() {
    for (name, firmware) in
        [("bq34110", [0x01, 0x10, 0x00, 0x01, 0, 1]), ("bq35100", [0x01, 0x00, 0x00, 0x01, 0, 1])]
    {
        let mut gauge = answering(name, firmware, 0);
        let answers = gauge.identify().expect("it answers");
        assert_eq!(
            (answers.device_type, answers.firmware_version),
            (gauge.chip.identity.device_type, 0x0001)
        );
        // Bits 14 and 13 of 0xFFA5 would mean SEALED.
        assert_eq!(gauge.control_status(), Ok((Seal::Unsealed, 0x4080)), "{name}");
        gauge.confirm_identity().expect("the same part");
        assert_eq!(gauge.seal(), Ok(Seal::Unsealed), "{name}");
    }
}

/// TI's images of a BQ27220 compare the answer with 02 20 00 03.
#[test]
fn regression_the_firmware_follows_the_device_number() {
    for (name, number) in [("bq27220", [0x02, 0x20]), ("bq34110", [0x01, 0x10]), ("bq35100", [0x01, 0x00])] {
        let [a, b] = number;
        for stale in 0..3 {
            let mut gauge = answering(name, [a, b, 0x02, 0x01, 0x00, 0x07], stale);
            assert_eq!(gauge.firmware_version(), Ok(0x0201), "{name}");
            assert_eq!(gauge.ask(0x0002), Ok(0x0201), "{name}: gauge/control");
        }
        // Nothing says that; it is shown as it is.
        let mut gauge = answering(name, [0x07, 0x03, 0, 0, 0, 0], 0);
        assert_eq!(gauge.firmware_version(), Ok(0x0307), "{name}");
    }
}

/// A gauge whose adapter answers with an error before every transfer that succeeds.
struct Disturbed(Box<dyn Bus>, BusError, bool);

impl Bus for Disturbed {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.2 = !self.2;
        if self.2 { Err(self.1) } else { self.0.transfer(write, read) }
    }
}

/// i2c-gpio reports EIO, other adapters ENXIO or ETIMEDOUT, where a byte was not acknowledged.
#[test]
fn an_idempotent_transfer_is_sent_again_whatever_the_adapter_calls_the_failure() {
    let clock = Arc::new(SimClock::new());
    let sim =
        gauge_sim::Sim::new("bq34z100-g1", &gauge_sim::Options::default(), clock.clone()).expect("a gauge");
    clock.sleep(std::time::Duration::from_secs(1));
    let chip = Chip::by_name("bq34z100-g1").expect("a chip in the tables");
    for error in [BusError::NoAck, BusError::Timeout, BusError::Other(5)] {
        let bus = Box::new(Disturbed(Box::new(sim.bus()), error, false));
        let mut gauge = Gauge::new(chip, bus, clock.clone(), Keys::default());
        assert_eq!(gauge.seal(), Ok(Seal::Sealed), "{error}");
    }
    let bus = Box::new(Disturbed(Box::new(sim.bus()), BusError::Other(22), false));
    let mut gauge = Gauge::new(chip, bus, clock, Keys::default());
    gauge.seal().expect_err("the adapter cannot do it");
}

#[test]
fn a_row_may_be_the_answer_to_a_subcommand() {
    let mut rig = Rig::new("bq34110");
    let rows: &[Register] = Vec::leak(vec![
        Register::new(0x08, Type::U(2), "Voltage", "mV", Tier::Static),
        Register::answer(0x0001, Type::U(2), "DeviceType", "", Tier::Static),
        Register::answer(0x0002, Type::U(4), "FirmwareVersion", "", Tier::Static),
    ]);
    let mut registers = Registers::unread(rows);
    registers.read(&mut rig.gauge, |tier| tier == Tier::Static).expect("it answers");
    let [voltage, kind, version] = [0, 1, 2].map(|at| registers.value(&rows[at]).expect("it was read"));
    assert!((2000..5000).contains(&voltage), "{voltage}");
    assert_eq!(kind, 0x0110);
    // The device number comes first, most significant byte first.
    assert_eq!(version & 0xffff, 0x1001, "0x{version:08x}");
}
