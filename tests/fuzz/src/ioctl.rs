// SPDX-License-Identifier: MIT

//! ioctls of a program on a bus: their arguments, decoded and carried out.
//!
//! The first byte says how wide the caller is, the next four are the number of the ioctl and the next eight its argument.
//! The rest is the caller's memory from address 0x1000 on. Whatever it has there, nothing else is read or written, and the
//! bus answers the next caller.

use i2c_server::{Adapter, Client, Errno, MAX_LENGTH, MAX_MESSAGES, Memory, Request, Target, Width, command};

/// Where the caller's memory begins.
const BASE: u64 = 0x1000;

struct Caller(Vec<u8>);

impl Caller {
    fn range(&self, at: u64, length: usize) -> Result<std::ops::Range<usize>, Errno> {
        let start = at.checked_sub(BASE).and_then(|start| usize::try_from(start).ok()).ok_or(Errno::FAULT)?;
        let end = start.checked_add(length).filter(|end| *end <= self.0.len()).ok_or(Errno::FAULT)?;
        Ok(start..end)
    }
}

impl Memory for Caller {
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno> {
        assert!(to.len() <= MAX_LENGTH, "no argument is so long");
        to.copy_from_slice(&self.0[self.range(at, to.len())?]);
        Ok(())
    }

    fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno> {
        let range = self.range(at, from.len())?;
        self.0[range].copy_from_slice(from);
        Ok(())
    }
}

/// A target that answers with what it was written last, and whether it was reached.
#[derive(Default)]
pub(crate) struct Echo(Vec<u8>);

impl Target for Echo {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
        if !write.is_empty() {
            self.0 = write.to_vec();
        }
        for (byte, last) in read.iter_mut().zip(self.0.iter().cycle()) {
            *byte = *last;
        }
        Ok(())
    }
}

pub(crate) fn run(input: &[u8]) {
    let Some((head, rest)) = input.split_first_chunk::<13>() else { return };
    let width = if head[0] & 1 == 0 { Width::Bits64 } else { Width::Bits32 };
    let number = u32::from_le_bytes([head[1], head[2], head[3], head[4]]);
    let argument = u64::from_le_bytes(head[5..].try_into().expect("eight bytes"));
    let mut caller = Caller(rest.to_vec());
    let adapter = Adapter::new().with(0x55, Echo::default());
    let mut client = Client::default();
    let set = |client: &mut Client, number, argument| {
        client.ioctl(&adapter, number, argument, Width::Bits64, &mut Caller(Vec::new())).expect("accepted");
    };
    set(&mut client, command::I2C_SLAVE, 0x55);
    set(&mut client, command::I2C_PEC, u64::from(head[0] >> 1 & 1));
    let decoded = Request::decode(number, argument, width, &mut caller);
    assert_eq!(caller.0, rest, "decoding writes nothing");
    if let Ok(Request::Messages(messages)) = &decoded {
        assert!((1..=MAX_MESSAGES).contains(&messages.len()));
        assert!(messages.iter().all(|message| message.data.len() <= MAX_LENGTH));
    }
    let refused = decoded.err();
    let outcome = client.ioctl(&adapter, number, argument, width, &mut caller);
    if let Some(refused) = refused {
        assert_eq!((outcome, &caller.0[..]), (Err(refused), rest), "what is refused writes nothing");
    }
    assert_eq!(caller.0.len(), rest.len());
    let mut other = Client::default();
    set(&mut other, command::I2C_SLAVE, 0x55);
    assert_eq!(other.write(&adapter, &[7]), Ok(1));
    assert_eq!(other.read(&adapter, 2), Ok(vec![7, 7]));
}
