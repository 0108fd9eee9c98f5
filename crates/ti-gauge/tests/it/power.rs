// SPDX-License-Identifier: MIT

//! The host loses power at each transfer of a write and at each call of the journal's file system, and its disk
//! keeps only what was synced. Of everything else any part may be there.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{Change, DataFlash};
use ti_gauge::error::Result;
use ti_gauge::gauge::{Gauge, Seal};

use crate::rig::Rig;
use crate::room::{Case, State, on_disk, one_in};

/// Two blocks with and without a reset, on a part with subclasses and on one with flat addresses.
const CASES: &[Case] = &[
    Case { chip: "bq34z100-g1", values: &[((48, 11), "2200"), ((80, 53), "3100")], found: Seal::Sealed },
    Case { chip: "bq34z100-g1", values: &[((58, 3), "0x5a")], found: Seal::Unsealed },
    Case { chip: "bq28z610", values: &[((FLAT, 0x4202), "40"), ((FLAT, 0x4618), "7")], found: Seal::Sealed },
    Case {
        chip: "bq34110",
        values: &[((FLAT, 0x41F5), "3100"), ((FLAT, 0x40D7), "0x000b")],
        found: Seal::Sealed,
    },
];

/// Outcomes of a power cut that are tried besides that everything, or nothing, reached the disk.
const OUTCOMES: u64 = 8;

/// The outcomes of a power cut that are tried: everything is on disk, nothing is, and some of it.
fn outcomes(disk: &State) -> Vec<State> {
    if disk.is_synced() {
        return vec![disk.clone()];
    }
    let mut left = vec![disk.after_cut(|| false), disk.after_cut(|| true)];
    for seed in 1..=OUTCOMES {
        // xorshift64
        let mut random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        left.push(disk.after_cut(|| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random >> 63 == 1
        }));
    }
    left
}

/// Reads the subclasses of what is written.
fn read(dataflash: &mut DataFlash, gauge: &mut Gauge, changes: &[Change]) -> Result<()> {
    changes.iter().try_for_each(|change| {
        let (subclass, _) = change.row().expect("a parameter");
        dataflash.read(gauge, &[subclass], Duration::ZERO).map(drop)
    })
}

/// A write and its restart, with cuts at given places.
struct Story<'a> {
    case: &'a Case,
    model: (Vec<u8>, Vec<u8>),
    disk: State,
    /// What is written was read before, so that its plan is foreseen.
    is_known: bool,
}

impl Story<'_> {
    fn write(&self, rig: &Rig, cut: Option<(u64, bool)>) -> (Option<()>, u64, State) {
        let changes = self.case.changes(rig);
        let (said, calls, disk) = on_disk(rig, self.disk.clone(), cut, |dataflash, gauge| {
            if self.is_known {
                read(dataflash, gauge, &changes)?;
            }
            dataflash.write(gauge, &changes, Duration::ZERO)
        });
        (said.map(|said| drop(said.expect("no fault"))), calls, disk)
    }

    /// Starts again with what is left on the disk. Nothing but a loss of power may keep that from settling the write.
    fn restart(&self, rig: &Rig, disk: State, cut: Option<(u64, bool)>, at: &str) -> (bool, u64, State) {
        let (said, calls, disk) =
            on_disk(rig, disk, cut, |dataflash, gauge| dataflash.settle(gauge, Duration::ZERO));
        let told = said.map(|said| said.unwrap_or_else(|error| panic!("{at}: {error}")));
        (told.flatten().is_some(), calls, disk)
    }

    /// Flash holds the old values or the new ones, the gauge is sealed if it was, and nothing is left to settle.
    fn check(&self, rig: &mut Rig, disk: &State, at: &str) {
        let flash = rig.sim.flash();
        assert!(flash == self.model.0 || flash == self.model.1, "{at}: neither old nor new");
        rig.clock.sleep(Duration::from_secs(3));
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{at}");
        let (seal, found) = (rig.seal(), self.case.found);
        assert!(seal == found || seal == Seal::Sealed || found == Seal::FullAccess, "{at}: {seal:?}");
        // What a cut leaves of a file that was not renamed yet is replaced by the next write.
        assert_eq!(disk.journal(), None, "{at}");
    }
}

#[test]
pub(crate) fn a_host_power_cut_that_loses_what_was_not_synced_leaves_old_or_new_values() {
    let (mut runs, mut lossy, mut again) = (0, 0, 0);
    let stories = CASES.iter().flat_map(|case| {
        let first = Story { case, model: case.model(), disk: State::default(), is_known: false };
        // The file of that write is used again.
        let disk = first.write(&case.rig(), None).2;
        let later = Story { case, model: case.model(), disk, is_known: true };
        [first, later]
    });
    for story in stories {
        let case = story.case;
        let (said, calls, disk) = story.write(&case.rig(), None);
        assert!(said.is_some());
        for left in outcomes(&disk) {
            let at = format!("{}, known: {}, cut after the answer", case.name(), story.is_known);
            let mut rig = case.rig();
            story.write(&rig, None);
            let (told, _, settled) = story.restart(&rig, left, None, &at);
            assert!(!told, "{at}: a finished write is settled again");
            story.check(&mut rig, &settled, &at);
        }
        for (number, after) in one_in(12, (1..=calls).flat_map(|number| [(number, false), (number, true)])) {
            let at = format!(
                "{}, known: {}, cut at {number} of {calls}, after it: {after}",
                case.name(),
                story.is_known
            );
            let (said, _, disk) = story.write(&case.rig(), Some((number, after)));
            assert!(said.is_none(), "{at}");
            lossy += u64::from(!disk.is_synced());
            for (which, left) in outcomes(&disk).into_iter().enumerate() {
                let at = format!("{at}, outcome {which}");
                let mut rig = case.rig();
                story.write(&rig, Some((number, after)));
                rig.clock.sleep(Duration::from_secs(5));
                let (_, settling, settled) = story.restart(&rig, left.clone(), None, &at);
                story.check(&mut rig, &settled, &at);
                runs += 1;
                // A second cut, at some of the calls of the second start.
                for second in (number % 7 + 1..=settling).step_by(7) {
                    let at = format!("{at}, and again at {second} of {settling}");
                    let cut = Some((second, second % 2 == 0));
                    let rig = case.rig();
                    story.write(&rig, Some((number, after)));
                    rig.clock.sleep(Duration::from_secs(5));
                    let disk = story.restart(&rig, left.clone(), cut, &at).2;
                    for last in outcomes(&disk) {
                        let mut rig = case.rig();
                        story.write(&rig, Some((number, after)));
                        rig.clock.sleep(Duration::from_secs(5));
                        story.restart(&rig, left.clone(), cut, &at);
                        rig.clock.sleep(Duration::from_secs(5));
                        let (_, _, settled) = story.restart(&rig, last, None, &at);
                        story.check(&mut rig, &settled, &at);
                        again += 1;
                    }
                }
            }
        }
    }
    println!(
        "{runs} power cuts, {lossy} of them with something that was not synced; {again} more with a second one"
    );
}

/// Another program has written beside the value since it was read.
#[test]
fn a_plan_that_has_come_otherwise_is_the_one_that_counts() {
    let case = &CASES[0];
    let (mut runs, mut done, mut undecided) = (0, 0, 0);
    let write = |cut| {
        let rig = case.rig();
        let changes = case.changes(&rig);
        let said = on_disk(&rig, State::default(), cut, |dataflash, gauge| {
            read(dataflash, gauge, &changes)?;
            rig.sim.set_flash(48, 15, &(-300_i16).to_be_bytes());
            dataflash.write(gauge, &changes, Duration::ZERO)
        });
        (rig, said)
    };
    let (rig, (said, calls, _)) = write(None);
    said.expect("no cut").expect("no fault");
    let new = rig.sim.flash();
    let rig = case.rig();
    rig.sim.set_flash(48, 15, &(-300_i16).to_be_bytes());
    let model = (rig.sim.flash(), new);
    let other = case.rig();
    let changes = case.changes(&other);
    let reading =
        on_disk(&other, State::default(), None, |dataflash, gauge| read(dataflash, gauge, &changes));
    let story = Story { case, model, disk: State::default(), is_known: true };
    for (number, after) in
        one_in(5, (reading.1 + 1..=calls).flat_map(|number| [(number, false), (number, true)]))
    {
        let at = format!("cut at {number} of {calls}, after it: {after}");
        let (_, (_, _, disk)) = write(Some((number, after)));
        for left in outcomes(&disk) {
            let (mut rig, _) = write(Some((number, after)));
            rig.clock.sleep(Duration::from_secs(5));
            runs += 1;
            // Before the plan that counts is on disk nothing is touched, and what is foreseen does not fit the gauge.
            if rig.sim.flash() == story.model.0 {
                let settle =
                    on_disk(&rig, left, None, |dataflash, gauge| dataflash.settle(gauge, Duration::ZERO));
                undecided += u64::from(settle.0.is_some_and(|settled| settled.is_err()));
                assert!(rig.sim.flash() == story.model.0, "{at}: changed");
                continue;
            }
            let (_, _, settled) = story.restart(&rig, left, None, &at);
            story.check(&mut rig, &settled, &at);
            done += u64::from(rig.sim.flash() == story.model.1);
        }
    }
    assert!(
        done > 0 && undecided > 0 && runs > undecided * 2,
        "{runs} runs, {done} done, {undecided} undecided"
    );
}
