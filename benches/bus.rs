//! What a gauge costs on the bus: one full poll of each chip beside the kernel's driver, and a write.
//!
//!     cargo bench --bench bus
//!
//! Bytes include the address byte of each direction; a bit time is 10 µs at 100 kHz. The kernel's counts
//! are those of `bq27xxx_battery` for one reading of all its properties, a transfer a register.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{wire_bits, wire_bytes};
use gaugefs::sim::{Options, Sim};
use ti_gauge::chip::{CHIPS, Chip, Kind, Parameter, Scheme, Tier};
use ti_gauge::codec::{self, WINDOW};
use ti_gauge::dataflash::{Change, DataFlash, Outcome, Place};
use ti_gauge::gauge::{Gauge, Seal, bursts};
use ti_gauge::keys::Keys;
use ti_gauge::value::Value;

/// Transfers and bytes of the kernel's driver, where it has one for the part.
const KERNEL: &[(&str, u64, u64)] =
    &[("bq34z100-g1", 16, 79), ("bq27520-g3", 16, 80), ("bq27441-g1", 11, 55)];

fn main() {
    println!("one full poll   transfers  bytes  bit times    kernel: transfers  bytes");
    for chip in CHIPS {
        let polled = bursts(chip.registers, |tier| tier == Tier::Poll);
        let bytes: u64 = polled.iter().map(|&(_, length)| wire_bytes(1, length.into())).sum();
        let bits: u64 = polled.iter().map(|&(_, length)| wire_bits(1, length.into())).sum();
        print!("{:14} {:10}  {bytes:5}  {bits:9}", chip.name, polled.len());
        match KERNEL.iter().find(|(name, ..)| *name == chip.name) {
            Some((_, transfers, bytes)) => println!("  {transfers:19}  {bytes:5}"),
            None => println!("  {:>19}  {:>5}", "-", "-"),
        }
    }
    println!("\none parameter written, found     transfers  bytes");
    for chip in CHIPS {
        for found in [Seal::Sealed, Seal::Unsealed] {
            if let Some((transfers, bytes, _)) = write(chip, found) {
                println!("{:22} {:9} {transfers:9}  {bytes:5}", chip.name, found.as_str());
            }
        }
    }
    println!("\na whole image, found sealed  blocks  transfers  bytes  a block  needed  ratio  takes");
    for chip in CHIPS {
        let (Some(whole), Some(one)) = (image(chip), write(chip, Seal::Sealed)) else { continue };
        let Whole { blocks, transfers, bytes, reset, time } = whole;
        let a_block = |reset| A_BLOCK + if reset { AFTER_A_RESET } else { 0 };
        let again = if chip.access.scheme == Scheme::Mac { 0 } else { SELECTED_AGAIN };
        // The visit costs what a write of one parameter does beside its block, which stays in the window.
        let (needed, visit) = (a_block(reset) + again, one.0 - a_block(one.2));
        println!(
            "{:27} {blocks:7} {transfers:10} {bytes:6} {:8.2} {needed:7} {:6.2} {:4.1} s",
            chip.name,
            (transfers - visit) as f64 / blocks as f64,
            transfers as f64 / (blocks * needed + visit) as f64,
            time.as_secs_f64()
        );
    }
}

/// Transfers that a block needs however it is done: select and read it, write, checksum, select and read what
/// is stored.
const A_BLOCK: u64 = 6;
/// All old blocks are on disk before the first one is touched, so where a block has to be in the window to be
/// written it is selected a second time.
const SELECTED_AGAIN: u64 = 1;
/// Where its class takes a reset, it is selected and read once more after it.
const AFTER_A_RESET: u64 = 2;

/// A simulated gauge, awake, in that seal state, and the engine.
fn rig(chip: &'static Chip, found: Seal) -> Option<(Arc<SimClock>, Gauge, DataFlash)> {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip.name, &Options::default(), clock.clone()).ok()?;
    let mut gauge = Gauge::new(chip, Box::new(sim.bus()), clock.clone(), Keys::default(), false);
    clock.sleep(Duration::from_secs(2));
    let mut dataflash = DataFlash::default();
    dataflash.go_to(&mut gauge, found, Duration::ZERO).ok()?;
    Some((clock, gauge, dataflash))
}

/// Transfers and bytes so far.
fn cost(gauge: &Gauge) -> (u64, u64) {
    let list = gauge.statistics.list();
    let find = |wanted| list.iter().find(|(name, _)| *name == wanted).map_or(0, |(_, count)| *count);
    (find("transfers"), find("bytes"))
}

/// What a write that changes every block has cost.
struct Whole {
    blocks: u64,
    transfers: u64,
    bytes: u64,
    reset: bool,
    time: Duration,
}

/// One bit more or less in one parameter of every block, written as one.
fn image(chip: &'static Chip) -> Option<Whole> {
    let (clock, mut gauge, mut dataflash) = rig(chip, Seal::Sealed)?;
    let mut changes: Vec<Change> = Vec::new();
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        let bytes = dataflash.read(&mut gauge, &[subclass], Duration::ZERO).ok()?.remove(0);
        let block = |one: &Parameter| usize::from(one.offset - subclass.start()) / WINDOW;
        let may = |one: &&Parameter| {
            let last = usize::from(one.offset - subclass.start()) + one.kind.size() - 1;
            one.safe.is_none() && one.kind.bounds().is_some() && last / WINDOW == block(one)
        };
        // What the gauge rewrites itself only where a block holds nothing else.
        let mut rows: Vec<_> = subclass.parameters.iter().filter(may).collect();
        rows.sort_by_key(|one| (block(one), one.learned));
        rows.dedup_by_key(|one| block(one));
        for parameter in rows {
            let at = usize::from(parameter.offset - subclass.start());
            let mut bytes = bytes[at..at + parameter.kind.size()].to_vec();
            *bytes.last_mut()? ^= 1;
            let place = Place { subclass: subclass.id, offset: parameter.offset };
            changes.push(Change { place, bytes, row: Some((subclass, parameter)), saved: false });
        }
    }
    let (before, begun) = (cost(&gauge), clock.now());
    let written = dataflash.write(&mut gauge, &changes, Duration::ZERO);
    let outcome = written.map_err(|error| println!("{}: {error}", chip.name)).ok()?;
    let after = cost(&gauge);
    let list = gauge.statistics.list();
    let blocks = list.iter().find(|(name, _)| *name == "flash_writes")?.1;
    let (transfers, bytes) = (after.0 - before.0, after.1 - before.1);
    let reset = outcome == Outcome::Written { reset: true };
    Some(Whole { blocks, transfers, bytes, reset, time: clock.now() - begun })
}

/// Adds one to the first parameter of two bytes that may be written: transfers, bytes, and whether it took a
/// reset.
fn write(chip: &'static Chip, found: Seal) -> Option<(u64, u64, bool)> {
    let (_, mut gauge, mut dataflash) = rig(chip, found)?;
    let rows = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |one| (row, one)));
    let plain = |one: &ti_gauge::chip::Parameter| {
        one.kind.size() == 2 && one.safe.is_none() && !one.unproven && !one.learned
    };
    let (subclass, parameter) = rows.into_iter().find(|(_, one)| plain(one))?;
    let bytes = dataflash.read(&mut gauge, &[subclass], Duration::ZERO).ok()?.remove(0);
    let at = usize::from(parameter.offset - subclass.start());
    let Value::Int(value) = codec::decode(parameter.kind, &bytes[at..at + 2]) else { return None };
    let change = Change::of_value((subclass, parameter), &Value::Int(value + 1))?;
    let before = cost(&gauge);
    let written = dataflash.write(&mut gauge, &[change], Duration::ZERO);
    let outcome = written.map_err(|error| println!("{}: {error}", chip.name)).ok()?;
    let after = cost(&gauge);
    Some((after.0 - before.0, after.1 - before.1, outcome == Outcome::Written { reset: true }))
}
