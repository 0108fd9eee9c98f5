//! Reads the CSV into lines to draw.

use jiff::Timestamp;

use super::super::thin::Point;
use crate::error::{Cause, Error, Result};

/// The columns that are drawn by default.
const USUAL: [&str; 4] = ["voltage", "current", "capacity", "temperature"];
/// The largest value that can be drawn: differences of such values, and steps of an axis, can be computed.
const MOST: f64 = 1e15;
/// A pause this many times as long as the usual one is a gap: nothing was recorded.
const GAP: f64 = 10.0;

/// Series that share a unit.
#[derive(Debug)]
pub(super) struct Panel {
    pub(super) unit: String,
    pub(super) series: Vec<Series>,
}

/// One column of one gauge.
#[derive(Debug)]
pub(super) struct Series {
    pub(super) gauge: String,
    pub(super) column: String,
    /// Seconds since 1970 and values, with a new line after each gap.
    pub(super) lines: Vec<Vec<Point>>,
}

fn invalid(subject: impl Into<String>, why: impl Into<String>) -> Error {
    Error::new(subject, Cause::Invalid(why.into()))
}

/// Splits `voltage (V)` into name and unit.
fn split(header: &str) -> (&str, &str) {
    header.strip_suffix(')').and_then(|header| header.split_once(" (")).unwrap_or((header, ""))
}

/// The wanted columns, grouped by unit.
pub(super) fn panels(text: &[u8], wanted: &[String]) -> Result<Vec<Panel>> {
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(text);
    let broken = |error: csv::Error| invalid("", format!("not a CSV file: {error}"));
    let headers = reader.headers().map_err(broken)?.clone();
    if headers.get(0) != Some("time (UTC)") || headers.get(1) != Some("gauge") {
        return Err(invalid("", "not written by `gaugefs log`: its first columns are not time and gauge"));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        // A full disk or a power cut may have truncated the row.
        if record.len() < headers.len() {
            continue;
        }
        let line = record.position().map_or(0, csv::Position::line);
        let time = &record[0];
        let time: Timestamp =
            time.parse().map_err(|_| invalid(format!("line {line}"), format!("`{time}` is not a time")))?;
        rows.push((time.as_millisecond() as f64 / 1000.0, line, record));
    }
    let mut gauges: Vec<String> = Vec::new();
    for (.., record) in &rows {
        if !gauges.iter().any(|gauge| *gauge == record[1]) {
            gauges.push(record[1].to_string());
        }
    }
    let mut panels: Vec<Panel> = Vec::new();
    for name in names(&headers, wanted)? {
        let at = headers.iter().position(|header| split(header).0 == name).unwrap_or_default();
        let unit = split(&headers[at]).1;
        for gauge in &gauges {
            let mut points = Vec::new();
            for (time, line, record) in rows.iter().filter(|(.., record)| record[1] == **gauge) {
                let value = match &record[at] {
                    "" => None,
                    text => Some(text.parse::<f64>().ok().filter(|value| value.abs() <= MOST).ok_or_else(
                        || {
                            invalid(
                                format!("line {line}"),
                                format!("{name} `{text}` is not a number, or too large to draw"),
                            )
                        },
                    )?),
                };
                points.push((*time, value));
            }
            let lines = lines(&points);
            // A default column that the gauge does not have is left out.
            if wanted.is_empty() && lines.is_empty() {
                continue;
            }
            let series = Series { gauge: gauge.clone(), column: name.clone(), lines };
            match panels.iter_mut().find(|panel| panel.unit == unit) {
                Some(panel) => panel.series.push(series),
                None => panels.push(Panel { unit: unit.to_string(), series: vec![series] }),
            }
        }
    }
    if panels.iter().all(|panel| panel.series.iter().all(|series| series.lines.is_empty())) {
        return Err(invalid("", "it has no values to draw"));
    }
    Ok(panels)
}

fn names(headers: &csv::StringRecord, wanted: &[String]) -> Result<Vec<String>> {
    let words = ["gauge", "status", "bits", "time"];
    let there: Vec<_> = headers.iter().map(|header| split(header).0).collect();
    let there: Vec<_> = there.into_iter().filter(|name| !words.contains(name)).collect();
    if wanted.is_empty() {
        let usual = USUAL.iter().filter(|name| there.contains(name));
        return Ok(usual.map(|name| name.to_string()).collect());
    }
    let mut names = Vec::new();
    for name in wanted.iter().map(|name| name.trim()) {
        if !there.contains(&name) {
            return Err(invalid(
                "",
                format!("no column `{name}` to draw; the columns are {}", there.join(", ")),
            ));
        }
        names.push(name.to_string());
    }
    Ok(names)
}

/// Splits points into lines at missing values and at long pauses.
fn lines(points: &[(f64, Option<f64>)]) -> Vec<Vec<Point>> {
    let mut steps: Vec<_> = points.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    steps.sort_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    let mut lines: Vec<Vec<Point>> = vec![Vec::new()];
    let mut before = f64::NEG_INFINITY;
    for &(time, value) in points {
        // If the clock was set back, the line would go to the left.
        let cut = value.is_none() || time - before > GAP * usual || time < before;
        if cut && lines.last().is_some_and(|line| !line.is_empty()) {
            lines.push(Vec::new());
        }
        before = time;
        lines.last_mut().into_iter().for_each(|line| line.extend(value.map(|value| (time, value))));
    }
    lines.retain(|line| !line.is_empty());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_values_and_pauses_split_a_line() {
        let at = |time, value| (time, Some(value));
        let points = [at(0.0, 1.0), at(1.0, 2.0), (2.0, None), at(3.0, 3.0), at(4.0, 4.0), at(50.0, 5.0)];
        let lengths: Vec<_> = lines(&points).iter().map(Vec::len).collect();
        assert_eq!(lengths, [2, 2, 1]);
        assert!(lines(&[]).is_empty());
    }

    #[test]
    fn a_header_has_a_name_and_a_unit() {
        assert_eq!(split("time to empty (s)"), ("time to empty", "s"));
        assert_eq!(split("cycle count"), ("cycle count", ""));
    }

    #[test]
    fn a_file_that_cannot_be_drawn_is_refused() {
        let refusal = |text: &str, wanted: &[&str]| {
            let wanted: Vec<_> = wanted.iter().map(|name| name.to_string()).collect();
            panels(text.as_bytes(), &wanted).expect_err("a refusal").to_string()
        };
        let head = "time (UTC),gauge,status,voltage (V)\n";
        let row = "2026-01-01T00:00:00Z,BAT0,Full,";
        assert!(refusal("a,b\n", &[]).contains("not written by"));
        assert!(refusal(head, &[]).contains("no values"));
        assert!(refusal(&format!("{head}{row}\n"), &[]).contains("no values"));
        assert!(refusal(&format!("{head}{row}x\n"), &[]).contains("line 2: voltage `x` is not a number"));
        // Such values gave coordinates that are no numbers.
        assert!(
            refusal(&format!("{head}{row}1e308\n"), &[]).contains("voltage `1e308` is not a number, or too")
        );
        assert!(
            refusal(&format!("{head}yesterday,BAT0,Full,1\n"), &[])
                .contains("line 2: `yesterday` is not a time")
        );
        assert!(
            refusal(&format!("{head}{row}1\n"), &["speed"])
                .contains("no column `speed` to draw; the columns are voltage")
        );
    }
}
