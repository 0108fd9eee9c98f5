// SPDX-License-Identifier: MIT

//! Data flash of which only names are known: it is read, and nothing is written to it, whichever way is tried.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_sim::{Options, Sim};
use ti_gauge::authentication::Order;
use ti_gauge::chip::{
    Answers, CHIPS, Chip, Effect, Kind, Parameter, Range, Recognised, Subclass, bq27500, recognise,
};
use ti_gauge::dataflash::{Change, Decision, samples};
use ti_gauge::error::Cause;
use ti_gauge::gauge::Seal;
use ti_gauge::image::Image;
use ti_gauge::keys::{KeyChange, Name};
use ti_gauge::notation;
use ti_gauge::value::Value;
use ti_gauge::value::types::{H1, I2};

use crate::rig::Rig;
use crate::room::{Folder, cut, programs};

static DATA: &[Parameter] = &[Parameter::int(10, I2, "Design Capacity", 0, 32767, 1000, "mAh").unproven()];
static CODES: &[Parameter] = &[Parameter::any(0, H1, "Key", "hex")];
static MAKERS: &[Parameter] = &[Parameter::any(0, H1, "Block A 0", "hex").unproven()];

/// The bq27500 with one parameter, which nobody has proven.
fn unproven() -> &'static Chip {
    static CLASSES: &[Subclass] = &[
        Subclass { class: "C", name: "Data", id: 48, length: 32, kind: Kind::Reset, parameters: DATA },
        Subclass {
            class: "C",
            name: "Manufacturer Info",
            id: 57,
            length: 32,
            kind: Kind::Plain,
            parameters: MAKERS,
        },
        Subclass { class: "C", name: "Codes", id: 112, length: 8, kind: Kind::Security, parameters: CODES },
    ];
    let chip = Chip { subclasses: CLASSES, signature: &[], ..bq27500::CHIP.clone() };
    Box::leak(Box::new(chip))
}

/// A gauge with the whole table, whose own is [`unproven`].
fn rig() -> (Rig, &'static Chip) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("bq27500", &Options::default(), clock.clone()).expect("a chip that is simulated");
    sim.be_strict();
    sim.keep_log(true);
    clock.sleep(Duration::from_secs(1));
    let chip = unproven();
    let mut rig = Rig::on(chip, sim, clock);
    rig.gauge.seal().expect("the gauge answers");
    (rig, chip)
}

fn is_told<T: std::fmt::Debug>(outcome: Result<T, ti_gauge::error::Error>) {
    let error = outcome.expect_err("nothing is written");
    let text = error.to_string();
    assert_eq!(error.cause(), Cause::NotPermitted, "{text}");
    assert!(text.contains("bq27500") && text.contains("not one is proven"), "{text}");
    assert!(text.contains("gaugefs report"), "{text}");
}

#[test]
fn it_is_read_by_its_names() {
    let (mut rig, chip) = rig();
    assert!(chip.has_only_names() && !bq27500::CHIP.has_only_names());
    let read = rig.dataflash.read(&mut rig.gauge, &[&chip.subclasses[0]], Duration::ZERO).expect("the block");
    assert_eq!(read[0][10..12], [0x03, 0xe8]);
    assert_eq!(rig.seal(), Seal::Sealed);
}

/// A user who allows unproven rows has them where others prove the layout.
#[test]
fn no_change_of_it_can_be_made() {
    let chip = unproven();
    for also_unproven in [false, true] {
        is_told(Change::parse(chip, (&chip.subclasses[0], &DATA[0]), b"1200", also_unproven));
    }
    is_told(Change::raw(chip, (48, 0).into(), vec![1]));
    is_told(Change::raw(chip, (200, 0).into(), vec![1]));
    let of = |value| {
        let mut image = Image::new(chip, None);
        image.set(&chip.subclasses[0], &DATA[0], Value::Int(value));
        image
    };
    is_told(of(1000).changes(&of(1200), &[], true).map(drop));
    is_told(of(1000).changes(&of(1200), &[], false).map(drop));
}

/// A change that another table has made, as an interrupted write or a program has it.
#[test]
fn the_engine_writes_no_change_of_another_table() {
    let (mut rig, _) = rig();
    let chip = &bq27500::CHIP;
    let row = chip.row("48", "10").expect("Design Capacity");
    let change = Change::parse(chip, row, b"1200", false).expect("in its range");
    rig.sim.clear_log();
    let changes = std::slice::from_ref(&change);
    is_told(rig.dataflash.write(&mut rig.gauge, changes, Duration::ZERO));
    is_told(rig.dataflash.try_write(&mut rig.gauge, changes, Duration::ZERO));
    let (old, new) = ([0x0414, 0x3672].into(), [0x1234, 0x5678].into());
    let key = KeyChange { name: Name::Unseal, old, new };
    is_told(rig.dataflash.change_key(&mut rig.gauge, &key, Order::default(), Duration::ZERO));
    assert_eq!(rig.log(), Vec::<String>::new(), "nothing was sent");
}

/// A write that a table with proven rows had begun is neither finished nor undone.
#[test]
fn an_interrupted_write_is_not_settled_there() {
    let folder = Folder::new("only-names");
    let mut proven = Rig::calibrated("bq27500", Seal::Sealed);
    let changes = [proven.change(48, 10, "1200"), proven.change(80, 48, "3100")];
    cut(&mut proven, &folder, &changes, programs);
    let flash = proven.sim.flash();
    let mut rig = Rig::on(unproven(), proven.sim, proven.clock);
    rig.start(&folder);
    rig.arrive().expect_err("it is left to a person");
    for decision in [Decision::Undo(None), Decision::Finish(None)] {
        rig.dataflash.decide(&mut rig.gauge, decision, Duration::ZERO).expect_err("nothing is written");
    }
    assert!(rig.sim.flash() == flash);
    assert!(folder.text().is_some(), "the journal is kept");
}

/// Blocks of the maker's are no evidence, and keys are never read.
#[test]
fn a_report_has_the_blocks_that_could_prove_its_rows() {
    let chip = unproven();
    assert_eq!(samples(chip), [0]);
    let rows: Vec<_> = chip.believed_rows().iter().map(|(subclass, row)| (subclass.id, row.offset)).collect();
    assert!(rows.contains(&(48, 10)) && !rows.contains(&(57, 0)), "{rows:?}");
}

/// The tables of this state: no row of theirs can be written, and no subcommand that may be sent changes anything.
#[test]
fn the_tables_of_names_take_nothing() {
    let mut names = Vec::new();
    for chip in CHIPS.iter().copied().filter(|chip| chip.has_only_names()) {
        for row in chip.rows() {
            let least = match row.1.range {
                Range::Int { min, .. } => Value::Int(min),
                _ => panic!("{}: {}", chip.name, row.1.name),
            };
            let error = Change::of_value(chip, row, &least, true).expect_err("nothing is written");
            assert_eq!(error.cause(), Cause::NotPermitted, "{error}");
        }
        for one in chip.subcommands {
            assert!(one.effect != Effect::Safe, "{}: {}", chip.name, one.name);
        }
        assert!(
            chip.calibration.is_none() && chip.gate.is_none() && chip.signature.is_empty(),
            "{}",
            chip.name
        );
        names.push(chip.name);
    }
    assert_eq!(names, ["bq27541-g1", "bq27542-g1", "bq27545-g1"]);
}

/// 0x0541 is answered by four parts; another firmware has another layout, or none that is known.
#[test]
fn type_and_firmware_decide_whose_names_are_shown() {
    let found = |device_type, firmware_version| match recognise(&Answers {
        device_type,
        firmware_version,
        ..Answers::default()
    }) {
        Recognised::Chip(chip) => chip.name.to_string(),
        Recognised::Sibling(sibling) => format!("sibling {}", sibling.name),
        Recognised::Ambiguous(chips) => chips.iter().map(|chip| chip.name).collect::<Vec<_>>().join(" or "),
        other => format!("{other:?}"),
    };
    assert_eq!(found(0x0541, 0x0224), "bq27541-g1");
    assert_eq!(found(0x0541, 0x0200), "sibling bq27541-V200");
    assert_eq!(found(0x0541, 0x0100), "bq27541 or bq27546");
    assert_eq!(found(0x0542, 0x0201), "bq27542-g1");
    assert_eq!(found(0x0542, 0x0100), "sibling bq27542");
    assert_eq!(found(0x0545, 0x0200), "Unknown", "only its name says what it answers");
    assert_eq!(found(0x0546, 0x0200), "Unknown");
}

/// Beside the block of a fresh part (E2E 909149) and the worked example of SLUSAL6C: class 80, block 2, 0x43.
#[test]
fn names_show_what_real_parts_hold() {
    for (chip, rows) in [
        (
            "bq27542-g1",
            &[
                ("48", "0", "3800"),
                ("48", "8", "5"),
                ("48", "12", "1000"),
                ("48", "14", "3800"),
                ("48", "16", "-400"),
                ("48", "23", "1"),
                ("81", "6", "60"),
                ("81", "9", "400"),
            ][..],
        ),
        ("bq27541-g1", &[("80", "67", "3000"), ("64", "0", "0x1177"), ("68", "13", "2550")]),
        ("bq27545-g1", &[("2", "0", "550"), ("48", "23", "1000"), ("36", "9", "-1")]),
    ] {
        let mut rig = Rig::new(chip);
        for (id, offset, shown) in rows {
            let (subclass, parameter) = rig.gauge.chip.row(id, offset).expect("a row");
            let bytes =
                rig.dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO).expect("a read").remove(0);
            let at = usize::from(parameter.offset);
            let value = rig.gauge.chip.layout.decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
            assert_eq!(notation::render(parameter.kind, &value), *shown, "{chip} {id}/{offset}");
        }
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        let sent = rig.log();
        assert!(
            sent.iter().any(|line| line.starts_with("W 3E "))
                && !sent.iter().any(|line| line.starts_with("W 60 "))
        );
    }
    let mut rig = Rig::new("bq27541-g1");
    rig.gauge.unseal().expect("the family's key");
    for (code, byte) in [(0x61, 0x00), (0x3e, 0x50), (0x3f, 0x02)] {
        rig.gauge.write(code, &[byte]).expect("a selection");
    }
    rig.clock.sleep(Duration::from_millis(50));
    let mut word = [0; 2];
    rig.gauge.read(0x43, &mut word).expect("Terminate Voltage");
    assert_eq!(u16::from_be_bytes(word), 3000);
}
