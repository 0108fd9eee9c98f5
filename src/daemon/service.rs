// SPDX-License-Identifier: MIT

//! A systemd service without the privilege to mount, and its unit's two steps as root.
//!
//! A unit's daemon has its own account, no capability and its own mount namespace, where nobody else would see a mount.
//! So it opens `/dev/fuse` and mounts nothing. It reports that it is ready after reading its gauges; `gaugefs attach`
//! then copies the descriptor and mounts it for everybody. When the daemon has ended, for whatever reason, `gaugefs
//! detach` removes the mount.
//!
//! systemd runs these steps in the service's namespace too, so the units enter that of process 1 with `nsenter`. The
//! unit gives `attach` the daemon's options. `attach` takes only the descriptor from the daemon, and the kernel
//! verifies that it is one of FUSE.

use std::fs::{self, File};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::time::Duration;

use nix::errno::Errno;
use nix::mount::{MsFlags, mount};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::{Mode, makedev, umask};
use rustix::process::{Pid, PidfdFlags, PidfdGetfdFlags, pidfd_getfd, pidfd_open};

use super::background;
use super::mountpoint::{self, Hiding};
use crate::config::Setup;
use crate::error::{Error, Result};
use crate::output::{say, say_error};
use gauge_bus::clock::Clock;
use gauge_owner::{Outlook, lock};
use gaugefs_client::mounts;

const DEVICE: &str = "/dev/fuse";
/// Device numbers of `/dev/fuse`, which are the same on every machine.
const MAJOR: u64 = 10;
const MINOR: u64 = 229;

/// How long the daemon waits for its mount, and the interval of checks.
const PATIENCE: Duration = Duration::from_secs(60);
const STEP: Duration = Duration::from_millis(5);

/// How long a start is repeated, and the interval of tries.
const TRIES: Duration = Duration::from_secs(30);
const PAUSE: Duration = Duration::from_secs(2);
/// The exit code after which the unit is started again: EX_TEMPFAIL of `sysexits.h`.
const AGAIN: i32 = 75;

/// Opens the gauges, repeatedly while the machine starts. If they may answer later, the process ends with the exit code
/// for another start; lasting failures are returned.
pub(super) fn open<T>(clock: &dyn Clock, open: impl Fn() -> Result<T>) -> Result<T> {
    let error = match patiently(clock, open) {
        Err(error) if Outlook::of(error.cause()) == Outlook::Later => error,
        outcome => return outcome,
    };
    say_error(&error);
    lock::remove_all();
    std::process::exit(AGAIN)
}

fn patiently<T>(clock: &dyn Clock, open: impl Fn() -> Result<T>) -> Result<T> {
    let start = clock.now();
    loop {
        match open() {
            Err(error)
                if Outlook::of(error.cause()) > Outlook::Never
                    && clock.now().saturating_sub(start) < TRIES =>
            {
                background::notify(&format!("STATUS=trying again: {error}"));
                clock.sleep(PAUSE);
            }
            outcome => return outcome,
        }
    }
}

/// The daemon's end of the future mount.
pub(super) fn device() -> Result<OwnedFd> {
    let device = File::options().read(true).write(true).open(DEVICE);
    device.map(OwnedFd::from).map_err(|error| Error::io(DEVICE, "cannot open it", &error))
}

/// Waits for the mount, which the kernel's first request shows.
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
            let limit = PATIENCE.as_secs();
            let why =
                format!("not mounted within {limit} s; --service is for units that run `gaugefs attach`");
            return Err(Error::host(DEVICE, Errno::ETIMEDOUT, why));
        }
        clock.sleep(STEP);
    }
}

/// Mounts what the daemon in process `pid` serves. For root.
pub(crate) fn attach(pid: i32, setup: &Setup) -> Result<()> {
    let device = device_of(pid)?;
    // Everybody may enter created folders, whatever umask the unit sets.
    umask(Mode::S_IWGRP | Mode::S_IWOTH);
    let tell = |line: &str| say(format_args!("warning: {line}"));
    let mountpoint = mountpoint::prepare(setup.mountpoint(), &Hiding::by(&setup.mount, true, &tell))?;
    mountpoint::make(&mountpoint)?;
    // fuser's options for a daemon of root. The mount belongs to root, not to the service's account.
    let others = if setup.mount.private { "" } else { ",allow_other" };
    let data =
        format!("fd={},rootmode=40000,user_id=0,group_id=0,default_permissions{others}", device.as_raw_fd());
    let mut flags = MsFlags::MS_NOSUID | MsFlags::MS_NODEV | MsFlags::MS_NOEXEC;
    flags.set(MsFlags::MS_RDONLY, setup.mount.read_only);
    let mounted = mount(Some(mounts::SOURCE), &mountpoint, Some("fuse.gaugefs"), flags, Some(&*data));
    mounted.map_err(|errno| Error::io(mountpoint.display().to_string(), "cannot mount it", &errno.into()))
}

/// Removes all mounts whose daemon has ended. For root.
pub fn detach() -> Result<()> {
    mountpoint::clear_all()
}

/// A copy of a process's descriptor of `/dev/fuse`.
pub(crate) fn device_of(pid: i32) -> Result<OwnedFd> {
    let fuse =
        |status: &fs::Metadata| status.file_type().is_char_device() && status.rdev() == makedev(MAJOR, MINOR);
    let found = descriptor_of(pid, DEVICE, fuse, |_| true)?;
    found.ok_or_else(|| {
        Error::host(
            format!("process {pid}"),
            Errno::ENOENT,
            "it serves no mount: it has not opened /dev/fuse",
        )
    })
}

/// A copy of a process's descriptor, chosen by its target, and then by the copy itself. `what` names it in errors.
pub(super) fn descriptor_of(
    pid: i32,
    what: &str,
    may_be: impl Fn(&fs::Metadata) -> bool,
    is_it: impl Fn(&OwnedFd) -> bool,
) -> Result<Option<OwnedFd>> {
    let refuse = |error: std::io::Error| {
        Error::io(format!("process {pid}"), &format!("cannot take its {what}"), &error)
    };
    let number = Pid::from_raw(pid).ok_or_else(|| refuse(Errno::ESRCH.into()))?;
    let holder = pidfd_open(number, PidfdFlags::empty()).map_err(|errno| refuse(errno.into()))?;
    for entry in fs::read_dir(format!("/proc/{pid}/fd")).map_err(refuse)?.flatten() {
        let Some(descriptor) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else {
            continue;
        };
        // The link's name would be one of the process's own namespace.
        if fs::metadata(entry.path()).is_ok_and(|status| may_be(&status)) {
            let taken = pidfd_getfd(&holder, descriptor, PidfdGetfdFlags::empty())
                .map_err(|errno| refuse(errno.into()))?;
            if is_it(&taken) {
                return Ok(Some(taken));
            }
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use gauge_bus::clock::SimClock;

    use super::*;
    use crate::error::Cause;
    use gauge_bus::error::ErrorKind;

    /// A service stayed failed after a failed first start at boot.
    #[test]
    fn regression_a_start_gave_up_although_the_gauge_came_a_moment_later() {
        let tries = |cause: Cause, until: u32| {
            let (clock, count) = (SimClock::new(), Cell::new(0));
            let outcome = patiently(&clock, || {
                count.set(count.get() + 1);
                if count.get() < until { Err(Error::new("", cause, "no")) } else { Ok(()) }
            });
            (outcome.is_ok(), count.get())
        };
        for cause in [Cause::NoAnswer, Cause::TimedOut, Cause::Adapter(ErrorKind::NotFound)] {
            assert_eq!(tries(cause, 3), (true, 3), "{cause:?}");
            let (is_open, count) = tries(cause, u32::MAX);
            assert!(!is_open && (10..20).contains(&count), "{cause:?}: {count}");
        }
        // Lasting failures are reported at once.
        for cause in [Cause::Invalid, Cause::NotPermitted, Cause::Gone, Cause::Adapter(ErrorKind::NoWords)] {
            assert_eq!(tries(cause, 3), (false, 1), "{cause:?}");
        }
    }
}
