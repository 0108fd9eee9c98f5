// SPDX-License-Identifier: MIT

//! A gauge that arrives, or comes back, and what is done before its values are shown.

use super::{Attempt, Owner, calibrate, now};
use crate::error::Result;

impl Owner {
    /// Identifies the gauge and polls it for the first time.
    pub(super) fn open(&mut self) -> Result<()> {
        self.identity.take_missing()?;
        self.arrive()?;
        self.poll()?;
        self.after_first_poll();
        Ok(())
    }

    /// The steps after the first poll of a gauge.
    pub(super) fn after_first_poll(&mut self) {
        self.access.hurry();
        calibrate::report_mode(&self.access);
        self.memory.keep_configured(&mut self.access);
        // Before the mount appears: some monitors read what does not change only once.
        self.read_if_open();
    }

    /// Reads what attributes and messages need of data flash, if the gauge is open: it is never unsealed for this.
    pub(super) fn read_if_open(&mut self) {
        // Values that are about to be undone or restored must not be shown.
        if self.access.owed().is_none() && !self.memory.is_waited_for() {
            self.readings.look_at_dataflash(&mut self.access);
        }
    }

    /// Asks a gauge that has been there all the time what it is, and compares its pack with the one that was there
    /// before, as far as that is possible without a key. Another one is in doubt then, and arrives with the next poll.
    pub(super) fn recognise(&mut self) -> Result<()> {
        if self.access.schedule().is_gone() || self.access.doubts() || !self.access.chip().has_table() {
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

    /// Identifies a gauge that has come, or come back, and forgets what was known of the one before it.
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
