// SPDX-License-Identifier: MIT

//! bq27621-G1: gauge without a sense resistor, for one Li-ion cell; data memory is RAM.
//!
//! Its reference, SLUUAD4C, has not been read itself. Commands, subcommands, flags and the State block are as
//! two drivers written from it have them: Chromium's EC (driver/battery/bq27621_g1.c) and
//! github.com/uedsoldier/BQ27621. A third, github.com/pbdaran/BQ27621-G1, has parameters of the first classes.
//! TI's sample image (github.com/tibms/i2c-flashstream) shows all blocks, and TI's text in
//! github.com/aneeshv/bq-docs some places of the State block. A row is proven if a driver or TI's text names
//! its place and the image has a fitting value there. The others are the bq27441-G1's, moved to where the
//! image has their values. Defaults are the bq27441-G1's.

use super::Effect::{Answers, Guarded, Never, Safe as Allowed};
use super::Kind::{Reset, Security as Keys};
use super::Tier::{Poll, Slow, Static, Window};
use super::bq27427::ACCESS;
use super::bq27441_g1::{CAPACITY, CONDITION, ITPOR, LOAD_SELECT, OP_CONFIG_B, SECURITY};
use super::{
    Bit, Chip, Evidence, Identity, Mode, Pack, Parameter as P, Preflight, Register, Role, Scaling, Security,
    Source, Subclass, Subcommand,
};
use crate::codec::Layout;
use crate::value::Type::U;
use crate::value::types::{H1, H2, H4, I1, I2, U1, U2};
use gauge_bus::GAUGE_ADDRESS;

/// The bq27621-G1 as far as it is known.
pub static CHIP: Chip = Chip {
    name: "bq27621-g1",
    model: "bq27621-G1",
    documents: &["SLUUAD4C (August 2014), as drivers quote it", "SLUSBB3E (January 2016)"],
    evidence: &[Evidence::Sibling, Evidence::Drivers, Evidence::Image, Evidence::Kernel],
    // The firmware is what TI's image expects.
    identity: Identity {
        device_type: 0x0621,
        firmware: &[0x0105],
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
    scaling: Scaling::NONE,
    // No document at hand says that SEALED sets OpConfigB [DEF_SEAL].
    security: Security { seals_itself: None, ..SECURITY },
    // TI's image waits as the BQ27427's do: 1.1 s to CONFIG UPDATE, 10 ms after a checksum, 2 s at the end.
    asks: None,
    access: ACCESS,
    gate: None,
    authentication: None,
    subclasses: SUBCLASSES,
    // Chromium's driver allows no faster bus.
    byte_writes_above_hz: Some(100_000),
    calibration: None,
    signature: &[],
    volatile: Some(ITPOR),
    quirks: &[],
    rom_image: None,
    preflight: Preflight {
        pack: Some(Pack { word: Source::Answer(0x0008), name: "Control(CHEM_ID)", rows: &[(82, 36)] }),
        // Without a sense resistor there is no calibration of the current, and no serial number is known.
        marks: &[(104, 1), (104, 2)],
        modes: MODES,
        // No Update Status is known.
        learning: None,
        // SLUSBB3E, recommended operating conditions.
        voltage_mv: Some((2450, 4500)),
    },
};

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
];

/// Standard and extended commands. No driver has a StateOfHealth().
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x02, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x04, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x06, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x08, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x0A, U2, "FullAvailableCapacity", "mAh", Poll),
    Register::new(0x0C, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x0E, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    // Estimated from voltages.
    Register::new(0x10, I2, "EffectiveCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x18, I2, "AveragePower", "mW", Poll).role(Role::PowerAvg),
    Register::new(0x1C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x1E, U2, "InternalTemperature", "0.1K", Slow),
    Register::new(0x28, U2, "RemainingCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2A, U2, "RemainingCapacityFiltered", "mAh", Slow),
    Register::new(0x2C, U2, "FullChargeCapacityUnfiltered", "mAh", Slow),
    Register::new(0x2E, U2, "FullChargeCapacityFiltered", "mAh", Slow),
    Register::new(0x30, U2, "StateOfChargeUnfiltered", "%", Slow),
    Register::new(0x3A, U2, "OpConfig", "", Slow).bits(OP_CONFIG),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataClass", "", Window),
    Register::new(0x3F, U1, "DataBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

/// Key words are no subcommands and have no row.
#[rustfmt::skip]
static SUBCOMMANDS: &[Subcommand] = &[
    Subcommand::new(0x0000, "CONTROL_STATUS", Answers),
    Subcommand::new(0x0001, "DEVICE_TYPE", Answers),
    Subcommand::new(0x0002, "FW_VERSION", Answers),
    Subcommand::new(0x0007, "PREV_MACWRITE", Answers),
    Subcommand::new(0x0008, "CHEM_ID", Answers),
    Subcommand::new(0x000C, "BAT_INSERT", Allowed),
    Subcommand::new(0x000D, "BAT_REMOVE", Allowed),
    Subcommand::new(0x0010, "TOGGLE_POWERMIN", Guarded),
    Subcommand::new(0x0011, "SET_HIBERNATE", Allowed),
    Subcommand::new(0x0012, "CLEAR_HIBERNATE", Allowed),
    // The transaction's own way in and out of CONFIG UPDATE, in which the gauge does not gauge.
    Subcommand::new(0x0013, "SET_CFGUPDATE", Guarded).unsealed(),
    // Only an edge on GPOUT wakes the gauge again, its data memory lost.
    Subcommand::new(0x001B, "SHUTDOWN_ENABLE", Never).unsealed(),
    Subcommand::new(0x001C, "SHUTDOWN", Never).unsealed(),
    Subcommand::new(0x0020, "SEALED", Guarded).unsealed(),
    Subcommand::new(0x0023, "TOGGLE_GPOUT", Guarded),
    // Chemistries 0x1210 and 0x0354, taken in CONFIG UPDATE only.
    Subcommand::new(0x0031, "ALT_CHEM1", Guarded).unsealed(),
    Subcommand::new(0x0032, "ALT_CHEM2", Guarded).unsealed(),
    // The whole configuration is lost.
    Subcommand::new(0x0041, "RESET", Guarded).unsealed(),
    Subcommand::new(0x0042, "SOFT_RESET", Guarded).unsealed(),
    Subcommand::new(0x0043, "EXIT_CFGUPDATE", Guarded).unsealed(),
    Subcommand::new(0x0044, "EXIT_RESIM", Guarded).unsealed(),
];

/// Chromium's. The other driver has [POWERMIN] in the place of [HIBERNATE].
static CONTROL_STATUS: &[Bit] = &[
    Bit::new(0x8000, "SHUTDOWNEN"),
    Bit::new(0x4000, "WDRESET"),
    Bit::new(0x2000, "SS"),
    Bit::new(0x1000, "CALMODE"),
    Bit::new(0x0200, "OCVCMDCOMP"),
    Bit::new(0x0100, "OCVFAIL"),
    Bit::new(0x0080, "INITCOMP"),
    Bit::new(0x0040, "HIBERNATE"),
    Bit::new(0x0020, "POWERMIN"),
    Bit::new(0x0010, "SLEEP"),
    Bit::new(0x0008, "LDMD"),
    Bit::new(0x0001, "CHEMCHNG"),
];

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

static OP_CONFIG: &[Bit] = &[
    Bit::new(0x4000, "ADOLP"),
    Bit::new(0x2000, "BIE"),
    Bit::new(0x0800, "GPIOPOL"),
    Bit::new(0x0400, "ADMLP"),
    Bit::new(0x0080, "VCONSEN"),
    Bit::new(0x0010, "RMFCC"),
    Bit::new(0x0008, "FCONVEN"),
    Bit::new(0x0004, "BATLOWEN"),
    Bit::new(0x0002, "NODVAVG"),
    Bit::new(0x0001, "TEMPS"),
];

/// Data memory, in the order of TI's image.
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
        // No source has ranges of these two for this part; the limits are the bq34z100-G1's.
        P::int(0, I2, "Min Taper Capacity",   0, 1000, 25, "mAh").unprinted(),
        P::int(2, U1, "Current Taper Window", 0,   60, 40, "s").unprinted(),
        P::int(3, I1, "TCA Set %",           -1,  100, 99, "%").unproven(),
        P::int(4, I1, "TCA Clear %",         -1,  100, 95, "%").unproven(),
        P::int(5, I1, "FC Set %",            -1,  100, -1, "%"),
        P::int(6, I1, "FC Clear %",           0,  100, 98, "%"),
        P::int(7, I2, "DODatEOC Delta T",     0, 1000, 50, "0.1°C").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Data", id: 48, length: 5, kind: Reset,
               parameters: &[
        P::int(2, I1, "Initial Standby",   -128, 0,   -3, "mA").unproven(),
        P::int(3, I2, "Initial MaxLoad", -32768, 0, -200, "mA").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Discharge", id: 49, length: 4, kind: Reset,
               parameters: &[
        P::int(0, U1, "SOC1 Set Threshold",   0, 100, 10, "%"),
        P::int(1, U1, "SOC1 Clear Threshold", 0, 100, 15, "%"),
        P::int(2, U1, "SOCF Set Threshold",   0, 100,  2, "%"),
        P::int(3, U1, "SOCF Clear Threshold", 0, 100,  5, "%"),
    ] },
    Subclass { class: "Configuration", name: "Registers", id: 64, length: 4, kind: Reset,
               parameters: &[
        P::within(0, H2, "OpConfig",  0x0000, 0xFFFF, "flags").bits(OP_CONFIG),
        // Bit 5 is [DEF_SEAL] in Chromium's driver: the gauge seals itself when CONFIG UPDATE ends. It keeps its value, as
        // all bits without a name.
        P::within(2, H1, "OpConfigB",   0x00,   0xFF, "flags").bits(OP_CONFIG_B),
        P::any(3, H1, "DF Version", "hex").unproven(),
    ] },
    Subclass { class: "Configuration", name: "Power", id: 68, length: 5, kind: Reset,
               parameters: &[
        P::int(1, I2, "Hibernate I", 0, 8000,    3, "mA").unproven(),
        P::int(3, I2, "Hibernate V", 0, 5000, 2200, "mV").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "IT Cfg", id: 80, length: 71, kind: Reset,
               parameters: &[
        P::int(21, U2, "Ra Filter",              0,  1000, 800, "Num").unproven(),
        P::int(30, U2, "ResRelax Time",          0, 65535, 500, "s").unproven(),
        P::int(32, I2, "User Rate-mA",      -32768,     0,   0, "mA").unproven(),
        P::int(34, I2, "User Rate-mW",      -32768,     0,   0, "mW").unproven(),
        P::int(43, U1, "Max Sim Rate",           0,   255,   1, "Hr rate").unproven(),
        P::int(44, U1, "Min Sim Rate",           0,   255,  20, "Hr rate").unproven(),
        P::int(45, U2, "Ra Max Delta",           0, 32767,  11, "4 mΩ").unproven(),
        P::int(54, I2, "Min Delta Voltage",      0, 32767,   0, "mV").unproven(),
        P::int(56, I2, "Max Delta Voltage",      0, 32767, 200, "mV").unproven(),
        P::int(58, I2, "DeltaV Max dV",          0, 32767, 100, "mV").unproven(),
        P::int(60, U1, "TermV Valid t",          0,   255,   2, "s").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "Current Thresholds", id: 81, length: 14, kind: Reset,
               parameters: &[
        P::int( 0, I2, "Dsg Current Threshold", 0,  2000, 167, "0.1 Hr rate").unproven(),
        P::int( 2, I2, "Chg Current Threshold", 0,  2000, 100, "0.1 Hr rate").unproven(),
        P::int( 4, I2, "Quit Current",          0,  2000, 250, "0.1 Hr rate").unproven(),
        P::int( 6, U2, "Dsg Relax Time",        0, 65535,  60, "s").unproven(),
        P::int( 8, U1, "Chg Relax Time",        0,   255,  60, "s").unproven(),
        P::int( 9, U1, "Quit Relax Time",       0,   255,   1, "s").unproven(),
        P::int(12, U2, "Max IR Correct",        0,  1000, 400, "mV").unproven(),
    ] },
    Subclass { class: "Gas Gauging", name: "State", id: 82, length: 38, kind: Reset,
               parameters: &[
        P::within( 0, I2, "Qmax Cell 0",          0, 32767, "Num").safe(CAPACITY).learned(),
        P::within( 2, H1, "Load Select/Mode",  0x00,  0xFF, "hex").bits(LOAD_SELECT),
        P::int( 3, I2, "Design Capacity",         0,  8000,  1340, "mAh").safe(CAPACITY),
        P::int( 5, I2, "Design Energy",           0, 32767,  4960, "mWh"),
        P::within( 7, I2, "Default Design Cap",   0, 32767, "mAh"),
        P::int( 9, I2, "Terminate Voltage",    2500,  3700,  3200, "mV").role(Role::VoltageMinDesign),
        P::int(19, U1, "SOCI Delta",              0,   100,     1, "%"),
        P::int(20, I2, "Taper Rate",              0,  2000,   100, "0.1 Hr rate"),
        P::int(22, I2, "Taper Voltage",           0,  5000,  4100, "mV"),
        P::int(24, I2, "Sleep Current",           0,  1000,    10, "mA"),
        P::int(26, I2, "V at Chg Term",           0,  5000,  4190, "mV").learned(),
        P::int(28, I2, "Avg I Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned(),
        P::int(30, I2, "Avg P Last Run",     -32768,    -1,   -50, "0.1 Hr rate").learned(),
        P::int(32, I2, "Delta Voltage",           0,  1000,     1, "mV").learned(),
        P::int(36, H2, "Chem ID",            0x0000, 0xFFFF, 0x1202, "hex"),
    ] },
    // Of these only the length is known, from TI's image. 83 and 84 are OCV tables in drivers of the bq27541 and
    // the bq27520.
    Subclass::opaque("Chemistry", "OCV Table 83", 83, 41),
    Subclass::opaque("Chemistry", "OCV Table 84", 84, 42),
    // One driver has 89 for this class, which the image does not write.
    Subclass { class: "Ra Tables", name: "R_a RAM", id: 85, length: 30, kind: Reset,
               parameters: &[
        P::within( 0, I2, "R_a0 0",  0, 32767, "Num").learned().unproven(),
        P::within( 2, I2, "R_a0 1",  0, 32767, "Num").learned().unproven(),
        P::within( 4, I2, "R_a0 2",  0, 32767, "Num").learned().unproven(),
        P::within( 6, I2, "R_a0 3",  0, 32767, "Num").learned().unproven(),
        P::within( 8, I2, "R_a0 4",  0, 32767, "Num").learned().unproven(),
        P::within(10, I2, "R_a0 5",  0, 32767, "Num").learned().unproven(),
        P::within(12, I2, "R_a0 6",  0, 32767, "Num").learned().unproven(),
        P::within(14, I2, "R_a0 7",  0, 32767, "Num").learned().unproven(),
        P::within(16, I2, "R_a0 8",  0, 32767, "Num").learned().unproven(),
        P::within(18, I2, "R_a0 9",  0, 32767, "Num").learned().unproven(),
        P::within(20, I2, "R_a0 10", 0, 32767, "Num").learned().unproven(),
        P::within(22, I2, "R_a0 11", 0, 32767, "Num").learned().unproven(),
        P::within(24, I2, "R_a0 12", 0, 32767, "Num").learned().unproven(),
        P::within(26, I2, "R_a0 13", 0, 32767, "Num").learned().unproven(),
        P::within(28, I2, "R_a0 14", 0, 32767, "Num").learned().unproven(),
    ] },
    Subclass::opaque("Chemistry", "Chemistry 86", 86, 17),
    Subclass::opaque("Chemistry", "Chemistry 108", 108, 17),
    Subclass::opaque("Chemistry", "Chemistry 92", 92, 16),
    Subclass::opaque("Chemistry", "Chemistry 93", 93, 16),
    Subclass::opaque("Chemistry", "Chemistry 94", 94, 16),
    Subclass::opaque("Chemistry", "Chemistry 95", 95, 16),
    Subclass { class: "Calibration", name: "Data", id: 104, length: 3, kind: Reset,
               parameters: &[
        // The image has zeros in the whole block.
        P::int(1, I1, "Int Temp Offset", -128, 127, 0, "0.1°C").unproven(),
        P::int(2, I1, "Pack V Offset",   -128, 127, 0, "mV").unproven(),
    ] },
    Subclass::opaque("Calibration", "Calibration 106", 106, 15),
    Subclass::opaque("Calibration", "Calibration 107", 107, 1),
    Subclass { class: "Security", name: "Codes", id: 112, length: 4, kind: Keys,
               parameters: &[
        // No default: nothing that shows defaults may show a key.
        P::any(0, H4, "Sealed to Unsealed", "hex"),
    ] },
];
