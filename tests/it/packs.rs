// SPDX-License-Identifier: MIT

//! A Smart Battery in a mount: every command and every file, after which the pack has been sent nothing but command codes.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use nix::errno::Errno;

use super::room::{Folder, can_mount, command, gaugefs, run, within};

/// Every file below a folder, `sim/` left out: its knobs are turned by no program.
fn files(folder: &Path, into: &mut Vec<std::path::PathBuf>) {
    let mut entries: Vec<_> =
        fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")).collect();
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        match entry.file_type().expect("a type") {
            kind if kind.is_dir() && entry.file_name() != "sim" => files(&entry.path(), into),
            kind if kind.is_file() => into.push(entry.path()),
            _ => {}
        }
    }
}

fn errno(outcome: std::io::Result<()>) -> Option<i32> {
    outcome.err().and_then(|error| error.raw_os_error())
}

#[test]
fn no_command_and_no_file_writes_to_a_smart_battery() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", "sbs", "--poll", "0.5", &at]).done();
    let gauge = format!("{at}/BAT0");
    let cat = |name: &str| fs::read_to_string(format!("{gauge}/{name}")).expect(name).trim().to_string();
    assert_eq!(
        [cat("manufacturer"), cat("model_name"), cat("gauge/pec")],
        ["Sim Cells", "SIM-4S2P", "checked"]
    );
    assert_eq!([cat("gauge/battery_status"), cat("gauge/registers/cell_voltage1")], ["INIT DSG", "3855"]);

    let listed = gaugefs(&["list", "--json"]).out;
    assert!(listed.contains("\"serial\":\"0x1a2b\""), "{listed}");

    for command in [
        &["top", "--json", "--count", "1", &at][..],
        &["log", "--count", "2", &gauge],
        &["metrics", &at],
        &["check", &gauge],
        &["wait", &gauge, "capacity>1"],
        &["report", "-o", &folder.file("report.txt"), &gauge],
    ] {
        gaugefs(command).done();
    }
    let image = folder.file("image.toml");
    fs::write(&image, "chip = \"bq34z100-g1\"\n").expect("a file");
    let [key, old, new] = [
        ("key", "authentication = 0123456789abcdeffedcba9876543210\n"),
        ("old", "unseal = 0x04143672\n"),
        ("new", "unseal = 0x12345678\n"),
    ]
    .map(|(name, line)| {
        let file = folder.file(name);
        fs::write(&file, line).expect("a file");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).expect("its mode");
        file
    });
    for command in [
        &["set", &gauge, "design-capacity=1000"][..],
        &["get", &gauge, "design-capacity"],
        &["export", &gauge],
        &["import", &gauge, &image],
        &["calibrate", &gauge, "board-offset"],
        &["auth", &gauge, "--key-file", &key],
        &["keys", "change", "--key-file", &old, "--new-key-file", &new, &gauge, "unseal"],
    ] {
        let ran = gaugefs(command);
        assert_eq!(ran.code, Some(1), "{command:?}: {}", ran.err);
        assert!(ran.err.contains("a Smart Battery is only read"), "{command:?}: {}", ran.err);
    }

    let mut all = Vec::new();
    files(Path::new(&gauge), &mut all);
    assert!(all.len() > 60, "{}", all.len());
    let mut refused = 0;
    for path in &all {
        let _ = fs::read(path);
        for text in ["0x0010", "sealed", "unsealed", "1"] {
            refused += u32::from(fs::write(path, text).is_err());
        }
    }
    assert!(refused > 3 * all.len() as u32, "{refused} of {}", all.len());
    assert_eq!(errno(fs::write(format!("{gauge}/gauge/control"), "0x0010")), Some(Errno::EPERM as i32));
    for absent in ["df", "gauge/seal", "gauge/keys", "gauge/calibrate", "gauge/control_status"] {
        assert!(!Path::new(&gauge).join(absent).exists(), "{absent}");
    }

    assert_eq!([cat("sim/written"), cat("sim/battery_mode")], ["0", "0x0000"]);
    fs::write(format!("{gauge}/sim/power"), "off").expect("a knob");
    within("it is gone", || cat("present") == "0");
    let error = cat("gauge/last_error");
    assert!(error.contains("woken by a charger's voltage"), "{error}");
    gaugefs(&["umount", &at]).done();
}

/// With all that it shows, its packet error codes and its serial number included.
#[test]
fn a_recording_and_a_report_of_a_pack_are_its_replay() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let [trace, report] = ["trace", "report"].map(|name| folder.file(name));
    let shown = |what: &str| {
        let names = [
            "manufacturer",
            "model_name",
            "serial_number",
            "technology",
            "capacity",
            "charge_full",
            "voltage_now",
            "temp",
            "cycle_count",
            "manufacture_year",
            "gauge/pec",
            "gauge/battery_status",
            "gauge/registers/charging_voltage",
            "gauge/registers/cell_voltage1",
        ];
        let cat = |name: &str| fs::read_to_string(format!("{at}/BAT0/{name}"));
        // Not all of them change at each poll.
        within("all of it has been read", || names.iter().all(|name| cat(name).is_ok()));
        names.map(|name| cat(name).unwrap_or_else(|error| panic!("{what}: {name}: {error}")))
    };
    gaugefs(&["mount", "--sim", "sbs", "--poll", "0.5", "--trace", &trace, &at]).done();
    let polls = || fs::read_to_string(format!("{at}/BAT0/gauge/statistics/polls")).expect("a count");
    within("some polls", || polls().trim().parse::<u32>().is_ok_and(|polls| polls > 3));
    let live = shown("live");
    gaugefs(&["report", "-o", &report, &format!("{at}/BAT0")]).done();
    gaugefs(&["umount", &at]).done();
    for file in [&trace, &report] {
        gaugefs(&["mount", "--replay", file, "--poll", "0.5", &at]).done();
        assert_eq!(shown(file), live, "{file}");
        assert_eq!(fs::read_to_string(format!("{at}/BAT0/gauge/last_error")).expect("a file"), "");
        assert_eq!(errno(fs::write(format!("{at}/BAT0/gauge/control"), "1")), Some(Errno::EROFS as i32));
        gaugefs(&["umount", &at]).done();
    }
}

/// The kernel's driver, or a laptop, changes the unit of capacities. Numbers of two units were compared.
#[test]
fn regression_a_pack_in_another_mode_was_taken_for_another_pack() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, log] = ["m", "log"].map(|name| folder.file(name));
    gaugefs(&["mount", "--sim", "sbs", "--poll", "0.5", "--log", &log, &at]).done();
    let has = |name: &str| fs::read_to_string(format!("{at}/BAT0/{name}")).is_ok();
    for (mode, shown, other) in [
        ("0x8000", "energy_full_design", "charge_full_design"),
        ("0x0000", "charge_full_design", "energy_full_design"),
    ] {
        fs::write(format!("{at}/BAT0/sim/battery_mode"), mode).expect("a knob");
        within("its capacities are in the other unit", || has(shown) && !has(other));
    }
    let said = || fs::read_to_string(&log).expect("a log");
    assert!(!said().contains("another pack"), "{}", said());
    gaugefs(&["umount", &at]).done();
}

/// Reads, writes and commands of a pack that is asked: only questions reach it, and it is not harmed.
#[test]
fn an_asked_pack_is_sent_its_questions_and_tells_why_it_has_failed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let options = ["mount", "--sim", "bq40z50-r2", "--poll", "0.5", "--sim-set", "pf_status=0x00000801"];
    gaugefs(&[&options[..], &[&at]].concat()).done();
    let gauge = format!("{at}/BAT0");
    let cat = |name: &str| fs::read_to_string(format!("{gauge}/{name}")).expect(name).trim().to_string();
    assert!(
        cat("gauge/questions")
            .starts_with("not asked: with --ask-the-pack these codes are sent\n0x0001 DeviceType")
    );
    assert!(!Path::new(&gauge).join("gauge/pfstatus").exists());
    assert_eq!((cat("sim/written"), cat("health")), ("0".into(), "Good".into()));
    gaugefs(&["umount", &at]).done();

    gaugefs(&[&options[..], &["--ask-the-pack", &at]].concat()).done();
    within("it is asked", || Path::new(&gauge).join("gauge/pfstatus").exists());
    assert_eq!([cat("gauge/pfstatus"), cat("health")], ["VIMR SUV", "Unspecified failure"]);
    assert_eq!(cat("gauge/operation_status"), "XCHG XDSG PF SEC1 SEC0 PRES");
    assert_eq!(cat("gauge/registers/dastatus1_cell_voltage1"), "3855");
    let reasons = cat("gauge/permanent_failure");
    assert!(reasons.contains("SUV: a cell was far below") && reasons.lines().count() == 2, "{reasons}");
    let error = cat("gauge/last_error");
    assert!(
        error.contains("out of use for good, by a permanent failure: VIMR (") && error.contains("SUV ("),
        "{error}"
    );
    let metrics = gaugefs(&["metrics", &at]).done();
    assert!(
        metrics.contains("gaugefs_permanent_failure_info{") && metrics.contains("reason=\"SUV\""),
        "{metrics}"
    );
    let top = gaugefs(&["top", "--json", "--count", "1", &at]).done();
    assert!(top.contains("permanent failure: VIMR"), "{top}");
    let file = folder.file("report.txt");
    gaugefs(&["report", "-o", &file, &gauge]).done();
    let report = fs::read_to_string(&file).expect("a report");
    assert!(report.contains("Permanent failure: SUV, a cell was far below"), "{report}");

    let key = folder.file("key");
    fs::write(&key, "unseal = 0414 3672\n").expect("a file");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).expect("its mode");
    for command in [
        &["set", &gauge, "design-capacity=1000"][..],
        &["export", &gauge],
        &["calibrate", &gauge, "board-offset"],
        &["keys", &gauge, "--key-file", &key],
        &["check", &gauge],
    ] {
        gaugefs(command);
    }
    let mut all = Vec::new();
    files(Path::new(&gauge), &mut all);
    assert!(all.len() > 180, "{}", all.len());
    for path in &all {
        let _ = fs::read(path);
        for text in ["0x0010", "0x0029", "unsealed", "1"] {
            let _ = fs::write(path, text);
        }
    }
    assert_eq!(errno(fs::write(format!("{gauge}/gauge/control"), "0x0010")), Some(Errno::EPERM as i32));
    assert_eq!(
        [cat("sim/harm"), cat("sim/battery_mode"), cat("gauge/pfstatus")],
        ["0", "0x0000", "VIMR SUV"]
    );

    fs::write(format!("{gauge}/sim/device_type"), "0x9e34").expect("a knob");
    within("asking ends", || cat("gauge/questions").starts_with("ended: it is another part, of type 0x9e34"));
    within("its status is not shown", || !Path::new(&gauge).join("gauge/pfstatus").exists());
    gaugefs(&["umount", &at]).done();
}

/// A chip of a file, and DeviceName() on a bus where none is named.
#[test]
fn a_part_that_is_asked_is_named_by_its_user_or_by_its_pack() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, file, bus] = ["m", "gauges.toml", "bus"].map(|name| folder.file(name));
    fs::write(&file, format!("[[gauge]]\nbus = '{bus}'\nchip = \"bq40z50-r2\"\nask-the-pack = true\n"))
        .expect("a file");
    let script = r#"
mount=$1; shift
"$gaugefs" mount "$@" "$mount" || exit
head -n 1 "$mount"/BAT0/gauge/questions
"$gaugefs" umount "$mount"
"#;
    let on_bus = ["--bus", &bus, "--address", "0x0b"];
    let answers = "answers by blocks at 0x44: firmware 2.11, build 52\n";
    for (simulated, options, first) in [
        ("bq40z50-r2", &[&on_bus[..], &["--ask-the-pack"]].concat()[..], answers),
        ("bq40z50-r2", &["--config", &file], answers),
        ("bq40z50-r2", &on_bus, "not asked: with --ask-the-pack these codes are sent\n"),
        (
            "bq40z50-r2",
            &["--bus", &bus, "--chip", "bq4050", "--ask-the-pack"],
            "ended: it is another part, of type 0x4500\n",
        ),
        (
            "sbs",
            &[&on_bus[..], &["--ask-the-pack"]].concat(),
            "not asked: name TI's gauge in the pack, such as --chip bq40z50-r2; `gaugefs chips` has all\n",
        ),
    ] {
        let bash = ["--", "bash", "-c", script, "bash", &at];
        let mut sim = command(&[&["sim", simulated, "--fast", &bus], &bash[..], options].concat());
        sim.env("gaugefs", env!("CARGO_BIN_EXE_gaugefs"));
        assert_eq!(run(sim).done(), first, "{options:?}");
    }
}
