//! Mounts, alive or dead, and who holds which gauge.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use super::host::Host;
use super::{Finding, ok, problem, warning};
use crate::daemon::mountpoint::{entries, is_dead, ours};
use crate::lock::{Holder, holder};

/// Where the service mounts.
const PLACE: &str = "/run/gaugefs";
/// How long a daemon may take to answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Where root's daemons keep journals.
const JOURNALS: &str = "/var/lib/gaugefs";

pub(super) fn check(host: &Host) -> Vec<Finding> {
    let table = fs::read(host.at("/proc/self/mountinfo")).unwrap_or_default();
    let all: Vec<_> = entries(&table).collect();
    let mut findings = Vec::new();
    for (index, (path, kind, source)) in all.iter().enumerate() {
        let what = path.display().to_string();
        let above = all[index + 1..].iter().find(|(above, ..)| above == path);
        if !ours(kind, source) {
            if path.starts_with(PLACE) {
                let says = format!("{kind} ({source}) is mounted where the service mounts gauges");
                findings.push(problem(&what, says, format!("Unmount it as root: umount {what}")));
            }
        } else if let Some((_, kind, source)) = above {
            let says = format!("a gaugefs is hidden below {kind} ({source})");
            findings.push(warning(&what, says, format!("Unmount what covers it: umount {what}")));
        } else {
            findings.push(match answer(host.at(&what)) {
                Some(Answer::Alive) => ok(&what, "a gaugefs is mounted there"),
                Some(Answer::Dead) => {
                    let remedy = format!("Unmount it: gaugefs umount {what}");
                    problem(&what, "a gaugefs whose process is gone", remedy)
                }
                None => {
                    let says = "a gaugefs whose process does not answer";
                    problem(&what, says, "Find out what stops the process, or kill it.")
                }
            });
        }
    }
    if !all.iter().any(|(_, kind, source)| ours(kind, source)) {
        findings.push(ok("mounts", "no gaugefs is mounted"));
    }
    let mounted = |path: &Path| all.iter().any(|(at, kind, source)| at == path && ours(kind, source));
    findings.extend(locks(host, &mounted));
    findings.extend(journals(host));
    findings
}

enum Answer {
    Alive,
    Dead,
}

/// How the daemon of a mount answers, if it does. A thread asks: one that hangs would block doctor too.
fn answer(path: PathBuf) -> Option<Answer> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || sender.send(if is_dead(&path) { Answer::Dead } else { Answer::Alive }));
    receiver.recv_timeout(PATIENCE).ok()
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
