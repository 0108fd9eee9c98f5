// SPDX-License-Identifier: MIT

//! How the arguments of operations are written. An error repeats no word that is unknown: it may be half of a key.

use std::time::Duration;

use super::operation::Context;
use super::{Seal, Version, Wish};
use crate::error::{Cause, Error, Result};
use ti_gauge::calibration::Job;
use ti_gauge::chip::Effect;
use ti_gauge::dataflash::Decision;
use ti_gauge::text;

/// Any text means the same.
pub(super) fn anything(_: &Context, _: &[u8]) -> Result<()> {
    Ok(())
}

fn trimmed(data: &[u8]) -> &str {
    std::str::from_utf8(data).unwrap_or_default().trim()
}

pub(super) fn seal(_: &Context, data: &[u8]) -> Result<Seal> {
    let seals = [Seal::Sealed, Seal::Unsealed, Seal::FullAccess];
    let found = seals.into_iter().find(|seal| seal.as_str().eq_ignore_ascii_case(trimmed(data)));
    let why = "not a state of the seal; write sealed, unsealed or full-access";
    found.ok_or_else(|| Error::new("seal", Cause::Invalid, why))
}

/// `show`, or a decision about an interrupted write, with the serial number of another pack if it is meant.
pub(super) fn decision(_: &Context, data: &[u8]) -> Result<Option<Decision>> {
    let usage = "not a decision; write show, undo, finish or discard; undo and finish may be followed by the pack's \
                 serial number";
    let bad = || Error::new("settle", Cause::Invalid, usage);
    let words = trimmed(data).to_ascii_lowercase();
    let mut words = words.split_ascii_whitespace();
    let (word, number) = (words.next().unwrap_or_default(), words.next());
    let pack = match number.map(|number| (number, number.strip_prefix("0x"))) {
        None => None,
        Some((_, Some(digits))) => Some(u16::from_str_radix(digits, 16).map_err(|_| bad())?),
        Some((digits, None)) => Some(digits.parse().map_err(|_| bad())?),
    };
    match (word, pack, words.next()) {
        ("show", None, None) => Ok(None),
        ("undo", pack, None) => Ok(Some(Decision::Undo(pack))),
        ("finish", pack, None) => Ok(Some(Decision::Finish(pack))),
        ("discard", None, None) => Ok(Some(Decision::Discard)),
        _ => Err(bad()),
    }
}

/// `show`, `restore`, also with the name of a version, or `forget`: what somebody wants of what was learned.
pub(super) fn wish(_: &Context, data: &[u8]) -> Result<Wish> {
    let bad = |why| Error::new("learned", Cause::Invalid, why);
    let words = trimmed(data).to_ascii_lowercase();
    let mut words = words.split_ascii_whitespace();
    match (words.next().unwrap_or_default(), words.next(), words.next()) {
        ("show", None, _) => Ok(Wish::Show),
        ("restore", None, _) => Ok(Wish::Restore(None)),
        ("restore", Some(version), None) => Version::parse(version)
            .map(|version| Wish::Restore(Some(version)))
            .ok_or_else(|| bad("not a version; each is named by its time, such as 20261125T093000Z")),
        ("forget", None, _) => Ok(Wish::Forget),
        _ => Err(bad("write show, restore, restore VERSION or forget")),
    }
}

/// The meter's values are divided by the scales: registers and data flash are in the gauge's own steps.
pub(super) fn job(context: &Context, data: &[u8]) -> Result<Job> {
    let usage = "write board-offset, cc-offset, voltage MV, current MA, temperature CELSIUS, bringup CELLS DIVIDER [MV] \
                 or leave";
    let bad = || Error::new("calibrate", Cause::Invalid, usage);
    let number = |word: &str| word.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(bad);
    let step = |word: &str, scale: Option<f64>| -> Result<f64> {
        let why = "the scale of the gauge is not known yet; wait for a poll";
        let scale =
            scale.filter(|scale| *scale > 0.0).ok_or_else(|| Error::new("calibrate", Cause::NotNow, why))?;
        Ok(number(word)? / scale)
    };
    let words: Vec<&str> = trimmed(data).split_whitespace().collect();
    Ok(match words[..] {
        ["board-offset"] => Job::BoardOffset,
        ["cc-offset"] => Job::CcOffset,
        ["voltage", actual] => Job::Voltage(step(actual, context.voltage_scale)?),
        ["current", actual] => Job::Current(step(actual, context.current_scale)?),
        ["temperature", actual] => Job::Temperature(number(actual)?),
        ["leave"] => Job::Leave,
        ["bringup", cells, divider, ref voltage @ ..] if voltage.len() < 2 => Job::BringUp {
            cells: cells.parse().map_err(|_| bad())?,
            divider: divider.parse().map_err(|_| bad())?,
            voltage_mv: voltage.first().map(|voltage| step(voltage, context.voltage_scale)).transpose()?,
        },
        _ => return Err(bad()),
    })
}

pub(super) fn subcommand(context: &Context, data: &[u8]) -> Result<u16> {
    if let Some(why) = &context.limitation {
        return Err(why.clone());
    }
    let word = trimmed(data);
    let coded = text::unsigned(word).and_then(|code| context.chip.subcommand(code));
    let mut all = context.chip.subcommands.iter();
    let found = coded.or_else(|| all.find(|one| one.name.eq_ignore_ascii_case(word)));
    let is_allowed = |effect| matches!(effect, Effect::Answers | Effect::Safe);
    match found {
        Some(found) if is_allowed(found.effect) => Ok(found.code),
        found => {
            let allowed = context.chip.subcommands.iter().filter(|one| is_allowed(one.effect));
            let allowed: Vec<_> = allowed.map(|one| one.name).collect();
            // An unknown word is not repeated: it may be half of a key.
            let what = found.map_or("unknown subcommand".into(), |found| match found.effect {
                Effect::Never => format!("{} may ruin or lock a gauge and is never sent", found.name),
                _ => format!("{} is not allowed here", found.name),
            });
            // A name that other tools use for it is told as well.
            let means = |names: &[&str]| names.iter().any(|name| name.eq_ignore_ascii_case(word));
            let instead = match found.map(|found| found.code) {
                Some(code) if code == context.chip.security.seal => "; write sealed to gauge/seal",
                None if means(&["seal", "sealed"]) => "; write sealed to gauge/seal",
                None if means(&["unseal", "unsealed"]) => "; write unsealed to gauge/seal",
                Some(_)
                    if found.is_some_and(|found| found.name == "RESET") && context.chip.is_never_reset() =>
                {
                    "; what is written counts from the gauge's next start on"
                }
                _ if means(&["reset", "soft_reset"]) || found.is_some_and(|found| found.name == "RESET") => {
                    "; gaugefs resets the gauge itself after a write that needs it"
                }
                _ => "",
            };
            let why = format!("{what}{instead}; allowed are {}", allowed.join(" "));
            Err(Error::new("control", Cause::Invalid, why))
        }
    }
}

/// An error does not repeat the text, which may be a key.
pub(super) fn interval(_: &Context, data: &[u8]) -> Result<Duration> {
    let seconds: f64 = trimmed(data).parse().map_err(|_| {
        let why = "not a number of seconds; write 0.5 to 3600";
        Error::new("poll_interval", Cause::Invalid, why)
    })?;
    if !(0.5..=3600.0).contains(&seconds) {
        let why = "the number of seconds is outside 0.5 to 3600";
        return Err(Error::new("poll_interval", Cause::OutOfRange, why));
    }
    Ok(Duration::from_secs_f64(seconds))
}
