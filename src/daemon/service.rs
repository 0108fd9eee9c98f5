//! A service that may not mount, and the two steps that systemd's units do for it as root.
//!
//! The daemon of a unit has an account of its own, no capability, and a view of the file system of its own,
//! in which nobody else would see a mount. So it opens `/dev/fuse` and mounts nothing. When its gauges have
//! been read it says that it is ready; `gaugefs attach` takes the descriptor out of it and mounts that for
//! everybody. When it has ended, however that happened, `gaugefs detach` clears the mount away.
//!
//! systemd gives these steps a view of their own as well, so the units have `nsenter` take them to that of
//! process 1. `attach` is told what the daemon is told, by the unit. It asks the daemon for nothing but the
//! descriptor, and the kernel makes sure that it is one of FUSE.

use std::fs::{self, File};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::time::Duration;

use nix::errno::Errno;
use nix::mount::{MsFlags, mount};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::{Mode, makedev, umask};
use rustix::process::{Pid, PidfdFlags, PidfdGetfdFlags, pidfd_getfd, pidfd_open};

use super::mountpoint;
use crate::clock::Clock;
use crate::config::Setup;
use crate::error::{Error, Result};

const DEVICE: &str = "/dev/fuse";
/// Its numbers, which are the same everywhere.
const MAJOR: u64 = 10;
const MINOR: u64 = 229;

/// How long the daemon waits for its mount, and how often it looks.
const PATIENCE: Duration = Duration::from_secs(60);
const STEP: Duration = Duration::from_millis(5);

/// The daemon's end of a mount that is still to come.
pub(super) fn device() -> Result<OwnedFd> {
    let device = File::options().read(true).write(true).open(DEVICE);
    device.map(OwnedFd::from).map_err(|error| Error::io(DEVICE, "cannot open it", &error))
}

/// Waits until it is mounted: then the kernel's first request is there.
pub(super) fn wait(device: &OwnedFd, clock: &dyn Clock) -> Result<()> {
    let start = clock.now();
    loop {
        let mut polled = [PollFd::new(device.as_fd(), PollFlags::POLLIN)];
        poll(&mut polled, PollTimeout::ZERO)
            .map_err(|errno| Error::io(DEVICE, "cannot wait for its mount", &errno.into()))?;
        if polled[0].revents().is_some_and(|events| events.contains(PollFlags::POLLIN)) {
            return Ok(());
        }
        if clock.now().saturating_sub(start) > PATIENCE {
            let why = "nobody has mounted it; --service is for units that run `gaugefs attach`";
            return Err(Error::host(DEVICE, Errno::ETIMEDOUT, why));
        }
        clock.sleep(STEP);
    }
}

/// Mounts what the daemon of that process serves. For root.
pub(crate) fn attach(pid: i32, setup: &Setup) -> Result<()> {
    let device = device_of(pid)?;
    // The folders that are made are for everybody, whatever the unit says of files.
    umask(Mode::S_IWGRP | Mode::S_IWOTH);
    let mountpoint = mountpoint::prepare(setup.mountpoint())?;
    mountpoint::make(&mountpoint)?;
    // As fuser mounts it for a daemon of root's. The mount is root's, whoever serves it.
    let others = if setup.mount.private { "" } else { ",allow_other" };
    let data =
        format!("fd={},rootmode=40000,user_id=0,group_id=0,default_permissions{others}", device.as_raw_fd());
    let mut flags = MsFlags::MS_NOSUID | MsFlags::MS_NODEV | MsFlags::MS_NOEXEC;
    flags.set(MsFlags::MS_RDONLY, setup.mount.read_only);
    let mounted = mount(Some(mountpoint::SOURCE), &mountpoint, Some("fuse.gaugefs"), flags, Some(&*data));
    mounted.map_err(|errno| Error::io(mountpoint.display().to_string(), "cannot mount it", &errno.into()))
}

/// Clears away what daemons that have ended have left, wherever they were mounted. For root.
pub fn detach() -> Result<()> {
    mountpoint::list().iter().try_for_each(|path| mountpoint::clear(path).map(drop))
}

/// A copy of the descriptor that a process has of `/dev/fuse`.
fn device_of(pid: i32) -> Result<OwnedFd> {
    let process = format!("process {pid}");
    let refuse = |error: std::io::Error| Error::io(&process, "cannot take its /dev/fuse", &error);
    let number = Pid::from_raw(pid).ok_or_else(|| refuse(Errno::ESRCH.into()))?;
    let holder = pidfd_open(number, PidfdFlags::empty()).map_err(|errno| refuse(errno.into()))?;
    let fuse =
        |status: &fs::Metadata| status.file_type().is_char_device() && status.rdev() == makedev(MAJOR, MINOR);
    for entry in fs::read_dir(format!("/proc/{pid}/fd")).map_err(refuse)?.flatten() {
        let Some(descriptor) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else {
            continue;
        };
        // The name may mean nothing here: the process has a view of its own.
        if fs::metadata(entry.path()).is_ok_and(|status| fuse(&status)) {
            let taken = pidfd_getfd(&holder, descriptor, PidfdGetfdFlags::empty());
            return taken.map_err(|errno| refuse(errno.into()));
        }
    }
    Err(Error::host(process, Errno::ENOENT, "it serves no mount: it has not opened /dev/fuse"))
}
