// SPDX-License-Identifier: MIT

//! A gauge stuck in ROM mode, on a bus that the user has named.

use std::path::Path;
use std::sync::Arc;

use super::{Finding, ok, problem, warning};
use crate::error::Result;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::adapters::certain;
use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus};
use ti_gauge::probe::{ROM_ADDRESS, answers_in_rom};
use ti_gauge::rom::{self, Device};

const CHECK: &str = "Check the gauge's power and its wires.";

pub(super) fn check(bus: &Path) -> Result<Finding> {
    let adapter = Adapter::find(bus)?;
    let clock = Arc::new(RealClock::new());
    let open = |address| LinuxBus::open(adapter.clone(), address, clock.clone());
    if adapter.driver(GAUGE_ADDRESS).is_some() {
        return Ok(ok(format!("gauge on {adapter}"), "a kernel driver uses 0x55; nothing was read"));
    }
    let gauge = answers_in_rom(&mut open(GAUGE_ADDRESS)?).map(|answers| answers.then_some(()));
    let rom = rom::find(&mut open(ROM_ADDRESS)?, &*clock);
    Ok(finding(&adapter.to_string(), Answer::of(gauge), Answer::of(rom)))
}

/// Whether an address is acknowledged, or what happened instead of an answer.
enum Answer<T> {
    Yes(T),
    No,
    Unknown(String),
}

impl<T> Answer<T> {
    fn of(found: Result<Option<T>>) -> Self {
        match found {
            Ok(Some(who)) => Self::Yes(who),
            Ok(None) => Self::No,
            Err(error) => Self::Unknown(error.reason().to_string()),
        }
    }
}

/// The finding by which of the two addresses is acknowledged.
fn finding(bus: &str, gauge: Answer<()>, rom: Answer<Device>) -> Finding {
    let what = format!("gauge on {bus}");
    let which = |device| match device {
        Device::BootLoader => "a gauge in ROM mode, whose firmware is not whole",
        Device::SmartBattery => "a Smart Battery",
        Device::Unclear => "a gauge in ROM mode, whose firmware is not whole, or a Smart Battery",
    };
    match (gauge, rom) {
        (Answer::Yes(()), _) => ok(what, "a device answers at 0x55"),
        (Answer::No, Answer::Yes(Device::SmartBattery)) => ok(
            what,
            format!("a Smart Battery answers at 0x0b; gaugefs mount --bus {bus} --chip sbs reads it"),
        ),
        (Answer::Unknown(why), Answer::Yes(device)) => {
            let says = format!("a device answers at 0x0b: {}; at 0x55: {why}", which(device));
            let remedy =
                format!("Ask an adapter that tells a missing acknowledge for certain: {}", certain());
            warning(what, says, remedy)
        }
        (Answer::Unknown(why), Answer::Unknown(other)) if why != other => {
            warning(what, format!("at 0x55: {why}; at 0x0b: {other}"), CHECK)
        }
        (Answer::Unknown(why), _) | (Answer::No, Answer::Unknown(why)) => {
            warning(what, format!("no device answers at 0x55 or 0x0b: {why}"), CHECK)
        }
        (Answer::No, Answer::Yes(device)) => {
            let says = format!("no device answers at 0x55, and one at 0x0b: {}", which(device));
            let remedy = format!(
                "If it is a gauge: switch its power off and on; if that does not help: gaugefs rescue FILE.bq.fs \
                 --bus {bus} --chip CHIP, which is {}; other parts take TI's tools",
                rom::supported()
            );
            problem(what, says, remedy)
        }
        (Answer::No, Answer::No) => warning(what, "no device answers at 0x55 or 0x0b", CHECK),
    }
}

#[cfg(test)]
mod tests {
    use super::super::State;
    use super::*;

    #[test]
    fn a_gauge_that_answers_at_0x0b_only_is_in_rom_mode() {
        use Answer::{No, Unknown, Yes};
        let found = finding("/dev/i2c-1", No, Yes(Device::BootLoader));
        assert!(found.state == State::Problem && found.says.contains("ROM mode"));
        assert!(found.remedy.expect("the way").contains("gaugefs rescue FILE.bq.fs --bus /dev/i2c-1"));
        let found = finding("/dev/i2c-1", No, Yes(Device::Unclear));
        assert!(found.state == State::Problem && found.says.contains("or a Smart Battery"));
        let found = finding("/dev/i2c-1", No, Yes(Device::SmartBattery));
        assert!(found.state == State::Ok && found.says.contains("--chip sbs"), "{}", found.says);
        // A gauge beside a Smart Battery.
        assert!(finding("/dev/i2c-1", Yes(()), Yes(Device::SmartBattery)).state == State::Ok);
        assert!(finding("/dev/i2c-1", No, No).state == State::Warning);
        // The adapter does not tell whether a gauge is at 0x55, so none is called in ROM mode.
        let says = || gauge_bus::BusError::MaybeNoAck(110).to_string();
        let (maybe, maybe_rom) = (|| Unknown(says()), || Unknown(says()));
        let found = finding("/dev/i2c-1", maybe(), Yes(Device::BootLoader));
        assert!(
            found.state == State::Warning && found.says.contains("or the bus timed out"),
            "{}",
            found.says
        );
        assert!(found.remedy.expect("the way").contains("MCP2221"));
        assert!(finding("/dev/i2c-1", Yes(()), maybe_rom()).state == State::Ok);
        for (gauge, rom) in [(maybe(), maybe_rom()), (maybe(), No), (No, maybe_rom())] {
            let found = finding("/dev/i2c-1", gauge, rom);
            assert!(found.state == State::Warning && found.says.contains("or the bus timed out"));
        }
    }
}
