// SPDX-License-Identifier: MIT

//! TI's gauges in Smart Battery packs: what they answer beside the words of the specification, if they are asked.
//!
//! Codes, lengths and bits: SLUUA43A 12.1 (bq40z50), SLUUBC1D 13.1 (R1), SLUUBK0B 14.1 (R2), SLUUAQ3A 13.1 (bq4050), SLUU852A
//! 11.1 (bq30z50, bq30z55), SLUUA79 (bq30z554), SLUUBD3D 17.2 (bq78350), E2E 71892 (bq20z). What R3, R4 and R5 have in
//! common, and what is known of the bq40z80, is from drivers. An answer is taken as long as the pack sends it.

use super::super::{Asks, Effect, Subcommand, Way};
use super::*;
use crate::value::Type::{I, U};

/// Every part.
pub static GAUGES: &[&Chip] = &[
    &BQ40Z50_CHIP,
    &BQ40Z50_R1_CHIP,
    &BQ40Z50_R2_CHIP,
    &BQ40Z50_R3_CHIP,
    &BQ40Z50_R4_CHIP,
    &BQ40Z50_R5_CHIP,
    &BQ40Z80_CHIP,
    &BQ4050_CHIP,
    &BQ30Z50_CHIP,
    &BQ30Z55_CHIP,
    &BQ30Z554_CHIP,
    &BQ78350_CHIP,
    &BQ20Z45_CHIP,
    &BQ20Z65_CHIP,
];

/// What DeviceName() is as TI ships a part, and of one real pack (SLUUA43A 12.31, SLUUBC1D 13.31, SLUUBK0B 14.31, SLUUAQ3A
/// 13.31, ArminJo/Smart-Battery-Module-Info_For_Arduino). A maker's own name says nothing.
static DEVICE_NAMES: &[(&str, &Chip)] = &[
    ("bq40z50", &BQ40Z50_CHIP),
    ("bq40z50-R1", &BQ40Z50_R1_CHIP),
    ("bq40z50-R2", &BQ40Z50_R2_CHIP),
    ("BQ4050", &BQ4050_CHIP),
    ("bq20z451", &BQ20Z45_CHIP),
];

/// The part whose DeviceName() is that.
pub fn by_device_name(name: &str) -> Option<&'static Chip> {
    DEVICE_NAMES.iter().find(|(known, _)| known.eq_ignore_ascii_case(name)).map(|(_, chip)| *chip)
}

const SBS: &str = "Smart Battery Data Specification 1.1";
const MANUAL: &[Evidence] = &[Evidence::Manual, Evidence::Drivers];
const DRIVERS: &[Evidence] = &[Evidence::Drivers];
const BLOCKS: &[Way] = &[Way::Block, Way::Word];
const WORD: &[Way] = &[Way::Word];
const BACK: &[Way] = &[Way::Back];

/// Lists of rows, one behind the other.
macro_rules! joined {
    ($($list:expr),*) => {{
        const LISTS: &[&[Register]] = &[$($list),*];
        &join::<{ count(LISTS) }>(LISTS)
    }};
}

/// The major version of the firmware of a bq40z50 is its revision (E2E 441952, 1108797).
static BQ40Z50_CHIP: Chip = Chip {
    name: "bq40z50",
    model: "bq40z50",
    documents: &[SBS, "SLUUA43A"],
    evidence: MANUAL,
    asks: Some(&Asks {
        device_type: 0x4500,
        majors: &[0x00, 0x01],
        ways: BLOCKS,
        sealed: 0x0300,
        failed: 0x1000,
    }),
    subcommands: MOST_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50, MEASURED, LIFETIME),
    ..BASE
};

static BQ40Z50_R1_CHIP: Chip = Chip {
    name: "bq40z50-r1",
    model: "bq40z50-R1",
    documents: &[SBS, "SLUUBC1D"],
    evidence: MANUAL,
    asks: Some(&Asks {
        device_type: 0x4500,
        majors: &[0x00, 0x01],
        ways: BLOCKS,
        sealed: 0x0300,
        failed: 0x1000,
    }),
    subcommands: MOST_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50, MEASURED, LIFETIME),
    ..BASE
};

static BQ40Z50_R2_CHIP: Chip = Chip {
    name: "bq40z50-r2",
    model: "bq40z50-R2",
    documents: &[SBS, "SLUUBK0B"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x4500, majors: &[0x02], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: ALL_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50_R2, MEASURED, GAUGING_TEMPERATURE, LIFETIME, LIFETIME_EVENTS),
    ..BASE
};

static BQ40Z50_R3_CHIP: Chip = Chip {
    name: "bq40z50-r3",
    model: "bq40z50-R3",
    documents: &[SBS, "OpenDevicePartnership/bq40z50"],
    evidence: DRIVERS,
    asks: Some(&Asks { device_type: 0x4500, majors: &[0x03], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: NEWER_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50_NEWER, MEASURED),
    ..BASE
};

static BQ40Z50_R4_CHIP: Chip = Chip {
    name: "bq40z50-r4",
    model: "bq40z50-R4",
    documents: &[SBS, "OpenDevicePartnership/bq40z50"],
    evidence: DRIVERS,
    asks: Some(&Asks { device_type: 0x4500, majors: &[0x04], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: NEWER_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50_NEWER, MEASURED),
    ..BASE
};

static BQ40Z50_R5_CHIP: Chip = Chip {
    name: "bq40z50-r5",
    model: "bq40z50-R5",
    documents: &[SBS, "OpenDevicePartnership/bq40z50"],
    evidence: DRIVERS,
    asks: Some(&Asks { device_type: 0x4500, majors: &[0x05], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: NEWER_QUESTIONS,
    registers: joined!(WORDS, BQ40Z50_NEWER, MEASURED),
    ..BASE
};

static BQ40Z80_CHIP: Chip = Chip {
    name: "bq40z80",
    model: "bq40z80",
    documents: &[SBS, "SLUUBT5C"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x4800, majors: &[], ways: BLOCKS, sealed: 0x0300, failed: 0x0000 }),
    subcommands: NEWER_QUESTIONS,
    registers: joined!(WORDS, BQ40Z80, MEASURED),
    ..BASE
};

static BQ4050_CHIP: Chip = Chip {
    name: "bq4050",
    model: "bq4050",
    documents: &[SBS, "SLUUAQ3A"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x9e34, majors: &[], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: MOST_QUESTIONS,
    registers: joined!(WORDS, BQ4050, MEASURED, LIFETIME),
    ..BASE
};

static BQ30Z50_CHIP: Chip = Chip {
    name: "bq30z50",
    model: "bq30z50",
    documents: &[SBS, "SLUU852A"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x0500, majors: &[], ways: WORD, sealed: 0x0300, failed: 0x1000 }),
    subcommands: BASIC_QUESTIONS,
    registers: joined!(WORDS, BQ30Z55),
    ..BASE
};

static BQ30Z55_CHIP: Chip = Chip {
    name: "bq30z55",
    model: "bq30z55",
    documents: &[SBS, "SLUU852A"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x0550, majors: &[], ways: WORD, sealed: 0x0300, failed: 0x1000 }),
    subcommands: BASIC_QUESTIONS,
    registers: joined!(WORDS, BQ30Z55),
    ..BASE
};

static BQ30Z554_CHIP: Chip = Chip {
    name: "bq30z554",
    model: "bq30z554",
    documents: &[SBS, "SLUUA79"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x0554, majors: &[], ways: WORD, sealed: 0x0300, failed: 0x1000 }),
    subcommands: BASIC_QUESTIONS,
    registers: joined!(WORDS, BQ30Z554),
    ..BASE
};

static BQ78350_CHIP: Chip = Chip {
    name: "bq78350",
    model: "bq78350",
    documents: &[SBS, "SLUUBD3D"],
    evidence: MANUAL,
    asks: Some(&Asks { device_type: 0x1e9b, majors: &[], ways: BLOCKS, sealed: 0x0300, failed: 0x1000 }),
    subcommands: BASIC_QUESTIONS,
    registers: joined!(WORDS, CELLS_5_TO_15, BQ78350),
    ..BASE
};

static BQ20Z45_CHIP: Chip = Chip {
    name: "bq20z45",
    model: "bq20z45",
    documents: &[SBS, "SLUU264"],
    evidence: DRIVERS,
    asks: Some(&Asks { device_type: 0x0450, majors: &[], ways: BACK, sealed: 0x2000, failed: 0x0000 }),
    subcommands: BQ20Z_QUESTIONS,
    registers: joined!(WORDS, BQ20Z),
    ..BASE
};

static BQ20Z65_CHIP: Chip = Chip {
    name: "bq20z65",
    model: "bq20z65",
    documents: &[SBS, "SLUU264"],
    evidence: DRIVERS,
    asks: Some(&Asks { device_type: 0x0650, majors: &[], ways: BACK, sealed: 0x2000, failed: 0x0000 }),
    subcommands: BQ20Z_QUESTIONS,
    registers: joined!(WORDS, BQ20Z),
    ..BASE
};

/// Status words, measurements and lifetime data. Nothing else is asked.
#[rustfmt::skip]
static BASIC_QUESTIONS: &[Subcommand] = &[
    asks(0x0001, "DeviceType"),
    asks(0x0002, "FirmwareVersion"),
    asks(0x0051, "SafetyStatus"),
    asks(0x0053, "PFStatus"),
    asks(0x0054, "OperationStatus"),
    asks(0x0055, "ChargingStatus"),
    asks(0x0056, "GaugingStatus"),
];

#[rustfmt::skip]
static ALL_QUESTIONS: &[Subcommand] = &[
    asks(0x0001, "DeviceType"),
    asks(0x0002, "FirmwareVersion"),
    asks(0x0051, "SafetyStatus"),
    asks(0x0053, "PFStatus"),
    asks(0x0054, "OperationStatus"),
    asks(0x0055, "ChargingStatus"),
    asks(0x0056, "GaugingStatus"),
    asks(0x0060, "LifetimeDataBlock1"),
    asks(0x0061, "LifetimeDataBlock2"),
    asks(0x0062, "LifetimeDataBlock3"),
    asks(0x0063, "LifetimeDataBlock4"),
    asks(0x0064, "LifetimeDataBlock5"),
    asks(0x0071, "DAStatus1"),
    asks(0x0072, "DAStatus2"),
];

#[rustfmt::skip]
static MOST_QUESTIONS: &[Subcommand] = &[
    asks(0x0001, "DeviceType"),
    asks(0x0002, "FirmwareVersion"),
    asks(0x0051, "SafetyStatus"),
    asks(0x0053, "PFStatus"),
    asks(0x0054, "OperationStatus"),
    asks(0x0055, "ChargingStatus"),
    asks(0x0056, "GaugingStatus"),
    asks(0x0060, "LifetimeDataBlock1"),
    asks(0x0061, "LifetimeDataBlock2"),
    asks(0x0062, "LifetimeDataBlock3"),
    asks(0x0071, "DAStatus1"),
    asks(0x0072, "DAStatus2"),
];

#[rustfmt::skip]
static NEWER_QUESTIONS: &[Subcommand] = &[
    asks(0x0001, "DeviceType"),
    asks(0x0002, "FirmwareVersion"),
    asks(0x0051, "SafetyStatus"),
    asks(0x0053, "PFStatus"),
    asks(0x0054, "OperationStatus"),
    asks(0x0055, "ChargingStatus"),
    asks(0x0056, "GaugingStatus"),
    asks(0x0071, "DAStatus1"),
    asks(0x0072, "DAStatus2"),
];

#[rustfmt::skip]
static BQ20Z_QUESTIONS: &[Subcommand] = &[
    asks(0x0001, "DeviceType"),
    asks(0x0002, "FirmwareVersion"),
    asks(0x0006, "ManufacturerStatus"),
    asks(0x0051, "SafetyStatus"),
    asks(0x0053, "PFStatus"),
    asks(0x0054, "OperationStatus"),
];

#[rustfmt::skip]
const BQ40Z50: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ40Z50_SAFETY),
    status(0x0053, "PFStatus", BQ40Z50_PF),
    status(0x0054, "OperationStatus", BQ40Z50_OPERATION),
    status(0x0055, "ChargingStatus", BQ40Z50_CHARGING),
    status(0x0056, "GaugingStatus", BQ40Z50_GAUGING),
];

#[rustfmt::skip]
const BQ40Z50_R2: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ40Z50_R2_SAFETY),
    status(0x0053, "PFStatus", BQ40Z50_R2_PF),
    status(0x0054, "OperationStatus", BQ40Z50_OPERATION),
    status(0x0055, "ChargingStatus", BQ40Z50_R2_CHARGING),
    status(0x0056, "GaugingStatus", BQ40Z50_GAUGING),
];

#[rustfmt::skip]
const BQ40Z50_NEWER: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ40Z50_NEWER_SAFETY),
    status(0x0053, "PFStatus", BQ40Z50_PF),
    status(0x0054, "OperationStatus", BQ40Z50_OPERATION),
    status(0x0055, "ChargingStatus", BQ40Z50_NEWER_CHARGING),
    status(0x0056, "GaugingStatus", BQ40Z50_GAUGING),
];

#[rustfmt::skip]
const BQ4050: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ40Z50_SAFETY),
    status(0x0053, "PFStatus", BQ4050_PF),
    status(0x0054, "OperationStatus", BQ4050_OPERATION),
    status(0x0055, "ChargingStatus", BQ4050_CHARGING),
    status(0x0056, "GaugingStatus", BQ4050_GAUGING),
];

#[rustfmt::skip]
const BQ40Z80: &[Register] = &[
    status(0x0051, "SafetyStatus", &[]),
    status(0x0053, "PFStatus", &[]),
    status(0x0054, "OperationStatus", BQ40Z80_OPERATION),
    status(0x0055, "ChargingStatus", &[]),
    status(0x0056, "GaugingStatus", BQ40Z50_GAUGING),
];

#[rustfmt::skip]
const BQ30Z55: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ30Z55_SAFETY),
    status(0x0053, "PFStatus", BQ30Z55_PF),
    status(0x0054, "OperationStatus", BQ30Z55_OPERATION),
    status(0x0055, "ChargingStatus", BQ30Z55_CHARGING),
    status(0x0056, "GaugingStatus", BQ30Z55_GAUGING),
];

#[rustfmt::skip]
const BQ30Z554: &[Register] = &[
    status(0x0051, "SafetyStatus", BQ30Z55_SAFETY),
    status(0x0053, "PFStatus", BQ30Z554_PF),
    status(0x0054, "OperationStatus", BQ30Z554_OPERATION),
    status(0x0055, "ChargingStatus", BQ30Z55_CHARGING),
    status(0x0056, "GaugingStatus", BQ30Z55_GAUGING),
];

#[rustfmt::skip]
const BQ78350: &[Register] = &[
    status(0x0051, "SafetyStatus", &[]),
    status(0x0053, "PFStatus", BQ78350_PF),
    status(0x0054, "OperationStatus", BQ78350_OPERATION),
    status(0x0055, "ChargingStatus", &[]),
    status(0x0056, "GaugingStatus", BQ78350_GAUGING),
];

#[rustfmt::skip]
const MEASURED: &[Register] = &[
    Register::within(0x0071, 0, U(2), "DAStatus1 CellVoltage1", "mV", Tier::Poll),
    Register::within(0x0071, 2, U(2), "DAStatus1 CellVoltage2", "mV", Tier::Poll),
    Register::within(0x0071, 4, U(2), "DAStatus1 CellVoltage3", "mV", Tier::Poll),
    Register::within(0x0071, 6, U(2), "DAStatus1 CellVoltage4", "mV", Tier::Poll),
    Register::within(0x0071, 8, U(2), "DAStatus1 BATVoltage", "mV", Tier::Poll),
    Register::within(0x0071, 10, U(2), "DAStatus1 PACKVoltage", "mV", Tier::Poll),
    Register::within(0x0071, 12, I(2), "DAStatus1 CellCurrent1", "mA", Tier::Poll),
    Register::within(0x0071, 14, I(2), "DAStatus1 CellCurrent2", "mA", Tier::Poll),
    Register::within(0x0071, 16, I(2), "DAStatus1 CellCurrent3", "mA", Tier::Poll),
    Register::within(0x0071, 18, I(2), "DAStatus1 CellCurrent4", "mA", Tier::Poll),
    Register::within(0x0071, 20, I(2), "DAStatus1 CellPower1", "10 mW", Tier::Poll),
    Register::within(0x0071, 22, I(2), "DAStatus1 CellPower2", "10 mW", Tier::Poll),
    Register::within(0x0071, 24, I(2), "DAStatus1 CellPower3", "10 mW", Tier::Poll),
    Register::within(0x0071, 26, I(2), "DAStatus1 CellPower4", "10 mW", Tier::Poll),
    Register::within(0x0071, 28, I(2), "DAStatus1 Power", "10 mW", Tier::Poll),
    Register::within(0x0071, 30, I(2), "DAStatus1 AveragePower", "10 mW", Tier::Poll),
    Register::within(0x0072, 0, U(2), "DAStatus2 IntTemperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 2, U(2), "DAStatus2 TS1Temperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 4, U(2), "DAStatus2 TS2Temperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 6, U(2), "DAStatus2 TS3Temperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 8, U(2), "DAStatus2 TS4Temperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 10, U(2), "DAStatus2 CellTemperature", "0.1 K", Tier::Poll),
    Register::within(0x0072, 12, U(2), "DAStatus2 FETTemperature", "0.1 K", Tier::Poll),
];

#[rustfmt::skip]
const GAUGING_TEMPERATURE: &[Register] = &[
    Register::within(0x0072, 14, U(2), "DAStatus2 GaugingTemperature", "0.1 K", Tier::Poll),
];

#[rustfmt::skip]
const LIFETIME: &[Register] = &[
    Register::within(0x0060, 0, U(2), "Lifetime MaxVoltageCell1", "mV", Tier::Slow),
    Register::within(0x0060, 2, U(2), "Lifetime MaxVoltageCell2", "mV", Tier::Slow),
    Register::within(0x0060, 4, U(2), "Lifetime MaxVoltageCell3", "mV", Tier::Slow),
    Register::within(0x0060, 6, U(2), "Lifetime MaxVoltageCell4", "mV", Tier::Slow),
    Register::within(0x0060, 8, U(2), "Lifetime MinVoltageCell1", "mV", Tier::Slow),
    Register::within(0x0060, 10, U(2), "Lifetime MinVoltageCell2", "mV", Tier::Slow),
    Register::within(0x0060, 12, U(2), "Lifetime MinVoltageCell3", "mV", Tier::Slow),
    Register::within(0x0060, 14, U(2), "Lifetime MinVoltageCell4", "mV", Tier::Slow),
    Register::within(0x0060, 16, U(2), "Lifetime MaxDeltaCellVoltage", "mV", Tier::Slow),
    Register::within(0x0060, 18, I(2), "Lifetime MaxChargeCurrent", "mA", Tier::Slow),
    Register::within(0x0060, 20, I(2), "Lifetime MaxDischargeCurrent", "mA", Tier::Slow),
    Register::within(0x0060, 22, I(2), "Lifetime MaxAvgDischargeCurrent", "mA", Tier::Slow),
    Register::within(0x0060, 24, I(2), "Lifetime MaxAvgDischargePower", "10 mW", Tier::Slow),
    Register::within(0x0060, 26, I(1), "Lifetime MaxTempCell", "degC", Tier::Slow),
    Register::within(0x0060, 27, I(1), "Lifetime MinTempCell", "degC", Tier::Slow),
    Register::within(0x0060, 28, I(1), "Lifetime MaxDeltaCellTemp", "degC", Tier::Slow),
    Register::within(0x0060, 29, I(1), "Lifetime MaxTempIntSensor", "degC", Tier::Slow),
    Register::within(0x0060, 30, I(1), "Lifetime MinTempIntSensor", "degC", Tier::Slow),
    Register::within(0x0060, 31, I(1), "Lifetime MaxTempFET", "degC", Tier::Slow),
    Register::within(0x0061, 0, U(1), "Lifetime ShutdownCount", "", Tier::Slow),
    Register::within(0x0061, 1, U(1), "Lifetime PartialResetCount", "", Tier::Slow),
    Register::within(0x0061, 2, U(1), "Lifetime FullResetCount", "", Tier::Slow),
    Register::within(0x0061, 3, U(1), "Lifetime WatchdogResetCount", "", Tier::Slow),
    Register::within(0x0061, 4, U(1), "Lifetime BalancingTimeCell1", "", Tier::Slow),
    Register::within(0x0061, 5, U(1), "Lifetime BalancingTimeCell2", "", Tier::Slow),
    Register::within(0x0061, 6, U(1), "Lifetime BalancingTimeCell3", "", Tier::Slow),
    Register::within(0x0061, 7, U(1), "Lifetime BalancingTimeCell4", "", Tier::Slow),
    Register::within(0x0062, 0, U(2), "Lifetime TotalRunTime", "", Tier::Slow),
    Register::within(0x0062, 2, U(2), "Lifetime TimeInUT", "", Tier::Slow),
    Register::within(0x0062, 4, U(2), "Lifetime TimeInLT", "", Tier::Slow),
    Register::within(0x0062, 6, U(2), "Lifetime TimeInSTL", "", Tier::Slow),
    Register::within(0x0062, 8, U(2), "Lifetime TimeInRT", "", Tier::Slow),
    Register::within(0x0062, 10, U(2), "Lifetime TimeInSTH", "", Tier::Slow),
    Register::within(0x0062, 12, U(2), "Lifetime TimeInHT", "", Tier::Slow),
    Register::within(0x0062, 14, U(2), "Lifetime TimeInOT", "", Tier::Slow),
];

#[rustfmt::skip]
const LIFETIME_EVENTS: &[Register] = &[
    Register::within(0x0063, 0, U(2), "Lifetime COVCount", "", Tier::Slow),
    Register::within(0x0063, 2, U(2), "Lifetime COVLastCycle", "", Tier::Slow),
    Register::within(0x0063, 4, U(2), "Lifetime CUVCount", "", Tier::Slow),
    Register::within(0x0063, 6, U(2), "Lifetime CUVLastCycle", "", Tier::Slow),
    Register::within(0x0063, 8, U(2), "Lifetime OCD1Count", "", Tier::Slow),
    Register::within(0x0063, 10, U(2), "Lifetime OCD1LastCycle", "", Tier::Slow),
    Register::within(0x0063, 12, U(2), "Lifetime OCD2Count", "", Tier::Slow),
    Register::within(0x0063, 14, U(2), "Lifetime OCD2LastCycle", "", Tier::Slow),
    Register::within(0x0063, 16, U(2), "Lifetime OCC1Count", "", Tier::Slow),
    Register::within(0x0063, 18, U(2), "Lifetime OCC1LastCycle", "", Tier::Slow),
    Register::within(0x0063, 20, U(2), "Lifetime OCC2Count", "", Tier::Slow),
    Register::within(0x0063, 22, U(2), "Lifetime OCC2LastCycle", "", Tier::Slow),
    Register::within(0x0063, 24, U(2), "Lifetime AOLDCount", "", Tier::Slow),
    Register::within(0x0063, 26, U(2), "Lifetime AOLDLastCycle", "", Tier::Slow),
    Register::within(0x0063, 28, U(2), "Lifetime ASCDCount", "", Tier::Slow),
    Register::within(0x0063, 30, U(2), "Lifetime ASCDLastCycle", "", Tier::Slow),
    Register::within(0x0064, 0, U(2), "Lifetime ASCCCount", "", Tier::Slow),
    Register::within(0x0064, 2, U(2), "Lifetime ASCCLastCycle", "", Tier::Slow),
    Register::within(0x0064, 4, U(2), "Lifetime OTCCount", "", Tier::Slow),
    Register::within(0x0064, 6, U(2), "Lifetime OTCLastCycle", "", Tier::Slow),
    Register::within(0x0064, 8, U(2), "Lifetime OTDCount", "", Tier::Slow),
    Register::within(0x0064, 10, U(2), "Lifetime OTDLastCycle", "", Tier::Slow),
    Register::within(0x0064, 12, U(2), "Lifetime OTFCount", "", Tier::Slow),
    Register::within(0x0064, 14, U(2), "Lifetime OTFLastCycle", "", Tier::Slow),
    Register::within(0x0064, 16, U(2), "Lifetime ValidChargeTerminationCount", "", Tier::Slow),
    Register::within(0x0064, 18, U(2), "Lifetime ValidChargeTerminationLastCycle", "", Tier::Slow),
    Register::within(0x0064, 20, U(2), "Lifetime QmaxUpdateCount", "", Tier::Slow),
    Register::within(0x0064, 22, U(2), "Lifetime QmaxUpdateLastCycle", "", Tier::Slow),
    Register::within(0x0064, 24, U(2), "Lifetime RaUpdateCount", "", Tier::Slow),
    Register::within(0x0064, 26, U(2), "Lifetime RaUpdateLastCycle", "", Tier::Slow),
    Register::within(0x0064, 28, U(2), "Lifetime RaDisableCount", "", Tier::Slow),
    Register::within(0x0064, 30, U(2), "Lifetime RaDisableLastCycle", "", Tier::Slow),
];

#[rustfmt::skip]
const CELLS_5_TO_15: &[Register] = &[
    cell(0x3b, "CellVoltage5"),
    cell(0x3a, "CellVoltage6"),
    cell(0x39, "CellVoltage7"),
    cell(0x38, "CellVoltage8"),
    cell(0x37, "CellVoltage9"),
    cell(0x36, "CellVoltage10"),
    cell(0x35, "CellVoltage11"),
    cell(0x34, "CellVoltage12"),
    cell(0x33, "CellVoltage13"),
    cell(0x32, "CellVoltage14"),
    cell(0x31, "CellVoltage15"),
];

#[rustfmt::skip]
const BQ20Z: &[Register] = &[
    Register::answer(0x0006, U(2), "ManufacturerStatus", "", Tier::Poll),
    word_status(0x0051, "SafetyStatus", &[]),
    word_status(0x0053, "PFStatus", &[]),
    word_status(0x0054, "OperationStatus", BQ20Z_OPERATION),
];

#[rustfmt::skip]
static BQ40Z50_SAFETY: &[Bit] = &[
    bit(27, "UTD"), bit(26, "UTC"), bit(25, "PCHGC"), bit(24, "CHGV"), bit(23, "CHGC"), bit(22, "OC"), bit(20, "CTO"),
    bit(18, "PTO"), bit(16, "OTF"), bit(14, "CUVC"), bit(13, "OTD"), bit(12, "OTC"), bit(11, "ASCDL"),
    bit(10, "ASCD"), bit(9, "ASCCL"), bit(8, "ASCC"), bit(7, "AOLDL"), bit(6, "AOLD"), bit(5, "OCD2"), bit(4, "OCD1"),
    bit(3, "OCC2"), bit(2, "OCC1"), bit(1, "COV"), bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ40Z50_PF: &[Bit] = &[
    bit(31, "TS4"), bit(30, "TS3"), bit(29, "TS2"), bit(28, "TS1"), bit(26, "DFW"), bit(25, "OPNCELL"),
    bit(24, "IFC"), bit(23, "PTC"), bit(22, "2LVL"), bit(21, "AFEC"), bit(20, "AFER"), bit(19, "FUSE"),
    bit(17, "DFETF"), bit(16, "CFETF"), bit(12, "VIMA"), bit(11, "VIMR"), bit(10, "CD"), bit(9, "IMP"), bit(8, "CB"),
    bit(7, "QIM"), bit(6, "SOTF"), bit(4, "SOT"), bit(3, "SOCD"), bit(2, "SOCC"), bit(1, "SOV"), bit(0, "SUV"),
];

#[rustfmt::skip]
static BQ40Z50_OPERATION: &[Bit] = &[
    bit(29, "EMSHUT"), bit(28, "CB"), bit(27, "SLPCC"), bit(26, "SLPAD"), bit(25, "SMBLCAL"), bit(24, "INIT"),
    bit(23, "SLEEPM"), bit(22, "XL"), bit(21, "CAL_OFFSET"), bit(20, "CAL"), bit(19, "AUTOCALM"), bit(18, "AUTH"),
    bit(17, "LED"), bit(16, "SDM"), bit(15, "SLEEP"), bit(14, "XCHG"), bit(13, "XDSG"), bit(12, "PF"), bit(11, "SS"),
    bit(10, "SDV"), bit(9, "SEC1"), bit(8, "SEC0"), bit(7, "BTP_INT"), bit(5, "FUSE"), bit(3, "PCHG"), bit(2, "CHG"),
    bit(1, "DSG"), bit(0, "PRES"),
];

#[rustfmt::skip]
static BQ40Z50_CHARGING: &[Bit] = &[
    bit(17, "CCC"), bit(16, "CVR"), bit(15, "CCR"), bit(14, "VCT"), bit(13, "MCHG"), bit(12, "IN"), bit(11, "HV"),
    bit(10, "MV"), bit(9, "LV"), bit(8, "PV"), bit(6, "OT"), bit(5, "HT"), bit(4, "STH"), bit(3, "RT"), bit(2, "STL"),
    bit(1, "LT"), bit(0, "UT"),
];

#[rustfmt::skip]
static BQ40Z50_GAUGING: &[Bit] = &[
    bit(20, "OCVFR"), bit(19, "LDMD"), bit(18, "RX"), bit(17, "QMax"), bit(16, "VDQ"), bit(15, "NSFM"),
    bit(13, "SLPQMax"), bit(12, "QEN"), bit(11, "VOK"), bit(10, "R_DIS"), bit(8, "REST"), bit(7, "CF"), bit(6, "DSG"),
    bit(5, "EDV"), bit(4, "BAL_EN"), bit(3, "TC"), bit(2, "TD"), bit(1, "FC"), bit(0, "FD"),
];

#[rustfmt::skip]
static BQ40Z50_R2_SAFETY: &[Bit] = &[
    bit(29, "OCDL"), bit(28, "COVL"), bit(27, "UTD"), bit(26, "UTC"), bit(25, "PCHGC"), bit(24, "CHGV"),
    bit(23, "CHGC"), bit(22, "OC"), bit(20, "CTO"), bit(18, "PTO"), bit(16, "OTF"), bit(14, "CUVC"), bit(13, "OTD"),
    bit(12, "OTC"), bit(11, "ASCDL"), bit(10, "ASCD"), bit(9, "ASCCL"), bit(8, "ASCC"), bit(7, "AOLDL"),
    bit(6, "AOLD"), bit(5, "OCD2"), bit(4, "OCD1"), bit(3, "OCC2"), bit(2, "OCC1"), bit(1, "COV"), bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ40Z50_R2_PF: &[Bit] = &[
    bit(31, "TS4"), bit(30, "TS3"), bit(29, "TS2"), bit(28, "TS1"), bit(26, "DFW"), bit(24, "IFC"), bit(23, "PTC"),
    bit(22, "2LVL"), bit(21, "AFEC"), bit(20, "AFER"), bit(19, "FUSE"), bit(18, "OCDL"), bit(17, "DFETF"),
    bit(16, "CFETF"), bit(15, "ASCDL"), bit(14, "ASCCL"), bit(13, "AOLDL"), bit(12, "VIMA"), bit(11, "VIMR"),
    bit(10, "CD"), bit(9, "IMP"), bit(8, "CB"), bit(7, "QIM"), bit(6, "SOTF"), bit(5, "COVL"), bit(4, "SOT"),
    bit(3, "SOCD"), bit(2, "SOCC"), bit(1, "SOV"), bit(0, "SUV"),
];

#[rustfmt::skip]
static BQ40Z50_R2_CHARGING: &[Bit] = &[
    bit(19, "NCT"), bit(18, "CCC"), bit(17, "CVR"), bit(16, "CCR"), bit(15, "VCT"), bit(14, "MCHG"), bit(13, "SU"),
    bit(12, "IN"), bit(11, "HV"), bit(10, "MV"), bit(9, "LV"), bit(8, "PV"), bit(6, "OT"), bit(5, "HT"),
    bit(4, "STH"), bit(3, "RT"), bit(2, "STL"), bit(1, "LT"), bit(0, "UT"),
];

#[rustfmt::skip]
static BQ40Z50_NEWER_SAFETY: &[Bit] = &[
    bit(27, "UTD"), bit(26, "UTC"), bit(25, "PCHGC"), bit(24, "CHGV"), bit(23, "CHGC"), bit(22, "OC"), bit(20, "CTO"),
    bit(19, "PTOS"), bit(18, "PTO"), bit(16, "OTF"), bit(14, "CUVC"), bit(13, "OTD"), bit(12, "OTC"),
    bit(11, "ASCDL"), bit(10, "ASCD"), bit(9, "ASCCL"), bit(8, "ASCC"), bit(7, "AOLDL"), bit(6, "AOLD"),
    bit(5, "OCD2"), bit(4, "OCD1"), bit(3, "OCC2"), bit(2, "OCC1"), bit(1, "COV"), bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ40Z50_NEWER_CHARGING: &[Bit] = &[
    bit(21, "ERETM"), bit(20, "ERM"), bit(19, "NCT"), bit(18, "CCC"), bit(17, "CVR"), bit(16, "CCR"), bit(15, "VCT"),
    bit(14, "MCHG"), bit(13, "SU"), bit(12, "IN"), bit(11, "HV"), bit(10, "MV"), bit(9, "LV"), bit(8, "PV"),
    bit(6, "OT"), bit(5, "HT"), bit(4, "STH"), bit(3, "RT"), bit(2, "STL"), bit(1, "LT"), bit(0, "UT"),
];

#[rustfmt::skip]
static BQ4050_PF: &[Bit] = &[
    bit(31, "TS4"), bit(30, "TS3"), bit(29, "TS2"), bit(28, "TS1"), bit(26, "DFW"), bit(25, "OPNCELL"),
    bit(24, "IFC"), bit(23, "PTC"), bit(22, "2LVL"), bit(21, "AFEC"), bit(20, "AFER"), bit(19, "FUSE"),
    bit(17, "DFETF"), bit(16, "CFETF"), bit(12, "VIMA"), bit(11, "VIMR"), bit(6, "SOTF"), bit(4, "SOT"),
    bit(3, "SOCD"), bit(2, "SOCC"), bit(1, "SOV"), bit(0, "SUV"),
];

#[rustfmt::skip]
static BQ4050_OPERATION: &[Bit] = &[
    bit(29, "EMSHUT"), bit(28, "CB"), bit(27, "SLPCC"), bit(26, "SLPAD"), bit(25, "SMBLCAL"), bit(24, "INIT"),
    bit(23, "SLEEPM"), bit(22, "XL"), bit(21, "CAL_OFFSET"), bit(20, "CAL"), bit(19, "AUTOCALM"), bit(18, "AUTH"),
    bit(17, "LED"), bit(16, "SDM"), bit(15, "SLEEP"), bit(14, "XCHG"), bit(13, "XDSG"), bit(12, "PF"), bit(11, "SS"),
    bit(10, "SDV"), bit(9, "SEC1"), bit(8, "SEC0"), bit(7, "BTP_INT"), bit(6, "SMOOTH"), bit(5, "FUSE"),
    bit(3, "PCHG"), bit(2, "CHG"), bit(1, "DSG"), bit(0, "PRES"),
];

#[rustfmt::skip]
static BQ4050_CHARGING: &[Bit] = &[
    bit(15, "TAPER"), bit(10, "CCC"), bit(9, "CVR"), bit(8, "CCR"), bit(7, "VCT"), bit(6, "MCHG"), bit(5, "SU"),
    bit(4, "IN"), bit(3, "HV"), bit(2, "MV"), bit(1, "LV"), bit(0, "PV"),
];

#[rustfmt::skip]
static BQ4050_GAUGING: &[Bit] = &[
    bit(15, "VDQ"), bit(14, "EDV2"), bit(13, "EDV1"), bit(10, "FCCX"), bit(7, "CF"), bit(6, "DSG"), bit(5, "EDV0"),
    bit(4, "BAL_EN"), bit(3, "TC"), bit(2, "TD"), bit(1, "FC"), bit(0, "FD"),
];

#[rustfmt::skip]
static BQ40Z80_OPERATION: &[Bit] = &[
    bit(17, "LED"), bit(14, "XCHG"), bit(13, "XDSG"), bit(9, "SEC1"), bit(8, "SEC0"), bit(4, "PDSG"), bit(3, "PCHG"),
    bit(2, "CHG"), bit(1, "DSG"),
];

#[rustfmt::skip]
static BQ30Z55_SAFETY: &[Bit] = &[
    bit(24, "CHGV"), bit(23, "CHGC"), bit(22, "OC"), bit(20, "CTO"), bit(18, "PTO"), bit(17, "HWD"), bit(16, "OTF"),
    bit(14, "CUVC"), bit(13, "OTD"), bit(12, "OTC"), bit(11, "SCDL"), bit(10, "SCD"), bit(9, "SCCL"), bit(8, "SCC"),
    bit(7, "OLDL"), bit(6, "OLD"), bit(5, "OCD2"), bit(4, "OCD1"), bit(3, "OCC2"), bit(2, "OCC1"), bit(1, "COV"),
    bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ30Z55_PF: &[Bit] = &[
    bit(26, "DFW"), bit(25, "OCECO"), bit(24, "IFC"), bit(23, "PTC"), bit(22, "2LVL"), bit(21, "AFEC"),
    bit(20, "AFER"), bit(19, "FUSE"), bit(18, "TH"), bit(17, "DFET"), bit(16, "CFETF"), bit(12, "VIMA"),
    bit(11, "VIMR"), bit(10, "CD"), bit(9, "IMP"), bit(8, "CB"), bit(7, "QIM"), bit(6, "OTF"), bit(4, "OTCE"),
    bit(1, "COV"), bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ30Z55_OPERATION: &[Bit] = &[
    bit(28, "XL"), bit(27, "SLEEPC"), bit(26, "SLEEPQMax"), bit(25, "SMBLCAL"), bit(24, "INIT"), bit(23, "SLEEPM"),
    bit(22, "SDV"), bit(21, "CALO"), bit(20, "FVS"), bit(19, "AWD"), bit(18, "AUTH"), bit(17, "SHIPM"),
    bit(16, "SDM"), bit(15, "SLEEP"), bit(14, "XCHG"), bit(13, "XDSG"), bit(12, "PF"), bit(11, "SS"), bit(10, "CAL"),
    bit(9, "SEC1"), bit(8, "SEC0"), bit(7, "LED"), bit(6, "CB"), bit(5, "FUSE"), bit(4, "GPOD"), bit(3, "PCHG"),
    bit(2, "CHG"), bit(1, "DSG"), bit(0, "PRES"),
];

#[rustfmt::skip]
static BQ30Z55_CHARGING: &[Bit] = &[
    bit(15, "CCC"), bit(14, "CVR"), bit(13, "CCR"), bit(12, "SU"), bit(11, "IN"), bit(10, "HV"), bit(9, "MV"),
    bit(8, "LV"), bit(7, "PV"), bit(6, "OT"), bit(5, "HT"), bit(4, "ST"), bit(3, "RT"), bit(2, "STL"), bit(1, "LT"),
    bit(0, "UT"),
];

#[rustfmt::skip]
static BQ30Z55_GAUGING: &[Bit] = &[
    bit(15, "LPF"), bit(14, "TCA"), bit(13, "TDA"), bit(12, "OCVFR"), bit(11, "LDMD"), bit(10, "RX"), bit(9, "QMax"),
    bit(8, "VDQ"), bit(7, "NSFM"), bit(6, "FC"), bit(5, "FD"), bit(4, "QEN"), bit(3, "VOK"), bit(2, "RU"),
    bit(1, "DSG"), bit(0, "REST"),
];

#[rustfmt::skip]
static BQ30Z554_PF: &[Bit] = &[
    bit(26, "DFW"), bit(25, "OCECO"), bit(24, "IFC"), bit(23, "PTC"), bit(22, "2LVL"), bit(21, "AFEC"),
    bit(20, "AFER"), bit(19, "FUSE"), bit(18, "THERM"), bit(17, "DFET"), bit(16, "CFETF"), bit(12, "VIMA"),
    bit(11, "VIMR"), bit(10, "CD"), bit(9, "IMP"), bit(8, "CB"), bit(7, "QIM"), bit(6, "OTF"), bit(4, "OTCE"),
    bit(1, "COV"), bit(0, "CUV"),
];

#[rustfmt::skip]
static BQ30Z554_OPERATION: &[Bit] = &[
    bit(28, "XL"), bit(27, "SLEEPC"), bit(26, "SLEEPQMax"), bit(25, "SMBLCAL"), bit(24, "INIT"), bit(23, "SLEEPM"),
    bit(22, "SDV"), bit(21, "CALO"), bit(20, "FVS"), bit(19, "AWD"), bit(18, "AUTH"), bit(16, "SDM"),
    bit(15, "SLEEP"), bit(14, "XCHG"), bit(13, "XDSG"), bit(12, "PF"), bit(11, "SS"), bit(10, "CAL"), bit(9, "SEC1"),
    bit(8, "SEC0"), bit(6, "CB"), bit(5, "FUSE"), bit(4, "GPOD"), bit(3, "PCHG"), bit(2, "CHG"), bit(1, "DSG"),
    bit(0, "PRES"),
];

#[rustfmt::skip]
static BQ78350_PF: &[Bit] = &[
    bit(5, "VIMR"), bit(4, "SOT"), bit(3, "SOCD"), bit(2, "SOCC"), bit(1, "SOV"), bit(0, "SUV"),
];

#[rustfmt::skip]
static BQ78350_OPERATION: &[Bit] = &[
    bit(31, "KEYIN"), bit(28, "CB"), bit(27, "SLPCC"), bit(26, "SLPAD"), bit(24, "INIT"), bit(23, "SLEEPM"),
    bit(22, "XL"), bit(21, "CAL_OFFSET"), bit(20, "CAL"), bit(18, "AUTH"), bit(17, "LED"), bit(16, "SDM"),
    bit(15, "SLEEP"), bit(14, "XCHG"), bit(13, "XDSG"), bit(12, "PF"), bit(11, "SS"), bit(10, "SDV"), bit(9, "SEC1"),
    bit(8, "SEC0"), bit(5, "SAFE"), bit(4, "HCFET"), bit(3, "PCHG"), bit(2, "DSG"), bit(1, "CHG"), bit(0, "PRES"),
];

#[rustfmt::skip]
static BQ78350_GAUGING: &[Bit] = &[
    bit(14, "EDV2"), bit(13, "EDV1"), bit(10, "FCCX"), bit(8, "REST"), bit(7, "CF"), bit(6, "DSG"), bit(5, "EDV0"),
    bit(4, "BAL_OK"), bit(3, "TC"), bit(2, "TD"), bit(1, "FC"), bit(0, "FD"),
];

#[rustfmt::skip]
static BQ20Z_OPERATION: &[Bit] = &[
    bit(15, "PRES"), bit(14, "FAS"), bit(13, "SS"),
];

const fn count(lists: &[&[Register]]) -> usize {
    let (mut count, mut at) = (0, 0);
    while at < lists.len() {
        count += lists[at].len();
        at += 1;
    }
    count
}

const fn join<const N: usize>(lists: &[&[Register]]) -> [Register; N] {
    let mut all = [lists[0][0]; N];
    let (mut list, mut from, mut to) = (0, 0, 0);
    while to < N {
        if from == lists[list].len() {
            (list, from) = (list + 1, 0);
        }
        all[to] = lists[list][from];
        (from, to) = (from + 1, to + 1);
    }
    all
}

const fn asks(code: u16, name: &'static str) -> Subcommand {
    Subcommand::new(code, name, Effect::Answers)
}

const fn bit(number: u32, name: &'static str) -> Bit {
    Bit::new(1 << number, name)
}

/// Bits, in as many bytes as the firmware has: five on a bq40z50-R5, two to four on the others.
const fn status(code: u16, name: &'static str, bits: &'static [Bit]) -> Register {
    Register::answer(code, U(5), name, "", Tier::Poll).bits(bits).tells_all()
}

const fn word_status(code: u16, name: &'static str, bits: &'static [Bit]) -> Register {
    Register::answer(code, U(2), name, "", Tier::Poll).bits(bits).tells_all()
}
