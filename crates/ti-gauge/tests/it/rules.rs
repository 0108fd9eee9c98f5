// SPDX-License-Identifier: MIT

//! Rules of the engine that only one transfer, one byte or one moment shows.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::{FLAT, Range};
use ti_gauge::codec;
use ti_gauge::dataflash::{Change, DataFlash, Limits, Outcome};
use ti_gauge::gauge::Seal;
use ti_gauge::value::Value;

use crate::rig::{Rig, cause};
use crate::room::{Folder, PowerCut, programs as commits, until_cut};

/// A read of a whole block with its selection, checksum and what follows.
fn is_whole(write: &[u8], read: &[u8]) -> bool {
    write == [0x3e] && read.len() == 36
}

/// Changes a byte of a block and its checksum.
fn forge(read: &mut [u8], value: u8) {
    read[2 + 11] = value;
    read[34] = !read[2..34].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
}

/// A block that was not loaded yet looks valid: the window shows the one before, and its checksum.
#[test]
fn a_block_that_changes_between_two_looks_is_not_believed() {
    let expected = Rig::new("bq34z100-g1").read(48, 11).expect("a read");
    for forged in [1, 2, 3] {
        let mut rig = Rig::new("bq34z100-g1");
        let mut looks = 0;
        rig.through(move |bus, write, read| {
            let done = bus.transfer(write, read);
            if is_whole(write, read) && read[..2] == [48, 0] {
                looks += 1;
                if looks <= forged {
                    forge(read, looks);
                }
            }
            done
        });
        assert_eq!(rig.read(48, 11).as_ref(), Ok(&expected), "{forged} looks");
    }
}

/// A wrong bit in the number of the block selects one that does not exist, which reads as zeros; another wrong bit at the
/// second try selects another one of those.
#[test]
fn regression_two_blocks_that_do_not_exist_were_believed() {
    for errors in 2..4 {
        let mut rig = Rig::new("bq34z100-g1");
        let mut selections = 0;
        rig.through(move |bus, write, read| match *write {
            [0x3e, 48, 0] if selections < errors => {
                selections += 1;
                bus.transfer(&[0x3e, 48, 2 << selections], read)
            }
            _ => bus.transfer(write, read),
        });
        match rig.read(48, 11) {
            Ok(bytes) => assert_eq!(bytes, [0x03, 0xe8], "{errors} errors"),
            Err(error) => assert_eq!(cause(&error), "protocol", "{errors} errors: {error}"),
        }
    }
}

/// A wrong selection, twice, with valid blocks that differ.
#[test]
fn a_block_that_was_not_selected_is_not_believed() {
    let mut rig = Rig::new("bq34z100-g1");
    let mut selections = 0;
    rig.through(move |bus, write, read| match *write {
        [0x3e, 48, 0] => {
            selections += 1;
            bus.transfer(&[0x3e, if selections == 1 { 80 } else { 82 }, 0], read)
        }
        _ => bus.transfer(write, read),
    });
    assert_eq!(cause(&rig.read(48, 11).expect_err("two other blocks")), "protocol");
}

/// The answer to another address may have a sum that fits the one that was asked for.
#[test]
fn a_flat_block_with_a_wrong_address_or_sum_is_not_believed() {
    let expected = Rig::new("bq34110").read(FLAT, 0x41F5).expect("a read");
    for which in ["address", "sum"] {
        let mut rig = Rig::new("bq34110");
        let mut looks = 0;
        rig.through(move |bus, write, read| {
            let done = bus.transfer(write, read);
            if is_whole(write, read) {
                let address = u16::from_le_bytes([read[0], read[1]]);
                let at = 0x41F5_u16.checked_sub(address).filter(|at| *at < 32);
                if let Some(at) = at.filter(|_| looks < 3) {
                    looks += 1;
                    let at = 2 + usize::from(at);
                    read[at] ^= 0x80;
                    if which == "address" {
                        read[at + 1] ^= 0x80;
                        read[0] ^= 0x80;
                    }
                }
            }
            done
        });
        assert_eq!(rig.read(FLAT, 0x41F5).as_ref(), Ok(&expected), "{which}");
    }
}

/// Cycle Count, which the gauge counts, is between the serial number and CC Threshold.
const COUNT: (u8, usize) = (48, 6);

#[test]
fn a_learned_byte_between_two_written_ones_is_not_sent() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.sim.clear_log();
    rig.write_values(&[((48, 4), "0x0707"), ((48, 8), "901")]).expect("no fault");
    for record in rig.sim.log() {
        if let [at @ 0x40..0x60, data @ ..] = &record.write[..] {
            let sent = usize::from(*at) - 0x40..usize::from(*at) - 0x40 + data.len();
            assert!(!sent.contains(&6) && !sent.contains(&7), "{sent:?}");
        }
    }
}

/// The count rises while another block is programmed, or while its own is, with and without a failure.
#[test]
fn a_count_that_rises_during_a_write_is_kept() {
    for (values, fault) in [
        (&[((32, 4), "60"), ((48, 8), "901")][..], "none"),
        (&[((48, 8), "901")], "none"),
        (&[((48, 8), "901")], "corrupt-commit"),
        (&[((48, 8), "901")], "drop-commit"),
    ] {
        let at = format!("{values:?}, {fault}");
        let mut rig = Rig::new("bq34z100-g1");
        let place = rig.position(COUNT.0, COUNT.1);
        let old = rig.sim.flash();
        let sim = rig.sim.clone();
        rig.set_fault(fault);
        rig.after(commits, 1, move || sim.set_flash(COUNT.0.into(), COUNT.1, &[0, 1]));
        let outcome = rig.write_values(values);
        assert_eq!(rig.bytes(place, 2), [0, 1], "{at}: {outcome:?}");
        match outcome {
            Ok(Outcome::Written { .. }) => assert_eq!(fault, "none", "{at}"),
            outcome => {
                assert_eq!(cause(&outcome.expect_err("it is written")), "rolled-back", "{at}");
                let mut now = rig.sim.flash();
                now[place..place + 2].copy_from_slice(&old[place..place + 2]);
                assert!(now == old && fault != "none", "{at}");
            }
        }
    }
}

#[test]
fn after_the_reset_only_what_was_written_is_undone() {
    let mut rig = Rig::new("bq34z100-g1");
    let (written, other) = (rig.position(48, 11), rig.position(48, 15));
    let old = rig.sim.flash();
    let sim = rig.sim.clone();
    rig.after(
        |write| write == [0x00, 0x41, 0x00],
        1,
        move || {
            sim.set_flash(48, 11, &[0x11]);
            sim.set_flash(48, 15, &[0x22]);
        },
    );
    let error = rig.write_values(&[((48, 11), "2200")]).expect_err("it does not verify");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert_eq!(
        (rig.bytes(written, 2), rig.bytes(other, 1)),
        (old[written..written + 2].to_vec(), vec![0x22])
    );
}

/// A neighbour that was erased is restored; one that something else has changed is left as it is.
#[test]
fn a_disturbed_neighbour_is_restored_only_where_it_was_erased() {
    for (byte, expected) in [(0xff, "rolled-back"), (0x42, "state-unknown")] {
        let mut rig = Rig::new("bq34z100-g1");
        rig.read(48, 11).expect("its neighbours are known then");
        let place = rig.position(48, 33);
        let mut wanted = rig.sim.flash();
        let sim = rig.sim.clone();
        rig.set_fault("corrupt-commit");
        rig.after(commits, 1, move || sim.set_flash(48, 33, &[byte]));
        let error = rig.write_values(&[((48, 11), "2200")]).expect_err("it is not stored");
        assert_eq!(cause(&error), expected, "{byte:02x}: {error}");
        if byte == 0x42 {
            wanted[place] = byte;
            assert_eq!(rig.bytes(place, 1), [byte]);
        } else {
            assert!(rig.sim.flash() == wanted, "{byte:02x}");
        }
    }
}

/// The host loses power before the first block is programmed, and a neighbour has been erased since.
#[test]
fn a_disturbed_neighbour_is_restored_when_a_write_is_settled() {
    let folder = Folder::new("neighbour");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    rig.read(48, 11).expect("its neighbours are known then");
    rig.through(|bus, write, read| match write {
        [0x60, _] => std::panic::resume_unwind(Box::new(PowerCut)),
        _ => bus.transfer(write, read),
    });
    let values = [((48, 11), "2200")];
    assert!(until_cut(|| rig.write_values(&values)).is_none());
    rig.sim.set_flash(48, 33, &[0xff]);
    assert!(rig.sim.flash() != old);
    rig.through(|bus, write, read| bus.transfer(write, read));
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("nothing is in the way");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// A pack that has counted less than before is another one, though its calibration is the same.
#[test]
fn a_write_is_not_settled_on_a_pack_whose_count_has_fallen() {
    for (count, settles) in [(8, true), (3, false)] {
        let folder = Folder::new("count");
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        rig.sim.set_flash(COUNT.0.into(), COUNT.1, &[0, 7]);
        rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
        rig.read(48, 11).expect("the count is known then");
        rig.through(|bus, write, read| match write {
            [0x60, _] => std::panic::resume_unwind(Box::new(PowerCut)),
            _ => bus.transfer(write, read),
        });
        assert!(until_cut(|| rig.write_values(&[((32, 4), "60")])).is_none());
        rig.sim.set_flash(COUNT.0.into(), COUNT.1, &[0, count]);
        rig.through(|bus, write, read| bus.transfer(write, read));
        rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
        let outcome = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO);
        assert_eq!(outcome.is_ok(), settles, "{count}: {outcome:?}");
        assert_eq!(folder.files().is_empty(), settles, "{count}: {outcome:?}");
    }
}

/// Power is lost while the row is erased, and with it what the gauge has counted.
#[test]
fn an_erased_row_is_restored_with_its_learned_bytes() {
    let folder = Folder::new("erased-count");
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    rig.sim.set_flash(COUNT.0.into(), COUNT.1, &[0, 7]);
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    let old = rig.sim.flash();
    rig.sim.set("tear", "erased").expect("a knob");
    rig.set_fault("torn-commit 1");
    rig.write_values(&[((48, 11), "2200")]).expect_err("it is torn");
    rig.set_fault("none");
    rig.sim.set("power", "on").expect("a knob");
    rig.clock.sleep(Duration::from_secs(3));
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("nothing is in the way");
    assert!(rig.sim.flash() == old);
}

#[test]
fn nothing_is_sent_while_a_kernel_driver_has_the_address() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.claimed_through(Err(BusError::Busy), |bus, write, read| bus.transfer(write, read));
    rig.sim.clear_log();
    assert_eq!(cause(&rig.write_values(&[((48, 11), "2200")]).expect_err("it is bound")), "bus");
    assert!(rig.log().is_empty());
}

/// SLUSBZ5D 6.14.
#[test]
fn transfers_are_66_us_apart() {
    let mut rig = Rig::new("bq34z100-g1");
    let (clock, mut last) = (rig.clock.clone(), None);
    rig.through(move |bus, write, read| {
        let begun = clock.now();
        if let Some(last) = last {
            assert!(begun - last >= Duration::from_micros(66), "{:?}", begun - last);
        }
        let done = bus.transfer(write, read);
        last = Some(clock.now());
        done
    });
    rig.write_values(&[((48, 11), "2200")]).expect("no fault");
}

/// Reserved bits of a saved word are not written.
#[test]
fn a_saved_word_keeps_the_bits_that_must_not_change() {
    let mut kept = 0;
    for chip in ti_gauge::chip::CHIPS {
        for subclass in chip.subclasses {
            for parameter in subclass.parameters {
                let Some(ti_gauge::chip::Safe::Keep(mask, _)) = &parameter.safe else { continue };
                let mut rig = Rig::new(chip.name);
                let old = rig.read(subclass.id, parameter.offset).expect("a read");
                let other: Vec<u8> = old.iter().map(|byte| !byte).collect();
                // Bits that the manual has none for are out of its range.
                let other = match (codec::Layout::TI.decode(parameter.kind, &other), &parameter.range) {
                    (Value::Int(word), Range::Int { max, .. }) => Value::Int(word & max),
                    (other, _) => other,
                };
                let change =
                    Change::of_value(chip, (subclass, parameter), &other, true).expect("bits").saved();
                let outcome = rig.dataflash.write(&mut rig.gauge, &[change], Duration::ZERO);
                let now = rig.read(subclass.id, parameter.offset).expect("a read");
                let word = |bytes: &[u8]| bytes.iter().fold(0, |word, &byte| word << 8 | u64::from(byte));
                let differ = word(&old) ^ word(&now);
                assert_eq!(differ & u64::from(*mask), 0, "{}/{}: {outcome:?}", chip.name, parameter.name);
                kept += usize::from(outcome.is_ok() && differ != 0);
            }
        }
    }
    assert!(kept > 0);
}

/// Within the time that gauges need: to program a block, to start after a reset, to show a seal state.
#[test]
fn a_gauge_that_needs_its_time_is_awaited() {
    for knobs in [
        &[("commit_ms", "218"), ("commit_busy", "old")][..],
        &[("commit_ms", "218"), ("commit_busy", "nack")],
        &[("reset_ms", "500"), ("reset_busy", "old")],
        &[("reset_ms", "500"), ("reset_busy", "nack")],
        &[("status_ms", "240")],
    ] {
        let mut rig = Rig::new("bq34z100-g1");
        for (knob, value) in knobs {
            rig.sim.set(knob, value).unwrap_or_else(|error| panic!("{knob}: {error}"));
        }
        let resets: u32 = rig.sim.get("resets").expect("a knob").parse().expect("a number");
        let outcome = rig.write_values(&[((48, 11), "2200")]);
        assert!(matches!(outcome, Ok(Outcome::Written { reset: true, .. })), "{knobs:?}: {outcome:?}");
        assert_eq!(rig.sim.get("resets"), Some((resets + 1).to_string()), "{knobs:?}");
        assert_eq!(rig.seal(), Seal::Sealed, "{knobs:?}");
        let seals = rig.log().iter().filter(|line| line.contains("00 20 00")).count();
        assert!(seals <= 1, "{knobs:?}: sealed {seals} times");
    }
}

/// Somebody else writes to the second block while the first one is programmed.
#[test]
fn a_block_that_has_changed_since_it_was_read_is_not_written() {
    let mut rig = Rig::new("bq34z100-g1");
    let mut wanted = rig.sim.flash();
    let place = rig.position(48, 15);
    let sim = rig.sim.clone();
    rig.after(commits, 1, move || sim.set_flash(48, 15, &[0x22]));
    let error = rig.write_values(&[((32, 4), "60"), ((48, 11), "2200")]).expect_err("it has changed");
    assert!(error.to_string().contains("has changed since it was read"), "{error}");
    wanted[place] = 0x22;
    assert!(rig.sim.flash() == wanted, "{error}");
}

/// Two wrong bytes with a right sum, beside the written ones, in the look at a block to which the write may go back: it
/// would write them.
#[test]
fn a_block_that_was_read_with_wrong_bytes_and_a_right_sum_is_not_written_back() {
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let (armed, forged) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let (is_armed, is_forged) = (armed.clone(), forged.clone());
    rig.through(move |bus, write, read| {
        let done = bus.transfer(write, read);
        if is_whole(write, read) && read[..2] == [80, 1] && is_armed.swap(false, Ordering::SeqCst) {
            let beside = &mut read[2..4];
            beside[0] = beside[0].wrapping_add(1);
            beside[1] = beside[1].wrapping_sub(1);
            is_forged.store(true, Ordering::SeqCst);
        }
        done
    });
    rig.read(80, 53).expect("the block is known then");
    let mut wanted = rig.sim.flash();
    let place = rig.position(80, 53);
    wanted[place..place + 2].copy_from_slice(&3100_u16.to_be_bytes());
    armed.store(true, Ordering::SeqCst);
    let outcome = rig.write_values(&[((80, 53), "3100")]);
    assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{outcome:?}");
    assert!(forged.load(Ordering::SeqCst) && rig.sim.flash() == wanted);
}

/// The block is stored wrong, and the first attempt to undo that is not stored at all.
#[test]
fn the_old_bytes_are_written_until_they_are_there() {
    let mut rig = Rig::new("bq34z100-g1");
    let old = rig.sim.flash();
    rig.set_fault("corrupt-commit");
    let mut count = 0;
    rig.through(move |bus, write, read| {
        count += u32::from(commits(write));
        if commits(write) && count == 2 { Ok(()) } else { bus.transfer(write, read) }
    });
    let error = rig.write_values(&[((48, 11), "2200")]).expect_err("it is stored wrong");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert!(rig.sim.flash() == old);
}

/// However slow the bus is, and however late a request is served, it is answered in 30 s.
#[test]
fn a_write_of_several_blocks_answers_within_30_s() {
    let values =
        [((32, 4), "60"), ((36, 15), "181"), ((48, 11), "2200"), ((49, 0), "160"), ((80, 53), "3100")];
    let (mut done, mut begun, mut refused) = (0, 0, 0);
    for (ms, waited) in
        [50, 100, 150, 200].into_iter().flat_map(|ms| (0..64).map(move |quarter| (ms, quarter * 250)))
    {
        let at = format!("{ms} ms for each transfer, served after {waited} ms");
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        let old = rig.sim.flash();
        let changes = values.map(|((subclass, offset), text)| rig.change(subclass, offset, text));
        let clock = rig.clock.clone();
        rig.through(move |bus, write, read| {
            clock.sleep(Duration::from_millis(ms));
            bus.transfer(write, read)
        });
        // The clock begins with the rig.
        rig.clock.sleep(Duration::from_secs(60));
        let waited = Duration::from_millis(waited);
        let asked = rig.clock.now();
        let outcome = rig.dataflash.write(&mut rig.gauge, &changes, waited);
        let took = waited + (rig.clock.now() - asked);
        assert!(took < Duration::from_secs(30), "{at}: {took:?} until {outcome:?}");
        match outcome.as_ref().map_err(cause) {
            Ok(_) => done += 1,
            Err("rolled-back" | "state-unknown") => begun += 1,
            Err(_) => {
                refused += 1;
                assert!(rig.sim.flash() == old, "{at}: {outcome:?}");
            }
        }
    }
    assert!(done > 0 && begun > 0 && refused > 0, "{done} done, {begun} begun, {refused} refused");
}

/// The host pauses after the first commit, so that there is no time left to go on.
#[test]
fn the_way_back_has_time_after_a_pause() {
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    let old = rig.sim.flash();
    let clock = rig.clock.clone();
    rig.after(commits, 1, move || clock.sleep(Duration::from_secs(60)));
    let error = rig.write_values(&[((32, 4), "60"), ((48, 11), "2200")]).expect_err("there is no time left");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert!(rig.sim.flash() == old);
    assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
}
