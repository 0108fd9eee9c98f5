// SPDX-License-Identifier: MIT

//! The screen of a production line, `gaugefs-station program --screen`: a large field per slot, a question, and
//! counters. It is readable from two metres on a terminal of 80 columns and 24 lines, and on a serial console without
//! colours.

use std::collections::VecDeque;
use std::io::{self, IsTerminal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::errno::Errno;

use gaugefs_host::error::{Error, Result};
use gaugefs_host::output;
use gaugefs_host::sign::Sign;

mod draw;
mod terminal;

/// Interval of checks for the station's end while waiting for a line.
const LOOK: Duration = Duration::from_millis(200);
/// Outcomes kept for the screen.
const LAST: usize = 50;
/// Longest typed line, in characters.
const LONGEST: usize = 200;

/// A slot and its state.
struct Field {
    name: String,
    sign: Sign,
    text: String,
}

/// The content of the screen.
struct Model {
    title: String,
    fields: Vec<Field>,
    /// The question, and the text typed so far.
    asked: Option<String>,
    typed: String,
    /// The last line was not empty, and no key has followed.
    has_answered: bool,
    totals: String,
    last: VecDeque<String>,
    colour: bool,
    /// The terminal has line drawing characters.
    unicode: bool,
    /// Counts the parts shown of texts that are too long.
    turn: usize,
    changed: bool,
}

/// The screen of a line, drawn by a separate thread. Clones are the same screen.
#[derive(Clone)]
pub struct Board {
    model: Arc<Mutex<Model>>,
    lines: Arc<Mutex<Receiver<String>>>,
    stops: Arc<AtomicBool>,
}

/// A visible screen. Its end restores the terminal.
pub struct Shown {
    ends: Arc<AtomicBool>,
    drawn: Option<JoinHandle<Result<()>>>,
}

impl Board {
    /// Shows the screen of these slots. Ctrl-C sets `stops`; a second one runs `leaves` and ends the process.
    pub fn show(
        title: String,
        slots: &[String],
        stops: Arc<AtomicBool>,
        leaves: fn(),
    ) -> Result<(Self, Shown)> {
        if !(output::is_terminal() && io::stdin().is_terminal()) {
            let why = "not a terminal; without --screen the outcomes are lines";
            return Err(Error::host("standard output", Errno::ENOTTY, why));
        }
        let variable = |name| std::env::var(name).unwrap_or_default();
        let term = variable("TERM");
        if matches!(term.as_str(), "dumb" | "") {
            let what = if term.is_empty() { "TERM is not set" } else { "TERM=dumb" };
            let why = format!(
                "{what}, so the cursor of this terminal cannot be moved; set TERM=vt100 if it can, or leave out --screen: \
                 outcomes and questions are then lines, which any terminal shows"
            );
            return Err(Error::host("standard output", Errno::ENOTTY, why));
        }
        let is_old = ["vt100", "vt102", "vt220"].iter().any(|old| term.starts_with(old));
        let locale = ["LC_ALL", "LC_CTYPE", "LANG"].map(variable).into_iter().find(|text| !text.is_empty());
        let is_utf8 = locale.is_some_and(|text| text.to_lowercase().replace('-', "").contains("utf8"));
        let colour = !is_old && variable("NO_COLOR").is_empty();
        let model = Model::new(title, slots, colour, is_utf8 && !is_old);
        let (sender, lines) = mpsc::channel();
        let board = Self {
            model: Arc::new(Mutex::new(model)),
            lines: Arc::new(Mutex::new(lines)),
            stops: stops.clone(),
        };
        let ends = Arc::new(AtomicBool::new(false));
        let drawn = terminal::start(board.clone(), sender, ends.clone(), leaves)?;
        Ok((board, Shown { ends, drawn: Some(drawn) }))
    }

    fn model(&self) -> MutexGuard<'_, Model> {
        let mut model = self.model.lock().unwrap_or_else(PoisonError::into_inner);
        model.changed = true;
        model
    }

    /// Sets what a slot shows.
    pub fn sign(&self, slot: &str, sign: Sign, text: &str) {
        if let Some(field) = self.model().fields.iter_mut().find(|field| field.name == slot) {
            (field.sign, field.text) = (sign, text.into());
        }
    }

    /// Shows a line below the slots, with the latest ones.
    pub fn say(&self, line: &str) {
        let last = &mut self.model().last;
        last.push_front(line.into());
        last.truncate(LAST);
    }

    /// Shows the counters.
    pub fn totals(&self, line: String) {
        self.model().totals = line;
    }

    /// Asks for a typed or scanned line. `None` if the station ends.
    pub fn ask(&self, what: &str) -> Option<String> {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        // Nobody asked for what was scanned before.
        while lines.try_recv().is_ok() {}
        (self.model().asked, self.model().typed) = (Some(what.into()), String::new());
        let line = loop {
            match lines.recv_timeout(LOOK) {
                Ok(line) => break Some(line),
                Err(RecvTimeoutError::Timeout) if !self.stops.load(Ordering::SeqCst) => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => break None,
            }
        };
        self.model().asked = None;
        line
    }
}

impl Shown {
    /// Restores the terminal.
    pub fn end(mut self) -> Result<()> {
        self.finish()
    }

    fn finish(&mut self) -> Result<()> {
        self.ends.store(true, Ordering::SeqCst);
        match self.drawn.take().map(JoinHandle::join) {
            Some(Ok(outcome)) => outcome,
            Some(Err(_)) | None => Ok(()),
        }
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        // Nobody could read its message.
        let _ = self.finish();
    }
}

#[derive(Debug, PartialEq, Eq)]
enum Key {
    Letter(char),
    Back,
    Clear,
    Enter,
}

impl Model {
    fn new(title: String, slots: &[String], colour: bool, unicode: bool) -> Self {
        let field = |name: &String| Field { name: name.clone(), sign: Sign::Wait, text: String::new() };
        Self {
            title,
            fields: slots.iter().map(field).collect(),
            asked: None,
            typed: String::new(),
            has_answered: false,
            totals: String::new(),
            last: VecDeque::new(),
            colour,
            unicode,
            turn: 0,
            changed: true,
        }
    }

    /// Handles a key. Keys do nothing without a question.
    fn key(&mut self, key: Key) -> Option<String> {
        self.asked.as_ref()?;
        self.changed = true;
        self.has_answered &= key == Key::Enter;
        match key {
            Key::Letter(letter) if self.typed.chars().count() < LONGEST => self.typed.push(letter),
            Key::Letter(_) => {}
            Key::Back => drop(self.typed.pop()),
            Key::Clear => self.typed.clear(),
            // A scanner may end its lines with two characters; the line feed must not answer the next question.
            Key::Enter if self.typed.is_empty() && std::mem::take(&mut self.has_answered) => {}
            Key::Enter => {
                self.has_answered = !self.typed.is_empty();
                return Some(std::mem::take(&mut self.typed));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use ratatui::buffer::Buffer;

    use super::*;

    fn model(slots: &[&str], colour: bool) -> Model {
        let slots: Vec<String> = slots.iter().map(ToString::to_string).collect();
        let mut model = Model::new("line1  golden.gm.fs".into(), &slots, colour, colour);
        let states = [
            (Sign::Pass, "PASS LEFT SN00123 serial 1000 (0x03e8) (pack 1, 8.6 s)"),
            (Sign::Busy, "programming, do not remove (2 of 4: calibration)"),
            (Sign::Scan, "THIRD: scan the label"),
            (
                Sign::Fail,
                "FAIL FOURTH (pack 4): bq34z100-G1: identify: device type 0x0541; nothing was changed",
            ),
        ];
        for (field, (sign, text)) in model.fields.iter_mut().zip(states) {
            (field.sign, field.text) = (sign, text.into());
        }
        model.asked = Some("THIRD: scan the label".into());
        model.typed = "SN0012".into();
        model.totals = "packs: 2, passed: 1, failed: 1, first-pass yield: 50.0 %".into();
        model.last.push_front("PASS LEFT SN00123 serial 1000 (0x03e8) (pack 1, 8.6 s)".into());
        model
    }

    fn drawn(model: &Model, width: u16, height: u16) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
        terminal.draw(|frame| has_parts(draw::screen(frame, model), model)).expect("it is drawn");
        terminal.backend().buffer().clone()
    }

    /// Only a screen without room for a text changes by itself.
    fn has_parts(has_parts: bool, model: &Model) {
        assert!(!has_parts || model.fields.iter().any(|field| field.text.len() > 40));
    }

    fn text(buffer: &Buffer) -> String {
        let row = |row: u16| (0..buffer.area.width).map(move |column| buffer[(column, row)].symbol());
        (0..buffer.area.height).map(|at| row(at).collect::<String>().trim_end().to_string() + "\n").collect()
    }

    #[test]
    fn every_slot_is_told_by_text_and_shape_without_colour() {
        let names = ["LEFT", "RIGHT", "THIRD", "FOURTH"];
        for count in 1..=4 {
            let shown = text(&drawn(&model(&names[..count], false), 80, 24));
            assert!(shown.is_ascii(), "{shown}");
            for name in &names[..count] {
                assert!(shown.contains(name), "{count}: {shown}");
            }
            assert!(shown.contains("serial 1000 (0x03e8)"), "{shown}");
            assert!(shown.contains("> SN0012_") && shown.contains("passed: 1"), "{shown}");
        }
        // The same in few lines, and in hardly any.
        let eight: Vec<String> = (1..=8).map(|number| format!("SLOT{number}")).collect();
        let eight: Vec<&str> = eight.iter().map(String::as_str).collect();
        let shown = text(&drawn(&model(&eight, false), 80, 24));
        for word in ["[PASS]", "[BUSY]", "[SCAN]", "[FAIL]", "SLOT8"] {
            assert!(shown.contains(word), "{word}: {shown}");
        }
        for (width, height) in [(1, 1), (20, 3), (40, 10), (200, 60)] {
            drawn(&model(&eight, true), width, height);
        }
    }

    #[test]
    fn regression_a_slot_on_a_small_terminal_showed_no_word() {
        let names: Vec<String> = (1..=16).map(|number| format!("S{number}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        for (count, width, height) in [(4, 60, 15), (4, 40, 12), (8, 40, 16), (8, 80, 16), (16, 80, 24)] {
            let shown = text(&drawn(&model(&names[..count], false), width, height));
            for word in ["[PASS] S1 ", "[BUSY] S2 ", "[SCAN] S3 ", "[FAIL] S4 "] {
                assert!(shown.contains(word), "{count} on {width} x {height}: {shown}");
            }
            assert_eq!(shown.matches("[WAIT]").count(), count - 4, "{shown}");
            // Narrow fields have room for their text where wide ones have none.
            assert!(width < 80 || shown.contains("programming,"), "{count} on {width} x {height}: {shown}");
        }
    }

    #[test]
    fn regression_the_reason_of_a_failure_was_cut_off() {
        let mut model = model(&["LEFT", "RIGHT", "THIRD", "FOURTH"], false);
        let reason = "FAIL FOURTH (pack 4): bq34z100-G1: identify: device type 0x0100, firmware 0x0202, hardware 0x0008: this \
                      is a bq34z100-R2; refusing to mount it as a bq34z100-G1; nothing was changed";
        model.last.push_front(reason.into());
        model.asked = None;
        let shown = text(&drawn(&model, 80, 24));
        assert!(shown.split_whitespace().collect::<Vec<_>>().join(" ").ends_with(reason), "{shown}");
        // The words of the others are as large as before.
        assert_eq!(shown.matches('[').count(), 1, "{shown}");
    }

    const REASON: &str = "FAIL FOURTH SN00124 serial 1003 (pack 4): bring-up: Voltage(): verify: 0.0 mV (3 readings, 0 to 0) with \
                          the new divider, and it should be 13878 to 16962 mV: is the divider right, and the number of \
                          cells?; the old value was restored and verified";

    /// The whole text of the named field, from its lines and parts.
    fn text_of(model: &mut Model, name: &str, width: u16, height: u16) -> String {
        let mut whole = String::new();
        for turn in 0.. {
            model.turn = turn;
            let shown = text(&drawn(model, width, height));
            let lines: Vec<Vec<char>> = shown.lines().map(|line| line.chars().collect()).collect();
            let title = format!("] {name} ").chars().collect::<Vec<_>>();
            let find = |line: &[char]| line.windows(title.len()).position(|part| part == title);
            let (top, at) =
                (0..).zip(&lines).find_map(|(row, line)| Some((row, find(line)?))).expect("its frame");
            let left = lines[top][..at].iter().rposition(|&letter| letter == '+').expect("a corner");
            let right = lines[top][at..].iter().position(|&letter| letter == '+').expect("a corner") + at;
            let inner = lines[top + 1..].iter().take_while(|line| line[left] == '|');
            let inner: Vec<String> = inner.map(|line| line[left + 1..right].iter().collect()).collect();
            whole = whole + " " + &inner.join(" ").replace('#', " ");
            let head: String = lines[top][at..right].iter().collect();
            let parts = head.split(' ').find_map(|word| word.split_once('/')?.1.parse::<usize>().ok());
            if turn + 1 >= parts.unwrap_or(1) {
                return whole.split_whitespace().collect::<Vec<_>>().join(" ");
            }
        }
        unreachable!("there is a last part")
    }

    #[test]
    fn regression_the_reason_of_a_failure_was_cut_off_in_its_field_and_lost_with_the_next_message() {
        let names: Vec<String> = (1..=8).map(|number| format!("S{number}")).collect();
        let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
        names[3] = "FOURTH";
        for (count, width, height) in [(4, 80, 24), (4, 120, 40), (8, 80, 24), (8, 40, 24), (4, 60, 15)] {
            let mut model = model(&names[..count], false);
            model.fields[3].text = REASON.into();
            model.last.push_front("S2: take the pack off".into());
            assert_eq!(text_of(&mut model, "FOURTH", width, height), REASON, "{count} on {width} x {height}");
            // Two of them, in different rows.
            model.fields[0].sign = Sign::Fail;
            model.fields[0].text = REASON.replace("FOURTH", "S1");
            assert_eq!(text_of(&mut model, "FOURTH", width, height), REASON);
            assert_eq!(text_of(&mut model, "S1", width, height), REASON.replace("FOURTH", "S1"));
        }
        // A text of usual length gets a sign and room beside it; the others keep their words.
        let mut model = model(&names[..4], false);
        let (reason, _) = REASON.split_once(": is the divider").expect("a question");
        model.fields[3].text = reason.into();
        let shown = text(&drawn(&model, 80, 24));
        assert!(shown.contains("[FAIL] FOURTH --") && shown.contains("| #   #  FAIL FOURTH"), "{shown}");
        assert_eq!(shown.matches('[').count(), 1, "{shown}");
    }

    /// docs/line.svg and the texts of it.
    #[test]
    fn the_picture_is_that_of_the_document() {
        let buffer = drawn(&model(&["LEFT", "RIGHT", "THIRD", "FOURTH"], true), 80, 24);
        let svg = crate::top::picture::svg(&buffer);
        crate::top::tests::matches(Path::new("docs/line.svg"), &svg);
    }

    #[test]
    fn keys_are_for_the_question_only() {
        let mut model = model(&["LEFT"], false);
        for letter in "34\u{e9}".chars() {
            assert_eq!(model.key(Key::Letter(letter)), None);
        }
        assert_eq!(model.key(Key::Back), None);
        assert_eq!(model.key(Key::Enter).as_deref(), Some("SN001234"));
        model.asked = None;
        assert_eq!(model.key(Key::Letter('7')), None);
        assert_eq!(model.key(Key::Enter), None);
        assert_eq!(model.typed, "");
        model.asked = Some("again".into());
        for _ in 0..1000 {
            model.key(Key::Letter('7'));
        }
        assert_eq!(model.typed.len(), LONGEST);
        assert_eq!((model.key(Key::Clear), model.typed.len()), (None, 0));
    }

    #[test]
    fn regression_the_line_feed_of_a_scanner_answered_the_next_question() {
        let mut model = model(&["LEFT"], false);
        assert_eq!(model.key(Key::Enter).as_deref(), Some("SN0012"));
        // The second question is there already.
        assert_eq!(model.key(Key::Enter), None);
        // A person's Enter is an empty line.
        assert_eq!(model.key(Key::Enter).as_deref(), Some(""));
        assert_eq!(model.key(Key::Enter).as_deref(), Some(""));
        for key in [Key::Letter('7'), Key::Back] {
            assert_eq!(model.key(key), None);
        }
        assert_eq!(model.key(Key::Enter).as_deref(), Some(""));
    }
}
