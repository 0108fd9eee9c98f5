// SPDX-License-Identifier: MIT

//! Reads the CSV as lines to draw.

use std::collections::HashMap;

use jiff::Timestamp;

use super::super::log::columns::split;
use super::super::thin::Point;
use gaugefs_host::error::{Cause, Error, Result};

const USUAL: [&str; 4] = ["voltage", "current", "capacity", "temperature"];
/// Largest value that can be drawn: differences and axis steps of such values are computable.
const MOST: f64 = 1e15;
/// A pause this many times longer than usual is a gap without records.
const GAP: f64 = 10.0;

/// Series that share a unit.
#[derive(Debug)]
pub(super) struct Panel {
    pub(super) unit: String,
    pub(super) series: Vec<Series>,
}

/// A column of a gauge.
#[derive(Debug)]
pub(crate) struct Series {
    pub(crate) gauge: String,
    pub(crate) column: String,
    /// Seconds since 1970 and values, with a new line after each gap.
    pub(crate) lines: Vec<Vec<Point>>,
}

#[derive(Debug)]
pub(super) struct History {
    pub(super) panels: Vec<Panel>,
    pub(super) gauges: Vec<Gauge>,
}

#[derive(Debug)]
pub(super) struct Gauge {
    pub(super) name: String,
    pub(super) part: String,
    pub(super) serial: String,
    pub(super) from: f64,
    pub(super) to: f64,
    /// Its status over time, without gaps where it was recorded.
    pub(super) stretches: Vec<Stretch>,
    /// The charge that has flowed, if current was recorded.
    pub(super) flow: Option<Flow>,
    /// Flags of a low charge, with the largest capacity at which each was set.
    pub(super) low: Vec<(&'static str, f64)>,
}

/// A time with a constant `status`; `None` if nothing was recorded or the gauge was absent.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stretch {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) status: Option<String>,
}

/// Charge in Ah and energy in Wh; energy only if the voltage was recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Flow {
    pub(super) charged: f64,
    pub(super) discharged: f64,
    pub(super) energy: Option<(f64, f64)>,
}

const LOW: [&str; 2] = ["SOC1", "SOCF"];

fn invalid(subject: impl Into<String>, why: impl Into<String>) -> Error {
    Error::new(subject, Cause::Invalid, why.into())
}

/// A row's time and fields.
type Row = (f64, csv::StringRecord);

/// The line of a row. Between CR and LF the reader's position is still before the line.
fn line_of(text: &[u8], at: &csv::Position) -> String {
    let (before, rest) = text.split_at(text.len().min(at.byte() as usize));
    let ends = rest.iter().take_while(|byte| b"\r\n".contains(byte));
    let count = before.iter().chain(ends).filter(|&&byte| byte == b'\n').count();
    format!("line {}", count + 1)
}

/// The wanted columns, grouped by unit, and the gauges' facts.
pub(super) fn read(text: &[u8], wanted: &[String]) -> Result<History> {
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(text);
    let broken = |error: csv::Error| match (error.kind(), error.position()) {
        (csv::ErrorKind::Utf8 { .. }, Some(at)) => invalid(line_of(text, at), "not a text in UTF-8"),
        _ => invalid("", format!("not a CSV file: {error}")),
    };
    let headers = reader.headers().map_err(broken)?.clone();
    if headers.get(0) != Some("time (UTC)") || headers.get(1) != Some("gauge") {
        return Err(invalid("", "not written by `gaugefs log`: its first columns are not time and gauge"));
    }
    // In the file's order.
    let (mut gauges, mut numbers) = (Vec::<(String, Vec<Row>)>::new(), HashMap::new());
    for record in reader.records() {
        let record = record.map_err(broken)?;
        // A full disk or a power cut may have truncated the row.
        if record.len() < headers.len() {
            continue;
        }
        let line = || record.position().map_or(String::new(), |at| line_of(text, at));
        let time = &record[0];
        let time: Timestamp = time.parse().map_err(|_| invalid(line(), format!("`{time}` is not a time")))?;
        let number = *numbers.entry(record[1].to_string()).or_insert_with_key(|name| {
            gauges.push((name.clone(), Vec::new()));
            gauges.len() - 1
        });
        gauges[number].1.push((time.as_millisecond() as f64 / 1000.0, record));
    }
    let mut panels: Vec<Panel> = Vec::new();
    for name in names(&headers, wanted)? {
        let at = headers.iter().position(|header| split(header).0 == name).unwrap_or_default();
        let unit = split(&headers[at]).1;
        for (gauge, rows) in &gauges {
            let mut points = Vec::new();
            for (time, record) in rows {
                let value = match &record[at] {
                    "" => None,
                    field => Some(field.parse::<f64>().ok().filter(|value| value.abs() <= MOST).ok_or_else(
                        || {
                            invalid(
                                record.position().map_or(String::new(), |at| line_of(text, at)),
                                format!("{name} `{field}` is not a number, or too large to draw"),
                            )
                        },
                    )?),
                };
                points.push((*time, value));
            }
            let lines = lines(&points);
            // A default column that the gauge lacks is left out.
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
    let gauges = gauges.into_iter().map(|(name, rows)| gauge(name, &headers, &rows));
    Ok(History { panels, gauges: gauges.collect() })
}

/// A gauge's facts beside the drawn columns.
fn gauge(name: String, headers: &csv::StringRecord, rows: &[Row]) -> Gauge {
    let field = |row: &Row, name: &str| {
        let at = headers.iter().position(|header| split(header).0 == name)?;
        row.1.get(at).filter(|text| !text.is_empty()).map(str::to_string)
    };
    let number =
        |row: &Row, name: &str| field(row, name)?.parse::<f64>().ok().filter(|value| value.abs() <= MOST);
    let last = |name: &str| rows.iter().rev().find_map(|row| field(row, name)).unwrap_or_default();
    let steps = || rows.windows(2).map(|pair| (&pair[0], &pair[1]));
    let longest = longest_step(rows.iter().map(|row| row.0));

    let mut stretches: Vec<Stretch> = Vec::new();
    let mut flow: Option<Flow> = None;
    for (row, next) in steps().filter(|(row, next)| next.0 >= row.0) {
        let recorded = next.0 - row.0 <= longest;
        let status = field(row, "status").filter(|_| recorded);
        match stretches.last_mut().filter(|stretch| stretch.to == row.0 && stretch.status == status) {
            Some(stretch) => stretch.to = next.0,
            None => stretches.push(Stretch { from: row.0, to: next.0, status }),
        }
        let mean = |name: &str| Some((number(row, name)? + number(next, name)?) / 2.0);
        if let Some(current) = mean("current").filter(|_| recorded) {
            let hours = (next.0 - row.0) / 3600.0;
            flow.get_or_insert_default().add(current * hours, mean("voltage"));
        }
    }
    // Nothing is known without a column `status`.
    if !headers.iter().any(|header| header == "status") {
        stretches.clear();
    }
    let low = LOW.into_iter().filter_map(|flag| {
        let is_set =
            |row: &&Row| field(row, "bits").is_some_and(|bits| bits.split(' ').any(|bit| bit == flag));
        let set = rows.iter().filter(is_set).filter_map(|row| number(row, "capacity"));
        Some((flag, set.max_by(f64::total_cmp)?))
    });
    Gauge {
        part: last("part"),
        serial: last("serial number"),
        from: rows.iter().map(|row| row.0).fold(f64::INFINITY, f64::min),
        to: rows.iter().map(|row| row.0).fold(f64::NEG_INFINITY, f64::max),
        stretches,
        flow,
        low: low.collect(),
        name,
    }
}

impl Flow {
    /// Adds a charge, positive into the pack, at a voltage.
    fn add(&mut self, charge: f64, voltage: Option<f64>) {
        if charge > 0.0 {
            self.charged += charge
        } else {
            self.discharged -= charge
        }
        if let Some(voltage) = voltage {
            let (charged, discharged) = self.energy.get_or_insert_default();
            if charge > 0.0 { *charged += charge * voltage } else { *discharged -= charge * voltage }
        }
    }
}

/// Longest time between two rows without a gap.
fn longest_step(times: impl Iterator<Item = f64>) -> f64 {
    let times: Vec<_> = times.collect();
    let mut steps: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    GAP * steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

fn names(headers: &csv::StringRecord, wanted: &[String]) -> Result<Vec<String>> {
    let words = ["gauge", "status", "bits", "time", "part", "serial number", "events", "seal", "learning"];
    let there: Vec<_> = headers.iter().map(|header| split(header).0).collect();
    let there: Vec<_> = there.into_iter().filter(|name| !words.contains(name)).collect();
    if wanted.is_empty() {
        let usual = USUAL.iter().filter(|name| there.contains(name));
        return Ok(usual.map(|name| name.to_string()).collect());
    }
    let mut names = Vec::new();
    for name in wanted.iter().map(|name| name.trim()) {
        // Accept the names of register files, as `gaugefs log` does.
        let spaced = name.replace('_', " ");
        let name = if there.contains(&name) { name } else { &spaced };
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

/// Splits points into lines at missing values and long pauses.
fn lines(points: &[(f64, Option<f64>)]) -> Vec<Vec<Point>> {
    let longest = longest_step(points.iter().map(|point| point.0));
    let mut lines: Vec<Vec<Point>> = vec![Vec::new()];
    let mut before = f64::NEG_INFINITY;
    for &(time, value) in points {
        // After the clock was set back, the line would go to the left.
        let cut = value.is_none() || time - before > longest || time < before;
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
    fn what_has_flowed_is_summed_up_without_gaps() {
        let text = "time (UTC),gauge,status,voltage (V),current (A),capacity (%),bits,part\n\
                    2026-01-01T00:00:00Z,A,Discharging,4,-1,50,DSG,bq\n\
                    2026-01-01T00:30:00Z,A,Discharging,4,-1,10,DSG SOC1,bq\n\
                    2026-01-01T01:00:00Z,A,Charging,4,1,11,,bq\n\
                    2026-01-01T01:30:00Z,A,,,,,,\n\
                    2026-01-01T02:00:00Z,A,Charging,4,1,12,,bq\n\
                    2026-01-01T02:30:00Z,A,Charging,4,1,13,,bq\n\
                    2026-01-03T00:00:00Z,A,Charging,4,1,13,,bq\n";
        let history = read(text.as_bytes(), &[]).expect("a history");
        let gauge = &history.gauges[0];
        // The mean of -1 and 1 A is no current.
        assert_eq!(gauge.flow, Some(Flow { charged: 0.5, discharged: 0.5, energy: Some((2.0, 2.0)) }));
        let found: Vec<_> = gauge
            .stretches
            .iter()
            .map(|stretch| ((stretch.to - stretch.from) / 1800.0, stretch.status.as_deref().unwrap_or("-")))
            .collect();
        assert_eq!(
            found,
            [(2.0, "Discharging"), (1.0, "Charging"), (1.0, "-"), (1.0, "Charging"), (91.0, "-")]
        );
        assert_eq!(gauge.low, [("SOC1", 10.0)]);
        assert_eq!((gauge.part.as_str(), gauge.serial.as_str()), ("bq", ""));
    }

    #[test]
    fn a_column_is_named_as_log_names_it() {
        let text = "time (UTC),gauge,full charge (Ah)\n2026-01-01T00:00:00Z,A,2\n";
        for name in ["full charge", "full_charge"] {
            let history = read(text.as_bytes(), &[name.into()]).expect("a history");
            assert_eq!(history.panels[0].series[0].column, "full charge");
        }
    }

    /// It would take an hour if each gauge looked at all others' rows.
    #[test]
    fn regression_many_gauges_took_the_square_of_their_number() {
        let mut text = "time (UTC),gauge,status,voltage (V)\n".to_string();
        for number in 0..40_000 {
            text += &format!("2026-01-01T00:00:00Z,B{number},Full,3.7\n");
        }
        let history = read(text.as_bytes(), &[]).expect("a history");
        assert_eq!((history.gauges.len(), history.panels[0].series.len()), (40_000, 40_000));
    }

    #[test]
    fn a_file_that_cannot_be_drawn_is_refused() {
        let refusal = |text: &str, wanted: &[&str]| {
            let wanted: Vec<_> = wanted.iter().map(|name| name.to_string()).collect();
            read(text.as_bytes(), &wanted).expect_err("a refusal").to_string()
        };
        let head = "time (UTC),gauge,status,voltage (V)\n";
        let row = "2026-01-01T00:00:00Z,BAT0,Full,";
        assert!(refusal("a,b\n", &[]).contains("not written by"));
        assert!(refusal(head, &[]).contains("no values"));
        assert!(refusal(&format!("{head}{row}\n"), &[]).contains("no values"));
        // `gaugefs log` ends its lines with CR and LF.
        let text = format!("{head}{row}3.7\n\n{row}x\n").replace('\n', "\r\n");
        assert!(
            refusal(&text, &[]).contains("line 4: voltage `x` is not a number"),
            "{}",
            refusal(&text, &[])
        );
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
