// SPDX-License-Identifier: MIT

//! The 32-byte window at 0x40 to 0x5F, its checksum, and the registers that select its content. It is separate from
//! flash: after a write the host reads this buffer back, whether anything was stored or not.

use std::time::Duration;

use super::envelope::Uncommitted;
use super::flash::BLOCK;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Source {
    /// There is no such block.
    #[default]
    Nothing,
    Flash(u16, u8),
    Authentication,
}

/// The window before a block is loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Before {
    /// The block before, with its checksum.
    Same,
    /// Zeros, with their checksum.
    Blank,
    /// Zeros, with checksum 0.
    Zeros,
}

#[derive(Debug, Default)]
pub(super) struct Window {
    pub(super) control: u8,
    pub(super) class: u8,
    pub(super) block: u8,
    pub(super) source: Source,
    pub(super) data: [u8; BLOCK],
    /// As it was loaded or committed.
    loaded: [u8; BLOCK],
    /// Bytes after it stay 0.
    length: usize,
    /// The checksum as loaded or committed, which may not be that of `data`.
    pub(super) sum: u8,
    /// The load's end, and what is read before.
    ready: Duration,
    early: ([u8; BLOCK], u8),
}

impl Window {
    /// The window after a reset, which shows the challenge field if there is one.
    pub(super) fn new(authentication: bool) -> Self {
        let source = if authentication { Source::Authentication } else { Source::Nothing };
        Self { source, length: BLOCK, sum: 0xFF, ..Self::default() }
    }

    /// Shows `bytes` of `source` from `ready` on, and `before` until then.
    pub(super) fn load(&mut self, source: Source, bytes: &[u8], before: Before, ready: Duration) {
        self.early = match before {
            Before::Same => (self.data, self.sum),
            Before::Blank => ([0; BLOCK], checksum(&[0; BLOCK])),
            Before::Zeros => ([0; BLOCK], 0),
        };
        self.source = source;
        self.data = [0; BLOCK];
        self.length = match source {
            Source::Authentication => BLOCK,
            _ => bytes.len(),
        };
        self.data[..bytes.len()].copy_from_slice(bytes);
        self.sum = checksum(&self.data);
        self.loaded = self.data;
        self.ready = ready;
    }

    /// The sum has come that commits what the buffer has now.
    pub(super) fn commit(&mut self, sum: u8) {
        (self.sum, self.loaded) = (sum, self.data);
    }

    pub(super) fn read(&self, index: usize, uncommitted: Uncommitted, now: Duration) -> u8 {
        match uncommitted {
            _ if now < self.ready => self.early.0[index],
            Uncommitted::Stored if matches!(self.source, Source::Flash(..)) => self.loaded[index],
            Uncommitted::Stored | Uncommitted::Written => self.data[index],
        }
    }

    pub(super) fn read_sum(&self, now: Duration) -> u8 {
        if now < self.ready { self.early.1 } else { self.sum }
    }

    /// Changes a byte of the buffer. The load overwrites an earlier byte; one beyond the block's end has no place.
    pub(super) fn write(&mut self, index: usize, byte: u8, now: Duration) {
        if now >= self.ready && index < self.length {
            self.data[index] = byte;
        }
    }

    /// The block's bytes as the buffer has them now.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.data[..self.length]
    }
}

/// 255 less the sum of the bytes.
pub(super) fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0u8, |sum, &byte| sum.wrapping_add(byte))
}
