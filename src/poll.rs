//! The one thread that owns a gauge.
//!
//! It reads what is due, publishes each poll as a whole new [`Snapshot`], and carries out the
//! requests of the file system one after the other. Nobody else touches the gauge's bus, so bus
//! traffic does not grow with the number of readers. It renders no text and knows no file names.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SendError, Sender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use nix::errno::Errno;

use crate::authentication::{self, Message, Order};
use crate::bus::Bus;
use crate::chip::{Chip, Recognised, Register, Role, Sibling, Subclass, Tier, recognise};
use crate::clock::Clock;
use crate::dataflash::{Change, DataFlash, Limits, Outcome};
use crate::error::{Cause, Error, Result, Step};
pub use crate::gauge::{Answers, Seal};
use crate::gauge::{Gauge, Statistics};
use crate::journal::Journal;
use crate::keys::{self, Keys};
use crate::probe;
use crate::registers::Registers;

/// Every so many polls the slow tier is read as well; first with the second poll, which follows soon, so
/// that a mount waits only for what its attributes need.
const SLOW_EVERY: u64 = 10;
/// So many polls that fail in a row make a gauge gone.
const FAILURES: u32 = 3;
/// A failed poll is tried again so soon, once.
const RETRY: Duration = Duration::from_secs(1);
/// No standard command more than twice a second, or the gauge's watchdog may reset it.
const SHORTEST: Duration = Duration::from_millis(500);
/// A request that has waited so long is answered rather than begun: write(2) returns within 30 s.
const PATIENCE: Duration = Duration::from_secs(12);

/// All registers of one poll.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The clock when the poll's first transfer began.
    pub taken: Duration,
    /// Counts the polls; two snapshots of one number are the same snapshot.
    pub number: u64,
    registers: Registers,
    /// CONTROL_STATUS, as of the last slow poll.
    pub control_status: u16,
}

impl Snapshot {
    /// The register's value, sign applied; `None` where it has not been read.
    pub fn value(&self, register: &Register) -> Option<i64> {
        self.registers.value(register)
    }
}

/// What is known of a gauge at one moment; replaced as a whole.
#[derive(Clone, Debug)]
pub struct Published {
    /// The last poll; `None` while the gauge is gone.
    pub snapshot: Option<Arc<Snapshot>>,
    /// Who it is.
    pub answers: Answers,
    /// Set where it is not the table's part but a relative of it: its standard commands mean the same,
    /// its data flash is out of bounds.
    pub sibling: Option<&'static Sibling>,
    /// Its seal state, as of the last time it was looked at.
    pub seal: Seal,
    /// The answer to the last challenge; `None` while there is none.
    pub digest: Option<Message>,
    /// Time between polls.
    pub interval: Duration,
    /// The last failure, one line; empty for none.
    pub last_error: Arc<str>,
}

/// Called from the owner's thread with the outcome of a request; must not block.
pub type Done<T> = Box<dyn FnOnce(Result<T>) + Send>;

/// What the file system may ask of a gauge's owner.
pub enum Request {
    /// Read subclasses, by their indices in the table; those that are kept and fresh cost nothing.
    Read(Vec<usize>, Done<Vec<Arc<[u8]>>>),
    /// Write parameters, whose ranges have been checked already, all or none.
    WriteAll(Vec<Change>, Done<()>),
    /// Go to a seal state.
    Seal(Seal, Done<()>),
    /// Send a subcommand that the table marks safe.
    Control(u16, Done<()>),
    /// Change one of its keys.
    ChangeKey(keys::Change, Done<()>),
    /// Publish the gauge's answer to a challenge.
    Authenticate(Message, Done<()>),
    /// Poll now and drop kept data flash.
    Refresh(Done<()>),
    /// Change the time between polls.
    Interval(Duration, Done<()>),
    /// The adapter's node has come or gone: let go of it, or see whether the gauge is back.
    Look,
}

impl Request {
    /// Whether it sends anything but what a poll reads.
    fn goes_beyond_polling(&self) -> bool {
        match self {
            Request::Read(..)
            | Request::WriteAll(..)
            | Request::Seal(..)
            | Request::Control(..)
            | Request::ChangeKey(..)
            | Request::Authenticate(..) => true,
            Request::Refresh(_) | Request::Interval(..) | Request::Look => false,
        }
    }

    /// Answers without carrying it out.
    fn refuse(self, error: Error) {
        match self {
            Request::Read(_, done) => done(Err(error)),
            Request::WriteAll(_, done)
            | Request::Seal(_, done)
            | Request::Control(_, done)
            | Request::ChangeKey(_, done)
            | Request::Authenticate(_, done)
            | Request::Refresh(done)
            | Request::Interval(_, done) => done(Err(error)),
            Request::Look => {}
        }
    }
}

/// A gauge, as everything but its owner sees it. Cheap to clone; nothing here blocks or touches the
/// bus. When the last clone is dropped, the owner finishes what it is doing and ends.
#[derive(Clone)]
pub struct Handle {
    shared: Arc<Shared>,
    queue: Sender<(Duration, Request)>,
}

/// What the owner lets others see.
struct Shared {
    chip: &'static Chip,
    allow_unproven: bool,
    auth_order: Order,
    clock: Arc<dyn Clock>,
    statistics: Arc<Statistics>,
    published: Mutex<Arc<Published>>,
    kept: Mutex<Vec<Option<Kept>>>,
    signal: Arc<Signal>,
    /// Something has been published since the FUSE side last looked.
    changed: AtomicBool,
    /// What lines in the log begin with: nothing where there is only one gauge.
    prefix: String,
}

/// A subclass as it was read.
struct Kept {
    bytes: Arc<[u8]>,
    /// The poll before which it was read; learned values are read again after the next.
    poll: u64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no thread panics while it holds the lock")
}

impl Shared {
    fn published(&self) -> Arc<Published> {
        lock(&self.published).clone()
    }

    fn publish(&self, change: impl FnOnce(&mut Published)) {
        {
            let mut published = lock(&self.published);
            let mut next = Published::clone(&published);
            change(&mut next);
            *published = Arc::new(next);
        }
        self.raise();
    }

    fn raise(&self) {
        self.changed.store(true, Ordering::SeqCst);
        self.signal.raise();
    }

    /// One line in the log and in `gauge/last_error`.
    fn say(&self, error: &Error) {
        log::warn!("{}{error}", self.prefix);
        self.note(error);
    }

    /// The same without the log.
    fn note(&self, error: &Error) {
        let line = error.to_string();
        self.publish(|published| published.last_error = line.into());
    }

    fn kept(&self, subclass: usize) -> Option<Arc<[u8]>> {
        let polls = self.published().snapshot.as_ref().map(|snapshot| snapshot.number);
        let kept = lock(&self.kept);
        let kept = kept.get(subclass)?.as_ref()?;
        let learned = self.chip.subclasses[subclass].parameters.iter().any(|parameter| parameter.learned);
        let fresh = !learned || polls == Some(kept.poll);
        fresh.then(|| kept.bytes.clone())
    }
}

impl Handle {
    /// The gauge's table.
    pub fn chip(&self) -> &'static Chip {
        self.shared.chip
    }

    /// Whether parameters may be written whose address or range is not sure.
    pub fn allows_unproven(&self) -> bool {
        self.shared.allow_unproven
    }

    /// The order of bytes in which challenges are sent.
    pub fn auth_order(&self) -> Order {
        self.shared.auth_order
    }

    /// What is known now.
    pub fn published(&self) -> Arc<Published> {
        self.shared.published()
    }

    /// The bytes of a subclass (by its index in the table), where they are kept and need not be read
    /// again first.
    pub fn kept(&self, subclass: usize) -> Option<Arc<[u8]>> {
        self.shared.kept(subclass)
    }

    /// Age of the published snapshot; `None` while the gauge is gone.
    pub fn age(&self) -> Option<Duration> {
        let taken = self.published().snapshot.as_ref()?.taken;
        Some(self.shared.clock.now().saturating_sub(taken))
    }

    /// The owner's clock.
    pub fn now(&self) -> Duration {
        self.shared.clock.now()
    }

    /// Has the FUSE side look at this gauge.
    pub fn raise(&self) {
        self.shared.raise();
    }

    /// Whether something has changed since this was last asked.
    pub fn take_changed(&self) -> bool {
        self.shared.changed.swap(false, Ordering::SeqCst)
    }

    /// Name and value of each file of `gauge/statistics`.
    pub fn statistics(&self) -> Vec<(&'static str, u64)> {
        self.shared.statistics.list()
    }

    /// How many blocks of those that a write needs are programmed; `None` while nothing is written.
    pub fn progress(&self) -> Option<(u32, u32)> {
        self.shared.statistics.progress.get()
    }

    /// One line in the log and in `gauge/last_error`, for what was refused before the owner heard of it.
    pub fn note(&self, error: &Error) {
        self.shared.say(error);
    }

    /// Queues a request; its outcome comes to its `Done`, within 30 s for a write. Where the owner has
    /// ended, the request is dropped, and its `Done` with it.
    pub fn submit(&self, request: Request) {
        // Nobody is left to answer when the owner has ended; the dropped `Done` says so.
        let _ = self.queue.send((self.shared.clock.now(), request));
    }
}

/// How a gauge is to be run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Its keys.
    pub keys: Keys,
    /// Time between polls.
    pub interval: Duration,
    /// Write one byte a transfer.
    pub byte_writes: bool,
    /// Write parameters too whose address or range is not sure.
    pub allow_unproven: bool,
    /// What may be overruled, and how often flash may be programmed.
    pub limits: Limits,
    /// The order of bytes in which challenges are sent.
    pub auth_order: Order,
    /// What a gauge whose data memory is RAM is given again when it has lost its power.
    pub restore: Vec<Change>,
    /// What makes writes survive a power cut of the host.
    pub journal: Option<Journal>,
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
        }
    }
}

/// How a gauge stands among the others of its mount.
#[derive(Debug, Default)]
pub struct Place {
    /// Its name, for the log; empty where there is no other.
    pub name: String,
    /// By how much the third poll comes early, so that the polls of many gauges do not fall together.
    pub phase: Duration,
    /// Nobody has seen yet that what is at the address reads like a gauge.
    pub unseen: bool,
    /// Why it cannot be there yet.
    pub missing: Option<Error>,
}

/// Opens a gauge: identifies it, polls it once, and starts the thread that owns it from then on.
pub fn spawn(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    settings: Settings,
    signal: Arc<Signal>,
) -> Result<Handle> {
    let (handle, begun) = start(chip, bus, clock, settings, Place::default(), signal)?;
    let ended = || Err(Error::host(chip.name, Errno::EIO, "its thread has ended"));
    begun.recv().unwrap_or_else(|_| ended()).map(|()| handle)
}

/// Starts the thread that owns a gauge, which opens it. What came of that is received once; who does not
/// wait for it, or keeps the handle all the same, has a gauge that is gone until it answers.
pub fn start(
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    settings: Settings,
    place: Place,
    signal: Arc<Signal>,
) -> Result<(Handle, Receiver<Result<()>>)> {
    let (queue, requests) = mpsc::channel();
    let (tell, begun) = mpsc::channel();
    let called = if place.name.is_empty() { chip.name } else { &place.name };
    let thread = std::thread::Builder::new().name(format!("poll {called}")).stack_size(256 * 1024);
    let (mut owner, shared) = Owner::new(chip, bus, clock, settings, place, signal);
    let own = move || {
        owner.begin(&tell);
        drop(tell);
        owner.run(&requests);
    };
    thread.spawn(own).map_err(|error| Error::io(chip.name, "cannot start a thread", &error))?;
    Ok((Handle { shared, queue }, begun))
}

/// The owner: the only one who has the gauge.
struct Owner {
    gauge: Gauge,
    dataflash: DataFlash,
    shared: Arc<Shared>,
    /// Registers of the tiers that are not read with every poll.
    other: Registers,
    /// Whether those that are copies of data flash are up to date.
    statics: bool,
    control_status: u16,
    polls: u64,
    failures: u32,
    last_poll: Duration,
    /// The next poll follows soon: after the first one, and when a reset has changed what registers say.
    hurry: bool,
    /// See [`Settings::restore`].
    restore: Vec<Change>,
    /// It has been tried for the power loss that the gauge tells of now.
    restored: bool,
    /// See [`Place::unseen`]. Until then nothing is sent that writes.
    unseen: bool,
    missing: Option<Error>,
    /// See [`Place::phase`]; zero once it has been used.
    phase: Duration,
}

impl Owner {
    fn new(
        chip: &'static Chip,
        bus: Box<dyn Bus>,
        clock: Arc<dyn Clock>,
        settings: Settings,
        place: Place,
        signal: Arc<Signal>,
    ) -> (Self, Arc<Shared>) {
        let gauge = Gauge::new(chip, bus, clock.clone(), settings.keys, settings.byte_writes);
        let published = Published {
            snapshot: None,
            answers: Answers::default(),
            sibling: None,
            seal: Seal::Sealed,
            digest: None,
            interval: settings.interval,
            last_error: "".into(),
        };
        let shared = Arc::new(Shared {
            chip,
            allow_unproven: settings.allow_unproven,
            auth_order: settings.auth_order,
            clock,
            statistics: gauge.statistics.clone(),
            published: Mutex::new(Arc::new(published)),
            kept: Mutex::new(chip.subclasses.iter().map(|_| None).collect()),
            signal,
            changed: AtomicBool::new(true),
            prefix: if place.name.is_empty() { String::new() } else { format!("{}: ", place.name) },
        });
        let owner = Self {
            gauge,
            dataflash: DataFlash::new(settings.limits, settings.journal),
            shared: shared.clone(),
            other: Registers::UNREAD,
            statics: false,
            control_status: 0,
            polls: 0,
            failures: 0,
            last_poll: Duration::ZERO,
            hurry: false,
            restore: settings.restore,
            restored: false,
            unseen: place.unseen,
            missing: place.missing,
            phase: place.phase,
        };
        (owner, shared)
    }

    /// Opens the gauge and tells what came of it; where it is not there, it is waited for.
    fn begin(&mut self, tell: &Sender<Result<()>>) {
        let outcome = self.open();
        if let Err(error) = &outcome {
            self.failures = FAILURES;
            self.last_poll = self.gauge.clock.now();
            self.shared.note(error);
        }
        // Where nobody has waited so long, the log is told.
        match tell.send(outcome) {
            Ok(()) => {}
            Err(SendError(Ok(()))) => log::info!("{}the gauge is there", self.shared.prefix),
            Err(SendError(Err(error))) => self.say(&error),
        }
    }

    fn open(&mut self) -> Result<()> {
        if let Some(error) = self.missing.take() {
            return Err(error);
        }
        self.arrive()?;
        self.poll()?;
        self.first_look();
        Ok(())
    }

    /// After the first poll of a gauge that has come.
    fn first_look(&mut self) {
        self.hurry = true;
        self.look_after();
        // A quirk can be seen without a key only where the gauge is found unsealed.
        let (chip, seen) = (self.gauge.chip, self.shared.published());
        if seen.seal != Seal::Sealed && seen.sibling.is_none() {
            let at = |id| chip.subclasses.iter().position(|subclass| subclass.id == id);
            let places: Vec<_> = chip.quirks.iter().filter_map(|quirk| at(quirk.subclass)).collect();
            let _ = self.read(&places, Duration::ZERO);
        }
    }

    /// A gauge has come, or come back: who is it, and what does it hold that does not change by itself?
    fn arrive(&mut self) -> Result<()> {
        if self.unseen {
            probe::look(&mut self.gauge)?;
        }
        let answers = self.gauge.identify()?;
        let chip = self.gauge.chip;
        let sibling = match recognise(&answers) {
            Recognised::Chip(found) if std::ptr::eq(found, chip) => None,
            // Several parts answer so, and the user has said which one it is.
            Recognised::Ambiguous(found) if found.iter().any(|&found| std::ptr::eq(found, chip)) => None,
            Recognised::Sibling(sibling) if sibling.like.is_some_and(|like| std::ptr::eq(like, chip)) => {
                let prefix = &self.shared.prefix;
                log::warn!(
                    "{prefix}this is a {}, not a {}: standard commands only",
                    sibling.name,
                    chip.model
                );
                Some(sibling)
            }
            other => {
                let found = match other {
                    Recognised::Chip(found) => format!("answers as a {}", found.model),
                    Recognised::Sibling(sibling) => format!("answers as a {}", sibling.name),
                    Recognised::Ambiguous(_) | Recognised::Unknown => {
                        "is none of the parts known".to_string()
                    }
                };
                let Answers { device_type, firmware_version, hardware_version, .. } = answers;
                let why = format!(
                    "device type 0x{device_type:04x}, firmware 0x{firmware_version:04x}, hardware \
                     0x{hardware_version:04x} {found}; it is not mounted as this one"
                );
                return Err(Error::new(chip.model, Cause::Gone(why)).at(Step::Identify));
            }
        };
        self.unseen = false;
        self.gauge.forget_refusal();
        self.dataflash.meet(chip, &answers);
        self.drop_kept();
        self.other = Registers::UNREAD;
        self.polls = self.polls.next_multiple_of(SLOW_EVERY);
        self.restored = false;
        self.shared.publish(|published| {
            (published.answers, published.sibling, published.digest) = (answers, sibling, None);
        });
        if sibling.is_none() {
            self.settle();
        }
        Ok(())
    }

    /// Brings a write that was cut off to its end, before anybody sees what the gauge holds.
    fn settle(&mut self) {
        match self.dataflash.journals_of_others(&mut self.gauge) {
            Ok(others) => {
                let prefix = &self.shared.prefix;
                for other in others {
                    log::warn!("{prefix}{}: the journal of another gauge; left alone", other.display());
                }
            }
            Err(error) => return self.say(&error.into()),
        }
        match self.dataflash.settle(&mut self.gauge, Duration::ZERO) {
            Ok(Some(told)) => {
                self.drop_kept();
                self.say(&Error::new(self.gauge.chip.name, Cause::RolledBack(told)));
            }
            Ok(None) => {}
            Err(error) => self.say(&error.into()),
        }
    }

    /// After each poll: a RAM gauge that has lost its power gets its configuration back, once.
    fn look_after(&mut self) {
        let (Some(lost), Some(flags)) = (self.gauge.chip.volatile, self.gauge.chip.register(Role::Flags))
        else {
            return;
        };
        let published = self.shared.published();
        let word = published.snapshot.as_ref().and_then(|snapshot| snapshot.value(flags));
        if word.is_none_or(|word| word & i64::from(lost) == 0) {
            self.restored = false;
            return;
        }
        if self.restored || published.sibling.is_some() {
            return;
        }
        self.restored = true;
        // Between two polls nobody saw it go. What was read of data memory is not there any more, and the
        // seal may be open.
        self.drop_kept();
        self.look_at_seal();
        self.hurry = true;
        if self.restore.is_empty() {
            log::warn!("{}: lost its configuration with its power; --restore gives it back", self.called());
            return;
        }
        let changes = std::mem::take(&mut self.restore);
        let outcome = self.dataflash.write(&mut self.gauge, &changes, Duration::ZERO);
        self.restore = changes;
        self.drop_kept();
        match self.told(outcome.map_err(|error| error.within("--restore"))) {
            Ok(Outcome::Written { .. }) => log::info!("{}: configuration restored", self.called()),
            Ok(Outcome::Unchanged) => log::info!("{}: configuration is as saved", self.called()),
            // Said already; a look at the bus may help before it is tried again.
            Err(_) => {}
        }
    }

    /// Looks for the flaws that the table knows of, as far as the bytes are there to see.
    fn look_for_quirks(&self) {
        for quirk in self.gauge.chip.quirks {
            let index = self.gauge.chip.subclasses.iter().position(|subclass| subclass.id == quirk.subclass);
            let bytes = index.and_then(|index| self.shared.kept(index));
            let byte = bytes.and_then(|bytes| bytes.get(usize::from(quirk.offset)).copied());
            if byte.is_some_and(|byte| byte & quirk.mask == quirk.wrong) {
                let place = format!("df/{}/{}", quirk.subclass, quirk.offset);
                let why = format!("{}; {}", quirk.effect, quirk.remedy);
                self.say(&Error::new(place, Cause::Protocol(why)));
            }
        }
    }

    /// Data flash may hold something else now, and so may its copies.
    fn drop_kept(&mut self) {
        self.statics = false;
        lock(&self.shared.kept).iter_mut().for_each(|kept| *kept = None);
    }

    /// Serves requests and polls when it is time, until nobody is left to ask.
    fn run(&mut self, requests: &Receiver<(Duration, Request)>) {
        loop {
            let due = self.last_poll + self.pause();
            let wait = due.saturating_sub(self.gauge.clock.now());
            match requests.recv_timeout(wait) {
                Ok((asked, request)) => self.serve(asked, request),
                Err(RecvTimeoutError::Timeout) => self.poll_or_say(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn pause(&self) -> Duration {
        let interval = self.shared.published().interval;
        match self.failures {
            0 if self.hurry => SHORTEST,
            0 => interval.saturating_sub(self.phase).max(SHORTEST.min(interval)),
            1 => interval.min(RETRY),
            _ => interval,
        }
    }

    fn poll_or_say(&mut self) {
        let back = self.failures >= FAILURES;
        let arrives = back || self.dataflash.doubts();
        let new = self.shared.published().answers == Answers::default();
        let outcome = if arrives { self.arrive().and_then(|()| self.poll()) } else { self.poll() };
        match outcome {
            Ok(()) if new => {
                log::info!("{}: the gauge is there", self.called());
                self.first_look();
            }
            Ok(()) => {
                if back {
                    log::info!("{}: the gauge is back", self.called());
                }
                self.look_after();
            }
            Err(error) => self.poll_failed(&error),
        }
    }

    fn poll_failed(&mut self, error: &Error) {
        self.failures = self.failures.saturating_add(1);
        self.last_poll = self.gauge.clock.now();
        Statistics::count(&self.shared.statistics.failed_polls);
        // Once gone, it is gone: the log need not hear of each further poll.
        if self.failures <= FAILURES {
            self.say(error);
        }
        if self.failures == FAILURES {
            log::warn!("{}: gone after {FAILURES} polls that failed", self.called());
            self.shared.publish(|published| published.snapshot = None);
        }
    }

    /// Reads what is due and publishes it as a new Snapshot.
    fn poll(&mut self) -> Result<()> {
        let taken = self.gauge.clock.now();
        let slow = self.polls % SLOW_EVERY == 1;
        let statics = !self.statics;
        if statics || slow {
            // In one pass: they stand between each other.
            self.other.read(&mut self.gauge, |tier| {
                tier == Tier::Slow && slow || tier == Tier::Static && statics
            })?;
            self.statics = true;
            let (seal, status) = self.gauge.control_status()?;
            self.control_status = status;
            self.shared.publish(|published| published.seal = seal);
        }
        let mut registers = self.other.clone();
        registers.read(&mut self.gauge, |tier| tier == Tier::Poll)?;
        if registers.hold_only(0xff) {
            let why = "every byte reads 0xff, as a bus without a gauge does";
            return Err(Error::new(self.gauge.chip.name, Cause::Protocol(why.into())).at(Step::Read));
        }
        self.polls += 1;
        self.failures = 0;
        if !self.hurry && self.polls > 1 {
            self.phase = Duration::ZERO;
        }
        self.hurry = false;
        self.last_poll = taken;
        Statistics::count(&self.shared.statistics.polls);
        let snapshot = Snapshot { taken, number: self.polls, registers, control_status: self.control_status };
        let chip = self.gauge.chip;
        let word = |code| {
            let register = chip.registers.iter().find(|register| register.code == code)?;
            snapshot.value(register).map(|value| value as u16)
        };
        if self.dataflash.polled(chip, word) {
            log::warn!("{}: another pack answers; its data flash is read anew", chip.name);
            self.drop_kept();
            self.hurry = true;
        }
        self.shared.publish(|published| published.snapshot = Some(Arc::new(snapshot)));
        Ok(())
    }

    fn say(&self, error: &Error) {
        self.shared.say(error);
    }

    /// What it is called in the log.
    fn called(&self) -> &str {
        self.shared.prefix.strip_suffix(": ").unwrap_or(self.gauge.chip.name)
    }

    fn told<T, E: Into<Error>>(&self, outcome: Result<T, E>) -> Result<T> {
        outcome.map_err(|error| {
            let error = error.into();
            self.say(&error);
            error
        })
    }

    /// Why a request is turned away before anything is sent, if it is.
    fn refusal(&self, request: &Request, waited: Duration) -> Option<Error> {
        if !request.goes_beyond_polling() {
            return None;
        }
        if self.unseen {
            let why = "it has not answered yet, so nothing is sent to its address";
            return Some(Error::new(self.called(), Cause::Gone(why.into())));
        }
        if let Some(sibling) = self.shared.published().sibling {
            let why = "no table describes its data flash and subcommands; only standard commands are read";
            return Some(Error::new(sibling.name, Cause::NotPermitted(why.into())));
        }
        let why = "the gauge was busy with other requests for too long; nothing was sent, try again";
        let late = || Error::new(self.gauge.chip.name, Cause::NotNow(why.into()));
        (waited > PATIENCE).then(late)
    }

    fn serve(&mut self, asked: Duration, request: Request) {
        let waited = self.gauge.clock.now().saturating_sub(asked);
        if let Some(error) = self.refusal(&request, waited) {
            return request.refuse(error);
        }
        match request {
            Request::Read(wanted, done) => done(self.read(&wanted, waited)),
            Request::WriteAll(changes, done) => {
                let outcome = self.write(&changes, waited).map_err(|error| match changes.len() {
                    1 => error,
                    _ => error.within("df/transaction"),
                });
                done(self.told(outcome));
            }
            Request::Seal(goal, done) => {
                let outcome = self.dataflash.go_to(&mut self.gauge, goal, waited);
                self.look_at_seal();
                done(self.told(outcome));
            }
            Request::Control(code, done) => {
                let outcome = self.gauge.ask(code);
                self.look_at_seal();
                let prefix = &self.shared.prefix;
                done(
                    self.told(outcome)
                        .map(|answer| log::info!("{prefix}Control(0x{code:04x}) answered 0x{answer:04x}")),
                );
            }
            Request::ChangeKey(change, done) => {
                let order = self.shared.auth_order;
                let outcome = self.dataflash.change_key(&mut self.gauge, &change, order, waited);
                self.look_at_seal();
                let name = change.name.as_str();
                done(self.told(outcome).map(|()| log::info!("{name} key: changed and tried")));
            }
            Request::Authenticate(challenge, done) => {
                // Whatever comes of it, the digest before is no answer to this challenge.
                self.shared.publish(|published| published.digest = None);
                let order = self.shared.auth_order;
                let digest = authentication::ask(&mut self.gauge, &challenge, order, waited);
                done(self.told(digest).map(|digest| {
                    self.shared.publish(|published| published.digest = Some(digest));
                }));
            }
            // Somebody else's refresh, or a poll, came in between: its values are as fresh as was asked for.
            Request::Refresh(done) if asked < self.last_poll && self.failures == 0 => {
                self.drop_kept();
                self.dataflash.forget();
                done(Ok(()));
            }
            Request::Refresh(done) => {
                // However fast it is asked for, the gauge sees it twice a second at most.
                let early = (self.last_poll + SHORTEST).saturating_sub(self.gauge.clock.now());
                self.gauge.wait(early);
                self.drop_kept();
                self.dataflash.forget();
                self.polls = self.polls.next_multiple_of(SLOW_EVERY) + 1;
                let arrives = self.failures >= FAILURES || self.dataflash.doubts();
                let outcome = if arrives { self.arrive() } else { Ok(()) };
                let outcome = outcome.and_then(|()| self.poll());
                if let Err(error) = &outcome {
                    self.poll_failed(error);
                }
                done(outcome);
            }
            Request::Look => {
                self.gauge.release_if_gone();
                if self.failures > 0 {
                    self.poll_or_say();
                }
            }
            Request::Interval(interval, done) => {
                self.shared.publish(|published| published.interval = interval);
                done(Ok(()));
            }
        }
    }

    /// Reads those subclasses that are not kept, in one visit to the unsealed gauge.
    fn read(&mut self, wanted: &[usize], waited: Duration) -> Result<Vec<Arc<[u8]>>> {
        let kept: Vec<_> = wanted.iter().map(|&index| self.shared.kept(index)).collect();
        let unread = wanted.iter().zip(&kept).filter(|(_, kept)| kept.is_none());
        let unread: Vec<usize> = unread.map(|(&index, _)| index).collect();
        let mut read = self.read_anew(&unread, waited)?.into_iter();
        Ok(kept.into_iter().filter_map(|kept| kept.or_else(|| read.next())).collect())
    }

    fn read_anew(&mut self, wanted: &[usize], waited: Duration) -> Result<Vec<Arc<[u8]>>> {
        let rows: Vec<&Subclass> = wanted.iter().map(|&index| &self.gauge.chip.subclasses[index]).collect();
        let Some(first) = rows.first() else { return Ok(Vec::new()) };
        let read = self.dataflash.read(&mut self.gauge, &rows, waited);
        let read = self.told(read.map_err(|error| error.within(&format!("df of {}", first.name))))?;
        let read: Vec<Arc<[u8]>> = read.into_iter().map(Arc::from).collect();
        for (&index, bytes) in wanted.iter().zip(&read) {
            lock(&self.shared.kept)[index] = Some(Kept { bytes: bytes.clone(), poll: self.polls });
        }
        self.look_for_quirks();
        Ok(read)
    }

    fn write(&mut self, changes: &[Change], waited: Duration) -> Result<()> {
        if changes.is_empty() {
            return Ok(());
        }
        let outcome = self.dataflash.write(&mut self.gauge, changes, waited);
        let told = match &outcome {
            Ok(Outcome::Unchanged) => "unchanged, nothing written",
            Ok(Outcome::Written { .. }) => "written and verified",
            Err(_) => "",
        };
        for change in changes.iter().filter(|_| outcome.is_ok()) {
            log::info!("{}{}: {told}", self.shared.prefix, change.name());
        }
        // After a reset, and after a failure, nothing that was read before is taken for granted.
        if outcome == (Ok(Outcome::Written { reset: false })) {
            let mut kept = lock(&self.shared.kept);
            for (row, kept) in self.gauge.chip.subclasses.iter().zip(kept.iter_mut()) {
                let touched = |change: &Change| match change.row {
                    Some((subclass, _)) => std::ptr::eq(subclass, row),
                    None => change.place.subclass == row.id,
                };
                if changes.iter().any(touched) {
                    *kept = None;
                }
            }
        } else if !matches!(outcome, Ok(Outcome::Unchanged)) {
            self.drop_kept();
            self.hurry = true;
        }
        Ok(outcome.map(|_| ())?)
    }

    /// Reads CONTROL_STATUS for whoever looks at it next; a failure shows in the next poll.
    fn look_at_seal(&mut self) {
        if let Ok((seal, status)) = self.gauge.control_status() {
            self.control_status = status;
            self.shared.publish(|published| {
                published.seal = seal;
                if let Some(snapshot) = &mut published.snapshot {
                    Arc::make_mut(snapshot).control_status = status;
                }
            });
        }
    }
}

/// Raised by owners whenever something published has changed; the FUSE side waits on it.
#[derive(Debug, Default)]
pub struct Signal {
    count: Mutex<u64>,
    raised: Condvar,
}

impl Signal {
    /// Something has changed.
    pub fn raise(&self) {
        *self.count.lock().expect("no thread panics while it holds the lock") += 1;
        self.raised.notify_all();
    }

    /// Waits until the count differs from `seen` or the time is over, and returns the count.
    pub fn wait(&self, seen: u64, limit: Option<Duration>) -> u64 {
        let count = self.count.lock().expect("no thread panics while it holds the lock");
        match limit {
            None => *self.raised.wait_while(count, |count| *count == seen).expect("as above"),
            Some(limit) => {
                *self.raised.wait_timeout_while(count, limit, |count| *count == seen).expect("as above").0
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SimClock;
    use crate::sim::{Options, Sim};

    const INTERVAL: Duration = Duration::from_secs(8);

    /// The owner of a simulated gauge that is the `at`th of four.
    fn owner(at: u32) -> Owner {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a gauge");
        clock.sleep(Duration::from_secs(1));
        let settings = Settings { interval: INTERVAL, ..Settings::default() };
        let place = Place { phase: INTERVAL * at / 4, ..Place::default() };
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        Owner::new(chip, Box::new(sim.bus()), clock, settings, place, Arc::default()).0
    }

    #[test]
    fn polls_of_many_gauges_are_spread_over_the_interval() {
        for at in 0..4 {
            let mut owner = owner(at);
            owner.open().expect("it answers");
            // Soon after the first one, as with a single gauge; then once early, by its place.
            let pauses = [(); 4].map(|()| {
                let pause = owner.pause();
                owner.poll_or_say();
                pause
            });
            assert_eq!(pauses, [SHORTEST, INTERVAL - INTERVAL * at / 4, INTERVAL, INTERVAL]);
        }
    }
}
