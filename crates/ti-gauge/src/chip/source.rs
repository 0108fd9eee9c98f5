// SPDX-License-Identifier: MIT

//! The places that values of a gauge are read from.

use std::fmt;

/// The place of a value outside of data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    /// A standard command, by the address of its least significant byte.
    Command(u8),
    /// The answer to a subcommand.
    Answer(u16),
    /// CONTROL_STATUS, which is read for the seal in any case.
    Status,
}

impl Source {
    /// The address of a standard command; `None` for another source.
    pub const fn command(self) -> Option<u8> {
        match self {
            Source::Command(code) => Some(code),
            Source::Answer(_) | Source::Status => None,
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Command(code) => write!(f, "0x{code:02x}"),
            Source::Answer(code) => write!(f, "Control(0x{code:04x})"),
            Source::Status => f.write_str("CONTROL_STATUS"),
        }
    }
}
