//! Looks at mounted gauges again and again, from a thread for each mount.
//!
//! A file of a mount whose daemon hangs blocks who reads it, perhaps for ever. So nobody else touches
//! them: who watches sees that a mount has not been heard of.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use nix::errno::Errno;

use super::sample::Sample;
use crate::chip::{CHIPS, Parameter, Subclass, kebab_case};
use crate::daemon::mountpoint;
use crate::error::{Error, Result};

/// Where Impedance Track and its relatives keep what they have learned, in TI's words.
const STATE: &str = "State";
/// How often it is looked whether there was a poll, where the gauge does not say when the next is due.
const LOOK: Duration = Duration::from_secs(1);

/// What a thread is asked to do besides looking.
pub(super) enum Order {
    /// Poll this gauge now, through `gauge/refresh`.
    Refresh(PathBuf),
    /// Read what this gauge has learned from data flash.
    ReadLearned(PathBuf),
}

/// What a thread has seen.
pub(super) struct Report {
    /// Where it looks, as an index of [`Watch::roots`].
    pub(super) root: usize,
    /// A gauge's folder; the root itself where there was none to be seen.
    pub(super) gauge: PathBuf,
    pub(super) seen: Seen,
}

/// What there was to be seen.
pub(super) enum Seen {
    Sample(Box<Sample>),
    /// Nothing, for this reason.
    Trouble(String),
    /// The outcome of [`Order::ReadLearned`].
    Learned(Result<Vec<Learned>, String>),
    /// An order that could not be followed.
    Refused(String),
}

/// One parameter that the gauge itself rewrites.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Learned {
    pub(super) name: &'static str,
    pub(super) value: String,
    pub(super) unit: &'static str,
}

/// The threads.
pub(super) struct Watch {
    /// What is looked at: mount points, or what the user named.
    pub(super) roots: Vec<PathBuf>,
    orders: Vec<Sender<Order>>,
    /// What they have seen.
    pub(super) reports: Receiver<Report>,
    sender: Sender<Report>,
    every: Option<Duration>,
    named: bool,
}

impl Watch {
    /// Looks at a mount point or a gauge's folder, or at whatever gaugefs is mounted; so often, or else once
    /// after each poll.
    pub(super) fn start(named: Option<&Path>, every: Option<Duration>) -> Result<Self> {
        let (sender, reports) = mpsc::channel();
        let (roots, orders) = (Vec::new(), Vec::new());
        let mut watch = Self { roots, orders, reports, sender, every, named: named.is_some() };
        match named {
            // Not asked for what is at its end: that may hang.
            Some(path) => watch.add(std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf()))?,
            None => watch.look_for_mounts()?,
        }
        if watch.roots.is_empty() {
            let why = "no gaugefs is mounted; mount one: gaugefs mount --help";
            return Err(Error::host("", Errno::ENOENT, why));
        }
        Ok(watch)
    }

    /// Mounts that have come since, unless the user named one.
    pub(super) fn look_for_mounts(&mut self) -> Result<()> {
        if self.named {
            return Ok(());
        }
        for path in mountpoint::list() {
            if !self.roots.contains(&path) {
                self.add(path)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, path: PathBuf) -> Result<()> {
        let (orders, received) = mpsc::channel();
        let (root, reports, every) = (self.roots.len(), self.sender.clone(), self.every);
        let thread = path.clone();
        std::thread::Builder::new()
            .stack_size(256 * 1024)
            .spawn(move || attend(root, &thread, every, &received, &reports))
            .map_err(|error| Error::io("", "cannot start a thread", &error))?;
        self.roots.push(path);
        self.orders.push(orders);
        Ok(())
    }

    /// Asks for something; what comes of it is a report.
    pub(super) fn order(&self, root: usize, order: Order) {
        // A thread ends only with the watch.
        let _ = self.orders[root].send(order);
    }
}

/// Looks, follows orders, looks again, until nobody listens any more.
fn attend(
    root: usize,
    path: &Path,
    every: Option<Duration>,
    orders: &Receiver<Order>,
    reports: &Sender<Report>,
) {
    let tell = |gauge: &Path, seen| reports.send(Report { root, gauge: gauge.to_path_buf(), seen }).is_ok();
    loop {
        let mut next = LOOK;
        let heard = match gauges(path) {
            Ok(gauges) => gauges.iter().all(|gauge| {
                let seen = match Sample::read(gauge) {
                    Ok(sample) => {
                        next = sample
                            .next_poll()
                            .map_or(next, |soon| if gauges.len() > 1 { soon.min(next) } else { soon });
                        Seen::Sample(Box::new(sample))
                    }
                    Err(error) => Seen::Trouble(trouble(path, &error)),
                };
                tell(gauge, seen)
            }),
            Err(error) => tell(path, Seen::Trouble(trouble(path, &error))),
        };
        let heard = heard
            && match orders.recv_timeout(every.unwrap_or(next)) {
                Ok(Order::Refresh(gauge)) => match refresh(&gauge) {
                    Ok(()) => true,
                    Err(error) => tell(&gauge, Seen::Refused(format!("refresh: {}", said(&gauge, &error)))),
                },
                Ok(Order::ReadLearned(gauge)) => tell(&gauge, Seen::Learned(learned(&gauge))),
                Err(RecvTimeoutError::Timeout) => true,
                Err(RecvTimeoutError::Disconnected) => false,
            };
        if !heard {
            return;
        }
    }
}

/// The gauges at a path: itself, or the folders in it.
fn gauges(path: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::metadata(path.join("uevent")) {
        Ok(_) => return Ok(vec![path.to_path_buf()]),
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let entries = fs::read_dir(path)?.flatten().map(|entry| entry.path());
    let mut gauges: Vec<_> = entries.filter(|entry| entry.join("uevent").exists()).collect();
    gauges.sort();
    if gauges.is_empty() { Err(ErrorKind::NotFound.into()) } else { Ok(gauges) }
}

fn trouble(root: &Path, error: &io::Error) -> String {
    match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::ENOTCONN | Errno::ECONNABORTED) => {
            format!("its daemon is gone; take it away with: gaugefs umount {}", root.display())
        }
        None | Some(Errno::ENOENT) => "not mounted".into(),
        Some(errno) => errno.desc().to_string(),
    }
}

fn refresh(gauge: &Path) -> io::Result<()> {
    fs::File::options().write(true).open(gauge.join("gauge/refresh"))?.write_all(b"1\n")
}

/// What a write was refused for.
fn said(gauge: &Path, error: &io::Error) -> String {
    match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::EACCES) => "only the mount's owner may".into(),
        Some(Errno::EROFS) => "mounted read-only".into(),
        errno => {
            let why = fs::read_to_string(gauge.join("gauge/last_error")).unwrap_or_default();
            let why = why.trim().to_string();
            if why.is_empty() { errno.map_or("failed", Errno::desc).to_string() } else { why }
        }
    }
}

/// The parameters of a part in which the state of learning shows: what it rewrites itself of TI's
/// subclass State. Rows whose address is not sure would show a wrong number.
pub(super) fn state_of_learning(model: &str) -> Vec<(&'static Subclass, &'static Parameter, PathBuf)> {
    let Some(chip) = CHIPS.iter().find(|chip| chip.model == model) else { return Vec::new() };
    let states = chip.subclasses.iter().filter(|subclass| subclass.name == STATE);
    let rows = states.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    rows.filter(|(_, row)| row.learned && !row.unproven)
        .map(|(subclass, row)| {
            let place = Path::new("df/by-name").join(chip.class_dir(subclass)).join(kebab_case(row.name));
            (subclass, row, place)
        })
        .collect()
}

/// Reads them. They are of one subclass: one visit to the gauge, which unseals it where it is sealed.
fn learned(gauge: &Path) -> Result<Vec<Learned>, String> {
    let uevent = fs::read_to_string(gauge.join("uevent")).unwrap_or_default();
    let model =
        uevent.lines().find_map(|line| line.strip_prefix("POWER_SUPPLY_MODEL_NAME=")).unwrap_or_default();
    let rows = state_of_learning(model);
    if rows.is_empty() {
        return Err("no parameter of this part is known to show it".into());
    }
    let mut values = Vec::new();
    for (_, row, place) in rows {
        let value = fs::read_to_string(gauge.join(place)).map_err(|error| {
            match error.raw_os_error().map(Errno::from_raw) {
                Some(Errno::EPERM) => "sealed: no key".into(),
                Some(Errno::EACCES) => "only the mount's owner may read data flash".into(),
                _ => said(gauge, &error),
            }
        })?;
        values.push(Learned { name: row.name, value: value.trim_end().to_string(), unit: row.unit });
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_that_learns_shows_it() {
        let names = |model| {
            let rows = state_of_learning(model);
            rows.iter().map(|(_, row, _)| row.name).collect::<Vec<_>>()
        };
        for model in ["bq34z100-G1", "bq27441-G1", "BQ27427"] {
            assert!(names(model).contains(&"Update Status"), "{model}");
            assert!(names(model).contains(&"Qmax Cell 0"), "{model}");
        }
        assert_eq!(names("bq34110"), ["Learned Full Charge Capacity"]);
        assert!(names("unheard-of").is_empty());
        // One visit to the gauge reads them all.
        for chip in CHIPS {
            let rows = state_of_learning(chip.model);
            assert!(rows.iter().all(|(subclass, ..)| std::ptr::eq(*subclass, rows[0].0)), "{}", chip.name);
        }
    }
}
