//! The thread that owns a gauge.
//!
//! It reads the registers that are due, publishes each poll as a whole new [`Snapshot`], and carries out
//! the requests of the file system one after the other. Nothing else touches the gauge's bus, so bus
//! traffic does not grow with the number of readers. It renders no text and knows no file names.
//!
//! `handle` is what everything else sees of a gauge, `request` is what the owner can be asked to do,
//! `backup` saves a gauge's configuration before the first write, `arrival` identifies a gauge that comes or comes
//! back, `poll` reads its registers, and `debt` pays what a failed access has left: a seal, or a write that is
//! neither done nor undone.

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SendError, Sender};
use std::time::Duration;

use nix::errno::Errno;

use crate::error::{Error, Result};
use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use ti_gauge::authentication::Order;
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, DataFlash, Limits};
use ti_gauge::gauge::Gauge;
pub use ti_gauge::gauge::{Answers, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

mod arrival;
mod backup;
mod debt;
mod handle;
mod poll;
mod request;
#[cfg(test)]
pub(crate) mod rig;

use arrival::Loss;
pub use backup::Backup;
use debt::Debt;
use handle::Shared;
pub use handle::{Handle, Published, Signal, Snapshot};
use poll::Schedule;
pub use request::{Done, Request};

/// How a gauge is run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Its keys.
    pub keys: Keys,
    /// Time between polls.
    pub interval: Duration,
    /// Write one byte a transfer.
    pub byte_writes: bool,
    /// Also write parameters whose address or range is not certain.
    pub allow_unproven: bool,
    /// Limits on writes.
    pub limits: Limits,
    /// Byte order in which challenges are sent.
    pub auth_order: Order,
    /// Configuration that is written again to a gauge with RAM data memory after it has lost power.
    pub restore: Vec<Change>,
    /// Lets a write that a power cut of the host interrupts be settled afterwards.
    pub journal: Option<Journal>,
    /// Where the configuration is saved before the first write; `None` for not at all.
    pub backup: Option<Backup>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            keys: Keys::default(),
            interval: Duration::from_secs(30),
            byte_writes: false,
            allow_unproven: false,
            limits: Limits::default(),
            auth_order: Order::default(),
            restore: Vec::new(),
            journal: None,
            backup: None,
        }
    }
}

/// What is known of a gauge when its owner starts, and how it fits in among the others of its mount.
#[derive(Debug, Default)]
pub struct Startup {
    /// Its name in the log; empty if it is the only gauge.
    pub name: String,
    /// How much earlier than the interval the third poll comes, which spreads the polls of many gauges.
    pub phase: Duration,
    /// The device at the address may be no gauge: nothing that writes is sent until its registers have been
    /// read and checked.
    pub unverified: bool,
    /// Why the gauge cannot be reached yet.
    pub missing: Option<Error>,
}

/// Starts the owner of a gauge, and waits until it has identified and polled the gauge.
pub fn spawn(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    settings: Settings,
    signal: Arc<Signal>,
) -> Result<Handle> {
    let (handle, opened) = start(chip, bus, clock, settings, Startup::default(), signal)?;
    let ended = || Err(Error::host(chip.name, Errno::EIO, "its thread has ended"));
    opened.recv().unwrap_or_else(|_| ended()).map(|()| handle)
}

/// Starts the owner of a gauge.
///
/// The receiver gets one message: whether the gauge was identified and polled. After a failure the handle
/// is that of a gauge that is gone, and the owner goes on trying.
pub fn start(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    settings: Settings,
    startup: Startup,
    signal: Arc<Signal>,
) -> Result<(Handle, Receiver<Result<()>>)> {
    let (queue, requests) = mpsc::channel();
    let (sender, opened) = mpsc::channel();
    let name = if startup.name.is_empty() { chip.name } else { &startup.name };
    let thread = std::thread::Builder::new().name(format!("poll {name}")).stack_size(256 * 1024);
    let (mut owner, shared) = Owner::new(chip, bus, clock, settings, startup, signal);
    let run = move || {
        owner.begin(&sender);
        drop(sender);
        owner.run(&requests);
    };
    thread.spawn(run).map_err(|error| Error::io(chip.name, "cannot start a thread", &error))?;
    Ok((Handle::new(shared, queue), opened))
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
    statics_are_current: bool,
    control_status: u16,
    /// Polls in a row that found a gauge which has not measured since its power-up or reset.
    unmeasured: u32,
    /// See [`Settings::restore`].
    restore: Vec<Change>,
    /// What is known of the gauge's loss of its configuration.
    loss: Loss,
    /// See [`Settings::backup`].
    backup: Option<Backup>,
    /// The configuration of this gauge is saved.
    backed_up: bool,
    /// See [`Startup::unverified`].
    unverified: bool,
    /// See [`Startup::missing`].
    missing: Option<Error>,
}

impl Owner {
    fn new(
        chip: &'static Chip,
        bus: Box<dyn Bus>,
        clock: Arc<dyn Clock>,
        mut settings: Settings,
        startup: Startup,
        signal: Arc<Signal>,
    ) -> (Self, Arc<Shared>) {
        let keys = std::mem::take(&mut settings.keys);
        let now = clock.now();
        let gauge = Gauge::new(chip, bus, clock, keys, settings.byte_writes);
        let shared = Arc::new(Shared::new(&gauge, &settings, startup.name, signal));
        let owner = Self {
            gauge,
            dataflash: DataFlash::new(settings.limits, settings.journal),
            shared: shared.clone(),
            schedule: Schedule::new(startup.phase, now),
            debt: Debt::default(),
            rare: Registers::UNREAD,
            statics_are_current: false,
            control_status: 0,
            unmeasured: 0,
            restore: settings.restore,
            loss: Loss::None,
            backup: settings.backup,
            backed_up: false,
            unverified: startup.unverified,
            missing: startup.missing,
        };
        (owner, shared)
    }

    /// Opens the gauge and sends the outcome. After a failure the gauge is gone, and is tried again with
    /// each poll.
    fn begin(&mut self, opened: &Sender<Result<()>>) {
        let outcome = self.open();
        if let Err(error) = &outcome {
            self.schedule.set_gone(self.gauge.clock.now());
            self.shared.record(error);
        }
        // If the caller has stopped waiting, the outcome goes to the log instead.
        match opened.send(outcome) {
            Ok(()) => {}
            Err(SendError(Ok(()))) => log::info!("{}: the gauge answers", self.shared.name()),
            Err(SendError(Err(error))) => self.shared.report(&error),
        }
    }

    /// Serves requests, and polls when a poll is due, until the last handle has been dropped.
    fn run(&mut self, requests: &Receiver<(Duration, Request)>) {
        loop {
            let poll = self.schedule.due(self.shared.published().interval);
            let due = self.debt.due().map_or(poll, |debt| debt.min(poll));
            match requests.recv_timeout(due.saturating_sub(self.gauge.clock.now())) {
                Ok((submitted, request)) => self.serve(submitted, request),
                Err(RecvTimeoutError::Timeout) if due < poll => self.pay(),
                Err(RecvTimeoutError::Timeout) => self.poll_on_time(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Reports an error, and passes the outcome on.
    fn logged<T, E: Into<Error>>(&self, outcome: Result<T, E>) -> Result<T> {
        outcome.map_err(Into::into).inspect_err(|error| self.shared.report(error))
    }

    /// Forgets what was read of data flash, and its copies in registers: it may hold something else now.
    fn forget_dataflash(&mut self) {
        self.statics_are_current = false;
        self.shared.forget_all();
    }
}
