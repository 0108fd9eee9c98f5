// SPDX-License-Identifier: MIT

//! The bus: its targets, one transfer at a time, and the time that a transfer takes.

use std::collections::BTreeMap;
use std::fmt;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::io::Errno;

use crate::functions::{FUNCTIONS, I2C, READ_BLOCK};
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

/// How an adapter treats its callers, whatever its targets do.
#[derive(Clone, Copy, Debug)]
pub struct Manner {
    /// The answer to I2C_FUNCS, without what is not in [`FUNCTIONS`]. Without `I2C_FUNC_I2C`, I2C_RDWR, read(2) and write(2) are
    /// EOPNOTSUPP, as are the SMBus transactions whose bit is not set.
    pub functions: u64,
    /// The error where no target is.
    pub nobody: Errno,
    /// A call is one message, or a write and the read after it; others are EOPNOTSUPP.
    pub is_pair: bool,
}

impl Default for Manner {
    fn default() -> Self {
        Self { functions: FUNCTIONS, nobody: Errno::NXIO, is_pair: false }
    }
}

/// A bus with its targets, shared by all clients.
#[derive(Default)]
pub struct Adapter {
    manner: Manner,
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

    /// Treats callers in that manner.
    #[must_use]
    pub fn in_manner(self, manner: Manner) -> Self {
        Self { manner, ..self }
    }

    /// What it is able to do, as the bits of I2C_FUNCS.
    pub(crate) fn functions(&self) -> u64 {
        // Where the kernel emulates SMBus with messages, it reads no blocks whose length the target says.
        let blocks = if self.manner.functions & I2C == 0 { READ_BLOCK } else { 0 };
        self.manner.functions & (FUNCTIONS | blocks)
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
        if self.manner.is_pair && !messages.is_empty() && operation(messages) < messages.len() {
            return Err(Errno::OPNOTSUPP);
        }
        let mut targets = self.lock();
        let mut left = messages;
        while !left.is_empty() {
            let count = operation(left);
            let (sent, rest) = left.split_at_mut(count);
            let target = targets.get_mut(&sent[0].address).ok_or(self.manner.nobody);
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
            Err(error) if error == self.manner.nobody => 1,
            _ => sent.iter().map(|message| 1 + message.data.len()).sum(),
        };
        // Nine bits per byte, and one for each START and for STOP.
        let bits = bytes * 9 + sent.len() + 1;
        (pace.sleep)(Duration::from_secs(bits as u64) / pace.hertz.max(1));
    }
}

/// How many of the messages are one operation of a target: a read goes with the write before it.
fn operation(messages: &[Message]) -> usize {
    match messages {
        [first, second, ..] if !first.is_read() && !first.data.is_empty() => {
            let is_pair = second.is_read() && second.address == first.address && !second.data.is_empty();
            1 + usize::from(is_pair)
        }
        _ => 1,
    }
}
