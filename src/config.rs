//! What can be told of a mount and of its gauges: each option once, for the command line and for a
//! configuration file in TOML, under the same name.
//!
//! A file is read strictly. What it does not know, or cannot mean, is an error that names file, line and
//! key; nothing is opened before the whole file has been understood.

use std::collections::HashMap;
use std::fmt;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Command};
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer};
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::authentication::Order;
use crate::chip::{CHIPS, Chip};
use crate::daemon::Source;
use crate::daemon::node::Node;
use crate::dataflash::{Limits, WRITES_PER_HOUR};
use crate::error::{Cause, Error, Result};
use crate::fs::Scales;
use crate::keys;

// The help of these two belongs to the subcommand that holds them, so they have no description of their own.

#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub(crate) struct GaugeOptions {
    /// A simulated gauge of this kind; `gaugefs chips` lists them
    #[arg(long, value_name = "CHIP", value_parser = known_chips(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "chip")]
    pub(crate) sim: Option<&'static Chip>,
    /// Keep the simulated gauge's flash in this file; made if it is missing
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    pub(crate) sim_state: Option<PathBuf>,
    /// Unseal key of a new simulated gauge [default: the manual's]
    #[arg(long, value_name = "WORDS", value_parser = key_words, conflicts_with_all = ["bus", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "sim_key")]
    pub(crate) sim_key: Option<Key>,
    /// The I2C bus that the gauge is on, such as /dev/i2c-1, or its device, such as
    /// /sys/bus/i2c/devices/1-0055
    #[arg(long, value_name = "DEVICE", help_heading = "Gauge")]
    pub(crate) bus: Option<PathBuf>,
    /// The gauge's 7-bit address [default: 0x55]
    #[arg(long, value_name = "ADDRESS", value_parser = address, conflicts_with_all = ["sim", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "address_word")]
    pub(crate) address: Option<u8>,
    /// What the gauge is [default: it is asked]
    #[arg(long, value_name = "CHIP", value_parser = known_chips(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["sim", "replay", "config"], help_heading = "Gauge")]
    #[serde(deserialize_with = "chip")]
    pub(crate) chip: Option<&'static Chip>,
    /// A recorded gauge, read-only: the file that --trace wrote
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "trace", "config"], help_heading = "Gauge")]
    pub(crate) replay: Option<PathBuf>,
    /// Write one byte a transfer, as some gauges want above 100 kHz
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Gauge"
    )]
    pub(crate) byte_writes: Option<bool>,
    /// A copy of df/index to write again when a gauge without flash has lost its power
    #[arg(long, value_name = "FILE", conflicts_with_all = ["replay", "config"], help_heading = "Gauge")]
    pub(crate) restore: Option<PathBuf>,

    /// Name of the gauge's folder [default: BAT0, or the first BATn that the kernel does not have]
    #[arg(long, value_name = "NAME", value_parser = name, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "name_word")]
    pub(crate) name: Option<String>,
    /// Time between two polls, 0.5 to 3600 s [default: 30; 3 with --sim and --replay]
    #[arg(long, value_name = "SECONDS", value_parser = interval, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "interval_word")]
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
    /// Show currents without their sign, for monitors that cannot bear it
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "What is shown"
    )]
    pub(crate) absolute_current: Option<bool>,
    /// Multiply currents and charges by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "factor_word")]
    pub(crate) current_scale: Option<f64>,
    /// Multiply voltages by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "factor_word")]
    pub(crate) voltage_scale: Option<f64>,
    /// Multiply energies and powers by this factor [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = factor, conflicts_with = "config", help_heading = "What is shown")]
    #[serde(deserialize_with = "factor_word")]
    pub(crate) energy_scale: Option<f64>,

    /// Write parameters too whose address or range is not sure
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Access"
    )]
    pub(crate) allow_unproven: Option<bool>,
    /// Write in the middle of a learning cycle too; the reset that follows ends it
    #[arg(
        long,
        num_args = 0,
        default_missing_value = "true",
        conflicts_with = "config",
        help_heading = "Access"
    )]
    pub(crate) allow_learning: Option<bool>,
    /// Program at most so many blocks of flash an hour, 0 for any number [default: 300]
    #[arg(long, value_name = "N", conflicts_with_all = ["replay", "config"], help_heading = "Access")]
    pub(crate) writes_per_hour: Option<u32>,
    /// File with the gauge's keys: lines such as `unseal = 0414 3672`; nobody else may read it
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
    /// In which order the gauge takes the bytes of a challenge, lsb-first or as-sent; `gaugefs auth`
    /// tells which one fits [default: lsb-first]
    #[arg(long, value_name = "ORDER", value_parser = order, conflicts_with = "config", help_heading = "Access")]
    #[serde(deserialize_with = "order_word")]
    pub(crate) auth_order: Option<Order>,

    /// Write every transfer to this file; keys are left out
    #[arg(long, value_name = "FILE", conflicts_with = "config", help_heading = "Running")]
    pub(crate) trace: Option<PathBuf>,
}

/// What belongs to one gauge and is no default for many.
const OWN: &[&str] = &["sim", "sim-state", "sim-key", "replay", "name", "trace"];

#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub(crate) struct MountOptions {
    /// Folder to mount at; made if it is missing
    #[arg(required_unless_present = "config")]
    pub(crate) mountpoint: Option<PathBuf>,

    /// Show a Mains supply too [default NAME: AC]: `online` while no gauge is discharged
    #[arg(long, value_name = "NAME", value_parser = name, require_equals = true, num_args = 0..=1, help_heading = "What is shown")]
    #[serde(deserialize_with = "ac_word")]
    pub(crate) ac: Option<Option<String>>,

    /// Refuse every write
    #[arg(long, help_heading = "Access")]
    pub(crate) read_only: bool,
    /// Let no other user look at the mount (without root this is always so)
    #[arg(long, help_heading = "Access")]
    pub(crate) private: bool,
    /// Let this group read and write data flash, besides the owner
    #[arg(long, value_name = "GROUP", value_parser = group, help_heading = "Access")]
    #[serde(deserialize_with = "group_word")]
    pub(crate) group: Option<u32>,

    /// Log to this file [default: syslog, in the foreground standard error]
    #[arg(long, value_name = "FILE", help_heading = "Running")]
    pub(crate) log: Option<PathBuf>,
    /// Folder for the journal, which lets a write survive a power cut [default: /var/lib/gaugefs; without
    /// root, ~/.local/state/gaugefs]
    #[arg(long, value_name = "DIR", help_heading = "Running")]
    pub(crate) state_dir: Option<PathBuf>,
}

/// Key words, which are not shown again.
#[derive(Clone)]
pub(crate) struct Key(pub(crate) [u16; 2]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("hidden")
    }
}

impl MountOptions {
    /// These, and where they say nothing, the others.
    fn over(self, others: Self) -> Self {
        Self {
            mountpoint: self.mountpoint.or(others.mountpoint),
            ac: self.ac.or(others.ac),
            read_only: self.read_only || others.read_only,
            private: self.private || others.private,
            group: self.group.or(others.group),
            log: self.log.or(others.log),
            state_dir: self.state_dir.or(others.state_dir),
        }
    }

    /// Its paths.
    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        [&mut self.mountpoint, &mut self.log, &mut self.state_dir].into_iter().flatten()
    }
}

impl GaugeOptions {
    /// With a device of sysfs for a bus: what the device tree says of it, where nothing else was said.
    pub(crate) fn of_node(self) -> Result<Self> {
        let node = self.bus.as_deref().map(Node::find).transpose()?.flatten();
        let Some(Node { bus, address, chip }) = node else { return Ok(self) };
        Ok(Self { bus: Some(bus), address: self.address.or(Some(address)), chip: self.chip.or(chip), ..self })
    }

    /// These, and where they say nothing, the others.
    fn over(self, others: &Self) -> Self {
        // What a gauge is, and where, is one choice.
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

    /// Its paths.
    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let Self { sim_state, bus, replay, restore, key_file, trace, .. } = self;
        [sim_state, bus, replay, restore, key_file, trace].into_iter().flatten()
    }

    /// Two options that exclude each other, or one that needs another: what the command line refuses too.
    fn contradiction(&self) -> Option<(&'static str, &'static str)> {
        let own = [("replay", self.replay.is_some()), ("bus", self.bus.is_some())];
        let place = [("address", self.address.is_some()), ("chip", self.chip.is_some())];
        let sim = [("sim-state", self.sim_state.is_some()), ("sim-key", self.sim_key.is_some())];
        let recorded = [("restore", self.restore.is_some()), ("trace", self.trace.is_some())];
        let first = |list: &[(&'static str, bool)]| list.iter().find(|(_, set)| *set).map(|(name, _)| *name);
        if self.sim.is_some() {
            return first(&[own, place].concat()).map(|name| (name, "cannot stand beside sim"));
        }
        if let Some(name) = first(&sim) {
            return Some((name, "is for simulated gauges; add sim, or take it out"));
        }
        if self.replay.is_some() {
            let others = [&own[1..], &place, &recorded].concat();
            return first(&others).map(|name| (name, "cannot stand beside replay"));
        }
        None
    }

    /// Time between two polls.
    pub(crate) fn interval(&self) -> Duration {
        let on_bus = matches!(Source::of(self), Source::Bus { .. });
        self.poll.unwrap_or(Duration::from_secs(if on_bus { 30 } else { 3 }))
    }

    /// How its figures are shown.
    pub(crate) fn scales(&self) -> Scales {
        Scales {
            current: self.current_scale.unwrap_or(1.0),
            voltage: self.voltage_scale.unwrap_or(1.0),
            energy: self.energy_scale.unwrap_or(1.0),
            absolute_current: self.absolute_current.unwrap_or_default(),
            energy_shown: self.energy.unwrap_or_default(),
        }
    }

    /// What may be overruled, and how often flash may be programmed.
    pub(crate) fn limits(&self) -> Limits {
        Limits {
            allow_learning: self.allow_learning.unwrap_or_default(),
            writes_per_hour: self.writes_per_hour.unwrap_or(WRITES_PER_HOUR),
        }
    }
}

/// What `gaugefs mount` mounts, from the command line and a configuration file. Every path in it is
/// absolute: a daemon in the background works in `/`.
#[derive(Debug)]
pub(crate) struct Setup {
    pub(crate) mount: MountOptions,
    /// Each is simulated, recorded or on a bus.
    pub(crate) gauges: Vec<GaugeOptions>,
    /// They come from a configuration file: the mount does without those that do not answer.
    pub(crate) configured: bool,
}

impl Setup {
    /// The one gauge of a command line.
    pub(crate) fn one(mut mount: MountOptions, gauge: GaugeOptions) -> Result<Self> {
        let mut gauge = gauge.of_node()?;
        make_absolute(mount.paths().chain(gauge.paths()), Path::new(""))?;
        mount.read_only |= gauge.replay.is_some();
        Ok(Self { mount, gauges: vec![gauge], configured: false })
    }

    /// The gauges of a configuration file. The options of the command line go before those of the file;
    /// `bus` is for the gauges that have no source of their own.
    pub(crate) fn read(path: &Path, mut mount: MountOptions, bus: Option<&Path>) -> Result<Self> {
        let mut bus = bus.map(Path::to_path_buf);
        make_absolute(mount.paths().chain(&mut bus), Path::new(""))?;
        let name = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
        let file = File { name: &name, text: &text, folder: path.parent().unwrap_or(Path::new("/")) };
        let (told, defaults, gauges) = file.parse()?;
        let mut mount = mount.over(told);
        if mount.mountpoint.is_none() {
            let why =
                "names no mount point; add `mountpoint = \"/run/gauges\"`, or give one on the command line";
            return Err(Error::new(name, Cause::Invalid(why.into())));
        }
        let defaults = GaugeOptions { bus: bus.or(defaults.bus.clone()), ..defaults };
        let gauges = file.resolve(gauges, &defaults)?;
        let recorded = gauges.iter().filter(|gauge| gauge.replay.is_some()).count();
        if recorded > 0 && recorded < gauges.len() && !mount.read_only {
            let why = "a recorded gauge beside others makes all of them read-only; add `read-only = true`, or \
                       mount it apart";
            return Err(Error::new(name, Cause::Invalid(why.into())));
        }
        mount.read_only |= recorded > 0;
        Ok(Self { mount, gauges, configured: true })
    }

    /// Folder to mount at.
    pub(crate) fn mountpoint(&self) -> &Path {
        self.mount.mountpoint.as_deref().expect("neither clap nor `read` do without a mount point")
    }
}

/// Makes paths absolute that begin at `folder`; the empty path is the current folder.
fn make_absolute<'a>(paths: impl Iterator<Item = &'a mut PathBuf>, folder: &Path) -> Result<()> {
    for path in paths {
        *path = std::path::absolute(folder.join(&*path))
            .map_err(|error| Error::io(path.display().to_string(), "cannot find it", &error))?;
    }
    Ok(())
}

/// A configuration that is being read.
struct File<'a> {
    name: &'a str,
    text: &'a str,
    /// Where its relative paths begin.
    folder: &'a Path,
}

/// A gauge as its table has it.
struct Section {
    options: GaugeOptions,
    /// Where the table and its keys stand.
    at: usize,
    keys: HashMap<String, usize>,
}

impl File<'_> {
    fn line(&self, at: usize) -> usize {
        1 + self.text.bytes().take(at).filter(|&byte| byte == b'\n').count()
    }

    /// An error about a key of the file.
    fn refuse(&self, at: usize, key: &str, why: &str) -> Error {
        Error::new(format!("{}: line {}: {key}", self.name, self.line(at)), Cause::Invalid(why.into()))
    }

    fn parse(&self) -> Result<(MountOptions, GaugeOptions, Vec<Section>)> {
        let document = DeTable::parse(self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            self.refuse(at, "not TOML", &one_line(error.message()))
        })?;
        let (of_mount, of_gauge) = (names(MountOptions::augment_args), names(GaugeOptions::augment_args));
        let mut known = [of_mount.clone(), of_gauge.clone()].concat();
        known.push("gauge".into());
        let span = document.span();
        let (mut mount, mut defaults, mut gauges) = (DeTable::new(), DeTable::new(), Vec::new());
        for (key, value) in document.into_inner() {
            let (at, word) = (key.span().start, key.get_ref().to_string());
            if word == "gauge" {
                for table in self.tables(at, value)? {
                    self.check_names(table.get_ref(), &of_gauge)?;
                    gauges.push(self.section(table)?);
                }
            } else if of_mount.contains(&word) {
                mount.insert(key, value);
            } else if OWN.contains(&word.as_str()) {
                return Err(self.refuse(at, &word, "belongs to one gauge; write it below a [[gauge]]"));
            } else if of_gauge.contains(&word) {
                defaults.insert(key, value);
            } else {
                return Err(self.unknown(at, &word, &known));
            }
        }
        let mut mount: MountOptions = self.read(Spanned::new(span.clone(), mount))?;
        let mut defaults: GaugeOptions = self.read(Spanned::new(span, defaults))?;
        make_absolute(mount.paths().chain(defaults.paths()), self.folder)?;
        Ok((mount, defaults, gauges))
    }

    /// The tables of `[[gauge]]`.
    fn tables<'i>(&self, at: usize, value: Spanned<DeValue<'i>>) -> Result<Vec<Spanned<DeTable<'i>>>> {
        let refuse = || self.refuse(at, "gauge", "write [[gauge]] above the options of each gauge");
        let DeValue::Array(list) = value.into_inner() else { return Err(refuse()) };
        let tables = list.into_iter().map(|one| {
            let span = one.span();
            match one.into_inner() {
                DeValue::Table(table) => Ok(Spanned::new(span, table)),
                _ => Err(refuse()),
            }
        });
        tables.collect()
    }

    fn check_names(&self, table: &DeTable<'_>, known: &[String]) -> Result<()> {
        let strange = |key: &&Spanned<DeString<'_>>| !known.iter().any(|name| name == key.get_ref());
        match table.keys().filter(strange).min_by_key(|key| key.span().start) {
            Some(key) if names(MountOptions::augment_args).iter().any(|name| name == key.get_ref()) => {
                let why = "is for the whole mount; write it above the first [[gauge]]";
                Err(self.refuse(key.span().start, key.get_ref(), why))
            }
            Some(key) => Err(self.unknown(key.span().start, key.get_ref(), known)),
            None => Ok(()),
        }
    }

    fn unknown(&self, at: usize, word: &str, known: &[String]) -> Error {
        let likeness = |name: &&String| strsim::jaro(word, name);
        let best = known.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
        let why = match best.filter(|name| likeness(name) > 0.7) {
            Some(name) => format!("there is no such option; did you mean `{name}`?"),
            None => format!("there is no such option; there are: {}", known.join(", ")),
        };
        self.refuse(at, word, &why)
    }

    fn section(&self, table: Spanned<DeTable<'_>>) -> Result<Section> {
        let at = table.span().start;
        let place = |key: &Spanned<DeString<'_>>| (key.get_ref().to_string(), key.span().start);
        let keys = table.get_ref().keys().map(place).collect();
        let mut options: GaugeOptions = self.read(table)?;
        make_absolute(options.paths(), self.folder)?;
        let section = Section { options, at, keys };
        match section.options.contradiction() {
            Some((key, why)) => Err(self.refuse(section.place(key), key, why)),
            None => Ok(section),
        }
    }

    fn read<T: DeserializeOwned>(&self, table: Spanned<DeTable<'_>>) -> Result<T> {
        let place =
            |(key, value): (&Spanned<DeString<'_>>, &Spanned<DeValue<'_>>)| -> (String, usize, Range<usize>) {
                (key.get_ref().to_string(), key.span().start, value.span())
            };
        let places: Vec<_> = table.get_ref().iter().map(place).collect();
        T::deserialize(toml::de::Deserializer::from(table)).map_err(|error| {
            let span = error.span().unwrap_or_default();
            let inside = |place: &&(String, usize, Range<usize>)| place.2.contains(&span.start);
            let (key, at) = places.iter().find(inside).map_or(("", span.start), |(key, at, _)| (key, *at));
            self.refuse(at, key, &one_line(error.message()))
        })
    }

    /// The gauges with their defaults. No two are the same.
    fn resolve(&self, sections: Vec<Section>, defaults: &GaugeOptions) -> Result<Vec<GaugeOptions>> {
        if sections.is_empty() {
            let why = "names no gauge; write [[gauge]] and below it the options of one";
            return Err(Error::new(self.name, Cause::Invalid(why.into())));
        }
        let mut taken: HashMap<Mark, usize> = HashMap::new();
        let mut gauges = Vec::new();
        for section in sections {
            let gauge = section.options.clone().over(defaults);
            if gauge.sim.is_none() && gauge.replay.is_none() && gauge.bus.is_none() {
                let why = "says nowhere what it is; add `bus = \"/dev/i2c-1\"`, or give --bus";
                return Err(self.refuse(section.at, "gauge", why));
            }
            for (key, mark) in marks(&gauge) {
                if let Some(other) = taken.insert(mark, section.place(key)) {
                    let why = format!("the same as on line {}; give each gauge its own", self.line(other));
                    return Err(self.refuse(section.place(key), key, &why));
                }
            }
            gauges.push(gauge);
        }
        Ok(gauges)
    }
}

impl Section {
    /// Where a key stands, or else its table.
    fn place(&self, key: &str) -> usize {
        self.keys.get(key).copied().unwrap_or(self.at)
    }
}

/// What only one gauge can have.
#[derive(PartialEq, Eq, Hash)]
enum Mark {
    Name(String),
    Address(PathBuf, u8),
    File(PathBuf),
}

fn marks(gauge: &GaugeOptions) -> Vec<(&'static str, Mark)> {
    let mut marks: Vec<_> = gauge.name.iter().map(|name| ("name", Mark::Name(name.clone()))).collect();
    match Source::of(gauge) {
        Source::Bus { bus, address, .. } => {
            // Two names of one adapter are the same bus.
            let bus = fs::canonicalize(bus).unwrap_or_else(|_| bus.into());
            marks.push(("address", Mark::Address(bus, address)));
        }
        Source::Sim { state: Some(state), .. } => marks.push(("sim-state", Mark::File(state.into()))),
        Source::Sim { .. } | Source::Recording(_) => {}
    }
    marks.extend(gauge.trace.iter().map(|trace| ("trace", Mark::File(trace.clone()))));
    marks
}

/// The names of options as the command line has them.
fn names(augment: impl FnOnce(Command) -> Command) -> Vec<String> {
    let command = augment(Command::new("gaugefs"));
    command.get_arguments().map(|option| option.get_id().as_str().replace('_', "-")).collect()
}

fn one_line(text: &str) -> String {
    text.lines().collect::<Vec<_>>().join(", ")
}

/// A number or a text, taken as the command line would take it.
fn word<'de, D: Deserializer<'de>, T>(
    from: D,
    take: impl FnOnce(&str) -> Result<T, String>,
) -> Result<Option<T>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a number or a text")]
    enum Word {
        Integer(i64),
        Float(f64),
        Text(String),
    }
    let text = match Word::deserialize(from)? {
        Word::Integer(number) => number.to_string(),
        Word::Float(number) => number.to_string(),
        Word::Text(text) => text,
    };
    take(&text).map(Some).map_err(D::Error::custom)
}

/// `true`, or a name.
fn ac_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected true, false or a name")]
    enum Word {
        Shown(bool),
        Name(String),
    }
    Ok(match Word::deserialize(from)? {
        Word::Shown(shown) => shown.then_some(None),
        Word::Name(text) => Some(Some(name(&text).map_err(D::Error::custom)?)),
    })
}

fn chip<'de, D: Deserializer<'de>>(from: D) -> Result<Option<&'static Chip>, D::Error> {
    word(from, |text| {
        let known = CHIPS.iter().copied().find(|chip| chip.name.eq_ignore_ascii_case(text));
        known.ok_or_else(|| format!("`{text}` is not in the list of `gaugefs chips`"))
    })
}

fn sim_key<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Key>, D::Error> {
    word(from, key_words)
}

fn address_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u8>, D::Error> {
    word(from, address)
}

fn name_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    word(from, name)
}

fn interval_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
    word(from, interval)
}

fn factor_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    word(from, factor)
}

fn order_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Order>, D::Error> {
    word(from, order)
}

fn group_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    word(from, group)
}

pub(crate) fn chip_names() -> PossibleValuesParser {
    PossibleValuesParser::new(CHIPS.iter().map(|chip| chip.name))
}

fn known_chips() -> impl TypedValueParser<Value = &'static Chip> {
    chip_names().map(|name| Chip::by_name(&name).expect("clap took only names of chips"))
}

fn key_words(text: &str) -> Result<Key, String> {
    keys::words(text).map(Key).ok_or_else(|| "expected two words, such as '0414 3672'".into())
}

fn order(text: &str) -> Result<Order, String> {
    Order::by_name(text).ok_or_else(|| "expected lsb-first or as-sent".into())
}

pub(crate) fn address(text: &str) -> Result<u8, String> {
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let number = digits.map_or_else(|| text.parse(), |digits| u8::from_str_radix(digits, 16));
    match number {
        Ok(address @ 0x08..=0x77) => Ok(address),
        _ => Err("expected a 7-bit address, 0x08 to 0x77".into()),
    }
}

fn interval(text: &str) -> Result<Duration, String> {
    match text.parse() {
        Ok(seconds @ 0.5..=3600.0) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("expected 0.5 to 3600 seconds".into()),
    }
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor @ 0.001..=1000.0) => Ok(factor),
        _ => Err("expected a factor from 0.001 to 1000".into()),
    }
}

/// The name goes into uevent, paths and other people's shell scripts.
fn name(text: &str) -> Result<String, String> {
    if keys::is_name(text) {
        Ok(text.to_string())
    } else {
        Err("expected letters, digits and . _ + -, at most 64, no dot or dash first".into())
    }
}

fn group(text: &str) -> Result<u32, String> {
    if let Ok(gid) = text.parse() {
        return Ok(gid);
    }
    match nix::unistd::Group::from_name(text) {
        Ok(Some(group)) => Ok(group.gid.as_raw()),
        _ => Err("there is no such group".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_checked() {
        assert_eq!(address("0x55"), Ok(0x55));
        assert_eq!(address("85"), Ok(0x55));
        assert!(["0x07", "0x78", "0xaa", "55h", ""].iter().all(|text| address(text).is_err()));
        assert_eq!(interval("0.5"), Ok(Duration::from_millis(500)));
        assert!(["0.4", "3601", "NaN", "-1", "inf"].iter().all(|text| interval(text).is_err()));
        assert!(["0", "-1", "NaN", "1e9"].iter().all(|text| factor(text).is_err()));
        assert!(["", "..", "a/b", "a b", "-x", "BAT\n"].iter().all(|text| name(text).is_err()));
        assert_eq!(name("BAT_1.2"), Ok("BAT_1.2".into()));
    }
}
