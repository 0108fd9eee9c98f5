//! What a gauge costs on the bus: one full poll of each chip beside the kernel's driver, and a write.
//!
//!     cargo bench --bench bus
//!
//! Bytes include the address byte of each direction; a bit time is 10 µs at 100 kHz. The kernel's counts
//! are those of `bq27xxx_battery` for one reading of all its properties, a transfer a register.

use std::sync::Arc;
use std::time::Duration;

use gaugefs::bus::{wire_bits, wire_bytes};
use gaugefs::chip::{CHIPS, Chip, Tier};
use gaugefs::clock::{Clock, SimClock};
use gaugefs::codec;
use gaugefs::dataflash::{Change, DataFlash};
use gaugefs::gauge::{Gauge, Seal, bursts};
use gaugefs::keys::Keys;
use gaugefs::sim::{Options, Sim};
use gaugefs::value::Value;

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
            if let Some((transfers, bytes)) = write(chip, found) {
                println!("{:22} {:9} {transfers:9}  {bytes:5}", chip.name, found.as_str());
            }
        }
    }
}

/// Adds one to the first parameter of two bytes that may be written.
fn write(chip: &'static Chip, found: Seal) -> Option<(u64, u64)> {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip.name, &Options::default(), clock.clone()).ok()?;
    let mut gauge = Gauge::new(chip, Box::new(sim.bus()), clock.clone(), Keys::default(), false);
    clock.sleep(Duration::from_secs(2));
    let mut dataflash = DataFlash::default();
    dataflash.go_to(&mut gauge, found, Duration::ZERO).ok()?;
    let rows = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |one| (row, one)));
    let plain = |one: &gaugefs::chip::Parameter| {
        one.kind.size() == 2 && one.safe.is_none() && !one.unproven && !one.learned
    };
    let (subclass, parameter) = rows.into_iter().find(|(_, one)| plain(one))?;
    let bytes = dataflash.read(&mut gauge, &[subclass], Duration::ZERO).ok()?.remove(0);
    let at = usize::from(parameter.offset - subclass.start());
    let Value::Int(value) = codec::decode(parameter.kind, &bytes[at..at + 2]) else { return None };
    let change = Change {
        subclass,
        parameter,
        bytes: codec::encode(parameter.kind, &Value::Int(value + 1))?,
        saved: false,
    };
    let cost = |gauge: &Gauge| {
        let list = gauge.statistics.list();
        let find = |wanted| list.iter().find(|(name, _)| *name == wanted).map_or(0, |(_, count)| *count);
        (find("transfers"), find("bytes"))
    };
    let before = cost(&gauge);
    let written = dataflash.write(&mut gauge, &[change], Duration::ZERO);
    written.map_err(|error| println!("{}: {error}", chip.name)).ok()?;
    let after = cost(&gauge);
    Some((after.0 - before.0, after.1 - before.1))
}
