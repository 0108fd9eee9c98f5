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

use gauge_owner::Seal;
use gauge_owner::rig::days::{Errors, Remedy, days};
use gauge_owner::rig::restoring::{Cost, Lost, cost, values};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::Change;

mod report;
use report::Report;

/// Draws the loads, charges and losses of power of the 1000 days.
const SEED: u64 = 7;
const PARTS: &[&str] = &["bq27421-g1", "bq27441-g1", "bq27426", "bq27427", "bq27621-g1", "bq27220"];
/// What gaugefs adds to the gauge's own waits for CONFIG UPDATE, for the usual profile and for a whole image.
const ADDED: [Duration; 2] = [Duration::from_millis(350), Duration::from_millis(1150)];
/// Time for each way that is no longer the most that a manual allows.
const HALF: Duration = Duration::from_millis(500);
const SEALS: [Seal; 2] = [Seal::Unsealed, Seal::Sealed];

/// What a part takes in the simulator to enter CONFIG UPDATE and to leave it.
fn ways(name: &str) -> Duration {
    match name {
        "bq27427" | "bq27426" => Duration::from_millis(2100),
        "bq27220" => Duration::from_millis(1800),
        _ => Duration::from_secs(2),
    }
}

fn blocks(changes: &[Change]) -> usize {
    let mut places: Vec<_> =
        changes.iter().map(|change| (change.place().subclass, change.place().offset / 32)).collect();
    places.sort_unstable();
    places.dedup();
    places.len()
}

fn main() -> ExitCode {
    let mut report = Report::default();
    for name in PARTS {
        let chip = Chip::by_name(name).expect("it has a table");
        for ((all, added), seal) in
            [(false, ADDED[0]), (true, ADDED[1])].into_iter().flat_map(|size| SEALS.map(|seal| (size, seal)))
        {
            let changes = values(chip, all);
            let cost = |ways, as_a_write| cost(chip, &changes, Lost { seal, ways }, as_a_write);
            let Cost { transfers, time } = cost(None, false);
            let half = cost(Some(HALF), false).time;
            let write = cost(None, true);
            let what = if all { "all that may be written" } else { "the usual profile" };
            report.row(
                &format!(
                    "{what}, blocks: {}, of a {name} found {}, after a loss of power",
                    blocks(&changes),
                    seal.as_str()
                ),
                &format!(
                    "{:.2} s, {transfers} transfers; {:.2} s if the gauge needs half a second for each way",
                    time.as_secs_f64(),
                    half.as_secs_f64()
                ),
                &format!(
                    "{:.2} s, {} transfers as an ordinary write",
                    write.time.as_secs_f64(),
                    write.transfers
                ),
            );
            report.promise(time <= ways(name) + added, || format!("{name} {seal:?}, {what}: {time:?}"));
            report.promise(all || half <= Duration::from_secs(2), || format!("{name} {seal:?}: {half:?}"));
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
