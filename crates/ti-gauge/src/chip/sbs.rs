// SPDX-License-Identifier: MIT

//! A Smart Battery: any pack by the Smart Battery Data Specification 1.1 (SBS 1.1), of any maker.
//!
//! Its words are at command codes, which are no addresses. It is only read. Codes that makers have given other meanings
//! have no row, and what has no row is not read: 0x2F, which takes a waiting challenge, 0x23, and 0x43 and above.
//! CellVoltage1() to CellVoltage4() are TI's (SLUUBK0B 14.35), and a maker's own words in other packs.

use super::{Access, Scheme};
use super::{
    Bit, Chip, Condition, Evidence, Identity, Preflight, Register, Role, Scale, Scaling, Security, Source,
    Tier,
};
use crate::codec::Layout;
use crate::value::Type::{self, I, S, U};

pub mod failures;
pub mod ti;

/// The address that the System Management Bus gives to a Smart Battery.
pub(crate) const ADDRESS: u8 = 0x0b;
const BATTERY_MODE: u8 = 0x03;
/// SpecificationInfo(), whose upper digits are the powers of ten of voltages, and of currents and capacities (SBS 1.1, 5.1.25).
pub(crate) const SPECIFICATION_INFO: u8 = 0x1a;
pub(crate) const SERIAL_NUMBER: u8 = 0x1c;
const VOLTS: u8 = 8;
const AMPERES: u8 = 12;
/// A conditioning cycle is requested (5.1.4).
pub const CONDITION_FLAG: (Source, u32) = (Source::Command(BATTERY_MODE), 0x0080);
/// Capacities are in 10 mWh (5.1.4).
const CAPACITY_MODE: u32 = 0x8000;
/// The longest block of SMBus, and its length.
const BLOCK: u8 = 33;

/// Whether a word can be that of SpecificationInfo(): revision 1, version 1 to 3, and two powers of ten up to 3 (5.1.25).
pub(crate) fn is_specification(info: u16) -> bool {
    info & 0xf == 1 && (1..=3).contains(&(info >> 4 & 0xf)) && info >> 8 & 0xf <= 3 && info >> 12 <= 3
}

/// Any Smart Battery.
pub static CHIP: Chip = BASE;

/// What a gauge of TI's in one has as well.
pub(super) const BASE: Chip = Chip {
    name: "sbs",
    model: "Smart Battery",
    documents: &[
        "Smart Battery Data Specification 1.1",
        "System Management Bus Specification 1.1",
        "SLUUBK0B",
    ],
    evidence: &[Evidence::Manual, Evidence::Drivers, Evidence::Transcript],
    identity: Identity::NONE,
    firmware_file: None,
    technology: "Unknown",
    address: ADDRESS,
    layout: Layout::TI,
    flat: 0..0,
    registers: WORDS,
    subcommands: &[],
    control_status: &[],
    condition: Condition {
        full: 0x0020, // FULLY_CHARGED
        low: 0x0200,  // REMAINING_CAPACITY_ALARM
        critical: 0,
        overheat: 0x1000, // OVER_TEMP_ALARM
        cold: 0,
        over_voltage: 0,
        under_voltage: 0,
        present: 0,
        absent: 0,
        uncertain: 0,
        certain: 0x0080, // INITIALIZED
        empty: 0x0010,   // FULLY_DISCHARGED
        complete: None,
        primary: None,
    },
    // Not of ChargingCurrent() and ChargingVoltage().
    scaling: Scaling {
        voltage: Scale::Power(Source::Command(SPECIFICATION_INFO), &[VOLTS]),
        current: Scale::Power(Source::Command(SPECIFICATION_INFO), &[AMPERES]),
        charge: Scale::Power(Source::Command(SPECIFICATION_INFO), &[AMPERES]),
        energy: Scale::Power(Source::Command(SPECIFICATION_INFO), &[VOLTS, AMPERES]),
        scaled: None,
    },
    security: Security::NONE,
    asks: None,
    access: Access { scheme: Scheme::Smbus, ..Access::NONE },
    gate: None,
    calibration: None,
    authentication: None,
    subclasses: &[],
    byte_writes_above_hz: None,
    signature: &[],
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight::NONE,
};

#[rustfmt::skip]
const WORDS: &[Register] = &[
    Register::new(0x01, U(2), "RemainingCapacityAlarm", "", Tier::Slow),
    Register::new(0x02, U(2), "RemainingTimeAlarm", "min", Tier::Slow),
    Register::new(BATTERY_MODE, U(2), "BatteryMode", "", Tier::Poll).bits(BATTERY_MODES),
    word(0x08, U(2), "Temperature", "0.1 K", Role::Temp),
    word(0x09, U(2), "Voltage", "mV", Role::VoltageNow).values(1, 0xfffe, NO_WORD),
    word(0x0a, I(2), "Current", "mA", Role::CurrentNow),
    word(0x0b, I(2), "AverageCurrent", "mA", Role::CurrentAvg),
    word(0x0c, U(2), "MaxError", "%", Role::CapacityErrorMargin).values(0, 100, "SBS 1.1, 5.1.13: 0 to 100"),
    word(0x0d, U(2), "RelativeStateOfCharge", "%", Role::Capacity).values(0, 0xff, "SBS 1.1, 5.1.14: more than 100 occurs"),
    Register::new(0x0e, U(2), "AbsoluteStateOfCharge", "%", Tier::Slow),
    capacity(0x0f, "RemainingCapacity", Role::ChargeNow, Role::EnergyNow).values(0, 0xfffe, NO_WORD),
    capacity(0x10, "FullChargeCapacity", Role::ChargeFull, Role::EnergyFull),
    word(0x11, U(2), "RunTimeToEmpty", "min", Role::TimeToEmptyNow),
    word(0x12, U(2), "AverageTimeToEmpty", "min", Role::TimeToEmptyAvg),
    word(0x13, U(2), "AverageTimeToFull", "min", Role::TimeToFullAvg),
    Register::new(0x14, U(2), "ChargingCurrent", "mA", Tier::Slow),
    Register::new(0x15, U(2), "ChargingVoltage", "mV", Tier::Slow),
    word(0x16, U(2), "BatteryStatus", "", Role::Flags).bits(BATTERY_STATUS),
    Register::new(0x17, U(2), "CycleCount", "", Tier::Slow).role(Role::CycleCount),
    capacity(0x18, "DesignCapacity", Role::ChargeFullDesign, Role::EnergyFullDesign),
    Register::new(0x19, U(2), "DesignVoltage", "mV", Tier::Static),
    Register::new(SPECIFICATION_INFO, U(2), "SpecificationInfo", "", Tier::Static),
    Register::new(0x1b, U(2), "ManufactureDate", "", Tier::Static).role(Role::ManufactureDate),
    // Another one is another pack, which may have taken its place between two polls.
    word(SERIAL_NUMBER, U(2), "SerialNumber", "", Role::SerialNumber),
    Register::new(0x20, S(BLOCK), "ManufacturerName", "", Tier::Static).role(Role::Manufacturer),
    Register::new(0x21, S(BLOCK), "DeviceName", "", Tier::Static).role(Role::ModelName),
    Register::new(0x22, S(BLOCK), "DeviceChemistry", "", Tier::Static).role(Role::Technology),
    cell(0x3c, "CellVoltage4"),
    cell(0x3d, "CellVoltage3"),
    cell(0x3e, "CellVoltage2"),
    cell(0x3f, "CellVoltage1"),
];

const NO_WORD: &str = "65535 is what a bus without an answer reads";

#[rustfmt::skip]
static BATTERY_MODES: &[Bit] = &[
    Bit::new(CAPACITY_MODE, "CAPM"), Bit::new(0x4000, "CHGM"), Bit::new(0x2000, "AM"), Bit::new(0x0200, "PB"),
    Bit::new(0x0100, "CC"), Bit::new(0x0080, "CF"), Bit::new(0x0002, "PBS"), Bit::new(0x0001, "ICC"),
];

#[rustfmt::skip]
static BATTERY_STATUS: &[Bit] = &[
    Bit::new(0x8000, "OCA"), Bit::new(0x4000, "TCA"), Bit::new(0x1000, "OTA"), Bit::new(0x0800, "TDA"),
    Bit::new(0x0200, "RCA"), Bit::new(0x0100, "RTA"), Bit::new(0x0080, "INIT"), Bit::new(0x0040, "DSG"),
    Bit::new(0x0020, "FC"), Bit::new(0x0010, "FD"),
];

const fn word(code: u8, kind: Type, name: &'static str, unit: &'static str, role: Role) -> Register {
    Register::new(code, kind, name, unit, Tier::Poll).role(role)
}

/// In mAh, or in 10 mWh as the pack is set. The mode is taken as it is found.
const fn capacity(code: u8, name: &'static str, charge: Role, energy: Role) -> Register {
    let row = word(code, U(2), name, "", charge).values(1, 0xfffe, "0 is not known, 65535 no answer");
    row.or((BATTERY_MODE, CAPACITY_MODE), energy, (10, 1))
}

/// Where no cell is, packs have 0.
const fn cell(code: u8, name: &'static str) -> Register {
    Register::new(code, U(2), name, "mV", Tier::Poll).values(1000, 5000, "a cell in use")
}
