// SPDX-License-Identifier: MIT

//! The interface of `/dev/i2c-N`, as the kernel's `i2c-dev` has it, served from user space.
//!
//! A program that opens `/dev/i2c-N` speaks to the kernel with ioctl(2), read(2) and write(2). This crate answers these
//! calls in the kernel's place, for [targets](Target) that are simulated: I2C_RDWR with up to 42 messages of up to 8192
//! bytes, I2C_SMBUS, I2C_FUNCS, I2C_SLAVE, I2C_SLAVE_FORCE, I2C_TENBIT, I2C_PEC, I2C_RETRIES, I2C_TIMEOUT, and plain
//! reads and writes, for callers of 64 and of 32 bits, with the kernel's limits and error numbers.
//!
//! [`usb`] answers the kernel instead, which makes an adapter of it to which its own drivers bind.
//!
//! It opens no device. Its caller, such as a FUSE file ([`fuse`] reads its requests), passes the arguments of each call to
//! the open file's [`Client`], and access to the calling process's memory as a [`Memory`]. All clients share one
//! [`Adapter`]. No client can disturb the others: an argument is read as a whole before anything is sent, and the bus is
//! held for no longer than the transfer takes.
//!
//! ```
//! use i2c_server::{Adapter, Client, Errno, Memory, Target, Width, command};
//!
//! /// A target that answers every read with its register pointer.
//! struct Echo(u8);
//!
//! impl Target for Echo {
//!     fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
//!         self.0 = *write.first().unwrap_or(&self.0);
//!         read.fill(self.0);
//!         Ok(())
//!     }
//! }
//!
//! /// The memory of the caller: here an array that begins at address 0x1000.
//! struct Caller([u8; 64]);
//!
//! impl Memory for Caller {
//!     fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno> {
//!         let start = at.checked_sub(0x1000).ok_or(Errno::FAULT)? as usize;
//!         let from = self.0.get(start..).and_then(|rest| rest.get(..to.len()));
//!         to.copy_from_slice(from.ok_or(Errno::FAULT)?);
//!         Ok(())
//!     }
//!
//!     fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno> {
//!         let start = at.checked_sub(0x1000).ok_or(Errno::FAULT)? as usize;
//!         let to = self.0.get_mut(start..).and_then(|rest| rest.get_mut(..from.len()));
//!         to.ok_or(Errno::FAULT)?.copy_from_slice(from);
//!         Ok(())
//!     }
//! }
//!
//! let adapter = Adapter::new().with(0x55, Echo(0));
//! let mut client = Client::default();
//! let mut memory = Caller([0; 64]);
//!
//! // As a program does it: ioctl(fd, I2C_SLAVE, 0x55), write(fd, "\x08", 1), read(fd, word, 2).
//! client.ioctl(&adapter, command::I2C_SLAVE, 0x55, Width::Bits64, &mut memory)?;
//! client.write(&adapter, &[0x08])?;
//! assert_eq!(client.read(&adapter, 2)?, [0x08, 0x08]);
//!
//! // ioctl(fd, I2C_FUNCS, 0x1000) puts an unsigned long there.
//! client.ioctl(&adapter, command::I2C_FUNCS, 0x1000, Width::Bits64, &mut memory)?;
//! assert_eq!(u64::from_ne_bytes(memory.0[..8].try_into().unwrap()), i2c_server::FUNCTIONS);
//!
//! // Nothing answers at another address.
//! client.ioctl(&adapter, command::I2C_SLAVE, 0x56, Width::Bits64, &mut memory)?;
//! assert_eq!(client.read(&adapter, 2), Err(Errno::NXIO));
//! # Ok::<(), Errno>(())
//! ```
//!
//! # What differs from an adapter of the kernel
//!
//! Messages are sent as pairs where a read follows a write to the same address, and singly otherwise; between two pairs a
//! target cannot tell a repeated START from STOP and START. What [`FUNCTIONS`] leaves out is refused with EOPNOTSUPP:
//! block reads whose length the target decides, addresses of 10 bits, and flags of a message other than I2C_M_RD. A block
//! write without a byte is EINVAL. I2C_RETRIES and I2C_TIMEOUT are accepted and change nothing.

mod adapter;
mod client;
mod functions;
pub mod fuse;
mod message;
mod request;
mod smbus;
pub mod usb;

pub use adapter::{Adapter, Manner, Target};
pub use client::{Client, Outcome};
pub use functions::FUNCTIONS;
pub use message::{MAX_LENGTH, Memory, Message};
pub use request::{MAX_MESSAGES, Request, Width, command};
pub use rustix::io::Errno;
pub use smbus::Transaction;
