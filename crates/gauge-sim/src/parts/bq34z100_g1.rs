// SPDX-License-Identifier: MIT

//! The bq34z100-G1 as it leaves the factory: its answers, its registers and its data flash in bytes.
//!
//! The flash is from SLUSBZ5D table 7-11, and private bytes are 0. The device name is in lower case, as parts
//! have it and as the checksum of SLUA790 section 2.4 requires.

use std::array;

use super::flash::Flash;
use super::gauging::Quantity as Q;
use super::gauging::{
    BATHI, BATLOW, CF, CHG, CHG_INH, DSG, FC, Learns, Map, OCVTAKEN, OTC, OTD, SOC1, SOCF, Settings, XCHG,
};
use super::part::Action::*;
use super::part::{Action, BlockPart, Detection, Gate, Own, Part, Scheme, Status};
use super::rom::Layout;
use super::seal::Level::{self, FullAccess, Sealed as Anyone, Unsealed};
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq34z100-g1",
    image: &IMAGE,
    timing: Timing::USUAL,
    scheme: Scheme::Block(&SCHEME),
    rewrites: REWRITES,
};

/// Cycle Count, lifetime data and their samples, Qmax and Avg I Last Run, R_a0x, CC Offset and Board Offset.
#[rustfmt::skip]
pub(super) static REWRITES: &[(u16, usize, usize)] = &[
    (48, 6, 2), (59, 0, 2), (59, 4, 2), (59, 8, 2), (60, 0, 2), (82, 0, 2), (82, 7, 2), (89, 2, 2), (89, 16, 2),
    (104, 8, 2), (104, 10, 1),
];

pub(super) const SCHEME: BlockPart = BlockPart {
    code: 0,
    map: Map {
        settings,
        registers: REGISTERS,
        flags: FLAGS,
        cycles: Some((48, 6)),
        lifetime: Some((59, 60)),
        learned: Some(Learns {
            qmax: (82, 0),
            of_design: false,
            count: Some((82, 2)),
            status: Some((82, 4)),
        }),
    },
    subcommands: &SUBCOMMANDS,
    status: STATUS,
    remembered: 0x0020,
    last_register: 0x7F,
    flags_register: 0x0E,
    voltage_register: 0x08,
    host_registers: &[],
    keys: &[0, 4],
    data_memory: None,
    gate: Some(Gate {
        limit: (68, 0),
        divider: Some(((104, 14), (64, 0, 0x0800))),
        cell_divider: Some(5000),
    }),
    authentication: Some((112, 8)),
    // Manufacturer block A, and lifetime data, which can be written (7.3.6.17).
    sealed_blocks: &[(1, 58), (4, 59)],
    sealed_writes: Some(59),
    detection: Detection::None,
    own: Own {
        update_status: Some((82, 4)),
        cc_offset: Some((104, 8)),
        board_offset: Some((104, 10)),
        load_mode: Some((80, 1)),
        calibration: Some((64, 0, 0x4000)),
        sleep: Some(((64, 0, 0x0040), (68, 2))),
        settle: Some((68, 11)),
        chemistry: Some(88),
    },
    rom: Some(LAYOUT),
    protector: None,
};

/// The places of the classes in the rows of an image for ROM mode (bq34z100_dffs.h of github.com/tibms/kernel-4.4 for
/// the G1, BQ34Z100_DFI.c of github.com/DmitrijSarychev/Handy_Files for the R2).
#[rustfmt::skip]
static LAYOUT: Layout = &[
    (104, 0, 16), (82, 68, 17), (80, 85, 93), (32, 400, 6), (34, 406, 14), (36, 420, 27), (64, 447, 8),
    (68, 459, 12), (81, 471, 11), (112, 482, 24), (67, 506, 1), (59, 507, 12), (60, 519, 2), (66, 521, 5),
    (2, 571, 10), (48, 602, 60), (49, 662, 22), (58, 684, 32), (88, 768, 32), (89, 832, 32),
];

/// SLUSBZ5D table 7-2. Answers are those of SLUA790 section 2.3, versions those of production parts.
#[rustfmt::skip]
pub(super) const SUBCOMMANDS: [(u16, Level, Action); 22] = [
    (0x0000, Anyone, ControlStatus),
    (0x0001, Anyone, Answer(0x0100)),
    (0x0002, Anyone, Answer(0x0016)),
    (0x0003, Anyone, Answer(0x0008)),
    (0x0005, Anyone, ResetData),
    (0x0007, Anyone, Previous),
    (0x0008, Anyone, Answer(0x0107)),
    (0x0009, Anyone, BoardOffset),
    (0x000A, Anyone, CcOffset),
    (0x000B, Anyone, WriteCcOffset),
    (0x000C, Anyone, AnswerFrom(56, 10)),
    (0x0010, Anyone, FullSleep),
    (0x0017, Anyone, ChemistryChecksum),
    (0x0020, Unsealed, Seal),
    (0x0021, Unsealed, ItEnable),
    (0x002D, Unsealed, CalEnable),
    (0x0041, Unsealed, Reset),
    (0x0080, Unsealed, ExitCalibration),
    (0x0081, Unsealed, EnterCalibration),
    (0x0082, Unsealed, AnswerOffset),
    (0x0F00, FullAccess, Rom),
    (0x7C40, Anyone, Hdq),
];

/// CONTROL_STATUS, table 7-3.
#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::NotFullAccess, 0x4000),
    (Status::Sealed,        0x2000),
    (Status::Calibrating,   0x1000),
    (Status::CcOffset,      0x0800),
    (Status::BoardOffset,   0x0400),
    (Status::ChecksumValid, 0x0200),
    (Status::Sleep,         0x0010),
    (Status::LoadMode,      0x0008),
    (Status::RaOff,         0x0004),
    (Status::VoltageOk,     0x0002),
    (Status::Enabled,       0x0001),
];

/// Flags(), table 7-6.
#[rustfmt::skip]
static FLAGS: &[(u32, u16)] = &[
    (OTC, 0x8000), (OTD, 0x4000), (BATHI, 0x2000), (BATLOW, 0x1000), (CHG_INH, 0x0800), (XCHG, 0x0400),
    (FC, 0x0200), (CHG, 0x0100), (OCVTAKEN, 0x0080), (CF, 0x0010), (SOC1, 0x0004), (SOCF, 0x0002),
    (DSG, 0x0001),
];

/// Standard commands, table 7-1, and extended ones, table 7-8.
#[rustfmt::skip]
static REGISTERS: &[(u8, usize, Q)] = &[
    (0x02, 1, Q::Percent),
    (0x03, 1, Q::MaxError),
    (0x04, 2, Q::Remaining),
    (0x06, 2, Q::Full),
    (0x08, 2, Q::Voltage),
    (0x0A, 2, Q::AverageCurrent),
    (0x0C, 2, Q::Temperature),
    (0x0E, 2, Q::Flags),
    (0x10, 2, Q::Current),
    (0x12, 2, Q::FlagsB),
    (0x18, 2, Q::TimeToEmpty),
    (0x1A, 2, Q::TimeToFull),
    (0x1C, 2, Q::PassedCharge),
    (0x1E, 2, Q::DodTime),
    (0x24, 2, Q::AvailableEnergy),
    (0x26, 2, Q::PowerDrawn),
    (0x28, 2, Q::SerialNumber),
    (0x2A, 2, Q::InternalTemperature),
    (0x2C, 2, Q::CycleCount),
    (0x2E, 2, Q::Health),
    (0x30, 2, Q::ChargeVoltage),
    (0x32, 2, Q::ChargeCurrent),
    (0x3A, 2, Q::PackConfiguration),
    (0x3C, 2, Q::DesignCapacity),
    (0x62, 1, Q::Grid),
    (0x63, 1, Q::LearnedStatus),
    (0x64, 2, Q::EndDod),
    (0x66, 2, Q::StartCharge),
    (0x68, 2, Q::Remaining),
    (0x6A, 2, Q::Full),
    (0x6C, 2, Q::StateTime),
    (0x6E, 2, Q::QmaxPassed),
    (0x70, 2, Q::Dod),
    (0x72, 2, Q::Dod),
    (0x74, 2, Q::DodTimeHours),
];

pub(super) fn settings(flash: &Flash) -> Settings {
    let i16 = |id, offset| f64::from(flash.i16(id, offset));
    let u8 = |id, offset| f64::from(flash.u8(id, offset));
    let i8 = |id, offset| flash.u8(id, offset) as i8;
    let u16 = |id, offset| flash.u16(id, offset);
    // Pack Configuration, table 7-17, and Pack Configuration B, table 7-18.
    let (pack, pack_b) = (u16(64, 0), flash.u8(64, 2));
    let (rmfcc, temps, jeita) = (pack & 0x0020 != 0, pack & 0x0001 != 0, pack_b & 0x08 != 0);
    Settings {
        ot_charge: (i16(2, 0), u8(2, 2), i16(2, 3)),
        ot_discharge: (i16(2, 5), u8(2, 7), i16(2, 8)),
        inhibit: (i16(32, 0), i16(32, 2), i16(32, 4)),
        suspend: (i16(34, 0), i16(34, 2)),
        taper_ma: i16(36, 0),
        taper_mv: i16(36, 4),
        taper_s: u8(36, 6),
        charge_alert: (i8(36, 7), i8(36, 8)),
        full: (i8(36, 9), i8(36, 10)),
        serial: u16(48, 4),
        cycle_mah: i16(48, 8).max(1.0),
        cycles: u16(48, 6),
        max_error_limit: flash.u8(48, 10),
        design_mah: u16(48, 11),
        charge_mv: [u16(48, 17), u16(48, 19), u16(48, 21)],
        charge_percent: [flash.u8(48, 23), flash.u8(48, 24), flash.u8(48, 25)],
        jeita: jeita.then(|| array::from_fn(|i| f64::from(i8(48, 26 + i)) * 10.0)),
        energy_scale: u8(48, 30).max(1.0),
        soc1: (u16(49, 0), u16(49, 2)),
        socf: (u16(49, 4), u16(49, 6)),
        low_mv: (i16(49, 8), u8(49, 10), i16(49, 11)),
        high_mv: (i16(49, 13), u8(49, 15), i16(49, 16)),
        // [CAL_EN] is shown as it stands in the running copy.
        pack: pack & !0x4000,
        full_at_taper: rmfcc,
        thermistor: temps,
        reserve_mah: i16(80, 66).max(0.0),
        discharge_ma: i16(81, 0),
        charge_ma: i16(81, 2),
        quit_ma: i16(81, 4),
        relax_s: (f64::from(u16(81, 6)), u8(81, 8)),
        internal_offset: f64::from(i8(104, 11)),
        external_offset: f64::from(i8(104, 12)),
        gain: flash.f4(104, 0),
        board_offset: f64::from(i8(104, 10)),
        cc_offset: i16(104, 8),
        deadband_ma: u8(107, 1),
        cells: u8(64, 7).max(1.0),
        qmax_mah: i16(82, 0).max(1.0),
        enabled: flash.u8(82, 4) & 0x04 != 0,
        learned: flash.u8(82, 4) & 0x0B,
        lifetime_s: f64::from(u16(66, 3)),
        lifetime_step: [u8(66, 0), u8(66, 1), u8(66, 2)],
        lifetime: array::from_fn(|i| match i {
            4 | 5 => f64::from(u16(59, 2 * i)),
            _ => i16(59, 2 * i),
        }),
        ..Settings::none()
    }
}

#[rustfmt::skip]
pub(super) const IMAGE: [(u16, &[u8]); 22] = [
    // Safety
    (2, &[0x02, 0x26, 0x02, 0x01, 0xF4, 0x02, 0x58, 0x02, 0x02, 0x26]),
    // Charge Inhibit Cfg
    (32, &[0x00, 0x00, 0x01, 0xC2, 0x00, 0x32]),
    // Charge
    (34, &[0xFF, 0xCE, 0x02, 0x26, 0x64, 0x7B, 0x20, 0x00, 0x00, 0x60, 0x7E, 0x00, 0x00, 0x00]),
    // Charge Termination
    (36, &[0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28, 0x63, 0x5F, 0x64, 0x62, 0x00, 0x64, 0x00, 0x1E, 0x00,
           0xB4, 0x00, 0x64, 0x00, 0xF0, 0x00, 0xFA, 0x11, 0x10, 0x10, 0x68]),
    // Data
    (48, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x03, 0x84, 0x64, 0x03, 0xE8, 0x15, 0x18, 0xFE,
           0x70, 0x10, 0x68, 0x10, 0x68, 0x10, 0x04, 0x0A, 0x32, 0x1E, 0xF6, 0x0A, 0x2D, 0x37, 0x01, 0x0B,
           0x62, 0x71, 0x33, 0x34, 0x7A, 0x31, 0x30, 0x30, 0x2D, 0x47, 0x31, 0x0B, 0x54, 0x65, 0x78, 0x61,
           0x73, 0x20, 0x49, 0x6E, 0x73, 0x74, 0x2E, 0x04, 0x4C, 0x49, 0x4F, 0x4E]),
    // Discharge
    (49, &[0x00, 0x96, 0x00, 0xAF, 0x00, 0x4B, 0x00, 0x64, 0x00, 0x00, 0x00, 0x00, 0x05, 0x10, 0xCC, 0x02,
           0x00, 0x05, 0x00, 0x00, 0x00, 0x05]),
    // Manufacturer Data
    (56, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // Lifetime Data
    (59, &[0x01, 0x2C, 0x00, 0xC8, 0x00, 0x00, 0x00, 0x00, 0x01, 0x40, 0x01, 0x5E]),
    // Lifetime Temp Samples
    (60, &[0x00, 0x00]),
    // Registers
    (64, &[0x01, 0x61, 0xFF, 0x30, 0x00, 0x00, 0x00, 0x01]),
    // Lifetime Resolution
    (66, &[0x0A, 0x64, 0x01, 0x00, 0x3C]),
    // LED Display
    (67, &[0x04]),
    // Power
    (68, &[0x0A, 0xF0, 0x00, 0x0A, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // Manufacturer Info
    (58, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // IT Cfg
    (80, &[0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x00, 0x00, 0x32, 0x01,
           0x00, 0x01, 0xF4, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x32,
           0x00, 0x64, 0x00, 0x00, 0x00, 0x0B, 0xB8, 0x00, 0xC8, 0x00, 0x01, 0xF4, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x04, 0x00, 0x00, 0x0F, 0x00, 0x2A, 0x04, 0x0A,
           0x7D, 0x00, 0x00, 0x01, 0x0A, 0x00, 0x00, 0x00, 0x00, 0x00, 0x28, 0x03, 0xE8]),
    // Current Thresholds
    (81, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28, 0x00, 0x3C, 0x3C, 0x01, 0x90]),
    // State
    (82, &[0x03, 0xE8, 0x00, 0x00, 0x00, 0x10, 0x68, 0xFE, 0xD5, 0xFB, 0x95, 0x00, 0x02, 0x00, 0x14, 0x03,
           0xE8]),
    // R_a0
    (88, &[0xFF, 0x55, 0x00, 0x69, 0x00, 0x64, 0x00, 0x71, 0x00, 0x8F, 0x00, 0x62, 0x00, 0x61, 0x00, 0x6C,
           0x00, 0x59, 0x00, 0x56, 0x00, 0x55, 0x00, 0x57, 0x00, 0x5A, 0x00, 0x6E, 0x02, 0x87, 0x05, 0xDC]),
    // R_a0x
    (89, &[0xFF, 0xFF, 0x00, 0x69, 0x00, 0x64, 0x00, 0x71, 0x00, 0x8F, 0x00, 0x62, 0x00, 0x61, 0x00, 0x6C,
           0x00, 0x59, 0x00, 0x56, 0x00, 0x55, 0x00, 0x57, 0x00, 0x5A, 0x00, 0x6E, 0x02, 0x87, 0x05, 0xDC]),
    // Data
    (104, &[0x7F, 0x74, 0x1F, 0x21, 0x94, 0x0A, 0x9C, 0x09, 0xFB, 0x50, 0x00, 0x00, 0x00, 0x00, 0x13, 0x88]),
    // Current
    (107, &[0x00, 0x05]),
    // Codes
    (112, &[0x36, 0x72, 0x04, 0x14, 0xFF, 0xFF, 0xFF, 0xFF, 0x01, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF,
            0xFE, 0xDC, 0xBA, 0x98, 0x76, 0x54, 0x32, 0x10]),
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// 64/0 follows from SLUSBZ5D 7.3.3.1. 48/1 is in SLUA790 2.4, except for the chemistry. The others are
    /// sums over table 7-11, calculated by hand.
    #[test]
    fn blocks_have_the_checksums_of_the_manual() {
        check_sums(
            &IMAGE,
            &[
                (2, 0, 0x5C),
                (48, 0, 0xBF),
                (48, 1, 0xE3),
                (64, 0, 0x6D),
                (68, 0, 0xFB),
                (80, 0, 0xCC),
                (80, 1, 0xE9),
                (80, 2, 0x19),
                (82, 0, 0x38),
                (104, 0, 0xA3),
                (112, 0, 0x4B),
            ],
        );
    }

    #[test]
    fn subclasses_have_the_lengths_of_the_manual() {
        let lengths: Vec<_> = IMAGE.iter().map(|(id, bytes)| (*id, bytes.len())).collect();
        assert_eq!(
            lengths,
            [
                (2, 10),
                (32, 6),
                (34, 14),
                (36, 27),
                (48, 60),
                (49, 22),
                (56, 12),
                (59, 12),
                (60, 2),
                (64, 8),
                (66, 5),
                (67, 1),
                (68, 12),
                (58, 32),
                (80, 93),
                (81, 11),
                (82, 17),
                (88, 32),
                (89, 32),
                (104, 16),
                (107, 2),
                (112, 24),
            ]
        );
    }
}
