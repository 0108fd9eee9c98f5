// SPDX-License-Identifier: MIT

//! The messages of a transfer, and the memory of their caller.

use rustix::io::Errno;

/// Longest message, read and write.
pub const MAX_LENGTH: usize = 8192;

pub(crate) const M_RD: u16 = 0x0001;
/// Longest SMBus block.
pub(crate) const BLOCK: usize = 32;

/// The memory of a calling process.
pub trait Memory {
    /// Copies from the address, or fails with EFAULT if some of it is unreadable.
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno>;
    /// Copies to the address, or fails with EFAULT if some of it is not writable.
    fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno>;
}

/// One message of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The address of the target.
    pub address: u16,
    /// Flags of `linux/i2c.h`.
    pub flags: u16,
    /// The bytes to write, or room for the bytes to read.
    pub data: Vec<u8>,
    /// The caller's address for the bytes that are read.
    pub destination: u64,
}

impl Message {
    pub(crate) fn write(address: u16, data: Vec<u8>) -> Self {
        Self { address, flags: 0, data, destination: 0 }
    }

    pub(crate) fn read(address: u16, length: usize) -> Self {
        Self { address, flags: M_RD, data: vec![0; length], destination: 0 }
    }

    /// Whether the target sends the bytes.
    pub fn is_read(&self) -> bool {
        self.flags & M_RD != 0
    }
}
