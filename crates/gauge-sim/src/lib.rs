// SPDX-License-Identifier: MIT

//! Simulated Texas Instruments fuel gauges: each is a [`gauge_bus::Bus`] with a believable part, its data flash and a
//! battery behind it.
//!
//! They are written from the manuals alone, byte by byte: acknowledgement, sealed and unsealed, the block-access window
//! apart from flash, the checksum that commits, the voltage below which nothing is stored, a reset that takes its time.
//! Knobs turn the load, the temperature, the timings and the power, and make the nth transfer fail. A
//! [`scenario`] does that by a file.
//!
//! Real gauges differ from each other more than their manuals say. [`Options::envelope`] draws one by seed: blocks that
//! are ready late while the window shows another one with a valid checksum, commits that leave the gauge deaf or its old
//! content readable, rows that a loss of power erases, a RESET or SEAL that is lost, wrong values after a reset, seal bits
//! that are late, values that the gauge itself rewrites, other versions, a watchdog. A test prints [`Sim::envelope`], so
//! that the same gauge can be drawn again, and sets one behaviour alone by its knob. Without that seed the gauge is
//! friendly: quick, and the same every time. Two knobs are never drawn: `single_byte`, because the simulated bus runs at
//! 100 kHz, and `endurance`.
//!
//! It has limits by intention: it knows no tables of parameters, no names and no units, so that a wrong table of
//! `ti-gauge` cannot agree with a wrong simulator by being the same text. It is no model of a chemistry.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use gauge_bus::Bus;
//! use gauge_bus::clock::{Clock, SimClock};
//! use gauge_sim::{Options, Sim};
//!
//! let clock = Arc::new(SimClock::new());
//! let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a simulated part");
//! clock.sleep(Duration::from_secs(1)); // from power to the first voltage
//! let mut word = [0; 2];
//! sim.bus().transfer(&[0x08], &mut word)?; // Voltage()
//! assert_eq!(u16::from_le_bytes(word), 3855);
//! # Ok::<(), gauge_bus::BusError>(())
//! ```
//!
//! [`Sim`] is the bus with its faults and counters. Behind it is a `device`, the shell that every gauge has, with one
//! of four schemes: `block` access, `mac`, `register` for a gauge without data flash, or `smbus`. The `envelope` has the
//! behaviour of one specimen, a `part` the differences between the parts, and a `model` the gauge's view of its
//! `battery`.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::error::{Error, ErrorKind, Result};
use gauge_bus::{AdapterModel, Bus, BusError, Packet, Reach, wire_bits, wire_bytes};

mod adapter;
mod analog;
mod battery;
mod block;
mod device;
mod envelope;
mod fault;
pub mod firmware;
mod flash;
mod flat;
mod gauging;
mod knob;
mod learning;
mod mac;
mod model;
mod options;
mod part;
mod parts;
mod protector;
mod random;
mod register;
mod rom;
pub mod scenario;
mod seal;
mod smbus;
mod timing;
mod update;
mod watchdog;
mod window;

use adapter::Adapter;
use block::Block;
use device::Gauge;
pub use fault::{FAULTS, FaultWord};
use fault::{Fault, Transfer};
pub use knob::Knob;
use mac::Mac;
pub use options::Options;
use part::{Part, Scheme};
use register::Register;
use scenario::{Player, Scenario};
pub use seal::Level;
use smbus::SmartBattery;

/// What adapters of the kernel answer to what they cannot carry.
const EOPNOTSUPP: i32 = 95;
/// How many transfers the log keeps.
const LOG: usize = 4096;

/// A transfer in the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// When it ended.
    pub at: Duration,
    /// The 7-bit address.
    pub address: u8,
    /// Bytes written, starting with the register.
    pub write: Vec<u8>,
    /// Bytes read.
    pub read: Vec<u8>,
    /// The result that the host got.
    pub result: Result<(), BusError>,
    /// It carried keys, so it is not shown.
    pub secret: bool,
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.secret {
            return f.write_str("; hidden");
        }
        let hex = |f: &mut fmt::Formatter<'_>, bytes: &[u8]| {
            bytes.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
        };
        match (&self.write[..], self.read.len()) {
            ([register], count) if count > 0 => write!(f, "R {register:02X} {count:X}")?,
            ([], count) if count > 0 => write!(f, "R {count:X}")?,
            (write, count) => {
                f.write_str("W")?;
                hex(f, write)?;
                if count > 0 {
                    write!(f, " ; R {count:X}")?;
                }
            }
        }
        match &self.result {
            Ok(()) if self.read.is_empty() => Ok(()),
            Ok(()) => {
                f.write_str(" ->")?;
                hex(f, &self.read)
            }
            Err(BusError::NoAck) => f.write_str(" -> NACK"),
            Err(other) => write!(f, " -> {other:?}"),
        }
    }
}

struct State {
    part: &'static Part,
    options: Options,
    gauge: Gauge,
    /// The present pack's number, and the packs that were exchanged.
    pack: u32,
    others: BTreeMap<u32, Gauge>,
    /// Commits to exchanged packs.
    commits: u64,
    player: Option<Player>,
    counters: Counters,
    log: Option<VecDeque<Record>>,
    /// Nothing on the bus is acknowledged until then.
    silent_until: Duration,
    adapter: Adapter,
}

#[derive(Default)]
struct Counters {
    transfers: u64,
    bytes: u64,
    bits: u64,
    stretched: Duration,
    nacks: u64,
}

impl State {
    fn new(part: &'static Part, options: &Options, now: Duration) -> Result<Self> {
        let gauge = make(part, options, now)?;
        // The state file belongs to the first pack.
        let options = Options { state: None, ..options.clone() };
        let (counters, silent_until) = (Counters::default(), Duration::ZERO);
        let (pack, others, commits, player) = (1, BTreeMap::new(), 0, None);
        let (log, adapter) = (None, Adapter::PLAIN);
        Ok(Self { part, options, gauge, pack, others, commits, player, counters, log, silent_until, adapter })
    }

    fn find(&self, name: &str) -> Option<&'static Knob> {
        knob::KNOBS.iter().find(|knob| knob.name == name && self.gauge.has_knob(knob))
    }

    /// Turns a knob. A bad text changes nothing.
    fn turn(&mut self, knob: &str, text: &str, now: Duration) -> Result<()> {
        match self.find(knob) {
            None => Err(Error::new(knob, ErrorKind::Invalid, "there is no such knob")),
            Some(known) if !known.writable => {
                Err(Error::new(knob, ErrorKind::NotPermitted, "it can only be read"))
            }
            Some(_) if knob == "fault" => self.gauge.plan().set(text),
            // The help has the unit.
            Some(known) => {
                self.gauge.set_knob(knob, text, now).map_err(|error| match error.kind {
                    ErrorKind::Invalid | ErrorKind::OutOfRange => {
                        Error { text: format!("{} ({})", error.text, known.help), ..error }
                    }
                    _ => error,
                })?;
                if let Some(player) = &mut self.player {
                    player.set_speed(self.gauge.speed(), now);
                }
                Ok(())
            }
        }
    }

    /// Performs an act of the scenario.
    fn act(&mut self, knob: &str, text: &str, now: Duration) -> Result<()> {
        match knob {
            scenario::PACK => self.exchange(text, now),
            scenario::FLASH => self.gauge.put_flash(text, now),
            _ => self.turn(knob, text, now),
        }
    }

    /// Performs all acts up to `now`, each at its time.
    fn catch_up(&mut self, now: Duration) {
        loop {
            let commits = self.commits + self.gauge.commits();
            let Some((at, act)) = self.player.as_mut().and_then(|player| player.next(commits, now)) else {
                return;
            };
            // A gauge of this part has accepted it before.
            let _ = self.act(&act.knob, &act.text, at);
        }
    }

    /// Exchanges the pack for another one by number, as it was left or new.
    fn exchange(&mut self, text: &str, now: Duration) -> Result<()> {
        let number = knob::number(scenario::PACK, text, 1.0, 9.0)? as u32;
        if number == self.pack {
            return Ok(());
        }
        let mut next = match self.others.remove(&number) {
            Some(gauge) => gauge,
            None => make(self.part, &self.options, now)?,
        };
        self.gauge.power_off(now, None);
        next.follow(&mut self.gauge, now);
        let before = std::mem::replace(&mut self.gauge, next);
        self.commits += before.commits();
        self.others.insert(self.pack, before);
        self.pack = number;
        Ok(())
    }
}

fn make(part: &'static Part, options: &Options, now: Duration) -> Result<Gauge> {
    let mut gauge = match part.scheme {
        Scheme::Block(scheme) => Block::gauge(part, scheme, options, now),
        Scheme::Mac(scheme) => Mac::gauge(part, scheme, options, now),
        Scheme::Registers(scheme) => Register::gauge(part, scheme, options, now),
        Scheme::Smbus(ti) => SmartBattery::gauge(part, ti, options, now),
    }?;
    options.seal.map_or(Ok(()), |level| gauge.set_level(level))?;
    Ok(gauge)
}

/// A simulated gauge. Clones are the same gauge.
#[derive(Clone)]
pub struct Sim {
    state: Arc<Mutex<State>>,
    clock: Arc<dyn Clock>,
}

impl fmt::Debug for Sim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Sim")
    }
}

impl Sim {
    /// Makes a gauge. With flash it is SEALED, with RAM UNSEALED, unless the options say otherwise. Its pack is one
    /// cell at rest, about 60 % full; a primary cell is new.
    pub fn new(chip: &str, options: &Options, clock: Arc<dyn Clock>) -> Result<Sim> {
        let Some(part) = parts::all().find(|part| part.name == chip) else {
            let known: Vec<&str> = parts::all().map(|part| part.name).collect();
            let text = format!("there is no such gauge to simulate; known are: {}", known.join(", "));
            return Err(Error::new(chip, ErrorKind::Invalid, text));
        };
        let state = State::new(part, options, clock.now())?;
        Ok(Sim { state: Arc::new(Mutex::new(state)), clock })
    }

    /// Checks that a gauge of this chip can keep its flash in that file, as far as possible without a change.
    pub fn check_state(chip: &str, path: &std::path::Path) -> Result<()> {
        let Some(part) = parts::all().find(|part| part.name == chip) else { return Ok(()) };
        let mut flash = flash::Flash::new(part.image);
        flash.firmware = part.firmware();
        flash::Store::new(Some(path.to_path_buf()), part.name).check(&mut flash)
    }

    /// Whether this chip can be simulated.
    pub fn knows(chip: &str) -> bool {
        parts::all().any(|part| part.name == chip)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> MutexGuard<'_, State> {
        let mut state = self.lock();
        state.catch_up(self.clock.now());
        state
    }

    /// A bus to the gauge.
    pub fn bus(&self) -> SimBus {
        self.bus_at(self.lock().part.address())
    }

    /// A bus to another address on the same wires, where usually nothing answers.
    pub fn bus_at(&self, address: u8) -> SimBus {
        SimBus { sim: self.clone(), address, secret: false }
    }

    /// From now on the adapter carries no more than that: it refuses what is longer, and sends nothing of it.
    pub fn set_reach(&self, reach: Reach) {
        self.lock().adapter.narrower = reach;
    }

    /// From now on the gauge is behind an adapter of that model: it carries as much, reports a failure by the same errno, and
    /// gives up as soon on a gauge that holds the clock. Paced, it takes the time of its reports as well.
    pub fn set_adapter(&self, model: &'static AdapterModel, is_paced: bool) {
        self.lock().adapter.become_model(model, is_paced);
    }

    /// The part's knobs, which are the files of `sim/`.
    pub fn knobs(&self) -> Vec<Knob> {
        let state = self.lock();
        knob::KNOBS.iter().copied().filter(|knob| state.gauge.has_knob(knob)).collect()
    }

    /// The text of a knob, if the part has it.
    pub fn get(&self, knob: &str) -> Option<String> {
        let mut state = self.now();
        state.find(knob)?;
        let State { gauge, counters, adapter, .. } = &mut *state;
        Some(match knob {
            "fault" => gauge.plan().to_string(),
            "transfers" => counters.transfers.to_string(),
            "bytes" => counters.bytes.to_string(),
            "bus_us" => (adapter.bit() * counters.bits as u32).as_micros().to_string(),
            "stretched_us" => counters.stretched.as_micros().to_string(),
            "nacks" => counters.nacks.to_string(),
            _ => return gauge.knob(knob, self.clock.now()),
        })
    }

    /// Turns a knob. A bad text changes nothing.
    pub fn set(&self, knob: &str, text: &str) -> Result<()> {
        self.now().turn(knob, text.trim(), self.clock.now())
    }

    /// Makes it stricter than any reported real gauge, to test drivers: it is SEALED, and does not acknowledge its
    /// address while it resets.
    pub fn be_strict(&self) {
        for (knob, text) in [("seal", "sealed"), ("reset_busy", "nack")] {
            // A part without data flash has neither knob.
            let _ = self.set(knob, text);
        }
    }

    /// Plays a scenario from now on, instead of any other. Acts that this part refuses change nothing.
    pub fn play(&self, scenario: Scenario) -> Result<()> {
        let now = self.clock.now();
        let part = self.lock().part;
        let mut rehearsal = State::new(part, &Options::default(), now)?;
        for act in scenario.acts() {
            rehearsal.act(&act.knob, &act.text, now).map_err(|error| {
                let text = format!("{}: {}", error.subject, error.text);
                Error { subject: act.place(), text, ..error }
            })?;
        }
        let mut state = self.lock();
        state.gauge.plan().seed(scenario.seed);
        state.player = Some(Player::new(scenario, now, state.gauge.speed()));
        state.catch_up(now);
        Ok(())
    }

    /// The gauge that [`Options::envelope`] has drawn, in one line: the seed, and the knobs with their present values.
    pub fn envelope(&self) -> String {
        self.lock().gauge.envelope()
    }

    /// All flash, subclass after subclass.
    pub fn flash(&self) -> Vec<u8> {
        self.now().gauge.flash().bytes()
    }

    /// Rows of instruction flash, and data flash as the boot loader has it; `None` if the part's boot loader is not
    /// simulated.
    pub fn firmware(&self) -> Option<(Vec<[u8; 96]>, Vec<u8>)> {
        self.now().gauge.firmware()
    }

    /// Sends a new gauge to ROM mode, as an interrupted firmware update does. Returns whether it is there: that needs a
    /// boot loader and the manual's keys.
    pub fn leave_in_rom(&self) -> bool {
        let mut bus = self.bus();
        // Keys to UNSEALED and FULL ACCESS, and ROM_MODE.
        for word in [0x0414_u16, 0x3672, 0xFFFF, 0xFFFF, 0x0F00] {
            let [low, high] = word.to_le_bytes();
            // The mode shows whether it was acknowledged.
            let _ = bus.transfer(&[0x00, low, high], &mut []);
            self.clock.sleep(Duration::from_millis(100));
        }
        self.get("mode").as_deref() == Some("rom")
    }

    /// Puts bytes into flash without the bus, as a production line's programmer does. `area` is a subclass, or 0 with
    /// offsets from address 0x4000 on.
    pub fn set_flash(&self, area: u16, offset: usize, bytes: &[u8]) {
        self.now().gauge.set_flash(area, offset, bytes);
    }

    /// Switches the log on or off, and empties it.
    pub fn keep_log(&self, on: bool) {
        self.lock().log = on.then(VecDeque::new);
    }

    /// The latest transfers, oldest first; empty if the log is off.
    pub fn log(&self) -> Vec<Record> {
        self.lock().log.iter().flatten().cloned().collect()
    }

    /// Empties the log.
    pub fn clear_log(&self) {
        if let Some(log) = &mut self.lock().log {
            log.clear();
        }
    }
}

/// A [`Bus`] to one address of the simulated bus.
#[derive(Debug)]
pub struct SimBus {
    sim: Sim,
    address: u8,
    secret: bool,
}

struct Direct<'a> {
    sim: &'a Sim,
    address: u8,
    /// A byte after the address was not acknowledged.
    in_data: bool,
}

impl Direct<'_> {
    /// Counts the transfer and lets its time pass. Nothing follows an address that is not acknowledged.
    fn pass(&self, state: &mut State, write: usize, read: usize) {
        let bits = wire_bits(write, read);
        state.counters.transfers += 1;
        state.counters.bytes += wire_bytes(write, read);
        state.counters.bits += bits;
        self.sim.clock.spend(state.adapter.bit() * bits as u32);
    }

    /// Waits while the gauge holds the clock. `false` if the adapter has given up, and then some of what was written may have
    /// arrived. Others can read the knobs meanwhile.
    fn outlasts(&self, hold: Duration, write: &[u8]) -> bool {
        let clock = &*self.sim.clock;
        let (waits, arrives) = {
            let mut state = self.sim.lock();
            let waits = state.adapter.waits(!write.is_empty());
            state.counters.stretched += hold.min(waits);
            let arrives = if hold > waits { state.adapter.give_up(write.len()) } else { 0 };
            (waits, arrives)
        };
        clock.sleep(hold.min(waits));
        if arrives > 0 {
            clock.sleep(hold - waits);
            let state = &mut *self.sim.lock();
            let _ = state.gauge.message(&write[..arrives], &mut [], clock.now());
            self.pass(state, arrives, 0);
            state.gauge.stop(clock.now());
        }
        hold <= waits
    }
}

impl Bus for Direct<'_> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let clock = &*self.sim.clock;
        let mut held = self.sim.lock();
        if clock.now() < held.silent_until {
            self.pass(&mut held, 0, 0);
            return Err(BusError::NoAck);
        }
        let Some(hold) = held.gauge.start(self.address, clock.now()) else {
            self.pass(&mut held, 0, 0);
            return Err(BusError::NoAck);
        };
        if hold > Duration::ZERO {
            drop(held);
            if !self.outlasts(hold, write) {
                return Err(BusError::Timeout);
            }
            held = self.sim.lock();
        }
        // The time depends on what is acknowledged, and the other way round: the gauge sees the end of a transfer in
        // which everything is acknowledged.
        let now = clock.now() + held.adapter.bit() * wire_bits(write.len(), read.len()) as u32;
        let state = &mut *held;
        let result = state.gauge.message(write, read, now);
        match result {
            Ok(()) => self.pass(state, write.len(), read.len()),
            Err(sent) => self.pass(state, sent, 0),
        }
        state.gauge.stop(clock.now());
        self.in_data = result.is_err();
        result.map_err(|_| BusError::NoAck)
    }
}

impl SimBus {
    fn attempt(&self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let clock = &*self.sim.clock;
        let due = {
            let mut state = self.sim.lock();
            if let Some(player) = &mut state.player {
                player.count_transfer();
            }
            state.catch_up(clock.now());
            state.gauge.plan().next(write.len() + read.len())
        };
        let mut direct = Direct { sim: &self.sim, address: self.address, in_data: false };
        let is_held = match due {
            Some(Fault::Transfer(Transfer::Stretch(ms))) => {
                !direct.outlasts(Duration::from_millis(ms), write)
            }
            _ => false,
        };
        let power_off = |back: Option<u64>| {
            self.sim.lock().gauge.power_off(clock.now(), back.map(Duration::from_millis));
        };
        let result = match due {
            _ if is_held => Err(BusError::Timeout),
            Some(Fault::Transfer(fault)) => {
                if matches!(fault, Transfer::Nack(None, _) | Transfer::Arbitration) {
                    direct.pass(&mut self.sim.lock(), 0, 0);
                }
                fault.perform(&mut direct, write, read)
            }
            Some(Fault::PowerCut(back)) => {
                power_off(back);
                direct.transfer(write, read)
            }
            Some(Fault::PowerCutAfter(back)) => {
                let result = direct.transfer(write, read);
                power_off(back);
                result
            }
            Some(Fault::Silence(ms)) => {
                self.sim.lock().silent_until = clock.now() + Duration::from_millis(ms);
                direct.transfer(write, read)
            }
            // The gauge takes these from the plan itself.
            Some(Fault::Commit(_) | Fault::Lost(_)) | None => direct.transfer(write, read),
        };
        let mut state = self.sim.lock();
        let nack_as = state.gauge.nack_as();
        // Steps that wait for a commit follow it directly.
        state.catch_up(clock.now());
        let is_nack = matches!(due, Some(Fault::Transfer(Transfer::Nack(..))));
        if result == Err(BusError::NoAck) || result.is_err() && is_nack {
            state.counters.nacks += 1;
        }
        let adapter = state.adapter;
        drop(state);
        if let Some(Fault::Transfer(Transfer::Stuck(_))) = due {
            clock.sleep(adapter.waits(!write.is_empty()));
        }
        result.map_err(|error| match (adapter.errno(error, due, direct.in_data), error) {
            (Some(errno), _) => errno,
            (None, BusError::NoAck) => nack_as.error(),
            (None, _) => error,
        })
    }

    /// The 7-bit address.
    pub fn address(&self) -> u8 {
        self.address
    }

    /// A transfer as a program of the kernel's interface makes it: what the adapter does not carry is sent in another length if
    /// its model does that, and an error of the model is [`BusError::Other`] with its errno.
    pub fn call(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let adapter = self.sim.lock().adapter;
        let (mut written, mut done) = (0, 0);
        for (wrote, reads) in adapter.parts(write.len(), read.len())? {
            let mut message = write[written..][..wrote].to_vec();
            if let (Some(register), true) = (message.last_mut(), reads > 0) {
                *register = register.wrapping_add(done as u8);
            }
            self.sim.clock.sleep(adapter.pace(wrote, reads));
            self.attempt(&message, &mut read[done..][..reads])?;
            written += if reads > 0 { 0 } else { wrote };
            done += reads;
        }
        Ok(())
    }

    /// A transfer, which the log has with its outcome.
    fn logged(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let begun = self.sim.clock.now();
        let result = self.call(write, read);
        let took = self.sim.clock.now().saturating_sub(begun);
        let mut state = self.sim.lock();
        let result = result.map_err(|error| state.adapter.meant(error, !write.is_empty(), took));
        if let Some(log) = &mut state.log {
            if log.len() == LOG {
                log.pop_front();
            }
            log.push_back(Record {
                at: self.sim.clock.now(),
                address: self.address,
                write: write.to_vec(),
                read: read.to_vec(),
                result,
                secret: self.secret,
            });
        }
        result
    }
}

impl Bus for SimBus {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if !self.reach().carries(write.len(), read.len()) {
            return Err(BusError::Other(EOPNOTSUPP));
        }
        self.logged(write, read)
    }

    fn packet(&mut self, packet: Packet) -> Result<Vec<u8>, BusError> {
        self.reach().check_packet(packet)?;
        let mut bytes =
            vec![0; usize::from(packet.pec) + if packet.is_block { adapter::PACKET - 1 } else { 2 }];
        self.logged(&[packet.code], &mut bytes)?;
        if packet.is_block {
            let length @ 1..=32 = usize::from(bytes[0]) else { return Err(BusError::NO_LENGTH) };
            bytes.truncate(1 + length + usize::from(packet.pec));
        }
        let Some(pec) = packet.pec.then(|| bytes.pop()).flatten() else { return Ok(bytes) };
        let [to, from] = [self.address << 1, self.address << 1 | 1];
        let sum = smbus::crc(&[&[to, packet.code, from], &*bytes].concat());
        if sum == pec { Ok(bytes) } else { Err(BusError::Pec) }
    }

    fn reach(&mut self) -> Reach {
        self.sim.lock().adapter.reach()
    }

    fn set_secret(&mut self, secret: bool) {
        self.secret = secret;
    }
}
