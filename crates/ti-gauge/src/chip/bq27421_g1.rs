// SPDX-License-Identifier: MIT

//! bq27421-G1: the bq27441-G1 with a sense resistor of its own, 7 mΩ.
//!
//! Device type, firmware, standard commands and subcommands are the bq27441-G1's (SLUUAC9A 4.1.2), and
//! so are those tables here. The data memory tables of its own reference, SLUUAC5, have not been read:
//! parameters that shipped drivers write on this part are proven, and those whose place a product's image
//! of this part confirms. The others are the bq27441-G1's and marked.

use super::Kind::{Reset, Security as Keys};
use super::bq27441_g1::{
    ACCESS, CAPACITY, CONDITION, CONTROL_STATUS, ITPOR, KEEP_STATE, LOAD_SELECT, OP_CONFIG, OP_CONFIG_B,
    REGISTERS, SECURITY, SUBCOMMANDS, preflight,
};
use super::{Chip, Evidence, Identity, Parameter as P, Role, Scaling, Subclass};
use crate::codec::Layout;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27421-G1 as far as it is known.
pub static CHIP: Chip = Chip {
    name: "bq27421-g1",
    model: "bq27421-G1",
    documents: &["SLUUAC9A (May 2015), of the bq27441-G1"],
    evidence: &[Evidence::Sibling, Evidence::Drivers, Evidence::Kernel],
    // Its DM_CODE is printed nowhere that we found: any code that is not another part's.
    identity: Identity {
        device_type: 0x0421,
        firmware: &[0x0109],
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
    scaling: Scaling::NONE,
    security: SECURITY,
    asks: None,
    access: ACCESS,
    gate: None,
    authentication: None,
    subclasses: SUBCLASSES,
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: &[],
    volatile: Some(ITPOR),
    quirks: &[],
    rom_image: None,
    preflight: preflight(&[]),
};

/// Proven are the rows of the kernel's driver (82/10, 12 and 16), of Zephyr's bq274xx (82/27 as well)
/// and of an Android kernel's tables of learned values (82/0 and 89). The others are where the bq27441-G1
/// has them, with the defaults of its G1A. Of these, an image for this part (github.com/Monstatek/M1,
/// Battery/Golden_Image_0420.h, commit 30bcf002) proves the rows that hold that default in it, and those
/// between two such rows, or between one and the start of the block, without a gap. A zero elsewhere proves
/// nothing, so 80/52, 54 and 72 are not proven; nor is what follows 82/31, or is not in the image (104,
/// 105 and 107).
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
    Subclass { class: "Configuration", name: "Data", id: 48, length: 5, kind: Reset,
               parameters: &[
        P::int(2, I1, "Initial Standby",   -128, 0,   -3, "mA"),
        P::int(3, I2, "Initial MaxLoad", -32768, 0, -200, "mA"),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: 49, length: 4, kind: Reset,
               parameters: &[
        P::int(0, U1, "SOC1 Set Threshold",   0, 100, 10, "%"),
        P::int(1, U1, "SOC1 Clear Threshold", 0, 100, 15, "%"),
        P::int(2, U1, "SOCF Set Threshold",   0, 100,  2, "%"),
        P::int(3, U1, "SOCF Clear Threshold", 0, 100,  5, "%"),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: 64, length: 3, kind: Reset,
               parameters: &[
        P::int(0, H2, "OpConfig",  0x0000, 0xFFFF, 0x25F8, "flags").bits(OP_CONFIG),
        P::int(2, H1, "OpConfigB",   0x00,   0xFF,   0x0F, "flags").bits(OP_CONFIG_B),
    ] },
    Subclass { class: "Configuration", name: "Power", id: 68, length: 11, kind: Reset,
               parameters: &[
        P::int(7, I2, "Hibernate I", 0, 8000,    3, "mA"),
        P::int(9, I2, "Hibernate V", 0, 5000, 2200, "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: 80, length: 79, kind: Reset,
               parameters: &[
        P::int(22, U2, "Ra Filter",                        0,  1000, 800, "Num"),
        P::int(35, U1, "Fast Qmax Start DOD %",            0,   100,  92, "%"),
        P::int(36, U1, "Fast Qmax End DOD %",              0,   100,  96, "%"),
        P::int(37, I2, "Fast Qmax Start Volt Delta",       0,  4200, 125, "mV"),
        P::int(39, U2, "Fast Qmax Current Threshold",      0,  1000,   4, "Hr rate"),
        P::int(41, U1, "Fast Qmax Min Points",             0,   255,   3, "Num"),
        P::int(45, U1, "Max Qmax Change",                  0,   255,  20, "%"),
        P::int(46, U1, "Qmax Max Delta %",                 0,   255,  10, "%"),
        P::int(47, U1, "Max % Default Qmax",               0,   255, 120, "%"),
        P::int(48, U1, "Qmax Filter",                      0,   255,  96, "Num"),
        P::int(50, U2, "ResRelax Time",                    0, 65535, 500, "s"),
        P::int(52, I2, "User Rate-mA",                -32768,     0,   0, "mA").unproven(),
        P::int(54, I2, "User Rate-mW",                -32768,     0,   0, "mW").unproven(),
        P::int(61, U1, "Max Sim Rate",                     0,   255,   1, "Hr rate"),
        P::int(62, U1, "Min Sim Rate",                     0,   255,  20, "Hr rate"),
        P::int(63, U2, "Ra Max Delta",                     0, 32767,  11, "4 mΩ"),
        P::int(72, I2, "Min Delta Voltage",                0, 32767,   0, "mV").unproven(),
        P::int(74, I2, "Max Delta Voltage",                0, 32767, 200, "mV"),
        P::int(76, I2, "DeltaV Max dV",                    0, 32767, 100, "mV"),
        P::int(78, U1, "TermV Valid t",                    0,   255,   2, "s"),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Dsg Current Threshold", 0,  2000, 167, "0.1 Hr rate"),
        P::int( 2, I2, "Chg Current Threshold", 0,  2000, 100, "0.1 Hr rate"),
        P::int( 4, I2, "Quit Current",          0,  2000, 250, "0.1 Hr rate"),
        P::int( 6, U2, "Dsg Relax Time",        0, 65535,  60, "s"),
        P::int( 8, U1, "Chg Relax Time",        0,   255,  60, "s"),
        P::int( 9, U1, "Quit Relax Time",       0,   255,   1, "s"),
        P::int(12, U2, "Max IR Correct",        0,  1000, 400, "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: 82, length: 41, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Qmax Cell 0",             0, 32767, 16384, "Num").safe(CAPACITY).learned(),
        P::int( 2, H1, "Update Status",        0x00,  0xFF,  0x00, "hex").safe(KEEP_STATE).learned(),
        P::int( 3, I2, "Reserve Cap-mAh",         0,  9000,     0, "mAh"),
        P::int( 5, H1, "Load Select/Mode",     0x00,  0xFF,  0x81, "hex").bits(LOAD_SELECT),
        P::int( 6, I2, "Q Invalid MaxV",          0, 32767,  3803, "mV"),
        P::int( 8, I2, "Q Invalid MinV",          0, 32767,  3752, "mV"),
        P::int(10, I2, "Design Capacity",         0,  8000,  1340, "mAh").safe(CAPACITY),
        P::int(12, I2, "Design Energy",           0, 32767,  4960, "mWh"),
        P::int(14, I2, "Default Design Cap",      0, 32767,  1340, "mAh"),
        P::int(16, I2, "Terminate Voltage",    2500,  3700,  3200, "mV").role(Role::VoltageMinDesign),
        P::int(22, I2, "T Rise",                  0, 32767,    20, "Num"),
        P::int(24, I2, "T Time Constant",         0, 32767,  1000, "s"),
        P::int(26, U1, "SOCI Delta",              0,   100,     1, "%"),
        P::int(27, I2, "Taper Rate",              0,  2000,   100, "0.1 Hr rate"),
        P::int(29, I2, "Taper Voltage",           0,  5000,  4100, "mV"),
        P::int(31, I2, "Sleep Current",           0,  1000,    10, "mA"),
        P::int(33, I2, "V at Chg Term",           0,  5000,  4190, "mV").learned().unproven(),
        P::int(35, I2, "Avg I Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned().unproven(),
        P::int(37, I2, "Avg P Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned().unproven(),
        P::int(39, I2, "Delta Voltage",           0,  1000,     1, "mV").learned().unproven(),
    ] },
    Subclass { class: "Ra Tables", name: "R_a RAM", id: 89, length: 30, kind: Reset,
               parameters: &[
        // The defaults depend on the flavour (G1A, G1B, G1D).
        P::int( 0, I2, "R_a0 0",  0, 32767, 0, "Num").no_default().learned(),
        P::int( 2, I2, "R_a0 1",  0, 32767, 0, "Num").no_default().learned(),
        P::int( 4, I2, "R_a0 2",  0, 32767, 0, "Num").no_default().learned(),
        P::int( 6, I2, "R_a0 3",  0, 32767, 0, "Num").no_default().learned(),
        P::int( 8, I2, "R_a0 4",  0, 32767, 0, "Num").no_default().learned(),
        P::int(10, I2, "R_a0 5",  0, 32767, 0, "Num").no_default().learned(),
        P::int(12, I2, "R_a0 6",  0, 32767, 0, "Num").no_default().learned(),
        P::int(14, I2, "R_a0 7",  0, 32767, 0, "Num").no_default().learned(),
        P::int(16, I2, "R_a0 8",  0, 32767, 0, "Num").no_default().learned(),
        P::int(18, I2, "R_a0 9",  0, 32767, 0, "Num").no_default().learned(),
        P::int(20, I2, "R_a0 10", 0, 32767, 0, "Num").no_default().learned(),
        P::int(22, I2, "R_a0 11", 0, 32767, 0, "Num").no_default().learned(),
        P::int(24, I2, "R_a0 12", 0, 32767, 0, "Num").no_default().learned(),
        P::int(26, I2, "R_a0 13", 0, 32767, 0, "Num").no_default().learned(),
        P::int(28, I2, "R_a0 14", 0, 32767, 0, "Num").no_default().learned(),
    ] },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 3, kind: Reset,
               parameters: &[
        P::int(0, I1, "Board Offset",    -128, 127, 0, "Counts").learned().unproven(),
        P::int(1, I1, "Int Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        P::int(2, I1, "Pack V Offset",   -128, 127, 0, "mV").unproven(),
    ] },
    Subclass { class: "Calibration", name: "CC Cal", id: 105, length: 12, kind: Reset,
               parameters: &[
        P::int(0, I2, "CC Offset",   -32768, 32767,    0, "Counts").learned().unproven(),
        P::int(2, I2, "CC Cal Temp",      0, 32767, 2982, "0.1K").learned().unproven(),
        P::float(4, "CC Gain",       0.1,        40.0,   0.672785, "Num").unproven(),
        P::float(8, "CC Delta", 30_000.0, 3_000_000.0, 799_341.14, "Num").unproven(),
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
