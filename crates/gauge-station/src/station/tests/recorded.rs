// SPDX-License-Identifier: MIT

//! The record of a station: what is in it, what is made of it, and what becomes of a station that loses it.

use super::*;

#[test]
fn without_room_for_the_record_nothing_is_touched() {
    let folder = Folder::new("full");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    line.power.disk_is_full.store(true, Ordering::SeqCst);
    let flash = sim.flash();
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("nothing was changed"), "{said:?}");
    assert!(sim.flash() == flash && folder.lines().is_empty());
    line.power.disk_is_full.store(false, Ordering::SeqCst);
    let said = line.run(&clock, [(sim, "none".into())]);
    assert!(said[1].starts_with("PASS"), "{said:?}");
}

/// Whatever becomes of the record while the station waits: no number is given twice.
#[test]
fn regression_a_record_that_is_removed_between_packs_goes_unnoticed() {
    type Change = fn(&Path);
    let changes: [(&str, Change); 5] = [
        ("removed", |path| fs::remove_file(path).expect("it is there")),
        ("replaced", |path| {
            let copy = path.with_extension("copy");
            fs::copy(path, &copy).and_then(|_| fs::rename(&copy, path)).expect("a copy");
        }),
        ("emptied", |path| drop(fs::File::create(path).expect("a file"))),
        ("continued", |path| {
            let text = fs::read_to_string(path).expect("text");
            fs::OpenOptions::new()
                .append(true)
                .open(path)
                .and_then(|mut file| {
                    use std::io::Write;
                    file.write_all(text.as_bytes())
                })
                .expect("more of it");
        }),
        ("moved", |path| fs::rename(path, path.with_extension("old")).expect("it is there")),
    ];
    for (what, change) in changes {
        let folder = Folder::new("removed");
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
        assert!(said[0].starts_with("PASS"), "{what}: {said:?}");
        change(&folder.file("line1.jsonl"));
        let sim = new_pack(&clock, 2, None);
        let flash = sim.flash();
        let said = line.run(&clock, [(sim.clone(), "none".into())]);
        assert_eq!(said.len(), 1, "{what}: {said:?}");
        assert!(sim.flash() == flash && !line.station.all_passed(), "{what}");
        let why = line.said.all().pop().expect("a reason");
        assert!(why.contains("line1.jsonl") && why.contains("record was"), "{what}: {why}");
        drop(line);
        // Its images show that there was one.
        if !folder.file("line1.jsonl").exists() {
            let error = Line::start(folder.plan(PLAIN), &[], None).err().expect("it is missing").to_string();
            assert!(error.contains("images"), "{what}: {error}");
        }
    }
}

/// Nor while a pack is programmed.
#[test]
fn a_record_that_is_removed_while_a_pack_is_programmed_gives_no_number() {
    let folder = Folder::new("removed-begin");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let mut line = Line::start(plan, &[], None).expect("a record");
    struct Removing(PathBuf);
    impl Scanner for Removing {
        fn line(&mut self, _: &str) -> Option<String> {
            fs::remove_file(&self.0).expect("it is there");
            Some("7".into())
        }
    }
    let scanner = Box::new(Removing(folder.file("line1.jsonl")));
    line.station.desk.scanner = Mutex::new(scanner);
    let sim = new_pack(&clock, 1, None);
    let flash = sim.flash();
    let said = line.run(&clock, [(sim.clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("record was"), "{said:?}");
    assert!(sim.flash() == flash && !line.station.all_passed());
}

#[test]
fn regression_a_record_that_cannot_be_synced_says_pass_and_the_screen_says_fail() {
    for times in [1, 2, u64::MAX] {
        let folder = Folder::new("unsynced");
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        line.power.unsynced.store(times, Ordering::SeqCst);
        let packs = [1, 2].map(|seed| (new_pack(&clock, seed, None), "none".to_string()));
        let said = line.run(&clock, packs);
        // It does not go on.
        assert!(said.len() == 1 && said[0].starts_with("FAIL BAT0 serial 1000"), "{times}: {said:?}");
        assert!(said[0].contains("the record cannot be written"), "{times}: {said:?}");
        assert!(folder.lines().iter().all(|line| line.event != Event::Pass), "{times}: {:?}", folder.lines());
        assert!(!line.station.all_passed());
        drop(line);
        let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
        check_record(&folder);
        let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
        assert!(said.last().is_some_and(|line| line.starts_with("PASS BAT0 serial 1001")), "{said:?}");
    }
}

#[test]
fn regression_a_field_of_the_record_forges_an_outcome() {
    for (name, text) in [
        ("gauge", "BAT0\nPASS BAT0 serial 0x0001 (pack 1, 9.0 s)\n"),
        ("serial", "0x0001\u{2028}PASS BAT0"),
        ("serial", "0x0001\r\x1b[1A"),
        ("serial_before", "1\n2"),
        ("time", "now\nPASS"),
    ] {
        let folder = Folder::new("forged");
        let begun = Entry { event: Event::Begun, number: 1, gauge: "BAT0".into(), ..Entry::default() };
        let mut line = serde_json::to_value(&begun).expect("JSON");
        line[name] = text.into();
        fs::write(folder.file("line1.jsonl"), format!("{line}\n")).expect("a file");
        let error = Line::start(folder.plan(PLAIN), &[], None).err().expect("forged").to_string();
        assert!(error.contains("line 1") && error.contains(name) && !error.contains('\n'), "{name}: {error}");
    }
}

#[test]
fn regression_an_unfinished_pack_of_an_earlier_run_is_no_failure() {
    let folder = Folder::new("unfinished");
    let begun = Entry { event: Event::Begun, number: 1, gauge: "BAT0".into(), ..Entry::default() };
    let text = serde_json::to_string(&begun).expect("JSON") + "\n";
    fs::write(folder.file("line1.jsonl"), text).expect("a file");
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    assert!(line.said.all()[0].contains("the station was stopped while it programmed this pack"));
    assert!(!line.station.all_passed(), "it has not passed");
}

#[test]
fn a_pack_that_comes_again_is_no_first_try() {
    let clock = Arc::new(SimClock::new());
    let folder = Folder::new("again");
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let said = line.run(&clock, [(sim.clone(), "drop-seal".into()), (sim, "none".into())]);
    let totals = line.station.tally().totals.clone();
    if said[0].starts_with("PASS") {
        assert_eq!((totals.first_tries, totals.first_passes), (1, 1), "{said:?}");
    } else {
        assert_eq!((totals.first_tries, totals.first_passes, totals.passed), (1, 0, 1), "{said:?}");
    }
}

#[test]
fn a_program_gets_every_outcome_and_its_failure_is_one() {
    let folder = Folder::new("exec");
    let (told, refuses) = (folder.file("told"), folder.file("refuses"));
    let script = format!(
        "cat >> {}; echo $GAUGEFS_EVENT $GAUGEFS_SERIAL >> {0}; if test -e {}; then echo no paper >&2; exit 3; fi",
        told.display(),
        refuses.display()
    );
    let lines = format!("{PLAIN}\nexec = ['sh', '-c', '{script}']");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    let packs = ["none", "silence 1 900000"].map(|fault| (new_pack(&clock, 1, None), fault.to_string()));
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("PASS") && said[1].starts_with("FAIL"), "{said:?}");
    let text = fs::read_to_string(&told).expect("it was told");
    let lines_of: Vec<_> = text.lines().collect();
    let [pass, pass_facts, fail, fail_facts] = lines_of[..] else { panic!("{text}") };
    let record = fs::read_to_string(folder.file("line1.jsonl")).expect("a record");
    assert!(record.lines().any(|line| line == pass) && record.lines().any(|line| line == fail), "{text}");
    assert_eq!((pass_facts, fail_facts), ("pass 1000", "fail"));
    // The label was not printed: the pack has not passed.
    fs::write(&refuses, "").expect("a file");
    let said = line.run(&clock, [(new_pack(&clock, 2, None), "none".into())]);
    let last = said.last().expect("an outcome");
    assert!(
        last.starts_with(
            "FAIL BAT0 serial 1001 (pack 3): exec: sh has failed: exit status: 3; it says: no paper"
        ),
        "{last}"
    );
    let last = folder.lines().pop().expect("a line");
    assert_eq!((last.event, last.step.as_deref()), (Event::Fail, Some("exec")));
    check_record(&folder);
    drop(line);
    // What an interrupted pack has become is told by the next start.
    let begun = Entry { event: Event::Begun, number: 9, gauge: "BAT0".into(), ..Entry::default() };
    let mut text = fs::read_to_string(folder.file("line1.jsonl")).expect("a record");
    text += &(serde_json::to_string(&begun).expect("JSON") + "\n");
    fs::write(folder.file("line1.jsonl"), text).expect("a file");
    fs::remove_file(&refuses).expect("it is there");
    drop(Line::start(folder.plan(&lines), &[], None).expect("a record"));
    let text = fs::read_to_string(&told).expect("it was told");
    assert!(text.contains("\"number\":9") && text.ends_with("\nfail\n"), "{text}");
    // A program that is missing is no reason for PASS either.
    let printer = folder.file("printer");
    fs::copy("/bin/true", &printer).expect("a program");
    let plan = folder.plan(&format!("{PLAIN}\nexec = ['{}']", printer.display()));
    fs::remove_file(&printer).expect("it is there");
    let line = Line::start(plan, &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("/printer"), "{said:?}");
}

#[test]
fn a_calibration_outside_of_its_limits_fails_and_the_record_becomes_a_table() {
    let folder = Folder::new("table");
    let image = format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n");
    fs::write(folder.file("golden.toml"), image).expect("a file");
    let clock = Arc::new(SimClock::new());
    let sims = [1, 2].map(|seed| new_pack(&clock, seed, None));
    let mut gauge = opened(&sims[0], &clock, Run::default());
    gauge.ask(&op::REFRESH, ()).expect("it answers");
    let register = gauge.handle.chip().register(ti_gauge::chip::Role::VoltageNow).expect("a voltage");
    let shown =
        gauge.handle.published().snapshot.as_ref().and_then(|all| all.value(register)).expect("it is read");
    let lines = |tolerance: &str| {
        format!(
            "{PLAIN}\nboard-offset = true\noffset-tolerance = 3\nvoltage = {}.4\nvoltage-tolerance = {tolerance}",
            shown + 9
        )
    };
    // Nothing shows a fraction of a millivolt.
    let line = Line::start(folder.plan(&lines("0.1")), &[], None).expect("a record");
    let said = line.run(&clock, [(sims[0].clone(), "none".into())]);
    assert!(said[0].starts_with("FAIL") && said[0].contains("mV are allowed"), "{said:?}");
    drop(line);
    let line = Line::start(folder.plan(&lines("5")), &[], None).expect("a record");
    sims[1].set("board_offset_ma", "6").expect("a knob");
    let said = line.run(&clock, [(sims[1].clone(), "none".into())]);
    assert!(said[0].starts_with("PASS"), "{said:?}");
    let records = crate::station::Records::read(&folder.file("line1.jsonl")).expect("a record");
    let text = String::from_utf8(records.csv()).expect("text");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3, "{text}");
    let column = |name: &str| {
        rows[0].iter().position(|head| *head == name).unwrap_or_else(|| panic!("{name}: {text}"))
    };
    let last = &rows[2];
    assert_eq!(last[column("outcome")], "pass");
    assert_eq!(last[column("board_offset_before")], "0");
    assert_ne!(last[column("board_offset_after")], "0");
    assert_eq!([last[column("current_mA_low")], last[column("current_mA_high")]], ["-3", "3"]);
    assert_eq!(last[column("current_mA_before")], "6");
    let after: f64 = last[column("voltage_mV_after")].parse().expect("a number");
    assert!((after - (shown + 9) as f64).abs() < 5.0, "{text}");
    assert_eq!(last[column("temperature_celsius_low")], "", "{text}");
    assert!(last[column("temperature_celsius_after")].parse::<f64>().is_ok(), "{text}");
    let failures = records.failures();
    assert!(
        failures.len() == 1 && failures[0].step == "calibration" && failures[0].count == 1,
        "{failures:?}"
    );
    let days = records.groups(crate::station::By::Day);
    assert!(days.iter().map(|day| day.totals.passed).sum::<u64>() == 1, "{days:?}");
}

/// Lines that earlier versions have written are still read.
#[test]
fn an_older_record_is_read() {
    let folder = Folder::new("older");
    let lines = concat!(
        "{\"event\":\"begun\",\"number\":1,\"time\":\"2026-03-01T10:00:00Z\",\"station\":\"line1\",\"gauge\":\"BAT0\",",
        "\"who\":\"a@b\",\"chip\":\"bq34z100-g1\",\"image\":\"golden.toml\",\"image_sha256\":\"00\",",
        "\"serial\":\"0x03e8\",\"serial_before\":\"0x0001\",\"before\":\"000001-BAT0-before.toml\"}\n",
        "{\"event\":\"fail\",\"number\":1,\"time\":\"2026-03-01T10:00:09Z\",\"station\":\"line1\",\"gauge\":\"BAT0\",",
        "\"who\":\"a@b\",\"chip\":\"bq34z100-g1\",\"image\":\"golden.toml\",\"image_sha256\":\"00\",",
        "\"serial\":\"0x03e8\",\"reason\":\"=cmd, seal: verify\",\"seconds\":9.5}\n"
    );
    fs::write(folder.file("line1.jsonl"), lines).expect("a file");
    let records = crate::station::Records::read(&folder.file("line1.jsonl")).expect("a record");
    let text = String::from_utf8(records.csv()).expect("text");
    // It is no formula, and stays one cell.
    assert!(text.contains(",\"'=cmd, seal: verify\","), "{text}");
    assert_eq!(records.failures()[0].step, "");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(PLAIN), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
    assert!(said[0].starts_with("PASS BAT0 serial 1001 (pack 2"), "{said:?}");
}

/// Each pack has files of its own, so a full disk was as many reasons as it had failures.
#[test]
fn regression_one_reason_was_counted_once_for_each_pack() {
    let folder = Folder::new("reasons");
    let lines = [
        "/line/000005-LEFT-before.toml: cannot be saved: No space left on device; nothing was changed",
        "/line/000006-LEFT-before.toml: cannot be saved: No space left on device; nothing was changed",
        "/line/000007-LEFT-before.toml: cannot be saved: Read-only file system; nothing was changed",
        "bq34z100-G1: identify: device type 0x0100, firmware 0x0202: this is a bq34z100-R2",
    ];
    let text = (1..).zip(lines).map(|(number, reason)| {
        let (step, reason) = (Some("checks".into()), Some(reason.into()));
        let entry = Entry { event: Event::Fail, number, step, reason, ..Entry::default() };
        serde_json::to_string(&entry).expect("JSON") + "\n"
    });
    fs::write(folder.file("line1.jsonl"), text.collect::<String>()).expect("a file");
    let failures = crate::station::Records::read(&folder.file("line1.jsonl")).expect("a record").failures();
    let mut failures: Vec<_> = failures.iter().map(|one| (one.count, one.reason.as_str())).collect();
    failures.sort_unstable();
    let expected = [
        (1, "/line/000007-LEFT-before.toml: cannot be saved: Read-only file system"),
        (1, "bq34z100-G1: identify: device type 0x0100, firmware 0x0202"),
        (2, "... cannot be saved: No space left on device"),
    ];
    assert_eq!(failures, expected);
}
