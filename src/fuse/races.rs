// SPDX-License-Identifier: MIT

//! Schedules of a mount's threads: owners that publish, the thread that notifies, and the kernel that looks up, reads,
//! writes and forgets. The table of nodeids and the queue of answers are the real ones; the crate `shuttle` chooses
//! from a seed whose turn it is at each lock. GAUGEFS_SEEDS sets the number of schedules, GAUGEFS_SEED the first one.
//!
//! The kernel of these tests keeps a name as Linux does, with the epoch of its request, so that a name requested before
//! a notification is not used after it.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use shuttle::scheduler::{PctScheduler, RandomScheduler};
use shuttle::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use shuttle::sync::{Condvar, Mutex};
use shuttle::{Config, Runner, thread};

use super::Shared;
use super::inodes::{self, Inodes, Now, RENEWAL_DELAY, Sharing, Value};
use super::notify::{Queue, end, serve};
use crate::fs::{DfItem, Item, Node};

/// Schedules of each test in the everyday run.
const SCHEDULES: usize = 300;
/// Schedules with a fixed number of switches to another thread.
const SWITCHES: usize = 3;

/// How long the kernel may keep a name.
const KEPT: Duration = Duration::from_secs(2);

const FILE: Node = Node::Of(0, Item::Df(DfItem::Raw(0)));

impl<T> Shared<T> for Mutex<T> {
    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        work(&mut self.lock().expect("no panic"))
    }
}

/// A gauge, its mount, and what the kernel knows of the latter.
struct World {
    start: Instant,
    /// Milliseconds since then.
    passed: AtomicU64,
    /// The value of the file, which its owner replaces.
    published: Mutex<u64>,
    changed: AtomicBool,
    /// As `gauge_owner::Signal`.
    count: Mutex<u64>,
    raised: Condvar,
    table: Mutex<Inodes<u64>>,
    queue: Mutex<Queue>,
    /// The kernel's, which a notification counts up.
    epoch: AtomicU64,
    /// A name that the kernel keeps: its nodeid, and the epoch before it asked.
    kept: Mutex<Option<(u64, u64)>>,
    given: AtomicU64,
}

fn bytes(value: u64) -> Value {
    Value::Bytes(value.to_string().into_bytes().into())
}

impl World {
    fn new() -> Arc<Self> {
        let start = Instant::now();
        let now = Now { instant: start, time: SystemTime::UNIX_EPOCH };
        Arc::new(Self {
            start,
            passed: AtomicU64::new(0),
            published: Mutex::new(0),
            changed: AtomicBool::new(false),
            count: Mutex::new(0),
            raised: Condvar::new(),
            table: Mutex::new(Inodes::new(now)),
            queue: Mutex::new(Queue::default()),
            epoch: AtomicU64::new(0),
            kept: Mutex::new(None),
            given: AtomicU64::new(0),
        })
    }

    fn now(&self) -> Now {
        let passed = Duration::from_millis(self.passed.load(Ordering::SeqCst));
        Now { instant: self.start + passed, time: SystemTime::UNIX_EPOCH + passed }
    }

    fn present(&self) -> Value {
        bytes(*self.published.lock().expect("no panic"))
    }

    fn raise(&self) {
        *self.count.lock().expect("no panic") += 1;
        self.raised.notify_all();
    }

    /// As `gauge_owner`'s owner publishes.
    fn publish(&self, value: u64) {
        *self.published.lock().expect("no panic") = value;
        self.changed.store(true, Ordering::SeqCst);
        self.raise();
    }

    /// The thread that notifies, until it is told to end.
    fn notify(&self) {
        let mut seen = 0;
        let wait = || {
            let mut count = self.count.lock().expect("no panic");
            while *count == seen {
                count = self.raised.wait(count).expect("no panic");
            }
            seen = *count;
        };
        serve(&self.queue, wait, || {
            let changed = self.changed.swap(false, Ordering::SeqCst);
            let outdated = inodes::retire_outdated(
                &self.table,
                if changed { &[0..=u32::MAX] } else { &[] },
                |_| self.present(),
                || self.now(),
            );
            if outdated.names {
                self.epoch.fetch_add(1, Ordering::SeqCst);
            }
        });
        end(&self.queue);
    }

    fn look_up(&self, sharing: Sharing) -> u64 {
        let shown = inodes::look_up(&self.table, FILE, || Some(self.present()), (sharing, KEPT), self.now());
        shown.expect("the file exists").number
    }

    /// What the kernel does when a file is opened: it uses the name that it keeps, or asks. Of those who need a name at the
    /// same time, one asks for it and the others wait. Returns the nodeid.
    fn open(&self) -> u64 {
        let mut name = self.kept.lock().expect("no panic");
        let epoch = self.epoch.load(Ordering::SeqCst);
        if let Some((number, _)) = name.filter(|(_, at)| *at == epoch) {
            return number;
        }
        let number = self.look_up(Sharing::All);
        if let Some((old, _)) = name.replace((number, epoch))
            && old != number
        {
            drop(name);
            self.table.with(|inodes| inodes.forget(old, 1));
        }
        number
    }

    /// The value of a nodeid, as a READ answers it: the bytes that it had when it was looked up.
    fn read(&self, number: u64) -> Option<u64> {
        let value = self.table.with(|inodes| inodes.get(number).map(|inode| inode.value().clone()));
        match value? {
            Value::Bytes(bytes) => Some(String::from_utf8_lossy(&bytes).parse().expect("a number")),
            _ => None,
        }
    }

    fn add(&self, answer: impl FnOnce() + Send + 'static) {
        match self.queue.with(|queue| queue.add(Box::new(answer), false)) {
            Some(answer) => answer(),
            None => self.raise(),
        }
    }

    /// Ends the thread that notifies, after everything that was given to it.
    fn stop(&self) {
        let refused = self.queue.with(|queue| queue.add(Box::new(|| ()), true));
        assert!(refused.is_none(), "it runs");
        self.raise();
    }
}

/// Runs a test in as many schedules as are asked for, half of them with few switches between threads.
fn explore(test: impl Fn() + Send + Sync + Copy + 'static) {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    let seed = number("GAUGEFS_SEED").unwrap_or(1);
    let count = number("GAUGEFS_SEEDS").map_or(SCHEDULES, |count| count as usize);
    let config = Config::new;
    Runner::new(RandomScheduler::new_from_seed(seed, count.div_ceil(2)), config()).run(test);
    Runner::new(PctScheduler::new_from_seed(seed, SWITCHES, count.div_ceil(2)), config()).run(test);
    println!("{count} schedules from seed {seed}");
}

/// While values are published, a nodeid that is read twice has one value; and when all is told, the name that the kernel
/// keeps is that of the last value.
#[test]
fn readers_of_a_file_that_changes() {
    explore(|| {
        let world = World::new();
        let notifier = thread::spawn({
            let world = world.clone();
            move || world.notify()
        });
        let readers: Vec<_> = (0..2)
            .map(|_| {
                let world = world.clone();
                thread::spawn(move || {
                    for _ in 0..3 {
                        // A nodeid may be forgotten before it is read; then the kernel looks it up again.
                        let number = world.open();
                        let Some(value) = world.read(number) else { continue };
                        assert!(value <= 2, "{value} was never published");
                        assert!(
                            world.read(number).is_none_or(|again| again == value),
                            "a nodeid has two values"
                        );
                    }
                })
            })
            .collect();
        for value in 1..=2 {
            world.publish(value);
        }
        readers.into_iter().for_each(|reader| reader.join().expect("no panic"));
        world.stop();
        notifier.join().expect("no panic");
        let number = world.open();
        assert_eq!(world.read(number), Some(2), "the kernel keeps the name of an old value");
    });
}

/// A writer whose write was answered reads what it has written, or what came after it; a reader that opens the file then
/// does, too. Each write is answered once.
#[test]
fn writers_and_readers() {
    explore(|| {
        let world = World::new();
        let notifier = thread::spawn({
            let world = world.clone();
            move || world.notify()
        });
        let writers: Vec<_> = [1, 2]
            .map(|value| {
                let world = world.clone();
                thread::spawn(move || {
                    let number = world.look_up(Sharing::Alone);
                    world.table.with(|inodes| inodes.write_begins(number, world.now()));
                    // Time passes in which the nodeid must not be renewed.
                    world.passed.fetch_add(RENEWAL_DELAY.as_millis() as u64, Ordering::SeqCst);
                    world.publish(value);
                    let (done, answered) = shuttle::sync::mpsc::channel();
                    let mount = world.clone();
                    world.add(move || {
                        inodes::end_write(&mount.table, number, || mount.present(), mount.now());
                        mount.given.fetch_add(1, Ordering::SeqCst);
                        let _ = done.send(());
                    });
                    answered.recv().expect("an answer");
                    // Ask as GETATTR does before a read.
                    let due = world.table.with(|inodes| inodes.due(number, world.now()));
                    if due.is_some() {
                        world.table.with(|inodes| inodes.renew(number, world.present(), world.now()));
                    }
                    assert!(world.read(number).is_some_and(|read| read == 1 || read == 2), "an old value");
                    let other = world.look_up(Sharing::Alone);
                    assert_ne!(world.read(other), Some(0), "an old value");
                    world.table.with(|inodes| inodes.forget(number, 1));
                })
            })
            .into();
        let reader = thread::spawn({
            let world = world.clone();
            move || {
                let number = world.open();
                let before = world.read(number);
                assert!(world.read(number).is_none() || world.read(number) == before || before.is_none());
            }
        });
        writers.into_iter().chain([reader]).for_each(|each| each.join().expect("no panic"));
        world.stop();
        notifier.join().expect("no panic");
        assert_eq!(world.given.load(Ordering::SeqCst), 2, "each write is answered once");
    });
}

/// The thread that notifies is ended while writes are answered: each is answered once, before its end or after it.
#[test]
fn an_end_amid_writes() {
    explore(|| {
        let world = World::new();
        let notifier = thread::spawn({
            let world = world.clone();
            move || world.notify()
        });
        let writers: Vec<_> = (0..3)
            .map(|_| {
                let world = world.clone();
                thread::spawn(move || {
                    let (done, answered) = shuttle::sync::mpsc::channel();
                    let mount = world.clone();
                    world.add(move || {
                        mount.given.fetch_add(1, Ordering::SeqCst);
                        let _ = done.send(());
                    });
                    answered.recv().expect("an answer");
                })
            })
            .collect();
        world.publish(1);
        world.stop();
        writers.into_iter().for_each(|writer| writer.join().expect("no panic"));
        notifier.join().expect("no panic");
        assert_eq!(world.given.load(Ordering::SeqCst), 3);
    });
}
