//! The time that the code above a bus measures and waits for: a [`Clock`] to read and to sleep on.
//!
//! The daemon uses [`RealClock`]. Tests use [`SimClock`], where a sleep takes no real time and the simulated
//! bus adds the duration of its transfers. This is the only place that calls `thread::sleep`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Monotonic time since a fixed start, and a way to wait.
pub trait Clock: Send + Sync {
    /// Time since the clock's start; never decreases.
    fn now(&self) -> Duration;
    /// Returns when at least `time` has passed.
    fn sleep(&self, time: Duration);
    /// Adds time that a bus has taken. Only a simulated clock needs this; a real one advances by
    /// itself.
    fn spend(&self, _time: Duration) {}
}

/// The machine's monotonic clock.
#[derive(Debug)]
pub struct RealClock(Instant);

impl RealClock {
    /// A clock that starts now.
    pub fn new() -> Self {
        Self(Instant::now())
    }
}

impl Default for RealClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for RealClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
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
