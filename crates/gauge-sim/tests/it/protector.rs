// SPDX-License-Identifier: MIT

//! The simulated bq27742-G1 beside what its sources print, and what opens the FETs that it drives.

use gauge_sim::Options;

use crate::bench::Bench;

const OPEN: &str = "W 00 14 04 ; W 00 72 36";
const RESET: &str = "W 00 41 00 ; X 500";

fn bench() -> Bench {
    Bench::of("bq27742-g1", &Options::default())
}

fn unsealed() -> Bench {
    let bench = bench();
    bench.replay(OPEN);
    bench
}

fn fets(bench: &Bench) -> String {
    bench.sim.get("fets").expect("the part drives FETs")
}

/// Lets seconds pass in which the part measures.
fn pass(bench: &Bench, seconds: u32) {
    for _ in 0..seconds * 2 {
        bench.replay("X 500 ; R 08 2 -> ..");
    }
}

#[test]
fn it_names_itself_and_opens_as_printed() {
    let bench = bench();
    bench.replay("W 00 01 00 ; X 66 ; R 00 2 -> 42 07 ; W 00 02 00 ; X 66 ; R 00 2 -> 03 01");
    let is_sealed = || {
        bench.replay("W 00 00 00");
        bench.word(0x00) & 0x2000 != 0
    };
    assert!(is_sealed());
    bench.replay(OPEN);
    assert!(!is_sealed());
}

/// Pack Configuration D and Prot OV Config with the sum that belongs to them, and Terminate Voltage.
#[test]
fn blocks_are_read_and_written_as_printed() {
    let bench = unsealed();
    let rest = "00 ".repeat(25);
    let select = |class: &str, block: &str| format!("W 61 00 ; W 3E {class} ; W 3F {block} ; X 60");
    bench.replay(&format!("{} ; R 40 20 -> 09 7F A7 B9 83 0A 07 {rest}; R 60 1 -> 83", select("40", "00")));
    bench.replay(&format!("W 40 09 7F A7 B9 B3 0A 00 {rest}; W 60 5A ; X 100"));
    bench.replay(&format!("{} ; R 40 7 -> 09 7F A7 B9 B3 0A 00", select("40", "00")));
    let zeros = "00 ".repeat(18);
    let sums = |last: &str| format!("00 00 00 00 00 00 00 00 7C 23 00 00 00 {last} {zeros}");
    bench.replay(&format!("{} ; R 40 20 -> {}; R 60 1 -> 4F", select("39", "00"), sums("11")));
    bench.replay(&format!("W 40 {}; W 60 56 ; X 100", sums("0A")));
    bench.replay(&format!("{} ; R 40 20 -> {}", select("39", "00"), sums("0A")));
    bench.replay("W 00 1A 00 ; X 100 ; R 00 2 -> 0A 00");
    assert_eq!((bench.word(0x1A) & 0x80, bench.word(0x6D) & 0xC0), (0, 0));
    bench.replay(&format!("{} ; R 40 2 -> 0B B8", select("50", "02")));
    pass(&bench, 3);
    assert_eq!(fets(&bench), "closed");
}

#[test]
fn commands_open_the_fets() {
    for (commands, why) in [(RESET, "reset"), ("W 00 24 00", "test"), ("W 00 13 00", "shutdown")] {
        let bench = unsealed();
        assert_eq!(fets(&bench), "closed");
        bench.replay(commands);
        assert_eq!(fets(&bench), why);
    }
    let sealed = bench();
    sealed.replay("W 00 41 00 ; W 00 24 00 ; X 500");
    assert_eq!(fets(&sealed), "closed");
}

/// One of two blocks that belong together.
#[test]
fn a_wrong_sum_opens_the_fets_for_good() {
    let bench = unsealed();
    bench.write(64, 6, &[0x00]);
    bench.replay("X 200 ; W 00 1A 00 ; X 100 ; R 00 2 -> 0A 80");
    pass(&bench, 3);
    assert_eq!(fets(&bench), "checksum");
    bench.write(57, 12, &[0x00, 0x0A]);
    pass(&bench, 3);
    assert_eq!(fets(&bench), "checksum");
}

#[test]
fn thresholds_open_the_fets_after_their_time() {
    for (voltage, temperature, why) in [
        ("4400", "250", "over-voltage"),
        ("2700", "250", "under-voltage"),
        ("3700", "560", "hot-charge"),
        ("3700", "610", "hot-charge hot-discharge"),
    ] {
        let bench = unsealed();
        pass(&bench, 3);
        bench.set("voltage_mv", voltage);
        bench.set("temperature", temperature);
        assert_eq!(fets(&bench), "closed");
        pass(&bench, 10);
        assert_eq!(fets(&bench), why);
        // A time of 0 switches it off.
        let bench = unsealed();
        for offset in [2, 7, 14, 19] {
            bench.write(2, offset, &[0x00]);
            bench.replay("X 200");
        }
        bench.set("voltage_mv", voltage);
        bench.set("temperature", temperature);
        pass(&bench, 10);
        assert_eq!(fets(&bench), "closed");
    }
}
