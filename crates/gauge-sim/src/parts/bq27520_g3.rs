// SPDX-License-Identifier: MIT

//! The bq27520-G3, as far as it is known.
//!
//! The data-flash table of this generation is not published. Bytes are from the bq27500-V130 (SLUS914A table
//! 4-7) if drivers for this part or the image of a product with a bq27520-G4 agree with it, else from that
//! image, and 0 if neither has them. The class State is the bq27500-V130's.

use super::flash::{Flash, Image};
use super::gauging::Quantity as Q;
use super::gauging::{CHG, CHG_INH, DSG, FC, Map, OCVTAKEN, OTC, OTD, SOC1, SOCF, Settings, XCHG};
use super::model::Host;
use super::part::Action::*;
use super::part::{Action, BlockPart, Detection, Gate, Own, Part, Scheme, Status};
use super::rom::Layout;
use super::seal::Level::{self, FullAccess, Sealed as Anyone, Unsealed};
use super::timing::Timing;

pub(super) static PART: Part = Part {
    name: "bq27520-g3",
    image: IMAGE,
    timing: Timing::USUAL,
    scheme: Scheme::Block(&SCHEME),
    rewrites: REWRITES,
};

/// Qmax and cycle count, Pack0 Ra and Pack0 Rax, CC Offset and Board Offset.
static REWRITES: &[(u16, usize, usize)] =
    &[(82, 2, 2), (82, 4, 2), (91, 2, 2), (93, 2, 2), (104, 8, 2), (104, 10, 1)];

static SCHEME: BlockPart = BlockPart {
    code: 0,
    map: Map {
        settings,
        registers: REGISTERS,
        flags: FLAGS,
        cycles: Some((82, 4)),
        lifetime: None,
        learned: None,
    },
    subcommands: SUBCOMMANDS,
    status: STATUS,
    remembered: 0x0020,
    // SLUS914A 7.1.
    last_register: 0x6B,
    flags_register: 0x0A,
    voltage_register: 0x08,
    host_registers: &[(0x02, Host::AtRate), (0x06, Host::Temperature)],
    keys: &[0, 4],
    data_memory: None,
    gate: Some(Gate { limit: (68, 0), divider: None, cell_divider: None }),
    authentication: None,
    // Manufacturer block A; it cannot be written (SLUS914A 4.1.2.3).
    sealed_blocks: &[(1, 57)],
    sealed_writes: None,
    // Operation Configuration B [BIE].
    detection: Detection::PinIf(64, 11, 0x40),
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
    rom: Some(LAYOUT),
    protector: None,
};

/// Only the device name is known to be in its place in the rows of an image for ROM mode.
static LAYOUT: Layout = &[];

/// SLUSAB7A. The firmware version is the third generation's. Hardware version and chemistry are not known.
#[rustfmt::skip]
static SUBCOMMANDS: &[(u16, Level, Action)] = &[
    (0x0000, Anyone, ControlStatus),
    (0x0001, Anyone, Answer(0x0520)),
    (0x0002, Anyone, Answer(0x0324)),
    (0x0003, Anyone, Answer(0x00A3)),
    (0x0004, Unsealed, FlashChecksum),
    (0x0007, Anyone, Previous),
    (0x0008, Anyone, Answer(0x0128)),
    (0x0009, Unsealed, BoardOffset),
    (0x000A, Unsealed, CcOffset),
    (0x000B, Unsealed, WriteCcOffset),
    (0x000C, Anyone, Set(Status::OcvDone)),
    (0x000D, Anyone, BatteryInsert(true)),
    (0x000E, Anyone, BatteryInsert(false)),
    (0x0011, Anyone, Set(Status::Hibernate)),
    (0x0012, Anyone, Clear(Status::Hibernate)),
    (0x0013, Anyone, Set(Status::Snooze)),
    (0x0014, Anyone, Clear(Status::Snooze)),
    (0x0018, Anyone, Set(Status::DataLog)),
    (0x0019, Anyone, Clear(Status::DataLog)),
    (0x001F, Anyone, AnswerFrom(48, 24)),
    (0x0020, Unsealed, Seal),
    (0x0021, Unsealed, ItEnable),
    (0x0023, Unsealed, ItDisable),
    (0x0041, Unsealed, Reset),
    (0x0F00, FullAccess, Rom),
];

/// CONTROL_STATUS, SLUSAB7A.
#[rustfmt::skip]
static STATUS: &[(Status, u16)] = &[
    (Status::DataLog,       0x8000),
    (Status::NotFullAccess, 0x4000),
    (Status::Sealed,        0x2000),
    (Status::ChecksumValid, 0x1000),
    (Status::CcOffset,      0x0800),
    (Status::BoardOffset,   0x0400),
    (Status::OcvDone,       0x0200),
    (Status::Initialized,   0x0080),
    (Status::Hibernate,     0x0040),
    (Status::Snooze,        0x0020),
    (Status::Sleep,         0x0010),
    (Status::LoadMode,      0x0008),
    (Status::RaOff,         0x0004),
    (Status::VoltageOk,     0x0002),
    (Status::Enabled,       0x0001),
];

/// Flags(), SLUSAB7A. `[OCV_GD]` is a good open-circuit voltage, and `[SYSDOWN]` was `[SOCF]` before.
#[rustfmt::skip]
static FLAGS: &[(u32, u16)] = &[
    (OTC, 0x8000), (OTD, 0x4000), (CHG_INH, 0x0800), (XCHG, 0x0400), (FC, 0x0200), (CHG, 0x0100),
    (OCVTAKEN, 0x0020), (SOC1, 0x0004), (SOCF, 0x0002), (DSG, 0x0001),
];

/// SLUSAP0 and SLUSAB7A. NormalizedImpedanceCal() and the data log are not modelled.
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
    (0x1A, 2, Q::StandbyCurrent),
    (0x1C, 2, Q::StandbyTimeToEmpty),
    (0x1E, 2, Q::MaxLoadCurrent),
    (0x20, 2, Q::MaxLoadTimeToEmpty),
    (0x22, 2, Q::AvailableEnergy),
    (0x24, 2, Q::AveragePower),
    (0x26, 2, Q::ConstantPowerTimeToEmpty),
    (0x28, 1, Q::Health),
    (0x29, 1, Q::HealthStatus),
    (0x2A, 2, Q::CycleCount),
    (0x2C, 2, Q::Percent),
    (0x30, 2, Q::Current),
    (0x36, 2, Q::InternalTemperature),
    (0x3A, 2, Q::PackConfiguration),
    (0x3C, 2, Q::DesignCapacity),
];

fn settings(flash: &Flash) -> Settings {
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
        taper_ma: i16(36, 0),
        taper_mv: i16(36, 4),
        taper_s: u8(36, 6),
        charge_alert: (i8(36, 7), i8(36, 8)),
        full: (i8(36, 9), i8(36, 10)),
        cycle_mah: i16(48, 7).max(1.0),
        cycles: flash.u16(82, 4),
        design_mah: flash.u16(48, 10),
        charge_mv: [flash.u16(34, 2); 3],
        soc1: (word(49, 0), word(49, 1)),
        socf: (word(49, 2), word(49, 3)),
        pack: configuration,
        full_at_taper: configuration & 0x0010 != 0,
        thermistor: configuration & 0x0001 != 0,
        // Operation Configuration B [WRTEMP].
        host_temperature: flash.u8(64, 11) & 0x80 != 0,
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
static IMAGE: Image = &[
    // Safety
    (2, &[0x02, 0x26, 0x02, 0x01, 0xF4, 0x02, 0x58, 0x02, 0x02, 0x26]),
    // Charge Inhibit Config
    (32, &[0x00, 0x00, 0x01, 0xC2, 0x00, 0x32]),
    // Charge
    (34, &[0x00, 0x00, 0x10, 0x68, 0x00, 0x32, 0xFF, 0xCE, 0x02, 0x26]),
    // Charge Termination
    (36, &[0x00, 0x64, 0x00, 0x19, 0x00, 0x64, 0x28, 0x63, 0x5F, 0x64, 0x62, 0x00, 0x32]),
    // Data
    (48, &[0x00, 0x00, 0x00, 0x00, 0xF6, 0xFE, 0x0C, 0x03, 0x84, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x01]),
    // Discharge
    (49, &[0x96, 0x00, 0x00, 0x00, 0x00, 0x0B, 0xEA, 0x02, 0x0C, 0x1C]),
    // Manufacturer Info
    (57, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    // Registers
    (64, &[0x09, 0x79, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x04, 0x00, 0x00, 0xE2, 0x84, 0x42]),
    // Power
    (68, &[0x0A, 0xF0, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x00, 0x00, 0x00, 0x00, 0x00, 0x08, 0x09,
           0xF6]),
    // IT Cfg
    (80, &[0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x03, 0x20, 0x00, 0x00, 0x00, 0x00, 0x00, 0x0E,
           0xE3, 0x0E, 0xBC, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x0B, 0xB8]),
    // Current Thresholds
    (81, &[0x00, 0x3C, 0x00, 0x4B, 0x00, 0x28, 0x00, 0x3C, 0x3C, 0x01, 0x80, 0x80, 0x01, 0x90]),
    // State
    (82, &[0x00, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0xFE, 0xD5, 0xFB, 0x95]),
    // Def0 Ra
    (87, &[0x00, 0x55, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Def1 Ra
    (88, &[0x00, 0x55, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Pack0 Ra
    (91, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Pack1 Ra
    (92, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Pack0 Rax
    (93, &[0xFF, 0xFF, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Pack1 Rax
    (94, &[0xFF, 0xFF, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
           0x00, 0x00, 0x00]),
    // Data
    (104, &[0x7F, 0x74, 0x1F, 0x21, 0x94, 0x0A, 0x9C, 0x08, 0xFA, 0x65, 0x00, 0x00, 0x00, 0x00]),
    // Current
    (107, &[0xEF, 0x05]),
    // Codes
    (112, &[0x36, 0x72, 0x04, 0x14, 0xFF, 0xFF, 0xFF, 0xFF]),
];

#[cfg(test)]
mod tests {
    use super::super::check_sums;
    use super::*;

    /// Sums over SLUS914A table 4-7, calculated by hand.
    #[test]
    fn blocks_have_the_checksums_of_parts() {
        check_sums(IMAGE, &[(81, 0, 0x46), (112, 0, 0x43), (2, 0, 0x5C), (32, 0, 0x0A)]);
    }
}
