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
use crate::config::{GaugeOptions, MountOptions, Setup};
use crate::error::{Cause, Error, Result};
use crate::fs::Covered;
use crate::fuse::needs;
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular;
use gauge_owner::{GaugeSetup, Source, journal_dir};
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
    let batteries = names.iter().zip(gauges).filter(|(_, gauge)| gauge.kernel_node);
    found.extend(batteries.map(|(name, gauge)| {
        let chip = gauge.source().chip();
        node::check(name, chip, covered.is_some(), is_service || geteuid().is_root())
    }));
    found.extend(gauges.iter().map(|gauge| gauge.setup().check_trace()));
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
        found.extend(needs_of(name, &gauge.setup(), &mountpoint).into_iter().map(|error| error.within(name)));
    }
    (names, found)
}

/// Checks that no gauge needs a time that the mount must not wait for.
fn fast(setup: &Setup, names: &[String]) -> Result<()> {
    let real = |gauge: &&GaugeOptions| !matches!(gauge.source(), Source::Sim { .. });
    match names.iter().zip(&setup.gauges).find(|(_, gauge)| real(gauge)) {
        Some((name, gauge)) if setup.mount.fast => {
            let why = format!("fast is for simulated gauges, and it is {}", gauge.source());
            Err(Error::new(name, Cause::Invalid, why))
        }
        _ => Ok(()),
    }
}

/// Checks that every written file has a name of its own.
fn distinct(setup: &Setup) -> Result<()> {
    let of_gauges = setup.gauges.iter().flat_map(|gauge| [&gauge.trace, &gauge.sim_state]).flatten();
    let mut seen = HashSet::new();
    match setup.mount.log.iter().chain(of_gauges).find(|file| !seen.insert(*file)) {
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

fn needs_of(name: &str, gauge: &GaugeSetup, mountpoint: &Path) -> Vec<Error> {
    let mut found: Vec<Error> = Vec::new();
    match gauge.keys(name) {
        Err(error) => found.push(error),
        Ok(keys) => {
            let none = keys.is_empty();
            if let Some(path) = gauge.key_file.as_ref().filter(|_| none) {
                let why =
                    format!("it has no key for {name}: neither above its sections nor in a section [{name}]");
                found.push(Error::new(path.display().to_string(), Cause::Invalid, why));
            }
        }
    }
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    found.extend(gauge.source.check(mountpoint, &clock).err().map(|error| match gauge.source {
        Source::Bus { chip: Some(_), .. } => waited_for(&error),
        _ => error,
    }));
    if let Some(chip) = gauge.source.chip() {
        found.extend(gauge.profile(chip).err());
        found.extend(gauge.choices(chip).err());
    }
    found.extend(gauge.choose.iter().filter_map(|rule| rule.evidence.as_ref()?.check().err()));
    found
}

/// A gauge whose part is named may be absent when the mount starts.
fn waited_for(error: &Error) -> Error {
    Error::host("", error.errno(), format!("{error}; a mount would wait for it"))
}
