// SPDX-License-Identifier: MIT

//! bq35100: gauge for primary lithium cells, which counts their charge, or tells their state of health
//! (Li-MnO2) or end of service (Li-SOCl2).
//!
//! Table and section numbers are those of SLUUBH1C. Its summary of data flash was not at hand: addresses
//! are those of arithmetics.io's Zephyr driver, which lists them all; most of what other drivers
//! (pilotak/BQ35100, MikroE's, CoreKinect's for Zephyr) and SLUA790 use agrees. Ranges and defaults are
//! SLUUBH1C's chapters 7 and 8 and SLUAAL7's tables.
//!
//! A row that a TI document or two drivers have, or one driver with its range, can be written; where no
//! range is printed it is the type's. A row of one driver without a range, or placed by its neighbours,
//! is unproven. Names of classes without one in TI's documents follow the bq34z100-G1. Two bytes at
//! 0x41DE that nobody names are left out.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Plain, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, External, FLAT, Gate, Identity, KeyBlock, KeyOrder, KeyStorage,
    Mode, Pack, Parameter as P, Preflight, Primary, Register, Role, Safe, Scaling, Scheme, SealStatus,
    Security, Signature, Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, I4, U1, U2, U4};
use gauge_bus::GAUGE_ADDRESS;

/// The bq35100 as TI's documents and its drivers describe it.
pub static CHIP: Chip = Chip {
    name: "bq35100",
    model: "bq35100",
    documents: &["SLUUBH1C (March 2018)", "SLUSCM6E (April 2019)", "SLUA790", "SLUAAL7"],
    // SLUA790's and 12.1's worked transfers, and those of owners; none of it from our own hardware.
    evidence: &[Evidence::Manual, Evidence::Drivers, Evidence::Transcript],
    // Table 11-2; SLUSCM6E prints 0x40 for the type. pilotak/BQ35100 knows a part by the hardware version,
    // and only that tells it from a bq34z100-G1. Nobody tells a firmware version.
    identity: Identity {
        device_type: 0x0100,
        firmware: &[],
        build: None,
        hardware: Some(0x00A8),
        dm_codes: &[],
        answer: 0x40,
    },
    firmware_file: None,
    // Li-MnO2 and Li-SOCl2 are primary cells, for which the kernel has no name.
    technology: "Unknown",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0x4000..0x4400, // SLUUBH1C 12.1.3
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: CONTROL_STATUS,
    // Masks of BatteryAlert(), which shows only what ALERT Configuration lets through: as delivered, nothing.
    condition: Condition {
        full: 0,
        low: 0x90,      // [BATLOW], [SOH_LOW]
        critical: 0x08, // [EOS]
        overheat: 0x20, // [TEMPHIGH]
        cold: 0x40,     // [TEMPLOW]
        over_voltage: 0,
        under_voltage: 0x80, // [BATLOW]
        present: 0,
        absent: 0,
        uncertain: 0,
        certain: 0,
        empty: 0,
        complete: Some((Source::Status, 0x0080)), // [INITCOMP]
        primary: Some(Primary {
            active: 0x0001,         // [GA]
            alerts: (FLAT, 0x41B2), // ALERT Configuration
            mode: (FLAT, 0x41B1),   // Operation Config A [GMSEL1], [GMSEL0]
            mode_mask: 0x03,
            health_modes: &[0b01, 0b10],
            resistance_modes: &[0b10],
        }),
    },
    scaling: Scaling::NONE,
    security: Security {
        status: SealStatus::Field { word: Source::Status, shift: 13 },
        // Owners send them so; stored in this order at 0x41CC.
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0020,
        // E2E 888302: a full-access key right after the unseal key was refused, 10 s later it was taken.
        shows: Security::SHOWS,
        key_silence: Duration::from_secs(11),
        seals_itself: None,
        shown_sealed: &[],
        // An owner read 04 14 36 72 from a part (E2E 668766), though one address lower; what a part holds is
        // compared with its keys before it is changed. Its authentication key cannot be tried.
        storage: KeyStorage::Flash(KeyBlock {
            subclass: FLAT,
            start: 0x41CC,
            length: 8,
            unseal: 0,
            full_access: 4,
            authentication: None,
            order: KeyOrder::AsSent,
        }),
    },
    asks: None,
    access: Access {
        scheme: Scheme::Mac,
        // No document gives it; pilotak/BQ35100 waits 2 ms. The echo and the sum tell what was read too early.
        select: Duration::from_millis(5),
        soonest: Duration::ZERO,
        // Not given either; pilotak/BQ35100 waits 100 ms, CoreKinect's driver 10 ms.
        commit: Duration::from_millis(100),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        // After power-up drivers wait 100 and 110 ms, one having seen the clock held for 103.5 ms; the limit
        // is ours.
        reset: Duration::from_millis(250),
        reset_limit: Duration::from_secs(2),
        resets: Access::RESET,
        advances: false,
    },
    // The rule is that of the siblings; no scale between Voltage() and the limit is known.
    gate: Some(Gate {
        limit: (FLAT, 0x41B6),
        divider: None,
        cell_divider: None,
        external: Some(External { byte: (FLAT, 0x41B1), mask: 0x40, name: "[EXTVCELL]", factor: None }),
        cells: None,
        calibration: None,
    }),
    // It has AuthenticateData() at 0x40, but how it is selected is in no source at hand.
    authentication: None,
    subclasses: SUBCLASSES,
    byte_writes_above_hz: None,
    // An owner's part had its keys, at least, one address lower (E2E 668766). Each row has a first byte that
    // its second one cannot stand in for: CC Delta's exponent, which a positive mantissa is not; then the
    // high bytes of numbers whose range leaves most of them out.
    calibration: None,
    signature: &[
        Signature { subclass: FLAT, offset: 0x4004, kind: H4, min: 0x8F00_0000, max: 0x977F_FFFF },
        Signature { subclass: FLAT, offset: 0x41DB, kind: I2, min: 0, max: 5000 },
        Signature { subclass: FLAT, offset: 0x41E0, kind: I2, min: -400, max: 850 },
        Signature { subclass: FLAT, offset: 0x425E, kind: U2, min: 1, max: 20000 },
    ],
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        pack: Some(Pack { word: Source::Answer(0x0006), name: "Control(CHEM_ID)", rows: &[] }),
        marks: &[(FLAT, 0x4000), (FLAT, 0x4004), (FLAT, 0x400D), (FLAT, 0x400E), (FLAT, 0x400F)],
        modes: &[
            Mode::calibration(
                Source::Status,
                0x1000,
                "CONTROL_STATUS [CALMODE]",
                "leave it with the tool that entered it (EXIT_CAL, 0x0080)",
            )
            // ENTER_CAL (0x0081) needs no CAL_ENABLE before it: pilotak/BQ35100 (01505a5f) sends it alone.
            .slips(0x0080),
            Mode::measuring(0x0400, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
            Mode::measuring(0x0800, "CONTROL_STATUS [BCA]", "the board offset is being measured"),
        ],
        // A primary cell learns nothing that a write could end: no row of it needs a reset.
        learning: None,
        voltage_mv: None,
    },
};

/// Table 11-1. The poll reads 0x02 to 0x0D whole, and 0x2E. Reading BatteryAlert() takes the ALERT signal
/// back (11.8), so that a host which waits for that pin has to look at the gauge's own registers instead.
///
/// There is no `capacity` and no `charge_now`: only the accumulator mode counts charge, as what was taken
/// out, from a start that only the user knows.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    // Counts down from 0 (pilotak/BQ35100). SLUUBH1C prints it signed with a range of 4.29E9.
    Register::new(0x02, I4, "AccumulatedCapacity", "µAh", Poll).role(Role::ChargeCounter).step(1, 1000),
    // Unsigned, with a negative minimum; SLUSCM6E has it signed. Kelvin need no sign.
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    // Signed, with a maximum of 65535; SLUSCM6E has it unsigned.
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U1, "BatteryStatus", "", Poll).bits(BATTERY_STATUS),
    Register::new(0x0B, U1, "BatteryAlert", "", Poll).role(Role::Flags).bits(ALERTS),
    // Of the last second, and only between GAUGE_START and GAUGE_STOP.
    Register::new(0x0C, I2, "Current", "mA", Poll).role(Role::CurrentNow),
    Register::new(0x16, U2, "ScaledR", "mΩ", Slow),
    Register::new(0x22, U2, "MeasuredZ", "mΩ", Slow).role(Role::InternalResistance),
    Register::new(0x28, U2, "InternalTemperature", "0.1K", Slow),
    Register::new(0x2E, U1, "StateOfHealth", "%", Poll)
        .role(Role::StateOfHealth)
        .values(0, 100, "SLUUBH1C: 0 at the end of service"),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U2, "ManufacturerAccessControl", "", Window),
    // AuthenticateData() is its first 20 bytes, AuthenticateChecksum() the one at 0x54.
    Register::new(0x40, U(32), "MACData", "", Window),
    Register::new(0x60, U1, "MACDataSum", "", Window),
    Register::new(0x61, U1, "MACDataLen", "", Window),
    // Only in MikroE's driver.
    Register::new(0x62, U1, "MACDataControl", "", Window),
    Register::new(0x79, U1, "Cal_Count", "", Slow),
    Register::new(0x7A, I2, "Cal_Current", "mA", Slow),
    // Counts where Operation Config A [EXTVCELL] is set. Signed here, unsigned in SLUSCM6E.
    Register::new(0x7C, U2, "Cal_Voltage", "mV", Slow),
    Register::new(0x7E, U2, "Cal_Temperature", "K", Slow),
];

/// Table 11-2. Key words are no subcommands and have no row, so they cannot be sent by name or code; nor
/// have addresses of data flash, 0x4000 to 0x43FF, which are sent the same way.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0005, "STATIC_CHEM_CHKSUM", Answers),
    Subcommand::new(0x0006, "CHEM_ID", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    // Measures and stores: with any current flowing it spoils the calibration it replaces.
    Subcommand::new(0x0009, "BOARD_OFFSET", Guarded),
    // Nothing is stored before CC_OFFSET_SAVE.
    Subcommand::new(0x000A, "CC_OFFSET", Allowed),
    Subcommand::new(0x000B, "CC_OFFSET_SAVE", Guarded),
    // Only in SLUSCM6E.
    Subcommand::new(0x000C, "DF_VERSION", Answers),
    // What a host does around each load: sent twice they start and stop no more than once.
    Subcommand::new(0x0011, "GAUGE_START", Allowed),
    Subcommand::new(0x0012, "GAUGE_STOP", Allowed),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    Subcommand::new(0x002D, "CAL_ENABLE", Guarded).unsealed(),
    Subcommand::new(0x002E, "LT_ENABLE", Allowed).unsealed(),
    // What was counted since GAUGE_START would be lost.
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0080, "EXIT_CAL", Guarded).unsealed(),
    Subcommand::new(0x0081, "ENTER_CAL", Guarded).unsealed(),
    // Not in Table 11-2. The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
    // Forgets all that was learned about the cell, even while SEALED.
    Subcommand::new(0xA613, "NEW_BATTERY", Never),
];

/// 11.2.1.
static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x8000, "FLASHF"),
    Bit::new(0x4000, "SEC1"),
    Bit::new(0x2000, "SEC0"),
    Bit::new(0x1000, "CALMODE"),
    Bit::new(0x0800, "BCA"),
    Bit::new(0x0400, "CCA"),
    Bit::new(0x0200, "LTEN"),
    Bit::new(0x0100, "OCVFAIL"),
    Bit::new(0x0080, "INITCOMP"),
    Bit::new(0x0040, "G_DONE"),
    Bit::new(0x0020, "SOH_ERR"),
    Bit::new(0x0010, "SOH_MERIT"),
    Bit::new(0x0008, "EOS_BAD_OCV"),
    Bit::new(0x0001, "GA"),
];

/// 11.7.
static BATTERY_STATUS: &[Bit] = &[Bit::new(0x04, "ALERT"), Bit::new(0x01, "DSG")];

/// 11.8, and Table 8-1 for ALERT Configuration.
static ALERTS: &[Bit] = &[
    Bit::new(0x80, "BATLOW"),
    Bit::new(0x40, "TEMPLOW"),
    Bit::new(0x20, "TEMPHIGH"),
    Bit::new(0x10, "SOH_LOW"),
    Bit::new(0x08, "EOS"),
    Bit::new(0x02, "G_DONE"),
    Bit::new(0x01, "INITCOMP"),
];

/// `[GMSEL]` 00 accumulates, 01 tells the state of health, 10 the end of service; 11 is invalid.
static OPERATION_CONFIG_A: &[Bit] = &[
    Bit::new(0x80, "TEMPS"),
    Bit::new(0x40, "EXTVCELL"),
    Bit::new(0x20, "WRTEMP"),
    Bit::new(0x10, "LF_EN"),
    Bit::new(0x04, "GNDSEL"),
    Bit::new(0x02, "GMSEL1"),
    Bit::new(0x01, "GMSEL0"),
];

/// Above the present voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");

/// What was used and what is left are fractions of it.
const CAPACITY: Safe = Safe::AtLeast(1, "a cell has a capacity");

/// Voltages of a cell are the pack's divided by this.
const CELLS: Safe = Safe::AtLeast(1, "a pack has one cell at least");

/// By address. SLUA790 and the drivers change settings without a reset, and one would lose what was counted
/// since GAUGE_START.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Calibration", name: "Data", id: FLAT, length: 18, kind: Plain,
               parameters: &[
        // The defaults are not known; gauges leave the factory near 0.47095 and 567744.6.
        P::float(0x4000, "CC Gain",         0.02, 10.0, 0.47095, "").no_default(),
        P::float(0x4004, "CC Delta",        29_826.2, 5_677_445.0, 567_744.6, "").no_default(),
        P::any(0x4008, I2, "CC Offset",       "").learned(),
        P::any(0x400A, I2, "AD I Offset",     "").unproven(),
        P::within(0x400C, I1, "Board Offset",    -128, 127, "").learned(),
        P::within(0x400D, I1, "Int Temp Offset", -128, 127, "0.1°C"),
        P::within(0x400E, I1, "Ext Temp Offset", -128, 127, "0.1°C"),
        P::within(0x400F, I1, "Pack V Offset",   -128, 127, "mV"),
        // Two drivers write it here; no source gives its size, its sign, or which values would make the voltage too
        // low for any further write.
        P::any(0x4010, U2, "VIN Gain",        "").unproven(),
    ] },
    Subclass { class: "Calibration", name: "Temp Model", id: FLAT, length: 22, kind: Plain,
               parameters: &[
        P::any(0x4012, I2, "Int Coeff 1",  "").unproven(),
        P::any(0x4014, I2, "Int Coeff 2",  "").unproven(),
        P::any(0x4016, I2, "Int Coeff 3",  "").unproven(),
        P::any(0x4018, I2, "Int Coeff 4",  "").unproven(),
        P::any(0x401A, I2, "Int Min AD",   "").unproven(),
        P::any(0x401C, I2, "Int Max Temp", "").unproven(),
        P::any(0x401E, I2, "Ext Coeff 1",  "").unproven(),
        P::any(0x4020, I2, "Ext Coeff 2",  "").unproven(),
        P::any(0x4022, I2, "Ext Coeff 3",  "").unproven(),
        P::any(0x4024, I2, "Ext Coeff 4",  "").unproven(),
        P::any(0x4026, I2, "Ext Rc0",      "").unproven(),
    ] },
    Subclass { class: "Calibration", name: "Vcomp", id: FLAT, length: 11, kind: Plain,
               parameters: &[
        P::any(0x4028, I2, "Vcomp Coeff 1",           "").unproven(),
        P::any(0x402A, I2, "Vcomp Coeff 2",           "").unproven(),
        P::any(0x402C, I2, "Vcomp Coeff 3",           "").unproven(),
        P::any(0x402E, I2, "Vcomp Coeff 4",           "").unproven(),
        P::any(0x4030, U1, "Vcomp Input Multiplier",  "").unproven(),
        P::any(0x4031, U2, "Vcomp Output Multiplier", "").unproven(),
    ] },
    Subclass { class: "Calibration", name: "Filter", id: FLAT, length: 1, kind: Plain,
               parameters: &[
        P::any(0x4033, U1, "Filter", "").unproven(),
    ] },
    Subclass { class: "System Data", name: "Manufacturer Info", id: FLAT, length: 32, kind: Plain,
               parameters: &[
        P::within(0x4036, H1, "Manufacturer Info Block A01", 0x00, 0xFF, "hex"),
        P::within(0x4037, H1, "Manufacturer Info Block A02", 0x00, 0xFF, "hex"),
        P::within(0x4038, H1, "Manufacturer Info Block A03", 0x00, 0xFF, "hex"),
        P::within(0x4039, H1, "Manufacturer Info Block A04", 0x00, 0xFF, "hex"),
        P::within(0x403A, H1, "Manufacturer Info Block A05", 0x00, 0xFF, "hex"),
        P::within(0x403B, H1, "Manufacturer Info Block A06", 0x00, 0xFF, "hex"),
        P::within(0x403C, H1, "Manufacturer Info Block A07", 0x00, 0xFF, "hex"),
        P::within(0x403D, H1, "Manufacturer Info Block A08", 0x00, 0xFF, "hex"),
        P::within(0x403E, H1, "Manufacturer Info Block A09", 0x00, 0xFF, "hex"),
        P::within(0x403F, H1, "Manufacturer Info Block A10", 0x00, 0xFF, "hex"),
        P::within(0x4040, H1, "Manufacturer Info Block A11", 0x00, 0xFF, "hex"),
        P::within(0x4041, H1, "Manufacturer Info Block A12", 0x00, 0xFF, "hex"),
        P::within(0x4042, H1, "Manufacturer Info Block A13", 0x00, 0xFF, "hex"),
        P::within(0x4043, H1, "Manufacturer Info Block A14", 0x00, 0xFF, "hex"),
        P::within(0x4044, H1, "Manufacturer Info Block A15", 0x00, 0xFF, "hex"),
        P::within(0x4045, H1, "Manufacturer Info Block A16", 0x00, 0xFF, "hex"),
        P::within(0x4046, H1, "Manufacturer Info Block A17", 0x00, 0xFF, "hex"),
        P::within(0x4047, H1, "Manufacturer Info Block A18", 0x00, 0xFF, "hex"),
        P::within(0x4048, H1, "Manufacturer Info Block A19", 0x00, 0xFF, "hex"),
        P::within(0x4049, H1, "Manufacturer Info Block A20", 0x00, 0xFF, "hex"),
        P::within(0x404A, H1, "Manufacturer Info Block A21", 0x00, 0xFF, "hex"),
        P::within(0x404B, H1, "Manufacturer Info Block A22", 0x00, 0xFF, "hex"),
        P::within(0x404C, H1, "Manufacturer Info Block A23", 0x00, 0xFF, "hex"),
        P::within(0x404D, H1, "Manufacturer Info Block A24", 0x00, 0xFF, "hex"),
        P::within(0x404E, H1, "Manufacturer Info Block A25", 0x00, 0xFF, "hex"),
        P::within(0x404F, H1, "Manufacturer Info Block A26", 0x00, 0xFF, "hex"),
        P::within(0x4050, H1, "Manufacturer Info Block A27", 0x00, 0xFF, "hex"),
        P::within(0x4051, H1, "Manufacturer Info Block A28", 0x00, 0xFF, "hex"),
        P::within(0x4052, H1, "Manufacturer Info Block A29", 0x00, 0xFF, "hex"),
        P::within(0x4053, H1, "Manufacturer Info Block A30", 0x00, 0xFF, "hex"),
        P::within(0x4054, H1, "Manufacturer Info Block A31", 0x00, 0xFF, "hex"),
        P::within(0x4055, H1, "Manufacturer Info Block A32", 0x00, 0xFF, "hex"),
    ] },
    Subclass { class: "System Data", name: "Integrity", id: FLAT, length: 10, kind: Plain,
               parameters: &[
        // Sums that the gauge holds against its own flash; a wrong one makes it distrust itself.
        P::within(0x4056, H2, "Static Chem DF Checksum", 0x0000, 0xFFFF, "hex").unproven(),
        P::any(0x405C, H4, "IF Checksum",             "hex").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Data", id: FLAT, length: 10, kind: Plain,
               parameters: &[
        // Length and form are inferred from the eight bytes before the next row.
        P::text(0x4060, 8, "Device Name",        "bq35100").unproven(),
        P::within(0x4068, H2, "Data Flash Version", 0x0000, 0xFFFF, "hex"),
    ] },
    Subclass { class: "Ra Table", name: "R_a0", id: FLAT, length: 30, kind: Plain,
               parameters: &[
        P::any(0x4175, I2, "R_a 0",  "").learned().unproven(),
        P::any(0x4177, I2, "R_a 1",  "").learned().unproven(),
        P::any(0x4179, I2, "R_a 2",  "").learned().unproven(),
        P::any(0x417B, I2, "R_a 3",  "").learned().unproven(),
        P::any(0x417D, I2, "R_a 4",  "").learned().unproven(),
        P::any(0x417F, I2, "R_a 5",  "").learned().unproven(),
        P::any(0x4181, I2, "R_a 6",  "").learned().unproven(),
        P::any(0x4183, I2, "R_a 7",  "").learned().unproven(),
        P::any(0x4185, I2, "R_a 8",  "").learned().unproven(),
        P::any(0x4187, I2, "R_a 9",  "").learned().unproven(),
        P::any(0x4189, I2, "R_a 10", "").learned().unproven(),
        P::any(0x418B, I2, "R_a 11", "").learned().unproven(),
        P::any(0x418D, I2, "R_a 12", "").learned().unproven(),
        P::any(0x418F, I2, "R_a 13", "").learned().unproven(),
        P::any(0x4191, I2, "R_a 14", "").learned().unproven(),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: FLAT, length: 3, kind: Plain,
               parameters: &[
        P::int(0x41B1, H1, "Operation Config A",  0x00, 0xFF, 0x80, "hex").bits(OPERATION_CONFIG_A),
        P::int(0x41B2, H1, "ALERT Configuration", 0x00, 0xFF, 0x00, "hex").bits(ALERTS),
        P::any(0x41B3, H1, "Clk Ctl Reg",         "hex").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Power", id: FLAT, length: 6, kind: Plain,
               parameters: &[
        P::any(0x41B6, I2, "Flash Update OK Voltage",      "mV").safe(GATE).unproven(),
        P::any(0x41B8, I2, "Offset Cal Inhibit Temp Low",  "0.1°C").unproven(),
        P::any(0x41BA, I2, "Offset Cal Inhibit Temp High", "0.1°C").unproven(),
    ] },
    Subclass { class: "Security", name: "Codes", id: FLAT, length: 24, kind: Keys,
               parameters: &[
        // No defaults: nothing that shows defaults may show these.
        P::any(0x41BC, H2, "Authen Key3 MSB",    "hex"),
        P::any(0x41BE, H2, "Authen Key3 LSB",    "hex"),
        P::any(0x41C0, H2, "Authen Key2 MSB",    "hex"),
        P::any(0x41C2, H2, "Authen Key2 LSB",    "hex"),
        P::any(0x41C4, H2, "Authen Key1 MSB",    "hex"),
        P::any(0x41C6, H2, "Authen Key1 LSB",    "hex"),
        P::any(0x41C8, H2, "Authen Key0 MSB",    "hex"),
        P::any(0x41CA, H2, "Authen Key0 LSB",    "hex"),
        P::within(0x41CC, H2, "Unseal Step 1",       0x0001, 0xFFFF, "hex"),
        P::within(0x41CE, H2, "Unseal Step 2",       0x0001, 0xFFFF, "hex"),
        P::within(0x41D0, H2, "Full Unseal Step 1",  0x0001, 0xFFFF, "hex"),
        P::within(0x41D2, H2, "Full Unseal Step 2",  0x0001, 0xFFFF, "hex"),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: FLAT, length: 18, kind: Plain,
               parameters: &[
        P::any(0x41D4, I2, "Default Temperature",               "0.1°C").unproven(),
        P::any(0x41D6, I2, "OT Dsg",                            "0.1°C").unproven(),
        // arithmetics.io prints 0x41B8, where another row stands; this is the one byte left for it.
        P::any(0x41D8, U1, "OT Dsg Time",                       "s").unproven(),
        P::any(0x41D9, I2, "OT Dsg Recovery",                   "0.1°C").unproven(),
        P::int(0x41DB, I2, "BatLow Voltage Set Threshold",         0, 5000, 2800, "mV"),
        // The values are the manual's, the address is the byte between its neighbours.
        P::int(0x41DD, U1, "BatLow Voltage Set Time",              0,  255,   10, "s").unproven(),
        // SLUUBH1C prints 0.1 K for both; a range from -400 on is one of 0.1 °C.
        P::int(0x41E0, I2, "Under Temperature Set Threshold",   -400,  850, -200, "0.1°C"),
        P::int(0x41E2, U1, "Under Temperature Set Time",           0,  255,    4, "s"),
        // The maximum is as printed, though it leaves no room above 25.5 °C.
        P::int(0x41E3, I2, "Under Temperature Clear Threshold",    0,  255,  100, "0.1°C"),
        P::any(0x41E5, U1, "SOH Low",                           "%").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "Design", id: FLAT, length: 11, kind: Plain,
               parameters: &[
        P::any(0x41FE, I2, "Cell Design Capacity mAh", "mAh").safe(CAPACITY),
        P::any(0x4202, I2, "Cell Design Voltage",      "mV"),
        P::any(0x4204, I2, "Cell Terminate Voltage",   "mV"),
        // Two drivers write it: arithmetics.io's, and Orgatex's for Zephyr (2025).
        P::any(0x4206, U1, "Series Cell Count",        "Num").safe(CELLS),
        P::any(0x4207, I2, "Max Load",                 "mA").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: FLAT, length: 2, kind: Plain,
               parameters: &[
        P::any(0x4209, U1, "SOH",           "%").learned().unproven(),
        P::any(0x420A, U1, "SOH Max Delta", "%").unproven(),
    ] },
    Subclass { class: "Lifetime", name: "Data", id: FLAT, length: 16, kind: Plain,
               parameters: &[
        P::any(0x4240, I2, "Primary Max",   "mV").learned().unproven(),
        P::any(0x4242, I2, "Primary Min",   "mV").learned().unproven(),
        P::any(0x4244, I2, "Max Discharge", "mA").learned().unproven(),
        P::any(0x4246, I2, "Min Discharge", "mA").learned().unproven(),
        P::any(0x4248, I2, "Max Cell",      "0.1°C").learned().unproven(),
        P::any(0x424A, I2, "Min Cell",      "0.1°C").learned().unproven(),
        P::any(0x424C, I2, "Max Gauge",     "0.1°C").learned().unproven(),
        P::any(0x424E, I2, "Min Gauge",     "0.1°C").learned().unproven(),
    ] },
    Subclass { class: "System Data", name: "Reset Counter", id: FLAT, length: 1, kind: Plain,
               parameters: &[
        P::any(0x4253, U1, "Reset Counter WD", "Num").learned().unproven(),
    ] },
    Subclass { class: "Configuration", name: "Battery ID", id: FLAT, length: 1, kind: Plain,
               parameters: &[
        P::any(0x4254, U1, "Battery ID", "").unproven(),
    ] },
    Subclass { class: "EOS Data", name: "Values", id: FLAT, length: 26, kind: Plain,
               parameters: &[
        // One byte, as pilotak/BQ35100 writes it; the next row leaves room for two.
        P::any(0x4255, U1, "R Data Seconds",                   "s").unproven(),
        P::int(0x4257, I2, "R Table Scale",                      -1,   32767,   -1, "").learned(),
        P::int(0x4259, U1, "New Batt R Scale Delay",              0,     255,    2, "readings"),
        P::int(0x425A, H1, "R Table Scale Update Flag",        0x00,    0xFF, 0xFF, "hex").learned(),
        P::int(0x425B, U1, "R Short Trend Filter",                1,     255,  251, ""),
        P::int(0x425C, U1, "R Long Trend Filter",                 1,     255,  253, ""),
        P::int(0x425D, U1, "EOS Trend Detection",                 1,     100,   20, "%"),
        P::int(0x425E, U2, "EOS Detection Pulse Count Thrshd",    1,   20000,  120, "Num"),
        // The averages start at 0, below the minimum that is printed.
        P::within(0x4260, U4, "Short Trend Average",                 1, 8355712, "").learned(),
        P::within(0x4264, U4, "Long Trend Average",                  1, 8355712, "").learned(),
        // SLUAAL7 repeats the threshold's row here; a count does not start at 120.
        P::within(0x4268, U2, "EOS Trend Detection Pulse Count",     1,   20000, "Num").learned(),
        P::any(0x426A, H1, "EOS Not Detected Flag",            "hex").learned().unproven(),
        P::any(0x426B, I2, "EOS SOH Smoothing Start Voltage",  "mV").unproven(),
        P::any(0x426D, U1, "EOS SOH Smoothing Margin",         "").unproven(),
        P::any(0x426E, U1, "EOS Relax V Hi Max Counts",        "").unproven(),
    ] },
    Subclass { class: "Accumulator Table", name: "Table0", id: FLAT, length: 60, kind: Plain,
               parameters: &[
        P::any(0x4280, U1, "Table0 Page Active",       "").learned().unproven(),
        P::any(0x4281, H1, "Table0 Last Entry Code 0", "hex").learned().unproven(),
        P::any(0x4282, H1, "Table0 Last Entry Code 1", "hex").learned().unproven(),
        P::any(0x4283, H1, "Table0 Last Entry Code 2", "hex").learned().unproven(),
        P::any(0x4284, H1, "Table0 Last Entry Code 3", "hex").learned().unproven(),
        P::any(0x4285, H1, "Table0 Last Entry Code 4", "hex").learned().unproven(),
        P::any(0x4286, I2, "Table0 Integer Part 0",    "").learned().unproven(),
        P::any(0x4288, I4, "Table0 Fractional Part 0", "").learned().unproven(),
        P::any(0x428C, I2, "Table0 Integer Part 1",    "").learned().unproven(),
        P::any(0x428E, I4, "Table0 Fractional Part 1", "").learned().unproven(),
        P::any(0x4292, I2, "Table0 Integer Part 2",    "").learned().unproven(),
        P::any(0x4294, I4, "Table0 Fractional Part 2", "").learned().unproven(),
        P::any(0x4298, I2, "Table0 Integer Part 3",    "").learned().unproven(),
        P::any(0x429A, I4, "Table0 Fractional Part 3", "").learned().unproven(),
        P::any(0x429E, I2, "Table0 Integer Part 4",    "").learned().unproven(),
        P::any(0x42A0, I4, "Table0 Fractional Part 4", "").learned().unproven(),
        P::any(0x42A4, I2, "Table0 Integer Part 5",    "").learned().unproven(),
        P::any(0x42A6, I4, "Table0 Fractional Part 5", "").learned().unproven(),
        P::any(0x42AA, I2, "Table0 Integer Part 6",    "").learned().unproven(),
        P::any(0x42AC, I4, "Table0 Fractional Part 6", "").learned().unproven(),
        P::any(0x42B0, I2, "Table0 Integer Part 7",    "").learned().unproven(),
        P::any(0x42B2, I4, "Table0 Fractional Part 7", "").learned().unproven(),
        P::any(0x42B6, I2, "Table0 Integer Part 8",    "").learned().unproven(),
        P::any(0x42B8, I4, "Table0 Fractional Part 8", "").learned().unproven(),
    ] },
    Subclass { class: "Accumulator Table", name: "Table1", id: FLAT, length: 60, kind: Plain,
               parameters: &[
        P::any(0x42C0, U1, "Table1 Page Active",       "").learned().unproven(),
        P::any(0x42C1, H1, "Table1 Last Entry Code 0", "hex").learned().unproven(),
        P::any(0x42C2, H1, "Table1 Last Entry Code 1", "hex").learned().unproven(),
        P::any(0x42C3, H1, "Table1 Last Entry Code 2", "hex").learned().unproven(),
        P::any(0x42C4, H1, "Table1 Last Entry Code 3", "hex").learned().unproven(),
        P::any(0x42C5, H1, "Table1 Last Entry Code 4", "hex").learned().unproven(),
        P::any(0x42C6, I2, "Table1 Integer Part 0",    "").learned().unproven(),
        P::any(0x42C8, I4, "Table1 Fractional Part 0", "").learned().unproven(),
        P::any(0x42CC, I2, "Table1 Integer Part 1",    "").learned().unproven(),
        P::any(0x42CE, I4, "Table1 Fractional Part 1", "").learned().unproven(),
        P::any(0x42D2, I2, "Table1 Integer Part 2",    "").learned().unproven(),
        P::any(0x42D4, I4, "Table1 Fractional Part 2", "").learned().unproven(),
        P::any(0x42D8, I2, "Table1 Integer Part 3",    "").learned().unproven(),
        P::any(0x42DA, I4, "Table1 Fractional Part 3", "").learned().unproven(),
        P::any(0x42DE, I2, "Table1 Integer Part 4",    "").learned().unproven(),
        P::any(0x42E0, I4, "Table1 Fractional Part 4", "").learned().unproven(),
        P::any(0x42E4, I2, "Table1 Integer Part 5",    "").learned().unproven(),
        P::any(0x42E6, I4, "Table1 Fractional Part 5", "").learned().unproven(),
        P::any(0x42EA, I2, "Table1 Integer Part 6",    "").learned().unproven(),
        P::any(0x42EC, I4, "Table1 Fractional Part 6", "").learned().unproven(),
        P::any(0x42F0, I2, "Table1 Integer Part 7",    "").learned().unproven(),
        P::any(0x42F2, I4, "Table1 Fractional Part 7", "").learned().unproven(),
        P::any(0x42F6, I2, "Table1 Integer Part 8",    "").learned().unproven(),
        P::any(0x42F8, I4, "Table1 Fractional Part 8", "").learned().unproven(),
    ] },
];
