// SPDX-License-Identifier: MIT

//! What a record says about its packs: a table, or counts. It is only read, even while a station writes to it.

use std::collections::BTreeMap;
use std::path::Path;

use gaugefs_host::input;

use super::record::{self, Bad, Entry, Event, Measured};
use super::tally::{Tally, Totals};
use crate::error::{Error, Result};

/// Largest record in bytes: hundreds of thousands of packs.
const LONGEST: u64 = 1 << 30;

/// The outcomes in a record.
pub struct Records {
    outcomes: Vec<Entry>,
    unfinished: usize,
}

/// A row of counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its day, slot or image.
    pub name: String,
    /// Its outcomes.
    pub totals: Totals,
}

/// Failures with a common reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failures {
    /// How many there are.
    pub count: u64,
    /// The failed step; empty in older records.
    pub step: String,
    /// Common start of the reasons.
    pub reason: String,
}

/// The subject of counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// A day, in UTC.
    Day,
    /// A slot.
    Slot,
    /// An image.
    Image,
}

impl Records {
    /// Reads a record; `-` is standard input.
    pub fn read(path: &Path) -> Result<Self> {
        let name = input::name(path);
        let read = input::read_file(path, LONGEST);
        let text = read.map_err(|error| Error::io(&name, "the record cannot be read", &error))?;
        // A line with anything but text does not belong in a record.
        let text = String::from_utf8_lossy(&text);
        let (mut outcomes, mut begun) = (Vec::new(), BTreeMap::new());
        for line in record::lines(&text) {
            match line {
                Ok(entry) if entry.event == Event::Begun => drop(begun.insert(entry.number, ())),
                Ok(entry) => {
                    begun.remove(&entry.number);
                    outcomes.push(entry);
                }
                // A station may be writing it.
                Err(Bad::CutShort) => {}
                Err(Bad::Not(number, error)) => return Err(record::not_a_line(&name, number, &error)),
            }
        }
        Ok(Self { outcomes, unfinished: begun.len() })
    }

    /// Number of packs without an outcome.
    pub fn unfinished(&self) -> usize {
        self.unfinished
    }

    /// All outcomes together.
    pub fn totals(&self) -> Totals {
        let mut tally = Tally::default();
        self.outcomes.iter().for_each(|entry| tally.count(entry));
        tally.totals
    }

    /// The outcomes of each day, slot or image. The whole record decides what is a first try.
    pub fn groups(&self, by: By) -> Vec<Group> {
        let name = |entry: &Entry| match by {
            By::Day => entry.time.get(..10).unwrap_or(&entry.time).to_string(),
            By::Slot => entry.gauge.clone(),
            By::Image => {
                format!("{} {}", entry.image, entry.image_sha256.get(..12).unwrap_or(&entry.image_sha256))
            }
        };
        let mut groups: BTreeMap<String, Totals> = BTreeMap::new();
        let mut tally = Tally::default();
        for entry in &self.outcomes {
            let totals = groups.entry(name(entry)).or_default();
            std::mem::swap(&mut tally.totals, totals);
            tally.count(entry);
            std::mem::swap(&mut tally.totals, totals);
        }
        groups.into_iter().map(|(name, totals)| Group { name, totals }).collect()
    }

    /// The failures, the most frequent first.
    pub fn failures(&self) -> Vec<Failures> {
        // Serial numbers, times and files differ from pack to pack.
        let alike = |word: &str| !word.contains(|letter: char| letter.is_ascii_digit());
        type Kind<'a> = (String, Vec<Option<&'a str>>);
        let mut all: BTreeMap<Kind<'_>, (u64, Vec<&str>)> = BTreeMap::new();
        for entry in self.outcomes.iter().filter(|entry| entry.event != Event::Pass) {
            let reason = entry.reason.as_deref().unwrap_or("unknown");
            let reason = reason.split("; ").next().unwrap_or_default();
            // The rest differs from pack to pack.
            let end = reason.match_indices(": ").nth(2).map_or(reason.len(), |(at, _)| at);
            let words: Vec<&str> = reason[..end].split(' ').collect();
            let kind = words.iter().map(|word| alike(word).then_some(*word)).collect();
            let step = entry.step.clone().unwrap_or_default();
            let (count, common) = all.entry((step, kind)).or_insert_with(|| (0, words.clone()));
            *count += 1;
            for (common, word) in common.iter_mut().zip(words) {
                if *common != word {
                    *common = "...";
                }
            }
        }
        let list = all.into_iter().map(|((step, _), (count, words))| {
            let reason = words.join(" ");
            Failures { count, step, reason }
        });
        let mut list: Vec<Failures> = list.collect();
        list.sort_by_key(|failures| std::cmp::Reverse(failures.count));
        list
    }

    /// A row per outcome, as CSV with a header. Each quantity has its target, limits, and values before and after.
    pub fn csv(&self) -> Vec<u8> {
        let mut quantities: Vec<(&str, &str)> = Vec::new();
        for measured in self.outcomes.iter().flat_map(|entry| &entry.measured) {
            let quantity = (&*measured.name, &*measured.unit);
            if !quantities.contains(&quantity) {
                quantities.push(quantity);
            }
        }
        let mut names: Vec<String> = FIELDS.iter().map(|(name, _)| name.to_string()).collect();
        for (name, unit) in &quantities {
            let name = name.trim_end_matches("()").to_lowercase().replace(' ', "_");
            let unit = match *unit {
                "" => String::new(),
                "°C" => "_celsius".into(),
                unit => format!("_{unit}"),
            };
            names.extend(VALUES.iter().map(|(value, _)| format!("{name}{unit}_{value}")));
        }
        let mut text = row(names);
        for entry in &self.outcomes {
            let mut cells: Vec<String> = FIELDS.iter().map(|(_, of)| of(entry)).collect();
            for (name, unit) in &quantities {
                // The last one counts: the bring-up measures a voltage that may be calibrated later.
                let found = entry.measured.iter().rfind(|one| one.name == *name && one.unit == *unit);
                let value = |of: &Value| found.and_then(of).map_or(String::new(), |value| value.to_string());
                cells.extend(VALUES.iter().map(|(_, of)| value(of)));
            }
            text += &row(cells);
        }
        text.into_bytes()
    }
}

type Value = fn(&Measured) -> Option<f64>;

const VALUES: [(&str, Value); 5] = [
    ("wanted", |measured| measured.wanted),
    ("low", |measured| measured.low),
    ("high", |measured| measured.high),
    ("before", |measured| Some(measured.before)),
    ("after", |measured| Some(measured.after)),
];

type Text = fn(&Entry) -> String;

const FIELDS: [(&str, Text); 15] = [
    ("number", |entry| entry.number.to_string()),
    ("time", |entry| entry.time.clone()),
    ("station", |entry| entry.station.clone()),
    ("slot", |entry| entry.gauge.clone()),
    ("who", |entry| entry.who.clone()),
    ("chip", |entry| entry.chip.clone()),
    ("image", |entry| entry.image.clone()),
    ("image_sha256", |entry| entry.image_sha256.clone()),
    ("outcome", |entry| if entry.event == Event::Pass { "pass" } else { "fail" }.into()),
    ("serial", |entry| entry.serial.clone().unwrap_or_default()),
    ("label", |entry| entry.label.clone().unwrap_or_default()),
    ("step", |entry| entry.step.clone().unwrap_or_default()),
    ("reason", |entry| entry.reason.clone().unwrap_or_default()),
    ("seconds", |entry| entry.seconds.map_or(String::new(), |seconds| seconds.to_string())),
    ("transfers", |entry| entry.transfers.map_or(String::new(), |count| count.to_string())),
];

/// A row of CSV (RFC 4180). An apostrophe precedes a cell that a spreadsheet would take for a formula.
fn row(cells: Vec<String>) -> String {
    let cell = |cell: String| {
        let is_formula =
            cell.starts_with(['=', '+', '@']) || cell.starts_with('-') && cell.parse::<f64>().is_err();
        let cell = if is_formula { format!("'{cell}") } else { cell };
        match cell.contains([',', '"', '\n', '\r']) {
            true => format!("\"{}\"", cell.replace('"', "\"\"")),
            false => cell,
        }
    };
    cells.into_iter().map(cell).collect::<Vec<_>>().join(",") + "\n"
}
