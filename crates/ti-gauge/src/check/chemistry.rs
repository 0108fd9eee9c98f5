// SPDX-License-Identifier: MIT

//! What is public of chemistry profiles: those that TI programs, by CHEM_ID. TI's list of all others is part of its tools.

use super::battery::{Battery, Family};
use super::{CELL_MV, CHARGE, Facts, Lacking, TAPER_VOLTAGE, Verdict};
use crate::chip::{Chip, Role};
use crate::learning::Learns;
use crate::value::Value;

/// A profile of lithium-ion cells with an oxide cathode.
struct Profile {
    parts: &'static [&'static str],
    chem_id: u16,
    /// What its documents call it.
    name: &'static str,
    /// The voltages in mV to which its cells are charged.
    charge_mv: (f64, f64),
}

const G1: &[&str] = &["bq27421-g1", "bq27441-g1"];
const SELECTED: &[&str] = &["bq27426", "bq27427"];
const BQ27621: &[&str] = &["bq27621-g1"];

/// SLUUAC9A 4.1.6, SLUUBB0, SLUUCD5, SLUUAD4C, and the voltages as in Zephyr's `dt-bindings/sensor/bq274xx.h`. That of a new
/// bq34z100-G1 is what an owner read, who wanted one for lead-acid (E2E 416308).
#[rustfmt::skip]
const PROFILES: &[Profile] = &[
    Profile { parts: &["bq34z100-g1"], chem_id: 0x0107, name: "as shipped", charge_mv: (4200.0, 4200.0) },
    Profile { parts: G1,               chem_id: 0x0128, name: "G1A",        charge_mv: (4200.0, 4200.0) },
    Profile { parts: G1,               chem_id: 0x0312, name: "G1B",        charge_mv: (4300.0, 4350.0) },
    Profile { parts: &["bq27421-g1"],  chem_id: 0x3142, name: "G1D",        charge_mv: (4300.0, 4400.0) },
    Profile { parts: SELECTED,         chem_id: 0x3230, name: "CHEM_A",     charge_mv: (4350.0, 4350.0) },
    Profile { parts: SELECTED,         chem_id: 0x1202, name: "CHEM_B",     charge_mv: (4200.0, 4200.0) },
    Profile { parts: SELECTED,         chem_id: 0x3142, name: "CHEM_C",     charge_mv: (4400.0, 4400.0) },
    Profile { parts: BQ27621,          chem_id: 0x1202, name: "default",    charge_mv: (4200.0, 4200.0) },
    Profile { parts: BQ27621,          chem_id: 0x1210, name: "ALT_CHEM1",  charge_mv: (4300.0, 4300.0) },
    Profile { parts: BQ27621,          chem_id: 0x0354, name: "ALT_CHEM2",  charge_mv: (4350.0, 4350.0) },
];

/// Cells are charged to less, or a little more, than their profile has.
const BELOW_MV: f64 = 100.0;
const ABOVE_MV: f64 = 50.0;
/// How far Taper Voltage is below the voltage at which charging ends.
const TAPER_MV: (f64, f64) = (0.0, 300.0);

impl Profile {
    fn all_of(chip: &Chip) -> impl Iterator<Item = &'static Self> {
        PROFILES.iter().filter(move |profile| profile.parts.contains(&chip.name))
    }

    fn of(chip: &Chip, chem_id: u16) -> Option<&'static Self> {
        Self::all_of(chip).find(|profile| profile.chem_id == chem_id)
    }

    fn suits(&self, mv: f64) -> bool {
        (self.charge_mv.0 - BELOW_MV..=self.charge_mv.1 + ABOVE_MV).contains(&mv)
    }

    /// `CHEM_ID 0x0128 is of lithium-ion cells charged to 4200 mV`.
    fn told(&self) -> String {
        let (low, high) = self.charge_mv;
        let volts = if low == high { format!("{high}") } else { format!("{low} to {high}") };
        format!("CHEM_ID 0x{:04x} is of lithium-ion cells charged to {volts} mV", self.chem_id)
    }
}

/// The profile against what is configured for the battery.
pub(super) fn finds(facts: &Facts<'_>) -> Verdict {
    let profile = facts.chem_id.and_then(|id| Profile::of(facts.chip, id)).ok_or(Lacking::Never)?;
    let mut others = Vec::new();
    if let Some(row) = facts.chip.stored(Role::Technology)
        && let Value::Text(name) = facts.value(row)?
        && !name.eq_ignore_ascii_case(b"LION")
    {
        others.push(format!("{} {}", row.1.name, String::from_utf8_lossy(&name).trim()));
    }
    if let Ok(row) = facts.named(CHARGE) {
        let mv = facts.number(row)?;
        if !profile.suits(mv) {
            others.push(format!("{} {mv} mV", row.1.name));
        }
    }
    if let Ok(row) = facts.named(TAPER_VOLTAGE) {
        let mv = facts.number(row)?;
        // What the part has by itself may be of another of its profiles. Some parts have a distance there.
        let is_chosen = facts.default(row) != Some(mv) && mv >= CELL_MV.0;
        let fits = (profile.charge_mv.0 - TAPER_MV.1..=profile.charge_mv.1 - TAPER_MV.0).contains(&mv);
        if is_chosen && !fits {
            others.push(format!("{} {mv} mV", row.1.name));
        }
    }
    Ok((!others.is_empty()).then(|| format!("{}; {}", profile.told(), others.join(", "))))
}

/// What is left to do about the chemistry of a battery that is charged, and whether the gauge is wrong without it.
pub(super) fn step(chip: &Chip, battery: &Battery, chem_id: Option<u16>) -> (bool, String) {
    if Learns::of(chip) == Some(Learns::FullCharge) {
        let text = "the CEDV profile (EMF, C0, R0 and what follows) is programmed with TI's tool, from a log of the cell";
        return (false, text.into());
    }
    let is_lithium = battery.chemistry.family == Family::Lithium;
    let mv = battery.charge_mv.or(battery.chemistry.charge.map(|charge| f64::from(charge.usual)));
    let volts = mv.map_or_else(String::new, |mv| format!(" charged to {mv} mV"));
    let wanted =
        format!("the chemistry of a {} must be of {} cells{volts}", chip.model, battery.chemistry.name);
    let suits = |profile: &Profile| is_lithium && battery.charge_mv.is_none_or(|mv| profile.suits(mv));
    let Some(profile) = chem_id.and_then(|id| Profile::of(chip, id)) else {
        let how = "compare `gauge/chem_id` with TI's list; another one is programmed with TI's tool";
        return (false, format!("{wanted}: {how}"));
    };
    if suits(profile) {
        return (
            false,
            format!("{wanted}, and {}; other cells have other ones in TI's list", profile.told()),
        );
    }
    let how = match Profile::all_of(chip).find(|profile| suits(profile)) {
        Some(other) => format!("0x{:04x} ({}) is for it", other.chem_id, other.name),
        None => "another one is programmed with TI's tool".into(),
    };
    (true, format!("{wanted}, but {}: {how}", profile.told()))
}
