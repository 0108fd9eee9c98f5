// SPDX-License-Identifier: MIT

//! The bq27500 with firmware 1.20, and the bq27500-V130.
//!
//! Bytes are those of TI's stock image for firmware 1.20 (github.com/buglabs/bq27500-update), cut at the first byte of
//! each class. For the bq27500-V130 the classes that differ have the defaults of SLUS914A Table 4-7, and 0 between them.

use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{CHG, CHG_INH, DSG, FC, Map, OCVTAKEN, OTC, OTD, SOC1, SOCF, Settings, XCHG};
use super::model::Host;
use super::part::Action::*;
use super::part::{Action, BlockPart, Detection, Gate, Own, Part, Scheme, Status};
use super::seal::Level::{self, FullAccess, Sealed as Anyone, Unsealed};
use super::timing::Timing;

pub(super) static PART: Part = part("bq27500", IMAGE, &const { scheme(settings, SUBCOMMANDS) });
pub(super) static V130: Part =
    part("bq27500-v130", IMAGE_V130, &const { scheme(settings_v130, SUBCOMMANDS_V130) });

const fn part(name: &'static str, image: Image, scheme: &'static BlockPart) -> Part {
    Part { name, image, timing: Timing::USUAL, scheme: Scheme::Block(scheme), rewrites: REWRITES }
}

/// Qmax and cycle count of the first profile, CC Offset and Board Offset.
static REWRITES: &[(u16, usize, usize)] = &[(82, 2, 2), (82, 4, 2), (104, 8, 2), (104, 10, 1)];

const fn scheme(settings: fn(&Flash) -> Settings, subcommands: Subcommands) -> BlockPart {
    BlockPart {
        code: 0,
        map: Map {
            settings,
            registers: REGISTERS,
            flags: FLAGS,
            cycles: Some((82, 4)),
            lifetime: None,
            learned: None,
        },
        subcommands,
        status: STATUS,
        // SLUS914A 4.1.1.1.6.
        remembered: 0x000A,
        // SLUS914A 7.1.
        last_register: 0x6B,
        flags_register: 0x0A,
        voltage_register: 0x08,
        host_registers: &[(0x02, Host::AtRate)],
        keys: &[0, 4],
        data_memory: None,
        gate: Some(Gate { limit: (68, 0), divider: None, cell_divider: None }),
        authentication: None,
        // Manufacturer block A; it cannot be written (SLUS914A 4.3). B and C are not modelled.
        sealed_blocks: &[(1, 57)],
        sealed_writes: None,
        detection: Detection::Pin,
        own: Own {
            update_status: None,
            cc_offset: Some((104, 8)),
            board_offset: Some((104, 10)),
            load_mode: Some((80, 1)),
            calibration: None,
            sleep: Some(((64, 0, 0x0020), (68, 7))),
            settle: None,
            chemistry: None,
        },
        rom: None,
        protector: None,
    }
}

type Subcommands = &'static [(u16, Level, Action)];

const SUBCOMMANDS: Subcommands = &subcommands(0x0120);
const SUBCOMMANDS_V130: Subcommands = &subcommands(0x0130);

/// SLUS914A, Table 4-2, without those of the BAT_LOW pin and CAL_MODE. The last one is in no table:
/// github.com/buglabs/bq27500-update finds the gauge at 0x0B then.
#[rustfmt::skip]
const fn subcommands(firmware: u16) -> [(u16, Level, Action); 15] {
    [
        (0x0000, Anyone, ControlStatus),
        (0x0001, Anyone, Answer(0x0500)),
        (0x0002, Anyone, Answer(firmware)),
        (0x0004, Unsealed, FlashChecksum),
        (0x0005, Anyone, ResetData),
        (0x0007, Anyone, Previous),
        (0x0008, Anyone, Answer(0x0107)),
        (0x0011, Anyone, Set(Status::Hibernate)),
        (0x0012, Anyone, Clear(Status::Hibernate)),
        (0x0013, Anyone, Set(Status::Snooze)),
        (0x0014, Anyone, Clear(Status::Snooze)),
        (0x0020, Unsealed, Seal),
        (0x0021, Unsealed, ItEnable),
        (0x0041, Unsealed, Reset),
        (0x0F00, FullAccess, Rom),
    ]
}

/// CONTROL_STATUS, SLUS914A Table 4-3.
#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::NotFullAccess, 0x4000),
    (Status::Sealed,        0x2000),
    (Status::ChecksumValid, 0x1000),
    (Status::CcOffset,      0x0800),
    (Status::BoardOffset,   0x0400),
    (Status::Hibernate,     0x0040),
    (Status::Snooze,        0x0020),
    (Status::Sleep,         0x0010),
    (Status::LoadMode,      0x0008),
    (Status::RaOff,         0x0004),
    (Status::VoltageOk,     0x0002),
    (Status::Enabled,       0x0001),
];

/// Flags(), SLUS914A Table 4-4. `[OCV_GD]` is a good open-circuit voltage.
#[rustfmt::skip]
static FLAGS: &[(u32, u16)] = &[
    (OTC, 0x8000), (OTD, 0x4000), (CHG_INH, 0x0800), (XCHG, 0x0400), (FC, 0x0200), (CHG, 0x0100),
    (OCVTAKEN, 0x0020), (SOC1, 0x0004), (SOCF, 0x0002), (DSG, 0x0001),
];

/// SLUS914A, Tables 4-1 and 4-5, without DeviceName().
#[rustfmt::skip]
static REGISTERS: &[(u8, usize, Q)] = &[
    (0x02, 2, Q::AtRate),
    (0x04, 2, Q::AtRateTimeToEmpty),
    (0x06, 2, Q::Temperature),
    (0x08, 2, Q::Voltage),
    (0x0A, 2, Q::Flags),
    (0x0C, 2, Q::NominalRemaining),
    (0x0E, 2, Q::NominalFull),
    (0x10, 2, Q::Remaining),
    (0x12, 2, Q::Full),
    (0x14, 2, Q::AverageCurrent),
    (0x16, 2, Q::TimeToEmpty),
    (0x18, 2, Q::TimeToFull),
    (0x1A, 2, Q::StandbyCurrent),
    (0x1C, 2, Q::StandbyTimeToEmpty),
    (0x1E, 2, Q::MaxLoadCurrent),
    (0x20, 2, Q::MaxLoadTimeToEmpty),
    (0x22, 2, Q::AvailableEnergy),
    (0x24, 2, Q::AveragePower),
    (0x26, 2, Q::ConstantPowerTimeToEmpty),
    (0x2A, 2, Q::CycleCount),
    (0x2C, 2, Q::Percent),
    (0x3C, 2, Q::DesignCapacity),
];

/// Firmware 1.20: Taper Current is at 36/2, and the two of `[CHG]` at 36/9.
fn settings(flash: &Flash) -> Settings {
    let i8 = |offset| flash.u8(36, offset) as i8;
    Settings {
        taper_ma: flash.i16(36, 2).into(),
        taper_mv: flash.i16(36, 6).into(),
        taper_s: flash.u8(36, 8).into(),
        charge_alert: (i8(9), i8(10)),
        full: (i8(11), i8(12)),
        ..common(flash)
    }
}

fn settings_v130(flash: &Flash) -> Settings {
    let i8 = |offset| flash.u8(36, offset) as i8;
    Settings {
        taper_ma: flash.i16(36, 0).into(),
        taper_mv: flash.i16(36, 4).into(),
        taper_s: flash.u8(36, 6).into(),
        full: (i8(9), i8(10)),
        ..common(flash)
    }
}

fn common(flash: &Flash) -> Settings {
    let i16 = |id, offset| f64::from(flash.i16(id, offset));
    let u8 = |id, offset| f64::from(flash.u8(id, offset));
    let i8 = |id, offset| flash.u8(id, offset) as i8;
    let word = |id, offset| u16::from(flash.u8(id, offset));
    let configuration = flash.u16(64, 0);
    Settings {
        ot_charge: (i16(2, 0), u8(2, 2), i16(2, 3)),
        ot_discharge: (i16(2, 5), u8(2, 7), i16(2, 8)),
        inhibit: (i16(32, 0), i16(32, 2), i16(32, 4)),
        suspend: (i16(34, 6), i16(34, 8)),
        cycle_mah: i16(48, 7).max(1.0),
        cycles: flash.u16(82, 4),
        design_mah: flash.u16(48, 10),
        charge_mv: [flash.u16(34, 2); 3],
        soc1: (word(49, 0), word(49, 1)),
        socf: (word(49, 2), word(49, 3)),
        full_at_taper: configuration & 0x0010 != 0,
        thermistor: configuration & 0x0001 != 0,
        reserve_mah: i16(80, 57).max(0.0),
        discharge_ma: i16(81, 0),
        charge_ma: i16(81, 2),
        quit_ma: i16(81, 4),
        relax_s: (f64::from(flash.u16(81, 6)), u8(81, 8)),
        internal_offset: f64::from(i8(104, 11)),
        external_offset: f64::from(i8(104, 12)),
        deadband_ma: u8(107, 1),
        standby_ma: f64::from(i8(48, 4)),
        max_load_ma: i16(48, 5),
        qmax_mah: i16(82, 2).max(1.0),
        ..Settings::none()
    }
}

#[rustfmt::skip]
const IMAGE: Image = &[
    // Safety
    (2, &[0x02, 0x26, 0x02, 0x01, 0xF4, 0x02, 0x58, 0x02, 0x02, 0x26]),
    // Charge Inhibit Config
    (32, &[0x00, 0x00, 0x01, 0xC2, 0x00, 0x32]),
    // Charge
    (34, &[0x00, 0xC8, 0x10, 0x68, 0x00, 0x32, 0xFF, 0xCE, 0x02, 0x26]),
    // Charge Termination
    (36, &[0x00, 0x00, 0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28, 0x63, 0x5F, 0x64, 0x62]),
    // Data
    (48, &[0x00, 0x64, 0x01, 0xB0, 0xF6, 0xFE, 0x0C, 0x03, 0x84, 0x5A, 0x03, 0xE8, 0x07, 0x62, 0x71, 0x32,
           0x37, 0x35, 0x30, 0x30]),
    // Discharge
    (49, &[0x96, 0xAF, 0x4B, 0x64]),
    // Manufacturer Info
    (57, &[0x00; 96]),
    // Registers
    (64, &[0x09, 0x79, 0x04, 0x2E, 0x00, 0x6E, 0x14, 0x04, 0x00, 0x00]),
    // Power
    (68, &[0x0A, 0xF0, 0x06, 0xD6, 0x00, 0x0B, 0xB8, 0x00, 0x0A, 0x05, 0x00, 0x32, 0x01, 0xC2, 0x14, 0x14,
           0x00, 0x08, 0x09, 0xF6]),
    // IT Cfg
    (80, &[0x01, 0x00, 0x02, 0xBC, 0x01, 0x2C, 0x00, 0x32, 0x00, 0xC8, 0xC8, 0x14, 0x02, 0x00, 0x3C, 0x0E,
           0x10, 0x00, 0x0A, 0x1E, 0x05, 0x32, 0x02, 0x0F, 0x0A, 0x00, 0x64, 0x46, 0x50, 0x28, 0x0E, 0xD8,
           0x0E, 0x99, 0x01, 0x90, 0x00, 0x64, 0x19, 0x01, 0x03, 0x05, 0x05, 0x25, 0x5A, 0x96, 0x1E, 0x60,
           0x0B, 0xB8, 0x28, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // Current Thresholds
    (81, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28, 0x00, 0x3C, 0x3C, 0x01]),
    // State
    (82, &[0x00, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0xFE, 0xD5, 0xFB, 0x95, 0x00, 0x02, 0x02, 0xBC]),
    // Data
    (104, &[0x7F, 0x71, 0x20, 0x5C, 0x94, 0x08, 0x98, 0xC0, 0xFB, 0x50, 0x00, 0x4E, 0x00, 0x00]),
    // Current
    (107, &[0xEF, 0x05]),
    // Codes
    (112, &[0x36, 0x72, 0x04, 0x14, 0xFF, 0xFF, 0xFF, 0xFF]),
];

#[rustfmt::skip]
const IMAGE_V130: Image = &[
    IMAGE[0],
    IMAGE[1],
    IMAGE[2],
    // Charge Termination
    (36, &[0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28, 0x00, 0x00, 0x64, 0x62]),
    IMAGE[4],
    IMAGE[5],
    IMAGE[6],
    // Registers
    (64, &[0x09, 0x79, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // Power
    (68, &[0x0A, 0xF0, 0x06, 0xD6, 0x00, 0x0B, 0xB8, 0x00, 0x0A, 0x05, 0x00, 0x32, 0x01, 0xC2, 0x14, 0x14,
           0x00, 0x08, 0x09, 0xF6, 0x0D, 0x48]),
    IMAGE[9],
    // Current Thresholds
    (81, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28, 0x00, 0x3C, 0x3C, 0x01, 0x80, 0x80, 0x01, 0x90]),
    IMAGE[11],
    IMAGE[12],
    IMAGE[13],
    IMAGE[14],
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// Sums over SLUS914A Table 4-7, calculated by hand, and over the same rows of TI's image.
    #[test]
    fn blocks_have_the_checksums_of_parts() {
        check_sums(IMAGE, &[(112, 0, 0x43), (2, 0, 0x5C), (32, 0, 0x0A)]);
        check_sums(IMAGE_V130, &[(81, 0, 0x46), (112, 0, 0x43), (2, 0, 0x5C), (32, 0, 0x0A)]);
    }
}
