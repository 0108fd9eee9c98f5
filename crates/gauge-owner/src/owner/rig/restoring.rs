// SPDX-License-Identifier: MIT

//! How long a gauge with RAM shows nothing after a loss of power, because its profile is written again.

use std::time::Duration;

use super::Rig;
use crate::owner::{Run, Seal, operations};
use gauge_bus::Bus as _;
use gauge_bus::clock::Clock as _;
use ti_gauge::chip::{Chip, Kind, Range, Row};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

/// What a profile usually has: parameters whose names begin so.
const USUAL: &[&str] = &[
    "Design Capacity",
    "Design Energy",
    "Terminate Voltage",
    "Taper ",
    "Qmax Cell 0",
    "R_a0 ",
    "Ra 0",
    "Ra 1",
    "Full Charge Capacity",
];

/// Values that the gauge does not have by itself, for all parameters that may be written or for the usual ones.
pub fn values(chip: &'static Chip, all: bool) -> Vec<Change> {
    let rows = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let is_wanted =
        |(_, row): &Row| !row.unproven && (all || USUAL.iter().any(|name| row.name.starts_with(name)));
    let change = |row: Row| {
        let Range::Int { min, max, .. } = row.1.range else { return None };
        let values = [(min + max) / 2, min + 1, max / 3, 4000, 1800, 12];
        let fits = |value: &i64| Change::of_value(chip, row, &Value::Int(*value), false).ok();
        values.iter().filter(|&&value| (min..=max).contains(&value)).find_map(fits).map(Change::saved)
    };
    rows.filter(is_wanted).filter_map(change).collect()
}

/// A gauge that has lost its power.
#[derive(Clone, Copy, Debug)]
pub struct Lost {
    /// How it is found.
    pub seal: Seal,
    /// What it takes to enter CONFIG UPDATE, and to leave it; `None` for all the time that its manual allows.
    pub ways: Option<Duration>,
}

/// What it took.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Transfers.
    pub transfers: u64,
    /// From the poll that finds the loss until the profile is there.
    pub time: Duration,
}

impl Rig {
    /// Its power is gone for a moment.
    pub fn lose_power(&self) {
        self.sim.set("power", "off").expect("a knob");
        self.sim.set("power", "on").expect("a knob");
    }
}

/// What it takes to write a profile to a gauge that has lost its power; `as_a_write` is what these values take as an
/// ordinary write, beside that. The gauge is left as it was found.
pub fn cost(chip: &'static Chip, changes: &[Change], lost: Lost, as_a_write: bool) -> Cost {
    let profile = if as_a_write { Vec::new() } else { changes.to_vec() };
    let run = Run { profile, ..Run::default() };
    let mut rig = Rig::of(chip.name, run);
    for (knob, time) in ["cfgupdate_ms", "cfgexit_ms"].iter().zip([lost.ways; 2]) {
        if let Some(time) = time {
            rig.sim.set(knob, &time.as_millis().to_string()).expect("a knob");
        }
    }
    rig.start().expect("it answers");
    rig.poll_after(Duration::from_secs(20));
    rig.lose_power();
    rig.clock.sleep(Duration::from_secs(3));
    let mut other = rig.sim.bus();
    let [low, high] = chip.security.seal.to_le_bytes();
    match lost.seal {
        Seal::Sealed => other.transfer(&[0x00, low, high], &mut []).expect("SEALED"),
        Seal::Unsealed | Seal::FullAccess => {
            let Some(key) = rig.default_key(ti_gauge::keys::Name::Unseal) else {
                unreachable!("a default key")
            };
            for word in key.bytes().chunks_exact(2) {
                other.transfer(&[0x00, word[1], word[0]], &mut []).expect("a word of the key");
            }
        }
    }
    rig.clock.sleep(Duration::from_secs(1));
    assert_eq!(rig.sim.get("seal").as_deref(), Some(lost.seal.as_str()), "{}", chip.name);
    if as_a_write {
        rig.poll_after(Duration::ZERO);
    }
    let (begun, transfers) = (rig.clock.now(), rig.transfers());
    match as_a_write {
        true => rig.ask(&operations::WRITE, changes.to_vec()).expect("it is written"),
        // What attributes need of data memory is read afterwards.
        false => {
            rig.owner.update().expect("it answers");
            let owner = &mut *rig.owner;
            owner.memory.keep_configured(&mut owner.access);
        }
    }
    let cost = Cost { transfers: rig.transfers() - transfers, time: rig.clock.now() - begun };
    let published = rig.handle.published();
    assert_eq!(&*published.last_error, "", "{}", chip.name);
    assert_eq!(rig.sim.get("seal").as_deref(), Some(lost.seal.as_str()), "{}", chip.name);
    cost
}

#[cfg(test)]
mod tests {
    use super::*;
    use ti_gauge::chip::CHIPS;

    /// A second each way is the most that a manual allows; the bq27427 is not asked before 1.1 s have passed.
    #[test]
    fn a_usual_profile_is_there_within_two_seconds_and_what_the_gauge_itself_takes_longer() {
        for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
            let changes = values(chip, false);
            for seal in [Seal::Unsealed, Seal::Sealed] {
                let time = |ways| cost(chip, &changes, Lost { seal, ways }, false).time;
                let [longest, half] = [time(None), time(Some(Duration::from_millis(500)))];
                let shown = format!("{} {}: {longest:?}, {half:?}", chip.name, seal.as_str());
                println!("{shown}");
                assert!(longest < Duration::from_millis(2500), "{shown}");
                assert!(half < Duration::from_secs(2), "{shown}");
            }
        }
    }
}
