// SPDX-License-Identifier: MIT

//! Changing keys: which keys a gauge accepts afterwards, what is refused before the gauge is touched, and one
//! fault at each transfer in turn.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};
use ti_gauge::authentication::{Order, answer, ask};
use ti_gauge::chip::{CHIPS, FLAT, KeyStorage, Kind};
use ti_gauge::dataflash::{Change, Decision};
use ti_gauge::error::{Cause, Error, Result};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::{KeyChange, Keys, Name, WIPED, WIPED_OF_WORDS};
use ti_gauge::value::Value;

use crate::rig::{Rig, cause};
use crate::room::{Folder, one_in};

const STATES: [Seal; 3] = [Seal::Sealed, Seal::Unsealed, Seal::FullAccess];

/// A change from the default keys.
struct Case {
    chip: &'static str,
    text: &'static str,
    found: Seal,
}

const AUTHENTICATION: &str =
    "authentication 0123456789abcdeffedcba9876543210 8d3eb7c5d1a96f4e70821b3c5a6e9df4";

fn cases() -> Vec<Case> {
    let unseal = "unseal 0414 3672 8d3e b7c5";
    let full_access = "full-access ffff ffff 8d3e b7c5";
    let mut cases = Vec::new();
    for (chip, texts) in [
        ("bq34z100-g1", vec![unseal, full_access, AUTHENTICATION]),
        ("bq34z100-r2", vec![unseal, full_access, AUTHENTICATION]),
        ("bq27520-g3", vec![unseal, full_access]),
        ("bq27500", vec![unseal, full_access]),
        ("bq35100", vec![unseal, full_access]),
    ] {
        for text in texts {
            cases.extend(STATES.map(|found| Case { chip, text, found }));
        }
    }
    cases
}

fn parse(text: &str) -> KeyChange {
    KeyChange::parse(text.as_bytes()).expect("a change")
}

fn run(rig: &mut Rig, text: &str) -> Result<()> {
    rig.dataflash.change_key(&mut rig.gauge, &parse(text), Order::LsbFirst, Duration::ZERO)
}

impl Case {
    fn rig(&self) -> Rig {
        Rig::found(self.chip, self.found)
    }

    fn name(&self) -> String {
        format!("{} {} found {:?}", self.chip, parse(self.text).name.as_str(), self.found)
    }
}

/// Whether another host can open the gauge, from SEALED, with the given key and the manual's defaults for the
/// others.
fn opens(rig: &mut Rig, change: &KeyChange, new: bool) -> bool {
    let key = if new { &change.new } else { &change.old };
    let mut keys = Keys::default();
    keys.set(change.name, key);
    let mut gauge = Gauge::new(rig.gauge.chip, Box::new(rig.sim.bus()), rig.clock.clone(), keys);
    if change.name == Name::Authentication {
        let challenge = *b"a challenge of 20 by";
        let bytes: [u8; 16] = key.bytes().try_into().expect("16 bytes");
        let digest = ask(&mut gauge, &challenge, Order::LsbFirst, Duration::ZERO).expect("a digest");
        return digest == answer(&bytes, &challenge) && goes_up(&mut gauge);
    }
    goes_up(&mut gauge)
}

fn goes_up(gauge: &mut Gauge) -> bool {
    gauge.go_to(Seal::Sealed).is_ok() && gauge.go_to(Seal::FullAccess).is_ok()
}

#[test]
fn after_a_change_only_the_new_key_opens_the_gauge() {
    for case in cases() {
        let at = case.name();
        let mut rig = case.rig();
        let before = rig.sim.flash();
        run(&mut rig, case.text).unwrap_or_else(|error| panic!("{at}: {error}"));
        assert_eq!(rig.seal(), case.found, "{at}");
        let differing = before.iter().zip(rig.sim.flash()).filter(|(old, new)| **old != *new).count();
        assert!((4..=16).contains(&differing), "{at}: {differing} bytes differ");
        // The keys of the mount that made the change are updated.
        rig.gauge.go_to(Seal::Sealed).expect("seals");
        rig.gauge.go_to(Seal::FullAccess).unwrap_or_else(|error| panic!("{at}: {error}"));
        let change = parse(case.text);
        assert!(opens(&mut rig, &change, true), "{at}");
        assert!(!opens(&mut rig, &change, false), "{at}");
        // The change back to the manual's key.
        let back = format!("{} {} {}", change.name.as_str(), &*change.new.text(), &*change.old.text());
        run(&mut rig, &back).unwrap_or_else(|error| panic!("{at}, back: {error}"));
        assert!(rig.sim.flash() == before, "{at}: not the bytes of before");
    }
}

#[test]
fn both_seal_keys_can_be_changed() {
    let mut rig = Rig::new("bq34z100-g1");
    run(&mut rig, "unseal 0414 3672 8d3e b7c5").expect("changed");
    run(&mut rig, "full-access ffff ffff 1a2b 3c4d").expect("changed");
    run(&mut rig, AUTHENTICATION).expect("changed");
    run(&mut rig, "unseal 8d3e b7c5 9999 7777").expect("changed");
    assert_eq!(rig.seal(), Seal::Sealed);
    rig.gauge.go_to(Seal::FullAccess).expect("the keyring follows");
}

/// The bytes on the wire, from SLUSBZ5D 7.3.3.1 and Table 7-11: the key 1234 5678 is stored as 56 78 12 34.
#[test]
fn the_bytes_on_the_wire_match_the_manuals() {
    let bytes = |chip: &str| {
        let mut rig = Rig::new(chip);
        let before = rig.sim.flash();
        run(&mut rig, "unseal 0414 3672 1234 5678").expect("changed");
        let flash = rig.sim.flash();
        let at = before.iter().zip(&flash).position(|(old, new)| old != new).expect("a difference");
        flash[at..at + 4].to_vec()
    };
    assert_eq!(bytes("bq34z100-g1"), [0x56, 0x78, 0x12, 0x34]);
    assert_eq!(bytes("bq27520-g3"), [0x56, 0x78, 0x12, 0x34]);
    assert_eq!(bytes("bq27500"), [0x56, 0x78, 0x12, 0x34]);
    assert_eq!(bytes("bq35100"), [0x12, 0x34, 0x56, 0x78]);
}

/// The change is refused, nothing is written, and the seal state is as found.
#[track_caller]
fn refused(rig: &mut Rig, text: &str, expected: &str, why: &str) {
    let (before, found) = (rig.sim.flash(), rig.seal());
    let error: Error = run(rig, text).expect_err("refused");
    assert_eq!(cause(&error), expected, "{error}");
    assert!(error.to_string().contains(why), "{error}");
    assert!(rig.sim.flash() == before, "{error}");
    assert_eq!(rig.seal(), found, "{error}");
    for key in text.split_whitespace().skip(1) {
        assert!(!error.to_string().contains(key), "{error}");
    }
}

#[test]
fn a_wrong_old_key_changes_nothing_in_any_seal_state() {
    for case in cases() {
        let mut rig = case.rig();
        let change = parse(case.text);
        let wrong = match change.name {
            Name::Authentication => "00112233445566778899aabbccddeeff",
            _ => "7b1c 55d2",
        };
        let text = format!("{} {wrong} {}", change.name.as_str(), &*change.new.text());
        refused(&mut rig, &text, "not-permitted", "key");
    }
}

#[test]
fn a_dangerous_key_is_refused() {
    for (new, why) in [
        ("0000 0000", "zeros or ones"),
        ("1234 0000", "zeros or ones"),
        ("1234 ffff", "zeros or ones"),
        ("ffff ffff", "the other key as well"),
        ("1234 1234", "one word twice"),
        ("1234 0020", "a subcommand"),
        ("0041 1234", "a subcommand"),
        ("0f00 1234", "a subcommand"),
    ] {
        refused(&mut Rig::new("bq34z100-g1"), &format!("unseal 0414 3672 {new}"), "out-of-range", why);
    }
    refused(&mut Rig::new("bq34z100-g1"), "full-access ffff ffff 0414 3672", "out-of-range", "the other key");
    refused(
        &mut Rig::new("bq35100"),
        "unseal 0414 3672 41cc 1234",
        "out-of-range",
        "an address of data flash",
    );
    refused(&mut Rig::new("bq35100"), "unseal 0414 3672 a613 1234", "out-of-range", "a subcommand");
    refused(&mut Rig::new("bq34z100-g1"), "unseal 0414 3672 0414 3672", "invalid", "is the old one");
    let zeros = format!("authentication 0123456789abcdeffedcba9876543210 {}", "00".repeat(16));
    refused(&mut Rig::new("bq34z100-g1"), &zeros, "out-of-range", "sixteen times");
}

#[test]
fn an_undocumented_key_change_is_refused() {
    for (chip, why) in [
        ("bq34110", "no document at hand"),
        ("bq27441-g1", "in ROM"),
        ("bq27421-g1", "in ROM"),
        ("bq27426", "in ROM"),
        ("bq27427", "in ROM"),
        ("bq27621-g1", "in ROM"),
    ] {
        for text in ["unseal 0414 3672 1234 5678", "full-access ffff ffff 1234 5678", AUTHENTICATION] {
            refused(&mut Rig::new(chip), text, "not-permitted", why);
        }
    }
    for chip in ["bq27520-g3", "bq27500", "bq35100"] {
        refused(&mut Rig::new(chip), AUTHENTICATION, "not-permitted", "has no authentication");
    }
}

/// On a part whose keys are at another address than the manual says, as on one owner's bq35100.
#[test]
fn keys_at_another_address_than_documented_are_not_changed() {
    let mut rig = Rig::new("bq35100");
    rig.sim.set("df_shift", "1").expect("a knob");
    let before = rig.sim.flash();
    let error = run(&mut rig, "unseal 0414 3672 1234 5678").expect_err("refused");
    assert!(matches!(cause(&error), "not-permitted" | "gone"), "{error}");
    assert!(rig.sim.flash() == before);
}

/// If both keys read the same in two byte orders, it is unknown which one the gauge uses.
#[test]
fn an_ambiguous_byte_order_is_not_guessed() {
    let options = gauge_sim::Options { unseal_key: Some([0x1212, 0x1212]), ..Default::default() };
    let clock = std::sync::Arc::new(gauge_bus::clock::SimClock::new());
    let sim = gauge_sim::Sim::new("bq34z100-g1", &options, clock.clone()).expect("a chip");
    let keys = Keys::of(Name::Unseal, &[0x1212, 0x1212].into());
    let table = ti_gauge::chip::Chip::by_name("bq34z100-g1").expect("a chip");
    let gauge = Gauge::new(table, Box::new(sim.bus()), clock.clone(), keys);
    clock.sleep(Duration::from_secs(1));
    let mut rig = Rig { clock, sim, gauge, dataflash: Default::default() };
    refused(&mut rig, "unseal 1212 1212 1234 5678", "not-permitted", "order of bytes");
}

#[test]
fn key_blocks_contain_only_keys_according_to_the_tables() {
    for chip in CHIPS {
        let KeyStorage::Flash(block) = &chip.security.storage else { continue };
        assert!(block.length <= 32 && chip.security.full_access, "{}", chip.name);
        let places = [(block.unseal, 4), (block.full_access, 4)];
        for (at, size) in places.into_iter().chain(block.authentication.map(|at| (at, 16))) {
            assert!(at + size <= block.length, "{}", chip.name);
            for offset in (block.start + at as u16..).take(size) {
                let row = chip
                    .subclasses
                    .iter()
                    .filter(|row| row.id == block.subclass)
                    .find(|row| (row.start()..row.start() + row.length).contains(&offset));
                assert_eq!(row.map(|row| row.kind), Some(Kind::Security), "{} {offset}", chip.name);
            }
        }
    }
}

/// No transfer is recorded while the keys are in the data window.
#[test]
fn the_bus_log_contains_no_key() {
    for case in cases() {
        let mut rig = case.rig();
        run(&mut rig, case.text).expect("changed");
        let log = rig.log();
        assert!(log.iter().any(|line| line.contains("; hidden")), "{}", case.name());
        let tight = |text: &str| text.to_lowercase().split(' ').collect::<String>();
        let (all, control) = (tight(&log.join("\n")), log.iter().filter(|line| line.starts_with("W 00")));
        for key in ["8d3eb7c5", "b7c58d3e", "3e8dc5b7", "c5b73e8d", "36720414", "1a96f4e7"] {
            assert!(!all.contains(key), "{}: {key} in\n{}", case.name(), log.join("\n"));
        }
        // A single word is in a random challenge by chance; elsewhere it would be sent to Control().
        for line in control {
            let word = tight(line);
            assert!(!["3e8d", "8d3e", "c5b7", "b7c5"].iter().any(|key| word.contains(key)), "{line}");
        }
    }
}

/// A bus whose host loses power after a number of transfers.
struct Dying<B>(B, u64);

impl<B: Bus> Bus for Dying<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.1 = self.1.checked_sub(1).ok_or(BusError::Gone)?;
        self.0.transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.0)
    }
}

/// The host loses power at any transfer, but the gauge does not; repeating the same change completes it.
#[test]
fn an_interrupted_change_can_be_repeated() {
    let (mut runs, mut begun, mut made) = (0, 0, 0);
    for case in cases() {
        let change = parse(case.text);
        let mut plain = case.rig();
        let before = plain.cost().0;
        run(&mut plain, case.text).expect("no fault");
        for count in 0..plain.cost().0 - before {
            let at = format!("{}, {count} transfers", case.name());
            let rig = case.rig();
            let host =
                |bus: Box<dyn Bus>| Gauge::new(rig.gauge.chip, bus, rig.clock.clone(), Keys::default());
            let dying = host(Box::new(Dying(rig.sim.bus(), count)));
            let after = host(Box::new(rig.sim.bus()));
            let mut dying = Rig { gauge: dying, ..rig };
            run(&mut dying, case.text).expect_err("the host is gone");
            let mut rig = Rig { gauge: after, dataflash: Default::default(), ..dying };
            let found = rig.seal();
            runs += 1;
            begun += u32::from(found != case.found);
            rig.clock.sleep(Duration::from_secs(10));
            run(&mut rig, case.text).unwrap_or_else(|error| panic!("{at}: {error}"));
            assert_eq!(rig.seal(), found, "{at}");
            made += u32::from(opens(&mut rig, &change, true) && !opens(&mut rig, &change, false));
        }
    }
    assert_eq!(made, runs);
    println!(
        "{runs} changes cut short, {begun} with the seal on its way, all made by the same change once more"
    );
}

/// The faults tried for any write, and power cuts while a block is programmed.
fn faults(found: Seal, (n, length): (u64, usize)) -> Vec<String> {
    let mut faults: Vec<String> =
        ["nack", "short", "lost", "stuck", "arbitration"].map(|word| format!("{word} {n}")).into();
    faults.push(format!("stretch {n} 30"));
    for word in ["power-cut", "power-cut-after"] {
        faults.push(format!("{word} {n} 300"));
        if found == Seal::Sealed {
            faults.push(format!("{word} {n}"));
        }
    }
    // The bytes do not depend on the seal state in which the gauge was found.
    let bytes = if found == Seal::Sealed { length } else { 0 };
    for byte in (0..bytes).filter(|&byte| byte < 4 || byte % 9 == 0 || byte + 2 >= length) {
        faults.push(format!("nack {n} {byte}"));
        faults.extend([0, 7].map(|bit| format!("flip {n} {byte} {bit}")));
    }
    faults
}

#[test]
pub(crate) fn a_fault_at_any_transfer_of_a_key_change_causes_no_false_success() {
    let (mut runs, mut succeeded, mut refused, mut rolled_back, mut unknown, mut lost) = (0, 0, 0, 0, 0, 0);
    for case in cases() {
        let change = parse(case.text);
        let mut plain = case.rig();
        plain.sim.clear_log();
        run(&mut plain, case.text).expect("no fault");
        let transfers = plain.sim.log().into_iter().map(|record| record.write.len() + record.read.len());
        let torn = (0..=12).map(|words| format!("torn-commit {words}"));
        let commits = ["drop-commit".into(), "corrupt-commit".into()].into_iter().chain(torn);
        let faults = (1..).zip(transfers).flat_map(|transfer| faults(case.found, transfer));
        for fault in one_in(5, faults).chain(commits) {
            let at = format!("{}, fault `{fault}`", case.name());
            let mut rig = case.rig();
            rig.sim.set("fault", &fault).expect("a fault");
            let asked = rig.clock.now();
            let outcome = run(&mut rig, case.text);
            let answered = rig.clock.now() - asked;
            assert!(answered < Duration::from_secs(180), "{at}: answered after {answered:?}");
            runs += 1;
            rig.sim.set("fault", "none").expect("a knob");
            rig.sim.set("power", "on").expect("a knob");
            rig.clock.sleep(Duration::from_secs(3));
            let interrupted = fault.starts_with("power") || fault.starts_with("torn");
            if !interrupted {
                assert_eq!(rig.seal(), case.found, "{at}: {outcome:?}");
            }
            let (new, old) = (opens(&mut rig, &change, true), opens(&mut rig, &change, false));
            match &outcome {
                Ok(()) => {
                    succeeded += 1;
                    assert!(new && !old, "{at}: success is false: new {new}, old {old}");
                }
                Err(error) if cause(error) == "state-unknown" => {
                    unknown += 1;
                    let is_enabled = error.to_string().contains("as IT_ENABLE");
                    assert!(interrupted || is_enabled, "{at}: {error}");
                    lost += u32::from(!new && !old);
                    // Every such state is recovered by repeating the change with both keys.
                    let mut again = Rig {
                        gauge: Gauge::new(
                            rig.gauge.chip,
                            Box::new(rig.sim.bus()),
                            rig.clock.clone(),
                            Keys::default(),
                        ),
                        ..rig
                    };
                    run(&mut again, case.text)
                        .unwrap_or_else(|second| panic!("{at}: {error}; again: {second}"));
                    assert!(opens(&mut again, &change, true), "{at}: {error}");
                }
                Err(error) => {
                    match error.cause() {
                        Cause::RolledBack => rolled_back += 1,
                        _ => refused += 1,
                    }
                    assert!(old && !new, "{at}: {error}, but new {new}, old {old}");
                }
            }
        }
    }
    println!(
        "{runs} runs with a fault: {succeeded} succeeded, {refused} refused with nothing changed, {rolled_back} put \
         back, {unknown} unknown and said so, {lost} of them with no key that opens"
    );
}

const OWN: &str = "8d3eb7c5d1a96f4e70821b3c5a6e9df4";
const TEARS: [&str; 4] = ["rest-old", "rest-erased", "old", "erased"];

/// A calibrated pack and a host with a journal that knows the keys which the pack has.
fn at_home(chip: &str, folder: &Folder, has_authentication: bool) -> Rig {
    let mut rig = Rig::calibrated(chip, Seal::Sealed);
    restart(&mut rig, folder, has_authentication);
    rig
}

/// Another process, with the keys from before the change.
fn restart(rig: &mut Rig, folder: &Folder, has_authentication: bool) {
    let lines = "authentication = 0123456789abcdeffedcba9876543210";
    let keys =
        Keys::parse("keys", if has_authentication { lines.as_bytes() } else { b"" }, "BAT0").expect("keys");
    rig.start_with(folder, keys, |bus, _, write, read| bus.transfer(write, read));
}

fn texts(chip: &str) -> Vec<&'static str> {
    cases()
        .iter()
        .filter(|case| case.chip == chip && case.found == Seal::Sealed)
        .map(|case| case.text)
        .collect()
}

const WITH_KEYS: [&str; 5] = ["bq34z100-g1", "bq34z100-r2", "bq27520-g3", "bq27500", "bq35100"];

/// The process that has begun the change still knows all keys, whatever the gauge has lost.
#[test]
fn regression_a_gauge_that_loses_its_power_in_a_change_of_keys_loses_its_keys() {
    let folder = Folder::new("keys-gauge");
    let mut undone = 0;
    for (chip, tear) in WITH_KEYS.into_iter().flat_map(|chip| TEARS.map(|tear| (chip, tear))) {
        for (text, words) in texts(chip).into_iter().flat_map(|text| [0, 1, 3].map(|words| (text, words))) {
            let at = format!("{chip} {} {tear} after {words} words", parse(text).name.as_str());
            let mut rig = at_home(chip, &folder, false);
            let before = rig.sim.flash();
            rig.set("tear", tear);
            rig.set("fault", &format!("torn-commit {words}"));
            let error = run(&mut rig, text).expect_err("its power is lost");
            assert_eq!(cause(&error), "state-unknown", "{at}: {error}");
            assert!(error.to_string().contains("gaugefs keys change GAUGE"), "{at}: {error}");
            let owed = rig.dataflash.owed().expect("it is owed");
            assert!(owed.data && !owed.needs_decision, "{at}: {}", owed.why);
            rig.settle().expect_err("it is off");
            rig.set("power", "on");
            rig.pause(3);
            let told = rig.settle().unwrap_or_else(|error| panic!("{at}: {error}")).expect("it is owed");
            assert!(told.contains("the old key was restored"), "{at}: {told}");
            assert!(rig.sim.flash() == before, "{at}: {told}");
            assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
            assert!(rig.dataflash.owed().is_none(), "{at}");
            run(&mut rig, text).unwrap_or_else(|error| panic!("{at}: {error}"));
            undone += 1;
        }
    }
    assert!(undone > 90, "{undone}");
}

/// What is put back does not read back right, again and again: it may be a key that nobody has, so the gauge stays open
/// until it can be put right.
#[test]
fn a_gauge_with_a_key_that_nobody_has_is_not_sealed() {
    let folder = Folder::new("keys-corrupt");
    for chip in ["bq34z100-g1", "bq27520-g3"] {
        for text in texts(chip) {
            let at = format!("{chip} {}", parse(text).name.as_str());
            let mut rig = at_home(chip, &folder, false);
            let before = rig.sim.flash();
            rig.set("tear", "erased");
            rig.set("fault", "torn-commit 1");
            run(&mut rig, text).expect_err("its power is lost");
            rig.set("power", "on");
            rig.pause(3);
            // Every commit is stored with a wrong bit.
            for _ in 0..2 {
                rig.set("fault", &["corrupt-commit"; 60].join(";"));
                rig.settle().expect_err(&at);
                assert_eq!(rig.get("seal"), "full-access", "{at}");
                assert!(rig.dataflash.owed().is_some_and(|owed| owed.data && !owed.needs_decision), "{at}");
            }
            rig.set("fault", "none");
            rig.settle().unwrap_or_else(|error| panic!("{at}: {error}")).expect("it is owed");
            assert!(rig.sim.flash() == before, "{at}");
            assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");

            let mut rig = at_home(chip, &folder, false);
            rig.set("fault", &["corrupt-commit"; 60].join(";"));
            let error = run(&mut rig, text).expect_err("nothing is stored right");
            assert_eq!(cause(&error), "state-unknown", "{at}: {error}");
            assert!(error.to_string().contains("it is left open"), "{at}: {error}");
            assert_eq!(rig.get("seal"), "full-access", "{at}");
            rig.set("fault", "none");
            rig.settle().unwrap_or_else(|error| panic!("{at}: {error}")).expect("it is owed");
            assert!(rig.sim.flash() == before, "{at}");
            assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
        }
    }
}

/// Another process knows only what the journal has, and what a person gives it.
#[test]
fn regression_a_power_cut_in_a_change_of_keys_cannot_be_settled() {
    let folder = Folder::new("keys-both");
    let (mut decided, mut settled, mut lost) = (0, 0, 0);
    for (chip, tear) in WITH_KEYS.into_iter().flat_map(|chip| TEARS.map(|tear| (chip, tear))) {
        for (text, words) in texts(chip).into_iter().flat_map(|text| [0, 1, 3].map(|words| (text, words))) {
            for (undo, has_authentication) in [(false, true), (true, false)] {
                let change = parse(text);
                let name = change.name.as_str();
                let at = format!("{chip} {name} {tear} after {words} words, undo {undo}");
                let mut rig = at_home(chip, &folder, has_authentication);
                let before = rig.sim.flash();
                rig.set("tear", tear);
                rig.set("fault", &format!("torn-commit {words}"));
                run(&mut rig, text).expect_err("its power is lost");
                let journal = folder.text().expect("a journal");
                assert!(journal.contains("\nkeys ordered ") && !journal.contains("8d3e"), "{at}: {journal}");
                restart(&mut rig, &folder, has_authentication);
                rig.set("power", "on");
                rig.pause(12);
                let back = format!("{name} {} {}", &*change.new.text(), &*change.old.text());
                let again = if undo { &back } else { text };
                match rig.arrive() {
                    Ok(told) => {
                        assert!(told.is_some_and(|told| told.contains("the keys of this mount")), "{at}");
                        settled += 1;
                        if undo {
                            assert!(rig.sim.flash() == before, "{at}");
                            continue;
                        }
                    }
                    Err(error) => {
                        let told = error.to_string();
                        assert_eq!(cause(&error), "busy", "{at}: {told}");
                        assert!(told.contains("the gauge has now: unseal key "), "{at}: {told}");
                        assert!(told.contains(&format!("gaugefs keys change GAUGE {name} ")), "{at}: {told}");
                        let is_erased = rig.sim.flash() != before && tear == "erased";
                        assert!(!is_erased || told.contains("unseal key ffff ffff (erased)"), "{at}: {told}");
                        assert!(
                            rig.dataflash.owed().is_some_and(|owed| owed.data && owed.needs_decision),
                            "{at}"
                        );
                        let shown =
                            rig.dataflash.examine(&mut rig.gauge, Duration::ZERO).expect("it is shown");
                        assert!(
                            shown.contains(&format!("the {name} key was about to be written")),
                            "{at}: {shown}"
                        );
                        // Nothing else is written, and no wrong key is sent again and again.
                        let wrong = rig.clock.now();
                        rig.dataflash
                            .decide(&mut rig.gauge, Decision::Finish(None), Duration::ZERO)
                            .expect_err("no keys");
                        let row = rig.gauge.chip.subclasses.iter().find(|row| row.kind != Kind::Security);
                        let row = row.expect("a subclass");
                        let mut others = row.parameters.iter();
                        let one =
                            |one| Change::of_value(rig.gauge.chip, (row, one), &Value::Int(1), true).ok();
                        let other = others.find_map(one).expect("a number that may be 1");
                        assert_eq!(cause(&rig.write_all(&[other]).expect_err("refused")), "busy", "{at}");
                        assert!(rig.clock.now() - wrong < Duration::from_secs(1), "{at}");
                        decided += 1;
                    }
                }
                run(&mut rig, again).unwrap_or_else(|error| panic!("{at}: {error}"));
                if let Some(owed) = rig.dataflash.owed() {
                    assert!(
                        !has_authentication && owed.why.contains("authentication key may have been lost"),
                        "{at}"
                    );
                    lost += 1;
                    let text = format!("authentication {} 0123456789abcdeffedcba9876543210", "f".repeat(32));
                    run(&mut rig, &text).unwrap_or_else(|error| panic!("{at}: {error}"));
                }
                assert!(rig.dataflash.owed().is_none(), "{at}: {:?}", rig.dataflash.owed());
                assert_eq!((rig.get("seal").as_str(), folder.files()), ("sealed", vec![]), "{at}");
                assert!(opens(&mut rig, &change, !undo) && !opens(&mut rig, &change, undo), "{at}");
                if !undo {
                    run(&mut rig, &back).unwrap_or_else(|error| panic!("{at}, back: {error}"));
                }
                let differing = before.iter().zip(rig.sim.flash()).filter(|(old, new)| **old != *new).count();
                // No table of gaugefs says how the authentication key of a bq35100 is set.
                let most = if chip == "bq35100" && tear == "erased" { 12 } else { 0 };
                assert!(differing <= most, "{at}: {differing} bytes differ");
            }
        }
    }
    assert!(decided > 100 && settled > 10 && lost > 10, "{decided} decided, {settled} settled, {lost} lost");
}

/// A pack whose keys are all erased, and nobody knows since when.
#[test]
fn regression_keys_that_are_erased_cannot_be_changed() {
    for chip in WITH_KEYS {
        let mut rig = Rig::calibrated(chip, Seal::Sealed);
        let KeyStorage::Flash(block) = &rig.gauge.chip.security.storage else { panic!("{chip} has keys") };
        let start = usize::from(block.start) - if chip == "bq35100" { 0x4000 } else { 0 };
        let area = if chip == "bq35100" { 0 } else { block.subclass.into() };
        rig.sim.set_flash(area, start, &vec![0xff; block.length]);
        run(&mut rig, "unseal ffff ffff 8d3e b7c5").unwrap_or_else(|error| panic!("{chip}: {error}"));
        run(&mut rig, "full-access ffff ffff 1a2b 3c4d").unwrap_or_else(|error| panic!("{chip}: {error}"));
        if block.authentication.is_some() {
            let text = format!("authentication {} {OWN}", "f".repeat(32));
            run(&mut rig, &text).unwrap_or_else(|error| panic!("{chip}: {error}"));
        }
        let keys = b"unseal = 8d3e b7c5\nfull_access = 1a2b 3c4d";
        let keys = Keys::parse("keys", keys, "BAT0").expect("keys");
        let mut gauge = Gauge::new(rig.gauge.chip, Box::new(rig.sim.bus()), rig.clock.clone(), keys);
        assert!(goes_up(&mut gauge), "{chip}");

        // The full-access key of the owner is one that he gives, and the gauge has ffff ffff as well.
        let mut rig = Rig::calibrated(chip, Seal::Sealed);
        rig.sim.set_flash(area, start, &vec![0xff; block.length]);
        let keys = Keys::parse("keys", b"full_access = 1a2b 3c4d", "BAT0").expect("keys");
        rig.gauge = Gauge::new(rig.gauge.chip, Box::new(rig.sim.bus()), rig.clock.clone(), keys);
        run(&mut rig, "unseal ffff ffff 8d3e b7c5").unwrap_or_else(|error| panic!("{chip}: {error}"));
        run(&mut rig, "full-access ffff ffff 1a2b 3c4d").unwrap_or_else(|error| panic!("{chip}: {error}"));
        assert!(goes_up(&mut rig.gauge), "{chip}");
    }
}

/// A gauge that keeps the bytes of its keys in another order than its manual says. Nothing shows that while they are
/// erased, so it is found out by using the new key, which is not lost then.
struct Turned<B>(B, bool);

impl<B: Bus> Bus for Turned<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        let mut sent = write.to_vec();
        if let [0x3e, class, ..] = write {
            self.1 = *class == 112;
        }
        if let ([0x40..=0x47, ..], true) = (write, self.1) {
            sent[1..].chunks_exact_mut(4).for_each(<[u8]>::reverse);
        }
        self.0.transfer(&sent, read)?;
        if self.1 && write == [0x3e] && read.len() > 10 {
            read[2..10].chunks_exact_mut(4).for_each(<[u8]>::reverse);
        }
        Ok(())
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut self.0)
    }
}

#[test]
fn erased_keys_of_a_gauge_with_another_order_of_bytes_are_not_lost() {
    for text in ["unseal ffff ffff 8d3e b7c5", "full-access ffff ffff 1a2b 3c4d"] {
        let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
        rig.sim.set_flash(112, 0, &[0xff; 8]);
        let keys = Keys::parse("keys", b"unseal = ffff ffff", "BAT0").expect("keys");
        let bus = Turned(rig.sim.bus(), false);
        rig.gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), keys.clone());
        let before = rig.sim.flash();
        let error = run(&mut rig, text).expect_err("another order");
        assert_eq!(cause(&error), "rolled-back", "{error}");
        assert!(rig.sim.flash() == before, "{error}");
        let mut gauge = Gauge::new(rig.gauge.chip, Box::new(rig.sim.bus()), rig.clock.clone(), keys);
        assert!(goes_up(&mut gauge), "{error}");
    }
    // In another order this one would be RESET.
    let mut rig = Rig::calibrated("bq34z100-g1", Seal::Sealed);
    rig.sim.set_flash(112, 0, &[0xff; 8]);
    refused(&mut rig, "unseal ffff ffff 4100 1234", "not-permitted", "change it to some other key first");
}

/// A bus that fails says nothing about a key.
#[test]
fn regression_a_bus_error_in_a_challenge_counts_as_a_wrong_key() {
    let mut plain = Rig::new("bq34z100-g1");
    plain.sim.clear_log();
    run(&mut plain, AUTHENTICATION).expect("no fault");
    let sums = plain.sim.log().iter().map(|record| record.write.first() == Some(&0x54)).collect::<Vec<_>>();
    let at: Vec<_> = (1..).zip(sums).filter(|(_, is_sum)| *is_sum).map(|(number, _)| number).collect();
    assert!(at.len() >= 2, "one challenge before and one after: {at:?}");
    let mut rig = Rig::new("bq34z100-g1");
    let before = rig.sim.flash();
    rig.set("fault", &format!("silence {} 2500", at[0]));
    let error = run(&mut rig, AUTHENTICATION).expect_err("the bus is gone");
    assert!(matches!(cause(&error), "bus" | "timed-out" | "state-unknown"), "{error}");
    assert!(!error.to_string().contains("neither the old key"), "{error}");
    assert!(rig.sim.flash() == before, "{error}");
}

/// On a bq35100 each wrong key locks the gauge for 11 s. Its keys share a row with parameters.
#[test]
fn regression_the_erased_key_is_sent_with_each_retry() {
    let folder = Folder::new("keys-retry");
    let mut rig = at_home("bq35100", &folder, false);
    rig.set("fault", "torn-commit 1");
    rig.write(FLAT, 0x41DB, "2900").expect_err("its power is lost");
    rig.set("power", "on");
    rig.sim.set_flash(0, 0x1CC, &[0x77, 0x11, 0x22, 0x33]);
    restart(&mut rig, &folder, false);
    let mut took = Vec::new();
    for _ in 0..6 {
        rig.pause(30);
        let begun = rig.clock.now();
        rig.settle().expect_err("nobody knows its key");
        took.push((rig.clock.now() - begun).as_secs());
    }
    assert!(took[0] >= 11 && took[2..].iter().all(|took| *took < 2), "{took:?}");
    assert!(rig.dataflash.owed().is_some_and(|owed| owed.data && owed.keys.is_empty()));
}

#[test]
fn regression_another_pack_gets_the_keys_of_an_interrupted_change() {
    let folder = Folder::new("keys-other");
    let text = "unseal 0414 3672 8d3e b7c5";
    let mut rig = at_home("bq34z100-g1", &folder, false);
    rig.set("tear", "erased");
    rig.set("fault", "torn-commit 2");
    run(&mut rig, text).expect_err("its power is lost");
    for restarts in [false, true] {
        if restarts {
            restart(&mut rig, &folder, false);
        }
        rig.set("power", "on");
        // Another pack with the manual's keys takes its place.
        rig.pause(60);
        let erased = rig.sim.flash();
        rig.sim.set_flash(112, 0, &[0x36, 0x72, 0x04, 0x14, 0xff, 0xff, 0xff, 0xff]);
        rig.calibrate(9);
        let other = rig.sim.flash();
        let error = rig.arrive().expect_err("another pack");
        assert!(error.to_string().contains("this is another pack"), "{error}");
        let error = run(&mut rig, text).expect_err("another pack");
        assert!(matches!(cause(&error), "gone" | "busy"), "{error}");
        assert!(rig.sim.flash() == other && folder.text().is_some(), "{error}");
        // The right one is back.
        rig.sim.set_flash(112, 0, &[0xff; 24]);
        rig.calibrate(3);
        assert!(rig.sim.flash() == erased);
    }
}

/// A bus that notes how far down the stack keys come.
struct Deep {
    bus: gauge_sim::SimBus,
    is_secret: bool,
    lowest: Arc<AtomicUsize>,
}

impl Bus for Deep {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let here = 0_u8;
        if self.is_secret {
            self.lowest.fetch_min(std::ptr::from_ref(&here).addr(), Ordering::SeqCst);
        }
        self.bus.transfer(write, read)
    }

    fn set_secret(&mut self, secret: bool) {
        self.is_secret = secret;
        self.bus.set_secret(secret);
    }
}

/// The other half is for the bus. Without optimisation, as a program that takes this crate from crates.io is compiled for its own
/// tests, they come down to 18 KiB of the 24.
#[test]
fn keys_come_no_deeper_than_half_of_what_is_wiped() {
    if !Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml").exists() {
        eprintln!(
            "SKIPPED: this workspace compiles the crate with optimisation, which crates.io cannot ask for"
        );
        return;
    }
    for case in cases() {
        let mut rig = case.rig();
        let lowest = Arc::new(AtomicUsize::new(usize::MAX));
        let bus = Deep { bus: rig.sim.bus(), is_secret: false, lowest: lowest.clone() };
        rig.gauge = Gauge::new(rig.gauge.chip, Box::new(bus), rig.clock.clone(), Keys::default());
        rig.gauge.seal().expect("the gauge answers");
        let here = 0_u8;
        let deep =
            || std::ptr::from_ref(&here).addr().saturating_sub(lowest.swap(usize::MAX, Ordering::SeqCst));
        run(&mut rig, case.text).expect("no fault");
        let changed = deep();
        assert!((1..WIPED / 2).contains(&changed), "{} {}: {changed} bytes", case.chip, case.text);
        rig.gauge.try_key(&parse("unseal 0414 3672 8d3e b7c5").old, Seal::Unsealed).expect("no fault");
        let sent = deep();
        assert!((1..WIPED_OF_WORDS / 2).contains(&sent), "{}: {sent} bytes", case.chip);
    }
}
