// SPDX-License-Identifier: MIT

//! A [`Clock`] to read and to sleep on. On a [`SimClock`] a sleep takes no real time, and the simulated bus adds the
//! duration of its transfers. This is the only place that calls `thread::sleep`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Monotonic time since a fixed start, and a way to wait.
pub trait Clock: Send + Sync {
    /// Time since the clock's start; never decreases.
    fn now(&self) -> Duration;
    /// Returns when at least `time` has passed.
    fn sleep(&self, time: Duration);
    /// Adds time that a bus has taken; a real clock advances by itself.
    fn spend(&self, _time: Duration) {}
}

/// The machine's monotonic clock. It goes on while the machine is asleep, when a pack may be exchanged.
#[derive(Debug)]
pub struct RealClock(Duration);

impl RealClock {
    /// A clock that starts now.
    pub fn new() -> Self {
        Self(since_boot())
    }
}

/// Time since the machine was started. `Instant` leaves out the time asleep.
fn since_boot() -> Duration {
    let time = clock_gettime(ClockId::Boottime);
    Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or(0))
}

impl Default for RealClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for RealClock {
    fn now(&self) -> Duration {
        since_boot().saturating_sub(self.0)
    }

    fn sleep(&self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// A clock that advances only when code sleeps on it or adds bus time.
#[derive(Debug, Default)]
pub struct SimClock(AtomicU64);

impl SimClock {
    /// A clock at zero.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Clock for SimClock {
    fn now(&self) -> Duration {
        Duration::from_nanos(self.0.load(Ordering::SeqCst))
    }

    fn sleep(&self, time: Duration) {
        self.spend(time);
    }

    fn spend(&self, time: Duration) {
        let nanos = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.0.fetch_add(nanos, Ordering::SeqCst);
    }
}

/// Real time, except that a sleep ends at once and counts as slept, for writes to simulated gauges.
#[derive(Debug, Default)]
pub struct HurriedClock {
    real: RealClock,
    skipped: SimClock,
}

impl Clock for HurriedClock {
    fn now(&self) -> Duration {
        self.real.now() + self.skipped.now()
    }

    fn sleep(&self, time: Duration) {
        self.spend(time);
    }

    fn spend(&self, time: Duration) {
        self.skipped.spend(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The kernel's own figure counts the time asleep; no test can put the machine to sleep.
    #[test]
    fn regression_the_clock_counts_the_time_asleep() {
        let uptime = || {
            let text = std::fs::read_to_string("/proc/uptime").expect("Linux has it");
            let seconds: f64 = text.split(' ').next().and_then(|first| first.parse().ok()).expect("seconds");
            Duration::from_secs_f64(seconds)
        };
        // Hundredths of a second are rounded.
        let (before, now, after) = (uptime(), since_boot(), uptime() + Duration::from_millis(20));
        assert!(before <= now && now <= after, "{before:?}, {now:?}, {after:?}");
        let clock = RealClock::new();
        clock.sleep(Duration::from_millis(2));
        assert!(clock.now() >= Duration::from_millis(2));
    }
}
