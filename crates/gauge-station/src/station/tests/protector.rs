// SPDX-License-Identifier: MIT

//! A station for packs whose gauge drives their FETs. They have no place for a serial number.

use super::*;

const CHIP: &str = "bq27742-g1";
const LINES: &str = "exclude = ['calibration', 'learned', 'keys']";
/// OV Prot Threshold, Design Capacity, Terminate Voltage.
const ASKED: [(u8, u16, i64); 3] = [(2, 0, 4350), (48, 12, 1200), (80, 64, 3100)];

fn chip() -> &'static Chip {
    Chip::by_name(CHIP).expect("it has a table")
}

/// An image with these values.
fn image(values: &[(u8, u16, i64)]) -> String {
    let mut image = Image::new(chip(), Some(0x0103));
    for &(id, offset, value) in values {
        let (subclass, row) = chip().row(&id.to_string(), &offset.to_string()).expect("a row");
        image.set(subclass, row, Value::Int(value));
    }
    toml::write(&image)
}

/// A station for an image of these values.
fn line(folder: &Folder, values: &[(u8, u16, i64)]) -> Line {
    fs::write(folder.file("golden.toml"), image(values)).expect("a file");
    let plan = folder.try_plan_of(CHIP, LINES).unwrap_or_else(|error| panic!("{error}"));
    Line::start(plan, &[], None).expect("a record")
}

fn pack(clock: &Arc<SimClock>, seed: u64) -> Sim {
    let options = gauge_sim::Options { seed, ..gauge_sim::Options::default() };
    Sim::new(CHIP, &options, clock.clone()).expect("it is simulated")
}

/// Runs the station with a pack, in which nothing may open the FETs. Returns what the station says.
fn run(line: &Line, clock: &Arc<SimClock>, sim: &Sim, fault: &str) -> String {
    sim.keep_log(true);
    let said = line.run(clock, [(sim.clone(), fault.into())]).pop().expect("an outcome");
    let is_reset = |record: &gauge_sim::Record| record.write == [0x00, 0x41, 0x00];
    let log = sim.log();
    assert!(log.len() > 20 && !log.iter().any(is_reset), "{fault}: {said}");
    clock.sleep(Duration::from_secs(10));
    assert_eq!(sim.get("fets").as_deref(), Some("closed"), "{fault}: {said}");
    said
}

/// What the pack has in place of the values asked for, whether it has them, and whether all else is as before.
fn check(sim: &Sim, before: &[u8], fault: &str) {
    let clock = Arc::new(SimClock::new());
    let other = pack(&clock, 1);
    let mut asked = BTreeMap::new();
    for (id, offset, value) in ASKED {
        for (offset, byte) in (offset..).zip((value as i16).to_be_bytes()) {
            let old = other.flash();
            other.set_flash(id.into(), offset.into(), &[0xa5]);
            let now = other.flash();
            let at = (0..old.len()).find(|&at| old[at] != now[at]).expect("it has changed");
            other.set_flash(id.into(), offset.into(), &[old[at]]);
            asked.insert(at, byte);
        }
    }
    let free = chip().rows().filter(|(_, row)| row.learned).map(|(_, row)| row.kind.size()).sum::<usize>();
    let now = sim.flash();
    let others = (0..now.len()).filter(|at| !asked.contains_key(at) && now[*at] != before[*at]).count();
    assert!(others <= free, "{fault}: {others} bytes that nobody has asked for");
    for (at, byte) in asked {
        assert_eq!(now[at], byte, "{fault}: byte {at}");
    }
    assert_eq!(sim.get("seal").as_deref(), Some("sealed"), "{fault}");
}

#[test]
fn packs_with_a_protector_are_programmed_without_a_reset() {
    let folder = Folder::new("protector");
    let clock = Arc::new(SimClock::new());
    let line = line(&folder, &ASKED);
    let faults = ["none", "nack 40", "power-cut 60 500", "drop-commit", "torn-commit 7", "drop-seal"];
    let mut passed = 0;
    for (seed, fault) in (1..).zip(faults) {
        let sim = pack(&clock, seed);
        let before = sim.flash();
        let said = run(&line, &clock, &sim, fault);
        match folder.lines().pop().expect("a line").event {
            Event::Pass => {
                passed += 1;
                check(&sim, &before, fault);
            }
            outcome => assert!(outcome == Event::Fail && fault != "none", "{said}"),
        }
    }
    assert!(passed >= 2, "{passed} of {}", faults.len());
    let outcomes = folder.lines().into_iter().filter(|line| line.event != Event::Begun).count();
    assert_eq!(outcomes, faults.len(), "each has one");
}

/// Rows of the protector are never written: an image that asks for another value of one fits no pack.
#[test]
fn an_image_with_another_value_of_the_protector_fails_before_a_write() {
    let folder = Folder::new("protector-row");
    let clock = Arc::new(SimClock::new());
    let line = line(&folder, &[(48, 12, 1200), (64, 6, 3)]);
    let sim = pack(&clock, 1);
    let before = sim.flash();
    let said = run(&line, &clock, &sim, "none");
    assert!(said.starts_with("FAIL") && said.contains("cannot be written"), "{said}");
    assert!(sim.flash() == before);
}
