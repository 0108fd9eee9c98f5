// SPDX-License-Identifier: MIT

//! The gauges of the kernel's driver `bq27xxx` that have no table: their standard commands, and nothing else.
//!
//! Read from drivers/power/supply/bq27xxx_battery.c of Linux 6.12: which register is where, what the flags mean, and
//! which parts share a map. Registers that feed no attribute are left out, except those that keep a read in one piece.
//! No manual was at hand, so nothing is sent to these parts but register pointers.
//!
//! Some things differ from the driver, because documents show them otherwise:
//!
//! - `power_avg` is AveragePower() in mW: SLUS785D and SLUS914A (bq27500), SLUS927 (bq27510-G1), SLUS948 (bq27510-G2),
//!   SLUSAB7A (bq27520-G2), SLUSAL5 (bq27530-G1), SLUSBE7 (bq27531-G1), SLUS861 and SLUSAL6C (bq27541), SLUSAT0E (bq27545).
//!   The driver takes it for 10 mW. Of bq27z561, bq28z620 and bq78z100 nobody says what it is, so these have no
//!   `power_avg`.
//! - At 0x24, where the driver reads AveragePower(), the bq27546-G1 has BTPSOC1Set(), a threshold that the host sets
//!   (SLUSC53, Table 7), and the bq27542-G1 has the battery trip points (SLUSC33): no `power_avg`.
//! - `energy_now` of the bq27510-G2: SLUS948 says mWh in its Table 1, and 10 mWh in the text of AvailableEnergy().
//! - `charge_now` is RemainingCapacity() where there is one, because StateOfCharge() is that divided by
//!   FullChargeCapacity() (SLUSAL6C). The driver shows NominalAvailableCapacity(), which is not compensated for the load and
//!   may be above `charge_full`.
//! - `capacity_level` is `Critical` with the final threshold, which is below the first (SLUS914A): the driver asks for the
//!   first one first, and never says `Critical`. `health` is `Dead` with the final one only.
//! - `state_of_health` of bq27541, bq27542, bq27545 and bq27546 is in StateOfHealth() at 0x2E, a percentage and a
//!   status (SLUSAL6C, SLUSAT0E, SLUSC53). The bq27541-V200 has an impedance there (SLUSA11), which reads as not
//!   valid. The driver shows no health.
//! - bq27000 and bq27010: a step of charge is 3.57 µVh (SLUS556), 178.5 µAh with 20 mΩ. The driver rounds it down to 178.

use super::{
    Access, Bit, Chip, Condition, Evidence, Identity, Preflight, Register, Role, Scaling, Security, Tier,
};
use crate::codec::Layout;
use crate::value::Type::{self, I, U};
use gauge_bus::GAUGE_ADDRESS;

/// The gauges, in the order of the driver.
#[rustfmt::skip]
pub static GAUGES: &[&Chip] = &[
    &BQ27000, &BQ27010, &BQ2750X, &BQ2751X, &BQ2752X, &BQ27510_G1, &BQ27510_G2, &BQ27510_G3,
    &BQ27520_G1, &BQ27520_G2, &BQ27520_G4, &BQ27521, &BQ27530, &BQ27531, &BQ27541, &BQ27542, &BQ27546,
    &BQ27545, &BQ27411, &BQ27425, &BQ27Z561, &BQ28Z620, &BQ78Z100,
];

/// The driver's names (its I2C ids, which follow `ti,` in a device tree), and what gaugefs has for each.
pub static DRIVER: &[(&str, &str)] = &[
    ("bq27200", "bq27000"),
    ("bq27210", "bq27010"),
    ("bq27500", "bq2750x"),
    ("bq27510", "bq2751x"),
    ("bq27520", "bq2752x"),
    ("bq27500-1", "bq27500"),
    ("bq27510g1", "bq27510-g1"),
    ("bq27510g2", "bq27510-g2"),
    ("bq27510g3", "bq27510-g3"),
    ("bq27520g1", "bq27520-g1"),
    ("bq27520g2", "bq27520-g2"),
    ("bq27520g3", "bq27520-g3"),
    ("bq27520g4", "bq27520-g4"),
    ("bq27521", "bq27521"),
    ("bq27530", "bq27530"),
    ("bq27531", "bq27531"),
    ("bq27541", "bq27541"),
    ("bq27542", "bq27542"),
    ("bq27546", "bq27546"),
    ("bq27742", "bq27742-g1"),
    ("bq27545", "bq27545"),
    ("bq27411", "bq27411"),
    ("bq27421", "bq27421-g1"),
    ("bq27425", "bq27425"),
    ("bq27426", "bq27426"),
    ("bq27441", "bq27441-g1"),
    ("bq27621", "bq27621-g1"),
    ("bq27z561", "bq27z561"),
    ("bq28z610", "bq28z610"),
    // In trees for the release after 6.19, with the map of the bq28z610.
    ("bq28z620", "bq28z620"),
    ("bq34z100", "bq34z100-g1"),
    ("bq78z100", "bq78z100"),
];

/// TI's whole names of gauges that have the driver's name here.
static WHOLE: &[(&str, &str)] = &[
    ("bq27411-g1", "bq27411"),
    ("bq27530-g1", "bq27530"),
    ("bq27531-g1", "bq27531"),
    ("bq27546-g1", "bq27546"),
];

/// The other names of a chip: the driver's, and TI's full one. A name of another chip belongs to that chip.
pub fn aliases(chip: &Chip) -> impl Iterator<Item = &'static str> {
    let names = DRIVER.iter().chain(WHOLE).filter(|(_, ours)| *ours == chip.name);
    let alias = names.map(|(name, _)| *name).filter(|name| *name != chip.name);
    alias.filter(|name| Chip::by_name(name).is_some_and(|one| one.name == chip.name))
}

/// The chip with that full name of TI's.
pub(super) fn by_whole_name(name: &str) -> Option<&'static Chip> {
    let (_, ours) = WHOLE.iter().find(|(whole, _)| whole.eq_ignore_ascii_case(name))?;
    Chip::all().find(|chip| chip.name == *ours)
}

/// The chip with that name in the kernel's driver. Its `bq27500` is any part of the family.
pub fn by_driver_name(name: &str) -> Option<&'static Chip> {
    let (_, ours) = DRIVER.iter().find(|(driver, _)| *driver == name)?;
    Chip::all().find(|chip| chip.name == *ours)
}

/// The chip's name in the kernel's driver.
pub fn driver_name(chip: &Chip) -> Option<&'static str> {
    DRIVER.iter().find(|(_, ours)| *ours == chip.name).map(|(driver, _)| *driver)
}

/// The meaning of Flags().
#[derive(Clone, Copy)]
enum Flavour {
    /// The bq27000's byte.
    Zero,
    /// Over-temperature in charge and in discharge.
    Otdc,
    /// Over- and under-temperature.
    Utot,
    /// BatteryStatus() of the parts with ManufacturerAccessControl().
    Z561,
    /// No documented bits.
    Plain,
}
use Flavour::{Otdc, Plain, Utot, Z561, Zero};

impl Flavour {
    const fn condition(self) -> Condition {
        let (full, low, critical, overheat, cold, uncertain) = match self {
            Zero => (0x20, EDV1, EDVF, 0, 0, 0x10),
            Otdc => (0x0200, 0x0004, 0x0002, 0xc000, 0, 0),
            Utot => (0x0200, 0x0004, 0x0002, 0x8000, 0x4000, 0),
            Z561 => (0x0020, 0, 0x0010, 0, 0, 0),
            Plain => (0, 0, 0, 0, 0, 0),
        };
        Condition {
            full,
            low,
            critical,
            overheat,
            cold,
            over_voltage: 0,
            under_voltage: 0,
            present: 0,
            // Nothing pulls the lines of a gauge that is not there.
            absent: if matches!(self, Zero) { 0xff } else { 0 },
            uncertain,
            certain: 0,
            empty: 0,
            complete: None,
            primary: None,
        }
    }

    #[rustfmt::skip]
    const fn bits(self) -> &'static [Bit] {
        match self {
            Zero => const {
                &[
                    Bit::new(CHGS, "CHGS"), Bit::new(0x20, "FC"), Bit::new(0x10, "CI"),
                    Bit::new(EDV1, "EDV1"), Bit::new(EDVF, "EDVF"),
                ]
            },
            Otdc => const {
                &[
                    Bit::new(0x8000, "OTC"), Bit::new(0x4000, "OTD"), Bit::new(0x0200, "FC"),
                    Bit::new(0x0004, "SOC1"), Bit::new(0x0002, "SOCF"), Bit::new(0x0001, "DSG"),
                ]
            },
            Utot => const {
                &[
                    Bit::new(0x8000, "OT"), Bit::new(0x4000, "UT"), Bit::new(0x0200, "FC"),
                    Bit::new(0x0004, "SOC1"), Bit::new(0x0002, "SOCF"), Bit::new(0x0001, "DSG"),
                ]
            },
            Z561 => const { &[Bit::new(0x0040, "DSG"), Bit::new(0x0020, "FC"), Bit::new(0x0010, "FD")] },
            Plain => &[],
        }
    }
}

const CHGS: u32 = 0x80;
const EDV1: u32 = 0x02;
const EDVF: u32 = 0x01;

/// A gauge that is known by its standard commands only.
const fn gauge(
    name: &'static str,
    model: &'static str,
    registers: &'static [Register],
    flavour: Flavour,
) -> Chip {
    Chip {
        name,
        model,
        documents: &["Linux 6.12, bq27xxx_battery.c"],
        evidence: &[Evidence::Drivers, Evidence::Kernel],
        identity: Identity::NONE,
        firmware_file: None,
        technology: "Li-ion",
        address: GAUGE_ADDRESS,
        layout: Layout::TI,
        flat: 0..0,
        registers,
        subcommands: &[],
        control_status: &[],
        condition: flavour.condition(),
        scaling: Scaling::NONE,
        security: Security::NONE,
        asks: None,
        access: Access::NONE,
        gate: None,
        authentication: None,
        subclasses: &[],
        byte_writes_above_hz: None,
        calibration: None,
        signature: &[],
        volatile: None,
        quirks: &[],
        rom_image: None,
        preflight: Preflight::NONE,
    }
}

static BQ27000: Chip = gauge("bq27000", "bq27000", REGISTERS_27000, Zero);
static BQ27010: Chip = gauge("bq27010", "bq27010", REGISTERS_27010, Zero);
// Names for old device trees, which mean any part of a family.
static BQ2750X: Chip = gauge("bq2750x", "bq2750x", REGISTERS_2750X, Otdc);
static BQ2751X: Chip = gauge("bq2751x", "bq2751x", REGISTERS_2751X, Otdc);
static BQ2752X: Chip = gauge("bq2752x", "bq2752x", REGISTERS_2751X, Otdc);
pub(super) static BQ27510_G1: Chip = gauge("bq27510-g1", "bq27510-G1", REGISTERS_27500, Otdc);
pub(super) static BQ27510_G2: Chip = gauge("bq27510-g2", "bq27510-G2", REGISTERS_27510_G2, Otdc);
pub(super) static BQ27510_G3: Chip = gauge("bq27510-g3", "bq27510-G3", REGISTERS_2751X, Otdc);
pub(super) static BQ27520_G1: Chip = gauge("bq27520-g1", "bq27520-G1", REGISTERS_27520_G1, Otdc);
static BQ27520_G2: Chip = gauge("bq27520-g2", "bq27520-G2", REGISTERS_27500, Otdc);
pub(super) static BQ27520_G4: Chip = gauge("bq27520-g4", "bq27520-G4", REGISTERS_27520_G4, Otdc);
static BQ27521: Chip = gauge("bq27521", "bq27521", REGISTERS_27521, Plain);
static BQ27530: Chip = gauge("bq27530", "bq27530", REGISTERS_27530, Utot);
static BQ27531: Chip = gauge("bq27531", "bq27531", REGISTERS_27530, Utot);
pub(super) static BQ27541: Chip = gauge("bq27541", "bq27541", REGISTERS_27541, Otdc);
pub(super) static BQ27542: Chip = gauge("bq27542", "bq27542", REGISTERS_27546, Otdc);
pub(super) static BQ27546: Chip = gauge("bq27546", "bq27546", REGISTERS_27546, Otdc);
static BQ27545: Chip = gauge("bq27545", "bq27545", REGISTERS_27545, Otdc);
static BQ27411: Chip = gauge("bq27411", "bq27411", REGISTERS_27411, Utot);
static BQ27425: Chip = gauge("bq27425", "bq27425", REGISTERS_27411, Utot);
pub(super) static BQ27Z561: Chip = gauge("bq27z561", "bq27z561", REGISTERS_27Z561, Z561);
static BQ28Z620: Chip = gauge("bq28z620", "bq28z620", REGISTERS_27Z561, Z561);
static BQ78Z100: Chip = gauge("bq78z100", "bq78z100", REGISTERS_27Z561, Z561);

/// The words of the otdc parts with TimeToFull() and energy.
#[rustfmt::skip]
static REGISTERS_27500: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), to_full(0x18), energy(0x22), power(0x24), at_constant_power(0x26), cycles(0x2a), percent(0x2c),
    design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_27510_G2: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), to_full(0x18), power(0x24), at_constant_power(0x26), cycles(0x2a), percent(0x2c), design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_27520_G1: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), to_full(0x18), energy(0x22), power(0x24), at_constant_power(0x26), percent(0x2c), design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_2750X: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), cycles(0x2a), percent(0x2c), design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_2751X: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), standby(0x1a), cycles(0x1e), percent(0x20), design(0x2e),
];

#[rustfmt::skip]
static REGISTERS_27520_G4: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), standby(0x1a), cycles(0x1e), percent(0x20),
];

#[rustfmt::skip]
static REGISTERS_27521: &[Register] =
    &[flags(0x08, Plain), temperature(0x0a), voltage(0x0c), current(0x0e)];

#[rustfmt::skip]
static REGISTERS_27530: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Utot), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), power(0x24), cycles(0x2a), percent(0x2c),
];

#[rustfmt::skip]
static REGISTERS_27541: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), power(0x24), cycles(0x2a), percent(0x2c), health(0x2e), health_status(0x2f), design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_27546: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), cycles(0x2a), percent(0x2c), health(0x2e), health_status(0x2f), design(0x3c),
];

#[rustfmt::skip]
static REGISTERS_27545: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Otdc), nominal(0x0c), remaining(0x10), full(0x12), current(0x14),
    to_empty(0x16), power(0x24), cycles(0x2a), percent(0x2c), health(0x2e), health_status(0x2f),
];

#[rustfmt::skip]
static REGISTERS_27411: &[Register] = &[
    temperature(0x02), voltage(0x04), flags(0x06, Utot), nominal(0x08), remaining(0x0c), full(0x0e), current(0x10),
    power_without_role(0x18, "mW"), percent(0x1c), design(0x3c),
];

/// The charge is RemainingCapacity() in the driver, too.
#[rustfmt::skip]
static REGISTERS_27Z561: &[Register] = &[
    temperature(0x06), voltage(0x08), flags(0x0a, Z561), remaining(0x10), full(0x12), current(0x14), to_empty(0x16),
    to_full(0x18), power_without_role(0x22, ""), cycles(0x2a), percent(0x2c), design(0x3c),
];

// The bq27000 counts in units of its sense resistor's voltage; the steps are for 20 mΩ, as in the driver. With
// another resistor the scales of currents and energies are 20 mΩ divided by it.

#[rustfmt::skip]
static REGISTERS_27000: &[Register] = &[
    kelvin_quarters(0x06), voltage(0x08), byte_flags(0x0a), byte_percent(0x0b), available(0x0c), measured(0x12), magnitude(0x14), to_empty(0x16), to_full(0x18),
    zero_energy(0x22), zero_power(0x24), at_constant_power(0x26), cycles(0x2a), byte_design(0x76),
];

#[rustfmt::skip]
static REGISTERS_27010: &[Register] = &[
    kelvin_quarters(0x06), voltage(0x08), byte_flags(0x0a), byte_percent(0x0b), available(0x0c), measured(0x12), magnitude(0x14), to_empty(0x16), to_full(0x18),
    at_constant_power(0x26), cycles(0x2a), byte_design(0x76),
];

const fn word(code: u8, kind: Type, name: &'static str, unit: &'static str, role: Role) -> Register {
    Register::new(code, kind, name, unit, Tier::Poll).role(role)
}

const fn temperature(code: u8) -> Register {
    word(code, U(2), "Temperature", "0.1 K", Role::Temp)
}

const fn voltage(code: u8) -> Register {
    word(code, U(2), "Voltage", "mV", Role::VoltageNow)
}

const fn flags(code: u8, flavour: Flavour) -> Register {
    word(code, U(2), "Flags", "", Role::Flags).bits(flavour.bits())
}

/// Fills a gap between two registers that are needed.
const fn nominal(code: u8) -> Register {
    Register::new(code, U(2), "NominalAvailableCapacity", "mAh", Tier::Poll)
}

const fn remaining(code: u8) -> Register {
    word(code, U(2), "RemainingCapacity", "mAh", Role::ChargeNow)
}

const fn full(code: u8) -> Register {
    word(code, U(2), "FullChargeCapacity", "mAh", Role::ChargeFull)
}

const fn current(code: u8) -> Register {
    word(code, I(2), "AverageCurrent", "mA", Role::CurrentAvg)
}

const fn to_empty(code: u8) -> Register {
    word(code, U(2), "TimeToEmpty", "min", Role::TimeToEmptyNow)
}

const fn to_full(code: u8) -> Register {
    word(code, U(2), "TimeToFull", "min", Role::TimeToFullNow)
}

/// Fills a gap between two registers that are needed.
const fn standby(code: u8) -> Register {
    Register::new(code, U(2), "StandbyTimeToEmpty", "min", Tier::Poll)
}

/// Fills a gap between two registers that are needed. The driver shows it for the bq27000 and the bq27010 only.
const fn at_constant_power(code: u8) -> Register {
    word(code, U(2), "TimeToEmptyAtConstantPower", "min", Role::TimeToEmptyAvg)
}

const fn energy(code: u8) -> Register {
    word(code, U(2), "AvailableEnergy", "mWh", Role::EnergyNow)
}

const fn power(code: u8) -> Register {
    word(code, I(2), "AveragePower", "mW", Role::PowerAvg)
}

/// AveragePower() that is not shown: the driver does not show it, or its unit is unknown.
const fn power_without_role(code: u8, unit: &'static str) -> Register {
    Register::new(code, I(2), "AveragePower", unit, Tier::Slow)
}

const fn cycles(code: u8) -> Register {
    word(code, U(2), "CycleCount", "", Role::CycleCount)
}

const fn percent(code: u8) -> Register {
    word(code, U(2), "StateOfCharge", "%", Role::Capacity)
}

/// The low byte of StateOfHealth().
const fn health(code: u8) -> Register {
    word(code, U(1), "StateOfHealth", "%", Role::StateOfHealth).valid_by(code + 1)
}

const fn health_status(code: u8) -> Register {
    Register::new(code, U(1), "StateOfHealthStatus", "", Tier::Poll)
}

const fn design(code: u8) -> Register {
    Register::new(code, U(2), "DesignCapacity", "mAh", Tier::Static).role(Role::ChargeFullDesign)
}

const fn kelvin_quarters(code: u8) -> Register {
    word(code, U(2), "Temperature", "0.25 K", Role::Temp).step(5, 2)
}

const fn byte_flags(code: u8) -> Register {
    word(code, U(1), "Flags", "", Role::Flags).bits(Zero.bits())
}

/// The gauge shows 0 for a moment now and then; it is only valid with `[EDVF]`.
const fn byte_percent(code: u8) -> Register {
    word(code, U(1), "RelativeStateOfCharge", "%", Role::Capacity).empty(EDVF)
}

/// 3.57 µVh across 20 mΩ; 0 for a moment now and then, like the percentage.
const fn available(code: u8) -> Register {
    word(code, U(2), "NominalAvailableCapacity", "3.57 uVh", Role::ChargeNow).step(357, 2000).empty(EDVF)
}

const fn measured(code: u8) -> Register {
    word(code, U(2), "LastMeasuredDischarge", "3.57 uVh", Role::ChargeFull).step(357, 2000)
}

const fn magnitude(code: u8) -> Register {
    word(code, U(2), "AverageCurrent", "3.57 uV", Role::CurrentAvg).step(357, 2000).positive(CHGS)
}

/// 29.2 µV² h across 20 mΩ.
const fn zero_energy(code: u8) -> Register {
    word(code, U(2), "AvailableEnergy", "29.2 uV2h", Role::EnergyNow).step(146, 100)
}

/// Without a sign, as in the driver.
const fn zero_power(code: u8) -> Register {
    word(code, U(2), "AveragePower", "29.2 uV2", Role::PowerAvg).step(146, 100)
}

/// The high byte of a charge.
const fn byte_design(code: u8) -> Register {
    let row = Register::new(code, U(1), "InitialLastMeasuredDischarge", "256 x 3.57 uVh", Tier::Static);
    row.role(Role::ChargeFullDesign).step(256 * 357, 2000)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::CHIPS;
    use super::*;
    use crate::chip::bursts;

    #[test]
    fn names_are_those_of_one_chip() {
        let names: Vec<_> = Chip::all().map(|chip| chip.name).collect();
        assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
        assert!(GAUGES.iter().all(|chip| !chip.has_table()) && CHIPS.iter().all(|chip| chip.has_table()));
    }

    #[test]
    fn all_of_the_drivers_names_are_listed_and_every_gauge_has_one() {
        assert_eq!(DRIVER.len(), 32);
        for (name, _) in DRIVER {
            assert!(by_driver_name(name).is_some(), "{name}");
        }
        for chip in GAUGES {
            let name = driver_name(chip).expect("a name");
            assert_eq!(by_driver_name(name).expect("a chip").name, chip.name);
        }
    }

    #[test]
    fn a_gauge_has_tis_whole_name_as_well() {
        for (name, ours) in WHOLE {
            let chip = Chip::by_name(&name.to_uppercase()).expect("a chip");
            assert_eq!((chip.name, aliases(chip).any(|alias| alias == *name)), (*ours, true), "{name}");
        }
        let others: Vec<_> = Chip::all().flat_map(aliases).collect();
        assert!(others.iter().all(|name| !Chip::all().any(|chip| chip.name == *name)), "{others:?}");
    }

    /// The registers behind each gauge's attributes, as in L612's table.
    #[test]
    fn registers_are_in_order_and_feed_each_attribute_once() {
        for chip in GAUGES {
            let end = |row: &Register| row.source.command().map(|code| code + row.size);
            let ends = chip.registers.windows(2).all(|two| end(&two[0]) <= two[1].source.command());
            assert!(ends, "{}", chip.name);
            let roles: Vec<_> = chip.registers.iter().filter_map(|register| register.role).collect();
            assert_eq!(
                roles.iter().collect::<std::collections::HashSet<_>>().len(),
                roles.len(),
                "{}",
                chip.name
            );
            assert!(
                [Role::Temp, Role::VoltageNow, Role::CurrentAvg, Role::Flags]
                    .iter()
                    .all(|role| roles.contains(role))
            );
        }
    }

    #[test]
    fn a_poll_takes_few_reads() {
        let reads = |name: &str| {
            let chip = Chip::by_name(name).expect("a chip");
            bursts(chip.registers, |tier| tier == Tier::Poll)
        };
        assert_eq!(reads("bq27000"), [(0x06, 8), (0x12, 8), (0x22, 10)]);
        assert_eq!(reads("bq27510-g1"), [(0x06, 20), (0x22, 12)]);
        assert_eq!(reads("bq27510-g3"), [(0x06, 28)]);
        assert_eq!(reads("bq27541"), [(0x06, 18), (0x24, 2), (0x2a, 6)]);
        assert_eq!(reads("bq27521"), [(0x08, 8)]);
        assert_eq!(reads("bq27411"), [(0x02, 16), (0x1c, 2)]);
        assert_eq!(reads("bq2750x"), [(0x06, 18), (0x2a, 4)]);
    }
}
