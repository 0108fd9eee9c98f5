// SPDX-License-Identifier: MIT

//! A mount that is one file, whose requests the caller answers itself.
//!
//! The crate `fuser` mounts it and agrees with the kernel on the protocol. It does not answer the requests: of an ioctl it
//! passes on the number, but not the argument.

use std::io;
use std::mem;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;

use fuser::{Config, Filesystem, KernelConfig, Request};

use super::needs;
use crate::error::{Error, Result};

/// Most bytes of a write that the kernel passes on at once.
pub const MAX_WRITE: u32 = 64 * 1024;

struct Single;

impl Filesystem for Single {
    fn init(&mut self, _request: &Request, config: &mut KernelConfig) -> io::Result<()> {
        config.set_max_write(MAX_WRITE).map(drop).map_err(|_| io::ErrorKind::InvalidInput.into())
    }
}

/// Mounts at an existing regular file. The kernel's end of it is where the requests are read and answered; the mount is
/// over when it has been unmounted.
pub fn mount(path: &Path, source: &str) -> Result<OwnedFd> {
    let session = needs::session(Single, path, (source, "i2c"), Config::default())?;
    let device = session.as_fd().try_clone_to_owned();
    // Dropping it would unmount the path, and so whatever has been mounted there since.
    mem::forget(session);
    device.map_err(|error| Error::io("/dev/fuse", "cannot be used twice", &error))
}
