// SPDX-License-Identifier: MIT

//! Rules about keys, the seal, modes and disturbed transfers that only one transfer or one moment shows.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use ti_gauge::authentication::Order;
use ti_gauge::chip::{CHIPS, Chip, FLAT, Kind};
use ti_gauge::dataflash::Outcome;
use ti_gauge::error::Fact;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::{KeyChange, Keys};

use crate::rig::{Rig, another, cause};
use crate::room::programs as commits;

/// The words of the default unseal key as they are sent.
const FIRST_WORD: [u8; 3] = [0x00, 0x14, 0x04];
const SECOND_WORD: [u8; 3] = [0x00, 0x72, 0x36];
const SEAL: [u8; 3] = [0x00, 0x20, 0x00];
/// An adapter's error that is not sent again.
const UNSUPPORTED: BusError = BusError::Other(22);

impl Rig {
    /// Changes what the first reads of `register` after a transfer of `from` return.
    fn forge_after(&mut self, from: [u8; 3], register: u8, count: u32, forge: fn(&mut [u8])) {
        let (mut begun, mut left) = (false, count);
        self.through(move |bus, write, read| {
            begun |= write == from;
            let done = bus.transfer(write, read);
            if begun && left > 0 && write == [register] && !read.is_empty() {
                left -= 1;
                forge(read);
            }
            done
        });
    }
}

fn is_written(outcome: &ti_gauge::error::Result<Outcome>) -> bool {
    matches!(outcome, Ok(Outcome::Written { .. }))
}

#[test]
fn full_access_is_believed_only_when_it_is_read_twice() {
    let mut rig = Rig::found("bq34z100-g1", Seal::Unsealed);
    rig.set("drop_keys", "9");
    // [FAS] is 0 in FULL ACCESS.
    rig.forge_after([0x00, 0xff, 0xff], 0x00, 1, |read| read[1] &= !0x40);
    rig.gauge.seal().expect("the gauge answers");
    rig.gauge.full_access().expect_err("the gauge has refused the key");
}

#[test]
fn another_device_type_is_believed_only_when_it_is_read_twice() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.forge_after([0x00, 0x01, 0x00], 0x00, 1, |read| read[0] ^= 0x01);
    rig.gauge.confirm_identity().expect("it is the same part");
}

#[test]
fn another_seal_state_is_believed_only_when_it_is_read_twice() {
    let mut rig = Rig::new("bq34z100-g1");
    // [SS] is 0 in UNSEALED.
    rig.forge_after([0x00, 0x00, 0x00], 0x00, 1, |read| read[1] &= !0x20);
    assert_eq!(rig.seal(), Seal::Sealed);
}

#[test]
fn sealed_is_sent_up_to_four_times() {
    let mut rig = Rig::found("bq34z100-g1", Seal::Unsealed);
    rig.set("drop_seals", "3");
    rig.gauge.close().expect("the fourth one reaches it");
    assert_eq!(rig.seal(), Seal::Sealed);
}

#[test]
fn a_key_whose_transfers_failed_does_not_count_as_refused() {
    let mut rig = Rig::new("bq34z100-g1");
    let mut left = 12;
    rig.through(move |bus, write, read| {
        if write == FIRST_WORD && left > 0 {
            left -= 1;
            return Err(BusError::NoAck);
        }
        bus.transfer(write, read)
    });
    assert_eq!(cause(&rig.gauge.unseal().expect_err("the bus is disturbed")), "not-now");
    rig.gauge.unseal().expect("the key fits");
}

#[test]
fn a_word_of_a_key_that_was_not_acknowledged_is_sent_again_at_once() {
    let mut rig = Rig::new("bq34z100-g1");
    let mut left = 1;
    rig.through(move |bus, write, read| {
        if write == SECOND_WORD && left > 0 {
            left -= 1;
            return Err(BusError::NoAck);
        }
        bus.transfer(write, read)
    });
    let begun = rig.clock.now();
    rig.gauge.unseal().expect("the key fits");
    assert!(rig.clock.now() - begun < Duration::from_secs(1), "{:?}", rig.clock.now() - begun);
}

/// Every part may want up to 5 s of silence after a refused key; the lithium primary gauge 10 s.
#[test]
fn a_refused_key_is_sent_again_after_the_silence_that_a_gauge_may_need() {
    for chip in CHIPS {
        let quiet = if chip.name == "bq35100" { "10000" } else { "5000" };
        let mut rig = Rig::new(chip.name);
        rig.set("drop_keys", "1");
        rig.set("refused_quiet_ms", quiet);
        rig.set("full_access_quiet_ms", quiet);
        rig.gauge.unseal().unwrap_or_else(|error| panic!("{}: {error}", chip.name));
        if chip.security.full_access {
            rig.gauge.full_access().unwrap_or_else(|error| panic!("{}: {error}", chip.name));
        }
    }
}

/// Reads of Flags() fail right after SET_CFGUPDATE, and the mode begins a second later.
#[test]
fn config_update_that_begins_late_is_ended() {
    let mut rig = Rig::new("bq27441-g1");
    rig.set("cfgupdate_ms", "1000");
    let mut failing = 0;
    rig.through(move |bus, write, read| {
        if write == [0x00, 0x13, 0x00] {
            failing = 1;
        }
        if write == [0x06] && failing > 0 {
            failing -= 1;
            return Err(UNSUPPORTED);
        }
        bus.transfer(write, read)
    });
    rig.write_values(&[((82, 10), "1500")]).expect_err("the bus failed");
    rig.clock.sleep(Duration::from_secs(3));
    assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"));
}

#[test]
fn regression_config_update_that_does_not_begin_said_nothing_to_do() {
    let mut rig = Rig::new("bq27441-g1");
    rig.set("cfgupdate_ms", "60000");
    let error = rig.write_values(&[((82, 10), "1500")]).expect_err("it does not begin").to_string();
    assert!(error.contains("[CFGUPMODE] was not set within"), "{error}");
    assert!(error.contains("nothing was changed") && error.contains("write again"), "{error}");
}

#[test]
fn config_update_is_believed_only_when_it_is_read_twice() {
    let mut rig = Rig::new("bq27441-g1");
    rig.set("cfgupdate_ms", "1000");
    rig.forge_after([0x00, 0x13, 0x00], 0x06, 1, |read| read[0] |= 0x10);
    let outcome = rig.write_values(&[((82, 10), "1500")]);
    assert!(is_written(&outcome), "{outcome:?}");
}

/// A gauge seals itself when CONFIG UPDATE ends, and may show it late.
#[test]
fn the_seal_state_after_config_update_is_read_when_it_must_show() {
    for found in [Seal::Sealed, Seal::Unsealed] {
        let mut rig = Rig::found("bq27441-g1", found);
        rig.set("status_ms", "240");
        let outcome = rig.write_values(&[((82, 10), "1500")]);
        assert!(is_written(&outcome), "{found:?}: {outcome:?}");
        assert_eq!(rig.seal(), found);
    }
}

/// It was found unsealed, and comes back sealed.
#[test]
fn a_gauge_that_lost_its_power_during_a_write_is_unsealed_again() {
    let mut rig = Rig::new("bq34z100-g1");
    let (sim, mut left) = (rig.sim.clone(), 1);
    rig.through(move |bus, write, read| {
        if write == [0x3e, 48, 0] && left > 0 {
            left -= 1;
            sim.set("power", "off").expect("a knob");
            sim.set("power", "on").expect("a knob");
        }
        bus.transfer(write, read)
    });
    rig.gauge.go_to(Seal::Unsealed).expect("the default key");
    rig.write_values(&[((48, 11), "2200")]).expect_err("it is sealed");
    assert_eq!(rig.sim.get("seal").as_deref(), Some("unsealed"));
}

/// The state cannot be read after the key, and for a moment the gauge still shows the one before: a transfer fails, or each
/// look is another one. After these no pause has shown, so nothing that takes time comes before SEALED.
#[test]
fn sealed_is_always_sent_after_a_failure() {
    for fails in [true, false] {
        let mut rig = Rig::new("bq34z100-g1");
        rig.set("status_ms", "240");
        rig.set("drop_seals", "1");
        let (mut begun, mut looks) = (false, 0);
        rig.through(move |bus, write, read| {
            begun |= write == SECOND_WORD;
            if !begun || write != [0x00] || looks > 3 {
                return bus.transfer(write, read);
            }
            looks += 1;
            if fails {
                looks = 4;
                return Err(UNSUPPORTED);
            }
            let done = bus.transfer(write, read);
            // [SS] is 0 in UNSEALED, which is expected after a key.
            read[1] ^= if looks % 2 == 0 { 0x20 } else { 0 };
            done
        });
        rig.write_values(&[((48, 11), "2200")]).expect_err("the state is not known");
        rig.clock.sleep(Duration::from_secs(1));
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"), "fails {fails}");
    }
}

/// The gauge keeps the new key and does not take it at first.
#[test]
fn a_new_key_is_proven_by_using_it() {
    let mut rig = Rig::new("bq34z100-g1");
    let old = rig.sim.flash();
    let mut left = 2;
    rig.through(move |bus, write, read| {
        if write == [0x00, 0x3e, 0x8d] && left > 0 {
            left -= 1;
            return Ok(());
        }
        bus.transfer(write, read)
    });
    let change = KeyChange::parse(b"unseal 0414 3672 8d3e b7c5").expect("a change");
    let outcome = rig.dataflash.change_key(&mut rig.gauge, &change, Order::LsbFirst, Duration::ZERO);
    assert_eq!(cause(&outcome.expect_err("the key does not open it")), "rolled-back");
    assert!(rig.sim.flash() == old);
}

#[test]
fn one_wrong_reading_does_not_show_that_calibration_is_enabled() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.set("voltage_mv", "850");
    let mut left = 1;
    rig.through(move |bus, write, read| {
        let done = bus.transfer(write, read);
        if write == [0x3a] && left > 0 {
            left -= 1;
            read[1] |= 0x40;
        }
        done
    });
    rig.sim.clear_log();
    let error = rig.write_values(&[((48, 11), "2200")]).expect_err("flash is shut");
    assert_eq!(cause(&error), "not-now", "{error}");
}

/// The power is lost after the block was read back.
#[test]
fn a_write_without_a_reset_notices_that_the_gauge_is_sealed() {
    let mut rig = Rig::new("bq34z100-g1");
    let (sim, clock, mut committed) = (rig.sim.clone(), rig.clock.clone(), false);
    rig.through(move |bus, write, read| {
        if committed && write == [0x00, 0x00, 0x00] {
            committed = false;
            sim.set("power", "off").expect("a knob");
            sim.set("power", "on").expect("a knob");
            clock.sleep(Duration::from_secs(1));
        }
        committed |= commits(write);
        bus.transfer(write, read)
    });
    let error = rig.write_values(&[((58, 31), "0x42")]).expect_err("it has lost its power");
    assert!(error.to_string().contains("in the middle of the write"), "{error}");
}

#[test]
fn a_commit_that_was_not_acknowledged_and_changed_nothing_is_repeated() {
    for (chip, row) in [("bq34z100-g1", (48, 11)), ("bq34110", (FLAT, 0x41F5))] {
        let mut rig = Rig::new(chip);
        let mut left = 2;
        rig.through(move |bus, write, read| {
            if commits(write) && left > 0 {
                left -= 1;
                return Err(BusError::NoAck);
            }
            bus.transfer(write, read)
        });
        let outcome = rig.write_values(&[(row, "2222")]);
        assert!(is_written(&outcome), "{chip}: {outcome:?}");
    }
}

/// A gauge that programs a row of its own.
#[test]
fn a_gauge_that_does_not_answer_for_250_ms_is_awaited() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.set_fault("silence 1 250");
    assert_eq!(rig.seal(), Seal::Sealed);
}

#[test]
fn a_transfer_is_not_sent_again_when_it_is_late() {
    let mut rig = Rig::new("bq34z100-g1");
    let begun = rig.clock.now();
    rig.gauge.limit(Some(Duration::ZERO));
    rig.gauge.seal().expect_err("there is no time");
    assert_eq!(rig.clock.now(), begun);
}

/// No transfer has failed, so the bus is not called faulty.
#[test]
fn regression_a_limit_of_our_own_was_told_as_a_line_that_is_held_low() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.gauge.limit(Some(Duration::from_secs(2)));
    let error = std::iter::repeat_with(|| rig.gauge.seal()).find_map(Result::err).expect("it is late");
    let text = error.to_string();
    assert!(
        text.contains("the bus is too slow: ") && text.ends_with(" transfers in 2.0 s, of 2.0 s"),
        "{text}"
    );
    assert!(!text.contains("held low"), "{text}");
    assert_eq!((error.errno(), cause(&error)), (110, "timed-out"));
    let facts = error.facts();
    let fact = |name| match facts.iter().find(|(known, _)| *known == name) {
        Some((_, Fact::Number(number))) => *number,
        other => panic!("{name}: {other:?}"),
    };
    assert!(fact("transfers") > 100 && fact("failed") == 0, "{facts:?}");
    assert!(fact("milliseconds") >= 2000 && fact("limit") == 2000, "{facts:?}");
    // A later limit of the same access counts from its beginning.
    rig.gauge.limit(Some(Duration::ZERO));
    let text = rig.gauge.seal().expect_err("it is late").to_string();
    assert!(text.ends_with(" transfers in 2.0 s, of 2.0 s"), "{text}");
    // Where transfers have failed, that is said.
    rig.gauge.limit(None);
    rig.gauge.limit(Some(Duration::from_secs(1)));
    rig.set_fault("silence 1 60000");
    let end = rig.clock.now() + Duration::from_secs(1);
    while rig.clock.now() < end {
        rig.gauge.seal().expect_err("it is silent");
        rig.clock.sleep(Duration::from_millis(500));
    }
    let text = rig.gauge.seal().expect_err("it is late").to_string();
    assert!(text.contains("no time is left: ") && text.contains("transfers failed in"), "{text}");
}

/// Calibration inhibit temperatures are in the row in which the bq35100's authentication key begins.
#[test]
fn rows_with_keys_are_neither_recorded_nor_kept() {
    let mut rig = Rig::new("bq35100");
    rig.sim.set_flash(FLAT.into(), 0x1bc, &[0xd3, 0xc5, 0xb7, 0xe1]);
    rig.sim.clear_log();
    rig.read(FLAT, 0x41b8).expect("a read");
    let log = rig.log().join("\n").to_lowercase();
    assert!(log.contains("hidden") && !log.contains("d3 c5"), "{log}");
    let kept = format!("{:?}", rig.dataflash);
    assert!(!kept.contains("211, 197"), "{kept}");
}

#[test]
fn flat_windows_are_rows() {
    let mut rig = Rig::new("bq34110");
    rig.sim.clear_log();
    rig.read(FLAT, 0x41f5).expect("a read");
    let log = rig.sim.log();
    let bases = log.iter().filter_map(|record| match record.write[..] {
        [0x3e, low, high @ 0x40..0x44] => Some(u16::from_le_bytes([low, high])),
        _ => None,
    });
    let bases: Vec<u16> = bases.collect();
    assert!(!bases.is_empty() && bases.iter().all(|base| base % 32 == 0), "{bases:x?}");
}

/// Beyond the ends of flash, a word that selects a block is a subcommand or unknown.
#[test]
fn regression_blocks_beyond_the_ends_of_flash_were_selected() {
    for name in ["bq34110", "bq35100", "bq27220"] {
        let chip = Chip::by_name(name).expect("a chip in the tables");
        let rows = chip.subclasses.iter().filter(|row| row.kind != Kind::Security);
        let rows = rows.flat_map(|row| row.parameters.iter().map(move |parameter| (row, parameter)));
        let rows: Vec<_> = rows.collect();
        let first = rows.iter().min_by_key(|(_, parameter)| parameter.offset).expect("a parameter");
        let last = rows.iter().max_by_key(|(_, parameter)| parameter.offset).expect("a parameter");
        for &(subclass, parameter) in [first, last] {
            let mut rig = Rig::new(name);
            let bytes = rig.read(FLAT, parameter.offset).expect("a value");
            let change = another((subclass, parameter), &bytes).expect("another value");
            rig.sim.clear_log();
            let written = rig.dataflash.write(&mut rig.gauge, &[change], Duration::ZERO);
            written.unwrap_or_else(|error| panic!("{name} {}: {error}", parameter.name));
            let selected = rig.sim.log().into_iter().filter_map(|record| match record.write[..] {
                [0x3e, low, high] => Some(u16::from_le_bytes([low, high])),
                _ => None,
            });
            let selected: Vec<u16> = selected.collect();
            let ends = match name {
                "bq27220" => first.1.offset & !31..last.1.offset + 32,
                _ => 0x4000..0x4400,
            };
            assert!(
                selected.len() > 2 && selected.iter().all(|base| ends.contains(base)),
                "{name}: {selected:x?}"
            );
        }
    }
}

/// Its power is lost when everything is done but for the answer.
#[test]
fn ram_that_was_lost_within_a_write_is_reported() {
    let mut rig = Rig::new("bq27441-g1");
    let (sim, clock) = (rig.sim.clone(), rig.clock.clone());
    rig.after(
        |write| write == SEAL,
        1,
        move || {
            sim.set("power", "off").expect("a knob");
            sim.set("power", "on").expect("a knob");
            clock.sleep(Duration::from_secs(1));
        },
    );
    let error = rig.write_values(&[((82, 10), "1500")]).expect_err("its data memory is lost");
    assert_eq!(cause(&error), "state-unknown", "{error}");
}

/// Its power is lost at the first commit. What it had in RAM cannot be restored.
#[test]
fn ram_that_was_lost_at_a_commit_is_not_called_restored() {
    let mut rig = Rig::new("bq27441-g1");
    let (sim, clock) = (rig.sim.clone(), rig.clock.clone());
    rig.after(commits, 1, move || {
        sim.set("power", "off").expect("a knob");
        sim.set("power", "on").expect("a knob");
        clock.sleep(Duration::from_secs(1));
    });
    let error = rig.write_values(&[((82, 10), "1500")]).expect_err("its data memory is lost");
    assert_eq!(cause(&error), "state-unknown", "{error}");
    assert!(error.to_string().contains("its data memory with it"), "{error}");
}

/// A bus that shows whether transfers are secret.
struct Hushed(Arc<Mutex<bool>>);

impl Bus for Hushed {
    fn transfer(&mut self, _: &[u8], _: &mut [u8]) -> Result<(), BusError> {
        Ok(())
    }

    fn set_secret(&mut self, secret: bool) {
        *self.0.lock().unwrap() = secret;
    }
}

#[test]
fn transfers_stay_secret_until_the_outer_caller_has_ended_it() {
    let secret = Arc::new(Mutex::new(false));
    let chip = Chip::by_name("bq34z100-g1").expect("a chip in the tables");
    let bus = Box::new(Hushed(secret.clone()));
    let mut gauge = Gauge::new(chip, bus, Arc::new(SimClock::new()), Keys::default());
    for (call, expected) in [(true, true), (true, true), (false, true), (false, false)] {
        gauge.set_secret(call);
        assert_eq!(*secret.lock().unwrap(), expected);
    }
}
