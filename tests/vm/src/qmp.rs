// SPDX-License-Identifier: MIT

//! Pulls the adapter out of the running machine and puts it back, over QEMU's monitor protocol.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

/// The slot that the adapter sits in. The names are those of `run`'s QEMU command line.
#[derive(Clone, Debug)]
pub(crate) struct Slot {
    /// QEMU's monitor socket.
    pub(crate) monitor: PathBuf,
    /// The socket of this back end.
    pub(crate) bus: PathBuf,
}

impl Slot {
    /// Returns when the guest has let the device go.
    pub(crate) fn unplug(&self) -> Result<(), String> {
        let mut monitor = Monitor::open(self)?;
        monitor.execute(r#"{"execute":"device_del","arguments":{"id":"gauge"}}"#, Some("DEVICE_DELETED"))?;
        // A device added on the chardev of the one before freezes QEMU.
        monitor.execute(r#"{"execute":"chardev-remove","arguments":{"id":"bus"}}"#, None)
    }

    /// Presses a key of the machine's keyboard, which wakes one that is asleep.
    pub(crate) fn press(&self) -> Result<(), String> {
        let key = r#"{"execute":"send-key","arguments":{"keys":[{"type":"qcode","data":"shift"}]}}"#;
        Monitor::open(self)?.execute(key, None)
    }

    /// Returns when the device is in its slot; the guest finds it a little later.
    pub(crate) fn plug(&self) -> Result<(), String> {
        let mut monitor = Monitor::open(self)?;
        let address = format!(r#"{{"type":"unix","data":{{"path":"{}"}}}}"#, self.bus.display());
        let backend = format!(r#"{{"type":"socket","data":{{"addr":{address},"server":false}}}}"#);
        let chardev =
            format!(r#"{{"execute":"chardev-add","arguments":{{"id":"bus","backend":{backend}}}}}"#);
        monitor.execute(&chardev, None)?;
        let device = concat!(
            r#"{"execute":"device_add","arguments":{"driver":"vhost-user-i2c-pci","#,
            r#""id":"gauge","chardev":"bus","bus":"hole"}}"#
        );
        monitor.execute(device, None)
    }
}

struct Monitor(BufReader<UnixStream>);

impl Monitor {
    fn open(slot: &Slot) -> Result<Self, String> {
        let stream = UnixStream::connect(&slot.monitor).map_err(|error| format!("monitor: {error}"))?;
        // A guest on a busy machine lets a device go when it gets to it.
        stream.set_read_timeout(Some(Duration::from_secs(180))).map_err(|error| error.to_string())?;
        let mut monitor = Self(BufReader::new(stream));
        monitor.execute(r#"{"execute":"qmp_capabilities"}"#, None)?;
        Ok(monitor)
    }

    /// Sends a command and waits for its answer, and for an event where one is named. QEMU's
    /// answers are a line each, so that no parser is needed to tell them apart.
    fn execute(&mut self, command: &str, event: Option<&str>) -> Result<(), String> {
        writeln!(self.0.get_mut(), "{command}").map_err(|error| format!("monitor: {error}"))?;
        let (mut answered, mut happened) = (false, event.is_none());
        while !(answered && happened) {
            let mut line = String::new();
            if self.0.read_line(&mut line).map_err(|error| format!("monitor: {error}"))? == 0 {
                return Err("monitor: closed".to_owned());
            }
            if line.starts_with(r#"{"error""#) {
                return Err(format!("{command}: {}", line.trim()));
            }
            answered |= line.starts_with(r#"{"return""#);
            happened |=
                event.is_some_and(|event| line.contains(event) && line.contains(r#""device": "gauge""#));
        }
        Ok(())
    }
}
