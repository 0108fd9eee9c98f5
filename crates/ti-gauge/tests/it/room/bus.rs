// SPDX-License-Identifier: MIT

//! A bus on which a test does something at a transfer.

use std::time::Duration;

use gauge_bus::Bus;
use gauge_sim::SimBus;
use ti_gauge::dataflash::{Change, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::Gauge;
use ti_gauge::keys::Keys;

use super::Transferred;
use crate::rig::Rig;

/// A bus that hands each transfer to a function, with its number.
struct Through<F> {
    bus: SimBus,
    number: u64,
    act: F,
    claimed: Transferred,
}

impl<F> Bus for Through<F>
where
    F: FnMut(&mut SimBus, u64, &[u8], &mut [u8]) -> Transferred + Send,
{
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Transferred {
        self.number += 1;
        (self.act)(&mut self.bus, self.number, write, read)
    }

    fn claim(&mut self) -> Transferred {
        self.claimed
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}

impl Rig {
    pub(crate) fn through(
        &mut self,
        act: impl FnMut(&mut SimBus, &[u8], &mut [u8]) -> Transferred + Send + 'static,
    ) {
        self.claimed_through(Ok(()), act);
    }

    pub(crate) fn claimed_through(
        &mut self,
        claimed: Transferred,
        mut act: impl FnMut(&mut SimBus, &[u8], &mut [u8]) -> Transferred + Send + 'static,
    ) {
        self.numbered_through(Keys::default(), claimed, move |bus, _, write, read| act(bus, write, read));
    }

    /// From here on each transfer is handed to `act` with its number, from 1; `claimed` answers a claim.
    pub(crate) fn numbered_through(
        &mut self,
        keys: Keys,
        claimed: Transferred,
        act: impl FnMut(&mut SimBus, u64, &[u8], &mut [u8]) -> Transferred + Send + 'static,
    ) {
        let bus = Through { bus: self.sim.bus(), number: 0, act, claimed };
        self.gauge = Gauge::new(self.gauge.chip, Box::new(bus), self.clock.clone(), keys);
    }

    /// Runs `act` right after the first transfer that `at` picks, `count` times.
    pub(crate) fn after(&mut self, at: fn(&[u8]) -> bool, mut count: u32, act: impl Fn() + Send + 'static) {
        self.through(move |bus, write, read| {
            let done = bus.transfer(write, read);
            if at(write) && count > 0 {
                count -= 1;
                act();
            }
            done
        });
    }

    pub(crate) fn write_values(&mut self, values: &[((u8, u16), &str)]) -> Result<Outcome> {
        let changes: Vec<Change> =
            values.iter().map(|((subclass, offset), text)| self.change(*subclass, *offset, text)).collect();
        self.dataflash.write(&mut self.gauge, &changes, Duration::ZERO)
    }

    pub(crate) fn set_fault(&self, fault: &str) {
        self.sim.set("fault", fault).expect("a fault");
    }

    pub(crate) fn bytes(&self, at: usize, length: usize) -> Vec<u8> {
        self.sim.flash()[at..at + length].to_vec()
    }

    /// The position of a place in the image of all data flash.
    pub(crate) fn position(&self, subclass: u8, offset: usize) -> usize {
        let probe = Rig::new(self.gauge.chip.name);
        probe.sim.set_flash(subclass.into(), offset, &[0xa5]);
        let first = probe.sim.flash();
        probe.sim.set_flash(subclass.into(), offset, &[0x5a]);
        let second = probe.sim.flash();
        (0..first.len()).find(|&at| first[at] != second[at]).expect("a place in data flash")
    }
}
