// SPDX-License-Identifier: MIT

//! One wrong bit in each subcommand that gaugefs sends, in turn: it may be another one then. A gauge that is sealed takes few of
//! them, so all gauges here are found open.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::{CHIPS, Chip, Effect};
use ti_gauge::error::Result;
use ti_gauge::gauge::Seal;

use crate::rig::Rig;
use crate::room::one_in;

type Operation = (&'static str, fn(&mut Rig) -> Result<()>);

const OPERATIONS: [Operation; 3] = [
    ("identify", |rig| rig.gauge.identify().map(drop)),
    ("read", |rig| {
        let (id, at) = capacity(rig.gauge.chip);
        rig.read(id, at).map(drop)
    }),
    ("write", |rig| {
        let (id, at) = capacity(rig.gauge.chip);
        rig.write(id, at, "1200").map(drop)
    }),
];

/// The parts whose data flash is written, and the states in which they are found.
fn found() -> impl Iterator<Item = (&'static Chip, Seal)> {
    let chips = CHIPS.iter().filter(|chip| chip.check_proven().is_ok());
    chips.flat_map(|chip| {
        let full = chip.security.full_access.then_some(Seal::FullAccess);
        [Some(Seal::Unsealed), full].into_iter().flatten().map(|seal| (*chip, seal))
    })
}

fn capacity(chip: &Chip) -> (u8, u16) {
    let names =
        ["Design Capacity", "Design Capacity mAh", "Cell Design Capacity mAh", "Cell Design Capacity"];
    let rows =
        chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(|parameter| (row.id, parameter)));
    let mut rows = rows.filter(|(_, parameter)| names.contains(&parameter.name));
    rows.next().map(|(id, parameter)| (id, parameter.offset)).unwrap_or_else(|| panic!("{}", chip.name))
}

/// The subcommands of an operation, with the number of each transfer.
fn sent(chip: &Chip, seal: Seal, run: fn(&mut Rig) -> Result<()>) -> Vec<(usize, u16)> {
    let mut rig = Rig::calibrated(chip.name, seal);
    rig.sim.clear_log();
    run(&mut rig).unwrap_or_else(|error| panic!("{}: no fault: {error}", chip.name));
    let words = rig.sim.log().into_iter().enumerate().filter_map(|(at, record)| match record.write[..] {
        [0x00 | 0x3e, low, high] => Some((at + 1, u16::from_le_bytes([low, high]))),
        _ => None,
    });
    words.filter(|(_, word)| chip.subcommand(*word).is_some()).collect()
}

/// What one wrong bit makes of the subcommands that are sent to an open gauge: what is not a question, by part. Nobody can
/// exclude it, so whoever sends a new one, or adds one to a table, reads here what it is next to.
#[test]
fn what_is_a_bit_away_from_what_is_sent_is_known() {
    let mut found_all = Vec::new();
    for chip in CHIPS.iter().filter(|chip| chip.check_proven().is_ok()) {
        let mut away: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (_, seal) in found().filter(|(found, _)| found.name == chip.name) {
            for (_, word) in OPERATIONS.into_iter().flat_map(|(_, run)| sent(chip, seal, run)) {
                let near = (0..16).filter_map(|bit| chip.subcommand(word ^ 1 << bit));
                for near in near.filter(|known| known.effect != Effect::Answers) {
                    away.entry(near.name).or_default().extend(chip.subcommand(word).map(|sent| sent.name));
                }
            }
        }
        let listed = |sent: &BTreeSet<&str>| sent.iter().copied().collect::<Vec<_>>().join(", ");
        let away: Vec<_> = away.iter().map(|(near, sent)| format!("{near} ({})", listed(sent))).collect();
        found_all.push((chip.name, away.join("; ")));
    }
    for (found, known) in found_all.iter().zip(NEIGHBOURS) {
        assert_eq!((found.0, &*found.1), *known);
    }
    assert_eq!(found_all.len(), NEIGHBOURS.len());
}

/// A subcommand that changes something, and those of which a wrong bit makes it. ENTER_CAL of a bq35100 is ended, and IT_ENABLE
/// for SEALED is told; nothing is sent against the others.
const NEIGHBOURS: &[(&str, &str)] = &[
    (
        "bq34z100-g1",
        "BOARD_OFFSET (CHEM_ID, DEVICE_TYPE); CC_OFFSET (CHEM_ID, FW_VERSION); CC_OFFSET_SAVE \
         (HW_VERSION); ENTER_CAL (DEVICE_TYPE); EXIT_CAL (CONTROL_STATUS); IT_ENABLE (DEVICE_TYPE); \
         OFFSET_CAL (FW_VERSION); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_FULLSLEEP \
         (CONTROL_STATUS)",
    ),
    (
        "bq34z100-r2",
        "BOARD_OFFSET (CHEM_ID, DEVICE_TYPE); CC_OFFSET (CHEM_ID, FW_VERSION); CC_OFFSET_SAVE \
         (HW_VERSION); ENTER_CAL (DEVICE_TYPE); EXIT_CAL (CONTROL_STATUS); IT_ENABLE (DEVICE_TYPE); \
         OFFSET_CAL (FW_VERSION); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_FULLSLEEP \
         (CONTROL_STATUS)",
    ),
    (
        "bq27520-g3",
        "BOARD_OFFSET (CHEM_ID, DEVICE_TYPE); CAL_MODE (CONTROL_STATUS, RESET); CC_INT_OFFSET \
         (CHEM_ID, FW_VERSION); CLEAR_HIBERNATE (FW_VERSION); ENABLE_DLOG (CHEM_ID); IT_DISABLE \
         (HW_VERSION); IT_ENABLE (DEVICE_TYPE); OCV_CMD (CHEM_ID); RESET (DEVICE_TYPE); SEALED \
         (CONTROL_STATUS); SET_HIBERNATE (DEVICE_TYPE); SET_SLEEP+ (HW_VERSION); WRITE_CC_OFFSET \
         (HW_VERSION)",
    ),
    (
        "bq27500",
        "CAL_MODE (CONTROL_STATUS, RESET); CLEAR_HIBERNATE (FW_VERSION); IT_ENABLE (DEVICE_TYPE); \
         RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_HIBERNATE (DEVICE_TYPE)",
    ),
    (
        "bq27500-v130",
        "CAL_MODE (CONTROL_STATUS, RESET); CLEAR_HIBERNATE (FW_VERSION); IT_ENABLE (DEVICE_TYPE); \
         RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_HIBERNATE (DEVICE_TYPE)",
    ),
    (
        "bq27742-g1",
        "IT_ENABLE (DEVICE_TYPE); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_SHUTDOWN \
         (HW_VERSION)",
    ),
    (
        "bq27441-g1",
        "BAT_INSERT (CHEM_ID, DM_CODE); CLEAR_HIBERNATE (FW_VERSION, SET_CFGUPDATE); EXIT_CFGUPDATE \
         (SOFT_RESET); EXIT_RESIM (DM_CODE); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); \
         SET_HIBERNATE (DEVICE_TYPE, SET_CFGUPDATE); SHUTDOWN_ENABLE (SET_CFGUPDATE); SOFT_RESET \
         (FW_VERSION)",
    ),
    (
        "bq27421-g1",
        "BAT_INSERT (CHEM_ID, DM_CODE); CLEAR_HIBERNATE (FW_VERSION, SET_CFGUPDATE); EXIT_CFGUPDATE \
         (SOFT_RESET); EXIT_RESIM (DM_CODE); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); \
         SET_HIBERNATE (DEVICE_TYPE, SET_CFGUPDATE); SHUTDOWN_ENABLE (SET_CFGUPDATE); SOFT_RESET \
         (FW_VERSION)",
    ),
    (
        "bq27426",
        "BAT_INSERT (CHEM_ID, DM_CODE); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); \
         SHUTDOWN_ENABLE (SET_CFGUPDATE); SOFT_RESET (FW_VERSION)",
    ),
    (
        "bq27427",
        "BAT_INSERT (CHEM_ID, DM_CODE); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); \
         SHUTDOWN_ENABLE (SET_CFGUPDATE); SOFT_RESET (FW_VERSION)",
    ),
    (
        "bq27220",
        "BOARD_OFFSET (DEVICE_NUMBER); CC_OFFSET (FW_VERSION); CC_OFFSET_SAVE (HW_VERSION); \
         ENTER_CAL (DEVICE_NUMBER, EXIT_CFG_UPDATE_REINIT); ENTER_CFG_UPDATE \
         (EXIT_CFG_UPDATE_REINIT); EXIT_CAL (CONTROL_STATUS, ENTER_CFG_UPDATE); EXIT_CFG_UPDATE \
         (ENTER_CFG_UPDATE); EXIT_CFG_UPDATE_REINIT (ENTER_CFG_UPDATE); RESET (DEVICE_NUMBER); \
         SET_SNOOZE (HW_VERSION)",
    ),
    (
        "bq27621-g1",
        "BAT_INSERT (CHEM_ID); CLEAR_HIBERNATE (FW_VERSION, SET_CFGUPDATE); EXIT_CFGUPDATE \
         (SOFT_RESET); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS); SET_HIBERNATE (DEVICE_TYPE, \
         SET_CFGUPDATE); SHUTDOWN_ENABLE (SET_CFGUPDATE); SOFT_RESET (FW_VERSION); TOGGLE_POWERMIN \
         (CONTROL_STATUS)",
    ),
    (
        "bq34110",
        "BOARD_OFFSET (DEVICE_TYPE); CC_OFFSET (FW_VERSION); CC_OFFSET_SAVE (HW_VERSION); EOS_EN \
         (DEVICE_TYPE); IGNORE_SELFDSG_EN (CONTROL_STATUS); LIFETIME_EN (HW_VERSION); \
         PIN_CONTROL_EN (FW_VERSION); RESET (DEVICE_TYPE); SET_SNOOZE (HW_VERSION)",
    ),
    (
        "bq35100",
        "BOARD_OFFSET (DEVICE_TYPE); CC_OFFSET (FW_VERSION); CC_OFFSET_SAVE (HW_VERSION); ENTER_CAL \
         (DEVICE_TYPE); EXIT_CAL (CONTROL_STATUS); GAUGE_START (DEVICE_TYPE); GAUGE_STOP \
         (FW_VERSION); RESET (DEVICE_TYPE); SEALED (CONTROL_STATUS)",
    ),
    ("bq28z610", "FET_CONTROL (FW_VERSION); GAUGING (DEVICE_TYPE); RESET (FW_VERSION)"),
];

/// No mode is left on by a wrong bit, and no gauge is more open than it was found.
#[test]
fn a_wrong_bit_in_a_subcommand_leaves_no_mode_on() {
    let mut runs = 0;
    for (chip, seal) in found() {
        for (name, run) in OPERATIONS {
            let words = sent(chip, seal, run);
            let flips = words.into_iter().flat_map(|(at, word)| (0..16).map(move |bit| (at, word, bit)));
            let all = chip.preflight.slip().is_some();
            for (at, word, bit) in one_in(if all { 1 } else { 4 }, flips) {
                let mut rig = Rig::calibrated(chip.name, seal);
                let fault = format!("flip {at} {} {}", 1 + bit / 8, bit % 8);
                rig.sim.set("fault", &fault).expect("a fault");
                let outcome = run(&mut rig);
                rig.sim.set("fault", "none").expect("a knob");
                rig.clock.sleep(Duration::from_secs(3));
                runs += 1;
                let which = format!("{} {name} {seal:?}: {word:04x} as {:04x}", chip.name, word ^ 1 << bit);
                assert_eq!(rig.get("mode"), "normal", "{which}: {outcome:?}");
                let now = rig.seal();
                assert!([seal, Seal::Sealed].contains(&now), "{which}: {now:?}");
            }
        }
    }
    println!("{runs} wrong bits in subcommands");
}

/// It may be in the middle of a calibration.
#[test]
fn calibration_mode_that_somebody_else_has_begun_is_left_alone() {
    for (name, run) in OPERATIONS {
        let mut rig = Rig::calibrated("bq35100", Seal::Unsealed);
        rig.gauge.command(0x0081).expect("the gauge answers");
        rig.clock.sleep(Duration::from_secs(1));
        assert_eq!(rig.get("mode"), "calibration");
        let outcome = run(&mut rig);
        assert_eq!(rig.get("mode"), "calibration", "{name}: {outcome:?}");
        assert_eq!(
            outcome.is_err_and(|error| error.to_string().contains("calibration mode")),
            name == "write",
            "{name}"
        );
    }
}

/// Whatever does not end it, its state is not called known.
#[test]
fn calibration_mode_that_cannot_be_left_is_told() {
    let mut rig = Rig::calibrated("bq35100", Seal::Unsealed);
    let at = sent(rig.gauge.chip, Seal::Unsealed, OPERATIONS[0].1).into_iter().find(|(_, word)| *word == 1);
    let (at, _) = at.expect("it asks for the type");
    // DEVICE_TYPE becomes ENTER_CAL, and each EXIT_CAL another one.
    let exits: Vec<_> = (1..40).map(|next| format!("flip {} 1 1", at + next)).collect();
    rig.sim.set("fault", &format!("flip {at} 1 7; {}", exits.join("; "))).expect("faults");
    let error = rig.gauge.identify().expect_err("it stays on");
    assert!(error.to_string().contains("calibration mode"), "{error}");
}
