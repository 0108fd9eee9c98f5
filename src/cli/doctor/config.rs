// SPDX-License-Identifier: MIT

//! The configurations and key files in `/etc/gaugefs`.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::host::Host;
use super::{Finding, ok, problem, warning};
use crate::config::{MountOptions, Setup};

const FOLDER: &str = crate::folders::CONFIGURATION;
/// The configuration of gaugefs.service, which names its own mount point.
const MANY: &str = "gaugefs";

/// Buses for which the udev rule starts a service: `i2c-1` for `i2c-1.toml`.
pub(super) fn buses(host: &Host) -> Vec<String> {
    let names = host.names(FOLDER).into_iter();
    let stems = names.filter_map(|name| Some(name.strip_suffix(".toml")?.to_string()));
    stems.filter(|name| is_bus(name)).collect()
}

fn is_bus(name: &str) -> bool {
    name.strip_prefix("i2c-").is_some_and(|number| number.parse::<u32>().is_ok())
}

pub(super) fn check(host: &Host) -> Vec<Finding> {
    let (mut findings, mut key_files) = (Vec::new(), Vec::new());
    for name in host.names(FOLDER) {
        let path = format!("{FOLDER}/{name}");
        match name.rsplit_once('.') {
            Some((name, "toml")) => findings.push(configuration(host, &path, name, &mut key_files)),
            Some((_, "keys")) => key_files.push(path.into()),
            _ => {}
        }
    }
    key_files.sort();
    key_files.dedup();
    findings.extend(key_files.iter().map(|path: &PathBuf| keys(host, path)));
    findings
}

/// Reads a configuration as its service does.
fn configuration(host: &Host, path: &str, name: &str, key_files: &mut Vec<PathBuf>) -> Finding {
    let device = is_bus(name).then(|| format!("/dev/{name}"));
    // Others are for `gaugefs mount --config`, or for the administrator's own rule.
    let place = (name != MANY).then(|| PathBuf::from(format!("/run/gaugefs/{name}")));
    let over = |mount: &mut MountOptions| mount.mountpoint = place.or(mount.mountpoint.take());
    let bus = device.as_deref().map(Path::new).or((name != MANY).then_some(Path::new("/dev/i2c")));
    let gauges = match Setup::read(&host.at(path), over, bus) {
        Ok(setup) => setup.gauges,
        Err(error) => {
            let why = error.to_string().replace(&*host.at(path).to_string_lossy(), path);
            let why = why.strip_prefix(&format!("{path}: ")).unwrap_or(&why).to_string();
            return problem(path, why, "Correct it; see gaugefs.toml(5).");
        }
    };
    let files = gauges.iter().filter_map(|gauge| gauge.key_file.as_deref());
    key_files.extend(files.map(|file| {
        let below = file.strip_prefix(host.at(FOLDER)).map(|below| Path::new(FOLDER).join(below));
        below.unwrap_or_else(|_| file.to_path_buf())
    }));
    match device.filter(|device| !host.has(device)) {
        Some(device) => {
            warning(path, format!("{device} does not exist"), "Its service starts when the bus appears.")
        }
        None if gauges.len() == 1 => ok(path, "one gauge"),
        None => ok(path, format!("{} gauges", gauges.len())),
    }
}

fn keys(host: &Host, path: &Path) -> Finding {
    let what = path.display().to_string();
    let Ok(status) = fs::metadata(host.at(&what)) else {
        return problem(
            what,
            "this key file does not exist",
            "Create it, or remove key-file from the configuration.",
        );
    };
    let mode = status.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let remedy = format!("As root: chmod 600 {what}");
        return problem(what, format!("others may read the keys (mode {mode:03o})"), remedy);
    }
    ok(what, "only its owner may read it")
}
