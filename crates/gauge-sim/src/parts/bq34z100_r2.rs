// SPDX-License-Identifier: MIT

//! The bq34z100-R2 with the settings of a new bq34z100-G1: what differs from that part.
//!
//! Subclass 48 is as in the image of a pack with firmware 2.02, where the scales are taken to be in the order of their
//! registers. No source has the voltage at the converter's full scale with firmware 2.02, so the limit of the flash
//! applies to Voltage() only. The host multiplies by the scales (SLUUCO5A 2.2.5 to 2.2.7); no other register depends on
//! them.

use std::array;

use super::bq34z100_g1 as g1;
use super::flash::Flash;
use super::gauging::Quantity as Q;
use super::gauging::{Map, Settings};
use super::part::{Action, BlockPart, Gate, Part, Scheme};
use super::rom::Layout;
use super::seal::Level;
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq34z100-r2",
    image: &IMAGE,
    timing: Timing::USUAL,
    scheme: Scheme::Block(&BlockPart {
        map: Map { settings, registers: REGISTERS, ..g1::SCHEME.map },
        subcommands: &SUBCOMMANDS,
        gate: Some(Gate { limit: (68, 0), divider: Some(((104, 14), (64, 0, 0x0800))), cell_divider: None }),
        rom: Some(LAYOUT),
        protector: None,
        ..g1::SCHEME
    }),
    rewrites: g1::REWRITES,
};

/// The places of the classes in the rows of an image for ROM mode (BQ34Z100_DFI.c of
/// github.com/DmitrijSarychev/Handy_Files).
#[rustfmt::skip]
static LAYOUT: Layout = &[
    (104, 0, 16), (82, 68, 17), (80, 85, 93), (32, 405, 6), (34, 411, 14), (36, 425, 27), (64, 452, 8),
    (68, 464, 12), (81, 476, 11), (112, 487, 24), (67, 511, 1), (59, 512, 12), (60, 524, 2), (66, 526, 5),
    (2, 576, 10), (48, 607, 62), (49, 669, 22), (58, 691, 32), (88, 768, 32), (89, 832, 32),
];

/// The codes of SLUUCO5A 2.1.1, with the effects of the bq34z100-G1 (SLUSBZ5D table 7-2). The hardware is that of a
/// bq34z100-G1 with firmware 2.02.
const SUBCOMMANDS: [(u16, Level, Action); g1::SUBCOMMANDS.len()] = {
    let mut all = g1::SUBCOMMANDS;
    assert!(all[2].0 == 0x0002);
    all[2].2 = Action::Answer(0x0202);
    all
};

/// Standard commands and extended ones, SLUUCO5A 2.1 and 2.2.
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
    (0x20, 1, Q::VoltageScale),
    (0x21, 1, Q::CurrentScale),
    (0x22, 1, Q::EnergyScale),
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

fn settings(flash: &Flash) -> Settings {
    Settings {
        // Energies are in cWh.
        energy_scale: 10.0,
        scales: array::from_fn(|i| flash.u8(48, 30 + i)),
        ..g1::settings(flash)
    }
}

/// The index of subclass 48, Data.
const DATA: usize = 4;

#[rustfmt::skip]
const IMAGE: [(u16, &[u8]); g1::IMAGE.len()] = {
    let mut all = g1::IMAGE;
    assert!(all[DATA].0 == 48);
    all[DATA].1 = &[0x00, 0x00, 0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x03, 0x84, 0x64, 0x03, 0xE8, 0x15, 0x18, 0xFE,
        0x70, 0x10, 0x68, 0x10, 0x68, 0x10, 0x04, 0x0A, 0x32, 0x1E, 0xF6, 0x0A, 0x2D, 0x37, 0x01, 0x01,
        0x01, 0x0B, 0x62, 0x71, 0x33, 0x34, 0x7A, 0x31, 0x30, 0x30, 0x2D, 0x47, 0x31, 0x0B, 0x54, 0x65,
        0x78, 0x61, 0x73, 0x20, 0x49, 0x6E, 0x73, 0x74, 0x2E, 0x04, 0x4C, 0x49, 0x4F, 0x4E];
    all
};

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    #[test]
    fn subclass_48_has_its_checksums() {
        assert_eq!(IMAGE[DATA].1.len(), 62);
        check_sums(&IMAGE, &[(48, 0, 0xC9), (48, 1, 0xD7)]);
    }
}
