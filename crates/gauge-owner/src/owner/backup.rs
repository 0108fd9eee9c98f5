// SPDX-License-Identifier: MIT

//! The configuration of a gauge, saved as an image before gaugefs writes to it for the first time.

use std::fs;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::Presence;
use super::access::Access;
use super::handle::Shared;
use super::signed::{is_own as is_of_this_host, signed, temporary, unsigned};
use crate::error::{Error, Result};
use gauge_bus::regular;
use ti_gauge::chip::{CHIPS, Chip, Kind};
use ti_gauge::dataflash::{self, Change, Place, Row};
use ti_gauge::epoch::{Epoch, Fact};
use ti_gauge::image::{self, Image, toml};
use ti_gauge::journal;

/// Backups of one gauge's place that are kept.
const KEPT: usize = 10;
const SUFFIX: &str = ".backup.toml";

/// The folder with the backups of the gauges in one place.
#[derive(Clone, Debug)]
pub struct Backup {
    folder: PathBuf,
    key: String,
    trusted: journal::Trusted,
}

#[derive(Debug, PartialEq, Eq)]
enum Saved {
    /// It was written to this file.
    Written(PathBuf),
    /// The newest file has the same values.
    There(PathBuf),
}

impl Backup {
    /// Backups in a folder, of the gauges that are connected at the place that `key` identifies.
    pub fn new(folder: PathBuf, key: String) -> Self {
        Self { folder, key, trusted: || None }
    }

    /// Also believes backups of that account, as [`journal::Journal::trusting`] does.
    #[must_use]
    pub fn trusting(self, account: journal::Trusted) -> Self {
        Self { trusted: account, ..self }
    }

    fn trusts(&self, path: &Path) -> bool {
        [&self.folder, path].into_iter().all(|path| journal::is_own(path, self.trusted).is_ok())
    }

    /// Saves an image, unless the newest backup is the same. On return it is on disk.
    fn save(&self, image: &Image, serial: u16, now: Timestamp) -> Result<Saved> {
        let text = toml::write(image);
        if let Some(newest) = self.files().pop().filter(|newest| self.trusts(newest))
            && regular::read_text(&newest, image::LONGEST).is_ok_and(|found| unsigned(&found) == text)
        {
            return Ok(Saved::There(newest));
        }
        let named = |second: i64| {
            let time = (now + SignedDuration::from_secs(second)).strftime("%Y%m%dT%H%M%SZ");
            let name = format!("{}-{}-{serial:04x}-{time}{SUFFIX}", self.key, image.chip.name);
            self.folder.join(name)
        };
        // No backup replaces another.
        let path = (0..).map(named).find(|path| !path.exists()).expect("there are enough seconds");
        let temporary = self.folder.join(temporary(&self.key, "backup"));
        journal::save(&path, &temporary, &signed(&text)).map_err(|error| {
            let what = "cannot save the configuration before the first write, so nothing was written to the gauge \
                        (choose another folder with --state-dir, or mount with --no-backup)";
            Error::io(path.display().to_string(), what, &error)
        })?;
        // The clock may have been put back, so that this is not the newest by its name.
        let mut others = self.files();
        others.retain(|file| *file != path);
        let mut packs: Vec<Option<String>> = Vec::new();
        let originals = others.iter().filter(|file| {
            let pack = self.pack_of(file);
            let is_first = !packs.contains(&pack);
            packs.push(pack);
            is_first
        });
        let originals: Vec<PathBuf> = originals.cloned().collect();
        let old = &others[..others.len().saturating_sub(KEPT - 1)];
        for old in old.iter().filter(|old| !originals.contains(old)) {
            if let Err(error) = fs::remove_file(old) {
                log::warn!("{}: cannot remove this old backup: {error}", old.display());
            }
        }
        Ok(Saved::Written(path))
    }

    fn pack_of(&self, file: &Path) -> Option<String> {
        let rest = file.file_name()?.to_str()?.strip_suffix(SUFFIX)?.strip_prefix(&self.key)?;
        Some(rest.rsplit_once('-')?.0.to_string())
    }

    /// The oldest and the newest backup of a pack in any place, by a calibration or serial number of its own.
    fn own(
        &self,
        chip: &'static Chip,
        bytes: &dyn Fn(Row) -> Option<Vec<u8>>,
    ) -> Option<[(PathBuf, Image); 2]> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let part = format!("-{}-", chip.name);
        let mut files: Vec<(String, PathBuf)> = entries
            .filter_map(|entry| {
                let name = entry.file_name().into_string().ok()?;
                let rest = name.strip_suffix(SUFFIX).filter(|rest| rest.contains(&part))?;
                Some((rest.rsplit_once('-')?.1.to_string(), entry.path()))
            })
            .collect();
        files.sort();
        let own = |(_, path): &(String, PathBuf)| {
            self.trusts(path).then_some(())?;
            let image = Image::open(path, Some(chip)).ok()?;
            is_own(chip, &image, bytes).then(|| (path.clone(), image))
        };
        let oldest = files.iter().find_map(own)?;
        let newest = files.iter().rev().find_map(own)?;
        Some([oldest, newest])
    }

    /// The backups of this place and this host, oldest first.
    fn files(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut files: Vec<(String, PathBuf)> = entries
            .filter_map(|entry| {
                let name = entry.file_name().into_string().ok()?;
                let rest = name.strip_suffix(SUFFIX)?.strip_prefix(&self.key)?.strip_prefix('-')?;
                // The name of another place may begin with the name of this one.
                let rest = CHIPS.iter().find_map(|chip| rest.strip_prefix(chip.name)?.strip_prefix('-'))?;
                let (_, time) = rest.split_once('-')?;
                is_of_this_host(&entry.path()).then(|| (time.to_string(), entry.path()))
            })
            .collect();
        files.sort();
        files.into_iter().map(|(_, path)| path).collect()
    }
}

/// The backups of one gauge, and whether it has one.
pub(super) struct Backups {
    folder: Option<Backup>,
    saved: Fact<(), Presence>,
}

impl Backups {
    pub(super) fn new(folder: Option<Backup>) -> Self {
        Self { folder, saved: Fact::default() }
    }

    pub(super) fn is_saved(&self, presence: Epoch<Presence>) -> bool {
        self.saved.is_known(presence)
    }

    pub(super) fn note_saved(&mut self, presence: Epoch<Presence>) {
        self.saved.learn(presence, ());
    }

    /// Makes sure that no row of flash is erased, now or after these changes, by the table and by the pack's own backups.
    pub(super) fn check_erased(
        &self,
        access: &mut Access,
        changes: &[Change],
        waited: Duration,
    ) -> Result<()> {
        let chip = access.chip();
        let read = access.read(&readable(chip), waited)?;
        self.check_read(chip, &read, changes)
    }

    /// Checks subclasses that were read: no row of theirs is erased, now or after these changes.
    fn check_read(&self, chip: &'static Chip, read: &[Arc<[u8]>], changes: &[Change]) -> Result<()> {
        let readable = readable(chip);
        let bytes = |(subclass, parameter): Row| {
            let index = chip.subclasses.iter().position(|row| ptr::eq(row, subclass))?;
            let content = &read[readable.iter().position(|&at| at == index)?];
            let at = usize::from(parameter.offset - subclass.start());
            content.get(at..at + parameter.kind.size()).map(<[u8]>::to_vec)
        };
        let own = self.folder.as_ref().and_then(|backup| backup.own(chip, &bytes));
        let mut lost = dataflash::erased(chip, bytes);
        if let Some([(_, oldest), (_, newest)]) = &own {
            let of = |image: &Image, row: Row| image.entry(row).and_then(|entry| entry.bytes(chip));
            let since = dataflash::erased_since(chip, |row| of(oldest, row), bytes);
            lost.extend(
                since.into_iter().filter(|row| {
                    of(newest, *row).is_some_and(|bytes| bytes.iter().any(|&byte| byte != 0xff))
                }),
            );
        }
        lost.retain(|row| !changes.iter().any(|change| covers(change, *row)));
        lost.dedup_by_key(|(subclass, parameter)| (subclass.id, parameter.offset));
        if lost.is_empty() {
            return Ok(());
        }
        let remedy = match &own {
            Some([(path, _), _]) => {
                format!("write what it had before with gaugefs import GAUGE {}", path.display())
            }
            None => "write all of them in one transaction, with gaugefs import from an export of a pack like this one for \
                     example"
                .into(),
        };
        Err(dataflash::says_erased(&lost, &remedy))
    }

    /// The subclasses to be read and saved before a first write, by their indices; `None` once they are saved.
    pub(super) fn unsaved(&self, shared: &Shared) -> Option<Vec<usize>> {
        let is_due = self.folder.is_some() && !self.is_saved(shared.published().presence);
        is_due.then(|| readable(shared.chip))
    }

    /// Saves the configuration, once after an arrival.
    pub(super) fn save(&mut self, access: &mut Access, waited: Duration) -> Result<()> {
        let Some(readable) = self.unsaved(access.shared()) else { return Ok(()) };
        let read = access.read(&readable, waited).map_err(|error| error.within("backup"))?;
        self.save_read(&access.shared().clone(), &read, &[])
    }

    /// Saves what was read of [`Self::unsaved`]. An erased row that these changes do not write is refused.
    pub(super) fn save_read(
        &mut self,
        shared: &Shared,
        read: &[Arc<[u8]>],
        changes: &[Change],
    ) -> Result<()> {
        let Some(backup) = &self.folder else { return Ok(()) };
        let chip = shared.chip;
        self.check_read(chip, read, changes).map_err(|error| error.within("backup"))?;
        let published = shared.published();
        let readable = readable(chip);
        let read = readable.iter().zip(read).map(|(&index, bytes)| (index, &**bytes));
        let image = Image::of_flash(chip, Some(published.answers.firmware_version), read);
        let snapshot = published.snapshot.as_ref();
        let serial = snapshot.and_then(|snapshot| snapshot.value(serial_number(chip)?));
        let prefix = &shared.prefix;
        match backup.save(&image, serial.unwrap_or_default() as u16, Timestamp::now())? {
            Saved::Written(path) => log::info!("{prefix}configuration saved in {}", path.display()),
            Saved::There(path) => log::info!("{prefix}configuration is as saved in {}", path.display()),
        }
        self.note_saved(published.presence);
        Ok(())
    }
}

/// The subclasses, by their indices in the table, that hold a configuration: all but the keys.
pub fn readable(chip: &Chip) -> Vec<usize> {
    let rows = chip.subclasses.iter().enumerate();
    rows.filter(|(_, row)| row.kind != Kind::Security).map(|(index, _)| index).collect()
}

fn covers(change: &Change, (subclass, parameter): Row) -> bool {
    let Place { subclass: id, offset: start } = change.place();
    let end = start + change.bytes().len() as u16;
    id == subclass.id
        && (start..=end).contains(&parameter.offset)
        && parameter.offset + parameter.kind.size() as u16 <= end
}

/// Whether an image is of the pack that has these bytes. Erased bytes show nothing.
fn is_own(chip: &'static Chip, image: &Image, bytes: &dyn Fn(Row) -> Option<Vec<u8>>) -> bool {
    let mut certain = false;
    for entry in &image.entries {
        let (place, row) = ((entry.subclass.id, entry.parameter.offset), (entry.subclass, entry.parameter));
        if !chip.preflight.marks.contains(&place) || entry.parameter.learned {
            continue;
        }
        let (Some(then), Some(now)) = (entry.bytes(chip), bytes(row)) else { continue };
        if now.iter().all(|&byte| byte == 0xff) {
            continue;
        }
        if then != now {
            return false;
        }
        certain |= dataflash::distinguishes(chip, row, &now);
    }
    certain
}

fn serial_number(chip: &Chip) -> Option<&ti_gauge::chip::Register> {
    chip.registers.iter().find(|register| register.name == "SerialNumber")
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use nix::errno::Errno;

    use super::super::rig::Rig;
    use super::super::{Run, operations as op};
    use super::*;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::image::Entry;
    use ti_gauge::value::Value;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("gaugefs-backup-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    fn image(capacity: i64) -> Image {
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        let (subclass, parameter) = chip.row("48", "11").expect("Design Capacity");
        let mut image = Image::new(chip, Some(0x0016));
        image.entries.push(Entry { subclass, parameter, value: Value::Int(capacity), line: 0 });
        image
    }

    fn second(number: i64) -> Timestamp {
        Timestamp::from_second(1_800_000_000 + number).expect("a time")
    }

    #[test]
    fn a_backup_is_written_once_for_the_same_values() {
        let folder = folder("once");
        let backup = Backup::new(folder.clone(), "i2c-1-55".into());
        let first = folder.join("i2c-1-55-bq34z100-g1-0007-20270115T080000Z.backup.toml");
        assert_eq!(backup.save(&image(1000), 7, second(0)).expect("a folder"), Saved::Written(first.clone()));
        assert_eq!(fs::metadata(&first).expect("a file").permissions().mode() & 0o777, 0o600);
        assert_eq!(backup.save(&image(1000), 7, second(1)).expect("a folder"), Saved::There(first.clone()));
        assert_eq!(Image::open(&first, None).expect("an image").entries.len(), 1);
        assert!(matches!(backup.save(&image(2000), 7, second(2)), Ok(Saved::Written(_))));
        // Only the newest one counts.
        assert!(matches!(backup.save(&image(1000), 7, second(3)), Ok(Saved::Written(_))));
        assert_eq!(backup.files().len(), 3);
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn the_newest_ten_of_a_place_and_the_first_one_of_each_pack_are_kept() {
        let folder = folder("ten");
        let backup = Backup::new(folder.clone(), "i2c-1-55".into());
        let other = Backup::new(folder.clone(), "i2c-1-55-bus".into());
        other.save(&image(1), 1, second(0)).expect("a folder");
        fs::write(folder.join("i2c-1-55.bq34z100-g1-0100-0016-0001.journal"), "").expect("a file");
        for number in 0..25 {
            let serial = if number % 2 == 0 { 0xffff } else { 1 };
            backup.save(&image(number), serial, second(number)).expect("a folder");
        }
        let files = backup.files();
        let values = files.iter().map(|file| Image::open(file, None).expect("an image").entries[0].text());
        let kept: Vec<_> = (0..2).chain(15..25).map(|value| value.to_string()).collect();
        assert_eq!(values.collect::<Vec<_>>(), kept);
        assert_eq!(other.files().len(), 1);
        // A clock that was put back.
        let Saved::Written(old) = backup.save(&image(99), 1, second(-1000)).expect("a folder") else {
            panic!("these values are new")
        };
        assert!(old.exists());
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 14, "and nothing else");
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_hosts_with_one_folder_took_the_others_backups_for_their_own() {
        let folder = folder("hosts");
        let backup = Backup::new(folder.clone(), "i2c-1-55".into());
        let theirs = |number: i64| {
            let Ok(Saved::Written(path)) = backup.save(&image(number), 7, second(number)) else {
                panic!("it is new")
            };
            let text = fs::read_to_string(&path).expect("text");
            let (_, rest) = text.split_once('\n').expect("lines");
            fs::write(&path, format!("# host bench 1 2\n{rest}")).expect("it is written");
            path
        };
        let other: Vec<_> = (0..4).map(theirs).collect();
        assert!(backup.files().is_empty());
        // The same values as the other host's newest one.
        assert!(matches!(backup.save(&image(3), 7, second(4)), Ok(Saved::Written(_))));
        for number in 0..25 {
            backup.save(&image(number), 7, second(10 + number)).expect("a folder");
        }
        assert!(other.iter().all(|path| path.exists()));
        assert_eq!(backup.files().len(), KEPT + 1);
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn regression_a_backup_that_others_may_write_counted_as_saved() {
        let folder = folder("untrusted");
        let backup = Backup::new(folder.clone(), "i2c-1-55".into());
        let Ok(Saved::Written(path)) = backup.save(&image(1000), 7, second(0)) else { panic!("it is new") };
        fs::set_permissions(&path, fs::Permissions::from_mode(0o666)).expect("it is mine");
        assert!(matches!(backup.save(&image(1000), 7, second(1)), Ok(Saved::Written(_))));
        assert!(matches!(backup.save(&image(1000), 7, second(2)), Ok(Saved::There(_))));
        fs::remove_dir_all(folder).expect("it is there");
    }

    fn write(rig: &mut Rig, text: &str) -> Result<()> {
        let chip = rig.handle.chip();
        let row = chip.row("80", "53").expect("Cell Terminate Voltage");
        let value = Value::Int(text.parse().expect("a number"));
        let change = Change::of_value(chip, row, &value, false).expect("it fits");
        rig.ask(&op::WRITE, vec![change])
    }

    fn with_backup(folder: &Path) -> Rig {
        let backup = Some(Backup::new(folder.to_path_buf(), "i2c-1-55".into()));
        let mut rig = Rig::of("bq34z100-g1", Run { backup, ..Run::default() });
        rig.owner.open().expect("it answers");
        rig
    }

    #[test]
    fn the_first_write_saves_what_the_gauge_had() {
        let folder = folder("first");
        let mut rig = with_backup(&folder);
        for text in ["3100", "3200"] {
            write(&mut rig, text).expect("the default key");
        }
        let files = rig.owner.backups.folder.as_ref().expect("one is set").files();
        let [file] = &files[..] else { panic!("{files:?}") };
        let image = Image::open(file, None).expect("an image");
        let find = |name: &str| {
            let entry = image.entries.iter().find(|entry| entry.parameter.name == name);
            entry.map(Entry::text)
        };
        assert_eq!(find("Cell Terminate Voltage").as_deref(), Some("3000"));
        assert!(image.entries.iter().all(|entry| entry.subclass.kind != Kind::Security));
        let expected = rig.handle.chip().subclasses.iter().filter(|row| row.kind != Kind::Security);
        assert_eq!(image.entries.len(), expected.map(|row| row.parameters.len()).sum::<usize>());
        assert_eq!(rig.handle.published().seal, super::super::Seal::Sealed);
        // Another gauge may be in its place.
        rig.owner.arrive().expect("it answers");
        rig.owner.poll().expect("it answers");
        write(&mut rig, "3300").expect("the default key");
        assert_eq!(rig.owner.backups.folder.as_ref().expect("one is set").files().len(), 2);
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// The write that follows has to end within 30 s of its request.
    #[test]
    fn each_part_is_saved_in_a_few_seconds() {
        let folder = folder("time");
        for chip in CHIPS {
            let backup = Some(Backup::new(folder.clone(), chip.name.into()));
            let mut rig = Rig::of(chip.name, Run { backup, ..Run::default() });
            rig.owner.open().expect("it answers");
            let begun = rig.clock.now();
            let owner = &mut *rig.owner;
            owner.backups.save(&mut owner.access, Duration::ZERO).expect("the default key");
            let taken = rig.clock.now() - begun;
            assert!(taken < Duration::from_secs(8), "{}: {taken:?}", chip.name);
            println!("{}: {taken:?}", chip.name);
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    /// Erases a row of flash: subclass and the place of its first byte.
    fn erase(rig: &Rig, (id, at): (u8, usize)) {
        rig.sim.set_flash(id.into(), at, &[0xff; 32]);
        rig.clock.sleep(Duration::from_secs(1));
    }

    #[test]
    fn regression_a_pack_with_an_erased_row_was_written_to() {
        let folder = folder("erased");
        // Cell Terminate Voltage is in the second row of IT Cfg, and cannot be 65535.
        for place in [(80, 32), (48, 0)] {
            let mut rig = with_backup(&folder);
            erase(&rig, place);
            let flash = rig.sim.flash();
            let own_row = if place.0 == 80 { "3100" } else { "3200" };
            let error = write(&mut rig, own_row).expect_err("a row is erased");
            let says = error.to_string();
            assert_eq!(error.errno(), Errno::EBADMSG as i32, "{says}");
            assert!(says.contains(&format!("subclass {} offset {}", place.0, place.1)), "{says}");
            assert!(says.contains("gaugefs import") && rig.sim.flash() == flash, "{says}");
        }
        let _ = fs::remove_dir_all(folder);
    }

    /// What the table allows, such as a text of 0xff, its own backup shows to be erased.
    #[test]
    fn regression_a_row_that_only_the_backup_shows_to_be_erased_was_written_to() {
        let folder = folder("compared");
        let first = |calibration: u8| {
            let rig = with_backup(&folder);
            rig.sim.set_flash(104, 11, &[calibration]);
            rig
        };
        let mut rig = first(3);
        rig.sim.set_flash(58, 0, &[7; 32]);
        write(&mut rig, "3100").expect("it is whole");
        for calibration in [3, 5] {
            let mut rig = first(calibration);
            erase(&rig, (58, 0));
            let written = write(&mut rig, "3200");
            // Another pack may always have had that.
            let Err(error) = written else {
                assert_eq!(calibration, 5, "it is not noticed");
                continue;
            };
            let says = error.to_string();
            assert!(calibration == 3 && says.contains(".backup.toml"), "{says}");
        }
        fs::remove_dir_all(folder).expect("it is there");
    }

    #[test]
    fn without_room_for_the_backup_nothing_is_written() {
        let folder = folder("room");
        fs::write(&folder, "").expect("a file in place of the folder");
        let mut rig = with_backup(&folder);
        let flash = rig.sim.flash();
        let error = write(&mut rig, "3100").expect_err("there is no folder");
        assert!(matches!(Errno::from_raw(error.errno()), Errno::EEXIST | Errno::ENOTDIR), "{error}");
        let says = error.to_string();
        assert!(says.contains("--state-dir") && says.contains("--no-backup"), "{says}");
        assert!(rig.sim.flash() == flash);
        assert_eq!(*rig.handle.published().last_error, *says);
        fs::remove_file(&folder).expect("it is there");
        write(&mut rig, "3100").expect("now there is room");
        fs::remove_dir_all(folder).expect("it is there");
    }
}
