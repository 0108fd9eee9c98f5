// SPDX-License-Identifier: MIT

//! The life of a mount: open the gauges, poll each once, mount, report, wait for the end, unmount.

use std::collections::HashMap;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nix::unistd::{getegid, geteuid};

use crate::config::{MountOptions, Setup};
use crate::error::{Cause, Error, Result};
use crate::fs::{Access, Covered, Fs, Knobs, Scales, Supply, free_names};
use crate::fuse;
use crate::output::say;
use gauge_bus::clock::{Clock, HurriedClock, RealClock};
use gauge_owner::lock::Lock;
use gauge_owner::{GaugeOptions, Handle, Opening, Ready, Signal};

mod adapters;
pub mod background;
pub(crate) mod knobs;
pub mod log;
pub(crate) mod look;
pub mod mountpoint;
pub(crate) mod node;
pub(crate) mod preflight;
mod report;
pub mod service;
mod shutdown;

use knobs::SimKnobs;
use mountpoint::Hiding;
pub(crate) use report::report;
use shutdown::{Phase, Shutdown, finish};

/// How the daemon of a mount runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// A child without a terminal, whose parent waits until the mount is ready.
    Background,
    /// The process that the user started.
    Foreground,
    /// A systemd service without privilege, for which `service::attach` mounts.
    Service,
}

/// Mounts gauges and serves them until they are unmounted.
pub(crate) fn run(setup: Setup, mode: Mode) -> Result<()> {
    let inherited = background::inherited();
    let shutdown = Shutdown::watch()?;
    self::log::start(mode.destination(&setup.mount))?;
    let warn = |line: &str| mode.warn(line);
    let (mountpoint, device) = match mode {
        Mode::Service => (setup.mountpoint().to_path_buf(), Some(service::device()?)),
        Mode::Background | Mode::Foreground => {
            let hiding = Hiding::by(&setup.mount, false, &warn);
            (mountpoint::prepare(setup.mountpoint(), &hiding)?, None)
        }
    };
    let covered = mountpoint::covered(&mountpoint)?;
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let names = names(&setup.gauges, &taken);
    if let Some(first) =
        preflight::mount(&setup, &names, covered.as_ref(), mode == Mode::Service).into_iter().next()
    {
        return Err(first);
    }
    let Setup { mount, gauges, configured, .. } = setup;
    let mains = mains_name(&mount, &names, &taken)?;

    let signal = Arc::new(Signal::default());
    let opening = opening(&mount, mountpoint.clone(), signal.clone());
    let clock = opening.clock.clone();
    let open = || Gauges::open(&opening, names.clone(), &gauges, configured, &warn);
    let opened = if mode == Mode::Service { service::open(&*clock, open)? } else { open()? };
    let Gauges { entries, handles, nodes, batteries, locks, places } = opened;
    entries.iter().flat_map(Supply::warnings).for_each(|line| warn(&line));
    adapters::watch(nodes.into_iter());
    let tree = Arc::new(Fs::new(entries, mode.access(&mount)).with_mains(mains).overlay(covered));
    let offer = (!batteries.is_empty()).then(node::Offer::new).transpose()?;
    let batteries = offer.as_ref().map(|offer| offer.serve(&tree, &signal, batteries)).transpose()?;
    if let Some(offer) = offer.as_ref().filter(|_| mode != Mode::Service) {
        offer.plug()?;
    }
    let served = Served { tree, how: how(&mount), signal, handles: &handles };
    let mounted = match device {
        Some(device) => served.through(device, &*clock, &shutdown)?,
        None => served.mount(&mountpoint, &shutdown)?,
    };
    for (what, name) in &places {
        ::log::info!("{what} mounted at {}/{name}", mountpoint.display());
    }
    match mode {
        Mode::Background => background::ready(&inherited)?,
        Mode::Foreground => background::notify("READY=1"),
        Mode::Service => {}
    }
    mounted.wait();
    if let Some(batteries) = batteries {
        batteries.end();
    }
    shutdown.reach(Phase::Ending);
    mountpoint::unmake();
    let ended = finish(&handles);
    for (_, name) in &places {
        ::log::info!("{}/{name} unmounted", mountpoint.display());
    }
    ::log::logger().flush();
    drop(locks);
    ended
}

impl Mode {
    /// Where the log goes.
    fn destination(self, mount: &MountOptions) -> self::log::Destination<'_> {
        match &mount.log {
            Some(path) => self::log::Destination::File(path),
            None if self == Self::Background => self::log::Destination::Syslog,
            None => self::log::Destination::Stderr,
        }
    }

    /// Puts a warning into the log, and onto the terminal that waits for the mount.
    fn warn(self, line: &str) {
        ::log::warn!("{line}");
        if self == Self::Background {
            say(format_args!("warning: {line}"));
        }
    }

    /// Who owns the files. Root's mount belongs to root, also if a service's account serves it.
    fn access(self, mount: &MountOptions) -> Access {
        let (uid, gid) = match self {
            Self::Service => (0, 0),
            Self::Background | Self::Foreground => (geteuid().as_raw(), getegid().as_raw()),
        };
        Access { uid, gid: mount.group.unwrap_or(gid), group: mount.group.is_some() }
    }
}

/// How the gauges of a mount are opened.
fn opening(mount: &MountOptions, mountpoint: PathBuf, signal: Arc<Signal>) -> Opening {
    let clock: Arc<dyn Clock> =
        if mount.fast { Arc::new(HurriedClock::default()) } else { Arc::new(RealClock::new()) };
    Opening {
        signal,
        read_only: mount.read_only,
        no_backup: mount.no_backup,
        state_dir: mount.state_dir.clone(),
        ..Opening::new(mountpoint, clock)
    }
}

/// How the kernel mounts it.
fn how(mount: &MountOptions) -> fuse::Options {
    fuse::Options {
        private: mount.private,
        shared: mount.group.is_some(),
        read_only: mount.read_only,
        ..Default::default()
    }
}

/// A tree that is ready to be served, and its gauges.
struct Served<'a> {
    tree: Arc<Fs>,
    how: fuse::Options,
    signal: Arc<Signal>,
    handles: &'a [Handle],
}

impl Served<'_> {
    /// Serves the mount that `service::attach` makes of the device.
    fn through(self, device: OwnedFd, clock: &dyn Clock, shutdown: &Shutdown) -> Result<fuse::Mounted> {
        // Its mount confirms it.
        background::notify("READY=1");
        service::wait(&device, clock)?;
        shutdown.mount(|| {
            let mounted = fuse::serve(self.tree, device, self.how, self.signal)?;
            let phase = Phase::Serving(self.handles.to_vec(), mounted.announcer());
            Ok((mounted, phase))
        })
    }

    /// Mounts it.
    fn mount(self, mountpoint: &Path, shutdown: &Shutdown) -> Result<fuse::Mounted> {
        fuse::needs::device()?;
        let mount = || fuse::mount(self.tree.clone(), mountpoint, self.how, self.signal.clone());
        shutdown.mount(|| {
            let mounted = mountpoint::make_and_mount(mountpoint, mount)?;
            let phase = Phase::Mounted(mountpoint.into(), self.handles.to_vec(), mounted.announcer());
            Ok((mounted, phase))
        })
    }
}

/// The gauges of a mount, opened and polled once. All lists have their order.
#[derive(Default)]
struct Gauges {
    entries: Vec<Supply>,
    handles: Vec<Handle>,
    /// Nodes of adapters, and the gauges that go with them.
    nodes: Vec<(PathBuf, Handle)>,
    /// Gauges that are also batteries of the kernel.
    batteries: Vec<node::Wanted>,
    /// Locks that keep other processes out.
    locks: Vec<Option<Lock>>,
    /// Each gauge's description, and the name of its folder.
    places: Vec<(String, String)>,
}

impl Gauges {
    /// From a configuration file, gauges without an answer are skipped.
    fn open(
        opening: &Opening,
        names: Vec<String>,
        options: &[GaugeOptions],
        configured: bool,
        warn: &dyn Fn(&str),
    ) -> Result<Self> {
        let options_of: HashMap<String, &GaugeOptions> = names.iter().cloned().zip(options).collect();
        let named = names.into_iter().zip(options.iter().cloned());
        let ready: Vec<Ready> = if configured {
            let (gauges, lines) = opening.many(named.collect())?;
            lines.iter().for_each(|line| warn(line));
            gauges
        } else {
            named.map(|(name, gauge)| opening.one(name, &gauge)).collect::<Result<_>>()?
        };
        let mut all = Self::default();
        for (gauge, ready) in (0..).zip(ready) {
            let options = options_of[&ready.name];
            all.add(gauge, ready, options)?;
        }
        Ok(all)
    }

    fn add(&mut self, gauge: u16, ready: Ready, options: &GaugeOptions) -> Result<()> {
        let Ready { name, handle, sim, what, lock, node } = ready;
        if node::is_wanted(options) {
            node::check_chip(&name, handle.chip())?;
            let interval = handle.published().interval;
            self.batteries.push(node::Wanted { gauge, name: name.clone(), interval });
        }
        self.nodes.extend(node.map(|node| (node, handle.clone())));
        self.places.push((what, name.clone()));
        self.handles.push(handle.clone());
        let knobs = sim.map(|sim| Box::new(SimKnobs(sim)) as Box<dyn Knobs>);
        self.entries.push(Supply::new(name, handle).with_scales(Scales::wanted(options)).with_knobs(knobs));
        self.locks.push(lock);
        Ok(())
    }
}

/// Names of the gauges' folders. Gauges without a name get the first free ones of BAT0, BAT1 ...
pub(crate) fn names(gauges: &[GaugeOptions], taken: &[String]) -> Vec<String> {
    let given = gauges.iter().filter_map(|gauge| gauge.name.as_deref());
    let taken = taken.iter().map(String::as_str).chain(given).collect();
    let mut free = free_names("BAT", &taken);
    let mut name = |gauge: &GaugeOptions| gauge.name.clone().or_else(|| free.next());
    gauges.iter().filter_map(&mut name).collect()
}

/// The name of the Mains supply, if there is one: as given, otherwise `AC` or the first like it that the kernel does
/// not have.
fn mains_name(mount: &MountOptions, gauges: &[String], taken: &[String]) -> Result<Option<String>> {
    let Some(given) = &mount.ac else { return Ok(None) };
    let usual = "AC".to_string();
    let name = match given {
        Some(name) => name.clone(),
        None if taken.contains(&usual) => {
            let taken = taken.iter().map(String::as_str).collect();
            free_names(&usual, &taken).next().expect("numbers do not run out")
        }
        None => usual,
    };
    if gauges.contains(&name) {
        let why = "a gauge and the Mains supply cannot share a name; choose another --name or --ac";
        return Err(Error::new(name, Cause::Invalid, why));
    }
    Ok(Some(name))
}
