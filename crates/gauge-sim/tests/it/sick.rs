// SPDX-License-Identifier: MIT

//! Simulated gauges that are sick as real ones are.

use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_sim::Options;

use super::bench::Bench;

impl Bench {
    fn sleeps(&self, seconds: u64) {
        self.clock.sleep(Duration::from_secs(seconds));
    }

    fn has(&self, knob: &str) -> String {
        self.sim.get(knob).expect("a knob")
    }
}

/// Owners of a BQ27426 see the old full charge capacity after a change of Design Capacity (E2E 805842).
#[test]
fn the_full_charge_capacity_of_some_parts_stays_as_it_was() {
    for (chip, design) in [("bq27421-g1", 10), ("bq27426", 6)] {
        for (keeps, full) in [("off", 2000), ("on", 1340)] {
            let bench = Bench::of(chip, &Options::default());
            bench.set("keeps_full", keeps);
            bench.replay("W 00 13 00 ; X 1200");
            bench.write(0x52, design, &[0x07, 0xD0]);
            bench.replay("W 00 42 00 ; X 1200");
            assert_eq!(bench.word(0x0E), full, "{chip} {keeps}");
            assert_eq!(bench.word(0x1C), 60, "{chip} {keeps}");
        }
    }
    let bench = Bench::new();
    bench.sim.set("keeps_full", "on").expect_err("Qmax has its own row");
    assert_eq!(bench.has("keeps_full"), "off");
}

#[test]
fn initcomp_never_comes() {
    for (chip, register, bit) in [("bq27441-g1", 0x00, 0x0080), ("bq27220", 0x3A, 0x0020)] {
        let bench = Bench::of(chip, &Options::default());
        bench.replay("W 00 00 00 ; X 20");
        assert_ne!(bench.word(register) & bit, 0, "{chip}");
        bench.set("no_initcomp", "on");
        bench.set("first_values", "nonsense");
        let full = if chip == "bq27220" { 0x12 } else { 0x0E };
        let before = bench.word(full);
        bench.sleeps(3600);
        bench.replay("W 00 00 00 ; X 20");
        assert_eq!(bench.word(register) & bit, 0, "{chip}");
        assert_eq!(bench.word(full), before, "{chip}");
        bench.set("no_initcomp", "off");
        bench.replay("W 00 00 00 ; X 20");
        assert_ne!(bench.word(register) & bit, 0, "{chip}");
    }
}

#[test]
fn a_loose_contact_resets_the_gauge_again_and_again() {
    let bench = Bench::of("bq27441-g1", &Options::default());
    bench.replay("W 00 13 00 ; X 1200");
    bench.write(0x52, 10, &[0x07, 0xD0]);
    bench.replay("W 00 42 00 ; X 1200");
    bench.set("reset_every_s", "60");
    bench.sleeps(59);
    assert_eq!((bench.word(0x06) & 0x0020, bench.word(0x3C)), (0, 2000));
    for _ in 0..3 {
        bench.replay("X 1100 ; R 06 2 -> NACK");
        bench.replay("X 400 ; R 04 2 -> 00 00");
        bench.sleeps(5);
        assert_ne!(bench.word(0x06) & 0x0020, 0, "[ITPOR]");
        assert_eq!(bench.word(0x3C), 1340);
        assert_ne!(bench.word(0x04), 0);
        bench.replay("X 53500");
    }
    bench.set("reset_every_s", "0");
    bench.sleeps(10);
    let voltage = bench.word(0x04);
    bench.sleeps(600);
    assert_eq!(bench.word(0x04), voltage);
}

/// It counts what it measures, until a rest shows the real depth of discharge.
#[test]
fn a_sense_resistor_of_another_value_makes_the_count_wrong() {
    let bench = Bench::unsealed();
    bench.set("soc", "90");
    // 5 mOhm where data flash has 10.
    bench.set("shunt_error", "-500");
    bench.set("load_ma", "500");
    bench.sleeps(3600);
    assert_eq!(bench.signed(0x10), -250);
    let (shown, real) = (bench.percent(), bench.has("real_soc"));
    assert!((64..=66).contains(&shown) && real.starts_with("40."), "{shown} {real}");
    bench.set("load_ma", "0");
    bench.sleeps(5 * 3600);
    assert!((39..=41).contains(&bench.percent()), "{}", bench.percent());
}

#[test]
fn without_a_thermistor_the_temperature_is_at_an_end() {
    let bench = Bench::new();
    assert_eq!(bench.word(0x0C), 2981);
    for (thermistor, shown) in [("out", 2331), ("short", 3931), ("in", 2981)] {
        bench.set("thermistor", thermistor);
        assert_eq!((bench.word(0x0C), bench.word(0x2A)), (shown, 2981), "{thermistor}");
    }
    // It uses its own sensor.
    let bench = Bench::of("bq27441-g1", &Options::default());
    bench.set("thermistor", "out");
    assert_eq!(bench.word(0x02), 2981);
}

#[test]
fn an_old_cell_has_more_resistance() {
    let bench = Bench::new();
    let drop = |bench: &Bench| {
        bench.set("load_ma", "0");
        let rest = bench.word(0x08);
        bench.set("load_ma", "1000");
        rest - bench.word(0x08)
    };
    assert_eq!(drop(&bench), 42);
    bench.set("cell_mohm", "420");
    assert_eq!(drop(&bench), 420);
}
