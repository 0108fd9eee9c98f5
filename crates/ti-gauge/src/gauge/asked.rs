// SPDX-License-Identifier: MIT

//! What came of asking a gauge of TI's in a Smart Battery.

use std::fmt;

use crate::chip::Way;

/// Whether it is asked, and why it is not any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Asked {
    /// No question has been sent.
    #[default]
    Not,
    /// It is that part, with this version and build of its firmware.
    Answers {
        /// By which messages.
        way: Way,
        /// Two digits in BCD before the point, two behind it.
        version: u16,
        /// The build.
        build: u16,
    },
    /// It is another part, by its type.
    OtherType(u16),
    /// The version of its firmware is that of another part.
    OtherFirmware(u16),
    /// What it answers is no answer to what it was asked.
    Unclear,
    /// It does not take the question.
    Silent,
    /// The adapter carries no answer.
    NotCarried,
    /// It is not sealed, and has no checksum: a bit error could make a command of a question.
    Unprotected,
}

const WAYS: [Way; 3] = [Way::Block, Way::Word, Way::Back];

impl Asked {
    /// Whether nothing is asked any more.
    pub fn is_over(self) -> bool {
        !matches!(self, Self::Not | Self::Answers { .. })
    }

    /// Whether that stays so until the next mount. What did not answer may have gone.
    pub(super) fn is_final(self) -> bool {
        self.is_over() && self != Self::Silent
    }

    pub(super) fn number(self) -> u64 {
        let (kind, rest) = match self {
            Self::Not => (0, 0),
            Self::Answers { way, version, build } => {
                let way = WAYS.iter().position(|one| *one == way).unwrap_or_default() as u64;
                (1, way << 32 | u64::from(version) << 16 | u64::from(build))
            }
            Self::OtherType(found) => (2, found.into()),
            Self::OtherFirmware(found) => (3, found.into()),
            Self::Unclear => (4, 0),
            Self::Silent => (5, 0),
            Self::NotCarried => (6, 0),
            Self::Unprotected => (7, 0),
        };
        kind << 48 | rest
    }

    pub(super) fn of(number: u64) -> Self {
        let word = |shift: u32| (number >> shift) as u16;
        match word(48) {
            1 => Self::Answers {
                way: *WAYS.get(usize::from(word(32))).unwrap_or(&Way::Block),
                version: word(16),
                build: word(0),
            },
            2 => Self::OtherType(word(0)),
            3 => Self::OtherFirmware(word(0)),
            4 => Self::Unclear,
            5 => Self::Silent,
            6 => Self::NotCarried,
            7 => Self::Unprotected,
            _ => Self::Not,
        }
    }
}

/// A version in BCD.
struct Version(u16);

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:x}.{:02x}", self.0 >> 8, self.0 & 0xff)
    }
}

impl fmt::Display for Asked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Not => f.write_str("not asked yet"),
            Self::Answers { way, version, build } => {
                write!(f, "answers by {}: firmware {}, build {build}", way.as_str(), Version(version))
            }
            Self::OtherType(found) => write!(f, "ended: it is another part, of type 0x{found:04x}"),
            Self::OtherFirmware(found) => {
                write!(f, "ended: firmware {} is not that of this part", Version(found))
            }
            Self::Unclear => f.write_str("ended: what it answers is not what it was asked"),
            Self::Silent => f.write_str("ended: it does not answer its type"),
            Self::NotCarried => f.write_str("ended: the adapter carries no answer, which is a block"),
            Self::Unprotected => f.write_str(
                "ended: it is not sealed, and without a checksum (PEC) a bit error could make a command of a question",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_state_keeps_its_number() {
        let answers = WAYS.map(|way| Asked::Answers { way, version: 0x0211, build: 0xffff });
        let others = [
            Asked::Not,
            Asked::OtherType(0x9e34),
            Asked::OtherFirmware(0x0402),
            Asked::Unclear,
            Asked::Silent,
            Asked::NotCarried,
            Asked::Unprotected,
        ];
        for asked in answers.into_iter().chain(others) {
            assert_eq!(Asked::of(asked.number()), asked);
        }
        assert_eq!(Asked::of(u64::MAX), Asked::Not);
        assert!(answers[0].to_string().ends_with("firmware 2.11, build 65535"), "{}", answers[0]);
    }
}
