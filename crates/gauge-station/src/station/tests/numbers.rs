// SPDX-License-Identifier: MIT

//! Serial numbers: scanned, from a list, and given once.

use super::*;

/// A rack on which the pack is exchanged while somebody scans its number.
struct Exchange(Sim, Arc<Mutex<Option<Sim>>>);

impl Scanner for Exchange {
    fn line(&mut self, _: &str) -> Option<String> {
        *self.1.lock().expect("nobody panics") = Some(self.0.clone());
        Some("7".into())
    }
}

/// A bus to the pack that was put in its place, or else to the first one.
struct Exchanged(SimBus, Arc<Mutex<Option<Sim>>>);

impl Bus for Exchanged {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        match &*self.1.lock().expect("nobody panics") {
            Some(sim) => sim.bus().transfer(write, read),
            None => self.0.transfer(write, read),
        }
    }
}

struct OnBus(Arc<SimClock>, Sim, Arc<Mutex<Option<Sim>>>, u32);

impl Slot for OnBus {
    fn clock(&self) -> Arc<dyn Clock> {
        self.0.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        Box::new(Exchanged(self.1.bus(), self.2.clone()))
    }

    fn is_there(&mut self) -> Option<bool> {
        (self.3 == 0).then_some(true)
    }

    fn done(&mut self) {
        self.3 = 1;
    }
}

#[test]
fn a_pack_that_is_exchanged_while_its_number_is_scanned_is_not_touched() {
    let folder = Folder::new("exchanged");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let (one, other) = (new_pack(&clock, 1, None), new_pack(&clock, 2, None));
    other.set_flash(48, 11, &[0x12, 0x34]);
    clock.sleep(Duration::from_secs(3));
    let now = Arc::new(Mutex::new(None));
    let mut line = Line::start(plan, &[], None).expect("a record");
    line.station.desk.scanner = Mutex::new(Box::new(Exchange(other.clone(), now.clone())));
    let flash = [one.flash(), other.flash()];
    line.station.run(&line.bench, &mut OnBus(clock, one.clone(), now, 0));
    let last = folder.lines().pop().expect("a line");
    let reason = last.reason.expect("a reason");
    assert!(last.event == Event::Fail && reason.contains("nothing was changed"), "{reason}");
    assert!([one.flash(), other.flash()] == flash && folder.lines().len() == 1);
}

#[test]
fn a_scanned_number_is_asked_for_until_it_is_right() {
    let folder = Folder::new("scan");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let typed = ["", "70000", "serial", "7", "7", " 0x0008 "];
    let line = Line::start(plan, &typed, None).expect("a record");
    let packs: Vec<_> = (0..2).map(|seed| (new_pack(&clock, seed, None), "none".to_string())).collect();
    let said = line.run(&clock, packs);
    assert!(
        said[0].starts_with("PASS BAT0 serial 7 (0x0007) (pack 1,")
            && said[1].starts_with("PASS BAT0 serial 0x0008 (pack 2,"),
        "{said:?}"
    );
    let told = line.said.all();
    assert!(told.contains(&"? BAT0: 7 (0x0007)".to_string()), "{told:?}");
    assert!(told.contains(&"? BAT0: programming, do not remove (1 of 2: image)".to_string()), "{told:?}");
    assert_eq!(folder.lines().pop().expect("a line").scanned, None);
    let said = refused(&folder, &line, &clock, &new_pack(&clock, 3, None), "none");
    assert!(said.contains("the input has ended"), "{said}");
    check_record(&folder);
}

#[test]
fn regression_a_serial_number_was_shown_in_another_base_than_in_the_file() {
    let list = PLAIN.replace("'counter'\nfirst-serial = 1000", "'list'\nserial-list = 'serials.txt'");
    for (name, lines, serials) in [
        ("base-10", PLAIN.to_string(), ["1000", "1001"]),
        ("base-16", format!("{PLAIN}\nserial-is-hex = true"), ["0x03e8", "0x03e9"]),
        ("base-list", list, ["258", "0x1F"]),
    ] {
        let folder = Folder::new(name);
        fs::write(folder.file("serials.txt"), "258\n0x1F\n").expect("a file");
        let told = folder.file("told");
        let exec = format!("exec = ['sh', '-c', 'echo $GAUGEFS_SERIAL >> {}']", told.display());
        let clock = Arc::new(SimClock::new());
        let line = Line::start(folder.plan(&format!("{lines}\n{exec}")), &[], None).expect("a record");
        let packs = [1, 2].map(|seed| new_pack(&clock, seed, None));
        let again = packs[0].clone();
        let said = line.run(&clock, packs.into_iter().chain([again]).map(|pack| (pack, "none".into())));
        for (said, serial) in said.iter().zip(serials) {
            assert!(said.starts_with(&format!("PASS BAT0 serial {serial} (pack ")), "{said}");
        }
        let seen = format!("it was programmed before as serial number {},", serials[0]);
        assert!(said[2].contains(&seen), "{}", said[2]);
        let told = fs::read_to_string(told).expect("it was told");
        assert!(told.starts_with(&format!("{}\n{}\n", serials[0], serials[1])), "{told}");
        check_record(&folder);
    }
}

#[test]
fn a_list_is_given_once_and_has_no_number_twice() {
    let folder = Folder::new("list");
    let lines = PLAIN.replace("'counter'\nfirst-serial = 1000", "'list'\nserial-list = 'serials.txt'");
    fs::write(folder.file("serials.txt"), "0x0101 # first\n\n258\n0x0102\n").expect("a file");
    let error = folder.try_plan(&lines).err().expect("one is there twice").to_string();
    assert!(error.contains("serials.txt: line 4") && error.contains("also in line 3"), "{error}");
    fs::write(folder.file("serials.txt"), "0x0101 # first\n\n258\n").expect("a file");
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &[], None).expect("a record");
    // The number of a pack that fails is not given again.
    let packs = [
        (new_pack(&clock, 1, None), "silence 300 900000".to_string()),
        (new_pack(&clock, 2, None), "none".into()),
    ];
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("FAIL BAT0 serial 0x0101"), "{said:?}");
    drop(line);
    let line =
        Line::start(folder.plan(&format!("{lines}\nunsettled = 'discard'")), &[], None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 3, None), "none".into())]);
    let last = folder.lines().pop().expect("a line");
    assert!(
        said.len() == 1 && last.serial.as_deref() == Some("0x0102") || said[0].contains("all serial numbers"),
        "{said:?}"
    );
    let said = refused(&folder, &line, &clock, &new_pack(&clock, 4, None), "none");
    assert!(said.contains("all serial numbers were given"), "{said}");
    check_record(&folder);
}

#[test]
fn a_scan_for_another_pack_than_the_one_that_is_there_is_refused() {
    let folder = Folder::new("scan-other");
    let lines = PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'") + "\nseen = 'redo'";
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &["1000", "1001", "BAT0: 1000"], None).expect("a record");
    let sim = new_pack(&clock, 1, None);
    let said = line.run(&clock, [(sim.clone(), "none".into()), (sim, "none".into())]);
    assert!(said.len() == 2 && said[1].starts_with("PASS BAT0 serial 1000 (0x03e8) (pack 2"), "{said:?}");
    assert!(line.station.all_passed() && line.station.tally().totals.first_tries == 1);
}

#[test]
fn a_label_is_kept_in_the_record_and_in_the_pack() {
    let folder = Folder::new("label");
    let lines = format!("{PLAIN}\nlabel = true\nlabel-parameter = 'configuration-data/device-name'");
    let typed = ["a label that is too long for it", "SN00123", "SN00123", "SN\u{1b}", "SN00124"];
    let clock = Arc::new(SimClock::new());
    let line = Line::start(folder.plan(&lines), &typed, None).expect("a record");
    let packs = [1, 2].map(|seed| (new_pack(&clock, seed, None), "none".to_string()));
    let said = line.run(&clock, packs);
    assert!(said[0].starts_with("PASS BAT0 SN00123 serial 1000 (pack 1") && said.len() == 2, "{said:?}");
    assert!(said[1].starts_with("PASS BAT0 SN00124 serial 1001"), "{said:?}");
    let pass = folder.lines().pop().expect("a line");
    assert_eq!(pass.label.as_deref(), Some("SN00124"));
    let name = pass.changes.iter().find(|change| change.name == "configuration-data/device-name");
    assert_eq!(name.map(|change| &*change.new), Some("SN00124"), "{:?}", pass.changes);
    // A failure sets its label free, and an interrupted pack, too.
    drop(line);
    let line = Line::start(folder.plan(&lines), &["SN7", "SN7", "SN00124"], None).expect("a record");
    let sim = new_pack(&clock, 3, None);
    // After its number is given, and before the first commit.
    let said = line.run(&clock, [(sim.clone(), "silence 280 900000".into())]);
    assert!(said[0].starts_with("FAIL BAT0 SN7"), "{said:?}");
    clock.sleep(Duration::from_secs(1000));
    let said = line.run(&clock, [(sim, "none".into()), (new_pack(&clock, 4, None), "none".into())]);
    assert!(said[1].starts_with("PASS BAT0 SN7 serial 1003") && said[2].starts_with("FAIL"), "{said:?}");
    check_record(&folder);
    for (lines, says) in [
        ("label-parameter = 'configuration-data/device-name'", "label-parameter: set label = true too"),
        ("label = true\nlabel-parameter = 'it-cfg/cell-terminate-voltage'", "a label needs a parameter"),
        ("label = true\nlabel-parameter = 'it-cfg/nothing'", "has no parameter it-cfg/nothing"),
    ] {
        let error = folder.try_plan(lines).err().expect("refused").to_string();
        assert!(error.contains(says), "{error}");
    }
}
