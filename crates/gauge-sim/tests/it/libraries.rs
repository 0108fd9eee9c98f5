// SPDX-License-Identifier: MIT

//! Public programs that work on real parts, by the bytes that they send to a new simulated gauge.

use gauge_bus::Bus;
use gauge_sim::Options;

use super::bench::{Bench, UNSEAL, sum};

/// A part that has had power for three seconds.
fn new(chip: &str) -> Bench {
    let bench = Bench::of(chip, &Options::default());
    bench.sleep(3);
    bench
}

/// `update_design_capacity` of the crate bq34z100 0.4.0 and of the Arduino library that it was ported from
/// (xkam1x/BQ34Z100G1), up to RESET.
fn design_capacity(bench: &Bench, read: impl Fn(&mut [u8])) {
    bench.replay(UNSEAL);
    let mut block = [0; 32];
    bench.replay("W 61 00 ; W 3E 30 ; W 3F 00");
    read(&mut block);
    (block[6], block[7]) = (0, 0);
    for (at, byte) in [(8, 0x08), (9, 0x98), (11, 0x08), (12, 0x98)] {
        block[at] = byte;
    }
    for at in [6, 7, 8, 9, 11, 12] {
        bench.replay(&format!("W {:02X} {:02X}", 0x40 + at, block[at]));
    }
    bench.replay(&format!("W 60 {:02X} ; X 150 ; W 00 41 00", sum(&block)));
}

/// The crate reads Control() right after RESET, and any error is its own.
#[test]
fn regression_the_crate_bq34z100_survives_its_own_reset() {
    let bench = new("bq34z100-g1");
    let read = |block: &mut [u8]| {
        let mut bus = bench.sim.bus();
        bus.transfer(&[0x40], &mut []).expect("an acknowledgement");
        bus.transfer(&[], block).expect("a block");
    };
    design_capacity(&bench, read);
    bench.replay("R 00 2 -> .. ; X 150");
    bench.replay(UNSEAL);
    bench.replay(
        "W 61 00 ; W 3E 30 ; W 3F 00 ; R 48 2 -> 08 98 ; R 4B 2 -> 08 98 ; W 00 21 00 ; R 00 2 -> ..",
    );
    bench.replay("R 3C 2 -> 98 08");
}

/// The Arduino library ignores errors, unseals 150 ms after RESET, and reads the block where the pointer is.
#[test]
fn regression_an_arduino_library_reads_back_what_it_has_written_after_reset() {
    let bench = new("bq34z100-g1");
    let read = |block: &mut [u8]| bench.sim.bus().transfer(&[], block).expect("a block");
    design_capacity(&bench, read);
    let _ = bench.sim.bus().transfer(&[0x00], &mut [0; 2]);
    bench.replay("X 150");
    bench.replay(UNSEAL);
    bench.replay("W 61 00 ; W 3E 30 ; W 3F 00");
    let mut block = [0; 32];
    read(&mut block);
    assert_eq!((&block[8..10], &block[11..13]), (&[0x08, 0x98][..], &[0x08, 0x98][..]));
}

/// The driver of the Flipper Zero, and of ESPHome components after it: OperationStatus() is read once a millisecond from
/// RESET on, and has to show \[INITCOMP\] and then UNSEALED, in which it sends the key to FULL ACCESS.
#[test]
fn regression_a_bq27220_driver_goes_on_after_reset() {
    let bench = new("bq27220");
    bench.replay("W 00 01 00 ; X 1 ; R 40 2 -> 20 02 ; R 3A 2 -> 24 00");
    bench.replay("W 00 41 00");
    let status = bench.word(0x3A);
    assert_eq!(status & 0x0026, 0x0024, "[INITCOMP], UNSEALED: {status:04X}");
    bench.replay("W 00 FF FF ; X 5 ; W 00 FF FF ; X 5 ; R 3A 2 -> 22 00");
    bench.replay("W 3E 90 00");
    bench.sleep(1);
    assert_eq!(bench.word(0x3A) & 0x0400, 0x0400, "[CFGUPDATE]");
}

/// `BQ27441_Configure` of Dinamiet/BQ27441 never unseals: block by block, the new bytes, the block, its checksum.
#[test]
fn regression_a_bq27441_library_that_never_unseals_configures_a_new_gauge() {
    let bench = new("bq27441-g1");
    bench.replay("W 00 13 00 ; X 1100 ; R 06 1 -> 98");
    for (at, bytes) in [(0x4A, "05 DC"), (0x4C, "15 AE"), (0x5B, "00 4B")] {
        bench.replay("W 61 00 ; W 3E 52 ; W 3F 00");
        bench.replay(&format!("W {at:02X} {bytes}"));
        let mut block = [0; 32];
        bench.sim.bus().transfer(&[0x40], &mut block).expect("a block");
        bench.replay(&format!("W 60 {:02X}", sum(&block)));
    }
    bench.replay("W 00 42 00 ; X 1100 ; R 06 1 -> 88 ; R 3C 2 -> DC 05");
}

/// `set_design_capacity` of martinberlin/BQ27426_idf never unseals either, and reads each byte back.
#[test]
fn regression_a_bq27426_library_that_never_unseals_configures_a_new_gauge() {
    let bench = new("bq27426");
    bench.replay("W 00 13 00 ; X 1100");
    assert_eq!(bench.word(0x06) & 0x0010, 0x0010, "[CFGUPMODE]");
    bench.replay("W 61 00 ; X 10 ; W 3E 52 ; X 10 ; W 3F 00 ; X 10 ; W 46 07 ; X 10 ; W 47 D0 ; X 10");
    let mut bus = bench.sim.bus();
    let mut byte = |register| {
        let mut byte = [0];
        bus.transfer(&[register], &mut byte).expect("a byte");
        byte[0]
    };
    let block: Vec<u8> = (0x40..0x60).map(&mut byte).collect();
    let checksum = sum(&block);
    bench.replay(&format!("W 60 {checksum:02X} ; R 46 1 -> 07 ; R 47 1 -> D0 ; R 60 1 -> {checksum:02X}"));
    bench.replay("W 00 42 00 ; X 1100");
    assert_eq!(bench.word(0x06) & 0x0010, 0);
    bench.replay("W 61 00 ; W 3E 52 ; W 3F 00 ; R 46 2 -> 07 D0");
}
