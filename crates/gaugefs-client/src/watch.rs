// SPDX-License-Identifier: MIT

//! Samples mounted gauges repeatedly, with one thread per mount.
//!
//! If a daemon hangs, a read blocks. So only these threads read; their owner notices a silent mount.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use nix::errno::Errno;

use ti_gauge::chip::{Chip, Parameter, Subclass, kebab_case};
use ti_gauge::learning::Limits;

use crate::error::{Error, Result};
use crate::file::{content, is_dead, send, text};
use crate::gauge::Gauge;
use crate::hang::{Calling, PATIENCE, SILENT, is_served, thread};
use crate::mounts;
use crate::place::{dead, gauges_at};
use crate::sample::Sample;

/// TI's subclass of learned values.
const STATE: &str = "State";
/// Sampling interval where the next poll's time is unknown.
pub const INTERVAL: Duration = Duration::from_secs(1);

/// A request to a thread.
pub enum Order {
    /// Poll this gauge now, through `gauge/refresh`.
    Refresh(PathBuf),
    /// Read the learned values of this gauge from data flash.
    ReadLearned(PathBuf),
    /// Read the thresholds of learning of this gauge from data flash.
    ReadLimits(PathBuf),
}

/// A report of a thread.
pub struct Report {
    /// The mount, as an index of [`Watch::roots`].
    pub root: usize,
    /// A gauge's folder, or the root itself if it has no gauge.
    pub gauge: PathBuf,
    /// How many gauges of the mount this round has yet to report.
    pub left: usize,
    /// The news.
    pub seen: Seen,
}

/// The news in a report.
pub enum Seen {
    /// The values of a poll.
    Sample(Box<Sample>),
    /// Why there is no sample.
    Trouble(String),
    /// The outcome of [`Order::ReadLearned`].
    Learned(Result<Vec<Learned>, String>),
    /// The outcome of [`Order::ReadLimits`]; also sent with [`Seen::Learned`] if the gauge is unsealed.
    Limits(Limits),
    /// Why an order failed.
    Refused(String),
}

/// A parameter that the gauge itself rewrites.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Learned {
    /// TI's name.
    pub name: &'static str,
    /// Its text.
    pub value: String,
    /// The unit of the number; empty without one.
    pub unit: &'static str,
}

/// The threads, and the channels to them.
pub struct Watch {
    /// Mount points, or the folder that the user named.
    pub roots: Vec<PathBuf>,
    orders: Vec<Sender<Order>>,
    /// The reports of all threads.
    pub reports: Receiver<Report>,
    sender: Sender<Report>,
    /// Each thread's call into its mount, in the order of `roots`.
    calls: Vec<Calling>,
    every: Option<Duration>,
    named: bool,
}

impl Watch {
    /// Watches a mount point, a gauge or every gaugefs mount. Without an interval, it takes one sample per poll.
    pub fn start(named: Option<&Path>, every: Option<Duration>) -> Result<Self> {
        let (sender, reports) = mpsc::channel();
        let (roots, orders, calls) = (Vec::new(), Vec::new(), Vec::new());
        let mut watch = Self { roots, orders, reports, sender, calls, every, named: named.is_some() };
        match named {
            // Symbolic links are not resolved: that may hang.
            Some(path) => {
                let path = Gauge::named(path)?;
                watch.add(std::path::absolute(&path).unwrap_or(path))?;
            }
            None => watch.find_mounts()?,
        }
        if watch.roots.is_empty() {
            let why = "no gaugefs is mounted; to mount one, see: gaugefs mount --help";
            return Err(Error::host("", Errno::ENOENT, why));
        }
        Ok(watch)
    }

    /// The next report within a time limit. A silent mount is reported each time [`PATIENCE`] passes.
    pub fn next(&self, limit: Duration) -> Option<Report> {
        let end = Instant::now() + limit;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            match self.reports.recv_timeout(left.min(INTERVAL)) {
                Ok(report) => return Some(report),
                // It cannot be disconnected: a sender is here.
                Err(_) => {
                    if let Some(root) = self.calls.iter().position(Calling::is_silent) {
                        let seen = Seen::Trouble(SILENT.into());
                        return Some(Report { root, gauge: self.roots[root].clone(), left: 0, seen });
                    }
                    if left.is_zero() {
                        return None;
                    }
                }
            }
        }
    }

    /// Adds new mounts, unless the user named one.
    pub fn find_mounts(&mut self) -> Result<()> {
        if self.named {
            return Ok(());
        }
        for path in mounts::list() {
            if !self.roots.contains(&path) {
                self.add(path)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, path: PathBuf) -> Result<()> {
        let (orders, received) = mpsc::channel();
        let (root, reports, every) = (self.roots.len(), self.sender.clone(), self.every);
        let (folder, calling) = (path.clone(), Calling::default());
        self.calls.push(calling.clone());
        thread(move || watch(root, &folder, every, &received, &reports, &calling))?;
        self.roots.push(path);
        self.orders.push(orders);
        Ok(())
    }

    /// Gives an order. Its result comes as a report.
    pub fn order(&self, root: usize, order: Order) {
        // It cannot fail: the threads end only with the watch.
        let _ = self.orders[root].send(order);
    }
}

/// Samples and follows orders until the reports have no receiver.
fn watch(
    root: usize,
    path: &Path,
    every: Option<Duration>,
    orders: &Receiver<Order>,
    reports: &Sender<Report>,
    calling: &Calling,
) {
    let report_one = |gauge: &Path, left, seen| {
        reports.send(Report { root, gauge: gauge.to_path_buf(), left, seen }).is_ok()
    };
    let report = |gauge: &Path, seen| report_one(gauge, 0, seen);
    loop {
        let mut next = INTERVAL;
        calling.begin();
        let listening = match gauges_at(path) {
            Ok(gauges) => gauges.iter().zip((0..gauges.len()).rev()).all(|(gauge, left)| {
                let sample = Sample::read(gauge);
                // There may be many, and each takes a moment.
                calling.begin();
                let seen = match sample {
                    Ok(sample) => {
                        next = sample
                            .next_poll()
                            .map_or(next, |soon| if gauges.len() > 1 { soon.min(next) } else { soon });
                        Seen::Sample(Box::new(sample))
                    }
                    Err(error) => Seen::Trouble(trouble(path, &error)),
                };
                report_one(gauge, left, seen)
            }),
            Err(error) => report(path, Seen::Trouble(trouble(path, &error))),
        };
        calling.end();
        let listening = listening
            && match every
                .map_or_else(|| order(orders, next, path, calling), |every| orders.recv_timeout(every))
            {
                Ok(Order::Refresh(gauge)) => match send(&gauge, "gauge/refresh", b"1\n") {
                    Ok(()) => true,
                    Err(failure) => report(&gauge, Seen::Refused(format!("refresh: {}", failure.reason()))),
                },
                Ok(Order::ReadLearned(gauge)) => {
                    report(&gauge, Seen::Learned(learned(&gauge)))
                        && limits(&gauge).is_none_or(|limits| report(&gauge, Seen::Limits(limits)))
                }
                Ok(Order::ReadLimits(gauge)) => {
                    limits(&gauge).is_none_or(|limits| report(&gauge, Seen::Limits(limits)))
                }
                Err(RecvTimeoutError::Timeout) => true,
                Err(RecvTimeoutError::Disconnected) => false,
            };
        if !listening {
            return;
        }
    }
}

/// Waits for an order until the next poll, as long as the daemon is there.
fn order(
    orders: &Receiver<Order>,
    next: Duration,
    path: &Path,
    calling: &Calling,
) -> Result<Order, RecvTimeoutError> {
    let until = Instant::now() + next;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        match orders.recv_timeout(left.min(PATIENCE)) {
            Err(RecvTimeoutError::Timeout) if left > PATIENCE && is_served(path, calling) => {}
            received => return received,
        }
    }
}

pub(crate) fn trouble(root: &Path, error: &io::Error) -> String {
    match error.raw_os_error().map(Errno::from_raw) {
        _ if is_dead(error) => dead(root),
        None | Some(Errno::ENOENT) => {
            "not mounted; give the folder of a mounted gauge, or its mount point".into()
        }
        Some(errno) => errno.desc().to_string(),
    }
}

/// The parameters that show learning: of TI's subclass State, rewritten by the gauge, at a certain address.
pub fn learned_parameters(model: &str) -> Vec<(&'static Subclass, &'static Parameter, String)> {
    let Some(chip) = Chip::by_model(model) else { return Vec::new() };
    let states = chip.subclasses.iter().filter(|subclass| subclass.name == STATE);
    let rows = states.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    rows.filter(|(_, row)| row.learned && !row.unproven)
        .map(|(subclass, row)| {
            let place = format!("df/by-name/{}", chip.name_of((subclass, row)));
            (subclass, row, place)
        })
        .collect()
}

fn model_name(gauge: &Path) -> String {
    let uevent = content(&gauge.join("uevent")).unwrap_or_default();
    let model = uevent.lines().find_map(|line| line.strip_prefix("POWER_SUPPLY_MODEL_NAME="));
    model.unwrap_or_default().into()
}

fn limits(gauge: &Path) -> Option<Limits> {
    let seal = content(&gauge.join("gauge/seal")).ok()?;
    (seal.trim() != "sealed").then(|| of_flash(gauge, &model_name(gauge)))
}

/// The thresholds of a gauge from data flash, or the manual's where they cannot be read.
fn of_flash(gauge: &Path, model: &str) -> Limits {
    let mut limits = Limits::default();
    let Some(chip) = Chip::by_model(model) else { return limits };
    let rows = chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
    for (class, row) in rows.filter(|(_, row)| !row.unproven) {
        let target = match (row.name, row.unit) {
            ("Quit Current", "mA") => &mut limits.quit_ma,
            ("Dsg Current Threshold", "mA") => &mut limits.discharge_ma,
            ("Chg Current Threshold", "mA") => &mut limits.charge_ma,
            ("Number of series cell", _) => limits.cells.insert(1.0),
            _ => continue,
        };
        let place = Path::new("df/by-name").join(chip.class_dir(class)).join(kebab_case(row.name));
        let text = content(&gauge.join(place)).unwrap_or_default();
        if let Ok(value) = text.trim().parse() {
            *target = value;
        }
    }
    limits
}

/// Reads the learned parameters. They share a subclass, so a sealed gauge is unsealed only once.
fn learned(gauge: &Path) -> Result<Vec<Learned>, String> {
    let rows = learned_parameters(&model_name(gauge));
    if rows.is_empty() {
        return Err("no learned parameter of this part is known".into());
    }
    let mut values = Vec::new();
    for (_, row, place) in rows {
        let value = text(gauge, &place).map_err(|failure| {
            match failure.is(&[Errno::EPERM]) && !failure.is_unopened() {
                true => "sealed: no key".into(),
                false => failure.reason(),
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
    fn parts_that_learn_have_learned_parameters() {
        let names = |model| {
            let rows = learned_parameters(model);
            rows.iter().map(|(_, row, _)| row.name).collect::<Vec<_>>()
        };
        for model in ["bq34z100-G1", "bq27441-G1", "BQ27427"] {
            assert!(names(model).contains(&"Update Status"), "{model}");
            assert!(names(model).contains(&"Qmax Cell 0"), "{model}");
        }
        assert_eq!(names("bq34110"), ["Learned Full Charge Capacity"]);
        assert!(names("unheard-of").is_empty());
        // All are in one subclass, so that one unsealing is enough.
        for chip in ti_gauge::chip::CHIPS {
            let rows = learned_parameters(chip.model);
            assert!(rows.iter().all(|(subclass, ..)| std::ptr::eq(*subclass, rows[0].0)), "{}", chip.name);
        }
    }
}
