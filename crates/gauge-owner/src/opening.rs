// SPDX-License-Identifier: MIT

//! Opening gauges and starting their owners: one, which has to answer, or many at a time, where some may be silent.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use nix::errno::Errno;

use crate::error::{Cause, Error, Reason, Result};
use crate::journal_dir;
use crate::lock::Lock;
use crate::options::GaugeOptions;
use crate::owner::{self, Handle, Origin, Run, Signal};
use crate::source::{Opened, Source};
use gauge_bus::BusError;
use gauge_bus::clock::Clock;
use gauge_bus::error::ErrorKind;
use gauge_bus::linux::Adapter;
use gauge_sim::Sim;
use ti_gauge::keys::Keys;

/// How long a mount of many gauges waits for those that do not answer, while it has others.
const PATIENCE: Duration = Duration::from_secs(5);
/// And how long while it has none: a machine that is busy takes its time.
const LONGEST: Duration = Duration::from_secs(30);

/// The settings that all gauges of a mount share while they are opened.
#[derive(Clone)]
pub struct Opening {
    /// Where they will be mounted: another process that finds a gauge in use names it.
    pub mountpoint: PathBuf,
    /// The time of all of them.
    pub clock: Arc<dyn Clock>,
    /// Raised when a gauge has published something.
    pub signal: Arc<Signal>,
    /// Nothing is written, so there is neither journal nor backup.
    pub read_only: bool,
    /// Configurations are not saved before the first write.
    pub no_backup: bool,
    /// Folder for journals and backups, if one was given.
    pub state_dir: Option<PathBuf>,
}

/// A gauge whose owner is running.
pub struct Ready {
    /// Its name among the others.
    pub name: String,
    /// What everybody else sees of it.
    pub handle: Handle,
    /// The simulated gauge, if it is one.
    pub sim: Option<Sim>,
    /// Its name in messages.
    pub what: String,
    /// Keeps other processes out while it is held.
    pub lock: Option<Lock>,
    /// The node of its adapter.
    pub node: Option<PathBuf>,
}

type Begun = Receiver<Result<()>>;

enum News {
    Opened(Result<Ready>),
    Polled(Result<()>),
}

struct Slot {
    name: String,
    /// It has a folder also while it does not answer.
    waits: bool,
    ready: Option<Ready>,
    /// `None` until it has been polled, or has failed.
    outcome: Option<Result<()>>,
}

impl Slot {
    fn take(&mut self, news: News) {
        match news {
            News::Opened(Ok(ready)) => self.ready = Some(ready),
            News::Opened(Err(error)) => self.outcome = Some(Err(error)),
            News::Polled(outcome) => self.outcome = Some(outcome),
        }
    }

    fn can_be_mounted(&self) -> bool {
        self.ready.is_some() && (self.waits || matches!(self.outcome, Some(Ok(()))))
    }
}

/// Whether a gauge that could not be opened may answer later. The greater one is the better outlook.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outlook {
    /// What was asked for is wrong, or the kernel's driver has it, whose release udev tells.
    Never,
    /// Its bus is not there, or may not be used: while a machine starts, that may change.
    AtBoot,
    /// It does not answer, or another process uses it.
    Later,
}

impl Outlook {
    /// By the cause of the failure.
    pub fn of(cause: Cause) -> Self {
        match cause {
            Cause::Busy
            | Cause::NotNow
            | Cause::BadChecksum
            | Cause::Protocol
            | Cause::TimedOut
            | Cause::NoAnswer => Self::Later,
            Cause::Bus(
                BusError::ReadOnly | BusError::WriteDisabled | BusError::NotRecorded | BusError::Busy,
            ) => Self::Never,
            Cause::Bus(_) => Self::Later,
            Cause::Adapter(ErrorKind::NotFound | ErrorKind::Forbidden) => Self::AtBoot,
            _ => Self::Never,
        }
    }
}

impl Opening {
    /// Gauges that may be written to, whose journals and backups are in this account's own folder.
    pub fn new(mountpoint: PathBuf, clock: Arc<dyn Clock>) -> Self {
        Self {
            mountpoint,
            clock,
            signal: Arc::default(),
            read_only: false,
            no_backup: false,
            state_dir: None,
        }
    }

    /// Opens the only gauge of a mount.
    pub fn one(&self, name: String, options: &GaugeOptions) -> Result<Ready> {
        let keys = options.keys(&name)?;
        let source = Source::of(options)?;
        let subject = source.to_string();
        let (ready, begun) = self.begin(name, options, &source, keys, None)?;
        begun.recv().unwrap_or_else(|_| Err(ended(&subject))).map_err(|error| error.within(&subject))?;
        Ok(ready)
    }

    /// Opens many gauges at the same time. Silent ones of a known chip are waited for, others left out; a line says so.
    pub fn many(&self, gauges: Vec<(String, GaugeOptions)>) -> Result<(Vec<Ready>, Vec<String>)> {
        // A key file that cannot be used is an error of the configuration, so the mount fails.
        let gauges = gauges.into_iter().map(|(name, options)| {
            let (source, keys) = (Source::of(&options)?, options.keys(&name)?);
            Ok((name, options, source, keys))
        });
        let gauges = gauges.collect::<Result<Vec<_>>>()?;
        let slot = |(name, _, source, _): &(String, GaugeOptions, Source, Keys)| Slot {
            name: name.clone(),
            waits: source.chip().is_some(),
            ready: None,
            outcome: None,
        };
        let mut slots: Vec<Slot> = gauges.iter().map(slot).collect();
        let (sender, news) = mpsc::channel();
        let all = gauges.len() as u32;
        for (at, (name, options, source, keys)) in (0u32..).zip(gauges) {
            let phase = options.interval(&source) * at / all;
            let (sender, opening) = (sender.clone(), self.clone());
            let open = move || {
                // If the mount no longer waits, this drops the gauge.
                let tell = |news| drop(sender.send((at as usize, news)));
                match opening.begin(name, &options, &source, keys, Some(phase)) {
                    Ok((ready, begun)) => {
                        tell(News::Opened(Ok(ready)));
                        tell(News::Polled(begun.recv().unwrap_or_else(|_| Err(ended("")))));
                    }
                    Err(error) => tell(News::Opened(Err(error))),
                }
            };
            let thread = std::thread::Builder::new().name("open".into()).stack_size(256 * 1024);
            thread.spawn(open).map_err(|error| Error::io("gauges", "cannot start a thread", &error))?;
        }
        drop(sender);

        let start = Instant::now();
        let mut patience = LONGEST;
        while slots.iter().any(|slot| slot.outcome.is_none()) {
            patience = if slots.iter().any(Slot::can_be_mounted) { PATIENCE } else { LONGEST };
            match news.recv_timeout((start + patience).saturating_duration_since(Instant::now())) {
                Ok((at, news)) => slots[at].take(news),
                Err(_) => break,
            }
        }
        let (mut ready, mut lines, mut failures) = (Vec::new(), Vec::new(), Vec::new());
        for Slot { name, waits, ready: opened, outcome } in slots {
            match (opened, outcome.unwrap_or_else(|| Err(slow(patience)))) {
                (Some(one), Ok(())) => ready.push(one),
                (Some(mut one), Err(error)) if waits => {
                    lines.push(format!("{name}: not there yet, waiting for it: {error}"));
                    one.what += ", not there yet,";
                    ready.push(one);
                }
                (_, outcome) => {
                    let error = outcome.err().unwrap_or_else(|| ended(""));
                    lines.push(format!("{name}: left out: {error}"));
                    failures.push(error.within(&name));
                }
            }
        }
        if ready.is_empty() {
            let best = failures.iter().map(Error::cause).max_by_key(|&cause| Outlook::of(cause));
            let reasons: Vec<_> = failures.iter().map(ToString::to_string).collect();
            let why = format!("no gauge can be mounted: {}", reasons.join("; "));
            return Err(Error::new("", best.unwrap_or(Cause::Gone), why));
        }
        Ok((ready, lines))
    }

    /// Opens a gauge and starts its owner, which polls it. One of many has a `phase`, and is waited for.
    fn begin(
        &self,
        name: String,
        options: &GaugeOptions,
        source: &Source,
        keys: Keys,
        phase: Option<Duration>,
    ) -> Result<(Ready, Begun)> {
        let is_one_of_many = phase.is_some();
        let waits = is_one_of_many && source.chip().is_some();
        let opened = source.open(&self.mountpoint, &self.clock, waits)?;
        let Opened { chip, bus, reach, address, subject, sim, lock, journal_key, node, unverified, missing } =
            opened;
        let head = format!("{} on {subject}, {:.0}", chip.name, Timestamp::now());
        let bus = options.traced(bus, address, &self.clock, &head)?;
        let place = match self.read_only {
            true => None,
            false => journal_dir::place(self.state_dir.as_deref(), journal_key)?,
        };
        let run = options.run(keys, chip, &subject, place, self.no_backup)?;
        let run = Run {
            reach: run.reach.narrowed(reach),
            name: if is_one_of_many { name.clone() } else { String::new() },
            phase: phase.unwrap_or_default(),
            unverified,
            missing,
            origin: Origin {
                place: source.place(),
                address,
                adapter: node.as_deref().map_or_else(String::new, adapter),
            },
            ..run
        };
        let (handle, begun) = owner::start(chip, bus, self.clock.clone(), run, self.signal.clone())?;
        let what = format!("{} ({subject})", chip.model);
        Ok((Ready { name, handle, sim, what, lock, node }, begun))
    }
}

/// An adapter in words, for a report.
fn adapter(node: &Path) -> String {
    let Ok(adapter) = Adapter::find(node) else { return "not there when it was opened".into() };
    let name = adapter.name().unwrap_or_default();
    let capabilities = adapter.capabilities().map_or("unknown".into(), |bits| format!("0x{bits:08x}"));
    let clock = adapter.clock_hz().map_or("unknown".into(), |hz| format!("{hz} Hz"));
    format!("i2c-{} ({name}), capabilities {capabilities}, clock {clock}", adapter.number())
}

fn slow(patience: Duration) -> Error {
    Error::of("", Reason::Silent { seconds: patience.as_secs() as i64 })
}

fn ended(subject: &str) -> Error {
    Error::host(subject, Errno::EIO, "its thread has ended")
}
