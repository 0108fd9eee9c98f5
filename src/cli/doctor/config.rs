//! `/etc/gaugefs`: whether what the administrator wrote there can be used.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use clap::Parser;
use toml::de::DeTable;

use super::super::{Cli, Command};
use super::host::Host;
use super::{Finding, ok, problem, warning};

const FOLDER: &str = "/etc/gaugefs";

/// The buses that the udev rule starts a service for: `i2c-1` of `i2c-1.conf`.
pub(super) fn buses(host: &Host) -> Vec<String> {
    let names = host.names(FOLDER).into_iter();
    names.filter_map(|name| Some(name.strip_suffix(".conf")?.to_string())).collect()
}

pub(super) fn look(host: &Host) -> Vec<Finding> {
    let (mut findings, mut key_files) = (Vec::new(), Vec::new());
    for name in host.names(FOLDER) {
        let path = format!("{FOLDER}/{name}");
        match name.rsplit_once('.') {
            Some((bus, "conf")) => findings.push(environment(host, &path, bus, &mut key_files)),
            Some((_, "toml")) => findings.push(match DeTable::parse(&host.text(&path)) {
                Ok(_) => ok(path, "can be read"),
                Err(error) => problem(path, error.message(), "Correct it; see gaugefs.toml(5)."),
            }),
            Some((_, "keys")) => key_files.push(path.into()),
            _ => {}
        }
    }
    key_files.sort_unstable();
    key_files.dedup();
    findings.extend(key_files.iter().map(|path: &PathBuf| keys(host, path)));
    findings
}

/// The settings of a bus's service: a line OPTIONS, which is parsed as the service's command line is.
fn environment(host: &Host, path: &str, bus: &str, key_files: &mut Vec<PathBuf>) -> Finding {
    if bus.strip_prefix("i2c-").is_none_or(|number| number.parse::<u32>().is_err()) {
        let says = format!("no bus is called {bus}, so nothing reads it");
        return warning(path, says, "Call it after the bus: i2c-1.conf for /dev/i2c-1.");
    }
    let text = host.text(path);
    let options = text.lines().rev().find_map(|line| line.trim().strip_prefix("OPTIONS="));
    let options = options.unwrap_or_default().trim_matches(['"', '\'']);
    let (device, place) = (format!("/dev/{bus}"), format!("/run/gaugefs/{bus}"));
    let mut words = vec!["gaugefs", "mount", "--foreground", "--bus", &device];
    words.extend(options.split_ascii_whitespace());
    words.push(&place);
    match Cli::try_parse_from(words) {
        Ok(Cli { command: Command::Mount(mount) }) => {
            key_files.extend(mount.gauge.key_file().map(Path::to_path_buf));
        }
        Ok(_) => {}
        Err(error) => {
            let why = error.to_string();
            let why = why.lines().next().unwrap_or_default().trim_start_matches("error: ").to_string();
            return problem(path, why, "Correct OPTIONS; see gaugefs mount --help");
        }
    }
    if !host.has(&device) {
        return warning(path, format!("{device} is not there"), "Its service starts when the bus appears.");
    }
    ok(path, if options.is_empty() { "no options" } else { options })
}

fn keys(host: &Host, path: &Path) -> Finding {
    let what = path.display().to_string();
    let Ok(status) = fs::metadata(host.at(&what)) else {
        return problem(what, "a key file that is not there", "Write it, or take --key-file away.");
    };
    let mode = status.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let remedy = format!("As root: chmod 600 {what}");
        return problem(what, format!("others may read the keys (mode {mode:03o})"), remedy);
    }
    ok(what, "only its owner may read it")
}
