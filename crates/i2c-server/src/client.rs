// SPDX-License-Identifier: MIT

//! An open file of the device.

use rustix::io::Errno;

use crate::adapter::Adapter;
use crate::functions::I2C;
use crate::message::{MAX_LENGTH, Memory, Message};
use crate::request::{Request, Width};

/// An open file: the address and modes that its user has set.
#[derive(Clone, Debug, Default)]
pub struct Client {
    address: u16,
    ten_bit: bool,
    pec: bool,
}

/// A call's result, and what goes into the caller's memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// What ioctl(2) returns.
    pub result: i32,
    /// Addresses of the caller, and the bytes for each.
    pub writes: Vec<(u64, Vec<u8>)>,
}

impl Client {
    /// Answers an ioctl, reading and writing the caller's memory.
    pub fn ioctl(
        &mut self,
        adapter: &Adapter,
        command: u32,
        argument: u64,
        width: Width,
        memory: &mut dyn Memory,
    ) -> Result<i32, Errno> {
        let outcome = self.run(adapter, Request::decode(command, argument, width, memory)?)?;
        outcome.writes.iter().try_for_each(|(at, bytes)| memory.write(*at, bytes))?;
        Ok(outcome.result)
    }

    /// Carries out a decoded ioctl without the caller's memory.
    pub fn run(&mut self, adapter: &Adapter, request: Request) -> Result<Outcome, Errno> {
        let put = |at: u64, bytes: Vec<u8>| Outcome { result: 0, writes: vec![(at, bytes)] };
        match request {
            Request::Address(address) => {
                let most = if self.ten_bit { 0x3ff } else { 0x7f };
                self.address =
                    u16::try_from(address).ok().filter(|address| *address <= most).ok_or(Errno::INVAL)?;
            }
            Request::TenBit(on) => self.ten_bit = on,
            Request::Pec(on) => self.pec = on,
            Request::Accepted => {}
            Request::Functions(at, Width::Bits64) => {
                return Ok(put(at, adapter.functions().to_ne_bytes().into()));
            }
            Request::Functions(at, Width::Bits32) => {
                return Ok(put(at, (adapter.functions() as u32).to_ne_bytes().into()));
            }
            Request::Messages(mut messages) => {
                plain(adapter, &mut messages)?;
                let result = messages.len() as i32;
                let read =
                    messages.into_iter().filter(|message| message.is_read() && !message.data.is_empty());
                let writes = read.map(|message| (message.destination, message.data)).collect();
                return Ok(Outcome { result, writes });
            }
            Request::Smbus(transaction, data) => {
                let read = transaction.run(adapter, self.target()?, self.pec)?;
                return Ok(read.map_or_else(Outcome::default, |bytes| put(data, bytes)));
            }
        }
        Ok(Outcome::default())
    }

    /// Answers read(2).
    pub fn read(&self, adapter: &Adapter, count: usize) -> Result<Vec<u8>, Errno> {
        let mut messages = [Message::read(self.target()?, count.min(MAX_LENGTH))];
        plain(adapter, &mut messages)?;
        let [message] = messages;
        Ok(message.data)
    }

    /// Answers write(2): how many bytes were written.
    pub fn write(&self, adapter: &Adapter, data: &[u8]) -> Result<usize, Errno> {
        let data = &data[..data.len().min(MAX_LENGTH)];
        plain(adapter, &mut [Message::write(self.target()?, data.to_vec())])?;
        Ok(data.len())
    }

    fn target(&self) -> Result<u16, Errno> {
        if self.ten_bit { Err(Errno::OPNOTSUPP) } else { Ok(self.address) }
    }
}

/// Sends messages that are no transaction of SMBus.
fn plain(adapter: &Adapter, messages: &mut [Message]) -> Result<(), Errno> {
    if adapter.functions() & I2C == 0 {
        return Err(Errno::OPNOTSUPP);
    }
    adapter.transfer(messages)
}
