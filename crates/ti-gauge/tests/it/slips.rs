// SPDX-License-Identifier: MIT

//! One wrong bit in each subcommand that gaugefs sends to a bq35100, in turn: DEVICE_TYPE is ENTER_CAL then. A gauge that is
//! sealed does not take it, so it is found open.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::FLAT;
use ti_gauge::error::Result;
use ti_gauge::gauge::Seal;

use crate::rig::Rig;

type Operation = (&'static str, fn(&mut Rig) -> Result<()>);

const CHIP: &str = "bq35100";
/// Cell Design Capacity mAh.
const CAPACITY: u16 = 0x41FE;

const OPERATIONS: [Operation; 3] = [
    ("identify", |rig| rig.gauge.identify().map(drop)),
    ("read", |rig| rig.read(FLAT, CAPACITY).map(drop)),
    ("write", |rig| rig.write(FLAT, CAPACITY, "3100").map(drop)),
];

/// The subcommands of an operation, with the number of each transfer.
fn sent(seal: Seal, run: fn(&mut Rig) -> Result<()>) -> Vec<(usize, u16)> {
    let mut rig = Rig::calibrated(CHIP, seal);
    rig.sim.clear_log();
    run(&mut rig).expect("no fault");
    let words = rig.sim.log().into_iter().enumerate().filter_map(|(at, record)| match record.write[..] {
        [0x00 | 0x3e, low, high] => Some((at + 1, u16::from_le_bytes([low, high]))),
        _ => None,
    });
    words.filter(|(_, word)| rig.gauge.chip.subcommands.iter().any(|known| known.code == *word)).collect()
}

#[test]
fn a_wrong_bit_in_a_subcommand_leaves_no_mode_on() {
    let mut runs = 0;
    for seal in [Seal::Unsealed, Seal::FullAccess] {
        for (name, run) in OPERATIONS {
            let flips =
                sent(seal, run).into_iter().flat_map(|(at, word)| (0..16).map(move |bit| (at, word, bit)));
            for (at, word, bit) in flips {
                let mut rig = Rig::calibrated(CHIP, seal);
                let fault = format!("flip {at} {} {}", 1 + bit / 8, bit % 8);
                rig.sim.set("fault", &fault).expect("a fault");
                let outcome = run(&mut rig);
                rig.clock.sleep(Duration::from_secs(3));
                runs += 1;
                let which = format!("{name} {seal:?}: {word:04x} as {:04x}", word ^ 1 << bit);
                assert_eq!(rig.get("mode"), "normal", "{which}: {outcome:?}");
            }
        }
    }
    println!("{runs} wrong bits in subcommands");
}

/// It may be in the middle of a calibration.
#[test]
fn calibration_mode_that_somebody_else_has_begun_is_left_alone() {
    for (name, run) in OPERATIONS {
        let mut rig = Rig::calibrated(CHIP, Seal::Unsealed);
        rig.gauge.command(0x0081).expect("the gauge answers");
        rig.clock.sleep(Duration::from_secs(1));
        assert_eq!(rig.get("mode"), "calibration");
        let outcome = run(&mut rig);
        assert_eq!(rig.get("mode"), "calibration", "{name}: {outcome:?}");
        assert!(name != "write" || outcome.is_err(), "{name}");
    }
}
