// SPDX-License-Identifier: MIT

//! The flash-voltage gate: writes after which the gauge would store nothing any more, and packs that have to be
//! configured although their voltage is low.

use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::{FLAT, Kind};
use ti_gauge::dataflash::{Change, DataFlash, Outcome, Row};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

use crate::rig::{Rig, another, cause, without_old};

const WRITTEN: Result<Outcome> = Ok(Outcome::Written { reset: true, old: Vec::new() });
const STORED: Result<Outcome> = Ok(Outcome::Written { reset: false, old: Vec::new() });

const LIMIT: (u8, u16) = (68, 0);
const DIVIDER: (u8, u16) = (104, 14);
const PACK_CONFIG: (u8, u16) = (64, 0);
const CELLS: (u8, u16) = (64, 7);
/// Pack Configuration with and without [VOLTSEL].
const EXTERNAL: &str = "0x0961";
const INTERNAL: &str = "0x0161";

type Values<'a> = &'a [((u8, u16), &'a str)];

fn at(chip: &str, voltage_mv: &str) -> Rig {
    let rig = Rig::new(chip);
    rig.sim.set("voltage_mv", voltage_mv).expect("a knob");
    rig
}

fn write_all(rig: &mut Rig, values: Values<'_>) -> Result<Outcome> {
    let changes: Vec<_> = values.iter().map(|((id, offset), text)| rig.change(*id, *offset, text)).collect();
    rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO).map(without_old)
}

fn written(rig: &mut Rig, values: Values<'_>) {
    let outcome = write_all(rig, values);
    assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{values:?}: {outcome:?}");
    assert!(is_open(rig), "{values:?} shut flash");
}

/// Whether the gauge still stores what it is sent: a byte that no parameter depends on.
fn is_open(rig: &mut Rig) -> bool {
    // A small number near the end of the table, where nothing of the gate is.
    let rows = rig.gauge.chip.subclasses.iter().filter(|class| class.kind != Kind::Security);
    let mut rows = rows.flat_map(|class| class.parameters.iter().map(move |one| (class, one)));
    let free = |(_, one): &Row| one.kind.size() == 1 && !one.unproven && !one.learned && one.safe.is_none();
    let row = rows.rfind(free).expect("a byte");
    let old = rig.read(row.0.id, row.1.offset).expect("a read");
    let change = another(row, &old).expect("another value");
    let mut dataflash = DataFlash::default();
    let outcome = dataflash.write(&mut rig.gauge, &[change], Duration::ZERO);
    outcome.is_ok()
}

fn refused(rig: &mut Rig, values: Values<'_>, expected: &str, says: &[&str]) {
    let before = rig.sim.flash();
    let error = write_all(rig, values).expect_err("it would shut flash");
    assert_eq!(cause(&error), expected, "{values:?}: {error}");
    for says in says {
        assert!(error.to_string().contains(says), "{values:?}: `{error}` does not say `{says}`");
    }
    assert!(rig.sim.flash() == before, "{values:?}: {error}, but data flash has changed");
    assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"), "{values:?}");
    assert_eq!(rig.seal(), Seal::Sealed);
}

/// A pack of four cells in series: 850 mV at the pin, and the limit was set to 0 before it was built.
fn new_pack() -> Rig {
    let mut rig = Rig::new("bq34z100-g1");
    assert_eq!(rig.write(68, 0, "0"), WRITTEN);
    rig.sim.set("voltage_mv", "850").expect("a knob");
    rig
}

/// The pack of [`new_pack`] after its calibration: it measures 17000 mV.
fn finished_pack() -> Rig {
    let mut rig = new_pack();
    written(&mut rig, &[(PACK_CONFIG, EXTERNAL), (DIVIDER, "20000"), (CELLS, "4")]);
    assert_eq!(rig.write(68, 0, "2800"), WRITTEN);
    rig
}

/// Voltage() is 0 until the gauge has measured.
#[test]
fn regression_a_write_right_after_a_reset_was_refused_as_one_of_a_flat_pack() {
    for (chip, id, offset, values) in
        [("bq34z100-g1", 80, 53, ["3100", "3200"]), ("bq27441-g1", 82, 10, ["1400", "1500"])]
    {
        let mut rig = Rig::new(chip);
        rig.sim.set("first_ms", "2000").expect("a knob");
        for value in values {
            let outcome = rig.write(id, offset, value);
            assert!(matches!(outcome, Ok(Outcome::Written { .. })), "{chip}: {value}: {outcome:?}");
        }
    }
    // One that never measures any is not waited for without an end.
    let mut rig = at("bq34z100-g1", "0");
    let begun = rig.clock.now();
    refused(&mut rig, &[((80, 53), "3100")], "not-now", &["measures 0 mV"]);
    assert!(rig.clock.now() - begun < Duration::from_secs(4));
}

#[test]
fn a_divider_that_would_shut_flash_is_refused() {
    // Voltage() would be 385 mV.
    refused(
        &mut at("bq34z100-g1", "3855"),
        &[(DIVIDER, "500")],
        "out-of-range",
        &["385 mV", "2800 mV", "68/0"],
    );
    // Voltage() would be 72000 mV, more than its 16 bits hold.
    refused(
        &mut at("bq34z100-g1", "12000"),
        &[(DIVIDER, "30000")],
        "out-of-range",
        &["72003 mV", "cannot show"],
    );
    // Should Voltage() not follow the divider, 642 mV would be compared.
    refused(&mut at("bq34z100-g1", "3855"), &[(DIVIDER, "30000")], "out-of-range", &["642 mV", "68/0"]);
    refused(
        &mut at("bq34110", "3500"),
        &[((FLAT, 0x4010), "100")],
        "out-of-range",
        &["69 mV", "flash/0x4157"],
    );
    written(&mut at("bq34z100-g1", "3855"), &[(DIVIDER, "5100")]);
    written(&mut at("bq34110", "3500"), &[((FLAT, 0x4010), "5100")]);
}

/// Each of the two values is right by itself.
#[test]
fn values_are_judged_together() {
    for (chip, limit, divider) in
        [("bq34z100-g1", LIMIT, DIVIDER), ("bq34110", (FLAT, 0x4157), (FLAT, 0x4010))]
    {
        written(&mut at(chip, "3855"), &[(limit, "3800")]);
        written(&mut at(chip, "3855"), &[(divider, "4000")]);
        refused(&mut at(chip, "3855"), &[(limit, "3800"), (divider, "4000")], "out-of-range", &["3083 mV"]);
        refused(&mut at(chip, "3855"), &[(divider, "4000"), (limit, "3800")], "out-of-range", &["3083 mV"]);
    }
    // And together right, although the divider alone is wrong.
    refused(&mut at("bq34z100-g1", "3855"), &[(DIVIDER, "3000")], "out-of-range", &["2312 mV"]);
    written(&mut at("bq34z100-g1", "3855"), &[(DIVIDER, "3000"), (LIMIT, "2300")]);
}

/// The divider of firmware 2.02 has another full scale than that of 0.16, so 33000 is a divider of three cells there;
/// and no source has the factor of [VOLTSEL].
#[test]
fn the_gate_of_the_bq34z100_r2_has_no_full_scale() {
    let at = |voltage_mv| at("bq34z100-r2", voltage_mv);
    written(&mut at("3855"), &[(DIVIDER, "33000")]);
    refused(&mut at("3855"), &[(DIVIDER, "500")], "out-of-range", &["385 mV", "2800 mV", "68/0"]);
    refused(&mut at("12000"), &[(DIVIDER, "33000")], "out-of-range", &["cannot show"]);
    refused(&mut at("3855"), &[(CELLS, "2")], "out-of-range", &["1927 mV per cell"]);
    refused(&mut at("3855"), &[(PACK_CONFIG, EXTERNAL)], "out-of-range", &["[VOLTSEL]"]);
    let mut new = at("3855");
    assert_eq!(new.write(68, 0, "0"), WRITTEN);
    written(&mut new, &[(PACK_CONFIG, EXTERNAL), (DIVIDER, "33000"), (CELLS, "3")]);
}

#[test]
fn voltsel_without_an_external_divider_is_refused() {
    let mut rig = at("bq34z100-g1", "3855");
    refused(
        &mut rig,
        &[(PACK_CONFIG, EXTERNAL)],
        "out-of-range",
        &["[VOLTSEL]", "external divider", "5000 mV"],
    );
    // With the external divider, the pin has no more than the converter's range of 1 V.
    let mut rig = new_pack();
    written(&mut rig, &[(PACK_CONFIG, EXTERNAL), (LIMIT, "2800")]);
    // And without [VOLTSEL] the converter would get a fifth.
    refused(&mut finished_pack(), &[(PACK_CONFIG, INTERNAL)], "out-of-range", &["849 mV per cell"]);
}

/// The limit applies to Voltage() scaled back to the internal divider, too (SLUSBZ5D 8.2.2.1.3).
#[test]
fn the_limit_is_compared_with_the_scaled_voltage() {
    let mut rig = finished_pack();
    written(&mut rig, &[(CELLS, "1")]);
    rig.sim.set("voltage_mv", "14000").expect("a knob");
    refused(&mut rig, &[(LIMIT, "3501")], "out-of-range", &["3500 mV at a Voltage Divider of 5000"]);
    written(&mut rig, &[(LIMIT, "3500")]);
    rig.sim.set("voltage_mv", "13999").expect("a knob");
    refused(&mut rig, &[((80, 53), "3100")], "not-now", &["3499 mV at a Voltage Divider of 5000"]);
}

/// By its name the limit is a cell's.
#[test]
fn the_number_of_cells_counts() {
    refused(&mut at("bq34z100-g1", "3855"), &[(CELLS, "2")], "out-of-range", &["1927 mV per cell"]);
    // 17000 mV are 3400 mV a cell if there are five.
    let mut rig = finished_pack();
    written(&mut rig, &[(LIMIT, "4000")]);
    refused(&mut rig, &[(CELLS, "5")], "out-of-range", &["3400 mV per cell"]);
    written(&mut rig, &[(CELLS, "5"), (LIMIT, "3300")]);
    // The number of cells is read when it is not among the changes.
    refused(&mut rig, &[(LIMIT, "3500")], "out-of-range", &["3400 mV per cell"]);
    written(&mut rig, &[(CELLS, "1")]);
}

/// No division may round in favour of the write.
#[test]
fn rounding_does_not_open_the_gate() {
    for (voltage, divider, limit, open) in [
        // Voltage() is as measured.
        ("2801", "5000", "2801", true),
        ("2801", "5000", "2802", false),
        // 2999.9 mV, from which half a millivolt of rounding is taken.
        ("3750", "4000", "3000", false),
        ("3750", "4000", "2999", true),
        // 3061.8 mV scaled to a divider of 5000.
        ("3062", "5001", "3062", false),
        ("3062", "5001", "3060", true),
    ] {
        let mut rig = at("bq34z100-g1", voltage);
        let values: Values<'_> = &[(DIVIDER, divider), (LIMIT, limit)];
        match open {
            true => written(&mut rig, values),
            false => refused(&mut rig, values, "out-of-range", &["mV"]),
        }
    }
}

#[test]
fn a_new_pack_is_configured_in_one_transaction() {
    let mut rig = new_pack();
    written(&mut rig, &[(LIMIT, "2800"), (DIVIDER, "20000"), (PACK_CONFIG, EXTERNAL), (CELLS, "4")]);
    assert_eq!(rig.read(104, 14), Ok(20_000u16.to_be_bytes().to_vec()));
    assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"));
    let mut voltage = [0; 2];
    rig.gauge.read(0x08, &mut voltage).expect("it answers");
    assert_eq!(u16::from_le_bytes(voltage), 17_000);
}

/// The way of TI's staff: calibration enabled, the limit lowered, the divider selected.
#[test]
fn a_new_pack_whose_flash_is_shut_says_the_way() {
    let mut rig = at("bq34z100-g1", "850");
    let values: Values<'_> = &[(LIMIT, "2800"), (DIVIDER, "20000"), (PACK_CONFIG, EXTERNAL), (CELLS, "4")];
    let says = ["850 mV", "2800 mV (68/0)", "CAL_ENABLE, 0x002d", "104/14", "[VOLTSEL]", "one transaction"];
    refused(&mut rig, values, "not-now", &says);
    rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO).expect("the default key");
    rig.gauge.command(0x002D).expect("it answers");
    written(&mut rig, values);
    // The reset has ended calibration.
    rig.sim.set("voltage_mv", "850").expect("a knob");
    assert!(!is_open(&mut rig));
    // On a part without that way it is not named.
    let error = at("bq34110", "700").write(FLAT, 0x4010, "20000").expect_err("shut");
    assert!(
        !error.to_string().contains("CAL_ENABLE") && error.to_string().contains("flash/0x4157"),
        "{error}"
    );
}

/// Calibration opens flash, but what would shut it after the reset is refused all the same.
#[test]
fn calibration_does_not_let_through_what_shuts_flash() {
    let mut rig = at("bq34z100-g1", "3855");
    rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO).expect("the default key");
    rig.gauge.command(0x002D).expect("it answers");
    let error = rig.write(104, 14, "500").expect_err("it would shut flash");
    assert_eq!(cause(&error), "out-of-range", "{error}");
}

/// Where no source says what a divider's bit does to Voltage(), the limit has to be 0 first.
#[test]
fn an_unknown_divider_needs_a_limit_of_0() {
    for (chip, row, text, limit, name) in [
        ("bq34110", (FLAT, 0x413D), "0x10", (FLAT, 0x4157), "[VEN_EN]"),
        ("bq35100", (FLAT, 0x41B1), "0xc0", (FLAT, 0x41B6), "[EXTVCELL]"),
    ] {
        let mut rig = at(chip, "3500");
        refused(&mut rig, &[(row, text)], "out-of-range", &[name, "set the limit to 0"]);
        assert_eq!(rig.write(limit.0, limit.1, "0"), STORED);
        assert_eq!(rig.write(row.0, row.1, text), STORED);
    }
}

/// The block with the limit comes first on the way down and last on the way up.
#[test]
fn the_gate_is_open_after_each_block() {
    let mut rig = finished_pack();
    written(&mut rig, &[(DIVIDER, "3000"), (LIMIT, "600")]);
    written(&mut rig, &[(DIVIDER, "20000"), (LIMIT, "2800")]);
    assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"));
}

/// The blocks of a flat part are written in the order of their addresses.
#[test]
fn values_that_would_shut_flash_half_way_are_refused() {
    let (divider, limit, other) = ((FLAT, 0x4010), (FLAT, 0x4157), ((FLAT, 0x41F5), "6000"));
    let says = ["before the last block", "set the limit to 0"];
    // The divider comes first, and Voltage() would be 2099 mV.
    let mut rig = at("bq34110", "3500");
    refused(&mut rig, &[(divider, "3000"), (limit, "2000")], "out-of-range", &says);
    written(&mut rig, &[(limit, "2000")]);
    written(&mut rig, &[(divider, "3000")]);
    // Voltage() would be 4199 mV, if the gauge measured it before the block behind the limit.
    let mut rig = at("bq34110", "3500");
    refused(&mut rig, &[(divider, "6000"), (limit, "3900"), other], "out-of-range", &says);
    written(&mut rig, &[(divider, "6000"), (limit, "3900")]);
}

/// Swallows one write to the checksum: that block is not stored.
struct Drops(Box<dyn Bus>, usize);

impl Bus for Drops {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if write.len() == 2 && write[0] == 0x60 {
            self.1 = self.1.wrapping_sub(1);
            if self.1 == usize::MAX {
                return Ok(());
            }
        }
        self.0.transfer(write, read)
    }
}

/// A failure at any block puts all of them back, which the gate must allow.
#[test]
fn a_failed_configuration_is_undone() {
    let up: Values<'_> = &[(PACK_CONFIG, EXTERNAL), (DIVIDER, "20000"), (LIMIT, "2800")];
    let down: Values<'_> = &[((80, 53), "3100"), (DIVIDER, "3000"), (LIMIT, "600"), ((107, 1), "6")];
    type Pack = fn() -> Rig;
    for (pack, values) in [(new_pack as Pack, up), (finished_pack, down)] {
        for block in 0..values.len() {
            let mut rig = pack();
            let before = rig.sim.flash();
            let bus = Box::new(Drops(Box::new(rig.sim.bus()), block));
            rig.gauge = Gauge::new(rig.gauge.chip, bus, rig.clock.clone(), Keys::default());
            rig.gauge.seal().expect("the gauge answers");
            let error = write_all(&mut rig, values).expect_err("not stored");
            assert_eq!(cause(&error), "rolled-back", "{values:?} {block}: {error}");
            assert!(rig.sim.flash() == before, "{values:?} {block}: {error}");
            assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"), "{values:?} {block}");
        }
    }
}

/// What the gate depends on cannot be written as bytes without a parameter.
#[test]
fn undocumented_bytes_do_not_shut_flash() {
    let mut rig = at("bq34z100-g1", "3855");
    let place = ti_gauge::dataflash::Place { subclass: 104, offset: 15 };
    let error = Change::raw(rig.gauge.chip, place, vec![0]).expect_err("the low byte of Voltage Divider");
    assert_eq!(cause(&error), "invalid", "{error}");
    let written = rig.write(104, 14, "256").expect_err("0x0100 is too low");
    assert_eq!(cause(&written), "out-of-range", "{written}");
}

/// Flips one bit of one read.
struct Flips {
    bus: Box<dyn Bus>,
    clock: std::sync::Arc<gauge_bus::clock::SimClock>,
    /// Register and length of the reads to count, which of them, byte and mask.
    flip: (u8, usize, usize, usize, u8),
    seen: usize,
    /// Time of each read of the window since it was last selected.
    since: std::sync::Arc<std::sync::Mutex<Vec<Duration>>>,
    selected: Duration,
}

impl Bus for Flips {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.bus.transfer(write, read)?;
        let now = self.clock.now();
        if write.len() > 1 && write[0] == 0x3E {
            self.selected = now;
        }
        let (register, length, which, at, mask) = self.flip;
        if write == [register] && read.len() == length {
            self.since.lock().expect("a list").push(now - self.selected);
            if self.seen == which {
                read[at] ^= mask;
            }
            self.seen += 1;
        }
        Ok(())
    }
}

impl Rig {
    fn flips(
        &mut self,
        flip: (u8, usize, usize, usize, u8),
    ) -> std::sync::Arc<std::sync::Mutex<Vec<Duration>>> {
        let since = std::sync::Arc::default();
        let bus = Flips {
            bus: Box::new(self.sim.bus()),
            clock: self.clock.clone(),
            flip,
            seen: 0,
            since: std::sync::Arc::clone(&since),
            selected: Duration::ZERO,
        };
        let keys = Keys::default();
        self.gauge = Gauge::new(self.gauge.chip, Box::new(bus), self.clock.clone(), keys);
        self.gauge.seal().expect("the gauge answers");
        since
    }
}

/// A wrong bit in the limit, in the divider or in Voltage() neither opens the gate nor is kept.
#[test]
fn a_flipped_bit_does_not_open_the_gate() {
    // The limit: 2800 becomes 752; the divider: 5000 becomes 904; the selection that is echoed.
    for flip in [
        (0x3E, 4, 0, 2, 0x08),
        (0x3E, 4, 1, 2, 0x08),
        (0x3E, 4, 0, 0, 0x01),
        (0x3E, 36, 0, 16, 0x10),
        (0x3E, 36, 1, 16, 0x10),
    ] {
        let mut rig = at("bq34z100-g1", "2700");
        rig.flips(flip);
        let error = rig.write(80, 53, "3100").expect_err("too low");
        assert_eq!(cause(&error), "not-now", "{flip:?}: {error}");
        assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"), "{flip:?}");
    }
    // Voltage() before a change of the limit: 2900 becomes 3924, in the first reading or in a later one.
    for which in 0..4 {
        let mut rig = at("bq34z100-g1", "2900");
        rig.flips((0x08, 2, which, 1, 0x04));
        refused(&mut rig, &[(LIMIT, "3000")], "out-of-range", &["2900 mV"]);
        let mut rig = at("bq34z100-g1", "2900");
        rig.flips((0x00, 10, which, 9, 0x04));
        refused(&mut rig, &[(LIMIT, "3000")], "out-of-range", &["2900 mV"]);
    }
}

/// Flips a bit of the first selection of Power, which makes it Registers: Pack Configuration as a limit is 353.
struct Misselects(Box<dyn Bus>, bool);

impl Bus for Misselects {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if write == [0x3E, 68, 0] && !std::mem::replace(&mut self.1, true) {
            return self.0.transfer(&[0x3E, 64, 0], read);
        }
        self.0.transfer(write, read)
    }
}

#[test]
fn another_block_is_not_taken_for_the_limit() {
    let mut rig = at("bq34z100-g1", "2700");
    let bus = Box::new(Misselects(Box::new(rig.sim.bus()), false));
    rig.gauge = Gauge::new(rig.gauge.chip, bus, rig.clock.clone(), Keys::default());
    rig.gauge.seal().expect("the gauge answers");
    refused(&mut rig, &[((80, 53), "3100")], "not-now", &["2800 mV (68/0)"]);
}

#[test]
fn the_limit_is_read_twice_55_ms_after_the_selection() {
    let mut rig = Rig::new("bq34z100-g1");
    let since = rig.flips((0x3E, 4, usize::MAX, 0, 0));
    assert_eq!(rig.write(80, 53, "3100"), WRITTEN);
    let since = since.lock().expect("a list").clone();
    assert_eq!(since.len(), 2, "{since:?}");
    assert!(since[0] >= Duration::from_millis(30) && since[1] >= Duration::from_millis(55), "{since:?}");
    assert!(since[1] - since[0] >= Duration::from_millis(20), "{since:?}");
}

/// What was read before a failure is read again, for it may be what caused it.
#[test]
fn the_limit_is_read_again_after_a_failure() {
    let mut rig = at("bq34z100-g1", "3855");
    let since = rig.flips((0x3E, 4, usize::MAX, 0, 0));
    assert_eq!(rig.write(80, 53, "3100"), WRITTEN);
    assert_eq!(rig.write(80, 53, "3200"), WRITTEN);
    assert_eq!(since.lock().expect("a list").len(), 2, "it is known");
    rig.sim.set("fault", "drop-commit").expect("a fault");
    assert_eq!(cause(&rig.write(80, 53, "3300").expect_err("dropped")), "rolled-back");
    assert_eq!(rig.write(80, 53, "3300"), WRITTEN);
    assert_eq!(since.lock().expect("a list").len(), 4, "it is read again");
}
