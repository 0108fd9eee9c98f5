// SPDX-License-Identifier: MIT

//! Daemons that do not answer, and files and locks of other users, do not hold up gaugefs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, geteuid};

use super::room::{CHIP, LONG, Ran, command, gaugefs, users_can_mount};

/// A folder that is removed with what is mounted in it.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        Self(crate::room::folder())
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().expect("a path in UTF-8").into()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        crate::room::remove(&self.0);
    }
}

/// A daemon in the foreground.
struct Daemon {
    at: String,
    child: Child,
}

impl Daemon {
    /// `None` without FUSE.
    fn start(at: String) -> Option<Self> {
        Self::with(at, &[])
    }

    /// Starts it with more options; `None` without FUSE.
    fn with(at: String, more: &[&str]) -> Option<Self> {
        if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
            eprintln!("SKIPPED: /dev/fuse cannot be opened; no daemon was stopped");
            return None;
        }
        let mut command = command(&["mount", "--foreground", "--sim", CHIP, &at]);
        command.args(more);
        let child = command.stderr(Stdio::null()).spawn().expect("gaugefs runs");
        let daemon = Self { at, child };
        let start = Instant::now();
        // It serves the mount, too.
        while !daemon.is_mounted() || !Path::new(&daemon.at).join("BAT0/present").exists() {
            assert!(start.elapsed() < LONG, "not mounted");
            std::thread::sleep(Duration::from_millis(20));
        }
        Some(daemon)
    }

    fn is_mounted(&self) -> bool {
        let table = fs::read_to_string("/proc/self/mountinfo").expect("mounts");
        table.lines().any(|line| line.split(' ').nth(4) == Some(&self.at))
    }

    fn send(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it runs");
    }

    fn ends(&mut self) -> bool {
        let start = Instant::now();
        loop {
            match self.child.try_wait().expect("a child") {
                Some(status) => return status.success(),
                None if start.elapsed() > LONG => return false,
                None => std::thread::sleep(Duration::from_millis(20)),
            }
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let flags = nix::mount::MntFlags::MNT_DETACH | nix::mount::MntFlags::MNT_FORCE;
        let _ = nix::mount::umount2(Path::new(&self.at), flags);
    }
}

/// Runs a command that has to end within a time limit; kills it otherwise.
#[track_caller]
fn ended(mut command: Command) -> Ran {
    let what = format!("{command:?}");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it runs");
    let start = Instant::now();
    while child.try_wait().expect("a child").is_none() {
        if start.elapsed() > LONG {
            child.kill().expect("it runs");
            panic!("{what} hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ran::of(child.wait_with_output().expect("it has ended"))
}

#[test]
fn a_stopped_daemon_holds_up_no_other_and_is_removed_by_force() {
    let folder = Folder::new();
    let Some(mut stopped) = Daemon::start(folder.file("stopped")) else { return };
    let (at, other) = (stopped.at.clone(), folder.file("other"));
    crate::room::stop(stopped.child.id(), &stopped.at);
    ended(command(&["mount", "--sim", CHIP, &other])).done();
    ended(command(&["umount", &other])).done();
    ended(command(&["mount", "--sim", CHIP, &at])).failed(&["does not answer", "gaugefs umount"]);
    let inside = format!("{at}/BAT0/gauge/other");
    ended(command(&["mount", "--sim", CHIP, &inside])).failed(&["does not answer"]);
    ended(command(&["umount", &inside])).failed(&["does not answer"]);
    let doctor = ended(command(&["doctor"])).out;
    assert!(doctor.contains(&format!("{at}: a gaugefs whose process does not answer\n")), "{doctor}");
    assert!(doctor.contains(&format!("gaugefs umount {at}\n")), "{doctor}");
    assert!(stopped.is_mounted());
    // A reader that waits for the daemon is released.
    let reader = Command::new("cat").arg(format!("{at}/BAT0/gauge/seal")).stderr(Stdio::null()).spawn();
    let mut reader = reader.expect("cat runs");
    std::thread::sleep(Duration::from_millis(200));
    assert!(reader.try_wait().expect("a child").is_none(), "it does not wait for the daemon");
    ended(command(&["umount", &at])).done();
    assert!(!stopped.is_mounted());
    assert!(!reader.wait().expect("a child").success());
    // The daemon notices once it runs again, and the place is free before that.
    ended(command(&["mount", "--sim", CHIP, &at])).done();
    stopped.send(Signal::SIGCONT);
    assert!(stopped.ends());
    assert!(stopped.is_mounted(), "it has removed the mount of another daemon");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn detach_removes_dead_mounts_beside_a_stopped_one() {
    let folder = Folder::new();
    let Some(stopped) = Daemon::start(folder.file("stopped")) else { return };
    let Some(mut dead) = Daemon::start(folder.file("dead")) else { return };
    if !geteuid().is_root() {
        eprintln!("SKIPPED: without root nothing was detached");
        return;
    }
    crate::room::stop(stopped.child.id(), &stopped.at);
    dead.child.kill().and_then(|()| dead.child.wait()).expect("it ends");
    // In a mount namespace of its own, because it removes the dead mounts of other tests too.
    let mut detach = Command::new("unshare");
    detach.args([
        "--mount",
        "--propagation",
        "private",
        "sh",
        "-c",
        "\"$0\" detach && cat /proc/self/mountinfo",
    ]);
    detach.arg(env!("CARGO_BIN_EXE_gaugefs"));
    let ran = ended(detach);
    let left = ran.out;
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(left.contains(&stopped.at), "{left}");
    assert!(!left.contains(&dead.at), "{left}");
}

/// The lock of root's daemon is not theirs to open.
#[test]
fn another_user_is_refused_with_the_name_of_roots_daemon() {
    if !users_can_mount() {
        return;
    }
    use std::os::unix::process::CommandExt;
    if !geteuid().is_root() {
        eprintln!("SKIPPED: without root there is no other user");
        return;
    }
    let folder = Folder::new();
    let (at, state, program) = (folder.file("m"), folder.file("state"), folder.file("gaugefs"));
    let Some(mut daemon) = Daemon::with(at.clone(), &["--sim-state", &state]) else { return };
    // The program may be in a folder that other users cannot enter.
    fs::copy(env!("CARGO_BIN_EXE_gaugefs"), &program).expect("a copy");
    std::os::unix::fs::chown(&folder.0, Some(65534), Some(65534)).expect("given away");
    let mut other = Command::new(&program);
    other.args(["mount", "--sim", CHIP, "--sim-state", &state, &folder.file("n")]).current_dir("/");
    other.env("XDG_RUNTIME_DIR", folder.file("run")).uid(65534).gid(65534).stdin(Stdio::null());
    let who = format!("in use by process {} (gaugefs of root)", daemon.child.id());
    ended(other).failed(&[&state, &who]);
    let lock = format!("/run/gaugefs/{}.lock", gauge_owner::lock::key_of_state(Path::new(&state)));
    assert!(Path::new(&lock).exists());
    gaugefs(&["umount", &at]).done();
    assert!(daemon.ends());
    assert!(!Path::new(&lock).exists(), "{lock} is left behind");
}

/// A signal ends the process by another way than an unmount does.
#[test]
fn a_daemon_that_a_signal_ends_removes_its_lock() {
    let folder = Folder::new();
    let (at, state) = (folder.file("m"), folder.file("state"));
    let Some(mut daemon) = Daemon::with(at.clone(), &["--sim-state", &state]) else { return };
    let key = format!("{}.lock", gauge_owner::lock::key_of_state(Path::new(&state)));
    let folders =
        ["/run/gaugefs".to_string(), std::env::var("XDG_RUNTIME_DIR").unwrap_or_default() + "/gaugefs"];
    let left = || folders.iter().any(|folder| Path::new(folder).join(&key).exists());
    assert!(left() || !geteuid().is_root());
    // In use, so that the signal detaches it.
    let open = fs::File::open(&at).expect("opens");
    daemon.send(Signal::SIGTERM);
    assert!(daemon.ends());
    drop(open);
    assert!(!left());
}

/// It used to leave a dead mount behind, and end with 1, if it was told to end between the mount and the first answer to
/// a reader.
#[test]
fn regression_a_signal_during_the_mount_leaves_none_behind() {
    if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
        eprintln!("SKIPPED: /dev/fuse cannot be opened; no daemon was ended");
        return;
    }
    let folder = Folder::new();
    std::thread::scope(|scope| {
        for thread in 0..2 {
            let folder = &folder;
            scope.spawn(move || {
                for round in 0..12 {
                    let at = folder.file(&format!("{thread}-{round}"));
                    let mut command = command(&["mount", "--foreground", "--sim", CHIP, &at]);
                    let child = command.stderr(Stdio::null()).spawn().expect("gaugefs runs");
                    let mut daemon = Daemon { at, child };
                    // As soon as it is mounted, or a moment later.
                    while !daemon.is_mounted() {}
                    std::thread::sleep(Duration::from_micros(100 * round));
                    daemon.send(Signal::SIGTERM);
                    assert!(daemon.ends(), "round {round}");
                    assert!(!daemon.is_mounted(), "round {round}");
                    assert!(!Path::new(&daemon.at).exists(), "round {round}");
                }
            });
        }
    });
}

/// Files that another user may have planted in a shared folder.
#[test]
fn what_gaugefs_writes_is_never_a_link_or_a_fifo() {
    let folder = Folder::new();
    let [at, target, link, fifo, state] =
        ["m", "target", "link", "fifo", "state"].map(|name| folder.file(name));
    fs::write(&target, "mine\n").expect("a file");
    std::os::unix::fs::symlink(&target, &link).expect("a link");
    let mkfifo = |path: &str| nix::unistd::mkfifo(path, nix::sys::stat::Mode::S_IRWXU).expect("a FIFO");
    mkfifo(&fifo);
    for option in ["--log", "--trace"] {
        for (path, why) in [(&link, "a symbolic link"), (&fifo, "not a regular file")] {
            let arguments = ["mount", "--foreground", "--sim", CHIP, option, path, &at];
            ended(command(&arguments)).failed(&[path, why]);
        }
    }
    let arguments = ["mount", "--foreground", "--sim", CHIP, "--sim-state", &fifo, &at];
    ended(command(&arguments)).failed(&[&fifo, "not a regular file"]);
    let journal = folder.file(&format!("{}.journal", gauge_owner::lock::key_of_state(Path::new(&state))));
    mkfifo(&journal);
    let arguments =
        ["mount", "--sim", CHIP, "--sim-state", &state, "--state-dir", folder.0.to_str().expect("UTF-8")];
    let mount = ended(command(&[&arguments[..], &[&at]].concat()));
    if mount.code == Some(0) {
        // The gauge can be read, and is not written while its journal cannot be.
        fs::write(format!("{at}/BAT0/df/80/53"), "3100\n").expect_err("no journal can be written");
        // Whether something is owed cannot be known.
        let ran = gaugefs(&["umount", &at]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{}", ran.err);
        let words = [journal.as_str(), "not a regular file", "it is unmounted now"];
        assert!(words.iter().all(|word| ran.err.contains(word)), "{}", ran.err);
    }
    assert_eq!(fs::read_to_string(&target).expect("a file"), "mine\n");
}

/// Ordinary users have no MNT_FORCE. The mount namespace has what a usual machine has: a /dev/fuse for everybody,
/// and the kernel's list of FUSE connections.
const AS_A_USER: &str = r#"
mknod "$1/fuse" c 10 229 && chmod 666 "$1/fuse" && mount --bind "$1/fuse" /dev/fuse
# Where systemd runs, it is mounted already.
grep -q " /sys/fs/fuse/connections " /proc/self/mountinfo || \
    mount -t fusectl none /sys/fs/fuse/connections
user() { exec setpriv --reuid 65534 --regid 65534 --clear-groups -- env XDG_RUNTIME_DIR="$1" "${@:2}"; }
chown 65534:65534 "$1"
(user "$1" "$1/gaugefs" mount --foreground --sim bq34z100-g1 "$1/m") & daemon=$!
until (user "$1" cat "$1/m/BAT0/present") 2>&-; do kill -0 $daemon; sleep 0.05; done
kill -STOP $daemon
# One thread takes the signal, and then stops the others.
while grep -L '^State:.T' /proc/$daemon/task/*/status | grep -q .; do sleep 0.01; done
(user "$1" cat "$1/m/BAT0/gauge/seal") & reader=$!
sleep 0.5
kill -0 $reader
(user "$1" timeout -s KILL 200 "$1/gaugefs" umount "$1/m")
! grep " $1/m " /proc/self/mountinfo
! wait $reader
kill -CONT $daemon
wait $daemon
echo done
"#;

/// With a namespace of processes of its own, none of them outlives the script.
fn in_namespaces() -> Command {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--propagation", "private", "--pid", "--fork", "--kill-child", "--mount-proc"]);
    command
}

#[test]
fn a_user_removes_a_stopped_mount_too() {
    let fuse = fs::File::options().read(true).write(true).open("/dev/fuse");
    let try_it = "fusermount3 -V && setpriv --reuid 65534 --regid 65534 --clear-groups -- true";
    let works = in_namespaces().args(["sh", "-euc", try_it]).output().is_ok_and(|ran| ran.status.success());
    if fuse.is_err() || !geteuid().is_root() || !works {
        eprintln!("SKIPPED: without root, /dev/fuse, fusermount3 and setpriv no other user has mounted");
        return;
    }
    let folder = Folder::new();
    // The program may be in a folder that other users cannot enter.
    fs::copy(env!("CARGO_BIN_EXE_gaugefs"), folder.file("gaugefs")).expect("a copy");
    let mut script = in_namespaces();
    script.args(["bash", "-euc", AS_A_USER, "bash"]).arg(&folder.0);
    let ran = ended(script);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.ends_with("done\n"), "{}{}", ran.out, ran.err);
}
