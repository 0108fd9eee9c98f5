// SPDX-License-Identifier: MIT

//! What the pages promise of tests: each way in of the threat model is attacked by one, and each check before a write is
//! left out by a rule of `tests/mutations`.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

use super::room::{root, within_code};

/// One way in.
struct Threat {
    way_in: String,
    tests: String,
}

/// The ways in of docs/SECURITY.md, with the tests of each from `threats.list`, which has the same ways in the same order.
fn threats() -> Vec<Threat> {
    let page = fs::read_to_string(root().join("docs/SECURITY.md")).expect("the page");
    let mut is_threat = false;
    let rows = page.lines().filter(|line| {
        is_threat = line.starts_with('|') && (is_threat || line.starts_with("| way in |"));
        is_threat && !line.starts_with("| way in |") && !line.starts_with("| ---")
    });
    let cells = |row: &str| row.trim_matches('|').split('|').map(|cell| cell.trim().to_string()).collect();
    let ways: Vec<String> = rows
        .map(|row| {
            let [way_in, holds] = <[String; 2]>::try_from(Vec::from_iter::<Vec<_>>(cells(row)))
                .unwrap_or_else(|cells| panic!("two cells: {cells:?}"));
            assert!(!way_in.is_empty() && !holds.is_empty(), "{row}");
            way_in
        })
        .collect();
    let list = fs::read_to_string(root().join("tests/it/threats.list")).expect("the list");
    let attacks = list.lines().filter(|line| !line.starts_with('#'));
    let attacks: Vec<(&str, &str)> =
        attacks.map(|line| line.split_once(" | ").expect("a way in, and its tests")).collect();
    assert_eq!(ways, Vec::from_iter(attacks.iter().map(|(way, _)| *way)), "the page; the list");
    attacks.into_iter().map(|(way_in, tests)| Threat { way_in: way_in.into(), tests: tests.into() }).collect()
}

/// The files of a kind below the folders with code and tests.
fn files(end: &str) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = ["src", "crates", "tests"].map(|folder| root().join(folder)).into();
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder of the checkout") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_string_lossy().ends_with(end) {
                found.push(path);
            }
        }
    }
    found
}

/// The names of all tests.
fn tests() -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for file in files(".rs") {
        let text = fs::read_to_string(&file).expect("a file of the checkout");
        let mut lines = text.lines().map(str::trim);
        while let Some(line) = lines.next() {
            if line != "#[test]" {
                continue;
            }
            let function = lines
                .find_map(|line| line.trim_start_matches("pub(crate) ").strip_prefix("fn "))
                .unwrap_or_default();
            names.extend(function.split('(').next().map(str::to_string));
        }
    }
    names
}

/// What a cell names as a test, and whether it exists.
fn exists(named: &str, tests: &BTreeSet<String>, sources: &[PathBuf]) -> bool {
    if let Some(module) = named.strip_suffix("::tests") {
        let file = format!("/{}.rs", module.replace("::", "/"));
        let found = sources.iter().filter(|path| path.to_string_lossy().ends_with(&file));
        return found.map(fs::read_to_string).any(|text| text.is_ok_and(|text| text.contains("mod tests")));
    }
    if named.ends_with(".rs") || named.starts_with("tests/") {
        let is_it = |path: &PathBuf| {
            path.ends_with(named) && path.components().any(|part| part.as_os_str() == "tests")
        };
        let is_place = named.starts_with("src/") || named.starts_with("tests/");
        return is_place && root().join(named).exists() || sources.iter().any(is_it);
    }
    let others = ["tests/vm/guest", "tests/boot/guest", "tests/fuzz/corpus", "crates"];
    tests.contains(named) || others.iter().any(|folder| root().join(folder).join(named).exists())
}

#[test]
fn each_line_of_the_threat_model_has_its_test() {
    let (tests, sources) = (tests(), files(".rs"));
    let boot: String = files("")
        .iter()
        .filter(|path| path.starts_with(root().join("tests/boot/guest")))
        .map(|path| fs::read_to_string(path).expect("a file of the checkout"))
        .collect();
    let (mut ways, mut count, mut wrong, mut attacks) = (0, 0, Vec::new(), BTreeSet::new());
    for Threat { way_in, tests: cell } in threats() {
        ways += 1;
        let mut attacked = 0;
        for named in within_code(&cell) {
            attacks.extend(tests.contains(named).then(|| named.to_string()));
            match exists(named, &tests, &sources) {
                // A crate or a source file is where the test beside it is.
                true => {
                    attacked +=
                        u32::from(!named.starts_with("src/") && !root().join("crates").join(named).is_dir())
                }
                false => wrong.push(format!("{way_in}: there is no {named}")),
            }
        }
        if let Some((_, checks)) = cell.split_once("boot: ") {
            for check in checks.split(", ") {
                match boot.contains(check) {
                    true => attacked += 1,
                    false => wrong.push(format!("{way_in}: tests/boot/guest does not check that {check}")),
                }
            }
        }
        if attacked == 0 {
            wrong.push(format!("{way_in}: no test"));
        }
        count += attacked;
    }
    println!("{ways} ways in, {count} tests");
    // `tests/campaign` runs these.
    println!("attacks: {}", Vec::from_iter(attacks).join(" "));
    assert!(ways > 25, "{ways} ways in");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn each_check_before_a_write_has_a_rule_that_still_fits_the_code() {
    let checked = Command::new("python3").arg(root().join("tests/mutations")).arg("--check").output();
    match checked {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => eprintln!("SKIPPED: no python3"),
        checked => {
            let checked = checked.expect("it runs");
            assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
        }
    }
}
