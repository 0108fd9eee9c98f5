// SPDX-License-Identifier: MIT

//! Folders for gaugefs's own files: locks, journals and backups.
//!
//! None is in a shared folder such as `/tmp`, where the first user to create it would keep all others out.

use std::path::PathBuf;
use std::sync::OnceLock;

use nix::unistd::{User, geteuid};

/// Lock folders of root's daemons and of the services.
pub const SYSTEM_LOCKS: [&str; 2] = [RUN, STATE];
/// Root's lock folder, which also has the services' mounts.
pub const RUN: &str = "/run/gaugefs";
/// The account of the services (`udev/sysusers.conf`).
const SERVICE: &str = "gaugefs";
/// The system's folder for configurations and key files.
pub const CONFIGURATION: &str = "/etc/gaugefs";
/// The system's folder for journals and backups.
const STATE: &str = "/var/lib/gaugefs";

/// The lock folder: root's, the user's runtime folder, or the one for [`state`]. `None` for an account without any.
pub fn locks() -> Option<PathBuf> {
    if geteuid().is_root() {
        return Some(RUN.into());
    }
    named("XDG_RUNTIME_DIR").map(|runtime| runtime.join("gaugefs")).or_else(state)
}

/// The folder for journals and backups: the system's or the user's own. `None` for an account without a home.
pub fn state() -> Option<PathBuf> {
    if geteuid().is_root() {
        return Some(STATE.into());
    }
    let account = || User::from_uid(geteuid()).ok().flatten().map(|user| user.dir);
    let home = || named("HOME").or_else(account).map(|home| home.join(".local/state"));
    named("XDG_STATE_HOME").or_else(home).map(|state| state.join("gaugefs"))
}

/// The services' account, whose folders root uses too. `None` for other users, who trust only themselves and root.
pub fn service() -> Option<u32> {
    // A daemon asks for each gauge's folders, and each time the system would load what finds accounts in networks.
    static ACCOUNT: OnceLock<Option<u32>> = OnceLock::new();
    let account = || User::from_name(SERVICE).ok().flatten().map(|user| user.uid.as_raw());
    geteuid().is_root().then(|| *ACCOUNT.get_or_init(account)).flatten()
}

fn named(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}
