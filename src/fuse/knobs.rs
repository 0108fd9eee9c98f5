// SPDX-License-Identifier: MIT

//! A folder of knobs: a file each, whose reads and writes are not kept by the kernel.

use std::ffi::OsStr;
use std::path::Path;
use std::time::{Duration, SystemTime};

use fuser::{
    BsdFileFlags, Config, Errno, FileAttr, FileHandle, FileType, Filesystem, FopenFlags, Generation, INodeNo,
    LockOwner, OpenFlags, ReplyAttr, ReplyData, ReplyDirectory, ReplyEntry, ReplyOpen, ReplyWrite, Request,
    TimeOrNow, WriteFlags,
};

use super::{host, needs};
use crate::error::Result;
use crate::fs::Knobs;
use crate::output::say;

/// Each gauge has as many nodeids, beginning with that of its folder.
const STRIDE: u64 = 1 << 16;

/// What a nodeid is.
enum Place {
    /// The folders of the gauges.
    Top,
    /// The folder of the gauge at that index.
    Gauge(usize),
    /// A knob of it, by its index.
    Knob(usize, usize),
}

struct Tree {
    /// What each gauge is called, and its knobs.
    gauges: Vec<(String, Box<dyn Knobs>)>,
    uid: u32,
    gid: u32,
}

impl Tree {
    /// The folder that is mounted has the knobs of the only gauge, or a folder for each.
    fn place(&self, ino: INodeNo) -> Place {
        match (u64::from(ino), &self.gauges[..]) {
            (1, [_]) => Place::Gauge(0),
            (1, _) => Place::Top,
            (number, _) if number % STRIDE == 0 => Place::Gauge((number / STRIDE - 1) as usize),
            (number, _) => Place::Knob((number / STRIDE - 1) as usize, (number % STRIDE - 1) as usize),
        }
    }

    /// The names in a folder with their nodeids.
    fn list(&self, place: &Place) -> Vec<(String, u64)> {
        match *place {
            Place::Top => {
                (1..).zip(&self.gauges).map(|(at, (name, _))| (name.clone(), at * STRIDE)).collect()
            }
            Place::Gauge(gauge) => {
                let first = (gauge as u64 + 1) * STRIDE + 1;
                let knobs = self.gauges.get(gauge).map(|(_, knobs)| knobs.list()).unwrap_or_default();
                (first..).zip(knobs).map(|(ino, (name, _))| (name.to_string(), ino)).collect()
            }
            Place::Knob(..) => Vec::new(),
        }
    }

    /// A knob: all of its gauge, its name, and whether it may be written.
    fn knob(&self, ino: INodeNo) -> Option<(&dyn Knobs, &'static str, bool)> {
        let Place::Knob(gauge, knob) = self.place(ino) else { return None };
        let (_, knobs) = self.gauges.get(gauge)?;
        let (name, writable) = knobs.list().get(knob).copied()?;
        Some((&**knobs, name, writable))
    }

    fn attr(&self, ino: INodeNo) -> FileAttr {
        let (kind, perm) = match self.knob(ino) {
            Some((_, _, true)) => (FileType::RegularFile, 0o644),
            Some((_, _, false)) => (FileType::RegularFile, 0o444),
            None => (FileType::Directory, 0o755),
        };
        let time = SystemTime::UNIX_EPOCH;
        FileAttr {
            ino,
            size: 0,
            blocks: 0,
            atime: time,
            mtime: time,
            ctime: time,
            crtime: time,
            kind,
            perm,
            nlink: 1,
            uid: self.uid,
            gid: self.gid,
            rdev: 0,
            blksize: 4096,
            flags: 0,
        }
    }
}

impl Filesystem for Tree {
    fn lookup(&self, _: &Request, parent: INodeNo, name: &OsStr, reply: ReplyEntry) {
        match self.list(&self.place(parent)).into_iter().find(|(found, _)| OsStr::new(found) == name) {
            Some((_, ino)) => reply.entry(&TTL, &self.attr(INodeNo(ino)), Generation(0)),
            None => reply.error(Errno::ENOENT),
        }
    }

    fn getattr(&self, _: &Request, ino: INodeNo, _: Option<FileHandle>, reply: ReplyAttr) {
        reply.attr(&TTL, &self.attr(ino));
    }

    /// `echo` truncates a file before it writes.
    #[allow(clippy::too_many_arguments, reason = "the trait's signature")]
    fn setattr(
        &self,
        _: &Request,
        ino: INodeNo,
        mode: Option<u32>,
        uid: Option<u32>,
        gid: Option<u32>,
        _: Option<u64>,
        _: Option<TimeOrNow>,
        _: Option<TimeOrNow>,
        _: Option<SystemTime>,
        _: Option<FileHandle>,
        _: Option<SystemTime>,
        _: Option<SystemTime>,
        _: Option<SystemTime>,
        _: Option<BsdFileFlags>,
        reply: ReplyAttr,
    ) {
        match mode.or(uid).or(gid) {
            Some(_) => reply.error(Errno::EPERM),
            None => reply.attr(&TTL, &self.attr(ino)),
        }
    }

    fn open(&self, _: &Request, _: INodeNo, _: OpenFlags, reply: ReplyOpen) {
        reply.opened(FileHandle(0), FopenFlags::FOPEN_DIRECT_IO);
    }

    fn read(
        &self,
        _: &Request,
        ino: INodeNo,
        _: FileHandle,
        offset: u64,
        size: u32,
        _: OpenFlags,
        _: Option<LockOwner>,
        reply: ReplyData,
    ) {
        let Some(text) = self.knob(ino).and_then(|(knobs, name, _)| knobs.get(name)) else {
            return reply.error(Errno::ENODEV);
        };
        let text = text + "\n";
        let rest = text.as_bytes().get(offset as usize..).unwrap_or_default();
        reply.data(&rest[..rest.len().min(size as usize)]);
    }

    fn write(
        &self,
        _: &Request,
        ino: INodeNo,
        _: FileHandle,
        _: u64,
        data: &[u8],
        _: WriteFlags,
        _: OpenFlags,
        _: Option<LockOwner>,
        reply: ReplyWrite,
    ) {
        let Some((knobs, name, _)) = self.knob(ino) else { return reply.error(Errno::ENODEV) };
        match knobs.set(name, std::str::from_utf8(data).unwrap_or_default()) {
            Ok(()) => reply.written(data.len() as u32),
            Err(error) => {
                reply.error(Errno::from_i32(error.errno() as i32));
                say(error);
            }
        }
    }

    fn readdir(&self, _: &Request, ino: INodeNo, _: FileHandle, offset: u64, mut reply: ReplyDirectory) {
        let dots = [".", ".."].map(|name| (name.to_string(), u64::from(ino)));
        let list = dots.into_iter().chain(self.list(&self.place(ino)));
        for (at, (name, ino)) in (1..).zip(list).skip(offset as usize) {
            let kind = self.attr(INodeNo(ino)).kind;
            if reply.add(INodeNo(ino), at, kind, name) {
                break;
            }
        }
        reply.ok();
    }

    fn flush(&self, _: &Request, _: INodeNo, _: FileHandle, _: LockOwner, reply: fuser::ReplyEmpty) {
        reply.ok();
    }
}

/// How long the kernel may keep names and attributes, which do not change.
const TTL: Duration = Duration::from_secs(3600);

/// Mounts a folder with the knobs of these gauges, each with its name, and serves it until it is unmounted.
pub fn mount(path: &Path, source: &str, gauges: Vec<(String, Box<dyn Knobs>)>) -> Result<()> {
    let uid = nix::unistd::geteuid().as_raw();
    let tree = Tree { gauges, uid, gid: nix::unistd::getegid().as_raw() };
    let session = needs::session(tree, path, (source, "knobs"), Config::default())?;
    let session = session.spawn().map_err(|error| host("a thread", &error))?;
    // Dropping it would unmount the path, and so whatever has been mounted there since.
    std::mem::forget(session);
    Ok(())
}
