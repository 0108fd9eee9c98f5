// SPDX-License-Identifier: MIT

//! A target behind `/dev/i2c-N`, or behind a FUSE file or a device of CUSE that answers like one, as `gaugefs sim` serves it.
//!
//! Transfers use I2C_RDWR, so that a pointer write and the read after it are one transfer with a repeated
//! START. The address is claimed with I2C_SLAVE first, because I2C_RDWR does not report that a kernel driver
//! is bound to it. When the adapter is unplugged, its file is closed: the kernel keeps an unplugged adapter
//! until its last user has closed it. When the adapter is back, the next transfer opens it again. A driver that
//! hangs is given up after a while ([`bounded`](crate::bounded)).
//!
//! All `unsafe` code of this crate is here; it makes calls for which the crate `i2cdev` has no function.

use std::fmt;
use std::fs::{self, File};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use i2cdev::core::{I2CMessage, I2CTransfer};
use i2cdev::linux::{LinuxI2CDevice, LinuxI2CError, LinuxI2CMessage};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::sys::stat::{major, minor};

use crate::bounded::{Bounded, PATIENCE};
use crate::clock::Clock;
use crate::error::{Driver, Error, ErrorKind, Result};
use crate::{Bus, BusError, regular};

/// Major number of the i2c-dev character devices; the minor number is the adapter's.
const I2C_MAJOR: u64 = 89;
/// The adapter transfers whole I2C messages, and not just the SMBus commands.
const I2C_FUNC_I2C: libc::c_ulong = 1;
/// Bus-free time that the gauges need between transfers at 400 kHz; it costs little at 100 kHz.
const BUS_FREE: Duration = Duration::from_micros(66);

#[allow(unsafe_code, missing_docs)]
mod ioctl {
    nix::ioctl_read_bad!(i2c_funcs, 0x0705, nix::libc::c_ulong);
}

/// What distinguishes the number of a FUSE file from those of the kernel's adapters, which are minor numbers.
const FILE: u64 = 1 << 32;
/// What distinguishes the number of a device of CUSE from those of adapters and of FUSE files.
const CUSE: u64 = 1 << 33;

/// An adapter: its device node, and the adapter's number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adapter {
    path: PathBuf,
    /// The device number of the node, with [`CUSE`] if it is one, or [`FILE`] and that of the mount.
    device: u64,
}

/// The device behind a path, if it may be an adapter: a node of i2c-dev or CUSE, or a file that is a FUSE mount by itself.
/// Others are not even opened, because that has effects on many devices.
fn device(path: &Path, status: &fs::Metadata) -> Option<u64> {
    /// `FUSE_SUPER_MAGIC` of `linux/magic.h`.
    const FUSE: i64 = 0x6573_5546;
    /// `FUSE_ROOT_ID`: only a mount that is one file has a file there.
    const ROOT: u64 = 1;
    let kind = status.file_type();
    if kind.is_char_device() && major(status.rdev()) == I2C_MAJOR {
        return Some(status.rdev());
    }
    if kind.is_char_device() {
        let (major, minor) = (major(status.rdev()), minor(status.rdev()));
        let class = fs::read_link(format!("/sys/dev/char/{major}:{minor}/subsystem")).ok()?;
        return class.ends_with("cuse").then(|| CUSE | status.rdev());
    }
    let is_mount = kind.is_file() && status.ino() == ROOT;
    let is_fuse = || rustix::fs::statfs(path).is_ok_and(|found| i64::from(found.f_type as u32) == FUSE);
    (is_mount && is_fuse()).then(|| FILE | status.dev())
}

impl Adapter {
    /// Finds the adapter of a device node such as `/dev/i2c-1`, or of a link to one.
    pub fn find(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let status = match fs::metadata(path) {
            Ok(status) => status,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(Error::new(name, ErrorKind::NotFound, missing(path, &adapters(Path::new("/")))));
            }
            Err(error) => return Err(Error::io(name, "cannot read its type", &error)),
        };
        let not_a_bus = |why: &str| {
            let list = list(&adapters(Path::new("/")));
            Error::new(&name, ErrorKind::NotABus, format!("not an I2C bus{why}; {list}"))
        };
        let device = device(path, &status).ok_or_else(|| not_a_bus(""))?;
        let adapter = Self { path: path.to_path_buf(), device };
        if device & (FILE | CUSE) != 0 {
            adapter.ask().map_err(|refusal| {
                refusal.unwrap_or_else(|| {
                    not_a_bus(", although FUSE or CUSE serves it: it does not answer I2C_FUNCS")
                })
            })?;
        }
        Ok(adapter)
    }

    /// Asks a FUSE file or a device of CUSE what a bus answers, without a transfer. Without an error it has refused in its own way.
    fn ask(&self) -> Result<(), Option<Error>> {
        let failed = |what: &str, errno: Errno| Some(Error::io(self.to_string(), what, &errno.into()));
        let node = File::options().read(true).write(true).open(&self.path);
        let node = node.map_err(|error| Some(Error::io(self.to_string(), "cannot open it", &error)))?;
        match functions(&node) {
            Ok(_) => Ok(()),
            // The kernel's answers to an ioctl that a file system does not know.
            Err(Errno::ENOTTY | Errno::ENOSYS | Errno::EINVAL) => Err(None),
            Err(Errno::EPERM) => {
                let why = "who serves it may not read the memory of this program; run it with `gaugefs sim CHIP -- COMMAND`";
                Err(Some(Error::new(self.to_string(), ErrorKind::Forbidden, why)))
            }
            Err(errno) => Err(failed("cannot ask it for its functions", errno)),
        }
    }

    /// The adapter's number: N in `i2c-N`, whatever the name of the node. That of a FUSE file or a
    /// device of CUSE is larger than any of these.
    pub fn number(&self) -> u64 {
        if self.device & (FILE | CUSE) != 0 { self.device } else { minor(self.device) }
    }

    /// The path given to [`Adapter::find`].
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The kernel's name of the hardware.
    pub fn name(&self) -> Option<String> {
        let name = {
            let file = format!("/sys/class/i2c-dev/i2c-{}/name", self.number());
            regular::read_text(Path::new(&file), regular::SYSTEM).ok()?
        };
        Some(name.trim().to_string())
    }

    /// The bus clock, if the device tree contains it; x86 and USB adapters do not report theirs.
    pub fn clock_hz(&self) -> Option<u32> {
        clock_hz(Path::new("/"), self.number())
    }

    /// The kernel driver that is bound to an address, and its device.
    pub fn driver(&self, address: u8) -> Option<Driver> {
        driver(Path::new("/"), self.number(), address)
    }

    /// Whether the adapter can transfer whole I2C messages. Asking sends nothing on the bus.
    pub fn speaks_i2c(&self) -> Result<bool> {
        Ok(self.capabilities()? & I2C_FUNC_I2C != 0)
    }

    /// The bits of the kernel's I2C_FUNCS. Asking sends nothing on the bus.
    pub fn capabilities(&self) -> Result<libc::c_ulong> {
        let asked = File::options().read(true).write(true).open(&self.path).map(|node| functions(&node));
        match asked {
            Ok(Ok(functions)) => Ok(functions),
            Ok(Err(errno)) => Err(Error::io(self.to_string(), "cannot read its capabilities", &errno.into())),
            Err(error) => Err(Error::io(self.to_string(), "cannot open it", &error)),
        }
    }

    /// Whether the node still belongs to the same adapter.
    fn is_there(&self) -> bool {
        fs::metadata(&self.path).is_ok_and(|status| device(&self.path, &status) == Some(self.device))
    }
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.display().fmt(f)
    }
}

/// One target address of an adapter. A driver that hangs in a transfer is waited for no longer than [`PATIENCE`].
pub struct LinuxBus {
    target: Bounded,
    name: String,
}

/// A device, as the thread that waits for the kernel needs it.
struct Target {
    adapter: Adapter,
    address: u8,
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
        let target = Target { adapter, address, clock: clock.clone(), device, last };
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
        let since = self.clock.now().saturating_sub(self.last);
        if since < BUS_FREE {
            self.clock.sleep(BUS_FREE - since);
        }
        let device = self.device()?;
        let (wanted, moved) = if read.is_empty() {
            (1, device.transfer(&mut [LinuxI2CMessage::write(write)]))
        } else if write.is_empty() {
            (1, device.transfer(&mut [LinuxI2CMessage::read(read)]))
        } else {
            (2, device.transfer(&mut [LinuxI2CMessage::write(write), LinuxI2CMessage::read(read)]))
        };
        self.last = self.clock.now();
        match moved {
            Ok(moved) if moved == wanted => Ok(()),
            // Some adapters, such as virtio's, report this when a message is not acknowledged.
            Ok(0) => Err(BusError::NoAck),
            Ok(_) => Err(BusError::Short),
            Err(_) if !self.adapter.is_there() => {
                self.device = None;
                Err(BusError::Gone)
            }
            Err(error) => Err(transfer_error(errno(&error))),
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

/// The clock of an adapter of the system below `root`, if the device tree contains it.
pub fn clock_hz(root: &Path, number: u64) -> Option<u32> {
    let device = root.join(format!("sys/bus/i2c/devices/i2c-{number}"));
    // The property is in the adapter's own node or in that of its controller.
    let nodes = ["of_node", "device/of_node", "../of_node"];
    let read = |node: &&str| regular::read(&device.join(node).join("clock-frequency"), regular::SYSTEM).ok();
    Some(u32::from_be_bytes(nodes.iter().find_map(read)?.try_into().ok()?))
}

/// The kernel driver that is bound to an address of an adapter of the system below `root`.
pub fn driver(root: &Path, number: u64, address: u8) -> Option<Driver> {
    let device = root.join(format!("sys/bus/i2c/devices/{number}-{address:04x}"));
    let driver = fs::read_link(device.join("driver")).ok()?;
    let device = regular::read_text(&device.join("name"), regular::SYSTEM).unwrap_or_default();
    let name = driver.file_name()?.to_string_lossy().into_owned();
    Some(Driver { name, device: device.trim().to_string() })
}

impl Driver {
    /// The command with which root unbinds it from an address.
    pub fn remedy(&self, number: u64, address: u8) -> String {
        format!(
            "`echo 0x{address:02x} > /sys/bus/i2c/devices/i2c-{number}/delete_device`, or with \
             `echo {number}-{address:04x} > /sys/bus/i2c/drivers/{}/unbind`",
            self.name
        )
    }
}

fn functions(device: &impl AsRawFd) -> nix::Result<libc::c_ulong> {
    let mut functions = 0;
    // SAFETY: I2C_FUNCS writes one unsigned long to the given address, which is valid until the call
    // returns; the descriptor stays open while `device` is borrowed.
    #[allow(unsafe_code)]
    unsafe { ioctl::i2c_funcs(device.as_raw_fd(), &raw mut functions) }?;
    Ok(functions)
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

/// Converts the errno of a transfer (`Documentation/i2c/fault-codes.rst`).
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

/// The adapters with a node in the system below `root`: number and the kernel's name, sorted by number.
pub fn adapters(root: &Path) -> Vec<(u64, String)> {
    let nodes = fs::read_dir(root.join("sys/class/i2c-dev")).into_iter().flatten().flatten();
    let mut adapters: Vec<(u64, String)> = nodes
        .filter_map(|node| {
            let number = node.file_name().to_str()?.strip_prefix("i2c-")?.parse().ok()?;
            let name = regular::read_text(&node.path().join("name"), regular::SYSTEM).unwrap_or_default();
            Some((number, name.trim().to_string()))
        })
        .collect();
    adapters.sort_unstable();
    adapters
}

fn list(adapters: &[(u64, String)]) -> String {
    if adapters.is_empty() {
        return "this machine has none at present".into();
    }
    let each = adapters.iter().map(|(number, name)| format!("/dev/i2c-{number} ({name})"));
    format!("available: {}", each.collect::<Vec<_>>().join(", "))
}

fn missing(path: &Path, adapters: &[(u64, String)]) -> String {
    if let Some(meant) = meant(path) {
        return format!("no such bus; did you mean {meant}?");
    }
    if adapters.is_empty() {
        "no such bus; this machine has none. The kernel module i2c-dev creates them; as root: modprobe i2c-dev"
            .into()
    } else {
        format!("no such bus; {}", list(adapters))
    }
}

/// The node that was probably meant by `1` or `i2c-1`, in whatever folder but `/dev`.
fn meant(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_str()?;
    let number: u64 = name.strip_prefix("i2c-").unwrap_or(name).parse().ok()?;
    (!path.starts_with("/dev")).then(|| format!("/dev/i2c-{number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_bus_is_reported_with_the_available_ones() {
        let path = Path::new("/dev/i2c-3");
        assert!(missing(path, &[]).ends_with("modprobe i2c-dev"));
        let two = [(0, "SMBus I801".to_string()), (7, "bcm2835".to_string())];
        assert_eq!(
            missing(path, &two),
            "no such bus; available: /dev/i2c-0 (SMBus I801), /dev/i2c-7 (bcm2835)"
        );
    }

    #[test]
    fn a_bus_without_its_folder_is_suggested() {
        for path in ["1", "i2c-1", "/home/me/1", "/home/me/i2c-1"] {
            assert_eq!(missing(Path::new(path), &[]), "no such bus; did you mean /dev/i2c-1?", "{path}");
        }
        assert_eq!((meant(Path::new("/dev/i2c-1")), meant(Path::new("pack"))), (None, None));
    }

    #[test]
    fn a_file_that_is_not_a_bus_is_refused() {
        let error = Adapter::find(Path::new("/dev/null")).expect_err("not a bus").to_string();
        assert!(error.starts_with("/dev/null: not an I2C bus; "), "{error}");
        let error = Adapter::find(Path::new("/dev/i2c-none")).expect_err("no node");
        assert_eq!(error.kind, ErrorKind::NotFound);
    }

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
