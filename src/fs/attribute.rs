//! The power_supply attributes: names, units and signs of the kernel's ABI (`sysfs-class-power`), taken
//! from one Snapshot.

use crate::chip::{Chip, Role};
use crate::poll::Snapshot;

use super::Scales;

/// One attribute, in the order of `uevent`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Attribute {
    /// `Battery`.
    Type,
    /// 1, or 0 while the gauge is gone.
    Present,
    /// Charging, Discharging, Full or Not charging.
    Status,
    /// Good, Overheat, Cold or Dead.
    Health,
    /// Chemistry, as far as the part allows only one.
    Technology,
    /// `System`.
    Scope,
    /// `Texas Instruments`.
    Manufacturer,
    /// The part.
    ModelName,
    /// Normal, Low, Critical or Full.
    CapacityLevel,
    /// A number that one register gives.
    Measured(Role),
}

/// All attributes but `uevent`, in its order.
pub(super) const ALL: &[Attribute] = &[
    Attribute::Type,
    Attribute::Status,
    Attribute::Present,
    Attribute::Health,
    Attribute::Technology,
    Attribute::Scope,
    Attribute::Measured(Role::Capacity),
    Attribute::CapacityLevel,
    Attribute::Measured(Role::CapacityErrorMargin),
    Attribute::Measured(Role::VoltageNow),
    Attribute::Measured(Role::CurrentNow),
    Attribute::Measured(Role::CurrentAvg),
    Attribute::Measured(Role::ChargeNow),
    Attribute::Measured(Role::ChargeFull),
    Attribute::Measured(Role::ChargeFullDesign),
    Attribute::Measured(Role::EnergyNow),
    Attribute::Measured(Role::PowerAvg),
    Attribute::Measured(Role::Temp),
    Attribute::Measured(Role::TimeToEmptyNow),
    Attribute::Measured(Role::TimeToFullNow),
    Attribute::Measured(Role::CycleCount),
    Attribute::Measured(Role::StateOfHealth),
    Attribute::Manufacturer,
    Attribute::ModelName,
];

/// What an attribute is rendered from.
pub(super) struct Source<'a> {
    pub(super) chip: &'static Chip,
    pub(super) model: &'static str,
    /// `None` while the gauge is gone.
    pub(super) snapshot: Option<&'a Snapshot>,
    pub(super) scales: &'a Scales,
}

impl Attribute {
    /// File name.
    pub fn name(self) -> &'static str {
        match self {
            Attribute::Type => "type",
            Attribute::Present => "present",
            Attribute::Status => "status",
            Attribute::Health => "health",
            Attribute::Technology => "technology",
            Attribute::Scope => "scope",
            Attribute::Manufacturer => "manufacturer",
            Attribute::ModelName => "model_name",
            Attribute::CapacityLevel => "capacity_level",
            Attribute::Measured(role) => match role {
                Role::Capacity => "capacity",
                Role::CapacityErrorMargin => "capacity_error_margin",
                Role::ChargeNow => "charge_now",
                Role::ChargeFull => "charge_full",
                Role::ChargeFullDesign => "charge_full_design",
                Role::VoltageNow => "voltage_now",
                Role::CurrentNow => "current_now",
                Role::CurrentAvg => "current_avg",
                Role::Temp => "temp",
                Role::TimeToEmptyNow => "time_to_empty_now",
                Role::TimeToFullNow => "time_to_full_now",
                Role::EnergyNow => "energy_now",
                Role::PowerAvg => "power_avg",
                Role::CycleCount => "cycle_count",
                Role::StateOfHealth => "state_of_health",
                Role::Flags => "flags",
            },
        }
    }

    /// Its text without a newline; `None` where the gauge does not have it, or does not have it now.
    pub(super) fn text(self, source: &Source<'_>) -> Option<String> {
        let Source { chip, snapshot, .. } = source;
        let fixed = match self {
            Attribute::Type => "Battery",
            Attribute::Present => {
                if snapshot.is_some_and(|snapshot| is_inserted(chip, snapshot)) {
                    "1"
                } else {
                    "0"
                }
            }
            Attribute::Technology => chip.technology,
            Attribute::Scope => "System",
            Attribute::Manufacturer => "Texas Instruments",
            Attribute::ModelName => source.model,
            Attribute::Status => status(chip, (*snapshot)?)?,
            Attribute::Health => health(chip, (*snapshot)?)?,
            Attribute::CapacityLevel => capacity_level(chip, (*snapshot)?)?,
            Attribute::Measured(role) => return measured(role, source).map(|value| value.to_string()),
        };
        Some(fixed.to_string())
    }
}

fn value(chip: &Chip, snapshot: &Snapshot, role: Role) -> Option<i64> {
    snapshot.value(chip.register(role)?)
}

fn has_flag(chip: &Chip, snapshot: &Snapshot, mask: u16) -> Option<bool> {
    Some(value(chip, snapshot, Role::Flags)? & i64::from(mask) != 0)
}

/// Parts that cannot tell (no such flag) are present whenever they answer.
fn is_inserted(chip: &Chip, snapshot: &Snapshot) -> bool {
    chip.condition.present == 0 || has_flag(chip, snapshot, chip.condition.present) == Some(true)
}

/// The kernel driver's rule: the sign of the current, and at rest the full flag.
fn status(chip: &Chip, snapshot: &Snapshot) -> Option<&'static str> {
    let current =
        value(chip, snapshot, Role::CurrentAvg).or_else(|| value(chip, snapshot, Role::CurrentNow))?;
    Some(match current {
        0 if chip.condition.primary => "Not charging",
        0 if has_flag(chip, snapshot, chip.condition.full)? => "Full",
        0 => "Not charging",
        _ if chip.condition.primary => "Discharging",
        1.. => "Charging",
        _ => "Discharging",
    })
}

/// The kernel driver's order; a pack below a threshold of its remaining capacity counts as Dead there.
fn health(chip: &Chip, snapshot: &Snapshot) -> Option<&'static str> {
    let condition = &chip.condition;
    let set = |mask| has_flag(chip, snapshot, mask);
    Some(if set(condition.overheat)? {
        "Overheat"
    } else if set(condition.cold)? {
        "Cold"
    } else if set(condition.low | condition.critical)? {
        "Dead"
    } else {
        "Good"
    })
}

fn capacity_level(chip: &Chip, snapshot: &Snapshot) -> Option<&'static str> {
    let condition = &chip.condition;
    let set = |mask| has_flag(chip, snapshot, mask);
    Some(if set(condition.full)? {
        "Full"
    } else if set(condition.critical)? {
        "Critical"
    } else if set(condition.low)? {
        "Low"
    } else {
        "Normal"
    })
}

fn measured(role: Role, source: &Source<'_>) -> Option<i64> {
    let Source { chip, snapshot, scales, .. } = source;
    if matches!(role, Role::EnergyNow | Role::PowerAvg) && !scales.energy_shown {
        return None;
    }
    let snapshot = (*snapshot)?;
    let raw = match role {
        // Parts with one current only have an averaged one; monitors look for current_now, and the
        // kernel's driver shows it there.
        Role::CurrentNow => value(chip, snapshot, role).or_else(|| value(chip, snapshot, Role::CurrentAvg)),
        role => value(chip, snapshot, role),
    }?;
    let scaled = |factor: f64| (raw as f64 * 1000.0 * factor).round() as i64;
    Some(match role {
        Role::Capacity | Role::CapacityErrorMargin | Role::CycleCount | Role::StateOfHealth => raw,
        Role::VoltageNow => scaled(scales.voltage),
        Role::CurrentNow | Role::CurrentAvg => {
            let signed = scaled(scales.current);
            if scales.absolute_current { signed.abs() } else { signed }
        }
        Role::ChargeNow | Role::ChargeFull | Role::ChargeFullDesign => scaled(scales.current),
        Role::EnergyNow | Role::PowerAvg => scaled(scales.energy),
        // 0.1 K to 0.1 °C as the kernel's driver does it.
        Role::Temp => raw - 2731,
        // 65535 minutes are no number of minutes.
        Role::TimeToEmptyNow | Role::TimeToFullNow if raw == 0xffff => return None,
        Role::TimeToEmptyNow | Role::TimeToFullNow => raw * 60,
        Role::Flags => return None,
    })
}

/// `uevent`: NAME first, then every attribute that is there, all from one Snapshot. Shells source this
/// file, so values hold nothing that one would act on.
pub(super) fn uevent(name: &str, source: &Source<'_>) -> String {
    let mut lines = format!("POWER_SUPPLY_NAME={}\n", plain(name));
    for attribute in ALL {
        let gone = source.snapshot.is_none();
        if gone && !matches!(attribute, Attribute::Type | Attribute::Present) {
            continue;
        }
        if let Some(text) = attribute.text(source) {
            lines += &format!("POWER_SUPPLY_{}={}\n", attribute.name().to_uppercase(), plain(&text));
        }
    }
    lines
}

pub(super) fn plain(text: &str) -> String {
    let keep = |letter: char| letter.is_ascii_alphanumeric() || "._+-".contains(letter);
    text.chars().map(|letter| if keep(letter) { letter } else { '_' }).collect()
}
