// SPDX-License-Identifier: MIT

//! What is known of a Smart Battery's answers: whether it sends packet error codes, and which codes it has.

use std::collections::{BTreeMap, BTreeSet};

use super::asked::Asked;

/// Packet error codes of a pack.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Pec {
    /// It has not been asked.
    #[default]
    Unasked,
    /// SpecificationInfo() says that it has none.
    None,
    /// They are compared, and right.
    Right,
    /// They are compared, and cover the second message alone: the adapter puts a STOP between the two.
    Split,
    /// The pack says that it sends them, and does not.
    Wrong,
    /// The adapter carries no byte behind a word.
    Unseen,
    /// The adapter compares them itself: a host of SMBus.
    Host,
}

impl Pec {
    const ALL: [Self; 7] =
        [Self::Unasked, Self::None, Self::Right, Self::Split, Self::Wrong, Self::Unseen, Self::Host];

    pub(super) fn number(self) -> u64 {
        Self::ALL.iter().position(|one| *one == self).unwrap_or_default() as u64
    }

    pub(super) fn of(number: u64) -> Self {
        Self::ALL.get(number as usize).copied().unwrap_or_default()
    }

    pub(super) fn is_checked(self) -> bool {
        matches!(self, Self::Right | Self::Split | Self::Host)
    }

    /// A word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unasked => "unasked",
            Self::None => "none",
            Self::Right => "checked",
            Self::Split => "checked, split",
            Self::Wrong => "not checked, wrong",
            Self::Unseen => "not checked, not carried",
            Self::Host => "checked by the adapter",
        }
    }

    pub(super) fn told(self) -> Option<&'static str> {
        match self {
            Self::Unasked | Self::None | Self::Right | Self::Host => None,
            Self::Split => Some(
                "the adapter puts a STOP between a command and its answer: the packet error codes cover the answer alone, \
                 and are compared so",
            ),
            Self::Wrong => Some(
                "the pack says that it sends packet error codes (PEC), and does not: bit errors are not noticed",
            ),
            Self::Unseen => Some(
                "the pack sends packet error codes (PEC), which this adapter does not carry: bit errors are not noticed",
            ),
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Code {
    is_lacking: bool,
    /// It has read as something else than the one before it.
    is_own: bool,
}

/// Words of several codes; `None` where the pack has none.
pub(super) type Words = Vec<Option<Vec<u8>>>;

#[derive(Debug)]
pub(super) struct Packets {
    /// Where the pack is: a packet error code covers the address.
    pub(super) address: u8,
    pub(super) pec: Pec,
    codes: BTreeMap<u8, Code>,
    last: Option<(u8, [u8; 2])>,
    /// The serial number of the pack.
    pub(super) serial: Option<Vec<u8>>,
    /// The mode that decides units, and the last words that were read in it.
    pub(super) in_mode: Option<Words>,
    pub(super) asked: Asked,
    /// Questions that it has not answered.
    pub(super) unknown: BTreeSet<u16>,
    /// The last answer to a question.
    pub(super) heard: Option<Vec<u8>>,
    /// The last answer was none to its question.
    pub(super) was_wrong: bool,
}

impl Packets {
    pub(super) fn at(address: u8) -> Self {
        Self {
            address,
            pec: Pec::Unasked,
            codes: BTreeMap::new(),
            last: None,
            serial: None,
            in_mode: None,
            asked: Asked::Not,
            unknown: BTreeSet::new(),
            heard: None,
            was_wrong: false,
        }
    }

    /// Another pack may be there.
    pub(super) fn forget(&mut self) {
        // One that was not the part is not asked again, whatever comes in its place.
        let asked = if self.asked.is_final() { self.asked } else { Asked::Not };
        *self = Self { asked, ..Self::at(self.address) };
    }

    /// Whether the pack has not acknowledged a code, with all repeats.
    pub(super) fn is_lacking(&self, code: u8) -> bool {
        self.codes.get(&code).is_some_and(|code| code.is_lacking)
    }

    /// The pack has not acknowledged a code. Returns whether that is new.
    pub(super) fn lacks(&mut self, code: u8) -> bool {
        !std::mem::replace(&mut self.codes.entry(code).or_default().is_lacking, true)
    }

    pub(super) fn answers(&mut self, code: u8) {
        self.codes.entry(code).or_default().is_lacking = false;
    }

    /// Whether a word may be that of the code before it, which the pack repeats.
    pub(super) fn repeats(&self, code: u8, word: [u8; 2]) -> bool {
        let is_own = self.codes.get(&code).is_some_and(|code| code.is_own);
        !is_own && self.last.is_some_and(|(last, read)| last != code && read == word)
    }

    /// The word that a code has read. One that repeats another is not the code's own.
    pub(super) fn saw(&mut self, code: u8, word: [u8; 2], is_stale: bool) {
        self.codes.entry(code).or_default().is_own |= self.last.is_some() && !is_stale;
        self.last = Some((code, word));
    }
}

/// CRC-8 of SMBus: x^8 + x^2 + x + 1, from 0.
pub(super) fn crc(bytes: &[u8]) -> u8 {
    let mut crc = 0_u8;
    for byte in bytes {
        crc ^= byte;
        for _ in 0..8 {
            crc = if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x07 };
        }
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As a driver's tests and a sealed pack have them.
    #[test]
    fn sums_are_those_of_packs() {
        for (bytes, pec) in [
            (&[0x16, 0x16, 0x17, 0x30, 0x30][..], 0xb7),
            // The second message alone, behind an adapter that puts a STOP before it.
            (&[0x17, 0x04, 0x21, 0x7b, 0x50, 0x00], 0x91),
            (&[0x17, 0x04, 0xb5, 0xfe, 0xb2, 0xd5], 0x18),
            (&[0x17, 0x02, 0x32, 0x28], 0xd8),
            // What a driver of a bq40z50 writes.
            (&[0x16, 0x44, 0x02, 0x02, 0x00], 0x46),
            (&[0x16, 0x44, 0x02, 0x7b, 0x00], 0x59),
            (&[0x16, 0x44, 0x02, 0x00, 0x40], 0xab),
        ] {
            assert_eq!(crc(bytes), pec, "{bytes:02x?}");
        }
    }

    #[test]
    fn each_answer_of_a_recorded_pack_has_the_sum_of_its_bytes() {
        let lines = include_str!("../../tests/packs/t41.txt").lines().filter(|line| !line.starts_with('#'));
        let (mut right, mut without) = (0, 0);
        for line in lines {
            let bytes: Vec<_> =
                line.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect("a byte")).collect();
            let (pec, rest) = bytes.split_last().expect("a transfer");
            match bytes[..] {
                [0x16, 0x1a, 0x17, _, _] => without += 1,
                _ => right += u32::from(crc(rest) == *pec),
            }
        }
        assert_eq!((right, without), (26, 1));
    }

    #[test]
    fn each_state_keeps_its_number() {
        for pec in Pec::ALL {
            assert_eq!(Pec::of(pec.number()), pec);
        }
        assert_eq!(Pec::of(99), Pec::Unasked);
    }
}
