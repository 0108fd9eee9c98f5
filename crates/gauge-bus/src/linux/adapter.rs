// SPDX-License-Identifier: MIT

//! The kernel's I2C drivers, by their names in sysfs: which errno is a NACK, and at which clock the adapter works.
//!
//! `fault-codes.rst` of the kernel leaves drivers much choice. A driver without a row is taken at its word.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;

use super::mux;
use crate::{BusError, Reach, regular};

/// When an errno of a NACK is a NACK, and nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sure {
    Always,
    /// Not in a transfer that writes.
    InReads,
    /// If the transfer was shorter: the driver gives the errno also for a clock that is held low, after this time.
    Sooner(Duration),
    Never,
}

#[derive(Clone, Copy, Debug)]
struct Nack(Errno, Sure);

/// Where the clock of the bus is known from.
#[derive(Clone, Copy, Debug)]
enum Source {
    /// The device tree, if it has the clock.
    Tree,
    /// A constant of the driver, in Hz.
    Driver(u32),
    /// A file of the adapter's device, in kHz.
    File(&'static str),
    /// The device tree or else this constant of the driver in Hz, from that version of the kernel on.
    Since([u32; 2], u32),
}

/// What is known of a driver.
#[derive(Debug)]
pub(super) struct Row {
    /// The driver of the adapter's device, or the first words of the adapter's name where it has no device.
    driver: &'static str,
    /// The name by which people know the adapter.
    label: &'static str,
    /// Of the address, and of a byte after it.
    nacks: [Nack; 2],
    clock: Source,
    /// What it carries, if less than I2C_FUNCS says.
    pub(super) reach: Reach,
}

const STRETCHED: Sure = Sure::Sooner(Duration::from_millis(25));

/// "Run": with the drivers of Debian's kernels 6.1.176, 6.12.117 and 7.3.4. "Source": read in the driver only.
static ADAPTERS: [Row; 11] = [
    // Run. Source of the doubt: STATUS1_TIMEOUT_NACK, STATUS1_TIMEOUT_BUS and a transfer that is cancelled after ten
    // status reports are all ETIMEDOUT, any other status is EIO. A longer write is EINVAL, or sent in part without an error:
    // its length becomes 8 bits. Clock: 7.3.4 sets it, 6.1 and 6.12 leave the chip's.
    Row {
        driver: "cp2112",
        label: "CP2112",
        nacks: [Nack(Errno::ETIMEDOUT, Sure::Never), Nack(Errno::EIO, Sure::Never)],
        clock: Source::Since([7, 3], 100_000),
        reach: Reach { write: 61, read: 512, first: 16, ..Reach::FULL },
    },
    // Run. Source of the doubt: each error bit of the status report is EIO. Its attribute `clock` is in kHz.
    // Linux 6.1 cuts a longer message without an error: each part has a START of its own, and a read goes on at the register
    // plus what was read. Newer kernels do not, and nothing but the rows of ROM mode is longer.
    Row {
        driver: "ft260",
        label: "FT260",
        nacks: [Nack(Errno::EIO, Sure::Never); 2],
        clock: Source::File("clock"),
        reach: Reach { write: 60, read: 60, first: 2, ..Reach::FULL },
    },
    // Run. Source of the doubt: the state 0x21, "address being sent" one millisecond after a write, is ENXIO as well.
    // Clock: `i2c_clk_freq`, which is no parameter of the module.
    Row {
        driver: "mcp2221",
        label: "MCP2221",
        nacks: [Nack(Errno::ENXIO, Sure::InReads); 2],
        clock: Source::Driver(400_000),
        reach: Reach { write: 512, read: 512, first: 512, ..Reach::FULL },
    },
    // Run. DEV_ERR of both hosts is also a target that holds the clock low for 25 ms (Intel 82801, HST_STS; PIIX4, SMBHSTSTS).
    Row {
        driver: "i801_smbus",
        label: "i801",
        nacks: [Nack(Errno::ENXIO, STRETCHED); 2],
        clock: Source::Tree,
        reach: Reach::smbus(32, true),
    },
    Row {
        driver: "piix4_smbus",
        label: "piix4",
        nacks: [Nack(Errno::ENXIO, STRETCHED); 2],
        clock: Source::Tree,
        reach: Reach::smbus(2, false),
    },
    // i2c-algo-bit. Run. Source of the doubt: `bit_doAddress` makes ENXIO of the ETIMEDOUT of a clock that is held low, for
    // 100 ms or longer; a read that ends early is EIO as well.
    Row {
        driver: "i2c-gpio",
        label: "i2c-gpio",
        nacks: [Nack(Errno::ENXIO, Sure::Sooner(Duration::from_millis(100))), Nack(Errno::EIO, Sure::Never)],
        clock: Source::Tree,
        reach: Reach::FULL,
    },
    // Run. Only the device's own answer STATUS_ADDRESS_NAK is ENXIO.
    Row {
        driver: "i2c-tiny-usb",
        label: "i2c-tiny-usb",
        nacks: [Nack(Errno::ENXIO, Sure::Always); 2],
        clock: Source::Tree,
        reach: Reach::FULL,
    },
    // i2c-stub, which has no device. Run.
    Row {
        driver: "SMBus stub driver",
        label: "i2c-stub",
        nacks: [Nack(Errno::ENODEV, Sure::Always); 2],
        clock: Source::Tree,
        reach: Reach::smbus(32, false),
    },
    // Source, not run: the bit ERR, "no acknowledge".
    Row {
        driver: "i2c-bcm2835",
        label: "bcm2835",
        nacks: [Nack(Errno::EREMOTEIO, Sure::Always); 2],
        clock: Source::Tree,
        reach: Reach::FULL,
    },
    // Source, not run: DW_IC_TX_ABRT_NOACK.
    Row {
        driver: "i2c_designware",
        label: "DesignWare",
        nacks: [Nack(Errno::EREMOTEIO, Sure::Always); 2],
        clock: Source::Tree,
        reach: Reach::FULL,
    },
    Row {
        driver: "i2c-designware-pci",
        label: "DesignWare",
        nacks: [Nack(Errno::EREMOTEIO, Sure::Always); 2],
        clock: Source::Tree,
        reach: Reach::FULL,
    },
];

/// The adapters that people can buy or have, and that say for certain whether an address is acknowledged in a read.
pub fn certain() -> String {
    let is_certain = |row: &&Row| row.nacks.iter().any(|nack| nack.1 != Sure::Never) && !row.reach.smbus;
    let mut labels: Vec<_> = ADAPTERS.iter().filter(is_certain).map(|row| row.label).collect();
    labels.dedup();
    labels.join(", ")
}

impl Row {
    /// The row of an adapter's driver, in the system below `root`. Behind a mux it is that of the adapter before all muxes.
    pub(super) fn of(root: &Path, number: u64) -> Option<&'static Self> {
        let device = device(root, number);
        let driver = fs::read_link(device.join("../driver")).ok();
        let driver = driver.as_deref().and_then(Path::file_name).and_then(|name| name.to_str());
        let name = regular::read_text(&device.join("name"), regular::SYSTEM).unwrap_or_default();
        ADAPTERS.iter().find(|row| driver == Some(row.driver) || name.starts_with(row.driver))
    }

    /// What an errno says that may be a NACK, of a transfer that `wrote` something and `took` so long.
    pub(super) fn nack(&self, errno: Errno, wrote: bool, took: Duration) -> Option<BusError> {
        let listed = self.nacks.iter().find(|nack| nack.0 == errno);
        let sure = match (listed, errno) {
            (Some(nack), _) => nack.1,
            // Of the mux in front of the gauge, or of a layer between.
            (None, Errno::ENXIO | Errno::EREMOTEIO) => Sure::Never,
            (None, _) => return None,
        };
        let is_sure = match sure {
            Sure::Always => true,
            Sure::InReads => !wrote,
            Sure::Sooner(limit) => took < limit,
            Sure::Never => false,
        };
        Some(if is_sure { BusError::NoAck } else { BusError::MaybeNoAck(errno as i32) })
    }
}

fn device(root: &Path, number: u64) -> PathBuf {
    mux::device(root, mux::above(root, number).pop().unwrap_or(number))
}

/// The clock of a bus, and from where it is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusClock {
    /// In Hz.
    pub hz: u32,
    /// The source, to follow "from".
    pub from: String,
}

/// The clock of an adapter of the system below `root`, if it is known.
pub fn clock(root: &Path, number: u64) -> Option<BusClock> {
    let device = device(root, number);
    let row = Row::of(root, number);
    let known = |hz, from: &str| Some(BusClock { hz, from: from.into() });
    let tree = || known(tree_hz(&device)?, "the device tree");
    match row.map_or(Source::Tree, |row| row.clock) {
        Source::Tree => tree(),
        Source::Driver(hz) => known(hz, &format!("the driver {}, which sets no other", row?.driver)),
        Source::File(name) => {
            let text = regular::read_text(&device.join("..").join(name), regular::SYSTEM).ok()?;
            let khz: u32 = text.trim().parse().ok()?;
            known(khz.checked_mul(1000)?, &format!("the file {name} of its device in sysfs"))
        }
        Source::Since(since, _) if kernel(root)? < since => None,
        Source::Since(_, hz) => {
            tree().or_else(|| known(hz, &format!("the driver {} of this kernel", row?.driver)))
        }
    }
}

/// The clock in the device tree: in the adapter's own node, or in that of its controller.
fn tree_hz(device: &Path) -> Option<u32> {
    let nodes = ["of_node", "device/of_node", "../of_node"];
    let read = |node: &&str| regular::read(&device.join(node).join("clock-frequency"), regular::SYSTEM).ok();
    Some(u32::from_be_bytes(nodes.iter().find_map(read)?.try_into().ok()?))
}

fn kernel(root: &Path) -> Option<[u32; 2]> {
    let text = regular::read_text(&root.join("proc/sys/kernel/osrelease"), regular::SYSTEM).ok()?;
    let mut numbers = text.split(|letter: char| !letter.is_ascii_digit()).map(str::parse);
    Some([numbers.next()?.ok()?, numbers.next()?.ok()?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linux::fake::System;

    const QUICK: Duration = Duration::from_millis(1);
    const SLOW: Duration = Duration::from_secs(1);

    /// What a row says of an errno: certain, maybe, or nothing.
    fn said(system: &System, number: u64, errno: Errno, wrote: bool, took: Duration) -> &'static str {
        let row = Row::of(system.root(), number).expect("a row");
        match row.nack(errno, wrote, took) {
            Some(BusError::NoAck) => "certain",
            Some(BusError::MaybeNoAck(number)) if number == errno as i32 => "maybe",
            Some(other) => panic!("{other:?}"),
            None => "nothing",
        }
    }

    #[test]
    fn each_driver_answers_a_nack_in_its_own_way() {
        let system = System::new("nacks");
        let drivers = [
            ("cp2112", Errno::ETIMEDOUT, "maybe"),
            ("cp2112", Errno::EIO, "maybe"),
            ("ft260", Errno::EIO, "maybe"),
            ("i801_smbus", Errno::ENXIO, "certain"),
            ("piix4_smbus", Errno::ENXIO, "certain"),
            ("i2c-gpio", Errno::ENXIO, "certain"),
            ("i2c-gpio", Errno::EIO, "maybe"),
            ("i2c-tiny-usb", Errno::ENXIO, "certain"),
            ("i2c-bcm2835", Errno::EREMOTEIO, "certain"),
            ("i2c_designware", Errno::EREMOTEIO, "certain"),
            ("i2c-designware-pci", Errno::EREMOTEIO, "certain"),
            // It is no errno of theirs for a NACK.
            ("mcp2221", Errno::ETIMEDOUT, "nothing"),
            ("ft260", Errno::ETIMEDOUT, "nothing"),
            ("i2c-tiny-usb", Errno::EIO, "nothing"),
            ("cp2112", Errno::ENXIO, "maybe"),
        ];
        for (number, (driver, errno, expected)) in (1..).zip(drivers) {
            system.adapter(number, Some(driver), "an adapter");
            assert_eq!(said(&system, number, errno, true, QUICK), expected, "{driver} {errno}");
        }
        system.adapter(90, None, "SMBus stub driver");
        assert_eq!(said(&system, 90, Errno::ENODEV, true, QUICK), "certain");
        // "Address being sent" is ENXIO as well, but only after a write.
        system.adapter(91, Some("mcp2221"), "MCP2221 usb-i2c bridge");
        assert_eq!(said(&system, 91, Errno::ENXIO, false, SLOW), "certain");
        assert_eq!(said(&system, 91, Errno::ENXIO, true, QUICK), "maybe");
        // A clock that is held low is ENXIO as well, but only after a time.
        assert_eq!(said(&system, 4, Errno::ENXIO, false, SLOW), "maybe");
        system.adapter(92, Some("i2c-new"), "a new one");
        assert!(Row::of(system.root(), 92).is_none());
        assert!(Row::of(system.root(), 93).is_none(), "no such adapter");
    }

    #[test]
    fn a_driver_carries_less_than_its_functions_say() {
        let system = System::new("reach");
        for (number, driver, write, read, first) in [
            (1, "cp2112", 61, 512, 16),
            (2, "piix4_smbus", 3, 2, 1),
            (3, "i801_smbus", 33, 32, 1),
            (4, "ft260", 60, 60, 2),
        ] {
            system.adapter(number, Some(driver), "an adapter");
            let reach = Row::of(system.root(), number).expect("a row").reach;
            assert_eq!((reach.write, reach.read, reach.first), (write, read, first), "{driver}");
        }
    }

    #[test]
    fn a_channel_of_a_mux_answers_as_its_adapter_does() {
        let system = System::new("channel");
        system.adapter(3, Some("cp2112"), "CP2112 SMBus Bridge on hidraw0");
        system.channel(3, 4, "3-0070", 0);
        system.channel(4, 5, "4-0071", 7);
        assert_eq!(said(&system, 5, Errno::ETIMEDOUT, false, QUICK), "maybe");
    }

    #[test]
    fn only_adapters_that_tell_a_nack_for_certain_are_recommended() {
        assert_eq!(certain(), "MCP2221, i2c-gpio, i2c-tiny-usb, bcm2835, DesignWare");
    }

    #[test]
    fn the_clock_is_known_by_driver_where_it_cannot_be_read() {
        let system = System::new("clock");
        let clock_of = |number| clock(system.root(), number).map(|clock| (clock.hz, clock.from));
        let hertz = |number| clock_of(number).map(|(hz, _)| hz);
        system.adapter(1, Some("mcp2221"), "MCP2221 usb-i2c bridge");
        let says = "the driver mcp2221, which sets no other".to_string();
        assert_eq!(clock_of(1), Some((400_000, says)));
        system.adapter(2, Some("ft260"), "FT260 usb-i2c bridge on hidraw1");
        assert_eq!(clock_of(2), None, "the file is not there yet");
        system.write("sys/devices/usb/2/clock", b"100\n");
        assert_eq!(clock_of(2), Some((100_000, "the file clock of its device in sysfs".into())));
        system.channel(2, 7, "2-0070", 0);
        assert_eq!(hertz(7), Some(100_000), "a channel has the clock of its adapter");
        // Only newer kernels set it; older ones leave what the chip has kept.
        system.adapter(3, Some("cp2112"), "CP2112 SMBus Bridge on hidraw2");
        for (release, expected) in [
            ("7.3.4+deb14-amd64", Some(100_000)),
            ("6.12.117+deb13-amd64", None),
            ("8.0", Some(100_000)),
            ("x", None),
        ] {
            system.write("proc/sys/kernel/osrelease", format!("{release}\n").as_bytes());
            assert_eq!(hertz(3), expected, "{release}");
        }
        system.adapter(4, Some("i2c-bcm2835"), "bcm2835 (i2c@7e804000)");
        assert_eq!(clock_of(4), None);
        system.write("sys/devices/usb/4/of_node/clock-frequency", &50_000_u32.to_be_bytes());
        assert_eq!(clock_of(4), Some((50_000, "the device tree".into())));
    }
}
