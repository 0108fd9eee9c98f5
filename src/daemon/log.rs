// SPDX-License-Identifier: MIT

//! The log, to standard error, a file, or syslog.
//!
//! For syslog, every line is a datagram to `/dev/log` without a lasting connection, because syslog may restart at any
//! time. Without syslog the line is lost.
//!
//! Every refused write to a file of the mount logs a line, so repeated lines are counted.

use std::collections::HashMap;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use env_logger::{Builder, Env, Logger, Target};
use jiff::Timestamp;
use log::{Level, Log, Metadata, Record};
use ti_gauge::text;

use crate::error::{Error, Result};
use gauge_bus::regular;

/// RUST_LOG's default: information from gaugefs, but only warnings from the FUSE library, which logs each second answer
/// of a 32-bit program (`fuse/entry.rs`) as an error.
const FILTER: &str =
    if cfg!(target_pointer_width = "64") { "info,fuser=warn" } else { "info,fuser=warn,fuser::reply=off" };
/// How long similar lines are counted after the first one.
const PERIOD: Duration = Duration::from_secs(60);
/// Kinds of lines told apart in that time.
const KINDS: usize = 100;
/// Replaces all further kinds.
const OTHERS: &str = "further lines are left out, as too many differ";
/// syslog's facility `daemon`, in the upper bits of a priority.
const DAEMON: u8 = 3 << 3;

/// Where log lines go.
#[derive(Clone, Copy, Debug)]
pub enum Destination<'a> {
    /// systemd or a person adds the time.
    Stderr,
    /// A regular file with the time in every line.
    File(&'a Path),
    /// syslog, with the time from there.
    Syslog,
}

/// Starts the log. RUST_LOG selects what is logged; the default is level info and up.
pub fn start(to: Destination<'_>) -> Result<()> {
    let mut builder = Builder::from_env(Env::default().default_filter_or(FILTER));
    match to {
        Destination::Stderr => {
            builder.format(|out, record| writeln!(out, "gaugefs: {}{}", word(record), message(record)));
        }
        Destination::File(path) => {
            let file = regular::open(&options(), path).map_err(|error| cannot_write(path, &error))?;
            builder.target(Target::Pipe(Box::new(file)));
            builder.format(|out, record| {
                writeln!(out, "{:.0} {}{}", Timestamp::now(), word(record), message(record))
            });
        }
        Destination::Syslog => {
            builder.target(Target::Pipe(Box::new(Syslog)));
            let pid = std::process::id();
            builder.format(move |out, record| {
                let priority = DAEMON | severity(record.level());
                write!(out, "<{priority}>gaugefs[{pid}]: {}{}", word(record), message(record))
            });
        }
    }
    // A panic ends one piece of work, and nobody reads a daemon's standard error.
    std::panic::set_hook(Box::new(|panic| log::error!("{panic}; please report it")));
    let logger = builder.build();
    log::set_max_level(logger.filter());
    // It fails only if the process has a logger already.
    let set = log::set_boxed_logger(Box::new(Counting { logger, repeats: Mutex::default() }));
    set.map_err(|error| Error::io("log", "cannot start it", &io::Error::other(error)))
}

/// Checks that a log can be written to a file, as far as possible without a change.
pub(super) fn check(path: &Path) -> Result<()> {
    regular::check_open(&options(), path).map_err(|error| cannot_write(path, &error))
}

fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.append(true).create(true).mode(0o640);
    options
}

fn cannot_write(path: &Path, error: &io::Error) -> Error {
    Error::io(path.display().to_string(), "cannot write the log", error)
}

/// A line's prefix: its level, unless that is info.
fn word(record: &Record<'_>) -> &'static str {
    match record.level() {
        Level::Error => "error: ",
        Level::Warn => "warning: ",
        Level::Info => "",
        Level::Debug => "debug: ",
        Level::Trace => "trace: ",
    }
}

/// A message is one line, whatever names of files and processes it contains.
fn message(record: &Record<'_>) -> String {
    text::printable(&record.args().to_string())
}

fn severity(level: Level) -> u8 {
    match level {
        Level::Error => 3,
        Level::Warn => 4,
        Level::Info => 6,
        Level::Debug | Level::Trace => 7,
    }
}

struct Counting {
    logger: Logger,
    repeats: Mutex<Repeats>,
}

impl Counting {
    fn write(&self, lines: Vec<(Level, String)>) {
        for (level, line) in lines {
            self.logger
                .log(&Record::builder().level(level).target("gaugefs").args(format_args!("{line}")).build());
        }
    }
}

impl Log for Counting {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        self.logger.enabled(metadata)
    }

    fn log(&self, record: &Record<'_>) {
        if !self.logger.matches(record) {
            return;
        }
        let (line, now) = (record.args().to_string(), Instant::now());
        // Held during the write, so that lines keep their order.
        let mut repeats = self.repeats.lock().unwrap_or_else(PoisonError::into_inner);
        self.write(repeats.due(now, PERIOD));
        if repeats.is_news(record.level(), &line, now) {
            self.logger.log(record);
        }
    }

    fn flush(&self) {
        let mut repeats = self.repeats.lock().unwrap_or_else(PoisonError::into_inner);
        self.write(repeats.due(Instant::now(), Duration::ZERO));
        self.logger.flush();
    }
}

/// Lines of the last [`PERIOD`] by kind.
#[derive(Default)]
struct Repeats(HashMap<String, Repeated>);

struct Repeated {
    since: Instant,
    level: Level,
    line: String,
    /// Similar lines that were not written.
    more: u64,
}

impl Repeats {
    /// Whether a line is written instead of counted.
    fn is_news(&mut self, level: Level, line: &str, now: Instant) -> bool {
        // Changes to a gauge, such as each write.
        if level == Level::Info {
            return true;
        }
        let kind = kind(level, line);
        if let Some(known) = self.0.get_mut(&kind) {
            known.more += 1;
            return false;
        }
        let is_one_too_many = self.0.len() >= KINDS;
        if is_one_too_many && level != Level::Warn {
            return true;
        }
        let (kind, line) = if is_one_too_many { (OTHERS.into(), OTHERS) } else { (kind, line) };
        let new = Repeated { since: now, level, line: line.into(), more: 0 };
        self.0.entry(kind).or_insert(new).more += u64::from(is_one_too_many);
        !is_one_too_many
    }

    /// The summaries of lines that were counted for this long, oldest first.
    fn due(&mut self, now: Instant, period: Duration) -> Vec<(Level, String)> {
        let over = self.0.extract_if(|_, repeated| now.duration_since(repeated.since) >= period);
        let mut over: Vec<_> = over.map(|(_, repeated)| repeated).filter(|one| one.more > 0).collect();
        over.sort_by_key(|repeated| repeated.since);
        let text = |Repeated { since, line, more, .. }: &Repeated| {
            let seconds = now.duration_since(*since).as_secs();
            let more = format!("{more} more like it within {seconds} s");
            if line == OTHERS { format!("{OTHERS}: {more}") } else { format!("{line} ({more})") }
        };
        over.iter().map(|repeated| (repeated.level, text(repeated))).collect()
    }
}

/// What similar lines have in common: the whole line, or for a warning all but numbers and quotations, which may be a
/// user's text.
fn kind(level: Level, line: &str) -> String {
    if level != Level::Warn {
        return format!("{level} {line}");
    }
    let outside = line.split('`').step_by(2);
    let letters = outside.flat_map(str::chars).filter(|letter| !letter.is_ascii_digit());
    letters.collect()
}

/// RFC 3164 on a datagram socket. The logger writes one line at a time.
struct Syslog;

impl Write for Syslog {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let sent = UnixDatagram::unbound().and_then(|socket| {
            // A syslog that does not read must not block the daemon.
            socket.set_nonblocking(true)?;
            socket.send_to(line, "/dev/log")
        });
        sent.map(|_| line.len()).or(Ok(line.len()))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The written lines among those of these seconds.
    fn written(lines: &[(u64, Level, &str)]) -> Vec<String> {
        let (start, mut repeats, mut written) = (Instant::now(), Repeats::default(), Vec::new());
        let mut now = start;
        for (second, level, line) in lines {
            now = start + Duration::from_secs(*second);
            written.extend(repeats.due(now, PERIOD).into_iter().map(|(_, line)| line));
            written.extend(repeats.is_news(*level, line, now).then(|| line.to_string()));
        }
        written.extend(repeats.due(now, Duration::ZERO).into_iter().map(|(_, line)| line));
        written
    }

    #[test]
    fn regression_refused_writes_filled_the_disk() {
        let refused: Vec<_> =
            (0..100_000).map(|number| format!("80/53: `{number}x` is not a number")).collect();
        let lines: Vec<_> = refused.iter().map(|line| (0, Level::Warn, line.as_str())).collect();
        let first = "80/53: `0x` is not a number";
        assert_eq!(written(&lines), [first, &format!("{first} (99999 more like it within 0 s)")]);
        // As many kinds as possible, such as one per file.
        let names: Vec<_> = (0..100_000).map(|number| "x".repeat(number % 1000) + " is refused").collect();
        let lines: Vec<_> = names.iter().map(|line| (0, Level::Warn, line.as_str())).collect();
        assert!(written(&lines).len() <= 2 * KINDS + 1);
    }

    #[test]
    fn lines_that_are_alike_are_counted_for_a_minute() {
        let refused = "BAT0: 80/53: out of range";
        let lines = [0, 1, 59, 60, 61].map(|second| (second, Level::Warn, refused));
        let counted = |more, seconds| format!("{refused} ({more} more like it within {seconds} s)");
        assert_eq!(written(&lines), [refused, &counted(2, 60), refused, &counted(1, 1)]);
        // The next line of any kind reports the count.
        let lines = [(0, Level::Warn, refused), (1, Level::Warn, refused), (70, Level::Info, "other")];
        assert_eq!(written(&lines), [refused, &counted(1, 70), "other"]);
    }

    #[test]
    fn each_write_is_logged_with_its_values_whatever_is_refused() {
        // Also one that is repeated.
        let writes: Vec<_> =
            (0..200).map(|value| format!("80/53: {} -> {}", value % 2, (value + 1) % 2)).collect();
        let refused: Vec<_> = (0..200).map(|length| "x".repeat(length)).collect();
        let lines: Vec<_> = writes
            .iter()
            .zip(&refused)
            .flat_map(|(write, refused)| [(0, Level::Warn, refused.as_str()), (0, Level::Info, write)])
            .collect();
        let logged = written(&lines);
        assert_eq!(
            logged.iter().filter(|line| line.starts_with("80/53: ")).collect::<Vec<_>>(),
            writes.iter().collect::<Vec<_>>()
        );
    }
}
