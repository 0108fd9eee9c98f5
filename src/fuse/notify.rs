//! The thread that notifies the kernel of names that have a new value.
//!
//! It holds no lock while it notifies: the kernel may need the answer to a request before it takes the
//! notification, and the handler of that request needs the locks.
//!
//! # Why the daemon can always end
//!
//! A notification is a write(2) to `/dev/fuse` that waits for locks in the kernel and cannot be killed. If a
//! request holds such a lock until it is answered, and the daemon is killed, both wait for ever: the request
//! is never answered, and it is not aborted either, because the thread in the write(2) keeps `/dev/fuse` open.
//! Therefore:
//!
//! - `inval_inode` is never sent for a file. It waits for the file's pages, and a page stays locked from the
//!   moment the kernel queues a READ or WRITE until the answer, which can take the gauge seconds. Not even
//!   files without a known request are safe, because the next write(2) may be in the queue already. A file
//!   that is held open gets its new value without a notification, see `getattr` in `adapter`.
//! - What is sent, `inval_entry` and `inval_inode` for a folder, waits only for the folder's lock. The kernel
//!   holds it during LOOKUP, READDIR and attempts to change the folder, which the handlers answer at once;
//!   they wait neither for a gauge nor for this thread.
//! - Before the daemon ends, it calls [`Announcer::stop`] while the handlers still work.
//!
//! What remains is a SIGKILL in the microseconds in which a notification waits for such a handler. To make that
//! rarer still, names that the kernel does not keep are not announced.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::sync::mpsc;
use std::sync::{Arc, Mutex};

use fuser::{INodeNo, Notifier};

use super::adapter::present;
use super::inodes::{Now, Value};
use super::{Table, host, lock};
use crate::error::Result;
use crate::fs::{Fs, Node};
use crate::owner::Signal;

/// An answer to a write, given when the kernel has been notified of everything that the write changed.
pub(super) type Answer = Box<dyn FnOnce() + Send>;

/// Controls the thread that notifies the kernel.
#[derive(Clone)]
pub struct Announcer {
    queue: Arc<Mutex<Queue>>,
    signal: Arc<Signal>,
}

#[derive(Default)]
struct Queue {
    answers: Vec<Answer>,
    /// The thread has to end after these answers.
    stopping: bool,
    /// The thread has ended.
    stopped: bool,
}

impl Announcer {
    /// One whose thread has not been started; `signal` wakes it.
    pub(super) fn new(signal: Arc<Signal>) -> Self {
        Self { queue: Arc::default(), signal }
    }

    /// Starts the thread. It ends when the tree is unmounted.
    pub(super) fn start(&self, fs: Arc<Fs>, table: Arc<Table>, notifier: Notifier) -> Result<()> {
        let mut announcing =
            Announcing { fs, table, notifier, announcer: self.clone(), folders: HashMap::new() };
        let builder = std::thread::Builder::new().name("notify".into()).stack_size(128 * 1024);
        let started = builder.spawn(move || announcing.run());
        started.map(drop).map_err(|error| host("a thread", &error))
    }

    /// Gives an answer when the kernel has been notified of everything that has changed until now. The caller
    /// has to raise the signal.
    pub(super) fn answer(&self, answer: Answer) {
        if let Some(answer) = self.add(answer, false) {
            answer();
        }
    }

    /// Gives the answers that are waiting. When it returns, no notification is under way, and none will follow.
    pub fn stop(&self) {
        let (last, is_given) = mpsc::channel::<()>();
        self.add(Box::new(move || drop(last)), true);
        self.signal.raise();
        // Nothing is sent: the channel disconnects when the last answer is given.
        let _ = is_given.recv();
    }

    /// Returns the answer if the thread has ended.
    fn add(&self, answer: Answer, stopping: bool) -> Option<Answer> {
        let mut queue = lock(&self.queue);
        if queue.stopped {
            return Some(answer);
        }
        queue.stopping |= stopping;
        queue.answers.push(answer);
        None
    }

    fn take(&self) -> (Vec<Answer>, bool) {
        let mut queue = lock(&self.queue);
        (std::mem::take(&mut queue.answers), queue.stopping)
    }
}

/// The thread.
struct Announcing {
    fs: Arc<Fs>,
    table: Arc<Table>,
    notifier: Notifier,
    announcer: Announcer,
    /// The names that each folder held at the last look.
    folders: HashMap<Node, Vec<String>>,
}

/// However the thread ends, no write is left without an answer.
impl Drop for Announcing {
    fn drop(&mut self) {
        lock(&self.announcer.queue).stopped = true;
        self.announcer.take().0.into_iter().for_each(|answer| answer());
    }
}

impl Announcing {
    fn run(&mut self) {
        let mut seen = 0;
        loop {
            seen = self.announcer.signal.wait(seen, None);
            let (answers, stopping) = self.announcer.take();
            let announced = self.announce();
            // Only now, so that whoever reads right after a write gets the result of the write.
            answers.into_iter().for_each(|answer| answer());
            if stopping || announced.is_err() {
                return;
            }
        }
    }

    /// Retires every nodeid whose file has another value now, then notifies the kernel of the names that it
    /// keeps. Looks only at the gauges that have changed, because many gauges are polled one after the other.
    fn announce(&mut self) -> std::io::Result<()> {
        let gauges = self.fs.take_changed();
        let has_changed = |node: Node| match node {
            Node::Of(gauge, _) => gauges.contains(&gauge),
            // The Mains supply's values follow from all gauges.
            Node::Mains(_) => !gauges.is_empty(),
            Node::Root | Node::Covered(_) => false,
        };
        let files: Vec<(u64, Node, Value)> = lock(&self.table)
            .up_to_date()
            .filter(|(_, node, _)| has_changed(*node))
            .map(|(number, node, value)| (number, node, value.clone()))
            .collect();
        let mut changed = Vec::new();
        for (number, node, value) in files {
            if present(&self.fs, node) == value {
                continue;
            }
            let mut inodes = lock(&self.table);
            let folder = inodes.current(self.fs.parent(node));
            // The kernel asks for other names each time they are used.
            let kept = inodes.current(node) == Some(number) && self.fs.may_be_cached(node);
            inodes.retire(number, Now::read());
            if let Some(folder) = folder.filter(|_| kept) {
                changed.push((folder, node));
            }
        }
        for (folder, node) in changed {
            if let Some(name) = self.fs.file_name(node) {
                ignore_unknown(self.notifier.inval_entry(INodeNo(folder), OsStr::new(&name)))?;
            }
        }
        self.announce_folders(&gauges)
    }

    /// The kernel keeps listings as well; some change when a value appears or disappears.
    fn announce_folders(&mut self, gauges: &[u16]) -> std::io::Result<()> {
        for folder in self.fs.changing_folders(gauges) {
            let Some(number) = lock(&self.table).current(folder) else {
                // The kernel does not know it, and will ask for a new listing when it does.
                self.folders.remove(&folder);
                continue;
            };
            let names: Vec<String> = self.fs.list(folder).into_iter().map(|(name, _)| name).collect();
            let before = self.folders.insert(folder, names);
            // The first time there is nothing to compare with: the listing may have changed since the kernel
            // asked for it.
            if before.is_none() || before.as_ref() != self.folders.get(&folder) {
                ignore_unknown(self.notifier.inval_inode(INodeNo(number), 0, 0))?;
            }
        }
        Ok(())
    }
}

/// ENOENT means that the kernel does not know the name; any other error, that the tree is unmounted.
fn ignore_unknown(notified: std::io::Result<()>) -> std::io::Result<()> {
    match notified {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
