// SPDX-License-Identifier: MIT

//! The BQ27427 with its data memory as ROM has it.
//!
//! The block State is from a trace of a part, with its checksum. Everything else is from SLUUCD5 and from the
//! image of a shipped product, private bytes included. Calibration that nobody has published is the
//! bq27441-G1's. The sign of CC Gain differs between specimens: it is positive here, and a knob makes it
//! negative.

use std::time::Duration;

use super::bq27441_g1::{self, OWN, UPDATE_STATUS, family, rate};
use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{Map, Settings};
use super::part::Action::*;
use super::part::{Action, BlockPart, DataMemory, Own, Part, Scheme, Status};
use super::seal::Level::{self, Sealed as Anyone, Unsealed};
use super::timing::Timing;
use super::update::Exit;

pub(super) static PART: Part = Part {
    name: "bq27427",
    image: IMAGE,
    timing: TIMING,
    scheme: Scheme::Block(&SCHEME),
    rewrites: REWRITES,
};

/// Qmax, Avg I Last Run, R_a, Board Offset and CC Offset.
pub(super) static REWRITES: &[(u16, usize, usize)] =
    &[(82, 0, 2), (82, 25, 2), (89, 0, 2), (89, 8, 2), (104, 0, 1), (105, 0, 2)];

/// A host must not look for `[CFGUPMODE]` before 1.1 s have passed (2.4.3).
pub(super) const TIMING: Timing = Timing { update_enter: Duration::from_millis(1100), ..bq27441_g1::TIMING };

pub(super) const SCHEME: BlockPart = BlockPart {
    // Not documented.
    code: 0x0001,
    map: Map { settings, registers: REGISTERS, ..bq27441_g1::SCHEME.map },
    subcommands: &SUBCOMMANDS,
    status: STATUS,
    data_memory: Some(DataMemory { seals: UPDATE_STATUS, gain_sign: Some((105, 5)) }),
    own: Own { sleep: Some(((64, 0, 0x0020), (82, 23))), ..OWN },
    ..bq27441_g1::SCHEME
};

/// The table of 5.1. The firmware version is what parts answer.
#[rustfmt::skip]
pub(super) const SUBCOMMANDS: [(u16, Level, Action); 17] = [
    (0x0000, Anyone, ControlStatus),
    (0x0001, Anyone, Answer(0x0427)),
    (0x0002, Anyone, Answer(0x0202)),
    (0x0004, Anyone, AnswerCode),
    (0x0007, Anyone, Previous),
    (0x0008, Anyone, AnswerChemistry(0x3230)),
    (0x000C, Anyone, BatteryInsert(true)),
    (0x000D, Anyone, BatteryInsert(false)),
    (0x0013, Unsealed, ConfigUpdate),
    (0x001B, Unsealed, Set(Status::ShutdownArmed)),
    (0x001C, Unsealed, Shutdown),
    (0x0020, Unsealed, Seal),
    (0x0030, Unsealed, Chemistry(0x3230)),
    (0x0031, Unsealed, Chemistry(0x1202)),
    (0x0032, Unsealed, Chemistry(0x3142)),
    (0x0041, Unsealed, Reset),
    (0x0042, Unsealed, Leave(Exit::Anew)),
];

/// CONTROL_STATUS, 5.1.1.
#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::ShutdownArmed,    0x8000),
    (Status::WatchdogReset, 0x4000),
    (Status::Sealed,           0x2000),
    (Status::Initialized,      0x0080),
    (Status::Sleep,            0x0010),
    (Status::LoadMode,         0x0008),
    (Status::ChemistryChanged, 0x0001),
];

/// Chapter 5. StandbyCurrent() and MaxLoadCurrent() are known from drivers only.
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
];

fn settings(flash: &Flash) -> Settings {
    // OpConfig [TempSource]: 0 internal, 1 a thermistor, 2 the host.
    let source = flash.u16(64, 0) & 0x0003;
    Settings {
        thermistor: source == 1,
        host_temperature: source == 2,
        taper_mv: f64::from(flash.i16(109, 6)) - f64::from(flash.i16(109, 8)),
        charge_mv: [flash.u16(109, 6); 3],
        taper_ma: rate(flash, 6, flash.u16(82, 21)),
        inverted: flash.u8(105, 5) & 0x80 != 0,
        ..family(flash, 6)
    }
}

#[rustfmt::skip]
static IMAGE: Image = &[
    // Safety
    (2, &[0x02, 0x26, 0x00, 0x00, 0x32]),
    // Charge Termination
    (36, &[0x00, 0x19, 0x28, 0x63, 0x5F, 0xFF, 0x62, 0x00, 0x32]),
    // Discharge
    (49, &[0x0A, 0x0F, 0x02, 0x05]),
    // Registers
    (64, &[0x64, 0x78, 0x0F, 0x9F, 0x23, 0x00, 0x00, 0x14, 0x04, 0x00, 0x09, 0x04, 0x27]),
    // Power
    (68, &[0x00, 0x32, 0x01, 0xC2, 0x30, 0x00, 0x03, 0x08, 0x98, 0x01, 0x00, 0x3C, 0x01]),
    // IT Cfg
    (80, &[0x01, 0xF4, 0x00, 0x1E, 0xC8, 0x14, 0x08, 0x00, 0x3C, 0x0E, 0x10, 0x00, 0x0A, 0x46, 0x05, 0x14,
           0x05, 0x0F, 0x03, 0x20, 0x7F, 0xFF, 0x00, 0xF0, 0x46, 0x50, 0x18, 0x01, 0x90, 0x00, 0x64, 0x19,
           0xDC, 0x5C, 0x60, 0x00, 0x7D, 0x00, 0x04, 0x03, 0x19, 0x25, 0x0F, 0x14, 0x0A, 0x78, 0x60, 0x28,
           0x01, 0xF4, 0x00, 0x00, 0x00, 0x00, 0x43, 0x80, 0x04, 0x01, 0x14, 0x00, 0x08, 0x0B, 0xB8, 0x01,
           0x2C, 0x0A, 0x01, 0x0A, 0x00, 0x00, 0x00, 0xC8, 0x00, 0x64, 0x02, 0x00, 0x00, 0x00, 0x00, 0x07,
           0xD0, 0x01, 0x03, 0x5A, 0x14]),
    // Current Thresholds
    (81, &[0x01, 0xC2, 0x00, 0x64, 0x00, 0x64, 0x00, 0x3C, 0x3C, 0x01, 0xB3, 0xB3, 0x01, 0x90]),
    // State
    (82, &[0x40, 0x00, 0x00, 0x00, 0x00, 0x81, 0x05, 0x3C, 0x13, 0x60, 0x0C, 0x80, 0x00, 0xC8, 0x00, 0x32,
           0x00, 0x14, 0x03, 0xE8, 0x01, 0x00, 0x64, 0x00, 0x0A, 0xFF, 0xCE, 0xFF, 0xCE, 0x00, 0x01]),
    // Ra0 RAM
    (89, &[0x00, 0x4E, 0x00, 0x23, 0x00, 0x27, 0x00, 0x2D, 0x00, 0x2A, 0x00, 0x24, 0x00, 0x27, 0x00, 0x24,
           0x00, 0x23, 0x00, 0x25, 0x00, 0x26, 0x00, 0x28, 0x00, 0x2E, 0x00, 0x36, 0x00, 0x2E]),
    // Chem Data
    (109, &[0x09, 0x22, 0x0E, 0xE3, 0x0E, 0xA6, 0x10, 0xF4, 0x10, 0x9A]),
    // Data
    (104, &[0x00, 0x00, 0x00]),
    // CC Cal
    (105, &[0x00, 0x00, 0x0B, 0xA6, 0x7F, 0x2D, 0x8E, 0xA8, 0x94, 0x43, 0x26, 0xD2]),
    // Current
    (107, &[0x00, 0x05]),
    // Codes
    (112, &[0x80, 0x00, 0x80, 0x00]),
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// 82/0 from a trace, the others from the image of the product.
    #[test]
    fn blocks_have_the_checksums_of_parts() {
        check_sums(
            IMAGE,
            &[
                (82, 0, 0xFB),
                (89, 0, 0x79),
                (2, 0, 0xA5),
                (112, 0, 0xFF),
                (36, 0, 0x69),
                (49, 0, 0xDF),
                (64, 0, 0x06),
                (68, 0, 0xF9),
                (80, 0, 0xE4),
                (80, 1, 0xDB),
                (80, 2, 0x47),
                (81, 0, 0x04),
                (109, 0, 0x81),
            ],
        );
    }
}
