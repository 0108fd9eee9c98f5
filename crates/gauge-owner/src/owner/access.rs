// SPDX-License-Identifier: MIT

//! Access to the gauge. Data flash is reached through [`Access::run`] only, so that no access forgets what it owes.

use std::sync::Arc;
use std::time::Duration;

use super::debt::Debt;
use super::handle::Shared;
use super::now;
use super::schedule::Schedule;
use crate::error::Result;
use ti_gauge::chip::{Chip, Source};
use ti_gauge::dataflash::{DataFlash, Owed};
use ti_gauge::gauge::{Answers, Gauge};
use ti_gauge::keys::{Name, Secret};
use ti_gauge::registers::Registers;

mod debts;
mod reads;

pub(super) struct Access {
    gauge: Gauge,
    dataflash: DataFlash,
    debt: Debt,
    schedule: Schedule,
    control_status: u32,
    shared: Arc<Shared>,
}

impl Access {
    pub(super) fn new(gauge: Gauge, dataflash: DataFlash, schedule: Schedule, shared: Arc<Shared>) -> Self {
        Self { gauge, dataflash, debt: Debt::default(), schedule, control_status: 0, shared }
    }

    pub(super) fn chip(&self) -> &'static Chip {
        self.gauge.chip
    }

    pub(super) fn now(&self) -> Duration {
        self.gauge.clock.now()
    }

    pub(super) fn gauge(&mut self) -> &mut Gauge {
        &mut self.gauge
    }

    pub(super) fn schedule(&mut self) -> &mut Schedule {
        &mut self.schedule
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    pub(super) fn control_status(&self) -> u32 {
        self.control_status
    }

    /// Polls again soon: the registers may hold something else now.
    pub(super) fn hurry(&mut self) {
        self.schedule.hurry();
    }

    pub(super) fn next_poll(&self) -> Duration {
        self.schedule.due(self.shared.published().interval)
    }

    pub(super) fn key(&self, name: Name) -> Option<Secret> {
        self.gauge.key(name)
    }

    pub(super) fn default_key(&self, name: Name) -> Option<Secret> {
        self.gauge.default_key(name)
    }

    pub(super) fn wait_for_turn(&mut self) {
        self.gauge.wait(self.schedule.wait(self.now()));
    }

    /// The gauge does not answer, and is identified by the next poll.
    pub(super) fn set_gone(&mut self) {
        self.schedule.set_gone(self.gauge.clock.now());
    }

    /// Throws away what is known, after a panic. A write that it has interrupted is found in the journal.
    pub(super) fn start_over(&mut self) {
        self.gauge.start_over();
        self.dataflash.start_over();
        self.shared.forget_dataflash();
        self.debt = Debt::default();
        self.set_gone();
        self.shared.publish(|published| {
            published.snapshot = None;
            published.presence = now::presence();
            (published.owed, published.settling) = ("".into(), "".into());
        });
    }

    pub(super) fn meet(&mut self, answers: &Answers) {
        self.gauge.forget_refusal();
        self.dataflash.meet(self.gauge.chip, answers);
        self.shared.forget_dataflash();
        self.schedule.begin_anew();
    }

    /// Makes an access to data flash, and notes and publishes what it has left, which its error says as well.
    pub(super) fn run<T>(
        &mut self,
        access: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<T>,
    ) -> Result<T> {
        let outcome = access(&mut self.dataflash, &mut self.gauge);
        self.noted(outcome)
    }

    pub(super) fn owed(&self) -> Option<Owed<'_>> {
        self.dataflash.owed()
    }

    pub(super) fn doubts(&self) -> bool {
        self.dataflash.doubts()
    }

    pub(super) fn doubt_pack(&mut self) {
        self.dataflash.doubt_pack();
    }

    /// The pack may have been exchanged unnoticed: it is compared with the next access to data flash.
    pub(super) fn suspect(&mut self) {
        self.dataflash.suspect(self.gauge.chip);
    }

    pub(super) fn compare(&mut self) -> Result<()> {
        self.dataflash.compare(&mut self.gauge)
    }

    pub(super) fn forget_memory(&mut self) {
        self.dataflash.forget();
        self.shared.forget_scales();
    }

    pub(super) fn needs_second_poll(&mut self, registers: &Registers) -> Result<bool> {
        let chip = self.gauge.chip;
        let value = |source| word(chip, registers, source);
        Ok(self.dataflash.misreads_loss(&mut self.gauge, value)?
            || self.dataflash.needs_second_poll(chip, value))
    }

    /// Compares the registers of a poll with what is known of the pack. Another pack begins a presence.
    pub(super) fn note_poll(&mut self, registers: &Registers) {
        let chip = self.gauge.chip;
        let contradicted = self.dataflash.contradicted(chip, |source| word(chip, registers, source));
        if self.dataflash.polled(chip, |source| word(chip, registers, source)) {
            self.note_another(contradicted.unwrap_or("data flash"));
        }
    }

    /// Another pack answers, as that shows.
    fn note_another(&mut self, shown_by: &str) {
        log::warn!("{}: another pack answers, as {shown_by} shows; it is read anew", self.shared.name());
        self.shared.forget_dataflash();
        self.shared.begin_presence();
        self.hurry();
    }

    /// Reads the seal state and CONTROL_STATUS, and publishes the seal state.
    pub(super) fn read_status(&mut self) -> Result<()> {
        let (seal, status) = self.gauge.control_status()?;
        self.control_status = status;
        self.shared.publish(|published| published.seal = seal);
        Ok(())
    }

    /// Publishes seal state and CONTROL_STATUS. A failure is reported by the next poll, which cannot read registers either.
    pub(super) fn publish_seal(&mut self) {
        if let Ok((seal, status)) = self.gauge.control_status() {
            self.control_status = status;
            self.shared.publish(|published| {
                published.seal = seal;
                if let Some(snapshot) = &mut published.snapshot {
                    Arc::make_mut(snapshot).control_status = status;
                }
            });
        }
    }
}

pub(super) fn word(chip: &Chip, registers: &Registers, source: Source) -> Option<u32> {
    registers.value(chip.register_at(source)?).map(|value| value as u32)
}
