// SPDX-License-Identifier: MIT

//! The bq27441-G1A with its data memory as ROM has it, and the bq27421-G1, which a host cannot distinguish
//! from it but by DM_CODE.
//!
//! Data memory is from SLUUAC9A tables 6-2 to 6-6. Private bytes are from the image of a shipped product, in
//! every block in which that image has the documented defaults.

use std::time::Duration;

use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{CHG, DSG, FC, Learns, Map, OCVTAKEN, OT, SOC1, SOCF, Settings, UT};
use super::learning::QMAX;
use super::model::Host;
use super::part::Action::*;
use super::part::{Action, BlockPart, DataMemory, Detection, Own, Part, Scheme, Status};
use super::seal::Level::{self, Sealed as Anyone, Unsealed};
use super::timing::Timing;
use super::update::Exit;

/// The bq27441-G1A.
pub(super) static PART: Part = Part {
    name: "bq27441-g1",
    image: IMAGE,
    timing: TIMING,
    scheme: Scheme::Block(&SCHEME),
    rewrites: REWRITES,
};

/// The bq27421-G1A. It differs in DM_CODE only, whose value is not documented.
pub(super) static BQ27421: Part = Part {
    name: "bq27421-g1",
    image: IMAGE,
    timing: TIMING,
    scheme: Scheme::Block(&BlockPart { code: 0x0001, ..SCHEME }),
    rewrites: REWRITES,
};

/// Qmax, Avg I Last Run, R_a, Board Offset and CC Offset.
static REWRITES: &[(u16, usize, usize)] =
    &[(82, 0, 2), (82, 35, 2), (89, 0, 2), (89, 8, 2), (104, 0, 1), (105, 0, 2)];

/// CONFIG UPDATE takes up to a second each way (3.1), and RAM is written at once.
pub(super) const TIMING: Timing = Timing {
    update_enter: Duration::from_secs(1),
    update_leave: Duration::from_secs(1),
    word: Duration::ZERO,
    ..Timing::USUAL
};

pub(super) const SCHEME: BlockPart = BlockPart {
    // SLUSBH1C, device comparison.
    code: 0x0048,
    map: Map { settings, registers: REGISTERS, flags: FLAGS, cycles: None, lifetime: None, learned: LEARNS },
    subcommands: SUBCOMMANDS,
    status: STATUS,
    // 4.1.5.
    remembered: 0x0015,
    last_register: 0x7F,
    flags_register: 0x06,
    voltage_register: 0x04,
    host_registers: &[(0x02, Host::Temperature)],
    keys: &[0],
    data_memory: Some(DataMemory { seals: UPDATE_STATUS, gain_sign: None }),
    gate: None,
    authentication: None,
    sealed_blocks: &[],
    sealed_writes: None,
    // OpConfig [BIE], table 6-7.
    detection: Detection::PinIf(64, 0, 0x20),
    own: OWN,
    rom: None,
    protector: None,
};

/// Bit 7 of Update Status (6.4.2.3.2).
pub(super) const UPDATE_STATUS: (u16, usize, u8) = (82, 2, 0x80);

/// The family stores Qmax alone: the low bits of Update Status are set by the host, for a learning cycle (6.4.2.3.2).
pub(super) const LEARNS: Option<Learns> =
    Some(Learns { qmax: (82, 0), of_design: true, count: None, status: None });

pub(super) const OWN: Own = Own {
    update_status: None,
    cc_offset: None,
    board_offset: None,
    load_mode: Some((82, 5)),
    calibration: None,
    sleep: Some(((64, 0, 0x0020), (82, 31))),
    settle: None,
    chemistry: None,
};

/// Table 4-2. The chemistry is the G1A's (4.1.6), the firmware version is what parts answer.
#[rustfmt::skip]
static SUBCOMMANDS: &[(u16, Level, Action)] = &[
    (0x0000, Anyone, ControlStatus),
    (0x0001, Anyone, Answer(0x0421)),
    (0x0002, Anyone, Answer(0x0109)),
    (0x0004, Anyone, AnswerCode),
    (0x0007, Anyone, Previous),
    (0x0008, Anyone, Answer(0x0128)),
    (0x000C, Anyone, BatteryInsert(true)),
    (0x000D, Anyone, BatteryInsert(false)),
    (0x0011, Anyone, Set(Status::Hibernate)),
    (0x0012, Anyone, Clear(Status::Hibernate)),
    (0x0013, Unsealed, ConfigUpdate),
    (0x001B, Unsealed, Set(Status::ShutdownArmed)),
    (0x001C, Unsealed, Shutdown),
    (0x0020, Unsealed, Seal),
    (0x0041, Unsealed, Reset),
    (0x0042, Unsealed, Leave(Exit::Anew)),
    (0x0043, Unsealed, Leave(Exit::Plain)),
    (0x0044, Unsealed, Leave(Exit::Anew)),
];

/// CONTROL_STATUS, table 4-3.
#[rustfmt::skip]
pub(super) static STATUS: &[(Status, u16)] = &[
    (Status::ShutdownArmed, 0x8000),
    (Status::WatchdogReset, 0x4000),
    (Status::Sealed,        0x2000),
    (Status::Initialized,   0x0080),
    (Status::Hibernate,     0x0040),
    (Status::Sleep,         0x0010),
    (Status::LoadMode,      0x0008),
];

/// Flags(), table 4-4, without `[ITPOR]`, `[CFGUPMODE]` and `[BAT_DET]`.
#[rustfmt::skip]
pub(super) static FLAGS: &[(u32, u16)] = &[
    (OT, 0x8000), (UT, 0x4000), (FC, 0x0200), (CHG, 0x0100), (OCVTAKEN, 0x0080), (SOC1, 0x0004),
    (SOCF, 0x0002), (DSG, 0x0001),
];

/// Standard commands, table 4-1, and the copies of table 5-1.
#[rustfmt::skip]
static REGISTERS: &[(u8, usize, Q)] = &[
    (0x02, 2, Q::Temperature),
    (0x04, 2, Q::Voltage),
    (0x06, 2, Q::Flags),
    (0x08, 2, Q::NominalRemaining),
    (0x0A, 2, Q::NominalFull),
    (0x0C, 2, Q::Remaining),
    (0x0E, 2, Q::Full),
    (0x10, 2, Q::AverageCurrent),
    (0x12, 2, Q::StandbyCurrent),
    (0x14, 2, Q::MaxLoadCurrent),
    (0x18, 2, Q::AveragePower),
    (0x1C, 2, Q::Percent),
    (0x1E, 2, Q::InternalTemperature),
    (0x20, 1, Q::Health),
    (0x21, 1, Q::HealthStatus),
    (0x28, 2, Q::Remaining),
    (0x2A, 2, Q::Remaining),
    (0x2C, 2, Q::Full),
    (0x2E, 2, Q::Full),
    (0x30, 2, Q::Percent),
    (0x3A, 2, Q::PackConfiguration),
    (0x3C, 2, Q::DesignCapacity),
];

fn settings(flash: &Flash) -> Settings {
    let i16 = |id, offset| f64::from(flash.i16(id, offset));
    let i8 = |id, offset| f64::from(flash.u8(id, offset) as i8);
    Settings {
        pack: flash.u16(64, 0),
        // OpConfig [TEMPS].
        host_temperature: flash.u16(64, 0) & 0x0001 != 0,
        // 6.4.2.3.1: Qmax Cell 0 is a fraction of Design Capacity.
        taper_mv: i16(82, 33) - i16(82, 29),
        charge_mv: [flash.u16(82, 33); 3],
        taper_ma: rate(flash, 10, flash.u16(82, 27)),
        standby_ma: i8(48, 2),
        max_load_ma: i16(48, 3),
        ..family(flash, 10)
    }
}

/// A current that is given as a rate: Design Capacity, at offset `design` of the class State, divided by
/// tenths of an hour.
pub(super) fn rate(flash: &Flash, design: usize, tenths: u16) -> f64 {
    f64::from(flash.i16(82, design)) * 10.0 / f64::from(tenths.max(1))
}

/// The parameters that all parts of the family have in the same places.
pub(super) fn family(flash: &Flash, design: usize) -> Settings {
    let i16 = |id, offset| f64::from(flash.i16(id, offset));
    let u8 = |id, offset| f64::from(flash.u8(id, offset));
    let i8 = |id, offset| flash.u8(id, offset) as i8;
    let design_mah = i16(82, design);
    let percent = |offset| (design_mah * u8(49, offset) / 100.0).round() as u16;
    Settings {
        over: (i16(2, 0), u8(2, 4)),
        under: (i16(2, 2), u8(2, 4)),
        charge_alert: (i8(36, 3), i8(36, 4)),
        full: (i8(36, 5), i8(36, 6)),
        design_mah: flash.u16(82, design),
        soc1: (percent(0), percent(1)),
        socf: (percent(2), percent(3)),
        full_at_taper: flash.u16(64, 0) & 0x0010 != 0,
        reserve_mah: i16(82, 3).max(0.0),
        discharge_ma: rate(flash, design, flash.u16(81, 0)),
        charge_ma: rate(flash, design, flash.u16(81, 2)),
        quit_ma: rate(flash, design, flash.u16(81, 4)),
        relax_s: (f64::from(flash.u16(81, 6)), u8(81, 8)),
        internal_offset: f64::from(i8(104, 1)),
        deadband_ma: u8(107, 1),
        qmax_mah: (i16(82, 0) * design_mah / 16384.0).max(1.0),
        // In ROM there is a Qmax already.
        learned: QMAX,
        ..Settings::none()
    }
}

#[rustfmt::skip]
static IMAGE: Image = &[
    // Safety
    (2, &[0x02, 0x26, 0x00, 0x00, 0x32]),
    // Charge Termination
    (36, &[0x00, 0x19, 0x28, 0x63, 0x5F, 0xFF, 0x62, 0x00, 0x32]),
    // Data
    (48, &[0x0E, 0x74, 0xFD, 0xFF, 0x38]),
    // Discharge
    (49, &[0x0A, 0x0F, 0x02, 0x05, 0x32]),
    // Registers
    (64, &[0x25, 0xF8, 0x0F, 0x48, 0x00, 0x14, 0x04, 0x00, 0x09]),
    // Power
    (68, &[0x05, 0x00, 0x32, 0x01, 0xC2, 0x14, 0x14, 0x00, 0x03, 0x08, 0x98, 0x01, 0x00]),
    // IT Cfg
    (80, &[0x02, 0xBC, 0x01, 0x2C, 0x00, 0x1E, 0x00, 0xC8, 0xC8, 0x14, 0x08, 0x00, 0x3C, 0x0E, 0x10, 0x00,
           0x0A, 0x46, 0x05, 0x14, 0x05, 0x0F, 0x03, 0x20, 0x00, 0x64, 0x46, 0x50, 0x0A, 0x01, 0x90, 0x00,
           0x64, 0x19, 0xDC, 0x5C, 0x60, 0x00, 0x7D, 0x00, 0x04, 0x03, 0x19, 0x25, 0x0F, 0x14, 0x0A, 0x78,
           0x60, 0x28, 0x01, 0xF4, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x43, 0x80, 0x04, 0x01, 0x14, 0x00,
           0x0B, 0x0B, 0xB8, 0x01, 0x2C, 0x0A, 0x01, 0x0A, 0x00, 0x00, 0x00, 0xC8, 0x00, 0x64, 0x02]),
    // Current Thresholds
    (81, &[0x00, 0xA7, 0x00, 0x64, 0x00, 0xFA, 0x00, 0x3C, 0x3C, 0x01, 0xB3, 0xB3, 0x01, 0x90]),
    // State
    (82, &[0x40, 0x00, 0x00, 0x00, 0x00, 0x81, 0x0E, 0xDB, 0x0E, 0xA8, 0x05, 0x3C, 0x13, 0x60, 0x05, 0x3C,
           0x0C, 0x80, 0x00, 0xC8, 0x00, 0x32, 0x00, 0x14, 0x03, 0xE8, 0x01, 0x00, 0x64, 0x10, 0x04, 0x00,
           0x0A, 0x10, 0x5E, 0xFF, 0xCE, 0xFF, 0xCE, 0x00, 0x01]),
    // R_a RAM
    (89, &[0x00, 0x66, 0x00, 0x66, 0x00, 0x63, 0x00, 0x6B, 0x00, 0x48, 0x00, 0x3B, 0x00, 0x3E, 0x00, 0x3F,
           0x00, 0x35, 0x00, 0x2F, 0x00, 0x3C, 0x00, 0x46, 0x00, 0x8C, 0x01, 0x71, 0x02, 0x4C]),
    // Data
    (104, &[0x00, 0x00, 0x00]),
    // CC Cal
    (105, &[0x00, 0x00, 0x0B, 0xA6, 0x80, 0x2C, 0x3B, 0xA3, 0x94, 0x43, 0x26, 0xD2]),
    // Current
    (107, &[0x00, 0x05]),
    // Codes
    (112, &[0x80, 0x00, 0x80, 0x00]),
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// 82, 89 and 2 follow from the defaults, and a part has returned 82/0. The others are from the image of
    /// the product.
    #[test]
    fn blocks_have_the_checksums_of_parts() {
        check_sums(
            IMAGE,
            &[
                (82, 0, 0xAC),
                (82, 1, 0xEC),
                (89, 0, 0x33),
                (2, 0, 0xA5),
                (112, 0, 0xFF),
                (36, 0, 0x69),
                (48, 0, 0x49),
                (49, 0, 0xAD),
                (68, 0, 0x39),
                (80, 0, 0xBB),
                (80, 1, 0x2A),
                (80, 2, 0xC1),
                (81, 0, 0x8A),
            ],
        );
    }
}
