// SPDX-License-Identifier: MIT

//! `gaugefs top`, `log` and `plot` on mounted gauges, and on a terminal.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::{Value, json};

use super::golden;
use crate::room::{
    CHIP, Folder, Foreground, LONG, can_mount, command, gaugefs, impatient, read, stop, within,
};

/// `gaugefs top` on a terminal of its own.
struct Screen {
    child: Child,
    keys: File,
    terminal: OwnedFd,
    shown: Arc<Mutex<vt100::Parser>>,
    settings: String,
}

fn stty(terminal: &OwnedFd, arguments: &[&str]) -> String {
    let terminal = terminal.try_clone().expect("a terminal");
    let output = Command::new("stty").args(arguments).stdin(terminal).output().expect("stty runs");
    String::from_utf8(output.stdout).expect("text")
}

impl Screen {
    fn new(arguments: &[&str]) -> Self {
        let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
        let pty = openpty(&size, None).expect("a terminal");
        let settings = stty(&pty.slave, &["-g"]);
        let end = || Stdio::from(pty.slave.try_clone().expect("a terminal"));
        let child = Command::new("setsid")
            .args(["--ctty", env!("CARGO_BIN_EXE_gaugefs"), "top"])
            .args(arguments)
            .env("TERM", "xterm")
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn()
            .expect("setsid runs");
        let shown = Arc::new(Mutex::new(vt100::Parser::new(24, 80, 0)));
        let mut master = File::from(pty.master);
        let keys = master.try_clone().expect("a terminal");
        let parser = shown.clone();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = master.read(&mut bytes) {
                parser.lock().expect("a screen").process(&bytes[..count]);
            }
        });
        Self { child, keys, terminal: pty.slave, shown, settings }
    }

    fn text(&self) -> String {
        self.shown.lock().expect("a screen").screen().contents()
    }

    #[track_caller]
    fn shows(&self, what: &str) {
        let start = Instant::now();
        while !self.text().contains(what) {
            assert!(start.elapsed() < LONG, "`{what}` is not on the screen:\n{}", self.text());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("keys are taken");
    }

    fn resize(&self, rows: u16, columns: u16) {
        self.shown.lock().expect("a screen").screen_mut().set_size(rows, columns);
        stty(&self.terminal, &["rows", &rows.to_string(), "cols", &columns.to_string()]);
    }

    fn send(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it runs");
    }

    /// Everything is as the shell left it: main screen, cursor, echo and all other settings.
    #[track_caller]
    fn is_restored(&self) {
        within("the terminal is restored", || {
            let shown = self.shown.lock().expect("a screen");
            !shown.screen().alternate_screen() && !shown.screen().hide_cursor()
        });
        assert_eq!(stty(&self.terminal, &["-g"]), self.settings);
    }

    #[track_caller]
    fn ends(&mut self) {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                break status;
            }
            assert!(start.elapsed() < LONG, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        };
        assert_eq!(status.code(), Some(0), "{}", self.text());
        self.is_restored();
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn top_can_be_used_and_quit() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    let mut screen = Screen::new(&[&at]);
    screen.shows("bq34z100-G1");
    screen.shows("voltage in V, last 5 min");
    screen.press("i+");
    screen.shows("current in A, last 15 min");
    fs::write(format!("{at}/BAT0/sim/load_ma"), "700").expect("a knob");
    screen.shows("-0.700");
    screen.shows("Discharging");
    screen.press("l");
    screen.shows("passed charge");
    screen.resize(10, 40);
    screen.shows("? help");
    screen.resize(50, 132);
    screen.shows("d data flash");
    screen.press("?");
    screen.shows("read the learned values from data flash, once");
    fs::write(format!("{at}/BAT0/sim/power"), "off").expect("a knob");
    screen.shows("absent");
    screen.press("q");
    screen.ends();

    // A signal, a stop and a continuation.
    let mut screen = Screen::new(&[&at]);
    screen.shows("GAUGE");
    let state = || {
        let stat = fs::read_to_string(format!("/proc/{}/stat", screen.child.id())).expect("a process");
        stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().next()).map(str::to_string)
    };
    screen.send(Signal::SIGTSTP);
    within("it stops", || state().as_deref() == Some("T"));
    screen.is_restored();
    screen.send(Signal::SIGCONT);
    within("it is back", || screen.shown.lock().expect("a screen").screen().alternate_screen());
    screen.shows("GAUGE");
    screen.send(Signal::SIGTERM);
    screen.ends();
}

#[test]
fn top_reports_a_mount_that_hangs_and_one_that_ends() {
    impatient();
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &[]);
    let mut screen = Screen::new(&[&at]);
    screen.shows("bq34z100-G1");
    stop(daemon.0.id(), &at);
    screen.shows("no answer for");
    screen.press("q");
    screen.ends();

    daemon.send(Signal::SIGCONT);
    let mut screen = Screen::new(&[&at]);
    screen.shows("bq34z100-G1");
    daemon.send(Signal::SIGKILL);
    daemon.ends();
    screen.shows("its daemon has died");
    gaugefs(&["umount", &at]).done();
    screen.shows("not mounted");
    screen.press("q");
    screen.ends();
}

/// Watching a sealed gauge causes no transfer until a key asks for data flash.
#[test]
fn top_leaves_a_sealed_gauge_alone() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    // After the first two polls there are no more during this test.
    gaugefs(&["mount", "--sim", CHIP, "--poll", "3600", &at]).done();
    let statistic =
        |name: &str| read(&at, &format!("BAT0/gauge/statistics/{name}")).parse::<u64>().expect("a number");
    within("two polls", || statistic("polls") == 2);
    let transfers = statistic("transfers");

    let out = gaugefs(&["top", "--json", "--interval", "0.1", "--count", "5", &at]).done();
    assert_eq!(out.lines().count(), 5);
    let mut screen = Screen::new(&[&format!("{at}/BAT0"), "--interval", "0.1"]);
    screen.shows("bq34z100-G1");
    screen.press("l");
    screen.shows("sealed: not read");
    screen.shows("grid number");
    let asked = Instant::now();
    within("some time", || asked.elapsed() > Duration::from_secs(2));
    assert_eq!((statistic("transfers"), statistic("polls")), (transfers, 2));
    assert_eq!(read(&at, "BAT0/gauge/seal"), "sealed");

    screen.press("d");
    screen.shows("Update Status");
    screen.shows("Qmax Cell 0");
    assert_eq!(read(&at, "BAT0/gauge/seal"), "sealed");
    let once = statistic("transfers");
    assert!(once > transfers);
    let asked = Instant::now();
    within("some time", || asked.elapsed() > Duration::from_secs(2));
    assert_eq!(statistic("transfers"), once, "it was read once");
    screen.press("q");
    screen.ends();

    // An unsealed gauge is read without a key press.
    fs::write(format!("{at}/BAT0/gauge/seal"), "unsealed").expect("the default key fits");
    let mut screen = Screen::new(&[&at]);
    screen.shows("unsealed");
    screen.press("l");
    screen.shows("Update Status");
    screen.press("r");
    within("a poll", || statistic("polls") == 3);
    assert_eq!(read(&at, "BAT0/gauge/seal"), "unsealed");
    screen.press("q");
    screen.ends();
}

#[test]
fn top_says_that_there_is_no_key_for_a_sealed_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--no-default-keys", &at]).done();
    let mut screen = Screen::new(&[&at]);
    screen.shows("bq34z100-G1");
    screen.press("d");
    screen.shows("sealed: no key");
    screen.press("q");
    screen.ends();
}

#[test]
fn top_prints_json_until_its_reader_closes_the_pipe() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let passed = Path::new(&at).join("BAT0/gauge/registers/passed_charge");
    within("the second poll", || passed.exists());
    let out = gaugefs(&["top", "--json", "--interval", "0.1", "--count", "2", &at]).done();
    for line in out.lines() {
        let sample: Value = serde_json::from_str(line).expect("JSON");
        for (pointer, value) in [
            ("/gauge", json!(format!("{at}/BAT0"))),
            ("/name", json!("BAT0")),
            ("/voltage_now", json!(3_855_000)),
            ("/status", json!("Not charging")),
            ("/bits/flags", json!(["CHG", "OCVTAKEN"])),
            ("/registers/passed_charge", json!(0)),
            ("/seal", json!("sealed")),
            ("/last_error", json!("")),
        ] {
            assert_eq!(sample.pointer(pointer), Some(&value), "{pointer} in {line}");
        }
        assert!(sample["time"].is_string() && sample["age_ms"].is_u64(), "{line}");
    }
    // The reader takes a few bytes and closes the pipe.
    let mut child = command(&["top", "--json", "--interval", "0.1", &at])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("gaugefs runs");
    let mut first = [0; 10];
    child.stdout.take().expect("a pipe").read_exact(&mut first).expect("a line");
    let output = child.wait_with_output().expect("it ends");
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), &b""[..]));

    gaugefs(&["top", "--json", &folder.file("none")]).failed(&["none: not mounted"]);
    gaugefs(&["top", &at]).failed(&["not a terminal", "--json"]);
}

/// A mount of so many simulated gauges, which are polled twice and then no more.
fn mounted_many(folder: &Folder, gauges: usize) -> String {
    let (at, file) = (folder.file("m"), folder.file("many.toml"));
    let text = "[defaults]\npoll = 3600\n".to_string() + &"[[gauge]]\nsim = 'bq34z100-g1'\n".repeat(gauges);
    fs::write(&file, text).expect("a file");
    gaugefs(&["mount", "--config", &file, &at]).done();
    at
}

#[test]
fn regression_a_count_is_of_each_gauge_of_a_mount() {
    if !can_mount() {
        return;
    }
    const GAUGES: usize = 9;
    let folder = Folder::new();
    let at = mounted_many(&folder, GAUGES);
    for count in [1, 2] {
        let count_text = count.to_string();
        let out = gaugefs(&["top", "--json", "--interval", "0.1", "--count", &count_text, &at]).done();
        let mut gauges: Vec<_> = out
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).expect("JSON")["name"].to_string())
            .collect();
        gauges.sort();
        let each: Vec<_> = gauges.chunk_by(|one, next| one == next).map(<[_]>::len).collect();
        assert_eq!(each, [count; GAUGES], "{out}");
    }
    // One gauge's learning is shown, not that of whichever comes first.
    gaugefs(&["learn", "--once", &at]).failed(&["more than one gauge"]);
}

#[test]
fn learn_says_what_a_cycle_waits_for() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "3600", &at]).done();
    let gauge = format!("{at}/BAT0");
    let file = |name: &str| format!("{gauge}/{name}");
    let transfers = || read(&at, "BAT0/gauge/statistics/transfers");
    // The second poll follows the first after half a second, whatever the interval.
    within("the second poll", || read(&at, "BAT0/gauge/statistics/polls") != "1");
    let before = transfers();
    let ran = gaugefs(&["learn", "--once", &gauge]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(4), ""), "{}", ran.out);
    assert!(
        ran.out.contains("waits for IT_ENABLE") && ran.out.contains("disqualified since before"),
        "{}",
        ran.out
    );
    assert_eq!(transfers(), before, "it causes no bus traffic");

    fs::write(file("gauge/poll_interval"), "0.5").expect("an interval");
    fs::write(file("gauge/seal"), "unsealed").expect("the default key fits");
    fs::write(file("gauge/control"), "IT_ENABLE").expect("a subcommand");
    within("a poll", || read(&at, "BAT0/gauge/control_status").contains("QEN"));
    let ran = gaugefs(&["learn", "--once", "--json", &gauge]);
    assert_eq!(ran.code, Some(3), "{}", ran.out);
    let state: Value = serde_json::from_str(&ran.out).expect("JSON");
    for (pointer, value) in [
        ("/gauge", json!(gauge)),
        ("/bits", json!("VOK -RUP_DIS QEN")),
        ("/phase", json!("resting")),
        ("/temperature", json!(25.0)),
        ("/qualified", json!(true)),
        ("/why", json!(null)),
    ] {
        assert_eq!(state.pointer(pointer), Some(&value), "{pointer} in {state}");
    }
    let mut screen = Screen::new(&[&at]);
    screen.press("l");
    screen.shows("VOK -RUP_DIS QEN");
    screen.press("q");
    screen.ends();

    fs::write(file("df/82/4"), "0x06").expect("Update Status may be written");
    // After the reset that ends the write, nothing is shown at first.
    let status = || fs::read_to_string(file("gauge/learned_status")).unwrap_or_default();
    within("a poll", || status().contains("CF1"));
    let out = gaugefs(&["learn", &gauge]).done();
    assert!(out.contains("update status 06; learned"), "{out}");
    gaugefs(&["learn", &folder.file("none")]).failed(&["none: not mounted"]);
}

/// Rows of a CSV whose cells hold no quotes.
fn rows(file: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(file).unwrap_or_default();
    assert!(text.is_empty() || text.ends_with("\r\n"), "whole rows: {text:?}");
    text.lines().map(|line| line.split(',').map(str::to_string).collect()).collect()
}

#[test]
fn log_writes_each_poll_once_and_continues() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("history.csv"));
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    fs::write(format!("{at}/BAT0/sim/load_ma"), "500").expect("a knob");
    gaugefs(&["log", &at, "-o", &file, "--count", "4"]).done();
    gaugefs(&["log", &format!("{at}/BAT0"), "-o", &file, "--count", "2"]).done();
    let written = rows(&file);
    assert_eq!(written.len(), 7, "one header: {written:?}");
    assert_eq!(written[0][..4], ["time (UTC)", "gauge", "status", "voltage (V)"]);
    let times: Vec<jiff::Timestamp> =
        written[1..].iter().map(|row| row[0].parse().expect("a time")).collect();
    for pair in times.windows(2) {
        assert!(pair[1].as_millisecond() - pair[0].as_millisecond() >= 400, "one poll twice: {times:?}");
    }
    let last = &written[6];
    assert_eq!((last[1].as_str(), last[2].as_str(), last[4].as_str()), ("BAT0", "Discharging", "-0.500"));

    // To standard output, and to a reader that closes the pipe.
    let out = gaugefs(&["log", &at, "--count", "1"]).done();
    assert_eq!(out.lines().count(), 2);
    let script = format!("'{}' log '{at}' | head -n 1", env!("CARGO_BIN_EXE_gaugefs"));
    let output = Command::new("sh").args(["-c", &script]).output().expect("a shell");
    assert_eq!(output.stderr, b"");

    // A truncated row remains, and the plot leaves it out.
    let text = fs::read_to_string(&file).expect("the log");
    fs::write(&file, &text[..text.len() - 20]).expect("a file");
    gaugefs(&["log", &at, "-o", &file, "--count", "1"]).done();
    assert_eq!(rows(&file).len(), 8);
    gaugefs(&["plot", &file, "-o", &folder.file("history.svg")]).done();

    fs::write(&file, "some,other,columns\n1,2,3\n").expect("a file");
    gaugefs(&["log", &at, "-o", &file]).failed(&[&file, "its columns are not those that gaugefs log writes"]);
    assert_eq!(fs::read_to_string(&file).expect("it"), "some,other,columns\n1,2,3\n");
    gaugefs(&["log", &at, "-o", "/dev/full"]).failed(&["/dev/full", "No space left on device"]);
    gaugefs(&["log", &folder.file("none")]).failed(&["not mounted"]);
}

#[test]
fn regression_a_mains_supply_counted_as_a_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--ac", &at]).done();
    let logged = gaugefs(&["log", "--count", "1", &at]).done();
    let gauges: Vec<_> = logged.lines().skip(1).filter_map(|line| line.split(',').nth(1)).collect();
    assert_eq!(gauges, ["BAT0"]);
    // It is the only gauge of its mount.
    gaugefs(&["wait", &at, "capacity<200", "--timeout", "60"]).done();
    gaugefs(&["umount", &at]).done();
}

#[test]
fn log_continues_after_an_absence() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("history.csv"));
    let knob = |name: &str, text: &str| fs::write(format!("{at}/BAT0/sim/{name}"), text).expect("a knob");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    let child = command(&["log", &at, "-o", &file]).stderr(Stdio::null()).spawn().expect("gaugefs runs");
    let mut log = Foreground(child);
    let there = |row: &[String]| !row[3].is_empty();
    let count = |what: fn(&[String]) -> bool| rows(&file).iter().skip(1).filter(|row| what(row)).count();
    within("two rows", || count(there) >= 2);
    // The gauge goes and comes back.
    knob("power", "off");
    within("a row with empty fields", || count(|row| row[3].is_empty()) == 1);
    let before = count(there);
    knob("power", "on");
    within("rows again", || count(there) >= before + 2);
    // The mount goes and comes back.
    let gaps = count(|row| row[3].is_empty());
    // It may be reading, and on a busy machine keep what it reads in use for longer than umount waits.
    within("umount", || gaugefs(&["umount", &at]).code == Some(0));
    within("another one", || count(|row| row[3].is_empty()) == gaps + 1);
    let before = count(there);
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    within("rows again", || count(there) >= before + 2);
    log.0.kill().expect("it still runs");
    log.ends();
    gaugefs(&["umount", &at]).done();

    let svg = folder.file("history.svg");
    gaugefs(&["plot", &file, "--columns", "voltage", "-o", &svg]).done();
    let drawn = fs::read_to_string(svg).expect("the plot");
    // Each period without a gap is a line of its own, and there is one beside the panel's title.
    assert_eq!(drawn.matches("stroke=\"#0072b2\"").count(), 3 + 1, "{drawn}");
}

#[test]
fn plot_draws_a_history() {
    golden(
        "plot",
        &[
            "plot tests/it/images/history.csv",
            "plot tests/it/images/history.csv --columns charge --width 640 --height 300",
            "plot tests/it/images/history.csv --columns voltage --limit voltage=3.6..4.1 --height 260",
            "plot tests/it/images/history.csv --limit charge=..0.5",
            "plot tests/it/images/history.csv --limit voltage=4",
            "plot tests/it/images/history.csv --limit voltage=4..3",
            "plot tests/it/images/history.csv --columns speed",
            "plot tests/it/images/history.csv --height 200",
            "plot tests/it/images/history.csv -o history.png",
            "plot tests/it/images/history.csv -o history.gif",
            "plot tests/it/images/pack.gg.csv",
            "plot tests/it/images/none",
        ],
    );
}

/// Chosen columns, and what changes between two rows although no row is written for it.
#[test]
fn log_writes_chosen_columns_and_events() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("history.csv"));
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    let knob = |name: &str, text: &str| fs::write(format!("{at}/BAT0/sim/{name}"), text).expect("a knob");
    within("the slow registers", || Path::new(&at).join("BAT0/gauge/registers/true_fcc").exists());
    let names = "voltage,true_fcc,flags,learning,events";
    let arguments = ["log", &at, "--columns", names, "--interval", "4", "-o", &file];
    let child = command(&arguments).stderr(Stdio::null()).spawn().expect("gaugefs runs");
    let mut log = Foreground(child);
    within("a row", || rows(&file).len() >= 2);
    knob("load_ma", "500");
    // On a busy machine the log may miss a discharge that is over before it looks again.
    within("a discharge in the log", || {
        fs::read_to_string(&file).expect("the log").contains("Not charging -> Discharging")
    });
    knob("load_ma", "0");
    within("the rows with both", || {
        let text = fs::read_to_string(&file).expect("the log");
        text.contains("Discharging -> Not charging") && rows(&file).len() >= 4
    });
    log.0.kill().expect("it still runs");
    log.ends();

    let written = rows(&file);
    let titles = "time (UTC),gauge,voltage (V),true fcc (mAh; every 10th poll),flags,learning,events";
    assert_eq!(written[0].join(","), titles);
    // The state of learning has commas, so it is in quotes.
    assert_eq!(
        (written[1][3].as_str(), written[1].last().map(String::as_str)),
        ("1000", Some("")),
        "{written:?}"
    );
    assert!(written[1][5].starts_with("\"update status 00; waits for IT_ENABLE"), "{written:?}");
    let events: Vec<_> = written[2..].iter().filter_map(|row| row.last().map(String::as_str)).collect();
    let events = events.join("; ");
    for event in ["Not charging -> Discharging", "+DSG", "Discharging -> Not charging"] {
        assert!(events.contains(event), "{event}: {events}");
    }

    // The file is continued with its columns, and with no others.
    gaugefs(&["log", &at, "-o", &file, "--count", "1"]).done();
    assert_eq!(rows(&file).len(), written.len() + 1);
    let others = ["log", &at, "-o", &file, "--columns", "voltage"];
    gaugefs(&others).failed(&["its columns are others: voltage, true fcc, flags, learning, events"]);
    gaugefs(&["log", &at, "--columns", "voltage,speed"]).failed(&["no column `speed`; there are status"]);
    gaugefs(&["log", &at, "--columns", "voltage,voltage"]).failed(&["`voltage` is named twice"]);
}

/// A quick battery would otherwise lose more charge than its current can have taken.
#[test]
fn log_has_the_battery_time_of_a_simulated_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("history.csv"));
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    let knob = |name: &str, text: &str| fs::write(format!("{at}/BAT0/sim/{name}"), text).expect("a knob");
    knob("load_ma", "500");
    knob("speed", "200");
    let polls = || read(&at, "BAT0/gauge/statistics/polls").parse::<u64>().expect("a number");
    let before = polls();
    within("polls at that speed", || polls() >= before + 2);
    gaugefs(&["log", &at, "-o", &file, "--count", "6"]).done();
    let text = fs::read_to_string(&file).expect("the log");
    let (integral, change) = charges(&text, "BAT0");
    assert!(change < -0.03, "{text}");
    // By the time of the host it would be a two-hundredth; a busy one stamps a poll a little later than it reads.
    assert!((integral - change).abs() < 0.2 * change.abs(), "{integral} and {change} Ah: {text}");
}

/// The charge in Ah by which the current of a log accounts for, and the change of the charge that it shows.
fn charges(text: &str, gauge: &str) -> (f64, f64) {
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let titles = lines.next().expect("a header");
    let at = |title: &str| titles.iter().position(|found| *found == title).expect("a column");
    let (time, current, charge) = (at("time (UTC)"), at("current (A)"), at("charge (Ah)"));
    let number = |text: &str| text.parse::<f64>().expect("a number");
    let seconds =
        |text: &str| text.parse::<jiff::Timestamp>().expect("a time").as_millisecond() as f64 / 1000.0;
    let rows: Vec<_> = lines
        .filter(|row| row[1] == gauge)
        .map(|row| (seconds(row[time]), number(row[current]), number(row[charge])))
        .collect();
    let parts = rows.windows(2).map(|pair| (pair[1].0 - pair[0].0) / 3600.0 * (pair[0].1 + pair[1].1) / 2.0);
    (parts.sum(), rows[rows.len() - 1].2 - rows[0].2)
}

/// The histories that the README's pictures are drawn from, which `tests/record` has recorded.
#[test]
fn the_recorded_histories_can_be_true() {
    let image = |path: &str| fs::read_to_string(path).expect("a history");
    for (text, gauge) in [
        (image("tests/it/images/recorded.csv"), "PACK-A"),
        (image("crates/gaugefs-screen/src/top/recorded.csv"), "PACK-A"),
        (image("crates/gaugefs-screen/src/top/recorded.csv"), "PACK-B"),
        (image("crates/gaugefs-screen/src/top/recorded.csv"), "PACK-C"),
    ] {
        let (integral, change) = charges(&text, gauge);
        assert!((integral - change).abs() < 0.03, "{gauge}: {integral} and {change} Ah");
    }
}

/// docs/plot.svg, the README's picture.
#[test]
fn the_picture_in_docs_is_what_plot_draws() {
    let drawn = gaugefs(&["plot", "tests/it/images/recorded.csv"]).done();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/plot.svg");
    if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
        fs::write(&path, &drawn).expect("the picture");
    }
    let kept = fs::read_to_string(&path).expect("the picture");
    assert!(drawn == kept, "docs/plot.svg differs; if that is intended, GAUGEFS_GOLDEN=write\n{drawn}");
    // Every mark that is there has its word in the legend, and the other way round.
    for (mark, text) in [("#7bc88f", ">charging<"), ("#f2b36b", ">discharging<"), ("#fbe3a6", "[SOC1]")] {
        assert!(drawn.contains(mark) && drawn.contains(text), "{mark} {text}");
    }
    assert!(!drawn.contains("another status") && !drawn.contains("single poll"));
}

/// Names that have no room beside a title are in the legend, each once for all panels; what is below the title is
/// wrapped.
#[test]
fn plot_names_every_one_of_many_gauges() {
    let folder = Folder::new();
    let file = folder.file("many.csv");
    let mut text = "time (UTC),gauge,status,voltage (V),current (A)\n".to_string();
    for minute in 0..5 {
        for gauge in 0..12 {
            text += &format!("2026-01-01T00:{minute:02}:00Z,PACK-{gauge},Discharging,3.{gauge:02},-0.5\n");
        }
    }
    fs::write(&file, text).expect("a history");
    let drawn = gaugefs(&["plot", &file]).done();
    for gauge in 0..12 {
        // Once beside its strip, once in the legend; the title has them all in one text.
        assert_eq!(drawn.matches(&format!(">PACK-{gauge}<")).count(), 2, "PACK-{gauge}: {drawn}");
    }
    // Twelve lines in two panels and twelve in the legend, of which the last five each have dashes.
    assert_eq!(drawn.matches("stroke-dasharray").count(), 5 * 3);
    let narrow = gaugefs(&["plot", "tests/it/images/recorded.csv", "--width", "400"]).done();
    assert!(narrow.contains("discharged 0.") && narrow.contains(" Wh"), "{narrow}");
}
