// SPDX-License-Identifier: MIT

//! What is exported from one gauge, imported into another and exported from that one is the same file: for every part with
//! data flash, in every format that is written, with values at the ends of their ranges.

use std::fs;

use ti_gauge::chip::{CHIPS, Chip, Range, Signature};
use ti_gauge::image::{Entry, Format, Image};
use ti_gauge::value::Value;

use crate::drawn::one_in;
use crate::room::{Folder, Ran, can_mount, gaugefs};

/// The format, and which end of its range every value has that may have it.
const TURNS: [(&str, End); 3] = [("flashstream", End::Most), ("gg.csv", End::Least), ("toml", End::Most)];

#[derive(Clone, Copy, Debug)]
enum End {
    Least,
    Most,
}

/// Gives a value the end of its range. Flags, calibration, what the gauge rewrites itself, values with a limit of their
/// own and those that show where a firmware keeps its data flash stay: they decide whether the gauge measures, stores and
/// answers at all.
fn set(chip: &Chip, entry: &mut Entry, end: End) {
    let row = entry.parameter;
    let signs = |sign: &Signature| (sign.subclass, sign.offset) == (entry.subclass.id, row.offset);
    let signs = chip.signature.iter().any(signs);
    if signs
        || row.never.is_some()
        || row.learned
        || row.safe.is_some()
        || !row.bits.is_empty()
        || entry.subclass.class == "Calibration"
    {
        return;
    }
    entry.value = match (&row.range, end) {
        (Range::Int { min, .. }, End::Least) => Value::Int(*min),
        (Range::Int { max, .. }, End::Most) => Value::Int(*max),
        (Range::Float { min, .. }, End::Least) => Value::Float(*min),
        (Range::Float { max, .. }, End::Most) => Value::Float(*max),
        (Range::Text { .. }, End::Least) => Value::Text(Vec::new()),
        (Range::Text { .. }, End::Most) => Value::Text(vec![0xfe; row.kind.size() - 1]),
    };
}

fn exported(gauge: &str, format: &str) -> String {
    gaugefs(&["export", gauge, "--format", format]).done()
}

/// The two exports, and how many values the import between them has written.
fn turn(chip: &'static Chip, folder: &Folder, [from, to]: [&str; 2], format: &str, end: End) -> usize {
    let at = format!("{} {format} {end:?}", chip.name);
    let file = folder.file("pack");
    let import = |gauge: &str| gaugefs(&["import", "--allow-unproven", gauge, &file]);
    let kept = Image::parse(&exported(from, "toml"), None).unwrap_or_else(|error| panic!("{at}: {error}"));
    let mut wanted = Image::parse(&exported(from, "toml"), None).expect("the same");
    wanted.entries.iter_mut().for_each(|entry| set(chip, entry, end));
    let mut refusals = Vec::new();
    loop {
        let text = wanted.write(Format::Toml, |_| Ok(Vec::new())).expect("every value fits");
        fs::write(&file, text).expect("a file");
        let Ran { code, err, .. } = import(from);
        if code == Some(0) {
            break;
        }
        // The gauge needs another value of this one; it stays as it is.
        let of_it = |entry: &Entry| {
            err.contains(&format!("{} (", entry.parameter.name))
                || err.contains(&format!("{}: ", entry.parameter.name))
        };
        let mut found = false;
        for (entry, old) in wanted.entries.iter_mut().zip(&kept.entries) {
            if of_it(entry) && entry.value != old.value {
                (entry.value, found) = (old.value.clone(), true);
            }
        }
        refusals.push(err.clone());
        assert!(found && refusals.len() < 10, "{at}: {code:?}: {refusals:?}");
    }
    let first = exported(from, format);
    fs::write(&file, &first).expect("a file");
    let written = import(to);
    assert!(matches!(written.code, Some(0 | 3)), "{at}: {}", written.err);
    let second = exported(to, format);
    let differ = first.lines().zip(second.lines()).find(|(one, other)| one != other);
    assert!(first == second, "{at}: {differ:?}; {}", written.err);
    let again = import(to);
    assert_eq!(again.out, "", "{at}: nothing is left to write");
    written.out.lines().count()
}

#[test]
fn an_export_that_is_imported_into_another_gauge_is_exported_the_same() {
    if !can_mount() {
        return;
    }
    let chips = || CHIPS.iter().filter(|chip| chip.is_proven());
    assert_eq!(chips().count(), 15);
    let check = |chip: &'static Chip, format, end| {
        let folder = Folder::new();
        let mounts = ["m", "n"].map(|name| folder.file(name));
        for at in &mounts {
            gaugefs(&["mount", "--sim", chip.name, "--allow-unproven", "--writes-per-hour", "0", at]).done();
            // Nothing that a battery does meanwhile may change a value.
            fs::write(format!("{at}/BAT0/sim/speed"), "0").expect("a knob");
        }
        let [from, to] = [0, 1].map(|index| format!("{}/BAT0", mounts[index]));
        let written = turn(chip, &folder, [&from, &to], format, end);
        // A FlashStream of a flat part has the proven ones only, and a third of the bq28z610's few have no limit of their own.
        let proven = chip.rows().filter(|(_, row)| !row.unproven).count();
        let least = if proven > 20 { 20 } else { proven / 3 };
        assert!(written > least, "{} {format}: {written} values", chip.name);
        for at in &mounts {
            gaugefs(&["umount", at]).done();
        }
    };
    // Each waits for its gauges. With one in two every format has some parts, as their number is odd.
    let turns = chips().flat_map(|chip| TURNS.map(|turn| (chip, turn)));
    std::thread::scope(|scope| {
        for (chip, (format, end)) in one_in(2, turns) {
            scope.spawn(move || check(chip, format, end));
        }
    });
}
