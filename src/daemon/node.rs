// SPDX-License-Identifier: MIT

//! `kernel-node`: a gauge as a battery of the kernel.
//!
//! The daemon serves an adapter with a Smart Battery, and the kernel's `sbs-battery` makes a power supply of it.
//! [`plug`] is root's part: it plugs in the adapter, binds the driver, opens the supply's `uevent`, and ends. In a
//! service `gaugefs attach` does it, and passes the open files to the daemon, which may not open them.
//!
//! The kernel releases an adapter when its socket closes, however the daemon ends.

use std::fs::{self, File};
use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::net::Shutdown;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{FileExt, FileTypeExt};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use i2c_server::{Adapter, Errno, Target, usb};
use nix::sched::{CloneFlags, unshare};
use rustix::net::{
    self, AddressFamily, RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, SocketAddrUnix, SocketFlags, SocketType, sockopt,
};

use super::service;
use crate::config::Setup;
use crate::error::{Cause, Error, Result};
use crate::fs::{BATTERY_ADDRESS, BatteryEvent, Fs, SmartBattery, battery_obstacle};
use crate::vhci::{self, Plugged};
use gauge_bus::clock::{Clock, RealClock};
use gauge_owner::{GaugeOptions, Signal};
use ti_gauge::chip::Chip;

const OPTION: &str = "kernel-node";
/// The kernel's driver, and its name for the bound device.
const DRIVER: &str = "sbs-battery";
const DEVICES: &str = "/sys/bus/i2c/devices";
/// Between two events: each makes the kernel read everything from the battery. Changes are still told within a second.
const PAUSE: Duration = Duration::from_millis(500);
/// Longest message, in bytes.
const LONGEST: usize = 256;

impl Target for SmartBattery {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), Errno> {
        if SmartBattery::transfer(self, write, read) { Ok(()) } else { Err(Errno::NXIO) }
    }
}

/// Items that root's part passes to the daemon, each with an open file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Adapter = 1,
    /// The battery's `uevent`.
    Event = 2,
}

/// The meeting point of root's part and the daemon: a pair of sockets. The named one is root's.
pub(super) struct Offer {
    ours: OwnedFd,
    roots: OwnedFd,
}

/// A wanted battery: its gauge's index in the tree, and its polling interval.
pub(super) struct Wanted {
    pub(super) gauge: u16,
    pub(super) name: String,
    pub(super) interval: Duration,
}

#[derive(Clone, Default)]
pub(super) struct Nodes(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    sockets: Vec<UnixStream>,
    is_ending: bool,
}

impl Offer {
    /// Makes the pair of sockets. Call it before root's part starts.
    pub(super) fn new() -> Result<Self> {
        let make = || {
            let (ours, roots) =
                net::socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?;
            // The kernel chooses a name, which tells the two apart.
            net::bind(&roots, &SocketAddrUnix::new_unnamed())?;
            rustix::io::Result::Ok(Self { ours, roots })
        };
        make().map_err(|errno| Error::io(OPTION, "cannot make a socket", &errno.into()))
    }

    /// Serves what root's part passes on, for these gauges, from separate threads.
    pub(super) fn serve(&self, tree: &Arc<Fs>, signal: &Arc<Signal>, wanted: Vec<Wanted>) -> Result<Nodes> {
        let failed = |errno: Errno| Error::io(OPTION, "cannot speak to root's part", &errno.into());
        let ours =
            self.ours.try_clone().map_err(|error| Error::io(OPTION, "cannot copy a socket", &error))?;
        // The number of gauges stands for an answer.
        net::send(&ours, &(wanted.len() as u16).to_ne_bytes(), SendFlags::NOSIGNAL).map_err(failed)?;
        let nodes = Nodes::default();
        let (tree, signal, kept) = (Arc::clone(tree), Arc::clone(signal), nodes.clone());
        spawn("nodes", move || {
            while let Ok(Some((kind, number, name, file))) = receive(ours.as_fd()) {
                let Some(gauge) = wanted.get(usize::from(number)) else { continue };
                let battery = SmartBattery::new(Arc::clone(&tree), gauge.gauge);
                let done = match kind {
                    Kind::Adapter => kept.serve(UnixStream::from(file), battery),
                    Kind::Event => {
                        log::info!("{}: {name} is its battery of the kernel's", gauge.name);
                        let (signal, limit) = (Arc::clone(&signal), 3 * gauge.interval);
                        spawn("events", move || tell(File::from(file), &battery, &signal, limit))
                    }
                };
                if let Err(error) = done {
                    log::error!("{}: {error}", gauge.name);
                }
            }
        })?;
        Ok(nodes)
    }

    /// Root's part, within the daemon.
    pub(super) fn plug(&self) -> Result<()> {
        plug(self.roots.as_fd(), usize::MAX)
    }
}

impl Nodes {
    fn serve(&self, socket: UnixStream, battery: SmartBattery) -> Result<()> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if state.is_ending {
            return Ok(());
        }
        let copy = socket.try_clone().map_err(|error| Error::io(OPTION, "cannot copy a socket", &error))?;
        state.sockets.push(copy);
        let adapter = Adapter::new().with(BATTERY_ADDRESS, battery);
        spawn("battery", move || {
            if let Err(error) = usb::serve(&socket, &adapter) {
                log::error!("{OPTION}: the kernel cannot be spoken to: {error}");
            }
            // Otherwise the copy would keep it open.
            let _ = socket.shutdown(Shutdown::Both);
        })
    }

    /// Removes the kernel's batteries, and plugs in no other.
    pub(super) fn end(&self) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.is_ending = true;
        for socket in state.sockets.drain(..) {
            let _ = socket.shutdown(Shutdown::Both);
        }
    }
}

/// Makes the kernel send an event after every change that is worth one.
fn tell(uevent: File, battery: &SmartBattery, signal: &Signal, limit: Duration) {
    // During a write the kernel reads the battery, and this thread waits for it, even after SIGKILL. So it keeps no
    // copy of the socket, which would look to the kernel like a battery that is only slow.
    if unshare(CloneFlags::CLONE_FILES).is_ok() {
        close_all_but(uevent.as_raw_fd());
    }
    let clock = RealClock::new();
    let mut told: BatteryEvent = None;
    let mut seen = 0;
    loop {
        let now = battery.told();
        if now != told {
            if uevent.write_all_at(b"change", 0).is_err() {
                return;
            }
            told = now;
            clock.sleep(PAUSE);
        }
        // Values that are not renewed disappear without a signal.
        seen = signal.wait(seen, told.is_some().then_some(limit));
    }
}

/// Closes this thread's descriptors, except that one and the standard ones.
fn close_all_but(kept: i32) {
    let open = fs::read_dir("/proc/thread-self/fd").into_iter().flatten().flatten();
    let open: Vec<i32> = open.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect();
    for descriptor in open.into_iter().filter(|&descriptor| descriptor > 2 && descriptor != kept) {
        let _ = nix::unistd::close(descriptor);
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<()> {
    let thread = std::thread::Builder::new().name(name.into()).stack_size(128 * 1024).spawn(work);
    thread.map(drop).map_err(|error| Error::io(OPTION, "cannot start a thread", &error))
}

/// Whether a gauge is to be offered.
pub(super) fn is_wanted(options: &GaugeOptions) -> bool {
    options.kernel_node
}

/// Checks that a gauge can be offered: by its chip, if known, by whether the mount covers the kernel's supplies, and by
/// who can run root's part.
pub(super) fn check(name: &str, chip: Option<&Chip>, covers: bool, may_plug: bool) -> Result<()> {
    if !may_plug {
        let why = "only root may offer a gauge to the kernel; mount with sudo or as a service, or leave out kernel-node";
        return Err(Error::new(name, Cause::NotPermitted, why));
    }
    if covers {
        let why = "a mount over the kernel's supplies would show the gauge twice, as it is and as the kernel's battery; mount \
                   elsewhere, or leave out kernel-node";
        return Err(Error::new(name, Cause::Invalid, why));
    }
    chip.map_or(Ok(()), |chip| check_chip(name, chip))
}

/// Checks that gauges of that chip can be offered.
pub(super) fn check_chip(name: &str, chip: &Chip) -> Result<()> {
    let refuse = |why: String| Error::new(name, Cause::Invalid, format!("{why}; leave out kernel-node"));
    battery_obstacle(chip).map_or(Ok(()), |why| Err(refuse(why)))
}

/// Root's part for the service in process `pid`.
pub(crate) fn attach(pid: i32, setup: &Setup) -> Result<()> {
    let most = setup.gauges.iter().filter(|gauge| gauge.kernel_node).count();
    if most == 0 {
        return Ok(());
    }
    let Some(socket) = end_of_root(pid)? else {
        let why = "it offers no battery; its options are other ones";
        return Err(Error::host(format!("process {pid}"), nix::errno::Errno::ENOENT, why));
    };
    plug(socket.as_fd(), most)
}

/// A copy of that process's root end of the sockets.
fn end_of_root(pid: i32) -> Result<Option<OwnedFd>> {
    let is_it = |socket: &OwnedFd| {
        sockopt::socket_domain(socket) == Ok(AddressFamily::UNIX)
            && sockopt::socket_type(socket) == Ok(SocketType::SEQPACKET)
            && net::getsockname(socket).is_ok_and(|name| {
                let name = SocketAddrUnix::try_from(name).ok();
                // A socket without a name shows an empty one.
                name.is_some_and(|name| name.abstract_name().is_some_and(|name| !name.is_empty()))
            })
    };
    service::descriptor_of(pid, "end of a socket", |status| status.file_type().is_socket(), is_it)
}

/// Plugs in an adapter for each gauge that the daemon at the socket's other end offers, up to `most`, makes the kernel
/// create its battery, and passes on what the daemon needs.
fn plug(daemon: BorrowedFd<'_>, most: usize) -> Result<()> {
    let failed = |errno: Errno| Error::io(OPTION, "cannot speak to the daemon", &errno.into());
    let mut count = [0; 2];
    net::recv(daemon, &mut count, RecvFlags::empty()).map_err(failed)?;
    vhci::load(vhci::MODULES);
    vhci::load(&[DRIVER]);
    for number in 0..u16::from_ne_bytes(count).min(most.try_into().unwrap_or(u16::MAX)) {
        let Plugged { socket, port } = vhci::plug(OPTION)?;
        send(daemon, Kind::Adapter, number, "", socket.as_fd()).map_err(failed)?;
        drop(socket);
        let (name, uevent) = bind(port)?;
        send(daemon, Kind::Event, number, &name, uevent.as_fd()).map_err(failed)?;
    }
    Ok(())
}

/// Binds the kernel's driver to the Smart Battery on the adapter at that port. Returns the power supply's name and
/// `uevent`.
fn bind(port: u32) -> Result<(String, File)> {
    let missing = |what: &str| {
        let why = format!(
            "the kernel has made no {what}; load its modules: sudo modprobe -a i2c-tiny-usb {DRIVER}"
        );
        Error::new(OPTION, Cause::NotNow, why)
    };
    let failed = |what: &str, error: &std::io::Error| Error::io(OPTION, what, error);
    let adapter =
        vhci::adapter(Path::new(DEVICES), port, vhci::PATIENCE).ok_or_else(|| missing("adapter of it"))?;
    fs::write(adapter.join("new_device"), format!("{DRIVER} {BATTERY_ADDRESS:#04x}"))
        .map_err(|error| failed("the kernel refuses the battery", &error))?;
    let number = adapter.file_name().and_then(|name| name.to_str()?.strip_prefix("i2c-")).unwrap_or_default();
    let supplies = adapter.join(format!("{number}-{BATTERY_ADDRESS:04x}/power_supply"));
    let supply =
        vhci::entry(&supplies, vhci::PATIENCE, |_| true).ok_or_else(|| missing("power supply of it"))?;
    let uevent = File::options()
        .write(true)
        .open(supply.join("uevent"))
        .map_err(|error| failed("cannot open its uevent", &error))?;
    let name = supply.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Ok((name, uevent))
}

fn send(
    to: BorrowedFd<'_>,
    kind: Kind,
    number: u16,
    name: &str,
    file: BorrowedFd<'_>,
) -> std::result::Result<(), Errno> {
    let message = [&[kind as u8], &number.to_ne_bytes()[..], name.as_bytes()].concat();
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut files = SendAncillaryBuffer::new(&mut space);
    let files_sent = [file];
    files.push(SendAncillaryMessage::ScmRights(&files_sent));
    net::sendmsg(to, &[IoSlice::new(&message)], &mut files, SendFlags::NOSIGNAL).map(drop)
}

/// The next message; `None` when nobody can send one any more.
fn receive(from: BorrowedFd<'_>) -> std::result::Result<Option<(Kind, u16, String, OwnedFd)>, Errno> {
    let mut message = [0; LONGEST];
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut files = RecvAncillaryBuffer::new(&mut space);
    let length =
        net::recvmsg(from, &mut [IoSliceMut::new(&mut message)], &mut files, RecvFlags::CMSG_CLOEXEC)?.bytes;
    let file = files.drain().find_map(|part| match part {
        RecvAncillaryMessage::ScmRights(mut files) => files.next(),
        _ => None,
    });
    let ([kind, low, high, name @ ..], Some(file)) = (&message[..length], file) else { return Ok(None) };
    let kind = if *kind == Kind::Adapter as u8 { Kind::Adapter } else { Kind::Event };
    let name = String::from_utf8_lossy(name).into_owned();
    Ok(Some((kind, u16::from_ne_bytes([*low, *high]), name, file)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regression_root_took_the_end_that_the_daemon_reads_from() {
        let offer = Offer::new().expect("a pair of sockets");
        let root = end_of_root(std::process::id() as i32).expect("its descriptors").expect("its end");
        net::send(&offer.ours, b"2", SendFlags::DONTWAIT).expect("room");
        let mut heard = [0; 2];
        let length = net::recv(&root, &mut heard, RecvFlags::DONTWAIT).map(|(length, _)| length);
        assert_eq!((length, heard[0]), (Ok(1), b'2'));
    }
}
