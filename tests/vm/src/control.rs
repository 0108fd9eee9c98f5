// SPDX-License-Identifier: MIT

//! The control line: commands that change the gauge or ask about the bus while the guest runs.
//!
//! One command a line; the answer is any number of lines, then `ok` or `error: why`.
//!
//! ```text
//! set KNOB VALUE    get KNOB    knobs      the simulated gauge's
//! gauge CHIP                               another gauge takes its place, as new
//! counters [reset]                         what passed on the bus: transfers bytes bits refused
//! log [clear]                              the last transfers, a line each
//! pass SECONDS                             time goes on by so much, at the gauge's `speed`
//! pace on|off                              the bus takes its time at 100 kHz, or none
//! strange on|off                           what answers is the gauge no more, but something else
//! unplug   plug                            the adapter itself (needs --qmp)
//! key                                      one of the machine's keyboard is pressed (needs --qmp)
//! beside CHIP ADDRESS                      another gauge at another address of the same bus, as new
//! beside COMMAND                           a command to that one
//! after SECONDS COMMAND                    the command is carried out later; nobody hears whether it went through
//! ```

use std::io::{self, BufRead, BufReader, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use crate::bench::Bench;
use crate::qmp::Slot;

/// What a command works on.
#[derive(Clone, Debug)]
pub(crate) struct Control {
    pub(crate) bench: Arc<Mutex<Bench>>,
    pub(crate) slot: Option<Slot>,
}

impl Control {
    /// Answers every connection to `listener`, each on a thread of its own, for ever.
    pub(crate) fn serve(self, listener: UnixListener) {
        for connection in listener.incoming() {
            let control = self.clone();
            match connection {
                Ok(stream) => drop(thread::spawn(move || control.converse(&stream))),
                Err(error) => eprintln!("gaugefs-vm-bus: control: {error}"),
            }
        }
    }

    fn converse(&self, stream: &UnixStream) -> io::Result<()> {
        let mut answer = stream;
        for line in BufReader::new(stream).lines() {
            let text = match self.command(&line?) {
                Ok(lines) => lines + "ok\n",
                Err(why) => format!("error: {why}\n"),
            };
            answer.write_all(text.as_bytes())?;
        }
        Ok(())
    }

    fn command(&self, line: &str) -> Result<String, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        // Unplugging takes the adapter's thread, which may need the bench: no lock meanwhile.
        let slot = || self.slot.as_ref().ok_or_else(|| "started without --qmp".to_owned());
        match words[..] {
            ["unplug"] => return slot()?.unplug().map(|()| String::new()),
            ["plug"] => return slot()?.plug().map(|()| String::new()),
            ["key"] => return slot()?.press().map(|()| String::new()),
            ["after", seconds, ref command @ ..] if !command.is_empty() => {
                let pause =
                    Duration::from_secs(seconds.parse().map_err(|_| format!("{seconds}: not a time"))?);
                let (control, command) = (self.clone(), command.join(" "));
                thread::spawn(move || {
                    thread::sleep(pause);
                    if let Err(why) = control.command(&command) {
                        eprintln!("gaugefs-vm-bus: {command}: {why}");
                    }
                });
                return Ok(String::new());
            }
            _ => {}
        }
        let mut bench = self.bench.lock().unwrap_or_else(PoisonError::into_inner);
        bench.command(&words)
    }
}
