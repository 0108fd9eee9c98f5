// SPDX-License-Identifier: MIT

//! bq27542-G1: Impedance Track gauge on the pack's side. Its data flash is known by names, and nothing is written
//! to it.
//!
//! A reader for a real part with firmware 0x0201 (github.com/Anivice/yogabook-bq27542) quotes the offsets of
//! SLUUB65B, Table 16-3. Two blocks of a fresh part (E2E 909149) hold the defaults of classes 48 and 81 at these
//! places, and the bq27742-G1 has the same names and types there. No public source has a range, or the row of the
//! flash gate, below whose voltage the gauge drops a write without an error. In 81 the part has 400 at 9, the
//! default of Max IR Correct, which the bq27742-G1 has at 10.

use super::Tier::{Poll, Static, Window};
use super::bq27541_g1::{FLAGS, class, only_names};
use super::{Chip, Evidence, Parameter as P, Register, Role, Subclass};
use crate::value::Type::U;
use crate::value::types::{H1, H2, I2, U1, U2};

/// The bq27542-G1.
pub static CHIP: Chip = only_names(
    "bq27542-g1",
    "bq27542-G1",
    &["SLUUB65B, Table 16-3, as a driver quotes it", "SLUSC33"],
    &[Evidence::Sibling, Evidence::Drivers, Evidence::Transcript],
    (0x0542, &[0x0201]),
    REGISTERS,
    SUBCLASSES,
);

/// Standard commands, as the kernel's driver has them. At 0x24 is a battery trip point (SLUSC33), and no power.
#[rustfmt::skip]
static REGISTERS: &[Register] = &[
    Register::new(0x00, U2, "Control", "", Window),
    Register::new(0x06, U2, "Temperature", "0.1K", Poll).role(Role::Temp),
    Register::new(0x08, U2, "Voltage", "mV", Poll).role(Role::VoltageNow),
    Register::new(0x0A, U2, "Flags", "", Poll).role(Role::Flags).bits(FLAGS),
    Register::new(0x0C, U2, "NominalAvailableCapacity", "mAh", Poll),
    Register::new(0x10, U2, "RemainingCapacity", "mAh", Poll).role(Role::ChargeNow),
    Register::new(0x12, U2, "FullChargeCapacity", "mAh", Poll).role(Role::ChargeFull),
    Register::new(0x14, I2, "AverageCurrent", "mA", Poll).role(Role::CurrentAvg),
    Register::new(0x16, U2, "TimeToEmpty", "min", Poll).role(Role::TimeToEmptyNow),
    Register::new(0x2A, U2, "CycleCount", "Counts", Poll).role(Role::CycleCount),
    Register::new(0x2C, U2, "StateOfCharge", "%", Poll).role(Role::Capacity),
    Register::new(0x2E, U1, "StateOfHealth", "%", Poll).role(Role::StateOfHealth).valid_by(0x2F),
    Register::new(0x2F, U1, "StateOfHealthStatus", "", Poll),
    Register::new(0x3C, U2, "DesignCapacity", "mAh", Static).role(Role::ChargeFullDesign),
    Register::new(0x3E, U1, "DataFlashClass", "", Window),
    Register::new(0x3F, U1, "DataFlashBlock", "", Window),
    Register::new(0x40, U(32), "BlockData", "", Window),
    Register::new(0x60, U1, "BlockDataChecksum", "", Window),
    Register::new(0x61, U1, "BlockDataControl", "", Window),
];

// What shows that a row is where it is.
const QUOTED: &str = "SLUUB65B Table 16-3, as a driver of a real part quotes it; the bq27742 has it there";
const QUOTED_ALONE: &str = "SLUUB65B Table 16-3, as a driver of a real part quotes it";
const QUOTED_AND_SEEN: &str =
    "SLUUB65B Table 16-3, as a driver quotes it, and a block of a real part (E2E 909149)";
const QUOTED_AND_ACTED: &str =
    "SLUUB65B Table 16-3, as a driver quotes it, which writes it and sees it act in CONTROL_STATUS";
const SEEN: &str = "a block of a real part (E2E 909149); the bq27742 has it there";
const SEEN_BY_DEFAULT: &str = "TI's default in a block of a real part (E2E 909149)";

#[rustfmt::skip]
static DF_DATA: &[P] = &[
    P::int(0, I2, "Design Voltage", -32768, 32767, 3800, "mV").unprinted().unproven().by(QUOTED_AND_SEEN),
    P::int(8, U2, "Cycle Count", 0, 65535, 5, "Counts").unprinted().learned().unproven().by(SEEN),
    P::int(10, I2, "CC Threshold", -32768, 32767, 900, "mAh").unprinted().unproven().by(SEEN),
    P::int(12, I2, "Design Capacity", -32768, 32767, 1000, "mAh").unprinted().unproven().by(QUOTED_AND_SEEN),
    P::int(14, I2, "Design Energy", -32768, 32767, 3800, "mWh").unprinted().unproven().by(QUOTED_AND_SEEN),
    P::int(16, I2, "SOH Load I", -32768, 32767, -400, "mA").unprinted().unproven().by(QUOTED_AND_SEEN),
    P::int(18, U1, "TDD SOH Percent", 0, 255, 80, "%").unprinted().unproven().by(SEEN),
    P::int(19, U2, "ISD Current", 0, 65535, 10, "Hr rate").unprinted().unproven().by(SEEN),
    P::int(21, U1, "ISD I Filter", 0, 255, 127, "Num").unprinted().unproven().by(SEEN),
    P::int(22, U1, "Min ISD Time", 0, 255, 7, "h").unprinted().unproven().by(SEEN),
    P::int(23, U1, "Design Energy Scale", 0, 255, 1, "Num").unprinted().unproven().by(QUOTED_AND_SEEN),
];

#[rustfmt::skip]
static DF_REGISTERS: &[P] = &[
    P::any(0, H2, "Pack Configuration", "hex").unproven().by(QUOTED),
    P::any(2, H1, "Pack Configuration B", "hex").unproven().by(QUOTED),
    P::any(3, H1, "Pack Configuration C", "hex").unproven().by(QUOTED),
    P::any(4, H1, "Pack Configuration D", "hex").unproven().by(QUOTED),
];

#[rustfmt::skip]
static DF_IT_CFG: &[P] = &[
    P::any(0, U1, "Load Select", "Num").unproven().by(QUOTED),
    P::any(1, U1, "Load Mode", "Num").unproven().by(QUOTED_AND_ACTED),
    P::any(64, I2, "Terminate Voltage", "mV").unproven().by(QUOTED),
    P::any(66, I2, "Term V Delta", "mV").unproven().by(QUOTED),
    P::any(73, I2, "User Rate-mA", "mA").unproven().by(QUOTED),
    P::any(75, I2, "User Rate-Pwr", "mW/cW").unproven().by(QUOTED),
    P::any(77, I2, "Reserve Cap-mAh", "mAh").unproven().by(QUOTED),
    P::any(79, I2, "Reserve Energy", "mWh/cWh").unproven().by(QUOTED_ALONE),
    P::any(88, U1, "Max Sim Rate", "Hr rate").unproven().by(QUOTED),
    P::any(89, U1, "Min Sim Rate", "Hr rate").unproven().by(QUOTED),
    P::any(92, I2, "Trace Resistance", "mΩ").unproven().by(QUOTED),
    P::any(94, I2, "Downstream Resistance", "mΩ").unproven().by(QUOTED),
];

#[rustfmt::skip]
static DF_CURRENT_THRESHOLDS: &[P] = &[
    P::int(0, I2, "Dsg Current Threshold", -32768, 32767, 60, "mA").unprinted().unproven().by(SEEN),
    P::int(2, I2, "Chg Current Threshold", -32768, 32767, 75, "mA").unprinted().unproven().by(SEEN),
    P::int(4, I2, "Quit Current", -32768, 32767, 40, "mA").unprinted().unproven().by(SEEN),
    P::int(6, U2, "Dsg Relax Time", 0, 65535, 60, "s").unprinted().unproven().by(SEEN),
    P::int(8, U1, "Chg Relax Time", 0, 255, 60, "s").unprinted().unproven().by(SEEN),
    P::int(9, I2, "Max IR Correct", -32768, 32767, 400, "mV").unprinted().unproven().by(SEEN_BY_DEFAULT),
];

#[rustfmt::skip]
static DF_STATE: &[P] = &[
    P::any(0, I2, "Qmax Cell 0", "mAh").learned().unproven().by(QUOTED),
    P::any(2, H1, "Update Status", "hex").learned().unproven().by(QUOTED),
    P::any(3, I2, "V at Chg Term", "mV").learned().unproven().by(QUOTED),
    P::any(5, I2, "Avg I Last Run", "mA").learned().unproven().by(QUOTED),
    P::any(7, I2, "Avg P Last Run", "mW/cW").learned().unproven().by(QUOTED),
    P::any(9, I2, "Delta Voltage", "mV").learned().unproven().by(QUOTED),
];

#[rustfmt::skip]
static DF_R_A0: &[P] = &[
    P::any(0, H2, "Cell0 R_a flag", "hex").learned().unproven().by(QUOTED),
    P::any(2, I2, "Cell0 R_a 0", "Num").learned().unproven().by(QUOTED),
    P::any(4, I2, "Cell0 R_a 1", "Num").learned().unproven().by(QUOTED),
    P::any(6, I2, "Cell0 R_a 2", "Num").learned().unproven().by(QUOTED),
    P::any(8, I2, "Cell0 R_a 3", "Num").learned().unproven().by(QUOTED),
    P::any(10, I2, "Cell0 R_a 4", "Num").learned().unproven().by(QUOTED),
    P::any(12, I2, "Cell0 R_a 5", "Num").learned().unproven().by(QUOTED),
    P::any(14, I2, "Cell0 R_a 6", "Num").learned().unproven().by(QUOTED),
    P::any(16, I2, "Cell0 R_a 7", "Num").learned().unproven().by(QUOTED),
    P::any(18, I2, "Cell0 R_a 8", "Num").learned().unproven().by(QUOTED),
    P::any(20, I2, "Cell0 R_a 9", "Num").learned().unproven().by(QUOTED),
    P::any(22, I2, "Cell0 R_a 10", "Num").learned().unproven().by(QUOTED),
    P::any(24, I2, "Cell0 R_a 11", "Num").learned().unproven().by(QUOTED),
    P::any(26, I2, "Cell0 R_a 12", "Num").learned().unproven().by(QUOTED),
    P::any(28, I2, "Cell0 R_a 13", "Num").learned().unproven().by(QUOTED),
    P::any(30, I2, "Cell0 R_a 14", "Num").learned().unproven().by(QUOTED),
];

#[rustfmt::skip]
static DF_R_A0X: &[P] = &[
    P::any(0, H2, "xCell0 R_a flag", "hex").learned().unproven().by(QUOTED),
    P::any(2, I2, "xCell0 R_a 0", "Num").learned().unproven().by(QUOTED),
    P::any(4, I2, "xCell0 R_a 1", "Num").learned().unproven().by(QUOTED),
    P::any(6, I2, "xCell0 R_a 2", "Num").learned().unproven().by(QUOTED),
    P::any(8, I2, "xCell0 R_a 3", "Num").learned().unproven().by(QUOTED),
    P::any(10, I2, "xCell0 R_a 4", "Num").learned().unproven().by(QUOTED),
    P::any(12, I2, "xCell0 R_a 5", "Num").learned().unproven().by(QUOTED),
    P::any(14, I2, "xCell0 R_a 6", "Num").learned().unproven().by(QUOTED),
    P::any(16, I2, "xCell0 R_a 7", "Num").learned().unproven().by(QUOTED),
    P::any(18, I2, "xCell0 R_a 8", "Num").learned().unproven().by(QUOTED),
    P::any(20, I2, "xCell0 R_a 9", "Num").learned().unproven().by(QUOTED),
    P::any(22, I2, "xCell0 R_a 10", "Num").learned().unproven().by(QUOTED),
    P::any(24, I2, "xCell0 R_a 11", "Num").learned().unproven().by(QUOTED),
    P::any(26, I2, "xCell0 R_a 12", "Num").learned().unproven().by(QUOTED),
    P::any(28, I2, "xCell0 R_a 13", "Num").learned().unproven().by(QUOTED),
    P::any(30, I2, "xCell0 R_a 14", "Num").learned().unproven().by(QUOTED),
];

/// The classes with rows in a public source.
#[rustfmt::skip]
static SUBCLASSES: &[Subclass] = &[
    class("Configuration", "Data", 48, 24, DF_DATA),
    class("Configuration", "Registers", 64, 5, DF_REGISTERS),
    class("Gas Gauging", "IT Cfg", 80, 96, DF_IT_CFG),
    class("Gas Gauging", "Current Thresholds", 81, 11, DF_CURRENT_THRESHOLDS),
    class("Gas Gauging", "State", 82, 11, DF_STATE),
    class("Ra Tables", "R_a0", 88, 32, DF_R_A0),
    class("Ra Tables", "R_a0x", 89, 32, DF_R_A0X),
];
