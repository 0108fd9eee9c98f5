// SPDX-License-Identifier: MIT

//! One address of an adapter: how it is claimed, locked and spoken to, and what the kernel's errnos mean.

use std::fmt;
use std::fs;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use i2cdev::core::{I2CMessage, I2CTransfer};
use i2cdev::linux::{LinuxI2CDevice, LinuxI2CError, LinuxI2CMessage};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

use super::adapter::Row;
use super::{Adapter, I2C_FUNC_I2C, functions};
use crate::bounded::{Bounded, PATIENCE};
use crate::clock::Clock;
use crate::error::{Driver, Error, ErrorKind, Result};
use crate::{Bus, BusError};

/// Bus-free time that the gauges need between transfers at 400 kHz; it costs little at 100 kHz.
const BUS_FREE: Duration = Duration::from_micros(66);

/// One target address of an adapter. A driver that hangs in a transfer is waited for no longer than [`PATIENCE`].
pub struct LinuxBus {
    target: Bounded,
    name: String,
}

/// A device, as the thread that waits for the kernel needs it.
struct Target {
    adapter: Adapter,
    address: u8,
    /// What is known of the adapter's driver.
    row: Option<&'static Row>,
    clock: Arc<dyn Clock>,
    /// `None` while the adapter is unplugged.
    device: Option<LinuxI2CDevice>,
    last: Duration,
}

impl fmt::Debug for LinuxBus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl LinuxBus {
    /// Opens an adapter and claims an address on it. Nothing is sent.
    pub fn open(adapter: Adapter, address: u8, clock: Arc<dyn Clock>) -> Result<Self> {
        let device = LinuxI2CDevice::new(&adapter.path, address.into());
        let device = device.map_err(|error| refusal(&adapter, address, errno(&error)))?;
        if hold(&device, address).is_err() {
            let why = "another gaugefs is using the gauge; `gaugefs umount` its mount point first";
            return Err(Error::new(subject(&adapter, address), ErrorKind::Busy, why));
        }
        if functions(&device).unwrap_or(0) & I2C_FUNC_I2C == 0 {
            let why = "the adapter speaks only SMBus, not plain I2C; connect the gauge to another one";
            return Err(Error::new(adapter.to_string(), ErrorKind::SmbusOnly, why));
        }
        let number = adapter.number();
        Ok(Self::new(adapter, number, address, clock, Some(device)))
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
        device: Option<LinuxI2CDevice>,
    ) -> Self {
        let name = format!("{adapter} 0x{address:02x}");
        let last = clock.now().saturating_sub(BUS_FREE);
        let row = device.as_ref().and_then(|_| adapter.row());
        let target = Target { adapter, address, row, clock: clock.clone(), device, last };
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
                self.row = self.adapter.row();
                let device = LinuxI2CDevice::new(&self.adapter.path, self.address.into());
                let device = device.map_err(|error| claim_error(errno(&error)))?;
                hold(&device, self.address).map_err(|_| BusError::Busy)?;
                Ok(gone.insert(device))
            }
        }
    }
}

impl Bus for Target {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let clock = self.clock.clone();
        let since = clock.now().saturating_sub(self.last);
        if since < BUS_FREE {
            clock.sleep(BUS_FREE - since);
        }
        let device = self.device()?;
        let begun = clock.now();
        let (wanted, moved) = if read.is_empty() {
            (1, device.transfer(&mut [LinuxI2CMessage::write(write)]))
        } else if write.is_empty() {
            (1, device.transfer(&mut [LinuxI2CMessage::read(read)]))
        } else {
            (2, device.transfer(&mut [LinuxI2CMessage::write(write), LinuxI2CMessage::read(read)]))
        };
        self.last = clock.now();
        match moved {
            Ok(moved) if moved == wanted => Ok(()),
            // Some adapters, such as virtio's, report this when a message is not acknowledged.
            Ok(0) => Err(BusError::NoAck),
            Ok(_) => Err(BusError::Short),
            Err(_) if !self.adapter.is_there() => {
                self.device = None;
                Err(BusError::Gone)
            }
            Err(error) => {
                let (errno, took) = (errno(&error), self.last.saturating_sub(begun));
                let nack = self.row.and_then(|row| row.nack(errno, !write.is_empty(), took));
                Err(nack.unwrap_or_else(|| transfer_error(errno)))
            }
        }
    }

    fn release_if_gone(&mut self) {
        if !self.adapter.is_there() {
            self.device = None;
        }
    }

    fn claim(&mut self) -> Result<(), BusError> {
        let address = self.address.into();
        self.device()?.set_slave_address(address).map_err(|error| claim_error(errno(&error)))
    }
}

/// Locks one byte of the node, at the offset of the address, for as long as the node is open. Unlike a lock
/// file, this works between different accounts, and it needs no further file.
fn hold(device: &LinuxI2CDevice, address: u8) -> nix::Result<()> {
    let lock = libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: address.into(),
        l_len: 1,
        l_pid: 0,
    };
    // SAFETY: the descriptor stays open while `device` is borrowed.
    #[allow(unsafe_code)]
    let device = unsafe { BorrowedFd::borrow_raw(device.as_raw_fd()) };
    fcntl(device, FcntlArg::F_OFD_SETLK(&lock)).map(drop)
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

/// Converts the errno of a transfer (`Documentation/i2c/fault-codes.rst`) on an adapter of which nothing else is known.
fn transfer_error(errno: Errno) -> BusError {
    match errno {
        Errno::ENXIO | Errno::EREMOTEIO => BusError::NoAck,
        Errno::EAGAIN => BusError::ArbitrationLost,
        // The adapter waited in vain for both lines to be high.
        Errno::ETIMEDOUT | Errno::EBUSY => BusError::Timeout,
        Errno::ENODEV | Errno::ENOENT => BusError::Gone,
        other => BusError::Other(other as i32),
    }
}

/// Converts the errno of claiming an address.
fn claim_error(errno: Errno) -> BusError {
    match errno {
        Errno::EBUSY => BusError::Busy,
        other => transfer_error(other),
    }
}

/// The error, with the remedy, if an adapter cannot be opened or its address cannot be claimed.
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
    let number = adapter.number();
    let why = match driver {
        Some(driver) => format!(
            "the kernel driver {} ({}) is bound to the gauge; unbind it as root with {}",
            driver.name,
            driver.device,
            driver.remedy(number, address)
        ),
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
        let driver = Driver { name: "bq27xxx-battery".into(), device: "bq34z100".into() };
        let error = busy(&adapter, 0x55, Some(&driver));
        assert_eq!(error.kind, ErrorKind::Busy);
        let text = error.to_string();
        assert!(text.contains("bq27xxx-battery (bq34z100)"), "{text}");
        assert!(text.contains("echo 0x55 > /sys/bus/i2c/devices/i2c-1/delete_device"), "{text}");
        assert!(text.contains("echo 1-0055 > /sys/bus/i2c/drivers/bq27xxx-battery/unbind"), "{text}");
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
