// SPDX-License-Identifier: MIT

//! Requests of FUSE and CUSE for a file that is a bus.
//!
//! The input is a number of requests, each behind two bytes with its length: as the kernel would send them for one open file,
//! whose memory it brings. An answer that asks for more asks for what the kernel takes, and no request is asked for more forever.

use i2c_server::fuse::{
    Call, HEAD, IOCTL_DATA, Job, WRITE_IN, message, opened, parse, plain, u32_at, u64_at,
};
use i2c_server::{Adapter, Client, MAX_LENGTH};

use crate::ioctl::Echo;

/// FUSE_IOCTL_MAX_IOV: most places that the kernel takes.
const MOST: u32 = 256;
/// FUSE_IOCTL_RETRY.
const RETRY: u32 = 1 << 2;

pub(crate) fn run(mut input: &[u8]) {
    let adapter = Adapter::new().with(0x55, Echo::default());
    let mut client = Client::default();
    while let Some((length, rest)) = input.split_first_chunk::<2>() {
        let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        let (request, rest) = rest.split_at(length);
        input = rest;
        let (unique, call) = parse(request);
        let body = match call {
            Call::Nothing | Call::Close(_) => continue,
            Call::Open => Ok(opened(1)),
            Call::Other(code) => plain(code, (0, 0)),
            Call::Job(_, job) => answer(&mut client, &adapter, job),
        };
        let answer = message(unique, body);
        assert_eq!((u32_at(&answer, 0) as usize, u64_at(&answer, 8)), (answer.len(), unique));
        assert!(u32_at(&answer, 4) as i32 <= 0, "an error is negative");
        assert!(answer.len() < HEAD + WRITE_IN + IOCTL_DATA + 42 * MAX_LENGTH);
    }
}

/// What comes of a job, when the kernel has brought what it was asked for: zeros.
fn answer(client: &mut Client, adapter: &Adapter, mut job: Job) -> Result<Vec<u8>, i2c_server::Errno> {
    for _ in 0..5 {
        let body = job.clone().run(client, adapter, None)?;
        let Job::Ioctl { came, room, .. } = &mut job else { return Ok(body) };
        if u32_at(&body, 4) & RETRY == 0 {
            assert!(body.len() - 16 <= *room, "more than there is room for");
            return Ok(body);
        }
        let (ins, outs) = (u32_at(&body, 8), u32_at(&body, 12));
        assert!(ins <= MOST && outs <= MOST && body.len() == 16 + 16 * (ins + outs) as usize);
        let lengths: Vec<usize> =
            body[16..].chunks_exact(16).map(|place| u64_at(place, 8) as usize).collect();
        let (needed, answers) = lengths.split_at(ins as usize);
        assert!(lengths.iter().all(|&length| length <= MAX_LENGTH));
        came.resize(needed.iter().sum(), 0);
        *room = answers.iter().sum();
    }
    panic!("it asks again and again");
}
