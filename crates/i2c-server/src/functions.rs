// SPDX-License-Identifier: MIT

//! The bits of I2C_FUNCS.

/// The answer to I2C_FUNCS: I2C messages; quick commands, bytes, words, process calls, I2C blocks and block writes of SMBus;
/// packet error codes.
pub const FUNCTIONS: u64 = 0x0000_0001 | 0x0000_0008 | 0x00ff_0000 | 0x0200_0000 | 0x0c00_0000;

/// The bits of whole messages, and of packet error codes.
pub(crate) const I2C: u64 = 0x0000_0001;
pub(crate) const PEC: u64 = 0x0000_0008;
/// Blocks that are read and begin with their length, which only hosts without messages have.
pub(crate) const READ_BLOCK: u64 = 0x0100_0000;
