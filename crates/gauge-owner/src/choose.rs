// SPDX-License-Identifier: MIT

//! Which of several profiles a gauge gets: rules, of which the first that fits counts. They look at what the gauge answers,
//! at a file, such as that of a converter which measures a resistor in the pack, or at what a program prints.

use std::fmt;
use std::io::{self, ErrorKind, Read as _};
use std::os::fd::AsFd as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, killpg};
use nix::unistd::{AccessFlags, Pid, access};

use crate::error::{Error, Result};
use gauge_bus::regular;
use ti_gauge::chip::{Answers, Chip};
use ti_gauge::dataflash::Change;
use ti_gauge::keys;

/// How long a program may take.
const TIME_LIMIT: Duration = Duration::from_secs(5);
/// How much it may print, and how long a file may be. sysfs shows a page as the length of each file.
const LONGEST: u64 = 4096;
/// How long what was printed may be to be compared or shown.
const TEXT: usize = 64;
/// How often a file is read, and the pause in between: one reading of a converter may be wrong.
const READINGS: u32 = 3;
const PAUSE: Duration = Duration::from_millis(10);
/// All that a program finds in its environment, besides the name of the gauge.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// A rule: a profile, and what must be the case for a gauge to get it. Without a condition it always fits.
#[derive(Clone, Debug, Default)]
pub struct Rule {
    /// The part.
    pub chip: Option<&'static Chip>,
    /// Control(CHEM_ID).
    pub chem_id: Option<u16>,
    /// Control(FW_VERSION).
    pub firmware: Option<u16>,
    /// Where the pack shows what it is.
    pub evidence: Option<Evidence>,
    /// What must be found there; without it, only that something can be read.
    pub text: Option<String>,
    /// The least number that must be found there.
    pub from: Option<f64>,
    /// The greatest number that must be found there.
    pub to: Option<f64>,
    /// The profile.
    pub profile: PathBuf,
    /// The name of the pack.
    pub pack: Option<String>,
    /// What is found there is the name of the pack.
    pub pack_by_text: bool,
}

/// Where a pack shows what it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// In a file, read three times.
    File(PathBuf),
    /// In what a program prints: its path, and its arguments.
    Command(Vec<String>),
}

impl Evidence {
    /// Whether it can be looked at, as far as that can be seen without running anything.
    pub fn check(&self) -> Result<()> {
        let failed = |path: &Path, error| {
            Error::io(path.display().to_string(), "cannot be used to choose a profile", &error)
        };
        match self {
            Self::File(path) => regular::read(path, LONGEST).map(drop).map_err(|error| failed(path, error)),
            Self::Command(words) => {
                let path = Path::new(&words[0]);
                access(path, AccessFlags::X_OK).map_err(|errno| failed(path, errno.into()))
            }
        }
    }
}

impl fmt::Display for Evidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Command(words) => write!(f, "{}", words.join(" ")),
        }
    }
}

/// A rule with the content of its profile.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The rule.
    pub rule: Rule,
    /// The profile, as changes to data memory.
    pub profile: Vec<Change>,
}

/// What was chosen, and why.
pub(crate) struct Chosen<'a> {
    pub(crate) choice: &'a Choice,
    pub(crate) pack: Option<String>,
    pub(crate) why: String,
}

/// The first choice that fits a gauge with these answers. An error says why there is none: no rule fits, or one cannot be
/// decided, after which a later one must not count.
pub(crate) fn choose<'a>(
    choices: &'a [Choice],
    answers: &Answers,
    gauge: &str,
    wait: impl Fn(Duration),
) -> Result<Chosen<'a>, String> {
    // Rules may share a converter, or a program.
    let mut read: Vec<(&Evidence, Vec<String>)> = Vec::new();
    for choice in choices {
        let rule = &choice.rule;
        let fits = |wanted: Option<u16>, found| wanted.is_none_or(|wanted| Some(wanted) == found);
        if !fits(rule.chem_id, answers.chem_id) || !fits(rule.firmware, Some(answers.firmware_version)) {
            continue;
        }
        let Some(evidence) = &rule.evidence else {
            let why = "no rule before it fits".into();
            return Ok(Chosen { choice, pack: rule.pack.clone(), why });
        };
        let known = read.iter().find(|(other, _)| *other == evidence);
        let found = match known {
            Some((_, found)) => found.clone(),
            None => {
                let found = look(evidence, gauge, &wait).map_err(|error| format!("{evidence}: {error}"))?;
                read.push((evidence, found.clone()));
                found
            }
        };
        let fitting = found.iter().map(|text| rule.accepts(text)).collect::<Result<Vec<bool>, _>>();
        let fitting = fitting.map_err(|why| format!("{evidence}: {why}"))?;
        if fitting.iter().any(|fits| *fits != fitting[0]) {
            return Err(format!("{evidence}: shows {} one after the other", found.join(", ")));
        }
        if fitting[0] {
            let text = &found[0];
            let pack = match rule.pack_by_text {
                false => rule.pack.clone(),
                true if keys::is_name(text) && found.iter().all(|other| other == text) => Some(text.clone()),
                true => return Err(format!("{evidence}: shows {text}, which cannot be the name of a pack")),
            };
            return Ok(Chosen { choice, pack, why: format!("{evidence} shows {text}") });
        }
    }
    let chem_id = answers.chem_id.map_or(String::new(), |id| format!(", chem_id 0x{id:04x}"));
    let read: String =
        read.iter().map(|(evidence, found)| format!(", {evidence} shows {}", found[0])).collect();
    Err(format!(
        "none of its {} profiles fits: firmware 0x{:04x}{chem_id}{read}; add a rule to [[gauge.choose]]",
        choices.len(),
        answers.firmware_version
    ))
}

impl Rule {
    /// Whether it accepts what was found.
    fn accepts(&self, found: &str) -> Result<bool, String> {
        let is_text = self.text.as_ref().is_none_or(|text| text == found);
        if self.from.is_none() && self.to.is_none() {
            return Ok(is_text);
        }
        let number = found.parse::<f64>().ok().filter(|number| number.is_finite());
        let number = number.ok_or_else(|| format!("shows {found}, which is no number"))?;
        Ok(is_text && self.from.is_none_or(|from| from <= number) && self.to.is_none_or(|to| number <= to))
    }
}

/// What a piece of evidence shows, as often as it is looked at.
fn look(evidence: &Evidence, gauge: &str, wait: &impl Fn(Duration)) -> io::Result<Vec<String>> {
    match evidence {
        Evidence::File(path) => (0..READINGS)
            .map(|number| {
                if number > 0 {
                    wait(PAUSE);
                }
                word(regular::read(path, LONGEST)?)
            })
            .collect(),
        Evidence::Command(words) => Ok(vec![word(printed(words, gauge, TIME_LIMIT)?)?]),
    }
}

/// The only line of a text.
fn word(bytes: Vec<u8>) -> io::Result<String> {
    let text = regular::text(bytes)?.trim().to_string();
    match text.len() {
        1..=TEXT if !text.contains(char::is_control) => Ok(text),
        0 => Err(io::Error::other("shows nothing")),
        _ => Err(io::Error::other(format!("shows more than one line of {TEXT} characters"))),
    }
}

/// What a program prints. It has the rights of this process, no input, and little environment. One that takes too long, or
/// prints too much, is killed with what it has started.
fn printed(words: &[String], gauge: &str, limit: Duration) -> io::Result<Vec<u8>> {
    let mut command = Command::new(&words[0]);
    command.args(&words[1..]).env_clear().env("PATH", PATH).env("GAUGEFS_GAUGE", gauge).current_dir("/");
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0).spawn()?;
    let deadline = Instant::now() + limit;
    let out = child.stdout.take().expect("it is piped");
    let ended = read_until(out, deadline).and_then(|text| Ok((text, end_until(&mut child, deadline)?)));
    let (text, status) = ended.inspect_err(|_| {
        // It has not been waited for, so its number is still its own.
        let _ = killpg(Pid::from_raw(child.id().cast_signed()), Signal::SIGKILL);
        let _ = child.wait();
    })?;
    if status.success() { Ok(text) } else { Err(io::Error::other(format!("it has failed ({status})"))) }
}

fn too_late() -> io::Error {
    io::Error::new(ErrorKind::TimedOut, "it has not ended in time and was killed")
}

fn read_until(mut out: ChildStdout, deadline: Instant) -> io::Result<Vec<u8>> {
    let mut text = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let mut waited = [PollFd::new(out.as_fd(), PollFlags::POLLIN)];
        let left = PollTimeout::try_from(left).unwrap_or(PollTimeout::ZERO);
        if poll(&mut waited, left)? == 0 {
            return Err(too_late());
        }
        let mut part = [0; 512];
        match out.read(&mut part)? {
            0 => return Ok(text),
            length => text.extend_from_slice(&part[..length]),
        }
        if text.len() as u64 > LONGEST {
            return Err(io::Error::other(format!("it prints more than {LONGEST} bytes")));
        }
    }
}

/// Waits for a program that has closed its output.
fn end_until(child: &mut Child, deadline: Instant) -> io::Result<ExitStatus> {
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if Instant::now() >= deadline {
            return Err(too_late());
        }
        std::thread::sleep(PAUSE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::fs;

    fn rules(evidence: &Evidence) -> Vec<Choice> {
        let rule = |from: f64, to: f64, profile: &str| Rule {
            evidence: Some(evidence.clone()),
            from: Some(from),
            to: Some(to),
            profile: profile.into(),
            pack: Some(profile.to_uppercase()),
            ..Rule::default()
        };
        let rules = [
            Rule { chem_id: Some(0x1202), profile: "chem".into(), ..Rule::default() },
            rule(100.0, 200.0, "a"),
            rule(200.5, 300.0, "b"),
        ];
        rules.into_iter().map(|rule| Choice { rule, profile: Vec::new() }).collect()
    }

    fn outcome(choices: &[Choice], chem_id: u16, wait: impl Fn(Duration)) -> String {
        let answers = Answers { chem_id: Some(chem_id), firmware_version: 0x0202, ..Answers::default() };
        match choose(choices, &answers, "BAT0", wait) {
            Ok(chosen) => format!("{} {:?}", chosen.choice.rule.profile.display(), chosen.pack),
            Err(why) => why,
        }
    }

    fn file(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("gaugefs-choose-{name}-{}", std::process::id()))
    }

    #[test]
    fn the_first_rule_that_fits_counts_and_one_that_is_undecided_ends_the_choice() {
        let path = file("adc");
        let choices = rules(&Evidence::File(path.clone()));
        assert_eq!(outcome(&choices, 0x1202, |_| ()), "chem None");
        assert!(outcome(&choices, 0x3230, |_| ()).contains("No such file"));
        for (reading, expected) in [
            ("150\n", "a Some(\"A\")"),
            ("200.5", "b Some(\"B\")"),
            ("200.2", "none of its 3 profiles fits: firmware 0x0202, chem_id 0x3230, "),
            ("nonsense", "which is no number"),
            ("nan", "which is no number"),
            ("", "shows nothing"),
            ("1\n2", "more than one line"),
        ] {
            fs::write(&path, reading).expect("a file");
            let outcome = outcome(&choices, 0x3230, |_| ());
            assert!(outcome.contains(expected), "{reading}: {outcome}");
        }
        fs::remove_file(path).expect("it is there");
    }

    /// A reading of a converter while a contact bounces.
    #[test]
    fn readings_that_fit_different_rules_choose_nothing() {
        let path = file("bounce");
        let choices = rules(&Evidence::File(path.clone()));
        let number = Cell::new(0);
        let bounce = |_| {
            number.set(number.get() + 1);
            fs::write(&path, if number.get() == 1 { "250" } else { "150" }).expect("a file");
        };
        fs::write(&path, "150").expect("a file");
        let outcome = outcome(&choices, 0x3230, bounce);
        assert!(outcome.contains("shows 150, 250, 150 one after the other"), "{outcome}");
        fs::remove_file(path).expect("it is there");
    }

    fn by_program(script: &str) -> String {
        let words = ["/bin/sh", "-c", script].map(String::from).to_vec();
        let rule = Rule { evidence: Some(Evidence::Command(words)), pack_by_text: true, ..Rule::default() };
        outcome(&[Choice { rule, profile: Vec::new() }], 0, |_| ())
    }

    #[test]
    fn a_program_may_name_the_pack() {
        assert_eq!(by_program("echo SN-1234"), " Some(\"SN-1234\")");
        assert!(by_program("echo ../x").contains("cannot be the name of a pack"));
        assert!(by_program("echo A; exit 3").contains("it has failed (exit status: 3)"));
        assert!(by_program("cat /dev/zero").contains("prints more than 4096 bytes"));
        // Nothing of the daemon's environment, no input, no descriptor of the daemon's.
        assert_eq!(by_program("cat; env | grep -cv '^PWD=\\|^_=\\|^SHLVL='"), " Some(\"2\")");
        assert_eq!(by_program("echo $GAUGEFS_GAUGE"), " Some(\"BAT0\")");
    }

    #[test]
    fn a_program_that_does_not_end_is_killed_with_what_it_has_started() {
        let path = file("alive");
        let script = format!("(sleep 0.6; touch {}) & sleep 60", path.display());
        let words = ["/bin/sh", "-c", &script].map(String::from);
        let begun = Instant::now();
        let error = printed(&words, "BAT0", Duration::from_millis(200)).expect_err("it takes too long");
        assert_eq!(error.kind(), ErrorKind::TimedOut);
        assert!(begun.elapsed() < Duration::from_secs(50));
        std::thread::sleep(Duration::from_millis(800));
        assert!(!path.exists());
    }
}
