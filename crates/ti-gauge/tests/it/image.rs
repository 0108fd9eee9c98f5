//! Images of TI's tools on simulated gauges, bit for bit.

use std::collections::BTreeMap;
use std::time::Duration;

use ti_gauge::chip::Kind;
use ti_gauge::dataflash::Change;
use ti_gauge::image::Image;

use crate::rig::{Rig, first_address};

/// The blocks of TI's image for a BQ27220 with firmware 0.03, with other values: 0x418F is one-time programmable memory.
const BLOCKS_OF_A_BQ27220: [(u16, &str); 20] = [
    (0x91F5, "00 0A 01 F4 00 1E 00 FA 10 36"),
    (0x9201, "00 50"),
    (0x9232, "02 30 03 01 FE 02 62 04 02 30 F4"),
    (0x9206, "04 84 10 00"),
    (0x920B, "02 09 00 00 A0 00 B4"),
    (0x9212, "02 20"),
    (0x9217, "00 0C 06 00 3C 01 B8 15 16"),
    (0x9228, "00 40 00 50 00 2A 00 46 3D 02"),
    (0x9240, "0A 90 03 0A F8"),
    (0x927F, "0C 8C 8C 0A F4 0B 58 01 06 10 60 0F FC 63 5E 0B 5C 0B BC 07 09 10 5E 0F FA 62 5D"),
    (0x929A, "00 10 2A 0C B2 0C B2"),
    (0x418F, "00"),
    (0x927D, "50"),
    (0x9251, "02 B2"),
    (0x925B, "75"),
    (0x9264, "05 AA"),
    (0x9268, "15 00 01 00 C0 00 01 63 62 08 0E 70 00 60 1F 00"),
    (
        0x92A3,
        "0E 0F 00 60 0E 9E 00 94 03 60 0F BC 01 3B 08 01 02 0B D0 02 0D 38 02 0D AC 02 10 4C 0F CA 0F 54",
    ),
    (0x92C3, "0E EC 0E 8C 0E 47 0E 22 0D FD 0D BA 0D 6D 0A 98"),
    (0x927B, "03 3D"),
];

fn unhex(text: &str) -> Vec<u8> {
    text.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect("hexadecimal")).collect()
}

/// The configuration of a gauge.
fn image_of(rig: &mut Rig) -> Image {
    let rows = rig.gauge.chip.subclasses.iter().enumerate();
    let rows: Vec<_> = rows.filter(|(_, row)| row.kind != Kind::Security).collect();
    let subclasses: Vec<_> = rows.iter().map(|(_, row)| *row).collect();
    let read = rig.dataflash.read(&mut rig.gauge, &subclasses, Duration::ZERO).expect("the default keys");
    let firmware = rig.gauge.firmware_version().expect("it answers");
    let read = rows.iter().zip(&read).map(|((index, _), bytes)| (*index, &bytes[..]));
    Image::of_flash(rig.gauge.chip, Some(firmware), read)
}

/// Imports a file. Returns what of it is passed over.
fn import(rig: &mut Rig, text: &str) -> Vec<String> {
    let here = image_of(rig);
    let mut file = Image::parse(text, Some(rig.gauge.chip)).expect("an image");
    file.keep_reserved(&here);
    let changes = here.changes(&file, &[], false).expect("values in range");
    let change = |entry: &ti_gauge::image::Entry| {
        Change::of_value((entry.subclass, entry.parameter), &entry.value).expect("it fits its type")
    };
    let all: Vec<_> = changes.changes.iter().map(|difference| change(difference.new)).collect();
    rig.dataflash.write(&mut rig.gauge, &all, Duration::ZERO).expect("it is written");
    assert!(image_of(rig).changes(&file, &[], false).expect("the same").changes.is_empty());
    changes.passed_over
}

#[test]
fn regression_tis_image_of_a_bq27220_is_imported_and_read_back_bit_for_bit() {
    let mut text = "; Verify\nW: AA 3E 02 00\nC: AA 3E 02 00 02 20 00 03\n".to_string();
    for (address, bytes) in BLOCKS_OF_A_BQ27220 {
        let [low, high] = address.to_le_bytes();
        let all = unhex(bytes);
        let sum = all.iter().chain(&[low, high]).fold(0_u8, |sum, &byte| sum.wrapping_add(byte));
        let (select, length) = (format!("AA 3E {low:02X} {high:02X}"), all.len() + 4);
        text += &format!("W: {select} {bytes}\nW: AA 60 {:02X} {length:02X}\nX: 10\n", !sum);
        text += &format!("W: {select}\nC: {select} {bytes}\n");
    }
    let mut rig = Rig::new("bq27220");
    assert_eq!(
        import(&mut rig, &text),
        ["line 60: 0x418f: 1 byte of one-time programmable memory, which gaugefs never writes"]
    );
    let flash = rig.sim.flash();
    let first = first_address(rig.gauge.chip);
    let stored: BTreeMap<_, _> = (first..).zip(flash).collect();
    for (address, bytes) in BLOCKS_OF_A_BQ27220.into_iter().filter(|(address, _)| *address >= 0x9000) {
        for (at, byte) in (usize::from(address)..).zip(unhex(bytes)) {
            assert_eq!(stored.get(&at), Some(&byte), "0x{at:04x}");
        }
    }
    // Nothing was sent to the memory that cannot be written twice.
    rig.sim.set("firmware", "0x0201").expect("a knob");
    let other = image_of(&mut rig);
    let file = Image::parse(&text, None).expect("an image");
    let error =
        other.changes(&file, &[], false).expect_err("another firmware may have other places").to_string();
    assert!(error.contains("it is for firmware 0x0003, but the gauge has 0x0201"), "{error}");
    let one_time = |write: &[u8]| matches!(write, [0x00 | 0x3E, _, 0x40..=0x4F, ..]);
    assert!(!rig.sim.log().iter().any(|record| one_time(&record.write)));
}

/// A shipped image for two cells has a Design Energy Scale of 10: without it the capacity is ten times too small.
#[test]
fn regression_the_scale_of_a_shipped_image_is_imported() {
    for chip in ["bq27426", "bq27427"] {
        let mut rig = Rig::new(chip);
        let before = rig.read(80, 81);
        assert_eq!(before, Ok(vec![1]), "{chip}");
        let place =
            "W: AA 3E 50 02\nW: AA 51 0A\nW: AA 60 00\nW: AA 3E 69 00\nW: AA 48 94 43 26 D3\nW: AA 60 00\n";
        let passed_over = import(&mut rig, place);
        assert_eq!(rig.read(80, 81), Ok(vec![10]), "{chip}");
        assert!(!passed_over.iter().any(|line| line.contains("design-energy-scale")), "{passed_over:?}");
        let is_known = chip == "bq27426";
        assert_eq!(passed_over.is_empty(), is_known, "cc-delta: {passed_over:?}");
        assert_eq!(rig.read(105, 8).expect("it is read")[3], if is_known { 0xD3 } else { 0xD2 }, "{chip}");
    }
}
