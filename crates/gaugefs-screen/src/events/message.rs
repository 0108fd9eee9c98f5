// SPDX-License-Identifier: MIT

//! Messages of systemd-udevd to listeners with libudev: a header, then the device's properties, each with a NUL at its
//! end.
//!
//! Source: systemd, `src/libsystemd/sd-device/device-monitor.c`, `monitor_netlink_header`. The hashes in the header let
//! the kernel drop what a listener has not asked for.

use std::time::Duration;

/// The group of [`NETLINK_KOBJECT_UEVENT`](nix::sys::socket::SockProtocol) that these listeners join, as a bit; udevd
/// hears the kernel's own messages in group 1.
pub(super) const GROUP: u32 = 2;

const PREFIX: &[u8; 8] = b"libudev\0";
const MAGIC: u32 = 0xfeed_cafe;
const HEADER: u32 = 40;
const SUBSYSTEM: &str = "power_supply";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Add,
    Change,
    Remove,
}

impl Action {
    fn word(self) -> &'static str {
        match self {
            Self::Add => "add",
            Self::Change => "change",
            Self::Remove => "remove",
        }
    }
}

/// A message about a power supply. Its path begins below `/sys`. The sequence number is above 0, because libudev drops
/// other messages. The time is that since the machine started.
pub(super) fn message(action: Action, devpath: &str, name: &str, sequence: u64, uptime: Duration) -> Vec<u8> {
    let properties = format!(
        "ACTION={}\0DEVPATH={devpath}\0SUBSYSTEM={SUBSYSTEM}\0SEQNUM={sequence}\0POWER_SUPPLY_NAME={name}\0\
         USEC_INITIALIZED={}\0",
        action.word(),
        uptime.as_micros().max(1)
    );
    let length = u32::try_from(properties.len()).expect("a path is shorter");
    let mut message = PREFIX.to_vec();
    message.extend(MAGIC.to_be_bytes());
    // Length of the header, offset of the properties, and their length.
    for number in [HEADER, HEADER, length] {
        message.extend(number.to_ne_bytes());
    }
    message.extend(murmur_hash_2(SUBSYSTEM.as_bytes()).to_be_bytes());
    // Hash of DEVTYPE and Bloom filter of tags: a power supply has neither.
    message.extend([0; 12]);
    message.extend(properties.as_bytes());
    message
}

/// Austin Appleby's MurmurHash2 with seed 0.
fn murmur_hash_2(text: &[u8]) -> u32 {
    const M: u32 = 0x5bd1_e995;
    let (words, rest) = text.as_chunks::<4>();
    let mut hash = u32::try_from(text.len()).expect("a short text");
    for &word in words {
        let mixed = u32::from_le_bytes(word).wrapping_mul(M);
        hash = hash.wrapping_mul(M) ^ (mixed ^ mixed >> 24).wrapping_mul(M);
    }
    if !rest.is_empty() {
        let tail = rest.iter().rev().fold(0, |tail, &byte| tail << 8 | u32::from(byte));
        hash = (hash ^ tail).wrapping_mul(M);
    }
    hash = (hash ^ hash >> 13).wrapping_mul(M);
    hash ^ hash >> 15
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_has_the_bytes_that_libudev_reads() {
        let properties = b"ACTION=add\0DEVPATH=/class/power_supply/BAT0\0SUBSYSTEM=power_supply\0SEQNUM=7\0\
            POWER_SUPPLY_NAME=BAT0\0USEC_INITIALIZED=1500000\0";
        let mut expected = b"libudev\0\xfe\xed\xca\xfe".to_vec();
        for number in [40, 40, properties.len() as u32] {
            expected.extend(number.to_ne_bytes());
        }
        expected.extend(b"\xb1\xac\xbc\xca\0\0\0\0\0\0\0\0\0\0\0\0");
        expected.extend(properties);
        let path = "/class/power_supply/BAT0";
        assert_eq!(message(Action::Add, path, "BAT0", 7, Duration::from_millis(1500)), expected);
    }

    /// Hashes that `udevadm monitor --udev --subsystem-match=...` puts into its socket's filter, for names of each
    /// length modulo 4.
    const HASHES: [(&str, u32); 4] = [
        ("power_supply", 0xb1ac_bcca),
        ("block", 0xf003_1db7),
        ("hidraw", 0xc2ca_f397),
        ("usb", 0x0577_c5e5),
    ];

    #[test]
    fn subsystems_have_the_hashes_of_libudev() {
        for (text, hash) in HASHES {
            assert_eq!(murmur_hash_2(text.as_bytes()), hash, "{text}");
        }
    }
}
