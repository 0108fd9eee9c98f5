// SPDX-License-Identifier: MIT

//! SMBus transactions, emulated with I2C messages as in the kernel (`i2c_smbus_xfer_emulated`).

use rustix::io::Errno;

use crate::adapter::Adapter;
use crate::functions::{I2C, PEC, READ_BLOCK};
use crate::message::{BLOCK, Memory, Message};

/// A transaction's size field: I2C_SMBUS_QUICK and those after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Quick,
    Byte,
    ByteData,
    WordData,
    ProcessCall,
    Block,
    I2cBlock,
    BlockProcessCall,
}

/// One SMBus transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transaction {
    kind: Kind,
    is_read: bool,
    command: u8,
    /// The part of `union i2c_smbus_data` that the kind uses.
    data: Vec<u8>,
}

impl Transaction {
    /// `data` is the address of the caller's `union i2c_smbus_data`.
    pub(crate) fn decode(
        direction: u8,
        command: u8,
        size: u32,
        data: u64,
        memory: &mut dyn Memory,
    ) -> Result<Self, Errno> {
        const BROKEN: u32 = 6;
        let kind = match size {
            0 => Kind::Quick,
            1 => Kind::Byte,
            2 => Kind::ByteData,
            3 => Kind::WordData,
            4 => Kind::ProcessCall,
            5 => Kind::Block,
            BROKEN | 8 => Kind::I2cBlock,
            7 => Kind::BlockProcessCall,
            _ => return Err(Errno::INVAL),
        };
        let is_read = match direction {
            0 => false,
            1 => true,
            _ => return Err(Errno::INVAL),
        };
        let length = match kind {
            Kind::Quick => 0,
            Kind::Byte if !is_read => 0,
            Kind::Byte | Kind::ByteData => 1,
            Kind::WordData | Kind::ProcessCall => 2,
            Kind::Block | Kind::I2cBlock | Kind::BlockProcessCall => BLOCK + 2,
        };
        let mut bytes = vec![0; length];
        if length > 0 {
            if data == 0 {
                return Err(Errno::INVAL);
            }
            let is_call = matches!(kind, Kind::ProcessCall | Kind::BlockProcessCall);
            if !is_read || is_call || size == 8 {
                memory.read(data, &mut bytes)?;
            }
            // The old kind of I2C block is read with its whole length.
            if size == BROKEN && is_read {
                bytes[0] = BLOCK as u8;
            }
        }
        Ok(Self { kind, is_read, command, data: bytes })
    }

    /// Its bit in I2C_FUNCS.
    fn function(&self) -> u64 {
        let (read, has_two) = match self.kind {
            Kind::Quick => (0x0001_0000, false),
            Kind::Byte => (0x0002_0000, true),
            Kind::ByteData => (0x0008_0000, true),
            Kind::WordData => (0x0020_0000, true),
            Kind::ProcessCall => (0x0080_0000, false),
            Kind::Block => (0x0100_0000, true),
            Kind::I2cBlock => (0x0400_0000, true),
            Kind::BlockProcessCall => (0x0000_8000, false),
        };
        if has_two && !self.is_read { read << 1 } else { read }
    }

    pub(crate) fn answer(&self) -> Option<usize> {
        let has = match self.kind {
            Kind::Quick | Kind::BlockProcessCall => false,
            Kind::Byte | Kind::ByteData | Kind::WordData | Kind::Block | Kind::I2cBlock => self.is_read,
            Kind::ProcessCall => true,
        };
        has.then_some(self.data.len())
    }

    pub(crate) fn run(
        mut self,
        adapter: &Adapter,
        address: u16,
        pec: bool,
    ) -> Result<Option<Vec<u8>>, Errno> {
        // The kernel emulates the others with messages.
        if adapter.functions() & (I2C | self.function()) == 0 {
            return Err(Errno::OPNOTSUPP);
        }
        let block = || match self.data[0] {
            length @ 1..=32 => Ok(usize::from(length)),
            _ => Err(Errno::INVAL),
        };
        // Bytes written after the command, and number of bytes read.
        let (written, read): (&[u8], usize) = match (self.kind, self.is_read) {
            (Kind::Quick, _) => return self.quick(adapter, address),
            (Kind::Block, true) => return self.block(adapter, address, pec),
            (Kind::BlockProcessCall, _) => return Err(Errno::OPNOTSUPP),
            (Kind::Byte, true) => (&[], 1),
            (Kind::Byte, false) => (&[], 0),
            (Kind::ByteData | Kind::WordData, true) => (&[], self.data.len()),
            (Kind::ByteData | Kind::WordData, false) => (&self.data, 0),
            (Kind::ProcessCall, _) => (&self.data, 2),
            (Kind::Block, false) => (&self.data[..=block()?], 0),
            (Kind::I2cBlock, true) => (&[], block()?),
            (Kind::I2cBlock, false) => (&self.data[1..=block()?], 0),
        };
        // SMBus words are little-endian on the wire, and native in the union.
        let is_word = matches!(self.kind, Kind::WordData | Kind::ProcessCall);
        let written = if is_word && !written.is_empty() { swapped(written) } else { written.to_vec() };
        let pec = pec && self.kind != Kind::I2cBlock && adapter.functions() & PEC != 0;
        let mut messages = Vec::new();
        // A byte is received without a command.
        if !(self.kind == Kind::Byte && self.is_read) {
            messages.push(Message::write(address, [&[self.command], &written[..]].concat()));
        }
        if read > 0 {
            messages.push(Message::read(address, read + usize::from(pec)));
        } else if pec {
            let code = messages.iter().fold(0, code);
            messages[0].data.push(code);
        }
        adapter.transfer(&mut messages)?;
        let Some(Message { data: answer, .. }) = messages.last().filter(|_| read > 0) else {
            return Ok(None);
        };
        if pec && messages.iter().fold(0, code) != 0 {
            return Err(Errno::BADMSG);
        }
        let answer = &answer[..read];
        match self.kind {
            Kind::I2cBlock => self.data[1..=read].copy_from_slice(answer),
            _ if is_word => self.data = swapped(answer),
            _ => self.data = answer.to_vec(),
        }
        Ok(Some(self.data))
    }

    /// A block whose length the target says. All that it could send is read, as more than a block is harmless here.
    fn block(mut self, adapter: &Adapter, address: u16, pec: bool) -> Result<Option<Vec<u8>>, Errno> {
        if adapter.functions() & READ_BLOCK == 0 {
            return Err(Errno::OPNOTSUPP);
        }
        let pec = usize::from(pec && adapter.functions() & PEC != 0);
        let read = Message::read(address, 1 + BLOCK + pec);
        let mut messages = [Message::write(address, vec![self.command]), read];
        adapter.transfer(&mut messages)?;
        let [_, answer] = &mut messages;
        let length @ 1..=BLOCK = usize::from(answer.data[0]) else { return Err(Errno::PROTO) };
        answer.data.truncate(1 + length + pec);
        let read = answer.data[..=length].to_vec();
        if pec == 1 && messages.iter().fold(0, code) != 0 {
            return Err(Errno::BADMSG);
        }
        self.data[..=length].copy_from_slice(&read);
        Ok(Some(self.data))
    }

    /// Its only data is the direction.
    fn quick(&self, adapter: &Adapter, address: u16) -> Result<Option<Vec<u8>>, Errno> {
        let message =
            if self.is_read { Message::read(address, 0) } else { Message::write(address, Vec::new()) };
        adapter.transfer(&mut [message]).map(|()| None)
    }
}

/// Converts between a little-endian and a native word.
fn swapped(word: &[u8]) -> Vec<u8> {
    let word: [u8; 2] = word.try_into().unwrap_or_default();
    u16::from_le_bytes(word).to_ne_bytes().to_vec()
}

/// Continues a packet error code over a message: a CRC-8 with the polynomial x^8 + x^2 + x + 1 over address and data.
/// It is 0 over a message that ends with its code.
fn code(code: u8, message: &Message) -> u8 {
    let address = (message.address as u8) << 1 | u8::from(message.is_read());
    std::iter::once(&address).chain(&message.data).fold(code, |code, byte| {
        (0..8).fold(code ^ byte, |code, _| if code & 0x80 == 0 { code << 1 } else { code << 1 ^ 0x07 })
    })
}
