// SPDX-License-Identifier: MIT

//! Writes one data-flash parameter, without FUSE: on a simulated gauge, or on a real one.
//!
//! ```text
//! cargo run -p ti-gauge --example write_parameter                  # simulated
//! cargo run -p ti-gauge --example write_parameter -- /dev/i2c-1    # a bq34z100-G1 on that bus
//! ```

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::linux::{Adapter, LinuxBus};
use gauge_bus::{Bus, GAUGE_ADDRESS};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, DataFlash, Outcome};
use ti_gauge::gauge::Gauge;
use ti_gauge::keys::Keys;

fn main() -> Result<(), Box<dyn Error>> {
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let bus: Box<dyn Bus> = match std::env::args_os().nth(1).map(PathBuf::from) {
        Some(path) => Box::new(LinuxBus::open(Adapter::find(&path)?, GAUGE_ADDRESS, clock.clone())?),
        None => {
            let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone())?;
            // A gauge measures its first voltage a second after it has power.
            clock.sleep(Duration::from_secs(1));
            Box::new(sim.bus())
        }
    };
    let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
    // Without a key of its own, the gauge is unsealed with the manual's default.
    let mut gauge = Gauge::new(chip, bus, clock, Keys::default());
    let mut dataflash = DataFlash::default();

    let (subclass, parameter) = chip.row("80", "53").expect("Cell Terminate Voltage");
    let change = Change::parse(chip, (subclass, parameter), b"3100", false)?;
    match dataflash.write(&mut gauge, &[change], Duration::ZERO)? {
        Outcome::Unchanged => println!("{}: was 3100 already", parameter.name),
        Outcome::Written { .. } => println!("{}: 3100 mV, written and verified", parameter.name),
    }
    Ok(())
}
