// SPDX-License-Identifier: MIT

//! Recognises a part by its answers.

use crate::error::Cause;
use gauge_bus::BusError;

use super::{Answers, CHIPS, Chip, Identity, SIBLINGS, Scheme, Sibling};

/// The result of recognising a part.
#[derive(Debug)]
pub enum Recognised {
    /// A chip with a table.
    Chip(&'static Chip),
    /// A known part without a table: its standard commands may be read, its data flash is out of bounds.
    Sibling(&'static Sibling),
    /// Several chips, or parts without a table, give these answers; the user has to decide.
    Ambiguous(Vec<&'static Chip>),
    /// These chips' device type, with a firmware or hardware version that is not their tables'.
    Unproven(Vec<&'static Chip>),
    /// An unknown part.
    Unknown,
}

/// Why only a part's standard commands are used.
#[derive(Clone, Copy, Debug)]
pub enum Limited {
    /// A relative of the chip, without a table.
    Sibling(&'static Sibling),
    /// The chip's device type, with a firmware or hardware version that is not its table's.
    Unproven,
    /// The chip has no table.
    NoTable,
    /// The host of its bus sends no write to its address.
    WriteDisabled,
}

impl Limited {
    /// Name of the part.
    pub fn name(self, chip: &Chip) -> &'static str {
        match self {
            Limited::Sibling(sibling) => sibling.name,
            Limited::Unproven | Limited::NoTable | Limited::WriteDisabled => chip.model,
        }
    }

    /// Whether it is sent nothing but the registers' numbers.
    pub fn is_never_asked(self) -> bool {
        matches!(self, Limited::NoTable | Limited::WriteDisabled)
    }

    /// The cause of a refusal of everything else.
    pub fn cause(self) -> Cause {
        if matches!(self, Limited::WriteDisabled) { Cause::ReadOnly } else { Cause::NotPermitted }
    }

    /// Why it is limited, and what would change that.
    pub fn why(self, chip: &Chip, answers: &Answers) -> String {
        let found = match self {
            Limited::NoTable if chip.access.scheme == Scheme::Smbus => return chip.only_read().to_string(),
            Limited::Sibling(_) | Limited::NoTable => {
                let why =
                    "no table describes its data flash and subcommands; only standard commands are read";
                return why.to_string();
            }
            Limited::WriteDisabled => {
                let why = BusError::WriteDisabled;
                return format!("only standard commands are read, and there is no df: {why}");
            }
            Limited::Unproven => {
                let build = answers.build.map(built).unwrap_or_default();
                let (firmware, hardware) = (answers.firmware_version, answers.hardware_version);
                format!("firmware 0x{firmware:04x}{build}, hardware 0x{hardware:04x}")
            }
        };
        let identity = &chip.identity;
        let build = identity.build.map(built).unwrap_or_default();
        let firmware: Vec<_> =
            identity.firmware.iter().map(|code| format!("firmware 0x{code:04x}{build}")).collect();
        let hardware = identity.hardware.map(|code| format!("hardware 0x{code:04x}"));
        let proven: Vec<_> = firmware.into_iter().chain(hardware).collect();
        format!(
            "{found}: the table was proven only for {}, so only standard commands are read, and there is no df. To have \
             this version added, send the file that `gaugefs report` writes, and, if there is one, a gg.csv that bqStudio \
             exported from this gauge",
            proven.join(", ")
        )
    }
}

fn built(build: u16) -> String {
    format!(" build 0x{build:04x}")
}

/// Identifies a part by its answers. One whose identity names the hardware, a DM_CODE or the firmware takes precedence.
pub fn recognise(answers: &Answers) -> Recognised {
    let names_hardware = |one: &Identity| one.hardware.is_some();
    let names_dm_code = |one: &Identity| answers.dm_code.is_some_and(|code| one.dm_codes.contains(&code));
    let fits = |chip: &&Chip| chip.identity.fits(answers) && !chip.is_inferred();
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(fits).collect();
    let mut siblings: Vec<_> = SIBLINGS.iter().filter(|sibling| sibling.identity.fits(answers)).collect();
    let names_firmware = |one: &Identity| one.firmware.contains(&answers.firmware_version);
    let choices: &[&dyn Fn(&Identity) -> bool] = &[&names_hardware, &names_dm_code, &names_firmware];
    for named in choices {
        let in_chips = chips.iter().any(|chip| named(&chip.identity));
        if in_chips || siblings.iter().any(|sibling| named(&sibling.identity)) {
            chips.retain(|chip| named(&chip.identity));
            siblings.retain(|sibling| named(&sibling.identity));
        }
    }
    match (chips.as_slice(), siblings.as_slice()) {
        ([], []) => unproven(answers),
        ([], [sibling]) => Recognised::Sibling(sibling),
        ([chip], []) => Recognised::Chip(chip),
        _ => {
            let likes = siblings.iter().filter_map(|sibling| sibling.like);
            Recognised::Ambiguous(chips.into_iter().chain(likes.filter(|like| !like.has_table())).collect())
        }
    }
}

/// Judges answers that no part gives exactly. A hardware version narrows down the chips of a device type.
fn unproven(answers: &Answers) -> Recognised {
    let fits = |chip: &&Chip| chip.identity.is_of_type(answers) && !chip.is_inferred();
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(fits).collect();
    let is_hardware = |chip: &&Chip| chip.identity.hardware == Some(answers.hardware_version);
    if chips.iter().any(is_hardware) {
        chips.retain(|chip| is_hardware(chip));
    }
    if chips.is_empty() { Recognised::Unknown } else { Recognised::Unproven(chips) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The recognised part for these answers.
    fn seen(device_type: u16, firmware_version: u16, hardware_version: u16, dm_code: Option<u16>) -> String {
        let answers =
            Answers { device_type, firmware_version, hardware_version, dm_code, ..Answers::default() };
        match recognise(&answers) {
            Recognised::Chip(chip) => chip.name.to_string(),
            Recognised::Sibling(Sibling { name, like: Some(chip), .. }) => {
                format!("{name} like {}", chip.name)
            }
            Recognised::Sibling(Sibling { name, like: None, .. }) => format!("{name} like none"),
            Recognised::Ambiguous(chips) => {
                chips.iter().map(|chip| chip.name).collect::<Vec<_>>().join(" or ")
            }
            Recognised::Unproven(chips) => {
                let chips: Vec<_> = chips.iter().map(|chip| chip.name).collect();
                format!("unproven {}", chips.join(" or "))
            }
            Recognised::Unknown => "unknown".to_string(),
        }
    }

    #[test]
    fn a_firmware_without_a_table_is_a_sibling() {
        assert_eq!(seen(0x0100, 0x0016, 0x0008, None), "bq34z100-g1");
        assert_eq!(seen(0x0100, 0x0202, 0x0008, None), "bq34z100-r2");
        assert_eq!(seen(0x0100, 0x0202, 0x0009, None), "bq34z100-r2");
        assert_eq!(seen(0x0100, 0x0202, 0x00a8, None), "bq35100");
        assert_eq!(seen(0x0110, 0x0100, 0x0000, None), "bq34110");
        assert_eq!(seen(0x0520, 0x0324, 0x0000, None), "bq27520-g3");
        assert_eq!(seen(0x0500, 0x0106, 0x0000, None), "bq27500");
        assert_eq!(seen(0x0500, 0x0120, 0x0000, None), "bq27500");
        assert_eq!(seen(0x0500, 0x0130, 0x0000, None), "bq27500-v130");
        assert_eq!(seen(0x0520, 0x0311, 0x0000, None), "bq27520-G2 like bq27520-g3");
        assert_eq!(seen(0x0520, 0x0329, 0x0000, None), "bq27520-G4 like bq27520-g4");
        let z610 = |firmware_version, build| {
            let answers = Answers { device_type: 0x2610, firmware_version, build, ..Answers::default() };
            matches!(recognise(&answers), Recognised::Chip(chip) if chip.name == "bq28z610")
        };
        assert!(z610(0x0017, Some(0x0016)));
        // Another build, or one that is not known.
        assert!(!z610(0x0017, Some(0x0017)) && !z610(0x0017, None) && !z610(0x0018, Some(0x0016)));
        assert_eq!(seen(0xffff, 0xffff, 0xffff, None), "unknown");
        assert_eq!(seen(0x0000, 0x0000, 0x0000, None), "unknown");
    }

    #[test]
    fn a_type_of_several_maps_is_for_the_user_to_decide() {
        assert_eq!(seen(0x0541, 0x0224, 0, None), "bq27541-g1");
        assert_eq!(seen(0x0541, 0x0200, 0, None), "bq27541-V200 like bq27541");
        assert_eq!(seen(0x0541, 0x0117, 0, None), "bq27541 or bq27546");
        assert_eq!(seen(0x0510, 0x0400, 0, None), "bq27510-g1 or bq27510-g2 or bq27510-g3");
        // Types that only the name of a part suggests.
        for device_type in [0x0521, 0x0530, 0x0531, 0x0545, 0x0546, 0x0425] {
            assert_eq!(seen(device_type, 0x0100, 0, None), "unknown");
        }
    }

    #[test]
    fn another_version_of_a_known_type_is_unproven() {
        assert_eq!(seen(0x0520, 0x0325, 0x0000, None), "unproven bq27520-g3");
        assert_eq!(seen(0x0500, 0x0108, 0x0000, None), "unproven bq27500 or bq27500-v130");
        assert_eq!(seen(0x0100, 0x0017, 0x0008, None), "unproven bq34z100-g1");
        assert_eq!(seen(0x0100, 0x0016, 0x0009, None), "unproven bq34z100-g1 or bq34z100-r2 or bq35100");
        assert_eq!(seen(0x0421, 0x0200, 0, None), "unproven bq27441-g1 or bq27421-g1");
    }

    #[test]
    fn dm_code_distinguishes_parts_of_one_type() {
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x48)), "bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x58)), "bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x80)), "bq27411-G1 like bq27441-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, Some(0x11)), "bq27421-g1");
        assert_eq!(seen(0x0421, 0x0109, 0, None), "bq27441-g1 or bq27421-g1");
        assert_eq!(seen(0x0421, 0x0200, 0, Some(0x48)), "unproven bq27441-g1 or bq27421-g1");
    }

    #[test]
    fn a_unique_device_type_is_enough() {
        assert_eq!(seen(0x0427, 0x0202, 0, Some(0x9f)), "bq27427");
        assert_eq!(seen(0x0427, 0x0202, 0, None), "bq27427");
        assert_eq!(seen(0x0427, 0x0109, 0, None), "unproven bq27427");
        assert_eq!(seen(0x0426, 0x0202, 0, Some(0x9f)), "bq27426");
        assert_eq!(seen(0x0621, 0x0105, 0, None), "bq27621-g1");
        assert_eq!(seen(0x0621, 0x0110, 0, None), "unproven bq27621-g1");
    }
}
