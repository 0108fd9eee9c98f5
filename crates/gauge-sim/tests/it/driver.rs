// SPDX-License-Identifier: MIT

//! The independently published driver crate `bq27441` on the simulated bq27441-G1, through embedded-hal's
//! `I2c`.

use std::sync::Arc;
use std::time::Duration;

use bq27441::{Bq27441, ControlCmd, DelayMs};
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::hal::AsHal;
use gauge_sim::{Options, Sim, SimBus};

type Driver = Bq27441<AsHal<SimBus>>;

/// The driver's delays advance the simulated clock.
struct Delay(Arc<SimClock>);

impl DelayMs for Delay {
    fn delay_ms(&mut self, ms: u32) {
        self.0.sleep(Duration::from_millis(ms.into()));
    }
}

fn connect() -> (Sim, Arc<SimClock>, Driver) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("bq27441-g1", &Options::default(), clock.clone()).expect("a simulated gauge");
    clock.sleep(Duration::from_secs(3));
    let driver = Driver::new(AsHal::new(sim.bus(), GAUGE_ADDRESS)).expect("the driver finds its part");
    (sim, clock, driver)
}

#[test]
fn a_published_driver_reads_the_simulated_gauge() {
    let (sim, _, mut driver) = connect();
    assert_eq!(driver.control_read(ControlCmd::DeviceType).expect("an answer"), 0x0421);
    assert_eq!(driver.voltage().expect("a word"), 3855);
    let soc = driver.state_of_charge().expect("a word");
    let shown: f64 = sim.get("soc").expect("a knob").parse().expect("a number");
    assert!((f64::from(soc) - shown).abs() <= 1.0, "{soc} and {shown}");
    assert!((driver.temperature_celsius().expect("a word") - 25.0).abs() < 1.0);
    assert_eq!(driver.average_current().expect("a word"), 0);
}

/// The driver's own sequence of unsealing, CONFIG UPDATE, block access and checksum.
#[test]
fn a_published_driver_unseals_and_reads_data_memory() {
    let (sim, clock, mut driver) = connect();
    assert!(!driver.is_sealed().expect("an answer"), "a gauge with RAM starts UNSEALED");
    sim.set("seal", "sealed").expect("a knob");
    assert!(driver.is_sealed().expect("an answer"));
    driver.unseal().expect("the manual's key");
    assert!(!driver.is_sealed().expect("an answer"));
    driver.enter_config_mode().expect("SET_CFGUPDATE");
    driver.wait_for_config_mode(true, &mut Delay(clock.clone())).expect("the mode comes");
    assert_eq!(sim.get("mode").as_deref(), Some("config-update"));
    assert_eq!(driver.design_capacity().expect("a block"), 1340);
}
