// SPDX-License-Identifier: MIT

//! Prints what starship's prompt would show of the batteries, and nothing where there is none: the state, and the energy
//! of all of them in per cent. A battery that cannot be read is left out, as there. Then what the crate has of the last one: seconds
//! until it is empty or full, cycles and degrees Celsius.

use starship_battery::Manager;
use starship_battery::units::thermodynamic_temperature::degree_celsius;

fn main() -> Result<(), starship_battery::Error> {
    let (mut energy, mut full, mut last) = (0.0, 0.0, None);
    for battery in Manager::new()?.batteries()?.flatten() {
        energy += battery.energy().value;
        full += battery.energy_full().value;
        last = Some(battery);
    }
    if let Some(battery) = last.filter(|_| full != 0.0) {
        let seconds = battery.time_to_empty().or(battery.time_to_full()).map_or(0.0, |time| time.value);
        let celsius = battery.temperature().map_or(0.0, |temperature| temperature.get::<degree_celsius>());
        let cycles = battery.cycle_count().unwrap_or(0);
        println!("{} {:.0} {seconds:.0} {cycles} {celsius:.1}", battery.state(), 100.0 * energy / full);
    }
    Ok(())
}
