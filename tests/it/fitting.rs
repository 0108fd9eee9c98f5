// SPDX-License-Identifier: MIT

//! `gaugefs check --for`: what a gauge lacks for a battery, and how it gets that.

use std::fs;

use serde_json::Value as Json;

use crate::room::{CHIP, Folder, Ran, can_mount, gaugefs, read};

/// The answer about the battery.
fn battery(ran: &Ran) -> Json {
    let answer: Json =
        serde_json::from_str(ran.out.trim()).unwrap_or_else(|_| panic!("{}{}", ran.out, ran.err));
    assert!(answer["battery"].is_object(), "{}{}", ran.out, ran.err);
    answer["battery"].clone()
}

/// The new values by their names.
fn rows(battery: &Json) -> Vec<String> {
    let rows = battery["rows"].as_array().expect("a list").iter();
    rows.map(|row| format!("{}={}", row["name"].as_str().expect("a name"), row["new"])).collect()
}

fn due(battery: &Json) -> Vec<&str> {
    let steps = battery["steps"].as_array().expect("a list").iter();
    steps.filter(|step| step["due"] == true).map(|step| step["step"].as_str().expect("a name")).collect()
}

/// Each part with a battery that is not the one it has by itself.
const PARTS: [(&str, &str, &str); 12] = [
    ("bq34z100-g1", "li-ion 1s 1.2Ah", "configuration-data/design-capacity=1200"),
    ("bq34z100-r2", "lfp 1s 1.2Ah", "configuration-data/design-energy=384"),
    ("bq27520-g3", "li-ion 1s 1.2Ah terminate-voltage=3.1V", "it-cfg/terminate-voltage=3100"),
    ("bq27500", "li-ion 1s 1.2Ah terminate-voltage=3.1V", "it-cfg/terminate-voltage=3100"),
    ("bq27441-g1", "li-ion 1s 1.2Ah taper-current=60mA", "state/taper-rate=200"),
    ("bq27421-g1", "li-ion 1s 1.2Ah charge-voltage=4.25V", "state/taper-voltage=4150"),
    ("bq27426", "li-ion 1s 1.2Ah energy=4.4Wh", "state/design-energy=4400"),
    ("bq27427", "li-ion 1s 1.2Ah", "state/design-energy=4440"),
    ("bq27621-g1", "li-ion 1s 1.2Ah", "state/design-capacity=1200"),
    ("bq27220", "li-ion 1s 2.5Ah terminate-voltage=3.1V", "cedv-profile-1/fixed-edv-0=3100"),
    ("bq34110", "pb 6s 7Ah", "configuration-data/number-of-series-cells=6"),
    ("bq35100", "li-socl2 2s 2.4Ah", "design/series-cell-count=2"),
];

#[test]
fn each_part_says_what_it_lacks() {
    for (part, wanted, row) in PARTS {
        let ran = gaugefs(&["check", "--json", "--for", wanted, "--sim", part]);
        assert_eq!(ran.code, Some(1), "{part}: {}{}", ran.out, ran.err);
        let battery = battery(&ran);
        assert!(rows(&battery).contains(&row.into()), "{part}: {battery}");
        assert_eq!(battery["unread"], Json::Array(Vec::new()), "{part}");
        let sources = battery["rows"].as_array().expect("a list").iter().map(|row| &row["source"]);
        assert!(
            sources.into_iter().all(|source| source.as_str().is_some_and(|text| !text.is_empty())),
            "{part}"
        );
    }
}

#[test]
fn a_fixed_gauge_of_each_part_lacks_nothing() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, config) = (folder.file("m"), folder.file("gauges.toml"));
    let gauges = PARTS.map(|(part, ..)| format!("[[gauge]]\nsim = \"{part}\"\nname = \"{part}\"\n"));
    fs::write(&config, gauges.concat()).expect("a file");
    gaugefs(&["mount", "--config", &config, &at]).done();
    for (part, wanted, row) in PARTS {
        let gauge = format!("{at}/{part}");
        let check =
            |more: &[&str]| gaugefs(&[&["check", "--json", "--for", wanted], more, &[&gauge]].concat());
        // Showing it writes nothing.
        let shown = battery(&check(&["--fix"]));
        assert!(rows(&shown).contains(&row.into()) && shown["written"] == false, "{part}: {shown}");
        let ran = check(&["--fix", "--write"]);
        let written = battery(&ran);
        assert_eq!(
            (&written["written"], rows(&written)),
            (&true.into(), rows(&shown)),
            "{part}: {}",
            ran.err
        );
        let (name, value) = row.split_once('=').expect("a row");
        assert_eq!(read(&gauge, &format!("df/by-name/{name}")), value, "{part}");
        for more in [&[][..], &["--fix", "--write"]] {
            // After its reset the gauge may be away for a moment.
            let answers = || (0..100).map(|_| check(more)).find(|ran| ran.out.contains("\"battery\""));
            let again = battery(&answers().expect("an answer"));
            assert!(rows(&again).is_empty() && again["written"] == false, "{part}: {again}");
            assert_eq!((&again["command"], due(&again)), (&Json::Null, Vec::new()), "{part}: {again}");
        }
    }
    gaugefs(&["umount", &at]).done();
}

#[test]
fn what_fix_prints_can_be_typed_and_several_cells_are_brought_up_first() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    let set = |knob: &str, text: &str| fs::write(format!("{gauge}/sim/{knob}"), text).expect("a knob");
    gaugefs(&["mount", "--sim", CHIP, "--state-dir", &folder.file("state"), &at]).done();
    set("cells", "3");
    set("board_divider", "15000");
    let wanted = "li-ion 3s 1.2Ah taper-current=60mA";
    let shown = gaugefs(&["check", "--for", wanted, "--fix", &gauge]);
    assert_eq!(shown.code, Some(1), "{}{}", shown.out, shown.err);
    for says in [
        "differs   configuration-data/design-capacity: 1000 -> 1200 mAh\n          SLUSBZ5D 8.2.2.1.1\n"
            .into(),
        "fits      configuration-data/design-energy-scale, ".into(),
        format!(
            "to do     bringup: [VOLTSEL] is clear, so the gauge measures one cell: `gaugefs bringup '{gauge}' --cells 3 "
        ),
        format!("`gaugefs learn '{gauge}'`"),
    ] as [String; 4]
    {
        assert!(shown.out.contains(&says), "{says}: {}", shown.out);
    }
    gaugefs(&["bringup", &gauge, "--cells", "3", "--divider", "15V", "--voltage-now", "11565mV"]).done();
    let command = shown.out.lines().find(|line| line.starts_with("gaugefs set ")).expect("a command");
    // The folder has spaces, so it is quoted.
    let values = command.strip_prefix(&format!("gaugefs set '{gauge}' ")).expect("the gauge");
    gaugefs(&[&["set", &gauge], &values.split(' ').collect::<Vec<_>>()[..]].concat()).done();
    let fits = battery(&gaugefs(&["check", "--json", "--for", wanted, &gauge]));
    assert!(rows(&fits).is_empty() && due(&fits).is_empty(), "{fits}");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_battery_is_also_read_from_files() {
    let folder = Folder::new();
    let (toml, source, node) = (folder.file("pack.toml"), folder.file("pack.dts"), folder.file("battery"));
    fs::write(&toml, "chemistry = \"li-ion\"\ncells = \"1s\"\ncapacity = \"1430mAh\"\nenergy = \"5.29Wh\"\n")
        .expect("a file");
    let lines = "compatible = \"simple-battery\";\nvoltage-max-design-microvolt = <4200000>;\n\
                 energy-full-design-microwatt-hours = <5290000>;\ncharge-full-design-microamp-hours = <1430000>;\n";
    fs::write(&source, format!("bat: battery {{\n{lines}}};\n")).expect("a file");
    fs::create_dir(&node).expect("a folder");
    fs::write(format!("{node}/compatible"), b"simple-battery\0").expect("a property");
    for (name, value) in [
        ("voltage-max-design-microvolt", 4_200_000_u32),
        ("energy-full-design-microwatt-hours", 5_290_000),
        ("charge-full-design-microamp-hours", 1_430_000),
    ] {
        fs::write(format!("{node}/{name}"), value.to_be_bytes()).expect("a property");
    }
    for file in [&toml, &source, &node] {
        let found = battery(&gaugefs(&["check", "--json", "--for", file, "--sim", "bq27421-g1"]));
        let rows = rows(&found);
        for row in ["state/design-capacity=1430", "state/design-energy=5290"] {
            assert!(rows.contains(&row.into()), "{file}: {found}");
        }
    }
    let found = battery(&gaugefs(&["check", "--json", "--for", &source, "--sim", "bq27421-g1"]));
    assert!(found["battery"].as_str().is_some_and(|text| text.contains("lithium-ion is taken")), "{found}");
}

#[test]
fn an_image_and_a_report_are_compared_and_never_written() {
    let folder = Folder::new();
    let (image, report) = (folder.file("golden.toml"), folder.file("report.txt"));
    fs::write(&image, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1340\n").expect("a file");
    gaugefs(&["report", "--sim", "bq27441-g1", "-o", &report]).done();
    let wanted = "li-ion 1s 1.34Ah";
    let ran = gaugefs(&["check", "--json", "--for", wanted, &image]);
    let found = battery(&ran);
    assert_eq!((ran.code, rows(&found)), (Some(3), Vec::new()), "{}{}", ran.out, ran.err);
    let unread = found["unread"].as_array().expect("a list");
    assert!(unread.contains(&"state/design-energy".into()), "{found}");
    let ran = gaugefs(&["check", "--json", "--for", "li-ion 1s 2Ah", &image]);
    assert_eq!((ran.code, rows(&battery(&ran))), (Some(1), vec!["state/design-capacity=2000".into()]));
    assert!(battery(&gaugefs(&["check", "--json", "--for", wanted, &report]))["rows"].is_array());
    for file in [&image, &report] {
        let ran = gaugefs(&["check", "--for", wanted, "--fix", "--write", file]);
        assert_eq!(ran.code, Some(2), "{}{}", ran.out, ran.err);
        assert!(ran.err.contains("only a mounted gauge is written"), "{}", ran.err);
    }
}

#[test]
fn what_cannot_be_meant_is_misuse() {
    let base = ["check", "--sim", CHIP];
    for (words, says) in [
        (&["--for", "li-ion 3s 5200"][..], "5200 has no unit; write a capacity as 5200mAh or 5200Ah"),
        (&["--for", "li-ion 3s"], "it lacks the capacity"),
        (&["--for", "/no/such.toml"], "/no/such.toml"),
        (&["--for", "no-such.toml"], "no-such.toml"),
        (&["--for", "li-ion 3s 5Ah", "--fix", "--write"], "--write"),
        (&["--fix"], "--for"),
        (&["--for", "li-ion 3s 5Ah", "--write"], "--write"),
    ] {
        let ran = gaugefs(&[&base[..], words].concat());
        assert!(ran.code == Some(2) && ran.err.contains(says), "{words:?}: {:?} {}", ran.code, ran.err);
    }
    // A battery that the part cannot gauge is no misuse: the check could not be done.
    let ran = gaugefs(&["check", "--for", "li-ion 2s 2Ah", "--sim", "bq27427"]);
    assert!(ran.code == Some(1) && ran.err.contains("gauges one cell"), "{:?} {}", ran.code, ran.err);
}
