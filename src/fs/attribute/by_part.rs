// SPDX-License-Identifier: MIT

//! docs/attributes.tsv, where each attribute of each part comes from: it lists what the parts' tables have, and simulated
//! gauges show the results of its conversions.
//!
//! After an intended change, run the tests once with GAUGEFS_GOLDEN=write and read the difference before you commit it.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use super::tests::{open, show, turn};
use super::*;
use gauge_owner::operations as op;
use gauge_owner::rig::Rig;
use ti_gauge::chip::{FLAT, Parameter, Subclass};

/// Numeric attributes: the roles that they may follow from, in order of preference, how many of their units make one of
/// the role, and what is subtracted.
const NUMBERS: &[(&str, &[Role], i64, i64)] = &[
    ("capacity", &[Role::Capacity], 1, 0),
    ("capacity_error_margin", &[Role::CapacityErrorMargin], 1, 0),
    ("voltage_now", &[Role::VoltageNow], 1000, 0),
    ("voltage_min_design", &[Role::VoltageMinDesign], 1000, 0),
    ("voltage_max_design", &[Role::VoltageMaxDesign], 1000, 0),
    ("current_now", &[Role::CurrentNow, Role::CurrentAvg], 1000, 0),
    ("current_avg", &[Role::CurrentAvg], 1000, 0),
    ("charge_now", &[Role::ChargeNow], 1000, 0),
    ("charge_full", &[Role::ChargeFull], 1000, 0),
    ("charge_full_design", &[Role::ChargeFullDesign], 1000, 0),
    ("charge_counter", &[Role::ChargeCounter], 1000, 0),
    ("constant_charge_voltage", &[Role::ChargeVoltage], 1000, 0),
    ("constant_charge_current", &[Role::ChargeCurrent], 1000, 0),
    ("energy_now", &[Role::EnergyNow], 1000, 0),
    ("energy_full", &[Role::EnergyFull], 1000, 0),
    ("energy_full_design", &[Role::EnergyFullDesign], 1000, 0),
    ("power_avg", &[Role::PowerAvg], 1000, 0),
    ("temp", &[Role::Temp], 1, 2731),
    ("internal_resistance", &[Role::InternalResistance], 1000, 0),
    ("time_to_empty_now", &[Role::TimeToEmptyNow, Role::TimeToEmptyAvg], 60, 0),
    ("time_to_empty_avg", &[Role::TimeToEmptyAvg], 60, 0),
    ("time_to_full_now", &[Role::TimeToFullNow], 60, 0),
    ("time_to_full_avg", &[Role::TimeToFullAvg], 60, 0),
    ("cycle_count", &[Role::CycleCount], 1, 0),
    ("state_of_health", &[Role::StateOfHealth], 1, 0),
];

/// Attributes that follow from a value in another way, named by the table.
const OTHERS: &[(&str, Role, &str)] = &[
    ("technology", Role::Technology, "the kernel's name for it"),
    ("serial_number", Role::SerialNumber, "four hexadecimal digits"),
    ("manufacture_year", Role::ManufactureDate, "1980 + bits 15 to 9"),
    ("manufacture_month", Role::ManufactureDate, "bits 8 to 5"),
    ("manufacture_day", Role::ManufactureDate, "bits 4 to 0"),
];

/// Attributes that every part has, or that follow from several values.
const REST: &[&str] = &["type", "status", "present", "scope", "manufacturer", "model_name"];

/// A part's value behind an attribute.
enum Feed {
    Register(&'static Register),
    Stored(&'static Subclass, &'static Parameter),
}

fn source(chip: &Chip, roles: &[Role]) -> Option<(Role, Feed)> {
    roles.iter().find_map(|&role| {
        let stored = || chip.stored(role).map(|(subclass, parameter)| Feed::Stored(subclass, parameter));
        Some((role, chip.register(role).map(Feed::Register).or_else(stored)?))
    })
}

fn place(subclass: &Subclass, parameter: &Parameter) -> String {
    match subclass.id {
        FLAT => format!("`df/flash/0x{:04x}`", parameter.offset),
        id => format!("`df/{id}/{}`", parameter.offset),
    }
}

impl Feed {
    fn name(&self) -> String {
        match self {
            Feed::Register(register) => {
                let code = register.source.command().expect("a standard command");
                format!("{}(), 0x{code:02X}", register.name)
            }
            Feed::Stored(subclass, parameter) => {
                format!("{}, {}", parameter.name, place(subclass, parameter))
            }
        }
    }

    /// The unit, and how a reading becomes the attribute.
    fn conversion(&self, chip: &Chip, role: Role, units: i64, less: i64) -> String {
        let (unit, (numerator, denominator), discharge) = match self {
            Feed::Register(register) => match register.other.filter(|other| other.role == role) {
                Some(other) => ("10 mWh in CAPACITY_MODE:", other.step, false),
                None if register.other.is_some() => ("mAh", register.step, false),
                None => (register.unit, register.step, register.discharge),
            },
            Feed::Stored(_, parameter) => (parameter.unit, (1, 1), false),
        };
        let sign = if discharge { -1 } else { 1 };
        let (numerator, denominator) = (sign * units * numerator, denominator);
        let common = divisor(numerator.abs(), denominator);
        let mut text = unit.to_string();
        if (numerator, denominator) != (common, common) {
            write!(text, " × {}", numerator / common).expect("a string");
        }
        if denominator != common {
            write!(text, " / {}", denominator / common).expect("a string");
        }
        if less != 0 {
            write!(text, " - {less}").expect("a string");
        }
        if discharge {
            text += ", while discharging";
        }
        if let Some((subclass, parameter)) = chip.stored(Role::Cells) {
            let cells = place(subclass, parameter);
            match role {
                Role::VoltageMinDesign | Role::VoltageMaxDesign => {
                    write!(text, " × {cells}").expect("a string");
                }
                Role::ChargeVoltage => write!(text, " (× {cells} if it is a cell's)").expect("a string"),
                _ => {}
            }
        }
        if let Feed::Register(Register { positive: 1.., .. }) = self {
            text += ", negative without [CHGS]";
        }
        let text = text.trim_start().to_string();
        if text.is_empty() { "as read".into() } else { text }
    }
}

/// Readings without a meaning, and the source that says so.
fn absent(chip: &Chip, role: Role, source: &Feed) -> Option<(String, &'static str)> {
    let (values, register) = match source {
        Feed::Register(register) => (register.values, Some(*register)),
        Feed::Stored(..) => (role.values(), None),
    };
    let (zero, end) = (values.least == 1, values.greatest);
    let mut readings: Vec<String> = zero.then(|| "0".into()).into_iter().collect();
    readings.extend((end < i64::MAX).then(|| match end {
        0xfffe => "65535".into(),
        end => format!("above {end}"),
    }));
    if let Some(source) = register.and_then(|register| register.validity) {
        let by = chip.register_at(source).expect("a register").name;
        readings.push(format!("any while {by}() is 0"));
    }
    if register.is_some_and(|register| register.empty != 0) {
        readings.push("0 without [EDVF]".into());
    }
    (!readings.is_empty()).then(|| (readings.join(", "), values.source))
}

fn divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { divisor(b, a % b) }
}

/// Words decided by flags, each with the names of its bits.
fn words(chip: &Chip, words: &[(u32, &str)]) -> Option<(String, String)> {
    let flags = chip.register(Role::Flags)?;
    let names = |mask: u32| {
        let set = flags.bits.iter().filter(move |bit| bit.mask & mask != 0);
        set.map(|bit| format!(" [{}]", bit.name)).collect::<String>()
    };
    let words: Vec<_> = words.iter().filter(|(mask, _)| *mask != 0).collect();
    let listed = words.iter().map(|(mask, word)| format!("`{word}`{}", names(*mask)));
    let listed = listed.collect::<Vec<_>>().join(", ");
    (!words.is_empty()).then(|| (Feed::Register(flags).name(), listed))
}

/// Source and conversion of a part's attribute.
fn entry(chip: &Chip, attribute: &str) -> Option<(String, String)> {
    let condition = &chip.condition;
    match attribute {
        "health" => return words(chip, &health(condition)),
        "capacity_level" => return words(chip, &level(condition)),
        _ => {}
    }
    if let Some((_, role, conversion)) = OTHERS.iter().find(|(name, ..)| *name == attribute) {
        return source(chip, &[*role]).map(|(_, source)| (source.name(), (*conversion).to_string()));
    }
    let (_, roles, units, less) = NUMBERS.iter().find(|(name, ..)| *name == attribute)?;
    let (role, source) = source(chip, roles)?;
    Some((source.name(), source.conversion(chip, role, *units, *less)))
}

/// The table, one line for each attribute of each part.
fn table() -> String {
    let mut text = "part\tattribute\tfrom\tconversion\treadings that are no value\tby\n".to_string();
    let mut followed = BTreeSet::new();
    for chip in Chip::all() {
        for name in Attribute::all().map(Attribute::name).filter(|name| !REST.contains(name)) {
            let Some((from, conversion)) = entry(chip, name) else { continue };
            followed.insert(name);
            let number = NUMBERS.iter().find(|(number, ..)| *number == name);
            let no_value = number.and_then(|(_, roles, ..)| {
                let (role, source) = source(chip, roles)?;
                absent(chip, role, &source)
            });
            let (readings, by) = no_value.unwrap_or_default();
            let cells =
                [chip.name, name, &from, &conversion, &readings, by].map(|cell| cell.replace('`', ""));
            writeln!(text, "{}", cells.join("\t").trim_end()).expect("a string");
        }
    }
    let all: BTreeSet<_> =
        Attribute::all().map(Attribute::name).filter(|name| !REST.contains(name)).collect();
    assert_eq!(followed, all, "these follow from something; all");
    text
}

#[test]
fn the_table_by_part_is_what_the_tables_of_the_parts_have() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/attributes.tsv");
    let now = table();
    if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
        std::fs::write(&path, now).expect("the table");
        return;
    }
    let then = std::fs::read_to_string(&path).expect("the table");
    assert!(now == then, "docs/attributes.tsv differs; if that is intended, GAUGEFS_GOLDEN=write\n{now}");
}

#[test]
fn every_attribute_has_a_place_in_the_table_by_part() {
    let numbers = NUMBERS.iter().map(|(name, ..)| *name);
    let listed = numbers.chain(OTHERS.iter().map(|(name, ..)| *name)).chain(REST.iter().copied());
    let listed: BTreeSet<_> = listed.chain(["health", "capacity_level"]).collect();
    assert_eq!(Attribute::all().map(Attribute::name).collect::<BTreeSet<_>>(), listed);
}

/// The result of a conversion, such as `mV × 1000` of 3700.
fn convert(conversion: &str, reading: i64) -> i64 {
    let after = |sign: &str| {
        let digits = conversion.split_once(sign)?.1;
        let end =
            digits.find(|letter: char| letter != '-' && !letter.is_ascii_digit()).unwrap_or(digits.len());
        digits[..end].parse::<i64>().ok()
    };
    reading * after(" × ").unwrap_or(1) / after(" / ").unwrap_or(1) - after(" - ").unwrap_or(0)
}

/// Reads the places of data flash that attributes need, as a reader of `df` would.
pub(super) fn read_places(rig: &mut Rig) {
    let chip = rig.handle.chip();
    let holds = |row: &Subclass, (id, offset): (u8, u16)| {
        row.id == id && (row.start()..row.start() + row.length).contains(&offset)
    };
    let wanted = |row: &Subclass| chip.places().any(|place| holds(row, place));
    let rows = chip.subclasses.iter().enumerate().filter(|(_, row)| wanted(row));
    let rows: Vec<_> = rows.map(|(index, _)| index).collect();
    if !rows.is_empty() {
        rig.ask(&op::READ, rows).expect("the default key");
    }
}

#[test]
fn simulated_gauges_show_what_the_conversions_yield() {
    let mut compared = BTreeSet::new();
    for chip in Chip::all() {
        let mut rig = open(chip.name);
        turn(&rig, "speed", "20");
        let loads: &[&str] = if chip.condition.primary.is_some() { &["50"] } else { &["500", "-500"] };
        for load in loads {
            turn(&rig, "load_ma", load);
            if chip.registers.iter().any(|register| register.other.is_some()) {
                turn(&rig, "battery_mode", if *load == "500" { "0x0000" } else { "0x8000" });
            }
            for _ in 0..12 {
                rig.poll_after(Duration::from_secs(1));
            }
            read_places(&mut rig);
            let snapshot = rig.handle.published().snapshot.clone().expect("a poll");
            for (name, roles, ..) in NUMBERS {
                let Some((_, conversion)) = entry(chip, name) else {
                    assert_eq!(show(&rig, name), None, "{}: {name}", chip.name);
                    continue;
                };
                let Some(shown) = show(&rig, name) else { continue };
                let reading = match source(chip, roles).expect("a source").1 {
                    Feed::Register(register) => snapshot.value(register),
                    Feed::Stored(subclass, parameter) => {
                        let place = (subclass.id, parameter.offset);
                        match rig.handle.kept_value(place, parameter.kind) {
                            Some(Value::Int(number)) => Some(number),
                            _ => None,
                        }
                    }
                };
                let expected = convert(&conversion, reading.expect("it was read"));
                let shown: i64 = shown.parse().expect("a number");
                let same = if conversion.contains("negative without") {
                    shown.abs() == expected.abs()
                } else {
                    shown == expected
                };
                assert!(same, "{}: {name} is {shown}, {conversion} yields {expected}", chip.name);
                compared.insert(*name);
            }
        }
    }
    // The simulated gauge of primary cells is not in the mode that measures resistance.
    let missing: Vec<_> =
        NUMBERS.iter().map(|(name, ..)| *name).filter(|name| !compared.contains(name)).collect();
    assert_eq!(missing, ["internal_resistance"]);
}
