// SPDX-License-Identifier: MIT

//! A host whose disk keeps only what was synced when it loses power.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gauge_bus::{Bus, BusError};
use ti_gauge::dataflash::{DataFlash, Limits};
use ti_gauge::error::Result;
use ti_gauge::gauge::Gauge;
use ti_gauge::journal::{Disk, File, Journal};
use ti_gauge::keys::Keys;

use super::{PowerCut, until_cut};
use crate::rig::Rig;

/// The journal's folder, and the one above, which is there.
const FOLDER: &str = "/var/lib/gaugefs";

const PARENT: &str = "/var/lib";

/// What a disk writes in one piece.
const SECTOR: usize = 512;

/// The power of a host: calls and transfers so far, and the number of the one at which it ends, before or after it.
#[derive(Debug)]
struct Power {
    done: AtomicU64,
    cut: Option<(u64, bool)>,
}

impl Power {
    fn new(cut: Option<(u64, bool)>) -> Arc<Self> {
        Arc::new(Self { done: AtomicU64::new(0), cut })
    }

    fn run<T>(&self, work: impl FnOnce() -> T) -> T {
        let number = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if self.cut == Some((number, false)) {
            resume_unwind(Box::new(PowerCut));
        }
        let done = work();
        if self.cut == Some((number, true)) {
            resume_unwind(Box::new(PowerCut));
        }
        done
    }
}

/// A bus on the same power.
struct Powered<B> {
    bus: B,
    power: Arc<Power>,
}

impl<B: Bus> Bus for Powered<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.power.run(|| self.bus.transfer(write, read))
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}

/// The content of a file: what is certainly on disk, and what a reader sees.
#[derive(Clone, Debug, Default)]
pub(crate) struct Content {
    durable: Vec<u8>,
    now: Vec<u8>,
}

/// A change of the names in a folder that is not on disk yet.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    Link(PathBuf, usize),
    Rename(PathBuf, PathBuf, usize),
    Unlink(PathBuf),
}

/// A file system in memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    pub(crate) files: Vec<Content>,
    pub(crate) durable: BTreeMap<PathBuf, usize>,
    pub(crate) now: BTreeMap<PathBuf, usize>,
    pub(crate) steps: Vec<Step>,
}

impl State {
    fn step(&mut self, step: Step) {
        step.run(&mut self.now);
        self.steps.push(step);
    }

    fn find(&self, path: &Path) -> io::Result<usize> {
        self.now.get(path).copied().ok_or_else(|| ErrorKind::NotFound.into())
    }

    /// The open entry of the journal, under whatever name.
    pub(crate) fn journal(&self) -> Option<String> {
        let names = ["i2c-1-55.journal", "i2c-1-55.spare"].map(|name| Path::new(FOLDER).join(name));
        let texts = names.iter().filter_map(|path| Some(&self.files[self.find(path).ok()?].now));
        let mut texts = texts.map(|text| String::from_utf8_lossy(text).into_owned());
        // Half an entry behind one that is over was not begun.
        let is_begun = |entry: &&str| {
            let begun =
                entry.split_once("\nbegun ").and_then(|(head, rest)| Some((head, rest.split_once('\n')?.0)));
            begun.is_some_and(|(head, sum)| !head.contains('\0') && !sum.contains('\0'))
        };
        texts.find_map(|text| text.rsplit("\nover\n").next().filter(is_begun).map(str::to_string))
    }

    /// Whether a power cut now has only one outcome.
    pub(crate) fn is_synced(&self) -> bool {
        self.steps.is_empty() && self.files.iter().all(|file| file.durable == file.now)
    }

    /// What is left after a power cut. `chance` says for each piece that was not synced whether it is lost.
    pub(crate) fn after_cut(&self, mut chance: impl FnMut() -> bool) -> Self {
        let mut names = self.durable.clone();
        for step in &self.steps {
            if !chance() {
                step.run(&mut names);
            }
        }
        if !names.contains_key(Path::new(FOLDER)) {
            names.clear();
        }
        let files = self.files.iter().map(|file| Content::of(file.after_cut(&mut chance))).collect();
        Self { files, durable: names.clone(), now: names, steps: Vec::new() }
    }
}

impl Step {
    /// Where the name is.
    fn folder(&self) -> Option<&Path> {
        let (Step::Link(path, _) | Step::Rename(path, ..) | Step::Unlink(path)) = self;
        path.parent()
    }

    fn run(&self, names: &mut BTreeMap<PathBuf, usize>) {
        match self {
            Step::Link(path, file) => {
                names.insert(path.clone(), *file);
            }
            Step::Rename(from, to, file) => {
                names.remove(from);
                names.insert(to.clone(), *file);
            }
            Step::Unlink(path) => {
                names.remove(path);
            }
        }
    }
}

impl Content {
    fn of(bytes: Vec<u8>) -> Self {
        Self { durable: bytes.clone(), now: bytes }
    }

    /// Any sector that was not synced may be as it was, or zeros where there was nothing, and the length may be the
    /// old one, the new one, or the end of a sector between them.
    fn after_cut(&self, mut chance: impl FnMut() -> bool) -> Vec<u8> {
        let Self { durable, now } = self;
        if durable == now {
            return now.clone();
        }
        let mut left = durable.clone();
        let (short, long) = (durable.len().min(now.len()), durable.len().max(now.len()));
        left.resize(long, 0);
        for start in (0..now.len()).step_by(SECTOR) {
            let end = now.len().min(start + SECTOR);
            if !chance() {
                left[start..end].copy_from_slice(&now[start..end]);
            }
        }
        let ends = (short / SECTOR + 1..=long / SECTOR).map(|sector| sector * SECTOR);
        let mut ends = [now.len()].into_iter().chain(ends.rev()).chain([durable.len()]);
        left.truncate(ends.find(|_| !chance()).unwrap_or(durable.len()));
        left
    }
}

/// The file system on a disk, as long as its host has power.
#[derive(Clone, Debug)]
struct Memory {
    state: Arc<Mutex<State>>,
    power: Arc<Power>,
}

#[derive(Debug)]
struct OpenFile {
    disk: Memory,
    number: usize,
}

impl Memory {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn opened(&self, number: usize) -> Box<dyn File> {
        Box::new(OpenFile { disk: self.clone(), number })
    }
}

impl Disk for Memory {
    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        self.power.run(|| {
            let mut state = self.state();
            let number = state.files.len();
            state.files.push(Content::default());
            state.step(Step::Link(folder.into(), number));
            Ok(())
        })
    }

    fn exists(&self, path: &Path) -> bool {
        Path::new(PARENT).starts_with(path) || self.state().now.contains_key(path)
    }

    fn read(&self, path: &Path) -> io::Result<String> {
        let state = self.state();
        let content = state.files[state.find(path)?].now.clone();
        String::from_utf8(content).map_err(|_| ErrorKind::InvalidData.into())
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.power.run(|| {
            let mut state = self.state();
            if let Ok(number) = state.find(path) {
                state.files[number].now.clear();
                return Ok(self.opened(number));
            }
            let number = state.files.len();
            state.files.push(Content::default());
            state.step(Step::Link(path.into(), number));
            Ok(self.opened(number))
        })
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.state().find(path).map(|number| self.opened(number))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.power.run(|| {
            let mut state = self.state();
            let number = state.find(from)?;
            state.step(Step::Rename(from.into(), to.into(), number));
            Ok(())
        })
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        Ok(self.state().now.keys().filter(|path| path.parent() == Some(folder)).cloned().collect())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.power.run(|| {
            let mut state = self.state();
            state.find(path)?;
            state.step(Step::Unlink(path.into()));
            Ok(())
        })
    }

    fn sync(&self, folder: &Path) -> io::Result<()> {
        self.power.run(|| {
            let State { steps, durable, .. } = &mut *self.state();
            steps.extract_if(.., |step| step.folder() == Some(folder)).for_each(|step| step.run(durable));
            Ok(())
        })
    }
}

impl File for OpenFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.disk.power.run(|| {
            self.disk.state().files[self.number].now.extend_from_slice(bytes);
            Ok(())
        })
    }

    fn reserve(&mut self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        self.disk.power.run(|| {
            let file = &mut self.disk.state().files[self.number];
            file.durable = file.now.clone();
            Ok(())
        })
    }
}

/// Runs a host with the disk until it is done or loses power. Returns the engine's result, or `None` where there is
/// none, how many calls and transfers there were, and the disk before its losses.
pub(crate) fn on_disk<T>(
    rig: &Rig,
    disk: State,
    cut: Option<(u64, bool)>,
    work: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<T>,
) -> (Option<Result<T>>, u64, State) {
    let power = Power::new(cut);
    let disk = Memory { state: Arc::new(Mutex::new(disk)), power: power.clone() };
    let bus = Powered { bus: rig.sim.bus(), power: power.clone() };
    let mut gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), Keys::default());
    let journal = Journal::new(FOLDER.into(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
    let mut dataflash = DataFlash::new(Limits::default(), Some(journal.on(Arc::new(disk.clone()))));
    let said = until_cut(|| work(&mut dataflash, &mut gauge));
    let state = disk.state().clone();
    (said, power.done.load(Ordering::Relaxed), state)
}
