//! Time as the engine sees it: a [`Clock`] to read and to sleep on.
//!
//! The daemon runs on [`RealClock`]; tests run on [`SimClock`], where a sleep takes no time and the
//! simulated bus adds its own. This is the only place that calls `thread::sleep`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Monotonic time since some fixed start, and a way to let it pass.
pub trait Clock: Send + Sync {
    /// Time since the clock's start; never goes back.
    fn now(&self) -> Duration;
    /// Returns when at least `time` has passed.
    fn sleep(&self, time: Duration);
    /// Time that the bus itself has taken. Only a simulated clock has to be told; the real one
    /// notices.
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

/// A clock that moves only when somebody sleeps on it or spends bus time.
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
