// SPDX-License-Identifier: MIT

//! Adapters that carry less than a whole transfer: what is cut, what is not, and what is read twice because of it. The
//! simulated adapter refuses what it does not carry, so a cut that is forgotten fails.

use std::time::Duration;

use gauge_bus::{BusError, Reach};
use ti_gauge::chip::{CHIPS, FLAT};
use ti_gauge::dataflash::{DataFlash, Decision, Outcome};
use ti_gauge::error::{Cause, Reason};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

use crate::rig::{self, Adapter, Rig};
use crate::room::{Folder, drawn, half_way};

const WINDOW: usize = 32;

fn rig_within(chip: &str, reach: Reach) -> Rig {
    let rig = Rig::new(chip);
    rig.sim.set_reach(reach);
    rig.sim.clear_log();
    rig
}

/// A read ends where a register ends, whatever the adapter carries. Only a register that is longer is read in several
/// messages, and twice.
#[test]
fn a_register_is_never_cut() {
    for chip in CHIPS {
        for most in [2, 3, 4, 5, 7, 16, 31] {
            let mut rig = rig_within(chip.name, Reach::of_data(most));
            let mut whole = Registers::unread(chip.registers);
            whole.read(&mut rig.gauge, |_| true).expect("it answers");
            let mut short = 0;
            for record in rig.sim.log() {
                let ([code], length) = (&record.write[..], record.read.len()) else { continue };
                assert!(length <= most.into(), "{}, {most}: {record}", chip.name);
                let (start, end) = (usize::from(*code), usize::from(*code) + length);
                for row in chip.registers {
                    let Some(at) = row.source.command().map(usize::from) else { continue };
                    let size = usize::from(row.size);
                    let is_cut = |edge: usize| at < edge && edge < at + size;
                    let is_window = (0x3e..0x62).contains(&at);
                    if is_window || !(is_cut(start) || is_cut(end)) {
                        continue;
                    }
                    assert!(size > most.into(), "{}, {most}: {record} cuts {}", chip.name, row.name);
                    short += 1;
                }
            }
            assert_eq!(short > 0, most < 4 && chip.name == "bq35100", "{}, {most}", chip.name);
        }
    }
}

/// One byte is no word.
#[test]
fn an_adapter_that_reads_one_byte_is_refused() {
    let mut rig = rig_within("bq34z100-g1", Reach { read: 1, ..Reach::FULL });
    let error = rig.gauge.word(0x08).expect_err("one byte");
    assert_eq!(error.cause(), Cause::Bus(BusError::TooLong { bytes: 2, most: 1 }));
    assert_eq!(
        error.to_string(),
        "Voltage(): read: a message of 2 bytes, and the adapter carries 1 at most; connect the gauge to another one"
    );
    assert_eq!(rig.log(), Vec::<String>::new());
}

/// What must not happen twice, or not in part, has one message or none.
#[test]
fn what_must_not_happen_twice_is_never_cut() {
    for (chip, at) in [("bq34z100-g1", (80, 53)), ("bq34110", (FLAT, 0x41F5))] {
        let mut rig = rig_within(chip, Reach { write: 2, ..Reach::FULL });
        let seal = rig.gauge.chip.security.seal;
        let refused = BusError::TooLong { bytes: 3, most: 2 };
        assert_eq!(rig.gauge.write_once(0x60, &[0x5a, 0x24]), Err(refused), "{chip}");
        assert_eq!(rig.gauge.write_once(0x3e, &[0x30, 0x00]), Err(refused), "{chip}");
        for error in [
            rig.gauge.command(seal).expect_err("a word"),
            rig.gauge.command_once(0x0041).expect_err("a word"),
            rig.gauge.close().expect_err("a word"),
            rig.gauge.identify().map(drop).expect_err("a word"),
        ] {
            assert_eq!(error.cause(), Cause::Bus(refused), "{chip}: {error}");
            assert!(error.to_string().contains("Control("), "{error}");
            assert!(error.to_string().contains("a message of 3 bytes, and the adapter carries 2"), "{error}");
        }
        assert_eq!(
            rig.write(at.0, at.1, "3100").map_err(|error| error.cause()),
            Err(Cause::ReadOnly),
            "{chip}"
        );
        assert_eq!(rig.log(), Vec::<String>::new(), "{chip}");
    }
}

/// Where a manual says that the gauge takes single bytes.
#[test]
fn a_gauge_that_takes_single_bytes_is_written_on_an_adapter_that_carries_no_more() {
    for (chip, at) in [("bq27441-g1", (82, 10)), ("bq27520-g3", (48, 10)), ("bq27220", (FLAT, 0x929F))] {
        let mut rig = rig_within(chip, Reach { write: 2, ..Reach::FULL });
        rig.write(at.0, at.1, "1200").expect("byte by byte");
        assert_eq!(rig.read(at.0, at.1), Ok(vec![0x04, 0xb0]), "{chip}");
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
    }
}

/// The messages that fill the window, and those that commit it.
fn filled(rig: &Rig) -> (Vec<String>, usize) {
    let sent = rig.log();
    let begins = |line: &&String, starts: &[&str]| starts.iter().any(|start| line.starts_with(start));
    let commits = sent.iter().filter(|line| begins(line, &["W 60"])).count();
    (sent.iter().filter(|line| begins(line, &["W 4", "W 5"])).cloned().collect(), commits)
}

/// Changes each byte of Manufacturer Info, which is a block.
fn write_block(rig: &mut Rig, subclass: u8) -> ti_gauge::error::Result<Outcome> {
    let change = |at| Rig::change_of(rig.gauge.chip, subclass, at, &format!("0x{:02x}", at + 1));
    let changes: Vec<_> = (0..32).map(change).collect();
    rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO)
}

/// Where a manual says that the gauge takes single bytes, or a user, the block is filled in messages that the adapter carries,
/// and committed by one.
#[test]
fn the_window_is_filled_in_several_messages() {
    let mut rig = rig_within("bq27520-g3", Reach::smbus(2, false));
    write_block(&mut rig, 57).expect("by the manual");
    let (sent, commits) = filled(&rig);
    assert_eq!((sent.len(), &*sent[0], &*sent[15], commits), (16, "W 40 01 02", "W 5E 1F 20", 1));

    let takes = Reach::ONE_BYTE_A_WRITE;
    let mut rig = Rig::with("bq34z100-g1", Keys::default(), takes);
    rig.sim.set_reach(Reach::smbus(2, false));
    rig.sim.clear_log();
    rig.write(48, 31, "Pack 7").expect("with --byte-writes");
    let (sent, commits) = filled(&rig);
    assert_eq!(sent[..3], ["W 5F 06", "W 40 50", "W 41 61"]);
    assert_eq!(commits, 2, "two blocks");
}

/// A block of data flash, its register and no more: i801 and i2c-stub carry that, and nothing is cut.
#[test]
fn a_block_and_its_register_fit_exactly_into_a_command() {
    let mut rig = rig_within("bq34z100-g1", Reach::smbus(32, true));
    write_block(&mut rig, 58).expect("one message");
    let bytes: String = (1..=32).map(|byte| format!(" {byte:02X}")).collect();
    assert_eq!(filled(&rig), (vec![format!("W 40{bytes}")], 1));
    let mut rig = rig_within("bq34110", Reach::smbus(32, true));
    rig.write(FLAT, 0x41F5, "3100").expect("it is written");
    let (sent, commits) = filled(&rig);
    assert_eq!((&*sent[0], commits), ("W 40 0C 1C", 1));
    rig.gauge.write(0x40, &[0x5a; WINDOW]).expect("one message");
}

/// A host with words alone, such as piix4. What a row may have to be put back is a whole block, so a change of two bytes is
/// refused as well.
#[test]
fn data_flash_that_cannot_be_written_as_a_whole_is_only_read() {
    for (chip, at) in [("bq34z100-g1", (80, 53)), ("bq34z100-r2", (80, 53)), ("bq34110", (FLAT, 0x41F5))] {
        for reach in [Reach::smbus(2, false), Reach::of_data(31)] {
            let mut rig = rig_within(chip, reach);
            let before = rig.read(at.0, at.1).expect("it is read");
            rig.sim.clear_log();
            let error = rig.write(at.0, at.1, "3100").expect_err("it is refused");
            assert_eq!((error.cause(), error.errno()), (Cause::ReadOnly, 30), "{chip}: {error}");
            let says =
                format!("data flash can only be read: the adapter carries writes of {} bytes", reach.write);
            assert!(error.to_string().contains(&says), "{error}");
            assert_eq!(rig.log(), Vec::<String>::new(), "{chip}: nothing was sent");
            assert_eq!(rig.read(at.0, at.1), Ok(before), "{chip}");
            assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        }
    }
}

/// An interrupted write waits for an adapter that can finish or undo it, however often it is tried without one.
#[test]
fn what_cannot_be_put_back_on_an_adapter_waits_for_another_one() {
    let folder = Folder::new("words");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    let (torn, journal) = (rig.sim.flash(), folder.text());
    assert!(torn != old && journal.is_some());
    rig.sim.set_reach(Reach::smbus(2, false));
    rig.start(&folder);
    let programmed = rig.get("programmed");
    for _ in 0..5 {
        for error in [
            rig.arrive().expect_err("a block is too long"),
            rig.dataflash
                .decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO)
                .expect_err("a person changes nothing about that"),
        ] {
            assert!(matches!(error.reason(), Reason::ShortWrites { .. }), "{error}");
            let text = error.to_string();
            assert!(
                text.contains("was interrupted") && text.contains("connect it to another adapter"),
                "{text}"
            );
        }
        let owed = rig.dataflash.owed().expect("it is owed");
        assert!(!owed.needs_decision, "{}", owed.why);
        assert!(rig.sim.flash() == torn && rig.get("programmed") == programmed);
        assert_eq!((folder.text(), rig.seal()), (journal.clone(), Seal::Sealed));
    }
    rig.sim.set_reach(Reach::FULL);
    rig.start(&folder);
    assert!(rig.arrive().expect("nothing is in the way").is_some());
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// What is owed and needs no block to be written is settled there as well.
#[test]
fn what_is_as_it_was_is_settled_on_any_adapter() {
    let folder = Folder::new("whole");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    rig.sim.set_flash(48, 11, &1000_u16.to_be_bytes());
    assert!(rig.sim.flash() == old);
    rig.sim.set_reach(Reach::smbus(2, false));
    rig.start(&folder);
    assert!(rig.arrive().expect("nothing is written").is_some());
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// The sum of a block is that of its bytes in any order, so a message that was read two bytes too early is not noticed by it.
#[test]
fn a_piece_that_was_read_from_elsewhere_is_not_believed() {
    let mut block: [u8; WINDOW] = std::array::from_fn(|at| at as u8 * 5 + 1);
    // What a reading of 12 to 27 in place of 14 to 29 leaves out is the sum of what it has twice.
    (block[28], block[29]) = (block[13], block[12]);
    let start = || {
        let mut rig = rig_within("bq34z100-g1", Reach::of_data(16));
        rig.sim.set_flash(58, 0, &block);
        rig.gauge.go_to(Seal::Unsealed).expect("the default key");
        rig.dataflash = DataFlash::default();
        rig.sim.clear_log();
        rig
    };
    let row = CHIPS[0].subclasses.iter().find(|row| row.id == 58).expect("a subclass");
    let read = |rig: &mut Rig| rig.dataflash.read(&mut rig.gauge, &[row], Duration::ZERO);
    let mut plain = start();
    assert_eq!(read(&mut plain), Ok(vec![block.to_vec()]));
    let log = plain.sim.log();
    let pieces = (1..).zip(&log).filter(|(_, record)| record.read.len() == 16);
    let (mut struck, mut moved) = (0, 0);
    for (number, record) in pieces {
        for bit in 0..8 {
            let mut rig = start();
            rig.sim.set("fault", &format!("flip {number} 0 {bit}")).expect("a fault");
            let seen = read(&mut rig);
            assert!(seen.is_err() || seen == Ok(vec![block.to_vec()]), "{record}, bit {bit}: {seen:?}");
            struck += 1;
            moved += u32::from(record.write == [0x4e] && bit == 1);
        }
    }
    assert!(struck > 0 && moved > 0, "{log:?}");
}

/// A bus that never shows the same twice.
struct Restless(u8);

impl gauge_bus::Bus for Restless {
    fn transfer(&mut self, _: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.0 = self.0.wrapping_add(1);
        read.fill(self.0);
        Ok(())
    }

    fn reach(&mut self) -> Reach {
        Reach::of_data(16)
    }
}

#[test]
fn a_window_that_never_reads_the_same_is_an_error() {
    let mut gauge =
        Gauge::new(CHIPS[0], Box::new(Restless(0)), Rig::new("bq34z100-g1").clock, Keys::default());
    let error = gauge.read(0x3e, &mut [0; 36]).expect_err("it differs");
    assert_eq!(error.cause(), Cause::Bus(BusError::Unsteady));
    // What is measured changes, and is not compared.
    gauge.read(0x08, &mut [0; 36]).expect("registers");
    gauge.read(0x3e, &mut [0; 16]).expect("one message");
}

/// A gauge that stores a row of its own whenever it may, and answers meanwhile as before it: a commit may wait for such a
/// row, and is shown as long after it was acknowledged as both take.
#[test]
fn a_commit_that_waits_for_rows_of_the_gauges_own_is_not_taken_for_none() {
    for (chip, at, length) in [("bq34z100-r2", (80, 53), 2), ("bq34110", (FLAT, 0x41F5), 2)] {
        for read in [u16::MAX, 3, 2] {
            let reach = Reach { read, ..Reach::FULL };
            for every in ["1", "7", "20", "50"] {
                let mut rig = rig_within(chip, reach);
                for (knob, text) in [("commit_ms", "218"), ("commit_busy", "old"), ("rewrite_every", every)] {
                    rig.set(knob, text);
                }
                let outcome = rig.write(at.0, at.1, "3100");
                rig.set("rewrite_every", "0");
                rig.pause(5);
                let about = format!("{chip}, {reach:?}, a row at each transfer of {every}");
                let stored = rig.read(at.0, at.1).expect("it answers");
                assert_eq!(
                    (stored.len(), stored == [0x0c, 0x1c]),
                    (length, outcome.is_ok()),
                    "{about}: {outcome:?}"
                );
                assert!(outcome.is_ok(), "{about}: {outcome:?}");
            }
        }
    }
}

/// A bridge gives up when the gauge holds the clock for longer than it waits, and nothing of the write, its register or all of
/// it has arrived: what may happen twice is sent again, and no block is stored twice.
#[test]
fn a_bridge_that_gives_up_on_the_clock_stores_each_block_once() {
    for name in ["mcp2221", "cp2112", "i801"] {
        // As many transfers as it gives up before, which sets how much arrives.
        let start = |given_up| {
            let rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
            Adapter::of(name).lead_to(&rig.sim, rig.gauge.chip);
            for _ in 0..given_up {
                rig.sim.set("fault", "stretch 1 30").expect("a fault");
                gauge_bus::Bus::transfer(&mut rig.sim.bus(), &[0x08], &mut [0; 2]).expect_err("it gives up");
            }
            rig
        };
        let stored = |rig: &Rig| rig.sim.get("programmed");
        let mut plain = start(0);
        let before = plain.cost().0;
        plain.write(80, 53, "3100").expect("it waits for the gauge");
        let transfers = plain.cost().0 - before;
        let mut refused = 0;
        for (given_up, at) in (0..3).flat_map(|given_up| (1..=transfers).map(move |at| (given_up, at))) {
            let mut rig = start(given_up);
            let old = rig.sim.flash();
            rig.sim.set("fault", &format!("stretch {at} 30")).expect("a fault");
            let about = format!("{name}, transfer {at} given up after {given_up}");
            if let Err(error) = rig.write(80, 53, "3100") {
                // Between the key and the first block: nothing was written, and it may be tried again.
                assert_eq!(
                    (error.cause(), rig.sim.flash() == old),
                    (Cause::NotNow, true),
                    "{about}: {error}"
                );
                rig.write(80, 53, "3100").unwrap_or_else(|error| panic!("{about}: {error}"));
                refused += 1;
            }
            assert!(rig.sim.flash() == plain.sim.flash(), "{about}");
            assert_eq!(stored(&rig), stored(&plain), "{about}");
        }
        assert!(refused < transfers / 2, "{name}: {refused} of three times {transfers}");
    }
}

/// Runs a test that draws faults on an adapter that is drawn too. `GAUGEFS_SEED` repeats one.
fn on_drawn_adapters(name: &str, test: fn()) {
    drawn(&format!("adapters: {name}"), 6, |seed| {
        let adapter =
            Adapter::drawn(name.bytes().fold(seed, |seed, byte| seed.wrapping_mul(31) + u64::from(byte)));
        println!("seed {seed}: {adapter}");
        rig::set_adapter(adapter);
        test();
        Ok(vec![adapter.to_string()])
    });
}

macro_rules! on_drawn_adapters {
    ($($module:ident: $($test:ident),*;)*) => {
        $(mod $module {
            $(#[test]
            fn $test() {
                super::on_drawn_adapters(stringify!($test), crate::$module::$test);
            })*
        })*
    };
}

on_drawn_adapters! {
    faults:
        a_fault_at_any_transfer_of_a_write_causes_no_false_success,
        a_challenge_is_answered_by_slow_and_by_fast_gauges,
        a_fault_at_any_transfer_of_a_challenge_causes_no_false_answer;
    flips:
        a_wrong_bit_in_a_write_changes_nothing_unsaid,
        a_wrong_bit_in_a_write_to_an_open_gauge_changes_nothing_unsaid,
        a_wrong_bit_in_a_write_without_a_reset_changes_nothing_unsaid,
        a_wrong_bit_in_a_write_to_ram_changes_nothing_unsaid,
        a_wrong_bit_in_a_write_to_a_flat_part_changes_nothing_unsaid,
        a_wrong_bit_in_a_read_changes_nothing,
        regression_a_wrong_bit_while_a_write_is_settled_discarded_its_journal,
        a_wrong_bit_in_a_decision_leaves_no_pack_open,
        a_wrong_bit_in_a_calibration_leaves_no_mode_on,
        a_wrong_bit_in_a_change_of_keys_is_no_false_success;
    keychange:
        a_fault_at_any_transfer_of_a_key_change_causes_no_false_success;
    journal:
        host_power_loss_at_any_transfer_leaves_old_or_new_values;
    power:
        a_host_power_cut_that_loses_what_was_not_synced_leaves_old_or_new_values;
    restore:
        a_fault_at_any_transfer_of_a_restore_causes_no_false_success;
    recovery:
        a_host_that_pauses_at_any_transfer_leaves_nothing_half_way,
        a_second_power_cut_while_settling_leaves_old_or_new_values;
    calibration:
        a_fault_at_any_transfer_of_a_calibration_causes_no_false_success;
}
