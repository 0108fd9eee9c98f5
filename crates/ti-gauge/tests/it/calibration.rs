// SPDX-License-Identifier: MIT

//! Calibration and bring-up: what they find on boards with errors, what they refuse, and one fault at each transfer.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::calibration::{self, Job};
use ti_gauge::dataflash::{DataFlash, Decision, Limits};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};

use crate::rig::{Rig, cause};
use crate::room::programs;
use crate::room::{Folder, host, one_in, restart};

/// What a job reaches, in words.
fn run(
    dataflash: &mut DataFlash,
    gauge: &mut Gauge,
    job: &Job,
    waited: Duration,
    tell: &mut dyn FnMut(&str),
) -> Result<String> {
    calibration::run(dataflash, gauge, job, waited, tell).map(|reached| reached.text)
}

/// A board, and a calibration of it.
struct Case {
    chip: &'static str,
    knobs: &'static [(&'static str, &'static str)],
    job: Job,
    found: Seal,
}

const BRING_UP: Job = Job::BringUp { cells: 7, divider: 33_000, voltage_mv: Some(26_985.0) };
/// Seven cells behind an external divider, of a new part: Voltage() is 818 mV.
const NEW_BOARD: &[(&str, &str)] = &[("cells", "7"), ("board_divider", "33000")];

fn cases() -> Vec<Case> {
    let case = |chip, knobs, job| Case { chip, knobs, job, found: Seal::Sealed };
    vec![
        case("bq34z100-g1", &[("shunt_error", "50"), ("load_ma", "1000")], Job::Current(-1000.0)),
        case("bq34z100-r2", &[("shunt_error", "-80"), ("load_ma", "-500")], Job::Current(500.0)),
        case("bq34z100-g1", &[("temperature_error", "35")], Job::Temperature(25.0)),
        case("bq34z100-g1", &[("board_offset_ma", "8")], Job::BoardOffset),
        case("bq34z100-g1", &[("cc_offset_ma", "7")], Job::CcOffset),
        case("bq34z100-g1", NEW_BOARD, BRING_UP),
        Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: BRING_UP, found: Seal::Unsealed },
        Case {
            chip: "bq34z100-g1",
            knobs: &[("temperature_error", "-20")],
            job: Job::Temperature(25.0),
            found: Seal::FullAccess,
        },
    ]
}

impl Case {
    fn rig(&self) -> Rig {
        let mut rig = Rig::calibrated(self.chip, self.found);
        // What was read before the values were set is not known.
        rig.dataflash = DataFlash::default();
        for (knob, text) in self.knobs {
            rig.sim.set(knob, text).expect("a knob");
        }
        rig.clock.sleep(Duration::from_secs(2));
        rig
    }

    fn run(&self, rig: &mut Rig) -> Result<String> {
        run(&mut rig.dataflash, &mut rig.gauge, &self.job, Duration::ZERO, &mut |_| {})
    }
}

fn signed(rig: &mut Rig, register: u8) -> i16 {
    let mut bytes = [0; 2];
    rig.gauge.read(register, &mut bytes).expect("it answers");
    i16::from_le_bytes(bytes)
}

#[test]
fn a_calibration_removes_the_error_of_a_board() {
    for case in cases() {
        let mut rig = case.rig();
        let (register, name, unit, actual, most) = match case.job {
            Job::Current(actual) => (0x10, "Current()", "mA", actual, 2.0),
            Job::Temperature(actual) => (0x0C, "Temperature()", "0.1 K", actual * 10.0 + 2731.0, 1.0),
            Job::BoardOffset | Job::CcOffset => (0x10, "Current()", "mA", 0.0, 1.0),
            _ => (0x08, "Voltage()", "mV", 26_985.0, 30.0),
        };
        let error = |rig: &mut Rig| (f64::from(signed(rig, register)) - actual).abs();
        let before = error(&mut rig);
        assert!(before > 5.0, "{:?}: {before}", case.job);
        let begun = rig.clock.now();
        let text = case.run(&mut rig).unwrap_or_else(|error| panic!("{:?}: {error}", case.job));
        assert!(rig.clock.now() - begun < Duration::from_secs(30), "{text}");
        let after = error(&mut rig);
        // A row of benches/run.
        println!(
            "| {} {:?}: error of {name} | {before:.1} before, {after:.1} {unit} after | |",
            case.chip, case.job
        );
        assert!(after <= most, "{:?}: {before} before, {after} after: {text}", case.job);
        assert_eq!(rig.seal(), case.found, "{text}");
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{text}");
        assert_eq!(rig.sim.get("dropped").as_deref(), Some("0"), "{text}");
    }
}

#[test]
fn a_divider_is_calibrated_to_what_a_meter_shows() {
    let mut rig = Rig::new("bq34z100-g1");
    rig.sim.set("noise_mv", "3").expect("a knob");
    // 3855 mV with 5000: the meter shows 2 % more.
    let job = Job::Voltage(3932.0);
    let reached = calibration::run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |_| {})
        .expect("no fault");
    let (text, measured) = (reached.text, &reached.measured[..]);
    assert!(text.contains("the error was -7"), "{text}");
    let [measured] = measured else { panic!("{measured:?}") };
    assert_eq!((measured.name, measured.unit, measured.wanted), ("Voltage()", "mV", Some(3932.0)));
    assert!((measured.before - 3855.0).abs() < 4.0 && (measured.after - 3932.0).abs() < 5.0, "{measured:?}");
    let divider = rig.read(104, 14).expect("it can be read");
    let divider = u16::from_be_bytes([divider[0], divider[1]]);
    assert!((5095..=5105).contains(&divider), "{divider}");
    let voltage = signed(&mut rig, 0x08);
    assert!((3927..=3937).contains(&voltage), "{voltage}: {text}");
}

/// What is refused, with nothing changed and nothing programmed.
#[test]
fn what_is_noisy_or_out_of_range_is_refused() {
    let noisy: &[(&str, &str)] = &[("noise_mv", "300")];
    let trembling: &[(&str, &str)] = &[("load_ma", "1000"), ("noise_ma", "200")];
    let load: &[(&str, &str)] = &[("load_ma", "1000")];
    for (knobs, job, expected, says) in [
        (noisy, Job::Voltage(3900.0), "not-now", "too noisy"),
        (trembling, Job::Current(-1000.0), "not-now", "too noisy"),
        (&[], Job::Voltage(12_600.0), "out-of-range", "gaugefs bringup"),
        (load, Job::Current(1000.0), "out-of-range", "negative"),
        (load, Job::Current(-500.0), "out-of-range", "5677445"),
        (&[], Job::Current(-20.0), "out-of-range", "100 mA"),
        (&[], Job::Temperature(60.0), "out-of-range", "-12.8 °C (-128) to 12.7 °C (127)"),
        (load, Job::BoardOffset, "not-now", "disconnect load"),
        (load, Job::CcOffset, "not-now", "disconnect load"),
        (
            &[],
            Job::BringUp { cells: 7, divider: 20_000, voltage_mv: Some(26_000.0) },
            "out-of-range",
            "20000 mV",
        ),
        (
            NEW_BOARD,
            Job::BringUp { cells: 7, divider: 33_000, voltage_mv: Some(26.985) },
            "out-of-range",
            "26.985 mV is too little for 7 cells; if it means 26.985V,",
        ),
        (
            NEW_BOARD,
            Job::BringUp { cells: 7, divider: 33, voltage_mv: None },
            "out-of-range",
            "33 mV is too little for 7 cells; if it means 33V,",
        ),
    ] {
        let mut rig = Case { chip: "bq34z100-g1", knobs, job: job.clone(), found: Seal::Sealed }.rig();
        let flash = rig.sim.flash();
        let error = run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |_| {})
            .expect_err("it is refused");
        assert_eq!(cause(&error), expected, "{job:?}: {error}");
        assert!(error.to_string().contains(says), "{job:?}: {error}");
        assert!(rig.sim.flash() == flash && rig.seal() == Seal::Sealed, "{job:?}");
        assert_eq!(rig.sim.get("programmed").as_deref(), Some("0"), "{job:?}");
    }
    let mut rig = Rig::new("bq27441-g1");
    let error = run(&mut rig.dataflash, &mut rig.gauge, &Job::Leave, Duration::ZERO, &mut |_| {});
    assert_eq!(cause(&error.expect_err("not documented")), "not-permitted");
}

/// The load changes while the new values are written: they seem to make the error larger.
#[test]
fn what_makes_the_error_larger_is_put_back() {
    let mut rig = Case {
        chip: "bq34z100-g1",
        knobs: &[("shunt_error", "50"), ("load_ma", "1000")],
        job: Job::Leave,
        found: Seal::Sealed,
    }
    .rig();
    let (flash, sim) = (rig.sim.flash(), rig.sim.clone());
    let mut tell = |text: &str| {
        if text.starts_with("writing") {
            sim.set("load_ma", "2000").expect("a knob");
        }
    };
    let error = run(&mut rig.dataflash, &mut rig.gauge, &Job::Current(-1000.0), Duration::ZERO, &mut tell)
        .expect_err("it is worse");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert!(rig.sim.flash() == flash && rig.seal() == Seal::Sealed);

    // An offset that was measured while a load was connected.
    let mut rig = Rig::new("bq34z100-g1");
    rig.sim.set("board_offset_ma", "8").expect("a knob");
    let (flash, sim) = (rig.sim.flash(), rig.sim.clone());
    let mut tell = |text: &str| {
        if text.starts_with("the gauge measures") {
            sim.set("load_ma", "1000").expect("a knob");
        }
    };
    let error = run(&mut rig.dataflash, &mut rig.gauge, &Job::BoardOffset, Duration::ZERO, &mut tell)
        .expect_err("it is worse");
    assert_eq!(cause(&error), "rolled-back", "{error}");
    assert!(rig.sim.flash() == flash && rig.seal() == Seal::Sealed, "{error}");
}

#[test]
fn a_new_board_gets_its_old_values_back_if_the_voltage_is_wrong() {
    for (cells, divider, voltage_mv) in [(7, 45_000, Some(26_985.0)), (4, 33_000, None), (7, 60_000, None)] {
        let mut rig =
            Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: Job::Leave, found: Seal::Sealed }.rig();
        let flash = rig.sim.flash();
        let job = Job::BringUp { cells, divider, voltage_mv };
        let mut told = Vec::new();
        let error = run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |text| {
            told.push(text.to_string())
        })
        .expect_err("the divider is wrong");
        assert_eq!(cause(&error), "rolled-back", "{job:?}: {error}");
        assert!(error.to_string().contains("is the divider right"), "{error}");
        assert!(told.iter().any(|text| text.contains("[VOLTSEL]")), "{told:?}");
        assert!(rig.sim.flash() == flash && rig.seal() == Seal::Sealed, "{job:?}");
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"));
    }
    // Without a meter the divider is taken as it is given.
    let mut rig = Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: Job::Leave, found: Seal::Sealed }.rig();
    rig.write(80, 53, "3100").expect_err("flash is shut");
    let job = Job::BringUp { cells: 7, divider: 33_000, voltage_mv: None };
    let text = run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |_| {}).expect("no fault");
    // 2800 x 7 x 5000 / 33000.
    assert!(text.contains("limit 68/0 is 2970 mV"), "{text}");
    assert_eq!(rig.read(68, 0), Ok(2970_u16.to_be_bytes().to_vec()));
    rig.write(80, 53, "3100").expect("flash is open");
}

/// The second transaction of a bring-up, which sets the limit, is put back: that is no success, and the same command
/// completes it.
#[test]
fn regression_a_bring_up_without_its_limit_was_a_success() {
    for (knob, text, undone) in
        [("fault", "corrupt-commit", true), ("noise_mv", "1000", true), ("fault", "torn-commit 1", false)]
    {
        let case = Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: BRING_UP, found: Seal::Sealed };
        let mut rig = case.rig();
        let sim = rig.sim.clone();
        let mut tell = |step: &str| {
            if step.starts_with("writing") {
                sim.set(knob, text).expect("a knob");
            }
        };
        let outcome = run(&mut rig.dataflash, &mut rig.gauge, &BRING_UP, Duration::ZERO, &mut tell);
        let error = outcome.expect_err("the limit is not set");
        let says = error.to_string();
        assert_eq!(cause(&error), "state-unknown", "{says}");
        assert!(says.contains("not complete") && says.contains("run the same command again"), "{says}");
        assert_eq!(says.contains("its limit stays 0"), undone, "{says}");
        if !undone {
            continue;
        }
        rig.sim.set(knob, if knob == "fault" { "none" } else { "0" }).expect("a knob");
        assert_eq!(rig.read(68, 0), Ok(vec![0, 0]));
        rig.write(80, 53, "3100").expect("flash is open");
        let done = case.run(&mut rig).unwrap_or_else(|error| panic!("{knob}: {error}"));
        assert!(done.contains("limit 68/0 is 29"), "{done}");
        assert_ne!(rig.read(68, 0), Ok(vec![0, 0]));
        assert_eq!(rig.seal(), Seal::Sealed);
    }
}

#[test]
fn a_gauge_that_a_dead_host_has_left_in_calibration_mode_is_led_out() {
    for found in [Seal::Sealed, Seal::Unsealed] {
        let mut rig = Rig::found("bq34z100-g1", Seal::Unsealed);
        rig.gauge.command(0x002D).expect("it answers");
        rig.gauge.command(0x0081).expect("it answers");
        rig.gauge.go_to(found).expect("the default key");
        let error = rig.write(80, 53, "3100").expect_err("calibration mode");
        assert!(error.to_string().contains("gaugefs calibrate GAUGE leave"), "{error}");
        for says in ["it is off now", "was off already"] {
            let text = run(&mut rig.dataflash, &mut rig.gauge, &Job::Leave, Duration::ZERO, &mut |_| {});
            assert!(text.as_ref().is_ok_and(|text| text.contains(says)), "{text:?}");
            assert_eq!(rig.seal(), found);
        }
        rig.write(80, 53, "3100").expect("normal mode");
    }
}

/// The faults that are tried at transfer `n`.
fn faults(n: u64) -> Vec<String> {
    let mut faults: Vec<String> = ["nack", "lost", "stuck"].map(|kind| format!("{kind} {n}")).into();
    for bit in [0, 4, 7] {
        faults.extend((0..3).map(|byte| format!("flip {n} {byte} {bit}")));
    }
    faults.extend(["power-cut", "power-cut-after"].map(|kind| format!("{kind} {n} 300")));
    faults.push(format!("silence {n} 60000"));
    faults
}

/// Whether data flash holds that. SEALED with one wrong bit is IT_ENABLE, which sets a bit of Update Status for good.
fn is_as(flash: &[u8], wanted: &[u8]) -> bool {
    flash.iter().zip(wanted).filter(|(now, wanted)| now != wanted).all(|(now, wanted)| now ^ wanted == 0x04)
}

/// Success is never reported falsely, nothing but the calibration has changed, and no gauge is left in calibration mode
/// without a word.
#[test]
pub(crate) fn a_fault_at_any_transfer_of_a_calibration_causes_no_false_success() {
    let folder = Folder::new("calibration");
    let every = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { 1 } else { 3 };
    let mut counts = std::collections::BTreeMap::new();
    for (number, case) in cases().into_iter().enumerate() {
        let mut plain = case.rig();
        let old = plain.sim.flash();
        let before = plain.cost().0;
        case.run(&mut plain).expect("no fault");
        let (new, transfers) = (plain.sim.flash(), plain.cost().0 - before);
        assert!(old != new, "{:?}", case.job);
        let calibrated: Vec<bool> = old.iter().zip(&new).map(|(old, new)| old != new).collect();
        let faults = (1..=transfers).flat_map(faults).skip(number % every).step_by(every);
        for fault in one_in(2, faults) {
            let at = format!("{} {:?} found {:?}, fault `{fault}`", case.chip, case.job, case.found);
            let mut rig = case.rig();
            rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
            rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("nothing to settle");
            rig.sim.set("fault", &fault).expect("a fault");
            let outcome = case.run(&mut rig);
            let flash = rig.sim.flash();
            let others =
                (0..flash.len()).all(|at| calibrated[at] || flash[at] == old[at] || old[at] ^ flash[at] == 4);
            let name = outcome.as_ref().map_or_else(cause, |_| "success");
            *counts.entry(name).or_insert(0) += 1;
            match name {
                "success" => {
                    assert!(flash != old && others, "{at}: success is false: {outcome:?}");
                    let is_open =
                        matches!(case.job, Job::BringUp { .. }) && rig.read(68, 0) == Ok(vec![0, 0]);
                    assert!(!is_open, "{at}: without its limit: {outcome:?}");
                }
                "state-unknown" => {}
                _ => assert!(is_as(&flash, &old), "{at}: {outcome:?}, but data flash has changed"),
            }
            let mode = rig.sim.get("mode");
            assert!(
                mode.as_deref() != Some("calibration") || rig.dataflash.owed().is_some(),
                "{at}: left in calibration mode without a word: {outcome:?}"
            );
            rig.sim.set("fault", "none").expect("a knob");
            rig.clock.sleep(Duration::from_secs(65));
            if rig.dataflash.owed().is_some() {
                rig.gauge.forget_refusal();
                let settled = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO);
                assert!(settled.is_ok(), "{at}: {outcome:?}, then {settled:?}");
            }
            assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{at}: {outcome:?}");
            let seal = rig.seal();
            // Never more open than before.
            let is_open = seal != case.found && seal != Seal::Sealed && case.found != Seal::FullAccess;
            assert!(!is_open, "{at}: {outcome:?}: {seal:?}");
            if case.found == Seal::Sealed && !fault.starts_with("power") {
                assert_eq!(seal, Seal::Sealed, "{at}: {outcome:?}");
            }
        }
    }
    println!("{} runs with a fault: {counts:?}", counts.values().sum::<u32>());
}

/// A host that loses power at any transfer of a bring-up. The next one finds old values or those of a finished
/// transaction, and if calibration mode is still on, CONTROL_STATUS shows it, and `Leave` ends it.
#[test]
fn a_host_that_dies_in_calibration_mode_leaves_a_gauge_that_says_so() {
    let folder = Folder::new("bring-up");
    let case = Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: BRING_UP, found: Seal::Sealed };
    let start = |rig: &Rig, cut| {
        host(rig, &folder, cut, |dataflash, gauge| {
            run(dataflash, gauge, &case.job, Duration::ZERO, &mut |_| {})
        })
    };
    let (plain, mut seen) = (case.rig(), Vec::new());
    seen.push(plain.sim.flash());
    let (done, transfers) = start(&plain, None);
    done.expect("no power cut").expect("no fault");
    seen.push(plain.sim.flash());
    let (mut runs, mut left_on, mut between) = (0, 0, 0);
    for cut in (1..=transfers).flat_map(|at| [(at, false), (at, true)]) {
        let mut rig = case.rig();
        let (outcome, _) = start(&rig, Some(cut));
        assert!(outcome.is_none_or(|outcome| outcome.is_ok()), "{cut:?}");
        rig.clock.sleep(Duration::from_secs(3));
        rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
        let settled = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO);
        // The calibration has changed what distinguishes the pack, or a person has to decide.
        if let Err(error) = settled {
            panic!("{cut:?}: {error}");
        }
        runs += 1;
        let is_on = rig.sim.get("mode").as_deref() == Some("calibration");
        let status = rig.gauge.control_status().expect("it answers").1;
        assert_eq!(ti_gauge::calibration::is_on(rig.gauge.chip, status), is_on, "{cut:?}");
        if is_on {
            left_on += 1;
            let left = run(&mut rig.dataflash, &mut rig.gauge, &Job::Leave, Duration::ZERO, &mut |_| {});
            assert!(left.is_ok(), "{cut:?}: {left:?}");
        }
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{cut:?}");
        assert_eq!(rig.seal(), Seal::Sealed, "{cut:?}");
        let flash = rig.sim.flash();
        if !seen.contains(&flash) {
            between += 1;
            // After the first transaction: the limit is 0, and flash is open.
            assert_eq!(rig.read(68, 0), Ok(vec![0, 0]), "{cut:?}");
            rig.write(80, 53, "3100").expect("flash is open");
        }
    }
    assert!(left_on > 0 && between > 0, "{left_on} left on, {between} between the transactions");
    println!("{runs} runs: {left_on} left in calibration mode and led out, {between} with the limit at 0");
}

#[test]
fn a_calibration_that_changes_a_divider_by_more_than_a_fifth_is_refused() {
    for factor in [0.75, 1.25] {
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        let actual = f64::from(signed(&mut rig, 0x08)) * factor;
        let flash = rig.sim.flash();
        let job = Job::Voltage(actual);
        let error = run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |_| {});
        let error = error.expect_err("no tolerance explains it");
        assert_eq!(cause(&error), "out-of-range", "{error}");
        assert!(error.to_string().contains("20 %") && rig.sim.flash() == flash, "{error}");
    }
}

/// The host is gone in the middle of a bring-up, and no one has heard of calibration mode but its journal.
#[test]
fn a_host_that_starts_again_leaves_the_calibration_mode_of_an_interrupted_write() {
    let folder = Folder::new("left-calibrating");
    let case = Case { chip: "bq34z100-g1", knobs: NEW_BOARD, job: BRING_UP, found: Seal::Sealed };
    let work = |rig: &Rig, cut| {
        host(rig, &folder, cut, |dataflash, gauge| {
            run(dataflash, gauge, &case.job, Duration::ZERO, &mut |_| {})
        })
    };
    let plain = case.rig();
    plain.sim.clear_log();
    work(&plain, None).0.expect("no cut").expect("no fault");
    let commit = plain.sim.log().iter().position(|record| programs(&record.write));
    let number = commit.expect("it is written") as u64 + 1;
    let mut rig = case.rig();
    assert!(work(&rig, Some((number, true))).0.is_none(), "the host loses power");
    rig.clock.sleep(Duration::from_secs(5));
    assert_ne!(rig.gauge.control_status().expect("it answers").1 & 0x1000, 0, "[CALEN]");
    restart(&rig, &folder, None);
    let (seal, status) = rig.gauge.control_status().expect("it answers");
    assert_eq!((seal, status & 0x1000), (Seal::Sealed, 0));
}

/// A host that loses power at any transfer of the measurement of an offset, which the gauge itself stores. The next one
/// finds old values, or what the gauge has measured is undone: it is judged after the last transfer.
#[test]
fn an_offset_that_nobody_has_judged_does_not_outlive_its_host() {
    let cases = [
        Case {
            chip: "bq34z100-g1",
            knobs: &[("board_offset_ma", "8")],
            job: Job::BoardOffset,
            found: Seal::Sealed,
        },
        Case {
            chip: "bq34z100-r2",
            knobs: &[("cc_offset_ma", "7")],
            job: Job::CcOffset,
            found: Seal::Unsealed,
        },
    ];
    let folder = Folder::new("offsets");
    for case in cases {
        let start = |rig: &Rig, cut| {
            host(rig, &folder, cut, |dataflash, gauge| {
                run(dataflash, gauge, &case.job, Duration::ZERO, &mut |_| {})
            })
        };
        let plain = case.rig();
        let old = plain.sim.flash();
        let (done, transfers) = start(&plain, None);
        done.expect("no power cut").expect("no fault");
        let new = plain.sim.flash();
        assert!(old != new && folder.files().is_empty(), "{:?}", folder.files());
        let (mut undone, mut untouched) = (0, 0);
        for cut in (1..=transfers).flat_map(|at| [(at, false), (at, true)]) {
            let rig = case.rig();
            let (outcome, _) = start(&rig, Some(cut));
            assert!(outcome.is_none_or(|outcome| outcome.is_ok()), "{cut:?}");
            let journals =
                folder.files().into_iter().map(|file| std::fs::read_to_string(folder.path().join(file)));
            let waits =
                journals.map(|text| text.expect("it is text")).any(|text| text.contains("\nby gauge\n"));
            let stored = rig.sim.flash() != old;
            rig.clock.sleep(Duration::from_secs(20));
            let (said, _) = restart(&rig, &folder, None);
            let flash = rig.sim.flash();
            assert!(flash == old, "{cut:?}: {said:?}");
            match (waits, stored) {
                (false, true) => panic!("{cut:?}: stored, and not on record: {said:?}"),
                (true, true) => {
                    let said = said.clone().flatten().unwrap_or_default();
                    assert!(said.contains("was not judged; the old values were restored"), "{cut:?}: {said}");
                    undone += 1;
                }
                (_, false) => untouched += 1,
            }
            let mut rig = rig;
            assert_eq!((rig.seal(), folder.files()), (case.found, vec![]), "{cut:?}: {said:?}");
            assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{cut:?}");
        }
        assert!(undone > 0 && untouched > 0, "{undone} undone, {untouched} untouched");
    }
}

/// A pack as it left the factory cannot be told from another one: a person decides, and sees what the gauge holds.
#[test]
fn an_offset_of_a_new_pack_that_nobody_has_judged_waits_for_a_person() {
    for (decision, kept) in [(Decision::Undo(None), false), (Decision::Finish(None), true)] {
        let folder = Folder::new("new-offset");
        let interrupted = |at| {
            let rig = Rig::new("bq34z100-g1");
            rig.sim.set("board_offset_ma", "8").expect("a knob");
            let old = rig.sim.flash();
            let _ = std::fs::remove_dir_all(folder.path());
            let (done, _) = host(&rig, &folder, Some((at, true)), |dataflash, gauge| {
                run(dataflash, gauge, &Job::BoardOffset, Duration::ZERO, &mut |_| {})
            });
            assert!(done.is_none(), "stored before transfer {at}");
            (rig.sim.flash() != old).then_some((rig, old))
        };
        let (mut rig, old) = (1..).find_map(interrupted).expect("it stores something");
        rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
        rig.clock.sleep(Duration::from_secs(20));
        let new = rig.sim.flash();
        let error = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect_err("it may be another pack");
        assert_eq!(cause(&error), "busy", "{error}");
        assert!(error.to_string().contains("not judged") && rig.sim.flash() == new, "{error}");
        let shown = rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it answers");
        assert!(shown.contains("Board Offset"), "{shown}");
        rig.dataflash.decide(&mut rig.gauge, decision, Duration::ZERO).expect("no fault");
        assert_eq!(rig.sim.flash() == new, kept, "{decision:?}");
        assert_eq!(rig.sim.flash() == old, !kept, "{decision:?}");
        assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
    }
}

/// The gauge stores its result at the end of a measurement, which would undo what was put back before.
#[test]
fn an_offset_that_is_still_measured_is_not_settled_yet() {
    let folder = Folder::new("still-measured");
    let case = || {
        let knobs = &[("board_offset_ma", "8")];
        Case { chip: "bq34z100-g1", knobs, job: Job::BoardOffset, found: Seal::Sealed }.rig()
    };
    let old = case().sim.flash();
    let is_running = |rig: &mut Rig| rig.gauge.control_status().expect("it answers").1 & 0x0C00 != 0;
    let mut at = 0;
    let mut rig = loop {
        at += 1;
        let mut rig = case();
        let _ = std::fs::remove_dir_all(folder.path());
        let (done, _) = host(&rig, &folder, Some((at, true)), |dataflash, gauge| {
            run(dataflash, gauge, &Job::BoardOffset, Duration::ZERO, &mut |_| {})
        });
        assert!(done.is_none(), "it never measures");
        if is_running(&mut rig) {
            break rig;
        }
    };
    rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
    let error = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect_err("it measures");
    assert!(cause(&error) == "not-now" && error.to_string().contains("still measures its offset"), "{error}");
    rig.clock.sleep(Duration::from_secs(20));
    rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("it is over");
    assert_eq!((rig.sim.flash() == old, rig.seal(), folder.files()), (true, Seal::Sealed, vec![]));
}

/// A gauge shows no voltage for up to two seconds after a reset.
#[test]
fn three_measurements_that_agree_are_enough() {
    // The first reading after the reset may come before its first measurement.
    for (noise, first_ms, readings) in [("0", "0", [3, 3]), ("0", "2000", [3, 4]), ("3", "0", [8, 8])] {
        let mut rig = Rig::new("bq34z100-g1");
        for (knob, text) in [("noise_mv", noise), ("first_ms", first_ms)] {
            rig.sim.set(knob, text).expect("a knob");
        }
        rig.clock.sleep(Duration::from_secs(3));
        let begun = rig.clock.now();
        let job = Job::Voltage(3932.0);
        let text = run(&mut rig.dataflash, &mut rig.gauge, &job, Duration::ZERO, &mut |_| {})
            .unwrap_or_else(|error| panic!("{noise} mV, {first_ms} ms: {error}"));
        let took = rig.clock.now() - begun;
        println!("{noise} mV, {first_ms} ms: {took:?}: {text}");
        let most = if readings[0] == 3 { 7500 } else { 13_000 };
        let (first, last) = text.split_once(" before, ").expect("both");
        for (text, readings) in [first, last].into_iter().zip(readings) {
            assert!(text.contains(&format!("({readings} readings")), "{first_ms} ms: {text}");
        }
        assert!(took < Duration::from_millis(most), "{took:?}: {text}");
        let mut voltage = [0; 2];
        rig.gauge.read(0x08, &mut voltage).expect("it answers");
        assert!(u16::from_le_bytes(voltage).abs_diff(3932) <= 10, "{voltage:?}: {text}");
    }
}
