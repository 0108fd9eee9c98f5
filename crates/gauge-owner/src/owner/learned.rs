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
        [&self.folder, path].into_iter().try_for_each(|path| journal::check(path, self.trusted))
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
fn restored(image: &Image) -> Result<Vec<Change>> {
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
mod tests;
