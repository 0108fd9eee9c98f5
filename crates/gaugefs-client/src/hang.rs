// SPDX-License-Identifier: MIT

//! Daemons that hang: a call into their mount may never return, so it is made by a thread of its own.

use std::sync::mpsc;
use std::time::Duration;

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
