// SPDX-License-Identifier: MIT

//! Adapters to and from `embedded-hal`: any blocking [`I2c`] as a [`Bus`], and any [`Bus`] as an [`I2c`].
//!
//! Published driver crates run against a simulated gauge, a recording, or a Linux adapter, as an [`I2c`].

use embedded_hal::i2c::{Error as _, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

use crate::{Bus, BusError};

/// A [`Bus`] to one address of an `embedded-hal` I2C.
#[derive(Debug)]
pub struct FromHal<I> {
    i2c: I,
    address: u8,
}

impl<I> FromHal<I> {
    /// The target at a 7-bit address of `i2c`.
    pub fn new(i2c: I, address: u8) -> Self {
        Self { i2c, address }
    }

    /// Returns the I2C.
    pub fn into_inner(self) -> I {
        self.i2c
    }
}

impl<I: I2c + Send> Bus for FromHal<I> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let done = if read.is_empty() {
            self.i2c.write(self.address, write)
        } else if write.is_empty() {
            self.i2c.read(self.address, read)
        } else {
            self.i2c.write_read(self.address, write, read)
        };
        done.map_err(|error| match error.kind() {
            ErrorKind::NoAcknowledge(_) => BusError::NoAck,
            ErrorKind::ArbitrationLoss => BusError::ArbitrationLost,
            ErrorKind::Overrun => BusError::Short,
            // A stuck bus, or any failure for which `embedded-hal` has no kind of its own.
            _ => BusError::Timeout,
        })
    }
}

/// An `embedded-hal` I2C on which only the address of a [`Bus`] answers.
#[derive(Debug)]
pub struct AsHal<B> {
    bus: B,
    address: u8,
}

impl<B> AsHal<B> {
    /// An I2C with the target of `bus` at a 7-bit address, and nothing else.
    pub fn new(bus: B, address: u8) -> Self {
        Self { bus, address }
    }

    /// Returns the bus.
    pub fn into_inner(self) -> B {
        self.bus
    }
}

impl embedded_hal::i2c::Error for BusError {
    fn kind(&self) -> ErrorKind {
        match self {
            BusError::NoAck => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            BusError::ArbitrationLost => ErrorKind::ArbitrationLoss,
            BusError::Short => ErrorKind::Overrun,
            BusError::Timeout => ErrorKind::Bus,
            BusError::Gone
            | BusError::Busy
            | BusError::HasMux
            | BusError::ReadOnly
            | BusError::WriteDisabled
            | BusError::NotRecorded
            | BusError::MaybeNoAck(_)
            | BusError::Hung(_)
            | BusError::TooSlow { .. }
            | BusError::TooLong { .. }
            | BusError::Unsteady
            | BusError::Pec
            | BusError::Other(_) => ErrorKind::Other,
        }
    }
}

impl<B> ErrorType for AsHal<B> {
    type Error = BusError;
}

impl<B: Bus> I2c for AsHal<B> {
    /// Each write and read becomes one transfer. Consecutive ones are merged, as `embedded-hal` requires.
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        if address != self.address {
            return Err(BusError::NoAck);
        }
        let mut rest = operations;
        loop {
            let writes = rest.iter().take_while(|one| matches!(one, Operation::Write(_))).count();
            let reads = rest[writes..].iter().take_while(|one| matches!(one, Operation::Read(_))).count();
            let (transfer, later) = rest.split_at_mut(writes + reads);
            self.transfer(transfer)?;
            if later.is_empty() {
                return Ok(());
            }
            rest = later;
        }
    }
}

impl<B: Bus> AsHal<B> {
    fn transfer(&mut self, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        let (mut write, mut length) = (Vec::new(), 0);
        for operation in operations.iter() {
            match operation {
                Operation::Write(bytes) => write.extend_from_slice(bytes),
                Operation::Read(bytes) => length += bytes.len(),
            }
        }
        let mut read = vec![0; length];
        self.bus.transfer(&write, &mut read)?;
        let mut rest = &read[..];
        for operation in operations {
            if let Operation::Read(bytes) = operation {
                let (own, later) = rest.split_at(bytes.len());
                bytes.copy_from_slice(own);
                rest = later;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A target with a register pointer and 256 bytes, which records each transfer.
    #[derive(Debug, Default)]
    struct Memory {
        pointer: u8,
        transfers: Vec<(Vec<u8>, usize)>,
    }

    impl Bus for Memory {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            self.transfers.push((write.to_vec(), read.len()));
            if let Some(&pointer) = write.first() {
                self.pointer = pointer;
            }
            for byte in read {
                *byte = self.pointer;
                self.pointer = self.pointer.wrapping_add(1);
            }
            Ok(())
        }
    }

    #[test]
    fn a_bus_is_an_i2c() {
        let mut i2c = AsHal::new(Memory::default(), 0x55);
        let mut word = [0; 2];
        i2c.write_read(0x55, &[0x08], &mut word).expect("the target answers");
        assert_eq!(word, [8, 9]);
        i2c.write(0x55, &[0x3e, 1, 2]).expect("the target answers");
        i2c.read(0x55, &mut word).expect("the target answers");
        assert_eq!(i2c.write(0x50, &[0]), Err(BusError::NoAck));
        let mut later = [0; 1];
        i2c.transaction(
            0x55,
            &mut [
                Operation::Write(&[1]),
                Operation::Write(&[2]),
                Operation::Read(&mut word),
                Operation::Write(&[9]),
                Operation::Read(&mut later),
            ],
        )
        .expect("the target answers");
        assert_eq!((word, later), ([1, 2], [9]));
        let transfers = i2c.into_inner().transfers;
        let lengths: Vec<_> = transfers.iter().map(|(write, read)| (write.len(), *read)).collect();
        assert_eq!(lengths, [(1, 2), (3, 0), (0, 2), (2, 2), (1, 1)]);
    }

    #[test]
    fn an_i2c_is_a_bus() {
        let mut bus = FromHal::new(AsHal::new(Memory::default(), 0x55), 0x55);
        let mut word = [0; 2];
        bus.transfer(&[0x20], &mut word).expect("the target answers");
        assert_eq!(word, [0x20, 0x21]);
        bus.transfer(&[0x3e, 1], &mut []).expect("the target answers");
        bus.transfer(&[], &mut word).expect("the target answers");
        assert_eq!(bus.into_inner().into_inner().transfers.len(), 3);
        let mut elsewhere = FromHal::new(AsHal::new(Memory::default(), 0x55), 0x0b);
        assert_eq!(elsewhere.transfer(&[0], &mut word), Err(BusError::NoAck));
    }
}
