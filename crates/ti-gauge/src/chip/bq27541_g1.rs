// SPDX-License-Identifier: MIT

//! bq27541-G1 and bq27545-G1, one generation: Impedance Track gauges on the pack's side. Their data flash is known
//! by names, and nothing is written to it.
//!
//! Single pages of both tables are public, so a row has one source: of the bq27541-G1 page 22 of SLUSAL6C (classes
//! 58 to 80, offset 69), of the bq27545-G1 the beginning of Table 17 of SLUSAT0E (classes 2 to 48) and three rows
//! that Linux has switched off, Terminate Voltage among them. The only row of both is at one place. The printed
//! default of Design Energy is not legible, so it has none.
//!
//! Four parts answer 0x0541, and firmware 0x0224 is printed for the bq27541-G1 only. No source prints what a
//! bq27545-G1 answers: 0x0545 is inferred from its name, so it has to be named by the user.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never};
use super::Tier::{Poll, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, Identity, KeyStorage, Kind, Parameter as P, Preflight, Register,
    Role, Scaling, Scheme, SealStatus, Security, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27541-G1.
pub static CHIP: Chip = only_names(
    "bq27541-g1",
    "bq27541-G1",
    &["SLUSAL6C, pages 12, 19 and 22"],
    &[Evidence::Drivers, Evidence::Transcript],
    (0x0541, &[0x0224]),
    REGISTERS,
    SUBCLASSES,
);

/// The bq27545-G1.
pub static BQ27545_G1: Chip = only_names(
    "bq27545-g1",
    "bq27545-G1",
    &["SLUSAT0E, the beginning of Table 17", "Linux 6.12, bq27xxx_battery.c"],
    &[Evidence::Drivers],
    (0x0545, &[]),
    REGISTERS_27545,
    SUBCLASSES_27545,
);

/// A gauge of this family whose data flash is only read. It is unsealed for that with the family's key, and sealed
/// again.
pub(super) const fn only_names(
    name: &'static str,
    model: &'static str,
    documents: &'static [&'static str],
    evidence: &'static [Evidence],
    (device_type, firmware): (u16, &'static [u16]),
    registers: &'static [Register],
    subclasses: &'static [Subclass],
) -> Chip {
    Chip {
        name,
        model,
        documents,
        evidence,
        identity: Identity {
            device_type,
            firmware,
            build: None,
            hardware: None,
            dm_codes: &[],
            answer: 0x00,
        },
        firmware_file: None,
        technology: "Li-ion",
        address: GAUGE_ADDRESS,
        layout: Layout::TI,
        flat: 0..0,
        registers,
        subcommands: SUBCOMMANDS,
        control_status: CONTROL_STATUS,
        condition: Condition {
            full: 0x0200,     // [FC]
            low: 0x0004,      // [SOC1]
            critical: 0x0002, // [SOCF]
            overheat: 0xC000, // [OTC], [OTD]
            cold: 0,
            over_voltage: 0,
            under_voltage: 0,
            present: 0,
            absent: 0,
            uncertain: 0,
            certain: 0,
            empty: 0,
            complete: None,
            primary: None,
        },
        scaling: Scaling::NONE,
        security: SECURITY,
        asks: None,
        access: ACCESS,
        gate: None,
        authentication: None,
        subclasses,
        byte_writes_above_hz: Some(100_000),
        calibration: None,
        signature: &[],
        volatile: None,
        quirks: &[],
        rom_image: None,
        preflight: Preflight::NONE,
    }
}

const SECURITY: Security = Security {
    status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
    // The kernel's driver has it for the whole family.
    default_unseal: [0x0414, 0x3672],
    full_access: true,
    seal: 0x0020,
    // TI's advice to owners of relatives whose keys were refused.
    shows: Security::SHOWS,
    key_silence: Duration::from_millis(5200),
    seals_itself: None,
    shown_sealed: &[],
    storage: KeyStorage::Fixed("no public source has their place"),
};

const ACCESS: Access = Access {
    scheme: Scheme::Block,
    // A shipped driver for the bq27520-G3; no document gives it.
    select: Duration::from_millis(50),
    soonest: Duration::ZERO,
    // Of the bq27500, SLUS914A 7.3 and 3.2: nothing is committed or reset here.
    commit: Duration::from_millis(100),
    enter: Duration::ZERO,
    enter_limit: Duration::ZERO,
    reset: Duration::from_millis(300),
    reset_limit: Duration::from_secs(2),
    resets: Access::RESET,
    advances: false,
};

/// Standard commands, as the kernel's driver and SLUSAL6C have them. AveragePower() is in mW.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0E, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x24, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x2F),
    Register::new(0x2F, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

/// Without DesignCapacity(), which the driver does not have for the bq27545.
#[rustfmt::skip]
static REGISTERS_27545: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x24, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x2F),
    Register::new(0x2F, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

/// What is read, and what reading needs. All others change the gauge, and whatever they change is not proven,
/// either.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    // As on all of the family; other questions would be too many for the watchdog of a part that is identified.
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    Subcommand::new(0x0021, "IT_ENABLE", Never).unsealed(),
    Subcommand::new(0x0041, "RESET", Never).unsealed(),
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
];

static CONTROL_STATUS: &[Bit] = &[Bit::new(0x4000, "FAS"), Bit::new(0x2000, "SS")];

pub(super) static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

/// Plain: nothing is written, so nothing is reset.
pub(super) const fn class(
    class: &'static str,
    name: &'static str,
    id: u8,
    length: u16,
    parameters: &'static [P],
) -> Subclass {
    Subclass { class, name, id, length, kind: Kind::Plain, parameters }
}

// What shows that a row is where it is.
const PAGE_22: &str = "SLUSAL6C Table 7, page 22";
const PAGES_19_AND_22: &str = "SLUSAL6C Table 7, page 22, and the text of page 19";
const PAGE_22_AND_EXAMPLE: &str =
    "SLUSAL6C Table 7, page 22, and the example of page 19; Linux has the bq27545's at this place";
const PAGE_22_AND_BQ27546: &str = "SLUSAL6C Table 7, page 22; SLUSC53B prints the same of the bq27546-G1";
const TABLE_17: &str = "SLUSAT0E Table 17";
const TABLE_17_AND_LINUX: &str = "SLUSAT0E Table 17, and a row that Linux has switched off";
const LINUX: &str = "a row that Linux has switched off";

#[rustfmt::skip]
static DF_MANUFACTURER_INFO: &[P] = &[
    P::int(0, H1, "Block A 0", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(1, H1, "Block A 1", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(2, H1, "Block A 2", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(3, H1, "Block A 3", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(4, H1, "Block A 4", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(5, H1, "Block A 5", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(6, H1, "Block A 6", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(7, H1, "Block A 7", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(8, H1, "Block A 8", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(9, H1, "Block A 9", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(10, H1, "Block A 10", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(11, H1, "Block A 11", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(12, H1, "Block A 12", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(13, H1, "Block A 13", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(14, H1, "Block A 14", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(15, H1, "Block A 15", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(16, H1, "Block A 16", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(17, H1, "Block A 17", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(18, H1, "Block A 18", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(19, H1, "Block A 19", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(20, H1, "Block A 20", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(21, H1, "Block A 21", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(22, H1, "Block A 22", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(23, H1, "Block A 23", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(24, H1, "Block A 24", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(25, H1, "Block A 25", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(26, H1, "Block A 26", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(27, H1, "Block A 27", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(28, H1, "Block A 28", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(29, H1, "Block A 29", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(30, H1, "Block A 30", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(31, H1, "Block A 31", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(32, H1, "Block B 0", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(33, H1, "Block B 1", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(34, H1, "Block B 2", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(35, H1, "Block B 3", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(36, H1, "Block B 4", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(37, H1, "Block B 5", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(38, H1, "Block B 6", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(39, H1, "Block B 7", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(40, H1, "Block B 8", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(41, H1, "Block B 9", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(42, H1, "Block B 10", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(43, H1, "Block B 11", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(44, H1, "Block B 12", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(45, H1, "Block B 13", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(46, H1, "Block B 14", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(47, H1, "Block B 15", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(48, H1, "Block B 16", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(49, H1, "Block B 17", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(50, H1, "Block B 18", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(51, H1, "Block B 19", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(52, H1, "Block B 20", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(53, H1, "Block B 21", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(54, H1, "Block B 22", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(55, H1, "Block B 23", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(56, H1, "Block B 24", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(57, H1, "Block B 25", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(58, H1, "Block B 26", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(59, H1, "Block B 27", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(60, H1, "Block B 28", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(61, H1, "Block B 29", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(62, H1, "Block B 30", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
    P::int(63, H1, "Block B 31", 0x00, 0xFF, 0x00, "hex").unproven().by(PAGES_19_AND_22),
];

#[rustfmt::skip]
static DF_LIFETIME_DATA: &[P] = &[
    P::int(0, I2, "Lifetime Max Temp", 0, 1400, 0, "0.1°C").learned().unproven().by(PAGE_22),
    P::int(2, I2, "Lifetime Min Temp", -600, 1400, 500, "0.1°C").learned().unproven().by(PAGE_22),
    P::int(4, I2, "Lifetime Max Pack Voltage", 0, 32767, 2800, "mV").learned().unproven().by(PAGE_22),
    P::int(6, I2, "Lifetime Min Pack Voltage", 0, 32767, 4200, "mV").learned().unproven().by(PAGE_22),
    P::int(8, I2, "Lifetime Max Chg Current", -32767, 32767, 0, "mA").learned().unproven().by(PAGE_22),
    P::int(10, I2, "Lifetime Max Dsg Current", -32767, 32767, 0, "mA").learned().unproven().by(PAGE_22),
];

#[rustfmt::skip]
static DF_LIFETIME_TEMP_SAMPLES: &[P] = &[
    P::int(0, U2, "LT Flash Cnt", 0, 65535, 0, "Counts").learned().unproven().by(PAGE_22),
];

#[rustfmt::skip]
static DF_REGISTERS: &[P] = &[
    P::int(0, H2, "Pack Configuration", 0x0000, 0xFFFF, 0x1177, "hex").unproven().by(PAGE_22_AND_BQ27546),
    P::int(2, H1, "Pack Configuration B", 0x00, 0xFF, 0xA7, "hex").unproven().by(PAGE_22),
    P::int(3, H1, "Pack Configuration C", 0x00, 0xFF, 0x18, "hex").unproven().by(PAGE_22),
];

#[rustfmt::skip]
static DF_LIFETIME_RESOLUTION: &[P] = &[
    P::int(0, U1, "LT Temp Res", 0, 255, 10, "Num").unproven().by(PAGE_22),
    P::int(1, U1, "LT V Res", 0, 255, 25, "Num").unproven().by(PAGE_22),
    P::int(2, U1, "LT Cur Res", 0, 255, 100, "Num").unproven().by(PAGE_22),
    P::int(3, U2, "LT Update Time", 0, 65535, 60, "Num").unproven().by(PAGE_22),
];

#[rustfmt::skip]
static DF_POWER: &[P] = &[
    P::int(0, I2, "Flash Update OK Voltage", 0, 4200, 2800, "mV").unproven().by(PAGE_22),
    P::int(2, I2, "Sleep Current", 0, 100, 10, "mA").unproven().by(PAGE_22),
    P::int(11, U2, "Hibernate I", 0, 700, 8, "mA").unproven().by(PAGE_22),
    P::int(13, U2, "Hibernate V", 2400, 3000, 2550, "mV").unproven().by(PAGE_22),
    P::int(15, U1, "FS Wait", 0, 255, 0, "s").unproven().by(PAGE_22),
];

#[rustfmt::skip]
static DF_IT_CFG: &[P] = &[
    P::int(0, U1, "Load Select", 0, 255, 1, "Num").unproven().by(PAGE_22),
    P::int(1, U1, "Load Mode", 0, 255, 0, "Num").unproven().by(PAGE_22),
    P::int(21, U1, "Max Res Factor", 0, 255, 15, "Num").unproven().by(PAGE_22),
    P::int(22, U1, "Min Res Factor", 0, 255, 5, "Num").unproven().by(PAGE_22),
    P::int(25, U2, "Ra Filter", 0, 1000, 800, "Num").unproven().by(PAGE_22),
    P::int(67, I2, "Terminate Voltage", 2800, 3700, 3000, "mV").unproven().by(PAGE_22_AND_EXAMPLE),
    P::int(69, I2, "Term V Delta", 0, 4200, 200, "mV").unproven().by(PAGE_22),
];

#[rustfmt::skip]
static G5_SAFETY: &[P] = &[
    P::int(0, I2, "OT Chg", 0, 1200, 550, "0.1°C").unproven().by(TABLE_17),
    P::int(2, U1, "OT Chg Time", 0, 60, 2, "s").unproven().by(TABLE_17),
    P::int(3, I2, "OT Chg Recovery", 0, 1200, 500, "0.1°C").unproven().by(TABLE_17),
    P::int(5, I2, "OT Dsg", 0, 1200, 600, "0.1°C").unproven().by(TABLE_17),
    P::int(7, U1, "OT Dsg Time", 0, 60, 2, "s").unproven().by(TABLE_17),
    P::int(8, I2, "OT Dsg Recovery", 0, 1200, 550, "0.1°C").unproven().by(TABLE_17),
];

#[rustfmt::skip]
static G5_CHARGE_INHIBIT_CFG: &[P] = &[
    P::int(0, I2, "Chg Inhibit Temp Low", -400, 1200, 0, "0.1°C").unproven().by(TABLE_17),
    P::int(2, I2, "Chg Inhibit Temp High", -400, 1200, 450, "0.1°C").unproven().by(TABLE_17),
    P::int(4, I2, "Temp Hys", 0, 100, 50, "0.1°C").unproven().by(TABLE_17),
];

#[rustfmt::skip]
static G5_CHARGE: &[P] = &[
    P::int(0, I2, "Charging Voltage", 0, 4600, 4200, "mV").unproven().by(TABLE_17),
];

#[rustfmt::skip]
static G5_CHARGE_TERMINATION: &[P] = &[
    P::int(0, I2, "Taper Current", 0, 1000, 100, "mA").unproven().by(TABLE_17),
    P::int(2, I2, "Min Taper Capacity", 0, 1000, 25, "mAh").unproven().by(TABLE_17),
    P::int(4, I2, "Taper Voltage", 0, 1000, 100, "mV").unproven().by(TABLE_17),
    P::int(6, U1, "Current Taper Window", 0, 60, 40, "s").unproven().by(TABLE_17),
    P::int(7, I1, "TCA Set %", -1, 100, 99, "%").unproven().by(TABLE_17),
    P::int(8, I1, "TCA Clear %", -1, 100, 95, "%").unproven().by(TABLE_17),
    P::int(9, I1, "FC Set %", -1, 100, -1, "%").unproven().by(TABLE_17),
    P::int(10, I1, "FC Clear %", -1, 100, 98, "%").unproven().by(TABLE_17),
    P::int(11, I2, "DODatEOC Delta T", 0, 1000, 50, "0.1°C").unproven().by(TABLE_17),
];

#[rustfmt::skip]
static G5_DATA: &[P] = &[
    P::int(0, I2, "Rem Cap Alarm", 0, 700, 100, "mA").unproven().by(TABLE_17),
    // -256 is printed for the minimum of this signed byte.
    P::int(8, I1, "Initial Standby", -128, 0, -10, "mA").unproven().by(TABLE_17),
    P::int(9, I2, "Initial MaxLoad", -32767, 0, -500, "mA").unproven().by(TABLE_17),
    P::int(17, U2, "Cycle Count", 0, 65535, 0, "Counts").learned().unproven().by(TABLE_17),
    P::int(19, I2, "CC Threshold", 100, 32767, 900, "mAh").unproven().by(TABLE_17),
    P::int(23, I2, "Design Capacity", 0, 32767, 1000, "mAh").unproven().by(TABLE_17_AND_LINUX),
    P::within(25, I2, "Design Energy", 0, 32767, "mWh").unproven().by(TABLE_17_AND_LINUX),
];

#[rustfmt::skip]
static G5_IT_CFG: &[P] = &[
    P::within(67, I2, "Terminate Voltage", 2800, 3700, "mV").unproven().by(LINUX),
];

/// SLUSAL6C, Table 7, page 22.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    class("System Data", "Manufacturer Info", 58, 64, DF_MANUFACTURER_INFO),
    class("Configuration", "Lifetime Data", 59, 12, DF_LIFETIME_DATA),
    class("Configuration", "Lifetime Temp Samples", 60, 2, DF_LIFETIME_TEMP_SAMPLES),
    class("Configuration", "Registers", 64, 4, DF_REGISTERS),
    class("Configuration", "Lifetime Resolution", 66, 5, DF_LIFETIME_RESOLUTION),
    class("Configuration", "Power", 68, 16, DF_POWER),
    class("Gas Gauging", "IT Cfg", 80, 71, DF_IT_CFG),
];

/// SLUSAT0E, Table 17, and the kernel's 80/67.
#[rustfmt::skip]
static SUBCLASSES_27545: &[Subclass] = &[
    class("Configuration", "Safety", 2, 10, G5_SAFETY),
    class("Configuration", "Charge Inhibit Cfg", 32, 6, G5_CHARGE_INHIBIT_CFG),
    class("Configuration", "Charge", 34, 2, G5_CHARGE),
    class("Configuration", "Charge Termination", 36, 13, G5_CHARGE_TERMINATION),
    class("Configuration", "Data", 48, 27, G5_DATA),
    class("Gas Gauging", "IT Cfg", 80, 69, G5_IT_CFG),
];
