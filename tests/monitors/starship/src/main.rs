// SPDX-License-Identifier: MIT

//! Prints what starship's prompt would show of the batteries, and nothing where there is none: the state, and the energy
//! of all of them in per cent. A battery that cannot be read is left out, as there.

use starship_battery::Manager;

fn main() -> Result<(), starship_battery::Error> {
    let (mut energy, mut full, mut state) = (0.0, 0.0, None);
    for battery in Manager::new()?.batteries()?.flatten() {
        energy += battery.energy().value;
        full += battery.energy_full().value;
        state = Some(battery.state());
    }
    if let Some(state) = state.filter(|_| full != 0.0) {
        println!("{state} {:.0}", 100.0 * energy / full);
    }
    Ok(())
}
