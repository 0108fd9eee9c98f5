// SPDX-License-Identifier: MIT

//! Gauges of the kernel's driver that are known by their standard commands only. Each has the map of the driver of
//! Linux 6.12, and StateOfHealth() where data sheets have it; all share one battery.

use super::flash::Flash;
use super::gauging::Quantity as Q;
use super::gauging::{DSG, FC, Map, OT, OTC, OTD, SOC1, SOCF, Settings, UT};
use super::part::{Part, RegisterPart, Scheme};
use super::timing::Timing;

type Row = (u8, usize, Q);
type Flags = &'static [(u32, u16)];

const fn named(name: &'static str, part: &'static RegisterPart) -> Part {
    Part { name, image: &[], timing: Timing::USUAL, scheme: Scheme::Registers(part), rewrites: &[] }
}

const fn map(registers: &'static [Row], flags: Flags) -> Map {
    Map { settings, registers, flags, cycles: None, lifetime: None, learned: None }
}

/// A part that answers DEVICE_TYPE and FW_VERSION with these words, made up where no version is known.
const fn of(registers: &'static [Row], flags: Flags, device_type: u16, firmware: u16) -> RegisterPart {
    RegisterPart { map: map(registers, flags), in_volts: false, control: Some((device_type, firmware)) }
}

/// A part without Control(), in the units of its sense resistor's voltage.
const fn in_volts(registers: &'static [Row]) -> RegisterPart {
    RegisterPart { map: map(registers, ZERO), in_volts: true, control: None }
}

#[rustfmt::skip]
pub(super) static PARTS: &[&Part] = &[
    &const { named("bq27000", const { &in_volts(BQ27000) }) },
    &const { named("bq27010", const { &in_volts(BQ27010) }) },
    &const { named("bq2750x", const { &of(BQ2750X, OTDC, 0x0500, 0x0108) }) },
    &const { named("bq2751x", const { &of(BQ2751X, OTDC, 0x0510, 0x0400) }) },
    &const { named("bq2752x", const { &of(BQ2751X, OTDC, 0x0520, 0x0400) }) },
    &const { named("bq27510-g1", const { &of(BQ27500, OTDC, 0x0510, 0x0100) }) },
    &const { named("bq27510-g2", const { &of(BQ27500, OTDC, 0x0510, 0x0200) }) },
    &const { named("bq27510-g3", const { &of(BQ2751X, OTDC, 0x0510, 0x0400) }) },
    &const { named("bq27520-g1", const { &of(BQ27520_G1, OTDC, 0x0520, 0x0302) }) },
    &const { named("bq27520-g2", const { &of(BQ27500, OTDC, 0x0520, 0x0311) }) },
    &const { named("bq27520-g4", const { &of(BQ27520_G4, OTDC, 0x0520, 0x0329) }) },
    &const { named("bq27521", const { &of(BQ27521, &[], 0x0521, 0x0100) }) },
    &const { named("bq27530", const { &of(BQ27530, UTOT, 0x0530, 0x0100) }) },
    &const { named("bq27531", const { &of(BQ27530, UTOT, 0x0531, 0x0100) }) },
    &const { named("bq27541", const { &of(BQ27541, OTDC, 0x0541, 0x0200) }) },
    &const { named("bq27542", const { &of(BQ27546, OTDC, 0x0542, 0x0200) }) },
    &const { named("bq27546", const { &of(BQ27546, OTDC, 0x0541, 0x0100) }) },
    &const { named("bq27545", const { &of(BQ27545, OTDC, 0x0545, 0x0200) }) },
    &const { named("bq27411", const { &of(BQ27411, UTOT, 0x0421, 0x0109) }) },
    &const { named("bq27425", const { &of(BQ27411, UTOT, 0x0425, 0x0205) }) },
    &const { named("bq27z561", const { &of(BQ27Z561, Z561, 0x1561, 0x0100) }) },
    &const { named("bq28z620", const { &of(BQ27Z561, Z561, 0x2620, 0x0100) }) },
    &const { named("bq78z100", const { &of(BQ27Z561, Z561, 0x2610, 0x0100) }) },
];

static ZERO: Flags = &[(FC, 0x20), (SOC1, 0x02), (SOCF, 0x01)];
static OTDC: Flags =
    &[(OTC, 0x8000), (OTD, 0x4000), (FC, 0x0200), (SOC1, 0x0004), (SOCF, 0x0002), (DSG, 0x0001)];
static UTOT: Flags =
    &[(OT, 0x8000), (UT, 0x4000), (FC, 0x0200), (SOC1, 0x0004), (SOCF, 0x0002), (DSG, 0x0001)];
static Z561: Flags = &[(DSG, 0x0040), (FC, 0x0020), (SOCF, 0x0010)];

#[rustfmt::skip]
static BQ27000: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 1, Q::Flags), (0x0B, 1, Q::Percent),
    (0x0C, 2, Q::NominalRemaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x18, 2, Q::TimeToFull), (0x22, 2, Q::AvailableEnergy), (0x24, 2, Q::AveragePower),
    (0x26, 2, Q::ConstantPowerTimeToEmpty), (0x2A, 2, Q::CycleCount), (0x76, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ27010: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 1, Q::Flags), (0x0B, 1, Q::Percent),
    (0x0C, 2, Q::NominalRemaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x18, 2, Q::TimeToFull), (0x26, 2, Q::ConstantPowerTimeToEmpty), (0x2A, 2, Q::CycleCount),
    (0x76, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ27500: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x18, 2, Q::TimeToFull), (0x22, 2, Q::AvailableEnergy), (0x24, 2, Q::AveragePower),
    (0x26, 2, Q::ConstantPowerTimeToEmpty), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent),
    (0x3C, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ27520_G1: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x18, 2, Q::TimeToFull), (0x22, 2, Q::AvailableEnergy), (0x24, 2, Q::AveragePower),
    (0x26, 2, Q::ConstantPowerTimeToEmpty), (0x2C, 2, Q::Percent), (0x3C, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ2750X: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x1A, 2, Q::StandbyTimeToEmpty), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x3C, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ2751X: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x1A, 2, Q::StandbyTimeToEmpty), (0x1E, 2, Q::CycleCount), (0x20, 2, Q::Percent), (0x2E, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ27520_G4: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x1A, 2, Q::StandbyTimeToEmpty), (0x1E, 2, Q::CycleCount), (0x20, 2, Q::Percent),
];

#[rustfmt::skip]
static BQ27521: &[Row] =
    &[(0x08, 2, Q::Flags), (0x0A, 2, Q::Temperature), (0x0C, 2, Q::Voltage), (0x0E, 2, Q::AverageCurrent)];

#[rustfmt::skip]
static BQ27530: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x24, 2, Q::AveragePower), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent),
];

#[rustfmt::skip]
static BQ27541: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x24, 2, Q::AveragePower), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x2E, 1, Q::Health),
    (0x2F, 1, Q::HealthStatus), (0x3C, 2, Q::DesignCapacity),
];

/// Where the BQ27541 has its power is a threshold that the host sets.
#[rustfmt::skip]
static BQ27546: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x24, 2, Q::DesignCapacity), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x2E, 1, Q::Health),
    (0x2F, 1, Q::HealthStatus), (0x3C, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static BQ27545: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x24, 2, Q::AveragePower), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x2E, 1, Q::Health),
    (0x2F, 1, Q::HealthStatus),
];

#[rustfmt::skip]
static BQ27411: &[Row] = &[
    (0x02, 2, Q::Temperature), (0x04, 2, Q::Voltage), (0x06, 2, Q::Flags), (0x08, 2, Q::NominalRemaining),
    (0x0C, 2, Q::Remaining), (0x0E, 2, Q::Full), (0x10, 2, Q::AverageCurrent), (0x18, 2, Q::AveragePower),
    (0x1C, 2, Q::Percent), (0x3C, 2, Q::DesignCapacity),
];

/// SLUUA65E has the power of the bq28z610 in cW; the others of this map are assumed to be the same.
#[rustfmt::skip]
static BQ27Z561: &[Row] = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x10, 2, Q::Remaining), (0x12, 2, Q::Full),
    (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty), (0x18, 2, Q::TimeToFull), (0x22, 2, Q::AverageCentiwatts),
    (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x3C, 2, Q::DesignCapacity),
];

/// Settings of all these parts: a cell of 1200 mAh, and TI's default thresholds of the bq27500. The reserve keeps
/// RemainingCapacity() apart from NominalAvailableCapacity().
fn settings(_: &Flash) -> Settings {
    Settings {
        ot_charge: (550.0, 2.0, 500.0),
        ot_discharge: (600.0, 2.0, 550.0),
        over: (550.0, 50.0),
        under: (0.0, 50.0),
        taper_ma: 100.0,
        taper_mv: 100.0,
        full_at_taper: true,
        cycle_mah: 900.0,
        cycles: 7,
        design_mah: 1150,
        qmax_mah: 1200.0,
        soc1: (150, 175),
        socf: (75, 100),
        reserve_mah: 50.0,
        ..Settings::none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_do_not_overlap() {
        for part in PARTS {
            let Scheme::Registers(scheme) = part.scheme else { panic!("{}", part.name) };
            let rows = scheme.map.registers;
            assert!(rows.windows(2).all(|two| usize::from(two[0].0) + two[0].1 <= usize::from(two[1].0)));
        }
    }
}
