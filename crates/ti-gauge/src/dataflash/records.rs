// SPDX-License-Identifier: MIT

//! The record on disk of each access, and which accesses go on where it cannot be written.

use crate::error::{Cause, Error, Result};
use crate::gauge::Gauge;
use crate::journal::Journal;

#[derive(Debug, Default)]
pub(super) struct Records {
    /// Records each write before it starts.
    journal: Option<Journal>,
    /// The journal of an access that goes on without one could not be written, which has been reported.
    unrecorded: bool,
}

impl Records {
    pub(super) fn new(journal: Option<Journal>) -> Self {
        Self { journal, unrecorded: false }
    }

    pub(super) fn anew(self) -> Self {
        Self::new(self.journal)
    }

    pub(super) fn journal(&self) -> Option<&Journal> {
        self.journal.as_ref()
    }

    /// A read goes on without a journal: it changes nothing. Lost: a power cut of the host leaves the gauge unsealed.
    pub(super) fn read_without(&mut self, recorded: Result<()>) -> Result<()> {
        match recorded {
            Ok(()) => self.unrecorded = false,
            Err(error) if matches!(error.cause(), Cause::Io(_) | Cause::NotPermitted) => {
                if !std::mem::replace(&mut self.unrecorded, true) {
                    log::warn!("{error}");
                }
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Goes on with a restoration whose journal cannot be written, as on a full disk: the next one writes all of RAM again.
    /// Lost: a power cut of the host leaves the gauge unsealed, and in CONFIG UPDATE until that ends by itself.
    pub(super) fn go_on_without(&mut self, gauge: &Gauge, recorded: Result<()>) -> Result<()> {
        let Err(Cause::Io(kind)) = recorded.as_ref().map_err(Error::cause) else {
            self.unrecorded &= recorded.is_err();
            return recorded;
        };
        if !std::mem::replace(&mut self.unrecorded, true) {
            log::warn!(
                "{}: no journal can be written ({kind}); the profile is written without one",
                gauge.chip.name
            );
        }
        Ok(())
    }
}
