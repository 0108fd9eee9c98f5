// SPDX-License-Identifier: MIT

//! Round numbers and round times for axes.

use jiff::Timestamp;

/// A position on an axis and its label.
pub(super) type Tick = (f64, String);

/// Steps of a time axis, in seconds. Longer steps are whole days.
const STEPS: [f64; 21] = [
    0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0,
    10_800.0, 21_600.0, 43_200.0, DAY,
];
const DAY: f64 = 86_400.0;

/// Round bounds around values, at least `least` apart, with about `most` steps between them.
pub(super) fn numbers(low: f64, high: f64, least: f64, most: usize) -> (f64, f64, Vec<Tick>) {
    // A constant value is in the middle.
    let spread = (high - low).max(least);
    let middle = (low + high) / 2.0;
    let (low, high) = (middle - spread / 2.0, middle + spread / 2.0);
    let raw = spread / most.max(1) as f64;
    let power = 10f64.powf(raw.log10().floor());
    let round = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = round.into_iter().find(|step| *step >= raw * 0.999).unwrap_or(10.0 * power);
    let places = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    // Rounding errors must not add an empty step.
    let (first, last) = ((low / step + 1e-6).floor() as i64, (high / step - 1e-6).ceil() as i64);
    let ticks = (first..=last).map(|at| at as f64 * step);
    let label =
        |value: f64| format!("{:.places$}", if value == 0.0 { 0.0 } else { value }).replace('-', "\u{2212}");
    (first as f64 * step, last as f64 * step, ticks.map(|value| (value, label(value))).collect())
}

/// The round step that divides a time span into `most` steps.
fn step(span: f64, most: usize) -> f64 {
    let raw = span / most.max(1) as f64;
    STEPS.into_iter().find(|step| *step >= raw).unwrap_or((raw / DAY).ceil() * DAY)
}

/// At most `most` round times between two.
pub(super) fn times(from: f64, to: f64, most: usize) -> Vec<Tick> {
    let step = step(to - from, most);
    let (first, last) = ((from / step).ceil() as i64, (to / step).floor() as i64);
    let label = |seconds: f64| {
        let format = match () {
            // Midnight shows the date.
            () if seconds % DAY == 0.0 => "%b %-d",
            () if step < 1.0 => "%H:%M:%S%.1f",
            () if step < 60.0 => "%H:%M:%S",
            () => "%H:%M",
        };
        utc(seconds, format)
    };
    (first..=last).map(|at| at as f64 * step).map(|seconds| (seconds, label(seconds))).collect()
}

/// At most `most` round durations from 0 to `span` seconds.
pub(super) fn durations(span: f64, most: usize) -> Vec<Tick> {
    lasting(span, step(span, most))
}

/// At most `most` round durations of a step that divides the span. If no round step does, only the ends are left.
pub(super) fn divisions(span: f64, most: usize) -> Vec<Tick> {
    let divides = |step: &f64| span % step == 0.0 && span / step <= most as f64;
    lasting(span, STEPS.into_iter().find(divides).unwrap_or(span))
}

fn lasting(span: f64, step: f64) -> Vec<Tick> {
    let label = |seconds: f64| {
        let whole = seconds.round() as i64;
        let clock =
            |unit: i64, name: &str| format!("{}:{:02} {name}", whole / unit, whole % unit * 60 / unit);
        match () {
            () if whole == 0 => "0".to_string(),
            () if step < 1.0 => format!("{seconds:.1} s"),
            () if whole % DAY as i64 == 0 => format!("{} d", whole / DAY as i64),
            () if whole % 3600 == 0 => format!("{} h", whole / 3600),
            () if whole > 3600 => clock(3600, "h"),
            () if whole % 60 == 0 => format!("{} min", whole / 60),
            () if whole > 60 => clock(60, "min"),
            () => format!("{whole} s"),
        }
    };
    let last = (span / step + 1e-6).floor() as i64;
    (0..=last).map(|at| at as f64 * step).map(|seconds| (seconds, label(seconds))).collect()
}

/// A time in UTC, in strftime(3) format.
pub(super) fn utc(seconds: f64, format: &str) -> String {
    let time = Timestamp::from_millisecond((seconds * 1000.0).round() as i64).unwrap_or_default();
    time.strftime(format).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|(_, label)| label.as_str()).collect()
    }

    #[test]
    fn number_ticks_are_round_and_enclose_all_values() {
        let (low, high, ticks) = numbers(3.512, 4.117, 0.02, 4);
        assert_eq!(labels(&ticks), ["3.4", "3.6", "3.8", "4.0", "4.2"]);
        assert!(low <= 3.512 && high >= 4.117);
        assert_eq!(
            labels(&numbers(-0.5, 0.0, 0.02, 3).2),
            ["\u{2212}0.6", "\u{2212}0.4", "\u{2212}0.2", "0.0"]
        );
        let (low, high, ticks) = numbers(25.0, 25.0, 2.0, 4);
        assert!(low < 25.0 && high > 25.0 && ticks.len() <= 6);
        assert!(numbers(0.0, 0.0, 1.0, 4).2.iter().any(|(_, label)| label.starts_with('0')));
    }

    #[test]
    fn durations_begin_at_zero() {
        assert_eq!(labels(&durations(60.0, 4)), ["0", "15 s", "30 s", "45 s", "1 min"]);
        assert_eq!(labels(&durations(100.0, 4)), ["0", "30 s", "1 min", "1:30 min"]);
        assert_eq!(labels(&durations(2.6 * 3600.0, 6)), ["0", "30 min", "1 h", "1:30 h", "2 h", "2:30 h"]);
        assert_eq!(labels(&durations(3.0 * DAY, 3)), ["0", "1 d", "2 d", "3 d"]);
        assert_eq!(labels(&divisions(300.0, 9)), ["0", "1 min", "2 min", "3 min", "4 min", "5 min"]);
        assert_eq!(labels(&divisions(900.0, 5)), ["0", "5 min", "10 min", "15 min"]);
        assert_eq!(labels(&divisions(7.0 * DAY, 3)), ["0", "7 d"]);
    }

    #[test]
    fn time_ticks_are_round() {
        let noon = 1_700_000_000.0 - 1_700_000_000.0 % DAY + DAY / 2.0;
        assert_eq!(
            labels(&times(noon, noon + 3600.0, 6)),
            ["12:00", "12:10", "12:20", "12:30", "12:40", "12:50", "13:00"]
        );
        assert_eq!(
            labels(&times(noon + 1.0, noon + 11.0, 5)),
            ["12:00:02", "12:00:04", "12:00:06", "12:00:08", "12:00:10"]
        );
        assert_eq!(labels(&times(noon, noon + DAY, 4)), ["12:00", "18:00", "Nov 15", "06:00", "12:00"]);
        assert!(times(noon, noon + 400.0 * DAY, 8).len() <= 9);
    }
}
