// SPDX-License-Identifier: MIT

//! A journal that waits for a pack: whether it is this one's, who decides, and what is done then.

use std::fs::{self, File};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use ti_gauge::dataflash::Decision;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

use super::differences;
use crate::rig::{Rig, cause};
use crate::room::{Folder, half_way};

/// A pack with a journal that does not fit it: what the journal is of, and the rig with the pack.
type Stale = fn(&Folder) -> Rig;

/// The journal of a calibrated pack, and another calibrated pack.
fn another_pack(folder: &Folder) -> Rig {
    half_way(&mut Rig::calibrated("bq34z100-g1", Seal::Sealed), folder);
    let rig = Rig::new("bq34z100-g1");
    rig.calibrate(5);
    rig
}

/// The journal of a pack as it left the factory, and another one that differs in one byte of a planned block.
fn another_factory_pack(folder: &Folder) -> Rig {
    half_way(&mut Rig::new("bq34z100-g1"), folder);
    let rig = Rig::new("bq34z100-g1");
    rig.sim.set_flash(48, 15, &(-300_i16).to_be_bytes());
    rig
}

/// The pack itself, repaired by hand since.
fn repaired_pack(folder: &Folder) -> Rig {
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    half_way(&mut rig, folder);
    rig.sim.set_flash(48, 11, &3300_u16.to_be_bytes());
    rig
}

const STALE: [(&str, Stale); 3] = [
    ("another pack", another_pack),
    ("another factory pack", another_factory_pack),
    ("repaired pack", repaired_pack),
];

#[test]
fn a_stale_journal_changes_nothing_until_a_person_decides() {
    for (name, stale) in STALE {
        let folder = Folder::new("stale");
        let mut rig = stale(&folder);
        rig.start(&folder);
        let (flash, programmed, journal) = (rig.sim.flash(), rig.get("programmed"), folder.text());
        let error = rig.arrive().expect_err(name);
        assert_eq!(cause(&error), "busy", "{name}: {error}");
        let owed = rig.dataflash.owed().expect(name);
        assert!(owed.needs_decision && owed.why.contains("gaugefs settle"), "{name}: {}", owed.why);
        for _ in 0..2 {
            let refused = rig.write(58, 3, "0x5a").expect_err(name);
            assert_eq!(cause(&refused), "busy", "{name}: {refused}");
            assert!(refused.to_string().contains(&owed_reason(&error.to_string())), "{name}: {refused}");
            rig.arrive().expect_err(name);
        }
        let present = rig.read(48, 11).expect("it can be read");
        let present = u16::from_be_bytes([present[0], present[1]]);
        let shown = rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it can be read");
        let line = format!("48/11\tDesign Capacity\t1000\t2200\t{present}\n");
        let serial = if name == "another pack" { " --serial 0x0001" } else { "" };
        for what in ["--undo", "--finish"] {
            let line = format!("  gaugefs settle GAUGE {what}{serial} ");
            assert!(shown.contains(&line), "{name}: {line}: {shown}");
        }
        assert!(shown.contains("  gaugefs settle GAUGE --discard ") && shown.lines().count() > 5, "{shown}");
        assert!(shown.contains(&line) && shown.contains("80/53\t"), "{name}: {shown}");
        // What the write did not change and is not as it was is shown as well.
        let other = shown.contains("48/15\tSOH Load I\t-400\t-400\t-300\n");
        assert_eq!(other, name == "another factory pack", "{name}: {shown}");
        assert!(rig.sim.flash() == flash, "{name}");
        assert_eq!(rig.get("programmed"), programmed, "{name}");
        assert_eq!((folder.text(), rig.seal()), (journal, Seal::Sealed), "{name}");
    }
}

/// The part of a refusal that says why.
fn owed_reason(error: &str) -> String {
    error.split_once("is not settled: ").expect("it says why").1.to_string()
}

#[test]
fn a_person_decides_what_becomes_of_a_stale_journal() {
    for (name, stale) in STALE {
        let pack = (name == "another pack").then_some(1);
        for decision in [Decision::Undo(pack), Decision::Finish(pack), Decision::Discard] {
            let at = format!("{name}, {decision:?}");
            let folder = Folder::new("decided");
            let mut rig = stale(&folder);
            rig.start(&folder);
            rig.arrive().expect_err(name);
            let (flash, journal) = (rig.sim.flash(), folder.text());
            for wrong in [Decision::Undo(None), Decision::Finish(None), Decision::Undo(Some(2))] {
                if pack.is_some() || wrong == Decision::Undo(Some(2)) {
                    let error = rig.dataflash.decide(&mut rig.gauge, wrong, Duration::ZERO).expect_err(&at);
                    let says = if wrong == Decision::Undo(Some(2)) {
                        "0x0001, not 0x0002"
                    } else {
                        "--serial 0x0001"
                    };
                    assert!(cause(&error) == "busy" && error.to_string().contains(says), "{at}: {error}");
                    assert!(rig.sim.flash() == flash && folder.text() == journal, "{at}: {error}");
                }
            }
            let said = rig.dataflash.decide(&mut rig.gauge, decision, Duration::ZERO);
            let said = said.unwrap_or_else(|error| panic!("{at}: {error}"));
            let values = (rig.read(48, 11).expect("a read"), rig.read(80, 53).expect("a read"));
            let (old, new) = (vec![0x03, 0xe8], vec![0x08, 0x98]);
            match decision {
                Decision::Undo(_) => assert_eq!(values, (old, vec![0x0b, 0xb8]), "{at}: {said}"),
                Decision::Finish(_) => assert_eq!(values, (new, vec![0x0c, 0x1c]), "{at}: {said}"),
                Decision::Discard => assert!(rig.sim.flash() == flash, "{at}: {said}"),
            }
            // Nothing but what `examine` shows is changed.
            let changed = differences(&flash, &rig.sim.flash()).len();
            assert!(changed <= 4 + 2 * usize::from(name == "another factory pack"), "{at}: {changed} bytes");
            match decision {
                Decision::Discard => {
                    assert_eq!(folder.files(), ["i2c-1-55.dismissed"], "{at}");
                    assert!(said.contains("i2c-1-55.dismissed"), "{at}: {said}");
                    let kept = folder.journal().path().with_extension("dismissed");
                    assert_eq!(fs::read_to_string(kept).ok(), journal, "{at}");
                }
                // The pack of the journal may come back.
                _ if pack.is_some() => {
                    assert_eq!(folder.files(), ["i2c-1-55.waiting"], "{at}");
                    assert!(!said.contains("restored") && said.contains("another pack"), "{at}: {said}");
                    assert!(said.contains("serial number 0x0001"), "{at}: {said}");
                }
                _ => assert_eq!(folder.files(), Vec::<String>::new(), "{at}"),
            }
            assert_eq!(rig.seal(), Seal::Sealed, "{at}");
            assert!(rig.write(58, 3, "0x5a").is_ok(), "{at}");
        }
    }
}

/// A decision is about the pack that was shown. Another one that has taken its place meanwhile is not written to, also if
/// neither can be told from the pack of the journal.
#[test]
fn what_was_decided_of_one_pack_is_not_done_to_another() {
    let folder = Folder::new("shown");
    let mut rig = another_factory_pack(&folder);
    rig.start(&folder);
    rig.arrive().expect_err("a person decides");
    rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it can be read");
    let shown = rig.sim.flash();
    rig.sim.set_flash(48, 15, &(-200_i16).to_be_bytes());
    let (flash, journal) = (rig.sim.flash(), folder.text());
    for decision in [Decision::Undo(None), Decision::Finish(None), Decision::Undo(Some(1))] {
        let error =
            rig.dataflash.decide(&mut rig.gauge, decision, Duration::ZERO).expect_err("it is not that");
        assert!(error.to_string().contains("not what was shown"), "{error}");
        assert!(rig.sim.flash() == flash && folder.text() == journal, "{error}");
    }
    assert_eq!(rig.seal(), Seal::Sealed);
    assert!(shown != flash);
    rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it can be read");
    rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO).expect("it is what was shown");
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// Another pack as it left the factory differs from the journal's only in a block that is not planned: it holds all
/// old values, so there is nothing to write.
#[test]
fn a_factory_pack_that_holds_the_old_values_is_not_touched_and_the_journal_is_kept() {
    let folder = Folder::new("plausible");
    half_way(&mut Rig::new("bq34z100-g1"), &folder);
    let mut rig = Rig::new("bq34z100-g1");
    rig.sim.set_flash(34, 2, &[0x11]);
    rig.start(&folder);
    let (flash, programmed, resets) = (rig.sim.flash(), rig.get("programmed"), rig.get("resets"));
    let said = rig.arrive().expect("nothing is in the way").expect("there is a journal");
    assert!(said.contains("i2c-1-55.waiting"), "{said}");
    assert!(rig.sim.flash() == flash);
    assert_eq!((rig.get("programmed"), rig.get("resets")), (programmed, resets));
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec!["i2c-1-55.waiting".to_string()]));
    // Nobody may ever need it again, and only a person knows that.
    let shown = rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it is shown");
    let what = "i2c-1-55.waiting: the write of Design Capacity and Cell Terminate Voltage was interrupted on a bq34z100-g1";
    assert!(shown.contains(what) && shown.contains("gaugefs settle GAUGE --discard"), "{shown}");
    rig.dataflash.decide(&mut rig.gauge, Decision::Discard, Duration::ZERO).expect("it is put aside");
    assert_eq!((rig.sim.flash() == flash, folder.files()), (true, vec!["i2c-1-55.dismissed".to_string()]));
    let shown = rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it is shown");
    assert_eq!(shown, "nothing to settle\n");
}

/// The journal that waits may be another pack's and seals nothing here: what this pack is owed has a record of its own.
#[test]
fn regression_a_pack_that_was_opened_for_a_waiting_journal_stayed_open() {
    for restarts in [false, true] {
        let mut left_open = 0;
        for number in 1.. {
            let at = format!("silent from {number} on, restarts: {restarts}");
            let folder = Folder::new("opened-for-another");
            half_way(&mut Rig::new("bq34z100-g1"), &folder);
            let mut rig = Rig::new("bq34z100-g1");
            rig.sim.set_flash(34, 2, &[0x11]);
            rig.start(&folder);
            rig.arrive().expect("nothing is in the way").expect("there is a journal");
            assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec!["i2c-1-55.waiting".to_string()]));
            rig.start(&folder);
            rig.arrive().expect("mounting opens no gauge");
            let flash = rig.sim.flash();
            rig.set("fault", &format!("silence {number} 60000"));
            let read = rig.read(80, 53);
            rig.set("fault", "none");
            rig.pause(61);
            if read.is_ok() {
                break;
            }
            let is_open = rig.seal() != Seal::Sealed;
            left_open += u32::from(is_open);
            assert!(!is_open || rig.dataflash.owed().is_some(), "{at}");
            if restarts {
                rig.start(&folder);
            }
            let settled = rig.arrive();
            assert_eq!(rig.seal(), Seal::Sealed, "{at}: {read:?}, then {settled:?}");
            assert!(rig.sim.flash() == flash, "{at}");
            assert_eq!(folder.files(), ["i2c-1-55.waiting"], "{at}");
        }
        assert!(left_open > 0);
    }
}

/// A clock at which another program lets go of a journal.
struct LetsGo {
    clock: Arc<SimClock>,
    held: Mutex<Option<(File, Duration)>>,
}

impl Clock for LetsGo {
    fn now(&self) -> Duration {
        self.clock.now()
    }

    fn sleep(&self, time: Duration) {
        self.clock.sleep(time);
        let mut held = self.held.lock().expect("no panic");
        held.take_if(|(_, until)| self.clock.now() >= *until);
    }

    fn spend(&self, time: Duration) {
        self.clock.spend(time);
    }
}

/// Two packs of one mux looked at the journal that waits at the same moment: the write of the second one was refused.
#[test]
fn regression_a_journal_that_another_program_judges_was_not_waited_for() {
    for (seconds, is_written) in [(2, true), (60, false)] {
        let folder = Folder::new("judged");
        half_way(&mut Rig::new("bq34z100-g1"), &folder);
        let mut rig = Rig::new("bq34z100-g1");
        rig.sim.set_flash(34, 2, &[0x11]);
        rig.start(&folder);
        rig.arrive().expect("nothing is in the way").expect("there is a journal");
        rig.start(&folder);
        let held = File::open(folder.path().join("i2c-1-55.waiting")).expect("it waits");
        held.lock().expect("nobody has it");
        let until = rig.clock.now() + Duration::from_secs(seconds);
        let clock = LetsGo { clock: rig.clock.clone(), held: Mutex::new(Some((held, until))) };
        let bus = Box::new(rig.sim.bus());
        rig.gauge = Gauge::new(rig.gauge.chip, bus, Arc::new(clock), Keys::default());
        rig.arrive().expect("mounting opens no gauge");
        let flash = rig.sim.flash();
        let written = rig.write(80, 53, "3105");
        assert_eq!(written.is_ok(), is_written, "{written:?}");
        assert_eq!(rig.sim.flash() == flash, !is_written);
        assert!(written.err().is_none_or(|error| cause(&error) == "busy"));
        assert_eq!(rig.seal(), Seal::Sealed);
    }
}

/// SerialNumber() then reads 0xFFFF.
#[test]
fn an_erased_serial_number_is_restored_where_the_calibration_shows_the_pack() {
    for calibrated in [true, false] {
        for (offset, text) in [(11, "2200"), (4, "0x0007")] {
            let at = format!("48/{offset}, calibrated: {calibrated}");
            let folder = Folder::new("erased");
            let mut rig = Rig::new("bq34z100-g1");
            if calibrated {
                rig.calibrate(3);
            }
            let old = rig.sim.flash();
            rig.set("tear", "erased");
            rig.start(&folder);
            rig.arrive().expect("nothing to settle");
            rig.set("fault", "torn-commit 5");
            let error = rig.write(48, offset, text).expect_err("it is torn");
            assert_eq!(cause(&error), "state-unknown", "{at}: {error}");
            assert!(rig.dataflash.owed().is_some() && folder.text().is_some(), "{at}");
            rig.set("power", "on");
            rig.pause(3);
            let mut word = [0; 2];
            rig.gauge.read(0x28, &mut word).expect("it answers");
            assert_eq!(word, [0xff; 2], "{at}");
            rig.start(&folder);
            let torn = rig.sim.flash();
            let outcome = rig.arrive();
            if calibrated {
                outcome.unwrap_or_else(|error| panic!("{at}: {error}")).expect("there is a journal");
                assert_eq!(differences(&old, &rig.sim.flash()), [], "{at}");
                assert_eq!(folder.files(), Vec::<String>::new(), "{at}");
            } else {
                assert_eq!(cause(&outcome.expect_err(&at)), "busy", "{at}");
                assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err(&at)), "busy", "{at}");
                assert!(rig.sim.flash() == torn && folder.text().is_some(), "{at}");
                let undone = rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO);
                undone.expect("a person knows the pack");
                assert!(rig.sim.flash() == old, "{at}");
            }
            assert_eq!(rig.seal(), Seal::Sealed, "{at}");
        }
    }
}
