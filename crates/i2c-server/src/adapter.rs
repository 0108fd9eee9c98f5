// SPDX-License-Identifier: MIT

//! The bus: its targets, one transfer at a time, and the time that a transfer takes.

use std::collections::BTreeMap;
use std::fmt;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::io::Errno;

use crate::message::{M_RD, Message};

/// A device at an address.
pub trait Target: Send {
    /// One transfer: START, `write`, then, if `read` is not empty, a repeated START and as many bytes from the target, STOP.
    /// If `write` is empty, only the read; if both are, the address alone is sent.
    ///
    /// The error is what an adapter of the kernel reports: ENXIO if the target does not acknowledge, EAGAIN if another
    /// controller wins the bus, ETIMEDOUT if a line is held for too long.
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno>;
}

/// A bus with its targets, shared by all clients.
#[derive(Default)]
pub struct Adapter {
    targets: Mutex<BTreeMap<u16, Box<dyn Target>>>,
    pace: Option<Pace>,
}

/// The duration of a bit, and a way to wait.
struct Pace {
    hertz: u32,
    sleep: Box<dyn Fn(Duration) + Send + Sync>,
}

impl fmt::Debug for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Adapter").field("targets", &self.lock().keys()).finish()
    }
}

impl Adapter {
    /// A bus without targets, where transfers take no time.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a target at a 7-bit address, or replaces the one there.
    #[must_use]
    pub fn with(self, address: u8, target: impl Target + 'static) -> Self {
        self.lock().insert(address.into(), Box::new(target));
        self
    }

    /// Gives transfers the time of their bits at this clock.
    #[must_use]
    pub fn paced(self, hertz: u32, sleep: impl Fn(Duration) + Send + Sync + 'static) -> Self {
        Self { pace: Some(Pace { hertz, sleep: Box::new(sleep) }), ..self }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u16, Box<dyn Target>>> {
        // A panic of a target is caught while this is held.
        self.targets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn transfer(&self, messages: &mut [Message]) -> Result<(), Errno> {
        if messages.iter().any(|message| message.flags & !M_RD != 0) {
            return Err(Errno::OPNOTSUPP);
        }
        let mut targets = self.lock();
        let mut left = messages;
        while let Some(first) = left.first() {
            let is_pair = |second: &Message| {
                second.is_read() && second.address == first.address && !second.data.is_empty()
            };
            let pair = !first.is_read() && !first.data.is_empty() && left.get(1).is_some_and(is_pair);
            let (sent, rest) = left.split_at_mut(if pair { 2 } else { 1 });
            let target = targets.get_mut(&sent[0].address).ok_or(Errno::NXIO);
            let outcome = target.and_then(|target| {
                // A defect of one target ends neither the server nor the other targets.
                panic::catch_unwind(AssertUnwindSafe(|| match sent {
                    [message] if message.is_read() => target.transfer(&[], &mut message.data),
                    [message] => target.transfer(&message.data, &mut []),
                    [write, read] => target.transfer(&write.data, &mut read.data),
                    _ => Ok(()),
                }))
                .unwrap_or(Err(Errno::IO))
            });
            self.spend(sent, outcome);
            outcome?;
            left = rest;
        }
        Ok(())
    }

    /// Waits while the messages are on the wire. Nothing follows an address that is not acknowledged.
    fn spend(&self, sent: &[Message], outcome: Result<(), Errno>) {
        let Some(pace) = &self.pace else { return };
        let bytes = match outcome {
            Err(Errno::NXIO) => 1,
            _ => sent.iter().map(|message| 1 + message.data.len()).sum(),
        };
        // Nine bits per byte, and one for each START and for STOP.
        let bits = bytes * 9 + sent.len() + 1;
        (pace.sleep)(Duration::from_secs(bits as u64) / pace.hertz.max(1));
    }
}
