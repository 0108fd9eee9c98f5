// SPDX-License-Identifier: MIT

//! Paying what a failed access has left: a seal, or a write that is neither done nor undone.

use std::time::Duration;

use super::super::Attempt;
use super::super::operation::Asked;
use super::Access;
use crate::error::{Cause, Error, Reason, Result};
use ti_gauge::dataflash::Decision;

/// Tries when gaugefs ends, and the pause between them.
const LAST: u32 = 3;
const PAUSE: Duration = Duration::from_secs(1);

impl Access {
    /// Notes and publishes what is owed after an access, and says it in the access's error.
    pub(super) fn noted<T>(&mut self, outcome: Result<T>) -> Result<T> {
        let is_new = self.debt.note_owed(self.dataflash.owed(), &self.shared);
        outcome.map_err(|error| error.owing(is_new))
    }

    /// When what is owed is tried next; `None` while nothing is owed that a try could pay.
    pub(in super::super) fn next_payment(&self) -> Option<Duration> {
        self.debt.due()
    }

    fn is_payable(&self) -> bool {
        self.owed().is_some_and(|owed| !owed.needs_decision)
    }

    pub(in super::super) fn pay(&mut self) {
        let data = self.owed().is_some_and(|owed| owed.data);
        match self.dataflash.settle(&mut self.gauge, Duration::ZERO) {
            Ok(Some(message)) => {
                log::warn!("{}: {message}", self.shared.name());
                self.after_settling();
                if data {
                    let error = Error::new(self.gauge.chip.name, Cause::RolledBack, message);
                    self.shared.record(Attempt::SETTLE, &error);
                }
            }
            Ok(None) => {}
            // The first failure was reported; why it still fails is published as what is owed.
            Err(error) => log::debug!("{}: {error}", self.shared.name()),
        }
        self.debt.note_owed(self.dataflash.owed(), &self.shared);
    }

    /// Pays for the last time, because gaugefs ends. An error says what remains, which the next start finds in the journal.
    pub(in super::super) fn pay_for_the_last_time(&mut self) -> Result<()> {
        for attempt in 0..LAST {
            let is_payable = self.is_payable();
            if is_payable && attempt > 0 {
                self.gauge.wait(PAUSE);
            }
            if is_payable {
                self.pay();
            }
        }
        self.dataflash.tidy_up();
        let Some(owed) = self.owed() else { return Ok(()) };
        let what = format!("gaugefs ends, and this is still owed: {}", owed.why);
        Err(Error::of(self.shared.name(), Reason::Owed { decision: owed.needs_decision, what }))
    }

    /// A subcommand is not sent while something is owed: nobody knows what the gauge holds, or whether it is the same.
    pub(in super::super) fn pay_before_subcommand(&mut self) -> Result<()> {
        if self.is_payable() {
            self.pay();
        }
        match self.owed() {
            None => Ok(()),
            Some(owed) => {
                let what =
                    format!("no subcommand is sent while an interrupted access is not settled: {}", owed.why);
                let owed = Reason::Owed { decision: owed.needs_decision, what };
                Err(Error::of(self.gauge.chip.name, owed).owing(true))
            }
        }
    }

    /// Settles what an earlier process has left, before anybody sees what data flash holds.
    pub(in super::super) fn settle(&mut self) {
        match self.run(|dataflash, gauge| dataflash.settle(gauge, Duration::ZERO)) {
            Ok(Some(found)) => {
                self.shared.forget_dataflash();
                let error = Error::new(self.gauge.chip.name, Cause::RolledBack, found);
                self.shared.report(Attempt::SETTLE, &error);
            }
            Ok(None) => {}
            Err(error) => self.shared.report(Attempt::SETTLE, &error),
        }
    }

    pub(in super::super) fn settle_as_decided(
        &mut self,
        decision: Option<Decision>,
        asked: Asked,
    ) -> Result<()> {
        if decision.is_none() && self.is_payable() {
            self.pay();
        }
        let outcome = match decision {
            None => self.dataflash.examine(&mut self.gauge, asked.waited),
            Some(decision) => self.dataflash.decide(&mut self.gauge, decision, asked.waited),
        };
        if decision.is_some() {
            self.after_settling();
        }
        let told = self.noted(outcome)?;
        if decision.is_some() {
            log::warn!("{}: {told}", self.shared.name());
        }
        self.shared.publish(|published| published.settling = (asked.title() + &told).into());
        Ok(())
    }

    /// Data flash may hold something else, and the seal may be another one.
    pub(in super::super) fn after_settling(&mut self) {
        self.shared.forget_dataflash();
        self.hurry();
        self.publish_seal();
    }
}
