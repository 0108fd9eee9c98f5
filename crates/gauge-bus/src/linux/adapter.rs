// SPDX-License-Identifier: MIT

//! The model of an adapter by its driver in sysfs, and the clock at which it works.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::mux;
use crate::adapters::{AdapterModel, Source};
use crate::regular;

/// The longest start of a driver, from the node of its adapter on.
const STARTS: Duration = Duration::from_secs(30);

/// The model of an adapter, in the system below `root`. Behind a mux it is that of the adapter before all muxes.
pub fn model(root: &Path, number: u64) -> Option<&'static AdapterModel> {
    let device = device(root, number);
    let driver = fs::read_link(device.join("../driver")).ok();
    let driver = driver.as_deref().and_then(Path::file_name).and_then(|name| name.to_str());
    let name = regular::read_text(&device.join("name"), regular::SYSTEM).unwrap_or_default();
    AdapterModel::of(driver, &name, kernel(root))
}

fn device(root: &Path, number: u64) -> PathBuf {
    mux::device(root, before_all(root, number))
}

/// The adapter before all muxes.
fn before_all(root: &Path, number: u64) -> u64 {
    mux::above(root, number).pop().unwrap_or(number)
}

/// Whether the driver of an adapter of the system below `root` is still starting: it adds the adapter, and gets no answer of
/// the chip before it has ended its probe(). A transfer meanwhile takes seconds and fails.
///
/// hid-mcp2221 is such a driver before Linux 6.7, which calls hid_device_io_start(). It asks for four GPIOs meanwhile, 4 s
/// each; its last step is their chip.
pub(super) fn is_starting(root: &Path, number: u64) -> bool {
    let device = device(root, number);
    let is_such = kernel(root).is_some_and(|kernel| kernel < [6, 7])
        && model(root, number).is_some_and(|model| model.name == "mcp2221");
    let has_gpios = || {
        let beside = fs::read_dir(device.join("..")).into_iter().flatten().flatten();
        beside.into_iter().any(|entry| entry.file_name().as_encoded_bytes().starts_with(b"gpiochip"))
    };
    let is_new = || {
        let node = fs::metadata(root.join(format!("dev/i2c-{}", before_all(root, number))));
        let age = node.and_then(|node| node.modified()).ok().and_then(|since| since.elapsed().ok());
        age.is_some_and(|age| age < STARTS)
    };
    is_such && !has_gpios() && is_new()
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
    let model = model(root, number);
    let known = |hz, from: &str| Some(BusClock { hz, from: from.into() });
    let tree = || known(tree_hz(&device)?, "the device tree");
    match model.map_or(Source::Tree, |model| model.clock) {
        Source::Tree => tree(),
        Source::Driver(hz) => known(hz, &format!("the driver {}, which sets no other", model?.driver)),
        Source::File(name) => {
            let text = regular::read_text(&device.join("..").join(name), regular::SYSTEM).ok()?;
            let khz: u32 = text.trim().parse().ok()?;
            known(khz.checked_mul(1000)?, &format!("the file {name} of its device in sysfs"))
        }
        Source::Since(since, _) if kernel(root)? < since => None,
        Source::Since(_, hz) => {
            tree().or_else(|| known(hz, &format!("the driver {} of this kernel", model?.driver)))
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
    use nix::errno::Errno;

    use super::*;
    use crate::BusError;
    use crate::linux::fake::System;

    const QUICK: Duration = Duration::from_millis(1);
    const SLOW: Duration = Duration::from_secs(1);

    /// What a model says of an errno: certain, maybe, or nothing.
    fn said(system: &System, number: u64, errno: Errno, wrote: bool, took: Duration) -> &'static str {
        let model = model(system.root(), number).expect("a model");
        match model.error(errno as i32, wrote, took) {
            BusError::NoAck => "certain",
            BusError::MaybeNoAck(number) if number == errno as i32 => "maybe",
            BusError::MaybeNoAck(other) => panic!("{other}"),
            _ => "nothing",
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
            // A byte that is not acknowledged, or a write that was cancelled because the clock is held low.
            ("mcp2221", Errno::EIO, "maybe"),
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
        assert!(model(system.root(), 92).is_none());
        assert!(model(system.root(), 93).is_none(), "no such adapter");
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
            let reach = model(system.root(), number).expect("a model").reach();
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
    fn a_driver_without_answers_before_the_end_of_its_probe_is_waited_for() {
        let system = System::new("starts");
        let release = |release: &str| system.write("proc/sys/kernel/osrelease", release.as_bytes());
        let starts = |number| is_starting(system.root(), number);
        release("6.1.0-48-amd64\n");
        for (number, driver) in [(1, "mcp2221"), (2, "cp2112")] {
            system.adapter(number, Some(driver), "a bridge");
            assert!(!starts(number), "{driver}: it has no node yet");
            system.write(&format!("dev/i2c-{number}"), b"");
        }
        system.channel(1, 3, "1-0070", 0);
        assert_eq!([1, 2, 3, 9].map(starts), [true, false, true, false]);
        release("6.12.118+deb13-amd64\n");
        assert!(!starts(1), "the driver has its answers from the beginning");
        release("6.1.0-48-amd64\n");
        let node = fs::File::options().write(true).open(system.root().join("dev/i2c-1")).expect("a node");
        node.set_modified(std::time::SystemTime::now() - 2 * STARTS).expect("its time");
        assert!(!starts(1), "nothing is waited for forever");
        node.set_modified(std::time::SystemTime::now()).expect("its time");
        assert!(starts(1));
        system.write("sys/devices/usb/1/gpiochip0/dev", b"254:0\n");
        assert!(!starts(1), "that was the last step");
    }

    #[test]
    fn the_reach_of_a_driver_is_that_of_the_kernels_version() {
        let system = System::new("versions");
        system.adapter(1, Some("ft260"), "FT260 usb-i2c bridge on hidraw1");
        for (release, most) in [
            ("6.1.0-44-amd64", 60),
            ("6.2.0", 120),
            ("6.12.117+deb13-amd64", 120),
            ("7.3.4+deb14-amd64", 120),
            ("5.13.1", 60),
            ("x", 60),
        ] {
            system.write("proc/sys/kernel/osrelease", format!("{release}\n").as_bytes());
            let reach = model(system.root(), 1).expect("a model").reach();
            assert_eq!(reach.write, most, "{release}");
        }
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
