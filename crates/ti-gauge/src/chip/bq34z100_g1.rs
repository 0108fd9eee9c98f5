// SPDX-License-Identifier: MIT

//! bq34z100-G1: Impedance Track gauge for packs of one to many cells in series, 3 V to 65 V.
//!
//! Table, section and figure numbers are those of the datasheet, SLUSBZ5D. Data flash is its Table
//! 7-11 row for row; where another place of the documents disagrees, the row says what was taken. A
//! default that sources dispute is left out. Firmware 0.16 only: the bq34z100-R2 has another subclass 48.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Plain, Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Authentication, Bit, Calibration, Chip, Condition, Evidence, External, Gate, Identity, KeyBlock,
    KeyOrder, KeyStorage, Learning, Mode, Offset, Pack, Parameter as P, Preflight, Register, Role, RomImage,
    Safe, Scale, Scaling, Scheme, SealStatus, Security, Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq34z100-G1 as TI's documents describe it.
pub static CHIP: Chip = Chip {
    name: "bq34z100-g1",
    model: "bq34z100-G1",
    documents: &["SLUSBZ5D (April 2021)", "SLUA790"],
    // SLUA790's worked transfers; none of it from our own hardware.
    evidence: &[Evidence::Manual, Evidence::Transcript, Evidence::Kernel],
    // DEVICE_TYPE is printed in SLUA790, 2.3; the versions are those that owners read from parts. The
    // bq35100 has the same type and hardware 0x00A8, the bq34z100-R2 firmware 0x0202.
    identity: Identity {
        device_type: 0x0100,
        firmware: &[0x0016],
        build: None,
        hardware: Some(0x0008),
        dm_codes: &[],
        answer: 0x00,
    },
    // bq34z100_dffs.h of github.com/tibms/kernel-4.4 (firmware 0.16).
    firmware_file: Some(super::FirmwareFile { name: 633, names: &["bq34z100-G1"] }),
    technology: "Unknown",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0..0,
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: CONTROL_STATUS,
    // No bit tells that a battery is present, and none that it is too cold: [CHG_INH] and [XCHG] stand
    // for either end of the temperature range.
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
    // 7.3.7.1: the factor that [SCALED] announces is not in the gauge. 7.3.6.5: Design Energy Scale.
    scaling: Scaling {
        energy: Scale::Flash(48, 30),
        scaled: Some((Source::Command(0x3A), SCALED)),
        ..Scaling::NONE
    },
    security: Security {
        status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
        // 7.3.3.1; stored the other way round, as 36 72 04 14 (Table 7-11).
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0020,
        // TI's advice to owners whose keys were refused; not in the datasheet.
        shows: Security::SHOWS,
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
        // 7.3.2.16.
        shown_sealed: &[(1, 58), (4, 59)],
        // Table 7-11 and a real part's image: 36 72 04 14 for keys that are sent as 14 04, 72 36; four
        // different bytes, so there is one way only. 7.3.15.2 has the authentication key at 0x4C, where it
        // would run over the block's end; the table and the image have it at 8.
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
        // No document gives it. Drivers in the field wait 5 to 30 ms; read too early, the window shows zeros or
        // the block before.
        select: Duration::from_millis(30),
        soonest: Duration::ZERO,
        // Not given either: 100 ms after a checksum is the rule for the sibling bq27545-G1 (SLUSAT0E).
        commit: Duration::from_millis(100),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        // Owners measured 150 to 175 ms; the limit is ours, power-up itself takes 250 ms (6.3).
        reset: Duration::from_millis(200),
        reset_limit: Duration::from_secs(2),
        resets: Access::RESET,
        advances: false,
    },
    // 7.3.16.3 and 8.2.2.1.3: cell voltages are compared at the internal divider's full scale of 5000.
    // 7.3.16.3 compares the limit with Voltage(); 8.2.2.1.3, where seven cells have a limit of 2800 x 7 x 5000 /
    // Voltage Divider, implies that Voltage() is scaled back to a cell's; the parameter's name says a cell's. All
    // three must hold. Without the internal 5:1 divider (7.3.8) the converter gets 5 times the voltage.
    gate: Some(Gate {
        limit: (68, 0),
        divider: Some((104, 14)),
        cell_divider: Some(5000),
        external: Some(External { byte: (64, 0), mask: 0x08, name: "[VOLTSEL]", factor: Some(5) }),
        cells: Some((64, 7)),
        calibration: Some((Source::Command(0x3A), 0x4000)),
    }),
    // 7.3.15.3 gives the sequence and no times: these are a shipped driver's for the bq27541, which has the
    // same commands.
    authentication: Some(Authentication {
        challenge: Duration::from_millis(1),
        digest: Duration::from_millis(50),
    }),
    subclasses: &SUBCLASSES,
    byte_writes_above_hz: None,
    calibration: Some(&CALIBRATION),
    signature: &[],
    volatile: None,
    quirks: &[],
    rom_image: Some(ROM_IMAGE),
    preflight: Preflight {
        pack: Some(Pack { word: Source::Command(0x28), name: "SerialNumber()", rows: &[(48, 4)] }),
        marks: &[(104, 0), (104, 4), (104, 11), (104, 12), (48, 4), (48, 6)],
        // Table 7-3.
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
        // A reset builds RAM anew from data flash (7.3.16.1), and what a cycle has counted so far is in RAM.
        // [QEN] stays set for good and [VOK] comes and goes in every pack; LearnedStatus(), Table 7-9, has
        // [ITEN] and not yet [CF1] until Qmax and Ra are learned, like Update Status 04 and 05 of Table 7-16.
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

/// Table 7-2 has the subcommands and Table 7-3 their bits; TI's tool sends BOARD_OFFSET, waits for [BCA] and [CCA],
/// and sends CC_OFFSET_SAVE. A pack that TI's tool has calibrated holds CC Delta = CC Gain x 1193046 (4 x 298261.6178,
/// TI's usual constant), which differs from Table 7-12 by 0.2 %. 7.3.8 has the divider's formula.
pub(super) static CALIBRATION: Calibration = Calibration {
    enable: 0x002D,
    enter: 0x0081,
    exit: 0x0080,
    enabled: (Source::Command(0x3A), 0x4000),
    mode: 0x1000,
    board_offset: Offset { start: 0x0009, running: 0x0C00, row: (104, 10) },
    cc_offset: Offset { start: 0x000A, running: 0x0800, row: (104, 8) },
    save: 0x000B,
    divider: (104, 14),
    gain: (104, 0),
    delta: (104, 4),
    ratio: 1_193_046.471_2,
    internal: (104, 11),
    external: (104, 12),
    thermistor: (Source::Command(0x3A), 0x0001),
};

/// Found by laying Table 7-11 over an image of firmware 0.16 (github.com/tibms/kernel-4.4,
/// drivers/power/bq34z100/bq34z100_dffs.h): all 198 rows are in their ranges there. The place of 56 is not known;
/// 107 begins with the bytes of the BQ27426's.
#[rustfmt::skip]
const ROM_IMAGE: RomImage = RomImage {
    layouts: &[(0x0016, &[
        (104, 0), (107, 49), (82, 68), (80, 85), (32, 400), (34, 406), (36, 420), (64, 447), (68, 459),
        (81, 471), (112, 482), (67, 506), (59, 507), (60, 519), (66, 521), (2, 571), (48, 602),
        (49, 662), (58, 684), (88, 768), (89, 832),
    ])],
    chemistry: (178, 400),
    // Behind the sum of instruction flash, which the image's commands show; below 0x8000 in every image.
    chemistry_sum: Some(600),
};

/// Standard commands, Table 7-1, and extended ones, Table 7-8, without the reserved 0x76 to 0x7F. The
/// poll reads 0x02 to 0x13, 0x18 to 0x1B and 0x24 to 0x2F whole, so all in there count as polled.
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
    // Table 7-8 says 10 mWh and 10 mW, the text of 7.3.2.5 and 7.3.2.6 mWh and mW: the unit is that
    // times Design Energy Scale (Table 7-15). The text has no negative power.
    Register::new(0x24, U2, "AvailableEnergy", "mWh", Poll).role(Role::EnergyNow),
    Register::new(0x26, U2, "AveragePower", "mW", Poll).role(Role::PowerAvg).of_discharges(),
    Register::new(0x28, U2, "SerialNumber", "", Poll).role(Role::SerialNumber),
    Register::new(0x2A, U2, "InternalTemperature", "0.1K", Poll),
    Register::new(0x2C, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2E, U2, "StateOfHealth", "%", Poll).role(Role::StateOfHealth),
    Register::new(0x30, U2, "ChargeVoltage", "mV", Slow).role(Role::ChargeVoltage),
    Register::new(0x32, U2, "ChargeCurrent", "mA", Slow).role(Role::ChargeCurrent),
    Register::new(0x3A, U2, "PackConfiguration", "", Static).bits(PACK_CONFIG),
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

/// Table 7-2. Key words are no subcommands and have no row, so they cannot be sent by name or code.
#[rustfmt::skip]
pub(super) static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0005, "RESET_DATA", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    // Measures and stores: with any current flowing it spoils the calibration it replaces.
    Subcommand::new(0x0009, "BOARD_OFFSET", Guarded),
    // Measures the converter's own offset; nothing is stored before CC_OFFSET_SAVE.
    Subcommand::new(0x000A, "CC_OFFSET", Allowed),
    Subcommand::new(0x000B, "CC_OFFSET_SAVE", Guarded),
    Subcommand::new(0x000C, "DF_VERSION", Answers),
    // Any message to the gauge ends FULL SLEEP.
    Subcommand::new(0x0010, "SET_FULLSLEEP", Allowed),
    Subcommand::new(0x0017, "STATIC_CHEM_DF_CHKSUM", Answers),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    // Sets [QEN] for good (7.3.1.2.15), but that is what every finished pack has: the way to start
    // gauging.
    Subcommand::new(0x0021, "IT_ENABLE", Allowed).unsealed(),
    Subcommand::new(0x002D, "CAL_ENABLE", Guarded).unsealed(),
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0080, "EXIT_CAL", Guarded).unsealed(),
    Subcommand::new(0x0081, "ENTER_CAL", Guarded).unsealed(),
    Subcommand::new(0x0082, "OFFSET_CAL", Guarded).unsealed(),
    // Not in Table 7-2. The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
    // 7.3.15.6: the gauge leaves I2C, and the way back is over HDQ.
    Subcommand::new(0x29E7, "HDQ_TO_I2C", Never),
    Subcommand::new(0x7C40, "I2C_TO_HDQ", Never),
];

/// Table 7-3.
pub(super) static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x4000, "FAS"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CALEN"),
    Bit::new(0x0800, "CCA"),
    Bit::new(0x0400, "BCA"),
    Bit::new(0x0200, "CSV"),
    Bit::new(0x0020, "FULLSLEEP"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0004, "RUP_DIS"),
    Bit::new(0x0002, "VOK"),
    Bit::new(0x0001, "QEN"),
];

/// Table 7-6.
pub(super) static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x2000, "BATHI"),
    Bit::new(0x1000, "BATLOW"),
    Bit::new(0x0800, "CHG_INH"),
    Bit::new(0x0400, "XCHG"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0080, "OCVTAKEN"),
    Bit::new(0x0010, "CF"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

/// Table 7-7.
pub(super) static FLAGS_B: &[Bit] = &[
    Bit::new(0x8000, "SOH"),
    Bit::new(0x4000, "LIFE"),
    Bit::new(0x2000, "FIRSTDOD"),
    Bit::new(0x0400, "DODEOC"),
    Bit::new(0x0200, "DTRC"),
];

/// Table 7-9.
pub(super) static LEARNED_STATUS: &[Bit] =
    &[Bit::new(0x08, "Qmax"), Bit::new(0x04, "ITEN"), Bit::new(0x02, "CF1"), Bit::new(0x01, "CF0")];

const SCALED: Bit = Bit::new(0x2000, "SCALED");

/// Table 7-17.
static PACK_CONFIG: &[Bit] = &[
    Bit::new(0x8000, "RESCAP"),
    Bit::new(0x4000, "CAL_EN"),
    SCALED,
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

/// Table 7-18.
pub(super) static PACK_CONFIG_B: &[Bit] = &[
    Bit::new(0x80, "CHGDoDEoC"),
    Bit::new(0x20, "VconsEN"),
    Bit::new(0x08, "JEITA"),
    Bit::new(0x04, "LFPRelax"),
    Bit::new(0x02, "DoDWT"),
    Bit::new(0x01, "FConvEN"),
];

/// Table 7-19.
pub(super) static PACK_CONFIG_C: &[Bit] = &[
    Bit::new(0x80, "SOH_DISP"),
    Bit::new(0x40, "RSOC_HOLD"),
    Bit::new(0x20, "FF_NEAR_EDV"),
    Bit::new(0x10, "SleepWakeCHG"),
    Bit::new(0x08, "LOCK_0"),
    Bit::new(0x04, "RELAX_JUMP_OK"),
    Bit::new(0x02, "RELAX_SMOOTH_OK"),
    Bit::new(0x01, "SMOOTH"),
];

/// Table 7-20.
pub(super) static LED_COMM: &[Bit] = &[
    Bit::new(0x80, "EXT_LED3"),
    Bit::new(0x40, "EXT_LED2"),
    Bit::new(0x20, "EXT_LED1"),
    Bit::new(0x10, "EXT_LED0"),
    Bit::new(0x08, "LED_ON"),
    Bit::new(0x04, "LED_Mode2"),
    Bit::new(0x02, "LED_Mode1"),
    Bit::new(0x01, "LED_Mode0"),
];

/// Table 7-22.
pub(super) static ALERT_CONFIG: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x2000, "BAT_HIGH"),
    Bit::new(0x1000, "BATLOW"),
    Bit::new(0x0800, "CHG_INH"),
    Bit::new(0x0400, "XCHG"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0080, "OCVTAKEN"),
    Bit::new(0x0010, "CF"),
    Bit::new(0x0004, "RCA"),
    Bit::new(0x0002, "EOD"),
    Bit::new(0x0001, "DSG"),
];

/// 7.3.8: the factor of every voltage, the flash gate's included.
pub(super) const DIVIDER: Safe = Safe::AtLeast(1, "with 0 every voltage reads 0 and flash stays shut");

/// Voltages of a cell are the pack's divided by this.
pub(super) const CELLS: Safe = Safe::AtLeast(1, "a pack has one cell at least");

/// 7.3.16.3: above the voltage the gauge would take no further write, this one's repair included.
pub(super) const GATE: Safe =
    Safe::BelowVoltage("above it the gauge would store no further data-flash write");

/// StateOfHealth() and the depth of discharge are fractions of these.
pub(super) const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// 7.3.13: LED modes from 4 on, which all have [LED_Mode2] set, move communication from I2C to HDQ or
/// are not defined.
pub(super) const KEEP_I2C: Safe = Safe::Keep(0x04, "LED_Mode 4 would move the gauge from I2C to HDQ");

/// Table 7-11.
#[rustfmt::skip]
pub(super) const SUBCLASSES: [Subclass; 22] = [
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
    Subclass { class: "Configuration", name: "Data", id: 48, length: 60, kind: Reset,
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
        P::int(30, U1, "Design Energy Scale",            0,    255,      1, "Num"),
        // Parts answer in lower case: the checksum worked out in SLUA790, 2.4 fits no other spelling.
        P::text(31, 12, "Device Name",       "BQ34Z100-G1"),
        P::text(43, 12, "Manufacturer Name", "Texas Inst."),
        P::text(55,  5, "Device Chemistry",  "LION").role(Role::Technology),
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
        P::int( 0, H2, "Pack Lot Code",     0x0000, 0xFFFF, 0x0000, "hex"),
        P::int( 2, H2, "PCB Lot Code",      0x0000, 0xFFFF, 0x0000, "hex"),
        P::int( 4, H2, "Firmware Version",  0x0000, 0xFFFF, 0x0000, "hex"),
        P::int( 6, H2, "Hardware Revision", 0x0000, 0xFFFF, 0x0000, "hex"),
        P::int( 8, H2, "Cell Revision",     0x0000, 0xFFFF, 0x0000, "hex"),
        P::int(10, H2, "DF Config Version", 0x0000, 0xFFFF, 0x0000, "hex"),
    ] },
    Subclass { class: "Configuration", name: "Lifetime Data", id: 59, length: 12, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Lifetime Max Temp",              0,  1400, 300, "0.1°C").learned(),
        P::int( 2, I2, "Lifetime Min Temp",           -600,  1400, 200, "0.1°C").learned(),
        P::int( 4, I2, "Lifetime Max Chg Current",  -32767, 32767,   0, "mA").learned(),
        P::int( 6, I2, "Lifetime Max Dsg Current",  -32767, 32767,   0, "mA").learned(),
        P::int( 8, U2, "Lifetime Max Pack Voltage",      0, 65535, 320, "20mV").learned(),
        P::int(10, U2, "Lifetime Min Pack Voltage",      0, 65535, 350, "20mV").learned(),
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
        // 7.3.3.1 has it at 48; the table is right.
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
