// SPDX-License-Identifier: MIT

//! The screen as SVG, cell by cell. A test draws docs/top.svg with it; `GAUGEFS_GOLDEN=write` draws the picture anew.

use std::fmt::Write;

use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};

const WIDTH: f64 = 8.4;
const HEIGHT: f64 = 17.0;
const MARGIN: f64 = 12.0;
const PAPER: &str = "#1b1f24";
const INK: &str = "#d7dce2";

pub(crate) fn svg(buffer: &Buffer) -> String {
    let area = buffer.area;
    let (width, height) =
        (f64::from(area.width) * WIDTH + 2.0 * MARGIN, f64::from(area.height) * HEIGHT + 2.0 * MARGIN);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" \
         height=\"{height:.0}\" font-family=\"ui-monospace, 'DejaVu Sans Mono', Menlo, Consolas, monospace\" \
         font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" rx=\"8\" fill=\"{PAPER}\"/>\n"
    );
    for row in 0..area.height {
        let mut column = 0;
        while column < area.width {
            let first = &buffer[(area.x + column, area.y + row)];
            let same =
                |cell: &Cell| cell.style() == first.style() && dots(cell).is_some() == dots(first).is_some();
            let run: Vec<_> = (column..area.width)
                .map(|column| &buffer[(area.x + column, area.y + row)])
                .take_while(|cell| same(cell))
                .collect();
            stretch(&mut svg, &run, MARGIN + f64::from(column) * WIDTH, MARGIN + f64::from(row) * HEIGHT);
            column += run.len() as u16;
        }
    }
    svg += "</svg>\n";
    svg
}

/// Renders neighbouring cells of one style. Writing to a String does not fail.
fn stretch(svg: &mut String, run: &[&Cell], x: f64, y: f64) {
    let (mut ink, mut paper) = (colour(run[0].fg), behind(run[0].bg));
    if run[0].modifier.contains(Modifier::REVERSED) {
        (ink, paper) = (paper, ink);
    }
    if paper != PAPER {
        let width = run.len() as f64 * WIDTH;
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{HEIGHT}\" fill=\"{paper}\"/>"
        );
    }
    // Few fonts have braille as wide as letters, so the dots are drawn.
    if dots(run[0]).is_some() {
        let mut path = String::new();
        for (at, bits) in run.iter().enumerate().filter_map(|(at, cell)| Some((at, dots(cell)?))) {
            let places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)];
            for (_, (column, line)) in places.iter().enumerate().filter(|(bit, _)| bits >> bit & 1 == 1) {
                let x = x + (at as f64 + 0.25 + 0.5 * f64::from(*column)) * WIDTH;
                let y = y + (0.125 + 0.25 * f64::from(*line)) * HEIGHT;
                let _ = write!(path, "M{x:.1} {y:.1}h0");
            }
        }
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" stroke=\"{ink}\" stroke-width=\"3\" stroke-linecap=\"round\"/>"
        );
        return;
    }
    let symbols: Vec<&str> = run.iter().map(|cell| cell.symbol()).collect();
    let bold = if run[0].modifier.contains(Modifier::BOLD) { " font-weight=\"bold\"" } else { "" };
    let base = y + 0.76 * HEIGHT;
    // Each word has its own position, because viewers differ in the width of spaces.
    let mut at = 0;
    for piece in symbols.chunk_by(|a, b| *a != " " || *b != " ") {
        let text = piece.concat().replace('&', "&amp;").replace('<', "&lt;");
        let before = piece.iter().take_while(|symbol| **symbol == " ").count();
        let text = text.trim();
        if !text.is_empty() {
            let x = x + (at + before) as f64 * WIDTH;
            let width = text.replace("&amp;", "&").replace("&lt;", "<").chars().count() as f64 * WIDTH;
            let _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{base:.1}\" textLength=\"{width:.1}\" fill=\"{ink}\"{bold}>{text}</text>"
            );
        }
        at += piece.len();
    }
}

fn dots(cell: &Cell) -> Option<u32> {
    let letter = u32::from(cell.symbol().chars().next()?);
    (0x2801..=0x28ff).contains(&letter).then(|| letter - 0x2800)
}

pub(crate) fn behind(paper: Color) -> String {
    if paper == Color::Reset { PAPER.into() } else { colour(paper) }
}

pub(crate) fn colour(colour: Color) -> String {
    let of_theme = match colour {
        // xterm's cube: six steps of each colour.
        Color::Indexed(index @ 16..=231) => {
            let step = |place: u8| [0, 95, 135, 175, 215, 255][usize::from((index - 16) / place % 6)];
            return format!("#{:02x}{:02x}{:02x}", step(36), step(6), step(1));
        }
        Color::Red => "#ff7b72",
        Color::Green => "#7ee787",
        Color::Yellow => "#e3b341",
        Color::Cyan => "#56d4dd",
        Color::DarkGray => "#7d8590",
        Color::Black => PAPER,
        _ => INK,
    };
    of_theme.into()
}
