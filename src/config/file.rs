// SPDX-License-Identifier: MIT

//! A configuration file: the tables `[mount]`, `[defaults]`, and any number of `[[gauge]]` and `[[alert]]`. A station's
//! file has `[station]` in place of `[mount]`, accepts `[[slot]]` for `[[gauge]]`, and has no alerts.
//!
//! A file is read strictly. Unknown or meaningless content is an error with file, line and key, and no gauge is opened
//! before the whole file is understood.

use std::collections::HashMap;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::option::{self, At, Opt, Options, Wrong, names};
use super::options::{AlertOptions, MountOptions};
use super::{choice, make_absolute};
use crate::error::{Cause, Error, Result};
use gauge_bus::regular;
use gauge_owner::{GaugeOptions, Source};
use ti_gauge::text::nearest;

/// The subject of a file besides gauges: its first table.
pub(crate) trait Head: Options {
    /// Name of that table and of the subject.
    const NAME: &'static str;
    /// Tables that may occur any number of times.
    const LISTS: &'static [&'static str];
    /// The place where options of a gauge must be valid, if not all of them are.
    const GAUGES: Option<At>;
}

impl Head for MountOptions {
    const NAME: &'static str = "mount";
    const LISTS: &'static [&'static str] = &["gauge", "alert"];
    const GAUGES: Option<At> = None;
}

/// Limit for a file. Thousands of gauges need less.
const LONGEST: u64 = 4 << 20;

/// Reads the options of a mount and of its gauges. Gauges without a source are on `bus`.
pub(super) fn read(
    path: &Path,
    bus: Option<&Path>,
) -> Result<(MountOptions, Vec<GaugeOptions>, Vec<AlertOptions>)> {
    let text = text(path)?;
    let file = File::<MountOptions>::parse(path, &text)?;
    let mut read = file.read()?;
    make_absolute(&mut read.head, folder(path))?;
    Ok((read.head, file.complete(read.gauges, path, bus)?, read.alerts))
}

pub(crate) fn text(path: &Path) -> Result<String> {
    let failed = |error| Error::io(path.display().to_string(), "cannot read it", &error);
    regular::read_text(path, LONGEST).map_err(failed)
}

/// The base folder of a file's relative paths.
pub(crate) fn folder(path: &Path) -> &Path {
    // Standard input has no folder.
    let is_input = path == Path::new(super::STANDARD_INPUT);
    if is_input { Path::new("") } else { path.parent().unwrap_or(Path::new("/")) }
}

/// Reads the mount point and the alerts. The gauges need no source for that.
#[cfg(feature = "screen")]
pub(super) fn alerts(path: &Path) -> Result<(Option<PathBuf>, Vec<AlertOptions>)> {
    let text = text(path)?;
    let file = File::<MountOptions>::parse(path, &text)?;
    let mut read = file.read()?;
    if read.alerts.is_empty() {
        return Err(Error::new(file.name, Cause::Invalid, "no alert; add one below a line [[alert]]"));
    }
    make_absolute(&mut read.head, folder(path))?;
    Ok((read.head.mountpoint, read.alerts))
}

pub(crate) struct File<'a, H> {
    pub(crate) name: String,
    text: &'a str,
    head: Keys<'a>,
    defaults: Keys<'a>,
    gauges: Vec<Item<'a>>,
    alerts: Vec<Item<'a>>,
    about: PhantomData<H>,
}

pub(crate) struct Read<H> {
    pub(crate) head: H,
    pub(crate) gauges: Vec<GaugeOptions>,
    #[cfg_attr(not(feature = "screen"), allow(dead_code, reason = "the commands of that feature use them"))]
    alerts: Vec<AlertOptions>,
}

/// A key with its place and value.
struct Key<'a> {
    name: String,
    at: usize,
    value: DeValue<'a>,
}

/// In the file's order.
type Keys<'a> = Vec<Key<'a>>;

/// A table that may occur any number of times, and its place.
struct Item<'a> {
    at: usize,
    keys: Keys<'a>,
}

impl Item<'_> {
    fn place(&self, name: &str) -> Option<usize> {
        place(&self.keys, name)
    }

    fn has(&self, name: &str) -> bool {
        self.place(name).is_some()
    }
}

fn keys<'a>(table: DeTable<'a>) -> Keys<'a> {
    let key = |(name, value): (Spanned<DeString<'a>>, Spanned<DeValue<'a>>)| Key {
        at: name.span().start,
        name: name.into_inner().into_owned(),
        value: value.into_inner(),
    };
    let mut keys: Keys<'a> = table.into_iter().map(key).collect();
    keys.sort_by_key(|key| key.at);
    keys
}

fn place(keys: &[Key<'_>], name: &str) -> Option<usize> {
    keys.iter().find(|key| key.name == name).map(|key| key.at)
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Table {
    Top,
    Head,
    Defaults,
    Gauge,
    Alert,
}

impl<'a, H: Head> File<'a, H> {
    pub(crate) fn parse(path: &Path, text: &'a str) -> Result<Self> {
        let mut file = Self {
            name: path.display().to_string(),
            text,
            head: Vec::new(),
            defaults: Vec::new(),
            gauges: Vec::new(),
            alerts: Vec::new(),
            about: PhantomData,
        };
        let document = DeTable::parse(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            file.refuse(at, "not TOML", error.message())
        })?;
        for Key { name, at, value } in keys(document.into_inner()) {
            let is_list = H::LISTS.contains(&name.as_str());
            match value {
                DeValue::Table(table) if name == H::NAME => file.head = keys(table),
                DeValue::Table(table) if name == "defaults" => file.defaults = keys(table),
                DeValue::Array(list) if is_list => {
                    let item = |item: Spanned<DeValue<'a>>| {
                        let at = item.span().start;
                        match item.into_inner() {
                            DeValue::Table(table) => Some(Item { at, keys: keys(table) }),
                            _ => None,
                        }
                    };
                    let items = list.into_iter().map(item).collect::<Option<_>>();
                    let items = items.ok_or_else(|| file.refuse(at, &name, &above_each(&name)))?;
                    if name == "alert" { &mut file.alerts } else { &mut file.gauges }.extend::<Vec<_>>(items);
                }
                _ => {
                    let why = match name.as_str() {
                        list if is_list => above_each(list),
                        table if table == H::NAME || table == "defaults" => {
                            format!("write [{table}] above its keys")
                        }
                        _ => Self::unknown(Table::Top, &name),
                    };
                    return Err(file.refuse(at, &name, &why));
                }
            }
        }
        Ok(file)
    }

    pub(crate) fn refuse(&self, at: usize, key: &str, why: &str) -> Error {
        // One line: TOML's own errors, and keys in quotes, may have several.
        let why = why.lines().collect::<Vec<_>>().join(", ");
        let key = if key.is_empty() { "\"\"".into() } else { key.escape_debug().to_string() };
        let subject = format!("{}: line {}: {key}", self.name, self.line(at));
        Error::new(subject, Cause::Invalid, why)
    }

    fn line(&self, at: usize) -> usize {
        1 + self.text.bytes().take(at).filter(|&byte| byte == b'\n').count()
    }

    pub(crate) fn place(&self, name: &str) -> Option<usize> {
        place(&self.head, name)
    }

    /// Reads every table. Each gauge's table includes the defaults.
    pub(crate) fn read(&self) -> Result<Read<H>> {
        let head = self.options(Table::Head, &self.head)?;
        // Bad defaults are refused even without a gauge.
        self.options::<GaugeOptions>(Table::Defaults, &self.defaults)?;
        let gauge = |gauge: &Item<'_>| {
            self.check_keys(gauge)?;
            let defaults = self.defaults.iter().filter(|default| is_default_of(gauge, &default.name));
            self.options(Table::Gauge, defaults.chain(&gauge.keys))
        };
        let gauges = self.gauges.iter().map(gauge).collect::<Result<_>>()?;
        let alert = |alert: &Item<'_>| match alert.has("when") {
            true => self.options(Table::Alert, &alert.keys),
            false => Err(self.refuse(alert.at, "alert", "missing field `when`")),
        };
        let alerts = self.alerts.iter().map(alert).collect::<Result<_>>()?;
        Ok(Read { head, gauges, alerts })
    }

    fn options<'k, T: Options>(&self, table: Table, keys: impl IntoIterator<Item = &'k Key<'a>>) -> Result<T>
    where
        'a: 'k,
    {
        let place = if table == Table::Defaults { At::Defaults } else { At::Table };
        let mut options = T::default();
        for Key { name, at, value } in keys {
            let refuse = |why: String| self.refuse(*at, name, &why);
            let row = T::row(name).filter(|row| row.is_at(place));
            let row = row.ok_or_else(|| refuse(Self::unknown(table, name)))?;
            if matches!(table, Table::Defaults | Table::Gauge)
                && H::GAUGES.is_some_and(|place| !row.is_at(place))
            {
                return Err(refuse(format!("has no meaning at a {}; remove it", H::NAME)));
            }
            row.read(&mut options, value).map_err(|Wrong { why, within }| match within {
                Some((key, at)) => self.refuse(at, &key, &why),
                None => refuse(why),
            })?;
        }
        Ok(options)
    }

    /// Refuses incompatible keys of a gauge.
    fn check_keys(&self, gauge: &Item<'_>) -> Result<()> {
        for Key { name, at, .. } in &gauge.keys {
            let Some(row) = GaugeOptions::row(name) else { continue };
            if let Some(other) = row.not_with.iter().find(|other| gauge.has(other)) {
                return Err(self.refuse(*at, name, &format!("cannot be combined with {other}")));
            }
            if let Some(needed) = row.needs.filter(|needed| !gauge.has(needed)) {
                let why = format!("only together with {needed}; set {needed} too, or remove this key");
                return Err(self.refuse(*at, name, &why));
            }
        }
        Ok(())
    }

    /// The gauges, with absolute paths. Each has a source, and no two share what only one can have.
    pub(crate) fn complete(
        &self,
        mut gauges: Vec<GaugeOptions>,
        path: &Path,
        bus: Option<&Path>,
    ) -> Result<Vec<GaugeOptions>> {
        if gauges.is_empty() {
            let why = "no gauge; add one below a line [[gauge]]";
            return Err(Error::new(&self.name, Cause::Invalid, why));
        }
        let mut taken: HashMap<Mark, usize> = HashMap::new();
        for (written, gauge) in self.gauges.iter().zip(&mut gauges) {
            make_absolute(gauge, folder(path))?;
            choice::make_absolute(gauge, folder(path))?;
            if let Some(bus) = bus
                && !["bus", "sim", "replay"].iter().any(|source| written.has(source))
            {
                GaugeOptions::row("bus").expect("it is an option").set_path(gauge, bus.to_path_buf());
            }
            if Source::of(gauge).is_err() {
                let why = "no source given; below it, set bus = \"/dev/i2c-1\", sim or replay, or pass --bus";
                return Err(self.refuse(written.at, "[[gauge]]", why));
            }
            for (key, mark) in marks(gauge) {
                // Without the key, the default comes from the gauge as a whole.
                let at = written.place(key).unwrap_or(written.at);
                if let Some(other) = taken.insert(mark, at) {
                    let why = format!("the same as on line {}; give each gauge its own", self.line(other));
                    return Err(self.refuse(at, key, &why));
                }
            }
        }
        Ok(gauges)
    }

    /// The error for a key that cannot be in its table.
    fn unknown(table: Table, key: &str) -> String {
        let head = H::NAME;
        let known = |known: Vec<&str>| known.join(", ");
        if table == Table::Alert {
            return format!(
                "unknown key; known below [[alert]] are {}",
                known(names::<AlertOptions>(At::Table).collect())
            );
        }
        match GaugeOptions::row(key) {
            Some(row) if !row.is_at(At::Defaults) => {
                return "belongs to one gauge; move it below its [[gauge]]".into();
            }
            _ if H::row(key).is_some() => return format!("belongs to the {head}; move it below [{head}]"),
            Some(_) => {
                return "belongs to the gauges; move it below [defaults], or below a [[gauge]]".into();
            }
            None => {}
        }
        if let Some(meant) = Self::nearest(key) {
            return format!("unknown key; did you mean {meant}?");
        }
        let here = match table {
            Table::Top => {
                let lists = H::LISTS.iter().map(|list| format!("[[{list}]]"));
                let tables = [format!("[{head}]"), "[defaults]".into()].into_iter().chain(lists);
                let tables = tables.collect::<Vec<_>>().join(", ");
                return format!("unknown key; a file has the tables {tables}");
            }
            Table::Head => known(names::<H>(At::Table).collect()),
            Table::Defaults => known(names::<GaugeOptions>(At::Defaults).collect()),
            Table::Gauge | Table::Alert => known(names::<GaugeOptions>(At::Table).collect()),
        };
        format!("unknown key; known here are {here}")
    }

    /// A known key or table close to a misspelt one.
    fn nearest(word: &str) -> Option<String> {
        let tables = [H::NAME, "defaults"].into_iter().chain(H::LISTS.iter().copied());
        let names = names::<GaugeOptions>(At::Table).chain(names::<H>(At::Table)).chain(tables);
        Some(match nearest(&word.replace('_', "-"), names)? {
            table if H::LISTS.contains(&table) => format!("[[{table}]]"),
            table if table == H::NAME || table == "defaults" => format!("[{table}]"),
            key => format!("`{key}`"),
        })
    }
}

fn above_each(list: &str) -> String {
    format!("write [[{list}]] above the keys of each {list}")
}

/// Whether a default applies to this gauge. The gauge's own options come first, and drop defaults that contradict them.
/// A simulated or recorded gauge does not get the others' bus.
fn is_default_of(gauge: &Item<'_>, default: &str) -> bool {
    let contradicts = |row: &Opt<GaugeOptions>, other: &str| row.not_with.contains(&other);
    let row = GaugeOptions::row(default);
    gauge.keys.iter().all(|own| {
        own.name != default
            && !row.is_some_and(|row| contradicts(row, &own.name))
            && !GaugeOptions::row(&own.name).is_some_and(|row| contradicts(row, default))
    })
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
    if let Ok(Source::Bus { bus, address, .. }) = Source::of(gauge) {
        // Two names of an adapter mean the same bus.
        let bus = std::fs::canonicalize(&bus).unwrap_or(bus);
        marks.push(("address", Mark::Address(bus, address)));
    }
    marks.extend(option::written(gauge).map(|(option, file)| (option, Mark::File(file))));
    marks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gauges(text: &str) -> Vec<GaugeOptions> {
        let path = Path::new("/etc/gauges.toml");
        let file = File::<MountOptions>::parse(path, text).expect("TOML");
        let read = file.read().unwrap_or_else(|error| panic!("{error}"));
        file.complete(read.gauges, path, Some(Path::new("/dev/i2c-9"))).expect("they have a source")
    }

    #[test]
    fn a_gauge_goes_before_the_defaults_and_what_contradicts_it_is_left_out() {
        let gauges = gauges(
            "[defaults]\nbus = '/dev/i2c-1'\naddress = 0x56\nchip = 'bq27427'\nrestore = 'image'\npoll = 10\n\
             energy = true\nwrites-per-hour = 3\nkey-file = 'keys'\n\
             [[gauge]]\n\
             [[gauge]]\nbus = '/dev/i2c-2'\npoll = '1min'\nenergy = false\nwrites-per-hour = 0\n\
             [[gauge]]\nsim = 'bq27427'\n\
             [[gauge]]\nreplay = 'recording'\n",
        );
        let shown = gauges.iter().map(|gauge| {
            let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
            let place = (path(&gauge.bus), gauge.address, gauge.chip.is_some());
            let rest = (path(&gauge.profile), gauge.poll.map(|poll| poll.as_secs()), gauge.energy);
            (place, rest, gauge.writes_per_hour, path(&gauge.key_file))
        });
        let text = |text: &str| Some(text.to_string());
        let (image, keys) = (text("/etc/image"), text("/etc/keys"));
        let expected = [
            ((text("/dev/i2c-9"), Some(0x56), true), (image.clone(), Some(10), true), Some(3), keys.clone()),
            ((text("/dev/i2c-2"), Some(0x56), true), (image.clone(), Some(60), false), Some(0), keys.clone()),
            ((None, None, false), (image, Some(10), true), Some(3), keys.clone()),
            ((None, None, false), (None, Some(10), true), None, keys),
        ];
        assert_eq!(shown.collect::<Vec<_>>(), expected);
    }
}
