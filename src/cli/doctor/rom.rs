// SPDX-License-Identifier: MIT

//! A gauge stuck in ROM mode, on a bus that the user has named.

use std::path::Path;
use std::sync::Arc;

use super::{Finding, ok, problem, warning};
use crate::error::Result;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus, certain};
use ti_gauge::probe::{ROM_ADDRESS, answers_in_rom};
use ti_gauge::rom;

const CHECK: &str = "Check the gauge's power and its wires.";

pub(super) fn check(bus: &Path) -> Result<Finding> {
    let adapter = Adapter::find(bus)?;
    let answers = |address| -> Result<Answer> {
        let mut bus = LinuxBus::open(adapter.clone(), address, Arc::new(RealClock::new()))?;
        Ok(match answers_in_rom(&mut bus) {
            Ok(true) => Answer::Yes,
            Ok(false) => Answer::No,
            Err(error) => Answer::Unknown(error.reason().to_string()),
        })
    };
    if adapter.driver(GAUGE_ADDRESS).is_some() {
        return Ok(ok(format!("gauge on {adapter}"), "a kernel driver uses 0x55; nothing was read"));
    }
    Ok(finding(&adapter.to_string(), answers(GAUGE_ADDRESS)?, answers(ROM_ADDRESS)?))
}

/// Whether an address is acknowledged, or what happened instead of an answer.
enum Answer {
    Yes,
    No,
    Unknown(String),
}

/// The finding by which of the two addresses is acknowledged.
fn finding(bus: &str, gauge: Answer, rom: Answer) -> Finding {
    let what = format!("gauge on {bus}");
    match (gauge, rom) {
        (Answer::Yes, _) => ok(what, "a device answers at 0x55"),
        (Answer::Unknown(why), Answer::Yes) => {
            let says =
                format!("a device answers at 0x0b: a gauge in ROM mode or a smart battery; at 0x55: {why}");
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
        (Answer::No, Answer::Yes) => {
            let says = "no device answers at 0x55, and one at 0x0b: a gauge in ROM mode, whose firmware is not whole, or \
                        a smart battery";
            let remedy = format!(
                "If it is a gauge: switch its power off and on; if that does not help: gaugefs rescue FILE.bq.fs \
                 --bus {bus} --chip CHIP, which is {}; no other part can be brought back",
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
        let found = finding("/dev/i2c-1", No, Yes);
        assert!(found.state == State::Problem && found.says.contains("ROM mode"));
        assert!(found.remedy.expect("the way").contains("gaugefs rescue FILE.bq.fs --bus /dev/i2c-1"));
        // A gauge beside a smart battery.
        assert!(finding("/dev/i2c-1", Yes, Yes).state == State::Ok);
        assert!(finding("/dev/i2c-1", No, No).state == State::Warning);
        // The adapter does not tell whether a gauge is at 0x55, so none is called in ROM mode.
        let maybe = || Unknown(gauge_bus::BusError::MaybeNoAck(110).to_string());
        let found = finding("/dev/i2c-1", maybe(), Yes);
        assert!(
            found.state == State::Warning && found.says.contains("or the bus timed out"),
            "{}",
            found.says
        );
        assert!(found.remedy.expect("the way").contains("MCP2221"));
        assert!(finding("/dev/i2c-1", Yes, maybe()).state == State::Ok);
        for (gauge, rom) in [(maybe(), maybe()), (maybe(), No), (No, maybe())] {
            let found = finding("/dev/i2c-1", gauge, rom);
            assert!(found.state == State::Warning && found.says.contains("or the bus timed out"));
        }
    }
}
