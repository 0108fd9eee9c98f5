// SPDX-License-Identifier: MIT

//! The udev rule, the unit, and the state of its instances.

use std::process::Command;

use super::host::Host;
use super::{Finding, ok, problem, warning};

pub(super) fn check(host: &Host, configured: &[String]) -> Vec<Finding> {
    let what = "gaugefs@.service";
    let parts = [("udev/rules.d", "60-gaugefs.rules"), ("systemd/system", what)];
    let missing = parts.iter().find(|(folder, name)| {
        let places = ["/etc", "/run", "/usr/local/lib", "/usr/lib", "/lib"];
        !places.iter().any(|place| host.has(&format!("{place}/{folder}/{name}")))
    });
    match missing {
        Some((_, name)) if !configured.is_empty() => {
            let says = format!("{name} is not installed, so no gauge is mounted automatically");
            return vec![problem(what, says, "Install the package, or copy the files of udev/.")];
        }
        Some(_) => return vec![ok(what, "not installed; gauges are mounted manually")],
        None => {}
    }
    if !host.has("/run/systemd/system") {
        return vec![ok(what, "installed; systemd is not running")];
    }
    let mut systemctl = Command::new("systemctl");
    systemctl.args(["list-units", "--all", "--plain", "--no-legend", "--no-pager", "gaugefs@*"]);
    let listed = match systemctl.output() {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout).into_owned(),
        _ => return vec![warning(what, "systemctl does not answer", "Try: systemctl status")],
    };
    let mut findings: Vec<_> = listed.lines().filter_map(instance).collect();
    for bus in configured {
        // As systemd-escape writes it: a plain dash would mean a slash.
        let unit = format!("gaugefs@{}.service", bus.replace('-', "\\x2d"));
        if host.has(&format!("/dev/{bus}")) && !listed.contains(&unit) {
            let remedy = format!("As root: udevadm trigger /dev/{bus}");
            findings.push(warning(unit, "configured, but not started", remedy));
        }
    }
    if findings.is_empty() {
        findings.push(ok(what, "installed; no bus is configured in /etc/gaugefs"));
    }
    findings
}

/// A line of `systemctl list-units`: unit, load, active, sub, description.
fn instance(line: &str) -> Option<Finding> {
    let mut words = line.split_ascii_whitespace();
    let (unit, _, active, sub) = (words.next()?, words.next()?, words.next()?, words.next()?);
    let says = format!("{active} ({sub})");
    Some(match active {
        "active" => ok(unit, says),
        "inactive" => ok(unit, format!("{says}; start it with: systemctl start '{unit}'")),
        "failed" => {
            let remedy = format!("See why: journalctl -u '{unit}'; then: systemctl restart '{unit}'");
            problem(unit, says, remedy)
        }
        _ => warning(unit, says, format!("If it stays like this: journalctl -u '{unit}'")),
    })
}
