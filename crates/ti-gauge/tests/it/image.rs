// SPDX-License-Identifier: MIT

//! Images of TI's tools on simulated gauges, bit for bit.

use std::collections::BTreeMap;
use std::time::Duration;

use ti_gauge::chip::{CHIPS, Chip, FLAT, Kind, Parameter, Range, Role, Subclass};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::image::{Entry, Format, Image};
use ti_gauge::value::Value;

use crate::rig::{Rig, first_address};
use ti_gauge::notation;

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
    let chip = rig.gauge.chip;
    let here = image_of(rig);
    let mut file = Image::parse(text, Some(rig.gauge.chip)).expect("an image");
    file.keep_reserved(&here);
    let changes = here.changes(&file, &[], false).expect("values in range");
    let change = |entry: &ti_gauge::image::Entry| {
        Change::of_value(chip, (entry.subclass, entry.parameter), &entry.value, false)
            .expect("it is in range")
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

/// The subclasses that an image may have.
fn readable(chip: &'static Chip) -> Vec<&'static Subclass> {
    chip.subclasses.iter().filter(|row| row.kind != Kind::Security).collect()
}

/// All bytes of these subclasses, as the engine reads them.
fn stored(rig: &mut Rig) -> Vec<(&'static Subclass, Vec<u8>)> {
    let rows = readable(rig.gauge.chip);
    let read = rig.dataflash.read(&mut rig.gauge, &rows, Duration::ZERO).expect("the default keys");
    rows.into_iter().zip(read).collect()
}

/// Another value of a parameter, if the gauge measures, stores and answers with it all the same.
fn other_value(chip: &Chip, subclass: &Subclass, row: &Parameter, old: &Value) -> Option<Value> {
    let signs = chip.signature.iter().any(|sign| (sign.subclass, sign.offset) == (subclass.id, row.offset));
    // A learned value outside its range is not imported.
    let is_in_range = notation::parse(row, notation::render(row.kind, old).as_bytes()).is_ok();
    let decides = row.role == Some(Role::Cells) || row.safe.is_some() || !row.bits.is_empty();
    let external = chip.gate.as_ref().and_then(|gate| gate.external.as_ref());
    let measures = external.is_some_and(|external| external.byte == (subclass.id, row.offset));
    if signs || row.never.is_some() || decides || measures || !is_in_range || subclass.class == "Calibration"
    {
        return None;
    }
    let both = match &row.range {
        Range::Int { min, max, .. } => [Value::Int(*min), Value::Int(*max)],
        Range::Float { min, max, .. } => [Value::Float(*min), Value::Float(*max)],
        Range::Text { .. } => [Value::Text(b"xy".into()), Value::Text(b"z".into())],
    };
    both.into_iter().find(|value| value != old)
}

/// Gives a gauge other bytes wherever it can have them: at the ends of ranges, and between the parameters. Returns how
/// many there are.
fn fill(rig: &Rig, content: &[(&'static Subclass, Vec<u8>)]) -> usize {
    let mut count = 0;
    for (subclass, bytes) in content {
        let start = if subclass.id == FLAT {
            usize::from(subclass.start()) - first_address(rig.gauge.chip)
        } else {
            0
        };
        let mut put = |offset: usize, bytes: &[u8]| {
            count += bytes.len();
            rig.sim.set_flash(subclass.id.into(), start + offset, bytes);
        };
        let mut is_parameter = vec![false; bytes.len()];
        for row in subclass.parameters {
            let at = usize::from(row.offset - subclass.start());
            let old = &bytes[at..at + row.kind.size()];
            is_parameter[at..at + old.len()].fill(true);
            let layout = rig.gauge.chip.layout;
            let old = layout.decode(row.kind, old);
            if let Some(value) = other_value(rig.gauge.chip, subclass, row, &old) {
                put(at, &layout.encode(row.kind, &value).expect("a value in range"));
            }
        }
        // A flat part has a place for all that it computes with, named or not.
        let measures = subclass.id == FLAT && subclass.class == "Calibration";
        let unnamed =
            (0..bytes.len().min(subclass.length.into())).filter(|at| !is_parameter[*at] && !measures);
        for at in unnamed {
            put(at, &[bytes[at] ^ 0x5a]);
        }
    }
    count
}

/// What docs/IMAGES.md says that a clone by a file of this format does not have.
fn is_left_out(format: Format, subclass: &Subclass, row: Option<&Parameter>) -> bool {
    match (format, row) {
        // Values have a name.
        (Format::Toml | Format::GgCsv, row) => row.is_none(),
        (Format::FlashStream, Some(row)) => subclass.id == FLAT && row.unproven,
        // Whole blocks, and the chemistry; on parts with a flat address space only what has a name.
        (Format::FlashStream, None) => {
            subclass.id == FLAT || (subclass.parameters.is_empty() && subclass.class != "Chemistry")
        }
    }
}

/// A gauge is exported, and the file imported with everything into a gauge that differs wherever it can.
fn clone_by(chip: &'static Chip, format: Format) {
    let at = format!("{} {format:?}", chip.name);
    let (mut from, mut to) = (Rig::new(chip.name), Rig::new(chip.name));
    let original = stored(&mut from);
    let other = fill(&to, &original);
    let before: Vec<_> = stored(&mut to);
    let of = |content: &[(&'static Subclass, Vec<u8>)], id: u8| {
        let found = content.iter().find(|(row, _)| row.id == id).expect("a subclass");
        Ok(found.1.clone())
    };
    let mut image = image_of(&mut from);
    image.add_opaque(|id| of(&original, id)).expect("its bytes");
    let text = image.write(format, |id| of(&original, id)).expect("a file");

    let mut file = Image::parse(&text, None).unwrap_or_else(|error| panic!("{at}: {error}"));
    let here = image_of(&mut to);
    file.keep_reserved(&here);
    let changes = here.changes(&file, &[], true).unwrap_or_else(|error| panic!("{at}: {error}"));
    assert!(changes.passed_over.is_empty(), "{at}: {:?}", changes.passed_over);
    let raw = file.raw_changes(|id| of(&before, id), true).unwrap_or_else(|error| panic!("{at}: {error}"));
    let of_entry =
        |entry: &Entry| Change::of_value(chip, (entry.subclass, entry.parameter), &entry.value, true);
    let mut all: Vec<_> =
        changes.changes.iter().map(|change| of_entry(change.new).expect("it fits")).collect();
    for run in raw {
        let (subclass, mut offset) = (run.new.subclass, run.new.offset);
        // A change is in one block.
        let room = WINDOW - usize::from(offset) % WINDOW;
        let (first, rest) = run.new.bytes.split_at(room.min(run.new.bytes.len()));
        for bytes in std::iter::once(first).chain(rest.chunks(WINDOW)).filter(|bytes| !bytes.is_empty()) {
            let place = Place { subclass, offset };
            let change = Change::raw(chip, place, bytes.to_vec());
            assert_eq!(change.is_err(), chip.is_never_reset(), "{at}: {place}");
            all.extend(change.ok());
            offset += bytes.len() as u16;
        }
    }
    let written = to.dataflash.write(&mut to.gauge, &all, Duration::ZERO);
    written.unwrap_or_else(|error| panic!("{at}: {error}"));

    let (mut same, mut lacking) = (0, 0);
    for ((subclass, wanted), ((_, found), (_, before))) in
        original.iter().zip(stored(&mut to).iter().zip(&before))
    {
        for (offset, (wanted, (found, before))) in
            (subclass.start()..).zip(wanted.iter().zip(found.iter().zip(before)))
        {
            let holds = |row: &&Parameter| (row.offset..).take(row.kind.size()).any(|at| at == offset);
            let place = format!("{at}: {}/{offset}", subclass.id);
            let row = subclass.parameters.iter().find(holds);
            let is_never = row.map_or(chip.is_never_reset(), |row| row.never.is_some());
            if is_never || is_left_out(format, subclass, row) {
                assert_eq!(found, before, "{place} is left out");
                lacking += usize::from(found != wanted);
            } else {
                assert_eq!(found, wanted, "{place}");
                same += usize::from(wanted != before);
            }
        }
    }
    assert!(same + lacking <= other && same > 20, "{at}: {same} of {other} bytes came, {lacking} did not");
    // What is lacking is said, except for the bytes between parameters.
    let has_opaque = |row: &&Subclass| row.parameters.is_empty() && is_left_out(format, row, None);
    let is_in_none = |row: &Parameter| format == Format::FlashStream && row.never.is_some();
    let has_unproven = chip
        .rows()
        .any(|(subclass, row)| row.unproven && (is_in_none(row) || is_left_out(format, subclass, Some(row))));
    let says = readable(chip).iter().any(has_opaque) || has_unproven;
    assert_eq!(says, !image.omitted(format).is_empty(), "{at}: {:?}", image.omitted(format));
}

#[test]
fn a_clone_has_every_byte_that_its_format_has() {
    for chip in CHIPS.iter().copied().filter(|chip| chip.is_proven()) {
        for format in [Format::Toml, Format::GgCsv, Format::FlashStream] {
            clone_by(chip, format);
        }
    }
}

/// Parts that a clone by FlashStream is complete for, and those that it is not complete for.
#[test]
fn what_a_file_lacks_is_named() {
    let omitted = |chip: &str, format| image_of(&mut Rig::new(chip)).omitted(format);
    assert_eq!(omitted("bq27426", Format::FlashStream), [""; 0]);
    let chemistry = "without the chemistry, subclasses 83, 84, 85 and 108: bytes without parameters, which only a \
                     FlashStream has";
    assert_eq!(omitted("bq27426", Format::Toml), [chemistry]);
    let calibration =
        "without subclasses 106 and 107: bytes of calibration without parameters, which no format has";
    assert_eq!(omitted("bq27621-g1", Format::FlashStream), [calibration]);
    assert!(omitted("bq34z100-g1", Format::GgCsv).is_empty());
    let unproven = omitted("bq35100", Format::FlashStream);
    assert!(unproven.len() == 1 && unproven[0].contains(" unproven parameters of "), "{unproven:?}");
}

/// Subclasses without parameters are seen by a comparison.
#[test]
fn regression_a_clone_of_a_bq27426_has_its_chemistry() {
    let mut rig = Rig::new("bq27426");
    let content = stored(&mut rig);
    let of = |id: u8| Ok(content.iter().find(|(row, _)| row.id == id).expect("a subclass").1.clone());
    let mut one = image_of(&mut rig);
    one.add_opaque(of).expect("its bytes");
    let mut other = one.clone();
    for raw in &mut other.raw {
        raw.bytes[3] ^= 1;
    }
    let compared = one.compare(&other, &[]).expect("one chip");
    assert_eq!(
        compared.raw.iter().map(|raw| raw.new.name()).collect::<Vec<_>>(),
        ["raw 83/3", "raw 84/3", "raw 85/3", "raw 108/3"]
    );
    let file = Image::parse(&one.write(Format::FlashStream, of).expect("a file"), None).expect("an image");
    assert!(one.compare(&file, &[]).expect("one chip").raw.is_empty());
    assert_eq!(other.compare(&file, &[]).expect("one chip").raw.len(), 4);
    // And it is written again after a loss of power.
    let restored: Vec<_> = file
        .to_restore()
        .expect("values in range")
        .into_iter()
        .filter(|change| change.row().is_none())
        .collect();
    assert!(restored.iter().any(|change| change.place().subclass == 108));
    for raw in &other.raw {
        rig.sim.set_flash(raw.subclass.into(), 0, &raw.bytes);
    }
    rig.dataflash.write(&mut rig.gauge, &restored, Duration::ZERO).expect("it is written");
    assert!(stored(&mut rig).iter().zip(&content).all(|(found, wanted)| found.1 == wanted.1));
    // A TOML has none of it, which a comparison says.
    let toml = Image::parse(&one.write(Format::Toml, of).expect("a file"), None).expect("an image");
    assert_eq!(one.compare(&toml, &[]).expect("one chip").raw_only_first.len(), 4);
}
