// SPDX-License-Identifier: MIT

//! bq27500: Impedance Track gauge on the system side, for one Li-ion cell, in two layouts of data flash.
//!
//! Firmware 1.30 is the bq27500-V130, whose Table 4-7 SLUS914A prints. TI's stock images for firmware 1.06 and 1.20
//! (github.com/buglabs/bq27500-update) hold that table's defaults in the same places in most classes: a row whose
//! default, other than 0, stands there in both is proven for all three. In 36, 64, 68, 81 and 107 the layouts differ.
//! The rest is marked unproven, as are these:
//!
//! - 64/0: the printed defaults of its bits contradict the printed default of the word.
//! - 82: the gauge learns it.
//! - 104: printed in the units of TI's tool, and not as it is stored.
//! - 57: zeros in the images.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Plain, Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, Gate, Identity, KeyBlock, KeyOrder, KeyStorage, Mode, Pack,
    Parameter as P, Preflight, Register, Role, RomImage, Safe, Scaling, Scheme, SealStatus, Security,
    Signature, Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27500 with firmware 1.06 or 1.20.
pub static CHIP: Chip = chip(
    "bq27500",
    "bq27500",
    &[Evidence::Sibling, Evidence::Drivers, Evidence::Transcript, Evidence::Image, Evidence::Kernel],
    &[0x0106, 0x0120],
    SUBCLASSES,
    Some(ROM_IMAGE),
);

/// The bq27500 with firmware 1.30, which has a data sheet of its own.
pub static V130: Chip = chip(
    "bq27500-v130",
    "bq27500-V130",
    &[Evidence::Manual, Evidence::Transcript, Evidence::Kernel],
    &[0x0130],
    SUBCLASSES_V130,
    None,
);

const fn chip(
    name: &'static str,
    model: &'static str,
    evidence: &'static [Evidence],
    firmware: &'static [u16],
    subclasses: &'static [Subclass],
    rom_image: Option<RomImage>,
) -> Chip {
    Chip {
        name,
        model,
        documents: &["SLUS914A (December 2009), of the bq27500-V130"],
        evidence,
        // The type is in the names of TI's images.
        identity: Identity {
            device_type: 0x0500,
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
            present: 0x0008, // [BAT_DET]
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
        // SLUS914A says where the digest is, and not how long it takes.
        authentication: None,
        subclasses,
        // The rule of the family, SLUSBH1C 9.5.4.3.
        byte_writes_above_hz: Some(100_000),
        calibration: None,
        signature: SIGNATURE,
        volatile: None,
        quirks: &[],
        rom_image,
        preflight: Preflight {
            pack: Some(Pack { word: Source::Answer(0x0008), name: "Control(CHEM_ID)", rows: &[] }),
            marks: &[(104, 0), (104, 4), (104, 11), (104, 12), (104, 13)],
            modes: MODES,
            // Update Status has the same value during the first cycle and after it (SLUS914A 4.1.1.1.15, 5.2.9).
            learning: None,
            voltage_mv: None,
        },
    }
}

/// Both stock images hold the defaults of the classes here. From 68 on the older one has them a byte before, because its
/// class 64 is shorter. The places of 57 and 107 are not known.
#[rustfmt::skip]
const ROM_IMAGE: RomImage = RomImage {
    layouts: &[
        (0x0106, &[
            (104, 0x1E), (82, 0x74), (80, 0x8C), (32, 0x1F7), (34, 0x1FD), (36, 0x207), (64, 0x214), (68, 0x21D),
            (81, 0x231), (112, 0x23B), (2, 0x267), (48, 0x27B), (49, 0x28F),
        ]),
        (0x0120, &[
            (104, 0x1E), (82, 0x74), (80, 0x8C), (32, 0x1F7), (34, 0x1FD), (36, 0x207), (64, 0x214), (68, 0x21E),
            (81, 0x232), (112, 0x23C), (2, 0x268), (48, 0x27C), (49, 0x290),
        ]),
    ],
    // Behind the known part of 80.
    chemistry: (0xC9, 0x1F7),
    chemistry_sum: None,
};

/// No bit shows CAL_MODE.
const MODES: &[Mode] = &[
    Mode::measuring(0x0800, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
    Mode::measuring(0x0400, "CONTROL_STATUS [BCA]", "the board offset is being measured"),
];

const SECURITY: Security = Security {
    status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
    default_unseal: [0x0414, 0x3672],
    full_access: true,
    seal: 0x0020,
    // TI's advice to owners whose keys were refused.
    shows: Security::SHOWS,
    key_silence: Duration::from_millis(5200),
    seals_itself: None,
    // Blocks 1 to 3 are those of class 57 (SLUS914A 4.1.2.3), which is read as a whole.
    shown_sealed: &[],
    // SLUS914A 4.5: the bytes are entered the other way round than they lie in data flash, Key 1 first. The images
    // have the authentication key behind them; no document prints its place.
    storage: KeyStorage::Flash(KeyBlock {
        subclass: 112,
        start: 0,
        length: 8,
        unseal: 0,
        full_access: 4,
        authentication: None,
        order: KeyOrder::Reversed,
    }),
};

const ACCESS: Access = Access {
    scheme: Scheme::Block,
    // A shipped driver for the bq27520-G3; no document gives it.
    select: Duration::from_millis(50),
    soonest: Duration::ZERO,
    // SLUS914A 7.3.
    commit: Duration::from_millis(100),
    enter: Duration::ZERO,
    enter_limit: Duration::ZERO,
    // SLUS914A 3.2 has 250 ms until it communicates; the limit is ours.
    reset: Duration::from_millis(300),
    reset_limit: Duration::from_secs(2),
    resets: Access::RESET,
    advances: false,
};

/// Values that a pack can have. Every place holds something else if the class is another.
#[rustfmt::skip]
static SIGNATURE: &[Signature] = &[
    Signature::new(34,  2, I2, CHARGED.0 as i64, CHARGED.1 as i64), // Charging Voltage
    Signature::new(48, 10, I2, 1, 32767),                           // Design Capacity
    Signature::new(68,  0, I2, 0, 4200),                            // Flash Update OK Voltage
    Signature::new(80, 48, I2, EMPTY.0 as i64, EMPTY.1 as i64),     // Terminate Voltage
    Signature::new(81,  4, I2, 0, 1000),                            // Quit Current
    Signature::new(81,  9, U1, 0, 63),                              // Quit Relax Time
];

/// The charging voltages of a lithium cell, in mV.
const CHARGED: (i32, i32) = (3000, 4600);
/// The voltages of an empty one.
const EMPTY: (i32, i32) = (2000, 4200);

/// Standard commands, SLUS914A Tables 4-1 and 4-5. The poll reads 0x06 to 0x19 and 0x22 to 0x2D whole.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, I2, "AtRate", "mA", Slow),
    Register::new(0x04, U2, "AtRateTimeToEmpty", "min", Slow),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0E, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x18, U2, "TimeToFull", "min", Poll).role(Role::TimeToFullNow),
    Register::new(0x1A, I2, "StandbyCurrent", "mA", Slow),
    Register::new(0x1C, U2, "StandbyTimeToEmpty", "min", Slow),
    Register::new(0x1E, I2, "MaxLoadCurrent", "mA", Slow),
    Register::new(0x20, U2, "MaxLoadTimeToEmpty", "min", Slow),
    Register::new(0x22, U2, "AvailableEnergy", "mWh", Poll).role(Role::EnergyNow),
    Register::new(0x24, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x26, U2, "TimeToEmptyAtConstantPower", "min", Poll).role(Role::TimeToEmptyAvg),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
    Register::new(0x6A, U1, "ApplicationStatus", "", Slow).bits(APPLICATION_STATUS),
];

/// SLUS914A, Table 4-2. Key words have no row.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0004, "DF_CHECKSUM", Answers).unsealed(),
    Subcommand::new(0x0005, "RESET_DATA", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    Subcommand::new(0x000D, "BATL_ENABLE", Allowed),
    Subcommand::new(0x000E, "BATL_DISABLE", Allowed),
    Subcommand::new(0x0011, "SET_HIBERNATE", Allowed),
    Subcommand::new(0x0012, "CLEAR_HIBERNATE", Allowed),
    Subcommand::new(0x0013, "SET_SLEEP+", Allowed),
    Subcommand::new(0x0014, "CLEAR_SLEEP+", Allowed),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    // What every finished product has: the way to start gauging. It cannot be taken back.
    Subcommand::new(0x0021, "IT_ENABLE", Allowed).unsealed(),
    Subcommand::new(0x0040, "CAL_MODE", Guarded).unsealed(),
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    // In no table. The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
];

/// SLUS914A, Table 4-3.
static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x4000, "FAS"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CSV"),
    Bit::new(0x0800, "CCA"),
    Bit::new(0x0400, "BCA"),
    Bit::new(0x0040, "HIBERNATE"),
    Bit::new(0x0020, "SNOOZE"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0004, "RUP_DIS"),
    Bit::new(0x0002, "VOK"),
    Bit::new(0x0001, "QEN"),
];

/// SLUS914A, Table 4-4.
static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x0800, "CHG_INH"),
    Bit::new(0x0400, "XCHG"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0020, "OCV_GD"),
    Bit::new(0x0010, "WAIT_ID"),
    Bit::new(0x0008, "BAT_DET"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

/// SLUS914A, Table 6-1: the profile in use.
static APPLICATION_STATUS: &[Bit] = &[Bit::new(0x01, "LU_PROF")];

/// SLUS914A, Table 5-3.
static OP_CONFIG: &[Bit] = &[
    Bit::new(0x8000, "RESCAP"),
    Bit::new(0x4000, "BATG_OVR"),
    Bit::new(0x2000, "I2C_NACK"),
    Bit::new(0x1000, "PFC_CFG1"),
    Bit::new(0x0800, "PFC_CFG0"),
    Bit::new(0x0400, "IWAKE"),
    Bit::new(0x0200, "RSNS1"),
    Bit::new(0x0100, "RSNS0"),
    Bit::new(0x0080, "GNDSEL"),
    Bit::new(0x0040, "IDSELEN"),
    Bit::new(0x0020, "SLEEP"),
    Bit::new(0x0010, "RMFCC"),
    Bit::new(0x0008, "BATL_POL"),
    Bit::new(0x0004, "BATG_POL"),
    Bit::new(0x0002, "BATL_CTL"),
    Bit::new(0x0001, "TEMPS"),
];

/// Above the present voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");

/// StateOfHealth() and the depth of discharge are fractions of it.
const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// Beyond these limits no further write would be let through.
const CHARGING: Safe = Safe::Within(CHARGED.0, CHARGED.1, LAYOUT);
const TERMINATE: Safe = Safe::Within(EMPTY.0, EMPTY.1, LAYOUT);
const LAYOUT: &str = "the layout of data flash is recognised by it";

// What shows that a row is where it is.
const TABLES_AND_IMAGES: &str =
    "SLUS914A, of firmware 1.30; TI's images of 1.06 and 1.20 hold its default there";
const TABLES_AND_ZERO: &str = "SLUS914A, of firmware 1.30; 0 in TI's images of 1.06 and 1.20";
const IMAGES_AND_DRIVER: &str = "TI's images of 1.06 and 1.20, and a driver for 1.20";
const ONLY_V130: &str = "SLUS914A, of firmware 1.30; TI's images of 1.06 and 1.20 differ there";
const TABLES_AND_DRIVER: &str = "SLUS914A, of firmware 1.30; a maker's driver reads it there";
const TABLES_AND_OTHER: &str = "SLUS914A, of firmware 1.30; TI's image of 1.20 holds another value there";

#[rustfmt::skip]
static SAFETY: &[P] = &[
    P::int(0, I2, "OT Chg",          0, 1200, 550, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(2, U1, "OT Chg Time",     0,   60,   2, "s").by(TABLES_AND_IMAGES),
    P::int(3, I2, "OT Chg Recovery", 0, 1200, 500, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(5, I2, "OT Dsg",          0, 1200, 600, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(7, U1, "OT Dsg Time",     0,   60,   2, "s").by(TABLES_AND_IMAGES),
    P::int(8, I2, "OT Dsg Recovery", 0, 1200, 550, "0.1°C").by(TABLES_AND_IMAGES),
];

#[rustfmt::skip]
static CHARGE_INHIBIT: &[P] = &[
    P::int(0, I2, "Charge Inhibit Temp Low",  -400, 1200,   0, "0.1°C").unproven().by(TABLES_AND_ZERO),
    P::int(2, I2, "Charge Inhibit Temp High", -400, 1200, 450, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(4, I2, "Temp Hys",                    0,  100,  50, "0.1°C").by(TABLES_AND_IMAGES),
];

#[rustfmt::skip]
static CHARGE: &[P] = &[
    P::int(2, I2, "Charging Voltage",     0, 20000, 4200, "mV").safe(CHARGING).role(Role::VoltageMaxDesign).by(TABLES_AND_IMAGES),
    P::int(4, I2, "Delta Temp",           0,   500,   50, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(6, I2, "Suspend Low Temp",  -400,  1200,  -50, "0.1°C").by(TABLES_AND_IMAGES),
    P::int(8, I2, "Suspend High Temp", -400,  1200,  550, "0.1°C").by(TABLES_AND_IMAGES),
];

/// The images of 1.06 and 1.20, and a driver for 1.20 (AMiRO's), with the names and limits of 1.30 where it has the row.
#[rustfmt::skip]
static CHARGE_TERMINATION: &[P] = &[
    P::int( 2, I2, "Taper Current",        0, 1000, 100, "mA").unproven().by(IMAGES_AND_DRIVER),
    P::int( 4, I2, "Minimum Taper Charge", 0, 1000,  25, "0.01mAh").unproven().by(IMAGES_AND_DRIVER),
    P::int( 6, I2, "Taper Voltage",        0, 1000, 100, "mV").unproven().by(IMAGES_AND_DRIVER),
    P::int( 8, U1, "Current Taper Window", 0,   60,  40, "s").unproven().by(IMAGES_AND_DRIVER),
    P::int( 9, I1, "TCA Set %",           -1,  100,  99, "%").unprinted().unproven().by(IMAGES_AND_DRIVER),
    P::int(10, I1, "TCA Clear %",         -1,  100,  95, "%").unprinted().unproven().by(IMAGES_AND_DRIVER),
    P::int(11, I1, "FC Set %",            -1,  100, 100, "%").unproven().by(IMAGES_AND_DRIVER),
    P::int(12, I1, "FC Clear %",          -1,  100,  98, "%").unproven().by(IMAGES_AND_DRIVER),
];

#[rustfmt::skip]
static CHARGE_TERMINATION_V130: &[P] = &[
    P::int( 0, I2, "Taper Current",        0, 1000, 100, "mA").unproven().by(ONLY_V130),
    P::int( 2, I2, "Minimum Taper Charge", 0, 1000,  25, "0.01mAh").unproven().by(ONLY_V130),
    P::int( 4, I2, "Taper Voltage",        0, 1000, 100, "mV").unproven().by(ONLY_V130),
    P::int( 6, U1, "Current Taper Window", 0,   60,  40, "s").unproven().by(ONLY_V130),
    P::int( 9, I1, "FC Set %",            -1,  100, 100, "%").unproven().by(ONLY_V130),
    P::int(10, I1, "FC Clear %",          -1,  100,  98, "%").unproven().by(ONLY_V130),
];

#[rustfmt::skip]
static DATA: &[P] = &[
    P::int( 4, I1, "Initial Standby Current",    -128,     0,  -10, "mA").by(TABLES_AND_IMAGES),
    P::int( 5, I2, "Initial Max Load Current", -32767,     0, -500, "mA").by(TABLES_AND_IMAGES),
    P::int( 7, I2, "CC Threshold",                100, 32767,  900, "mAh").by(TABLES_AND_IMAGES),
    // 65535 is printed for the maximum of this signed word.
    P::int(10, I2, "Design Capacity",               0, 32767, 1000, "mAh").safe(CAPACITY).by(TABLES_AND_IMAGES),
    P::text(12, 8, "Device Name", "bq27500").by(TABLES_AND_IMAGES),
];

#[rustfmt::skip]
static DISCHARGE: &[P] = &[
    P::int(0, U1, "SOC1 Set Threshold",   0, 255, 150, "mAh").by(TABLES_AND_IMAGES),
    P::int(1, U1, "SOC1 Clear Threshold", 0, 255, 175, "mAh").by(TABLES_AND_IMAGES),
    P::int(2, U1, "SOCF Set Threshold",   0, 255,  75, "mAh").by(TABLES_AND_IMAGES),
    P::int(3, U1, "SOCF Clear Threshold", 0, 255, 100, "mAh").by(TABLES_AND_IMAGES),
];

#[rustfmt::skip]
static MANUFACTURER_INFO: &[P] = &[
    P::int( 0, H1, "Block A 0",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 1, H1, "Block A 1",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 2, H1, "Block A 2",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 3, H1, "Block A 3",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 4, H1, "Block A 4",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 5, H1, "Block A 5",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 6, H1, "Block A 6",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 7, H1, "Block A 7",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 8, H1, "Block A 8",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int( 9, H1, "Block A 9",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(10, H1, "Block A 10",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(11, H1, "Block A 11",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(12, H1, "Block A 12",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(13, H1, "Block A 13",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(14, H1, "Block A 14",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(15, H1, "Block A 15",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(16, H1, "Block A 16",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(17, H1, "Block A 17",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(18, H1, "Block A 18",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(19, H1, "Block A 19",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(20, H1, "Block A 20",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(21, H1, "Block A 21",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(22, H1, "Block A 22",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(23, H1, "Block A 23",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(24, H1, "Block A 24",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(25, H1, "Block A 25",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(26, H1, "Block A 26",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(27, H1, "Block A 27",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(28, H1, "Block A 28",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(29, H1, "Block A 29",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(30, H1, "Block A 30",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(31, H1, "Block A 31",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(32, H1, "Block B 0",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(33, H1, "Block B 1",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(34, H1, "Block B 2",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(35, H1, "Block B 3",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(36, H1, "Block B 4",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(37, H1, "Block B 5",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(38, H1, "Block B 6",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(39, H1, "Block B 7",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(40, H1, "Block B 8",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(41, H1, "Block B 9",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(42, H1, "Block B 10",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(43, H1, "Block B 11",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(44, H1, "Block B 12",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(45, H1, "Block B 13",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(46, H1, "Block B 14",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(47, H1, "Block B 15",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(48, H1, "Block B 16",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(49, H1, "Block B 17",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(50, H1, "Block B 18",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(51, H1, "Block B 19",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(52, H1, "Block B 20",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(53, H1, "Block B 21",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(54, H1, "Block B 22",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(55, H1, "Block B 23",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(56, H1, "Block B 24",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(57, H1, "Block B 25",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(58, H1, "Block B 26",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(59, H1, "Block B 27",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(60, H1, "Block B 28",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(61, H1, "Block B 29",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(62, H1, "Block B 30",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(63, H1, "Block B 31",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(64, H1, "Block C 0",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(65, H1, "Block C 1",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(66, H1, "Block C 2",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(67, H1, "Block C 3",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(68, H1, "Block C 4",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(69, H1, "Block C 5",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(70, H1, "Block C 6",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(71, H1, "Block C 7",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(72, H1, "Block C 8",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(73, H1, "Block C 9",   0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(74, H1, "Block C 10",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(75, H1, "Block C 11",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(76, H1, "Block C 12",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(77, H1, "Block C 13",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(78, H1, "Block C 14",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(79, H1, "Block C 15",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(80, H1, "Block C 16",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(81, H1, "Block C 17",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(82, H1, "Block C 18",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(83, H1, "Block C 19",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(84, H1, "Block C 20",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(85, H1, "Block C 21",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(86, H1, "Block C 22",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(87, H1, "Block C 23",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(88, H1, "Block C 24",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(89, H1, "Block C 25",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(90, H1, "Block C 26",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(91, H1, "Block C 27",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(92, H1, "Block C 28",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(93, H1, "Block C 29",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(94, H1, "Block C 30",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
    P::int(95, H1, "Block C 31",  0x00, 0xFF, 0x00, "hex").unproven().by(TABLES_AND_DRIVER),
];

/// The first rows, in which the layouts agree.
static REGISTERS_64: &[P] = REGISTERS_64_V130.split_at(1).0;

#[rustfmt::skip]
static REGISTERS_64_V130: &[P] = &[
    P::within( 0, H2, "Operation Configuration", 0x0000, 0xFFFF, "flags").bits(OP_CONFIG).unproven().by(TABLES_AND_IMAGES),
    P::int( 8, U2, "Batt Insert Delay",  0, 65535, 0, "ms").unproven().by(ONLY_V130),
    P::int(10, U1, "Sleep Insert Delay", 0,   255, 0, "s").unproven().by(ONLY_V130),
];

static POWER: &[P] = POWER_V130.split_at(4).0;

#[rustfmt::skip]
static POWER_V130: &[P] = &[
    P::int( 0, I2, "Flash Update OK Voltage",   0, 4200, 2800, "mV").safe(GATE).by(TABLES_AND_IMAGES),
    P::int( 7, I2, "Sleep Current",             0,  100,   10, "mA").by(TABLES_AND_IMAGES),
    P::int(16, U2, "Hibernate Current",         0,  700,    8, "mA").by(TABLES_AND_IMAGES),
    P::int(18, U2, "Hibernate Voltage",      2400, 3000, 2550, "mV").by(TABLES_AND_IMAGES),
    P::int(20, U2, "BAT_LOW Enable Voltage", 2800, 4000, 3400, "mV").unproven().by(TABLES_AND_OTHER),
];

#[rustfmt::skip]
static IT_CFG: &[P] = &[
    P::int( 0, U1, "Load Select",            0,   255,    1, "").by(TABLES_AND_IMAGES),
    P::int( 1, U1, "Load Mode",              0,   255,    0, "").unproven().by(TABLES_AND_ZERO),
    P::int(48, I2, "Terminate Voltage", -32768, 32767, 3000, "mV").safe(TERMINATE).role(Role::VoltageMinDesign).by(TABLES_AND_IMAGES),
    P::int(53, I2, "User Rate-mA",           0,  9000,    0, "mA").unproven().by(TABLES_AND_ZERO),
    P::int(55, I2, "User Rate-mW",           0, 14000,    0, "mW").unproven().by(TABLES_AND_ZERO),
    P::int(57, I2, "Reserve Cap-mAh",        0,  9000,    0, "mAh").unproven().by(TABLES_AND_ZERO),
    P::int(59, I2, "Reserve Cap-mWh",        0, 14000,    0, "mWh").unproven().by(TABLES_AND_ZERO),
];

static CURRENT_THRESHOLDS: &[P] = CURRENT_THRESHOLDS_V130.split_at(6).0;

#[rustfmt::skip]
static CURRENT_THRESHOLDS_V130: &[P] = &[
    P::int( 0, I2, "Dsg Current Threshold",      0, 2000,  60, "mA").by(TABLES_AND_IMAGES),
    P::int( 2, I2, "Chg Current Threshold",      0, 2000,  75, "mA").by(TABLES_AND_IMAGES),
    P::int( 4, I2, "Quit Current",               0, 1000,  40, "mA").by(TABLES_AND_IMAGES),
    // 1800 in firmware 1.06.
    P::int( 6, U2, "Dsg Relax Time",             0, 8191,  60, "s").by(TABLES_AND_IMAGES),
    P::int( 8, U1, "Chg Relax Time",             0,  255,  60, "s").by(TABLES_AND_IMAGES),
    P::int( 9, U1, "Quit Relax Time",            0,   63,   1, "s").by(TABLES_AND_IMAGES),
    P::int(10, U1, "Transient Factor Charge",    0,  255, 128, "").unproven().by(ONLY_V130),
    P::int(11, U1, "Transient Factor Discharge", 0,  255, 128, "").unproven().by(ONLY_V130),
    P::int(12, U2, "Max IR Correct",             0, 1000, 400, "mV").unproven().by(ONLY_V130),
];

#[rustfmt::skip]
static STATE: &[P] = &[
    P::int( 0, H1, "IT Enable",               0x00,  0xFF,  0x00, "hex").unproven().by(TABLES_AND_ZERO),
    P::int( 1, H1, "Application Status",      0x00,  0xFF,  0x00, "hex").unproven().by(TABLES_AND_ZERO),
    P::int( 2, I2, "Qmax Cell 0",                0, 32767,  1000, "mAh").learned().unproven().by(TABLES_AND_IMAGES),
    P::int( 4, U2, "Cycle Count 0",              0, 65535,     0, "").learned().unproven().by(TABLES_AND_ZERO),
    P::int( 6, H1, "Update Status 0",         0x00,  0x03,  0x00, "hex").learned().unproven().by(TABLES_AND_ZERO),
    P::int( 7, I2, "Qmax Cell 1",                0, 32767,  1000, "mAh").learned().unproven().by(TABLES_AND_IMAGES),
    P::int( 9, U2, "Cycle Count 1",              0, 65535,     0, "").learned().unproven().by(TABLES_AND_ZERO),
    P::int(11, H1, "Update Status 1",         0x00,  0x03,  0x00, "hex").learned().unproven().by(TABLES_AND_ZERO),
    P::int(16, I2, "Avg I Last Run",        -32768, 32767,  -299, "mA").learned().unproven().by(TABLES_AND_IMAGES),
    // Printed in mAh.
    P::int(18, I2, "Avg P Last Run",        -32768, 32767, -1131, "mW").learned().unproven().by(TABLES_AND_IMAGES),
];

#[rustfmt::skip]
static CALIBRATION: &[P] = &[
    // Printed in milliohms, 0.1 to 47 and 4.7 to 188, 10 for both; these are the stored numbers: 4.768 / CC Gain and
    // 5677445 / CC Delta are the milliohms. Defaults here and at 104/11 are the images', with which parts left the
    // factory.
    P::float( 0, "CC Gain",    0.1014,       47.68,   0.47095, "Num").unproven().by(TABLES_AND_IMAGES),
    P::float( 4, "CC Delta", 30_199.0, 1_207_967.0, 559_500.0, "Num").unproven().by(TABLES_AND_IMAGES),
    // Printed in mV, -0.123; the images have -1200.
    P::any( 8, I2, "CC Offset", "Num").learned().unproven().by(TABLES_AND_OTHER),
    P::int(10, I1, "Board Offset",    -128, 127,  0, "Num").learned().unproven().by(TABLES_AND_ZERO),
    P::int(11, I1, "Int Temp Offset", -128, 127, 78, "0.1°C").unproven().by(TABLES_AND_OTHER),
    P::int(12, I1, "Ext Temp Offset", -128, 127,  0, "0.1°C").unproven().by(TABLES_AND_ZERO),
    // Printed in 0.1°C.
    P::int(13, I1, "Pack V Offset",   -128, 127,  0, "mV").unproven().by(TABLES_AND_ZERO),
];

/// The images of 1.06 and 1.20 have 239 and 5 behind 104, where other parts of the family have Filter and Deadband.
#[rustfmt::skip]
static CURRENT: &[P] = &[
    P::int(1, U1, "Deadband", 0, 255, 5, "mA").unproven().by(TABLES_AND_OTHER),
];

#[rustfmt::skip]
static CODES: &[P] = &[
    // No defaults: nothing that shows defaults may show these.
    P::any(0, H2, "Unseal Key 0", "hex"),
    P::any(2, H2, "Unseal Key 1", "hex"),
    P::any(4, H2, "Full-Access Key 0", "hex"),
    P::any(6, H2, "Full-Access Key 1", "hex"),
];

const fn subclass(
    class: &'static str,
    name: &'static str,
    id: u8,
    length: u16,
    kind: super::Kind,
    parameters: &'static [P],
) -> Subclass {
    Subclass { class, name, id, length, kind, parameters }
}

/// Firmware 1.06 and 1.20.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    subclass("Configuration", "Safety", 2, 10, Reset, SAFETY),
    subclass("Configuration", "Charge Inhibit Config", 32, 6, Reset, CHARGE_INHIBIT),
    subclass("Configuration", "Charge", 34, 10, Reset, CHARGE),
    subclass("Configuration", "Charge Termination", 36, 13, Reset, CHARGE_TERMINATION),
    subclass("Configuration", "Data", 48, 20, Reset, DATA),
    subclass("Configuration", "Discharge", 49, 4, Reset, DISCHARGE),
    subclass("System Data", "Manufacturer Info", 57, 96, Plain, MANUFACTURER_INFO),
    subclass("Configuration", "Registers", 64, 2, Reset, REGISTERS_64),
    subclass("Configuration", "Power", 68, 20, Reset, POWER),
    subclass("Fuel Gauging", "IT Cfg", 80, 61, Reset, IT_CFG),
    subclass("Fuel Gauging", "Current Thresholds", 81, 10, Reset, CURRENT_THRESHOLDS),
    subclass("Fuel Gauging", "State", 82, 20, Reset, STATE),
    subclass("Calibration", "Data", 104, 14, Reset, CALIBRATION),
    subclass("Calibration", "Current", 107, 2, Reset, CURRENT),
    subclass("Security", "Codes", 112, 8, Keys, CODES),
];

/// SLUS914A, Table 4-7, in its order. It lists the encoded profiles 87, 88 and 91 to 94 as well, without their bytes.
#[rustfmt::skip]
static SUBCLASSES_V130: &[Subclass] = &[
    subclass("Configuration", "Safety", 2, 10, Reset, SAFETY),
    subclass("Configuration", "Charge Inhibit Config", 32, 6, Reset, CHARGE_INHIBIT),
    subclass("Configuration", "Charge", 34, 10, Reset, CHARGE),
    subclass("Configuration", "Charge Termination", 36, 11, Reset, CHARGE_TERMINATION_V130),
    subclass("Configuration", "Data", 48, 20, Reset, DATA),
    subclass("Configuration", "Discharge", 49, 4, Reset, DISCHARGE),
    subclass("System Data", "Manufacturer Info", 57, 96, Plain, MANUFACTURER_INFO),
    subclass("Configuration", "Registers", 64, 11, Reset, REGISTERS_64_V130),
    subclass("Configuration", "Power", 68, 22, Reset, POWER_V130),
    subclass("Fuel Gauging", "IT Cfg", 80, 61, Reset, IT_CFG),
    subclass("Fuel Gauging", "Current Thresholds", 81, 14, Reset, CURRENT_THRESHOLDS_V130),
    subclass("Fuel Gauging", "State", 82, 20, Reset, STATE),
    subclass("Calibration", "Data", 104, 14, Reset, CALIBRATION),
    subclass("Calibration", "Current", 107, 2, Reset, CURRENT),
    subclass("Security", "Codes", 112, 8, Keys, CODES),
];
