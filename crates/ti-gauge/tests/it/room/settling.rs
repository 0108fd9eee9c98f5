// SPDX-License-Identifier: MIT

//! A host that starts again on a gauge that an earlier one has left.

use std::fs;
use std::panic::resume_unwind;
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use gauge_sim::SimBus;
use ti_gauge::dataflash::{Change, DataFlash, Limits, Outcome};
use ti_gauge::error::Result;
use ti_gauge::keys::Keys;

use super::{Folder, PowerCut, until_cut};
use crate::rig::Rig;

pub(crate) type Transferred = std::result::Result<(), BusError>;

impl Rig {
    /// A program starts at the place of that folder's journal.
    pub(crate) fn start(&mut self, folder: &Folder) {
        self.start_with(folder, Keys::default(), |bus, _, write, read| bus.transfer(write, read));
    }

    /// A program starts there with keys, on a bus that hands each transfer to a function.
    pub(crate) fn start_with(
        &mut self,
        folder: &Folder,
        keys: Keys,
        act: impl FnMut(&mut SimBus, u64, &[u8], &mut [u8]) -> Transferred + Send + 'static,
    ) {
        self.numbered_through(keys, Ok(()), act);
        self.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    }

    /// The gauge arrives, and what is owed to it is settled.
    pub(crate) fn arrive(&mut self) -> Result<Option<String>> {
        let answers = self.gauge.identify()?;
        self.dataflash.meet(self.gauge.chip, &answers);
        self.settle()
    }

    pub(crate) fn settle(&mut self) -> Result<Option<String>> {
        self.dataflash.settle(&mut self.gauge, Duration::ZERO)
    }

    pub(crate) fn write_all(&mut self, changes: &[Change]) -> Result<Outcome> {
        self.dataflash.write(&mut self.gauge, changes, Duration::ZERO)
    }

    pub(crate) fn set(&self, knob: &str, value: &str) {
        self.sim.set(knob, value).expect("a knob");
    }

    pub(crate) fn get(&self, knob: &str) -> String {
        self.sim.get(knob).expect("a knob")
    }

    /// Power is lost and comes back.
    pub(crate) fn power_cycle(&self) {
        self.set("power", "off");
        self.set("power", "on");
        self.clock.sleep(Duration::from_secs(3));
    }

    pub(crate) fn pause(&self, seconds: u64) {
        self.clock.sleep(Duration::from_secs(seconds));
    }
}

impl Folder {
    /// The open entry of the journal.
    pub(crate) fn text(&self) -> Option<String> {
        let text = fs::read_to_string(self.journal().path()).ok()?;
        Some(text.rsplit("\nover\n").next().unwrap_or_default().into())
    }
}

pub(crate) fn programs(write: &[u8]) -> bool {
    matches!(write, [0x60, _, ..])
}

/// A change of two blocks, the serial number's first.
pub(crate) fn two_blocks(rig: &Rig) -> [Change; 2] {
    [rig.change(48, 11, "2200"), rig.change(80, 53, "3100")]
}

/// The host loses power right after the first transfer of a write for which `at` holds.
pub(crate) fn cut(
    rig: &mut Rig,
    folder: &Folder,
    changes: &[Change],
    at: impl Fn(&[u8]) -> bool + Send + 'static,
) {
    rig.start_with(folder, Keys::default(), move |bus, _, write, read| {
        let done = bus.transfer(write, read);
        if at(write) {
            resume_unwind(Box::new(PowerCut));
        }
        done
    });
    let said = until_cut(|| rig.write_all(changes));
    assert!(said.is_none(), "the host loses power: {said:?}");
    rig.start(folder);
    rig.pause(5);
}

/// The first of two blocks is new, and the second one is old.
pub(crate) fn half_way(rig: &mut Rig, folder: &Folder) {
    let changes = two_blocks(rig);
    cut(rig, folder, &changes, programs);
}

pub(crate) const RESET: [u8; 3] = [0x00, 0x41, 0x00];
