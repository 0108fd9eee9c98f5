// SPDX-License-Identifier: MIT

//! bq27742-G1: Impedance Track gauge and protector of one cell, on the pack's side, with firmware 0x0103.
//!
//! Two read TI's manual (SLUUAX0C): the driver of a shipped product, which programs the whole flash
//! (github.com/inteliclinic/NeuroonOpenFirmware), and a reference that quotes it by page, with what a bench has confirmed
//! (github.com/samuelbles07/airgradient-go). A row of both is proven. Those are written that have a printed range, or that
//! of a relative (48, 68/2: SLUSAT0E, SLUSAL6C); the limits of 68/0 and 80/64, and those beside a range, are our own. The
//! rest is unproven, and these rows are never written, nor are the blocks that have them:
//!
//! - 64: 64/5 and 64/6 are in the same block as 64/0 to 64/4. Their sum is in 57/12; while it differs, the protector opens
//!   both FETs within a second, and a write that is torn would leave it so.
//! - 57: what the gauge compares.
//! - 39: what a charger may follow.
//!
//! RESET opens both FETs for a moment, and with them the host's power: it is never sent. What is written counts from the
//! gauge's next start on.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never};
use super::Kind::{Plain, Reset, Security as Keys};
use super::Tier::{Poll, Proven, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, Gate, Identity, KeyBlock, KeyOrder, KeyStorage, Kind,
    Parameter as P, Preflight, Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Signature,
    Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27742-G1.
pub static CHIP: Chip = Chip {
    name: "bq27742-g1",
    model: "bq27742-G1",
    documents: &["SLUUAX0C (July 2015), as two quote it", "SLUSBV9D"],
    evidence: &[Evidence::Drivers, Evidence::Transcript],
    identity: Identity {
        device_type: 0x0742,
        firmware: &[0x0103],
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
    registers: REGISTERS,
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
    gate: Some(Gate {
        limit: (68, 0),
        divider: None,
        cell_divider: None,
        external: None,
        cells: None,
        calibration: None,
    }),
    authentication: None,
    subclasses: SUBCLASSES,
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: SIGNATURE,
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        pack: None,
        marks: &[(104, 0), (104, 4), (104, 11), (104, 12), (104, 13)],
        modes: &[],
        learning: None,
        voltage_mv: None,
    },
};

const SECURITY: Security = Security {
    status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
    default_unseal: [0x0414, 0x3672],
    full_access: true,
    seal: 0x0020,
    shows: Security::SHOWS,
    // TI's advice to owners of relatives whose keys were refused.
    key_silence: Duration::from_millis(5200),
    seals_itself: None,
    shown_sealed: &[],
    // 112/0 and 112/4, reversed.
    storage: KeyStorage::Kept(
        KeyBlock {
            subclass: 112,
            start: 0,
            length: 8,
            unseal: 0,
            full_access: 4,
            authentication: None,
            order: KeyOrder::Reversed,
        },
        "the gauge would have to be reset, which opens both FETs",
    ),
};

const ACCESS: Access = Access {
    scheme: Scheme::Block,
    // A shipped driver for the bq27520-G3; no document gives it.
    select: Duration::from_millis(50),
    soonest: Duration::ZERO,
    // SLUUAX0C 3.4.2: 144 ms at most, in which the clock is stretched.
    commit: Duration::from_millis(150),
    enter: Duration::ZERO,
    enter_limit: Duration::ZERO,
    reset: Duration::from_millis(300),
    reset_limit: Duration::from_secs(2),
    resets: Access::RESET,
    advances: false,
};

/// Values that a pack can have. Every place holds something else if the class is another.
#[rustfmt::skip]
static SIGNATURE: &[Signature] = &[
    Signature::new( 2,  0, I2, 4200, 4600),  // OV Prot Threshold
    Signature::new( 2,  5, I2, 2300, 3100),  // UV Prot Threshold
    Signature::new(48, 12, I2, 1, 32767),    // Design Capacity
    Signature::new(68,  0, I2, 2500, 3000),  // Flash Update OK Voltage
    Signature::new(80, 64, I2, 2800, 3700),  // Terminate Voltage
];

/// Standard commands of both sources. The kernel's driver reads BTPSOC1Set() as a power. Relatives end before AveragePower().
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x18, U2, "FilteredFCC", "mAh", Slow),
    Register::new(0x1A, U2, "SafetyStatus", "", Slow),
    Register::new(0x1E, I2, "Imax", "mA", Slow),
    Register::new(0x24, U2, "BTPSOC1Set", "mAh", Slow),
    Register::new(0x26, U2, "BTPSOC1Clear", "mAh", Slow),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x2F),
    Register::new(0x2F, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x30, U2, "ChargingVoltage", "mV", Slow),
    Register::new(0x32, U2, "ChargingCurrent", "mA", Slow),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
    Register::new(0x6D, U1, "ProtectorStatus", "", Slow),
    Register::new(0x76, I2, "AveragePower", "mW", Proven).role(Role::PowerAvg),
    Register::new(0x78, U1, "ProtectorState", "", Slow),
];

/// Those of the sources. RESET, SET_SHUTDOWN and START_FET_TEST move the FETs, and IT_ENABLE cannot be taken back.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0004, "PROTECTOR_VERSION", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    Subcommand::new(0x0013, "SET_SHUTDOWN", Never),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    Subcommand::new(0x0021, "IT_ENABLE", Guarded).unsealed(),
    Subcommand::new(0x0024, "START_FET_TEST", Never).unsealed(),
    Subcommand::new(0x0041, "RESET", Never).unsealed(),
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
];

static CONTROL_STATUS: &[Bit] = &[Bit::new(0x4000, "FAS"), Bit::new(0x2000, "SS")];

static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

// What shows that a row is where it is.
const DRIVER: &str = "a shipped driver, which writes it";
const BOTH: &str = "a shipped driver, and SLUUAX0C as quoted";
const THREE: &str = "two drivers, and SLUUAX0C as quoted";
const DOUBTFUL: &str = "a shipped driver, which doubts it: a bq27542-G1 has Max IR Correct at 81/9";

/// Why the protector's rows, and their block, are left alone.
const PROTECTOR: &str =
    "the protector compares it with a sum in another block, and opens both FETs while they differ";

const CHARGER: &str = "a charger may follow it, and no source prints its range";

const DELAY: Safe = Safe::AtLeast(1, "0 switches the protection off");
const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");
/// Above the present voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");

const ENDS: &str = "a protection ends on the safe side of where it begins";
const TRIPS: &str = "the protection would open a FET at once";

const SHUTDOWN: Safe = Safe::BelowNow(Role::VoltageNow, 50, "the gauge would cut the pack off");

// Margins and OT_MOST are our own: 50 mV and 5 degrees are more than a reading moves from one to the next.
const OV: Safe = Safe::All(&[Safe::Over(3, 1, ENDS), Safe::AboveNow(Role::VoltageNow, 50, TRIPS)]);
const OV_RECOVERY: Safe = Safe::Under(0, 1, ENDS);
const UV: Safe = Safe::All(&[Safe::Under(8, 1, ENDS), Safe::BelowNow(Role::VoltageNow, 50, TRIPS)]);
const UV_RECOVERY: Safe = Safe::All(&[Safe::Over(5, 1, ENDS), Safe::BelowNow(Role::VoltageNow, 50, TRIPS)]);
const OT_MOST: Safe = Safe::Within(0, 700, "a lithium cell is damaged above 70 degrees");
const OT_CHG: Safe = Safe::All(&[OT_MOST, Safe::Over(15, 1, ENDS), Safe::AboveNow(Role::Temp, 50, TRIPS)]);
const OT_CHG_RECOVERY: Safe = Safe::Under(12, 1, ENDS);
const OT_DSG: Safe = Safe::All(&[OT_MOST, Safe::Over(20, 1, ENDS), Safe::AboveNow(Role::Temp, 50, TRIPS)]);
const OT_DSG_RECOVERY: Safe = Safe::Under(17, 1, ENDS);

const fn class(
    class: &'static str,
    name: &'static str,
    id: u8,
    length: u16,
    kind: Kind,
    parameters: &'static [P],
) -> Subclass {
    Subclass { class, name, id, length, kind, parameters }
}

#[rustfmt::skip]
static DF_SAFETY: &[P] = &[
    P::int(0, I2, "OV Prot Threshold", 4200, 4600, 4390, "mV").safe(OV).by(BOTH),
    P::int(2, U1, "OV Prot Delay", 0, 5, 1, "s").safe(DELAY).by(BOTH),
    P::int(3, I2, "OV Prot Recovery", 4100, 4500, 4290, "mV").safe(OV_RECOVERY).by(BOTH),
    P::int(5, I2, "UV Prot Threshold", 2300, 3100, 2800, "mV").safe(UV).by(BOTH),
    P::int(7, U1, "UV Prot Delay", 0, 5, 1, "s").safe(DELAY).by(BOTH),
    P::int(8, I2, "UV Prot Recovery", 2400, 3200, 2900, "mV").safe(UV_RECOVERY).by(BOTH),
    P::int(10, I2, "Body Diode Threshold", 0, 100, 60, "mA").by(BOTH),
    P::int(12, I2, "OT Chg", 0, 1200, 550, "0.1°C").safe(OT_CHG).by(BOTH),
    P::int(14, U1, "OT Chg Time", 0, 60, 5, "s").safe(DELAY).by(BOTH),
    P::int(15, I2, "OT Chg Recovery", 0, 1200, 500, "0.1°C").safe(OT_CHG_RECOVERY).by(BOTH),
    P::int(17, I2, "OT Dsg", 0, 1200, 600, "0.1°C").safe(OT_DSG).by(BOTH),
    P::int(19, U1, "OT Dsg Time", 0, 60, 5, "s").safe(DELAY).by(BOTH),
    P::int(20, I2, "OT Dsg Recovery", 0, 1200, 550, "0.1°C").safe(OT_DSG_RECOVERY).by(BOTH),
];

#[rustfmt::skip]
static DF_CHARGE: &[P] = &[
    P::int(0, I2, "Charging Voltage", 0, 4600, 4200, "mV").unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_CHARGE_TERMINATION: &[P] = &[
    P::int(0, I2, "Taper Current", 0, 1000, 100, "mA").unprinted().unproven().by(DRIVER),
    P::int(2, I2, "Min Taper Capacity", 0, 1000, 25, "mAh").unprinted().unproven().by(DRIVER),
    P::int(4, I2, "Taper Voltage", 0, 1000, 100, "mV").unprinted().unproven().by(DRIVER),
    P::int(6, U1, "Current Taper Window", 0, 60, 40, "s").unprinted().unproven().by(DRIVER),
    P::int(7, I1, "TCA Set %", -1, 100, 99, "%").unprinted().unproven().by(DRIVER),
    P::int(8, I1, "TCA Clear %", -1, 100, 95, "%").unprinted().unproven().by(DRIVER),
    P::int(9, I1, "FC Set %", -1, 100, -1, "%").unprinted().unproven().by(DRIVER),
    P::int(10, I1, "FC Clear %", -1, 100, 98, "%").unprinted().unproven().by(DRIVER),
    P::int(11, I2, "DODatEOC Delta T", 0, 1000, 50, "0.1°C").unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_JEITA: &[P] = &[
    P::int(0, I1, "T1 Temp", -128, 127, 0, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(1, I1, "T2 Temp", -128, 127, 10, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(2, I1, "T3 Temp", -128, 127, 45, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(3, I1, "T4 Temp", -128, 127, 50, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(4, I1, "T5 Temp", -128, 127, 60, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(5, I1, "Temp Hys", -128, 127, 1, "°C").unprinted().never(CHARGER).by(BOTH),
    P::int(6, I2, "T1-T2 Chg Voltage", -32768, 32767, 4350, "mV").unprinted().never(CHARGER).by(BOTH),
    P::int(8, I2, "T2-T3 Chg Voltage", -32768, 32767, 4350, "mV").unprinted().never(CHARGER).by(BOTH),
    P::int(10, I2, "T3-T4 Chg Voltage", -32768, 32767, 4300, "mV").unprinted().never(CHARGER).by(BOTH),
    P::int(12, I2, "T4-T5 Chg Voltage", -32768, 32767, 4250, "mV").unprinted().never(CHARGER).by(BOTH),
    P::int(14, U1, "T1-T2 Chg Current", 0, 255, 50, "%").unprinted().never(CHARGER).by(BOTH),
    P::int(15, U1, "T2-T3 Chg Current", 0, 255, 80, "%").unprinted().never(CHARGER).by(BOTH),
    P::int(16, U1, "T3-T4 Chg Current", 0, 255, 80, "%").unprinted().never(CHARGER).by(BOTH),
    P::int(17, U1, "T4-T5 Chg Current", 0, 255, 80, "%").unprinted().never(CHARGER).by(BOTH),
];

#[rustfmt::skip]
static DF_DATA: &[P] = &[
    P::any(0, I2, "Design Voltage", "mV").unproven().by(DRIVER),
    P::int(8, U2, "Cycle Count", 0, 65535, 0, "Counts").learned().unprinted().unproven().by(BOTH),
    P::int(10, I2, "CC Threshold", 100, 32767, 900, "mAh").unprinted().unproven().by(DRIVER),
    P::int(12, I2, "Design Capacity", 0, 32767, 1000, "mAh").unprinted().safe(CAPACITY).by(BOTH),
    P::int(14, I2, "Design Energy", 0, 32767, 3800, "mWh").unprinted().safe(CAPACITY).by(BOTH),
    P::any(16, I2, "SOH Load I", "mA").unproven().by(DRIVER),
    P::any(18, U1, "TDD SOH Percent", "%").unproven().by(DRIVER),
    P::any(19, U2, "ISD Current", "Hr rate").unproven().by(DRIVER),
    P::any(21, U1, "ISD I Filter", "Num").unproven().by(DRIVER),
    P::any(22, U1, "Min ISD Time", "h").unproven().by(DRIVER),
    P::any(23, U1, "Design Energy Scale", "Num").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_DISCHARGE: &[P] = &[
    P::any(0, U2, "SOC1 Set Threshold", "mAh").unproven().by(DRIVER),
    P::any(2, U2, "SOC1 Clear Threshold", "mAh").unproven().by(DRIVER),
    P::any(4, U2, "SOCF Set Threshold", "mAh").unproven().by(DRIVER),
    P::any(6, U2, "SOCF Clear Threshold", "mAh").unproven().by(DRIVER),
    P::any(8, I2, "BL Set Volt Threshold", "mV").unproven().by(DRIVER),
    P::any(10, U1, "BL Set Volt Time", "s").unproven().by(DRIVER),
    P::any(11, I2, "BL Clear Volt Threshold", "mV").unproven().by(DRIVER),
    P::any(13, I2, "BH Set Volt Threshold", "mV").unproven().by(DRIVER),
    P::any(15, U1, "BH Volt Time", "s").unproven().by(DRIVER),
    P::any(16, I2, "BH Clear Volt Threshold", "mV").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_MANUFACTURER_DATA: &[P] = &[
    P::any(0, H2, "Pack Lot Code", "hex").unproven().by(DRIVER),
    P::any(2, H2, "PCB Lot Code", "hex").unproven().by(DRIVER),
    P::any(4, H2, "Firmware Version", "hex").unproven().by(DRIVER),
    P::any(6, H2, "Hardware Revision", "hex").unproven().by(DRIVER),
    P::any(8, H2, "Cell Revision", "hex").unproven().by(DRIVER),
    P::any(10, H2, "DF Config Version", "hex").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_INTEGRITY_DATA: &[P] = &[
    P::int(6, H2, "All DF Checksum", 0x0000, 0x7FFF, 0x0000, "hex").never(PROTECTOR).by(BOTH),
    P::int(8, H2, "Static Chem DF Checksum", 0x0000, 0x7FFF, 0x7C23, "hex").never(PROTECTOR).by(BOTH),
    P::int(10, H2, "Static DF Checksum", 0x0000, 0x7FFF, 0x0000, "hex").never(PROTECTOR).by(BOTH),
    P::int(12, H2, "Prot Checksum", 0x0000, 0x7FFF, 0x0011, "hex").never(PROTECTOR).by(BOTH),
];

#[rustfmt::skip]
static DF_MANUFACTURER_INFO: &[P] = &[
    P::int(0, H1, "Block A 0", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(1, H1, "Block A 1", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(2, H1, "Block A 2", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(3, H1, "Block A 3", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(4, H1, "Block A 4", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(5, H1, "Block A 5", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(6, H1, "Block A 6", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(7, H1, "Block A 7", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(8, H1, "Block A 8", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(9, H1, "Block A 9", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(10, H1, "Block A 10", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(11, H1, "Block A 11", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(12, H1, "Block A 12", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(13, H1, "Block A 13", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(14, H1, "Block A 14", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(15, H1, "Block A 15", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(16, H1, "Block A 16", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(17, H1, "Block A 17", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(18, H1, "Block A 18", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(19, H1, "Block A 19", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(20, H1, "Block A 20", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(21, H1, "Block A 21", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(22, H1, "Block A 22", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(23, H1, "Block A 23", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(24, H1, "Block A 24", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(25, H1, "Block A 25", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(26, H1, "Block A 26", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(27, H1, "Block A 27", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(28, H1, "Block A 28", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(29, H1, "Block A 29", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(30, H1, "Block A 30", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(31, H1, "Block A 31", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(32, H1, "Block B 0", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(33, H1, "Block B 1", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(34, H1, "Block B 2", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(35, H1, "Block B 3", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(36, H1, "Block B 4", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(37, H1, "Block B 5", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(38, H1, "Block B 6", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(39, H1, "Block B 7", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(40, H1, "Block B 8", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(41, H1, "Block B 9", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(42, H1, "Block B 10", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(43, H1, "Block B 11", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(44, H1, "Block B 12", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(45, H1, "Block B 13", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(46, H1, "Block B 14", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(47, H1, "Block B 15", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(48, H1, "Block B 16", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(49, H1, "Block B 17", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(50, H1, "Block B 18", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(51, H1, "Block B 19", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(52, H1, "Block B 20", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(53, H1, "Block B 21", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(54, H1, "Block B 22", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(55, H1, "Block B 23", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(56, H1, "Block B 24", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(57, H1, "Block B 25", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(58, H1, "Block B 26", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(59, H1, "Block B 27", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(60, H1, "Block B 28", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(61, H1, "Block B 29", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(62, H1, "Block B 30", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
    P::int(63, H1, "Block B 31", 0x00, 0xFF, 0x00, "hex").unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_LIFETIME_DATA: &[P] = &[
    P::int(0, I2, "Lifetime Max Temp", 0, 1400, 0, "0.1°C").learned().unprinted().unproven().by(DRIVER),
    P::int(2, I2, "Lifetime Min Temp", -600, 1400, 500, "0.1°C").learned().unprinted().unproven().by(DRIVER),
    P::int(4, I2, "Lifetime Max Pack Voltage", 0, 32767, 2800, "mV").learned().unprinted().unproven().by(DRIVER),
    P::int(6, I2, "Lifetime Min Pack Voltage", 0, 32767, 4200, "mV").learned().unprinted().unproven().by(DRIVER),
    P::int(8, I2, "Lifetime Max Chg Current", -32767, 32767, 0, "mA").learned().unprinted().unproven().by(DRIVER),
    P::int(10, I2, "Lifetime Max Dsg Current", -32767, 32767, 0, "mA").learned().unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_LIFETIME_TEMP_SAMPLES: &[P] = &[
    P::int(0, U2, "LT Flash Cnt", 0, 65535, 0, "Counts").learned().unprinted().unproven().by(DRIVER),
    P::any(2, H1, "LT AFE Status", "hex").learned().unproven().by(BOTH),
];

#[rustfmt::skip]
static DF_REGISTERS: &[P] = &[
    P::int(0, H2, "Pack Configuration", 0x0000, 0xFFFF, 0x097F, "hex").unprinted().never(PROTECTOR).by(THREE),
    P::int(2, H1, "Pack Configuration B", 0x00, 0xFF, 0xA7, "hex").unprinted().never(PROTECTOR).by(BOTH),
    P::int(3, H1, "Pack Configuration C", 0x00, 0xFF, 0xB9, "hex").unprinted().never(PROTECTOR).by(THREE),
    P::int(4, H1, "Pack Configuration D", 0x00, 0xFF, 0x83, "hex").unprinted().never(PROTECTOR).by(BOTH),
    P::int(5, H1, "Prot OC Config", 0x00, 0xFF, 0x0A, "hex").unprinted().never(PROTECTOR).by(BOTH),
    P::int(6, H1, "Prot OV Config", 0x00, 0xFF, 0x07, "hex").unprinted().never(PROTECTOR).by(BOTH),
];

#[rustfmt::skip]
static DF_LIFETIME_RESOLUTION: &[P] = &[
    P::int(0, U1, "LT Temp Res", 0, 255, 10, "Num").unprinted().unproven().by(DRIVER),
    P::int(1, U1, "LT V Res", 0, 255, 25, "Num").unprinted().unproven().by(DRIVER),
    P::int(2, U1, "LT Cur Res", 0, 255, 100, "Num").unprinted().unproven().by(DRIVER),
    P::int(3, U2, "LT Update Time", 0, 65535, 60, "Num").unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_POWER: &[P] = &[
    P::int(0, I2, "Flash Update OK Voltage", 2500, 3000, 2800, "mV").unprinted().safe(GATE).by(BOTH),
    P::int(2, I2, "Sleep Current", 0, 100, 15, "mA").unprinted().by(BOTH),
    P::any(10, U2, "Shutdown V", "mV").safe(SHUTDOWN).unproven().by(DRIVER),
    P::int(12, U1, "FS Wait", 0, 255, 0, "s").unprinted().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_IT_CFG: &[P] = &[
    P::int(0, U1, "Load Select", 0, 255, 1, "Num").unprinted().unproven().by(BOTH),
    P::int(1, U1, "Load Mode", 0, 255, 1, "Num").unprinted().unproven().by(BOTH),
    P::any(17, U1, "Max Res Factor", "Num").unproven().by(DRIVER),
    P::any(18, U1, "Min Res Factor", "Num").unproven().by(DRIVER),
    P::any(20, U2, "Ra Filter", "Num").unproven().by(DRIVER),
    P::any(22, I2, "Res V Drop", "mV").unproven().by(DRIVER),
    P::any(39, U1, "Fast Qmax Start DOD %", "%").unproven().by(DRIVER),
    P::any(40, U1, "Fast Qmax End DOD %", "%").unproven().by(DRIVER),
    P::any(41, I2, "Fast Qmax Start Volt Delta", "mV").unproven().by(DRIVER),
    P::any(43, U2, "Fast Qmax Current Threshold", "Hr rate").unproven().by(DRIVER),
    P::any(61, U1, "Qmax Capacity Err", "0.1%").unproven().by(DRIVER),
    P::any(62, U1, "Max Qmax Change", "%").unproven().by(DRIVER),
    P::int(64, I2, "Terminate Voltage", 2800, 3700, 3000, "mV").unprinted().role(Role::VoltageMinDesign).by(BOTH),
    P::any(66, I2, "Term V Delta", "mV").unproven().by(DRIVER),
    P::any(69, U2, "ResRelax Time", "s").unproven().by(DRIVER),
    P::any(73, I2, "User Rate-mA", "mA").unproven().by(DRIVER),
    P::any(75, I2, "User Rate-Pwr", "mW/cW").unproven().by(DRIVER),
    P::any(77, I2, "Reserve Cap-mAh", "mAh").unproven().by(DRIVER),
    P::any(84, I2, "Max DeltaV", "mV").unproven().by(DRIVER),
    P::any(86, I2, "Min DeltaV", "mV").unproven().by(DRIVER),
    P::any(88, U1, "Max Sim Rate", "Hr rate").unproven().by(DRIVER),
    P::any(89, U1, "Min Sim Rate", "Hr rate").unproven().by(DRIVER),
    P::any(90, I2, "Ra Max Delta", "mΩ").unproven().by(DRIVER),
    P::any(92, I2, "Trace Resistance", "mΩ").unproven().by(DRIVER),
    P::any(94, I2, "Downstream Resistance", "mΩ").unproven().by(DRIVER),
    P::any(96, U1, "Qmax Max Delta %", "%").unproven().by(DRIVER),
    P::any(97, U1, "Qmax Bound %", "%").unproven().by(DRIVER),
    P::any(98, U2, "DeltaV Max Delta", "mV").unproven().by(DRIVER),
    P::any(100, U2, "Max Res Scale", "Num").unproven().by(DRIVER),
    P::any(102, U2, "Min Res Scale", "Num").unproven().by(DRIVER),
    P::any(104, U1, "Fast Scale Start SOC", "%").unproven().by(DRIVER),
    P::any(105, U1, "Fast Scale Load Select", "Num").unproven().by(DRIVER),
    P::any(106, I2, "Charge Hys V Shift", "mV").unproven().by(DRIVER),
    P::any(108, U1, "RaScl OCV Rst Temp Thresh", "°C").unproven().by(DRIVER),
    P::any(109, U2, "Max Allowed Current", "mA").unproven().by(DRIVER),
    P::any(111, U1, "Max Current Pulse Duration", "s").unproven().by(DRIVER),
    P::any(112, I2, "Max Current Interrupt Step", "mA").unproven().by(DRIVER),
    P::any(114, U2, "Relax Smooth Time", "s").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_CURRENT_THRESHOLDS: &[P] = &[
    P::int(0, I2, "Dsg Current Threshold", 0, 2000, 60, "mA").unprinted().unproven().by(DRIVER),
    P::int(2, I2, "Chg Current Threshold", 0, 2000, 75, "mA").unprinted().unproven().by(DRIVER),
    P::int(4, I2, "Quit Current", 0, 1000, 40, "mA").unprinted().unproven().by(DRIVER),
    P::int(6, U2, "Dsg Relax Time", 0, 8191, 60, "s").unprinted().unproven().by(DRIVER),
    P::int(8, U1, "Chg Relax Time", 0, 255, 60, "s").unprinted().unproven().by(DRIVER),
    P::int(9, U1, "Quit Relax Time", 0, 63, 1, "s").unprinted().unproven().by(DOUBTFUL),
    P::int(10, I2, "Max IR Correct", -32768, 32767, 400, "mV").unprinted().unproven().by(DOUBTFUL),
];

#[rustfmt::skip]
static DF_STATE: &[P] = &[
    P::int(0, I2, "Qmax Cell 0", 0, 14500, 1000, "mAh").learned().unproven().by(BOTH),
    P::int(2, H1, "Update Status", 0x00, 0x06, 0x00, "hex").learned().unproven().by(BOTH),
    P::int(3, I2, "V at Chg Term", 0, 5000, 4350, "mV").learned().unproven().by(BOTH),
    P::any(5, I2, "Avg I Last Run", "mA").learned().unproven().by(DRIVER),
    P::any(7, I2, "Avg P Last Run", "mW/cW").learned().unproven().by(DRIVER),
    P::any(9, I2, "Delta Voltage", "mV").learned().unproven().by(DRIVER),
    P::any(11, I2, "T Rise", "Num").learned().unproven().by(DRIVER),
    P::any(13, I2, "T Time Constant", "Num").learned().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_CHEM: &[P] = &[
    P::any(0, H2, "Chem ID", "hex").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_R_A0: &[P] = &[
    P::any(0, H2, "Cell0 R_a flag", "hex").learned().unproven().by(BOTH),
    P::any(2, I2, "Cell0 R_a 0", "Num").learned().unproven().by(BOTH),
    P::any(4, I2, "Cell0 R_a 1", "Num").learned().unproven().by(BOTH),
    P::any(6, I2, "Cell0 R_a 2", "Num").learned().unproven().by(BOTH),
    P::any(8, I2, "Cell0 R_a 3", "Num").learned().unproven().by(BOTH),
    P::any(10, I2, "Cell0 R_a 4", "Num").learned().unproven().by(BOTH),
    P::any(12, I2, "Cell0 R_a 5", "Num").learned().unproven().by(BOTH),
    P::any(14, I2, "Cell0 R_a 6", "Num").learned().unproven().by(BOTH),
    P::any(16, I2, "Cell0 R_a 7", "Num").learned().unproven().by(BOTH),
    P::any(18, I2, "Cell0 R_a 8", "Num").learned().unproven().by(BOTH),
    P::any(20, I2, "Cell0 R_a 9", "Num").learned().unproven().by(BOTH),
    P::any(22, I2, "Cell0 R_a 10", "Num").learned().unproven().by(BOTH),
    P::any(24, I2, "Cell0 R_a 11", "Num").learned().unproven().by(BOTH),
    P::any(26, I2, "Cell0 R_a 12", "Num").learned().unproven().by(BOTH),
    P::any(28, I2, "Cell0 R_a 13", "Num").learned().unproven().by(BOTH),
    P::any(30, I2, "Cell0 R_a 14", "Num").learned().unproven().by(BOTH),
];

#[rustfmt::skip]
static DF_R_A0X: &[P] = &[
    P::any(0, H2, "xCell0 R_a flag", "hex").learned().unproven().by(DRIVER),
    P::any(2, I2, "xCell0 R_a 0", "Num").learned().unproven().by(DRIVER),
    P::any(4, I2, "xCell0 R_a 1", "Num").learned().unproven().by(DRIVER),
    P::any(6, I2, "xCell0 R_a 2", "Num").learned().unproven().by(DRIVER),
    P::any(8, I2, "xCell0 R_a 3", "Num").learned().unproven().by(DRIVER),
    P::any(10, I2, "xCell0 R_a 4", "Num").learned().unproven().by(DRIVER),
    P::any(12, I2, "xCell0 R_a 5", "Num").learned().unproven().by(DRIVER),
    P::any(14, I2, "xCell0 R_a 6", "Num").learned().unproven().by(DRIVER),
    P::any(16, I2, "xCell0 R_a 7", "Num").learned().unproven().by(DRIVER),
    P::any(18, I2, "xCell0 R_a 8", "Num").learned().unproven().by(DRIVER),
    P::any(20, I2, "xCell0 R_a 9", "Num").learned().unproven().by(DRIVER),
    P::any(22, I2, "xCell0 R_a 10", "Num").learned().unproven().by(DRIVER),
    P::any(24, I2, "xCell0 R_a 11", "Num").learned().unproven().by(DRIVER),
    P::any(26, I2, "xCell0 R_a 12", "Num").learned().unproven().by(DRIVER),
    P::any(28, I2, "xCell0 R_a 13", "Num").learned().unproven().by(DRIVER),
    P::any(30, I2, "xCell0 R_a 14", "Num").learned().unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_DATA_104: &[P] = &[
    P::float(0, "CC Gain", -1e7, 1e7, 0.0, "Num").no_default().unprinted().unproven().by(DRIVER),
    P::float(4, "CC Delta", -1e7, 1e7, 0.0, "Num").no_default().unprinted().unproven().by(DRIVER),
    P::any(8, I2, "CC Offset", "Num").unproven().by(DRIVER),
    P::any(10, I1, "Board Offset", "Num").unproven().by(DRIVER),
    P::any(11, I1, "Int Temp Offset", "0.1°C").unproven().by(DRIVER),
    P::any(12, I1, "Ext Temp Offset", "0.1°C").unproven().by(DRIVER),
    P::any(13, I1, "Pack V Offset", "mV").unproven().by(DRIVER),
];

#[rustfmt::skip]
static DF_CURRENT: &[P] = &[
    P::any(0, U1, "Filter", "Num").unproven().by(DRIVER),
    P::any(1, U1, "Deadband", "mA").unproven().by(DRIVER),
    P::any(2, U1, "CC Deadband", "Num").unproven().by(DRIVER),
];

#[rustfmt::skip]
static CODES: &[P] = &[
    // No defaults: nothing that shows defaults may show these.
    P::any( 0, H4, "Sealed to Unsealed", "hex"),
    P::any( 4, H4, "Unsealed to Full", "hex"),
    P::any( 8, H4, "Authen Key3", "hex"),
    P::any(12, H4, "Authen Key2", "hex"),
    P::any(16, H4, "Authen Key1", "hex"),
    P::any(20, H4, "Authen Key0", "hex"),
];

/// In order of their ids.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    class("Configuration", "Safety", 2, 22, Reset, DF_SAFETY),
    class("Configuration", "Charge", 34, 2, Reset, DF_CHARGE),
    class("Configuration", "Charge Termination", 36, 13, Reset, DF_CHARGE_TERMINATION),
    class("Configuration", "JEITA", 39, 18, Reset, DF_JEITA),
    class("Configuration", "Data", 48, 24, Reset, DF_DATA),
    class("Configuration", "Discharge", 49, 18, Reset, DF_DISCHARGE),
    class("System Data", "Manufacturer Data", 56, 12, Reset, DF_MANUFACTURER_DATA),
    class("Configuration", "Integrity Data", 57, 14, Reset, DF_INTEGRITY_DATA),
    class("System Data", "Manufacturer Info", 58, 64, Plain, DF_MANUFACTURER_INFO),
    class("Configuration", "Lifetime Data", 59, 12, Reset, DF_LIFETIME_DATA),
    class("Configuration", "Lifetime Temp Samples", 60, 3, Reset, DF_LIFETIME_TEMP_SAMPLES),
    class("Configuration", "Registers", 64, 7, Reset, DF_REGISTERS),
    class("Configuration", "Lifetime Resolution", 66, 5, Reset, DF_LIFETIME_RESOLUTION),
    class("Configuration", "Power", 68, 13, Reset, DF_POWER),
    class("Gas Gauging", "IT Cfg", 80, 116, Reset, DF_IT_CFG),
    class("Gas Gauging", "Current Thresholds", 81, 12, Reset, DF_CURRENT_THRESHOLDS),
    class("Gas Gauging", "State", 82, 15, Reset, DF_STATE),
    class("Chemistry", "Chem", 83, 2, Reset, DF_CHEM),
    class("Ra Tables", "R_a0", 88, 32, Reset, DF_R_A0),
    class("Ra Tables", "R_a0x", 89, 32, Reset, DF_R_A0X),
    class("Calibration", "Data", 104, 14, Reset, DF_DATA_104),
    class("Calibration", "Current", 107, 3, Reset, DF_CURRENT),
    class("Security", "Codes", 112, 24, Keys, CODES),
];
