// SPDX-License-Identifier: MIT

//! What only commands read: configurations, recorded histories and the values of options. The commands are those of
//! `gaugefs::cli` and `gaugefs::station`, and none of them mounts or opens a bus.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::value::number_of;

/// A file that is removed with its last use.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    /// A file with this content. Each thread has one of each name.
    pub(crate) fn new(name: &str, content: &[u8]) -> Self {
        let (process, thread) = (std::process::id(), std::thread::current().id());
        let file = std::env::temp_dir().join(format!("gaugefs-fuzz-{process}-{thread:?}-{name}"));
        std::fs::write(&file, content).expect("a folder for temporary files");
        Self(file)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A place where nothing is.
const NOWHERE: &str = "/nonexistent/gaugefs";

/// The exit code of a command.
fn run(arguments: &[OsString]) -> u8 {
    let all = std::iter::once("gaugefs".into()).chain(arguments.iter().cloned());
    let code = match arguments.first().and_then(|command| command.to_str()) {
        Some("program") => gaugefs::station::run(all),
        _ => gaugefs::cli::run(all),
    };
    let known = (0..=2).find(|known| code == ExitCode::from(*known));
    known.unwrap_or_else(|| panic!("{arguments:?} ended with {code:?}"))
}

fn arguments<const N: usize>(arguments: [&str; N]) -> Vec<OsString> {
    arguments.map(OsString::from).to_vec()
}

/// Whether `mount --check` accepts a configuration.
fn accepts(content: &[u8]) -> bool {
    let mut check = arguments(["mount", "--check", NOWHERE, "--config"]);
    let file = Scratch::new("gaugefs.toml", content);
    check.push(file.path().into());
    let code = run(&check);
    assert!(code < 2, "a configuration is not misuse");
    code == 0
}

/// A configuration: `gaugefs mount --check`.
pub(crate) fn configuration(input: &[u8]) {
    if accepts(input) {
        assert!(accepts(&[input, b"\n# a comment\n"].concat()));
        assert!(!accepts(&[input, b"\n[unknown]\n"].concat()));
    }
}

/// A station's file: `gaugefs-station program --check`.
pub(crate) fn station(input: &[u8]) {
    const IMAGE: &str = "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = 3100\n";
    let accepts = |content: &[u8]| {
        let (image, station) =
            (Scratch::new("image.toml", IMAGE.as_bytes()), Scratch::new("station.toml", content));
        let mut check = arguments(["program", "--check", "--image"]);
        check.extend([image.path().into(), "--station".into(), station.path().into()]);
        let code = run(&check);
        assert!(code < 2, "a station's file is not misuse");
        code == 0
    };
    if accepts(input) {
        assert!(accepts(&[input, b"\n# a comment\n"].concat()));
        assert!(!accepts(&[input, b"\n[unknown]\n"].concat()));
    }
}

/// A condition: `gaugefs wait`, which finds no gauge. What is accepted stays so with another one behind it.
pub(crate) fn condition(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else { return };
    if text.contains('\0') {
        return;
    }
    let accepts = |text: &str| {
        let mut wait = arguments(["wait", "--timeout", "0", "--", NOWHERE]);
        wait.push(text.into());
        run(&wait) == 1
    };
    let is_missing = text.trim() == "missing";
    let accepted = accepts(text);
    assert!(accepted || !is_missing);
    assert_eq!(accepts(&format!("{text} && capacity<20")), accepted && !is_missing, "{text}");
    assert_eq!(accepts(&format!("capacity<20&&{text}")), accepted && !is_missing, "{text}");
    if let Some(number) = text.strip_prefix("capacity<") {
        let number = number.trim();
        let plain =
            !number.is_empty() && number.len() < 10 && number.bytes().all(|byte| byte.is_ascii_digit());
        assert!(accepted || !plain, "{text}");
        assert!(!accepted || number.bytes().any(|byte| byte.is_ascii_digit()), "{text} has no number");
    }
}

/// A history: `gaugefs plot`.
#[expect(clippy::disallowed_methods, reason = "it was written here")]
pub(crate) fn csv(input: &[u8]) {
    let (history, svg) = (Scratch::new("history.csv", input), Scratch::new("plot.svg", b""));
    let mut plot = arguments(["plot", "-o"]);
    plot.extend([svg.path().into(), history.path().into()]);
    if run(&plot) == 0 {
        let svg = std::fs::read_to_string(svg.path()).expect("the picture");
        assert!(svg.len() < 1_000_000 + 20 * input.len(), "{} bytes of SVG", svg.len());
        for (tag, _) in svg.split('<').filter_map(|piece| piece.split_once('>')) {
            assert!(!tag.contains("NaN") && !tag.contains("inf"), "{tag}");
        }
    }
}

/// An option and its value, such as `address 0x55`.
pub(crate) fn options(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else { return };
    let Some((option, value)) = text.split_once(' ') else { return };
    if value.contains('\0') {
        return;
    }
    let given = format!("--{option}={value}");
    let whole = number_of(value);
    let real: Option<f64> = value.parse().ok();
    match option {
        "address" => {
            let code = run(&arguments(["probe", "--bus", NOWHERE, &given]));
            assert_eq!(
                code == 1,
                whole.is_some_and(|number| (0x08..=0x77).contains(&number))
                    && is_address(value)
                    // Most likely 0x55 is meant.
                    && value.trim_start_matches('0') != "55"
            );
        }
        "width" => {
            let code = run(&arguments(["plot", NOWHERE, &given]));
            assert_eq!(
                code == 1,
                whole.is_some_and(|number| (320..=8000).contains(&number)) && is_decimal(value)
            );
        }
        "poll" => {
            let accepted = accepts_gauge(option, value);
            let meant = real.or_else(|| seconds_of(value.trim()));
            assert!(!accepted || meant.is_some_and(|seconds| (0.5..=3600.0).contains(&seconds)), "{meant:?}");
        }
        "current-scale" | "voltage-scale" | "energy-scale" => {
            let accepted = accepts_gauge(option, value);
            assert!(!accepted || real.is_some_and(|factor| (0.001..=1000.0).contains(&factor)));
        }
        "writes-per-hour" => {
            // A number, not a string.
            let content = format!("[[gauge]]\nsim = \"bq34z100-g1\"\nwrites-per-hour = {value}\n");
            let alone = value.bytes().all(|byte| byte.is_ascii_digit());
            let fits = whole.is_some_and(|number| number <= u32::MAX.into());
            assert!(!alone || fits || !accepts(content.as_bytes()), "{value}");
        }
        "name" | "sim-key" | "sim" | "auth-order" => drop(accepts_gauge(option, value)),
        "ac" | "group" => {
            let mut check = arguments(["mount", "--check", NOWHERE, &given, "--config"]);
            let file = Scratch::new("one.toml", b"[[gauge]]\nsim = \"bq34z100-g1\"\n");
            check.push(file.path().into());
            run(&check);
        }
        _ => {}
    }
}

fn is_decimal(value: &str) -> bool {
    let digits = value.strip_prefix('+').unwrap_or(value);
    !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit())
}

fn is_address(value: &str) -> bool {
    is_decimal(value) || value.starts_with("0x") || value.starts_with("0X")
}

/// What a person reads in a time with its unit, such as `2min`.
fn seconds_of(text: &str) -> Option<f64> {
    let (number, unit) = text.split_at(text.find(char::is_alphabetic)?);
    let number: f64 = number.trim_end().parse().ok()?;
    let factor = match unit {
        "s" => 1.0,
        "min" => 60.0,
        "h" => 3600.0,
        "d" => 86_400.0,
        "ks" => 1e3,
        "ms" => 1e-3,
        "us" | "µs" | "μs" => 1e-6,
        "ns" => 1e-9,
        _ => return None,
    };
    Some(number * factor)
}

/// Whether a gauge of a configuration may have an option with this text.
fn accepts_gauge(option: &str, value: &str) -> bool {
    let value: String = value.chars().map(|letter| format!("\\U{:08x}", u32::from(letter))).collect();
    let source = if option == "sim" { "" } else { "sim = \"bq34z100-g1\"\n" };
    accepts(format!("[[gauge]]\n{source}{option} = \"{value}\"\n").as_bytes())
}
