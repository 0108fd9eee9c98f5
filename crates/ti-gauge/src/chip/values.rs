// SPDX-License-Identifier: MIT

//! Valid readings of a property.

use super::Role;

/// The valid readings of a property. Any other reading means that the gauge has no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Values {
    /// Least valid reading.
    pub least: i64,
    /// Greatest valid reading.
    pub greatest: i64,
    /// The source; empty if every reading is valid.
    pub source: &'static str,
}

impl Values {
    /// Every reading is a value.
    pub const ALL: Self = Self { least: i64::MIN, greatest: i64::MAX, source: "" };

    const fn new(least: i64, greatest: i64, source: &'static str) -> Self {
        Self { least, greatest, source }
    }

    const fn from(least: i64, source: &'static str) -> Self {
        Self { least, ..Self::ALL }.by(source)
    }

    const fn up_to(greatest: i64, source: &'static str) -> Self {
        Self { greatest, ..Self::ALL }.by(source)
    }

    const fn by(self, source: &'static str) -> Self {
        Self { source, ..self }
    }

    /// Whether a reading is valid.
    pub const fn hold(self, reading: i64) -> bool {
        self.least <= reading && reading <= self.greatest
    }
}

impl Role {
    /// The valid readings of a property on every part, unless [`Register::values`](super::Register::values) differs.
    pub const fn values(self) -> Values {
        match self {
            Role::Capacity => Values::new(0, 100, "SLUSBZ5D 7.3.1.3, SLUUAC9A Table 4-1: 0 to 100"),
            Role::CapacityErrorMargin => Values::new(1, 100, "SLUSBZ5D 7.3.1.4: 1 to 100"),
            Role::ChargeFull => Values::from(
                1,
                "SLUSBZ5D 7.3.1.3: StateOfCharge() is a fraction of it; 0 before the first prediction",
            ),
            Role::ChargeFullDesign => {
                Values::from(1, "SLUSBZ5D 7.3.2.10: StateOfHealth() is a fraction of it; 0 if not configured")
            }
            Role::VoltageNow => Values::from(
                1,
                "SLUSBZ5D 6.3: 0 before the first measurement; a gauge that answers has a voltage",
            ),
            Role::Temp => Values::new(
                1,
                0xfffe,
                "a word in 0.1 K; 0 K before the first measurement, and the end of the range",
            ),
            Role::TimeToEmptyNow | Role::TimeToEmptyAvg => {
                Values::up_to(0xfffe, "SLUSBZ5D 7.3.2.1, SLUSAB7A: 65535 while not discharging")
            }
            Role::TimeToFullNow | Role::TimeToFullAvg => {
                Values::up_to(0xfffe, "SLUSBZ5D 7.3.2.2, SLUSAB7A: 65535 while not charging")
            }
            Role::ChargeVoltage | Role::ChargeCurrent => {
                Values::up_to(0xfffe, "Smart Battery Data 1.1: 65535 leaves it to the charger")
            }
            Role::InternalResistance => Values::from(1, "SLUUBH1C: 0 before the first pulse"),
            Role::StateOfHealth => {
                Values::new(1, 100, "SLUSBZ5D 7.3.2.10, SLUUCD5A: 0 to 100; 0 before it is computed")
            }
            Role::VoltageMinDesign | Role::VoltageMaxDesign => Values::from(1, "0 if not configured"),
            Role::Cells => Values::from(1, "a pack has one at least; 0 if not configured"),
            Role::ChargeNow
            | Role::CurrentNow
            | Role::CurrentAvg
            | Role::EnergyNow
            | Role::EnergyFull
            | Role::EnergyFullDesign
            | Role::PowerAvg
            | Role::ChargeCounter
            | Role::CycleCount
            | Role::Flags
            | Role::Technology
            | Role::ManufactureDate
            | Role::SerialNumber
            | Role::Manufacturer
            | Role::ModelName => Values::ALL,
        }
    }
}
