// SPDX-License-Identifier: MIT

//! Draws the screen of a line on the terminal, and reads its keys.

#![expect(clippy::disallowed_methods, reason = "ratatui draws on standard output, and reports what fails")]

use std::io;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use ratatui::backend::CrosstermBackend;
use ratatui::layout::Rect;
use ratatui::{DefaultTerminal, Terminal, TerminalOptions, Viewport};

use super::{Board, Key, draw};
use crate::top::terminal::{STEP, failed};
use gaugefs_host::error::Result;

/// Time for each part of a text.
const TURN: Duration = Duration::from_secs(4);
/// The size of a serial console, which reports none.
const SERIAL: Rect = Rect { x: 0, y: 0, width: 80, height: 24 };

/// Shows a board until `ends`, from a separate thread.
pub(super) fn start(
    board: Board,
    lines: Sender<String>,
    ends: Arc<AtomicBool>,
    leaves: fn(),
) -> Result<JoinHandle<Result<()>>> {
    let (ready, begun) = mpsc::channel();
    let work = move || {
        let terminal = open();
        let terminal = match terminal {
            Ok(terminal) => {
                let _ = ready.send(Ok(()));
                terminal
            }
            Err(error) => {
                let _ = ready.send(Err(failed(&error)));
                return Ok(());
            }
        };
        let outcome = show(terminal, &board, &lines, &ends, leaves);
        // A lost terminal may also fail while it is drawn, and nobody would see a question.
        if outcome.is_err() {
            board.stops.store(true, Ordering::SeqCst);
        }
        ratatui::try_restore().map_err(|error| failed(&error))?;
        outcome
    };
    let drawn = thread::Builder::new().spawn(work).map_err(|error| failed(&error))?;
    begun.recv().unwrap_or(Ok(()))?;
    Ok(drawn)
}

fn open() -> io::Result<DefaultTerminal> {
    let terminal = ratatui::try_init()?;
    let size = terminal.size()?;
    if size.width > 0 && size.height > 0 {
        return Ok(terminal);
    }
    let options = TerminalOptions { viewport: Viewport::Fixed(SERIAL) };
    Terminal::with_options(CrosstermBackend::new(io::stdout()), options)
}

fn show(
    mut terminal: DefaultTerminal,
    board: &Board,
    lines: &Sender<String>,
    ends: &AtomicBool,
    leaves: fn(),
) -> Result<()> {
    let (mut has_parts, mut turned) = (false, Instant::now());
    loop {
        let is_over = ends.load(Ordering::SeqCst);
        let mut model = board.model.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if has_parts && turned.elapsed() >= TURN {
            (model.turn, model.changed, turned) = (model.turn + 1, true, Instant::now());
        }
        if std::mem::take(&mut model.changed) {
            terminal.draw(|frame| has_parts = draw::screen(frame, &model)).map_err(|error| failed(&error))?;
        }
        drop(model);
        if is_over {
            return Ok(());
        }
        if is_gone() {
            // The packs under way are finished; their results are only in the record.
            board.stops.store(true, Ordering::SeqCst);
            return Ok(());
        }
        if !event::poll(STEP).map_err(|error| failed(&error))? {
            continue;
        }
        match event::read().map_err(|error| failed(&error))? {
            Event::Key(key) if key.kind != KeyEventKind::Release => match key_of(key) {
                Some(Typed::Key(key)) => {
                    let line = board.model().key(key);
                    if let Some(line) = line {
                        let _ = lines.send(line);
                    }
                }
                Some(Typed::Stop) if board.stops.swap(true, Ordering::SeqCst) => {
                    let _ = ratatui::try_restore();
                    leaves();
                    std::process::exit(1);
                }
                Some(Typed::Stop) => {
                    board.say("ending after the packs that are being programmed; once more to end at once");
                }
                None => {}
            },
            _ => board.model().changed = true,
        }
    }
}

fn is_gone() -> bool {
    let stdin = io::stdin();
    // Only a hangup or an error counts.
    let mut terminal = [PollFd::new(stdin.as_fd(), PollFlags::empty())];
    poll(&mut terminal, PollTimeout::ZERO).is_ok_and(|count| count > 0)
}

enum Typed {
    Key(Key),
    Stop,
}

fn key_of(key: KeyEvent) -> Option<Typed> {
    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        KeyCode::Char('c') if is_control => Typed::Stop,
        KeyCode::Char('u') if is_control => Typed::Key(Key::Clear),
        // Scanners send either of them as Enter.
        KeyCode::Char('j' | 'm') if is_control => Typed::Key(Key::Enter),
        KeyCode::Char(_) if is_control => return None,
        KeyCode::Char(letter) => Typed::Key(Key::Letter(letter)),
        KeyCode::Backspace => Typed::Key(Key::Back),
        KeyCode::Enter | KeyCode::Tab => Typed::Key(Key::Enter),
        _ => return None,
    })
}
