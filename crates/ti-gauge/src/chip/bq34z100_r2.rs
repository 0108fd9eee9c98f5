// SPDX-License-Identifier: MIT

//! bq34z100-R2: the bq34z100-G1 with scales that it reports itself, for packs of more than 65 V, 32 A and 29 Ah.
//!
//! Section numbers are those of the technical reference manual, SLUUCO5A. Its sections on commands, scales and block access
//! are public, its summary of data flash is not. Data flash is that of the bq34z100-G1 (SLUSBZ5D, Table 7-11), row for
//! row, as far as the complete image of a pack with firmware 2.02 agrees with it: its bytes are in range at the same
//! places, except in subclass 48. What the image does not confirm is unproven. Bits are the bq34z100-G1's.

use std::time::Duration;

use super::Kind::{Plain, Reset};
use super::Tier::{Poll, Slow, Static, Window};
use super::bq34z100_g1::{
    self, ALERT_CONFIG, CALIBRATION, CAPACITY, CELLS, CONTROL_STATUS, FLAGS, FLAGS_B, KEEP_I2C,
    LEARNED_STATUS, LED_COMM, PACK_CONFIG_B, PACK_CONFIG_C, SUBCOMMANDS,
};
use super::{
    Access, Authentication, Bit, Chip, Condition, Evidence, External, Gate, Identity, KeyBlock, KeyOrder,
    KeyStorage, Learning, Mode, Pack, Parameter as P, Preflight, Register, Role, RomImage, Scale, Scaling,
    Scheme, SealStatus, Security, Signature, Source, Subclass,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2};
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
        build: None,
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
        certain: 0,
        empty: 0,
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
        shows: Security::SHOWS,
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
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
    asks: None,
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
        resets: Access::RESET,
        advances: false,
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
    subclasses: &SUBCLASSES,
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
    layouts: &[(0x0202, &[
        (104, 0), (107, 49), (82, 68), (80, 85), (32, 405), (34, 411), (36, 425), (64, 452), (68, 464),
        (81, 476), (112, 487), (67, 511), (59, 512), (60, 524), (66, 526), (2, 576), (48, 607),
        (49, 669), (58, 691), (88, 768), (89, 832),
    ])],
    chemistry: (178, 405),
    // Behind the sum of instruction flash, which the image's commands show; below 0x8000 in every image.
    chemistry_sum: Some(605),
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

/// The bq34z100-G1's subclasses, with the changes of firmware 2.02 as its image shows them.
static SUBCLASSES: [Subclass; bq34z100_g1::SUBCLASSES.len()] = {
    let mut all = bq34z100_g1::SUBCLASSES;
    let [data, manufacturer, lifetime, registers] = CHANGED;
    assert!(all[4].id == data.id && all[6].id == manufacturer.id);
    assert!(all[7].id == lifetime.id && all[9].id == registers.id);
    (all[4], all[6], all[7], all[9]) = (data, manufacturer, lifetime, registers);
    all
};

#[rustfmt::skip]
const CHANGED: [Subclass; 4] = [
    Subclass { class: "Configuration", name: "Data", id: 48, length: 62, kind: Reset,
               parameters: &[
        // The manual prints *256 here, which makes days and months overlap.
        P::int( 2, U2, "Manufacture Date",               0,  65535,      0, "Day+Mo*32+(Yr-1980)*512").role(Role::ManufactureDate),
        P::int( 4, H2, "Serial Number",             0x0000, 0xFFFF, 0x0001, "hex"),
        P::int( 6, U2, "Cycle Count",                    0,  65535,      0, "Counts").learned(),
        P::int( 8, I2, "CC Threshold",                 100,  32767,    900, "mAh"),
        P::int(10, U1, "Max Error Limit",                0,    100,    100, "%"),
        P::int(11, I2, "Design Capacity",                0,  32767,   1000, "mAh").safe(CAPACITY),
        // In 10 mWh, where the sister part has mWh (SLUUCO5A Table 3-4, SLUSF37 8.2.2.1.1).
        P::int(13, I2, "Design Energy",                  0,  32767,   5400, "10mWh"),
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
];
