// SPDX-License-Identifier: MIT

//! Whether it is still the same gauge that answers.
//!
//! A pack can be exchanged while it does not answer: within one transfer that fails, in a pause, or while the host is
//! asleep. After each of these the gauge is asked which block is selected, before anything else is sent. It forgets
//! that with its power, and another one has not been told it. Where that shows nothing, the presence is broken, and
//! what was certain of the gauge before is certain no longer.

use std::time::Duration;

use super::{CONTROL, Gauge, Seal};
use gauge_bus::BusError;

/// DataFlashClass() and DataFlashBlock(), or ManufacturerAccessControl(), which show what was selected last.
const SELECTION: u8 = 0x3e;
/// The selection that an access leaves behind.
const NOTHING: [u8; 2] = [0, 0];
/// A pause without a transfer in which a pack can be exchanged without a trace.
const PAUSE: Duration = Duration::from_secs(1);
/// Looks at the selection before another one counts, and failed ones in a row before it cannot be known.
const LOOKS: u32 = 2;
const FAILED_LOOKS: u32 = 6;

/// A moment in the presence of a gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Moment(u64);

/// What is known of the gauge's presence.
#[derive(Debug, Default)]
pub(super) struct Presence {
    /// How often it was broken.
    breaks: u64,
    /// Something has happened behind which the gauge could have been exchanged.
    in_doubt: bool,
    /// Looks at the selection that have failed in a row.
    failed: u32,
    /// An access is going on, in which pauses count.
    attended: bool,
    /// What the gauge may show as its selection. Several, if it is not certain which was taken.
    selected: Vec<[u8; 2]>,
}

impl Presence {
    /// Something has happened behind which the gauge could have been exchanged.
    pub(super) fn doubt(&mut self) {
        self.in_doubt = true;
    }

    /// A transfer has taken that long.
    pub(super) fn note_duration(&mut self, time: Duration) {
        self.in_doubt |= self.attended && time >= PAUSE;
    }

    /// Bytes are about to be sent.
    pub(super) fn sends(&mut self, code: u8, data: &[u8]) {
        if let (SELECTION, &[first, second], true) = (code, data, self.attended) {
            let half: Vec<_> = self.selected.iter().map(|&[_, other]| [first, other]).collect();
            self.selected.extend(half);
            self.selected.push([first, second]);
        }
    }

    /// Bytes were acknowledged. A gauge with a flat address space shows a subcommand in place of its selection.
    pub(super) fn sent(&mut self, code: u8, data: &[u8], is_flat: bool) {
        match (code, data) {
            (SELECTION, &[first, second]) if self.attended => self.selected = vec![[first, second]],
            (SELECTION, _) => self.selected.clear(),
            (CONTROL, _) if is_flat => self.selected.clear(),
            _ => {}
        }
    }

    fn end(&mut self) {
        self.breaks += 1;
        (self.in_doubt, self.failed) = (false, 0);
        self.selected.clear();
    }
}

impl Gauge {
    /// The present moment, for [`Self::is_unbroken_since`]. What is in doubt now counts as happening later.
    pub(crate) fn moment(&self) -> Moment {
        Moment(self.presence.breaks)
    }

    /// Whether nothing has happened since then behind which the gauge could have been exchanged for another one.
    pub(crate) fn is_unbroken_since(&self, moment: Moment) -> bool {
        !self.presence.in_doubt && self.presence.breaks == moment.0
    }

    /// Whether an access is going on from now on, in which pauses between two transfers count.
    pub(crate) fn attend(&mut self, attended: bool) {
        if !attended && !self.presence.selected.is_empty() && self.seen != Some(Seal::Sealed) {
            // A gauge that is left open is not to be taken for another one on which the same was done.
            let _ = match self.chip.access.scheme.is_flat() {
                true => self.write_once(CONTROL, &[0, 0]),
                false => self.write_once(SELECTION, &NOTHING),
            };
        }
        self.presence.attended = attended;
        self.presence.selected.clear();
        self.rested.set(self.clock.now());
    }

    /// Whether a gauge that was sent RESET, and has not been away, no longer shows the block that was selected.
    pub(crate) fn has_forgotten_selection(&mut self) -> bool {
        let [selected] = self.presence.selected[..] else { return false };
        let mut seen = [[0; 2]; 2];
        for seen in &mut seen {
            if self.again(|gauge| gauge.transfer(&[SELECTION], seen)).is_err() {
                return false;
            }
        }
        seen[0] == seen[1] && seen[0] != selected
    }

    /// Learns what the gauge shows as its selection, so that it is known again from now on.
    pub(crate) fn learn_selection(&mut self) {
        let mut seen = [0; 2];
        if self.again(|gauge| gauge.transfer(&[SELECTION], &mut seen)).is_ok() && !self.presence.in_doubt {
            self.presence.selected = vec![seen];
        }
    }

    /// Makes sure, before the next transfer, that it is still the same gauge.
    pub(crate) fn doubt(&mut self) {
        if !self.presence.selected.is_empty() {
            self.presence.doubt();
        }
    }

    /// It is in a state in which nobody has put it: it may be another gauge.
    pub(crate) fn lose_sight(&mut self) {
        self.presence.end();
    }

    /// Finds out, before something is sent, whether a gauge that may have been exchanged is the same one.
    pub(super) fn recognise(&mut self) -> Result<(), BusError> {
        let paused = self.stopped.is_some_and(|stopped| {
            // A wait of our own is as long as it has to be.
            self.clock.now() >= stopped.max(self.rested.get()) + PAUSE
        });
        if !(self.presence.in_doubt || paused && self.presence.attended) {
            return Ok(());
        }
        self.presence.doubt();
        // Nothing may come between the words of a key.
        if self.presence.selected.is_empty() || self.secrets > 0 {
            self.presence.end();
            return Ok(());
        }
        for _ in 0..LOOKS {
            let mut seen = [0; 2];
            self.presence.in_doubt = false;
            match self.pass(&[SELECTION], &mut seen) {
                // The host was asleep in this very transfer.
                Ok(()) if self.presence.in_doubt => {}
                Ok(()) if seen != NOTHING && self.presence.selected.contains(&seen) => {
                    self.presence.failed = 0;
                    self.presence.selected = vec![seen];
                    return Ok(());
                }
                Ok(()) => {}
                Err(error) if error.is_transient() && self.presence.failed < FAILED_LOOKS => {
                    self.presence.failed += 1;
                    return Err(error);
                }
                // The transfer itself says what is wrong.
                Err(_) => break,
            }
        }
        self.presence.end();
        Ok(())
    }
}
