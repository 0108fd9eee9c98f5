// SPDX-License-Identifier: MIT

//! Random numbers that repeat with their seed (xorshift).

use std::ops::RangeInclusive;

#[derive(Clone, Debug)]
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        // An odd multiplier keeps seeds apart, and the generator must not start at 0.
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub(super) fn of(seed: u64, area: u16, block: usize) -> Self {
        let place = u64::from(area) << 32 | block as u64;
        let mut new = Self::new(seed ^ place.wrapping_mul(0xD6E8_FEB8_6659_FD93));
        new.roll(1);
        new
    }

    pub(super) fn roll(&mut self, below: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % below
    }

    pub(super) fn within(&mut self, range: RangeInclusive<u64>) -> u64 {
        range.start() + self.roll(range.end() - range.start() + 1)
    }

    pub(super) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.roll(from.len() as u64) as usize]
    }
}
