// SPDX-License-Identifier: MIT

//! The log, which goes to standard error, a file, or syslog.
//!
//! For syslog, every line is a datagram to `/dev/log` and no connection is kept, because syslog may restart
//! at any time. Without a syslog the line is lost.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;

use env_logger::{Builder, Env, Target};
use jiff::Timestamp;
use log::{Level, Record};
use ti_gauge::text;

use crate::error::{Error, Result};
use gauge_bus::regular;

/// The default of RUST_LOG: information from gaugefs, only warnings from the FUSE library.
const FILTER: &str = "info,fuser=warn";
/// syslog's facility `daemon`, in the upper bits of a priority.
const DAEMON: u8 = 3 << 3;

/// The destination of log lines.
#[derive(Clone, Copy, Debug)]
pub enum Destination<'a> {
    /// Standard error, where systemd or a person adds the time.
    Stderr,
    /// A regular file; every line begins with the time.
    File(&'a Path),
    /// syslog.
    Syslog,
}

/// Starts to log. RUST_LOG selects what is logged; the default is everything from level info up.
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
    // A panic ends one piece of work, and nobody reads the standard error of a daemon.
    std::panic::set_hook(Box::new(|panic| log::error!("{panic}; please report it")));
    // It fails only if the process has a logger already.
    builder.try_init().map_err(|error| Error::io("log", "cannot start it", &io::Error::other(error)))
}

/// Whether a log can be written to a file, as far as that can be seen without a change.
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

/// The prefix of a line: its level, unless that is info.
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
