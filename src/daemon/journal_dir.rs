//! The folder of the journals and backups.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::errno::Errno;
use nix::unistd::{User, geteuid};

use crate::error::{Error, Result};

/// The folder, and the name of the gauge in it. A gauge that ends with this process has no name, since there is
/// nothing to settle later; it has one only if a folder was given.
pub(super) fn place(folder: Option<&Path>, key: Option<String>) -> Result<Option<(PathBuf, String)>> {
    let key = match (key, folder) {
        (Some(key), _) => key,
        (None, Some(_)) => {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
            format!("sim-{}-{now}", std::process::id())
        }
        (None, None) => return Ok(None),
    };
    let folder = folder.map_or_else(state_dir, |path| Ok(path.to_path_buf()))?;
    Ok(Some((folder, key)))
}

/// The system's folder for state, or the user's own. It is created when something is written to it.
fn state_dir() -> Result<PathBuf> {
    if geteuid().is_root() {
        return Ok(PathBuf::from("/var/lib/gaugefs"));
    }
    let named = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let account = || User::from_uid(geteuid()).ok().flatten().map(|user| user.dir);
    let home = || named("HOME").or_else(account).map(|home| home.join(".local/state"));
    match named("XDG_STATE_HOME").or_else(home) {
        Some(state) => Ok(state.join("gaugefs")),
        None => {
            let why = "this account has no home for journals; name a folder";
            Err(Error::host("--state-dir", Errno::ENOENT, why))
        }
    }
}
