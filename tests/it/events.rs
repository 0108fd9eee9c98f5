// SPDX-License-Identifier: MIT

//! `gaugefs events`: what a program hears that listens to udev, in a network and a mount namespace of its own. It takes
//! root.

use std::fs::{self, File};
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use gauge_bus::clock::{Clock, RealClock};
use nix::errno::Errno;
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::sockopt::ReceiveTimeout;
use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, setsockopt, socket,
};
use nix::sys::time::{TimeVal, TimeValLike};
use nix::unistd::{Pid, geteuid};

use crate::room::{
    Folder, Foreground, LONG, as_nobody, can_mount, command, drop_copied_mounts, gaugefs, impatient, run,
    stop, within,
};

const SUPPLIES: &str = "/sys/class/power_supply";

/// Runs a test of this file in namespaces of its own, and returns whether this is that run.
fn is_apart(test: &str) -> bool {
    const APART: &str = "GAUGEFS_TEST_APART";
    if std::env::var_os(APART).is_some() {
        drop_copied_mounts();
        return true;
    }
    let apart = |program: &Path, arguments: &[&str]| {
        let mut command = Command::new("unshare");
        command.args(["--mount", "--net"]).arg(program).args(arguments).env(APART, "yes").output()
    };
    let able = apart(Path::new("test"), &["-d", SUPPLIES]).is_ok_and(|able| able.status.success());
    if !geteuid().is_root() || !able || !can_mount() {
        eprintln!("SKIPPED: without root, unshare, FUSE and {SUPPLIES}, {test} did not run");
        return false;
    }
    let own = std::env::current_exe().expect("the test's own program");
    let output = apart(&own, &["--exact", "--nocapture", test]).expect("unshare runs");
    let text =
        [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    eprint!("{text}");
    assert!(output.status.success() && text.contains("1 passed"));
    false
}

/// A listener of udev's messages.
struct Listener(OwnedFd);

impl Listener {
    fn new() -> Self {
        let kind = SockProtocol::NetlinkKObjectUEvent;
        let socket = socket(AddressFamily::Netlink, SockType::Raw, SockFlag::SOCK_CLOEXEC, kind);
        let socket = socket.expect("a socket");
        bind(socket.as_raw_fd(), &NetlinkAddr::new(0, 2)).expect("root may listen");
        Self(socket)
    }

    /// The next message, as `add /class/power_supply/BAT0`; `None` if there is none in this time.
    fn next(&self, limit: Duration) -> Option<String> {
        let limit = TimeVal::microseconds(limit.as_micros().max(1) as i64);
        setsockopt(&self.0, ReceiveTimeout, &limit).expect("a time limit");
        let mut message = [0; 4096];
        let length = match recv(self.0.as_raw_fd(), &mut message, MsgFlags::empty()) {
            Ok(length) => length,
            Err(Errno::EAGAIN) => return None,
            Err(errno) => panic!("{errno}"),
        };
        let (header, properties) = message[..length].split_at(40);
        assert_eq!(&header[..8], b"libudev\0");
        let text = str::from_utf8(properties).expect("text");
        let of = |name: &str| text.split('\0').find_map(|line| line.strip_prefix(name)).expect(name);
        assert_eq!(of("SUBSYSTEM="), "power_supply");
        Some(format!("{} {}", of("ACTION="), of("DEVPATH=")))
    }

    /// Waits for a message, whatever else is told.
    #[track_caller]
    fn hears(&self, wanted: &str) {
        let start = Instant::now();
        let mut heard = Vec::new();
        while start.elapsed() < LONG {
            heard.extend(self.next(Duration::from_millis(100)));
            if heard.last().is_some_and(|last| last == wanted) {
                return;
            }
        }
        panic!("{wanted}: heard only {heard:?}");
    }
}

/// `gaugefs events`, killed when the test ends.
struct Events {
    child: Child,
    _folder: Folder,
    err: String,
}

impl Events {
    fn new() -> Self {
        let folder = Folder::new();
        let err = folder.file("err");
        let mut command = command(&["events"]);
        let command = command.stdout(Stdio::null()).stderr(File::create(&err).expect("a file"));
        Self { child: command.spawn().expect("gaugefs runs"), _folder: folder, err }
    }

    fn says(&self, words: &str) {
        within(words, || fs::read_to_string(&self.err).expect("text").contains(words));
    }

    fn ends(mut self, signal: Signal) -> Option<i32> {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it runs");
        self.child.wait().expect("a child").code()
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn mounted() -> Foreground {
    Foreground::new(SUPPLIES, &["--name", "BAT0", "--ac", "--poll", "0.5"])
}

fn set(knob: &str, value: &str) {
    fs::write(Path::new(SUPPLIES).join("BAT0/sim").join(knob), value).expect("a knob");
}

const ADDED: &str = "add /class/power_supply/BAT0";
const CHANGED: &str = "change /class/power_supply/BAT0";
const REMOVED: &str = "remove /class/power_supply/BAT0";
const AC_ADDED: &str = "add /class/power_supply/AC";
const AC_REMOVED: &str = "remove /class/power_supply/AC";

#[test]
fn listeners_hear_of_changes_and_of_each_way_in_which_a_mount_ends() {
    if !is_apart("events::listeners_hear_of_changes_and_of_each_way_in_which_a_mount_ends") {
        return;
    }
    impatient();
    let listener = Listener::new();
    let events = Events::new();
    events.says("waiting");
    let mut daemon = mounted();
    listener.hears(AC_ADDED);
    listener.hears(ADDED);
    // What was told is told again after 10 s. However busy the machine is, not every change waits for that.
    let mut soonest = Duration::MAX;
    let mut changes = ["40", "60", "20"].into_iter().cycle();
    for number in 0.. {
        if number >= 3 && soonest < Duration::from_secs(8) {
            break;
        }
        assert!(
            number < 40,
            "each change is told only when all is told again, the soonest after {soonest:?}"
        );
        let (soc, start) = (changes.next().expect("it has no end"), Instant::now());
        set("soc", soc);
        listener.hears(CHANGED);
        // Before the first one it is not known when that was.
        soonest = soonest.min(if number == 0 { soonest } else { start.elapsed() });
        let shown = fs::read_to_string(Path::new(SUPPLIES).join("BAT0/capacity")).expect("it has one");
        assert_eq!(shown.trim(), soc);
    }
    // The gauge goes, its mount stays.
    set("power", "off");
    listener.hears(CHANGED);
    set("power", "on");
    listener.hears(CHANGED);
    // Unmounted.
    gaugefs(&["umount", SUPPLIES]).done();
    listener.hears(AC_REMOVED);
    listener.hears(REMOVED);
    assert_eq!(daemon.ends(), Some(0));
    // Killed.
    let daemon = mounted();
    listener.hears(ADDED);
    daemon.send(Signal::SIGKILL);
    listener.hears(REMOVED);
    drop(daemon);
    gaugefs(&["umount", SUPPLIES]).done();
    // Silent, and back.
    let daemon = mounted();
    listener.hears(ADDED);
    stop(daemon.0.id(), SUPPLIES);
    listener.hears(REMOVED);
    events.says("its daemon does not answer");
    daemon.send(Signal::SIGCONT);
    listener.hears(ADDED);
    // The command itself ends.
    assert_eq!(events.ends(Signal::SIGHUP), Some(0));
    listener.hears(REMOVED);
    gaugefs(&["umount", SUPPLIES]).done();
}

#[test]
fn regression_a_mount_that_had_hung_was_not_looked_at_for_nine_times_as_long() {
    if !is_apart("events::regression_a_mount_that_had_hung_was_not_looked_at_for_nine_times_as_long") {
        return;
    }
    impatient();
    let listener = Listener::new();
    let daemon = mounted();
    let _events = Events::new();
    listener.hears(ADDED);
    stop(daemon.0.id(), SUPPLIES);
    // Nine times as long is longer than a message is waited for.
    RealClock::new().sleep(Duration::from_secs(8));
    daemon.send(Signal::SIGCONT);
    listener.hears(REMOVED);
    listener.hears(ADDED);
    daemon.send(Signal::SIGKILL);
    listener.hears(REMOVED);
    drop(daemon);
    gaugefs(&["umount", SUPPLIES]).done();
}

#[test]
fn a_supply_is_told_twice_a_second_at_most() {
    if !is_apart("events::a_supply_is_told_twice_a_second_at_most") {
        return;
    }
    let listener = Listener::new();
    let daemon = mounted();
    let events = Events::new();
    listener.hears(ADDED);
    let start = Instant::now();
    let mut heard = 0;
    for round in 0.. {
        if round >= 60 && heard > 0 {
            break;
        }
        assert!(start.elapsed() < LONG, "nothing is told");
        set("soc", if round % 2 == 0 { "30" } else { "70" });
        let until = Instant::now() + Duration::from_millis(100);
        while let Some(left) = until.checked_duration_since(Instant::now()) {
            heard += u64::from(listener.next(left).is_some_and(|message| message == CHANGED));
        }
    }
    assert!((1..=2 * start.elapsed().as_secs() + 2).contains(&heard), "{heard} in {:?}", start.elapsed());
    assert_eq!(events.ends(Signal::SIGTERM), Some(0));
    drop(daemon);
    gaugefs(&["umount", SUPPLIES]).done();
}

#[test]
fn it_says_what_it_needs() {
    gaugefs(&["events", "/run/gauges"]).failed(&["/run/gauges", "below /sys", SUPPLIES]);
    let folder = Folder::new();
    let needs = ["root with CAP_NET_ADMIN", "sudo", "gaugefs-events"];
    if !geteuid().is_root() {
        gaugefs(&["events"]).failed(&needs);
        return;
    }
    run(as_nobody(&folder, &["events"])).failed(&needs);
    let mut without = Command::new("setpriv");
    without.args([
        "--bounding-set=-net_admin",
        "--inh-caps=-net_admin",
        env!("CARGO_BIN_EXE_gaugefs"),
        "events",
    ]);
    run(without).failed(&needs);
}
