// SPDX-License-Identifier: MIT

//! bq34z100-R2: the bq34z100-G1 with scales that it reports itself, for packs of more than 65 V, 32 A and 29 Ah.
//!
//! Section numbers are those of the technical reference manual, SLUUCO5A. Its sections on commands, scales and block access
//! are public, its summary of data flash is not. Data flash is that of the bq34z100-G1 (SLUSBZ5D, Table 7-11), row for
//! row, as far as the complete image of a pack with firmware 2.02 agrees with it: its bytes are in range at the same
//! places, except in subclass 48. What the image does not confirm is unproven. Bits are the bq34z100-G1's.

use std::time::Duration;

use super::Kind::{Plain, Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::bq34z100_g1::{
    ALERT_CONFIG, CALIBRATION, CAPACITY, CELLS, CONTROL_STATUS, DIVIDER, FLAGS, FLAGS_B, GATE, KEEP_I2C,
    LEARNED_STATUS, LED_COMM, PACK_CONFIG_B, PACK_CONFIG_C, SUBCOMMANDS,
};
use super::{
    Access, Authentication, Bit, Chip, Condition, Evidence, External, Gate, Identity, KeyBlock, KeyOrder,
    KeyStorage, Learning, Mode, Pack, Parameter as P, Preflight, Register, Role, RomImage, Scale, Scaling,
    Scheme, SealStatus, Security, Signature, Source, Subclass,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq34z100-R2 as far as it is known.
pub static CHIP: Chip = Chip {
    name: "bq34z100-r2",
    model: "bq34z100-R2",
    documents: &["SLUUCO5A (August 2023)", "SLUSBZ5D (April 2021), of the bq34z100-G1"],
    evidence: &[Evidence::Manual, Evidence::Sibling, Evidence::Image],
    // Only the firmware distinguishes it from the bq34z100-G1, and TI lets it be loaded into all bq34z100 parts, so it
    // runs on any of their hardware. The bq35100 has the same type and hardware 0x00A8.
    identity: Identity {
        device_type: 0x0100,
        firmware: &[0x0202],
        hardware: None,
        dm_codes: &[],
        answer: 0x00,
    },
    // BQ34Z100_DFI.c of github.com/DmitrijSarychev/Handy_Files (firmware 2.02, all 512 rows).
    firmware_file: Some(super::FirmwareFile { name: 640, names: &["bq34z100-G1"] }),
    technology: "Unknown",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0..0,
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: CONTROL_STATUS,
    // The bits of the bq34z100-G1: none shows that a battery is present, and none that it is too cold.
    condition: Condition {
        full: 0x0200,     // [FC]
        low: 0x0004,      // [SOC1]
        critical: 0x0002, // [SOCF]
        overheat: 0xC000, // [OTC], [OTD]
        cold: 0,
        over_voltage: 0x2000,  // [BATHI]
        under_voltage: 0x1000, // [BATLOW]
        present: 0,
        absent: 0,
        uncertain: 0x0010, // [CF]
        // No bit: Voltage() is 0 before the first measurement.
        complete: None,
        primary: None,
    },
    // 2.2.5 to 2.2.9: energies are in cWh and powers in cW before the scale.
    scaling: Scaling {
        voltage: Scale::Register(Source::Command(0x20)),
        current: Scale::Register(Source::Command(0x21)),
        charge: Scale::Register(Source::Command(0x21)),
        energy: Scale::Register(Source::Command(0x22)),
        scaled: None,
    },
    security: Security {
        status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
        // Those of the bq34z100-G1; the image has them as 36 72 04 14.
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0020,
        // As on the bq34z100-G1, by TI's advice to owners whose keys were refused.
        key_silence: Duration::from_millis(5200),
        // SLUSBZ5D 7.3.2.16.
        shown_sealed: &[(1, 58), (4, 59)],
        // The image has 36 72 04 14 for keys that are sent as 14 04, 72 36; four different bytes, so there is one way
        // only. The authentication key follows there as in the bq34z100-G1.
        storage: KeyStorage::Flash(KeyBlock {
            subclass: 112,
            start: 0,
            length: 24,
            unseal: 0,
            full_access: 4,
            authentication: Some(8),
            order: KeyOrder::Reversed,
        }),
    },
    access: Access {
        scheme: Scheme::Block,
        // The times are those of the bq34z100-G1, none of which is in a manual.
        select: Duration::from_millis(30),
        soonest: Duration::ZERO,
        commit: Duration::from_millis(100),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        reset: Duration::from_millis(200),
        reset_limit: Duration::from_secs(2),
    },
    // The limit is a cell's by its name, and Voltage() is compared before the scale: the gauge does not apply that. The
    // divider at which Voltage() is a cell's is not the bq34z100-G1's: a board that was calibrated with 9967 there needed
    // about 33000 with firmware 2.02, and no source has the new one, nor by how much [VOLTSEL] multiplies.
    gate: Some(Gate {
        limit: (68, 0),
        divider: Some((104, 14)),
        cell_divider: None,
        external: Some(External { byte: (64, 0), mask: 0x08, name: "[VOLTSEL]", factor: None }),
        cells: Some((64, 7)),
        calibration: Some((Source::Command(0x3A), 0x4000)),
    }),
    // The sequence is the bq34z100-G1's, as are the times.
    authentication: Some(Authentication {
        challenge: Duration::from_millis(1),
        digest: Duration::from_millis(50),
    }),
    subclasses: SUBCLASSES,
    byte_writes_above_hz: None,
    // The lengths of the three names, which are elsewhere in firmware 0.16: data flash is known from one image only.
    calibration: Some(&CALIBRATION),
    signature: &[
        Signature::new(48, 33, U1, 0, 11),
        Signature::new(48, 45, U1, 0, 11),
        Signature::new(48, 57, U1, 0, 4),
    ],
    volatile: None,
    quirks: &[],
    rom_image: Some(ROM_IMAGE),
    preflight: Preflight {
        pack: Some(Pack { word: Source::Command(0x28), name: "SerialNumber()", rows: &[(48, 4)] }),
        marks: &[(104, 0), (104, 4), (104, 11), (104, 12), (48, 4), (48, 6)],
        modes: &[
            Mode::calibration(
                Source::Status,
                0x1000,
                "CONTROL_STATUS [CALEN]",
                "leave it with `gaugefs calibrate GAUGE leave` or the tool that entered it (EXIT_CAL, 0x0080)",
            ),
            Mode::measuring(0x0800, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
            Mode::measuring(0x0400, "CONTROL_STATUS [BCA]", "the board offset is being measured"),
        ],
        // As on the bq34z100-G1: a reset discards what a cycle has counted so far.
        learning: Some(Learning {
            status: 0x0003,
            row: (82, 4),
            shown: Some(Source::Command(0x63)),
            mask: 0x06,
            value: 0x04,
            name: "CONTROL_STATUS [VOK] [QEN], LearnedStatus() [ITEN] without [CF1]",
        }),
        voltage_mv: None,
    },
};

/// Found by laying this table over an image of firmware 2.02 (github.com/DmitrijSarychev/Handy_Files,
/// BQ34Z100_DFI.c): 197 of 198 rows are in their ranges there. The place of 56 is not known; 107 begins with the
/// bytes of the BQ27426's.
#[rustfmt::skip]
const ROM_IMAGE: RomImage = RomImage {
    subclasses: &[
        (104, 0), (107, 49), (82, 68), (80, 85), (32, 405), (34, 411), (36, 425), (64, 452), (68, 464),
        (81, 476), (112, 487), (67, 511), (59, 512), (60, 524), (66, 526), (2, 576), (48, 607),
        (49, 669), (58, 691), (88, 768), (89, 832),
    ],
    chemistry: (178, 405),
    // Behind the sum of instruction flash, which the image's commands show; below 0x8000 in every image.
    chemistry_sum: 605,
};

/// Standard commands and extended ones (SLUUCO5A 2.1 and 2.2); types and signs are those of the bq34z100-G1. The
/// poll reads 0x02 to 0x13, 0x18 to 0x1B and 0x20 to 0x2F whole, so all in there count as polled.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, U1, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x03, U1, "MaxError", "%", Poll).role(Role::CapacityErrorMargin),
    Register::new(0x04, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x06, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x0C, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x0E, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x10, I2, "Current", "mA", Poll).role(Role::CurrentNow),
    Register::new(0x12, U2, "FlagsB", "", Poll).bits(FLAGS_B),
    Register::new(0x18, U2, "AverageTimeToEmpty", "min", Poll).role(Role::TimeToEmptyAvg),
    Register::new(0x1A, U2, "AverageTimeToFull", "min", Poll).role(Role::TimeToFullNow),
    Register::new(0x1C, I2, "PassedCharge", "mAh", Slow),
    Register::new(0x1E, U2, "DOD0Time", "min", Slow),
    // 2.2.5 to 2.2.7: copies of data flash, by which the host multiplies.
    Register::new(0x20, U1, "VoltScale", "", Poll),
    Register::new(0x21, U1, "CurrScale", "", Poll),
    Register::new(0x22, U1, "EnergyScale", "", Poll),
    Register::new(0x24, U2, "AvailableEnergy", "cWh", Poll).role(Role::EnergyNow).step(10, 1),
    Register::new(0x26, U2, "AveragePower", "cW", Poll).role(Role::PowerAvg).step(10, 1).of_discharges(),
    Register::new(0x28, U2, "SerialNumber", "", Poll).role(Role::SerialNumber),
    Register::new(0x2A, U2, "InternalTemperature", "0.1K", Poll),
    Register::new(0x2C, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2E, U2, "StateOfHealth", "%", Poll).role(Role::StateOfHealth),
    Register::new(0x30, U2, "ChargeVoltage", "mV", Slow).role(Role::ChargeVoltage),
    Register::new(0x32, U2, "ChargeCurrent", "mA", Slow).role(Role::ChargeCurrent),
    Register::new(0x3A, U2, "PackConfiguration", "", Slow).bits(PACK_CONFIG),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(20), "AuthenticateData", "", Window),
    Register::new(0x54, U1, "AuthenticateChecksum", "", Window),
    Register::new(0x55, U(11), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
    Register::new(0x62, U1, "GridNumber", "", Slow),
    Register::new(0x63, U1, "LearnedStatus", "", Slow).bits(LEARNED_STATUS),
    Register::new(0x64, U2, "DOD@EOC", "", Slow),
    Register::new(0x66, U2, "QStart", "mAh", Slow),
    Register::new(0x68, U2, "TrueRC", "mAh", Slow),
    Register::new(0x6A, U2, "TrueFCC", "mAh", Slow),
    Register::new(0x6C, U2, "StateTime", "s", Slow),
    // No sign is printed; charge passed in either direction needs one, like PassedCharge().
    Register::new(0x6E, I2, "QMaxPassedQ", "mAh", Slow),
    Register::new(0x70, U2, "DOD0", "", Slow),
    Register::new(0x72, U2, "QmaxDOD0", "", Slow),
    Register::new(0x74, U2, "QmaxTime", "h/16", Slow),
];

/// Without [SCALED] of the bq34z100-G1: the scales have registers of their own.
static PACK_CONFIG: &[Bit] = &[
    Bit::new(0x8000, "RESCAP"),
    Bit::new(0x4000, "CAL_EN"),
    Bit::new(0x0800, "VOLTSEL"),
    Bit::new(0x0400, "IWAKE"),
    Bit::new(0x0200, "RSNS1"),
    Bit::new(0x0100, "RSNS0"),
    Bit::new(0x0080, "RFACTSTEP"),
    Bit::new(0x0040, "SLEEP"),
    Bit::new(0x0020, "RMFCC"),
    Bit::new(0x0010, "NiDT"),
    Bit::new(0x0008, "NiDV"),
    Bit::new(0x0004, "QPCCLEAR"),
    Bit::new(0x0002, "GNDSEL"),
    Bit::new(0x0001, "TEMPS"),
];

/// Rows, ranges and defaults of SLUSBZ5D, Table 7-11, with the changes of firmware 2.02 as its image shows them.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Configuration", name: "Safety", id: 2, length: 10, kind: Reset,
               parameters: &[
        P::int(0, I2, "OT Chg",          0, 1200, 550, "0.1°C"),
        P::int(2, U1, "OT Chg Time",     0,   60,   2, "s"),
        P::int(3, I2, "OT Chg Recovery", 0, 1200, 500, "0.1°C"),
        P::int(5, I2, "OT Dsg",          0, 1200, 600, "0.1°C"),
        P::int(7, U1, "OT Dsg Time",     0,   60,   2, "s"),
        P::int(8, I2, "OT Dsg Recovery", 0, 1200, 550, "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Charge Inhibit Cfg", id: 32, length: 6, kind: Reset,
               parameters: &[
        P::int(0, I2, "Chg Inhibit Temp Low",  -400, 1200,   0, "0.1°C"),
        P::int(2, I2, "Chg Inhibit Temp High", -400, 1200, 450, "0.1°C"),
        P::int(4, I2, "Temp Hys",                 0,  100,  50, "0.1°C"),
    ] },
    Subclass { class: "Configuration", name: "Charge", id: 34, length: 14, kind: Reset,
               parameters: &[
        P::int(0, I2, "Suspend Low Temp",    -400, 1200, -50, "0.1°C"),
        P::int(2, I2, "Suspend High Temp",   -400, 1200, 550, "0.1°C"),
        P::int(4, U1, "Pb EFF Efficiency",      0,  100, 100, "%"),
        // Table 7-11 prints 0.01953125, Table 8-2 25 %.
        P::float( 5, "Pb Temp Comp",      0.0, 0.078125, 0.01953125, "%").no_default(),
        P::int(9, U1, "Pb Drop Off Percent",    0,  100,  96, "%"),
        P::float(10, "Pb Reduction Rate", 0.0,     1.25,      0.125, "%"),
    ] },
    Subclass { class: "Configuration", name: "Charge Termination", id: 36, length: 27, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Taper Current",                  0,  1000,  100, "mA"),
        P::int( 2, I2, "Min Taper Capacity",             0,  1000,   25, "mAh"),
        P::int( 4, I2, "Cell Taper Voltage",             0,  1000,  100, "mV"),
        P::int( 6, U1, "Current Taper Window",           0,    60,   40, "s"),
        P::int( 7, I1, "TCA Set %",                     -1,   100,   99, "%"),
        P::int( 8, I1, "TCA Clear %",                   -1,   100,   95, "%"),
        P::int( 9, I1, "FC Set %",                      -1,   100,  100, "%"),
        P::int(10, I1, "FC Clear %",                    -1,   100,   98, "%"),
        P::int(11, I2, "DODatEOC Delta T",               0,  1000,  100, "0.1°C"),
        // Table 8-3 prints 3 and 25 for Delta Temp and Hold Off Temp; Table 7-11 has 30 and 250.
        P::int(13, I2, "NiMH Delta Temp",                0,   255,   30, "0.1°C"),
        P::int(15, U2, "NiMH Delta Temp Time",           0,  1000,  180, "s"),
        P::int(17, U2, "NiMH Hold Off Time",             0,  1000,  100, "s"),
        P::int(19, I2, "NiMH Hold Off Current",          0, 32000,  240, "mA"),
        P::int(21, I2, "NiMH Hold Off Temp",             0,  1000,  250, "0.1°C"),
        P::int(23, U1, "NiMH Cell Negative Delta Volt",  0,   100,   17, "mV"),
        P::int(24, U1, "NiMH Cell Negative Delta Time",  0,   255,   16, "s"),
        P::int(25, I2, "NiMH Cell Neg Delta Qual Volt",  0, 32767, 4200, "mV"),
    ] },
    Subclass { class: "Configuration", name: "Data", id: 48, length: 62, kind: Reset,
               parameters: &[
        // The manual prints *256 here, which makes days and months overlap.
        P::int( 2, U2, "Manufacture Date",               0,  65535,      0, "Day+Mo*32+(Yr-1980)*512").role(Role::ManufactureDate),
        P::int( 4, H2, "Serial Number",             0x0000, 0xFFFF, 0x0001, "hex"),
        P::int( 6, U2, "Cycle Count",                    0,  65535,      0, "Counts").learned(),
        P::int( 8, I2, "CC Threshold",                 100,  32767,    900, "mAh"),
        P::int(10, U1, "Max Error Limit",                0,    100,    100, "%"),
        P::int(11, I2, "Design Capacity",                0,  32767,   1000, "mAh").safe(CAPACITY),
        P::int(13, I2, "Design Energy",                  0,  32767,   5400, "mWh"),
        P::int(15, I2, "SOH Load I",                -32767,      0,   -400, "mA"),
        P::int(17, U2, "Cell Charge Voltage T1-T2",      0,   4600,   4200, "mV"),
        P::int(19, U2, "Cell Charge Voltage T2-T3",      0,   4600,   4200, "mV").role(Role::VoltageMaxDesign),
        P::int(21, U2, "Cell Charge Voltage T3-T4",      0,   4600,   4100, "mV"),
        P::int(23, U1, "Charge Current T1-T2",           0,    100,     10, "%"),
        P::int(24, U1, "Charge Current T2-T3",           0,    100,     50, "%"),
        P::int(25, U1, "Charge Current T3-T4",           0,    100,     30, "%"),
        P::int(26, I1, "JEITA T1",                    -128,    127,    -10, "°C"),
        P::int(27, I1, "JEITA T2",                    -128,    127,     10, "°C"),
        P::int(28, I1, "JEITA T3",                    -128,    127,     45, "°C"),
        P::int(29, I1, "JEITA T4",                    -128,    127,     55, "°C"),
        // The image has 01 01 01 here, and SLUUCO5A has the names without the places, so the order is uncertain.
        P::int(30, U1, "Volt Scale",                     1,    255,      1, "").unproven(),
        P::int(31, U1, "Curr Scale",                     1,    255,      1, "").unproven(),
        P::int(32, U1, "Energy Scale",                   1,    255,      1, "").unproven(),
        P::text(33, 12, "Device Name",       "BQ34Z100-G1"),
        P::text(45, 12, "Manufacturer Name", "Texas Inst."),
        P::text(57,  5, "Device Chemistry",  "LION").role(Role::Technology),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: 49, length: 22, kind: Reset,
               parameters: &[
        P::int( 0, U2, "SOC1 Set Threshold",           0, 65535,  150, "mAh"),
        P::int( 2, U2, "SOC1 Clear Threshold",         0, 65535,  175, "mAh"),
        P::int( 4, U2, "SOCF Set Threshold",           0, 65535,   75, "mAh"),
        P::int( 6, U2, "SOCF Clear Threshold",         0, 65535,  100, "mAh"),
        P::int( 8, I2, "Cell BL Set Volt Threshold",   0,  5000,    0, "mV"),
        P::int(10, U1, "Cell BL Set Volt Time",        0,    60,    0, "s"),
        // Printed as 5 mV for both Clear thresholds; the name and Set threshold say a voltage of its own.
        P::int(11, I2, "Cell BL Clear Volt Threshold", 0,  5000,    5, "mV").no_default(),
        P::int(13, I2, "Cell BH Set Volt Threshold",   0,  5000, 4300, "mV"),
        P::int(15, U1, "Cell BH Volt Time",            0,    60,    2, "s"),
        P::int(16, I2, "Cell BH Clear Volt Threshold", 0,  5000,    5, "mV").no_default(),
        P::int(21, U1, "Cycle Delta",                  0,   255,    5, "0.01%"),
    ] },
    Subclass { class: "Configuration", name: "Manufacturer Data", id: 56, length: 12, kind: Plain,
               parameters: &[
        // Somewhere among zeros in the image.
        P::int( 0, H2, "Pack Lot Code",     0x0000, 0xFFFF, 0x0000, "hex").unproven(),
        P::int( 2, H2, "PCB Lot Code",      0x0000, 0xFFFF, 0x0000, "hex").unproven(),
        P::int( 4, H2, "Firmware Version",  0x0000, 0xFFFF, 0x0000, "hex").unproven(),
        P::int( 6, H2, "Hardware Revision", 0x0000, 0xFFFF, 0x0000, "hex").unproven(),
        P::int( 8, H2, "Cell Revision",     0x0000, 0xFFFF, 0x0000, "hex").unproven(),
        P::int(10, H2, "DF Config Version", 0x0000, 0xFFFF, 0x0000, "hex").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Lifetime Data", id: 59, length: 12, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Lifetime Max Temp",              0,  1400, 300, "0.1°C").learned(),
        P::int( 2, I2, "Lifetime Min Temp",           -600,  1400, 200, "0.1°C").learned(),
        P::int( 4, I2, "Lifetime Max Chg Current",  -32767, 32767,   0, "mA").learned(),
        P::int( 6, I2, "Lifetime Max Dsg Current",  -32767, 32767,   0, "mA").learned(),
        // SLUSBZ5D prints steps of 20 mV; the values in the image are plausible in mV only.
        P::within( 8, U2, "Lifetime Max Pack Voltage",   0, 65535, "mV").learned(),
        P::within(10, U2, "Lifetime Min Pack Voltage",   0, 65535, "mV").learned(),
    ] },
    Subclass { class: "Configuration", name: "Lifetime Temp Samples", id: 60, length: 2, kind: Reset,
               parameters: &[
        P::int(0, U2, "LT Flash Cnt", 0, 65535, 0, "Counts").learned(),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: 64, length: 8, kind: Reset,
               parameters: &[
        // Table 7-11 prints 0x0161, the bit texts of Table 7-17 add up to 0x01E1.
        P::int(0, H2, "Pack Configuration",     0x0000, 0xFFFF, 0x0161, "flags").no_default().bits(PACK_CONFIG),
        P::int(2, H1, "Pack Configuration B",     0x00,   0xFF,   0xFF, "flags").bits(PACK_CONFIG_B),
        P::int(3, H1, "Pack Configuration C",     0x00,   0xFF,   0x30, "flags").bits(PACK_CONFIG_C),
        P::int(4, H1, "LED_Comm Configuration",   0x00,   0xFF,   0x00, "flags").bits(LED_COMM).safe(KEEP_I2C),
        P::int(5, H2, "Alert Configuration",    0x0000, 0xFFFF, 0x0000, "flags").bits(ALERT_CONFIG),
        P::int(7, U1, "Number of series cell",       0,    100,      1, "Num").safe(CELLS).role(Role::Cells),
    ] },
    Subclass { class: "Configuration", name: "Lifetime Resolution", id: 66, length: 5, kind: Reset,
               parameters: &[
        P::int(0, U1, "LT Temp Res",    0,   255,  10, "0.1°C"),
        P::int(1, U1, "LT Cur Res",     0,   255, 100, "mA"),
        P::int(2, U1, "LT V Res",       0,   255,   1, "20mV"),
        P::int(3, U2, "LT Update Time", 0, 65535,  60, "s"),
    ] },
    Subclass { class: "Configuration", name: "LED Display", id: 67, length: 1, kind: Reset,
               parameters: &[
        P::int(0, U1, "LED Hold Time", 0, 255, 4, "Num"),
    ] },
    Subclass { class: "Configuration", name: "Power", id: 68, length: 12, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Flash Update OK Cell Volt", 0, 4200, 2800, "mV").safe(GATE),
        P::int( 2, I2, "Sleep Current",             0,  100,   10, "mA"),
        P::int(11, U1, "FS Wait",                   0,  255,    0, "s"),
    ] },
    Subclass { class: "System Data", name: "Manufacturer Info", id: 58, length: 32, kind: Plain,
               parameters: &[
        P::int( 0, H1, "Block A 0",  0x00, 0xFF, 0x00, "hex"),
        P::int( 1, H1, "Block A 1",  0x00, 0xFF, 0x00, "hex"),
        P::int( 2, H1, "Block A 2",  0x00, 0xFF, 0x00, "hex"),
        P::int( 3, H1, "Block A 3",  0x00, 0xFF, 0x00, "hex"),
        P::int( 4, H1, "Block A 4",  0x00, 0xFF, 0x00, "hex"),
        P::int( 5, H1, "Block A 5",  0x00, 0xFF, 0x00, "hex"),
        P::int( 6, H1, "Block A 6",  0x00, 0xFF, 0x00, "hex"),
        P::int( 7, H1, "Block A 7",  0x00, 0xFF, 0x00, "hex"),
        P::int( 8, H1, "Block A 8",  0x00, 0xFF, 0x00, "hex"),
        P::int( 9, H1, "Block A 9",  0x00, 0xFF, 0x00, "hex"),
        P::int(10, H1, "Block A 10", 0x00, 0xFF, 0x00, "hex"),
        P::int(11, H1, "Block A 11", 0x00, 0xFF, 0x00, "hex"),
        P::int(12, H1, "Block A 12", 0x00, 0xFF, 0x00, "hex"),
        P::int(13, H1, "Block A 13", 0x00, 0xFF, 0x00, "hex"),
        P::int(14, H1, "Block A 14", 0x00, 0xFF, 0x00, "hex"),
        P::int(15, H1, "Block A 15", 0x00, 0xFF, 0x00, "hex"),
        P::int(16, H1, "Block A 16", 0x00, 0xFF, 0x00, "hex"),
        P::int(17, H1, "Block A 17", 0x00, 0xFF, 0x00, "hex"),
        P::int(18, H1, "Block A 18", 0x00, 0xFF, 0x00, "hex"),
        P::int(19, H1, "Block A 19", 0x00, 0xFF, 0x00, "hex"),
        P::int(20, H1, "Block A 20", 0x00, 0xFF, 0x00, "hex"),
        P::int(21, H1, "Block A 21", 0x00, 0xFF, 0x00, "hex"),
        P::int(22, H1, "Block A 22", 0x00, 0xFF, 0x00, "hex"),
        P::int(23, H1, "Block A 23", 0x00, 0xFF, 0x00, "hex"),
        P::int(24, H1, "Block A 24", 0x00, 0xFF, 0x00, "hex"),
        P::int(25, H1, "Block A 25", 0x00, 0xFF, 0x00, "hex"),
        P::int(26, H1, "Block A 26", 0x00, 0xFF, 0x00, "hex"),
        P::int(27, H1, "Block A 27", 0x00, 0xFF, 0x00, "hex"),
        P::int(28, H1, "Block A 28", 0x00, 0xFF, 0x00, "hex"),
        P::int(29, H1, "Block A 29", 0x00, 0xFF, 0x00, "hex"),
        P::int(30, H1, "Block A 30", 0x00, 0xFF, 0x00, "hex"),
        P::int(31, H1, "Block A 31", 0x00, 0xFF, 0x00, "hex"),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: 80, length: 93, kind: Reset,
               parameters: &[
        P::int( 0, U1, "Load Select",                         0,   255,     1, "Num"),
        P::int( 1, U1, "Load Mode",                           0,   255,     0, "Num"),
        P::int(10, I2, "Res Current",                         0,  1000,    10, "mA"),
        P::int(14, U1, "Max Res Factor",                      0,   255,    50, "Num"),
        P::int(15, U1, "Min Res Factor",                      0,   255,     1, "Num"),
        P::int(17, U2, "Ra Filter",                           0,  1000,   500, "Num"),
        // Table 7-11 prints 50, Table 8-4 90 for lithium.
        P::int(47, U1, "Min PassedChg NiMH-LA 1st Qmax",      1,   100,    50, "%").no_default(),
        P::int(49, U1, "Maximum Qmax Change",                 0,   255,   100, "%"),
        // 7.3.3.1 of SLUSBZ5D has it at 48; its table is right.
        P::int(53, I2, "Cell Terminate Voltage",           1000,  3700,  3000, "mV").role(Role::VoltageMinDesign),
        P::int(55, I2, "Cell Term V Delta",                   0,  4200,   200, "mV"),
        P::int(58, U2, "ResRelax Time",                       0, 65534,   500, "s"),
        P::int(62, I2, "User Rate-mA",                   -32767, 32767,     0, "mA"),
        P::int(64, I2, "User Rate-Pwr",                  -32767, 32767,     0, "mW/cW"),
        P::int(66, I2, "Reserve Cap-mAh",                     0,  9000,     0, "mAh"),
        P::int(68, I2, "Reserve Energy",                      0, 14000,     0, "mWh/cWh"),
        P::int(72, U1, "Max Scale Back Grid",                 0,    15,     4, "Num"),
        P::int(73, U2, "Cell Min DeltaV",                     0, 65535,     0, "mV"),
        P::int(75, U1, "Ra Max Delta",                        0,   255,    15, "%"),
        P::int(76, I2, "Design Resistance",                   1, 32767,    42, "mΩ"),
        P::int(78, U1, "Reference Grid",                      0,    14,     4, ""),
        // The manual prints mAh.
        P::int(79, U1, "Qmax Max Delta %",                    0,   100,    10, "%"),
        P::int(80, U2, "Max Res Scale",                       0, 32767, 32000, "Num"),
        P::int(82, U2, "Min Res Scale",                       0, 32767,     1, "Num"),
        P::int(84, U1, "Fast Scale Start SOC",                0,   100,    10, "%"),
        P::int(89, I2, "Charge Hys V Shift",                  0,  2000,    40, "mV"),
        P::int(91, I2, "Smooth Relax Time",                   1, 32767,  1000, "s"),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 11, kind: Reset,
               parameters: &[
        P::int(0, I2, "Dsg Current Threshold", 0, 2000,  60, "mA"),
        P::int(2, I2, "Chg Current Threshold", 0, 2000,  75, "mA"),
        P::int(4, I2, "Quit Current",          0, 1000,  40, "mA"),
        P::int(6, U2, "Dsg Relax Time",        0, 8191,  60, "s"),
        P::int(8, U1, "Chg Relax Time",        0,  255,  60, "s"),
        P::int(9, U2, "Cell Max IR Correct",   0, 1000, 400, "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: 82, length: 17, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Qmax Cell 0",             0, 32767,  1000, "mAh").safe(CAPACITY).learned(),
        P::int( 2, U2, "Cycle Count",             0, 65535,     0, "Num").learned(),
        P::int( 4, H1, "Update Status",        0x00,  0x06,  0x00, "Num").learned(),
        P::int( 5, I2, "Cell V at Chg Term",      0,  5000,  4200, "mV").learned(),
        P::int( 7, I2, "Avg I Last Run",     -32768, 32767,  -299, "mA").learned(),
        // The manual prints mWh for this power.
        P::int( 9, I2, "Avg P Last Run",     -32768, 32767, -1131, "mW").learned(),
        P::int(11, I2, "Cell Delta Voltage", -32768, 32767,     2, "mV").learned(),
        P::int(13, I2, "T Rise",                  0, 32767,    20, "Num").learned(),
        P::int(15, I2, "T Time Constant",         0, 32767,  1000, "Num").learned(),
    ] },
    Subclass { class: "Ra Table", name: "R_a0", id: 88, length: 32, kind: Reset,
               parameters: &[
        P::int( 0, H2, "R_a0 Flag", 0x0000, 0xFFFF, 0xFF55, "Hex").learned(),
        P::int( 2, I2, "R_a0 0",         0,  32767,    105, "Num").learned(),
        P::int( 4, I2, "R_a0 1",         0,  32767,    100, "Num").learned(),
        P::int( 6, I2, "R_a0 2",         0,  32767,    113, "Num").learned(),
        P::int( 8, I2, "R_a0 3",         0,  32767,    143, "Num").learned(),
        P::int(10, I2, "R_a0 4",         0,  32767,     98, "Num").learned(),
        P::int(12, I2, "R_a0 5",         0,  32767,     97, "Num").learned(),
        P::int(14, I2, "R_a0 6",         0,  32767,    108, "Num").learned(),
        P::int(16, I2, "R_a0 7",         0,  32767,     89, "Num").learned(),
        P::int(18, I2, "R_a0 8",         0,  32767,     86, "Num").learned(),
        P::int(20, I2, "R_a0 9",         0,  32767,     85, "Num").learned(),
        P::int(22, I2, "R_a0 10",        0,  32767,     87, "Num").learned(),
        P::int(24, I2, "R_a0 11",        0,  32767,     90, "Num").learned(),
        P::int(26, I2, "R_a0 12",        0,  32767,    110, "Num").learned(),
        P::int(28, I2, "R_a0 13",        0,  32767,    647, "Num").learned(),
        P::int(30, I2, "R_a0 14",        0,  32767,   1500, "Num").learned(),
    ] },
    Subclass { class: "Ra Table", name: "R_a0x", id: 89, length: 32, kind: Reset,
               parameters: &[
        P::int( 0, H2, "R_a0x Flag", 0x0000, 0xFFFF, 0xFFFF, "Hex").learned(),
        P::int( 2, I2, "R_a0x 0",         0,  32767,    105, "Num").learned(),
        P::int( 4, I2, "R_a0x 1",         0,  32767,    100, "Num").learned(),
        P::int( 6, I2, "R_a0x 2",         0,  32767,    113, "Num").learned(),
        P::int( 8, I2, "R_a0x 3",         0,  32767,    143, "Num").learned(),
        P::int(10, I2, "R_a0x 4",         0,  32767,     98, "Num").learned(),
        P::int(12, I2, "R_a0x 5",         0,  32767,     97, "Num").learned(),
        P::int(14, I2, "R_a0x 6",         0,  32767,    108, "Num").learned(),
        P::int(16, I2, "R_a0x 7",         0,  32767,     89, "Num").learned(),
        P::int(18, I2, "R_a0x 8",         0,  32767,     86, "Num").learned(),
        P::int(20, I2, "R_a0x 9",         0,  32767,     85, "Num").learned(),
        P::int(22, I2, "R_a0x 10",        0,  32767,     87, "Num").learned(),
        P::int(24, I2, "R_a0x 11",        0,  32767,     90, "Num").learned(),
        P::int(26, I2, "R_a0x 12",        0,  32767,    110, "Num").learned(),
        P::int(28, I2, "R_a0x 13",        0,  32767,    647, "Num").learned(),
        P::int(30, I2, "R_a0x 14",        0,  32767,   1500, "Num").learned(),
    ] },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 16, kind: Reset,
               parameters: &[
        // The manual prints milliohms, but these are the stored numbers: 4.768 / CC Gain and 5677445 / CC
        // Delta are the milliohms (Table 7-12).
        P::float(0, "CC Gain",       0.1,        40.0,     0.4768, "Num"),
        P::float(4, "CC Delta", 29_800.0, 1_190_000.0, 567_744.56, "Num"),
        P::int( 8, I2, "CC Offset",       -32768, 32767, -1200, "Num").learned(),
        P::int(10, I1, "Board Offset",      -128,   127,     0, "Num").learned(),
        P::int(11, I1, "Int Temp Offset",   -128,   127,     0, "0.1°C"),
        P::int(12, I1, "Ext Temp Offset",   -128,   127,     0, "0.1°C"),
        P::int(14, U2, "Voltage Divider",      0, 65535,  5000, "mV").safe(DIVIDER),
    ] },
    Subclass { class: "Calibration", name: "Current", id: 107, length: 2, kind: Reset,
               parameters: &[
        // The default, among 19 bytes that the image of a bq34z100-G1 has as well; a class 107 of the BQ27426 begins with them.
        P::int(1, U1, "Deadband", 0, 255, 5, "mA"),
    ] },
    Subclass { class: "Security", name: "Codes", id: 112, length: 24, kind: Keys,
               parameters: &[
        // No defaults: nothing that shows defaults may show these.
        P::any( 0, H4, "Sealed to Unsealed", "hex"),
        P::any( 4, H4, "Unsealed to Full",   "hex"),
        P::any( 8, H4, "Authen Key3",        "hex"),
        P::any(12, H4, "Authen Key2",        "hex"),
        P::any(16, H4, "Authen Key1",        "hex"),
        P::any(20, H4, "Authen Key0",        "hex"),
    ] },
];
