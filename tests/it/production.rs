// SPDX-License-Identifier: MIT

//! Holds docs/PRODUCTION.md to what gaugefs does: every command of its worked example is run as it is printed, in its
//! order, and prints what the document shows. The hidden comments of the document turn the knobs of the simulated gauge.

use std::collections::VecDeque;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::room::{CHIP, Folder, can_mount, within};

const TEXT: &str = include_str!("../../docs/PRODUCTION.md");

/// A step of the document.
#[derive(Debug, PartialEq)]
enum Step {
    /// A file, by name.
    File(String, String),
    /// Knobs and their values.
    Knobs(Vec<(String, String)>),
    /// A command line, its exit code, and what it prints.
    Run { line: String, code: i32, prints: String },
}

/// The steps of a section, by its heading.
fn steps(text: &str, heading: &str) -> Vec<Step> {
    let section = text.split_once(&format!("\n## {heading}\n")).expect("the section is there").1;
    let section = section.split("\n## ").next().unwrap_or_default();
    let mut steps = Vec::new();
    let mut lines = section.lines();
    while let Some(line) = lines.next() {
        if let Some(knobs) = line.strip_prefix("<!-- sim: ").and_then(|rest| rest.strip_suffix(" -->")) {
            let knobs = knobs.split("; ").map(|knob| knob.split_once(' ').expect("a knob and its value"));
            steps.push(Step::Knobs(knobs.map(|(knob, value)| (knob.into(), value.into())).collect()));
        } else if line.starts_with("```") {
            let block: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
            steps.extend(of_block(&block));
        }
    }
    steps
}

/// A file begins with its name, a session with a command. Anything else is neither.
fn of_block(block: &[&str]) -> Vec<Step> {
    if let Some(name) = block[0].strip_prefix("# ") {
        return vec![Step::File(name.into(), block.join("\n") + "\n")];
    }
    let mut steps = Vec::new();
    for line in block {
        if let Some(line) = line.strip_prefix("$ ") {
            let (line, comment) = line.split_once("     # ").unwrap_or((line, ""));
            let code = comment.strip_prefix("exit code ").map_or(0, |code| code.parse().expect("a number"));
            steps.push(Step::Run { line: line.trim_end().into(), code, prints: String::new() });
        } else if let Some(Step::Run { prints, .. }) = steps.last_mut() {
            *prints += &format!("{line}\n");
        }
    }
    steps
}

/// Whether a text is a time as gaugefs prints it, with what follows.
fn is_time(word: &str) -> bool {
    let word = word.trim_end_matches(':');
    word.len() == 20 && word.ends_with('Z') && word.as_bytes()[10] == b'T'
}

/// The number in a word such as `+60.1` or `=2060;`.
fn number(word: &str) -> Option<f64> {
    word.trim_matches(|sign: char| !sign.is_ascii_digit() && sign != '-').parse().ok()
}

/// Whether two texts are alike except for line breaks, times, and measured values: these may be off by two steps, or by
/// a hundredth.
fn alike(printed: &str, shown: &str) -> bool {
    let mut printed: VecDeque<_> = printed.split_whitespace().collect();
    let mut same = true;
    for shown in shown.split_whitespace() {
        let word = printed.pop_front().unwrap_or_default();
        same &= word == shown
            || is_time(word) && is_time(shown)
            || number(word).zip(number(shown)).is_some_and(|(one, other)| {
                (one - other).abs() <= (other.abs() * 0.01).max(2.0) && !word.starts_with("0x")
            });
    }
    same && printed.is_empty()
}

/// The bench: a folder in which the commands are run, and the simulated gauge in place of a bus.
struct Bench(Folder);

impl Bench {
    fn file(&self, name: &str) -> String {
        self.0.file(name)
    }

    /// The command line as it is run here.
    fn here(&self, line: &str) -> String {
        let bus = if line.starts_with("gaugefs mount ") {
            format!("--sim {CHIP} --poll 0.5 --state-dir state --sim-state flash")
        } else if line.starts_with("gaugefs doctor") {
            String::new()
        } else {
            "--bus /dev/i2c-999".into()
        };
        line.replace("--bus /dev/i2c-1", &bus).replace("/run/gauges", "\"$GAUGES\"")
    }

    /// Runs a command line in a shell; exit code, and what it prints.
    fn run(&self, line: &str) -> (i32, String) {
        let programs = Path::new(env!("CARGO_BIN_EXE_gaugefs")).parent().expect("a folder");
        let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap_or_default());
        let output = Command::new("bash")
            .args(["-c", &format!("exec 2>&1\n{}", self.here(line))])
            .current_dir(&self.0.0)
            .envs([("PATH", path.as_str()), ("HOME", &self.file("")), ("GAUGES", &self.file("m"))])
            .envs(["AUTHOR", "COMMITTER"].map(|who| (format!("GIT_{who}_NAME"), "line 1")))
            .envs(["AUTHOR", "COMMITTER"].map(|who| (format!("GIT_{who}_EMAIL"), "line1@example.org")))
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .output()
            .expect("bash runs");
        let text = String::from_utf8(output.stdout).expect("text").replace(&self.file("m"), "/run/gauges");
        let text = text.replace("bash: line 2: ", "bash: ");
        let is_about_it = |line: &&str| !line.starts_with("gaugefs: gauge ");
        let text: String = text.split_inclusive('\n').filter(is_about_it).collect();
        (output.status.code().expect("it exits"), text)
    }

    /// Turns knobs, and waits until the gauge has measured and the daemon has polled it.
    fn turn(&self, knobs: &[(String, String)]) {
        let gauge = self.file("m/BAT0");
        for (knob, value) in knobs {
            fs::write(format!("{gauge}/sim/{knob}"), value).unwrap_or_else(|error| panic!("{knob}: {error}"));
        }
        let polls = || -> u64 {
            let text = fs::read_to_string(format!("{gauge}/gauge/statistics/polls")).expect("a count");
            text.trim().parse().expect("a number")
        };
        let before = polls();
        within(Duration::from_secs(60), "two polls", || polls() >= before + 2);
    }
}

fn has_git() -> bool {
    let is_there = Command::new("git").arg("--version").output().is_ok();
    if !is_there {
        eprintln!("SKIPPED: git is not installed; its commands in docs/PRODUCTION.md were not run");
    }
    is_there
}

#[test]
fn production_by_hand_is_as_printed() {
    if !can_mount() {
        return;
    }
    let (bench, git) = (Bench(Folder::new()), has_git());
    let steps = steps(TEXT, "By hand");
    // What a gauge of TI's is when it is delivered, and what the pack is, before the first look at it.
    let pack = steps.iter().find_map(|step| if let Step::Knobs(knobs) = step { Some(knobs) } else { None });
    let (mut ran, mut is_new) = (0, true);
    for step in &steps {
        match step {
            Step::File(name, text) => {
                let path = bench.file(name);
                fs::write(&path, text).expect("a file");
                fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("its mode");
            }
            Step::Knobs(knobs) => bench.turn(knobs),
            Step::Run { line, .. } if line.starts_with("git ") && !git => {}
            Step::Run { line, code, prints } => {
                let (exit, printed) = bench.run(line);
                ran += 1;
                // What these two print depends on the machine.
                if line.starts_with("gaugefs doctor") {
                    assert!(matches!(exit, 0 | 1) && !printed.is_empty(), "{line}: {exit}: {printed}");
                    continue;
                }
                if line.starts_with("gaugefs probe ") {
                    assert!(printed.contains("no such bus") && exit == 1, "{line}: {exit}: {printed}");
                    continue;
                }
                assert!(
                    exit == *code && alike(&printed, prints),
                    "$ {line}\nexit code {exit}, and printed:\n{printed}\nbut the document has {code}, and:\n{prints}"
                );
                if line.starts_with("gaugefs mount ") && std::mem::take(&mut is_new) {
                    fs::write(bench.file("m/BAT0/gauge/seal"), "full-access").expect("a new gauge is open");
                    bench.turn(pack.expect("the pack"));
                }
            }
        }
    }
    assert!(ran > 30, "{ran} commands");
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
    let section = TEXT.split_once("\n### What can go wrong\n").expect("the section is there").1;
    let section = section.split("\n## ").next().unwrap_or_default();
    let rows: Vec<&str> = section.lines().filter(|line| line.starts_with("| `")).collect();
    assert!(rows.len() > 6, "{rows:?}");
    for row in rows {
        let cell = row.split('|').nth(1).expect("a cell");
        for part in cell.split('`').nth(1).expect("a text").split("...") {
            assert!(text.contains(part.trim()), "no message has `{part}`: {row}");
        }
    }
}

#[test]
fn a_document_that_is_wrong_is_noticed() {
    let shown = "2026-11-22T13:02:36Z: Current(): -2060.0 mA\n(8 readings), 10 to 12; 0x0107\n";
    assert!(alike("2027-01-01T00:00:00Z: Current(): -2061.0 mA (8 readings), 10 to 13; 0x0107", shown));
    for printed in [
        "2027-01-01T00:00:00Z: Current(): -1900.0 mA (8 readings), 10 to 12; 0x0107",
        "2027-01-01T00:00:00Z: Current(): +2060.0 mA (8 readings), 10 to 12; 0x0107",
        "2027-01-01T00:00:00Z: Voltage(): -2060.0 mA (8 readings), 10 to 12; 0x0107",
        "2027-01-01T00:00:00Z: Current(): -2060.0 mA (8 readings), 10 to 12; 0x0108",
        "2027-01-01T00:00:00Z: Current(): -2060.0 mA (8 readings), 10 to 12; 0x0107 and more",
        "2027-01-01T00:00:00Z: Current(): -2060.0 mA (8 readings), 10 to 12;",
    ] {
        assert!(!alike(printed, shown), "{printed}");
    }
    let found = steps(
        "\n## A\n```\n$ one     # exit code 3\ntwo\n```\n<!-- sim: load_ma 1 -->\n## B\n```\n$ no\n```\n",
        "A",
    );
    let run = Step::Run { line: "one".into(), code: 3, prints: "two\n".into() };
    assert_eq!(found, [run, Step::Knobs(vec![("load_ma".into(), "1".into())])]);
}
