// SPDX-License-Identifier: MIT

//! Which chip a file is for.

use crate::chip::{CHIPS, Chip, SIBLINGS};
use crate::error::{Cause, Error, Result};

/// The chip that a file is for, by the device type and firmware in it and by the chip that is `told`. A
/// contradiction is an error.
pub(super) fn chip_of(
    told: Option<&'static Chip>,
    device_type: Option<u16>,
    firmware: Option<u16>,
) -> Result<&'static Chip> {
    let invalid = |why: String| Err(Error::new("", Cause::Invalid, why));
    let is = |chip: &Chip| {
        device_type.is_none_or(|code| chip.identity.device_type == code)
            && firmware.is_none_or(|code| fits(chip.identity.firmware, code))
    };
    let codes = || {
        let code = |what: &str, code: Option<u16>| code.map(|code| format!("{what} 0x{code:04x}"));
        let codes = [code("device type", device_type), code("firmware", firmware)];
        codes.into_iter().flatten().collect::<Vec<_>>().join(", ")
    };
    if let Some(chip) = told {
        return if is(chip) {
            Ok(chip)
        } else {
            invalid(format!("it is for {}, which a {} is not", codes(), chip.model))
        };
    }
    if device_type.is_none() {
        return invalid("it does not say which gauge it is for; name it with --chip".into());
    }
    // A part whose identity names this firmware takes precedence over one without known firmware.
    let names = |known: &[u16]| firmware.is_some_and(|code| known.contains(&code));
    let mut chips: Vec<_> = CHIPS.iter().copied().filter(|chip| is(chip)).collect();
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
        ([], _) => invalid(format!("it is for {}: not a gauge that gaugefs knows", codes())),
        _ => {
            let names = names.collect::<Vec<_>>().join(" or ");
            invalid(format!("it is for {}: {names}; choose with --chip", codes()))
        }
    }
}

pub(super) fn fits(known: &[u16], code: u16) -> bool {
    known.is_empty() || known.contains(&code)
}
