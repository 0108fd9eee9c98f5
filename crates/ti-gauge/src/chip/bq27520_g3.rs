// SPDX-License-Identifier: MIT

//! bq27520-G3: Impedance Track gauge on the system side, for one Li-ion cell.
//!
//! No data-flash table of this generation could be read. Rows that independent drivers for it agree on,
//! or one driver and a document of TI's, are proven; a row of one driver alone is not (48/24, 49/0, 64/8, 9,
//! 12 and 13). Rows that stand at one place both in its ancestor, the bq27500-V130 (SLUS914A, Table
//! 4-7), and in a shipped image of its successor, the bq27520-G4, very likely stand there in between: they
//! and what follows from less are marked unproven.
//!
//! Offsets did move in between: Terminate Voltage is at 80/48, 80/45 and 80/55 in the three. So rows of
//! only one sibling are left out, 43 that are a guess here and 21 of the bq27520-G4's that would overlap
//! or stand behind the first that moved, and three classes without an address (OCV tables 83 and 84,
//! Temp Model 106).

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Plain, Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, Gate, Identity, KeyBlock, KeyOrder, KeyStorage, Mode, Pack,
    Parameter as P, Preflight, Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Signature,
    Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27520-G3 as far as it is known.
pub static CHIP: Chip = Chip {
    name: "bq27520-g3",
    model: "bq27520-G3",
    documents: &["SLUSAP0", "SLUSAB7A, of the bq27520-G2", "SLUS914A (December 2009), of the bq27500-V130"],
    evidence: &[Evidence::Sibling, Evidence::Drivers, Evidence::Kernel],
    // All generations have one type; the firmware, which can be exchanged in the field, tells them apart.
    identity: Identity {
        device_type: 0x0520,
        firmware: &[0x0324],
        build: None,
        hardware: None,
        dm_codes: &[],
        answer: 0x00,
    },
    // bq_bqfs_g3.h of github.com/pelotoncycle/opensource-quartz (firmware 3.24, whole).
    firmware_file: Some(super::FirmwareFile { name: 670, names: &["bq27520"] }),
    technology: "Li-ion",
    address: GAUGE_ADDRESS,
    layout: Layout::TI,
    flat: 0..0,
    registers: REGISTERS,
    subcommands: SUBCOMMANDS,
    control_status: CONTROL_STATUS,
    // [OTC] and [OTD] are all there is about temperature.
    condition: Condition {
        full: 0x0200,     // [FC]
        low: 0x0004,      // [SOC1]
        critical: 0x0002, // [SYSDOWN]
        overheat: 0xC000, // [OTC], [OTD]
        cold: 0,
        over_voltage: 0,
        under_voltage: 0,
        present: 0x0008, // [BAT_DET]
        absent: 0,
        uncertain: 0,
        certain: 0,
        empty: 0,
        complete: Some((Source::Status, 0x0080)), // [INITCOMP]
        primary: None,
    },
    scaling: Scaling::NONE,
    security: Security {
        status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0x4000 },
        // SLUS914A, Table 4-7; drivers for this part send the same. Products do change it.
        default_unseal: [0x0414, 0x3672],
        full_access: true,
        seal: 0x0020,
        // TI's advice to owners whose keys were refused.
        shows: Security::SHOWS,
        key_silence: Duration::from_millis(5200),
        seals_itself: None,
        // SLUS914A 4.1.2.3.
        shown_sealed: &[(1, 57)],
        // SLUS914A 4.5: the bytes are entered the other way round than they lie in data flash, Key 1 first.
        // It has an authentication key in no source.
        storage: KeyStorage::Flash(KeyBlock {
            subclass: 112,
            start: 0,
            length: 8,
            unseal: 0,
            full_access: 4,
            authentication: None,
            order: KeyOrder::Reversed,
        }),
    },
    asks: None,
    access: Access {
        scheme: Scheme::Block,
        // A shipped OMAP4 kernel driver for this part; no document gives it.
        select: Duration::from_millis(50),
        soonest: Duration::ZERO,
        // SLUS914A 7.3.
        commit: Duration::from_millis(100),
        enter: Duration::ZERO,
        enter_limit: Duration::ZERO,
        // The kernel's driver; the limit is ours.
        reset: Duration::from_millis(300),
        reset_limit: Duration::from_secs(2),
        resets: Access::RESET,
        advances: false,
    },
    gate: Some(Gate {
        limit: (68, 0),
        divider: None,
        cell_divider: None,
        external: None,
        cells: None,
        calibration: None,
    }),
    // Known of the relative with firmware 1.30 only (SLUS914A 4.1.2.3).
    authentication: None,
    subclasses: SUBCLASSES,
    // The rule of the family, SLUSBH1C 9.5.4.3.
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: SIGNATURE,
    volatile: None,
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        pack: Some(Pack { word: Source::Answer(0x0008), name: "Control(CHEM_ID)", rows: &[] }),
        marks: &[(104, 0), (104, 4), (104, 11), (104, 12), (104, 13)],
        // No bit shows CAL_MODE.
        modes: &[
            Mode::measuring(0x0800, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
            Mode::measuring(0x0400, "CONTROL_STATUS [BCA]", "the board offset is being measured"),
        ],
        // [VOK] and [QEN] are set in finished products too, and where Update Status stands is not sure.
        learning: None,
        voltage_mv: None,
    },
};

/// Values that a pack can have, at places that hold something else where offsets moved: Terminate
/// Voltage's would be 4 with the bq27520-G4's. The transient factors are 128 before and after this
/// generation, and no product is known to change them.
#[rustfmt::skip]
static SIGNATURE: &[Signature] = &[
    Signature::new(34,  2, I2, 3000,  4600), // Charging Voltage
    Signature::new(48, 10, I2,    1, 32767), // Design Capacity
    Signature::new(68,  0, I2,    0,  4200), // Flash Update OK Voltage
    Signature::new(80, 45, I2, 2000,  4200), // Terminate Voltage
    Signature::new(81, 10, U1,  128,   128), // Transient Factor Charge
    Signature::new(81, 11, U1,  128,   128), // Transient Factor Discharge
];

/// Standard commands, SLUSAP0 and SLUSAB7A. The poll reads 0x06 to 0x17 and 0x22 to 0x31 whole, so all
/// in there count as polled. The kernel's driver has no TimeToFull() at 0x18 in this generation, and
/// DeviceName() at 0x62 is the ancestor's: no rows. Reads above 0x6B are not acknowledged.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, I2, "AtRate", "mA", Slow),
    Register::new(0x04, U2, "AtRateTimeToEmpty", "min", Slow),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0E, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x1A, I2, "StandbyCurrent", "mA", Slow),
    Register::new(0x1C, U2, "StandbyTimeToEmpty", "min", Slow),
    Register::new(0x1E, I2, "MaxLoadCurrent", "mA", Slow),
    Register::new(0x20, U2, "MaxLoadTimeToEmpty", "min", Slow),
    Register::new(0x22, U2, "AvailableEnergy", "mWh", Poll).role(Role::EnergyNow),
    Register::new(0x24, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x26, U2, "TTEatConstantPower", "min", Poll).role(Role::TimeToEmptyAvg),
    // One command of two bytes, a percentage and what stands behind it.
    Register::new(0x28, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x29),
    Register::new(0x29, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U2, "NormalizedImpedanceCal", "mΩ", Poll),
    Register::new(0x30, I2, "InstantaneousCurrent", "mA", Poll).role(Role::CurrentNow),
    Register::new(0x32, U2, "DataLogIndex", "", Slow),
    Register::new(0x34, U2, "DataLogBuffer", "", Slow),
    Register::new(0x36, U2, "InternalTemperature", "0.1K", Slow),
    Register::new(0x3A, U2, "OperationConfiguration", "", Slow).bits(OP_CONFIG),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
    Register::new(0x6A, U1, "ApplicationStatus", "", Slow).bits(APPLICATION_STATUS),
];

/// SLUSAB7A's table. RESET_DATA (0x0005) and IF_CHECKSUM (0x0022) are the ancestor's and have no row, nor
/// have key words. The codes are not those of the bq274xx: 0x0013 is SET_CFGUPDATE there.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0003, "HW_VERSION", Answers),
    Subcommand::new(0x0004, "DF_CHECKSUM", Answers).unsealed(),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    // Measures and stores: with any current flowing it spoils the calibration it replaces.
    Subcommand::new(0x0009, "BOARD_OFFSET", Guarded).unsealed(),
    // Measures only; nothing is stored before WRITE_CC_OFFSET.
    Subcommand::new(0x000A, "CC_INT_OFFSET", Allowed).unsealed(),
    Subcommand::new(0x000B, "WRITE_CC_OFFSET", Guarded).unsealed(),
    Subcommand::new(0x000C, "OCV_CMD", Allowed),
    Subcommand::new(0x000D, "BAT_INSERT", Allowed),
    Subcommand::new(0x000E, "BAT_REMOVE", Allowed),
    Subcommand::new(0x0011, "SET_HIBERNATE", Allowed),
    Subcommand::new(0x0012, "CLEAR_HIBERNATE", Allowed),
    Subcommand::new(0x0013, "SET_SLEEP+", Allowed),
    Subcommand::new(0x0014, "CLEAR_SLEEP+", Allowed),
    // All that the gauge has learned of its cell is gone.
    Subcommand::new(0x0015, "FACTORY_RESTORE", Never).unsealed(),
    // What the log writes, and how often, is not documented.
    Subcommand::new(0x0018, "ENABLE_DLOG", Guarded),
    Subcommand::new(0x0019, "DISABLE_DLOG", Guarded),
    Subcommand::new(0x001F, "DF_VERSION", Answers),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    // What every finished product has: the way to start gauging.
    Subcommand::new(0x0021, "IT_ENABLE", Allowed).unsealed(),
    Subcommand::new(0x0023, "IT_DISABLE", Guarded).unsealed(),
    Subcommand::new(0x0040, "CAL_MODE", Guarded).unsealed(),
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    // In no table. The gauge leaves 0x55 and answers as a flash programmer at 0x0B.
    Subcommand::new(0x0F00, "ROM_MODE", Never).unsealed(),
];

/// SLUSAB7A.
static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x8000, "DLOGEN"),
    Bit::new(0x4000, "FAS"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CSV"),
    Bit::new(0x0800, "CCA"),
    Bit::new(0x0400, "BCA"),
    Bit::new(0x0200, "OCVCMDCOMP"),
    Bit::new(0x0100, "OCVFAIL"),
    Bit::new(0x0080, "INITCOMP"),
    Bit::new(0x0040, "HIBERNATE"),
    Bit::new(0x0020, "SNOOZE"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0004, "RUP_DIS"),
    Bit::new(0x0002, "VOK"),
    Bit::new(0x0001, "QEN"),
];

/// SLUSAB7A; SYSDOWN is SOCF in the ancestor.
static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OTC"),
    Bit::new(0x4000, "OTD"),
    Bit::new(0x0800, "CHG_INH"),
    Bit::new(0x0400, "XCHG"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0020, "OCV_GD"),
    Bit::new(0x0010, "WAIT_ID"),
    Bit::new(0x0008, "BAT_DET"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SYSDOWN"),
    Bit::new(0x0001, "DSG"),
];

/// The profile in use.
static APPLICATION_STATUS: &[Bit] = &[Bit::new(0x01, "LU_PROF")];

/// SLUSAP0, page 26, and a shipped driver for all generations (FIH's).
static OP_CONFIG: &[Bit] = &[
    Bit::new(0x8000, "RESCAP"),
    Bit::new(0x4000, "BATG_OVR"),
    Bit::new(0x2000, "INT_BREM"),
    Bit::new(0x1000, "PFC_CFG1"),
    Bit::new(0x0800, "PFC_CFG0"),
    Bit::new(0x0400, "IWAKE"),
    Bit::new(0x0200, "RSNS1"),
    Bit::new(0x0100, "RSNS0"),
    Bit::new(0x0080, "INT_FOCV"),
    Bit::new(0x0040, "IDSELEN"),
    Bit::new(0x0020, "SLEEP"),
    Bit::new(0x0010, "RMFCC"),
    Bit::new(0x0008, "SOCI_POL"),
    Bit::new(0x0004, "BATG_POL"),
    Bit::new(0x0002, "BATL_POL"),
    Bit::new(0x0001, "TEMPS"),
];

/// SLUSAP0, page 26, and a shipped driver for all generations (FIH's).
static OP_CONFIG_B: &[Bit] = &[
    Bit::new(0x80, "WRTEMP"),
    Bit::new(0x40, "BIE"),
    Bit::new(0x20, "BL_INT"),
    Bit::new(0x10, "GNDSEL"),
    Bit::new(0x08, "FCE"),
    Bit::new(0x04, "DFWRINDBL"),
    Bit::new(0x02, "RFACTSTEP"),
    Bit::new(0x01, "INDFACRES"),
];

/// SLUSAP0, page 26, and a shipped driver for all generations (FIH's).
static OP_CONFIG_C: &[Bit] = &[
    Bit::new(0x80, "BATGSPUEN"),
    Bit::new(0x40, "BATGWPUEN"),
    Bit::new(0x20, "BATLSPUEN"),
    Bit::new(0x10, "BATLWPUEN"),
    Bit::new(0x04, "SLPWKCHG"),
    Bit::new(0x02, "DELTAVOPT1"),
    Bit::new(0x01, "DELTAVOPT0"),
];

/// The shipped driver alone.
static OP_CONFIG_D: &[Bit] = &[
    Bit::new(0x80, "RCJUMPOK"),
    Bit::new(0x40, "SMTHEN"),
    Bit::new(0x20, "SOC_STATE"),
    Bit::new(0x10, "SOC_OCV"),
    Bit::new(0x08, "SOC_DFW"),
    Bit::new(0x04, "SOC_OT"),
    Bit::new(0x02, "CHGDODEOC"),
];

/// Above the present voltage the gauge would take no further write, this one's repair included.
const GATE: Safe = Safe::BelowVoltage("above it the gauge would store no further data-flash write");

/// StateOfHealth() and the depth of discharge are fractions of it.
const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// The signature's limits: beyond them no further write would be let through.
const TERMINATE: Safe = Safe::Within(2000, 4200, "the layout of data flash is recognised by it");

/// An encoded resistance profile: two bytes of flags, then steps from one grid point to the next.
#[rustfmt::skip]
static DEFAULT_RA: &[P] = &[
    P::any( 0, H1, "Byte 0",  "hex").unproven(),
    P::any( 1, H1, "Byte 1",  "hex").unproven(),
    P::any( 2, H1, "Byte 2",  "hex").unproven(),
    P::any( 3, H1, "Byte 3",  "hex").unproven(),
    P::any( 4, H1, "Byte 4",  "hex").unproven(),
    P::any( 5, H1, "Byte 5",  "hex").unproven(),
    P::any( 6, H1, "Byte 6",  "hex").unproven(),
    P::any( 7, H1, "Byte 7",  "hex").unproven(),
    P::any( 8, H1, "Byte 8",  "hex").unproven(),
    P::any( 9, H1, "Byte 9",  "hex").unproven(),
    P::any(10, H1, "Byte 10", "hex").unproven(),
    P::any(11, H1, "Byte 11", "hex").unproven(),
    P::any(12, H1, "Byte 12", "hex").unproven(),
    P::any(13, H1, "Byte 13", "hex").unproven(),
    P::any(14, H1, "Byte 14", "hex").unproven(),
    P::any(15, H1, "Byte 15", "hex").unproven(),
    P::any(16, H1, "Byte 16", "hex").unproven(),
    P::any(17, H1, "Byte 17", "hex").unproven(),
    P::any(18, H1, "Byte 18", "hex").unproven(),
];

/// A resistance profile as the gauge has learned it, encoded like the default one.
#[rustfmt::skip]
static LEARNED_RA: &[P] = &[
    P::any( 0, H1, "Byte 0",  "hex").learned().unproven(),
    P::any( 1, H1, "Byte 1",  "hex").learned().unproven(),
    P::any( 2, H1, "Byte 2",  "hex").learned().unproven(),
    P::any( 3, H1, "Byte 3",  "hex").learned().unproven(),
    P::any( 4, H1, "Byte 4",  "hex").learned().unproven(),
    P::any( 5, H1, "Byte 5",  "hex").learned().unproven(),
    P::any( 6, H1, "Byte 6",  "hex").learned().unproven(),
    P::any( 7, H1, "Byte 7",  "hex").learned().unproven(),
    P::any( 8, H1, "Byte 8",  "hex").learned().unproven(),
    P::any( 9, H1, "Byte 9",  "hex").learned().unproven(),
    P::any(10, H1, "Byte 10", "hex").learned().unproven(),
    P::any(11, H1, "Byte 11", "hex").learned().unproven(),
    P::any(12, H1, "Byte 12", "hex").learned().unproven(),
    P::any(13, H1, "Byte 13", "hex").learned().unproven(),
    P::any(14, H1, "Byte 14", "hex").learned().unproven(),
    P::any(15, H1, "Byte 15", "hex").learned().unproven(),
    P::any(16, H1, "Byte 16", "hex").learned().unproven(),
    P::any(17, H1, "Byte 17", "hex").learned().unproven(),
    P::any(18, H1, "Byte 18", "hex").learned().unproven(),
];

/// SLUS914A, Table 4-7, in its order, with what drivers for this part say otherwise.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    Subclass { class: "Configuration", name: "Safety", id: 2, length: 10, kind: Reset,
               parameters: &[
        P::int(0, I2, "OT Chg",          0, 1200, 550, "0.1°C").unproven(),
        P::int(2, U1, "OT Chg Time",     0,   60,   2, "s").unproven(),
        P::int(3, I2, "OT Chg Recovery", 0, 1200, 500, "0.1°C").unproven(),
        P::int(5, I2, "OT Dsg",          0, 1200, 600, "0.1°C").unproven(),
        P::int(7, U1, "OT Dsg Time",     0,   60,   2, "s").unproven(),
        P::int(8, I2, "OT Dsg Recovery", 0, 1200, 550, "0.1°C").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Charge Inhibit Config", id: 32, length: 6, kind: Reset,
               parameters: &[
        P::int(0, I2, "Charge Inhibit Temp Low",  -400, 1200,   0, "0.1°C").unproven(),
        P::int(2, I2, "Charge Inhibit Temp High", -400, 1200, 450, "0.1°C").unproven(),
        P::int(4, I2, "Temp Hys",                    0,  100,  50, "0.1°C").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Charge", id: 34, length: 10, kind: Reset,
               parameters: &[
        P::int(2, I2, "Charging Voltage",     0, 20000, 4200, "mV").unproven(),
        P::int(4, I2, "Delta Temp",           0,   500,   50, "0.1°C").unproven(),
        P::int(6, I2, "Suspend Low Temp",  -400,  1200,  -50, "0.1°C").unproven(),
        P::int(8, I2, "Suspend High Temp", -400,  1200,  550, "0.1°C").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Charge Termination", id: 36, length: 13, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Taper Current",         0, 1000, 100, "mA").unproven(),
        P::int( 2, I2, "Minimum Taper Charge",  0, 1000,  25, "0.01mAh").unproven(),
        P::int( 4, I2, "Taper Voltage",         0, 1000, 100, "mV").unproven(),
        P::int( 6, U1, "Current Taper Window",  0,   60,  40, "s").unproven(),
        // Here and at 36/11 the G4's image alone; the ancestor leaves gaps.
        P::int( 7, I1, "TCA Set %",            -1,  100,   0, "%").no_default().unproven(),
        P::int( 8, I1, "TCA Clear %",          -1,  100,   0, "%").no_default().unproven(),
        P::int( 9, I1, "FC Set %",             -1,  100, 100, "%").unproven(),
        P::int(10, I1, "FC Clear %",           -1,  100,  98, "%").unproven(),
        P::any(11, I2, "DODatEOC Delta T", "0.1°C").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Data", id: 48, length: 26, kind: Reset,
               parameters: &[
        P::int( 4, I1, "Initial Standby Current",    -128,     0,  -10, "mA").unproven(),
        P::int( 5, I2, "Initial Max Load Current", -32767,     0, -500, "mA").unproven(),
        P::int( 7, I2, "CC Threshold",                100, 32767,  900, "mAh").unproven(),
        // The ancestor prints 65535 for the maximum of this signed word.
        P::int(10, I2, "Design Capacity",               0, 32767, 1000, "mAh").safe(CAPACITY),
        // A shipped driver keeps a version of its own here, low byte first.
        P::within(24, U2, "DF Version", 0, 65535, "hex").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: 49, length: 10, kind: Reset,
               parameters: &[
        // A word in the G4; what follows it is a guess in this generation and left out up to 49/5.
        P::int(0, U1, "SOC1 Set Threshold",           0, 255, 150, "mAh").unprinted().unproven(),
        // Limits are printed nowhere.
        P::any(5, I2, "SysDown Set Volt Threshold", "mV").unproven(),
        P::any(7, U1, "SysDown Set Volt Time", "s").unproven(),
        P::any(8, I2, "SysDown Clear Volt Threshold", "mV").unproven(),
    ] },
    Subclass { class: "System Data", name: "Manufacturer Info", id: 57, length: 32, kind: Plain,
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
    Subclass { class: "Configuration", name: "Registers", id: 64, length: 14, kind: Reset,
               parameters: &[
        // The default is 0x0979 in the ancestor; a product with a G4 has 0x0971.
        P::within( 0, H2, "Operation Configuration", 0x0000, 0xFFFF, "flags").bits(OP_CONFIG),
        P::any( 7, U1, "SOC Delta", "%").unproven(),
        // The units of this and the next, 0.5 s and 5 µs, are guesses of the driver's readers.
        P::any( 8, U1, "I2C Timeout", "").unproven(),
        P::within( 9, U2, "DF Wr Ind Wait Time", 0, 65535, "").unproven(),
        P::within(11, H1, "Operation Configuration B", 0x00, 0xFF, "flags").bits(OP_CONFIG_B),
        P::within(12, H1, "Operation Configuration C", 0x00, 0xFF, "flags").bits(OP_CONFIG_C).unproven(),
        P::within(13, H1, "Operation Configuration D", 0x00, 0xFF, "flags").bits(OP_CONFIG_D).unproven(),
    ] },
    Subclass { class: "Configuration", name: "Power", id: 68, length: 17, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Flash Update OK Voltage", 0, 4200, 2800, "mV").safe(GATE).unproven(),
        P::int( 7, I2, "Sleep Current",           0,  100,   10, "mA").unproven(),
        // From here on the G4's image alone.
        P::any(13, I2, "Hibernate Current", "mA").unproven(),
        P::any(15, I2, "Hibernate Voltage", "mV").unproven(),
    ] },
    Subclass { class: "Fuel Gauging", name: "IT Cfg", id: 80, length: 47, kind: Reset,
               parameters: &[
        P::int( 0, U1, "Load Select",            0,   255,    1, "").unproven(),
        P::int( 1, U1, "Load Mode",              0,   255,    0, "").unproven(),
        // The G4's image alone, from before the rows that moved Terminate Voltage on.
        P::any(24, U2, "Ra Filter", "Num").unproven(),
        P::any(31, I2, "Q Invalid MaxV", "mV").unproven(),
        P::any(33, I2, "Q Invalid MinV", "mV").unproven(),
        // SLUSAP0, page 19, prints the place, where a shipped driver for this part writes it; limits and default are
        // the ancestor's.
        P::int(45, I2, "Terminate Voltage", -32768, 32767, 3000, "mV").safe(TERMINATE).role(Role::VoltageMinDesign),
    ] },
    Subclass { class: "Fuel Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Dsg Current Threshold",      0, 2000,  60, "mA").unproven(),
        P::int( 2, I2, "Chg Current Threshold",      0, 2000,  75, "mA").unproven(),
        P::int( 4, I2, "Quit Current",               0, 1000,  40, "mA").unproven(),
        P::int( 6, U2, "Dsg Relax Time",             0, 8191,  60, "s").unproven(),
        P::int( 8, U1, "Chg Relax Time",             0,  255,  60, "s").unproven(),
        P::int( 9, U1, "Quit Relax Time",            0,   63,   1, "s").unproven(),
        P::int(10, U1, "Transient Factor Charge",    0,  255, 128, "").unproven(),
        P::int(11, U1, "Transient Factor Discharge", 0,  255, 128, "").unproven(),
        P::int(12, U2, "Max IR Correct",             0, 1000, 400, "mV").unproven(),
    ] },
    Subclass { class: "Default Ra Tables", name: "Def0 Ra", id: 87, length: 19, kind: Reset,
               parameters: DEFAULT_RA },
    Subclass { class: "Default Ra Tables", name: "Def1 Ra", id: 88, length: 19, kind: Reset,
               parameters: DEFAULT_RA },
    Subclass { class: "Ra Tables", name: "Pack0 Ra", id: 91, length: 19, kind: Reset,
               parameters: LEARNED_RA },
    Subclass { class: "Ra Tables", name: "Pack1 Ra", id: 92, length: 19, kind: Reset,
               parameters: LEARNED_RA },
    Subclass { class: "Ra Tables", name: "Pack0 Rax", id: 93, length: 19, kind: Reset,
               parameters: LEARNED_RA },
    Subclass { class: "Ra Tables", name: "Pack1 Rax", id: 94, length: 19, kind: Reset,
               parameters: LEARNED_RA },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 14, kind: Reset,
               parameters: &[
        // The ancestor prints milliohms, 0.1 to 47 and 4.7 to 188, 10 for both; these are the stored
        // numbers: 4.768 / CC Gain and 5677445 / CC Delta are the milliohms.
        P::float( 0, "CC Gain",    0.1014,       47.68,    0.4768, "Num").unproven(),
        P::float( 4, "CC Delta", 30_199.0, 1_207_967.0, 567_744.5, "Num").unproven(),
        // Printed in mV as well, -0.123; the stored number has no scale in any source.
        P::any( 8, I2, "CC Offset", "Num").learned().unproven(),
        P::int(10, I1, "Board Offset",    -128, 127, 0, "Num").learned().unproven(),
        P::int(11, I1, "Int Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        P::int(12, I1, "Ext Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        // The ancestor prints 0.1°C.
        P::int(13, I1, "Pack V Offset",   -128, 127, 0, "mV").unproven(),
    ] },
    Subclass { class: "Calibration", name: "Current", id: 107, length: 2, kind: Reset,
               parameters: &[
        P::within(0, U1, "Filter", 0, 255, "").unproven(),
        P::int(1, U1, "Deadband", 0, 255, 5, "mA").unproven(),
    ] },
    Subclass { class: "Security", name: "Codes", id: 112, length: 8, kind: Keys,
               parameters: &[
        // No defaults: nothing that shows defaults may show these.
        P::any(0, H2, "Unseal Key 0", "hex"),
        P::any(2, H2, "Unseal Key 1", "hex"),
        P::any(4, H2, "Full-Access Key 0", "hex"),
        P::any(6, H2, "Full-Access Key 1", "hex"),
    ] },
];
