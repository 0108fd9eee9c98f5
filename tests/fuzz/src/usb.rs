// SPDX-License-Identifier: MIT

//! The kernel's side of an adapter that is plugged in: USB/IP, control transfers, and the messages of an i2c-tiny-usb.
//!
//! The input is what the kernel sends. Each whole request has one answer, of no more bytes than were asked for, and what is no
//! request ends the server, and nothing else does.

use std::io::{Cursor, ErrorKind, Read, Result, Write};

use i2c_server::{Adapter, usb};

use crate::ioctl::Echo;

/// What the kernel sends, and what it has been answered.
struct Kernel<'a> {
    sends: Cursor<&'a [u8]>,
    hears: Vec<u8>,
}

impl Read for Kernel<'_> {
    fn read(&mut self, to: &mut [u8]) -> Result<usize> {
        self.sends.read(to)
    }
}

impl Write for Kernel<'_> {
    fn write(&mut self, from: &[u8]) -> Result<usize> {
        self.hears.write(from)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

const HEAD: usize = 48;
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const PIPE: i32 = 32;

fn field(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

pub(crate) fn run(input: &[u8]) {
    let adapter = Adapter::new().with(0x55, Echo::default());
    let mut kernel = Kernel { sends: Cursor::new(input), hears: Vec::new() };
    let ended = usb::serve(&mut kernel, &adapter);
    let (mut left, mut answers) = (input, &kernel.hears[..]);
    while left.len() >= HEAD {
        let (head, rest) = left.split_at(HEAD);
        let (code, sequence, is_in, length) =
            (field(head, 0), field(head, 4), field(head, 12) == 1, field(head, 24) as usize);
        let sent = if code == SUBMIT && !is_in { length } else { 0 };
        if ![SUBMIT, UNLINK].contains(&code) || (code == SUBMIT && length > 0xffff) {
            assert_eq!(ended.map_err(|error| error.kind()), Err(ErrorKind::InvalidData));
            assert!(answers.is_empty(), "an answer too many");
            return;
        }
        if rest.len() < sent {
            break;
        }
        left = &rest[sent..];
        let (answer, more) = answers.split_at(HEAD);
        assert_eq!((field(answer, 0), field(answer, 4)), (code + 2, sequence));
        let (status, count) = (field(answer, 20) as i32, field(answer, 24) as usize);
        assert!(status == 0 || (status == -PIPE && count == 0), "{status}, {count} bytes");
        let data = if code == SUBMIT && is_in { count } else { 0 };
        assert!(count <= length || code == UNLINK);
        answers = &more[data..];
    }
    assert!(answers.is_empty(), "an answer too many");
    // It has ended within a request, or between two.
    assert!(ended.is_ok() || ended.is_err_and(|error| error.kind() == ErrorKind::UnexpectedEof));
}
