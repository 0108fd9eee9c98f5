//! The life of a mount: open the gauges, poll each once, mount, say so, wait for the end, unmount.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use nix::errno::Errno;
use nix::sys::signal::{SigSet, Signal as Unix};
use nix::unistd::{User, getegid, geteuid};

use crate::authentication::Order;
use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::replay::{Recording, Replay, Seals};
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::{Chip, SealStatus, Tier};
use crate::clock::{Clock, RealClock};
use crate::dataflash::{Change, Limits};
use crate::error::{Cause, Error, Result};
use crate::fs::{Access, Covered, Fs, Knobs, Scales, free_name};
use crate::fuse;
use crate::gauge::bursts;
use crate::image::Image;
use crate::journal::Journal;
use crate::key_file;
use crate::keys::Keys;
use crate::lock::{self, Holder, Lock};
use crate::poll::{Handle, Request, Signal};
use crate::probe;
use crate::sim::{self, Sim};

mod adapters;
pub mod background;
mod gauges;
pub mod log;
pub mod mountpoint;
pub mod node;
pub mod service;

use gauges::{Opening, Ready};

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

/// Where the keys come from.
#[derive(Debug)]
pub struct Keyring {
    /// File that holds them; without one, systemd's credential where there is one.
    pub file: Option<PathBuf>,
    /// Never try the manual's default key.
    pub no_default: bool,
}

/// One gauge of a mount.
#[derive(Debug)]
pub struct Gauge {
    /// Name of its folder; without one, the first of BAT0, BAT1 ... that is free.
    pub name: Option<String>,
    /// Where it is.
    pub source: Source,
    /// Write one byte a transfer.
    pub byte_writes: bool,
    /// Time between polls.
    pub interval: Duration,
    /// How figures are shown.
    pub scales: Scales,
    /// Write parameters too whose address or range is not sure.
    pub allow_unproven: bool,
    /// What else may be overruled, and how often flash may be programmed.
    pub limits: Limits,
    /// The order of bytes in which challenges are sent.
    pub auth_order: Order,
    /// A copy of `df/index`, for gauges that lose their configuration with their power.
    pub restore: Option<PathBuf>,
    /// Where the keys come from.
    pub keyring: Keyring,
    /// File to write transfers to.
    pub trace: Option<PathBuf>,
}

/// Everything that `gaugefs mount` can be told.
#[derive(Debug)]
pub struct Options {
    /// Folder to mount at.
    pub mountpoint: PathBuf,
    /// What to mount.
    pub gauges: Gauges,
    /// Refuse every write.
    pub read_only: bool,
    /// Shut other users out.
    pub private: bool,
    /// Group that may read and write data flash.
    pub group: Option<u32>,
    /// Stay in the foreground.
    pub foreground: bool,
    /// Leave the mounting to `service::attach`.
    pub service: bool,
    /// File to log to.
    pub log: Option<PathBuf>,
    /// Show a Mains supply too, of this name where one was chosen.
    pub ac: Option<Option<String>>,
    /// Folder for journals; without one, the system's or the user's own.
    pub state_dir: Option<PathBuf>,
}

/// The gauges of a mount.
#[derive(Debug)]
pub enum Gauges {
    /// The one of the command line, without which there is no mount.
    One(Box<Gauge>),
    /// Those of a configuration. The mount goes on without some of them.
    Many(Vec<Gauge>),
}

/// A gauge that is reached and locked, and nothing more.
struct Opened {
    chip: &'static Chip,
    bus: Box<dyn Bus>,
    /// Its clock, where that is known.
    clock_hz: Option<u32>,
    address: u8,
    /// What to call it in messages.
    subject: String,
    sim: Option<Sim>,
    lock: Option<Lock>,
    /// A name for its place, which lasts; `None` for what ends with this process.
    key: Option<String>,
    /// The node of its adapter.
    node: Option<PathBuf>,
    /// Nobody has seen yet that it reads like a gauge.
    unseen: bool,
    /// Why it cannot be reached yet.
    missing: Option<Error>,
}

/// Mounts gauges and serves them until they are unmounted.
pub fn run(options: Options) -> Result<()> {
    let inherited = background::inherited();
    // Before any thread is there, so that all inherit it: signals wait for the thread that takes them.
    let signals = [Unix::SIGTERM, Unix::SIGINT].into_iter().collect::<SigSet>();
    signals.thread_block().map_err(|errno| Error::io("signals", "cannot block them", &errno.into()))?;
    self::log::start(match &options.log {
        Some(path) => self::log::Destination::File(path),
        None if options.foreground => self::log::Destination::Stderr,
        None => self::log::Destination::Syslog,
    })?;
    let end = Arc::new(End::default());
    end.clone().watch(signals)?;

    let (mountpoint, device) = if options.service {
        (options.mountpoint, Some(service::device()?))
    } else {
        (mountpoint::prepare(&options.mountpoint)?, None)
    };
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let covered = mountpoint::covered(&mountpoint)?;
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let (gauges, one) = match options.gauges {
        Gauges::One(gauge) => (vec![*gauge], true),
        Gauges::Many(gauges) => (gauges, false),
    };
    let mut gauges = named(gauges, &taken);
    let mains = options.ac.map(|name| mains_name(name, &taken));
    if let Some((name, _)) = gauges.iter().find(|(name, _)| mains.as_ref() == Some(name)) {
        let why = "a gauge and the Mains supply cannot share a name; choose another --name or --ac";
        return Err(Error::new(name, Cause::Invalid(why.into())));
    }
    let signal = Arc::new(Signal::default());
    let opening = Opening {
        mountpoint: mountpoint.clone(),
        clock: clock.clone(),
        signal: signal.clone(),
        read_only: options.read_only,
        state_dir: options.state_dir,
    };
    let gauges = match gauges.pop() {
        Some((name, gauge)) if one => vec![opening.one(name, gauge)?],
        last => opening.many(gauges.into_iter().chain(last).collect(), !options.foreground)?,
    };

    // What root mounts is root's.
    let (uid, gid) = if options.service { (0, 0) } else { (geteuid().as_raw(), getegid().as_raw()) };
    let access = Access { uid, gid: options.group.unwrap_or(gid), group: options.group.is_some() };
    let handles: Vec<Handle> = gauges.iter().map(|gauge| gauge.entry.handle.clone()).collect();
    adapters::watch(
        gauges.iter().filter_map(|gauge| Some((gauge.node.clone()?, gauge.entry.handle.clone()))),
    );
    let mut told = Vec::new();
    let (mut entries, mut locks) = (Vec::new(), Vec::new());
    for Ready { entry, what, lock, .. } in gauges {
        told.push((what, format!("{}/{}", mountpoint.display(), entry.name)));
        entries.push(entry);
        locks.push(lock);
    }
    let tree = Arc::new(Fs::new(entries, access).with_mains(mains).overlay(covered));
    let how = fuse::Options { private: options.private, read_only: options.read_only };
    let mounted = match device {
        Some(device) => {
            // Its mount is the answer.
            background::notify();
            service::wait(&device, &*clock)?;
            let mounted = fuse::serve(tree, device, how, signal)?;
            end.reach(Phase::Serving(handles.clone(), mounted.answers()));
            mounted
        }
        None => {
            mountpoint::make(&mountpoint)?;
            let mounted = fuse::mount(tree, &mountpoint, how, signal)?;
            end.reach(Phase::Mounted(mountpoint.clone(), handles.clone()));
            mounted
        }
    };
    for (what, place) in &told {
        ::log::info!("{what} mounted at {place}");
    }
    if !options.foreground {
        background::ready(&inherited)?;
    } else if !options.service {
        background::notify();
    }
    mounted.wait();
    end.reach(Phase::Ending);
    finish(&handles);
    for (_, place) in &told {
        ::log::info!("{place} unmounted");
    }
    drop(locks);
    Ok(())
}

/// Where it is put down what a write is about to do, so that a power cut of the host leaves nothing half
/// done. What ends with this process has nothing to come back to, and a journal only on demand.
fn journal(folder: Option<&Path>, key: Option<String>, subject: &str) -> Result<Option<Journal>> {
    let key = match (key, folder) {
        (Some(key), _) => key,
        (None, Some(_)) => {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
            format!("sim-{}-{now}", std::process::id())
        }
        (None, None) => return Ok(None),
    };
    let folder = folder.map_or_else(state_dir, |path| Ok(path.to_path_buf()))?;
    // The daemon leaves this folder when it goes to the background.
    let folder = std::path::absolute(&folder)
        .map_err(|error| Error::io(folder.display().to_string(), "no such path", &error))?;
    Ok(Some(Journal::new(folder, key, subject.into())))
}

/// The system's folder for state, or the user's own. It is made when something is written to it.
fn state_dir() -> Result<PathBuf> {
    if geteuid().is_root() {
        return Ok(PathBuf::from("/var/lib/gaugefs"));
    }
    let named = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let account = || User::from_uid(geteuid()).ok().flatten().map(|user| user.dir);
    let home = || named("HOME").or_else(account).map(|home| home.join(".local/state"));
    match named("XDG_STATE_HOME").or_else(home) {
        Some(state) => Ok(state.join("gaugefs")),
        None => {
            let why = "this account has no folder for journals; name one";
            Err(Error::host("--state-dir", Errno::ENOENT, why))
        }
    }
}

/// The gauges with their names, in their order. Those that were given none get the first that are free.
pub fn named(gauges: Vec<Gauge>, taken: &[String]) -> Vec<(String, Gauge)> {
    let mut taken = taken.to_vec();
    taken.extend(gauges.iter().filter_map(|gauge| gauge.name.clone()));
    let name = |gauge: Gauge| {
        let name = gauge.name.clone().unwrap_or_else(|| {
            let free = free_name("BAT", &taken);
            taken.push(free.clone());
            free
        });
        (name, gauge)
    };
    gauges.into_iter().map(name).collect()
}

/// `AC`, unless another name was chosen or the kernel has one of that name.
fn mains_name(chosen: Option<String>, taken: &[String]) -> String {
    chosen.unwrap_or_else(|| {
        let usual = "AC".to_string();
        if taken.contains(&usual) { free_name(&usual, taken) } else { usual }
    })
}

fn saved(chip: &'static Chip, path: &Path) -> Result<Vec<Change>> {
    let image = Image::open(path, Some(chip))?;
    Ok(image.to_restore().map_err(|error| error.within(&path.display().to_string()))?)
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

/// Whether the part takes only one byte a write at that clock.
fn too_fast(chip: &Chip, clock_hz: Option<u32>) -> bool {
    chip.byte_writes_above_hz.zip(clock_hz).is_some_and(|(limit_hz, clock_hz)| clock_hz > limit_hz)
}

/// The files of `sim/`.
struct SimKnobs(Sim);

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
    fn open(&self, mountpoint: &Path, clock: &Arc<dyn Clock>, waits: bool) -> Result<Opened> {
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

impl Keyring {
    fn open(&self, gauge: &str) -> Result<Keys> {
        let mut keys = match &self.file {
            Some(path) => key_file::from_file(path, gauge)?,
            None => key_file::from_credential(gauge)?.unwrap_or_default(),
        };
        keys.no_default = self.no_default;
        Ok(keys)
    }
}

/// How far a mount has come, for the thread that takes signals.
#[derive(Default)]
enum Phase {
    /// Nothing but reads has passed.
    #[default]
    Starting,
    /// There is something to unmount.
    Mounted(PathBuf, Vec<Handle>),
    /// What there is to unmount, `service::detach` will.
    Serving(Vec<Handle>, fuse::Answers),
    /// It has been unmounted, and `run` is about to return.
    Ending,
}

/// How a mount ends from outside.
#[derive(Default)]
struct End(Mutex<Phase>);

impl End {
    fn reach(&self, phase: Phase) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = phase;
    }

    /// Waits for signals on a thread of its own.
    fn watch(self: Arc<Self>, signals: SigSet) -> Result<()> {
        let thread = std::thread::Builder::new().name("signals".into()).stack_size(128 * 1024);
        let watch = move || {
            while let Ok(signal) = signals.wait() {
                self.reached(signal);
            }
        };
        thread.spawn(watch).map(drop).map_err(|error| Error::io("signals", "cannot start a thread", &error))
    }

    fn reached(&self, signal: Unix) {
        let mut phase = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (path, handles) = match &*phase {
            Phase::Starting => {
                eprintln!("gaugefs: {signal}: ended before the gauge was mounted");
                std::process::exit(1);
            }
            Phase::Mounted(path, handles) => (path, handles),
            Phase::Serving(handles, answers) => {
                ::log::info!("{signal}: ending");
                finish(handles);
                answers.flush();
                std::process::exit(0);
            }
            Phase::Ending => return,
        };
        ::log::info!("{signal}: unmounting {}", path.display());
        match mountpoint::detach(path, false) {
            // The session ends, and `run` with it.
            Ok(()) => *phase = Phase::Ending,
            Err(error) if error.errno() == Errno::EBUSY => {
                ::log::warn!("{}: in use, so it is detached", path.display());
                let detached = mountpoint::detach(path, true);
                finish(handles);
                std::process::exit(i32::from(detached.is_err()));
            }
            Err(error) => ::log::error!("{error}"),
        }
    }
}

/// Waits until the gauges' owners have finished what was asked of them: a transaction is not cut short, and
/// none is begun any more.
fn finish(handles: &[Handle]) {
    let (done, is_done) = mpsc::channel::<()>();
    for handle in handles {
        let done = done.clone();
        // Requests are served in their order, and this one changes nothing.
        let same = handle.published().interval;
        let stop = move |_| {
            drop(done);
            loop {
                std::thread::park();
            }
        };
        handle.submit(Request::Interval(same, Box::new(stop)));
    }
    drop(done);
    // Nobody sends: each owner drops its end with the request, whether it serves it or has ended.
    let _ = is_done.recv();
}
