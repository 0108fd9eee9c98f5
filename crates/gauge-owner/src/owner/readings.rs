// SPDX-License-Identifier: MIT

//! What is read without being asked for: each tier of registers when it is due, and what attributes need of data flash.

use std::time::Duration;

use super::access::{Access, word};
use super::handle::Shared;
use super::now::{Content, Presence};
use crate::error::{Cause, Error, Result, Step};
use ti_gauge::check::{History, Poll, Summary};
use ti_gauge::chip::{Chip, Role, Source, Tier};
use ti_gauge::epoch::Fact;
use ti_gauge::gauge::{Gauge, Seal, Statistics};
use ti_gauge::registers::Registers;

#[derive(Debug)]
pub(super) struct Readings {
    /// Registers of the tiers that are not read with every poll.
    rare: Registers,
    /// The static tier has been read since data flash last changed.
    statics: Fact<(), Content>,
    /// What attributes need of data flash has been read since then, or was tried.
    looked: Fact<(), Content>,
    /// Polls in a row that found a gauge which has not measured since its power-up or reset.
    unmeasured: u32,
    /// What the polls of one presence have shown.
    history: Fact<History, Presence>,
}

impl Readings {
    pub(super) fn new(chip: &'static Chip) -> Self {
        Self {
            rare: Registers::unread(chip.registers),
            statics: Fact::default(),
            looked: Fact::default(),
            unmeasured: 0,
            history: Fact::default(),
        }
    }

    /// Another gauge may be there.
    pub(super) fn forget(&mut self, chip: &'static Chip) {
        self.rare = Registers::unread(chip.registers);
    }

    /// A write has changed what attributes need of data flash, and registers that are copies of it.
    pub(super) fn look_again(&mut self) {
        self.statics = Fact::default();
        self.looked = Fact::default();
    }

    pub(super) fn unmeasured(&self) -> u32 {
        self.unmeasured
    }

    /// Reads what is due, also copies of data memory if `watched` for its loss, and returns when the poll began.
    pub(super) fn read(&mut self, access: &mut Access, watched: bool) -> Result<(Duration, Registers)> {
        let chip = access.chip();
        let mut taken = access.now();
        let slow = access.schedule().reads_slow_tier();
        let statics = watched || !self.statics.is_known(access.shared().content());
        if slow || statics {
            self.read_rare(access.gauge(), slow, statics)?;
            self.statics.learn(access.shared().content(), ());
        }
        // A primary cell is measured only while CONTROL_STATUS says so.
        let shows_measuring = self.unmeasured > 0 || chip.condition.primary.is_some();
        if access.shared().is_asked() && (slow || statics || shows_measuring) {
            access.read_status()?;
        }
        let mut registers = self.read_polled(access)?;
        if registers.are_all_ones() {
            let why = "every byte reads 0xff, as on a bus without a gauge; check that it is connected";
            return Err(Error::new(chip.name, Cause::Protocol, why).at(Step::Read));
        }
        let shows_change = |shared: &Shared, registers: &Registers| {
            had_battery(shared).is_some_and(|had| had != has_battery(chip, registers))
        };
        if access.needs_second_poll(&registers)? || shows_change(access.shared(), &registers) {
            access.schedule().reads(taken);
            access.wait_for_turn();
            taken = access.now();
            if statics {
                self.read_rare(access.gauge(), false, true)?;
            }
            registers = self.read_polled(access)?;
        }
        Ok((taken, registers))
    }

    /// Reads the tiers that are due in one pass: a burst may hold registers of each.
    fn read_rare(&mut self, gauge: &mut Gauge, slow: bool, statics: bool) -> Result<()> {
        self.rare.read(gauge, |tier| match tier {
            Tier::Slow => slow,
            Tier::Static => statics,
            Tier::Poll | Tier::Proven | Tier::Window => false,
        })
    }

    /// Reads the tiers of each poll, and adds them to the others.
    fn read_polled(&self, access: &mut Access) -> Result<Registers> {
        let is_proven = access.shared().published().limited.is_none();
        let mut registers = self.rare.clone();
        registers.read(access.gauge(), |tier| match tier {
            Tier::Poll => true,
            Tier::Proven => is_proven,
            Tier::Slow | Tier::Static | Tier::Window => false,
        })?;
        Ok(registers)
    }

    /// Notes whether the gauge has measured. One that has not is polled again soon.
    pub(super) fn note_measurement(&mut self, access: &mut Access, registers: &Registers) {
        let has_measured = has_measured(access, registers);
        self.unmeasured = if has_measured { 0 } else { self.unmeasured.saturating_add(1) };
        if self.unmeasured > 0 {
            let (now, interval) = (access.now(), access.shared().published().interval);
            access.schedule().try_again(now, self.unmeasured, interval);
        }
    }

    /// Notes what a check needs of a poll.
    pub(super) fn note_history(&mut self, access: &Access, time: Duration, registers: &Registers) -> Summary {
        let shared = access.shared();
        let statistics = &shared.statistics;
        let own = [&statistics.resets, &statistics.flash_writes].map(Statistics::read);
        let poll = Poll {
            time: time.as_secs_f64(),
            registers,
            control_status: access.control_status(),
            is_measured: self.unmeasured == 0,
            own: own.iter().sum(),
            keys: Statistics::read(&statistics.keys),
        };
        let history = self.history.in_epoch(shared.published().presence);
        history.note(access.chip(), &poll);
        history.summary()
    }

    /// Reads what attributes and messages need of data flash, once after each change of it, if the gauge is open.
    pub(super) fn look_at_dataflash(&mut self, access: &mut Access) {
        let (published, content) = (access.shared().published(), access.shared().content());
        let is_closed = published.limited.is_some() || published.seal == Seal::Sealed;
        if is_closed || self.looked.is_known(content) {
            return;
        }
        // If it fails, the next look follows a change.
        self.looked.learn(content, ());
        access.read_if_open();
    }
}

/// Whether the gauge has measured since its power-up or reset: then it has more than 0 mV. With a battery or a loss of
/// power that the last poll did not show it may have started since CONTROL_STATUS was read.
fn has_measured(access: &Access, registers: &Registers) -> bool {
    let chip = access.chip();
    let read = |registers: &Registers, role| registers.value(chip.register(role)?);
    let starts = i64::from(chip.condition.present | chip.volatile.unwrap_or(0));
    let published = access.shared().published();
    let before = published.snapshot.as_ref().and_then(|last| read(&last.registers, Role::Flags));
    let has_started =
        read(registers, Role::Flags).zip(before).is_some_and(|(now, before)| now & !before & starts != 0);
    let shows = |(shown_in, bit)| match shown_in {
        Source::Command(_) => word(chip, registers, shown_in).is_some_and(|word| word & bit != 0),
        // What nothing can ask for is taken for set.
        Source::Status | Source::Answer(_) | Source::Within(..) => {
            !access.shared().is_asked() || access.control_status() & bit != 0
        }
    };
    chip.condition.complete.is_none_or(shows) && read(registers, Role::VoltageNow) != Some(0) && !has_started
}

pub(super) fn has_battery(chip: &Chip, registers: &Registers) -> bool {
    chip.condition.shows_battery(chip.register(Role::Flags).and_then(|flags| registers.value(flags)))
}

/// Whether the last poll has shown a battery; `None` before it, and while the gauge is gone.
pub(super) fn had_battery(shared: &Shared) -> Option<bool> {
    let published = shared.published();
    Some(has_battery(shared.chip, &published.snapshot.as_ref()?.registers))
}
