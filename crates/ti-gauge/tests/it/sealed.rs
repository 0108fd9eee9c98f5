// SPDX-License-Identifier: MIT

//! What a sealed gauge shows without a key.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gauge_bus::{Bus as _, Reach};
use ti_gauge::chip::{CHIPS, Chip, Subclass};
use ti_gauge::gauge::Seal;
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause};

/// A gauge whose key nobody has, with values in all that it shows.
fn locked(chip: &Chip) -> Rig {
    let mut keys = Keys::default();
    keys.no_default = true;
    let mut rig = Rig::with(chip.name, keys, Reach::FULL);
    for row in rows(chip) {
        let bytes: Vec<u8> = (0..row.length as u8).map(|at| 0xa0 ^ at).collect();
        rig.sim.set_flash(row.id.into(), 0, &bytes);
    }
    rig.sim.clear_log();
    rig.gauge.seal().expect("it answers");
    rig
}

fn rows(chip: &Chip) -> Vec<&'static Subclass> {
    let shown = chip.security.shown_sealed.iter();
    shown.map(|(_, id)| chip.subclass(*id).expect("a subclass")).collect()
}

fn is_right(row: &Subclass, bytes: &[u8]) -> bool {
    let end = usize::from(row.length);
    bytes[..end].iter().zip(0..).all(|(byte, at)| *byte == 0xa0 ^ at)
        && bytes[end..].iter().all(|byte| *byte == 0)
}

#[test]
fn regression_manufacturer_info_of_a_sealed_gauge_asked_for_a_key() {
    let mut shown = 0;
    for chip in CHIPS {
        for row in rows(chip) {
            let mut rig = locked(chip);
            let read = rig
                .dataflash
                .read(&mut rig.gauge, &[row], Duration::ZERO)
                .expect("no key is needed")
                .remove(0);
            assert!(is_right(row, &read), "{}: {}: {read:02x?}", chip.name, row.name);
            assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
            // No word but CONTROL_STATUS, and nothing in the window.
            let sent = rig.sim.log().into_iter().filter(|sent| sent.write.len() > 1);
            let others: Vec<_> =
                sent.filter(|sent| !matches!(sent.write[..], [0x00, 0, 0] | [0x3f, _])).collect();
            assert!(others.is_empty(), "{}: {others:?}", chip.name);
            let whole =
                chip.subclasses.iter().find(|other| other.name == "Data").expect("every part has one");
            let error =
                rig.dataflash.read(&mut rig.gauge, &[row, whole], Duration::ZERO).expect_err("no key");
            assert_eq!(cause(&error), "not-permitted", "{error}");
            shown += 1;
        }
    }
    assert_eq!(shown, 5);
}

/// Whatever one transfer does, and however late the block is.
#[test]
fn what_a_sealed_gauge_shows_is_right_or_an_error() {
    let chip = Chip::by_name("bq34z100-g1").expect("a chip in the tables");
    let row = rows(chip)[0];
    let mut right = 0;
    for late in ["0", "20", "40", "70"] {
        for fault in ["nack", "lost", "short", "eio", "flip BYTE"] {
            for transfer in 1..12 {
                for byte in if fault.contains("BYTE") { 0..35 } else { 0..1 } {
                    let mut rig = locked(chip);
                    rig.set("sealed_load_ms", late);
                    let fault = match fault.split_once(' ') {
                        Some((flip, _)) => format!("{flip} {transfer} {byte} {}", byte % 8),
                        None => format!("{fault} {transfer}"),
                    };
                    rig.set_fault(&fault);
                    match rig.dataflash.read(&mut rig.gauge, &[row], Duration::ZERO) {
                        Ok(read) => {
                            assert!(is_right(row, &read[0]), "late by {late} ms, {fault}: {:02x?}", read[0]);
                            right += 1;
                        }
                        Err(error) => assert_ne!(cause(&error), "state-unknown", "{fault}: {error}"),
                    }
                }
            }
        }
    }
    assert!(right > 1000, "{right}");
}

/// Opened between the look at the seal state and the selection, it shows another block of that number.
#[test]
fn a_gauge_that_was_opened_meanwhile_is_not_believed() {
    let chip = Chip::by_name("bq34z100-g1").expect("a chip in the tables");
    let row = rows(chip)[0];
    let mut rig = locked(chip);
    let (sim, opened) = (rig.sim.clone(), Arc::new(AtomicU64::new(0)));
    let counted = opened.clone();
    rig.through(move |bus, write, read| {
        if matches!(write, [0x3f, 1]) && counted.fetch_add(1, Ordering::Relaxed) == 0 {
            sim.set("seal", "unsealed").expect("a knob");
        }
        bus.transfer(write, read)
    });
    let read = rig.dataflash.read(&mut rig.gauge, &[row], Duration::ZERO);
    assert!(opened.load(Ordering::Relaxed) > 0);
    assert!(read.as_ref().map_or(true, |read| is_right(row, &read[0])), "{read:?}");
    assert_ne!(rig.gauge.seal().expect("it answers"), Seal::FullAccess);
}
