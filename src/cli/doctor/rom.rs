// SPDX-License-Identifier: MIT

//! A gauge stuck in ROM mode, on a bus that the user has named.

use std::path::Path;
use std::sync::Arc;

use super::{Finding, ok, problem, warning};
use crate::error::Result;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus};
use ti_gauge::probe::{ROM_ADDRESS, answers_in_rom};
use ti_gauge::rom;

pub(super) fn check(bus: &Path) -> Result<Finding> {
    let adapter = Adapter::find(bus)?;
    let answers = |address| -> Result<bool> {
        let mut bus = LinuxBus::open(adapter.clone(), address, Arc::new(RealClock::new()))?;
        let answers = answers_in_rom(&mut bus);
        answers.map_err(|error| error.about(format!("{adapter} address 0x{address:02x}")))
    };
    if adapter.driver(GAUGE_ADDRESS).is_some() {
        return Ok(ok(format!("gauge on {adapter}"), "a kernel driver uses 0x55; nothing was read"));
    }
    Ok(finding(&adapter.to_string(), answers(GAUGE_ADDRESS)?, answers(ROM_ADDRESS)?))
}

/// The finding by which of the two addresses is acknowledged.
fn finding(bus: &str, gauge: bool, rom: bool) -> Finding {
    let what = format!("gauge on {bus}");
    match (gauge, rom) {
        (true, _) => ok(what, "a device answers at 0x55"),
        (false, true) => {
            let says = "no device answers at 0x55, and one at 0x0b: a gauge in ROM mode, whose firmware is not whole, or \
                        a smart battery";
            let remedy = format!(
                "If it is a gauge: switch its power off and on; if that does not help: gaugefs rescue FILE.bq.fs \
                 --bus {bus} --chip CHIP, which is {}; no other part can be brought back",
                rom::supported()
            );
            problem(what, says, remedy)
        }
        (false, false) => {
            warning(what, "no device answers at 0x55 or 0x0b", "Check the gauge's power and its wires.")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::State;
    use super::*;

    #[test]
    fn a_gauge_that_answers_at_0x0b_only_is_in_rom_mode() {
        let found = finding("/dev/i2c-1", false, true);
        assert!(found.state == State::Problem && found.says.contains("ROM mode"));
        assert!(found.remedy.expect("the way").contains("gaugefs rescue FILE.bq.fs --bus /dev/i2c-1"));
        // A gauge beside a smart battery.
        assert!(finding("/dev/i2c-1", true, true).state == State::Ok);
        assert!(finding("/dev/i2c-1", false, false).state == State::Warning);
    }
}
