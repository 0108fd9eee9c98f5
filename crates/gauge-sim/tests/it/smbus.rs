// SPDX-License-Identifier: MIT

//! A Smart Battery by the Smart Battery Data Specification 1.1, and by a trace of a laptop with a pack of 2004.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim};

fn pack() -> (Sim, Arc<SimClock>) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("sbs", &Options::default(), clock.clone()).expect("a simulated part");
    clock.sleep(Duration::from_secs(1));
    (sim, clock)
}

fn read<const N: usize>(sim: &Sim, code: u8) -> [u8; N] {
    let mut bytes = [0; N];
    sim.bus().transfer(&[code], &mut bytes).expect("it answers");
    bytes
}

fn word(sim: &Sim, code: u8) -> u16 {
    u16::from_le_bytes(read(sim, code))
}

fn set(sim: &Sim, knob: &str, text: &str) {
    sim.set(knob, text).unwrap_or_else(|error| panic!("{knob} {text}: {error}"));
}

#[test]
fn each_word_is_at_its_own_code_in_the_units_of_the_specification() {
    let (pack, clock) = pack();
    assert_eq!(
        [0x08, 0x09, 0x0a, 0x0d, 0x0f, 0x10].map(|code| word(&pack, code)),
        [2981, 15420, 0, 60, 3030, 5050]
    );
    assert_eq!([0x11, 0x12, 0x13].map(|code| word(&pack, code)), [0xffff; 3], "no current, no time");
    assert_eq!([0x18, 0x19, 0x1a].map(|code| word(&pack, code)), [5200, 14400, 0x0031]);
    assert_eq!([0x3c, 0x3f].map(|code| word(&pack, code)), [3855; 2]);
    set(&pack, "load_ma", "1500");
    clock.sleep(Duration::from_secs(600));
    assert_eq!(word(&pack, 0x0a) as i16, -1500);
    assert_eq!((word(&pack, 0x11), word(&pack, 0x16) & 0x00f0), (111, 0x00c0));
    set(&pack, "battery_mode", "0x8000");
    assert_eq!(word(&pack, 0x18), 7488, "74.88 Wh in steps of 10 mWh");
}

/// Of the charging voltage and current the specification says that they have no scale.
#[test]
fn the_scales_divide_what_was_measured_and_not_what_a_charger_is_asked_for() {
    let (pack, clock) = pack();
    set(&pack, "series", "16");
    set(&pack, "load_ma", "-2000");
    clock.sleep(Duration::from_secs(2));
    let [voltage, current, charge] = [0x09, 0x0a, 0x10].map(|code| word(&pack, code));
    set(&pack, "specification", "0x1131");
    let scaled = [0x09, 0x0a, 0x10].map(|code| word(&pack, code));
    let tenth = |word: u16| (f64::from(word) / 10.0).round() as u16;
    assert_eq!(scaled, [voltage, current, charge].map(tenth));
    // 67.2 V do not fit into the word.
    assert_eq!([0x14, 0x15].map(|code| word(&pack, code)), [2600, 0xffff]);
}

#[test]
fn a_block_has_its_length_first_and_bytes_behind_its_text() {
    let (pack, _) = pack();
    assert_eq!(&read::<13>(&pack, 0x20), b"\x0cSim Cells\x0002");
    assert_eq!(&read::<5>(&pack, 0x22), b"\x04LION");
}

/// Bytes of the trace, whose packet error codes a pack has sent.
#[test]
fn packet_error_codes_are_those_of_a_real_pack() {
    let (pack, _) = pack();
    for (code, answer, pec) in [
        (0x01, &[0xdb, 0x01][..], 0xf1),
        (0x03, &[0x00, 0x80], 0x7e),
        (0x09, &[0x6b, 0x2c], 0xcd),
        (0x13, &[0xff, 0xff], 0xb4),
        (0x20, b"\x08SANYO\x0002", 0x83),
        (0x21, b"\x0bIBM-08K8193", 0xb1),
        (0x22, b"\x04LION", 0x31),
    ] {
        let hex: String = answer.iter().map(|byte| format!("{byte:02x}")).collect();
        set(&pack, "answers", &format!("{code:02x}={hex}"));
        let mut bytes = vec![0; answer.len() + 3];
        pack.bus().transfer(&[code], &mut bytes).expect("it answers");
        assert_eq!(bytes, [answer, &[pec; 3]].concat(), "0x{code:02x}: and the last byte repeats");
    }
    // A pack of TI behind an adapter that sends a STOP between the two messages.
    set(&pack, "pec", "split");
    set(&pack, "answers", "23=04217b5000");
    assert_eq!(read::<6>(&pack, 0x23)[5], 0x91);
    set(&pack, "pec", "missing");
    assert_eq!(read::<6>(&pack, 0x23)[5], 0x00);
}

#[test]
fn it_takes_what_a_driver_writes_and_counts_it() {
    let (pack, _) = pack();
    let write = |message: &[u8]| pack.bus().transfer(message, &mut []);
    write(&[0x03, 0x00, 0x80, 0x27]).expect("with its PEC");
    assert_eq!(word(&pack, 0x03), 0x8000);
    write(&[0x03, 0x00, 0x00]).expect("without one");
    assert_eq!(write(&[0x03, 0x00, 0x80, 0x28]), Err(BusError::NoAck), "with a wrong one");
    assert_eq!((word(&pack, 0x03), word(&pack, 0x00)), (0, 0x8306));
    // A sealed pack acknowledges each command, and a code that it does not have is the word before again.
    write(&[0x00, 0x54, 0x00]).expect("it takes it");
    assert_eq!(word(&pack, 0x09), word(&pack, 0x1d));
    assert_eq!(pack.bus().transfer(&[0x44], &mut [0; 2]), Err(BusError::NoAck));
    assert_eq!(pack.get("written").as_deref(), Some("4"));
}

#[test]
fn a_pack_that_sleeps_answers_a_second_after_it_was_addressed() {
    let (pack, clock) = pack();
    set(&pack, "sleeps", "on");
    assert_eq!(word(&pack, 0x0d), 60);
    clock.sleep(Duration::from_secs(20));
    let answers = || pack.bus().transfer(&[0x0d], &mut [0; 2]).is_ok();
    assert!(!answers());
    clock.sleep(Duration::from_millis(500));
    assert!(!answers());
    clock.sleep(Duration::from_millis(600));
    assert!(answers());
}

#[test]
fn answers_are_given_in_place_of_its_own() {
    let (pack, _) = pack();
    set(&pack, "answers", "0d=7800 1b=- all=1717");
    assert_eq!((word(&pack, 0x0d), word(&pack, 0x09)), (0x78, 0x1717));
    assert_eq!(pack.bus().transfer(&[0x1b], &mut [0; 2]), Err(BusError::NoAck));
    assert_eq!(pack.get("answers").as_deref(), Some("all=1717 0d=7800 1b=-"));
    for wrong in ["0d", "0d=7", "0d=gg", "all=-", "100=00"] {
        assert!(pack.set("answers", wrong).is_err(), "{wrong}");
    }
    set(&pack, "answers", "own");
    assert_eq!(word(&pack, 0x0d), 60);
    set(&pack, "power", "off");
    assert_eq!(pack.bus().transfer(&[0x0d], &mut [0; 2]), Err(BusError::NoAck));
}

fn played(name: &str) -> (Sim, Arc<SimClock>) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("sbs", &Options::default(), clock.clone()).expect("a simulated part");
    let scenario = gauge_sim::scenario::Scenario::read(name.as_ref(), None).expect("it is shipped");
    sim.play(scenario).expect("a pack can do it");
    (sim, clock)
}

#[test]
fn a_drone_lands_with_a_quarter_left_and_is_charged() {
    let (pack, clock) = played("drone-flight");
    clock.sleep(Duration::from_secs(5 * 60));
    let current = word(&pack, 0x0a) as i16;
    assert!((-25000..=-17000).contains(&current), "{current}");
    assert!(word(&pack, 0x11) < 20, "minutes to empty");
    clock.sleep(Duration::from_secs(7 * 60 + 30));
    let left = word(&pack, 0x0d);
    assert!((15..=35).contains(&left), "{left} %");
    clock.sleep(Duration::from_secs(30 * 60));
    assert_eq!(pack.bus().transfer(&[0x0d], &mut [0; 2]), Err(BusError::NoAck), "it is switched off");
    clock.sleep(Duration::from_secs(4 * 3600));
    assert_eq!(word(&pack, 0x0d), 100);
}

#[test]
fn a_laptop_counts_the_cycles_of_a_year() {
    let (pack, clock) = played("laptop-year");
    let before = word(&pack, 0x17);
    for _ in 0..365 {
        clock.sleep(Duration::from_secs(24 * 3600));
    }
    let cycles = word(&pack, 0x17) - before;
    assert!((180..=300).contains(&cycles), "{cycles}");
    assert_eq!(word(&pack, 0x0d), 100);
}

#[test]
fn a_pack_that_has_failed_lets_no_current_through_and_asks_for_none() {
    let (pack, clock) = played("failed-pack");
    clock.sleep(Duration::from_secs(29 * 60));
    assert_eq!((word(&pack, 0x0a) as i16, word(&pack, 0x16) & 0x4800), (-900, 0));
    assert!(word(&pack, 0x15) > 0);
    for _ in 0..3 {
        clock.sleep(Duration::from_secs(600));
        assert_eq!((word(&pack, 0x0a), word(&pack, 0x16) & 0x4800), (0, 0x4800));
        assert_eq!([0x14, 0x15].map(|code| word(&pack, code)), [0; 2]);
    }
    let left = word(&pack, 0x0d);
    clock.sleep(Duration::from_secs(3600));
    assert_eq!(word(&pack, 0x0d), left);
    pack.set("failed", "off").expect_err("for good");
}

/// A code by a block to 0x44 or a word to 0x00, with the checksums of a driver's tests and of two lines for i2cset.
#[test]
fn a_gauge_of_tis_answers_a_code_and_takes_a_shutdown_that_comes_twice() {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("bq40z50-r2", &Options::default(), clock.clone()).expect("a simulated part");
    clock.sleep(Duration::from_secs(1));
    let send = |message: &[u8]| sim.bus().transfer(message, &mut []);
    let harm = || sim.get("harm").expect("a knob");

    // Length, code, and type 0x4500, and the packet error code behind.
    send(&[0x44, 2, 0x01, 0x00]).expect("DeviceType()");
    assert_eq!(read::<5>(&sim, 0x44), [4, 0x01, 0x00, 0x00, 0x45]);
    send(&[0x44, 2, 0x02, 0x00, 0x46]).expect("FirmwareVersion(), most significant bytes first");
    assert_eq!(read::<9>(&sim, 0x44)[..9], [13, 0x02, 0x00, 0x45, 0x00, 0x02, 0x11, 0x00, 52]);
    send(&[0x44, 2, 0x54, 0x00, 0x34]).expect("OperationStatus()");
    assert_eq!(read::<8>(&sim, 0x44), [6, 0x54, 0x00, 0x07, 0x03, 0x00, 0x00, 0x0d]);
    // Without the code at 0x23, by either way to ask.
    assert_eq!(read::<5>(&sim, 0x23), [4, 0x07, 0x03, 0x00, 0x00]);
    send(&[0x00, 0x01, 0x00, 0x06]).expect("by a word");
    assert_eq!(read::<3>(&sim, 0x23), [2, 0x00, 0x45]);

    set(&sim, "failed", "on");
    send(&[0x44, 2, 0x53, 0x00, 0x5f]).expect("PFStatus()");
    assert_eq!(read::<7>(&sim, 0x44), [6, 0x53, 0x00, 0x02, 0x00, 0x00, 0x00]);
    send(&[0x44, 2, 0x01, 0x00]).expect("DeviceType()");

    // A wrong checksum takes no code.
    assert_eq!(send(&[0x44, 2, 0x54, 0x00, 0x35]), Err(BusError::NoAck));
    assert_eq!(read::<3>(&sim, 0x23), [2, 0x00, 0x45]);

    // Sealed it takes no command but a shutdown that comes twice within four seconds.
    for code in [0x1d, 0x22, 0x29, 0x30, 0x41, 0x10] {
        send(&[0x00, code, 0x00]).expect("it is acknowledged");
    }
    assert_eq!(harm(), "0");
    clock.sleep(Duration::from_secs(5));
    send(&[0x00, 0x10, 0x00]).expect("once more, too late");
    assert_eq!(harm(), "0");
    send(&[0x44, 2, 0x10, 0x00]).expect("twice");
    assert_eq!(harm(), "1");
    sim.bus().transfer(&[0x09], &mut [0; 2]).expect_err("it is off");
    set(&sim, "power", "off");
    set(&sim, "power", "on");
    clock.sleep(Duration::from_secs(1));
    set(&sim, "sealed", "off");
    send(&[0x00, 0x29, 0x00]).expect("it is acknowledged");
    assert_eq!(harm(), "2", "unsealed it takes every command");
}
