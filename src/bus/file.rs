// SPDX-License-Identifier: MIT

//! A FUSE file or CUSE device that is an I2C bus: the kernel's requests and their answers.
//!
//! The crate `fuser` passes on an ioctl's number but not its argument, so requests are read and answered here. Each
//! open file has its own thread: reading a program's memory may take as long as that program wants, and only its own
//! calls wait for it.

use std::collections::HashMap;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;

use i2c_server::fuse::{self, Call, HEAD, IOCTL_DATA, Job, WRITE_IN, message};
use i2c_server::{Adapter, Client, Errno, Memory};
use nix::unistd::{Pid, getegid, geteuid, read, write};

use super::caller::Caller;
use crate::error::{Error, Result};
use crate::fuse::single::MAX_WRITE;

/// Most open files at a time; further programs get ENFILE.
const MAX_OPEN: usize = 256;

/// Access to the memory of a caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// As another process's memory.
    Direct,
    /// Through the kernel.
    Asked,
}

#[derive(Clone)]
struct Device(Arc<OwnedFd>);

impl Device {
    fn answer(&self, unique: u64, outcome: Result<Vec<u8>, Errno>) {
        // The caller was killed, or the file is unmounted: nobody waits for the answer.
        let _ = write(&self.0, &message(unique, outcome));
    }
}

/// Answers the requests until the file is unmounted.
pub(super) fn serve(device: OwnedFd, adapter: &Arc<Adapter>, access: Access) -> Result<()> {
    let device = Device(Arc::new(device));
    let mut clients: HashMap<u64, Sender<(u64, Job)>> = HashMap::new();
    let mut next = 0;
    let mut buffer = vec![0; HEAD + WRITE_IN + IOCTL_DATA.max(MAX_WRITE as usize)];
    loop {
        let length = match read(&device.0, &mut buffer) {
            // Not from the kernel.
            Ok(0) => return Ok(()),
            Ok(length) => length,
            // A signal, or a request that its caller has withdrawn.
            Err(nix::errno::Errno::EINTR | nix::errno::Errno::ENOENT | nix::errno::Errno::EAGAIN) => continue,
            // ECONNABORTED if the kernel ended the connection, as at the end of a mount namespace.
            Err(nix::errno::Errno::ENODEV | nix::errno::Errno::ECONNABORTED) => return Ok(()),
            Err(errno) => return Err(Error::io("/dev/fuse", "cannot read a request", &errno.into())),
        };
        let (unique, call) = fuse::parse(&buffer[..length]);
        let owner = || (geteuid().as_raw(), getegid().as_raw());
        let answer = match call {
            Call::Nothing => continue,
            Call::Open => {
                next += 1;
                open(&device, adapter, &mut clients, next, access)
            }
            Call::Close(handle) => {
                clients.remove(&handle);
                Ok(Vec::new())
            }
            Call::Job(handle, job) => {
                if clients.get(&handle).is_some_and(|client| client.send((unique, job)).is_ok()) {
                    continue;
                }
                Err(Errno::BADF)
            }
            Call::Other(code) => fuse::plain(code, owner()),
        };
        device.answer(unique, answer);
    }
}

fn open(
    device: &Device,
    adapter: &Arc<Adapter>,
    clients: &mut HashMap<u64, Sender<(u64, Job)>>,
    handle: u64,
    access: Access,
) -> Result<Vec<u8>, Errno> {
    if clients.len() >= MAX_OPEN {
        return Err(Errno::NFILE);
    }
    let (sender, jobs) = mpsc::channel();
    let (device, adapter) = (device.clone(), adapter.clone());
    let thread = thread::Builder::new().name("client".into()).stack_size(256 * 1024);
    thread.spawn(move || attend(&device, &adapter, &jobs, access)).map_err(|_| Errno::AGAIN)?;
    clients.insert(handle, sender);
    Ok(fuse::opened(handle))
}

/// Answers an open file until it is closed. Each job has the number for its answer.
fn attend(device: &Device, adapter: &Adapter, jobs: &Receiver<(u64, Job)>, access: Access) {
    let mut client = Client::default();
    for (unique, job) in jobs {
        let mut memory = match (access, &job) {
            (Access::Direct, Job::Ioctl { caller, .. }) => Some(Caller(Pid::from_raw(*caller as i32))),
            _ => None,
        };
        let memory = memory.as_mut().map(|memory| memory as &mut dyn Memory);
        device.answer(unique, job.run(&mut client, adapter, memory));
    }
}
