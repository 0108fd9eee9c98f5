// SPDX-License-Identifier: MIT

//! Which keys may be changed, and to what.

use super::ring::{ERASED, SEALS, SUBCOMMANDS};
use crate::chip::{Chip, KeyBlock, KeyStorage};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;
use crate::keys::{KeyChange, Name};

pub(super) fn block_of(chip: &'static Chip, name: Name) -> Result<&'static KeyBlock> {
    let refuse = |why: &str| {
        let why = format!("cannot be changed here: {why}");
        Err(Error::new(chip.model, Cause::NotPermitted, why).at(Step::Check))
    };
    match &chip.security.storage {
        KeyStorage::Fixed(why) | KeyStorage::Kept(_, why) => refuse(why),
        KeyStorage::Flash(block) if name == Name::Authentication => {
            match block.authentication.filter(|_| chip.authentication.is_some()) {
                Some(_) => Ok(block),
                None => refuse(
                    "this part has no authentication that gaugefs knows, so a new key could not be tried",
                ),
            }
        }
        KeyStorage::Flash(block) => Ok(block),
    }
}

/// Refuses keys that leave a gauge open or mean something else. The manual's defaults are allowed, to hand a pack on.
pub(super) fn check_new(gauge: &Gauge, change: &KeyChange) -> Result<()> {
    let refuse =
        |why: &str| Err(Error::new("", Cause::OutOfRange, format!("the new key {why}")).at(Step::Check));
    if change.new == change.old {
        let why = "the new key is the old one";
        return Err(Error::new("", Cause::Invalid, why).at(Step::Check));
    }
    let Some(default) = gauge.manual_key(change.name) else {
        let bytes = change.new.bytes();
        return match bytes.iter().all(|byte| *byte == bytes[0]) {
            true => refuse("is one byte sixteen times, which is the first that anybody tries"),
            false => Ok(()),
        };
    };
    let words = change.new.words();
    if SEALS.iter().any(|other| *other != change.name && gauge.key(*other).as_ref() == Some(&change.new)) {
        return refuse("is the other key as well: sent twice it would open the gauge wide");
    }
    if words == default {
        return Ok(());
    }
    if words.contains(&0) || words.contains(&ERASED) {
        return refuse("has a word of zeros or ones, as a bus or a flash has that fails");
    }
    if words[0] == words[1] {
        return refuse("is one word twice: a transfer that is repeated would open the gauge");
    }
    if words.iter().any(|word| *word < SUBCOMMANDS || gauge.chip.subcommand(*word).is_some()) {
        return refuse("has a word that is a subcommand, which the manual forbids");
    }
    let flat = &gauge.chip.flat;
    if words.iter().any(|word| flat.contains(word)) {
        let last = flat.end - 1;
        return refuse(&format!(
            "has a word that is an address of data flash (0x{:04x} to 0x{last:04x})",
            flat.start
        ));
    }
    Ok(())
}
