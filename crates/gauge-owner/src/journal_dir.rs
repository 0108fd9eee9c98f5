// SPDX-License-Identifier: MIT

//! The folder of the journals and backups.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::errno::Errno;
use nix::unistd::{AccessFlags, access};

use crate::error::{Error, Result};
use crate::folders;

/// Whether journals can be kept in a folder that was given; it is created when something is written to it.
pub fn check(folder: &Path) -> Result<()> {
    let failed = |error: &std::io::Error| {
        let what = "cannot keep journals there; name another folder with --state-dir";
        Error::io(folder.display().to_string(), what, error)
    };
    let there = folder.ancestors().find(|above| above.symlink_metadata().is_ok()).unwrap_or(folder);
    if !there.metadata().map_err(|error| failed(&error))?.is_dir() {
        return Err(failed(&Errno::ENOTDIR.into()));
    }
    access(there, AccessFlags::W_OK | AccessFlags::X_OK).map_err(|errno| failed(&errno.into()))
}

/// The folder, and the gauge's name in it. A gauge that ends with this process has one only if a folder was given.
pub fn place(folder: Option<&Path>, key: Option<String>) -> Result<Option<(PathBuf, String)>> {
    let key = match (key, folder) {
        (Some(key), _) => key,
        (None, Some(_)) => {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
            format!("sim-{}-{now}", std::process::id())
        }
        (None, None) => return Ok(None),
    };
    // It is created when something is written to it.
    let folder = folder.map(Path::to_path_buf).or_else(folders::state).ok_or_else(|| {
        let why = "this account has no home for journals; name a folder";
        Error::host("--state-dir", Errno::ENOENT, why)
    })?;
    Ok(Some((folder, key)))
}
