// SPDX-License-Identifier: MIT

//! The watchdog of a gauge that is polled too fast. By the manuals a host must not issue any standard command more than
//! twice a second, or the gauge could reset (SLUSBH1C 9.5.4.3, SLUS914A 7.3). Control() and block access are not
//! limited.

use std::ops::Range;
use std::time::Duration;

/// Standard commands, without Control().
const COMMANDS: Range<u8> = 0x02..0x3A;
/// Times per second for each command.
const ALLOWED: u8 = 2;
/// Overloaded seconds in a row that a gauge survives. No manual has a number; a host that waits for a flag of CONFIG
/// UPDATE may poll fast for a second or two.
const SURVIVED: u8 = 5;

#[derive(Debug)]
pub(super) struct Watchdog {
    second: u64,
    counts: [u8; 0x80],
    strained: u8,
}

impl Watchdog {
    pub(super) fn new() -> Self {
        Self { second: 0, counts: [0; 0x80], strained: 0 }
    }

    /// A message reads `register` and those after it. Returns whether the watchdog expires.
    pub(super) fn read(&mut self, register: u8, now: Duration) -> bool {
        let second = now.as_secs();
        if second != self.second {
            let strain = self.counts.iter().any(|&count| count > ALLOWED) && second == self.second + 1;
            self.strained = if strain { self.strained + 1 } else { 0 };
            (self.second, self.counts) = (second, [0; 0x80]);
        }
        if COMMANDS.contains(&register) {
            let count = &mut self.counts[usize::from(register)];
            *count = count.saturating_add(1);
        }
        self.strained >= SURVIVED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads a register every `ms` milliseconds for 20 s.
    fn expires(register: u8, ms: usize) -> bool {
        let mut watchdog = Watchdog::new();
        (0..20_000).step_by(ms).any(|at| watchdog.read(register, Duration::from_millis(at as u64)))
    }

    #[test]
    fn two_a_second_are_allowed_and_more_are_not() {
        assert!(!expires(0x08, 500));
        assert!(expires(0x08, 300));
        assert!(!expires(0x00, 10));
        assert!(!expires(0x40, 10));
    }

    #[test]
    fn a_few_fast_seconds_are_survived() {
        let mut watchdog = Watchdog::new();
        assert!(!(0..4000).step_by(25).any(|at| watchdog.read(0x06, Duration::from_millis(at))));
        assert!(!(6000..10_000).step_by(25).any(|at| watchdog.read(0x06, Duration::from_millis(at))));
    }
}
