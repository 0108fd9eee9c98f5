// SPDX-License-Identifier: MIT

//! A bus that answers what the input says: everything that reads a gauge or writes to it, in `ti_gauge`.
//!
//! The first byte chooses the chip and the second the access. Then each byte decides about one transfer or more, of a
//! simulated gauge or of nothing at all. Whatever is answered, an access ends in time, and with an error rather than
//! with a panic.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError, Reach};
use gauge_sim::{Options, Sim, SimBus};
use ti_gauge::authentication::Order;
use ti_gauge::chip::{Chip, FLAT, Kind, Subclass, Tier};
use ti_gauge::dataflash::{Change, DataFlash, Decision, Limits, Place};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::{KeyChange, Keys};
use ti_gauge::probe::{self, Target};
use ti_gauge::registers::Registers;

use crate::disk::Memory;
use crate::script::Script;

/// A request is answered within this time, whatever the gauge does.
const ANSWER: Duration = Duration::from_secs(30);
/// Except for a change of keys, because a gauge takes a key only after several seconds of silence.
const KEYS: Duration = Duration::from_secs(180);
/// Transfers of one access; far more than any of them needs.
const TRANSFERS: u64 = 20_000;
/// The longest that an adapter holds a transfer.
const ADAPTER: Duration = Duration::from_secs(1);
/// A transfer of four bytes at 100 kHz.
const TRANSFER: Duration = Duration::from_micros(500);

/// Subclass, offset and text of a value.
type Written = (u8, u16, &'static str);

/// Values to write, by chip.
const CHIPS: [(&str, &[Written]); 6] = [
    ("bq34z100-g1", &[(48, 31, "Pack 7"), (80, 53, "3100"), (48, 11, "2200"), (81, 0, "61")]),
    ("bq27441-g1", &[(82, 10, "1200"), (82, 16, "3100")]),
    ("bq34110", &[(FLAT, 0x41f5, "3100"), (FLAT, 0x40d7, "0x000b")]),
    ("bq27520-g3", &[(48, 10, "1200")]),
    ("bq27427", &[(82, 6, "1200")]),
    ("bq35100", &[(FLAT, 0x41fe, "3100"), (FLAT, 0x41b1, "0x82")]),
];

/// The state of the bus, shared with the check after each access.
struct Wires {
    script: Script,
    transfers: u64,
    /// Transfers that pass unchanged before the next decision.
    passing: u32,
}

struct Hostile {
    sim: SimBus,
    clock: Arc<SimClock>,
    wires: Arc<Mutex<Wires>>,
    /// Without a gauge: every answer is from the input.
    alone: bool,
}

impl Bus for Hostile {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let wires = &mut *self.wires.lock().unwrap_or_else(PoisonError::into_inner);
        wires.transfers += 1;
        assert!(wires.transfers < TRANSFERS, "an access without end");
        if wires.passing > 0 && !self.alone {
            wires.passing -= 1;
            return self.sim.transfer(write, read);
        }
        let script = &mut wires.script;
        if self.alone {
            self.clock.spend(TRANSFER);
            if script.is_over() {
                return Err(BusError::NoAck);
            }
            let decision = script.byte();
            if decision >= 0xe0 {
                return Err(self.fail(decision));
            }
            script.fill(read);
            return Ok(());
        }
        match script.byte() {
            decision @ 0..0x80 => {
                wires.passing = if script.is_over() { u32::MAX } else { decision.into() };
                self.sim.transfer(write, read)
            }
            decision @ 0x80..0xa0 => Err(self.fail(decision)),
            decision @ 0xa0..0xc0 => {
                let _ = self.sim.transfer(write, read);
                Err(self.fail(decision))
            }
            0xc0..0xe0 => {
                self.sim.transfer(write, read)?;
                if !read.is_empty() {
                    let at = script.below(read.len());
                    read[at] ^= script.byte();
                }
                Ok(())
            }
            _ => {
                self.sim.transfer(write, read)?;
                script.fill(read);
                Ok(())
            }
        }
    }
}

impl Hostile {
    fn fail(&self, decision: u8) -> BusError {
        match decision % 8 {
            0..=2 => BusError::NoAck,
            3 => BusError::ArbitrationLost,
            4 => {
                self.clock.spend(ADAPTER);
                BusError::Timeout
            }
            5 => BusError::Short,
            6 => BusError::Other(5),
            _ => BusError::Gone,
        }
    }
}

pub(crate) fn run(input: &[u8]) {
    let mut script = Script::new(input);
    let (first, access) = (script.byte(), script.byte());
    let (name, values) = CHIPS[usize::from(first & 0x7f) % CHIPS.len()];
    let alone = first & 0x80 != 0;
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(name, &Options::default(), clock.clone()).expect("a chip that is simulated");
    clock.sleep(Duration::from_secs(1));
    let chip = Chip::by_name(name).expect("a chip in the tables");
    let wires = Arc::new(Mutex::new(Wires { script, transfers: 0, passing: 0 }));
    let bus = || -> Box<dyn Bus> {
        Box::new(Hostile { sim: sim.bus(), clock: clock.clone(), wires: wires.clone(), alone })
    };
    let timed: Arc<dyn Clock> = clock.clone();
    let takes = if access & 0x80 != 0 { Reach::ONE_BYTE_A_WRITE } else { Reach::FULL };
    let gauge = || Gauge::new(chip, bus(), timed.clone(), Keys::default()).within(takes);
    let disk = Memory::default();
    let dataflash = || DataFlash::new(Limits::default(), Some(disk.journal()));
    let mut engine = Engine { gauge: gauge(), dataflash: dataflash(), clock: &clock, wires: &wires };
    let changes = |count: usize| -> Vec<Change> {
        values.iter().take(count).map(|&(id, offset, value)| change(chip, id, offset, value)).collect()
    };
    match access % 9 {
        0 => {
            let open = || Ok(bus());
            let target = Target { open: &open, clock: &timed, reach: Reach::FULL, clock_hz: None };
            let _ = probe::find("bus", &target);
            let _ = probe::answers_in_rom(&mut *bus());
            let _ = ti_gauge::rom::device(&mut *bus(), &*timed);
        }
        1 => {
            let _ = engine.gauge.identify();
            let mut registers = Registers::unread(chip.registers);
            let _ = registers.read(&mut engine.gauge, |tier| tier != Tier::Window);
            for register in chip.registers.iter().filter(|register| register.tier != Tier::Window) {
                let _ = registers.value(register);
            }
        }
        2 => engine.access(|dataflash, gauge| {
            let readable = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
            let readable: Vec<&Subclass> = readable.take(4).collect();
            let read = dataflash.read(gauge, &readable, Duration::ZERO)?;
            assert!(read.iter().zip(&readable).all(|(bytes, row)| bytes.len() == usize::from(row.stored())));
            Ok(())
        }),
        3 => engine.access(|dataflash, gauge| dataflash.write(gauge, &changes(1), Duration::ZERO).map(drop)),
        4 => engine.access(|dataflash, gauge| dataflash.write(gauge, &changes(4), Duration::ZERO).map(drop)),
        5 => engine.access(|dataflash, gauge| {
            let place = Place { subclass: values[0].0, offset: values[0].1 };
            let raw = Change::raw(chip, place, vec![0x5a])?;
            dataflash.write(gauge, &[raw], Duration::ZERO).map(drop)
        }),
        6 => {
            engine.access(|dataflash, gauge| dataflash.go_to(gauge, Seal::FullAccess, Duration::ZERO));
            engine.access(|dataflash, gauge| dataflash.go_to(gauge, Seal::Sealed, Duration::ZERO));
        }
        7 => engine.access_within(KEYS, |dataflash, gauge| {
            let change = KeyChange::parse(b"unseal 0414 3672 1234 5678").expect("a change of keys");
            dataflash.change_key(gauge, &change, Order::default(), Duration::ZERO)
        }),
        _ => {
            engine.access(|dataflash, gauge| dataflash.write(gauge, &changes(2), Duration::ZERO).map(drop));
            // The host starts again, and a person decides.
            engine.gauge = gauge();
            engine.dataflash = dataflash();
            engine.access(|dataflash, gauge| dataflash.examine(gauge, Duration::ZERO).map(drop));
            let decision =
                [Decision::Undo(None), Decision::Finish(None), Decision::Discard][usize::from(access) % 3];
            engine.access(|dataflash, gauge| dataflash.decide(gauge, decision, Duration::ZERO).map(drop));
        }
    }
    // A change of keys that is neither done nor undone tries keys again.
    let limit = if access % 9 == 7 { KEYS } else { ANSWER };
    for _ in 0..3 {
        engine.access_within(limit, |dataflash, gauge| dataflash.settle(gauge, Duration::ZERO).map(drop));
    }
}

struct Engine<'a> {
    gauge: Gauge,
    dataflash: DataFlash,
    clock: &'a SimClock,
    wires: &'a Mutex<Wires>,
}

impl Engine<'_> {
    fn access(&mut self, access: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<()>) {
        self.access_within(ANSWER, access);
    }

    fn access_within(
        &mut self,
        limit: Duration,
        access: impl FnOnce(&mut DataFlash, &mut Gauge) -> Result<()>,
    ) {
        let start = self.clock.now();
        self.wires.lock().unwrap_or_else(PoisonError::into_inner).transfers = 0;
        let outcome = access(&mut self.dataflash, &mut self.gauge);
        let time = self.clock.now() - start;
        assert!(time <= limit, "answered after {time:?}: {outcome:?}");
    }
}

fn change(chip: &'static Chip, id: u8, offset: u16, value: &str) -> Change {
    let mut alike = chip.subclasses.iter().filter(|row| row.id == id);
    let row = alike.find_map(|row| Some((row, row.parameter(offset)?))).expect("a parameter of the table");
    Change::parse(chip, row, value.as_bytes(), true).expect("a value in range")
}
