// SPDX-License-Identifier: MIT

//! The handlers of the kernel's requests.
//!
//! No handler blocks, and none notifies the kernel: while the kernel waits for an answer it holds locks
//! that a notification needs. A request that needs the gauge keeps its reply object, which is answered from
//! the thread of the gauge's owner.

use std::borrow::Cow;
use std::collections::HashSet;
use std::ffi::OsStr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use fuser::{
    AccessFlags, BsdFileFlags, CopyFileRangeFlags, Errno, FileAttr, FileHandle, FileType, Filesystem,
    FopenFlags, INodeNo, InitFlags, IoctlFlags, KernelConfig, LockOwner, OpenFlags, PollEvents, PollFlags,
    PollNotifier, RenameFlags, ReplyAttr, ReplyCreate, ReplyData, ReplyDirectory, ReplyEmpty, ReplyEntry,
    ReplyIoctl, ReplyLseek, ReplyOpen, ReplyPoll, ReplyStatfs, ReplyWrite, ReplyXattr, Request, TimeOrNow,
    WriteFlags,
};

use super::entry::Entry;
use super::inodes::{self, Inode, Inodes, Now, Sharing, Shown, Value};
use super::notify::{Announcer, hash};
use super::{Options, Table, lock, present};
use crate::error::{Error, Result};
use crate::fs::{Caller, Fs, Node, Process, Shape};

/// How long the kernel may keep a name without asking.
const TTL: Duration = Duration::from_secs(2);

/// How long it may keep the folder of a gauge, which stays as long as the mount, and at most what it is notified of: this
/// bounds how long a dead daemon goes unnoticed.
const FIXED_TTL: Duration = Duration::from_secs(60);

/// How long a write waits until the kernel tells that the open file before it is closed.
const CLOSES: Duration = Duration::from_secs(1);

/// An extended attribute that the kernel asks for before each write, and removes if the file has it. Only then it copies
/// what is written to the page cache, where everybody sees it before gaugefs gets it. A file that nobody may write
/// pretends to have the attribute and does not let it be removed, so that not even root's writes get to the page cache.
/// A reader of the attribute gets the answer that it does not exist.
const CAPABILITY: &str = "security.capability";
/// The size of that attribute; any but 0 will do.
const CAPABILITY_SIZE: u32 = 20;

/// What the kernel and `ls` ask of each file, and this tree has of none: labels and access lists. `ls` does not ask again
/// after this answer.
const UNSUPPORTED: [&str; 3] = ["security.selinux", "system.posix_acl_access", "system.posix_acl_default"];

/// The unit of a file's blocks.
const BLOCK: u64 = 512;

/// A request that is answered when an unread value has arrived.
pub(super) enum Waiter {
    Read {
        offset: u64,
        size: u32,
        reply: ReplyData,
    },
    /// A GETATTR that precedes a READ, and fails as that would.
    SizeToRead(ReplyAttr),
    /// A GETATTR for `fstat`, which fails as a read would.
    SizeOfOpen(ReplyAttr),
    /// A GETATTR for `stat`.
    Attributes(ReplyAttr),
}

impl Now {
    pub(super) fn read() -> Self {
        Self { instant: Instant::now(), time: SystemTime::now() }
    }
}

#[derive(Clone)]
pub(super) struct Adapter {
    pub(super) fs: Arc<Fs>,
    pub(super) table: Arc<Table>,
    pub(super) options: Options,
    pub(super) announcer: Announcer,
    /// The files to which a write waits for the end of an open file.
    pub(super) waits: Arc<Mutex<HashSet<u32>>>,
    /// Disconnects when the session has ended and drops its adapter.
    pub(super) _alive: Sender<()>,
}

impl Adapter {
    fn inodes(&self) -> MutexGuard<'_, Inodes<Waiter>> {
        lock(&self.table)
    }

    /// The table, with this nodeid in use.
    fn using(&self, number: u64) -> MutexGuard<'_, Inodes<Waiter>> {
        let mut inodes = self.inodes();
        if inodes.get(number).is_none()
            && let Some(node) = inodes::node(number).filter(|&node| self.fs.shape(node) == Shape::File)
        {
            inodes.wake(number, present(&self.fs, node), self.sharing(node, 0), Now::read());
        }
        inodes
    }

    fn node(&self, ino: INodeNo) -> Option<Node> {
        inodes::node(ino.into())
    }

    /// Which lookups find a nodeid that a thread has looked up.
    fn sharing(&self, node: Node, thread: u32) -> Sharing {
        match self.fs.may_be_written(node) && !self.options.read_only {
            true => Sharing::Alone,
            false if self.fs.may_be_cached(node) => Sharing::All,
            false => Sharing::By(thread),
        }
    }

    fn attr(&self, shown: &Shown) -> FileAttr {
        let (kind, nlink) = match self.fs.shape(shown.node) {
            Shape::Folder => (FileType::Directory, 2),
            Shape::Link => (FileType::Symlink, 1),
            Shape::File => (FileType::RegularFile, 1),
        };
        let size = match kind {
            FileType::Symlink => self.fs.target(shown.node).map_or(0, |target| target.len() as u64),
            _ => shown.size,
        };
        let (uid, gid) = self.fs.owner();
        FileAttr {
            // Not the nodeid: 32-bit programs without large-file support cannot take a larger number.
            ino: INodeNo(shown.node.place().into()),
            size,
            // Programs look for holes in a file with fewer blocks than its size needs.
            blocks: if kind == FileType::RegularFile { size.div_ceil(BLOCK) } else { 0 },
            atime: shown.since,
            mtime: shown.since,
            ctime: shown.since,
            crtime: shown.since,
            kind,
            perm: self.fs.mode(shown.node),
            nlink,
            uid,
            gid,
            rdev: 0,
            blksize: 4096,
            flags: 0,
        }
    }

    /// How long the kernel may keep a name. That of a file means the value that it had, and of many gauges it is kept until
    /// the next poll only: a notification makes the kernel look up every name again.
    fn name_ttl(&self, node: Node) -> Duration {
        let fixed = self.fs.shape(node) != Shape::File;
        match self.fs.may_be_cached(node) && (fixed || self.announcer.keeps_names()) {
            false => Duration::ZERO,
            true if self.fs.is_fixed(node) => FIXED_TTL,
            true if fixed => TTL,
            true => {
                let unchanged = self.fs.unchanged_for(node);
                let unchanged = unchanged.map(|time| time.saturating_sub(inodes::NAME_OVER).min(TTL));
                unchanged.unwrap_or_else(|| self.notified_ttl(node))
            }
        }
    }

    /// How long it may keep what it is notified of.
    fn notified_ttl(&self, node: Node) -> Duration {
        self.fs.outlasts_daemon(node).clamp(TTL, FIXED_TTL)
    }

    /// How long the kernel may keep the attributes.
    fn attr_ttl(&self, shown: &Shown) -> Duration {
        match self.fs.shape(shown.node) {
            Shape::File => shown.valid,
            // They change with its listing, of which the kernel is notified.
            Shape::Folder if shown.node == Node::Root && !self.fs.is_overlay() => {
                self.notified_ttl(shown.node)
            }
            Shape::Folder | Shape::Link => self.name_ttl(shown.node),
        }
    }

    /// Answers a request when the nodeid's value has been read from the gauge.
    fn answer_when_read(&self, mut inodes: MutexGuard<'_, Inodes<Waiter>>, number: u64, waiter: Waiter) {
        let node = inodes::node(number);
        // The first answer becomes the value of this nodeid, for this request and every other.
        let first = inodes.wait(number, waiter);
        drop(inodes);
        if let Some(node) = node.filter(|_| first) {
            let arrival = Arrival { adapter: self.clone(), number, answered: false };
            self.announcer.pass_on(|refused| match refused {
                Some(error) => arrival.with(Err(error)),
                None => self.fs.read(node, Box::new(move |read| arrival.with(read))),
            });
        }
    }

    /// Passes a write on when nothing else of the gauge's files is leased, and when the open file before it is closed. The
    /// kernel tells of that in its own time, and perhaps after what a shell has written to the next one.
    fn write_in_turn(&self, write: Write<'_>) {
        let (node, caller, place) = (write.writing.node, write.caller, write.writing.node.place());
        // One at a time: whoever has several open files in use at once waits for none of them.
        let awaits_close = self.fs.awaits_close(node, caller) && lock(&self.waits).insert(place);
        let now = Now::read();
        let leases = self.inodes().leases(write.writing.number, now);
        if !awaits_close && leases.is_zero() {
            return self.begin_write(write);
        }
        let write = Write { data: write.data.into_owned().into(), ..write };
        let (adapter, until) = (self.clone(), now.instant + CLOSES);
        let later = move || {
            thread::sleep(leases);
            while awaits_close && adapter.fs.awaits_close(node, caller) && Instant::now() < until {
                thread::sleep(Duration::from_millis(1));
            }
            if awaits_close {
                lock(&adapter.waits).remove(&place);
            }
            adapter.begin_write(write);
        };
        // If there can be no thread, the write is dropped, which answers it.
        let started = thread::Builder::new().name("write".into()).stack_size(128 * 1024).spawn(later);
        if started.is_err() && awaits_close {
            lock(&self.waits).remove(&place);
        }
    }

    fn begin_write(&self, Write { mut writing, caller, offset, data }: Write<'_>) {
        self.announcer.pass_on(|refused| {
            if let Some(error) = refused {
                return writing.answer(Err(error));
            }
            writing.is_begun = true;
            let (fs, node) = (self.fs.clone(), writing.node);
            fs.write(node, caller, offset, &data, Box::new(move |outcome| writing.answer(outcome)));
        });
    }

    /// Notes a write(2) that has arrived: what the kernel has copied may be refused.
    fn writing(&self, number: u64, node: Node, length: usize, reply: ReplyWrite) -> Writing {
        self.using(number).write_begins(number, Now::read());
        Writing {
            fs: self.fs.clone(),
            table: self.table.clone(),
            announcer: self.announcer.clone(),
            number,
            node,
            length: u32::try_from(length).unwrap_or(u32::MAX),
            is_begun: false,
            reply: Some(reply),
        }
    }

    /// Gives the kernel bytes of a nodeid's value.
    fn serve(&self, number: u64, bytes: &[u8], offset: u64, size: u32, reply: ReplyData) {
        // First the note: whoever is answered next may be told to drop these bytes.
        self.inodes().served(number, offset + u64::from(size), Now::read());
        reply.data(slice(bytes, offset, size));
    }

    /// Handles a request. A panic in it is an error of this request, whose reply is dropped, which answers EIO; it is
    /// reported as one of the gauge, and other requests go on.
    fn guard(&self, ino: INodeNo, work: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(work)).is_err() {
            self.fs.report_defect(self.node(ino));
        }
    }

    /// Whether a node is a file that nobody may write.
    fn is_read_only(&self, node: Node) -> bool {
        self.fs.shape(node) == Shape::File && !self.fs.may_be_written(node)
    }

    /// The errno of every request to add, remove or rename something, which this tree does not allow.
    fn fixed(&self) -> Errno {
        if self.options.read_only { Errno::EROFS } else { Errno::EPERM }
    }
}

/// A requested unread value. Its waiters get an answer, even if the gauge's owner ends without reading it.
struct Arrival {
    adapter: Adapter,
    number: u64,
    answered: bool,
}

impl Arrival {
    fn with(mut self, read: Result<Arc<[u8]>>) {
        self.answered = true;
        self.answer(&read);
    }

    fn answer(&self, read: &Result<Arc<[u8]>>) {
        let mut inodes = self.adapter.inodes();
        let Some((shown, waiting)) = inodes.arrived(self.number, read.as_ref().ok(), Now::read()) else {
            return;
        };
        let is_read = |waiter: &Waiter| matches!(waiter, Waiter::Read { .. } | Waiter::SizeToRead(_));
        if let Err(error) = read
            && !waiting.iter().any(is_read)
        {
            inodes.refuse(self.number, errno(error), Now::read());
        }
        drop(inodes);
        for waiter in waiting {
            match (waiter, read) {
                (Waiter::Read { offset, size, reply }, Ok(bytes)) => {
                    self.adapter.serve(self.number, bytes, offset, size, reply);
                }
                (Waiter::Read { reply, .. }, Err(error)) => reply.error(errno(error)),
                (Waiter::SizeToRead(reply) | Waiter::SizeOfOpen(reply), Err(error)) => {
                    reply.error(errno(error))
                }
                (Waiter::Attributes(reply) | Waiter::SizeToRead(reply) | Waiter::SizeOfOpen(reply), _) => {
                    reply.attr(&self.adapter.attr_ttl(&shown), &self.adapter.attr(&shown));
                }
            }
        }
    }
}

impl Drop for Arrival {
    fn drop(&mut self) {
        if !self.answered {
            self.answer(&Err(Error::host("", nix::errno::Errno::ENODEV, "the gauge has been given up")));
        }
    }
}

/// A write(2) that has arrived.
struct Write<'a> {
    writing: Writing,
    caller: Caller,
    /// Where the data begins in the file.
    offset: u64,
    data: Cow<'a, [u8]>,
}

/// A write that has an answer coming. It gets one, even if the gauge's owner ends without giving it.
struct Writing {
    fs: Arc<Fs>,
    table: Arc<Table>,
    announcer: Announcer,
    number: u64,
    node: Node,
    length: u32,
    /// It was passed on.
    is_begun: bool,
    reply: Option<ReplyWrite>,
}

impl Writing {
    fn answer(&mut self, outcome: Result<()>) {
        let Some(reply) = self.reply.take() else { return };
        let (fs, table, number, node, length) =
            (self.fs.clone(), self.table.clone(), self.number, self.node, self.length);
        // Before the answer can be given, so that it follows on the notification of what the write has changed.
        self.fs.raise(node);
        self.announcer.answer(Box::new(move || {
            inodes::end_write(&*table, number, || present(&fs, node), Now::read());
            match outcome {
                Ok(()) => reply.written(length),
                Err(error) => reply.error(errno(&error)),
            }
        }));
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        let (errno, why) = match self.is_begun {
            true => (
                nix::errno::Errno::ENOTRECOVERABLE,
                "the gauge has been given up during a write; mount it again to find out what it holds",
            ),
            false => (nix::errno::Errno::EIO, "gaugefs cannot start a thread, so nothing was sent"),
        };
        self.answer(Err(Error::host("", errno, why)));
    }
}

fn errno(error: &Error) -> Errno {
    Errno::from_i32(error.errno())
}

fn slice(bytes: &[u8], offset: u64, size: u32) -> &[u8] {
    let start = usize::try_from(offset).unwrap_or(usize::MAX).min(bytes.len());
    &bytes[start..bytes.len().min(start.saturating_add(size as usize))]
}

impl Filesystem for Adapter {
    fn init(&mut self, _: &Request, config: &mut KernelConfig) -> std::io::Result<()> {
        // See `getattr`. Linux has had it since 3.10.
        if config.add_capabilities(InitFlags::FUSE_AUTO_INVAL_DATA).is_err() {
            log::warn!("this kernel is too old to show changes in files that are held open");
        }
        Ok(())
    }

    fn destroy(&mut self) {
        self.announcer.close();
    }

    fn lookup(&self, request: &Request, parent: INodeNo, name: &OsStr, reply: ReplyEntry) {
        self.guard(parent, || {
            let Some(folder) = self.node(parent) else { return reply.error(Errno::ESTALE) };
            let Some(node) = name.to_str().and_then(|name| self.fs.lookup(folder, name)) else {
                return reply.error(Errno::ENOENT);
            };
            let content = || Value::of(self.fs.content(node));
            let entry_ttl = self.name_ttl(node);
            let shown = match self.fs.shape(node) {
                Shape::File => {
                    let sharing = self.sharing(node, request.pid());
                    inodes::look_up(&*self.table, node, content, (sharing, entry_ttl), Now::read())
                }
                Shape::Folder | Shape::Link => Some(self.inodes().fixed(node)),
            };
            let Some(shown) = shown else { return reply.error(Errno::ENOENT) };
            let attr_ttl = self.attr_ttl(&shown);
            let entry = Entry { nodeid: shown.number, attr: self.attr(&shown), attr_ttl, entry_ttl };
            self.announcer.device.answer(request, &entry, reply);
        });
    }

    fn forget(&self, _: &Request, ino: INodeNo, lookups: u64) {
        self.inodes().forget(ino.into(), lookups);
        // The nodeid of a file that may be written is of one open file.
        if let Some(node) = self.node(ino) {
            self.fs.close(node, ino.into());
        }
    }

    /// The kernel sends this before a read if the attributes that it has are no longer valid, and drops the
    /// bytes that it has if the file's time differs. This is how a file that is held open gets its new value.
    fn getattr(&self, _: &Request, ino: INodeNo, handle: Option<FileHandle>, reply: ReplyAttr) {
        self.guard(ino, || {
            let (number, now) = (u64::from(ino), Now::read());
            let mut inodes = self.using(number);
            // A read passes a handle, and `fstat` does not.
            let reads = inodes.ask(number) || handle.is_some();
            if let Some(node) = inodes.due(number, now) {
                let value = present(&self.fs, node);
                // The estimated size of an unread value would be wrong for whoever is reading the old value.
                if reads || !matches!(value, Value::Unread(_)) {
                    inodes.renew(number, value, now);
                }
            }
            let Some(inode) = inodes.get(number) else {
                let Some(node) = self.node(ino) else { return reply.error(Errno::ESTALE) };
                let shown = inodes.fixed(node);
                drop(inodes);
                return reply.attr(&self.attr_ttl(&shown), &self.attr(&shown));
            };
            // The errno of a READ becomes EIO from Linux 7.2 on, and that of this answer does not.
            if inode.is_gone() {
                return reply.error(Errno::ENODEV);
            }
            if reads && inode.is_unread() {
                if handle.is_none() {
                    return self.answer_when_read(inodes, number, Waiter::SizeOfOpen(reply));
                }
                return match inodes.take_refusal(number, now) {
                    Some(errno) => reply.error(errno),
                    None => self.answer_when_read(inodes, number, Waiter::SizeToRead(reply)),
                };
            }
            if inode.is_awaited() {
                // The size arrives with the value.
                return self.answer_when_read(inodes, number, Waiter::Attributes(reply));
            }
            inodes.settle(number, now);
            let Some(shown) = inodes.show(number, now) else { return reply.error(Errno::ESTALE) };
            drop(inodes);
            reply.attr(&self.attr_ttl(&shown), &self.attr(&shown));
        });
    }

    /// Truncation alone writes nothing, and the size stays the same, as in sysfs.
    #[allow(clippy::too_many_arguments, reason = "the trait's signature")]
    fn setattr(
        &self,
        _: &Request,
        ino: INodeNo,
        mode: Option<u32>,
        uid: Option<u32>,
        gid: Option<u32>,
        size: Option<u64>,
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
        self.guard(ino, || {
            if mode.is_some() || uid.is_some() || gid.is_some() {
                return reply.error(self.fixed());
            }
            let number = u64::from(ino);
            let mut inodes = self.using(number);
            let Some(node) = self.node(ino) else { return reply.error(Errno::ESTALE) };
            let shown = inodes.shown(number, Now::read()).unwrap_or_else(|| inodes.fixed(node));
            // The kernel takes over the time from this answer, but keeps its bytes; the next time has to differ.
            inodes.touch(number);
            if size.is_some() {
                inodes.overwrite(number);
            }
            drop(inodes);
            if size.is_some() && !self.fs.may_be_written(shown.node) {
                return reply.error(Errno::EACCES);
            }
            reply.attr(&Duration::ZERO, &self.attr(&shown));
        });
    }

    fn readlink(&self, _: &Request, ino: INodeNo, reply: ReplyData) {
        self.guard(ino, || match self.node(ino).and_then(|node| self.fs.target(node)) {
            Some(target) => reply.data(target.as_bytes()),
            None => reply.error(Errno::EINVAL),
        });
    }

    fn open(&self, _: &Request, _: INodeNo, _: OpenFlags, reply: ReplyOpen) {
        reply.error(Errno::ENOSYS);
    }

    fn opendir(&self, _: &Request, ino: INodeNo, _: OpenFlags, reply: ReplyOpen) {
        if !self.fs.is_overlay() {
            return reply.error(Errno::ENOSYS);
        }
        let kept = FopenFlags::FOPEN_KEEP_CACHE | FopenFlags::FOPEN_CACHE_DIR;
        reply.opened(FileHandle(0), if ino == INodeNo::ROOT { FopenFlags::empty() } else { kept });
    }

    fn flush(&self, _: &Request, _: INodeNo, _: FileHandle, _: LockOwner, reply: ReplyEmpty) {
        reply.error(Errno::ENOSYS);
    }

    fn fsync(&self, _: &Request, _: INodeNo, _: FileHandle, _: bool, reply: ReplyEmpty) {
        reply.ok();
    }

    fn access(&self, _: &Request, _: INodeNo, _: AccessFlags, reply: ReplyEmpty) {
        reply.error(Errno::ENOSYS);
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
        self.guard(ino, || {
            let number = u64::from(ino);
            let mut inodes = self.inodes();
            // One that rests has not been shown to the kernel with the size of its present value.
            let Some(inode) = inodes.get(number) else { return reply.error(Errno::ESTALE) };
            match inode.value() {
                Value::Bytes(bytes) => {
                    let bytes = bytes.clone();
                    drop(inodes);
                    return self.serve(number, &bytes, offset, size, reply);
                }
                Value::Gone => return reply.error(Errno::ENODEV),
                Value::Unread(_) => {}
            }
            match inodes.take_refusal(number, Now::read()) {
                Some(errno) => reply.error(errno),
                None => self.answer_when_read(inodes, number, Waiter::Read { offset, size, reply }),
            }
        });
    }

    fn write(
        &self,
        request: &Request,
        ino: INodeNo,
        _: FileHandle,
        offset: u64,
        data: &[u8],
        _: WriteFlags,
        flags: OpenFlags,
        _: Option<LockOwner>,
        reply: ReplyWrite,
    ) {
        self.guard(ino, || {
            let number = u64::from(ino);
            let Some(node) = self.node(ino) else { return reply.error(Errno::ESTALE) };
            let appends = flags.0 & nix::fcntl::OFlag::O_APPEND.bits() != 0;
            if offset != 0 && !appends && !self.fs.is_stream(node) {
                return reply.error(Errno::EINVAL);
            }
            // Only of a stream does it matter who writes.
            let process = self.fs.is_stream(node).then(|| Process::of_thread(request.pid()));
            let caller = Caller { file: number, process: process.flatten() };
            let writing = self.writing(number, node, data.len(), reply);
            self.write_in_turn(Write { writing, caller, offset, data: data.into() });
        });
    }

    /// SEEK_DATA and SEEK_HOLE. No file has a hole, and a gauge is not asked: an ENXIO of it would mean that the file ends
    /// here. A read of what this promises gets the errno.
    fn lseek(&self, _: &Request, ino: INodeNo, _: FileHandle, offset: i64, whence: i32, reply: ReplyLseek) {
        self.guard(ino, || {
            let inodes = self.using(ino.into());
            let Some(shown) = inodes.shown(ino.into(), Now::read()) else {
                return reply.error(Errno::ESTALE);
            };
            let size = i64::try_from(shown.size).unwrap_or(i64::MAX);
            match whence {
                _ if inodes.get(ino.into()).is_some_and(Inode::is_gone) => reply.error(Errno::ENODEV),
                _ if !(0..size).contains(&offset) => reply.error(Errno::ENXIO),
                nix::libc::SEEK_HOLE => reply.offset(size),
                _ => reply.offset(offset),
            }
        });
    }

    fn readdir(&self, _: &Request, ino: INodeNo, _: FileHandle, offset: u64, mut reply: ReplyDirectory) {
        self.guard(ino, || {
            let Some(folder) = self.node(ino) else { return reply.error(Errno::ESTALE) };
            // One lock for both: if a poll changed the names in between, nobody would notify the kernel of it.
            let mut inodes = self.inodes();
            let list = self.fs.list(folder);
            if self.fs.may_change(folder) {
                inodes.listed(folder, hash(&list), offset > 0, Now::read());
            }
            drop(inodes);
            let dots = [".", ".."].map(|name| (name.to_string(), folder));
            let list = dots.into_iter().chain(list);
            for (at, (name, node)) in (1u64..).zip(list).skip(offset as usize) {
                let kind = match self.fs.shape(node) {
                    Shape::Folder => FileType::Directory,
                    Shape::Link => FileType::Symlink,
                    Shape::File => FileType::RegularFile,
                };
                // A file's inode number changes with its value, so any number but 0 will do here.
                if reply.add(INodeNo(at), at, kind, name) {
                    break;
                }
            }
            reply.ok();
        });
    }

    fn statfs(&self, _: &Request, _: INodeNo, reply: ReplyStatfs) {
        reply.statfs(0, 0, 0, 0, 0, 4096, 255, 4096);
    }

    fn getxattr(&self, request: &Request, ino: INodeNo, name: &OsStr, size: u32, reply: ReplyXattr) {
        self.guard(ino, || {
            let node = self.node(ino);
            if name == CAPABILITY && size == 0 && node.is_some_and(|node| self.is_read_only(node)) {
                self.using(ino.into()).asks(ino.into(), request.pid());
                return reply.size(CAPABILITY_SIZE);
            }
            let list = node.map(|node| self.fs.xattrs(node)).unwrap_or_default();
            if UNSUPPORTED.iter().any(|unsupported| name == *unsupported) {
                return reply.error(Errno::EOPNOTSUPP);
            }
            // ENOSYS would make the kernel stop asking for extended attributes at all.
            match list.iter().find(|(found, _)| OsStr::new(found) == name) {
                Some((_, value)) => answer_xattr(value.as_bytes(), size, reply),
                None => reply.error(Errno::ENODATA),
            }
        });
    }

    fn listxattr(&self, _: &Request, ino: INodeNo, size: u32, reply: ReplyXattr) {
        self.guard(ino, || {
            let list = self.node(ino).map(|node| self.fs.xattrs(node)).unwrap_or_default();
            let names: String = list.iter().flat_map(|(name, _)| [name, "\0"]).collect();
            answer_xattr(names.as_bytes(), size, reply);
        });
    }

    fn setxattr(&self, _: &Request, _: INodeNo, _: &OsStr, _: &[u8], _: i32, _: u32, reply: ReplyEmpty) {
        reply.error(self.fixed());
    }

    fn removexattr(&self, request: &Request, ino: INodeNo, name: &OsStr, reply: ReplyEmpty) {
        // The write or the change of the owner gets this answer.
        let is_write = name == CAPABILITY && self.inodes().is_about_to_write(ino.into(), request.pid());
        reply.error(if is_write { Errno::EACCES } else { self.fixed() });
    }

    // Requests that sysfs refuses too. The default methods of the trait would log a warning for each.

    /// Asked for a name that LOOKUP did not find: a mistyped one, written to with `>`.
    fn create(&self, _: &Request, parent: INodeNo, name: &OsStr, _: u32, _: u32, _: i32, reply: ReplyCreate) {
        self.guard(parent, || {
            let Some(folder) = self.node(parent) else { return reply.error(Errno::ESTALE) };
            reply.error(errno(&self.fs.refuse_new(folder, &name.to_string_lossy())));
        });
    }

    fn link(&self, _: &Request, _: INodeNo, _: INodeNo, _: &OsStr, reply: ReplyEntry) {
        reply.error(self.fixed());
    }

    fn rename(
        &self,
        _: &Request,
        _: INodeNo,
        _: &OsStr,
        _: INodeNo,
        _: &OsStr,
        _: RenameFlags,
        reply: ReplyEmpty,
    ) {
        reply.error(self.fixed());
    }

    fn fallocate(&self, _: &Request, _: INodeNo, _: FileHandle, _: u64, _: u64, _: i32, reply: ReplyEmpty) {
        reply.error(Errno::EOPNOTSUPP);
    }

    /// Programs call it to find out whether a file is a terminal.
    fn ioctl(
        &self,
        _: &Request,
        _: INodeNo,
        _: FileHandle,
        _: IoctlFlags,
        _: u32,
        _: &[u8],
        _: u32,
        reply: ReplyIoctl,
    ) {
        reply.error(Errno::ENOTTY);
    }

    // After ENOSYS the kernel handles these by itself and does not ask again.

    fn poll(
        &self,
        _: &Request,
        _: INodeNo,
        _: FileHandle,
        _: PollNotifier,
        _: PollEvents,
        _: PollFlags,
        reply: ReplyPoll,
    ) {
        reply.error(Errno::ENOSYS);
    }

    fn copy_file_range(
        &self,
        _: &Request,
        _: INodeNo,
        _: FileHandle,
        _: u64,
        _: INodeNo,
        _: FileHandle,
        _: u64,
        _: u64,
        _: CopyFileRangeFlags,
        reply: ReplyWrite,
    ) {
        reply.error(Errno::ENOSYS);
    }

    fn mknod(&self, _: &Request, _: INodeNo, _: &OsStr, _: u32, _: u32, _: u32, reply: ReplyEntry) {
        reply.error(self.fixed());
    }

    fn mkdir(&self, _: &Request, _: INodeNo, _: &OsStr, _: u32, _: u32, reply: ReplyEntry) {
        reply.error(self.fixed());
    }

    fn unlink(&self, _: &Request, _: INodeNo, _: &OsStr, reply: ReplyEmpty) {
        reply.error(self.fixed());
    }

    fn rmdir(&self, _: &Request, _: INodeNo, _: &OsStr, reply: ReplyEmpty) {
        reply.error(self.fixed());
    }

    fn symlink(&self, _: &Request, _: INodeNo, _: &OsStr, _: &Path, reply: ReplyEntry) {
        reply.error(self.fixed());
    }
}

fn answer_xattr(value: &[u8], size: u32, reply: ReplyXattr) {
    let length = value.len() as u32;
    match size {
        0 => reply.size(length),
        size if size < length => reply.error(Errno::ERANGE),
        _ => reply.data(value),
    }
}
