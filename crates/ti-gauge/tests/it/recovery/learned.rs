// SPDX-License-Identifier: MIT

//! Values that the gauge rewrites by itself while they, or what is beside them, are written.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use gauge_sim::Sim;
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{Change, Outcome};
use ti_gauge::gauge::Seal;
use ti_gauge::keys::Keys;

use super::{differences, set};
use crate::rig::{Rig, cause};
use crate::room::{Folder, host, programs, restart};

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
