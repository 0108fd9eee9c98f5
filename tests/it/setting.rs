// SPDX-License-Identifier: MIT

//! `gaugefs get` and `set`, and what export, diff and import do with names, dates and several gauges.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use serde_json::Value;

use crate::room::{CHIP, Folder, Ran, can_mount, command, gaugefs, read, run, within};

const NAME: &str = "it-cfg/cell-terminate-voltage";

/// One simulated gauge, mounted.
struct Gauge {
    folder: Folder,
    at: String,
}

impl Gauge {
    fn new(more: &[&str]) -> Option<Self> {
        if !can_mount() {
            return None;
        }
        let folder = Folder::new();
        let at = folder.file("m");
        gaugefs(&[&["mount", "--sim", CHIP, "--fast", &at], more].concat()).done();
        Some(Self { folder, at })
    }

    fn path(&self) -> String {
        format!("{}/BAT0", self.at)
    }

    fn number(&self, name: &str) -> u64 {
        read(&self.at, &format!("BAT0/gauge/statistics/{name}")).parse().expect("a number")
    }

    fn set(&self, words: &[&str]) -> Ran {
        gaugefs(&[&["set", &self.path()], words].concat())
    }
}

/// Two gauges in one mount, of these parts.
fn two(parts: [&str; 2]) -> Option<Gauge> {
    if !can_mount() {
        return None;
    }
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("two.toml"));
    let gauges = parts.map(|part| format!("[[gauge]]\nsim = \"{part}\"\n")).concat();
    fs::write(&file, gauges).expect("a file");
    gaugefs(&["mount", "--config", &file, &at]).done();
    Some(Gauge { folder, at })
}

fn json(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[test]
fn a_gauge_is_found_by_its_name_if_only_one_has_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let name = format!("PACK-{}", std::process::id());
    let [first, second] = ["m", "n"].map(|at| folder.file(at));
    let mount = |at: &str| {
        gaugefs(&["mount", "--sim", CHIP, "--fast", "--name", &name, at]).done();
    };
    mount(&first);
    let whole = format!("{first}/{name}");
    let told = gaugefs(&["set", &name, "cell-terminate-voltage=3.1V"]).done();
    assert_eq!(told, format!("{NAME}: 3000 -> 3100 mV\n"));
    assert_eq!(gaugefs(&["get", &name, NAME]).done(), format!("{NAME}: 3100 mV\n"));
    for words in
        [&["export", &name][..], &["wait", &name, "capacity>0"], &["settle", &name], &["diff", &name, &whole]]
    {
        gaugefs(words).done();
    }
    gaugefs(&["top", "--json", "--count", "1", &name]).done();
    // A file of that name is that file.
    let file = folder.file(&name);
    fs::write(&file, "").expect("a file");
    let ran = Ran::of(command(&["get", &name, NAME]).current_dir(&folder.0).output().expect("gaugefs runs"));
    ran.troubled(&["is neither a folder nor a mounted gauge"]);
    mount(&second);
    let both = format!("several gauges have that name; write one of {whole}, {second}/{name}");
    gaugefs(&["get", &name, NAME]).failed(&[&name, &both]);
    gaugefs(&["wait", &name, "capacity>0"]).failed(&[&both]);
    gaugefs(&["umount", &second]).done();
    // An alias.
    gaugefs(&["unmount", &first]).done();
    gaugefs(&["get", &name, NAME]).troubled(&["is neither a folder nor a mounted gauge"]);
}

#[test]
fn the_right_name_is_found_by_part_of_a_word() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let get = |name: &str| gaugefs(&["get", &gauge.path(), name]);
    get("terminate-voltage").failed(&["did you mean it-cfg/cell-terminate-voltage?"]);
    get("voltage_now").failed(&["did you mean the file voltage_now of the gauge's folder?"]);
    get("voltage")
        .failed(&["a bq34z100-G1 has no such parameter", "or the file voltage_now of the gauge's folder?"]);
    gauge.set(&["voltage_now=3V"]).failed(&["the file voltage_now of the gauge's folder?"]);
    let wait = |condition: &str| gaugefs(&["wait", "--timeout", "0", &gauge.path(), condition]);
    assert!(wait("voltage<3V").err.contains("did you mean voltage_now?"));
    assert!(wait("terminate-voltage<3V").err.contains("cell-terminate-voltage is a parameter of data flash"));
}

#[test]
fn values_in_steps_are_shown_as_a_person_reads_them() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let told = gauge.set(&["ot-chg=60C"]).done();
    assert_eq!(told, "safety/ot-chg: 55.0 °C (550) -> 60.0 °C (600)\n");
    assert_eq!(gaugefs(&["get", &gauge.path(), "ot-chg"]).done(), "safety/ot-chg: 60.0 °C (600)\n");
    let json = gaugefs(&["get", "--json", &gauge.path(), "ot-chg"]).done();
    assert_eq!(self::json(&json)[0]["values"][0]["value"], 600);
    gauge.set(&["ot-chg=200C"]).failed(&["outside 0.0 °C (0) to 120.0 °C (1200)"]);
}

#[test]
fn a_new_design_capacity_says_what_stays() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let ran = gauge.set(&["design-capacity=850"]);
    let (path, energy) = (gauge.path(), "configuration-data/design-energy");
    for says in [
        "Design Energy stays 5400 mWh, which fits 1000 mAh",
        &format!("gaugefs set {path} {energy}=4590 fits 850 mAh"),
        "Qmax Cell 0 is learned later",
    ] {
        assert!(ran.gauges.iter().any(|line| line.contains(says)), "{says}: {:?}", ran.gauges);
    }
    let told = gauge.set(&["design-capacity=900", "design-energy=4860"]).gauges.concat();
    assert!(!told.contains("Design Energy") && told.contains("Qmax Cell 0"), "{told}");
    let told = gauge.set(&["ot-chg=61C"]).gauges.concat();
    assert!(!told.contains("Qmax"), "{told}");
}

#[test]
fn set_writes_names_and_units_in_one_transaction() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let (writes, resets) = (gauge.number("flash_writes"), gauge.number("resets"));
    let words = [
        &format!("{NAME}=3.1V") as &str,
        "design-capacity=2.2Ah",
        "manufacture-date=2026-11-22",
        "serial-number=42",
    ];
    let told = "configuration-data/manufacture-date: 0 -> 2026-11-22\n\
                configuration-data/serial-number: 0x0001 -> 0x002a\n";
    let dry = gauge.set(&[&words[..], &["--dry-run"]].concat()).differs();
    assert!(told.lines().all(|line| dry.contains(line)), "{dry}");
    assert_eq!(read(&gauge.at, "BAT0/df/80/53"), "3000", "a dry run writes nothing");
    let done = gauge.set(&words).done();
    assert_eq!(done, dry);
    assert!(done.contains(&format!("{NAME}: 3000 -> 3100 mV\n")), "{done}");
    for (path, value) in [("df/80/53", "3100"), ("df/48/2", "23926"), ("df/48/4", "0x002a")] {
        assert_eq!(read(&gauge.at, &format!("BAT0/{path}")), value, "{path}");
    }
    assert_eq!(
        (gauge.number("flash_writes") - writes, gauge.number("resets") - resets),
        (2, 1),
        "two blocks"
    );
    assert_eq!(read(&gauge.at, "BAT0/gauge/seal"), "sealed");
    // Nothing differs any more.
    assert_eq!(gauge.set(&words).done(), "");
    assert_eq!(gauge.set(&[&words[..], &["--dry-run"]].concat()).done(), "");
    let shown = gaugefs(&["get", &gauge.path(), NAME, "manufacture-date", "48/4"]).done();
    assert_eq!(
        shown,
        format!(
            "{NAME}: 3100 mV\nconfiguration-data/manufacture-date: 2026-11-22\n\
             configuration-data/serial-number: 0x002a\n"
        )
    );
    let all = gaugefs(&["get", &gauge.path()]).done();
    assert!(shown.lines().all(|line| all.lines().any(|other| other == line)), "{all}");
    // What get shows, set takes.
    for line in all.lines() {
        let (name, value) = line.split_once(": ").expect("a name");
        if value.is_empty() {
            continue;
        }
        let same = gauge.set(&["--dry-run", &format!("{name}={value}")]);
        assert!(same.code == Some(0) || same.err.contains("is outside"), "{line}: {}{}", same.out, same.err);
        if name.starts_with("it-cfg/") {
            break;
        }
    }
}

#[test]
fn set_refuses_what_is_wrong_and_then_writes_nothing() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let transfers = || read(&gauge.at, "BAT0/gauge/statistics/flash_writes");
    let before = transfers();
    for (word, says) in [
        ("it-cfg/cell-terminate-voltag=3.1V", "did you mean it-cfg/cell-terminate-voltage?"),
        (
            "cell-terminate-voltage=3.1A",
            "it-cfg/cell-terminate-voltage: another unit; it is stored in mV, and accepts mV or V",
        ),
        ("cell-terminate-voltage=3.1005V", "not rounded"),
        ("cell-terminate-voltage=4V", "outside 1000 to 3700 mV"),
        ("manufacture-date=2026-02-30", "write a day from 1980-01-01"),
        ("codes/sealed-to-unsealed=1", "gaugefs keys change"),
        ("nonsense=1", "`gaugefs get` without a name lists them"),
        ("80/53=3200", "it is given twice"),
    ] {
        // The first one alone could be written.
        gauge.set(&[&format!("{NAME}=3100"), word]).failed(&[says]);
        gauge.set(&["--dry-run", &format!("{NAME}=3100"), word]).troubled(&[says]);
    }
    assert_eq!((read(&gauge.at, "BAT0/df/80/53").as_str(), transfers()), ("3000", before));
    gaugefs(&["set", &gauge.path(), "nonsense"]).troubled(&["write NAME=VALUE"]);
    gaugefs(&["set", "it-cfg/x=1", "y=2"]).troubled(&["name a gauge first"]);
    gaugefs(&["get", &gauge.path(), "cell-terminate-volts"])
        .failed(&["did you mean it-cfg/cell-terminate-voltage?"]);
    gaugefs(&["get", &gauge.path(), "codes/sealed-to-unsealed"]).failed(&["keys are never read"]);
    gaugefs(&["get", "/etc", NAME]).failed(&["/etc: not a mounted gauge"]);
}

/// A part of the message of the daemon, which decides what only it knows.
#[test]
fn what_the_mount_refuses_is_told_and_leaves_no_transaction_open() {
    let Some(gauge) = Gauge::new(&["--read-only"]) else { return };
    gauge.set(&[&format!("{NAME}=3100")]).failed(&["Read-only"]);
    assert_eq!(read(&gauge.at, "BAT0/df/transaction"), "idle");
    assert_eq!(gaugefs(&["get", &gauge.path(), NAME]).done(), format!("{NAME}: 3000 mV\n"));
}

/// Somebody's failure is there already, and the next one has no rights: another cause.
#[test]
fn regression_a_user_without_rights_is_told_so_and_not_the_last_error() {
    if !nix::unistd::geteuid().is_root() {
        eprintln!("SKIPPED: without root there is no other user to be refused");
        return;
    }
    let Some(gauge) = Gauge::new(&[]) else { return };
    let path = gauge.path();
    let program = gauge.folder.file("gaugefs");
    fs::copy(env!("CARGO_BIN_EXE_gaugefs"), &program).expect("a copy that everybody may run");
    let image = gauge.folder.file("pack.toml");
    gaugefs(&["export", &path, "-o", &image]).done();
    let word = format!("{NAME}=3100");
    let actions = [
        &["get", &path, NAME][..],
        &["get", &path],
        &["set", &path, &word],
        &["set", "--dry-run", &path, &word],
        &["settle", &path],
        &["settle", &path, "--undo"],
        &["settle", &path, "--discard"],
        &["export", &path],
        &["import", &path, &image],
        &["diff", &path, &image],
        &["report", &path, "-o", "/dev/null/none"],
        &["calibrate", &path, "voltage", "--actual", "4V"],
        &["calibrate", &path, "leave"],
        &["bringup", &path, "--cells", "4", "--divider", "20V"],
    ];
    for arguments in actions {
        // It is as new as it can be.
        fs::write(format!("{path}/df/80/53"), "9999").expect_err("out of range");
        assert!(read(&path, "gauge/last_error").contains("outside 1000 to 3700"));
        let mut command = std::process::Command::new(&program);
        command.args(arguments).current_dir("/").env_remove("XDG_RUNTIME_DIR");
        std::os::unix::process::CommandExt::uid(&mut command, 65534);
        std::os::unix::process::CommandExt::gid(&mut command, 65534);
        let ran = run(command);
        let last = ran.err.lines().last().unwrap_or_default();
        assert!([Some(1), Some(2)].contains(&ran.code), "{arguments:?}: {}", ran.err);
        assert!(
            last.contains("Permission denied; only the mount's owner and group may"),
            "{arguments:?}: {}",
            ran.err
        );
        assert!(!ran.err.contains("outside"), "{arguments:?}: {}", ran.err);
    }
    // Whoever may is told why the daemon refuses.
    gauge.set(&[&format!("{NAME}=3999mV")]).failed(&["outside 1000 to 3700"]);
    fs::write(format!("{path}/sim/power"), "off").expect("a knob");
    gaugefs(&["get", &path, NAME]).failed(&["Z: ", "not acknowledged"]);
}

#[test]
fn several_gauges_are_each_done_for_themselves() {
    let Some(gauges) = two([CHIP, "bq27441-g1"]) else { return };
    let (one, other) = (format!("{}/BAT0", gauges.at), format!("{}/BAT1", gauges.at));
    let word = format!("{NAME}=3.1V");
    // Only the first has that parameter.
    let ran = gaugefs(&["set", &other, &one, &word]);
    assert_eq!(ran.code, Some(1));
    assert_eq!(ran.out, format!("{one} serial 0x0001: {NAME}: 3000 -> 3100 mV\n"));
    assert!(ran.err.contains("a bq27441-G1 has no such parameter"), "{}", ran.err);
    let ran = gaugefs(&["set", "--fail-fast", &other, &one, &format!("{NAME}=3200")]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""));
    assert!(ran.err.ends_with("1 more not tried, because of --fail-fast\n"), "{}", ran.err);
    assert_eq!(read(&gauges.at, "BAT0/df/80/53"), "3100");

    let ran = gaugefs(&["set", "--json", &one, &other, &format!("{NAME}=3200")]);
    assert_eq!(ran.code, Some(1));
    let [first, second] = &json(&ran.out)[..] else { panic!("{}", ran.out) };
    assert_eq!(first["gauge"], one.as_str());
    assert_eq!((&first["part"], &first["serial"]), (&"bq34z100-G1".into(), &"0x0001".into()));
    assert_eq!(
        (&first["outcome"], &first["exit_code"], &first["error"]),
        (&"written".into(), &0.into(), &Value::Null)
    );
    let change = &first["changes"][0];
    assert_eq!((&change["name"], &change["unit"]), (&NAME.into(), &"mV".into()));
    assert_eq!((&change["old"], &change["new"]), (&3100.into(), &3200.into()));
    assert_eq!((&second["outcome"], &second["exit_code"]), (&"failed".into(), &1.into()));
    assert!(second["error"].as_str().expect("a text").contains("no such parameter"));
    assert_eq!(second["error_details"]["errno"], "ENOENT");
    assert_eq!(first["error_details"], Value::Null);

    let ran = gaugefs(&["set", "--json", &one, &format!("{NAME}=9V")]);
    let details = &json(&ran.out)[0]["error_details"];
    let fact = |name: &str| details[name].as_str().unwrap_or_default();
    assert_eq!((fact("errno"), fact("cause"), fact("place")), ("ERANGE", "out-of-range", "80/53"));
    assert_eq!((&details["least"], &details["greatest"]), (&1000.into(), &3700.into()));
    // What only the gauge can refuse has its facts, too.
    fs::write(Path::new(&one).join("sim/voltage_mv"), "2700").expect("a knob");
    let ran = gaugefs(&["set", "--json", &one, &format!("{NAME}=3300")]);
    let details = &json(&ran.out)[0]["error_details"];
    assert_eq!((&details["errno"], &details["reason"]), (&"EAGAIN".into(), &"flash-voltage".into()));
    assert_eq!((&details["value"], &details["least"]), (&2700.into(), &2800.into()));
    let ran = gaugefs(&["get", "--json", &one, NAME]).done();
    let value = &json(&ran)[0]["values"][0];
    assert_eq!((&value["name"], &value["value"], &value["unit"]), (&NAME.into(), &3200.into(), &"mV".into()));
}

#[test]
fn a_mount_point_stands_for_its_only_gauge() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let file = gauge.folder.file("pack.toml");
    gaugefs(&["export", &gauge.at, "-o", &file]).done();
    assert_eq!(gaugefs(&["diff", &file, &gauge.at]).done(), "");
    assert_eq!(gaugefs(&["diff", &gauge.at, &file]).done(), "");
    assert_eq!(gaugefs(&["import", &gauge.at, &file]).done(), "");
    assert_eq!(gaugefs(&["settle", &gauge.at]).done(), "nothing to settle\n");
    assert_eq!(gaugefs(&["get", &gauge.at, NAME]).done(), format!("{NAME}: 3000 mV\n"));
    gaugefs(&["report", &gauge.at, "-o", &gauge.folder.file("report")]).done();
    gaugefs(&["calibrate", &gauge.at, "leave"]);
    assert!(!read(&gauge.at, "BAT0/gauge/last_error").contains("not a mounted gauge"));
}

#[test]
fn a_mount_point_of_several_gauges_is_refused_with_their_names() {
    let Some(gauges) = two([CHIP, CHIP]) else { return };
    let file = gauges.folder.file("pack.toml");
    gaugefs(&["export", &format!("{}/BAT0", gauges.at), "-o", &file]).done();
    let says = ["2 gauges are mounted there; name one: ", "/m/BAT0, ", "/m/BAT1"];
    for arguments in [
        &["export", &gauges.at][..],
        &["import", &gauges.at, &file],
        &["settle", &gauges.at],
        &["calibrate", &gauges.at, "leave"],
        &["report", &gauges.at],
        &["bringup", &gauges.at, "--cells", "4", "--divider", "20000"],
        &["keys", "change", &gauges.at, "unseal"],
        &["set", &gauges.at, "80/53=3100"],
        &["get", &gauges.at, "80/53"],
    ] {
        gaugefs(arguments).failed(&says);
    }
    gaugefs(&["diff", &file, &gauges.at]).troubled(&says);
    gaugefs(&["auth", &gauges.at, "--key-file", &file]).troubled(&says);
    // Each of them, in a folder.
    let packs = gauges.folder.file("packs");
    fs::create_dir(&packs).expect("a folder");
    let both = [format!("{}/BAT0", gauges.at), format!("{}/BAT1", gauges.at)];
    gaugefs(&["export", &both[0], &both[1], "-o", &packs]).done();
    for name in ["BAT0.toml", "BAT1.toml"] {
        assert_eq!(gaugefs(&["lint", &format!("{packs}/{name}")]).code, Some(0), "{name}");
    }
    gaugefs(&["export", &both[0], &both[1]]).troubled(&["several gauges need a folder"]);
    gaugefs(&["export", &both[0], &both[0], "-o", &packs]).troubled(&["two gauges are named BAT0"]);
    gaugefs(&["export", "--json", &both[0]]).troubled(&["--json needs --output"]);
    gaugefs(&["export", "--json", &both[0], "-o", "-"]).troubled(&["--json needs --output"]);
    // One that is not there is made, if its name says that it is a folder.
    let new = gauges.folder.file("new/packs");
    gaugefs(&["export", &both[0], &both[1], "-o", &new]).troubled(&["several gauges need a folder"]);
    assert!(!Path::new(&new).exists());
    gaugefs(&["export", &both[0], &both[1], "--format", "gg.csv", "-o", &format!("{new}/")]).done();
    assert!(Path::new(&format!("{new}/BAT1.gg.csv")).exists());
    let report = gaugefs(&["export", "--json", &both[0], "-o", &packs]).done();
    assert_eq!(json(&report)[0]["file"], format!("{packs}/BAT0.toml"));
    assert_eq!(json(&report)[0]["outcome"], "read");
}

#[test]
fn the_ending_of_an_export_chooses_its_format() {
    let Some(gauges) = two([CHIP, CHIP]) else { return };
    let gauge = format!("{}/BAT0", gauges.at);
    for (format, ending) in [("toml", "toml"), ("gg.csv", "gg.csv"), ("flashstream", "gm.fs")] {
        let (chosen, asked) = (gauges.folder.file(&format!("a.{ending}")), gauges.folder.file("asked"));
        gaugefs(&["export", &gauge, "-o", &chosen]).done();
        gaugefs(&["export", &gauge, "--format", format, "-o", &asked]).done();
        let lines = |file: &str| {
            let text = fs::read_to_string(file).expect("the export");
            // The time of the export is in a comment.
            text.lines()
                .filter(|line| !line.starts_with(['#', ';', '*']))
                .map(String::from)
                .collect::<Vec<_>>()
        };
        assert_eq!(lines(&chosen), lines(&asked), "{ending}");
        gaugefs(&["lint", &chosen]).done();
    }
    let file = gauges.folder.file("b.gm.fs");
    gaugefs(&["export", &gauge, "--format", "toml", "-o", &file])
        .troubled(&["--format is toml, but a file of that name is a flashstream"]);
    let image = gauges.folder.file("b.df.fs");
    gaugefs(&["export", &gauge, "-o", &image]).troubled(&["ROM mode"]);
    assert!(!Path::new(&file).exists() && !Path::new(&image).exists());
}

#[test]
fn an_image_from_standard_input_goes_to_every_gauge_with_what_is_set() {
    let Some(gauges) = two([CHIP, CHIP]) else { return };
    let both = [format!("{}/BAT0", gauges.at), format!("{}/BAT1", gauges.at)];
    let image = format!(
        "chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n[configuration-data]\nserial-number = 7\n"
    );
    let import = |more: &[&str]| {
        let mut command = command(&[&["import", &both[0], &both[1], "-"], more].concat());
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("gaugefs runs");
        child.stdin.take().expect("a pipe").write_all(image.as_bytes()).expect("it reads");
        let output = child.wait_with_output().expect("it ends");
        (output.status.code(), String::from_utf8(output.stdout).expect("text"), output.stderr)
    };
    let set = ["--exclude", "serial", "--set", "serial-number=42", "--set", "manufacture-date=2026-11-22"];
    let lines = |gauge: &str| {
        format!(
            "{gauge} serial 0x0001: {NAME}: 3000 -> 3100 mV\n\
             {gauge} serial 0x0001: configuration-data/manufacture-date: 0 -> 2026-11-22\n\
             {gauge} serial 0x0001: configuration-data/serial-number: 0x0001 -> 0x002a\n"
        )
    };
    let (code, out, err) = import(&[&set[..], &["--dry-run"]].concat());
    assert_eq!(code, Some(1), "{}", String::from_utf8_lossy(&err));
    assert_eq!(out, lines(&both[0]) + &lines(&both[1]));
    let (code, out, err) = import(&[&set[..], &["--json"]].concat());
    assert_eq!(code, Some(0), "{}", String::from_utf8_lossy(&err));
    for (report, gauge) in json(&out).iter().zip(&both) {
        assert_eq!((&report["gauge"], &report["outcome"]), (&gauge.as_str().into(), &"written".into()));
        assert_eq!(report["changes"].as_array().expect("a list").len(), 3);
    }
    for gauge in ["BAT0", "BAT1"] {
        assert_eq!(read(&gauges.at, &format!("{gauge}/df/48/4")), "0x002a");
        assert_eq!(read(&gauges.at, &format!("{gauge}/df/80/53")), "3100");
    }
    let (code, out, _) = import(&set);
    assert_eq!(code, Some(0));
    assert_eq!(out.lines().filter(|line| line.ends_with(": unchanged")).count(), 2, "{out}");
    let (code, out, err) = import(&["--set", "serial-numbr=1"]);
    assert_eq!((code, out.as_str()), (Some(1), ""));
    assert!(String::from_utf8_lossy(&err).contains("did you mean configuration-data/serial-number?"));
    gaugefs(&["diff", "-", "-"]).troubled(&["standard input: it has one file only"]);
}

/// Export, diff and import have the date as one.
#[test]
fn a_date_goes_through_a_file() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let file = gauge.folder.file("pack.toml");
    gauge.set(&["manufacture-date=2012-05-23"]).done();
    gaugefs(&["export", &gauge.path(), "-o", &file]).done();
    let text = fs::read_to_string(&file).expect("the export");
    assert!(text.contains("\nmanufacture-date = 2012-05-23\n"), "{text}");
    gauge.set(&["manufacture-date=2026-11-22"]).done();
    let line = |old: &str, new: &str| format!("configuration-data/manufacture-date: {old} -> {new}\n");
    assert_eq!(gaugefs(&["diff", &file, &gauge.path()]).differs(), line("2012-05-23", "2026-11-22"));
    assert_eq!(gaugefs(&["import", &gauge.path(), &file]).done(), line("2026-11-22", "2012-05-23"));
    assert_eq!(read(&gauge.at, "BAT0/df/48/2"), "16567");
    fs::write(&file, text.replace("2012-05-23", "23926")).expect("a file");
    assert_eq!(gaugefs(&["import", &gauge.path(), &file]).done(), line("2012-05-23", "2026-11-22"));
}

/// The log has what a report has: serial number, parameter, old and new value.
#[test]
fn the_log_has_serial_number_parameter_and_values() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, log) = (folder.file("m"), folder.file("log"));
    gaugefs(&["mount", "--sim", CHIP, "--log", &log, &at]).done();
    gaugefs(&["set", &at, &format!("{NAME}=3.1V")]).done();
    let text = fs::read_to_string(&log).expect("the log");
    let line = "Z serial 0x0001: Cell Terminate Voltage: 3000 -> 3100 mV, written and verified\n";
    assert!(text.contains(line), "{text}");
}

#[test]
fn the_names_that_a_shell_completes_are_those_that_set_takes() {
    let Some(gauge) = Gauge::new(&[]) else { return };
    let names = gaugefs(&["names", &gauge.path()]).done();
    assert_eq!(gaugefs(&["names", &gauge.at]).done(), names, "the mount point of a single gauge");
    assert!(names.lines().any(|name| name == NAME) && !names.contains("codes/"), "{names}");
    let shown = gaugefs(&["get", &gauge.path()]).done();
    let shown: Vec<_> =
        shown.lines().filter_map(|line| line.split_once(": ")).map(|(name, _)| name).collect();
    let (whole, short): (Vec<_>, Vec<_>) = names.lines().partition(|name| name.contains('/'));
    assert_eq!(whole, shown);
    // A short name is there if it means one parameter.
    let last = |name: &&str| name.rsplit('/').next().map(str::to_string);
    let own: Vec<String> = shown.iter().filter_map(last).collect();
    let once = own.iter().filter(|name| own.iter().filter(|other| other == name).count() == 1);
    assert_eq!(short, once.collect::<Vec<_>>());
    assert_eq!(gaugefs(&["names", "/etc"]).done(), "");
    // bash, with the script that the package installs.
    let script = gauge.folder.file("completions");
    fs::write(&script, gaugefs(&["completions", "bash"]).done()).expect("a file");
    let complete = |verb: &str, word: &str| {
        let ask = format!(
            r#"PATH="$3:$PATH"; . "$1"; COMP_WORDS=(gaugefs {verb} "$2" {word}); COMP_CWORD=3
            _gaugefs_names gaugefs '{word}' "$2"; echo "${{COMPREPLY[@]}}""#
        );
        let program = Path::new(env!("CARGO_BIN_EXE_gaugefs")).parent().expect("a folder");
        let mut bash = std::process::Command::new("bash");
        bash.args(["-c", &ask, "bash", &script, &gauge.path()]).arg(program);
        run(bash)
    };
    assert_eq!(complete("set", "it-cfg/cell-termi").done(), "it-cfg/cell-terminate-voltage=\n");
    assert_eq!(complete("get", "it-cfg/cell-termi").done(), "it-cfg/cell-terminate-voltage\n");
    assert_eq!(complete("set", "cell-termi").done(), "cell-terminate-voltage=\n");
    let bash_script = gauge.folder.file("completions.bash");
    fs::copy(&script, &bash_script).expect("a copy");
    fs::write(&script, gaugefs(&["completions", "fish"]).done()).expect("a file");
    // In fish a variable without a value makes the whole word vanish: `get` completed nothing.
    for (verb, end) in [("set", "="), ("get", "")] {
        let mut fish = std::process::Command::new("fish");
        let ask = format!(
            r#"set PATH $argv[3] $PATH; source $argv[1]; complete -C "gaugefs {verb} '$argv[2]' it-cfg/cell-termi""#
        );
        let program = Path::new(env!("CARGO_BIN_EXE_gaugefs")).parent().expect("a folder");
        fish.args(["--no-config", "-c", &ask, &script, &gauge.path()]).arg(program);
        match fish.output() {
            Ok(answer) => {
                let answer = String::from_utf8_lossy(&answer.stdout).into_owned();
                assert_eq!(answer.trim_end(), format!("it-cfg/cell-terminate-voltage{end}"));
            }
            Err(_) => eprintln!("SKIPPED: fish is not installed; its completion of names was not tried"),
        }
    }
    let offered = |line: &str, at: usize| {
        let ask = format!(
            r#"PATH="$2:$PATH"; . "$1"; COMP_WORDS=({line}); COMP_CWORD={at}
            _gaugefs_names gaugefs "${{COMP_WORDS[{at}]}}" "${{COMP_WORDS[{at} - 1]}}"; printf '%s\n' "${{COMPREPLY[@]}}""#
        );
        let program = Path::new(env!("CARGO_BIN_EXE_gaugefs")).parent().expect("a folder");
        let mut bash = std::process::Command::new("bash");
        bash.args(["-c", &ask, "bash", &bash_script]).arg(program);
        run(bash).done()
    };
    // Other tests have mounts, too.
    for command in ["get", "export", "top", "settle", "watch"] {
        assert!(
            offered(&format!("gaugefs {command} ''"), 2).lines().any(|line| line == gauge.path()),
            "{command}"
        );
    }
    assert_eq!(offered("gaugefs mount --sim bq35100 --scenario robot", 5), "robot-day\n");
    assert_eq!(offered("gaugefs log --columns volt", 3), "voltage\n");
    assert_eq!(offered("gaugefs plot --columns voltage,full_", 3), "voltage,full_charge\n");
    let buses = gaugefs(&["names", "--of", "buses"]).done();
    assert_eq!(buses.lines().count(), gauge_bus::linux::adapters(Path::new("/")).len());
    for (shell, word) in [("zsh", "_gaugefs_names"), ("fish", "__gaugefs_names")] {
        let script = gaugefs(&["completions", shell]).done();
        assert!(script.matches(word).count() >= 2, "{shell}: its names are not asked for");
    }
}

#[test]
fn a_trace_is_not_written_over() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, trace) = (folder.file("m"), folder.file("trace"));
    fs::write(&trace, "mine\n").expect("a file");
    let mount = |more: &[&str]| gaugefs(&[&["mount", "--sim", CHIP, "--trace", &trace, &at], more].concat());
    mount(&[]).failed(&[&trace, "is there already", "--trace-replace"]);
    assert_eq!(fs::read_to_string(&trace).expect("it"), "mine\n");
    assert!(!Path::new(&at).exists(), "a refused mount leaves nothing behind");
    mount(&["--trace-replace"]).done();
    assert!(fs::read_to_string(&trace).expect("it").starts_with("; gaugefs: bq34z100-g1"));
    gaugefs(&["umount", &at]).done();
    // The same from a file, whose gauges are mounted even if some cannot be.
    let config = folder.file("config.toml");
    fs::write(&config, format!("[[gauge]]\nsim = \"{CHIP}\"\ntrace = \"{trace}\"\n")).expect("a file");
    gaugefs(&["mount", "--config", &config, &at]).failed(&[&trace, "is there already"]);
}

#[test]
fn folders_that_a_mount_has_made_are_removed_at_its_end() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let deep = format!("{}/a/b", folder.file("n"));
    let is_gone = |path: &str| {
        let path = path.to_string();
        within("removed", move || !Path::new(&path).exists());
    };
    gaugefs(&["mount", "--sim", CHIP, &deep]).done();
    gaugefs(&["umount", &deep]).done();
    is_gone(&folder.file("n"));
    // One that was there stays, and so does one in which something is.
    let at = folder.file("m");
    fs::create_dir(&at).expect("a folder");
    gaugefs(&["mount", "--sim", CHIP, &format!("{at}/new")]).done();
    fs::write(format!("{at}/mine"), "").expect("a file");
    gaugefs(&["umount", &format!("{at}/new")]).done();
    is_gone(&format!("{at}/new"));
    assert!(Path::new(&at).exists());
    // Mounted, unmounted and mounted again at once: the first daemon does not remove what the next one uses.
    for _ in 0..5 {
        gaugefs(&["mount", "--sim", CHIP, &format!("{at}/new")]).done();
        gaugefs(&["umount", &format!("{at}/new")]).done();
    }
    is_gone(&format!("{at}/new"));
}

/// The folder of locks goes with the last of them.
#[test]
fn the_folder_of_locks_is_removed_with_the_last() {
    if !can_mount() {
        return;
    }
    if nix::unistd::geteuid().is_root() {
        // Root's is shared with every other test.
        eprintln!("SKIPPED: as root the folder of locks is /run/gaugefs, which other tests use");
        return;
    }
    let folder = Folder::new();
    let (at, state) = (folder.file("m"), folder.file("state"));
    let runtime = folder.file("runtime");
    fs::create_dir(&runtime).expect("a folder");
    let mut mount = command(&["mount", "--sim", CHIP, "--sim-state", &state, &at]);
    mount.env("XDG_RUNTIME_DIR", &runtime);
    run(mount).done();
    assert!(Path::new(&runtime).join("gaugefs").exists());
    gaugefs(&["umount", &at]).done();
    let gone = || !Path::new(&runtime).join("gaugefs").exists();
    within("removed", gone);
}
