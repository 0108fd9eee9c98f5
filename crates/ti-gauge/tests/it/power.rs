//! The host loses power at each transfer of a write and at each call of the journal's file system, and its disk
//! keeps only what was synced. Of everything else any part may be there.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{DataFlash, Limits};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::journal::{Disk, File, Journal};
use ti_gauge::keys::Keys;

use crate::journal::{Case, PowerCut, until_cut};
use crate::rig::Rig;

/// Two blocks with and without a reset, on a part with subclasses and on one with flat addresses.
const CASES: &[Case] = &[
    Case { chip: "bq34z100-g1", values: &[((48, 11), "2200"), ((80, 53), "3100")], found: Seal::Sealed },
    Case { chip: "bq34z100-g1", values: &[((58, 3), "0x5a")], found: Seal::Unsealed },
    Case {
        chip: "bq34110",
        values: &[((FLAT, 0x41F5), "3100"), ((FLAT, 0x40D7), "0x000b")],
        found: Seal::Sealed,
    },
];

/// The journal's folder, and the one above, which is there.
const FOLDER: &str = "/var/lib/gaugefs";
const PARENT: &str = "/var/lib";
/// What a disk writes in one piece.
const SECTOR: usize = 512;
/// Outcomes of a power cut that are tried besides that everything, or nothing, reached the disk.
const OUTCOMES: u64 = 8;

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
}

/// The content of a file: what is certainly on disk, and what a reader sees.
#[derive(Clone, Debug, Default)]
struct Content {
    durable: Vec<u8>,
    now: Vec<u8>,
}

/// A change of the names in a folder that is not on disk yet.
#[derive(Clone, Debug)]
enum Step {
    Link(PathBuf, usize),
    Rename(PathBuf, PathBuf, usize),
    Unlink(PathBuf),
}

/// A file system in memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    files: Vec<Content>,
    durable: BTreeMap<PathBuf, usize>,
    now: BTreeMap<PathBuf, usize>,
    steps: Vec<Step>,
}

impl State {
    fn step(&mut self, step: Step) {
        step.run(&mut self.now);
        self.steps.push(step);
    }

    fn find(&self, path: &Path) -> io::Result<usize> {
        self.now.get(path).copied().ok_or_else(|| ErrorKind::NotFound.into())
    }

    /// The journal's text.
    pub(crate) fn journal(&self) -> Option<String> {
        let number = self.find(&Path::new(FOLDER).join("i2c-1-55.journal")).ok()?;
        Some(String::from_utf8_lossy(&self.files[number].now).into_owned())
    }

    /// Whether a power cut now has only one outcome.
    fn is_synced(&self) -> bool {
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
pub(crate) fn host<T>(
    rig: &Rig,
    disk: State,
    cut: Option<(u64, bool)>,
    work: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<T>,
) -> (Option<Result<T>>, u64, State) {
    let power = Power::new(cut);
    let disk = Memory { state: Arc::new(Mutex::new(disk)), power: power.clone() };
    let bus = Powered { bus: rig.sim.bus(), power: power.clone() };
    let mut gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), Keys::default(), false);
    let journal = Journal::new(FOLDER.into(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
    let mut dataflash = DataFlash::new(Limits::default(), Some(journal.on(Arc::new(disk.clone()))));
    let said = until_cut(|| work(&mut dataflash, &mut gauge));
    let state = disk.state().clone();
    (said, power.done.load(Ordering::Relaxed), state)
}

/// The outcomes of a power cut that are tried: everything is on disk, nothing is, and some of it.
fn outcomes(disk: &State) -> Vec<State> {
    if disk.is_synced() {
        return vec![disk.clone()];
    }
    let mut left = vec![disk.after_cut(|| false), disk.after_cut(|| true)];
    for seed in 1..=OUTCOMES {
        // xorshift64
        let mut random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        left.push(disk.after_cut(|| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random >> 63 == 1
        }));
    }
    left
}

/// A write and its restart, with cuts at given places.
struct Story<'a> {
    case: &'a Case,
    model: (Vec<u8>, Vec<u8>),
}

impl Story<'_> {
    fn write(&self, rig: &Rig, cut: Option<(u64, bool)>) -> (Option<()>, u64, State) {
        let changes = self.case.changes(rig);
        let (said, calls, disk) = host(rig, State::default(), cut, |dataflash, gauge| {
            dataflash.write(gauge, &changes, Duration::ZERO)
        });
        (said.map(|said| drop(said.expect("no fault"))), calls, disk)
    }

    /// Starts again with what is left on the disk. Nothing but a loss of power may keep that from settling the write.
    fn restart(&self, rig: &Rig, disk: State, cut: Option<(u64, bool)>, at: &str) -> (bool, u64, State) {
        let (said, calls, disk) =
            host(rig, disk, cut, |dataflash, gauge| dataflash.settle(gauge, Duration::ZERO));
        let told = said.map(|said| said.unwrap_or_else(|error| panic!("{at}: {error}")));
        (told.flatten().is_some(), calls, disk)
    }

    /// Flash holds the old values or the new ones, the gauge is sealed if it was, and nothing is left to settle.
    fn check(&self, rig: &mut Rig, disk: &State, at: &str) {
        let flash = rig.sim.flash();
        assert!(flash == self.model.0 || flash == self.model.1, "{at}: neither old nor new");
        rig.clock.sleep(Duration::from_secs(3));
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{at}");
        let (seal, found) = (rig.seal(), self.case.found);
        assert!(seal == found || seal == Seal::Sealed || found == Seal::FullAccess, "{at}: {seal:?}");
        // What a cut leaves of a file that was not renamed yet is replaced by the next write.
        let left: Vec<_> =
            disk.now.keys().filter(|path| path.extension() == Some("journal".as_ref())).collect();
        assert!(left.is_empty(), "{at}: {left:?}");
    }
}

#[test]
fn a_host_power_cut_that_loses_what_was_not_synced_leaves_old_or_new_values() {
    let (mut runs, mut lossy, mut again) = (0, 0, 0);
    for case in CASES {
        let story = Story { case, model: case.model() };
        let (said, calls, disk) = story.write(&case.rig(), None);
        assert!(said.is_some());
        for left in outcomes(&disk) {
            let at = format!("{}, cut after the answer", case.name());
            let mut rig = case.rig();
            story.write(&rig, None);
            let (told, _, settled) = story.restart(&rig, left, None, &at);
            assert!(!told, "{at}: a finished write is settled again");
            story.check(&mut rig, &settled, &at);
        }
        for (number, after) in (1..=calls).flat_map(|number| [(number, false), (number, true)]) {
            let at = format!("{}, cut at {number} of {calls}, after it: {after}", case.name());
            let (said, _, disk) = story.write(&case.rig(), Some((number, after)));
            assert!(said.is_none(), "{at}");
            lossy += u64::from(!disk.is_synced());
            for (which, left) in outcomes(&disk).into_iter().enumerate() {
                let at = format!("{at}, outcome {which}");
                let mut rig = case.rig();
                story.write(&rig, Some((number, after)));
                rig.clock.sleep(Duration::from_secs(5));
                let (_, settling, settled) = story.restart(&rig, left.clone(), None, &at);
                story.check(&mut rig, &settled, &at);
                runs += 1;
                // A second cut, at some of the calls of the second start.
                for second in (number % 7 + 1..=settling).step_by(7) {
                    let at = format!("{at}, and again at {second} of {settling}");
                    let cut = Some((second, second % 2 == 0));
                    let rig = case.rig();
                    story.write(&rig, Some((number, after)));
                    rig.clock.sleep(Duration::from_secs(5));
                    let disk = story.restart(&rig, left.clone(), cut, &at).2;
                    for last in outcomes(&disk) {
                        let mut rig = case.rig();
                        story.write(&rig, Some((number, after)));
                        rig.clock.sleep(Duration::from_secs(5));
                        story.restart(&rig, left.clone(), cut, &at);
                        rig.clock.sleep(Duration::from_secs(5));
                        let (_, _, settled) = story.restart(&rig, last, None, &at);
                        story.check(&mut rig, &settled, &at);
                        again += 1;
                    }
                }
            }
        }
    }
    println!(
        "{runs} power cuts, {lossy} of them with something that was not synced; {again} more with a second one"
    );
}
