//! What a mount needs of the machine. What the mount itself would stumble over is found before any gauge is opened;
//! `gaugefs mount --check` also looks at what each gauge needs, and lists all of it.

use std::env;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nix::errno::Errno;
use nix::unistd::{AccessFlags, Gid, Group, User, access, getegid, geteuid, getgroups};

use super::gauges::{keys, saved};
use super::source::recorded;
use super::{Source, mountpoint};
use crate::config::{GaugeOptions, MountOptions, Setup};
use crate::error::{Cause, Error, Result};
use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus};

const DEVICE: &str = "/dev/fuse";
const CONFIGURATION: &str = "/etc/fuse.conf";
/// Its line that lets ordinary users open their mounts to others.
const SHARED: &str = "user_allow_other";
/// The programs that mount for ordinary users. The crate `fuser` finds them in the same places.
const HELPERS: [&str; 2] = ["fusermount3", "fusermount"];

/// What prevents a mount whatever its gauges are.
pub(super) fn mount(options: &MountOptions) -> Result<()> {
    group(options)?;
    can_mount()
}

/// Everything that a setup would stumble over. Nothing is mounted, written or sent on a bus.
pub(crate) fn check(setup: &Setup, names: &[String]) -> Vec<Error> {
    let MountOptions { log, state_dir, .. } = &setup.mount;
    let needs = [group(&setup.mount), device(), can_mount()];
    let mut found: Vec<Error> = needs.into_iter().filter_map(Result::err).collect();
    found.extend(mountpoint::check(setup.mountpoint()).err());
    found.extend(log.iter().filter_map(|path| can_be_written(path).err()));
    found.extend(state_dir.iter().filter_map(|path| can_be_written(path).err()));
    for (name, gauge) in names.iter().zip(&setup.gauges) {
        found.extend(needs_of(name, gauge).into_iter().map(|error| error.within(name)));
    }
    found
}

/// Whether the kernel's end of a mount can be opened.
pub(super) fn device() -> Result<()> {
    let error = match File::options().read(true).write(true).open(DEVICE) {
        Ok(_) => return Ok(()),
        Err(error) => error,
    };
    let remedy = match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::EACCES) => "as root: chmod 666 /dev/fuse",
        Some(Errno::EPERM) => "a container has to be given the device",
        _ => "load the kernel's module as root: modprobe fuse",
    };
    let error = Error::io(DEVICE, "cannot open it", &error);
    Err(Error::host(DEVICE, error.errno(), format!("{}; {remedy}", error.cause())))
}

/// The program that mounts and unmounts for users other than root.
pub(super) fn helper() -> Option<PathBuf> {
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

fn can_mount() -> Result<()> {
    if geteuid().is_root() || helper().is_some() {
        return Ok(());
    }
    let why = "not found, and only root can mount without it; install the package fuse3 (sudo apt-get install fuse3), or \
               run gaugefs with sudo";
    Err(Error::host(HELPERS[0], Errno::ENOENT, why))
}

/// Whether a group can be given access. The kernel opens a mount to others than its owner only if root has mounted it,
/// or allows it.
fn group(options: &MountOptions) -> Result<()> {
    let Some(gid) = options.group.map(Gid::from_raw) else { return Ok(()) };
    let name = Group::from_gid(gid).ok().flatten().map_or_else(|| gid.to_string(), |group| group.name);
    let refuse =
        |cause: fn(String) -> Cause, why: String| Err(Error::new(format!("group {name}"), cause(why)));
    if options.private {
        let why =
            "--private denies every other user access, also those of the group; leave out one of the two";
        return refuse(Cause::Invalid, why.into());
    }
    if geteuid().is_root() {
        return Ok(());
    }
    let is_member = gid == getegid() || getgroups().is_ok_and(|groups| groups.contains(&gid));
    if !is_member {
        let user = User::from_uid(geteuid()).ok().flatten().map_or_else(|| "$USER".into(), |user| user.name);
        let why = format!(
            "you are not in it, so you cannot give it access; mount with sudo, or join it (sudo usermod -aG {name} \
             {user}) and log in again"
        );
        return refuse(Cause::NotPermitted, why);
    }
    let lines = fs::read_to_string(CONFIGURATION).unwrap_or_default();
    if !lines.lines().any(|line| line.trim() == SHARED) {
        let why = format!(
            "only root may open a mount to others; mount with sudo, or allow it to all users with this line in \
             {CONFIGURATION}: {SHARED}"
        );
        return refuse(Cause::NotPermitted, why);
    }
    Ok(())
}

/// What one gauge would stumble over.
fn needs_of(name: &str, gauge: &GaugeOptions) -> Vec<Error> {
    let mut found: Vec<Error> = Vec::new();
    match keys(gauge, name) {
        Err(error) => found.push(error),
        Ok(keys) => {
            let none = keys.unseal.is_none() && keys.full_access.is_none() && keys.authentication.is_none();
            if let Some(path) = gauge.key_file.as_ref().filter(|_| none) {
                let why =
                    format!("it has no key for {name}: neither above its sections nor in a section [{name}]");
                found.push(Error::new(path.display().to_string(), Cause::Invalid(why)));
            }
        }
    }
    match Source::of(gauge) {
        Source::Bus { bus, address, chip, .. } => {
            found.extend(bus_of(bus, address).err().map(|error| match chip {
                Some(_) => waited_for(&error),
                None => error,
            }))
        }
        Source::Recording(path) => found.extend(recorded(path).err()),
        Source::Sim { state, .. } => found.extend(state.and_then(|path| can_be_written(path).err())),
    }
    if let (Some(path), Some(chip)) = (&gauge.restore, Source::of(gauge).chip()) {
        found.extend(saved(chip, path).err());
    }
    found.extend(gauge.trace.as_ref().and_then(|path| can_be_written(path).err()));
    found
}

/// Claims an address, which sends nothing, and releases it.
fn bus_of(bus: &Path, address: u8) -> Result<()> {
    let adapter = Adapter::find(bus)?;
    LinuxBus::open(adapter, address, Arc::new(RealClock::new()))?;
    Ok(())
}

/// A gauge whose part is named need not be there when the mount starts.
fn waited_for(error: &Error) -> Error {
    Error::host("", error.errno(), format!("{error}; a mount would wait for it"))
}

/// Whether this account may write a file, or make it.
fn can_be_written(path: &Path) -> Result<()> {
    let there = path.ancestors().find(|above| above.exists()).unwrap_or(path);
    access(there, AccessFlags::W_OK)
        .map_err(|errno| Error::io(path.display().to_string(), "cannot be written", &errno.into()))
}
