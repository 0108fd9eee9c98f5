// SPDX-License-Identifier: MIT

//! FUSE and CUSE requests for a file that is a bus (`linux/fuse.h`).
//!
//! An ioctl's argument is an address. If that memory is not readable, an answer names it, and the kernel repeats the
//! request with it (FUSE_IOCTL_RETRY). Only CUSE devices may ask for that.

use rustix::io::Errno;

use crate::adapter::Adapter;
use crate::client::Client;
use crate::message::Memory;
use crate::request::{Request, Width};

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
pub const HEAD: usize = 40;
/// Length of `fuse_write_in`.
pub const WRITE_IN: usize = 40;
const IOCTL_IN: usize = 32;
/// Most data that the kernel passes with an ioctl: the 32 pages of a request.
pub const IOCTL_DATA: usize = 32 * 4096;
const OPEN_FLAGS: u32 = 1 | 4;
const IOCTL_32BIT: u32 = 1 << 3;

/// The purpose of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Call {
    /// A request without an answer.
    Nothing,
    /// Opens the file.
    Open,
    /// Closes the file with the handle given by [`opened`].
    Close(u64),
    /// A job for the open file with this handle.
    Job(u64, Job),
    /// Another request by number, for [`plain`].
    Other(u32),
}

/// A job of an open file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Job {
    /// ioctl(2).
    Ioctl {
        /// The calling process.
        caller: u32,
        /// Width of the process.
        width: Width,
        /// Number of the ioctl.
        command: u32,
        /// Argument of the ioctl.
        argument: u64,
        /// The caller's memory that the kernel sent along.
        came: Vec<u8>,
        /// How many bytes the kernel takes back.
        room: usize,
    },
    /// read(2) of so many bytes.
    Read(usize),
    /// write(2).
    Write(Vec<u8>),
}

/// A field of 32 bits; bytes that the kernel has not sent read as 0.
pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |field| u32::from_ne_bytes(*field))
}

/// A field of 64 bits; bytes that the kernel has not sent read as 0.
pub fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |field| u64::from_ne_bytes(*field))
}

/// The request's number for the answer, and its purpose.
pub fn parse(request: &[u8]) -> (u64, Call) {
    let (code, unique, body) =
        (u32_at(request, 4), u64_at(request, 8), request.get(HEAD..).unwrap_or_default());
    let (handle, count) = (u64_at(body, 0), u32_at(body, 16) as usize);
    let call = match code {
        FORGET | BATCH_FORGET | INTERRUPT => Call::Nothing,
        OPEN => Call::Open,
        RELEASE => Call::Close(handle),
        IOCTL => Call::Job(
            handle,
            Job::Ioctl {
                caller: u32_at(request, 32),
                width: match u32_at(body, 8) & IOCTL_32BIT {
                    0 => Width::Bits64,
                    _ => Width::Bits32,
                },
                command: u32_at(body, 12),
                argument: u64_at(body, 16),
                came: body.get(IOCTL_IN..).unwrap_or_default().to_vec(),
                room: u32_at(body, 28) as usize,
            },
        ),
        READ => Call::Job(handle, Job::Read(count)),
        WRITE => {
            let data = body.get(WRITE_IN..).unwrap_or_default();
            Call::Job(handle, Job::Write(data[..count.min(data.len())].to_vec()))
        }
        code => Call::Other(code),
    };
    (unique, call)
}

/// The body of an answer to [`Call::Open`], with the file's handle.
pub fn opened(handle: u64) -> Vec<u8> {
    [&handle.to_ne_bytes()[..], &OPEN_FLAGS.to_ne_bytes(), &[0; 4]].concat()
}

impl Job {
    /// Carries out a job. Without access to the caller's memory, the answer asks the kernel for it.
    pub fn run(
        self,
        client: &mut Client,
        adapter: &Adapter,
        memory: Option<&mut dyn Memory>,
    ) -> Result<Vec<u8>, Errno> {
        match (self, memory) {
            (Self::Ioctl { width, command, argument, .. }, Some(memory)) => {
                client.ioctl(adapter, command, argument, width, memory).map(|result| done(result, &[]))
            }
            (Self::Ioctl { width, command, argument, came, room, .. }, None) => {
                let mut memory = Asked::new(&came);
                let request = Request::decode(command, argument, width, &mut memory);
                asked(client, adapter, request, &memory, room)
            }
            (Self::Read(count), _) => client.read(adapter, count),
            (Self::Write(data), _) => {
                let written = client.write(adapter, &data)?;
                Ok([(written as u32).to_ne_bytes(), [0; 4]].concat())
            }
        }
    }
}

/// An answer in the kernel's format.
pub fn message(unique: u64, outcome: Result<Vec<u8>, Errno>) -> Vec<u8> {
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

/// Answers a request unrelated to the bus, for a file of this user and group.
pub fn plain(code: u32, owner: (u32, u32)) -> Result<Vec<u8>, Errno> {
    match code {
        GETATTR | SETATTR => {
            // Validity, then inode, size, blocks, and times with nanoseconds.
            let mut attributes = vec![0; 16 + 60];
            attributes[16..24].copy_from_slice(&1_u64.to_ne_bytes());
            let fields = [0o100_600, 1, owner.0, owner.1, 0, 4096, 0];
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

/// The body of an ioctl's answer: `fuse_ioctl_out`, and what goes into the caller's memory.
fn done(result: i32, data: &[u8]) -> Vec<u8> {
    [&result.to_ne_bytes()[..], &[0; 12], data].concat()
}

/// Answers an ioctl whose memory comes along. Nothing is sent before all of it, and room for the answer, is there.
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

struct Asked<'a> {
    came: &'a [u8],
    at: usize,
    needed: Vec<(u64, usize)>,
    /// Some of it has not come.
    lacks: bool,
}

impl<'a> Asked<'a> {
    fn new(came: &'a [u8]) -> Self {
        Self { came, at: 0, needed: Vec::new(), lacks: false }
    }
}

impl Memory for Asked<'_> {
    /// Missing memory reads as zeros, so that one answer can ask for all that is known to be needed.
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

/// The body of an answer with FUSE_IOCTL_RETRY: memory to come with the request, and to go with its answer.
fn retry(needed: &[(u64, usize)], answers: &[(u64, usize)]) -> Vec<u8> {
    const RETRY: u32 = 1 << 2;
    let head = [0, RETRY, needed.len() as u32, answers.len() as u32];
    let places = needed.iter().chain(answers).flat_map(|&(at, length)| [at, length as u64]);
    head.iter().flat_map(|field| field.to_ne_bytes()).chain(places.flat_map(u64::to_ne_bytes)).collect()
}
