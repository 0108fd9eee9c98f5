//! What becomes of a write or a read that fails half way: its journal, the pack it belongs to, the seal, the old
//! values, and the time that it takes.

use std::fs;
use std::panic::resume_unwind;
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use gauge_sim::SimBus;
use ti_gauge::dataflash::{Change, DataFlash, Decision, Limits, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

use crate::journal::{Folder, PowerCut, until_cut};
use crate::rig::{Rig, cause};

/// Where two images differ, with both bytes.
fn differences(one: &[u8], other: &[u8]) -> Vec<(usize, u8, u8)> {
    (0..one.len()).filter(|&at| one[at] != other[at]).map(|at| (at, one[at], other[at])).collect()
}

type Transferred = std::result::Result<(), BusError>;

/// A bus that hands each transfer to a function, with its number.
struct Through<F> {
    bus: SimBus,
    number: u64,
    act: F,
}

impl<F> Bus for Through<F>
where
    F: FnMut(&mut SimBus, u64, &[u8], &mut [u8]) -> Transferred + Send,
{
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Transferred {
        self.number += 1;
        (self.act)(&mut self.bus, self.number, write, read)
    }

    fn set_secret(&mut self, secret: bool) {
        self.bus.set_secret(secret);
    }
}

impl Rig {
    /// A program starts at the place of that folder's journal.
    fn start(&mut self, folder: &Folder) {
        self.start_with(folder, Keys::default(), |bus, _, write, read| bus.transfer(write, read));
    }

    /// The same with keys, on a bus that hands each transfer to a function.
    fn start_with(
        &mut self,
        folder: &Folder,
        keys: Keys,
        act: impl FnMut(&mut SimBus, u64, &[u8], &mut [u8]) -> Transferred + Send + 'static,
    ) {
        let bus = Through { bus: self.sim.bus(), number: 0, act };
        self.gauge = Gauge::new(self.gauge.chip, Box::new(bus), self.clock.clone(), keys, false);
        self.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    }

    /// The gauge arrives, and what is owed to it is settled.
    fn arrive(&mut self) -> Result<Option<String>> {
        let answers = self.gauge.identify()?;
        self.dataflash.meet(self.gauge.chip, &answers);
        self.settle()
    }

    fn settle(&mut self) -> Result<Option<String>> {
        self.dataflash.settle(&mut self.gauge, Duration::ZERO)
    }

    fn write_all(&mut self, changes: &[Change]) -> Result<Outcome> {
        self.dataflash.write(&mut self.gauge, changes, Duration::ZERO)
    }

    fn set(&self, knob: &str, value: &str) {
        self.sim.set(knob, value).expect("a knob");
    }

    fn get(&self, knob: &str) -> String {
        self.sim.get(knob).expect("a knob")
    }

    /// Power is lost and comes back.
    fn power_cycle(&self) {
        self.set("power", "off");
        self.set("power", "on");
        self.clock.sleep(Duration::from_secs(3));
    }

    fn pause(&self, seconds: u64) {
        self.clock.sleep(Duration::from_secs(seconds));
    }
}

impl Folder {
    fn text(&self) -> Option<String> {
        fs::read_to_string(self.journal().path()).ok()
    }
}

fn programs(write: &[u8]) -> bool {
    matches!(write, [0x60, _, ..])
}

/// A change of two blocks, the first of which is that of the serial number.
fn two_blocks(rig: &Rig) -> [Change; 2] {
    [rig.change(48, 11, "2200"), rig.change(80, 53, "3100")]
}

/// The host loses power right after the first transfer of a write for which `at` holds.
fn cut(rig: &mut Rig, folder: &Folder, changes: &[Change], at: impl Fn(&[u8]) -> bool + Send + 'static) {
    rig.start_with(folder, Keys::default(), move |bus, _, write, read| {
        let done = bus.transfer(write, read);
        if at(write) {
            resume_unwind(Box::new(PowerCut));
        }
        done
    });
    let said = until_cut(|| rig.write_all(changes));
    assert!(said.is_none(), "the host loses power: {said:?}");
    rig.start(folder);
    rig.pause(5);
}

/// The first of two blocks is new, and the second one is old.
fn half_way(rig: &mut Rig, folder: &Folder) {
    let changes = two_blocks(rig);
    cut(rig, folder, &changes, programs);
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
        let keys = Keys { no_default: fault == "no key", ..Keys::default() };
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
            assert!(error.to_string().contains("interrupted write"), "{fault}: {error}");
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
    assert_eq!(cause(&error), "StateUnknown", "{error}");
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
        assert_eq!(cause(&error), "Busy", "{name}: {error}");
        let owed = rig.dataflash.owed().expect(name);
        assert!(owed.needs_decision && owed.why.contains("gaugefs settle"), "{name}: {}", owed.why);
        for _ in 0..2 {
            let refused = rig.write(58, 3, "0x5a").expect_err(name);
            assert_eq!(cause(&refused), "Busy", "{name}: {refused}");
            assert!(refused.to_string().contains(&owed_reason(&error.to_string())), "{name}: {refused}");
            rig.arrive().expect_err(name);
        }
        let present = rig.read(48, 11).expect("it can be read");
        let present = u16::from_be_bytes([present[0], present[1]]);
        let shown = rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it can be read");
        let line = format!("48/11\tDesign Capacity\t1000\t2200\t{present}\n");
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
        for decision in [Decision::Undo, Decision::Finish, Decision::Discard] {
            let at = format!("{name}, {decision:?}");
            let folder = Folder::new("decided");
            let mut rig = stale(&folder);
            rig.start(&folder);
            rig.arrive().expect_err(name);
            let (flash, journal) = (rig.sim.flash(), folder.text());
            let said = rig.dataflash.decide(&mut rig.gauge, decision, Duration::ZERO);
            let said = said.unwrap_or_else(|error| panic!("{at}: {error}"));
            let values = (rig.read(48, 11).expect("a read"), rig.read(80, 53).expect("a read"));
            let (old, new) = (vec![0x03, 0xe8], vec![0x08, 0x98]);
            match decision {
                Decision::Undo => assert_eq!(values, (old, vec![0x0b, 0xb8]), "{at}: {said}"),
                Decision::Finish => assert_eq!(values, (new, vec![0x0c, 0x1c]), "{at}: {said}"),
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
                _ => assert_eq!(folder.files(), Vec::<String>::new(), "{at}"),
            }
            assert_eq!(rig.seal(), Seal::Sealed, "{at}");
            assert!(rig.write(58, 3, "0x5a").is_ok(), "{at}");
        }
    }
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
    assert!(said.contains("dismissed"), "{said}");
    assert!(rig.sim.flash() == flash);
    assert_eq!((rig.get("programmed"), rig.get("resets")), (programmed, resets));
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec!["i2c-1-55.dismissed".to_string()]));
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
            assert_eq!(cause(&error), "StateUnknown", "{at}: {error}");
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
                assert_eq!(cause(&outcome.expect_err(&at)), "Busy", "{at}");
                assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err(&at)), "Busy", "{at}");
                assert!(rig.sim.flash() == torn && folder.text().is_some(), "{at}");
                let undone = rig.dataflash.decide(&mut rig.gauge, Decision::Undo, Duration::ZERO);
                undone.expect("a person knows the pack");
                assert!(rig.sim.flash() == old, "{at}");
            }
            assert_eq!(rig.seal(), Seal::Sealed, "{at}");
        }
    }
}
