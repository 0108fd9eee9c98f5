// SPDX-License-Identifier: MIT

//! What the gauge has learned of its pack, and the pack's age.

use super::capacity::is_stale;
use super::{Facts, Lacking, Row, Verdict, found_if};
use crate::check::history::learned;
use crate::chip::{Role, Source};
use crate::learning::{Learned, Learns, Spoiled};

const MOST_WARMTH: &[&str] = &["Lifetime Max Temp"];
const TOO_WARM: &[&str] = &["OT Dsg"];
const HIGHEST: &[&str] = &["Lifetime Max Pack Voltage"];
const LOWEST: &[&str] = &["Lifetime Min Pack Voltage"];
const TOO_HIGH: &[&str] = &["Cell BH Set Volt Threshold"];
/// A pack that was once below that share of Terminate Voltage was discharged by something that does not end there.
const DEEP: f64 = 0.8;
/// What a cell loses in mV when a current flows that empties it in an hour: new ones lose 50 to 200 mV.
const LOSS_MV: f64 = 500.0;
/// A condition that has not been met for so many seconds is named.
const LONG_S: f64 = 3600.0;

/// What learning needs and has not seen since.
fn unmet(facts: &Facts<'_>) -> String {
    let long = facts.history.unmet.iter().flatten().filter(|(_, seconds)| *seconds >= LONG_S);
    long.map(|(what, seconds)| format!("; for {:.0} h not seen: {what}", seconds / 3600.0)).collect()
}

pub(super) fn not_learned(facts: &Facts<'_>) -> Verdict {
    found_if(learned(facts)? == Learned::Nothing, || format!("Qmax has not been learned{}", unmet(facts)))
}

pub(super) fn never_learned(facts: &Facts<'_>) -> Verdict {
    let cycles = facts.polled(Role::CycleCount)?;
    found_if(learned(facts)? == Learned::Nothing && cycles >= 200.0, || {
        format!("CycleCount() is {cycles}, and Qmax has not been learned{}", unmet(facts))
    })
}

pub(super) fn not_enabled(facts: &Facts<'_>) -> Verdict {
    let bit = facts.chip.control_status.iter().find(|bit| bit.name == "QEN");
    let bit = bit.filter(|_| Learns::of(facts.chip) == Some(Learns::ImpedanceTrack)).ok_or(Lacking::Never)?;
    found_if(facts.word(Source::Status)? & bit.mask == 0, || "[QEN] is clear".into())
}

pub(super) fn learning_disturbed(facts: &Facts<'_>) -> Verdict {
    let spoiled = facts.history.spoiled.filter(|(why, _)| *why != Spoiled::NotEnabled);
    Ok(spoiled.map(|(why, seconds)| format!("for {:.1} h: {why}", seconds / 3600.0)))
}

pub(super) fn worn(facts: &Facts<'_>, from: f64, below: f64) -> Verdict {
    let register =
        facts.chip.register(Role::StateOfHealth).filter(|_| facts.chip.condition.primary.is_none());
    let register = register.ok_or(Lacking::Never)?;
    let health = facts.predicted(Role::StateOfHealth)?;
    // It is a share of the design capacity, of which those rules say more.
    if super::full_capacity(facts).is_ok_and(|found| found.is_some()) || is_stale(facts) {
        return Ok(None);
    }
    let is_ready = register.validity.is_none_or(|source| facts.word(source).is_ok_and(|word| word != 0));
    found_if(is_ready && health > from && health <= below && health > 0.0, || {
        format!("StateOfHealth() is {health} %")
    })
}

pub(super) fn many_cycles(facts: &Facts<'_>) -> Verdict {
    let cycles = facts.polled(Role::CycleCount)?;
    found_if(cycles >= 500.0, || format!("CycleCount() is {cycles}"))
}

pub(super) fn was_too_warm(facts: &Facts<'_>) -> Verdict {
    let (most, limit) = (facts.number(facts.named(MOST_WARMTH)?)?, facts.number(facts.named(TOO_WARM)?)?);
    found_if(limit > 0.0 && most > limit, || {
        format!("Lifetime Max Temp is {:.1} °C, OT Dsg {:.1} °C", most / 10.0, limit / 10.0)
    })
}

pub(super) fn learning_lost(facts: &Facts<'_>) -> Verdict {
    let name = |learned| match learned {
        Learned::Nothing => "nothing",
        Learned::Qmax => "Qmax",
        Learned::All => "Qmax and Ra",
    };
    let lost = facts.history.unlearned;
    Ok(lost.map(|(from, to)| format!("{} were learned, and now {}", name(from), name(to))))
}

/// A row of the lifetime data in mV for each cell; `None` while it is as shipped.
fn recorded(facts: &Facts<'_>, names: &[&str]) -> Result<Option<f64>, Lacking> {
    let row: Row = facts.named(names)?;
    let (value, default) = (facts.number(row)?, facts.default(row).ok_or(Lacking::Never)?);
    let step = if row.1.unit == "20mV" { 20.0 } else { 1.0 };
    Ok(Some(value * step * facts.scale()? / facts.cells()?).filter(|_| value != default))
}

pub(super) fn lifetime_voltage(facts: &Facts<'_>) -> Verdict {
    let (high, low) = (recorded(facts, HIGHEST)?, recorded(facts, LOWEST)?);
    let (most, least) =
        (facts.number(facts.named(TOO_HIGH)?)?, facts.number(facts.named(super::TERMINATE)?)?);
    let mut found = Vec::new();
    if let Some(high) = high.filter(|high| most > 0.0 && *high > most) {
        found.push(format!("once {high:.0} mV for each cell, Cell BH Set Volt Threshold {most} mV"));
    }
    if let Some(low) = low.filter(|low| *low < least * DEEP) {
        found.push(format!("once {low:.0} mV for each cell, Terminate Voltage {least} mV"));
    }
    found_if(!found.is_empty(), || found.join(", "))
}

pub(super) fn resistance(facts: &Facts<'_>) -> Verdict {
    let loss = facts.history.loss.ok_or(Lacking::Never)? / facts.cells()?;
    found_if(loss >= LOSS_MV, || {
        format!("by steps of the current, a cell loses {loss:.0} mV when it is emptied within an hour")
    })
}
