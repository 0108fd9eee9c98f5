// SPDX-License-Identifier: MIT

//! What is known of a Smart Battery's answers: whether it sends packet error codes, and which codes it has.

use std::collections::BTreeMap;

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
}

impl Pec {
    const ALL: [Self; 6] = [Self::Unasked, Self::None, Self::Right, Self::Split, Self::Wrong, Self::Unseen];

    pub(super) fn number(self) -> u64 {
        Self::ALL.iter().position(|one| *one == self).unwrap_or_default() as u64
    }

    pub(super) fn of(number: u64) -> Self {
        Self::ALL.get(number as usize).copied().unwrap_or_default()
    }

    pub(super) fn is_checked(self) -> bool {
        matches!(self, Self::Right | Self::Split)
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
        }
    }

    pub(super) fn told(self) -> Option<&'static str> {
        match self {
            Self::Unasked | Self::None | Self::Right => None,
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

#[derive(Debug)]
pub(super) struct Packets {
    /// Where the pack is: a packet error code covers the address.
    pub(super) address: u8,
    pub(super) pec: Pec,
    codes: BTreeMap<u8, Code>,
    last: Option<(u8, [u8; 2])>,
}

impl Packets {
    pub(super) fn at(address: u8) -> Self {
        Self { address, pec: Pec::Unasked, codes: BTreeMap::new(), last: None }
    }

    /// Another pack may be there.
    pub(super) fn forget(&mut self) {
        *self = Self::at(self.address);
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

    /// As a pack of 2004 has sent them to a laptop, and as a driver's tests have them.
    #[test]
    fn sums_are_those_of_real_packs() {
        for (bytes, pec) in [
            (&[0x16, 0x01, 0x17, 0xdb, 0x01][..], 0xf1),
            (&[0x16, 0x08, 0x17, 0xa4, 0x0b], 0x00),
            (&[0x16, 0x09, 0x17, 0x6b, 0x2c], 0xcd),
            (&[0x16, 0x13, 0x17, 0xff, 0xff], 0xb4),
            (b"\x16\x20\x17\x08SANYO\x0002", 0x83),
            (b"\x16\x21\x17\x0bIBM-08K8193", 0xb1),
            (&[0x16, 0x16, 0x17, 0x30, 0x30], 0xb7),
            // The second message alone, behind an adapter that puts a STOP before it.
            (&[0x17, 0x04, 0x21, 0x7b, 0x50, 0x00], 0x91),
        ] {
            assert_eq!(crc(bytes), pec, "{bytes:02x?}");
        }
    }

    #[test]
    fn each_state_keeps_its_number() {
        for pec in Pec::ALL {
            assert_eq!(Pec::of(pec.number()), pec);
        }
        assert_eq!(Pec::of(99), Pec::Unasked);
    }
}
