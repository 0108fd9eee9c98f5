// SPDX-License-Identifier: MIT

//! Signals that a thread waits for.

use nix::sys::signal::{SigSet, Signal};

use crate::error::{Error, Result};

/// Blocks signals, for a thread that waits for them. To be called before any other thread is started: the others inherit
/// them as blocked, so that only that one receives them.
pub fn block(signals: &[Signal]) -> Result<SigSet> {
    let signals = signals.iter().copied().collect::<SigSet>();
    signals.thread_block().map_err(|errno| Error::io("signals", "cannot block them", &errno.into()))?;
    Ok(signals)
}
