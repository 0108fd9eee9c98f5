// SPDX-License-Identifier: MIT

//! `gaugefs check`: its exit codes, what it takes, and where else its findings are shown.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value as Json;

use crate::room::{CHIP, Folder, Ran, can_mount, command, gaugefs, read, run, within};

fn answers(out: &str) -> Vec<Json> {
    out.lines().map(|line| serde_json::from_str(line).expect("an object")).collect()
}

/// The rules that are said with this severity.
fn rules(answer: &Json, severity: &str) -> Vec<String> {
    let findings = answer["findings"].as_array().expect("a list").iter();
    let found = findings.filter(|finding| finding["severity"] == severity);
    found.map(|finding| finding["rule"].as_str().expect("a text").to_string()).collect()
}

#[test]
fn a_gauge_that_is_not_mounted_is_checked_with_its_data_flash() {
    let ran = gaugefs(&["check", "--json", "--sim", CHIP]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let answer = &answers(&ran.out)[0];
    assert_eq!(rules(answer, "wrong"), Vec::<String>::new());
    assert!(rules(answer, "doubtful").contains(&"design-capacity-default".into()), "{answer}");
    let names_none = |remedy: &str| remedy.contains("gaugefs set GAUGE ");
    assert!(answer["findings"][0]["remedy"].as_str().is_some_and(names_none), "{answer}");
    let unread = answer["not_looked_at"].as_array().expect("a list").len();
    assert!(unread > 0 && answer["missing"] == Json::Array(Vec::new()), "{answer}");
    let ran = gaugefs(&["check", "--json", "--read", "--sim", CHIP]);
    let answer = &answers(&ran.out)[0];
    assert_eq!(answer["not_looked_at"], Json::Array(Vec::new()), "{answer}");
    assert!(rules(answer, "doubtful").contains(&"design-energy".into()), "{answer}");
    assert!(answer["findings"][0]["source"].as_str().is_some_and(|source| !source.is_empty()));
}

#[test]
fn files_are_checked_by_who_receives_them_and_bad_ones_are_named() {
    let folder = Folder::new();
    let (report, image, none) =
        (folder.file("report.txt"), folder.file("golden.toml"), folder.file("none.txt"));
    gaugefs(&["report", "--sim", "bq27441-g1", "-o", &report]).done();
    let ran = gaugefs(&["check", "--json", &report]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(
        rules(&answers(&ran.out)[0], "doubtful").contains(&"design-capacity-default".into()),
        "{}",
        ran.out
    );
    fs::write(&image, "chip = \"bq34z100-g1\"\n[configuration-data]\ndesign-capacity = 1000\n")
        .expect("a file");
    let ran = gaugefs(&["check", &image]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("design-capacity-default") && !ran.out.contains("missing"), "{}", ran.out);
    // One that fails does not keep the others from being checked.
    fs::write(&none, "nothing of a gauge").expect("a file");
    let missing = folder.file("BAT0");
    let ran = gaugefs(&["check", "--json", &none, &missing, &report]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    let all = answers(&ran.out);
    let failed: Vec<bool> = all.iter().map(|answer| answer["error"].is_string()).collect();
    assert_eq!(failed, [true, true, false], "{}", ran.out);
    assert!(ran.err.contains(&none) && ran.err.contains(&missing), "{}", ran.err);
    let many = vec![image.as_str(); 512];
    let ran = gaugefs(&[&["check", "--json"], &many[..]].concat());
    assert_eq!((ran.code, answers(&ran.out).len()), (Some(0), 512));
}

/// As from `cat FILE | gaugefs`.
fn piped(file: &str, arguments: &[&str]) -> Ran {
    let mut cat = Command::new("cat").arg(file).stdout(Stdio::piped()).spawn().expect("cat");
    let mut check = command(arguments);
    check.stdin(cat.stdout.take().expect("a pipe"));
    let ran = run(check);
    cat.wait().expect("cat ends");
    ran
}

#[test]
fn a_report_or_an_image_is_read_from_a_pipe() {
    let folder = Folder::new();
    let (report, image) = (folder.file("report.txt"), folder.file("golden.toml"));
    gaugefs(&["report", "--sim", "bq27441-g1", "-o", &report]).done();
    fs::write(&image, "chip = \"bq34z100-g1\"\n[configuration-data]\ndesign-capacity = 1000\n")
        .expect("a file");
    for file in [&report, &image] {
        let ran = piped(file, &["check", "--json", "-"]);
        assert_eq!(ran.code, Some(0), "{file}: {}{}", ran.out, ran.err);
        let answer = &answers(&ran.out)[0];
        assert_eq!(answer["gauge"], "standard input");
        assert!(rules(answer, "doubtful").contains(&"design-capacity-default".into()), "{answer}");
    }
    let ran = piped("/dev/null", &["check", "-"]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert!(ran.err.contains("standard input"), "{}", ran.err);
}

#[test]
fn what_is_neither_a_gauge_nor_a_file_is_told_as_that() {
    let folder = Folder::new();
    for name in ["BAT7", "report.txt"] {
        let path = folder.file(name);
        let ran = gaugefs(&["check", &path]);
        assert_eq!((ran.code, &*ran.out), (Some(1), ""));
        assert!(
            ran.err.starts_with(&format!("gaugefs: {path}: no such gauge or file; `gaugefs list`")),
            "{}",
            ran.err
        );
    }
    let ran = gaugefs(&["check", "--chip", CHIP, &folder.file("BAT7")]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("--chip is for files"), "{}", ran.err);
}

#[test]
fn data_flash_of_a_recording_is_looked_at_as_far_as_it_was_recorded() {
    let folder = Folder::new();
    let report = folder.file("report.txt");
    gaugefs(&["report", "--sim", CHIP, "-o", &report]).done();
    let told = |words: &[&str]| {
        let ran = gaugefs(&[&["check"], words, &[&report]].concat());
        assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
        ran.out
    };
    let (without, with) = (told(&[]), told(&["--read"]));
    assert!(without.contains("not looked at without data flash (--read): design-energy, "), "{without}");
    assert!(
        with.contains(
            "not looked at without data flash, as it could not be read or the gauge has updated it: "
        ),
        "{with}"
    );
    assert!(!with.contains("cell-voltage") && without.contains("cell-voltage"), "{with}");
    // A part of which no data flash is known is checked all the same.
    let ran = gaugefs(&["check", "--read", "--json", "--sim", "bq27000"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
}

#[test]
fn the_rules_are_printed_with_their_limits() {
    let out = gaugefs(&["check", "--rules"]).done();
    for says in [
        "remaining-above-full (wrong): more than 1.1 times",
        "percent-jumped (doubtful): 20 % or more within 5 minutes",
        "150 mV or more",
        "three or more within a day",
        "    SLUA450\n",
    ] {
        assert!(out.contains(says), "{says}: {out}");
    }
    assert_eq!(gaugefs(&["check", "--rules", "BAT0"]).code, Some(2));
}

#[test]
fn a_check_of_nothing_or_of_two_places_is_misuse() {
    for line in [
        &["check"][..],
        &["check", "BAT0", "--bus", "/dev/i2c-1"],
        &["check", "--key-file", "x", "BAT0"],
        &["report", "--chip", CHIP, "BAT0"],
    ] {
        assert_eq!(gaugefs(line).code, Some(2), "{line:?}");
    }
}

#[test]
fn what_is_wrong_is_shown_by_the_file_the_command_list_doctor_and_metrics() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", "bq27441-g1", "--poll", "0.5", "--sim-set", "voltage_mv=4700", &at]).done();
    let gauge = format!("{at}/BAT0");
    within("the voltage", || {
        read(&gauge, "gauge/check").starts_with("wrong\tcell-voltage\tVoltage() is 4700 mV")
    });
    let ran = gaugefs(&["check", "--json", "--read", &gauge]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert_eq!(rules(&answers(&ran.out)[0], "wrong"), ["cell-voltage"]);
    let list = gaugefs(&["list"]);
    assert!(list.err.contains("wrong: cell-voltage"), "{}", list.err);
    assert!(list.err.contains(&format!("{gauge}: doubtful: design-capacity-default; see: ")), "{}", list.err);
    let doctor = gaugefs(&["doctor"]);
    assert!(doctor.out.contains("wrong: cell-voltage"), "{}", doctor.out);
    let metrics = gaugefs(&["metrics", &at]);
    assert!(metrics.out.contains("rule=\"cell-voltage\""), "{}{}", metrics.out, metrics.err);
    let top = gaugefs(&["top", "--json", "--count", "1", &at]);
    assert!(
        top.out.contains("wrong: cell-voltage; doubtful: design-capacity-default"),
        "{}{}",
        top.out,
        top.err
    );
    // The gauge measures nothing from here on.
    fs::write(Path::new(&gauge).join("sim/voltage_mv"), "0").expect("a knob");
    within("no measurement", || read(&gauge, "gauge/check").contains("missing\t"));
    let ran = gaugefs(&["check", "--json", &gauge]);
    assert!([Some(1), Some(3)].contains(&ran.code), "{}", ran.out);
    within("it is certain", || read(&gauge, "gauge/check").starts_with("wrong\tmeasures-nothing"));
    gaugefs(&["umount", &at]).done();
}

/// Sick gauges, all in one mount.
fn many(folder: &Folder, count: usize) -> (String, Vec<String>) {
    let (config, at) = (folder.file(&format!("{count}.toml")), folder.file(&format!("m{count}")));
    let gauge = |number| {
        let knob = "[gauge.sim-set]\nthermistor = \"out\"\n";
        format!("[[gauge]]\nsim = \"{CHIP}\"\nname = \"G{number:03}\"\n{knob}")
    };
    fs::write(&config, (0..count).map(gauge).collect::<String>()).expect("a file");
    gaugefs(&["mount", "--config", &config, &at]).done();
    let gauges: Vec<String> = (0..count).map(|number| format!("{at}/G{number:03}")).collect();
    for gauge in &gauges {
        within(gauge, || {
            let found = read(gauge, "gauge/check");
            !found.is_empty() && !found.contains("missing\t")
        });
    }
    (at, gauges)
}

/// Processor time in hundredths of a second of the commands that have ended.
fn spent() -> u64 {
    let stat = fs::read_to_string("/proc/self/stat").expect("it is there");
    let fields: Vec<&str> = stat.rsplit(')').next().expect("its fields").split_whitespace().collect();
    fields[13..=14].iter().map(|ticks| ticks.parse::<u64>().expect("a number")).sum()
}

/// Each is told, in order, with 32 MB of data for the command, and eight times as many take at most three times that.
#[test]
fn very_many_mounted_gauges_are_checked() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let checked = |count: usize| {
        let (at, gauges) = many(&folder, count);
        let before = spent();
        let limited = "ulimit -d 32768; exec \"$@\"";
        let words = ["-c", limited, "sh", env!("CARGO_BIN_EXE_gaugefs"), "check", "--json"];
        let ran = Ran::of(Command::new("sh").args(words).args(&gauges).output().expect("sh"));
        let spent = spent() - before;
        assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
        let told = answers(&ran.out);
        let names: Vec<_> = told.iter().map(|answer| answer["gauge"].as_str().expect("a path")).collect();
        assert_eq!(names, gauges);
        for answer in &told {
            assert_eq!(rules(answer, "wrong"), ["temperature"], "{answer}");
        }
        (at, gauges, spent)
    };
    let (few, few_gauges, of_few) = checked(64);
    let (at, gauges, of_many) = checked(512);
    eprintln!("64 gauges in {of_few}0 ms of a processor, 512 in {of_many}0 ms");
    assert!(of_many <= 3 * 8 * (of_few + 2), "{of_few} and {of_many} hundredths of a second");
    // Data flash of all is read at the same time.
    let words = ["check", "--json", "--read"].into_iter().chain(few_gauges.iter().map(String::as_str));
    let ran = gaugefs(&words.collect::<Vec<_>>());
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    let told = answers(&ran.out);
    assert_eq!(told.len(), few_gauges.len());
    for (answer, gauge) in told.iter().zip(&few_gauges) {
        assert_eq!(answer["gauge"], gauge.as_str());
        // What the gauge itself updates is kept until the next poll.
        let updated = ["was-too-warm", "lifetime-voltage"];
        let unread = answer["not_looked_at"].as_array().expect("a list");
        assert!(unread.iter().all(|rule| updated.iter().any(|name| rule == name)), "{answer}");
    }
    let list = gaugefs(&["list"]);
    let doctor = gaugefs(&["doctor"]);
    for gauge in &gauges {
        assert!(list.err.contains(&format!("{gauge}: wrong: temperature;")), "{}", list.err);
        assert!(
            doctor.out.lines().any(|line| line.contains(gauge) && line.contains("wrong: temperature")),
            "{}",
            doctor.out
        );
    }
    let metrics = gaugefs(&["metrics", &at]).out;
    assert_eq!(metrics.matches("rule=\"temperature\"").count(), 512);
    // Another test's look at all mounts may hold one.
    for mount in [&few, &at] {
        within("unmounted", || gaugefs(&["umount", mount]).code == Some(0));
    }
}

/// The values of several polls count, also of those before and after a gauge that does not answer.
#[test]
fn sick_simulated_gauges_are_found() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    for (chip, knob, rule) in [
        ("bq34z100-g1", "thermistor=out", "temperature"),
        ("bq27441-g1", "no_initcomp=on", "measures-nothing"),
        ("bq34z100-g1", "reset_every_s=3", "resets-in-a-row"),
    ] {
        let at = folder.file(rule);
        gaugefs(&["mount", "--sim", chip, "--poll", "0.5", "--sim-set", knob, &at]).done();
        let gauge = format!("{at}/BAT0");
        within(rule, || read(&gauge, "gauge/check").contains(&format!("wrong\t{rule}\t")));
        gaugefs(&["umount", &at]).done();
    }
}
