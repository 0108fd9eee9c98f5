//! Opening the gauges of a mount: one that has to be there, or many at once, of which some may not be.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use nix::errno::Errno;

use super::{Gauge, Opened, SimKnobs, journal, saved, too_fast};
use crate::bus::trace::Trace;
use crate::clock::Clock;
use crate::error::{Cause, Error, Result};
use crate::fs::{Entry, Knobs};
use crate::keys::Keys;
use crate::lock::Lock;
use crate::poll::{self, Place, Settings, Signal};

/// So long a mount of many waits for those that do not answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// What all gauges of a mount have in common while they are opened.
#[derive(Clone)]
pub(super) struct Opening {
    pub(super) mountpoint: PathBuf,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) signal: Arc<Signal>,
    /// Nothing is written, so no journal is kept.
    pub(super) read_only: bool,
    /// Folder for journals.
    pub(super) state_dir: Option<PathBuf>,
}

/// A gauge that has its owner.
pub(super) struct Ready {
    pub(super) entry: Entry,
    /// What to call it in messages.
    pub(super) what: String,
    pub(super) lock: Option<Lock>,
    /// The node of its adapter.
    pub(super) node: Option<PathBuf>,
}

/// What comes of its first poll.
type Begun = Receiver<Result<()>>;

impl Opening {
    /// The one gauge of a mount.
    pub(super) fn one(&self, name: String, gauge: Gauge) -> Result<Ready> {
        let keys = gauge.keyring.open(&name)?;
        let subject = gauge.source.to_string();
        let (ready, begun) = self.begin(name, gauge, keys, Place::default(), false)?;
        let ended = || Err(Error::host(&subject, Errno::EIO, "its thread has ended"));
        begun.recv().unwrap_or_else(|_| ended()).map_err(|error| error.within(&subject))?;
        Ok(ready)
    }

    /// Many gauges, all at the same time. Those that do not answer are waited for later where it is known
    /// what they are, and else left out; `aloud` has that said on standard error too.
    pub(super) fn many(&self, gauges: Vec<(String, Gauge)>, aloud: bool) -> Result<Vec<Ready>> {
        // What the configuration names and cannot be used is not the gauge's fault.
        let keys = gauges.iter().map(|(name, gauge)| gauge.keyring.open(name)).collect::<Result<Vec<_>>>()?;
        let names: Vec<String> = gauges.iter().map(|(name, _)| name.clone()).collect();
        let waits: Vec<bool> = gauges.iter().map(|(_, gauge)| gauge.source.chip().is_some()).collect();
        let (tell, opened) = mpsc::channel();
        let all = gauges.len() as u32;
        for (at, ((name, gauge), keys)) in (0u32..).zip(gauges.into_iter().zip(keys)) {
            let phase = gauge.interval * at / all;
            let place = Place { name: name.clone(), phase, ..Place::default() };
            let (tell, opening) = (tell.clone(), self.clone());
            let open = move || {
                let waits = gauge.source.chip().is_some();
                // Where the mount has not waited so long, the gauge is let go of.
                let _ = tell.send((at as usize, opening.begin(name, gauge, keys, place, waits)));
            };
            let thread = std::thread::Builder::new().name("open".into()).stack_size(256 * 1024);
            thread.spawn(open).map_err(|error| Error::io("gauges", "cannot start a thread", &error))?;
        }
        drop(tell);

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
                    lines.push(format!("{name}: not there yet, waited for: {error}"));
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
                eprintln!("gaugefs: warning: {line}");
            }
        }
        Ok(ready)
    }

    /// Reaches a gauge and gives it its owner, who polls it.
    fn begin(
        &self,
        name: String,
        gauge: Gauge,
        keys: Keys,
        place: Place,
        waits: bool,
    ) -> Result<(Ready, Begun)> {
        let opened = gauge.source.open(&self.mountpoint, &self.clock, waits)?;
        let Opened { chip, mut bus, clock_hz, address, subject, .. } = opened;
        if let Some(path) = &gauge.trace {
            let head = format!("{} on {subject}, {:.0}", chip.name, Timestamp::now());
            bus = Box::new(Trace::new(bus, address, path, self.clock.clone(), &head)?);
        }
        let settings = Settings {
            keys,
            interval: gauge.interval,
            byte_writes: gauge.byte_writes || too_fast(chip, clock_hz),
            allow_unproven: gauge.allow_unproven,
            limits: gauge.limits,
            auth_order: gauge.auth_order,
            restore: gauge.restore.as_deref().map_or(Ok(Vec::new()), |path| saved(chip, path))?,
            journal: match self.read_only {
                true => None,
                false => journal(self.state_dir.as_deref(), opened.key, &subject)?,
            },
        };
        let place = Place { unseen: opened.unseen, missing: opened.missing, ..place };
        let (handle, begun) =
            poll::start(chip, bus, self.clock.clone(), settings, place, self.signal.clone())?;
        let entry = Entry {
            name,
            handle,
            scales: gauge.scales,
            knobs: opened.sim.map(|sim| Box::new(SimKnobs(sim)) as Box<dyn Knobs>),
        };
        let what = format!("{} ({subject})", chip.model);
        Ok((Ready { entry, what, lock: opened.lock, node: opened.node }, begun))
    }
}

/// Waits for a gauge's first poll, and says why it is not there where it `waits`.
fn wait(ready: Ready, begun: &Begun, end: Instant, waits: bool) -> Result<(Ready, Option<Error>)> {
    let error = match begun.recv_timeout(end.saturating_duration_since(Instant::now())) {
        Ok(Ok(())) => return Ok((ready, None)),
        Ok(Err(error)) => error,
        Err(RecvTimeoutError::Timeout) => slow(),
        Err(RecvTimeoutError::Disconnected) => Error::host("", Errno::EIO, "its thread has ended"),
    };
    if waits { Ok((ready, Some(error))) } else { Err(error) }
}

fn slow() -> Error {
    Error::new("", Cause::Slow(format!("it has not answered within {} s", PATIENCE.as_secs())))
}
