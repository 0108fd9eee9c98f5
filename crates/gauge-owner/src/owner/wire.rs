// SPDX-License-Identifier: MIT

//! The golden of the wire: what is sent to each part with data flash, from the first look at it to a report, and what comes
//! of it. It stays as it is, byte by byte, while the code is arranged anew: tests/it/golden/wire has both for each part,
//! and GAUGEFS_GOLDEN=write writes them.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gauge_bus::clock::SimClock;
use gauge_bus::trace::Trace;
use gauge_bus::{Bus, GAUGE_ADDRESS, Reach};
use gauge_sim::SimBus;
use ti_gauge::chip::{Chip, Kind, Register, Tier};
use ti_gauge::dataflash::{Change, Row};
use ti_gauge::notation;
use ti_gauge::value::Value;

mod costs;

use super::rig::{INTERVAL, Rig};
use super::{GaugeOptions, Run, Seal, operations as op};

/// A part, the parameter of its write, and those of its transaction.
type Case = (&'static str, &'static str, [&'static str; 3]);

const CASES: [Case; 15] = [
    ("bq34z100-g1", "Cell Terminate Voltage", ["Design Capacity", "Taper Current", "Sleep Current"]),
    ("bq34z100-r2", "Cell Terminate Voltage", ["Design Capacity", "Taper Current", "Sleep Current"]),
    ("bq27520-g3", "Terminate Voltage", ["Design Capacity", "Taper Current", "Sleep Current"]),
    ("bq27500", "Terminate Voltage", ["Design Capacity", "Charging Voltage", "Sleep Current"]),
    ("bq27500-v130", "Terminate Voltage", ["Design Capacity", "Taper Current", "Sleep Current"]),
    ("bq27742-g1", "Terminate Voltage", ["Design Capacity", "Body Diode Threshold", "Sleep Current"]),
    ("bq27441-g1", "Terminate Voltage", RAM),
    ("bq27421-g1", "Terminate Voltage", RAM),
    ("bq27426", "Terminate Voltage", RAM),
    ("bq27427", "Terminate Voltage", RAM),
    ("bq27621-g1", "Terminate Voltage", RAM),
    ("bq27220", "Taper Current", ["Design Capacity", "Sleep Current", "Dsg Current Threshold"]),
    ("bq34110", "Taper Current", ["Design Capacity mAh", "Taper Voltage", "Dsg Current Threshold"]),
    (
        "bq35100",
        "Cell Terminate Voltage",
        ["Cell Design Capacity mAh", "Cell Design Voltage", "Under Temperature Set Time"],
    ),
    ("bq28z610", "Pack Resistance", ["Resistance Parameter Filter", "Voltage Time", "Ra Max Delta"]),
];
const RAM: [&str; 3] = ["Design Capacity", "SOC1 Set Threshold", "Dsg Current Threshold"];

/// A block of data flash and its register.
const BLOCK: u16 = 33;

/// How the gauge behaves, whatever is usual for a simulated one.
const KNOBS: [(&str, &str); 4] =
    [("commit_busy", "nack"), ("reset_busy", "nack"), ("early", "previous"), ("load_ms", "0")];

/// Every parameter may be written.
fn options() -> GaugeOptions {
    GaugeOptions { allow_unproven: true, ..GaugeOptions::default() }
}

/// A gauge, and what was sent to it.
struct Wire {
    rig: Rig,
    trace: PathBuf,
    /// Lines of the trace that were taken over.
    seen: usize,
    text: String,
}

impl Wire {
    /// The gauge is sealed, and its adapter carries no more than that.
    fn new(chip: &'static Chip, reach: Reach) -> Self {
        let trace = std::env::temp_dir().join(format!("gaugefs-wire-{}-{}", chip.name, std::process::id()));
        let recorded = |mut bus: SimBus| -> Box<dyn Bus> {
            let [low, high] = chip.security.seal.to_le_bytes();
            bus.transfer(&[0, low, high], &mut []).expect("it is sealed");
            // Times are left out.
            let clock = Arc::new(SimClock::new());
            let bus = Trace::new(Box::new(bus), GAUGE_ADDRESS, &trace, clock, chip.name, true);
            Box::new(bus.expect("a trace"))
        };
        let run = Run { options: options(), ..Run::default() };
        let rig = Rig::on(chip.name, run, recorded);
        for (knob, setting) in KNOBS {
            rig.sim.set(knob, setting).unwrap_or_else(|error| panic!("{}: {error}", chip.name));
        }
        rig.sim.set_reach(reach);
        Self { rig, trace, seen: 0, text: String::new() }
    }

    /// Takes over what a step has sent: no times, and no answers but errors.
    fn step(&mut self, name: &str) {
        let trace = fs::read_to_string(&self.trace).expect("a trace");
        let lines: Vec<&str> = trace.lines().collect();
        let is_sent = |line: &&&str| {
            let result = line.strip_prefix(';').map(str::trim_start).unwrap_or_default();
            !result.starts_with("Below")
                && !result.starts_with("gaugefs")
                && !result.ends_with(" ok")
                && !result.contains(" -> ")
        };
        let sent = lines[self.seen..].iter().filter(is_sent);
        let sent: Vec<&str> =
            sent.map(|line| line.split_once("failed:").map_or(*line, |_| "; failed")).collect();
        // Writing to a String does not fail.
        let _ = writeln!(self.text, "; {name}: {}\n{}", sent.len(), sent.join("\n"));
        self.seen = lines.len();
    }

    fn row(&self, name: &str) -> Row {
        let chip = self.rig.handle.chip();
        let all = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |found| (row, found)));
        all.into_iter()
            .find(|(_, found)| found.name == name)
            .unwrap_or_else(|| panic!("{}: {name}", chip.name))
    }

    /// A parameter's value as it was read last.
    fn value(&self, (subclass, row): Row) -> Value {
        let at = self.rig.handle.chip().subclasses.iter().position(|one| std::ptr::eq(one, subclass));
        let kept = self.rig.handle.kept(at.expect("it is of the table")).expect("it was read");
        let at = usize::from(row.offset - subclass.start());
        self.rig.handle.chip().layout.decode(row.kind, &kept[at..at + row.kind.size()])
    }

    /// Another value of it.
    fn change(&self, name: &str) -> Change {
        let row = self.row(name);
        let value = match self.value(row) {
            Value::Int(number) => Value::Int(number ^ 1),
            Value::Float(_) | Value::Text(_) => unreachable!("{name} is a whole number"),
        };
        Change::of_value(self.rig.handle.chip(), row, &value, true).expect("it is in range")
    }

    fn read_all(&mut self) {
        let subclasses = self.rig.handle.chip().subclasses.iter().enumerate();
        let all =
            subclasses.filter(|(_, subclass)| subclass.kind != Kind::Security).map(|(at, _)| at).collect();
        self.rig.ask(&op::READ, all).expect("the default key");
    }

    /// What all of that has shown, which does not depend on how it was asked for.
    fn values(&self) -> String {
        let (chip, published) = (self.rig.handle.chip(), self.rig.handle.published());
        let snapshot = published.snapshot.as_ref().expect("it was polled");
        let registers = chip
            .registers
            .iter()
            .filter_map(|register| Some(format!("{} {}\n", register.name, snapshot.value(register)?)));
        let readable = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
        let rows = readable.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
        let rows = rows.map(|(subclass, row)| {
            let value = notation::render(row.kind, &self.value((subclass, row)));
            format!("{}/{} {value}\n", subclass.id, row.offset)
        });
        registers.chain(rows).collect()
    }
}

/// What is sent to a part, and what it has shown.
fn run((chip, write, transaction): &Case, reach: Reach) -> (String, String) {
    let mut wire = Wire::new(Chip::by_name(chip).expect("it has a table"), reach);
    wire.rig.start().expect("it answers");
    wire.step("open");
    for _ in 0..3 {
        wire.rig.poll_after(INTERVAL);
        wire.step("poll");
    }
    wire.read_all();
    wire.step("df/index");
    let change = wire.change(write);
    let changes: Vec<Change> = transaction.iter().map(|name| wire.change(name)).collect();
    wire.rig.ask(&op::WRITE, vec![change]).expect("written");
    wire.step("one write");
    wire.rig.ask(&op::WRITE, changes).expect("written");
    wire.step("a transaction of three");
    for seal in [Seal::Unsealed, Seal::Sealed] {
        wire.rig.ask(&op::SEAL, seal).expect("the default key");
        wire.step(if seal == Seal::Sealed { "seal" } else { "unseal" });
    }
    wire.rig.ask(&op::REPORT, ()).expect("it answers");
    wire.step("report");
    wire.read_all();
    let values = wire.values();
    fs::remove_file(&wire.trace).expect("its trace");
    (wire.text, values)
}

/// Compares with a file of the repository, or writes it. What crates.io has of this crate is without them.
fn check(name: &str, now: &str) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/it/golden/wire");
    if !folder.exists() {
        return eprintln!("SKIPPED: there is no {}", folder.display());
    }
    let path = folder.join(name);
    if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
        fs::write(&path, now).expect("the golden file");
    }
    let then = fs::read_to_string(&path).unwrap_or_default();
    let differs = now.lines().zip(then.lines()).position(|(now, then)| now != then);
    let line = differs.unwrap_or_else(|| now.lines().count().min(then.lines().count()));
    let shown = |text: &str| text.lines().skip(line.saturating_sub(3)).take(8).collect::<Vec<_>>().join("\n");
    assert!(
        now == then,
        "{name}: line {} differs; if that is intended, GAUGEFS_GOLDEN=write, and say why in the commit\n{}\n--- was\n{}",
        line + 1,
        shown(now),
        shown(&then)
    );
}

#[test]
fn the_wire_is_as_recorded() {
    let parts = Chip::all().filter(|chip| chip.is_proven()).map(|chip| chip.name);
    let mut parts: Vec<&str> = parts.collect();
    parts.retain(|part| !CASES.iter().any(|(chip, ..)| chip == part));
    assert!(parts.is_empty(), "without a golden: {parts:?}");
    for case in &CASES {
        let (sent, values) = run(case, Reach::FULL);
        check(case.0, &sent);
        check(&format!("{}.values", case.0), &values);
    }
}

/// Messages with so many bytes of data at most, and SMBus commands alone.
const REACHES: [Reach; 6] = [
    Reach::of_data(2),
    Reach::of_data(16),
    Reach::of_data(32),
    Reach::of_data(60),
    Reach::smbus(2, false),
    Reach::smbus(32, false),
];

/// Values without those that count measurements, and so move with time.
fn still(values: &str) -> Vec<&str> {
    let counts = ["AnalogCount", "Cal_Count", "StateTime"];
    let moves = |line: &&str| counts.iter().any(|name| line.starts_with(name));
    values.lines().filter(|line| !moves(line)).collect()
}

/// The lines of the polls and of reading all of data flash, which do not depend on how long the gauge takes; without those
/// that may be of any length.
fn reads(sent: &str) -> Vec<&str> {
    let mut is_one = false;
    let mut lines = sent.lines().collect::<Vec<_>>();
    lines.retain(|line| {
        if line.starts_with("; ") && line.contains(": ") {
            is_one = line.starts_with("; poll") || line.starts_with("; df/index");
            return false;
        }
        is_one && !line.is_empty() && *line != "; hidden"
    });
    lines
}

/// How many messages a reach makes of a read.
fn messages(chip: &Chip, line: &str, reach: Reach) -> usize {
    let Some(read) = line.strip_prefix("R: AA ") else { return 1 };
    let (code, length) = read.split_once(' ').expect("a register and a length");
    let code = usize::from_str_radix(code, 16).expect("a register");
    let length: usize = length.parse().expect("a length");
    if reach.carries(1, length) {
        return 1;
    }
    let count = |length: usize| length.div_ceil(usize::from(reach.read & !1));
    let longer = chip.registers.iter().filter(|row| {
        let is_read = row.source.command().is_some_and(|at| (code..code + length).contains(&at.into()));
        is_read && u16::from(row.size) > reach.read
    });
    let is_window =
        |row: &&Register| row.tier == Tier::Window && row.source.command() == u8::try_from(code).ok();
    // The window is read twice, and so is a register that is cut.
    let twice = match chip.registers.iter().find(is_window) {
        Some(row) if row.name != "Control" => count(length),
        _ => longer.map(|row| count(row.size.into())).sum(),
    };
    count(length) + twice
}

#[test]
fn the_values_are_the_same_within_any_reach() {
    for case in &CASES {
        let chip = Chip::by_name(case.0).expect("it has a table");
        let (whole, values) = run(case, Reach::FULL);
        let bytes = chip.byte_writes_above_hz.map(|_| Reach::ONE_BYTE_A_WRITE);
        // A block is written in pieces only where a manual says so.
        let least = if bytes.is_some() { 0 } else { BLOCK };
        let reaches = REACHES.map(|reach| Reach { write: reach.write.max(least), ..reach });
        for reach in reaches.into_iter().chain(bytes) {
            let (cut, now) = run(case, reach);
            assert_eq!(still(&now), still(&values), "{} {reach:?}", case.0);
            if reach.write > 2 {
                let needed: usize = reads(&whole).iter().map(|line| messages(chip, line, reach)).sum();
                assert_eq!(reads(&cut).len(), needed, "{} {reach:?}", case.0);
            }
        }
    }
}
