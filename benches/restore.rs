// SPDX-License-Identifier: MIT

//! How long a gauge with RAM shows nothing after a loss of power: its profile is written again, in simulated time, and
//! beside that the same values as an ordinary write.
//!
//!     cargo bench --bench restore
//!
//! The simulated gauges take all of the second that SLUUAC9A allows for the way into CONFIG UPDATE, and as much for the
//! way out: that is the floor of each figure. The promise is what gaugefs adds to it.

use std::process::ExitCode;
use std::time::Duration;

use gauge_bus::clock::Clock as _;
use gauge_owner::rig::Rig;
use gauge_owner::rig::days::{Errors, Remedy, days};
use gauge_owner::{Settings, Startup, operations};
use ti_gauge::chip::{Chip, Kind, Range, Row};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

mod report;
use report::Report;

/// Draws the loads, charges and losses of power of the 1000 days.
const SEED: u64 = 7;
const PARTS: &[&str] = &["bq27421-g1", "bq27441-g1", "bq27426", "bq27427", "bq27621-g1", "bq27220"];
/// What a profile usually has: parameters whose names begin so.
const USUAL: &[&str] = &[
    "Design Capacity",
    "Design Energy",
    "Terminate Voltage",
    "Taper ",
    "Qmax Cell 0",
    "R_a0 ",
    "Ra 0",
    "Ra 1",
    "Full Charge Capacity",
];
/// What gaugefs adds to the gauge's own waits for CONFIG UPDATE, for the usual profile and for a whole image.
const ADDED: [Duration; 2] = [Duration::from_millis(650), Duration::from_millis(1150)];
/// What a part takes to enter CONFIG UPDATE and to leave it, in the simulator, and what its table waits besides.
const MODES: fn(&str) -> Duration = |name| match name {
    "bq27427" | "bq27426" => Duration::from_millis(2100),
    // Each run of its bytes is addressed, loaded and committed by itself.
    "bq27220" => Duration::from_millis(3800),
    _ => Duration::from_secs(2),
};

/// Values that the gauge does not have by itself, for all parameters that may be written or for the usual ones.
fn values(chip: &'static Chip, all: bool) -> Vec<Change> {
    let rows = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let is_wanted =
        |(_, row): &Row| !row.unproven && (all || USUAL.iter().any(|name| row.name.starts_with(name)));
    let change = |row: Row| {
        let Range::Int { min, max, .. } = row.1.range else { return None };
        let values = [(min + max) / 2, min + 1, max / 3, 4000, 1800, 12];
        let fits = |value: &i64| Change::of_value(row, &Value::Int(*value), false).ok();
        values.iter().filter(|&&value| (min..=max).contains(&value)).find_map(fits).map(Change::saved)
    };
    rows.filter(is_wanted).filter_map(change).collect()
}

fn blocks(changes: &[Change]) -> usize {
    let mut places: Vec<_> =
        changes.iter().map(|change| (change.place().subclass, change.place().offset / 32)).collect();
    places.sort_unstable();
    places.dedup();
    places.len()
}

/// Transfers and time from the poll that finds the loss to the end of what it leads to.
/// `quick` is a gauge that takes no time for the ways into CONFIG UPDATE and out of it.
fn measured(chip: &'static Chip, changes: &[Change], as_a_write: bool, quick: bool) -> (u64, Duration) {
    let profile = if as_a_write { Vec::new() } else { changes.to_vec() };
    let settings = Settings { profile, ..Settings::default() };
    let mut rig = Rig::of(chip.name, settings, Startup::default());
    for knob in ["cfgupdate_ms", "cfgexit_ms"].iter().filter(|_| quick) {
        rig.sim.set(knob, "1").expect("a knob");
    }
    rig.start().expect("it answers");
    rig.poll_after(Duration::from_secs(20));
    let cut = |rig: &Rig| {
        rig.sim.set("power", "off").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(3));
    };
    cut(&rig);
    if as_a_write {
        rig.poll_after(Duration::ZERO);
    }
    let (begun, transfers) = (rig.clock.now(), rig.transfers());
    match as_a_write {
        true => rig.ask(&operations::WRITE, changes.to_vec()).expect("it is written"),
        false => rig.poll_after(Duration::ZERO),
    }
    assert_eq!(&*rig.handle.published().last_error, "", "{}", chip.name);
    (rig.transfers() - transfers, rig.clock.now() - begun)
}

fn main() -> ExitCode {
    let mut report = Report::default();
    for name in PARTS {
        let chip = Chip::by_name(name).expect("it has a table");
        for (all, added) in [(false, ADDED[0]), (true, ADDED[1])] {
            let changes = values(chip, all);
            let (transfers, time) = measured(chip, &changes, false, false);
            let (before, longer) = measured(chip, &changes, true, false);
            let (_, own) = measured(chip, &changes, false, true);
            let what = if all { "all that may be written" } else { "the usual profile" };
            report.row(
                &format!("{what}, blocks: {}, of a {name}, after a loss of power", blocks(&changes)),
                &format!(
                    "{:.2} s, {transfers} transfers; {:.2} s if the gauge itself takes no time",
                    time.as_secs_f64(),
                    own.as_secs_f64()
                ),
                &format!("{:.2} s, {before} transfers as an ordinary write", longer.as_secs_f64()),
            );
            report.promise(time <= MODES(name) + added, || format!("{name}, {what}: {time:?}"));
        }
    }
    for name in PARTS.iter().filter(|name| **name != "bq27220") {
        life(&mut report, Chip::by_name(name).expect("it has a table"));
    }
    report.finish()
}

/// How right the state of charge is over 1000 days with random losses of power, while the device is in use.
fn life(report: &mut Report, chip: &'static Chip) {
    let folder = std::env::temp_dir().join(format!("gaugefs-bench-days-{}", std::process::id()));
    let [nothing, profile, learned] = [Remedy::Nothing, Remedy::Profile, Remedy::Learned(&folder)]
        .map(|remedy| days(chip, 0..1000, SEED, remedy));
    let _ = std::fs::remove_dir_all(&folder);
    let shown = |errors: &Errors| {
        format!("median {:.1} %, worst {:.1} %", errors.quantile(0.5), errors.quantile(1.0))
    };
    report.row(
        &format!(
            "error of the state of charge of a {} in use, 1000 days, {} losses of power, seed {SEED}",
            chip.name, learned.losses
        ),
        &format!("{}; with the profile alone {}", shown(&learned), shown(&profile)),
        &format!("{} configured once", shown(&nothing)),
    );
}
