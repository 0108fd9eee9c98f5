// SPDX-License-Identifier: MIT

//! `gaugefs-station`: a station with simulated packs that are kept in files. The tests of its rules and faults are in
//! `crates/gauge-station/src/station/tests.rs`.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::Stdio;

use ti_gauge::chip::Chip;
use ti_gauge::image::Image;

use crate::room::{CHIP, Folder, STATION, command_of, gaugefs, gaugefs_station, within};

/// An image of two values, and a station of two benches.
fn station(folder: &Folder, lines: &str) -> [String; 2] {
    let (image, station) = (folder.file("golden.toml"), folder.file("line1.toml"));
    let text = format!(
        "chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n[data]\ndevice-name = \"PACK\"\n"
    );
    let name = Chip::by_name(CHIP).and_then(|chip| chip.subclass(48).map(|row| chip.class_dir(row)));
    fs::write(&image, text.replace("[data]", &format!("[{}]", name.expect("a class")))).expect("a file");
    let text = format!("[station]\nserial = 'counter'\nstate-dir = 'state'\n{lines}\n[defaults]\n");
    let gauge =
        |name: &str| format!("[[gauge]]\nname = '{name}'\nsim = '{CHIP}'\nsim-state = '{name}-%.flash'\n");
    fs::write(&station, text + &gauge("LEFT") + &gauge("RIGHT")).expect("a file");
    [image, station]
}

fn run(files: &[String; 2], more: &[&str]) -> Vec<String> {
    let [image, station] = files;
    let arguments = ["program", "--image", image, "--station", station];
    arguments.iter().chain(more).map(ToString::to_string).collect()
}

fn lines(folder: &Folder) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(folder.file("line1.jsonl")).unwrap_or_default();
    // The last one may not be complete.
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

#[test]
fn a_station_is_checked_without_touching_anything() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let arguments = run(&files, &["--check"]);
    let shown = gaugefs_station(&arguments.iter().map(String::as_str).collect::<Vec<_>>()).done();
    assert!(shown.starts_with("image golden.toml for a bq34z100-G1, values: 2, SHA-256 "), "{shown}");
    assert!(shown.contains("\nLEFT: simulated gauge kept in ") && shown.contains("\nRIGHT: "), "{shown}");
    assert!(
        !Path::new(&folder.file("line1.jsonl")).exists() && !Path::new(&folder.file("LEFT-1.flash")).exists()
    );
    let files = station(&folder, "sael = true");
    let arguments = run(&files, &["--check"]);
    gaugefs_station(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
        .failed(&["line1.toml: line 4: sael: unknown key; did you mean `seal`?"]);
}

#[test]
fn regression_a_check_of_a_station_did_not_look_for_its_buses() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let text = fs::read_to_string(&files[1]).expect("the station");
    let text = text.replace(&format!("sim = '{CHIP}'\nsim-state = 'RIGHT-%.flash'"), "bus = '/dev/i2c-4077'");
    fs::write(&files[1], text).expect("a file");
    let arguments = run(&files, &["--check"]);
    let ran = gaugefs_station(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(ran.code == Some(1) && ran.out.contains("\nRIGHT: /dev/i2c-4077 address 0x55\n"), "{}", ran.out);
    assert!(ran.err.contains("RIGHT: /dev/i2c-4077: no such bus"), "{}", ran.err);
    assert_eq!(ran.err.lines().count(), 1, "LEFT has its pack: {}", ran.err);
}

#[test]
fn packs_on_two_buses_are_programmed_and_recognised() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let run = |code| {
        let arguments = run(&files, &["--count", "2", "--fast"]);
        let ran = gaugefs_station(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(ran.code, Some(code), "{}{}", ran.out, ran.err);
        ran.out
    };
    let said = run(0);
    assert_eq!(said.lines().filter(|line| line.starts_with("PASS ")).count(), 2, "{said}");
    assert!(said.contains("serial 1 (") && said.contains("serial 2 ("), "{said}");
    let found = lines(&folder);
    assert_eq!(found.len(), 4);
    for line in found.iter().filter(|line| line["event"] == "pass") {
        assert!(line["changes"].as_array().is_some_and(|list| list.len() >= 2), "{line}");
        let after = folder.file("line1.images") + "/" + line["after"].as_str().expect("an image");
        let image = Image::open(Path::new(&after), None).expect("an image");
        let serial =
            image.entries.iter().find(|entry| entry.parameter.name == "Serial Number").expect("it has one");
        assert_eq!(serial.text(), line["serial"].as_str().expect("a number"));
    }
    let record = folder.file("line1.jsonl");
    let shown = gaugefs_station(&["records", &record]).done();
    assert!(shown.starts_with("day ") && shown.lines().any(|line| line.starts_with("all ")), "{shown}");
    let table = gaugefs_station(&["records", "--csv", &record]).done();
    assert!(table.starts_with("number,time,station,slot,") && table.lines().count() == 3, "{table}");
    // The same files are the same packs.
    let said = run(1);
    let reasons = gaugefs_station(&["records", "--by", "reason", &record]).done();
    assert!(reasons.lines().any(|line| line.starts_with("2 ") && line.contains("  reading  ")), "{reasons}");
    assert_eq!(said.matches("it was programmed before as serial number ").count(), 2, "{said}");
}

/// Killed in the middle, as by a loss of power.
#[test]
fn a_station_that_was_killed_records_the_failure_when_it_starts_again() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let arguments = run(&files, &["--count", "2"]);
    let mut child = command_of(STATION, &arguments.iter().map(String::as_str).collect::<Vec<_>>())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("it runs");
    let begun = || lines(&folder).iter().filter(|line| line["event"] == "begun").count() == 2;
    within("both packs are begun", begun);
    child.kill().and_then(|()| child.wait()).expect("it is killed");
    let ended = lines(&folder).iter().filter(|line| line["event"] != "begun").count();
    let ran = gaugefs_station(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let found = lines(&folder);
    for begun in found.iter().filter(|line| line["event"] == "begun") {
        let ends = found.iter().filter(|line| line["number"] == begun["number"] && line["event"] != "begun");
        assert_eq!(ends.count(), 1, "{begun}");
    }
    assert_eq!(ran.out.matches("the station was stopped while it programmed this pack").count(), 2 - ended);
    // The packs pass now, with new numbers, unless a write was interrupted that nothing shows to be this pack's.
    let is_held = ran.out.contains("was interrupted and is not settled");
    assert!(ended > 0 || is_held || ran.out.contains("PASS LEFT serial "), "{}{}", ran.out, ran.err);
    assert!(!ran.out.contains("PASS LEFT serial 1 ") && !ran.out.contains("PASS RIGHT serial 1 "));
}

#[test]
fn serial_numbers_are_read_from_standard_input() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let text = fs::read_to_string(&files[1]).expect("the station").replace("'counter'", "'input'");
    fs::write(&files[1], text).expect("a file");
    let arguments = run(&files, &["--once", "--fast"]);
    let mut child = command_of(STATION, &arguments.iter().map(String::as_str).collect::<Vec<_>>())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    child.stdin.take().expect("a pipe").write_all(b"\n0x4711\n").expect("it reads");
    let output = child.wait_with_output().expect("it ends");
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(
        output.status.success() && out.starts_with("PASS ") && out.contains(" serial 0x4711 "),
        "{out}{err}"
    );
    assert!(err.contains(": scan the serial number\n") && err.contains("the line is empty; scan"), "{err}");
}

/// A line that was scanned for nobody went to the next pack, at a terminal without a screen; and a byte of a scanner that is no
/// text ended the input.
#[test]
fn regression_a_station_took_a_line_that_was_scanned_too_early() {
    let folder = Folder::new();
    let files = station(&folder, "");
    let text = fs::read_to_string(&files[1]).expect("the station").replace("'counter'", "'input'");
    let text =
        text.replace("[[gauge]]\nname = 'RIGHT'", "[[gauge]]\n# 'RIGHT'").replace("sim-state = ", "# ");
    let (text, _) = text.split_once("[[gauge]]\n# 'RIGHT'").expect("two slots");
    fs::write(&files[1], text.replace("[station]", "[station]\npacks = 2")).expect("a file");
    let terminal = nix::pty::openpty(None, None).expect("a terminal");
    let arguments = run(&files, &["--fast"]);
    let mut child = command_of(STATION, &arguments.iter().map(String::as_str).collect::<Vec<_>>())
        .stdin(terminal.slave)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    let mut keys = fs::File::from(terminal.master);
    let mut asked = BufReader::new(child.stderr.take().expect("a pipe")).lines().map_while(Result::ok);
    let mut until = |what: &str| {
        let is_it = |line: String| {
            assert!(!line.contains("the line is empty"), "{line}");
            line.contains(what)
        };
        assert!(asked.any(is_it), "{what}");
    };
    until("LEFT: scan the serial number");
    keys.write_all(b"caf\xe9\n").expect("it reads");
    until("the line is no text in UTF-8; scan the serial number, again");
    // The second end of a scanner's line is none.
    keys.write_all(b"\n").expect("it reads");
    // The second line comes before the second pack.
    keys.write_all(b"1\n99\n").expect("it reads");
    until("LEFT: scan the serial number");
    keys.write_all(b"2\n").expect("it reads");
    until("packs: 2, passed: 2");
    let output = child.wait_with_output().expect("it ends");
    let out = String::from_utf8_lossy(&output.stdout);
    assert!(
        out.contains("PASS LEFT serial 1 (0x0001)") && out.contains("PASS LEFT serial 2 (0x0002)"),
        "{out}"
    );
}

/// Whoever types what earlier versions had is told which program has it, whatever follows.
#[test]
fn gaugefs_says_which_program_is_the_station() {
    for command in ["program", "records"] {
        for more in
            [&[][..], &["--help"], &["--image", "golden.toml", "--station", "line1.toml"], &["-", "x"]]
        {
            let line = [&[command], more].concat();
            let says = format!("gaugefs: {command}: this is `gaugefs-station {command}` now, ");
            gaugefs(&line).troubled(&[&says]);
        }
        let help = gaugefs_station(&[command, "--help"]).done();
        assert!(help.contains(&format!("Usage: gaugefs-station {command} ")), "{help}");
    }
    let help = gaugefs(&["--help"]).done();
    assert!(!help.contains("program  ") && !help.contains("records  "), "{help}");
    let version = gaugefs_station(&["--version"]).done();
    assert_eq!(version, gaugefs(&["--version"]).done().replace("gaugefs", "gaugefs-station"));
    // A misuse is told in the name of this program.
    let misspelt = gaugefs_station(&["progam"]);
    assert!(misspelt.code == Some(2) && misspelt.err.starts_with("gaugefs-station: "), "{}", misspelt.err);
    assert!(misspelt.err.contains("a similar subcommand exists: 'program'"), "{}", misspelt.err);
}
