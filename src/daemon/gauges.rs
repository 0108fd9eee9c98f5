//! Opening the gauges of a mount: one that has to answer, or many at the same time, of which some may not.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use nix::errno::Errno;

use super::journal_dir;
use super::source::{Opened, SimKnobs};
use crate::config::{GaugeOptions, Source};
use crate::error::{Cause, Error, Result};
use crate::folders;
use crate::fs::{Knobs, MountedGauge};
use crate::key_file;
use crate::lock::Lock;
use crate::output::say;
use crate::owner::{self, Backup, Origin, Settings, Signal, Startup};
use gauge_bus::clock::Clock;
use gauge_bus::linux::Adapter;
use gauge_bus::trace::{self, Trace};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::Change;
use ti_gauge::image::Image;
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;

/// How long a mount of many gauges waits for those that do not answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// The settings that all gauges of a mount share while they are opened.
#[derive(Clone)]
pub(super) struct Opening {
    pub(super) mountpoint: PathBuf,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) signal: Arc<Signal>,
    /// Nothing is written, so there is neither journal nor backup.
    pub(super) read_only: bool,
    /// Configurations are not saved before the first write.
    pub(super) no_backup: bool,
    /// Folder for journals and backups, if one was given.
    pub(super) state_dir: Option<PathBuf>,
}

/// A gauge whose owner is running.
pub(super) struct Ready {
    pub(super) entry: MountedGauge,
    /// Its name in messages.
    pub(super) what: String,
    pub(super) lock: Option<Lock>,
    /// The node of its adapter.
    pub(super) node: Option<PathBuf>,
}

/// The result of a gauge's first poll.
type Begun = Receiver<Result<()>>;

impl Opening {
    /// Opens the only gauge of a mount.
    pub(super) fn one(&self, name: String, gauge: GaugeOptions) -> Result<Ready> {
        let keys = keys(&gauge, &name)?;
        let subject = Source::of(&gauge).to_string();
        let (ready, begun) = self.begin(name, gauge, keys, Startup::default(), false)?;
        let ended = || Err(Error::host(&subject, Errno::EIO, "its thread has ended"));
        begun.recv().unwrap_or_else(|_| ended()).map_err(|error| error.within(&subject))?;
        Ok(ready)
    }

    /// Opens many gauges at the same time. Those that do not answer are waited for in the background if their
    /// chip is known, and left out otherwise. Both are logged, and with `aloud` also printed.
    pub(super) fn many(&self, gauges: Vec<(String, GaugeOptions)>, aloud: bool) -> Result<Vec<Ready>> {
        // A key file that cannot be used is an error of the configuration, so the mount fails.
        let keys = gauges.iter().map(|(name, gauge)| keys(gauge, name)).collect::<Result<Vec<_>>>()?;
        let names: Vec<String> = gauges.iter().map(|(name, _)| name.clone()).collect();
        let waits: Vec<bool> = gauges.iter().map(|(_, gauge)| Source::of(gauge).chip().is_some()).collect();
        let (sender, opened) = mpsc::channel();
        let all = gauges.len() as u32;
        for (at, ((name, gauge), keys)) in (0u32..).zip(gauges.into_iter().zip(keys)) {
            let phase = gauge.interval() * at / all;
            let startup = Startup { name: name.clone(), phase, ..Startup::default() };
            let (sender, opening) = (sender.clone(), self.clone());
            let open = move || {
                let waits = Source::of(&gauge).chip().is_some();
                // If the mount no longer waits, this drops the gauge.
                let _ = sender.send((at as usize, opening.begin(name, gauge, keys, startup, waits)));
            };
            let thread = std::thread::Builder::new().name("open".into()).stack_size(256 * 1024);
            thread.spawn(open).map_err(|error| Error::io("gauges", "cannot start a thread", &error))?;
        }
        drop(sender);

        let end = Instant::now() + PATIENCE;
        let mut outcomes: Vec<Option<Result<(Ready, Begun)>>> = names.iter().map(|_| None).collect();
        while let Ok((at, outcome)) = opened.recv_timeout(end.saturating_duration_since(Instant::now())) {
            outcomes[at] = Some(outcome);
        }
        let (mut ready, mut lines, mut reasons) = (Vec::new(), Vec::new(), Vec::new());
        for ((name, waits), outcome) in names.iter().zip(waits).zip(outcomes) {
            match outcome
                .unwrap_or_else(|| Err(slow()))
                .and_then(|(ready, begun)| wait(ready, &begun, end, waits))
            {
                Ok((one, None)) => ready.push(one),
                Ok((mut one, Some(error))) => {
                    lines.push(format!("{name}: not there yet, waiting for it: {error}"));
                    one.what += ", not there yet,";
                    ready.push(one);
                }
                Err(error) => {
                    lines.push(format!("{name}: left out: {error}"));
                    reasons.push(error.within(name).to_string());
                }
            }
        }
        if ready.is_empty() {
            let why = format!("no gauge can be mounted: {}", reasons.join("; "));
            return Err(Error::new("", Cause::Gone(why)));
        }
        for line in lines {
            log::warn!("{line}");
            if aloud {
                say(format_args!("warning: {line}"));
            }
        }
        Ok(ready)
    }

    /// Opens a gauge and starts its owner, which polls it.
    fn begin(
        &self,
        name: String,
        gauge: GaugeOptions,
        keys: Keys,
        startup: Startup,
        waits: bool,
    ) -> Result<(Ready, Begun)> {
        let opened = Source::of(&gauge).open(&self.mountpoint, &self.clock, waits)?;
        let Opened { chip, mut bus, clock_hz, address, subject, .. } = opened;
        if let Some(path) = &gauge.trace {
            let head = format!("{} on {subject}, {:.0}", chip.name, Timestamp::now());
            let replace = gauge.trace_replace;
            bus = Box::new(Trace::new(bus, address, path, self.clock.clone(), &head, replace)?);
        }
        let place = match self.read_only {
            true => None,
            false => journal_dir::place(self.state_dir.as_deref(), opened.journal_key)?,
        };
        let slow = chip.is_slower_than(clock_hz);
        let settings = settings(&gauge, keys, chip, &subject, slow, place, self.no_backup)?;
        let origin = Origin {
            place: Source::of(&gauge).place(),
            address,
            adapter: opened.node.as_deref().map_or_else(String::new, adapter),
        };
        let startup = Startup { unverified: opened.unverified, missing: opened.missing, origin, ..startup };
        let (handle, begun) =
            owner::start(chip, bus, self.clock.clone(), settings, startup, self.signal.clone())?;
        let entry = MountedGauge {
            name,
            handle,
            scales: gauge.scales(),
            knobs: opened.sim.map(|sim| Box::new(SimKnobs(sim)) as Box<dyn Knobs>),
        };
        let what = format!("{} ({subject})", chip.model);
        Ok((Ready { entry, what, lock: opened.lock, node: opened.node }, begun))
    }
}

/// Whether the trace of a gauge can be recorded. A file that is there is not recorded over.
pub(super) fn check_trace(gauge: &GaugeOptions) -> Result<()> {
    let Some(path) = &gauge.trace else { return Ok(()) };
    trace::check(path, gauge.trace_replace).map_err(|error| {
        let name = path.display().to_string();
        if error.kind() == ErrorKind::AlreadyExists {
            let why =
                "the trace is there already; move it away, choose another name, or replace it with --trace-replace";
            return Error::host(name, Errno::EEXIST, why);
        }
        Error::io(name, "cannot write the trace", &error)
    })
}

/// How a gauge is run, as its options have it. `place` is the folder of its journals and backups, and its name there.
pub(crate) fn settings(
    gauge: &GaugeOptions,
    keys: Keys,
    chip: &'static Chip,
    subject: &str,
    byte_writes: bool,
    place: Option<(PathBuf, String)>,
    no_backup: bool,
) -> Result<Settings> {
    let key_file = gauge.key_file.as_ref().map(|path| path.display().to_string());
    Ok(Settings {
        keys,
        key_file: key_file.or_else(key_file::of_credential),
        interval: gauge.interval(),
        byte_writes: gauge.byte_writes || byte_writes,
        allow_unproven: gauge.allow_unproven,
        limits: gauge.limits(),
        auth_order: gauge.auth_order.unwrap_or_default(),
        restore: gauge.restore.as_deref().map_or(Ok(Vec::new()), |path| saved(chip, path))?,
        journal: place
            .clone()
            .map(|(folder, key)| Journal::new(folder, key, subject.into()).trusting(folders::service())),
        backup: place.filter(|_| !no_backup).map(|(folder, key)| Backup::new(folder, key)),
    })
}

/// Waits for a gauge's first poll. A failure is an error, or with `waits` the reason why it is not there yet.
fn wait(ready: Ready, begun: &Begun, end: Instant, waits: bool) -> Result<(Ready, Option<Error>)> {
    let error = match begun.recv_timeout(end.saturating_duration_since(Instant::now())) {
        Ok(Ok(())) => return Ok((ready, None)),
        Ok(Err(error)) => error,
        Err(RecvTimeoutError::Timeout) => slow(),
        Err(RecvTimeoutError::Disconnected) => Error::host("", Errno::EIO, "its thread has ended"),
    };
    if waits { Ok((ready, Some(error))) } else { Err(error) }
}

/// An adapter in words, for a report.
fn adapter(node: &Path) -> String {
    let Ok(adapter) = Adapter::find(node) else { return "not there when it was opened".into() };
    let name = adapter.name().unwrap_or_default();
    let capabilities = adapter.capabilities().map_or("unknown".into(), |bits| format!("0x{bits:08x}"));
    let clock = adapter.clock_hz().map_or("unknown".into(), |hz| format!("{hz} Hz"));
    format!("i2c-{} ({name}), capabilities {capabilities}, clock {clock}", adapter.number())
}

fn slow() -> Error {
    Error::new("", Cause::TimedOut(format!("no answer within {} s", PATIENCE.as_secs())))
}

pub(super) fn saved(chip: &'static Chip, path: &Path) -> Result<Vec<Change>> {
    let image = Image::open(path, Some(chip))?;
    Ok(image.to_restore().map_err(|error| error.within(&path.display().to_string()))?)
}

/// The gauge's keys, from its key file or else from systemd's credential.
pub(crate) fn keys(gauge: &GaugeOptions, name: &str) -> Result<Keys> {
    let mut keys = match &gauge.key_file {
        Some(path) => key_file::from_file(path, name)?,
        None => key_file::from_credential(name)?.unwrap_or_default(),
    };
    keys.no_default = gauge.no_default_keys;
    Ok(keys)
}
