// SPDX-License-Identifier: MIT

//! The owner of a gauge.
//!
//! It reads the registers that are due, publishes each poll as a whole new [`Snapshot`], and carries out
//! the requests of the file system one after the other. Nothing else touches the gauge's bus, so bus
//! traffic does not grow with the number of readers. It renders no text and knows no file names.
//!
//! `handle` is what everything else sees of a gauge, `operations` is what the owner can be asked to do, each a row of
//! what `operation` is, `words` reads their arguments, `attempt` says which failure is shown, `calibrate` calibrates the gauge, `crew` has the threads in which owners work, `backup` saves a gauge's configuration before the
//! first write, `direct` is an owner without a thread, `arrival` identifies a gauge that comes or comes back, `memory` keeps one with RAM configured, `learned` keeps what it has learned, `claim` says whose, `signed` on which host, `poll` reads its registers, `amiss` says what is wrong with one that answers, `report` records all
//! of that for a bug report, and `debt` pays what a failed access has left: a seal, or a write that is neither done nor
//! undone.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, SendError, Sender};
use std::time::{Duration, Instant};

use nix::errno::Errno;

use crate::choose::Choice;
use crate::error::{Error, Result};
use crate::options::GaugeOptions;
use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, DataFlash, Limits};
use ti_gauge::epoch::Fact;
use ti_gauge::gauge::Gauge;
pub use ti_gauge::gauge::{Answers, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

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
mod learned;
mod memory;
mod now;
mod operation;
pub mod operations;
mod poll;
mod report;
#[cfg(any(test, feature = "rig"))]
pub mod rig;
mod signed;
#[cfg(test)]
mod wire;
mod words;

pub use attempt::Attempt;
pub use backup::Backup;
pub use backup::readable;
use crew::Member;
use debt::Debt;
pub use direct::Direct;
pub use handle::{Failure, Handle, Published, Signal, Snapshot};
use handle::{Queue, Shared};
pub(crate) use learned::implausible_profile;
pub use learned::{Learned, Version, Wish};
use memory::Memory;
use now::Content;
pub use now::Presence;
use operation::Request;
pub use operation::{Context, Spoken};
pub use operation::{Done, Operation};
use poll::Schedule;
pub use report::{Effect, Origin, Report, Times};

/// Longest time without a look at the clock. The gauge's clock counts the time in which the host is asleep, and a wait does not: what
/// fell due then is done at most this long after the host is awake.
const NAP: Duration = Duration::from_secs(30);
/// Longest time without a look at the clock for a gauge that may have lost its memory while the host was asleep.
const NAP_OF_RAM: Duration = Duration::from_secs(1);
/// Time by which the gauge's clock may be ahead of one that stops with the host, although the host was awake.
const AWAKE: Duration = Duration::from_millis(500);

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
    /// Write one byte a transfer.
    pub single: bool,
    /// Limits on writes.
    pub limits: Limits,
    /// Configuration that a gauge whose data memory is RAM gets again after it has lost its power.
    pub profile: Vec<Change>,
    /// In its place, several of which one is chosen whenever the gauge comes, or has lost its power.
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
    /// The device at the address may be no gauge: nothing that writes is sent until its registers have been
    /// read and checked.
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
            single: false,
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

/// Starts the owner of a gauge.
///
/// The receiver gets one message: whether the gauge was identified and polled. After a failure the handle
/// is that of a gauge that is gone, and the owner goes on trying.
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
    owner.opening = Some(sender);
    let member = Member::new(owner).map_err(|error| Error::io(chip.name, "cannot start a thread", &error))?;
    Ok((Handle::new(shared, Queue::Crew(member)), opened))
}

/// The owner: it alone has the gauge.
struct Owner {
    gauge: Gauge,
    dataflash: DataFlash,
    shared: Arc<Shared>,
    schedule: Schedule,
    debt: Debt,
    /// Registers of the tiers that are not read with every poll.
    rare: Registers,
    /// The static tier has been read since data flash last changed.
    statics: Fact<(), Content>,
    /// What attributes need of data flash has been read since then, or was tried.
    looked: Fact<(), Content>,
    control_status: u32,
    /// When the gauge was last asked what it is.
    identified: Duration,
    /// Polls in a row that found a gauge which has not measured since its power-up or reset.
    unmeasured: u32,
    /// What is known of its data memory, where that is RAM.
    memory: Memory,
    /// See [`Run::backup`].
    backup: Option<Backup>,
    /// See [`Run::learned`], of a gauge with RAM.
    learned: Option<Learned>,
    /// The configuration of this gauge is saved.
    backed_up: Fact<(), Presence>,
    /// See [`Run::unverified`].
    unverified: bool,
    /// See [`Run::missing`].
    missing: Option<Error>,
    /// Whoever waits for the gauge to be opened, until it has been tried.
    opening: Option<Sender<Result<()>>>,
    /// It was asked to end: from then on it does nothing.
    has_ended: bool,
    /// The end of its last turn, by the gauge's clock and by one that stops while the host is asleep.
    turned: Option<(Duration, Instant)>,
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
        let mut gauge = Gauge::new(chip, bus, clock, run.keys, run.single);
        if let Some(file) = run.keys_from {
            gauge.key_file = file;
        }
        let shared = Shared::new(&gauge, run.options, run.interval, run.name, run.origin, signal);
        let shared = Arc::new(shared);
        // By value it would be on the stack of its thread once for each function that passes it on.
        let owner = Box::new(Self {
            gauge,
            dataflash: DataFlash::new(run.limits, run.journal),
            shared: shared.clone(),
            schedule: Schedule::new(run.phase, now),
            debt: Debt::default(),
            rare: Registers::unread(chip.registers),
            statics: Fact::default(),
            looked: Fact::default(),
            control_status: 0,
            identified: Duration::ZERO,
            unmeasured: 0,
            memory: Memory::new(run.profile, run.choices),
            backup: run.backup,
            learned: run.learned.filter(|_| chip.volatile.is_some()),
            backed_up: Fact::default(),
            unverified: run.unverified,
            missing: run.missing,
            opening: None,
            has_ended: false,
            turned: None,
        });
        (owner, shared)
    }

    /// Opens the gauge and sends the outcome. After a failure the gauge is gone, and is tried again with
    /// each poll.
    fn begin(&mut self, opened: &Sender<Result<()>>) {
        let outcome = self.first_poll();
        // If the caller has stopped waiting, the outcome goes to the log instead.
        match opened.send(outcome) {
            Ok(()) => {}
            Err(SendError(Ok(()))) => log::info!("{}: the gauge answers", self.shared.name()),
            Err(SendError(Err(error))) => self.shared.report(Attempt::Poll, &error),
        }
    }

    /// Opens the gauge. After a failure it is gone.
    fn first_poll(&mut self) -> Result<()> {
        let outcome = self.survive(Attempt::Poll, Self::open).and_then(|opened| opened);
        outcome.inspect_err(|error| {
            self.schedule.set_gone(self.gauge.clock.now());
            self.shared.record(Attempt::Poll, error);
        })
    }

    /// Opens the gauge, carries out a request, or does what is due. Returns how long nothing is due then; `None` if it was
    /// asked to end.
    fn take_turn(&mut self, request: Option<(Duration, Request)>) -> Option<Duration> {
        if let Some(opening) = self.opening.take() {
            self.begin(&opening);
        }
        let next_poll = |owner: &Self| owner.schedule.due(owner.shared.published().interval);
        let now = self.gauge.clock.now();
        let was_asleep =
            // A sleep that stops no clock shows in a nap that was too long.
            |(then, awake): (Duration, Instant)| now.saturating_sub(then) > awake.elapsed().min(NAP_OF_RAM) + AWAKE;
        let is_watched = self.memory.is_watched(self.gauge.chip);
        if is_watched && (self.turned.is_some_and(was_asleep) || self.memory.is_look_due(now)) {
            self.schedule.hurry();
        }
        if let Some((submitted, request)) = request {
            self.carry_out(submitted, request);
        } else if next_poll(self) <= now {
            let _ = self.survive(Attempt::Poll, Self::poll_on_time);
        } else if self.debt.due().is_some_and(|debt| debt <= now) {
            let _ = self.survive(operations::SETTLE.itself(), Self::pay);
        }
        let due = self.debt.due().unwrap_or(Duration::MAX).min(next_poll(self));
        let now = self.gauge.clock.now();
        self.turned = Some((now, Instant::now()));
        let nap = if is_watched { NAP_OF_RAM } else { NAP };
        (!self.has_ended).then(|| due.saturating_sub(now).min(nap))
    }

    /// Does some work. A panic in it is a failure of this gauge only: what is known of the gauge is thrown away, and it
    /// is gone until the next poll has identified it. A write that was cut short is then settled from its journal, as
    /// after the end of a daemon.
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
        let error = Error::host(self.shared.name(), errno, why);
        self.gauge.start_over();
        self.dataflash.start_over();
        self.forget_dataflash();
        self.rare = Registers::unread(self.gauge.chip.registers);
        self.debt = Debt::default();
        self.schedule.set_gone(self.gauge.clock.now());
        self.shared.publish(|published| {
            published.snapshot = None;
            published.presence = now::presence();
            (published.owed, published.settling) = ("".into(), "".into());
        });
        self.shared.report(attempt, &error);
        Err(error)
    }

    /// Reports an error, or clears the failure of an earlier attempt, and passes the outcome on.
    fn logged<T>(&self, attempt: Attempt, outcome: Result<T>) -> Result<T> {
        match outcome {
            Ok(done) => {
                self.shared.succeeded(&attempt);
                Ok(done)
            }
            Err(error) => {
                self.shared.report(attempt, &error);
                Err(error)
            }
        }
    }

    /// Another presence begins: whatever was read of the gauge is to be read again before anything follows from it.
    fn begin_anew(&mut self) {
        self.shared.publish(|published| published.presence = now::presence());
    }

    /// Forgets what was read of data flash, and its copies in registers: it may hold something else now.
    fn forget_dataflash(&mut self) {
        self.forget_values();
        self.shared.doubt_scales();
    }

    /// Forgets what was read of data flash of a gauge that has not been exchanged: its scales have not changed.
    fn forget_values(&mut self) {
        self.shared.next_content();
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
