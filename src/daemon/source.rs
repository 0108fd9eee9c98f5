//! Opening a gauge: a simulated one, a recording, or one on a bus.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use nix::errno::Errno;

use super::mountpoint;
use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::replay::{Recording, Replay, Seals};
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::{Chip, SealStatus, Tier};
use crate::clock::Clock;
use crate::error::{Cause, Error, Result};
use crate::fs::Knobs;
use crate::gauge::bursts;
use crate::lock::{self, Holder, Lock};
use crate::probe;
use crate::sim::{self, Sim};

/// How long a simulated gauge may take from power-up to its first answer.
const POWER_UP: Duration = Duration::from_secs(2);

/// Where the gauge is.
#[derive(Debug)]
pub enum Source {
    /// In this process.
    Sim {
        /// What it is.
        chip: &'static Chip,
        /// File that keeps its flash.
        state: Option<PathBuf>,
        /// Its unseal key, where it is new.
        key: Option<[u16; 2]>,
    },
    /// In a file that `--trace` wrote.
    Recorded(PathBuf),
    /// On a bus.
    Bus {
        /// The adapter's node.
        bus: PathBuf,
        /// Its 7-bit address.
        address: u8,
        /// What it is; `None` to ask it.
        chip: Option<&'static Chip>,
    },
}

/// A gauge that is reached and locked, and nothing more.
pub(super) struct Opened {
    pub(super) chip: &'static Chip,
    pub(super) bus: Box<dyn Bus>,
    /// Its clock, where that is known.
    pub(super) clock_hz: Option<u32>,
    pub(super) address: u8,
    /// What to call it in messages.
    pub(super) subject: String,
    pub(super) sim: Option<Sim>,
    pub(super) lock: Option<Lock>,
    /// A name for its place, which lasts; `None` for what ends with this process.
    pub(super) key: Option<String>,
    /// The node of its adapter.
    pub(super) node: Option<PathBuf>,
    /// Nobody has seen yet that it reads like a gauge.
    pub(super) unseen: bool,
    /// Why it cannot be reached yet.
    pub(super) missing: Option<Error>,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim { state: Some(state), .. } => write!(f, "simulated gauge kept in {}", state.display()),
            Self::Sim { .. } => f.write_str("simulated gauge"),
            Self::Recorded(path) => write!(f, "recording {}", path.display()),
            Self::Bus { bus, address, .. } => write!(f, "{} address 0x{address:02x}", bus.display()),
        }
    }
}

impl Source {
    /// What it is, where that has been said.
    pub fn chip(&self) -> Option<&'static Chip> {
        match self {
            Self::Sim { chip, .. } => Some(chip),
            Self::Bus { chip, .. } => *chip,
            Self::Recorded(_) => None,
        }
    }

    /// With `waits`, a gauge whose chip is known need not be within reach now.
    pub(super) fn open(&self, mountpoint: &Path, clock: &Arc<dyn Clock>, waits: bool) -> Result<Opened> {
        let subject = self.to_string();
        // A daemon whose mount is gone is about to end; one that is mounted is not.
        let ending = |holder: &Holder| !mountpoint::is_ours(&holder.mountpoint);
        match self {
            Self::Sim { chip, state, key: unseal_key } => {
                let (lock, key) = match state {
                    None => (None, None),
                    Some(path) => {
                        let path = std::path::absolute(path)
                            .map_err(|error| Error::io(path.display().to_string(), "no such path", &error))?;
                        let lock = Lock::state(&path, mountpoint, &**clock, ending)?;
                        (Some(lock), Some(lock::key_of_state(&path)))
                    }
                };
                let seed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
                let options = sim::Options { state: state.clone(), unseal_key: *unseal_key, seed };
                let sim = Sim::new(chip.name, &options, clock.clone())?;
                let mut bus = sim.bus();
                let start = clock.now();
                while bus.transfer(&[0], &mut [0; 2]).is_err() && clock.now() - start < POWER_UP {
                    clock.sleep(Duration::from_millis(20));
                }
                let opened = Opened::new(chip, Box::new(bus), subject);
                Ok(Opened { sim: Some(sim), lock, key, ..opened })
            }
            Self::Recorded(path) => {
                let (chip, replay) = recorded(path)?;
                Ok(Opened::new(chip, Box::new(replay), subject))
            }
            Self::Bus { bus, address, chip } => {
                let absent = |chip, error: Error| {
                    // Its journal has to be found again, whether the adapter is there at the start or not.
                    let Some(key) = lock::key_of_place(bus, *address) else {
                        let why = format!("{error}; one that is waited for has to be called /dev/i2c-N");
                        return Err(Error::host("", error.errno(), why));
                    };
                    let bus = LinuxBus::absent(bus, *address, clock.clone());
                    let opened = Opened::new(chip, Box::new(bus), subject.clone());
                    Ok(Opened { missing: Some(error), unseen: true, key: Some(key), ..opened })
                };
                let reach = || -> Result<_> {
                    let adapter = Adapter::find(bus)?;
                    let lock = Lock::gauge(&adapter, *address, mountpoint, &**clock, ending)?;
                    let open = || {
                        let bus = LinuxBus::open(adapter.clone(), *address, clock.clone())?;
                        Ok(Box::new(bus) as Box<dyn Bus>)
                    };
                    let asked = chip.is_none().then(|| probe::find(&subject, &open, clock)).transpose()?;
                    let clock_hz = adapter.clock_hz();
                    let key = lock::key_of_gauge(&adapter, *address);
                    Ok((asked, open()?, lock, clock_hz, key))
                };
                let opened = match (reach(), *chip) {
                    (Ok((asked, bus, lock, clock_hz, key)), chip) => {
                        let known = asked.or(chip).expect("what has not been said was asked");
                        let opened = Opened::new(known, bus, subject.clone());
                        let key = Some(key);
                        Opened { lock: Some(lock), clock_hz, key, unseen: asked.is_none(), ..opened }
                    }
                    (Err(error), Some(chip)) if waits && error.errno() != Errno::ENOTTY => {
                        absent(chip, error)?
                    }
                    (Err(error), _) => return Err(error),
                };
                Ok(Opened { address: *address, node: Some(bus.clone()), ..opened })
            }
        }
    }
}

impl Opened {
    fn new(chip: &'static Chip, bus: Box<dyn Bus>, subject: String) -> Self {
        Self {
            chip,
            bus,
            clock_hz: None,
            address: GAUGE_ADDRESS,
            subject,
            sim: None,
            lock: None,
            node: None,
            key: None,
            unseen: false,
            missing: None,
        }
    }
}

/// The gauge of a recording, which has to hold all that a mount reads by itself.
fn recorded(path: &Path) -> Result<(&'static Chip, Replay)> {
    let name = path.display().to_string();
    let refuse = |why: String| Error::new(&name, Cause::Invalid(why));
    let recording = Recording::open(path)?;
    let chip = Chip::by_name(&recording.chip)
        .ok_or_else(|| refuse(format!("`{}` is no gauge that gaugefs knows", recording.chip)))?;
    let status = match chip.security.status {
        SealStatus::Field { register, .. } => register,
        SealStatus::Bits { .. } => None,
    };
    let replay = Replay::new(&recording, Seals { command: chip.security.seal, status });
    for tier in [Tier::Poll, Tier::Static, Tier::Slow] {
        let mut read = bursts(chip.registers, |found| found == tier).into_iter();
        if !read.all(|(register, length)| replay.covers(register, length)) {
            let why = "it ends before every register was read; a few seconds of a mount have them all";
            return Err(refuse(why.into()));
        }
    }
    Ok((chip, replay))
}

/// The files of `sim/`.
pub(super) struct SimKnobs(pub(super) Sim);

impl Knobs for SimKnobs {
    fn list(&self) -> Vec<(&'static str, bool)> {
        self.0.knobs().iter().map(|knob| (knob.name, knob.writable)).collect()
    }

    fn get(&self, name: &str) -> Option<String> {
        self.0.get(name)
    }

    fn set(&self, name: &str, text: &str) -> Result<()> {
        self.0.set(name, text)
    }
}
