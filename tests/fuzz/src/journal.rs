// SPDX-License-Identifier: MIT

//! Journals, settled on a simulated gauge: `ti_gauge::journal` and `ti_gauge::dataflash`.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_sim::{Options, Sim};
use sha1::{Digest as _, Sha1};
use ti_gauge::chip::{Chip, FLAT};
use ti_gauge::dataflash::{DataFlash, Decision, Limits};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::keys::Keys;
use ti_gauge::text;

use crate::disk::Memory;

/// A request is answered within this time.
const LIMIT: Duration = Duration::from_secs(30);
/// In an input, a line `end *` stands for the right sum.
const SUM: &str = "\nend *\n";

pub(crate) fn run(input: &[u8]) {
    let input = with_sum(input);
    let named = ["bq27441-g1", "bq34110", "bq35100"].into_iter().find(|name| {
        let part = format!("\npart {name} ");
        input.windows(part.len()).any(|window| window == part.as_bytes())
    });
    let name = named.unwrap_or("bq34z100-g1");
    for decision in [None, Some(Decision::Undo(None)), Some(Decision::Finish(None))] {
        settle(name, &input, decision);
    }
}

fn settle(name: &str, input: &[u8], decision: Option<Decision>) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(name, &Options::default(), clock.clone()).expect("a chip that is simulated");
    clock.sleep(Duration::from_secs(1));
    let chip = Chip::by_name(name).expect("a chip in the tables");
    // A pack that is distinguished from others as the kept inputs have it.
    let (subclass, offset) = match chip.preflight.marks {
        [(FLAT, _), ..] => (FLAT, 0x400d - 0x4000),
        _ if chip.name == "bq34z100-g1" => (104, 11),
        _ => (104, 1),
    };
    sim.set_flash(subclass.into(), offset, &[3]);
    let mut gauge = Gauge::new(chip, Box::new(sim.bus()), clock.clone(), Keys::default());
    let disk = Memory::default();
    let journal = disk.journal();
    let path = journal.path();
    disk.put(path.clone(), input);
    let mut dataflash = DataFlash::new(Limits::default(), Some(journal));
    let before = sim.flash();
    let settled = match decision {
        None => dataflash.settle(&mut gauge, Duration::ZERO).map(drop),
        Some(decision) => dataflash.decide(&mut gauge, decision, Duration::ZERO).map(drop),
    };
    assert!(clock.now() <= LIMIT, "settling took {:?}", clock.now());
    let left = disk.get(&path);
    assert_eq!(settled.is_ok(), left.is_none(), "{settled:?}, but the journal is {left:?}");
    assert_eq!(settled.is_ok(), dataflash.owed().is_none(), "{settled:?}");
    if !input.windows(5).any(|window| window == b"\nend ") {
        assert!(sim.flash() == before, "nothing had been planned");
    }
    let seal = gauge.seal().expect("the gauge answers");
    if settled.is_ok() && input.windows(13).any(|window| window == b"\nfound sealed") {
        assert_eq!(seal, Seal::Sealed);
    }
    // Whatever a journal says, no key changes.
    gauge.wait(Duration::from_secs(60));
    gauge.go_to(Seal::Unsealed).expect("the default key");
}

fn with_sum(input: &[u8]) -> Vec<u8> {
    let whole = std::str::from_utf8(input).ok();
    let Some((plan, rest)) = whole.and_then(|text| text.split_once(SUM)) else { return input.to_vec() };
    // The plan begins below the fourth line.
    let start: usize = plan.split_inclusive('\n').take(4).map(str::len).sum();
    let sum = text::hex(&Sha1::digest(format!("{}\n", &plan[start..])));
    format!("{plan}\nend {sum}\n{rest}").into_bytes()
}
