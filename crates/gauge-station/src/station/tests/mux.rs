// SPDX-License-Identifier: MIT

//! Slots behind one I2C multiplexer, such as a PCA9548. Linux shows each of its channels as an adapter, `/dev/i2c-N`, and
//! lets one transfer at a time through to the wire that they share, in the order in which they were asked for.
//!
//! The wire is modelled in time that is the same on each run: every slot has a clock, and only the slot whose clock is
//! behind all others goes on.

use std::sync::{Condvar, MutexGuard};
use std::thread;

use super::*;
use gauge_bus::wire_bits;

/// A bit at 100 kHz.
const BIT: Duration = Duration::from_micros(10);

/// The wire that all channels share.
struct Wire {
    turns: Mutex<Turns>,
    changed: Condvar,
}

struct Turns {
    /// The time of each slot, until it ends.
    now: Vec<Option<Duration>>,
    /// The transfers on the wire: their slots, and the times of their ends.
    sent: VecDeque<(usize, Duration)>,
    /// The channel that the multiplexer lets through.
    selected: Option<usize>,
    /// The most transfers of other slots that one of each slot has waited for.
    waited: Vec<usize>,
    /// Time during which something was sent.
    busy: Duration,
}

impl Wire {
    fn new(slots: usize) -> Arc<Self> {
        let turns = Turns {
            now: vec![Some(Duration::ZERO); slots],
            sent: VecDeque::new(),
            selected: None,
            waited: vec![0; slots],
            busy: Duration::ZERO,
        };
        Arc::new(Self { turns: Mutex::new(turns), changed: Condvar::new() })
    }

    fn turns(&self) -> MutexGuard<'_, Turns> {
        self.turns.lock().expect("nobody panics")
    }

    /// Lets a slot's time pass, and waits until no other slot is behind it.
    fn pass(&self, slot: usize, time: Duration) {
        let mut turns = self.turns();
        turns.now[slot] = turns.now[slot].map(|now| now + time);
        self.changed.notify_all();
        let is_behind = |turns: &Turns| {
            let others = turns.now.iter().enumerate().filter_map(|(at, now)| Some(((*now)?, at)));
            others.min().is_some_and(|(_, at)| at != slot)
        };
        drop(self.changed.wait_while(turns, |turns| is_behind(turns)).expect("nobody panics"));
    }

    fn end(&self, slot: usize) {
        self.turns().now[slot] = None;
        self.changed.notify_all();
    }
}

/// The clock of a slot.
struct SlotClock(Arc<Wire>, usize);

impl Clock for SlotClock {
    fn now(&self) -> Duration {
        self.0.turns().now[self.1].expect("it has not ended")
    }

    fn sleep(&self, time: Duration) {
        self.0.pass(self.1, time);
    }

    fn spend(&self, time: Duration) {
        let now = &mut self.0.turns().now[self.1];
        *now = now.map(|now| now + time);
    }
}

/// A channel of the multiplexer with a pack.
struct Channel(SimBus, Arc<Wire>, usize);

impl Bus for Channel {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        let Self(bus, wire, slot) = self;
        wire.pass(*slot, Duration::ZERO);
        let mut turns = wire.turns();
        let asked = turns.now[*slot].expect("it has not ended");
        turns.sent.retain(|(_, end)| *end > asked);
        let others = turns.sent.iter().filter(|(other, _)| other != slot).count();
        turns.waited[*slot] = turns.waited[*slot].max(others);
        // The kernel's driver writes the channel to the multiplexer first, unless it is the last one.
        let select = if turns.selected.replace(*slot) == Some(*slot) {
            Duration::ZERO
        } else {
            BIT * wire_bits(1, 0) as u32
        };
        let start = turns.sent.back().map_or(asked, |(_, end)| *end);
        turns.now[*slot] = Some(start + select);
        drop(turns);
        let outcome = bus.transfer(write, read);
        let mut turns = wire.turns();
        let end = turns.now[*slot].expect("it has not ended");
        turns.sent.push_back((*slot, end));
        turns.busy += end - start;
        drop(turns);
        wire.pass(*slot, Duration::ZERO);
        outcome
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.0)
    }
}

/// Packs behind a channel, one after the other.
struct Behind {
    clock: Arc<SlotClock>,
    packs: VecDeque<Sim>,
    now: Option<Sim>,
    looks: u32,
}

impl Slot for Behind {
    fn clock(&self) -> Arc<dyn Clock> {
        self.clock.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        let sim = self.now.as_ref().expect("a pack is there");
        Box::new(Channel(sim.bus(), self.clock.0.clone(), self.clock.1))
    }

    fn is_there(&mut self) -> Option<bool> {
        if self.now.is_some() {
            return Some(self.bus().transfer(&[0x08], &mut [0; 2]).is_ok());
        }
        self.looks += 1;
        if self.looks <= STEADY {
            return Some(false);
        }
        self.now = Some(self.packs.pop_front()?);
        Some(true)
    }

    fn done(&mut self) {
        (self.now, self.looks) = (None, 0);
    }
}

/// What a run of several slots comes to.
struct Run {
    lines: Vec<Entry>,
    waited: Vec<usize>,
    /// The share of the time in which the wire was in use.
    load: f64,
}

/// Programs two packs at each of so many slots.
fn run(slots: usize) -> Run {
    let folder = Folder::new(&format!("mux{slots}"));
    let plan = folder.plan(PLAIN);
    let bench = |at: usize| {
        let bench =
            plan.bench(0, format!("i2c-{at} address 0x55"), Reach::FULL, Some(format!("i2c-{at}-55")));
        Bench { name: format!("SLOT{at}"), ..bench.expect("a bench") }
    };
    let benches: Vec<_> = (0..slots).map(bench).collect();
    let stops = Arc::new(AtomicBool::new(false));
    let said = Said::default();
    let station = Station::start(plan, Arc::new(Host), Box::new(said.clone()), Lines::of(&[]), None, stops)
        .expect("a record");
    let wire = Wire::new(slots);
    thread::scope(|scope| {
        for (slot, bench) in benches.iter().enumerate() {
            let (station, wire) = (&station, wire.clone());
            scope.spawn(move || {
                let clock = Arc::new(SlotClock(wire.clone(), slot));
                let pack = |seed| {
                    let options = gauge_sim::Options { seed, ..gauge_sim::Options::default() };
                    Sim::new(CHIP, &options, clock.clone()).expect("it is simulated")
                };
                let packs = (0..2).map(|seed| pack(seed + 10 * slot as u64)).collect();
                // Nobody connects two packs in the same instant.
                clock.sleep(Duration::from_millis(3000 + 120 * slot as u64));
                let mut behind = Behind { clock, packs, now: None, looks: STEADY };
                station.run(bench, &mut behind);
                wire.end(slot);
            });
        }
    });
    let end = wire.turns().sent.back().map_or(Duration::ZERO, |(_, end)| *end);
    let turns = wire.turns();
    assert!(
        said.all().iter().filter(|line| line.starts_with("PASS")).count() == 2 * slots,
        "{:?}",
        said.all()
    );
    check_record(&folder);
    let load = turns.busy.as_secs_f64() / end.as_secs_f64();
    Run { lines: folder.lines(), waited: turns.waited.clone(), load }
}

#[test]
fn slots_behind_one_multiplexer_share_its_wire_transfer_by_transfer() {
    let mean = |run: &Run| {
        let passed: Vec<_> = run.lines.iter().filter(|line| line.event == Event::Pass).collect();
        let sum: f64 = passed.iter().filter_map(|line| line.seconds).sum();
        sum / passed.len() as f64
    };
    let most = |run: &Run| run.lines.iter().filter_map(|line| line.transfers).max();
    let alone = run(1);
    assert_eq!(alone.waited, [0]);
    for slots in [2, 4, 8] {
        let shared = run(slots);
        println!(
            "{slots} slots: {:.1} s a pack (alone: {:.1} s), {:.0} % of the wire, waited for {:?} transfers",
            mean(&shared),
            mean(&alone),
            shared.load * 100.0,
            shared.waited
        );
        // All are under way before the first one has passed.
        let events: Vec<_> = shared.lines.iter().map(|line| line.event).collect();
        assert!(events[..slots].iter().all(|event| *event == Event::Begun), "{events:?}");
        // A slot has one transfer on its way, so each waits for at most one of every other slot; and all have waited.
        assert!(shared.waited.iter().all(|waited| (1..slots).contains(waited)), "{:?}", shared.waited);
        // Waiting costs a pack no second attempt at anything, and the wire is enough for all.
        assert_eq!(most(&shared), most(&alone), "{slots} slots");
        assert!(
            mean(&shared) < mean(&alone) * 1.5,
            "{slots} slots: {} and {} s",
            mean(&shared),
            mean(&alone)
        );
        assert!(shared.load < 0.9, "{}", shared.load);
    }
}
