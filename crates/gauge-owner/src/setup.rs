// SPDX-License-Identifier: MIT

//! How a gauge is run: what its options come to, with the keys, profiles and folders that they name.

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use nix::errno::Errno;

use crate::choose::{Choice, Rule};
use crate::error::{Cause, Error, Result};
use crate::folders;
use crate::key_file;
use crate::options::GaugeOptions;
use crate::owner::{Backup, Learned, Run, implausible_profile};
use crate::source::Source;
use gauge_bus::clock::Clock;
use gauge_bus::trace::{self, Trace};
use gauge_bus::{Bus, regular};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, Limits, WRITES_PER_HOUR};
use ti_gauge::image::Image;
use ti_gauge::journal::{self, Journal};
use ti_gauge::keys::Keys;

/// The bit of a folder's mode by which only the owner of a file may replace it.
const STICKY: u32 = 0o1000;

impl GaugeOptions {
    /// Its keys, from its key file or else from systemd's credential.
    pub fn keys(&self, name: &str) -> Result<Keys> {
        let mut keys = match &self.key_file {
            Some(path) => key_file::from_file(path, name)?,
            None => key_file::from_credential(name)?.unwrap_or_default(),
        };
        keys.no_default = self.no_default_keys;
        Ok(keys)
    }

    /// Makes sure that its key file has a key of it, if there is one.
    pub fn check_keys(&self, name: &str) -> Result<()> {
        let keys = self.keys(name)?;
        match &self.key_file {
            Some(path) if keys.is_empty() => {
                let why =
                    format!("it has no key for {name}: neither above its sections nor in a section [{name}]");
                Err(Error::new(path.display().to_string(), Cause::Invalid, why))
            }
            _ => Ok(()),
        }
    }

    /// The configuration that it gets again after it has lost power, if its part is a `chip`.
    pub fn profile(&self, chip: &'static Chip) -> Result<Vec<Change>> {
        self.profile.as_ref().map_or(Ok(Vec::new()), |path| profile(path, chip))
    }

    /// The profiles to choose from, if its part is a `chip`.
    pub fn choices(&self, chip: &'static Chip) -> Result<Vec<Choice>> {
        let rules = self.choose.iter().filter(|rule| rule.chip.is_none_or(|named| ptr::eq(named, chip)));
        let choice = |rule: &Rule| Ok(Choice { profile: profile(&rule.profile, chip)?, rule: rule.clone() });
        rules.map(choice).collect()
    }

    /// Makes sure that what its rules look at can be looked at.
    pub fn check_rules(&self) -> Vec<Error> {
        self.choose.iter().filter_map(|rule| rule.evidence.as_ref()?.check().err()).collect()
    }

    /// Whether its trace can be recorded. A file that is there is not recorded over.
    pub fn check_trace(&self) -> Result<()> {
        let Some(path) = &self.trace else { return Ok(()) };
        trace::check(path, self.trace_replace).map_err(|error| {
            let name = path.display().to_string();
            if error.kind() == ErrorKind::AlreadyExists {
                let why =
                    "the trace is there already; move it away, choose another name, or replace it with --trace-replace";
                return Error::host(name, Errno::EEXIST, why);
            }
            Error::io(name, "cannot write the trace", &error)
        })
    }

    /// The bus, with every transfer recorded if that is wanted.
    pub(crate) fn traced(
        &self,
        bus: Box<dyn Bus>,
        address: u8,
        clock: &Arc<dyn Clock>,
        head: &str,
    ) -> Result<Box<dyn Bus>> {
        Ok(match &self.trace {
            Some(path) => Box::new(Trace::new(bus, address, path, clock.clone(), head, self.trace_replace)?),
            None => bus,
        })
    }

    /// Time between two polls of a gauge there.
    pub(crate) fn interval(&self, source: &Source) -> Duration {
        self.poll.unwrap_or_else(|| source.interval())
    }

    /// How the owner of a gauge, a `chip`, runs it. `place`: the folder of journals and backups, and its name there.
    pub fn run(
        &self,
        keys: Keys,
        chip: &'static Chip,
        subject: &str,
        place: Option<(PathBuf, String)>,
        no_backup: bool,
    ) -> Result<Run> {
        let key_file = self.key_file.as_ref().map(|path| path.display().to_string());
        Ok(Run {
            keys,
            keys_from: key_file.or_else(key_file::of_credential),
            interval: self.interval(&Source::of(self)?),
            reach: self.reach(),
            limits: Limits {
                allow_learning: self.allow_learning,
                writes_per_hour: self.writes_per_hour.unwrap_or(WRITES_PER_HOUR),
            },
            profile: self.profile(chip)?,
            choices: self.choices(chip)?,
            learned: place
                .clone()
                .map(|(folder, key)| Learned::new(folder, key, self.pack.clone()).trusting(folders::service)),
            journal: place
                .clone()
                .map(|(folder, key)| Journal::new(folder, key, subject.into()).trusting(folders::service)),
            backup: place
                .filter(|_| !no_backup)
                .map(|(folder, key)| Backup::new(folder, key).trusting(folders::service)),
            options: self.clone(),
            ..Run::default()
        })
    }
}

fn profile(path: &Path, chip: &'static Chip) -> Result<Vec<Change>> {
    let refuse = |why| Err(Error::new(path.display().to_string(), Cause::Invalid, why));
    if chip.volatile.is_none() {
        let why = "is flash, which keeps its configuration: write the file once, with gaugefs import";
        return refuse(format!("the data memory of a {} {why}", chip.model));
    }
    let image = Image::open(path, Some(chip))?;
    check_own(path)?;
    if let Some(why) = implausible_profile(&image) {
        return refuse(format!("{why}; leave that out, and the gauge begins with its own"));
    }
    image.to_restore().map_err(|error| error.within(&path.display().to_string()))
}

/// Makes sure that nobody else can have written a profile, which is written to the gauge without a question.
fn check_own(path: &Path) -> Result<()> {
    if regular::is_inherited(path) {
        return Ok(());
    }
    let name = path.display().to_string();
    let own = |path: &Path| journal::is_own(path, folders::service);
    let folder = |path: &Path| match path.parent() {
        // Nobody replaces another's file there.
        Some(folder) if fs::metadata(folder)?.mode() & STICKY != 0 => Ok(()),
        Some(folder) => own(&fs::canonicalize(folder)?),
        None => Ok(()),
    };
    let real = fs::canonicalize(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
    let checked = own(&real).and_then(|()| folder(&real)).and_then(|()| folder(path));
    checked.map_err(|error| {
        let why = format!(
            "{error}, so it is not written to the gauge: make the file and its folder yours or root's, and only theirs to \
             write (chown, chmod go-w)"
        );
        Error::new(name, Cause::NotPermitted, why)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regression_a_profile_could_have_what_no_gauge_learns_or_be_for_flash() {
        let path = std::env::temp_dir().join(format!("gaugefs-profile-{}", std::process::id()));
        for (chip, text, expected) in [
            ("bq27441-g1", "[state]\ndesign-capacity = 2100\nqmax-cell-0 = 16000\n", ""),
            ("bq27441-g1", "[state]\nqmax-cell-0 = 5000\n", "Qmax Cell 0 is 5000"),
            ("bq27441-g1", "[r-a-ram]\nr-a0-3 = 0\n", "R_a0 3 is 0"),
            ("bq27220", "[cedv-profile-1]\nfull-charge-capacity = 3000\n", ""),
            (
                "bq27220",
                "[cedv-profile-1]\ndesign-capacity = 1000\nfull-charge-capacity = 3000\n",
                "one and a half times 1000",
            ),
            ("bq34z100-g1", "[configuration-data]\ndesign-capacity = 1000\n", "is flash"),
        ] {
            std::fs::write(&path, format!("chip = \"{chip}\"\n{text}")).expect("a file");
            let chip = Chip::by_name(chip).expect("it has a table");
            let why = profile(&path, chip).map_or_else(|error| error.to_string(), |_| String::new());
            assert!(why.contains(expected) && why.is_empty() == expected.is_empty(), "{text}: {why}");
        }
        std::fs::remove_file(path).expect("it is there");
    }

    #[test]
    fn regression_a_profile_that_others_may_write_was_believed() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = std::env::temp_dir().join(format!("gaugefs-own-profile-{}", std::process::id()));
        let (inside, outside) = (folder.join("inside"), folder.join("outside"));
        let (file, link) = (inside.join("pack.toml"), outside.join("link.toml"));
        fs::create_dir_all(&inside).and_then(|()| fs::create_dir(&outside)).expect("folders");
        fs::write(&file, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 2100\n").expect("a file");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        let set = |path: &Path, mode| {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("it is mine");
        };
        let chip = Chip::by_name("bq27441-g1").expect("it has a table");
        let why = |path: &Path| profile(path, chip).err().map(|error| error.to_string());
        set(&file, 0o644);
        for (path, mode, refused) in [
            (&file, 0o664, [true, true]),
            (&file, 0o646, [true, true]),
            (&inside, 0o775, [true, true]),
            (&outside, 0o777, [false, true]),
            (&outside, 0o1777, [false, false]),
        ] {
            let before = fs::metadata(path).expect("it is there").permissions().mode();
            set(path, mode);
            for (named, refused) in [&file, &link].into_iter().zip(refused) {
                let why = why(named);
                let is_told = why.as_ref().is_some_and(|why| why.contains("others may write to it"));
                assert_eq!((why.is_some(), is_told), (refused, refused), "{mode:o}: {why:?}");
            }
            set(path, before & 0o755);
            assert_eq!((why(&file), why(&link)), (None, None));
        }
        fs::remove_dir_all(folder).expect("it is there");
    }
}
