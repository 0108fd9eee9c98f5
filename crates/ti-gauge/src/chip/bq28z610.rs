// SPDX-License-Identifier: MIT

//! bq28z610: Impedance Track gauge with protector for one or two cells in series.
//!
//! Addresses move with the firmware, as SLUUA65E says itself: a telephone's part has DA Configuration where version 0.17
//! has Enabled PF B. So the table is that of version 0x0017, build 0x0016, and of no other.
//!
//! Addresses, types and names are those of SLUUA65E's table as transcribed by Oleksii Sylichenko
//! (bq28z610-arduino-driver, MIT, commit ecf755c), beside two dumps that he made of one pack. 122 rows are proven there:
//! the part holds TI's distinctive default, a text, a value that it has learned between the dumps, or one that was set by
//! its name and acted. Ranges are printed in SLUUA65E (25 rows) and in SLUUCO9A of the bq28z620 (30).
//!
//! Writable are the proven rows with a printed range that are no protection, calibration, switch of a FET or sign of
//! the layout, and the texts. The rest is read-only; what could open FETs, switch a protection off or mislead a charger
//! is never written.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never};
use super::Kind::Plain;
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, FLAT, Gate, Identity, KeyStorage, Mode, Parameter as P,
    Preflight, Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Signature, Source, Subclass,
    Subcommand,
};
use crate::codec::{Float, Layout, Order};
use crate::date;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2, U4};
use gauge_bus::GAUGE_ADDRESS;

/// OperationStatus().
const OPERATION_STATUS: u16 = 0x0054;

/// The bq28z610 with firmware 0.17.
pub static CHIP: Chip = Chip {
    name: "bq28z610",
    model: "bq28z610",
    documents: &["SLUUA65E", "SLUUCO9A"],
    evidence: &[
        Evidence::Sibling,
        Evidence::Drivers,
        Evidence::Transcript,
        Evidence::Image,
        Evidence::Kernel,
    ],
    // As the transcription's author prints them from the part of the dumps.
    identity: Identity {
        device_type: 0x2610,
        firmware: &[0x0017],
        build: Some(0x0016),
        hardware: None,
        dm_codes: &[],
        answer: 0x40,
    },
    firmware_file: None,
    technology: "Li-ion",
    address: GAUGE_ADDRESS,
    // Both dumps: 0x4000 holds 87 2F, 0x4006 7B 09 ED 3F, and Capacity Gain divided by it is as in the defaults.
    layout: Layout { order: Order::Little, float: Float::Ieee },
    // Data flash goes on to 0x5FFF; behind the last row are copies that the part makes for itself.
    flat: 0x4000..0x4729,
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: OPERATION_BITS,
    // SLUUA65E 12.1.6.
    condition: Condition {
        full: 0x0020, // [FC]
        low: 0,
        critical: 0x0010, // [FD]
        overheat: 0x1000, // [OTA]
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
    security: Security {
        // SLUUA65E 12.2.30. Bits 14 and 13 of Control() show FULL ACCESS as 00, against the manual (E2E 791892).
        status: SealStatus::Field { word: Source::Answer(OPERATION_STATUS), shift: 8 },
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0030,
        // The transcription's author waits 1 s after the second word, and calls that necessary.
        shows: Duration::from_millis(1200),
        // As its relatives'; no document at hand has it.
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
        shown_sealed: &[],
        storage: KeyStorage::Fixed(
            "it takes them at SECURITY_KEYS, and no transcript shows how the part answers",
        ),
    },
    asks: None,
    access: Access {
        scheme: Scheme::Mac,
        // The author's driver waits 5 ms; echo, sum and a second try are ours as well.
        select: Duration::from_millis(20),
        soonest: Duration::ZERO,
        // The author's driver waits 200 ms.
        commit: Duration::from_millis(300),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        // Drivers wait 0.5 s.
        reset: Duration::from_secs(1),
        reset_limit: Duration::from_secs(5),
        // No write needs it, and it is never sent.
        resets: 0x0012,
        // SLUUCO9A and the manuals of other relatives say so of a read from 0x3E to 0x61.
        advances: true,
    },
    // In a relative's manual (SLUUCO0) the voltage of the stack. The part of the dumps has two cells and 6000 mV.
    gate: Some(Gate {
        limit: (FLAT, 0x460A),
        divider: None,
        cell_divider: None,
        external: None,
        cells: None,
        calibration: None,
    }),
    calibration: None,
    authentication: None,
    subclasses: SUBCLASSES,
    byte_writes_above_hz: None,
    // None of them is ever written. The first distinguishes an empty chemistry, the last two are TI's coefficients.
    signature: &[
        Signature { subclass: FLAT, offset: 0x4063, kind: H2, min: 0x0001, max: 0xFFFE },
        Signature { subclass: FLAT, offset: 0x462E, kind: I2, min: 6000, max: 9000 },
        Signature { subclass: FLAT, offset: 0x45BE, kind: I2, min: 4000, max: 8000 },
        Signature { subclass: FLAT, offset: 0x4400, kind: I2, min: -12143, max: -12143 },
        Signature { subclass: FLAT, offset: 0x441A, kind: I2, min: 11703, max: 11703 },
    ],
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        // Nothing that a sealed gauge shows is known to differ from pack to pack.
        pack: None,
        marks: &[
            (FLAT, 0x4000),
            (FLAT, 0x4002),
            (FLAT, 0x4004),
            (FLAT, 0x4006),
            (FLAT, 0x4014),
            (FLAT, 0x4015),
        ],
        modes: &[
            Mode::calibration(
                Source::Answer(0x0057),
                0x8000,
                "ManufacturingStatus() [CAL_EN]",
                "leave it with the tool that entered it",
            ),
            Mode {
                word: Source::Status,
                mask: 0x1000,
                name: "OperationStatus() [PF]",
                what: "the pack is in PERMANENT FAILURE",
                remedy: "have it examined before anything is written",
                ours: false,
                slip: None,
            },
        ],
        // A reset would end a cycle, and no write sends one.
        learning: None,
        voltage_mv: None,
    },
};

/// SLUUA65E 12.1, as far as the transcription's author and the kernel's driver read them. In a relative's manual
/// (SLUUCO0) AveragePower() is in mW, in SLUUA65E in cW.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "BatteryStatus", "", Poll).role(Role::Flags).bits(BATTERY_STATUS),
    Register::new(0x0C, I2, "Current", "mA", Poll).role(Role::CurrentNow),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x18, U2, "TimeToFull", "min", Poll).role(Role::TimeToFullNow),
    Register::new(0x22, I2, "AveragePower", "cW", Poll).role(Role::PowerAvg).step(10, 1),
    Register::new(0x2A, U2, "CycleCount", "Num", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "RelativeStateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U2, "StateOfHealth", "%", Poll).role(Role::StateOfHealth),
    Register::new(0x30, U2, "ChargingVoltage", "mV", Slow).role(Role::ChargeVoltage),
    Register::new(0x32, U2, "ChargingCurrent", "mA", Slow).role(Role::ChargeCurrent),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U2, "AltManufacturerAccess", "", Window),
    Register::new(0x40, U(32), "MACData", "", Window),
    Register::new(0x60, U1, "MACDataSum", "", Window),
    Register::new(0x61, U1, "MACDataLen", "", Window),
];

/// SLUUA65E 12.2, as far as the author's driver has them, and the family's. Sums (0x0004, 0x0005, 0x0008, 0x0009) are
/// left out: their answers come after 250 ms. Where nobody says that a sealed gauge takes one, it is held not to.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0006, "CHEM_ID", Answers),
    Subcommand::new(0x0010, "SHUTDOWN", Never).unsealed(),
    // While the gauge starts its FETs may be off.
    Subcommand::new(0x0012, "RESET", Never).unsealed(),
    // These switch FETs.
    Subcommand::new(0x001F, "CHG_FET", Never).unsealed(),
    Subcommand::new(0x0020, "DSG_FET", Never).unsealed(),
    Subcommand::new(0x0021, "GAUGING", Guarded).unsealed(),
    Subcommand::new(0x0022, "FET_CONTROL", Never).unsealed(),
    // These erase what a pack has lived through.
    Subcommand::new(0x0028, "LIFETIME_DATA_RESET", Never).unsealed(),
    Subcommand::new(0x0029, "PF_DATA_RESET", Never).unsealed(),
    Subcommand::new(0x0030, "SEAL", Guarded).unsealed(),
    Subcommand::new(0x0035, "SECURITY_KEYS", Guarded).unsealed(),
    Subcommand::new(0x0050, "SAFETY_ALERT", Answers).unsealed(),
    Subcommand::new(0x0051, "SAFETY_STATUS", Answers).unsealed(),
    Subcommand::new(0x0052, "PF_ALERT", Answers).unsealed(),
    Subcommand::new(0x0053, "PF_STATUS", Answers).unsealed(),
    Subcommand::new(OPERATION_STATUS, "OPERATION_STATUS", Answers),
    Subcommand::new(0x0055, "CHARGING_STATUS", Answers).unsealed(),
    Subcommand::new(0x0056, "GAUGING_STATUS", Answers).unsealed(),
    Subcommand::new(0x0057, "MANUFACTURING_STATUS", Answers).unsealed(),
    // The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ENTER_ROM", Never).unsealed(),
];

/// SLUUA65E 12.1.6. The lowest four bits are an error code.
static BATTERY_STATUS: &[Bit] = &[
    Bit::new(0x8000, "OCA"),
    Bit::new(0x4000, "TCA"),
    Bit::new(0x1000, "OTA"),
    Bit::new(0x0800, "TDA"),
    Bit::new(0x0200, "RCA"),
    Bit::new(0x0100, "RTA"),
    Bit::new(0x0080, "INIT"),
    Bit::new(0x0040, "DSG"),
    Bit::new(0x0020, "FC"),
    Bit::new(0x0010, "FD"),
];

/// SLUUA65E 12.2.30, the lower word.
static OPERATION_BITS: &[Bit] = &[
    Bit::new(0x8000, "SLEEP"),
    Bit::new(0x4000, "XCHG"),
    Bit::new(0x2000, "XDSG"),
    Bit::new(0x1000, "PF"),
    Bit::new(0x0800, "SS"),
    Bit::new(0x0400, "SDV"),
    Bit::new(0x0200, "SEC1"),
    Bit::new(0x0100, "SEC0"),
    Bit::new(0x0080, "BTP_INT"),
    Bit::new(0x0004, "CHG"),
    Bit::new(0x0002, "DSG"),
];

const PROTECTION: &str = "it belongs to the pack's protection";
const RECORD: &str = "it is the part's own record";
const CALIBRATION: &str = "the board was calibrated with it";
const LAYOUT: &str = "by it the layout of data flash is recognised";
const SWITCHES: &str = "its bits switch FETs and modes, and not all of them are known";
const CHARGES: &str = "a charger and the charge FET follow it, and no source prints its range";
const SWITCHES_OFF: &str = "with a wrong value the part switches itself off";

/// Above the voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");
/// The limit is our own: SLUUCO9A allows 0 to 255.
const SAMPLING: Safe = Safe::Within(1, 20, "a sleeping gauge protects the pack only as often as it measures");
/// SLUUCO0: "should not be longer".
const OFF_FIRST: Safe = Safe::Under(0x461C, 0, "FETs are to be off before the part shuts down");
const SHIP_LATER: Safe = Safe::Over(0x461B, 0, "FETs are to be off before the part shuts down");
const EMPTY: &str = "the flag of an empty pack is cleared above the charge at which it is set";
const FULL: &str = "the flag of a full pack is cleared below the value at which it is set";

// What shows that a row is where it is.
const BLANK: &str = "as transcribed; 0 or erased in the dumps";
const BLANK_PRINTED: &str = "as transcribed; 0 or erased in the dumps; range: SLUUA65E";
const BLANK_SISTER: &str = "as transcribed; 0 or erased in the dumps; range: SLUUCO9A";
const DEFAULT: &str = "as transcribed; the dumps hold TI's default";
const DEFAULT_OTHERS: &str = "as transcribed; the dumps hold TI's default; range: manuals of relatives";
const DEFAULT_PRINTED: &str = "as transcribed; the dumps hold TI's default; range: SLUUA65E";
const DEFAULT_SISTER: &str = "as transcribed; the dumps hold TI's default; range: SLUUCO9A";
const LEARNED: &str = "as transcribed; it has changed between the dumps as a learned table does";
const MOVED: &str = "as transcribed; learned, and plausible in both dumps";
const PLAUSIBLE: &str = "as transcribed; both dumps hold what such a pack can have";
const PLAUSIBLE_PRINTED: &str = "as transcribed; both dumps hold what such a pack can have; range: SLUUA65E";
const PLAUSIBLE_SISTER: &str = "as transcribed; both dumps hold what such a pack can have; range: SLUUCO9A";
const RATIO_PRINTED: &str =
    "as transcribed; the quotient of both gains is that of TI's defaults; range: SLUUA65E";
const SET: &str = "as transcribed; its author has set it by its name, and it acted";
const SET_OTHERS: &str =
    "as transcribed; its author has set it by its name, and it acted; range: manuals of relatives";
const SET_PRINTED: &str = "as transcribed; its author has set it by its name, and it acted; range: SLUUA65E";
const SET_SISTER: &str = "as transcribed; its author has set it by its name, and it acted; range: SLUUCO9A";
const TEXT: &str = "as transcribed; a text in the dumps";

/// By address. Classes that lie in several places have a group for each.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Calibration", name: "Voltage", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x4000, I2, "Cell Gain", -32767, 32767, 12101, "").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
        P::int(0x4002, U2, "Pack Gain", 0, 65535, 49669, "").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
        P::int(0x4004, U2, "BAT Gain", 0, 65535, 48936, "").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
    ] },
    Subclass { class: "Calibration", name: "Current", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::float(0x4006, "CC Gain", 0.1, 4.0, 3.58422, "").never(CALIBRATION).by(RATIO_PRINTED),
        P::float(0x400A, "Capacity Gain", 29_826.2, 1_193_046.0, 1_069_035.256, "").never(CALIBRATION).by(RATIO_PRINTED),
    ] },
    Subclass { class: "Calibration", name: "Current Offset", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x400E, I2, "CC Offset", -32767, 32767, 0, "").never(CALIBRATION).by(BLANK_PRINTED),
        P::int(0x4010, U2, "Coulomb Counter Offset Samples", 0, 65535, 64, "").never(CALIBRATION).by(DEFAULT_PRINTED),
        P::int(0x4012, I2, "Board Offset", -32768, 32767, 0, "").never(CALIBRATION).by(BLANK_PRINTED),
    ] },
    Subclass { class: "Calibration", name: "Temperature", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::int(0x4014, I1, "Internal Temp Offset", -128, 127, 0, "0.1°C").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
        P::int(0x4015, I1, "External1 Temp Offset", -128, 127, 0, "0.1°C").never(CALIBRATION).by(PLAUSIBLE_SISTER),
    ] },
    Subclass { class: "System Data", name: "Manufacturer Data", id: FLAT, length: 32, kind: Plain, parameters: &[
        P::any(0x4041, H1, "Manufacturer Info Block A01", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4042, H1, "Manufacturer Info Block A02", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4043, H1, "Manufacturer Info Block A03", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4044, H1, "Manufacturer Info Block A04", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4045, H1, "Manufacturer Info Block A05", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4046, H1, "Manufacturer Info Block A06", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4047, H1, "Manufacturer Info Block A07", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4048, H1, "Manufacturer Info Block A08", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4049, H1, "Manufacturer Info Block A09", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404A, H1, "Manufacturer Info Block A10", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404B, H1, "Manufacturer Info Block A11", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404C, H1, "Manufacturer Info Block A12", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404D, H1, "Manufacturer Info Block A13", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404E, H1, "Manufacturer Info Block A14", "hex").unproven().by(PLAUSIBLE),
        P::any(0x404F, H1, "Manufacturer Info Block A15", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4050, H1, "Manufacturer Info Block A16", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4051, H1, "Manufacturer Info Block A17", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4052, H1, "Manufacturer Info Block A18", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4053, H1, "Manufacturer Info Block A19", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4054, H1, "Manufacturer Info Block A20", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4055, H1, "Manufacturer Info Block A21", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4056, H1, "Manufacturer Info Block A22", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4057, H1, "Manufacturer Info Block A23", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4058, H1, "Manufacturer Info Block A24", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4059, H1, "Manufacturer Info Block A25", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405A, H1, "Manufacturer Info Block A26", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405B, H1, "Manufacturer Info Block A27", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405C, H1, "Manufacturer Info Block A28", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405D, H1, "Manufacturer Info Block A29", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405E, H1, "Manufacturer Info Block A30", "hex").unproven().by(PLAUSIBLE),
        P::any(0x405F, H1, "Manufacturer Info Block A31", "hex").unproven().by(PLAUSIBLE),
        P::any(0x4060, H1, "Manufacturer Info Block A32", "hex").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "System Data", name: "Integrity", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x4061, H2, "Static DF Signature", "hex").never(RECORD).by(BLANK),
        P::any(0x4063, H2, "Static Chem DF Signature", "hex").never(LAYOUT).by(PLAUSIBLE),
        P::any(0x4065, H2, "All DF Signature", "hex").never(RECORD).by(BLANK),
    ] },
    Subclass { class: "I2C Configuration", name: "Data", id: FLAT, length: 51, kind: Plain, parameters: &[
        P::any(0x4067, U2, "Manufacture Date", date::UNIT).unproven().by(PLAUSIBLE),
        P::any(0x4069, H2, "Serial Number", "hex").unproven().by(PLAUSIBLE),
        P::text(0x406B, 21, "Manufacturer Name", "").no_default().by(TEXT),
        P::text(0x4080, 21, "Device Name", "").no_default().by(TEXT),
        P::text(0x4095, 5, "Device Chemistry", "").no_default().by(TEXT),
    ] },
    Subclass { class: "Calibration", name: "Current Offset", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::int(0x40C0, H1, "CC Auto Config", 0x00, 0x07, 0x03, "hex").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
        P::int(0x40C1, I2, "CC Auto Offset", -10000, 10000, 0, "").never(CALIBRATION).by(PLAUSIBLE_PRINTED),
    ] },
    Subclass { class: "Ra Table", name: "R_a0", id: FLAT, length: 32, kind: Plain, parameters: &[
        P::any(0x4100, H2, "Cell0 R_a flag", "hex").learned().unproven().by(BLANK),
        P::any(0x4102, I2, "Cell0 R_a 0", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4104, I2, "Cell0 R_a 1", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4106, I2, "Cell0 R_a 2", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4108, I2, "Cell0 R_a 3", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x410A, I2, "Cell0 R_a 4", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x410C, I2, "Cell0 R_a 5", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x410E, I2, "Cell0 R_a 6", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4110, I2, "Cell0 R_a 7", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4112, I2, "Cell0 R_a 8", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4114, I2, "Cell0 R_a 9", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4116, I2, "Cell0 R_a 10", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4118, I2, "Cell0 R_a 11", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x411A, I2, "Cell0 R_a 12", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x411C, I2, "Cell0 R_a 13", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x411E, I2, "Cell0 R_a 14", "2^-10 Ω").learned().unproven().by(LEARNED),
    ] },
    Subclass { class: "Ra Table", name: "R_a1", id: FLAT, length: 32, kind: Plain, parameters: &[
        P::any(0x4140, H2, "Cell1 R_a flag", "hex").learned().unproven().by(BLANK),
        P::any(0x4142, I2, "Cell1 R_a 0", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4144, I2, "Cell1 R_a 1", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4146, I2, "Cell1 R_a 2", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4148, I2, "Cell1 R_a 3", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x414A, I2, "Cell1 R_a 4", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x414C, I2, "Cell1 R_a 5", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x414E, I2, "Cell1 R_a 6", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4150, I2, "Cell1 R_a 7", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4152, I2, "Cell1 R_a 8", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4154, I2, "Cell1 R_a 9", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4156, I2, "Cell1 R_a 10", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4158, I2, "Cell1 R_a 11", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x415A, I2, "Cell1 R_a 12", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x415C, I2, "Cell1 R_a 13", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x415E, I2, "Cell1 R_a 14", "2^-10 Ω").learned().unproven().by(LEARNED),
    ] },
    Subclass { class: "Ra Table", name: "R_a0x", id: FLAT, length: 32, kind: Plain, parameters: &[
        P::any(0x4180, H2, "xCell0 R_a flag", "hex").learned().unproven().by(PLAUSIBLE),
        P::any(0x4182, I2, "xCell0 R_a 0", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4184, I2, "xCell0 R_a 1", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4186, I2, "xCell0 R_a 2", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4188, I2, "xCell0 R_a 3", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x418A, I2, "xCell0 R_a 4", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x418C, I2, "xCell0 R_a 5", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x418E, I2, "xCell0 R_a 6", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4190, I2, "xCell0 R_a 7", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4192, I2, "xCell0 R_a 8", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4194, I2, "xCell0 R_a 9", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4196, I2, "xCell0 R_a 10", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x4198, I2, "xCell0 R_a 11", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x419A, I2, "xCell0 R_a 12", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x419C, I2, "xCell0 R_a 13", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x419E, I2, "xCell0 R_a 14", "2^-10 Ω").learned().unproven().by(LEARNED),
    ] },
    Subclass { class: "Ra Table", name: "R_a1x", id: FLAT, length: 32, kind: Plain, parameters: &[
        P::any(0x41C0, H2, "xCell1 R_a flag", "hex").learned().unproven().by(PLAUSIBLE),
        P::any(0x41C2, I2, "xCell1 R_a 0", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41C4, I2, "xCell1 R_a 1", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41C6, I2, "xCell1 R_a 2", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41C8, I2, "xCell1 R_a 3", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41CA, I2, "xCell1 R_a 4", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41CC, I2, "xCell1 R_a 5", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41CE, I2, "xCell1 R_a 6", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41D0, I2, "xCell1 R_a 7", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41D2, I2, "xCell1 R_a 8", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41D4, I2, "xCell1 R_a 9", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41D6, I2, "xCell1 R_a 10", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41D8, I2, "xCell1 R_a 11", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41DA, I2, "xCell1 R_a 12", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41DC, I2, "xCell1 R_a 13", "2^-10 Ω").learned().unproven().by(LEARNED),
        P::any(0x41DE, I2, "xCell1 R_a 14", "2^-10 Ω").learned().unproven().by(LEARNED),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x4200, I2, "Design Resistance", "mΩ").unproven().by(PLAUSIBLE),
        P::int(0x4202, I2, "Pack Resistance", 0, 32767, 30, "mΩ").by(DEFAULT_PRINTED),
        P::int(0x4204, I2, "System Resistance", 0, 32767, 0, "mΩ").unproven().by(BLANK_PRINTED),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: FLAT, length: 60, kind: Plain, parameters: &[
        P::any(0x4206, I2, "Qmax Cell 1", "mAh").learned().unproven().by(MOVED),
        P::any(0x4208, I2, "Qmax Cell 2", "mAh").learned().unproven().by(MOVED),
        P::any(0x420A, I2, "Qmax Pack", "mAh").learned().unproven().by(MOVED),
        P::any(0x420C, U2, "Qmax Cycle Count", "").learned().unproven().by(MOVED),
        P::any(0x420E, H1, "Update Status", "hex").learned().unproven().by(PLAUSIBLE),
        P::any(0x420F, I2, "Cell 1 Chg Voltage at EoC", "mV").learned().unproven().by(MOVED),
        P::any(0x4211, I2, "Cell 2 Chg Voltage at EoC", "mV").learned().unproven().by(MOVED),
        P::any(0x4213, I2, "Current at EoC", "mA").learned().unproven().by(MOVED),
        P::any(0x4215, I2, "Avg I Last Run", "mA").learned().unproven().by(MOVED),
        P::any(0x4217, I2, "Avg P Last Run", "cW").learned().unproven().by(MOVED),
        P::any(0x4219, I2, "Delta Voltage", "mV").learned().unproven().by(MOVED),
        P::any(0x421B, I2, "Temp k", "").learned().unproven().by(MOVED),
        P::any(0x421D, I2, "Temp a", "").learned().unproven().by(MOVED),
        P::any(0x421F, I2, "Max Avg I Last Run", "mA").learned().unproven().by(MOVED),
        P::any(0x4221, I2, "Max Avg P Last Run", "cW").learned().unproven().by(MOVED),
        P::any(0x4240, U2, "Cycle Count", "").learned().unproven().by(MOVED),
    ] },
    Subclass { class: "Lifetimes", name: "Voltage", id: FLAT, length: 4, kind: Plain, parameters: &[
        P::any(0x4280, I2, "Cell 1 Max Voltage", "mV").learned().unproven().by(PLAUSIBLE),
        P::any(0x4282, I2, "Cell 2 Max Voltage", "mV").learned().unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Lifetimes", name: "Current", id: FLAT, length: 4, kind: Plain, parameters: &[
        P::any(0x4284, I2, "Max Charge Current", "mA").learned().unproven().by(PLAUSIBLE),
        P::any(0x4286, I2, "Max Discharge Current", "mA").learned().unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Lifetimes", name: "Temperature", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x4288, I1, "Max Temp Cell", "°C").learned().unproven().by(PLAUSIBLE),
        P::any(0x4289, I1, "Min Temp Cell", "°C").learned().unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "Device Status Data", id: FLAT, length: 26, kind: Plain, parameters: &[
        P::any(0x42C0, H1, "Safety Alert A", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C1, H1, "Safety Status A", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C2, H1, "Safety Alert B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C3, H1, "Safety Status B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C4, H1, "Safety Alert C", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C5, H1, "Safety Status C", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C6, H1, "Safety Alert D", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C7, H1, "Safety Status D", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C8, H1, "PF Alert A", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42C9, H1, "PF Status A", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42CA, H1, "PF Alert B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42CB, H1, "PF Status B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42CF, H1, "PF Status D", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42D0, H2, "Operation Status A", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42D2, H2, "Operation Status B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42D4, H1, "Temp Range", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42D5, H1, "Charging Status A", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42D6, H1, "Charging Status B", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42D7, H1, "Gauging Status", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42D8, H2, "IT Status", "hex").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "Device Voltage Data", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x42DA, I2, "Cell 1 Voltage", "mV").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42DC, I2, "Cell 2 Voltage", "mV").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42DE, I2, "Battery Direct Voltage", "mV").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42E0, I2, "Pack Voltage", "mV").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "Device Current Data", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x42E2, I2, "Current", "mA").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "Device Temperature Data", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x42E4, I2, "Internal Temperature", "0.1K").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42E6, I2, "External 1 Temperature", "0.1K").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42E8, I2, "External 2 Temperature", "0.1K").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "Device Gauging Data", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x42EA, I2, "Cell 1 Dod0", "").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42EC, I2, "Cell 2 Dod0", "").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42EE, I2, "Passed Charge", "").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "PF Status", name: "AFE Regs", id: FLAT, length: 21, kind: Plain, parameters: &[
        P::any(0x42F0, H1, "AFE Interrupt Status", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F1, H1, "AFE FET Status", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42F2, H1, "AFE RXIN", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F3, H1, "AFE Latch Status", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F4, H1, "AFE Interrupt Enable", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42F5, H1, "AFE FET Control", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F6, H1, "AFE RXIEN", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F7, H1, "AFE RLOUT", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42F8, H1, "AFE RHOUT", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42F9, H1, "AFE RHINT", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42FA, H1, "AFE Cell Balance", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42FB, H1, "AFE AD/CC Control", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42FC, H1, "AFE ADC Mux", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x42FD, H1, "AFE LED Output", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42FE, H1, "AFE State Control", "hex").learned().never(RECORD).by(BLANK),
        P::any(0x42FF, H1, "AFE LED/Wake Control", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x4300, H1, "AFE Protection Control", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x4301, H1, "AFE OCD", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x4302, H1, "AFE SCC", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x4303, H1, "AFE SCD1", "hex").learned().never(RECORD).by(PLAUSIBLE),
        P::any(0x4304, H1, "AFE SCD2", "hex").learned().never(RECORD).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Manufacturing", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x43C0, H2, "Mfg Status init", "hex").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Calibration", name: "Internal Temp Model", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::int(0x4400, I2, "Int Gain", -32768, 32767, -12143, "").never(LAYOUT).by(DEFAULT_SISTER),
        P::int(0x4402, I2, "Int base offset", -32768, 32767, 6232, "").never(CALIBRATION).by(DEFAULT_SISTER),
        P::int(0x4404, I2, "Int Minimum AD", -32768, 32767, 0, "").never(CALIBRATION).by(BLANK_SISTER),
        P::any(0x4406, I2, "Int Maximum Temp", "").never(CALIBRATION).by(DEFAULT),
    ] },
    Subclass { class: "Calibration", name: "Cell Temperature Model", id: FLAT, length: 26, kind: Plain, parameters: &[
        P::any(0x4408, I2, "Coeff a1", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x440A, I2, "Coeff a2", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x440C, I2, "Coeff a3", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x440E, I2, "Coeff a4", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x4410, I2, "Coeff a5", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x4412, I2, "Coeff b1", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x4414, I2, "Coeff b2", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x4416, I2, "Coeff b3", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x4418, I2, "Coeff b4", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x441A, I2, "Rc0", "").never(LAYOUT).by(DEFAULT),
        P::any(0x441C, I2, "Adc0", "").never(CALIBRATION).by(DEFAULT),
        P::any(0x441E, I2, "Rpad", "").never(CALIBRATION).by(BLANK),
        P::any(0x4420, I2, "Rint", "").never(CALIBRATION).by(BLANK),
    ] },
    Subclass { class: "Calibration", name: "Current Deadband", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x4446, U1, "Deadband", "mA").never(CALIBRATION).by(PLAUSIBLE),
        P::any(0x4447, U1, "Coulomb Counter Deadband", "mA").never(CALIBRATION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: FLAT, length: 10, kind: Plain, parameters: &[
        P::int(0x458E, U2, "Ra Filter", 0, 999, 500, "0.1%").unproven().by(PLAUSIBLE_PRINTED),
        P::int(0x4591, U1, "Ra Max Delta", 0, 255, 15, "%").by(DEFAULT_PRINTED),
        P::int(0x4594, U2, "Resistance Parameter Filter", 1, 65534, 65142, "").by(DEFAULT_PRINTED),
        P::int(0x4596, U2, "Near EDV Ra Param Filter", 1, 65535, 59220, "").unproven().by(DEFAULT_OTHERS),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: FLAT, length: 44, kind: Plain, parameters: &[
        P::int(0x45BC, U1, "Qmax Delta", 3, 100, 5, "").unproven().by(DEFAULT_OTHERS),
        P::int(0x45BD, U1, "Qmax Upper Bound", 100, 255, 130, "").unproven().by(DEFAULT_OTHERS),
        P::any(0x45BE, I2, "Term Voltage", "mV").never(LAYOUT).by(PLAUSIBLE),
        P::any(0x45C0, U1, "Term V Hold Time", "s").unproven().by(PLAUSIBLE),
        P::any(0x45C1, I2, "Term Voltage Delta", "mV").unproven().by(PLAUSIBLE),
        P::any(0x45C3, I2, "Term Min Cell V", "mV").unproven().by(PLAUSIBLE),
        P::any(0x45CC, U1, "Max Simulation Iterations", "").unproven().by(PLAUSIBLE),
        P::any(0x45DD, U1, "Fast Scale Start SOC", "").unproven().by(PLAUSIBLE),
        P::any(0x45E6, I2, "Min Delta Voltage", "mV").unproven().by(BLANK),
    ] },
    Subclass { class: "Gas Gauging", name: "SoH", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x45E8, U1, "SoH Load Rate", "").unproven().by(BLANK),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x4600, H1, "FET Options", 0x00, 0xFF, 0x20, "flags").never(SWITCHES).by(SET_PRINTED),
        P::int(0x4601, H1, "I2C Gauging Configuration", 0x00, 0x0F, 0x04, "flags").never(SWITCHES).by(PLAUSIBLE_PRINTED),
        P::any(0x4602, H1, "I2C Configuration", "hex").never(SWITCHES).by(BLANK),
        P::any(0x4604, H1, "Power Config", "hex").never(SWITCHES).by(BLANK),
        P::any(0x4605, H1, "IO Config", "hex").never(SWITCHES).by(BLANK),
    ] },
    Subclass { class: "Settings", name: "BTP", id: FLAT, length: 4, kind: Plain, parameters: &[
        P::any(0x4606, I2, "Init Discharge Set", "").never(SWITCHES).by(PLAUSIBLE),
        P::any(0x4608, I2, "Init Charge Set", "").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Power", name: "Power", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x460A, I2, "Valid Update Voltage", "mV").unproven().safe(GATE).by(PLAUSIBLE),
    ] },
    Subclass { class: "Power", name: "Shutdown", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x460C, I2, "Shutdown Voltage", "mV").never(SWITCHES_OFF).by(PLAUSIBLE),
        P::any(0x460E, U1, "Shutdown Time", "s").never(SWITCHES_OFF).by(PLAUSIBLE),
        P::any(0x460F, I2, "Charger Present Threshold", "mV").never(SWITCHES_OFF).by(PLAUSIBLE),
    ] },
    Subclass { class: "Power", name: "Sleep", id: FLAT, length: 10, kind: Plain, parameters: &[
        P::int(0x4611, I2, "Sleep Current", 0, 32767, 10, "mA").unproven().by(PLAUSIBLE_SISTER),
        P::any(0x4613, U1, "Bus Timeout", "s").unproven().by(PLAUSIBLE),
        P::int(0x4618, U1, "Voltage Time", 0, 255, 5, "s").safe(SAMPLING).by(DEFAULT_SISTER),
        P::int(0x4619, U1, "Current Time", 0, 255, 20, "s").safe(SAMPLING).by(DEFAULT_SISTER),
        P::int(0x461A, H1, "Wake Comparator", 0x00, 0xFF, 0x00, "flags").unproven().by(BLANK_SISTER),
    ] },
    Subclass { class: "Power", name: "Ship", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::int(0x461B, U1, "FET Off Time", 0, 127, 10, "s").safe(OFF_FIRST).by(DEFAULT_SISTER),
        P::int(0x461C, U1, "Delay", 0, 254, 20, "s").safe(SHIP_LATER).by(DEFAULT_SISTER),
    ] },
    Subclass { class: "Gas Gauging", name: "Standby", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x461D, I2, "StandbyCurrent", "mA").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "Max Load", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x461F, I2, "Max Load Current", "mA").unproven().by(PLAUSIBLE),
        P::any(0x4621, U1, "Max Load Rsoc", "%").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Power", name: "Ship", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x4622, U2, "Auto Ship Time", "").never(SWITCHES_OFF).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Charger", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x4624, H1, "Device Address", "hex").never(SWITCHES).by(PLAUSIBLE),
        P::any(0x4625, H1, "Voltage Register", "hex").never(SWITCHES).by(PLAUSIBLE),
        P::any(0x4626, H1, "Current Register", "hex").never(SWITCHES).by(PLAUSIBLE),
        P::any(0x4629, U1, "Broadcast Pacing", "").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "Design", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::within(0x462A, I2, "Design Capacity mAh", 100, 32767, "mAh").unproven().by(SET_OTHERS),
        P::any(0x462C, I2, "Design Capacity cWh", "cWh").unproven().by(SET),
        P::any(0x462E, I2, "Design Voltage", "mV").never(LAYOUT).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "Cycle", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x4630, U1, "Cycle Count Percentage", "%").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x4632, H2, "SOC Flag Config A", "hex").never(SWITCHES).by(SET),
        P::any(0x4634, H1, "SOC Flag Config B", "hex").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "FD", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x4635, I2, "Set Voltage Threshold", "mV").unproven().by(PLAUSIBLE),
        P::any(0x4637, I2, "Clear Voltage Threshold", "mV").unproven().by(PLAUSIBLE),
        P::any(0x4639, U1, "Set % RSOC Threshold", "%").unproven().by(BLANK),
        P::any(0x463A, U1, "Clear % RSOC Threshold", "%").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "FC", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x463B, I2, "Set Voltage Threshold", "mV").unproven().by(PLAUSIBLE),
        P::any(0x463D, I2, "Clear Voltage Threshold", "mV").unproven().by(PLAUSIBLE),
        P::any(0x463F, U1, "Set % RSOC Threshold", "%").unproven().by(PLAUSIBLE),
        P::any(0x4640, U1, "Clear % RSOC Threshold", "%").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "TD", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x4641, I2, "Set Voltage Threshold", 0, 5000, 3200, "mV").unproven().by(PLAUSIBLE_SISTER),
        P::int(0x4643, I2, "Clear Voltage Threshold", 0, 5000, 3300, "mV").unproven().by(PLAUSIBLE_SISTER),
        P::int(0x4645, U1, "Set % RSOC Threshold", 0, 100, 6, "%").safe(Safe::Under(0x4646, 1, EMPTY)).by(DEFAULT_SISTER),
        P::int(0x4646, U1, "Clear % RSOC Threshold", 0, 100, 8, "%").safe(Safe::Over(0x4645, 1, EMPTY)).by(DEFAULT_SISTER),
    ] },
    Subclass { class: "Gas Gauging", name: "TC", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x4647, I2, "Set Voltage Threshold", 0, 5000, 4200, "mV").safe(Safe::Over(0x4649, 1, FULL)).by(DEFAULT_SISTER),
        P::int(0x4649, I2, "Clear Voltage Threshold", 0, 5000, 4100, "mV").safe(Safe::Under(0x4647, 1, FULL)).by(DEFAULT_SISTER),
        P::int(0x464B, U1, "Set % RSOC Threshold", 0, 100, 100, "%").safe(Safe::Over(0x464C, 1, FULL)).by(SET_SISTER),
        P::int(0x464C, U1, "Clear % RSOC Threshold", 0, 100, 95, "%").safe(Safe::Under(0x464B, 1, FULL)).by(SET_SISTER),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x464D, H2, "IT Gauging Configuration", "hex").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: FLAT, length: 10, kind: Plain, parameters: &[
        P::any(0x4651, U1, "Load Select", "").unproven().by(PLAUSIBLE),
        P::any(0x4652, U1, "Load Mode", "").unproven().by(PLAUSIBLE),
        P::any(0x4653, I2, "User Rate-mA", "mA").unproven().by(BLANK),
        P::any(0x4655, I2, "User Rate-cW", "cW").unproven().by(BLANK),
        P::any(0x4657, I2, "Reserve Cap-mAh", "mAh").unproven().by(BLANK),
        P::any(0x4659, I2, "Reserve Cap-cWh", "cWh").unproven().by(BLANK),
    ] },
    Subclass { class: "Gas Gauging", name: "Smoothing", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x465B, I2, "Smooth Relax Time", "s").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x465E, H1, "Charging Configuration", "hex").never(SWITCHES).by(BLANK),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Temperature Ranges", id: FLAT, length: 7, kind: Plain, parameters: &[
        P::any(0x465F, I1, "T1 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4660, I1, "T2 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4661, I1, "T5 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4662, I1, "T6 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4663, I1, "T3 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4664, I1, "T4 Temp", "°C").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4665, I1, "Hysteresis Temp", "°C").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Low Temp Charging", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x4666, I2, "Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4668, I2, "Current Low", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x466A, I2, "Current Med", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x466C, I2, "Current High", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Standard Temp Charging", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x466E, I2, "Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4670, I2, "Current Low", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4672, I2, "Current Med", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4674, I2, "Current High", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "High Temp Charging", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x4676, I2, "Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4678, I2, "Current Low", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x467A, I2, "Current Med", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x467C, I2, "Current High", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Rec Temp Charging", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x467E, I2, "Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4680, I2, "Current Low", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4682, I2, "Current Med", "mA").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4684, I2, "Current High", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Pre-Charging", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x4686, I2, "Current", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Maintenance Charging", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x4688, I2, "Current", "mA").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Voltage Range", id: FLAT, length: 9, kind: Plain, parameters: &[
        P::any(0x468A, I2, "Precharge Start Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x468C, I2, "Charging Voltage Low", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x468E, I2, "Charging Voltage Med", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4690, I2, "Charging Voltage High", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4692, U1, "Charging Voltage Hysteresis", "mV").never(CHARGES).by(BLANK),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Termination Config", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::within(0x4693, I2, "Charge Term Taper Current", 0, 32767, "mA").unproven().by(SET_OTHERS),
        P::any(0x4697, I2, "Charge Term Voltage", "mV").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x469A, H1, "Temperature Enable", "hex").never(SWITCHES).by(PLAUSIBLE),
        P::any(0x469B, H1, "DA Configuration", "hex").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "AFE", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x469D, H1, "AFE Protection Control", "hex").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "AOLD", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::int(0x469E, H1, "Threshold", 0x00, 0xFF, 0xF4, "hex").never(PROTECTION).by(PLAUSIBLE_SISTER),
    ] },
    Subclass { class: "Protections", name: "ASCC", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x469F, H1, "Threshold", "hex").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "ASCD", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x46A0, H1, "Threshold 1", "hex").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46A1, H1, "Threshold 2", "hex").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "AFE", id: FLAT, length: 2, kind: Plain, parameters: &[
        P::any(0x46A3, I2, "ZVCHG Exit Threshold", "mV").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::any(0x46A6, I2, "Dsg Current Threshold", "mA").unproven().by(PLAUSIBLE),
        P::any(0x46A8, I2, "Chg Current Threshold", "mA").unproven().by(PLAUSIBLE),
        P::any(0x46AA, I2, "Quit Current", "mA").unproven().by(PLAUSIBLE),
        P::any(0x46AC, U1, "Dsg Relax Time", "s").unproven().by(PLAUSIBLE),
        P::any(0x46AD, U1, "Chg Relax Time", "s").unproven().by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Protection", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::int(0x46AE, H1, "Protection Configuration", 0x00, 0xFF, 0x00, "flags").never(PROTECTION).by(PLAUSIBLE_SISTER),
        P::int(0x46AF, H1, "Enabled Protections A", 0x00, 0xFF, 0x57, "flags").never(PROTECTION).by(PLAUSIBLE_SISTER),
        P::int(0x46B0, H1, "Enabled Protections B", 0x00, 0xFF, 0x35, "flags").never(PROTECTION).by(DEFAULT_SISTER),
        P::int(0x46B1, H1, "Enabled Protections C", 0x00, 0xFF, 0x3C, "flags").never(PROTECTION).by(PLAUSIBLE_SISTER),
        P::int(0x46B2, H1, "Enabled Protections D", 0x00, 0xFF, 0x0C, "flags").never(PROTECTION).by(DEFAULT_SISTER),
    ] },
    Subclass { class: "Protections", name: "CUV", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x46B3, I2, "Threshold", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46B5, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46B6, I2, "Recovery", "mV").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "COV", id: FLAT, length: 17, kind: Plain, parameters: &[
        P::any(0x46B8, I2, "Threshold Low Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46BA, I2, "Threshold Standard Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46BC, I2, "Threshold High Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46BE, I2, "Threshold Rec Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46C0, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46C1, I2, "Recovery Low Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46C3, I2, "Recovery Standard Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46C5, I2, "Recovery High Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46C7, I2, "Recovery Rec Temp", "mV").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "OCC", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::int(0x46C9, I2, "Threshold", -32768, 32767, 6000, "mA").never(PROTECTION).by(SET_SISTER),
        P::int(0x46CB, U1, "Delay", 0, 255, 0, "s").never(PROTECTION).by(PLAUSIBLE_SISTER),
        P::int(0x46CC, I2, "Recovery Threshold", -32768, 32767, 200, "mA").never(PROTECTION).by(PLAUSIBLE_SISTER),
        P::int(0x46CE, U1, "Recovery Delay", 0, 255, 5, "s").never(PROTECTION).by(PLAUSIBLE_SISTER),
    ] },
    Subclass { class: "Protections", name: "OCD", id: FLAT, length: 6, kind: Plain, parameters: &[
        P::any(0x46CF, I2, "Threshold", "mA").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46D1, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46D2, I2, "Recovery Threshold", "mA").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46D4, U1, "Recovery Delay", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "AOLD", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::int(0x46D5, U1, "Recovery", 0, 255, 5, "s").never(PROTECTION).by(PLAUSIBLE_SISTER),
    ] },
    Subclass { class: "Protections", name: "ASCC", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x46D6, U1, "Recovery", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "ASCD", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x46D7, U1, "Recovery", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "OTC", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x46D8, I2, "Threshold", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46DA, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46DB, I2, "Recovery", "0.1°C").never(PROTECTION).by(SET),
    ] },
    Subclass { class: "Protections", name: "OTD", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x46DD, I2, "Threshold", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46DF, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46E0, I2, "Recovery", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "UTC", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x46E2, I2, "Threshold", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46E4, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46E5, I2, "Recovery", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "UTD", id: FLAT, length: 5, kind: Plain, parameters: &[
        P::any(0x46E7, I2, "Threshold", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46E9, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46EA, I2, "Recovery", "0.1°C").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Protections", name: "PTO", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::int(0x46EC, I2, "Charge Threshold", -32768, 32767, 2000, "mA").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46EE, I2, "Suspend Threshold", -32768, 32767, 1800, "mA").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46F0, U2, "Delay", 0, 65535, 1800, "s").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46F2, I2, "Reset", -32768, 32767, 2, "mAh").never(PROTECTION).by(DEFAULT_PRINTED),
    ] },
    Subclass { class: "Protections", name: "CTO", id: FLAT, length: 8, kind: Plain, parameters: &[
        P::int(0x46F4, I2, "Charge Threshold", -32768, 32767, 2500, "mA").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46F6, I2, "Suspend Threshold", -32768, 32767, 2000, "mA").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46F8, U2, "Delay", 0, 65535, 54000, "s").never(PROTECTION).by(PLAUSIBLE_PRINTED),
        P::int(0x46FA, I2, "Reset", -32768, 32767, 2, "mAh").never(PROTECTION).by(DEFAULT_PRINTED),
    ] },
    Subclass { class: "Settings", name: "Permanent Failure", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x46FC, H1, "Enabled PF A", "hex").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x46FD, H1, "Enabled PF B", "hex").never(PROTECTION).by(BLANK),
        P::any(0x46FE, H1, "Enabled PF C", "hex").never(PROTECTION).by(BLANK),
    ] },
    Subclass { class: "Permanent Fail", name: "SOV", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x4700, I2, "Threshold", "mV").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x4702, U1, "Delay", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Permanent Fail", name: "CFET", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x4703, I2, "OFF Threshold", "").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x4705, U1, "OFF Delay", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Permanent Fail", name: "DFET", id: FLAT, length: 3, kind: Plain, parameters: &[
        P::any(0x4706, I2, "OFF Threshold", "").never(PROTECTION).by(PLAUSIBLE),
        P::any(0x4708, U1, "OFF Delay", "s").never(PROTECTION).by(PLAUSIBLE),
    ] },
    Subclass { class: "Settings", name: "Configuration", id: FLAT, length: 1, kind: Plain, parameters: &[
        P::any(0x470A, H1, "Balancing Configuration", "hex").never(SWITCHES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Advanced Charge Algorithm", name: "Cell Balancing Config", id: FLAT, length: 10, kind: Plain, parameters: &[
        P::any(0x470B, U2, "Bal Time/mAh Cell 1", "").never(CHARGES).by(PLAUSIBLE),
        P::any(0x470D, U2, "Bal Time/mAh Cell 2", "").never(CHARGES).by(PLAUSIBLE),
        P::any(0x470F, U1, "Min Start Balance Delta", "mV").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4710, U4, "Relax Balance Interval", "s").never(CHARGES).by(PLAUSIBLE),
        P::any(0x4714, U1, "Min Rsoc for Balancing", "%").never(CHARGES).by(PLAUSIBLE),
    ] },
    Subclass { class: "Permanent Fail", name: "VIMR", id: FLAT, length: 9, kind: Plain, parameters: &[
        P::any(0x4715, I2, "Check Voltage", "mV").never(PROTECTION).by(BLANK),
        P::any(0x4717, I2, "Check Current", "mA").never(PROTECTION).by(BLANK),
        P::any(0x4719, I2, "Delta Threshold", "").never(PROTECTION).by(BLANK),
        P::any(0x471B, U1, "Delta Delay", "s").never(PROTECTION).by(BLANK),
        P::any(0x471C, U2, "Duration", "").never(PROTECTION).by(BLANK),
    ] },
    Subclass { class: "Permanent Fail", name: "VIMA", id: FLAT, length: 7, kind: Plain, parameters: &[
        P::any(0x471E, I2, "Check Voltage", "mV").never(PROTECTION).by(BLANK),
        P::any(0x4720, I2, "Check Current", "mA").never(PROTECTION).by(BLANK),
        P::any(0x4722, I2, "Delta Threshold", "").never(PROTECTION).by(BLANK),
        P::any(0x4724, U1, "Delta Delay", "s").never(PROTECTION).by(BLANK),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: FLAT, length: 4, kind: Plain, parameters: &[
        P::any(0x4725, I2, "SOH Temp k", "").learned().unproven().by(BLANK),
        P::any(0x4727, I2, "SOH Temp a", "").learned().unproven().by(BLANK),
    ] },
];
