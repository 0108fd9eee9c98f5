// SPDX-License-Identifier: MIT

//! Where a gauge is, simulated, in a recording or on a bus, and how it is opened there.

use std::fmt;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use nix::errno::Errno;

use crate::error::{Cause, Error, Result, Step};
use crate::lock::{self, Lock};
use crate::options::GaugeOptions;
use gauge_bus::clock::Clock;
use gauge_bus::error::ErrorKind;
use gauge_bus::linux::{Adapter, LinuxBus};
use gauge_bus::replay::{Recording, Replay};
use gauge_bus::{AdapterModel, Bus, BusError, GAUGE_ADDRESS, Reach};
use gauge_sim::scenario::Scenario;
use gauge_sim::{self, Level, Sim, SimBus};
use gaugefs_client::mounts;
use ti_gauge::chip::{self, Chip, Role, Tier};
use ti_gauge::gauge::{Gauge, reads};
use ti_gauge::keys::Keys;
use ti_gauge::probe::{self, ROM_ADDRESS, Target};
use ti_gauge::registers::Registers;
use ti_gauge::rom::{self, Device};

/// Longest time from the power-up of a simulated gauge to its first answer.
const POWER_UP: Duration = Duration::from_secs(2);

/// A scenario that a simulated gauge plays.
#[derive(Clone, Debug)]
pub struct Script {
    /// Its name, or its file: a path with a slash.
    pub name: PathBuf,
    /// Another seed than the file's.
    pub seed: Option<u64>,
}

impl Script {
    fn read(&self) -> Result<Scenario> {
        Scenario::read(&self.name, self.seed).map_err(Error::from)
    }

    fn play(&self, sim: &Sim) -> Result<()> {
        let name = self.name.display().to_string();
        sim.play(self.read()?).map_err(|error| Error::from(error).within(&name))
    }
}

/// Where a gauge is.
#[derive(Clone)]
pub enum Source {
    /// Simulated in this process.
    Sim {
        /// The part.
        chip: &'static Chip,
        /// File that keeps its flash, by its absolute path.
        state: Option<PathBuf>,
        /// Unseal key of a new one.
        key: Option<[u16; 2]>,
        /// The seal state in which it begins.
        seal: Option<Level>,
        /// What happens to it.
        scenario: Option<Script>,
        /// Knobs that are turned before anything happens, each with its setting.
        knobs: Vec<(String, String)>,
        /// The adapter that it is behind; without one, a bus that carries and reports everything.
        adapter: Option<&'static AdapterModel>,
    },
    /// In a file that `--trace` wrote.
    Recording(PathBuf),
    /// On a bus.
    Bus {
        /// The adapter's node.
        bus: PathBuf,
        /// Its 7-bit address.
        address: u8,
        /// `None` where the gauge is asked.
        chip: Option<&'static Chip>,
        /// What the gauge takes, also while it is asked.
        reach: Reach,
    },
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim { state: Some(state), .. } => write!(f, "simulated gauge kept in {}", state.display()),
            Self::Sim { .. } => f.write_str("simulated gauge"),
            Self::Recording(path) => write!(f, "recording {}", path.display()),
            Self::Bus { bus, address, .. } => write!(f, "{} address 0x{address:02x}", bus.display()),
        }
    }
}

impl fmt::Debug for Source {
    /// As it is displayed: the key is not shown.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// A gauge that is reached and locked, and nothing more.
pub struct Opened {
    /// Its table.
    pub chip: &'static Chip,
    /// The way to it.
    pub bus: Box<dyn Bus>,
    /// What it takes at the clock of its bus.
    pub reach: Reach,
    /// Its 7-bit address.
    pub address: u8,
    /// Its name in messages.
    pub subject: String,
    /// The simulated gauge, if it is one.
    pub sim: Option<Sim>,
    /// Keeps other processes out while it is held; `None` for a gauge that ends with this process.
    pub lock: Option<Lock>,
    /// The name of its journal; `None` for a gauge that ends with this process.
    pub journal_key: Option<String>,
    /// The node of its adapter.
    pub node: Option<PathBuf>,
    /// The device at the address has not been seen to read like a gauge yet.
    pub unverified: bool,
    /// The reason why the gauge cannot be reached yet.
    pub missing: Option<Error>,
}

impl GaugeOptions {
    /// What it takes, wherever it is.
    pub fn reach(&self) -> Reach {
        if self.byte_writes { Reach::ONE_BYTE_A_WRITE } else { Reach::FULL }
    }
}

impl Source {
    /// The gauge that the options name.
    pub fn of(options: &GaugeOptions) -> Result<Self> {
        if let Some(chip) = options.sim {
            let seed = options.scenario_seed;
            return Ok(Self::Sim {
                chip,
                state: options.sim_state.clone(),
                key: options.sim_key.as_ref().map(|key| key.0),
                seal: options.sim_seal,
                scenario: options.scenario.clone().map(|name| Script { name, seed }),
                knobs: options.sim_set.clone(),
                adapter: options.sim_adapter,
            });
        }
        match (&options.replay, &options.bus) {
            (Some(file), _) => Ok(Self::Recording(file.clone())),
            (None, Some(bus)) => Ok(Self::Bus {
                bus: bus.clone(),
                address: options.address.unwrap_or(options.chip.map_or(GAUGE_ADDRESS, |chip| chip.address)),
                chip: options.chip,
                reach: options.reach(),
            }),
            (None, None) => Err(Error::new(
                "gauge",
                Cause::Invalid,
                "it is nowhere; name a bus, a chip to simulate or a recording",
            )),
        }
    }

    /// The usual time between two polls.
    pub(crate) fn interval(&self) -> Duration {
        Duration::from_secs(if matches!(self, Self::Bus { .. }) { 30 } else { 3 })
    }

    /// Describes the source without the names of files.
    pub fn place(&self) -> String {
        match self {
            Self::Sim { .. } => "simulated gauge".into(),
            Self::Recording(_) => "recording".into(),
            Self::Bus { .. } => self.to_string(),
        }
    }

    /// What the gauge is, where that is known before it is opened.
    pub fn chip(&self) -> Option<&'static Chip> {
        match self {
            Self::Sim { chip, .. } => Some(chip),
            Self::Bus { chip, .. } => *chip,
            Self::Recording(_) => None,
        }
    }

    /// What [`open`](Self::open) would find without a change or a transfer. The gauge is locked for a moment.
    pub fn check(&self, mountpoint: &Path, clock: &Arc<dyn Clock>) -> Result<()> {
        match self {
            Self::Sim { chip, state, seal, scenario, knobs, .. } => {
                if scenario.is_some() || seal.is_some() || !knobs.is_empty() {
                    let options = gauge_sim::Options { seal: *seal, ..gauge_sim::Options::default() };
                    let sim = Sim::new(chip.name, &options, clock.clone())?;
                    turn(&sim, knobs)?;
                    scenario.as_ref().map_or(Ok(()), |script| script.play(&sim))?;
                }
                let Some(path) = state else { return Ok(()) };
                let _lock = Lock::state(path, mountpoint, &**clock, is_ending)?;
                Sim::check_state(chip.name, path).map_err(Error::from)
            }
            Self::Recording(path) => recorded(path).map(drop),
            Self::Bus { bus, address, .. } => {
                let adapter = Adapter::find(bus)?;
                let _lock = claim(&adapter, *address, mountpoint, clock)?;
                Ok(LinuxBus::open(adapter, *address, clock.clone()).map(drop)?)
            }
        }
    }

    /// Opens and locks the gauge. With `waits`, one on a bus whose chip is known may be out of reach now.
    pub fn open(&self, mountpoint: &Path, clock: &Arc<dyn Clock>, waits: bool) -> Result<Opened> {
        let subject = self.to_string();
        match self {
            Self::Sim { chip, state, key, seal, scenario, knobs, adapter } => {
                let state = state.as_deref();
                let lock =
                    state.map(|path| Lock::state(path, mountpoint, &**clock, is_ending)).transpose()?;
                state.map_or(Ok(()), |path| Sim::check_state(chip.name, path))?;
                let (sim, bus) = power_up(chip, state, *key, *seal, clock)?;
                turn(&sim, knobs)?;
                scenario.as_ref().map_or(Ok(()), |script| script.play(&sim))?;
                let reach = adapter.map_or(Reach::FULL, |model| {
                    sim.set_adapter(model, true);
                    chip.reach_at(Some(model.hertz()))
                });
                let journal_key = state.map(lock::key_of_state);
                let opened = Opened::new(chip, Box::new(bus), subject);
                Ok(Opened { sim: Some(sim), lock, journal_key, reach, ..opened })
            }
            Self::Recording(path) => {
                let (chip, replay) = recorded(path)?;
                let address = replay.address().unwrap_or(chip.address);
                Ok(Opened { address, ..Opened::new(chip, Box::new(replay), subject) })
            }
            &Self::Bus { ref bus, address, chip, reach } => {
                let opened = match waits && chip.is_some() {
                    true => refuse_starting(bus),
                    false => Ok(()),
                };
                let opened =
                    opened.and_then(|()| on_bus(bus, address, chip, reach, &subject, mountpoint, clock));
                let opened = match (opened, chip) {
                    (Err(error), Some(chip)) if waits && may_come(&error) => {
                        absent(bus, address, chip, subject, error, clock)?
                    }
                    (opened, _) => opened?,
                };
                Ok(Opened { address, node: Some(bus.into()), ..opened })
            }
        }
    }
}

/// Whether a gauge that could not be opened may be there later: its path may be that of another adapter then.
pub fn may_come(error: &Error) -> bool {
    error.errno() != Errno::ENOTTY as i32 && error.cause() != Cause::Adapter(ErrorKind::HasMux)
}

/// Whether the daemon that holds a lock is about to end: its mount is gone.
fn is_ending(mountpoint: &Path) -> bool {
    !mounts::is_gaugefs(mountpoint)
}

fn turn(sim: &Sim, knobs: &[(String, String)]) -> Result<()> {
    knobs
        .iter()
        .try_for_each(|(knob, text)| sim.set(knob, text))
        .map_err(|error| Error::from(error).within("sim-set"))
}

#[inline(never)] // A gauge as a value is large; it is not to be on the stack with all else that opens one.
fn power_up(
    chip: &'static Chip,
    state: Option<&Path>,
    unseal_key: Option<[u16; 2]>,
    seal: Option<Level>,
    clock: &Arc<dyn Clock>,
) -> Result<(Sim, SimBus)> {
    let seed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
    let options =
        gauge_sim::Options { state: state.map(Path::to_path_buf), unseal_key, seal, seed, envelope: None };
    let sim = Sim::new(chip.name, &options, clock.clone())?;
    let mut bus = sim.bus();
    let start = clock.now();
    while bus.transfer(&[0], &mut [0; 2]).is_err() && clock.now() - start < POWER_UP {
        clock.sleep(Duration::from_millis(20));
    }
    Ok((sim, bus))
}

/// Only a gauge that is asked has to be written to.
fn named(error: Error) -> Error {
    let bus = match error.cause() {
        Cause::Bus(bus @ BusError::WriteDisabled) => bus,
        _ => return error,
    };
    let why =
        format!("it cannot be asked which part it is: {bus}; with --chip its standard commands are read");
    Error::new("", Cause::Bus(bus), why).at(Step::Identify)
}

/// A gauge on a bus that is there; without a chip, the gauge is asked.
fn on_bus(
    bus: &Path,
    address: u8,
    chip: Option<&'static Chip>,
    reach: Reach,
    subject: &str,
    mountpoint: &Path,
    clock: &Arc<dyn Clock>,
) -> Result<Opened> {
    let adapter = Adapter::find(bus)?;
    let open = || {
        let bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
        Ok(Box::new(bus) as Box<dyn Bus>)
    };
    let lock = claim(&adapter, address, mountpoint, clock)?;
    let known = match chip {
        Some(chip) if ptr::eq(chip, &chip::sbs::CHIP) => named_by_pack(open()?, address, clock),
        Some(chip) => chip,
        None if address == ROM_ADDRESS => {
            smart_battery(&mut *open()?, &**clock, subject)?;
            named_by_pack(open()?, address, clock)
        }
        None => {
            let clock_hz = adapter.clock_hz();
            probe::find(subject, &Target { open: &open, clock, reach, clock_hz }).map_err(named)?
        }
    };
    Ok(Opened {
        reach: known.reach_at(adapter.clock_hz()),
        lock: Some(lock),
        journal_key: Some(lock::key_of_gauge(&adapter, address)),
        unverified: chip.is_some(),
        ..Opened::new(known, open()?, subject.into())
    })
}

/// What answers at ROM mode's address, by reads alone: any other question might be a command there.
fn smart_battery(bus: &mut dyn Bus, clock: &dyn Clock, subject: &str) -> Result<()> {
    let found = rom::find(bus, clock).map_err(|error| error.within(subject))?;
    match found.ok_or_else(|| Error::from(BusError::NoAck).within(subject))? {
        Device::SmartBattery => Ok(()),
        Device::BootLoader | Device::Unclear => {
            let why = "it does not read like a Smart Battery, and nothing was written to it; a gauge that answers only \
                       here is in ROM mode (`gaugefs rescue --help`)";
            Err(Error::new(subject, Cause::Gone, why).at(Step::Identify))
        }
    }
}

/// A Smart Battery, or the gauge of TI's in it whose name is its DeviceName(). It is only read.
fn named_by_pack(bus: Box<dyn Bus>, address: u8, clock: &Arc<dyn Clock>) -> &'static Chip {
    let pack = &chip::sbs::CHIP;
    let mut gauge = Gauge::new(pack, bus, clock.clone(), Keys::default()).at(address);
    let mut registers = Registers::unread(pack.registers);
    // A pack that does not answer now is opened as any other.
    let read = registers.read(&mut gauge, |tier| tier == Tier::Static);
    let name = pack.register(Role::ModelName).and_then(|row| registers.text(row)).filter(|_| read.is_ok());
    name.and_then(|name| chip::sbs::ti::by_device_name(name)).unwrap_or(pack)
}

/// Locks a gauge on a bus, which has no mux.
fn claim(adapter: &Adapter, address: u8, mountpoint: &Path, clock: &Arc<dyn Clock>) -> Result<Lock> {
    adapter.refuse_mux()?;
    Lock::gauge(adapter, address, mountpoint, &**clock, is_ending).or_else(|error| {
        if error.errno() != Errno::EBUSY as i32 {
            // Without permission for the bus, that is the first thing to correct.
            LinuxBus::open(adapter.clone(), address, clock.clone())?;
        }
        Err(error)
    })
}

/// Refuses an adapter whose driver is still starting: among many gauges it is not waited for.
fn refuse_starting(bus: &Path) -> Result<()> {
    match Adapter::find(bus).is_ok_and(|adapter| adapter.is_starting()) {
        true => Err(Error::host(bus.display().to_string(), Errno::ENODEV, "its driver is still starting")),
        false => Ok(()),
    }
}

/// A gauge whose bus is not there, or does not reach it, because of `error`.
fn absent(
    bus: &Path,
    address: u8,
    chip: &'static Chip,
    subject: String,
    error: Error,
    clock: &Arc<dyn Clock>,
) -> Result<Opened> {
    // The journal has the same name whether the adapter is there at the start or not.
    let Some(journal_key) = lock::key_of_place(bus, address) else {
        let why = format!("{error}; to wait for an adapter, name it /dev/i2c-N");
        return Err(Error::host("", Errno::from_raw(error.errno()), why));
    };
    let bus = LinuxBus::absent(bus, address, clock.clone());
    Ok(Opened {
        journal_key: Some(journal_key),
        unverified: true,
        missing: Some(error),
        ..Opened::new(chip, Box::new(bus), subject)
    })
}

impl Opened {
    fn new(chip: &'static Chip, bus: Box<dyn Bus>, subject: String) -> Self {
        Self {
            chip,
            bus,
            reach: Reach::FULL,
            address: chip.address,
            subject,
            sim: None,
            lock: None,
            node: None,
            journal_key: None,
            unverified: false,
            missing: None,
        }
    }
}

/// The gauge of a recording, which has to contain all registers that a mount polls.
pub fn recorded(path: &Path) -> Result<(&'static Chip, Replay)> {
    let name = path.display().to_string();
    let refuse = |why: String| Error::new(&name, Cause::Invalid, why);
    let recording = Recording::open(path)?;
    let chip = Chip::by_name(&recording.chip).ok_or_else(|| {
        refuse(format!("unknown chip `{}`; `gaugefs chips` lists the known ones", recording.chip))
    })?;
    let replay = ti_gauge::gauge::replay(chip, &recording);
    for tier in [Tier::Poll, Tier::Static, Tier::Slow] {
        let mut read = reads(chip, tier).into_iter();
        if !read.all(|(register, length)| replay.covers(register, length)) {
            let why = "recording too short: record a few seconds of a mount";
            return Err(refuse(why.into()));
        }
    }
    Ok((chip, replay))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gauge_bus::clock::{RealClock, SimClock};

    #[test]
    fn a_gauge_is_at_the_address_of_its_part_unless_another_is_named() {
        let table = Chip::by_name("bq34z100-g1").expect("a part with a table");
        let other: &'static Chip = Box::leak(Box::new(Chip { address: 0x16, ..table.clone() }));
        let of = |chip, address| {
            let bus = Some("/dev/i2c-1".into());
            match Source::of(&GaugeOptions { chip, address, bus, ..GaugeOptions::default() }) {
                Ok(Source::Bus { address, .. }) => address,
                _ => panic!("it is on a bus"),
            }
        };
        assert_eq!((of(Some(other), None), of(Some(other), Some(0x55)), of(None, None)), (0x16, 0x55, 0x55));
        let bus = gauge_sim::Sim::new(table.name, &gauge_sim::Options::default(), Arc::new(RealClock::new()));
        let bus = Box::new(bus.expect("a part of the simulator").bus());
        assert_eq!(Opened::new(other, bus, String::new()).address, 0x16);
    }

    #[test]
    fn a_pack_is_the_part_of_its_device_name_and_is_only_read_for_it() {
        for (simulated, named) in
            [("sbs", "sbs"), ("bq40z50-r2", "bq40z50-r2"), ("bq4050", "bq4050"), ("bq40z80", "sbs")]
        {
            let clock = Arc::new(SimClock::new());
            let sim =
                Sim::new(simulated, &gauge_sim::Options::default(), clock.clone()).expect("it is simulated");
            clock.sleep(Duration::from_secs(1));
            let clock: Arc<dyn Clock> = clock;
            assert_eq!(named_by_pack(Box::new(sim.bus()), 0x0b, &clock).name, named, "{simulated}");
            assert_eq!(sim.get("written").as_deref(), Some("0"), "{simulated}");
        }
    }
}
