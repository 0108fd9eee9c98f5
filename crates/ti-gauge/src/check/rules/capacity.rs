// SPDX-License-Identifier: MIT

//! The full charge capacity against the design capacity. It follows from Qmax, which a write of Design Capacity leaves as it
//! is: the gauge has the old one until it predicts anew or learns, and that is no fault of the configuration.

use super::{Facts, Lacking, Verdict, found_if};
use crate::check::history::{Configured, learned};
use crate::chip::Role;
use crate::codec::FREEZING;
use crate::learning::Learned;

/// The full charge capacity that a battery can have, as a share of the design capacity: a worn-out one, and a new one of
/// another make. Max % Default Qmax is 120 %, and below a third no pack is still used.
const FULL: (f64, f64) = (1.0 / 3.0, 1.5);
/// The remaining capacity may be that much above the full one, until the gauge has predicted anew.
const REMAINING: f64 = 1.1;
/// A capacity that differs by less from an earlier one is still that one: temperature and load change it as well.
const SAME: f64 = 0.1;
/// The full charge capacity in mAh that a gauge believes before it has learned.
const QMAX: &[&str] = &["Qmax Cell 0"];
/// The unit of a Qmax that is a share of the design capacity.
const SHARE: &str = "Num";

/// FullChargeCapacity() and Design Capacity, if no battery has the one with the other.
fn impossible(facts: &Facts<'_>) -> Result<Option<(f64, f64)>, Lacking> {
    let (full, design) = (facts.predicted(Role::ChargeFull)?, facts.design()?);
    Ok(Some((full, design)).filter(|_| design > 0.0 && !can_have(facts, full, design)))
}

/// Whether a battery of that design capacity can have that full charge capacity.
fn can_have(facts: &Facts<'_>, full: f64, design: f64) -> bool {
    let is_cold = facts.polled(Role::Temp).is_ok_and(|tenths| tenths < FREEZING as f64);
    full > 0.0 && (full >= design * FULL.0 || is_cold) && full <= design * FULL.1
}

pub(super) fn full_capacity(facts: &Facts<'_>) -> Verdict {
    let found = impossible(facts)?.filter(|_| waits(facts).is_none());
    Ok(found
        .map(|(full, design)| format!("FullChargeCapacity() is {full} mAh, Design Capacity {design} mAh")))
}

pub(super) fn full_capacity_stale(facts: &Facts<'_>) -> Verdict {
    let found = impossible(facts)?.zip(waits(facts));
    Ok(found.map(|((full, design), why)| {
        format!("FullChargeCapacity() is {full} mAh, Design Capacity {design} mAh; {why}")
    }))
}

fn is_same(capacity: f64, before: f64) -> bool {
    (capacity - before).abs() <= before * SAME
}

pub(super) fn is_stale(facts: &Facts<'_>) -> bool {
    stale(facts).is_some()
}

/// Why the full charge capacity is not yet of the battery that was configured.
fn stale(facts: &Facts<'_>) -> Option<String> {
    let full = facts.predicted(Role::ChargeFull).ok().filter(|full| *full > 0.0)?;
    since_write(facts, full).or_else(|| of_default(facts, full))
}

/// Why the full charge capacity is not yet of the battery that was configured, for as long as it takes. A worn pack may have
/// had that capacity before the write as well, so it is told again.
fn waits(facts: &Facts<'_>) -> Option<String> {
    stale(facts).or_else(|| until_learned(facts))
}

/// It is of the battery that was configured before. A gauge may predict or learn it anew just before it takes the other design
/// capacity, so for an hour it may be any that the former battery can have.
fn since_write(facts: &Facts<'_>, full: f64) -> Option<String> {
    let Configured { seconds, design, full: before, .. } = facts.history.configured?;
    let (former, change) = match design {
        Some((from, to)) => (from, went(from, to)),
        None if facts.chip.register(Role::ChargeFullDesign).is_none() => {
            (before?, "since data flash was written".into())
        }
        None => return None,
    };
    let is_old = can_have(facts, full, former) || before.is_some_and(|before| is_same(full, before));
    is_old.then(|| format!("the first is still of the battery before, {change} {}", ago(seconds)))
}

/// A part whose Qmax is no share of Design Capacity has the old one until it learns. One that had learned had measured it.
fn until_learned(facts: &Facts<'_>) -> Option<String> {
    let Configured { seconds, design, full: before, .. } = facts.history.resized?;
    let ((from, to), before) = design.zip(before)?;
    let follows = facts.named(QMAX).is_ok_and(|row| row.1.unit == SHARE);
    let is_measured = learned(facts).is_ok_and(|learned| learned > Learned::Nothing);
    let full = facts.predicted(Role::ChargeFull).ok()?;
    (full > 0.0 && !follows && !is_measured && is_same(full, before))
        .then(|| format!("the first has not changed {} {}", went(from, to), ago(seconds)))
}

fn went(from: f64, to: f64) -> String {
    format!("since it went from {from} to {to} mAh")
}

fn ago(seconds: f64) -> String {
    format!("{:.0} min ago", seconds / 60.0)
}

/// It is the Qmax of the part as shipped: nothing has been learned, and Design Capacity is another one.
fn of_default(facts: &Facts<'_>, full: f64) -> Option<String> {
    let row = facts.named(QMAX).ok().filter(|row| row.1.unit == "mAh")?;
    let default = facts.default(row)?;
    let is_default = match facts.number(row) {
        Ok(qmax) => qmax == default,
        Err(_) => full <= default && full >= default * (1.0 - SAME),
    };
    let is_configured = facts.design().is_ok_and(|design| design != default);
    (is_default && is_configured && full <= default && learned(facts) == Ok(Learned::Nothing))
        .then(|| format!("{} is {default} mAh as shipped, and nothing has been learned", row.1.name))
}

pub(super) fn remaining_above_full(facts: &Facts<'_>) -> Verdict {
    let (now, full) = (facts.predicted(Role::ChargeNow)?, facts.predicted(Role::ChargeFull)?);
    // After a write the one may be predicted anew before the other.
    let before = facts.history.configured.and_then(|before| before.now.zip(before.full));
    let is_old = before.is_some_and(|before| is_same(now, before.0) && !is_same(full, before.1));
    found_if(full > 0.0 && now > full * REMAINING && !is_old, || {
        format!("RemainingCapacity() is {now} mAh, FullChargeCapacity() {full} mAh")
    })
}
