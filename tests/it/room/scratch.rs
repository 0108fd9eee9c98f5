// SPDX-License-Identifier: MIT

//! The folders that tests work in. A folder is named after the process that made it, so that the next test can remove
//! what a killed one has left: its mounts, its daemons and the folder.

use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use nix::mount::{MntFlags, MsFlags, mount, umount2};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::commands::{CHIP, LONG, can_mount, command, gaugefs, stop, within};

/// Names of all folders begin so.
const PREFIX: &str = "gaugefs-test-";

/// A new folder.
pub(crate) fn folder() -> PathBuf {
    folder_named("")
}

/// A new folder whose name ends so.
pub(crate) fn folder_named(end: &str) -> PathBuf {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    static SWEPT: Once = Once::new();
    SWEPT.call_once(|| sweep(&std::env::temp_dir()));
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let path = std::env::temp_dir().join(format!("{PREFIX}{}-{count}{end}", std::process::id()));
    fs::create_dir(&path).expect("a temporary folder");
    path
}

/// Whether a process has ended, or its first thread has, because of SIGKILL, and another one waits for what never comes.
fn has_ended(process: &str) -> bool {
    let status = fs::read_to_string(Path::new("/proc").join(process).join("status")).unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("State:\t"))
        .is_none_or(|state| state.starts_with(['Z', 'X']))
}

/// Removes what tests that run no more have left in a folder.
pub(super) fn sweep(parent: &Path) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let process = name.to_str().and_then(|name| name.strip_prefix(PREFIX)?.split('-').next());
        if process.is_some_and(has_ended) {
            remove(&entry.path());
        }
    }
}

/// Removes a folder with the daemons and mounts in it.
pub(crate) fn remove(folder: &Path) {
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let process = entry.file_name().to_str().and_then(|name| name.parse().ok());
        let Some(process) = process.filter(|process| *process != std::process::id() as i32) else { continue };
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let mut words = line.split(|byte| *byte == 0);
        let is_gaugefs = words.next().is_some_and(|program| program.ends_with(b"/gaugefs"));
        if is_gaugefs && words.any(|word| Path::new(std::ffi::OsStr::from_bytes(word)).starts_with(folder)) {
            let _ = kill(Pid::from_raw(process), Signal::SIGKILL);
        }
    }
    for mountpoint in mounts(folder) {
        // With force, so that whoever waits for it waits no longer.
        if umount2(&mountpoint, MntFlags::MNT_DETACH | MntFlags::MNT_FORCE).is_err() {
            let _ = Command::new("fusermount3").args(["-u", "-z"]).arg(&mountpoint).status();
        }
    }
    let _ = fs::remove_dir_all(folder);
}

/// What is mounted in a folder, the latest first.
fn mounts(folder: &Path) -> Vec<PathBuf> {
    let table = fs::read_to_string("/proc/self/mounts").unwrap_or_default();
    let places = table.lines().rev().filter_map(|line| line.split(' ').nth(1));
    places
        .map(|place| PathBuf::from(place.replace("\\040", " ")))
        .filter(|place| place.starts_with(folder))
        .collect()
}

/// A temporary folder. Dropping it unmounts what is mounted in it.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(folder_named(" with spaces"))
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().expect("a path in UTF-8").to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let mut left = Vec::new();
        for name in ["m", "n"].map(|name| self.file(name)) {
            // Whoever looks at all mounts, as `gaugefs doctor` of another test does, uses this one for a moment.
            let (is_there, start) = (|| gaugefs_client::mounts::is_gaugefs(Path::new(&name)), Instant::now());
            while gaugefs(&["umount", &name]).code == Some(0) || is_there() && start.elapsed() < LONG {}
            left.extend(is_there().then_some(name));
        }
        remove(&self.0);
        assert!(left.is_empty() || std::thread::panicking(), "{left:?} was still mounted: what used it?");
    }
}

/// The kernel's list of FUSE connections, where each can be aborted.
pub(crate) struct Connections(pub(crate) PathBuf);

impl Connections {
    /// Mounts it in a folder of its own, which needs root.
    pub(crate) fn mount() -> nix::Result<Self> {
        let folder = Self(folder());
        let kind = Some("fusectl");
        mount(kind, &folder.0, kind, MsFlags::empty(), None::<&str>)?;
        Ok(folder)
    }
}

impl Drop for Connections {
    fn drop(&mut self) {
        let _ = umount2(&self.0, MntFlags::MNT_DETACH);
        let _ = fs::remove_dir(&self.0);
    }
}

#[test]
fn what_a_killed_test_has_left_is_removed() {
    if !can_mount() {
        return;
    }
    let mut ended = Command::new("true").spawn().expect("a process");
    ended.wait().expect("its end");
    // In a folder of its own, where no other test removes it.
    let parent = folder();
    let left = parent.join(format!("{PREFIX}{}-0 with spaces", ended.id()));
    fs::create_dir(&left).expect("a folder");
    let at = |name: &str| left.join(name).to_str().expect("text").to_string();
    // One daemon in the background and one that is stopped.
    assert_eq!(command(&["mount", "--sim", CHIP, &at("m")]).status().expect("gaugefs runs").code(), Some(0));
    let mut daemon =
        command(&["mount", "-f", "--sim", CHIP, &at("n")]).stderr(Stdio::null()).spawn().expect("it");
    within("mounted", || left.join("n/BAT0").exists());
    stop(daemon.id(), &at("n"));
    assert_eq!(mounts(&left).len(), 2);
    sweep(&parent);
    daemon.wait().expect("it was killed");
    assert_eq!((mounts(&left), left.exists()), (Vec::new(), false));
    remove(&parent);
}
