// SPDX-License-Identifier: MIT

//! Holds docs/BY-HAND.md and docs/PRODUCTION.md to what gaugefs does: every command of the worked example and of the rehearsal
//! is run as it is printed, in its order, and prints what the document shows. The hidden comments of the document turn the
//! knobs of the simulated gauge.

use std::fs;
use std::path::Path;

use crate::room::{CHIP, Session, Step, can_mount, steps, table};

const BY_HAND: &str = include_str!("../../docs/BY-HAND.md");
const TEXT: &str = include_str!("../../docs/PRODUCTION.md");

#[test]
fn production_by_hand_is_as_printed() {
    if !can_mount() {
        return;
    }
    let mut session = Session::new();
    session.strict = true;
    // What is printed does not show how long somebody has waited.
    session.sim = format!("--sim {CHIP} --fast --poll 0.5 --state-dir state --sim-state flash");
    let steps = steps(BY_HAND, None);
    // What a gauge of TI's is when it is delivered, and what the pack is, before the first look at it.
    let pack = steps.iter().find_map(|step| if let Step::Knobs(knobs) = step { Some(knobs) } else { None });
    let mut is_new = true;
    for step in &steps {
        session.step(step);
        let mounts = matches!(step, Step::Run { line, .. } if line.starts_with("gaugefs mount "));
        if mounts && std::mem::take(&mut is_new) {
            fs::write(session.file("m/BAT0/gauge/seal"), "full-access").expect("a new gauge is open");
            session.turn(pack.expect("the pack"));
        }
    }
    assert!(session.ran > 25, "{} commands", session.ran);
}

#[test]
fn a_rehearsal_is_as_printed() {
    let mut session = Session::new();
    session.strict = true;
    let by_hand = steps(BY_HAND, None);
    let image = by_hand.iter().filter(|step| matches!(step, Step::File(name, _) if name == "golden.toml"));
    for step in image.chain(&steps(TEXT, Some("### Trying it"))) {
        session.step(step);
    }
    assert_eq!(session.ran, 3);
}

/// The text of all sources in a folder, without the ends of lines that a long string is broken at.
fn sources(folder: &Path) -> String {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries
        .map(
            |path| if path.is_dir() { sources(&path) } else { fs::read_to_string(&path).unwrap_or_default() },
        )
        .map(|text| text.split("\\\n").map(str::trim_start).collect::<String>())
        .collect()
}

#[test]
fn what_can_go_wrong_is_said_so() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = sources(&root.join("src")) + &sources(&root.join("crates"));
    for rows in [table(BY_HAND, "## What can go wrong"), table(TEXT, "FAIL has the reason behind it:")] {
        assert!(rows.len() > 6, "{rows:?}");
        for row in rows {
            let quoted = row[0].split('`').skip(1).step_by(2);
            for part in quoted.flat_map(|quoted| quoted.split("...")) {
                assert!(text.contains(part.trim()), "no message has `{part}`: {row:?}");
            }
        }
    }
}
