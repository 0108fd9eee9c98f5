// SPDX-License-Identifier: MIT

//! Gives up root's privileges for good.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use nix::sys::prctl;
use nix::unistd::{Gid, Uid, geteuid, setgroups, setresgid, setresuid};

use crate::error::{Cause, Error, Result};

/// Makes root an ordinary user for good: sudo's caller, or the owner of `state`'s folder, or nobody. Call it before
/// other threads exist. Other users stay as they are.
pub(super) fn give_up(state: Option<&Path>) -> Result<()> {
    if !geteuid().is_root() {
        return Ok(());
    }
    let (uid, gid) = successor(state)?;
    become_user(uid, gid).map_err(|errno| Error::io("gaugefs", "cannot give up root's rights", &errno.into()))
}

/// The user that this process becomes.
pub(super) fn successor(state: Option<&Path>) -> Result<(Uid, Gid)> {
    if let Some(state) = state {
        let folder = state.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let status = fs::metadata(folder)
            .map_err(|error| Error::io(folder.display().to_string(), "cannot be used for --state", &error))?;
        if status.uid() == 0 {
            let why = "its folder is root's, whose rights are given up; choose a folder of the user that is to own the file";
            return Err(Error::new(format!("--state {}", state.display()), Cause::Invalid, why));
        }
        return Ok((Uid::from_raw(status.uid()), Gid::from_raw(status.gid())));
    }
    const NOBODY: u32 = 65534;
    let number = |name| std::env::var(name).ok()?.parse().ok().filter(|number| *number != 0);
    let (uid, gid) = (number("SUDO_UID"), number("SUDO_GID"));
    let (uid, gid) = uid.zip(gid).unwrap_or((NOBODY, NOBODY));
    Ok((Uid::from_raw(uid), Gid::from_raw(gid)))
}

/// Becomes that user for good. Changing all user IDs from 0 clears the capabilities (capabilities(7)).
fn become_user(uid: Uid, gid: Gid) -> nix::Result<()> {
    setgroups(&[])?;
    setresgid(gid, gid, gid)?;
    setresuid(uid, uid, uid)?;
    prctl::set_no_new_privs()
}
