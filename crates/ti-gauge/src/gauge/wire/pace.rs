// SPDX-License-Identifier: MIT

//! A standard command read more than twice a second may make the watchdog reset the gauge (SLUSBH1C 9.5.4.3, SLUS914A 7.3).

use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Duration;

/// Standard commands, without Control().
pub(super) const COMMANDS: Range<u8> = 0x02..0x3a;
/// In this time a command may be read twice.
const PERIOD: Duration = Duration::from_secs(1);
/// So long a flag may be awaited faster: the kernel's driver reads that of CONFIG UPDATE every 25 ms, up to 100 times.
const BURST: Duration = Duration::from_millis(2500);
/// After that long without an excess the next burst may come: a whole second of the gauge's is within it.
const CALM: Duration = Duration::from_secs(2);

#[derive(Default)]
pub(super) struct Pace {
    /// When each command was read last, and before that.
    read: BTreeMap<u8, [Option<Duration>; 2]>,
    /// The first and the last read of a burst.
    burst: Option<(Duration, Duration)>,
}

impl Pace {
    /// How long to wait before that command is read, which then is.
    pub(super) fn before(&mut self, code: u8, now: Duration) -> Duration {
        if !COMMANDS.contains(&code) {
            return Duration::ZERO;
        }
        let [last, before] = self.read.entry(code).or_default();
        let mut pause = Duration::ZERO;
        if before.is_some_and(|before| now < before + PERIOD) {
            match &mut self.burst {
                Some((first, fast)) if now < *fast + CALM => match now < *first + BURST {
                    true => *fast = now,
                    false => {
                        let due = last.map_or(now, |last| last + PERIOD / 2);
                        pause = due.saturating_sub(now);
                    }
                },
                burst => *burst = Some((now, now)),
            }
        }
        (*before, *last) = (*last, Some(now + pause));
        pause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// When a register is read by a host that asks every so many milliseconds for 20 s.
    fn times(code: u8, ms: u64) -> Vec<u64> {
        let (mut pace, mut now) = (Pace::default(), Duration::ZERO);
        let mut times = Vec::new();
        while now < Duration::from_secs(20) {
            now += pace.before(code, now);
            times.push(now.as_millis() as u64);
            now += Duration::from_millis(ms);
        }
        times
    }

    #[test]
    fn what_is_read_too_often_for_long_is_read_twice_a_second() {
        let times = times(0x06, 25);
        // A gauge survives some seconds of that in a row, whenever its own begin.
        for phase in 0..1000_u64 {
            let (mut strained, mut most) = (0, 0);
            for second in 0..19 {
                let within = second * 1000 + phase..(second + 1) * 1000 + phase;
                let count = times.iter().filter(|&time| within.contains(time)).count();
                strained = if count > 2 { strained + 1 } else { 0 };
                most = most.max(strained);
            }
            assert!((3..=4).contains(&most), "{phase}: {most}");
        }
    }

    #[test]
    fn what_is_read_seldom_or_is_no_standard_command_is_not_awaited() {
        let plain = |ms: u64| (0..20_000).step_by(ms as usize).collect::<Vec<u64>>();
        assert_eq!(times(0x06, 500), plain(500));
        assert_eq!(times(0x00, 25), plain(25));
        assert_eq!(times(0x3e, 25), plain(25));
        let short: Vec<_> = times(0x06, 25).into_iter().filter(|time| *time < 2500).collect();
        assert_eq!(short, (0..2500).step_by(25).collect::<Vec<u64>>());
    }
}
