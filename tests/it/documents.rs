// SPDX-License-Identifier: MIT

//! The documents as a whole: every link leads to a file and a heading, and the README's map has every page.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use gauge_bus::adapters::{AdapterModel, Source};

use super::room::{page, readme, rows, section, within_code};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn pages(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).expect("a folder").map(|entry| entry.expect("an entry"));
    entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "md")).collect()
}

/// The lines of a page outside of its code blocks.
fn prose(page: &str) -> impl Iterator<Item = &str> {
    let mut in_code = false;
    page.lines().filter(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        in_code ^= is_fence;
        !in_code && !is_fence
    })
}

/// The anchor that GitHub makes of a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|letter| letter.is_alphanumeric() || " -_".contains(*letter));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

fn anchors(page: &str) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    for line in prose(page).filter(|line| line.starts_with('#')) {
        let anchor = anchor(line.trim_start_matches('#').trim());
        assert!(seen.insert(anchor.clone()), "two headings have the anchor #{anchor}");
    }
    seen
}

/// The targets of the links in a page, its pictures included.
fn links(page: &str) -> Vec<String> {
    // A link may be broken across two lines.
    let text = prose(page).collect::<Vec<_>>().join("\n");
    // What is in backticks is no link.
    let text: String = text.split('`').step_by(2).collect();
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    targets.map(|(target, _)| target.to_string()).collect()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn every_link_leads_to_a_file_and_a_heading() {
    let mut all = [pages("."), pages("docs")].concat();
    for entry in fs::read_dir(root().join("crates")).expect("a folder") {
        let page = entry.expect("an entry").path().join("README.md");
        all.extend(page.exists().then_some(page));
    }
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in &all {
        for link in links(&read(page)) {
            if link.contains("://") {
                continue;
            }
            count += 1;
            let (file, heading) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { page.clone() } else { page.with_file_name(file) };
            let leads = target.exists() && (heading.is_empty() || anchors(&read(&target)).contains(heading));
            if !leads {
                wrong.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(count > 80, "{count} links");
}

#[test]
fn the_map_of_the_readme_has_every_page() {
    let readme = readme();
    let map: BTreeSet<String> =
        links(section(&readme, "All pages")).into_iter().filter(|link| link.starts_with("docs/")).collect();
    let name = |path: &PathBuf| format!("docs/{}", path.file_name().expect("a name").to_string_lossy());
    assert_eq!(map, pages("docs").iter().map(name).collect());
}

/// GitHub shows the rows below a blank line as text.
#[test]
fn regression_a_blank_line_cut_a_table_in_two() {
    for path in [pages("."), pages("docs")].concat() {
        let text = read(&path);
        let lines: Vec<_> = prose(&text).collect();
        let is_row = |at: usize| lines.get(at).is_some_and(|line| line.starts_with('|'));
        for at in (0..lines.len()).filter(|&at| is_row(at) && (at == 0 || !is_row(at - 1))) {
            let has_head = lines.get(at + 1).is_some_and(|line| line.starts_with("| ---"));
            assert!(has_head, "{}: no head above: {}", path.display(), lines[at]);
        }
    }
}

/// What gaugefs knows of an adapter is in the models of gauge-bus; who buys one reads the page.
#[test]
fn the_page_of_adapters_has_a_row_for_each_driver() {
    let rows: Vec<_> = rows(&page("ADAPTERS.md"), "Adapters").into_iter().skip(2).collect();
    let told: Vec<_> = rows.iter().flat_map(|row| within_code(&row[1])).collect();
    let drivers: BTreeSet<_> = AdapterModel::all().map(|model| model.driver).collect();
    assert_eq!(told.iter().copied().collect::<BTreeSet<_>>(), drivers, "the page; the models");
    assert_eq!(told.len(), drivers.len(), "{told:?}");
    for model in AdapterModel::all() {
        let row = rows.iter().find(|row| within_code(&row[1]).any(|driver| driver == model.driver));
        let [.., clock, read, notes] = &row.expect("a row")[..] else { panic!("five cells: {row:?}") };
        let told = match model.clock {
            Source::Driver(hertz) | Source::Since(_, hertz) => {
                clock.starts_with(&format!("{} kHz", hertz / 1000))
            }
            Source::File(name) => notes.contains(&format!("the file `{name}`")),
            Source::Tree => true,
        };
        assert!(told, "the clock of {}: {row:?}", model.name);
        let beside_bits = model.pace(1, 2).as_millis();
        assert_eq!(
            *read,
            if beside_bits > 0 { format!("{beside_bits} ms") } else { String::new() },
            "{row:?}"
        );
        let waits = format!("waits {} ms for a gauge", model.waits(true).as_millis());
        let is_host = model.reach().smbus;
        assert!(is_host || !model.is_impatient() || notes.contains(&waits), "{waits}: {row:?}");
        assert_eq!(is_host && model.name != "i2c-stub", notes.starts_with("[SMBus only]"), "{row:?}");
    }
}

/// A program that reads `error_details` has only the table to go by.
#[test]
fn every_reason_of_a_failure_is_documented() {
    let page = read(&root().join("docs/COMMANDS.md"));
    let rows = page.lines().skip_while(|line| *line != "| `reason` | fields |").skip(2);
    let documented: Vec<_> =
        rows.map_while(|row| row.strip_prefix("| `")?.split_once('`')).map(|(name, _)| name).collect();
    assert_eq!(documented, ti_gauge::error::Reason::NAMES);
}

/// A machine that boots with an empty pack on its charger would be turned off again.
#[test]
fn regression_an_example_turned_a_charging_machine_off() {
    let files = ["README.md", "src/cli/watch.rs", "docs", "udev", "docs/fleet"].map(|path| root().join(path));
    let all = files.into_iter().flat_map(|path| match fs::read_dir(&path) {
        Ok(entries) => entries.map(|entry| entry.expect("an entry").path()).collect(),
        Err(_) => vec![path],
    });
    let mut count = 0;
    for path in all.filter(|path| path.is_file()) {
        let text = fs::read_to_string(&path).unwrap_or_default();
        let lines: Vec<_> = text.lines().collect();
        let ends = |line: &str| line.contains("poweroff") && line.contains("exec");
        for at in (0..lines.len()).filter(|at| ends(lines[*at])) {
            count += 1;
            // A table of a file has its condition above.
            let example = lines[at.saturating_sub(3)..=at].join("\n");
            assert!(example.contains("status==Discharging"), "{}: {example}", path.display());
        }
    }
    assert!(count >= 6, "{count} examples");
}

#[test]
fn every_cause_of_a_failure_is_documented() {
    let page = read(&root().join("docs/COMMANDS.md"));
    let row = page.lines().find(|line| line.starts_with("| `errno`, `cause` |")).expect("a row");
    let (_, causes) = row.split_once("is one of ").expect("a list");
    let documented: Vec<_> = causes.split('`').skip(1).step_by(2).collect();
    assert_eq!(documented, ti_gauge::error::Cause::NAMES);
}
