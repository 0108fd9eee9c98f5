// SPDX-License-Identifier: MIT

//! The thread that notifies the kernel that files have a new value.
//!
//! # Why the daemon can always end
//!
//! A notification is a write(2) to `/dev/fuse`. Some of them wait in the kernel for a lock that a request holds
//! until the daemon has answered it. If the daemon is killed in that moment, the request is never answered; nor
//! does the kernel abort it, because the waiting thread, which no signal can end, keeps `/dev/fuse` open. Only
//! notifications that wait for nothing are sent:
//!
//! | notification | waits for | |
//! | --- | --- | --- |
//! | `inval_inode` of a file | its pages; a READ or WRITE locks one until it is answered | not sent; see `getattr` in `adapter` |
//! | `inval_entry` | the lock of the folder, which a LOOKUP holds until it is answered | not sent |
//! | `inval_inode` of a folder, without its pages | nothing | when its listing has changed |
//! | `inval_inode` of a file, without its pages | nothing | when its value has changed, and the kernel would trust its time for longer than it shows the old one |
//! | `FUSE_NOTIFY_INC_EPOCH` | nothing | when the kernel may still keep the name of an old value |
//!
//! The last one makes the kernel look up every name again, and read what they name, also of other gauges. So names of many
//! gauges are given until the gauge's next poll only, and then nothing has to be sent. Linux has it since 6.16; an older one may not keep the
//! names of files at all, so that it sends a LOOKUP each time a file is opened.

use std::cell::Cell;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

use fuser::{INodeNo, Notifier};

use super::entry::Device;
use super::inodes::{self, Now, Outdated};
use super::{Shared, Table, host, lock, present};
use crate::error::{Cause, Error, Result};
use crate::fs::{Fs, Node};
use gauge_owner::Signal;

/// The notification that makes the kernel look up every name again.
const FUSE_NOTIFY_INC_EPOCH: u32 = 8;

/// An answer to a LOOKUP that was given before a notification has arrived by then.
const ON_THE_WAY: Duration = Duration::from_secs(1);

/// The answer to a write, given when the kernel knows everything that the write changed.
pub(super) type Answer = Box<dyn FnOnce() + Send>;

/// Controls the thread that notifies the kernel.
#[derive(Clone)]
pub struct Announcer {
    queue: Arc<Mutex<Queue>>,
    signal: Arc<Signal>,
    pub(super) device: Device,
    /// The kernel keeps names.
    keeps_names: Arc<AtomicBool>,
    /// The daemon is ending. Locked while a request is passed on to a gauge's owner.
    ending: Arc<Mutex<bool>>,
}

#[derive(Default)]
pub(super) struct Queue {
    answers: Vec<Answer>,
    /// The thread ends after these answers.
    stopping: bool,
    stopped: bool,
}

impl Queue {
    /// Returns the answer if the thread has ended.
    pub(super) fn add(&mut self, answer: Answer, stopping: bool) -> Option<Answer> {
        if self.stopped {
            return Some(answer);
        }
        self.stopping |= stopping;
        self.answers.push(answer);
        None
    }

    fn take(&mut self) -> (Vec<Answer>, bool) {
        (std::mem::take(&mut self.answers), self.stopping)
    }
}

/// The thread's work: whenever woken it announces changes, and then gives the answers that waited before, so that a
/// read right after a write gets the write's result.
pub(super) fn serve(queue: &impl Shared<Queue>, mut wait: impl FnMut(), mut announce: impl FnMut()) {
    loop {
        wait();
        let (answers, stopping) = queue.with(Queue::take);
        announce();
        answers.into_iter().for_each(|answer| answer());
        if stopping {
            return;
        }
    }
}

/// The thread has ended. No write stays without an answer, however that came.
pub(super) fn end(queue: &impl Shared<Queue>) {
    let answers = queue.with(|queue| {
        queue.stopped = true;
        queue.take().0
    });
    answers.into_iter().for_each(|answer| answer());
}

impl Announcer {
    /// An announcer without a thread; `signal` wakes it.
    pub(super) fn new(signal: Arc<Signal>) -> Self {
        let (queue, device, ending) = Default::default();
        Self { queue, signal, device, keeps_names: Arc::default(), ending }
    }

    /// Lets the kernel keep names of files, if it can be told when they are outdated.
    pub(super) fn keep_names(&self) {
        match look_up_again(&self.device) {
            Ok(()) => self.keeps_names.store(true, Ordering::Relaxed),
            Err(_) => log::info!("Linux 6.16 and later read attributes faster"),
        }
    }

    pub(super) fn keeps_names(&self) -> bool {
        self.keeps_names.load(Ordering::Relaxed)
    }

    /// Starts the thread before the first request is answered. It ends after the session.
    pub(super) fn start(&self, fs: Arc<Fs>, table: Arc<Table>, notifier: Notifier) -> Result<()> {
        // The kernel knows no mode of a folder until its first GETATTR is answered, and drops an answer that a
        // notification overtakes, which refuses ordinary users. So none is sent before the folder was listed.
        let (announcer, dropped) = (self.clone(), Vec::new());
        let mut announcing = Announcing { fs, table, notifier, announcer, dropped };
        let builder = std::thread::Builder::new().name("notify".into()).stack_size(128 * 1024);
        let started = builder.spawn(move || announcing.run());
        started.map(drop).map_err(|error| host("a thread", &error))
    }

    /// Gives an answer when the kernel knows everything that has changed until now.
    pub(super) fn answer(&self, answer: Answer) {
        match self.add(answer, false) {
            Some(answer) => answer(),
            None => self.signal.raise(),
        }
    }

    /// Refuses later writes, and later reads of values from a gauge.
    pub fn refuse(&self) {
        *lock(&self.ending) = true;
    }

    /// Passes a request to a gauge's owner, or refuses it because the daemon is ending. A passed request comes before
    /// what the daemon sends to the owner after [`Self::refuse`].
    pub(super) fn pass_on(&self, request: impl FnOnce(Option<Error>)) {
        let ending = lock(&self.ending);
        let why = "gaugefs is ending, so nothing was sent; mount again and try again";
        request(ending.then(|| Error::new("", Cause::NotNow, why)));
    }

    /// Gives the waiting answers. When it returns, no notification is under way or will follow.
    pub fn stop(&self) {
        let (last, is_given) = mpsc::channel::<()>();
        self.add(Box::new(move || drop(last)), true);
        self.signal.raise();
        // Nothing is sent: the channel disconnects with the last answer.
        let _ = is_given.recv();
    }

    /// Makes the thread give the waiting answers and end.
    pub(super) fn close(&self) {
        lock(&self.queue).stopping = true;
        self.signal.raise();
    }

    /// Returns the answer if the thread has ended.
    fn add(&self, answer: Answer, stopping: bool) -> Option<Answer> {
        lock(&self.queue).add(answer, stopping)
    }
}

struct Announcing {
    fs: Arc<Fs>,
    table: Arc<Table>,
    notifier: Notifier,
    announcer: Announcer,
    /// Nodeids whose attributes are dropped once more, and when.
    dropped: Vec<(Instant, Vec<u64>)>,
}

impl Drop for Announcing {
    fn drop(&mut self) {
        end(&*self.announcer.queue);
    }
}

impl Announcing {
    fn run(&mut self) {
        let (mut seen, queue, signal) = (0, self.announcer.queue.clone(), self.announcer.signal.clone());
        let limit = Cell::new(None);
        let wait = || seen = signal.wait(seen, limit.get());
        serve(&*queue, wait, || {
            // After a panic the kernel is told of these values with the next ones.
            if catch_unwind(AssertUnwindSafe(|| self.announce())).is_err() {
                self.fs.report_defect(None);
            }
            limit.set(self.drop_again());
        });
    }

    /// Retires every nodeid whose file has another value now, then notifies the kernel if it keeps one of their names.
    /// Looks only at changed gauges, because many gauges are polled one after the other.
    fn announce(&mut self) {
        let gauges = self.announcer.signal.take_changed();
        // The Mains supply follows from all gauges.
        let mains = (!gauges.is_empty()).then(Node::of_mains);
        let places: Vec<_> = gauges.iter().map(|&gauge| Node::of_gauge(gauge)).chain(mains).collect();
        let Outdated { names, attributes } =
            inodes::retire_outdated(&*self.table, &places, |node| present(&self.fs, node), Now::read);
        if names
            && self.announcer.keeps_names()
            && let Err(error) = look_up_again(&self.announcer.device)
        {
            self.announcer.keeps_names.store(false, Ordering::Relaxed);
            log::warn!("cannot notify the kernel ({error}): values may lag by a minute");
        }
        self.drop_attributes(&attributes);
        if !attributes.is_empty() {
            self.dropped.push((Instant::now() + ON_THE_WAY, attributes));
        }
        self.announce_folders(&gauges);
    }

    /// Makes readers of open files ask for their attributes before the next read.
    fn drop_attributes(&self, numbers: &[u64]) {
        for &number in numbers {
            // It fails if the kernel does not know the nodeid.
            let _ = self.notifier.inval_inode(INodeNo(number), -1, 0);
        }
    }

    /// Drops attributes again that may have been on their way to the kernel. Returns for how long there is nothing to drop.
    fn drop_again(&mut self) -> Option<Duration> {
        let now = Instant::now();
        while let Some((due, _)) = self.dropped.first() {
            if *due > now {
                return Some(*due - now);
            }
            let (_, numbers) = self.dropped.remove(0);
            self.drop_attributes(&numbers);
        }
        None
    }

    /// The kernel also keeps listings; some change when a value appears or disappears. It drops a listing after a
    /// change of the folder's time.
    fn announce_folders(&mut self, gauges: &[u16]) {
        for folder in self.fs.changing_folders(gauges) {
            if !lock(&self.table).is_listed(folder) {
                // The kernel has not asked for the names.
                continue;
            }
            let is_outdated = lock(&self.table).has_rested(folder, Now::read()) || {
                let names = hash(&self.fs.list(folder));
                lock(&self.table).has_outdated(folder, names, Now::read())
            };
            if is_outdated {
                // It fails if the kernel has forgotten the folder. Without an offset, only what `stat` shows becomes
                // invalid; the listing's pages stay, so nothing waits for them.
                let _ = self.notifier.inval_inode(INodeNo(folder.place().into()), -1, 0);
            }
        }
    }
}

/// A hash of a listing, to notice changes.
pub(super) fn hash(names: &[(String, Node)]) -> u64 {
    let mut hasher = DefaultHasher::new();
    names.hash(&mut hasher);
    hasher.finish()
}

/// Makes the kernel look up every name again before using it. The crate `fuser` lacks this notification.
fn look_up_again(device: &Device) -> std::io::Result<()> {
    // struct fuse_out_header: length, code, and 0 in place of a request's number.
    let mut message = [0; 16];
    message[..4].copy_from_slice(&16_u32.to_ne_bytes());
    message[4..8].copy_from_slice(&FUSE_NOTIFY_INC_EPOCH.to_ne_bytes());
    device.write(&message)
}
