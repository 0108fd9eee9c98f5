// SPDX-License-Identifier: MIT

//! Multiplexers, as sysfs shows them: each channel is an adapter, in the folder of the one in front of the mux, and its
//! link `mux_device` leads to the mux. Nothing is written to a mux or to its `idle_state`.

use std::fs;
use std::path::{Path, PathBuf};

use crate::regular;

/// `MUX_IDLE_DISCONNECT` of the kernel.
const DISCONNECT: &str = "-2";

/// A mux on an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mux {
    /// Its device, such as `0-0070`.
    pub device: String,
    /// What it is, such as `pca9548`.
    pub name: String,
    /// Its address, if it has one.
    pub address: Option<u8>,
    /// The adapters that are its channels, by their numbers.
    pub channels: Vec<u64>,
    /// It connects no channel while nobody uses one; `None` for one that cannot, as the manager of Smart Batteries.
    pub disconnects: Option<bool>,
}

pub(super) fn device(root: &Path, number: u64) -> PathBuf {
    root.join(format!("sys/bus/i2c/devices/i2c-{number}"))
}

/// The adapters in front of the muxes that lead to an adapter, in the system below `root`: the nearest first.
pub(super) fn above(root: &Path, number: u64) -> Vec<u64> {
    std::iter::successors(parent(root, number), |&number| parent(root, number)).collect()
}

fn parent(root: &Path, number: u64) -> Option<u64> {
    let device = device(root, number);
    fs::read_link(device.join("mux_device")).ok()?;
    fs::canonicalize(device).ok()?.parent()?.file_name()?.to_str()?.strip_prefix("i2c-")?.parse().ok()
}

fn all(root: &Path) -> Vec<u64> {
    let devices = fs::read_dir(root.join("sys/bus/i2c/devices")).into_iter().flatten().flatten();
    let number = |name: &str| name.strip_prefix("i2c-")?.parse().ok();
    let mut all: Vec<u64> = devices.filter_map(|device| number(device.file_name().to_str()?)).collect();
    all.sort_unstable();
    all
}

/// The adapters behind the muxes of an adapter, also behind several.
pub(super) fn below(root: &Path, number: u64) -> Vec<u64> {
    let mut all = all(root);
    all.retain(|&other| above(root, other).contains(&number));
    all
}

/// The muxes on an adapter.
pub fn muxes(root: &Path, number: u64) -> Vec<Mux> {
    let mut muxes: Vec<Mux> = Vec::new();
    for channel in all(root).into_iter().filter(|&other| parent(root, other) == Some(number)) {
        let Some(device) = mux_of(root, channel) else { continue };
        match muxes.iter_mut().find(|mux| mux.device == device) {
            Some(mux) => mux.channels.push(channel),
            None => muxes.push(Mux::of(root, channel, device)),
        }
    }
    muxes
}

fn mux_of(root: &Path, channel: u64) -> Option<String> {
    let link = fs::read_link(device(root, channel).join("mux_device")).ok()?;
    Some(link.file_name()?.to_str()?.to_string())
}

impl Mux {
    fn of(root: &Path, channel: u64, device: String) -> Self {
        let folder = self::device(root, channel).join("mux_device");
        let text = |name: &str| {
            let text = regular::read_text(&folder.join(name), regular::SYSTEM).ok()?;
            Some(text.trim().to_string()).filter(|text| !text.is_empty())
        };
        Self {
            name: text("name").unwrap_or_else(|| device.clone()),
            address: address(&device),
            channels: vec![channel],
            disconnects: folder
                .join("idle_state")
                .exists()
                .then(|| text("idle_state").as_deref() == Some(DISCONNECT)),
            device,
        }
    }
}

fn address(device: &str) -> Option<u8> {
    u8::from_str_radix(device.split_once('-')?.1, 16)
        .ok()
        .filter(|_| device.starts_with(|c: char| c.is_ascii_digit()))
}

/// The muxes in words, with what to use instead: `i2c-0 has a mux, pca9548 at 0x70: use i2c-1 to i2c-8`.
pub fn described(number: u64, muxes: &[Mux]) -> Option<String> {
    let channels: Vec<_> = muxes.iter().map(|mux| channels(&mux.channels)).collect();
    let names = muxes.iter().map(|Mux { name, address, .. }| match address {
        Some(address) => format!("{name} at 0x{address:02x}"),
        None => name.clone(),
    });
    let names = names.collect::<Vec<_>>().join(" and ");
    let what = match muxes {
        [] => return None,
        [_] => "a mux",
        _ => "muxes",
    };
    Some(format!("i2c-{number} has {what}, {names}: use {}", channels.join(" or ")))
}

/// The mux that keeps a channel connected, if one does: in front of it the gauge changes whenever somebody uses another one.
pub fn connected(muxes: &[Mux]) -> Option<&Mux> {
    muxes.iter().find(|mux| mux.disconnects != Some(true))
}

fn channels(numbers: &[u64]) -> String {
    match numbers {
        [first, .., last] if last - first + 1 == numbers.len() as u64 => format!("i2c-{first} to i2c-{last}"),
        _ => numbers.iter().map(|number| format!("i2c-{number}")).collect::<Vec<_>>().join(", "),
    }
}

/// The way from the adapter before all muxes, by mux and channel: `i2c-0.70.3`. It shows what is in front.
pub(super) fn path(root: &Path, number: u64) -> String {
    let Some((parent, device)) = parent(root, number).zip(mux_of(root, number)) else {
        return format!("i2c-{number}");
    };
    let mux = match address(&device) {
        Some(address) => format!("{address:02x}"),
        None => device.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_"),
    };
    format!("{}.{mux}.{}", path(root, parent), channel(root, number).unwrap_or(number))
}

/// The channel of its mux that an adapter is: the kernel names it `i2c-0-mux (chan_id 3)`.
fn channel(root: &Path, number: u64) -> Option<u64> {
    let name = regular::read_text(&device(root, number).join("name"), regular::SYSTEM).ok()?;
    name.trim().strip_suffix(')')?.rsplit_once("chan_id ")?.1.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linux::fake::System;

    /// A USB bridge with a mux of two channels, another mux behind the second channel, and an adapter beside them.
    fn system(name: &str) -> System {
        let system = System::new(name);
        system.adapter(0, Some("mcp2221"), "MCP2221 usb-i2c bridge");
        system.channel(0, 1, "0-0070", 0);
        system.channel(0, 2, "0-0070", 1);
        system.channel(2, 9, "2-0071", 4);
        system.adapter(5, Some("cp2112"), "CP2112 SMBus Bridge on hidraw0");
        system.write("sys/devices/usb/0/i2c-0/0-0070/name", b"pca9548\n");
        system
    }

    #[test]
    fn a_channel_shows_what_is_in_front_of_it() {
        let system = system("tree");
        let root = system.root();
        assert_eq!((above(root, 9), above(root, 1), above(root, 0)), (vec![2, 0], vec![0], vec![]));
        assert_eq!((below(root, 0), below(root, 2), below(root, 5)), (vec![1, 2, 9], vec![9], vec![]));
        let paths = [0, 1, 2, 9, 5, 77].map(|number| path(root, number));
        let expected = ["i2c-0", "i2c-0.70.0", "i2c-0.70.1", "i2c-0.70.1.71.4", "i2c-5", "i2c-77"];
        assert_eq!(paths, expected);
    }

    #[test]
    fn a_mux_is_described_with_the_buses_to_use() {
        let system = system("muxes");
        let says = |number| described(number, &muxes(system.root(), number));
        assert_eq!(says(0).as_deref(), Some("i2c-0 has a mux, pca9548 at 0x70: use i2c-1 to i2c-2"));
        assert_eq!((says(1), says(5)), (None, None));
        system.channel(5, 6, "i2c-mux-gpio.0", 0);
        system.channel(5, 8, "i2c-mux-gpio.0", 1);
        system.channel(5, 7, "5-0070", 0);
        let expected = "i2c-5 has muxes, i2c-mux-gpio.0 and 5-0070 at 0x70: use i2c-6, i2c-8 or i2c-7";
        assert_eq!(says(5).as_deref(), Some(expected));
        assert_eq!(path(system.root(), 8), "i2c-5.i2c_mux_gpio_0.1");
    }

    /// The kernel's sbs-manager makes a channel of each pack that an LTC1760 has: the first and the fourth here.
    #[test]
    fn each_pack_of_a_manager_is_a_bus_with_a_path_of_its_own() {
        let system = system("manager");
        system.channel(5, 10, "5-000a", 0);
        system.channel(5, 13, "5-000a", 3);
        fs::write(device(system.root(), 5).join("5-000a/name"), "ltc1760\n").expect("a file");
        let muxes = muxes(system.root(), 5);
        let says = described(5, &muxes);
        assert_eq!(says.as_deref(), Some("i2c-5 has a mux, ltc1760 at 0x0a: use i2c-10, i2c-13"));
        assert_eq!((connected(&muxes), muxes[0].disconnects), (Some(&muxes[0]), None));
        assert_eq!([10, 13].map(|number| path(system.root(), number)), ["i2c-5.0a.0", "i2c-5.0a.3"]);
        assert_eq!(above(system.root(), 13), [5]);
    }

    #[test]
    fn only_a_mux_that_says_so_connects_nothing_while_it_is_idle() {
        let system = system("idle");
        let disconnects = || muxes(system.root(), 0)[0].disconnects;
        assert_eq!(disconnects(), None, "it has no such file");
        for (state, expected) in [("-1", false), ("0", false), ("-2", true), ("", false)] {
            system.write("sys/devices/usb/0/i2c-0/0-0070/idle_state", format!("{state}\n").as_bytes());
            assert_eq!(disconnects(), Some(expected), "{state}");
        }
    }
}
