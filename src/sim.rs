//! The simulated gauge: a [`Bus`] with a believable part, its data flash and a battery behind it.
//!
//! It knows bytes and protocol and is written from the manuals alone. It never looks at the tables of
//! `crate::chip`, so that a wrong table cannot agree with a wrong simulator.

use std::collections::VecDeque;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::bus::{Bus, BusError, GAUGE_ADDRESS, wire_bits, wire_bytes};
use crate::clock::Clock;
use crate::error::{Cause, Error, Result};

mod battery;
mod block;
mod bq27427;
mod bq27441_g1;
mod bq27520_g3;
mod bq34110;
mod bq34z100_g1;
mod bq35100;
pub mod fault;
mod flash;
mod gauging;
mod knob;
mod mac;
mod seal;
mod update;
mod window;

use fault::{ADAPTER_WAITS, Fault, Inside, Plan, Wire};
use flash::Flash;
pub use knob::Knob;

/// One bit at 100 kHz.
const BIT: Duration = Duration::from_micros(10);
/// Transfers that the log keeps.
const LOG: usize = 4096;

static PARTS: &[&block::Part] =
    &[&bq34z100_g1::PART, &bq27520_g3::PART, &bq27441_g1::PART, &bq27441_g1::BQ27421, &bq27427::PART];
static MAC_PARTS: &[&mac::Part] = &[&bq34110::PART, &bq35100::PART];

/// How a simulated gauge is made.
#[derive(Clone, Default)]
pub struct Options {
    /// File that keeps the flash across processes; made where there is none.
    pub state: Option<PathBuf>,
    /// The key that unseals, in the order its words are sent, for a gauge that is new.
    pub unseal_key: Option<[u16; 2]>,
    /// For what is random: faults, and offsets of the part.
    pub seed: u64,
}

impl fmt::Debug for Options {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { state, unseal_key, seed } = self;
        let key = unseal_key.map(|_| "hidden");
        f.debug_struct("Options").field("state", state).field("unseal_key", &key).field("seed", seed).finish()
    }
}

/// A gauge at the level of the wire. The bus asks it byte by byte.
trait Chip: Send {
    /// START and address: `None` is no acknowledgement, else how long the clock is held.
    fn start(&mut self, address: u8, now: Duration) -> Option<Duration>;
    /// Whether a command byte is acknowledged.
    fn has(&self, register: u8) -> bool;
    /// Whether a message that began lower may go on with `register`.
    fn extends(&self, register: u8) -> bool;
    /// A data byte; whether it is acknowledged.
    fn write(&mut self, register: u8, byte: u8, plan: &mut Plan, now: Duration) -> bool;
    /// The byte at `register`.
    fn read(&mut self, register: u8, now: Duration) -> u8;
    /// STOP.
    fn stop(&mut self, now: Duration);
    /// Power is lost, for some time or until it is switched on.
    fn power_off(&mut self, now: Duration, back: Option<Duration>);
    fn flash(&self) -> &Flash;
    fn knob(&mut self, name: &str, now: Duration) -> Option<String>;
    fn set_knob(&mut self, name: &str, text: &str, now: Duration) -> Result<()>;
}

/// A transfer as it passed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// When it ended.
    pub at: Duration,
    /// The 7-bit address.
    pub address: u8,
    /// Bytes written, the register first.
    pub write: Vec<u8>,
    /// Bytes read.
    pub read: Vec<u8>,
    /// What the host was told.
    pub result: Result<(), BusError>,
    /// The host said that it carries keys: it is not shown.
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
    chip: Box<dyn Chip>,
    plan: Plan,
    pointer: u8,
    transfers: u64,
    bytes: u64,
    bits: u64,
    stretched: Duration,
    nacks: u64,
    log: Option<VecDeque<Record>>,
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
    /// A gauge: SEALED, its pack of one cell at rest and about 60 % full; a primary cell is new.
    pub fn new(chip: &str, options: &Options, clock: Arc<dyn Clock>) -> Result<Sim> {
        let now = clock.now();
        let chip: Box<dyn Chip> = if let Some(part) = PARTS.iter().find(|part| part.name == chip) {
            Box::new(block::Gauge::new(part, options, now)?)
        } else if let Some(part) = MAC_PARTS.iter().find(|part| part.name == chip) {
            Box::new(mac::Gauge::new(part, options, now)?)
        } else {
            let names = PARTS.iter().map(|part| part.name).chain(MAC_PARTS.iter().map(|part| part.name));
            let known: Vec<&str> = names.collect();
            let text = format!("there is no such gauge to simulate; known are: {}", known.join(", "));
            return Err(Error::new(chip, Cause::Invalid(text)));
        };
        let state = State {
            chip,
            plan: Plan::new(options.seed),
            pointer: 0,
            transfers: 0,
            bytes: 0,
            bits: 0,
            stretched: Duration::ZERO,
            nacks: 0,
            log: None,
        };
        Ok(Sim { state: Arc::new(Mutex::new(state)), clock })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A way to the gauge.
    pub fn bus(&self) -> SimBus {
        self.bus_at(GAUGE_ADDRESS)
    }

    /// A way to another address of the same bus, where usually nothing answers.
    pub fn bus_at(&self, address: u8) -> SimBus {
        SimBus { sim: self.clone(), address, secret: false }
    }

    /// The files of `sim/`: those that the part has.
    pub fn knobs(&self) -> Vec<Knob> {
        knob::KNOBS.iter().copied().filter(|knob| self.get(knob.name).is_some()).collect()
    }

    /// What a knob shows; `None` where there is none of that name.
    pub fn get(&self, knob: &str) -> Option<String> {
        let mut state = self.lock();
        Some(match knob {
            "fault" => state.plan.to_string(),
            "transfers" => state.transfers.to_string(),
            "bytes" => state.bytes.to_string(),
            "bus_us" => (state.bits * BIT.as_micros() as u64).to_string(),
            "stretched_us" => state.stretched.as_micros().to_string(),
            "nacks" => state.nacks.to_string(),
            _ => return state.chip.knob(knob, self.clock.now()),
        })
    }

    /// Turns a knob. A text that is not understood changes nothing.
    pub fn set(&self, knob: &str, text: &str) -> Result<()> {
        let text = text.trim();
        let mut state = self.lock();
        let now = self.clock.now();
        match knob::KNOBS.iter().find(|known| known.name == knob) {
            Some(known) if !known.writable => Err(knob::read_only(knob)),
            Some(_) if knob == "fault" => state.plan.set(text),
            Some(_) if state.chip.knob(knob, now).is_some() => state.chip.set_knob(knob, text, now),
            _ => Err(Error::new(knob, Cause::Invalid("there is no such knob".into()))),
        }
    }

    /// All flash, subclass after subclass: what tests compare.
    pub fn flash(&self) -> Vec<u8> {
        self.lock().chip.flash().bytes()
    }

    /// Switches the log on or off; it starts empty.
    pub fn keep_log(&self, on: bool) {
        self.lock().log = on.then(VecDeque::new);
    }

    /// The latest transfers, oldest first; none while the log is off.
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

/// A [`Bus`] to one address of the simulated gauge's bus.
#[derive(Debug)]
pub struct SimBus {
    sim: Sim,
    address: u8,
    secret: bool,
}

/// The bus without faults.
struct Direct<'a> {
    sim: &'a Sim,
    address: u8,
}

impl Direct<'_> {
    /// Counts what passed, and lets its time pass. Without an acknowledged address nothing follows it.
    fn pass(&self, state: &mut State, write: usize, read: usize) -> Duration {
        let bits = wire_bits(write, read);
        state.transfers += 1;
        state.bytes += wire_bytes(write, read);
        state.bits += bits;
        self.sim.clock.spend(BIT * bits as u32);
        self.sim.clock.now()
    }
}

impl Bus for Direct<'_> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let clock = &*self.sim.clock;
        let mut held = self.sim.lock();
        let Some(hold) = held.chip.start(self.address, clock.now()) else {
            self.pass(&mut held, 0, 0);
            return Err(BusError::NoAck);
        };
        if hold > Duration::ZERO {
            held.stretched += hold.min(ADAPTER_WAITS);
            // Its knobs can be read meanwhile, by a thread that serves other gauges as well.
            drop(held);
            clock.sleep(hold.min(ADAPTER_WAITS));
            if hold > ADAPTER_WAITS {
                return Err(BusError::Timeout);
            }
            held = self.sim.lock();
        }
        // What is acknowledged has to be known before its time can pass, and the register after it.
        let now = clock.now() + BIT * wire_bits(write.len(), read.len()) as u32;
        let state = &mut *held;
        let mut sent = 0;
        let mut acknowledged = true;
        if let Some((&register, data)) = write.split_first() {
            sent = 1;
            acknowledged = state.chip.has(register);
            if acknowledged {
                state.pointer = register;
            }
            for (at, &byte) in data.iter().enumerate() {
                if !acknowledged {
                    break;
                }
                sent += 1;
                let to = state.pointer;
                acknowledged =
                    (at == 0 || state.chip.extends(to)) && state.chip.write(to, byte, &mut state.plan, now);
                if acknowledged {
                    state.pointer = next(to);
                }
            }
        }
        if acknowledged {
            for byte in read.iter_mut() {
                *byte = state.chip.read(state.pointer, now);
                state.pointer = next(state.pointer);
            }
        }
        let now = self.pass(state, sent, if acknowledged { read.len() } else { 0 });
        state.chip.stop(now);
        if acknowledged { Ok(()) } else { Err(BusError::NoAck) }
    }
}

/// The address pointer goes from 0x7F to 0x00 (SLUSBZ5D figure 7-6).
fn next(register: u8) -> u8 {
    (register + 1) & 0x7F
}

impl SimBus {
    fn attempt(&self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let clock = &*self.sim.clock;
        let due = self.sim.lock().plan.next(write.len() + read.len());
        // Waits of the bus pass while nobody holds the gauge, so that its knobs can still be read.
        if let Some(Fault::Wire(Wire::Stretch(ms))) = due {
            let hold = Duration::from_millis(ms).min(ADAPTER_WAITS);
            clock.sleep(hold);
            self.sim.lock().stretched += hold;
        }
        let mut direct = Direct { sim: &self.sim, address: self.address };
        let power_off = |back: Option<u64>| {
            self.sim.lock().chip.power_off(clock.now(), back.map(Duration::from_millis));
        };
        let result = match due {
            None => direct.transfer(write, read),
            Some(Fault::Wire(wire)) => {
                if matches!(wire, Wire::Nack(None) | Wire::Arbitration) {
                    direct.pass(&mut self.sim.lock(), 0, 0);
                }
                wire.perform(&mut direct, write, read)
            }
            Some(Fault::Inside(Inside::PowerCut(back))) => {
                power_off(back);
                direct.transfer(write, read)
            }
            Some(Fault::Inside(Inside::PowerCutAfter(back))) => {
                let result = direct.transfer(write, read);
                power_off(back);
                result
            }
            // Those wait for a commit, which takes them from the plan itself.
            Some(Fault::Inside(_)) => direct.transfer(write, read),
        };
        if result == Err(BusError::NoAck) {
            self.sim.lock().nacks += 1;
        }
        if let Some(Fault::Wire(Wire::Stuck(_))) = due {
            clock.sleep(ADAPTER_WAITS);
        }
        result
    }
}

impl Bus for SimBus {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let result = self.attempt(write, read);
        let mut state = self.sim.lock();
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

    fn set_secret(&mut self, secret: bool) {
        self.secret = secret;
    }
}
