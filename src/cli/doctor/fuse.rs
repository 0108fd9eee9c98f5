// SPDX-License-Identifier: MIT

//! The kernel, FUSE, and the program that mounts for ordinary users.

use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt;

use super::host::Host;
use super::{Finding, ok, problem, warning};

/// The first kernel that caches directory listings.
const KERNEL: (u32, u32) = (5, 1);

pub(super) fn check(host: &Host) -> Vec<Finding> {
    vec![kernel(host), device(host), fusermount(host), others(host)]
}

fn kernel(host: &Host) -> Finding {
    let release = host.text("/proc/sys/kernel/osrelease");
    let release = release.trim();
    let mut numbers = release.split(['.', '-']).map_while(|number| number.parse().ok());
    match (numbers.next(), numbers.next()) {
        (Some(major), Some(minor)) if (major, minor) < KERNEL => {
            let says = format!(
                "{release} is older than {}.{}; it does not cache directory listings",
                KERNEL.0, KERNEL.1
            );
            warning("Linux", says, "Use a newer kernel if listings have to be cheap.")
        }
        (Some(_), Some(_)) => ok("Linux", release),
        _ => warning("Linux", "its version cannot be read", "Mount /proc."),
    }
}

fn device(host: &Host) -> Finding {
    let what = "/dev/fuse";
    let status = match fs::metadata(host.at(what)) {
        Ok(status) => status,
        Err(_) => return problem(what, "does not exist", "Load the module as root: modprobe fuse"),
    };
    if !host.may_use(what, &status) {
        return problem(what, "no permission", "As root: chmod 666 /dev/fuse");
    }
    match File::options().read(true).write(true).open(host.at(what)) {
        Ok(_) => ok(what, "can be opened"),
        Err(error) => {
            let remedy = "Load the module as root: modprobe fuse. A container needs access to the device.";
            problem(what, format!("cannot be opened: {error}"), remedy)
        }
    }
}

fn fusermount(host: &Host) -> Finding {
    let what = "fusermount3";
    let places = ["/usr/local/bin", "/usr/bin", "/bin"].map(|folder| format!("{folder}/{what}"));
    let found = places.iter().find_map(|path| Some((path, fs::metadata(host.at(path)).ok()?)));
    match found {
        None if host.is_root() => ok(what, "not installed; root does not need it"),
        None => problem(what, "not installed", "Install it: sudo apt-get install fuse3"),
        Some((path, status)) if status.permissions().mode() & 0o4000 == 0 && !host.is_root() => {
            let remedy = format!("Restore its setuid bit: sudo chmod u+s {path}");
            problem(what, format!("{path} is not setuid, so only root can mount"), remedy)
        }
        Some((path, _)) => ok(what, path),
    }
}

fn others(host: &Host) -> Finding {
    let set = host.text("/etc/fuse.conf").lines().any(|line| line.trim() == "user_allow_other");
    let is = if set { "is set" } else { "is not set" };
    let means = "only a user who mounts with --group needs it; root's mounts are open to all users";
    ok("user_allow_other", format!("{is}; {means}"))
}
