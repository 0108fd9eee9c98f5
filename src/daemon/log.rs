//! Where log lines go: standard error, a file, or syslog.
//!
//! syslog is a datagram to `/dev/log` a line, with nothing kept open: it may be restarted at any time,
//! and where there is none the line is lost.

use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;

use env_logger::{Builder, Env, Target};
use jiff::Timestamp;
use log::{Level, Record};

use crate::error::{Error, Result};

/// RUST_LOG's default: gaugefs in brief, and its FUSE library only where something is wrong.
const FILTER: &str = "info,fuser=warn";
/// syslog's number for daemons, times eight.
const DAEMON: u8 = 3 << 3;

/// Where to.
#[derive(Clone, Copy, Debug)]
pub enum Destination<'a> {
    /// Standard error, where systemd or a person adds the time.
    Stderr,
    /// A file, each line with its time.
    File(&'a Path),
    /// The system's log.
    Syslog,
}

/// From now on log lines go there. What RUST_LOG names is logged, else all from info up.
pub fn start(to: Destination<'_>) -> Result<()> {
    let mut builder = Builder::from_env(Env::default().default_filter_or(FILTER));
    match to {
        Destination::Stderr => {
            builder.format(|out, record| writeln!(out, "gaugefs: {}{}", word(record), record.args()));
        }
        Destination::File(path) => {
            let failed = |error| Error::io(path.display().to_string(), "cannot write the log", &error);
            let file = File::options().append(true).create(true).mode(0o640).open(path).map_err(failed)?;
            builder.target(Target::Pipe(Box::new(file)));
            builder.format(|out, record| {
                writeln!(out, "{:.0} {}{}", Timestamp::now(), word(record), record.args())
            });
        }
        Destination::Syslog => {
            builder.target(Target::Pipe(Box::new(Syslog)));
            let pid = std::process::id();
            builder.format(move |out, record| {
                let priority = DAEMON | severity(record.level());
                write!(out, "<{priority}>gaugefs[{pid}]: {}{}", word(record), record.args())
            });
        }
    }
    // A second logger in one process would be a mistake of gaugefs's own.
    builder.try_init().map_err(|error| Error::io("log", "cannot start it", &io::Error::other(error)))
}

/// What stands before a line that is not just information.
fn word(record: &Record<'_>) -> &'static str {
    match record.level() {
        Level::Error => "error: ",
        Level::Warn => "warning: ",
        Level::Info => "",
        Level::Debug => "debug: ",
        Level::Trace => "trace: ",
    }
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
            // A syslog that does not read must not stop a gauge.
            socket.set_nonblocking(true)?;
            socket.send_to(line, "/dev/log")
        });
        sent.map(|_| line.len()).or(Ok(line.len()))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
