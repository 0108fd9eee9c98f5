// SPDX-License-Identifier: MIT

//! Ends the wait for a mount that its own process served, and that nobody will answer any more.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use gauge_owner::Run;
use gaugefs::fs::Access;
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::minor;
use nix::unistd::gettid;
use ti_gauge::chip::Chip;

use super::commands::{CHIP, LONG, can_mount};
use super::mounted::{Swift, mapped};
use super::scratch::{Connections, Folder, sweep};

/// Aborts the connection of a mount that the test's own process serves, if the test fails or is killed. A thread that waits for
/// such a mount, in a page fault above all, cannot be killed; its process could not end, and nobody would ever answer it.
pub(crate) struct Abort {
    file: PathBuf,
    /// Aborts it when the thread that made this has ended.
    watcher: Child,
    _connections: Option<Connections>,
}

impl Abort {
    /// For a place in a mount. `None` where connections cannot be aborted.
    pub(crate) fn of(place: &Path) -> Option<Self> {
        let number = minor(fs::metadata(place).expect("a mount").dev()).to_string();
        let listed = Path::new("/sys/fs/fuse/connections").join(&number).join("abort");
        let own = if listed.exists() { None } else { Some(Connections::mount().ok()?) };
        let file = own.as_ref().map_or(listed, |own| own.0.join(&number).join("abort"));
        // The first thread of a process remains as a zombie for as long as there are others.
        let waits = r#"while grep -qs "^State:.[^ZX]" "$0"; do sleep 1; done; echo 1 >"$1""#;
        let thread = format!("/proc/{}/task/{}/status", std::process::id(), gettid());
        let mut watcher = Command::new("/bin/sh");
        watcher.args(["-c", waits]).arg(thread).arg(&file);
        // What ends the test, with all processes of its group, does not end this one.
        watcher.process_group(0).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        Some(Self { file, watcher: watcher.spawn().expect("a shell"), _connections: own })
    }

    pub(crate) fn now(&self) {
        let _ = fs::write(&self.file, "1");
    }
}

impl Drop for Abort {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.now();
        }
        let _ = self.watcher.kill();
        let _ = self.watcher.wait();
    }
}

/// Serves a mount, waits for it in page faults, and is killed.
#[test]
#[ignore = "kills its process; a_killed_test_that_waits_for_its_own_mount_ends runs it"]
fn killed_in_a_page_fault() {
    let (chip, folder) = (Chip::by_name(CHIP).expect("a chip"), Folder::new());
    let (uid, gid) = (nix::unistd::geteuid().as_raw(), nix::unistd::getegid().as_raw());
    let access = Access { uid, gid, group: false };
    let mount = Swift::new(chip, folder, Run::default(), access, |_| ());
    let _abort = Abort::of(&mount.root);
    for _ in 0..4 {
        let path = mount.root.join("df/80/53");
        std::thread::spawn(move || {
            loop {
                // A file that may be written has pages of its own each time that it is opened.
                let file = fs::File::open(&path).expect("it is mounted").into();
                let _ = mapped(&file, &nix::unistd::pipe().expect("a pipe"));
            }
        });
    }
    std::thread::sleep(Duration::from_millis(300));
    kill(nix::unistd::getpid(), Signal::SIGKILL).expect("its own process");
}

#[test]
fn a_killed_test_that_waits_for_its_own_mount_ends() {
    if !can_mount() || Connections::mount().is_err() {
        eprintln!("SKIPPED: connections of FUSE cannot be aborted here");
        return;
    }
    for _ in 0..4 {
        let mut killed = Command::new(std::env::current_exe().expect("this program"));
        killed.args(["--ignored", "--exact", "room::abort::killed_in_a_page_fault"]);
        let mut killed = killed.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it runs");
        let start = Instant::now();
        while killed.try_wait().expect("its state").is_none() && start.elapsed() < LONG {
            std::thread::sleep(Duration::from_millis(50));
        }
        let took = start.elapsed();
        // Ends it, if it has not ended by itself.
        sweep(&std::env::temp_dir());
        let signal = killed.wait().expect("its end").signal();
        assert!(took < LONG, "the test that was killed has not ended");
        assert_eq!(signal, Some(Signal::SIGKILL as i32));
    }
}
