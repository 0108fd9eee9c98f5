// SPDX-License-Identifier: MIT

//! The text of a `df` file, `ti_gauge::text`, and values with units and dates, `ti_gauge::unit`.

use std::sync::LazyLock;

use ti_gauge::chip::{CHIPS, Kind, Parameter, Range, Subclass};
use ti_gauge::codec;
use ti_gauge::dataflash::Change;
use ti_gauge::error::Cause;
use ti_gauge::notation;
use ti_gauge::text;
use ti_gauge::value::{Type, Value};

type Row = (&'static Subclass, &'static Parameter);

/// Of each type and each range one parameter.
static ROWS: LazyLock<Vec<Row>> = LazyLock::new(|| {
    let rows = CHIPS.iter().flat_map(|chip| chip.subclasses);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let mut found: Vec<Row> = Vec::new();
    for row in rows {
        let alike = found.iter().filter(|(_, other)| other.kind == row.1.kind);
        if alike.clone().count() < 2 && !alike.clone().any(|(_, other)| limits(other) == limits(row.1)) {
            found.push(row);
        }
    }
    found
});

fn limits(row: &Parameter) -> String {
    match &row.range {
        Range::Int { min, max, .. } => format!("{min} {max}"),
        Range::Float { min, max, .. } => format!("{min} {max}"),
        Range::Text { .. } => String::new(),
    }
}

pub(crate) fn run(input: &[u8]) {
    for row in ROWS.iter() {
        check(*row, input);
        if let Ok(text) = std::str::from_utf8(input) {
            check_unit(row.1, text);
        }
    }
    if let Some(bytes) = text::unhex(input) {
        assert_eq!(text::hex(&bytes).as_bytes(), input.to_ascii_lowercase());
    }
}

fn check((subclass, parameter): Row, input: &[u8]) {
    let stored = notation::parse_stored(parameter, input);
    let Ok(value) = notation::parse(parameter, input) else { return };
    assert_eq!(stored.as_ref(), Ok(&value), "a gauge's own value is refused");
    let kind = parameter.kind;
    let shown = std::str::from_utf8(input).expect("accepted as text").trim();
    match (&value, &parameter.range) {
        (Value::Int(number), Range::Int { min, max, .. }) => {
            assert!((min..=max).contains(&number), "{number} is out of range");
            assert_eq!(number_of(shown), Some(i128::from(*number)), "{shown} became {number}");
        }
        (Value::Float(number), Range::Float { min, max, .. }) => {
            assert!((min..=max).contains(&number), "{number} is out of range");
        }
        (Value::Text(bytes), Range::Text { .. }) if !shown.contains('%') => {
            assert_eq!(bytes, shown.as_bytes())
        }
        (Value::Text(bytes), Range::Text { .. }) => assert!(bytes.len() <= shown.len()),
        other => panic!("a value of another type: {other:?}"),
    }
    let change = match Change::of_value(CHIPS[0], (subclass, parameter), &value, true) {
        Err(error) if subclass.kind == Kind::Security || parameter.never.is_some() => {
            return assert!(matches!(error.cause(), Cause::NotPermitted), "{error}");
        }
        change => change.expect("an accepted value fits its type"),
    };
    assert_eq!(change.bytes().len(), kind.size());
    let read = codec::Layout::TI.decode(kind, change.bytes());
    if kind != Type::F4 {
        assert_eq!(read, value, "stored and read as another value");
    }
    if let (Value::Float(one), Value::Float(other)) = (&value, &read) {
        assert!((one - other).abs() <= one.abs() * 1e-6 + 1e-37, "{one} is stored as {other}");
    }
    let again = notation::parse_stored(parameter, notation::render(kind, &read).as_bytes());
    let again = again.expect("what is shown can be written");
    assert_eq!(codec::Layout::TI.encode(kind, &again), Some(change.bytes().to_vec()));
}

/// What a file accepts means the same with units allowed; a unit is refused, or gives a value of which the text is the
/// very number.
fn check_unit(parameter: &'static Parameter, text: &str) {
    let value =
        match (notation::parse(parameter, text.as_bytes()), notation::parse_with_unit(parameter, text)) {
            (Ok(plain), value) => {
                assert_eq!(value.as_ref(), Ok(&plain), "{text}");
                plain
            }
            (Err(_), Ok(value)) => value,
            (Err(_), Err(_)) => return,
        };
    let shown = notation::show(parameter, &value);
    let Value::Int(stored) = value else { return };
    assert_eq!(
        notation::parse_with_unit(parameter, &shown),
        Ok(value),
        "{text}: what is shown is read as another value"
    );
    // Volts and amperes differ from what is stored by three digits.
    let of_thousand = ["mV", "mA", "mAh"].contains(&parameter.unit);
    let number = text.trim().strip_suffix(parameter.unit.trim_start_matches('m')).filter(|_| of_thousand);
    let number =
        number.map(str::trim).filter(|number| number.bytes().all(|byte| b"+-.0123456789".contains(&byte)));
    if let Some((whole, part)) = number.and_then(|number| number.split_once('.')) {
        let digits = format!("{whole}{part:0<3}");
        let (digits, rest) = digits.split_at(whole.len() + 3);
        assert!(rest.bytes().all(|digit| digit == b'0'), "{text} was rounded to {stored}");
        assert_eq!(digits.parse(), Ok(stored), "{text}");
    }
}

/// A whole number in decimal, hexadecimal or binary, by other code than the one under test.
pub(crate) fn number_of(text: &str) -> Option<i128> {
    let (sign, digits) = match text.as_bytes().first()? {
        b'-' => (-1, &text[1..]),
        b'+' => (1, &text[1..]),
        _ => (1, text),
    };
    let radix = match digits.get(..2) {
        Some("0x" | "0X") => 16,
        Some("0b" | "0B") => 2,
        _ => 10,
    };
    let digits = if radix == 10 { digits } else { &digits[2..] };
    let step = |sum: i128, digit: char| {
        sum.checked_mul(radix.into())?.checked_add(i128::from(digit.to_digit(radix)?))
    };
    if digits.is_empty() { None } else { digits.chars().try_fold(0, step).map(|sum| sign * sum) }
}
