// SPDX-License-Identifier: MIT

//! bq27441-G1: Impedance Track gauge on the system side, for one Li-ion cell; data memory is RAM.
//!
//! Table and section numbers are those of the technical reference, SLUUAC9A. Data memory is its Tables
//! 6-2 to 6-6 row for row. There are two flavours, which differ in chemistry and in the defaults that go
//! with it: the bq27441-G1A's come first, those of the bq27441-G1B as its flavour.

use std::time::Duration;

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::{
    Access, Bit, Chip, Condition, Evidence, Identity, KeyStorage, Learning, Mode, Pack, Parameter as P,
    Preflight, Register, Role, Safe, Scaling, Scheme, SealStatus, Security, Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// DM_CODE of the bq27441-G1B.
const G1B: u16 = 0x58;

/// The bq27441-G1 as TI's documents describe it.
pub static CHIP: Chip = Chip {
    name: "bq27441-g1",
    model: "bq27441-G1",
    documents: &["SLUUAC9A (May 2015)", "SLUSBH1C", "SLUA801"],
    // SLUUAC9A 3.1's worked transfers and a tablet's shipped image, block for block.
    evidence: &[Evidence::Manual, Evidence::Transcript, Evidence::Image, Evidence::Kernel],
    // The bq27421-G1 and the bq27411-G1 have the same type (4.1.2) and firmware; the codes of the two
    // flavours are printed in SLUSBH1C's device comparison.
    identity: Identity {
        device_type: 0x0421,
        firmware: &[0x0109],
        build: None,
        hardware: None,
        dm_codes: &[0x48, G1B],
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
    // SLUSBH1C 9.5.4.3.
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: &[],
    volatile: Some(ITPOR),
    quirks: &[],
    rom_image: None,
    preflight: preflight(&[]),
};

/// The preflight checks of the family; `rows` is where data memory chooses the chemistry.
pub(super) const fn preflight(rows: &'static [(u8, u16)]) -> Preflight {
    Preflight {
        pack: Some(Pack { word: Source::Answer(0x0008), name: "Control(CHEM_ID)", rows }),
        marks: &[(104, 1), (104, 2), (105, 4), (105, 8)],
        modes: MODES,
        // 6.4.2.3.2: both low bits of Update Status are set for a learning cycle only. Leaving CONFIG UPDATE
        // takes a new OCV (4.1.17), whatever the cycle had come to.
        learning: Some(Learning {
            status: 0x0002,
            row: (82, 2),
            shown: None,
            mask: 0x03,
            value: 0x03,
            name: "CONTROL_STATUS [VOK], Update Status (82/2) 03",
        }),
        // SLUSBH1C 8.7 and 8.9.
        voltage_mv: Some((2450, 4500)),
    }
}

/// Table 4-3 and, for [CFGUPMODE], 2.4.3.
static MODES: &[Mode] = &[
    Mode {
        word: Source::Command(0x06),
        mask: 0x0010,
        name: "Flags() [CFGUPMODE]",
        what: "somebody has left CONFIG UPDATE on, and the gauge does not gauge",
        remedy: "the gauge leaves it by itself after 240 s; try again then",
        ours: true,
        slip: None,
    },
    Mode::calibration(
        Source::Status,
        0x1000,
        "CONTROL_STATUS [CALMODE]",
        "leave it with the tool that entered it",
    ),
    Mode::measuring(0x0800, "CONTROL_STATUS [CCA]", "the coulomb counter is being calibrated"),
    Mode::measuring(0x0400, "CONTROL_STATUS [BCA]", "the board is being calibrated"),
];

/// Flags `[ITPOR]`: data memory has its defaults from ROM (2.4.2).
pub(super) const ITPOR: u32 = 0x0020;

/// Bits of Flags(), Table 4-4.
pub(super) const CONDITION: Condition = Condition {
    full: 0x0200,     // [FC]
    low: 0x0004,      // [SOC1]
    critical: 0x0002, // [SOCF]
    overheat: 0x8000, // [OT]
    cold: 0x4000,     // [UT]
    over_voltage: 0,
    under_voltage: 0,
    present: 0x0008, // [BAT_DET]
    absent: 0,
    uncertain: 0,
    certain: 0,
    empty: 0,
    complete: Some((Source::Status, 0x0080)), // [INITCOMP]
    primary: None,
};

/// 6.1.2: SEALED and UNSEALED, no FULL ACCESS.
pub(super) const SECURITY: Security = Security {
    status: SealStatus::Bits { sealed: 0x2000, not_full_access: 0 },
    // 6.1.3: both words are the same, and in ROM.
    default_unseal: [0x8000, 0x8000],
    full_access: false,
    seal: 0x0020,
    // 6.4.5.1.1: a gauge that sealed itself at the end of CONFIG UPDATE takes no key for so long.
    shows: Security::SHOWS,
    key_silence: Duration::from_millis(5200),
    // Update Status bit 7: 6.4.2.3.2, and 4.1.14 for SEALED.
    seals_itself: Some((82, 2, 0x80)),
    shown_sealed: &[],
    storage: KeyStorage::Fixed("its only key is in ROM"),
};

pub(super) const ACCESS: Access = Access {
    scheme: Scheme::CfgUpdate,
    // No document gives it. The kernel's driver waits 1 ms, Zephyr's bq274xx 5 ms; owners who read at
    // once saw a wrong first byte.
    select: Duration::from_millis(30),
    // Zephyr's bq274xx, on parts of this family; the kernel's driver waits 1 ms.
    soonest: Duration::from_millis(5),
    // SLUA801, between the checksum and reading it back.
    commit: Duration::from_millis(10),
    // 3.1: within a second; SLUA801 asks five times, half a second apart.
    enter: Duration::ZERO,
    enter_limit: Duration::from_millis(2500),
    // The way out shows in [CFGUPMODE] as well.
    reset: Duration::ZERO,
    reset_limit: Duration::from_millis(2500),
    resets: Access::RESET,
    advances: false,
};

/// Standard commands, Table 4-1, and extended ones, Table 5-1. The poll reads 0x02 to 0x11 and 0x18 to
/// 0x21 whole, so all in there count as polled. 0x6A is TrueRemainingCapacity() in SLUSBH1C only and
/// reserved here: no row.
#[rustfmt::skip]
pub(super) static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x04, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x06, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x08, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0A, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x0C, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x0E, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x10, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x12, I2, "StandbyCurrent", "mA", Slow),
    Register::new(0x14, I2, "MaxLoadCurrent", "mA", Slow),
    Register::new(0x18, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x1C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x1E, U2, "InternalTemperature", "0.1K", Poll),
    // 4.15: one command of two bytes, a percentage and what stands behind it (0 for not valid, 3 for learned).
    Register::new(0x20, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x21),
    Register::new(0x21, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x28, U2, "RemainingCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2A, U2, "RemainingCapacityFiltered", "mAh", Slow),
    Register::new(0x2C, U2, "FullChargeCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2E, U2, "FullChargeCapacityFiltered", "mAh", Slow),
    // Table 4-1 prints mAh; 4.20 says what the name says.
    Register::new(0x30, U2, "StateOfChargeUnfiltered", "%", Slow),
    Register::new(0x3A, U2, "OpConfig", "", Slow).bits(OP_CONFIG),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataClass", "", Window),
    Register::new(0x3F, U1, "DataBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

/// Table 4-2. Key words are no subcommands and have no row.
#[rustfmt::skip]
pub(super) static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0004, "DM_CODE", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    // 4.1.7: where OpConfig [BIE] is 0 the gauge does not gauge before this comes.
    Subcommand::new(0x000C, "BAT_INSERT", Allowed),
    Subcommand::new(0x000D, "BAT_REMOVE", Allowed),
    Subcommand::new(0x0011, "SET_HIBERNATE", Allowed),
    Subcommand::new(0x0012, "CLEAR_HIBERNATE", Allowed),
    // The transaction's own way in and out of CONFIG UPDATE, in which the gauge does not gauge.
    Subcommand::new(0x0013, "SET_CFGUPDATE", Guarded).unsealed(),
    // 4.1.13: only an edge on GPOUT wakes the gauge again, its data memory lost.
    Subcommand::new(0x001B, "SHUTDOWN_ENABLE", Never).unsealed(),
    Subcommand::new(0x001C, "SHUTDOWN", Never).unsealed(),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    // TOGGLE_GPOUT in Table 4-2, this in 4.1.15.
    Subcommand::new(0x0023, "PULSE_SOC_INT", Allowed),
    // 4.1.16: the whole configuration is lost.
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0042, "SOFT_RESET", Guarded).unsealed(),
    Subcommand::new(0x0043, "EXIT_CFGUPDATE", Guarded).unsealed(),
    Subcommand::new(0x0044, "EXIT_RESIM", Guarded).unsealed(),
];

/// Table 4-3.
pub(super) static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x8000, "SHUTDOWNEN"),
    Bit::new(0x4000, "WDRESET"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CALMODE"),
    Bit::new(0x0800, "CCA"),
    Bit::new(0x0400, "BCA"),
    Bit::new(0x0200, "QMAX_UP"),
    Bit::new(0x0100, "RES_UP"),
    Bit::new(0x0080, "INITCOMP"),
    Bit::new(0x0040, "HIBERNATE"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0004, "RUP_DIS"),
    Bit::new(0x0002, "VOK"),
];

/// Table 4-4.
static FLAGS: &[Bit] = &[
    Bit::new(0x8000, "OT"),
    Bit::new(0x4000, "UT"),
    Bit::new(0x0200, "FC"),
    Bit::new(0x0100, "CHG"),
    Bit::new(0x0080, "OCVTAKEN"),
    Bit::new(ITPOR, "ITPOR"),
    Bit::new(0x0010, "CFGUPMODE"),
    Bit::new(0x0008, "BAT_DET"),
    Bit::new(0x0004, "SOC1"),
    Bit::new(0x0002, "SOCF"),
    Bit::new(0x0001, "DSG"),
];

/// Table 6-7. Several of the reserved bits have to stay 1.
pub(super) static OP_CONFIG: &[Bit] = &[
    Bit::new(0x2000, "BIE"),
    Bit::new(0x1000, "BI_PU_EN"),
    Bit::new(0x0800, "GPIOPOL"),
    Bit::new(0x0020, "SLEEP"),
    Bit::new(0x0010, "RMFCC"),
    Bit::new(0x0004, "BATLOWEN"),
    Bit::new(0x0001, "TEMPS"),
];

/// Table 6-8.
pub(super) static OP_CONFIG_B: &[Bit] = &[Bit::new(0x04, "SMOOTHEN")];

/// Table 6-9.
pub(super) static LOAD_SELECT: &[Bit] = &[
    Bit::new(0x80, "LoadMode"),
    Bit::new(0x04, "LoadSelect2"),
    Bit::new(0x02, "LoadSelect1"),
    Bit::new(0x01, "LoadSelect0"),
];

/// StateOfHealth() is a fraction of the one, and all capacities scale with the other (6.4.2.3.1).
pub(super) const CAPACITY: Safe = Safe::AtLeast(1, "the gauge divides by it");

/// 6.4.2.3.2: bits 0 and 1 are for a learning cycle, bit 7 seals the gauge whenever CONFIG UPDATE ends.
pub(super) const KEEP_STATE: Safe =
    Safe::Keep(0xFC, "only bits 0 and 1 are the host's; bit 7 seals the gauge");

/// Tables 6-2 to 6-6.
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
        P::int(52, I2, "User Rate-mA",                -32768,     0,   0, "mA"),
        P::int(54, I2, "User Rate-mW",                -32768,     0,   0, "mW"),
        P::int(61, U1, "Max Sim Rate",                     0,   255,   1, "Hr rate"),
        P::int(62, U1, "Min Sim Rate",                     0,   255,  20, "Hr rate"),
        P::int(63, U2, "Ra Max Delta",                     0, 32767,  11, "4 mΩ"),
        P::int(72, I2, "Min Delta Voltage",                0, 32767,   0, "mV"),
        P::int(74, I2, "Max Delta Voltage",                0, 32767, 200, "mV"),
        P::int(76, I2, "DeltaV Max dV",                    0, 32767, 100, "mV"),
        P::int(78, U1, "TermV Valid t",                    0,   255,   2, "s"),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Dsg Current Threshold", 0,  2000, 167, "0.1 Hr rate"),
        P::int( 2, I2, "Chg Current Threshold", 0,  2000, 100, "0.1 Hr rate"),
        // The text of 6.4.2.2.1 has 1000 for the maximum.
        P::int( 4, I2, "Quit Current",          0,  2000, 250, "0.1 Hr rate"),
        P::int( 6, U2, "Dsg Relax Time",        0, 65535,  60, "s"),
        P::int( 8, U1, "Chg Relax Time",        0,   255,  60, "s"),
        P::int( 9, U1, "Quit Relax Time",       0,   255,   1, "s"),
        P::int(12, U2, "Max IR Correct",        0,  1000, 400, "mV"),
    ] },
    // Where a G1A (DM_CODE 0x48) and a G1B (0x58) have other defaults, none is shown; the numbers are the G1A's.
    Subclass { class: "Gas Gauging", name: "State", id: 82, length: 41, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Qmax Cell 0",             0, 32767, 16384, "Num").safe(CAPACITY).learned(),
        P::int( 2, H1, "Update Status",        0x00,  0xFF,  0x00, "hex").safe(KEEP_STATE).learned(),
        P::int( 3, I2, "Reserve Cap-mAh",         0,  9000,     0, "mAh"),
        P::int( 5, H1, "Load Select/Mode",     0x00,  0xFF,  0x81, "hex").bits(LOAD_SELECT),
        P::int( 6, I2, "Q Invalid MaxV",          0, 32767,  3803, "mV").flavour(G1B, 3814),
        P::int( 8, I2, "Q Invalid MinV",          0, 32767,  3752, "mV").flavour(G1B, 3748),
        P::int(10, I2, "Design Capacity",         0,  8000,  1340, "mAh").flavour(G1B, 1000).safe(CAPACITY),
        P::int(12, I2, "Design Energy",           0, 32767,  4960, "mWh").flavour(G1B, 3800),
        P::int(14, I2, "Default Design Cap",      0, 32767,  1340, "mAh").flavour(G1B, 5580),
        P::int(16, I2, "Terminate Voltage",    2500,  3700,  3200, "mV").role(Role::VoltageMinDesign),
        P::int(22, I2, "T Rise",                  0, 32767,    20, "Num"),
        P::int(24, I2, "T Time Constant",         0, 32767,  1000, "s"),
        P::int(26, U1, "SOCI Delta",              0,   100,     1, "%"),
        P::int(27, I2, "Taper Rate",              0,  2000,   100, "0.1 Hr rate"),
        P::int(29, I2, "Taper Voltage",           0,  5000,  4100, "mV").flavour(G1B, 4200),
        P::int(31, I2, "Sleep Current",           0,  1000,    10, "mA"),
        P::int(33, I2, "V at Chg Term",           0,  5000,  4190, "mV").flavour(G1B, 4290).learned(),
        P::int(35, I2, "Avg I Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned(),
        P::int(37, I2, "Avg P Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned(),
        P::int(39, I2, "Delta Voltage",           0,  1000,     1, "mV").learned(),
    ] },
    Subclass { class: "Ra Tables", name: "R_a RAM", id: 89, length: 30, kind: Reset,
               parameters: &[
        P::int( 0, I2, "R_a0 0",  0, 32767, 102, "Num").flavour(G1B, 16).learned(),
        P::int( 2, I2, "R_a0 1",  0, 32767, 102, "Num").flavour(G1B, 17).learned(),
        P::int( 4, I2, "R_a0 2",  0, 32767,  99, "Num").flavour(G1B, 20).learned(),
        P::int( 6, I2, "R_a0 3",  0, 32767, 107, "Num").flavour(G1B, 24).learned(),
        P::int( 8, I2, "R_a0 4",  0, 32767,  72, "Num").flavour(G1B, 20).learned(),
        P::int(10, I2, "R_a0 5",  0, 32767,  59, "Num").flavour(G1B, 18).learned(),
        P::int(12, I2, "R_a0 6",  0, 32767,  62, "Num").flavour(G1B, 20).learned(),
        P::int(14, I2, "R_a0 7",  0, 32767,  63, "Num").flavour(G1B, 20).learned(),
        P::int(16, I2, "R_a0 8",  0, 32767,  53, "Num").flavour(G1B, 21).learned(),
        P::int(18, I2, "R_a0 9",  0, 32767,  47, "Num").flavour(G1B, 22).learned(),
        P::int(20, I2, "R_a0 10", 0, 32767,  60, "Num").flavour(G1B, 24).learned(),
        P::int(22, I2, "R_a0 11", 0, 32767,  70, "Num").flavour(G1B, 31).learned(),
        P::int(24, I2, "R_a0 12", 0, 32767, 140, "Num").flavour(G1B, 49).learned(),
        P::int(26, I2, "R_a0 13", 0, 32767, 369, "Num").flavour(G1B, 98).learned(),
        P::int(28, I2, "R_a0 14", 0, 32767, 588, "Num").flavour(G1B, 375).learned(),
    ] },
    Subclass { class: "Calibration", name: "Data", id: 104, length: 3, kind: Reset,
               parameters: &[
        P::int(0, I1, "Board Offset",    -128, 127, 0, "Counts").learned(),
        P::int(1, I1, "Int Temp Offset", -128, 127, 0, "0.1°C"),
        P::int(2, I1, "Pack V Offset",   -128, 127, 0, "mV"),
    ] },
    Subclass { class: "Calibration", name: "CC Cal", id: 105, length: 12, kind: Reset,
               parameters: &[
        P::int(0, I2, "CC Offset",   -32768, 32767,    0, "Counts").learned(),
        P::int(2, I2, "CC Cal Temp",      0, 32767, 2982, "0.1K").learned(),
        P::float(4, "CC Gain",       0.1,        40.0,   0.672785, "Num"),
        P::float(8, "CC Delta", 30_000.0, 3_000_000.0, 799_341.14, "Num"),
    ] },
    Subclass { class: "Calibration", name: "Current", id: 107, length: 2, kind: Reset,
               parameters: &[
        P::int(1, U1, "Deadband", 0, 255, 5, "mA"),
    ] },
    Subclass { class: "Security", name: "Codes", id: 112, length: 4, kind: Keys,
               parameters: &[
        // No default: nothing that shows defaults may show a key.
        P::any(0, H4, "Sealed to Unsealed", "hex"),
    ] },
];
