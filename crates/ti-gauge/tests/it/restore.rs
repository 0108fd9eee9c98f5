// SPDX-License-Identifier: MIT

//! The configuration of a gauge with RAM, written again after a loss of power.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use gauge_bus::clock::Clock as _;
use gauge_bus::{Bus, BusError};
use gauge_sim::SimBus;
use ti_gauge::chip::{CHIPS, Chip};
use ti_gauge::dataflash::{Change, DataFlash, Limits, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::journal::{Disk, File, Journal};
use ti_gauge::keys::{Keys, Name};

use crate::rig::Rig;
use crate::room::one_in;

type Values = &'static [((u8, u16), &'static str)];

/// Parts with RAM, and values that they do not have by themselves: in two blocks at least where there are so many.
const PARTS: &[(&str, Values)] = &[
    ("bq27441-g1", &[((82, 10), "1200"), ((80, 22), "700"), ((89, 0), "90"), ((64, 2), "0x0e")]),
    ("bq27421-g1", &[((82, 10), "1200"), ((89, 0), "90"), ((49, 0), "12")]),
    ("bq27426", &[((82, 6), "1200"), ((49, 0), "12"), ((89, 0), "90")]),
    ("bq27427", &[((82, 6), "1200"), ((49, 0), "12"), ((89, 0), "90")]),
    ("bq27621-g1", &[((82, 3), "1200"), ((49, 0), "12")]),
    ("bq27220", &[((0, 0x929F), "1200"), ((0, 0x91FD), "4100")]),
];

fn changes(chip: &str, values: Values) -> Vec<Change> {
    let chip = Chip::by_name(chip).expect("it has a table");
    let change = |&((id, at), text): &((u8, u16), &str)| Rig::change_of(chip, id, at, text).saved();
    values.iter().map(change).collect()
}

impl Rig {
    fn lose_power(&mut self) {
        self.sim.set("power", "off").expect("a knob");
        self.sim.set("power", "on").expect("a knob");
        self.pause(3);
        self.dataflash.forget();
        let _ = self.gauge.seal();
    }

    /// It has lost its power, and is found in that state: somebody has sealed it, or opened it.
    fn is_found(&mut self, found: Seal) {
        self.lose_power();
        self.gauge.go_to(found).expect("the default key");
        self.pause(5);
    }

    fn restore(&mut self, changes: &[Change]) -> Result<Outcome> {
        self.dataflash.restore(&mut self.gauge, changes, true, Duration::ZERO)
    }
}

/// What a gauge without faults holds when it was restored.
fn model(chip: &str, found: Seal, changes: &[Change]) -> Vec<u8> {
    let mut rig = Rig::new(chip);
    rig.is_found(found);
    assert!(matches!(rig.restore(changes), Ok(Outcome::Written { .. })), "{chip}");
    assert_eq!(rig.seal(), found, "{chip}");
    let flash = rig.sim.flash();
    assert!(matches!(rig.restore(changes), Ok(Outcome::Unchanged)), "{chip}");
    assert!(rig.sim.flash() == flash, "{chip}");
    flash
}

#[test]
fn every_part_with_ram_is_tested() {
    let with_ram: Vec<_> =
        CHIPS.iter().filter(|chip| chip.volatile.is_some()).map(|chip| chip.name).collect();
    assert!(with_ram.iter().all(|name| PARTS.iter().any(|(part, _)| part == name)), "{with_ram:?}");
}

/// How a gauge is found after a loss of power.
const FOUND: [Seal; 2] = [Seal::Unsealed, Seal::Sealed];

/// A block shows what was there before, or nothing, for longer than the first look waits.
#[test]
fn late_blocks_are_restored_right() {
    for (found, (chip, values)) in
        FOUND.into_iter().flat_map(|found| PARTS.iter().map(move |part| (found, part)))
    {
        let changes = changes(chip, values);
        let new = model(chip, found, &changes);
        for early in ["previous", "blank"] {
            for (load, block) in [("4", "0"), ("20", "10"), ("0", "45")] {
                let mut rig = Rig::new(chip);
                rig.is_found(found);
                for (knob, value) in [("early", early), ("load_ms", load), ("block_ms", block)] {
                    rig.sim.set(knob, value).expect("a knob");
                }
                let outcome = rig.restore(&changes);
                let at = format!("{chip} {found:?}, {early}, {load} ms, {block} ms: {outcome:?}");
                assert!(outcome.is_ok() && rig.sim.flash() == new, "{at}");
            }
        }
    }
}

#[test]
fn a_block_that_was_not_stored_is_stored_once_more() {
    for (chip, values) in PARTS {
        let changes = changes(chip, values);
        let new = model(chip, Seal::Unsealed, &changes);
        for fault in ["drop-commit", "corrupt-commit"] {
            let mut rig = Rig::new(chip);
            rig.lose_power();
            let begun = rig.gauge.statistics.resets.load(std::sync::atomic::Ordering::Relaxed);
            rig.sim.set("fault", fault).expect("a fault");
            rig.restore(&changes).unwrap_or_else(|error| panic!("{chip}, {fault}: {error}"));
            assert!(rig.sim.flash() == new, "{chip}, {fault}");
            let ended = rig.gauge.statistics.resets.load(std::sync::atomic::Ordering::Relaxed);
            assert_eq!(ended - begun, 1, "{chip}, {fault}: without leaving CONFIG UPDATE for it");
        }
    }
}

/// A disk that is full after so many bytes.
#[derive(Clone, Debug)]
struct Full(Arc<AtomicUsize>);

impl Disk for Full {
    fn create_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn exists(&self, path: &Path) -> bool {
        path.extension().is_none()
    }

    fn read(&self, _: &Path) -> io::Result<String> {
        Err(io::ErrorKind::NotFound.into())
    }

    fn create(&self, _: &Path) -> io::Result<Box<dyn File>> {
        Ok(Box::new(self.clone()))
    }

    fn open(&self, _: &Path) -> io::Result<Box<dyn File>> {
        Err(io::ErrorKind::NotFound.into())
    }

    fn rename(&self, _: &Path, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn list(&self, _: &Path) -> io::Result<Vec<PathBuf>> {
        Ok(Vec::new())
    }

    fn remove(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn sync(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }
}

impl File for Full {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let left = self.0.load(Ordering::Relaxed).checked_sub(bytes.len());
        self.0.store(left.ok_or(io::ErrorKind::StorageFull)?, Ordering::Relaxed);
        Ok(())
    }

    fn reserve(&mut self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Without its profile the gauge shows nothing, for as long as nobody removes a file. An ordinary write is refused.
#[test]
fn regression_a_full_disk_kept_a_gauge_from_its_profile() {
    for (found, (chip, values)) in
        FOUND.into_iter().flat_map(|found| PARTS.iter().map(move |part| (found, part)))
    {
        let changes = changes(chip, values);
        let new = model(chip, found, &changes);
        // Not even the first lines, and all but the plan.
        for room in [0, 300] {
            let mut rig = Rig::new(chip);
            let journal = Journal::new("/state".into(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
            let disk = Arc::new(Full(Arc::new(AtomicUsize::new(room))));
            rig.dataflash = DataFlash::new(Limits::default(), Some(journal.on(disk.clone())));
            rig.is_found(found);
            let before = rig.sim.flash();
            let write = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
            let write = write.expect_err("it could not be undone").to_string();
            assert!(
                write.contains("cannot write the journal") && rig.sim.flash() == before,
                "{chip}: {write}"
            );
            disk.0.store(room, Ordering::Relaxed);
            rig.is_found(found);
            let outcome = rig.restore(&changes);
            let is_written = matches!(outcome, Ok(Outcome::Written { .. }));
            assert!(is_written && rig.sim.flash() == new, "{chip} {found:?} {room}: {outcome:?}");
            assert_eq!(rig.seal(), found, "{chip} {room}");
        }
    }
}

#[test]
fn a_profile_does_not_wait_for_the_first_measurement() {
    for &(chip, values) in PARTS {
        let time = |first_ms: &str| {
            let mut rig = Rig::new(chip);
            rig.sim.set("first_ms", first_ms).expect("a knob");
            rig.sim.set("power", "off").expect("a knob");
            rig.sim.set("power", "on").expect("a knob");
            rig.dataflash.forget();
            while rig.gauge.seal().is_err() {
                rig.clock.sleep(Duration::from_millis(10));
            }
            let begun = rig.clock.now();
            let outcome = rig.restore(&changes(chip, values));
            assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{chip}: {first_ms} ms: {outcome:?}");
            rig.clock.now() - begun
        };
        assert_eq!(time("60000"), time("0"), "{chip}");
    }
}

/// One fault at each transfer. Success is said only of what is there, and the next attempt succeeds.
#[test]
pub(crate) fn a_fault_at_any_transfer_of_a_restore_causes_no_false_success() {
    let mut runs = 0;
    for (found, (chip, values)) in
        FOUND.into_iter().flat_map(|found| PARTS.iter().map(move |part| (found, part)))
    {
        let changes = changes(chip, values);
        let new = model(chip, found, &changes);
        let transfers = {
            let mut rig = Rig::new(chip);
            rig.is_found(found);
            let before = rig.cost().0;
            rig.restore(&changes).expect("no fault");
            rig.cost().0 - before
        };
        let faults: &[fn(u64) -> String] = &[
            |n| format!("nack {n}"),
            |n| format!("flip {n} 2 1"),
            |n| format!("lost {n}"),
            |n| format!("power-cut {n} 20"),
            |n| format!("power-cut-after {n} 20"),
        ];
        let faults = (1..=transfers).flat_map(|number| faults.iter().map(move |fault| fault(number)));
        for fault in one_in(5, faults) {
            let mut rig = Rig::new(chip);
            rig.is_found(found);
            rig.sim.set("fault", &fault).expect("a fault");
            let outcome = rig.restore(&changes);
            let is_there = |rig: &mut Rig| {
                let flash = rig.sim.flash();
                rig.sim.set("fault", "none").expect("a knob");
                same_but_for_the_seal(&flash, &new)
            };
            let there = is_there(&mut rig);
            // A cut behind the last look is a loss of its own.
            let lost_since = fault.starts_with("power") && !there;
            assert!(
                outcome.is_err() || there || lost_since && says_lost(&mut rig.gauge),
                "{chip} {found:?}, {fault}: {outcome:?}"
            );
            // A cut takes the seal of most parts with it.
            if outcome.is_ok() && there && !fault.starts_with("power") {
                assert_eq!(rig.seal(), found, "{chip}, {fault}");
            }
            rig.pause(5);
            rig.dataflash.start_over();
            let mut again = rig.settle().map(drop).and_then(|()| rig.restore(&changes));
            for _ in 0..3 {
                if again.is_ok() {
                    break;
                }
                rig.pause(5);
                again = rig.settle().map(drop).and_then(|()| rig.restore(&changes));
            }
            // The mark of the seal went with the power, or came with the way back.
            let is_new = |rig: &Rig| same_but_for_the_seal(&rig.sim.flash(), &new);
            assert!(again.is_ok() && is_new(&rig), "{chip} {found:?}, {fault}: {again:?}");
            runs += 1;
        }
    }
    println!("{runs} restores with one fault");
}

/// A part without the flag is compared by the program that has its profile.
fn says_lost(gauge: &mut Gauge) -> bool {
    let mut flags = [0; 2];
    let _ = gauge.read(0x06, &mut flags);
    gauge.chip.volatile == Some(0)
        || u32::from(u16::from_le_bytes(flags)) & gauge.chip.volatile.unwrap_or(0) != 0
}

/// Whether data memory is the same but for the bit that says that the gauge is sealed.
fn same_but_for_the_seal(one: &[u8], other: &[u8]) -> bool {
    let differing: Vec<_> = one.iter().zip(other).filter(|(one, other)| one != other).collect();
    one.len() == other.len()
        && (differing.is_empty()
            || matches!(differing[..], [(one, other)] if [0x80, 0x20].contains(&(*one ^ *other))))
}

/// How often the first word of a key was sent.
fn keys_sent(rig: &Rig) -> usize {
    let key = rig.gauge.default_key(Name::Unseal).expect("a default key");
    let word = [0x00, key.bytes()[1], key.bytes()[0]];
    let sent = rig.sim.log().iter().filter(|record| record.write == word).count();
    // Some have the same word twice.
    if key.bytes()[..2] == key.bytes()[2..] { sent / 2 } else { sent }
}

/// One that has sealed itself takes no key for 4 s. All blocks were looked at before.
#[test]
fn regression_a_gauge_that_was_found_sealed_was_opened_once_more_after_its_restoration() {
    for (chip, values) in PARTS {
        let mut rig = Rig::new(chip);
        rig.is_found(Seal::Sealed);
        rig.sim.clear_log();
        let begun = rig.clock.now();
        assert!(matches!(rig.restore(&changes(chip, values)), Ok(Outcome::Written { .. })), "{chip}");
        let took = rig.clock.now() - begun;
        assert_eq!((keys_sent(&rig), rig.seal()), (1, Seal::Sealed), "{chip}");
        assert!(took < Duration::from_millis(2500), "{chip}: {took:?}");
    }
}

/// A gauge whose DesignCapacity() shows something else.
struct Shows {
    bus: SimBus,
    word: u16,
}

impl Bus for Shows {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.bus.transfer(write, read)?;
        if let ([0x3C], [low, high]) = (write, read) {
            [*low, *high] = self.word.to_le_bytes();
        }
        Ok(())
    }
}

/// What can be read of a sealed gauge is all that its restoration is proven by, so that what does not fit has it opened.
#[test]
fn a_sealed_gauge_that_does_not_show_its_new_capacity_is_looked_at_as_a_whole() {
    for (chip, values) in PARTS.iter().filter(|(chip, _)| !["bq27426", "bq27427"].contains(chip)) {
        for (word, opened) in [(1200, 1), (1199, 3)] {
            let mut rig = Rig::new(chip);
            rig.is_found(Seal::Sealed);
            let bus = Box::new(Shows { bus: rig.sim.bus(), word });
            let table = rig.gauge.chip;
            rig.gauge = Gauge::new(table, bus, rig.clock.clone(), Keys::default());
            rig.gauge.seal().expect("it answers");
            rig.sim.clear_log();
            let outcome = rig.restore(&changes(chip, values));
            // A bq27220 goes from FULL ACCESS to UNSEALED through SEALED.
            let opened = if *chip == "bq27220" { opened.min(2) } else { opened };
            assert!(outcome.is_ok(), "{chip} {word}: {outcome:?}");
            // The first key after it has sealed itself is refused.
            assert_eq!((keys_sent(&rig), rig.seal()), (opened, Seal::Sealed), "{chip} {word}");
        }
    }
}

/// It holds the default after a loss of power as well.
#[test]
fn a_bq27220_whose_profile_has_the_capacity_of_the_part_is_looked_at_as_a_whole() {
    for (capacity, reads) in [("1200", 0), ("3000", 1)] {
        let mut rig = Rig::new("bq27220");
        rig.is_found(Seal::Sealed);
        rig.sim.clear_log();
        let values = [((0, 0x929F), capacity), ((0, 0x91FD), "4100")];
        let change = |&((id, at), text): &((u8, u16), &str)| rig.change(id, at, text).saved();
        let changes: Vec<_> = values.iter().map(change).collect();
        assert!(matches!(rig.restore(&changes), Ok(Outcome::Written { .. })), "{capacity}");
        let log = rig.sim.log();
        let left = log.iter().position(|record| record.write == [0x00, 0x91, 0x00]).expect("the way out");
        let looks = log[left..].iter().filter(|record| record.write == [0x3E, 0xE0, 0x91]).count();
        assert_eq!(looks, reads, "{capacity}");
    }
}

/// Nothing else would show that it was loaded again.
#[test]
fn a_block_in_the_window_is_loaded_without_a_long_look() {
    let mut rig = Rig::new("bq27621-g1");
    rig.is_found(Seal::Unsealed);
    rig.sim.clear_log();
    let changes = changes("bq27621-g1", &[((82, 3), "1200")]);
    assert!(matches!(rig.restore(&changes), Ok(Outcome::Written { .. })));
    // A long look is at the checksum alone first, when it may be there.
    let mut selected = Duration::ZERO;
    for record in rig.sim.log() {
        match record.write[..] {
            [0x3e, ..] if record.read.is_empty() => selected = record.at,
            [0x60] => assert!(record.at - selected < Duration::from_millis(20), "{record}"),
            _ => {}
        }
    }
}
