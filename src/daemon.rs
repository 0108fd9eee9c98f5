//! The life of a mount: open the gauges, poll each once, mount, say so, wait for the end, unmount.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use nix::unistd::{getegid, geteuid};

use crate::authentication::Order;
use crate::clock::{Clock, RealClock};
use crate::dataflash::Limits;
use crate::error::{Cause, Error, Result};
use crate::fs::{Access, Covered, Fs, Scales, free_name};
use crate::fuse;
use crate::poll::{Handle, Signal};

mod adapters;
pub mod background;
mod gauges;
mod journal_dir;
pub mod log;
pub mod mountpoint;
pub mod node;
pub mod service;
mod shutdown;
mod source;

use gauges::{Opening, Ready};
use shutdown::{Phase, Shutdown, finish};
pub use source::Source;

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

/// Mounts gauges and serves them until they are unmounted.
pub fn run(options: Options) -> Result<()> {
    let inherited = background::inherited();
    let shutdown = Shutdown::watch()?;
    self::log::start(match &options.log {
        Some(path) => self::log::Destination::File(path),
        None if options.foreground => self::log::Destination::Stderr,
        None => self::log::Destination::Syslog,
    })?;

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
    let tree = Arc::new(Fs::new(entries, access).with_mains(mains).over(covered));
    let how = fuse::Options { private: options.private, read_only: options.read_only };
    let mounted = match device {
        Some(device) => {
            // Its mount is the answer.
            background::notify();
            service::wait(&device, &*clock)?;
            let mounted = fuse::serve(tree, device, how, signal)?;
            shutdown.reach(Phase::Serving(handles.clone(), mounted.answers()));
            mounted
        }
        None => {
            mountpoint::make(&mountpoint)?;
            let mounted = fuse::mount(tree, &mountpoint, how, signal)?;
            shutdown.reach(Phase::Mounted(mountpoint.clone(), handles.clone()));
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
    shutdown.reach(Phase::Ending);
    finish(&handles);
    for (_, place) in &told {
        ::log::info!("{place} unmounted");
    }
    drop(locks);
    Ok(())
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
