// SPDX-License-Identifier: MIT

//! What becomes of a write or a read that fails half way: its journal, the pack it belongs to, the seal, the old
//! values, and the time that it takes.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::Sim;
use ti_gauge::authentication::Order;
use ti_gauge::chip::{CHIPS, Chip, FLAT, KeyStorage, Kind, Scheme};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, DataFlash, Decision, Limits, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::{KeyChange, Keys, Name};

use crate::rig::{Rig, another, cause};
use crate::room::{CASES, Case, Folder, RESET, half_way, host, one_in, programs, restart};

/// Where two images differ, with both bytes.
fn differences(one: &[u8], other: &[u8]) -> Vec<(usize, u8, u8)> {
    (0..one.len()).filter(|&at| one[at] != other[at]).map(|at| (at, one[at], other[at])).collect()
}

#[test]
fn the_journal_stays_until_the_outcome_is_proven() {
    let folder = Folder::new("stays");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    // The gauge loses power as well, and is sealed when it is back.
    rig.power_cycle();
    let (torn, journal) = (rig.sim.flash(), folder.text());
    assert!(torn != old && journal.is_some());
    for fault in ["no key", "bad checksum", "NACK", "timeout", "silence"] {
        let keys = if fault == "no key" { Keys::none() } else { Keys::default() };
        rig.start_with(&folder, keys, move |bus, _, write, read| {
            let done = match fault {
                "NACK" if matches!(write, [0x3E, ..]) => return Err(BusError::NoAck),
                "timeout" if read.len() > 32 => return Err(BusError::Timeout),
                "silence" => return Err(BusError::NoAck),
                _ => bus.transfer(write, read),
            };
            if fault == "bad checksum" && read.len() > 32 {
                read[9] ^= 1;
            }
            done
        });
        rig.settle().expect_err(fault);
        for _ in 0..2 {
            let error = rig.write(58, 3, "0x5a").expect_err(fault);
            let says = "interrupted, and it is finished or undone as soon as that is possible";
            assert!(error.to_string().contains(says), "{fault}: {error}");
            let owed = rig.dataflash.owed().expect("it is owed");
            assert!(!owed.needs_decision, "{fault}: {}", owed.why);
        }
        assert_eq!(folder.text(), journal, "{fault}");
        assert!(rig.sim.flash() == torn, "{fault}");
        // A gauge to which something is owed can be read.
        rig.start(&folder);
        assert_eq!(rig.read(80, 53), Ok(vec![0x0b, 0xb8]), "{fault}");
        assert_eq!(rig.seal(), Seal::Sealed, "{fault}");
        assert_eq!(folder.text(), journal, "{fault}");
    }
    assert!(rig.settle().expect("nothing is in the way").is_some());
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
    assert!(rig.dataflash.owed().is_none());
}

/// The voltage is too low to program anything until the second attempt to settle.
#[test]
fn the_journal_stays_while_what_is_put_back_is_not_stored() {
    let folder = Folder::new("shut");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    let torn = rig.sim.flash();
    rig.set("voltage_mv", "2000");
    let error = rig.settle().expect_err("nothing is stored");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    assert!(rig.sim.flash() == torn && folder.text().is_some() && rig.dataflash.owed().is_some());
    rig.write(58, 3, "0x5a").expect_err("an interrupted write is owed");
    assert!(rig.sim.flash() == torn);
    rig.set("voltage_mv", "auto");
    // The next write settles it first.
    assert!(rig.write(58, 3, "0x5a").is_ok());
    assert_eq!(rig.read(48, 11), Ok(vec![0x03, 0xe8]));
    assert_eq!(rig.read(58, 3), Ok(vec![0x5a]));
    assert!(rig.sim.flash() != old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

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

/// A byte that no table calls learned, or that a user writes, moves by itself: every 250 ms, and at each commit. Flash has 20,000 cycles: it
/// is not programmed again and again.
#[test]
fn regression_a_byte_that_moves_by_itself_was_written_again_and_again() {
    // Beside the value that is written, and in its place; Reserve Cap-mAh is 48/21 to 48/22.
    for (offset, is_beside) in [(30, true), (12, false)] {
        let folder = Folder::new("moving");
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        let (sim, clock) = (rig.sim.clone(), rig.clock.clone());
        let mut commits = 0;
        rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
            commits += u8::from(matches!(write, [0x60, _]));
            let moved = ((clock.now().as_millis() / 250) as u8).wrapping_add(commits);
            sim.set_flash(48, offset, &[0x40 | moved & 0x3f]);
            bus.transfer(write, read)
        });
        let mut before = rig.sim.flash();
        let programmed = |rig: &Rig| rig.get("programmed").parse::<u32>().expect("a number");
        let mut error = rig.write(48, 11, "2200").expect_err("it does not read back as it was stored");
        for _ in 0..40 {
            if rig.dataflash.owed().is_none_or(|owed| owed.needs_decision) {
                break;
            }
            rig.pause(2);
            if let Err(again) = rig.settle() {
                error = again;
            }
        }
        assert!(programmed(&rig) <= if is_beside { 4 } else { 16 }, "{}: {error}", programmed(&rig));
        let owed = rig.dataflash.owed().map(|owed| (owed.needs_decision, owed.why.to_string()));
        if is_beside {
            assert_eq!(owed, None, "{error}");
            assert_eq!(cause(&error), "rolled-back", "{error}");
            let mut after = rig.sim.flash();
            let changed = differences(&before, &after);
            changed.iter().for_each(|&(at, ..)| (before[at], after[at]) = (0, 0));
            assert!(changed.len() <= 1 && before == after, "{changed:?}");
        } else {
            assert!(owed.is_some_and(|(decision, why)| decision && why.contains("tried 3 times")), "{error}");
        }
        assert_eq!(rig.get("seal"), "sealed", "{error}");
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

/// Each part, with Design Capacity and a value for it.
const PARTS: [(&str, (u8, u16)); 10] = [
    ("bq34z100-g1", (48, 11)),
    ("bq27520-g3", (48, 10)),
    ("bq27500", (48, 10)),
    ("bq27441-g1", (82, 10)),
    ("bq27421-g1", (82, 10)),
    ("bq27426", (82, 6)),
    ("bq27427", (82, 6)),
    ("bq27621-g1", (82, 3)),
    ("bq34110", (FLAT, 0x41F5)),
    ("bq35100", (FLAT, 0x41FE)),
];

/// Everything that can be read, but for keys.
fn everything(rig: &mut Rig) -> Vec<Vec<u8>> {
    let subclasses = rig.gauge.chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let subclasses: Vec<_> = subclasses.collect();
    rig.dataflash.read(&mut rig.gauge, &subclasses, Duration::ZERO).expect("it can be read")
}

/// Until a block is loaded the window shows another one, or none, with a checksum that fits.
#[test]
fn blocks_that_are_ready_late_are_read_and_written_right() {
    for (chip, (id, offset)) in PARTS {
        let expected = everything(&mut Rig::new(chip));
        for (knob, ms) in ["load_ms", "block_ms"]
            .into_iter()
            .flat_map(|knob| ["0", "5", "9", "10", "20", "30", "40", "50"].map(|ms| (knob, ms)))
        {
            for early in ["previous", "blank"] {
                let at = format!("{chip}, {knob} {ms}, {early}");
                let mut rig = Rig::new(chip);
                rig.set(knob, ms);
                rig.set("early", early);
                assert!(everything(&mut rig) == expected, "{at}");
                let before = rig.sim.flash();
                let old = rig.read(id, offset).expect("a read");
                let text = u16::from_be_bytes([old[0], old[1]]).to_string();
                let programmed = rig.get("programmed");
                assert_eq!(rig.write(id, offset, &text), Ok(Outcome::Unchanged), "{at}");
                assert_eq!(rig.get("programmed"), programmed, "{at}");
                for fault in ["drop-commit", "corrupt-commit"] {
                    rig.set("fault", fault);
                    let error = rig.write(id, offset, "1234").expect_err(fault);
                    assert_eq!(cause(&error), "rolled-back", "{at}: {error}");
                    assert_eq!(differences(&before, &rig.sim.flash()), [], "{at}");
                }
                assert!(matches!(rig.write(id, offset, "1234"), Ok(Outcome::Written { .. })), "{at}");
                let changed = differences(&before, &rig.sim.flash()).len();
                assert!((1..=2).contains(&changed), "{at}: {changed} bytes changed");
                assert_eq!(rig.read(id, offset), Ok(vec![0x04, 0xd2]), "{at}");
                assert_eq!(rig.seal(), Seal::Sealed, "{at}");
            }
        }
    }
}

/// The end of CONFIG UPDATE seals the gauge, which then refuses keys for 4 s by its own clock.
#[test]
fn a_write_waits_until_a_gauge_that_has_sealed_itself_takes_keys_again() {
    for (chip, (id, offset)) in PARTS.into_iter().filter(|(chip, _)| chip.starts_with("bq274")) {
        for lock in ["0", "4000", "4005", "5000"] {
            for key_lock in ["off", "on"] {
                let at = format!("{chip}, {lock} ms, {key_lock}");
                let mut rig = Rig::new(chip);
                rig.set("lock_ms", lock);
                rig.set("key_lock", key_lock);
                for text in ["1234", "1300"] {
                    let begun = rig.clock.now();
                    let outcome = rig.write(id, offset, text);
                    assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{at}: {outcome:?}");
                    let took = rig.clock.now() - begun;
                    assert!(took < Duration::from_secs(20), "{at}: {took:?}");
                    assert_eq!(rig.seal(), Seal::Sealed, "{at}");
                }
                assert_eq!(rig.read(id, offset), Ok(vec![0x05, 0x14]), "{at}");
            }
        }
    }
}

/// Pairs of key words that were sent.
fn keys_sent(rig: &Rig) -> usize {
    rig.log().iter().filter(|line| *line == "; hidden").count() / 2
}

#[test]
fn a_key_that_has_worked_is_not_given_up_after_two_disturbed_attempts() {
    let folder = Folder::new("disturbed");
    for (chip, (id, offset)) in PARTS {
        for disturbance in ["refused", "first word flipped", "second word flipped"] {
            let at = format!("{chip}, {disturbance}");
            let mut rig = Rig::new(chip);
            let [first, second] = rig.gauge.chip.security.default_unseal.map(u16::to_le_bytes);
            let word = if disturbance.starts_with("first") { first } else { second };
            let (flips, left) = (disturbance != "refused", Arc::new(AtomicU64::new(0)));
            let flipped = left.clone();
            rig.start_with(&folder, Keys::default(), move |bus, _, write, read| match *write {
                [0x00, low, high] if [low, high] == word && flipped.load(Ordering::Relaxed) > 0 => {
                    flipped.fetch_sub(1, Ordering::Relaxed);
                    bus.transfer(&[0x00, low ^ 1, high], read)
                }
                _ => bus.transfer(write, read),
            });
            rig.read(id, offset).expect("the default key");
            let before = rig.sim.flash();
            match flips {
                // In two attempts; the words of some keys are alike.
                true => left.store(if first == second { 4 } else { 2 }, Ordering::Relaxed),
                false => rig.set("drop_keys", "2"),
            }
            let error = rig.write(id, offset, "1234").expect_err("both attempts are disturbed");
            assert_eq!(cause(&error), "not-now", "{at}: {error}");
            assert_eq!(differences(&before, &rig.sim.flash()), [], "{at}");
            let outcome = rig.write(id, offset, "1234");
            assert!(outcome.is_ok(), "{at}: {error}, then {outcome:?}");
            assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]), "{at}");
        }
    }
}

#[test]
fn a_wrong_key_is_sent_twice_and_then_never_again() {
    let folder = Folder::new("wrong");
    for (chip, (id, offset)) in PARTS {
        let mut rig = Rig::new(chip);
        let keys = Keys::of(Name::Unseal, &[0x1234, 0x5678].into());
        rig.start_with(&folder, keys, |bus, _, write, read| bus.transfer(write, read));
        rig.sim.clear_log();
        rig.arrive().expect("nothing to settle");
        for _ in 0..4 {
            assert_eq!(cause(&rig.write(id, offset, "1234").expect_err("no key")), "not-permitted", "{chip}");
            assert_eq!(cause(&rig.read(id, offset).expect_err("no key")), "not-permitted", "{chip}");
            let opened = rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO);
            assert_eq!(cause(&opened.expect_err("no key")), "not-permitted", "{chip}");
            rig.settle().expect("nothing to settle");
            rig.pause(60);
        }
        assert_eq!(keys_sent(&rig), 2, "{chip}");
        assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]), "{chip}");
    }
}

/// The reset of a write seals a gauge, so its key must be known to fit before.
#[test]
fn a_write_whose_reset_would_lock_out_the_host_is_refused() {
    let folder = Folder::new("lockout");
    let wrong = Keys::of(Name::Unseal, &[0x1234, 0x5678].into());
    for found in [Seal::Unsealed, Seal::FullAccess] {
        let mut rig = Rig::found("bq34z100-g1", found);
        let flash = rig.sim.flash();
        rig.start_with(&folder, wrong.clone(), |bus, _, write, read| bus.transfer(write, read));
        rig.arrive().expect("nothing to settle");
        let error = rig.write(80, 53, "3100").expect_err("the key does not fit");
        assert_eq!(cause(&error), "not-permitted", "{found:?}: {error}");
        assert!(rig.sim.flash() == flash && rig.get("resets") == "0", "{found:?}");
        assert_eq!((rig.seal(), folder.files()), (found, vec![]), "{found:?}");
        // What needs no reset needs no key.
        assert!(rig.write(58, 3, "0x5a").is_ok(), "{found:?}");
        assert_eq!(rig.seal(), found, "{found:?}");
    }
}

/// FULL ACCESS shows the stored key, so it need not be tried.
#[test]
fn found_in_full_access_the_stored_key_shows_that_the_mounts_key_fits() {
    let folder = Folder::new("shown");
    let mut rig = Rig::found("bq34z100-g1", Seal::FullAccess);
    rig.start(&folder);
    rig.arrive().expect("nothing to settle");
    let outcome = rig.write(80, 53, "3100");
    assert!(matches!(outcome, Ok(Outcome::Written { reset: true, .. })), "{outcome:?}");
    assert_eq!((rig.seal(), rig.get("resets")), (Seal::FullAccess, "1".to_string()));
    assert_eq!(rig.read(80, 53), Ok(vec![0x0c, 0x1c]));
}

fn seals(chip: &Chip, write: &[u8]) -> bool {
    write == [&[0x00], &chip.security.seal.to_le_bytes()[..]].concat()
}

/// From the first SEALED on, nothing answers for that time.
fn silent_at_the_end(rig: &mut Rig, folder: &Folder, silence: Duration) {
    let (chip, clock, mut until) = (rig.gauge.chip, rig.clock.clone(), None);
    rig.start_with(folder, Keys::default(), move |bus, _, write, read| {
        if until.is_none() && seals(chip, write) {
            until = Some(clock.now() + silence);
        }
        if until.is_some_and(|until| clock.now() < until) {
            return Err(BusError::NoAck);
        }
        bus.transfer(write, read)
    });
}

#[test]
fn a_gauge_is_sealed_although_its_seal_command_is_lost() {
    let folder = Folder::new("lost-seal");
    for case in CASES.iter().filter(|case| case.found == Seal::Sealed) {
        let new = case.model().1;
        for trouble in ["1 lost", "2 lost", "3 lost", "silence"] {
            let at = format!("{}, {trouble}", case.name());
            let mut rig = case.rig();
            let changes = case.changes(&rig);
            match trouble.split_once(" lost") {
                Some((count, _)) => {
                    rig.start(&folder);
                    rig.set("drop_seals", count);
                }
                None => silent_at_the_end(&mut rig, &folder, Duration::from_millis(300)),
            }
            let outcome = rig.write_all(&changes);
            assert!(outcome.is_ok(), "{at}: {outcome:?}");
            assert!(rig.sim.flash() == new, "{at}");
            assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
            assert!(rig.dataflash.owed().is_none(), "{at}");
        }
    }
}

#[test]
fn a_seal_that_cannot_be_restored_is_owed_and_paid_when_the_gauge_answers() {
    let folder = Folder::new("owed-seal");
    for case in CASES.iter().filter(|case| case.found == Seal::Sealed) {
        let (old, new) = case.model();
        for (access, flash) in [("write", &new), ("read", &old)] {
            for restarts in [false, true] {
                let at = format!("{}, {access}, starts again: {restarts}", case.name());
                let mut rig = case.rig();
                let changes = case.changes(&rig);
                silent_at_the_end(&mut rig, &folder, Duration::from_secs(60));
                let place = changes[0].place();
                let error = match access {
                    "write" => rig.write_all(&changes).map(|_| ()),
                    _ => rig.read(place.subclass, place.offset).map(|_| ()),
                };
                let error = error.expect_err("the gauge stays open");
                assert_eq!(cause(&error), "state-unknown", "{at}: {error}");
                let owed = rig.dataflash.owed().expect("the seal is owed");
                assert!(owed.why.contains("restoring the sealed state") && !owed.needs_decision, "{at}");
                assert_eq!(folder.files().len(), 1, "{at}");
                rig.settle().expect_err("it is still silent");
                assert!(rig.dataflash.owed().is_some() && folder.files().len() == 1, "{at}");
                rig.pause(60);
                if restarts {
                    rig.start(&folder);
                    rig.arrive().expect("it answers").expect("something is owed");
                } else {
                    rig.settle().expect("it answers").expect("something is owed");
                }
                assert!(rig.dataflash.owed().is_none() && rig.sim.flash() == *flash, "{at}");
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
            }
        }
    }
}

#[test]
fn a_gauge_that_a_host_left_open_is_sealed_at_the_next_start() {
    let folder = Folder::new("left-open");
    type Access = fn(&mut DataFlash, &mut Gauge) -> Result<()>;
    let read: Access = |dataflash, gauge| {
        let subclass = gauge.chip.subclasses.iter().find(|one| one.kind != Kind::Security).expect("one");
        dataflash.read(gauge, &[subclass], Duration::ZERO).map(|_| ())
    };
    let change_key: Access = |dataflash, gauge| {
        let [first, second] = gauge.chip.security.default_unseal;
        let text = format!("unseal {first:04x} {second:04x} 8d3e b7c5");
        let change = KeyChange::parse(text.as_bytes()).expect("a change");
        dataflash.change_key(gauge, &change, Order::LsbFirst, Duration::ZERO)
    };
    let (mut left_open, mut undecided) = (0, 0);
    for (chip, _) in PARTS {
        let has_keys = matches!(Rig::new(chip).gauge.chip.security.storage, KeyStorage::Flash(_));
        for (name, access) in [("read", read), ("key change", change_key)] {
            if name == "key change" && !has_keys {
                continue;
            }
            let (said, transfers) = host(&Rig::calibrated(chip, Seal::Sealed), &folder, None, access);
            said.expect("no cut").expect("no fault");
            assert_eq!(folder.files(), Vec::<String>::new(), "{chip} {name}");
            for (number, after) in (1..=transfers).flat_map(|number| [(number, false), (number, true)]) {
                let at = format!("{chip}, {name}, cut at {number}, after it: {after}");
                let mut rig = Rig::calibrated(chip, Seal::Sealed);
                assert!(host(&rig, &folder, Some((number, after)), access).0.is_none(), "{at}");
                rig.pause(5);
                left_open += usize::from(rig.get("seal") != "sealed");
                rig.start(&folder);
                match rig.arrive() {
                    Ok(_) => {}
                    // A key that nobody knows is in the gauge, which stays open until somebody gives it.
                    Err(error) if name == "key change" && rig.get("seal") != "sealed" => {
                        undecided += 1;
                        assert!(error.to_string().contains("do not cut its power"), "{at}: {error}");
                        let again = change_key(&mut rig.dataflash, &mut rig.gauge);
                        again.unwrap_or_else(|error| panic!("{at}: {error}"));
                    }
                    Err(error) => panic!("{at}: {error}"),
                }
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
                assert!(rig.dataflash.owed().is_none(), "{at}");
            }
        }
    }
    assert!(left_open > 100, "{left_open} times the host left it open");
    assert!((4..200).contains(&undecided), "{undecided} times a new key was not known");
}

/// A gauge that was found SEALED is opened to be compared with the one that a host had left open. Where the bus fails then
/// for a moment, the gauge is SEALED again all the same.
#[test]
fn regression_a_gauge_stayed_open_where_its_comparison_failed() {
    let folder = Folder::new("compared");
    let read = |dataflash: &mut DataFlash, gauge: &mut Gauge| {
        let subclass = gauge.chip.subclasses.iter().find(|one| one.kind != Kind::Security).expect("one");
        dataflash.read(gauge, &[subclass], Duration::ZERO).map(|_| ())
    };
    let mut failed = 0;
    for first in 1..90 {
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        let first_read = host(&rig, &folder, None, read).0.expect("no cut");
        first_read.expect("no fault");
        let cut = host(&rig, &folder, Some((40, true)), |dataflash, gauge| {
            read(dataflash, gauge)?;
            read(dataflash, gauge)
        });
        assert!(cut.0.is_none() && folder.files().len() == 1, "{:?}", folder.files());
        rig.power_cycle();
        rig.pause(5);
        rig.start_with(&folder, Keys::default(), move |bus, number, write, read| {
            match (first..first + 8).contains(&number) {
                true => Err(BusError::NoAck),
                false => bus.transfer(write, read),
            }
        });
        let arrived = rig.arrive();
        failed += u32::from(arrived.is_err());
        assert_eq!(rig.get("seal"), "sealed", "the bus fails at transfer {first}: {arrived:?}");
        rig.start(&folder);
        rig.arrive().expect("the bus works");
        assert_eq!(folder.files(), Vec::<String>::new(), "{first}");
    }
    assert!(failed > 10, "{failed} times it could not be compared");
}

/// The value that fails to verify after the reset is the gauge's Design Capacity, which a register shows.
#[test]
fn a_rollback_after_the_reset_makes_the_gauge_work_with_the_old_value() {
    for (chip, (id, offset), code) in [("bq34z100-g1", (48, 11), 0x3C), ("bq27520-g3", (48, 10), 0x3C)] {
        let folder = Folder::new("works-with");
        let mut rig = Rig::calibrated(chip, Seal::Sealed);
        let register = |rig: &mut Rig| {
            let mut word = [0; 2];
            rig.gauge.read(code, &mut word).expect("it answers");
            u16::from_le_bytes(word)
        };
        let (old, before) = (rig.sim.flash(), register(&mut rig));
        let (sim, mut wrong) = (rig.sim.clone(), true);
        rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
            let done = bus.transfer(write, read);
            if write == RESET && std::mem::take(&mut wrong) {
                sim.set_flash(id.into(), offset.into(), &[0x11, 0x11]);
            }
            done
        });
        let error = rig.write(id, offset, "2200").expect_err("it does not verify");
        assert_eq!(cause(&error), "rolled-back", "{chip}: {error}");
        assert_eq!(differences(&old, &rig.sim.flash()), [], "{chip}");
        assert_eq!(rig.get("resets"), "2", "{chip}");
        rig.pause(3);
        assert_eq!(register(&mut rig), before, "{chip}");
        assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]), "{chip}");
    }
}

#[test]
fn a_bit_error_after_the_reset_rolls_nothing_back() {
    let mut runs = 0;
    for case in CASES.iter().filter(|case| case.found == Seal::Sealed) {
        let new = case.model().1;
        let run = |rig: &mut Rig, fault: &str| {
            let changes = case.changes(rig);
            rig.set("fault", fault);
            rig.write_all(&changes)
        };
        let mut plain = case.rig();
        plain.sim.clear_log();
        run(&mut plain, "none").expect("no fault");
        let log = plain.sim.log();
        let after = |write: &[u8]| log.iter().rposition(|record| record.write == write);
        // The end of CONFIG UPDATE is a reset as well.
        let Some(reset) = after(&RESET).or_else(|| after(&[0x00, 0x42, 0x00])) else { continue };
        let last_data =
            log.iter().rposition(|record| record.read.len() > 4 || record.write.first() >= Some(&0x40));
        let last_data = last_data.expect("it is verified");
        for (number, record) in log.iter().enumerate().take(last_data + 1).skip(reset + 1) {
            for byte in (record.write.len()..record.write.len() + record.read.len()).take(40) {
                for bit in [0, 4, 7] {
                    let fault = format!("flip {} {byte} {bit}", number + 1);
                    let mut rig = case.rig();
                    let outcome = run(&mut rig, &fault);
                    runs += 1;
                    assert!(outcome.is_ok(), "{}, {fault}: {outcome:?}", case.name());
                    assert!(rig.sim.flash() == new, "{}, {fault}", case.name());
                    assert_eq!(rig.get("seal"), "sealed", "{}, {fault}", case.name());
                }
            }
        }
    }
    println!("{runs} bit errors after the reset");
}

#[test]
fn a_reset_that_is_lost_is_noticed() {
    for case in CASES {
        let (old, new) = case.model();
        for lost in [1, 2, 3, 6] {
            let at = format!("{}, {lost} resets lost", case.name());
            let folder = Folder::new("lost-reset");
            let mut rig = case.rig();
            let resets = |rig: &Rig| rig.get("resets").parse::<u32>().expect("a number");
            let before = resets(&rig);
            let changes = case.changes(&rig);
            let needs = {
                let mut plain = case.rig();
                plain.write_all(&changes).expect("no fault");
                resets(&plain) > 0
            };
            // Keys are tried at the start, as a mount that has read something has done.
            rig.read(changes[0].place().subclass, changes[0].place().offset).expect("the default key");
            rig.start(&folder);
            rig.gauge.prove_key();
            rig.set("drop_resets", &lost.to_string());
            let outcome = rig.write_all(&changes);
            match &outcome {
                Ok(_) if case.found == Seal::Sealed => {
                    assert!(rig.sim.flash() == new && (!needs || lost < 3), "{at}");
                    assert_eq!(resets(&rig), before + u32::from(needs), "{at}");
                }
                Ok(_) => assert!(rig.sim.flash() == new && (!needs || lost < 3), "{at}"),
                Err(error) if cause(error) == "rolled-back" => {
                    assert!(needs && lost >= 3 && rig.sim.flash() == old, "{at}: {error}");
                }
                Err(error) => {
                    assert_eq!(cause(error), "state-unknown", "{at}: {error}");
                    assert!(lost > 3 && rig.dataflash.owed().is_some(), "{at}: {error}");
                    rig.settle().unwrap_or_else(|error| panic!("{at}: {error}")).expect("it is owed");
                    assert!(rig.sim.flash() == old, "{at}: {error}");
                }
            }
            let seal = rig.seal();
            assert!(seal == case.found, "{at}: {seal:?} after {outcome:?}");
            assert_eq!(folder.files(), Vec::<String>::new(), "{at}");
        }
    }
}

/// Checks what an answer says, settles what is owed, and checks that data flash then holds old or new values.
fn check_answer(
    case: &Case,
    rig: &mut Rig,
    folder: &Folder,
    (old, new): &(Vec<u8>, Vec<u8>),
    outcome: &Result<Outcome>,
    at: &str,
) {
    match outcome {
        Ok(_) => assert_eq!(differences(new, &rig.sim.flash()), [], "{at}: success is false"),
        Err(error) if cause(error) == "state-unknown" => {
            let flash = rig.sim.flash();
            let is_owed = rig.dataflash.owed().is_some();
            assert!(
                is_owed || flash == *old || flash == *new,
                "{at}: half way, and nothing is owed: {error}"
            );
            assert_eq!(is_owed, folder.text().is_some(), "{at}: {error}");
        }
        Err(error) => assert_eq!(differences(old, &rig.sim.flash()), [], "{at}: {error}"),
    }
    if rig.dataflash.owed().is_none() {
        assert_eq!(folder.files(), Vec::<String>::new(), "{at}: {outcome:?}");
        if outcome.as_ref().is_ok() {
            assert_eq!(rig.seal(), case.found, "{at}");
        }
    }
    rig.pause(3);
    rig.settle().unwrap_or_else(|error| panic!("{at}: {outcome:?}, then {error}"));
    let flash = rig.sim.flash();
    assert!(flash == *old || flash == *new, "{at}: {outcome:?}, settled to {:?}", differences(old, &flash));
    let seal = rig.seal();
    assert!(seal == case.found || case.found != Seal::Sealed, "{at}: {seal:?}");
    assert!(rig.dataflash.owed().is_none() && folder.files().is_empty(), "{at}: {outcome:?}");
    assert_eq!(rig.get("mode"), "normal", "{at}: {outcome:?}");
}

#[test]
fn a_write_on_a_slow_bus_answers_within_30_s() {
    let folder = Folder::new("slow");
    for case in CASES {
        let model = case.model();
        for ms in [50, 100, 150, 200] {
            let at = format!("{}, {ms} ms for each transfer", case.name());
            let mut rig = case.rig();
            let changes = case.changes(&rig);
            let (clock, slow) = (rig.clock.clone(), Arc::new(AtomicU64::new(ms)));
            let pause = slow.clone();
            rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
                clock.sleep(Duration::from_millis(pause.load(Ordering::Relaxed)));
                bus.transfer(write, read)
            });
            rig.gauge.prove_key();
            let asked = rig.clock.now();
            let outcome = rig.write_all(&changes);
            let took = rig.clock.now() - asked;
            assert!(took < Duration::from_secs(30), "{at}: {took:?} until {outcome:?}");
            slow.store(0, Ordering::Relaxed);
            check_answer(case, &mut rig, &folder, &model, &outcome, &at);
        }
    }
}

/// A host that is suspended for five minutes at each transfer in turn.
#[test]
pub(crate) fn a_host_that_pauses_at_any_transfer_leaves_nothing_half_way() {
    let folder = Folder::new("paused");
    let (mut done, mut refused, mut back, mut unknown) = (0, 0, 0, 0);
    for case in CASES {
        let model = case.model();
        let transfers = {
            let rig = case.rig();
            let changes = case.changes(&rig);
            host(&rig, &folder, None, |dataflash, gauge| dataflash.write(gauge, &changes, Duration::ZERO)).1
        };
        for (number, after) in one_in(5, (1..=transfers).flat_map(|number| [(number, false), (number, true)]))
        {
            let at = format!("{}, pause at {number} of {transfers}, after it: {after}", case.name());
            let mut rig = case.rig();
            let changes = case.changes(&rig);
            let clock = rig.clock.clone();
            rig.start_with(&folder, Keys::default(), move |bus, now, write, read| {
                let pause = |is_now: bool| {
                    if is_now && now == number {
                        clock.sleep(Duration::from_secs(300));
                    }
                };
                pause(!after);
                let done = bus.transfer(write, read);
                pause(after);
                done
            });
            let before = rig.gauge.clock.now();
            let outcome = rig.write_all(&changes);
            let took = rig.clock.now() - before;
            assert!(took < Duration::from_secs(330), "{at}: {took:?}");
            match &outcome {
                Ok(_) => done += 1,
                Err(error) if cause(error) == "rolled-back" => back += 1,
                Err(error) if cause(error) == "state-unknown" => unknown += 1,
                Err(_) => refused += 1,
            }
            check_answer(case, &mut rig, &folder, &model, &outcome, &at);
        }
    }
    println!("paused: {done} done, {refused} refused, {back} rolled back, {unknown} unknown and owed");
}

/// Power fails while a block is programmed, and again at each transfer of settling that, for the host and the gauge.
/// Only where the damage cannot be told from somebody else's values does a person have to decide.
#[test]
pub(crate) fn a_second_power_cut_while_settling_leaves_old_or_new_values() {
    let folder = Folder::new("second-cut");
    let (mut settled, mut undecided) = (0, 0);
    for case in CASES.iter().filter(|case| case.found == Seal::Sealed) {
        if Chip::by_name(case.chip).is_some_and(|chip| chip.volatile.is_some()) {
            continue;
        }
        let (old, new) = case.model();
        let tears = ["old", "rest-old", "erased", "rest-erased", "neighbour"];
        // A flat part has a neighbour of each neighbour, which is not in the plan.
        let is_flat = Chip::by_name(case.chip).is_some_and(|chip| chip.access.scheme == Scheme::Mac);
        // The keys of a bq35100 are in the row of Operation Config A, and in no journal.
        let count = if case.chip == "bq35100" {
            2
        } else if is_flat {
            4
        } else {
            5
        };
        for tear in tears.into_iter().take(count) {
            for words in [0, 5] {
                let first = || {
                    let mut rig = case.rig();
                    let changes = case.changes(&rig);
                    rig.set("tear", tear);
                    rig.start(&folder);
                    // What is next to the blocks is known once it has been read.
                    for change in &changes {
                        let _ = rig.read(change.place().subclass, change.place().offset).expect("a read");
                    }
                    rig.set("fault", &format!("torn-commit {words}"));
                    let error = rig.write_all(&changes).expect_err("it is torn");
                    assert_eq!(cause(&error), "state-unknown", "{}: {error}", case.name());
                    rig.set("power", "on");
                    rig.pause(3);
                    rig.start(&folder);
                    rig
                };
                let settle =
                    |dataflash: &mut DataFlash, gauge: &mut Gauge| dataflash.settle(gauge, Duration::ZERO);
                let rig = first();
                let (_, transfers) = host(&rig, &folder, None, settle);
                for (number, after) in one_in(5, (1..=transfers).map(|number| (number, number % 2 == 0))) {
                    let _ = fs::remove_file(folder.journal().path());
                    let at = format!("{}, {tear} {words}, cut at {number}, after it: {after}", case.name());
                    let mut rig = first();
                    let said = host(&rig, &folder, Some((number, after)), settle).0;
                    assert!(said.is_none(), "{at}: {said:?}");
                    rig.power_cycle();
                    let flash = rig.sim.flash();
                    rig.start(&folder);
                    match rig.arrive() {
                        Ok(_) => {
                            settled += 1;
                            let flash = rig.sim.flash();
                            let is_known = flash == old || flash == new;
                            assert!(is_known, "{at}: {:?}", differences(&old, &flash));
                            assert_eq!(folder.files(), Vec::<String>::new(), "{at}");
                        }
                        Err(error) => {
                            undecided += 1;
                            assert_eq!((cause(&error), tear), ("busy", "neighbour"), "{at}: {error}");
                            assert!(rig.sim.flash() == flash && folder.text().is_some(), "{at}: {error}");
                            let undone =
                                rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO);
                            undone.unwrap_or_else(|error| panic!("{at}: {error}"));
                            assert_eq!(differences(&old, &rig.sim.flash()), [], "{at}");
                        }
                    }
                    assert_eq!(rig.get("seal"), "sealed", "{at}");
                }
                let _ = fs::remove_file(folder.journal().path());
            }
        }
    }
    println!("a second power cut: {settled} settled, {undecided} left to a person");
}

/// A value that the gauge learns, and a parameter of the same block that a user writes: area, offset.
struct Beside {
    chip: &'static str,
    learned: (u8, u16),
    written: (u8, u16),
}

const BESIDE: [Beside; 8] = [
    // Cycle Count and Design Capacity, Board Offset and Int Temp Offset, Qmax and Design Capacity.
    Beside { chip: "bq34z100-g1", learned: (48, 6), written: (48, 11) },
    Beside { chip: "bq34z100-g1", learned: (104, 10), written: (104, 11) },
    Beside { chip: "bq27520-g3", learned: (104, 10), written: (104, 11) },
    Beside { chip: "bq27441-g1", learned: (82, 0), written: (82, 10) },
    Beside { chip: "bq27426", learned: (82, 0), written: (82, 6) },
    Beside { chip: "bq27427", learned: (82, 0), written: (82, 6) },
    Beside { chip: "bq27621-g1", learned: (82, 0), written: (82, 3) },
    Beside { chip: "bq34110", learned: (FLAT, 0x400C), written: (FLAT, 0x400D) },
];

/// Changes data flash without the bus.
fn set(sim: &Sim, (id, offset): (u8, u16), bytes: &[u8]) {
    let at = usize::from(offset) - if id == FLAT { 0x4000 } else { 0 };
    sim.set_flash(id.into(), at, bytes);
}

impl Beside {
    fn rig(&self) -> Rig {
        Rig::calibrated(self.chip, Seal::Sealed)
    }

    /// A value that differs from the one before.
    fn text(&self, round: usize) -> String {
        let first = if self.written.0 == 104 || self.chip == "bq34110" { 1 } else { 1100 };
        (first + round % 20).to_string()
    }

    fn put(&self, sim: &Sim, byte: u8) {
        set(sim, self.learned, &[byte]);
    }

    fn learned(&self, rig: &mut Rig) -> u8 {
        rig.read(self.learned.0, self.learned.1).expect("a read")[0]
    }
}

/// The gauge rewrites its own values at any moment.
#[test]
fn writes_beside_learned_values_succeed_while_the_gauge_learns() {
    for case in &BESIDE {
        for (knob, value) in
            [("rewrite_ms", "300"), ("rewrite_ms", "700"), ("rewrite_every", "7"), ("rewrite_every", "1")]
        {
            let mut rig = case.rig();
            rig.set(knob, value);
            for round in 0..25 {
                let at = format!("{} {:?}, {knob} {value}, write {round}", case.chip, case.written);
                let outcome = rig.write(case.written.0, case.written.1, &case.text(round));
                assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{at}: {outcome:?}");
                assert_eq!(rig.get("seal"), "sealed", "{at}");
                rig.pause(5);
            }
        }
    }
}

/// Values that the gauge itself updates, and numbers for them.
const REWRITTEN: [(&str, (u8, u16), [u16; 3]); 5] = [
    // Lifetime Max Temp, Cycle Count, Qmax Cell 0.
    ("bq34z100-g1", (59, 0), [301, 250, 0x0155]),
    ("bq34z100-r2", (59, 0), [301, 250, 0x0155]),
    ("bq34z100-g1", (48, 6), [11, 5, 0x0155]),
    ("bq27441-g1", (82, 0), [15_000, 16_111, 0x3855]),
    ("bq27427", (82, 0), [15_000, 16_111, 0x3855]),
];

#[test]
fn regression_a_write_to_what_the_gauge_keeps_rewriting_left_its_state_unknown() {
    let folder = Folder::new("rewritten");
    for (chip, (id, offset), numbers) in REWRITTEN {
        for (knob, value) in
            [("rewrite_ms", "300"), ("rewrite_ms", "700"), ("rewrite_every", "7"), ("rewrite_every", "1")]
        {
            let mut rig = Rig::calibrated(chip, Seal::Sealed);
            rig.start(&folder);
            rig.set(knob, value);
            let mut written = 0;
            for round in 0..25 {
                let at = format!("{chip} {id}/{offset}, {knob} {value}, write {round}");
                match rig.write(id, offset, &numbers[round % 2].to_string()) {
                    Ok(_) => written += 1,
                    Err(error) => assert_eq!(cause(&error), "rolled-back", "{at}: {error}"),
                }
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
                rig.pause(5);
            }
            assert!(written > 0, "{chip} {id}/{offset}, {knob} {value}");
        }
    }
}

/// After each reset the gauge stores the extremes that it has measured, every second.
#[test]
fn lifetime_data_that_is_lowered_is_written_or_put_back() {
    let folder = Folder::new("lifetime");
    for chip in ["bq34z100-g1", "bq34z100-r2"] {
        let mut rig = Rig::calibrated(chip, Seal::Sealed);
        // [QEN] in Update Status, and LT Update Time.
        set(&rig.sim, (82, 4), &[0x06]);
        set(&rig.sim, (66, 0), &[1, 1, 1, 0, 1]);
        rig.start(&folder);
        rig.power_cycle();
        for round in 0..10 {
            let outcome = rig.write(59, 0, "0");
            let failed = outcome.as_ref().err().map(cause);
            assert!([None, Some("rolled-back")].contains(&failed), "{chip}, {round}: {outcome:?}");
            assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{chip}, {round}");
            rig.pause(5);
        }
    }
}

/// The host loses its power, and the gauge rewrites the value before it is back. What a loss of power erases is no value.
#[test]
fn regression_a_value_that_was_rewritten_after_an_interrupted_write_needed_a_person() {
    let folder = Folder::new("rewritten-since");
    for (chip, place @ (id, offset), [_, new, own]) in REWRITTEN {
        for own in [own, 0xffff] {
            let write = |rig: &Rig, cut| {
                let row = rig.gauge.chip.row(&id.to_string(), &offset.to_string()).expect("a parameter");
                let change =
                    Change::parse(rig.gauge.chip, row, new.to_string().as_bytes(), false).expect("it fits");
                host(rig, &folder, cut, |dataflash, gauge| dataflash.write(gauge, &[change], Duration::ZERO))
            };
            let (said, transfers) = write(&Rig::calibrated(chip, Seal::Sealed), None);
            said.expect("no cut").expect("no fault");
            for number in 1..=transfers {
                let at = format!("{chip} {id}/{offset}, cut after {number} of {transfers}, 0x{own:04x}");
                let mut rig = Rig::calibrated(chip, Seal::Sealed);
                let old = rig.sim.flash();
                write(&rig, Some((number, true)));
                rig.clock.sleep(Duration::from_secs(5));
                let is_planned = folder.text().is_some_and(|text| text.contains("\nblock "));
                if is_planned {
                    set(&rig.sim, place, &own.to_be_bytes());
                }
                restart(&rig, &folder, None);
                rig.start(&folder);
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
                let stored = rig.read(id, offset).expect("the default key");
                let is_own = stored == own.to_be_bytes();
                assert_eq!(is_own, is_planned && own != 0xffff, "{at}: {stored:x?}");
                assert!(is_own || stored == new.to_be_bytes() || rig.sim.flash() == old, "{at}: {stored:x?}");
            }
        }
    }
}

/// The gauge rewrites one of two values with its reset, and the other one reads wrong, so the write goes back. That the first
/// is neither old nor new makes it the gauge's own.
#[test]
fn what_the_gauge_has_rewritten_does_not_go_back() {
    let folder = Folder::new("rewritten-back");
    const OTHER: (u8, u16) = (80, 53);
    for (chip, place @ (id, offset), [_, new, own]) in REWRITTEN.into_iter().take(2) {
        let mut rig = Rig::calibrated(chip, Seal::Sealed);
        let other = rig.read(OTHER.0, OTHER.1).expect("the default key");
        let changes = [rig.change(id, offset, &new.to_string()), rig.change(OTHER.0, OTHER.1, "3100")];
        let (sim, mut fails) = (rig.sim.clone(), true);
        rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
            let done = bus.transfer(write, read);
            if fails && matches!(write, [0x00, 0x41, 0x00]) {
                fails = false;
                set(&sim, place, &own.to_be_bytes());
                set(&sim, OTHER, &[0x11, 0x11]);
            }
            done
        });
        let outcome = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
        let error = outcome.expect_err("one value reads wrong after the reset");
        assert_eq!(cause(&error), "rolled-back", "{chip}: {error}");
        assert_eq!(rig.read(OTHER.0, OTHER.1), Ok(other), "{chip}");
        assert_eq!(rig.read(id, offset), Ok(own.to_be_bytes().to_vec()), "{chip}");
        assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{chip}");
    }
}

/// One block is put back before the first of two writes of a block each.
#[test]
fn regression_blocks_that_a_write_had_settled_first_counted_twice() {
    let folder = Folder::new("settled-first");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    half_way(&mut rig, &folder);
    rig.start(&folder);
    let limits = Limits { writes_per_hour: 3, ..Limits::default() };
    rig.dataflash = DataFlash::new(limits, Some(folder.journal()));
    for text in ["3201", "3202"] {
        let outcome = rig.write(80, 53, text);
        assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{text}: {outcome:?}");
    }
    let error = rig.write(80, 53, "3203").expect_err("three an hour");
    assert!(cause(&error) == "not-now" && error.to_string().contains("3 blocks"), "{error}");
}

/// The value moves at each transfer of a write in turn, which succeeds or is rolled back. It has moved afterwards, unless
/// that was between the moment when its block was loaded and the commit: a block is programmed as a whole.
#[test]
fn neither_a_write_nor_its_rollback_undoes_what_the_gauge_has_learned() {
    let folder = Folder::new("learned");
    for case in &BESIDE {
        for fails_after in ["nothing", "its commit", "the reset"] {
            let run = |moves_at: u64| {
                let mut rig = case.rig();
                case.put(&rig.sim, 1);
                let (sim, number) = (rig.sim.clone(), Arc::new(AtomicU64::new(0)));
                let (mut fails, count) = (fails_after != "nothing", number.clone());
                rig.start_with(&folder, Keys::default(), move |bus, number, write, read| {
                    count.store(number, Ordering::Relaxed);
                    if number == moves_at {
                        case.put(&sim, 2);
                    }
                    let done = bus.transfer(write, read);
                    let is_reset = matches!(write, [0x00, 0x41 | 0x42, 0x00]);
                    let is_it = if fails_after == "the reset" { is_reset } else { programs(write) };
                    if fails && is_it {
                        fails = false;
                        set(&sim, case.written, &[0x11]);
                    }
                    done
                });
                let outcome = rig.write(case.written.0, case.written.1, &case.text(0));
                (rig, outcome, number.load(Ordering::Relaxed))
            };
            let (mut plain, outcome, transfers) = run(u64::MAX);
            let fails = outcome.is_err();
            assert!(fails == (fails_after != "nothing") || fails_after == "the reset", "{outcome:?}");
            assert_eq!(case.learned(&mut plain), 1);
            let mut lost = Vec::new();
            for number in 1..=transfers {
                let at = format!("{} {:?}, moves at {number} of {transfers}", case.chip, case.learned);
                let at = format!("{at}, fails after {fails_after}");
                let (mut rig, outcome, _) = run(number);
                match &outcome {
                    Ok(_) => assert!(!fails, "{at}"),
                    Err(error) => assert!(fails && cause(error) == "rolled-back", "{at}: {error}"),
                }
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
                if case.learned(&mut rig) != 2 {
                    lost.push(number);
                }
            }
            // Of each commit: to select and to look at the block, to send the bytes, and the checksum.
            let most = if case.learned.0 == FLAT { 0 } else { 4 * (1 + usize::from(fails)) };
            assert!(lost.len() <= most, "{} {:?}: {lost:?} of {transfers}", case.chip, case.learned);
        }
    }
}

/// One wrong bit makes IT_ENABLE of SEALED. The access succeeded, and Update Status was 04 for good.
#[test]
fn regression_a_seal_that_arrived_as_it_enable_was_a_success() {
    let folder = Folder::new("it-enable");
    for chip in ["bq34z100-g1", "bq34z100-r2"] {
        for access in ["write", "read", "seal"] {
            for is_enabled in [false, true] {
                let at = format!("{chip}, {access}, enabled before: {is_enabled}");
                let mut rig = Rig::calibrated(chip, Seal::Unsealed);
                if is_enabled {
                    rig.gauge.command(0x0021).expect("IT_ENABLE");
                }
                rig.gauge.go_to(Seal::Sealed).expect("it is sealed");
                let mut flips = true;
                rig.start_with(&folder, Keys::default(), move |bus, _, write, read| match *write {
                    [0x00, 0x20, 0x00] if std::mem::take(&mut flips) => {
                        bus.transfer(&[0x00, 0x21, 0x00], read)
                    }
                    _ => bus.transfer(write, read),
                });
                let outcome = match access {
                    "write" => rig.write(58, 3, "0x5a").map(drop),
                    "read" => rig.read(80, 53).map(drop),
                    _ => {
                        rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO).expect("its key");
                        rig.dataflash.go_to(&mut rig.gauge, Seal::Sealed, Duration::ZERO)
                    }
                };
                match is_enabled {
                    true => assert_eq!(outcome, Ok(()), "{at}"),
                    false => {
                        let error = outcome.expect_err(&at);
                        assert_eq!(cause(&error), "state-unknown", "{at}: {error}");
                        assert!(error.to_string().contains("as IT_ENABLE"), "{at}: {error}");
                    }
                }
                assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]), "{at}");
                assert!(rig.dataflash.owed().is_none(), "{at}");
            }
        }
    }
}

/// The rows of flash that decide whether a gauge programs flash, each with a change of something else in it.
fn rows_of_the_gate(rig: &mut Rig) -> Vec<Change> {
    let chip = rig.gauge.chip;
    let Some(gate) = &chip.gate else { return Vec::new() };
    let external = gate.external.as_ref().map(|external| external.byte);
    let bytes = [Some(gate.limit), gate.divider, external, gate.cells].into_iter().flatten();
    let rows: BTreeSet<_> = bytes.map(|(id, offset)| (id, offset - offset % WINDOW as u16)).collect();
    let mut other = |(id, base): (u8, u16)| {
        let subclasses = chip.subclasses.iter().filter(|row| row.id == id && row.kind != Kind::Security);
        let mut all = subclasses.flat_map(|row| row.parameters.iter().map(move |one| (row, one)));
        all.find_map(|row @ (_, parameter)| {
            let end = usize::from(parameter.offset) + parameter.kind.size();
            let is_inside = parameter.offset >= base && end <= usize::from(base) + WINDOW;
            let is_plain = !(parameter.learned || parameter.unproven || parameter.safe.is_some());
            let is_mark = chip.preflight.marks.contains(&(id, parameter.offset));
            let old = (is_inside && is_plain && !is_mark).then(|| rig.read(id, parameter.offset))?;
            another(row, &old.expect("it is read"))
        })
    };
    rows.into_iter().filter_map(&mut other).collect()
}

/// An erased row may hold what shuts flash, such as the bit that selects a divider: then nothing that is put back is
/// stored. That was tried again and again, and what was told was that the bus timed out.
#[test]
fn regression_a_row_that_shuts_flash_when_it_is_erased_was_never_settled() {
    let (mut runs, mut shut) = (0, BTreeSet::new());
    for chip in CHIPS {
        for change in rows_of_the_gate(&mut Rig::new(chip.name)) {
            let mut whole = Rig::calibrated(chip.name, Seal::Sealed);
            let old = whole.sim.flash();
            whole.write_all(std::slice::from_ref(&change)).expect("without a fault");
            let new = whole.sim.flash();
            for (tear, words) in [("erased", 0), ("erased", 9), ("rest-erased", 0), ("rest-erased", 5)] {
                let folder = Folder::new("erased-gate");
                let mut rig = Rig::calibrated(chip.name, Seal::Sealed);
                let case = format!("{} {} {tear} {words}", chip.name, change.name());
                rig.start(&folder);
                rig.set("tear", tear);
                rig.set("fault", &format!("torn-commit {words}"));
                rig.write_all(std::slice::from_ref(&change)).expect_err(&case);
                rig.set("power", "on");
                rig.pause(3);
                rig.start(&folder);
                let torn = rig.sim.flash();
                for _ in 0..5 {
                    if rig.settle().is_ok() {
                        break;
                    }
                    rig.pause(8);
                    let owed = rig.dataflash.owed().expect(&case);
                    assert!(owed.why.contains("stores nothing below"), "{case}: {}", owed.why);
                    assert!(!owed.needs_decision, "{case}: {}", owed.why);
                    assert!(rig.sim.flash() == torn, "{case}");
                }
                if rig.dataflash.owed().is_some() {
                    shut.insert(chip.name);
                    rig.set("voltage_mv", "60000");
                    rig.settle().expect(&case);
                }
                assert!([&old, &new].contains(&&rig.sim.flash()), "{case}");
                assert!(rig.dataflash.owed().is_none() && rig.get("seal") == "sealed", "{case}");
                runs += 1;
            }
        }
    }
    assert!(runs >= 24 && shut.contains("bq34110"), "{runs} runs, shut on {shut:?}");
}
