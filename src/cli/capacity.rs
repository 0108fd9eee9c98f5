// SPDX-License-Identifier: MIT

//! Values that belong to the old design capacity and stay when it changes.

use crate::error::shown;
use crate::output::say;
use gaugefs_client::Gauge;
use ti_gauge::chip::{Chip, Row};
use ti_gauge::image::{Difference, Image};
use ti_gauge::notation;
use ti_gauge::quantity::with_unit;
use ti_gauge::unit;
use ti_gauge::value::Value;

const CAPACITY: &str = "Design Capacity";
const ENERGY: &str = "Design Energy";

/// Whether an image has a value for such a parameter.
fn has(wanted: &[&Image], is_it: impl Fn(&str) -> bool) -> bool {
    wanted.iter().any(|image| image.entries.iter().any(|entry| is_it(entry.parameter.name)))
}

/// The row of the design energy, if a design capacity is wanted without it.
pub(super) fn energy(chip: &'static Chip, wanted: &[&Image]) -> Option<Row> {
    let row = chip.rows().find(|(_, row)| row.name == ENERGY);
    row.filter(|_| has(wanted, |name| name == CAPACITY) && !has(wanted, |name| name == ENERGY))
}

/// Says what a change of the design capacity leaves behind. `stored` has the design energy, if the part has one.
pub(super) fn say_what_stays(gauge: &Gauge, stored: &Image, wanted: &[&Image], changes: &[Difference<'_>]) {
    let Some(change) = changes.iter().find(|change| change.new.parameter.name == CAPACITY) else { return };
    let (folder, chip) = (shown(gauge.folder()), stored.chip);
    if let Some((_, energy)) = energy(chip, wanted)
        && let Some(entry) = stored.entries.iter().find(|entry| std::ptr::eq(energy, entry.parameter))
        && let (Value::Int(kept), Value::Int(old), Value::Int(new)) =
            (&entry.value, &change.old.value, &change.new.value)
        && *old > 0
    {
        // Half of the old capacity, for rounding.
        let fits = (kept * new + old / 2) / old;
        let of_capacity = |value: &i64| with_unit(&value.to_string(), unit::shown(change.new.parameter));
        let remedy = match notation::check(entry.parameter, &Value::Int(fits)) {
            Ok(()) => format!("gaugefs set {folder} {}={fits} fits {}", stored.name(entry), of_capacity(new)),
            Err(_) => format!("{fits} would fit {}, which it cannot hold", of_capacity(new)),
        };
        let kept = with_unit(&kept.to_string(), unit::shown(entry.parameter));
        say(format_args!("gauge {folder}: {ENERGY} stays {kept}, which fits {}: {remedy}", of_capacity(old)));
    }
    let is_learned = |name: &str| name.starts_with("Qmax Cell") || name.starts_with("Learned Full Charge");
    let learned = chip.rows().find(|(_, row)| row.learned && is_learned(row.name));
    if let Some((_, learned)) = learned.filter(|_| !has(wanted, is_learned)) {
        let name = learned.name;
        say(format_args!(
            "gauge {folder}: {name} is learned later, from a whole cycle: gaugefs learn {folder}"
        ));
    }
}
