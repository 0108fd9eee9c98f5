//! A [`Bus`] that records every transfer in a file similar to a FlashStream.
//!
//! Commands are `W:` and `R:` lines; times and answers are in comments. Transfers that carry keys or security
//! data are replaced by a line `; hidden`.

use std::fmt::Write as _;
use std::fs::{File, Permissions};
use std::io::Write as _;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::clock::Clock;
use crate::error::{Error, Result};
use crate::{Bus, BusError, regular};

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
    /// Records the transfers of `bus` in a file that only its owner can read. An existing file is replaced.
    pub fn new(
        bus: Box<dyn Bus>,
        address: u8,
        path: &Path,
        clock: Arc<dyn Clock>,
        head: &str,
    ) -> Result<Self> {
        let failed = |error| Error::io(path.display().to_string(), "cannot write the trace", &error);
        let mut options = File::options();
        options.write(true).create(true).truncate(true).mode(0o600);
        let mut file = regular::open(&options, path).map_err(failed)?;
        file.set_permissions(Permissions::from_mode(0o600)).map_err(failed)?;
        let form = "; Below each transfer: seconds since the start, and the result.";
        writeln!(file, "; gaugefs: {head}\n{form}").map_err(failed)?;
        Ok(Self { bus, file: Some(file), clock, address, secret: false })
    }

    fn note(&mut self, write: &[u8], read: &[u8], result: Result<(), BusError>) {
        let Some(file) = &mut self.file else { return };
        let lines = if self.secret {
            "; hidden\n".to_string()
        } else {
            lines(self.address, write, read, result, self.clock.now().as_secs_f64())
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

    fn claim(&mut self) -> Result<(), BusError> {
        self.bus.claim()
    }

    fn limit(&mut self, latest: Option<Duration>) {
        self.bus.limit(latest);
    }

    fn release_if_gone(&mut self) {
        self.bus.release_if_gone();
    }

    fn set_secret(&mut self, secret: bool) {
        self.secret = secret;
        self.bus.set_secret(secret);
    }
}

fn lines(address: u8, write: &[u8], read: &[u8], result: Result<(), BusError>, at: f64) -> String {
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
    // FlashStream writes the address with its direction bit. Transfers that it cannot express are comments.
    let target = address << 1;
    let command = match (write, read.len()) {
        (_, 0) => format!("W: {target:02X}{}", hex(write)),
        ([register], count) => format!("R: {target:02X} {register:02X} {count}"),
        ([], count) => format!("; R: {target:02X} {count}"),
        (_, count) => format!("; W: {target:02X}{} R: {count}", hex(write)),
    };
    let mut lines = format!("{command}\n; {at:12.6} ");
    // Writing to a String does not fail.
    let _ = match result {
        Ok(()) if read.is_empty() => writeln!(lines, "ok"),
        Ok(()) => writeln!(lines, "->{}", hex(read)),
        Err(error) => writeln!(lines, "failed: {error}"),
    };
    lines
}

#[cfg(test)]
mod tests {
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
    fn transfers_are_recorded_without_keys() {
        let path = std::env::temp_dir().join(format!("gaugefs-trace-{}", std::process::id()));
        let clock = Arc::new(SimClock::new());
        let mut bus = Trace::new(Box::new(Echo), 0x55, &path, clock.clone(), "test").expect("a trace");
        clock.sleep(std::time::Duration::from_millis(1500));
        bus.transfer(&[0x61, 0], &mut []).expect("a write");
        bus.transfer(&[0x08], &mut [0; 2]).expect("a read");
        bus.transfer(&[], &mut [0; 1]).expect("a read");
        let _ = bus.transfer(&[0xff], &mut [0; 1]);
        bus.set_secret(true);
        bus.transfer(&[0, 0x14, 0x04], &mut []).expect("a key word");
        bus.set_secret(false);
        let text = std::fs::read_to_string(&path).expect("the trace");
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
