// SPDX-License-Identifier: MIT

//! Daemons that hang: a call into their mount may never return, so it is made by a thread of its own.

use std::sync::mpsc::{self, Sender};
use std::time::Duration;

use gauge_bus::clock::{Clock, RealClock};
use nix::errno::Errno;

use crate::error::{Error, Result};

/// A daemon that has not answered for this long hangs.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// Why there is nothing of a daemon that hangs.
pub const SILENT: &str = "its daemon does not answer";

/// Starts a thread that calls into mounts.
pub(crate) fn thread(work: impl FnOnce() + Send + 'static) -> Result<()> {
    let thread = std::thread::Builder::new().stack_size(256 * 1024).spawn(work);
    thread.map(drop).map_err(|error| Error::io("", "cannot start a thread", error))
}

/// Looks at a mount again and again from a thread of its own, which reports to a channel: what it sees, and how long it is
/// until the next look. It ends with its receiver.
pub(crate) fn look_again<R, T: From<R> + Send + 'static>(
    mut look: impl FnMut() -> (R, Duration) + Send + 'static,
    to: Sender<T>,
) -> Result<()> {
    thread(move || {
        loop {
            let (seen, next) = look();
            if to.send(seen.into()).is_err() {
                return;
            }
            RealClock::new().sleep(next);
        }
    })
}

/// Calls a function from a thread of its own, and waits at most so long for it. A daemon that hangs keeps that thread, and
/// not the caller.
pub fn within<T: Send + 'static>(limit: Duration, call: impl FnOnce() -> T + Send + 'static) -> Result<T> {
    let (sender, answer) = mpsc::channel();
    thread(move || {
        // It cannot be heard any more after the limit.
        let _ = sender.send(call());
    })?;
    answer.recv_timeout(limit).map_err(|_| Error::host("", Errno::ETIMEDOUT, SILENT))
}
