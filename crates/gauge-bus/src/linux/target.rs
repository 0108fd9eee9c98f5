// SPDX-License-Identifier: MIT

//! One address of an adapter: how it is claimed, locked and spoken to, and what the kernel's errnos mean.

use std::fmt;
use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use i2cdev::core::{I2CMessage, I2CTransfer};
use i2cdev::linux::{LinuxI2CDevice, LinuxI2CError, LinuxI2CMessage};
use nix::errno::Errno;
use nix::libc;

use super::spd::Writes;
use super::{Adapter, functions, hold, reach, smbus};
use crate::adapters::{AdapterModel, error_of};
use crate::bounded::{Bounded, PATIENCE};
use crate::clock::Clock;
use crate::error::{Driver, Error, ErrorKind, Result};
use crate::{Bus, BusError, Packet, Reach};

/// Bus-free time that the gauges need between transfers at 400 kHz; it costs little at 100 kHz.
const BUS_FREE: Duration = Duration::from_micros(66);

/// One target address of an adapter. A driver that hangs in a transfer is waited for no longer than [`PATIENCE`].
pub struct LinuxBus {
    target: Bounded,
    name: String,
}

struct Target {
    adapter: Adapter,
    address: u8,
    model: Option<&'static AdapterModel>,
    /// What the adapter that was there last carries.
    reach: Reach,
    writes: Writes,
    clock: Arc<dyn Clock>,
    /// `None` while the adapter is unplugged.
    device: Option<LinuxI2CDevice>,
    /// The nodes of the adapters in front of a mux, with locks of the same address.
    above: Vec<File>,
    last: Duration,
}

impl fmt::Debug for LinuxBus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl LinuxBus {
    /// Opens an adapter, whose driver is waited for, and claims an address on it. Nothing is sent.
    pub fn open(adapter: Adapter, address: u8, clock: Arc<dyn Clock>) -> Result<Self> {
        adapter.wait_until_started(&*clock);
        let device = LinuxI2CDevice::new(&adapter.path, address.into());
        let device = device.map_err(|error| refusal(&adapter, address, errno(&error)))?;
        let above = hold_all(&device, &adapter, address).map_err(|other| {
            let place = match other {
                Some(number) => format!("uses that address on i2c-{number}, in front of the mux"),
                None => "is using the gauge".into(),
            };
            let why = format!("another gaugefs {place}; `gaugefs umount` its mount point first");
            Error::new(subject(&adapter, address), ErrorKind::Busy, why)
        })?;
        if !reach(functions(&device).unwrap_or(0), None).carries(1, 2) {
            let why = "the adapter has neither plain I2C nor SMBus commands for words; connect the gauge to another one";
            return Err(Error::new(adapter.to_string(), ErrorKind::NoWords, why));
        }
        let number = adapter.number();
        Ok(Self::new(adapter, number, address, clock, Some((device, above))))
    }

    /// A target whose adapter is absent or cannot be opened yet: each transfer tries to open it.
    pub fn absent(path: &Path, address: u8, clock: Arc<dyn Clock>) -> Self {
        let name = path.file_name().and_then(|name| name.to_str()?.strip_prefix("i2c-")?.parse().ok());
        let adapter = Adapter { path: path.to_path_buf(), device: 0 };
        Self::new(adapter, name.unwrap_or_default(), address, clock, None)
    }

    fn new(
        adapter: Adapter,
        number: u64,
        address: u8,
        clock: Arc<dyn Clock>,
        open: Option<(LinuxI2CDevice, Vec<File>)>,
    ) -> Self {
        let name = format!("{adapter} 0x{address:02x}");
        let last = clock.now().saturating_sub(BUS_FREE);
        let model = open.as_ref().and_then(|_| adapter.model());
        let reach = open.as_ref().map_or(Reach::FULL, |(device, _)| carried(device, model));
        let writes = Writes::to(Path::new("/"), number, address);
        let (device, above) = open.map_or((None, Vec::new()), |(device, above)| (Some(device), above));
        let target =
            Target { adapter, address, model, reach, writes, clock: clock.clone(), device, above, last };
        let named = (number, target.adapter.to_string());
        Self { target: Bounded::new(target, named, PATIENCE, clock), name }
    }
}

impl Bus for LinuxBus {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.target.transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.target)
    }
}

impl Target {
    /// The open device; opens it again if the adapter was unplugged and is back.
    fn device(&mut self) -> Result<&mut LinuxI2CDevice, BusError> {
        self.release_if_gone();
        match &mut self.device {
            Some(device) => Ok(device),
            gone => {
                self.adapter = Adapter::find(&self.adapter.path).map_err(|_| BusError::Gone)?;
                if self.adapter.is_starting() {
                    return Err(BusError::Gone);
                }
                self.model = self.adapter.model();
                let device = LinuxI2CDevice::new(&self.adapter.path, self.address.into());
                let device = device.map_err(|error| claim_error(errno(&error)))?;
                self.adapter.refuse_mux().map_err(|_| BusError::HasMux)?;
                self.above = hold_all(&device, &self.adapter, self.address).map_err(|_| BusError::Busy)?;
                self.reach = carried(&device, self.model);
                self.writes = Writes::to(Path::new("/"), self.adapter.number(), self.address);
                Ok(gone.insert(device))
            }
        }
    }

    fn close(&mut self) {
        self.device = None;
        self.above.clear();
    }
}

impl Target {
    /// Lets the device be asked once, and says what its error means. The transfer writes and reads so many bytes.
    fn ask<T>(
        &mut self,
        (write, read): (usize, usize),
        check: impl FnOnce(Reach) -> Result<(), BusError>,
        ask: impl FnOnce(&mut LinuxI2CDevice, Reach) -> Result<Result<T, BusError>, LinuxI2CError>,
    ) -> Result<T, BusError> {
        let clock = self.clock.clone();
        let since = clock.now().saturating_sub(self.last);
        if since < BUS_FREE {
            clock.sleep(BUS_FREE - since);
        }
        self.device()?;
        let (reach, device) = (self.reach, self.device.as_mut().ok_or(BusError::Gone)?);
        // A driver that gets more may move a part of it and report success.
        check(reach)?;
        let begun = clock.now();
        let moved = ask(device, reach);
        self.last = clock.now();
        let is_write = read == 0;
        match moved {
            Ok(answer) => answer.inspect(|_| {
                if is_write {
                    self.writes.passed();
                }
            }),
            Err(_) if !self.adapter.is_there() => {
                self.close();
                Err(BusError::Gone)
            }
            Err(error) => {
                let (errno, took) = (errno(&error), self.last.saturating_sub(begun));
                let wrote = write > 0;
                let error = match self.model {
                    Some(model) => model.error(errno as i32, wrote, took),
                    None => transfer_error(errno),
                };
                let is_read = || matches!(send(device, reach, &[], &mut [0]), Ok(Ok(())));
                match is_write && error.may_be_no_ack() && self.writes.refused(is_read) {
                    true => Err(BusError::WriteDisabled),
                    false => Err(error),
                }
            }
        }
    }
}

impl Bus for Target {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let lengths = (write.len(), read.len());
        self.ask(
            lengths,
            |reach| reach.check(lengths.0, lengths.1),
            |device, reach| send(device, reach, write, read),
        )
    }

    fn packet(&mut self, packet: Packet) -> Result<Vec<u8>, BusError> {
        self.ask(
            (1, 2),
            |reach| reach.check_packet(packet),
            |device, _| {
                // The switch is this file's; other transfers are without.
                device.set_smbus_pec(packet.pec)?;
                let read = smbus::packet(device, packet);
                device.set_smbus_pec(false)?;
                read.map(Ok)
            },
        )
    }

    fn reach(&mut self) -> Reach {
        self.reach
    }

    fn release_if_gone(&mut self) {
        if !self.adapter.is_there() {
            self.close();
        }
    }

    fn claim(&mut self) -> Result<(), BusError> {
        let address = self.address.into();
        self.device()?.set_slave_address(address).map_err(|error| claim_error(errno(&error)))?;
        self.adapter.refuse_mux().map_err(|_| BusError::HasMux)
    }
}

/// One transfer that the adapter carries; or that it moved only a part of it.
fn send(
    device: &mut LinuxI2CDevice,
    reach: Reach,
    write: &[u8],
    read: &mut [u8],
) -> Result<Result<(), BusError>, LinuxI2CError> {
    if reach.smbus {
        let is_whole = smbus::transfer(device, write, read)?;
        return Ok(if is_whole { Ok(()) } else { Err(BusError::Short) });
    }
    let (wanted, moved) = if read.is_empty() {
        (1, device.transfer(&mut [LinuxI2CMessage::write(write)])?)
    } else if write.is_empty() {
        (1, device.transfer(&mut [LinuxI2CMessage::read(read)])?)
    } else {
        (2, device.transfer(&mut [LinuxI2CMessage::write(write), LinuxI2CMessage::read(read)])?)
    };
    Ok(match moved {
        moved if moved == wanted => Ok(()),
        // Some adapters, such as virtio's, report this when a message is not acknowledged.
        0 => Err(BusError::NoAck),
        _ => Err(BusError::Short),
    })
}

/// What an adapter carries that is open.
fn carried(device: &LinuxI2CDevice, model: Option<&AdapterModel>) -> Reach {
    reach(functions(device).unwrap_or(0), model)
}

/// Locks the gauge on its own adapter, and on each in front of a mux, shared. Returns their nodes, or one in use.
fn hold_all(device: &LinuxI2CDevice, adapter: &Adapter, address: u8) -> Result<Vec<File>, Option<u64>> {
    hold(device, address, libc::F_WRLCK).map_err(|_| None)?;
    let mut nodes = Vec::new();
    for number in adapter.above() {
        // Where this user may not open it, the lock's file excludes root and the services.
        let Ok(node) = File::open(format!("/dev/i2c-{number}")) else { continue };
        hold(&node, address, libc::F_RDLCK).map_err(|_| Some(number))?;
        nodes.push(node);
    }
    Ok(nodes)
}

fn subject(adapter: &Adapter, address: u8) -> String {
    format!("{adapter} address 0x{address:02x}")
}

fn errno(error: &LinuxI2CError) -> Errno {
    match error {
        LinuxI2CError::Errno(errno) => Errno::from_raw(*errno),
        LinuxI2CError::Io(error) => Errno::from_raw(error.raw_os_error().unwrap_or(libc::EIO)),
    }
}

/// Converts the errno of a transfer on an adapter of no model.
fn transfer_error(errno: Errno) -> BusError {
    error_of(errno as i32)
}

/// Converts the errno of claiming an address.
fn claim_error(errno: Errno) -> BusError {
    match errno {
        Errno::EBUSY => BusError::Busy,
        other => transfer_error(other),
    }
}

fn refusal(adapter: &Adapter, address: u8, errno: Errno) -> Error {
    match errno {
        Errno::EBUSY => busy(adapter, address, adapter.driver(address).as_ref()),
        Errno::EACCES | Errno::EPERM => {
            let gid = fs::metadata(&adapter.path).map_or(0, |status| status.gid());
            Error::new(adapter.to_string(), ErrorKind::Forbidden, forbidden(gid))
        }
        _ => Error::io(adapter.to_string(), "cannot open it", &errno.into()),
    }
}

/// A kernel driver is bound to the address: which one, and how to unbind it.
fn busy(adapter: &Adapter, address: u8, driver: Option<&Driver>) -> Error {
    let why = match driver {
        Some(driver) => {
            let place = match driver.bus == adapter.number() {
                true => "the gauge".into(),
                false => format!("0x{address:02x} on i2c-{}, on the other side of a mux", driver.bus),
            };
            format!(
                "the kernel driver {} ({}) is bound to {place}; unbind it as root with {}",
                driver.name,
                driver.device,
                driver.remedy(address)
            )
        }
        None => "a kernel driver is bound to that address; unbind it first".into(),
    };
    let driver = driver.cloned().map(Box::new);
    Error { driver, ..Error::new(subject(adapter, address), ErrorKind::Busy, why) }
}

fn forbidden(gid: u32) -> String {
    let group = nix::unistd::Group::from_gid(gid.into()).ok().flatten();
    match group.filter(|_| gid != 0) {
        Some(group) => format!(
            "no permission; run gaugefs as root, or join the group {0} and log in again: \
             sudo usermod -aG {0} $USER",
            group.name
        ),
        None => "no permission; run gaugefs as root".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linux::I2C_MAJOR;

    #[test]
    fn a_bound_driver_is_named_with_both_remedies() {
        let adapter = Adapter { path: "/dev/i2c-1".into(), device: nix::sys::stat::makedev(I2C_MAJOR, 1) };
        let mut driver = Driver { name: "bq27xxx-battery".into(), device: "bq34z100".into(), bus: 1 };
        let error = busy(&adapter, 0x55, Some(&driver));
        assert_eq!(error.kind, ErrorKind::Busy);
        let text = error.to_string();
        assert!(text.contains("bq27xxx-battery (bq34z100)"), "{text}");
        assert!(text.contains("echo 0x55 > /sys/bus/i2c/devices/i2c-1/delete_device"), "{text}");
        assert!(text.contains("echo 1-0055 > /sys/bus/i2c/drivers/bq27xxx-battery/unbind"), "{text}");
        driver.bus = 4;
        let text = busy(&adapter, 0x55, Some(&driver)).to_string();
        assert!(text.contains("is bound to 0x55 on i2c-4, on the other side of a mux"), "{text}");
        assert!(text.contains("echo 0x55 > /sys/bus/i2c/devices/i2c-4/delete_device"), "{text}");
    }

    #[test]
    fn the_kernels_fault_codes_become_bus_errors() {
        for (errno, error) in [
            (Errno::ENXIO, BusError::NoAck),
            (Errno::EREMOTEIO, BusError::NoAck),
            (Errno::EAGAIN, BusError::ArbitrationLost),
            (Errno::ETIMEDOUT, BusError::Timeout),
            (Errno::ENODEV, BusError::Gone),
            (Errno::EIO, BusError::Other(libc::EIO)),
        ] {
            assert_eq!((transfer_error(errno), claim_error(errno)), (error, error));
        }
        // A busy bus is not a bound driver.
        assert_eq!(
            (transfer_error(Errno::EBUSY), claim_error(Errno::EBUSY)),
            (BusError::Timeout, BusError::Busy)
        );
    }

    /// The numbers are the kernel's, on every architecture.
    #[test]
    fn only_disturbed_transfers_are_worth_sending_again() {
        let passes = |errno| transfer_error(errno).is_transient();
        for errno in [Errno::EAGAIN, Errno::EBADMSG, Errno::EBUSY, Errno::EIO, Errno::ENXIO, Errno::EPROTO] {
            assert!(passes(errno), "{errno}");
        }
        for errno in [Errno::EREMOTEIO, Errno::ESHUTDOWN, Errno::ETIMEDOUT, Errno::EINTR, Errno::EPIPE] {
            assert!(passes(errno), "{errno}");
        }
        for errno in [Errno::EINVAL, Errno::ENODEV, Errno::ENOMEM, Errno::EOPNOTSUPP] {
            assert!(!passes(errno), "{errno}");
        }
    }
}
