// SPDX-License-Identifier: MIT

//! The power supplies of a mount, Mains included, look by look.
//!
//! If a daemon hangs, a read blocks. So a separate thread reads, and [`Calling`] says that the daemon is silent.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::Duration;

use nix::sys::statvfs::statvfs;
use nix::time::{ClockId, clock_gettime};

use crate::condition::Texts;
use crate::error::Result;
use crate::hang::{Calling, look_again};
use crate::mounts;
use crate::sample::{attributes, if_readable};
use crate::watch::trouble;

/// Shortest time between two looks. Polls are at least as far apart.
const PAUSE: Duration = Duration::from_millis(500);
/// Looks take one part in so many of a processor's time, as of the daemon's: there may be a thousand gauges.
const SHARE: u32 = 20;

/// A report of a thread that follows a mount.
#[derive(Clone, Debug)]
pub struct Look {
    /// The `uevent` attributes of each supply by name; or why there are none.
    pub supplies: Result<BTreeMap<String, Texts>, String>,
}

/// Follows the supplies of a mount from a thread that reports to a channel and ends with its receiver.
pub fn to_channel<T: From<Look> + Send + 'static>(mountpoint: PathBuf, to: Sender<T>) -> Result<Calling> {
    let mount = mountpoint.clone();
    let look = move |calling: &Calling| {
        let before = processor_time();
        let supplies = supplies_at(&mountpoint, calling).map_err(|error| trouble(&mountpoint, &error));
        // Elapsed time would not show the cost: the daemon may have hung.
        let next = PAUSE.max(processor_time().saturating_sub(before) * (SHARE - 1));
        (Look { supplies }, next)
    };
    look_again(&mount, PAUSE, look, to)
}

fn processor_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map(Duration::from).unwrap_or_default()
}

/// The supplies of the mount. The kernel's own supplies show as symbolic links, and are left out.
fn supplies_at(mountpoint: &Path, calling: &Calling) -> io::Result<BTreeMap<String, Texts>> {
    if !mounts::is_gaugefs(mountpoint) {
        return Err(ErrorKind::NotFound.into());
    }
    // Only STATFS is never answered from the kernel's cache, which outlives a killed daemon.
    statvfs(mountpoint)?;
    let mut supplies = BTreeMap::new();
    for entry in fs::read_dir(mountpoint)? {
        let entry = entry?;
        calling.begin();
        let Ok(name) = entry.file_name().into_string() else { continue };
        if entry.file_type()?.is_dir()
            && let Some(texts) = if_readable(attributes(&entry.path()))?
            && texts.iter().any(|(attribute, _)| attribute == "type")
        {
            supplies.insert(name, texts.into_iter().collect());
        }
    }
    Ok(supplies)
}
