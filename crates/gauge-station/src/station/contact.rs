// SPDX-License-Identifier: MIT

//! Watches the contact to a pack: a long silence means that somebody could have exchanged it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};

/// No exchange is quicker; a busy gauge may be silent for as long.
const QUICK: Duration = Duration::from_millis(250);

#[derive(Debug, Default)]
struct Contact {
    breaks: u64,
    /// Time of the last answer.
    answered: Duration,
    has_failed: bool,
}

/// A watched bus. Clones watch the same contact.
#[derive(Clone)]
pub(super) struct Watch {
    clock: Arc<dyn Clock>,
    contact: Arc<Mutex<Contact>>,
}

impl Watch {
    pub(super) fn new(clock: Arc<dyn Clock>) -> Self {
        Self { clock, contact: Arc::default() }
    }

    fn contact(&self) -> MutexGuard<'_, Contact> {
        self.contact.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Breaks of the contact so far, including a present one.
    pub(super) fn breaks(&self) -> u64 {
        let contact = self.contact();
        contact.breaks + u64::from(contact.has_failed)
    }

    /// Whether the silence, or the lack of transfers, was long enough for an exchange of the pack.
    pub(super) fn may_be_exchanged(&self) -> bool {
        self.clock.now() >= self.contact().answered + QUICK
    }

    pub(super) fn over(&self, bus: Box<dyn Bus>) -> Watched {
        Watched { bus, watch: self.clone() }
    }

    fn see(&self, has_answered: bool) {
        let now = self.clock.now();
        let mut contact = self.contact();
        if has_answered {
            let is_break = contact.has_failed && now >= contact.answered + QUICK;
            contact.breaks += u64::from(is_break);
            contact.answered = now;
        }
        contact.has_failed = !has_answered;
    }
}

pub(super) struct Watched {
    bus: Box<dyn Bus>,
    watch: Watch,
}

impl Bus for Watched {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let outcome = self.bus.transfer(write, read);
        self.watch.see(outcome.is_ok());
        outcome
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}
