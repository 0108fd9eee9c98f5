// SPDX-License-Identifier: MIT

//! SIGHUP, which a terminal sends that is closed: it ends every program as SIGTERM does, and under nohup it does nothing.

use std::fs::{self, File};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

#[cfg(feature = "screen")]
use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

#[cfg(feature = "screen")]
use crate::room::Foreground;
use crate::room::{CHIP, Folder, LONG, STATION, can_mount};

/// A program that runs until it is ended.
struct Program {
    child: Child,
    said: String,
}

impl Program {
    /// Starts it, and waits until it is at work. `nohup` starts it with the signal ignored.
    #[track_caller]
    fn start(folder: &Folder, arguments: &[&str], nohup: bool, is_at_work: &dyn Fn(&str) -> bool) -> Self {
        let said = folder.file("said");
        let file = File::create(&said).expect("a file");
        let mut command = Command::new("sh");
        let line = if nohup { "trap '' HUP; exec \"$@\"" } else { "exec \"$@\"" };
        let program = if arguments[0] == "program" { STATION } else { env!("CARGO_BIN_EXE_gaugefs") };
        command.args(["-c", line, "sh", program]).args(arguments);
        command.stdin(Stdio::null()).stdout(file.try_clone().expect("a file")).stderr(file);
        let mut program = Self { child: command.spawn().expect("a shell"), said };
        let start = Instant::now();
        while !is_at_work(&program.said()) {
            let ended = program.child.try_wait().expect("a child");
            assert!(ended.is_none() && start.elapsed() < LONG, "{arguments:?}: {ended:?} {}", program.said());
            std::thread::sleep(Duration::from_millis(10));
        }
        program
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.said).expect("text")
    }

    fn send(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it runs");
    }

    /// Whether the kernel drops the signal when it comes.
    fn drops(&self, signal: Signal) -> bool {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let is_in = |name: &str| {
            let mask = status.lines().find_map(|line| line.strip_prefix(name)).expect("a mask");
            u64::from_str_radix(mask.trim(), 16).expect("a number") >> (signal as u32 - 1) & 1 == 1
        };
        is_in("SigIgn:") && !is_in("SigBlk:") && !is_in("SigCgt:")
    }

    /// Its exit code, or whether the signal itself has ended it, and what it has said, without the signal's name.
    #[track_caller]
    fn ends(mut self, signal: Signal) -> (Option<i32>, bool, String) {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                break status;
            }
            assert!(start.elapsed() < LONG, "it does not end: {}", self.said());
            std::thread::sleep(Duration::from_millis(10));
        };
        let said = self.said().replace(signal.as_str(), "SIGNAL");
        (status.code(), status.signal() == Some(signal as i32), said)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// How a program ends by SIGTERM, by SIGHUP, and by SIGTERM after a SIGHUP that it was started to ignore.
#[track_caller]
fn check(arguments: &[&str], is_at_work: &dyn Fn(&str) -> bool, remains: &dyn Fn() -> bool) {
    let run = |nohup, signal| {
        let folder = Folder::new();
        let program = Program::start(&folder, arguments, nohup, is_at_work);
        assert_eq!(program.drops(Signal::SIGHUP), nohup, "{arguments:?}");
        if nohup {
            program.send(Signal::SIGHUP);
        }
        program.send(signal);
        let (code, is_killed, said) = program.ends(signal);
        assert!(!remains(), "{arguments:?}: {signal} has left something behind: {said}");
        (code, is_killed, said.contains("SIGHUP"))
    };
    let usual = run(false, Signal::SIGTERM);
    assert_eq!(run(false, Signal::SIGHUP), usual, "{arguments:?}");
    assert_eq!(run(true, Signal::SIGTERM), usual, "{arguments:?} under nohup");
}

#[cfg(feature = "screen")]
fn nothing() -> bool {
    false
}

#[test]
fn regression_a_hangup_left_a_dead_mount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("tree");
    let present = Path::new(&at).join("BAT0/present");
    let is_mounted = || fs::read_to_string("/proc/self/mountinfo").expect("a table").contains(&at);
    check(&["mount", "-f", "--sim", CHIP, &at], &|_| present.exists(), &is_mounted);
    let bus = folder.file("bus");
    check(&["sim", CHIP, &bus], &|said| said.contains(&bus), &|| Path::new(&bus).exists());
}

#[cfg(feature = "screen")]
#[test]
fn what_shows_and_records_ends_by_a_hangup_and_not_under_nohup() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("tree");
    let _mounted = Foreground::new(&at, &["--poll", "0.5"]);
    let gauge = format!("{at}/BAT0");
    let has_said = |said: &str| !said.is_empty();
    check(&["log", &gauge], &has_said, &nothing);
    check(&["watch", &gauge, "capacity<200"], &has_said, &nothing);
    check(&["learn", &gauge], &has_said, &nothing);
    check(&["wait", &gauge, "energy_now>1Wh"], &has_said, &nothing);
    check(&["metrics", "--listen", "127.0.0.1:0", &at], &|said| said.contains("/metrics"), &nothing);
    let page = folder.file("page");
    let is_written = || Path::new(&page).exists();
    let is_kept = || fs::remove_file(&page).is_err();
    check(&["metrics", "-o", &page, "--interval", "0.5", &at], &|_| is_written(), &is_kept);
    check(&["top", "--json", &at], &has_said, &nothing);
}

/// A station of one slot with a counter, and its record.
fn station(folder: &Folder) -> ([String; 2], String) {
    let (image, station) = (folder.file("golden.toml"), folder.file("line.toml"));
    fs::write(&image, format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n"))
        .expect("a file");
    let text = format!(
        "[station]\nserial = 'counter'\nstate-dir = 'state'\n[[gauge]]\nname = 'LEFT'\nsim = '{CHIP}'\nsim-state = '%.flash'\n"
    );
    fs::write(&station, text).expect("a file");
    ([image, station], folder.file("line.jsonl"))
}

/// How often a record has an event.
fn events(record: &str, event: &str) -> usize {
    let text = fs::read_to_string(record).unwrap_or_default();
    text.matches(&format!("\"event\":\"{event}\"")).count()
}

/// A shell and the kernel each send one when a terminal is closed.
#[test]
fn regression_a_hangup_failed_the_packs_of_a_station() {
    let again = [Signal::SIGHUP, Signal::SIGHUP, Signal::SIGTERM];
    for (nohup, signals) in [(false, [Signal::SIGHUP; 3]), (true, again)] {
        let folder = Folder::new();
        let ([image, station], record) = station(&folder);
        let arguments = ["program", "--image", &image, "--station", &station];
        let program = Program::start(&folder, &arguments, nohup, &|_| events(&record, "begun") > 0);
        assert_eq!(program.drops(Signal::SIGHUP), nohup);
        for signal in signals {
            program.send(signal);
            // The kernel keeps one of each kind.
            std::thread::sleep(Duration::from_millis(50));
        }
        let (code, _, said) = program.ends(signals[2]);
        assert_eq!((code, events(&record, "begun"), events(&record, "pass")), (Some(0), 1, 1), "{said}");
    }
}

/// Nothing can be drawn any more, and the pack passes.
#[cfg(feature = "screen")]
#[test]
fn a_station_whose_screen_is_closed_ends_after_its_pack() {
    let folder = Folder::new();
    let ([image, station], record) = station(&folder);
    let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
    let terminal = openpty(&size, None).expect("a terminal");
    let end = || Stdio::from(terminal.slave.try_clone().expect("a terminal"));
    let mut command = Command::new("setsid");
    command.args(["--ctty", STATION, "program", "--screen", "--image", &image]);
    command.args(["--station", &station]).env("TERM", "xterm").stdin(end()).stdout(end()).stderr(end());
    let mut child = command.spawn().expect("setsid runs");
    drop(command);
    let start = Instant::now();
    while events(&record, "begun") == 0 {
        let ended = child.try_wait().expect("a child");
        assert!(ended.is_none() && start.elapsed() < LONG, "{ended:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(terminal);
    let program = Program { child, said: folder.file("golden.toml") };
    program.ends(Signal::SIGHUP);
    assert_eq!((events(&record, "begun"), events(&record, "pass")), (1, 1));
}
