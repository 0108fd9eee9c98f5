// SPDX-License-Identifier: MIT

//! Locks of gauges in front of a mux and behind it.
//!
//! A gauge in front of a mux, which every channel reaches, excludes those behind it; sibling channels do not. The name of
//! a lock is the path, such as `i2c-0.70.3-55`: adapter before all muxes, each mux and its channel, address.

use std::fmt;
use std::fs;
use std::path::PathBuf;

use super::{Holder, seen};

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Name {
    path: Vec<String>,
    address: String,
}

impl Name {
    pub(super) fn of(path: &str, address: u8) -> Self {
        let path = path.split('.').map(String::from).collect();
        Self { path, address: format!("{address:02x}") }
    }

    /// The gauge of a lock; `None` if it is another kind of lock.
    pub(super) fn parse(key: &str) -> Option<Self> {
        let (path, address) = key.rsplit_once('-').filter(|(path, _)| path.starts_with("i2c-"))?;
        Some(Self::of(path, u8::from_str_radix(address, 16).ok()?))
    }

    fn is_related_to(&self, other: &Self) -> bool {
        let (short, long) = if self.path.len() < other.path.len() { (self, other) } else { (other, self) };
        short.path.len() < long.path.len()
            && long.path.starts_with(&short.path)
            && self.address == other.address
    }

    fn bus(&self) -> String {
        let places = self.path[1..].chunks(2).rev();
        let channels = places.map(|place| match place {
            [mux, channel] => {
                let is_address = mux.len() == 2 && u8::from_str_radix(mux, 16).is_ok();
                format!("channel {channel} of the mux {}{mux} on ", if is_address { "at 0x" } else { "" })
            }
            _ => String::new(),
        });
        channels.chain([self.path[0].clone()]).collect()
    }

    /// Who has a gauge in front of this one or behind it, by the locks in these folders.
    pub(super) fn holder_of_related(&self, folders: &[PathBuf]) -> Option<Holder> {
        let entries = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
        let mut related = entries.filter_map(|entry| {
            let other = Self::parse(entry.file_name().to_str()?.strip_suffix(".lock")?)?;
            self.is_related_to(&other).then(|| (other, entry.path()))
        });
        related.find_map(|(other, path)| Some(Holder { bus: Some(other.bus()), ..seen(&path)? }))
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.path.join("."), self.address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_address_in_front_or_behind_is_related() {
        let name = |key| Name::parse(key).expect("a gauge");
        for (one, other, expected) in [
            ("i2c-0-55", "i2c-0.70.3-55", true),
            ("i2c-0-55", "i2c-0.70.3.71.0-55", true),
            ("i2c-0.70.3-55", "i2c-0.70.3.71.0-55", true),
            ("i2c-0.70.3-55", "i2c-0.70.4-55", false),
            ("i2c-0.70.3-55", "i2c-0.71.3-55", false),
            ("i2c-0-55", "i2c-0.70.3-0b", false),
            ("i2c-1-55", "i2c-10.70.3-55", false),
            ("i2c-0-55", "i2c-0-55", false),
        ] {
            assert_eq!(name(one).is_related_to(&name(other)), expected, "{one} {other}");
            assert_eq!(name(other).is_related_to(&name(one)), expected, "{other} {one}");
        }
        assert_eq!(
            name("i2c-0.70.3.71.0-55").bus(),
            "channel 0 of the mux at 0x71 on channel 3 of the mux at 0x70 on i2c-0"
        );
        assert_eq!(name("i2c-0.70.3-55").to_string(), "i2c-0.70.3-55");
        assert_eq!(Name::parse("sim-0123456789abcdef"), None);
    }
}
