// SPDX-License-Identifier: MIT

//! Looks at the seal state, and when one counts.

use std::time::Duration;

use super::effects::Status;
use super::presence::Moment;
use super::state::{Look, Seal};
use super::{APART, Gauge, TRIES};
use crate::chip::{SealStatus, Source};
use crate::error::{Cause, Error, Result, Step};
use gauge_bus::BusError;

pub(super) const SEAL_POLL: Duration = Duration::from_millis(80);

pub(super) struct Looks {
    /// The last state shown, with which the next look has to agree; `None` once something was sent that may change it.
    seen: Option<Seal>,
    /// The seal state that a command of ours leads to, and until when CONTROL_STATUS may show the one before it.
    commanded: Option<(Seal, Duration)>,
    agreed: Option<Moment>,
    /// The last look, and which rows each look reads along with CONTROL_STATUS.
    look: Look,
    also: Vec<Source>,
}

impl Looks {
    pub(super) fn new() -> Self {
        Self { seen: None, commanded: None, agreed: None, look: Look::NONE, also: Vec::new() }
    }

    pub(super) fn start_over(&mut self) {
        (self.seen, self.commanded, self.also) = (None, None, Vec::new());
    }

    pub(super) fn agreed(&self) -> Option<Moment> {
        self.agreed
    }

    /// RESET is about to be sent, after which the gauge is sealed; one look that shows it counts.
    pub(super) fn resets(&mut self) {
        (self.seen, self.commanded) = (Some(Seal::Sealed), None);
    }

    /// The next look counts if it shows this state.
    pub(super) fn expect(&mut self, seal: Option<Seal>) {
        self.seen = seal;
    }
}

impl Gauge {
    /// Reads the seal state.
    pub fn seal(&mut self) -> Result<Seal> {
        self.control_status().map(|(seal, _)| seal)
    }

    /// Reads the seal state with two looks, whatever was seen before.
    pub fn seal_anew(&mut self) -> Result<Seal> {
        self.looks.seen = None;
        self.seal()
    }

    /// Reads the seal state and the CONTROL_STATUS word.
    ///
    /// I2C has no error detection, and a gauge whose state was misread would be left in it, or open. A state counts only if
    /// the look before has shown it too, and after a command that changes it two looks have to: while the gauge may still
    /// show the state from before the command, that one does not count.
    pub fn control_status(&mut self) -> Result<(Seal, u32)> {
        let look = self.look_at_status()?;
        Ok((look.seal, look.status))
    }

    pub(crate) fn look_at_status(&mut self) -> Result<Look> {
        let mut differ = 0;
        loop {
            let seal = self.control_status_once()?;
            match self.looks.seen.replace(seal) {
                Some(before) if before == seal => {}
                before => {
                    differ += 1;
                    if differ > TRIES {
                        let why = "the seal state reads differently each time: check the bus";
                        return Err(Error::new("CONTROL_STATUS", Cause::Protocol, why).at(Step::Control));
                    }
                    if before.is_none() {
                        self.wait(APART);
                    }
                    continue;
                }
            }
            match self.looks.commanded {
                Some((goal, until)) if seal != goal && self.clock.now() < until => self.wait(SEAL_POLL),
                _ => {
                    self.looks.agreed = Some(self.moment());
                    return Ok(self.looks.look);
                }
            }
        }
    }

    /// From now on each look at CONTROL_STATUS also reads these rows, in the same transfer if the bus can.
    pub(crate) fn also_read(&mut self, rows: Vec<Source>) {
        self.looks.also = rows;
    }

    pub(crate) fn last_look(&self) -> Look {
        self.looks.look
    }

    fn control_status_once(&mut self) -> Result<Seal> {
        let begun = self.clock.now();
        let also = std::mem::take(&mut self.looks.also);
        let looked = self.dialect.look(self, &also);
        self.looks.also = also;
        let (word, rows) = looked?;
        let status = u32::from(word);
        let seal = match self.chip.security.status {
            SealStatus::Bits { sealed, .. } if status & sealed != 0 => Seal::Sealed,
            SealStatus::Bits { not_full_access, .. } => {
                if not_full_access != 0 && status & not_full_access == 0 {
                    Seal::FullAccess
                } else {
                    Seal::Unsealed
                }
            }
            SealStatus::None => {
                return Err(Error::bus("CONTROL_STATUS", BusError::ReadOnly).of_register());
            }
            SealStatus::Field { word, shift } => {
                let word = match word {
                    Source::Status | Source::Answer(_) | Source::Within(..) => status,
                    Source::Command(code) => self.word(code)?.into(),
                };
                match word >> shift & 3 {
                    3 => Seal::Sealed,
                    2 => Seal::Unsealed,
                    1 => Seal::FullAccess,
                    _ => {
                        let why = format!("security bits of 0x{word:04x} are 00, which means no state");
                        return Err(Error::new("CONTROL_STATUS", Cause::Protocol, why));
                    }
                }
            }
        };
        self.looks.look = Look { seal, status, rows };
        let look = Status { begun, ended: self.clock.now(), status, seal };
        self.effects.look(&look, &self.statistics.reset_seals, &self.statistics.offsets);
        Ok(seal)
    }

    /// Something is sent that leads to a seal state, which CONTROL_STATUS may show late.
    pub(super) fn commands(&mut self, goal: Seal) {
        (self.looks.seen, self.looks.commanded) =
            (None, Some((goal, self.clock.now() + self.chip.security.shows)));
    }

    /// Whether an access is going on from now on, in which pauses between two transfers count.
    pub(crate) fn attend(&mut self, attended: bool) {
        if !attended && self.presence.is_marked() && self.looks.seen != Some(Seal::Sealed) {
            // A gauge that is left open is not to be taken for another one on which the same was done.
            let _ = self.dialect.deselect(self);
        }
        self.presence.attend(attended);
        self.forget_shown();
        self.rest();
    }
}
