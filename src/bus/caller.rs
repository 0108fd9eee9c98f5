// SPDX-License-Identifier: MIT

//! The memory of the process that makes a call on the bus.

use std::io::{IoSlice, IoSliceMut};

use i2c_server::{Errno, Memory};
use nix::sys::uio::{RemoteIoVec, process_vm_readv, process_vm_writev};
use nix::unistd::Pid;

/// A process by its number in a request. It waits in its call, so no other process gets the number.
pub(super) struct Caller(pub(super) Pid);

impl Caller {
    /// Judges a copy that should have moved `length` bytes.
    fn copied(&self, outcome: nix::Result<usize>, length: usize) -> Result<(), Errno> {
        match outcome {
            Ok(count) if count == length => Ok(()),
            Ok(_) => Err(Errno::FAULT),
            // A process in another PID namespace has no number here.
            Err(nix::errno::Errno::ESRCH) => Err(Errno::PERM),
            Err(errno) => Err(Errno::from_raw_os_error(errno as i32)),
        }
    }
}

fn remote(at: u64, length: usize) -> Result<[RemoteIoVec; 1], Errno> {
    Ok([RemoteIoVec { base: usize::try_from(at).map_err(|_| Errno::FAULT)?, len: length }])
}

impl Memory for Caller {
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno> {
        let (length, from) = (to.len(), remote(at, to.len())?);
        self.copied(process_vm_readv(self.0, &mut [IoSliceMut::new(to)], &from), length)
    }

    fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno> {
        let to = remote(at, from.len())?;
        self.copied(process_vm_writev(self.0, &[IoSlice::new(from)], &to), from.len())
    }
}
