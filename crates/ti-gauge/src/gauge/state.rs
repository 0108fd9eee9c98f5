// SPDX-License-Identifier: MIT

//! What is known of a gauge's state: its seal, and a look at CONTROL_STATUS. Types only.

/// Most bytes following Control() that can be read in the same transfer.
pub const BEHIND: usize = 0x3A;

/// The seal state of a gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// Data flash cannot be accessed.
    Sealed,
    /// Data flash can be read and written.
    Unsealed,
    /// Like UNSEALED, and keys can be changed.
    FullAccess,
}

/// A look at CONTROL_STATUS.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub(crate) seal: Seal,
    /// The word.
    pub(crate) status: u32,
    /// The registers from 0x02 on, as far as they were read with it.
    pub(crate) behind: [u8; BEHIND],
}

impl Look {
    pub(super) const NONE: Self = Self { seal: Seal::Sealed, status: 0, behind: [0; BEHIND] };
}

impl Seal {
    /// The word for it in `gauge/seal`.
    pub fn as_str(self) -> &'static str {
        match self {
            Seal::Sealed => "sealed",
            Seal::Unsealed => "unsealed",
            Seal::FullAccess => "full-access",
        }
    }
}
