// SPDX-License-Identifier: MIT

//! The answer to a LOOKUP, written to `/dev/fuse` without the crate `fuser`, which would show the nodeid as the inode
//! number. A nodeid is larger than 2^32, and a file's attributes must be valid together with its name.

use std::fs::File;
use std::io::Write;
use std::os::fd::BorrowedFd;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime};

use fuser::{Errno, FileAttr, FileType, ReplyEntry, Request};

/// The kernel's end of a mount, once it is open.
#[derive(Clone, Default)]
pub(super) struct Device(Arc<OnceLock<File>>);

pub(super) struct Entry {
    pub(super) nodeid: u64,
    pub(super) attr: FileAttr,
    pub(super) attr_ttl: Duration,
    pub(super) entry_ttl: Duration,
}

impl Device {
    pub(super) fn open(&self, device: BorrowedFd<'_>) -> std::io::Result<()> {
        let device = device.try_clone_to_owned()?;
        let _ = self.0.set(device.into());
        Ok(())
    }

    pub(super) fn write(&self, message: &[u8]) -> std::io::Result<()> {
        let mut device = self.0.get().ok_or(nix::errno::Errno::EBADF)?;
        device.write_all(message)
    }

    pub(super) fn answer(&self, request: &Request, entry: &Entry, reply: ReplyEntry) {
        match self.write(&entry.message(request.unique().into())) {
            Ok(()) => give_up(reply),
            Err(error) => reply.error(Errno::from_i32(error.raw_os_error().unwrap_or(nix::libc::EIO))),
        }
    }
}

/// Gives up the reply to an answered request. The crate would answer again for a dropped reply, and a forgotten one
/// leaves a count behind, which overflows after 2^31 LOOKUPs of a 32-bit program and ends it. On 32 bits the kernel
/// refuses the second answer.
fn give_up(reply: ReplyEntry) {
    if cfg!(target_pointer_width = "64") {
        std::mem::forget(reply);
    } else {
        reply.error(Errno::ENOENT);
    }
}

impl Entry {
    /// `struct fuse_out_header`, `struct fuse_entry_out`.
    fn message(&self, unique: u64) -> Vec<u8> {
        let attr = &self.attr;
        let format = match attr.kind {
            FileType::Directory => nix::libc::S_IFDIR,
            FileType::Symlink => nix::libc::S_IFLNK,
            _ => nix::libc::S_IFREG,
        };
        let times = [attr.atime, attr.mtime, attr.ctime].map(since_epoch);
        let seconds = times.map(|time| time.as_secs());
        let [entry_ttl, attr_ttl] = [self.entry_ttl, self.attr_ttl];
        let mut body = Message(Vec::with_capacity(144));
        // The header comes before the body is known: its length does not vary.
        body.words32(&[144, 0]).words64(&[unique]);
        body.words64(&[self.nodeid, 0, entry_ttl.as_secs(), attr_ttl.as_secs()]);
        body.words32(&[entry_ttl.subsec_nanos(), attr_ttl.subsec_nanos()]);
        body.words64(&[attr.ino.into(), attr.size, attr.blocks]).words64(&seconds);
        body.words32(&times.map(|time| time.subsec_nanos()));
        body.words32(&[
            format | u32::from(attr.perm),
            attr.nlink,
            attr.uid,
            attr.gid,
            attr.rdev,
            attr.blksize,
            0,
        ]);
        body.0
    }
}

fn since_epoch(time: SystemTime) -> Duration {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}

/// Words in the machine's order.
struct Message(Vec<u8>);

impl Message {
    fn words32(&mut self, words: &[u32]) -> &mut Self {
        words.iter().for_each(|word| self.0.extend(word.to_ne_bytes()));
        self
    }

    fn words64(&mut self, words: &[u64]) -> &mut Self {
        words.iter().for_each(|word| self.0.extend(word.to_ne_bytes()));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fuser::INodeNo;

    /// In the order of a kernel's header.
    #[test]
    fn an_entry_has_its_place_for_each_field() {
        let at = |seconds, nanos| SystemTime::UNIX_EPOCH + Duration::new(seconds, nanos);
        let attr = FileAttr {
            ino: INodeNo(0x10_0001),
            size: 5,
            blocks: 1,
            atime: at(1, 2),
            mtime: at(3, 4),
            ctime: at(5, 6),
            crtime: at(7, 8),
            kind: FileType::RegularFile,
            perm: 0o444,
            nlink: 1,
            uid: 1000,
            gid: 1001,
            rdev: 0,
            blksize: 4096,
            flags: 0,
        };
        let ttl = Duration::new;
        let entry = Entry { nodeid: 7 << 32 | 0x10_0001, attr, attr_ttl: ttl(0, 500), entry_ttl: ttl(2, 9) };
        let message = entry.message(42);
        assert_eq!(message.len(), 144);
        let word32 = |at: usize| u32::from_ne_bytes(message[at..at + 4].try_into().expect("4 bytes"));
        let word64 = |at: usize| u64::from_ne_bytes(message[at..at + 8].try_into().expect("8 bytes"));
        assert_eq!((word32(0), word32(4), word64(8)), (144, 0, 42));
        assert_eq!([16, 24, 32, 40].map(word64), [7 << 32 | 0x10_0001, 0, 2, 0]);
        assert_eq!([48, 52].map(word32), [9, 500]);
        assert_eq!([56, 64, 72, 80, 88, 96].map(word64), [0x10_0001, 5, 1, 1, 3, 5]);
        assert_eq!([104, 108, 112].map(word32), [2, 4, 6]);
        assert_eq!([116, 120, 124, 128, 132, 136, 140].map(word32), [0o100_444, 1, 1000, 1001, 0, 4096, 0]);
    }
}
