// SPDX-License-Identifier: MIT

//! For tests: the owner of a simulated bq34z100-G1 on a simulated clock, driven by the test's own thread.

pub mod days;
pub mod restoring;

use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::time::Duration;

use super::{Direct, Run};
use crate::error::Result;
use gauge_bus::Bus;
use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::replay::Replay;
use gauge_sim::{Options, Sim, SimBus};
use ti_gauge::chip::{Chip, Subclass};

/// Its time between two polls.
pub const INTERVAL: Duration = Duration::from_secs(8);

/// The owner, and what it runs on.
pub struct Rig {
    /// Its clock, which nothing but its owner and the test moves.
    pub clock: Arc<SimClock>,
    /// The gauge.
    pub sim: Sim,
    pub(in crate::owner) direct: Direct,
}

impl Deref for Rig {
    type Target = Direct;

    fn deref(&self) -> &Direct {
        &self.direct
    }
}

impl DerefMut for Rig {
    fn deref_mut(&mut self) -> &mut Direct {
        &mut self.direct
    }
}

impl Rig {
    /// The gauge answers, and nothing has been sent to it yet.
    pub fn new(run: Run) -> Self {
        Self::of("bq34z100-g1", run)
    }

    /// A gauge of another chip.
    pub fn of(chip: &str, run: Run) -> Self {
        Self::on(chip, run, |bus| Box::new(bus))
    }

    /// A gauge on a bus that is wrapped into another one.
    pub fn on(chip: &str, run: Run, wrap: impl FnOnce(SimBus) -> Box<dyn Bus>) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("it is simulated");
        sim.be_strict();
        clock.sleep(Duration::from_secs(1));
        let run = Run { interval: INTERVAL, ..run };
        let chip = Chip::by_name(chip).expect("it has a table");
        let bus = wrap(sim.bus());
        let direct = Direct::new(chip, bus, clock.clone(), run);
        Self { clock, sim, direct }
    }

    /// A recorded gauge.
    pub fn replay(chip: &Chip, replay: Replay) -> Self {
        Self::on(chip.name, Run::default(), |_| Box::new(replay))
    }

    /// The gauge has been identified and polled.
    pub fn open() -> Self {
        let mut rig = Self::new(Run::default());
        rig.owner.open().expect("it answers");
        rig
    }

    /// Identifies and polls the gauge.
    pub fn start(&mut self) -> Result<()> {
        self.owner.open()
    }

    /// Lets time pass, and polls if that is due.
    pub fn poll_after(&mut self, pause: Duration) {
        self.clock.sleep(pause);
        self.owner.poll_on_time();
    }

    /// The index in the table of the subclass of that id.
    pub fn index(&self, id: u8) -> usize {
        let is_it = |subclass: &Subclass| subclass.id == id;
        self.handle.chip().subclasses.iter().position(is_it).expect("a subclass of the table")
    }

    /// A report leaves no recording going on.
    pub fn gauge_records_nothing(&mut self) -> bool {
        self.owner.poll_on_time();
        self.owner.access.gauge().recorded().is_empty()
    }

    /// How many transfers the gauge has seen from its owner.
    pub fn transfers(&self) -> u64 {
        self.handle.statistics().iter().find(|(name, _)| *name == "transfers").expect("it is counted").1
    }
}
