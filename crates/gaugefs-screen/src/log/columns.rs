// SPDX-License-Identifier: MIT

//! The columns of a history and their contents.

use ti_gauge::chip::{Chip, Tier, snake_case};

use super::super::decimal::decimal;
use gaugefs_client::sample::Sample;
use gaugefs_host::error::{Cause, Error, Result};

/// The first columns of every row.
pub(super) const FIRST: [&str; 2] = ["time (UTC)", "gauge"];
/// Added to the unit of a register that not every poll reads.
const SLOW: &str = "every 10th poll";

/// The contents of a row.
pub(super) struct Facts<'a> {
    pub(super) sample: &'a Sample,
    /// Changes since the previous row.
    pub(super) events: &'a str,
    pub(super) learning: &'a str,
}

#[derive(Clone, Debug)]
pub(super) struct Column {
    /// Name and unit, for the first line.
    pub(super) title: String,
    value: Value,
}

#[derive(Clone, Debug)]
enum Value {
    Of(fn(&Sample) -> Option<String>),
    /// A register, by its file in `gauge/registers`.
    Register(String),
    /// The set bits of a register, by its file in `gauge`.
    Bits(String),
    Events,
    Learning,
}

/// A column with its own value: name, unit, whether it is a default column, and its text for a present gauge.
type Known = (&'static str, &'static str, bool, fn(&Sample) -> Option<String>);

const KNOWN: [Known; 15] = [
    ("status", "", true, |sample| Some(sample.status())),
    ("voltage", "V", true, |sample| millionths(sample, "voltage_now")),
    ("current", "A", true, |sample| millionths(sample, "current_now")),
    ("charge", "Ah", true, |sample| millionths(sample, "charge_now")),
    ("full charge", "Ah", true, |sample| millionths(sample, "charge_full")),
    ("capacity", "%", true, |sample| plain(sample, "capacity")),
    ("temperature", "°C", true, |sample| Some(decimal(sample.number("temp")?, 1, 1))),
    ("time to empty", "s", true, |sample| plain(sample, "time_to_empty_now")),
    ("time to full", "s", true, |sample| plain(sample, "time_to_full_now")),
    ("cycle count", "", true, |sample| plain(sample, "cycle_count")),
    ("state of health", "%", true, |sample| plain(sample, "state_of_health")),
    ("bits", "", true, |sample| {
        let words: Vec<_> = sample.words.iter().map(|(_, bits)| bits.as_str()).collect();
        Some(words.join(" ").trim().to_string())
    }),
    ("part", "", true, |sample| Some(sample.attribute("model_name")?.to_string())),
    // In the form that every command writes and accepts.
    ("serial number", "", true, |sample| Some(format!("0x{}", sample.attribute("serial_number")?))),
    ("seal", "", false, |sample| sample.seal.clone()),
];

/// Names of the columns that every part may have.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    KNOWN.iter().map(|known| known.0).chain([PASSED_CHARGE, EVENTS, LEARNING])
}

const EVENTS: &str = "events";
const LEARNING: &str = "learning";
/// A register that is a default column.
const PASSED_CHARGE: &str = "passed charge";

fn millionths(sample: &Sample, name: &str) -> Option<String> {
    Some(decimal(sample.number(name)?, 6, 3))
}

fn plain(sample: &Sample, name: &str) -> Option<String> {
    sample.number(name).map(|value| value.to_string())
}

/// Splits `voltage (V)` into name and unit. Text after the unit says how often the value is read.
pub(crate) fn split(title: &str) -> (&str, &str) {
    let parts = title.strip_suffix(')').and_then(|title| title.split_once(" ("));
    let (name, unit) = parts.unwrap_or((title, ""));
    let unit = unit.strip_suffix(SLOW).map_or(unit, |unit| unit.trim_end_matches("; "));
    (name, unit)
}

fn title(name: &str, unit: &str, slow: bool) -> String {
    match (unit, slow) {
        ("", false) => name.to_string(),
        ("", true) => format!("{name} ({SLOW})"),
        (unit, false) => format!("{name} ({unit})"),
        (unit, true) => format!("{name} ({unit}; {SLOW})"),
    }
}

impl Column {
    /// The column of a name, also written as a register's file: `true_fcc`.
    fn named(name: &str) -> Option<Self> {
        let name = &*name.trim().replace('_', " ");
        if let Some((name, unit, _, value)) = KNOWN.iter().find(|known| known.0 == name) {
            return Some(Self { title: title(name, unit, false), value: Value::Of(*value) });
        }
        let value = match name {
            EVENTS => Value::Events,
            LEARNING => Value::Learning,
            // A subcommand reads it, so it is in no table of registers.
            "control status" => Value::Bits("control_status".into()),
            _ => return Self::register(name),
        };
        Some(Self { title: name.into(), value })
    }

    /// A register that some part's mount shows.
    fn register(name: &str) -> Option<Self> {
        let registers = || {
            let all = Chip::all().flat_map(|chip| chip.registers).filter(|row| row.tier != Tier::Window);
            all.filter(|row| snake_case(row.name).replace('_', " ") == name)
        };
        let first = registers().next()?;
        let file = snake_case(first.name);
        if registers().any(|row| !row.bits.is_empty()) {
            let title = title(name, "", registers().any(|row| row.tier == Tier::Slow));
            return Some(Self { title, value: Value::Bits(file) });
        }
        // No unit is right for all where parts differ.
        let unit = if registers().all(|row| row.unit == first.unit) { first.unit } else { "" };
        let title = title(name, unit, registers().any(|row| row.tier == Tier::Slow));
        Some(Self { title, value: Value::Register(file) })
    }

    pub(super) fn choose(names: &[String]) -> Result<Vec<Self>> {
        let mut columns: Vec<Self> = Vec::new();
        for name in names {
            let column = Self::named(name).ok_or_else(|| unknown(name))?;
            if columns.iter().any(|other| other.title == column.title) {
                let why = format!("`{}` is named twice", name.trim());
                return Err(Error::new("--columns", Cause::Invalid, why));
            }
            columns.push(column);
        }
        Ok(columns)
    }

    /// The columns of an existing file, by its first line; `None` if `gaugefs log` did not write it.
    pub(super) fn of_file<'a>(titles: impl Iterator<Item = &'a str>) -> Option<Vec<Self>> {
        let mut titles = titles;
        if !FIRST.iter().all(|first| titles.next() == Some(*first)) {
            return None;
        }
        // The file keeps its titles: an earlier version may have written others.
        titles.map(|title| Some(Self { title: title.into(), ..Self::named(split(title).0)? })).collect()
    }

    pub(super) fn name(&self) -> &str {
        split(&self.title).0
    }

    /// The text for a gauge; empty if the gauge is absent or has no such value.
    pub(super) fn text(&self, facts: &Facts<'_>) -> String {
        let sample = facts.sample;
        let find = |name: &str| {
            let word = sample.words.iter().find(|(found, _)| found == name);
            word.map(|(_, bits)| bits.clone())
        };
        let value = match &self.value {
            Value::Events => return facts.events.into(),
            _ if !sample.present() => None,
            Value::Learning => return facts.learning.into(),
            Value::Of(value) => value(sample),
            Value::Register(file) => {
                let found = sample.registers.iter().find(|(name, _)| name == file);
                found.map(|(_, value)| value.to_string())
            }
            Value::Bits(file) => find(file),
        };
        value.unwrap_or_default()
    }
}

pub(super) fn usual() -> Vec<Column> {
    let known = KNOWN.iter().filter(|known| known.2).map(|known| known.0);
    known.chain([PASSED_CHARGE, EVENTS]).filter_map(Column::named).collect()
}

fn unknown(name: &str) -> Error {
    let known: Vec<_> = KNOWN.iter().map(|known| known.0).chain([EVENTS, LEARNING]).collect();
    let why = format!(
        "no column `{}`; there are {}, and the registers that ls GAUGE/gauge/registers shows",
        name.trim(),
        known.join(", ")
    );
    Error::new("--columns", Cause::Invalid, why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_has_a_name_and_a_unit() {
        assert_eq!(split("time to empty (s)"), ("time to empty", "s"));
        assert_eq!(split("cycle count"), ("cycle count", ""));
        assert_eq!(split("true fcc (mAh; every 10th poll)"), ("true fcc", "mAh"));
        assert_eq!(split("grid number (every 10th poll)"), ("grid number", ""));
    }

    #[test]
    fn what_is_read_slowly_is_marked() {
        let title = |name: &str| Column::named(name).map(|column| column.title);
        assert_eq!(title("true_fcc").as_deref(), Some("true fcc (mAh; every 10th poll)"));
        assert_eq!(title("true fcc"), title("true_fcc"));
        assert_eq!(title("voltage").as_deref(), Some("voltage (V)"));
        assert_eq!(title("learned_status").as_deref(), Some("learned status (every 10th poll)"));
        assert_eq!(title("control_status").as_deref(), Some("control status"));
        // A mount does not show the window of block access as registers.
        assert_eq!(title("block_data_checksum"), None);
    }

    /// Also with the columns of version 0.1.0.
    #[test]
    fn a_file_is_continued_with_its_columns() {
        let old = "time (UTC),gauge,status,voltage (V),passed charge (mAh),bits";
        let columns = Column::of_file(old.split(',')).expect("columns");
        let titles: Vec<_> = FIRST.into_iter().chain(columns.iter().map(|column| &*column.title)).collect();
        assert_eq!(titles.join(","), old);
        assert!(Column::of_file("time (UTC),gauge,speed".split(',')).is_none());
        assert!(Column::of_file("some,other".split(',')).is_none());
        let usual = usual();
        let titles = FIRST.into_iter().chain(usual.iter().map(|column| &*column.title));
        assert_eq!(Column::of_file(titles).expect("columns").len(), usual.len());
    }
}
