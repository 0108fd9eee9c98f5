// SPDX-License-Identifier: MIT

//! A mount over the kernel's own supplies: over a folder with links like theirs, and over the real one where the
//! machine allows it.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::RealClock;
use gauge_owner::{self as owner, Run, Signal};
use gauge_sim::{Options, Sim};
use gaugefs::fs::{Access, Covered, Fs, Node, Supply, free_names};
use gaugefs::fuse::{self, Mounted};
use nix::sys::signal::Signal as Kill;
use nix::unistd::geteuid;
use ti_gauge::chip::Chip;

use crate::room::{CHIP, Folder, Foreground, Ran, apart, can_mount, command, gaugefs, run};

/// A folder that resembles `/sys`; each supply is a folder below `devices` and a link to it.
struct Tree(PathBuf);

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = nix::mount::umount2(&self.supplies(), nix::mount::MntFlags::MNT_DETACH);
        let _ = fs::remove_dir_all(&self.0);
    }
}

impl Tree {
    fn new() -> Self {
        let tree = Self(crate::room::folder());
        fs::create_dir_all(tree.supplies()).expect("a temporary folder");
        tree
    }

    fn supplies(&self) -> PathBuf {
        self.0.join("class/power_supply")
    }

    fn device(&self, name: &str) -> PathBuf {
        self.0.join("devices/bus").join(name)
    }

    /// Adds a supply, as a driver does when it has found its device.
    fn bind(&self, name: &str, capacity: &str) {
        fs::create_dir_all(self.device(name)).expect("a folder");
        fs::write(self.device(name).join("capacity"), capacity).expect("a file");
        symlink(format!("../../devices/bus/{name}"), self.underneath(name)).expect("a link");
    }

    fn unbind(&self, name: &str) {
        fs::remove_file(self.underneath(name)).expect("a link");
    }

    /// The folder of supplies below a mount over it; it is opened before the mount.
    fn underneath(&self, name: &str) -> PathBuf {
        self.0.join("underneath").join(name)
    }

    fn keep_underneath(&self) -> fs::File {
        let folder = fs::File::open(self.supplies()).expect("the folder");
        let way = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&folder));
        symlink(way, self.0.join("underneath")).expect("a link");
        folder
    }
}

fn tree_of(names: &[&str], covered: Covered, signal: &Arc<Signal>) -> Fs {
    let clock = Arc::new(RealClock::new());
    let entries = names.iter().map(|name| {
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a simulated chip");
        std::thread::sleep(Duration::from_millis(1300));
        let run = Run { interval: Duration::from_secs(3600), ..Run::default() };
        let chip = Chip::by_name("bq34z100-g1").expect("a chip of the tables");
        let handle = owner::spawn(chip, Box::new(sim.bus()), clock.clone(), run, signal.clone());
        let handle = handle.expect("a gauge");
        Supply::new((*name).into(), handle)
    });
    let access = Access { uid: 0, gid: 0, group: false };
    Fs::new(entries.collect(), access).overlay(Some(covered))
}

/// One gauge, mounted over the supplies of a tree; `None` if this machine cannot mount FUSE.
fn mount(tree: &Tree, name: &str) -> Option<Mounted> {
    if OpenOptions::new().read(true).write(true).open("/dev/fuse").is_err() {
        eprintln!("SKIPPED: /dev/fuse cannot be opened; no test of a mount over the kernel's supplies ran");
        return None;
    }
    let signal = Arc::new(Signal::default());
    let covered = Covered::open(&tree.supplies()).expect("the folder");
    let fs = Arc::new(tree_of(&[name], covered, &signal));
    Some(fuse::mount(fs, &tree.supplies(), fuse::Options::default(), signal).expect("a mount"))
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> = entries
        .map(|entry| {
            let entry = entry.expect("an entry");
            let status = fs::symlink_metadata(entry.path()).expect("what is listed is there");
            assert_eq!(entry.file_type().expect("d_type is there"), status.file_type());
            entry.file_name().into_string().expect("text")
        })
        .collect();
    names.sort();
    names
}

fn free_name(taken: &[String]) -> String {
    let taken = taken.iter().map(String::as_str).collect();
    free_names("BAT", &taken).next().expect("numbers do not run out")
}

/// It would take a day if each name were compared with all others.
#[test]
fn regression_many_gauges_took_the_cube_of_their_number() {
    let free = free_names("BAT", &["BAT1"].into()).take(100_000).last();
    assert_eq!(free.as_deref(), Some("BAT100000"));
    let folder = Folder::new();
    let file = folder.file("gauges.toml");
    let gauges = "[[gauge]]\nsim = 'bq35100'\n".repeat(100_000);
    std::fs::write(&file, format!("[mount]\nmountpoint = 'm'\n{gauges}")).expect("a file");
    let plan = gaugefs(&["mount", "--config", &file, "--check"]).out;
    assert!(plan.lines().count() == 100_000 && plan.contains("/BAT99999 "), "{}", plan.lines().count());
}

#[test]
fn the_kernels_supplies_stay_visible_and_unchanged() {
    let tree = Tree::new();
    let _folder = tree.keep_underneath();
    tree.bind("BAT0", "81\n");
    fs::write(tree.supplies().join("no-link"), "").expect("a file");
    let Some(_mounted) = mount(&tree, "BAT1") else { return };
    assert_eq!(names(&tree.supplies()), ["BAT0", "BAT1"]);
    let link = tree.supplies().join("BAT0");
    let target = "../../devices/bus/BAT0";
    assert_eq!(fs::read_link(&link).expect("a link").to_str(), Some(target));
    assert_eq!(fs::symlink_metadata(&link).expect("a link").len(), target.len() as u64);
    assert_eq!(fs::canonicalize(&link).expect("it leads somewhere"), tree.device("BAT0"));
    assert_eq!(fs::read_to_string(link.join("capacity")).expect("a file"), "81\n");
    assert_eq!(fs::read_to_string(tree.supplies().join("BAT1/present")).expect("a file"), "1\n");
    assert_eq!(fs::remove_file(&link).expect_err("not from here").kind(), ErrorKind::PermissionDenied);
}

/// fusermount3 mounts a folder without a mode. The kernel then has none before its first GETATTR is answered, and drops an
/// answer that a notification overtakes. Root may read a folder without a mode, so this is tried as somebody else.
#[test]
fn regression_the_first_look_of_an_ordinary_user_was_refused() {
    use std::os::unix::process::CommandExt;
    if !nix::unistd::geteuid().is_root() {
        // Then the test below has looked as an ordinary user.
        return;
    }
    let tree = Tree::new();
    let program = tree.0.join("tests");
    let own = std::env::current_exe().expect("the test's own program");
    fs::copy(own, &program).expect("a copy that any user may run");
    let mut command = Command::new(program);
    command.args(["--exact", "--nocapture", "over::the_kernels_supplies_stay_visible_and_unchanged"]);
    let output = command.uid(65534).gid(65534).current_dir("/").output().expect("it runs");
    let text =
        [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    eprint!("{text}");
    assert!(output.status.success() && text.contains("1 passed"));
}

#[test]
fn added_and_removed_supplies_show_at_once() {
    let tree = Tree::new();
    let _folder = tree.keep_underneath();
    let Some(_mounted) = mount(&tree, "BAT1") else { return };
    let link = tree.supplies().join("AC");
    // Each check directly follows a change, and an earlier access has filled any cache there might be.
    for round in 0..20 {
        assert_eq!(names(&tree.supplies()), ["BAT1"]);
        assert_eq!(fs::symlink_metadata(&link).expect_err("not there").kind(), ErrorKind::NotFound);
        tree.bind("AC", &format!("{round}\n"));
        assert_eq!(fs::read_to_string(link.join("capacity")).expect("a file"), format!("{round}\n"));
        assert_eq!(names(&tree.supplies()), ["AC", "BAT1"]);
        // The same name now belongs to another device.
        tree.bind("other", "7\n");
        tree.unbind("other");
        tree.unbind("AC");
        symlink("../../devices/bus/other", tree.underneath("AC")).expect("a link");
        assert_eq!(fs::read_link(&link).expect("a link").to_str(), Some("../../devices/bus/other"));
        assert_eq!(fs::read_to_string(link.join("capacity")).expect("a file"), "7\n");
        tree.unbind("AC");
    }
}

#[test]
fn a_gauge_keeps_its_name_although_the_kernel_uses_it_too() {
    let tree = Tree::new();
    symlink("../../devices/bus/BAT0", tree.supplies().join("BAT0")).expect("a link");
    symlink("../../devices/bus/AC", tree.supplies().join("AC")).expect("a link");
    let covered = Covered::open(&tree.supplies()).expect("the folder");
    let mut found = covered.names();
    found.sort();
    assert_eq!(found, ["AC", "BAT0"]);
    assert_eq!(free_name(&found), "BAT1");
    assert_eq!(free_name(&[]), "BAT0");
    let fs = tree_of(&["BAT0"], covered, &Arc::default());
    let list = fs.list(Node::Root);
    assert_eq!(list.len(), 2, "{list:?}");
    assert!(matches!(fs.lookup(Node::Root, "BAT0"), Some(Node::Of(0, _))));
    let kernels = fs.lookup(Node::Root, "AC").expect("it shows through");
    assert!(list.contains(&("AC".into(), kernels)));
    assert_eq!(fs.target(kernels).as_deref(), Some("../../devices/bus/AC"));
    // A removed name has no inode, and one that is added again has the same inode as before.
    fs::remove_file(tree.supplies().join("AC")).expect("a link");
    assert_eq!((fs.lookup(Node::Root, "AC"), fs.target(kernels)), (None, None));
    symlink("../../devices/bus/other", tree.supplies().join("AC")).expect("a link");
    assert_eq!(fs.lookup(Node::Root, "AC"), Some(kernels));
}

/// Mounts over the real folder, in a mount namespace of its own, so that the rest of the system does not see it.
#[test]
fn the_real_folder_can_be_mounted_over() {
    let supplies = Path::new("/sys/class/power_supply");
    let private = |script: &str| {
        let gaugefs = env!("CARGO_BIN_EXE_gaugefs");
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-euc", script, "sh", gaugefs]).output()
    };
    let able = private("test -d /sys/class/power_supply && test -r /dev/fuse");
    if !nix::unistd::geteuid().is_root() || !able.is_ok_and(|able| able.status.success()) {
        eprintln!("SKIPPED: without root, unshare, FUSE and {supplies:?} nothing was mounted over it");
        return;
    }
    let before = names_of_links(supplies);
    let output = private(
        "cd /
        supplies=/sys/class/power_supply
        $1 mount --sim bq34z100-g1 $supplies
        trap '$1 umount $supplies' EXIT
        ls $supplies
        cat $supplies/BAT*/gauge/seal
        cat $supplies/BAT*/subsystem/BAT*/gauge/seal",
    );
    let output = output.expect("unshare runs");
    assert!(output.status.success(), "{output:?}");
    let mut expected = before.clone();
    expected.push(free_name(&before));
    expected.sort();
    let mut lines: Vec<_> = String::from_utf8_lossy(&output.stdout).lines().map(String::from).collect();
    assert_eq!(lines.split_off(lines.len() - 2), ["sealed", "sealed"]);
    lines.sort();
    assert_eq!(lines, expected);
    assert_eq!(names_of_links(supplies), before);
}

fn names_of_links(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry"));
    entries.map(|entry| entry.file_name().into_string().expect("text")).collect()
}

/// `gaugefs mount` of a simulated gauge there, with more options and variables.
fn mounts(at: &str, more: &[&str], variables: &[(&str, &str)]) -> Ran {
    let mut mount = command(&[&["mount", "--sim", CHIP, at], more].concat());
    run({
        mount.envs(variables.iter().copied());
        mount
    })
}

#[test]
fn regression_a_mount_hid_what_was_in_its_folder() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let full = |name: &str| {
        let at = folder.file(name);
        fs::create_dir(&at).expect("a folder");
        fs::write(format!("{at}/precious"), "").expect("a file");
        at
    };
    let at = full("tree");
    let words = ["not empty", "/precious", "--over", "over = true"];
    mounts(&at, &[], &[]).failed(&words);
    // A dead mount is looked through.
    let dead = Foreground::new(&at, &["--over"]);
    dead.send(Kill::SIGKILL);
    drop(dead);
    mounts(&at, &[], &[]).failed(&words);
    assert!(Path::new(&at).join("precious").exists());
    let unmounts = |at: &str| {
        assert!(Path::new(at).join("BAT0").exists() && !Path::new(at).join("precious").exists(), "{at}");
        gaugefs(&["umount", at]).done();
        assert!(Path::new(at).join("precious").exists(), "{at}");
    };
    mounts(&at, &["--over"], &[]).done();
    unmounts(&at);
    let config = |over: &str| {
        let path = folder.file("packs.toml");
        fs::write(&path, format!("[mount]\nmountpoint = '{at}'\n{over}\n[[gauge]]\nsim = '{CHIP}'\n"))
            .expect("a file");
        path
    };
    let path = config("");
    gaugefs(&["mount", "--config", &path]).failed(&words);
    let checked = gaugefs(&["mount", "--config", &path, "--check"]);
    assert!(
        checked.code == Some(1) && words.iter().all(|word| checked.err.contains(word)),
        "{}",
        checked.err
    );
    gaugefs(&["mount", "--config", &config("over = true")]).done();
    unmounts(&at);
    let supplies = full("power_supply");
    mounts(&supplies, &[], &[]).done();
    unmounts(&supplies);
    // A unit of systemd that was written before goes on, and is told what to write.
    let mut unit = Command::new("sh");
    unit.args(["-c", "SYSTEMD_EXEC_PID=$$ exec \"$@\"", "sh", env!("CARGO_BIN_EXE_gaugefs")]);
    let ran = run({
        unit.args(["mount", "--sim", CHIP, &at]);
        unit
    });
    assert!(
        ran.code == Some(0) && ran.err.contains("warning: ") && ran.err.contains("over = true"),
        "{}",
        ran.err
    );
    unmounts(&at);
    mounts(&at, &[], &[("SYSTEMD_EXEC_PID", "1")]).failed(&words);
}

/// A process of another user, with a mount namespace that was made before the mount, which removes that folder when told to.
fn attacker(folder: &str) -> Child {
    let mut child = Command::new("unshare");
    child.args([
        "--user",
        "--map-root-user",
        "--mount",
        "sh",
        "-c",
        "echo ready; read -r _; rmdir -- \"$0\"",
        folder,
    ]);
    child.uid(NOBODY).gid(NOBODY).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = child.spawn().expect("unshare runs");
    let mut ready = [0; 5];
    let _ = child.stdout.as_mut().expect("a pipe").read_exact(&mut ready);
    child
}

const NOBODY: u32 = 65534;

#[test]
fn regression_another_user_took_roots_mount_away() {
    if !can_mount() || !geteuid().is_root() {
        eprintln!("SKIPPED: only root's mounts are kept from other users");
        return;
    }
    // The namespaces of the attackers are copies of this one.
    apart();
    let folder = Folder::new();
    let made = |name: &str, mode: u32, owner: u32| {
        let path = folder.file(name);
        fs::create_dir(&path).expect("a folder");
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("its mode");
        chown(&path, Some(owner), Some(owner)).expect("root may");
        path
    };
    fs::set_permissions(folder.file(""), fs::Permissions::from_mode(0o755)).expect("its mode");
    let theirs = made("theirs", 0o755, NOBODY);
    let (open, shared) = (made("open", 0o777, 0), made("shared", 0o1777, 0));
    let inside = |folder: &str| format!("{folder}/tree");
    for at in [theirs.clone(), inside(&theirs)] {
        mounts(&at, &[], &[]).failed(&["belongs to user ", "take away", "/run/gauges"]);
    }
    mounts(&inside(&open), &[], &[]).failed(&[
        "can be written to by other users",
        "take away",
        "/run/gauges",
    ]);
    run(command(&["sim", CHIP, &inside(&theirs)])).failed(&["belongs to user "]);
    assert!(!Path::new(&inside(&theirs)).exists() && !Path::new(&inside(&open)).exists());

    let is_mounted = |at: &str| Path::new(at).join("BAT0").exists();
    let attack = |at: &str, variables: &[(&str, &str)]| {
        let mut attacker = attacker(at);
        mounts(at, &[], variables).done();
        assert!(is_mounted(at));
        drop(attacker.stdin.take());
        attacker.wait().expect("a child").success()
    };
    // Nothing but a folder in which others may remove only what is theirs.
    assert!(!attack(&inside(&shared), &[]) && is_mounted(&inside(&shared)));
    gaugefs(&["umount", &inside(&shared)]).done();
    // Who has called root by sudo may have it in a folder of his own, and then he can do this.
    let sudo = [("SUDO_UID", "65534"), ("SUDO_GID", "65534")];
    if !attack(&inside(&theirs), &sudo) {
        eprintln!("SKIPPED in part: users have no namespaces here, so that there is no attack");
        gaugefs(&["umount", &inside(&theirs)]).done();
    }
}
