// SPDX-License-Identifier: MIT

//! The power supplies of a mount, the Mains supply included, look by look.
//!
//! If a daemon hangs, a read of its files blocks, perhaps for ever. So a thread of its own reads them, and whoever waits
//! for it counts a daemon as silent that is not heard of for [`PATIENCE`](crate::hang::PATIENCE) after its next look is due.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use nix::sys::statvfs::statvfs;

use crate::condition::Texts;
use crate::error::Result;
use crate::hang::look_again;
use crate::mounts;
use crate::sample::{attributes, if_readable};
use crate::watch::trouble;

/// The least time between two looks. Polls are at least as far apart.
const PAUSE: Duration = Duration::from_millis(500);
/// A look takes at most this part of the time: there may be a thousand gauges.
const SHARE: u32 = 10;

/// What a thread that follows a mount reports.
#[derive(Clone, Debug)]
pub struct Look {
    /// The attributes in the `uevent` of each supply, by its name; or why there are none.
    pub supplies: Result<BTreeMap<String, Texts>, String>,
    /// Time until the next report.
    pub next: Duration,
}

/// Follows the supplies of a mount from a thread of its own, which reports to a channel. It ends with its receiver.
pub fn to_channel<T: From<Look> + Send + 'static>(mountpoint: PathBuf, to: Sender<T>) -> Result<()> {
    let look = move || {
        let begun = Instant::now();
        let supplies = supplies_at(&mountpoint).map_err(|error| trouble(&mountpoint, &error));
        let next = PAUSE.max(begun.elapsed() * (SHARE - 1));
        (Look { supplies, next }, next)
    };
    look_again(look, to)
}

/// The supplies of the mount. Those of the kernel that show through it are symbolic links, and are left out.
fn supplies_at(mountpoint: &Path) -> io::Result<BTreeMap<String, Texts>> {
    if !mounts::is_gaugefs(mountpoint) {
        return Err(ErrorKind::NotFound.into());
    }
    // Only STATFS is never answered from the kernel's cache, which outlives a daemon that was killed.
    statvfs(mountpoint)?;
    let mut supplies = BTreeMap::new();
    for entry in fs::read_dir(mountpoint)? {
        let entry = entry?;
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
