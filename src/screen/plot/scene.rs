//! The layout: panels one below the other, with one time axis.

use super::super::thin::thin;
use super::table::{Panel, Series};
use super::ticks::{self, Tick};
use crate::error::{Cause, Error, Result};

/// Size of letters, and an upper bound for their average width.
pub(super) const SIZE: f64 = 12.0;
const LETTER: f64 = 7.2;
const MARGIN: f64 = 16.0;
/// Space above each panel for its title, and below the last one for the times.
const TITLE: f64 = 36.0;
const TIMES: f64 = 44.0;
/// A panel's default height, and its minimum.
const USUAL: f64 = 150.0;
const LEAST: f64 = 40.0;

const INK: [u8; 3] = [0x24, 0x29, 0x2f];
const FAINT: [u8; 3] = [0x6e, 0x77, 0x81];
const GRID: [u8; 3] = [0xe4, 0xe7, 0xeb];
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

/// Which part of a text is at its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Something to draw.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    Line { points: Vec<(f64, f64)>, colour: [u8; 3], width: f64 },
    Dot { at: (f64, f64), colour: [u8; 3], radius: f64 },
    Text { at: (f64, f64), text: String, colour: [u8; 3], anchor: Anchor, bold: bool },
}

/// A picture, in pixels.
#[derive(Debug)]
pub(super) struct Scene {
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) shapes: Vec<Shape>,
}

/// Where a panel's values are drawn.
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

/// Lays panels out as a picture. The default height depends on their number.
pub(super) fn lay_out(panels: &[Panel], width: u16, height: Option<u16>) -> Result<Scene> {
    let width = f64::from(width);
    let count = panels.len() as f64;
    let around = 2.0 * MARGIN + TIMES + count * TITLE;
    let height = height.map_or(around + count * USUAL, f64::from);
    let each = (height - around) / count;
    if each < LEAST {
        let least = (around + count * LEAST).ceil();
        let why = format!("{count} panels need a height of {least} pixels");
        return Err(Error::new("--height", Cause::OutOfRange(why)));
    }
    let axes: Vec<_> = panels.iter().map(|panel| axis(panel, each)).collect();
    let letters = axes.iter().flat_map(|(.., ticks)| ticks).map(|(_, label)| label.chars().count()).max();
    let left = MARGIN + letters.unwrap_or(0) as f64 * LETTER + 8.0;
    let right = width - MARGIN - 3.0 * LETTER;

    let times = || points(panels).map(|(time, _)| time);
    let (from, to) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
    // A single poll is in the middle.
    let (from, to) = if to - from < 1.0 { (from - 0.5, to + 0.5) } else { (from, to) };
    let marks = ticks::times(from, to, ((right - left) / (11.0 * LETTER)) as usize);

    let mut shapes = Vec::new();
    for (at, (panel, axis)) in panels.iter().zip(&axes).enumerate() {
        let top = MARGIN + at as f64 * (each + TITLE) + TITLE;
        let frame = Frame { left, right, top, bottom: top + each };
        draw(&mut shapes, panel, at, axis, &frame, (from, to), &marks);
    }
    let base = height - MARGIN - TIMES;
    let place = |time: f64| left + (time - from) / (to - from) * (right - left);
    for (time, label) in &marks {
        text(&mut shapes, (place(*time), base + 18.0), label, FAINT, Anchor::Middle);
    }
    let (first, last) = (ticks::utc(from, "%Y-%m-%d"), ticks::utc(to, "%Y-%m-%d"));
    let day = if first == last { first } else { format!("{first} \u{2013} {last}") };
    text(&mut shapes, (right, height - MARGIN), &format!("{day}, UTC"), FAINT, Anchor::End);
    let mut gauges: Vec<_> =
        panels.iter().flat_map(|panel| &panel.series).map(|series| &*series.gauge).collect();
    gauges.dedup();
    if gauges.iter().all(|gauge| *gauge == gauges[0]) {
        text(&mut shapes, (left, height - MARGIN), gauges[0], FAINT, Anchor::Start);
    }
    Ok(Scene { width, height, shapes })
}

fn points(panels: &[Panel]) -> impl Iterator<Item = (f64, f64)> + '_ {
    panels.iter().flat_map(values)
}

fn values(panel: &Panel) -> impl Iterator<Item = (f64, f64)> + '_ {
    panel.series.iter().flat_map(|series| series.lines.iter().flatten().copied())
}

fn axis(panel: &Panel, height: f64) -> (f64, f64, Vec<Tick>) {
    let values = || values(panel).map(|(_, value)| value);
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    // A minimum span, so that noise of one step does not fill the panel.
    let least = match panel.unit.as_str() {
        "V" | "A" | "Ah" => 0.02,
        "%" => 4.0,
        "°C" => 2.0,
        _ => 1.0,
    };
    ticks::numbers(low, high, least, (height / 34.0) as usize)
}

fn text(shapes: &mut Vec<Shape>, at: (f64, f64), text: &str, colour: [u8; 3], anchor: Anchor) {
    shapes.push(Shape::Text { at, text: text.to_string(), colour, anchor, bold: false });
}

/// Names a series by its column, its gauge or both: by whatever differs within the panel.
fn label(series: &Series, panel: &Panel) -> String {
    let one_gauge = panel.series.iter().all(|other| other.gauge == series.gauge);
    let one_column = panel.series.iter().all(|other| other.column == series.column);
    match (one_gauge, one_column) {
        (true, _) => series.column.clone(),
        (false, true) => series.gauge.clone(),
        (false, false) => format!("{} {}", series.gauge, series.column),
    }
}

fn draw(
    shapes: &mut Vec<Shape>,
    panel: &Panel,
    number: usize,
    axis: &(f64, f64, Vec<Tick>),
    frame: &Frame,
    (from, to): (f64, f64),
    marks: &[Tick],
) {
    let Frame { left, right, top, bottom } = *frame;
    let (low, high, ticks) = axis;
    let x = |time: f64| left + (time - from) / (to - from) * (right - left);
    // Lines of one pixel are sharp at half coordinates.
    let sharp = |at: f64| at.floor() + 0.5;
    let y = |value: f64| bottom - (value - low) / (high - low) * (bottom - top);
    let mut line =
        |points: Vec<(f64, f64)>, colour, width| shapes.push(Shape::Line { points, colour, width });
    for (time, _) in marks {
        line(vec![(sharp(x(*time)), top), (sharp(x(*time)), bottom)], GRID, 1.0);
    }
    for (value, _) in ticks {
        line(vec![(left, sharp(y(*value))), (right, sharp(y(*value)))], GRID, 1.0);
    }
    line(vec![(left, sharp(bottom)), (right, sharp(bottom))], FAINT, 1.0);
    for (value, label) in ticks {
        text(shapes, (left - 8.0, y(*value) + SIZE * 0.35), label, FAINT, Anchor::End);
    }

    let column = &panel.series[0].column;
    let one_column = panel.series.iter().all(|series| series.column == *column);
    let title = match (one_column, panel.unit.as_str()) {
        (true, "") => column.clone(),
        (true, unit) => format!("{column} ({unit})"),
        (false, unit) => unit.to_string(),
    };
    let at = (left, top - 9.0);
    shapes.push(Shape::Text { at, text: title, colour: INK, anchor: Anchor::Start, bold: true });

    let many = panel.series.len() > 1;
    let mut legend = right;
    for (at, series) in panel.series.iter().enumerate().rev() {
        // If each panel has one line, each panel has its own colour.
        let colour = COLOURS[if many { at } else { number } % COLOURS.len()];
        if many {
            let name = label(series, panel);
            let length = name.chars().count() as f64 * LETTER;
            text(shapes, (legend, top - 9.0), &name, INK, Anchor::End);
            let line = vec![(legend - length - 24.0, top - 13.0), (legend - length - 6.0, top - 13.0)];
            shapes.push(Shape::Line { points: line, colour, width: 3.0 });
            legend -= length + 40.0;
        }
        for line in &series.lines {
            let thinned = thin(line, from, to - from, (right - left) as usize);
            let points: Vec<_> = thinned.iter().map(|(time, value)| (x(*time), y(*value))).collect();
            shapes.push(match points[..] {
                [at] => Shape::Dot { at, colour, radius: 2.0 },
                _ => Shape::Line { points, colour, width: 1.8 },
            });
        }
    }
}
