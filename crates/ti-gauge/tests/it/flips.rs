// SPDX-License-Identifier: MIT

//! One wrong bit in each reading of each operation in turn. I2C has no error detection, so a reading that permits,
//! discards or proves something counts only when a second one agrees: whatever bit is wrong, no success is false,
//! nothing is called unknown that is known, no journal is thrown away, no mode is left on, and no pack stays open with
//! nothing owed.

use std::time::Duration;

use gauge_bus::Reach;
use gauge_bus::clock::Clock;
use ti_gauge::authentication::Order;
use ti_gauge::calibration::{Job, run};
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{DataFlash, Decision, Limits};
use ti_gauge::error::Result;
use ti_gauge::gauge::Seal;
use ti_gauge::keys::{KeyChange, Keys, Name};

use crate::rig::{Rig, cause};
use crate::room::{Folder, one_in};
use crate::room::{cut, half_way, programs};

/// Something that is done with a gauge.
struct Operation {
    name: &'static str,
    /// A gauge that is ready for it.
    rig: fn(&Folder) -> Rig,
    run: fn(&mut Rig) -> Result<()>,
}

/// What a gauge and its journal are like afterwards.
#[derive(Debug, PartialEq, Eq)]
struct State {
    flash: Vec<u8>,
    seal: Option<String>,
    mode: Option<String>,
    files: Vec<String>,
}

impl State {
    fn of(rig: &Rig, folder: &Folder) -> Self {
        let get = |knob| rig.sim.get(knob);
        Self { flash: rig.sim.flash(), seal: get("seal"), mode: get("mode"), files: folder.files() }
    }
}

/// The bits of a reading that are tried. Words decide most; of a block, whose checksum is read with it, each eighth byte
/// is taken.
fn bits(transfer: usize, length: usize) -> Vec<(usize, usize)> {
    let all = length <= 4 || std::env::var_os("GAUGEFS_ALL_FAULTS").is_some();
    let bytes = (0..length).filter(|at| all || at % 8 == transfer % 8 || *at < 2);
    bytes
        .flat_map(|at| (0..8).filter(move |bit| all || bit % 4 == transfer % 4).map(move |bit| (at, bit)))
        .collect()
}

impl Operation {
    fn start(&self, folder: &Folder) -> Rig {
        let rig = (self.rig)(folder);
        rig.sim.clear_log();
        rig
    }

    /// Runs the operation with each wrong bit.
    fn strike(&self) {
        let folder = Folder::new(&format!("flips-{}", self.name.replace(' ', "-")));
        let mut plain = self.start(&folder);
        let before = State::of(&plain, &folder);
        (self.run)(&mut plain).unwrap_or_else(|error| panic!("{}: no fault: {error}", self.name));
        let after = State::of(&plain, &folder);
        let reads = plain.sim.log().into_iter().enumerate();
        let reads: Vec<_> =
            reads.map(|(at, record)| (at + 1, record.write.len(), record.read.len())).collect();
        let mut runs = 0;
        for (number, written, length) in reads {
            for (byte, bit) in one_in(1, bits(number, length)) {
                let fault = format!("flip {number} {} {bit}", written + byte);
                let at = format!("{}, `{fault}`", self.name);
                let mut rig = self.start(&folder);
                rig.sim.set("fault", &fault).expect("a fault");
                let outcome = (self.run)(&mut rig);
                rig.sim.set("fault", "none").expect("a knob");
                let now = State::of(&rig, &folder);
                let owed = rig.dataflash.owed().map(|owed| owed.why.to_string());
                runs += 1;
                match &outcome {
                    Ok(()) => assert!(now == after, "{at}: success is false: {:?}", now.differs(&after)),
                    Err(error) => {
                        assert_ne!(cause(error), "state-unknown", "{at}: {error}");
                        assert!(now == before, "{at}: {error}: {:?}", now.differs(&before));
                    }
                }
                assert!(owed.is_none() || outcome.is_err(), "{at}: {owed:?}");
                // What failed is done at the next attempt.
                if outcome.is_err() {
                    (self.run)(&mut rig).unwrap_or_else(|error| panic!("{at}: again: {error}"));
                    assert!(State::of(&rig, &folder) == after, "{at}: again");
                }
            }
        }
        println!("{}: {runs} wrong bits", self.name);
    }
}

impl State {
    fn differs(&self, wanted: &Self) -> String {
        let bytes = (0..self.flash.len()).filter(|&at| self.flash[at] != wanted.flash[at]).count();
        format!(
            "{bytes} bytes differ, {:?} {:?} {:?}, wanted {:?} {:?} {:?}",
            self.seal, self.mode, self.files, wanted.seal, wanted.mode, wanted.files
        )
    }
}

/// A gauge whose engine keeps a journal, as when a mount starts.
fn journalled(mut rig: Rig, folder: &Folder) -> Rig {
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("nothing to settle");
    rig
}

fn settle(rig: &mut Rig) -> Result<()> {
    rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).map(drop)
}

#[test]
pub(crate) fn a_wrong_bit_in_a_write_changes_nothing_unsaid() {
    Operation {
        name: "write found sealed",
        rig: |folder| journalled(Rig::calibrated("bq34z100-g1", Seal::Sealed), folder),
        run: |rig| rig.write(80, 53, "3100").map(drop),
    }
    .strike();
}

/// A part that is never reset. The voltage is read once more for the threshold.
#[test]
fn a_wrong_bit_in_a_write_to_a_protector_changes_nothing_unsaid() {
    Operation {
        name: "write to a protector",
        rig: |folder| journalled(Rig::calibrated("bq27742-g1", Seal::Sealed), folder),
        run: |rig| rig.write(2, 0, "4350").map(drop),
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_write_to_an_open_gauge_changes_nothing_unsaid() {
    Operation {
        name: "write found unsealed",
        rig: |folder| journalled(Rig::calibrated("bq34z100-g1", Seal::Unsealed), folder),
        run: |rig| rig.write(80, 53, "3100").map(drop),
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_write_without_a_reset_changes_nothing_unsaid() {
    Operation {
        name: "write without a reset",
        rig: |folder| journalled(Rig::calibrated("bq34z100-g1", Seal::Sealed), folder),
        run: |rig| rig.write(58, 3, "0x5a").map(drop),
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_write_to_ram_changes_nothing_unsaid() {
    Operation {
        name: "write to RAM",
        rig: |folder| journalled(Rig::calibrated("bq27441-g1", Seal::Sealed), folder),
        run: |rig| rig.write(82, 10, "1200").map(drop),
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_write_to_a_flat_part_changes_nothing_unsaid() {
    Operation {
        name: "write to a flat part",
        rig: |folder| journalled(Rig::calibrated("bq34110", Seal::Sealed), folder),
        run: |rig| rig.write(FLAT, 0x41F5, "3100").map(drop),
    }
    .strike();
}

/// Its seal state is an answer like a block, and its blocks move on.
#[test]
pub(crate) fn a_wrong_bit_in_a_write_to_a_bq28z610_changes_nothing_unsaid() {
    Operation {
        name: "write to a bq28z610",
        rig: |folder| journalled(Rig::calibrated("bq28z610", Seal::Sealed), folder),
        run: |rig| rig.write(FLAT, 0x4202, "40").map(drop),
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_read_changes_nothing() {
    for found in [Seal::Sealed, Seal::Unsealed] {
        Operation {
            name: if found == Seal::Sealed { "read found sealed" } else { "read found unsealed" },
            rig: match found {
                Seal::Sealed => |folder| journalled(Rig::calibrated("bq34z100-g1", Seal::Sealed), folder),
                _ => |folder| journalled(Rig::calibrated("bq34z100-g1", Seal::Unsealed), folder),
            },
            run: |rig| {
                let value = rig.read(80, 53)?;
                assert_eq!(value, [0x0B, 0xB8]);
                Ok(())
            },
        }
        .strike();
    }
}

#[test]
pub(crate) fn regression_a_wrong_bit_while_a_write_is_settled_discarded_its_journal() {
    Operation {
        name: "settling",
        rig: |folder| {
            let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
            half_way(&mut rig, folder);
            rig
        },
        run: settle,
    }
    .strike();
    Operation {
        name: "settling RAM",
        rig: |folder| {
            let mut rig = Rig::calibrated("bq27441-g1", Seal::Sealed);
            let changes = [rig.change(82, 10, "1200"), rig.change(64, 0, "0x25f9")];
            cut(&mut rig, folder, &changes, programs);
            rig
        },
        run: settle,
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_decision_leaves_no_pack_open() {
    Operation {
        name: "discarding",
        rig: |folder| {
            let _ = std::fs::remove_file(folder.journal().path().with_extension("dismissed"));
            let mut rig = Rig::calibrated("bq27441-g1", Seal::Sealed);
            let change = [rig.change(82, 10, "1200")];
            cut(&mut rig, folder, &change, programs);
            rig
        },
        run: |rig| match rig.dataflash.owed() {
            None if rig.sim.get("seal").as_deref() == Some("sealed") => Ok(()),
            _ => rig.dataflash.decide(&mut rig.gauge, Decision::Discard, Duration::ZERO).map(drop),
        },
    }
    .strike();
}

#[test]
fn regression_a_wrong_bit_after_seal_left_a_pack_open() {
    for (name, rig, goal) in [
        (
            "to sealed",
            (|folder| journalled(Rig::found("bq34z100-g1", Seal::Unsealed), folder)) as fn(&Folder) -> Rig,
            Seal::Sealed,
        ),
        ("to unsealed", |folder| journalled(Rig::found("bq34z100-g1", Seal::Sealed), folder), Seal::Unsealed),
    ] {
        let run: fn(&mut Rig) -> Result<()> = match goal {
            Seal::Sealed => |rig| rig.dataflash.go_to(&mut rig.gauge, Seal::Sealed, Duration::ZERO),
            _ => |rig| rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO),
        };
        Operation { name, rig, run }.strike();
    }
    // SEALED is lost, and the look after it is wrong.
    let mut rig = Rig::found("bq34z100-g1", Seal::Unsealed);
    rig.sim.set("fault", "drop-seal; flip 3 2 5").expect("faults");
    rig.gauge.close().expect("it is sent again");
    assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
}

#[test]
pub(crate) fn a_wrong_bit_in_a_calibration_leaves_no_mode_on() {
    fn board(folder: &Folder) -> Rig {
        let rig = journalled(Rig::calibrated("bq34z100-g1", Seal::Sealed), folder);
        rig.sim.set("temperature_error", "35").expect("a knob");
        rig.clock.sleep(Duration::from_secs(2));
        rig
    }
    Operation {
        name: "leaving calibration mode",
        rig: |folder| {
            let mut rig = board(folder);
            rig.gauge.go_to(Seal::Unsealed).expect("the default key");
            for code in [0x002d, 0x0081] {
                rig.gauge.command(code).expect("the gauge answers");
            }
            rig.clock.sleep(Duration::from_secs(1));
            rig
        },
        run: |rig| {
            run(&mut rig.dataflash, &mut rig.gauge, &Job::Leave, Duration::ZERO, &mut |_| {}).map(drop)
        },
    }
    .strike();
}

#[test]
pub(crate) fn a_wrong_bit_in_a_change_of_keys_is_no_false_success() {
    Operation {
        name: "keys",
        rig: |folder| journalled(Rig::found("bq34z100-g1", Seal::Sealed), folder),
        run: |rig| {
            let change = KeyChange::parse(b"unseal 0414 3672 8d3e b7c5").expect("a change");
            rig.dataflash.change_key(&mut rig.gauge, &change, Order::LsbFirst, Duration::ZERO)
        },
    }
    .strike();
}

/// [VOK] and LearnedStatus() tell that a learning cycle runs, and a RESET would end it.
#[test]
fn regression_a_wrong_bit_let_a_reset_end_a_learning_cycle() {
    let start = || {
        let mut rig = Rig::new("bq34z100-g1");
        rig.send(&[0x0021, 0x0020]);
        rig.sim.clear_log();
        rig
    };
    let mut plain = start();
    assert_eq!(cause(&plain.write(80, 53, "3100").expect_err("a cycle runs")), "busy");
    for (at, record) in plain.sim.log().into_iter().enumerate() {
        for (byte, bit) in bits(at + 1, record.read.len()) {
            let fault = format!("flip {} {} {bit}", at + 1, record.write.len() + byte);
            let mut rig = start();
            let (flash, resets) = (rig.sim.flash(), rig.sim.get("resets"));
            rig.sim.set("fault", &fault).expect("a fault");
            rig.write(80, 53, "3100").expect_err(&fault);
            assert!(rig.sim.flash() == flash && rig.sim.get("resets") == resets, "{fault}");
        }
    }
}

/// A gauge that has lost its power before the write, and not since, still says so while it is in CONFIG UPDATE.
#[test]
fn regression_a_loss_of_power_before_a_write_discarded_its_journal() {
    let folder = Folder::new("flips-before");
    let mut rig = Rig::calibrated("bq27441-g1", Seal::Sealed);
    rig.power_cycle();
    rig.clock.sleep(Duration::from_secs(3));
    rig.calibrate(3);
    rig.gauge.go_to(Seal::Sealed).expect("it answers");
    let old = rig.sim.flash();
    let changes = [rig.change(82, 10, "1200"), rig.change(64, 0, "0x25f9")];
    cut(&mut rig, &folder, &changes, programs);
    assert!(rig.sim.flash() != old && rig.get("mode") != "normal");
    let told = settle(&mut rig);
    assert_eq!(told, Ok(()));
    assert!(rig.sim.flash() == old, "the old values are back");
    assert_eq!((rig.get("mode").as_str(), rig.get("seal").as_str()), ("normal", "sealed"));
    assert_eq!(folder.files(), Vec::<String>::new());
}

/// It is left although nothing is written until a person decides.
#[test]
fn regression_a_write_that_waits_for_a_decision_left_config_update_on() {
    let folder = Folder::new("flips-undecided");
    let mut rig = Rig::found("bq27441-g1", Seal::Sealed);
    let changes = [rig.change(82, 10, "1200"), rig.change(64, 0, "0x25f9")];
    cut(&mut rig, &folder, &changes, programs);
    assert_ne!(rig.get("mode"), "normal");
    let error = settle(&mut rig).expect_err("the pack may be another one");
    assert_eq!(cause(&error), "busy", "{error}");
    assert_eq!((rig.get("mode").as_str(), rig.get("seal").as_str()), ("normal", "sealed"));
    assert!(rig.dataflash.owed().is_some_and(|owed| owed.needs_decision));
}

/// What a command leads to may show late, and a look in between shows the state before it.
#[test]
fn regression_a_seal_that_shows_late_was_taken_for_an_open_gauge() {
    let mut rig = Rig::found("bq34z100-g1", Seal::Unsealed);
    rig.sim.set("status_ms", "200").expect("a knob");
    // The seal is sent, and whoever has sent it is given up before the gauge shows it.
    rig.sim.set("fault", "silence 2 60").expect("a fault");
    rig.gauge.limit(Some(Duration::from_millis(40)));
    rig.gauge.close().expect_err("there is no time");
    rig.gauge.limit(None);
    assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
    assert_eq!(rig.seal(), Seal::Sealed);
}

/// A key that has not opened the gauge is not proven by a look with a wrong bit.
#[test]
fn a_wrong_bit_does_not_prove_a_key() {
    let mut keys = Keys::default();
    keys.set(Name::Unseal, &[0x1234u16, 0x5678].into());
    let mut plain = Rig::with("bq34z100-g1", keys.clone(), Reach::FULL);
    plain.sim.clear_log();
    plain.read(80, 53).expect_err("the key is wrong");
    for (at, record) in plain.sim.log().into_iter().enumerate() {
        for (byte, bit) in bits(at + 1, record.read.len()) {
            let fault = format!("flip {} {} {bit}", at + 1, record.write.len() + byte);
            let mut rig = Rig::with("bq34z100-g1", keys.clone(), Reach::FULL);
            rig.sim.set("fault", &fault).expect("a fault");
            rig.read(80, 53).expect_err(&fault);
            assert!(!rig.gauge.key_is_proven(), "{fault}");
            assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"), "{fault}");
            // One that has worked would be tried for ever, as on a disturbed bus.
            let error = rig.read(80, 53).expect_err("the key is wrong");
            assert_eq!(cause(&error), "not-permitted", "{fault}: {error}");
        }
    }
}
