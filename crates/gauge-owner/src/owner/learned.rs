// SPDX-License-Identifier: MIT

//! What a gauge with RAM has learned, kept beside the journals: its power is lost, and what took weeks to learn is not.
//!
//! It belongs to the pack. No gauge with RAM can tell its pack from another one after a loss of power, so that only what
//! was named is believed (`--pack`); otherwise it waits for a person.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::claim::Claim;
use super::operation::Asked;
use super::signed::{is_own, signed, temporary};
use super::{Attempt, Owner};
use crate::error::{Cause, Error, Result};
use ti_gauge::chip::{Chip, Parameter, Row, Stays, Subclass};
use ti_gauge::dataflash::{self, Change, Place};
use ti_gauge::gauge::Seal;
use ti_gauge::image::{Entry, Image, toml};
use ti_gauge::journal;
use ti_gauge::value::Value;

/// The newest versions of one pack are kept, and besides them the last one of each of so many days: that what was learned is
/// wrong may be noticed late.
const KEPT: usize = 10;
const DAYS: usize = 30;
const SUFFIX: &str = ".learned.toml";
/// Least time between two looks at what was learned: a gauge learns with charges and discharges. One that is SEALED is
/// opened for it.
const EVERY: Duration = Duration::from_secs(15 * 60);
const EVERY_SEALED: Duration = Duration::from_secs(60 * 60);
/// The first look comes early: a gauge learns while the host is off, too, and not every host is on for long.
const FIRST: Duration = Duration::from_secs(60);

/// The folder with what the gauges in one place have learned.
#[derive(Clone, Debug)]
pub struct Learned {
    folder: PathBuf,
    key: String,
    pack: Option<String>,
    /// The pack itself shows that name, wherever it is.
    anywhere: bool,
    trusted: Option<u32>,
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
    /// A version's name as text, in upper or lower case; `None` if it is none.
    pub fn parse(text: &str) -> Option<Self> {
        let time: Timestamp = text.to_ascii_uppercase().parse().ok()?;
        Some(Self::at(time)).filter(|version| version.0.eq_ignore_ascii_case(text))
    }

    fn at(time: Timestamp) -> Self {
        Self(time.strftime("%Y%m%dT%H%M%SZ").to_string())
    }

    /// The version that follows, which is newer also by a clock that was put back. By one that stays far behind, days pass as
    /// well, or all versions would be of one day.
    fn next(&self, now: Timestamp) -> Option<Self> {
        let last: Timestamp = self.0.parse().ok()?;
        let [second, pause] = [Duration::from_secs(1), EVERY].map(SignedDuration::try_from);
        let (second, pause) = (second.ok()?, pause.ok()?);
        let step = if last.duration_since(now) < pause { second } else { pause };
        Some(Self::at(now.max(last.checked_add(step).ok()?)))
    }

    /// One that is a second newer.
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
        Self { folder, key, pack, anywhere: false, trusted: None }
    }

    /// Also believes versions of that account, as [`journal::Journal::trusting`] does.
    #[must_use]
    pub fn trusting(self, account: Option<u32>) -> Self {
        Self { trusted: account, ..self }
    }

    /// The name of its pack.
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

    /// Says that the gauge has this pack, if it has a name, to whoever else keeps what is learned in the folder.
    fn claim(&self, chip: &Chip) -> Option<Claim> {
        Claim::new(&self.folder, chip.name, self.pack.as_deref()?, self.anywhere)
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
    fn files(&self, chip: &Chip) -> Vec<(Version, PathBuf)> {
        let of_pack = self.all(chip).filter(|(pack, ..)| pack == self.pack());
        let mut files: Vec<_> = of_pack.map(|(_, version, path)| (version, path)).collect();
        files.sort();
        files
    }

    /// The newest version that can be read and is plausible, and why newer ones do not count.
    fn newest(&self, chip: &'static Chip, design: Option<i64>) -> (Option<(Version, Image)>, Vec<String>) {
        let mut dropped = Vec::new();
        for (version, path) in self.files(chip).into_iter().rev() {
            match self.read(&path, chip, design) {
                Ok(image) => return (Some((version, image)), dropped),
                Err(why) => dropped.push(why),
            }
        }
        (None, dropped)
    }

    /// The version that somebody has named, or why it does not count. Whose those without a name are, somebody knows.
    fn named(&self, version: &Version, chip: &'static Chip, design: Option<i64>) -> Result<Image, String> {
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

    /// A version, or why it does not count.
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

    /// Makes sure that nobody else can have written a version.
    fn trust(&self, path: &Path) -> Result<()> {
        [&self.folder, path].into_iter().try_for_each(|path| Ok(journal::check(path, self.trusted)?))
    }

    /// Saves a version, unless the newest one would restore the same. On return it is on disk.
    fn save(&self, image: &Image, now: Timestamp) -> Result<bool> {
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

    /// Removes all versions. One that cannot be removed keeps none of the others.
    fn forget(&self, chip: &Chip) -> Result<usize> {
        let files = self.files(chip);
        let remove = |(_, path): &(Version, PathBuf)| {
            fs::remove_file(path)
                .map_err(|error| Error::io(path.display().to_string(), "cannot be removed", &error))
        };
        let removed: Vec<_> = files.iter().rev().map(remove).collect();
        removed.into_iter().collect::<Result<()>>().map(|()| files.len())
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

/// The index of the subclass that a change is of.
fn index_of(chip: &'static Chip, change: &Change) -> Option<usize> {
    let (subclass, _) = change.row()?;
    chip.subclasses.iter().position(|other| std::ptr::eq(other, subclass))
}

/// A pack, as a message has it.
fn named_pack(name: &str) -> String {
    if name.is_empty() { "a pack without a name".into() } else { format!("the pack {name}") }
}

/// The subclasses, by their indices in the table, that hold what a gauge learns.
fn learning(chip: &'static Chip) -> Vec<usize> {
    let rows = chip.subclasses.iter().enumerate();
    let learns = |subclass: &'static Subclass| {
        subclass.parameters.iter().any(|row| !row.unproven && chip.stays((subclass, row)) == Stays::Pack)
    };
    rows.filter(|(_, row)| learns(row)).map(|(index, _)| index).collect()
}

/// Whether the charge of the pack when it is full follows from this parameter.
fn is_capacity(parameter: &Parameter) -> bool {
    matches!(parameter.name, "Qmax Cell 0" | "Full Charge Capacity")
}

/// Whether Qmax is in parts of this parameter.
fn is_design(parameter: &Parameter) -> bool {
    parameter.name == "Design Capacity"
}

/// The changes that restore what was learned. The image has Design Capacity besides, for comparison.
fn restored(image: &Image) -> ti_gauge::error::Result<Vec<Change>> {
    let mut changes = image.to_restore()?;
    changes.retain(|change| change.row().is_some_and(|row| image.chip.stays(row) == Stays::Pack));
    Ok(changes)
}

/// Design Capacity in an image, in mAh.
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

/// Why values cannot be what a gauge has learned. It limits Qmax itself to 120 % of its default (Max % Default Qmax). Design Capacity is needed for those in mAh.
fn implausible(image: &Image, design: Option<i64>) -> Option<String> {
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

impl Owner {
    /// Design Capacity by the profile.
    fn design_capacity(&self) -> Option<i64> {
        let is_it = |change: &&Change| change.row().is_some_and(|(_, row)| is_design(row));
        let change = self.memory.profile().iter().find(is_it)?;
        Some(change.bytes().iter().fold(0, |word, &byte| word << 8 | i64::from(byte)))
    }

    /// The profile with what the pack has learned in the place of the profile's own, and from when that is.
    pub(super) fn profile_with_learned(&mut self) -> (Vec<Change>, Option<Version>) {
        let mut profile = self.memory.profile().to_vec();
        if self.memory.is_of_another_pack() {
            profile = over(unlearned(self.gauge.chip, self.shared.published().answers.dm_code), profile);
        }
        let Some(store) = self.learned.clone() else { return (profile, None) };
        if self.is_contested() {
            self.memory.owes_learned = true;
            return (profile, None);
        }
        self.memory.owes_learned = false;
        if store.pack.is_none() {
            if !store.files(self.gauge.chip).is_empty() {
                let why = "what it had learned is kept and not restored, because its pack has no name; see \
                           `gaugefs learned`";
                log::info!("{}: {why}", self.shared.name());
            }
            return (profile, None);
        }
        let (newest, dropped) = store.newest(self.gauge.chip, self.design_capacity());
        for why in dropped {
            log::warn!("{}: {why}; it is not restored", self.shared.name());
        }
        let Some((time, image)) = newest else { return (profile, None) };
        match restored(&image) {
            Ok(learned) => (over(profile, learned), Some(time)),
            Err(error) => {
                log::warn!("{}: what it has learned is not restored: {error}", self.shared.name());
                (profile, None)
            }
        }
    }

    /// Whether another gauge has the same pack. From now on that one knows of this one, too.
    fn is_contested(&mut self) -> bool {
        let chip = self.gauge.chip;
        let pack = self.learned.as_ref().and_then(|store| Some((store, store.pack.as_deref()?)));
        let claim = self.memory.claim.take();
        self.memory.claim = pack.and_then(|(store, pack)| {
            claim.filter(|claim| claim.is_of(chip.name, pack, store.anywhere)).or_else(|| store.claim(chip))
        });
        let is_contested = self.memory.claim.as_ref().is_some_and(Claim::is_contested);
        if std::mem::replace(&mut self.memory.is_contested, is_contested) != is_contested {
            match self.contested() {
                Some(error) => self.shared.report(Attempt::LEARNED, &error),
                None => self.shared.succeeded(&Attempt::LEARNED),
            }
        }
        is_contested
    }

    /// Why nothing that was learned is saved or restored, while another gauge has the same pack.
    fn contested(&self) -> Option<Error> {
        let pack = self.learned.as_ref()?.pack.as_ref().filter(|_| self.memory.is_contested)?;
        let why = format!(
            "another gauge has the pack {pack} as well, and no pack is in two places: what either of them learns is not saved, \
             and nothing is restored; give each pack a name of its own"
        );
        Some(Error::new("learned", Cause::NotNow, why))
    }

    /// Restores what was not restored while another gauge had the same pack, unless the gauge has learned something since.
    fn restore_owed(&mut self) {
        match self.look_at_learned() {
            Ok(None) if self.memory.is_kept() => self.write_profile(0, true),
            Ok(_) => {}
            Err(error) => return self.shared.report(Attempt::LEARNED, &error),
        }
        self.memory.owes_learned = false;
    }

    /// Saves what the gauge has learned, now and then, while its memory is known to be what it should be.
    pub(super) fn save_learned(&mut self) {
        let published = self.shared.published();
        let is_shown = |snapshot: &super::Snapshot| snapshot.is_valid && snapshot.is_configured;
        let is_good = published.snapshot.as_deref().is_some_and(is_shown) && self.memory.is_kept();
        let (Some(store), true) = (self.learned.clone(), is_good) else {
            self.memory.next_look = None;
            return;
        };
        if self.is_contested() {
            return;
        }
        if self.memory.owes_learned {
            return self.restore_owed();
        }
        let now = self.gauge.clock.now();
        let pause = if published.seal == Seal::Sealed { EVERY_SEALED } else { EVERY };
        if now < *self.memory.next_look.get_or_insert(now + FIRST) {
            return;
        }
        self.memory.next_look = Some(now + pause);
        match self.look_at_learned().and_then(|image| match image {
            Some(image) => store.save(&image, Timestamp::now()),
            None => Ok(false),
        }) {
            Ok(true) => log::info!("{}: what it has learned was saved", self.shared.name()),
            Ok(false) => {}
            Err(error) => return self.shared.report(Attempt::LEARNED, &error),
        }
        self.shared.succeeded(&Attempt::LEARNED);
    }

    /// What the gauge has learned; `None` if that is nothing, or no plausible value.
    fn look_at_learned(&mut self) -> Result<Option<Image>> {
        let chip = self.gauge.chip;
        let mut indices = learning(chip);
        if indices.is_empty() {
            return Ok(None);
        }
        let profile = self.memory.profile().to_vec();
        // Where no flag shows a loss of memory, what the profile has set does.
        if chip.volatile == Some(0) {
            indices.extend(profile.iter().filter_map(|change| index_of(chip, change)));
            indices.sort_unstable();
            indices.dedup();
        }
        let rows: Vec<&Subclass> = indices.iter().map(|&index| &chip.subclasses[index]).collect();
        let read = self.dataflash.read(&mut self.gauge, &rows, Duration::ZERO);
        let read = self.noted(read)?;
        let holds = |change: &Change| {
            let Some((subclass, row)) = change.row().filter(|(_, row)| !row.learned) else { return true };
            let index = index_of(chip, change).and_then(|index| indices.iter().position(|at| *at == index));
            let begin = usize::from(row.offset - subclass.start());
            let bytes = index.and_then(|index| read[index].get(begin..begin + row.kind.size()));
            bytes.is_some_and(|bytes| change.stored_over(bytes) == bytes)
        };
        let is_lost = match chip.volatile {
            Some(0) => !profile.iter().all(holds),
            _ => dataflash::has_lost_memory(&mut self.gauge)?,
        };
        // Unnoticed, since the poll: these are the part's defaults, or some of them.
        if is_lost {
            self.memory.doubt();
            self.schedule.hurry();
            return Ok(None);
        }
        let firmware = self.shared.published().answers.firmware_version;
        let read = indices.iter().zip(&read).map(|(&index, bytes)| (index, &**bytes));
        let mut image = Image::of_flash(chip, Some(firmware), read);
        image.entries.retain(|entry| {
            let is_of_pack = chip.stays((entry.subclass, entry.parameter)) == Stays::Pack;
            !entry.parameter.unproven && (is_of_pack || is_design(entry.parameter))
        });
        let changes = restored(&image)?;
        // Where no default is printed, only a change shows that something was learned.
        self.memory.first.get_or_insert_with(|| changes.clone());
        if let Some(why) = implausible(&image, self.design_capacity()) {
            log::warn!("{}: what it has learned is not saved: {why}", self.shared.name());
            return Ok(None);
        }
        // What the profile has is nothing that was learned.
        let is_written = |change: &Change| {
            let mut written = profile.iter().filter(|wrote| wrote.place() == change.place());
            written.any(|wrote| wrote.stored_over(change.bytes()) == change.bytes())
        };
        // Bits that are never restored say nothing.
        let is_default = |change: &Change| change.is_default(&change.stored_over(&[0; 8]));
        let first = self.memory.first.iter().flatten();
        let has_changed = |change: &Change| {
            first.clone().any(|first| first.place() == change.place() && first.bytes() != change.bytes())
        };
        let is_new = |change: &Change| !is_written(change) && (!is_default(change) || has_changed(change));
        Ok(changes.iter().any(is_new).then_some(image))
    }

    /// Shows what is kept of the gauge's pack, writes it, or removes it.
    pub(super) fn keep_learned(&mut self, wish: Wish, asked: Asked) -> Result<()> {
        let chip = self.gauge.chip;
        let refuse = |why: &'static str| Error::new("learned", Cause::NotPermitted, why);
        if chip.volatile.is_none() {
            let why = "its data memory is flash, and keeps what the gauge learns without power";
            return Err(refuse(why));
        }
        let Some(store) = self.learned.clone() else {
            return Err(refuse("nothing is kept of a simulated gauge without --state-dir"));
        };
        let told = match wish {
            Wish::Show => self.kept_text(&store),
            Wish::Forget => format!(
                "{} versions removed; what the gauge itself still has is saved with the next look, unless another pack is \
                 there or its profile is imported\n",
                store.forget(chip)?
            ),
            Wish::Restore(version) => self.restore_learned(&store, version, asked)?,
        };
        self.shared.publish(|published| published.learned = (asked.title() + &told).into());
        Ok(())
    }

    /// Writes a version to the gauge, which is the newest one from then on. What the gauge has learned since the last look is a
    /// version before it.
    fn restore_learned(&mut self, store: &Learned, named: Option<Version>, asked: Asked) -> Result<String> {
        if self.is_contested()
            && let Some(error) = self.contested()
        {
            return Err(error);
        }
        let (chip, design) = (self.gauge.chip, self.design_capacity());
        let not_now = |why| Error::new("learned", Cause::NotNow, why);
        let (version, image) = match &named {
            Some(version) => (version.clone(), store.named(version, chip, design).map_err(not_now)?),
            None => {
                let (newest, dropped) = store.newest(chip, design);
                let why = dropped.into_iter().next().unwrap_or_else(|| "nothing is kept of it".into());
                newest.ok_or_else(|| not_now(why))?
            }
        };
        let begun = self.gauge.clock.now();
        if self.memory.is_kept()
            && let Some(present) = self.look_at_learned()?
        {
            store.save(&present, Timestamp::now())?;
        }
        let waited = asked.waited + (self.gauge.clock.now() - begun);
        let learned = over(self.memory.profile().to_vec(), restored(&image)?);
        let outcome = self.dataflash.restore(&mut self.gauge, &learned, true, waited);
        let outcome = self.noted(outcome);
        self.forget_values();
        self.schedule.hurry();
        let outcome = outcome?;
        self.log_written(&learned, &outcome);
        self.note_memory_written();
        store.save(&image, Timestamp::now()).map_err(|error| {
            error.within(&format!("{version} is restored, but is not the newest version from now on"))
        })?;
        Ok(format!("restored what it had learned until {version}\n"))
    }

    fn kept_text(&self, store: &Learned) -> String {
        let (chip, design) = (self.gauge.chip, self.design_capacity());
        let (newest, dropped) = store.newest(chip, design);
        let mut text = self.memory.why().to_string();
        if !text.is_empty() {
            text.push('\n');
        }
        if let Some((version, image)) = &newest {
            text += &format!("{}: learned until {version}\n", named_pack(store.pack()));
            for entry in &image.entries {
                text += &format!("  {} = {}\n", image.name(entry), entry.shown());
            }
        }
        for why in &dropped {
            text += &format!("not restored: {why}\n");
        }
        let mut older = store.files(chip);
        older.retain(|(version, _)| newest.as_ref().is_some_and(|(newest, _)| version < newest));
        let told = |older: &[(Version, PathBuf)]| -> String {
            let line = |(version, path): &(Version, PathBuf)| match store.read(path, chip, design) {
                Ok(image) => {
                    let capacities = image.entries.iter().filter(|entry| is_capacity(entry.parameter));
                    let shown = |entry| format!("{} = {}", image.name(entry), entry.shown());
                    format!("  {version}  {}\n", capacities.map(shown).collect::<Vec<_>>().join(", "))
                }
                Err(why) => format!("  {version}  not restored: {why}\n"),
            };
            older.iter().rev().map(line).collect()
        };
        if !older.is_empty() {
            text += &format!("older versions in {}; --restore=VERSION writes one:\n", store.folder.display());
            text += &told(&older);
        }
        let nameless = store.clone().of_pack(None).files(chip);
        if store.pack.is_some() && !nameless.is_empty() {
            text += "learned before the pack had a name; --restore=VERSION writes one, if it is this pack:\n";
            text += &told(&nameless);
        }
        if let Some(error) = self.contested() {
            text += &format!("{}\n", error.reason());
            return text;
        }
        text += match (&newest, &store.pack) {
            (None, _) => "nothing is kept that could be restored\n",
            (Some(_), Some(_)) if self.memory.profile().is_empty() => {
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
}

/// What a gauge that has learned nothing yet has in the place of that, where a source prints it.
fn unlearned(chip: &'static Chip, dm_code: Option<u16>) -> Vec<Change> {
    let rows = chip.rows().filter(|row| !row.1.unproven && chip.stays(*row) == Stays::Pack);
    let default = |(subclass, parameter): Row| {
        let value = Value::Int(parameter.int_default(dm_code)?);
        Some(Entry { subclass, parameter, value, line: 0 })
    };
    let mut image = Image::new(chip, None);
    image.entries = rows.filter_map(default).collect();
    restored(&image).unwrap_or_default()
}

/// Changes, with others in the place of those of the same parameters.
fn over(mut changes: Vec<Change>, others: Vec<Change>) -> Vec<Change> {
    changes.retain(|change| others.iter().all(|other| other.place() != change.place()));
    changes.extend(others);
    changes
}

#[cfg(test)]
mod tests {
    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Run, operations as op};
    use super::*;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::chip::{CHIPS, FLAT};

    const QMAX: (u16, usize) = (82, 0);

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("gaugefs-learned-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    /// The files with versions.
    fn kept(folder: &Path) -> Vec<PathBuf> {
        let files = fs::read_dir(folder).into_iter().flatten().map(|file| file.expect("a file").path());
        let mut files: Vec<_> = files.filter(|file| file.to_string_lossy().ends_with(SUFFIX)).collect();
        files.sort();
        files
    }

    fn chip() -> &'static Chip {
        Chip::by_name("bq27441-g1").expect("it has a table")
    }

    fn rig(folder: &std::path::Path, pack: Option<&str>) -> Rig {
        let image = "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1234\nqmax-cell-0 = 16000\n";
        let image = Image::parse(image, Some(chip())).expect("an image");
        let learned = Learned::new(folder.into(), "i2c-1-55".into(), pack.map(String::from));
        let profile = image.to_restore().expect("values in range");
        let run = Run { profile, learned: Some(learned), ..Run::default() };
        let mut rig = Rig::of("bq27441-g1", run);
        rig.start().expect("it answers");
        rig.poll_after(INTERVAL);
        rig.poll_after(INTERVAL);
        rig
    }

    /// The gauge learns a Qmax and an Ra, and is looked at.
    fn learn(rig: &mut Rig, qmax: u16) {
        learn_now(rig, qmax);
        rig.poll_after(EVERY_SEALED);
    }

    fn learn_now(rig: &mut Rig, qmax: u16) {
        rig.sim.set_flash(QMAX.0, QMAX.1, &qmax.to_be_bytes());
        rig.sim.set_flash(89, 0, &77_u16.to_be_bytes());
    }

    fn lose_power(rig: &mut Rig) {
        rig.sim.set("power", "off").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        for _ in 0..3 {
            rig.poll_after(Duration::from_secs(3));
        }
    }

    fn words(rig: &mut Rig) -> (u16, u16) {
        rig.ask(&op::REFRESH, ()).expect("it answers");
        let indices = vec![rig.index(82), rig.index(89)];
        let read = rig.ask(&op::READ, indices).expect("it is read");
        let word = |bytes: &[u8]| u16::from_be_bytes([bytes[0], bytes[1]]);
        (word(&read[0]), word(&read[1]))
    }

    fn told(rig: &mut Rig) -> String {
        rig.ask(&op::LEARNED, Wish::Show).expect("it is shown");
        rig.handle.published().learned.to_string()
    }

    #[test]
    fn what_was_learned_outlives_the_power_of_a_pack_with_a_name() {
        let folder = folder("named");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_432);
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_432, 77));
        let told = told(&mut rig);
        assert!(told.contains("qmax-cell-0 = 15432") && told.contains("restored with the profile"), "{told}");
        // Another daemon, and another pack, whose gauge gets nothing of it.
        for (pack, expected) in [("B", (16_000, 102)), ("A", (15_432, 77))] {
            let mut rig = self::rig(&folder, Some(pack));
            lose_power(&mut rig);
            assert_eq!(words(&mut rig), expected, "{pack}");
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The gauge has power of its own, and another battery comes.
    fn exchange_battery(rig: &mut Rig, between: impl FnOnce()) {
        let then = rig.handle.published().presence;
        rig.sim.set("bat_det", "out").expect("a knob");
        rig.poll_after(INTERVAL);
        assert!(!rig.handle.is_present());
        let away = rig.handle.published().presence;
        between();
        rig.sim.set("bat_det", "in").expect("a knob");
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        let now = rig.handle.published().presence;
        assert!(rig.handle.is_present() && then != away && away != now && then != now);
    }

    #[test]
    fn regression_a_battery_that_was_inserted_had_what_another_one_had_taught() {
        // Without a name it may be any; the one of a name is that one.
        for (pack, expected) in [(None, (16_000, 102)), (Some("A"), (15_440, 77))] {
            let folder = folder(&format!("inserted-{}", pack.is_some()));
            let mut rig = rig(&folder, pack);
            learn(&mut rig, 15_432);
            // No version has this yet.
            learn_now(&mut rig, 15_440);
            exchange_battery(&mut rig, || {});
            assert_eq!(words(&mut rig), expected, "{pack:?}");
            assert_eq!(*rig.handle.published().last_error, *"");
            fs::remove_dir_all(folder).expect("it is there");
        }
    }

    #[test]
    fn a_battery_that_was_inserted_gets_the_profile_and_the_name_of_its_pack() {
        let folder = folder("chosen");
        fs::create_dir_all(&folder).expect("a folder");
        let shows = folder.join("pack");
        let name = |name: &str| fs::write(&shows, name).expect("a file");
        let choice = |text: &str, design: u16| {
            let evidence = Some(crate::Evidence::File(shows.clone()));
            let rule = crate::Rule {
                evidence,
                text: Some(text.into()),
                pack_by_text: true,
                profile: text.into(),
                ..crate::Rule::default()
            };
            let image =
                format!("chip = \"bq27441-g1\"\n[state]\ndesign-capacity = {design}\nqmax-cell-0 = 16000\n");
            let image = Image::parse(&image, Some(chip())).expect("an image");
            crate::Choice { rule, profile: image.to_restore().expect("values in range") }
        };
        let learned = Learned::new(folder.clone(), "i2c-1-55".into(), None);
        let choices = vec![choice("A", 1234), choice("B", 1300)];
        let run = Run { choices, learned: Some(learned), ..Run::default() };
        name("A");
        let mut rig = Rig::of("bq27441-g1", run);
        rig.start().expect("it answers");
        (0..2).for_each(|_| rig.poll_after(INTERVAL));
        learn(&mut rig, 15_432);
        let design = |rig: &mut Rig| {
            let index = rig.index(82);
            let read = rig.ask(&op::READ, vec![index]).expect("it is read");
            u16::from_be_bytes([read[0][10], read[0][11]])
        };
        for (pack, expected, capacity) in [("B", (16_000, 102), 1300), ("A", (15_432, 77), 1234)] {
            exchange_battery(&mut rig, || name(pack));
            assert_eq!((words(&mut rig), design(&mut rig)), (expected, capacity), "{pack}");
            assert!(told(&mut rig).contains(&format!("of the pack {pack}")), "{}", told(&mut rig));
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// A version of each Qmax, the last one newest.
    fn versions(rig: &mut Rig, qmaxes: &[u16]) -> Vec<Version> {
        for &qmax in qmaxes {
            learn(rig, qmax);
        }
        let store = rig.owner.learned.clone().expect("it was given");
        store.files(chip()).into_iter().map(|(version, _)| version).collect()
    }

    #[test]
    fn somebody_may_go_back_to_an_older_version() {
        for pack in [Some("A"), None] {
            let folder = folder(&format!("older-{}", pack.is_some()));
            let mut rig = rig(&folder, pack);
            let there = versions(&mut rig, &[15_001, 15_002, 15_003]);
            let shown = told(&mut rig);
            for (version, qmax) in there.iter().zip([15_001, 15_002]) {
                assert!(shown.contains(&format!("  {version}  state/qmax-cell-0 = {qmax}\n")), "{shown}");
            }
            // What it has learned since is not lost.
            learn_now(&mut rig, 15_004);
            rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
            assert_eq!(words(&mut rig), (15_001, 77));
            assert!(told(&mut rig).contains("state/qmax-cell-0 = 15004\n"));
            // It stays after a loss of power, by itself or by the next word.
            lose_power(&mut rig);
            let is_named = pack.is_some();
            assert_eq!(words(&mut rig), if is_named { (15_001, 77) } else { (16_000, 102) });
            let before = versions(&mut rig, &[]);
            rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
            assert_eq!(words(&mut rig), (15_001, 77));
            assert_eq!(versions(&mut rig, &[]), before, "a version twice");
            fs::remove_dir_all(folder).expect("it is there");
        }
    }

    #[test]
    fn a_version_that_cannot_be_right_is_refused_with_the_reason() {
        let folder = folder("named-wrong");
        let mut rig = rig(&folder, Some("A"));
        let there = versions(&mut rig, &[15_001, 15_002]);
        let refused = |rig: &mut Rig, version: &Version| {
            let flash = rig.sim.flash();
            let asked = rig.ask(&op::LEARNED, Wish::Restore(Some(version.clone())));
            assert!(rig.sim.flash() == flash);
            asked.expect_err("a reason").to_string()
        };
        let other = Version::parse("19700101T000000Z").expect("a version");
        let error = refused(&mut rig, &other);
        assert!(error.contains(&format!("there are {}, {}", there[0], there[1])), "{error}");

        let store = rig.owner.learned.clone().expect("it was given");
        let path = store.files(chip())[0].1.clone();
        let text = fs::read_to_string(&path).expect("text");
        for (from, to, why) in [
            ("qmax-cell-0 = 15001", "qmax-cell-0 = 0", "which is no capacity"),
            ("design-capacity = 1234", "design-capacity = 4321", "a Design Capacity of 4321 mAh"),
            ("r-a0-5 = 59", "r-a0-5 = 0", "which is no resistance"),
            ("bq27441-g1", "bq27427", "it is for a BQ27427"),
            ("[r-a-ram]", "[r-a", "line "),
        ] {
            fs::write(&path, text.replace(from, to)).expect("it is written");
            let error = refused(&mut rig, &there[0]);
            assert!(error.contains(why), "{to}: {error}");
            assert!(told(&mut rig).contains(&format!("  {}  not restored: ", there[0])), "{to}");
        }

        let mut other = self::rig(&folder, Some("B"));
        let error = refused(&mut other, &there[0]);
        assert!(error.contains("was learned with the pack A, and this is the pack B"), "{error}");
        let mut other = self::rig(&folder, None);
        let error = refused(&mut other, &there[0]);
        assert!(error.contains("and this is a pack without a name"), "{error}");
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// It was saved before somebody named the pack.
    #[test]
    fn what_a_pack_without_a_name_has_learned_can_be_given_to_one_with_a_name() {
        let folder = folder("adopted");
        let mut nameless = rig(&folder, None);
        let there = versions(&mut nameless, &[15_001]);
        let mut rig = rig(&folder, Some("A"));
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102), "nothing is guessed");
        let shown = told(&mut rig);
        assert!(
            shown.contains("before the pack had a name") && shown.contains("qmax-cell-0 = 15001"),
            "{shown}"
        );
        rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_001, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The profile that is still to be written has a Qmax as well.
    #[test]
    fn regression_what_somebody_had_restored_was_replaced_by_the_profile() {
        let folder = folder("owed");
        let mut rig = rig(&folder, None);
        let there = versions(&mut rig, &[15_001]);
        rig.sim.set("power", "off").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(3));
        // The adapter fails once the profile is being written.
        let faults: Vec<_> = (20..120).map(|number| format!("eio {number}")).collect();
        rig.sim.set("fault", &faults.join("; ")).expect("faults");
        rig.poll_after(Duration::ZERO);
        assert!(!rig.handle.published().last_error.is_empty());
        rig.sim.set("fault", "none").expect("a knob");
        rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        assert_eq!(words(&mut rig), (15_001, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn a_clock_that_jumps_by_years_makes_no_older_version_the_newest() {
        let folder = folder("jumps");
        let rig = rig(&folder, Some("A"));
        let store = rig.owner.learned.clone().expect("it was given");
        // Another daemon, as after a restart.
        let stores = [store.clone(), rig.owner.learned.clone().expect("it was given")];
        let times =
            ["2026-11-25T09:30:00Z", "1970-01-01T00:00:00Z", "2099-01-01T00:00:00Z", "2026-11-25T09:30:00Z"];
        for (number, time) in (0..).zip(times) {
            let text = format!("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = {}\n", 15_000 + number);
            let image = Image::parse(&text, Some(chip())).expect("an image");
            let now = time.parse().expect("a time");
            assert_eq!(stores[number % 2].save(&image, now), Ok(true), "{time}");
            let (newest, dropped) = store.newest(chip(), None);
            let newest = newest.map(|(_, image)| image.entries[0].value.clone());
            assert_eq!((newest, dropped.len()), (Some(Value::Int(15_000 + number as i64)), 0), "{time}");
        }
        let versions: Vec<_> = store.files(chip()).into_iter().map(|(version, _)| version.0).collect();
        let expected = ["20261125T093000Z", "20261125T094500Z", "20990101T000000Z", "20990101T001500Z"];
        assert_eq!(versions, expected);
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// A store, and what saves a version with that Qmax at a time.
    fn store(name: &str) -> (Learned, impl Fn(usize, Timestamp)) {
        let store = Learned::new(folder(name), "i2c-1-55".into(), Some("A".into()));
        let other = store.clone();
        let save = move |number: usize, now: Timestamp| {
            let qmax = 15_000 + number % 2;
            let text = format!("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = {qmax}\n");
            let image = Image::parse(&text, Some(chip())).expect("an image");
            assert_eq!(store.save(&image, now), Ok(true), "{number}");
        };
        (other, save)
    }

    fn time(text: &str) -> Timestamp {
        text.parse().expect("a time")
    }

    fn names(store: &Learned) -> Vec<String> {
        store.files(chip()).into_iter().map(|(version, _)| version.0).collect()
    }

    /// What is left of versions that were saved at these times, without a disk.
    fn history(times: impl Iterator<Item = Timestamp>) -> Vec<String> {
        let mut files: Vec<(Version, PathBuf)> = Vec::new();
        for now in times {
            let version = files.last().map_or(Some(Version::at(now)), |(last, _)| last.next(now));
            let version = version.expect("time is left");
            files.push((version.clone(), version.0.into()));
            let gone: Vec<PathBuf> = superfluous(&files).into_iter().map(PathBuf::from).collect();
            files.retain(|(_, path)| !gone.contains(path));
        }
        files.into_iter().map(|(version, _)| version.0).collect()
    }

    /// Whoever notices after weeks that something wrong was learned can go back.
    #[test]
    fn the_last_version_of_each_of_thirty_days_is_kept_beside_the_newest_ones() {
        let at =
            |day: i64, hour: i64| time("2026-11-01T00:30:00Z") + SignedDuration::from_hours(24 * day + hour);
        let left = history((0..40 * 24).map(|hour| at(0, hour)));
        let days = (10..39).map(|day| at(day, 23));
        let newest = (14..24).map(|hour| at(39, hour));
        let expected: Vec<_> = days.chain(newest).map(|time| Version::at(time).0).collect();
        assert_eq!((left, expected.len()), (expected.clone(), KEPT + DAYS - 1));
    }

    /// As of a host without a clock of its own, and of one that was in the year 2099 once.
    #[test]
    fn days_pass_by_a_clock_that_stays_behind() {
        for (first, ever_after) in [
            ("2099-01-01T00:00:00Z", "2026-11-25T09:30:00Z"),
            ("2026-11-25T09:30:00Z", "1970-01-01T00:01:00Z"),
        ] {
            let left = history([first].into_iter().chain([ever_after; 4000]).map(time));
            let mut days: Vec<_> = left.iter().map(|name| &name[..8]).collect();
            days.dedup();
            assert!(days.len() == DAYS && left.len() < KEPT + DAYS, "{left:?}");
        }
    }

    /// The host has lost its power between a new version and the end of the old ones, again and again.
    #[test]
    fn versions_that_should_have_been_removed_are_removed_with_the_next_one() {
        let (store, save) = store("left");
        let left =
            |number: i64| Version::at(time("2026-11-20T09:30:00Z") + SignedDuration::from_mins(15 * number));
        fs::create_dir_all(&store.folder).expect("a folder");
        for number in 0..80 {
            let name = format!("i2c-1-55-bq27441-g1-A-{}{SUFFIX}", left(number));
            fs::write(store.folder.join(name), "half a").expect("a file");
        }
        save(0, time("2026-11-25T09:30:00Z"));
        // 58 of them are of the first day.
        assert_eq!(names(&store).len(), KEPT + 1);
        assert_eq!(names(&store)[0], left(57).0);
        fs::remove_dir_all(&store.folder).expect("it is there");
    }

    /// A device with two bays: the pack shows its serial number in either.
    #[test]
    fn a_pack_that_shows_its_name_takes_what_it_has_learned_along() {
        let (store, save) = store("bays");
        save(1, time("2026-11-25T09:30:00Z"));
        let other = Learned::new(store.folder.clone(), "i2c-2-55".into(), None);
        let of = |pack: &str| other.clone().of_pack_anywhere(Some(pack.into()));
        let qmax = |store: &Learned| {
            let (newest, _) = store.newest(chip(), None);
            newest.map(|(_, image)| image.entries[0].value.clone())
        };
        assert_eq!(qmax(&of("A")), Some(Value::Int(15_001)));
        assert_eq!(
            (qmax(&of("B")), qmax(&of("")), qmax(&other.clone().of_pack(Some("A".into())))),
            Default::default()
        );
        // What it learns there is newer.
        let image = Image::parse("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = 15002\n", Some(chip()));
        let image = image.expect("an image");
        assert_eq!(of("A").save(&image, time("2026-11-25T09:30:00Z")), Ok(true));
        assert_eq!(qmax(&store.clone().of_pack_anywhere(Some("A".into()))), Some(Value::Int(15_002)));
        assert_eq!(qmax(&store), Some(Value::Int(15_001)));
        assert_eq!(of("A").forget(chip()), Ok(2));
        fs::remove_dir_all(&store.folder).expect("it is there");
    }

    #[test]
    fn regression_a_folder_named_like_a_version_kept_the_newest_from_being_forgotten() {
        let (store, save) = store("forget");
        for number in 0..3 {
            save(number, time("2026-11-25T09:30:00Z") + SignedDuration::from_mins(15 * number as i64));
        }
        let like = |pack, time| format!("i2c-1-55-bq27441-g1-{pack}-{time}{SUFFIX}");
        let others = [
            like("A", "20261125T091500Z"),
            like("A", "20261126T091500Z"),
            like("B", "20261125T093000Z"),
            like("A", "20261125"),
            "notes.txt".into(),
        ];
        for name in &others {
            let path = store.folder.join(name);
            if name.contains("T091500Z") { fs::create_dir(path) } else { fs::write(path, "") }.expect("made");
        }
        assert_eq!(store.forget(chip()), Ok(3));
        let mut left: Vec<_> = fs::read_dir(&store.folder)
            .expect("a folder")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("text"))
            .collect();
        let mut others = others.to_vec();
        left.sort();
        others.sort();
        assert_eq!(left, others);
        fs::remove_dir_all(&store.folder).expect("it is there");
    }

    #[test]
    fn a_version_is_named_by_a_time() {
        for text in ["20261125T093000Z", "20261125t093000z", "00010101T000000Z", "99991230T000000Z"] {
            assert_eq!(Version::parse(text).map(|version| version.0), Some(text.to_uppercase()), "{text}");
        }
        for text in
            ["", "20261125", "20261325T093000Z", "2026-11-25T09:30:00Z", "20261125T093000+01", "../../x", "x"]
        {
            assert_eq!(Version::parse(text), None, "{text}");
        }
        let next = |text, now: &str| {
            let next = Version::parse(text).and_then(|version| version.next(now.parse().expect("a time")));
            next.map(|version| version.0)
        };
        for (last, now, expected) in [
            ("20261231T235959Z", "2026-12-31T23:59:59Z", "20270101T000000Z"),
            ("20261231T235959Z", "2026-12-31T23:50:00Z", "20270101T000000Z"),
            ("20261231T235959Z", "2027-01-01T00:00:05Z", "20270101T000005Z"),
            ("20261231T235959Z", "1970-01-01T00:00:00Z", "20270101T001459Z"),
            ("19700101T000000Z", "2026-12-31T23:59:59Z", "20261231T235959Z"),
        ] {
            assert_eq!(next(last, now).as_deref(), Some(expected), "{last} {now}");
        }
        assert_eq!(next("99991230T220000Z", "2026-12-31T23:59:59Z"), None);
    }

    #[test]
    fn of_a_pack_without_a_name_nothing_is_guessed() {
        let folder = folder("unnamed");
        let mut rig = rig(&folder, None);
        learn(&mut rig, 15_432);
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102));
        assert!(told(&mut rig).contains("--pack"));
        rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
        assert_eq!(words(&mut rig), (15_432, 77));
        rig.ask(&op::LEARNED, Wish::Forget).expect("it can be removed");
        rig.ask(&op::LEARNED, Wish::Restore(None)).expect_err("nothing is kept");
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn what_cannot_be_right_is_neither_saved_nor_restored() {
        let folder = folder("implausible");
        let mut rig = rig(&folder, Some("A"));
        for wrong in [0, 5000, 32_767] {
            rig.clock.sleep(Duration::from_secs(1));
            learn(&mut rig, wrong);
            assert!(kept(&folder).is_empty(), "{wrong}");
        }
        learn(&mut rig, 15_000);
        let file = kept(&folder).remove(0);
        let text = fs::read_to_string(&file).expect("text");
        for (from, to) in
            [("qmax-cell-0 = 15000", "qmax-cell-0 = 0"), ("r-a0-5 = 59", "r-a0-5 = 0"), ("[r-a-ram]", "[r-a")]
        {
            let wrong = text.replace(from, to);
            assert_ne!(wrong, text, "{from}\n{text}");
            fs::write(&file, wrong).expect("it is written");
            lose_power(&mut rig);
            assert_eq!(words(&mut rig).0, 16_000, "{to}");
            assert!(told(&mut rig).contains("nothing is kept that could be restored"), "{to}");
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The newest version is half written, as by a disk that lies about its cache: the one before it counts.
    #[test]
    fn an_older_version_counts_where_the_newest_cannot_be_read() {
        let folder = folder("versions");
        let mut rig = rig(&folder, Some("A"));
        let store = rig.owner.learned.clone().expect("it was given");
        for qmax in 0..15 {
            learn(&mut rig, 15_000 + qmax);
        }
        let files = store.files(chip());
        assert_eq!(files.len(), KEPT);
        let text = fs::read_to_string(&files[KEPT - 1].1).expect("text");
        fs::write(&files[KEPT - 1].1, &text[..text.len() / 2]).expect("it is written");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_013, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_said_once_and_tried_again() {
        let folder = folder("full");
        fs::write(&folder, "").expect("a file in place of the folder");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_000);
        let error = rig.handle.published().last_error.to_string();
        assert!(error.contains("cannot save what the gauge has learned"), "{error}");
        fs::remove_file(&folder).expect("it is there");
        rig.poll_after(EVERY_SEALED);
        assert_eq!(&*rig.handle.published().last_error, "");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_000, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The power of the gauge is lost at every transfer of a look at what it has learned.
    #[test]
    fn a_loss_of_power_while_it_is_looked_at_saves_no_defaults() {
        let folder = folder("cut");
        let mut number = 1;
        loop {
            let mut rig = rig(&folder, Some("A"));
            rig.sim.set_flash(QMAX.0, QMAX.1, &15_000_u16.to_be_bytes());
            rig.sim.set_flash(89, 0, &77_u16.to_be_bytes());
            rig.clock.sleep(EVERY_SEALED);
            let before = rig.transfers();
            rig.sim.set("fault", &format!("power-cut {number} 20")).expect("a fault");
            rig.poll_after(Duration::ZERO);
            let is_done = rig.transfers() - before < number;
            rig.sim.set("fault", "none").expect("a knob");
            for _ in 0..4 {
                rig.poll_after(Duration::from_secs(4));
            }
            // What was learned before is lost with the first cut; nothing else is ever there.
            for (_, path) in rig.owner.learned.clone().expect("it was given").files(chip()) {
                let text = fs::read_to_string(path).expect("text");
                let is_right =
                    ["15000", "16000"].iter().any(|qmax| text.contains(&format!("qmax-cell-0 = {qmax}")));
                assert!(is_right, "transfer {number}: {text}");
            }
            let _ = fs::remove_dir_all(&folder);
            if is_done {
                break;
            }
            number += 1;
        }
        assert!(number > 10, "{number}");
    }

    /// A part with a profile and a pack of that name, and two rows in different blocks of what it learns.
    fn any(chip: &'static Chip, folder: &Path) -> (Rig, [(&'static Subclass, &'static Parameter, u16); 2]) {
        let rows =
            || chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let design = rows().find(|(_, row)| row.name == "Design Capacity").expect("each has one");
        let profile = Change::of_value(chip, design, &Value::Int(1200), false).expect("it fits").saved();
        let mut learned =
            rows().filter(|row| !row.1.unproven && chip.stays(*row) == Stays::Pack && row.1.kind.size() == 2);
        let (class, row) = learned.clone().find(|(_, row)| is_capacity(row)).expect("each has one");
        let block = |class: &Subclass, row: &Parameter| (class.id, row.offset / 32);
        let is_apart =
            |(other, at): &(&'static Subclass, &'static Parameter)| block(other, at) != block(class, row);
        let other = learned.find(is_apart).unwrap_or((class, row));
        let capacity = if row.unit == "mAh" { 1111 } else { 15_555 };
        let learned = Learned::new(folder.into(), "i2c-1-55".into(), Some("A".into()));
        let run = Run { profile: vec![profile], learned: Some(learned), ..Run::default() };
        let mut rig = Rig::of(chip.name, run);
        rig.start().expect("it answers");
        for pause in [INTERVAL, INTERVAL, FIRST, INTERVAL] {
            rig.poll_after(pause);
        }
        let second = if std::ptr::eq(other.1, row) { capacity } else { 77 };
        (rig, [(class, row, capacity), (other.0, other.1, second)])
    }

    /// The power of the gauge is lost before each transfer of a look at what it has learned, or, unnoticed, after it.
    #[test]
    fn regression_what_a_gauge_had_after_an_unnoticed_loss_was_saved_as_learned() {
        for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
            for fault in ["power-cut", "power-cut-after"] {
                let folder = folder(&format!("half-{}-{fault}", chip.name));
                for number in 1.. {
                    let (mut rig, rows) = any(chip, &folder);
                    for (class, row, value) in rows {
                        let (area, at) = match class.id {
                            FLAT => (0, usize::from(row.offset) - 0x9180),
                            id => (u16::from(id), usize::from(row.offset)),
                        };
                        rig.sim.set_flash(area, at, &value.to_be_bytes());
                    }
                    rig.clock.sleep(EVERY_SEALED);
                    let before = rig.transfers();
                    rig.sim.set("fault", &format!("{fault} {number} 1")).expect("a fault");
                    rig.poll_after(Duration::ZERO);
                    let is_done = rig.transfers() - before < number;
                    rig.sim.set("fault", "none").expect("a knob");
                    for _ in 0..4 {
                        rig.poll_after(Duration::from_secs(4));
                    }
                    rig.poll_after(EVERY_SEALED);
                    let files = rig.owner.learned.clone().expect("it was given").files(chip);
                    for (_, path) in &files {
                        let image = Image::open(path, Some(chip)).expect("an image");
                        for (_, row, value) in rows {
                            let entry = image.entries.iter().find(|entry| std::ptr::eq(entry.parameter, row));
                            let saved = entry.map(|entry| entry.value.clone());
                            assert_eq!(
                                saved,
                                Some(Value::Int(value.into())),
                                "{} {fault} {number}: {} {:?}",
                                chip.name,
                                row.name,
                                files.len()
                            );
                        }
                    }
                    let _ = fs::remove_dir_all(&folder);
                    if is_done {
                        assert_eq!(files.len(), 1, "{}: nothing was saved", chip.name);
                        break;
                    }
                }
            }
        }
    }

    /// It would be the newest version, and hide what was learned before.
    #[test]
    fn regression_what_the_profile_has_was_saved_as_learned() {
        let folder = folder("profile");
        let mut rig = rig(&folder, None);
        rig.poll_after(EVERY_SEALED);
        assert!(kept(&folder).is_empty(), "nothing was learned");
        learn(&mut rig, 15_432);
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102));
        rig.poll_after(EVERY_SEALED);
        rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
        assert_eq!(words(&mut rig), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// Qmax is in parts of Design Capacity.
    #[test]
    fn regression_qmax_of_another_design_capacity_was_restored() {
        let folder = folder("design");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_432);
        let file = kept(&folder).remove(0);
        let text = fs::read_to_string(&file).expect("text");
        fs::write(&file, text.replace("design-capacity = 1234", "design-capacity = 1235")).expect("written");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102));
        let told = told(&mut rig);
        assert!(told.contains("Design Capacity of 1235 mAh, and the profile has 1234"), "{told}");
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_capacity_of_zero_was_plausible_without_a_design_capacity() {
        let chip = Chip::by_name("bq27220").expect("it has a table");
        let rows =
            chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let row = rows.into_iter().find(|(_, row)| row.name == "Full Charge Capacity").expect("it has one");
        let name = chip.name_of(row);
        let (group, name) = name.split_once('/').expect("a group and a name");
        for (value, is_plausible) in [(0, false), (1000, true)] {
            let image = format!("chip = \"bq27220\"\n[{group}]\n{name} = {value}\n");
            let image = Image::parse(&image, Some(chip)).expect("an image");
            assert_eq!(implausible(&image, None).is_none(), is_plausible, "{value}");
        }
    }

    /// A gauge in a bay of the same host, whose pack shows its name.
    fn in_bay(folder: &Path, bay: u32) -> Rig {
        let mut rig = rig(folder, Some("A"));
        let store = Learned::new(folder.into(), format!("i2c-{bay}-55"), None);
        rig.owner.learned = Some(store.of_pack_anywhere(Some("A".into())));
        rig.owner.memory.claim = None;
        rig.poll_after(INTERVAL);
        rig
    }

    #[test]
    fn regression_two_gauges_with_one_pack_name_got_what_the_other_had_learned() {
        let folder = folder("twice");
        let mut first = in_bay(&folder, 1);
        learn(&mut first, 15_432);
        let mut second = in_bay(&folder, 2);
        lose_power(&mut second);
        assert_eq!(words(&mut second), (16_000, 102));
        first.poll_after(INTERVAL);
        for (rig, qmax) in [(&mut first, 15_433), (&mut second, 15_434)] {
            let error = rig.handle.published().last_error.to_string();
            assert!(error.contains("another gauge has the pack A as well"), "{error}");
            learn(rig, qmax);
            assert!(told(rig).contains("another gauge has the pack A as well"));
            assert_eq!(kept(&folder).len(), 1, "saved under neither");
        }
        let asked = second.ask(&op::LEARNED, Wish::Restore(None));
        assert!(asked.expect_err("whose is it").to_string().contains("no pack is in two places"));
        drop(second);
        first.poll_after(EVERY_SEALED);
        assert_eq!((kept(&folder).len(), &*first.handle.published().last_error), (2, ""));
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The bay that it has left notices that later.
    #[test]
    fn a_pack_that_moves_to_another_bay_gets_back_what_it_has_learned() {
        let folder = folder("moves");
        let (mut left, mut new) = (in_bay(&folder, 1), in_bay(&folder, 3));
        new.owner.memory.doubt();
        learn(&mut left, 15_432);
        lose_power(&mut new);
        assert_eq!(words(&mut new), (16_000, 102), "it may be in the other one");
        left.sim.set("power", "off").expect("a knob");
        left.poll_after(INTERVAL);
        for _ in 0..2 {
            new.poll_after(INTERVAL);
        }
        assert_eq!(words(&mut new), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_hosts_with_one_folder_got_what_was_learned_on_the_other() {
        let folder = folder("hosts");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_432);
        let theirs = kept(&folder).remove(0);
        let text = fs::read_to_string(&theirs).expect("text");
        let (line, rest) = text.split_once('\n').expect("lines");
        assert_eq!(line, format!("# {}", journal::Machine::this()));
        fs::write(&theirs, format!("# host bench 1 2\n{rest}")).expect("it is written");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102));
        assert!(told(&mut rig).contains("nothing is kept that could be restored"));
        // Neither does it stand in the way, nor is it removed.
        learn(&mut rig, 15_432);
        assert_eq!(kept(&folder).len(), 2);
        rig.ask(&op::LEARNED, Wish::Forget).expect("it is removed");
        assert_eq!(kept(&folder), std::slice::from_ref(&theirs));
        // One of an earlier version says nothing.
        fs::write(&theirs, rest).expect("it is written");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_version_that_is_not_trusted_kept_the_same_from_being_saved() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = folder("untrusted");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_432);
        let file = kept(&folder).remove(0);
        fs::set_permissions(&file, fs::Permissions::from_mode(0o666)).expect("it is mine");
        for _ in 0..3 {
            rig.poll_after(EVERY_SEALED);
            assert_eq!(kept(&folder).len(), 2, "once more, and no more");
        }
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_version_that_others_may_write_was_believed() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = folder("planted");
        let mut rig = rig(&folder, Some("A"));
        learn(&mut rig, 15_432);
        let file = kept(&folder).remove(0);
        for path in [&file, &folder] {
            let mode = fs::metadata(path).expect("it is there").permissions().mode();
            fs::set_permissions(path, fs::Permissions::from_mode(mode | 0o022)).expect("it is mine");
            lose_power(&mut rig);
            assert_eq!(words(&mut rig), (16_000, 102), "{}", path.display());
            let told = told(&mut rig);
            assert!(told.contains("others may write to it"), "{told}");
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("it is mine");
        }
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_pack_named_unnamed_got_what_others_had_learned() {
        let folder = folder("unnamed-name");
        let mut rig = rig(&folder, None);
        learn(&mut rig, 15_432);
        let mut rig = self::rig(&folder, Some("unnamed"));
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn a_host_that_is_on_for_two_minutes_saves_what_was_learned_while_it_was_off() {
        let folder = folder("short");
        let mut rig = rig(&folder, Some("A"));
        learn_now(&mut rig, 15_432);
        rig.poll_after(FIRST);
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (15_432, 77));
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_gauge_that_is_polled_once_an_hour_had_its_first_look_after_an_hour() {
        let folder = folder("hourly");
        let mut rig = rig(&folder, Some("A"));
        let store = rig.owner.learned.clone().expect("it was given");
        rig.owner.shared.publish(|published| published.interval = Duration::from_secs(3600));
        rig.poll_after(INTERVAL);
        for (qmax, limit) in [(15_432, FIRST), (15_433, EVERY_SEALED)] {
            learn_now(&mut rig, qmax);
            let (begun, before) = (rig.clock.now(), store.files(chip()).len());
            let polls = rig.transfers();
            while store.files(chip()).len() == before {
                // Nobody was asleep.
                rig.owner.turned = None;
                let pause = rig.owner.take_turn(None).expect("nobody ends it");
                rig.clock.sleep(pause);
                let took = rig.clock.now() - begun;
                assert!(took < limit + Duration::from_secs(5), "{qmax}: {took:?}");
            }
            // It is not polled all the time for it.
            assert!(rig.transfers() - polls < 300, "{}", rig.transfers() - polls);
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// `cargo bench --bench restore` lets 1000 days pass.
    #[test]
    fn the_state_of_charge_is_nearer_to_the_truth_with_what_was_learned() {
        use super::super::rig::days::{Remedy, days};
        for name in ["bq27441-g1", "bq27427", "bq27621-g1"] {
            let chip = Chip::by_name(name).expect("it has a table");
            let folder = folder(&format!("days-{name}"));
            let remedies = [Remedy::Nothing, Remedy::Profile, Remedy::Learned(&folder)];
            let errors = remedies.map(|remedy| days(chip, 900..908, 7, remedy));
            let [nothing, profile, learned] =
                errors.map(|errors| (errors.quantile(0.5), errors.quantile(1.0)));
            let shown = format!("{name}: {nothing:?} {profile:?} {learned:?}");
            // It shows 0 % while a third of the charge is left.
            assert!(nothing.1 > 30.0 && learned.1 < 15.0 && learned.1 <= profile.1, "{shown}");
            assert!(learned.0 < 1.0 && learned.0 * 3.0 < nothing.0, "{shown}");
            let _ = fs::remove_dir_all(folder);
        }
    }

    /// Of some parts no document prints what they learn with.
    #[test]
    fn regression_a_part_without_printed_defaults_had_nothing_saved() {
        for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
            let folder = folder(&format!("part-{}", chip.name));
            let rows = || {
                chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)))
            };
            let named = |name: &str| rows().find(|(_, row)| row.name == name);
            let design = named("Design Capacity").expect("each has one");
            let profile = Change::of_value(chip, design, &Value::Int(1200), false).expect("it fits").saved();
            let (class, row) = named("Qmax Cell 0").or(named("Full Charge Capacity")).expect("each has one");
            let learned = Learned::new(folder.clone(), "i2c-1-55".into(), Some("A".into()));
            let run = Run { profile: vec![profile], learned: Some(learned), ..Run::default() };
            let mut rig = Rig::of(chip.name, run);
            rig.start().expect("it answers");
            for pause in [INTERVAL, INTERVAL, FIRST, INTERVAL] {
                rig.poll_after(pause);
            }
            let value = if row.unit == "mAh" { 1111_u16 } else { 15_555 }.to_be_bytes();
            let (area, at) = match class.id {
                // The first address of its data memory.
                FLAT => (0, usize::from(row.offset) - 0x9180),
                id => (u16::from(id), usize::from(row.offset)),
            };
            rig.sim.set_flash(area, at, &value);
            rig.poll_after(EVERY_SEALED);
            assert!(!kept(&folder).is_empty(), "{}: nothing was saved", chip.name);
            rig.sim.set_flash(area, at, &[0x04, 0x56]);
            lose_power(&mut rig);
            let index = chip.subclasses.iter().position(|other| std::ptr::eq(other, class)).expect("its own");
            rig.ask(&op::REFRESH, ()).expect("it answers");
            let read = rig.ask(&op::READ, vec![index]).expect("it is read");
            let begin = usize::from(row.offset - class.start());
            assert_eq!(read[0][begin..begin + 2], value, "{}", chip.name);
            fs::remove_dir_all(folder).expect("it is there");
        }
    }

    #[test]
    fn every_part_with_ram_has_something_to_learn() {
        for chip in CHIPS.iter().filter(|chip| chip.volatile.is_some()) {
            assert!(!learning(chip).is_empty(), "{}", chip.name);
        }
    }
}
