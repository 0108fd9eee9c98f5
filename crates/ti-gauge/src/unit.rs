// SPDX-License-Identifier: MIT

//! Units of numbers, and their exact conversion to a parameter's unit, for [`crate::notation`].
//!
//! A stored value is converted exactly or refused, never rounded. A value for comparisons may be any number.

use crate::chip::Parameter;
use crate::date;
use crate::error::Result;
pub(crate) use crate::quantity::split;
use crate::value::Type;

/// An exact number times a unit: `num / den` of a base unit.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Unit {
    num: i128,
    den: i128,
    base: String,
}

const SYMBOLS: [(&str, &str, i128); 17] = [
    ("V", "V", 1),
    ("A", "A", 1),
    ("Ah", "Ah", 1),
    ("W", "W", 1),
    ("Wh", "Wh", 1),
    ("Ω", "Ω", 1),
    ("ohm", "Ω", 1),
    ("Ohm", "Ω", 1),
    ("s", "s", 1),
    ("min", "s", 60),
    ("h", "s", 3600),
    ("d", "s", 86400),
    ("%", "%", 1),
    ("°C", "°C", 1),
    ("degC", "°C", 1),
    ("C", "°C", 1),
    ("K", "K", 1),
];
const PREFIXED: [&str; 7] = ["V", "A", "Ah", "W", "Wh", "Ω", "s"];
/// Prefixes with their multiplier and divisor. The micro sign and the Greek letter are different characters.
const PREFIXES: [(&str, i128, i128); 8] = [
    ("", 1, 1),
    ("k", 1_000, 1),
    ("c", 1, 100),
    ("m", 1, 1_000),
    ("u", 1, 1_000_000),
    ("µ", 1, 1_000_000),
    ("μ", 1, 1_000_000),
    ("n", 1, 1_000_000_000),
];
/// Denominators. `mV/cell` never converts to `mV`: a pack's voltage is a different quantity.
const PER: [&str; 2] = ["/cell", "/day"];
/// Most digits of a number with a unit. It keeps all products within 128 bits.
const DIGITS: usize = 18;

impl Unit {
    /// A table's unit, such as `0.1°C` or `mV/cell`. `None` for names such as `hex`, and for units that a setting moves.
    fn of(text: &str) -> Option<Self> {
        let (number, unit) = split(text);
        let (num, den) = if number.is_empty() { (1, 1) } else { decimal(number)? };
        let per = PER.into_iter().find(|per| unit.ends_with(per)).unwrap_or_default();
        let name = unit.strip_suffix(per)?;
        let (symbol, size) = SYMBOLS.iter().find_map(|&(symbol, base, size)| {
            let prefix = name.strip_suffix(symbol)?;
            let &(_, times, divisor) = PREFIXES.iter().find(|(known, ..)| *known == prefix)?;
            let may_have = prefix.is_empty() || PREFIXED.contains(&base) && size == 1;
            may_have.then_some((base, (size * times, divisor)))
        })?;
        Some(Self { num: num * size.0, den: den * size.1, base: format!("{symbol}{per}") })
    }
}

pub(crate) fn decimal(text: &str) -> Option<(i128, i128)> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    let all = format!("{whole}{part}");
    let is_number = !all.is_empty() && all.len() <= DIGITS && all.bytes().all(|byte| byte.is_ascii_digit());
    let den = 10_i128.pow(part.len().min(DIGITS) as u32);
    if is_number { Some((sign * all.parse::<i128>().ok()?, den)) } else { None }
}

/// The units that [`crate::notation::parse_with_unit`] accepts for a parameter, in words; empty without any.
pub fn accepted(parameter: &Parameter) -> String {
    if parameter.is_date() {
        return "a date such as 2026-11-22".into();
    }
    accepted_for(parameter.unit)
}

/// The units that [`measured`] accepts for a value in `unit`, in words; empty for a mere name.
pub fn accepted_for(unit: &str) -> String {
    let Some(Unit { base, .. }) = Unit::of(unit) else { return String::new() };
    let small = ["n", "u"].into_iter().filter(|prefix| unit.contains(prefix));
    match base.split('/').next().unwrap_or_default() {
        "s" => "s, min or h".into(),
        "%" | "K" => base,
        "°C" => "degC".into(),
        symbol if PREFIXED.contains(&symbol) => {
            let small = small.map(|prefix| format!("{prefix}{base}, ")).collect::<String>();
            format!("{small}m{base} or {base}")
        }
        _ => base,
    }
}

/// Whether it is a unit instead of a mere name such as `hex`.
pub fn is_known(unit: &str) -> bool {
    Unit::of(unit).is_some()
}

/// A number with a unit, such as `3.1V`, in `unit`s, such as `uV`. `None` without a unit, or for another quantity.
pub fn measured(text: &str, unit: &str) -> Option<f64> {
    let (number, written) = split(text.trim());
    let (num, den) = decimal(number)?;
    let (written, unit) = (Unit::of(written).filter(|_| split(written).0.is_empty())?, Unit::of(unit)?);
    if written.base != unit.base {
        return None;
    }
    // Within 128 bits: a number has 18 digits, and no two units are further apart than these products.
    let num = num.checked_mul(written.num)?.checked_mul(unit.den)?;
    let den = den.checked_mul(written.den)?.checked_mul(unit.num)?;
    let common = greatest_divisor(num.unsigned_abs(), den.unsigned_abs()).max(1) as i128;
    Some((num / common) as f64 / (den / common) as f64)
}

fn greatest_divisor(a: u128, b: u128) -> u128 {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

/// What a number without a unit may mean in `unit`s: `3.9` in `uV` is `3.9V`, `3900` is `3900mV`. `None` for names.
pub fn likely(number: f64, unit: &str) -> Option<String> {
    /// Above these limits, people write a smaller unit.
    const LARGE: [(f64, &str); 2] = [(100.0, ""), (100_000.0, "m")];
    let Unit { num, den, base } = Unit::of(unit)?;
    let size = number.abs();
    let own = || format!("{}{base}", number * num as f64 / den as f64);
    let (symbol, per) = base.split_at(base.find('/').unwrap_or(base.len()));
    Some(match symbol {
        "°C" if size <= 150.0 => format!("{number}{}", word_of(symbol)),
        "°C" => format!("{}{}", number * num as f64 / den as f64, word_of(symbol)),
        "K" if size < 1000.0 => format!("{number}K"),
        "s" if den > 1 && size >= 1000.0 => format!("{number}ms"),
        "s" if num % 60 == 0 => format!("{number}min"),
        "s" => format!("{number}s"),
        symbol if PREFIXED.contains(&symbol) => {
            let prefix = LARGE.iter().find(|(large, _)| size < *large).map_or("u", |(_, prefix)| prefix);
            format!("{number}{prefix}{}{per}", word_of(symbol))
        }
        _ => own(),
    })
}

/// A symbol as it can be typed on any keyboard.
fn word_of(symbol: &str) -> &str {
    match symbol {
        "Ω" => "ohm",
        "°C" => "C",
        symbol => symbol,
    }
}

/// A number with a unit, in the parameter's own unit, if it can be stored.
pub(crate) fn in_own(parameter: &Parameter, text: &str) -> Option<String> {
    let (number, unit) = split(text);
    let number_of = decimal(number).filter(|_| !unit.is_empty())?;
    convert(parameter, number_of, unit, text[number.len()..].starts_with(' ')).ok()
}

/// A number with a unit, in the parameter's own unit, or why not. `spaced` means a space before the unit.
pub(crate) fn convert(
    parameter: &Parameter,
    (num, den): (i128, i128),
    unit: &str,
    spaced: bool,
) -> Result<String, String> {
    let own = parameter.unit;
    let (num, den) = if unit == own && spaced {
        // As the table prints it; its number is a part of the unit.
        (num, den)
    } else {
        let Some(stored) = Unit::of(own) else {
            return Err(match own {
                "" | "Num" | "hex" | "Hex" | "flags" => "it has no unit; write the number alone".into(),
                own => format!("write the number in {own}, without the unit"),
            });
        };
        let written = Unit::of(unit).filter(|_| split(unit).0.is_empty());
        let Some(written) = written.filter(|written| written.base == stored.base) else {
            let accepted = accepted(parameter);
            return Err(format!("another unit; it is stored in {own}, and accepts {accepted}"));
        };
        (num * written.num * stored.den, den * written.den * stored.num)
    };
    let why = || format!("it is stored in steps of {}, and this is none; it is not rounded", step(own));
    digits(parameter.kind, num, den).ok_or_else(why)
}

/// A step of the stored value, in words: `1 mV`, `0.1°C`.
fn step(unit: &str) -> String {
    if split(unit).0.is_empty() { format!("1 {unit}") } else { unit.into() }
}

/// A fraction in digits, if the type can hold it exactly. A floating-point number may have any decimal number.
fn digits(kind: Type, num: i128, den: i128) -> Option<String> {
    let places = if kind == Type::F4 { 24 } else { 0 };
    let mut scaled = num;
    for place in 0..=places {
        if scaled % den == 0 {
            let (sign, whole) = (if scaled < 0 { "-" } else { "" }, (scaled / den).to_string());
            let whole = whole.trim_start_matches('-');
            let padded = format!("{whole:0>0$}", place + 1);
            let (whole, part) = padded.split_at(padded.len() - place);
            return Some(if part.is_empty() {
                format!("{sign}{whole}")
            } else {
                format!("{sign}{whole}.{part}")
            });
        }
        scaled = scaled.checked_mul(10)?;
    }
    None
}

/// The unit for [`crate::notation::show`]; empty for a date and for mere names.
pub fn shown(parameter: &Parameter) -> &'static str {
    match parameter.unit {
        date::UNIT | "hex" | "Hex" | "flags" | "Num" => "",
        unit => unit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::CHIPS;
    use crate::notation::{parse_with_unit as parse, show};
    use crate::value::Value;
    use crate::value::types::*;
    use proptest::prelude::*;

    const fn in_unit(unit: &'static str) -> Parameter {
        Parameter::int(0, I2, "Value", -32768, 32767, 0, unit)
    }

    fn stored(unit: &'static str, text: &str) -> Result<Value> {
        parse(&in_unit(unit), text)
    }

    #[test]
    fn units_are_converted_exactly() {
        for (unit, text, value) in [
            ("mV", "3.1V", 3100),
            ("mV", "3.1 V", 3100),
            ("mV", "3100mV", 3100),
            ("mV", "3100 mV", 3100),
            ("mV", "3100", 3100),
            ("mV", "0xc1c", 3100),
            ("mV", " +3.100V ", 3100),
            ("mV", "3100000uV", 3100),
            ("mV", "3100000µV", 3100),
            ("mV", "-0.5V", -500),
            ("mV", ".5V", 500),
            ("mV", "1.V", 1000),
            ("mA", "-2A", -2000),
            ("mAh", "2.2Ah", 2200),
            ("mAh", "2200mAh", 2200),
            ("mWh", "7.4Wh", 7400),
            ("cWh", "24.48Wh", 2448),
            ("0.01mAh", "1mAh", 100),
            ("mV/cell", "4.2V/cell", 4200),
            ("20mV", "3.1V", 155),
            ("20mV", "155 20mV", 155),
            ("4 mΩ", "40mohm", 10),
            ("4 mΩ", "0.04Ω", 10),
            ("3uA", "300uA", 100),
            ("294nV", "2.94uV", 10),
            ("0.1°C", "25degC", 250),
            ("0.1°C", "-12.5°C", -125),
            ("°C", "25degC", 25),
            ("0.1K", "298.2K", 2982),
            ("0.1K", "2982 0.1K", 2982),
            ("s", "2min", 120),
            ("s", "1.5h", 5400),
            ("s", "5000ms", 5),
            ("%", "7%", 7),
            ("0.1%", "7.5%", 75),
            ("0.01%", "7.55 %", 755),
            ("Hr rate", "5 Hr rate", 5),
        ] {
            assert_eq!(stored(unit, text), Ok(Value::Int(value)), "{text} in {unit}");
        }
    }

    #[test]
    fn a_wrong_or_inexact_unit_is_refused_with_what_is_accepted() {
        for (unit, text, says) in [
            ("mV", "3.1A", "another unit; it is stored in mV, and accepts mV or V"),
            ("mV", "3.1mv", "another unit; it is stored in mV, and accepts mV or V"),
            ("mV", "3.1V/cell", "another unit; it is stored in mV, and accepts mV or V"),
            ("mV", "3.1 mV mV", "another unit"),
            ("mV", "31 0.1V", "another unit"),
            ("mV", "3.1005V", "it is stored in steps of 1 mV, and this is none; it is not rounded"),
            ("mV", "3.1", "write a whole number, or one with mV or V"),
            ("mV", "", "write a whole number, or one with mV or V"),
            ("mV", "V", "write a whole number, or one with mV or V"),
            ("mV", "1e3V", "another unit"),
            ("mV", "3..1V", "write a whole number, or one with mV or V"),
            ("mV", "9999999999999999999V", "write a whole number, or one with mV or V"),
            ("mV", "40V", "the value is outside -32768 to 32767 mV"),
            ("mV", "999999999999999999V", "the value is outside -32768 to 32767 mV"),
            ("mV/cell", "4.2V", "accepts mV/cell or V/cell"),
            ("20mV", "3.11V", "it is stored in steps of 20mV, and this is none"),
            ("0.1°C", "25K", "it is stored in 0.1°C, and accepts degC"),
            // 25 °C are 298.15 K.
            ("0.1K", "25degC", "it is stored in 0.1K, and accepts K"),
            ("0.1°C", "25.05degC", "it is stored in steps of 0.1°C, and this is none"),
            ("mAh", "2V", "accepts mAh or Ah"),
            ("294nV", "1V/cell", "accepts nV, mV or V"),
            ("s", "2min/day", "accepts s, min or h"),
            ("Num", "5V", "it has no unit; write the number alone"),
            ("", "5V", "it has no unit; write the number alone"),
            ("mWh/cWh", "5Wh", "write the number in mWh/cWh, without the unit"),
            ("Hr rate", "5h", "write the number in Hr rate, without the unit"),
        ] {
            let error = stored(unit, text).expect_err(text).to_string();
            assert!(error.starts_with("Value: ") && error.contains(says), "{text} in {unit}: {error}");
        }
    }

    #[test]
    fn a_number_with_a_unit_is_measured_in_another_one() {
        for (text, unit, number) in [
            ("3.1V", "uV", 3_100_000.0),
            ("-0.5 A", "uA", -500_000.0),
            ("1.5kWh", "uWh", 1.5e9),
            ("-5.5C", "0.1°C", -55.0),
            ("3.14159V", "mV", 3141.59),
            ("2d", "s", 172_800.0),
            ("1.5s", "ms", 1500.0),
            ("318.15K", "0.1K", 3181.5),
            ("20min", "5min", 4.0),
            ("999999999999999999d", "ns", 999_999_999_999_999_999.0 * 86400.0 * 1e9),
        ] {
            assert_eq!(measured(text, unit), Some(number), "{text} in {unit}");
        }
        for (text, unit) in [
            ("3.1", "uV"),
            ("3.1A", "uV"),
            ("3.1V/cell", "uV"),
            ("V", "uV"),
            ("3.1 1V", "uV"),
            ("5Num", "Num"),
            ("25C", "0.1K"),
            ("9999999999999999999V", "uV"),
        ] {
            assert_eq!(measured(text, unit), None, "{text} in {unit}");
        }
    }

    #[test]
    fn a_date_is_a_date_or_its_number() {
        let date = Parameter::int(2, U2, "Manufacture Date", 0, 65535, 0, date::UNIT);
        for text in ["2012-05-23", "16567", "0x40b7"] {
            assert_eq!(parse(&date, text), Ok(Value::Int(16567)), "{text}");
        }
        assert_eq!(show(&date, &Value::Int(16567)), "2012-05-23");
        assert_eq!(show(&date, &Value::Int(0)), "0");
        let error = parse(&date, "2012-02-30").expect_err("no such day").to_string();
        assert_eq!(
            error,
            "Manufacture Date: write a day from 1980-01-01 to 2107-12-31, or the stored number"
        );
    }

    #[test]
    fn a_number_with_a_point_is_exact_in_decimal() {
        let gain = Parameter::float(0, "CC Gain", 0.1, 40.0, 0.4768, "mΩ");
        for text in ["0.4768", "0.4768mΩ", "0.4768 mohm", "476.8uohm", "0.0004768Ω"] {
            assert_eq!(parse(&gain, text), Ok(Value::Float(0.4768)), "{text}");
        }
    }

    /// Every unit of the tables is either converted, or known to be a name.
    #[test]
    fn every_unit_of_the_tables_is_known() {
        let names = [
            "",
            "Num",
            "hex",
            "Hex",
            "flags",
            "Counts",
            "readings",
            "0.1 Hr rate",
            "Hr rate",
            "2^-10 Ω",
            "mWh/cWh",
            "mW/cW",
            date::UNIT,
        ];
        for parameter in CHIPS.iter().flat_map(|chip| chip.subclasses).flat_map(|row| row.parameters) {
            let unit = parameter.unit;
            assert_eq!(Unit::of(unit).is_none(), names.contains(&unit), "{}: `{unit}`", parameter.name);
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn what_is_shown_with_its_unit_is_read_again() {
        let config = ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() };
        proptest!(config, |(place in 0.0..=1.0)| {
            for parameter in CHIPS.iter().flat_map(|chip| chip.subclasses).flat_map(|row| row.parameters) {
                let crate::chip::Range::Int { min, max, .. } = parameter.range else { continue };
                let value = Value::Int(min + ((max - min) as f64 * place) as i64);
                let shown = show(parameter, &value);
                prop_assert_eq!(parse(parameter, &shown), Ok(value.clone()), "{}", shown);
                if matches!(parameter.kind, Type::H(_)) {
                    continue;
                }
                let with_unit = crate::quantity::with_unit(&shown, super::shown(parameter));
                prop_assert_eq!(parse(parameter, &with_unit), Ok(value), "{}", with_unit);
            }
        });
    }
}
