//! One line a battery, as the crate `starship-battery` sees it: state, percent, volts. The programs starship,
//! bottom and battop read batteries through this crate; they themselves are not run.

use starship_battery::units::electric_potential::volt;
use starship_battery::units::ratio::percent;

fn main() -> Result<(), starship_battery::Error> {
    for battery in starship_battery::Manager::new()?.batteries()? {
        let battery = battery?;
        let (charge, voltage) = (battery.state_of_charge().get::<percent>(), battery.voltage().get::<volt>());
        println!("{} {charge} {voltage}", battery.state());
    }
    Ok(())
}
