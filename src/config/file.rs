//! A configuration file: the tables `[mount]`, `[defaults]` and any number of `[[gauge]]` and `[[alert]]`; a station's
//! file has `[station]` in place of `[mount]`, and no alerts.
//!
//! A file is read strictly. Whatever it holds that is not known or makes no sense is an error with file,
//! line and key, and no gauge is opened before the whole file has been understood.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::{AlertOptions, GaugeOptions, MountOptions, make_absolute, values};
use crate::error::{Cause, Error, Result};
use gauge_bus::regular;
use gauge_owner::Source;
use ti_gauge::text::nearest;

/// The gauges of a configuration file.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Gauges {
    defaults: GaugeOptions,
    pub(super) gauge: Vec<Spanned<GaugeOptions>>,
}

/// The tables of [`Gauges`].
const OF_GAUGES: [&str; 2] = ["defaults", "gauge"];

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OfMount {
    mount: MountOptions,
    alert: Vec<AlertOptions>,
}

/// The table of a file that is not about gauges.
pub(super) struct Head {
    /// Its name, which is also its subject.
    name: &'static str,
    /// The tables of which there may be any number.
    lists: &'static [&'static str],
    keys: Vec<String>,
}

impl Head {
    pub(super) fn of<Options: Args>(name: &'static str, lists: &'static [&'static str]) -> Self {
        Self { name, lists, keys: keys::<Options>() }
    }

    pub(super) fn with_keys(
        name: &'static str,
        lists: &'static [&'static str],
        keys: &[&'static str],
    ) -> Self {
        Self { name, lists, keys: keys.iter().map(ToString::to_string).collect() }
    }
}

/// Largest size of a file. Thousands of gauges need less.
const LONGEST: u64 = 4 << 20;
/// Keys that belong to one gauge, and are no defaults for many.
const OWN: [&str; 7] = ["sim", "sim-state", "sim-key", "replay", "name", "trace", "trace-replace"];
/// Keys of one gauge, and those that cannot be combined with them. The command line refuses the same.
const CONFLICTS: [(&str, &[&str]); 2] = [
    ("sim", &["replay", "bus", "address", "chip"]),
    ("replay", &["bus", "address", "chip", "restore", "trace", "trace-replace"]),
];
/// Keys that are for simulated gauges only.
const OF_SIM: [&str; 2] = ["sim-state", "sim-key"];

/// Reads the options of a mount and of its gauges. Those are on `bus` where the file gives them no source.
pub(super) fn read(path: &Path, bus: Option<PathBuf>) -> Result<(MountOptions, Vec<GaugeOptions>)> {
    let text = text(path)?;
    let head = of_mount();
    let (file, OfMount { mut mount, .. }, gauges) = File::read::<OfMount>(path, &text, head)?;
    make_absolute(mount.paths(), folder(path))?;
    Ok((mount, file.gauges(gauges, path, bus)?))
}

fn of_mount() -> Head {
    Head::of::<MountOptions>("mount", &["gauge", "alert"])
}

pub(super) fn text(path: &Path) -> Result<String> {
    let failed = |error| Error::io(path.display().to_string(), "cannot read it", &error);
    regular::read_text(path, LONGEST).map_err(failed)
}

/// The folder at which the relative paths of a file begin.
pub(super) fn folder(path: &Path) -> &Path {
    // Standard input has none.
    let is_input = path == Path::new(super::STANDARD_INPUT);
    if is_input { Path::new("") } else { path.parent().unwrap_or(Path::new("/")) }
}

/// Reads the mount point and the alerts. Whether the gauges have a source does not matter to them.
#[cfg(feature = "screen")]
pub(super) fn alerts(path: &Path) -> Result<(Option<PathBuf>, Vec<AlertOptions>)> {
    let text = text(path)?;
    let (file, OfMount { mut mount, alert }, _) = File::read::<OfMount>(path, &text, of_mount())?;
    if alert.is_empty() {
        return Err(Error::new(file.name, Cause::Invalid("no alert; add one below a line [[alert]]".into())));
    }
    make_absolute(mount.mountpoint.iter_mut(), folder(path))?;
    Ok((mount.mountpoint, alert))
}

/// A configuration file that is being read.
pub(super) struct File<'a> {
    pub(super) name: String,
    text: &'a str,
    head: Head,
    places: Vec<Place>,
}

/// The place of a key.
pub(super) struct Place {
    table: Table,
    pub(super) key: String,
    pub(super) at: usize,
    value: Range<usize>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Table {
    /// The file outside of any table.
    Top,
    Head,
    Defaults,
    /// By its number in the file.
    Gauge(usize),
    /// Likewise.
    Alert(usize),
}

impl<'a> File<'a> {
    fn line(&self, at: usize) -> usize {
        1 + self.text.bytes().take(at).filter(|&byte| byte == b'\n').count()
    }

    /// An error about a key of the file.
    pub(super) fn refuse(&self, at: usize, key: &str, why: &str) -> Error {
        // One line: TOML's own errors may have several, and so may a key in quotes.
        let why = why.lines().collect::<Vec<_>>().join(", ");
        let key = if key.is_empty() { "\"\"".into() } else { key.escape_debug().to_string() };
        let subject = format!("{}: line {}: {key}", self.name, self.line(at));
        Error::new(subject, Cause::Invalid(why))
    }

    pub(super) fn place(&self, table: Table, key: &str) -> Option<&Place> {
        self.places.iter().find(|place| place.table == table && place.key == key)
    }

    /// Reads the table of its head and those of the gauges.
    pub(super) fn read<H: DeserializeOwned>(
        path: &Path,
        text: &'a str,
        head: Head,
    ) -> Result<(Self, H, Gauges)> {
        let mut file = Self { name: path.display().to_string(), text, head, places: Vec::new() };
        file.places = places(file.parse()?.get_ref(), &file.head);
        let head = file.tables(|key| !OF_GAUGES.contains(&key))?;
        let gauges: Gauges = file.tables(|key| OF_GAUGES.contains(&key))?;
        file.check_keys(gauges.gauge.len())?;
        Ok((file, head, gauges))
    }

    fn parse(&self) -> Result<Spanned<DeTable<'a>>> {
        DeTable::parse(self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            self.refuse(at, "not TOML", error.message())
        })
    }

    /// Parses the wanted tables only.
    fn tables<T: DeserializeOwned>(&self, wanted: impl Fn(&str) -> bool) -> Result<T> {
        let mut document = self.parse()?;
        let all = std::mem::take(document.get_mut());
        *document.get_mut() = all.into_iter().filter(|(key, _)| wanted(key.get_ref())).collect();
        T::deserialize(toml::de::Deserializer::from(document)).map_err(|error| self.explain(&error))
    }

    /// The gauges, complete and with absolute paths.
    pub(super) fn gauges(
        &self,
        gauges: Gauges,
        path: &Path,
        bus: Option<PathBuf>,
    ) -> Result<Vec<GaugeOptions>> {
        let Gauges { mut defaults, mut gauge } = gauges;
        let paths = gauge.iter_mut().flat_map(|gauge| gauge.get_mut().paths());
        make_absolute(defaults.paths().chain(paths), folder(path))?;
        defaults.bus = bus.or(defaults.bus);
        self.complete(gauge, &defaults)
    }

    /// The error for a place in the file that does not fit the structs above.
    fn explain(&self, error: &toml::de::Error) -> Error {
        let at = error.span().unwrap_or_default().start;
        // Keys of a table come after the table, so the last place is the innermost one.
        let is_in = |place: &&Place| place.at == at || place.value.contains(&at);
        let Some(Place { table, key, at: start, .. }) = self.places.iter().rev().find(is_in) else {
            return self.refuse(at, "not a configuration", error.message());
        };
        let why = match (table, key.as_str()) {
            (Table::Top, "gauge") => "write [[gauge]] above the keys of each gauge".into(),
            (Table::Top, "alert") if !error.message().starts_with("missing field") => {
                "write [[alert]] above the keys of each alert".into()
            }
            (Table::Top, name) if name == self.head.name || name == "defaults" => {
                format!("write [{key}] above its keys")
            }
            // It is about the key itself, not about its value.
            _ if *start == at => self.unknown(*table, key),
            _ => error.message().into(),
        };
        self.refuse(*start, key, &why)
    }

    /// Refuses keys that do not belong together.
    fn check_keys(&self, gauges: usize) -> Result<()> {
        for place in self.places.iter().filter(|place| place.key == "address") {
            // A decimal number, as it was written.
            let written = self.text[place.value.clone()].trim_matches(['"', '\'']);
            let is_decimal = written.bytes().all(|byte| byte.is_ascii_digit());
            if let Some(why) = values::address(written).err().filter(|_| is_decimal) {
                return Err(self.refuse(place.at, &place.key, &why));
            }
        }
        if let Some(own) = OWN.iter().find_map(|key| self.place(Table::Defaults, key)) {
            return Err(self.refuse(own.at, &own.key, &self.unknown(own.table, &own.key)));
        }
        for table in (0..gauges).map(Table::Gauge) {
            for (key, others) in CONFLICTS.iter().filter(|(key, _)| self.place(table, key).is_some()) {
                if let Some(other) = others.iter().find_map(|other| self.place(table, other)) {
                    return Err(self.refuse(other.at, &other.key, &format!("cannot be combined with {key}")));
                }
            }
            if let Some(place) = OF_SIM.iter().find_map(|key| self.place(table, key))
                && self.place(table, "sim").is_none()
            {
                let why = "only for simulated gauges; set sim too, or remove this key";
                return Err(self.refuse(place.at, &place.key, why));
            }
        }
        Ok(())
    }

    /// The gauges with their defaults. Each has a source, and no two share what only one can have.
    fn complete(
        &self,
        gauges: Vec<Spanned<GaugeOptions>>,
        defaults: &GaugeOptions,
    ) -> Result<Vec<GaugeOptions>> {
        if gauges.is_empty() {
            let why = "no gauge; add one below a line [[gauge]]";
            return Err(Error::new(&self.name, Cause::Invalid(why.into())));
        }
        let mut taken: HashMap<Mark, usize> = HashMap::new();
        let mut complete = Vec::new();
        for (number, gauge) in gauges.into_iter().enumerate() {
            let start = gauge.span().start;
            let gauge = gauge.into_inner().over(defaults);
            if gauge.sim.is_none() && gauge.replay.is_none() && gauge.bus.is_none() {
                let why = "no source given; below it, set bus = \"/dev/i2c-1\", sim or replay, or pass --bus";
                return Err(self.refuse(start, "[[gauge]]", why));
            }
            for (key, mark) in marks(&gauge) {
                // Without the key, the gauge as a whole is where the default is from.
                let at = self.place(Table::Gauge(number), key).map_or(start, |place| place.at);
                if let Some(other) = taken.insert(mark, at) {
                    let why = format!("the same as on line {}; give each gauge its own", self.line(other));
                    return Err(self.refuse(at, key, &why));
                }
            }
            complete.push(gauge);
        }
        Ok(complete)
    }

    /// The error for a key that cannot be in its table.
    fn unknown(&self, table: Table, key: &str) -> String {
        let head = self.head.name;
        let of_gauge = keys::<GaugeOptions>();
        let is_of = |keys: &[String]| keys.iter().any(|known| known == key);
        if let Table::Alert(_) = table {
            let of_alert = keys::<AlertOptions>().join(", ");
            return format!("unknown key; known below [[alert]] are gauge, {of_alert}");
        }
        if OWN.contains(&key) {
            return "belongs to one gauge; move it below its [[gauge]]".into();
        }
        if is_of(&self.head.keys) {
            return format!("belongs to the {head}; move it below [{head}]");
        }
        if is_of(&of_gauge) {
            return "belongs to the gauges; move it below [defaults], or below a [[gauge]]".into();
        }
        if let Some(known) = self.nearest(key) {
            return format!("unknown key; did you mean {known}?");
        }
        let here = match table {
            Table::Top => {
                let lists = self.head.lists.iter().map(|list| format!("[[{list}]]")).collect::<Vec<_>>();
                let tables = [format!("[{head}]"), "[defaults]".into()].into_iter().chain(lists);
                let tables = tables.collect::<Vec<_>>().join(", ");
                return format!("unknown key; a file has the tables {tables}");
            }
            Table::Head => self.head.keys.clone(),
            Table::Defaults => of_gauge.into_iter().filter(|key| !OWN.contains(&key.as_str())).collect(),
            Table::Gauge(_) | Table::Alert(_) => of_gauge,
        };
        format!("unknown key; known here are {}", here.join(", "))
    }

    /// The key or table that was probably meant.
    fn nearest(&self, word: &str) -> Option<String> {
        let tables = [self.head.name, "defaults"].into_iter().chain(self.head.lists.iter().copied());
        let (of_gauge, of_head) = (keys::<GaugeOptions>(), &self.head.keys);
        let names = of_gauge.iter().chain(of_head).map(String::as_str).chain(tables);
        Some(match nearest(&word.replace('_', "-"), names)? {
            table if self.head.lists.contains(&table) => format!("[[{table}]]"),
            table if table == self.head.name || table == "defaults" => format!("[{table}]"),
            key => format!("`{key}`"),
        })
    }
}

/// All keys of a file: those outside of tables, and those of the tables that are known.
fn places(document: &DeTable<'_>, head: &Head) -> Vec<Place> {
    let mut places = Vec::new();
    let mut add = |table, (key, value): (&Spanned<DeString<'_>>, &Spanned<DeValue<'_>>)| {
        places.push(Place {
            table,
            key: key.get_ref().to_string(),
            at: key.span().start,
            value: value.span(),
        });
    };
    for (key, value) in document {
        add(Table::Top, (key, value));
        match (key.get_ref().as_ref(), value.get_ref()) {
            (name, DeValue::Table(table)) if name == head.name => {
                table.iter().for_each(|key| add(Table::Head, key));
            }
            ("defaults", DeValue::Table(table)) => table.iter().for_each(|key| add(Table::Defaults, key)),
            (kind, DeValue::Array(list)) if head.lists.contains(&kind) => {
                let place = if kind == "gauge" { Table::Gauge } else { Table::Alert };
                for (number, item) in list.iter().enumerate() {
                    let table = item.get_ref().as_table();
                    table.into_iter().flatten().for_each(|key| add(place(number), key));
                }
            }
            _ => {}
        }
    }
    places
}

/// The names of options as the command line has them.
fn keys<Options: Args>() -> Vec<String> {
    let command = Options::augment_args(Command::new("gaugefs"));
    command.get_arguments().map(|option| option.get_id().as_str().replace('_', "-")).collect()
}

/// A property that only one gauge can have.
#[derive(PartialEq, Eq, Hash)]
enum Mark {
    Name(String),
    Address(PathBuf, u8),
    File(PathBuf),
}

fn marks(gauge: &GaugeOptions) -> Vec<(&'static str, Mark)> {
    let mut marks: Vec<_> = gauge.name.iter().map(|name| ("name", Mark::Name(name.clone()))).collect();
    match gauge.source() {
        Source::Bus { bus, address, .. } => {
            // Two names of one adapter are the same bus.
            let bus = std::fs::canonicalize(&bus).unwrap_or(bus);
            marks.push(("address", Mark::Address(bus, address)));
        }
        Source::Sim { state: Some(state), .. } => marks.push(("sim-state", Mark::File(state))),
        Source::Sim { .. } | Source::Recording(_) => {}
    }
    marks.extend(gauge.trace.iter().map(|trace| ("trace", Mark::File(trace.clone()))));
    marks
}
