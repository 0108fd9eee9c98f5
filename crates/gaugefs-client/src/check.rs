// SPDX-License-Identifier: MIT

//! The lines of `gauge/check`.

/// A line of `gauge/check`, whose columns are separated by tabs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Finding {
    /// `wrong`, `doubtful` or `note`; `missing` or `unread` for a rule that was not decided.
    pub severity: String,
    /// The rule's name.
    pub rule: String,
    /// The values that show it, or the name of a missing one.
    pub values: String,
    /// What it means.
    pub means: String,
    /// What to do.
    pub remedy: String,
}

impl Finding {
    /// All lines of the file.
    pub fn all(text: &str) -> Vec<Self> {
        let line = |line: &str| {
            let mut columns = line.split('\t').map(String::from);
            let mut next = || columns.next().unwrap_or_default();
            Self { severity: next(), rule: next(), values: next(), means: next(), remedy: next() }
        };
        text.lines().map(line).collect()
    }
}

/// `wrong: full-capacity, temperature`, for the lists of gauges; `None` while nothing is certainly wrong.
pub fn wrong(text: &str) -> Option<String> {
    named(text, "wrong")
}

/// `doubtful: design-capacity-default`, of what a person has to decide.
pub fn doubtful(text: &str) -> Option<String> {
    named(text, "doubtful")
}

fn named(text: &str, severity: &str) -> Option<String> {
    let found = Finding::all(text).into_iter().filter(|finding| finding.severity == severity);
    let names: Vec<_> = found.map(|finding| finding.rule).collect();
    (!names.is_empty()).then(|| format!("{severity}: {}", names.join(", ")))
}
