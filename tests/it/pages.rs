// SPDX-License-Identifier: MIT

//! Runs the code blocks of every page, in their order, on simulated gauges; `room::session` has how. What cannot be run
//! is marked in the page.

use std::fs;

use crate::room::{Session, Step, apart, can_mount, root, steps, table};

/// The pages with code blocks. The first two have tests of their own.
macro_rules! pages {
    ($($test:ident: $page:literal, $least:literal;)*) => {
        /// Each, and how many of its commands are run at least.
        const PAGES: &[&str] = &["docs/BY-HAND.md", "docs/PRODUCTION.md", $($page),*];

        $(#[test]
        fn $test() {
            runs($page, $least);
        })*
    };
}

pages! {
    the_readme: "README.md", 22;
    semantics: "docs/SEMANTICS.md", 1;
    smart_batteries: "docs/SMART-BATTERIES.md", 4;
    simulator: "docs/SIMULATOR.md", 10;
    images: "docs/IMAGES.md", 8;
    monitors: "docs/MONITORS.md", 0;
    fleet: "docs/FLEET.md", 3;
    python: "docs/PYTHON.md", 1;
    c_and_rust: "docs/C-AND-RUST.md", 5;
    raspberry_pi: "docs/RASPBERRY-PI.md", 0;
    adapters: "docs/ADAPTERS.md", 0;
    forgetful: "docs/FORGETFUL.md", 3;
    numbers: "docs/NUMBERS.md", 10;
    commands: "docs/COMMANDS.md", 1;
    keys: "docs/KEYS.md", 0;
    recovery: "docs/RECOVERY.md", 0;
    calibration: "docs/CALIBRATION.md", 0;
    packaging: "docs/PACKAGING.md", 0;
    architecture: "docs/ARCHITECTURE.md", 0;
}

fn runs(page: &str, least: usize) {
    if !can_mount() {
        return;
    }
    // Where root runs the tests, no gauge of another one has the name of a page's.
    apart();
    let text = fs::read_to_string(root().join(page)).expect("the page");
    let mut session = Session::new();
    for step in steps(&text, None) {
        session.step(&step);
    }
    assert!(session.ran >= least, "{page}: {} commands were run", session.ran);
}

/// The column of what to type in docs/COMPARISON.md, row by row.
#[test]
fn comparison() {
    if !can_mount() {
        return;
    }
    let page = include_str!("../../docs/COMPARISON.md");
    let rows = table(page, "## Everyday jobs");
    let mut session = Session::new();
    let step = |line: &str, ended| Step::Run { line: line.into(), code: None, prints: String::new(), ended };
    let config = "printf '[defaults]\\npoll = 0.5\\n[[gauge]]\\nsim = \"bq34z100-g1\"\\n[[gauge]]\\nsim = \"bq34z100-g1\"\\n' > two.toml";
    session.step(&step(config, false));
    session.step(&step("gaugefs mount --config two.toml /run/gauges", false));
    for row in rows {
        let command = row[1].split('`').nth(1).unwrap_or_default().replace("BAT", "/run/gauges/BAT");
        // Of this mount, not of those that other tests take away meanwhile.
        let command = if command.ends_with("--count 1") { command + " /run/gauges" } else { command };
        let lasts = ["gaugefs log", "gaugefs wait"].iter().any(|verb| command.starts_with(verb));
        session.step(&step(&command, lasts));
    }
    assert!(session.ran >= 10, "{} commands", session.ran);
}

#[test]
fn every_page_with_code_is_run() {
    let folder = fs::read_dir(root().join("docs")).expect("a folder");
    let pages =
        folder.map(|entry| format!("docs/{}", entry.expect("an entry").file_name().to_string_lossy()));
    for page in pages.filter(|page| page.ends_with(".md")).chain(["README.md".into()]) {
        let text = fs::read_to_string(root().join(&page)).expect("the page");
        let has_code = text.lines().any(|line| line.starts_with("```"));
        assert!(!has_code || PAGES.contains(&page.as_str()), "{page}: no test runs it");
    }
}
