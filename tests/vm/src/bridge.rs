// SPDX-License-Identifier: MIT

//! `gaugefs-vm-bridge`: a USB-to-I2C bridge of a guest, with a simulated gauge behind it, or with a mux and two.
//!
//! ```text
//! plug BRIDGE CHIP [CHIP]   plugs it into vhci_hcd and stays; BRIDGE is cp2112, mcp2221 or ft260
//! plug BRIDGE CHIP twice    two bridges with the same gauge behind them
//! say COMMAND               a command to the one that stays
//! ```
//!
//! The firmware of the bridges is a model, from the data sheets and the kernel's drivers. The commands are those of the
//! gauge (`set`, `counters`, ...), with `second` in front those of the second gauge, and:
//!
//! ```text
//! reports [reset]           what passed on USB: output input control, and I2C transfers
//! unplug   plug             the bridge itself
//! pull after TRANSFERS      the same in the middle of that transfer from now
//! absent on|off             nobody acknowledges
//! nack data N               the Nth byte of the next write is not acknowledged
//! nack restart              nor the address after the next repeated START
//! stretch MS TRANSFERS      so many transfers take so much longer
//! ```

#![allow(clippy::disallowed_methods, reason = "it speaks to the script that runs it")]

mod bench;
mod board;
mod gauge;
mod usb;
mod wire;

use std::fs;
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::net::Shutdown;
use std::os::fd::AsRawFd as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::ExitCode;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::{env, thread};

use bench::Bench;
use board::Board;
use usb::{Counts, Device, Request};

const CONTROL: &str = "/tmp/bridge";
const VHCI: &str = "/sys/devices/platform/vhci_hcd.0";

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let outcome = match arguments[..] {
        ["plug", bridge, chip] => plug(bridge, chip, None, 1),
        ["plug", bridge, chip, "twice"] => plug(bridge, chip, None, 2),
        ["plug", bridge, chip, second] => plug(bridge, chip, Some(second), 1),
        ["say", ref words @ ..] => say(&words.join(" ")),
        _ => Err("usage: gaugefs-vm-bridge plug BRIDGE CHIP [CHIP] | say COMMAND".to_owned()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("gaugefs-vm-bridge: {why}");
            ExitCode::FAILURE
        }
    }
}

fn say(command: &str) -> Result<(), String> {
    let failed = |error: io::Error| format!("{CONTROL}: {error}");
    let mut stream = UnixStream::connect(CONTROL).map_err(failed)?;
    writeln!(stream, "{command}").map_err(failed)?;
    for line in BufReader::new(stream).lines() {
        match &*line.map_err(failed)? {
            "ok" => return Ok(()),
            line => match line.strip_prefix("error: ") {
                Some(why) => return Err(format!("{command}: {why}")),
                None => println!("{line}"),
            },
        }
    }
    Err(format!("{command}: no answer"))
}

/// The bridge, plugged in or not.
#[derive(Debug)]
struct Bridge {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    board: Board,
    counts: Counts,
    /// To the kernel, one of each bridge that is plugged in.
    sockets: Vec<Arc<UnixStream>>,
    is_wanted: bool,
}

fn plug(name: &str, chip: &str, second: Option<&str>, bridges: u32) -> Result<(), String> {
    let state = State {
        board: Board::new(Bench::new(chip)?, second.map(Bench::new).transpose()?),
        counts: Counts::default(),
        sockets: Vec::new(),
        is_wanted: true,
    };
    let bridge = Arc::new(Bridge { state: Mutex::new(state), changed: Condvar::new() });
    let _ = fs::remove_file(CONTROL);
    let listener = UnixListener::bind(CONTROL).map_err(|error| format!("{CONTROL}: {error}"))?;
    let commanded = Arc::clone(&bridge);
    thread::spawn(move || commanded.answer(&listener));
    for _ in 1..bridges {
        let (bridge, name) = (Arc::clone(&bridge), name.to_owned());
        thread::spawn(move || {
            if let Err(why) = bridge.live(&name) {
                eprintln!("gaugefs-vm-bridge: {why}");
            }
        });
    }
    bridge.live(name)
}

impl Bridge {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_until_wanted(&self) {
        let waited = self.changed.wait_while(self.lock(), |state| !state.is_wanted);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// One life after the other.
    fn live(&self, name: &str) -> Result<(), String> {
        loop {
            let device = Device::new(usb::firmware(name).ok_or_else(|| format!("{name}: no such bridge"))?);
            self.wait_until_wanted();
            self.run(device)?;
        }
    }

    /// One life of the device, from the plug to the pull.
    fn run(&self, mut device: Device) -> Result<(), String> {
        let socket = {
            // Another bridge would take the same port.
            let mut state = self.lock();
            let socket = Arc::new(attach()?);
            state.sockets.push(Arc::clone(&socket));
            socket
        };
        while let Ok(request) = Request::read(&socket) {
            let state = &mut *self.lock();
            match device.serve(&socket, request, &mut state.board, &mut state.counts) {
                Ok(true) => {}
                Ok(false) => {
                    state.is_wanted = false;
                    break;
                }
                Err(error) => {
                    eprintln!("gaugefs-vm-bridge: {error}");
                    break;
                }
            }
        }
        let _ = socket.shutdown(Shutdown::Both);
        self.lock().sockets.retain(|other| !Arc::ptr_eq(other, &socket));
        Ok(())
    }

    /// Answers each connection, one after the other.
    fn answer(&self, listener: &UnixListener) {
        for stream in listener.incoming().flatten() {
            let mut line = String::new();
            if BufReader::new(&stream).read_line(&mut line).is_err() {
                continue;
            }
            let text = match self.command(&line.split_whitespace().collect::<Vec<_>>()) {
                Ok(lines) => lines + "ok\n",
                Err(why) => format!("error: {why}\n"),
            };
            let _ = (&stream).write_all(text.as_bytes());
        }
    }

    fn command(&self, words: &[&str]) -> Result<String, String> {
        let mut state = self.lock();
        match *words {
            ["plug"] => state.is_wanted = true,
            ["unplug"] => {
                state.is_wanted = false;
                for socket in &state.sockets {
                    let _ = socket.shutdown(Shutdown::Both);
                }
            }
            ["reports"] => {
                let Counts { output, input, control } = state.counts;
                let transfers = state.board.transfers;
                return Ok(format!(
                    "output {output}\ninput {input}\ncontrol {control}\ntransfers {transfers}\n"
                ));
            }
            ["reports", "reset"] => {
                state.counts = Counts::default();
                state.board.transfers = 0;
            }
            _ => return state.board.command(words),
        }
        drop(state);
        self.changed.notify_all();
        Ok(String::new())
    }
}

/// Gives a free port of vhci_hcd one end of a socket. Returns the other.
fn attach() -> Result<UnixStream, String> {
    const FREE: &str = "004";
    const FULL_SPEED: u8 = 2;
    let status = fs::read_to_string(format!("{VHCI}/status")).map_err(|error| format!("{VHCI}: {error}"))?;
    let free = status.lines().find_map(|line| match *line.split_whitespace().collect::<Vec<_>>() {
        ["hs", port, FREE, ..] => port.parse::<u32>().ok(),
        _ => None,
    });
    let port = free.ok_or("vhci_hcd has no free port")?;
    let (ours, theirs) = UnixStream::pair().map_err(|error| error.to_string())?;
    let line = format!("{port} {} {} {FULL_SPEED}", theirs.as_raw_fd(), 0x1_0002 + port);
    fs::write(format!("{VHCI}/attach"), line).map_err(|error| format!("attach: {error}"))?;
    Ok(ours)
}
