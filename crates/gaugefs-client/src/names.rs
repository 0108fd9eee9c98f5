// SPDX-License-Identifier: MIT

//! The files of a gauge's folder that have values, and the units of their numbers.

use ti_gauge::chip::{Bit, Chip, Tier, snake_case};
use ti_gauge::gauge::Statistics;

/// An attribute: a file of the folder itself, named as in the kernel's ABI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Its name.
    pub name: &'static str,
    /// What its text is.
    pub kind: Kind,
}

/// What the text of an attribute is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A text, such as `Charging`.
    Text,
    /// A decimal number in this unit; empty for no unit.
    Number(&'static str),
    /// A word in four hexadecimal digits, as the kernel's drivers show serial numbers.
    Hex,
}

impl Attribute {
    /// The unit of the number, or an empty text.
    pub fn unit(&self) -> &'static str {
        match self.kind {
            Kind::Number(unit) => unit,
            Kind::Text | Kind::Hex => "",
        }
    }

    /// Whether the text is a decimal number.
    pub fn is_number(&self) -> bool {
        matches!(self.kind, Kind::Number(_))
    }
}

const fn text(name: &'static str) -> Attribute {
    Attribute { name, kind: Kind::Text }
}

const fn number(name: &'static str, unit: &'static str) -> Attribute {
    Attribute { name, kind: Kind::Number(unit) }
}

static ATTRIBUTES: &[Attribute] = &[
    text("type"),
    text("status"),
    number("present", ""),
    text("health"),
    text("technology"),
    text("scope"),
    number("capacity", "%"),
    text("capacity_level"),
    number("capacity_error_margin", "%"),
    number("voltage_now", "uV"),
    number("voltage_min_design", "uV"),
    number("voltage_max_design", "uV"),
    number("current_now", "uA"),
    number("current_avg", "uA"),
    number("charge_now", "uAh"),
    number("charge_full", "uAh"),
    number("charge_full_design", "uAh"),
    number("charge_counter", "uAh"),
    number("constant_charge_voltage", "uV"),
    number("constant_charge_current", "uA"),
    number("energy_now", "uWh"),
    number("energy_full", "uWh"),
    number("energy_full_design", "uWh"),
    number("power_avg", "uW"),
    number("temp", "0.1°C"),
    number("internal_resistance", "uohm"),
    number("time_to_empty_now", "s"),
    number("time_to_empty_avg", "s"),
    number("time_to_full_now", "s"),
    number("time_to_full_avg", "s"),
    number("cycle_count", ""),
    number("state_of_health", "%"),
    text("manufacturer"),
    text("model_name"),
    Attribute { name: "serial_number", kind: Kind::Hex },
    number("manufacture_year", ""),
    number("manufacture_month", ""),
    number("manufacture_day", ""),
];

/// Files of `gauge/` that every part may have and that have their own text, with the units of their numbers.
static FILES: &[(&str, &str)] = &[
    ("control_status", ""),
    ("device_type", ""),
    ("firmware_version", ""),
    ("hardware_version", ""),
    ("chem_id", ""),
    ("itpor", ""),
    ("seal", ""),
    ("control", ""),
    ("authenticate", ""),
    ("auth_order", ""),
    ("check", ""),
    ("owed", ""),
    ("settle", ""),
    ("learned", ""),
    ("report", ""),
    ("voltage_scale", ""),
    ("current_scale", ""),
    ("charge_scale", ""),
    ("energy_scale", ""),
    ("pec", ""),
    ("questions", ""),
    ("permanent_failure", ""),
    ("presence", ""),
    ("poll_interval", "s"),
    ("age_ms", "ms"),
    ("last_error", ""),
    ("last_error_facts", ""),
    ("progress", ""),
    ("values", ""),
];

/// A file of `gauge/` with its own text.
#[derive(Clone, Debug)]
pub struct File {
    /// Its path in `gauge/`.
    pub name: String,
    /// The unit of the number, or an empty text.
    pub unit: &'static str,
    /// Names of bits, for a register of flags.
    pub bits: &'static [Bit],
}

/// All attributes, in the order of `uevent`.
pub fn attributes() -> impl Iterator<Item = Attribute> {
    ATTRIBUTES.iter().copied()
}

/// The attribute of that name.
pub fn attribute(name: &str) -> Option<Attribute> {
    attributes().find(|attribute| attribute.name == name)
}

/// The files of `gauge/` with their own texts that every part may have.
pub fn fixed_files() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name)
}

/// The files of `gauge/` with their own texts, for one chip or for all: a register is listed once per unit.
pub fn files() -> impl Iterator<Item = File> {
    let plain = |name: String, unit| File { name, unit, bits: &[] };
    let fixed = FILES.iter().map(move |&(name, unit)| plain(name.to_string(), unit));
    let counters = Statistics::default().list();
    let counters = counters.into_iter().map(move |(name, _)| plain(format!("statistics/{name}"), ""));
    let of_chips = Chip::all().flat_map(move |chip| {
        let registers = chip.registers.iter().filter(|register| register.tier != Tier::Window);
        let registers = registers.flat_map(move |register| {
            let name = snake_case(register.name);
            let number = plain(format!("registers/{name}"), register.unit);
            let flags = (!register.bits.is_empty()).then_some(File { name, unit: "", bits: register.bits });
            flags.into_iter().chain([number])
        });
        let status = File { name: "control_status".to_string(), unit: "", bits: chip.control_status };
        registers.chain([status])
    });
    fixed.chain(counters).chain(of_chips)
}

/// The unit of a file, or an empty text; `None` for an unknown file, and for a register, where parts differ.
pub(crate) fn unit(file: &str) -> Option<&'static str> {
    match file.strip_prefix("gauge/") {
        Some(name) => FILES.iter().find(|(known, _)| *known == name).map(|(_, unit)| *unit),
        None => attribute(file).map(|attribute| attribute.unit()),
    }
}

/// A serial number for people, from the attribute of it.
pub(crate) fn serial(attribute: &str) -> String {
    format!("0x{}", attribute.trim())
}
