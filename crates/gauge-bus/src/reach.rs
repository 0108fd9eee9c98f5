// SPDX-License-Identifier: MIT

//! What a bus can carry.
//!
//! The limits are those of `struct i2c_adapter_quirks` of `linux/i2c.h`, and the bits of I2C_FUNCS. Only a write and the
//! read after it are combined, so `I2C_AQ_COMB_WRITE_THEN_READ` is no limit here.

use rustix::io::Errno;

use crate::{BusError, Packet};

/// The limits of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reach {
    /// Longest message that is written, with the register at its start (`max_write_len`).
    pub write: u16,
    /// Longest message that is read (`max_read_len`, `max_comb_2nd_msg_len`).
    pub read: u16,
    /// Longest message that is written before a read in the same transfer (`max_comb_1st_msg_len`).
    pub first: u16,
    /// Only SMBus commands (no `I2C_FUNC_I2C`): without a command they read one byte.
    pub smbus: bool,
    /// Packet error codes are sent and compared (`I2C_FUNC_SMBUS_PEC`).
    pub pec: bool,
    /// Blocks that begin with their length are read (`I2C_FUNC_SMBUS_READ_BLOCK_DATA`).
    pub blocks: bool,
}

impl Default for Reach {
    fn default() -> Self {
        Self::FULL
    }
}

impl Reach {
    /// No limit; the length of a message is a 16-bit number in the kernel.
    pub const FULL: Self =
        Self { write: u16::MAX, read: u16::MAX, first: u16::MAX, smbus: false, pec: true, blocks: true };

    /// One byte a write, and the register before it.
    pub const ONE_BYTE_A_WRITE: Self = Self { write: 2, ..Self::FULL };

    /// So many bytes of data in a message at most, beside the register.
    pub const fn of_data(most: u16) -> Self {
        Self { write: 1 + most, read: most, ..Self::FULL }
    }

    /// SMBus commands with that much data at most: 1 with bytes alone, 2 with words, 32 with I2C blocks.
    pub const fn smbus(most: u16, pec: bool) -> Self {
        Self { first: 1, smbus: true, pec, blocks: false, ..Self::of_data(most) }
    }

    /// With blocks that begin with their length.
    #[must_use]
    pub const fn with_blocks(self) -> Self {
        Self { blocks: true, ..self }
    }

    /// What passes through both.
    #[must_use]
    pub fn narrowed(self, other: Self) -> Self {
        Self {
            write: self.write.min(other.write),
            read: self.read.min(other.read),
            first: self.first.min(other.first),
            smbus: self.smbus || other.smbus,
            pec: self.pec && other.pec,
            blocks: self.blocks && other.blocks,
        }
    }

    /// Refuses a packet that it does not carry as one command.
    pub fn check_packet(self, packet: Packet) -> Result<(), BusError> {
        let has = if packet.is_block { self.blocks } else { self.read >= 2 };
        match self.smbus && has && (self.pec || !packet.pec) {
            true => Ok(()),
            false => Err(BusError::Other(Errno::OPNOTSUPP.raw_os_error())),
        }
    }

    /// Whether it carries a transfer that writes and reads so many bytes.
    pub fn carries(self, write: usize, read: usize) -> bool {
        self.check(write, read).is_ok()
    }

    /// Refuses a transfer that it does not carry.
    pub fn check(self, write: usize, read: usize) -> Result<(), BusError> {
        let written = if read > 0 { self.first.min(self.write) } else { self.write };
        let most = if self.smbus && write == 0 { self.read.min(1) } else { self.read };
        let too_long = |length: usize, most: u16| {
            let bytes = length.try_into().unwrap_or(u16::MAX);
            (length > most.into()).then_some(BusError::TooLong { bytes, most })
        };
        // Without a byte it would be a quick command, which some devices take for a write.
        let quick = self.smbus && write == 0 && read == 0;
        let unsupported = || quick.then_some(BusError::Other(Errno::OPNOTSUPP.raw_os_error()));
        let refused = too_long(write, written).or_else(|| too_long(read, most)).or_else(unsupported);
        refused.map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transfer_is_carried_up_to_each_limit() {
        let cp2112 = Reach { write: 61, read: 512, first: 16, ..Reach::FULL };
        assert!(cp2112.carries(61, 0) && !cp2112.carries(62, 0));
        assert!(cp2112.carries(16, 512) && !cp2112.carries(16, 513) && !cp2112.carries(17, 2));
        assert!(cp2112.carries(0, 512) && cp2112.carries(0, 0));
        assert!(!Reach { write: 8, first: 16, ..Reach::FULL }.carries(9, 2));
        let words = Reach::smbus(2, false);
        assert!(words.carries(3, 0) && !words.carries(4, 0) && words.carries(1, 2) && !words.carries(2, 2));
        assert!(words.carries(0, 1) && !words.carries(0, 2) && !words.carries(0, 0));
        assert!(Reach::FULL.carries(8192, 8192));
    }

    #[test]
    fn two_limits_together_are_the_narrower_ones() {
        let blocks = Reach::smbus(32, true);
        assert_eq!(blocks.narrowed(Reach::FULL), blocks);
        assert_eq!(Reach::FULL.narrowed(blocks), blocks);
        let both = blocks.narrowed(Reach { read: 16, pec: false, ..Reach::ONE_BYTE_A_WRITE });
        assert_eq!(both, Reach { write: 2, read: 16, first: 1, smbus: true, pec: false, blocks: false });
    }

    #[test]
    fn a_packet_is_a_command_of_hosts_that_have_it() {
        let packet = |is_block, pec| Packet { code: 0x20, is_block, pec };
        let carries = |reach: Reach| {
            [(false, false), (true, false), (false, true), (true, true)]
                .map(|(is_block, pec)| reach.check_packet(packet(is_block, pec)).is_ok())
        };
        assert_eq!(carries(Reach::FULL), [false; 4], "it has messages");
        assert_eq!(carries(Reach::smbus(32, true).with_blocks()), [true; 4]);
        assert_eq!(carries(Reach::smbus(2, false).with_blocks()), [true, true, false, false]);
        assert_eq!(carries(Reach::smbus(32, false)), [true, false, false, false]);
        assert_eq!(carries(Reach::smbus(1, true)), [false; 4]);
    }
}
