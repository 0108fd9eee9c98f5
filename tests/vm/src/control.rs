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

use gauge_sim::Knob;

use crate::adapter::Bench;
use crate::gauge::Gauge;
use crate::qmp::Slot;
use crate::wire::{Counters, Wire};

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

impl Bench {
    fn command(&mut self, words: &[&str]) -> Result<String, String> {
        let Self { gauge, wire, beside } = self;
        match *words {
            ["beside", chip, address] if address.starts_with("0x") => {
                let address = u16::from_str_radix(&address[2..], 16);
                let address = address.map_err(|_| "not an address".to_owned())?;
                let wire = Wire { address, ..Wire::default() };
                *beside = Some(Box::new(Self { gauge: Gauge::new(chip)?, wire, beside: None }));
            }
            ["beside", ref command @ ..] => {
                return beside.as_mut().ok_or("there is no gauge beside it")?.command(command);
            }
            ["set", knob, ref value @ ..] if !value.is_empty() => {
                gauge.sim.set(knob, &value.join(" ")).map_err(|error| error.to_string())?;
            }
            ["get", knob] => {
                let value = gauge.sim.get(knob).ok_or_else(|| format!("{knob}: there is no such knob"))?;
                return Ok(value + "\n");
            }
            ["gauge", chip] => *gauge = Gauge::new(chip)?,
            ["knobs"] => {
                let line = |knob: &Knob| format!("{}: {}\n", knob.name, knob.help);
                return Ok(gauge.sim.knobs().iter().map(line).collect());
            }
            ["pass", seconds] => {
                gauge.clock.pass(seconds.parse().map_err(|_| format!("{seconds}: not a time"))?);
            }
            ["pace", "on"] => gauge.clock.pace(true),
            ["pace", "off"] => gauge.clock.pace(false),
            ["strange", "on"] => wire.strange = true,
            ["strange", "off"] => wire.strange = false,
            ["counters"] => {
                let Counters { transfers, bytes, bits, refused } = wire.counters;
                return Ok(format!("transfers {transfers}\nbytes {bytes}\nbits {bits}\nrefused {refused}\n"));
            }
            ["counters", "reset"] => wire.counters = Counters::default(),
            ["log"] => return Ok(gauge.sim.log().iter().map(|record| format!("{record}\n")).collect()),
            ["log", "clear"] => gauge.sim.clear_log(),
            _ => return Err(format!("{}: no such command", words.join(" "))),
        }
        Ok(String::new())
    }
}
