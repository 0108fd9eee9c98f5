// SPDX-License-Identifier: MIT

//! The host loses power before or after each transfer of a write, and starts again. Data flash then holds the
//! old values or the new ones, no other byte has changed, the gauge is in the seal state in which it was found,
//! and nothing is left to settle.

use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use gauge_sim::Sim;
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{DataFlash, Limits};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause};
use crate::room::{CASES, Case, Folder, host, one_in, restart};

/// Checks that flash is old or new, sealed if found sealed, and nothing is left to settle. Returns whether it is new.
fn check(case: &Case, rig: &mut Rig, folder: &Folder, (old, new): &(Vec<u8>, Vec<u8>), at: &str) -> bool {
    let flash = rig.sim.flash();
    assert!(flash == *old || flash == *new, "{at}: neither old nor new");
    rig.clock.sleep(Duration::from_secs(3));
    assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{at}");
    let seal = rig.seal();
    // A reset seals a gauge, which is then opened no further than settling needs.
    assert!(seal == case.found || seal == Seal::Sealed || case.found == Seal::FullAccess, "{at}: {seal:?}");
    assert_eq!(folder.files(), Vec::<String>::new(), "{at}");
    flash == *new
}

#[test]
pub(crate) fn host_power_loss_at_any_transfer_leaves_old_or_new_values() {
    let (mut runs, mut nothing, mut undone, mut finished, mut again) = (0, 0, 0, 0, 0);
    for case in CASES {
        let model = case.model();
        let folder = Folder::new("cuts");
        let write = |rig: &Rig, cut| {
            let changes = case.changes(rig);
            host(rig, &folder, cut, |dataflash, gauge| dataflash.write(gauge, &changes, Duration::ZERO))
        };
        let (said, transfers) = write(&case.rig(), None);
        said.expect("no cut").expect("no fault");
        assert_eq!(folder.files(), Vec::<String>::new());
        for (number, after) in one_in(5, (1..=transfers).flat_map(|number| [(number, false), (number, true)]))
        {
            let at = format!("{}, cut at {number} of {transfers}, after it: {after}", case.name());
            let mut rig = case.rig();
            let (said, _) = write(&rig, Some((number, after)));
            assert!(said.is_none(), "{at}: {said:?}");
            rig.clock.sleep(Duration::from_secs(if number % 2 == 0 { 5 } else { 300 }));
            let before = rig.sim.flash();
            let (told, settling) = restart(&rig, &folder, None);
            runs += 1;
            let is_new = check(case, &mut rig, &folder, &model, &at);
            match told.expect("no cut") {
                None => nothing += 1,
                Some(_) if is_new => finished += 1,
                Some(_) => undone += 1,
            }
            // The host loses power again at some transfers of the second start; the third start is not interrupted.
            for second in (number % 7 + 1..=settling).step_by(7) {
                let at = format!("{at}, and again at {second} of {settling}");
                let mut rig = case.rig();
                write(&rig, Some((number, after)));
                rig.clock.sleep(Duration::from_secs(5));
                assert!(rig.sim.flash() == before || number % 2 == 1, "{at}");
                restart(&rig, &folder, Some((second, second % 2 == 0)));
                rig.clock.sleep(Duration::from_secs(5));
                restart(&rig, &folder, None);
                check(case, &mut rig, &folder, &model, &at);
                again += 1;
            }
        }
    }
    println!(
        "{runs} power cuts of the host: {nothing} before there was anything to settle, {undone} settled to \
         the old values, {finished} finished; {again} more with a second cut while that was done"
    );
}

/// A host that is back at once meets a commit that is still at work, during which the gauge answers with what was there
/// before.
#[test]
fn regression_a_commit_at_work_was_taken_for_the_old_values() {
    let mut runs = 0;
    for case in
        CASES.iter().filter(|case| Chip::by_name(case.chip).is_some_and(|chip| chip.volatile.is_none()))
    {
        let model = case.model();
        let folder = Folder::new("at-once");
        let write = |cut| {
            let rig = case.rig();
            rig.sim.set("commit_ms", "218").expect("a knob");
            rig.sim.set("commit_busy", "old").expect("a knob");
            let changes = case.changes(&rig);
            let (said, transfers) =
                host(&rig, &folder, cut, |dataflash, gauge| dataflash.write(gauge, &changes, Duration::ZERO));
            (rig, said, transfers)
        };
        let (_, said, transfers) = write(None);
        said.expect("no cut").expect("no fault");
        for (number, after) in (1..=transfers).flat_map(|number| [(number, false), (number, true)]) {
            let at = format!("{}, cut at {number} of {transfers}, after it: {after}", case.name());
            let (mut rig, _, _) = write(Some((number, after)));
            restart(&rig, &folder, None);
            check(case, &mut rig, &folder, &model, &at);
            runs += 1;
        }
    }
    assert!(runs > 300, "{runs} runs");
}

/// The journal of a write that cannot be settled yet is kept.
#[test]
fn regression_a_journal_is_kept_until_settling_succeeds() {
    let case = &CASES[0];
    let (old, new) = case.model();
    let folder = Folder::new("kept");
    let mut rig = case.rig();
    let changes = case.changes(&rig);
    let write =
        |dataflash: &mut DataFlash, gauge: &mut Gauge| dataflash.write(gauge, &changes, Duration::ZERO);
    let (_, transfers) = host(&case.rig(), &folder, None, write);
    host(&rig, &folder, Some((transfers * 2 / 3, true)), write);
    // The gauge loses power as well, and is sealed when it is back.
    rig.sim.set("power", "off").expect("a knob");
    rig.sim.set("power", "on").expect("a knob");
    rig.clock.sleep(Duration::from_secs(5));
    let kept = folder.files();
    assert_eq!(kept.len(), 1, "{kept:?}");
    // Without a key, then with a gauge that does not answer, then with a bus on which every transfer fails.
    for fault in ["no key", "power", "noise"] {
        let keys = if fault == "no key" { Keys::none() } else { Keys::default() };
        let mut gauge = Gauge::new(rig.gauge.chip, Box::new(rig.sim.bus()), rig.clock.clone(), keys);
        match fault {
            "power" => rig.sim.set("power", "off").expect("a knob"),
            "noise" => rig.sim.set("fault", "random 1000").expect("a knob"),
            _ => {}
        }
        let mut dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
        let outcome = dataflash.settle(&mut gauge, Duration::ZERO);
        rig.sim.set("power", "on").expect("a knob");
        rig.sim.set("fault", "none").expect("a knob");
        rig.clock.sleep(Duration::from_secs(5));
        outcome.expect_err(fault);
        assert_eq!(folder.files(), kept, "{fault}");
    }
    assert!(restart(&rig, &folder, None).0.expect("no cut").is_some());
    check(case, &mut rig, &folder, &(old, new), "settled at last");
}

/// A bus on which the gauge's voltage drops below the flash-update limit at a given transfer.
struct Sinks<B> {
    bus: B,
    sim: Sim,
    /// Transfers that are left before the drop.
    left: u64,
}

impl<B: Bus> Bus for Sinks<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.left = self.left.saturating_sub(1);
        if self.left == 0 {
            self.sim.set("voltage_mv", "2000").expect("a knob");
        }
        self.bus.transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.bus)
    }
}

/// From a given transfer on, the gauge acknowledges everything and stores nothing, not even the old values put back.
#[test]
fn a_voltage_drop_at_any_transfer_causes_no_false_success() {
    let (mut runs, mut done, mut refused, mut back, mut unknown) = (0, 0, 0, 0, 0);
    for case in CASES.iter().filter(|case| Chip::by_name(case.chip).is_some_and(|chip| chip.gate.is_some())) {
        let (old, new) = case.model();
        let folder = Folder::new("voltage");
        let (said, transfers) = {
            let rig = case.rig();
            let changes = case.changes(&rig);
            host(&rig, &folder, None, |dataflash, gauge| dataflash.write(gauge, &changes, Duration::ZERO))
        };
        said.expect("no cut").expect("no fault");
        for left in 1..=transfers {
            let at = format!("{}, sinks at {left} of {transfers}", case.name());
            let mut rig = case.rig();
            let changes = case.changes(&rig);
            let bus = Sinks { bus: rig.sim.bus(), sim: rig.sim.clone(), left };
            let mut gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), Keys::default());
            let mut dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
            let outcome = dataflash.write(&mut gauge, &changes, Duration::ZERO);
            runs += 1;
            let flash = rig.sim.flash();
            match outcome.map_err(|error| cause(&error)) {
                Ok(_) => {
                    done += 1;
                    assert!(flash == new, "{at}: success is false");
                }
                Err("state-unknown") => unknown += 1,
                Err(cause) => {
                    *(if cause == "rolled-back" { &mut back } else { &mut refused }) += 1;
                    assert!(flash == old, "{at}: {cause}, but data flash has changed");
                }
            }
            rig.sim.set("voltage_mv", "auto").expect("a knob");
            rig.clock.sleep(Duration::from_secs(5));
            drop(dataflash);
            restart(&rig, &folder, None);
            check(case, &mut rig, &folder, &(old.clone(), new.clone()), &at);
        }
    }
    println!(
        "{runs} times the voltage sank: {done} done before it did, {refused} refused with nothing changed, {back} \
         with the old bytes there, {unknown} unknown, said so, and settled when it was back"
    );
}

/// The gauge loses power while it programs a block, and is back after the write has failed.
#[test]
fn an_unknown_outcome_is_settled_at_the_next_start() {
    for (torn, settled) in [("torn-commit 1", "3000"), ("torn-commit 5", "3000"), ("torn-commit 40", "3100")]
    {
        let folder = Folder::new("torn");
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        let change = rig.change(80, 53, "3100");
        let expected = rig.change(80, 53, settled).bytes().to_vec();
        rig.sim.set("fault", torn).expect("a fault");
        let write = |cut| {
            host(&rig, &folder, cut, |dataflash, gauge| {
                dataflash.write(gauge, std::slice::from_ref(&change), Duration::ZERO)
            })
        };
        let (said, _) = write(None);
        assert_eq!(cause(&said.expect("no cut").expect_err("a torn block")), "state-unknown", "{torn}");
        assert_eq!(folder.files().len(), 1, "{torn}: the journal stays");
        rig.sim.set("fault", "none").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(3));
        let (told, _) = restart(&rig, &folder, None);
        assert!(told.flatten().is_some(), "{torn}");
        assert_eq!(rig.read(80, 53).expect("the default key"), expected, "{torn}");
        assert_eq!(rig.seal(), Seal::Sealed);
        assert_eq!(folder.files(), Vec::<String>::new());
    }
}
