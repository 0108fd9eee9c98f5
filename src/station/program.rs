// SPDX-License-Identifier: MIT

//! `gaugefs-station program`: a station at which one pack after the other is connected.

use std::io::{self, ErrorKind, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
#[cfg(feature = "screen")]
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use clap::Args;
use nix::sys::signal::Signal;
use nix::sys::termios::{FlushArg, tcflush};

use super::file;
use crate::config;
use crate::daemon;
use crate::error::{Cause, Error, Result};
use crate::output::{self, print, say};
use gauge_bus::clock::{Clock, RealClock, SimClock};
use gauge_bus::regular;
use gauge_owner::{Source, lock};
use gauge_station::{Plan, Scanner, Screen};
#[cfg(feature = "screen")]
use gauge_station::{Sign, Totals};
use gaugefs_host::{input, signals};
#[cfg(feature = "screen")]
use gaugefs_screen::line::Board;

const PROGRAM: &str = "\
Waits for a pack, identifies it, writes the image, serial number, date and lot, calibrates it if the
station's file says so, changes its keys, seals it, reads all of it back, and prints PASS or FAIL
with the reason. Then it waits for the next pack. A pack passes only if it has every bit that was
asked for.

The record has a line of JSON for each pack that is begun and one for its outcome, and each pack's
complete image before and after is beside it. If something stops the station in the middle of a
pack, its next start records that this pack has failed. A record that is removed, replaced or
changed while the station runs ends it: no serial number is given without the record.
`gaugefs-station records` shows what is in it.

Ctrl-C ends the station after the pack that is being programmed; a second one ends it at once.
Exit code 0: all packs have passed, 1: one has not passed, an earlier run has left one unfinished,
or the station could not start or go on.

Examples:
  gaugefs-station program --image golden.gm.fs --station line1.toml --check
  gaugefs-station program --image golden.gm.fs --station rehearsal.toml --fast
  gaugefs-station program --image golden.gm.fs --station line1.toml";

/// Interval at which a wait for a line checks whether the station ends.
const LOOK: Duration = Duration::from_millis(200);

/// Program one pack after the other, as a station's file says
#[derive(Args, Debug)]
#[command(after_help = PROGRAM)]
pub(super) struct Program {
    /// Image that every pack gets, in any format that import reads
    #[arg(long, value_name = "FILE")]
    image: PathBuf,
    /// TOML file that describes the station
    #[arg(long, value_name = "FILE")]
    station: PathBuf,
    /// Check both files, and whether the buses can be used; nothing is sent to a gauge
    #[arg(long)]
    check: bool,
    /// End after that many packs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Show the slots as large fields on a terminal of 80 columns and 24 lines or more
    #[cfg(feature = "screen")]
    #[arg(long)]
    screen: bool,
    /// Let simulated packs take no time; every slot has to be simulated
    #[arg(long)]
    fast: bool,
    /// End after one pack
    #[arg(long, conflicts_with = "count")]
    once: bool,
}

impl Program {
    pub(super) fn run(self) -> Result<ExitCode> {
        let is_input = |file: &PathBuf| file.as_os_str() == "-";
        if is_input(&self.station) || is_input(&self.image) && !self.check {
            let why = "it has the serial numbers that are scanned; name files for --image and --station";
            return Err(Error::new("standard input", Cause::Invalid, why));
        }
        let setup = file::read(&self.station, |gauges| daemon::names(gauges, &[]))?;
        if self.fast
            && let Some((name, gauge)) = setup.gauges.iter().find(|(_, gauge)| !config::is_simulated(gauge))
        {
            let why = format!("--fast is for simulated packs, and it is {}", Source::of(gauge)?);
            return Err(Error::new(name, Cause::Invalid, why));
        }
        let plan = Plan::read(&self.image, setup)?;
        if self.check {
            return check(&plan);
        }
        let stops = Arc::new(AtomicBool::new(false));
        let names: Vec<String> = plan.slots().map(String::from).collect();
        let title = format!("{}  {}", plan.name(), input::name(&self.image));
        let clock = || -> Arc<dyn Clock> {
            if self.fast { Arc::new(SimClock::new()) } else { Arc::new(RealClock::new()) }
        };
        let packs = if self.once { Some(1) } else { self.count };
        let failed = Arc::new(AtomicBool::new(false));
        #[cfg(feature = "screen")]
        if self.screen {
            return on_screen(plan, clock, packs, stops, (title, &names));
        }
        #[cfg(not(feature = "screen"))]
        drop((names, title));
        watch_signals(stops.clone(), |line| say(line))?;
        let terminal = Terminal { stops: stops.clone(), failed: failed.clone() };
        let scanner = Box::new(Input::new(terminal.clone()));
        let passed = gauge_station::run(plan, clock, Box::new(terminal), scanner, packs, stops)?;
        let passed = passed && !failed.load(Ordering::SeqCst);
        Ok(if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

fn check(plan: &Plan) -> Result<ExitCode> {
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let found = plan.check(&clock);
    print(&plan.describe())?;
    found.iter().for_each(say);
    Ok(if found.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A signal ends the station when the present packs are done. A second one ends it at once, but for a hangup: a terminal that
/// closes sends several.
fn watch_signals(stops: Arc<AtomicBool>, tell: impl Fn(&str) + Send + 'static) -> Result<()> {
    let signals = signals::block()?;
    thread::spawn(move || {
        let mut is_told = false;
        while let Ok(signal) = signals.wait() {
            stops.store(true, Ordering::SeqCst);
            if signal == Signal::SIGHUP {
                continue;
            }
            if std::mem::replace(&mut is_told, true) {
                lock::remove_all();
                std::process::exit(1);
            }
            tell("ending after the packs that are being programmed; once more to end at once");
        }
    });
    Ok(())
}

/// Runs a station whose slots are shown as large fields.
#[cfg(feature = "screen")]
fn on_screen(
    plan: Plan,
    clock: impl Fn() -> Arc<dyn Clock>,
    packs: Option<u64>,
    stops: Arc<AtomicBool>,
    (title, slots): (String, &[String]),
) -> Result<ExitCode> {
    // Before there is a thread that would take them.
    let signals = signals::block()?;
    let (board, shown) = Board::show(title, slots, stops.clone(), lock::remove_all)?;
    let stopped = stops.clone();
    let told = board.clone();
    thread::spawn(move || {
        while signals.wait().is_ok() {
            stopped.store(true, Ordering::SeqCst);
            told.say("ending after the packs that are being programmed");
        }
    });
    let fields = Fields { board: board.clone(), lines: Arc::default() };
    let passed =
        gauge_station::run(plan, clock, Box::new(fields.clone()), Box::new(fields.clone()), packs, stops);
    shown.end()?;
    for line in fields.lines.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        say(line);
    }
    Ok(if passed? { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The fields of a screen.
#[cfg(feature = "screen")]
#[derive(Clone)]
struct Fields {
    board: Board,
    /// The last totals, for the time after the screen.
    lines: Arc<Mutex<Vec<String>>>,
}

#[cfg(feature = "screen")]
impl Screen for Fields {
    fn outcome(&self, line: &str) {
        self.board.say(line);
    }

    fn prompt(&self, line: &str) {
        self.board.say(line);
    }

    fn sign(&self, slot: &str, sign: Sign, what: &str) {
        self.board.sign(slot, sign, what);
    }

    fn totals(&self, totals: &Totals) {
        let lines = totals.lines();
        // One line of 80 columns.
        let mut short = format!("passed {}, failed {}", totals.passed, totals.failures());
        if let Some(percent) = totals.first_pass_yield() {
            short += &format!(", first-pass yield {percent:.1} %");
        }
        if let Some(mean) = totals.mean_seconds() {
            short += &format!(", {mean:.1} s a pack");
        }
        self.board.totals(short);
        *self.lines.lock().unwrap_or_else(PoisonError::into_inner) = lines;
    }
}

#[cfg(feature = "screen")]
impl Scanner for Fields {
    fn line(&mut self, what: &str) -> Option<String> {
        self.board.ask(what)
    }
}

#[derive(Clone)]
struct Terminal {
    stops: Arc<AtomicBool>,
    /// An outcome could not be printed.
    failed: Arc<AtomicBool>,
}

impl Screen for Terminal {
    /// A station whose outcomes nobody can read ends after the packs that are being programmed.
    fn outcome(&self, line: &str) {
        let printed = print(&format!("{line}\n"));
        if printed.is_ok() && !output::is_closed() {
            return;
        }
        self.stops.store(true, Ordering::SeqCst);
        if let Err(error) = printed {
            self.failed.store(true, Ordering::SeqCst);
            say(error.within(line));
        }
    }

    fn prompt(&self, line: &str) {
        say(line);
    }
}

/// Longest line of standard input, in bytes.
const LONGEST: u64 = 64 << 10;

/// Lines of standard input.
struct Input {
    lines: Option<Receiver<String>>,
    terminal: Terminal,
    /// The last line was not empty.
    has_answered: bool,
}

impl Input {
    fn new(terminal: Terminal) -> Self {
        Self { lines: None, terminal, has_answered: false }
    }
}

impl Scanner for Input {
    fn line(&mut self, what: &str) -> Option<String> {
        // A station that needs none does not read its input.
        let lines = self.lines.get_or_insert_with(|| {
            let (sender, lines) = mpsc::sync_channel(0);
            thread::spawn(move || {
                // Bytes that are no text are asked for again; they do not end the input.
                let text = |line: io::Result<String>| match line {
                    Err(error)
                        if [ErrorKind::InvalidData, ErrorKind::FileTooLarge].contains(&error.kind()) =>
                    {
                        Some(char::REPLACEMENT_CHARACTER.into())
                    }
                    line => line.ok(),
                };
                let lines = regular::lines(io::stdin().lock(), LONGEST);
                lines.map_while(text).try_for_each(|line| sender.send(line).ok())
            });
            lines
        });
        let is_terminal = io::stdin().is_terminal();
        if is_terminal {
            // What was scanned before it was asked for was for nobody. A program that writes lines may be ahead.
            let _ = tcflush(io::stdin(), FlushArg::TCIFLUSH);
            while lines.try_recv().is_ok() {}
        }
        self.terminal.prompt(what);
        loop {
            match lines.recv_timeout(LOOK) {
                // The line feed of a scanner that ends its lines with two characters is no answer to the next question.
                Ok(line) if is_terminal && line.is_empty() && std::mem::take(&mut self.has_answered) => {}
                Ok(line) => {
                    self.has_answered = !line.is_empty();
                    return Some(line);
                }
                Err(RecvTimeoutError::Timeout) if !self.terminal.stops.load(Ordering::SeqCst) => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return None,
            }
        }
    }
}
