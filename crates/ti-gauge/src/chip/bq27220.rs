// SPDX-License-Identifier: MIT

//! BQ27220: CEDV gauge for one Li-ion cell; data memory is RAM, filled from one-time programmable memory when
//! power comes.
//!
//! Section and table numbers are those of the technical reference, SLUUBD4A, which could be read in parts only:
//! the standard commands, the beginning of the table of subcommands and of the summary of data memory (up to
//! 0x91CA), the bits of CONTROL_STATUS, GaugingStatus and Operation Config B, and the example in 6.1. The rest is
//! from drivers that were written with the whole of it or on parts: Flipper Zero's, LilyGO's for its T-Embed and
//! SensorLib, Espressif's component, a pager's firmware that cites the summary row by row, and a configuration
//! tool of the CardputerZero. An owner printed the 32 bytes at 0x929F of a part as it was shipped (E2E forum,
//! "BQ27220: Design Capacity").
//!
//! TI's image for this part (a `.gm.fs` for firmware 0.03 in an STM32 driver, all sums right) writes 0x91F5 to 0x9299
//! in 23 blocks; a fifth driver (os.mbed.com, loopsva, revision 3 of 2017) names places and sizes of many of them.
//! The 24 bytes from 0x9282 on are named in TI's other CEDV gauges (those of the bq40z50 have these names in drivers):
//! voltage, voltage, %, % for each of four flags; in that order the image has values that fit, and the percentages are
//! TI's defaults.
//!
//! A row can be written if the manual prints it, or if two sources give its address and type; the others are
//! unproven. No source prints a range but the manual, for the rows that have one here. Drivers disagree on one address: EMF is at 0x92A7, where the printed bytes have its default;
//! Flipper's and LilyGO's 0x92A3 is Design Voltage. A value at 0x92A1 without a name, the coefficients from 0x91CC
//! on, and the profiles 2 to 6 are left out. The same parameters have a second address from 0x4000 on, that of
//! one-time programmable memory: nothing is ever sent there.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::Reset;
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, FLAT, Identity, KeyStorage, Mode, Parameter as P, Preflight,
    Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Signature, Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The BQ27220 as its manual and its drivers know it.
pub static CHIP: Chip = Chip {
    name: "bq27220",
    model: "BQ27220",
    documents: &["SLUUBD4A (November 2022)", "SLUSCB7A (April 2016)"],
    evidence: &[Evidence::Manual, Evidence::Drivers, Evidence::Image],
    // Every driver asks for this type. TI's image is for firmware 0x0003; no source says that there is no other, or gives
    // a hardware version.
    identity: Identity {
        device_type: 0x0220,
        firmware: &[],
        build: None,
        hardware: None,
        dm_codes: &[],
        answer: 0x40,
    },
    firmware_file: None,
    technology: "Li-ion",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0..0,
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: CONTROL_STATUS,
    // There is no threshold above the one at which the system should shut down, and no flag for cold.
    condition: Condition {
        full: 0x0200, // [FC]
        low: 0,
        critical: 0x8006, // [FD], [TDA], [SYSDWN]
        overheat: 0x0C00, // [OTC], [OTD]
        cold: 0,
        over_voltage: 0,
        under_voltage: 0,
        present: 0x0008, // [BATTPRES]
        absent: 0,
        uncertain: 0,
        certain: 0,
        empty: 0,
        complete: Some((Source::Command(0x3A), 0x0020)), // [INITCOMP]
        primary: None,
    },
    scaling: Scaling::NONE,
    security: Security {
        // 4.2: OperationStatus() [SEC1], [SEC0].
        status: SealStatus::Field { word: Source::Command(0x3A), shift: 1 },
        // 6.1, and most drivers. The text of 4.2 has 8000 8000, which is another family's; no part has been seen
        // that accepts it.
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0030,
        // TI's advice to owners of sibling gauges whose keys were refused.
        shows: Security::SHOWS,
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
        shown_sealed: &[],
        storage: KeyStorage::Fixed("its keys are in ROM"),
    },
    asks: None,
    access: Access {
        scheme: Scheme::MacUpdate,
        // Flipper's driver read wrong bytes after 0.5 ms and waits 1 ms; the others wait 10 ms.
        select: Duration::from_millis(10),
        // Flipper's driver wrote off 0.5 ms, and ships with 1 ms.
        soonest: Duration::from_millis(1),
        // All of them wait 10 ms before they read back.
        commit: Duration::from_millis(10),
        // 6.1: up to 1 s. Flipper's driver asks for [CFGUPDATE] at once, and then each millisecond; one for the T-Deck Pro every
        // 20 ms; another one after 1.2 s. Espressif's means to, but the condition of its loop ends it before the first look.
        enter: Duration::ZERO,
        enter_limit: Duration::from_millis(2500),
        // Flipper's driver: before that, data memory reads as nonsense. DesignCapacity(), by which they see that the profile is
        // there, is asked for by the one for the T-Deck Pro after 0.2 s, by Espressif's after 2 s: its loop goes on while
        // [CFGUPDATE] is clear.
        reset: Duration::from_secs(2),
        reset_limit: Duration::from_secs(4),
        resets: Access::RESET,
        advances: false,
    },
    gate: None,
    authentication: None,
    subclasses: SUBCLASSES,
    // SLUSCB7A 6.11.
    byte_writes_above_hz: Some(100_000),
    // One address lower, the high byte of each would be the low byte of the row before: a value out of range.
    calibration: None,
    signature: &[
        Signature::new(FLAT, 0x91FD, I2, 0, 4600),
        Signature::new(FLAT, 0x9201, I2, 0, 1000),
        Signature::new(FLAT, 0x922C, I2, 0, 1000),
    ],
    // No bit of BatteryStatus(), OperationStatus() or CONTROL_STATUS shows it: drivers compare data memory with what
    // they want there.
    volatile: Some(0),
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        // It has neither a serial number nor a chemistry that could be asked for.
        pack: None,
        marks: &[(FLAT, 0x91B5), (FLAT, 0x91B6), (FLAT, 0x91B7)],
        modes: &[
            Mode {
                word: Source::Command(0x3A),
                mask: 0x0400,
                name: "OperationStatus() [CFGUPDATE]",
                what: "somebody has left CONFIG UPDATE on, and the gauge does not gauge",
                remedy: "leave it with the tool that entered it (EXIT_CFG_UPDATE, 0x0092)",
                ours: true,
                slip: None,
            },
            Mode::calibration(
                Source::Command(0x3A),
                0x0001,
                "OperationStatus() [CALMD]",
                "leave it with the tool that entered it (CAL_TOGGLE, 0x002d)",
            ),
            Mode::measuring(0x0020, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
            Mode::measuring(0x0010, "CONTROL_STATUS [BCA]", "the board is being calibrated"),
        ],
        // CEDV: no cycle that the end of CONFIG UPDATE would lose but the discharge in progress.
        learning: None,
        // SLUSCB7A 6.7: what its regulator works with.
        voltage_mv: Some((2450, 4500)),
    },
};

/// Table 3-1. The poll reads 0x06 to 0x19 and 0x22 to 0x2F whole. The raw readings from 0x79 on are in drivers only;
/// the datasheet has no address above 0x6B acknowledged, so they are left out.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, I2, "AtRate", "mA", Slow),
    Register::new(0x04, U2, "AtRateTimeToEmpty", "min", Slow),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "BatteryStatus", "", Poll).role(Role::Flags).bits(BATTERY_STATUS),
    Register::new(0x0C, I2, "Current", "mA", Poll).role(Role::CurrentNow),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x18, U2, "TimeToFull", "min", Poll).role(Role::TimeToFullNow),
    Register::new(0x1A, I2, "StandbyCurrent", "mA", Slow),
    Register::new(0x1C, U2, "StandbyTimeToEmpty", "min", Slow),
    Register::new(0x1E, I2, "MaxLoadCurrent", "mA", Slow),
    Register::new(0x20, U2, "MaxLoadTimeToEmpty", "min", Slow),
    // 2.17: what was taken out since the last full charge.
    Register::new(0x22, U2, "RawCoulombCount", "mAh", Poll).role(Role::ChargeCounter).step(-1, 1),
    Register::new(0x24, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x28, U2, "InternalTemperature", "0.1K", Poll),
    Register::new(0x2A, U2, "CycleCount", "num", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "RelativeStateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U2, "StateOfHealth", "%", Poll).role(Role::StateOfHealth),
    Register::new(0x30, U2, "ChargeVoltage", "mV", Slow).role(Role::ChargeVoltage),
    Register::new(0x32, U2, "ChargeCurrent", "mA", Slow).role(Role::ChargeCurrent),
    Register::new(0x34, U2, "BTPDischargeSet", "mAh", Slow),
    Register::new(0x36, U2, "BTPChargeSet", "mAh", Slow),
    Register::new(0x3A, U2, "OperationStatus", "", Poll).bits(OPERATION_STATUS),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U2, "ManufacturerAccessControl", "", Window),
    Register::new(0x40, U(32), "MACData", "", Window),
    Register::new(0x60, U1, "MACDataSum", "", Window),
    Register::new(0x61, U1, "MACDataLen", "", Window),
];

/// Table 3-2. It has the first six as accepted while SEALED, and a driver that cites it the two status words; where
/// nobody says so, a sealed gauge is held not to accept one. Addresses of data memory are sent the same way and have
/// no row.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_NUMBER", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    // With any current flowing it spoils the calibration that it replaces.
    Subcommand::new(0x0009, "BOARD_OFFSET", Guarded),
    Subcommand::new(0x000A, "CC_OFFSET", Allowed),
    Subcommand::new(0x000B, "CC_OFFSET_SAVE", Guarded),
    Subcommand::new(0x000C, "OCV_CMD", Allowed),
    Subcommand::new(0x000D, "BAT_INSERT", Allowed).unsealed(),
    Subcommand::new(0x000E, "BAT_REMOVE", Allowed).unsealed(),
    Subcommand::new(0x0013, "SET_SNOOZE", Allowed).unsealed(),
    Subcommand::new(0x0014, "CLEAR_SNOOZE", Allowed).unsealed(),
    // Another profile is another configuration: the addresses of this table are those of profile 1.
    Subcommand::new(0x0015, "SET_PROFILE_1", Guarded).unsealed(),
    Subcommand::new(0x0016, "SET_PROFILE_2", Guarded).unsealed(),
    Subcommand::new(0x0017, "SET_PROFILE_3", Guarded).unsealed(),
    Subcommand::new(0x0018, "SET_PROFILE_4", Guarded).unsealed(),
    Subcommand::new(0x0019, "SET_PROFILE_5", Guarded).unsealed(),
    Subcommand::new(0x001A, "SET_PROFILE_6", Guarded).unsealed(),
    Subcommand::new(0x002D, "CAL_TOGGLE", Guarded).unsealed(),
    Subcommand::new(0x0030, "SEALED", Guarded).unsealed(),
    // Data memory is filled from one-time programmable memory again.
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0054, "OPERATION_STATUS", Answers),
    Subcommand::new(0x0056, "GAUGING_STATUS", Answers),
    Subcommand::new(0x0080, "EXIT_CAL", Guarded).unsealed(),
    Subcommand::new(0x0081, "ENTER_CAL", Guarded).unsealed(),
    Subcommand::new(0x0090, "ENTER_CFG_UPDATE", Guarded).unsealed(),
    Subcommand::new(0x0091, "EXIT_CFG_UPDATE_REINIT", Guarded).unsealed(),
    Subcommand::new(0x0092, "EXIT_CFG_UPDATE", Guarded).unsealed(),
    // The gauge no longer answers at 0x55, and its owners did not get it back (E2E 689362).
    Subcommand::new(0x0F00, "ENTER_ROM", Never).unsealed(),
];

/// Table 3-3.
static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x0020, "CCA"),
    Bit::new(0x0010, "BCA"),
    Bit::new(0x0008, "SNOOZE"),
    Bit::new(0x0004, "BATT_ID2"),
    Bit::new(0x0002, "BATT_ID1"),
    Bit::new(0x0001, "BATT_ID0"),
];

/// As Flipper's, Espressif's and SensorLib's drivers have it.
static BATTERY_STATUS: &[Bit] = &[
    Bit::new(0x8000, "FD"),
    Bit::new(0x4000, "OCVCOMP"),
    Bit::new(0x2000, "OCVFAIL"),
    Bit::new(0x1000, "SLEEP"),
    Bit::new(0x0800, "OTC"),
    Bit::new(0x0400, "OTD"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHGINH"),
    Bit::new(0x0040, "TCA"),
    Bit::new(0x0020, "OCVGD"),
    Bit::new(0x0010, "AUTH_GD"),
    Bit::new(0x0008, "BATTPRES"),
    Bit::new(0x0004, "TDA"),
    Bit::new(0x0002, "SYSDWN"),
    Bit::new(0x0001, "DSG"),
];

/// As Flipper's, Espressif's and SensorLib's drivers have it; 6.1 has the place of `[CFGUPDATE]`.
static OPERATION_STATUS: &[Bit] = &[
    Bit::new(0x0400, "CFGUPDATE"),
    Bit::new(0x0080, "BTPINT"),
    Bit::new(0x0040, "SMTH"),
    Bit::new(0x0020, "INITCOMP"),
    Bit::new(0x0010, "VDQ"),
    Bit::new(0x0008, "EDV2"),
    Bit::new(0x0004, "SEC1"),
    Bit::new(0x0002, "SEC0"),
    Bit::new(0x0001, "CALMD"),
];

/// SensorLib; the CardputerZero's values for boards with and without a thermistor agree.
static OPERATION_CONFIG_A: &[Bit] = &[
    Bit::new(0x8000, "TEMPS"),
    Bit::new(0x2000, "BATG_POL"),
    Bit::new(0x1000, "BATG_EN"),
    Bit::new(0x0400, "SLEEP"),
    Bit::new(0x0200, "SLPWAKECHG"),
    Bit::new(0x0100, "WRTEMP"),
    Bit::new(0x0080, "BIEnable"),
    Bit::new(0x0020, "BL_PUP_EN"),
    Bit::new(0x0010, "PFC_CFG1"),
    Bit::new(0x0008, "PFC_CFG0"),
    Bit::new(0x0004, "WAKE_EN"),
    Bit::new(0x0002, "WK_TH1"),
    Bit::new(0x0001, "WK_TH0"),
];

/// The manual's own table.
static OPERATION_CONFIG_B: &[Bit] = &[
    Bit::new(0x0800, "Default Seal"),
    Bit::new(0x0400, "NR"),
    Bit::new(0x0080, "INT_BREM"),
    Bit::new(0x0040, "INT_BATL"),
    Bit::new(0x0020, "INT_STATE"),
    Bit::new(0x0010, "INT_OCV"),
    Bit::new(0x0004, "INT_OT"),
    Bit::new(0x0002, "INT_POL"),
    Bit::new(0x0001, "INT_FOCV"),
];

/// The names that the pager's firmware cites, in the layout of TI's other CEDV gauges; the default fits.
static SOC_FLAG_CONFIG_A: &[Bit] = &[
    Bit::new(0x0800, "TCSETVCT"),
    Bit::new(0x0400, "FCSETVCT"),
    Bit::new(0x0080, "TCCLEARRSOC"),
    Bit::new(0x0040, "TCSETRSOC"),
    Bit::new(0x0020, "TCCLEARV"),
    Bit::new(0x0010, "TCSETV"),
    Bit::new(0x0008, "TDCLEARRSOC"),
    Bit::new(0x0004, "TDSETRSOC"),
    Bit::new(0x0002, "TDCLEARV"),
    Bit::new(0x0001, "TDSETV"),
];

/// As Flipper's and Espressif's drivers have it.
static GAUGING_CONFIGURATION: &[Bit] = &[
    Bit::new(0x1000, "SME0"),
    Bit::new(0x0800, "IGNORE_SD"),
    Bit::new(0x0400, "FC_FOR_VDQ"),
    Bit::new(0x0100, "FCC_LIM"),
    Bit::new(0x0020, "FIXED_EDV0"),
    Bit::new(0x0010, "SC"),
    Bit::new(0x0008, "EDV_CMP"),
    Bit::new(0x0002, "CSYNC"),
    Bit::new(0x0001, "CCT"),
];

/// No other value is known of any part.
const OWN_TYPE: Safe = Safe::Keep(0xFFFF, "it is the part's own number");
/// StateOfHealth() is a fraction of it.
const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// By address. Every row needs the end of CONFIG UPDATE, which makes the gauge start anew.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Calibration", name: "Data", id: FLAT, length: 2, kind: Reset,
               parameters: &[
        P::any(0x9180, I2, "CC Offset", "Counts").learned().unproven(),
    ] },
    Subclass { class: "Calibration", name: "Offset", id: FLAT, length: 4, kind: Reset,
               parameters: &[
        P::int(0x91B4, I1, "Board Offset",    -128, 127, 0, "Counts").learned(),
        P::int(0x91B5, I1, "Int Temp Offset", -128, 127, 0, "0.1°C"),
        P::int(0x91B6, I1, "Ext Temp Offset", -128, 127, 0, "0.1°C"),
        P::int(0x91B7, I1, "Pack V Offset",   -128, 127, 0, "mV"),
    ] },
    Subclass { class: "Calibration", name: "Temperature", id: FLAT, length: 20, kind: Reset,
               parameters: &[
        P::int(0x91B8, I2, "Internal Model Coefficient 1",   -32768, 32767,      0, "Num"),
        P::int(0x91BA, I2, "Internal Model Coefficient 2",   -32768, 32767,      0, "Num"),
        P::int(0x91BC, I2, "Internal Model Coefficient 3",   -32768, 32767, -13356, "Num"),
        P::int(0x91BE, I2, "Internal Model Coefficient 4",   -32768, 32767,   6661, "Num"),
        P::int(0x91C0, I2, "External Model Coefficient 1",   -32768, 32767, -11130, "Num"),
        P::int(0x91C2, I2, "External Model Coefficient 2",   -32768, 32767,  19142, "Num"),
        P::int(0x91C4, I2, "External Model Coefficient 3",   -32768, 32767, -19262, "Num"),
        P::int(0x91C6, I2, "External Model Coefficient 4",   -32768, 32767,  28203, "Num"),
        P::int(0x91C8, I2, "External Model Coefficient 5",   -32768, 32767,    892, "Num"),
        P::int(0x91CA, I2, "External Model Coefficient b 1", -32768, 32767,    328, "Num"),
    ] },
    Subclass { class: "Calibration", name: "Current", id: FLAT, length: 3, kind: Reset,
               parameters: &[
        P::any(0x91DD, U1, "Filter",      "Num").unproven(),
        P::any(0x91DE, U1, "Deadband",    "mA"),
        P::any(0x91DF, U1, "CC Deadband", "294nV").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Charge Inhibit", id: FLAT, length: 6, kind: Reset,
               parameters: &[
        P::any(0x91F5, I2, "Chg Inhibit Temp Low",  "0.1°C"),
        P::any(0x91F7, I2, "Chg Inhibit Temp High", "0.1°C"),
        P::any(0x91F9, I2, "Temp Hys",              "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Charge", id: FLAT, length: 8, kind: Reset,
               parameters: &[
        P::int(0x91FB, I2, "Charging Current", 0, 1000,  200, "mA"),
        P::int(0x91FD, I2, "Charging Voltage", 0, 4600, 4200, "mV").role(Role::VoltageMaxDesign),
        P::int(0x9201, I2, "Taper Current",    0, 1000,  100, "mA"),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: FLAT, length: 14, kind: Reset,
               parameters: &[
        P::within(0x9206, H2, "Operation Config A", 0x0000, 0xFFFF, "hex").bits(OPERATION_CONFIG_A),
        P::int(0x9208, H2, "Operation Config B", 0x0000, 0xFFFF, 0x1000, "hex").bits(OPERATION_CONFIG_B),
        P::any(0x920B, U1, "SOC Delta",          "%"),
        P::any(0x920C, H1, "Clk Ctl Reg",        "hex"),
        P::any(0x920D, H1, "IO Config",          "hex"),
        // Here the bq27z561 has defaults of 150 mAh and 175 mAh for these names, and the image has the same.
        P::any(0x920E, I2, "Init Discharge Set", "mAh"),
        P::any(0x9210, I2, "Init Charge Set",    "mAh"),
        P::int(0x9212, H2, "Device Type", 0x0000, 0xFFFF, 0x0220, "hex").safe(OWN_TYPE),
    ] },
    Subclass { class: "Configuration", name: "Power", id: FLAT, length: 11, kind: Reset,
               parameters: &[
        P::any(0x9217, I2, "Sleep Current",                "mA"),
        P::any(0x9219, U1, "Bus Low Time",                 "s"),
        P::any(0x921A, I2, "Offset Cal Inhibit Temp Low",  "0.1°C"),
        P::any(0x921C, I2, "Offset Cal Inhibit Temp High", "0.1°C"),
        P::any(0x921E, U1, "Sleep Voltage Time",           "s"),
        P::any(0x921F, U1, "Sleep Current Time",           "s"),
        // The manual advises 0: the part has no such mode.
        P::any(0x9221, U1, "Hibernate I",                  "mA"),
    ] },
    Subclass { class: "Configuration", name: "Current Thresholds", id: FLAT, length: 10, kind: Reset,
               parameters: &[
        P::any(0x9228, I2, "Dsg Current Threshold",   "mA"),
        P::int(0x922A, I2, "Chg Current Threshold",   0, 2000, 75, "mA"),
        P::int(0x922C, I2, "Quit Current",            0, 1000, 40, "mA"),
        P::any(0x922E, U2, "Dsg Relax Time",          "s"),
        P::int(0x9230, U1, "Chg Relax Time",          0, 255,  60, "s"),
        P::any(0x9231, U1, "Quit Relax Time",         "s"),
    ] },
    Subclass { class: "Configuration", name: "Safety", id: FLAT, length: 10, kind: Reset,
               parameters: &[
        P::any(0x9232, I2, "OT Chg",          "0.1°C"),
        P::any(0x9234, U1, "OT Chg Time",     "s"),
        P::any(0x9235, I2, "OT Chg Recovery", "0.1°C"),
        P::any(0x9237, I2, "OT Dsg",          "0.1°C"),
        P::any(0x9239, U1, "OT Dsg Time",     "s"),
        P::any(0x923A, I2, "OT Dsg Recovery", "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Data", id: FLAT, length: 1, kind: Reset,
               parameters: &[
        P::any(0x923C, I1, "Initial Standby", "mA"),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: FLAT, length: 5, kind: Reset,
               parameters: &[
        P::any(0x9240, I2, "SysDown Set Volt Threshold",   "mV"),
        P::any(0x9242, U1, "SysDown Set Volt Time",        "s"),
        P::any(0x9243, I2, "SysDown Clear Volt Threshold", "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "CEDV Configuration", id: FLAT, length: 32, kind: Reset,
               parameters: &[
        P::any(0x9251, U2, "Battery Low %",        "0.01%"),
        P::any(0x925B, U1, "Learning Low Temp",    "0.1°C"),
        P::any(0x9264, I2, "Overload Current",     "mA"),
        P::any(0x9268, U1, "Self Discharge Rate",  "0.0025%/day"),
        P::any(0x9269, I2, "Electronics Load",     "3uA"),
        P::any(0x926B, I2, "Near Full",            "mAh"),
        P::any(0x926D, I2, "Reserve Capacity",     "mAh"),
        P::any(0x926F, U1, "Chg Eff",              "%"),
        P::any(0x9270, U1, "Dsg Eff",              "%"),
    ] },
    Subclass { class: "Gas Gauging", name: "CEDV Smoothing Config", id: FLAT, length: 12, kind: Reset,
               parameters: &[
        P::any(0x9271, H1, "Smoothing Config",        "hex"),
        P::any(0x9272, I2, "Smoothing Start Voltage", "mV"),
        P::any(0x9274, I2, "Smoothing Delta Voltage", "mV"),
        P::any(0x9276, I2, "Max Smoothing Current",   "mA"),
        P::any(0x927B, U1, "EOC Smooth Current",      "0.1%"),
        P::any(0x927C, U1, "EOC Smooth Current Time", "s"),
    ] },
    Subclass { class: "Gas Gauging", name: "SOC Flags", id: FLAT, length: 29, kind: Reset,
               parameters: &[
        P::any(0x927D, U1, "Cycle Count %",     "%"),
        P::int(0x927F, H2, "SOC Flag Config A", 0x0000, 0x0FFF, 0x0C8C, "hex").bits(SOC_FLAG_CONFIG_A),
        P::any(0x9281, H1, "SOC Flag Config B", "hex"),
        P::any(0x9282, I2, "FD Set Voltage Threshold",   "mV"),
        P::any(0x9284, I2, "FD Clear Voltage Threshold", "mV"),
        P::any(0x9286, U1, "FD Set % RSOC Threshold",    "%"),
        P::any(0x9287, U1, "FD Clear % RSOC Threshold",  "%"),
        P::any(0x9288, I2, "FC Set Voltage Threshold",   "mV"),
        P::any(0x928A, I2, "FC Clear Voltage Threshold", "mV"),
        P::any(0x928C, U1, "FC Set % RSOC Threshold",    "%"),
        P::any(0x928D, U1, "FC Clear % RSOC Threshold",  "%"),
        P::any(0x928E, I2, "TD Set Voltage Threshold",   "mV"),
        P::any(0x9290, I2, "TD Clear Voltage Threshold", "mV"),
        P::any(0x9292, U1, "TD Set % RSOC Threshold",    "%"),
        P::any(0x9293, U1, "TD Clear % RSOC Threshold",  "%"),
        P::any(0x9294, I2, "TC Set Voltage Threshold",   "mV"),
        P::any(0x9296, I2, "TC Clear Voltage Threshold", "mV"),
        P::any(0x9298, U1, "TC Set % RSOC Threshold",    "%"),
        P::any(0x9299, U1, "TC Clear % RSOC Threshold",  "%"),
    ] },
    Subclass { class: "Gas Gauging", name: "Battery ID", id: FLAT, length: 1, kind: Reset,
               parameters: &[
        P::any(0x929A, H1, "Battery ID", "hex"),
    ] },
    // Defaults are those in the bytes of a part that was read as it was shipped.
    Subclass { class: "Gas Gauging", name: "CEDV Profile 1", id: FLAT, length: 56, kind: Reset,
               parameters: &[
        // The manual prints two defaults, 0x102A and 0.
        P::within(0x929B, H2, "Gauging Configuration", 0x0000, 0xFFFF, "hex").bits(GAUGING_CONFIGURATION),
        P::within(0x929D, I2, "Full Charge Capacity",       0, 32767,       "mAh").learned(),
        P::int(0x929F, I2, "Design Capacity",            0, 32767, 3000, "mAh").safe(CAPACITY),
        P::int(0x92A3, I2, "Design Voltage",             0, 32767, 3700, "mV"),
        P::int(0x92A5, I2, "Charge Termination Voltage", 0,  1000,  100, "mV"),
        P::int(0x92A7, U2, "EMF",                        0, 65535, 3743, "Num"),
        P::int(0x92A9, U2, "C0",                         0, 65535,  149, "Num"),
        P::int(0x92AB, U2, "R0",                         0, 65535,  867, "Num"),
        P::int(0x92AD, U2, "T0",                         0, 65535, 4030, "Num"),
        P::int(0x92AF, U2, "R1",                         0, 65535,  316, "Num"),
        P::int(0x92B1, U1, "TC",                         0,   255,    9, "Num"),
        P::int(0x92B2, U1, "C1",                         0,   255,    0, "Num"),
        P::any(0x92B3, U1, "Age Factor",                 "Num"),
        P::int(0x92B4, I2, "Fixed EDV 0",                0, 32767, 3031, "mV"),
        P::int(0x92B6, U1, "EDV 0 Hold Time",            0,   255,    1, "s"),
        P::int(0x92B7, I2, "Fixed EDV 1",                0, 32767, 3385, "mV"),
        P::int(0x92B9, U1, "EDV 1 Hold Time",            0,   255,    1, "s"),
        P::int(0x92BA, I2, "Fixed EDV 2",                0, 32767, 3501, "mV"),
        P::int(0x92BC, U1, "EDV 2 Hold Time",            0,   255,    1, "s"),
        P::int(0x92BD, I2, "Voltage 0% DOD",             0, 32767, 4173, "mV"),
        P::within(0x92BF, I2, "Voltage 10% DOD",            0, 32767,       "mV"),
        P::within(0x92C1, I2, "Voltage 20% DOD",            0, 32767,       "mV"),
        P::within(0x92C3, I2, "Voltage 30% DOD",            0, 32767,       "mV"),
        P::within(0x92C5, I2, "Voltage 40% DOD",            0, 32767,       "mV"),
        P::within(0x92C7, I2, "Voltage 50% DOD",            0, 32767,       "mV"),
        P::within(0x92C9, I2, "Voltage 60% DOD",            0, 32767,       "mV"),
        P::within(0x92CB, I2, "Voltage 70% DOD",            0, 32767,       "mV"),
        P::within(0x92CD, I2, "Voltage 80% DOD",            0, 32767,       "mV"),
        P::within(0x92CF, I2, "Voltage 90% DOD",            0, 32767,       "mV"),
        P::within(0x92D1, I2, "Voltage 100% DOD",           0, 32767,       "mV"),
    ] },
];
