// SPDX-License-Identifier: MIT

//! `gaugefs wait`, `watch` and `metrics` on mounted gauges.

use std::fs::{self, File, Permissions};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, geteuid};

use crate::room::{
    CHIP, Folder, Foreground, LONG, as_nobody, can_mount, command, gaugefs, impatient, read, run, stop,
    within,
};

/// A simulated gauge that is polled often, with this state of charge.
fn mounted(folder: &Folder, soc: &str) -> String {
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    set(&at, "soc", soc);
    within("a poll", || read(&at, "BAT0/capacity") == soc);
    // Not all registers are read by the first one.
    let second = Path::new(&at).join("BAT0/gauge/learned_status");
    within("the second poll", || second.exists());
    at
}

fn set(at: &str, knob: &str, value: &str) {
    fs::write(Path::new(at).join("BAT0/sim").join(knob), value).expect("a knob");
}

/// A command in the background, killed when the test ends.
struct Running {
    child: Child,
    out: String,
    err: String,
}

impl Running {
    fn new(folder: &Folder, arguments: &[&str]) -> Self {
        let (out, err) = (folder.file("out"), folder.file("err"));
        let file = |path: &str| Stdio::from(File::create(path).expect("a file"));
        let child = command(arguments).stdout(file(&out)).stderr(file(&err)).spawn().expect("gaugefs runs");
        Self { child, out, err }
    }

    fn out(&self) -> String {
        fs::read_to_string(&self.out).expect("text")
    }

    fn err(&self) -> String {
        fs::read_to_string(&self.err).expect("text")
    }

    fn ends(&mut self) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status.code();
            }
            assert!(start.elapsed() < LONG, "it does not end: {}{}", self.out(), self.err());
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn lines(path: &str) -> Vec<String> {
    fs::read_to_string(path).unwrap_or_default().lines().map(str::to_string).collect()
}

#[test]
fn wait_ends_when_its_condition_is_true_or_its_time_is_up() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let gauge = format!("{at}/BAT0");
    // True already; the mount point of one gauge will do.
    gaugefs(&["wait", "--timeout", "0", &at, "capacity<=60 && voltage_now>3V"]).done();
    let late = gaugefs(&["wait", "--timeout", "0", &gauge, "capacity<20"]);
    assert_eq!((late.code, late.err.as_str()), (Some(3), ""), "{}", late.out);
    let begun = Instant::now();
    assert_eq!(gaugefs(&["wait", "--timeout", "1.5", &gauge, "status==Full"]).code, Some(3));
    assert!(begun.elapsed() >= Duration::from_millis(1500), "{:?}", begun.elapsed());

    let mut waiting = Running::new(&folder, &["wait", &gauge, "capacity<20"]);
    std::thread::sleep(Duration::from_secs(2));
    assert!(waiting.child.try_wait().expect("a child").is_none(), "{}", waiting.err());
    set(&at, "soc", "19");
    assert_eq!((waiting.ends(), waiting.err().as_str()), (Some(0), ""));
    // A misspelt name is an error at once.
    let wrong = gaugefs(&["wait", &gauge, "capcity<20"]);
    assert_eq!(wrong.code, Some(2));
    assert!(wrong.err.contains("did you mean capacity?"), "{}", wrong.err);
    gaugefs(&["wait", &folder.file("none"), "capacity<20"]).failed(&["none: not mounted"]);
}

#[test]
fn wait_for_a_gauge_that_is_missing() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let mut gone = Running::new(&folder, &["wait", &at, "missing"]);
    assert_eq!(gaugefs(&["wait", "--timeout", "0", &at, "missing"]).code, Some(3));
    set(&at, "power", "off");
    assert_eq!(gone.ends(), Some(0));
    // Without values nothing is true, and whoever waits is told.
    let late = gaugefs(&["wait", "--timeout", "1", &at, "capacity!=0"]);
    assert_eq!(late.code, Some(3));
    assert!(late.err.contains("the gauge does not answer; waiting"), "{}", late.err);
}

#[test]
fn a_daemon_that_hangs_makes_a_gauge_missing_and_holds_up_nobody() {
    impatient();
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &["--poll", "0.5"]);
    let mut gone = Running::new(&folder, &["wait", &at, "missing"]);
    std::thread::sleep(Duration::from_secs(1));
    stop(daemon.0.id(), &at);
    assert_eq!(gone.ends(), Some(0), "{}", gone.err());
    let out = gaugefs(&["metrics", &at]).done();
    let down = format!("gaugefs_mount_up{{mountpoint=\"{at}\"}} 0\n");
    assert!(out.contains(&down), "{out}");
    gaugefs(&["watch", &at, "capacity<20"]).failed(&["its daemon does not answer"]);
    daemon.send(Signal::SIGCONT);
    daemon.send(Signal::SIGTERM);
    daemon.ends();
}

/// The fewest polls there can be; what watches makes none of its own.
#[test]
fn waiting_and_metrics_cause_no_bus_traffic() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "3600", &at]).done();
    let counts = || ["polls", "transfers"].map(|name| read(&at, &format!("BAT0/gauge/statistics/{name}")));
    within("two polls", || counts()[0] == "2");
    let before = counts();
    let late = gaugefs(&["wait", "--timeout", "1.5", &at, "capacity<20 && gauge/control_status has VOK"]);
    assert_eq!(late.code, Some(3), "{}", late.err);
    let page = gaugefs(&["metrics", &at]).done();
    assert!(page.contains("gaugefs_polls_total{"), "{page}");
    assert_eq!(counts(), before);
}

#[test]
fn watch_runs_a_program_once_an_alert_with_facts_in_its_environment() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let (events, facts) = (folder.file("events"), folder.file("facts"));
    let script = "echo \"$GAUGEFS_EVENT $GAUGEFS_VALUE\" >> \"$0\"; env > \"$1\"";
    let arguments = ["watch", &at, "capacity<20", "--clear", "capacity>25", "--name", "low"];
    let raised = ["--exec", "sh", "-c", script, &events, &facts, ";"];
    let cleared = ["--exec-clear", "sh", "-c", script, &events, "/dev/null"];
    let watch = Running::new(&folder, &[&arguments[..], &raised, &cleared].concat());
    set(&at, "soc", "19");
    within("raised", || lines(&events) == ["raised 19"]);
    within("its facts", || {
        let facts = lines(&facts);
        [
            "GAUGEFS_ALERT=low",
            "GAUGEFS_CONDITION=capacity<20",
            &format!("GAUGEFS_GAUGE={at}/BAT0"),
            "POWER_SUPPLY_MODEL_NAME=bq34z100-G1",
        ]
        .iter()
        .all(|fact| facts.iter().any(|found| found == fact))
    });
    // Between the two thresholds nothing happens.
    for soc in ["22", "19", "25"] {
        set(&at, "soc", soc);
        within("a poll", || read(&at, "BAT0/capacity") == soc);
        std::thread::sleep(Duration::from_millis(1200));
    }
    assert_eq!(lines(&events), ["raised 19"]);
    set(&at, "soc", "26");
    within("cleared", || lines(&events) == ["raised 19", "cleared 26"]);
    set(&at, "soc", "10");
    within("raised again", || lines(&events).len() == 3);
    let out = watch.out();
    let told: Vec<_> =
        out.lines().filter_map(|line| line.split_once("Z BAT0: ")).map(|(_, told)| told).collect();
    assert_eq!(
        told,
        ["raised low (capacity 19)", "cleared low (capacity 26)", "raised low (capacity 10)"],
        "{out}"
    );
    assert_eq!(watch.err(), "");
}

#[test]
fn a_program_that_fails_or_is_slow_stops_no_alert_and_runs_once_at_a_time() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let (runs, go, gone) = (folder.file("runs"), folder.file("go"), folder.file("gone"));
    let config = folder.file("alerts.toml");
    let text = format!(
        "[[alert]]\nwhen = \"capacity<20\"\nname = \"slow\"\n\
         exec = [\"sh\", \"-c\", 'echo begin >> \"$0\"; until [ -e \"$1\" ]; do sleep 0.1; done; echo end >> \"$0\"', {runs:?}, {go:?}]\n\
         [[alert]]\nwhen = \"capacity<20\"\nname = \"broken\"\nexec = [\"false\"]\n\
         [[alert]]\ngauge = \"BAT0\"\nwhen = \"capacity<20\"\nname = \"none\"\nexec = [{gone:?}]\n"
    );
    fs::write(&config, text).expect("a file");
    fs::write(&gone, "#!/bin/sh\n").expect("a file");
    fs::set_permissions(&gone, Permissions::from_mode(0o755)).expect("a mode");
    let watch = Running::new(&folder, &["watch", "--config", &config, &at]);
    for soc in ["10", "60", "11"] {
        let count = watch.out().lines().count();
        set(&at, "soc", soc);
        within("an event", || watch.out().lines().count() >= count + 3);
        let _ = fs::remove_file(&gone);
    }
    assert_eq!(lines(&runs), ["begin"], "the first one still runs");
    let failure = "alert broken: its program has failed: exit status: 1";
    within("both failures", || watch.err().matches(failure).count() == 2);
    let missing = format!("alert none: {gone}: cannot be started: No such file or directory");
    assert!(watch.err().contains(&missing), "{}", watch.err());
    fs::write(&go, "").expect("a file");
    within("its end", || lines(&runs) == ["begin", "end"]);
}

#[test]
fn regression_a_program_that_cannot_be_started_was_found_at_the_only_moment_that_counts() {
    let folder = Folder::new();
    let file = folder.file("gauges.toml");
    let likely = &["sleep 0", "write each word by itself", "[\"sleep\", \"0\"]"][..];
    for (words, says) in [
        (&["sleep 0"][..], likely),
        (&["/no/such/program"], &["/no/such/program", "there is no such program"]),
        (&["no-such-program", "x"], &["no-such-program", "in PATH"]),
    ] {
        for option in ["--exec", "--exec-clear"] {
            let command = [&["watch", "/no/such/mount", "capacity<20", option][..], words].concat();
            gaugefs(&command).failed(&[&["alert capacity<20"], says].concat());
            let key = &option[2..];
            let text = format!(
                "[mount]\nmountpoint = \"m\"\n[[gauge]]\nsim = \"bq35100\"\n\
                 [[alert]]\nwhen = \"capacity<20\"\n{key} = {words:?}\n"
            );
            fs::write(&file, text).expect("a file");
            gaugefs(&["watch", "--config", &file]).failed(&[&["alert capacity<20"], says].concat());
            let checked = gaugefs(&["mount", "--config", &file, "--check"]);
            assert_eq!(checked.code, Some(1), "{}", checked.err);
            assert!(says.iter().all(|word| checked.err.contains(word)), "{}", checked.err);
        }
    }
}

#[test]
fn watch_tests_each_program_once_whatever_the_gauge_shows() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let runs = folder.file("runs");
    let script = "echo \"$GAUGEFS_EVENT $GAUGEFS_VALUE $GAUGEFS_TEST\" >> \"$0\"";
    let both = ["--exec", "sh", "-c", script, &runs, ";", "--exec-clear", "sh", "-c", script, &runs, ";"];
    let watch = ["watch", &at, "capacity<20"];
    let told = gaugefs(&[&watch[..], &both, &["--test"]].concat()).done();
    assert_eq!(lines(&runs), ["raised 60 1", "cleared 60 1"]);
    assert!(told.contains("BAT0: raised capacity<20 (capacity 60)"), "{told}");
    let failed = gaugefs(&[&watch[..], &["--test", "--exec", "false"]].concat());
    assert_eq!(failed.code, Some(1), "{}", failed.err);
    assert!(
        failed.err.contains("alert capacity<20: its program has failed: exit status: 1"),
        "{}",
        failed.err
    );
    gaugefs(&[&watch[..], &["--test"]].concat()).failed(&["no alert has a program", "--exec"]);
}

#[test]
fn a_flat_pack_on_its_charger_raises_no_alert_that_ends_the_machine() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    set(&at, "load_ma", "-500");
    within("it charges", || read(&at, "BAT0/status") == "Charging");
    set(&at, "soc", "3");
    within("it is flat", || read(&at, "BAT0/capacity") == "3");
    let ends = "capacity<=5 && status==Discharging";
    let watch = Running::new(&folder, &["watch", &at, ends]);
    let polls = || read(&at, "BAT0/gauge/statistics/polls").parse::<u64>().expect("a number");
    let before = polls();
    within("some polls", || polls() > before + 4);
    assert_eq!(watch.out(), "");
    set(&at, "load_ma", "500");
    within("it is raised", || watch.out().contains(&format!("raised {ends}")));
}

#[test]
fn regression_an_option_behind_the_program_of_an_alert_is_refused() {
    let misused = |words: &[&str], says: &str| {
        let ran = gaugefs(&[&["watch", "/no/such/mount", "capacity<20"], words].concat());
        assert!(ran.code == Some(2) && ran.err.contains(says), "{words:?}: {:?} {}", ran.code, ran.err);
    };
    for option in ["--for", "--clear", "--name", "--exec", "--exec-clear", "--config", "--test"] {
        let says = format!("{option} is an option of `gaugefs watch`; end CMD with `;`");
        misused(&["--exec", "true", option, "60"], &says);
        misused(&["--exec", "true", "x", &format!("{option}=60")], &says);
        misused(&["--exec-clear", "true", option, "60"], &says);
    }
    misused(&["--exec", "--for", "60"], "--for is an option");
    // What is refused there is accepted before and behind the command.
    for words in [
        &["--for", "60", "--exec", "true", "-x", "--force", "--fork=1"][..],
        &["--exec", "true", ";", "--for", "60"],
        &["--exec", "true", "-v", ";", "--exec-clear", "sh", "-c", "true --for 3", ";", "--name", "n"],
    ] {
        let ran = gaugefs(&[&["watch", "/no/such/mount", "capacity<20"], words].concat());
        assert!(ran.code == Some(1) && ran.err.contains("not mounted"), "{words:?}: {}", ran.err);
    }
}

#[test]
fn regression_a_number_without_its_unit_is_refused_on_the_command_line_and_in_a_file() {
    for command in ["wait", "watch"] {
        let ran = gaugefs(&[command, "/no/such/mount", "voltage_now<3.9"]);
        assert!(ran.code == Some(2) && ran.err.contains("write voltage_now<3.9V"), "{}", ran.err);
    }
    let ran = gaugefs(&["watch", "/no/such/mount", "temp>45C", "--clear", "temp<40"]);
    assert!(ran.code == Some(2) && ran.err.contains("write temp<40C"), "{}", ran.err);
    let folder = Folder::new();
    let file = folder.file("gauges.toml");
    for key in ["when = \"temp>45\"", "when = \"missing\"\nclear = \"temp>45\""] {
        fs::write(&file, format!("[mount]\nmountpoint = \"m\"\n[[alert]]\n{key}\n")).expect("a file");
        gaugefs(&["watch", "--config", &file]).failed(&["gauges.toml: line", "write temp>45C"]);
        gaugefs(&["mount", "--config", &file, "--check"]).failed(&["write temp>45C"]);
    }
}

#[test]
fn alerts_of_a_file_are_checked_before_anything_runs() {
    let folder = Folder::new();
    let file = folder.file("gauges.toml");
    let refused = |text: &str, words: &[&str]| {
        fs::write(&file, text).expect("a file");
        gaugefs(&["watch", "--config", &file]).failed(&[&[file.as_str()], words].concat());
    };
    refused("[[gauge]]\n", &["no alert", "[[alert]]"]);
    refused("[[alert]]\nwhen = \"missing\"\n", &["no mount point"]);
    let mounted = "[mount]\nmountpoint = \"m\"\n[[alert]]\n";
    refused(&format!("{mounted}when = \"capcity<20\"\n"), &["line 4: when", "did you mean capacity?"]);
    refused(&format!("{mounted}when = \"missing\"\nexce = []\n"), &["line 5: exce", "unknown key", "exec"]);
    refused(&format!("{mounted}exec = [\"true\"]\n"), &["when"]);
    refused(
        &format!("{mounted}when = \"missing\"\nexec = \"true\"\n"),
        &["line 5: exec", "expected an array of strings"],
    );
    refused(&format!("{mounted}when = \"missing\"\nfor = -1\n"), &["line 5: for", "0 to 86400"]);
    // The mount sees such a mistake as well.
    fs::write(&file, format!("{mounted}when = \"capcity<20\"\n[[gauge]]\nsim = \"bq35100\"\n"))
        .expect("a file");
    gaugefs(&["mount", "--config", &file, "--check"]).failed(&["did you mean capacity?"]);
    // Whoever can change the file chooses what is run.
    fs::write(&file, format!("{mounted}when = \"missing\"\n")).expect("a file");
    fs::set_permissions(&file, Permissions::from_mode(0o664)).expect("a mode");
    gaugefs(&["watch", "--config", &file]).failed(&["others may change the programs", "chmod go-w"]);
}

/// What a server answers to a request, without its head; and the head.
fn ask(mut client: impl Read + Write, request: &str) -> (String, String) {
    client.write_all(request.as_bytes()).expect("a request");
    let mut answer = String::new();
    client.read_to_string(&mut answer).expect("an answer");
    let (head, body) = answer.split_once("\r\n\r\n").expect("a head");
    (head.to_string(), body.to_string())
}

#[test]
fn metrics_are_printed_written_to_a_file_and_answered() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let page = gaugefs(&["metrics", &at]).done();
    let of = format!("{{mountpoint=\"{at}\",power_supply=\"BAT0\"");
    for line in [
        "gaugefs_build_info{version=\"0.1.0\"} 1".to_string(),
        format!("gaugefs_mount_up{{mountpoint=\"{at}\"}} 1"),
        format!(
            "gaugefs_chip_info{of},model=\"bq34z100-G1\",serial_number=\"0001\",firmware=\"0x0016\",\
             chem_id=\"0x0107\"}} 1"
        ),
        format!("gaugefs_present{of}}} 1"),
        format!("gaugefs_state_of_health_ratio{of}}} 1"),
        format!("gaugefs_control_status{of},bit=\"QEN\"}} 0"),
        format!("gaugefs_update_status{of}}} 0"),
        format!("gaugefs_seal_state{of},state=\"sealed\"}} 1"),
        format!("gaugefs_owed{of}}} 0"),
        format!("gaugefs_poll_interval_seconds{of}}} 0.5"),
        format!("gaugefs_failed_polls_total{of}}} 0"),
        "# EOF".into(),
    ] {
        assert!(page.lines().any(|found| found == line), "{line} is not in:\n{page}");
    }

    // All of a file or nothing, and nothing beside it.
    let inside = folder.0.join("textfile");
    fs::create_dir(&inside).expect("a folder");
    let file = inside.join("gaugefs.prom");
    gaugefs(&["metrics", &at, "-o", file.to_str().expect("text")]).done();
    let text = fs::read_to_string(&file).expect("the metrics");
    assert!(
        text.contains("# TYPE gaugefs_failed_polls_total counter\n") && !text.contains("# EOF"),
        "{text}"
    );
    assert_eq!(fs::read_dir(&inside).expect("a folder").count(), 1);
    let nowhere = folder.file("nowhere/gaugefs.prom");
    gaugefs(&["metrics", &at, "-o", &nowhere]).failed(&[&nowhere, "cannot write it"]);

    let server = Running::new(&folder, &["metrics", "--listen", "127.0.0.1:0", &at]);
    within("it listens", || server.err().contains("/metrics\n"));
    let address = server.err().trim().trim_start_matches("gaugefs: http://").replace("/metrics", "");
    let tcp = |request: &str| ask(TcpStream::connect(&address).expect("a connection"), request);
    let (head, body) =
        tcp("GET /metrics HTTP/1.1\r\nHost: x\r\nAccept: application/openmetrics-text\r\n\r\n");
    assert!(
        head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("openmetrics-text; version=1.0.0"),
        "{head}"
    );
    assert!(
        head.contains(&format!("Content-Length: {}\r\n", body.len())) && body.ends_with("# EOF\n"),
        "{head}"
    );
    let (head, body) = tcp("GET /metrics?x=1 HTTP/1.0\r\n\r\n");
    assert!(head.contains("text/plain; version=0.0.4") && !body.contains("# EOF"), "{head}");
    let (head, body) = tcp("GET / HTTP/1.1\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("text/html"), "{head}");
    assert!(body.contains("href=\"/metrics\""), "{body}");
    assert!(tcp("GET /x HTTP/1.1\r\n\r\n").0.starts_with("HTTP/1.1 404 "));
    let (head, body) = tcp("HEAD /metrics HTTP/1.1\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200 ") && !head.contains("Content-Length: 0\r"), "{head}");
    assert_eq!(body, "");
    assert!(tcp("POST /metrics HTTP/1.1\r\n\r\n").0.starts_with("HTTP/1.1 405 "));
    // Clients that say nothing hold up no other, until there are too many of them; and these only for a while.
    let silent: Vec<_> = (0..4).map(|_| TcpStream::connect(&address).expect("a connection")).collect();
    assert!(tcp("GET /metrics HTTP/1.1\r\n\r\n").0.starts_with("HTTP/1.1 200 "));
    let many: Vec<_> = (0..8).map(|_| TcpStream::connect(&address).expect("a connection")).collect();
    let mut last = many.last().expect("a connection");
    assert!(matches!(last.read(&mut [0; 1]), Ok(0) | Err(_)), "it is turned away");
    within("the others are left", || {
        let mut client = TcpStream::connect(&address).expect("a connection");
        let mut answer = String::new();
        let asked = client.write_all(b"GET /metrics HTTP/1.1\r\n\r\n");
        asked.and_then(|()| client.read_to_string(&mut answer)).is_ok_and(|length| length > 0)
    });
    drop((silent, many));
    let long = format!("GET /metrics HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(10_000));
    let mut client = TcpStream::connect(&address).expect("a connection");
    let mut answer = Vec::new();
    let asked = client.write_all(long.as_bytes()).and_then(|()| client.read_to_end(&mut answer));
    assert!(asked.is_err() || answer.starts_with(b"HTTP/1.1 400 "), "{}", String::from_utf8_lossy(&answer));

    // A socket that a killed server has left is taken over.
    let socket = folder.file("socket");
    let listen = format!("unix:{socket}");
    for _ in 0..2 {
        let mut server = Running::new(&folder, &["metrics", "--listen", &listen, &at]);
        within("it listens", || UnixStream::connect(&socket).is_ok());
        let (_, body) =
            ask(UnixStream::connect(&socket).expect("a connection"), "GET /metrics HTTP/1.1\r\n\r\n");
        assert!(body.contains("gaugefs_mount_up"), "{body}");
        server.child.kill().expect("it runs");
        server.ends();
    }
}

#[test]
fn regression_a_server_of_metrics_that_ended_left_its_socket() {
    let folder = Folder::new();
    let socket = folder.file("socket");
    let mut server =
        Running::new(&folder, &["metrics", "--listen", &format!("unix:{socket}"), "/no/such/mount"]);
    within("it listens", || UnixStream::connect(&socket).is_ok());
    kill(Pid::from_raw(server.child.id() as i32), Signal::SIGTERM).expect("it runs");
    assert_eq!(server.ends(), Some(0));
    assert!(!Path::new(&socket).exists());
    // One that another server has put there stays.
    let mut server =
        Running::new(&folder, &["metrics", "--listen", &format!("unix:{socket}"), "/no/such/mount"]);
    within("it listens", || UnixStream::connect(&socket).is_ok());
    fs::remove_file(&socket).expect("it is there");
    fs::write(&socket, "").expect("a file");
    kill(Pid::from_raw(server.child.id() as i32), Signal::SIGTERM).expect("it runs");
    assert_eq!(server.ends(), Some(0));
    assert!(Path::new(&socket).exists());
}

#[test]
fn metrics_listen_on_all_interfaces_if_no_host_is_named_and_say_so() {
    let folder = Folder::new();
    let server = Running::new(&folder, &["metrics", "--listen", ":0", "/no/such/mount"]);
    within("it listens", || server.err().contains("/metrics"));
    let told = server.err();
    assert!(told.contains("all interfaces of this machine, without a password; 127.0.0.1:PORT"), "{told}");
    let port =
        told.split_once("/metrics").expect("an address").0.rsplit(':').next().expect("a port").to_string();
    let client = TcpStream::connect(format!("127.0.0.1:{port}")).expect("a connection");
    assert!(ask(client, "GET /metrics HTTP/1.1\r\n\r\n").1.contains("gaugefs_mount_up"));
    let server = Running::new(&folder, &["metrics", "--listen", "127.0.0.1:0", "/no/such/mount"]);
    within("it listens", || server.err().contains("/metrics"));
    assert!(!server.err().contains("all interfaces"), "{}", server.err());
}

#[test]
fn regression_the_labels_of_a_gauge_depended_on_how_it_was_named() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let link = folder.file("link");
    std::os::unix::fs::symlink(&at, &link).expect("a link");
    let series = |places: &[&str]| {
        let page = gaugefs(&[&["metrics"], places].concat()).done();
        let series = page.lines().filter(|line| !line.starts_with('#') && !line.contains("duration"));
        let mut series: Vec<_> =
            series.filter_map(|line| line.rsplit_once(' ')).map(|(name, _)| name.to_string()).collect();
        series.sort();
        series
    };
    let whole = series(&[&at]);
    assert!(whole.iter().any(|name| name.contains(&format!("mountpoint=\"{at}\",power_supply=\"BAT0\""))));
    let gauge = format!("{at}/BAT0");
    for places in
        [&[&*gauge][..], &[&format!("{at}/")], &[&link], &[&format!("{link}/BAT0")], &[&at, &gauge, &link]]
    {
        assert_eq!(series(places), whole, "{places:?}");
    }
}

#[test]
fn a_gauge_is_written_for_nut_and_has_no_status_when_it_is_gone() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let (gauge, file) = (format!("{at}/BAT0"), folder.file("BAT0.seq"));
    let write = |gauge: &str| gaugefs(&["metrics", "--format", "nut", "-o", &file, gauge]);
    let has = |wanted: &str| {
        let text = fs::read_to_string(&file).expect("the file");
        text.lines().any(|line| line == wanted)
    };
    // The folder of a gauge, or a mount of one.
    for path in [&gauge, &at] {
        write(path).done();
        assert!(has("battery.charge: 60") && has("ups.status: OL"), "{path}");
    }
    let printed = gaugefs(&["metrics", "--format", "nut", &gauge]).done();
    assert!(printed.contains("\nups.model: bq34z100-G1\n"), "{printed}");
    set(&at, "load_ma", "500");
    within("it discharges", || {
        write(&gauge).done();
        has("ups.status: OB DISCHRG") && has("battery.current: -0.5")
    });
    let mut server =
        Running::new(&folder, &["metrics", "--format", "nut", "--interval", "0.5", "-o", &file, &gauge]);
    set(&at, "soc", "5");
    within("it is low", || has("ups.status: OB DISCHRG LB"));
    set(&at, "power", "off");
    within("it is gone", || has("ups.status: \"\""));
    assert!(has("battery.charge: \"\"") && !has("battery.charge: 5"));
    server.child.kill().expect("it still runs");
    server.ends();
    let typo = folder.file("m/BAT7");
    fs::remove_file(&file).expect("it was there");
    write(&typo).failed(&[&typo, "no gauge answers there"]);
    assert!(has("ups.status: \"\""));

    let config = folder.file("two.toml");
    fs::write(&config, "[[gauge]]\nsim = \"bq34110\"\n[[gauge]]\nsim = \"bq34110\"\n").expect("a file");
    let two = folder.file("n");
    gaugefs(&["mount", "--config", &config, &two]).done();
    write(&two).failed(&["several gauges", "the folder of one"]);
}

#[test]
fn regression_a_mount_that_is_gone_is_down_and_a_private_one_is_unknown() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, gone) = (folder.file("m"), folder.file("gone"));
    gaugefs(&["mount", "--sim", CHIP, "--private", &at]).done();
    let up = |page: &str, place: &str| {
        let head = format!("gaugefs_mount_up{{mountpoint=\"{place}\"}} ");
        page.lines().find_map(|line| line.strip_prefix(&head)).map(str::to_string)
    };
    // Nobody but the owner can say how a private mount is.
    if geteuid().is_root() {
        for more in [&[][..], &[at.as_str()], &["--expect", &at]] {
            let page = run(as_nobody(&folder, &[&["metrics"], more].concat())).done();
            assert!(up(&page, &at).is_none() && page.contains("gaugefs_build_info"), "{more:?}: {page}");
        }
    } else {
        eprintln!("SKIPPED in part: without root there is no other user");
    }
    let page = |more: &[&str]| gaugefs(&[&["metrics"], more].concat()).done();
    let expected = ["--expect", &at, "--expect", &gone];
    let both = page(&expected);
    assert_eq!((up(&both, &at).as_deref(), up(&both, &gone).as_deref()), (Some("1"), Some("0")), "{both}");
    assert_eq!(both.matches(&format!("gaugefs_mount_up{{mountpoint=\"{at}\"}}")).count(), 1, "{both}");
    assert!(up(&page(&[&gone]), &gone).as_deref() == Some("0"));
    gaugefs(&["umount", &at]).done();
    // Its folder, and supplies in it that are not gaugefs's, do not stand for it.
    fs::create_dir_all(format!("{gone}/BAT0")).expect("a folder");
    fs::write(format!("{gone}/BAT0/uevent"), "POWER_SUPPLY_NAME=BAT0\n").expect("a file");
    let none = page(&expected);
    assert_eq!((up(&none, &at).as_deref(), up(&none, &gone).as_deref()), (Some("0"), Some("0")), "{none}");
    assert!(up(&page(&[]), &at).is_none(), "nobody expects it");
}

/// What docs/fleet runs without privilege gets from a mount of root's.
#[test]
fn metrics_and_conditions_need_no_privilege() {
    if !can_mount() || !geteuid().is_root() {
        eprintln!("SKIPPED: without root there is no other user to read a mount");
        return;
    }
    let folder = Folder::new();
    let at = mounted(&folder, "60");
    let other = |arguments: &[&str]| run(as_nobody(&folder, arguments));
    let page = other(&["metrics", &at]).done();
    for sample in
        [",state=\"sealed\"} 1\n", "gaugefs_owed{", "gaugefs_update_status{", "gaugefs_polls_total{"]
    {
        assert!(page.contains(sample), "{sample} is not in:\n{page}");
    }
    assert!(!page.contains("gaugefs_poll_interval_seconds{"), "only the owner may read it:\n{page}");
    other(&["wait", "--timeout", "0", &at, "capacity==60 && gauge/owed==0"]).done();
    // The seal itself is the owner's to see.
    let late = other(&["wait", "--timeout", "0", &at, "gauge/seal==sealed"]);
    assert_eq!(late.code, Some(3), "{}", late.err);
}

/// What is shipped beside the program is understood by the programs that it is for.
#[test]
fn the_units_and_scripts_beside_the_daemon_are_accepted() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    for script in ["gaugefs-alerts.openrc", "gaugefs-mqtt"] {
        let script = top.join("docs/fleet").join(script);
        let checked = Command::new("sh").arg("-n").arg(script).status().expect("a shell");
        assert!(checked.success());
    }
    let folder = Folder::new();
    let place = |name: &str, file: &str| {
        let text = fs::read_to_string(top.join(name)).expect("a unit");
        let file = folder.0.join(file);
        fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        // systemd looks whether the program is there.
        fs::write(&file, text.replace("/usr/bin/gaugefs", "/bin/true")).expect("a file");
        file
    };
    let mut units = Vec::new();
    for name in ["udev/gaugefs-alerts", "udev/gaugefs-events", "docs/fleet/gaugefs-metrics"] {
        let name = format!("{name}.service");
        units.push(place(&name, name.rsplit('/').next().expect("a name")));
    }
    for name in ["gaugefs-alerts@", "gaugefs-events@"] {
        place(&format!("udev/{name}.service"), &format!("{name}.service"));
        units.push(folder.0.join(format!("{name}i2c-1.service")));
    }
    place("docs/fleet/gaugefs-nut@.service", "gaugefs-nut@.service");
    units.push(folder.0.join("gaugefs-nut@BAT0.service"));
    for name in ["gaugefs-events", "gaugefs-events@"] {
        place("udev/events.conf", &format!("{name}.service.d/10-confined.conf"));
    }
    // Those that they are bound to, with one line that says what is run.
    for name in ["gaugefs", "gaugefs@"] {
        fs::write(folder.file(&format!("{name}.service")), "[Service]\nExecStart=/bin/true\n")
            .expect("a file");
    }
    let mut verify = Command::new("systemd-analyze");
    verify.args(["verify", "--man=no"]).args(&units).stdin(Stdio::null());
    match verify.output() {
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.success() && !said.contains("gaugefs-"), "{said}");
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            eprintln!("SKIPPED in part: systemd-analyze is missing, so it did not check the units");
        }
        Err(error) => panic!("systemd-analyze: {error}"),
    }
}
