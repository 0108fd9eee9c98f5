// SPDX-License-Identifier: MIT

//! What a gauge says of itself, as far as it decides whether data flash may be touched.

use std::time::Duration;

use super::Change;
use crate::chip::{Chip, Role, Source};
use crate::error::Result;
use crate::gauge::{Gauge, agreed};
use crate::registers;
use crate::value::Value;

/// Between two looks at a register that is to show what data memory holds, and the time that it has for that.
const COPY_POLL: Duration = Duration::from_millis(25);
const COPIES: Duration = Duration::from_millis(500);
/// How long Voltage() may be 0 after a reset: nothing is valid before [INITCOMP] (SLUUAC9A 2.4.6).
const FIRST_MEASUREMENT: Duration = Duration::from_secs(2);
const MEASUREMENT_POLL: Duration = Duration::from_millis(50);

pub(crate) fn read_word(gauge: &mut Gauge, source: Source) -> Result<u16> {
    read_bits(gauge, source).map(|word| word as u16)
}

/// Reads a flag word, which has two bytes unless the source has a row of another size.
pub(crate) fn read_bits(gauge: &mut Gauge, source: Source) -> Result<u32> {
    match source {
        Source::Status => Ok(gauge.control_status()?.1),
        Source::Answer(code) | Source::Within(code, _) => gauge.ask(code).map(u32::from),
        Source::Command(code) => {
            let size = gauge.chip.register_at(source).map_or(2, |row| row.size.min(4));
            let mut bytes = [0; 4];
            gauge.read(code, &mut bytes[..size.into()])?;
            Ok(registers::number(&bytes) as u32)
        }
    }
}

/// Looks at a voltage, again while the gauge has measured none: that is no flat battery's.
pub(super) fn once_measured<T>(
    gauge: &mut Gauge,
    look: impl Fn(&mut Gauge) -> Result<T>,
    voltage_mv: impl Fn(&T) -> u16,
) -> Result<T> {
    let end = gauge.clock.now() + FIRST_MEASUREMENT;
    loop {
        let seen = look(gauge)?;
        if voltage_mv(&seen) != 0 || !gauge.may_try_until(end) {
            return Ok(seen);
        }
        gauge.wait(MEASUREMENT_POLL);
    }
}

/// Flags(), and the bit of it that reports that data memory was lost, where there is one.
pub(super) fn lost_flag(chip: &Chip) -> Option<(Source, u32)> {
    let lost = chip.volatile.filter(|&lost| lost != 0)?;
    Some((chip.register(Role::Flags)?.source, lost))
}

/// Whether RAM was lost. Two looks must agree, because much is given up. In CONFIG UPDATE an earlier loss does not count.
pub fn has_lost_memory(gauge: &mut Gauge) -> Result<bool> {
    let chip = gauge.chip;
    let Some((flags, lost)) = lost_flag(chip) else { return Ok(false) };
    let modes = chip.preflight.modes.iter().filter(|mode| mode.ours && mode.word == flags);
    let ours = modes.fold(0, |all, mode| all | mode.mask);
    agreed("Flags()", || Ok(read_bits(gauge, flags)? & (lost | ours) == lost))
}

/// A register that shows a parameter while the gauge works, and what it is to show before and after a change.
#[derive(Clone, Copy)]
pub(super) struct Copied {
    source: Source,
    old: u16,
    new: u16,
}

impl Copied {
    /// DesignCapacity(), if changes include that parameter. `old` are the bytes that they replace.
    pub(super) fn of(chip: &Chip, changes: &[Change], old: &[Vec<u8>]) -> Option<Self> {
        let register = chip.register(Role::ChargeFullDesign)?;
        let (change, old) = changes.iter().zip(old).find(|(change, _)| {
            change.row().is_some_and(|(_, parameter)| parameter.name.replace(' ', "") == register.name)
        })?;
        let kind = change.row()?.1.kind;
        let word = |bytes: &[u8]| match chip.layout.decode(kind, bytes) {
            Value::Int(word) => u16::try_from(word).ok(),
            _ => None,
        };
        Some(Self { source: register.source, old: word(old)?, new: word(&change.stored_over(old))? })
    }
}

/// Whether RAM holds what was looked at in CONFIG UPDATE, which has ended: DesignCapacity() has its new value. A flag of a
/// loss is looked at by the transaction's end. A part without one must have shown another value before.
pub(super) fn has_kept(gauge: &mut Gauge, copied: Option<&Copied>) -> Result<bool> {
    let has_flag = lost_flag(gauge.chip).is_some();
    let Some(copied) = copied.filter(|copied| has_flag || copied.old != copied.new) else {
        return Ok(has_flag);
    };
    let limit = gauge.clock.now() + COPIES.max(gauge.chip.access.reset);
    while agreed("DesignCapacity()", || read_word(gauge, copied.source))? != copied.new {
        if !gauge.may_try_until(limit) {
            return Ok(false);
        }
        gauge.wait(COPY_POLL);
    }
    Ok(true)
}
