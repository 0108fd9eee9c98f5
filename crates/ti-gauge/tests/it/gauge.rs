//! Subcommands of the parts that answer in MACData(), on a minimal simulated bus.

use std::sync::Arc;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::Chip;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

/// UNSEALED, with CONTROL_STATUS 0x4080 and OperationStatus() 0x0004. After DEVICE_TYPE and FW_VERSION,
/// Control() reads 0xFFA5 once, according to an underwater vehicle's bq34110 driver.
struct Wire {
    device_type: u16,
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
        let word: u16 = match write {
            [0x00] if std::mem::take(&mut self.elsewhere) => 0xffa5,
            [0x00] => 0x4080,
            [0x3a] => 0x0004,
            [0x40] if self.last == 1 => self.device_type,
            [0x40] => 0x0001,
            _ => return Err(BusError::NoAck),
        };
        read.copy_from_slice(&word.to_le_bytes());
        Ok(())
    }
}

#[test]
fn an_invalid_control_status_is_not_taken_for_a_seal_state() {
    for name in ["bq34110", "bq35100"] {
        let chip = Chip::by_name(name).expect("a chip in the tables");
        let device_type = chip.identity.device_type;
        let wire = Wire { device_type, last: 0, elsewhere: false };
        let clock = Arc::new(SimClock::new());
        let mut gauge = Gauge::new(chip, Box::new(wire), clock, Keys::default(), false);
        let answers = gauge.identify().expect("it answers");
        assert_eq!((answers.device_type, answers.firmware_version), (device_type, 0x0001));
        // Bits 14 and 13 of 0xFFA5 would mean SEALED.
        assert_eq!(gauge.control_status(), Ok((Seal::Unsealed, 0x4080)), "{name}");
        gauge.confirm_identity().expect("the same part");
        assert_eq!(gauge.seal(), Ok(Seal::Unsealed), "{name}");
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
        let mut gauge = Gauge::new(chip, bus, clock.clone(), Keys::default(), false);
        assert_eq!(gauge.seal(), Ok(Seal::Sealed), "{error}");
    }
    let bus = Box::new(Disturbed(Box::new(sim.bus()), BusError::Other(22), false));
    let mut gauge = Gauge::new(chip, bus, clock, Keys::default(), false);
    gauge.seal().expect_err("the adapter cannot do it");
}
