// SPDX-License-Identifier: MIT

//! The threads in which owners work.
//!
//! An owner has a thread only while it has something to do: a thread keeps the stack that it has once used, and owners
//! mostly wait. A thread that begins to work makes sure that another one waits for what is due next.

use std::collections::VecDeque;
use std::io;
use std::ops::DerefMut;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use super::Owner;
use super::operation::Request;

#[cfg(test)]
mod races;

/// How many threads wait at most. More are started when they are needed, and end when they are not.
const SPARE: usize = 4;

/// What a crew needs of the machine that it runs on, and whom it works for: a test has schedules and a clock of its own.
pub(super) trait Stage: Clone + Send + 'static {
    type Worker: Worker;
    type Thread: Send;
    type Locked<'a>: DerefMut<Target = Crew<Self>>;

    fn lock(&self) -> Self::Locked<'_>;
    fn now(&self) -> Instant;
    /// Starts a thread.
    fn start(&self, work: impl FnOnce() + Send + 'static) -> io::Result<()>;
    fn current(&self) -> Self::Thread;
    fn is_current(&self, thread: &Self::Thread) -> bool;
    fn wait(&self, until: Instant);
    fn wake(&self, thread: &Self::Thread);
}

pub(super) trait Worker: Send + 'static {
    type Request: Send;

    /// Does what is due, or what it is asked for. Returns how long it has nothing to do then; `None` if it has ended.
    fn take_turn(&mut self, request: Option<(Duration, Self::Request)>) -> Option<Duration>;
}

impl Worker for Owner {
    type Request = Request;

    fn take_turn(&mut self, request: Option<(Duration, Request)>) -> Option<Duration> {
        Self::take_turn(self, request)
    }
}

#[derive(Clone)]
pub(super) struct Here;

static CREW: Mutex<Crew<Here>> = Mutex::new(Crew::new());

impl Stage for Here {
    type Worker = Owner;
    type Thread = Thread;
    type Locked<'a> = MutexGuard<'a, Crew<Self>>;

    fn lock(&self) -> Self::Locked<'_> {
        CREW.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> Instant {
        Instant::now()
    }

    fn start(&self, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        thread::Builder::new().name("gauges".into()).stack_size(256 * 1024).spawn(work).map(drop)
    }

    fn current(&self) -> Thread {
        thread::current()
    }

    fn is_current(&self, thread: &Thread) -> bool {
        thread.id() == thread::current().id()
    }

    fn wait(&self, until: Instant) {
        thread::park_timeout(until.saturating_duration_since(self.now()));
    }

    fn wake(&self, thread: &Thread) {
        thread.unpark();
    }
}

pub(super) struct Crew<S: Stage> {
    /// The owners by their numbers; `None` where one has ended.
    desks: Vec<Option<Desk<S::Worker>>>,
    /// When each owner that no thread works for has something to do, and its number; the earliest last.
    due: Vec<(Instant, usize)>,
    waiting: Vec<Waiting<S::Thread>>,
    /// How many threads were started or woken, and have not looked yet what there is to do.
    coming: usize,
    /// The last attempt to start a thread has failed.
    is_short: bool,
}

struct Desk<W: Worker> {
    /// `None` while a thread works for it, and after a panic.
    owner: Option<Box<W>>,
    /// When it has something to do; `None` while a thread works for it, and once it does nothing any more.
    due: Option<Instant>,
    /// Each with the time at which it was submitted; `None` if they are dropped.
    requests: Option<VecDeque<(Duration, W::Request)>>,
    /// Nobody can ask for anything any more.
    is_left: bool,
}

struct Turn<W: Worker> {
    number: usize,
    owner: Box<W>,
    request: Option<(Duration, W::Request)>,
    /// The owner has to end.
    is_over: bool,
}

struct Waiting<T> {
    thread: T,
    until: Instant,
}

impl<S: Stage> Crew<S> {
    const fn new() -> Self {
        Self { desks: Vec::new(), due: Vec::new(), waiting: Vec::new(), coming: 0, is_short: false }
    }

    /// When there is next something to do that no thread waits for.
    fn next(&self) -> Option<Instant> {
        let mut times = self.due.iter().rev().map(|(time, _)| *time);
        times.find(|time| self.waiting.iter().all(|waiting| waiting.until != *time))
    }

    fn desk(&mut self, number: usize) -> Option<&mut Desk<S::Worker>> {
        self.desks.get_mut(number)?.as_mut()
    }

    fn put(&mut self, number: usize, time: Instant) {
        let Some(desk) = self.desk(number) else { return };
        let before = desk.due.replace(time);
        if let Some(before) = before {
            let at = self.due.partition_point(|entry| *entry > (before, number));
            self.due.remove(at);
        }
        let at = self.due.partition_point(|entry| *entry > (time, number));
        self.due.insert(at, (time, number));
    }

    fn hurry(&mut self, number: usize, now: Instant) {
        if self.desk(number).is_some_and(|desk| desk.due.is_some()) {
            self.put(number, now);
        }
    }

    /// Takes the owner that has waited for the longest time to do something, and a request if there is one.
    fn take(&mut self, now: Instant) -> Option<Turn<S::Worker>> {
        let (_, number) = self.due.pop_if(|(time, _)| *time <= now)?;
        let desk = self.desk(number)?;
        desk.due = None;
        let request = desk.requests.as_mut().and_then(VecDeque::pop_front);
        let is_over = desk.is_left && request.is_none();
        Some(Turn { number, owner: desk.owner.take()?, request, is_over })
    }

    /// Makes sure that a thread waits for what there is to do next.
    fn attend(&mut self, stage: &S) -> io::Result<()> {
        let watched = self.waiting.iter().map(|waiting| waiting.until).min();
        let is_watched = |time| watched.is_some_and(|watched| watched <= time);
        if self.coming > 0 || self.next().is_none_or(is_watched) {
            return Ok(());
        }
        // The one that would wait for the longest time.
        let last = (0..self.waiting.len()).max_by_key(|&at| self.waiting[at].until);
        match last.map(|last| self.waiting.swap_remove(last)) {
            Some(waiting) => stage.wake(&waiting.thread),
            None => {
                let its = stage.clone();
                stage.start(move || work(&its))?;
            }
        }
        self.coming += 1;
        Ok(())
    }
}

/// An owner of the crew. When this is dropped, the owner finishes what it was asked for, and ends.
pub(super) struct Member<S: Stage = Here>(usize, S);

impl Member {
    /// Gives an owner to the threads; it works from now on.
    pub(super) fn new(owner: Box<Owner>) -> io::Result<Self> {
        Self::on(Here, owner)
    }
}

impl<S: Stage> Member<S> {
    fn on(stage: S, owner: Box<S::Worker>) -> io::Result<Self> {
        let mut crew = stage.lock();
        let number = crew.desks.iter().position(Option::is_none).unwrap_or(crew.desks.len());
        if number == crew.desks.len() {
            crew.desks.push(None);
        }
        let requests = Some(VecDeque::new());
        crew.desks[number] = Some(Desk { owner: Some(owner), due: None, requests, is_left: false });
        crew.put(number, stage.now());
        let started = crew.attend(&stage);
        drop(crew);
        // If it fails, this is dropped.
        let member = Self(number, stage);
        started.map(|()| member)
    }

    /// Asks the owner for something. If it has ended, the request is dropped.
    pub(super) fn submit(&self, now: Duration, request: <S::Worker as Worker>::Request) {
        let Self(number, stage) = self;
        let mut crew = stage.lock();
        match crew.desk(*number).and_then(|desk| desk.requests.as_mut()) {
            Some(requests) => requests.push_back((now, request)),
            // Whoever is answered may ask for something else.
            None => return drop((crew, request)),
        }
        crew.hurry(*number, stage.now());
        attend(stage, &mut crew);
    }
}

impl<S: Stage> Drop for Member<S> {
    fn drop(&mut self) {
        let Self(number, stage) = self;
        let mut crew = stage.lock();
        let Some(desk) = crew.desk(*number) else { return };
        // It was told to end, or has panicked: no thread will look at it again.
        let has_ended = desk.due.is_none() && (desk.owner.is_some() || desk.requests.is_none());
        if has_ended {
            let desk = crew.desks[*number].take();
            // Whoever is answered may ask for something else.
            return drop((crew, desk));
        }
        desk.is_left = true;
        crew.hurry(*number, stage.now());
        attend(stage, &mut crew);
    }
}

/// If no thread can be started, the next one that has nothing else to do sees to it.
fn attend<S: Stage>(stage: &S, crew: &mut Crew<S>) {
    let attended = crew.attend(stage);
    let was_short = std::mem::replace(&mut crew.is_short, attended.is_err());
    if let (Err(error), false) = (attended, was_short) {
        log::error!("gauges wait for each other: cannot start a thread: {error}");
    }
}

fn work<S: Stage>(stage: &S) {
    let mut crew = stage.lock();
    crew.coming -= 1;
    loop {
        let now = stage.now();
        if let Some(turn) = crew.take(now) {
            attend(stage, &mut crew);
            drop(crew);
            take_turn(stage, turn);
            crew = stage.lock();
            continue;
        }
        let Some(until) = crew.next().filter(|_| crew.waiting.len() < SPARE) else {
            // One of those that wait may have to wait for another time now.
            return attend(stage, &mut crew);
        };
        crew.waiting.push(Waiting { thread: stage.current(), until });
        drop(crew);
        stage.wait(until);
        crew = stage.lock();
        match crew.waiting.iter().position(|waiting| stage.is_current(&waiting.thread)) {
            Some(at) => drop(crew.waiting.swap_remove(at)),
            None => crew.coming -= 1,
        }
    }
}

fn take_turn<S: Stage>(stage: &S, Turn { number, mut owner, request, is_over }: Turn<S::Worker>) {
    // Whatever may panic is answered for, but for the owner itself.
    let turn = || (!is_over).then(|| owner.take_turn(request));
    let outcome = catch_unwind(AssertUnwindSafe(turn));
    let mut crew = stage.lock();
    let Some(desk) = crew.desk(number) else { return };
    let Ok(Some(rest)) = outcome else {
        let requests = desk.requests.take();
        if desk.is_left {
            crew.desks[number] = None;
        }
        drop(crew);
        let _ = catch_unwind(AssertUnwindSafe(|| drop((owner, requests))));
        return;
    };
    desk.owner = Some(owner);
    let is_asked = desk.is_left || desk.requests.as_ref().is_some_and(|requests| !requests.is_empty());
    if let Some(rest) = rest {
        let rest = if is_asked { Duration::ZERO } else { rest };
        crew.put(number, stage.now() + rest);
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
    use std::sync::{Arc, Mutex};

    use super::super::{Handle, Run, operations, spawn};
    use super::*;
    use gauge_bus::clock::{Clock, RealClock, SimClock};
    use gauge_bus::{Bus, BusError};
    use gauge_sim::{Options, Sim, SimBus};
    use ti_gauge::chip::Chip;

    /// A guard against what hangs, and no measurement.
    const PATIENCE: Duration = Duration::from_secs(300);

    /// A bus that waits in each transfer while somebody holds its gate, and says when it is dropped.
    struct Gated {
        bus: SimBus,
        gate: Arc<Mutex<()>>,
        _dropped: Sender<()>,
    }

    impl Bus for Gated {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            let _open = self.gate.lock().unwrap_or_else(PoisonError::into_inner);
            self.bus.transfer(write, read)
        }
    }

    /// A gauge with a clock of its own, and the end of its bus.
    fn gauge(gate: &Arc<Mutex<()>>) -> (Handle, Receiver<()>) {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        let (dropped, ended) = mpsc::channel();
        let bus = Box::new(Gated { bus: sim.bus(), gate: gate.clone(), _dropped: dropped });
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        let run = Run { interval: Duration::from_secs(3600), ..Run::default() };
        (spawn(chip, bus, clock, run, Arc::default()).expect("it answers"), ended)
    }

    fn threads() -> usize {
        let names = fs::read_dir("/proc/self/task").expect("Linux has it").flatten();
        names
            .filter(|task| fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name == "gauges\n"))
            .count()
    }

    #[test]
    fn gauges_that_hang_delay_no_other_and_gauges_at_rest_have_no_threads() {
        let (shut, open) = (Arc::new(Mutex::new(())), Arc::default());
        let hanging: Vec<_> = (0..3 * SPARE).map(|_| gauge(&shut)).collect();
        let others: Vec<_> = (0..3 * SPARE).map(|_| gauge(&open)).collect();
        let (done, answers) = mpsc::channel();
        let held = shut.lock().expect("nobody has panicked");
        for (handle, _) in hanging.iter().chain(&hanging) {
            let done = done.clone();
            handle.ask(&operations::REFRESH, (), Box::new(move |answer| drop(done.send(answer))));
        }
        for (handle, _) in &others {
            handle.wait_for(&operations::REFRESH, ()).expect("it does not hang");
        }
        assert_eq!(answers.recv_timeout(Duration::ZERO).err(), Some(RecvTimeoutError::Timeout));
        drop(held);
        for _ in hanging.iter().chain(&hanging) {
            answers.recv_timeout(PATIENCE).expect("an answer").expect("it answers again");
        }
        let begun = Instant::now();
        while threads() > 2 * SPARE {
            assert!(begun.elapsed() < PATIENCE, "{} threads for gauges at rest", threads());
            RealClock::new().sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn an_owner_that_nobody_asks_any_more_finishes_its_requests_and_ends() {
        let gate = Arc::new(Mutex::new(()));
        let (handle, ended) = gauge(&gate);
        let (done, answers) = mpsc::channel();
        let held = gate.lock().expect("nobody has panicked");
        for _ in 0..3 {
            let done = done.clone();
            handle.ask(&operations::REFRESH, (), Box::new(move |answer| drop(done.send(answer))));
        }
        drop((handle, held));
        for _ in 0..3 {
            answers.recv_timeout(PATIENCE).expect("an answer").expect("it answers");
        }
        assert_eq!(ended.recv_timeout(PATIENCE).err(), Some(RecvTimeoutError::Disconnected));
    }

    #[test]
    fn an_owner_that_was_asked_to_end_answers_nobody() {
        let (handle, _) = gauge(&Arc::default());
        handle.wait_for(&operations::END, ()).expect("nothing is owed");
        let (done, answers) = mpsc::channel();
        handle.ask(&operations::REFRESH, (), Box::new(move |answer| drop(done.send(answer))));
        let (other, _) = gauge(&Arc::default());
        other.wait_for(&operations::REFRESH, ()).expect("it answers");
        assert_eq!(answers.recv_timeout(Duration::from_millis(20)).err(), Some(RecvTimeoutError::Timeout));
    }
}
