// SPDX-License-Identifier: MIT

//! Draws the fields. A state has a word, a sign beside it and a colour, so that any one of them is enough.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::border;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Wrap};

use super::{Field, Mark, Model};

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

/// Draws everything.
pub(super) fn screen(frame: &mut Frame<'_>, model: &Model) {
    let [head, fields, ask, totals, last] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(3),
        Constraint::Length(2),
        Constraint::Length(1),
        Constraint::Length(1),
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
    frame.render_widget(Line::raw(said.to_string()), last);
}

/// The end of a text, if it is too long.
fn end(text: &str, width: usize) -> String {
    text.chars().skip(text.chars().count().saturating_sub(width)).collect()
}

fn bold() -> Style {
    Style::new().add_modifier(Modifier::BOLD)
}

/// The areas of the fields: as few columns as leave room for large words.
fn areas(area: Rect, count: usize) -> Vec<Rect> {
    let most = usize::from(area.width / WIDE).max(1);
    let fits = |columns: usize| area.height / count.div_ceil(columns).max(1) as u16 >= HIGH;
    let columns = (1..=most).find(|columns| fits(*columns)).unwrap_or(most).max(1);
    let rows = count.div_ceil(columns).max(1);
    let lines = Layout::vertical(vec![Constraint::Fill(1); rows]).split(area);
    let split = |line: &Rect| Layout::horizontal(vec![Constraint::Fill(1); columns]).split(*line).to_vec();
    lines.iter().flat_map(split).collect()
}

fn draw(frame: &mut Frame<'_>, model: &Model, field: &Field, area: Rect) {
    let look = look(field.mark);
    let style = match (model.colour, look.colour) {
        (true, Some((ink, paper))) => Style::new().fg(ink).bg(paper),
        _ => Style::new(),
    };
    let set = match (model.unicode, field.mark) {
        (false, _) => ASCII,
        (true, Mark::Pass | Mark::Fail) => border::DOUBLE,
        (true, _) => border::PLAIN,
    };
    let title = Line::styled(format!(" {} ", field.name), style.add_modifier(Modifier::BOLD));
    let block = Block::bordered().border_set(set).title(title).style(style);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let is_large = inner.height > LARGE && inner.width >= WIDE - 2;
    let mut lines: Vec<Line<'_>> = match is_large {
        true => {
            let block = if model.unicode { "\u{2588}" } else { "#" };
            large(look).map(|line| Line::styled(line.replace('#', block), bold())).into()
        }
        false => vec![Line::from(vec![Span::styled(format!("[{}]", look.word), bold())])],
    };
    lines.push(Line::raw(field.text.clone()));
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).style(style), inner);
}

/// How a state looks.
struct Look {
    word: &'static str,
    sign: [&'static str; 5],
    /// Of the letters and behind them.
    colour: Option<(Color, Color)>,
}

fn look(mark: Mark) -> Look {
    use Color::{Black, Cyan, Green, Red, White, Yellow};
    let of = |word, sign, colour| Look { word, sign, colour };
    match mark {
        Mark::Next => of("NEXT", ["  #  ", "  #  ", "# # #", " ### ", "  #  "], None),
        Mark::Scan => of("SCAN", [" ### ", "#   #", "  ## ", "     ", "  #  "], Some((Black, Yellow))),
        Mark::Look => of("LOOK", ["  #  ", "  #  ", "  #  ", "     ", "  #  "], Some((Black, Yellow))),
        Mark::Wait => of("WAIT", ["     ", "     ", "# # #", "     ", "     "], None),
        Mark::Busy => of("BUSY", ["#####", " ### ", "  #  ", " ### ", "#####"], Some((Black, Cyan))),
        Mark::Pass => of("PASS", ["    #", "    #", "#  # ", " # # ", "  #  "], Some((Black, Green))),
        Mark::Fail => of("FAIL", ["#   #", " # # ", "  #  ", " # # ", "#   #"], Some((White, Red))),
        Mark::End => of("END", ["#####", "#   #", "#   #", "#   #", "#####"], None),
    }
}

/// The word and the sign of a state, in lines.
fn large(look: Look) -> [String; 5] {
    std::array::from_fn(|row| {
        let letters = look.word.chars().map(|letter| letter_of(letter)[row]);
        format!(" {}  {}", look.sign[row], letters.collect::<Vec<_>>().join(" "))
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
        let marks =
            [Mark::Next, Mark::Scan, Mark::Look, Mark::Wait, Mark::Busy, Mark::Pass, Mark::Fail, Mark::End];
        for (at, mark) in marks.into_iter().enumerate() {
            let Look { word, sign, .. } = look(mark);
            assert!(word.chars().all(|letter| letter_of(letter) != letter_of(' ')), "{word}");
            assert!(large(look(mark)).iter().all(|line| line.len() < usize::from(WIDE) - 1), "{word}");
            for other in &marks[..at] {
                assert!(look(*other).word != word && look(*other).sign != sign, "{word}");
            }
        }
    }
}
