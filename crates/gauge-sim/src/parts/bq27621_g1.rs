// SPDX-License-Identifier: MIT

//! The bq27621-G1, which has no sense resistor, with its data memory as ROM has it.
//!
//! Commands are those of Chromium's driver, places in data memory those of TI's sample image, and its values
//! where the bq27441-G1 has the same. Its ROM has not been published: other values are the bq27441-G1's, and
//! those of the chemistry are invented, each class filled with its own number. The estimate of the current
//! is as good as a measurement here.

use super::bq27441_g1::{self, OWN, TIMING};
use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{Map, Settings};
use super::learning::QMAX;
use super::part::Action::*;
use super::part::{Action, BlockPart, DataMemory, Own, Part, Scheme, Status};
use super::seal::Level::{self, Sealed as Anyone, Unsealed};
use super::update::Exit;

pub(super) static PART: Part = Part {
    name: "bq27621-g1",
    image: IMAGE,
    timing: TIMING,
    scheme: Scheme::Block(&SCHEME),
    rewrites: REWRITES,
};

/// Qmax, Avg I Last Run and R_a.
static REWRITES: &[(u16, usize, usize)] = &[(82, 0, 2), (82, 28, 2), (85, 0, 2), (85, 8, 2)];

static SCHEME: BlockPart = BlockPart {
    // There is no DM_CODE.
    code: 0,
    map: Map { settings, registers: REGISTERS, ..bq27441_g1::SCHEME.map },
    subcommands: SUBCOMMANDS,
    status: STATUS,
    // OpConfigB [DEF_SEAL].
    data_memory: Some(DataMemory { seals: (64, 2, 0x20), gain_sign: None }),
    // No bit of OpConfig is known to allow SLEEP.
    own: Own { load_mode: Some((82, 2)), sleep: None, ..OWN },
    ..bq27441_g1::SCHEME
};

/// The firmware version is what TI's image expects.
#[rustfmt::skip]
static SUBCOMMANDS: &[(u16, Level, Action)] = &[
    (0x0000, Anyone, ControlStatus),
    (0x0001, Anyone, Answer(0x0621)),
    (0x0002, Anyone, Answer(0x0105)),
    (0x0007, Anyone, Previous),
    (0x0008, Anyone, AnswerChemistry(0x1202)),
    (0x000C, Anyone, BatteryInsert(true)),
    (0x000D, Anyone, BatteryInsert(false)),
    (0x0011, Anyone, Set(Status::Hibernate)),
    (0x0012, Anyone, Clear(Status::Hibernate)),
    (0x0013, Unsealed, ConfigUpdate),
    (0x001B, Unsealed, Set(Status::ShutdownArmed)),
    (0x001C, Unsealed, Shutdown),
    (0x0020, Unsealed, Seal),
    (0x0031, Unsealed, Chemistry(0x1210)),
    (0x0032, Unsealed, Chemistry(0x0354)),
    (0x0041, Unsealed, Reset),
    (0x0042, Unsealed, Leave(Exit::Anew)),
    (0x0043, Unsealed, Leave(Exit::Plain)),
    (0x0044, Unsealed, Leave(Exit::Anew)),
];

/// CONTROL_STATUS.
#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::ShutdownArmed,    0x8000),
    (Status::WatchdogReset,    0x4000),
    (Status::Sealed,           0x2000),
    (Status::Initialized,      0x0080),
    (Status::Hibernate,        0x0040),
    (Status::Sleep,            0x0010),
    (Status::LoadMode,         0x0008),
    (Status::ChemistryChanged, 0x0001),
];

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
    (0x18, 2, Q::AveragePower),
    (0x1C, 2, Q::Percent),
    (0x1E, 2, Q::InternalTemperature),
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
    let u8 = |id, offset| f64::from(flash.u8(id, offset));
    let i8 = |id, offset| flash.u8(id, offset) as i8;
    let design_mah = i16(82, 3);
    let rate = |tenths: u16| design_mah * 10.0 / f64::from(tenths.max(1));
    let percent = |offset| (design_mah * u8(49, offset) / 100.0).round() as u16;
    Settings {
        pack: flash.u16(64, 0),
        // OpConfig [TEMPS].
        host_temperature: flash.u16(64, 0) & 0x0001 != 0,
        over: (i16(2, 0), u8(2, 4)),
        under: (i16(2, 2), u8(2, 4)),
        charge_alert: (i8(36, 3), i8(36, 4)),
        full: (i8(36, 5), i8(36, 6)),
        taper_mv: i16(82, 26) - i16(82, 22),
        charge_mv: [flash.u16(82, 26); 3],
        taper_ma: rate(flash.u16(82, 20)),
        design_mah: flash.u16(82, 3),
        soc1: (percent(0), percent(1)),
        socf: (percent(2), percent(3)),
        // OpConfig [RMFCC].
        full_at_taper: flash.u16(64, 0) & 0x0010 != 0,
        discharge_ma: rate(flash.u16(81, 0)),
        charge_ma: rate(flash.u16(81, 2)),
        quit_ma: rate(flash.u16(81, 4)),
        relax_s: (f64::from(flash.u16(81, 6)), u8(81, 8)),
        internal_offset: f64::from(i8(104, 1)),
        // Qmax Cell 0 is a fraction of Design Capacity, as in the family.
        qmax_mah: (i16(82, 0) * design_mah / 16384.0).max(1.0),
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
    (64, &[0xB4, 0xD8, 0x0C, 0x01, 0x00, 0xC8, 0x04, 0x00, 0x09]),
    // Power
    (68, &[0x14, 0x00, 0x03, 0x08, 0x98]),
    // IT Cfg
    (80, &[0x02, 0xBC, 0x01, 0x2C, 0x00, 0x1E, 0x00, 0xC8, 0xC8, 0x14, 0x08, 0x00, 0x3C, 0x0E, 0x10, 0x00,
           0x0A, 0x46, 0x14, 0x05, 0x0F, 0x03, 0x20, 0x00, 0x64, 0x46, 0x50, 0x0A, 0x19, 0x28, 0x01, 0xF4,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x43, 0x80, 0x04, 0x01, 0x14, 0x00, 0x0B, 0x0B,
           0xB8, 0x01, 0x2C, 0x0A, 0x01, 0x0A, 0x00, 0x00, 0x00, 0xC8, 0x00, 0x64, 0x02, 0x5A, 0x20, 0x64,
           0x0F, 0x02, 0x00, 0x05, 0x04, 0xB0, 0x0F]),
    // Current Thresholds
    (81, &[0x00, 0xA7, 0x00, 0x64, 0x00, 0xFA, 0x00, 0x3C, 0x3C, 0x01, 0xB3, 0xB3, 0x01, 0x90]),
    // State
    (82, &[0x40, 0x00, 0x81, 0x05, 0x3C, 0x13, 0x60, 0x05, 0x3C, 0x0C, 0x80, 0x00, 0xC8, 0x00, 0x32, 0x00,
           0x14, 0x03, 0xE8, 0x01, 0x00, 0x64, 0x10, 0x04, 0x00, 0x0A, 0x10, 0x5E, 0xFF, 0xCE, 0xFF, 0xCE,
           0x00, 0x01, 0x02, 0xBC, 0x12, 0x02]),
    // Chemistry
    (83, &[0x53; 41]),
    (84, &[0x54; 42]),
    // R_a RAM, the bq27441-G1A's
    (85, &[0x00, 0x66, 0x00, 0x66, 0x00, 0x63, 0x00, 0x6B, 0x00, 0x48, 0x00, 0x3B, 0x00, 0x3E, 0x00, 0x3F,
           0x00, 0x35, 0x00, 0x2F, 0x00, 0x3C, 0x00, 0x46, 0x00, 0x8C, 0x01, 0x71, 0x02, 0x4C]),
    (86, &[0x56; 17]),
    (108, &[0x6C; 17]),
    (92, &[0x5C; 16]),
    (93, &[0x5D; 16]),
    (94, &[0x5E; 16]),
    (95, &[0x5F; 16]),
    // Data, and two without a name
    (104, &[0x00, 0x00, 0x00]),
    (106, &[0x6A; 15]),
    (107, &[0xEF]),
    // Codes
    (112, &[0x80, 0x00, 0x80, 0x00]),
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// Compares the blocks that TI's sample image leaves unchanged.
    #[test]
    fn blocks_have_the_checksums_of_tis_sample_image() {
        check_sums(
            IMAGE,
            &[
                (2, 0, 0xA5),
                (36, 0, 0x69),
                (48, 0, 0x49),
                (49, 0, 0xAD),
                (64, 0, 0x91),
                (68, 0, 0x48),
                (80, 0, 0x1B),
                (80, 1, 0x07),
                (80, 2, 0x26),
                (81, 0, 0x8A),
                (82, 1, 0x2C),
                (104, 0, 0xFF),
                (107, 0, 0x10),
                (112, 0, 0xFF),
            ],
        );
    }
}
