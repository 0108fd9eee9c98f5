// SPDX-License-Identifier: MIT

//! Runs the code blocks of a document in their order, as they are printed, in a folder of their own and with simulated
//! gauges, and holds the document to what they print.
//!
//! | block | is |
//! | --- | --- |
//! | with a line that begins with `$ ` | a session: each such line is a command, what follows is what it prints. `# exit code N` behind it is its exit code |
//! | `transaction` | written to `df/transaction` of the gauge |
//! | `python` | a program, which gets the folder of the gauge |
//! | another language, or a first line `# NAME` with a point in the name | a file; with that line it is written |
//!
//! A block that is none of these is not known to work, and fails. Comments of the document, which no reader sees:
//!
//! | comment before a block | means |
//! | --- | --- |
//! | `<!-- sim: KNOB VALUE; ... -->` | knobs of the simulated gauge |
//! | `<!-- run: COMMAND -->` | a command that is not printed |
//! | `<!-- not run (WHY) -->`, `<!-- not run (WHY): WORDS; ... -->` | the block, or its commands that begin so, cannot be run here |
//! | `<!-- ended: WORDS; ... -->` | its commands that begin so run until they are ended, after two seconds |

use std::collections::VecDeque;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nix::unistd::geteuid;

use super::documents::root;
use super::{CHIP, Folder, LONG, within};

/// A step of a document.
#[derive(Debug, PartialEq)]
pub(crate) enum Step {
    /// A file, by name.
    File(String, String),
    /// Knobs and their values.
    Knobs(Vec<(String, String)>),
    /// Lines for `df/transaction`.
    Transaction(String),
    /// A program in Python.
    Python(String),
    /// A command line, its exit code if the document says it, and what it prints.
    Run { line: String, code: Option<i32>, prints: String, ended: bool },
}

/// The steps of a document, or of a section of it.
pub(crate) fn steps(text: &str, heading: Option<&str>) -> Vec<Step> {
    let section = heading.map_or(text, |heading| {
        let section = text.split_once(&format!("\n{heading}\n")).expect("the section is there").1;
        let level = heading.split(' ').next().unwrap_or_default();
        section.split(&format!("\n{level} ")).next().unwrap_or_default()
    });
    let mut steps = Vec::new();
    let mut marks = Marks::default();
    let mut lines = section.lines();
    while let Some(line) = lines.next() {
        let comment = line.strip_prefix("<!-- ").and_then(|rest| rest.strip_suffix(" -->"));
        if let Some(knobs) = comment.and_then(|comment| comment.strip_prefix("sim: ")) {
            let knobs = knobs.split("; ").map(|knob| knob.split_once(' ').expect("a knob and its value"));
            steps.push(Step::Knobs(knobs.map(|(knob, value)| (knob.into(), value.into())).collect()));
        } else if let Some(line) = comment.and_then(|comment| comment.strip_prefix("run: ")) {
            steps.push(Step::Run { line: line.into(), code: Some(0), prints: String::new(), ended: false });
        } else if let Some(words) = comment.and_then(|comment| comment.strip_prefix("ended: ")) {
            marks.ended.extend(words.split("; "));
        } else if let Some(rest) = comment.and_then(|comment| comment.strip_prefix("not run (")) {
            let (why, words) = rest.split_once(')').expect("a reason in parentheses");
            assert!(!why.is_empty(), "{line}");
            marks.not_run.extend(words.strip_prefix(": ").unwrap_or_default().split("; "));
        } else if let Some(language) = line.strip_prefix("```") {
            let block: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
            steps.extend(of_block(language, &block, &std::mem::take(&mut marks)));
        }
    }
    steps
}

/// What comments say about the next block.
#[derive(Default)]
struct Marks<'a> {
    /// How commands begin that are not run; an empty text for the whole block.
    not_run: Vec<&'a str>,
    ended: Vec<&'a str>,
}

fn of_block(language: &str, block: &[&str], marks: &Marks<'_>) -> Vec<Step> {
    let begins = |line: &str, all: &[&str]| all.iter().any(|words| line.starts_with(words));
    let text = || block.join("\n") + "\n";
    for words in marks.not_run.iter().chain(&marks.ended) {
        let is_there = block.iter().any(|line| line.trim_start_matches(['$', '#', ' ']).starts_with(words));
        assert!(is_there, "no command begins with `{words}`: {block:?}");
    }
    if marks.not_run.contains(&"") {
        return Vec::new();
    }
    let has_command = block.iter().any(|line| line.starts_with("$ "));
    let name = block[0]
        .strip_prefix("# ")
        .or(block[0].strip_prefix("// "))
        .filter(|name| name.contains('.') && !name.contains(' '));
    match (language, name) {
        ("transaction", _) => return vec![Step::Transaction(text())],
        ("python", _) => return vec![Step::Python(text())],
        (_, Some(name)) if !has_command => return vec![Step::File(name.into(), text())],
        _ if has_command => {}
        ("", None) => panic!("neither run nor marked: {block:?}"),
        ("sh", None) => panic!("commands begin with `$ `, or the block is marked: {block:?}"),
        _ => return Vec::new(),
    }
    let mut steps = Vec::new();
    // What a command prints that is not run.
    let mut is_run = true;
    for line in block {
        if let Some(line) = line.strip_prefix("$ ").or(line.strip_prefix("# ")) {
            let (line, comment) = line.split_once("  # ").unwrap_or((line, ""));
            let line = line.trim_end();
            let comment = comment.trim_start().strip_prefix("exit code ");
            let code = comment.map(|code| code.split(',').next().unwrap_or(code).parse().expect("a number"));
            is_run = !begins(line, &marks.not_run);
            if is_run {
                let ended = begins(line, &marks.ended);
                steps.push(Step::Run { line: line.into(), code, prints: String::new(), ended });
            }
        } else if let (true, Some(Step::Run { prints, .. })) = (is_run, steps.last_mut()) {
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
pub(crate) fn alike(printed: &str, shown: &str) -> bool {
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

/// The seconds after which somebody ends a program that has shown something: more on a machine that is busy.
fn a_while() -> u64 {
    let start = Instant::now();
    super::gaugefs(&["--version"]).done();
    2 + 50 * start.elapsed().as_millis() as u64 / 1000
}

/// Whether a command is, or runs, a program that this machine lacks.
fn lacks(line: &str) -> bool {
    let words = line.split(|letter: char| !letter.is_ascii_alphanumeric());
    let tools = words.filter(|word| ["git", "i2cget", "cc", "rustc"].contains(word));
    let is_there = |tool: &str| {
        Command::new(tool).arg(if tool == "i2cget" { "-V" } else { "--version" }).output().is_ok()
    };
    let missing: Vec<_> = tools.filter(|tool| !is_there(tool)).collect();
    if !missing.is_empty() {
        eprintln!("SKIPPED in part: {} is not installed, so this was not run: {line}", missing.join(", "));
    }
    !missing.is_empty()
}

/// The place in which a document is run: a folder, and simulated gauges in place of a bus.
pub(crate) struct Session {
    folder: Folder,
    /// Whether a command for which nothing is shown prints nothing.
    pub(crate) strict: bool,
    /// The options of a mount in place of `--bus`.
    pub(crate) sim: String,
    pub(crate) ran: usize,
}

impl Session {
    pub(crate) fn new() -> Self {
        let folder = Folder::new();
        // The documents are read in the checkout.
        for name in ["udev", "docs", "tests"] {
            std::os::unix::fs::symlink(root().join(name), folder.0.join(name)).expect("a link");
        }
        Self { folder, strict: false, sim: format!("--sim {CHIP} --poll 0.5"), ran: 0 }
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.folder.file(name)
    }

    /// The command line as it is run here.
    fn here(&self, line: &str) -> String {
        let line = line.replace("cargo run --release -- ", "gaugefs ").replace("sudo ", "");
        let bus = if line.starts_with("gaugefs mount ") { &self.sim } else { "--bus /dev/i2c-999" };
        let line = line.replace(" --group i2c", "").replace("127.0.0.1:9947", "127.0.0.1:0");
        let mut line = line.replace("--bus /dev/i2c-1", bus);
        if line.starts_with("gaugefs mount ") && line.contains("--sim ") && !line.contains("--poll ") {
            line += " --poll 0.5";
        }
        if line.starts_with("gaugefs mount ") && line.contains("--sim ") && !line.contains("--fast") {
            line += " --fast";
        }
        if !geteuid().is_root() {
            // The mounts of other tests have a gauge of that name, too.
            line = line.replace(" set BAT0 ", " set /tmp/gauges/BAT0 ");
        }
        ["/run/gaugefs/i2c-1", "/run/gauges", "/tmp/gauges"]
            .iter()
            .fold(line, |line, place| line.replace(place, "\"$GAUGES\""))
            .replace("/tmp/", "\"$FOLDER\"/")
            .replace("/etc/gaugefs/", "\"$FOLDER\"/")
    }

    /// Runs a command line in a shell, where the one before it has ended; exit code, and what it prints. Where a program
    /// in the background, or a value of the next poll, is awaited, `is_it` says whether that is there.
    fn run(&self, line: &str, ended: bool, is_it: impl Fn(&str) -> bool) -> (i32, String) {
        let here = self.here(line);
        let (printed, place) = (self.file(".printed"), self.file(".place"));
        let words = if ended {
            format!("timeout --signal=INT --kill-after=60 {} ", a_while())
        } else {
            String::new()
        };
        let script = format!(
            "exec >\"$FOLDER/.printed\" 2>&1; [ ! -e \"$FOLDER/.place\" ] || . \"$FOLDER/.place\"\n{words}{here}\n\
             code=$?; printf 'cd %q; cd %q' \"${{OLDPWD:-$PWD}}\" \"$PWD\" >\"$FOLDER/.place\"; exit $code"
        );
        let programs = Path::new(env!("CARGO_BIN_EXE_gaugefs")).parent().expect("a folder");
        let path = format!("{}:{}:/usr/sbin", programs.display(), std::env::var("PATH").unwrap_or_default());
        let start = Instant::now();
        loop {
            let status = Command::new("bash")
                .args(["-c", &script])
                .current_dir(&self.folder.0)
                .envs([("PATH", path.as_str()), ("HOME", &self.file(""))])
                .envs([("GAUGES", self.file("m")), ("FOLDER", self.file(""))])
                .envs(["AUTHOR", "COMMITTER"].map(|who| (format!("GIT_{who}_NAME"), "line 1")))
                .envs(["AUTHOR", "COMMITTER"].map(|who| (format!("GIT_{who}_EMAIL"), "line1@example.org")))
                .env_remove("RUST_LOG")
                .env("GAUGEFS_PATIENCE", LONG.as_secs().to_string())
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .expect("bash runs");
            let in_background = here.ends_with('&');
            let code = status.code().expect("it exits");
            loop {
                let text = self.as_printed(line, &fs::read(&printed).expect("what it prints"));
                if is_it(&text) || start.elapsed() > LONG || !in_background {
                    let reads = ["cat ", "grep "].iter().any(|verb| here.starts_with(verb));
                    if !is_it(&text) && reads && !here.contains('>') && start.elapsed() < LONG {
                        break;
                    }
                    let is_there = Path::new(&place).exists();
                    assert!(is_there, "$ {line}\nhas ended its shell: {text}");
                    return (code, text);
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// What a command has printed, with the paths of the document, and without the names of gauges that come first.
    fn as_printed(&self, line: &str, bytes: &[u8]) -> String {
        let place = if line.contains("/tmp/gauges") { "/tmp/gauges" } else { "/run/gauges" };
        let text = String::from_utf8_lossy(bytes).replace(&self.file("m"), place);
        let text = text
            .replace(&self.file(""), if line.contains("/etc/gaugefs/") { "/etc/gaugefs/" } else { "/tmp/" });
        let of_shell = |line: &str| {
            let rest = line.strip_prefix("bash: line ").and_then(|rest| rest.split_once(": "));
            rest.map_or(line.to_string(), |(_, rest)| format!("bash: {rest}"))
        };
        let lines = text.split_inclusive('\n').filter(|line| !line.starts_with("gaugefs: gauge "));
        lines.map(of_shell).collect()
    }

    /// Turns knobs, and waits until the gauge has measured and the daemon has polled it.
    pub(crate) fn turn(&self, knobs: &[(String, String)]) {
        let gauge = self.file("m/BAT0");
        for (knob, value) in knobs {
            fs::write(format!("{gauge}/sim/{knob}"), value).unwrap_or_else(|error| panic!("{knob}: {error}"));
        }
        let polls = || -> u64 {
            let text = fs::read_to_string(format!("{gauge}/gauge/statistics/polls")).expect("a count");
            text.trim().parse().expect("a number")
        };
        let before = polls();
        within("two polls", || polls() >= before + 2);
    }

    /// Does a step, and holds the document to it.
    pub(crate) fn step(&mut self, step: &Step) {
        match step {
            Step::File(name, text) => {
                let path = self.file(name);
                fs::write(&path, text).expect("a file");
                fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("its mode");
            }
            Step::Knobs(knobs) => self.turn(knobs),
            Step::Transaction(text) => {
                fs::write(self.file("m/BAT0/df/transaction"), text)
                    .unwrap_or_else(|error| panic!("{error}: {text}"));
                self.ran += 1;
            }
            Step::Python(text) => self.python(text),
            Step::Run { line, .. } if lacks(line) => {}
            Step::Run { line, code, prints, ended } => {
                let is_it = |printed: &str| prints.is_empty() || alike(printed, prints);
                let start = Instant::now();
                let (mut exit, mut printed) = self.run(line, *ended, is_it);
                // The mount namespace of another test may have a copy of this mount, and its daemon ends with that.
                if exit == 3 && printed.contains("in the mount namespace of") {
                    (exit, printed) = (0, String::new());
                }
                while exit == 1 && printed.contains("in use by process") && start.elapsed() < LONG {
                    std::thread::sleep(Duration::from_millis(500));
                    (exit, printed) = self.run(line, *ended, is_it);
                }
                // Shown if the test fails.
                eprintln!("{:5.1} s  {line}", start.elapsed().as_secs_f32());
                self.ran += 1;
                // What these two print depends on the machine.
                if line.starts_with("gaugefs doctor") {
                    assert!(matches!(exit, 0 | 1) && !printed.is_empty(), "{line}: {exit}: {printed}");
                    return;
                }
                if line.starts_with("gaugefs probe ") {
                    let is_absent = printed.contains("no such bus") && exit == 1;
                    assert!(is_absent || exit == 0, "{line}: {exit}: {printed}");
                    return;
                }
                // A message that is shown says as well that the command fails, and differences that they were found.
                let is_code = match code {
                    Some(code) => exit == *code,
                    None if *ended => matches!(exit, 0 | 124 | 130),
                    None => exit == 0 || !self.strict && !prints.is_empty(),
                };
                let is_text = is_it(&printed) && !(self.strict && prints.is_empty() && !printed.is_empty());
                assert!(
                    is_code && is_text,
                    "$ {line}\nexit code {exit}, and printed:\n{printed}\nbut the document has {code:?}, and:\n{prints}"
                );
            }
        }
    }

    fn python(&mut self, text: &str) {
        if Command::new("python3").arg("--version").output().is_err() {
            eprintln!("SKIPPED: python3 is not installed; a program of the documents was not run");
            return;
        }
        let output = Command::new("timeout")
            .args(["60", "python3", "-W", "error", "-c", text, &self.file("m/BAT0")])
            .output()
            .expect("it runs");
        let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert!(output.status.success(), "{}{}", said(&output.stdout), said(&output.stderr));
        assert!(!output.stdout.is_empty(), "it prints nothing");
        self.ran += 1;
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
        Some("## A"),
    );
    let one =
        |code, prints: &str| Step::Run { line: "one".into(), code, prints: prints.into(), ended: false };
    assert_eq!(found, [one(Some(3), "two\n"), Step::Knobs(vec![("load_ma".into(), "1".into())])]);
    assert_eq!(steps("<!-- not run (no bus): two -->\n```\n$ one\n$ two\n2\n```\n", None), [one(None, "")]);
    assert_eq!(steps("<!-- not run (no bus) -->\n```\nanything\n```\n```toml\na = 1\n```\n", None), []);
    for wrong in ["```\nanything\n```\n", "<!-- not run (why): typo -->\n```\n$ one\n```\n"] {
        assert!(std::panic::catch_unwind(|| steps(wrong, None)).is_err(), "{wrong}");
    }
}
