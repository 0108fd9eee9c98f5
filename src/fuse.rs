//! The thin adapter to the crate `fuser`: nodeids, replies, notifications.
//!
//! One nodeid is one immutable value. LOOKUP gives a file's present text a nodeid of its own with its exact
//! size; GETATTR and READ of that nodeid serve those bytes for ever; FORGET drops it. So a reader never
//! sees the size of one value and the bytes of another, and what has not changed comes from the kernel's
//! page cache without a message. `open` and `opendir` answer ENOSYS once and are never asked again. Only over the
//! kernel's own supplies `opendir` is answered, so that the root's listing is not kept.
//!
//! A new value is a new nodeid: it becomes the current one under the lock, the lock is let go, and then
//! the kernel is told that the name means something else. No handler blocks, and none notifies: the
//! kernel holds locks of its own while it waits for an answer. A file that is held open across a change
//! keeps its nodeid; two seconds later, when no read of the old value can be under way, that nodeid
//! gets the latest value.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime};

use fuser::{
    AccessFlags, BsdFileFlags, Config, CopyFileRangeFlags, Errno, FileAttr, FileHandle, FileType, Filesystem,
    FopenFlags, Generation, INodeNo, IoctlFlags, LockOwner, MountOption, Notifier, OpenFlags, PollEvents,
    PollFlags, PollNotifier, RenameFlags, ReplyAttr, ReplyCreate, ReplyData, ReplyDirectory, ReplyEmpty,
    ReplyEntry, ReplyIoctl, ReplyLseek, ReplyOpen, ReplyPoll, ReplyStatfs, ReplyWrite, ReplyXattr, Request,
    Session, SessionACL, TimeOrNow, WriteFlags,
};

use crate::error::{Error, Result};
use crate::fs::{Content, Fs, Node, Shape};
use crate::poll::Signal;

/// How long the kernel may keep a name and a size without asking. It bounds for how long a lost
/// notification or a dead daemon goes unnoticed.
const TTL: Duration = Duration::from_secs(2);
/// The size of a file that was not read yet is believed until it is read.
const UNREAD_TTL: Duration = Duration::from_secs(3600);
/// So long after a change a nodeid that is still in use gets the new value. 50 ms were too short: one torn
/// read in 5 million.
const SETTLE: Duration = Duration::from_secs(2);
/// So long the kernel takes at most to forget what nobody holds open.
const FORGET: Duration = Duration::from_millis(30);

/// So long the last answers may take: each is one message to the kernel.
const FLUSH: Duration = Duration::from_secs(2);

/// How to mount.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Open to the mount's owner only.
    pub private: bool,
    /// Nothing can be written.
    pub read_only: bool,
}

/// A mounted tree; dropped, it is unmounted.
pub struct Mounted {
    session: fuser::BackgroundSession,
    /// Disconnected when the session has ended, and what it served is dropped.
    over: Receiver<()>,
    answers: Answers,
}

/// The answers to writes that wait until the kernel has heard what was changed.
#[derive(Clone)]
pub struct Answers {
    answers: Arc<Mutex<Vec<Answer>>>,
    signal: Arc<Signal>,
}

impl Answers {
    /// Returns when all of them have been given, or nobody takes them any more.
    pub fn flush(&self) {
        let (done, is_done) = mpsc::channel::<()>();
        let last = Box::new(move || drop(done));
        self.answers.lock().expect("no thread panics while it holds the lock").push(last);
        self.signal.raise();
        // Nobody sends: the other end is dropped when its turn comes. Unmounted, there is none.
        let _ = is_done.recv_timeout(FLUSH);
    }
}

impl Mounted {
    /// Whether the tree was unmounted from outside.
    pub fn is_over(&self) -> bool {
        self.session.guard.is_finished()
    }

    /// What has not been answered yet.
    pub fn answers(&self) -> Answers {
        self.answers.clone()
    }

    /// Returns when the tree is unmounted from outside.
    pub fn wait(self) {
        // Nobody sends: the other end is dropped with the session.
        let _ = self.over.recv();
        // Dropped, fuser would unmount the same path again, and with it what somebody has mounted there
        // since: it takes the end of the connection for a mount (POLLERR in its `is_mounted`).
        std::mem::forget(self.session);
    }
}

fn host(subject: &str, error: &std::io::Error) -> Error {
    let errno = nix::errno::Errno::from_raw(error.raw_os_error().unwrap_or_default());
    // What fusermount3 says ends with a newline.
    Error::host(subject, errno, error.to_string().trim_end())
}

/// Mounts the tree, and serves it from threads of its own until it is unmounted. `signal` is raised
/// whenever something that the tree shows may have changed.
pub fn mount(fs: Arc<Fs>, mountpoint: &Path, options: Options, signal: Arc<Signal>) -> Result<Mounted> {
    let mut config = Config::default();
    config.mount_options = vec![
        MountOption::FSName("gaugefs".into()),
        MountOption::Subtype("gaugefs".into()),
        MountOption::DefaultPermissions,
        MountOption::NoSuid,
        MountOption::NoDev,
        MountOption::NoExec,
    ];
    if options.read_only {
        config.mount_options.push(MountOption::RO);
    }
    // Without privileges the kernel shuts other users out unless the administrator allows it.
    if nix::unistd::geteuid().is_root() && !options.private {
        config.acl = SessionACL::All;
    }
    start(fs, options, signal, |adapter| {
        Session::new(adapter, mountpoint, &config)
            .map_err(|error| host(&mountpoint.display().to_string(), &error))
    })
}

/// Serves the tree to a `/dev/fuse` that has been mounted already.
pub fn serve(fs: Arc<Fs>, device: OwnedFd, options: Options, signal: Arc<Signal>) -> Result<Mounted> {
    // Who is let in, the mount has told the kernel.
    start(fs, options, signal, |adapter| {
        Session::from_fd(adapter, device, SessionACL::All, Config::default())
            .map_err(|error| host("/dev/fuse", &error))
    })
}

fn start(
    fs: Arc<Fs>,
    options: Options,
    signal: Arc<Signal>,
    begin: impl FnOnce(Adapter) -> Result<Session<Adapter>>,
) -> Result<Mounted> {
    let table = Arc::new(Mutex::new(Table::new()));
    let answers = Arc::new(Mutex::new(Vec::new()));
    let later = answers.clone();
    let (alive, over) = mpsc::channel();
    let adapter = Adapter { fs: fs.clone(), table: table.clone(), options, answers: later, _alive: alive };
    let session = begin(adapter)?;
    let notifier = session.notifier();
    let session = session.spawn().map_err(|error| host("a thread", &error))?;
    let renew = Arc::new(Signal::default());
    let (files, kernel) = (fs.clone(), notifier.clone());
    let mut renewal = Renewal { fs: files, table: table.clone(), notifier: kernel, threads: HashMap::new() };
    let mut watch = Watch { fs, table, notifier, folders: HashMap::new(), answers, renew: renew.clone() };
    let waiting = Answers { answers: watch.answers.clone(), signal: signal.clone() };
    thread("notify", move || watch.run(&signal))?;
    thread("renew", move || renewal.run(&renew))?;
    Ok(Mounted { session, over, answers: waiting })
}

fn thread(name: &str, body: impl FnOnce() + Send + 'static) -> Result<()> {
    let builder = std::thread::Builder::new().name(name.into()).stack_size(128 * 1024);
    builder.spawn(body).map(|_| ()).map_err(|error| host("a thread", &error))
}

/// What the kernel knows by number.
struct Table {
    next: u64,
    started: SystemTime,
    /// Every nodeid that the kernel has not forgotten.
    live: HashMap<u64, Live>,
    /// The nodeid that stands for the present value of a node.
    current: HashMap<Node, u64>,
    /// Nodeids under which a write has been answered.
    written: Vec<u64>,
    /// The mount is no more.
    over: bool,
}

struct Live {
    node: Node,
    lookups: u64,
    /// Who looked it up first.
    thread: u32,
    value: Value,
    /// Since when.
    since: SystemTime,
    /// When another value took its place, while that is not yet served under this nodeid.
    superseded: Option<Instant>,
    /// Writes that have not been answered. The kernel holds the file's page locked for as long.
    writing: u32,
    /// Who waits for a value that was not read yet, from the first READ until it comes.
    waiting: Option<Vec<Waiter>>,
}

/// A request that is answered when a value has come.
enum Waiter {
    Read { offset: u64, size: u32, reply: ReplyData },
    Attributes(ReplyAttr),
}

/// An answer to a write, given when the kernel has heard of everything that the write changed.
type Answer = Box<dyn FnOnce() + Send>;

/// What a nodeid stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Value {
    /// A folder or a link.
    Fixed,
    /// A file's bytes.
    Bytes(Arc<[u8]>),
    /// A file that has not been read yet, and its apparent size.
    Unread(u64),
    /// A file held open whose value is not there any more.
    Gone,
}

impl Value {
    fn of(content: Content) -> Option<Self> {
        match content {
            Content::Bytes(bytes) => Some(Value::Bytes(bytes.into())),
            Content::Unread(size) => Some(Value::Unread(size)),
            Content::Absent => None,
        }
    }

    fn size(&self) -> u64 {
        match self {
            Value::Fixed => 0,
            // Not 0: at the end of a file the kernel answers a read by itself, and not with ENODEV.
            Value::Gone => 4096,
            Value::Bytes(bytes) => bytes.len() as u64,
            Value::Unread(size) => *size,
        }
    }
}

impl Live {
    fn new(node: Node, value: Value, thread: u32, since: SystemTime) -> Self {
        Self { node, lookups: 1, thread, value, since, superseded: None, writing: 0, waiting: None }
    }

    /// Nobody is reading it from the gauge or writing it.
    fn is_idle(&self) -> bool {
        self.writing == 0 && self.waiting.is_none()
    }
}

impl Table {
    fn new() -> Self {
        let started = SystemTime::now();
        let root = Live::new(Node::Root, Value::Fixed, 0, started);
        let number = u64::from(INodeNo::ROOT);
        Self {
            next: number + 1,
            started,
            live: HashMap::from([(number, root)]),
            current: HashMap::from([(Node::Root, number)]),
            written: Vec::new(),
            over: false,
        }
    }

    fn node(&self, number: INodeNo) -> Option<Node> {
        self.live.get(&u64::from(number)).map(|live| live.node)
    }

    /// The nodeid under which a node has that value, one lookup more.
    ///
    /// A value that was not read yet has a nodeid for each thread that looks it up. The size shown for it
    /// shrinks when the kernel sees a READ end early, and only if nobody else's LOOKUP or GETATTR of that
    /// nodeid came in between: shared, the value would be filled up with zero bytes. A thread's own
    /// lookups come before its READ, and `cp` takes a file whose number changes for another one.
    fn enter(&mut self, node: Node, value: Value, thread: u32) -> (u64, SystemTime) {
        if let Some(&number) = self.current.get(&node)
            && let Some(live) = self.live.get_mut(&number)
        {
            // Threads that this process cannot see have the number 0.
            let own = live.thread == thread && thread != 0 && live.waiting.is_none();
            if live.value == value && (own || !matches!(value, Value::Unread(_))) {
                live.lookups += 1;
                return (number, live.since);
            }
            self.retire(number);
        }
        let number = self.next;
        self.next += 1;
        let since = if value == Value::Fixed { self.started } else { SystemTime::now() };
        self.live.insert(number, Live::new(node, value, thread, since));
        self.current.insert(node, number);
        (number, since)
    }

    /// The nodeid no longer stands for the present value.
    fn retire(&mut self, number: u64) {
        let Some(live) = self.live.get_mut(&number) else { return };
        // What was not read yet has promised nothing.
        if !matches!(live.value, Value::Unread(_)) {
            live.superseded.get_or_insert_with(Instant::now);
        }
        if self.current.get(&live.node) == Some(&number) {
            self.current.remove(&live.node);
        }
    }

    /// The value of a nodeid has come, or has not; returns its size, its time, and who waits.
    fn arrived(&mut self, number: u64, value: Option<&Arc<[u8]>>) -> ((u64, SystemTime), Vec<Waiter>) {
        let Some(live) = self.live.get_mut(&number) else { return ((0, self.started), Vec::new()) };
        let waiting = live.waiting.take().unwrap_or_default();
        if let Some(bytes) = value {
            live.value = Value::Bytes(bytes.clone());
        }
        let (node, superseded) = (live.node, live.superseded.is_some());
        let shown = (live.value.size(), live.since);
        if value.is_some() && !superseded {
            // Whoever looks it up next, within this poll, finds what was read.
            if let Some(other) = self.current.get(&node).copied().filter(|&other| other != number) {
                self.retire(other);
            }
            self.current.insert(node, number);
        }
        (shown, waiting)
    }

    fn forget(&mut self, number: u64, lookups: u64) {
        let Some(live) = self.live.get_mut(&number) else { return };
        live.lookups = live.lookups.saturating_sub(lookups);
        if live.lookups == 0 && live.node != Node::Root {
            let node = live.node;
            self.live.remove(&number);
            if self.current.get(&node) == Some(&number) {
                self.current.remove(&node);
            }
        }
    }
}

fn lock(table: &Mutex<Table>) -> MutexGuard<'_, Table> {
    table.lock().expect("no thread panics while it holds the lock")
}

/// A value that was asked for. Whoever waits for it is answered even where its gauge's owner has ended.
struct Arrival {
    adapter: Adapter,
    number: u64,
    node: Node,
    answered: bool,
}

impl Arrival {
    fn with(mut self, read: Result<Arc<[u8]>>) {
        self.answered = true;
        self.answer(&read);
    }

    fn answer(&self, read: &Result<Arc<[u8]>>) {
        let (shown, waiting) = lock(&self.adapter.table).arrived(self.number, read.as_ref().ok());
        for waiter in waiting {
            match (waiter, read) {
                (Waiter::Read { offset, size, reply }, Ok(bytes)) => reply.data(slice(bytes, offset, size)),
                (Waiter::Read { reply, .. }, Err(error)) => reply.error(errno(error)),
                (Waiter::Attributes(reply), _) => {
                    let (size, since) = shown;
                    reply.attr(&Duration::ZERO, &self.adapter.attr(self.number, self.node, size, since));
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

#[derive(Clone)]
struct Adapter {
    fs: Arc<Fs>,
    table: Arc<Mutex<Table>>,
    options: Options,
    answers: Arc<Mutex<Vec<Answer>>>,
    /// Tells by its end that the session has ended.
    _alive: Sender<()>,
}

impl Adapter {
    fn attr(&self, number: u64, node: Node, size: u64, since: SystemTime) -> FileAttr {
        let (kind, nlink) = match self.fs.shape(node) {
            Shape::Folder => (FileType::Directory, 2),
            Shape::Link => (FileType::Symlink, 1),
            Shape::File => (FileType::RegularFile, 1),
        };
        let size = match kind {
            FileType::Symlink => self.fs.target(node).map_or(0, |target| target.len() as u64),
            _ => size,
        };
        let (uid, gid) = self.fs.owner();
        FileAttr {
            ino: INodeNo(number),
            size,
            blocks: 0,
            atime: since,
            mtime: since,
            ctime: since,
            crtime: since,
            kind,
            perm: self.fs.mode(node),
            nlink,
            uid,
            gid,
            rdev: 0,
            blksize: 4096,
            flags: 0,
        }
    }

    fn ttl(&self, node: Node) -> Duration {
        if self.fs.may_be_cached(node) { TTL } else { Duration::ZERO }
    }

    fn attr_ttl(&self, node: Node, value: &Value) -> Duration {
        if matches!(value, Value::Unread(_)) { UNREAD_TTL } else { self.ttl(node) }
    }

    /// The errno of whatever tries to add, remove or rename: there is nothing of the kind here.
    fn fixed(&self) -> Errno {
        if self.options.read_only { Errno::EROFS } else { Errno::EPERM }
    }
}

fn errno(error: &Error) -> Errno {
    Errno::from_i32(error.errno() as i32)
}

fn slice(bytes: &[u8], offset: u64, size: u32) -> &[u8] {
    let start = usize::try_from(offset).unwrap_or(usize::MAX).min(bytes.len());
    &bytes[start..bytes.len().min(start.saturating_add(size as usize))]
}

impl Filesystem for Adapter {
    fn lookup(&self, request: &Request, parent: INodeNo, name: &OsStr, reply: ReplyEntry) {
        let Some(folder) = lock(&self.table).node(parent) else { return reply.error(Errno::ESTALE) };
        let Some(node) = name.to_str().and_then(|name| self.fs.lookup(folder, name)) else {
            return reply.error(Errno::ENOENT);
        };
        // Looked at and entered under one lock: a poll in between has to find what the kernel is told.
        let mut table = lock(&self.table);
        let value = match self.fs.shape(node) {
            Shape::File => Value::of(self.fs.content(node)),
            Shape::Folder | Shape::Link => Some(Value::Fixed),
        };
        let Some(value) = value else { return reply.error(Errno::ENOENT) };
        let (size, ttl) = (value.size(), self.attr_ttl(node, &value));
        let (number, since) = table.enter(node, value, request.pid());
        drop(table);
        reply.entry_with_ttls(&ttl, &self.ttl(node), &self.attr(number, node, size, since), Generation(0));
    }

    fn forget(&self, _: &Request, ino: INodeNo, lookups: u64) {
        lock(&self.table).forget(ino.into(), lookups);
    }

    fn getattr(&self, _: &Request, ino: INodeNo, _: Option<FileHandle>, reply: ReplyAttr) {
        let mut table = lock(&self.table);
        let Some(live) = table.live.get_mut(&u64::from(ino)) else { return reply.error(Errno::ESTALE) };
        if let Some(waiting) = &mut live.waiting {
            // Its size is on its way.
            return waiting.push(Waiter::Attributes(reply));
        }
        let ttl = self.attr_ttl(live.node, &live.value);
        let attr = self.attr(ino.into(), live.node, live.value.size(), live.since);
        drop(table);
        reply.attr(&ttl, &attr);
    }

    /// Truncation alone writes nothing, and the size stays what it is, as in sysfs.
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
        if mode.is_some() || uid.is_some() || gid.is_some() {
            return reply.error(self.fixed());
        }
        let table = lock(&self.table);
        let Some(live) = table.live.get(&u64::from(ino)) else { return reply.error(Errno::ESTALE) };
        if size.is_some() && !self.fs.may_be_written(live.node) {
            return reply.error(Errno::EACCES);
        }
        let attr = self.attr(ino.into(), live.node, live.value.size(), live.since);
        drop(table);
        reply.attr(&Duration::ZERO, &attr);
    }

    fn readlink(&self, _: &Request, ino: INodeNo, reply: ReplyData) {
        let node = lock(&self.table).node(ino);
        match node.and_then(|node| self.fs.target(node)) {
            Some(target) => reply.data(target.as_bytes()),
            None => reply.error(Errno::EINVAL),
        }
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
        let number = u64::from(ino);
        let mut table = lock(&self.table);
        let Some(live) = table.live.get_mut(&number) else { return reply.error(Errno::ESTALE) };
        match &live.value {
            Value::Bytes(bytes) => {
                let bytes = bytes.clone();
                drop(table);
                return reply.data(slice(&bytes, offset, size));
            }
            Value::Gone => return reply.error(Errno::ENODEV),
            Value::Fixed => return reply.error(Errno::EISDIR),
            Value::Unread(_) => {}
        }
        // The first answer is the value of this nodeid, for this read and every other.
        let waiter = Waiter::Read { offset, size, reply };
        if let Some(waiting) = &mut live.waiting {
            return waiting.push(waiter);
        }
        live.waiting = Some(vec![waiter]);
        let node = live.node;
        drop(table);
        let arrival = Arrival { adapter: self.clone(), number, node, answered: false };
        self.fs.read(node, Box::new(move |read| arrival.with(read.map(Arc::from))));
    }

    fn write(
        &self,
        _: &Request,
        ino: INodeNo,
        _: FileHandle,
        offset: u64,
        data: &[u8],
        _: WriteFlags,
        flags: OpenFlags,
        _: Option<LockOwner>,
        reply: ReplyWrite,
    ) {
        let number = u64::from(ino);
        let Some(node) = lock(&self.table).node(ino) else { return reply.error(Errno::ESTALE) };
        let appends = flags.0 & nix::fcntl::OFlag::O_APPEND.bits() != 0;
        if offset != 0 && !appends && !self.fs.is_stream(node) {
            return reply.error(Errno::EINVAL);
        }
        // Whatever comes of it, the kernel's copy now holds what was written.
        let mut table = lock(&self.table);
        table.retire(number);
        if let Some(live) = table.live.get_mut(&number) {
            live.writing += 1;
        }
        drop(table);
        let written = u32::try_from(data.len()).unwrap_or(u32::MAX);
        let (table, answers, fs) = (self.table.clone(), self.answers.clone(), self.fs.clone());
        self.fs.write(
            node,
            data,
            Box::new(move |outcome| {
                let answer = move || {
                    match outcome {
                        Ok(()) => reply.written(written),
                        Err(error) => reply.error(errno(&error)),
                    }
                    let mut table = lock(&table);
                    if let Some(live) = table.live.get_mut(&number) {
                        live.writing -= 1;
                        table.written.push(number);
                    }
                };
                answers.lock().expect("no thread panics while it holds the lock").push(Box::new(answer));
                fs.raise(node);
            }),
        );
    }

    fn readdir(&self, _: &Request, ino: INodeNo, _: FileHandle, offset: u64, mut reply: ReplyDirectory) {
        let Some(folder) = lock(&self.table).node(ino) else { return reply.error(Errno::ESTALE) };
        let dots = [".", ".."].map(|name| (name.to_string(), folder));
        let list = dots.into_iter().chain(self.fs.list(folder));
        for (at, (name, node)) in (1u64..).zip(list).skip(offset as usize) {
            let kind = match self.fs.shape(node) {
                Shape::Folder => FileType::Directory,
                Shape::Link => FileType::Symlink,
                Shape::File => FileType::RegularFile,
            };
            // A file's number changes with its value; here any number but 0 will do.
            if reply.add(INodeNo(at), at, kind, name) {
                break;
            }
        }
        reply.ok();
    }

    fn statfs(&self, _: &Request, _: INodeNo, reply: ReplyStatfs) {
        reply.statfs(0, 0, 0, 0, 0, 4096, 255, 4096);
    }

    fn getxattr(&self, _: &Request, ino: INodeNo, name: &OsStr, size: u32, reply: ReplyXattr) {
        let node = lock(&self.table).node(ino);
        let list = node.map(|node| self.fs.xattrs(node)).unwrap_or_default();
        // ENOSYS would switch extended attributes off for good.
        match list.iter().find(|(found, _)| OsStr::new(found) == name) {
            Some((_, value)) => answer_xattr(value.as_bytes(), size, reply),
            None => reply.error(Errno::ENODATA),
        }
    }

    fn listxattr(&self, _: &Request, ino: INodeNo, size: u32, reply: ReplyXattr) {
        let node = lock(&self.table).node(ino);
        let list = node.map(|node| self.fs.xattrs(node)).unwrap_or_default();
        let names: String = list.iter().flat_map(|(name, _)| [name, "\0"]).collect();
        answer_xattr(names.as_bytes(), size, reply);
    }

    fn setxattr(&self, _: &Request, _: INodeNo, _: &OsStr, _: &[u8], _: i32, _: u32, reply: ReplyEmpty) {
        reply.error(self.fixed());
    }

    fn removexattr(&self, _: &Request, _: INodeNo, _: &OsStr, reply: ReplyEmpty) {
        reply.error(self.fixed());
    }

    // What sysfs refuses as well. Left to the crate, each would leave a warning in the log.

    fn create(&self, _: &Request, _: INodeNo, _: &OsStr, _: u32, _: u32, _: i32, reply: ReplyCreate) {
        reply.error(self.fixed());
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

    /// Asked by whoever wonders whether the file is a terminal.
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

    // What the kernel does by itself once it has heard ENOSYS.

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

    fn lseek(&self, _: &Request, _: INodeNo, _: FileHandle, _: i64, _: i32, reply: ReplyLseek) {
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

/// Tells the kernel which names mean something else now, and answers the writes that brought it about. It
/// holds no lock when it notifies, and waits for nothing that a write holds.
struct Watch {
    fs: Arc<Fs>,
    table: Arc<Mutex<Table>>,
    notifier: Notifier,
    /// The names that each folder held when it was last looked at.
    folders: HashMap<Node, Vec<String>>,
    answers: Arc<Mutex<Vec<Answer>>>,
    renew: Arc<Signal>,
}

impl Watch {
    fn run(&mut self, signal: &Signal) {
        let mut seen = 0;
        loop {
            seen = signal.wait(seen, None);
            let answers =
                std::mem::take(&mut *self.answers.lock().expect("no thread panics while it holds the lock"));
            let announced = self.announce();
            // Who reads right after a write reads what it led to.
            answers.into_iter().for_each(|answer| answer());
            let mut table = lock(&self.table);
            table.over = announced.is_err();
            let superseded = table.live.values().any(|live| live.superseded.is_some());
            let renew = table.over || superseded || !table.written.is_empty();
            drop(table);
            if renew {
                self.renew.raise();
            }
            if announced.is_err() {
                return;
            }
        }
    }

    /// Retires every nodeid whose file holds another text now, then tells the kernel which names those
    /// were. Only the gauges that have changed are looked at: many polls of many gauges come one by one.
    fn announce(&mut self) -> std::io::Result<()> {
        let gauges = self.fs.take_changed();
        let of_them = |node: Node| match node {
            Node::Of(gauge, _) => gauges.contains(&gauge),
            // What the mains do follows from all gauges.
            Node::Mains(_) => !gauges.is_empty(),
            Node::Root | Node::Covered(_) => false,
        };
        let files: Vec<(u64, Node, Value)> = lock(&self.table)
            .live
            .iter()
            .filter(|(_, live)| !matches!(live.value, Value::Fixed | Value::Unread(_)))
            .filter(|(_, live)| live.superseded.is_none() && of_them(live.node))
            .map(|(&number, live)| (number, live.node, live.value.clone()))
            .collect();
        let mut changed = Vec::new();
        for (number, node, value) in files {
            if Value::of(self.fs.content(node)).unwrap_or(Value::Gone) == value {
                continue;
            }
            let mut table = lock(&self.table);
            let folder = table.current.get(&self.fs.parent(node)).copied();
            let named = table.current.get(&node) == Some(&number);
            table.retire(number);
            if let Some(folder) = folder.filter(|_| named) {
                changed.push((folder, node));
            }
        }
        for (folder, node) in changed {
            if let Some(name) = self.fs.file_name(node) {
                gone(self.notifier.inval_entry(INodeNo(folder), OsStr::new(&name)))?;
            }
        }
        self.announce_folders(&gauges)
    }

    /// Listings are kept by the kernel as well; some change when a value comes or goes.
    fn announce_folders(&mut self, gauges: &[u16]) -> std::io::Result<()> {
        for folder in self.fs.changing_folders(gauges) {
            let Some(number) = lock(&self.table).current.get(&folder).copied() else {
                // The kernel does not know it, and lists it anew when it does.
                self.folders.remove(&folder);
                continue;
            };
            let names: Vec<String> = self.fs.list(folder).into_iter().map(|(name, _)| name).collect();
            let before = self.folders.insert(folder, names);
            // What it held when the kernel first heard of it, nobody has looked at.
            if before.is_none() || before.as_ref() != self.folders.get(&folder) {
                gone(self.notifier.inval_inode(INodeNo(number), 0, 0))?;
            }
        }
        Ok(())
    }
}

/// Gives files that are held open their new value, under the nodeid they have. To do so it may have to
/// wait until a read or write of the file is answered. That is up to the file's gauge, so each gauge of
/// which a file was ever held open has a thread that does nothing else.
struct Renewal {
    fs: Arc<Fs>,
    table: Arc<Mutex<Table>>,
    notifier: Notifier,
    threads: HashMap<u16, Sender<u64>>,
}

impl Renewal {
    fn run(&mut self, signal: &Signal) {
        let mut seen = 0;
        let mut due = None;
        loop {
            // Nobody is to be woken while nothing is held open.
            let limit = due.map(|due: Instant| due.saturating_duration_since(Instant::now()));
            seen = signal.wait(seen, limit);
            if lock(&self.table).over {
                return;
            }
            self.renew();
            if self.superseded().is_some() {
                signal.wait(seen, Some(FORGET));
            }
            due = self.superseded().map(|oldest| oldest + SETTLE);
        }
    }

    /// When the oldest of the nodeids that are still in use was superseded. Those that are being read or
    /// written wait for their answer.
    fn superseded(&self) -> Option<Instant> {
        let table = lock(&self.table);
        table.live.values().filter(|live| live.is_idle()).filter_map(|live| live.superseded).min()
    }

    /// Whoever wrote a file reads what came of it; whoever only kept it open, so long after a change.
    fn renew(&mut self) {
        let now = Instant::now();
        let mut due = Vec::new();
        {
            let mut table = lock(&self.table);
            let written = std::mem::take(&mut table.written);
            for (&number, live) in &mut table.live {
                let settled = live.superseded.is_some_and(|since| now >= since + SETTLE);
                if live.is_idle() && (settled || written.contains(&number)) {
                    live.superseded = None;
                    live.value = Value::of(self.fs.content(live.node)).unwrap_or(Value::Gone);
                    live.since = SystemTime::now();
                    due.push((live.node, number));
                }
            }
        }
        for (node, number) in due {
            let Node::Of(gauge, _) = node else { continue };
            let teller = self.threads.entry(gauge).or_insert_with(|| teller(self.notifier.clone()));
            // It ends with this one, unless the machine has no thread left.
            if teller.send(number).is_err() {
                self.threads.remove(&gauge);
            }
        }
    }
}

/// A thread that tells the kernel of nodeids that have another value now.
fn teller(notifier: Notifier) -> Sender<u64> {
    let (tell, told) = mpsc::channel();
    let run = move || {
        for number in told {
            // It may have been forgotten meanwhile; then there is nobody to tell.
            let _ = notifier.inval_inode(INodeNo(number), 0, 0);
        }
    };
    if let Err(error) = thread("renew", run) {
        log::warn!("files that are held open may not follow: {error}");
    }
    tell
}

/// ENOENT says that the kernel does not have the name; anything else, that the mount is over.
fn gone(notified: std::io::Result<()>) -> std::io::Result<()> {
    match notified {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
