// SPDX-License-Identifier: MIT

//! A gauge that drives the FETs of its pack: what may not be written, what may not be sent, and which values would cut the
//! pack off.

use std::time::Duration;

use gauge_bus::clock::Clock;
use sha1::{Digest, Sha1};
use ti_gauge::chip::{Chip, Effect, Kind, Safe};
use ti_gauge::dataflash::{Change, Decision, Outcome};
use ti_gauge::error::{Cause, Error};
use ti_gauge::gauge::Seal;
use ti_gauge::image::{Format, Image};
use ti_gauge::value::Value;

use crate::rig::{Rig, cause};
use crate::room::{Folder, cut, programs};

const CHIP: &str = "bq27742-g1";

const STORED: Outcome = Outcome::Written { reset: false, old: Vec::new() };

fn chip() -> &'static Chip {
    Chip::by_name(CHIP).expect("it has a table")
}

/// Whether RESET was sent.
fn was_reset(rig: &Rig) -> bool {
    rig.log().iter().any(|line| line == "W 00 41 00")
}

/// The bytes that the gauge has of a subclass.
fn stored(rig: &Rig, id: u8) -> Vec<u8> {
    let lengths = chip().subclasses.iter().take_while(|row| row.id < id).map(|row| usize::from(row.length));
    let length = usize::from(chip().subclass(id).expect("a subclass").length);
    rig.sim.flash().into_iter().skip(lengths.sum()).take(length).collect()
}

/// What has opened the FETs.
fn fets(rig: &Rig) -> String {
    rig.clock.sleep(Duration::from_secs(3));
    let _ = rig.sim.get("fets");
    rig.clock.sleep(Duration::from_secs(3));
    rig.sim.get("fets").expect("the part drives FETs")
}

/// The FETs open for a moment with RESET, and with them the host's power.
#[test]
fn a_write_is_stored_without_a_reset() {
    assert!(chip().is_never_reset());
    for found in [Seal::Sealed, Seal::Unsealed, Seal::FullAccess] {
        let mut rig = Rig::found(CHIP, found);
        rig.sim.clear_log();
        assert_eq!(rig.write(48, 12, "1200"), Ok(STORED), "{found:?}");
        assert_eq!(rig.write(2, 0, "4350"), Ok(STORED), "{found:?}");
        assert_eq!((rig.read(48, 12), rig.seal()), (Ok(vec![0x04, 0xb0]), found));
        assert!(!was_reset(&rig), "{found:?}");
        assert_eq!(fets(&rig), "closed", "{found:?}");
    }
    let change = Rig::new(CHIP).change(48, 12, "1200");
    assert!(change.waits(chip()), "it counts from the gauge's next start on");
    let info = Change::of_value(chip(), chip().row("58", "0").expect("a row"), &Value::Int(1), true);
    assert!(!info.expect("a byte").waits(chip()), "nothing uses it");
}

/// Whatever goes wrong, on the way back as well.
#[test]
fn no_failure_leads_to_a_reset() {
    let at = |word: &str| (1..60).map(|at| format!("{word} {at}")).collect::<Vec<_>>();
    let faults = ["nack", "lost", "short"].into_iter().flat_map(at);
    for fault in faults.chain(["drop-commit", "corrupt-commit", "torn-commit 7"].map(String::from)) {
        let mut rig = Rig::new(CHIP);
        rig.sim.clear_log();
        rig.sim.set("fault", &fault).expect("a fault");
        let _ = rig.write(2, 0, "4350");
        rig.sim.set("fault", "none").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(5));
        let _ = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO);
        assert!(!was_reset(&rig), "{fault}");
        assert_eq!(fets(&rig), "closed", "{fault}");
    }
}

/// A wrong bit in what is sent may select another block, 64 among them. In a subcommand it may be any other one, and no
/// host can help that.
#[test]
fn no_wrong_bit_reaches_the_protectors_blocks() {
    for ((id, offset), text) in [((68, 2), "20"), ((80, 64), "3100")] {
        let mut rig = Rig::calibrated(CHIP, Seal::Unsealed);
        rig.sim.clear_log();
        let guarded = |rig: &Rig| [57, 64].map(|id| stored(rig, id));
        let before = guarded(&rig);
        rig.write(id, offset, text).expect("no fault");
        let sent: Vec<_> = rig.sim.log().into_iter().map(|record| record.write).collect();
        let bits = |write: &[u8]| (0..write.len().min(4)).flat_map(|byte| (0..8).map(move |bit| (byte, bit)));
        for (at, write) in sent.iter().enumerate().filter(|(_, write)| write[0] != 0x00) {
            for (byte, bit) in bits(write) {
                let fault = format!("flip {} {byte} {bit}", at + 1);
                let mut rig = Rig::calibrated(CHIP, Seal::Unsealed);
                rig.sim.set("fault", &fault).expect("a fault");
                let _ = rig.write(id, offset, text);
                assert!(guarded(&rig) == before, "{id}/{offset}, {fault}");
                assert_eq!(fets(&rig), "closed", "{id}/{offset}, {fault}");
            }
        }
    }
}

/// A write that was cut short is settled without one.
#[test]
fn an_interrupted_write_is_settled_without_a_reset() {
    let folder = Folder::new("protector");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let changes = [rig.change(2, 0, "4350"), rig.change(48, 12, "1200")];
    cut(&mut rig, &folder, &changes, programs);
    rig.sim.clear_log();
    rig.arrive().expect("it is settled");
    assert!(rig.dataflash.owed().is_none() && !was_reset(&rig));
    assert_eq!(rig.read(2, 0), Ok(vec![0x11, 0x26]), "half of it is undone");
    assert_eq!(fets(&rig), "closed");
    // One whose journal asks for a reset, as a table without this rule has left it.
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    cut(&mut rig, &folder, &changes, programs);
    rewrite(&folder, |plan| plan.replacen("reset false", "reset true", 1));
    rig.start(&folder);
    rig.sim.clear_log();
    let _ = rig.arrive();
    assert!(!was_reset(&rig));
    assert_eq!(fets(&rig), "closed");
}

/// Changes the plan in a journal.
fn rewrite(folder: &Folder, change: impl Fn(&str) -> String) {
    let path = folder.journal().path().to_path_buf();
    let text = std::fs::read_to_string(&path).expect("a journal");
    let at = text.find("\nreset false\n").expect("it asks for none") + 1;
    let (plan, _) = text[at..].split_once("end ").expect("it is whole");
    let plan = change(plan);
    let sum: String = Sha1::digest(&plan).iter().map(|byte| format!("{byte:02x}")).collect();
    std::fs::write(&path, format!("{}{plan}end {sum}\n", &text[..at])).expect("a journal");
}

/// One whose journal has the protector's block, as a table without this rule would have left it.
#[test]
fn an_interrupted_write_of_the_protectors_block_is_not_finished() {
    let folder = Folder::new("protector-block");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let changes = [rig.change(2, 0, "4350"), rig.change(48, 12, "1200")];
    cut(&mut rig, &folder, &changes, programs);
    let old = "097fa7b9830a07".to_string() + &"00".repeat(25);
    let new = old.replacen("07000", "00000", 1);
    rewrite(&folder, |plan| {
        let lines = plan.lines().map(|line| match line.starts_with("block 48 ") {
            true => format!("block 64 0 00000040 {old} {new}\n"),
            false => format!("{line}\n"),
        });
        lines.collect()
    });
    rig.start(&folder);
    let before = stored(&rig, 64);
    let finished = rig.dataflash.decide(&mut rig.gauge, Decision::Finish(None), Duration::ZERO);
    let error = finished.expect_err("it is never written");
    assert!(error.to_string().contains("never written"), "{error}");
    assert!(stored(&rig, 64) == before);
    assert_eq!(fets(&rig), "closed");
}

/// 64/5 and 64/6 have their sum in 57/12; the FETs open for good while it differs. A charger may follow 39.
#[test]
fn the_protectors_rows_and_their_blocks_are_never_written() {
    for (id, why) in [(57, "FETs"), (64, "FETs"), (39, "charger")] {
        let subclass = chip().subclass(id).expect("a subclass");
        assert!(!subclass.parameters.is_empty());
        for row in subclass.parameters {
            for value in [0, 1] {
                let refused = Change::of_value(chip(), (subclass, row), &Value::Int(value), true);
                let error = refused.expect_err(row.name);
                assert!(cause(&error) == "not-permitted" && error.to_string().contains(why), "{error}");
            }
        }
    }
}

/// Not beside a row either: a block is written as a whole.
#[test]
fn bytes_that_nobody_has_documented_are_never_written() {
    for id in [2, 48, 57, 64, 68, 200] {
        for offset in 0..64 {
            let error = Change::raw(chip(), (id, offset).into(), vec![0]).expect_err("any byte");
            assert_eq!(cause(&error), "not-permitted", "{id}/{offset}: {error}");
        }
    }
}

#[test]
fn no_subcommand_that_moves_the_fets_is_sent() {
    for code in [0x0013, 0x0024, 0x0041] {
        let one = chip().subcommand(code).expect("a row");
        assert_eq!(one.effect, Effect::Never, "{}", one.name);
    }
    let mut image = Image::new(chip(), Some(0x0103));
    let (subclass, row) = chip().row("48", "12").expect("a row");
    image.set(subclass, row, Value::Int(1200));
    let text = image.write(Format::FlashStream, |_| Ok(vec![0; 32])).expect("a file");
    assert!(text.contains("W: AA 3E 30 00") && !text.contains("W: AA 00 41 00"), "{text}");
    let (subclass, row) = chip().row("64", "0").expect("a row");
    image.set(subclass, row, Value::Int(1));
    let text = image.write(Format::FlashStream, |_| Ok(vec![0; 32])).expect("a file");
    assert!(!text.contains("W: AA 3E 40"), "{text}");
}

fn told(rig: &mut Rig, id: u8, offset: u16, text: &str) -> Error {
    let flash = rig.sim.flash();
    let error = rig.write(id, offset, text).expect_err(text);
    assert!(rig.sim.flash() == flash, "{id}/{offset} {text}");
    assert_eq!(error.cause(), Cause::OutOfRange, "{error}");
    error
}

/// 0 switches a protection off.
#[test]
fn no_protection_is_switched_off() {
    let mut rig = Rig::new(CHIP);
    for offset in [2, 7, 14, 19] {
        told(&mut rig, 2, offset, "0");
        assert_eq!(rig.write(2, offset, "1").map(drop), Ok(()), "{offset}");
    }
}

/// A protection ends on the safe side of where it begins, also if both are written together.
#[test]
fn thresholds_keep_their_order() {
    let mut rig = Rig::new(CHIP);
    rig.sim.set("voltage_mv", "3700").expect("a knob");
    for (offset, text) in [(3, "4390"), (0, "4290"), (5, "2900"), (8, "2800"), (15, "550"), (20, "600")] {
        told(&mut rig, 2, offset, text);
    }
    let pair = [rig.change(2, 0, "4300"), rig.change(2, 3, "4200")];
    assert!(rig.dataflash.write(&mut rig.gauge, &pair, Duration::ZERO).is_ok());
    let crossed = [rig.change(2, 0, "4400"), rig.change(2, 3, "4450")];
    let error = rig.dataflash.write(&mut rig.gauge, &crossed, Duration::ZERO).expect_err("crossed");
    assert_eq!(error.cause(), Cause::OutOfRange, "{error}");
}

/// The protection would open a FET within a second.
#[test]
fn no_threshold_is_beyond_what_is_measured_now() {
    let mut rig = Rig::new(CHIP);
    let at = |rig: &mut Rig, voltage: &str, temperature: &str| {
        rig.sim.set("voltage_mv", voltage).expect("a knob");
        rig.sim.set("temperature", temperature).expect("a knob");
        rig.clock.sleep(Duration::from_secs(3));
    };
    at(&mut rig, "4250", "250");
    told(&mut rig, 2, 0, "4295");
    assert_eq!(rig.write(2, 0, "4340").map(drop), Ok(()));
    at(&mut rig, "3000", "250");
    told(&mut rig, 2, 5, "2980");
    told(&mut rig, 2, 8, "2990");
    assert_eq!(rig.write(2, 5, "2700").map(drop), Ok(()));
    at(&mut rig, "3700", "520");
    told(&mut rig, 2, 12, "540");
    told(&mut rig, 2, 17, "560");
    assert_eq!(rig.write(2, 17, "650").map(drop), Ok(()));
    let error = told(&mut rig, 2, 17, "701");
    assert!(error.to_string().contains("70 degrees"), "{error}");
    // One that stays is no matter, as in a file with all values.
    at(&mut rig, "3700", "540");
    assert_eq!(rig.write(2, 12, "550"), Ok(Outcome::Unchanged));
    assert_eq!(fets(&rig), "closed");
}

/// Above the present voltage the gauge would take no further write.
#[test]
fn the_gate_stays_open() {
    let mut rig = Rig::new(CHIP);
    for text in ["2499", "3001", "0"] {
        told(&mut rig, 68, 0, text);
    }
    rig.sim.set("voltage_mv", "2900").expect("a knob");
    rig.clock.sleep(Duration::from_secs(3));
    told(&mut rig, 68, 0, "2950");
    assert_eq!(rig.write(68, 0, "2600").map(drop), Ok(()));
    // Shutdown V, whose range nobody prints.
    told(&mut rig, 68, 10, "2860");
    assert_eq!(rig.write(68, 10, "2500").map(drop), Ok(()));
    assert_eq!(fets(&rig), "closed");
}

/// Every limit of the table is one of the kinds that are tested here.
#[test]
fn the_table_has_the_limits_that_the_hazards_need() {
    let mut seen = Vec::new();
    for (subclass, row) in chip().rows().filter(|(subclass, _)| subclass.kind != Kind::Security) {
        let Some(safe) = &row.safe else { continue };
        let kinds = safe.each().iter().map(|one| match one {
            Safe::AtLeast(1, _) => "at least 1",
            Safe::Within(0, 700, _) => "to 700",
            Safe::BelowVoltage(_) => "gate",
            Safe::Under(..) => "under",
            Safe::Over(..) => "over",
            Safe::AboveNow(..) => "above now",
            Safe::BelowNow(..) => "below now",
            other => panic!("{}: {other:?}", row.name),
        });
        seen.push(format!("{}/{} {}", subclass.id, row.offset, kinds.collect::<Vec<_>>().join(", ")));
    }
    assert_eq!(
        seen,
        [
            "2/0 over, above now",
            "2/2 at least 1",
            "2/3 under",
            "2/5 under, below now",
            "2/7 at least 1",
            "2/8 over, below now",
            "2/12 to 700, over, above now",
            "2/14 at least 1",
            "2/15 under",
            "2/17 to 700, over, above now",
            "2/19 at least 1",
            "2/20 under",
            "48/12 at least 1",
            "48/14 at least 1",
            "68/0 gate",
            "68/10 below now",
        ]
    );
    let written: Vec<_> = chip()
        .rows()
        .filter(|(subclass, row)| subclass.kind != Kind::Security && !row.unproven)
        .map(|(subclass, row)| (subclass.id, row.offset))
        .collect();
    // Rows of two sources, the two keys apart.
    let shown = |source: &str| chip().rows().filter(|(_, row)| row.source.contains(source)).count();
    assert_eq!((shown("SLUUAX0C"), shown("driver")), (65, 250));
    assert_eq!(
        written,
        [
            (2, 0),
            (2, 2),
            (2, 3),
            (2, 5),
            (2, 7),
            (2, 8),
            (2, 10),
            (2, 12),
            (2, 14),
            (2, 15),
            (2, 17),
            (2, 19),
            (2, 20),
            (48, 12),
            (48, 14),
            (68, 0),
            (68, 2),
            (80, 64)
        ]
    );
}
