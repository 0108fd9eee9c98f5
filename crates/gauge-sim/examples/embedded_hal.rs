// SPDX-License-Identifier: MIT

//! Drives a simulated gauge through embedded-hal's `I2c`, as a driver for a microcontroller would.
//!
//! ```text
//! cargo run -p gauge-sim --example embedded_hal
//! ```

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::hal::AsHal;
use gauge_sim::{Options, Sim};

/// A driver of three lines. It knows nothing of gaugefs.
fn voltage_mv<I: I2c>(i2c: &mut I) -> Result<u16, I::Error> {
    let mut word = [0; 2];
    i2c.write_read(GAUGE_ADDRESS, &[0x04], &mut word)?;
    Ok(u16::from_le_bytes(word))
}

fn main() -> Result<(), Box<dyn Error>> {
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let sim = Sim::new("bq27441-g1", &Options::default(), clock.clone())?;
    clock.sleep(Duration::from_secs(1));

    let mut i2c = AsHal::new(sim.bus(), GAUGE_ADDRESS);
    println!("{} mV", voltage_mv(&mut i2c)?);
    Ok(())
}
