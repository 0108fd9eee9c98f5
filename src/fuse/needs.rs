// SPDX-License-Identifier: MIT

//! What the machine needs before anything can be mounted, and the only way to mount.

use std::env;
use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use fuser::{Config, Filesystem, MountOption, Session};
use nix::errno::Errno;
use nix::unistd::geteuid;
use rustix::thread::{CapabilitySet, capabilities};

use super::host;
use crate::error::{Error, Result};
use gauge_bus::error::reason;

/// The kernel's end of a mount.
const DEVICE: &str = "/dev/fuse";

/// Programs that mount for ordinary users, in the places where `fuser` finds them.
const HELPERS: [&str; 2] = ["fusermount3", "fusermount"];

/// The program that mounts and unmounts for users other than root.
pub fn helper() -> Option<PathBuf> {
    let path = env::var_os("PATH").unwrap_or_default();
    let folders: Vec<_> = env::split_paths(&path).chain(["/sbin".into(), "/bin".into()]).collect();
    // A name with a slash is taken as it is.
    let find = |name: &OsStr| folders.iter().map(|folder| folder.join(name)).find(|path| path.is_file());
    match env::var_os("FUSERMOUNT_PATH") {
        Some(name) if name.as_bytes().contains(&b'/') => {
            Some(name.into()).filter(|path: &PathBuf| path.is_file())
        }
        Some(name) => find(&name),
        None => HELPERS.iter().find_map(|name| find(OsStr::new(name))),
    }
}

/// Whether this process can mount: by itself, as root or in its user namespace, or with fusermount3.
pub fn rights() -> Result<()> {
    let is_able = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::SYS_ADMIN));
    if is_able || geteuid().is_root() || helper().is_some() {
        return Ok(());
    }
    let why = "not found, and only root can mount without it; install the package fuse3 (sudo apt-get install fuse3), or \
               run gaugefs with sudo";
    Err(Error::host(HELPERS[0], Errno::ENOENT, why))
}

/// Whether the kernel's end of a mount can be opened.
pub fn device() -> Result<()> {
    let error = match File::options().read(true).write(true).open(DEVICE) {
        Ok(_) => return Ok(()),
        Err(error) => error,
    };
    let remedy = match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::EACCES) => "as root: chmod 666 /dev/fuse",
        Some(Errno::EPERM) => "a container has to be given the device",
        _ => "load the kernel's module as root: modprobe fuse",
    };
    let why = format!("cannot open it: {}; {remedy}", reason(&error));
    Err(Error::host(DEVICE, error, why))
}

/// Mounts a file system whose name in the mount table begins with `source`. Reports what the machine lacks before the
/// crate `fuser` tries, which has only an errno for it.
pub(super) fn session<F: Filesystem + 'static>(
    filesystem: F,
    path: &Path,
    (source, subtype): (&str, &str),
    mut config: Config,
) -> Result<Session<F>> {
    rights()?;
    device()?;
    config.mount_options.extend([
        MountOption::FSName(source.into()),
        MountOption::Subtype(subtype.into()),
        MountOption::DefaultPermissions,
        MountOption::NoSuid,
        MountOption::NoDev,
        MountOption::NoExec,
    ]);
    Session::new(filesystem, path, &config).map_err(|error| host(&path.display().to_string(), &error))
}
