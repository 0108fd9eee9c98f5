// SPDX-License-Identifier: MIT

//! A [`Bus`] that gives up waiting for a transfer after a limited time.
//!
//! A driver may hang in a transfer for good; no signal ends such a call. So each bus has a thread for its transfers, and
//! its caller can give up. Until the transfer has returned, nothing else is sent on that adapter.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{self, AssertUnwindSafe};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::clock::Clock;
use crate::{Bus, BusError, Packet, Reach};

/// Longest wait for a transfer. The kernel's adapters give up after at most 5 s, most of them after 1 s.
pub const PATIENCE: Duration = Duration::from_secs(8);
/// Longest wait beyond the time at which the caller starts no further transfers.
const GRACE: Duration = Duration::from_millis(1500);

/// The adapters with a transfer that has not returned.
static HUNG: Mutex<BTreeSet<u64>> = Mutex::new(BTreeSet::new());

fn hung() -> MutexGuard<'static, BTreeSet<u64>> {
    HUNG.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the adapters are called: a bus that is a file has a number that nobody knows.
static NAMES: Mutex<BTreeMap<u64, String>> = Mutex::new(BTreeMap::new());

fn names() -> MutexGuard<'static, BTreeMap<u64, String>> {
    NAMES.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn name(adapter: u64) -> String {
    names().get(&adapter).cloned().unwrap_or_else(|| format!("/dev/i2c-{adapter}"))
}

enum Job {
    Transfer { write: Vec<u8>, read: usize },
    Packet(Packet),
    Claim,
    Release,
}

/// The outcome of a job, the bytes read, and the reach of the bus, which may be another adapter's; or its panic.
type Outcome = thread::Result<(Result<(), BusError>, Vec<u8>, Reach)>;

/// A bus, the thread that transfers on it, and the time that it may take.
pub struct Bounded {
    adapter: u64,
    patience: Duration,
    clock: Arc<dyn Clock>,
    /// `None` once the bus is being dropped.
    jobs: Option<Sender<Job>>,
    outcomes: Receiver<Outcome>,
    thread: Option<JoinHandle<()>>,
    /// The outcome of the last job is still to come; nobody waits for it any more.
    overdue: bool,
    /// See [`Bus::limit`].
    latest: Option<Duration>,
    reach: Reach,
}

impl Bounded {
    /// Transfers on `bus`, a target of the adapter of that number and name, in a thread of its own.
    pub fn new(
        mut bus: impl Bus + 'static,
        (adapter, name): (u64, String),
        patience: Duration,
        clock: Arc<dyn Clock>,
    ) -> Self {
        let (jobs, queue) = mpsc::channel();
        let (sender, outcomes) = mpsc::channel();
        let reach = bus.reach();
        let thread = thread::Builder::new().name("bus".into()).stack_size(64 * 1024);
        // Without a thread each transfer reports the adapter as gone.
        let started = thread.spawn(move || run(bus, &queue, &sender));
        let started = started.inspect_err(|error| {
            log::error!("{name}: cannot start a thread: {error}");
        });
        names().insert(adapter, name);
        let (jobs, thread) = (Some(jobs), started.ok());
        Self { adapter, patience, clock, jobs, outcomes, thread, overdue: false, latest: None, reach }
    }

    fn catch_up(&mut self) -> Result<(), BusError> {
        if self.overdue {
            match self.outcomes.try_recv() {
                Err(TryRecvError::Empty) => return Err(BusError::Hung(self.adapter)),
                Ok(_) | Err(TryRecvError::Disconnected) => {
                    self.overdue = false;
                    hung().remove(&self.adapter);
                    let name = name(self.adapter);
                    log::warn!("{name}: the transfer has returned; the adapter is used again");
                }
            }
        }
        // Another target of the same adapter.
        if hung().contains(&self.adapter) { Err(BusError::Hung(self.adapter)) } else { Ok(()) }
    }

    fn carry_out(&mut self, job: Job) -> Result<Vec<u8>, BusError> {
        self.catch_up()?;
        let left = self.latest.map(|latest| (latest + GRACE).saturating_sub(self.clock.now()).max(GRACE));
        let patience = left.map_or(self.patience, |left| left.min(self.patience));
        let jobs = self.jobs.as_ref().ok_or(BusError::Gone)?;
        jobs.send(job).map_err(|_| BusError::Gone)?;
        match self.outcomes.recv_timeout(patience) {
            Ok(Ok((outcome, read, reach))) => {
                self.reach = reach;
                outcome.map(|()| read)
            }
            // As if it had happened here.
            Ok(Err(panic)) => panic::resume_unwind(panic),
            Err(RecvTimeoutError::Disconnected) => Err(BusError::Gone),
            Err(RecvTimeoutError::Timeout) => {
                self.overdue = true;
                hung().insert(self.adapter);
                let error = BusError::Hung(self.adapter);
                log::error!("{error}");
                Err(error)
            }
        }
    }
}

/// The adapter's node and its lock are released when this returns, unless a transfer hangs.
impl Drop for Bounded {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take().filter(|_| !self.overdue) {
            // A panic was passed on to whoever asked for the transfer.
            let _ = thread.join();
        }
    }
}

fn run(mut bus: impl Bus, jobs: &Receiver<Job>, outcomes: &Sender<Outcome>) {
    while let Ok(job) = jobs.recv() {
        let outcome = panic::catch_unwind(AssertUnwindSafe(|| {
            let (outcome, bytes) = match job {
                Job::Transfer { write, read } => {
                    let mut bytes = vec![0; read];
                    (bus.transfer(&write, &mut bytes), bytes)
                }
                Job::Packet(packet) => match bus.packet(packet) {
                    Ok(bytes) => (Ok(()), bytes),
                    Err(error) => (Err(error), Vec::new()),
                },
                Job::Claim => (bus.claim(), Vec::new()),
                Job::Release => {
                    bus.release_if_gone();
                    (Ok(()), Vec::new())
                }
            };
            (outcome, bytes, bus.reach())
        }));
        if outcomes.send(outcome).is_err() {
            return;
        }
    }
}

impl Bus for Bounded {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let bytes = self.carry_out(Job::Transfer { write: write.to_vec(), read: read.len() })?;
        read.copy_from_slice(&bytes);
        Ok(())
    }

    fn packet(&mut self, packet: Packet) -> Result<Vec<u8>, BusError> {
        self.carry_out(Job::Packet(packet))
    }

    fn reach(&mut self) -> Reach {
        self.reach
    }

    fn claim(&mut self) -> Result<(), BusError> {
        self.carry_out(Job::Claim).map(drop)
    }

    fn release_if_gone(&mut self) {
        // It has no outcome. If the adapter hangs, it is released once it has returned.
        let _ = self.carry_out(Job::Release);
    }

    fn limit(&mut self, latest: Option<Duration>) {
        self.latest = latest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::RealClock;

    /// A driver whose transfers return when the test says so.
    struct Driver {
        begun: Sender<Vec<u8>>,
        returns: Receiver<Result<(), BusError>>,
        reach: Reach,
    }

    impl Bus for Driver {
        fn reach(&mut self) -> Reach {
            self.reach
        }

        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            // As another adapter.
            self.reach.read -= 1;
            self.begun.send(write.to_vec()).expect("the test listens");
            read.fill(0x5a);
            self.returns.recv().expect("the test decides")
        }
    }

    #[test]
    fn the_bus_is_released_when_it_is_dropped() {
        for _ in 0..100 {
            let Rig { bus, begun, .. } = rig(47, PATIENCE);
            drop(bus);
            assert_eq!(begun.try_recv(), Err(TryRecvError::Disconnected));
        }
    }

    struct Rig {
        bus: Bounded,
        begun: Receiver<Vec<u8>>,
        returns: Sender<Result<(), BusError>>,
    }

    fn rig(adapter: u64, patience: Duration) -> Rig {
        let ((begin, begun), (returns, returned)) = (mpsc::channel(), mpsc::channel());
        let driver = Driver { begun: begin, returns: returned, reach: Reach::smbus(32, false) };
        let named = (adapter, format!("/tmp/bus-{adapter}"));
        Rig { bus: Bounded::new(driver, named, patience, Arc::new(RealClock::new())), begun, returns }
    }

    /// Nobody waits for as long as that.
    const LONG: Duration = Duration::from_secs(600);
    const SHORT: Duration = Duration::from_millis(20);

    #[test]
    fn a_transfer_that_returns_is_passed_on() {
        let mut rig = rig(900, LONG);
        let mut read = [0; 3];
        rig.returns.send(Ok(())).expect("a driver");
        assert_eq!(rig.bus.reach().read, 32);
        assert_eq!(rig.bus.transfer(&[8], &mut read), Ok(()));
        assert_eq!(rig.bus.reach().read, 31, "that of the adapter which is there now");
        assert_eq!((rig.begun.recv(), read), (Ok(vec![8]), [0x5a; 3]));
        rig.returns.send(Err(BusError::NoAck)).expect("a driver");
        assert_eq!(rig.bus.transfer(&[8], &mut read), Err(BusError::NoAck));
    }

    #[test]
    fn nothing_is_sent_on_an_adapter_until_the_transfer_that_hangs_has_returned() {
        let (mut hangs, mut other, mut apart) = (rig(901, SHORT), rig(901, LONG), rig(902, LONG));
        assert_eq!(hangs.bus.transfer(&[1], &mut []), Err(BusError::Hung(901)));
        assert_eq!(hangs.begun.recv(), Ok(vec![1]));
        for _ in 0..3 {
            assert_eq!(hangs.bus.transfer(&[2], &mut []), Err(BusError::Hung(901)));
            assert_eq!(hangs.bus.claim(), Err(BusError::Hung(901)));
            hangs.bus.release_if_gone();
            assert_eq!(other.bus.transfer(&[3], &mut []), Err(BusError::Hung(901)));
        }
        // Another adapter goes on.
        apart.returns.send(Ok(())).expect("a driver");
        assert_eq!(apart.bus.transfer(&[4], &mut []), Ok(()));

        // The outcome of the transfer that was given up belongs to no later one.
        hangs.bus.patience = LONG;
        for outcome in [Err(BusError::NoAck), Ok(())] {
            hangs.returns.send(outcome).expect("a driver");
        }
        let mut read = [0; 2];
        while hangs.bus.transfer(&[5], &mut read) == Err(BusError::Hung(901)) {
            thread::yield_now();
        }
        assert_eq!(read, [0x5a; 2]);
        assert_eq!(hangs.begun.try_iter().collect::<Vec<_>>(), [vec![5]]);
        other.returns.send(Ok(())).expect("a driver");
        assert_eq!(other.bus.transfer(&[6], &mut []), Ok(()));
        assert_eq!(
            other.begun.try_iter().collect::<Vec<_>>(),
            [vec![6]],
            "nothing was kept to be sent later"
        );
    }

    #[test]
    fn a_caller_without_time_waits_no_longer_than_it_can() {
        let mut rig = rig(903, LONG);
        rig.bus.limit(Some(Duration::ZERO));
        let error = rig.bus.transfer(&[1], &mut []).expect_err("it hangs");
        assert_eq!(error, BusError::Hung(903));
        assert!(error.to_string().starts_with("/tmp/bus-903 hangs: "), "{error}");
    }

    #[test]
    fn a_panic_of_the_driver_is_one_of_the_caller() {
        let mut rig = rig(904, LONG);
        drop(rig.returns);
        let caught = panic::catch_unwind(AssertUnwindSafe(|| rig.bus.transfer(&[1], &mut [])));
        assert!(caught.is_err());
    }
}
