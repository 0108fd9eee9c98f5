//! The options of a mount and of its gauges, each defined once for the command line and for a configuration
//! file, where they have the same names.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Deserialize;

use crate::error::{Cause, Error, Result};
use crate::fs::Scales;
use ti_gauge::authentication::Order;
use ti_gauge::chip::Chip;

#[cfg_attr(not(feature = "screen"), allow(dead_code, reason = "the commands of that feature use the rest"))]
mod alert;
mod file;
mod from_toml;
mod node;
mod source;
mod station_file;
mod values;

pub(crate) use alert::AlertOptions;
use node::Node;
pub(crate) use station_file::station;
use values::Key;
pub(crate) use values::{address, chip_names, chips};

// No documentation on these two: clap would take it for the description of the subcommand.

#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub(crate) struct GaugeOptions {
    /// Simulate a gauge of this chip; `gaugefs chips` lists them
    #[arg(long, value_name = "CHIP", value_parser = values::chips(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "from_toml::chip")]
    pub(crate) sim: Option<&'static Chip>,
    /// File that keeps the simulated gauge's flash; created if missing
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    pub(crate) sim_state: Option<PathBuf>,
    /// Unseal key of a new simulated gauge [default: the manual's]
    #[arg(long, value_name = "WORDS", value_parser = values::key, conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "from_toml::key")]
    pub(crate) sim_key: Option<Key>,
    /// I2C bus of the gauge, such as /dev/i2c-1, or the gauge's device, such as
    /// /sys/bus/i2c/devices/1-0055
    #[arg(long, value_name = "DEVICE", help_heading = "Gauge")]
    pub(crate) bus: Option<PathBuf>,
    /// 7-bit address of the gauge [default: 0x55]
    #[arg(long, value_name = "ADDRESS", value_parser = values::address, conflicts_with_all = ["sim", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "from_toml::address")]
    pub(crate) address: Option<u8>,
    /// Chip of the gauge [default: the gauge is asked]
    #[arg(long, value_name = "CHIP", value_parser = values::chips(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["sim", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "from_toml::chip")]
    pub(crate) chip: Option<&'static Chip>,
    /// Replay a gauge from this recording, which --trace made; read-only; - is standard input
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "trace", "config"], help_heading = "Gauge")]
    pub(crate) replay: Option<PathBuf>,
    /// Write one byte per transfer, as some gauges need above 100 kHz
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Gauge"
    )]
    pub(crate) byte_writes: Option<bool>,
    /// Image, as `gaugefs export` writes it, to write again after a gauge without flash has lost power; -
    /// is standard input
    #[arg(long, value_name = "FILE", conflicts_with_all = ["replay", "config"], help_heading = "Gauge")]
    pub(crate) restore: Option<PathBuf>,

    /// Name of the gauge's folder [default: BAT0, or the first BATn that the kernel does not use]
    #[arg(long, value_name = "NAME", value_parser = values::name, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::name")]
    pub(crate) name: Option<String>,
    /// Seconds between two polls, 0.5 to 3600 [default: 30; 3 with --sim and --replay]
    #[arg(long, value_name = "SECONDS", value_parser = values::interval, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::interval")]
    pub(crate) poll: Option<Duration>,
    /// Show energy_now and power_avg too; beside charge_now they mislead some monitors
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "What is shown"
    )]
    pub(crate) energy: Option<bool>,
    /// Show currents without sign, for monitors that cannot handle negative ones
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "What is shown"
    )]
    pub(crate) absolute_current: Option<bool>,
    /// Multiply currents and charges by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = values::factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::factor")]
    pub(crate) current_scale: Option<f64>,
    /// Multiply voltages by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = values::factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::factor")]
    pub(crate) voltage_scale: Option<f64>,
    /// Multiply energies and powers by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = values::factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::factor")]
    pub(crate) energy_scale: Option<f64>,

    /// Also write parameters whose address or range is uncertain
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Access"
    )]
    pub(crate) allow_unproven: Option<bool>,
    /// Also write during a learning cycle; the reset that follows ends the cycle
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Access"
    )]
    pub(crate) allow_learning: Option<bool>,
    /// Program at most this many blocks of flash per hour; 0 for no limit [default: 300]
    #[arg(long, value_name = "N", conflicts_with_all = ["replay", "config"], help_heading = "Access")]
    pub(crate) writes_per_hour: Option<u32>,
    /// File with the gauge's keys, in lines such as `unseal = 0414 3672`; only its owner may read it
    #[arg(long, value_name = "FILE", conflicts_with = "config", help_heading = "Access")]
    pub(crate) key_file: Option<PathBuf>,
    /// Never try the manual's default key
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Access"
    )]
    pub(crate) no_default_keys: Option<bool>,
    /// Byte order in which the gauge takes a challenge, lsb-first or as-sent; `gaugefs auth` finds out
    /// which one [default: lsb-first]
    #[arg(long, value_name = "ORDER", value_parser = values::order, conflicts_with = "config", help_heading = "Access")]
    #[serde(deserialize_with = "from_toml::order")]
    pub(crate) auth_order: Option<Order>,

    /// Record every transfer in this file, which must be a new one; keys are left out
    #[arg(long, value_name = "FILE", conflicts_with = "config", help_heading = "Running")]
    pub(crate) trace: Option<PathBuf>,
    /// Replace the file of --trace if there is one
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        requires = "trace",
        conflicts_with = "config",
        help_heading = "Running"
    )]
    pub(crate) trace_replace: Option<bool>,
}

#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub(crate) struct MountOptions {
    /// Folder to mount at; created if missing
    #[arg(required_unless_present = "config")]
    pub(crate) mountpoint: Option<PathBuf>,

    /// Show a Mains supply too, online while no gauge is discharging [default NAME: AC]
    #[arg(long, value_name = "NAME", value_parser = values::name, require_equals = true, num_args = 0..=1, help_heading = "What is shown")]
    #[serde(deserialize_with = "from_toml::ac")]
    pub(crate) ac: Option<Option<String>>,

    /// Refuse every write
    #[arg(long, help_heading = "Access")]
    pub(crate) read_only: bool,
    /// Deny other users access to the mount; always so without root, unless there is a --group
    #[arg(long, help_heading = "Access")]
    pub(crate) private: bool,
    /// Let this group read and write data flash, besides the owner; without root, a group of yours,
    /// and /etc/fuse.conf must have user_allow_other
    #[arg(long, value_name = "GROUP", value_parser = values::group, help_heading = "Access")]
    #[serde(deserialize_with = "from_toml::group")]
    pub(crate) group: Option<u32>,

    /// Log to this file [default: syslog, in the foreground standard error]
    #[arg(long, value_name = "FILE", help_heading = "Running")]
    pub(crate) log: Option<PathBuf>,
    /// Folder for backups, and for journals, with which a write survives a power cut [default:
    /// /var/lib/gaugefs; without root, ~/.local/state/gaugefs]
    #[arg(long, value_name = "DIR", help_heading = "Running")]
    pub(crate) state_dir: Option<PathBuf>,
    /// Do not save a gauge's configuration before the first write to it
    #[arg(long, help_heading = "Running")]
    pub(crate) no_backup: bool,
}

impl MountOptions {
    /// These options, and the others where these are not given.
    fn over(self, others: Self) -> Self {
        Self {
            mountpoint: self.mountpoint.or(others.mountpoint),
            ac: self.ac.or(others.ac),
            read_only: self.read_only || others.read_only,
            private: self.private || others.private,
            group: self.group.or(others.group),
            log: self.log.or(others.log),
            state_dir: self.state_dir.or(others.state_dir),
            no_backup: self.no_backup || others.no_backup,
        }
    }

    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        [&mut self.mountpoint, &mut self.log, &mut self.state_dir].into_iter().flatten()
    }
}

impl MountOptions {
    fn check_log(&self) -> Result<()> {
        check_kept(self.log.as_ref(), "--log", "with --foreground the log goes to standard error without it")
    }
}

impl GaugeOptions {
    /// If `bus` is a device in sysfs, completes the options from the device tree.
    fn of_node(self) -> Result<Self> {
        let node = self.bus.as_deref().map(Node::find).transpose()?.flatten();
        let Some(Node { bus, address, chip }) = node else { return Ok(self) };
        Ok(Self { bus: Some(bus), address: self.address.or(Some(address)), chip: self.chip.or(chip), ..self })
    }

    /// These options, and the others where these are not given.
    fn over(self, others: &Self) -> Self {
        // A gauge that is simulated or recorded is not on the bus of the others.
        let elsewhere = self.sim.is_some() || self.replay.is_some();
        let place = if elsewhere { &Self::default() } else { others };
        Self {
            bus: self.bus.or_else(|| place.bus.clone()),
            address: self.address.or(place.address),
            chip: self.chip.or(place.chip),
            byte_writes: self.byte_writes.or(others.byte_writes),
            restore: self.restore.or_else(|| others.restore.clone().filter(|_| self.replay.is_none())),
            poll: self.poll.or(others.poll),
            energy: self.energy.or(others.energy),
            absolute_current: self.absolute_current.or(others.absolute_current),
            current_scale: self.current_scale.or(others.current_scale),
            voltage_scale: self.voltage_scale.or(others.voltage_scale),
            energy_scale: self.energy_scale.or(others.energy_scale),
            allow_unproven: self.allow_unproven.or(others.allow_unproven),
            allow_learning: self.allow_learning.or(others.allow_learning),
            writes_per_hour: self.writes_per_hour.or(others.writes_per_hour),
            key_file: self.key_file.or_else(|| others.key_file.clone()),
            no_default_keys: self.no_default_keys.or(others.no_default_keys),
            auth_order: self.auth_order.or(others.auth_order),
            ..self
        }
    }

    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let Self { sim_state, bus, replay, restore, key_file, trace, .. } = self;
        [sim_state, bus, replay, restore, key_file, trace].into_iter().flatten()
    }

    pub(crate) fn scales(&self) -> Scales {
        Scales {
            current: self.current_scale.unwrap_or(1.0),
            voltage: self.voltage_scale.unwrap_or(1.0),
            energy: self.energy_scale.unwrap_or(1.0),
            absolute_current: self.absolute_current.unwrap_or_default(),
            energy_shown: self.energy.unwrap_or_default(),
        }
    }
}

/// The settings of `gaugefs mount`, from the command line and the configuration file. All paths are
/// absolute, because the daemon in the background changes its folder to `/`.
#[derive(Debug)]
pub(crate) struct Setup {
    pub(crate) mount: MountOptions,
    /// Each has a source: it is simulated, recorded or on a bus.
    pub(crate) gauges: Vec<GaugeOptions>,
    /// From a configuration file: gauges that do not answer are skipped.
    pub(crate) configured: bool,
}

impl Setup {
    /// The one gauge of a command line.
    pub(crate) fn one(mut mount: MountOptions, gauge: GaugeOptions) -> Result<Self> {
        let mut gauge = gauge.of_node()?;
        let all = "a mount goes on when the command has returned, which standard output does not";
        check_kept(gauge.trace.as_ref(), "--trace", all)?;
        check_kept(
            gauge.sim_state.as_ref(),
            "--sim-state",
            "the gauge's flash is read from it and written to it",
        )?;
        mount.check_log()?;
        gauge_owner::key_file::check_name(gauge.key_file.as_deref())?;
        gauge.replay = gauge.replay.map(standard_input);
        gauge.restore = gauge.restore.map(standard_input);
        make_absolute(mount.paths().chain(gauge.paths()), Path::new(""))?;
        mount.read_only |= gauge.replay.is_some();
        Ok(Self { mount, gauges: vec![gauge], configured: false })
    }

    /// The gauges of a configuration file. The options of the command line go before those of the file;
    /// `bus` is for the gauges that have no source of their own.
    pub(crate) fn read(path: &Path, mut mount: MountOptions, bus: Option<&Path>) -> Result<Self> {
        let mut bus = bus.map(Path::to_path_buf);
        mount.check_log()?;
        make_absolute(mount.paths().chain(&mut bus), Path::new(""))?;
        let name = path.display().to_string();
        let refuse = |why: &str| Err(Error::new(&name, Cause::Invalid(why.into())));
        let (of_file, gauges) = file::read(path, bus)?;
        let mut mount = mount.over(of_file);
        if mount.mountpoint.is_none() {
            return refuse("no mount point; give one on the command line, or set mountpoint below [mount]");
        }
        let recordings = gauges.iter().filter(|gauge| gauge.replay.is_some()).count();
        if recordings > 0 && recordings < gauges.len() && !mount.read_only {
            return refuse(
                "a recording makes all gauges of its mount read-only; set read-only = true below [mount], or \
                 mount it separately",
            );
        }
        mount.read_only |= recordings > 0;
        Ok(Self { mount, gauges, configured: true })
    }

    /// Folder to mount at.
    pub(crate) fn mountpoint(&self) -> &Path {
        self.mount.mountpoint.as_deref().expect("clap and `read` demand a mount point")
    }
}

/// The mount point that a configuration file names, and its alerts. Their programs run with the rights of whoever
/// reads the file, so nobody else may be able to change it.
#[cfg(feature = "screen")]
pub(crate) fn alerts(path: &Path) -> Result<(Option<PathBuf>, Vec<AlertOptions>)> {
    use std::os::unix::fs::MetadataExt;
    let name = path.display().to_string();
    if path == Path::new("-") {
        let why = "programs are run from it, so it must be a file that nobody else may change";
        return Err(Error::new("standard input", Cause::Invalid(why.into())));
    }
    let status = std::fs::metadata(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
    let me = nix::unistd::geteuid().as_raw();
    let refuse = |why: String| Err(Error::new(&name, Cause::NotPermitted(why)));
    if ![me, 0].contains(&status.uid()) {
        let why =
            format!("belongs to user {}; a file with programs to run must be yours or root's", status.uid());
        return refuse(why);
    }
    if status.mode() & 0o022 != 0 {
        let mode = status.mode() & 0o777;
        return refuse(format!("others may change the programs in it (mode {mode:03o}); chmod go-w {name}"));
    }
    file::alerts(path)
}

/// The file that `-` stands for on a command line, in place of a file to read.
const STANDARD_INPUT: &str = "/dev/stdin";

/// A file of a command line that is read as a whole, before the command returns.
pub(crate) fn standard_input(path: PathBuf) -> PathBuf {
    if path == Path::new("-") { STANDARD_INPUT.into() } else { path }
}

/// Refuses `-` for a file that is written or read again and again while a mount lasts.
fn check_kept(path: Option<&PathBuf>, option: &str, why: &str) -> Result<()> {
    match path.is_some_and(|path| path == Path::new("-")) {
        true => Err(Error::new(option, Cause::Invalid(format!("{why}; name a file")))),
        false => Ok(()),
    }
}

/// Makes paths absolute that are relative to `folder`; an empty `folder` is the current one.
fn make_absolute<'a>(paths: impl Iterator<Item = &'a mut PathBuf>, folder: &Path) -> Result<()> {
    for path in paths {
        *path = std::path::absolute(folder.join(&*path))
            .map_err(|error| Error::io(path.display().to_string(), "cannot find it", &error))?;
    }
    Ok(())
}
