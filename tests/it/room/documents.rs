// SPDX-License-Identifier: MIT

//! The documents that tests are held against.

use std::fs;
use std::path::PathBuf;

pub(crate) const TEXT: &str = include_str!("../../../docs/SEMANTICS.md");

/// The cells of each row of the table below a heading of a document.
pub(crate) fn table(document: &'static str, heading: &str) -> Vec<Vec<&'static str>> {
    let section = document.split_once(&format!("\n{heading}\n")).expect("the section is there").1;
    let rows =
        section.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    rows.skip(2).map(|row| row.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

pub(crate) fn readme() -> String {
    fs::read_to_string(root().join("README.md")).expect("the README")
}

/// A page of `docs/`.
pub(crate) fn page(name: &str) -> String {
    fs::read_to_string(root().join("docs").join(name)).expect(name)
}

/// The text below a heading of a page.
pub(crate) fn section<'a>(text: &'a str, heading: &str) -> &'a str {
    let after = text.split_once(&format!("\n## {heading}\n")).expect("the section").1;
    after.split("\n## ").next().expect("its text")
}

/// The cells of the rows of a section's tables.
pub(crate) fn rows(text: &str, heading: &str) -> Vec<Vec<String>> {
    let rows = section(text, heading).lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix('|'));
    rows.map(|row| row.split('|').map(|cell| cell.trim().to_string()).collect()).collect()
}

/// What a cell has in backticks.
pub(crate) fn within_code(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}
