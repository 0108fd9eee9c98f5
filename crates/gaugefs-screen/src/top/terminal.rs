// SPDX-License-Identifier: MIT

//! Sets up the terminal, draws to it, and restores it however `top` ends.

#![expect(clippy::disallowed_methods, reason = "ratatui draws on standard output, and reports what fails")]

use std::io;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyEventKind};
use crossterm::execute;
use crossterm::terminal::{Clear, ClearType, EnterAlternateScreen, enable_raw_mode};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, raise};
use ratatui::backend::CrosstermBackend;
use ratatui::{DefaultTerminal, Terminal};
use signal_hook::consts::SIGTSTP;

use super::draw;
use super::history::{Past, seconds};
use super::model::{Action, Model};
use gauge_bus::clock::{Clock, RealClock};
use gaugefs_client::watch::Watch;
use gaugefs_host::error::{Error, Result};
use gaugefs_host::signals;

/// The longest delay until a report or a signal is noticed.
pub(crate) const STEP: Duration = Duration::from_millis(100);

/// Time for the screen to end by itself.
const GRACE: Duration = Duration::from_secs(1);

pub(crate) fn failed(error: &io::Error) -> Error {
    Error::io("terminal", "cannot use it", error)
}

/// Shows the screen until the user quits. ratatui restores the terminal after a panic too.
pub(super) fn run(watch: Watch, every: Duration, logs: Vec<Past>) -> Result<()> {
    let ends = Arc::new(AtomicBool::new(false));
    let stops = Arc::new(AtomicBool::new(false));
    for signal in signals::ends() {
        signal_hook::flag::register(signal as i32, ends.clone()).map_err(|error| failed(&error))?;
    }
    signal_hook::flag::register(SIGTSTP, stops.clone()).map_err(|error| failed(&error))?;
    let left = watch_terminal(ends.clone())?;
    let colour = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let model = Model::new(every.as_secs_f64(), colour).with(logs);
    let mut terminal = ratatui::try_init().map_err(|error| failed(&error))?;
    let outcome = show(&mut terminal, watch, model, &ends, &stops);
    left.store(true, Ordering::SeqCst);
    ratatui::try_restore().map_err(|error| failed(&error))?;
    outcome
}

/// Ends the process if its terminal is gone, or if it was told to end and does not: crossterm reads the end of a lost
/// terminal for ever. The returned flag notes that the program has left the terminal by itself.
fn watch_terminal(ends: Arc<AtomicBool>) -> Result<Arc<AtomicBool>> {
    let left = Arc::new(AtomicBool::new(false));
    let has_left = left.clone();
    let watch = move || {
        let mut since: Option<Instant> = None;
        while !has_left.load(Ordering::SeqCst) {
            let stdin = io::stdin();
            // Only a hangup or an error counts.
            let mut terminal = [PollFd::new(stdin.as_fd(), PollFlags::empty())];
            let is_gone = poll(&mut terminal, PollTimeout::ZERO).is_ok_and(|count| count > 0);
            if is_gone {
                ends.store(true, Ordering::SeqCst);
            }
            if !ends.load(Ordering::SeqCst) {
                since = None;
            } else if since.get_or_insert_with(Instant::now).elapsed() > GRACE {
                // There may be nothing left to restore.
                let _ = ratatui::try_restore();
                std::process::exit(1);
            }
            RealClock::new().sleep(STEP);
        }
    };
    std::thread::Builder::new().stack_size(128 * 1024).spawn(watch).map_err(|error| failed(&error))?;
    Ok(left)
}

fn show(
    terminal: &mut DefaultTerminal,
    mut watch: Watch,
    mut model: Model,
    ends: &AtomicBool,
    stops: &AtomicBool,
) -> Result<()> {
    let mut drawn = 0.0;
    let mut changed = true;
    loop {
        let now = seconds(jiff::Timestamp::now());
        model.add_mounts(&watch.roots, now);
        while let Ok(report) = watch.reports.try_recv() {
            model.update(report, now);
            changed = true;
        }
        for (root, order) in model.orders(now) {
            watch.order(root, order);
        }
        // Ages in seconds change the screen every second.
        if changed || (now - drawn).abs() >= 1.0 {
            watch.find_mounts()?;
            terminal.draw(|frame| draw::screen(frame, &model, now)).map_err(|error| failed(&error))?;
            (drawn, changed) = (now, false);
        }
        let mut action = Action::Nothing;
        if event::poll(STEP).map_err(|error| failed(&error))? {
            changed = true;
            match event::read().map_err(|error| failed(&error))? {
                Event::Key(key) if key.kind != KeyEventKind::Release => action = model.key(key, now),
                _ => {}
            }
        }
        if action == Action::Quit || ends.load(Ordering::SeqCst) {
            return Ok(());
        }
        if action == Action::Suspend || stops.swap(false, Ordering::SeqCst) {
            terminal.show_cursor().and_then(|()| ratatui::try_restore()).map_err(|error| failed(&error))?;
            // The handler of SIGTSTP only sets a flag; SIGSTOP stops the process.
            raise(Signal::SIGSTOP).map_err(|errno| failed(&errno.into()))?;
            let again = enable_raw_mode()
                .and_then(|()| execute!(io::stdout(), EnterAlternateScreen, Clear(ClearType::All)));
            // A new terminal, because the screen no longer shows the last drawing.
            let again = again.and_then(|()| Terminal::new(CrosstermBackend::new(io::stdout())));
            *terminal = again.map_err(|error| failed(&error))?;
            changed = true;
        }
    }
}
