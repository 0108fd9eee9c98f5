// SPDX-License-Identifier: MIT

//! Rules of settling and of the journal that only one byte, one moment or one other pack shows.

use std::fs;
use std::panic::resume_unwind;
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use gauge_sim::SimBus;
use sha1::{Digest as _, Sha1};
use ti_gauge::chip::{FLAT, Kind};
use ti_gauge::dataflash::{Change, Decision, Place};
use ti_gauge::gauge::Seal;
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause};
use crate::room::{Folder, PowerCut, State, on_disk, until_cut};
use crate::room::{RESET, cut, half_way, programs, two_blocks};

const CHIP: &str = "bq34z100-g1";
/// Counted by the gauge, in the block of Design Capacity.
const CYCLE_COUNT: (u16, usize) = (48, 6);
const UNDOCUMENTED: u8 = 200;

impl Folder {
    /// Changes the journal's text, after making it one of the previous version, which has no sum of its first lines.
    pub(crate) fn edit(&self, edit: impl FnOnce(String) -> String) {
        let text = self.text().expect("a journal").replace("journal 4", "journal 3");
        let text =
            text.lines().filter(|line| !line.starts_with("begun ")).map(|line| format!("{line}\n")).collect();
        fs::write(self.journal().path(), edit(text)).expect("it can be written");
    }
}

impl Rig {
    /// Settling is left to a person and changes nothing.
    fn is_undecided(&mut self, at: &str) {
        let (flash, resets) = (self.sim.flash(), self.get("resets"));
        let error = self.arrive().expect_err(at);
        assert_eq!(cause(&error), "busy", "{at}: {error}");
        assert!(self.dataflash.owed().is_some_and(|owed| owed.needs_decision), "{at}: {error}");
        assert!(self.sim.flash() == flash && self.get("resets") == resets, "{at}: {error}");
    }

    /// The Design Capacity that the gauge works with.
    fn capacity(&mut self) -> u16 {
        let mut word = [0; 2];
        self.gauge.read(0x3C, &mut word).expect("it answers");
        u16::from_le_bytes(word)
    }
}

#[test]
fn a_count_that_has_risen_since_an_interrupted_write_is_kept() {
    let folder = Folder::new("risen");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    half_way(&mut rig, &folder);
    rig.sim.set_flash(CYCLE_COUNT.0, CYCLE_COUNT.1, &[0, 7]);
    rig.arrive().expect("the gauge counts");
    let wanted = Rig::calibrated(CHIP, Seal::Sealed);
    wanted.sim.set_flash(CYCLE_COUNT.0, CYCLE_COUNT.1, &[0, 7]);
    assert!(rig.sim.flash() == wanted.sim.flash());
}

#[test]
fn a_journal_of_another_part_or_firmware_is_left_to_a_person() {
    for (then, other) in
        [("part bq34z100-g1 0100 ", "part bq34z100-g1 0101 "), (" 0016 0001\n", " 0015 0001\n")]
    {
        let folder = Folder::new("part");
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        half_way(&mut rig, &folder);
        folder.edit(|text| {
            assert!(text.contains(then), "{text}");
            text.replacen(then, other, 1)
        });
        rig.is_undecided(other);
    }
}

/// The first versions noted the device number as the firmware of these parts.
#[test]
fn regression_a_journal_with_the_device_number_for_its_firmware_is_settled() {
    for (chip, address, text, part) in [
        ("bq34110", 0x41F5, "3100", "part bq34110 0110 "),
        ("bq35100", 0x41FE, "3100", "part bq35100 0100 "),
        ("bq27220", 0x929F, "3100", "part bq27220 0220 "),
    ] {
        for (noted, counts) in [("swapped", true), ("9999", false)] {
            let folder = Folder::new("number");
            let mut rig = Rig::calibrated(chip, Seal::Sealed);
            let change = rig.change(FLAT, address, text);
            cut(&mut rig, &folder, &[change], programs);
            let number = part.split_whitespace().next_back().expect("a number");
            let swapped = format!("{}{}", &number[2..], &number[..2]);
            let noted = if counts { &swapped } else { noted };
            folder.edit(|text| {
                let start = text.find(part).expect("its part") + part.len();
                assert_ne!(&text[start..start + 4], noted, "{chip}: the firmware");
                format!("{}{noted}{}", &text[..start], &text[start + 4..])
            });
            if counts {
                rig.arrive().expect("the gauge counts").expect("there is a journal");
                assert_eq!(folder.text(), None, "{chip}");
            } else {
                rig.is_undecided(chip);
            }
        }
    }
}

/// Its sum is right, so nothing but its content shows that no gaugefs has written it.
#[test]
fn a_journal_with_an_impossible_place_is_left_to_a_person() {
    let resummed = |text: String, from: &str, to: &str| {
        let (head, plan) = text.split_once("\nreset ").expect("a plan");
        let (plan, _) = plan.rsplit_once("\nend ").expect("a plan");
        let plan = format!("reset {plan}\n");
        assert!(plan.contains(from), "{plan}");
        let plan = plan.replacen(from, to, 1);
        let sum: String = Sha1::digest(&plan).iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{head}\n{plan}end {sum}\n")
    };
    let long = format!("\nmark 104 11 {}", "00".repeat(70_000));
    for (from, to) in [
        ("\nblock 48 0 ", "\nblock 80 65504 "),
        ("\nblock 48 0 ", "\nblock 80 65535 "),
        ("\nmark 104 11 ", "\nmark 104 11 0000"),
        ("\nmark 104 11 ", &*long),
    ] {
        let folder = Folder::new("impossible");
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        half_way(&mut rig, &folder);
        folder.edit(|text| resummed(text, from, to));
        rig.is_undecided(&to[..20.min(to.len())]);
    }
}

/// A subclass that no table has, with the blocks of subclass 58.
fn with_undocumented(bus: &mut SimBus, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
    match *write {
        [0x3E, UNDOCUMENTED, block] => bus.transfer(&[0x3E, 58, block], read),
        [0x3E] => {
            bus.transfer(write, read)?;
            if read[0] == 58 {
                read[0] = UNDOCUMENTED;
            }
            Ok(())
        }
        _ => bus.transfer(write, read),
    }
}

#[test]
fn an_interrupted_write_to_an_undocumented_subclass_is_settled() {
    let folder = Folder::new("undocumented");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let old = rig.sim.flash();
    let place = Place { subclass: UNDOCUMENTED, offset: 3 };
    let raw = Change::raw(rig.gauge.chip, place, vec![0x5a]).expect("no parameter");
    let changes = [rig.change(48, 11, "2200"), raw];
    rig.start_with(&folder, Keys::default(), |bus, _, write, read| {
        let done = with_undocumented(bus, write, read);
        if programs(write) {
            resume_unwind(Box::new(PowerCut));
        }
        done
    });
    assert!(until_cut(|| rig.write_all(&changes)).is_none());
    assert!(rig.sim.flash() != old);
    rig.start_with(&folder, Keys::default(), |bus, _, write, read| with_undocumented(bus, write, read));
    rig.pause(5);
    rig.arrive().expect("nothing is in the way").expect("there is a journal");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

#[test]
fn a_gauge_whose_ram_was_lost_has_nothing_to_settle() {
    let folder = Folder::new("ram");
    let mut rig = Rig::calibrated("bq27441-g1", Seal::Sealed);
    rig.write(82, 10, "1200").expect("no fault");
    let change = rig.change(82, 10, "1300");
    cut(&mut rig, &folder, &[change], programs);
    rig.power_cycle();
    let programmed = rig.get("programmed");
    rig.arrive().expect("nothing is left of the write");
    assert_eq!(rig.get("programmed"), programmed);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// The gauge works with the new values when a person wants the old ones.
#[test]
fn a_write_that_is_undone_after_its_reset_resets_again_when_it_is_settled() {
    let folder = Folder::new("undone");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let changes = two_blocks(&rig);
    cut(&mut rig, &folder, &changes, |write| write == RESET);
    assert_eq!(rig.capacity(), 2200);
    rig.dataflash
        .decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO)
        .expect("nothing is in the way");
    assert_eq!(rig.capacity(), 1000);
}

/// All old values are back, as after a second loss of power while the write is undone, but the gauge still works with
/// the new ones.
#[test]
fn old_values_do_not_end_a_write_whose_reset_was_sent() {
    let folder = Folder::new("reset-sent");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let old = rig.sim.flash();
    let changes = two_blocks(&rig);
    cut(&mut rig, &folder, &changes, |write| write == RESET);
    rig.sim.set_flash(48, 11, &1000_u16.to_be_bytes());
    rig.sim.set_flash(80, 53, &3000_u16.to_be_bytes());
    assert!(rig.sim.flash() == old && rig.capacity() == 2200);
    rig.arrive().expect("nothing is in the way");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.capacity(), folder.files()), (1000, vec![]));
}

#[test]
fn a_gauge_found_open_and_sealed_since_stays_sealed() {
    let folder = Folder::new("sealed-since");
    let mut rig = Rig::calibrated(CHIP, Seal::Unsealed);
    let change = rig.change(58, 3, "0x5a");
    cut(&mut rig, &folder, &[change], programs);
    rig.power_cycle();
    rig.arrive().expect("nothing is in the way");
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

#[test]
fn a_count_that_went_back_is_of_another_pack() {
    for (count, is_another) in [(6, true), (8, false)] {
        let folder = Folder::new("count");
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        rig.sim.set_flash(CYCLE_COUNT.0, CYCLE_COUNT.1, &[0, 7]);
        let change = rig.change(80, 53, "3100");
        rig.start_with(&folder, Keys::default(), |bus, _, write, read| {
            let done = bus.transfer(write, read);
            if programs(write) {
                resume_unwind(Box::new(PowerCut));
            }
            done
        });
        rig.read(48, 11).expect("the count is known then");
        assert!(until_cut(|| rig.write_all(&[change])).is_none());
        rig.sim.set_flash(CYCLE_COUNT.0, CYCLE_COUNT.1, &[0, count]);
        rig.start(&folder);
        rig.pause(5);
        if is_another {
            rig.is_undecided("the count went back");
        } else {
            rig.arrive().expect("the gauge counts").expect("there is a journal");
        }
    }
}

#[test]
fn a_pack_with_another_serial_number_is_another_one() {
    let folder = Folder::new("serial");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let change = rig.change(80, 53, "3100");
    cut(&mut rig, &folder, &[change], programs);
    rig.sim.set_flash(48, 4, &[0x12, 0x34]);
    rig.power_cycle();
    rig.is_undecided("another serial number");
}

/// Two packs from the factory are the same one only while the gauge has been watched.
#[test]
fn a_gauge_that_was_silent_for_long_may_be_another_one() {
    for is_silent in [true, false] {
        let folder = Folder::new("silent");
        let mut rig = Rig::new(CHIP);
        let old = rig.sim.flash();
        let changes = two_blocks(&rig);
        let (clock, sim, mut until) = (rig.clock.clone(), rig.sim.clone(), None);
        rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
            if is_silent && until.is_some_and(|until| clock.now() < until) {
                return Err(BusError::NoAck);
            }
            let done = bus.transfer(write, read);
            if programs(write) && until.is_none() {
                until = Some(clock.now() + Duration::from_secs(60));
                if !is_silent {
                    // Nothing is stored any more.
                    sim.set("voltage_mv", "2000").expect("a knob");
                }
            }
            done
        });
        let error = rig.write_all(&changes).expect_err("it is half way");
        assert_eq!(cause(&error), "state-unknown", "{error}");
        assert!(rig.sim.flash() != old);
        if is_silent {
            rig.pause(60);
            rig.settle().expect_err("it may be another one");
            assert!(rig.sim.flash() != old);
            assert!(rig.dataflash.owed().is_some_and(|owed| owed.needs_decision));
        } else {
            rig.set("voltage_mv", "auto");
            rig.settle().expect("it is the same one").expect("something is owed");
            assert!(rig.sim.flash() == old);
        }
    }
}

/// Its calibration, which is in the block that is written, is not what was read before.
#[test]
fn a_block_of_another_pack_is_noticed_before_it_is_written() {
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    rig.read(104, 11).expect("its calibration is known then");
    rig.calibrate(5);
    let flash = rig.sim.flash();
    let error = rig.write(104, 12, "1").expect_err("another pack");
    assert_eq!(cause(&error), "gone", "{error}");
    assert!(rig.sim.flash() == flash);
}

#[test]
fn no_key_beside_a_written_parameter_is_in_the_journal() {
    let folder = Folder::new("keys");
    let mut rig = Rig::calibrated("bq35100", Seal::Sealed);
    let keys = rig.gauge.chip.subclasses.iter().filter(|subclass| subclass.kind == Kind::Security);
    let keys = keys.flat_map(|subclass| subclass.start()..subclass.start() + subclass.length);
    let beside: Vec<u16> = keys.filter(|address| address & !31 == 0x41A0).collect();
    assert!(beside.len() >= 4);
    for address in beside {
        rig.sim.set_flash(FLAT.into(), usize::from(address - 0x4000), &[0xc7]);
    }
    let change = rig.change(FLAT, 0x41B1, "0x82");
    cut(&mut rig, &folder, &[change], programs);
    let text = folder.text().expect("a journal");
    assert!(text.contains("\nend ") && !text.contains("c7c7"), "{text}");
}

/// Another program has begun a write at the same place after this one has looked for a journal.
#[test]
fn a_journal_that_is_there_is_not_replaced() {
    let folder = Folder::new("there");
    half_way(&mut Rig::calibrated(CHIP, Seal::Sealed), &folder);
    let journal = folder.text().expect("a journal");
    fs::remove_file(folder.journal().path()).expect("it is there");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let (old, path, text) = (rig.sim.flash(), folder.journal().path(), journal.clone());
    rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
        fs::write(&path, &text).expect("it can be written");
        bus.transfer(write, read)
    });
    assert_eq!(cause(&rig.write(80, 53, "3100").expect_err("it is not settled")), "busy");
    assert!(rig.sim.flash() == old && folder.text() == Some(journal));
}

/// A part of the plan did not reach the disk, so no block had been written. What is missing reads as zeros.
#[test]
fn a_plan_whose_sum_does_not_fit_does_not_count() {
    let folder = Folder::new("sum");
    half_way(&mut Rig::calibrated(CHIP, Seal::Sealed), &folder);
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let old = rig.sim.flash();
    folder.edit(|text| text.replacen("block 80 32 ", &"\0".repeat(12), 1));
    rig.start(&folder);
    rig.arrive().expect("nothing had been written").expect("there is a journal");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// All old content is back, and the gauge still works with the new one: only the journal says that a reset is due.
#[test]
fn a_reset_is_on_disk_before_anything_goes_back() {
    let write = |rig: &Rig, cut| {
        let changes = two_blocks(rig);
        on_disk(rig, State::default(), cut, |dataflash, gauge| {
            dataflash.write(gauge, &changes, Duration::ZERO)
        })
    };
    // As the reset is sent; what was not synced is lost.
    let interrupted = |number| {
        let rig = Rig::calibrated(CHIP, Seal::Sealed);
        let old = rig.sim.flash();
        let (_, _, disk) = write(&rig, Some((number, true)));
        let left = disk.after_cut(|| true);
        rig.clock.sleep(Duration::from_secs(5));
        (rig, old, left)
    };
    let (_, calls, _) = write(&Rig::calibrated(CHIP, Seal::Sealed), None);
    let first = (1..=calls).find(|&number| interrupted(number).0.get("resets") == "1").expect("it is reset");
    let text = interrupted(first).2.journal().expect("the write is not over");
    assert!(text.contains("\nend ") && !text.contains("reset sent"), "{text}");
    let mut returned = 0;
    for number in 1.. {
        let (mut rig, old, left) = interrupted(first);
        let (said, _, disk) = on_disk(&rig, left, Some((number, true)), |dataflash, gauge| {
            dataflash.decide(gauge, Decision::Undo(None), Duration::ZERO)
        });
        if let Some(said) = said {
            said.expect("nothing is in the way");
            assert_eq!(rig.capacity(), 1000);
            break;
        }
        if rig.sim.flash() == old
            && rig.capacity() == 2200
            && let Some(text) = disk.after_cut(|| true).journal()
        {
            assert!(text.ends_with("reset sent\n"), "cut at {number}: {text}");
            returned += 1;
        }
    }
    assert!(returned > 0);
}
