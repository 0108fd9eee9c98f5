// SPDX-License-Identifier: MIT

//! Rules about what is kept, and what is forgotten, after a write that failed or was interrupted.

use std::fs;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::{Chip, FLAT, Role};
use ti_gauge::dataflash::Decision;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause};
use crate::room::{Folder, PowerCut, until_cut};
use crate::room::{cut, half_way, programs, two_blocks};

const CHIP: &str = "bq34z100-g1";

/// Starts the engine on a bus whose adapter is gone from the first commit on, until the switch is turned off.
fn gone_after_a_commit(rig: &mut Rig, folder: &Folder) -> Arc<AtomicBool> {
    let gone = Arc::new(AtomicBool::new(false));
    let (switch, mut committed) = (gone.clone(), false);
    rig.start_with(folder, Keys::default(), move |bus, _, write, read| {
        if switch.load(Ordering::SeqCst) {
            return Err(BusError::Gone);
        }
        let done = bus.transfer(write, read);
        if programs(write) && !committed {
            committed = true;
            switch.store(true, Ordering::SeqCst);
        }
        done
    });
    gone
}

#[test]
fn a_discarded_write_leaves_the_gauge_sealed() {
    let folder = Folder::new("discarded");
    let mut rig = Rig::found(CHIP, Seal::Sealed);
    half_way(&mut rig, &folder);
    assert_eq!(rig.get("seal"), "unsealed");
    rig.dataflash.decide(&mut rig.gauge, Decision::Discard, Duration::ZERO).expect("it answers");
    assert_eq!(rig.get("seal"), "sealed");
    assert!(rig.dataflash.owed().is_none());
}

/// The gauge did not answer while its mode was to be ended. The next write was refused, as if somebody else had set it.
#[test]
fn regression_a_mode_that_a_discarded_write_had_left_on_was_not_ended_by_the_next_write() {
    let folder = Folder::new("mode-left-on");
    let mut rig = Rig::found("bq27441-g1", Seal::Unsealed);
    let changes = [rig.change(82, 10, "1500")];
    cut(&mut rig, &folder, &changes, programs);
    assert_eq!(rig.get("mode"), "config-update");
    // CONFIG UPDATE is ended, but the gauge does not take SOFT_RESET.
    rig.start_with(&folder, Keys::default(), |bus, _, write, read| match write {
        [0x00, 0x42 | 0x43, 0x00] => Err(BusError::NoAck),
        _ => bus.transfer(write, read),
    });
    rig.dataflash
        .decide(&mut rig.gauge, Decision::Discard, Duration::ZERO)
        .expect_err("the mode is still on");
    assert_eq!(rig.get("mode"), "config-update");
    assert_eq!(folder.text(), None);
    rig.through(|bus, write, read| bus.transfer(write, read));
    rig.write(82, 10, "1600").expect("the mode is ours");
    assert_eq!(rig.get("mode"), "normal");
    assert_eq!(rig.read(82, 10), Ok(vec![0x06, 0x40]));
}

/// Erased flash, and RAM that was never set, look alike in all packs.
#[test]
fn blank_values_do_not_distinguish_packs() {
    // Int Temp Offset, whose default is 0, and the serial number, whose default is 1.
    let values: [(&str, u16, usize, &[u8]); 5] = [
        (CHIP, 104, 11, &[0xff]),
        (CHIP, 48, 4, &[0xff, 0xff]),
        (CHIP, 48, 4, &[0, 0]),
        // The same offset of a part whose manual has no default.
        ("bq35100", FLAT as u16, 0x0e, &[0xff]),
        ("bq35100", FLAT as u16, 0x0e, &[0]),
    ];
    for (chip, area, at, bytes) in values {
        let folder = Folder::new("blank");
        let mut rig = Rig::found(chip, Seal::Sealed);
        rig.sim.set_flash(area, at, bytes);
        rig.power_cycle();
        rig.clock.sleep(Duration::from_secs(3));
        if chip == CHIP {
            half_way(&mut rig, &folder);
        } else {
            let changes = [rig.change(FLAT, 0x41b1, "0x82"), rig.change(FLAT, 0x41fe, "3100")];
            cut(&mut rig, &folder, &changes, programs);
        }
        let flash = rig.sim.flash();
        let error = rig.arrive().expect_err("it may be another pack");
        assert_eq!(cause(&error), "busy", "{chip} {bytes:02x?}: {error}");
        assert!(rig.sim.flash() == flash, "{chip} {bytes:02x?}");
    }
}

/// What was read while a write waited for a decision is not what the gauge has afterwards.
#[test]
fn what_was_read_before_a_write_is_settled_is_forgotten() {
    let folder = Folder::new("kept-known");
    let mut rig = Rig::found(CHIP, Seal::Sealed);
    let changes = [rig.change(48, 4, "0x0007"), rig.change(80, 53, "3100")];
    cut(&mut rig, &folder, &changes, programs);
    rig.arrive().expect_err("it may be another pack");
    assert_eq!(rig.read(48, 4).expect("it answers"), [0, 7]);
    rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO).expect("it answers");
    rig.write(48, 11, "2200").expect("it is the same pack");
}

/// The gauge has arrived anew, so it may be another one, however short its silence was.
#[test]
fn a_gauge_that_arrives_was_not_watched() {
    let folder = Folder::new("kept-watched");
    let mut rig = Rig::found(CHIP, Seal::Sealed);
    let gone = gone_after_a_commit(&mut rig, &folder);
    let changes = two_blocks(&rig);
    let error = rig.write_all(&changes).expect_err("the adapter is gone");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    gone.store(false, Ordering::SeqCst);
    let flash = rig.sim.flash();
    let error = rig.arrive().expect_err("it may be another pack");
    assert_eq!(cause(&error), "busy", "{error}");
    assert!(rig.sim.flash() == flash);
}

/// It may have stored the block, and may show what was sent to it as if it were in flash.
#[test]
fn nothing_is_committed_again_on_a_gauge_that_has_sealed_itself() {
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let flash = rig.sim.flash();
    let commits = Arc::new(AtomicU32::new(0));
    let (count, mut shows_sealed, mut asked) = (commits.clone(), false, false);
    rig.through(move |bus, write, read| {
        if programs(write) && count.fetch_add(1, Ordering::SeqCst) == 0 {
            shows_sealed = true;
            return Err(BusError::NoAck);
        }
        match write {
            [0x00, 0x00, 0x00] => asked = true,
            [0x00, _, _] => (asked, shows_sealed) = (false, false),
            _ => {}
        }
        let done = bus.transfer(write, read);
        if asked && shows_sealed && write == [0x00] {
            read[1] |= 0x20;
        }
        done
    });
    let error = rig.write(80, 53, "3100").expect_err("it has sealed itself");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert_eq!(commits.load(Ordering::SeqCst), 1);
    assert!(rig.sim.flash() == flash);
}

/// The record of an access names the pack as it is now.
#[test]
fn the_identity_is_read_again_after_a_write() {
    let folder = Folder::new("kept-identity");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let ends = Arc::new(AtomicBool::new(false));
    let switch = ends.clone();
    rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
        if switch.load(Ordering::SeqCst) && matches!(write, [0x3e, ..]) {
            resume_unwind(Box::new(PowerCut));
        }
        bus.transfer(write, read)
    });
    rig.write(48, 4, "0x0007").expect("no fault");
    ends.store(true, Ordering::SeqCst);
    assert!(until_cut(|| rig.read(80, 53)).is_none(), "the host loses power");
    let path = folder.journal().path();
    let text = fs::read_dir(path.parent().expect("a folder"))
        .expect("it is there")
        .map(|entry| fs::read_to_string(entry.expect("an entry").path()).expect("a text"));
    let text: String = text.collect();
    assert!(text.contains(" 0016 0007\n"), "{text}");
}

/// Its serial number may be the old one or the new one, so neither shows another pack.
#[test]
fn a_block_whose_write_failed_is_not_known() {
    let folder = Folder::new("kept-block");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let gone = gone_after_a_commit(&mut rig, &folder);
    let error = rig.write(48, 4, "0x0007").expect_err("the adapter is gone");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    gone.store(false, Ordering::SeqCst);
    rig.clock.sleep(Duration::from_secs(1));
    assert_eq!(rig.read(48, 4).expect("it answers"), [0, 7]);
    assert!(!rig.dataflash.doubts(), "it is the same pack");
}

/// A poll of a RAM gauge.
fn polled(rig: &mut Rig) {
    let chip = rig.gauge.chip;
    let source = chip.register(Role::Flags).expect("every part has Flags()").source;
    let code = source.command().expect("a standard command");
    let mut word = [0; 2];
    rig.gauge.read(code, &mut word).expect("it answers");
    let flags = u16::from_le_bytes(word);
    rig.dataflash.polled(chip, |at| (at == source).then_some(flags.into()));
}

fn lose_power(rig: &Rig) {
    rig.power_cycle();
    rig.clock.sleep(Duration::from_secs(3));
}

/// The write that lost its power has said so.
#[test]
fn a_loss_of_power_that_a_failed_write_has_reported_stops_no_other() {
    let mut rig = Rig::new("bq27441-g1");
    let (sim, clock) = (rig.sim.clone(), rig.clock.clone());
    rig.after(programs, 1, move || {
        sim.set("power", "off").expect("a knob");
        sim.set("power", "on").expect("a knob");
        clock.sleep(Duration::from_secs(1));
    });
    rig.arrive().expect("nothing to settle");
    polled(&mut rig);
    let error = rig.write(82, 10, "1500").expect_err("its data memory is lost");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    rig.clock.sleep(Duration::from_secs(3));
    rig.write(82, 10, "1500").expect("it was said");
}

/// The end of CONFIG UPDATE clears [ITPOR], so that the next loss of power is one more.
#[test]
fn a_loss_of_power_after_a_write_is_another_one() {
    let mut rig = Rig::new("bq27441-g1");
    lose_power(&rig);
    rig.arrive().expect("nothing to settle");
    polled(&mut rig);
    rig.write(82, 10, "1500").expect("the loss is known");
    lose_power(&rig);
    let error = rig.write(82, 10, "1600").expect_err("its values were lost again");
    assert_eq!(cause(&error), "gone", "{error}");
}

#[test]
fn a_gauge_that_sealed_itself_is_opened_on_the_way_back() {
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let flash = rig.sim.flash();
    let (sim, clock, mut commits) = (rig.sim.clone(), rig.clock.clone(), 0);
    rig.through(move |bus, write, read| {
        if programs(write) {
            commits += 1;
            if commits == 2 {
                sim.set("power", "off").expect("a knob");
                sim.set("power", "on").expect("a knob");
                clock.sleep(Duration::from_secs(1));
                return Err(BusError::NoAck);
            }
        }
        bus.transfer(write, read)
    });
    let changes = two_blocks(&rig);
    let error = rig.write_all(&changes).expect_err("it has lost its power");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert!(rig.sim.flash() == flash);
    assert_eq!(rig.get("seal"), "sealed");
}

/// Counts what is written behind a register pointer.
struct Counted(Arc<AtomicU32>);

impl Bus for Counted {
    fn transfer(&mut self, write: &[u8], _: &mut [u8]) -> Result<(), BusError> {
        if write.len() > 1 {
            self.0.fetch_add(1, Ordering::SeqCst);
        }
        Ok(())
    }
}

#[test]
fn nothing_but_register_pointers_is_sent_to_a_part_without_a_table() {
    let chip = Chip::by_name("bq27000").expect("the kernel's driver has it");
    let sent = Arc::new(AtomicU32::new(0));
    let clock = Arc::new(SimClock::new());
    let mut gauge = Gauge::new(chip, Box::new(Counted(sent.clone())), clock, Keys::default());
    assert_eq!(gauge.write_once(0x00, &[0x20, 0x00]), Err(BusError::ReadOnly));
    assert!(gauge.try_key(&[0x0414, 0x3672].into(), Seal::Unsealed).is_err());
    gauge.read(0x08, &mut [0; 2]).expect("a register");
    assert_eq!(sent.load(Ordering::SeqCst), 0);
}

/// A pack whose write waits for a person, and is sealed meanwhile.
fn waiting(folder: &Folder) -> Rig {
    let mut rig = Rig::found(CHIP, Seal::Sealed);
    half_way(&mut rig, folder);
    rig.arrive().expect_err("it may be another pack");
    assert_eq!(rig.get("seal"), "sealed");
    rig
}

/// A gauge that ignores so many SEAL commands that a read leaves it open.
fn left_open_by_a_read(rig: &mut Rig) {
    rig.set("fault", &["drop-seal"; 4].join("; "));
    let error = rig.read(80, 53).expect_err("it cannot be sealed");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    assert_eq!(rig.get("seal"), "unsealed");
}

#[test]
fn regression_a_seal_was_lost_while_a_write_waited_for_a_decision() {
    let folder = Folder::new("kept-seal");
    for restart in [false, true] {
        let mut rig = waiting(&folder);
        let flash = rig.sim.flash();
        left_open_by_a_read(&mut rig);
        let owed = rig.dataflash.owed().expect("a write and a seal");
        assert!(owed.data && !owed.needs_decision, "the seal can be tried again: {}", owed.why);
        let why = owed.why.to_string();
        assert!(
            why.contains("restoring the sealed state failed") && why.contains("until you decide"),
            "{why}"
        );
        if restart {
            rig.start(&folder);
        }
        let error = rig.settle().expect_err("the write still waits");
        assert_eq!(cause(&error), "busy", "{error}");
        assert_eq!(rig.get("seal"), "sealed");
        assert!(rig.sim.flash() == flash, "nothing is written");
        let owed = rig.dataflash.owed().expect("the write");
        assert!(owed.needs_decision && !owed.why.contains("sealed state failed"), "{}", owed.why);
        rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO).expect("it answers");
        assert_eq!(folder.files(), Vec::<String>::new());
        assert!(rig.dataflash.owed().is_none());
    }
}

#[test]
fn a_seal_that_is_owed_survives_the_decision_about_the_write() {
    let folder = Folder::new("kept-seal-decided");
    let mut rig = waiting(&folder);
    left_open_by_a_read(&mut rig);
    rig.set("fault", &["drop-seal"; 4].join("; "));
    let _ = rig.dataflash.decide(&mut rig.gauge, Decision::Discard, Duration::ZERO);
    assert_eq!(rig.get("seal"), "unsealed");
    assert!(rig.dataflash.owed().is_some_and(|owed| !owed.data && !owed.needs_decision));
    rig.start(&folder);
    rig.settle().expect("it answers").expect("it was owed");
    assert_eq!(rig.get("seal"), "sealed");
    assert!(rig.dataflash.owed().is_none());
}
