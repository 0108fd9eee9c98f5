// SPDX-License-Identifier: MIT

//! The answers that identify a part, and the known parts that have no table.

use super::{Chip, bq27441_g1, bq27520_g3, kernel};
use crate::value::Type;

/// The answers that identify a part.
#[derive(Clone, Debug)]
pub struct Identity {
    /// Control(DEVICE_TYPE).
    pub device_type: u16,
    /// Control(FW_VERSION) values of the table; empty if none is known and any is accepted.
    pub firmware: &'static [u16],
    /// The build that follows the version in the answer to FW_VERSION, where the table is that of one build.
    pub build: Option<u16>,
    /// Control(HW_VERSION), if it distinguishes parts with the same device type.
    pub hardware: Option<u16>,
    /// Control(DM_CODE) values, if they distinguish equal device types; empty for any that no other part has.
    pub dm_codes: &'static [u16],
    /// The register in which the answers to DEVICE_TYPE and the like are read.
    pub answer: u8,
}

impl Identity {
    /// For a part that is chosen by name or recognised by a row of [`SIBLINGS`]: no part answers with type 0.
    pub(super) const NONE: Self =
        Self { device_type: 0, firmware: &[], build: None, hardware: None, dm_codes: &[], answer: 0 };

    /// Whether a part of this identity gives these answers.
    pub fn fits(&self, answers: &Answers) -> bool {
        self.is_of_type(answers)
            && known(self.firmware, answers.firmware_version)
            && self.build.is_none_or(|build| answers.build == Some(build))
            && self.hardware.is_none_or(|hardware| hardware == answers.hardware_version)
    }

    pub(crate) fn answers_in_mac_data(&self) -> bool {
        self.answer != 0
    }

    /// Whether a version in a file is the device number with its bytes swapped, which gaugefs once wrote in its place.
    pub(crate) fn is_device_number(&self, version: u16) -> bool {
        self.answers_in_mac_data() && version == self.device_type.swap_bytes()
    }

    pub(super) fn is_of_type(&self, answers: &Answers) -> bool {
        self.device_type == answers.device_type
            && answers.dm_code.is_none_or(|code| known(self.dm_codes, code))
    }
}

fn known(codes: &[u16], code: u16) -> bool {
    codes.is_empty() || codes.contains(&code)
}

/// A part's answers to the subcommands that identify it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Answers {
    /// Control(DEVICE_TYPE).
    pub device_type: u16,
    /// Control(FW_VERSION).
    pub firmware_version: u16,
    /// Control(HW_VERSION); 0 where the part does not have it.
    pub hardware_version: u16,
    /// The build behind the version, where the part's table asks for it.
    pub build: Option<u16>,
    /// Control(CHEM_ID), where the part has it.
    pub chem_id: Option<u16>,
    /// Control(DM_CODE), where the part has it.
    pub dm_code: Option<u16>,
}

/// A parameter that must hold a plausible value before the first write.
#[derive(Clone, Debug)]
pub struct Signature {
    /// Subclass id.
    pub subclass: u8,
    /// Offset in the subclass.
    pub offset: u16,
    /// Type. An `F4` is compared as an `H4`, and a string by its length, as a `U1`.
    pub kind: Type,
    /// Smallest plausible value.
    pub min: i64,
    /// Largest plausible value.
    pub max: i64,
}

impl Signature {
    /// A row of [`Chip::signature`].
    pub const fn new(subclass: u8, offset: u16, kind: Type, min: i64, max: i64) -> Self {
        Self { subclass, offset, kind, min, max }
    }

    /// Whether a value is plausible there.
    pub fn holds(&self, value: i64) -> bool {
        (self.min..=self.max).contains(&value)
    }
}

/// A known part without a table.
#[derive(Clone, Debug)]
pub struct Sibling {
    /// TI's name.
    pub name: &'static str,
    /// What it answers.
    pub identity: Identity,
    /// The chip whose standard commands it shares; `None` if its addresses mean something else.
    pub like: Option<&'static Chip>,
}

impl Sibling {
    const fn new(
        name: &'static str,
        device_type: u16,
        firmware: &'static [u16],
        dm_codes: &'static [u16],
        like: Option<&'static Chip>,
    ) -> Self {
        Self { name, identity: Identity { device_type, firmware, dm_codes, ..Identity::NONE }, like }
    }
}

/// Known parts without a table. Only the user can tell rows with the same answers apart; an inferred type has no row.
pub static SIBLINGS: &[Sibling] = &[
    // The generations differ in firmware only, which can be exchanged. The first has no CycleCount() in
    // the kernel's driver, the last another map of commands; 6.04 is a build for one product.
    Sibling::new("bq27520-G1", 0x0520, &[0x0302], &[], Some(&kernel::BQ27520_G1)),
    Sibling::new("bq27520-G2", 0x0520, &[0x0311], &[], Some(&bq27520_g3::CHIP)),
    Sibling::new("bq27520-G4", 0x0520, &[0x0329, 0x0604], &[], Some(&kernel::BQ27520_G4)),
    // Firmware 1.09 like its sisters; codes from SLUSBN7D. Its configuration is in one-time programmable memory.
    Sibling::new("bq27411-G1", 0x0421, &[0x0109], &[0x80, 0x90, 0xA0], Some(&bq27441_g1::CHIP)),
    // Types that parts were seen to answer with, or that several drivers compare. Firmware versions are not known.
    Sibling::new("bq27510-G1", 0x0510, &[], &[], Some(&kernel::BQ27510_G1)),
    Sibling::new("bq27510-G2", 0x0510, &[], &[], Some(&kernel::BQ27510_G2)),
    Sibling::new("bq27510-G3", 0x0510, &[], &[], Some(&kernel::BQ27510_G3)),
    // Four parts have one type. The firmware is printed for the bq27541-G1 (SLUSAL6C), which has a table, in the name of
    // the bq27541-V200 (SLUSA11), and not for the first bq27541 and the bq27546-G1 (SLUSC53), which has a threshold in
    // the place of the others' AveragePower().
    Sibling::new("bq27541-V200", 0x0541, &[0x0200], &[], Some(&kernel::BQ27541)),
    Sibling::new("bq27541", 0x0541, &[], &[], Some(&kernel::BQ27541)),
    Sibling::new("bq27546", 0x0541, &[], &[], Some(&kernel::BQ27546)),
    Sibling::new("bq27542", 0x0542, &[], &[], Some(&kernel::BQ27542)),
    // Its block access is another one, but DEVICE_TYPE at Control() is the same.
    Sibling::new("bq27z561", 0x1561, &[], &[], Some(&kernel::BQ27Z561)),
];
