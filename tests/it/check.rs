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
