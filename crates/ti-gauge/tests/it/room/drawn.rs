// SPDX-License-Identifier: MIT

//! Runs that are drawn by seed.
//!
//! `GAUGEFS_SEEDS` sets their number and `GAUGEFS_SEED` the first one; the latter alone repeats that run.

use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The seeds of a test that has so many by default.
fn seeds(usual: u64) -> Range<u64> {
    let number = |name: &str| {
        let text = std::env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|_| panic!("{name}={text} is not a number")))
    };
    match (number("GAUGEFS_SEED"), number("GAUGEFS_SEEDS")) {
        (Some(first), count) => first..first + count.unwrap_or(1),
        (None, count) => 0..count.unwrap_or(usual),
    }
}

/// Makes the runs, prints how often each thing that they tell was told, and fails with the seeds of those that fail.
pub(crate) fn drawn(what: &str, usual: u64, run: impl Fn(u64) -> Result<Vec<String>, String>) {
    let seeds = seeds(usual);
    let total = seeds.end - seeds.start;
    let (mut counts, mut failures) = (BTreeMap::<String, u64>::new(), Vec::new());
    for seed in seeds {
        match catch_unwind(AssertUnwindSafe(|| run(seed))) {
            Ok(Ok(told)) => told.into_iter().for_each(|what| *counts.entry(what).or_default() += 1),
            Ok(Err(why)) => failures.push(format!("seed {seed}: {why}")),
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().map(ToString::to_string);
                let why =
                    panic.downcast_ref::<String>().cloned().or(text).unwrap_or_else(|| "a panic".into());
                failures.push(format!("seed {seed}: {why}"));
            }
        }
    }
    println!("{total} {what}:");
    for (what, count) in counts {
        println!("{count:8}  {what}");
    }
    assert!(failures.is_empty(), "{} of {total} failed:\n{}", failures.len(), failures.join("\n"));
}
