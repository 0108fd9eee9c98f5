// SPDX-License-Identifier: MIT

//! The memory of a caller that the kernel brings: what an ioctl points to is named in an answer, and comes with the request when
//! that is repeated (FUSE_IOCTL_RETRY of `linux/fuse.h`).

use i2c_server::{Errno, Memory};

/// The memory of the caller as far as it came with the request.
pub(super) struct Asked<'a> {
    came: &'a [u8],
    at: usize,
    /// All that is needed of it so far: addresses and lengths.
    pub(super) needed: Vec<(u64, usize)>,
    /// Something of that has not come.
    pub(super) lacks: bool,
}

impl<'a> Asked<'a> {
    pub(super) fn new(came: &'a [u8]) -> Self {
        Self { came, at: 0, needed: Vec::new(), lacks: false }
    }
}

impl Memory for Asked<'_> {
    /// What has not come reads as zeros, so that as much as can be known by now is asked for at once.
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno> {
        self.needed.push((at, to.len()));
        match self.came.get(self.at..self.at + to.len()) {
            Some(bytes) if !self.lacks => {
                to.copy_from_slice(bytes);
                self.at += to.len();
            }
            _ => {
                self.lacks = true;
                to.fill(0);
            }
        }
        Ok(())
    }

    /// What is written goes with the answer.
    fn write(&mut self, _: u64, _: &[u8]) -> Result<(), Errno> {
        Err(Errno::FAULT)
    }
}

/// The body of an answer that asks for the caller's memory: `fuse_ioctl_out` with FUSE_IOCTL_RETRY, and what is to come
/// with the request and to go with its answer.
pub(super) fn retry(needed: &[(u64, usize)], answers: &[(u64, usize)]) -> Vec<u8> {
    const RETRY: u32 = 1 << 2;
    let head = [0, RETRY, needed.len() as u32, answers.len() as u32];
    let places = needed.iter().chain(answers).flat_map(|&(at, length)| [at, length as u64]);
    head.iter().flat_map(|field| field.to_ne_bytes()).chain(places.flat_map(u64::to_ne_bytes)).collect()
}
