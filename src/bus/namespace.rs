// SPDX-License-Identifier: MIT

//! A command with its own bus in `/dev`.
//!
//! The command gets a mount namespace, in which `/dev` is a copy with one more file, `i2c-N`; without root it also gets
//! a user namespace, which allows it to mount. Nothing of this is visible outside, and nothing remains. gaugefs starts
//! itself again for it: that process makes the namespace, mounts the file, stops until its parent has taken the
//! kernel's end of the mount, and becomes the command.

use std::ffi::OsString;
use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use nix::errno::Errno;
use nix::mount::{MsFlags, mount};
use nix::sched::{CloneFlags, unshare};
use nix::sys::signal::{SigSet, Signal, raise};
use nix::unistd::{getegid, geteuid};
use rustix::thread::{
    CapabilitySet, CapabilitySets, capabilities, configure_capability_in_ambient_set, set_capabilities,
};

use super::{SOURCE, setting};
use crate::error::{Error, Result};
use crate::fuse::single;
use crate::output::say;
use gaugefs_host::signals;

/// The first number to try: adapters of the kernel count from 0.
const FIRST: u32 = 90;

/// A number without an adapter.
pub(super) fn number() -> u32 {
    let is_free = |number: &u32| {
        let node = format!("i2c-{number}");
        !Path::new("/dev").join(&node).exists() && !Path::new("/sys/class/i2c-dev").join(&node).exists()
    };
    (FIRST..).find(is_free).unwrap_or(FIRST)
}

pub(super) fn node(number: impl Display) -> PathBuf {
    format!("/dev/i2c-{number}").into()
}

/// Becomes the command, with a bus of that number. It returns only if the command cannot be run, with the exit code.
pub(crate) fn become_command(number: Option<u32>, command: &[OsString]) -> Result<ExitCode> {
    let failed = |errno: Errno| Error::io("the command", "cannot be started", &errno.into());
    if let Some(number) = number {
        enter()?;
        let node = node(number);
        copy_dev(&node).map_err(explained)?;
        // exec closes it, so the command does not hold it.
        let _device = single::mount(&node, SOURCE)?;
        raise(Signal::SIGSTOP).map_err(failed)?;
        // The kernel gives a new file to root. In a user namespace without root nobody could open it for writing, until
        // somebody has asked for its attributes.
        let _ = fs::metadata(&node);
    }
    // The server has blocked them, and a process inherits that.
    signals::ends().into_iter().collect::<SigSet>().thread_unblock().map_err(failed)?;
    Ok(not_run(command, &Command::new(&command[0]).args(&command[1..]).exec()))
}

/// Says why a command cannot be run, and returns a shell's exit code for that.
fn not_run(command: &[OsString], error: &io::Error) -> ExitCode {
    let subject = command[0].to_string_lossy().into_owned();
    if error.kind() == ErrorKind::NotFound {
        let place = if subject.contains('/') { "" } else { " in the folders of $PATH" };
        say(Error::host(subject, Errno::ENOENT, format!("no such program{place}")));
        return ExitCode::from(127);
    }
    say(Error::io(subject, "cannot be run", error));
    ExitCode::from(126)
}

fn enter() -> Result<()> {
    if geteuid().is_root() && unshare(CloneFlags::CLONE_NEWNS).is_ok() {
        return Ok(());
    }
    let (uid, gid) = (geteuid(), getegid());
    unshare(CloneFlags::CLONE_NEWNS | CloneFlags::CLONE_NEWUSER)
        .map_err(|errno| restricted(&errno.into()))?;
    // The command keeps its user.
    let map = |file: &str, text: String| {
        fs::write(file, text).map_err(|error| Error::io(file, "cannot be written", &error))
    };
    map("/proc/self/setgroups", "deny".into())?;
    map("/proc/self/uid_map", format!("{uid} {uid} 1"))?;
    map("/proc/self/gid_map", format!("{gid} {gid} 1"))?;
    // The command may mount too, as `gaugefs mount` has to. The bus does not need it.
    let _ = keep_mounting();
    Ok(())
}

/// Keeps the privilege to mount in this namespace beyond exec.
fn keep_mounting() -> rustix::io::Result<()> {
    let own = capabilities(None)?;
    set_capabilities(
        None,
        CapabilitySets { inheritable: own.inheritable | CapabilitySet::SYS_ADMIN, ..own },
    )?;
    configure_capability_in_ambient_set(CapabilitySet::SYS_ADMIN, true)
}

/// Covers `/dev` with a copy of its files and folders, plus an empty file.
fn copy_dev(node: &Path) -> Result<()> {
    const NONE: Option<&str> = None;
    let dev = Path::new("/dev");
    let failed = |error: io::Error| Error::io("/dev", "cannot be copied for the command", &error);
    let mounted = |outcome: nix::Result<()>| outcome.map_err(|errno| failed(errno.into()));
    mounted(mount(NONE, "/", NONE, MsFlags::MS_REC | MsFlags::MS_SLAVE, NONE))?;
    let original = File::open(dev).map_err(failed)?;
    let entries: Vec<_> = fs::read_dir(dev).map_err(failed)?.flatten().collect();
    let kinds: Vec<_> = entries.iter().map(|entry| entry.file_type()).collect();
    let below = PathBuf::from(format!("/proc/self/fd/{}", original.as_raw_fd()));
    mounted(mount(Some("dev"), dev, Some("tmpfs"), MsFlags::MS_NOSUID, Some("mode=755")))?;
    for (entry, kind) in entries.iter().zip(kinds) {
        let (old, new) = (below.join(entry.file_name()), dev.join(entry.file_name()));
        let kind = kind.map_err(failed)?;
        let mut how = MsFlags::MS_BIND;
        if kind.is_symlink() {
            fs::read_link(&old).and_then(|target| symlink(target, &new)).map_err(failed)?;
            continue;
        } else if kind.is_dir() {
            fs::create_dir(&new).map_err(failed)?;
            how |= MsFlags::MS_REC;
        } else {
            File::create(&new).map_err(failed)?;
        }
        match mount(Some(&old), &new, NONE, how, NONE) {
            // It is gone since it was listed.
            Err(Errno::ENOENT) => {}
            outcome => mounted(outcome)?,
        }
    }
    let made = File::options().write(true).create_new(true).mode(0o600).open(node);
    made.map(drop).map_err(failed)
}

/// Checks that the kernel lets another process take the kernel's end of the mount.
pub(super) fn check_ptrace() -> Result<()> {
    if setting("kernel/yama/ptrace_scope").is_some_and(|scope| scope == "3") {
        let why = "Yama forbids to take anything from another program (kernel.yama.ptrace_scope is 3), so the command cannot \
                   have a /dev of its own; with a PATH before `--` it finds the bus at that path instead, where plain reads \
                   and writes, and I2C_SLAVE, work";
        return Err(Error::host("the command", Errno::EPERM, why));
    }
    Ok(())
}

/// Explains an error of [`copy_dev`] where a security module withholds a user namespace's privileges.
fn explained(error: Error) -> Error {
    match Errno::from_raw(error.errno()) {
        errno @ (Errno::EPERM | Errno::EACCES) => restricted(&errno.into()),
        _ => error,
    }
}

/// Explains refused namespaces: what refuses them, and what works without.
fn restricted(error: &io::Error) -> Error {
    let is = |name: &str, value: &str| setting(name).is_some_and(|set| set == value);
    let reason = if is("kernel/unprivileged_userns_clone", "0") {
        "user namespaces are restricted to root (kernel.unprivileged_userns_clone is 0)".into()
    } else if is("user/max_user_namespaces", "0") {
        "user namespaces are switched off (user.max_user_namespaces is 0)".into()
    } else if is("kernel/apparmor_restrict_unprivileged_userns", "1") {
        "AppArmor restricts user namespaces (kernel.apparmor_restrict_unprivileged_userns is 1)".into()
    } else {
        format!("namespaces cannot be used here ({})", gauge_bus::error::reason(error))
    };
    let why = format!(
        "{reason}, so the command cannot have a /dev of its own; with a PATH before `--` it finds the bus at that path \
         instead, which is also in $I2C_DEV"
    );
    let errno = error.raw_os_error().map_or(Errno::EPERM, Errno::from_raw);
    Error::host("the command", errno, why)
}
