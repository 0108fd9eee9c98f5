// SPDX-License-Identifier: MIT

//! Ceilings: how much product there is, how long its functions are, and how much state a gauge has. A change lowers them,
//! or its commit says why not.
//!
//! Read from the sources as `rustfmt` leaves them. Tests are no product: files and items below `#[cfg(test)]`, and a rig.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::{crates, files, without_tests};

/// The most lines of each crate.
const LINES: [(&str, usize); 10] = [
    ("gauge-bus", 3_380),
    ("gauge-owner", 7_830),
    ("gauge-sim", 13_320),
    ("gauge-station", 3_800),
    ("gaugefs", 19_880),
    ("gaugefs-client", 2_850),
    ("gaugefs-host", 600),
    ("gaugefs-screen", 6_170),
    ("i2c-server", 1_300),
    ("ti-gauge", 37_470),
];

/// The least lines of code to one of comment in each crate, in tenths. What others use has a line for each public item.
const CODE_TO_COMMENT: [(&str, usize); 10] = [
    ("gauge-bus", 49),
    ("gauge-owner", 63),
    ("gauge-sim", 72),
    ("gauge-station", 75),
    ("gaugefs", 73),
    ("gaugefs-client", 50),
    ("gaugefs-host", 37),
    ("gaugefs-screen", 86),
    ("i2c-server", 38),
    ("ti-gauge", 70),
];

/// A function is long above that many lines, and so many are.
const LONG: usize = 80;
const LONG_FUNCTIONS: usize = 1;

/// The most fields of the structs that hold what they say.
const FIELDS: [(&str, &str, usize); 3] =
    [("gauge-owner", "Owner", 6), ("ti-gauge", "DataFlash", 5), ("ti-gauge", "Gauge", 10)];

/// All that one gauge is: how it is run, what its owner and those who read know of it, and what the engine knows of the gauge
/// and its pack. Each by the file that declares it, below its crate's sources.
const GAUGE: [(&str, &str); 36] = [
    ("gauge-owner", "options.rs GaugeOptions"),
    ("gauge-owner", "opening.rs Opening"),
    ("gauge-owner", "opening.rs Ready"),
    ("gauge-owner", "source.rs Opened"),
    ("gauge-owner", "owner.rs Run"),
    ("gauge-owner", "owner.rs Owner"),
    ("gauge-owner", "owner/access.rs Access"),
    ("gauge-owner", "owner/backup.rs Backups"),
    ("gauge-owner", "owner/debt.rs Debt"),
    ("gauge-owner", "owner/handle.rs Published"),
    ("gauge-owner", "owner/handle.rs Shared"),
    ("gauge-owner", "owner/handle.rs Snapshot"),
    ("gauge-owner", "owner/identity.rs Identity"),
    ("gauge-owner", "owner/learning.rs Learning"),
    ("gauge-owner", "owner/memory.rs Memory"),
    ("gauge-owner", "owner/profile.rs Profile"),
    ("gauge-owner", "owner/readings.rs Readings"),
    ("gauge-owner", "owner/schedule.rs Schedule"),
    ("gauge-owner", "owner/turn.rs Turn"),
    ("ti-gauge", "registers.rs Registers"),
    ("ti-gauge", "gauge.rs Gauge"),
    ("ti-gauge", "gauge/access.rs Access"),
    ("ti-gauge", "gauge/effects.rs Effects"),
    ("ti-gauge", "gauge/effects.rs Watch"),
    ("ti-gauge", "gauge/presence.rs Presence"),
    ("ti-gauge", "gauge/seal.rs Looks"),
    ("ti-gauge", "gauge/statistics.rs Statistics"),
    ("ti-gauge", "gauge/wire.rs Wire"),
    ("ti-gauge", "dataflash.rs DataFlash"),
    ("ti-gauge", "dataflash/debts.rs Debts"),
    ("ti-gauge", "dataflash/debts.rs Pending"),
    ("ti-gauge", "dataflash/knowledge.rs Knowledge"),
    ("ti-gauge", "dataflash/knowledge/preflight.rs KnownPack"),
    ("ti-gauge", "dataflash/records.rs Records"),
    ("ti-gauge", "dataflash/rules.rs Rules"),
    ("ti-gauge", "dataflash/rules.rs Wear"),
];
/// The most fields of all of them. Thirty-two are options that people set, thirteen are counters that the program reads.
const GAUGE_FIELDS: usize = 271;

/// The files of a crate that are product, and their text without tests.
fn product(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut all = Vec::new();
    files(&folder.join("src"), &mut all);
    all.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let texts: BTreeMap<PathBuf, String> = all
        .into_iter()
        .map(|path| (path.clone(), fs::read_to_string(&path).expect("a file of the checkout")))
        .collect();
    let tests: BTreeSet<PathBuf> =
        texts.iter().flat_map(|(path, text)| test_modules(text).map(|name| below(path, name))).collect();
    let is_test = |path: &Path| path.ancestors().any(|folder| tests.contains(&folder.with_extension("")));
    texts
        .into_iter()
        .filter(|(path, _)| !is_test(path))
        .map(|(path, text)| (path, without_tests(&text)))
        .collect()
}

/// The modules with files of their own that only a test has.
fn test_modules(text: &str) -> impl Iterator<Item = &str> {
    let mut is_test = false;
    text.lines().filter_map(move |line| {
        let was_test = is_test;
        is_test = line.starts_with("#[cfg(") && line.contains("test") || was_test && line.starts_with("#[");
        let (_, name) = line.strip_suffix(';').filter(|_| was_test)?.rsplit_once("mod ")?;
        Some(name)
    })
}

/// The place of a module that a file declares, without its extension.
fn below(file: &Path, module: &str) -> PathBuf {
    let place = file.with_extension("");
    let is_root = ["lib", "main", "mod"].iter().any(|name| place.ends_with(name));
    if is_root { place.with_file_name(module) } else { place.join(module) }
}

/// The functions of a text, each with its number of lines from `fn` to its end.
fn functions(text: &str) -> Vec<(&str, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let indent = line.len() - line.trim_start().len();
        let words = || line.trim_start().split(' ').take_while(|word| !word.contains('='));
        let Some(name) = words().skip_while(|word| *word != "fn").nth(1) else { continue };
        let is_end = |line: &&str| line.len() == indent + 1 && line.ends_with(['}', ';']);
        let has_no_body = |line: &&str| {
            line.ends_with(';') && line[..indent].trim().is_empty() && !line[indent..].starts_with(' ')
        };
        let length = lines[at..].iter().take_while(|line| !is_end(line) && !has_no_body(line)).count() + 1;
        let is_short = line.ends_with('}') || line.ends_with(';');
        found.push((name.split(['(', '<']).next().unwrap_or(name), if is_short { 1 } else { length }));
    }
    found
}

/// The fields of a struct at the top level of a text.
fn fields(text: &str, name: &str) -> Option<usize> {
    let start = format!("struct {name} {{\n");
    let (_, body) = text.split_once(&start)?;
    let body = body.split("\n}").next()?;
    let is_field = |line: &&str| {
        let line = line.strip_prefix("    ").unwrap_or_default();
        line.starts_with(|letter: char| letter.is_lowercase()) && line.contains(": ")
    };
    Some(body.lines().filter(is_field).count())
}

/// How many lines of a text are comments, and how many are code.
fn lines(text: &str) -> (usize, usize) {
    let written = || text.lines().map(str::trim_start).filter(|line| !line.is_empty());
    let comments = written().filter(|line| line.starts_with("//")).count();
    (comments, written().count() - comments)
}

fn name(folder: &Path) -> String {
    let name = folder.file_name().and_then(|name| name.to_str()).expect("a name");
    let is_package = folder == Path::new(env!("CARGO_MANIFEST_DIR"));
    if is_package { "gaugefs".into() } else { name.into() }
}

#[test]
fn no_crate_outgrows_its_ceiling() {
    let ceilings = BTreeMap::from(LINES);
    let mut found = Vec::new();
    for folder in crates() {
        let name = name(&folder);
        let lines: usize = product(&folder).values().map(|text| text.lines().count()).sum();
        let ceiling = *ceilings.get(&*name).unwrap_or_else(|| panic!("{name} has no ceiling"));
        println!("{name}: {lines} of {ceiling}");
        // A ceiling far above is none.
        if lines > ceiling || lines < ceiling - ceiling / 5 {
            found.push(format!("{name} has {lines} lines; its ceiling is {ceiling}"));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn no_crate_has_more_comments_than_its_ceiling() {
    let least = BTreeMap::from(CODE_TO_COMMENT);
    let mut found = Vec::new();
    for folder in crates() {
        let name = name(&folder);
        let (comments, code) = product(&folder)
            .values()
            .map(|text| lines(text))
            .fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        let least = *least.get(&*name).unwrap_or_else(|| panic!("{name} has no ceiling of comments"));
        let tenths = code * 10 / comments;
        println!("{name}: {comments} of comment, {code} of code: 1 to {tenths} tenths, at least {least}");
        // Much more code to a comment than the ceiling asks for would let as many comments come back.
        if tenths < least || tenths > least + least / 5 {
            found.push(format!(
                "{name} has {tenths} tenths of a line of code to one of comment; {least} are asked for"
            ));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn few_functions_are_long() {
    let mut found = Vec::new();
    for folder in crates() {
        for (path, text) in product(&folder) {
            let long = functions(&text).into_iter().filter(|(_, lines)| *lines > LONG);
            found.extend(long.map(|(name, lines)| format!("{}: {name} has {lines} lines", path.display())));
        }
    }
    assert!(found.len() <= LONG_FUNCTIONS, "{}", found.join("\n"));
}

#[test]
fn the_state_of_a_gauge_has_a_ceiling() {
    for (crate_, name, ceiling) in FIELDS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates").join(crate_);
        let counts: Vec<usize> = product(&folder).values().filter_map(|text| fields(text, name)).collect();
        assert!(
            counts.len() == 1 && (1..=ceiling).contains(&counts[0]),
            "{crate_} {name}: {counts:?} of {ceiling}"
        );
    }
}

#[test]
fn all_that_a_gauge_is_has_a_ceiling() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates");
    let mut sum = 0;
    for (crate_, place) in GAUGE {
        let (file, name) = place.split_once(' ').expect("a file and a name");
        let text = fs::read_to_string(crates.join(crate_).join("src").join(file)).expect(place);
        let count = fields(&without_tests(&text), name).unwrap_or_else(|| panic!("{crate_}: no {place}"));
        println!("{place}: {count}");
        sum += count;
    }
    assert!(sum <= GAUGE_FIELDS, "{sum} fields; the ceiling is {GAUGE_FIELDS}");
}

#[test]
fn functions_fields_and_tests_are_found() {
    let text = "pub(crate) fn one(&self) -> u8 {\n    1\n}\n\ntrait A {\n    fn none(&self);\n    fn more(\n        &self,\n    ) -> bool;\n\
                }\nimpl A for B {\n    fn two(\n        &self,\n    ) {\n        fn inner() {}\n    }\n}\nlet x = \"fn y\";\n";
    assert_eq!(functions(text), [("one", 3), ("none", 1), ("more", 3), ("two", 5), ("inner", 1)]);
    let text = "/// A: b.\npub struct Gauge {\n    /// Its bus: one.\n    pub bus: u8,\n    #[x]\n    a: Vec<(u8, u8)>,\n}\n";
    assert_eq!((fields(text, "Gauge"), fields(text, "Bus")), (Some(2), None));
    let text =
        "#[cfg(test)]\nmod tests;\n#[cfg(any(test, feature = \"rig\"))]\n#[x]\npub mod rig;\nmod other;\n";
    assert_eq!(test_modules(text).collect::<Vec<_>>(), ["tests", "rig"]);
}
