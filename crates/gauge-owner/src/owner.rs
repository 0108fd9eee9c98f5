// SPDX-License-Identifier: MIT

//! The owner of a gauge.
//!
//! It reads the registers that are due, publishes each poll as a whole new [`Snapshot`], and carries out requests one
//! after the other. Bus traffic does not grow with the number of readers. It renders no text and knows no file names.
//!
//! An [`Owner`] has rooms, whose fields nobody else sets: `access` is the gauge with its data flash, what it owes (`debt`)
//! and when it is polled (`schedule`); `identity` is which part it is; `readings` is what polls read; `memory` keeps a
//! gauge with RAM configured by its `profile`, and what that has learned (`learning`, in the files of `learned`, with a
//! `claim` on the pack's name); `backup` saves the configuration before the first write; `turn` says when the owner works.
//!
//! What needs several rooms is a method of the owner: turns here, `arrival`, `poll`, and in `operations` what it can be
//! asked to do, each a row of what `operation` is.
//!
//! Other files: `handle` is what everything else sees, `crew` has the threads, `direct` is an owner without one, `words`
//! reads arguments, `attempt` says which failure is shown; `calibrate`, `report`; `amiss` says what is wrong with a gauge
//! that answers, `written` logs what writes have changed, `signed` says on which host a file was saved.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use nix::errno::Errno;

use crate::choose::Choice;
use crate::error::{Error, Result};
use crate::options::GaugeOptions;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, Reach};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, DataFlash, Limits};
use ti_gauge::gauge::Gauge;
pub use ti_gauge::gauge::{Answers, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;

mod access;
mod amiss;
mod arrival;
mod attempt;
mod backup;
mod calibrate;
mod claim;
mod crew;
mod debt;
mod direct;
mod handle;
mod identity;
mod learned;
mod learning;
mod memory;
mod now;
mod operation;
pub mod operations;
mod poll;
mod profile;
mod readings;
mod report;
#[cfg(any(test, feature = "rig"))]
pub mod rig;
mod schedule;
mod signed;
mod turn;
#[cfg(test)]
mod wire;
mod words;
mod written;

use access::Access;
pub use attempt::Attempt;
use backup::Backups;
pub use backup::{Backup, readable};
use crew::Member;
pub use direct::Direct;
pub use handle::{Failure, Handle, Published, Signal, Snapshot};
use handle::{Queue, Shared};
use identity::Identity;
pub(crate) use learned::implausible_profile;
pub use learned::{Learned, Version, Wish};
use learning::Learning;
use memory::Memory;
pub use now::Presence;
use operation::Request;
pub use operation::{Context, FileOperation};
pub use operation::{Done, Operation};
use profile::Profile;
use readings::Readings;
pub use report::{Effect, Origin, Report, Times};
use schedule::Schedule;
use turn::Turn;

/// How a gauge is run: its options, what they name, and what is known of it when its owner starts.
#[derive(Debug)]
pub struct Run {
    /// As they were typed.
    pub options: GaugeOptions,
    /// Its keys.
    pub keys: Keys,
    /// The file that they are from, for messages.
    pub keys_from: Option<String>,
    /// Time between polls.
    pub interval: Duration,
    /// What it takes, whatever its bus carries.
    pub reach: Reach,
    /// Limits on writes.
    pub limits: Limits,
    /// Configuration that is restored in RAM after a loss of power.
    pub profile: Vec<Change>,
    /// The profiles to choose from in its place, whenever the gauge comes, or has lost its power.
    pub choices: Vec<Choice>,
    /// Lets a write that a power cut of the host interrupts be settled afterwards.
    pub journal: Option<Journal>,
    /// Saves the configuration before the first write; `None` for not at all.
    pub backup: Option<Backup>,
    /// Keeps what a gauge with RAM has learned.
    pub learned: Option<Learned>,
    /// Its name in the log; empty if it is the only gauge.
    pub name: String,
    /// How much earlier than the interval the third poll comes, which spreads the polls of many gauges.
    pub phase: Duration,
    /// The device may be no gauge: nothing that writes is sent until its registers have been read and checked.
    pub unverified: bool,
    /// The reason why the gauge cannot be reached yet.
    pub missing: Option<Error>,
    /// Its place.
    pub origin: Origin,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            options: GaugeOptions::default(),
            keys: Keys::default(),
            keys_from: None,
            interval: Duration::from_secs(30),
            reach: Reach::FULL,
            limits: Limits::default(),
            profile: Vec::new(),
            choices: Vec::new(),
            journal: None,
            backup: None,
            learned: None,
            name: String::new(),
            phase: Duration::ZERO,
            unverified: false,
            missing: None,
            origin: Origin::default(),
        }
    }
}

/// Starts the owner of a gauge, and waits until it has identified and polled the gauge.
pub fn spawn(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    run: Run,
    signal: Arc<Signal>,
) -> Result<Handle> {
    let (handle, opened) = start(chip, bus, clock, run, signal)?;
    let ended = || Err(Error::host(chip.name, Errno::EIO, "its thread has ended"));
    opened.recv().unwrap_or_else(|_| ended()).map(|()| handle)
}

/// Starts the owner. The receiver gets one message: whether the gauge was polled; after a failure it goes on trying.
#[inline(never)] // Its locals would otherwise be on the stack while the caller opens the gauge.
pub fn start(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    run: Run,
    signal: Arc<Signal>,
) -> Result<(Handle, Receiver<Result<()>>)> {
    let (sender, opened) = mpsc::channel();
    let (mut owner, shared) = Owner::new(chip, bus, clock, run, signal);
    owner.turn.begin_with(sender);
    let member = Member::new(owner).map_err(|error| Error::io(chip.name, "cannot start a thread", &error))?;
    Ok((Handle::new(shared, Queue::Crew(member)), opened))
}

struct Owner {
    access: Access,
    identity: Identity,
    readings: Readings,
    memory: Memory,
    backups: Backups,
    turn: Turn,
}

impl Owner {
    fn new(
        chip: &'static Chip,
        bus: Box<dyn Bus>,
        clock: Arc<dyn Clock>,
        run: Run,
        signal: Arc<Signal>,
    ) -> (Box<Self>, Arc<Shared>) {
        let now = clock.now();
        let mut gauge = Gauge::new(chip, bus, clock, run.keys).within(run.reach);
        if run.origin.address != 0 {
            gauge = gauge.at(run.origin.address);
        }
        if run.options.ask_the_pack {
            gauge = gauge.asked();
        }
        if let Some(file) = run.keys_from {
            gauge.key_file = file;
        }
        let shared = Shared::new(&gauge, run.options, run.interval, run.name, run.origin, signal);
        let shared = Arc::new(shared);
        let dataflash = DataFlash::new(run.limits, run.journal);
        let schedule = Schedule::new(run.phase, now);
        let learning = Learning::new(run.learned.filter(|_| chip.volatile.is_some()));
        // By value it would be on the stack of its thread once for each function that passes it on.
        let owner = Box::new(Self {
            access: Access::new(gauge, dataflash, schedule, shared.clone()),
            identity: Identity::new(run.unverified, run.missing),
            readings: Readings::new(chip),
            memory: Memory::new(Profile::new(run.profile, run.choices), learning),
            backups: Backups::new(run.backup),
            turn: Turn::default(),
        });
        (owner, shared)
    }

    fn shared(&self) -> &Arc<Shared> {
        self.access.shared()
    }

    /// Opens the gauge. After a failure it is gone, and is tried again with each poll.
    fn first_poll(&mut self) -> Result<()> {
        let outcome = self.survive(Attempt::Poll, Self::open).and_then(|opened| opened);
        outcome.inspect_err(|error| {
            self.access.set_gone();
            self.shared().record(Attempt::Poll, error);
        })
    }

    /// Opens the gauge, carries out a request, or does what is due. Returns how long nothing is due; `None` at the end.
    fn take_turn(&mut self, request: Option<(Duration, Request)>) -> Option<Duration> {
        if let Some(opening) = self.turn.take_opening() {
            let outcome = self.first_poll();
            opening.answer(self.shared(), outcome);
        }
        let now = self.access.now();
        let is_watched = self.memory.is_watched(self.access.chip());
        if is_watched && (self.turn.was_asleep(now) || self.memory.is_look_due(now)) {
            self.access.hurry();
        }
        if let Some((submitted, request)) = request {
            request.carry_out(self, submitted);
        } else if self.access.next_poll() <= now {
            let _ = self.survive(Attempt::Poll, Self::poll_on_time);
        } else if self.access.next_payment().is_some_and(|due| due <= now) {
            let _ = self.survive(Attempt::SETTLE, |owner| owner.access.pay());
        }
        let due = self.access.next_payment().unwrap_or(Duration::MAX).min(self.access.next_poll());
        self.turn.end(self.access.now(), due, is_watched)
    }

    /// Does some work. After a panic the gauge is gone until the next poll has identified it; a write that was cut short is
    /// settled from its journal, as after the end of a daemon.
    fn survive<T>(&mut self, attempt: Attempt, work: impl FnOnce(&mut Self) -> T) -> Result<T> {
        let panic = match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(done) => return Ok(done),
            Err(panic) => panic,
        };
        let text = panic.downcast_ref::<&str>().map(ToString::to_string);
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        let why = format!(
            "a defect of gaugefs has stopped this: {text}; the gauge is identified again, please report it"
        );
        // EIO after a write means that the old bytes are back, and that is not known yet.
        let errno = if matches!(attempt, Attempt::Poll | Attempt::Read(_)) {
            Errno::EIO
        } else {
            Errno::ENOTRECOVERABLE
        };
        let error = Error::host(self.shared().name(), errno, why);
        self.access.start_over();
        self.readings.forget(self.access.chip());
        self.shared().report(attempt, &error);
        Err(error)
    }
}

#[cfg(test)]
mod tests {
    use std::panic::resume_unwind;
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::rig::{INTERVAL, Rig};
    use super::*;
    use gauge_bus::BusError;
    use gauge_bus::clock::SimClock;
    use gauge_sim::{Options, Sim, SimBus};
    use ti_gauge::value::Value;

    /// A bus that panics at the transfer of that number.
    struct Panics {
        bus: SimBus,
        done: u64,
        at: Arc<AtomicU64>,
    }

    impl Bus for Panics {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            self.done += 1;
            if self.done == self.at.load(Ordering::SeqCst) {
                resume_unwind(Box::new("index out of bounds"));
            }
            self.bus.transfer(write, read)
        }
    }

    fn change(chip: &'static Chip) -> Change {
        let row = chip.row("80", "53").expect("a parameter of the table");
        Change::of_value(chip, row, &Value::Int(3100), false).expect("it fits")
    }

    #[test]
    fn a_panic_at_any_transfer_of_a_write_is_settled_as_after_the_end_of_a_daemon() {
        let folder = std::env::temp_dir().join(format!("gaugefs-panic-{}", std::process::id()));
        let write = |rig: &mut Rig| {
            let change = change(rig.handle.chip());
            rig.ask(&operations::WRITE, vec![change])
        };
        let mut plain = Rig::open();
        let (old, before) = (plain.sim.flash(), plain.transfers());
        write(&mut plain).expect("no fault");
        let (new, count) = (plain.sim.flash(), plain.transfers() - before);
        let mut outcomes = [0; 2];
        for number in 1..=count {
            let _ = std::fs::remove_dir_all(&folder);
            let journal = Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
            let run = Run { journal: Some(journal), ..Run::default() };
            let at = Arc::new(AtomicU64::new(0));
            let mut rig =
                Rig::on("bq34z100-g1", run, |bus| Box::new(Panics { bus, done: 0, at: at.clone() }));
            rig.owner.open().expect("it answers");
            at.store(rig.transfers() + number, Ordering::SeqCst);
            let error = write(&mut rig).expect_err("a panic");
            assert_eq!(error.errno(), Errno::ENOTRECOVERABLE as i32, "{error}");
            let published = rig.handle.published();
            assert!(published.snapshot.is_none() && published.last_error.contains("index out of bounds"));

            rig.clock.sleep(INTERVAL);
            rig.owner.poll_on_time();
            assert!(rig.handle.published().snapshot.is_some(), "transfer {number}");
            let flash = rig.sim.flash();
            let is = [&old, &new].map(|content| *content == flash);
            if is.contains(&true) {
                outcomes[usize::from(is[1])] += 1;
                assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"), "transfer {number}");
            } else {
                panic!("transfer {number}: half a write: {}", rig.handle.published().owed);
            }
        }
        assert!(outcomes[0] > 0 && outcomes[1] > 0, "{outcomes:?}");
        let _ = std::fs::remove_dir_all(&folder);
    }

    #[test]
    fn a_panic_does_not_end_the_thread_of_a_gauge() {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        let at = Arc::new(AtomicU64::new(0));
        let bus = Box::new(Panics { bus: sim.bus(), done: 0, at: at.clone() });
        let run = Run { interval: Duration::from_secs(3600), ..Run::default() };
        let handle = spawn(chip, bus, clock, run, Arc::default()).expect("it answers");
        let transfers = handle.statistics().iter().find(|(name, _)| *name == "transfers").expect("a count").1;
        at.store(transfers + 1, Ordering::SeqCst);
        let error = handle.wait_for(&operations::REFRESH, ()).expect_err("a panic");
        assert_eq!(error.errno(), Errno::EIO as i32, "{error}");
        assert!(handle.published().snapshot.is_none());
        handle.wait_for(&operations::REFRESH, ()).expect("it is identified again");
        assert!(handle.published().snapshot.is_some());
        assert_eq!(*handle.published().last_error, *"");
        handle.wait_for(&operations::WRITE, vec![change(chip)]).expect("the default key");
    }
}
