// SPDX-License-Identifier: MIT

//! The check of a gauge whose values are published, and the text of `gauge/check`.

use std::fmt::Write;

use gauge_owner::{Handle, Snapshot};
use ti_gauge::check::{Checked, Facts};
use ti_gauge::chip::{Limited, Row};
use ti_gauge::text::printable;

/// Applies the rules to a poll and to what of data flash has been read.
pub(crate) fn of(handle: &Handle, snapshot: &Snapshot, host_scale: f64) -> Checked {
    let published = handle.published();
    let is_asked = !published.limited.is_some_and(Limited::is_never_asked);
    let stored = |(subclass, row): Row| handle.kept_value((subclass.id, row.offset), row.kind);
    Checked::of(&Facts {
        chip: handle.chip(),
        dm_code: published.answers.dm_code,
        chem_id: published.answers.chem_id,
        registers: Some(snapshot.registers()),
        control_status: Some(snapshot.control_status).filter(|_| is_asked),
        unwritten: if snapshot.is_configured { "" } else { published.unwritten() },
        owed: &published.owed,
        host_scale,
        stored: &stored,
        history: snapshot.history,
    })
}

/// A line for each finding and for each rule that was not decided: severity, rule, values, what it means, what to do.
pub(crate) fn text(checked: &Checked) -> String {
    let mut text = String::new();
    let mut line = |columns: [&str; 5]| {
        let columns = columns.map(printable);
        // Writing to a String does not fail.
        let _ = writeln!(text, "{}", columns.join("\t").trim_end());
    };
    for finding in &checked.findings {
        let rule = finding.rule;
        line([rule.severity.as_str(), rule.name, &finding.values, rule.means, rule.remedy]);
    }
    for (rule, name) in &checked.missing {
        line(["missing", rule.name, &format!("{name}()"), "", ""]);
    }
    for rule in &checked.unread {
        line(["unread", rule.name, "data flash", "", ""]);
    }
    text
}

#[cfg(test)]
mod tests {
    use gaugefs_client::check::{Finding as Line, wrong};
    use ti_gauge::check::{Finding, RULES, Severity};

    use super::*;

    /// More than there are rules.
    #[test]
    fn sixty_four_findings_are_told_and_read_back() {
        let finding = |number: usize| Finding {
            rule: &RULES[number % RULES.len()],
            values: format!("value {number}\tof\nmany {}", "x".repeat(2000)),
        };
        let checked = Checked { findings: (0..64).map(finding).collect(), ..Checked::default() };
        let text = text(&checked);
        let lines = Line::all(&text);
        assert_eq!(lines.len(), 64, "{text}");
        for (line, finding) in lines.iter().zip(&checked.findings) {
            let rule = finding.rule;
            assert_eq!((&*line.severity, &*line.rule), (rule.severity.as_str(), rule.name));
            assert_eq!((&*line.means, &*line.remedy), (rule.means, rule.remedy));
        }
        let worst =
            checked.findings.iter().filter(|finding| finding.rule.severity == Severity::Wrong).count();
        assert_eq!(wrong(&text).expect("some are wrong").matches(", ").count() + 1, worst);
    }
}
