// SPDX-License-Identifier: MIT

//! Images for ROM mode of a bq34z100-G1 and -R2: written to a gauge as parameters, and never in that mode.

use std::fmt::Write as _;
use std::fs;

use crate::room::{Folder, can_mount, gaugefs, read};

/// A part, its firmware, and where its image has the subclasses, by id. Not taken from the tables.
type Part = (&'static str, u16, &'static [(u8, usize, usize)], usize);

const G1: Part = (
    "bq34z100-g1",
    0x0016,
    &[
        (104, 0, 16),
        (107, 49, 2),
        (82, 68, 17),
        (80, 85, 93),
        (32, 400, 6),
        (34, 406, 14),
        (36, 420, 27),
        (64, 447, 8),
        (68, 459, 12),
        (81, 471, 11),
        (67, 506, 1),
        (59, 507, 12),
        (60, 519, 2),
        (66, 521, 5),
        (2, 571, 10),
        (48, 602, 60),
        (49, 662, 22),
        (58, 684, 32),
        (88, 768, 32),
        (89, 832, 32),
    ],
    600,
);

const R2: Part = (
    "bq34z100-r2",
    0x0202,
    &[
        (104, 0, 16),
        (107, 49, 2),
        (82, 68, 17),
        (80, 85, 93),
        (32, 405, 6),
        (34, 411, 14),
        (36, 425, 27),
        (64, 452, 8),
        (68, 464, 12),
        (81, 476, 11),
        (67, 511, 1),
        (59, 512, 12),
        (60, 524, 2),
        (66, 526, 5),
        (2, 576, 10),
        (48, 607, 62),
        (49, 669, 22),
        (58, 691, 32),
        (88, 768, 32),
        (89, 832, 32),
    ],
    605,
);

/// The data flash of a mounted gauge as an image has it.
fn data_flash(gauge: &str, (_, _, subclasses, _): Part) -> Vec<u8> {
    let mut flash = vec![0xff; 1024];
    for &(id, at, length) in subclasses {
        let bytes = fs::read(format!("{gauge}/df/{id}/raw")).expect("bytes");
        flash[at..at + length].copy_from_slice(&bytes[..length]);
    }
    flash
}

fn command(bytes: &[u8]) -> String {
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
    let sum: u16 = bytes.iter().map(|&byte| u16::from(byte)).sum();
    format!("W: 16 00{}\nW: 16 64{}\nX: 20\nC: 16 66 00\n", hex(bytes), hex(&sum.to_le_bytes()))
}

/// A file as TI's tools write it: two rows of instruction flash, or more if it is a .bq.fs.
fn file(flash: &[u8], firmware: u16, instruction_rows: u8) -> String {
    let mut text = String::from("W: AA 00 14 04\nW: AA 00 72 36\nX: 1000\nW: AA 00 00 0F\nX: 1000\n");
    text += &command(&[0x03, 0, 0]);
    for row in 0..instruction_rows {
        let mut bytes = [0xff; 100];
        bytes[..4].copy_from_slice(&[0x02, row, 0, 0]);
        bytes[52..54].copy_from_slice(&firmware.to_le_bytes());
        text += &command(&bytes);
    }
    text += &command(&[0x0c, 0, 0, 0, 0x83, 0xde]);
    for (row, bytes) in (0..).zip(flash.chunks(32)) {
        text += &command(&[&[0x0a, row, 0, 0], bytes].concat());
    }
    text += &command(&[0x08]);
    let [low, high] = flash.iter().fold(0u16, |sum, &byte| sum.wrapping_add(byte.into())).to_le_bytes();
    writeln!(text, "C: 16 04 {low:02X} {high:02X}").expect("a string");
    text += &command(&[0x01, 0, 0, 0x05, 0x54, 0x54, 0x15]);
    text + &command(&[0x0f]).replace("C: 16 66 00\n", "")
}

fn all_parts(check: fn(Part)) {
    if can_mount() {
        std::thread::scope(|scope| [G1, R2].map(|part| scope.spawn(move || check(part))).map(|_| ()));
    }
}

/// Where nothing shows the chemistry of an image, a person vouches for it.
#[test]
fn an_image_of_a_bq27500_is_imported_if_somebody_knows_its_chemistry() {
    if !can_mount() {
        return;
    }
    // As the stock images have it (github.com/buglabs/bq27500-update).
    let part: Part = (
        "bq27500",
        0x0120,
        &[
            (104, 0x1e, 14),
            (82, 0x74, 20),
            (80, 0x8c, 61),
            (32, 0x1f7, 6),
            (34, 0x1fd, 10),
            (36, 0x207, 13),
            (64, 0x214, 2),
            (68, 0x21e, 20),
            (81, 0x232, 10),
            (2, 0x268, 10),
            (48, 0x27c, 20),
            (49, 0x290, 4),
        ],
        0,
    );
    let folder = Folder::new();
    let (at, image) = (folder.file("m"), folder.file("golden.dffs"));
    gaugefs(&["mount", "--sim", part.0, &at]).done();
    let gauge = format!("{at}/BAT0");
    let mut flash = data_flash(&gauge, part);
    flash[0x27c + 10..][..2].copy_from_slice(&1340u16.to_be_bytes());
    fs::write(&image, file(&flash, part.1, 2)).expect("a file");
    let groups = "undocumented,keys,learned,calibration";
    let ran = gaugefs(&["import", "--exclude", groups, &gauge, &image]);
    let says = ["whether it has the image's chemistry is unknown (CHEM_ID 0x0107)", "--same-chemistry"];
    assert!(ran.code == Some(1) && says.iter().all(|says| ran.err.contains(says)), "{}", ran.err);
    let ran = gaugefs(&["import", "--exclude", groups, "--same-chemistry", &gauge, &image]);
    assert!(ran.code == Some(0) && ran.out.lines().count() == 1, "{}{}", ran.out, ran.err);
    assert_eq!(read(&gauge, "df/48/10"), "1340");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn an_image_for_rom_mode_is_imported_in_normal_mode() {
    all_parts(|part| {
        let (chip, firmware, subclasses, chemistry) = part;
        let folder = Folder::new();
        let (at, image, trace) = (folder.file("m"), folder.file("golden.df.fs"), folder.file("trace"));
        gaugefs(&["mount", "--sim", chip, "--trace", &trace, &at]).done();
        let gauge = format!("{at}/BAT0");
        let mut flash = data_flash(&gauge, part);
        let place = |id: u8| subclasses.iter().find(|row| row.0 == id).expect("a subclass").1;
        let terminate = place(80) + 53;
        flash[terminate..terminate + 2].copy_from_slice(&3100u16.to_be_bytes());
        let capacity = place(48) + 11;
        flash[capacity..capacity + 2].copy_from_slice(&2200u16.to_be_bytes());
        // Lifetime data of another pack, and keys.
        flash[place(59)] ^= 1;
        let keys = place(81) + 11;
        flash[keys..keys + 8].copy_from_slice(&[0x12, 0x34, 0x56, 0x78, 0x9a, 0xbc, 0xde, 0xf0]);
        let lint = |flash: &[u8]| {
            fs::write(&image, file(flash, firmware, 2)).expect("a file");
            gaugefs(&["lint", &image]).done()
        };
        let told = lint(&flash);
        assert!(told.contains("cell-terminate-voltage") && told.contains(" 3100 mV "), "{told}");
        assert!(["123456", "12 34 56", "1234"].iter().all(|key| !told.contains(key)), "{told}");
        assert!(told.contains("bytes of the chemistry") && told.contains("32 rows of data flash"), "{told}");

        // Nothing shows that the chemistry is the same.
        flash[chemistry..chemistry + 2].copy_from_slice(&[0x7f, 0x01]);
        lint(&flash);
        let says = ["another chemistry: CHEM_ID 0x0107", "the image has checksum 0x7f01", "--same-chemistry"];
        gaugefs(&["import", &gauge, &image]).failed(&says);
        let changes = "configuration-data/design-capacity: 1000 -> 2200 mAh\n\
                       it-cfg/cell-terminate-voltage: 3000 -> 3100 mV\n";
        let dry = gaugefs(&["import", "--dry-run", "--same-chemistry", &gauge, &image]);
        assert_eq!((dry.code, dry.out.as_str()), (Some(1), changes), "{}", dry.err);
        assert!(dry.err.contains("keys; left out") && dry.err.contains(" 5 passed over"), "{}", dry.err);
        let diff = gaugefs(&["diff", &gauge, &image]);
        assert_eq!((diff.code, diff.out.as_str()), (Some(1), changes), "{}", diff.err);

        // The gauge has the chemistry that the checksum is of.
        fs::write(format!("{gauge}/gauge/control"), "STATIC_CHEM_DF_CHKSUM").expect("it answers");
        let answer = read(&gauge, "gauge/control");
        let (code, sum) = answer.split_once(' ').expect("two words");
        assert_eq!(code, "0x0017");
        let sum = u16::from_str_radix(sum.trim_start_matches("0x"), 16).expect("a word");
        flash[chemistry..chemistry + 2].copy_from_slice(&sum.to_be_bytes());
        lint(&flash);
        let groups = ["--exclude", "undocumented,keys,learned"];
        let written = gaugefs(&[&["import"][..], &groups, &[&gauge, &image]].concat());
        assert_eq!((written.code, written.out.as_str()), (Some(0), changes), "{}", written.err);
        assert!(written.err.contains(&format!("same chemistry (CHEM_ID 0x0107, checksum 0x{sum:04x})")));
        assert_eq!((read(&gauge, "df/80/53"), read(&gauge, "df/48/11")), ("3100".into(), "2200".into()));
        assert_eq!(read(&gauge, "gauge/seal"), "sealed");
        let again = gaugefs(&["import", &gauge, &image]);
        assert_eq!((again.code, again.out.as_str()), (Some(3), ""), "{}", again.err);
        gaugefs(&["umount", &at]).done();
        let trace = fs::read_to_string(&trace).expect("the trace");
        assert!(trace.contains("W: AA 3E 50 01"), "data flash in normal mode");
        assert!(!trace.contains(": 16 ") && !trace.contains("W: AA 00 00 0F"), "never in ROM mode");
    });
}

/// Images of real packs have 0 in bits that the manual reserves and prints as 1. That does not keep the rest of such an
/// image from being written.
#[test]
fn reserved_bits_of_an_image_do_not_refuse_it() {
    all_parts(|part| {
        let (chip, firmware, subclasses, _) = part;
        let folder = Folder::new();
        let (at, image) = (folder.file("m"), folder.file("golden.df.fs"));
        gaugefs(&["mount", "--sim", chip, &at]).done();
        let gauge = format!("{at}/BAT0");
        let mut flash = data_flash(&gauge, part);
        let place = |id: u8| subclasses.iter().find(|row| row.0 == id).expect("a subclass").1;
        // [RSVD] of bits 6 and 4, and [LFPRelax], which has a name.
        flash[place(64) + 2] &= !0x54;
        flash[place(80) + 53..place(80) + 55].copy_from_slice(&3100u16.to_be_bytes());
        fs::write(&image, file(&flash, firmware, 2)).expect("a file");
        let old = read(&gauge, "df/64/2");
        let import = ["import", "--same-chemistry", &gauge, &image, "--exclude"];
        let written = gaugefs(&[&import[..], &["keys,learned"]].concat());
        assert_eq!(written.code, Some(3), "{}", written.err);
        let lines: Vec<&str> = written.out.lines().collect();
        assert!(lines.contains(&"it-cfg/cell-terminate-voltage: 3000 -> 3100 mV"), "{lines:?}");
        assert!(lines.len() == 2 && written.out.contains("pack-configuration-b: "), "{lines:?}");
        let says = format!("differs from the gauge's {old} in bits 0x50, which stay as they are");
        assert!(written.err.contains(&says), "{}", written.err);
        let word = |text: &str| u8::from_str_radix(text.trim_start_matches("0x"), 16).expect("a byte");
        assert_eq!(word(&read(&gauge, "df/64/2")), word(&old) & !0x04, "only the bit with a name is new");
        assert_eq!(read(&gauge, "df/80/53"), "3100");
        let accepted = gaugefs(&[&import[..], &["keys,learned,undocumented"]].concat());
        assert_eq!((accepted.code, accepted.out.as_str()), (Some(0), ""), "{}", accepted.err);
        // A comparison shows the bits, unless it is told not to.
        let shown = gaugefs(&["diff", &gauge, &image, "--exclude", "keys,learned"]);
        assert!(shown.code == Some(1) && shown.out.lines().count() == 1, "{}", shown.out);
        let excluded = gaugefs(&["diff", &gauge, &image, "--exclude", "keys,learned,undocumented"]);
        assert_eq!((excluded.code, excluded.out.as_str()), (Some(0), ""), "{}", excluded.err);
        gaugefs(&["umount", &at]).done();
    });
}

#[test]
fn an_image_of_the_other_part_or_with_firmware_is_refused() {
    all_parts(|part| {
        let (chip, firmware, _, _) = part;
        let folder = Folder::new();
        let (at, image) = (folder.file("m"), folder.file("golden.bq.fs"));
        gaugefs(&["mount", "--sim", chip, &at]).done();
        let gauge = format!("{at}/BAT0");
        let flash = data_flash(&gauge, part);
        fs::write(&image, file(&flash, firmware, 5)).expect("a file");
        for command in [&["lint", &image][..], &["import", &gauge, &image]] {
            gaugefs(command).failed(&["also holds the gauge's firmware", "--data-flash"]);
        }
        gaugefs(&["lint", "--data-flash", &image]).done();
        let diff = gaugefs(&["diff", "--data-flash", &gauge, &image]);
        assert_eq!((diff.code, diff.out.as_str()), (Some(0), ""), "{}", diff.err);
        let other = if firmware == 0x0016 { 0x0202 } else { 0x0016 };
        fs::write(&image, file(&flash, other, 2)).expect("a file");
        gaugefs(&["import", &gauge, &image])
            .failed(&["it is for ROM mode", &format!("firmware 0x{other:04x}")]);
        gaugefs(&["lint", &image]).failed(&["its data flash is not laid out as that of a bq34z100"]);
        gaugefs(&["umount", &at]).done();
    });
}

/// What a mount with --allow-unproven takes, so does an import with it: a gauge whose rows are all unproven is cloned.
#[test]
fn unproven_parameters_are_imported_on_request() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (one, other, file) = (folder.file("m"), folder.file("n"), folder.file("pack.toml"));
    for at in [&one, &other] {
        gaugefs(&["mount", "--sim", "bq35100", "--allow-unproven", at]).done();
    }
    let (from, to) = (format!("{one}/BAT0"), format!("{other}/BAT0"));
    // A value of each kind of row that can be changed.
    let index = fs::read_to_string(format!("{from}/df/index")).expect("the index");
    let unproven = index.lines().map(|line| line.split('\t').collect::<Vec<_>>()).find_map(|fields| {
        let (flags, value) = (fields[8], fields[9].parse::<i64>().ok()?);
        let max: i64 = fields[6].parse().ok()?;
        (flags == "unproven" && value < max).then(|| (format!("df/{}/{}", fields[0], fields[1]), value + 1))
    });
    let (path, value) = unproven.expect("an unproven row");
    fs::write(format!("{from}/{path}"), value.to_string()).expect("it can be written");
    gaugefs(&["export", &from, "-o", &file]).done();
    let passed_over = gaugefs(&["import", &to, &file]);
    assert_eq!(passed_over.code, Some(3), "{}", passed_over.err);
    assert!(passed_over.err.contains("its address or range is unproven"), "{}", passed_over.err);
    let written = gaugefs(&["import", "--allow-unproven", &to, &file]).done();
    assert_eq!(written.lines().count(), 1, "{written}");
    assert_eq!(read(&to, &path), value.to_string());
    assert_eq!(gaugefs(&["diff", &from, &to]).done(), "");
    gaugefs(&["umount", &other]).done();
    // The mount has to allow it, too.
    gaugefs(&["mount", "--sim", "bq35100", &other]).done();
    gaugefs(&["import", "--allow-unproven", &to, &file]).failed(&["mount with --allow-unproven"]);
    gaugefs(&["umount", &one]).done();
    gaugefs(&["umount", &other]).done();
}

#[test]
fn a_binary_image_is_refused_by_name() {
    let folder = Folder::new();
    for (name, bytes) in [("golden.dfi", &b"\x7f\x71\x20\x5c"[..]), ("golden", b"\x7f\x71\x00\x5c")] {
        let file = folder.file(name);
        fs::write(&file, bytes).expect("a file");
        gaugefs(&["lint", &file]).failed(&[&file, "a binary image of data flash (.dfi)"]);
    }
}
