//! Mounts, alive or dead, and who holds which gauge.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::host::Host;
use super::{Finding, ok, problem, warning};
use crate::daemon::look::Look;
use crate::daemon::mountpoint::{Entry, entries, ours};
use crate::lock::{Holder, holder};

/// Where the service mounts.
const PLACE: &str = "/run/gaugefs";
/// Where root's daemons keep journals.
const JOURNALS: &str = "/var/lib/gaugefs";

pub(super) fn check(host: &Host) -> Vec<Finding> {
    let table = fs::read(host.at("/proc/self/mountinfo")).unwrap_or_default();
    let all: Vec<_> = entries(&table).collect();
    // Daemons that do not answer are waited for at the same time.
    let look = |mount: &Entry| Look::begin(&host.at(&mount.path.display().to_string())).ok();
    let looks = all.iter().map(|mount| ours(&mount.kind, &mount.source).then(|| look(mount)).flatten());
    let looks: Vec<_> = looks.collect();
    let mut findings = Vec::new();
    for (index, (Entry { path, kind, source, .. }, look)) in all.iter().zip(looks).enumerate() {
        let what = path.display().to_string();
        let above = all[index + 1..].iter().find(|above| above.path == *path);
        if !ours(kind, source) {
            if path.starts_with(PLACE) {
                let says = format!("{kind} ({source}) is mounted where the service mounts gauges");
                findings.push(problem(&what, says, format!("Unmount it as root: umount {what}")));
            }
        } else if let Some(Entry { kind, source, .. }) = above {
            let says = format!("a gaugefs is hidden below {kind} ({source})");
            findings.push(warning(&what, says, format!("Unmount what covers it: umount {what}")));
        } else {
            let found = look.map(Look::end).unwrap_or_default();
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
    if !all.iter().any(|mount| ours(&mount.kind, &mount.source)) {
        findings.push(ok("mounts", "no gaugefs is mounted"));
    }
    let mounted =
        |path: &Path| all.iter().any(|mount| mount.path == path && ours(&mount.kind, &mount.source));
    findings.extend(locks(host, &mounted));
    findings.extend(journals(host));
    findings
}

/// Journals of writes that are in progress, or were interrupted.
fn journals(host: &Host) -> Vec<Finding> {
    let own = format!("{}/.local/state/gaugefs", host.home());
    let folders = if host.is_root() { vec![JOURNALS.to_string()] } else { vec![JOURNALS.to_string(), own] };
    let paths = folders.iter().flat_map(|folder| {
        let names = host.names(folder).into_iter().filter(|name| name.ends_with(".journal"));
        names.map(move |name| format!("{folder}/{name}"))
    });
    let says = "a write to this gauge is in progress, or was interrupted";
    let remedy = "Mount the gauge, with its key file if it has one: that settles the write, or gauge/last_error says why \
                  not. Keep this file.";
    paths.map(|path| warning(path, says, remedy)).collect()
}

/// Locks that are held, and whether their holders have mounted the gauge.
fn locks(host: &Host, mounted: &dyn Fn(&Path) -> bool) -> Vec<Finding> {
    let uid = host.uid;
    let folders = [PLACE.into(), format!("/run/user/{uid}/gaugefs"), format!("/tmp/gaugefs-{uid}")];
    let (mut findings, mut left) = (Vec::new(), 0);
    for folder in folders {
        for name in host.names(&folder) {
            let Some(key) = name.strip_suffix(".lock") else { continue };
            let path = host.at(&format!("{folder}/{name}"));
            if !is_held(host, &path) {
                left += 1;
                continue;
            }
            let what = format!("lock {key}");
            let found = fs::File::open(&path).ok().and_then(|mut file| holder(&mut file));
            findings.push(match found {
                None => ok(what, "held by a process that is starting or ending"),
                Some(Holder { pid, mountpoint }) if mounted(&mountpoint) => {
                    ok(what, format!("held by process {pid}, mounted at {}", mountpoint.display()))
                }
                Some(Holder { pid, mountpoint }) => {
                    let place = mountpoint.display();
                    let says = format!("held by process {pid}, but nothing is mounted at {place}");
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

/// Whether a process holds the lock. It is looked up, because trying it would take it.
fn is_held(host: &Host, path: &PathBuf) -> bool {
    let Ok(status) = fs::metadata(path) else { return false };
    host.text("/proc/locks").lines().any(|line| {
        let words: Vec<_> = line.split_ascii_whitespace().collect();
        let inode = words.get(5).and_then(|place| place.rsplit(':').next()?.parse().ok());
        words.get(1) == Some(&"FLOCK") && inode == Some(status.ino())
    })
}
