// SPDX-License-Identifier: MIT

//! Unfriendly behaviour of real gauges: each alone, set by its knob, beside a gauge without it.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim};

use crate::bench::{Bench, sum};

const FLASH: &str = "bq34z100-g1";
const RAM: &str = "bq27441-g1";
const MAC: &str = "bq35100";
const UNSEAL: &str = "W 00 14 04 ; W 00 72 36";
const UNSEAL_RAM: &str = "W 00 00 80 ; W 00 00 80";
/// Every other part that is simulated.
const OTHERS: [&str; 7] =
    ["bq27520-g3", "bq27500", "bq27421-g1", "bq27426", "bq27427", "bq27621-g1", "bq34110"];

fn with(chip: &str, options: &Options) -> Bench {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip, options, clock.clone()).unwrap();
    Bench { sim, clock }
}

/// A gauge with these knobs, a second after it was made.
fn gauge(chip: &str, knobs: &[(&str, &str)]) -> Bench {
    let bench = with(chip, &Options::default());
    for (knob, text) in knobs {
        bench.set(knob, text);
    }
    bench.sleep(1);
    bench
}

/// An unsealed gauge with the knobs set.
fn open(chip: &str, knobs: &[(&str, &str)]) -> Bench {
    let bench = gauge(chip, knobs);
    bench.replay(if chip == RAM { UNSEAL_RAM } else { UNSEAL });
    assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    bench
}

fn seal(bench: &Bench) -> String {
    bench.sim.get("seal").unwrap()
}

/// The blocks that differ, as subclass and block.
fn changed(a: &Sim, b: &Sim) -> usize {
    a.flash().iter().zip(b.flash()).filter(|&(a, ref b)| a != b).count()
}

mod blocks {
    use super::*;

    const BLOCKS: [(u8, u8); 6] = [(48, 0), (48, 1), (64, 0), (80, 0), (81, 0), (104, 0)];

    fn select(bench: &Bench, (class, block): (u8, u8)) {
        bench.replay(&format!("W 61 00 ; W 3E {class:02X} ; W 3F {block:02X}"));
    }

    fn window(bench: &Bench) -> Vec<u8> {
        let mut read = vec![0; 33];
        bench.sim.bus().transfer(&[0x40], &mut read).unwrap();
        read
    }

    #[test]
    fn each_block_is_ready_at_its_own_time() {
        let friendly = open(FLASH, &[]);
        for early in ["previous", "blank"] {
            let bench = open(FLASH, &[("block_ms", "50"), ("early", early)]);
            let mut before = window(&bench);
            let mut times = BTreeSet::new();
            for place in BLOCKS {
                select(&friendly, place);
                let right = window(&friendly);
                select(&bench, place);
                let from = bench.clock.now();
                let mut read = window(&bench);
                while read != right {
                    assert_eq!(read[32], sum(&read[..32]), "{early} {place:?}");
                    let expected = if early == "blank" { &[0; 32][..] } else { &before[..32] };
                    assert_eq!(&read[..32], expected, "{early} {place:?}");
                    read = window(&bench);
                }
                let took = bench.clock.now() - from;
                assert!(took < Duration::from_millis(54), "{took:?}");
                times.insert(took);
                before = read;
            }
            assert!(times.len() > 2, "{times:?}");
        }
    }

    #[test]
    fn an_address_is_ready_at_its_own_time_too() {
        let read = |bench: &Bench| {
            bench.replay("W 3E 00 40 ; X 60 ; W 3E B1 41");
            let mut read = [0; 36];
            bench.sim.bus().transfer(&[0x3E], &mut read).unwrap();
            read
        };
        let right = read(&open(MAC, &[]));
        // The delay differs from gauge to gauge, and is long enough for some.
        let late = |early: &str| {
            let gauges = (0..8).map(|seed| {
                let bench = with(MAC, &Options { seed, ..Options::default() });
                bench.set("block_ms", "50");
                bench.set("early", early);
                bench.replay(UNSEAL);
                read(&bench)
            });
            gauges.filter(|read| *read != right).collect::<Vec<_>>()
        };
        let blank = late("blank");
        assert!(!blank.is_empty());
        for read in blank {
            assert_eq!((&read[..2], &read[2..34]), (&right[..2], &[0; 32][..]));
            assert_eq!(read[34], sum(&read[..34]));
        }
        let previous = late("previous");
        assert!(!previous.is_empty());
        for read in previous {
            assert_eq!((read[0], read[1]), (0xB1, 0x41));
            assert_eq!(read[34], sum(&[&[0x00, 0x40][..], &read[2..34]].concat()));
        }
    }
}

mod commits {
    use super::*;

    #[test]
    fn a_commit_takes_its_time() {
        let friendly = open(FLASH, &[]);
        friendly.write(48, 4, &[0xAA; 2]);
        friendly.replay("R 08 2 -> ..");
        assert!(friendly.number("stretched_us") < 40e3);
        let bench = open(FLASH, &[("commit_ms", "200")]);
        bench.write(48, 4, &[0xAA; 2]);
        bench.replay("R 08 2 -> ..");
        assert!(bench.number("stretched_us") > 200e3);
    }

    #[test]
    fn it_may_leave_the_gauge_deaf() {
        let bench = open(FLASH, &[("commit_ms", "200"), ("commit_busy", "nack")]);
        bench.write(48, 4, &[0xAA; 2]);
        bench.replay("R 08 2 -> NACK ; X 200 ; R 08 2 -> NACK ; X 40 ; R 08 2 -> ..");
        assert_eq!(bench.block(48, 0).0[4..6], [0xAA; 2]);
    }

    #[test]
    fn it_may_leave_the_old_block_to_be_read() {
        let bench = open(FLASH, &[("commit_ms", "200"), ("commit_busy", "old")]);
        let (old, _) = bench.block(48, 0);
        bench.write(48, 4, &[0xAA; 2]);
        assert_eq!(bench.block(48, 0), (old, sum(&old)));
        // What was loaded is not loaded again by itself.
        bench.replay("X 300 ; R 44 2 -> 00 01");
        assert_eq!(bench.block(48, 0).0[4..6], [0xAA; 2]);
        let bench = open(MAC, &[("commit_ms", "200"), ("commit_busy", "old")]);
        bench.replay("W 3E B1 41 82 ; W 60 8B 05 ; W 3E B1 41 ; R 40 1 -> 80");
        bench.replay("X 300 ; W 3E B1 41 ; R 40 1 -> 82");
    }

    /// It programs one row after the other, and does not begin one of its own while another is at work.
    #[test]
    fn it_is_shown_when_it_is_over_whatever_is_stored_next() {
        for chip in [FLASH, MAC] {
            let bench = open(chip, &[("commit_ms", "200"), ("commit_busy", "old"), ("rewrite_every", "1")]);
            let show = if chip == MAC { "W 3E B1 41 ; R 40 1" } else { "W 3E 30 ; W 3F 00 ; R 44 1" };
            match chip {
                MAC => bench.replay("W 3E B1 41 82 ; W 60 8B 05"),
                _ => bench.write(48, 4, &[0x82; 2]),
            }
            (0..50).for_each(|_| bench.replay(&format!("X 10 ; {show} -> ..")));
            bench.replay(&format!("{show} -> 82"));
        }
    }

    /// The rows 48/0 and 48/1 after power was lost in a commit of 48/0.
    fn torn(tear: &str) -> ([u8; 32], [u8; 32]) {
        let bench = open(FLASH, &[("tear", tear), ("fault", "torn-commit 4")]);
        bench.write(48, 4, &[0xAA; 10]);
        bench.set("power", "on");
        bench.sleep(1);
        bench.replay(UNSEAL);
        (bench.block(48, 0).0, bench.block(48, 1).0)
    }

    #[test]
    fn power_lost_in_a_commit_leaves_what_flash_leaves() {
        let bench = open(FLASH, &[]);
        let (old, other) = (bench.block(48, 0).0, bench.block(48, 1).0);
        let mut new = old;
        new[4..14].fill(0xAA);
        let row = |rest: &[u8; 32]| -> [u8; 32] { [&new[..8], &rest[8..]].concat().try_into().unwrap() };
        assert_eq!(torn("rest-old"), (row(&old), other));
        assert_eq!(torn("rest-erased"), (row(&[0xFF; 32]), other));
        assert_eq!(torn("old"), (old, other));
        assert_eq!(torn("erased"), ([0xFF; 32], other));
        let (same, disturbed) = torn("neighbour");
        assert_eq!(same, new);
        assert_ne!(disturbed, other);
        for (now, before) in disturbed.into_iter().zip(other) {
            assert!(now == 0xFF || now & !before == 0, "{now:02X} {before:02X}");
        }
    }

    #[test]
    fn the_row_of_a_single_row_area_is_erased_instead_of_its_neighbour() {
        let bench = open(FLASH, &[("tear", "neighbour"), ("fault", "torn-commit 4")]);
        bench.write(64, 0, &[0x41]);
        bench.set("power", "on");
        bench.sleep(1);
        bench.replay(UNSEAL);
        assert_eq!(bench.block(64, 0).0[..8], [0xFF; 8]);
    }

    /// The commit of an address erases the rows in which it is.
    #[test]
    fn an_address_is_torn_with_its_row() {
        let bench = open(MAC, &[("tear", "erased"), ("fault", "torn-commit 0")]);
        bench.replay("W 3E B1 41 82 ; W 60 8B 05");
        let flash = bench.sim.flash();
        assert_eq!(flash[0x1A0..0x1C0], [0xFF; 32]);
        assert_ne!((flash[0x1C0], flash[0x1CC]), (0xFF, 0xFF));
    }

    #[test]
    fn a_worn_out_block_keeps_bits_at_0() {
        for (endurance, worn) in [("0", false), ("3", true)] {
            let bench = open(FLASH, &[("endurance", endurance)]);
            let right: Vec<bool> = (0..5)
                .map(|_| {
                    bench.write(58, 0, &[0xFF; 32]);
                    bench.replay("X 50");
                    bench.block(58, 0).0 == [0xFF; 32]
                })
                .collect();
            assert_eq!(right, [true, true, true, !worn, !worn]);
            assert_eq!(bench.number("dropped"), 0.0);
        }
    }
}

mod resets {
    use super::*;

    #[test]
    fn a_reset_takes_its_time() {
        for (ms, answers) in [("175", true), ("500", false)] {
            let bench = open(FLASH, &[("reset_ms", ms), ("reset_busy", "nack")]);
            bench.replay("W 00 41 00 ; R 08 2 -> NACK ; X 180");
            assert_eq!(bench.sim.bus().transfer(&[0x08], &mut [0; 2]).is_ok(), answers);
            bench.replay("X 330 ; R 08 2 -> ..");
        }
    }

    #[test]
    fn a_gauge_may_answer_as_before_and_then_reset() {
        let bench = open(FLASH, &[("reset_ms", "500"), ("reset_busy", "old")]);
        bench.replay("W 00 41 00 ; X 400 ; R 08 2 -> ..");
        assert_eq!(seal(&bench), "unsealed");
        bench.replay("X 110 ; R 08 2 -> ..");
        assert_eq!((seal(&bench).as_str(), bench.number("resets")), ("sealed", 1.0));
    }

    #[test]
    fn resets_seals_and_keys_are_lost_as_often_as_asked_for() {
        for chip in [FLASH, MAC] {
            for (reset, seal_, key) in
                [("drop_resets", "drop_seals", "drop_keys"), ("fault", "fault", "fault")]
            {
                let once =
                    |knob: &str, fault: &str| if knob == "fault" { fault.to_string() } else { "1".into() };
                let bench = open(chip, &[]);
                bench.set(reset, &once(reset, "drop-reset"));
                bench.replay("W 00 41 00 ; X 1000");
                assert_eq!((seal(&bench).as_str(), bench.number("resets")), ("unsealed", 0.0));
                bench.set(seal_, &once(seal_, "drop-seal"));
                bench.replay("W 00 20 00");
                assert_eq!(seal(&bench), "unsealed");
                bench.replay("W 00 20 00");
                assert_eq!(seal(&bench), "sealed");
                bench.set(key, &once(key, "drop-key"));
                bench.replay(UNSEAL);
                assert_eq!(seal(&bench), "sealed");
                bench.replay(UNSEAL);
                assert_eq!(seal(&bench), "unsealed");
                bench.replay("W 00 41 00 ; X 1000");
                assert_eq!((seal(&bench).as_str(), bench.number("resets")), ("sealed", 1.0));
            }
        }
    }

    #[test]
    fn the_first_values_after_a_reset_are_wrong() {
        for (chip, voltage, percent) in [(FLASH, 0x08, 0x02), (MAC, 0x08, 0x2E)] {
            for first in ["", "old", "nonsense"] {
                let knobs: &[_] = &[("first_ms", "1500"), ("first_values", first)];
                let bench = open(chip, if first.is_empty() { &[] } else { knobs });
                let right = (bench.word(voltage), bench.word(percent) as u8);
                bench.replay("W 00 41 00 ; X 1000");
                let read = (bench.word(voltage), bench.word(percent) as u8);
                match first {
                    "" => assert_eq!(read, right),
                    "old" => assert_eq!(read, (0, right.1)),
                    _ => assert!(read.0 == 0 && read.1 != right.1, "{chip} {read:?}"),
                }
                bench.replay("X 1000");
                assert_eq!((bench.word(voltage), bench.word(percent) as u8), right, "{chip} {first}");
            }
        }
    }

    /// Until INITCOMP, the gauge shows the values from before a loss of power, although the pack has changed.
    #[test]
    fn predictions_are_old_until_initcomp() {
        const INITCOMP: u16 = 0x0080;
        let read = |knobs: &[(&str, &str)]| {
            let bench = gauge(RAM, knobs);
            bench.set("power", "off");
            bench.set("power", "on");
            bench.set("soc", "20");
            bench.replay("X 300");
            let mut read = Vec::new();
            for _ in 0..5 {
                // BAT_INSERT is what completes the initialization of a part without a pin.
                bench.replay("W 00 0C 00");
                read.push((bench.status() & INITCOMP != 0, bench.word(0x1C) > 50));
                bench.sleep(1);
            }
            read
        };
        assert!(read(&[]).iter().all(|&(_, old)| !old));
        let late = read(&[("first_ms", "2000")]);
        assert!(late.iter().all(|&(complete, old)| complete != old), "{late:?}");
        assert!(late[0].1 && late[4].0, "{late:?}");
    }
}

mod security {
    use super::*;

    #[test]
    fn control_status_may_show_a_change_late() {
        for (ms, late) in [("0", false), ("200", true)] {
            let bench = open(FLASH, &[("status_ms", ms)]);
            assert_eq!(bench.status() & 0x2000 != 0, late);
            bench.replay("X 200");
            assert_eq!(bench.status() & 0x6000, 0x4000);
            bench.replay("W 00 20 00");
            assert_eq!(bench.status() & 0x2000 == 0, late);
            bench.replay("X 200");
            assert_eq!(bench.status() & 0x6000, 0x6000);
            let bench = open(MAC, &[("status_ms", ms)]);
            assert_eq!(bench.word(0x00) & 0x2000 != 0, late);
            bench.replay("X 200");
            assert_eq!(bench.word(0x00) & 0x6000, 0x4000);
            // OperationStatus() and the subcommand for it.
            let bench = open("bq34110", &[("status_ms", ms)]);
            let shown = || {
                bench.replay("W 3E 54 00");
                [bench.word(0x3A), bench.word(0x40)]
            };
            let before = shown();
            bench.replay("X 200");
            let after = shown();
            assert_eq!([before[0] != after[0], before[1] != after[1]], [late; 2]);
        }
    }

    #[test]
    fn a_wrong_or_interrupted_key_may_lock_a_gauge_with_ram() {
        for refused in ["W 00 34 12 ; W 00 00 80", "W 00 00 80 ; W 00 00 00", "W 00 00 80 ; W 00 34 12"] {
            let bench = gauge(RAM, &[("seal", "sealed")]);
            bench.replay(refused);
            bench.replay(UNSEAL_RAM);
            assert_eq!(seal(&bench), "unsealed", "{refused}");
            let bench = gauge(RAM, &[("seal", "sealed"), ("key_lock", "on"), ("lock_ms", "4500")]);
            bench.replay(refused);
            // A try within the time starts it again.
            bench.replay("X 4400");
            bench.replay(UNSEAL_RAM);
            bench.replay("X 4490 ; W 00 00 00 ; X 20");
            assert_eq!(seal(&bench), "sealed", "{refused}");
            bench.replay(UNSEAL_RAM);
            assert_eq!(seal(&bench), "unsealed", "{refused}");
        }
    }

    #[test]
    fn a_refused_key_may_need_silence() {
        for (ms, taken) in [("0", "unsealed"), ("4500", "sealed")] {
            let bench = gauge(MAC, &[("refused_quiet_ms", ms)]);
            bench.replay("W 00 34 12 ; W 00 78 56 ; X 4400");
            bench.replay(UNSEAL);
            assert_eq!(seal(&bench), taken);
            bench.replay("X 4510");
            bench.replay(UNSEAL);
            assert_eq!(seal(&bench), "unsealed");
        }
    }
}

mod rewrites {
    use super::*;

    #[test]
    fn the_gauge_rewrites_its_own_values_in_time_and_by_transfers() {
        for chip in [FLASH, RAM, MAC].into_iter().chain(OTHERS) {
            let friendly = gauge(chip, &[]);
            for knob in [("rewrite_ms", "500"), ("rewrite_every", "10")] {
                let bench = gauge(chip, &[knob]);
                for bench in [&friendly, &bench] {
                    (0..100).for_each(|_| bench.replay("X 50 ; R 08 2 -> .."));
                }
                assert_eq!(friendly.number("programmed"), 0.0, "{chip}");
                let times = bench.number("programmed");
                assert!((8.0..=11.0).contains(&times), "{chip} {knob:?} {times}");
                let moved = changed(&friendly.sim, &bench.sim);
                assert!((1..=11).contains(&moved), "{chip} {knob:?} {moved}");
            }
        }
    }

    /// Between two readings of the row that hosts write most.
    #[test]
    fn a_value_changes_in_a_row_that_hosts_write() {
        let bench = open(FLASH, &[("rewrite_every", "1")]);
        let moved = (0..100).any(|_| {
            let (before, _) = bench.block(48, 0);
            bench.block(48, 0).0 != before
        });
        assert!(moved);
    }

    #[test]
    fn nothing_is_rewritten_in_config_update() {
        let bench = open(RAM, &[("rewrite_every", "1")]);
        bench.replay("W 00 13 00 ; X 1200 ; R 06 2 -> ..");
        let flash = bench.sim.flash();
        (0..20).for_each(|_| bench.replay("R 06 2 -> .."));
        assert_eq!(bench.sim.flash(), flash);
    }
}

mod wires {
    use super::*;

    #[test]
    fn an_adapter_has_its_own_error_for_a_nack() {
        for (word, error) in [
            ("enxio", BusError::NoAck),
            ("eio", BusError::Other(5)),
            ("etimedout", BusError::Timeout),
            ("eagain", BusError::ArbitrationLost),
        ] {
            let bench = gauge(FLASH, &[("nack_as", word)]);
            assert_eq!(bench.sim.bus().transfer(&[0x80], &mut []), Err(error));
            assert_eq!(bench.sim.bus_at(0x10).transfer(&[], &mut []), Err(error));
            assert_eq!(bench.sim.get("nacks").unwrap(), "2");
        }
    }

    #[test]
    fn a_single_nack_may_be_reported_otherwise() {
        let bench = gauge(FLASH, &[("fault", "eio 1; etimedout 2 0; eagain 3; nack 4")]);
        let mut bus = bench.sim.bus();
        let results: Vec<_> = (0..5).map(|_| bus.transfer(&[0x08], &mut [0; 2])).collect();
        let errors = [BusError::Other(5), BusError::Timeout, BusError::ArbitrationLost, BusError::NoAck];
        assert_eq!(results[..4], errors.map(Err));
        assert_eq!(results[4], Ok(()));
        assert_eq!(bench.sim.get("nacks").unwrap(), "4");
    }

    #[test]
    fn bursts_and_silence() {
        let bench = gauge(FLASH, &[("fault", "burst 1 1 2 0; burst 2 0 99 255; silence 3 300")]);
        bench.replay("R 3A 4 -> 61 00 00 03 ; R 3A 4 -> FF FF FF FF");
        bench.replay("R 3A 2 -> NACK ; X 290 ; R 3A 2 -> NACK ; X 10 ; R 3A 2 -> 61 01");
    }

    #[test]
    fn versions_need_not_be_the_printed_ones() {
        let bench = gauge(FLASH, &[("firmware", "0x0017"), ("hardware", "0x000A")]);
        bench.replay(
            "W 00 02 00 ; R 00 2 -> 17 00 ; W 00 03 00 ; R 00 2 -> 0A 00 ; W 00 01 00 ; R 00 2 -> 00 01",
        );
        bench.set("firmware", "printed");
        bench.replay("W 00 02 00 ; R 00 2 -> 16 00");
        assert!(bench.sim.set("firmware", "17").is_err());
        let bench = gauge(MAC, &[("firmware", "0x0019"), ("hardware", "0x00A9")]);
        bench.replay("W 3E 02 00 ; R 40 6 -> 01 00 00 19 00 08 ; W 3E 03 00 ; R 40 2 -> A9 00");
    }

    #[test]
    fn multi_byte_writes_may_be_refused() {
        let friendly = gauge(FLASH, &[]);
        friendly.replay("W 00 01 00");
        let bench = gauge(FLASH, &[("single_byte", "on")]);
        bench.replay("W 00 01 00 -> NACK ; W 00 01 ; W 01 00 ; R 00 2 -> 00 01");
    }

    #[test]
    fn a_start_right_after_stop_may_not_be_acknowledged() {
        let bench = gauge(FLASH, &[("bus_free_us", "66")]);
        bench.replay("R 3A 2 -> 61 01 ; R 3A 2 -> NACK ; X 1 ; R 3A 2 -> 61 01");
    }

    #[test]
    fn too_many_standard_commands_reset_the_gauge() {
        // Milliseconds between transfers, the register, and whether the gauge resets.
        for (knob, every, register, resets) in [
            ("off", 100, "R 08 2 -> ..", false),
            ("on", 100, "R 08 2 -> ..", true),
            ("on", 500, "R 08 2 -> ..", false),
            ("on", 10, "W 00 00 00", false),
            ("on", 10, "R 00 2 -> ..", false),
            ("on", 10, "R 40 20 -> ..", false),
        ] {
            let bench = gauge(RAM, &[("watchdog", knob)]);
            let count = 10_000 / every;
            let fails = (0..count).any(|_| {
                bench.replay(&format!("X {every}"));
                let register: Vec<&str> = register.split("->").collect();
                let first = u8::from_str_radix(&register[0][2..4], 16).unwrap();
                let reads = register.len() > 1;
                let (write, read) = (if reads { vec![first] } else { vec![0, 0, 0] }, &mut [0; 2]);
                bench.sim.bus().transfer(&write, if reads { read } else { &mut [] }).is_err()
            });
            assert_eq!((fails, bench.number("resets") > 0.0), (resets, resets), "{knob} {every} {register}");
            if resets {
                bench.replay("X 300");
                assert_eq!(bench.status() & 0x4000, 0x4000);
            }
        }
    }
}

mod draws {
    use super::*;

    fn draw(chip: &str, seed: u64) -> Bench {
        with(chip, &Options { envelope: Some(seed), ..Options::default() })
    }

    #[test]
    fn a_gauge_repeats_with_its_seed() {
        let shown: BTreeSet<String> = (0..50).map(|seed| draw(FLASH, seed).sim.envelope()).collect();
        assert_eq!(shown.len(), 50);
        assert_eq!(draw(FLASH, 7).sim.envelope(), draw(FLASH, 7).sim.envelope());
        assert!(draw(FLASH, 7).sim.envelope().starts_with("seed 7: block_ms "));
    }

    #[test]
    fn every_value_is_within_its_range() {
        for chip in [FLASH, RAM, MAC].into_iter().chain(OTHERS) {
            for seed in 0..200 {
                let bench = draw(chip, seed);
                let shown = bench.sim.envelope();
                for (knob, least, most) in [
                    ("block_ms", 0.0, 50.0),
                    ("commit_ms", 0.0, 218.0),
                    ("reset_ms", 0.0, 500.0),
                    ("first_ms", 1000.0, 2000.0),
                    ("status_ms", 0.0, 200.0),
                    ("full_access_quiet_ms", 0.0, 5000.0),
                    ("refused_quiet_ms", 0.0, 5000.0),
                    ("rewrite_ms", 0.0, 5000.0),
                    ("bus_free_us", 0.0, 66.0),
                ] {
                    let value = bench.number(knob);
                    assert!((least..=most).contains(&value), "{chip}: {knob}: {shown}");
                    assert!(shown.contains(&format!("{knob} {value}")), "{knob}: {shown}");
                }
                let lock = bench.sim.get("lock_ms").map(|ms| ms.parse::<f64>().unwrap());
                assert!(lock.is_none_or(|ms| (4000.0..=5000.0).contains(&ms)), "{shown}");
            }
        }
    }

    #[test]
    fn every_behaviour_is_drawn() {
        let all: String =
            (0..100).flat_map(|seed| [FLASH, RAM, MAC].map(|chip| draw(chip, seed).sim.envelope())).collect();
        for word in [
            "early previous",
            "early blank",
            "uncommitted written",
            "uncommitted stored",
            "commit_busy nack",
            "commit_busy stretch",
            "commit_busy old",
            "tear old",
            "tear erased",
            "tear rest-old",
            "tear rest-erased",
            "tear neighbour",
            "reset_busy nack",
            "reset_busy old",
            "reset_busy stretch",
            "first_values old",
            "first_values nonsense",
            "key_lock on",
            "drop_resets 1",
            "drop_seals 1",
            "drop_keys 1",
            "drop_updates 1",
            "reseals on",
            "cal_enable on",
            "rewrite_every 1",
            "nack_as enxio",
            "nack_as eio",
            "nack_as etimedout",
            "nack_as eagain",
            "firmware 0x0017",
            "hardware 0x0009",
            "watchdog on",
            "bus_free_us 66",
        ] {
            assert!(all.contains(word), "{word}");
        }
    }

    /// Random faults are of all kinds then.
    #[test]
    fn a_drawn_gauge_has_every_kind_of_random_fault() {
        let count = |envelope| {
            let bench = with(FLASH, &Options { envelope, seed: 3, ..Options::default() });
            bench.set("fault", "random 500");
            bench.set("nack_as", "enxio");
            bench.set("bus_free_us", "0");
            bench.set("watchdog", "off");
            let mut bus = bench.sim.bus();
            (0..500).filter(|_| bus.transfer(&[0x08], &mut [0; 2]) == Err(BusError::Other(5))).count()
        };
        assert_eq!(count(None), 0);
        assert!(count(Some(3)) > 0);
    }
}

/// A host that waits for as long as any gauge of the envelope needs.
struct Patient(Bench);

impl Patient {
    fn wait(&self, ms: u64) {
        self.0.clock.sleep(Duration::from_millis(ms));
    }

    /// Repeats a transfer until it is acknowledged.
    fn transfer(&self, write: &[u8], read: &mut [u8]) {
        let mut bus = self.0.sim.bus();
        let acknowledged = (0..400).any(|_| {
            self.wait(2);
            bus.transfer(write, read).is_ok()
        });
        assert!(acknowledged, "{write:02X?}: {}", self.0.sim.envelope());
    }

    fn words(&self, words: &[u16]) {
        for word in words {
            let [low, high] = word.to_le_bytes();
            self.transfer(&[0x00, low, high], &mut []);
        }
    }

    /// Sends words until the gauge has the seal state; one attempt may be lost.
    fn go_to(&self, words: &[u16], state: &str) {
        for _ in 0..2 {
            if seal(&self.0) != state {
                self.wait(5100);
                self.words(words);
            }
        }
        assert_eq!(seal(&self.0), state, "{}", self.0.sim.envelope());
    }

    fn block(&self, class: u8, block: u8) -> Vec<u8> {
        for write in [[0x61, 0], [0x3E, class], [0x3F, block]] {
            self.transfer(&write, &mut []);
        }
        self.wait(60);
        let mut read = vec![0; 33];
        self.transfer(&[0x40], &mut read);
        assert_eq!(read[32], sum(&read[..32]));
        read.truncate(32);
        read
    }

    /// Changes a byte of a block, and reads it back.
    fn change(&self, (class, number): (u8, u8), at: u8, byte: u8) {
        let mut block = self.block(class, number);
        block[usize::from(at)] = byte;
        self.transfer(&[0x40 + at, byte], &mut []);
        self.transfer(&[0x60, sum(&block)], &mut []);
        self.wait(600);
        assert_eq!(self.block(class, number)[usize::from(at)], byte, "{}", self.0.sim.envelope());
    }
}

/// No behaviour, nor any two together, makes a gauge that cannot be used.
#[test]
fn a_patient_host_can_write_every_drawn_gauge() {
    for seed in 0..200 {
        let made = |chip| {
            let host = Patient(with(chip, &Options { envelope: Some(seed), ..Options::default() }));
            host.wait(3000);
            host
        };
        let host = made(FLASH);
        host.go_to(&[0x0414, 0x3672], "unsealed");
        host.change((58, 0), 3, 0x5A);
        host.go_to(&[0x0020], "sealed");
        let host = made(RAM);
        host.go_to(&[0x8000, 0x8000], "unsealed");
        host.words(&[0x0013]);
        host.wait(1200);
        host.change((82, 0), 10, 0x5A);
        host.words(&[0x0043]);
        host.wait(1200);
        host.go_to(&[0x0020], "sealed");
        let host = made(MAC);
        host.go_to(&[0x0414, 0x3672], "unsealed");
        host.transfer(&[0x3E, 0xB1, 0x41, 0x82], &mut []);
        host.transfer(&[0x60, 0x8B, 0x05], &mut []);
        host.wait(600);
        host.transfer(&[0x3E, 0xB1, 0x41], &mut []);
        host.wait(60);
        let mut read = [0];
        host.transfer(&[0x40], &mut read);
        assert_eq!(read, [0x82], "{}", host.0.sim.envelope());
        host.go_to(&[0x0020], "sealed");
    }
}
