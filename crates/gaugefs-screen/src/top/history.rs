// SPDX-License-Identifier: MIT

//! History of a gauge's quantities, for a chart.

use std::collections::VecDeque;

use super::super::plot::Series;
use super::super::thin;
use gaugefs_client::sample::Sample;

/// A day of the fastest polls. Then the oldest are dropped.
const MOST: usize = 172_800;

/// A quantity for a chart: its place in [`QUANTITIES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Quantity(usize);

struct Row {
    key: char,
    name: &'static str,
    unit: &'static str,
    /// Minimum span of an axis, so that noise of one step does not fill the chart.
    least_span: f64,
    attribute: &'static str,
    /// Steps of the attribute in the unit.
    steps: f64,
}

#[rustfmt::skip]
static QUANTITIES: [Row; 4] = [
    Row { key: 'v', name: "voltage", unit: "V", least_span: 0.02, attribute: "voltage_now", steps: 1e6 },
    Row { key: 'i', name: "current", unit: "A", least_span: 0.02, attribute: "current_now", steps: 1e6 },
    Row { key: 'c', name: "capacity", unit: "%", least_span: 4.0, attribute: "capacity", steps: 1.0 },
    Row { key: 't', name: "temperature", unit: "°C", least_span: 1.0, attribute: "temp", steps: 10.0 },
];

impl Quantity {
    pub(super) const VOLTAGE: Self = Self(0);
    pub(super) const ALL: [Self; 4] = [Self(2), Self(0), Self(1), Self(3)];

    /// The quantity of a key.
    pub(super) fn of_key(key: char) -> Option<Self> {
        QUANTITIES.iter().position(|row| row.key == key).map(Self)
    }

    pub(super) fn name(self) -> &'static str {
        QUANTITIES[self.0].name
    }

    pub(super) fn unit(self) -> &'static str {
        QUANTITIES[self.0].unit
    }

    pub(super) fn least_span(self) -> f64 {
        QUANTITIES[self.0].least_span
    }
}

impl Row {
    fn of(&self, sample: &Sample) -> Option<f64> {
        sample.number(self.attribute).map(|value| value as f64 / self.steps)
    }
}

/// One poll: seconds since 1970, and the [`QUANTITIES`].
struct Point {
    time: f64,
    values: [Option<f64>; 4],
}

/// A log's part of a gauge's history: lines of each quantity, in seconds since 1970.
#[derive(Debug, Default)]
pub(super) struct Past {
    pub(super) gauge: String,
    lines: [Vec<Vec<thin::Point>>; 4],
}

impl Past {
    /// The histories of all gauges in a log.
    pub(super) fn of(series: Vec<Series>) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for Series { gauge, column, lines } in series {
            let Some(quantity) = QUANTITIES.iter().position(|row| row.name == column) else { continue };
            let at = all.iter().position(|past| past.gauge == gauge).unwrap_or_else(|| {
                all.push(Self { gauge, ..Self::default() });
                all.len() - 1
            });
            all[at].lines[quantity] = lines;
        }
        all
    }

    /// Lines of a quantity from the last point before `from` until `to`.
    fn lines(&self, quantity: Quantity, from: f64, to: f64) -> impl Iterator<Item = Vec<thin::Point>> {
        self.lines[quantity.0].iter().filter_map(move |line| {
            let first = line.partition_point(|(time, _)| *time < from).saturating_sub(1);
            let end = line.partition_point(|(time, _)| *time < to);
            line.get(first..end).filter(|line| !line.is_empty()).map(<[_]>::to_vec)
        })
    }
}

/// A log that ends this many of its steps before the first poll is not continued.
const JOINED: f64 = 2.5;

#[derive(Default)]
pub(super) struct History(VecDeque<Point>);

impl History {
    pub(super) fn add(&mut self, sample: &Sample) {
        let there = sample.present();
        let values = QUANTITIES.each_ref().map(|row| row.of(sample).filter(|_| there));
        self.push(Point { time: seconds(sample.time), values });
    }

    /// Records that nothing is known until the next poll.
    pub(super) fn gap(&mut self, now: f64) {
        if self.0.back().is_some_and(|point| point.values.iter().any(Option::is_some)) {
            self.push(Point { time: now, values: [None; 4] });
        }
    }

    fn push(&mut self, point: Point) {
        if self.0.len() == MOST {
            self.0.pop_front();
        }
        self.0.push_back(point);
    }

    /// The lines of the last `span` seconds, in seconds relative to `now`, reduced to what `columns` can show. They
    /// begin with the log's part before the first poll.
    pub(super) fn lines(
        &self,
        past: Option<&Past>,
        quantity: Quantity,
        now: f64,
        span: f64,
        columns: usize,
    ) -> Vec<Vec<thin::Point>> {
        // With the poll before the span, so that a line begins at its edge.
        let first = self.0.partition_point(|point| point.time < now - span).saturating_sub(1);
        let shown = self.0.iter().skip(first).take_while(|point| point.time <= now);
        let points: Vec<_> = shown.map(|point| (point.time, point.values[quantity.0])).collect();
        let lines = points.split(|(_, value)| value.is_none()).filter(|line| !line.is_empty());
        let known = |line: &[(f64, Option<f64>)]| -> Vec<_> {
            line.iter().filter_map(|(time, value)| Some((*time, (*value)?))).collect()
        };
        let begin = self.0.front().map_or(now, |point| point.time);
        let logged = past.into_iter().flat_map(|past| past.lines(quantity, now - span, begin.min(now)));
        let mut all: Vec<Vec<thin::Point>> = logged.collect();
        let mut polled = lines.map(known).peekable();
        if let Some(last) = all.last_mut()
            && let Some(line) = polled.next_if(|line| line[0].0 == begin && is_joined(last, line))
        {
            last.extend(line);
        }
        all.extend(polled);
        let relative = |line: Vec<thin::Point>| -> Vec<thin::Point> {
            line.into_iter().map(|(time, value)| (time - now, value)).collect()
        };
        all.into_iter().map(|line| thin::thin(&relative(line), -span, span, columns)).collect()
    }
}

/// Whether this program's polls continue a log.
fn is_joined(logged: &[thin::Point], polled: &[thin::Point]) -> bool {
    let [.., (before, _), (last, _)] = logged else { return false };
    polled.first().is_some_and(|(first, _)| first - last <= JOINED * (last - before))
}

pub(super) fn seconds(time: jiff::Timestamp) -> f64 {
    time.as_millisecond() as f64 / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history(points: &[(f64, Option<f64>)]) -> History {
        let point = |&(time, value)| Point { time, values: [value; 4] };
        History(points.iter().map(point).collect())
    }

    #[test]
    fn an_absence_is_one_gap() {
        let mut seen = history(&[(0.0, Some(1.0)), (10.0, Some(2.0)), (20.0, None), (30.0, Some(3.0))]);
        let lines = seen.lines(None, Quantity::VOLTAGE, 30.0, 60.0, 60);
        assert_eq!(lines, [vec![(-30.0, 1.0), (-20.0, 2.0)], vec![(0.0, 3.0)]]);
        seen.gap(40.0);
        seen.gap(50.0);
        assert_eq!(seen.0.len(), 5, "one gap, however long");
    }
}
