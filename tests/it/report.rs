// SPDX-License-Identifier: MIT

//! `gaugefs report`: one file about a gauge that can be given away, and replayed.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use crate::room::{CHIP, Folder, as_nobody, can_mount, command, gaugefs, read, run, shown, within};

/// Words of keys and serial numbers, as a person writes them and as they are on the bus.
fn lacks(text: &str, words: &[&str]) {
    let tight: String = text.to_lowercase().split_whitespace().collect();
    for word in words {
        // A number is none in the middle of another one, such as a time.
        let is_number = word.bytes().all(|byte| byte.is_ascii_digit());
        let is_digit = |byte: Option<&u8>| is_number && byte.is_some_and(u8::is_ascii_digit);
        let is_there = |(at, _): (usize, &str)| {
            !is_digit(tight.as_bytes()[..at].last()) && !is_digit(tight.as_bytes().get(at + word.len()))
        };
        assert!(!tight.match_indices(word).any(is_there), "{word} is in\n{text}");
    }
}

#[test]
fn a_report_of_a_mounted_gauge_replays_with_the_same_attributes() {
    if !can_mount() {
        return;
    }
    // Each waits for polls most of the time.
    std::thread::scope(|scope| {
        for (chip, parameter) in
            [(CHIP, Some("df/2/0")), ("bq27441-g1", None), ("bq35100", None), ("bq27541", None)]
        {
            scope.spawn(move || replays_with_the_same_attributes(chip, parameter));
        }
    });
}

fn replays_with_the_same_attributes(chip: &str, parameter: Option<&str>) {
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("report.txt"));
    let gauge = format!("{at}/BAT0");
    // The mount of an open gauge reads more of data flash by itself than the report has.
    let seal: &[&str] = if chip == "bq27541" { &[] } else { &["--sim-seal", "sealed"] };
    gaugefs(&[&["mount", "--sim", chip, "--poll", "0.5", &at], seal].concat()).done();
    fs::write(Path::new(&gauge).join("sim/load_ma"), "700").expect("a knob");
    within("the load is seen", || {
        fs::read_to_string(Path::new(&gauge).join("current_now")).is_ok_and(|now| now.trim() != "0")
            || chip == "bq35100"
    });
    let seal = || fs::read_to_string(Path::new(&gauge).join("sim/seal")).unwrap_or_default();
    let found = seal();
    // From now on all polls are equal.
    fs::write(Path::new(&gauge).join("sim/speed"), "0").expect("a knob");
    assert_eq!(gaugefs(&["report", &gauge, "-o", &file]).done(), format!("{file}\n"), "{chip}");
    let value = parameter.map(|name| read(&gauge, name));
    assert_eq!(seal(), found, "{chip}");
    let polls = || read(&gauge, "gauge/statistics/polls").parse::<u64>().expect("a number");
    let enough = polls() + 12;
    within("all tiers", || polls() >= enough);
    // A serial number is masked.
    let shown = || {
        let mut shown = shown(&gauge);
        shown.retain(|(name, _)| !name.ends_with("serial_number"));
        for (_, text) in shown.iter_mut().filter(|(name, _)| name == "./uevent") {
            let lines = text.lines().filter(|line| !line.starts_with("POWER_SUPPLY_SERIAL_NUMBER="));
            *text = lines.collect::<Vec<_>>().join("\n");
        }
        shown
    };
    let recorded = shown();
    gaugefs(&["umount", &at]).done();

    gaugefs(&["mount", "--replay", &file, "--poll", "0.5", &at]).done();
    within("all polls", || shown() == recorded);
    if let (Some(name), Some(value)) = (parameter, value) {
        assert_eq!(read(&gauge, name), value, "{chip}");
    }
    assert_eq!(read(&gauge, "gauge/last_error"), "", "{chip}");
    // A recording is read-only, and its report is the file that there is.
    gaugefs(&["report", &gauge, "-o", &folder.file("again")]).failed(&["the mount is read-only", "--bus"]);
    gaugefs(&["umount", &at]).done();
}

#[test]
fn keys_serial_numbers_and_texts_are_not_in_a_report() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, keys) = (folder.file("m"), folder.file("keys"));
    let gauge = format!("{at}/BAT0");
    fs::write(&keys, "unseal = 8d3e b7c5\n").expect("a key file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    let state = folder.file("state of somebody");
    let sim = ["mount", "--sim", CHIP, "--sim-key", "8d3e b7c5", "--key-file", &keys, "--sim-state", &state];
    gaugefs(&[&sim[..], &[&at]].concat()).done();
    let write = |name: &str, text: &str| fs::write(Path::new(&gauge).join(name), text).expect("a write");
    write("df/48/4", "0xbeef");
    write("df/48/43", "Owner Ltd");
    // Found open, the gauge compares its marks with those of before: they are among the serial numbers.
    for seal in ["sealed", "unsealed", "full-access"] {
        write("gauge/seal", seal);
        let file = folder.file(seal);
        gaugefs(&["report", &gauge, "--output", &file]).done();
        let text = fs::read_to_string(&file).expect("the report");
        assert_eq!(read(&gauge, "gauge/seal"), seal);
        assert!(
            text.contains("SerialNumber() = not shown") && text.contains("Safety (Configuration), "),
            "{text}"
        );
        assert_eq!(text.contains("; hidden"), seal == "sealed", "{text}");
        lacks(&text, &["8d3eb7c5", "3e8dc5b7", "aa003e8d", "aa00c5b7", "aa00ffff", "beef", "efbe", "48879"]);
        lacks(&text, &["4f776e6572", "owner", "somebody", &keys.to_lowercase().replace(' ', "")]);
    }
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_sealed_gauge_without_a_key_is_reported_without_data_flash() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("report"));
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", CHIP, "--no-default-keys", &at]).done();
    let ran = gaugefs(&["report", &gauge, "-o", &file]);
    assert_eq!(ran.code, Some(3), "{}", ran.err);
    assert!(
        ran.err.contains("data flash was not read: the gauge is sealed and no key opens it"),
        "{}",
        ran.err
    );
    gaugefs(&["umount", &at]).done();
    let text = fs::read_to_string(&file).expect("the report");
    assert!(text.contains("\n; Data flash: not read: the gauge is sealed"), "{text}");
    gaugefs(&["mount", "--replay", &file, &at]).done();
    assert_eq!(read(&gauge, "gauge/seal"), "sealed");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_gauge_that_is_not_mounted_is_reported() {
    let folder = Folder::new();
    let file = folder.file("report");
    let run = |arguments: &[&str]| {
        let mut command = command(arguments);
        command.current_dir(folder.file(""));
        run(command)
    };
    assert_eq!(run(&["report", "--sim", CHIP]).done(), format!("gaugefs-report-{CHIP}.txt\n"));
    let text = fs::read_to_string(folder.file(&format!("gaugefs-report-{CHIP}.txt"))).expect("the report");
    assert!(text.starts_with(&format!("; gaugefs: {CHIP} on simulated gauge, 20")), "{text}");
    assert!(text.contains("\n; Adapter: none\n") && text.contains("\n; hidden\n"), "{text}");

    let ran = run(&["report", "--sim", CHIP, "--no-default-keys", "-o", &file]);
    assert_eq!(ran.code, Some(3), "{}", ran.err);
    run(&["report", "--bus", "/dev/i2c-999"]).failed(&["/dev/i2c-999: no such bus"]);
    run(&["report", "--bus", "/dev/null"]).failed(&["/dev/null: not an I2C bus"]);
}

#[test]
fn no_gauge_is_no_report() {
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("report"));
    let report = |gauge: &str| gaugefs(&["report", gauge, "-o", &file]);
    report(&folder.file("none")).failed(&["not a mounted gauge", "--bus"]);
    report(&folder.file("")).failed(&["not a mounted gauge", "--bus"]);
    if can_mount() {
        gaugefs(&["mount", "--sim", CHIP, &at]).done();
        let gauge = format!("{at}/BAT0");
        fs::write(Path::new(&gauge).join("sim/power"), "off").expect("a knob");
        report(&gauge).failed(&["not acknowledged"]);
        assert_eq!(read(&gauge, "gauge/report"), "");
        fs::write(Path::new(&gauge).join("sim/power"), "on").expect("a knob");
        gaugefs(&["umount", &at]).done();
    }
    assert!(!Path::new(&file).exists());
}

#[test]
fn a_file_is_replaced_only_when_asked_for_and_never_left_in_part() {
    let folder = Folder::new();
    let file = folder.file("report");
    fs::write(&file, "mine\n").expect("a file");
    gaugefs(&["report", "--sim", CHIP, "-o", &file]).failed(&["it exists", "--force"]);
    assert_eq!(fs::read_to_string(&file).expect("it"), "mine\n");
    gaugefs(&["report", "--sim", CHIP, "--force", "-o", &file]).done();
    assert!(fs::read_to_string(&file).expect("it").starts_with("; gaugefs: "));
    gaugefs(&["report", "--sim", CHIP, "--force", "-o", "/dev/full"])
        .failed(&["/dev/full: cannot write it", "No space left"]);
    gaugefs(&["report", "--sim", CHIP, "-o", &folder.file("no/folder")])
        .failed(&["cannot write it", "No such file"]);

    // A file system on which there is no room for all of it.
    let half = folder.file("half");
    let mut limited = Command::new("sh");
    let line = r#"trap '' XFSZ; ulimit -f 1; exec "$0" report --sim "$1" -o "$2""#;
    limited.args(["-c", line, env!("CARGO_BIN_EXE_gaugefs"), CHIP, &half]);
    run(limited).failed(&["half: cannot write it", "File too large"]);
    assert!(!Path::new(&half).exists());
}

#[test]
fn who_may_not_use_the_gauge_gets_no_report() {
    if !can_mount() || !nix::unistd::geteuid().is_root() {
        eprintln!("SKIPPED: another user is needed");
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("report"));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    let other = as_nobody(&folder, &["report", &gauge, "-o", &file]);
    run(other).failed(&["only the mount's owner and group may", "Permission denied"]);
    let other = as_nobody(&folder, &["report", "--sim", CHIP, "-o", &file]);
    run(other).failed(&["cannot write it", "Permission denied"]);
    assert!(!Path::new(&file).exists());
    gaugefs(&["umount", &at]).done();
}
