// SPDX-License-Identifier: MIT

//! Looks at the selection, which show whether it is still the same gauge that answers.

use std::time::Duration;

use crate::gauge::Gauge;
use crate::gauge::presence::{Moment, PAUSE};
use gauge_bus::BusError;

const LOOKS: u32 = 2;
/// When a look at a gauge that was sent RESET is worth its transfer, in tenths of the usual time.
const RESET_LOOK: u32 = 9;
/// A gauge that did not show it so much earlier may show it by then.
const EARLIER_MS: u64 = 10;

impl Gauge {
    /// The present moment, for [`Self::is_unbroken_since`]. What is in doubt now counts as happening later.
    pub(crate) fn moment(&self) -> Moment {
        self.presence.moment()
    }

    /// Whether nothing has happened since then behind which the gauge could have been exchanged for another one.
    pub(crate) fn is_unbroken_since(&self, moment: Moment) -> bool {
        self.presence.is_unbroken_since(moment)
    }

    /// Whether a gauge that was sent RESET, and has not been away, no longer shows the block that was selected.
    pub(crate) fn has_forgotten_selection(&mut self) -> bool {
        let Some(selected) = self.presence.mark() else { return false };
        let mut seen = [[0; 2]; 2];
        for seen in &mut seen {
            if self.again(|gauge| gauge.transfer(gauge.dialect.selection(), seen)).is_err() {
                return false;
            }
        }
        seen[0] == seen[1] && seen[0] != selected
    }

    /// Learns what the gauge shows as its selection, so that it is known again from now on. A subcommand, which a gauge with a
    /// flat address space shows there, is no mark: another gauge that was asked for its seal state shows it, too.
    pub(crate) fn learn_selection(&mut self) {
        let mut seen = [0; 2];
        let is_subcommand = |gauge: &Self, seen| {
            let code = u16::from_le_bytes(seen);
            gauge.chip.access.scheme.is_flat() && gauge.chip.subcommand(code).is_some()
        };
        if self.again(|gauge| gauge.transfer(gauge.dialect.selection(), &mut seen)).is_ok()
            && !self.presence.is_doubted()
            && !is_subcommand(self, seen)
        {
            self.presence.learn(seen);
        }
    }

    /// Waits until a gauge that was sent RESET may show it, some time before the usual one unless this gauge was later. That it
    /// is silent until the usual time says no less than not to look would, so that is no failure.
    pub(crate) fn await_reset(&mut self, sent: Duration) {
        let (usual, seen) = (self.chip.access.reset, &self.statistics.reset_seals);
        let (is_known, unseen) = (seen.count() > 0, Duration::from_millis(seen.unseen_ms() + EARLIER_MS));
        let look = usual * RESET_LOOK / 10;
        if unseen < look {
            self.wait_until(sent + look);
            if is_known || !self.may_try_until(sent + usual) {
                return;
            }
            let was_doubted = self.presence.is_doubted();
            if self.pass(self.dialect.selection(), &mut [0; 2]).is_ok() {
                return;
            }
            // An adapter may have waited so long that a pack was exchanged meanwhile.
            if !was_doubted && self.clock.now() < sent + PAUSE {
                self.presence.look();
            }
        }
        self.wait_until(sent + usual);
    }

    pub(crate) fn doubt(&mut self) {
        if self.presence.is_marked() {
            self.presence.doubt();
        }
    }

    /// It is in a state in which nobody has put it: it may be another gauge.
    pub(crate) fn lose_sight(&mut self) {
        self.presence.end();
    }

    pub(in crate::gauge) fn rest(&self) {
        self.wire.rested.set(self.clock.now());
    }

    /// Finds out, before something is sent, whether a gauge that may have been exchanged is the same one.
    pub(super) fn recognise(&mut self) -> Result<(), BusError> {
        let paused = self.wire.stopped.is_some_and(|stopped| {
            // A wait of our own is as long as it has to be.
            self.clock.now() >= stopped.max(self.wire.rested.get()) + PAUSE
        });
        if !self.presence.is_doubted_after(paused) {
            return Ok(());
        }
        self.presence.doubt();
        // Nothing may come between the words of a key.
        if !self.presence.is_marked() || self.wire.secrets > 0 {
            self.presence.end();
            return Ok(());
        }
        for _ in 0..LOOKS {
            let mut seen = [0; 2];
            self.presence.look();
            match self.pass(self.dialect.selection(), &mut seen) {
                // The host was asleep in this very transfer.
                Ok(()) if self.presence.is_doubted() => {}
                Ok(()) if self.presence.knows_again(seen) => return Ok(()),
                Ok(()) => {}
                Err(error) if error.is_transient() && self.presence.may_look_again() => return Err(error),
                // The transfer itself says what is wrong.
                Err(_) => break,
            }
        }
        self.presence.end();
        Ok(())
    }
}
