// SPDX-License-Identifier: MIT

//! Writes to a gauge with RAM that is found sealed, which would seal itself at the end of CONFIG UPDATE.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::dataflash::Outcome;
use ti_gauge::gauge::Seal;

use crate::rig::{Rig, cause};

/// Parts, and Terminate Voltage. Update Status is in the same block.
const PARTS: &[(&str, u16)] = &[("bq27441-g1", 16), ("bq27421-g1", 16), ("bq27426", 10), ("bq27427", 10)];
const STATE: u8 = 82;
const UPDATE_STATUS: u16 = 2;
const WRITTEN: Outcome = Outcome::Written { reset: true, old: Vec::new() };

impl Rig {
    fn found_sealed(chip: &str, knobs: &[(&str, &str)]) -> Self {
        let rig = Self::new(chip);
        for (knob, text) in knobs {
            rig.sim.set(knob, text).expect("a knob");
        }
        rig
    }

    fn update_status(&mut self) -> u8 {
        self.clock.sleep(Duration::from_secs(6));
        self.read(STATE, UPDATE_STATUS).expect("the default key")[0]
    }
}

/// A second for each way, which a gauge takes at most.
#[test]
fn a_value_beside_the_bit_is_there_after_the_two_ways() {
    for &(chip, at) in PARTS {
        let mut rig = Rig::found_sealed(chip, &[]);
        let begun = rig.clock.now();
        assert_eq!(rig.write(STATE, at, "3100"), Ok(WRITTEN), "{chip}");
        let took = rig.clock.now() - begun;
        println!("{chip}: {took:?}");
        assert!(took < Duration::from_millis(2700), "{chip}: {took:?}");
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        assert_eq!(rig.update_status(), 0x80, "{chip}: SEALED has set it again");
        assert_eq!(rig.read(STATE, at), Ok(3100_u16.to_be_bytes().to_vec()), "{chip}");
    }
}

#[test]
fn a_block_that_is_lost_at_the_end_of_config_update_is_no_success() {
    for &(chip, at) in PARTS {
        let mut rig = Rig::found_sealed(chip, &[("drop_updates", "1"), ("status_ms", "200")]);
        let flash = rig.sim.flash();
        let error = rig.write(STATE, at, "3100").expect_err("it is lost");
        assert_eq!(cause(&error), "rolled-back", "{chip}: {error}");
        assert_eq!(rig.seal(), Seal::Sealed, "{chip}");
        assert!(rig.sim.flash() == flash, "{chip}");
        assert_eq!(rig.write(STATE, at, "3100"), Ok(WRITTEN), "{chip}");
        // Nor is it on a gauge that is silent until it takes its key, after which another pack may be there.
        let knobs = [("drop_updates", "1"), ("reseals", "on"), ("status_ms", "200")];
        let mut rig = Rig::found_sealed(chip, &knobs);
        let error = rig.write(STATE, at, "3100").expect_err("it is lost");
        assert!(["rolled-back", "state-unknown"].contains(&cause(&error)), "{chip}: {error}");
    }
}

/// It may show that only after its blocks were looked at.
#[test]
fn a_gauge_that_seals_itself_all_the_same_is_opened() {
    for &(chip, at) in PARTS {
        for status_ms in ["0", "100", "200"] {
            let mut rig = Rig::found_sealed(chip, &[("reseals", "on"), ("status_ms", status_ms)]);
            assert_eq!(rig.write(STATE, at, "3100"), Ok(WRITTEN), "{chip}, {status_ms} ms");
            assert_eq!((rig.seal(), rig.update_status()), (Seal::Sealed, 0x80), "{chip}, {status_ms} ms");
        }
    }
}

/// The bit is somebody's own then, and is verified.
#[test]
fn an_update_status_that_is_written_is_stored_as_it_is() {
    for &(chip, _) in PARTS {
        let mut rig = Rig::found_sealed(chip, &[]);
        rig.sim.clear_log();
        assert_eq!(rig.write(STATE, UPDATE_STATUS, "0x83"), Ok(WRITTEN), "{chip}");
        let log = rig.log();
        let sent: Vec<_> = log.iter().filter(|line| line.starts_with("W 42")).collect();
        assert_eq!(sent, ["W 42 83"], "{chip}");
        assert_eq!(rig.update_status(), 0x83, "{chip}");
    }
}
