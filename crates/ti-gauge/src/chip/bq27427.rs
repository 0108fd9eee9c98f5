// SPDX-License-Identifier: MIT

//! BQ27427: Impedance Track gauge with a sense resistor of its own, for one Li-ion cell; data memory is
//! RAM.
//!
//! Section numbers are those of the technical reference, SLUUCD5. Its data memory summary could not be
//! read as a whole: rows of single sections are proven, and so are those of the State block, which a
//! trace from a part shows with its checksum. The others follow from an image that a shipped product
//! writes, laid beside the bq27441-G1's table: offset, type and value fit, the name is inferred. They are
//! proven where 21 images of the BQ27426, which are another maker's, have the same layout: the bq27441-G1's
//! default at the same place, a table of Ra values, or voltages that fit. A library for this part
//! (github.com/edreanernst/BQ27427_Arduino_Library) writes 49/0 to 3, 81/0 and 109/8. The others are marked: a
//! zero proves nothing, and those images lack 104, 105 and 107, or have no values that could be
//! recognised there. Left out are two values of the State block and one of Chem Data without a name.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Reset, Security as Keys};
use super::Tier::{Poll, Slow, Window};
use super::bq27441_g1::{CAPACITY, CONDITION, ITPOR, KEEP_STATE, LOAD_SELECT, SECURITY, preflight};
use super::{
    Access, Bit, Chip, Evidence, Identity, Parameter as P, Quirk, Register, Role, Scale, Scaling, Scheme,
    Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The BQ27427 as TI's documents and traces describe it.
pub static CHIP: Chip = Chip {
    name: "bq27427",
    model: "BQ27427",
    documents: &["SLUUCD5 (January 2023)", "SLUUCD5A", "SLUSEB5B (September 2025)"],
    // Traces of parts: identity, CONFIG UPDATE and the State block.
    evidence: &[Evidence::Manual, Evidence::Transcript, Evidence::Image, Evidence::Kernel],
    // The firmware is what parts answer.
    identity: Identity {
        device_type: 0x0427,
        firmware: &[0x0202],
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
    condition: CONDITION,
    scaling: SCALING,
    security: SECURITY,
    asks: None,
    access: ACCESS,
    gate: None,
    authentication: None,
    subclasses: SUBCLASSES,
    // The rule of the family, SLUSBH1C 9.5.4.3.
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: &[],
    volatile: Some(ITPOR),
    quirks: &[Quirk {
        subclass: 105,
        offset: 5,
        mask: 0x80,
        wrong: 0x80,
        effect: "CC Gain is negative, as many parts have it in ROM: current has the wrong sign",
        remedy: "write CC Gain (105/4) again without its minus, and after each loss of power once more",
    }],
    rom_image: None,
    // OpConfigD [ChemID1], [ChemID0].
    preflight: preflight(&[(64, 4)]),
};

pub(super) const ACCESS: Access = Access {
    scheme: Scheme::CfgUpdate,
    // No document gives it; Zephyr's bq274xx waits so long.
    select: Duration::from_millis(30),
    // Zephyr's bq274xx, on parts of this family; the kernel's driver waits 1 ms.
    soonest: Duration::from_millis(5),
    // What a shipped product waits before it reads the checksum back; SLUA801 has it for the family.
    commit: Duration::from_millis(10),
    // 2.4.3: at least so long, where the bq27441-G1 is asked at once.
    enter: Duration::from_millis(1100),
    enter_limit: Duration::from_millis(2500),
    // [CFGUPMODE] shows the end. A shipped product gives it 2 s.
    reset: Duration::ZERO,
    reset_limit: Duration::from_secs(4),
    resets: Access::RESET,
    advances: false,
};

/// Standard commands, chapter 5, and extended ones, chapter 6. The poll reads 0x02 to 0x11 and 0x18 to
/// 0x21 whole, so all in there count as polled. Seven more addresses answer with something that has no
/// name (0x16, 0x1A, 0x66, 0x68, 0x6C, 0x6E and 0x70).
#[rustfmt::skip]
pub(super) static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x04, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x06, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x08, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0A, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x0C, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x0E, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x10, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    // These two are the bq27441-G1's; Zephyr's bq274xx reads them here, TI's documents are silent.
    Register::new(0x12, I2, "StandbyCurrent", "mA", Slow),
    Register::new(0x14, I2, "MaxLoadCurrent", "mA", Slow),
    Register::new(0x18, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x1C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x1E, U2, "InternalTemperature", "0.1K", Poll),
    // Not in SLUUCD5 but in its revision A: a percentage and what stands behind it.
    Register::new(0x20, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x21),
    Register::new(0x21, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x28, U2, "RemainingCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2A, U2, "RemainingCapacityFiltered", "mAh", Slow),
    Register::new(0x2C, U2, "FullChargeCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2E, U2, "FullChargeCapacityFiltered", "mAh", Slow),
    Register::new(0x30, U2, "StateOfChargeUnfiltered", "%", Slow),
    Register::new(0x3E, U1, "DataClass", "", Window),
    Register::new(0x3F, U1, "DataBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

/// The table of 5.1. Key words are no subcommands and have no row.
#[rustfmt::skip]
pub(super) static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0004, "DM_CODE", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    Subcommand::new(0x000C, "BAT_INSERT", Allowed),
    Subcommand::new(0x000D, "BAT_REMOVE", Allowed),
    // The transaction's own way into CONFIG UPDATE, in which the gauge does not gauge.
    Subcommand::new(0x0013, "SET_CFGUPDATE", Guarded).unsealed(),
    Subcommand::new(0x0019, "SMOOTH_SYNC", Allowed),
    // Only an edge on GPOUT wakes the gauge again, its data memory lost.
    Subcommand::new(0x001B, "SHUTDOWN_ENABLE", Never).unsealed(),
    Subcommand::new(0x001C, "SHUTDOWN", Never).unsealed(),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    Subcommand::new(0x0023, "PULSE_SOC_INT", Allowed),
    // Chemistries for 4.35, 4.2 and 4.4 V, taken in CONFIG UPDATE only.
    Subcommand::new(0x0030, "CHEM_A", Guarded).unsealed(),
    Subcommand::new(0x0031, "CHEM_B", Guarded).unsealed(),
    Subcommand::new(0x0032, "CHEM_C", Guarded).unsealed(),
    // The whole configuration is lost.
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0042, "SOFT_RESET", Guarded).unsealed(),
];

/// A shipped product multiplies both capacities by it and leaves the current alone. For energies and powers it is the unit
/// by the manuals of other parts (SLUSAT0E, SLUSBZ5D 7.3.6.5).
pub(super) const SCALING: Scaling =
    Scaling { charge: Scale::Flash(80, 81), energy: Scale::Flash(80, 81), ..Scaling::NONE };

/// 5.1.1.
pub(super) static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x8000, "SHUTDOWNEN"),
    Bit::new(0x4000, "WDRESET"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CALMODE"),
    Bit::new(0x0800, "CCA"),
    Bit::new(0x0400, "BCA"),
    Bit::new(0x0200, "QMAX_UP"),
    Bit::new(0x0100, "RES_UP"),
    Bit::new(0x0080, "INITCOMP"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0004, "RUP_DIS"),
    Bit::new(0x0002, "VOK"),
    Bit::new(0x0001, "CHEMCHANGE"),
];

/// 5.4.
static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OT"),
    Bit::new(0x4000, "UT"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0080, "OCVTAKEN"),
    Bit::new(0x0040, "DOD_CORRECT"),
    Bit::new(ITPOR, "ITPOR"),
    Bit::new(0x0010, "CFGUPMODE"),
    Bit::new(0x0008, "BAT_DET"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

/// The section on OpConfig. Two of the reserved bits have to stay 1.
pub(super) static OP_CONFIG: &[Bit] = &[
    Bit::new(0x2000, "BIE"),
    Bit::new(0x0800, "GPIOPOL"),
    Bit::new(0x0040, "ResFactStep"),
    Bit::new(0x0020, "SLEEP"),
    Bit::new(0x0010, "RMFCC"),
    Bit::new(0x0008, "FastConvEn"),
    Bit::new(0x0004, "BATLOWEN"),
    Bit::new(0x0002, "TempSource1"),
    Bit::new(0x0001, "TempSource0"),
];

/// The bq27441-G1's only name.
static OP_CONFIG_B: &[Bit] = &[Bit::new(0x04, "SMOOTHEN")];

/// The section on OpConfigD.
pub(super) static OP_CONFIG_D: &[Bit] = &[
    Bit::new(0x80, "FilterAlways"),
    Bit::new(0x40, "NoDeltaVAvg"),
    Bit::new(0x20, "PostponeLgDrops0"),
    Bit::new(0x10, "ChemID1"),
    Bit::new(0x08, "ChemID0"),
    Bit::new(0x04, "DODCorChgAlways"),
    Bit::new(0x02, "DODCorChg"),
    Bit::new(0x01, "DODCorDSG"),
];

/// Data memory, in the bq27441-G1's order.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Configuration", name: "Safety", id: 2, length: 5, kind: Reset,
               parameters: &[
        P::int(0, I2, "Over Temp",  -1200, 1200, 550, "0.1°C"),
        P::int(2, I2, "Under Temp", -1200, 1200,   0, "0.1°C"),
        P::int(4, U1, "Temp Hys",       0,  255,  50, "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Charge Termination", id: 36, length: 9, kind: Reset,
               parameters: &[
        P::int(3, I1, "TCA Set %",        -1,  100, 99, "%"),
        P::int(4, I1, "TCA Clear %",      -1,  100, 95, "%"),
        P::int(5, I1, "FC Set %",         -1,  100, -1, "%"),
        P::int(6, I1, "FC Clear %",        0,  100, 98, "%"),
        P::int(7, I2, "DODatEOC Delta T",  0, 1000, 50, "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: 49, length: 4, kind: Reset,
               parameters: &[
        P::int(0, U1, "SOC1 Set Threshold",   0, 100, 10, "%"),
        P::int(1, U1, "SOC1 Clear Threshold", 0, 100, 15, "%"),
        P::int(2, U1, "SOCF Set Threshold",   0, 100,  2, "%"),
        P::int(3, U1, "SOCF Clear Threshold", 0, 100,  5, "%"),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: 64, length: 5, kind: Reset,
               parameters: &[
        P::int(0, H2, "OpConfig",  0x0000, 0xFFFF, 0x6478, "flags").bits(OP_CONFIG),
        P::int(2, H1, "OpConfigB",   0x00,   0xFF,   0x0F, "flags").bits(OP_CONFIG_B),
        P::int(3, H1, "OpConfigC",   0x00,   0xFF,   0x9F, "flags").unproven(),
        // The section prints offset 2, where the image has OpConfigB; this value is here in the image.
        P::int(4, H1, "OpConfigD",   0x00,   0xFF,   0x23, "flags").bits(OP_CONFIG_D),
    ] },
    Subclass { class: "Configuration", name: "Power", id: 68, length: 9, kind: Reset,
               parameters: &[
        // No HIBERNATE is documented for this part; both are probably unused.
        P::int(5, I2, "Hibernate I", 0, 8000,    3, "mA"),
        P::int(7, I2, "Hibernate V", 0, 5000, 2200, "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: 80, length: 82, kind: Reset,
               parameters: &[
        P::int(18, U2, "Ra Filter",                        0,  1000, 800, "Num"),
        P::int(33, U1, "Fast Qmax Start DOD %",            0,   100,  92, "%"),
        P::int(34, U1, "Fast Qmax End DOD %",              0,   100,  96, "%"),
        P::int(35, I2, "Fast Qmax Start Volt Delta",       0,  4200, 125, "mV"),
        P::int(37, U2, "Fast Qmax Current Threshold",      0,  1000,   4, "Hr rate"),
        P::int(39, U1, "Fast Qmax Min Points",             0,   255,   3, "Num"),
        P::int(43, U1, "Max Qmax Change",                  0,   255,  20, "%"),
        P::int(44, U1, "Qmax Max Delta %",                 0,   255,  10, "%"),
        P::int(45, U1, "Max % Default Qmax",               0,   255, 120, "%"),
        P::int(46, U1, "Qmax Filter",                      0,   255,  96, "Num"),
        P::int(48, U2, "ResRelax Time",                    0, 65535, 500, "s"),
        P::int(50, I2, "User Rate-mA",                -32768,     0,   0, "mA").unproven(),
        P::int(52, I2, "User Rate-mW",                -32768,     0,   0, "mW").unproven(),
        P::int(57, U1, "Max Sim Rate",                     0,   255,   1, "Hr rate"),
        P::int(58, U1, "Min Sim Rate",                     0,   255,  20, "Hr rate"),
        P::int(59, U2, "Ra Max Delta",                     0, 32767,   8, "4 mΩ"),
        P::int(68, I2, "Min Delta Voltage",                0, 32767,   0, "mV").unproven(),
        P::int(70, I2, "Max Delta Voltage",                0, 32767, 200, "mV"),
        P::int(72, I2, "DeltaV Max dV",                    0, 32767, 100, "mV"),
        // The section prints offset 78, which is the bq27441-G1's.
        P::int(74, U1, "TermV Valid t",                    0,   255,   2, "s"),
        // One driver names it; its image for one cell has 1, and that for two has 10. Other parts have no other
        // values (SLUSAT0E).
        // A product's image for one cell has 1 here, and the one for two cells 10, by which its program multiplies both
        // capacities.
        P::int(81, U1, "Design Energy Scale",              1,    10,   1, "Num"),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        // The image has 450 and for Quit Current 100, the bq27441-G1 167 and 250.
        P::int( 0, I2, "Dsg Current Threshold", 0,  2000, 450, "0.1 Hr rate").no_default(),
        P::int( 2, I2, "Chg Current Threshold", 0,  2000, 100, "0.1 Hr rate"),
        P::int( 4, I2, "Quit Current",          0,  2000, 100, "0.1 Hr rate").no_default(),
        P::int( 6, U2, "Dsg Relax Time",        0, 65535,  60, "s"),
        P::int( 8, U1, "Chg Relax Time",        0,   255,  60, "s"),
        P::int( 9, U1, "Quit Relax Time",       0,   255,   1, "s"),
        P::int(12, U2, "Max IR Correct",        0,  1000, 400, "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: 82, length: 31, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Qmax Cell 0",            0, 32767, 16384, "Num").safe(CAPACITY).learned(),
        P::int( 2, H1, "Update Status",       0x00,  0xFF,  0x00, "hex").safe(KEEP_STATE).learned(),
        P::int( 3, I2, "Reserve Cap-mAh",        0,  9000,     0, "mAh"),
        P::int( 5, H1, "Load Select/Mode",    0x00,  0xFF,  0x81, "hex").bits(LOAD_SELECT),
        P::int( 6, I2, "Design Capacity",        0,  8000,  1340, "mAh").safe(CAPACITY).role(Role::ChargeFullDesign),
        P::int( 8, I2, "Design Energy",          0, 32767,  4960, "mWh"),
        P::int(10, I2, "Terminate Voltage",   2500,  3700,  3200, "mV").role(Role::VoltageMinDesign),
        P::int(16, I2, "T Rise",                 0, 32767,    20, "Num"),
        P::int(18, I2, "T Time Constant",        0, 32767,  1000, "s"),
        P::int(20, U1, "SOCI Delta",             0,   100,     1, "%"),
        P::int(21, I2, "Taper Rate",             0,  2000,   100, "0.1 Hr rate"),
        P::int(23, I2, "Sleep Current",          0,  1000,    10, "mA"),
        P::int(25, I2, "Avg I Last Run",    -32768,    -1,   -50, "0.1 Hr rate").learned(),
        P::int(27, I2, "Avg P Last Run",    -32768,    -1,   -50, "0.1 Hr rate").learned(),
        // Another section has Taper Voltage here, which the trace disproves.
        P::int(29, I2, "Delta Voltage",          0,  1000,     1, "mV").learned(),
    ] },
    Subclass { class: "Ra Tables", name: "Ra0 RAM", id: 89, length: 30, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Ra 0",  0, 32767, 78, "Num").learned(),
        P::int( 2, I2, "Ra 1",  0, 32767, 35, "Num").learned(),
        P::int( 4, I2, "Ra 2",  0, 32767, 39, "Num").learned(),
        P::int( 6, I2, "Ra 3",  0, 32767, 45, "Num").learned(),
        P::int( 8, I2, "Ra 4",  0, 32767, 42, "Num").learned(),
        P::int(10, I2, "Ra 5",  0, 32767, 36, "Num").learned(),
        P::int(12, I2, "Ra 6",  0, 32767, 39, "Num").learned(),
        P::int(14, I2, "Ra 7",  0, 32767, 36, "Num").learned(),
        P::int(16, I2, "Ra 8",  0, 32767, 35, "Num").learned(),
        P::int(18, I2, "Ra 9",  0, 32767, 37, "Num").learned(),
        P::int(20, I2, "Ra 10", 0, 32767, 38, "Num").learned(),
        P::int(22, I2, "Ra 11", 0, 32767, 40, "Num").learned(),
        P::int(24, I2, "Ra 12", 0, 32767, 46, "Num").learned(),
        P::int(26, I2, "Ra 13", 0, 32767, 54, "Num").learned(),
        P::int(28, I2, "Ra 14", 0, 32767, 46, "Num").learned(),
    ] },
    Subclass { class: "Gas Gauging", name: "Chem Data", id: 109, length: 10, kind: Reset,
               parameters: &[
        P::int(2, I2, "Q Invalid MaxV", 0, 32767, 3811, "mV"),
        P::int(4, I2, "Q Invalid MinV", 0, 32767, 3750, "mV"),
        P::int(6, I2, "V at Chg Term",  0,  5000, 4340, "mV").learned(),
        // The sections print class 82; the image has the value here, where a driver has it as well.
        P::int(8, I2, "Taper Voltage",  0,  5000, 4250, "mV"),
    ] },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 3, kind: Reset,
               parameters: &[
        P::int(0, I1, "Board Offset",    -128, 127, 0, "Counts").learned().unproven(),
        P::int(1, I1, "Int Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        P::int(2, I1, "Pack V Offset",   -128, 127, 0, "mV").unproven(),
    ] },
    Subclass { class: "Calibration", name: "CC Cal", id: 105, length: 12, kind: Reset,
               parameters: &[
        P::int(0, I2, "CC Offset",   -32768, 32767,    0, "Counts").learned(),
        P::int(2, I2, "CC Cal Temp",      0, 32767, 2982, "0.1K").learned(),
        // Limits of the magnitude. The ROM of many parts has -0.338979, of others -0.352335.
        P::float(4, "CC Gain",       0.1,        40.0,   0.338979, "Num").no_default(),
        P::float(8, "CC Delta", 30_000.0, 3_000_000.0, 799_341.14, "Num").no_default().unproven(),
    ] },
    Subclass { class: "Calibration", name: "Current", id: 107, length: 2, kind: Reset,
               parameters: &[
        P::int(1, U1, "Deadband", 0, 255, 5, "mA").unproven(),
    ] },
    Subclass { class: "Security", name: "Codes", id: 112, length: 4, kind: Keys,
               parameters: &[
        // No default: nothing that shows defaults may show a key.
        P::any(0, H4, "Sealed to Unsealed", "hex"),
    ] },
];
