// SPDX-License-Identifier: MIT

//! A gauge in the device tree: its bus, address and chip, from its device in sysfs.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Cause, Error, Result};
use gauge_bus::{GAUGE_ADDRESS, regular};
use gauge_owner::GaugeOptions;
use ti_gauge::chip::{CHIPS, Chip, kernel};

/// The gauge of a folder such as `/sys/bus/i2c/devices/1-0055`.
#[derive(Debug)]
pub(super) struct Node {
    bus: PathBuf,
    address: u8,
    /// The chip, if the name in the tree means exactly one; otherwise the gauge is asked.
    chip: Option<&'static Chip>,
}

impl Node {
    /// Completes the options of a gauge whose bus is a device in sysfs.
    pub(super) fn complete(options: &mut GaugeOptions) -> Result<()> {
        if let Some(Self { bus, address, chip }) =
            options.bus.as_deref().map(Self::find).transpose()?.flatten()
        {
            options.bus = Some(bus);
            options.address = options.address.or(Some(address));
            options.chip = options.chip.or(chip);
        }
        Ok(())
    }

    /// The device of a folder; `None` if there is no such folder.
    fn find(path: &Path) -> Result<Option<Self>> {
        if !path.is_dir() {
            return Ok(None);
        }
        let subject = path.display().to_string();
        let device = fs::canonicalize(path).map_err(|error| Error::io(&subject, "cannot find it", &error))?;
        let name = |path: Option<&Path>| Some(path?.file_name()?.to_str()?.to_string());
        let adapter = name(device.parent()).filter(|name| name.starts_with("i2c-"));
        let (Some(adapter), Some(name)) = (adapter, name(Some(&device))) else {
            let why = "not an I2C device; give a bus, or a device such as /sys/bus/i2c/devices/1-0055";
            return Err(Error::new(subject, Cause::Invalid, why));
        };
        let modalias = regular::read_text(&device.join("modalias"), regular::SYSTEM).unwrap_or_default();
        Ok(Some(Self {
            bus: Path::new("/dev").join(adapter),
            address: address(&name),
            chip: chip(&modalias),
        }))
    }
}

/// The address is part of the name, except in ACPI names; TI's default is assumed for them.
fn address(name: &str) -> u8 {
    let digits = name.split_once('-').map(|(_, digits)| digits).filter(|digits| digits.len() == 4);
    digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()).unwrap_or(GAUGE_ADDRESS)
}

/// The first known chip that the device is compatible with, from `of:NgaugeT(null)Cti,bq27520g3`.
fn chip(modalias: &str) -> Option<&'static Chip> {
    let mut words =
        modalias.trim().strip_prefix("of:")?.split('C').filter_map(|word| word.strip_prefix("ti,"));
    words.find_map(|word| {
        let mut alike = CHIPS.iter().copied().filter(|chip| compatible(chip).contains(&word.into()));
        match (alike.next(), alike.next()) {
            (None, _) => kernel::by_driver_name(word),
            // Two parts have this name; the gauge is asked.
            (found, other) => found.filter(|_| other.is_none()),
        }
    })
}

/// Names that bind the kernel's driver to parts unknown to it.
const BORROWED: &[(&str, &str)] =
    &[("bq27427", "bq27426"), ("bq27500", "bq27500-1"), ("bq27500-v130", "bq27500-1")];

/// The kernel's names have no dash, and most lack the first generation's suffix. Its bq34z100 also means the
/// bq34z100-R2, which TI made compatible. A name that means any part of a family there does so here.
fn compatible(chip: &Chip) -> Vec<String> {
    let name = chip.name.replace('-', "");
    let short = ["g1", "r2"].iter().find_map(|suffix| name.strip_suffix(suffix)).map(str::to_string);
    let borrowed = BORROWED.iter().find(|(part, _)| *part == chip.name).map(|(_, name)| (*name).to_string());
    let mut names: Vec<_> = [Some(name), short, borrowed].into_iter().flatten().collect();
    names.retain(|name| kernel::by_driver_name(name).is_none_or(Chip::has_table));
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_gives_bus_address_and_chip() {
        let top = std::env::temp_dir().join(format!("gaugefs-node-{}", std::process::id()));
        let device = top.join("i2c-7/7-0045");
        fs::create_dir_all(&device).expect("a folder");
        fs::write(device.join("modalias"), "of:NgaugeT(null)Cacme,packCti,bq27520g3\n").expect("a file");
        let link = top.join("7-0045");
        std::os::unix::fs::symlink(&device, &link).expect("a link, as in /sys/bus");
        let node = Node::find(&link).expect("a device").expect("a folder");
        assert_eq!(node.bus, Path::new("/dev/i2c-7"));
        assert_eq!(node.address, 0x45);
        assert_eq!(node.chip.expect("a known chip").name, "bq27520-g3");
        Node::find(&top).expect_err("no device");
        assert!(Node::find(Path::new("/dev/null")).expect("it may be a bus").is_none());
        fs::remove_dir_all(&top).expect("it was made here");
    }

    #[test]
    fn names_from_acpi_have_no_address() {
        assert_eq!(address("i2c-PRP0001:00"), 0x55);
        assert_eq!(address("10-000b"), 0x0b);
    }

    #[test]
    fn the_udev_rule_knows_every_chip() {
        let rules = include_str!("../../udev/60-gaugefs.rules");
        for gauge in CHIPS {
            let mut names = compatible(gauge);
            names.retain(|name| rules.contains(&format!("\"of:*Cti,{name}|of:*Cti,{name}C*\"")));
            assert!(!names.is_empty(), "{} is not in the rule", gauge.name);
            for name in names.iter().filter(|name| !["bq34z100", "bq27426", "bq27500-1"].contains(&&***name))
            {
                assert_eq!(
                    chip(&format!("of:NgT(null)Cti,{name}\n")).map(|chip| chip.name),
                    Some(gauge.name)
                );
            }
        }
        for (name, _) in kernel::DRIVER {
            assert!(
                rules.contains(&format!("\"of:*Cti,{name}|of:*Cti,{name}C*\"")),
                "{name} is not in the rule"
            );
        }
        assert_eq!(chip("of:NgT(null)Cti,bq27500").map(|chip| chip.name), Some("bq2750x"));
        assert!(chip("of:NgT(null)Cti,bq27500-1").is_none(), "its firmware tells");
        assert_eq!(chip("of:NgT(null)Cti,bq27500v130").map(|chip| chip.name), Some("bq27500-v130"));
        assert_eq!(chip("of:NgT(null)Cti,bq27220").map(|chip| chip.name), Some("bq27220"));
        assert!(chip("of:NgT(null)Cti,bq99").is_none());
        assert!(chip("i2c:bq34z100").is_none());
        // What the gauge answers decides.
        assert!(chip("of:NgT(null)Cti,bq27426").is_none());
        assert!(chip("of:NgT(null)Cti,bq34z100").is_none());
        assert_eq!(chip("of:NgT(null)Cti,bq34z100g1").map(|chip| chip.name), Some("bq34z100-g1"));
    }
}
