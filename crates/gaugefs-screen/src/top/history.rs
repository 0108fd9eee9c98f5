// SPDX-License-Identifier: MIT

//! The history of a gauge's quantities, for a chart.

use std::collections::VecDeque;

use super::super::thin;
use gaugefs_client::sample::Sample;

/// A day of the fastest polls. When it is full, the oldest are dropped.
const MOST: usize = 172_800;

/// A quantity that can be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    Voltage,
    Current,
    Capacity,
    Temperature,
}

pub(super) const QUANTITIES: [Quantity; 4] =
    [Quantity::Voltage, Quantity::Current, Quantity::Capacity, Quantity::Temperature];

impl Quantity {
    pub(super) fn name(self) -> &'static str {
        match self {
            Quantity::Voltage => "voltage",
            Quantity::Current => "current",
            Quantity::Capacity => "capacity",
            Quantity::Temperature => "temperature",
        }
    }

    pub(super) fn unit(self) -> &'static str {
        match self {
            Quantity::Voltage => "V",
            Quantity::Current => "A",
            Quantity::Capacity => "%",
            Quantity::Temperature => "°C",
        }
    }

    /// The minimum span of an axis, so that noise of one step does not fill the chart.
    pub(super) fn least_span(self) -> f64 {
        match self {
            Quantity::Voltage => 0.02,
            Quantity::Current => 0.02,
            Quantity::Capacity => 4.0,
            Quantity::Temperature => 1.0,
        }
    }

    fn of(self, sample: &Sample) -> Option<f64> {
        let number = |name| sample.number(name).map(|value| value as f64);
        match self {
            Quantity::Voltage => number("voltage_now").map(|value| value / 1e6),
            Quantity::Current => number("current_now").map(|value| value / 1e6),
            Quantity::Capacity => number("capacity"),
            Quantity::Temperature => number("temp").map(|value| value / 10.0),
        }
    }
}

/// One poll: seconds since 1970, and the [`QUANTITIES`].
struct Point {
    time: f64,
    values: [Option<f64>; 4],
}

/// Polls, the oldest first.
#[derive(Default)]
pub(super) struct History(VecDeque<Point>);

impl History {
    pub(super) fn add(&mut self, sample: &Sample) {
        let there = sample.present();
        let values = QUANTITIES.map(|quantity| quantity.of(sample).filter(|_| there));
        self.push(Point { time: seconds(sample.time), values });
    }

    /// Records that nothing is known from now until the next poll.
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

    /// The lines of the last `span` seconds, as seconds relative to `now` and values, reduced to what `columns`
    /// can show.
    pub(super) fn lines(
        &self,
        quantity: Quantity,
        now: f64,
        span: f64,
        columns: usize,
    ) -> Vec<Vec<thin::Point>> {
        let which = QUANTITIES.iter().position(|&one| one == quantity).unwrap_or_default();
        // With the poll before the span, so that a line begins at its edge.
        let first = self.0.partition_point(|point| point.time < now - span).saturating_sub(1);
        let shown = self.0.iter().skip(first).take_while(|point| point.time <= now);
        let points: Vec<_> = shown.map(|point| (point.time - now, point.values[which])).collect();
        let lines = points.split(|(_, value)| value.is_none()).filter(|line| !line.is_empty());
        let known = |line: &[(f64, Option<f64>)]| -> Vec<_> {
            line.iter().filter_map(|(time, value)| Some((*time, (*value)?))).collect()
        };
        lines.map(|line| thin::thin(&known(line), -span, span, columns)).collect()
    }
}

/// Seconds since 1970.
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
        let lines = seen.lines(Quantity::Voltage, 30.0, 60.0, 60);
        assert_eq!(lines, [vec![(-30.0, 1.0), (-20.0, 2.0)], vec![(0.0, 3.0)]]);
        seen.gap(40.0);
        seen.gap(50.0);
        assert_eq!(seen.0.len(), 5, "one gap, however long");
    }
}
