// SPDX-License-Identifier: MIT

//! An ioctl's argument: read from the caller's memory, checked and decoded. Nothing here reaches a bus.

use rustix::io::Errno;

use crate::message::{BLOCK, M_RD, MAX_LENGTH, Memory, Message};
use crate::smbus::Transaction;

/// Most messages of one I2C_RDWR.
pub const MAX_MESSAGES: usize = 42;

/// The numbers of the ioctls, as in `linux/i2c-dev.h`.
#[allow(missing_docs, reason = "the kernel's documentation describes them")]
pub mod command {
    pub const I2C_RETRIES: u32 = 0x0701;
    pub const I2C_TIMEOUT: u32 = 0x0702;
    pub const I2C_SLAVE: u32 = 0x0703;
    pub const I2C_TENBIT: u32 = 0x0704;
    pub const I2C_FUNCS: u32 = 0x0705;
    pub const I2C_SLAVE_FORCE: u32 = 0x0706;
    pub const I2C_RDWR: u32 = 0x0707;
    pub const I2C_PEC: u32 = 0x0708;
    pub const I2C_SMBUS: u32 = 0x0720;
}

const M_RECV_LEN: u16 = 0x0400;

/// Bits of the caller's pointers and of its `unsigned long`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// A program of 32 bits, also on a kernel of 64 bits.
    Bits32,
    /// A program of 64 bits.
    Bits64,
}

impl Width {
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::Bits32 => 4,
            Self::Bits64 => 8,
        }
    }

    fn pointer(self, bytes: &[u8]) -> u64 {
        match self {
            Self::Bits32 => u32(bytes).into(),
            Self::Bits64 => bytes.first_chunk().map_or(0, |pointer: &[u8; 8]| u64::from_ne_bytes(*pointer)),
        }
    }
}

fn u16(bytes: &[u8]) -> u16 {
    bytes.first_chunk().map_or(0, |word: &[u8; 2]| u16::from_ne_bytes(*word))
}

fn u32(bytes: &[u8]) -> u32 {
    bytes.first_chunk().map_or(0, |word: &[u8; 4]| u32::from_ne_bytes(*word))
}

/// A decoded ioctl.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// I2C_SLAVE or I2C_SLAVE_FORCE: without bound drivers they do the same.
    Address(u64),
    /// I2C_TENBIT.
    TenBit(bool),
    /// I2C_PEC.
    Pec(bool),
    /// I2C_RETRIES and I2C_TIMEOUT.
    Accepted,
    /// I2C_FUNCS, and the place of its answer.
    Functions(u64, Width),
    /// I2C_RDWR.
    Messages(Vec<Message>),
    /// I2C_SMBUS: the transaction, and the address of the caller's data.
    Smbus(Transaction, u64),
}

impl Request {
    /// Places of the answer in the caller's memory, and their lengths: the addresses of [`Outcome::writes`] in their
    /// order.
    ///
    /// [`Outcome::writes`]: crate::Outcome::writes
    pub fn answers(&self) -> Vec<(u64, usize)> {
        match self {
            Self::Functions(at, width) => vec![(*at, width.bytes())],
            Self::Messages(messages) => {
                let read = messages.iter().filter(|message| message.is_read() && !message.data.is_empty());
                read.map(|message| (message.destination, message.data.len())).collect()
            }
            Self::Smbus(transaction, at) => {
                transaction.answer().map(|length| (*at, length)).into_iter().collect()
            }
            Self::Address(_) | Self::TenBit(_) | Self::Pec(_) | Self::Accepted => Vec::new(),
        }
    }

    /// Decodes the number and the argument of an ioctl, with the kernel's checks in its order.
    pub fn decode(command: u32, argument: u64, width: Width, memory: &mut dyn Memory) -> Result<Self, Errno> {
        // A program of 32 bits cannot pass more.
        let argument = if width == Width::Bits32 { argument & u64::from(u32::MAX) } else { argument };
        Ok(match command {
            command::I2C_SLAVE | command::I2C_SLAVE_FORCE => Self::Address(argument),
            command::I2C_TENBIT => Self::TenBit(argument != 0),
            command::I2C_PEC => Self::Pec(argument != 0),
            command::I2C_RETRIES | command::I2C_TIMEOUT if argument > i32::MAX as u64 => {
                return Err(Errno::INVAL);
            }
            command::I2C_RETRIES | command::I2C_TIMEOUT => Self::Accepted,
            command::I2C_FUNCS => Self::Functions(argument, width),
            command::I2C_RDWR => Self::Messages(messages(argument, width, memory)?),
            command::I2C_SMBUS => {
                let mut head = [0; 16];
                let head = &mut head[..8 + width.bytes()];
                memory.read(argument, head)?;
                let data = width.pointer(&head[8..]);
                Self::Smbus(Transaction::decode(head[0], head[1], u32(&head[4..]), data, memory)?, data)
            }
            _ => return Err(Errno::NOTTY),
        })
    }
}

fn messages(argument: u64, width: Width, memory: &mut dyn Memory) -> Result<Vec<Message>, Errno> {
    let mut head = [0; 16];
    let head = &mut head[..2 * width.bytes()];
    memory.read(argument, head)?;
    let (list, count) = (width.pointer(head), u32(&head[width.bytes()..]) as usize);
    if list == 0 || count == 0 || count > MAX_MESSAGES {
        return Err(Errno::INVAL);
    }
    let size = 8 + width.bytes();
    let mut raw = vec![0; count * size];
    memory.read(list, &mut raw)?;
    let message = |raw: &[u8]| {
        let (address, flags, length) = (u16(raw), u16(&raw[2..]), usize::from(u16(&raw[4..])));
        if length > MAX_LENGTH {
            return Err(Errno::INVAL);
        }
        let destination = width.pointer(&raw[8..]);
        let mut data = vec![0; length];
        // As in the kernel, which also copies the buffer of a read.
        if length > 0 {
            memory.read(destination, &mut data)?;
        }
        if flags & M_RECV_LEN != 0 {
            let first = data.first().copied().map_or(0, usize::from);
            if flags & M_RD == 0 || first < 1 || length < first + BLOCK {
                return Err(Errno::INVAL);
            }
        }
        Ok(Message { address, flags, data, destination })
    };
    raw.chunks_exact(size).map(message).collect()
}
