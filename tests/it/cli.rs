// SPDX-License-Identifier: MIT

//! The command line: what it prints, its exit codes, and the life of a mount.
//!
//! The output is compared with the files in `golden/`. After an intended change, run the tests once with
//! GAUGEFS_GOLDEN=write and read the difference before you commit it.

use std::fmt::Write as _;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use ti_gauge::chip::{Chip, FLAT, Kind, Parameter, Range, kebab_case};

use crate::drawn::one_in;
use crate::room::{
    CHIP, Folder, Foreground, Ran, as_nobody, can_mount, command, gaugefs, gaugefs_station, in_real_time,
    read, run, same_as_golden, shown, stop, users_can_mount, within,
};

#[cfg(feature = "screen")]
mod acting;
#[cfg(feature = "screen")]
mod calibrating;
mod watching;

/// Compares the output and exit codes of command lines with a file of `golden/`.
#[track_caller]
fn golden(name: &str, lines: &[&str]) {
    let mut now = String::new();
    for line in lines {
        let Ran { code, out, err, .. } = gaugefs(&line.split_ascii_whitespace().collect::<Vec<_>>());
        writeln!(now, "$ gaugefs {line}\n{out}{err}=> {}\n", code.expect("it exits")).expect("a string");
    }
    same_as_golden(name, &now);
}

#[test]
fn help_texts() {
    golden(
        "help",
        &[
            "--help",
            "mount --help",
            "umount --help",
            "list --help",
            "probe --help",
            "rescue --help",
            "chips --help",
            "report --help",
            "get --help",
            "set --help",
            "export --help",
            "import --help",
            "diff --help",
            "lint --help",
            "bringup --help",
            "calibrate --help",
            "auth --help",
            "keys --help",
            "keys change --help",
            "doctor --help",
            "completions --help",
            "top --help",
            "learn --help",
            "log --help",
            "plot --help",
            "wait --help",
            "watch --help",
            "metrics --help",
            "events --help",
        ],
    );
}

#[test]
fn help_texts_of_the_station() {
    let mut now = String::new();
    for line in ["--help", "program --help", "records --help", "completions --help", "man --help", "program"]
    {
        let Ran { code, out, err, .. } = gaugefs_station(&line.split_ascii_whitespace().collect::<Vec<_>>());
        writeln!(now, "$ gaugefs-station {line}\n{out}{err}=> {}\n", code.expect("it exits"))
            .expect("a string");
    }
    same_as_golden("station", &now);
}

#[test]
fn chips_are_listed() {
    golden(
        "chips",
        &[
            "chips",
            "chips --json",
            "chips bq34z100-g1",
            "chips bq27000",
            "chips --json BQ34110",
            "chips bq27545-g1 --rows",
        ],
    );
}

#[test]
fn misuse_has_exit_code_2() {
    // The usage that is printed repeats the options that were typed.
    let _time = in_real_time();
    golden(
        "misuse",
        &[
            "frob",
            "mount /tmp/x",
            "mount --sim",
            "mount --sim bq34z100-g1",
            "mount --sim bq99 /tmp/x",
            "mount --sim bq34z100-g1 --bus /dev/i2c-1 /tmp/x",
            "mount --sim bq34z100-g1 --poll 0.1 /tmp/x",
            "mount --sim bq34z100-g1 --name a/b /tmp/x",
            "mount --sim bq34z100-g1 --ac=a/b /tmp/x",
            "mount --sim bq34z100-g1 --sim-key 0414 /tmp/x",
            "mount --sim bq34z100-g1 --energy-scale 0 /tmp/x",
            "mount --sim bq34z100-g1 --group no-such-group /tmp/x",
            "mount /dev/i2c-1 /tmp/x",
            "probe /dev/i2c-1",
            "mount --sim bq34z10-g1 /tmp/x",
            "mount --sim bq34z100-g1 -x /tmp/x",
            "mount --sim bq34z100-g1 /tmp/x /tmp/y",
            "mount --bus /dev/i2c-1 --adress 0x55 /tmp/x",
            "mount --bus /dev/i2c-1 --address 0xaa /tmp/x",
            "mount --bus /dev/i2c-1 --address 55 /tmp/x",
            "mount --bus /dev/i2c-1 --address 0x5x /tmp/x",
            "mount --bus /dev/i2c-1 --sim-state /tmp/y /tmp/x",
            "mount --sim bq34z100-g1 --auth-order random /tmp/x",
            "mount --replay /tmp/y --bus /dev/i2c-1 /tmp/x",
            "mount --replay /tmp/y --trace /tmp/z /tmp/x",
            "mount --config /tmp/y --sim bq34z100-g1 /tmp/x",
            "mount --config /tmp/y --name PACK",
            "mount --sim bq34z100-g1 --check /tmp/x",
            "umount",
            "probe --address 0x55",
            "chips bq99",
            "report",
            "report /tmp/x --bus /dev/i2c-1",
            "report /tmp/x --key-file /tmp/y",
            "report --sim bq34z100-g1 --address 0x55",
            "export",
            "import /tmp/x",
            "import /tmp/x /tmp/y --exclude secrets",
            "diff /tmp/x /tmp/y --exclude secrets",
            "keys",
            "keys change /tmp/x",
            "keys change /tmp/x seal",
            "export --format hex /tmp/x",
            "diff /tmp/x",
            "lint",
            "lint --chip bq99 /tmp/x",
            "auth /tmp/x",
            "completions",
            "completions csh",
            "top --count 3",
            "top --interval 0",
            "learn",
            "log",
            "log /tmp/x --count 0",
            "plot",
            "plot /tmp/x --width 10",
        ],
    );
}

#[test]
fn failures_say_what_to_do() {
    gaugefs(&["probe", "--bus", "/dev/i2c-999"]).failed(&["/dev/i2c-999: no such bus"]);
    gaugefs(&["probe", "--bus", "/dev/null"]).failed(&["/dev/null: not an I2C bus"]);
    let at = Folder::new().file("m");
    gaugefs(&["mount", "--bus", "/dev/i2c-999", &at]).failed(&["no such bus"]);
    gaugefs(&["umount", "/proc"]).failed(&["/proc: proc", "not gaugefs"]);
    gaugefs(&["umount", "/etc"]).failed(&["/etc: no gaugefs is mounted there"]);
    let mount = |at| gaugefs(&["mount", "--sim", CHIP, at]);
    mount("/proc").failed(&["/proc: proc", "is mounted there"]);
    let folder = Folder::new();
    let file = folder.file("file");
    fs::write(&file, "").expect("a file");
    mount(&file).failed(&[&format!("{file}: not a folder")]);
}

#[test]
fn a_bus_without_permission_names_the_group_to_join() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let node = folder.file("i2c-250");
    // An adapter that no machine has: the mode is checked before the adapter is opened.
    let device = nix::sys::stat::makedev(89, 250);
    let mode = nix::sys::stat::Mode::from_bits_truncate(0o660);
    let made = nix::sys::stat::mknod(node.as_str(), nix::sys::stat::SFlag::S_IFCHR, mode, device);
    if made.is_err() {
        eprintln!("SKIPPED: no device node can be made without root; no forbidden bus was probed");
        return;
    }
    for (gid, says) in [(0, "no permission; run gaugefs as root"), (1, "join the group daemon")] {
        std::os::unix::fs::chown(&node, Some(0), Some(gid)).expect("its group");
        for arguments in [&["probe", "--bus", &node][..], &["mount", "--bus", &node, &folder.file("m")]] {
            let output = as_nobody(&folder, arguments).output().expect("gaugefs runs");
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{said}");
            assert!(said.starts_with(&format!("gaugefs: {node}")) && said.contains(says), "{said}");
        }
    }
}

#[test]
fn lint_and_diff_of_files() {
    // The golden file has the paths of the samples relative to the folder of the package.
    golden(
        "images",
        &[
            "lint tests/it/images/pack.toml",
            "lint tests/it/images/pack.toml --json",
            "lint tests/it/images/pack.gm.fs",
            "lint tests/it/images/pack.gm.fs --chip bq27441-g1",
            "lint tests/it/images/pack.gg.csv",
            "lint tests/it/images/outside.toml",
            "lint tests/it/images/rom.fs",
            "lint tests/it/images/chemistry.gm.fs",
            "lint tests/it/images/chemistry.gm.fs --raw",
            "lint tests/it/images/chemistry.gm.fs --raw --json",
            "lint tests/it/images/none",
            "diff tests/it/images/pack.toml tests/it/images/pack.toml",
            "diff tests/it/images/pack.toml tests/it/images/pack.gg.csv",
            "diff tests/it/images/pack.toml tests/it/images/pack.gg.csv --json",
            "diff tests/it/images/pack.toml tests/it/images/pack.gm.fs --chip bq27441-g1",
            "diff tests/it/images/pack.toml tests/it/images/none",
            "export tests/it/images/pack.toml",
        ],
    );
}

#[test]
fn every_mistake_of_a_file_is_told() {
    let folder = Folder::new();
    let file = folder.file("pack.toml");
    let text = "chip = \"bq34z100-g1\"\n[it-cgf]\nra-filter = 1\n[it-cfg]\ncell-terminate-voltage = 900\n\
                ra-fliter = 1\nload-select = \"low\"\n[safety]\not-chg = 99999\n";
    fs::write(&file, text).expect("a file");
    let lines = |ran: Ran| -> Vec<String> { ran.err.lines().map(str::to_string).collect() };
    let lint = gaugefs(&["lint", &file]);
    assert_eq!((lint.code, &*lint.out), (Some(1), ""));
    let says = [
        "line 2: a bq34z100-G1 has no class it-cgf; did you mean [it-cfg]?",
        "line 5: Cell Terminate Voltage: the value is outside 1000 to 3700 mV",
        "line 6: a bq34z100-G1 has no parameter it-cfg/ra-fliter; did you mean it-cfg/ra-filter?",
        "line 7: it-cfg/load-select: string, but U1 is expected",
        "line 9: OT Chg: the value is outside",
    ];
    let told = lines(lint);
    assert_eq!(told.len(), says.len(), "{told:#?}");
    for (told, says) in told.iter().zip(says) {
        assert!(told.starts_with(&format!("gaugefs: {file}: {says}")), "{told}");
    }
    // What is wrong with the values is not known before the file can be read.
    let diff = gaugefs(&["diff", &file, &file]);
    assert_eq!((diff.code, lines(diff).len()), (Some(2), 4));
    // However many there are.
    let many: String = (0..5000).map(|at| format!("x{at} = 1\n")).collect();
    fs::write(&file, format!("chip = \"bq34z100-g1\"\n[it-cfg]\n{many}")).expect("a file");
    let told = lines(gaugefs(&["lint", &file]));
    assert_eq!((told.len(), &*told[20]), (21, &*format!("gaugefs: {file}: and 4980 more mistakes")));
    // Of what standard input has.
    let mut lint = command(&["lint", "--chip", "bq34z100-g1", "-"]);
    lint.stdin(fs::File::open(&file).expect("the file"));
    let told = lines(run(lint));
    assert!(told[0].starts_with("gaugefs: standard input: line 3: "), "{told:?}");
}

/// All chips at a time: reading data flash takes the gauge's own time.
#[test]
fn an_export_equals_its_gauge() {
    if !can_mount() {
        return;
    }
    std::thread::scope(|scope| {
        for chip in ti_gauge::chip::CHIPS {
            scope.spawn(|| check_exports(chip));
        }
    });
}

fn check_exports(chip: &Chip) {
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", chip.name, &at]).done();
    let gauge = format!("{at}/BAT0");
    for format in one_in(3, ["toml", "gg.csv", "flashstream"]) {
        let file = folder.file(format);
        gaugefs(&["export", &gauge, "--format", format, "-o", &file]).done();
        gaugefs(&["lint", &file]).done();
        let diff = gaugefs(&["diff", &file, &gauge]);
        assert_eq!((diff.code, diff.out.as_str()), (Some(0), ""), "{} {format}: {}", chip.name, diff.err);
        let text = fs::read_to_string(&file).expect("the export");
        for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind == Kind::Security) {
            for key in subclass.parameters {
                assert!(!text.contains(key.name) && !text.contains(&kebab_case(key.name)), "{}", key.name);
            }
        }
    }
    gaugefs(&["umount", &at]).done();
}

#[test]
fn diff_shows_what_a_gauge_has_changed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack.toml"));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    fs::write(&file, gaugefs(&["export", &gauge]).done()).expect("a file");
    fs::write(format!("{gauge}/df/80/53"), "3100\n").expect("a write");
    let diff = gaugefs(&["diff", &file, &gauge]);
    assert_eq!((diff.code, diff.out.as_str()), (Some(1), "it-cfg/cell-terminate-voltage: 3000 -> 3100 mV\n"));
    gaugefs(&["export", &folder.file("")]).failed(&["not a mounted gauge"]);
    gaugefs(&["umount", &at]).done();
}

/// Changes some parameters of many classes to values that are neither defaults nor limits.
fn change_some(gauge: &str, chip: &'static Chip) {
    let mut lines = String::from("begin\n");
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        let may = |row: &&Parameter| !row.unproven && !row.learned && row.safe.is_none();
        for parameter in subclass.parameters.iter().filter(may).take(2) {
            let Range::Int { min, max, .. } = parameter.range else { continue };
            let (offset, value) = (parameter.offset, min + (max - min) / 3);
            match subclass.id {
                FLAT => writeln!(lines, "flash/0x{offset:04x} {value}"),
                id => writeln!(lines, "{id}/{offset} {value}"),
            }
            .expect("a string");
        }
    }
    let wrote = fs::write(format!("{gauge}/df/transaction"), lines + "commit\n");
    let why = fs::read_to_string(format!("{gauge}/gauge/last_error"));
    wrote.unwrap_or_else(|error| panic!("{}: {error}: {why:?}", chip.name));
}

/// All parameters that can be read, as text.
fn all_of(gauge: &str) -> String {
    fs::read_to_string(format!("{gauge}/df/index")).expect("df/index")
}

#[test]
fn an_import_makes_one_gauge_equal_to_another() {
    if !can_mount() {
        return;
    }
    std::thread::scope(|scope| {
        for name in ["bq34z100-g1", "bq27441-g1", "bq34110"] {
            scope.spawn(move || check_imports(name));
        }
    });
}

/// Through the file of each format, from one gauge to another.
#[test]
fn a_string_survives_export_and_import_in_every_format() {
    if !can_mount() {
        return;
    }
    std::thread::scope(|scope| {
        for format in ["toml", "gg.csv", "flashstream"] {
            scope.spawn(move || check_strings(format));
        }
    });
}

fn check_strings(format: &str) {
    let folder = Folder::new();
    let (one, other) = (folder.file("m"), folder.file("n"));
    for at in [&one, &other] {
        gaugefs(&["mount", "--sim", "bq34z100-g1", at]).done();
    }
    let (from, to) = (format!("{one}/BAT0"), format!("{other}/BAT0"));
    let path = |gauge: &str| Path::new(gauge).join("df/48/31");
    let bytes = |gauge: &str| fs::read(Path::new(gauge).join("df/48/raw")).expect("bytes")[31..43].to_vec();
    let (file, again) = (folder.file("file"), folder.file("again"));
    let mut before = fs::read_to_string(path(&to)).expect("its text");
    for string in ["AT&T (4S)", "", "%20a,\"\\%2541%00%ff%20"] {
        fs::write(path(&from), format!("{string}\n")).expect("a string");
        let shown = fs::read_to_string(path(&from)).expect("its text");
        gaugefs(&["export", &from, "--format", format, "-o", &file]).done();
        let imported = gaugefs(&["import", &to, &file]).done();
        let old = before.trim_end_matches('\n');
        assert_eq!(imported, format!("configuration-data/device-name: {old} -> {shown}"), "{format}");
        assert_eq!(bytes(&to), bytes(&from), "{format} {shown}");
        gaugefs(&["export", &to, "--format", format, "-o", &again]).done();
        let read = |file: &str| fs::read(file).expect("a file");
        assert_eq!(read(&again), read(&file), "{format} {shown}");
        before = shown;
    }
    for at in [&one, &other] {
        gaugefs(&["umount", at]).done();
    }
}

fn check_imports(name: &str) {
    let folder = Folder::new();
    let (one, other) = (folder.file("m"), folder.file("n"));
    let chip = Chip::by_name(name).expect("a chip");
    gaugefs(&["mount", "--sim", name, &one]).done();
    gaugefs(&["mount", "--sim", name, &other]).done();
    let (from, to) = (format!("{one}/BAT0"), format!("{other}/BAT0"));
    change_some(&from, chip);
    for format in ["toml", "gg.csv", "flashstream"] {
        let file = folder.file(format);
        gaugefs(&["export", &from, "--format", format, "-o", &file]).done();
    }
    let before = all_of(&to);
    let dry = gaugefs(&["import", "--dry-run", &to, &folder.file("toml")]).differs();
    assert!(dry.lines().count() > 5, "{name}: {dry}");
    assert_eq!(all_of(&to), before);
    for format in ["gg.csv", "flashstream"] {
        let same = gaugefs(&["import", "--dry-run", &to, &folder.file(format)]).differs();
        assert_eq!(same, dry, "{name} {format}");
    }
    assert_eq!(gaugefs(&["import", &to, &folder.file("flashstream")]).done(), dry);
    assert_eq!(all_of(&to), all_of(&from), "{name}");
    assert_eq!(gaugefs(&["import", &to, &folder.file("toml")]).done(), "");
    gaugefs(&["umount", &one]).done();
    gaugefs(&["umount", &other]).done();
}

#[test]
fn an_import_excludes_groups_and_is_all_or_nothing() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack.toml"));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    let write = |values: &str| fs::write(&file, format!("chip = \"{CHIP}\"\n{values}")).expect("a file");
    write(
        "[it-cfg]\ncell-terminate-voltage = 3100\n[calibration-data]\ncc-offset = -1\n\
         [configuration-data]\nserial-number = 7\n",
    );
    let before = all_of(&gauge);
    let all = "configuration-data/serial-number: 0x0001 -> 0x0007\n\
               it-cfg/cell-terminate-voltage: 3000 -> 3100 mV\n";
    let some = gaugefs(&["import", &gauge, &file, "--dry-run", "--exclude", "calibration"]).differs();
    assert_eq!(some, all);
    write("[it-cfg]\ncell-terminate-voltage = 3100\nra-filter = 2000\n");
    gaugefs(&["import", &gauge, &file]).failed(&[&file, "line "]);
    // Only the daemon knows which bits the gauge has set that must not change. These have names: they are asked for.
    write("[it-cfg]\ncell-terminate-voltage = 3100\n[registers]\nled-comm-configuration = 0x04\n");
    gaugefs(&["import", &gauge, &file]).failed(&[&gauge, "LED_Comm Configuration", "HDQ"]);
    write("[it-cfg]\ncell-terminate-voltage = 3100\n[registers]\npack-configuration = 0xffff\n");
    gaugefs(&["import", &gauge, &file]).failed(&[&gauge, "Pack Configuration", "external divider"]);
    gaugefs(&["import", &gauge, "tests/it/images/pack.toml"]).failed(&["pack.toml", "bq27441-G1"]);
    assert_eq!(all_of(&gauge), before);
    write("[it-cfg]\ncell-terminate-voltage = 3100\n[configuration-data]\nserial-number = 7\n");
    let some = gaugefs(&["import", &gauge, &file, "--exclude", "calibration,serial"]).done();
    assert_eq!(some, "it-cfg/cell-terminate-voltage: 3000 -> 3100 mV\n");
    assert_eq!(read(&at, "BAT0/df/80/53"), "3100");
    assert_eq!(read(&at, "BAT0/gauge/seal"), "sealed");
    gaugefs(&["umount", &at]).done();
}

/// Exit code, printed lines and complaints.
fn outcome(ran: Ran) -> (i32, String, Vec<String>) {
    (ran.code.expect("it exits"), ran.out, ran.err.lines().map(str::to_string).collect())
}

#[test]
fn an_import_says_what_it_passes_over() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack"));
    let chip = Chip::by_name("bq34110").expect("a chip");
    gaugefs(&["mount", "--sim", chip.name, &at]).done();
    let gauge = format!("{at}/BAT0");
    // One row that can be written and one that is unproven, with another value than the gauge's.
    let rows = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let mut rows = rows.filter_map(|(subclass, row)| match row.range {
        Range::Int { min, max, default: Some(default) } if !row.learned && row.safe.is_none() => {
            let other = if default == max { min } else { default + 1 };
            Some((
                row.unproven,
                format!("[{}]\n{} = {other}\n", chip.class_dir(subclass), kebab_case(row.name)),
            ))
        }
        _ => None,
    });
    let (_, unproven) = rows.clone().find(|(unproven, _)| *unproven).expect("a row");
    let (_, proven) = rows.find(|(unproven, row)| !unproven && !row.starts_with("[data]")).expect("a row");
    fs::write(&file, format!("chip = \"bq34110\"\n{unproven}{proven}")).expect("a file");
    let passed_over = |(code, out, err): (i32, String, Vec<String>), expected| {
        assert_eq!(code, expected, "{out}{err:?}");
        assert_eq!(err.len(), 2, "{err:?}");
        assert!(err[0].starts_with(&format!("gaugefs: {file}: line 3: ")), "{err:?}");
        assert!(err[0].ends_with("its address or range is unproven"), "{err:?}");
        assert_eq!(err[1], format!("gaugefs: {file}: 1 passed over"));
        out
    };
    let dry = passed_over(outcome(gaugefs(&["import", "--dry-run", &gauge, &file])), 1);
    let written = passed_over(outcome(gaugefs(&["import", &gauge, &file])), 3);
    assert_eq!((dry.lines().count(), &dry), (1, &written));
    assert_eq!(passed_over(outcome(gaugefs(&["import", &gauge, &file])), 3), "");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_file_that_is_not_whole_is_not_imported() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack"));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    let whole = gaugefs(&["export", &gauge]).done();
    let before = all_of(&gauge);
    let cut = &whole[..whole.len() * 2 / 3];
    for (text, says) in [
        ("", "the file is empty"),
        (&format!("chip = \"{CHIP}\"\n"), "it has no parameter"),
        (&cut[..=cut.rfind('\n').expect("a line")], "cut short"),
        (
            &format!("chip = \"{CHIP}\"\n[it-cfg]\nra-filter = 1\nra-filter = 2\n"),
            "line 4: ra-filter is also in line 3",
        ),
    ] {
        fs::write(&file, text).expect("a file");
        gaugefs(&["import", &gauge, &file]).failed(&[&file, says]);
        gaugefs(&["import", "--dry-run", &gauge, &file]).troubled(&[&file, says]);
        gaugefs(&["diff", &gauge, &file]).troubled(&[&file, says]);
        gaugefs(&["lint", "--chip", CHIP, &file]).failed(&[&file, says]);
    }
    fs::write(&file, "[it-cfg]\ncell-terminate-voltage = 3000\n").expect("a file");
    gaugefs(&["import", &gauge, &file]).failed(&[&file, "does not say which gauge it is for", "--chip"]);
    gaugefs(&["import", "--chip", CHIP, &gauge, &file]).done();
    gaugefs(&["import", "--complete", "--chip", CHIP, &gauge, &file])
        .failed(&[&file, "not complete; it lacks"]);
    fs::write(&file, whole).expect("a file");
    gaugefs(&["import", "--complete", &gauge, &file]).done();
    assert_eq!(all_of(&gauge), before);
    gaugefs(&["umount", &at]).done();
}

/// One command shows whether a gauge has a golden image, except for what differs from pack to pack.
#[test]
fn groups_can_be_excluded_from_a_comparison() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack"));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    fs::write(&file, gaugefs(&["export", &gauge]).done()).expect("a file");
    assert_eq!(gaugefs(&["import", "--dry-run", &gauge, &file]).done(), "");
    fs::write(format!("{gauge}/df/48/4"), "0x0007\n").expect("a write");
    assert_eq!(
        gaugefs(&["diff", &file, &gauge]).differs(),
        "configuration-data/serial-number: 0x0001 -> 0x0007\n"
    );
    assert_eq!(
        gaugefs(&["import", "--dry-run", &gauge, &file]).differs(),
        "configuration-data/serial-number: 0x0007 -> 0x0001\n"
    );
    for command in [
        &["diff", "--exclude", "serial", &file, &gauge][..],
        &["import", "--dry-run", "--exclude", "serial", &gauge, &file],
    ] {
        let ran = gaugefs(command);
        assert_eq!(ran.gauges.len(), 1);
        let says = format!("gaugefs: gauge {gauge}: bq34z100-G1, SerialNumber() 0x0007, polled 0.");
        assert!(ran.gauges[0].starts_with(&says), "{:?}", ran.gauges);
        assert_eq!(ran.done(), "");
    }
    gaugefs(&["diff", &file, &folder.file("none")]).troubled(&["none"]);
    gaugefs(&["import", "--dry-run", &gauge, &folder.file("none")]).troubled(&["none"]);
    gaugefs(&["umount", &at]).done();
}

/// A recording cannot be polled.
#[test]
fn values_that_cannot_be_read_anew_are_shown_with_their_age() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, trace) = (folder.file("m"), folder.file("trace"));
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", CHIP, "--trace", &trace, &at]).done();
    let exported = gaugefs(&["export", &gauge]).done();
    gaugefs(&["umount", &at]).done();
    gaugefs(&["mount", "--replay", &trace, &at]).done();
    let ran = gaugefs(&["export", &gauge]);
    let line = ran.gauges.concat();
    assert!(line.contains("polled ") && line.contains("not polled now"), "{line}");
    assert!(line.contains("gauge/refresh: Read-only file system"), "{line}");
    assert_eq!(ran.done(), exported);
    gaugefs(&["umount", &at]).done();
}

/// A gauge that does not answer is neither exported nor compared: its pack may be another one by now.
#[test]
fn a_gauge_that_does_not_answer_is_not_believed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack"));
    gaugefs(&["mount", "--sim", CHIP, "--poll", "3600", &at]).done();
    let gauge = format!("{at}/BAT0");
    fs::write(&file, gaugefs(&["export", &gauge]).done()).expect("a file");
    fs::write(format!("{gauge}/sim/power"), "off").expect("a knob");
    gaugefs(&["export", &gauge]).failed(&[&gauge, "not acknowledged"]);
    gaugefs(&["import", &gauge, &file]).failed(&[&gauge, "not acknowledged"]);
    gaugefs(&["diff", &file, &gauge]).troubled(&[&gauge, "not acknowledged"]);
    fs::write(format!("{gauge}/sim/power"), "on").expect("a knob");
    gaugefs(&["umount", &at]).done();
}

/// Another process that reads the file during a commit sees the progress, without waiting.
#[test]
fn a_commit_shows_its_progress() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let _time = in_real_time();
    // It takes a third of a second to program a block.
    let chip = Chip::by_name("bq27520-g3").expect("a chip");
    gaugefs(&["mount", "--sim", chip.name, "--allow-unproven", &at]).done();
    let gauge = format!("{at}/BAT0");
    // A busy machine may not look while it is being programmed, so that it takes more than one commit.
    let mut shown = std::collections::BTreeSet::new();
    for more in 0..20 {
        let lines = format!("48/10 {}\n2/0 {}\n34/2 {}", 1100 + more, 560 + more, 4100 + more);
        let file = format!("{gauge}/df/transaction");
        let commit = std::thread::spawn(move || fs::write(file, format!("begin\n{lines}\ncommit\n")));
        while !commit.is_finished() {
            shown.insert(read(&at, "BAT0/df/transaction"));
            std::thread::sleep(Duration::from_millis(10));
        }
        commit.join().expect("no panic").expect("a commit");
        if shown.contains("committing 1/3") {
            break;
        }
    }
    assert!(shown.contains("committing 1/3"), "{shown:?}");
    assert_eq!(read(&at, "BAT0/df/transaction"), "idle");
    gaugefs(&["umount", &at]).done();
}

/// The registers of a bq27427 have bytes that belong to no parameter, and these are exported unchanged. The
/// checksum in the file is that of the whole block.
#[test]
fn bytes_without_a_parameter_are_imported_on_request() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("pack.gm.fs"));
    gaugefs(&["mount", "--sim", "bq27427", &at]).done();
    let gauge = format!("{at}/BAT0");
    let text = gaugefs(&["export", &gauge, "--format", "flashstream"]).done();
    let registers = "W: AA 40 64 78 0F 9F 23 00 00 14 04 00 09 04 27 00";
    let at_line = 2 + text.lines().position(|line| line.starts_with(registers)).expect("the block");
    assert!(text.contains("W: AA 60 06\n"));
    let bent = text.replace("09 04 27 00", "09 05 27 00").replace("W: AA 60 06\n", "W: AA 60 05\n");
    fs::write(&file, &text).expect("a file");
    assert_eq!(gaugefs(&["import", &gauge, &file]).done(), "");
    fs::write(&file, bent.replace("C: AA 60 06\n", "C: AA 60 05\n")).expect("a file");
    let says = format!("line {at_line}: raw 64/11: 04 -> 05: these bytes are undocumented");
    gaugefs(&["import", &gauge, &file]).failed(&[&file, &says, "write them with --raw"]);
    assert_eq!(gaugefs(&["import", "--exclude", "undocumented", &gauge, &file]).done(), "");
    let changed = "raw 64/11: 04 -> 05\n";
    assert_eq!(gaugefs(&["import", "--raw", "--dry-run", &gauge, &file]).differs(), changed);
    assert_eq!(fs::read(format!("{gauge}/df/64/raw")).expect("bytes")[11], 0x04);
    assert_eq!(gaugefs(&["import", "--raw", &gauge, &file]).done(), changed);
    assert_eq!(fs::read(format!("{gauge}/df/64/raw")).expect("bytes")[11], 0x05);
    assert_eq!(gaugefs(&["import", &gauge, &file]).done(), "");
    for lint in [&["lint", "--raw", &file][..], &["lint", &file]] {
        gaugefs(lint).done();
    }
    let chemistry = "tests/it/images/chemistry.gm.fs";
    gaugefs(&["import", &gauge, chemistry]).failed(&["line 11: subclass 83 of a BQ27427", "--raw"]);
    let shown = gaugefs(&["import", "--raw", "--dry-run", &gauge, chemistry]).differs();
    assert!(shown.starts_with("raw 83/0: - -> 2011"), "{shown}");
    // The mode that writes firmware is always refused.
    fs::write(&file, text + "W: AA 00 00 0F\n").expect("a file");
    for command in [&["import", "--raw", &gauge, &file][..], &["lint", "--raw", &file]] {
        gaugefs(command).failed(&["Control(ROM_MODE)"]);
    }
    gaugefs(&["umount", &at]).done();
}

/// A chemistry file as TI's tools write it for a BQ27426, with its classes and the second block of class 104.
#[test]
fn a_chemistry_file_is_named_by_lint_and_applied() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("chemistry.gm.fs"));
    let identity =
        "W: AA 00 01 00\nC: AA 00 26 04\nW: AA 00 02 00\nC: AA 00 02 02\nW: AA 00 13 00\nX: 1100\n";
    // Class, block, and how many of its bytes are known.
    let blocks =
        [(83, 0, 32), (83, 1, 11), (84, 0, 32), (84, 1, 10), (85, 0, 17), (108, 0, 17), (104, 1, 26)];
    let block = |(class, block, length): (u8, u8, usize)| {
        let data = " 11".repeat(length) + &" 00".repeat(32 - length);
        let sum = 0xff - (0x11 * length) as u8;
        let select = format!("W: AA 3E {class:02X} {block:02X}\n");
        format!("{select}W: AA 40{data}\nW: AA 60 {sum:02X}\nX: 10\n{select}C: AA 60 {sum:02X}\n")
    };
    let text = identity.to_string() + &blocks.map(block).concat() + "W: AA 00 42 00\nX: 2000\n";
    fs::write(&file, &text).expect("a file");
    let lint = gaugefs(&["lint", &file]).done();
    for name in ["83, OCV Table 83", "84, OCV Table 84", "85, Chemistry 85", "108, Chemistry 108"] {
        assert!(lint.contains(&format!(" bytes of subclass {name};")), "{name}: {lint}");
    }
    assert!(lint.contains(" undocumented bytes of subclass 104;"), "{lint}");
    gaugefs(&["mount", "--sim", "bq27426", &at]).done();
    let gauge = format!("{at}/BAT0");
    // Class 104 is calibration.
    gaugefs(&["import", &gauge, &file]).failed(&["raw 104/32: ", "write them with --raw"]);
    // Without the part or the firmware nothing shows that the chemistry is meant for this gauge.
    let other = folder.file("other.gm.fs");
    fs::write(&other, text.replace("W: AA 00 02 00\nC: AA 00 02 02\n", "")).expect("a file");
    gaugefs(&["import", &gauge, &other]).failed(&["line 7: raw 83/0: 5353", "write them with --raw"]);
    // The chemistry alone, as in TI's files for it.
    fs::write(&other, text.replace(&block(blocks[6]), "")).expect("a file");
    let written = gaugefs(&["import", &gauge, &other]).done();
    assert_eq!(written.lines().count(), blocks.len() - 1, "{written}");
    let written = gaugefs(&["import", "--raw", &gauge, &file]).done();
    assert_eq!(written.lines().count(), 1, "{written}");
    for (class, start, length) in [(83, 0, 43), (84, 0, 42), (85, 0, 17), (108, 0, 17), (104, 32, 26)] {
        let raw = fs::read(format!("{gauge}/df/{class}/raw")).expect("bytes");
        let (new, after) = raw[start..].split_at(length);
        assert!(
            new.iter().all(|&byte| byte == 0x11) && after.iter().all(|&byte| byte == 0),
            "{class}: {raw:x?}"
        );
    }
    assert_eq!(gaugefs(&["import", &gauge, &file]).done(), "");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn regression_a_clone_lost_its_chemistry_without_a_word() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let gauges = ["m", "n"].map(|name| {
        gaugefs(&["mount", "--sim", "bq27426", &folder.file(name)]).done();
        format!("{}/BAT0", folder.file(name))
    });
    let [from, to] = &gauges;
    let raw =
        |gauge: &str| [83, 84, 85, 108].map(|id| fs::read(format!("{gauge}/df/{id}/raw")).expect("bytes"));
    // Another chemistry.
    fs::write(format!("{from}/df/transaction"), "begin\nraw 83/3 1234\nraw 108/0 55\ncommit\n")
        .expect("written");
    assert_ne!(raw(from), raw(to));
    let differ = gaugefs(&["diff", to, from]);
    let shown = "raw 83/3: 5353 -> 1234\nraw 108/0: 6c -> 55\n";
    assert_eq!((differ.code, &*differ.out), (Some(1), shown), "{}", differ.err);
    let [toml, stream] = ["pack.toml", "pack.gm.fs"].map(|name| folder.file(name));
    let told = |file: &str| {
        let ran = gaugefs(&["export", "--json", from, "-o", file]);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        let says = "exported without the chemistry, subclasses 83, 84, 85 and 108";
        (ran.gauges.iter().any(|line| line.contains(says)), ran.out.contains("left_out"))
    };
    assert_eq!((told(&toml), told(&stream)), ((true, true), (false, false)));
    let blind = gaugefs(&["diff", &toml, to]);
    assert_eq!(blind.code, Some(0), "{}", blind.err);
    let lacks = "not compared: OCV Table 83 (83), OCV Table 84 (84), Chemistry 85 (85), Chemistry 108 (108), which the \
                 other side lacks";
    assert!(blind.err.contains(lacks), "{}", blind.err);
    let differ = gaugefs(&["diff", to, &stream]);
    assert_eq!((differ.code, &*differ.out), (Some(1), shown), "{}", differ.err);
    let differ = gaugefs(&["diff", "--json", to, &stream]).out;
    assert!(differ.contains(r#"{"name":"raw 83/3","a":"5353","b":"1234","unit":""}"#), "{differ}");
    let kept = gaugefs(&["import", "--exclude", "undocumented", to, &stream]);
    assert_eq!((kept.code, &*kept.out), (Some(0), ""), "{}", kept.err);
    let says = "leaves out the chemistry of ";
    let is_said =
        |line: &String| line.contains(says) && line.ends_with(", which differs: subclasses 83 and 108\n");
    assert!(kept.gauges.iter().any(is_said), "{:?}", kept.gauges);
    gaugefs(&["import", to, &stream]).done();
    assert_eq!(raw(from), raw(to));
    let same = gaugefs(&["import", "--exclude", "undocumented", to, &stream]);
    assert!(!same.gauges.iter().any(|line| line.contains(says)), "{:?}", same.gauges);
    assert_eq!(gaugefs(&["diff", to, &stream]).done(), "");
    assert_eq!(gaugefs(&["diff", to, from]).done(), "");
    for name in ["m", "n"] {
        gaugefs(&["umount", &folder.file(name)]).done();
    }
}

#[test]
fn regression_lint_leaves_out_the_groups_that_its_message_names() {
    let folder = Folder::new();
    let file = folder.file("golden.gm.fs");
    // The last block is among bytes without a name.
    fs::write(&file, "W: AA 3E 7D 92 5A\nW: AA 60 96 05\nW: AA 3E 78 92 01\nW: AA 60 F4 05\n")
        .expect("a file");
    let lint = |more: &[&str]| gaugefs(&[&["lint", "--chip", "bq27220", &file], more].concat());
    assert_eq!(
        lint(&[]).err,
        format!(
            "gaugefs: {file}: line 4: flash/0x9278 is undocumented; skip it with --exclude undocumented\n"
        )
    );
    let shown = lint(&["--exclude", "undocumented"]).done();
    assert!(shown.contains("soc-flags/cycle-count-pct") && !shown.contains("9278"), "{shown}");
    assert!(lint(&["--exclude", "everything"]).code == Some(2));
}

#[test]
fn a_key_file_that_others_may_read_is_refused() {
    let folder = Folder::new();
    let file = folder.file("keys");
    fs::write(&file, "unseal = 1234 zzzz\n").expect("a key file");
    let mount = || gaugefs(&["mount", "--sim", CHIP, "--key-file", &file, &folder.file("m")]);
    fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("its mode");
    mount().failed(&["others may read", "mode 640", "chmod 600"]);
    fs::set_permissions(&file, Permissions::from_mode(0o600)).expect("its mode");
    let bad = mount();
    assert!(!bad.err.contains("zzzz") && !bad.err.contains("1234"), "{}", bad.err);
    bad.failed(&["line 1", "two words"]);
    gaugefs(&["mount", "--sim", CHIP, "--key-file", &folder.file("none"), &folder.file("m")])
        .failed(&["cannot read the key file", "No such file"]);
    assert!(!Path::new(&folder.file("m")).exists(), "a refused mount leaves nothing behind");
}

/// A script that goes on after it believes that the gauge is sealed.
#[test]
fn a_seal_that_stays_owed_is_a_failure_of_umount_and_of_the_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mount = |state: &str, background: bool| {
        let mut mount = command(&["mount", "--sim", CHIP, "--no-backup"]);
        // The first daemon has its gauge for a moment after the unmount.
        let flash = folder.file(&format!("flash of the {state}"));
        mount.args(["--sim-state", &flash, "--state-dir", &folder.file(state), &at]);
        if background {
            Ran::of(mount.output().expect("gaugefs runs")).done();
            return None;
        }
        let log = fs::File::create(folder.file("log")).expect("a log");
        let child =
            mount.arg("--foreground").stdout(Stdio::null()).stderr(log).spawn().expect("gaugefs runs");
        within("mounted", || Path::new(&at).join("BAT0/present").exists());
        Some(child)
    };
    let file = |name: &str| Path::new(&at).join("BAT0").join(name);
    // It is opened for a read, and does not take the commands that would seal it again.
    let left_open = || {
        fs::write(file("sim/drop_seals"), "100000").expect("a knob");
        let read = fs::read(file("df/80/53")).map_err(|error| error.raw_os_error());
        assert_eq!(read, Err(Some(nix::libc::ENOTRECOVERABLE)));
        assert_eq!(fs::read_to_string(file("gauge/owed")).expect("readable"), "1\n");
        // Whoever looks is told.
        let told = [gaugefs(&["list"]).err, gaugefs(&["doctor"]).out].map(|said| {
            said.contains(&format!("{at}/BAT0: ")) && said.contains("restoring the sealed state failed")
        });
        assert_eq!(told, [true, true]);
    };
    let is_journal = |state: &str| {
        let names = fs::read_dir(folder.file(state)).expect("a folder");
        names.flatten().any(|entry| entry.path().extension().is_some_and(|end| end == "journal"))
    };

    let time = in_real_time();
    mount("first", true);
    left_open();
    let ran = gaugefs(&["umount", &at]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(
        ran.err.contains("BAT0: ") && ran.err.contains("restoring the sealed state failed"),
        "{}",
        ran.err
    );
    assert!(ran.err.contains("it is unmounted now"), "{}", ran.err);
    assert!(!gaugefs_client::mounts::is_gaugefs(Path::new(&at)), "it is unmounted all the same");
    assert!(is_journal("first"), "the next start finds it");
    // At once, while the daemon still tries to pay: the next one was refused for some seconds.
    mount("first", true);
    drop(time);
    gaugefs(&["umount", &at]).done();
    assert!(!is_journal("first"), "it has been paid");

    for by_signal in [true, false] {
        let mut daemon = mount("second", false).expect("a child");
        left_open();
        match by_signal {
            true => kill(Pid::from_raw(daemon.id() as i32), Signal::SIGTERM).expect("it runs"),
            false => assert_eq!(gaugefs(&["umount", &at]).code, Some(1)),
        }
        assert_eq!(daemon.wait().expect("a child").code(), Some(1));
        let log = fs::read_to_string(folder.file("log")).expect("a log");
        assert!(log.contains("gaugefs ends, and this is still owed"), "{log}");
        assert!(is_journal("second"));
    }

    // Paid by the next one, which then owes nothing.
    let mut daemon = mount("second", false).expect("a child");
    within("paid", || fs::read_to_string(file("gauge/owed")).is_ok_and(|owed| owed == "0\n"));
    gaugefs(&["umount", &at]).done();
    assert_eq!(daemon.wait().expect("a child").code(), Some(0));
    assert!(!is_journal("second"));
}

#[test]
fn mount_makes_the_folder_and_returns_when_the_gauge_can_be_read() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--name", "PACK-1", &at]).done();
    assert_eq!(read(&at, "PACK-1/model_name"), "bq34z100-G1");
    assert!(read(&at, "PACK-1/uevent").starts_with("POWER_SUPPLY_NAME=PACK-1\n"));
    gaugefs(&["mount", "--sim", CHIP, &at]).failed(&[&at, "a gaugefs is mounted there", "gaugefs umount"]);
    gaugefs(&["umount", &at]).done();
    gaugefs(&["umount", &at]).failed(&["no gaugefs is mounted there"]);
    within("the folder is removed", || !Path::new(&at).exists());
}

#[test]
fn the_daemon_keeps_no_descriptor_of_the_caller() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    // `output` in `gaugefs` returns only when no process has the pipes open any more. So does `cat` here, with
    // a pipe on a descriptor that the daemon does not know.
    let script = format!("{} mount --sim {CHIP} '{at}' 7>&1 | cat", env!("CARGO_BIN_EXE_gaugefs"));
    let status = Command::new("timeout").args(["10", "sh", "-c", &script]).status().expect("a shell");
    assert!(status.success());
    gaugefs(&["umount", &at]).done();
}

#[test]
fn signals_and_an_unmount_end_the_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let mut daemon = Foreground::new(&at, &[]);
        daemon.send(signal);
        assert_eq!(daemon.ends(), Some(0));
        assert!(!Path::new(&at).join("BAT0").exists());
    }
    let mut daemon = Foreground::new(&at, &[]);
    gaugefs(&["umount", &at]).done();
    assert_eq!(daemon.ends(), Some(0));
}

#[test]
fn a_mount_in_use_is_not_unmounted_but_a_signal_ends_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &[]);
    let held = fs::File::open(Path::new(&at).join("BAT0/capacity")).expect("a file");
    let me = format!("process {}", std::process::id());
    gaugefs(&["umount", &at]).failed(&["in use by", &me]);
    daemon.send(Signal::SIGTERM);
    assert_eq!(daemon.ends(), Some(0));
    assert!(!Path::new(&at).join("BAT0").exists());
    drop(held);
}

/// A program's name may be anybody's, and must not control the terminal of whoever unmounts.
#[test]
fn the_name_of_a_user_of_the_mount_is_printed_without_control_characters() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, program) = (folder.file("m"), folder.file("a\x1b[31m\nb"));
    fs::copy("/bin/sleep", &program).expect("a program");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let mut user = Command::new(&program).arg("60").current_dir(&at).spawn().expect("it runs");
    let ran = gaugefs(&["umount", &at]);
    user.kill().and_then(|()| user.wait()).expect("it ends");
    ran.failed(&["in use by process", r"(a\u{1b}[31m\nb)"]);
    gaugefs(&["umount", &at]).done();
}

#[test]
fn the_mount_of_a_killed_daemon_is_removed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &[]);
    assert_eq!(read(&at, "BAT0/present"), "1");
    daemon.send(Signal::SIGKILL);
    daemon.ends();
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    assert_eq!(read(&at, "BAT0/present"), "1");
    gaugefs(&["umount", &at]).done();

    let mut daemon = Foreground::new(&at, &[]);
    daemon.send(Signal::SIGKILL);
    daemon.ends();
    gaugefs(&["umount", &at]).done();
    gaugefs(&["umount", &at]).failed(&["no gaugefs is mounted there"]);
}

/// A daemon whose mount was removed must not unmount the path again when it ends.
#[test]
fn regression_an_ending_daemon_does_not_unmount_the_next_mount() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut first = Foreground::new(&at, &[]);
    stop(first.0.id(), &at);
    // Not with gaugefs, which would abort the connection of a daemon that does not answer. Another test's look at all mounts
    // may wait in this one.
    let unmounted = Command::new("fusermount3").args(["-uz", &at]).status().expect("fusermount3 runs");
    assert!(unmounted.success());
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    first.send(Signal::SIGCONT);
    assert_eq!(first.ends(), Some(0));
    assert_eq!(read(&at, "BAT0/present"), "1");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_mains_supply_follows_the_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let sim = |knob: &str, value: &str| {
        fs::write(Path::new(&at).join("BAT0/sim").join(knob), value).expect("a knob");
    };
    let text = |name: &str| fs::read_to_string(Path::new(&at).join("AC").join(name)).unwrap_or_default();
    let shows = |online: &str| {
        within("AC/online", || text("online") == online);
        let line = if online.is_empty() { String::new() } else { format!("POWER_SUPPLY_ONLINE={online}") };
        let uevent = format!("POWER_SUPPLY_NAME=AC\nPOWER_SUPPLY_TYPE=Mains\n{line}");
        within("AC/uevent", || text("uevent") == uevent);
        let all = ["online", "subsystem", "type", "uevent"];
        within("the list of AC", || {
            let listed = fs::read_dir(Path::new(&at).join("AC")).expect("a folder");
            let mut listed: Vec<_> = listed.map(|entry| entry.expect("an entry").file_name()).collect();
            listed.sort();
            listed == all[usize::from(online.is_empty())..]
        });
    };
    let _daemon = Foreground::new(&at, &["--ac", "--poll", "0.5"]);
    assert_eq!(text("type"), "Mains\n");
    assert!(fs::read_link(Path::new(&at).join("AC/subsystem")).expect("a link").ends_with("power_supply"));
    shows("1\n");
    sim("load_ma", "500");
    shows("0\n");
    sim("load_ma", "-800");
    shows("1\n");
    sim("power", "off");
    shows("");
    sim("power", "on");
    shows("1\n");
    gaugefs(&["umount", &at]).done();
    gaugefs(&["mount", "--sim", CHIP, "--name", "AC", "--ac", &at]).failed(&["AC", "--name", "--ac"]);
    gaugefs(&["mount", "--sim", "bq35100", "--ac=ADP1", &at]).done();
    // A primary cell says nothing about the mains.
    assert_eq!(read(&at, "ADP1/uevent"), "POWER_SUPPLY_NAME=ADP1\nPOWER_SUPPLY_TYPE=Mains");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_state_file_has_one_daemon_and_outlives_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, other, state) = (folder.file("m"), folder.file("n"), folder.file("state"));
    let journal = folder.file("journal");
    let daemon = Foreground::new(&at, &["--sim-state", &state, "--state-dir", &journal]);
    fs::write(Path::new(&at).join("BAT0/df/48/11"), "3400\n").expect("a write");
    let who = format!("process {}", daemon.0.id());
    gaugefs(&["mount", "--sim", CHIP, "--sim-state", &state, &other]).failed(&[
        "in use by process",
        &who,
        &at,
    ]);
    gaugefs(&["umount", &at]).done();
    // The first daemon may still be ending; the second waits for that.
    gaugefs(&["mount", "--sim", CHIP, "--sim-state", &state, &other]).done();
    assert_eq!(read(&other, "BAT0/df/48/11"), "3400");
}

/// The gauge stores a scale, which applies after the reset that the write ends with.
#[test]
fn a_scale_that_may_be_given_twice_is_warned_of_at_the_mount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state) = (folder.file("m"), folder.file("gauge"));
    let r2 = ["mount", "--sim", "bq34z100-r2", "--sim-state", &state];
    gaugefs(&[&r2[..], &["--allow-unproven", "--current-scale", "10", &at]].concat()).done();
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "10");
    fs::write(Path::new(&at).join("BAT0/df/48/31"), "10\n").expect("a write");
    fs::write(Path::new(&at).join("BAT0/gauge/refresh"), "1\n").expect("a poll");
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "100");
    gaugefs(&["umount", &at]).done();

    let ran = gaugefs(&[&r2[..], &["--current-scale", "10", "--voltage-scale", "2", &at]].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
    assert!(
        ran.err.starts_with("gaugefs: warning: BAT0: the gauge reports a scale of 10, and current-scale 10")
    );
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "100");
    assert_eq!(read(&at, "BAT0/gauge/voltage_scale"), "2");
}

#[test]
fn log_and_trace_are_written() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, log, trace) = (folder.file("m"), folder.file("log"), folder.file("trace"));
    gaugefs(&["mount", "--sim", CHIP, "--log", &log, "--trace", &trace, &at]).done();
    read(&at, "BAT0/df/48/11");
    gaugefs(&["umount", &at]).done();
    let text = || fs::read_to_string(&log).expect("the log");
    within("the end is logged", || text().contains("unmounted"));
    assert!(
        text().contains(&format!("Z bq34z100-G1 (simulated gauge) mounted at {at}/BAT0\n")),
        "{}",
        text()
    );
    let trace = fs::read_to_string(&trace).expect("the trace");
    assert!(trace.contains("\nW: AA 00 01 00\n"), "{trace}");
    assert_eq!(trace.matches("\n; hidden\n").count() + trace.matches("; hidden\n; hidden\n").count(), 2);
    assert!(!trace.contains("W: AA 00 14 04"), "a key word is in the trace");
}

/// Uses every key, and looks for them in the log, the trace and `gauge/last_error`.
#[test]
fn a_genuine_pack_is_recognised_and_its_keys_appear_nowhere() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, log, trace, keys) =
        (folder.file("m"), folder.file("log"), folder.file("trace"), folder.file("keys"));
    let write_keys = |text: &str| {
        fs::write(&keys, text).expect("a key file");
        fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    };
    let default = "0123456789ABCDEFFEDCBA9876543210";
    write_keys(&format!("unseal = 8d3e b7c5\nfull_access = ffff ffff\nauthentication = {default}\n"));
    let mount = ["mount", "--sim", CHIP, "--sim-key", "8d3e b7c5", "--key-file", &keys];
    gaugefs(&[&mount[..], &["--log", &log, "--trace", &trace, &at]].concat()).done();
    let gauge = format!("{at}/BAT0");
    let auth = || gaugefs(&["auth", &gauge, "--key-file", &keys]);

    assert_eq!(auth().done(), "genuine, byte order lsb-first\n");
    fs::write(Path::new(&gauge).join("sim/auth_order"), "as-sent").expect("a knob");
    assert_eq!(
        auth().done(),
        "genuine, byte order as-sent; it is mounted with lsb-first; mount it with --auth-order as-sent\n"
    );
    fs::write(Path::new(&gauge).join("gauge/seal"), "full-access").expect("a state");
    assert!(auth().done().starts_with("genuine"));
    assert_eq!(read(&gauge, "gauge/seal"), "full-access");
    fs::write(Path::new(&gauge).join("df/80/53"), "3100").expect("a write");
    // A key written in place of a subcommand or a challenge is not repeated either.
    for (file, text) in [("control", "8d3e"), ("control", "b7c5"), ("authenticate", default)] {
        fs::write(Path::new(&gauge).join("gauge").join(file), text).expect_err("a refusal");
        let last_error = read(&gauge, "gauge/last_error");
        assert!(!last_error.to_lowercase().contains(&text.to_lowercase()), "{last_error}");
    }

    write_keys("authentication = 0123456789ABCDEFFEDCBA9876543211\n");
    auth().failed(&["BAT0: not genuine", "in either byte order"]);
    write_keys(&format!("authentication = {default}\n"));
    fs::write(Path::new(&gauge).join("sim/auth_ms"), "9000").expect("a knob");
    auth().troubled(&["shows no digest"]);
    write_keys("unseal = 8d3e b7c5\n");
    auth().troubled(&[&keys, "has no line `authentication"]);
    gaugefs(&["auth", &at, "--key-file", &folder.file("none")]).troubled(&["cannot read the key file"]);
    write_keys(&format!("authentication = {default}\n"));
    gaugefs(&["auth", &folder.file(""), "--key-file", &keys]).troubled(&["not a mounted gauge"]);

    let last_error = read(&gauge, "gauge/last_error");
    gaugefs(&["umount", &at]).done();
    within("the end is logged", || fs::read_to_string(&log).expect("the log").contains("unmounted"));
    for text in [last_error, fs::read_to_string(&log).expect("it"), fs::read_to_string(&trace).expect("it")] {
        let tight: String = text.to_lowercase().split_whitespace().collect();
        // As a person writes it, and as it is sent on the bus. Parts of a key that other data may contain by
        // chance are left out.
        for key in ["8d3eb7c5", "3e8dc5b7", "aa003e8d", "aa00c5b7", "aa00ffff"] {
            assert!(!tight.contains(key), "{key} in {text}");
        }
        let turned: String =
            default.as_bytes().chunks(2).rev().map(|pair| String::from_utf8_lossy(pair)).collect();
        for key in [default.to_lowercase(), turned.to_lowercase()] {
            assert!(!tight.contains(&key), "the authentication key in {text}");
        }
    }
}

/// Each took the other's digest for its own: up to 42 of 150 said that a genuine pack was not genuine.
#[test]
fn regression_a_genuine_pack_was_not_genuine_for_two_who_asked_at_once() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, keys) = (folder.file("m"), folder.file("keys"));
    fs::write(&keys, "authentication = 0123456789abcdeffedcba9876543210\n").expect("a key file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    gaugefs(&["mount", "--sim", CHIP, "--fast", &at]).done();
    let gauge = folder.file("m/BAT0");
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..5 {
                    let ran = gaugefs(&["auth", &gauge, "--key-file", &keys]);
                    match ran.code {
                        Some(0) => assert_eq!(ran.out, "genuine, byte order lsb-first\n"),
                        // A busy machine may not look in time, each time.
                        code => assert!(
                            code == Some(2) && ran.err.contains("another program"),
                            "{code:?} {}",
                            ran.err
                        ),
                    }
                }
            });
        }
    });
    gaugefs(&["auth", &gauge, "--key-file", &keys]).done();
    gaugefs(&["umount", &at]).done();
}

#[test]
fn the_byte_order_is_chosen_with_the_mount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, keys) = (folder.file("m"), folder.file("keys"));
    fs::write(&keys, "authentication = 0123456789abcdeffedcba9876543210\n").expect("a key file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    gaugefs(&["mount", "--sim", CHIP, "--auth-order", "as-sent", &at]).done();
    let auth = gaugefs(&["auth", &folder.file("m/BAT0"), "--key-file", &keys]).done();
    assert!(auth.contains("genuine, byte order lsb-first; it is mounted with as-sent"), "{auth}");
    fs::write(Path::new(&at).join("BAT0/sim/auth_order"), "as-sent").expect("a knob");
    let auth = gaugefs(&["auth", &folder.file("m/BAT0"), "--key-file", &keys]).done();
    assert_eq!(auth, "genuine, byte order as-sent\n");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_recorded_gauge_can_be_mounted() {
    if !can_mount() {
        return;
    }
    let parts = [("bq34z100-g1", "df/48/11"), ("bq27441-g1", "df/82/10"), ("bq34110", "df/flash/0x41f5")];
    for (chip, parameter) in parts {
        let folder = Folder::new();
        let (at, trace) = (folder.file("m"), folder.file("trace"));
        let gauge = format!("{at}/BAT0");
        let number = |name: &str| read(&gauge, name).parse::<i64>().expect("a number");
        let sim = ["mount", "--sim", chip, "--sim-seal", "sealed"];
        gaugefs(&[&sim[..], &["--poll", "0.5", "--trace", &trace, &at]].concat()).done();
        let first = read(&gauge, "current_now");
        let value = read(&gauge, parameter);
        fs::write(Path::new(&gauge).join("sim/load_ma"), "700").expect("a knob");
        within("the load is seen", || {
            let current = fs::read_to_string(Path::new(&gauge).join("current_now"));
            // Values that are late are not there.
            current.is_ok_and(|current| current.trim() != first)
        });
        // From now on all polls are equal.
        fs::write(Path::new(&gauge).join("sim/speed"), "0").expect("a knob");
        let polls = number("gauge/statistics/polls") + 2;
        within("two polls", || number("gauge/statistics/polls") >= polls);
        let recorded = shown(&gauge);
        gaugefs(&["umount", &at]).done();

        gaugefs(&["mount", "--replay", &trace, "--poll", "0.5", &at]).done();
        assert_eq!(read(&gauge, "current_now"), first, "{chip} begins as the recording");
        assert!(!Path::new(&gauge).join("sim").exists());
        for file in ["gauge/refresh", "gauge/seal", parameter] {
            let refused = fs::File::options().write(true).open(Path::new(&gauge).join(file));
            let error = refused.expect_err("it is read-only").raw_os_error();
            assert_eq!(error, Some(nix::libc::EROFS), "{chip}: {file}");
        }
        assert_eq!(read(&gauge, parameter), value, "{chip}");
        within("all polls", || shown(&gauge) == recorded);
        assert_eq!(read(&gauge, "gauge/last_error"), "", "{chip}");
        // A value that was not recorded cannot be read, and the failure changes nothing else.
        fs::read(Path::new(&gauge).join("df/index")).expect_err("most of data flash was not recorded");
        assert_eq!(read(&gauge, "gauge/seal"), "sealed", "{chip}");
        // The values were not polled while that took its time.
        within("it stays as it ended", || shown(&gauge) == recorded);
        gaugefs(&["umount", &at]).done();
    }
}

#[test]
fn a_file_that_is_not_a_recording_is_refused() {
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("trace"));
    let replay = || gaugefs(&["mount", "--replay", &file, &at]);
    replay().failed(&["trace: cannot read it"]);
    fs::write(&file, "W: AA 00 01 00\n").expect("a file");
    replay().failed(&["line 1", "only a file that --trace or `gaugefs report` wrote"]);
    fs::write(&file, "; gaugefs: bq99 on a bus, now\n").expect("a file");
    replay().failed(&["unknown chip `bq99`"]);
    fs::write(&file, "; gaugefs: bq27441-g1 on a bus, now\nR: AA 02 2\n; 0.1 -> 01 0B\n").expect("a file");
    replay().failed(&["recording too short"]);
    assert!(!Path::new(&at).exists());
}

#[test]
fn a_write_of_a_killed_daemon_is_settled_by_the_next() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state, journal) = (folder.file("m"), folder.file("state"), folder.file("journal"));
    let kept = ["--sim-state", &state, "--state-dir", &journal];
    let _time = in_real_time();
    let files = || {
        let files = fs::read_dir(&journal).into_iter().flatten().flatten().map(|entry| entry.path());
        files.filter(|path| path.extension().is_some_and(|extension| extension == "journal"))
    };
    let planned = |path: PathBuf| fs::read_to_string(path).is_ok_and(|text| text.contains("\nend "));
    // A busy machine may let it end first.
    let is_half_way = |value: &'static str| {
        let mut daemon = Foreground::new(&at, &kept);
        let parameter = Path::new(&at).join("BAT0/df/80/53");
        let write = std::thread::spawn(move || fs::write(parameter, value));
        within("planned", || files().any(planned) || write.is_finished());
        for mode in files().filter_map(|path| fs::metadata(path).ok()).map(|file| file.permissions().mode()) {
            assert_eq!(mode & 0o777, 0o600);
        }
        daemon.send(Signal::SIGKILL);
        daemon.ends();
        let is_half_way = files().any(planned);
        let written = write.join().expect("the thread ends");
        assert!(!is_half_way || written.is_err(), "the daemon was killed");
        // Otherwise the kernel's cache of the dead mount would be taken for the next one.
        gaugefs(&["umount", &at]).done();
        is_half_way
    };
    assert!(["3100", "3000"].into_iter().cycle().take(20).any(is_half_way));
    let log = folder.file("log");
    let _daemon = Foreground::new(&at, &[&kept[..], &["--log", &log]].concat());
    let last_error = read(&at, "BAT0/gauge/last_error");
    assert!(last_error.contains("the write of Cell Terminate Voltage was interrupted"), "{last_error}");
    let log = fs::read_to_string(log).expect("the log");
    assert!(log.contains("the write of Cell Terminate Voltage was interrupted"), "{log}");
    let left: Vec<_> = files().filter(|path| path.extension().is_some_and(|end| end == "journal")).collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(["3000", "3100"].contains(&&*read(&at, "BAT0/df/80/53")));
    assert_eq!(read(&at, "BAT0/gauge/seal"), "sealed");
    fs::write(Path::new(&at).join("BAT0/df/80/53"), "3200\n").expect("writes work again");
    gaugefs(&["umount", &at]).done();
}

/// The file is what an export before the write would have been.
#[test]
fn the_first_write_leaves_a_backup_of_what_was_there() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state, journal) = (folder.file("m"), folder.file("state"), folder.file("journal"));
    let log = folder.file("log");
    let kept = ["--sim-state", &state, "--state-dir", &journal, "--log", &log];
    let backups = || -> Vec<_> {
        let files = fs::read_dir(&journal).into_iter().flatten().flatten().map(|entry| entry.path());
        files.filter(|path| path.to_string_lossy().ends_with(".backup.toml")).collect()
    };
    let daemon = Foreground::new(&at, &[&kept[..], &["--no-backup"]].concat());
    let gauge = format!("{at}/BAT0");
    fs::write(format!("{gauge}/df/48/11"), "3400\n").expect("a write");
    assert_eq!(backups(), [""; 0].map(std::path::PathBuf::from));
    gaugefs(&["umount", &at]).done();
    drop(daemon);
    let daemon = Foreground::new(&at, &kept);
    let exported = gaugefs(&["export", &gauge]).done();
    fs::write(format!("{gauge}/df/48/11"), "3500\n").expect("a write");
    let [backup] = &backups()[..] else { panic!("{:?}", backups()) };
    let saved = fs::read_to_string(backup).expect("a file");
    let (host, image) = saved.split_once('\n').expect("a line");
    assert!(host.starts_with("# host ") && image == exported, "{saved}");
    assert_eq!(fs::metadata(backup).expect("a file").permissions().mode() & 0o777, 0o600);
    let log = fs::read_to_string(&log).expect("the log");
    assert!(log.contains(&format!("configuration saved in {}", backup.display())), "{log}");
    assert!(
        log.contains("Z serial 0x0001: Design Capacity: 3400 -> 3500 mAh, written and verified\n"),
        "{log}"
    );
    // It can be applied again.
    let file = backup.display().to_string();
    gaugefs(&["import", &gauge, &file]).done();
    assert_eq!(read(&at, "BAT0/df/48/11"), "3400");
    gaugefs(&["umount", &at]).done();
    drop(daemon);
}

#[test]
fn without_space_for_the_journal_nothing_is_written() {
    use nix::mount::{MsFlags, mount, umount};

    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, journal) = (folder.file("m"), folder.file("journal"));
    fs::create_dir(&journal).expect("a folder");
    let options = Some("size=4k,mode=755");
    if let Err(errno) = mount(Some("full"), &*journal, Some("tmpfs"), MsFlags::empty(), options) {
        eprintln!("SKIPPED: no small file system can be mounted here ({errno}); a full disk was not tested");
        return;
    }
    let full = fs::write(Path::new(&journal).join("filler"), [0; 4096]);
    let daemon = Foreground::new(&at, &["--state-dir", &journal]);
    let parameter = Path::new(&at).join("BAT0/df/80/53");
    let commits = || read(&at, "BAT0/gauge/statistics/flash_writes");
    let refused = fs::write(&parameter, "3100\n").map_err(|error| error.raw_os_error());
    let last_error = read(&at, "BAT0/gauge/last_error");
    let flags = MsFlags::MS_REMOUNT | MsFlags::MS_RDONLY;
    let remounted = mount(None::<&str>, &*journal, None::<&str>, flags, None::<&str>);
    let read_only = fs::write(&parameter, "3100\n").map_err(|error| error.raw_os_error());
    let (written, value) = (commits(), read(&at, "BAT0/df/80/53"));
    drop(daemon);
    let ended = gaugefs(&["umount", &at]);
    umount(&*journal).expect("it is unmounted");
    full.and(remounted.map_err(Into::into)).expect("the disk is full, then read-only");
    assert_eq!(refused, Err(Some(nix::libc::ENOSPC)), "{last_error}");
    assert!(last_error.contains(&journal) && last_error.contains("--state-dir"), "{last_error}");
    assert_eq!(read_only, Err(Some(nix::libc::EROFS)));
    assert_eq!((&*written, &*value), ("0", "3000"));
    ended.done();
}

#[cfg(not(feature = "rescue"))]
#[test]
fn a_build_without_rescue_says_which_has_it() {
    for more in [&[][..], &["--help"], &["x.bq.fs", "--bus", "/dev/i2c-1"]] {
        let line = [&["rescue"], more].concat();
        gaugefs(&line).troubled(&["gaugefs: rescue: this build is without it; the Debian package has it"]);
    }
}

#[cfg(feature = "rescue")]
#[test]
fn rescue_checks_its_file_before_anything_else() {
    let file = crate::room::folder().join(format!("rescue-{}.df.fs", std::process::id()));
    let path = file.to_str().expect("a path in UTF-8");
    let rescue = ["rescue", path, "--bus", "/dev/i2c-none", "--chip", "bq34z100-g1", "--yes"];
    // Data flash alone: its first command erases one page of the firmware.
    fs::write(&file, "W: AA 00 00 0F\nX: 1000\nW: 16 00 03 00 00\nW: 16 64 03 00\nX: 20\nC: 16 66 00\n")
        .expect("a file");
    let Ran { code, err, .. } = gaugefs(&rescue);
    assert_eq!(code, Some(1));
    assert!(err.contains("line 4") && err.contains(".bq.fs") && !err.contains("i2c-none"), "{err}");
    fs::write(&file, "W: 16 00 04 00 00 00 83 DE\nW: 16 64 65 01\nX: 400\nC: 16 66 00\n").expect("a file");
    let Ran { code, err, .. } = gaugefs(&rescue);
    assert_eq!(code, Some(1));
    assert!(err.contains("cut short") && !err.contains("i2c-none"), "{err}");
    // The part is never guessed. Of one whose files are not known nothing is read, neither a file nor a bus.
    assert_eq!(gaugefs(&rescue[..4]).code, Some(2));
    for chip in ["bq27500", "bq27500-v130", "bq27541", "bq27542", "bq27545", "bq27742", "bq28z610", "bq35100"]
    {
        let says =
            ["in ROM mode gaugefs does not bring it back", "TI's tools do", "switch its power off and on"];
        let of_bus = ["rescue", "none.bq.fs", "--bus", "/dev/i2c-none", "--chip", chip];
        gaugefs(&of_bus).failed(&says);
        gaugefs(&["rescue", "none.bq.fs", "--sim", chip]).failed(&says);
    }
    fs::remove_file(&file).expect("it is there");
}
