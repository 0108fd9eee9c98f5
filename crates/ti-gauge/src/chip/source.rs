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
    /// Some bytes of the answer to a subcommand, from that one on.
    Within(u16, u8),
    /// CONTROL_STATUS, which is read for the seal in any case.
    Status,
}

impl Source {
    /// The address of a standard command; `None` for another source.
    pub const fn command(self) -> Option<u8> {
        match self {
            Source::Command(code) => Some(code),
            Source::Answer(_) | Source::Within(..) | Source::Status => None,
        }
    }

    /// The subcommand whose answer has it, and its first byte there; `None` for another source.
    pub const fn answer(self) -> Option<(u16, u8)> {
        match self {
            Source::Answer(code) => Some((code, 0)),
            Source::Within(code, at) => Some((code, at)),
            Source::Command(_) | Source::Status => None,
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Command(code) => write!(f, "0x{code:02x}"),
            Source::Answer(code) => write!(f, "Control(0x{code:04x})"),
            Source::Within(code, at) => write!(f, "Control(0x{code:04x}) byte {at}"),
            Source::Status => f.write_str("CONTROL_STATUS"),
        }
    }
}
