// SPDX-License-Identifier: MIT

//! The record of a station: a file with a line of JSON when a pack is begun, and one with the outcome.
//!
//! The first is on disk before the pack is changed, so every changed pack is finished or on record: a station that
//! starts records each pack without an outcome as failed. The record also gives the serial numbers, so none is given
//! twice. That requires one file with one writer: it is locked, and before each pack and line its name must still lead
//! to the locked file with only this station's lines.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use serde::{Deserialize, Serialize};
use ti_gauge::journal::{Disk, File};
use ti_gauge::text;

use crate::error::{Cause, Error, Result};

/// Follows a line that a loss of power has cut short.
const TORN: &str = "#torn";
/// Room on disk for the outcomes of begun packs.
const ROOM: u64 = 256 * 1024;
/// Largest number of a pack: the last whole number that every JSON reader has exactly.
const MOST: u64 = (1 << 53) - 1;

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Event {
    Begun,
    /// The pack has everything that was asked for.
    Pass,
    /// It has not, or may not have.
    #[default]
    Fail,
}

#[derive(Clone, Debug, Deserialize, PartialEq, Eq, Serialize)]
pub(super) struct Changed {
    pub(super) name: String,
    pub(super) old: String,
    pub(super) new: String,
}

/// A quantity before and after.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(super) struct Measured {
    pub(super) name: String,
    pub(super) unit: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) wanted: Option<f64>,
    /// Limits of the second value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) low: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) high: Option<f64>,
    pub(super) before: f64,
    pub(super) after: f64,
}

#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub(super) struct Entry {
    pub(super) event: Event,
    pub(super) number: u64,
    pub(super) time: String,
    pub(super) station: String,
    pub(super) gauge: String,
    pub(super) who: String,
    pub(super) chip: String,
    pub(super) image: String,
    pub(super) image_sha256: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) serial: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) label: Option<String>,
    /// The scanned text, if it differs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) scanned: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) serial_before: Option<String>,
    /// Its earlier number in the record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) seen: Option<u64>,
    /// SHA-256 of all values that the gauge does not rewrite itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) fingerprint: Option<String>,
    /// That sum as the pack came.
    #[serde(skip)]
    pub(super) found: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) step: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) changes: Vec<Changed>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) calibration: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) measured: Vec<Measured>,
    /// Names of the complete images, before and after.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) before: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) after: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) seconds: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) transfers: Option<u64>,
}

/// The record, with its facts about earlier packs.
#[derive(Debug)]
pub(super) struct Record {
    path: PathBuf,
    file: Box<dyn File>,
    held: Flock<fs::File>,
    length: u64,
    next: u64,
    /// Serial numbers of begun packs, as text.
    given: BTreeSet<String>,
    /// Serial numbers of passed packs, with their numbers in the record.
    passed: BTreeMap<String, u64>,
    /// Labels of passed packs and of those in progress, with their numbers in the record.
    labels: BTreeMap<String, u64>,
    /// Passed packs by fingerprint.
    seen: BTreeMap<String, Entry>,
    open: BTreeMap<u64, Entry>,
    last: String,
    broken: bool,
}

fn checked(entry: Entry) -> Result<Entry, String> {
    if entry.number > MOST {
        return Err(format!("number: above {MOST}"));
    }
    // What is printed of it must not look like another line.
    let Entry { time, gauge, serial, serial_before, label, scanned, step, .. } = &entry;
    let fields = [
        ("time", Some(time)),
        ("gauge", Some(gauge)),
        ("serial", serial.as_ref()),
        ("serial_before", serial_before.as_ref()),
        ("label", label.as_ref()),
        ("scanned", scanned.as_ref()),
        ("step", step.as_ref()),
    ];
    for (name, field) in fields {
        if field.is_some_and(|field| text::printable(field) != *field) {
            return Err(format!("{name}: it has characters that cannot be printed, or is too long"));
        }
    }
    Ok(entry)
}

/// Opens or creates the record, and keeps other stations out: two would give the same serial numbers.
fn lock(path: &Path) -> Result<Flock<fs::File>> {
    let name = path.display().to_string();
    let mut options = fs::File::options();
    options.read(true).append(true).create(true).mode(0o640);
    let file = regular::open(&options, path).map_err(|error| Error::io(&name, "cannot be opened", &error))?;
    Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
        Errno::EWOULDBLOCK => Error::host(name, errno, "another station uses this record"),
        errno => Error::io(name, "cannot be locked", &errno.into()),
    })
}

/// A line that does not belong in a record.
pub(super) enum Bad {
    /// A loss of power has cut the last one short.
    CutShort,
    /// Line number and reason.
    Not(usize, String),
}

/// The entries of a record. An incomplete line was never on disk as a whole, so it says nothing about a pack.
pub(super) fn lines(text: &str) -> impl Iterator<Item = Result<Entry, Bad>> + '_ {
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    let count = lines.len();
    let entry = move |at: usize| {
        let line = lines[at].trim_end_matches('\n');
        if line == TORN || lines.get(at + 1).is_some_and(|next| next.trim_end() == TORN) {
            return None;
        }
        let entry: Result<Entry, _> = serde_json::from_str(line);
        if at + 1 == lines.len() && (entry.is_err() || !text.ends_with('\n')) {
            return Some(Err(Bad::CutShort));
        }
        let entry = entry.map_err(|error| error.to_string()).and_then(checked);
        Some(entry.map_err(|error| Bad::Not(at + 1, error)))
    };
    (0..count).filter_map(entry)
}

/// The error for a line that does not belong in a record.
pub(super) fn not_a_line(name: &str, number: usize, error: &str) -> Error {
    let why = format!("not a line of a station's record: {error}; correct it, or move the file away");
    Error::new(format!("{name}: line {number}"), Cause::Invalid, why)
}

impl Record {
    /// Opens or begins the record. Marks an incomplete last line.
    pub(super) fn open(disk: &dyn Disk, path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let failed = |error| Error::io(&name, "the record cannot be used", &error);
        let held = lock(path)?;
        let text = match disk.read(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                disk.create(path).and_then(|mut file| file.sync()).map_err(failed)?;
                String::new()
            }
            read => read.map_err(failed)?,
        };
        disk.sync(path.parent().unwrap_or(Path::new("/"))).map_err(failed)?;
        let file = disk.open(path).map_err(failed)?;
        let mut record = Self {
            path: path.to_path_buf(),
            file,
            held,
            length: text.len() as u64,
            next: 1,
            given: BTreeSet::new(),
            passed: BTreeMap::new(),
            labels: BTreeMap::new(),
            seen: BTreeMap::new(),
            open: BTreeMap::new(),
            last: String::new(),
            broken: false,
        };
        // Between the two calls it may have been replaced.
        record.check()?;
        for line in lines(&text) {
            match line {
                Ok(entry) => record.note(&entry),
                Err(Bad::CutShort) => {
                    let end = if text.ends_with('\n') { "" } else { "\n" };
                    record.write(&format!("{end}{TORN}\n")).map_err(failed)?;
                }
                Err(Bad::Not(number, error)) => return Err(not_a_line(&name, number, &error)),
            }
        }
        Ok(record)
    }

    fn note(&mut self, entry: &Entry) {
        self.next = self.next.max(entry.number + 1);
        self.last.clone_from(&entry.time);
        match entry.event {
            Event::Begun => drop(self.open.insert(entry.number, entry.clone())),
            Event::Pass | Event::Fail => drop(self.open.remove(&entry.number)),
        }
        if let Some(label) = &entry.label {
            match entry.event {
                Event::Begun | Event::Pass => drop(self.labels.insert(label.clone(), entry.number)),
                // Once off the line, it may be scanned again.
                Event::Fail => {
                    if self.labels.get(label) == Some(&entry.number) {
                        self.labels.remove(label);
                    }
                }
            }
        }
        if let Some(serial) = &entry.serial {
            self.given.insert(serial.clone());
            if entry.event == Event::Pass {
                self.passed.insert(serial.clone(), entry.number);
            }
        }
        if let Some(fingerprint) = entry.fingerprint.as_ref().filter(|_| entry.event == Event::Pass) {
            self.seen.insert(fingerprint.clone(), entry.clone());
        }
    }

    fn write(&mut self, text: &str) -> io::Result<()> {
        self.file.append(text.as_bytes())?;
        self.file.sync()?;
        self.length += text.len() as u64;
        Ok(())
    }

    /// Checks that the record is the locked file, under its name, and that nobody else has written to it: a number
    /// given now would not be on record. After an error nothing more is recorded.
    pub(super) fn check(&mut self) -> Result<()> {
        let what = match (self.path.symlink_metadata(), self.held.metadata()) {
            (Err(error), _) if error.kind() == ErrorKind::NotFound => "removed or renamed".to_string(),
            (Err(error), _) | (_, Err(error)) => format!("made unreadable: {error}"),
            (Ok(named), Ok(held)) if (named.dev(), named.ino()) != (held.dev(), held.ino()) => {
                "replaced by another file".to_string()
            }
            (Ok(named), Ok(_)) if named.len() < self.length => "cut short".to_string(),
            (Ok(named), Ok(_)) if named.len() > self.length => "written to by another program".to_string(),
            _ => return Ok(()),
        };
        self.broken = true;
        let why = format!(
            "the record was {what} since the station has opened it; no pack is begun without it: put the right file \
             back, and start the station again"
        );
        Err(Error::new(self.path.display().to_string(), Cause::Gone, why))
    }

    /// Adds a line. On return it is on disk, and after a begun pack there is room for the outcome too.
    pub(super) fn append(&mut self, entry: &Entry) -> Result<()> {
        let name = self.path.display().to_string();
        if self.broken {
            let why = "an earlier line could not be written, or the record is not the same file any more; correct that, \
                       and start the station again";
            return Err(Error::new(name, Cause::Busy, why));
        }
        self.check()?;
        let line = to_line(entry);
        let room = if entry.event == Event::Begun { ROOM } else { 0 };
        if let Err(error) = self.file.reserve(self.length + line.len() as u64 + room) {
            return Err(Error::io(name, "there is no room for the record", &error));
        }
        if let Err(error) = self.write(&line) {
            self.broken = true;
            // It may be in the file without being on disk. No reader may believe it.
            let _ = self.file.truncate(self.length);
            return Err(Error::io(name, "the record cannot be written", &error));
        }
        self.note(entry);
        Ok(())
    }

    /// Adds a line after a failed one, so that the file agrees with what people were told. Returns why it may not.
    pub(super) fn supersede(&mut self, entry: &Entry) -> Result<()> {
        let length = self.path.symlink_metadata().map(|named| named.len());
        let is_same = length.is_ok_and(|length| length == self.length);
        let failed = |error| Error::io(self.path.display().to_string(), "its outcome is not on disk", &error);
        if !is_same {
            // What may be there is not this station's.
            return Err(failed(ErrorKind::NotFound.into()));
        }
        let written = self.file.append(to_line(entry).as_bytes()).and_then(|()| self.file.sync());
        written.map_err(failed)
    }

    pub(super) fn number(&mut self) -> u64 {
        self.next += 1;
        self.next - 1
    }

    pub(super) fn is_given(&self, serial: &str) -> bool {
        self.given.contains(serial)
    }

    pub(super) fn given(&self) -> impl Iterator<Item = &str> {
        self.given.iter().map(String::as_str)
    }

    pub(super) fn passed(&self, serial: &str) -> Option<u64> {
        self.passed.get(serial).copied()
    }

    /// Number in the record of the pack with that label that has passed or is in progress.
    pub(super) fn labelled(&self, label: &str) -> Option<u64> {
        self.labels.get(label).copied()
    }

    /// Number in the record of the pack with that serial number that has passed or is in progress.
    pub(super) fn taken(&self, serial: &str) -> Option<u64> {
        let mut open = self.open.values();
        let under_way =
            || open.find(|entry| entry.serial.as_deref() == Some(serial)).map(|entry| entry.number);
        self.passed(serial).or_else(under_way)
    }

    pub(super) fn seen(&self, fingerprint: &str) -> Option<&Entry> {
        self.seen.get(fingerprint)
    }

    pub(super) fn unfinished(&self) -> Vec<Entry> {
        self.open.values().cloned().collect()
    }

    /// The last line's time, or an empty text.
    pub(super) fn last(&self) -> &str {
        &self.last
    }

    pub(super) fn is_new(&self) -> bool {
        self.length == 0
    }

    pub(super) fn is_broken(&self) -> bool {
        self.broken
    }
}

fn to_line(entry: &Entry) -> String {
    serde_json::to_string(entry).expect("keys are strings, so it cannot fail") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use ti_gauge::journal::Host;

    fn path(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("gaugefs-record-{name}-{}.jsonl", std::process::id()));
        let _ = fs::remove_file(&path);
        path
    }

    fn entry(event: Event, number: u64, serial: &str) -> Entry {
        Entry { event, number, serial: Some(serial.into()), ..Entry::default() }
    }

    #[test]
    fn what_was_begun_and_not_ended_is_found_again() {
        let path = path("begun");
        let open = || Record::open(&Host, &path).expect("a record");
        let mut record = open();
        for (event, number, serial) in
            [(Event::Begun, 1, "1"), (Event::Begun, 2, "2"), (Event::Pass, 1, "1"), (Event::Begun, 3, "3")]
        {
            record.append(&entry(event, number, serial)).expect("room");
        }
        record.append(&entry(Event::Fail, 3, "3")).expect("room");
        drop(record);
        let mut again = open();
        assert_eq!(again.unfinished().iter().map(|entry| entry.number).collect::<Vec<_>>(), [2]);
        assert_eq!(again.number(), 4);
        assert!(again.is_given("2") && again.is_given("3") && !again.is_given("4"));
        assert!(again.passed("1").is_some() && again.passed("3").is_none());
        fs::remove_file(path).expect("it is there");
    }

    #[test]
    fn an_entry_is_one_line_whatever_is_in_it() {
        let path = path("hostile");
        let texts = [
            "a,b",
            "say \"no\"",
            "two\nlines",
            "\r",
            "\u{1b}[2J\u{7}\0",
            "\"}\n{\"event\":\"pass\"",
            "\u{2028}",
        ];
        let mut record = Record::open(&Host, &path).expect("a record");
        for (number, text) in (1..).zip(texts) {
            let (who, reason) = (text.to_string(), Some(text.to_string()));
            record.append(&Entry { who, reason, ..entry(Event::Begun, number, "1") }).expect("room");
        }
        drop(record);
        let text = fs::read_to_string(&path).expect("text");
        assert_eq!(text.lines().count(), texts.len(), "{text}");
        assert!(!text.contains(|letter: char| letter.is_control() && letter != '\n'), "{text:?}");
        let record = Record::open(&Host, &path).expect("a record");
        let found: Vec<_> = record.unfinished().iter().filter_map(|entry| entry.reason.clone()).collect();
        assert_eq!(found, texts);
        fs::remove_file(path).expect("it is there");
    }

    /// Wherever the file ends, what is whole counts, and the station can go on.
    #[test]
    fn a_last_line_that_was_cut_short_does_not_count() {
        let path = path("torn");
        let mut record = Record::open(&Host, &path).expect("a record");
        record.append(&entry(Event::Begun, 1, "1")).expect("room");
        let whole = fs::read(&path).expect("the record").len();
        record.append(&entry(Event::Pass, 1, "1")).expect("room");
        drop(record);
        let text = fs::read(&path).expect("the record");
        for length in whole..=text.len() {
            fs::write(&path, &text[..length]).expect("a file");
            for _ in 0..2 {
                let mut record = Record::open(&Host, &path).expect("a record");
                let is_whole = length == text.len();
                assert_eq!(record.unfinished().is_empty(), is_whole, "{length} of {}", text.len());
                if record.number() == 2 && !is_whole {
                    record.append(&entry(Event::Begun, 2, "2")).expect("room");
                    record.append(&entry(Event::Pass, 2, "2")).expect("room");
                }
            }
            let record = Record::open(&Host, &path).expect("a record");
            assert_eq!(record.is_given("2"), length < text.len());
        }
        fs::remove_file(path).expect("it is there");
    }

    #[test]
    fn one_station_at_a_time_has_a_record() {
        let path = path("locked");
        let record = Record::open(&Host, &path).expect("a record");
        let error = Record::open(&Host, &path).expect_err("it is in use").to_string();
        assert!(error.contains("another station uses this record"), "{error}");
        drop(record);
        Record::open(&Host, &path).expect("a record");
        fs::remove_file(path).expect("it is there");
    }

    #[test]
    fn a_line_that_is_none_is_refused_with_its_number() {
        let path = path("strange");
        let mut record = Record::open(&Host, &path).expect("a record");
        record.append(&entry(Event::Begun, 1, "1")).expect("room");
        drop(record);
        let text = fs::read_to_string(&path).expect("the record");
        let large = text.replace("\"number\":1", &format!("\"number\":{}", u64::MAX));
        for (line, why) in [("nonsense\n", "expected"), (&large, "number: above")] {
            fs::write(&path, format!("{text}{line}{text}")).expect("a file");
            let error = Record::open(&Host, &path).expect_err("it is none").to_string();
            assert!(
                error.contains("line 2: not a line of a station's record") && error.contains(why),
                "{error}"
            );
        }
        fs::remove_file(path).expect("it is there");
    }
}
