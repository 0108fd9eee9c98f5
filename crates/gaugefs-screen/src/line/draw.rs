// SPDX-License-Identifier: MIT

//! Draws the fields. A state has a word, a sign beside it and a colour, so that any one of them is enough.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::border;
use ratatui::text::Line;
use ratatui::widgets::{Block, Paragraph, Wrap};

use super::{Field, Model};
use gaugefs_host::sign::Sign;

/// A field at least so wide has its word and its sign in large letters.
const WIDE: u16 = 34;
/// Lines of a large word, and of a field that has one.
const LARGE: u16 = 5;
const HIGH: u16 = LARGE + 3;

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

/// A terminal of so many lines has room for a message of two.
const TALL: u16 = 24;
/// Lines of a question, with what has been typed. While nothing is asked for, the message has them as well.
const QUESTION: u16 = 2;

/// Draws everything.
pub(super) fn screen(frame: &mut Frame<'_>, model: &Model) {
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
    for (field, area) in model.fields.iter().zip(areas(fields, model.fields.len())) {
        draw(frame, model, field, area);
    }
    if let Some(asked) = &model.asked {
        let style = match model.colour {
            true => Style::new().fg(Color::Black).bg(Color::Yellow).add_modifier(Modifier::BOLD),
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
}

/// The end of a text, if it is too long.
fn end(text: &str, width: usize) -> String {
    text.chars().skip(text.chars().count().saturating_sub(width)).collect()
}

fn bold() -> Style {
    Style::new().add_modifier(Modifier::BOLD)
}

/// What fields need, the best first: width and height of one with large words, with two lines of text, and with none.
const SIZES: [(u16, u16); 4] = [(WIDE, HIGH), (WIDE, 4), (NARROW, 4), (NARROW, 2)];
const NARROW: u16 = 16;

/// The areas of the fields: as few columns as leave room for the best.
fn areas(area: Rect, count: usize) -> Vec<Rect> {
    let most = |width| usize::from(area.width / width).max(1);
    let fits = |columns: usize, height| area.height / count.div_ceil(columns).max(1) as u16 >= height;
    let best = |(width, height)| (1..=most(width)).find(|columns| fits(*columns, height));
    let columns = SIZES.into_iter().find_map(best).unwrap_or(most(NARROW));
    let rows = count.div_ceil(columns).max(1);
    let lines = Layout::vertical(vec![Constraint::Fill(1); rows]).split(area);
    let split = |line: &Rect| Layout::horizontal(vec![Constraint::Fill(1); columns]).split(*line).to_vec();
    lines.iter().flat_map(split).collect()
}

fn draw(frame: &mut Frame<'_>, model: &Model, field: &Field, area: Rect) {
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
    let is_large = inner.height > LARGE && inner.width >= WIDE - 2;
    // A field without room for anything else has a frame.
    let word = if is_large { String::new() } else { format!("[{}] ", look.word) };
    let title = Line::styled(format!(" {word}{} ", field.name), style.add_modifier(Modifier::BOLD));
    frame.render_widget(block.title(title), area);
    let mut lines: Vec<Line<'_>> = Vec::new();
    if is_large {
        let block = if model.unicode { "\u{2588}" } else { "#" };
        lines.extend(large(look).map(|line| Line::styled(line.replace('#', block), bold())));
    }
    lines.push(Line::raw(field.text.clone()));
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).style(style), inner);
}

/// How a state looks.
struct Look {
    word: &'static str,
    shape: [&'static str; 5],
    /// Of the letters and behind them.
    colour: Option<(Color, Color)>,
}

fn look(sign: Sign) -> Look {
    use Color::{Black, Cyan, Green, Red, White, Yellow};
    let of = |word, shape, colour| Look { word, shape, colour };
    match sign {
        Sign::Connect => of("NEXT", ["  #  ", "  #  ", "# # #", " ### ", "  #  "], None),
        Sign::Scan => of("SCAN", [" ### ", "#   #", "  ## ", "     ", "  #  "], Some((Black, Yellow))),
        Sign::Look => of("LOOK", ["  #  ", "  #  ", "  #  ", "     ", "  #  "], Some((Black, Yellow))),
        Sign::Wait => of("WAIT", ["     ", "     ", "# # #", "     ", "     "], None),
        Sign::Busy => of("BUSY", ["#####", " ### ", "  #  ", " ### ", "#####"], Some((Black, Cyan))),
        Sign::Pass => of("PASS", ["    #", "    #", "#  # ", " # # ", "  #  "], Some((Black, Green))),
        Sign::Fail => of("FAIL", ["#   #", " # # ", "  #  ", " # # ", "#   #"], Some((White, Red))),
        Sign::Over => of("END", ["#####", "#   #", "#   #", "#   #", "#####"], None),
    }
}

/// The word and the shape of a state, in lines.
fn large(look: Look) -> [String; 5] {
    std::array::from_fn(|row| {
        let letters = look.word.chars().map(|letter| letter_of(letter)[row]);
        format!(" {}  {}", look.shape[row], letters.collect::<Vec<_>>().join(" "))
    })
}

/// A letter of the words, five by five.
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
    use super::*;

    #[test]
    fn every_state_has_a_word_and_a_sign_of_its_own_in_letters_that_are_there() {
        let signs = [
            Sign::Connect,
            Sign::Scan,
            Sign::Look,
            Sign::Wait,
            Sign::Busy,
            Sign::Pass,
            Sign::Fail,
            Sign::Over,
        ];
        for (at, sign) in signs.into_iter().enumerate() {
            let Look { word, shape, .. } = look(sign);
            assert!(word.chars().all(|letter| letter_of(letter) != letter_of(' ')), "{word}");
            assert!(large(look(sign)).iter().all(|line| line.len() < usize::from(WIDE) - 1), "{word}");
            for other in &signs[..at] {
                assert!(look(*other).word != word && look(*other).shape != shape, "{word}");
            }
        }
    }
}
