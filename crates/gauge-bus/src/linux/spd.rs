// SPDX-License-Identifier: MIT

//! SPD Write Disable of Intel's hosts, whose driver is i801: the firmware keeps all writes from the memory modules' EEPROMs at
//! 0x50 to 0x57, and so from a gauge. The host sends nothing and reports a missing acknowledge; reads pass.

use std::fs::{self, File};
use std::ops::RangeInclusive;
use std::os::unix::fs::FileExt;
use std::path::Path;

use super::mux;

const DRIVER: &str = "i801_smbus";
const PROTECTED: RangeInclusive<u8> = 0x50..=0x57;
/// SMBHSTCFG in the PCI configuration, and its bit SPD_WD.
const REGISTER: u64 = 0x40;
const BIT: u8 = 0x10;
/// A gauge that programs its flash refuses a write, too, and may answer a read right after it.
const REFUSALS: u32 = 3;

/// Whether an address is protected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Writes {
    /// No: of another host, or a write was acknowledged.
    Pass,
    /// The host may be such a one; so many writes in a row were refused while reads were acknowledged.
    MayPass(u32),
    /// Yes, by its register.
    Never,
}

/// Whether SPD Write Disable is set on an adapter of the system below `root`, if it is readable.
pub fn write_disable(root: &Path, number: u64) -> Option<bool> {
    match Writes::to(root, number, *PROTECTED.start()) {
        Writes::Never => Some(true),
        Writes::Pass => Some(false),
        Writes::MayPass(_) => None,
    }
}

impl Writes {
    /// Writes to an address of an adapter of the system below `root`.
    pub(super) fn to(root: &Path, number: u64, address: u8) -> Self {
        let device = mux::device(root, mux::above(root, number).pop().unwrap_or(number)).join("..");
        let driver = fs::read_link(device.join("driver")).unwrap_or_default();
        if !driver.ends_with(DRIVER) || !PROTECTED.contains(&address) {
            return Self::Pass;
        }
        let mut byte = [0];
        // Only root gets more than the first 64 bytes.
        let read = File::open(device.join("config")).and_then(|file| file.read_at(&mut byte, REGISTER));
        match read {
            Ok(1) if byte[0] & BIT == 0 => Self::Pass,
            Ok(1) => Self::Never,
            _ => Self::MayPass(0),
        }
    }

    /// Notes that a write was acknowledged.
    pub(super) fn passed(&mut self) {
        *self = Self::Pass;
    }

    /// Notes that a write was not; `is_read` tells whether a read is. Returns whether the host has kept it back.
    pub(super) fn refused(&mut self, is_read: impl FnOnce() -> bool) -> bool {
        match self {
            Self::Pass => false,
            Self::Never => true,
            Self::MayPass(refused) => {
                *refused = if is_read() { *refused + 1 } else { 0 };
                *refused >= REFUSALS
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linux::fake::System;

    #[test]
    fn the_register_of_the_host_says_whether_writes_pass() {
        let system = System::new("spd");
        system.adapter(0, Some("i801_smbus"), "SMBus I801 adapter at efa0");
        system.adapter(1, Some("piix4_smbus"), "SMBus PIIX4 adapter at 0700");
        system.channel(0, 2, "0-0070", 0);
        let to = |number, address| Writes::to(system.root(), number, address);
        let config = |byte: u8, length: usize| {
            let mut bytes = vec![0; 256];
            bytes[0x40] = byte;
            for number in [0, 1] {
                system.write(&format!("sys/devices/usb/{number}/config"), &bytes[..length]);
            }
        };
        assert_eq!(to(0, 0x55), Writes::MayPass(0), "without the file");
        config(0x11, 64);
        assert_eq!(to(0, 0x55), Writes::MayPass(0), "as an ordinary user reads it");
        config(0x11, 256);
        assert_eq!(
            [0x4f, 0x50, 0x57, 0x58].map(|address| to(0, address) == Writes::Never),
            [false, true, true, false]
        );
        assert_eq!(to(2, 0x55), Writes::Never, "a channel of its mux");
        assert_eq!(to(1, 0x55), Writes::Pass, "piix4 has no such bit");
        config(0x01, 256);
        assert_eq!(to(0, 0x55), Writes::Pass);
    }

    #[test]
    fn a_write_that_is_refused_while_reads_pass_is_the_hosts_doing_unless_one_was_acknowledged() {
        let answers = |writes: &mut Writes, reads: &[bool]| {
            reads.iter().map(|&is_read| writes.refused(|| is_read)).collect::<Vec<_>>()
        };
        assert_eq!(answers(&mut Writes::MayPass(0), &[true; 4]), [false, false, true, true]);
        // A gauge that is away, or busy.
        assert_eq!(answers(&mut Writes::MayPass(0), &[true, true, false, true, true]), [false; 5]);
        let mut writes = Writes::MayPass(2);
        writes.passed();
        assert_eq!(answers(&mut writes, &[true; 4]), [false; 4]);
        assert!(Writes::Never.refused(|| unreachable!("no read is needed")));
    }
}
