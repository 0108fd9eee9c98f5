// SPDX-License-Identifier: MIT

//! Checks that the machine has what a mount needs. A mount reports the first failure before it opens any gauge;
//! `gaugefs mount --check` reports all. It also checks each gauge's needs and /dev/fuse, with the functions that open
//! them.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use nix::unistd::{Gid, Group, User, getegid, geteuid, getgroups};

use super::mountpoint::{self, Hiding};
use super::{log, node};
use crate::config::{self, MountOptions, Setup};
use crate::error::{Cause, Error, Result};
use crate::fs::Covered;
use crate::fuse::needs;
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular;
use gauge_owner::{GaugeOptions, Source, journal_dir, may_come};
#[cfg(feature = "screen")]
use gaugefs_screen::watch::Rule;

const CONFIGURATION: &str = "/etc/fuse.conf";
/// Lets ordinary users open their mounts to others.
const SHARED: &str = "user_allow_other";
/// Problems of the mount as a whole, whatever its gauges are. `names` are the gauges', `covered` the kernel's supplies
/// under the mount. `service::attach` mounts services with privileges of its own.
pub(super) fn mount(
    setup: &Setup,
    names: &[String],
    covered: Option<&Covered>,
    is_service: bool,
) -> Vec<Error> {
    let Setup { mount, gauges, .. } = setup;
    let taken = covered.map(Covered::names).unwrap_or_default();
    let mut found: Vec<Result<()>> = Vec::new();
    if !is_service {
        found.extend([group(mount), needs::rights()]);
    }
    found.extend(mount.log.as_deref().map(log::check));
    // Only writes to a gauge write there.
    found.extend(mount.state_dir.as_deref().filter(|_| !mount.read_only).map(journal_dir::check));
    found.push(super::mains_name(mount, names, &taken).map(drop));
    found.push(distinct(setup));
    found.push(fast(setup, names));
    let batteries = names.iter().zip(gauges).filter(|(_, gauge)| node::is_wanted(gauge));
    found.extend(batteries.map(|(name, gauge)| {
        let chip = Source::of(gauge).ok().and_then(|source| source.chip());
        node::check(name, chip, covered.is_some(), is_service || geteuid().is_root())
    }));
    found.extend(gauges.iter().map(GaugeOptions::check_trace));
    found.into_iter().filter_map(Result::err).collect()
}

/// All problems of a setup, and the names of its gauges. Nothing is mounted, written or sent on a bus.
pub(crate) fn check(setup: &Setup) -> (Vec<String>, Vec<Error>) {
    let mut found: Vec<Error> = Vec::new();
    let checked = mountpoint::check(setup.mountpoint(), &Hiding::by(&setup.mount, false, &|_| ()));
    let mountpoint = checked.unwrap_or_else(|error| {
        found.push(error);
        setup.mountpoint().to_path_buf()
    });
    let covered = mountpoint::covered(&mountpoint).unwrap_or_else(|error| {
        found.push(error);
        None
    });
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let names = super::names(&setup.gauges, &taken);
    found.extend(mount(setup, &names, covered.as_ref(), false));
    found.extend(needs::device().err());
    // The mount does not need alerts.
    #[cfg(feature = "screen")]
    found.extend(setup.alerts.iter().filter_map(|alert| Rule::from(alert.clone()).check().err()));
    for (name, gauge) in names.iter().zip(&setup.gauges) {
        found.extend(needs_of(name, gauge, &mountpoint).into_iter().map(|error| error.within(name)));
    }
    (names, found)
}

/// Checks that no gauge needs a time that the mount must not wait for.
fn fast(setup: &Setup, names: &[String]) -> Result<()> {
    match names.iter().zip(&setup.gauges).find(|(_, gauge)| !config::is_simulated(gauge)) {
        Some((name, gauge)) if setup.mount.fast => {
            let why = format!("fast is for simulated gauges, and it is {}", Source::of(gauge)?);
            Err(Error::new(name, Cause::Invalid, why))
        }
        _ => Ok(()),
    }
}

/// Checks that every written file has a name of its own.
fn distinct(setup: &Setup) -> Result<()> {
    let of_gauges = setup.gauges.iter().flat_map(config::written);
    let mut seen = HashSet::new();
    let mut files = config::written(&setup.mount).chain(of_gauges).map(|(_, file)| file);
    match files.find(|file| !seen.insert(file.clone())) {
        Some(twice) => {
            let why = "it is to be written for two purposes; give each of log, trace and sim-state a file of its own";
            Err(Error::new(twice.display().to_string(), Cause::Invalid, why))
        }
        None => Ok(()),
    }
}

/// Checks that a group can get access. The kernel opens a mount to other users only if root has mounted or allowed it.
fn group(options: &MountOptions) -> Result<()> {
    let Some(gid) = options.group.map(Gid::from_raw) else { return Ok(()) };
    let name = Group::from_gid(gid).ok().flatten().map_or_else(|| gid.to_string(), |group| group.name);
    let refuse = |cause, why: String| Err(Error::new(format!("group {name}"), cause, why));
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
    let lines = regular::read_text(Path::new(CONFIGURATION), regular::SYSTEM).unwrap_or_default();
    if !lines.lines().any(|line| line.trim() == SHARED) {
        let why = format!(
            "only root may open a mount to others; mount with sudo, or allow it to all users with this line in \
             {CONFIGURATION}: {SHARED}"
        );
        return refuse(Cause::NotPermitted, why);
    }
    Ok(())
}

fn needs_of(name: &str, gauge: &GaugeOptions, mountpoint: &Path) -> Vec<Error> {
    let mut found: Vec<Error> = gauge.check_keys(name).err().into_iter().collect();
    let source = match Source::of(gauge) {
        Ok(source) => source,
        Err(error) => {
            found.push(error);
            return found;
        }
    };
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    found.extend(source.check(mountpoint, &clock).err().map(|error| match source {
        Source::Bus { chip: Some(_), .. } if may_come(&error) => waited_for(&error),
        _ => error,
    }));
    if let Some(chip) = source.chip() {
        found.extend(gauge.profile(chip).err());
        found.extend(gauge.choices(chip).err());
    }
    found.extend(gauge.check_rules());
    found
}

/// A gauge whose part is named may be absent when the mount starts.
fn waited_for(error: &Error) -> Error {
    Error::host("", nix::errno::Errno::from_raw(error.errno()), format!("{error}; a mount would wait for it"))
}
