// SPDX-License-Identifier: MIT

//! `gaugefs-vm-bus`: a simulated gauge behind the I2C adapter of a virtual machine.
//!
//! QEMU's `vhost-user-i2c-pci` connects to the bus socket; the guest then has a real adapter,
//! `/dev/i2c-0`, with the gauge at 0x55. The control socket takes the commands of [`control`].

#![allow(clippy::disallowed_methods, reason = "it reads what the guest and QEMU say")]

mod adapter;
mod bench;
mod control;
mod gauge;
mod qmp;
mod wire;

use std::env;
use std::fs;
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::thread;

use vhost::vhost_user::{self, Listener};
use vhost_user_backend::{Error, VhostUserDaemon};
use vm_memory::{GuestMemoryAtomic, GuestMemoryMmap};

use adapter::Adapter;
use bench::Bench;
use control::Control;
use qmp::Slot;

const USAGE: &str = "usage: gaugefs-vm-bus --chip CHIP --bus SOCKET --control SOCKET [--qmp SOCKET]";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("gaugefs-vm-bus: {why}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), String> {
    let (mut chip, mut bus, mut control, mut monitor) = (None, None, None, None);
    let mut arguments = env::args().skip(1);
    while let Some(option) = arguments.next() {
        let value = arguments.next().ok_or(USAGE)?;
        match option.as_str() {
            "--chip" => chip = Some(value),
            "--bus" => bus = Some(PathBuf::from(value)),
            "--control" => control = Some(PathBuf::from(value)),
            "--qmp" => monitor = Some(PathBuf::from(value)),
            _ => return Err(USAGE.to_owned()),
        }
    }
    let (Some(chip), Some(bus), Some(control)) = (chip, bus, control) else { return Err(USAGE.to_owned()) };

    let bench = Arc::new(Mutex::new(Bench::new(&chip)?));
    let mut listener = Listener::new(&bus, true).map_err(|error| format!("{}: {error}", bus.display()))?;
    let slot = monitor.map(|monitor| Slot { monitor, bus: bus.clone() });
    let commands = Control { bench: Arc::clone(&bench), slot };
    let _ = fs::remove_file(&control);
    let doors = UnixListener::bind(&control).map_err(|error| format!("{}: {error}", control.display()))?;
    thread::spawn(move || commands.serve(doors));

    // One connection is one adapter; after an unplugging there may be another. Whoever started
    // this process ends it.
    loop {
        let memory = GuestMemoryAtomic::new(GuestMemoryMmap::new());
        let adapter = Adapter::new(Arc::clone(&bench), memory.clone()).map_err(|error| error.to_string())?;
        let adapter = Arc::new(Mutex::new(adapter));
        let mut daemon = VhostUserDaemon::new("i2c".to_owned(), adapter, memory)
            .map_err(|error| format!("vhost-user: {error}"))?;
        daemon.start(&mut listener).map_err(|error| format!("vhost-user: {error}"))?;
        match daemon.wait() {
            Ok(()) | Err(Error::HandleRequest(vhost_user::Error::Disconnected)) => {}
            Err(error) => eprintln!("gaugefs-vm-bus: connection ended: {error}"),
        }
        for thread in daemon.get_epoll_handlers() {
            thread.send_exit_event();
        }
    }
}
