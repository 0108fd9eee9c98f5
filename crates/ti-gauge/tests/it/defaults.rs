// SPDX-License-Identifier: MIT

//! The tables and the simulated gauges were written from the manuals independently, and have the same defaults.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::{CHIPS, Chip, Kind, Range};
use ti_gauge::codec;
use ti_gauge::value::Value;

use crate::rig::Rig;

/// The tables and the simulator's bytes, written from the manuals independently, agree on the default of every
/// proven parameter. A difference that is not listed here is a mistake in one of the two.
#[test]
fn defaults_of_the_simulator_match_the_tables() {
    use ti_gauge::chip::{Kind, Range};
    use ti_gauge::codec;
    use ti_gauge::value::Value;

    let intended: &[(&str, u8, u16)] = &[
        // In lower case, as in real parts; the checksum in SLUA790 is right only with it.
        ("bq34z100-g1", 48, 31),
        ("bq34z100-r2", 48, 33),
        // The simulated gauge was sealed by its maker.
        ("bq27441-g1", 82, 2),
        ("bq27421-g1", 82, 2),
        ("bq27426", 82, 2),
        ("bq27427", 82, 2),
    ];
    let chips = [
        "bq34z100-g1",
        "bq34z100-r2",
        "bq27520-g3",
        "bq27500",
        "bq27500-v130",
        "bq27441-g1",
        "bq27421-g1",
        "bq27426",
        "bq27427",
        "bq27621-g1",
    ];
    for chip in chips {
        let mut rig = crate::rig::Rig::new(chip);
        let mut compared = 0;
        let mut differ = Vec::new();
        for subclass in rig.gauge.chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
            let bytes = rig.dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO).unwrap().remove(0);
            for parameter in subclass.parameters.iter().filter(|parameter| !parameter.unproven) {
                let at = usize::from(parameter.offset - subclass.start());
                let found = codec::Layout::TI.decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
                let same = match (&parameter.range, &found) {
                    (Range::Int { default: Some(default), .. }, Value::Int(found)) => found == default,
                    (Range::Float { default: Some(default), .. }, Value::Float(found)) => {
                        (found - default).abs() <= default.abs() * 1e-6
                    }
                    (Range::Text { default: Some(default) }, Value::Text(found)) => {
                        found == default.as_bytes()
                    }
                    _ => continue,
                };
                compared += 1;
                if !same {
                    differ.push((rig.gauge.chip.name, subclass.id, parameter.offset));
                }
            }
        }
        println!("{chip}: {compared} defaults compared");
        let expected: Vec<_> = intended.iter().copied().filter(|(name, _, _)| *name == chip).collect();
        assert_eq!(differ, expected, "{chip}");
        assert!(compared > 1, "{chip}");
    }
}

/// A new gauge, read through the engine, holds the defaults of the tables. The simulated gauges do not use
/// the tables, so a difference is a mistake in one of them.
#[test]
fn a_new_gauge_read_through_the_engine_holds_the_tables_defaults() {
    let intended: &[(&str, u16)] = &[];
    let mut compared = 0;
    for name in ["bq27220", "bq34110", "bq35100"] {
        let chip: &Chip = CHIPS.iter().copied().find(|chip| chip.name == name).unwrap();
        let mut rig = Rig::new(name);
        for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
            let read = rig.dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO).unwrap().remove(0);
            for row in subclass.parameters {
                let expected = match row.range {
                    Range::Int { default: Some(number), .. } => Value::Int(number),
                    Range::Float { default: Some(number), .. } => Value::Float(number),
                    Range::Text { default: Some(text) } => Value::Text(text.into()),
                    _ => continue,
                };
                let at = usize::from(row.offset - subclass.start());
                let found = codec::Layout::TI.decode(row.kind, &read[at..at + row.kind.size()]);
                let same = match (&found, &expected) {
                    // An F4 is exact to about seven digits.
                    (Value::Float(found), Value::Float(expected)) => (found / expected - 1.0).abs() < 1e-6,
                    _ => found == expected,
                };
                let known = intended.contains(&(name, row.offset));
                assert!(same != known, "{name} 0x{:04x} {}: {found:?}, {expected:?}", row.offset, row.name);
                compared += 1;
            }
        }
        // The gauge is sealed again.
        assert_eq!(rig.sim.get("seal").unwrap(), "sealed");
        assert!(rig.clock.now() < Duration::from_secs(60));
    }
    assert!(compared >= 15, "{compared}");
}
