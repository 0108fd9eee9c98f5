// SPDX-License-Identifier: MIT

//! A gauge that arrives, or comes back, and what is done before its values are shown.

use super::{Attempt, Owner, calibrate, now};
use crate::error::Result;

impl Owner {
    pub(super) fn open(&mut self) -> Result<()> {
        self.identity.take_missing()?;
        self.arrive()?;
        self.poll()?;
        self.after_first_poll();
        Ok(())
    }

    pub(super) fn after_first_poll(&mut self) {
        self.access.hurry();
        calibrate::report_mode(&self.access);
        self.memory.keep_configured(&mut self.access);
        // Before the mount appears: some monitors read what does not change only once.
        self.read_if_open();
    }

    pub(super) fn read_if_open(&mut self) {
        // Values that are about to be undone or restored must not be shown.
        if self.access.owed().is_none() && !self.memory.is_waited_for() {
            self.readings.look_at_dataflash(&mut self.access);
        }
    }

    /// Compares a gauge, and its pack without a key, with the one before. Another one arrives with the next poll.
    pub(super) fn recognise(&mut self) -> Result<()> {
        if self.access.schedule().is_gone() || self.access.doubts() || !self.shared().is_asked() {
            return Ok(());
        }
        let (answers, limited) = self.identity.ask(self.access.gauge())?;
        if answers != self.shared().published().answers {
            self.access.doubt_pack();
        } else if limited.is_none() {
            self.access.compare()?;
        }
        Ok(())
    }

    pub(super) fn arrive(&mut self) -> Result<()> {
        let (answers, limited) = self.identity.meet(&mut self.access)?;
        let chip = self.access.chip();
        self.access.meet(&answers);
        self.readings.forget(chip);
        self.memory.arrives();
        self.shared().publish(|published| {
            published.presence = now::presence();
            (published.answers, published.limited) = (answers, limited);
        });
        match self.shared().limitation() {
            None => self.access.settle(),
            Some(_) if !chip.has_table() => {}
            Some(why) => self.shared().report(Attempt::Other, &why),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
