// SPDX-License-Identifier: MIT

//! What a change may be: whoever uses the library cannot make another one.

use ti_gauge::chip::{CHIPS, Kind, Range};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

use crate::rig::cause;

#[test]
fn a_change_is_what_may_be_written() {
    let (mut refused, mut unproven, mut raw) = (0, 0, 0);
    for chip in CHIPS.iter().copied().filter(|chip| chip.is_proven()) {
        for subclass in chip.subclasses {
            for parameter in subclass.parameters {
                let row = (subclass, parameter);
                let at = format!("{} {}", chip.name, parameter.name);
                if let Range::Int { min, max, .. } = parameter.range {
                    let of = |value| {
                        Change::of_value(chip, row, &Value::Int(value), true).map_err(|error| cause(&error))
                    };
                    if subclass.kind == Kind::Security || parameter.never.is_some() {
                        assert_eq!(of(min).err(), Some("not-permitted"), "{at}");
                    } else {
                        assert_eq!([of(min - 1).err(), of(max + 1).err()], [Some("out-of-range"); 2], "{at}");
                        refused += 2;
                    }
                    if parameter.unproven && parameter.never.is_none() && subclass.kind != Kind::Security {
                        let error = Change::of_value(chip, row, &Value::Int(min), false).expect_err(&at);
                        assert_eq!(cause(&error), "io", "{at}: {error}");
                        unproven += 1;
                    }
                }
                let there =
                    Change::raw(chip, (subclass.id, parameter.offset).into(), vec![0]).expect_err(&at);
                assert!(["invalid", "not-permitted"].contains(&cause(&there)), "{at}: {there}");
                raw += 1;
            }
        }
    }
    assert!(refused > 1000 && unproven > 10 && raw > 500, "{refused} {unproven} {raw}");
}
