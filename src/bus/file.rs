// SPDX-License-Identifier: MIT

//! A FUSE file, or a device of CUSE, that is an I2C bus: the kernel's requests, and who answers them.
//!
//! The crate `fuser` passes on the number of an ioctl but not its argument, so requests are read and answered here. Each
//! open file has a thread of its own: reading the memory of a program may take as long as that program wants, and only its
//! own calls wait for it.

use std::collections::HashMap;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;

use i2c_server::{Adapter, Client, Errno, Request, Width};
use nix::unistd::{Pid, getegid, geteuid, read, write};

use super::asked::{Asked, retry};
use super::caller::Caller;
use crate::error::{Error, Result};
use crate::fuse::single::MAX_WRITE;

// Numbers and layouts of `linux/fuse.h`.
const FORGET: u32 = 2;
const GETATTR: u32 = 3;
const SETATTR: u32 = 4;
const OPEN: u32 = 14;
const READ: u32 = 15;
const WRITE: u32 = 16;
const STATFS: u32 = 17;
const RELEASE: u32 = 18;
const FSYNC: u32 = 20;
const FLUSH: u32 = 25;
const ACCESS: u32 = 34;
const INTERRUPT: u32 = 36;
const IOCTL: u32 = 39;
const BATCH_FORGET: u32 = 42;
/// Length of `fuse_in_header`.
pub(super) const HEAD: usize = 40;
/// Length of `fuse_write_in`.
const WRITE_IN: usize = 40;
/// Length of `fuse_ioctl_in`.
const IOCTL_IN: usize = 32;
/// What the kernel passes on with an ioctl, at most: the 32 pages of a request.
const IOCTL_DATA: usize = 32 * 4096;
/// FOPEN_DIRECT_IO and FOPEN_NONSEEKABLE.
const OPEN_FLAGS: u32 = 1 | 4;
/// FUSE_IOCTL_32BIT.
const IOCTL_32BIT: u32 = 1 << 3;

/// Most open files at a time. A program that opens more gets ENFILE.
const MAX_OPEN: usize = 256;

/// How the memory of a caller is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// As that of another process.
    Direct,
    /// By the kernel, which is asked for it.
    Asked,
}

/// What a client's thread has to do. A request has a number, with which it is answered.
enum Job {
    Ioctl { unique: u64, caller: Pid, width: Width, command: u32, argument: u64, came: Vec<u8>, room: usize },
    Read { unique: u64, count: usize },
    Write { unique: u64, data: Vec<u8> },
}

/// A field of a request. What the kernel has not sent reads as 0.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |field| u32::from_ne_bytes(*field))
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |field| u64::from_ne_bytes(*field))
}

/// The kernel's end of the mount.
#[derive(Clone)]
struct Device(Arc<OwnedFd>);

impl Device {
    fn answer(&self, unique: u64, outcome: Result<Vec<u8>, Errno>) {
        // The caller was killed, or the file is unmounted: nobody waits for the answer.
        let _ = write(&self.0, &message(unique, outcome));
    }
}

/// An answer as the kernel takes it.
pub(super) fn message(unique: u64, outcome: Result<Vec<u8>, Errno>) -> Vec<u8> {
    let (error, body) = match outcome {
        Ok(body) => (0, body),
        Err(errno) => (-errno.raw_os_error(), Vec::new()),
    };
    let mut message = ((16 + body.len()) as u32).to_ne_bytes().to_vec();
    message.extend(error.to_ne_bytes());
    message.extend(unique.to_ne_bytes());
    message.extend(body);
    message
}

/// Answers the requests until the file is unmounted.
pub(super) fn serve(device: OwnedFd, adapter: &Arc<Adapter>, access: Access) -> Result<()> {
    let device = Device(Arc::new(device));
    let mut clients: HashMap<u64, Sender<Job>> = HashMap::new();
    let mut next = 0;
    let mut buffer = vec![0; HEAD + WRITE_IN + IOCTL_DATA.max(MAX_WRITE as usize)];
    loop {
        let length = match read(&device.0, &mut buffer) {
            // Not from the kernel.
            Ok(0) => return Ok(()),
            Ok(length) => length,
            // A signal, or a request that its caller has taken back.
            Err(nix::errno::Errno::EINTR | nix::errno::Errno::ENOENT | nix::errno::Errno::EAGAIN) => continue,
            // The second where the kernel has ended the connection, as at the end of a mount namespace.
            Err(nix::errno::Errno::ENODEV | nix::errno::Errno::ECONNABORTED) => return Ok(()),
            Err(errno) => return Err(Error::io("/dev/fuse", "cannot read a request", &errno.into())),
        };
        let request = &buffer[..length];
        let (code, unique, body) =
            (u32_at(request, 4), u64_at(request, 8), request.get(HEAD..).unwrap_or_default());
        let (handle, count) = (u64_at(body, 0), u32_at(body, 16) as usize);
        let job = match code {
            FORGET | BATCH_FORGET | INTERRUPT => continue,
            OPEN => {
                next += 1;
                let opened = open(&device, adapter, &mut clients, next, access);
                device.answer(unique, opened);
                continue;
            }
            RELEASE => {
                clients.remove(&handle);
                device.answer(unique, Ok(Vec::new()));
                continue;
            }
            IOCTL => Job::Ioctl {
                unique,
                caller: Pid::from_raw(u32_at(request, 32) as i32),
                width: match u32_at(body, 8) & IOCTL_32BIT {
                    0 => Width::Bits64,
                    _ => Width::Bits32,
                },
                command: u32_at(body, 12),
                argument: u64_at(body, 16),
                came: match access {
                    Access::Direct => Vec::new(),
                    Access::Asked => body.get(IOCTL_IN..).unwrap_or_default().to_vec(),
                },
                room: u32_at(body, 28) as usize,
            },
            READ => Job::Read { unique, count },
            WRITE => {
                let data = body.get(WRITE_IN..).unwrap_or_default();
                Job::Write { unique, data: data[..count.min(data.len())].to_vec() }
            }
            _ => {
                device.answer(unique, plain(code));
                continue;
            }
        };
        let sent = clients.get(&handle).is_some_and(|client| client.send(job).is_ok());
        if !sent {
            device.answer(unique, Err(Errno::BADF));
        }
    }
}

/// Answers a request that has nothing to do with the bus.
fn plain(code: u32) -> Result<Vec<u8>, Errno> {
    match code {
        GETATTR | SETATTR => {
            // How long it holds, then inode, size, blocks and times with their nanoseconds.
            let mut attributes = vec![0; 16 + 60];
            attributes[16..24].copy_from_slice(&1_u64.to_ne_bytes());
            let fields = [0o100_600, 1, geteuid().as_raw(), getegid().as_raw(), 0, 4096, 0];
            attributes.extend(fields.iter().flat_map(|field: &u32| field.to_ne_bytes()));
            Ok(attributes)
        }
        STATFS => {
            let mut status = vec![0; 80];
            status[40..44].copy_from_slice(&4096_u32.to_ne_bytes());
            status[48..52].copy_from_slice(&4096_u32.to_ne_bytes());
            Ok(status)
        }
        FLUSH | FSYNC | ACCESS => Ok(Vec::new()),
        _ => Err(Errno::NOSYS),
    }
}

fn open(
    device: &Device,
    adapter: &Arc<Adapter>,
    clients: &mut HashMap<u64, Sender<Job>>,
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
    Ok([&handle.to_ne_bytes()[..], &OPEN_FLAGS.to_ne_bytes(), &[0; 4]].concat())
}

/// Answers one open file until it is closed.
fn attend(device: &Device, adapter: &Adapter, jobs: &Receiver<Job>, access: Access) {
    let mut client = Client::default();
    for job in jobs {
        match job {
            Job::Ioctl { unique, caller, width, command, argument, came, room } => {
                let result = match access {
                    Access::Direct => client
                        .ioctl(adapter, command, argument, width, &mut Caller(caller))
                        .map(|result| done(result, &[])),
                    Access::Asked => {
                        let mut memory = Asked::new(&came);
                        let request = Request::decode(command, argument, width, &mut memory);
                        asked(&mut client, adapter, request, &memory, room)
                    }
                };
                device.answer(unique, result);
            }
            Job::Read { unique, count } => device.answer(unique, client.read(adapter, count)),
            Job::Write { unique, data } => {
                let written = client.write(adapter, &data);
                device.answer(unique, written.map(|count| [(count as u32).to_ne_bytes(), [0; 4]].concat()));
            }
        }
    }
}

/// The body of an answer to an ioctl: `fuse_ioctl_out`, and what goes into the caller's memory.
fn done(result: i32, data: &[u8]) -> Vec<u8> {
    [&result.to_ne_bytes()[..], &[0; 12], data].concat()
}

/// Answers an ioctl whose memory the kernel brings. Nothing is sent before all of it is there, and room for the answer.
fn asked(
    client: &mut Client,
    adapter: &Adapter,
    request: Result<Request, Errno>,
    memory: &Asked<'_>,
    room: usize,
) -> Result<Vec<u8>, Errno> {
    if memory.lacks {
        return Ok(retry(&memory.needed, &[]));
    }
    let request = request?;
    let answers = request.answers();
    if room < answers.iter().map(|(_, length)| length).sum() {
        return Ok(retry(&memory.needed, &answers));
    }
    let outcome = client.run(adapter, request)?;
    let data: Vec<u8> = outcome.writes.into_iter().flat_map(|(_, bytes)| bytes).collect();
    Ok(done(outcome.result, &data))
}
