// SPDX-License-Identifier: MIT

//! Mounts, alive or dead, and the holders of gauges.

use std::fs;
use std::path::Path;

use super::host::Host;
use super::{Finding, ok, problem, warning};
use crate::daemon::look::{self, Seen};
use crate::error::shown;
use gauge_bus::regular;
use gauge_owner::lock::{holding, mountpoint_of, process};
use gaugefs_client::mounts::{Mount, parse};

/// Folder in which the services mount.
const PLACE: &str = "/run/gaugefs";
/// Folder in which root's daemons keep journals.
const JOURNALS: &str = "/var/lib/gaugefs";

pub(super) fn check(host: &Host) -> Vec<Finding> {
    let table = regular::read(&host.at("/proc/self/mountinfo"), regular::SYSTEM).unwrap_or_default();
    let all: Vec<_> = parse(&table).collect();
    let gaugefs = all.iter().filter(|mount| mount.is_gaugefs());
    let places: Vec<_> = gaugefs.map(|mount| host.at(&mount.path.to_string_lossy())).collect();
    // Silent daemons are waited for together.
    let mut looks = look::gauges(&places).unwrap_or_default().into_iter();
    let mut findings = Vec::new();
    for (index, mount @ Mount { path, kind, source, .. }) in all.iter().enumerate() {
        let look = mount.is_gaugefs().then(|| looks.next()).flatten();
        let what = shown(path);
        let above = all[index + 1..].iter().find(|above| above.path == *path);
        if !mount.is_gaugefs() {
            if path.starts_with(PLACE) {
                let says = format!("{kind} ({source}) is mounted where the service mounts gauges");
                findings.push(problem(&what, says, format!("Unmount it as root: umount {what}")));
            }
        } else if let Some(Mount { kind, source, .. }) = above {
            let says = format!("a gaugefs is hidden below {kind} ({source})");
            findings.push(warning(&what, says, format!("Unmount what covers it: umount {what}")));
        } else {
            let found = look.map(|(_, found)| found).unwrap_or_default();
            findings.extend(found.gauges.iter().flat_map(
                |Seen { listed, notes, is_owed, wrong, .. }| {
                    let note = |note: &String| {
                        if !is_owed {
                            let remedy = "That is its gauge/last_error, which ends when it is over.";
                            return warning(&listed.gauge, note, remedy);
                        }
                        let remedy =
                            format!("What is known of it, and what to type: gaugefs settle {}", listed.gauge);
                        problem(&listed.gauge, note, remedy)
                    };
                    let remedy = || format!("What shows it, and what to do: gaugefs check {}", listed.gauge);
                    let wrong = wrong.iter().map(|wrong| warning(&listed.gauge, wrong, remedy()));
                    notes.iter().map(note).chain(wrong).collect::<Vec<_>>()
                },
            ));
            findings.push(if found.late {
                let says = "a gaugefs whose process does not answer";
                let remedy = format!(
                    "Find out what stops the process, or remove the mount by force: gaugefs umount {what}"
                );
                problem(&what, says, remedy)
            } else if found.dead == Some(true) {
                let remedy = format!("Unmount it: gaugefs umount {what}");
                problem(&what, "a gaugefs whose process is gone", remedy)
            } else {
                ok(&what, "a gaugefs is mounted there")
            });
        }
    }
    if !all.iter().any(Mount::is_gaugefs) {
        findings.push(ok("mounts", "no gaugefs is mounted"));
    }
    let mounted = |path: &Path| all.iter().any(|mount| mount.path == path && mount.is_gaugefs());
    findings.extend(locks(host, &mounted));
    findings.extend(journals(host));
    findings
}

/// Journals of writes that are in progress or were interrupted, and of owed seals.
fn journals(host: &Host) -> Vec<Finding> {
    let own = format!("{}/.local/state/gaugefs", host.home());
    let folders = if host.is_root() { vec![JOURNALS.to_string()] } else { vec![JOURNALS.to_string(), own] };
    let paths = folders.iter().flat_map(|folder| {
        let ours = |name: &String| [".journal", ".waiting", ".seal"].iter().any(|end| name.ends_with(end));
        host.names(folder).into_iter().filter(ours).map(move |name| format!("{folder}/{name}"))
    });
    let pending = (
        "a write to this gauge is in progress, or was interrupted",
        "Mount the gauge, with its key file if it has one: that settles the write, or gauge/last_error says why \
         not. Keep this file.",
    );
    let waiting = (
        "a write was interrupted, and the pack that was then found may be another one",
        "Keep this file until its pack has come back: what it lacks is settled when its data flash is read. If that pack \
         is lost, or was the one that was found, put the file aside where it is mounted: gaugefs settle GAUGE --discard",
    );
    let seal = (
        "a gauge that was found sealed is being read, or may have been left open",
        "Mount the gauge: that seals it again, or gauge/last_error says why not. Keep this file.",
    );
    let finding = |path: String| {
        let (says, remedy) = match () {
            () if path.ends_with(".waiting") => waiting,
            () if path.ends_with(".seal") => seal,
            () => pending,
        };
        warning(path, says, remedy)
    };
    paths.map(finding).collect()
}

/// Held locks, and whether their holders have mounted the gauge.
fn locks(host: &Host, mounted: &dyn Fn(&Path) -> bool) -> Vec<Finding> {
    let state = format!("{}/.local/state/gaugefs", host.home());
    let folders = [PLACE.into(), JOURNALS.into(), format!("/run/user/{}/gaugefs", host.uid), state];
    let listed = host.text("/proc/locks");
    let (mut findings, mut left) = (Vec::new(), 0);
    for folder in folders {
        for name in host.names(&folder) {
            let Some(key) = name.strip_suffix(".lock") else { continue };
            let path = host.at(&format!("{folder}/{name}"));
            // The list shows it, because trying the lock would take it.
            let Some(pid) = fs::metadata(&path).ok().and_then(|status| holding(&listed, &status)) else {
                left += 1;
                continue;
            };
            let what = format!("lock {key}");
            let who = process(host.root(), pid);
            let file = regular::open(fs::File::options().read(true), &path);
            findings.push(match file.ok().and_then(|mut file| mountpoint_of(&mut file, pid)) {
                None => ok(what, format!("held by {who}")),
                Some(place) if mounted(&place) => {
                    ok(what, format!("held by {who}, mounted at {}", shown(&place)))
                }
                Some(place) => {
                    let says = format!("held by {who}, but nothing is mounted at {}", shown(&place));
                    let remedy = format!("The process is starting or ending; if that takes long: kill {pid}");
                    warning(what, says, remedy)
                }
            });
        }
    }
    if left > 0 {
        findings.push(ok("locks", format!("{left} left over, held by no process; harmless")));
    }
    findings
}
