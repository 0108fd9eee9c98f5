// SPDX-License-Identifier: MIT

//! What a station is asked to make of its packs: an image, a calibration, and what contradicts them.

use super::*;

#[test]
fn a_new_board_is_brought_up_and_calibrated() {
    let folder = Folder::new("new");
    let image = format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n");
    fs::write(folder.file("golden.toml"), image).expect("a file");
    let plan = folder.plan(&format!(
        "{PLAIN}\ncells = 7\ndivider = 33000\npack-voltage = 26985\nboard-offset = true\ntemperature = 25"
    ));
    let clock = Arc::new(SimClock::new());
    let line = Line::start(plan, &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    for (knob, text) in
        [("cells", "7"), ("board_divider", "33000"), ("board_offset_ma", "6"), ("temperature_error", "30")]
    {
        sim.set(knob, text).expect("a knob");
    }
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert_eq!(pass.calibration.len(), 3, "{:?}", pass.calibration);
    assert!(pass.calibration[0].contains("limit"), "{:?}", pass.calibration);
    assert!(pass.calibration[2].contains("the error was"), "{:?}", pass.calibration);
    let new = |name: &str| {
        pass.changes.iter().find(|change| change.name.ends_with(name)).map(|change| &*change.new)
    };
    assert_eq!(new("/ext-temp-offset"), Some("-30"));
    assert_eq!(new("/cell-terminate-voltage"), Some("3100"));
    assert_eq!((sim.get("seal").as_deref(), sim.get("mode").as_deref()), (Some("sealed"), Some("normal")));

    // Without a load, a gain is not calibrated.
    drop(line);
    let line = Line::start(folder.plan(&format!("{PLAIN}\ncurrent = -2000")), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
    assert!(said[0].contains("switch on the current of -2000 mA"), "{said:?}");
    assert!(line.said.all().contains(&"? BAT0: switch on the current of -2000 mA".to_string()));
}

#[test]
fn an_image_that_contradicts_the_station_is_refused() {
    let folder = Folder::new("contradicts");
    let refuse = |lines: &str| folder.try_plan(lines).err().map_or(String::new(), |error| error.to_string());
    for (lines, says) in [
        ("cells = 7\ndivider = 33000", "the image has 1"),
        ("serial-parameter = 'it-cfg/nothing'\nserial = 'counter'", "has no parameter it-cfg/nothing"),
        ("serial = 'counter'\nfirst-serial = 70000", "first-serial"),
        ("pack-lot = 70000", "pack-lot"),
        ("divider = 33000", "divider: set cells too"),
        ("new-key-file = 'missing'", "missing"),
    ] {
        let error = refuse(lines);
        assert!(error.contains(says), "{lines}: {error}");
    }
    assert_eq!(refuse(""), "");
    let of = |chips: &[&str]| {
        let gauges = chips.iter().map(|chip| (chip.to_string(), simulated(chip))).collect();
        let setup = Setup::new(&folder.file("line1.toml"), Options::default(), gauges);
        Plan::read(&folder.file("golden.toml"), setup).err().expect("another part").to_string()
    };
    assert!(of(&[CHIP, "bq27441-g1"]).contains("golden.toml"), "{}", of(&[CHIP, "bq27441-g1"]));
    // RAM is lost with the power.
    fs::write(folder.file("golden.toml"), "chip = \"bq27441-g1\"\n[state]\ntaper-rate = 90\n")
        .expect("a file");
    assert!(of(&["bq27441-g1"]).contains("--profile"), "{}", of(&["bq27441-g1"]));
}

/// Images of real packs have 0 in bits that the manual reserves and prints as 1.
#[test]
fn reserved_bits_stay_as_the_pack_has_them_if_the_file_says_so() {
    let folder = Folder::new("reserved");
    let image = golden().replace("pack-configuration-b = 0xff", "pack-configuration-b = 0xaf");
    fs::write(folder.file("golden.toml"), &image).expect("a file");
    let clock = Arc::new(SimClock::new());
    let sim = new_pack(&clock, 1, None);
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    assert!(refused(&folder, &line, &clock, &sim, "none").contains("Pack Configuration B"));
    drop(line);
    let plan =
        folder.plan("serial = 'counter'\nexclude = ['serial', 'calibration', 'learned', 'undocumented']");
    let line = Line::start(plan, &[], None).expect("a record");
    let said = line.run(&clock, [(sim, "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert!(pass.changes.iter().any(|change| change.name == "it-cfg/cell-terminate-voltage"));
    assert!(pass.changes.iter().all(|change| change.name != "registers/pack-configuration-b"));
}

#[test]
fn a_wrong_part_and_another_chemistry_are_refused() {
    let folder = Folder::new("wrong");
    let clock = Arc::new(SimClock::new());
    let mut plan = folder.plan(PLAIN);
    plan.image.chemistry = Some(ti_gauge::image::Chemistry::Sum(0x1234));
    let line = Line::start(plan, &[], None).expect("a record");
    for (part, says) in
        [("bq27441-g1", "BAT0"), ("bq34z100-r2", "this is a bq34z100-R2"), (CHIP, "another chemistry")]
    {
        let sim = Sim::new(part, &gauge_sim::Options::default(), clock.clone()).expect("it is simulated");
        let said = refused(&folder, &line, &clock, &sim, "none");
        assert!(said.contains(says), "{part}: {said}");
    }
}

/// A gate that would shut at the packs' voltage.
fn wrong_image() -> String {
    let chip = Chip::by_name(CHIP).expect("it has a table");
    let (subclass, row) = chip.row("68", "0").expect("Flash Update OK Voltage");
    format!(
        "chip = \"{CHIP}\"\n[{}]\n{} = 4200\n",
        chip.class_dir(subclass),
        ti_gauge::chip::kebab_case(row.name)
    )
}

#[test]
fn a_wrong_image_stops_the_station_and_takes_no_serial_number() {
    let folder = Folder::new("stops");
    fs::write(folder.file("golden.toml"), wrong_image()).expect("a file");
    let lines = format!("{PLAIN}\nstop-after-failures = 3");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let packs: Vec<_> = (0..6).map(|seed| new_pack(&clock, seed, None)).collect();
    let flash: Vec<_> = packs.iter().map(Sim::flash).collect();
    let said = line.run(&clock, packs.iter().map(|sim| (sim.clone(), "none".into())));
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(said.iter().all(|line| line.starts_with("FAIL BAT0 (pack ")), "{said:?}");
    assert!(said.iter().all(|line| line.ends_with("nothing was changed")), "{said:?}");
    let told = line.said.all();
    assert!(
        told.iter().any(|line| line.starts_with("? failures in a row: 3, the last one at checks")),
        "{told:?}"
    );
    assert!(packs.iter().zip(flash).all(|(sim, flash)| sim.flash() == flash));
    assert!(!line.station.all_passed());
    assert!(
        folder.lines().iter().all(|line| line.serial.is_none() && line.step.as_deref() == Some("checks"))
    );
    drop(line);
    // With the right image they pass, and the first number is still there. A failure between two others is none in a row.
    fs::write(folder.file("golden.toml"), golden()).expect("a file");
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let faults = ["none", "silence 1 900000", "silence 1 900000", "none", "silence 1 900000", "none"];
    let said = line.run(&clock, packs.into_iter().zip(faults).map(|(sim, fault)| (sim, fault.to_string())));
    assert_eq!(said.len(), 6, "{said:?}");
    let passed: Vec<_> = said.iter().filter(|line| line.starts_with("PASS")).collect();
    assert!(passed.len() == 3 && passed[2].starts_with("PASS BAT0 serial 1002"), "{said:?}");
    let totals = line.station.tally().totals.clone();
    assert_eq!((totals.passed, totals.failures(), totals.in_a_row), (3, 3, 0));
    assert_eq!(totals.failed.get("identification"), Some(&3), "{totals:?}");
    let lines = totals.lines();
    assert!(
        lines[0].starts_with("packs: 6, passed: 3, failed: 3, first-pass yield: 50.0 %, seconds a pack: "),
        "{lines:?}"
    );
    assert_eq!(lines[1], "failed at identification: 3");
}

#[test]
fn the_first_pack_of_a_run_is_confirmed_before_the_next_one() {
    let run = |typed: &[&str], faults: &[&str]| {
        let clock = Arc::new(SimClock::new());
        let folder = Folder::new("confirm");
        let line = Line::start(folder.plan(&format!("{PLAIN}\nconfirm-first = true")), typed, None)
            .expect("a record");
        let packs = (1..).zip(faults).map(|(seed, fault)| (new_pack(&clock, seed, None), fault.to_string()));
        let packs: Vec<_> = packs.collect();
        let said = line.run(&clock, packs);
        (said, line.said.all(), line.station.all_passed())
    };
    let (said, _, passed) = run(&["perhaps", "YES"], &["none", "none"]);
    assert!(said.len() == 2 && passed, "{said:?}");
    // Neither an answer nor its absence lets another pack be begun.
    for typed in [&["no"][..], &[]] {
        let (said, told, passed) = run(typed, &["none", "none"]);
        assert!(said.len() == 1 && said[0].starts_with("PASS") && !passed, "{told:?}");
    }
    // One that fails is not the first one.
    let (said, _, passed) = run(&["yes"], &["silence 1 900000", "none", "none"]);
    assert!(said.len() == 3 && said[2].starts_with("PASS") && !passed, "{said:?}");
    let (said, ..) = run(&["no"], &["silence 1 900000", "none", "none"]);
    assert!(said.len() == 2 && said[1].starts_with("PASS"), "{said:?}");
}
