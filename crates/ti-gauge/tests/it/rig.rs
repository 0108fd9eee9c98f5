// SPDX-License-Identifier: MIT

//! A simulated gauge on a simulated clock, and the engine on its bus.

use std::cell::Cell;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{AdapterModel, Reach};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::{CHIPS, Chip, FLAT, Parameter, Subclass};
use ti_gauge::codec;
use ti_gauge::dataflash::{Change, DataFlash, Outcome, Row};
use ti_gauge::error::{Error, Result};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

/// A message with all of a block.
const WHOLE: u16 = 33;

/// An adapter in front of the simulated gauges: the model of a real one, or of none, and what it carries at most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Adapter {
    model: Option<&'static AdapterModel>,
    reach: Reach,
}

impl Adapter {
    const PLAIN: Self = Self { model: None, reach: Reach::FULL };

    /// One of no model by seed, with lengths around those of a block, down to words.
    pub(crate) fn narrow(seed: u64) -> Self {
        Self { model: None, reach: narrow(&mut Random(seed ^ DRAWN)) }
    }

    /// One by seed: most are models, and many of these are narrower as well. A bridge that is slow is not: all of data flash would
    /// take it more than the time of an access.
    pub(crate) fn drawn(seed: u64) -> Self {
        let random = &mut Random(seed ^ DRAWN);
        let reach = narrow(random);
        let models: Vec<_> = AdapterModel::all().collect();
        let model = (random.below(4) > 0).then(|| *random.pick(&models));
        let is_slow = model.is_some_and(|model| !model.pace(1, 2).is_zero());
        let is_narrow = model.is_none() || !is_slow && random.below(2) == 0;
        Self { model, reach: if is_narrow { reach } else { Reach::FULL } }
    }

    /// The model of that name.
    pub(crate) fn of(name: &str) -> Self {
        Self { model: AdapterModel::by_name(name), ..Self::PLAIN }
    }

    pub(crate) fn reach(self) -> Reach {
        self.model.map_or(Reach::FULL, AdapterModel::reach).narrowed(self.reach)
    }

    /// Puts it in front of a gauge. Data flash of most parts cannot be written in pieces: they get one that carries a block.
    pub(crate) fn lead_to(self, sim: &Sim, chip: &Chip) {
        let least = if chip.byte_writes_above_hz.is_some() { 0 } else { WHOLE };
        if let Some(model) = self.model.filter(|model| model.reach().write >= least) {
            sim.set_adapter(model, true);
        }
        sim.set_reach(Reach { write: self.reach.write.max(least), ..self.reach });
    }
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Reach { read, smbus, .. } = self.reach();
        let kind = if smbus { "SMBus" } else { "I2C" };
        write!(f, "{}, {kind} of {read} bytes", self.model.map_or("any", |model| model.name))
    }
}

const DRAWN: u64 = 0x0ada_97e2;

fn narrow(random: &mut Random) -> Reach {
    let data = *random.pick(&[2, 2, 3, 8, 16, 31, 32, 33, 60]);
    if random.below(3) == 0 { Reach::smbus(data.min(32), false) } else { Reach::of_data(data) }
}

thread_local! {
    static ADAPTER: Cell<Adapter> = const { Cell::new(Adapter::PLAIN) };
}

/// The adapter of this thread's simulated gauges.
pub(crate) fn adapter() -> Adapter {
    ADAPTER.get()
}

/// Sets it, from now on.
pub(crate) fn set_adapter(adapter: Adapter) {
    ADAPTER.set(adapter);
}

pub(crate) struct Rig {
    pub(crate) clock: Arc<SimClock>,
    pub(crate) sim: Sim,
    pub(crate) gauge: Gauge,
    pub(crate) dataflash: DataFlash,
}

/// The first address of the flat data flash that is simulated.
pub(crate) fn first_address(chip: &Chip) -> usize {
    if chip.access.scheme.is_ram() { 0x9180 } else { 0x4000 }
}

impl Rig {
    pub(crate) fn new(chip: &str) -> Self {
        Self::with(chip, Keys::default(), Reach::FULL)
    }

    pub(crate) fn with(chip: &str, keys: Keys, reach: Reach) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("a chip that is simulated");
        let table = Chip::by_name(chip).expect("a chip in the tables");
        sim.be_strict();
        adapter().lead_to(&sim, table);
        sim.keep_log(true);
        let mut gauge = Gauge::new(table, Box::new(sim.bus()), clock.clone(), keys).within(reach);
        // A gauge answers about 250 ms after power-up.
        clock.sleep(Duration::from_secs(1));
        // The state after the first poll.
        gauge.seal().expect("the gauge answers");
        Self { clock, sim, gauge, dataflash: DataFlash::default() }
    }

    /// The engine on a gauge that is there already.
    pub(crate) fn on(table: &'static Chip, sim: Sim, clock: Arc<SimClock>) -> Self {
        let gauge = Gauge::new(table, Box::new(sim.bus()), clock.clone(), Keys::default());
        Self { clock, sim, gauge, dataflash: DataFlash::default() }
    }

    /// A gauge that is found in the given seal state.
    pub(crate) fn found(chip: &str, found: Seal) -> Self {
        let mut rig = Self::new(chip);
        if found != Seal::Sealed {
            rig.dataflash.go_to(&mut rig.gauge, found, Duration::ZERO).expect("the default keys");
        }
        rig
    }

    /// A pack that can be told from others: its temperature offset has been calibrated.
    pub(crate) fn calibrated(chip: &str, found: Seal) -> Self {
        let rig = Self::found(chip, found);
        rig.calibrate(3);
        rig
    }

    /// Calibrates its temperature offset.
    pub(crate) fn calibrate(&self, offset: u8) {
        let marks = self.gauge.chip.preflight.marks.iter();
        let rows = marks.map(|&(id, offset)| (id, offset, self.find(id, offset).1));
        let mut rows = rows.filter(|(_, _, parameter)| {
            ["Int Temp Offset", "Internal Temp Offset"].contains(&parameter.name)
        });
        let (id, at, _) = rows.next().expect("every part has one");
        let at = usize::from(at) - if id == FLAT { first_address(self.gauge.chip) } else { 0 };
        self.sim.set_flash(id.into(), at, &[offset]);
    }

    /// A parameter and its subclass; on a part without subclasses, `FLAT` and an address.
    fn find(&self, subclass: u8, offset: u16) -> (&'static Subclass, &'static Parameter) {
        Self::find_in(self.gauge.chip, subclass, offset)
    }

    fn find_in(chip: &'static Chip, subclass: u8, offset: u16) -> (&'static Subclass, &'static Parameter) {
        let mut alike = chip.subclasses.iter().filter(|row| row.id == subclass);
        let found = alike.find_map(|row| Some((row, row.parameter(offset)?)));
        found.expect("a parameter of the table")
    }

    /// The change that `echo text > df/subclass/offset` requests.
    pub(crate) fn change(&self, subclass: u8, offset: u16, text: &str) -> Change {
        Self::change_of(self.gauge.chip, subclass, offset, text)
    }

    pub(crate) fn change_of(chip: &'static Chip, subclass: u8, offset: u16, text: &str) -> Change {
        let (subclass, parameter) = Self::find_in(chip, subclass, offset);
        Change::parse(chip, (subclass, parameter), text.as_bytes(), true).expect("a value in range")
    }

    /// Writes a parameter. The outcome is without the bytes that it replaced, so that tests can compare it.
    pub(crate) fn write(&mut self, subclass: u8, offset: u16, text: &str) -> Result<Outcome> {
        let row = self.find(subclass, offset);
        let change = Change::parse(self.gauge.chip, row, text.as_bytes(), true)?;
        self.dataflash.write(&mut self.gauge, &[change], Duration::ZERO).map(without_old)
    }

    /// The bytes of a parameter, read through the engine.
    pub(crate) fn read(&mut self, subclass: u8, offset: u16) -> Result<Vec<u8>> {
        let (row, parameter) = self.find(subclass, offset);
        let bytes = self.dataflash.read(&mut self.gauge, &[row], Duration::ZERO)?.remove(0);
        let at = usize::from(offset - row.start());
        Ok(bytes[at..at + parameter.kind.size()].to_vec())
    }

    pub(crate) fn seal(&mut self) -> Seal {
        self.gauge.seal().expect("the gauge answers")
    }

    /// Transfers and bytes since the last call, retries included.
    pub(crate) fn cost(&self) -> (u64, u64) {
        let list = self.gauge.statistics.list();
        let find = |name| list.iter().find(|(found, _)| *found == name).map_or(0, |(_, value)| *value);
        (find("transfers"), find("bytes"))
    }

    /// The transfers since the log was last cleared, one per line.
    pub(crate) fn log(&self) -> Vec<String> {
        self.sim.log().iter().map(ToString::to_string).collect()
    }
}

/// The outcome without the bytes that the write replaced.
pub(crate) fn without_old(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Written { reset, .. } => Outcome::Written { reset, old: Vec::new() },
        Outcome::Unchanged => Outcome::Unchanged,
    }
}

/// The name of the error's cause.
pub(crate) fn cause(error: &Error) -> &'static str {
    error.cause().name()
}

/// Another value for a parameter that has these bytes, near the old one; `None` if its range has no other.
pub(crate) fn another((subclass, parameter): Row, old: &[u8]) -> Option<Change> {
    let mut changes = (0..8).filter_map(|bit| {
        let mut bytes = old.to_vec();
        *bytes.last_mut()? ^= 1 << bit;
        // The layout of the parts with this engine's tests.
        Change::of_value(
            CHIPS[0],
            (subclass, parameter),
            &codec::Layout::TI.decode(parameter.kind, &bytes),
            true,
        )
        .ok()
    });
    changes.find(|change| change.bytes() != old)
}

/// A small generator, so that a seed means the same everywhere.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, limit: u64) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ mixed >> 31) % limit
    }

    pub(crate) fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len() as u64) as usize]
    }
}
