// SPDX-License-Identifier: MIT

//! What is amiss with a gauge that answers, such as TI's defaults: `gauge/last_error` has it as long as it is so.

use jiff::Timestamp;

use super::handle::Shared;
use super::memory;
use crate::error::Result;
use ti_gauge::chip::sbs::failures::failures;
use ti_gauge::chip::{Chip, Range, Role};
use ti_gauge::registers::Registers;

/// Polls in a row without a measurement, half a second to some seconds apart, after which a person is told.
const FOR_GOOD: u32 = 5;

/// Publishes it with each poll. `is_managed` says that there is a profile, or will be; `can_write`, whether data flash can
/// be written.
pub(super) fn tell(
    shared: &Shared,
    registers: &Registers,
    unmeasured: u32,
    is_managed: bool,
    can_write: Result<()>,
) {
    let amiss =
        has_failed(shared.chip, registers).or_else(|| measures_nothing(shared.chip, registers, unmeasured));
    let amiss = amiss.or_else(|| lacks_configuration(shared, registers).filter(|_| !is_managed));
    let has_flash = !shared.chip.subclasses.is_empty() && shared.published().limited.is_none();
    let is_refused = || can_write.err().filter(|_| has_flash).map(|error| error.reason().to_string());
    let amiss = amiss.or_else(is_refused);
    if shared.published().amiss.as_ref().map(|(_, amiss)| &**amiss) == amiss.as_deref() {
        return;
    }
    if let Some(amiss) = &amiss {
        log::warn!("{}: {amiss}", shared.name());
    }
    shared.publish(|published| {
        published.amiss = amiss.map(|amiss| (Timestamp::now(), amiss.into()));
    });
}

fn has_failed(chip: &Chip, registers: &Registers) -> Option<String> {
    let failures = failures(chip, |row| registers.value(row));
    let told = failures.iter().map(|one| format!("{} ({}; check {})", one.name, one.what, one.check));
    let told: Vec<_> = told.collect();
    (!told.is_empty())
        .then(|| format!("the pack is out of use for good, by a permanent failure: {}", told.join(", ")))
}

fn measures_nothing(chip: &Chip, registers: &Registers, unmeasured: u32) -> Option<String> {
    (unmeasured >= FOR_GOOD).then_some(())?;
    let voltage = chip.register(Role::VoltageNow).and_then(|register| registers.value(register));
    let sign = match chip.condition.complete {
        _ if voltage == Some(0) => "Voltage() stays 0 mV".to_string(),
        Some((shown_in, mask)) => {
            let bits = chip.register_at(shown_in).map_or(chip.control_status, |register| register.bits);
            format!("[{}] stays clear", bits.iter().find(|bit| bit.mask & mask != 0)?.name)
        }
        None => return None,
    };
    Some(format!(
        "{sign}: the gauge has measured nothing since its power-up or reset, so no measured value is shown and nothing \
         can be written; check the connection of the cell and its voltage at the gauge"
    ))
}

fn lacks_configuration(shared: &Shared, registers: &Registers) -> Option<String> {
    const REMEDY: &str =
        "mount with --profile to have its own written whenever that is so (docs/FORGETFUL.md)";
    let chip = shared.chip;
    let flag = chip.volatile.filter(|_| shared.published().limited.is_none())?;
    if flag != 0 {
        return memory::reports_loss(chip, registers).then(|| {
            format!("it has lost its configuration with its power, and works with TI's defaults; {REMEDY}")
        });
    }
    // Nothing else shows it.
    let design = registers.value(chip.register(Role::ChargeFullDesign)?)?;
    (default_capacity(chip)? == design).then(|| {
        format!(
            "DesignCapacity() is TI's default, {design} mAh: it has lost its configuration, or never had one; {REMEDY}"
        )
    })
}

fn default_capacity(chip: &Chip) -> Option<i64> {
    let mut rows = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
    match rows.find(|row| row.name == "Design Capacity")?.range {
        Range::Int { default, .. } => default,
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Run, operations as op};
    use super::*;
    use gauge_bus::Reach;
    use ti_gauge::chip::CHIPS;
    use ti_gauge::dataflash::Change;
    use ti_gauge::value::Value;

    fn told(rig: &Rig) -> String {
        rig.handle.published().amiss.as_ref().map_or(String::new(), |(_, amiss)| amiss.to_string())
    }

    #[test]
    fn regression_a_gauge_that_had_lost_its_configuration_said_so_in_the_log_only() {
        for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
            let mut rig = Rig::of(chip.name, Run::default());
            rig.start().expect("it answers");
            for position in ["off", "on"] {
                rig.sim.set("power", position).expect("a knob");
                rig.poll_after(INTERVAL);
            }
            rig.poll_after(INTERVAL);
            assert!(told(&rig).contains("--profile"), "{}: {}", chip.name, told(&rig));
            let rows =
                chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
            let row = rows.into_iter().find(|(_, row)| row.name == "Design Capacity").expect("each has one");
            let change = Change::of_value(chip, row, &Value::Int(1234), false).expect("it fits");
            rig.ask(&op::WRITE, vec![change]).expect("the default keys");
            for _ in 0..2 {
                rig.poll_after(INTERVAL);
            }
            assert_eq!(told(&rig), "", "{}", chip.name);
        }
    }

    /// What `list` shows, and `gauge/last_error`.
    #[test]
    fn data_flash_that_can_only_be_read_is_said_while_it_is_so() {
        for (chip, reach, is_said) in [
            ("bq34z100-g1", Reach::smbus(2, false), true),
            ("bq34z100-g1", Reach::smbus(32, false), false),
            ("bq27520-g3", Reach::smbus(2, false), false),
        ] {
            let mut rig = Rig::of(chip, Run::default());
            rig.sim.set_reach(reach);
            rig.start().expect("it answers");
            let says = "data flash can only be read: the adapter carries writes of 3 bytes";
            assert_eq!(told(&rig).starts_with(says), is_said, "{chip} {reach:?}: {}", told(&rig));
            rig.sim.set_reach(Reach::FULL);
            rig.poll_after(INTERVAL);
            assert_eq!(told(&rig), "", "{chip}: another adapter");
        }
    }

    #[test]
    fn regression_a_gauge_that_measures_nothing_did_not_say_why_nothing_is_shown() {
        for name in ["bq34z100-g1", "bq27441-g1"] {
            let mut rig = Rig::of(name, Run::default());
            rig.start().expect("it answers");
            let is_valid = |rig: &Rig| {
                rig.handle.published().snapshot.as_ref().is_some_and(|snapshot| snapshot.is_valid)
            };
            rig.sim.set("voltage_mv", "0").expect("a knob");
            for _ in 0..FOR_GOOD {
                assert_eq!(told(&rig), "", "{name}");
                rig.poll_after(Duration::from_secs(3));
            }
            assert!(!is_valid(&rig) && told(&rig).contains("Voltage() stays 0 mV"), "{name}: {}", told(&rig));
            rig.sim.set("voltage_mv", "3700").expect("a knob");
            rig.poll_after(INTERVAL);
            assert!(is_valid(&rig) && told(&rig).is_empty(), "{name}: {}", told(&rig));
        }
    }
}
