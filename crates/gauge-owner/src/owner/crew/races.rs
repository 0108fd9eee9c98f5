// SPDX-License-Identifier: MIT

//! Schedules of the threads in which owners work. The crew is the real one; whose turn it is when its lock is taken, or a
//! thread is started or woken, is chosen by the crate `shuttle`, from a seed. GAUGEFS_SEEDS sets how many schedules there
//! are, GAUGEFS_SEED which is the first one.
//!
//! The clock of these tests stands still while any thread has something to do. So whatever is not done at its time was
//! forgotten until something else woke a thread.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use shuttle::rand::{Rng, thread_rng};
use shuttle::scheduler::{PctScheduler, RandomScheduler};
use shuttle::sync::{Condvar, Mutex, MutexGuard};
use shuttle::thread::{self, ThreadId};
use shuttle::{Config, Runner};

use super::*;

/// Schedules of each test in the everyday run.
const SCHEDULES: usize = 150;
/// Of those that are drawn so: how often another thread goes first.
const SWITCHES: usize = 4;

const MINUTE: Duration = Duration::from_secs(60);
const SECOND: Duration = Duration::from_secs(1);

/// The machine of a test.
#[derive(Clone)]
struct Rig(Arc<World>);

struct World {
    start: Instant,
    crew: Mutex<Crew<Rig>>,
    clock: Mutex<Clock>,
    changed: Condvar,
    /// How many threads cannot be started, from the second one on.
    shortage: AtomicUsize,
    /// There are enough of them.
    is_punctual: bool,
    /// What a gauge has found wrong: the crew survives its panics.
    wrong: std::sync::Mutex<Vec<String>>,
}

#[derive(Default)]
struct Clock {
    passed: Duration,
    /// Threads that do not wait: the clock stands.
    busy: usize,
    /// Threads of the crew that have not ended.
    threads: usize,
    has_started: bool,
    sleepers: Vec<(ThreadId, Duration)>,
    /// Those that were woken before they waited.
    woken: Vec<ThreadId>,
    /// The requests whose answers somebody waits for.
    awaited: Vec<usize>,
    /// When each request was answered, or dropped: then the gauge had ended.
    answers: BTreeMap<usize, (Duration, bool)>,
    asked: usize,
}

impl Clock {
    /// Somebody begins to wait. If nobody has anything to do, time passes until somebody has.
    fn rest(&mut self) {
        self.busy -= 1;
        if self.busy > 0 {
            return;
        }
        if let Some(next) = self.sleepers.iter().map(|(_, until)| *until).min() {
            self.passed = self.passed.max(next);
            let before = self.sleepers.len();
            self.sleepers.retain(|(_, until)| *until > self.passed);
            self.busy += before - self.sleepers.len();
        }
    }
}

impl Rig {
    /// A machine whose only thread is the test's own, and which fails to start so many.
    fn new(shortage: usize) -> Self {
        Self(Arc::new(World {
            start: Instant::now(),
            crew: Mutex::new(Crew::new()),
            clock: Mutex::new(Clock { busy: 1, ..Clock::default() }),
            changed: Condvar::new(),
            shortage: AtomicUsize::new(shortage),
            is_punctual: shortage == 0,
            wrong: std::sync::Mutex::default(),
        }))
    }

    fn clock(&self) -> MutexGuard<'_, Clock> {
        self.0.clock.lock().expect("no panic")
    }

    fn passed(&self) -> Duration {
        self.clock().passed
    }

    /// Begins to wait, until that is so. The thread that makes it so counts this one among those that have something to do.
    fn wait_while(&self, mut clock: MutexGuard<'_, Clock>, is_waiting: impl Fn(&Clock) -> bool) {
        clock.rest();
        self.0.changed.notify_all();
        while is_waiting(&clock) {
            clock = self.0.changed.wait(clock).expect("no panic");
        }
    }

    fn sleep_until(&self, mut clock: MutexGuard<'_, Clock>, until: Duration) {
        if until > clock.passed {
            let own = thread::current().id();
            clock.sleepers.push((own, until));
            self.wait_while(clock, |clock| clock.sleepers.iter().any(|(id, _)| *id == own));
        }
    }

    fn sleep(&self, time: Duration) {
        let clock = self.clock();
        let until = clock.passed + time;
        self.sleep_until(clock, until);
    }

    /// Starts a thread of the test's.
    fn spawn(&self, work: impl FnOnce() + Send + 'static) {
        let rig = self.clone();
        {
            let mut clock = self.clock();
            (clock.busy, clock.threads) = (clock.busy + 1, clock.threads + 1);
        }
        thread::spawn(move || {
            work();
            let mut clock = rig.clock();
            clock.threads -= 1;
            clock.rest();
            rig.0.changed.notify_all();
        });
    }

    fn expect(&self, holds: bool, wrong: impl FnOnce() -> String) {
        if !holds {
            self.0.wrong.lock().expect("no panic").push(wrong());
        }
    }

    /// Waits until every other thread has ended.
    fn finish(&self) {
        self.wait_while(self.clock(), |clock| clock.threads > 0);
        assert_eq!(*self.0.wrong.lock().expect("no panic"), [""; 0]);
        let crew = self.lock();
        assert!(crew.desks.iter().all(Option::is_none), "an owner has not ended");
        assert!(crew.due.is_empty() && crew.waiting.is_empty() && crew.coming == 0);
    }
}

impl Stage for Rig {
    type Worker = Gauge;
    type Thread = ThreadId;
    type Locked<'a> = MutexGuard<'a, Crew<Self>>;

    fn lock(&self) -> Self::Locked<'_> {
        self.0.crew.lock().expect("no panic")
    }

    fn now(&self) -> Instant {
        self.0.start + self.passed()
    }

    fn start(&self, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let is_first = !std::mem::replace(&mut self.clock().has_started, true);
        let short = |left: usize| left.checked_sub(1);
        if !is_first && self.0.shortage.fetch_update(Ordering::SeqCst, Ordering::SeqCst, short).is_ok() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        self.spawn(work);
        Ok(())
    }

    fn current(&self) -> ThreadId {
        thread::current().id()
    }

    fn is_current(&self, thread: &ThreadId) -> bool {
        *thread == thread::current().id()
    }

    fn wait(&self, until: Instant) {
        let (mut clock, own) = (self.clock(), thread::current().id());
        match clock.woken.iter().position(|id| *id == own) {
            Some(at) => {
                clock.woken.swap_remove(at);
            }
            None => self.sleep_until(clock, until - self.0.start),
        }
    }

    fn wake(&self, thread: &ThreadId) {
        let mut clock = self.clock();
        match clock.sleepers.iter().position(|(id, _)| id == thread) {
            Some(at) => {
                clock.sleepers.swap_remove(at);
                clock.busy += 1;
                self.0.changed.notify_all();
            }
            None => clock.woken.push(*thread),
        }
    }
}

/// What a gauge can be asked for.
enum Wish {
    Value,
    /// Its bus hangs meanwhile.
    Hang(Duration),
    Panic,
    End,
}

/// A request, which is answered when it is dropped at the latest.
struct Asked {
    wish: Wish,
    number: usize,
    rig: Rig,
}

impl Asked {
    /// Answers it, unless it is answered already.
    fn answer(&self, is_carried_out: bool) {
        let mut clock = self.rig.clock();
        let passed = clock.passed;
        if clock.answers.contains_key(&self.number) {
            return self.rig.expect(!is_carried_out, || format!("request {} is answered twice", self.number));
        }
        clock.answers.insert(self.number, (passed, is_carried_out));
        if let Some(at) = clock.awaited.iter().position(|number| *number == self.number) {
            clock.awaited.swap_remove(at);
            clock.busy += 1;
            self.rig.0.changed.notify_all();
        }
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.answer(false);
        }
    }
}

struct Gauge {
    rig: Rig,
    is_at_work: AtomicBool,
    interval: Duration,
    next_poll: Duration,
    /// Its bus hung when it was to be polled.
    has_hung: bool,
    polls: Arc<AtomicUsize>,
}

impl Worker for Gauge {
    type Request = Asked;

    fn take_turn(&mut self, request: Option<(Duration, Asked)>) -> Option<Duration> {
        let is_first = !self.is_at_work.swap(true, Ordering::SeqCst);
        self.rig.expect(is_first, || "two threads work for one owner".into());
        thread::yield_now();
        let mut ends = false;
        match &request {
            Some((_, asked)) => {
                match asked.wish {
                    Wish::Value | Wish::Panic => (),
                    Wish::Hang(time) => {
                        self.rig.sleep(time);
                        self.has_hung = self.next_poll < self.rig.passed();
                    }
                    Wish::End => ends = true,
                }
                asked.answer(true);
                if let Wish::Panic = asked.wish {
                    // Without the message, which shuttle's hook would take for a failure.
                    resume_unwind(Box::new("a defect") as Box<dyn Any + Send>);
                }
            }
            None if self.next_poll <= self.rig.passed() => {
                let late = self.rig.passed() - self.next_poll;
                let is_excused = self.has_hung || !self.rig.0.is_punctual;
                self.rig.expect(is_excused || late.is_zero(), || format!("polled {late:?} late"));
                self.next_poll = self.rig.passed() + self.interval;
                self.polls.fetch_add(1, Ordering::SeqCst);
                self.has_hung = false;
            }
            None => (),
        }
        self.is_at_work.store(false, Ordering::SeqCst);
        let rest = self.next_poll.saturating_sub(self.rig.passed());
        (!ends).then_some(rest)
    }
}

/// A gauge in the crew, and how often it was polled.
struct Place {
    member: Member<Rig>,
    rig: Rig,
    interval: Duration,
    polls: Arc<AtomicUsize>,
}

impl Place {
    fn new(rig: &Rig) -> Self {
        Self::try_new(rig).expect("a thread starts")
    }

    fn try_new(rig: &Rig) -> io::Result<Self> {
        let polls = Arc::new(AtomicUsize::new(0));
        let interval = MINUTE + SECOND * thread_rng().gen_range(0..30);
        let (is_at_work, next_poll) = (AtomicBool::new(false), rig.passed());
        let gauge = Gauge {
            rig: rig.clone(),
            is_at_work,
            interval,
            next_poll,
            has_hung: false,
            polls: polls.clone(),
        };
        let member = Member::on(rig.clone(), Box::new(gauge))?;
        Ok(Self { member, rig: rig.clone(), interval, polls })
    }

    /// Asks for something. Returns its number.
    fn ask(&self, wish: Wish) -> usize {
        let (now, number) = {
            let mut clock = self.rig.clock();
            clock.asked += 1;
            (clock.passed, clock.asked)
        };
        self.member.submit(now, Asked { wish, number, rig: self.rig.clone() });
        number
    }

    /// The answer: how long it took, and whether it was carried out and not dropped.
    fn outcome(&self, number: usize, since: Duration) -> (Duration, bool) {
        let mut clock = self.rig.clock();
        if !clock.answers.contains_key(&number) {
            clock.awaited.push(number);
            self.rig.wait_while(clock, |clock| !clock.answers.contains_key(&number));
            clock = self.rig.clock();
        }
        let (at, is_carried_out) = clock.answers[&number];
        (at - since, is_carried_out)
    }

    fn wait_for(&self, wish: Wish) -> (Duration, bool) {
        let since = self.rig.passed();
        self.outcome(self.ask(wish), since)
    }
}

/// Runs a test in as many schedules as are asked for, half of them with few switches between threads.
fn explore(test: impl Fn() + Send + Sync + Copy + 'static) {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    let seed = number("GAUGEFS_SEED").unwrap_or(1);
    let count = number("GAUGEFS_SEEDS").map_or(SCHEDULES, |count| count as usize);
    Runner::new(RandomScheduler::new_from_seed(seed, count.div_ceil(2)), Config::new()).run(test);
    Runner::new(PctScheduler::new_from_seed(seed, SWITCHES, count.div_ceil(2)), Config::new()).run(test);
    println!("{count} schedules from seed {seed}");
}

/// Whatever others do, a gauge answers when it is asked, and is polled when that is due: neither one that hangs nor more
/// gauges than threads may wait delay another.
#[test]
fn every_request_and_poll_has_a_thread_at_once() {
    explore(|| {
        let rig = Rig::new(0);
        let hangs = Place::new(&rig);
        rig.spawn(move || {
            for seconds in [1, 90] {
                let time = Duration::from_secs(seconds);
                assert_eq!(hangs.wait_for(Wish::Hang(time)), (time, true));
            }
        });
        for _ in 0..=SPARE {
            let place = Place::new(&rig);
            rig.spawn(move || {
                let begun = place.rig.passed();
                // All of them at once, so that there are more threads than may wait.
                assert_eq!(place.wait_for(Wish::Hang(SECOND)), (SECOND, true));
                for _ in 0..2 {
                    place.rig.sleep(SECOND * thread_rng().gen_range(0..300));
                    assert_eq!(place.wait_for(Wish::Value), (Duration::ZERO, true));
                }
                let time = (place.rig.passed() - begun).as_secs() - 1;
                let polls = place.polls.load(Ordering::SeqCst) as u64;
                assert!(polls >= time / place.interval.as_secs(), "{polls} polls in {time} s");
            });
        }
        rig.finish();
    });
}

/// What was asked for before the last one who can ask goes is carried out, and then the owner ends.
#[test]
fn an_owner_that_is_left_answers_first() {
    explore(|| {
        let rig = Rig::new(0);
        let numbers: Vec<_> = (0..2)
            .flat_map(|_| {
                let place = Place::new(&rig);
                [Wish::Value, Wish::Hang(SECOND), Wish::Value].map(|wish| place.ask(wish))
            })
            .collect();
        rig.finish();
        let clock = rig.clock();
        assert!(numbers.iter().all(|number| clock.answers[number].1), "{:?}", clock.answers);
    });
}

/// What is asked of an owner that has panicked, or is about to, is dropped, which answers it; it delays no other.
#[test]
fn a_request_to_an_owner_that_panics_is_answered() {
    explore(|| {
        let rig = Rig::new(0);
        let (place, other) = (Arc::new(Place::new(&rig)), Place::new(&rig));
        for wish in [Wish::Panic, Wish::Value] {
            let place = place.clone();
            rig.spawn(move || assert_eq!(place.wait_for(wish).0, Duration::ZERO));
        }
        rig.spawn(move || assert_eq!(other.wait_for(Wish::Value), (Duration::ZERO, true)));
        drop(place);
        rig.finish();
    });
}

/// An owner that was told to end does nothing more, and goes with the last one who can ask.
#[test]
fn an_owner_that_was_told_to_end_goes_when_it_is_left() {
    explore(|| {
        let rig = Rig::new(0);
        let place = Place::new(&rig);
        assert_eq!(place.wait_for(Wish::End), (Duration::ZERO, true));
        place.ask(Wish::Value);
        let polls = place.polls.load(Ordering::SeqCst);
        rig.sleep(2 * MINUTE);
        assert_eq!(place.polls.load(Ordering::SeqCst), polls, "it works on");
        let number = place.ask(Wish::Value);
        drop(place);
        assert!(!rig.clock().answers[&number].1, "it is carried out");
        rig.finish();
    });
}

/// While no thread can be started, gauges wait for each other; none is forgotten.
#[test]
fn without_threads_nothing_is_forgotten() {
    explore(|| {
        let rig = Rig::new(thread_rng().gen_range(1..6));
        for seconds in [90, 0, 0] {
            // If no thread works, the owner is not taken.
            let place = std::iter::repeat_with(|| Place::try_new(&rig)).find_map(Result::ok).expect("no end");
            rig.spawn(move || {
                let time = Duration::from_secs(seconds);
                assert!(place.wait_for(Wish::Hang(time)).1);
                assert!(place.wait_for(Wish::Value).1);
            });
        }
        rig.finish();
    });
}
