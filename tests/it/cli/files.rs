// SPDX-License-Identifier: MIT

//! Files of values: exported, compared, checked and imported.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use ti_gauge::chip::{Chip, FLAT, Kind, Parameter, Range, kebab_case};

use super::golden;
use crate::drawn::one_in;
use crate::room::{CHIP, Folder, Ran, can_mount, command, gaugefs, read, run};

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
