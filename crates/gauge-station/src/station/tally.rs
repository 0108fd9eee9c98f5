// SPDX-License-Identifier: MIT

//! Outcomes of a run, counted for the people at the line.

use std::collections::{BTreeMap, BTreeSet};

use super::record::{Entry, Event};

/// The outcomes of a run so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Totals {
    /// Packs that have passed.
    pub passed: u64,
    /// Failed packs by step.
    pub failed: BTreeMap<String, u64>,
    /// First tries of packs in this run, as far as known.
    pub first_tries: u64,
    /// How many of those have passed.
    pub first_passes: u64,
    /// Seconds of passed packs: sum, least and most.
    pub seconds: (f64, f64, f64),
    /// Failures since the last pack that has passed.
    pub in_a_row: u64,
}

impl Totals {
    /// Number of failed packs.
    pub fn failures(&self) -> u64 {
        self.failed.values().sum()
    }

    /// Share of passed packs among first tries, in percent.
    pub fn first_pass_yield(&self) -> Option<f64> {
        (self.first_tries > 0).then(|| self.first_passes as f64 / self.first_tries as f64 * 100.0)
    }

    /// Mean seconds of a passed pack.
    pub fn mean_seconds(&self) -> Option<f64> {
        (self.passed > 0).then(|| self.seconds.0 / self.passed as f64)
    }

    /// The totals as lines; empty before the first outcome.
    pub fn lines(&self) -> Vec<String> {
        let packs = self.passed + self.failures();
        if packs == 0 {
            return Vec::new();
        }
        let mut line = format!("packs: {packs}, passed: {}, failed: {}", self.passed, self.failures());
        if let Some(percent) = self.first_pass_yield() {
            line += &format!(", first-pass yield: {percent:.1} %");
        }
        if let Some(mean) = self.mean_seconds() {
            let (_, least, most) = self.seconds;
            line += &format!(", seconds a pack: {mean:.1} ({least:.1} to {most:.1})");
        }
        let by_step = self.failed.iter().map(|(step, count)| format!("failed at {step}: {count}"));
        [line].into_iter().chain(by_step).collect()
    }
}

/// The totals, and the data to recognise second tries.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub(super) totals: Totals,
    tried: BTreeSet<String>,
}

impl Tally {
    pub(super) fn count(&mut self, entry: &Entry) {
        let Self { totals, tried } = self;
        let label = entry.label.iter().map(|label| format!("label {label}"));
        let serial = entry.serial.iter().map(|serial| format!("serial {serial}"));
        let names: Vec<String> = label.chain(serial).collect();
        // New packs may all have the same data flash, so it counts only after the station has changed it.
        let flash = |sum: &Option<String>| sum.as_ref().map(|sum| format!("flash {sum}"));
        let mut known = names.iter().cloned().chain(flash(&entry.found));
        let is_first = entry.seen.is_none() && !known.any(|name| tried.contains(&name));
        let left = entry.fingerprint.clone().filter(|left| Some(left) != entry.found.as_ref());
        tried.extend(names.into_iter().chain(flash(&left)));
        totals.first_tries += u64::from(is_first);
        if entry.event == Event::Pass {
            totals.passed += 1;
            totals.first_passes += u64::from(is_first);
            totals.in_a_row = 0;
            let seconds = entry.seconds.unwrap_or_default();
            let (sum, least, most) = totals.seconds;
            let least = if totals.passed == 1 { seconds } else { least.min(seconds) };
            totals.seconds = (sum + seconds, least, most.max(seconds));
        } else {
            totals.in_a_row += 1;
            let step = entry.step.clone().unwrap_or_else(|| "start".into());
            *totals.failed.entry(step).or_default() += 1;
        }
    }
}
