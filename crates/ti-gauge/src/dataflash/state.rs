// SPDX-License-Identifier: MIT

//! What a gauge says of itself, as far as it decides whether data flash may be touched.

use crate::chip::{Chip, Role, Word};
use crate::error::Result;
use crate::gauge::{Gauge, agreed};

pub(crate) fn read_word(gauge: &mut Gauge, word: Word) -> Result<u16> {
    match word {
        Word::ControlStatus => Ok(gauge.control_status()?.1),
        Word::Answer(code) => gauge.ask(code),
        Word::Register(code) => {
            let mut bytes = [0; 2];
            gauge.read(code, &mut bytes)?;
            Ok(u16::from_le_bytes(bytes))
        }
    }
}

/// The address of Flags(), and the bit of it that reports that data memory was lost, where there is one.
pub(super) fn lost_flag(chip: &Chip) -> Option<(u8, u16)> {
    let lost = chip.volatile.filter(|&lost| lost != 0)?;
    Some((chip.register(Role::Flags)?.code, lost))
}

/// Whether the gauge's data memory is RAM and was lost. Two looks must agree: much is given up where it was. A gauge in
/// CONFIG UPDATE has not lost its power since it entered that mode, whatever it has not forgotten of an earlier loss.
pub fn has_lost_memory(gauge: &mut Gauge) -> Result<bool> {
    let chip = gauge.chip;
    let Some((flags, lost)) = lost_flag(chip) else { return Ok(false) };
    let modes = chip.preflight.modes.iter().filter(|mode| mode.ours && mode.word == Word::Register(flags));
    let ours = modes.fold(0, |all, mode| all | mode.mask);
    agreed("Flags()", || Ok(read_word(gauge, Word::Register(flags))? & (lost | ours) == lost))
}
