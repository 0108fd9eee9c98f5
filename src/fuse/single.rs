// SPDX-License-Identifier: MIT

//! A mount of one file whose requests the caller answers itself.
//!
//! The crate `fuser` mounts it and agrees with the kernel on the protocol. It does not answer the requests: it passes
//! on an ioctl's number, but not its argument.

use std::io;
use std::mem;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;

use fuser::{Config, Filesystem, KernelConfig, Request};

use super::needs;
use crate::error::{Error, Result};

/// Largest write, in bytes.
pub const MAX_WRITE: u32 = 64 * 1024;

struct Single;

impl Filesystem for Single {
    fn init(&mut self, _request: &Request, config: &mut KernelConfig) -> io::Result<()> {
        config.set_max_write(MAX_WRITE).map(drop).map_err(|_| io::ErrorKind::InvalidInput.into())
    }
}

/// Mounts on an existing regular file. Requests are read and answered at the returned kernel's end; the mount is over
/// when it is unmounted.
pub fn mount(path: &Path, source: &str) -> Result<OwnedFd> {
    let session = needs::session(Single, path, (source, "i2c"), Config::default())?;
    let device = session.as_fd().try_clone_to_owned();
    // Dropping it would unmount the path, and so remove a newer mount.
    mem::forget(session);
    device.map_err(|error| Error::io("/dev/fuse", "cannot be used twice", &error))
}
