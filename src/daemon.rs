//! The life of a mount: open the gauge, poll it once, mount, say so, wait for the end, unmount.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use nix::errno::Errno;
use nix::sys::signal::{SigSet, Signal as Unix};
use nix::unistd::{User, getegid, geteuid};

use crate::authentication::Order;
use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::replay::{Recording, Replay, Seals};
use crate::bus::trace::Trace;
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::{Chip, SealStatus, Tier};
use crate::clock::{Clock, RealClock};
use crate::dataflash::{Change, Limits};
use crate::error::{Cause, Error, Result};
use crate::fs::{Access, Covered, Entry, Fs, Knobs, Scales, free_name};
use crate::fuse;
use crate::gauge::bursts;
use crate::journal::Journal;
use crate::keys::Keys;
use crate::lock::{self, Holder, Lock};
use crate::poll::{self, Handle, Request, Settings, Signal};
use crate::probe;
use crate::saved;
use crate::sim::{self, Sim};

pub mod background;
pub mod log;
pub mod mountpoint;

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

/// Everything that `gaugefs mount` can be told.
#[derive(Debug)]
pub struct Options {
    /// Folder to mount at.
    pub mountpoint: PathBuf,
    /// The gauge.
    pub source: Source,
    /// Write one byte a transfer.
    pub byte_writes: bool,
    /// Name of the gauge's folder.
    pub name: Option<String>,
    /// Show a Mains supply too, of this name where one was chosen.
    pub ac: Option<Option<String>>,
    /// Time between polls.
    pub interval: Duration,
    /// How figures are shown.
    pub scales: Scales,
    /// Refuse every write.
    pub read_only: bool,
    /// Write parameters too whose address or range is not sure.
    pub allow_unproven: bool,
    /// What else may be overruled, and how often flash may be programmed.
    pub limits: Limits,
    /// The order of bytes in which challenges are sent.
    pub auth_order: Order,
    /// A copy of `df/index`, for gauges that lose their configuration with their power.
    pub restore: Option<PathBuf>,
    /// Shut other users out.
    pub private: bool,
    /// Group that may read and write data flash.
    pub group: Option<u32>,
    /// Where the keys come from.
    pub keyring: Keyring,
    /// Stay in the foreground.
    pub foreground: bool,
    /// File to log to.
    pub log: Option<PathBuf>,
    /// File to write transfers to.
    pub trace: Option<PathBuf>,
    /// Folder for journals; without one, the system's or the user's own.
    pub state_dir: Option<PathBuf>,
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
}

/// Mounts a gauge and serves it until it is unmounted.
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

    let mountpoint = mountpoint::prepare(&options.mountpoint)?;
    let keys = options.keyring.open()?;
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let Opened { chip, mut bus, clock_hz, address, subject, sim, lock, key } =
        options.source.open(&mountpoint, &clock)?;
    if let Some(path) = &options.trace {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let head = format!("{} on {subject}, {}", chip.name, self::log::utc(now));
        bus = Box::new(Trace::new(bus, address, path, clock.clone(), &head)?);
    }
    let settings = Settings {
        keys,
        interval: options.interval,
        byte_writes: options.byte_writes || too_fast(chip, clock_hz),
        allow_unproven: options.allow_unproven,
        limits: options.limits,
        auth_order: options.auth_order,
        restore: options.restore.as_deref().map_or(Ok(Vec::new()), |path| saved(chip, path))?,
        journal: if options.read_only { None } else { journal(options.state_dir.as_deref(), key, &subject)? },
    };
    let signal = Arc::new(Signal::default());
    let handle =
        poll::spawn(chip, bus, clock, settings, signal.clone()).map_err(|error| error.within(&subject))?;

    let covered = mountpoint::covered(&mountpoint)?;
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let entry = Entry {
        name: options.name.unwrap_or_else(|| free_name("BAT", &taken)),
        handle: handle.clone(),
        scales: options.scales,
        knobs: sim.map(|sim| Box::new(SimKnobs(sim)) as Box<dyn Knobs>),
    };
    let mains = options.ac.map(|name| mains_name(name, &taken));
    if mains.as_ref() == Some(&entry.name) {
        let why = "a gauge and the Mains supply cannot share a name; choose another --name or --ac";
        return Err(Error::new(entry.name, Cause::Invalid(why.into())));
    }
    let place = format!("{}/{}", mountpoint.display(), entry.name);
    let access = Access {
        uid: geteuid().as_raw(),
        gid: options.group.unwrap_or_else(|| getegid().as_raw()),
        group: options.group.is_some(),
    };
    mountpoint::make(&mountpoint)?;
    let how = fuse::Options { private: options.private, read_only: options.read_only };
    let fs = Arc::new(Fs::new(vec![entry], access).with_mains(mains).over(covered));
    let mounted = fuse::mount(fs, &mountpoint, how, signal)?;
    end.mounted(&mountpoint, &handle);
    ::log::info!("{} ({subject}) mounted at {place}", chip.model);
    if options.foreground {
        background::notify();
    } else {
        background::ready(&inherited)?;
    }
    mounted.wait();
    end.over();
    finish(&handle);
    ::log::info!("{place} unmounted");
    drop(lock);
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

/// `AC`, unless another name was chosen or the kernel has one of that name.
fn mains_name(chosen: Option<String>, taken: &[String]) -> String {
    chosen.unwrap_or_else(|| {
        let usual = "AC".to_string();
        if taken.contains(&usual) { free_name(&usual, taken) } else { usual }
    })
}

fn saved(chip: &'static Chip, path: &Path) -> Result<Vec<Change>> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
    saved::parse(chip, &text).map_err(|error| error.within(&name))
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

impl Source {
    fn open(&self, mountpoint: &Path, clock: &Arc<dyn Clock>) -> Result<Opened> {
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
                let subject = match state {
                    Some(state) => format!("simulated gauge kept in {}", state.display()),
                    None => "simulated gauge".into(),
                };
                let bus = Box::new(bus);
                Ok(Opened {
                    chip,
                    bus,
                    clock_hz: None,
                    address: GAUGE_ADDRESS,
                    subject,
                    sim: Some(sim),
                    lock,
                    key,
                })
            }
            Self::Recorded(path) => {
                let (chip, replay) = recorded(path)?;
                Ok(Opened {
                    chip,
                    bus: Box::new(replay),
                    clock_hz: None,
                    address: GAUGE_ADDRESS,
                    subject: format!("recording {}", path.display()),
                    sim: None,
                    lock: None,
                    key: None,
                })
            }
            Self::Bus { bus, address, chip } => {
                let adapter = Adapter::find(bus)?;
                let lock = Lock::gauge(&adapter, *address, mountpoint, &**clock, ending)?;
                let subject = format!("{adapter} address 0x{address:02x}");
                let open = || {
                    let bus = LinuxBus::open(adapter.clone(), *address, clock.clone())?;
                    Ok(Box::new(bus) as Box<dyn Bus>)
                };
                let chip = probe::find(&subject, *chip, &open, clock)?;
                let clock_hz = adapter.clock_hz();
                let key = Some(lock::key_of_gauge(&adapter, *address));
                Ok(Opened {
                    chip,
                    bus: open()?,
                    clock_hz,
                    address: *address,
                    subject,
                    sim: None,
                    lock: Some(lock),
                    key,
                })
            }
        }
    }
}

impl Keyring {
    fn open(&self) -> Result<Keys> {
        let mut keys = match &self.file {
            Some(path) => Keys::from_file(path)?,
            None => Keys::from_credential()?.unwrap_or_default(),
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
    Mounted(PathBuf, Handle),
    /// It has been unmounted, and `run` is about to return.
    Ending,
}

/// How a mount ends from outside.
#[derive(Default)]
struct End(Mutex<Phase>);

impl End {
    fn mounted(&self, path: &Path, handle: &Handle) {
        let mut phase = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *phase = Phase::Mounted(path.to_path_buf(), handle.clone());
    }

    fn over(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Phase::Ending;
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
        let (path, handle) = match &*phase {
            Phase::Starting => {
                eprintln!("gaugefs: {signal}: ended before the gauge was mounted");
                std::process::exit(1);
            }
            Phase::Mounted(path, handle) => (path, handle),
            Phase::Ending => return,
        };
        ::log::info!("{signal}: unmounting {}", path.display());
        match mountpoint::detach(path, false) {
            // The session ends, and `run` with it.
            Ok(()) => *phase = Phase::Ending,
            Err(error) if error.errno() == Errno::EBUSY => {
                ::log::warn!("{}: in use, so it is detached", path.display());
                let detached = mountpoint::detach(path, true);
                finish(handle);
                std::process::exit(i32::from(detached.is_err()));
            }
            Err(error) => ::log::error!("{error}"),
        }
    }
}

/// Waits until the gauge's owner has finished what was asked of it: a transaction is not cut short.
fn finish(handle: &Handle) {
    let (done, is_done) = mpsc::channel();
    // Requests are served in their order, and this one changes nothing.
    let same = handle.published().interval;
    handle.submit(Request::Interval(
        same,
        Box::new(move |_| {
            let _ = done.send(());
        }),
    ));
    // An owner that has ended drops the request, and with it the sender.
    let _ = is_done.recv();
}
