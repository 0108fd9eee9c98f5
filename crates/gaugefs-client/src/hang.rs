// SPDX-License-Identifier: MIT

//! Hanging daemons: a call into a mount may never return, so a separate thread makes it.

use std::path::Path;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use gauge_bus::clock::{Clock, RealClock};
use nix::errno::Errno;
use nix::sys::statvfs::statvfs;

use crate::error::{Error, Result};

/// A daemon hangs if it does not answer for this long.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// [`PATIENCE`], or in a build for tests the seconds of `GAUGEFS_PATIENCE`: on a machine that is too busy a daemon may just be slow.
fn patience() -> Duration {
    static SET: OnceLock<Duration> = OnceLock::new();
    if !cfg!(debug_assertions) {
        return PATIENCE;
    }
    *SET.get_or_init(|| {
        let seconds = std::env::var("GAUGEFS_PATIENCE").ok().and_then(|text| text.parse().ok());
        seconds.map_or(PATIENCE, Duration::from_secs)
    })
}

/// The error for a daemon that hangs.
pub const SILENT: &str = "its daemon does not answer";

pub(crate) fn thread(work: impl FnOnce() + Send + 'static) -> Result<()> {
    let thread = std::thread::Builder::new().stack_size(256 * 1024).spawn(work);
    thread.map(drop).map_err(|error| Error::io("", "cannot start a thread", error))
}

/// Start of a thread's call into a mount; `None` outside a call.
#[derive(Clone, Debug, Default)]
pub struct Calling(Arc<Mutex<Option<Instant>>>);

impl Calling {
    /// A call begins, or the next one in a series.
    pub(crate) fn begin(&self) {
        self.set(Some(Instant::now()));
    }

    pub(crate) fn end(&self) {
        self.set(None);
    }

    fn set(&self, since: Option<Instant>) {
        // A panic cannot leave it half changed.
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = since;
    }

    /// Whether the daemon has been silent for [`PATIENCE`]: true once per such time.
    pub fn is_silent(&self) -> bool {
        let mut since = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_silent = since.is_some_and(|since| since.elapsed() >= patience());
        if is_silent {
            *since = Some(Instant::now());
        }
        is_silent
    }
}

/// Looks repeatedly from a thread. `look` returns what it sees, and the time until the next look.
pub(crate) fn look_again<R, T: From<R> + Send + 'static>(
    mount: &Path,
    every: Duration,
    mut look: impl FnMut(&Calling) -> (R, Duration) + Send + 'static,
    to: Sender<T>,
) -> Result<Calling> {
    let (mount, calling) = (mount.to_path_buf(), Calling::default());
    let within = calling.clone();
    thread(move || {
        loop {
            within.begin();
            let (seen, next) = look(&within);
            within.end();
            if to.send(seen.into()).is_err() {
                return;
            }
            rest(&mount, every, next, &within);
        }
    })?;
    Ok(calling)
}

fn rest(mount: &Path, every: Duration, next: Duration, calling: &Calling) {
    let until = Instant::now() + next;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        RealClock::new().sleep(left.min(every));
        if left <= every || !is_served(mount, calling) {
            return;
        }
    }
}

/// Whether a daemon answers. Only STATFS is never answered from the kernel's cache, which outlives a daemon.
pub(crate) fn is_served(mount: &Path, calling: &Calling) -> bool {
    calling.begin();
    let answer = statvfs(mount);
    calling.end();
    answer.is_ok()
}

/// Calls a function from a separate thread, with a time limit. If a daemon hangs, only that thread stays behind.
pub fn within<T: Send + 'static>(limit: Duration, call: impl FnOnce() -> T + Send + 'static) -> Result<T> {
    let (sender, answer) = mpsc::channel();
    thread(move || {
        // Nobody receives it after the limit.
        let _ = sender.send(call());
    })?;
    answer.recv_timeout(limit).map_err(|_| Error::host("", Errno::ETIMEDOUT, SILENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_gone_is_looked_at_long_before_the_next_look_is_due() {
        // More than a test may take, and a folder that is gone after the first look, as a mount whose daemon was killed.
        let hour = Duration::from_secs(3600);
        let folder = std::env::temp_dir().join(format!("gaugefs-hang-{}", std::process::id()));
        std::fs::create_dir(&folder).expect("a folder");
        let (sender, looks) = mpsc::channel::<usize>();
        let mut count = 0_usize;
        let gone = folder.clone();
        let look = move |_: &Calling| {
            count += 1;
            let _ = std::fs::remove_dir(&gone);
            (count, if count == 1 { hour } else { Duration::ZERO })
        };
        look_again(&folder, Duration::from_millis(1), look, sender).expect("a thread");
        assert_eq!(looks.iter().take(2).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn a_call_that_takes_too_long_is_reported_once_in_that_time() {
        let calling = Calling::default();
        assert!(!calling.is_silent());
        calling.begin();
        assert!(!calling.is_silent());
        calling.set(Instant::now().checked_sub(PATIENCE));
        assert!(calling.is_silent() && !calling.is_silent());
        calling.end();
        assert!(!calling.is_silent());
    }
}
