// SPDX-License-Identifier: MIT

//! Write transactions on simulated gauges: the bytes on the wire, the number of transfers, and the refusals.

use std::time::Duration;

use gauge_bus::Reach;
use gauge_bus::clock::Clock;
use ti_gauge::chip::{FLAT, Kind};
use ti_gauge::dataflash::Outcome;
use ti_gauge::error::Cause;
use ti_gauge::gauge::Seal;
use ti_gauge::keys::{Keys, Name};

use crate::rig::{Rig, another, cause};

const WRITTEN: Outcome = Outcome::Written { reset: true, old: Vec::new() };
const STORED: Outcome = Outcome::Written { reset: false, old: Vec::new() };

fn spent(rig: &mut Rig, run: impl FnOnce(&mut Rig)) -> (u64, u64) {
    let before = rig.cost();
    run(rig);
    let after = rig.cost();
    (after.0 - before.0, after.1 - before.1)
}

#[test]
fn a_value_is_stored_and_the_gauge_is_sealed_again() {
    let mut rig = Rig::new("bq34z100-g1");
    assert_eq!(rig.seal(), Seal::Sealed);
    assert_eq!(rig.read(80, 53), Ok(vec![0x0b, 0xb8]));
    assert_eq!(rig.write(80, 53, "3100"), Ok(WRITTEN));
    assert_eq!(rig.seal(), Seal::Sealed);
    assert_eq!(rig.read(80, 53), Ok(vec![0x0c, 0x1c]));
    // A power cycle shows that the value is in flash, and not only in the window's buffer.
    rig.sim.set("power", "off").expect("a knob");
    rig.sim.set("power", "on").expect("a knob");
    gauge_bus::clock::Clock::sleep(&*rig.clock, Duration::from_secs(1));
    assert_eq!(rig.read(80, 53), Ok(vec![0x0c, 0x1c]));
}

/// SLUSBZ5D 7.3.3.1 with byte-wise writes: the order and the bytes of the manual's own example, VOLTSEL.
#[test]
fn the_bytes_on_the_wire_match_the_manuals_example() {
    let mut rig = Rig::with("bq34z100-g1", Keys::default(), Reach::ONE_BYTE_A_WRITE);
    // The pin of an external divider, and a limit with which the bit leaves flash open.
    assert_eq!(rig.write(68, 0, "0"), Ok(WRITTEN));
    rig.sim.set("voltage_mv", "850").expect("a knob");
    let rows = rig.gauge.chip.subclasses.iter().filter(|row| [68, 104].contains(&row.id)).collect::<Vec<_>>();
    let read = rig.dataflash.read(&mut rig.gauge, &rows, Duration::ZERO);
    read.expect("the gate and the calibration are known from here on");
    rig.sim.clear_log();
    assert_eq!(rig.write(64, 0, "0x0961"), Ok(WRITTEN));
    let sent: Vec<_> = rig.log().into_iter().filter(|line| line.starts_with('W')).collect();
    assert_eq!(
        sent,
        [
            "W 00 02 00", // FW_VERSION
            "W 00 00 00", // CONTROL_STATUS: sealed
            "W 00 00 00", // and after the key words, which are hidden
            "W 61 00",
            "W 3E 40",
            "W 3F 00", // step 2 to 4
            "W 40 09",
            "W 60 65", // step 8 and 9, checksum as derived
            "W 3E 68",
            "W 3F 00", // another block, so that what is read back is not what was sent
            "W 3E 40",
            "W 3F 00",    // read back
            "W 00 41 00", // step 10
            "W 00 00 00", // sealed, so it was reset
            "W 00 00 00",
            "W 61 00",
            "W 3E 40",
            "W 3F 00",    // verified after the reset
            "W 00 20 00", // step 11
            "W 00 00 00",
            "W 00 00 00", // two looks
        ]
    );
    let hidden = rig.log().iter().filter(|line| *line == "; hidden").count();
    assert_eq!(hidden, 4, "two key words before the write, two after the reset");
}

#[test]
fn a_write_needs_no_more_transfers_than_documented() {
    let mut rig = Rig::new("bq34z100-g1");
    let (transfers, bytes) = spent(&mut rig, |rig| assert_eq!(rig.write(80, 53, "3100"), Ok(WRITTEN)));
    println!("found SEALED: {transfers} transfers, {bytes} bytes");
    assert!(transfers <= 46 && bytes <= 570, "found SEALED: {transfers} transfers, {bytes} bytes");
    rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO).expect("the default key");
    let (transfers, bytes) = spent(&mut rig, |rig| assert_eq!(rig.write(80, 53, "3200"), Ok(WRITTEN)));
    println!("found UNSEALED: {transfers} transfers, {bytes} bytes");
    assert!(transfers <= 32 && bytes <= 400, "found UNSEALED: {transfers} transfers, {bytes} bytes");
    assert_eq!(rig.seal(), Seal::Unsealed);
}

#[test]
fn an_unchanged_value_is_not_programmed() {
    let mut rig = Rig::new("bq34z100-g1");
    let before = rig.sim.get("wear");
    assert_eq!(rig.write(80, 53, "3000"), Ok(Outcome::Unchanged));
    assert_eq!(rig.sim.get("wear"), before);
    assert_eq!(rig.seal(), Seal::Sealed);
}

#[test]
fn a_class_that_is_only_stored_needs_no_reset() {
    let mut rig = Rig::new("bq34z100-g1");
    assert_eq!(rig.write(58, 3, "0x5a"), Ok(Outcome::Written { reset: false, old: Vec::new() }));
    assert_eq!(rig.read(58, 3), Ok(vec![0x5a]));
}

/// Device Name spans two blocks: both are programmed, with one reset.
#[test]
fn a_string_across_two_blocks_programs_both() {
    let mut rig = Rig::new("bq34z100-g1");
    assert_eq!(rig.write(48, 31, "My Pack"), Ok(WRITTEN));
    assert_eq!(rig.read(48, 31), Ok(b"\x07My Pack\0\0\0\0".to_vec()));
    assert_eq!(rig.read(48, 43), Ok(b"\x0bTexas Inst.".to_vec()));
}

/// What is after the end of a string, and a length that is larger than the field, are no part of the value. SLUA790
/// section 2.4 pads a new string with zeros.
#[test]
fn a_string_is_written_only_if_it_has_another_value() {
    for (stored, text, other) in [
        (b"\x04LIONjunk\0\x01\xff", "LION", "LIO"),
        (b"\xffbq34z100-G1", "bq34z100-G1", "BQ34Z100-G1"),
        (b"\x0c           ", "%20         %20", "          "),
        (b"\0bq34z100-G1", "", "%00"),
        (b"\x04AT&T (4S)\0\0", "AT%26T", "AT%26T%20"),
    ] {
        let mut rig = Rig::new("bq34z100-g1");
        rig.sim.set_flash(48, 31, stored);
        let programmed = rig.sim.get("programmed");
        assert_eq!(rig.write(48, 31, text), Ok(Outcome::Unchanged), "{text}");
        assert_eq!(rig.read(48, 31), Ok(stored.to_vec()), "{text}");
        assert_eq!(rig.sim.get("programmed"), programmed, "{text}");
        // Beside another change, in either order, and where an earlier change gives it another value.
        let changes =
            [(48, 31, other), (48, 55, "PbA"), (48, 31, text)].map(|(id, at, text)| rig.change(id, at, text));
        let outcome = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
        assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{outcome:?}");
        assert_eq!(rig.read(48, 31), Ok(stored.to_vec()), "{text}");
        assert_eq!(rig.read(48, 55), Ok(b"\x03PbA\0".to_vec()));
        let changes = [(48, 31, text), (48, 31, other)].map(|(id, at, text)| rig.change(id, at, text));
        let outcome = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
        assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{outcome:?}");
        assert_eq!(rig.read(48, 31), Ok(changes[1].bytes().to_vec()), "{other}");
    }
}

/// In the order of the changes, those that were not programmed included.
#[test]
fn a_write_reports_the_bytes_that_it_replaced() {
    let mut rig = Rig::new("bq34z100-g1");
    let changes = [(80, 53, "3100"), (58, 3, "0x5a"), (80, 53, "3200"), (48, 31, "My Pack")];
    let changes = changes.map(|(subclass, offset, text)| rig.change(subclass, offset, text));
    let old =
        [(80, 53), (58, 3), (80, 53), (48, 31)].map(|(id, offset)| rig.read(id, offset).expect("a read"));
    let outcome = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
    assert_eq!(outcome, Ok(Outcome::Written { reset: true, old: old.to_vec() }));
    assert_eq!(old[0], 3000_u16.to_be_bytes());
}

/// Every refusal leaves data flash unchanged and the gauge sealed.
#[test]
fn refusals_change_nothing() {
    type Set = fn(&mut Rig);
    let low: Set = |rig| rig.sim.set("voltage_mv", "2700").expect("a knob");
    let nothing: Set = |_| {};
    for (expected, prepare, at, text) in [
        ("not-now", low, (80, 53), "3100"),
        ("out-of-range", nothing, (104, 14), "0"),
        ("out-of-range", nothing, (64, 7), "0"),
        ("out-of-range", nothing, (68, 0), "4200"),
        ("out-of-range", nothing, (64, 0), "0x1161"),
        ("not-permitted", nothing, (112, 0), "0x12345678"),
    ] {
        let mut rig = Rig::new("bq34z100-g1");
        prepare(&mut rig);
        let before = rig.sim.flash();
        let error = rig.write(at.0, at.1, text).expect_err(text);
        assert_eq!(cause(&error), expected, "{at:?} {text}: {error}");
        assert!(rig.sim.flash() == before, "{at:?} {text}: data flash changed");
        assert_eq!(rig.seal(), Seal::Sealed, "{at:?} {text}");
    }
}

/// What proves the layout of data flash can only be written so that it still does.
#[test]
fn no_write_locks_its_owner_out() {
    for (chip, at, [low, high], [least, greatest]) in [
        ("bq27500", (34, 2), ["2999", "4601"], ["3000", "4600"]),
        ("bq27500-v130", (80, 48), ["1999", "4201"], ["2000", "4200"]),
        ("bq27520-g3", (80, 45), ["1999", "4201"], ["2000", "4200"]),
    ] {
        let mut rig = Rig::new(chip);
        let before = rig.sim.flash();
        for (text, says) in [(low, format!("is below {least}")), (high, format!("is above {greatest}"))] {
            let error = rig.write(at.0, at.1, text).expect_err(text);
            assert_eq!(cause(&error), "out-of-range", "{chip}: {error}");
            assert!(error.to_string().contains(&says), "{chip}: {error}");
            assert!(rig.sim.flash() == before, "{chip} {text}: data flash changed");
        }
        for text in [greatest, least] {
            rig.write(at.0, at.1, text).unwrap_or_else(|error| panic!("{chip} {text}: {error}"));
        }
        let mut again = Rig::on(rig.gauge.chip, rig.sim.clone(), rig.clock.clone());
        again.write(48, 10, "1234").unwrap_or_else(|error| panic!("{chip}: {error}"));
    }
}

#[test]
fn without_a_key_a_sealed_gauge_stays_sealed() {
    let none = Keys::none();
    let wrong = Keys::of(Name::Unseal, &[0x1234, 0x5678].into());
    for keys in [none, wrong] {
        let mut rig = Rig::with("bq34z100-g1", keys, Reach::FULL);
        let before = rig.sim.flash();
        for _ in 0..3 {
            assert_eq!(cause(&rig.write(80, 53, "3100").expect_err("no key")), "not-permitted");
            assert_eq!(cause(&rig.read(80, 53).expect_err("no key")), "not-permitted");
        }
        assert!(rig.sim.flash() == before);
        let tries = rig.log().iter().filter(|line| *line == "; hidden").count();
        assert!(tries <= 4, "a refused key went out {tries} words");
    }
}

/// A value that is acknowledged but not stored, one that is stored wrongly, and a damaged checksum: each is
/// detected, and the old value is put back.
#[test]
fn a_value_that_was_not_stored_is_detected() {
    for (fault, says) in [("drop-commit", "stored nothing"), ("corrupt-commit", "wrote 0x")] {
        let mut rig = Rig::new("bq34z100-g1");
        let before = rig.sim.flash();
        rig.sim.set("fault", fault).expect("a fault");
        let error = rig.write(80, 53, "3100").expect_err(fault);
        assert_eq!(cause(&error), "rolled-back", "{fault}: {error}");
        assert!(matches!(error.cause(), Cause::RolledBack));
        assert!(error.to_string().contains(says), "{fault}: {error}");
        assert!(rig.sim.flash() == before, "{fault}: {error}");
        assert_eq!(rig.seal(), Seal::Sealed, "{fault}");
    }
}

/// Design Capacity of each chip is stored at its own address, the gauge is sealed again, and no mode is left
/// on.
#[test]
fn design_capacity_can_be_written_on_every_part() {
    for (chip, at, text) in [
        ("bq34z100-r2", (48, 11), "1200"),
        ("bq27520-g3", (48, 10), "1200"),
        ("bq27500", (48, 10), "1200"),
        ("bq27500-v130", (48, 10), "1200"),
        ("bq27441-g1", (82, 10), "1200"),
        ("bq27421-g1", (82, 10), "1200"),
        ("bq27426", (82, 6), "1200"),
        ("bq27427", (82, 6), "1200"),
        ("bq27621-g1", (82, 3), "1200"),
    ] {
        let mut rig = Rig::new(chip);
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        let begun = rig.clock.now();
        assert_eq!(rig.write(at.0, at.1, text), Ok(WRITTEN), "{chip}");
        let took = rig.clock.now() - begun;
        assert!(took < Duration::from_secs(12), "{chip}: {took:?}");
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{chip}");
        assert_eq!(rig.read(at.0, at.1), Ok(vec![0x04, 0xb0]), "{chip}");
        assert_eq!(rig.write(at.0, at.1, text), Ok(Outcome::Unchanged), "{chip}");
    }
}

/// SLUA790 section 3 through the engine: the bytes that set Operation Config A to the end-of-service mode.
#[test]
fn on_a_flat_part_the_bytes_match_slua790() {
    let mut rig = Rig::new("bq35100");
    assert_eq!(rig.read(FLAT, 0x41B1), Ok(vec![0x80]));
    rig.sim.clear_log();
    assert_eq!(rig.write(FLAT, 0x41B1, "0x82"), Ok(STORED));
    let sent = rig.log();
    let at = sent.iter().position(|line| line == "W 40 82").expect("the new byte");
    assert_eq!(sent[at - 1..=at + 1], ["W 3E B1 41", "W 40 82", "W 60 8B 05"]);
    assert_eq!(rig.seal(), Seal::Sealed);
    assert_eq!(rig.read(FLAT, 0x41B1), Ok(vec![0x82]));
}

/// Byte by byte, too, the checksum is written before the length.
#[test]
fn a_flat_part_can_be_written_byte_by_byte() {
    let mut rig = Rig::with("bq34110", Keys::default(), Reach::ONE_BYTE_A_WRITE);
    assert_eq!(rig.write(FLAT, 0x41F5, "6000"), Ok(STORED));
    let sent = rig.log();
    let at = sent.iter().position(|line| line == "W 40 17").expect("the first new byte");
    assert_eq!(sent[at - 2..at + 4], ["W 3E F5", "W 3F 41", "W 40 17", "W 41 70", "W 60 42", "W 61 06"]);
    assert_eq!(rig.seal(), Seal::Sealed);
}

#[test]
fn flat_parts_store_refuse_and_seal() {
    for (chip, at, text, bytes, gate) in [
        ("bq34110", 0x41F5, "6000", vec![0x17, 0x70], 0x4157),
        ("bq34110", 0x4000, "0.5", vec![0x80, 0x00, 0x00, 0x00], 0x4157),
        ("bq35100", 0x41FE, "6000", vec![0x17, 0x70], 0x41B6),
        ("bq35100", 0x425E, "130", vec![0x00, 0x82], 0x41B6),
    ] {
        let mut rig = Rig::new(chip);
        let before = rig.sim.flash();
        rig.sim.set("voltage_mv", "2799").expect("a knob");
        let error = rig.write(FLAT, at, text).expect_err("below the gate");
        assert_eq!(cause(&error), "not-now", "{chip}: {error}");
        assert!(rig.sim.flash() == before);
        rig.sim.set("voltage_mv", "3500").expect("a knob");
        let error = rig.write(FLAT, gate, "3600").expect_err("above the voltage");
        assert_eq!(cause(&error), "out-of-range", "{chip}: {error}");
        assert_eq!(rig.write(FLAT, at, text), Ok(STORED), "{chip}");
        assert_eq!(rig.write(FLAT, at, text), Ok(Outcome::Unchanged), "{chip}");
        assert_eq!(rig.read(FLAT, at), Ok(bytes), "{chip}");
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        for fault in ["drop-commit", "corrupt-commit"] {
            rig.sim.set("fault", fault).expect("a fault");
            let before = rig.sim.flash();
            let error = rig.write(FLAT, gate, "2700").expect_err(fault);
            assert!(matches!(error.cause(), Cause::RolledBack), "{chip} {fault}: {error}");
            assert!(rig.sim.flash() == before, "{chip} {fault}: {error}");
        }
    }
}

/// A window that is ready late shows the previous block, or a blank one, with a valid checksum. These bytes
/// must not be written into the requested block.
#[test]
fn regression_a_block_that_is_ready_late_is_not_overwritten() {
    for chip in ["bq34z100-g1", "bq27520-g3", "bq27441-g1"] {
        for ready in ["0", "9", "10", "15", "20", "25", "30"] {
            for text in ["2200", "1500"] {
                let mut rig = Rig::new(chip);
                let at = if chip == "bq34z100-g1" {
                    (48, 11)
                } else if chip == "bq27520-g3" {
                    (48, 10)
                } else {
                    (82, 10)
                };
                let before = rig.sim.flash();
                let change = rig.change(at.0, at.1, text);
                rig.sim.set("load_ms", ready).expect("a knob");
                let outcome = rig.dataflash.write(&mut rig.gauge, &[change], Duration::ZERO);
                assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{chip} {ready} ms: {outcome:?}");
                let differ = before.iter().zip(rig.sim.flash()).filter(|(old, new)| **old != *new).count();
                assert!((1..=2).contains(&differ), "{chip} {ready} ms: {differ} bytes differ");
            }
        }
    }
}

/// On a part that loads a block slowly, bytes that are written too early are lost.
#[test]
fn a_write_waits_for_a_slow_flat_part() {
    for (chip, at) in [("bq34110", 0x41F5), ("bq35100", 0x41FE)] {
        for (load, ok) in [("4", true), ("200", false)] {
            let mut rig = Rig::new(chip);
            rig.sim.set("load_ms", load).expect("a knob");
            let outcome = rig.write(FLAT, at, "6000");
            assert_eq!(outcome == Ok(STORED), ok, "{chip} {load}: {outcome:?}");
        }
    }
}

/// A part whose data flash is one byte lower than documented, as owners have found, is not written.
#[test]
fn a_part_with_shifted_data_flash_is_not_written() {
    for (chip, at) in [("bq27220", 0x929F), ("bq34110", 0x41F5), ("bq35100", 0x41FE)] {
        let mut rig = Rig::new(chip);
        rig.sim.set("df_shift", "1").expect("a knob");
        let before = rig.sim.flash();
        let error = rig.write(FLAT, at, "6000").expect_err("another map");
        assert!(matches!(error.cause(), Cause::Gone), "{chip}: {error}");
        assert!(rig.sim.flash() == before);
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
    }
}

/// SLUUBD4A 6.1, whatever the gauge is found as: FULL ACCESS, ENTER_CFG_UPDATE, the new bytes, and
/// EXIT_CFG_UPDATE_REINIT. Afterwards it is as it was found.
#[test]
fn data_memory_behind_manufacturer_access_is_written_in_config_update() {
    for found in [Seal::Sealed, Seal::Unsealed, Seal::FullAccess] {
        let mut rig = Rig::found("bq27220", found);
        assert_eq!(rig.read(FLAT, 0x929F), Ok(vec![0x0B, 0xB8]));
        assert_eq!(rig.write(FLAT, 0x929F, "1200"), Ok(Outcome::Written { reset: true, old: Vec::new() }));
        assert_eq!(rig.read(FLAT, 0x929F), Ok(vec![0x04, 0xB0]));
        assert_eq!(rig.seal(), found);
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"));
        // StateOfHealth() follows the new value.
        let mut capacity = [0; 2];
        rig.gauge.read(0x3C, &mut capacity).expect("DesignCapacity()");
        assert_eq!(u16::from_le_bytes(capacity), 1200);
        assert_eq!(rig.write(FLAT, 0x929F, "1200"), Ok(Outcome::Unchanged));
    }
}

/// A gauge that does not accept the full-access key is left as it was found.
#[test]
fn data_memory_needs_the_full_access_key() {
    let keys = Keys::of(Name::FullAccess, &[0x1234, 0x5678].into());
    let mut rig = Rig::with("bq27220", keys, Reach::FULL);
    let before = rig.sim.flash();
    let error = rig.write(FLAT, 0x929F, "1200").expect_err("a wrong key");
    assert!(matches!(error.cause(), Cause::NotPermitted), "{error}");
    assert!(rig.sim.flash() == before);
    assert_eq!(rig.seal(), Seal::Sealed);
}

/// The names of the bq34z100-G1 are two bytes lower.
#[test]
fn firmware_2_02_on_the_data_flash_of_0_16_is_not_written() {
    let mut rig = Rig::new("bq34z100-r2");
    rig.sim.set_flash(48, 30, b"\x01\x0bbq34z100-G1\x0bTexas Inst.\x04LION\x00\x00");
    let before = rig.sim.flash();
    let error = rig.write(48, 11, "1200").expect_err("another map");
    assert!(matches!(error.cause(), Cause::Gone), "{error}");
    assert!(rig.sim.flash() == before);
    assert_eq!(rig.seal(), Seal::Sealed);
}

/// Their order is not known.
#[test]
fn the_scales_of_the_bq34z100_r2_are_written_with_consent_only() {
    let rig = Rig::new("bq34z100-r2");
    let (_, names) = rig.gauge.chip.row("48", "33").expect("the names follow");
    assert!(!names.unproven);
    for offset in ["30", "31", "32"] {
        let (_, scale) = rig.gauge.chip.row("48", offset).expect("a row");
        assert!(scale.unproven && scale.name.ends_with("Scale"));
    }
}

#[test]
fn flat_parts_go_to_full_access_and_back() {
    for chip in ["bq27220", "bq34110", "bq35100"] {
        let mut rig = Rig::new(chip);
        for goal in [Seal::FullAccess, Seal::Unsealed, Seal::Sealed, Seal::Unsealed, Seal::FullAccess] {
            rig.dataflash.go_to(&mut rig.gauge, goal, Duration::ZERO).expect("the default keys");
            assert_eq!(rig.seal(), goal, "{chip}");
        }
    }
}

/// Regression test: on a flat part, whose windows overlap, values in descending order failed to verify (EIO).
/// A golden image that changes every block, in any order of its values, is finished well within the 30 s after
/// which write(2) must return. Time is simulated, with the waits of each part.
#[test]
fn a_whole_image_is_written_within_30_s() {
    for chip in ti_gauge::chip::CHIPS.iter().filter(|chip| chip.is_proven()) {
        for reversed in [false, true] {
            let mut rig = Rig::new(chip.name);
            let mut changes = Vec::new();
            for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
                let bytes = rig.dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO);
                let bytes = bytes.expect("readable").remove(0);
                for parameter in subclass.parameters {
                    if parameter.safe.is_some() || parameter.learned || parameter.kind.bounds().is_none() {
                        continue;
                    }
                    let at = usize::from(parameter.offset - subclass.start());
                    changes.extend(another((subclass, parameter), &bytes[at..at + parameter.kind.size()]));
                }
            }
            if reversed {
                changes.reverse();
            }
            let begun = rig.clock.now();
            let written = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
            assert!(matches!(written, Ok(Outcome::Written { .. })), "{} {reversed}: {written:?}", chip.name);
            assert!(rig.clock.now() - begun < Duration::from_secs(12), "{}", chip.name);
            for change in &changes {
                let stored = rig.read(change.place().subclass, change.place().offset);
                assert_eq!(stored.as_ref(), Ok(&change.bytes().to_vec()), "{} {}", chip.name, change.name());
            }
        }
    }
}
