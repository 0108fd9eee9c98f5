//! The threads that notify the kernel: of names that have a new value, and of nodeids that were renewed.
//!
//! They hold no lock while they notify. The kernel may have to wait for the answer to a request before it
//! takes the notification, and the handler of that request needs the locks.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use fuser::{INodeNo, Notifier};

use super::inodes::{Now, Value};
use super::{Table, lock, thread};
use crate::fs::{Fs, Node};
use crate::owner::Signal;

/// Time within which the kernel forgets a nodeid that nobody holds open.
const FORGET: Duration = Duration::from_millis(30);

/// Time limit for the last answers, each of which is one message to the kernel.
const FLUSH: Duration = Duration::from_secs(2);

/// An answer to a write, given when the kernel has been notified of everything that the write changed.
pub(super) type Answer = Box<dyn FnOnce() + Send>;

/// The answers to writes that wait until the kernel has been notified of what was changed.
#[derive(Clone)]
pub struct Answers {
    answers: Arc<Mutex<Vec<Answer>>>,
    signal: Arc<Signal>,
}

impl Answers {
    /// No answers; `signal` wakes the thread that gives them.
    pub(super) fn new(signal: Arc<Signal>) -> Self {
        Self { answers: Arc::default(), signal }
    }

    /// Adds one. The caller has to raise the signal.
    pub(super) fn push(&self, answer: Answer) {
        lock(&self.answers).push(answer);
    }

    fn take(&self) -> Vec<Answer> {
        std::mem::take(&mut lock(&self.answers))
    }

    /// Returns when all of them have been given, or after a time limit if the tree is unmounted.
    pub fn flush(&self) {
        let (done, is_done) = mpsc::channel::<()>();
        self.push(Box::new(move || drop(done)));
        self.signal.raise();
        // Nothing is sent: the channel disconnects when its answer's turn comes.
        let _ = is_done.recv_timeout(FLUSH);
    }
}

/// Notifies the kernel of the names whose value changed, then answers the writes that changed them.
pub(super) struct Announcer {
    fs: Arc<Fs>,
    table: Arc<Table>,
    notifier: Notifier,
    answers: Answers,
    renewals: Arc<Renewals>,
    /// The names that each folder held at the last look.
    folders: HashMap<Node, Vec<String>>,
}

/// What the [`Announcer`] passes to the [`Renewer`].
#[derive(Default)]
struct Renewals {
    signal: Signal,
    /// The tree is unmounted.
    over: AtomicBool,
}

/// Starts the threads. They end when the tree is unmounted.
pub(super) fn start(
    fs: Arc<Fs>,
    table: Arc<Table>,
    notifier: Notifier,
    answers: Answers,
) -> crate::error::Result<()> {
    let renewals = Arc::new(Renewals::default());
    let mut renewer = Renewer {
        fs: fs.clone(),
        table: table.clone(),
        notifier: notifier.clone(),
        renewals: renewals.clone(),
        gauges: HashMap::new(),
    };
    let mut announcer = Announcer { fs, table, notifier, answers, renewals, folders: HashMap::new() };
    thread("notify", move || announcer.run())?;
    thread("renew", move || renewer.run())
}

impl Announcer {
    fn run(&mut self) {
        let mut seen = 0;
        loop {
            seen = self.answers.signal.wait(seen, None);
            let answers = self.answers.take();
            let announced = self.announce();
            // Only now, so that whoever reads right after a write gets the result of the write.
            answers.into_iter().for_each(|answer| answer());
            if announced.is_err() {
                self.renewals.over.store(true, Ordering::SeqCst);
            }
            if announced.is_err() || lock(&self.table).is_renewal_pending() {
                self.renewals.signal.raise();
            }
            if announced.is_err() {
                return;
            }
        }
    }

    /// Retires every nodeid whose file has another value now, then notifies the kernel of their names. Looks
    /// only at the gauges that have changed, because many gauges are polled one after the other.
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
            if self.value(node) == value {
                continue;
            }
            let mut inodes = lock(&self.table);
            let folder = inodes.current(self.fs.parent(node));
            let named = inodes.current(node) == Some(number);
            inodes.retire(number, Now::read());
            if let Some(folder) = folder.filter(|_| named) {
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

    fn value(&self, node: Node) -> Value {
        Value::of(self.fs.content(node)).unwrap_or(Value::Gone)
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

/// Shows files that are held open their new value, under the nodeid that they have. The kernel takes such a
/// notification only when no read or write of the file is under way. Those wait for the file's gauge, so each
/// gauge has a thread of its own that waits for them.
struct Renewer {
    fs: Arc<Fs>,
    table: Arc<Table>,
    notifier: Notifier,
    renewals: Arc<Renewals>,
    gauges: HashMap<u16, Sender<u64>>,
}

impl Renewer {
    fn run(&mut self) {
        let signal = &self.renewals.clone().signal;
        let mut seen = 0;
        let mut due = None;
        loop {
            // Without a limit while no file is held open across a change, so that nothing wakes the machine.
            let limit = due.map(|due: Instant| due.saturating_duration_since(Instant::now()));
            seen = signal.wait(seen, limit);
            if self.renewals.over.load(Ordering::SeqCst) {
                return;
            }
            self.renew();
            // Most superseded nodeids are not held open, and are forgotten at once.
            if lock(&self.table).next_due().is_some() {
                signal.wait(seen, Some(FORGET));
            }
            due = lock(&self.table).next_due();
        }
    }

    fn renew(&mut self) {
        let now = Now::read();
        let mut inodes = lock(&self.table);
        let due = inodes.take_due(now);
        for &(number, node) in &due {
            let value = Value::of(self.fs.content(node)).unwrap_or(Value::Gone);
            inodes.renew(number, value, now);
        }
        drop(inodes);
        for (number, node) in due {
            let Node::Of(gauge, _) = node else { continue };
            let notify = self.gauges.entry(gauge).or_insert_with(|| inval_inodes(self.notifier.clone()));
            // Fails if the thread could not be started; try again with the next file.
            if notify.send(number).is_err() {
                self.gauges.remove(&gauge);
            }
        }
    }
}

/// A thread that notifies the kernel of nodeids that have another value now.
fn inval_inodes(notifier: Notifier) -> Sender<u64> {
    let (sender, numbers) = mpsc::channel();
    let run = move || {
        for number in numbers {
            // It may fail because the nodeid has been forgotten in the meantime.
            let _ = notifier.inval_inode(INodeNo(number), 0, 0);
        }
    };
    if let Err(error) = thread("renew", run) {
        log::warn!("files that are held open may not follow: {error}");
    }
    sender
}

/// ENOENT means that the kernel does not know the name; any other error, that the tree is unmounted.
fn ignore_unknown(notified: std::io::Result<()>) -> std::io::Result<()> {
    match notified {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
