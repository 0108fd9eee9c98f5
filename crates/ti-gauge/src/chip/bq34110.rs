// SPDX-License-Identifier: MIT

//! bq34110: CEDV gauge for packs that are rarely discharged, of any chemistry, with a test of the
//! pack's end of service.
//!
//! TI's manual for it, SLUUBF7, was not at hand. Registers and subcommands are those on which public
//! drivers agree: Linumiz's for Zephyr (pull request 31801), one
//! for lead-acid packs and one for an underwater vehicle, both on STM32. Data flash holds the rows that
//! these drivers and owners in TI's forum (E2E) name: the manual has more.
//!
//! A row that two of them have, or that one has with its range, can be written; where no range is given
//! it is the type's. A row of one driver without a range, or placed by its neighbours or in the order of
//! a sibling, is unproven. Names of classes follow the siblings. A parameter between Design Capacity
//! mAh and Design Voltage that nobody names, and Manufacturer Info, whose address nobody gives, are left
//! out.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Plain, Reset};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, External, FLAT, Gate, Identity, KeyStorage, Mode, Parameter as P,
    Preflight, Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Signature, Source, Subclass,
    Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq34110 as its drivers know it.
pub static CHIP: Chip = Chip {
    name: "bq34110",
    model: "bq34110",
    documents: &["SLUSCI1B", "SLUA790"],
    // Bytes of real parts are known for the identity, the keys and CC Gain; the rest is the drivers'.
    evidence: &[Evidence::Drivers, Evidence::Transcript],
    // All drivers; nobody tells a firmware or hardware version.
    identity: Identity {
        device_type: 0x0110,
        firmware: &[],
        build: None,
        hardware: None,
        dm_codes: &[],
        answer: 0x40,
    },
    firmware_file: None,
    technology: "Unknown",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0x4000..0x4400, // SLUUBH1C 12.1.3
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    // Both are set while CC_OFFSET or BOARD_OFFSET runs; no driver uses another bit.
    control_status: &[Bit::new(0x0020, "CCA"), Bit::new(0x0010, "BCA")],
    // SOC Flag Config tells when [FC], [FD] and [TDA] are set. No bit tells that a battery is present.
    condition: Condition {
        full: 0x0010,          // [FC]
        low: 0x4000,           // [SOCLOW]
        critical: 0x0024,      // [FD], [TDA]
        overheat: 0x0C00,      // [OTC], [OTD]
        cold: 0x3000,          // [UTC], [UTD]
        over_voltage: 0x0200,  // [BATHIGH]
        under_voltage: 0x0100, // [BATLOW]
        present: 0,
        absent: 0,
        uncertain: 0,
        certain: 0,
        empty: 0,
        // [INITCOMP] is in OperationStatus(), and sources disagree about its place.
        complete: None,
        primary: None,
    },
    scaling: Scaling::NONE,
    security: Security {
        // OperationStatus() bits 2 and 1, as the underwater vehicle's driver reads them.
        status: SealStatus::Field { word: Source::Command(0x3A), shift: 1 },
        // Read from a part by an owner (E2E 992107) and sent by the underwater vehicle's driver.
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        // Not 0x0020 as elsewhere, which toggles [IGNORE_SD_EN] here.
        seal: 0x0030,
        // TI's advice to owners of sibling gauges whose keys were refused.
        shows: Security::SHOWS,
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
        shown_sealed: &[],
        storage: KeyStorage::Fixed(
            "it shows them at SECURITY_KEYS, and how they are written there is in no document at hand",
        ),
    },
    asks: None,
    access: Access {
        scheme: Scheme::Mac,
        // Zephyr's driver waits 1 ms, the underwater vehicle's 50 ms and then for the echo; the echo, the sum
        // and a second try are ours as well.
        select: Duration::from_millis(20),
        soonest: Duration::ZERO,
        // The longest wait of a driver that then reads back, but for the second that one waits between the sum
        // and the length, which we send together as SLUUBH1C does for the bq35100.
        commit: Duration::from_millis(300),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        // The underwater vehicle's driver looks for [INITCOMP] each second.
        reset: Duration::from_secs(1),
        reset_limit: Duration::from_secs(5),
        resets: Access::RESET,
        advances: false,
    },
    // No divider: owners whose writes were dropped had not set theirs yet, so that Voltage() itself was low
    // (E2E 834655, 797502, 846947).
    gate: Some(Gate {
        limit: (FLAT, 0x4157),
        divider: Some((FLAT, 0x4010)),
        cell_divider: None,
        external: Some(External { byte: (FLAT, 0x413D), mask: 0x10, name: "[VEN_EN]", factor: None }),
        cells: None,
        calibration: None,
    }),
    authentication: None,
    subclasses: SUBCLASSES,
    byte_writes_above_hz: None,
    // From somewhere on an owner's part had all one address lower. Each row has a first byte that its second
    // one cannot stand in for: CC Delta's exponent, which a positive
    // mantissa is not; the voltage's high byte; a coefficient of the internal sensor that nobody changes.
    calibration: None,
    signature: &[
        Signature { subclass: FLAT, offset: 0x4004, kind: H4, min: 0x8F00_0000, max: 0x977F_FFFF },
        Signature { subclass: FLAT, offset: 0x4157, kind: I2, min: 0, max: 5000 },
        Signature { subclass: FLAT, offset: 0x41C5, kind: I2, min: -12324, max: -12324 },
    ],
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        // No driver knows a serial number or a chemistry of it that could be asked while SEALED.
        pack: None,
        marks: &[(FLAT, 0x4000), (FLAT, 0x4004), (FLAT, 0x400D), (FLAT, 0x400E), (FLAT, 0x400F)],
        modes: &[
            Mode::calibration(
                Source::Answer(0x0057),
                0x8000,
                "ManufacturingStatus() [CAL_EN]",
                "leave it with the tool that entered it (CAL_TOGGLE, 0x002d)",
            ),
            Mode::measuring(0x0020, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
            Mode::measuring(0x0010, "CONTROL_STATUS [BCA]", "the board offset is being measured"),
        ],
        // CEDV: no cycle that a reset would end. What [LTEST] and its like do with one is not known.
        learning: None,
        voltage_mv: None,
    },
};

/// Standard commands. The poll reads 0x06 to 0x1B and 0x2A to 0x2F whole. One driver has RawExtTemp at
/// 0x80, where the parts of this family do not acknowledge.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "BatteryStatus", "", Poll).role(Role::Flags).bits(BATTERY_STATUS),
    Register::new(0x0C, I2, "Current", "mA", Poll).role(Role::CurrentNow),
    // In units of the user's own where Operation Config A [SCALED] is set.
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x18, U2, "TimeToFull", "min", Poll).role(Role::TimeToFullNow),
    Register::new(0x1A, I2, "AccumulatedCharge", "mAh", Poll).role(Role::ChargeCounter),
    Register::new(0x1C, U2, "AccumulatedTime", "5min", Slow),
    Register::new(0x1E, I2, "LastAccumulatedCharge", "mAh", Slow),
    Register::new(0x20, U2, "LastAccumulatedTime", "5min", Slow),
    // mW to the lead-acid driver, 10 mW to Zephyr's: a power that may be ten times too low feeds nothing.
    Register::new(0x24, I2, "AveragePower", "", Slow),
    Register::new(0x28, U2, "InternalTemperature", "0.1K", Slow),
    Register::new(0x2A, U2, "CycleCount", "Num", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "RelativeStateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U2, "StateOfHealth", "%", Poll).role(Role::StateOfHealth),
    Register::new(0x30, U2, "ChargingVoltage", "mV", Slow).role(Role::ChargeVoltage),
    Register::new(0x32, U2, "ChargingCurrent", "mA", Slow).role(Role::ChargeCurrent),
    Register::new(0x3A, U2, "OperationStatus", "", Slow).bits(OPERATION_STATUS),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U2, "ManufacturerAccessControl", "", Window),
    Register::new(0x40, U(32), "MACData", "", Window),
    Register::new(0x60, U1, "MACDataSum", "", Window),
    Register::new(0x61, U1, "MACDataLen", "", Window),
    // Its eleven flags are known by name only.
    Register::new(0x64, U2, "EOSLearnStatus", "", Slow),
    Register::new(0x68, U1, "EOSStatus", "", Slow),
    Register::new(0x79, U1, "AnalogCount", "Num", Slow),
    Register::new(0x7A, I2, "RawCurrent", "", Slow),
    Register::new(0x7C, U2, "RawVoltage", "", Slow),
    Register::new(0x7E, U2, "RawIntTemp", "0.1K", Slow),
];

/// Subcommands, from the one driver that lists them all (an ESP32 one for delivery boxes), as far as the
/// others know them with their agreement. Where nobody says that a sealed gauge takes one, it is held not
/// to. Addresses of data flash, 0x4000 to 0x43FF, are sent the same way and have no row.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0004, "IF_SUM", Answers),
    Subcommand::new(0x0005, "STATIC_DF_SUM", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    // Measures and stores: with any current flowing it spoils the calibration it replaces.
    Subcommand::new(0x0009, "BOARD_OFFSET", Guarded).unsealed(),
    Subcommand::new(0x000A, "CC_OFFSET", Allowed).unsealed(),
    Subcommand::new(0x000B, "CC_OFFSET_SAVE", Guarded).unsealed(),
    Subcommand::new(0x0010, "ALL_DF_SUM", Answers),
    Subcommand::new(0x0013, "SET_SNOOZE", Allowed).unsealed(),
    Subcommand::new(0x0014, "CLEAR_SNOOZE", Allowed).unsealed(),
    // Those that toggle a bit of ManufacturingStatus() are guarded: sent twice for a lost acknowledgement,
    // they do nothing. Mfg Status Init sets the same bits.
    Subcommand::new(0x001E, "ACCUM_DSG_EN", Guarded).unsealed(),
    Subcommand::new(0x001F, "ACCUM_CHG_EN", Guarded).unsealed(),
    Subcommand::new(0x0020, "IGNORE_SELFDSG_EN", Guarded).unsealed(),
    Subcommand::new(0x0021, "EOS_EN", Guarded).unsealed(),
    Subcommand::new(0x0022, "PIN_CONTROL_EN", Guarded).unsealed(),
    Subcommand::new(0x0023, "LIFETIME_EN", Guarded).unsealed(),
    Subcommand::new(0x0024, "WHR_EN", Guarded).unsealed(),
    Subcommand::new(0x002D, "CAL_TOGGLE", Guarded).unsealed(),
    Subcommand::new(0x0030, "SEAL", Guarded).unsealed(),
    // Both answer with keys.
    Subcommand::new(0x0035, "SECURITY_KEYS", Guarded).unsealed(),
    Subcommand::new(0x0037, "AUTHENTICATION_KEY", Guarded).unsealed(),
    Subcommand::new(0x0039, "EOS_START_LEARN", Allowed).unsealed(),
    Subcommand::new(0x003A, "EOS_ABORT_LEARN", Allowed).unsealed(),
    // Replaces what later tests are measured by.
    Subcommand::new(0x003B, "EOS_RCELL_RRATE_LEARN", Guarded).unsealed(),
    Subcommand::new(0x003C, "EOS_WARNCLR", Allowed).unsealed(),
    // Without data they read.
    Subcommand::new(0x003E, "EOS_INITIAL_RCELL", Answers).unsealed(),
    Subcommand::new(0x003F, "EOS_INITIAL_RRATE", Answers).unsealed(),
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    // The load stays on until it is taken off.
    Subcommand::new(0x0044, "EOS_LOAD_ON", Guarded).unsealed(),
    Subcommand::new(0x0045, "EOS_LOAD_OFF", Allowed).unsealed(),
    // Answers with a string.
    Subcommand::new(0x004A, "DEVICE_NAME", Answers),
    Subcommand::new(0x004B, "ACCUM_RESET", Allowed).unsealed(),
    Subcommand::new(0x0051, "EOS_SAFETY_STATUS", Answers).unsealed(),
    Subcommand::new(0x0054, "OPERATION_STATUS", Answers),
    Subcommand::new(0x0056, "GAUGING_STATUS", Answers).unsealed(),
    Subcommand::new(0x0057, "MANUFACTURING_STATUS", Answers).unsealed(),
    Subcommand::new(0x005E, "ALERT1_STATUS", Answers).unsealed(),
    Subcommand::new(0x005F, "ALERT2_STATUS", Answers).unsealed(),
    Subcommand::new(0x0060, "LT_DATA_1", Answers).unsealed(),
    // Pins, while [PCTL_EN] is set.
    Subcommand::new(0x0068, "PIN_ALERT1_SET", Allowed).unsealed(),
    Subcommand::new(0x0069, "PIN_ALERT1_RESET", Allowed).unsealed(),
    Subcommand::new(0x006A, "PIN_ALERT2_SET", Allowed).unsealed(),
    Subcommand::new(0x006B, "PIN_ALERT2_RESET", Allowed).unsealed(),
    // VEN connects the voltage divider, LEN the load.
    Subcommand::new(0x006C, "PIN_VEN_SET", Guarded).unsealed(),
    Subcommand::new(0x006D, "PIN_VEN_RESET", Guarded).unsealed(),
    Subcommand::new(0x006E, "PIN_LEN_SET", Guarded).unsealed(),
    Subcommand::new(0x006F, "PIN_LEN_RESET", Guarded).unsealed(),
    Subcommand::new(0x0070, "MANU_DATA", Answers).unsealed(),
    Subcommand::new(0x007A, "EOSSTATUS1", Answers).unsealed(),
    Subcommand::new(0x007B, "EOSSTATUS2", Answers).unsealed(),
    // The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ENTER_ROM", Never).unsealed(),
    // Nobody says what they do.
    Subcommand::new(0x22C1, "STORE_REMCAP_A", Never).unsealed(),
    Subcommand::new(0x28A0, "STORE_REMCAP_B", Never).unsealed(),
];

/// From the meanings in the lead-acid driver; short names as sibling gauges have them.
static BATTERY_STATUS: &[Bit] = &[
    Bit::new(0x4000, "SOCLOW"),
    Bit::new(0x2000, "UTC"),
    Bit::new(0x1000, "UTD"),
    Bit::new(0x0800, "OTC"),
    Bit::new(0x0400, "OTD"),
    Bit::new(0x0200, "BATHIGH"),
    Bit::new(0x0100, "BATLOW"),
    Bit::new(0x0080, "SLEEP"),
    Bit::new(0x0040, "CHGINH"),
    Bit::new(0x0020, "FD"),
    Bit::new(0x0010, "FC"),
    Bit::new(0x0008, "TCA"),
    Bit::new(0x0004, "TDA"),
    Bit::new(0x0002, "CHG"),
    Bit::new(0x0001, "DSG"),
];

/// From the underwater vehicle's driver, `[CALMD]` from the sibling bq27220. That one has `[INITCOMP]` at
/// bit 5.
static OPERATION_STATUS: &[Bit] = &[
    Bit::new(0x0200, "INITCOMP"),
    Bit::new(0x0010, "VDQ"),
    Bit::new(0x0008, "EDV2"),
    Bit::new(0x0004, "SEC1"),
    Bit::new(0x0002, "SEC0"),
    Bit::new(0x0001, "CALMD"),
];

/// The bits that subcommands 0x001E to 0x0024 toggle, in their order; four of them are confirmed by words
/// that owners wrote and read (E2E 616405).
static MFG_STATUS_INIT: &[Bit] = &[
    Bit::new(0x0040, "WHR_EN"),
    Bit::new(0x0020, "LF_EN"),
    Bit::new(0x0010, "PCTL_EN"),
    Bit::new(0x0008, "EOS_EN"),
    Bit::new(0x0004, "IGNORE_SD_EN"),
    Bit::new(0x0002, "ACCHG_EN"),
    Bit::new(0x0001, "ACDSG_EN"),
];

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

static SOC_FLAG_CONFIG_B: &[Bit] = &[
    Bit::new(0x80, "FCCLEARRSOC"),
    Bit::new(0x40, "FCSETRSOC"),
    Bit::new(0x20, "FCCLEARV"),
    Bit::new(0x10, "FCSETV"),
    Bit::new(0x08, "FDCLEARRSOC"),
    Bit::new(0x04, "FDSETRSOC"),
    Bit::new(0x02, "FDCLEARV"),
    Bit::new(0x01, "FDSETV"),
];

/// E2E 616405, and the sibling bq34210-Q1.
static EOS_CONFIG: &[Bit] =
    &[Bit::new(0x08, "LTEST"), Bit::new(0x04, "LVR"), Bit::new(0x02, "LSM"), Bit::new(0x01, "LENCTL")];

/// The factor of every voltage, the flash gate's included.
const DIVIDER: Safe = Safe::AtLeast(1, "with 0 every voltage reads 0 and flash stays shut");

/// Above the voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");

/// Charge is told as a fraction of it.
const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// By address. The underwater vehicle's driver resets first and then writes, and its settings hold: no
/// class but the one that is read at initialisation needs a reset.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Calibration", name: "Data", id: FLAT, length: 18, kind: Plain,
               parameters: &[
        // The ranges are the bq35100's, which shares rows and defaults; what lies beyond would make every
        // current wrong.
        P::float(0x4000, "CC Gain",         0.02, 10.0, 0.47095, ""),
        P::float(0x4004, "CC Delta",        29_826.2, 5_677_445.0, 567_744.6, ""),
        P::any(0x4008, I2, "CC Offset",       "").learned(),
        P::any(0x400A, I2, "AD I Offset",     "").unproven(),
        P::within(0x400C, I1, "Board Offset",    -128, 127, "").learned(),
        P::within(0x400D, I1, "Int Temp Offset", -128, 127, "0.1°C"),
        P::within(0x400E, I1, "Ext Temp Offset", -128, 127, "0.1°C").unproven(),
        P::within(0x400F, I1, "Pack V Offset",   -128, 127, "mV"),
        P::within(0x4010, U2, "Voltage Divider", 0, 65535, "mV").safe(DIVIDER),
    ] },
    Subclass { class: "Lifetimes", name: "Voltage", id: FLAT, length: 4, kind: Plain,
               parameters: &[
        P::within(0x4088, I2, "Max Pack Voltage", 0, 32767, "20mV").learned(),
        P::within(0x408A, I2, "Min Pack Voltage", 0, 32767, "20mV").learned(),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: FLAT, length: 13, kind: Plain,
               parameters: &[
        P::within(0x40C0, I2, "Learned Full Charge Capacity", 0, 32767, "mAh").learned(),
        P::any(0x40C7, I2, "Last Charge Voltage T1-T2",    "mV/cell").learned().unproven(),
        P::any(0x40C9, I2, "Last Charge Voltage T2-T3",    "mV/cell").learned().unproven(),
        P::any(0x40CB, I2, "Last Charge Voltage T3-T4",    "mV/cell").learned().unproven(),
    ] },
    Subclass { class: "Settings", name: "Manufacturing", id: FLAT, length: 2, kind: Reset,
               parameters: &[
        // Taken over at initialisation, as its name says.
        P::within(0x40D7, H2, "Mfg Status Init", 0x0000, 0x0FFF, "hex").bits(MFG_STATUS_INIT),
    ] },
    Subclass { class: "Charge", name: "Charging", id: FLAT, length: 12, kind: Plain,
               parameters: &[
        P::any(0x410E, I2, "Charging Current T1-T2", "mA").unproven(),
        P::any(0x4110, I2, "Charging Current T2-T3", "mA").unproven(),
        P::any(0x4112, I2, "Charging Current T3-T4", "mA").unproven(),
        P::any(0x4114, I2, "Charging Voltage T1-T2", "mV/cell").unproven(),
        P::any(0x4116, I2, "Charging Voltage T2-T3", "mV/cell").unproven(),
        P::any(0x4118, I2, "Charging Voltage T3-T4", "mV/cell").unproven(),
    ] },
    Subclass { class: "Charge", name: "Termination", id: FLAT, length: 9, kind: Plain,
               parameters: &[
        P::any(0x411A, I2, "Maintenance Current",    "mA").unproven(),
        P::any(0x411C, I2, "Taper Current",          "mA"),
        P::any(0x411E, I2, "Minimum Taper Capacity", "0.01mAh").unproven(),
        P::any(0x4120, I2, "Taper Voltage",          "mV"),
        // The lead-acid driver writes two bytes; sister parts have one.
        P::any(0x4122, U1, "Current Taper Window",   "s").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: FLAT, length: 4, kind: Plain,
               parameters: &[
        // Few bits of these two and of CEDV Gauging Configuration are known: naming those would lock the rest.
        P::within(0x413A, H2, "Operation Config A", 0x0000, 0xFFFF, "hex"),
        P::int(0x413D, H1, "Pin Control Config", 0x00, 0x1F, 0x00, "hex"),
    ] },
    Subclass { class: "Configuration", name: "Data", id: FLAT, length: 1, kind: Plain,
               parameters: &[
        P::within(0x4155, U1, "Number of Series Cells", 1, 100, "Num").role(Role::Cells),
    ] },
    Subclass { class: "Configuration", name: "Power", id: FLAT, length: 2, kind: Plain,
               parameters: &[
        P::int(0x4157, I2, "Flash Update OK Voltage", 0, 5000, 2800, "mV").safe(GATE),
    ] },
    Subclass { class: "Configuration", name: "Current Thresholds", id: FLAT, length: 6, kind: Plain,
               parameters: &[
        P::any(0x4162, I2, "Dsg Current Threshold", "mA").unproven(),
        P::any(0x4164, I2, "Chg Current Threshold", "mA").unproven(),
        P::any(0x4166, I2, "Quit Current",          "mA").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Accumulated Charge", id: FLAT, length: 4, kind: Plain,
               parameters: &[
        P::any(0x416C, I2, "Accumulated Charge Positive Threshold", "mAh").unproven(),
        P::any(0x416E, I2, "Accumulated Charge Negative Threshold", "mAh").unproven(),
    ] },
    Subclass { class: "Safety", name: "BATLOW", id: FLAT, length: 5, kind: Plain,
               parameters: &[
        P::any(0x4184, I2, "Battery Low Set Threshold",   "mV").unproven(),
        P::any(0x4186, U1, "Battery Low Time",            "s").unproven(),
        P::any(0x4187, I2, "Battery Low Clear Threshold", "mV").unproven(),
    ] },
    Subclass { class: "Safety", name: "SOC Low", id: FLAT, length: 2, kind: Plain,
               parameters: &[
        P::any(0x418E, U1, "SOC Low Threshold", "%").unproven(),
        P::any(0x418F, U1, "SOC Low Recovery",  "%").unproven(),
    ] },
    Subclass { class: "Charge", name: "Control", id: FLAT, length: 1, kind: Plain,
               parameters: &[
        P::any(0x4195, H1, "Direct Charge Pin Control Config", "hex").unproven(),
    ] },
    Subclass { class: "Calibration", name: "Temp Model", id: FLAT, length: 22, kind: Plain,
               parameters: &[
        // The manual has Int Coeff 3 at 0x41C5, and an owner who says so found it at 0x41C4 on his part: what
        // the signature is for. The others are spaced from it, in the order of the bq35100.
        P::within(0x41C1, I2, "Int Coeff 1",  -32768, 32767, "Num").unproven(),
        P::within(0x41C3, I2, "Int Coeff 2",  -32768, 32767, "Num").unproven(),
        P::int(0x41C5, I2, "Int Coeff 3",  -32768, 32767, -12324, "Num").unproven(),
        P::within(0x41C7, I2, "Int Coeff 4",  -32768, 32767, "Num").unproven(),
        P::any(0x41C9, I2, "Int Min AD",   "").unproven(),
        P::any(0x41CB, I2, "Int Max Temp", "").unproven(),
        P::any(0x41CD, I2, "Ext Coeff 1",  "").unproven(),
        P::any(0x41CF, I2, "Ext Coeff 2",  "").unproven(),
        P::any(0x41D1, I2, "Ext Coeff 3",  "").unproven(),
        P::any(0x41D3, I2, "Ext Coeff 4",  "").unproven(),
        P::any(0x41D5, I2, "Ext Rc0",      "").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "Design", id: FLAT, length: 6, kind: Plain,
               parameters: &[
        P::within(0x41F5, I2, "Design Capacity mAh", 0, 32767, "mAh").safe(CAPACITY),
        P::any(0x41F9, I2, "Design Voltage",      "mV"),
    ] },
    Subclass { class: "Gas Gauging", name: "SOC Flags", id: FLAT, length: 3, kind: Plain,
               parameters: &[
        // Bit names in the layout of TI's other CEDV gauges; the words that drivers write fit.
        P::within(0x41FD, H2, "SOC Flag Config A", 0x0000, 0x0FFF, "hex").bits(SOC_FLAG_CONFIG_A),
        P::within(0x41FF, H1, "SOC Flag Config B", 0x00, 0xFF, "hex").bits(SOC_FLAG_CONFIG_B),
    ] },
    Subclass { class: "EOS", name: "Configuration", id: FLAT, length: 15, kind: Plain,
               parameters: &[
        P::within(0x4218, H1, "EOS Configuration",       0x00, 0xFF, "hex").bits(EOS_CONFIG),
        P::any(0x4225, I2, "Learn Discharge Current", "mA"),
    ] },
    Subclass { class: "Gas Gauging", name: "CEDV Profile", id: FLAT, length: 46, kind: Plain,
               parameters: &[
        P::within(0x424B, H2, "CEDV Gauging Configuration", 0x0000, 0xFFFF, "hex"),
        // The order of the sister CEDV gauges fills the bytes up to Fixed EDV 0 exactly.
        P::any(0x424D, I2, "EMF",                        "").unproven(),
        P::any(0x424F, I2, "C0",                         "").unproven(),
        P::any(0x4251, I2, "R0",                         "").unproven(),
        P::any(0x4253, I2, "T0",                         "").unproven(),
        P::any(0x4255, I2, "R1",                         "").unproven(),
        P::any(0x4257, U1, "TC",                         "").unproven(),
        P::any(0x4258, U1, "C1",                         "").unproven(),
        P::any(0x4259, U1, "Age Factor",                 "").unproven(),
        // No default from here on: the drivers have some, but of another part.
        P::within(0x425A, I2, "Fixed EDV 0",                0, 32767, "mV"),
        P::any(0x425C, U1, "EDV 0 Hold Time",            "s").unproven(),
        P::within(0x425D, I2, "Fixed EDV 1",                0, 32767, "mV"),
        P::any(0x425F, U1, "EDV 1 Hold Time",            "s").unproven(),
        P::within(0x4260, I2, "Fixed EDV 2",                0, 32767, "mV"),
        P::any(0x4262, U1, "EDV 2 Hold Time",            "s").unproven(),
        P::within(0x4263, I2, "Voltage 0% DOD",             -32768, 32767, "mV/cell"),
        P::within(0x4265, I2, "Voltage 10% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4267, I2, "Voltage 20% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4269, I2, "Voltage 30% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x426B, I2, "Voltage 40% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x426D, I2, "Voltage 50% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x426F, I2, "Voltage 60% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4271, I2, "Voltage 70% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4273, I2, "Voltage 80% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4275, I2, "Voltage 90% DOD",            -32768, 32767, "mV/cell"),
        P::within(0x4277, I2, "Voltage 100% DOD",           -32768, 32767, "mV/cell"),
    ] },
    Subclass { class: "Gas Gauging", name: "CEDV Config", id: FLAT, length: 7, kind: Plain,
               parameters: &[
        P::any(0x4298, I2, "Near Full",           "mAh").unproven(),
        P::within(0x429E, U1, "RemCap Init Percent", 0, 100, "%"),
    ] },
];
