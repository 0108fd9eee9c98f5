// SPDX-License-Identifier: MIT

//! The steps of systemd's units: a daemon that mounts nothing, and `gaugefs attach`, which mounts for it.
//! `gaugefs detach` is tested in tests/boot, because it removes every dead mount, also those of other tests.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, geteuid};

use super::room::{CHIP, Folder, as_nobody, command, gaugefs, open_fuse, root, users_can_mount};
use crate::room;
use crate::room::LONG;

/// A daemon as systemd starts it, which has reported that it is ready.
struct Service {
    folder: PathBuf,
    daemon: Child,
}

impl Service {
    fn start(name: &str) -> Option<Self> {
        let device = fs::File::options().read(true).write(true).open("/dev/fuse");
        if device.is_err() || !geteuid().is_root() {
            eprintln!("SKIPPED: without root and /dev/fuse nothing was attached to a service");
            return None;
        }
        let folder = room::folder_named(&format!("-{name}"));
        let systemd = UnixDatagram::bind(folder.join("notify")).expect("a socket");
        systemd.set_read_timeout(Some(LONG)).expect("a limit");
        let place = folder.join("tree");
        let arguments = ["mount", "--foreground", "--service", "--sim", CHIP, path(&place)];
        let mut daemon = command(&arguments);
        let messages = fs::File::create(folder.join("messages")).expect("a file");
        daemon.env("NOTIFY_SOCKET", folder.join("notify")).stderr(messages);
        let daemon = daemon.spawn().expect("gaugefs runs");
        let mut word = [0; 16];
        let length = systemd.recv(&mut word).expect("it reports that it is ready");
        assert_eq!(&word[..length], b"READY=1");
        Some(Self { folder, daemon })
    }

    fn place(&self) -> PathBuf {
        self.folder.join("tree")
    }

    fn attach(&self) {
        let pid = self.daemon.id().to_string();
        gaugefs(&["attach", "--pid", &pid, "--sim", CHIP, path(&self.place())]).done();
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.daemon.id() as i32), signal).expect("it runs");
    }

    fn messages(&self) -> String {
        fs::read_to_string(self.folder.join("messages")).expect("text")
    }

    /// Its exit code and its messages.
    fn ended(&mut self) -> (Option<i32>, String) {
        (self.daemon.wait().expect("it ends").code(), self.messages())
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
        gaugefs(&["umount", path(&self.place())]);
        room::remove(&self.folder);
    }
}

fn path(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

#[test]
fn a_service_is_mounted_by_attach() {
    let Some(mut service) = Service::start("mounted") else { return };
    assert!(!service.place().exists(), "the daemon created the folder");
    service.attach();
    let gauge = service.place().join("BAT0");
    let voltage = gauge.join("voltage_now");
    assert_ne!(fs::read_to_string(&voltage).expect("a voltage"), "");
    let status = fs::metadata(&voltage).expect("a file");
    assert_eq!((status.uid(), status.gid()), (0, 0));
    let table = fs::read_to_string("/proc/self/mountinfo").expect("mounts");
    let line = table.lines().find(|line| line.contains(path(&service.place()))).expect("a mount");
    for word in [
        "nosuid,nodev,noexec",
        "fuse.gaugefs gaugefs",
        "user_id=0,group_id=0,default_permissions,allow_other",
    ] {
        assert!(line.contains(word), "`{word}` is not in: {line}");
    }
    // Unmounted from outside, it ends as any daemon does.
    gaugefs(&["umount", path(&service.place())]).done();
    assert_eq!(service.ended().0, Some(0));
}

#[test]
fn a_stopped_service_finishes_its_write_and_begins_no_other() {
    let Some(mut service) = Service::start("ends") else { return };
    service.attach();
    let gauge = service.place().join("BAT0");
    // Slow flash, so that the signal arrives during the write.
    fs::write(gauge.join("sim/word_ms"), "150").expect("a knob");
    let parameter = gauge.join("df/80/53");
    let first = parameter.clone();
    let writer = thread::spawn(move || fs::write(first, "3100\n"));
    let start = Instant::now();
    while fs::read_to_string(gauge.join("sim/seal")).is_ok_and(|seal| seal == "sealed\n") {
        assert!(start.elapsed() < LONG && !writer.is_finished(), "the write has not begun");
    }
    service.signal(Signal::SIGTERM);
    while !service.messages().contains("SIGTERM: ending") {
        assert!(start.elapsed() < LONG, "it does not end");
        thread::sleep(Duration::from_millis(10));
    }
    // It refuses other writes right after this message.
    thread::sleep(Duration::from_millis(300));
    // The daemon still answers, but accepts no other write.
    let second = thread::spawn(move || fs::write(parameter, "3200\n"));
    writer.join().expect("no panic").expect("written");
    let refused = second.join().expect("no panic").expect_err("the daemon is ending");
    assert_eq!(refused.raw_os_error(), Some(nix::errno::Errno::EAGAIN as i32));
    let (code, messages) = service.ended();
    assert_eq!(code, Some(0), "{messages}");
    assert_eq!(messages.matches("written and verified").count(), 1, "{messages}");
    assert!(messages.contains("SIGTERM: ending"), "{messages}");
}

#[test]
fn only_a_service_can_be_attached_to() {
    let Some(service) = Service::start("strangers") else { return };
    let mut stranger = Command::new("sleep").arg("60").spawn().expect("sleep runs");
    let attach = |pid: &str| gaugefs(&["attach", "--pid", pid, "--sim", CHIP, path(&service.place())]);
    attach(&stranger.id().to_string()).failed(&["has not opened /dev/fuse"]);
    stranger.kill().and_then(|()| stranger.wait()).expect("it ends");
    attach("0").failed(&["process 0"]);
    assert!(!service.place().exists());
    service.signal(Signal::SIGTERM);
}

/// What a unit runs before its daemon: systemd's copy of a key file does not show who may read the original.
#[test]
fn the_key_file_of_a_service_is_refused_if_others_may_read_it() {
    let folder = room::folder();
    let keys = folder.join("i2c-1.keys");
    let check = || gaugefs(&["check-keys", path(&keys)]);
    assert_eq!(check().done(), "", "a service needs no keys");
    fs::write(&keys, "unseal = 0414 3672\n").expect("a file");
    for (mode, others) in [(0o600, false), (0o400, false), (0o644, true), (0o640, true), (0o602, true)] {
        fs::set_permissions(&keys, fs::Permissions::from_mode(mode)).expect("its mode");
        match others {
            true => check().failed(&[path(&keys), "others may read the key file", "chmod 600"]),
            false => assert_eq!(check().done(), ""),
        }
    }
    if geteuid().is_root() {
        fs::set_permissions(&keys, fs::Permissions::from_mode(0o600)).expect("its mode");
        std::os::unix::fs::chown(&keys, Some(65534), None).expect("given away");
        check().failed(&[path(&keys), "belongs to user 65534"]);
    }
    fs::remove_file(&keys).expect("it is there");
    nix::unistd::mkfifo(&keys, nix::sys::stat::Mode::S_IRWXU).expect("a FIFO");
    check().failed(&[path(&keys), "not a file"]);
    fs::remove_dir_all(&folder).expect("it was made here");
}

/// The administrator knows the file in /etc, not systemd's copy, and not an option of a command line.
#[test]
fn messages_about_keys_name_the_file_of_the_service() {
    if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
        eprintln!("SKIPPED: /dev/fuse cannot be opened; no service had keys");
        return;
    }
    let folder = room::folder();
    let at = folder.join("m");
    let mount = |keys: &str| {
        fs::write(folder.join("gaugefs-keys"), keys).expect("a credential");
        let mut command = command(&["mount", "--sim", CHIP, path(&at)]);
        command.env("CREDENTIALS_DIRECTORY", &folder).env("GAUGEFS_KEYS", "/etc/gaugefs/i2c-1.keys");
        command.output().expect("gaugefs runs")
    };
    let said = String::from_utf8(mount("unseal = 04\n").stderr).expect("text");
    assert!(said.starts_with("gaugefs: /etc/gaugefs/i2c-1.keys: line 1: "), "{said}");
    assert!(mount("unseal = 1111 2222\n").status.success());
    let gauge = at.join("BAT0");
    let written = fs::write(gauge.join("df/80/53"), "3100\n");
    let said = fs::read_to_string(gauge.join("gauge/last_error")).expect("text");
    gaugefs(&["umount", path(&at)]).done();
    fs::remove_dir_all(&folder).expect("it was made here");
    written.expect_err("the key is wrong");
    assert!(said.contains("put the right one into /etc/gaugefs/i2c-1.keys"), "{said}");
    assert!(!said.contains("--key-file"), "{said}");
}

/// Sets of system calls, in each of systemd's the ones that it consists of; `None` without systemd's lists.
type Sets = Vec<(String, BTreeSet<String>)>;

fn sets(word: &str) -> Option<Sets> {
    if !word.starts_with('@') {
        return Some(vec![(word.into(), [word.into()].into())]);
    }
    let lists = Command::new("systemd-analyze").args(["--no-pager", "syscall-filter", word]).output();
    let lists = lists.ok().filter(|output| output.status.success())?.stdout;
    let lists = String::from_utf8(lists).expect("text");
    let names =
        lists.lines().skip(1).map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let (others, calls): (Vec<_>, Vec<_>) = names.partition(|name| name.starts_with('@'));
    let mut all = vec![(word.to_string(), calls.into_iter().map(str::to_string).collect())];
    for other in others {
        all.append(&mut sets(other)?);
    }
    Some(all)
}

/// What the filter of a unit allows, line by line as systemd reads it.
fn allowed(unit: &str) -> Option<Sets> {
    let mut allowed = Sets::new();
    for line in unit.lines().filter_map(|line| line.strip_prefix("SystemCallFilter=")) {
        let (words, is_refused) = line.strip_prefix('~').map_or((line, false), |words| (words, true));
        for word in words.split(' ') {
            let mut named = sets(word)?;
            match is_refused {
                false => allowed.append(&mut named),
                true => allowed.iter_mut().for_each(|(_, calls)| {
                    calls.retain(|call| named.iter().all(|(_, refused)| !refused.contains(call)));
                }),
            }
        }
    }
    Some(allowed)
}

/// A service under strace is used as a mount is. Each of its system calls is allowed by the filter of its unit, and of each
/// set of calls that the filter allows some are used: what nobody needs is refused.
#[test]
fn the_system_call_filter_allows_what_a_service_needs_and_no_other_set() {
    let unit = include_str!("../../udev/service.conf");
    let is_there = Command::new("strace").arg("-V").output().is_ok() && geteuid().is_root();
    let Some(allowed) = allowed(unit).filter(|_| is_there && users_can_mount()) else {
        eprintln!("SKIPPED: it needs root, a mount as another user, strace and systemd-analyze");
        return;
    };
    let folder = Folder::new();
    open_fuse(&folder);
    let [config, log, pid, state] = ["config", "log", "pid", "state"].map(|name| folder.file(name));
    let tree = folder.file("m");
    fs::create_dir(&state).expect("a folder");
    std::os::unix::fs::chown(&state, Some(65534), Some(65534)).expect("given away");
    let image = root().join("tests/it/images/pack.toml");
    let profile = folder.file("profile.toml");
    let named = format!("mountpoint = '{tree}'\nstate-dir = '{state}'");
    let choose = format!(
        "[[gauge.choose]]\ncommand = ['/usr/bin/timeout', '4', 'sh', '-c', 'echo atl | cat']\npack-by-text = true\nprofile = '{profile}'"
    );
    let text =
        format!("[mount]\n{named}\n[[gauge]]\nsim = '{CHIP}'\n[[gauge]]\nsim = 'bq27441-g1'\n{choose}\n");
    fs::write(&config, text).expect("a configuration");
    fs::copy(&image, &profile).expect("a profile");
    let systemd = UnixDatagram::bind(folder.file("notify")).expect("a socket");
    fs::set_permissions(folder.file("notify"), fs::Permissions::from_mode(0o666)).expect("its mode");
    systemd.set_read_timeout(Some(LONG)).expect("a limit");

    let daemon = as_nobody(&folder, &[]);
    fs::set_permissions(folder.file(""), fs::Permissions::from_mode(0o1777)).expect("its mode");
    let mut traced = Command::new("strace");
    traced.args(["-f", "-qq", "-o", &log, "sh", "-c", "echo $$ >\"$0\"; exec \"$@\"", &pid]);
    traced.arg(daemon.get_program()).args(["mount", "-f", "--service", "--config", &config]);
    traced.env("NOTIFY_SOCKET", folder.file("notify"));
    {
        use std::os::unix::process::CommandExt;
        traced.uid(65534).gid(65534).stderr(fs::File::create(folder.file("messages")).expect("a file"));
    }
    let mut traced = traced.spawn().expect("strace runs");
    let ready = systemd.recv(&mut [0; 16]);
    let messages = || fs::read_to_string(folder.file("messages")).unwrap_or_default();
    ready.unwrap_or_else(|error| panic!("it is not ready: {error}: {}", messages()));
    let pid = fs::read_to_string(&pid).expect("its number").trim().to_string();
    gaugefs(&["attach", "--pid", &pid, "--config", &config]).done();
    let gauge = format!("{tree}/BAT0");
    let used = || -> std::io::Result<()> {
        fs::read_to_string(format!("{gauge}/df/index"))?;
        fs::write(format!("{gauge}/df/80/53"), "3100\n")?;
        fs::read_dir(format!("{gauge}/df/by-name"))?.count();
        Ok(())
    };
    let outcome = used();
    let image = gaugefs(&["import", "--exclude", "serial", &format!("{tree}/BAT1"), path(&image)]);
    let report = gaugefs(&["report", &gauge, "-o", &folder.file("report")]);
    let number: i32 = pid.parse().expect("a number");
    kill(Pid::from_raw(number), Signal::SIGTERM).expect("it runs");
    let ended = traced.wait();
    gaugefs(&["umount", &tree]);
    outcome.unwrap_or_else(|error| panic!("{error}: {}", messages()));
    assert!(ended.is_ok_and(|status| status.success()), "{}", messages());
    assert!(matches!(image.code, Some(0 | 3)), "{}", image.err);
    report.done();

    let log = fs::read_to_string(log).expect("the calls");
    // Those before are the shell's.
    let own = log.rsplit_once("\"mount\", \"-f\", \"--service\"").expect("the program was started").1;
    let called = own.lines().filter_map(|line| line.split_once(' ')?.1.trim().split_once('('));
    let used: BTreeSet<&str> = called
        .map(|(name, _)| name)
        .filter(|name| name.chars().all(|one| one.is_ascii_alphanumeric() || one == '_'))
        .collect();
    assert!(used.len() > 40, "{used:?}");
    let is_allowed = |call: &&&str| allowed.iter().any(|(_, calls)| calls.contains(**call));
    let refused: Vec<_> = used.iter().filter(|call| !is_allowed(call)).collect();
    assert!(refused.is_empty(), "the filter refuses {refused:?}");
    // Single calls are also for other processors, and for programs that the daemon starts.
    let sets = allowed.iter().filter(|(set, calls)| set.starts_with('@') && !calls.is_empty());
    let is_used = |calls: &BTreeSet<String>| calls.iter().any(|call| used.contains(call.as_str()));
    let needless: Vec<_> = sets.filter(|(_, calls)| !is_used(calls)).map(|(set, _)| set).collect();
    assert!(needless.is_empty(), "nothing of {needless:?} is used by {used:?}");
}
