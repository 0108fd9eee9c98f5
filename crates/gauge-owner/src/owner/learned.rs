// SPDX-License-Identifier: MIT

//! What a gauge with RAM has learned, kept beside the journals: a loss of power takes it. It belongs to the pack, which
//! such a gauge cannot tell from another: only one with a name (`--pack`) gets it back; otherwise it waits for a person.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::claim::Claim;
use super::signed::{is_own, signed, temporary};
use crate::error::{Error, Result};
use ti_gauge::chip::{Chip, Parameter};
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::image::{Image, toml};
use ti_gauge::journal;
use ti_gauge::value::Value;

/// Versions of a pack that are kept: so many newest, and the last of each of so many days, as errors may show late.
const KEPT: usize = 10;
const DAYS: usize = 30;
const SUFFIX: &str = ".learned.toml";
/// Least time between two looks at what was learned: a gauge learns with charges and discharges.
pub(super) const EVERY: Duration = Duration::from_secs(15 * 60);

/// The folder with what the gauges in one place have learned.
#[derive(Clone, Debug)]
pub struct Learned {
    folder: PathBuf,
    key: String,
    pack: Option<String>,
    /// The pack itself shows that name, wherever it is.
    anywhere: bool,
    trusted: journal::Trusted,
}

/// What somebody wants of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// To see what is kept.
    Show,
    /// To have a version written to the gauge now; the newest one that can be, if none is named.
    Restore(Option<Version>),
    /// To have it removed.
    Forget,
}

/// A version's name: until when that was learned, such as 20261125T093000Z.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version(String);

impl Version {
    /// A version's name, in upper or lower case; `None` for another text.
    pub fn parse(text: &str) -> Option<Self> {
        let time: Timestamp = text.to_ascii_uppercase().parse().ok()?;
        Some(Self::at(time)).filter(|version| version.0.eq_ignore_ascii_case(text))
    }

    fn at(time: Timestamp) -> Self {
        Self(time.strftime("%Y%m%dT%H%M%SZ").to_string())
    }

    /// A version that is newer also by a clock that was put back. If that stays far behind, days pass as well.
    fn next(&self, now: Timestamp) -> Option<Self> {
        let last: Timestamp = self.0.parse().ok()?;
        let [second, pause] = [Duration::from_secs(1), EVERY].map(SignedDuration::try_from);
        let (second, pause) = (second.ok()?, pause.ok()?);
        let step = if last.duration_since(now) < pause { second } else { pause };
        Some(Self::at(now.max(last.checked_add(step).ok()?)))
    }

    fn after(&self) -> Option<Self> {
        self.next(self.0.parse().ok()?)
    }

    fn day(&self) -> &str {
        self.0.split_once('T').map_or(&self.0, |(day, _)| day)
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Learned {
    /// What is learned at the place that `key` identifies, by a pack of that name.
    pub fn new(folder: PathBuf, key: String, pack: Option<String>) -> Self {
        Self { folder, key, pack, anywhere: false, trusted: || None }
    }

    /// Also believes versions of that account, as [`journal::Journal::trusting`] does.
    #[must_use]
    pub fn trusting(self, account: journal::Trusted) -> Self {
        Self { trusted: account, ..self }
    }

    pub(super) fn pack_name(&self) -> Option<&str> {
        self.pack.as_deref()
    }

    /// What a pack of another name, or of none, learns there.
    pub(super) fn of_pack(self, pack: Option<String>) -> Self {
        Self { pack, anywhere: false, ..self }
    }

    /// What a pack learns that shows its name itself: it may have learned in other places, too.
    pub(super) fn of_pack_anywhere(self, pack: Option<String>) -> Self {
        Self { pack, anywhere: true, ..self }
    }

    pub(super) fn claim(&self, chip: &Chip, before: Option<Claim>) -> Option<Claim> {
        let pack = self.pack.as_deref()?;
        let is_it = |claim: &Claim| claim.is_of(chip.name, pack, self.anywhere);
        before.filter(is_it).or_else(|| Claim::new(&self.folder, chip.name, pack, self.anywhere))
    }

    /// The part of a file's name that tells packs apart. No pack has an empty name.
    fn pack(&self) -> &str {
        self.pack.as_deref().unwrap_or_default()
    }

    /// The files of this host, of this part in this place, or in all places: the pack, the version, and where it is.
    fn all(&self, chip: &Chip) -> impl Iterator<Item = (String, Version, PathBuf)> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let infix = format!("-{}-", chip.name);
        entries.filter_map(move |entry| {
            let name = entry.file_name().into_string().ok()?;
            entry.file_type().is_ok_and(|kind| kind.is_file()).then_some(())?;
            let (key, rest) = name.strip_suffix(SUFFIX)?.split_once(&infix)?;
            (self.anywhere || key == self.key).then_some(())?;
            let (pack, time) = rest.rsplit_once('-')?;
            is_own(&entry.path()).then_some(())?;
            Some((pack.to_string(), Version::parse(time)?, entry.path()))
        })
    }

    /// The versions of this pack, oldest first.
    pub(super) fn files(&self, chip: &Chip) -> Vec<(Version, PathBuf)> {
        let of_pack = self.all(chip).filter(|(pack, ..)| pack == self.pack());
        let mut files: Vec<_> = of_pack.map(|(_, version, path)| (version, path)).collect();
        files.sort();
        files
    }

    /// The newest version that can be read and is plausible, and why newer ones do not count.
    pub(super) fn newest(
        &self,
        chip: &'static Chip,
        design: Option<i64>,
    ) -> (Option<(Version, Image)>, Vec<String>) {
        let mut dropped = Vec::new();
        for (version, path) in self.files(chip).into_iter().rev() {
            match self.read(&path, chip, design) {
                Ok(image) => return (Some((version, image)), dropped),
                Err(why) => dropped.push(why),
            }
        }
        (None, dropped)
    }

    /// The version that somebody has named, also of a pack without a name: the person knows whose it is.
    pub(super) fn named(
        &self,
        version: &Version,
        chip: &'static Chip,
        design: Option<i64>,
    ) -> Result<Image, String> {
        let files = self.files(chip);
        let nameless = self.clone().of_pack(None).files(chip);
        if let Some((_, path)) = files.iter().chain(&nameless).find(|(other, _)| other == version) {
            return self.read(path, chip, design);
        }
        if let Some((pack, ..)) = self.all(chip).find(|(_, other, _)| other == version) {
            let [of, here] = [&*pack, self.pack()].map(named_pack);
            return Err(format!("{version} was learned with {of}, and this is {here}"));
        }
        let there: Vec<_> = files.iter().chain(&nameless).map(|(version, _)| version.0.as_str()).collect();
        Err(match there[..] {
            [] => "nothing is kept of it".into(),
            _ => format!("there is no version {version}; there are {}", there.join(", ")),
        })
    }

    fn read(&self, path: &Path, chip: &'static Chip, design: Option<i64>) -> Result<Image, String> {
        self.trust(path).map_err(|error| error.to_string())?;
        let image = Image::open(path, Some(chip)).map_err(|error| error.to_string())?;
        let why = match (design_of(&image), design) {
            (Some(was), Some(now)) if was != now => {
                Some(format!("it was learned with a Design Capacity of {was} mAh, and the profile has {now}"))
            }
            _ => implausible(&image, design),
        };
        why.map_or(Ok(image), |why| Err(format!("{}: {why}", path.display())))
    }

    fn trust(&self, path: &Path) -> Result<()> {
        [&self.folder, path].into_iter().try_for_each(|path| journal::check(path, self.trusted))
    }

    /// Saves a version, unless the newest one would restore the same. On return it is on disk.
    pub(super) fn save(&self, image: &Image, now: Timestamp) -> Result<bool> {
        let text = toml::write(image);
        let files = self.files(image.chip);
        let is_same = |(_, path): &(Version, PathBuf)| {
            let newest = self.trust(path).ok().and_then(|()| Image::open(path, Some(image.chip)).ok());
            newest.is_some_and(|newest| content(&newest) == content(image))
        };
        if files.last().is_some_and(is_same) {
            return Ok(false);
        }
        let mut version = match files.last() {
            Some((last, _)) => last.next(now).unwrap_or_else(|| last.clone()),
            None => Version::at(now),
        };
        let path = |version: &Version| {
            let name = format!("{}-{}-{}-{version}{SUFFIX}", self.key, image.chip.name, self.pack());
            self.folder.join(name)
        };
        // Another host may have one of that name.
        while path(&version).exists() {
            let Some(after) = version.after() else { break };
            version = after;
        }
        let (path, temporary) = (path(&version), self.folder.join(temporary(&self.key, "learned")));
        journal::save(&path, &temporary, &signed(&text)).map_err(|error| {
            Error::io(path.display().to_string(), "cannot save what the gauge has learned", &error)
        })?;
        for old in superfluous(&self.files(image.chip)) {
            if let Err(error) = fs::remove_file(old) {
                log::warn!("{}: cannot remove this old version: {error}", old.display());
            }
        }
        Ok(true)
    }

    /// Removes all versions, also if one of them cannot be removed.
    pub(super) fn forget(&self, chip: &Chip) -> Result<usize> {
        let files = self.files(chip);
        let remove = |(_, path): &(Version, PathBuf)| {
            fs::remove_file(path)
                .map_err(|error| Error::io(path.display().to_string(), "cannot be removed", &error))
        };
        let removed: Vec<_> = files.iter().rev().map(remove).collect();
        removed.into_iter().collect::<Result<()>>().map(|()| files.len())
    }

    /// What is kept, as a text. A gauge that `has_profile` gets it back by itself, unless the pack is `contested`.
    pub(super) fn told(
        &self,
        chip: &'static Chip,
        design: Option<i64>,
        has_profile: bool,
        contested: Option<&Error>,
    ) -> String {
        let (newest, dropped) = self.newest(chip, design);
        let mut text = String::new();
        if let Some((version, image)) = &newest {
            text += &format!("{}: learned until {version}\n", named_pack(self.pack()));
            for entry in &image.entries {
                text += &format!("  {} = {}\n", image.name(entry), entry.shown());
            }
        }
        for why in &dropped {
            text += &format!("not restored: {why}\n");
        }
        let mut older = self.files(chip);
        older.retain(|(version, _)| newest.as_ref().is_some_and(|(newest, _)| version < newest));
        if !older.is_empty() {
            text += &format!("older versions in {}; --restore=VERSION writes one:\n", self.folder.display());
            text += &self.list(&older, chip, design);
        }
        let nameless = self.clone().of_pack(None).files(chip);
        if self.pack.is_some() && !nameless.is_empty() {
            text += "learned before the pack had a name; --restore=VERSION writes one, if it is this pack:\n";
            text += &self.list(&nameless, chip, design);
        }
        if let Some(error) = contested {
            text += &format!("{}\n", error.reason());
            return text;
        }
        text += match (&newest, &self.pack) {
            (None, _) => "nothing is kept that could be restored\n",
            (Some(_), Some(_)) if !has_profile => {
                "not restored by itself: the gauge has no profile; name one with --profile\n"
            }
            (Some(_), Some(_)) => "restored with the profile after a loss of power\n",
            (Some(_), None) => {
                "not restored by itself: nothing tells packs of this part apart after a loss of power; name the pack with \
                 --pack, or write --restore\n"
            }
        };
        text
    }

    fn list(&self, versions: &[(Version, PathBuf)], chip: &'static Chip, design: Option<i64>) -> String {
        let line = |(version, path): &(Version, PathBuf)| match self.read(path, chip, design) {
            Ok(image) => {
                let capacities = image.entries.iter().filter(|entry| is_capacity(entry.parameter));
                let shown = |entry| format!("{} = {}", image.name(entry), entry.shown());
                format!("  {version}  {}\n", capacities.map(shown).collect::<Vec<_>>().join(", "))
            }
            Err(why) => format!("  {version}  not restored: {why}\n"),
        };
        versions.iter().rev().map(line).collect()
    }
}

/// The versions that are not kept. Days are counted by the versions, not by the clock.
fn superfluous(files: &[(Version, PathBuf)]) -> Vec<&Path> {
    let (mut days, mut day) = (0, "");
    let mut superfluous = Vec::new();
    for (number, (version, path)) in files.iter().rev().enumerate() {
        let is_last = std::mem::replace(&mut day, version.day()) != version.day();
        days += usize::from(is_last);
        if number >= KEPT && !(is_last && days <= DAYS) {
            superfluous.push(path.as_path());
        }
    }
    superfluous
}

fn named_pack(name: &str) -> String {
    if name.is_empty() { "a pack without a name".into() } else { format!("the pack {name}") }
}

/// Whether the charge of the pack when it is full follows from this parameter.
fn is_capacity(parameter: &Parameter) -> bool {
    matches!(parameter.name, "Qmax Cell 0" | "Full Charge Capacity")
}

/// Whether Qmax is in parts of this parameter.
pub(super) fn is_design(parameter: &Parameter) -> bool {
    parameter.name == "Design Capacity"
}

fn design_of(image: &Image) -> Option<i64> {
    match image.entries.iter().find(|entry| is_design(entry.parameter))?.value {
        Value::Int(design) => Some(design),
        _ => None,
    }
}

/// Why a profile has values that no gauge has learned.
pub(crate) fn implausible_profile(image: &Image) -> Option<String> {
    implausible(image, design_of(image))
}

/// What a version restores, and what it is compared by. Some bits are never restored.
fn content(image: &Image) -> Option<Vec<(Place, Vec<u8>)>> {
    let zeros = |change: &Change| vec![0; change.bytes().len()];
    let stored = |change: &Change| (change.place(), change.stored_over(&zeros(change)));
    Some(image.to_restore().ok()?.iter().map(stored).collect())
}

/// Why values cannot be learned ones: the gauge limits Qmax to 120 % of its default (Max % Default Qmax).
pub(super) fn implausible(image: &Image, design: Option<i64>) -> Option<String> {
    image.entries.iter().find_map(|entry| {
        let Value::Int(value) = entry.value else { return None };
        let name = entry.parameter.name;
        let full = match (name, entry.parameter.unit) {
            // In parts of Default Design Cap.
            ("Qmax Cell 0", "Num") => Some(16_384),
            ("Qmax Cell 0" | "Full Charge Capacity", "mAh") => design,
            _ => None,
        };
        let is_ra = name.starts_with("R_a") || name.starts_with("Ra ");
        match full {
            _ if is_capacity(entry.parameter) && value <= 0 => {
                Some(format!("{name} is {value}, which is no capacity"))
            }
            Some(full) if value * 3 < full || value * 2 > full * 3 => Some(format!(
                "{name} is {value}, which is not between a third and one and a half times {full}"
            )),
            None if is_ra && value <= 0 => Some(format!("{name} is {value}, which is no resistance")),
            _ => None,
        }
    })
}

#[cfg(test)]
mod tests;
