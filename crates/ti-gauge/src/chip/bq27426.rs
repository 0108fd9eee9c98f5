// SPDX-License-Identifier: MIT

//! BQ27426: the BQ27427 with a sense resistor outside, for one Li-ion cell; data memory is RAM.
//!
//! Its own reference, SLUUBB0, has not been read. Sources are images of TI's tools in a phone maker's sources
//! (github.com/MotorolaMobilityLLC/motorola-kernel-modules, drivers/power/bq27426_fg_mmi), the drivers of Linux
//! and NuttX (`bq27426`), a driver of a product (SMOORE, 2024), and the BQ27427's reference, SLUUCD5. NuttX
//! lists the BQ27427's commands, subcommands and flags, and so those tables here are the BQ27427's.
//!
//! In data memory a row is proven if the BQ27427's reference or traces have it and all images of this part
//! fit it, or if a driver of this part writes it there: Linux 82/6, 8 and 10; SMOORE's 64/0, 82/6, 82/21 and
//! 109/8. Proven as well is a row that both these images and the BQ27427's, which is another maker's, have
//! where it is expected: the bq27441-G1's default, a table of Ra values, or voltages that fit. A zero proves
//! nothing there. Defaults are the family's. The chemistry (83, 84, 85, 89, 108, 109) is what SMOORE's driver loads as
//! such; drivers of the bq27541 and the bq27520 call 83 and 84 OCV tables. Of 83, 84, 85 and 108 only the
//! length is known.

use super::Kind::{Reset, Security as Keys};
use super::bq27427::{ACCESS, CONTROL_STATUS, OP_CONFIG, OP_CONFIG_D, REGISTERS, SCALING, SUBCOMMANDS};
use super::bq27441_g1::{
    CAPACITY, CONDITION, ITPOR, KEEP_STATE, LOAD_SELECT, OP_CONFIG_B, SECURITY, preflight,
};
use super::{Chip, Evidence, Identity, Parameter as P, Role, Subclass};
use crate::codec::Layout;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The BQ27426 as far as it is known.
pub static CHIP: Chip = Chip {
    name: "bq27426",
    model: "BQ27426",
    documents: &["SLUUCD5 (January 2023), of the BQ27427"],
    evidence: &[Evidence::Sibling, Evidence::Drivers, Evidence::Image, Evidence::Kernel],
    // The firmware is what all images expect.
    identity: Identity {
        device_type: 0x0426,
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
    // The BQ27427's.
    scaling: SCALING,
    security: SECURITY,
    // The images wait as the BQ27427's do: 1.1 s to CONFIG UPDATE, 10 ms after a checksum, 2 s at the end.
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
    // OpConfigD [ChemID1], [ChemID0].
    preflight: preflight(&[(64, 4)]),
};

/// Data memory, in the BQ27427's order, and the chemistry that its table leaves out.
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
        // 15 images of three makers have other values than the default of both parts; its bits have no names.
        P::int(3, H1, "OpConfigC",   0x00,   0xFF,   0x9F, "flags").unprinted(),
        P::int(4, H1, "OpConfigD",   0x00,   0xFF,   0x23, "flags").bits(OP_CONFIG_D),
    ] },
    // A public image sets 14 bytes of it, and none sets more.
    Subclass { class: "Configuration", name: "Power", id: 68, length: 14, kind: Reset,
               parameters: &[
        // No driver knows a HIBERNATE of this part; both are probably unused.
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
        // The images have 11, the BQ27427's 8.
        P::within(59, U2, "Ra Max Delta",                  0, 32767, "4 mΩ"),
        P::int(68, I2, "Min Delta Voltage",                0, 32767,   0, "mV").unproven(),
        P::int(70, I2, "Max Delta Voltage",                0, 32767, 200, "mV"),
        P::int(72, I2, "DeltaV Max dV",                    0, 32767, 100, "mV"),
        P::int(74, U1, "TermV Valid t",                    0,   255,   2, "s"),
        // The BQ27427's: the images have its default here.
        P::int(81, U1, "Design Energy Scale",              1,    10,   1, "Num"),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        // Defaults that neither the images nor the bq27427's agree on.
        P::within( 0, I2, "Dsg Current Threshold", 0,  2000, "0.1 Hr rate"),
        P::int( 2, I2, "Chg Current Threshold", 0,  2000, 100, "0.1 Hr rate"),
        P::within( 4, I2, "Quit Current",          0,  2000, "0.1 Hr rate"),
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
        P::int(29, I2, "Delta Voltage",          0,  1000,     1, "mV").learned(),
    ] },
    Subclass { class: "Ra Tables", name: "Ra0 RAM", id: 89, length: 30, kind: Reset,
               parameters: &[
        // The defaults depend on the chemistry.
        P::within( 0, I2, "Ra 0",  0, 32767, "Num").learned(),
        P::within( 2, I2, "Ra 1",  0, 32767, "Num").learned(),
        P::within( 4, I2, "Ra 2",  0, 32767, "Num").learned(),
        P::within( 6, I2, "Ra 3",  0, 32767, "Num").learned(),
        P::within( 8, I2, "Ra 4",  0, 32767, "Num").learned(),
        P::within(10, I2, "Ra 5",  0, 32767, "Num").learned(),
        P::within(12, I2, "Ra 6",  0, 32767, "Num").learned(),
        P::within(14, I2, "Ra 7",  0, 32767, "Num").learned(),
        P::within(16, I2, "Ra 8",  0, 32767, "Num").learned(),
        P::within(18, I2, "Ra 9",  0, 32767, "Num").learned(),
        P::within(20, I2, "Ra 10", 0, 32767, "Num").learned(),
        P::within(22, I2, "Ra 11", 0, 32767, "Num").learned(),
        P::within(24, I2, "Ra 12", 0, 32767, "Num").learned(),
        P::within(26, I2, "Ra 13", 0, 32767, "Num").learned(),
        P::within(28, I2, "Ra 14", 0, 32767, "Num").learned(),
    ] },
    Subclass::opaque("Chemistry", "OCV Table 83", 83, 43),
    Subclass::opaque("Chemistry", "OCV Table 84", 84, 42),
    Subclass::opaque("Chemistry", "Chemistry 85", 85, 17),
    Subclass::opaque("Chemistry", "Chemistry 108", 108, 17),
    Subclass { class: "Gas Gauging", name: "Chem Data", id: 109, length: 10, kind: Reset,
               parameters: &[
        P::within(2, I2, "Q Invalid MaxV", 0, 32767, "mV"),
        P::within(4, I2, "Q Invalid MinV", 0, 32767, "mV"),
        P::within(6, I2, "V at Chg Term",  0,  5000, "mV").learned(),
        // A driver of this part writes it here (SMOORE's, 2024).
        P::within(8, I2, "Taper Voltage",  0,  5000, "mV"),
    ] },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 58, kind: Reset,
               parameters: &[
        // The other bytes, up to the end of the second block, have no names.
        P::int(0, I1, "Board Offset",    -128, 127, 0, "Counts").learned().unproven(),
        P::int(1, I1, "Int Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        P::int(2, I1, "Pack V Offset",   -128, 127, 0, "mV").unproven(),
    ] },
    Subclass { class: "Calibration", name: "CC Cal", id: 105, length: 12, kind: Reset,
               parameters: &[
        P::int(0, I2, "CC Offset",   -32768, 32767,    0, "Counts").learned(),
        P::int(2, I2, "CC Cal Temp",      0, 32767, 2982, "0.1K").learned(),
        // Depends on the sense resistor. No source reports a wrong sign, as the BQ27427 has it in ROM.
        P::float(4, "CC Gain",       0.1,        40.0,   0.672785, "Num").no_default(),
        // In 20 images it is CC Gain times 1193046.5, the ratio of TI's formulae, or half of that.
        P::float(8, "CC Delta", 30_000.0, 3_000_000.0, 799_341.14, "Num").no_default(),
    ] },
    // The images that set it set 19 bytes.
    Subclass { class: "Calibration", name: "Current", id: 107, length: 19, kind: Reset,
               parameters: &[
        // The default in five images, among the bytes that the bq34z100-G1 has at the places of its class 107.
        P::int(1, U1, "Deadband", 0, 255, 5, "mA"),
    ] },
    Subclass { class: "Security", name: "Codes", id: 112, length: 4, kind: Keys,
               parameters: &[
        // No default: nothing that shows defaults may show a key.
        P::any(0, H4, "Sealed to Unsealed", "hex"),
    ] },
];
