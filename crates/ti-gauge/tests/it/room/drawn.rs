// SPDX-License-Identifier: MIT

//! Runs that are drawn by seed, and those of a long list that are made in every test run.
//!
//! `GAUGEFS_SEEDS` sets the number of the drawn ones and `GAUGEFS_SEED` the first one; the latter alone repeats that run.
//! With `GAUGEFS_ALL`, which `tests/run --all` sets, no run of either kind is left out.

use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};

use gauge_bus::Reach;

use crate::rig;

/// Whether no run is left out.
pub(crate) fn is_all() -> bool {
    std::env::var_os("GAUGEFS_ALL").is_some()
}

/// One run of each so many, and of more where an adapter makes many transfers of one. A test that makes several such lists
/// begins each of them one further.
pub(crate) fn one_in<T>(many: usize, all: impl IntoIterator<Item = T>) -> impl Iterator<Item = T> {
    static LISTS: AtomicUsize = AtomicUsize::new(0);
    let usual = if is_all() { 1 } else { many };
    let step = match rig::adapter().reach() {
        Reach::FULL => usual,
        reach => usual * (4 + 100 / usize::from(reach.read)),
    };
    let first = if step == 1 { 0 } else { LISTS.fetch_add(1, Ordering::Relaxed) % step };
    all.into_iter().skip(first).step_by(step)
}

/// The seeds of a test that has so many by default.
fn seeds(usual: u64) -> Range<u64> {
    let number = |name: &str| {
        let text = std::env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|_| panic!("{name}={text} is not a number")))
    };
    match (number("GAUGEFS_SEED"), number("GAUGEFS_SEEDS")) {
        (Some(first), count) => first..first + count.unwrap_or(1),
        (None, count) => 0..count.unwrap_or(if is_all() { usual } else { usual / 5 }),
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
