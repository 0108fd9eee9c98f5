// SPDX-License-Identifier: MIT

//! The messages of a transfer, and the memory that they come from and go to.

use rustix::io::Errno;

/// Most bytes of one message, and of one read or write.
pub const MAX_LENGTH: usize = 8192;

/// A message that is read from the target: `I2C_M_RD`.
pub(crate) const M_RD: u16 = 0x0001;
/// Most bytes of an SMBus block.
pub(crate) const BLOCK: usize = 32;

/// The memory of the process that makes a call.
pub trait Memory {
    /// Copies from the address. EFAULT if not all of it can be read.
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno>;
    /// Copies to the address. EFAULT if not all of it can be written.
    fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno>;
}

/// One message of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The address of the target.
    pub address: u16,
    /// Flags of `linux/i2c.h`.
    pub flags: u16,
    /// The bytes to write, or as many as are to be read.
    pub data: Vec<u8>,
    /// Where the caller wants the bytes that are read.
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
