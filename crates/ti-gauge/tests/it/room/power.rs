// SPDX-License-Identifier: MIT

//! A host that loses power, and the folder with its journals.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gauge_bus::{Bus, BusError};
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{Change, DataFlash, Limits};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;

use crate::rig::Rig;

/// A folder that is removed when the test ends.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        // In memory if possible, because these tests call fsync many thousand times.
        let memory = Path::new("/dev/shm");
        let parent = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
        // A test that runs again behind adapters runs beside itself where all tests are one process.
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = parent.join(format!("gaugefs-journal-{name}-{}-{number}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }

    pub(crate) fn journal(&self) -> Journal {
        Journal::new(self.0.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into())
    }

    /// The journal of another place in the same folder.
    pub(crate) fn at(&self, key: &str) -> Journal {
        Journal::new(self.0.clone(), key.into(), key.into())
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    pub(crate) fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).into_iter().flatten();
        let names = entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
        // Nothing is open in a spare one.
        let mut names: Vec<String> = names.filter(|name| !name.ends_with(".spare")).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// The changes of one transaction, and the seal state in which the gauge is found.
pub(crate) struct Case {
    pub(crate) chip: &'static str,
    pub(crate) values: &'static [((u8, u16), &'static str)],
    pub(crate) found: Seal,
}

/// Each access scheme, with and without a reset, one block and several, and the serial number, by which a
/// journal is assigned to its gauge.
pub(crate) const CASES: &[Case] = &[
    Case { chip: "bq34z100-g1", values: &[((80, 53), "3100")], found: Seal::Sealed },
    Case { chip: "bq34z100-g1", values: &[((80, 53), "3100")], found: Seal::FullAccess },
    Case { chip: "bq34z100-g1", values: &[((58, 3), "0x5a")], found: Seal::Unsealed },
    Case { chip: "bq34z100-g1", values: &[((48, 4), "0x0007")], found: Seal::Sealed },
    Case {
        chip: "bq34z100-g1",
        values: &[((48, 31), "Pack 7"), ((80, 53), "3100"), ((48, 11), "2200"), ((81, 0), "61")],
        found: Seal::Sealed,
    },
    Case { chip: "bq27520-g3", values: &[((48, 10), "1200")], found: Seal::Sealed },
    Case { chip: "bq27500", values: &[((48, 10), "1200"), ((80, 48), "3100")], found: Seal::Sealed },
    Case { chip: "bq27742-g1", values: &[((2, 0), "4350"), ((48, 12), "1200")], found: Seal::Sealed },
    Case { chip: "bq27441-g1", values: &[((82, 10), "1200")], found: Seal::Sealed },
    Case { chip: "bq27441-g1", values: &[((82, 10), "1200"), ((82, 16), "3100")], found: Seal::Unsealed },
    Case { chip: "bq27426", values: &[((82, 6), "1200")], found: Seal::Sealed },
    Case { chip: "bq27427", values: &[((82, 6), "1200")], found: Seal::Sealed },
    Case { chip: "bq27621-g1", values: &[((82, 3), "1200")], found: Seal::Sealed },
    Case { chip: "bq34110", values: &[((FLAT, 0x41F5), "3100")], found: Seal::Sealed },
    Case {
        chip: "bq34110",
        values: &[((FLAT, 0x41F5), "3100"), ((FLAT, 0x40D7), "0x000b")],
        found: Seal::Sealed,
    },
    Case { chip: "bq28z610", values: &[((FLAT, 0x4202), "40"), ((FLAT, 0x4618), "7")], found: Seal::Sealed },
    Case { chip: "bq35100", values: &[((FLAT, 0x41B1), "0x82")], found: Seal::Sealed },
    Case { chip: "bq35100", values: &[((FLAT, 0x41FE), "3100")], found: Seal::Unsealed },
];

/// The panic with which the code of the host stops when it loses power.
pub(crate) struct PowerCut;

/// A bus whose host loses power at a given transfer.
struct Host<B> {
    bus: B,
    done: Arc<AtomicU64>,
    /// The number of that transfer, and whether the gauge still receives it.
    cut: Option<(u64, bool)>,
}

impl<B: Bus> Bus for Host<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        let number = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        match self.cut {
            Some((at, false)) if at == number => resume_unwind(Box::new(PowerCut)),
            Some((at, true)) if at == number => {
                let _ = self.bus.transfer(write, read);
                resume_unwind(Box::new(PowerCut))
            }
            _ => self.bus.transfer(write, read),
        }
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}

impl Case {
    pub(crate) fn rig(&self) -> Rig {
        Rig::calibrated(self.chip, self.found)
    }

    pub(crate) fn changes(&self, rig: &Rig) -> Vec<Change> {
        self.values.iter().map(|((subclass, offset), text)| rig.change(*subclass, *offset, text)).collect()
    }

    /// Flash before and after.
    pub(crate) fn model(&self) -> (Vec<u8>, Vec<u8>) {
        let mut rig = self.rig();
        let old = rig.sim.flash();
        let changes = self.changes(&rig);
        rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO).expect("no fault");
        (old, rig.sim.flash())
    }

    pub(crate) fn name(&self) -> String {
        format!("{} {:?} found {:?}", self.chip, self.values, self.found)
    }
}

/// Starts a host on the gauge of `rig`, which loses power as given. Returns the engine's result, or `None` if
/// the host lost power before there was one, and the number of transfers.
pub(crate) fn host<T>(
    rig: &Rig,
    folder: &Folder,
    cut: Option<(u64, bool)>,
    work: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<T>,
) -> (Option<Result<T>>, u64) {
    let done = Arc::new(AtomicU64::new(0));
    let bus = Host { bus: rig.sim.bus(), done: done.clone(), cut };
    let mut gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), Keys::default());
    let mut dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    let said = until_cut(|| work(&mut dataflash, &mut gauge));
    (said, done.load(Ordering::Relaxed))
}

/// What the code of a host returns; `None` if the host loses power before.
pub(crate) fn until_cut<T>(work: impl FnOnce() -> T) -> Option<T> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(said) => Some(said),
        Err(cut) if cut.is::<PowerCut>() => None,
        Err(panic) => resume_unwind(panic),
    }
}

/// The host starts again and settles an interrupted write.
pub(crate) fn restart(rig: &Rig, folder: &Folder, cut: Option<(u64, bool)>) -> (Option<Option<String>>, u64) {
    let (said, transfers) =
        host(rig, folder, cut, |dataflash, gauge| dataflash.settle(gauge, Duration::ZERO));
    (said.map(|said| said.expect("nothing stands in the way")), transfers)
}
