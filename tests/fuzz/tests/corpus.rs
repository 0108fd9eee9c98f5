// SPDX-License-Identifier: MIT

//! The kept inputs of each target, and a seeded slice of changed ones.
//!
//! `GAUGEFS_SEED` sets the seed, and `GAUGEFS_FUZZ_CASES` how many changed inputs each target gets; without it, an eighth of
//! its slice, or with `GAUGEFS_ALL` the whole slice. A failure prints
//! the input, shrunk; put it into the target's folder of `corpus`, where it stays.

#![allow(clippy::disallowed_methods, reason = "tests read what they have made")]

use std::path::PathBuf;

use gaugefs_fuzz::{TARGETS, Target};
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{RngAlgorithm, RngSeed, TestRunner};

/// Texts at which a parser may turn.
const TOKENS: &[&str] = &[
    "0",
    "-1",
    "1",
    "127",
    "128",
    "255",
    "256",
    "32767",
    "32768",
    "65535",
    "65536",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "9223372036854775808",
    "-9223372036854775808",
    "1e400",
    "-1e308",
    "1e-400",
    "nan",
    "inf",
    "0x",
    "it-cfg/",
    "cell-terminate-voltage",
    "mV",
    "V",
    "&&",
    "<",
    "==",
    " has ",
    "2026-11-22",
    "0xffff",
    "0b1",
    "1.5",
    "",
    " ",
    "\t",
    "\n",
    "\r\n",
    "\0",
    "\u{feff}",
    "é",
    "\"",
    "'",
    "[",
    "]",
    "[[",
    "=",
    "#",
    ",",
    ";",
    ":",
    "/",
    "*",
    "-",
    "+",
];

/// One change of an input.
#[derive(Clone, Debug)]
enum Edit {
    /// Replaces the run of digits at or behind a place.
    Number(Index, &'static str),
    /// Inserts a text at a place.
    Insert(Index, &'static str),
    /// Replaces a byte.
    Byte(Index, u8),
    /// Removes some bytes.
    Remove(Index, usize),
    /// Repeats a line.
    Repeat(Index, usize),
    /// Removes a line.
    Line(Index),
    /// Appends the rest of another input from a place on.
    Splice(Index, Index),
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let token = || select(TOKENS);
    let edit = prop_oneof![
        3 => (any::<Index>(), token()).prop_map(|(at, text)| Edit::Number(at, text)),
        2 => (any::<Index>(), token()).prop_map(|(at, text)| Edit::Insert(at, text)),
        3 => (any::<Index>(), any::<u8>()).prop_map(|(at, byte)| Edit::Byte(at, byte)),
        1 => (any::<Index>(), 1_usize..8).prop_map(|(at, count)| Edit::Remove(at, count)),
        1 => (any::<Index>(), 1_usize..4).prop_map(|(at, times)| Edit::Repeat(at, times)),
        1 => any::<Index>().prop_map(Edit::Line),
        1 => (any::<Index>(), any::<Index>()).prop_map(|(file, at)| Edit::Splice(file, at)),
    ];
    prop::collection::vec(edit, 1..6)
}

fn apply(mut input: Vec<u8>, edits: &[Edit], corpus: &[Vec<u8>]) -> Vec<u8> {
    for edit in edits {
        let place = |at: &Index| at.index(input.len() + 1);
        match edit {
            Edit::Number(at, text) => {
                let at = place(at);
                let digits = |from: usize, is: bool| {
                    let found = input[from..].iter().position(|byte| byte.is_ascii_digit() == is);
                    found.map_or(input.len(), |found| from + found)
                };
                let start = digits(at, true);
                let end = digits(start, false);
                input.splice(start..end, text.bytes());
            }
            Edit::Insert(at, text) => {
                let at = place(at);
                input.splice(at..at, text.bytes());
            }
            Edit::Byte(at, byte) => {
                let at = place(at);
                if let Some(old) = input.get_mut(at) {
                    *old = *byte;
                }
            }
            Edit::Remove(at, count) => {
                let at = place(at);
                input.drain(at..input.len().min(at + count));
            }
            Edit::Repeat(at, times) => {
                let line = line(&input, place(at));
                let text = input[line.clone()].repeat(*times);
                input.splice(line.end..line.end, text);
            }
            Edit::Line(at) => {
                let line = line(&input, place(at));
                input.drain(line);
            }
            Edit::Splice(file, at) => {
                let other = &corpus[file.index(corpus.len())];
                input.extend_from_slice(&other[at.index(other.len() + 1)..]);
            }
        }
    }
    input
}

/// The line around a place, with its newline.
fn line(input: &[u8], at: usize) -> std::ops::Range<usize> {
    let start = input[..at].iter().rposition(|&byte| byte == b'\n').map_or(0, |before| before + 1);
    let end = input[at..].iter().position(|&byte| byte == b'\n').map_or(input.len(), |end| at + end + 1);
    start..end
}

/// The kept inputs, by name.
fn corpus(target: &Target) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = std::fs::read_dir(target.corpus()).expect("a folder of inputs");
    let mut files: Vec<_> = folder.map(|file| file.expect("a file of the folder").path()).collect();
    files.sort();
    assert!(!files.is_empty(), "no inputs");
    files.into_iter().map(|path| (path.clone(), std::fs::read(path).expect("a file"))).collect()
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text} is not a number")))
}

fn check(name: &str) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target");
    let kept = corpus(target);
    for (path, input) in &kept {
        // The name comes with the output of a failure.
        println!("{}", path.display());
        (target.run)(input);
    }
    let inputs: Vec<Vec<u8>> = kept.into_iter().map(|(_, input)| input).collect();
    let seed = number("GAUGEFS_SEED").unwrap_or(1);
    let usual = if std::env::var_os("GAUGEFS_ALL").is_some() { target.slice } else { target.slice / 8 };
    let cases = number("GAUGEFS_FUZZ_CASES").map_or(usual, |cases| cases as u32);
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let config =
        ProptestConfig { rng_seed: RngSeed::Fixed(seed), rng_algorithm: RngAlgorithm::ChaCha, ..config };
    println!("GAUGEFS_SEED={seed}, {cases} changed inputs");
    let drawn = (any::<Index>(), edits());
    let changed = drawn.prop_map({
        let inputs = inputs.clone();
        move |(file, edits)| Input(apply(inputs[file.index(inputs.len())].clone(), &edits, &inputs))
    });
    let mut runner = TestRunner::new(config);
    let outcome = runner.run(&changed, |Input(input)| {
        (target.run)(&input);
        Ok(())
    });
    outcome.unwrap_or_else(|error| panic!("GAUGEFS_SEED={seed}: {error}"));
}

/// An input as its bytes are written in source.
#[derive(Clone)]
struct Input(Vec<u8>);

impl std::fmt::Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "b\"{}\"", self.0.escape_ascii())
    }
}

macro_rules! targets {
    ($($test:ident $name:literal)*) => {
        $(#[test]
        fn $test() {
            check($name);
        })*

        #[test]
        fn every_target_has_a_test() {
            let tested = [$($name),*];
            assert!(TARGETS.iter().map(|target| target.name).eq(tested));
        }
    };
}

targets! {
    image_toml "image-toml"
    image_ggcsv "image-ggcsv"
    image_gg "image-gg"
    image_flashstream "image-flashstream"
    value "value"
    name "name"
    transaction "transaction"
    keys "keys"
    journal "journal"
    replay "replay"
    configuration "configuration"
    station "station"
    condition "condition"
    csv "csv"
    command_line "command-line"
    bus "bus"
    ioctl "ioctl"
    fuse "fuse"
    usb "usb"
}
