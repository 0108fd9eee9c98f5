// SPDX-License-Identifier: MIT

//! Draws the fields. A state has a word, a sign and a colour, so that each alone is enough.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::border;
use ratatui::text::Line;
use ratatui::widgets::{Block, Paragraph, Wrap};

use super::super::wrap::wrapped;
use super::{Field, Model};
use gaugefs_host::sign::Sign;

/// A field of this width has its word and sign in large letters.
const WIDE: u16 = 34;
/// Lines of a large word, and of a field with one.
const LARGE: u16 = 5;
const HIGH: u16 = LARGE + FRAME + 1;
const FRAME: u16 = 2;
/// Columns of a sign with text beside it.
const BESIDE: u16 = 8;

// From the 240 colours that no terminal theme changes: among the sixteen others, text may be as bright as its
// background.
const BLACK: Color = Color::Indexed(16);
const WHITE: Color = Color::Indexed(231);
const RED: Color = Color::Indexed(160);
const GREEN: Color = Color::Indexed(77);
const YELLOW: Color = Color::Indexed(220);
const CYAN: Color = Color::Indexed(80);

const ASCII: border::Set<'static> = border::Set {
    top_left: "+",
    top_right: "+",
    bottom_left: "+",
    bottom_right: "+",
    vertical_left: "|",
    vertical_right: "|",
    horizontal_top: "-",
    horizontal_bottom: "-",
};

/// A terminal of this height has room for a message of two lines.
const TALL: u16 = 24;
/// Lines of a question with the typed text. Without a question, the message has them.
const QUESTION: u16 = 2;

/// Draws everything. Returns whether a text is shown in parts, so that the next part must follow.
pub(super) fn screen(frame: &mut Frame<'_>, model: &Model) -> bool {
    let message = if frame.area().height < TALL { 1 } else { 2 };
    let question = if model.asked.is_some() { QUESTION } else { 0 };
    let [head, fields, ask, totals, last] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(3),
        Constraint::Length(question),
        Constraint::Length(1),
        Constraint::Length(message + QUESTION - question),
    ])
    .areas(frame.area());
    let keys = "Ctrl-C ends after the packs under way";
    let gap = usize::from(head.width).saturating_sub(model.title.chars().count() + keys.len());
    let title =
        if gap < 2 { model.title.clone() } else { format!("{}{}{keys}", model.title, " ".repeat(gap)) };
    frame.render_widget(Line::styled(title, bold()), head);
    let mut has_parts = false;
    for (field, area) in model.fields.iter().zip(areas(fields, &model.fields)) {
        has_parts |= draw(frame, model, field, area);
    }
    if let Some(asked) = &model.asked {
        let style = match model.colour {
            true => Style::new().fg(BLACK).bg(YELLOW).add_modifier(Modifier::BOLD),
            false => Style::new().add_modifier(Modifier::REVERSED | Modifier::BOLD),
        };
        let width = usize::from(ask.width);
        let lines = vec![
            Line::styled(format!("{asked:width$.width$}"), style),
            Line::styled(format!("> {}_", end(&model.typed, width.saturating_sub(3))), bold()),
        ];
        frame.render_widget(Paragraph::new(lines), ask);
    }
    frame.render_widget(Line::styled(model.totals.clone(), bold()), totals);
    let said = model.last.front().map_or("", String::as_str);
    frame.render_widget(Paragraph::new(said).wrap(Wrap { trim: false }), last);
    has_parts
}

/// The end of a text that is too long.
fn end(text: &str, width: usize) -> String {
    text.chars().skip(text.chars().count().saturating_sub(width)).collect()
}

fn bold() -> Style {
    Style::new().add_modifier(Modifier::BOLD)
}

/// Needs of fields, best first: width and height with large words, with two lines of text, and without text.
const SIZES: [(u16, u16); 4] = [(WIDE, HIGH), (WIDE, 4), (NARROW, 4), (NARROW, 2)];
const NARROW: u16 = 16;

/// Areas of the fields: as few columns as leave room for the best, and rows as high as their texts need.
fn areas(area: Rect, fields: &[Field]) -> Vec<Rect> {
    let count = fields.len();
    let most = |width| usize::from(area.width / width).max(1);
    let fits = |columns: usize, height| area.height / count.div_ceil(columns).max(1) as u16 >= height;
    let best = |(width, height)| (1..=most(width)).find(|columns| fits(*columns, height));
    let columns = SIZES.into_iter().find_map(best).unwrap_or(most(NARROW));
    let needed = |row: &[Field]| {
        let inner = (area.width / columns as u16).saturating_sub(FRAME);
        row.iter().map(|field| wrapped(&field.text, inner.into()).len() as u16 + FRAME).max().unwrap_or(0)
    };
    let rows = heights(area.height, &fields.chunks(columns).map(needed).collect::<Vec<_>>());
    let lines = Layout::vertical(rows.into_iter().map(Constraint::Length)).split(area);
    let split = |line: &Rect| Layout::horizontal(vec![Constraint::Fill(1); columns]).split(*line).to_vec();
    lines.iter().flat_map(split).collect()
}

/// Heights of rows: equal, unless one needs more and others need less.
fn heights(total: u16, needed: &[u16]) -> Vec<u16> {
    let rows = needed.len().max(1) as u16;
    let mut heights: Vec<u16> =
        (0..rows).map(|row| total / rows + u16::from(row < total % rows)).take(needed.len()).collect();
    loop {
        let wants = (0..needed.len()).find(|&row| heights[row] < needed[row]);
        let spare = |row: &usize| heights[*row].saturating_sub(needed[*row].max(FRAME + 1));
        let gives = (0..needed.len()).filter(|row| spare(row) > 0).max_by_key(spare);
        let (Some(wants), Some(gives)) = (wants, gives) else { return heights };
        heights[wants] += 1;
        heights[gives] -= 1;
    }
}

/// Where a field has its text.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Below the sign and the word in large letters.
    Below,
    /// Beside the sign; the word is in the frame.
    Beside,
    Alone,
}

impl Place {
    /// The best place with room for the whole text. Otherwise the text is shown in parts where most of it fits.
    fn of(text: &str, inner: Rect) -> (Self, Vec<String>) {
        let places = [
            (Self::Below, WIDE - FRAME, 0, LARGE),
            (Self::Beside, WIDE - FRAME, BESIDE, 0),
            (Self::Alone, 0, 0, 0),
        ];
        let tried = places.map(|(place, least, columns, rows)| {
            let lines = wrapped(text, inner.width.saturating_sub(columns).into());
            let has_room = inner.width >= least
                && usize::from(inner.height.saturating_sub(rows)) >= lines.len()
                && (place == Self::Alone || inner.height >= LARGE);
            (has_room, place, lines)
        });
        let [.., alone] = &tried;
        let (_, place, lines) = tried.iter().find(|(has_room, ..)| *has_room).unwrap_or(alone);
        (*place, lines.clone())
    }
}

/// Draws a field. Returns whether its text is shown in parts.
fn draw(frame: &mut Frame<'_>, model: &Model, field: &Field, area: Rect) -> bool {
    let look = look(field.sign);
    let style = match (model.colour, look.colour) {
        (true, Some((ink, paper))) => Style::new().fg(ink).bg(paper),
        _ => Style::new(),
    };
    let set = match (model.unicode, field.sign) {
        (false, _) => ASCII,
        (true, Sign::Pass | Sign::Fail) => border::DOUBLE,
        (true, _) => border::PLAIN,
    };
    let block = Block::bordered().border_set(set).style(style);
    let inner = block.inner(area);
    let (place, lines) = Place::of(&field.text, inner);
    // The smallest field has only a frame.
    let word = if place == Place::Below { String::new() } else { format!("[{}] ", look.word) };
    let parts = lines.len().div_ceil(usize::from(inner.height).max(1));
    let part = model.turn % parts.max(1);
    let number = if parts > 1 { format!(" {}/{parts}", part + 1) } else { String::new() };
    let title = format!(" {word}{}{number} ", field.name);
    frame.render_widget(block.title(Line::styled(title, style.add_modifier(Modifier::BOLD))), area);
    let shape = match place {
        Place::Below => large(&look),
        Place::Beside => look.shape.map(|line| format!(" {line}  ")),
        Place::Alone => Default::default(),
    };
    let block = if model.unicode { "\u{2588}" } else { "#" };
    let shape = shape.map(|line| Line::styled(line.replace('#', block), bold()));
    let text = lines.into_iter().skip(part * usize::from(inner.height)).map(Line::raw);
    let columns = if place == Place::Beside { BESIDE } else { 0 };
    let [left, right] = Layout::horizontal([Constraint::Length(columns), Constraint::Min(0)]).areas(inner);
    match place {
        Place::Below => {
            let all: Vec<Line<'_>> = shape.into_iter().chain(text).collect();
            frame.render_widget(Paragraph::new(all).style(style), inner);
        }
        Place::Beside | Place::Alone => {
            frame.render_widget(Paragraph::new(shape.to_vec()).style(style), left);
            frame.render_widget(Paragraph::new(text.collect::<Vec<_>>()).style(style), right);
        }
    }
    parts > 1
}

/// The look of a state.
struct Look {
    word: &'static str,
    shape: [&'static str; 5],
    /// Colours of the letters and their background.
    colour: Option<(Color, Color)>,
}

fn look(sign: Sign) -> Look {
    let of = |word, shape, colour| Look { word, shape, colour };
    match sign {
        Sign::Connect => of("NEXT", ["  #  ", "  #  ", "# # #", " ### ", "  #  "], None),
        Sign::Scan => of("SCAN", [" ### ", "#   #", "  ## ", "     ", "  #  "], Some((BLACK, YELLOW))),
        Sign::Look => of("LOOK", ["  #  ", "  #  ", "  #  ", "     ", "  #  "], Some((BLACK, YELLOW))),
        Sign::Wait => of("WAIT", ["     ", "     ", "# # #", "     ", "     "], None),
        Sign::Busy => of("BUSY", ["#####", " ### ", "  #  ", " ### ", "#####"], Some((BLACK, CYAN))),
        Sign::Pass => of("PASS", ["    #", "    #", "#  # ", " # # ", "  #  "], Some((BLACK, GREEN))),
        Sign::Fail => of("FAIL", ["#   #", " # # ", "  #  ", " # # ", "#   #"], Some((WHITE, RED))),
        Sign::Over => of("END", ["#####", "#   #", "#   #", "#   #", "#####"], None),
    }
}

/// The word and the shape of a state, in lines.
fn large(look: &Look) -> [String; 5] {
    std::array::from_fn(|row| {
        let letters = look.word.chars().map(|letter| letter_of(letter)[row]);
        format!(" {}  {}", look.shape[row], letters.collect::<Vec<_>>().join(" "))
    })
}

/// A letter of five by five.
fn letter_of(letter: char) -> [&'static str; 5] {
    match letter {
        'A' => [" ### ", "#   #", "#####", "#   #", "#   #"],
        'B' => ["#### ", "#   #", "#### ", "#   #", "#### "],
        'C' => [" ####", "#    ", "#    ", "#    ", " ####"],
        'D' => ["#### ", "#   #", "#   #", "#   #", "#### "],
        'E' => ["#####", "#    ", "###  ", "#    ", "#####"],
        'F' => ["#####", "#    ", "###  ", "#    ", "#    "],
        'I' => ["#####", "  #  ", "  #  ", "  #  ", "#####"],
        'K' => ["#   #", "#  # ", "###  ", "#  # ", "#   #"],
        'L' => ["#    ", "#    ", "#    ", "#    ", "#####"],
        'N' => ["#   #", "##  #", "# # #", "#  ##", "#   #"],
        'O' => [" ### ", "#   #", "#   #", "#   #", " ### "],
        'P' => ["#### ", "#   #", "#### ", "#    ", "#    "],
        'S' => [" ####", "#    ", " ### ", "    #", "#### "],
        'T' => ["#####", "  #  ", "  #  ", "  #  ", "  #  "],
        'U' => ["#   #", "#   #", "#   #", "#   #", " ### "],
        'W' => ["#   #", "#   #", "# # #", "## ##", "#   #"],
        'X' => ["#   #", " # # ", "  #  ", " # # ", "#   #"],
        'Y' => ["#   #", " # # ", "  #  ", "  #  ", "  #  "],
        _ => ["     "; 5],
    }
}

#[cfg(test)]
mod tests {
    use crate::top::picture::{behind, colour};

    use super::*;

    /// By the Web Content Accessibility Guidelines 2.2, which ask for 4.5 with small text.
    fn contrast(one: Color, other: Color) -> f64 {
        let light = |colour: String| {
            let part = |at: usize| u8::from_str_radix(&colour[at..at + 2], 16).expect("a colour");
            let linear = |part: u8| match f64::from(part) / 255.0 {
                dark if dark <= 0.04045 => dark / 12.92,
                part => ((part + 0.055) / 1.055).powf(2.4),
            };
            0.2126 * linear(part(1)) + 0.7152 * linear(part(3)) + 0.0722 * linear(part(5)) + 0.05
        };
        let (one, other) = (light(colour(one)), light(behind(other)));
        one.max(other) / one.min(other)
    }

    #[test]
    fn regression_the_reason_of_a_failure_was_hardly_brighter_than_what_is_behind_it() {
        assert!((contrast(WHITE, BLACK) - 21.0).abs() < 0.01);
        for sign in ALL {
            let (ink, paper) = look(sign).colour.unwrap_or((Color::Reset, Color::Reset));
            assert!(contrast(ink, paper) >= 4.5, "{sign:?}: {:.1}", contrast(ink, paper));
            // A theme may change the sixteen others.
            let is_fixed = |colour| matches!(colour, Color::Reset | Color::Indexed(16..=231));
            assert!(is_fixed(ink) && is_fixed(paper), "{sign:?}");
        }
    }

    #[test]
    fn rows_are_alike_unless_one_needs_more() {
        assert_eq!(heights(18, &[3, 8]), [9, 9]);
        assert_eq!(heights(19, &[3, 3]), [10, 9]);
        assert_eq!(heights(18, &[3, 12]), [6, 12]);
        assert_eq!(heights(18, &[30, 3, 3, 3]), [9, 3, 3, 3]);
        assert_eq!(heights(6, &[9, 9, 9]), [2, 2, 2]);
        assert!(heights(6, &[]).is_empty());
    }

    const ALL: [Sign; 8] =
        [Sign::Connect, Sign::Scan, Sign::Look, Sign::Wait, Sign::Busy, Sign::Pass, Sign::Fail, Sign::Over];

    #[test]
    fn every_state_has_a_word_and_a_sign_of_its_own_in_letters_that_are_there() {
        for (at, sign) in ALL.into_iter().enumerate() {
            let Look { word, shape, .. } = look(sign);
            assert!(word.chars().all(|letter| letter_of(letter) != letter_of(' ')), "{word}");
            assert!(large(&look(sign)).iter().all(|line| line.len() < usize::from(WIDE) - 1), "{word}");
            for other in &ALL[..at] {
                assert!(look(*other).word != word && look(*other).shape != shape, "{word}");
            }
        }
    }
}
