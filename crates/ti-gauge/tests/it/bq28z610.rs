// SPDX-License-Identifier: MIT

//! The bq28z610: its table beside two dumps of a real pack, and the rules that its protector needs.

use std::collections::BTreeSet;
use std::time::Duration;

use gauge_bus::Bus;
use ti_gauge::chip::{Chip, FLAT, Limited, Parameter, Recognised, Row, bq28z610, recognise};
use ti_gauge::dataflash::Change;
use ti_gauge::error::{Cause, Error};
use ti_gauge::gauge::{Seal, Statistics};
use ti_gauge::image::{Format, Image};
use ti_gauge::notation;
use ti_gauge::value::Value;

use crate::rig::Rig;

/// Taken over from bq28z610-arduino-driver; each file says what of it is replaced.
const DUMPS: [&str; 2] =
    [include_str!("dumps/bq28z610-original.txt"), include_str!("dumps/bq28z610-20240710.txt")];
const BASE: usize = 0x4000;
const CHIP: &Chip = &bq28z610::CHIP;

fn bytes(dump: &str) -> Vec<u8> {
    let mut all = Vec::new();
    for line in dump.lines().filter(|line| line.starts_with("0x")) {
        let (address, row) = line.split_once(": ").expect("an address");
        let address = usize::from_str_radix(&address[2..], 16).expect("an address");
        assert_eq!(address, BASE + all.len());
        all.extend(row.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect("a byte")));
    }
    all
}

fn value(dump: &[u8], parameter: &Parameter) -> Value {
    let at = usize::from(parameter.offset) - BASE;
    CHIP.layout.decode(parameter.kind, &dump[at..at + parameter.kind.size()])
}

fn row(address: u16) -> Row {
    CHIP.row("flash", &format!("0x{address:04x}")).expect("a row")
}

/// Addresses, and what both dumps hold there as the table's type shows it: of each type, class and page one at least.
#[rustfmt::skip]
const VALUES: &[(u16, &str, &str)] = &[
    (0x4000, "12167", "12167"), (0x4002, "49197", "49197"), (0x4006, "1.8518518", "1.8518518"),
    (0x400A, "552336.3", "552336.3"), (0x4010, "64", "64"), (0x4014, "-3", "-3"), (0x4063, "0x36b2", "0x36b2"),
    (0x4095, "1352", "1352"), (0x40C1, "-188", "-187"), (0x4102, "325", "1238"), (0x415E, "9771", "1234"),
    (0x4182, "325", "1231"), (0x41DE, "9488", "1251"), (0x4202, "30", "30"), (0x4206, "4965", "3034"),
    (0x420C, "214", "101"), (0x420E, "0x0e", "0x0e"), (0x4215, "-426", "-511"), (0x421F, "-561", "-543"),
    (0x4240, "311", "103"), (0x4286, "-2197", "-2197"), (0x4288, "45", "49"), (0x42D0, "0x7b00", "0x7b00"),
    (0x43C0, "0x0078", "0x0078"), (0x4400, "-12143", "-12143"), (0x441A, "11703", "11703"), (0x4591, "15", "15"),
    (0x4594, "65142", "65142"), (0x4596, "59220", "59220"), (0x45BC, "5", "5"), (0x45BE, "6300", "6300"),
    (0x4600, "0x5c", "0x7c"), (0x460A, "6000", "6000"), (0x4618, "5", "5"), (0x461B, "10", "10"),
    (0x462A, "5100", "3400"), (0x462C, "3672", "2448"), (0x462E, "7200", "7200"), (0x4632, "0x0cef", "0x0ccf"),
    (0x4645, "6", "6"), (0x4647, "4200", "4200"), (0x464B, "100", "60"), (0x465F, "-25", "-25"),
    (0x4693, "330", "150"), (0x469B, "0x11", "0x11"), (0x46C9, "5000", "1300"), (0x46DB, "430", "370"),
    (0x46FA, "2", "2"), (0x4706, "-5", "-5"), (0x4710, "18000", "18000"), (0x4727, "-1", "-1"),
];

#[test]
fn both_dumps_decode_as_the_table_says() {
    for (dump, at) in DUMPS.map(bytes).iter().zip([0, 1]) {
        for &(address, first, second) in VALUES {
            let parameter = row(address).1;
            let shown = notation::render(parameter.kind, &value(dump, parameter));
            assert_eq!(shown, [first, second][at], "0x{address:04x} {}", parameter.name);
        }
        // What a source prints as a range holds what the part has, but for what was never set.
        for (_, parameter) in CHIP.rows().filter(|(_, row)| !row.unprinted) {
            let found = value(dump, parameter);
            assert!(notation::check(parameter, &found).is_ok(), "{}: {found:?}", parameter.name);
        }
        for sign in CHIP.signature {
            let at = usize::from(sign.offset) - BASE;
            let Value::Int(found) = CHIP.layout.decode(sign.kind, &dump[at..at + sign.kind.size()]) else {
                panic!("a number")
            };
            assert!(sign.holds(found), "0x{:04x} {found}", sign.offset);
        }
    }
}

#[test]
fn every_row_has_a_name_and_sixteen_are_written() {
    let names: BTreeSet<String> = CHIP.rows().map(|row| CHIP.name_of(row)).collect();
    assert_eq!(names.len(), 403);
    for found in CHIP.rows() {
        let name = CHIP.name_of(found);
        let (_, again) = CHIP.find(&name).expect(&name);
        assert!(std::ptr::eq(again, found.1), "{name}");
    }
    let written: Vec<u16> = CHIP.rows().filter(|(_, row)| !row.unproven).map(|(_, row)| row.offset).collect();
    assert_eq!(
        written,
        [
            0x406B, 0x4080, 0x4095, 0x4202, 0x4591, 0x4594, 0x4618, 0x4619, 0x461B, 0x461C, 0x4645, 0x4646,
            0x4647, 0x4649, 0x464B, 0x464C
        ]
    );
    // Groups that lie apart share a folder.
    for name in
        ["it-cfg/pack-resistance", "it-cfg/qmax-delta", "it-cfg/reserve-cap-mah", "ship/auto-ship-time"]
    {
        assert!(names.contains(name), "{name}");
    }
}

fn refusal(address: u16, text: &str) -> Error {
    Change::parse(CHIP, row(address), text.as_bytes(), true).expect_err("it is never written")
}

/// Whatever the user insists on: FETs, protections, records, calibration, and all by which the layout is recognised.
#[test]
fn what_opens_fets_or_switches_a_protection_off_is_never_written() {
    for (address, text) in [
        (0x4600, "0x20"),
        (0x4632, "0x0c8c"),
        (0x469B, "0x10"),
        (0x43C0, "0x0078"),
        (0x46AF, "0x57"),
        (0x46FC, "0x00"),
        (0x46B3, "2500"),
        (0x46C9, "6000"),
        (0x4700, "4500"),
        (0x4000, "12101"),
        (0x4006, "3.58"),
        (0x460C, "2500"),
        (0x466E, "4200"),
    ] {
        let error = refusal(address, text);
        assert_eq!(error.cause(), Cause::NotPermitted, "0x{address:04x}: {error}");
        assert!(error.to_string().contains("never written"), "{error}");
    }
    for sign in CHIP.signature {
        assert!(row(sign.offset).1.never.is_some(), "0x{:04x}", sign.offset);
    }
    let guarded = |row: &Row| ["Protections", "Permanent Fail", "PF Status"].contains(&row.0.class);
    assert!(CHIP.rows().filter(guarded).count() > 100);
    assert!(CHIP.rows().filter(guarded).all(|(_, row)| row.never.is_some()));
}

/// Neighbours that have to keep their order, alone and together.
#[test]
fn values_keep_their_order() {
    let refused = |values: &[((u8, u16), &str)]| {
        let mut rig = Rig::calibrated("bq28z610", Seal::Sealed);
        let before = rig.sim.flash();
        let error = rig.write_values(values).expect_err("out of order").to_string();
        assert!(rig.sim.flash() == before, "{error}");
        error
    };
    for (address, text) in [
        (0x461B, "21"),
        (0x461C, "9"),
        (0x4645, "8"),
        (0x4646, "6"),
        (0x4647, "4100"),
        (0x4649, "4200"),
        (0x464B, "55"),
        (0x464C, "60"),
        (0x4618, "0"),
        (0x4618, "21"),
        (0x4619, "21"),
    ] {
        refused_or_early(address, text, &refused);
    }
    refused(&[((FLAT, 0x461B), "30"), ((FLAT, 0x461C), "29")]);
    for values in [
        &[((FLAT, 0x461B), "20")][..],
        &[((FLAT, 0x461B), "40"), ((FLAT, 0x461C), "40")],
        &[((FLAT, 0x4645), "20"), ((FLAT, 0x4646), "21")],
        &[((FLAT, 0x464C), "90"), ((FLAT, 0x464B), "95")],
        &[((FLAT, 0x4080), "My pack")],
    ] {
        let mut rig = Rig::calibrated("bq28z610", Seal::Sealed);
        rig.write_values(values).expect("in order");
        assert_eq!(rig.sim.get("seal").expect("a knob"), "sealed");
    }
}

type Values<'a> = [((u8, u16), &'a str)];

/// A limit that needs no gauge is refused before anything is sent.
fn refused_or_early(address: u16, text: &str, refused: &dyn Fn(&Values<'_>) -> String) {
    if Change::parse(CHIP, row(address), text.as_bytes(), false).is_ok() {
        refused(&[((FLAT, address), text)]);
    }
}

/// MACData() still shows a block in which bits 9 and 8 of the first word say that the gauge is open.
#[test]
fn an_answer_of_something_else_is_no_seal_state() {
    let mut rig = Rig::new("bq28z610");
    rig.through(move |bus, write, read| {
        let done = bus.transfer(write, read);
        if write == [0x3e] && read.len() == 36 && read[..2] == [0x54, 0x00] {
            // The data of another answer, with its sum.
            read[2..4].copy_from_slice(&[0x86, 0x02]);
        }
        done
    });
    let error = rig.gauge.seal_anew().expect_err("no state").to_string();
    assert!(error.contains("another answer"), "{error}");
}

/// What the part takes 1 s to show is awaited: its keys are not called wrong before.
#[test]
fn a_seal_state_may_show_a_second_late() {
    let mut rig = Rig::new("bq28z610");
    rig.sim.set("status_ms", "1000").expect("a knob");
    rig.write(FLAT, 0x4202, "40").expect("written");
    assert_eq!(&rig.sim.flash()[0x202..0x204], &[40, 0]);
    assert_eq!(Statistics::read(&rig.gauge.statistics.keys), 1);
}

/// Data flash of a part that is read to its end, block by block, with a block read twice for each, also where no sum that is
/// read by itself is right: two looks at the whole must agree then.
#[test]
fn blocks_are_read_although_each_read_moves_on() {
    reads_all(&mut Rig::calibrated("bq28z610", Seal::Unsealed));
    let mut rig = Rig::calibrated("bq28z610", Seal::Unsealed);
    rig.through(|bus, write, read| {
        let done = bus.transfer(write, read);
        if let ([0x60], [sum]) = (write, &mut *read) {
            *sum ^= 1;
        }
        done
    });
    reads_all(&mut rig);
}

fn reads_all(rig: &mut Rig) {
    let whole = CHIP.subclasses.iter().collect::<Vec<_>>();
    let read = rig.dataflash.read(&mut rig.gauge, &whole, Duration::ZERO).expect("a read");
    let flash = rig.sim.flash();
    for (subclass, bytes) in whole.iter().zip(read) {
        let at = usize::from(subclass.start()) - BASE;
        assert_eq!(bytes, &flash[at..at + bytes.len()], "{}", subclass.name);
    }
}

/// No write needs a reset, and none is sent: FETs may be off while the part starts.
#[test]
fn no_write_resets() {
    let mut rig = Rig::calibrated("bq28z610", Seal::Sealed);
    rig.write(FLAT, 0x4202, "40").expect("written");
    let log = rig.log();
    assert!(!log.iter().any(|line| line.contains("00 12 00") || line.contains("00 41 00")), "{log:?}");
}

/// Answers to FW_VERSION with another build.
fn of_another_build(rig: &mut Rig) {
    rig.through(|bus, write, read| {
        let done = bus.transfer(write, read);
        if write == [0x40] && read.len() > 5 && read[..4] == [0x26, 0x10, 0x00, 0x17] {
            read[5] = 0x17;
        }
        done
    });
}

/// Version and build are in one answer. With a wrong bit it is asked for again, and so it is where another answer is there.
#[test]
fn a_firmware_is_known_by_one_answer() {
    for (at, asked) in [(None, 1), (Some(0), 3), (Some(3), 3), (Some(5), 3)] {
        let mut rig = Rig::new("bq28z610");
        let mut left = u32::from(at.is_some());
        rig.through(move |bus, write, read| {
            let done = bus.transfer(write, read);
            if let Some(at) = at.filter(|_| left > 0 && write == [0x40] && read.starts_with(&[0x26, 0x10])) {
                left -= 1;
                read[at] ^= 1;
            }
            done
        });
        rig.sim.clear_log();
        let answers = rig.gauge.identify().expect("it answers");
        assert_eq!((answers.firmware_version, answers.build), (0x0017, Some(0x0016)), "{at:?}");
        let log = rig.log();
        let sent = log.iter().filter(|line| *line == "W 3E 02 00" || *line == "W 00 02 00").count();
        assert_eq!(sent, asked, "{at:?}: {log:?}");
    }
}

/// It is read by its standard commands, and says of which build the table is.
#[test]
fn another_build_is_only_read() {
    let mut rig = Rig::new("bq28z610");
    of_another_build(&mut rig);
    let answers = rig.gauge.identify().expect("it answers");
    assert_eq!((answers.firmware_version, answers.build), (0x0017, Some(0x0017)));
    assert!(matches!(recognise(&answers), Recognised::Unproven(found) if found.len() == 1));
    let why = Limited::Unproven.why(CHIP, &answers);
    assert!(why.contains("firmware 0x0017 build 0x0017"), "{why}");
    assert!(why.contains("proven only for firmware 0x0017 build 0x0016"), "{why}");
}

/// The pack was exchanged for one with another build between the mount and the write.
#[test]
fn a_build_that_came_later_is_not_written() {
    let mut rig = Rig::calibrated("bq28z610", Seal::Sealed);
    let before = rig.sim.flash();
    of_another_build(&mut rig);
    let error = rig.write(FLAT, 0x4202, "40").expect_err("another build").to_string();
    assert!(error.contains("build is 0x0017"), "{error}");
    assert!(rig.sim.flash() == before, "{error}");
}

/// The second dump.
fn image() -> Image {
    let flash = bytes(DUMPS[1]);
    let read = CHIP.subclasses.iter().enumerate().map(|(index, subclass)| {
        let at = usize::from(subclass.start()) - BASE;
        (index, &flash[at..at + usize::from(subclass.length)])
    });
    Image::of_flash(CHIP, Some(0x0017), read)
}

/// Another tool that plays it must not reset the part, and finds none of the rows that are never written.
#[test]
fn a_flashstream_has_what_may_be_written_and_no_reset() {
    let text = image().write(Format::FlashStream, |_| Ok(Vec::new())).expect("a file");
    let words: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("W: AA 00 ")).collect();
    assert!(!words.iter().any(|word| ["12 00", "41 00"].contains(word)), "{words:?}");
    let rows = Image::parse(&text, None).unwrap_or_else(|error| panic!("{error}")).entries;
    let written: BTreeSet<u16> = rows.iter().map(|entry| entry.parameter.offset).collect();
    assert!(written.contains(&0x4594) && !written.contains(&0x4600) && written.len() == 16, "{written:x?}");
}

/// What a file has for such a row is passed over with the reason; the rest is imported.
#[test]
fn an_import_leaves_out_what_is_never_written() {
    let text = "chip = \"bq28z610\"\n\n[configuration]\nfet-options = 0x20\n\n\
                [it-cfg]\npack-resistance = 40\n";
    let file = Image::parse(text, None).unwrap_or_else(|error| panic!("{error}"));
    let here = image();
    let changes = here.changes(&file, &[], true).expect("values in range");
    assert_eq!(changes.changes.len(), 1);
    let [fets] = &changes.passed_over[..] else { panic!("{:?}", changes.passed_over) };
    assert!(fets.contains("fet-options") || fets.contains("FET Options"), "{fets}");
    assert!(
        fets.ends_with(CHIP.parameter(FLAT, 0x4600).and_then(|row| row.never).expect("a reason")),
        "{fets}"
    );
}
