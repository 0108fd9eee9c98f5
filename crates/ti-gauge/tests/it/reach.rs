// SPDX-License-Identifier: MIT

//! Adapters that carry less than a whole transfer: what is cut, what is not, and what is read twice because of it. The
//! simulated adapter refuses what it does not carry, so a cut that is forgotten fails.

use std::time::Duration;

use gauge_bus::{BusError, Reach};
use ti_gauge::chip::{CHIPS, FLAT};
use ti_gauge::dataflash::{DataFlash, Outcome};
use ti_gauge::error::Cause;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

use crate::rig::{self, Rig, drawn_reach};
use crate::room::drawn;

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
            rig.write(at.0, at.1, "3100").expect_err("a word"),
        ] {
            assert_eq!(error.cause(), Cause::Bus(refused), "{chip}: {error}");
            assert!(error.to_string().contains("Control("), "{error}");
            assert!(error.to_string().contains("a message of 3 bytes, and the adapter carries 2"), "{error}");
        }
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

/// The block is filled in messages that the adapter carries, and committed by one.
#[test]
fn the_window_is_filled_in_several_messages() {
    let mut rig = rig_within("bq34z100-g1", Reach::of_data(2));
    let written = rig.write(48, 31, "Pack 7");
    assert!(matches!(written, Ok(Outcome::Written { .. })), "{written:?}");
    let sent = rig.log();
    let filled: Vec<_> =
        sent.iter().filter(|line| line.starts_with("W 4") || line.starts_with("W 5")).collect();
    let text = ["W 40 50 61", "W 42 63 6B", "W 44 20 37", "W 46 00 00", "W 48 00 00", "W 4A 00"];
    assert_eq!(filled[0], "W 5F 06");
    assert_eq!(filled[1..], text);
    assert_eq!(sent.iter().filter(|line| line.starts_with("W 60")).count(), 2, "two blocks");

    let mut rig = rig_within("bq34110", Reach::of_data(2));
    rig.write(FLAT, 0x4000, "0.5").expect("in two messages");
    let sent = rig.log();
    let at = sent.iter().position(|line| line.starts_with("W 40")).expect("it is filled");
    assert!(sent[at + 1].starts_with("W 42") && sent[at + 2].starts_with("W 60"), "{:?}", &sent[at..at + 3]);
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
        for reach in [Reach::FULL, Reach::of_data(3), Reach::of_data(2)] {
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

/// Runs a test that draws faults on an adapter that is drawn too. `GAUGEFS_SEED` repeats one.
fn on_drawn_adapters(name: &str, test: fn()) {
    drawn(&format!("adapters: {name}"), 6, |seed| {
        let reach =
            drawn_reach(name.bytes().fold(seed, |seed, byte| seed.wrapping_mul(31) + u64::from(byte)));
        println!("seed {seed}: {reach:?}");
        rig::set_reach(reach);
        test();
        Ok(vec![format!("{reach:?}")])
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
