// SPDX-License-Identifier: MIT

//! The gauge behind the adapter: the simulator, on a clock that can be moved ahead.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use gauge_bus::clock::Clock;
use gauge_sim::{Level, Options, Sim, SimBus};

/// Real time, so that the guest sees real waits, and jumps, so that a battery need not be waited for.
#[derive(Debug)]
pub(crate) struct BenchClock {
    start: Instant,
    jumped: AtomicU64,
    paced: AtomicBool,
}

impl BenchClock {
    fn new() -> Self {
        Self { start: Instant::now(), jumped: AtomicU64::new(0), paced: AtomicBool::new(false) }
    }

    /// Moves the time ahead.
    pub(crate) fn pass(&self, seconds: u32) {
        self.jumped.fetch_add(seconds.into(), Ordering::SeqCst);
    }

    /// Whether the bus takes the time it would take at 100 kHz, or none.
    pub(crate) fn pace(&self, paced: bool) {
        self.paced.store(paced, Ordering::SeqCst);
    }
}

impl Clock for BenchClock {
    fn now(&self) -> Duration {
        self.start.elapsed() + Duration::from_secs(self.jumped.load(Ordering::SeqCst))
    }

    fn sleep(&self, time: Duration) {
        thread::sleep(time);
    }

    fn spend(&self, time: Duration) {
        if self.paced.load(Ordering::SeqCst) {
            thread::sleep(time);
        }
    }
}

/// A simulated gauge, the bus to it and its clock.
#[derive(Debug)]
pub(crate) struct Gauge {
    pub(crate) sim: Sim,
    pub(crate) bus: SimBus,
    pub(crate) clock: Arc<BenchClock>,
}

impl Gauge {
    /// A new gauge; every chip that the simulator has will do.
    pub(crate) fn new(chip: &str) -> Result<Self, String> {
        let clock = Arc::new(BenchClock::new());
        let time: Arc<dyn Clock> = clock.clone();
        let mut sim = Sim::new(chip, &Options::default(), time.clone()).map_err(|error| error.to_string())?;
        // A mount has to leave each part as it was found: one that has a seal starts with it.
        if sim.get("seal").is_some() {
            let options = Options { seal: Some(Level::Sealed), ..Options::default() };
            sim = Sim::new(chip, &options, time).map_err(|error| error.to_string())?;
        }
        sim.keep_log(true);
        Ok(Self { bus: sim.bus(), sim, clock })
    }
}
