// SPDX-License-Identifier: MIT

//! A [`Bus`] that records every transfer in a file similar to a FlashStream.
//!
//! Commands are `W:` and `R:` lines; times and answers are comments. Keys and security data become `; hidden`.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::clock::Clock;
use crate::error::{Error, Result};
use crate::regular::{self, Replace};
use crate::{Bus, BusError, Packet};

/// The record of one transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A transfer.
    Transfer {
        /// When it ended.
        at: Duration,
        /// The bytes that were written.
        write: Vec<u8>,
        /// How many bytes were to be read.
        read: usize,
        /// The bytes that were read.
        answer: Result<Vec<u8>, BusError>,
    },
    /// A transfer that carried keys or security data.
    Hidden,
}

impl Event {
    fn lines(&self, address: u8) -> String {
        match self {
            Event::Hidden => "; hidden\n".to_string(),
            Event::Transfer { at, write, read, answer } => {
                lines(address, write, *read, answer.as_deref().map_err(|error| *error), at.as_secs_f64())
            }
        }
    }
}

/// The line above the transfers.
const FORM: &str = "; Below each transfer: seconds since the start, and the result.\n";

/// The text of a trace: which gauge, lines about it, which [`replay`] skips, and its recorded transfers.
///
/// [`replay`]: crate::replay
pub fn text(head: &str, about: &[String], address: u8, events: &[Event]) -> String {
    let about = about.iter().map(|line| format!("; {line}\n"));
    let events = events.iter().map(|event| event.lines(address));
    [format!("; gaugefs: {head}\n")]
        .into_iter()
        .chain(about)
        .chain([FORM.to_string()])
        .chain(events)
        .collect()
}

/// Whether a trace can be recorded in a file. One with something in it is refused, unless it is to be replaced.
pub fn check(path: &Path, replace: bool) -> std::io::Result<()> {
    regular::check_open(File::options().append(true), path)?;
    if !replace && path.metadata().is_ok_and(|status| status.len() > 0) {
        return Err(std::io::Error::from(std::io::ErrorKind::AlreadyExists));
    }
    regular::check_replace(path, Replace::Private)
}

/// A bus, and the file in which its transfers are recorded.
pub struct Trace {
    bus: Box<dyn Bus>,
    /// `None` after writing to it has failed: a full disk must not stop the gauge.
    file: Option<File>,
    clock: Arc<dyn Clock>,
    address: u8,
    secret: bool,
}

impl Trace {
    /// Records `bus` in a file that only its owner can read; one with something in it is an error without `replace`.
    pub fn new(
        bus: Box<dyn Bus>,
        address: u8,
        path: &Path,
        clock: Arc<dyn Clock>,
        head: &str,
        replace: bool,
    ) -> Result<Self> {
        let failed = |error| Error::file(path.display().to_string(), "cannot write the trace", &error);
        check(path, replace).map_err(failed)?;
        // An old trace is there until the new one has begun.
        let head = text(head, &[], address, &[]);
        regular::replace(path, head.as_bytes(), Replace::Private).map_err(failed)?;
        let file = regular::open(File::options().append(true), path).map_err(failed)?;
        Ok(Self { bus, file: Some(file), clock, address, secret: false })
    }

    fn note(&mut self, write: &[u8], read: &[u8], result: Result<(), BusError>) {
        let Some(file) = &mut self.file else { return };
        let lines = if self.secret {
            "; hidden\n".to_string()
        } else {
            let answer = result.map(|()| read);
            lines(self.address, write, read.len(), answer, self.clock.now().as_secs_f64())
        };
        if let Err(error) = file.write_all(lines.as_bytes()) {
            log::error!("trace: recording stopped: {error}");
            self.file = None;
        }
    }
}

impl Bus for Trace {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let result = self.bus.transfer(write, read);
        self.note(write, read, result);
        result
    }

    /// As the messages that the host makes of it.
    fn packet(&mut self, packet: Packet) -> Result<Vec<u8>, BusError> {
        let read = self.bus.packet(packet);
        let nothing = [0];
        let (bytes, result) = match &read {
            Ok(bytes) => (&**bytes, Ok(())),
            Err(error) => (&nothing[..], Err(*error)),
        };
        self.note(&[packet.code], bytes, result);
        read
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }

    fn set_secret(&mut self, secret: bool) {
        self.secret = secret;
        self.bus.set_secret(secret);
    }
}

fn lines(address: u8, write: &[u8], read: usize, answer: Result<&[u8], BusError>, at: f64) -> String {
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
    // FlashStream writes the address with its direction bit. Transfers that it cannot express are comments.
    let target = address << 1;
    let command = match (write, read) {
        (_, 0) => format!("W: {target:02X}{}", hex(write)),
        ([register], count) => format!("R: {target:02X} {register:02X} {count}"),
        ([], count) => format!("; R: {target:02X} {count}"),
        (_, count) => format!("; W: {target:02X}{} R: {count}", hex(write)),
    };
    let mut lines = format!("{command}\n; {at:12.6} ");
    // Writing to a String does not fail.
    let _ = match answer {
        Ok([]) => writeln!(lines, "ok"),
        Ok(bytes) => writeln!(lines, "->{}", hex(bytes)),
        Err(error) => writeln!(lines, "failed: {error}"),
    };
    lines
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;
    use crate::clock::SimClock;

    struct Echo;

    impl Bus for Echo {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            read.fill(0xa5);
            if write == [0xff] { Err(BusError::NoAck) } else { Ok(()) }
        }
    }

    #[test]
    fn the_text_of_a_trace_has_lines_about_the_gauge_above_the_transfers() {
        let read =
            |answer| Event::Transfer { at: Duration::from_millis(250), write: vec![8], read: 2, answer };
        let events = [read(Ok(vec![1, 0xa2])), Event::Hidden, read(Err(BusError::Short))];
        assert_eq!(
            text("bq99 on a bus, now", &["Kernel: Linux".into()], 0x55, &events),
            "; gaugefs: bq99 on a bus, now\n; Kernel: Linux\n\
             ; Below each transfer: seconds since the start, and the result.\n\
             R: AA 08 2\n;     0.250000 -> 01 A2\n; hidden\n\
             R: AA 08 2\n;     0.250000 failed: the adapter moved only part of the transfer\n"
        );
    }

    #[test]
    fn transfers_are_recorded_without_keys() {
        let path = std::env::temp_dir().join(format!("gaugefs-trace-{}", std::process::id()));
        let clock = Arc::new(SimClock::new());
        let mut bus = Trace::new(Box::new(Echo), 0x55, &path, clock.clone(), "test", false).expect("a trace");
        clock.sleep(std::time::Duration::from_millis(1500));
        bus.transfer(&[0x61, 0], &mut []).expect("a write");
        bus.transfer(&[0x08], &mut [0; 2]).expect("a read");
        bus.transfer(&[], &mut [0; 1]).expect("a read");
        let _ = bus.transfer(&[0xff], &mut [0; 1]);
        bus.set_secret(true);
        bus.transfer(&[0, 0x14, 0x04], &mut []).expect("a key word");
        bus.set_secret(false);
        let text = std::fs::read_to_string(&path).expect("the trace");
        let again =
            |replace| Trace::new(Box::new(Echo), 0x55, &path, clock.clone(), "again", replace).map(drop);
        assert_eq!(
            again(false).expect_err("it is there").kind,
            crate::ErrorKind::File(std::io::ErrorKind::AlreadyExists)
        );
        assert_eq!(std::fs::read_to_string(&path).expect("the trace"), text, "it was touched");
        again(true).expect("it is replaced");
        assert!(std::fs::read_to_string(&path).expect("the trace").starts_with("; gaugefs: again\n"));
        let mode = std::fs::metadata(&path).expect("the trace").permissions().mode();
        std::fs::remove_file(&path).expect("the trace");
        assert_eq!(mode & 0o777, 0o600);
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(
            lines,
            [
                "W: AA 61 00",
                ";     1.500000 ok",
                "R: AA 08 2",
                ";     1.500000 -> A5 A5",
                "; R: AA 1",
                ";     1.500000 -> A5",
                "R: AA FF 1",
                ";     1.500000 failed: not acknowledged; is the gauge powered and connected?",
                "; hidden",
            ]
        );
    }
}
