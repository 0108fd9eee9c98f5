//! Draws the screen, at any size; 40 columns and 10 lines are enough.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Margin, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{
    Axis, Block, Cell, Chart, Dataset, GraphType, Paragraph, Row, Table, TableState, Wrap,
};

use super::super::learning::line;
use super::super::sample::{Sample, decimal};
use super::super::watch::learned_parameters;
use super::model::{Gauge, Model};
use ti_gauge::chip::{Chip, snake_case};

/// Keys, the most important first: a narrow screen has room for a few.
const KEYS: [(&str, &str); 9] = [
    ("q", "quit"),
    ("?", "help"),
    ("l", "learning"),
    ("v i c t", "quantity"),
    ("+ -", "span"),
    ("arrows", "gauge"),
    ("p", "pause"),
    ("r", "poll"),
    ("d", "data flash"),
];

/// Parts of the names of registers that show the progress of learning; these are listed first.
const LEARNING: [&str; 6] = ["passed", "qmax", "true", "dod", "accumulated", "unfiltered"];

const HELP: &str = "\
q        quit
arrows   select another gauge; tab too
v i c t  voltage, current, capacity, temperature
+ -      longer or shorter time span
l        state of learning: learned values, registers, recent changes
         (+QEN: the bit was set; -VOK: it was cleared)
p        pause the screen; polls go on and are recorded
r        poll the gauge now
d        read the learned values from data flash, once: a sealed gauge is
         unsealed and sealed again. While l shows them and the gauge is
         unsealed anyway, they are read once a minute.

Only r and these reads cause bus traffic.";

/// Draws everything.
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

/// One of the sixteen colours of the terminal, if colours are enabled.
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

/// A column of the table: title, width, minimum width of the screen, whether right-aligned.
const COLUMNS: [(&str, u16, u16, bool); 10] = [
    ("GAUGE", 0, 0, false),
    ("MODEL", 12, 60, false),
    ("STATUS", 12, 0, false),
    ("V", 6, 0, true),
    ("A", 7, 0, true),
    ("Ah", 13, 72, true),
    ("%", 4, 0, true),
    ("°C", 5, 50, true),
    ("TIME", 15, 94, true),
    ("SEAL", 11, 106, false),
];

fn gauges(frame: &mut Frame<'_>, model: &Model, now: f64, area: Rect) {
    let wanted: Vec<_> = COLUMNS.iter().map(|(_, _, least, _)| area.width >= *least).collect();
    let keep = |cells: Vec<Cell<'static>>| {
        let shown = cells.into_iter().zip(&wanted).filter(|(_, wanted)| **wanted);
        Row::new(shown.map(|(cell, _)| cell).collect::<Vec<_>>())
    };
    let aligned = |at: usize, text: String, style: Style| {
        let line = Line::styled(text, style);
        let line = if COLUMNS[at].3 { line.alignment(Alignment::Right) } else { line };
        Cell::from(line)
    };
    let titles = COLUMNS.iter().enumerate();
    let header = keep(titles.map(|(at, column)| aligned(at, column.0.into(), bold())).collect());
    // The width that the other columns leave, at most that of the longest name.
    let others: u16 =
        COLUMNS.iter().zip(&wanted).filter(|(_, wanted)| **wanted).map(|(column, _)| column.1 + 1).sum();
    let longest =
        model.gauges.iter().map(|gauge| label(model, gauge).chars().count()).max().unwrap_or(0) as u16;
    let first = longest.max(6).min((area.width + 1).saturating_sub(others)).max(4);
    let widths = COLUMNS.iter().zip(&wanted).filter(|(_, wanted)| **wanted);
    let widths: Vec<_> =
        widths.map(|(column, _)| Constraint::Length(if column.1 == 0 { first } else { column.1 })).collect();
    let cut = |name: String| {
        let over = name.chars().count().saturating_sub(usize::from(first));
        // The end of a path says more than its beginning.
        if over == 0 { name } else { "\u{2026}".chars().chain(name.chars().skip(over + 1)).collect() }
    };
    let rows = model.gauges.iter().enumerate().map(|(number, gauge)| {
        let (mut texts, colour) = cells(model, gauge, now);
        // The row of the selected gauge is reversed, so its status has no colour.
        let plain = number == model.selected && model.gauges.len() > 1;
        texts[0] = cut(label(model, gauge));
        let style = |at: usize| if at == 2 && !plain { coloured(model, colour) } else { Style::new() };
        keep(texts.into_iter().enumerate().map(|(at, text)| aligned(at, text, style(at))).collect())
    });
    let table = Table::new(rows, widths)
        .header(header)
        .row_highlight_style(Style::new().add_modifier(Modifier::REVERSED));
    let mut state = TableState::new().with_selected(Some(model.selected).filter(|_| model.gauges.len() > 1));
    frame.render_stateful_widget(table, area, &mut state);
}

/// A gauge's name, or its folder if another gauge has the same name.
fn label(model: &Model, gauge: &Gauge) -> String {
    let name = gauge.name();
    let alike = model.gauges.iter().filter(|other| other.name() == name).count();
    if alike > 1 { gauge.folder.display().to_string() } else { name }
}

/// A gauge's row except for its name, and the colour of its status.
fn cells(model: &Model, gauge: &Gauge, now: f64) -> ([String; 10], Color) {
    let mut row: [String; 10] = Default::default();
    if model.silence(gauge, now).is_some() {
        row[2] = "no answer".into();
        return (row, Color::Red);
    }
    let Some(sample) = &gauge.shown else {
        row[2] = if gauge.trouble.is_some() { "gone" } else { "..." }.into();
        return (row, Color::Red);
    };
    let millionths = |name, places| sample.number(name).map(|value| rounded(value, 6, places));
    row[1] = sample.attribute("model_name").unwrap_or_default().into();
    row[2] = sample.status();
    row[3] = millionths("voltage_now", 3).unwrap_or_default();
    row[4] = millionths("current_now", 3).unwrap_or_default();
    let charge = millionths("charge_now", 3).zip(millionths("charge_full", 3));
    row[5] = charge.map(|(now, full)| format!("{now}/{full}")).unwrap_or_default();
    row[6] = sample.number("capacity").map(|value| value.to_string()).unwrap_or_default();
    row[7] = sample.number("temp").map(|value| decimal(value, 1, 1)).unwrap_or_default();
    row[8] = time_left(sample).unwrap_or_default();
    row[9] = sample.seal.clone().unwrap_or_default();
    let colour = match row[2].as_str() {
        "Charging" | "Full" => Color::Green,
        "Discharging" => Color::Yellow,
        "absent" => Color::Red,
        _ => Color::Reset,
    };
    (row, colour)
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
        chart(frame, model, gauge, now, left);
        let right = right.inner(Margin { horizontal: 1, vertical: 0 });
        learning(frame, gauge, now, right);
    } else if model.learning {
        learning(frame, gauge, now, rest);
    } else {
        chart(frame, model, gauge, now, rest);
    }
}

/// The details as text, the most urgent first.
fn details(model: &Model, gauge: &Gauge, now: f64, width: u16) -> Vec<Line<'static>> {
    let warn = coloured(model, Color::Red).add_modifier(Modifier::BOLD);
    let mut lines = Vec::new();
    if let Some(silent) = model.silence(gauge, now) {
        let why = format!("{}: no answer for {silent:.0} s", gauge.folder.display());
        lines.extend(wrapped(&why, width).into_iter().map(|line| Line::styled(line, warn)));
        return lines;
    }
    if let Some(why) = &gauge.trouble {
        let why = format!("{}: {why}", gauge.folder.display());
        lines.extend(wrapped(&why, width).into_iter().map(|line| Line::styled(line, warn)));
    }
    let Some(sample) = &gauge.shown else { return lines };
    let mut facts = Vec::new();
    let polled = (model.paused.unwrap_or(now) - super::history::seconds(sample.time)).max(0.0);
    facts.push(if sample.moment.is_some() { format!("polled {polled:.0} s ago") } else { "absent".into() });
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
    if !sample.last_error.is_empty() {
        let text = wrapped(&format!("last error: {}", sample.last_error), width);
        let at = usize::from(lines.len() > 1);
        for line in text.into_iter().take(2).rev() {
            lines.insert(at, Line::styled(line, coloured(model, Color::Red)));
        }
    }
    lines
}

/// Breaks a text into lines of the width of the screen.
fn wrapped(text: &str, width: u16) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let line = lines.last_mut().expect("there is at least one line");
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > usize::from(width) {
            lines.push(word.to_string());
        } else {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines
}

fn chart(frame: &mut Frame<'_>, model: &Model, gauge: &Gauge, now: f64, area: Rect) {
    if area.height < 3 || area.width < 20 {
        return;
    }
    let now = model.paused.unwrap_or(now);
    let quantity = model.quantity;
    let (span, words) = model.span();
    // Each column has two columns of braille dots.
    let lines = gauge.history.lines(quantity, now, span, usize::from(area.width) * 2);
    let title = format!("{} in {}, last {words}", quantity.name(), quantity.unit());
    let block = Block::new().title(title).title_style(bold());
    let values = || lines.iter().flatten().map(|(_, value)| *value);
    if values().next().is_none() {
        let text = if gauge.shown.is_some() { "nothing to draw yet" } else { "" };
        frame.render_widget(Paragraph::new(text).block(block), area);
        return;
    }
    let (bounds, places) = axis(values(), quantity.least_span());
    let label = |value: f64| Line::raw(format!("{value:.places$}"));
    let middle = (bounds[0] + bounds[1]) / 2.0;
    let mut labels = vec![label(bounds[0]), label(bounds[1])];
    if area.height >= 8 {
        labels.insert(1, label(middle));
    }
    let style = coloured(model, Color::Cyan);
    let sets = lines.iter().map(|line| {
        let kind = if line.len() > 1 { GraphType::Line } else { GraphType::Scatter };
        Dataset::default().marker(Marker::Braille).graph_type(kind).style(style).data(line)
    });
    // A low screen has no room for the times.
    let ago = if area.height < 7 { Vec::new() } else { vec![format!("-{words}"), "now".to_string()] };
    let axes = coloured(model, Color::DarkGray);
    let chart = Chart::new(sets.collect())
        .block(block)
        .x_axis(Axis::default().bounds([-span, 0.0]).labels(ago).style(axes))
        .y_axis(Axis::default().bounds(bounds).labels(labels).style(axes));
    frame.render_widget(chart, area);
}

/// Round bounds that enclose all values, and the number of decimal places that they need.
fn axis(values: impl Iterator<Item = f64> + Clone, least: f64) -> ([f64; 2], usize) {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    let middle = (low + high) / 2.0;
    let half = ((high - low) / 2.0).max(least / 2.0);
    let raw = half / 2.0;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power).into_iter().find(|step| *step >= raw);
    let step = step.unwrap_or(10.0 * power);
    let bounds = [((middle - half) / step).floor() * step, ((middle + half) / step).ceil() * step];
    // The label in the middle is half a step from a round number.
    let places = (-(step / 2.0).log10()).ceil().clamp(0.0, 6.0) as usize;
    (bounds, places)
}

/// The state of learning: learned values, if they were read, registers, and recent changes.
fn learning(frame: &mut Frame<'_>, gauge: &Gauge, now: f64, area: Rect) {
    let Some(sample) = &gauge.shown else { return };
    let mut lines = vec![];
    let heading = |text: String| Line::styled(text, bold());
    if let Some(state) = gauge.shown_state.as_ref().filter(|_| area.height >= 8) {
        lines.push(heading("Cycle".into()));
        lines.extend(wrapped(&line(state), area.width).into_iter().map(Line::raw));
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
        lines.extend(wrapped(why, area.width).into_iter().map(Line::raw));
    }
    let mut cells = Vec::new();
    if let Some(Ok(rows)) = &gauge.learned {
        cells.extend(
            rows.iter().map(|row| (row.name.to_string(), format!("{} {}", row.value, unit(row.unit)))),
        );
    }
    lines.extend(columns(&cells, area.width));
    lines.push(heading("Registers".into()));
    let mut registers: Vec<_> = registers(model_name, sample).collect();
    registers.sort_by_key(|(name, _)| !LEARNING.iter().any(|word| name.contains(word)));
    lines.extend(columns(&registers, area.width));
    // Changes get the remaining lines, and always a few.
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
    let table = Chip::all().find(|chip| chip.model == model).map_or(&[][..], |chip| chip.registers);
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
    // Row by row, so that what does not fit is the end of the list.
    (0..rows)
        .map(|row| {
            let across: Vec<_> = (0..count).filter_map(|column| cell(row * count + column)).collect();
            Line::raw(across.join("   "))
        })
        .collect()
}
