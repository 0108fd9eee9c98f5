// SPDX-License-Identifier: MIT

//! What each gauge costs on the bus: one full poll compared with the kernel's driver, one changed parameter,
//! and an image that changes every block.
//!
//!     cargo bench --bench bus
//!
//! Costs are transfers and bytes, the address byte of each direction included. A parameter's cost is that of the
//! costliest parameter of the chip, all checks and the journal included: first the first write of a mount to a
//! sealed gauge, then a later one to a gauge found unsealed. The budgets of the bq34z100-G1 are promises.
//!
//! Beside it, what a word takes that another program reads on the bus of `gaugefs sim`. `tests/vm/run bq34z100-g1` compares that
//! with an adapter of the kernel.

use std::collections::HashMap;
use std::env;
use std::error::Error;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::time::{Duration, Instant};

use gauge_bus::bounded::Bounded;
use gauge_bus::clock::{Clock, RealClock, SimClock};
use gauge_bus::{Bus, BusError, wire_bytes};
use gauge_sim::{Options, Sim};
use i2cdev::core::I2CDevice;
use i2cdev::linux::LinuxI2CDevice;
use ti_gauge::chip::bursts;
use ti_gauge::chip::{CHIPS, Chip, Kind, Parameter, Scheme, Tier};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, DataFlash, Limits, Outcome, Row};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;
use ti_gauge::value::Value;

mod report;
use report::Report;

/// What the kernel's `bq27xxx_battery` spends on one reading of all its properties, where it has a driver for the
/// part: a transfer for each register that its source lists for the part.
const KERNEL: &[(&str, Cost)] = &[
    ("bq34z100-g1", Cost::of(16, 79)),
    ("bq27520-g3", Cost::of(16, 80)),
    ("bq27441-g1", Cost::of(11, 55)),
    ("bq27421-g1", Cost::of(11, 55)),
];

/// The chip with budgets.
const BUDGETED: &str = "bq34z100-g1";
const POLL: Cost = Cost::of(3, 43);
const FIRST: Cost = Cost::of(52, 700);
const LATER: Cost = Cost::of(44, 590);

/// Subcommand and parameter that put the pack of a bq34z100-G1 into service (SLUSBZ5D 7.3.1.2 and table 7-16).
const IT_ENABLE: u16 = 0x0021;
const UPDATE_STATUS: (u8, u16) = (82, 4);

/// What something has cost on the bus.
#[derive(Clone, Copy, Default)]
struct Cost {
    transfers: u64,
    bytes: u64,
}

impl Cost {
    const fn of(transfers: u64, bytes: u64) -> Self {
        Self { transfers, bytes }
    }

    fn spent(gauge: &Gauge) -> Self {
        Self::of(statistic(gauge, "transfers"), statistic(gauge, "bytes"))
    }

    fn since(self, before: Self) -> Self {
        Self::of(self.transfers - before.transfers, self.bytes - before.bytes)
    }

    /// How long its bits are on the bus at so many kHz: nine for a byte, with START and STOP for a transfer.
    fn time(self, khz: u64) -> Duration {
        Duration::from_micros((self.bytes * 9 + self.transfers * 2) * 1000 / khz)
    }

    /// The larger of each.
    fn max(self, other: Self) -> Self {
        Self::of(self.transfers.max(other.transfers), self.bytes.max(other.bytes))
    }
}

impl fmt::Display for Cost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format!("{}/{}", self.transfers, self.bytes))
    }
}

/// What this program is told when it is the other program on a bus of `gaugefs sim`.
const READ_WORDS: &str = "words";

fn main() -> ExitCode {
    if env::args().any(|argument| argument == READ_WORDS) {
        return match read_words() {
            Ok(each) => {
                println!("{}", each.as_nanos());
                ExitCode::SUCCESS
            }
            Err(why) => {
                eprintln!("{why}");
                ExitCode::FAILURE
            }
        };
    }
    let mut report = Report::default();
    println!(
        "transfers/bytes    poll  kernel  first parameter  later one  blocks      image  of needed   takes"
    );
    let (written, read): (Vec<_>, Vec<_>) = CHIPS.iter().partition(|chip| rows(chip).next().is_some());
    for chip in written {
        if let Err(error) = measure(chip, &mut report) {
            report.promise(false, || format!("{}: {error}", chip.name));
        }
    }
    let read: Vec<_> = read.into_iter().map(|chip| chip.name).collect();
    println!("names only, so nothing of them is written: {}", read.join(", "));
    let _ = fs::remove_dir_all(journals());
    let (thread, wire) = (cost_of_the_thread(), Duration::from_micros(wire_bytes(1, 2) * 9 * 10));
    println!(
        "the thread that bounds real transfers adds {thread:.1?} to each; a word takes {wire:?} at 100 kHz"
    );
    match [&["--fast"][..], &["--speed", "100"]].map(word_on_a_bus) {
        [Ok(fast), Ok(slow)] => report.row(
            "a word that another program reads on the bus of `gaugefs sim`, without and with the time of the bus",
            &format!("{:.2} ms; {:.2} ms", fast.as_secs_f64() * 1e3, slow.as_secs_f64() * 1e3),
            &format!("{:.2} ms on a wire at 100 kHz", wire.as_secs_f64() * 1e3),
        ),
        [Err(why), _] | [_, Err(why)] => println!("SKIPPED: no bus of `gaugefs sim` was timed: {why}"),
    }
    report.finish()
}

/// What a word takes on the bus of a command, which is this program.
fn word_on_a_bus(how: &[&str]) -> std::result::Result<Duration, Box<dyn Error>> {
    let mut sim = Command::new(env!("CARGO_BIN_EXE_gaugefs"));
    let ran =
        sim.args(["sim", BUDGETED]).args(how).arg("--").arg(env::current_exe()?).arg(READ_WORDS).output()?;
    if !ran.status.success() {
        return Err(String::from_utf8_lossy(&ran.stderr).trim_end().into());
    }
    Ok(Duration::from_nanos(String::from_utf8(ran.stdout)?.trim_end().parse()?))
}

/// What one of many words takes.
fn read_words() -> std::result::Result<Duration, Box<dyn Error>> {
    const WORDS: u32 = 5000;
    let mut gauge = LinuxI2CDevice::new(env::var("I2C_DEV")?, 0x55)?;
    let begun = Instant::now();
    for _ in 0..WORDS {
        gauge.smbus_read_word_data(0x08)?;
    }
    Ok(begun.elapsed() / WORDS)
}

/// What [`Bounded`] adds to a transfer.
fn cost_of_the_thread() -> Duration {
    struct Nothing;
    impl Bus for Nothing {
        fn transfer(&mut self, _: &[u8], _: &mut [u8]) -> std::result::Result<(), BusError> {
            Ok(())
        }
    }
    const TRANSFERS: u32 = 10_000;
    let mut bus =
        Bounded::new(Nothing, (0, "none".into()), Duration::from_secs(1), Arc::new(RealClock::new()));
    let begun = Instant::now();
    for _ in 0..TRANSFERS {
        bus.transfer(&[8], &mut [0; 18]).expect("it does nothing");
    }
    begun.elapsed() / TRANSFERS
}

fn measure(chip: &'static Chip, report: &mut Report) -> Result<()> {
    let bursts = bursts(chip.registers, |tier| tier == Tier::Poll);
    let bytes = bursts.iter().map(|&(_, length)| wire_bytes(1, length.into())).sum();
    let poll = Cost::of(bursts.len() as u64, bytes);
    let kernel = KERNEL.iter().find(|(name, _)| *name == chip.name).map(|(_, cost)| *cost);
    let first = costliest(chip, Seal::Sealed, Engine::Fresh)?;
    let later = costliest(chip, Seal::Unsealed, Engine::Used)?;
    let Whole { blocks, cost: image, needed, time } = image(chip)?;
    let ratio = image.transfers as f64 / needed as f64;
    let seconds = time.as_secs_f64();
    println!(
        "{:15} {poll:>7} {:>7}  {first:>15}  {later:>9}  {blocks:6}  {image:>9}  {ratio:9.2}  {seconds:4.1} s",
        chip.name,
        kernel.map_or("-".to_string(), |kernel| kernel.to_string()),
    );
    let times = [poll, first, image].map(|cost| {
        let [slow, fast] = [100, 400].map(|khz| cost.time(khz).as_secs_f64() * 1e3);
        format!("{slow:.1} or {fast:.1}")
    });
    let kernel = kernel.map_or(String::new(), |kernel| format!("a poll of the kernel's driver: {kernel}; "));
    report.row(
        &format!(
            "{}, transfers/bytes: a poll; a parameter, found sealed; an image of {blocks} blocks",
            chip.model
        ),
        &format!("{poll}; {first}; {image}"),
        &format!("{kernel}the image needs {needed} transfers"),
    );
    report.row(
        &format!("{}, ms on the bus at 100 or 400 kHz: a poll; a parameter; an image", chip.model),
        &times.join("; "),
        "without the waits of the gauge",
    );
    if chip.name == BUDGETED {
        for (what, cost, budget) in
            [("poll", poll, POLL), ("first write", first, FIRST), ("later write", later, LATER)]
        {
            report.promise(cost.transfers <= budget.transfers && cost.bytes <= budget.bytes, || {
                format!("{}: {what}: {cost} transfers/bytes, the budget is {budget}", chip.name)
            });
        }
    }
    Ok(())
}

/// Transfers that a block needs however it is done: select and read it, write, checksum, select and read what
/// is stored.
const A_BLOCK: u64 = 6;
/// Where a window may not be ready yet, a block counts when two readings of it agree: the old one and what is
/// stored.
const READ_TWICE: u64 = 2;
/// All old blocks are on disk before the first one is touched, so where a block has to be in the window to be
/// written it is selected a second time.
const SELECTED_AGAIN: u64 = 1;
/// Where its class takes a reset, it is selected and read once more after it.
const AFTER_A_RESET: u64 = 2;

/// A simulated gauge, awake, in that seal state, and the engine as it is after the first poll of a mount, with a
/// journal.
fn rig(chip: &'static Chip, found: Seal) -> Result<(Arc<SimClock>, Gauge, DataFlash)> {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a simulated gauge");
    let mut gauge = Gauge::new(chip, Box::new(sim.bus()), clock.clone(), Keys::default());
    clock.sleep(Duration::from_secs(2));
    if chip.name == BUDGETED {
        serve(&clock, &mut gauge)?;
    }
    gauge.go_to(found)?;
    let journal = Journal::new(journals(), chip.name.into(), chip.name.into());
    let mut dataflash = DataFlash::new(Limits::default(), Some(journal));
    let answers = gauge.identify()?;
    dataflash.meet(chip, &answers);
    dataflash.settle(&mut gauge, Duration::ZERO)?;
    let mut words = HashMap::new();
    for register in chip.registers.iter().filter(|register| register.size == 2) {
        let mut word = [0; 2];
        let Some(code) = register.source.command() else { continue };
        gauge.read(code, &mut word)?;
        words.insert(register.source, u16::from_le_bytes(word).into());
    }
    dataflash.polled(chip, |source| words.get(&source).copied());
    Ok((clock, gauge, dataflash))
}

/// Puts the pack of a bq34z100-G1 into service: Impedance Track runs and has learned. A write that takes a reset
/// costs more then.
fn serve(clock: &SimClock, gauge: &mut Gauge) -> Result<()> {
    gauge.go_to(Seal::Unsealed)?;
    gauge.command(IT_ENABLE)?;
    clock.sleep(Duration::from_secs(2));
    let mut subclasses = gauge.chip.subclasses.iter();
    let (subclass, parameter) = subclasses
        .find_map(|row| Some(row).zip(row.parameter(UPDATE_STATUS.1)).filter(|_| row.id == UPDATE_STATUS.0))
        .expect("a row");
    let learned = Change::of_value(gauge.chip, (subclass, parameter), &Value::Int(0x06), false)?;
    DataFlash::default().write(gauge, &[learned], Duration::ZERO).map(|_| ())
}

/// The folder of the journals, in memory where that is possible: they are synced to disk many times.
fn journals() -> PathBuf {
    let memory = Path::new("/dev/shm");
    let parent = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
    parent.join(format!("gaugefs-bench-{}", std::process::id()))
}

fn statistic(gauge: &Gauge, wanted: &str) -> u64 {
    let list = gauge.statistics.list();
    list.iter().find(|(name, _)| *name == wanted).expect("a statistic of that name").1
}

/// Whether a parameter may be set to any value of its range without an option.
fn is_writable(one: &Parameter) -> bool {
    one.kind.bounds().is_some() && one.safe.is_none() && !one.unproven
}

/// Those of them that the gauge does not rewrite itself.
fn rows(chip: &'static Chip) -> impl Iterator<Item = Row> {
    let subclasses = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = subclasses.flat_map(|row| row.parameters.iter().map(move |one| (row, one)));
    rows.filter(|(_, one)| is_writable(one) && !one.learned)
}

/// What the engine has done before a write.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Engine {
    /// Nothing since the mount: the limit of the flash voltage is read with the write.
    Fresh,
    /// It has read data flash, and that limit with it.
    Used,
}

/// The most that changing one parameter costs.
fn costliest(chip: &'static Chip, found: Seal, engine: Engine) -> Result<Cost> {
    let costs = rows(chip).map(|row| change(chip, found, engine, row).map(|(cost, _)| cost));
    costs.reduce(|most, cost| Ok(most?.max(cost?))).expect("a parameter that may be written")
}

/// Changes one bit of one parameter; its cost, and whether it took a reset.
fn change(chip: &'static Chip, found: Seal, engine: Engine, row: Row) -> Result<(Cost, bool)> {
    let (_, mut gauge, mut dataflash) = rig(chip, found)?;
    let mut other = DataFlash::default();
    let reader = if engine == Engine::Used { &mut dataflash } else { &mut other };
    let bytes = reader.read(&mut gauge, &[row.0], Duration::ZERO)?.remove(0);
    write(&mut gauge, &mut dataflash, flip(chip, row, &bytes).as_slice())
}

/// The change of one bit of a parameter, the lowest that its range allows, given the bytes of its subclass.
fn flip(chip: &Chip, (subclass, parameter): Row, bytes: &[u8]) -> Option<Change> {
    let at = usize::from(parameter.offset - subclass.start());
    (0..8).find_map(|bit| {
        let mut bytes = bytes[at..at + parameter.kind.size()].to_vec();
        *bytes.last_mut()? ^= 1 << bit;
        Change::of_value(chip, (subclass, parameter), &chip.layout.decode(parameter.kind, &bytes), false).ok()
    })
}

fn write(gauge: &mut Gauge, dataflash: &mut DataFlash, changes: &[Change]) -> Result<(Cost, bool)> {
    let before = Cost::spent(gauge);
    let outcome = dataflash.write(gauge, changes, Duration::ZERO)?;
    Ok((Cost::spent(gauge).since(before), matches!(outcome, Outcome::Written { reset: true, .. })))
}

/// What a write that changes every block has cost.
struct Whole {
    blocks: u64,
    cost: Cost,
    /// Transfers that its blocks need.
    needed: u64,
    time: Duration,
}

/// One bit more or less in one parameter of every block, written as one.
fn image(chip: &'static Chip) -> Result<Whole> {
    let (clock, mut gauge, mut dataflash) = rig(chip, Seal::Sealed)?;
    let mut changes: Vec<Change> = Vec::new();
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        let bytes = dataflash.read(&mut gauge, &[subclass], Duration::ZERO)?.remove(0);
        let block = |one: &Parameter| usize::from(one.offset - subclass.start()) / WINDOW;
        let may = |one: &&Parameter| {
            let last = usize::from(one.offset - subclass.start()) + one.kind.size() - 1;
            is_writable(one) && last / WINDOW == block(one)
        };
        // What the gauge rewrites itself only where a block holds nothing else.
        let mut rows: Vec<_> = subclass.parameters.iter().filter(may).collect();
        rows.sort_by_key(|one| (block(one), one.learned));
        rows.dedup_by_key(|one| block(one));
        changes.extend(rows.into_iter().filter_map(|parameter| flip(chip, (subclass, parameter), &bytes)));
    }
    let (before, begun) = (statistic(&gauge, "flash_writes"), clock.now());
    let (cost, reset) = write(&mut gauge, &mut dataflash, &changes)?;
    let (blocks, time) = (statistic(&gauge, "flash_writes") - before, clock.now() - begun);
    let (twice, again) =
        if chip.access.scheme == Scheme::Mac { (0, 0) } else { (READ_TWICE, SELECTED_AGAIN) };
    let a_block = |reset| A_BLOCK + twice + if reset { AFTER_A_RESET } else { 0 };
    // Preflight, unsealing and sealing cost what a write of one parameter does beside its block, which stays
    // in the window.
    let row = rows(chip).next().expect("a parameter that may be written");
    let (one, one_reset) = change(chip, Seal::Sealed, Engine::Used, row)?;
    let needed = blocks * (a_block(reset) + again) + one.transfers - a_block(one_reset);
    Ok(Whole { blocks, cost, needed, time })
}
