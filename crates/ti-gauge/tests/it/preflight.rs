// SPDX-License-Identifier: MIT

//! Checks before a write: each refusal has its cause and its remedy, and changes nothing on the gauge.

use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use ti_gauge::chip::{CHIPS, FLAT, Register, Role, SealStatus, Source};
use ti_gauge::dataflash::{DataFlash, Limits, Outcome};
use ti_gauge::error::Result;
use ti_gauge::gauge::{ALONG, Gauge, Seal};
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause, without_old};

const WRITTEN: Result<Outcome> = Ok(Outcome::Written { reset: true, old: Vec::new() });
const STORED: Result<Outcome> = Ok(Outcome::Written { reset: false, old: Vec::new() });

/// A chip, and one of its parameters with a value that the gauge does not hold.
const ROWS: &[(&str, (u8, u16), &str)] = &[
    ("bq34z100-g1", (80, 53), "3100"),
    ("bq34z100-r2", (80, 53), "3100"),
    ("bq27520-g3", (48, 10), "1200"),
    ("bq27500", (48, 10), "1200"),
    ("bq27500-v130", (48, 10), "1200"),
    ("bq27742-g1", (48, 12), "1200"),
    ("bq27441-g1", (82, 10), "1200"),
    ("bq27421-g1", (82, 10), "1200"),
    ("bq27426", (82, 6), "1200"),
    ("bq27427", (82, 6), "1200"),
    ("bq27220", (FLAT, 0x929F), "6000"),
    ("bq27621-g1", (82, 3), "1200"),
    ("bq34110", (FLAT, 0x41F5), "6000"),
    ("bq35100", (FLAT, 0x41FE), "6000"),
];

fn row(chip: &str) -> ((u8, u16), &'static str) {
    let found = ROWS.iter().find(|(name, ..)| *name == chip).expect("a row for each part");
    (found.1, found.2)
}

fn write(rig: &mut Rig) -> Result<Outcome> {
    let (at, text) = row(rig.gauge.chip.name);
    rig.write(at.0, at.1, text)
}

/// Attempts a write that must be refused without effect: no block programmed, no reset, the seal state as found.
fn refused(rig: &mut Rig, expected: &str, says: &[&str]) {
    let name = rig.gauge.chip.name;
    let (flash, seal) = (rig.sim.flash(), rig.seal());
    let count = |rig: &Rig| (rig.sim.get("programmed"), rig.sim.get("resets"));
    let before = count(rig);
    let error = write(rig).expect_err("it is refused");
    assert_eq!(cause(&error), expected, "{name}: {error}");
    for says in says {
        assert!(error.to_string().contains(says), "{name}: `{error}` does not say `{says}`");
    }
    assert!(rig.sim.flash() == flash, "{name}: {error}, but data flash has changed");
    assert_eq!(count(rig), before, "{name}: {error}");
    assert_eq!(rig.seal(), seal, "{name}: {error}");
}

/// Changes what is read from a register, depending on the last subcommand.
type Tamper = fn(asked: u16, register: u8, read: &mut [u8]);

struct Tampered(Box<dyn Bus>, u16, Tamper);

impl Bus for Tampered {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if let [0x00, low, high] = *write {
            self.1 = u16::from_le_bytes([low, high]);
        }
        self.0.transfer(write, read)?;
        if !read.is_empty() {
            (self.2)(self.1, write[0], read);
        }
        Ok(())
    }
}

impl Rig {
    fn tampered(chip: &str, tamper: Tamper) -> Self {
        let mut rig = Self::new(chip);
        rig.tamper(tamper);
        rig
    }

    fn tamper(&mut self, tamper: Tamper) {
        let bus = Box::new(Tampered(Box::new(self.sim.bus()), 0, tamper));
        self.gauge = Gauge::new(self.gauge.chip, bus, self.clock.clone(), Keys::default());
        self.gauge.seal().expect("the gauge answers");
    }

    /// Identifies the gauge, as the daemon does when it finds one.
    fn meet(&mut self) {
        let answers = self.gauge.identify().expect("the gauge answers");
        self.dataflash.meet(self.gauge.chip, &answers);
    }

    /// Sends subcommands as another program would: unseals the gauge, and seals it again.
    pub(crate) fn send(&mut self, codes: &[u16]) {
        self.gauge.go_to(Seal::Unsealed).expect("the default key");
        for &code in codes {
            self.gauge.command(code).expect("the gauge answers");
        }
        self.clock.sleep(Duration::from_secs(2));
    }
}

#[test]
fn no_write_in_a_mode_that_someone_else_set() {
    let minute = Duration::from_secs(60);
    // How the mode begins, what the refusal says, and how the mode ends: by subcommands, or by itself.
    type Case = (&'static str, &'static [u16], [&'static str; 2], &'static [u16], Duration);
    let cases: &[Case] = &[
        ("bq34z100-g1", &[0x002D, 0x0081], ["[CALEN]", "EXIT_CAL"], &[0x0080, 0x002D], minute),
        ("bq34z100-g1", &[0x000A], ["[CCA]", "ends by itself"], &[], minute),
        ("bq34z100-g1", &[0x0009], ["[BCA]", "ends by itself"], &[], minute),
        ("bq27520-g3", &[0x000A], ["[CCA]", "ends by itself"], &[], minute),
        ("bq27520-g3", &[0x0009], ["[BCA]", "ends by itself"], &[], minute),
        ("bq27441-g1", &[0x0013], ["[CFGUPMODE]", "240 s"], &[], 4 * minute),
        ("bq27421-g1", &[0x0013], ["[CFGUPMODE]", "240 s"], &[], 4 * minute),
        ("bq27426", &[0x0013], ["[CFGUPMODE]", "240 s"], &[], 4 * minute),
        ("bq27427", &[0x0013], ["[CFGUPMODE]", "240 s"], &[], 4 * minute),
        ("bq27621-g1", &[0x0013], ["[CFGUPMODE]", "240 s"], &[], 4 * minute),
        ("bq34110", &[0x002D], ["[CAL_EN]", "CAL_TOGGLE"], &[0x002D], minute),
        ("bq34110", &[0x000A], ["[CCA]", "ends by itself"], &[], minute),
        ("bq34110", &[0x0009], ["0x0030", "ends by itself"], &[], minute),
        ("bq35100", &[0x002D, 0x0081], ["[CALMODE]", "EXIT_CAL"], &[0x0080, 0x002D], minute),
        ("bq35100", &[0x000A], ["[CCA]", "ends by itself"], &[], minute),
        ("bq35100", &[0x0009], ["0x4c80", "ends by itself"], &[], minute),
    ];
    for &(chip, begin, says, end, lasts) in cases {
        let mut rig = Rig::new(chip);
        rig.send(begin);
        refused(&mut rig, "busy", &says);
        rig.send(end);
        rig.clock.sleep(lasts);
        let written = write(&mut rig);
        assert!(matches!(written, Ok(Outcome::Written { .. })), "{chip} {begin:04x?}: {written:?}");
    }
}

/// The bits are forced, because no simulated RAM gauge sets them.
#[test]
fn no_write_during_calibration_of_a_ram_gauge() {
    let cases: [(Tamper, &str); 3] = [
        (|asked, register, read| read[1] |= if (asked, register) == (0, 0) { 0x10 } else { 0 }, "[CALMODE]"),
        (|asked, register, read| read[1] |= if (asked, register) == (0, 0) { 0x08 } else { 0 }, "[CCA]"),
        (|asked, register, read| read[1] |= if (asked, register) == (0, 0) { 0x04 } else { 0 }, "[BCA]"),
    ];
    for chip in ["bq27441-g1", "bq27421-g1", "bq27426", "bq27427"] {
        for (tamper, says) in cases {
            refused(&mut Rig::tampered(chip, tamper), "busy", &[says]);
        }
    }
}

/// A mode that a failed transaction of this mount left on is ended by the next write.
#[test]
fn a_mode_left_by_our_own_failed_write_is_cleared() {
    let left_on = (1..60).find_map(|first: u64| {
        let mut rig = Rig::new("bq27441-g1");
        let faults: Vec<_> = (first..first + 2000).map(|n| format!("nack {n}")).collect();
        rig.sim.set("fault", &faults.join("; ")).expect("faults");
        let error = write(&mut rig).expect_err("the gauge falls silent");
        rig.sim.set("fault", "none").expect("a knob");
        let is_on = rig.sim.get("mode").is_some_and(|mode| mode != "normal");
        (is_on && cause(&error) == "state-unknown").then_some(rig)
    });
    let mut rig = left_on.expect("some silence leaves the mode on");
    rig.gauge.forget_refusal();
    assert_eq!(write(&mut rig), WRITTEN);
    assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"));
    rig.send(&[0x0013]);
    assert_eq!(cause(&rig.write(82, 10, "1300").expect_err("somebody else's")), "busy");
}

#[test]
fn a_gauge_in_rom_mode_is_reported() {
    for (chip, remedy) in [("bq34z100-g1", "`gaugefs rescue` brings it back"), ("bq27500", "TI's tools do")] {
        assert_rom_mode_is_reported(chip, remedy);
    }
}

fn assert_rom_mode_is_reported(chip: &str, remedy: &str) {
    let mut rig = Rig::new(chip);
    rig.dataflash.go_to(&mut rig.gauge, Seal::FullAccess, Duration::ZERO).expect("the default keys");
    rig.gauge.command(0x0F00).expect("it is sent");
    assert_eq!(rig.sim.get("mode").as_deref(), Some("rom"));
    let flash = rig.sim.flash();
    let error = write(&mut rig).expect_err("nobody answers");
    assert_eq!(cause(&error), "no-answer", "{error}");
    assert!(error.to_string().contains("0x0b") && error.to_string().contains(remedy), "{error}");
    assert!(rig.sim.flash() == flash);
}

#[test]
fn another_part_is_not_written_to() {
    type Case = (&'static str, Tamper, [&'static str; 2]);
    let cases: &[Case] = &[
        (
            "bq34z100-g1",
            |asked, at, read| {
                if (asked, at) == (2, 0) {
                    read[1] = 2
                }
            },
            ["0x0216", "0x0016"],
        ),
        (
            "bq34z100-g1",
            |_, at, read| {
                if at == 0x28 {
                    read[0] = 7
                }
            },
            ["SerialNumber() is 0x0007", "0x0001"],
        ),
        (
            "bq27520-g3",
            |asked, at, read| {
                if (asked, at) == (2, 0) {
                    read[0] = 0x29
                }
            },
            ["0x0329", "0x0324"],
        ),
        (
            "bq27520-g3",
            |asked, at, read| {
                if (asked, at) == (1, 0) {
                    read[0] = 0x41
                }
            },
            ["0x0541", "0x0520"],
        ),
        (
            "bq27441-g1",
            |asked, at, read| {
                if (asked, at) == (8, 0) {
                    read[0] = 0x12
                }
            },
            ["CHEM_ID", "0x0128"],
        ),
        (
            "bq27441-g1",
            |asked, at, read| {
                if (asked, at) == (1, 0) {
                    read[0] = 0x27
                }
            },
            ["0x0427", "0x0421"],
        ),
        (
            "bq27427",
            |asked, at, read| {
                if (asked, at) == (8, 0) {
                    read[0] = 0x31
                }
            },
            ["CHEM_ID", "0x3230"],
        ),
        (
            "bq34110",
            |asked, at, read| {
                if (asked, at) == (2, 0x40) {
                    read[0] = 9
                }
            },
            ["firmware", "0x1009"],
        ),
        (
            "bq34110",
            |asked, at, read| {
                if (asked, at) == (1, 0x40) {
                    read[0] = 0
                }
            },
            ["0x0100", "0x0110"],
        ),
        (
            "bq35100",
            |asked, at, read| {
                if (asked, at) == (6, 0x40) {
                    read[0] = 9
                }
            },
            ["CHEM_ID", "0x0609"],
        ),
    ];
    for &(chip, tamper, says) in cases {
        let mut rig = Rig::new(chip);
        rig.meet();
        // A write reads the serial number; in the daemon, a poll does.
        assert!(write(&mut rig).is_ok(), "{chip}");
        rig.tamper(tamper);
        assert!(!rig.dataflash.doubts());
        refused(&mut rig, "gone", &says);
        assert!(rig.dataflash.doubts(), "{chip}: it has to be asked anew who it is");
        refused(&mut rig, "gone", &says);
        rig.tamper(|_, _, _| ());
        assert_eq!(write(&mut rig), Ok(Outcome::Unchanged), "{chip}");
    }
}

/// A gauge with a firmware that no table covers is not written, whether it was identified before or not.
#[test]
fn an_unknown_firmware_is_not_written_to() {
    let mut rig = Rig::tampered("bq34z100-g1", |asked, at, read| {
        if (asked, at) == (2, 0) {
            read[1] = 2
        }
    });
    refused(&mut rig, "gone", &["0x0216", "mount it anew"]);
}

/// I2C has no error detection: one wrong bit must not be taken for another pack or a mode.
#[test]
fn a_single_bit_error_blocks_no_write() {
    // The answers to FW_VERSION, SerialNumber() and CONTROL_STATUS, by the log of a write.
    for fault in ["flip 2 0 4", "flip 3 0 2", "flip 5 1 4"] {
        let mut rig = Rig::new("bq34z100-g1");
        rig.meet();
        assert_eq!(rig.write(80, 53, "3050"), WRITTEN);
        rig.sim.set("fault", fault).expect("a fault");
        assert_eq!(write(&mut rig), WRITTEN, "{fault}");
        assert!(!rig.dataflash.doubts(), "{fault}");
    }
}

/// The pack's serial number is written like any other parameter.
#[test]
fn a_changed_serial_number_is_not_taken_for_another_pack() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.meet();
    assert_eq!(rig.write(48, 4, "0x0102"), WRITTEN);
    assert_eq!(write(&mut rig), WRITTEN);
    assert_eq!(rig.write(48, 4, "0x0103"), WRITTEN);
    assert_eq!(rig.write(80, 53, "3200"), WRITTEN);
}

/// A RAM gauge has lost power, or was exchanged, between two polls.
#[test]
fn a_ram_gauge_that_lost_power_is_read_again_before_a_write() {
    for chip in ["bq27441-g1", "bq27421-g1", "bq27426", "bq27427", "bq27621-g1"] {
        let mut rig = Rig::new(chip);
        rig.meet();
        assert_eq!(write(&mut rig), WRITTEN, "{chip}");
        rig.sim.set("power", "off").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(1));
        refused(&mut rig, "gone", &["[ITPOR]", "lost its power"]);
        rig.meet();
        assert_eq!(write(&mut rig), WRITTEN, "{chip}");
    }
}

#[test]
fn a_ram_gauge_is_written_only_between_2450_and_4500_mv() {
    for chip in ["bq27441-g1", "bq27421-g1", "bq27426", "bq27427", "bq27621-g1"] {
        for mv in ["0", "2449", "4501"] {
            let mut rig = Rig::new(chip);
            rig.sim.set("voltage_mv", mv).expect("a knob");
            refused(&mut rig, "not-now", &["Voltage()", mv, "charge the cell"]);
            // Restoring a configuration is not affected.
            let (at, text) = row(chip);
            let change = rig.change(at.0, at.1, text).saved();
            assert_eq!(
                rig.dataflash.write(&mut rig.gauge, &[change], Duration::ZERO).map(without_old),
                WRITTEN,
                "{chip} {mv}"
            );
        }
        for mv in ["2450", "4500"] {
            let mut rig = Rig::new(chip);
            rig.sim.set("voltage_mv", mv).expect("a knob");
            assert_eq!(write(&mut rig), WRITTEN, "{chip} {mv}");
        }
    }
}

const SAYS: &[&str] = &["learning", "LearnedStatus()", "--allow-learning"];

#[test]
fn a_write_that_would_end_a_learning_cycle_is_refused() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.send(&[0x0021, 0x0020]);
    refused(&mut rig, "busy", SAYS);
    // A write that needs no reset is allowed.
    assert_eq!(rig.write(80, 53, "3000"), Ok(Outcome::Unchanged));
    assert_eq!(rig.write(58, 3, "0x5a"), STORED);
    // First Qmax is learned and Ra is not, then both are.
    assert_eq!(rig.write(82, 4, "0x05"), WRITTEN);
    // After the reset there is nothing to lose until a rest has set [VOK] again.
    rig.clock.sleep(Duration::from_secs(3600));
    rig.seal();
    refused(&mut rig, "busy", SAYS);
    assert_eq!(rig.write(82, 4, "0x06"), WRITTEN);
    assert_eq!(write(&mut rig), WRITTEN);
}

#[test]
fn a_learning_cycle_can_be_ended_on_request() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.send(&[0x0021, 0x0020]);
    let limits = Limits { allow_learning: true, ..Limits::default() };
    rig.dataflash = DataFlash::new(limits, None);
    assert_eq!(write(&mut rig), WRITTEN);
}

/// A transaction that contains Update Status among other parameters, as a golden image does, does not end the cycle.
#[test]
fn a_golden_image_is_refused_during_a_learning_cycle() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.send(&[0x0021, 0x0020]);
    let before = rig.sim.flash();
    let changes = [rig.change(82, 4, "0x02"), rig.change(80, 53, "3100")];
    let error = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO).expect_err("it waits");
    assert_eq!(cause(&error), "busy", "{error}");
    assert!(rig.sim.flash() == before);
}

/// On a RAM gauge Update Status is in data memory only, and the host begins and ends the cycle there.
#[test]
fn a_write_during_a_learning_cycle_of_a_ram_gauge_is_refused() {
    for chip in ["bq27441-g1", "bq27426", "bq27427"] {
        // [VOK] is forced, because the simulated RAM gauges do not set it. Bit 7 of Update Status seals the gauge.
        let mut rig = Rig::tampered(chip, |asked, at, read| {
            if (asked, at) == (0, 0) {
                read[0] |= 0x02;
            }
        });
        assert_eq!(rig.write(82, 2, "0x83"), WRITTEN, "{chip}");
        refused(&mut rig, "busy", &["learning", "Update Status", "--allow-learning"]);
        assert_eq!(rig.write(82, 2, "0x80"), WRITTEN, "{chip}");
        assert_eq!(write(&mut rig), WRITTEN, "{chip}");
    }
}

/// The documented number of transfers also applies to a pack in service, in which Impedance Track runs.
#[test]
fn a_write_to_a_pack_in_service_needs_no_more_transfers() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.send(&[0x0021, 0x0020]);
    assert_eq!(rig.write(82, 4, "0x06"), WRITTEN);
    // The state after mounting.
    rig.dataflash = DataFlash::default();
    rig.meet();
    rig.dataflash.polled(rig.gauge.chip, |source| (source == Source::Command(0x28)).then_some(1));
    let before = rig.cost();
    assert_eq!(write(&mut rig), WRITTEN);
    let after = rig.cost();
    let (transfers, bytes) = (after.0 - before.0, after.1 - before.1);
    assert!(transfers <= 46 && bytes <= 570, "found SEALED: {transfers} transfers, {bytes} bytes");
    rig.dataflash.go_to(&mut rig.gauge, Seal::Unsealed, Duration::ZERO).expect("the default key");
    let before = rig.cost();
    assert_eq!(rig.write(80, 53, "3200"), WRITTEN);
    let after = rig.cost();
    let (transfers, bytes) = (after.0 - before.0, after.1 - before.1);
    assert!(transfers <= 37 && bytes <= 530, "found UNSEALED: {transfers} transfers, {bytes} bytes");
}

/// Properties of the tables on which the engine relies.
#[test]
fn the_tables_have_what_the_checks_need() {
    for chip in CHIPS.iter().copied().filter(|chip| chip.is_proven()) {
        let name = chip.name;
        let within = |last: u8, code: u8| {
            assert!((0x02..=last).contains(&code), "{name}: 0x{code:02x} is far from Control()");
        };
        let near = |row: &Register| within(0x0E, row.source.command().expect("a standard command"));
        near(chip.register(Role::VoltageNow).expect("every part measures a voltage"));
        if chip.volatile.is_some() {
            near(chip.register(Role::Flags).expect("flags"));
        }
        assert!(chip.gate.is_some() != chip.preflight.voltage_mv.is_some(), "{name}: one of them watches");
        assert!(chip.preflight.modes.len() + 2 <= ALONG, "{name}: voltage, flags and modes are one look");
        for mode in chip.preflight.modes {
            match mode.word {
                // OperationStatus() has the modes of the bq27220, and one read reaches it.
                Source::Command(code) => within(0x3A, code),
                Source::Status => {
                    let bit = chip.control_status.iter().find(|bit| bit.mask == mode.mask).expect("a bit");
                    let is_answer =
                        matches!(chip.security.status, SealStatus::Field { word: Source::Answer(_), .. });
                    let word = if is_answer { "OperationStatus()" } else { "CONTROL_STATUS" };
                    assert_eq!(mode.name, format!("{word} [{}]", bit.name), "{name}");
                }
                Source::Answer(code) | Source::Within(code, _) => {
                    assert!(chip.subcommand(code).is_some(), "{name}")
                }
            }
        }
        match chip.preflight.pack.as_ref().map(|pack| pack.word) {
            Some(Source::Answer(code)) => {
                let asked = chip.subcommand(code).expect("a subcommand");
                assert_eq!((asked.name, asked.sealed), ("CHEM_ID", true), "{name}");
            }
            Some(source @ Source::Command(_)) => {
                assert_eq!(chip.register_at(source).map(|register| register.size), Some(2), "{name}");
            }
            Some(Source::Status | Source::Within(..)) => panic!("{name}: a seal tells no packs apart"),
            None => {}
        }
        if let Some(learning) = &chip.preflight.learning {
            let row = chip.parameter(learning.row.0, learning.row.1).expect("a row");
            assert_eq!(row.name, "Update Status", "{name}");
        }
    }
}

fn limited(chip: &str, writes_per_hour: u32) -> Rig {
    let mut rig = Rig::new(chip);
    rig.dataflash = DataFlash::new(Limits { writes_per_hour, ..Limits::default() }, None);
    rig
}

fn count(rig: &Rig, wanted: &str) -> u64 {
    rig.gauge.statistics.list().iter().find(|(name, _)| *name == wanted).expect("it is counted").1
}

#[test]
fn writes_over_the_hourly_limit_are_refused_before_any_transfer() {
    let mut rig = limited("bq34z100-g1", 3);
    for text in ["3001", "3002", "3003"] {
        assert_eq!(rig.write(80, 53, text), WRITTEN);
    }
    rig.clock.sleep(Duration::from_secs(600));
    let (sent, flash) = (rig.cost(), rig.sim.flash());
    let error = rig.write(80, 53, "3004").expect_err("three an hour");
    assert_eq!(cause(&error), "not-now", "{error}");
    for says in [
        "Cell Terminate Voltage (80/53)",
        "3 blocks",
        "the next write may come in 50 min 0 s",
        "--writes-per-hour",
    ] {
        assert!(error.to_string().contains(says), "`{error}` does not say `{says}`");
    }
    assert_eq!(rig.cost(), sent, "the gauge was touched");
    assert!(rig.sim.flash() == flash);
    rig.clock.sleep(Duration::from_secs(3600));
    assert_eq!(rig.write(80, 53, "3004"), WRITTEN);
}

#[test]
fn unchanged_values_do_not_count_as_wear() {
    let mut rig = limited("bq34z100-g1", 1);
    for _ in 0..5 {
        assert_eq!(rig.write(80, 53, "3000"), Ok(Outcome::Unchanged));
    }
    let both = [rig.change(80, 53, "3000"), rig.change(48, 11, "1000")];
    let unchanged = rig.dataflash.write(&mut rig.gauge, &both, Duration::ZERO);
    assert_eq!(unchanged, Ok(Outcome::Unchanged));
    assert_eq!(rig.sim.get("programmed").as_deref(), Some("0"));
    let counts = ["unchanged_writes", "flash_writes", "resets"].map(|name| count(&rig, name));
    assert_eq!(counts, [6, 0, 0]);
    assert_eq!(rig.write(80, 53, "3001"), WRITTEN);
    assert_eq!(cause(&rig.write(80, 53, "3002").expect_err("one an hour")), "not-now");
}

/// A golden image is not stopped half-way by the limit; its blocks are counted afterwards.
#[test]
fn a_transaction_is_not_stopped_half_way_by_the_limit() {
    let mut rig = limited("bq34z100-g1", 2);
    let changes = [(80, 53, "3100"), (48, 11, "2200"), (36, 0, "110"), (58, 3, "0x5a")];
    let changes = changes.map(|(subclass, offset, text)| rig.change(subclass, offset, text));
    let outcome = rig.dataflash.write(&mut rig.gauge, &changes, Duration::ZERO);
    assert_eq!(outcome.map(without_old), WRITTEN);
    assert_eq!(count(&rig, "flash_writes"), 4);
    let error = rig.write(80, 53, "3200").expect_err("two an hour");
    assert!(error.to_string().contains("4 blocks"), "{error}");
}

/// Blocks that are put back wear the flash as well, so they count, but they are never refused.
#[test]
fn a_rollback_counts_but_is_never_refused() {
    let mut rig = limited("bq34z100-g1", 1);
    rig.sim.set("fault", "corrupt-commit").expect("a fault");
    let before = rig.sim.flash();
    assert_eq!(cause(&rig.write(80, 53, "3100").expect_err("stored wrongly")), "rolled-back");
    assert!(rig.sim.flash() == before);
    assert_eq!(count(&rig, "flash_writes"), 2);
    let error = rig.write(80, 53, "3100").expect_err("one an hour");
    assert!(cause(&error) == "not-now" && error.to_string().contains("2 blocks"), "{error}");
}

#[test]
fn ram_has_no_limit_and_0_means_no_limit() {
    let mut rig = limited("bq27441-g1", 1);
    for text in ["1001", "1002", "1003"] {
        assert_eq!(rig.write(82, 10, text), WRITTEN);
    }
    let mut rig = limited("bq34z100-g1", 0);
    for text in ["3001", "3002", "3003"] {
        assert_eq!(rig.write(80, 53, text), WRITTEN);
    }
}

/// What a pack does not change by itself: its number, a count of cycles that falls, its capacity by design.
#[test]
fn a_poll_that_contradicts_the_last_one_shows_another_pack() {
    const CYCLES: u8 = 0x2C;
    for (code, now, is_another) in
        [(0x28, 8, true), (CYCLES, 6, true), (CYCLES, 8, false), (0x3C, 8, true), (0x08, 8, false)]
    {
        let mut rig = Rig::new("bq34z100-g1");
        let answers = rig.gauge.identify().expect("it answers");
        rig.dataflash.meet(rig.gauge.chip, &answers);
        let chip = rig.gauge.chip;
        assert!(!rig.dataflash.polled(chip, |_| Some(7)), "{code:#x}");
        let shown = rig.dataflash.polled(chip, |at| Some(if at == Source::Command(code) { now } else { 7 }));
        assert_eq!(shown, is_another, "{code:#x} is {now}");
    }
}
