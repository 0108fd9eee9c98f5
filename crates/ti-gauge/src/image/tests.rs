// SPDX-License-Identifier: MIT

//! Every format reads back what was written, and what is refused.

use super::*;
use crate::chip::{CHIPS, Range};
use crate::value::Type;
use proptest::prelude::*;
use proptest::sample::Index;

/// The image of a gauge with the manual's defaults.
pub(super) fn defaults(chip: &'static Chip) -> Image {
    let mut image = Image::new(chip, chip.identity.firmware.first().copied());
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        for parameter in subclass.parameters {
            let value = match &parameter.range {
                Range::Int { min, default, .. } => Value::Int(default.unwrap_or(*min)),
                Range::Float { min, default, .. } => Value::Float(default.unwrap_or(*min)),
                Range::Text { default } => Value::Text(default.unwrap_or_default().into()),
            };
            image.add(subclass, parameter, value, 0);
        }
    }
    image
}

/// The image as text; the bytes between parameters are 0xff.
pub(super) fn written(image: &Image, format: Format) -> String {
    match format {
        Format::Toml => toml::write(image),
        Format::GgCsv => ggcsv::write(image),
        Format::FlashStream => flashstream::write(image, |id| {
            let length = image.chip.subclass(id).expect("a subclass").stored();
            let mut bytes = vec![0xff; length.into()];
            for entry in image.entries.iter().filter(|entry| entry.subclass.id == id) {
                let at = usize::from(entry.parameter.offset);
                bytes[at..at + entry.parameter.kind.size()]
                    .copy_from_slice(&entry.bytes(image.chip).expect("it fits"));
            }
            Ok(bytes)
        })
        .expect("every value fits"),
    }
}

fn chip(name: &str) -> &'static Chip {
    Chip::by_name(name).expect("it has a table")
}

const FORMATS: [Format; 3] = [Format::Toml, Format::GgCsv, Format::FlashStream];

#[test]
fn every_format_reads_back_what_was_written() {
    for chip in CHIPS {
        let image = defaults(chip);
        for format in FORMATS {
            let text = written(&image, format);
            let again = Image::parse(&text, None).unwrap_or_else(|error| panic!("{}: {error}", chip.name));
            assert!(std::ptr::eq(again.chip, *chip));
            let compared = image.compare(&again, &[]).expect("one chip");
            let differences: Vec<_> = compared.differences.iter().map(ToString::to_string).collect();
            assert!(differences.is_empty(), "{} {format:?}: {differences:?}", chip.name);
            // The FlashStream of a flat part leaves out unproven parameters, and of any what is never written with its block.
            let mut rows = chip.subclasses.iter().flat_map(|row| row.parameters);
            let is_partial = chip.access.scheme.is_flat() || rows.any(|row| row.never.is_some());
            let may_lack = format == Format::FlashStream && is_partial;
            assert!(compared.only_first.is_empty() || may_lack, "{} {format:?}", chip.name);
            assert!(compared.only_second.is_empty());
        }
    }
}

/// Every string parameter of every chip.
fn string_rows() -> Vec<(&'static Chip, &'static Subclass, &'static Parameter)> {
    let rows = CHIPS.iter().flat_map(|&chip| chip.subclasses.iter().map(move |subclass| (chip, subclass)));
    let rows =
        rows.flat_map(|(chip, subclass)| subclass.parameters.iter().map(move |row| (chip, subclass, row)));
    rows.filter(|(_, _, row)| matches!(row.kind, Type::S(_))).collect()
}

/// Exports a string in a format, reads the file, and exports that again.
fn assert_survives(
    (chip, subclass, parameter): (&'static Chip, &'static Subclass, &'static Parameter),
    string: &[u8],
    format: Format,
) {
    let mut image = defaults(chip);
    // A FlashStream has whole blocks.
    image.entries.retain(|entry| std::ptr::eq(entry.subclass, subclass));
    let is_it = |entry: &&mut Entry| entry.parameter.offset == parameter.offset;
    image.entries.iter_mut().find(is_it).expect("it has a default").value = Value::Text(string.into());
    let text = written(&image, format);
    let at = format!("{} {format:?} {:?} in\n{text}", parameter.name, string.escape_ascii().to_string());
    let again = Image::parse(&text, None).unwrap_or_else(|error| panic!("{error}: {at}"));
    let found = again.entries.iter().find(|entry| entry.parameter.offset == parameter.offset);
    let entry = found.unwrap_or_else(|| panic!("it is lost: {at}"));
    assert_eq!(entry.value, Value::Text(string.into()), "{at}");
    assert_eq!(written(&again, format), text, "{at}");
    // What an import writes to `df/transaction`, and a diff shows.
    let shown = entry.text();
    assert!(shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{at}");
    assert_eq!(notation::parse(parameter, shown.as_bytes()), Ok(entry.value.clone()), "{shown}: {at}");
}

#[test]
fn a_string_comes_back_as_it_went() {
    let strings: [&[u8]; 29] = [
        b"AT&T (4S)",
        b"",
        b" ",
        b"   ",
        b" a ",
        b"a  b",
        b"-",
        b"_",
        b"#",
        b"*",
        b"'",
        b"\"",
        b"\"\"\"",
        b"\\",
        b"\\n",
        b"\\u0041",
        b"a,b",
        b",",
        b"a;b",
        b"\t",
        b"\r\n",
        b"\n",
        b"\0",
        b"\x7f",
        b"%",
        b"%41",
        b"%%41",
        b"0x41",
        b"\xff\xfe\xc3\xa9",
    ];
    for row in string_rows() {
        for format in FORMATS {
            if row.2.unproven && format == Format::FlashStream {
                continue;
            }
            for string in strings {
                // The chemistry has room for four characters.
                let string = &string[..string.len().min(row.2.kind.size() - 1)];
                assert_survives(row, string, format);
            }
        }
    }
}

#[test]
fn a_string_of_any_byte_and_length_comes_back_as_it_went() {
    let rows = string_rows();
    let row = *rows.iter().find(|(_, _, row)| row.kind == Type::S(12)).expect("a Device Name");
    for format in FORMATS {
        for length in [1, 2, 11] {
            for byte in 0..=u8::MAX {
                assert_survives(row, &vec![byte; length], format);
            }
        }
    }
    let config = ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(string in prop::collection::vec(any::<u8>(), 0..=11), format in prop::sample::select(FORMATS.to_vec()))| {
        assert_survives(row, &string, format);
    });
}

/// An edited value counts, and not the bytes that the file had for it.
#[test]
fn a_string_that_was_edited_in_a_gg_csv_has_its_new_value() {
    let (chip, subclass, row) = string_rows()[0];
    let mut image = Image::new(chip, None);
    image.add(subclass, row, Value::Text(b"AT&T \x01".into()), 0);
    let text = written(&image, Format::GgCsv);
    let value = |text: &str| Image::parse(text, None).map(|image| image.entries[0].value.clone());
    for (new, bytes) in [("AT&T _", &b"AT&T \x01"[..]), ("AT_T _", b"AT_T _"), ("", b""), ("AT&T", b"AT&T")] {
        let edited = text.replace("AT&T _", new);
        assert_eq!(value(&edited), Ok(Value::Text(bytes.into())), "{edited}");
    }
    let error = value(&text.replace("AT&T _", "more than eleven")).expect_err("too long").to_string();
    assert!(error.contains(": 16 characters, but only 11 fit"), "{error}");
    let error = value(&text.replace("AT&T _", "caf\u{e9}")).expect_err("not ASCII").to_string();
    assert!(error.contains("Data Flash Raw Value"), "{error}");
}

#[test]
fn an_empty_string_in_a_gg_csv_is_a_value_and_an_empty_number_is_none() {
    for order in ["Parameter Value", "Parameter Value, Units"] {
        let end = if order.ends_with("Units") { ",-" } else { "" };
        let text = format!(
            "* Field Order: Class name, Subclass name, Parameter name, {order}\n\
             Configuration,Data,Device Name,{end}\nGas Gauging,IT Cfg,Cell Terminate Voltage,{end}\n"
        );
        let image = Image::parse(&text, Some(CHIPS[0])).expect("an image");
        let values: Vec<_> = image.entries.iter().map(|entry| (image.name(entry), &entry.value)).collect();
        assert_eq!(values, [("configuration-data/device-name".into(), &Value::Text(Vec::new()))]);
    }
}

/// Which end of its range every parameter has.
#[derive(Clone, Copy, Debug)]
enum Limit {
    Least,
    Default,
    Most,
}

fn at_limit(chip: &'static Chip, limit: Limit) -> Image {
    let mut image = defaults(chip);
    for entry in &mut image.entries {
        entry.value = match (&entry.parameter.range, limit) {
            (_, Limit::Default) => continue,
            (Range::Int { min, .. }, Limit::Least) => Value::Int(*min),
            (Range::Int { max, .. }, Limit::Most) => Value::Int(*max),
            (Range::Float { min, .. }, Limit::Least) => Value::Float(*min),
            (Range::Float { max, .. }, Limit::Most) => Value::Float(*max),
            (Range::Text { .. }, Limit::Least) => Value::Text(Vec::new()),
            (Range::Text { .. }, Limit::Most) => Value::Text(vec![0xff; entry.parameter.kind.size() - 1]),
        };
    }
    image
}

#[test]
fn an_export_of_what_was_imported_is_the_same_file() {
    for chip in CHIPS {
        for limit in [Limit::Least, Limit::Default, Limit::Most] {
            for format in FORMATS {
                let image = at_limit(chip, limit);
                let text = written(&image, format);
                let again = Image::parse(&text, None);
                let again =
                    again.unwrap_or_else(|error| panic!("{} {limit:?} {format:?}: {error}", chip.name));
                let second = written(&again, format);
                let differ = text.lines().zip(second.lines()).find(|(one, other)| one != other);
                assert_eq!(differ, None, "{} {limit:?} {format:?}", chip.name);
                assert_eq!(text.len(), second.len(), "{} {limit:?} {format:?}", chip.name);
                for entry in &again.entries {
                    assert!(entry.not_imported(false).is_ok(), "{} {limit:?}: {}", chip.name, entry.text());
                }
            }
        }
    }
}

/// A whole file twice, without the lines that count its parameters. A FlashStream is a sequence of writes.
#[test]
fn a_parameter_that_is_there_twice_is_refused_in_every_format_that_is_none_of_writes() {
    for chip in CHIPS {
        for format in [Format::Toml, Format::GgCsv] {
            let counts = ["parameters = ", "* gaugefs parameters"];
            let text = written(&defaults(chip), format);
            let is_count = |line: &str| counts.iter().any(|count| line.starts_with(count));
            let lines: Vec<&str> = text.lines().filter(|line| !is_count(line)).collect();
            // TOML does not allow a key outside of a table twice either.
            let start = if format == Format::Toml { 4 } else { 0 };
            let twice = [&lines[..], &lines[start..]].concat().join("\n") + "\n";
            let error = Image::parse(&twice, Some(chip)).map(drop).expect_err("twice").to_string();
            let (first, second) = error.split_once(" is also in line ").unwrap_or_default();
            let is_line = first.starts_with("line ") && second.ends_with("; remove one of the two");
            assert!(is_line, "{} {format:?}: {error}", chip.name);
        }
    }
}

#[test]
fn a_difference_is_shown_by_name() {
    let old = defaults(CHIPS[0]);
    let text =
        written(&old, Format::Toml).replace("cell-terminate-voltage = 3000", "cell-terminate-voltage = 3100");
    let new = Image::parse(&text, None).expect("an image");
    let compared = old.compare(&new, &[]).expect("one chip");
    let differences: Vec<_> = compared.differences.iter().map(ToString::to_string).collect();
    assert_eq!(differences, ["it-cfg/cell-terminate-voltage: 3000 -> 3100 mV"]);
}

#[test]
fn gauges_of_two_kinds_are_not_compared() {
    let (one, other) = (defaults(CHIPS[0]), defaults(chip("bq27441-g1")));
    let error = one.compare(&other, &[]).expect_err("two chips").to_string();
    assert_eq!(error, "one is for a bq34z100-G1, the other for a bq27441-G1");
}

#[test]
fn a_file_for_another_gauge_is_refused() {
    let text = written(&defaults(CHIPS[0]), Format::Toml);
    for (from, to, says) in [
        (
            "0x0016",
            "0x0017",
            "device type 0x0100, firmware 0x0017; gaugefs knows a bq34z100-G1 with firmware 0x0016",
        ),
        ("chip = \"bq34z100-g1\"", "chip = \"bq27441-g1\"", "which a bq27441-G1 is not"),
        ("chip = \"bq34z100-g1\"", "", ""),
    ] {
        let outcome = Image::parse(&text.replacen(from, to, 1), None).map(drop);
        let error = outcome.err().map_or(String::new(), |error| error.to_string());
        assert!(error.contains(says) && error.is_empty() == says.is_empty(), "{from}: {error}");
    }
    let why =
        "device type 0x0421, firmware 0x0109: bq27441-g1 or bq27421-g1 or bq27411-G1; choose with --chip";
    let ambiguous = Image::parse("device_type = 0x0421\nfirmware = 0x0109\n", None);
    assert!(ambiguous.expect_err("two chips").to_string().ends_with(why));
    let relative = Image::parse("device_type = 0x0520\nfirmware = 0x0329\n", None);
    let relative = relative.expect_err("no table").to_string();
    assert!(relative.contains("a bq27520-G4, whose data flash gaugefs does not support"), "{relative}");
}

/// The first versions wrote the device number of these parts for their firmware.
#[test]
fn regression_a_file_of_another_firmware_of_a_part_with_mac_data_is_refused() {
    for (name, number) in [("bq27220", "0x2002"), ("bq34110", "0x1001"), ("bq35100", "0x0001")] {
        let mut here = defaults(Chip::by_name(name).expect("a chip"));
        here.firmware = Some(0x0201);
        for format in FORMATS {
            let text = written(&here, format);
            let there = Image::parse(&text, Some(here.chip)).expect("an image");
            assert_eq!(there.firmware, Some(0x0201), "{name} {format:?}: {text}");
            here.changes(&there, &[], false).expect("the same firmware");
            let other = Image { firmware: Some(0x0202), ..here.clone() };
            let error = other.changes(&there, &[], false).expect_err("another firmware").to_string();
            assert!(error.contains("it is for firmware 0x0201, but the gauge has 0x0202"), "{error}");
        }
        let old =
            written(&here, Format::Toml).replacen("firmware = 0x0201", &format!("firmware = {number}"), 1);
        let old = Image::parse(&old, None).expect("an old image");
        assert_eq!(old.firmware, None, "{name}");
        here.changes(&old, &[], false).expect("it does not say which firmware it is for");
    }
    let old = "W: AA 00 01 00\nC: AA 40 20 02\nW: AA 00 02 00\nC: AA 40 02 20\n\
               W: AA 3E 9F 92\nW: AA 40 04 B0\nW: AA 60 1A 06\n";
    let old = Image::parse(old, None).expect("an old FlashStream");
    assert_eq!((old.chip.name, old.firmware), ("bq27220", None));
}

#[test]
fn a_file_that_was_cut_short_is_refused() {
    for chip in CHIPS {
        for format in FORMATS {
            let text = written(&defaults(chip), format);
            let last = text.len() - 100..text.len();
            // Each place takes a reading of all before it.
            for length in (0..text.len()).step_by(997).chain(last.step_by(3)) {
                let cut = String::from_utf8_lossy(&text.as_bytes()[..length]);
                let outcome = Image::parse(&cut, Some(chip));
                assert!(outcome.is_err(), "{} {format:?}: {length} bytes are an image", chip.name);
            }
        }
    }
    let text = written(&defaults(CHIPS[0]), Format::Toml).replacen("\nra-filter = ", "\n# ra-filter = ", 1);
    let error = Image::parse(&text, None).expect_err("one is missing").to_string();
    assert!(error.contains("the file is cut short, or lines were added or removed"), "{error}");
    // As earlier exports and people write it.
    let text = text.lines().filter(|line| !line.starts_with("parameters")).collect::<Vec<_>>().join("\n");
    assert!(Image::parse(&text, None).is_ok());
}

/// The exports of other tools have no count.
#[test]
fn a_file_of_another_tool_that_was_cut_short_is_refused_where_it_shows() {
    let rows = "* Field Order: Class name, Subclass name, Parameter name, Parameter Value, Units\n\
                Gas Gauging,IT Cfg,Cell Terminate Voltage,3100,mV\nGas Gauging,IT Cfg,Ra Filter,500";
    let error = Image::parse(rows, Some(CHIPS[0])).expect_err("the last value may be a part").to_string();
    assert!(error.starts_with("line 3: the last line has fewer fields"), "{error}");
    let stream = "W: AA 00 13 00\nW: AA 3E 44 00\nW: AA 47 00 03 08 98\nW: AA 60 5C\n";
    let chip = Chip::by_name("bq27441-g1");
    let error = Image::parse(stream, chip).expect_err("no end").to_string();
    assert!(error.starts_with("line 1: CONFIG UPDATE is entered, and no SOFT_RESET leaves it"), "{error}");
    assert!(Image::parse(&format!("{stream}W: AA 00 42 00\n"), chip).is_ok());
}

#[test]
fn a_file_without_parameters_is_refused() {
    let order = "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n";
    for (text, says) in [
        ("", "the file is empty"),
        ("\u{feff}\n \n", "the file is empty"),
        ("chip = \"bq34z100-g1\"\n", "it has no parameter of a bq34z100-G1"),
        ("[it-cfg]\n", "it has no parameter of a bq34z100-G1"),
        (order, "it has no parameter of a bq34z100-G1"),
        (
            &format!("{order}Gas Gauging,IT Cfg,Something,1\n"),
            "it has no parameter of a bq34z100-G1 (line 2: Gas Gauging/IT Cfg/Something: not in the table",
        ),
        ("; a comment\nW: AA 00 01 00\nC: AA 00 00 01\n", "it has no parameter of a bq34z100-G1"),
    ] {
        let error = Image::parse(text, Some(CHIPS[0])).expect_err(text).to_string();
        assert!(error.starts_with(says), "{text}: {error}");
    }
}

#[test]
fn a_parameter_that_is_there_twice_is_refused_with_both_lines() {
    let row = "Gas Gauging,IT Cfg,Cell Terminate Voltage,";
    let text = format!(
        "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n\
         {row}3100\nGas Gauging,IT Cfg,Ra Filter,500\n{row}3200\n"
    );
    let error = Image::parse(&text, Some(CHIPS[0])).expect_err("two values").to_string();
    assert_eq!(error, "line 4: it-cfg/cell-terminate-voltage is also in line 2; remove one of the two");
}

#[test]
fn what_an_import_passes_over_is_listed() {
    let parse = |text: &str| Image::parse(text, Some(CHIPS[0])).expect("an image");
    let gauge = parse("[it-cfg]\ncell-terminate-voltage = 3000\n");
    let file = parse(
        "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n\
         Gas Gauging,IT Cfg,Cell Terminate Voltage,3100\nGas Gauging,IT Cfg,Something,1\n\
         Gas Gauging,IT Cfg,Ra Filter,500\nSecurity,Codes,Sealed to Unsealed,36720414\n",
    );
    let passed_over = |exclude: &[Group]| {
        let Changes { changes, passed_over } = gauge.changes(&file, exclude, false).expect("one chip");
        assert_eq!(changes.len(), 1);
        passed_over
    };
    let unknown = "line 3: Gas Gauging/IT Cfg/Something: not in the table; left out";
    let unread = "line 4: it-cfg/ra-filter: the gauge does not show its value";
    let key = "line 5: Sealed to Unsealed: a key; left out";
    assert_eq!(passed_over(&[]), [unknown, key, unread]);
    assert_eq!(passed_over(&[Group::Keys]), [unknown, unread]);

    // An unproven value is passed over only if the gauge has another one.
    let chip = Chip::by_name("bq34110").expect("a chip");
    let (gauge, mut file) = (defaults(chip), defaults(chip));
    let entry = file.entries.iter_mut().find(|entry| entry.parameter.unproven).expect("an unproven row");
    let Value::Int(value) = &mut entry.value else { panic!("{}", entry.parameter.name) };
    *value += 1;
    let all = gauge.changes(&file, &[], true).expect("one chip");
    assert_eq!((all.changes.len(), all.passed_over.len()), (1, 0));
    let Changes { changes, passed_over } = gauge.changes(&file, &[], false).expect("one chip");
    assert!(changes.is_empty());
    assert_eq!(passed_over.len(), 1, "{passed_over:?}");
    assert!(passed_over[0].ends_with(": its address or range is unproven"), "{passed_over:?}");
}

/// Bits 6 and 4 of Pack Configuration B are reserved. Files of real packs have 0 in them, and the manual 1.
#[test]
fn reserved_bits_of_a_file_stay_as_the_gauge_has_them() {
    let chip = chip("bq34z100-g1");
    for (word, kept, left_out) in [(0xaf, 0xff, 1), (0xab, 0xfb, 1), (0x7f, 0x7f, 0), (0xff, 0xff, 0)] {
        let (gauge, mut file) = (defaults(chip), defaults(chip));
        let is_it = |entry: &&mut Entry| entry.parameter.name == "Pack Configuration B";
        file.entries.iter_mut().find(is_it).expect("a row").value = Value::Int(word);
        file.keep_reserved(&gauge);
        let Changes { changes, passed_over } = gauge.changes(&file, &[], false).expect("one chip");
        assert_eq!(passed_over.len(), left_out, "{word:x}: {passed_over:?}");
        let written: Vec<_> = changes.iter().map(|change| change.new.value.clone()).collect();
        let expected = if kept == 0xff { Vec::new() } else { vec![Value::Int(kept)] };
        assert_eq!(written, expected, "{word:x}");
        let excluded = gauge.changes(&file, &[Group::Undocumented], false).expect("one chip");
        assert!(excluded.passed_over.is_empty(), "{word:x}: {:?}", excluded.passed_over);
    }
}

#[test]
fn a_complete_image_has_every_parameter_that_can_be_written() {
    for chip in CHIPS {
        let mut image = defaults(chip);
        assert!(image.missing(&[]).is_empty(), "{}", chip.name);
        image.entries.retain(|entry| !entry.parameter.learned);
        assert!(image.missing(&[Group::Learned]).is_empty(), "{}", chip.name);
    }
    let mut image = defaults(CHIPS[0]);
    image.entries.retain(|entry| entry.parameter.name != "Serial Number");
    assert_eq!(image.missing(&[]), ["configuration-data/serial-number"]);
    assert!(image.missing(&[Group::Serial]).is_empty());
}

/// Whatever a file holds, it is an image or an error.
#[test]
fn garbage_is_refused_without_a_panic() {
    let chips = ["bq34z100-g1", "bq27441-g1", "bq34110"].into_iter().map(chip);
    let whole: Vec<_> = chips
        .flat_map(|chip| FORMATS.map(|format| (chip, written(&defaults(chip), format).into_bytes())))
        .collect();
    let letter = prop::sample::select(b"\n\r\t ;:*=[]#\",.0xfFWCX-\xff\x00e9".to_vec());
    let edits = prop::collection::vec((any::<Index>(), letter), 1..=4);
    let end = prop::option::weighted(0.3, any::<Index>());
    let config = ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(file in prop::sample::select(whole), edits in edits, end in end)| {
        let (chip, mut bytes) = file;
        for (at, letter) in edits {
            let at = at.index(bytes.len());
            bytes[at] = letter;
        }
        if let Some(end) = end {
            bytes.truncate(end.index(bytes.len()));
        }
        let text = String::from_utf8_lossy(&bytes);
        let _ = Image::parse(&text, None);
        let _ = Image::parse(&text, Some(chip));
    });
    for text in ["", "\n", ";", "*", ":", "W:", "X:", "W: AA", "* Field Order:", "[", "\u{feff}"] {
        let _ = Image::parse(text, Some(CHIPS[0]));
    }
}
