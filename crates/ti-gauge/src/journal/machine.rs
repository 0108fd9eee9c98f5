// SPDX-License-Identifier: MIT

//! The machine that wrote a journal. Several may keep their journals in one folder.

use std::fmt;
use std::path::Path;
use std::sync::OnceLock;

use gauge_bus::regular;
use sha1::{Digest as _, Sha1};

use crate::text::hex;

const UNKNOWN: &str = "-";

/// A host: its name, its identifier, and its last start. None of them is secret.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    name: String,
    id: String,
    boot: String,
}

/// The line of a journal: `host NAME ID BOOT`.
impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "host {} {} {}", self.name, self.id, self.boot)
    }
}

impl Machine {
    /// This process's machine.
    pub fn this() -> &'static Self {
        static THIS: OnceLock<Machine> = OnceLock::new();
        THIS.get_or_init(|| {
            let text = |path| regular::read_text(Path::new(path), regular::SYSTEM).ok();
            let read = |path| text(path).as_deref().map(str::trim).map(word);
            let or_unknown = |text: Option<String>| text.unwrap_or_else(|| UNKNOWN.into());
            // machine-id(5) asks programs not to disclose it.
            let hashed = |text: String| hex(&Sha1::digest(format!("gaugefs {text}")))[..16].to_string();
            Self {
                name: or_unknown(read("/proc/sys/kernel/hostname")),
                id: or_unknown(read("/etc/machine-id").filter(|id| id != UNKNOWN).map(hashed)),
                boot: or_unknown(read("/proc/sys/kernel/random/boot_id")),
            }
        })
    }

    pub(crate) fn named(name: &str) -> Self {
        let name = word(name);
        Self { id: name.clone(), boot: name.clone(), name }
    }

    /// Its identifier; `-` without one.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Identifier of its last start, which its containers share.
    pub fn boot(&self) -> &str {
        &self.boot
    }

    /// Whether it is the same machine. Containers of a host differ in the first two, and share its start.
    pub fn is(&self, other: &Self) -> bool {
        let same = |one: &str, other: &str| one != UNKNOWN && one == other;
        let nameless = self.id == UNKNOWN && other.id == UNKNOWN;
        same(&self.boot, &other.boot) || same(&self.id, &other.id) || nameless && self.name == other.name
    }

    /// The machine in such a line.
    pub fn parse(line: &str) -> Option<Self> {
        let mut words = line.strip_prefix("host ")?.split(' ').map(word);
        let machine = Self { name: words.next()?, id: words.next()?, boot: words.next()? };
        words.next().is_none().then_some(machine)
    }
}

fn word(text: &str) -> String {
    let word: String = text.chars().filter(|letter| letter.is_ascii_graphic()).take(64).collect();
    if word.is_empty() { UNKNOWN.into() } else { word }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_recognised_after_a_start_and_in_a_container() {
        let machine = |name: &str, id: &str, boot: &str| Machine {
            name: name.into(),
            id: id.into(),
            boot: boot.into(),
        };
        let bench = machine("bench", "a1", "b1");
        assert!(bench.is(&machine("bench", "a1", "b2")), "after a start");
        assert!(bench.is(&machine("5f2c", "-", "b1")), "in a container");
        assert!(!bench.is(&machine("bench", "a2", "b2")), "another one of that name");
        assert!(!machine("-", "-", "-").is(&bench) && machine("pi", "-", "-").is(&machine("pi", "-", "b9")));
        let this = Machine::this();
        assert_eq!(Machine::parse(&this.to_string()).as_ref(), Some(this));
        assert!(this.is(this));
    }
}
