// SPDX-License-Identifier: MIT

//! A gauge of which only the standard commands are known.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim};

fn sim(chip: &str) -> (Sim, Arc<SimClock>) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("a simulated part");
    clock.sleep(Duration::from_secs(1));
    (sim, clock)
}

fn word(sim: &Sim, register: u8) -> u16 {
    let mut word = [0; 2];
    sim.bus().transfer(&[register], &mut word).expect("it answers");
    u16::from_le_bytes(word)
}

#[test]
fn it_shows_its_battery_where_the_drivers_map_says() {
    let (gauge, clock) = sim("bq27541");
    assert_eq!((word(&gauge, 0x06), word(&gauge, 0x08), word(&gauge, 0x2c)), (2981, 3855, 58));
    gauge.set("load_ma", "500").expect("a knob");
    clock.sleep(Duration::from_secs(120));
    assert_eq!(word(&gauge, 0x14) as i16, -500);
    let (small, _) = sim("bq27521");
    assert_eq!((word(&small, 0x0a), word(&small, 0x0c)), (2981, 3855));
}

#[test]
fn a_bq27000_counts_quarter_kelvins_and_has_its_sign_in_the_flags() {
    let (gauge, clock) = sim("bq27000");
    assert_eq!(word(&gauge, 0x06), 1192);
    for (load, charging) in [("500", 0), ("-500", 0x80)] {
        gauge.set("load_ma", load).expect("a knob");
        clock.sleep(Duration::from_secs(200));
        assert_eq!(word(&gauge, 0x14), 2801, "500 mA in steps of 0.1785 mA");
        assert_eq!(word(&gauge, 0x0a) & 0x80, charging);
    }
}

#[test]
fn it_answers_for_its_type_and_takes_nothing_else() {
    let (gauge, _) = sim("bq27520-g4");
    let ask = |code: u8| {
        gauge.bus().transfer(&[0x00, code, 0x00], &mut []).expect("it takes the word");
        word(&gauge, 0x00)
    };
    assert_eq!([ask(0x01), ask(0x02)], [0x0520, 0x0329]);
    for register in [0x02, 0x3e, 0x3f, 0x40, 0x60, 0x61] {
        assert_eq!(
            gauge.bus().transfer(&[register, 0x00], &mut []),
            Err(BusError::NoAck),
            "0x{register:02x}"
        );
    }
    // Without Control() not even that is taken.
    let (gauge, _) = sim("bq27000");
    assert_eq!(gauge.bus().transfer(&[0x00, 0x01, 0x00], &mut []), Err(BusError::NoAck));
}

#[test]
fn it_has_the_knobs_that_have_an_effect() {
    let (gauge, _) = sim("bq27546");
    let knobs: Vec<_> = gauge.knobs().iter().map(|knob| knob.name).collect();
    for knob in ["load_ma", "soc", "temperature", "speed", "voltage_mv", "power", "fault", "transfers"] {
        assert!(knobs.contains(&knob), "{knob}");
    }
    for knob in ["seal", "wear", "commit_ms", "protocol", "df_shift"] {
        assert!(!knobs.contains(&knob), "{knob}");
    }
    gauge.set("power", "off").expect("a knob");
    assert_eq!(gauge.bus().transfer(&[0x08], &mut [0; 2]), Err(BusError::NoAck));
}
