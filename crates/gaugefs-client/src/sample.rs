// SPDX-License-Identifier: MIT

//! A sample of a mounted gauge: its files, all from one poll, without those that cause a transfer.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use nix::errno::Errno;

use crate::file::content;
use crate::names::serial;
use gauge_bus::clock::{Clock, RealClock};

/// The kernel's copies of the attributes are those of the last poll after this time. Polls are at least 0.5 s apart.
pub(crate) const SETTLED: Duration = Duration::from_millis(200);
/// Attempts to read all files between two polls; then a mixed sample is accepted.
const TRIES: u32 = 3;
/// Less than the time between two polls, more than the rounding of an age to milliseconds.
const SLACK: Duration = Duration::from_millis(100);

/// The values of one poll.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The time of the poll; for a gauge that is gone, the time of the sample.
    pub time: Timestamp,
    /// The poll's time on a simulated gauge's battery clock, and the clock's speed.
    pub simulated: Option<(Timestamp, f64)>,
    /// The poll's time on the monotonic clock, to distinguish polls; `None` while the gauge is gone.
    pub moment: Option<Moment>,
    /// `gauge/age_ms`.
    pub age: Option<Duration>,
    /// The attributes of `uevent`, by their file names.
    pub attributes: Vec<(String, String)>,
    /// Status registers, and the names of their set bits.
    pub words: Vec<(String, String)>,
    /// `gauge/registers`, except those in `words`.
    pub registers: Vec<(String, i64)>,
    /// `gauge/seal`, if the user may read it.
    pub seal: Option<String>,
    /// `gauge/poll_interval`, if the user may read it.
    pub interval: Option<Duration>,
    /// `gauge/last_error`.
    pub last_error: String,
    /// `gauge/check`.
    pub check: String,
}

/// A poll's time, with the precision of its age.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    earliest: Instant,
    latest: Instant,
}

impl Moment {
    /// Whether both may be the same poll.
    pub fn is_same_poll(self, other: Self) -> bool {
        self.earliest <= other.latest + SLACK && other.earliest <= self.latest + SLACK
    }

    /// A poll so much later, for an artificial history.
    pub fn later(self, time: Duration) -> Self {
        Self { earliest: self.earliest + time, latest: self.latest + time }
    }
}

impl Sample {
    /// Reads a gauge's folder. Right after a poll it waits a fraction of a second first.
    pub fn read(folder: &Path) -> io::Result<Self> {
        of_one_poll(folder, |polled| Self::once(folder, polled))
    }

    fn once(folder: &Path, polled: Option<(Duration, Moment)>) -> io::Result<Self> {
        let age = polled.map(|(_, moment)| moment.latest.elapsed());
        let time =
            Timestamp::now() - jiff::SignedDuration::try_from(age.unwrap_or_default()).unwrap_or_default();
        let attributes = attributes(folder)?;
        let gauge = folder.join("gauge");
        let names = |folder: &Path| -> io::Result<Vec<String>> {
            let Some(entries) = if_readable(fs::read_dir(folder))? else { return Ok(Vec::new()) };
            let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
            let mut names: Vec<_> = names.collect();
            names.sort();
            Ok(names)
        };
        let (mut words, mut registers) = (Vec::new(), Vec::new());
        let (files, all) = (names(&gauge)?, names(&gauge.join("registers"))?);
        for name in files.iter().filter(|name| *name == "control_status" || all.contains(name)) {
            // Configuration bits do not change by themselves.
            if name.ends_with("config") || name.ends_with("configuration") {
                continue;
            }
            words.extend(text(&gauge.join(name))?.map(|bits| (name.clone(), bits)));
        }
        for name in all.iter().filter(|name| !files.contains(name)) {
            let value = text(&gauge.join("registers").join(name))?.and_then(|text| text.parse().ok());
            registers.extend(value.map(|value| (name.clone(), value)));
        }
        let interval = text(&gauge.join("poll_interval"))?.and_then(|text| text.parse().ok());
        Ok(Self {
            time,
            simulated: simulated(folder, polled.map(|(_, moment)| moment))?,
            moment: polled.map(|(_, moment)| moment),
            age,
            attributes,
            words,
            registers,
            seal: text(&gauge.join("seal"))?,
            interval: interval.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()),
            last_error: text(&gauge.join("last_error"))?.unwrap_or_default(),
            check: text(&gauge.join("check"))?.unwrap_or_default(),
        })
    }

    /// The sample of a gauge whose mount has ended.
    pub fn absent() -> Self {
        Self {
            time: Timestamp::now(),
            simulated: None,
            moment: None,
            age: None,
            attributes: Vec::new(),
            words: Vec::new(),
            registers: Vec::new(),
            seal: None,
            interval: None,
            last_error: String::new(),
            check: String::new(),
        }
    }

    /// Text of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(found, _)| found == name).map(|(_, value)| value.as_str())
    }

    /// Number of an attribute.
    pub fn number(&self, name: &str) -> Option<i64> {
        self.attribute(name)?.parse().ok()
    }

    /// The part and the serial number, as far as known.
    pub fn pack(&self) -> (Option<&str>, Option<String>) {
        (self.attribute("model_name"), self.attribute("serial_number").map(serial))
    }

    /// Time until the next poll is readable, if the poll interval is known.
    pub fn next_poll(&self) -> Option<Duration> {
        Some(self.interval?.saturating_sub(self.age?) + SETTLED)
    }

    /// Whether the gauge is present.
    pub fn present(&self) -> bool {
        self.attribute("present") == Some("1") && self.moment.is_some()
    }

    /// The poll's time by the clock of its values: the battery's, if simulated.
    pub fn battery_time(&self) -> Timestamp {
        self.simulated.map_or(self.time, |(time, _)| time)
    }

    /// Bits set and cleared since an earlier sample, register by register: `+QEN -VOK`.
    pub fn changed_bits<'a>(&'a self, before: &'a Self) -> impl Iterator<Item = (&'a str, String)> + 'a {
        let earlier = |name: &String| before.words.iter().find(|(old, _)| old == name);
        let pairs = self.words.iter().filter_map(move |(name, bits)| Some((name, &earlier(name)?.1, bits)));
        pairs.filter(|(_, old, new)| old != new).map(|(name, old, new)| (name.as_str(), difference(old, new)))
    }

    /// `status`, or `absent`.
    pub fn status(&self) -> String {
        match self.attribute("status") {
            Some(status) if self.present() => status.into(),
            _ => "absent".into(),
        }
    }
}

pub(crate) fn attributes(folder: &Path) -> io::Result<Vec<(String, String)>> {
    let uevent = content(&folder.join("uevent"))?;
    let attributes = uevent.lines().filter_map(|line| {
        let (name, value) = line.strip_prefix("POWER_SUPPLY_")?.split_once('=')?;
        // uevent writes a space as `_`, but a name may contain a real one.
        let value = if name == "NAME" { value.to_string() } else { value.replace('_', " ") };
        Some((name.to_lowercase(), value))
    });
    Ok(attributes.collect())
}

/// Reads files of one poll. Right after a poll it waits a fraction of a second first.
pub(crate) fn of_one_poll<T>(
    folder: &Path,
    read: impl Fn(Option<(Duration, Moment)>) -> io::Result<T>,
) -> io::Result<T> {
    let mut tries = 0;
    loop {
        tries += 1;
        let before = age(folder)?;
        if let Some((age, _)) = before.filter(|(age, _)| *age < SETTLED) {
            RealClock::new().sleep(SETTLED - age);
        }
        let found = read(before)?;
        let after = age(folder)?;
        let same = match (before, after) {
            (Some((_, before)), Some((_, after))) => before.is_same_poll(after),
            (before, after) => before.is_none() && after.is_none(),
        };
        if same || tries == TRIES {
            return Ok(found);
        }
    }
}

fn age(folder: &Path) -> io::Result<Option<(Duration, Moment)>> {
    let before = Instant::now();
    let Some(age) = text(&folder.join("gauge/age_ms"))?.and_then(|text| text.parse().ok()) else {
        return Ok(None);
    };
    let age = Duration::from_millis(age);
    let after = Instant::now();
    let moment = before.checked_sub(age).zip(after.checked_sub(age));
    Ok(moment.map(|(earliest, latest)| (age, Moment { earliest, latest })))
}

fn simulated(folder: &Path, polled: Option<Moment>) -> io::Result<Option<(Timestamp, f64)>> {
    let number = |name: &str| -> io::Result<Option<f64>> {
        Ok(text(&folder.join("sim").join(name))?.and_then(|text| text.parse().ok()))
    };
    let Some((clock, speed)) = number("clock")?.zip(number("speed")?) else { return Ok(None) };
    // The battery's clock has gone on since the poll.
    let age = polled.map_or(0.0, |moment| moment.latest.elapsed().as_secs_f64());
    let time = Timestamp::from_millisecond(((clock - age * speed) * 1000.0) as i64);
    Ok(time.ok().map(|time| (time, speed)))
}

fn difference(before: &str, after: &str) -> String {
    let (before, after): (Vec<_>, Vec<_>) =
        (before.split_whitespace().collect(), after.split_whitespace().collect());
    let set = after.iter().filter(|bit| !before.contains(bit)).map(|bit| format!("+{bit}"));
    let cleared = before.iter().filter(|bit| !after.contains(bit)).map(|bit| format!("-{bit}"));
    set.chain(cleared).collect::<Vec<_>>().join(" ")
}

pub(crate) fn text(path: &Path) -> io::Result<Option<String>> {
    Ok(if_readable(content(path))?.map(|text| text.trim_end().to_string()))
}

/// `None` for a file that is missing or not readable for this user.
pub(crate) fn if_readable<T>(outcome: io::Result<T>) -> io::Result<Option<T>> {
    match outcome {
        Ok(value) => Ok(Some(value)),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) => Ok(None),
        Err(error) if error.raw_os_error() == Some(Errno::ENODEV as i32) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_samples_of_one_poll_are_recognised() {
        let now = Instant::now();
        let at = |ms: u64| Moment {
            earliest: now + Duration::from_millis(ms),
            latest: now + Duration::from_millis(ms + 3),
        };
        assert!(at(10).is_same_poll(at(12)) && at(12).is_same_poll(at(10)));
        assert!(!at(0).is_same_poll(at(500)) && !at(500).is_same_poll(at(0)));
    }
}
