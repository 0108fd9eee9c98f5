//! The one thread that owns a gauge.
//!
//! It reads what is due, publishes each poll as a whole new [`Snapshot`], and carries out the
//! requests of the file system one after the other. Nobody else touches the gauge's bus, so bus
//! traffic does not grow with the number of readers. It renders no text and knows no file names.

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use crate::chip::{Chip, Register};
use crate::error::Result;
pub use crate::gauge::{Answers, Seal};
use crate::value::Value;

/// All registers of one poll.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The clock when the poll's first transfer began.
    pub taken: Duration,
    /// Counts the polls; two snapshots of one number are the same snapshot.
    pub number: u64,
    bytes: [u8; 128],
    known: u128,
    /// CONTROL_STATUS, as of the last slow poll.
    pub control_status: u16,
}

impl Snapshot {
    /// The register's value, sign applied; `None` where it has not been read.
    pub fn value(&self, register: &Register) -> Option<i64> {
        let (start, size) = (usize::from(register.code), usize::from(register.size));
        let mask = ((1u128 << size) - 1) << start;
        if self.known & mask != mask {
            return None;
        }
        let raw =
            self.bytes[start..start + size].iter().rev().fold(0i64, |sum, &byte| sum << 8 | i64::from(byte));
        let span = 1i64 << (8 * size);
        Some(if register.signed && raw >= span / 2 { raw - span } else { raw })
    }
}

/// What is known of a gauge at one moment; replaced as a whole.
#[derive(Clone, Debug)]
pub struct Published {
    /// The last poll; `None` while the gauge is gone.
    pub snapshot: Option<Arc<Snapshot>>,
    /// Who it is.
    pub answers: Answers,
    /// Its seal state, as of the last time it was looked at.
    pub seal: Seal,
    /// Time between polls.
    pub interval: Duration,
    /// The last failure, one line; empty for none.
    pub last_error: Arc<str>,
}

/// Called from the owner's thread with the outcome of a request; must not block.
pub type Done<T> = Box<dyn FnOnce(Result<T>) + Send>;

/// What the file system may ask of a gauge's owner.
pub enum Request {
    /// Read a subclass (by its index in the table) unless it is kept and fresh.
    ReadSubclass(usize, Done<Arc<[u8]>>),
    /// Read every subclass but the security ones, unless kept and fresh.
    ReadAll(Done<()>),
    /// Write one parameter: index of the subclass, index of the parameter in it, and the value, whose
    /// range has been checked already.
    Write(usize, usize, Value, Done<()>),
    /// Go to a seal state.
    Seal(Seal, Done<()>),
    /// Send a subcommand that the table marks safe.
    Control(u16, Done<()>),
    /// Poll now and drop kept data flash.
    Refresh(Done<()>),
    /// Change the time between polls.
    Interval(Duration, Done<()>),
}

/// A gauge, as everything but its owner sees it. Cheap to clone; nothing here blocks or touches the
/// bus.
#[derive(Clone)]
pub struct Handle {
    shared: Arc<Shared>,
}

struct Shared {
    chip: &'static Chip,
    published: Mutex<Arc<Published>>,
}

impl Handle {
    /// The gauge's table.
    pub fn chip(&self) -> &'static Chip {
        self.shared.chip
    }

    /// What is known now.
    pub fn published(&self) -> Arc<Published> {
        self.shared.published.lock().expect("no thread panics while it holds the lock").clone()
    }

    /// The bytes of a subclass (by its index in the table), where they are kept and need not be read
    /// again first.
    pub fn kept(&self, _subclass: usize) -> Option<Arc<[u8]>> {
        None
    }

    /// Age of the published snapshot.
    pub fn age(&self) -> Option<Duration> {
        None
    }

    /// Name and value of each file of `gauge/statistics`.
    pub fn statistics(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// Queues a request; its outcome comes to its `Done`, within 30 s for a write.
    pub fn submit(&self, _request: Request) {}
}

/// Raised by owners whenever something published has changed; the FUSE side waits on it.
#[derive(Debug, Default)]
pub struct Signal {
    count: Mutex<u64>,
    raised: Condvar,
}

impl Signal {
    /// Something has changed.
    pub fn raise(&self) {
        *self.count.lock().expect("no thread panics while it holds the lock") += 1;
        self.raised.notify_all();
    }

    /// Waits until the count differs from `seen` or the time is over, and returns the count.
    pub fn wait(&self, seen: u64, limit: Option<Duration>) -> u64 {
        let count = self.count.lock().expect("no thread panics while it holds the lock");
        match limit {
            None => *self.raised.wait_while(count, |count| *count == seen).expect("as above"),
            Some(limit) => {
                *self.raised.wait_timeout_while(count, limit, |count| *count == seen).expect("as above").0
            }
        }
    }
}
