// SPDX-License-Identifier: MIT

//! Draws the screen, at any size; 40 columns and 10 lines are enough.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Margin, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{
    Axis, Block, Cell, Chart, Dataset, GraphType, Paragraph, Row, Table, TableState, Wrap,
};

use super::super::decimal::decimal;
use super::super::learning::line;
use super::super::ticks;
use super::super::wrap::wrapped;
use super::history::Quantity;
use super::model::{Gauge, Model};
use gaugefs_client::check;
use gaugefs_client::sample::Sample;
use gaugefs_client::watch::learned_parameters;
use ti_gauge::chip::{Chip, snake_case};

/// Keys, most important first: a narrow screen has room for a few.
const KEYS: [(&str, &str); 9] = [
    ("q", "quit"),
    ("?", "help"),
    ("l", "learning"),
    ("v i c t a", "quantity"),
    ("+ -", "span"),
    ("arrows", "gauge"),
    ("p", "pause"),
    ("r", "poll"),
    ("d", "data flash"),
];

/// A grid point, in the same script as the lines.
const GRID: &str = "\u{2802}";

/// Parts of register names that show the progress of learning; these come first.
const LEARNING: [&str; 6] = ["passed", "qmax", "true", "dod", "accumulated", "unfiltered"];

const HELP: &str = "\
q        quit
arrows   select another gauge; tab too
v i c t  voltage, current, capacity, temperature
a        all of them, where the screen has room
+ -      longer or shorter time span
l        state of learning: learned values, registers, recent changes
         (+QEN: the bit was set; -VOK: it was cleared)
p        pause the screen; polls go on and are recorded
r        poll the gauge now
d        read the learned values from data flash, once: a sealed gauge is
         unsealed and sealed again. While l shows them and the gauge is
         unsealed anyway, they are read once a minute.

Only r and these reads cause bus traffic.";

pub(super) fn screen(frame: &mut Frame<'_>, model: &Model, now: f64) {
    let area = frame.area();
    // Most of the screen is for the selected gauge.
    let rows = model.gauges.len().clamp(1, usize::from(area.height / 4).max(1)) as u16;
    let [title, table, body, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(rows + 1),
        Constraint::Min(0),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(headline(model, now, title.width), title);
    gauges(frame, model, now, table);
    if model.help {
        let help = Paragraph::new(HELP).wrap(Wrap { trim: false });
        frame.render_widget(help.block(Block::new().title("Help").title_style(bold())), body);
    } else if let Some(gauge) = model.gauge() {
        selected_gauge(frame, model, gauge, now, body);
    }
    frame.render_widget(bottom(model, keys.width), keys);
}

fn bold() -> Style {
    Style::new().add_modifier(Modifier::BOLD)
}

/// One of the terminal's sixteen colours, if colours are enabled.
fn coloured(model: &Model, colour: Color) -> Style {
    if model.colour { Style::new().fg(colour) } else { Style::new() }
}

fn headline(model: &Model, now: f64, width: u16) -> Line<'static> {
    let time = jiff::Timestamp::from_second(model.paused.unwrap_or(now) as i64).unwrap_or_default();
    let paused = if model.paused.is_some() { "  paused" } else { "" };
    let count = match model.gauges.len() {
        1 => "1 gauge".to_string(),
        count => format!("gauge {} of {count}", model.selected + 1),
    };
    let left = format!("gaugefs top  {count}{paused}");
    let time = time.to_string();
    let gap = usize::from(width).saturating_sub(left.len() + time.len());
    if gap < 2 {
        return Line::styled(left, bold());
    }
    Line::from(vec![Span::styled(left, bold()), Span::raw(" ".repeat(gap) + &time)])
}

fn bottom(model: &Model, width: u16) -> Line<'static> {
    if !model.message.is_empty() {
        return Line::styled(model.message.clone(), coloured(model, Color::Yellow));
    }
    let mut spans = Vec::new();
    let mut left = usize::from(width);
    for (key, does) in KEYS {
        let gap = if spans.is_empty() { 0 } else { 2 };
        let length = gap + key.len() + 1 + does.len();
        if length > left {
            break;
        }
        left -= length;
        spans.push(Span::raw(" ".repeat(gap)));
        spans.push(Span::styled(key, bold()));
        spans.push(Span::raw(format!(" {does}")));
    }
    Line::from(spans)
}

struct Column {
    title: &'static str,
    /// Minimum width, so that columns stay in place while values change.
    width: usize,
    right: bool,
    /// Columns of higher ranks are left out first.
    rank: u8,
}

const fn column(title: &'static str, width: usize, right: bool, rank: u8) -> Column {
    Column { title, width, right, rank }
}

const COLUMNS: [Column; 11] = [
    column("GAUGE", 6, false, 0),
    column("MODEL", 11, false, 7),
    column("STATUS", 12, false, 1),
    column("V", 5, true, 3),
    column("A", 6, true, 4),
    column("Ah", 11, true, 8),
    column("CHARGE", 10, false, 6),
    column("%", 3, true, 2),
    column("°C", 4, true, 5),
    column("TIME", 15, true, 9),
    column("SEAL", 11, false, 10),
];
/// The columns with colours.
const STATUS: usize = 2;
const CHARGE: usize = 6;
const PERCENT: usize = 7;
type Texts = [String; COLUMNS.len()];
/// Blocks of a bar on a screen of that many columns, and on others.
const WIDE: (u16, usize) = (120, 20);
const BLOCKS: usize = 10;
const GAP: usize = 2;

/// Widths of the columns that fit, and 0 for the others.
fn widths(rows: &[Texts], width: usize) -> [usize; COLUMNS.len()] {
    let widest = |at: usize| rows.iter().map(|row| row[at].chars().count()).max().unwrap_or(0);
    let wanted: [usize; COLUMNS.len()] = std::array::from_fn(|at| widest(at).max(COLUMNS[at].width));
    let mut ranked: Vec<_> = (1..COLUMNS.len()).collect();
    ranked.sort_by_key(|&at| COLUMNS[at].rank);
    let mut widths = [0; COLUMNS.len()];
    // A long name is cut before it takes a value's place.
    let name = wanted[0].min((width / 4).max(COLUMNS[0].width));
    let mut left = width.saturating_sub(name);
    for at in ranked {
        if wanted[at] + GAP > left {
            break;
        }
        widths[at] = wanted[at];
        left -= wanted[at] + GAP;
    }
    widths[0] = wanted[0].min(name + left);
    widths
}

fn gauges(frame: &mut Frame<'_>, model: &Model, now: f64, area: Rect) {
    let blocks = if area.width >= WIDE.0 { WIDE.1 } else { BLOCKS };
    let (mut rows, colours): (Vec<_>, Vec<_>) =
        model.gauges.iter().map(|gauge| cells(model, gauge, now, blocks)).unzip();
    for (row, gauge) in rows.iter_mut().zip(&model.gauges) {
        row[0] = label(model, gauge);
    }
    let widths = widths(&rows, area.width.into());
    let row = |texts: Texts, style: &dyn Fn(usize) -> Style| {
        let cells = texts.into_iter().enumerate().filter(|(at, _)| widths[*at] > 0);
        Row::new(cells.map(|(at, text)| {
            let line = Line::styled(cut(text, widths[at]), style(at));
            Cell::from(if COLUMNS[at].right { line.alignment(Alignment::Right) } else { line })
        }))
    };
    let header = row(COLUMNS.map(|column| column.title.to_string()), &|_| bold());
    let rows = rows.into_iter().zip(colours).enumerate().map(|(number, (texts, colour))| {
        let is_selected = number == model.selected && model.gauges.len() > 1;
        row(texts, &|at| match at {
            // Reversing the whole row would invert its bar.
            0 if is_selected => Style::new().add_modifier(Modifier::REVERSED),
            STATUS => coloured(model, colour.status),
            CHARGE | PERCENT => colour.charge(model),
            _ => Style::new(),
        })
    });
    let lengths = widths.iter().filter(|width| **width > 0).map(|width| Constraint::Length(*width as u16));
    let table = Table::new(rows, lengths).column_spacing(GAP as u16).header(header);
    let mut state = TableState::new().with_selected(Some(model.selected).filter(|_| model.gauges.len() > 1));
    frame.render_stateful_widget(table, area, &mut state);
}

/// The end of a text, which is the informative part of a path.
fn cut(text: String, width: usize) -> String {
    let over = text.chars().count().saturating_sub(width);
    if over == 0 { text } else { "\u{2026}".chars().chain(text.chars().skip(over + 1)).collect() }
}

/// A gauge's name, or its folder if the name is not unique.
fn label(model: &Model, gauge: &Gauge) -> String {
    let name = gauge.name();
    let alike = model.gauges.iter().filter(|other| other.name() == name).count();
    if alike > 1 { gauge.folder.display().to_string() } else { name }
}

struct Colours {
    status: Color,
    level: Option<Level>,
}

/// The gauge's own judgement of its charge.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Level {
    Enough,
    Low,
    Critical,
}

impl Level {
    fn of(sample: &Sample) -> Option<Self> {
        match sample.attribute("capacity_level")? {
            "Critical" => Some(Self::Critical),
            "Low" => Some(Self::Low),
            "Normal" | "High" | "Full" => Some(Self::Enough),
            _ => None,
        }
    }

    /// For a screen without colours.
    fn word(self) -> Option<&'static str> {
        match self {
            Self::Enough => None,
            Self::Low => Some("charge low"),
            Self::Critical => Some("charge critical"),
        }
    }
}

impl Colours {
    fn charge(&self, model: &Model) -> Style {
        match self.level {
            None => Style::new(),
            Some(Level::Enough) => coloured(model, Color::Green),
            Some(Level::Low) => coloured(model, Color::Yellow).add_modifier(Modifier::BOLD),
            Some(Level::Critical) => coloured(model, Color::Red).add_modifier(Modifier::BOLD),
        }
    }
}

/// A bar, with at least one block unless it is empty.
fn bar(percent: i64, blocks: usize) -> String {
    let percent = percent.clamp(0, 100) as usize;
    let filled = ((percent * blocks + 50) / 100).max(usize::from(percent > 0));
    "\u{2588}".repeat(filled) + &"\u{2591}".repeat(blocks - filled)
}

/// A gauge's row without its name, and its colours.
fn cells(model: &Model, gauge: &Gauge, now: f64, blocks: usize) -> (Texts, Colours) {
    let mut row = Texts::default();
    let mut colours = Colours { status: Color::Red, level: None };
    if model.silence(gauge, now).is_some() {
        row[STATUS] = "no answer".into();
        return (row, colours);
    }
    let Some(sample) = &gauge.shown else {
        row[STATUS] = if gauge.trouble.is_some() { "gone" } else { "..." }.into();
        return (row, colours);
    };
    let millionths = |name, places| sample.number(name).map(|value| rounded(value, 6, places));
    row[1] = sample.attribute("model_name").unwrap_or_default().into();
    row[STATUS] = sample.status();
    row[3] = millionths("voltage_now", 3).unwrap_or_default();
    row[4] = millionths("current_now", 3).unwrap_or_default();
    let charge = millionths("charge_now", 3).zip(millionths("charge_full", 3));
    row[5] = charge.map(|(now, full)| format!("{now}/{full}")).unwrap_or_default();
    let percent = sample.number("capacity");
    row[CHARGE] = percent.map(|value| bar(value, blocks)).unwrap_or_default();
    row[PERCENT] = percent.map(|value| value.to_string()).unwrap_or_default();
    row[8] = sample.number("temp").map(|value| decimal(value, 1, 1)).unwrap_or_default();
    row[9] = time_left(sample).unwrap_or_default();
    row[10] = sample.seal.clone().unwrap_or_default();
    colours.status = match row[STATUS].as_str() {
        "Charging" | "Full" => Color::Green,
        "absent" => Color::Red,
        _ => Color::Reset,
    };
    colours.level = Level::of(sample);
    (row, colours)
}

/// An integer in units of 10^-`places`, rounded to `wanted` places.
fn rounded(value: i64, places: usize, wanted: usize) -> String {
    let step = 10i64.pow((places - wanted) as u32);
    let half = if value < 0 { -step / 2 } else { step / 2 };
    decimal(value.saturating_add(half) / step, wanted, wanted)
}

fn time_left(sample: &Sample) -> Option<String> {
    let clock = |seconds: i64| format!("{}:{:02}", seconds / 3600, seconds / 60 % 60);
    let empty = sample.number("time_to_empty_now").map(|seconds| format!("{} h to empty", clock(seconds)));
    empty.or_else(|| Some(format!("{} h to full", clock(sample.number("time_to_full_now")?))))
}

/// The selected gauge: details, chart and state of learning.
fn selected_gauge(frame: &mut Frame<'_>, model: &Model, gauge: &Gauge, now: f64, area: Rect) {
    let details = details(model, gauge, now, area.width);
    let height = details.len().min(usize::from(if area.height >= 12 { 7 } else { area.height / 4 })) as u16;
    let [top, rest] = Layout::vertical([Constraint::Length(height), Constraint::Min(0)]).areas(area);
    frame.render_widget(Paragraph::new(details), top);
    let wide = area.width >= 120;
    if model.learning && wide {
        let [left, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Length(66)]).areas(rest);
        charts(frame, model, gauge, now, left);
        let right = right.inner(Margin { horizontal: 1, vertical: 0 });
        learning(frame, gauge, now, right);
    } else if model.learning {
        learning(frame, gauge, now, rest);
    } else {
        charts(frame, model, gauge, now, rest);
    }
}

/// The details as text, the most urgent first.
fn details(model: &Model, gauge: &Gauge, now: f64, width: u16) -> Vec<Line<'static>> {
    let warn = coloured(model, Color::Red).add_modifier(Modifier::BOLD);
    let mut lines = Vec::new();
    if let Some(silent) = model.silence(gauge, now) {
        let why = format!("{}: no answer for {silent:.0} s", gauge.folder.display());
        lines.extend(wrapped(&why, width.into()).into_iter().map(|line| Line::styled(line, warn)));
        return lines;
    }
    if let Some(why) = &gauge.trouble {
        let why = format!("{}: {why}", gauge.folder.display());
        lines.extend(wrapped(&why, width.into()).into_iter().map(|line| Line::styled(line, warn)));
    }
    let Some(sample) = &gauge.shown else { return lines };
    let mut facts = Vec::new();
    let polled = (model.paused.unwrap_or(now) - super::history::seconds(sample.time)).max(0.0);
    facts.push(if sample.moment.is_some() { format!("polled {polled:.0} s ago") } else { "absent".into() });
    facts.extend(Level::of(sample).and_then(Level::word).map(String::from));
    facts.extend(sample.seal.clone());
    facts.extend(time_left(sample));
    facts.extend(sample.attribute("health").map(|health| format!("health {}", health)));
    facts.extend(sample.number("cycle_count").map(|count| format!("{count} cycles")));
    facts.extend(sample.number("state_of_health").map(|percent| format!("state of health {percent} %")));
    let mut line = String::new();
    for fact in facts {
        let gap = if line.is_empty() { "" } else { ", " };
        if line.chars().count() + gap.len() + fact.chars().count() <= usize::from(width) {
            line += gap;
            line += &fact;
        }
    }
    lines.push(Line::raw(line));
    let widest = sample.words.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    for (name, bits) in &sample.words {
        let name = Span::styled(format!("{name:widest$}  "), bold());
        let bits = if bits.is_empty() { "-" } else { bits };
        lines.push(Line::from(vec![name, Span::raw(bits.to_string())]));
    }
    let error = Some(&sample.last_error).filter(|error| !error.is_empty());
    let error = error.map(|error| format!("last error: {error}"));
    let found = |found: Option<String>| found.map(|found| format!("check: {found}"));
    let (wrong, doubtful) = (found(check::wrong(&sample.check)), found(check::doubtful(&sample.check)));
    for (text, color) in [(doubtful, Color::Yellow), (error, Color::Red), (wrong, Color::Red)] {
        let text = text.map_or_else(Vec::new, |text| wrapped(&text, width.into()));
        let at = usize::from(lines.len() > 1);
        for line in text.into_iter().take(2).rev() {
            lines.insert(at, Line::styled(line, coloured(model, color)));
        }
    }
    lines
}

/// A chart of this size shows as much as a larger one.
const CHART: (u16, u16) = (50, 9);

/// Charts of all quantities if there is room, otherwise of one.
fn charts(frame: &mut Frame<'_>, model: &Model, gauge: &Gauge, now: f64, area: Rect) {
    let has_room = |columns: &u16| area.width / columns >= CHART.0 && area.height / (4 / columns) >= CHART.1;
    let columns = [2, 1].into_iter().find(has_room).filter(|_| model.quantity.is_none());
    let Some(columns) = columns else {
        return chart(frame, model, gauge, now, model.quantity.unwrap_or(Quantity::VOLTAGE), area);
    };
    let split = |layout: Layout, area: Rect| layout.spacing(GAP as u16).split(area).to_vec();
    let rows = Layout::vertical(vec![Constraint::Fill(1); usize::from(4 / columns)]).split(area);
    let cells = rows
        .iter()
        .flat_map(|row| split(Layout::horizontal(vec![Constraint::Fill(1); usize::from(columns)]), *row));
    for (quantity, cell) in Quantity::ALL.into_iter().zip(cells) {
        chart(frame, model, gauge, now, quantity, cell);
    }
}

fn chart(frame: &mut Frame<'_>, model: &Model, gauge: &Gauge, now: f64, quantity: Quantity, area: Rect) {
    if area.height < 3 || area.width < 20 {
        return;
    }
    let now = model.paused.unwrap_or(now);
    let (span, words) = model.span();
    // A column has two columns of braille dots.
    let past = model.past(gauge);
    let lines = gauge.history.lines(past, quantity, now, span, usize::from(area.width) * 2);
    let title = format!("{} in {}, last {words}", quantity.name(), quantity.unit());
    let block = Block::new().title(title).title_style(bold());
    let values = || lines.iter().flatten().map(|(_, value)| *value);
    if values().next().is_none() {
        let text = if gauge.shown.is_some() { "nothing to draw yet" } else { "" };
        frame.render_widget(Paragraph::new(text).block(block), area);
        return;
    }
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    // A low screen has no room for times.
    let timed = area.height >= 7;
    let height = usize::from(area.height) - if timed { 3 } else { 1 };
    let (low, high, marks) = ticks::numbers(low, high, quantity.least_span(), (height / 3).clamp(1, 9));
    let shown = if marks.len() * 2 <= height + 1 {
        &marks[..]
    } else {
        &[marks[0].clone(), marks[marks.len() - 1].clone()]
    };
    let labels: Vec<_> = shown.iter().map(|(_, label)| Line::raw(label.clone())).collect();
    let width = labels.iter().map(Line::width).max().unwrap_or(0).min(usize::from(area.width / 3)) as u16;
    let style = coloured(model, Color::Cyan);
    let sets = lines.iter().map(|line| {
        let kind = if line.len() > 1 { GraphType::Line } else { GraphType::Scatter };
        Dataset::default().marker(Marker::Braille).graph_type(kind).style(style).data(line)
    });
    // The chart makes room for time labels, but would spread them evenly instead of at their places.
    let room = if timed { vec![""; 2] } else { Vec::new() };
    let axes = coloured(model, Color::DarkGray);
    let chart = Chart::new(sets.collect())
        .block(block)
        .x_axis(Axis::default().bounds([-span, 0.0]).labels(room).style(axes))
        .y_axis(
            Axis::default().bounds([low, high]).labels(labels).style(axes).labels_alignment(Alignment::Right),
        );
    frame.render_widget(chart, area);
    let graph = Rect::new(area.x + width + 1, area.y + 1, area.width - width - 1, height as u16);
    let rows = (0..shown.len()).map(|at| graph.bottom() - 1 - (at * (height - 1) / (shown.len() - 1)) as u16);
    if timed {
        grid(frame, graph, &rows.collect::<Vec<_>>(), span, area.x, axes);
    }
}

/// The grid where a chart has drawn nothing, and below it as many times as fit from the column `left` on, at their
/// places.
fn grid(frame: &mut Frame<'_>, graph: Rect, rows: &[u16], span: f64, left: u16, style: Style) {
    let times = ticks::divisions(span, usize::from(graph.width / 11));
    let place = |ago: f64| graph.right() - 1 - (ago / span * f64::from(graph.width - 1)).round() as u16;
    let columns: Vec<_> = times.iter().map(|(ago, _)| place(*ago)).collect();
    let buffer = frame.buffer_mut();
    for y in graph.top()..graph.bottom() {
        for x in graph.left()..graph.right() {
            let on_row = rows.contains(&y) && (x - graph.left()).is_multiple_of(2);
            let on_column = columns.contains(&x) && x > graph.left();
            let cell = &mut buffer[(x, y)];
            if (on_row || on_column) && cell.symbol() == " " {
                cell.set_symbol(GRID).set_style(style);
            }
        }
    }
    for ((ago, label), x) in times.iter().zip(columns) {
        let label = if *ago == 0.0 { "now".to_string() } else { format!("-{label}") };
        let length = label.chars().count() as u16;
        let start = x.saturating_sub(length / 2).clamp(left, graph.right().saturating_sub(length).max(left));
        buffer.set_string(start, graph.bottom() + 1, label, style);
    }
}

/// The state of learning: learned values if read, registers, and recent changes.
fn learning(frame: &mut Frame<'_>, gauge: &Gauge, now: f64, area: Rect) {
    let Some(sample) = &gauge.shown else { return };
    let mut lines = vec![];
    let heading = |text: String| Line::styled(text, bold());
    if let Some(state) = gauge.shown_state.as_ref().filter(|_| area.height >= 8) {
        lines.push(heading("Cycle".into()));
        lines.extend(wrapped(&line(state), area.width.into()).into_iter().map(Line::raw));
    }
    let model_name = sample.attribute("model_name").unwrap_or_default();
    let known = !learned_parameters(model_name).is_empty();
    let why = match (&gauge.learned, gauge.unsealed()) {
        (Some(Ok(_)), Some(true)) => "read once a minute while unsealed",
        (Some(Ok(_)), _) => "d reads them again, which unseals and seals the gauge",
        (Some(Err(why)), _) => why.as_str(),
        (None, _) if !known => "no learned parameter of this part is known",
        (None, Some(true)) => "unsealed: reading",
        (None, Some(false)) => "sealed: not read; d reads them once, which unseals and seals the gauge",
        (None, None) => "not read; the owner of the mount can press d",
    };
    let age = gauge.learned_at.map(|at| format!(", {:.0} s ago", (now - at).max(0.0))).unwrap_or_default();
    lines.push(heading(format!("Learned (data flash){age}")));
    // On a low screen the values need the line.
    if area.height >= 8 || !matches!(gauge.learned, Some(Ok(_))) {
        lines.extend(wrapped(why, area.width.into()).into_iter().map(Line::raw));
    }
    let mut cells = Vec::new();
    if let Some(Ok(rows)) = &gauge.learned {
        cells.extend(
            rows.iter().map(|row| (row.name.to_string(), format!("{} {}", row.value, unit(row.unit)))),
        );
    }
    lines.extend(columns(&cells, area.width));
    lines.push(heading("Registers".into()));
    let (mut first, others): (Vec<_>, Vec<_>) =
        registers(model_name, sample).partition(|(name, _)| LEARNING.iter().any(|word| name.contains(word)));
    first.extend(others);
    lines.extend(columns(&first, area.width));
    // Changes get the remaining lines, and at least a few.
    let room = usize::from(area.height);
    let least = (room / 3).min(gauge.changes.len().max(1) + 1);
    lines.truncate(room.saturating_sub(least));
    lines.push(heading("Changes".into()));
    for (time, change) in &gauge.changes {
        let time = jiff::Timestamp::from_second(*time as i64).unwrap_or_default().to_string();
        let clock = time.get(11..19).unwrap_or_default();
        lines.push(Line::raw(format!("{clock}  {change}")));
    }
    if gauge.changes.is_empty() {
        lines.push(Line::raw("none since top was started"));
    }
    frame.render_widget(Paragraph::new(lines), area);
}

/// Registers that no attribute shows, with units.
fn registers<'a>(model: &str, sample: &'a Sample) -> impl Iterator<Item = (String, String)> + 'a {
    let table = Chip::by_model(model).map_or(&[][..], |chip| chip.registers);
    sample.registers.iter().filter_map(move |(name, value)| {
        let row = table.iter().find(|row| snake_case(row.name) == *name);
        let shown = row.is_some_and(|row| row.role.is_some());
        let unit = row.map_or("", |row| unit(row.unit));
        (!shown).then(|| (name.replace('_', " "), format!("{value} {unit}")))
    })
}

/// Leaves out units that mean nothing.
fn unit(unit: &str) -> &str {
    if ["-", "Num", "num", "hex", "Hex"].contains(&unit) { "" } else { unit }
}

/// Names and values in as many columns as fit.
fn columns(cells: &[(String, String)], width: u16) -> Vec<Line<'static>> {
    let name = cells.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let value = cells.iter().map(|(_, value)| value.trim_end().chars().count()).max().unwrap_or(0);
    let count = ((usize::from(width) + 3) / (name + value + 4)).max(1);
    let rows = cells.len().div_ceil(count);
    let cell = |at: usize| cells.get(at).map(|(key, text)| format!("{key:name$} {:value$}", text.trim_end()));
    // Row by row, so that the list's end is what does not fit.
    (0..rows)
        .map(|row| {
            let across: Vec<_> = (0..count).filter_map(|column| cell(row * count + column)).collect();
            Line::raw(across.join("   "))
        })
        .collect()
}
