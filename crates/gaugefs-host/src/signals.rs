// SPDX-License-Identifier: MIT

//! Signals that end a program.

use std::path::Path;

use gauge_bus::regular;
use nix::sys::signal::{SigSet, Signal};

use crate::error::{Error, Result};

/// The signals that end a program, without a hangup that it was started to ignore, as by nohup.
pub fn ends() -> Vec<Signal> {
    let status = regular::read_text(Path::new("/proc/self/status"), regular::SYSTEM).unwrap_or_default();
    let mut ends = vec![Signal::SIGTERM, Signal::SIGINT];
    ends.extend((!ignores(&status, Signal::SIGHUP)).then_some(Signal::SIGHUP));
    ends
}

/// Blocks these signals for a thread that waits for them. Call it first: other threads inherit the block.
pub fn block() -> Result<SigSet> {
    // A blocked signal is delivered to a waiting thread even if it is ignored.
    let signals = ends().into_iter().collect::<SigSet>();
    signals.thread_block().map_err(|errno| Error::io("signals", "cannot block them", &errno.into()))?;
    Ok(signals)
}

fn ignores(status: &str, signal: Signal) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal as u32 - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_says_which_signals_are_ignored() {
        let status = "SigBlk:\tffffffffffffffff\nSigIgn:\t0000000000001001\nSigCgt:\t0000000000000000\n";
        assert!(ignores(status, Signal::SIGHUP) && ignores(status, Signal::SIGPIPE));
        assert!(!ignores(status, Signal::SIGTERM) && !ignores("", Signal::SIGHUP));
    }
}
