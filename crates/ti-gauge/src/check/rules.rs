// SPDX-License-Identifier: MIT

//! The rules, as a table.

use super::Severity::{Doubtful, Note, Wrong};
use super::Subject::{Age, Flash, Impossible, Interference, Learning, NotConfigured};
use super::chemistry::finds as chem_id;
use super::{CELL_MV, CHARGE, ENERGY, ENERGY_SCALE, TAPER_VOLTAGE, TERMINATE};
use super::{Facts, Lacking, Rule, Severity, Subject, Verdict};
use crate::chip::{Kind, Quirk, Register, Role, Row, Safe};
use crate::codec::{FREEZING, WINDOW};
use crate::dataflash::{Place, erased};
use crate::notation;
use crate::value::Value;

mod age;
mod capacity;

use age::{
    learning_disturbed, learning_lost, lifetime_voltage, many_cycles, never_learned, not_enabled,
    not_learned, resistance, was_too_warm, worn,
};
use capacity::{full_capacity, full_capacity_stale, remaining_above_full};

pub(super) const DESIGN: &[&str] = &["Design Capacity", "Design Capacity mAh"];
const TAPER: &[&str] = &["Taper Current", "Taper Rate"];
/// The voltages at which a charge ends, and how far a cell may be above: where it is that of the charger, and where it is a
/// little below.
const CHARGED: [(&[&str], f64); 2] = [(CHARGE, 100.0), (TAPER_VOLTAGE, 200.0)];

/// What a lithium-ion cell can have in mV.
const LITHIUM_MV: (f64, f64) = (1500.0, 4600.0);
/// Temperatures in 0.1 K at which the parts work, -40 to 85 °C, with a margin.
const TEMPERATURE: (f64, f64) = (2331.0, 3631.0);
/// Voltages in V that a mAh of Design Energy can stand for.
const NOMINAL_V: (f64, f64) = (1.0, 4.6);
/// CC Gain times the milliohms of the sense resistor, and by what share CC Delta may be of another one: the factors of TI's tool,
/// of drivers and of new parts differ by 0.5 %.
const GAIN_MOHM: f64 = 4.768;
const SAME: f64 = 0.02;
/// Steps of the current from which its sign is certain: where it is known how the voltage moves without them, and where only
/// their number tells them from chance.
const STEPS: u32 = 5;
const STEPS_ALONE: u32 = 20;
/// A current of 0 for so long in seconds, while the voltage of a cell changes by so many mV.
const STILL_S: f64 = 2.0 * 86_400.0;
const STILL_MV: f64 = 150.0;

const fn rule(
    (subject, severity): (Subject, Severity),
    name: &'static str,
    finds: fn(&Facts<'_>) -> Verdict,
    [means, remedy, source]: [&'static str; 3],
) -> Rule {
    Rule { name, severity, subject, finds, means, remedy, source }
}

/// All rules.
#[rustfmt::skip]
pub static RULES: &[Rule] = &[
    rule((NotConfigured, Wrong), "configuration-lost", configuration_lost, [
        "data memory went back to TI's defaults when the gauge lost its power, so its predictions are of another battery",
        "mount it with --profile, which writes its own values whenever that is so (docs/FORGETFUL.md)",
        "SLUUAC9A 2.4.2",
    ]),
    rule((NotConfigured, Wrong), "profile-not-written", profile_not_written, [
        "the gauge has not got its profile, so its predictions are of another battery",
        "remove the cause; it is tried again with each poll",
        "docs/FORGETFUL.md",
    ]),
    rule((NotConfigured, Doubtful), "design-capacity-default", design_capacity_default, [
        "that is what the part has by itself; unless the battery happens to have it, the gauge was never configured or has lost that",
        "write the battery's capacity: `gaugefs set GAUGE 'design-capacity=...'`",
        "the default of the part's manual",
    ]),
    rule((NotConfigured, Doubtful), "design-energy", design_energy, [
        "no cell has that voltage, so one of the two is of another battery",
        "write Design Energy: Design Capacity times the nominal voltage of the cell",
        "SLUSBZ5D Table 7-11, SLUUAC9A 6.4.2.3",
    ]),
    rule((NotConfigured, Note), "rows-at-default", rows_at_default, [
        "these are still what the part has by itself, while Design Capacity is not",
        "compare them with the battery's data sheet and its charger",
        "the defaults of the part's manual",
    ]),
    rule((Impossible, Wrong), "full-capacity", full_capacity, [
        "no battery has less than a third or more than one and a half times its design capacity, so every percentage is wrong",
        "correct Design Capacity, or the capacity that the gauge believes (Qmax, Learned or Full Charge Capacity), and let it learn anew (docs/CALIBRATION.md)",
        "SLUSBZ5D 7.3.1.3; github.com/usetrmnl/trmnl-firmware pull request 542",
    ]),
    rule((Impossible, Wrong), "remaining-above-full", remaining_above_full, [
        "more than 1.1 times a full battery's charge",
        "let the gauge predict anew with a reset; if it comes back, check the sign of the current",
        "SLUSBZ5D 7.3.1.3",
    ]),
    rule((Impossible, Wrong), "percent-above-100", percent_above_100, [
        "StateOfCharge() ends at 100 %",
        "check that the chip is the right one: another part has another register there",
        "SLUSBZ5D 7.3.1.3, SLUUAC9A Table 4-1",
    ]),
    rule((Impossible, Doubtful), "percent-jumped", percent_jumped, [
        "20 % or more within 5 minutes, beyond four times what the current explains, and not within an hour of a write: the gauge has corrected itself, was reset, or does not know its battery",
        "see whether it has learned (`gaugefs learn`); if it comes back, check the chemistry, and CC Gain against the sense resistor",
        "SLUA450",
    ]),
    rule((Impossible, Wrong), "measures-nothing", measures_nothing, [
        "the gauge has measured nothing since its power-up or reset, and no measured value is shown",
        "check the connection of the cell and its voltage at the gauge",
        "SLUSBZ5D 6.3, SLUUAC9A 2.4.6",
    ]),
    rule((Impossible, Wrong), "cell-voltage", cell_voltage, [
        "no cell has that voltage",
        "check the number of cells, Voltage Divider and [VOLTSEL]; a new pack of several cells: `gaugefs bringup`",
        "SLUSBZ5D 7.3.8 and 8.2.2.1.3",
    ]),
    rule((NotConfigured, Doubtful), "divider", divider, [
        "with these the voltage of a full pack cannot be measured",
        "set them together: `gaugefs bringup`, docs/CALIBRATION.md",
        "SLUSBZ5D 7.3.8 and 8.2.2.1.3",
    ]),
    rule((NotConfigured, Doubtful), "sense-resistor", sense_resistor, [
        "current and charge are converted as if through two different sense resistors",
        "calibrate the current, or write both for the resistor of the board (docs/CALIBRATION.md)",
        "SLUSBZ5D Table 7-11 and 8.2.2",
    ]),
    rule((NotConfigured, Doubtful), "chemistry", chemistry, [
        "the pack is charged higher than its configuration says: another chemistry, or another number of cells",
        "compare the chemistry and these voltages with the data sheet of the cell (docs/CALIBRATION.md)",
        "SLUSBZ5D Table 7-11, SLUUAC9A Table 6-3",
    ]),
    rule((NotConfigured, Doubtful), "chem-id", chem_id, [
        "the chemistry profile is of other cells than the configuration, so state of charge and learning follow another curve",
        "choose or program the profile of the cell with TI's tool, then compare the voltages with its data sheet (docs/CALIBRATION.md)",
        "SLUUAC9A 4.1.6, SLUUBB0, SLUUAD4C; Zephyr, dt-bindings/sensor/bq274xx.h",
    ]),
    rule((Impossible, Wrong), "temperature", temperature, [
        "the end of the sensor's range, as without a thermistor or with a short circuit",
        "check the thermistor, or choose the internal sensor: [TEMPS] of the configuration",
        "SLUSBZ5D 6.3 and Table 7-13",
    ]),
    rule((Impossible, Doubtful), "current-always-0", current_always_0, [
        "in two days without current the voltage of a cell changes by 150 mV or more: the gauge does not see the current",
        "check that the current passes through the sense resistor, CC Gain, and CC Deadband",
        "SLUSBZ5D 7.3.8",
    ]),
    rule((Impossible, Wrong), "current-sign", current_sign, [
        "the voltage falls when the current rises, by three times what it moves without that: charge and discharge are exchanged",
        "exchange the lines of the sense resistor, or write CC Gain with the other sign",
        "github.com/usetrmnl/trmnl-firmware pull requests 540 and 542",
    ]),
    rule((Impossible, Wrong), "end-of-scale", end_of_scale, [
        "the last value of the register: the real one may be larger",
        "scale currents and capacities down, and multiply with --current-scale (docs/ATTRIBUTES.md)",
        "SLUSBZ5D 7.3.7.1",
    ]),
    rule((Flash, Wrong), "defect", defect, [
        "a known defect of parts as shipped",
        "see the values",
        "the table of the part",
    ]),
    rule((Flash, Wrong), "owed", owed, [
        "a write or a seal is neither done nor undone",
        "what is known of it, and what to type: `gaugefs settle GAUGE`",
        "docs/SEMANTICS.md",
    ]),
    rule((Flash, Wrong), "erased", is_erased, [
        "a loss of power in a write has erased a row of flash",
        "write all of it in one transaction: `gaugefs import GAUGE BACKUP`",
        "SLUSBZ5D 7.3.3",
    ]),
    rule((Flash, Wrong), "unsafe", unsafe_value, [
        "below what the pack or the gauge bears",
        "write a value within the limit",
        "the limits of the part's table",
    ]),
    rule((Flash, Doubtful), "out-of-range", out_of_range, [
        "outside the manual's range",
        "compare it with the data sheet: `gaugefs get GAUGE NAME`",
        "the ranges of the part's manual",
    ]),
    rule((Flash, Doubtful), "reserved-bits", reserved_bits, [
        "bits that the manual reserves are not as they are shipped",
        "compare with TI's default, and with a gauge that works: `gaugefs diff`",
        "the bits of the part's manual",
    ]),
    rule((Flash, Doubtful), "flash-shut", flash_shut, [
        "below that voltage the gauge acknowledges a write and stores nothing",
        "charge the pack; if the voltage is wrong: `gaugefs bringup`",
        "SLUSBZ5D 7.3.16.3",
    ]),
    rule((Learning, Note), "not-learned", not_learned, [
        "the capacity is the configured one, and not measured",
        "a learning cycle: docs/CALIBRATION.md, `gaugefs learn`",
        "SLUA450, SLUUAC9A 6.4.2.3.2",
    ]),
    rule((Learning, Doubtful), "full-capacity-stale", full_capacity_stale, [
        "the full charge capacity does not follow Design Capacity: percentages are of the old one until the gauge predicts anew or learns",
        "write the capacity that the gauge believes as well (Qmax in mAh, Learned or Full Charge Capacity), or let it learn: docs/CALIBRATION.md, `gaugefs learn`",
        "SLUSBZ5D 7.3.1.3 and Table 7-9",
    ]),
    rule((Learning, Doubtful), "never-learned", never_learned, [
        "in all these cycles the conditions for learning were never met",
        "watch with `gaugefs learn` which one is missing",
        "SLUA450",
    ]),
    rule((Learning, Doubtful), "learning-lost", learning_lost, [
        "a change of Update Status, or of what it is about, has taken it back",
        "learn anew (docs/CALIBRATION.md), or import the values that were learned: `gaugefs import GAUGE BACKUP`",
        "SLUSBZ5D Table 7-9",
    ]),
    rule((Learning, Doubtful), "not-enabled", not_enabled, [
        "Impedance Track is off: nothing is learned, and the capacity does not follow the battery",
        "start it with IT_ENABLE at rest: docs/CALIBRATION.md",
        "SLUSBZ5D 7.3.1.2.15",
    ]),
    rule((Learning, Note), "learning-disturbed", learning_disturbed, [
        "this cycle does not count",
        "begin again with a rest: docs/CALIBRATION.md",
        "SLUA450, SLUUBW5A chapter 12, SLUUBD4A 2.1.3",
    ]),
    rule((Age, Note), "worn", |facts| worn(facts, 50.0, 80.0), [
        "at 80 % cells are usually called worn",
        "plan for another pack",
        "SLUSBZ5D 7.3.2.10",
    ]),
    rule((Age, Doubtful), "worn-out", |facts| worn(facts, 0.0, 50.0), [
        "less than half of the battery's capacity is left, or Design Capacity is of a larger one",
        "exchange the pack, or correct Design Capacity",
        "SLUSBZ5D 7.3.2.10",
    ]),
    rule((Age, Note), "cycles", many_cycles, [
        "cells are usually made for 500",
        "compare with the data sheet of the cell",
        "SLUSBZ5D 7.3.2.9",
    ]),
    rule((Age, Doubtful), "was-too-warm", was_too_warm, [
        "the pack has been warmer than its maker's limit",
        "find out what warms it",
        "SLUSBZ5D 7.3.6.17",
    ]),
    rule((Age, Doubtful), "lifetime-voltage", lifetime_voltage, [
        "the pack has been charged or discharged beyond its maker's limit, or cells and divider were other ones when this was recorded",
        "find out what charges or empties it; a cell that was once so low is worn or dangerous",
        "SLUSBZ5D 7.3.6.17",
    ]),
    rule((Age, Doubtful), "resistance", resistance, [
        "the cells are worn, or a contact is bad; the pack dies under load with much charge left",
        "check the contacts, then plan for another pack",
        "SLUA450",
    ]),
    rule((Interference, Doubtful), "opened", opened, [
        "somebody else has the key to this gauge and can write to it",
        "find the other program; seal it: `gaugefs seal GAUGE`",
        "SLUSBZ5D 7.3.3.4",
    ]),
    rule((Interference, Doubtful), "mode-left-on", mode_left_on, [
        "the gauge does not gauge meanwhile",
        "see the values",
        "the modes of the part's table",
    ]),
    rule((Interference, Wrong), "resets-in-a-row", resets_in_a_row, [
        "three or more within a day: something resets it, such as its supply, its watchdog or another program",
        "check the supply of the gauge, and that nobody else polls it: `gaugefs doctor`",
        "SLUSBH1C 9.5.4.3",
    ]),
    rule((Interference, Doubtful), "reconfigured", reconfigured, [
        "somebody else writes to this gauge, such as the kernel's driver with a `monitored-battery`",
        "find the other program, or leave the configuration to it",
        "Linux, drivers/power/supply/bq27xxx_battery.c",
    ]),
];

fn found_if(is_true: bool, values: impl FnOnce() -> String) -> Verdict {
    Ok(is_true.then(values))
}

fn configuration_lost(facts: &Facts<'_>) -> Verdict {
    match facts.chip.volatile {
        None => Err(Lacking::Never),
        // No bit shows it, but what was written is gone.
        Some(0) => {
            let default = facts.named(DESIGN).ok().and_then(|row| facts.default(row));
            let gone = facts.history.redesigned.filter(|(_, to)| Some(*to) == default);
            Ok(gone
                .filter(|_| facts.unwritten.is_empty())
                .map(|(from, to)| format!("Design Capacity went from {from} back to {to} mAh, TI's default")))
        }
        Some(_) => {
            facts.word(facts.chip.register(Role::Flags).ok_or(Lacking::Never)?.source)?;
            // Why its profile is not there says more.
            found_if(facts.has_lost_memory() && facts.unwritten.is_empty(), || "[ITPOR] is set".into())
        }
    }
}

fn profile_not_written(facts: &Facts<'_>) -> Verdict {
    found_if(!facts.unwritten.is_empty(), || facts.unwritten.into())
}

fn design_capacity_default(facts: &Facts<'_>) -> Verdict {
    let row = facts.named(DESIGN)?;
    let default = facts.default(row).ok_or(Lacking::Never)?;
    let design = facts.design()?;
    // Said by another rule.
    let is_lost = facts.has_lost_memory();
    found_if(design == default && !is_lost, || format!("Design Capacity is {design} mAh, TI's default"))
}

fn design_energy(facts: &Facts<'_>) -> Verdict {
    let (design, energy) = (facts.number(facts.named(DESIGN)?)?, facts.number(facts.named(ENERGY)?)?);
    let steps = if facts.named(ENERGY)?.1.unit == "10mWh" { 10.0 } else { 1.0 };
    let scale = facts.named(ENERGY_SCALE).and_then(|row| facts.number(row)).unwrap_or(steps).max(1.0);
    let cells = facts.cells().unwrap_or(1.0);
    // Sources differ in whether it is the energy of a cell or of the pack, and in what is scaled.
    let fits = |factor: f64| {
        let volts = energy * factor / design;
        (NOMINAL_V.0..=NOMINAL_V.1).contains(&volts)
    };
    let is_wrong =
        design > 0.0 && energy > 0.0 && ![1.0, scale].iter().any(|scale| fits(*scale) || fits(scale / cells));
    found_if(is_wrong, || {
        format!("Design Energy {energy} mWh, Design Capacity {design} mAh: {:.1} V", energy / design)
    })
}

fn rows_at_default(facts: &Facts<'_>) -> Verdict {
    let design = facts.named(DESIGN)?;
    let is_default = |row| Ok(facts.default(row) == Some(facts.number(row)?));
    if facts.default(design).is_none() || is_default(design)? {
        return Ok(None);
    }
    let mut left = Vec::new();
    for row in [ENERGY, TERMINATE, TAPER, TAPER_VOLTAGE].iter().filter_map(|names| facts.named(names).ok()) {
        if is_default(row)? {
            left.push(format!("{} {} {}", row.1.name, facts.number(row)?, row.1.unit));
        }
    }
    found_if(!left.is_empty(), || left.join(", "))
}

fn percent_above_100(facts: &Facts<'_>) -> Verdict {
    let percent = facts.polled(Role::Capacity)?;
    found_if(percent > 100.0, || format!("StateOfCharge() is {percent} %"))
}

fn percent_jumped(facts: &Facts<'_>) -> Verdict {
    Ok(facts
        .history
        .jump
        .map(|(from, to)| format!("StateOfCharge() went from {from} to {to} % between two polls")))
}

fn measures_nothing(facts: &Facts<'_>) -> Verdict {
    let register = facts.chip.register(Role::VoltageNow).ok_or(Lacking::Never)?;
    let voltage = facts.registers.ok_or(Lacking::Never)?.value(register);
    match facts.history.never_measures() {
        Some(polls) if voltage == Some(0) => Ok(Some(format!("Voltage() stays 0 mV, in {polls} polls"))),
        Some(polls) => {
            Ok(Some(format!("the gauge says that it has not begun ([INITCOMP]), in {polls} polls")))
        }
        None => facts.polled(Role::VoltageNow).map(|_| None),
    }
}

fn cell_voltage(facts: &Facts<'_>) -> Verdict {
    let (cells, mv) = (facts.cells()?, facts.cell_mv()?);
    let (low, high) = if facts.is_lithium() { LITHIUM_MV } else { CELL_MV };
    found_if(!(low..=high).contains(&mv), || format!("Voltage() is {mv:.0} mV for each of {cells} cells"))
}

fn temperature(facts: &Facts<'_>) -> Verdict {
    let tenths = facts.polled(Role::Temp)?;
    let is_outside = tenths <= TEMPERATURE.0 || tenths >= TEMPERATURE.1;
    found_if(is_outside, || format!("Temperature() is {:.1} °C", (tenths - FREEZING as f64) / 10.0))
}

/// A bit and two rows that belong together.
fn divider(facts: &Facts<'_>) -> Verdict {
    let gate = facts.chip.gate.as_ref().ok_or(Lacking::Never)?;
    let (Some(external), Some(place)) =
        (gate.external.as_ref().filter(|bit| bit.factor.is_some()), gate.divider)
    else {
        return Err(Lacking::Never);
    };
    let row = facts.at(place)?;
    let bits = facts.at(external.byte)?;
    let byte = bytes(facts, bits).ok_or(Lacking::Stored)?[usize::from(external.byte.1 - bits.1.offset)];
    let is_external = byte & external.mask != 0;
    let (cells, full_scale) = (facts.cells()?, facts.number(row)?);
    let charged = facts.number(facts.chip.stored(Role::VoltageMaxDesign).ok_or(Lacking::Never)?)?;
    let internal = f64::from(gate.cell_divider.ok_or(Lacking::Never)?);
    let name = external.name;
    let is_one_cells = (0.9..=1.1).contains(&(full_scale / internal));
    Ok(match is_external {
        true if full_scale < cells * charged => {
            Some(format!("{name} is set, {cells} cells of {charged} mV, Voltage Divider {full_scale} mV"))
        }
        false if cells * charged > internal => {
            Some(format!("{name} is clear, which is for up to {internal} mV: {cells} cells of {charged} mV"))
        }
        false if !is_one_cells => {
            Some(format!("{name} is clear, Voltage Divider {full_scale} mV is for an external one"))
        }
        _ => None,
    })
}

fn sense_resistor(facts: &Facts<'_>) -> Verdict {
    let calibration = facts.chip.calibration.ok_or(Lacking::Never)?;
    let (gain, delta) =
        (facts.number(facts.at(calibration.gain)?)?, facts.number(facts.at(calibration.delta)?)?);
    let differ = (delta / gain / calibration.ratio - 1.0).abs();
    let [of_gain, of_delta] = [gain, delta / calibration.ratio].map(|gain| GAIN_MOHM / gain);
    found_if(gain != 0.0 && delta != 0.0 && differ > SAME, || {
        format!("CC Gain is of {of_gain:.2} mΩ, CC Delta of {of_delta:.2} mΩ")
    })
}

fn chemistry(facts: &Facts<'_>) -> Verdict {
    let mv = facts.cell_mv()?;
    let found = CHARGED.iter().find_map(|(names, margin)| Some((facts.named(names).ok()?, *margin)));
    let (row, margin) = found.ok_or(Lacking::Never)?;
    let charged = facts.number(row)?;
    // Some parts have a distance there, and what no cell has is said by another rule.
    found_if(charged >= CELL_MV.0 && mv > charged + margin && mv <= LITHIUM_MV.1, || {
        format!("Voltage() is {mv:.0} mV for each cell, {} {charged} mV", row.1.name)
    })
}

fn opened(facts: &Facts<'_>) -> Verdict {
    found_if(facts.history.opened, || "SEALED at first, and open now; gaugefs has not sent a key".into())
}

fn current_always_0(facts: &Facts<'_>) -> Verdict {
    let cells = facts.cells().unwrap_or(1.0);
    let still = facts
        .history
        .still
        .filter(|(since, until, low, high)| until - since >= STILL_S && high - low >= STILL_MV * cells);
    Ok(still.map(|(since, until, low, high)| {
        let hours = (until - since) / 3600.0;
        format!("0 mA for {hours:.0} h, while Voltage() was {low:.0} to {high:.0} mV")
    }))
}

fn current_sign(facts: &Facts<'_>) -> Verdict {
    let (against, with) = (facts.history.opposed, facts.history.agreeing);
    let needed = if facts.history.knows_quiet { STEPS } else { STEPS_ALONE };
    found_if(against >= needed && against >= 9 * with, || {
        format!("in {against} of {} steps of the current the voltage went the other way", against + with)
    })
}

fn end_of_scale(facts: &Facts<'_>) -> Verdict {
    let registers = facts.registers.ok_or(Lacking::Never)?;
    let is_end = |row: &&Register| {
        let bits = 8 * u32::from(row.size) - u32::from(row.signed);
        let Some(value) = registers.value(row).filter(|_| bits >= 15) else { return false };
        value == (1 << bits) - 1 || row.signed && value == -(1 << bits)
    };
    let roles = [Role::CurrentNow, Role::CurrentAvg, Role::ChargeNow, Role::ChargeFull];
    for role in roles.into_iter().filter(|role| facts.chip.register(*role).is_some()) {
        facts.polled(role)?;
    }
    let ends: Vec<_> = roles.iter().filter_map(|role| facts.chip.register(*role)).filter(is_end).collect();
    found_if(!ends.is_empty(), || {
        let shown =
            |row: &&Register| format!("{}() is {} {}", row.name, registers.value(row).unwrap_or(0), row.unit);
        ends.iter().map(shown).collect::<Vec<_>>().join(", ")
    })
}

/// The bytes of a row that has been read.
fn bytes(facts: &Facts<'_>, row: Row) -> Option<Vec<u8>> {
    facts.chip.layout.encode(row.1.kind, &(facts.stored)(row)?)
}

/// Whether the defect is in that row.
fn has((subclass, row): Row, quirk: &Quirk) -> bool {
    let bytes = row.offset..row.offset + row.kind.size() as u16;
    subclass.id == quirk.subclass && bytes.contains(&quirk.offset)
}

fn defect(facts: &Facts<'_>) -> Verdict {
    let mut is_unread = false;
    for quirk in facts.chip.quirks {
        let Some(row) = facts.chip.rows().find(|row| has(*row, quirk)) else { continue };
        let byte =
            bytes(facts, row).and_then(|bytes| bytes.get(usize::from(quirk.offset - row.1.offset)).copied());
        match byte {
            Some(byte) if byte & quirk.mask == quirk.wrong => {
                return Ok(Some(format!("{}; {}", quirk.effect, quirk.remedy)));
            }
            Some(_) => {}
            None => is_unread = true,
        }
    }
    if is_unread { Err(Lacking::Stored) } else { Ok(None) }
}

fn owed(facts: &Facts<'_>) -> Verdict {
    found_if(!facts.owed.is_empty(), || facts.owed.into())
}

/// Looks at each row that is certain and no key.
fn all(facts: &Facts<'_>, finds: impl Fn(Row, &Value) -> Option<String>) -> Verdict {
    let (mut found, mut is_unread) = (Vec::new(), false);
    for row in facts.chip.rows().filter(|(subclass, row)| subclass.kind != Kind::Security && !row.unproven) {
        match facts.value(row) {
            Ok(value) => found.extend(finds(row, &value)),
            // What the gauge rewrites is not kept for long.
            Err(_) => is_unread |= !row.1.learned,
        }
    }
    match found.len() {
        0 if is_unread => Err(Lacking::Stored),
        0 => Ok(None),
        count if count > 8 => Ok(Some(format!("{}, and {} more", found[..8].join(", "), count - 8))),
        _ => Ok(Some(found.join(", "))),
    }
}

fn shown((subclass, row): Row, value: &Value) -> String {
    format!("{} ({}) {}", row.name, Place::of((subclass, row)), notation::show(row, value))
}

fn is_erased(facts: &Facts<'_>) -> Verdict {
    let lost = erased(facts.chip, |row| bytes(facts, row));
    match lost.first() {
        Some(row) => Ok(Some(format!(
            "{} ({}) and what follows it in its row of {WINDOW} bytes read 0xff",
            row.1.name,
            Place::of(*row)
        ))),
        None => all(facts, |_, _| None),
    }
}

fn unsafe_value(facts: &Facts<'_>) -> Verdict {
    all(facts, |row, value| {
        let (Some((least, greatest, why)), Value::Int(number)) = (row.1.safe.as_ref()?.limits(), value)
        else {
            return None;
        };
        match *number {
            number if number < least => Some(format!("{}, at least {least}: {why}", shown(row, value))),
            number if number > greatest => Some(format!("{}, at most {greatest}: {why}", shown(row, value))),
            _ => None,
        }
    })
}

fn out_of_range(facts: &Facts<'_>) -> Verdict {
    all(facts, |row, value| {
        // A value that a defect explains is said with it.
        let is_explained = facts.chip.quirks.iter().any(|quirk| has(row, quirk));
        let is_checked = !row.1.unprinted && !row.1.learned && !row.1.is_date() && !is_explained;
        (is_checked && notation::check(row.1, value).is_err()).then(|| shown(row, value))
    })
}

fn reserved_bits(facts: &Facts<'_>) -> Verdict {
    all(facts, |row, value| {
        let (Some(Safe::Keep(mask, _)), Value::Int(word)) = (&row.1.safe, value) else { return None };
        let default =
            row.1.int_default(facts.dm_code).filter(|_| !row.1.bits.is_empty() && !row.1.learned)?;
        ((word ^ default) & i64::from(*mask) != 0).then(|| shown(row, value))
    })
}

fn flash_shut(facts: &Facts<'_>) -> Verdict {
    let gate = facts.chip.gate.as_ref().ok_or(Lacking::Never)?;
    let (voltage, row) = (facts.polled(Role::VoltageNow)?, facts.at(gate.limit)?);
    let limit = facts.number(row)?;
    found_if(limit > 0.0 && voltage < limit, || {
        format!("Voltage() is {voltage} mV, {} {limit} mV", row.1.name)
    })
}

fn mode_left_on(facts: &Facts<'_>) -> Verdict {
    for mode in facts.chip.preflight.modes.iter().filter(|mode| mode.lasts()) {
        if facts.word(mode.word)? & mode.mask != 0 {
            return Ok(Some(format!("{}: {}; {}", mode.name, mode.what, mode.remedy)));
        }
    }
    Ok(None)
}

fn resets_in_a_row(facts: &Facts<'_>) -> Verdict {
    let resets = facts.history.resets;
    found_if(resets >= 3, || format!("{resets} resets within a day that gaugefs has not sent"))
}

fn reconfigured(facts: &Facts<'_>) -> Verdict {
    // Nobody wrote what a loss of power has taken.
    if configuration_lost(facts).is_ok_and(|found| found.is_some()) {
        return Ok(None);
    }
    Ok(facts
        .history
        .redesigned
        .map(|(from, to)| format!("Design Capacity went from {from} to {to} mAh by itself")))
}
