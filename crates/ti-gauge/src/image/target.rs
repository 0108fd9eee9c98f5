// SPDX-License-Identifier: MIT

//! Finds the chip of a file.

use crate::chip::{CHIPS, Chip, SIBLINGS};
use crate::error::{Cause, Error, Result};

/// A file's chip, by its device type and firmware and by the chip `told`. A contradiction is an error.
pub(super) fn chip_of(
    told: Option<&'static Chip>,
    device_type: Option<u16>,
    firmware: Option<u16>,
) -> Result<&'static Chip> {
    chip_like(told, device_type, firmware, |_| true)
}

/// The chip of a file, among those that the file's form allows.
pub(super) fn chip_like(
    told: Option<&'static Chip>,
    device_type: Option<u16>,
    firmware: Option<u16>,
    is_like: impl Fn(&Chip) -> bool,
) -> Result<&'static Chip> {
    let invalid = |why: String| Err(Error::new("", Cause::Invalid, why));
    let is_of_type = |chip: &Chip| device_type.is_none_or(|code| chip.identity.device_type == code);
    let is = |chip: &Chip| is_of_type(chip) && firmware.is_none_or(|code| fits(chip.identity.firmware, code));
    let codes = || {
        let code = |what: &str, code: Option<u16>| code.map(|code| format!("{what} 0x{code:04x}"));
        let codes = [code("device type", device_type), code("firmware", firmware)];
        codes.into_iter().flatten().collect::<Vec<_>>().join(", ")
    };
    if let Some(chip) = told {
        return match (is(chip), is_of_type(chip)) {
            (true, _) => Ok(chip),
            (false, true) => invalid(format!("it is for {}; gaugefs knows a {}", codes(), versions(&[chip]))),
            (false, false) => invalid(format!("it is for {}, which a {} is not", codes(), chip.model)),
        };
    }
    if device_type.is_none() {
        return invalid("it does not say which gauge it is for; name it with --chip".into());
    }
    // A part whose identity names this firmware takes precedence over one without known firmware.
    let names = |known: &[u16]| firmware.is_some_and(|code| known.contains(&code));
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(|chip| is(chip) && is_like(chip)).collect();
    if chips.iter().any(|chip| names(chip.identity.firmware)) {
        chips.retain(|chip| names(chip.identity.firmware));
    }
    let relative = SIBLINGS.iter().find(|sibling| {
        let (of_type, known) = (device_type == Some(sibling.identity.device_type), sibling.identity.firmware);
        of_type && (names(known) || known.is_empty() && chips.is_empty())
    });
    if let ([], Some(relative)) = (chips.as_slice(), relative) {
        let name = relative.name;
        return invalid(format!(
            "it is for {}: a {name}, whose data flash gaugefs does not support",
            codes()
        ));
    }
    let names = chips.iter().map(|chip| chip.name).chain(relative.map(|relative| relative.name));
    match (chips.as_slice(), relative) {
        ([chip], None) => Ok(chip),
        ([], _) => {
            let of_type = CHIPS.iter().copied().filter(|chip| is_of_type(chip) && is_like(chip));
            let why = match &*of_type.collect::<Vec<_>>() {
                [] => ": not a gauge that gaugefs knows".into(),
                others => format!("; gaugefs knows a {}", versions(others)),
            };
            invalid(format!("it is for {}{why}", codes()))
        }
        _ => {
            let names = names.collect::<Vec<_>>().join(" or ");
            invalid(format!("it is for {}: {names}; choose with --chip", codes()))
        }
    }
}

/// The chips and their tables' firmware: `bq34z100-G1 with firmware 0x0016 and a bq34z100-R2 ...`.
pub(super) fn versions(chips: &[&Chip]) -> String {
    let version = |chip: &&Chip| match chip.identity.firmware {
        [] => chip.model.to_string(),
        known => {
            let known: Vec<_> = known.iter().map(|code| format!("0x{code:04x}")).collect();
            format!("{} with firmware {}", chip.model, known.join(" or "))
        }
    };
    chips.iter().map(version).collect::<Vec<_>>().join(" and a ")
}

pub(super) fn instead(chip: Option<&Chip>) -> String {
    match chip {
        Some(chip) if chip.subclasses.is_empty() => {
            format!("gaugefs only reads the registers of a {}, and no file configures it here", chip.model)
        }
        Some(chip) => format!("use a .gm.fs or .gg.csv of a {}", chip.model),
        None => {
            "use a .gm.fs or .gg.csv, if it is for a gauge that `gaugefs chips` lists with data flash".into()
        }
    }
}

pub(super) fn fits(known: &[u16], code: u16) -> bool {
    known.is_empty() || known.contains(&code)
}
