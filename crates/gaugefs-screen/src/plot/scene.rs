// SPDX-License-Identifier: MIT

//! The layout: a title, a strip with each gauge's status, and panels with a common time axis.

use std::borrow::Cow;
use std::collections::HashSet;

use super::super::thin::thin;
use super::super::ticks::{self, Tick};
use super::Limit;
use super::table::{Flow, Gauge, History, Panel};
use gaugefs_host::error::{Cause, Error, Result};

/// Font size, and an upper bound for the average width of letters.
pub(super) const SIZE: f64 = 12.0;
const LETTER: f64 = 7.2;
const MARGIN: f64 = 16.0;
/// Space for the title, for a line below it, and for a gauge's strip.
const HEAD: f64 = 28.0;
const FACTS: f64 = 16.0;
const STRIP: f64 = 14.0;
/// Space for a panel's title above it, for clock and elapsed time below the last panel, and for a line of the legend.
const TITLE: f64 = 34.0;
const TIMES: f64 = 48.0;
const LEGEND: f64 = 20.0;
/// Default and minimum height of a panel.
const USUAL: f64 = 140.0;
const LEAST: f64 = 40.0;
/// Names of the rows with times, left of them.
const CLOCK: &str = "UTC";
const ELAPSED: &str = "elapsed";

const INK: [u8; 3] = [0x24, 0x29, 0x2f];
const FAINT: [u8; 3] = [0x6e, 0x77, 0x81];
const GRID: [u8; 3] = [0xd8, 0xdc, 0xe1];
const ZERO: [u8; 3] = [0x8c, 0x95, 0x9f];
/// Distinguishable with colour vision deficiency too (Okabe and Ito).
const COLOURS: [[u8; 3]; 7] = [
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0xe6, 0x9f, 0x00],
    [0x56, 0xb4, 0xe9],
    [0x55, 0x55, 0x55],
];
/// Colours of a status in its strip and behind the lines, and its name in the legend.
const STATUS: [(&str, &str, [u8; 3], [u8; 3]); 4] = [
    ("Charging", "charging", [0x7b, 0xc8, 0x8f], [0xee, 0xf8, 0xf1]),
    ("Discharging", "discharging", [0xf2, 0xb3, 0x6b], [0xfe, 0xf6, 0xeb]),
    ("Not charging", "no current", [0xc8, 0xcf, 0xd6], [0xff, 0xff, 0xff]),
    ("Full", "full", [0x8f, 0xb8, 0xe8], [0xf0, 0xf5, 0xfc]),
];
const OTHER: (&str, &str, [u8; 3], [u8; 3]) = ("", "another status", [0xb9, 0xa5, 0xd6], [0xf6, 0xf2, 0xfb]);
const NOTHING: [u8; 3] = [0xff, 0xff, 0xff];
/// The capacity range with a flag set, the more urgent last.
const LOW: [[u8; 3]; 2] = [[0xfb, 0xe3, 0xa6], [0xf6, 0xb8, 0xb0]];
const OUTSIDE: [u8; 3] = [0xf9, 0xd5, 0xd0];
const BORDER: [u8; 3] = [0xc0, 0x39, 0x2b];

/// The part of a text at its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    Plain,
    Bold,
    Title,
}

#[derive(Clone, Debug)]
pub(super) enum Shape {
    Area { from: (f64, f64), to: (f64, f64), colour: [u8; 3] },
    Line { points: Vec<(f64, f64)>, colour: [u8; 3], width: f64, dashed: bool },
    Dot { at: (f64, f64), colour: [u8; 3], radius: f64 },
    Text { at: (f64, f64), text: String, colour: [u8; 3], anchor: Anchor, style: Style },
}

#[derive(Debug)]
pub(super) struct Scene {
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) shapes: Vec<Shape>,
}

struct Times {
    left: f64,
    right: f64,
    from: f64,
    to: f64,
    marks: Vec<Tick>,
}

impl Times {
    fn x(&self, time: f64) -> f64 {
        self.left + (time - self.from) / (self.to - self.from) * (self.right - self.left)
    }
}

/// The area of a panel's values.
struct Frame {
    top: f64,
    bottom: f64,
    low: f64,
    high: f64,
    ticks: Vec<Tick>,
}

impl Frame {
    fn y(&self, value: f64) -> f64 {
        self.bottom - (value - self.low) / (self.high - self.low) * (self.bottom - self.top)
    }
}

/// An entry of the legend.
struct Key {
    mark: Mark,
    text: String,
}

enum Mark {
    Area([u8; 3]),
    Line([u8; 3]),
    /// A series, by its number in its panel.
    Series(usize),
    Dot,
}

/// The line style of a series: after the last colour, they repeat with dashes.
fn colour_of(number: usize) -> ([u8; 3], bool) {
    (COLOURS[number % COLOURS.len()], number / COLOURS.len() % 2 == 1)
}

/// Whether the names of a panel's series fit beside its title; otherwise they are in the legend.
fn names_fit(panel: &Panel, width: f64) -> bool {
    let letters: usize = labels(panel).map(|label| label.chars().count()).sum();
    letters as f64 * LETTER + panel.series.len() as f64 * 40.0 <= width - 300.0
}

/// Lays out a history. The default height depends on the number of panels.
pub(super) fn lay_out(history: &History, limits: &[Limit], width: u16, height: Option<u16>) -> Result<Scene> {
    let History { panels, gauges } = history;
    let (width, count) = (f64::from(width), panels.len() as f64);
    for limit in limits {
        let is_drawn = |panel: &Panel| panel.series.iter().any(|series| series.column == limit.column);
        if !panels.iter().any(is_drawn) {
            let why = format!("`{}` is not drawn; name it in --columns, too", limit.column);
            return Err(Error::new("--limit", Cause::Invalid, why));
        }
    }
    let keys = legend(history, limits, width);
    let facts = facts(gauges, width - 2.0 * MARGIN);
    let head = HEAD + facts.len() as f64 * FACTS;
    let lines = rows_of(&keys, width - 2.0 * MARGIN);
    let strips = gauges.iter().filter(|gauge| !gauge.stretches.is_empty()).count() as f64 * STRIP;
    let around = 2.0 * MARGIN + head + strips + TIMES + lines.len() as f64 * LEGEND + count * TITLE;
    let height = height.map_or(around + count * USUAL, f64::from);
    let each = (height - around) / count;
    if each < LEAST {
        let least = (around + count * LEAST).ceil();
        let why = format!("{count} panels need a height of {least} pixels");
        return Err(Error::new("--height", Cause::OutOfRange, why));
    }
    let above = MARGIN + head + strips;
    let frames: Vec<_> = (0..)
        .zip(panels)
        .map(|(at, panel)| {
            let top = above + f64::from(at) * (each + TITLE) + TITLE;
            frame(panel, limits, top, top + each)
        })
        .collect();
    let many = gauges.iter().filter(|gauge| !gauge.stretches.is_empty()).count() > 1;
    let names = gauges.iter().filter(|_| many).map(|gauge| gauge.name.chars().count());
    let labels = frames.iter().flat_map(|frame| &frame.ticks).map(|(_, label)| label.chars().count());
    let letters = labels.chain(names).chain([ELAPSED.len()]).max().unwrap_or(0).min(16);
    let left = MARGIN + letters as f64 * LETTER + 8.0;
    let right = width - MARGIN - 3.0 * LETTER;

    let (from, to) = bounds(gauges);
    // A single poll is in the middle.
    let (from, to) = if to - from < 1.0 { (from - 0.5, to + 0.5) } else { (from, to) };
    let room = ((right - left) / (11.0 * LETTER)) as usize;
    let times = Times { left, right, from, to, marks: ticks::times(from, to, room) };

    let mut shapes = Vec::new();
    title(&mut shapes, gauges, &facts, width);
    let top = MARGIN + head;
    let base = height - MARGIN - TIMES - lines.len() as f64 * LEGEND;
    if let [gauge] = &gauges[..] {
        for frame in &frames {
            tints(&mut shapes, gauge, &times, (frame.top, frame.bottom), false);
        }
    }
    for (at, gauge) in gauges.iter().filter(|gauge| !gauge.stretches.is_empty()).enumerate() {
        let top = top + at as f64 * STRIP;
        tints(&mut shapes, gauge, &times, (top, top + STRIP - 3.0), true);
        let name: String = if many { gauge.name.chars().take(16).collect() } else { "status".into() };
        text(&mut shapes, (left - 8.0, top + STRIP - 4.0), &name, FAINT, Anchor::End);
    }
    for (at, (panel, frame)) in panels.iter().zip(&frames).enumerate() {
        let named = names_fit(panel, width);
        draw(&mut shapes, panel, (at, named), frame, &times, gauges, limits);
    }
    axis_of_times(&mut shapes, &times, base, room);
    for (at, row) in lines.iter().enumerate() {
        draw_keys(&mut shapes, row, (MARGIN, base + TIMES + (at as f64 + 0.5) * LEGEND));
    }
    Ok(Scene { width, height, shapes })
}

fn bounds(gauges: &[Gauge]) -> (f64, f64) {
    let start = (f64::INFINITY, f64::NEG_INFINITY);
    gauges.iter().fold(start, |(from, to), gauge| (from.min(gauge.from), to.max(gauge.to)))
}

/// The lines below the title: dates, span, charge and energy.
fn facts(gauges: &[Gauge], width: f64) -> Vec<String> {
    let (from, to) = bounds(gauges);
    let (first, last) = (ticks::utc(from, "%Y-%m-%d %H:%M:%S"), ticks::utc(to, "%Y-%m-%d %H:%M:%S"));
    let last = if first.get(..10) == last.get(..10) { last.get(11..).unwrap_or_default() } else { &last };
    let mut facts = vec![format!("{first} \u{2013} {last} UTC"), lasted(to - from)];
    if let [Gauge { flow: Some(flow), .. }] = gauges {
        facts.extend(flowed(flow));
    }
    let mut lines: Vec<String> = Vec::new();
    for fact in facts {
        match lines.last_mut() {
            Some(line) if ((line.chars().count() + fact.chars().count() + 3) as f64) * LETTER <= width => {
                *line += " \u{b7} ";
                *line += &fact;
            }
            _ => lines.push(fact),
        }
    }
    lines
}

fn title(shapes: &mut Vec<Shape>, gauges: &[Gauge], facts: &[String], width: f64) {
    let head = match gauges {
        [gauge] => {
            let part = Some(gauge.part.clone()).filter(|part| !part.is_empty());
            let serial = Some(&gauge.serial).filter(|serial| !serial.is_empty());
            let serial = serial.map(|serial| format!("serial number {serial}"));
            let words = [Some(gauge.name.clone()), part, serial];
            words.into_iter().flatten().collect::<Vec<_>>().join(" \u{b7} ")
        }
        _ => {
            let name = |gauge: &Gauge| match gauge.part.as_str() {
                "" => gauge.name.clone(),
                part => format!("{} ({part})", gauge.name),
            };
            gauges.iter().map(name).collect::<Vec<_>>().join(", ")
        }
    };
    let at = (MARGIN, MARGIN + 14.0);
    let head = cut(&head, width - 2.0 * MARGIN, 10.5);
    shapes.push(Shape::Text { at, text: head, colour: INK, anchor: Anchor::Start, style: Style::Title });
    for (at, fact) in facts.iter().enumerate() {
        let at = (MARGIN, MARGIN + 32.0 + at as f64 * FACTS);
        text(shapes, at, &cut(fact, width - 2.0 * MARGIN, LETTER), FAINT, Anchor::Start);
    }
}

/// A text, cut to fit.
fn cut(text: &str, width: f64, letter: f64) -> String {
    let room = (width / letter) as usize;
    if text.chars().count() <= room {
        return text.into();
    }
    text.chars().take(room.saturating_sub(1)).chain(['\u{2026}']).collect()
}

/// A duration in its two largest units.
fn lasted(seconds: f64) -> String {
    let whole = seconds.round() as i64;
    let (days, hours, minutes) = (whole / 86_400, whole / 3600 % 24, whole / 60 % 60);
    match () {
        () if days > 0 => format!("{days} d {hours} h"),
        () if hours > 0 => format!("{hours} h {minutes} min"),
        () if minutes > 0 => format!("{minutes} min {} s", whole % 60),
        () => format!("{whole} s"),
    }
}

/// The flow in each direction with any.
fn flowed(flow: &Flow) -> Vec<String> {
    let one = |word: &str, charge: f64, energy: Option<f64>| {
        let energy = energy.map(|energy| format!(", {energy:.2} Wh")).unwrap_or_default();
        (charge >= 0.0005).then(|| format!("{word} {charge:.3} Ah{energy}"))
    };
    let energies = flow.energy;
    let out = one("discharged", flow.discharged, energies.map(|(_, discharged)| discharged));
    let into = one("charged", flow.charged, energies.map(|(charged, _)| charged));
    out.into_iter().chain(into).collect()
}

fn status_of(status: &str) -> &'static (&'static str, &'static str, [u8; 3], [u8; 3]) {
    STATUS.iter().find(|known| known.0 == status).unwrap_or(&OTHER)
}

/// A gauge's status as areas: a strip, or behind the lines.
fn tints(shapes: &mut Vec<Shape>, gauge: &Gauge, times: &Times, (top, bottom): (f64, f64), strip: bool) {
    for stretch in &gauge.stretches {
        let colour = match &stretch.status {
            Some(status) => {
                let (.., dark, light) = status_of(status);
                if strip { *dark } else { *light }
            }
            None => NOTHING,
        };
        if colour != NOTHING {
            let (from, to) = ((times.x(stretch.from), top), (times.x(stretch.to), bottom));
            shapes.push(Shape::Area { from, to, colour });
        }
    }
}

/// What the picture contains and no panel's title explains.
fn legend(history: &History, limits: &[Limit], width: f64) -> Vec<Key> {
    let mut keys: Vec<Key> = Vec::new();
    let mut seen = HashSet::new();
    for panel in history.panels.iter().filter(|panel| panel.series.len() > 1 && !names_fit(panel, width)) {
        for (at, name) in labels(panel).enumerate() {
            if seen.insert((at, name.clone())) {
                keys.push(Key { mark: Mark::Series(at), text: name.into() });
            }
        }
    }
    let mut add = |mark: Mark, text: &str| keys.push(Key { mark, text: text.into() });
    let stretches = || history.gauges.iter().flat_map(|gauge| &gauge.stretches);
    for known in STATUS.iter().chain([&OTHER]) {
        let shown =
            |status: &String| std::ptr::eq(status_of(status), known) || status_of(status).1 == known.1;
        if stretches().any(|stretch| stretch.status.as_ref().is_some_and(shown)) {
            add(Mark::Area(known.2), known.1);
        }
    }
    let panels = &history.panels;
    let has = |column: &str| panels.iter().any(|panel| panel.series.iter().any(|one| one.column == column));
    if has("capacity") && history.gauges.len() == 1 {
        for (at, (flag, percent)) in history.gauges[0].low.iter().enumerate() {
            add(Mark::Area(LOW[at]), &format!("[{flag}] set by the gauge, up to {percent} %"));
        }
    }
    if !limits.is_empty() {
        add(Mark::Area(OUTSIDE), "outside of the limits");
    }
    let lines = || panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.lines);
    if panels.iter().any(crosses_zero) {
        add(Mark::Line(ZERO), "zero");
    }
    if lines().any(|line| line.len() == 1) {
        add(Mark::Dot, "a single poll");
    }
    let broken = panels.iter().flat_map(|panel| &panel.series).any(|series| series.lines.len() > 1);
    if broken || stretches().any(|stretch| stretch.status.is_none()) {
        add(Mark::Area(NOTHING), "no line: absent, or not recorded");
    }
    keys
}

fn rows_of(keys: &[Key], width: f64) -> Vec<Vec<&Key>> {
    let mut rows: Vec<Vec<&Key>> = Vec::new();
    let mut left = 0.0;
    for key in keys {
        let length = length(key);
        match rows.last_mut().filter(|_| length <= left) {
            Some(row) => row.push(key),
            None => {
                rows.push(vec![key]);
                left = width;
            }
        }
        left -= length;
    }
    rows
}

fn length(key: &Key) -> f64 {
    22.0 + key.text.chars().count() as f64 * LETTER + 14.0
}

fn draw_keys(shapes: &mut Vec<Shape>, keys: &[&Key], (left, middle): (f64, f64)) {
    let mut x = left;
    for key in keys {
        let (from, to) = ((x, middle - 5.0), (x + 16.0, middle + 5.0));
        match key.mark {
            Mark::Area(colour) => {
                shapes.push(Shape::Area { from, to, colour });
                let corners = vec![from, (to.0, from.1), to, (from.0, to.1), from];
                shapes.push(Shape::Line { points: corners, colour: GRID, width: 1.0, dashed: false });
            }
            Mark::Line(colour) => {
                let points = vec![(x, middle), (x + 16.0, middle)];
                shapes.push(Shape::Line { points, colour, width: 1.0, dashed: false });
            }
            Mark::Series(number) => {
                let (points, (colour, dashed)) = (vec![(x, middle), (x + 18.0, middle)], colour_of(number));
                shapes.push(Shape::Line { points, colour, width: 3.0, dashed });
            }
            Mark::Dot => shapes.push(Shape::Dot { at: (x + 8.0, middle), colour: INK, radius: 2.0 }),
        }
        text(shapes, (x + 22.0, middle + SIZE * 0.35), &key.text, INK, Anchor::Start);
        x += length(key);
    }
}

/// The clock, and below it the time since the start.
fn axis_of_times(shapes: &mut Vec<Shape>, times: &Times, base: f64, room: usize) {
    for (name, row) in [(CLOCK, 17.0), (ELAPSED, 39.0)] {
        // At the edge, away from the first time.
        text(shapes, (MARGIN, base + row), name, FAINT, Anchor::Start);
    }
    for (time, label) in &times.marks {
        text(shapes, (times.x(*time), base + 17.0), label, INK, Anchor::Middle);
    }
    let top = sharp(base + 23.0);
    let mut line = |points| shapes.push(Shape::Line { points, colour: ZERO, width: 1.0, dashed: false });
    line(vec![(times.left, top), (times.right, top)]);
    let durations = ticks::durations(times.to - times.from, room);
    for (passed, _) in &durations {
        let x = sharp(times.x(times.from + passed));
        line(vec![(x, top), (x, top + 4.0)]);
    }
    for (passed, label) in &durations {
        text(shapes, (times.x(times.from + passed), base + 39.0), label, INK, Anchor::Middle);
    }
}

fn values(panel: &Panel) -> impl Iterator<Item = f64> + '_ {
    panel.series.iter().flat_map(|series| series.lines.iter().flatten().map(|(_, value)| *value))
}

/// Whether zero matters in a panel: current and power flow in two directions.
fn has_zero(panel: &Panel) -> bool {
    ["A", "mA", "W", "mW"].contains(&panel.unit.as_str())
}

fn crosses_zero(panel: &Panel) -> bool {
    has_zero(panel) || (values(panel).any(|value| value < 0.0) && values(panel).any(|value| value > 0.0))
}

fn frame(panel: &Panel, limits: &[Limit], top: f64, bottom: f64) -> Frame {
    let of_panel = |limit: &&Limit| panel.series.iter().any(|series| series.column == limit.column);
    let limits = limits.iter().filter(of_panel).flat_map(|limit| [limit.low, limit.high]).flatten();
    let zero = has_zero(panel).then_some(0.0);
    let all: Vec<_> = values(panel).chain(limits).chain(zero).collect();
    let low = all.iter().copied().fold(f64::INFINITY, f64::min);
    let high = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    // A minimum span, so that noise of one step does not fill the panel.
    let least = match panel.unit.as_str() {
        "V" | "A" | "Ah" => 0.02,
        "%" => 4.0,
        "°C" => 2.0,
        _ => 1.0,
    };
    let (low, high, ticks) = ticks::numbers(low, high, least, ((bottom - top) / 26.0) as usize);
    Frame { top, bottom, low, high, ticks }
}

/// Lines of one pixel are sharp at half coordinates.
fn sharp(at: f64) -> f64 {
    at.floor() + 0.5
}

fn text(shapes: &mut Vec<Shape>, at: (f64, f64), text: &str, colour: [u8; 3], anchor: Anchor) {
    shapes.push(Shape::Text { at, text: text.to_string(), colour, anchor, style: Style::Plain });
}

/// Names of a panel's series: column, gauge or both, whatever differs.
fn labels(panel: &Panel) -> impl DoubleEndedIterator<Item = Cow<'_, str>> + ExactSizeIterator {
    let first = &panel.series[0];
    let one_gauge = panel.series.iter().all(|other| other.gauge == first.gauge);
    let one_column = panel.series.iter().all(|other| other.column == first.column);
    panel.series.iter().map(move |series| match (one_gauge, one_column) {
        (true, _) => series.column.as_str().into(),
        (false, true) => series.gauge.as_str().into(),
        (false, false) => format!("{} {}", series.gauge, series.column).into(),
    })
}

/// Ranges of a panel with a meaning: beyond a limit, or with a flag of low charge.
fn bands(
    shapes: &mut Vec<Shape>,
    panel: &Panel,
    frame: &Frame,
    times: &Times,
    gauges: &[Gauge],
    limits: &[Limit],
) {
    let mut area = |low: f64, high: f64, colour| {
        let (low, high) = (low.max(frame.low), high.min(frame.high));
        if low < high {
            let (from, to) = ((times.left, frame.y(high)), (times.right, frame.y(low)));
            shapes.push(Shape::Area { from, to, colour });
        }
    };
    let has = |column: &str| panel.series.iter().any(|series| series.column == column);
    if let (true, [gauge]) = (has("capacity"), gauges) {
        for (at, (_, percent)) in gauge.low.iter().enumerate() {
            area(f64::NEG_INFINITY, *percent, LOW[at]);
        }
    }
    let mut borders = Vec::new();
    for limit in limits.iter().filter(|limit| has(&limit.column)) {
        limit.low.into_iter().for_each(|low| area(f64::NEG_INFINITY, low, OUTSIDE));
        limit.high.into_iter().for_each(|high| area(high, f64::INFINITY, OUTSIDE));
        borders.extend([limit.low, limit.high].into_iter().flatten());
    }
    for value in borders {
        let y = sharp(frame.y(value));
        let points = vec![(times.left, y), (times.right, y)];
        shapes.push(Shape::Line { points, colour: BORDER, width: 1.0, dashed: true });
    }
}

fn draw(
    shapes: &mut Vec<Shape>,
    panel: &Panel,
    (number, named): (usize, bool),
    frame: &Frame,
    times: &Times,
    gauges: &[Gauge],
    limits: &[Limit],
) {
    let &Frame { top, bottom, .. } = frame;
    let &Times { left, right, from, to, .. } = times;
    bands(shapes, panel, frame, times, gauges, limits);
    let mut line = |points, colour, width| shapes.push(Shape::Line { points, colour, width, dashed: false });
    for (time, _) in &times.marks {
        line(vec![(sharp(times.x(*time)), top), (sharp(times.x(*time)), bottom)], GRID, 1.0);
    }
    for (value, _) in &frame.ticks {
        line(vec![(left, sharp(frame.y(*value))), (right, sharp(frame.y(*value)))], GRID, 1.0);
    }
    line(vec![(left, top), (left, bottom)], FAINT, 1.0);
    line(vec![(left, sharp(bottom)), (right, sharp(bottom))], FAINT, 1.0);
    if crosses_zero(panel) {
        line(vec![(left, sharp(frame.y(0.0))), (right, sharp(frame.y(0.0)))], ZERO, 1.0);
    }
    for (value, label) in &frame.ticks {
        text(shapes, (left - 8.0, frame.y(*value) + SIZE * 0.35), label, INK, Anchor::End);
    }

    let column = &panel.series[0].column;
    let one_column = panel.series.iter().all(|series| series.column == *column);
    let title = match (one_column, panel.unit.as_str()) {
        (true, "") => column.clone(),
        (true, unit) => format!("{column} ({unit})"),
        (false, unit) => unit.to_string(),
    };
    let many = panel.series.len() > 1;
    // Panels with one line each have different colours.
    let colour = |at: usize| colour_of(if many { at } else { number });
    let mut start = left;
    if !many {
        let points = vec![(left, top - 11.0), (left + 18.0, top - 11.0)];
        let (colour, dashed) = colour(0);
        shapes.push(Shape::Line { points, colour, width: 3.0, dashed });
        start += 24.0;
    }
    let at = (start, top - 7.0);
    shapes.push(Shape::Text { at, text: title, colour: INK, anchor: Anchor::Start, style: Style::Bold });

    let mut legend = right;
    for ((at, series), name) in panel.series.iter().enumerate().rev().zip(labels(panel).rev()) {
        let (colour, dashed) = colour(at);
        if many && named {
            let length = name.chars().count() as f64 * LETTER;
            text(shapes, (legend, top - 7.0), &name, INK, Anchor::End);
            let points = vec![(legend - length - 24.0, top - 11.0), (legend - length - 6.0, top - 11.0)];
            shapes.push(Shape::Line { points, colour, width: 3.0, dashed });
            legend -= length + 40.0;
        }
        for line in &series.lines {
            let thinned = thin(line, from, to - from, (right - left) as usize);
            let points: Vec<_> =
                thinned.iter().map(|(time, value)| (times.x(*time), frame.y(*value))).collect();
            shapes.push(match points[..] {
                [at] => Shape::Dot { at, colour, radius: 2.0 },
                _ => Shape::Line { points, colour, width: 1.8, dashed },
            });
        }
    }
}
