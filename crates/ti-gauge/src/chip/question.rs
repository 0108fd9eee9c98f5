// SPDX-License-Identifier: MIT

//! Questions to a gauge of TI's in a Smart Battery: ManufacturerAccess() commands that are only read.
//!
//! The same code is a status on one part and a command, a key or flash on another. So a question can only be made from a
//! row of the part's table that answers and changes nothing, and a message only from a question.

use super::{Chip, Effect};

/// How a gauge of TI's in a Smart Battery is asked, and told from others by its first answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asks {
    /// DeviceType(), and the first field of FirmwareVersion().
    pub device_type: u16,
    /// The major versions of the firmware that the table is for, in BCD; empty where no source ties them to the part.
    pub majors: &'static [u8],
    /// The ways by which it answers, the better one first.
    pub ways: &'static [Way],
    /// The bits of OperationStatus() that are all set while it is sealed.
    pub sealed: u32,
    /// The bit of OperationStatus() that a permanent failure sets; 0 where no source has it.
    pub failed: u32,
}

/// By which messages it is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// A block of two bytes to ManufacturerBlockAccess(), 0x44, where the answer follows the code.
    Block,
    /// A word to ManufacturerAccess(), 0x00; the answer is the block ManufacturerData(), 0x23, without the code.
    Word,
    /// A word to 0x00, where the answer is a word, too.
    Back,
}

impl Way {
    /// The command code at which it answers.
    pub(crate) fn code(self) -> u8 {
        match self {
            Way::Block => 0x44,
            Way::Word => 0x23,
            Way::Back => 0x00,
        }
    }

    /// A few words for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Way::Block => "blocks at 0x44",
            Way::Word => "a word to 0x00 and a block at 0x23",
            Way::Back => "words at 0x00",
        }
    }
}

/// A command that is asked and changes nothing. [`Question::of`] is the only way to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Question(u16);

impl Question {
    /// What every part is asked first.
    pub const DEVICE_TYPE: u16 = 0x0001;
    /// What it is asked next.
    pub const FIRMWARE_VERSION: u16 = 0x0002;
    /// PFStatus(), the reasons of a permanent failure.
    pub const PF_STATUS: u16 = 0x0053;
    /// OperationStatus().
    pub const OPERATION_STATUS: u16 = 0x0054;

    /// The question of that code, if the part's table has it as a command that answers and does nothing else.
    pub fn of(chip: &Chip, code: u16) -> Option<Self> {
        chip.asks?;
        let row = chip.subcommand(code)?;
        (row.effect == Effect::Answers).then_some(Self(code))
    }

    /// All questions of a part, by code and name.
    pub fn all(chip: &'static Chip) -> impl Iterator<Item = (Self, &'static str)> {
        chip.subcommands.iter().filter_map(|row| Some((Self::of(chip, row.code)?, row.name)))
    }

    /// The word that is sent.
    pub fn code(self) -> u16 {
        self.0
    }

    /// The message that asks it.
    pub(crate) fn message(self, way: Way) -> Vec<u8> {
        let [low, high] = self.0.to_le_bytes();
        match way {
            Way::Block => vec![way.code(), 2, low, high],
            Way::Word | Way::Back => vec![0x00, low, high],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CHIPS, Subcommand};
    use super::*;

    #[test]
    fn what_does_more_than_answer_is_no_question() {
        for chip in Chip::all().filter(|chip| chip.asks.is_some()) {
            for (question, name) in Question::all(chip) {
                let words = [question.message(Way::Word), question.message(Way::Block)];
                let [low, high] = question.code().to_le_bytes();
                assert_eq!(words, [vec![0x00, low, high], vec![0x44, 2, low, high]], "{name}");
            }
            let effects = [Effect::Safe, Effect::Guarded, Effect::Never];
            for effect in effects {
                let rows = vec![Subcommand::new(0x0050, "SafetyAlert", effect)].leak();
                let other = Chip { subcommands: rows, ..chip.clone() };
                assert_eq!(Question::of(&other, 0x0050), None, "{effect:?}");
            }
            assert_eq!(Question::of(chip, 0x0010), None, "SHUTDOWN");
        }
        // CONTROL_STATUS of another family is no question, whatever its table says of it.
        let answers = CHIPS.iter().flat_map(|chip| chip.subcommands.iter().map(move |row| (chip, row.code)));
        assert!(answers.into_iter().all(|(chip, code)| Question::of(chip, code).is_none()));
    }
}
