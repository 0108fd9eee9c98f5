// SPDX-License-Identifier: MIT

//! One fault at each transfer of a write in turn. Afterwards the parameter holds the old or the new value, no
//! other byte has changed, the seal state is as found or the error reports that it is not, and success is never
//! reported falsely. An unknown outcome is settled with the journal when the gauge works again.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::FLAT;
use ti_gauge::dataflash::{DataFlash, Decision, Limits, Outcome};
use ti_gauge::error::Cause;
use ti_gauge::gauge::Seal;

use crate::rig::{Rig, cause};
use crate::room::{Folder, one_in};

/// A write and what it does without a fault.
struct Case {
    chip: &'static str,
    at: (u8, u16),
    text: &'static str,
    found: Seal,
}

const CASES: &[Case] = &[
    Case { chip: "bq34z100-g1", at: (80, 53), text: "3100", found: Seal::Sealed },
    Case { chip: "bq34z100-g1", at: (80, 53), text: "3100", found: Seal::Unsealed },
    Case { chip: "bq34z100-g1", at: (80, 53), text: "3100", found: Seal::FullAccess },
    Case { chip: "bq34z100-g1", at: (48, 31), text: "Pack 7", found: Seal::Sealed },
    Case { chip: "bq34z100-g1", at: (58, 3), text: "0x5a", found: Seal::Sealed },
    Case { chip: "bq34z100-r2", at: (48, 33), text: "Pack 7", found: Seal::Sealed },
    Case { chip: "bq27520-g3", at: (48, 10), text: "1200", found: Seal::Sealed },
    Case { chip: "bq27500", at: (34, 2), text: "4100", found: Seal::Sealed },
    Case { chip: "bq27500-v130", at: (80, 48), text: "3100", found: Seal::Unsealed },
    Case { chip: "bq27742-g1", at: (2, 0), text: "4350", found: Seal::Sealed },
    Case { chip: "bq27441-g1", at: (82, 10), text: "1200", found: Seal::Sealed },
    Case { chip: "bq27441-g1", at: (82, 10), text: "1200", found: Seal::Unsealed },
    Case { chip: "bq27426", at: (82, 6), text: "1200", found: Seal::Sealed },
    Case { chip: "bq27427", at: (82, 6), text: "1200", found: Seal::Sealed },
    Case { chip: "bq27220", at: (FLAT, 0x929F), text: "1200", found: Seal::Sealed },
    Case { chip: "bq27220", at: (FLAT, 0x929F), text: "1200", found: Seal::Unsealed },
    Case { chip: "bq27220", at: (FLAT, 0x929F), text: "1200", found: Seal::FullAccess },
    Case { chip: "bq27621-g1", at: (82, 3), text: "1200", found: Seal::Sealed },
    // Design Capacity mAh, and Mfg Status Init, which needs a reset.
    Case { chip: "bq34110", at: (FLAT, 0x41F5), text: "3100", found: Seal::Sealed },
    Case { chip: "bq34110", at: (FLAT, 0x41F5), text: "3100", found: Seal::Unsealed },
    Case { chip: "bq34110", at: (FLAT, 0x40D7), text: "0x000b", found: Seal::Sealed },
    Case { chip: "bq34110", at: (FLAT, 0x40D7), text: "0x000b", found: Seal::FullAccess },
    // Pack Resistance, and Device Name.
    Case { chip: "bq28z610", at: (FLAT, 0x4202), text: "40", found: Seal::Sealed },
    Case { chip: "bq28z610", at: (FLAT, 0x4202), text: "40", found: Seal::FullAccess },
    Case { chip: "bq28z610", at: (FLAT, 0x4080), text: "Pack 7", found: Seal::Unsealed },
    // Operation Config A, and Cell Design Capacity mAh.
    Case { chip: "bq35100", at: (FLAT, 0x41B1), text: "0x82", found: Seal::Sealed },
    Case { chip: "bq35100", at: (FLAT, 0x41B1), text: "0x82", found: Seal::FullAccess },
    Case { chip: "bq35100", at: (FLAT, 0x41FE), text: "3100", found: Seal::Unsealed },
];

impl Case {
    fn rig(&self) -> Rig {
        Rig::calibrated(self.chip, self.found)
    }

    fn run(&self, rig: &mut Rig) -> ti_gauge::error::Result<Outcome> {
        rig.write(self.at.0, self.at.1, self.text)
    }

    /// Flash before and after a write without a fault, and its number of transfers.
    fn model(&self) -> (Vec<u8>, Vec<u8>, u64) {
        let mut rig = self.rig();
        let old = rig.sim.flash();
        let before = rig.cost().0;
        self.run(&mut rig).expect("no fault");
        (old, rig.sim.flash(), rig.cost().0 - before)
    }

    /// The bytes that survive a power loss unchanged: in RAM, those that are the same in ROM.
    fn kept(&self) -> Vec<bool> {
        let rig = self.rig();
        let old = rig.sim.flash();
        rig.sim.set("power", "off").expect("a knob");
        rig.sim.set("power", "on").expect("a knob");
        old.iter().zip(rig.sim.flash()).map(|(old, new)| *old == new).collect()
    }
}

/// The faults that are tried at transfer `n`. Single bits are changed in the first bytes, which matter most.
fn faults(n: u64) -> Vec<String> {
    let mut faults = vec![
        format!("nack {n}"),
        format!("short {n}"),
        format!("lost {n}"),
        format!("stuck {n}"),
        format!("arbitration {n}"),
        format!("stretch {n} 30"),
        format!("power-cut {n} 300"),
        format!("power-cut-after {n} 300"),
        format!("power-cut {n}"),
        format!("power-cut-after {n}"),
    ];
    // All of them take longer than a test that is run often may; benches/run asks for them.
    let all = std::env::var_os("GAUGEFS_ALL_FAULTS").is_some();
    for byte in 0..36 {
        if all || byte < 4 {
            faults.push(format!("nack {n} {byte}"));
            faults.push(format!("stuck {n} {byte}"));
        }
        for bit in [0, 3, 7] {
            if all || byte < 8 && bit != 3 || byte % 8 == 0 {
                faults.push(format!("flip {n} {byte} {bit}"));
            }
        }
    }
    faults
}

/// Transfers that restore and confirm the seal state, after the last look at data memory: SEALED, and two looks of three
/// transfers where a register of its own shows the state. Where no flag shows that RAM was lost, nothing reveals a loss
/// from then on.
const CLOSING: u64 = 7;

/// Whether a fault takes the power away after transfer `last` of the write.
fn is_power_cut_from(fault: &str, last: u64) -> bool {
    let mut words = fault.split(' ');
    let (kind, at) = (words.next(), words.next().and_then(|at| at.parse::<u64>().ok()));
    match kind {
        Some("power-cut") => at.is_some_and(|at| at > last),
        Some("power-cut-after") => at.is_some_and(|at| at >= last),
        _ => false,
    }
}

/// SEALED with one wrong bit is IT_ENABLE, which sets a bit of Update Status. Nothing can take that back; SEALED is
/// sent again, and the error says so.
fn is_enabled(flash: &[u8], new: &[u8]) -> bool {
    let differ: Vec<_> = flash.iter().zip(new).filter(|(now, new)| now != new).collect();
    matches!(differ[..], [(now, new)] if now ^ new == 0x04)
}

#[test]
pub(crate) fn a_fault_at_any_transfer_of_a_write_causes_no_false_success() {
    let (mut runs, mut succeeded, mut refused, mut rolled_back, mut unknown) = (0, 0, 0, 0, 0);
    let folder = Folder::new("faults");
    for case in CASES {
        let (old, new, transfers) = case.model();
        assert_ne!(old, new);
        let kept = case.kept();
        let commits = ["drop-commit", "corrupt-commit", "torn-commit 0", "torn-commit 1", "torn-commit 5"];
        let faults = one_in(5, (1..=transfers).flat_map(faults)).chain(commits.map(String::from));
        for fault in faults {
            let at = format!("{} {:?} found {:?}, fault `{fault}`", case.chip, case.at, case.found);
            let mut rig = case.rig();
            rig.dataflash = DataFlash::new(Limits::default(), Some(folder.journal()));
            // As when a mount starts.
            rig.dataflash.settle(&mut rig.gauge, Duration::ZERO).expect("nothing to settle");
            rig.sim.set("fault", &fault).expect("a fault");
            let asked = rig.clock.now();
            let outcome = case.run(&mut rig);
            let answered = rig.clock.now() - asked;
            assert!(answered < Duration::from_secs(30), "{at}: answered after {answered:?}");
            runs += 1;
            let mut flash = rig.sim.flash();
            if fault.starts_with("power") || fault.starts_with("torn") {
                for at in (0..flash.len()).filter(|&at| !kept[at]) {
                    flash[at] = old[at];
                }
            }
            let certain = match &outcome {
                // RAM that is lost after the last look at it.
                Ok(_) if fault.starts_with(&format!("power-cut-after {transfers}")) => true,
                Ok(_)
                    if rig.gauge.chip.volatile == Some(0)
                        && is_power_cut_from(&fault, transfers - CLOSING) =>
                {
                    true
                }
                Ok(_) => {
                    succeeded += 1;
                    assert!(flash == new, "{at}: success is false");
                    true
                }
                Err(error) if cause(error) == "state-unknown" => {
                    unknown += 1;
                    false
                }
                Err(error) => {
                    match error.cause() {
                        Cause::RolledBack => rolled_back += 1,
                        _ => refused += 1,
                    }
                    assert!(flash == old, "{at}: {error}, but data flash has changed");
                    true
                }
            };
            // Whatever the result, the rest of the gauge is unchanged.
            if !fault.starts_with("torn") {
                let is_known = flash == old || flash == new || is_enabled(&flash, &new);
                assert!(is_known || !certain, "{at}: neither old nor new");
            }
            rig.sim.set("fault", "none").expect("a knob");
            rig.sim.set("power", "on").expect("a knob");
            rig.clock.sleep(Duration::from_secs(3));
            if !certain {
                rig.gauge.forget_refusal();
                let settled = rig.dataflash.settle(&mut rig.gauge, Duration::ZERO);
                // Where no flag shows that RAM was lost, it may be another pack, and a person decides.
                match settled {
                    Err(error)
                        if rig.gauge.chip.volatile == Some(0)
                            && (fault.starts_with("power") || fault.starts_with("torn")) =>
                    {
                        assert!(
                            error.to_string().contains("or the gauge has lost its power"),
                            "{at}: {error}"
                        );
                        rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it answers");
                        let undone =
                            rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO);
                        undone.expect("the gauge is well again");
                        // The journal waits for the pack that this one seems not to be.
                        let _ = std::fs::remove_dir_all(folder.path());
                    }
                    settled => _ = settled.expect("the gauge is well again"),
                }
                let flash = rig.sim.flash();
                // A lost bit can turn a command into any other, so only the written value is compared. RAM
                // keeps nothing after a power loss.
                let is = |wanted: &[u8]| {
                    (0..flash.len()).all(|at| old[at] == new[at] || !kept[at] || flash[at] == wanted[at])
                };
                assert!(is(&old) || is(&new), "{at}: {outcome:?}, settled to neither old nor new");
                let seal = rig.seal();
                // RAM that has lost its power is as ROM has it, which is UNSEALED.
                let lost = fault.starts_with("power") && rig.gauge.chip.volatile.is_some();
                assert!(
                    seal == case.found || seal == Seal::Sealed || case.found == Seal::FullAccess || lost,
                    "{at}"
                );
            }
            assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"), "{at}: {outcome:?}");
            if certain && !fault.starts_with("power") && !fault.starts_with("torn") {
                assert_eq!(rig.seal(), case.found, "{at}: {outcome:?}");
            }
        }
    }
    println!(
        "{runs} runs with a fault: {succeeded} succeeded, {refused} refused with nothing changed, \
         {rolled_back} rolled back, {unknown} unknown and said so"
    );
}

/// No manual gives the times of the challenge. Whatever they are, and whatever a single reading looks like, what is
/// returned is the digest.
#[test]
pub(crate) fn a_challenge_is_answered_by_slow_and_by_fast_gauges() {
    use ti_gauge::authentication::{Order, answer, ask};

    let key = *b"\x01\x23\x45\x67\x89\xab\xcd\xef\xfe\xdc\xba\x98\x76\x54\x32\x10";
    let challenge = *b"a challenge of 20 by";
    for found in [Seal::Sealed, Seal::Unsealed] {
        for (load, digest) in [("0", "0"), ("20", "30"), ("50", "20"), ("50", "100"), ("0", "150")] {
            let mut rig = Case { chip: "bq34z100-g1", at: (0, 0), text: "", found }.rig();
            for (knob, ms) in [("load_ms", load), ("sealed_load_ms", load), ("auth_ms", digest)] {
                rig.sim.set(knob, ms).expect("a knob");
            }
            let genuine = answer(&key, &challenge);
            let asked = ask(&mut rig.gauge, &challenge, Order::LsbFirst, Duration::ZERO);
            assert_eq!(asked, Ok(genuine), "{load} ms, {digest} ms");
            // A bit error in what the window holds before the digest does not make the challenge the digest.
            let before = rig.cost().0;
            ask(&mut rig.gauge, &challenge, Order::LsbFirst, Duration::ZERO).expect("no fault");
            let transfers = rig.cost().0 - before;
            rig.sim.set("auth_ms", "5000").expect("a knob");
            for at in 1..=transfers {
                rig.sim.set("fault", &format!("flip {at} 0 1")).expect("a fault");
                let asked = ask(&mut rig.gauge, &challenge, Order::LsbFirst, Duration::ZERO);
                assert!(asked.is_err(), "{load} ms, bit error at transfer {at}: {asked:02x?}");
                rig.sim.set("fault", "none").expect("a fault");
                rig.clock.sleep(Duration::from_secs(6));
            }
        }
    }
}

/// A challenge is answered correctly or not at all, nothing is programmed, and the seal state does not change.
#[test]
pub(crate) fn a_fault_at_any_transfer_of_a_challenge_causes_no_false_answer() {
    use ti_gauge::authentication::{Order, answer, ask};

    let key = *b"\x01\x23\x45\x67\x89\xab\xcd\xef\xfe\xdc\xba\x98\x76\x54\x32\x10";
    let challenge = *b"a challenge of 20 by";
    for found in [Seal::Sealed, Seal::Unsealed, Seal::FullAccess] {
        let rig = || Case { chip: "bq34z100-g1", at: (0, 0), text: "", found }.rig();
        let mut plain = rig();
        let before = plain.cost().0;
        let genuine = ask(&mut plain.gauge, &challenge, Order::LsbFirst, Duration::ZERO).expect("no fault");
        assert_eq!(genuine, answer(&key, &challenge));
        let transfers = plain.cost().0 - before;
        let old = plain.sim.flash();
        let (mut right, mut wrong) = (0, Vec::new());
        for fault in one_in(1, (1..=transfers).flat_map(faults)) {
            let mut rig = rig();
            rig.sim.set("fault", &fault).expect("a fault");
            let asked = rig.clock.now();
            let outcome = ask(&mut rig.gauge, &challenge, Order::LsbFirst, Duration::ZERO);
            assert!(rig.clock.now() - asked < Duration::from_secs(30), "`{fault}` takes too long");
            match outcome {
                Ok(digest) if digest == genuine => right += 1,
                Ok(_) => wrong.push(fault.clone()),
                Err(_) => {}
            }
            assert!(rig.sim.flash() == old, "`{fault}` found {found:?}: data flash has changed");
            rig.sim.set("fault", "none").expect("a knob");
            rig.sim.set("power", "on").expect("a knob");
            rig.clock.sleep(Duration::from_secs(3));
            if !fault.starts_with("power") {
                assert_eq!(rig.seal(), found, "`{fault}`");
                rig.read(80, 53).expect("data flash can be read");
            }
        }
        assert!(wrong.is_empty(), "found {found:?}, false answers after {wrong:?}");
        println!("found {found:?}: {right} right answers, the others refused");
    }
}
