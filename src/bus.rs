// SPDX-License-Identifier: MIT

//! `gaugefs sim`: simulated gauges as an I2C bus for any program.
//!
//! The crate `i2c-server` answers the calls, and the simulated gauges are its targets. Calls come through a FUSE file
//! ([`file`]) at a path, or in the `/dev` of a command ([`namespace`]), without privilege; through a device of
//! [`cuse`]; or from the kernel, through an adapter plugged into it ([`device`]). Arguments of a call are in the
//! calling program's memory ([`caller`]).

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use i2c_server::{Adapter, Errno, Manner, Target};
use nix::sys::signal::{SigSet, Signal, kill};
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::{Pid, geteuid};

use crate::daemon::{mountpoint, service};
use crate::error::{Cause, Error, Result};
use crate::fuse::single;
use crate::output::{print, say};
use gauge_bus::adapters::{AdapterModel, Failure};
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::{Bus, BusError, GAUGE_ADDRESS, regular};
use gauge_owner::lock::Lock;
use gauge_owner::{Opened, Source};
use gauge_sim::{Sim, SimBus};
use gaugefs_client::mounts;
use ti_gauge::probe::ROM_ADDRESS;

mod caller;
mod cuse;
mod device;
mod file;
mod namespace;
mod panel;
mod rights;

pub(crate) use cuse::Cuse;
pub(crate) use device::Vhci;
use file::Access;
pub(crate) use namespace::become_command;
pub(crate) use panel::{Panel, RootPanel, end};

/// Source of the mount in mountinfo.
const SOURCE: &str = "gaugefs-sim";

pub(crate) struct Gauge {
    pub(crate) name: String,
    /// 7-bit.
    pub(crate) address: u8,
    sim: Option<Sim>,
    bus: Box<dyn Bus>,
    _lock: Option<Lock>,
}

impl Gauge {
    /// Opens a simulated or recorded gauge for this address.
    pub(crate) fn open(source: &Source, address: u8, clock: &Arc<dyn Clock>) -> Result<Self> {
        // It is mounted nowhere.
        let Opened { chip, bus, sim, lock, .. } = source.open(Path::new(""), clock, false)?;
        Ok(Self { name: chip.name.into(), address, sim, bus, _lock: lock })
    }
}

struct Wired<B> {
    bus: B,
    _lock: Option<Lock>,
}

impl Target for Wired<Box<dyn Bus>> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
        self.bus.transfer(write, read).map_err(errno)
    }
}

impl Target for Wired<SimBus> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
        self.bus.call(write, read).map_err(errno)
    }
}

fn errno(error: BusError) -> Errno {
    match error {
        // What is not recorded is not acknowledged, nor is what was not sent.
        BusError::NoAck | BusError::ReadOnly | BusError::NotRecorded | BusError::WriteDisabled => Errno::NXIO,
        BusError::ArbitrationLost => Errno::AGAIN,
        BusError::Timeout | BusError::Hung(_) | BusError::TooSlow { .. } => Errno::TIMEDOUT,
        BusError::Gone => Errno::NODEV,
        BusError::Busy | BusError::HasMux => Errno::BUSY,
        BusError::Short | BusError::Unsteady => Errno::IO,
        BusError::Pec => Errno::BADMSG,
        BusError::TooLong { .. } => Errno::OPNOTSUPP,
        BusError::Other(number) | BusError::MaybeNoAck(number) => Errno::from_raw_os_error(number),
    }
}

/// A bus with these gauges on an adapter of that model, whose transfers take the time of this clock, or no time.
pub(crate) fn adapter(
    gauges: Vec<Gauge>,
    model: Option<&'static AdapterModel>,
    hertz: Option<u32>,
) -> Result<Adapter> {
    let mut taken = BTreeSet::new();
    if let Some(twice) = gauges.iter().find(|gauge| !taken.insert(gauge.address)) {
        let why = format!(
            "another gauge is at address 0x{:02x} already; give each its own: {}@0x{:02x}",
            twice.address,
            twice.name,
            (0x08..0x78).rev().find(|free| !taken.contains(free)).unwrap_or(GAUGE_ADDRESS)
        );
        return Err(Error::new(&twice.name, Cause::Invalid, why));
    }
    let mut adapter = Adapter::new();
    if let Some(hertz) = hertz {
        let clock = RealClock::new();
        adapter = adapter.paced(hertz, move |time| clock.sleep(time));
    }
    if let Some(model) = model {
        adapter = adapter.in_manner(Manner {
            functions: model.functions.into(),
            nobody: Errno::from_raw_os_error(model.errno(Failure::Address)),
            is_pair: model.is_pair,
        });
    }
    for Gauge { address, sim, bus, _lock: lock, .. } in gauges {
        if let (Some(model), Some(sim)) = (model, &sim) {
            sim.set_adapter(model, hertz.is_some());
        }
        adapter = match &sim {
            Some(sim) => adapter.with(address, Wired { bus: sim.bus(), _lock: lock }),
            None => adapter.with(address, Wired { bus, _lock: lock }),
        };
        // A gauge's boot loader has an address of its own.
        if let Some(sim) = sim.filter(|_| address == GAUGE_ADDRESS && !taken.contains(&ROM_ADDRESS)) {
            adapter = adapter.with(ROM_ADDRESS, Wired { bus: sim.bus_at(ROM_ADDRESS), _lock: None });
        }
    }
    Ok(adapter)
}

fn setting(name: &str) -> Option<String> {
    let text = regular::read_text(&Path::new("/proc/sys").join(name), regular::SYSTEM).ok()?;
    Some(text.trim().to_string())
}

/// Why the memory of programs cannot be read, and what works nevertheless. A command in a user namespace of this
/// process is readable whatever Yama says, unless Yama forbids it to all.
fn unreadable(is_command: bool, has_namespace: bool) -> Option<String> {
    let scope = setting("kernel/yama/ptrace_scope")?;
    let remains = match (&*scope, is_command) {
        ("0", _) => return None,
        ("1" | "2", _) if geteuid().is_root() || has_namespace => return None,
        ("1", true) => return None,
        ("1", false) => {
            "only plain reads and writes, and I2C_SLAVE, work for programs that are started elsewhere; run the program \
             by gaugefs: gaugefs sim CHIP -- COMMAND"
        }
        ("2", _) => {
            "only plain reads and writes, and I2C_SLAVE, work; run gaugefs as root, or a command without a PATH: gaugefs \
             sim CHIP -- COMMAND"
        }
        _ => {
            "only plain reads and writes, and I2C_SLAVE, work until the machine is started with a lower value"
        }
    };
    Some(format!(
        "Yama restricts reading the memory of other programs (kernel.yama.ptrace_scope is {scope}): {remains}"
    ))
}

/// A file or folder to mount at, removed at the end if it was made for that.
struct Place {
    path: PathBuf,
    is_made: bool,
}

impl Place {
    /// Provides an empty file or folder with nothing mounted on it.
    fn prepare(path: &Path, is_folder: bool) -> Result<Self> {
        let subject = path.display().to_string();
        let failed = |error: &io::Error| Error::io(&subject, "cannot be made", error);
        let mut path = std::path::absolute(path).map_err(|error| failed(&error))?;
        // A killed server may have left its mount.
        while fs::metadata(&path).is_err_and(|error| error.raw_os_error() == Some(nix::libc::ENOTCONN)) {
            mountpoint::detach(&path, true)?;
        }
        if let Some(whole) = path.parent().and_then(|folder| folder.canonicalize().ok()).zip(path.file_name())
        {
            path = whole.0.join(whole.1);
        }
        mountpoint::keeps_its_mount(&path)?;
        let all = mounts::all().map_err(|error| failed(&error))?;
        if mounts::topmost(all, &path).is_some() {
            return Err(Error::new(subject, Cause::Busy, "something is mounted there; choose another path"));
        }
        let made = match is_folder {
            true => fs::create_dir(&path),
            false => File::options().write(true).create_new(true).mode(0o600).open(&path).map(drop),
        };
        let is_made = made.is_ok();
        match (made, fs::symlink_metadata(&path)) {
            (Ok(()), _) => {}
            (Err(error), Ok(status)) if error.kind() == ErrorKind::AlreadyExists => {
                let is_empty = match is_folder {
                    true => fs::read_dir(&path).is_ok_and(|mut entries| entries.next().is_none()),
                    false => status.is_file() && status.len() == 0,
                };
                if !is_empty {
                    let what = if is_folder { "folder" } else { "file" };
                    let why = format!("not an empty {what}; choose a path that does not exist");
                    return Err(Error::host(subject, nix::errno::Errno::EEXIST, why));
                }
            }
            (Err(error), _) => return Err(failed(&error)),
        }
        Ok(Self { path, is_made })
    }

    /// Unmounts it, even while programs have it open.
    fn remove(&self) -> Result<()> {
        let all = mounts::all().unwrap_or_default();
        let is_there = mounts::topmost(all, &self.path).is_some_and(|mount| mount.source == SOURCE);
        let outcome = if is_there { mountpoint::detach(&self.path, true) } else { Ok(()) };
        if self.is_made {
            // It is empty.
            let _ = fs::remove_file(&self.path).or_else(|_| fs::remove_dir(&self.path));
        }
        outcome
    }

    /// Mounts at it, and removes it if that fails.
    fn mount<T>(&self, mount: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
        mount(&self.path).inspect_err(|_| drop(self.remove()))
    }
}

/// Serves the bus at a path until it is unmounted, or a signal ends it.
pub(crate) fn at(
    path: &Path,
    adapter: Adapter,
    panel: Option<Panel>,
    signals: SigSet,
    what: &str,
) -> Result<ExitCode> {
    if let Some(why) = unreadable(false, false) {
        say(format_args!("warning: {why}"));
    }
    let place = Arc::new(Place::prepare(path, false)?);
    let device = place.mount(|path| single::mount(path, SOURCE))?;
    let panel = Arc::new(Mutex::new(panel));
    let (ending, closing) = (Arc::clone(&place), Arc::clone(&panel));
    spawn("signals", move || {
        while signals.wait().is_ok() {
            drop(closing.lock().unwrap_or_else(PoisonError::into_inner).take());
            match ending.remove() {
                Ok(()) => std::process::exit(0),
                Err(error) => say(error),
            }
        }
    })?;
    print(&format!("{what} at {}\n", place.path.display())).inspect_err(|_| drop(place.remove()))?;
    file::serve(device, &Arc::new(adapter), Access::Direct)?;
    drop(panel.lock().unwrap_or_else(PoisonError::into_inner).take());
    place.remove().map(|()| ExitCode::SUCCESS)
}

/// Runs a command with the bus, at a path or in a `/dev` of its own, and ends with the command's exit code.
pub(crate) fn with_command(
    path: Option<&Path>,
    adapter: Adapter,
    signals: SigSet,
    command: &[OsString],
) -> Result<ExitCode> {
    if path.is_none() {
        namespace::check_ptrace()?;
    }
    if let Some(why) = unreadable(true, path.is_none()) {
        say(format_args!("warning: {why}"));
    }
    let adapter = Arc::new(adapter);
    let place = path.map(|path| Place::prepare(path, false)).transpose()?;
    // The file of this program, even if another one has its name by now.
    let mut inside = Command::new("/proc/self/exe");
    inside.arg("sim-inside");
    let device = match &place {
        Some(place) => {
            inside.env("I2C_DEV", &place.path).env_remove("I2C_BUS");
            Some(place.mount(|path| single::mount(path, SOURCE))?)
        }
        None => {
            let number = namespace::number().to_string();
            inside
                .env("I2C_DEV", namespace::node(&number))
                .env("I2C_BUS", &number)
                .args(["--number", &number]);
            None
        }
    };
    let child = match inside.arg("--").args(command).spawn() {
        Ok(child) => Pid::from_raw(child.id() as i32),
        Err(error) => {
            place.map_or(Ok(()), |place| place.remove())?;
            return Err(Error::io("the command", "cannot be started", &error));
        }
    };
    let device = match device {
        Some(device) => device,
        None => match wait(child, WaitPidFlag::WUNTRACED)? {
            None => {
                let device = service::device_of(child.as_raw());
                if device.is_err() {
                    let _ = kill(child, Signal::SIGKILL);
                }
                let device = device?;
                kill(child, Signal::SIGCONT)
                    .map_err(|errno| Error::io("the command", "cannot start", &errno.into()))?;
                device
            }
            Some(code) => return Ok(ExitCode::from(code)),
        },
    };
    spawn("bus", move || {
        if let Err(error) = file::serve(device, &adapter, Access::Direct) {
            say(error);
        }
    })?;
    spawn("signals", move || {
        while let Ok(signal) = signals.wait() {
            // The terminal also sends SIGINT to the command.
            if signal != Signal::SIGINT {
                let _ = kill(child, signal);
            }
        }
    })?;
    let code = wait(child, WaitPidFlag::empty())?.unwrap_or(1);
    place.map_or(Ok(()), |place| place.remove())?;
    Ok(ExitCode::from(code))
}

/// Waits for a child: its exit code, or 128 plus the number of the signal that ended it, or `None` if it has stopped.
fn wait(child: Pid, how: WaitPidFlag) -> Result<Option<u8>> {
    loop {
        match waitpid(child, Some(how)) {
            Ok(WaitStatus::Exited(_, code)) => return Ok(Some(code as u8)),
            Ok(WaitStatus::Signaled(_, signal, _)) => return Ok(Some(128 + signal as u8)),
            Ok(WaitStatus::Stopped(..)) => return Ok(None),
            Ok(_) | Err(nix::errno::Errno::EINTR) => {}
            Err(errno) => return Err(Error::io("the command", "cannot be waited for", &errno.into())),
        }
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<()> {
    let thread = thread::Builder::new().name(name.into()).stack_size(256 * 1024).spawn(work);
    thread.map(drop).map_err(|error| Error::io(name, "cannot start a thread", &error))
}
