// SPDX-License-Identifier: MIT

//! The configuration of a gauge with RAM, written again after a loss of power.

use std::time::Duration;

use ti_gauge::chip::{CHIPS, Chip};
use ti_gauge::dataflash::{Change, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::Gauge;

use crate::rig::Rig;

type Values = &'static [((u8, u16), &'static str)];

/// Parts with RAM, and values that they do not have by themselves: in two blocks at least where there are so many.
const PARTS: &[(&str, Values)] = &[
    ("bq27441-g1", &[((82, 10), "1200"), ((80, 22), "700"), ((89, 0), "90"), ((64, 2), "0x0e")]),
    ("bq27421-g1", &[((82, 10), "1200"), ((89, 0), "90"), ((49, 0), "12")]),
    ("bq27426", &[((82, 6), "1200"), ((49, 0), "12"), ((89, 0), "90")]),
    ("bq27427", &[((82, 6), "1200"), ((49, 0), "12"), ((89, 0), "90")]),
    ("bq27621-g1", &[((82, 3), "1200"), ((49, 0), "12")]),
    ("bq27220", &[((0, 0x929F), "1200"), ((0, 0x91FD), "4100")]),
];

fn changes(chip: &str, values: Values) -> Vec<Change> {
    let chip = Chip::by_name(chip).expect("it has a table");
    let change = |&((id, at), text): &((u8, u16), &str)| Rig::change_of(chip, id, at, text).saved();
    values.iter().map(change).collect()
}

impl Rig {
    fn lose_power(&mut self) {
        self.sim.set("power", "off").expect("a knob");
        self.sim.set("power", "on").expect("a knob");
        self.pause(3);
        self.dataflash.forget();
        let _ = self.gauge.seal();
    }

    fn restore(&mut self, changes: &[Change]) -> Result<Outcome> {
        self.dataflash.restore(&mut self.gauge, changes, true, Duration::ZERO)
    }
}

/// What a gauge without faults holds when it was restored.
fn model(chip: &str, changes: &[Change]) -> Vec<u8> {
    let mut rig = Rig::new(chip);
    rig.lose_power();
    assert!(matches!(rig.restore(changes), Ok(Outcome::Written { .. })), "{chip}");
    let flash = rig.sim.flash();
    assert!(matches!(rig.restore(changes), Ok(Outcome::Unchanged)), "{chip}");
    assert!(rig.sim.flash() == flash, "{chip}");
    flash
}

#[test]
fn every_part_with_ram_is_tested() {
    let with_ram: Vec<_> =
        CHIPS.iter().filter(|chip| chip.volatile.is_some()).map(|chip| chip.name).collect();
    assert!(with_ram.iter().all(|name| PARTS.iter().any(|(part, _)| part == name)), "{with_ram:?}");
}

/// A block shows what was there before, or nothing, for longer than the first look waits.
#[test]
fn late_blocks_are_restored_right() {
    for (chip, values) in PARTS {
        let changes = changes(chip, values);
        let new = model(chip, &changes);
        for early in ["previous", "blank"] {
            for (load, block) in [("4", "0"), ("20", "10"), ("0", "45")] {
                let mut rig = Rig::new(chip);
                rig.lose_power();
                for (knob, value) in [("early", early), ("load_ms", load), ("block_ms", block)] {
                    rig.sim.set(knob, value).expect("a knob");
                }
                let outcome = rig.restore(&changes);
                let at = format!("{chip}, {early}, {load} ms, {block} ms: {outcome:?}");
                assert!(outcome.is_ok() && rig.sim.flash() == new, "{at}");
            }
        }
    }
}

#[test]
fn a_block_that_was_not_stored_is_stored_once_more() {
    for (chip, values) in PARTS {
        let changes = changes(chip, values);
        let new = model(chip, &changes);
        for fault in ["drop-commit", "corrupt-commit"] {
            let mut rig = Rig::new(chip);
            rig.lose_power();
            let begun = rig.gauge.statistics.resets.load(std::sync::atomic::Ordering::Relaxed);
            rig.sim.set("fault", fault).expect("a fault");
            rig.restore(&changes).unwrap_or_else(|error| panic!("{chip}, {fault}: {error}"));
            assert!(rig.sim.flash() == new, "{chip}, {fault}");
            let ended = rig.gauge.statistics.resets.load(std::sync::atomic::Ordering::Relaxed);
            assert_eq!(ended - begun, 1, "{chip}, {fault}: without leaving CONFIG UPDATE for it");
        }
    }
}

/// One fault at each transfer. Success is said only of what is there, and the next attempt succeeds.
#[test]
fn a_fault_at_any_transfer_of_a_restore_causes_no_false_success() {
    let mut runs = 0;
    for (chip, values) in PARTS {
        let changes = changes(chip, values);
        let new = model(chip, &changes);
        let transfers = {
            let mut rig = Rig::new(chip);
            rig.lose_power();
            rig.cost();
            rig.restore(&changes).expect("no fault");
            rig.cost().0
        };
        let faults: &[fn(u64) -> String] = &[
            |n| format!("nack {n}"),
            |n| format!("flip {n} 2 1"),
            |n| format!("lost {n}"),
            |n| format!("power-cut {n} 20"),
            |n| format!("power-cut-after {n} 20"),
        ];
        for fault in (1..=transfers).flat_map(|number| faults.iter().map(move |fault| fault(number))) {
            let mut rig = Rig::new(chip);
            rig.lose_power();
            rig.sim.set("fault", &fault).expect("a fault");
            let outcome = rig.restore(&changes);
            let is_there = |rig: &mut Rig| {
                let flash = rig.sim.flash();
                rig.sim.set("fault", "none").expect("a knob");
                flash == new
            };
            let there = is_there(&mut rig);
            // A cut behind the last look is a loss of its own.
            let lost_since = fault.starts_with("power") && !there;
            assert!(
                outcome.is_err() || there || lost_since && says_lost(&mut rig.gauge),
                "{chip}, {fault}: {outcome:?}"
            );
            rig.pause(5);
            rig.dataflash.start_over();
            let mut again = rig.settle().map(drop).and_then(|()| rig.restore(&changes));
            for _ in 0..3 {
                if again.is_ok() {
                    break;
                }
                rig.pause(5);
                again = rig.settle().map(drop).and_then(|()| rig.restore(&changes));
            }
            assert!(again.is_ok() && rig.sim.flash() == new, "{chip}, {fault}: {again:?}");
            runs += 1;
        }
    }
    println!("{runs} restores with one fault");
}

/// A part without the flag is compared by whoever has its profile.
fn says_lost(gauge: &mut Gauge) -> bool {
    let mut flags = [0; 2];
    let _ = gauge.read(0x06, &mut flags);
    gauge.chip.volatile == Some(0) || u16::from_le_bytes(flags) & gauge.chip.volatile.unwrap_or(0) != 0
}
