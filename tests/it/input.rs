// SPDX-License-Identifier: MIT

//! Input for every parameter of every chip: the limits of its range are accepted; values beyond them, and text
//! that is not a value of its type, are refused.

use nix::errno::Errno;
use ti_gauge::chip::{CHIPS, Parameter, Range};
use ti_gauge::notation;
use ti_gauge::value::{Type, Value};

fn refused(parameter: &Parameter, text: &str) -> Option<Errno> {
    notation::parse(parameter, text.as_bytes()).err().map(|error| Errno::from_raw(error.errno()))
}

/// The texts that a parameter must accept, and those that must be refused with an errno.
fn texts(parameter: &Parameter) -> (Vec<String>, Vec<(String, Errno)>) {
    let no_number = ["", " ", "abc", "1 2", "1,5", "0x", "0b2", "1e", "٣", "1\0"];
    let mut bad: Vec<_> = no_number.iter().map(|text| (text.to_string(), Errno::EINVAL)).collect();
    match (parameter.kind, &parameter.range) {
        (Type::S(size), _) => {
            let room = usize::from(size) - 1;
            let good = vec![String::new(), "x".repeat(room)];
            let bad = vec![
                ("x".repeat(room + 1), Errno::EINVAL),
                ("a\nb".to_string(), Errno::EINVAL),
                ("é".to_string(), Errno::EINVAL),
            ];
            (good, bad)
        }
        (Type::F4, Range::Float { min, max, .. }) => {
            let below = min - min.abs().max(1e-3) * 1e-3;
            let above = max + max.abs().max(1e-3) * 1e-3;
            bad.extend(["nan", "inf", "-inf"].map(|text| (text.to_string(), Errno::EINVAL)));
            bad.extend([below, above].map(|value| (value.to_string(), Errno::ERANGE)));
            (vec![min.to_string(), max.to_string(), format!("{max:e}")], bad)
        }
        (kind, range) => {
            let (min, max) = match range {
                Range::Int { min, max, .. } => (*min, *max),
                Range::Float { .. } | Range::Text { .. } => kind.bounds().expect("an integer type"),
            };
            bad.extend(["1.5", "--1", "0x1g", "1e3"].map(|text| (text.to_string(), Errno::EINVAL)));
            bad.extend([min - 1, max + 1].map(|value| (value.to_string(), Errno::ERANGE)));
            bad.push(("9".repeat(40), Errno::ERANGE));
            (
                vec![
                    min.to_string(),
                    max.to_string(),
                    format!(" {max}\n"),
                    format!("+{max:}").replace("+-", "-"),
                ],
                bad,
            )
        }
    }
}

#[test]
fn every_parameter_accepts_its_range_and_nothing_else() {
    let mut tried = 0;
    for chip in CHIPS {
        for subclass in chip.subclasses {
            for parameter in subclass.parameters {
                let at = format!("{} {} {} {}", chip.name, subclass.name, parameter.offset, parameter.name);
                let (good, bad) = texts(parameter);
                for text in &good {
                    assert_eq!(refused(parameter, text), None, "{at}: {text:?}");
                }
                for (text, errno) in &bad {
                    assert_eq!(refused(parameter, text), Some(*errno), "{at}: {text:?}");
                }
                tried += good.len() + bad.len();
                hexadecimal(parameter, &at);
            }
        }
    }
    assert!(tried > 10_000, "{tried}");
}

/// Integers are also accepted in hexadecimal and binary, and their text parses to the same value.
fn hexadecimal(parameter: &Parameter, at: &str) {
    let Range::Int { max, .. } = parameter.range else { return };
    for text in [format!("{max:#x}"), format!("{max:#X}").replace('X', "x"), format!("{max:#b}")] {
        if max < 0 || text.len() > 90 {
            continue;
        }
        let value = notation::parse(parameter, text.as_bytes());
        assert_eq!(value, Ok(Value::Int(max)), "{at}: {text}");
        let rendered = notation::render(parameter.kind, &Value::Int(max));
        assert_eq!(notation::parse(parameter, rendered.as_bytes()), Ok(Value::Int(max)), "{at}: {rendered}");
    }
}
