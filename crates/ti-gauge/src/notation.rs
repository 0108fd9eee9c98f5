// SPDX-License-Identifier: MIT

//! Notation of a parameter's value: as text of its `df` file, and with a unit or as a date. Pure: no bus, no file.

use crate::chip::{Parameter, Range};
use crate::codec;
use crate::date;
use crate::error::{Cause, Error, Reason, Result};
use crate::quantity;
use crate::text::unhex;
use crate::unit;
use crate::value::{Type, Value};

/// The text of a value: integers in decimal, `H` types in hexadecimal of full width, `F4` in the shortest decimal that
/// reads back to the same bytes, strings with `%HH` for unsafe bytes. [`parse_stored`] is the reverse.
pub fn render(kind: Type, value: &Value) -> String {
    match (kind, value) {
        (Type::H(size), Value::Int(value)) => format!("0x{value:0width$x}", width = usize::from(size) * 2),
        (_, Value::Int(value)) => value.to_string(),
        (_, Value::Float(value)) => shortest(*value),
        (_, Value::Text(bytes)) => escape(bytes),
    }
}

/// What a shell or a terminal could act on becomes `%HH`; so do a space at an end, and `%` before two hexadecimal digits.
fn escape(bytes: &[u8]) -> String {
    let mut text = String::new();
    for (at, &byte) in bytes.iter().enumerate() {
        let is_plain = match byte {
            b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => true,
            b'.' | b',' | b':' | b'+' | b'-' | b'_' | b'/' | b'=' | b'@' => true,
            b' ' => at > 0 && at + 1 < bytes.len(),
            b'%' => escaped(&bytes[at..]).is_none(),
            _ => false,
        };
        if is_plain { text.push(byte.into()) } else { text += &format!("%{byte:02x}") }
    }
    text
}

fn escaped(text: &[u8]) -> Option<u8> {
    match text {
        [b'%', digits @ ..] => unhex(digits.get(..2)?)?.first().copied(),
        _ => None,
    }
}

fn unescape(mut text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    while let [first, rest @ ..] = text {
        let byte = escaped(text);
        bytes.push(byte.unwrap_or(*first));
        text = if byte.is_some() { &rest[2..] } else { rest };
    }
    bytes
}

/// A string in a file of another format, one character per byte: `_` for those that are not printable ASCII.
pub fn shown(string: &[u8]) -> String {
    string.iter().map(|&byte| if is_printable(byte) { byte.into() } else { '_' }).collect()
}

fn is_printable(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte)
}

/// A string of any bytes as a parameter's value, if it is short enough.
pub fn string(parameter: &Parameter, bytes: Vec<u8>) -> Result<Value> {
    let room = parameter.kind.size() - 1;
    if bytes.len() > room {
        let why = format!("{} characters, but only {room} fit", bytes.len());
        return Err(Error::new(parameter.name, Cause::Invalid, why));
    }
    Ok(Value::Text(bytes))
}

fn shortest(value: f64) -> String {
    (0..=16)
        .filter_map(|digits| format!("{value:.digits$e}").parse::<f64>().ok())
        .find(|&short| codec::rounded(short) == codec::rounded(value))
        .unwrap_or(value)
        .to_string()
}

/// Parses a value of the parameter's type in the manual's range: decimal, `0x` or `0b`; in a string `%HH` is a byte.
pub fn parse(parameter: &Parameter, text: &[u8]) -> Result<Value> {
    parse_in(parameter, Some(&parameter.range), text)
}

/// Checks that a parameter's value is in the manual's range.
pub fn check(parameter: &Parameter, value: &Value) -> Result<()> {
    match (value, &parameter.range, parameter.kind) {
        (Value::Int(value), Range::Int { min, max, .. }, kind) if !(*min..=*max).contains(value) => {
            let show = |bound: &i64| render(kind, &Value::Int(*bound));
            Err(outside(parameter, &show(min), &show(max)))
        }
        (Value::Float(value), Range::Float { min, max, .. }, _) if !(*min..=*max).contains(value) => {
            Err(outside(parameter, &min.to_string(), &max.to_string()))
        }
        _ => Ok(()),
    }
}

/// The text is not repeated: it may be a key that was meant for another file.
fn outside(parameter: &Parameter, min: &str, max: &str) -> Error {
    let reason = Reason::OutOfRange { least: min.into(), greatest: max.into(), unit: parameter.unit };
    Error::of(parameter.name, reason)
}

/// Parses a gauge's present value, in or out of range: only the type is checked.
pub fn parse_stored(parameter: &Parameter, text: &[u8]) -> Result<Value> {
    parse_in(parameter, None, text)
}

fn parse_in(parameter: &Parameter, range: Option<&Range>, text: &[u8]) -> Result<Value> {
    let invalid = |why: String| Error::new(parameter.name, Cause::Invalid, why);
    let Some(text) = std::str::from_utf8(text).ok().map(str::trim).filter(|text| text.len() < 100) else {
        return Err(invalid(format!("not a value of type {}", parameter.kind)));
    };
    match (parameter.kind, range) {
        (Type::S(_), _) => {
            if !text.bytes().all(is_printable) {
                let why = "only printable ASCII is accepted; write any other byte as %HH, in hexadecimal";
                return Err(invalid(why.into()));
            }
            string(parameter, unescape(text.as_bytes()))
        }
        (Type::F4, range) => {
            let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
            let value = value.ok_or_else(|| invalid(wanted(parameter, range, text)))?;
            if let Some(Range::Float { min, max, .. }) = range
                && !(*min..=*max).contains(&value)
            {
                return Err(outside(parameter, &min.to_string(), &max.to_string()));
            }
            if codec::Layout::TI.encode(Type::F4, &Value::Float(value)).is_none() {
                return Err(outside(parameter, "-1.7e38", "1.7e38"));
            }
            Ok(Value::Float(value))
        }
        (kind, range) => {
            let value = integer(text).ok_or_else(|| invalid(wanted(parameter, range, text)))?;
            let bounds = match range {
                Some(Range::Int { min, max, .. }) => Some((*min, *max)),
                Some(Range::Float { .. } | Range::Text { .. }) | None => kind.bounds(),
            };
            let (min, max) = bounds.expect("an integer type has bounds");
            match value {
                Some(value) if (min..=max).contains(&value) => Ok(Value::Int(value)),
                _ => {
                    let show = |bound| render(kind, &Value::Int(bound));
                    Err(outside(parameter, &show(min), &show(max)))
                }
            }
        }
    }
}

fn wanted(parameter: &Parameter, range: Option<&Range>, text: &str) -> String {
    let unit = parameter.unit;
    if let Some(number) = without_unit(parameter, range, text) {
        return format!("the value has a unit; write the number in {unit}: {number}");
    }
    let (what, limits) = match (parameter.kind, range) {
        (Type::F4, Some(Range::Float { min, max, .. })) => {
            ("number", Some((min.to_string(), max.to_string())))
        }
        (Type::F4, _) => ("number", None),
        (kind, Some(Range::Int { min, max, .. })) => {
            let show = |bound: &i64| render(kind, &Value::Int(*bound));
            ("whole number", Some((show(min), show(max))))
        }
        _ => ("whole number", None),
    };
    let limits = limits.map_or("a number".into(), |(min, max)| format!("{min} to {max}"));
    let unit = if unit::is_known(unit) { format!(", in {unit}") } else { String::new() };
    let notations = if what == "number" { "" } else { ", as decimal, 0x or 0b" };
    format!("the value is not a {what}; write {limits}{unit}{notations}")
}

/// The number of a value with a unit, if possible. A message repeats nothing else of a text, which may be a key.
fn without_unit(parameter: &Parameter, range: Option<&Range>, text: &str) -> Option<String> {
    // `367A` may be half of a key, `367 A` is not.
    if text.strip_suffix('A').is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit())) {
        return None;
    }
    let number = unit::in_own(parameter, text)?;
    parse_in(parameter, range, number.as_bytes()).is_ok().then_some(number)
}

/// `None` for text that is not a number, `Some(None)` for a number too large for any type.
fn integer(text: &str) -> Option<Option<i64>> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let lower = digits.to_ascii_lowercase();
    let (radix, digits) = match (lower.strip_prefix("0x"), lower.strip_prefix("0b")) {
        (Some(digits), _) => (16, digits),
        (_, Some(digits)) => (2, digits),
        _ => (10, lower.as_str()),
    };
    if digits.is_empty() || !digits.chars().all(|digit| digit.is_digit(radix)) {
        return None;
    }
    let magnitude = i64::from_str_radix(digits, radix).ok();
    Some(magnitude.map(|magnitude| if negative { -magnitude } else { magnitude }))
}

/// Parses a value as in its file, with a unit that converts exactly, or as a date. The error lists the units.
pub fn parse_with_unit(parameter: &Parameter, text: &str) -> Result<Value> {
    let invalid = |why: String| Error::new(parameter.name, Cause::Invalid, why);
    let text = text.trim();
    // The shown form, with the stored number behind it.
    let stored = text.strip_suffix(')').and_then(|text| text.rsplit_once(" (")).map(|(_, stored)| stored);
    if let Some(stored) = stored.filter(|stored| quantity::with_unit(stored, unit::shown(parameter)) == text)
    {
        return parse(parameter, stored.as_bytes());
    }
    let plain = match parse(parameter, text.as_bytes()) {
        Err(error) if matches!(error.cause(), Cause::Invalid) => error,
        plain => return plain,
    };
    if matches!(parameter.kind, Type::S(_)) {
        return Err(plain);
    }
    if parameter.is_date() {
        let stored = date::parse(text).ok_or_else(|| {
            invalid("write a day from 1980-01-01 to 2107-12-31, or the stored number".into())
        })?;
        return parse(parameter, stored.to_string().as_bytes());
    }
    let (number, symbol) = unit::split(text);
    let Some((num, den)) = unit::decimal(number).filter(|_| !symbol.is_empty()) else {
        let units = unit::accepted(parameter);
        if units.is_empty() {
            return Err(plain);
        }
        return Err(invalid(format!(
            "not a number that can be stored; write a whole number, or one with {units}"
        )));
    };
    let spaced = text[number.len()..].starts_with(' ');
    let value = unit::convert(parameter, (num, den), symbol, spaced).map_err(invalid)?;
    parse(parameter, value.as_bytes())
}

/// A value for people: a date as `2026-11-22`, anything else as in [`render`]. [`parse_with_unit`] accepts it.
pub fn show(parameter: &Parameter, value: &Value) -> String {
    let date = match value {
        Value::Int(stored) if parameter.is_date() => date::text(*stored),
        _ => None,
    };
    date.unwrap_or_else(|| render(parameter.kind, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::CHIPS;
    use proptest::prelude::*;

    fn parameters() -> impl Iterator<Item = &'static Parameter> {
        CHIPS.iter().flat_map(|chip| chip.subclasses).flat_map(|subclass| subclass.parameters)
    }

    fn cases(cases: u32) -> ProptestConfig {
        ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn every_number_of_every_chip_reads_back_as_it_is_shown() {
        proptest!(cases(24), |(bytes: [u8; 4], place in 0.0..=1.0)| {
            for parameter in parameters() {
                let kind = parameter.kind;
                if matches!(kind, Type::S(_)) {
                    continue;
                }
                let stored = codec::Layout::TI.decode(kind, &bytes[..kind.size()]);
                let shown = render(kind, &stored);
                let read = parse_stored(parameter, shown.as_bytes());
                let read = read.map_err(|error| TestCaseError::fail(error.to_string()))?;
                prop_assert_eq!(codec::Layout::TI.encode(kind, &read), codec::Layout::TI.encode(kind, &stored), "{}", parameter.name);
                if let Range::Int { min, max, .. } = parameter.range {
                    let value = Value::Int(min + ((max - min) as f64 * place) as i64);
                    let shown = render(kind, &value);
                    prop_assert_eq!(parse(parameter, shown.as_bytes()), Ok(value), "{}", parameter.name);
                }
            }
        });
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn every_string_of_every_chip_reads_back_as_it_is_shown() {
        proptest!(cases(256), |(bytes in prop::collection::vec(any::<u8>(), 0..32), letters in prop::collection::vec(prop::sample::select(b"%02fF ".to_vec()), 0..32))| {
            for parameter in parameters().filter(|parameter| matches!(parameter.kind, Type::S(_))) {
                for string in [&bytes, &letters] {
                    let value = Value::Text(string[..string.len().min(parameter.kind.size() - 1)].to_vec());
                    let shown = render(parameter.kind, &value);
                    prop_assert_eq!(parse(parameter, shown.as_bytes()), Ok(value), "{}", shown);
                    // No shell acts on it.
                    let is_safe = |letter: char| letter.is_ascii_alphanumeric() || " .,:+-_/=@%".contains(letter);
                    prop_assert!(shown.chars().all(is_safe), "{}", shown);
                    prop_assert_eq!(shown.trim(), &shown);
                }
            }
        });
    }

    #[test]
    fn a_string_is_shown_and_read_with_escapes() {
        const LONG: Parameter = Parameter::text(31, 12, "Device Name", "");
        for (stored, text) in [
            (&b"AT&T (4S)"[..], "AT%26T %284S%29"),
            (b"Texas Inst.", "Texas Inst."),
            (b" a ", "%20a%20"),
            (b"  ", "%20%20"),
            (b"100%", "100%"),
            (b"%4", "%4"),
            (b"%%", "%%"),
            (b"%41", "%2541"),
            (b"%%fF", "%%25fF"),
            (b"%4(", "%4%28"),
            (b"a\0\xff\n", "a%00%ff%0a"),
            (b"", ""),
        ] {
            let value = Value::Text(stored.to_vec());
            assert_eq!(render(Type::S(12), &value), text);
            assert_eq!(parse(&LONG, text.as_bytes()), Ok(value), "{text}");
        }
        for (written, stored) in [
            ("AT&T (4S)\n", &b"AT&T (4S)"[..]),
            ("\n", b""),
            (" a  b ", b"a  b"),
            ("%41%6A%6a", b"Ajj"),
            ("%%41", b"%A"),
            ("50%, $(id)", b"50%, $(id)"),
            ("%2541", b"%41"),
        ] {
            assert_eq!(parse(&LONG, written.as_bytes()), Ok(Value::Text(stored.to_vec())), "{written}");
        }
        let error = parse(&LONG, "caf\u{e9}".as_bytes()).expect_err("not ASCII").to_string();
        assert!(error.ends_with("write any other byte as %HH, in hexadecimal"), "{error}");
        let error = parse(&LONG, "%41".repeat(12).as_bytes()).expect_err("too long").to_string();
        assert_eq!(error, "Device Name: 12 characters, but only 11 fit");
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn the_shortest_f4_reads_back_to_the_same_bytes() {
        proptest!(cases(2048), |(bytes: [u8; 4])| {
            let shown = render(Type::F4, &codec::Layout::TI.decode(Type::F4, &bytes));
            let Ok(Value::Float(read)) = parse_stored(&GAIN, shown.as_bytes()) else {
                return Err(TestCaseError::fail(format!("{shown} is refused")));
            };
            prop_assert_eq!(codec::Layout::TI.encode(Type::F4, &Value::Float(read)), Some(bytes.to_vec()), "{}", shown);
        });
    }

    const VOLTAGE: Parameter =
        Parameter::int(53, Type::I(2), "Cell Terminate Voltage", 1000, 3700, 3000, "mV");
    const CONFIG: Parameter = Parameter::int(0, Type::H(2), "Pack Configuration", 0, 0xffff, 0x161, "flags");
    const GAIN: Parameter = Parameter::float(0, "CC Gain", 0.1, 40.0, 0.4768, "mΩ");
    const NAME: Parameter = Parameter::text(55, 5, "Device Chemistry", "LION");

    fn is_invalid(error: &Error) -> bool {
        matches!(error.cause(), Cause::Invalid)
    }

    fn is_out_of_range(error: &Error) -> bool {
        matches!(error.cause(), Cause::OutOfRange)
    }

    fn refusal(parameter: &Parameter, text: &str) -> Error {
        parse(parameter, text.as_bytes()).expect_err(text)
    }

    #[test]
    fn numbers_in_every_notation() {
        for text in ["3100", "3100\n", "  3100 \n", "0xc1c", "0XC1C", "0b110000011100", "+3100"] {
            assert_eq!(parse(&VOLTAGE, text.as_bytes()), Ok(Value::Int(3100)), "{text:?}");
        }
    }

    #[test]
    fn what_is_refused_and_how() {
        for text in ["", "\n", "abc", "3100 mV", "3100 3200", "3100.0", "0x", "--5", "3_100", "\u{0663}"] {
            assert!(is_invalid(&refusal(&VOLTAGE, text)), "{text:?}");
        }
        for text in ["999", "3701", "-3100", "99999999999999999999999"] {
            assert!(is_out_of_range(&refusal(&VOLTAGE, text)), "{text:?}");
        }
        for text in ["nan", "inf", "-", "0.5 x"] {
            assert!(is_invalid(&refusal(&GAIN, text)), "{text:?}");
        }
        for text in ["0.09999", "41", "-1"] {
            assert!(is_out_of_range(&refusal(&GAIN, text)), "{text:?}");
        }
        assert!(is_invalid(&refusal(&NAME, "LiFePO4")));
        assert!(is_invalid(&refusal(&NAME, "a\u{1b}b")));
        assert!(is_invalid(&parse(&VOLTAGE, b"\xff\xfe").expect_err("not UTF-8")));
    }

    #[test]
    fn a_value_with_a_unit_is_refused_with_the_number_to_write() {
        const DELTA: Parameter = Parameter::int(0, Type::I(2), "OT Chg", 0, 1200, 550, "0.1°C");
        const CURRENT: Parameter = Parameter::int(0, Type::I(2), "Quit Current", 0, 1000, 40, "mA");
        let voltage = "the value is not a whole number; write 1000 to 3700, in mV, as decimal, 0x or 0b";
        for (parameter, text, says) in [
            (&VOLTAGE, "3100mV", "the value has a unit; write the number in mV: 3100"),
            (&VOLTAGE, "3100 mV\n", "the value has a unit; write the number in mV: 3100"),
            (&VOLTAGE, "3.1V", "the value has a unit; write the number in mV: 3100"),
            (&VOLTAGE, "+3.15 V", "the value has a unit; write the number in mV: 3150"),
            (&CURRENT, "0.05A", "the value has a unit; write the number in mA: 50"),
            (&CURRENT, "1 A", "the value has a unit; write the number in mA: 1000"),
            (&DELTA, "55 °C", "the value has a unit; write the number in 0.1°C: 550"),
            (&GAIN, "0.5 mΩ", "the value has a unit; write the number in mΩ: 0.5"),
            // Not that quantity, not in the range, no whole number, or none at all.
            (&VOLTAGE, "3100 mA", voltage),
            (&VOLTAGE, "99 V", voltage),
            (&VOLTAGE, "3.1001 V", voltage),
            (&VOLTAGE, "3,1", voltage),
            (&VOLTAGE, "", voltage),
            // It may be the half of a key.
            (&CURRENT, "1A", "the value is not a whole number; write 0 to 1000, in mA, as decimal, 0x or 0b"),
            (&CONFIG, "x", "the value is not a whole number; write 0x0000 to 0xffff, as decimal, 0x or 0b"),
            (&GAIN, "x", "the value is not a number; write 0.1 to 40, in mΩ"),
        ] {
            assert_eq!(refusal(parameter, text).to_string(), format!("{}: {says}", parameter.name), "{text}");
        }
    }

    #[test]
    fn texts_are_the_manuals_own() {
        assert_eq!(render(Type::H(2), &Value::Int(0x161)), "0x0161");
        assert_eq!(render(Type::H(4), &Value::Int(0x1234)), "0x00001234");
        assert_eq!(render(Type::I(2), &Value::Int(-400)), "-400");
        for text in ["0.4768", "567744.56", "0.1", "0.01953125", "40", "-1"] {
            let value = Value::Float(text.parse().expect("a number"));
            let stored = codec::Layout::TI.encode(Type::F4, &value).expect("fits");
            assert_eq!(render(Type::F4, &codec::Layout::TI.decode(Type::F4, &stored)), text);
        }
        assert_eq!(render(Type::S(12), &Value::Text(b"Texas Inst.".to_vec())), "Texas Inst.");
        assert_eq!(render(Type::S(12), &Value::Text(b"a$(id)`\x1b".to_vec())), "a%24%28id%29%60%1b");
        assert_eq!(parse(&CONFIG, b"0x01e1"), Ok(Value::Int(0x1e1)));
    }

    /// It may be a key that was meant for another file.
    #[test]
    fn an_error_does_not_repeat_what_was_written() {
        for parameter in [&VOLTAGE, &CONFIG, &GAIN, &NAME] {
            for text in [
                "8d3e b7c5",
                "0x8d3eb7c5",
                "36158",
                "-8735",
                "8d3e",
                "47b2\nd90e",
                "01234567890123456789012345678901",
            ] {
                if let Err(error) = parse(parameter, text.as_bytes()) {
                    let shown = error.to_string();
                    let mut words = text.split_whitespace();
                    assert!(
                        !words.any(|word| shown.contains(word.trim_start_matches("0x"))),
                        "{text}: {shown}"
                    );
                }
            }
        }
        assert_eq!(
            refusal(&VOLTAGE, "3701").to_string(),
            "Cell Terminate Voltage: the value is outside 1000 to 3700 mV"
        );
    }

    #[test]
    fn a_stored_value_need_not_be_in_range() {
        assert_eq!(parse_stored(&VOLTAGE, b"9999"), Ok(Value::Int(9999)));
        assert!(is_out_of_range(&parse_stored(&VOLTAGE, b"99999").expect_err("no I2")));
        assert_eq!(parse_stored(&GAIN, b"41"), Ok(Value::Float(41.0)));
    }
}
