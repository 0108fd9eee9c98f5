// SPDX-License-Identifier: MIT

//! Reads the voltage of a simulated gauge, byte by byte as the manual has it.
//!
//! ```text
//! cargo run -p gauge-sim --example read_voltage
//! ```

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::Bus;
use gauge_bus::clock::{Clock, RealClock};
use gauge_sim::{Options, Sim};

fn main() -> Result<(), Box<dyn Error>> {
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone())?;
    // A gauge measures its first voltage a second after it has power.
    clock.sleep(Duration::from_secs(1));

    // Voltage() of a bq34z100-G1 is at 0x08, the least significant byte first.
    let mut word = [0; 2];
    sim.bus().transfer(&[0x08], &mut word)?;
    println!("{} mV", u16::from_le_bytes(word));
    Ok(())
}
