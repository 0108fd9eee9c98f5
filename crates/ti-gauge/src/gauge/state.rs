// SPDX-License-Identifier: MIT

//! What is known of a gauge's state: its seal, and a look at CONTROL_STATUS. Types only.

use crate::chip::{Register, Source};

/// Most rows that can be read along with CONTROL_STATUS.
pub const ALONG: usize = 8;

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

#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows([Option<(Source, u32)>; ALONG]);

impl Rows {
    const NONE: Self = Self([None; ALONG]);

    pub(super) fn of(rows: &[Source], value: impl Fn(&Source) -> Option<u16>) -> Self {
        let mut found = Self::NONE;
        let values = rows.iter().filter_map(|row| Some((*row, value(row)?.into())));
        for (place, row) in found.0.iter_mut().zip(values) {
            *place = Some(row);
        }
        found
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub(crate) seal: Seal,
    pub(crate) status: u32,
    pub(super) rows: Rows,
}

impl Look {
    pub(super) const NONE: Self = Self { seal: Seal::Sealed, status: 0, rows: Rows::NONE };

    /// A word that the look has shown; `None` if it was not asked for.
    pub(crate) fn word(&self, row: Source) -> Option<u32> {
        if row == Source::Status {
            return Some(self.status);
        }
        self.rows.0.iter().flatten().find(|(found, _)| *found == row).map(|(_, word)| *word)
    }
}

/// What a read of the table's rows has brought.
pub(crate) enum Answer<'a> {
    /// Bytes from an address on.
    Burst(u8, &'a [u8]),
    /// A row, and its bytes; `None` if the gauge has none.
    Row(&'a Register, Option<&'a [u8]>),
}

/// What a read shows of the window of data flash.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown<'a> {
    pub(crate) selection: Option<[u8; 2]>,
    /// The bytes from there on; what follows the window may be among them.
    pub(crate) at: usize,
    pub(crate) window: &'a [u8],
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
