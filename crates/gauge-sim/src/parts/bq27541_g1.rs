// SPDX-License-Identifier: MIT

//! The bq27541-G1 and the bq27545-G1, of whose data flash public sources have some classes; the others do not exist
//! here.
//!
//! Bytes are the defaults of SLUSAL6C Table 7, page 22, and of SLUSAT0E Table 17, with 0 between them. Keys are the
//! family's.

use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{DSG, FC, Map, OTC, OTD, SOC1, SOCF, Settings};
use super::part::Action::*;
use super::part::{Action, BlockPart, Detection, Own, Part, Scheme, Status};
use super::seal::Level::{self, FullAccess, Sealed as Anyone, Unsealed};
use super::timing::Timing;

pub(super) static PART: Part =
    part("bq27541-g1", IMAGE, &const { scheme(settings, REGISTERS, SUBCOMMANDS_541) });
pub(super) static BQ27545: Part =
    part("bq27545-g1", IMAGE_545, &const { scheme(settings_545, REGISTERS_545, SUBCOMMANDS_545) });

const fn part(name: &'static str, image: Image, scheme: &'static BlockPart) -> Part {
    Part { name, image, timing: Timing::USUAL, scheme: Scheme::Block(scheme), rewrites: &[] }
}

type Registers = &'static [(u8, usize, Q)];
pub(super) type Subcommands = &'static [(u16, Level, Action)];

pub(super) const fn scheme(
    settings: fn(&Flash) -> Settings,
    registers: Registers,
    subcommands: Subcommands,
) -> BlockPart {
    BlockPart {
        code: 0,
        map: Map { settings, registers, flags: FLAGS, cycles: None, lifetime: None, learned: None },
        subcommands,
        status: STATUS,
        remembered: 0x000A,
        last_register: 0x7F,
        flags_register: 0x0A,
        voltage_register: 0x08,
        host_registers: &[],
        keys: &[0, 4],
        data_memory: None,
        gate: None,
        authentication: None,
        sealed_blocks: &[],
        sealed_writes: None,
        detection: Detection::None,
        own: Own {
            update_status: None,
            cc_offset: None,
            board_offset: None,
            load_mode: None,
            calibration: None,
            sleep: None,
            settle: None,
            chemistry: None,
        },
        rom: None,
        protector: None,
    }
}

const SUBCOMMANDS_541: Subcommands = &subcommands(0x0541, 0x0224, 0x0060);
/// Type and versions are made up: no source has them.
const SUBCOMMANDS_545: Subcommands = &subcommands(0x0545, 0x0200, 0x0000);

#[rustfmt::skip]
pub(super) const fn subcommands(kind: u16, firmware: u16, hardware: u16) -> [(u16, Level, Action); 9] {
    [
        (0x0000, Anyone, ControlStatus),
        (0x0001, Anyone, Answer(kind)),
        (0x0002, Anyone, Answer(firmware)),
        (0x0003, Anyone, Answer(hardware)),
        (0x0008, Anyone, Answer(0x0107)),
        (0x0020, Unsealed, Seal),
        (0x0021, Unsealed, ItEnable),
        (0x0041, Unsealed, Reset),
        (0x0F00, FullAccess, Rom),
    ]
}

#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::NotFullAccess, 0x4000),
    (Status::Sealed,        0x2000),
    (Status::Sleep,         0x0010),
    (Status::VoltageOk,     0x0002),
    (Status::Enabled,       0x0001),
];

#[rustfmt::skip]
static FLAGS: &[(u32, u16)] =
    &[(OTC, 0x8000), (OTD, 0x4000), (FC, 0x0200), (SOC1, 0x0004), (SOCF, 0x0002), (DSG, 0x0001)];

#[rustfmt::skip]
static REGISTERS: Registers = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x0E, 2, Q::NominalFull), (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent),
    (0x16, 2, Q::TimeToEmpty), (0x24, 2, Q::AveragePower), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent),
    (0x2E, 1, Q::Health), (0x2F, 1, Q::HealthStatus), (0x3C, 2, Q::DesignCapacity),
];

#[rustfmt::skip]
static REGISTERS_545: Registers = &[
    (0x06, 2, Q::Temperature), (0x08, 2, Q::Voltage), (0x0A, 2, Q::Flags), (0x0C, 2, Q::NominalRemaining),
    (0x10, 2, Q::Remaining), (0x12, 2, Q::Full), (0x14, 2, Q::AverageCurrent), (0x16, 2, Q::TimeToEmpty),
    (0x24, 2, Q::AveragePower), (0x2A, 2, Q::CycleCount), (0x2C, 2, Q::Percent), (0x2E, 1, Q::Health),
    (0x2F, 1, Q::HealthStatus),
];

/// A cell of 1200 mAh, for what no readable page has.
pub(super) fn cell() -> Settings {
    Settings {
        ot_charge: (550.0, 2.0, 500.0),
        ot_discharge: (600.0, 2.0, 550.0),
        taper_ma: 100.0,
        taper_mv: 100.0,
        full_at_taper: true,
        cycle_mah: 900.0,
        cycles: 7,
        design_mah: 1150,
        qmax_mah: 1200.0,
        soc1: (150, 175),
        socf: (75, 100),
        ..Settings::none()
    }
}

fn settings(_: &Flash) -> Settings {
    cell()
}

fn settings_545(flash: &Flash) -> Settings {
    let i16 = |id, offset| f64::from(flash.i16(id, offset));
    let u8 = |id, offset| f64::from(flash.u8(id, offset));
    Settings {
        ot_charge: (i16(2, 0), u8(2, 2), i16(2, 3)),
        ot_discharge: (i16(2, 5), u8(2, 7), i16(2, 8)),
        taper_ma: i16(36, 0),
        taper_mv: i16(36, 4),
        cycle_mah: i16(48, 19).max(1.0),
        cycles: flash.u16(48, 17),
        design_mah: flash.u16(48, 23),
        qmax_mah: i16(48, 23).max(1.0),
        ..cell()
    }
}

/// Default unseal key 0x0414, 0x3672 and full-access key, as relatives store them.
pub(super) const CODES: (u16, &[u8]) = (112, &[0x36, 0x72, 0x04, 0x14, 0xFF, 0xFF, 0xFF, 0xFF]);

#[rustfmt::skip]
const IMAGE: Image = &[
    // Manufacturer Info
    (58, &[0x00; 64]),
    // Lifetime Data
    (59, &[0x00, 0x00, 0x01, 0xF4, 0x0A, 0xF0, 0x10, 0x68, 0x00, 0x00, 0x00, 0x00]),
    // Lifetime Temp Samples
    (60, &[0x00, 0x00]),
    // Registers
    (64, &[0x11, 0x77, 0xA7, 0x18]),
    // Lifetime Resolution
    (66, &[0x0A, 0x19, 0x64, 0x00, 0x3C]),
    // Power
    (68, &[0x0A, 0xF0, 0x00, 0x0A, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x08, 0x09, 0xF6, 0x00]),
    // IT Cfg
    (80, &[0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x0F, 0x05, 0x00, 0x00, 0x03, 0x20, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x0B, 0xB8, 0x00, 0xC8]),
    CODES,
];

#[rustfmt::skip]
const IMAGE_545: Image = &[
    // Safety
    (2, &[0x02, 0x26, 0x02, 0x01, 0xF4, 0x02, 0x58, 0x02, 0x02, 0x26]),
    // Charge Inhibit Cfg
    (32, &[0x00, 0x00, 0x01, 0xC2, 0x00, 0x32]),
    // Charge
    (34, &[0x10, 0x68]),
    // Charge Termination
    (36, &[0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28, 0x63, 0x5F, 0xFF, 0x62, 0x00, 0x32]),
    // Data
    (48, &[0x00, 0x64, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xF6, 0xFE, 0x0C, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x03, 0x84, 0x00, 0x00, 0x03, 0xE8, 0x15, 0x18]),
    // IT Cfg
    (80, &[0x00; 69]),
    CODES,
];
