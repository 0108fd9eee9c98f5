// SPDX-License-Identifier: MIT

//! The three security levels, and the two-word keys that lead from one to the next.

use std::time::Duration;

use super::knob::KnobChoice;

/// The halves of a key must follow each other within this time.
const WINDOW: Duration = Duration::from_secs(4);

/// The access that a host has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Only standard commands and the manufacturer's block.
    #[default]
    Sealed,
    /// Data flash too, except the keys.
    Unsealed,
    /// Everything.
    FullAccess,
}

impl KnobChoice for Level {
    const WORDS: &'static [(&'static str, Self)] =
        &[("sealed", Level::Sealed), ("unsealed", Level::Unsealed), ("full-access", Level::FullAccess)];
}

/// The level, and the state of a key.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seal {
    pub(super) level: Level,
    first: Option<Duration>,
    /// The level before the last change, and the time of the change.
    before: Option<(Level, Duration)>,
    pub(super) refused: bool,
}

impl Seal {
    pub(super) fn new(level: Level) -> Self {
        Self { level, ..Self::default() }
    }

    pub(super) fn change(&mut self, level: Level, now: Duration) {
        *self = Self { level, before: Some((self.level, now)), ..Self::default() };
    }

    /// The level shown when changes show `late`.
    pub(super) fn shown(&self, late: Duration, now: Duration) -> Level {
        self.before.filter(|(_, at)| now < *at + late).map_or(self.level, |(before, _)| before)
    }

    pub(super) fn is_half(&self) -> bool {
        self.first.is_some()
    }

    /// Keeps the level, and forgets a half key that was wrong, incomplete or refused.
    pub(super) fn after_refusal(self) -> Self {
        Self { first: None, refused: true, ..self }
    }

    /// Takes a word of Control(). `keys` lead to UNSEALED and, if there is that level, to FULL ACCESS, with words in
    /// the order on the wire. A gauge that is not `listening` ignores a first half. Returns whether the level has
    /// changed.
    pub(super) fn word(&mut self, word: u16, keys: &[[u16; 2]], listening: bool, now: Duration) -> bool {
        let first = self.first.take();
        let (key, next) = match (self.level, keys) {
            (Level::Sealed, [key, ..]) => (key, Level::Unsealed),
            (Level::Unsealed, [_, key, ..]) => (key, Level::FullAccess),
            _ => return false,
        };
        if word == key[1] && first.is_some_and(|then| now.saturating_sub(then) <= WINDOW) {
            self.change(next, now);
            return true;
        }
        if word == key[0] && listening {
            self.first = Some(now);
        }
        false
    }
}

/// The words of a stored key as they are sent: all four bytes reversed, each word little-endian on the wire.
pub(super) fn words(stored: [u8; 4]) -> [u16; 2] {
    let [a, b, c, d] = stored;
    [u16::from_be_bytes([c, d]), u16::from_be_bytes([a, b])]
}

/// The inverse of [`words`].
pub(super) fn stored(words: [u16; 2]) -> [u8; 4] {
    let [c, d] = words[0].to_be_bytes();
    let [a, b] = words[1].to_be_bytes();
    [a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEYS: [[u16; 2]; 2] = [[0x0414, 0x3672], [0xFFFF, 0xFFFF]];

    fn send(words: &[(u16, u64)]) -> Level {
        let mut seal = Seal::new(Level::Sealed);
        for &(word, at) in words {
            seal.word(word, &KEYS, true, Duration::from_millis(at));
        }
        seal.level
    }

    #[test]
    fn keys_open_one_level_each() {
        assert_eq!(send(&[(0x0414, 0), (0x3672, 4000)]), Level::Unsealed);
        assert_eq!(send(&[(0x0414, 0), (0x3672, 1), (0xFFFF, 2)]), Level::Unsealed);
        assert_eq!(send(&[(0x0414, 0), (0x3672, 1), (0xFFFF, 2), (0xFFFF, 3)]), Level::FullAccess);
    }

    #[test]
    fn halves_must_be_consecutive_ordered_and_quick() {
        assert_eq!(send(&[(0x3672, 0), (0x0414, 1)]), Level::Sealed);
        assert_eq!(send(&[(0x0414, 0), (0x0000, 1), (0x3672, 2)]), Level::Sealed);
        assert_eq!(send(&[(0x0414, 0), (0x3672, 4001)]), Level::Sealed);
        assert_eq!(send(&[(0xFFFF, 0), (0xFFFF, 1)]), Level::Sealed);
    }

    #[test]
    fn stored_bytes_are_reversed_on_the_wire() {
        assert_eq!(words([0x36, 0x72, 0x04, 0x14]), [0x0414, 0x3672]);
        assert_eq!(stored([0x0414, 0x3672]), [0x36, 0x72, 0x04, 0x14]);
    }
}
