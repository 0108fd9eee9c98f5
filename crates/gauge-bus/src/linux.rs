// SPDX-License-Identifier: MIT

//! A target behind `/dev/i2c-N`, or behind a FUSE file or a device of CUSE that answers like one, as `gaugefs sim` serves it.
//!
//! Transfers use I2C_RDWR: a pointer write and the read after it are one transfer with a repeated START. An adapter without
//! that has the SMBus commands which put the same bits on the wire. I2C_SLAVE claims the address first, because I2C_RDWR does
//! not report a kernel driver that is bound to it. The file of an unplugged adapter is closed, for which the kernel waits; the
//! next transfer opens it again. A driver that hangs is given up after a while ([`bounded`](crate::bounded)).
//!
//! All `unsafe` code of this crate is here; it makes calls for which the crate `i2cdev` has no function.

use std::fmt;
use std::fs::{self, File};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::sys::stat::{major, minor};

use crate::adapters::{self, AdapterModel};
use crate::clock::Clock;
use crate::error::{Driver, Error, ErrorKind, Result};
use crate::{Reach, regular};

mod adapter;
mod mux;
mod smbus;
mod spd;
mod target;

pub use adapter::{BusClock, clock, model};
pub use mux::{Mux, connected, described, muxes};
pub use spd::write_disable;
pub use target::LinuxBus;

/// Major number of the i2c-dev character devices; the minor number is the adapter's.
const I2C_MAJOR: u64 = 89;
const I2C_FUNC_I2C: libc::c_ulong = adapters::I2C as libc::c_ulong;
const I2C_FUNC_SMBUS_PEC: libc::c_ulong = adapters::PEC as libc::c_ulong;

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

/// The device behind a path that may be an adapter: i2c-dev, CUSE, a FUSE mount of one file. To open others has effects.
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

    /// The adapter's number: N in `i2c-N`, whatever the node's name. A FUSE file's or CUSE device's is larger.
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

    /// The bus clock, if it is known: by the device tree, by the driver, or by a file of the driver's.
    pub fn clock_hz(&self) -> Option<u32> {
        clock(Path::new("/"), self.number()).map(|clock| clock.hz)
    }

    /// What is known of it and its driver.
    pub fn model(&self) -> Option<&'static AdapterModel> {
        model(Path::new("/"), self.number())
    }

    /// Whether it is known what it sends as one message: by the table of drivers, or because a program serves it.
    pub fn is_known(&self) -> bool {
        self.device & (FILE | CUSE) != 0 || self.model().is_some()
    }

    /// Whether its driver is still starting, and gets no answer: a transfer would take seconds and fail.
    pub fn is_starting(&self) -> bool {
        adapter::is_starting(Path::new("/"), self.number())
    }

    /// Waits for a driver that is still starting.
    pub fn wait_until_started(&self, clock: &dyn Clock) {
        if self.is_starting() {
            log::warn!("{self}: waiting for its driver, which takes up to 20 s to start");
        }
        while self.is_starting() {
            clock.sleep(Duration::from_millis(100));
        }
    }

    /// The kernel driver that is bound to an address, and its device: on this bus, or on one in front of it or behind it.
    pub fn driver(&self, address: u8) -> Option<Driver> {
        driver_near(Path::new("/"), self.number(), address)
    }

    /// The muxes on it.
    pub fn muxes(&self) -> Vec<Mux> {
        muxes(Path::new("/"), self.number())
    }

    /// The way to it from the adapter before all muxes, such as `i2c-0.70.3`; without a mux, `i2c-N`.
    pub fn channels(&self) -> String {
        mux::path(Path::new("/"), self.number())
    }

    fn above(&self) -> Vec<u64> {
        mux::above(Path::new("/"), self.number())
    }

    /// Refuses a bus with a mux that keeps a channel connected: the gauge changes whenever somebody uses another channel.
    pub fn refuse_mux(&self) -> Result<()> {
        refusal_of_mux(&self.to_string(), self.number(), &self.muxes()).map_or(Ok(()), Err)
    }

    /// What it carries. Asking sends nothing on the bus.
    pub fn reach(&self) -> Result<Reach> {
        Ok(reach(self.capabilities()?, self.model()))
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

    fn is_there(&self) -> bool {
        fs::metadata(&self.path).is_ok_and(|status| device(&self.path, &status) == Some(self.device))
    }
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.display().fmt(f)
    }
}

/// Why no gauge is used on a bus in front of its muxes, if one of them keeps a channel connected.
fn refusal_of_mux(subject: &str, number: u64, muxes: &[Mux]) -> Option<Error> {
    let stays = connected(muxes)?;
    let says = described(number, muxes)?;
    let why = format!(
        "{says}; on the bus in front of it the gauge changes whenever somebody uses another channel, unless the mux connects \
         none while it is idle: /sys/bus/i2c/devices/{}/idle_state is -2 (i2c-mux-idle-disconnect in the device tree)",
        stays.device
    );
    Some(Error::new(subject, ErrorKind::HasMux, why))
}

/// The kernel driver of an address, below `root`, also in front of a mux or behind it: the kernel refuses all of them.
pub fn driver_near(root: &Path, number: u64, address: u8) -> Option<Driver> {
    let near = [vec![number], mux::above(root, number), mux::below(root, number)].concat();
    near.into_iter().find_map(|number| driver(root, number, address))
}

/// The kernel driver that is bound to an address of an adapter of the system below `root`.
pub fn driver(root: &Path, number: u64, address: u8) -> Option<Driver> {
    let device = root.join(format!("sys/bus/i2c/devices/{number}-{address:04x}"));
    let driver = fs::read_link(device.join("driver")).ok()?;
    let device = regular::read_text(&device.join("name"), regular::SYSTEM).unwrap_or_default();
    let name = driver.file_name()?.to_string_lossy().into_owned();
    Some(Driver { name, device: device.trim().to_string(), bus: number })
}

impl Driver {
    /// The command with which root unbinds it from an address.
    pub fn remedy(&self, address: u8) -> String {
        let number = self.bus;
        format!(
            "`echo 0x{address:02x} > /sys/bus/i2c/devices/i2c-{number}/delete_device`, or with \
             `echo {number}-{address:04x} > /sys/bus/i2c/drivers/{}/unbind`",
            self.name
        )
    }
}

/// What an adapter carries. I2C_FUNCS says what kinds of messages; their longest lengths are known to its driver alone.
fn reach(functions: libc::c_ulong, model: Option<&AdapterModel>) -> Reach {
    let carried = match functions & I2C_FUNC_I2C {
        0 => smbus::reach(functions),
        _ => Reach { pec: functions & I2C_FUNC_SMBUS_PEC != 0, ..Reach::FULL },
    };
    // Whether it has packet error codes is known of the adapter itself.
    Reach { pec: carried.pec, ..model.map_or(carried, |model| model.reach().narrowed(carried)) }
}

fn functions(device: &impl AsRawFd) -> nix::Result<libc::c_ulong> {
    let mut functions = 0;
    // SAFETY: I2C_FUNCS writes one unsigned long to the given address, which is valid until the call
    // returns; the descriptor stays open while `device` is borrowed.
    #[allow(unsafe_code)]
    unsafe { ioctl::i2c_funcs(device.as_raw_fd(), &raw mut functions) }?;
    Ok(functions)
}

/// Locks the address's byte of the node while it is open. Unlike a lock file, this works between accounts.
fn hold(node: &impl AsRawFd, address: u8, kind: libc::c_int) -> nix::Result<()> {
    let lock = libc::flock {
        l_type: kind as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: address.into(),
        l_len: 1,
        l_pid: 0,
    };
    // SAFETY: the descriptor stays open while `node` is borrowed.
    #[allow(unsafe_code)]
    let node = unsafe { BorrowedFd::borrow_raw(node.as_raw_fd()) };
    fcntl(node, FcntlArg::F_OFD_SETLK(&lock)).map(drop)
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
mod fake;

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
    fn a_driver_on_a_bus_in_front_of_a_mux_or_behind_it_is_found_with_its_bus() {
        let system = fake::System::new("drivers");
        system.adapter(0, Some("mcp2221"), "MCP2221 usb-i2c bridge");
        system.channel(0, 1, "0-0070", 0);
        system.channel(0, 2, "0-0070", 1);
        system.driver(1, 0x55, "bq34z100", "bq27xxx-battery");
        let near = |number| driver_near(system.root(), number, 0x55);
        let bound = near(0).expect("it is behind the mux");
        assert_eq!((bound.bus, &*bound.name, &*bound.device), (1, "bq27xxx-battery", "bq34z100"));
        assert!(bound.remedy(0x55).contains("echo 0x55 > /sys/bus/i2c/devices/i2c-1/delete_device"));
        assert_eq!(near(1), Some(bound));
        assert_eq!(near(2), None, "packs on sibling channels do not concern each other");
        system.driver(0, 0x55, "24c02", "at24");
        assert_eq!(near(2).map(|driver| driver.bus), Some(0), "it is in front of the mux");
        assert_eq!(driver(system.root(), 2, 0x55), None);
    }

    #[test]
    fn a_bus_with_a_mux_that_stays_connected_is_refused() {
        let system = fake::System::new("refused");
        system.adapter(0, Some("mcp2221"), "MCP2221 usb-i2c bridge");
        let refusal = || refusal_of_mux("/dev/i2c-0", 0, &muxes(system.root(), 0));
        assert!(refusal().is_none());
        (1..=8).for_each(|number| system.channel(0, number, "0-0070", number as u32 - 1));
        system.write("sys/devices/usb/0/i2c-0/0-0070/name", b"pca9548\n");
        system.write("sys/devices/usb/0/i2c-0/0-0070/idle_state", b"-1\n");
        let error = refusal().expect("it stays connected");
        let text = error.to_string();
        for words in ["i2c-0 has a mux, pca9548 at 0x70: use i2c-1 to i2c-8; ", "0-0070/idle_state is -2"] {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert_eq!(error.kind, ErrorKind::HasMux);
        system.write("sys/devices/usb/0/i2c-0/0-0070/idle_state", b"-2\n");
        assert!(refusal().is_none(), "it connects no channel while it is idle");
    }

    /// Gauges on two channels of a mux, and one in front of it, whose node has the locks of all.
    #[test]
    fn a_gauge_in_front_of_a_mux_excludes_those_behind_it_and_they_not_each_other() {
        let path = std::env::temp_dir().join(format!("gauge-bus-hold-{}", std::process::id()));
        fs::write(&path, "").expect("a file");
        let open = || File::options().read(true).write(true).open(&path).expect("a node");
        let (left, right, front) = (open(), open(), open());
        hold(&left, 0x55, libc::F_RDLCK).expect("it is free");
        hold(&right, 0x55, libc::F_RDLCK).expect("a sibling");
        hold(&front, 0x55, libc::F_WRLCK).expect_err("two gauges are behind it");
        hold(&front, 0x54, libc::F_WRLCK).expect("another address");
        drop((left, right));
        hold(&front, 0x55, libc::F_WRLCK).expect("they are gone");
        hold(&open(), 0x55, libc::F_RDLCK).expect_err("it is in front");
        fs::remove_file(path).expect("it was there");
    }

    #[test]
    fn an_adapter_carries_what_both_its_functions_and_its_driver_say() {
        let system = fake::System::new("functions");
        for (number, driver) in [(0, "cp2112"), (1, "i801_smbus"), (2, "i2c-new")] {
            system.adapter(number, Some(driver), "an adapter");
        }
        let of = |number, functions| reach(functions, model(system.root(), number));
        assert_eq!((of(0, 0x0ffe_8001).write, of(0, 0x0ffe_8001).pec), (61, false));
        assert_eq!(of(1, 0x1fff_8008), Reach { blocks: true, ..Reach::smbus(32, true) });
        // Its module can be told not to read blocks, and to send no packet error codes.
        assert_eq!(of(1, 0x1bff_8000), Reach { write: 33, blocks: true, ..Reach::smbus(2, false) });
        assert_eq!(of(2, 0x0fff_8009), Reach::FULL);
        let blocks = Reach { blocks: true, ..Reach::smbus(2, false) };
        assert_eq!(of(2, 0x037f_0000), blocks, "a driver of no model");
    }

    #[test]
    fn a_bus_of_a_driver_without_a_row_is_not_known() {
        let adapter = |device| Adapter { path: "/dev/i2c-999999".into(), device };
        assert!(!adapter(999_999).is_known());
        assert!(adapter(FILE | 44).is_known() && adapter(CUSE | 44).is_known());
    }

    #[test]
    fn a_file_that_is_not_a_bus_is_refused() {
        let error = Adapter::find(Path::new("/dev/null")).expect_err("not a bus").to_string();
        assert!(error.starts_with("/dev/null: not an I2C bus; "), "{error}");
        let error = Adapter::find(Path::new("/dev/i2c-none")).expect_err("no node");
        assert_eq!(error.kind, ErrorKind::NotFound);
    }
}
