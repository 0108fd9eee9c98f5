// SPDX-License-Identifier: MIT

use super::*;

fn read(chip: &str, text: &str) -> Result<(Vec<String>, Vec<String>)> {
    let image = parse(text, Chip::by_name(chip))?;
    let entries = image.entries.iter();
    let entries = entries.map(|entry| format!("{} {} {}", entry.line, image.name(entry), entry.text()));
    Ok((entries.collect(), image.notes))
}

/// The identity lines of a bq27441-G1, key words, CONFIG UPDATE, a block, in the style of TI's files:
/// carriage returns, X: without a space, lower case, tabs.
const STREAM: &str = "; a comment\r\nW: AA 00 00 80\r\nW: AA 00 00 80\r\nX:10\r\nW: AA 00 01 00\r\n\
    C: AA 00 21 04\r\nW: AA 00 02 00\r\nC: AA 00 09 01\r\nW: AA 00 13 00\r\nX: 1100\r\n\
    W: AA 61 00\r\nw: aa\t3e 44 00\r\n\
    W: AA 40 00 00 00 00 00 00 00 00 03 20 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00  \r\n\
    W: AA 60 DC\r\nX: 10\r\nW: AA 3E 44 00\r\nC: AA 60 DC\r\nW: AA 00 42 00\r\nX: 2000";

#[test]
fn a_block_is_read_as_its_parameters() {
    let (entries, notes) = read("bq27441-g1", STREAM).expect("an image");
    assert!(entries.iter().all(|entry| entry.starts_with("14 power/")), "{entries:?}");
    assert!(!entries.is_empty());
    assert_eq!(notes[0], "device type and firmware are checked in lines 6 and 8");
    assert_eq!(notes[1], "line 2: key words; an import uses the keys of the mount");
    assert_eq!(notes[2], "line 9: SET_CFGUPDATE; an import does it by itself");
    assert_eq!(notes[3], "line 18: SOFT_RESET; an import does it by itself");
    assert_eq!(notes.len(), 4);
    let image = parse(STREAM, Chip::by_name("bq27441-g1")).expect("an image");
    let places: Vec<_> = image.raw.iter().map(|raw| (raw.name(), raw.bytes.len(), raw.line)).collect();
    assert_eq!(places, [("raw 68/0".into(), 7, 14), ("raw 68/11".into(), 21, 14)]);
    assert_eq!(
        image.undocumented(),
        "line 14: 28 undocumented bytes of subclass 68; refused if the gauge has other values\n"
    );
}

/// As in the chemistry files of TI's tools: blocks of undocumented subclasses.
#[test]
fn a_subclass_that_is_not_in_the_table_is_read_as_bytes() {
    let data = format!("W: AA 40{}", " 11".repeat(32));
    let block = |block| format!("W: AA 3E 53 0{block}\n{data}\nW: AA 60 DF\nX: 10\n");
    let text = block(0) + &block(1);
    let image = parse(&text, Chip::by_name("bq27427")).expect("an image");
    assert!(image.entries.is_empty() && image.undocumented().is_empty());
    let told = |allowed| -> Vec<Option<String>> {
        let why = image.raw.iter().map(|raw| image.refused(raw, allowed));
        why.map(|why| why.map(|why| why.to_string())).collect()
    };
    let why =
        |line| format!("line {line}: subclass 83 of a BQ27427 is undocumented; write its bytes with --raw");
    assert_eq!(told(false), [Some(why(3)), Some(why(7))]);
    assert_eq!(told(true), [None, None]);
    assert_eq!((image.raw[1].name(), image.raw[1].text()), ("raw 83/32".into(), "11".repeat(32)));
}

/// Of a BQ27426 the chemistry is known by name, as is the second block of class 104.
#[test]
fn a_subclass_known_only_by_name_is_read_as_bytes_and_named() {
    let data = format!("W: AA 40{}", " 11".repeat(32));
    let block = |class, block| format!("W: AA 3E {class} 0{block}\n{data}\nW: AA 60 DF\nX: 10\n");
    let known = ["53 0", "53 1", "54 0", "54 1", "55 0", "6C 0", "68 1"];
    let text: String = known.iter().map(|place| block(&place[..2], &place[3..])).collect();
    let image = parse(&text, Chip::by_name("bq27426")).expect("an image");
    assert!(image.entries.is_empty());
    assert!(image.raw.iter().all(|raw| image.refused(raw, false).is_none()));
    let line = |number, what| format!("line {number}: 32 {what}; refused if the gauge has other values\n");
    let lines = [
        line(3, "bytes of subclass 83, OCV Table 83"),
        line(7, "bytes of subclass 83, OCV Table 83"),
        line(11, "bytes of subclass 84, OCV Table 84"),
        line(15, "bytes of subclass 84, OCV Table 84"),
        line(19, "bytes of subclass 85, Chemistry 85"),
        line(23, "bytes of subclass 108, Chemistry 108"),
        line(27, "undocumented bytes of subclass 104"),
    ];
    assert_eq!(image.undocumented(), lines.concat());
    // A file that names part and firmware was made to write the chemistry.
    let identity = "W: AA 00 01 00\nC: AA 00 26 04\nW: AA 00 02 00\nC: AA 00 02 02\n";
    let image =
        parse(&(identity.to_string() + &block("53", "0") + &block("6D", "0") + &block("68", "1")), None);
    let told = image.expect("an image").undocumented();
    let outcomes: Vec<_> = told.lines().map(|line| line.rsplit("; ").next().expect("an outcome")).collect();
    let (written, refused) =
        ("written if the gauge has other values", "refused if the gauge has other values");
    assert_eq!(outcomes, [written, written, refused], "{told}");
    let beyond = parse(&block("55", "1"), Chip::by_name("bq27426")).expect_err("beyond the end").to_string();
    assert_eq!(beyond, "line 3: block 1 of subclass 85, whose last block is 0");
}

/// A firmware file is refused: rows of ROM mode have 96 bytes after four that name the row. The error gives
/// the mode as the reason, not the row.
#[test]
fn a_file_for_rom_mode_is_refused_as_such() {
    let row = format!("W: 16 00 02 00 00 00{}", " FF".repeat(96));
    let unseal = "W: AA 00 14 04\nW: AA 00 72 36\nX: 1000\n";
    for check in ["", "W: AA 3E 02 00\nC: AA 3E 02 00 FF A5 FF A5\n"] {
        let text =
            format!("{check}{unseal}W: AA 00 00 0F\nX: 1000\n{row}\nW: 16 64 98 2A\nX: 2\nC: 16 66 00\n");
        let error = read("bq34110", &text).expect_err("ROM mode").to_string();
        let line = 4 + check.lines().count();
        assert!(error.starts_with(&format!("line {line}: Control(ROM_MODE)")), "{error}");
    }
    let error = read("bq34110", &format!("{row} FF\n")).expect_err("too long").to_string();
    assert_eq!(error, "line 1: 101 bytes, but a row holds at most 100");
}

/// Files written by hand have comments after commands, subclass and block in two lines, and
/// checksums of blocks that they change only in part.
#[test]
fn files_written_by_hand_are_read() {
    let text = "\u{feff}; Terminate voltage\nW: AA 3E 50        ; IT Cfg\n W : AA 3F 01\n\
                w: aa 55 0c 1c;3100 mV\nW: AA 60 7A\nX : 500\nR: AA 40 20\n";
    let image = Image::parse(text, Chip::by_name("bq34z100-g1")).expect("an image");
    let entry = &image.entries[0];
    assert_eq!((image.name(entry), entry.text()), ("it-cfg/cell-terminate-voltage".into(), "3100".into()));
    assert_eq!((image.entries.len(), image.raw.len(), entry.line), (1, 0, 5));
    let unchecked = "line 5: not checked: the checksum covers bytes that the file does not set";
    assert!(image.notes.iter().any(|note| note == unchecked), "{:?}", image.notes);
}

/// A gauge with MACData() returns device type and version in one answer, the most significant byte first.
#[test]
fn one_answer_may_hold_device_type_and_firmware() {
    let row = "W: AA 3E 08 40 FB 50\nW: AA 60 6C 06\n";
    let text = |answer: &str| format!("W: AA 3E 02 00\nC: AA 3E 02 00 {answer}\n{row}");
    let image = parse(&text("01 10 00 02 00 08"), None).expect("an image");
    assert_eq!((image.chip.name, image.firmware), ("bq34110", Some(0x0002)));
    let error = parse(&text("0F 20 00 03"), None).expect_err("an unknown part").to_string();
    assert_eq!(
        error,
        "line 2: it is for device type 0x0f20, firmware 0x0003: not a gauge that gaugefs knows"
    );
    // What bqStudio writes for a bq34110, having asked in the wrong place.
    let image = parse(&text("FF A5 FF A5"), Chip::by_name("bq34110")).expect("an image");
    assert_eq!((image.firmware, image.entries.len()), (None, 1));
    assert_eq!(image.notes[0], "device type and firmware are not both checked by the file");
}

#[test]
fn regression_a_file_for_other_firmware_was_taken_for_one_of_another_part() {
    let text = "W: AA 00 01 00\nC: AA 00 00 01\nW: AA 00 02 00\nC: AA 00 99 00\nW: AA 3E 50 01\nW: AA 55 0C 1C\n\
                W: AA 60 7A\nW: AA 10 00\n";
    for chip in [None, Chip::by_name("bq34z100-g1")] {
        let reading = Image::examine_text(text, chip);
        let told: Vec<_> = reading.faults.iter().map(ToString::to_string).collect();
        let known = match chip {
            Some(_) => "bq34z100-G1 with firmware 0x0016",
            None => "bq34z100-G1 with firmware 0x0016 and a bq34z100-R2 with firmware 0x0202",
        };
        let says = format!("line 2: it is for device type 0x0100, firmware 0x0099; gaugefs knows a {known}");
        assert_eq!(told, [says]);
    }
    // A file in the form of a bq35100, whose versions nobody has listed, is one.
    let flat = text.replace(
        "W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 60 7A\nW: AA 10 00\n",
        "W: AA 3E 00 40\nW: AA 60 BF 05\n",
    );
    let reading = Image::examine_text(&flat, None);
    assert_eq!(reading.image.expect("a chip").chip.name, "bq35100");
}

#[test]
fn what_is_advised_in_place_of_a_file_can_be_done() {
    let rom = "W: AA 00 00 0F\nX: 1000\nW: 16 00 00 01\n";
    let of_type = |code: &str| format!("W: AA 00 01 00\nC: AA 00 {code}\n{rom}");
    for (text, chip, says) in [
        (rom.to_string(), None, "if it is for a gauge that `gaugefs chips` lists with data flash"),
        (rom.to_string(), Some("bq27541"), "gaugefs only reads the registers of a bq27541"),
        (rom.to_string(), Some("bq34110"), "use a .gm.fs or .gg.csv of a bq34110"),
        (rom.to_string(), Some("bq28z610"), "use a .gm.fs or .gg.csv of a bq28z610"),
        (of_type("41 05"), None, "gaugefs only reads the registers of a bq27541"),
        (of_type("26 04"), None, "use a .gm.fs or .gg.csv of a BQ27426"),
    ] {
        let chip = chip.and_then(Chip::by_name);
        let error = parse(&text, chip).expect_err("ROM mode").to_string();
        assert!(error.contains("Control(ROM_MODE)") && error.contains(says), "{error}");
    }
}

#[test]
fn a_dangerous_or_broken_line_is_refused() {
    for (line, says) in [
        ("W: AA 00 00 0F", "line 2: Control(ROM_MODE)"),
        ("W: 16 00 0C 00", "line 2: address 0x16 is the gauge in ROM mode"),
        ("W: 0B 00 0C", "line 2: address 0x16 is the gauge in ROM mode"),
        ("W: 55 00 13 00", "line 2: address 0x55 is not the gauge's, which is AA"),
        ("W: AA 00 1C 00", "line 2: SHUTDOWN: gaugefs never sends it"),
        (
            "W: AA 00 34 12",
            "line 2: neither a subcommand of a bq27441-G1 nor a pair of key words (not shown)",
        ),
        ("W: AA 10 00", "line 2: register 0x10 does not configure a gauge"),
        ("W: AA 61 01", "line 2: BlockDataControl() other than 0"),
        ("W: AA 60 00", "line 2: a checksum before any subclass is selected"),
        ("W: AA 3E 44 00\nW: AA 40 00", "line 3: these bytes are never committed"),
        ("W: AA 3E 44 00\nW: AA 40 00\nW: AA 3E 44 00", "line 4: the bytes of line 3 are not committed"),
        ("W: AA 3E 02 01\nW: AA 40 00\nW: AA 60 00", "line 4: block 1 of subclass 2, whose last block is 0"),
        ("W: AA 3E 52 00\nW: AA 4A 01\nW: AA 60 00", "line 4: Design Capacity: only part of it"),
        ("X: soon", "line 2: X: needs a number of milliseconds"),
        ("W: AA 3", "line 2: expected bytes of two hexadecimal digits"),
        ("W: AA 3E", "line 2: expected an address, a register and at least one byte"),
        (":", "line 2: not a command of a FlashStream"),
        ("hello", "line 2: not a line of a FlashStream"),
        ("M: AA 00 00", "line 2: not a command of a FlashStream"),
    ] {
        let error = read("bq27441-g1", &format!(";\n{line}\n")).expect_err(line).to_string();
        assert!(error.starts_with(says), "{line}: {error}");
    }
    let bent = STREAM.replace("03 20", "03 21");
    let error = read("bq27441-g1", &bent).expect_err("a wrong sum").to_string();
    assert_eq!(error, "line 14: checksum 0xdc, but the bytes give 0xdb; a gauge would discard them");
    let error = read("bq27441-g1", &STREAM.replace("C: AA 60 DC", "C: AA 60 DD")).expect_err("another sum");
    assert_eq!(error.to_string(), "line 17: checksum 0xdd is expected, but the file wrote 0xdc");
    let error = read("bq34z100-g1", STREAM).expect_err("another part").to_string();
    assert!(error.starts_with("line 6: it is for device type 0x0421, firmware 0x0109"), "{error}");
    let error =
        read("bq27441-g1", &STREAM.replace("C: AA 00 09 01", "C: AA 00 10 01")).expect_err("firmware");
    assert!(
        error.to_string().contains("firmware 0x0110; gaugefs knows a bq27441-G1 with firmware 0x0109"),
        "{error}"
    );
}

#[test]
fn of_a_parameter_that_is_committed_twice_the_later_value_counts() {
    let text = "W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 60 7A\n";
    let later = "W: AA 3E 50 01\nW: AA 55 0C 1D\nW: AA 60 79\n";
    let (entries, notes) = read("bq34z100-g1", &format!("{text};\n{later}")).expect("an image");
    assert_eq!(entries, ["7 it-cfg/cell-terminate-voltage 3101"]);
    let note = "line 7: it-cfg/cell-terminate-voltage has another value in line 3; the later one counts";
    assert!(notes.iter().any(|line| line == note), "{notes:?}");
    let text = "W: AA 3E 08 40 FB 50\nW: AA 60 6C 06\n";
    let later = "W: AA 3E 08 40 FB 51\nW: AA 60 6B 06\n";
    let (entries, notes) = read("bq34110", &format!("{text}{later}")).expect("an image");
    assert_eq!(entries, ["4 calibration-data/cc-offset -1199"]);
    assert!(notes.iter().any(|line| line.contains("line 4: calibration-data/cc-offset has")), "{notes:?}");
    // Another parameter of the same block.
    let text = "W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 60 7A\n";
    let other = "W: AA 3E 50 01\nW: AA 57 00 01\nW: AA 60 7A\n";
    let (_, notes) = read("bq34z100-g1", &format!("{text}{other}")).expect("an image");
    assert!(!notes.iter().any(|line| line.contains("the later one counts")), "{notes:?}");
    // The same value once more.
    let text = "W: AA 3E 08 40 FB 50\nW: AA 60 6C 06\n";
    let (_, notes) = read("bq34110", &text.repeat(2)).expect("an image");
    assert!(!notes.iter().any(|line| line.contains("the later one counts")), "{notes:?}");
}

/// A player would stop there.
#[test]
fn a_comparison_that_contradicts_what_was_written_is_refused() {
    let block = "W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 60 7A\nW: AA 3E 50 01\n";
    let flat = "W: AA 3E 08 40 FB 50\nW: AA 60 6C 06\nW: AA 3E 08 40\n";
    for (chip, text, line, says) in [
        ("bq34z100-g1", block, "C: AA 55 0C 1C", None),
        ("bq34z100-g1", block, "C: AA 54 99 0C", None),
        (
            "bq34z100-g1",
            block,
            "C: AA 55 0C 1D",
            Some("register 0x56 = 0x1d is expected, but the file wrote 0x1c"),
        ),
        ("bq34z100-g1", block, "C: AA 54 99 0D", Some("register 0x55 = 0x0d is expected")),
        ("bq34z100-g1", block, "C: AA 60 7B", Some("checksum 0x7b is expected, but the file wrote 0x7a")),
        ("bq34110", flat, "C: AA 3E 08 40 FB 50", None),
        (
            "bq34110",
            flat,
            "C: AA 40 FB 51",
            Some("register 0x41 = 0x51 is expected, but the file wrote 0x50"),
        ),
        ("bq34110", flat, "C: AA 3E 08 40 FA", Some("register 0x40 = 0xfa is expected")),
        ("bq34110", flat, "W: AA 3E 02 00\nC: AA 40 01 10", None),
    ] {
        match (read(chip, &format!("{text}{line}\n")), says) {
            (Ok(_), None) => {}
            (Err(error), Some(says)) => assert!(error.to_string().contains(says), "{line}: {error}"),
            (read, _) => panic!("{line}: {read:?}"),
        }
    }
}

#[test]
fn key_words_are_not_shown() {
    for text in
        ["W: AA 00 34 12\nW: AA 00 78 56\n", "W: AA 00 34 12 78 56\n", "W: AA 00 34 12\n", "W AA 00 3412\n"]
    {
        let told = match read("bq27441-g1", text) {
            Ok((_, notes)) => notes.join(" "),
            Err(error) => error.to_string(),
        };
        assert!(["1234", "3412", "34 12", "5678", "78 56"].iter().all(|key| !told.contains(key)), "{told}");
    }
}

/// A line of TI's image for a BQ27220 writes one byte there, between lines for RAM.
#[test]
fn regression_one_time_programmable_memory_is_left_out() {
    let text = "W: AA 3E 02 00\nC: AA 3E 02 00 02 20 00 03\nW: AA 3E 7D 92 5A\nW: AA 60 96 05\n\
                W: AA 3E 8F 41 00\nW: AA 60 2F 05\nX: 10\nW: AA 3E 8F 41\nC: AA 3E 8F 41 00\n";
    let mut image = parse(text, None).expect("an image");
    assert_eq!((image.chip.name, image.firmware, image.entries.len()), ("bq27220", Some(0x0003), 1));
    let left: Vec<_> = image.left_out.iter().map(|left| left.text.as_str()).collect();
    assert_eq!(left, ["line 6: 0x418f: 1 byte of one-time programmable memory, which gaugefs never writes"]);
    image.exclude(&[Group::Undocumented]);
    assert!(image.left_out.is_empty());
    let error = parse(&text.replace("60 2F 05", "60 2E 05"), None).expect_err("a wrong sum").to_string();
    assert!(error.starts_with("line 6: checksum 0x2e"), "{error}");
    // On a bq34110 such an address is flash.
    let image = parse("W: AA 3E 8F 41 00\nW: AA 60 2F 05\n", Chip::by_name("bq34110")).expect("an image");
    assert_eq!((image.entries.len(), image.left_out.len()), (1, 0));
}

#[test]
fn undocumented_bytes_of_a_flat_address_can_be_excluded() {
    let text = "W: AA 3E 7D 92 5A\nW: AA 60 96 05\nW: AA 3E 78 92 01\nW: AA 60 F4 05\n";
    let mut image = parse(text, Chip::by_name("bq27220")).expect("an image");
    let why = image.refused(&image.raw[0], false).expect("undocumented").to_string();
    assert_eq!(why, "line 4: flash/0x9278 is undocumented; skip it with --exclude undocumented");
    image.exclude(&[Group::Undocumented]);
    assert_eq!((image.entries.len(), image.raw.len()), (1, 0));
}

/// Address and data in one row or in two: ManufacturerAccessControl() accepts both.
#[test]
fn a_flat_address_is_read_as_its_parameters() {
    for text in
        ["W: AA 3E 08 40 FB 50\nW: AA 60 6C 06\n", "W: AA 3E 08 40\nX: 20\nW: AA 40 FB 50\nW: AA 60 6C 06\n"]
    {
        let (entries, _) = read("bq34110", text).expect("an image");
        assert_eq!(entries.len(), 1);
        assert!(entries[0].ends_with("data/cc-offset -1200"), "{entries:?}");
    }
    for (text, says) in [
        ("W: AA 3E 08 40 FB 50\nW: AA 60 6D 06\n", "line 2: checksum 0x6d, but the bytes give 0x6c"),
        ("W: AA 3E 08 40 FB 50\nW: AA 60 6C 07\n", "line 2: MACDataLen() is 7 instead of 6"),
        ("W: AA 3E 08 40 FB\nW: AA 60 BC 05\n", "line 2: CC Offset: only part of it is written"),
        ("W: AA 61 06\n", "line 1: MACDataLen() before any address"),
        ("W: AA 3E 00 0F\n", "line 1: Control(ROM_MODE)"),
        ("W: AA 3E 01 00 FB 50\n", "line 1: more than a word for DEVICE_TYPE"),
    ] {
        let error = read("bq34110", text).expect_err(text).to_string();
        assert!(error.starts_with(says), "{text}: {error}");
    }
}
