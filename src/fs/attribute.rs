//! The power_supply attributes, with the names, units and signs of the kernel's ABI (`sysfs-class-power`).
//!
//! One row of [`ATTRIBUTES`] is one attribute: its name, and how its text follows from a poll.

use crate::owner::Snapshot;
use ti_gauge::chip::{Chip, Role};

use super::Scales;

/// What attributes are rendered from: one poll of one gauge.
pub(super) struct Reading<'a> {
    pub(super) chip: &'static Chip,
    pub(super) model: &'static str,
    /// `None` while the gauge is gone.
    pub(super) snapshot: Option<&'a Snapshot>,
    pub(super) scales: &'a Scales,
}

/// One attribute. `None` means that the gauge does not have the value, or does not have it now.
struct Row {
    name: &'static str,
    show: Show,
}

enum Show {
    Text(fn(&Reading<'_>) -> Option<&'static str>),
    Number(fn(&Reading<'_>) -> Option<i64>),
}

const fn text(name: &'static str, show: fn(&Reading<'_>) -> Option<&'static str>) -> Row {
    Row { name, show: Show::Text(show) }
}

const fn number(name: &'static str, show: fn(&Reading<'_>) -> Option<i64>) -> Row {
    Row { name, show: Show::Number(show) }
}

/// All attributes, in the order in which `uevent` lists them.
static ATTRIBUTES: &[Row] = &[
    text("type", |_| Some("Battery")),
    text("status", |reading| reading.status()),
    text("present", |reading| Some(if reading.is_present() { "1" } else { "0" })),
    text("health", |reading| reading.health()),
    text("technology", |reading| Some(reading.chip.technology)),
    text("scope", |_| Some("System")),
    number("capacity", |reading| reading.value(Role::Capacity)),
    text("capacity_level", |reading| reading.capacity_level()),
    number("capacity_error_margin", |reading| reading.value(Role::CapacityErrorMargin)),
    number("voltage_now", |reading| reading.micro(Role::VoltageNow, reading.scales.voltage)),
    // Parts with a single current register average it. Monitors look for `current_now`, so the average is
    // shown there too, as by the kernel's driver.
    number("current_now", |reading| {
        reading.current(Role::CurrentNow).or_else(|| reading.current(Role::CurrentAvg))
    }),
    number("current_avg", |reading| reading.current(Role::CurrentAvg)),
    number("charge_now", |reading| reading.micro(Role::ChargeNow, reading.scales.current)),
    number("charge_full", |reading| reading.micro(Role::ChargeFull, reading.scales.current)),
    number("charge_full_design", |reading| reading.micro(Role::ChargeFullDesign, reading.scales.current)),
    number("energy_now", |reading| reading.energy(Role::EnergyNow)),
    number("power_avg", |reading| reading.energy(Role::PowerAvg)),
    // From 0.1 K to 0.1 °C, rounded as in the kernel's driver.
    number("temp", |reading| Some(reading.value(Role::Temp)? - 2731)),
    number("time_to_empty_now", |reading| reading.seconds(Role::TimeToEmptyNow)),
    number("time_to_full_now", |reading| reading.seconds(Role::TimeToFullNow)),
    number("cycle_count", |reading| reading.value(Role::CycleCount)),
    number("state_of_health", |reading| reading.value(Role::StateOfHealth)),
    text("manufacturer", |_| Some("Texas Instruments")),
    text("model_name", |reading| Some(reading.model)),
];

/// The attributes that `uevent` still lists while the gauge is gone.
const LISTED_WHILE_GONE: [&str; 2] = ["type", "present"];

/// One attribute: a row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Attribute(u8);

impl Attribute {
    /// All of them, in the order of `uevent`.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        (0..ATTRIBUTES.len() as u8).map(Self)
    }

    /// The attribute of that file name.
    pub(super) fn by_name(name: &str) -> Option<Self> {
        Self::all().find(|attribute| attribute.name() == name)
    }

    fn row(self) -> &'static Row {
        &ATTRIBUTES[usize::from(self.0)]
    }

    /// File name.
    pub(super) fn name(self) -> &'static str {
        self.row().name
    }

    /// Its text without a newline; `None` where the gauge does not have it, or does not have it now.
    pub(super) fn text(self, reading: &Reading<'_>) -> Option<String> {
        match self.row().show {
            Show::Text(show) => show(reading).map(str::to_string),
            Show::Number(show) => show(reading).map(|number| number.to_string()),
        }
    }
}

impl Reading<'_> {
    fn value(&self, role: Role) -> Option<i64> {
        self.snapshot?.value(self.chip.register(role)?)
    }

    /// A register in thousandths of a unit, in millionths of it.
    fn micro(&self, role: Role, scale: f64) -> Option<i64> {
        Some((self.value(role)? as f64 * 1000.0 * scale).round() as i64)
    }

    fn current(&self, role: Role) -> Option<i64> {
        let current = self.micro(role, self.scales.current)?;
        Some(if self.scales.absolute_current { current.abs() } else { current })
    }

    fn energy(&self, role: Role) -> Option<i64> {
        self.micro(role, self.scales.energy).filter(|_| self.scales.energy_shown)
    }

    /// A register in minutes, of which 65535 means that there is no such time.
    fn seconds(&self, role: Role) -> Option<i64> {
        self.value(role).filter(|&minutes| minutes != 0xffff).map(|minutes| minutes * 60)
    }

    fn has_flag(&self, mask: u16) -> Option<bool> {
        Some(self.value(Role::Flags)? & i64::from(mask) != 0)
    }

    /// Whether the gauge answers and has a battery. Parts without a flag for it have one whenever they answer.
    pub(super) fn is_present(&self) -> bool {
        let mask = self.chip.condition.present;
        self.snapshot.is_some() && (mask == 0 || self.has_flag(mask) == Some(true))
    }

    /// As in the kernel's driver: the sign of the current, and the full flag while no current flows.
    pub(super) fn status(&self) -> Option<&'static str> {
        let condition = &self.chip.condition;
        let current = self.value(Role::CurrentAvg).or_else(|| self.value(Role::CurrentNow))?;
        Some(match current {
            0 if condition.primary => "Not charging",
            0 if self.has_flag(condition.full)? => "Full",
            0 => "Not charging",
            _ if condition.primary => "Discharging",
            1.. => "Charging",
            _ => "Discharging",
        })
    }

    /// In the order of the kernel's driver, where a pack below a threshold of its remaining capacity is `Dead`.
    fn health(&self) -> Option<&'static str> {
        let condition = &self.chip.condition;
        Some(if self.has_flag(condition.overheat)? {
            "Overheat"
        } else if self.has_flag(condition.cold)? {
            "Cold"
        } else if self.has_flag(condition.low | condition.critical)? {
            "Dead"
        } else {
            "Good"
        })
    }

    fn capacity_level(&self) -> Option<&'static str> {
        let condition = &self.chip.condition;
        Some(if self.has_flag(condition.full)? {
            "Full"
        } else if self.has_flag(condition.critical)? {
            "Critical"
        } else if self.has_flag(condition.low)? {
            "Low"
        } else {
            "Normal"
        })
    }
}

/// `uevent`: NAME first, then every attribute that the gauge has, all from one poll.
pub(super) fn uevent(name: &str, reading: &Reading<'_>) -> String {
    let mut lines = format!("POWER_SUPPLY_NAME={}\n", plain(name));
    for attribute in Attribute::all() {
        if reading.snapshot.is_none() && !LISTED_WHILE_GONE.contains(&attribute.name()) {
            continue;
        }
        if let Some(text) = attribute.text(reading) {
            lines += &format!("POWER_SUPPLY_{}={}\n", attribute.name().to_uppercase(), plain(&text));
        }
    }
    lines
}

/// A value for `uevent`. Shells source that file, so whatever they would act on becomes `_`.
pub(super) fn plain(text: &str) -> String {
    let keep = |letter: char| letter.is_ascii_alphanumeric() || "._+-".contains(letter);
    text.chars().map(|letter| if keep(letter) { letter } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// What the kernel's ABI lets a battery report (`Documentation/ABI/testing/sysfs-class-power`).
    const ABI: &[&str] = &[
        "authentic",
        "calibrate",
        "capacity",
        "capacity_alert_max",
        "capacity_alert_min",
        "capacity_error_margin",
        "capacity_level",
        "charge_avg",
        "charge_counter",
        "charge_empty",
        "charge_empty_design",
        "charge_full",
        "charge_full_design",
        "charge_now",
        "charge_type",
        "current_avg",
        "current_max",
        "current_now",
        "cycle_count",
        "energy_avg",
        "energy_empty",
        "energy_empty_design",
        "energy_full",
        "energy_full_design",
        "energy_now",
        "health",
        "internal_resistance",
        "manufacture_day",
        "manufacture_month",
        "manufacture_year",
        "manufacturer",
        "model_name",
        "power_avg",
        "power_now",
        "present",
        "scope",
        "serial_number",
        "state_of_health",
        "status",
        "technology",
        "temp",
        "temp_alert_max",
        "temp_alert_min",
        "temp_ambient",
        "temp_max",
        "temp_min",
        "time_to_empty_avg",
        "time_to_empty_now",
        "time_to_full_avg",
        "time_to_full_now",
        "type",
        "voltage_avg",
        "voltage_boot",
        "voltage_max",
        "voltage_max_design",
        "voltage_min",
        "voltage_min_design",
        "voltage_now",
        "voltage_ocv",
    ];

    #[test]
    fn every_attribute_is_one_of_the_kernels() {
        for attribute in Attribute::all() {
            assert!(ABI.contains(&attribute.name()), "{}", attribute.name());
        }
    }

    #[test]
    fn names_are_unique() {
        let names: BTreeSet<_> = Attribute::all().map(Attribute::name).collect();
        assert_eq!(names.len(), ATTRIBUTES.len());
        assert!(LISTED_WHILE_GONE.iter().all(|name| names.contains(name)));
    }
}
