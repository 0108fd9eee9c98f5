// SPDX-License-Identifier: MIT

//! Whether somebody could have put another pack in place of the one that is there: nothing has answered for a while.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};

/// Nobody exchanges a pack in less time; a gauge that is busy may be silent for as long.
const QUICK: Duration = Duration::from_millis(250);

/// What is known of the contact to a pack.
#[derive(Debug, Default)]
struct Contact {
    /// How often it was broken.
    breaks: u64,
    /// When something has answered last.
    answered: Duration,
    /// The last transfer has failed.
    has_failed: bool,
}

/// A bus that is watched. Clones watch the same contact.
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

    /// How often the contact was broken so far, the present moment included.
    pub(super) fn breaks(&self) -> u64 {
        let contact = self.contact();
        contact.breaks + u64::from(contact.has_failed)
    }

    /// Whether nothing was sent, or has answered, for so long that somebody could have exchanged the pack.
    pub(super) fn may_be_exchanged(&self) -> bool {
        self.clock.now() >= self.contact().answered + QUICK
    }

    /// A bus to the pack.
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

/// A bus whose answers are seen.
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
