// SPDX-License-Identifier: MIT

//! Numbers with units for people. A table counts in steps such as `0.1°C` or `20mV`.

/// Units with prefixes: a thousand of one are shown as one of the next.
const PREFIXED: [&str; 6] = ["V", "A", "Ah", "W", "Wh", "Ω"];
const PREFIXES: [(char, &str); 3] = [('n', "u"), ('u', "m"), ('m', "")];

/// A number at the start of a text, and the rest.
pub(crate) fn split(text: &str) -> (&str, &str) {
    let is_of_number = |letter: char| letter.is_ascii_digit() || ".+-".contains(letter);
    let end = text.find(|letter| !is_of_number(letter)).unwrap_or(text.len());
    (&text[..end], text[end..].trim_start())
}

/// A number of steps for people: 550 of `0.1°C` are `55.0 °C`. `None` for a unit without steps.
fn readable(number: i64, unit: &str) -> Option<String> {
    let (step, name) = split(unit);
    if step.is_empty() || name.is_empty() || name.contains(|letter: char| letter.is_ascii_digit()) {
        return None;
    }
    let mut places = step.split_once('.').map_or(0, |(_, part)| part.len());
    let mut step = step.replace('.', "").parse::<i128>().ok()?;
    let mut name = name.to_string();
    let number = i128::from(number);
    let thousand = |places: usize| 1000 * 10_i128.pow(places as u32);
    while let Some(next) = larger(&name).filter(|_| (number * step).abs() >= thousand(places)) {
        (name, places) = (next, places + 3);
        while places > 0 && step % 10 == 0 {
            (step, places) = (step / 10, places - 1);
        }
    }
    let (sign, digits) = (if number * step < 0 { "-" } else { "" }, (number * step).abs());
    let digits = format!("{digits:0>0$}", places + 1);
    let (whole, part) = digits.split_at(digits.len() - places);
    let point = if places > 0 { "." } else { "" };
    Some(format!("{sign}{whole}{point}{part} {name}"))
}

fn larger(name: &str) -> Option<String> {
    let mut letters = name.chars();
    let (_, next) = PREFIXES.iter().find(|(prefix, _)| letters.clone().next() == Some(*prefix))?;
    letters.next();
    PREFIXED.contains(&letters.as_str()).then(|| format!("{next}{}", letters.as_str()))
}

/// A value with its unit: `3100 mV`. With steps, the value comes before the stored number: `55.0 °C (550)`.
pub fn with_unit(text: &str, unit: &str) -> String {
    match text.parse().ok().and_then(|number| readable(number, unit)) {
        Some(value) => format!("{value} ({text})"),
        None if unit.is_empty() => text.into(),
        None => format!("{text} {unit}"),
    }
}

/// A changed value with its unit: `3000 -> 3100 mV`.
pub fn change(old: &str, new: &str, unit: &str) -> String {
    pair(old, " -> ", new, unit)
}

pub(crate) fn pair(first: &str, between: &str, second: &str, unit: &str) -> String {
    let values = [first, second].map(|text| text.parse().ok().and_then(|number| readable(number, unit)));
    match values {
        [Some(_), _] | [_, Some(_)] => {
            format!("{}{between}{}", with_unit(first, unit), with_unit(second, unit))
        }
        [None, None] => format!("{first}{between}{}", with_unit(second, unit)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_in_steps_is_shown_as_a_person_reads_it() {
        for (text, unit, shown) in [
            ("550", "0.1°C", "55.0 °C (550)"),
            ("-5", "0.1°C", "-0.5 °C (-5)"),
            ("0", "0.1°C", "0.0 °C (0)"),
            ("320", "20mV", "6.40 V (320)"),
            ("30", "20mV", "600 mV (30)"),
            ("10", "4 mΩ", "40 mΩ (10)"),
            ("400", "3uA", "1.200 mA (400)"),
            ("10", "294nV", "2.940 uV (10)"),
            ("100", "0.01mAh", "1.00 mAh (100)"),
            ("2982", "0.1K", "298.2 K (2982)"),
            ("20", "5min", "100 min (20)"),
            ("80", "0.0025%/day", "0.2000 %/day (80)"),
            ("5", "0.1 Hr rate", "0.5 Hr rate (5)"),
            ("3100", "mV", "3100 mV"),
            ("25", "°C", "25 °C"),
            ("7", "256 x 3.57 uVh", "7 256 x 3.57 uVh"),
            ("0x0161", "", "0x0161"),
            ("2026-11-22", "", "2026-11-22"),
            ("0.5", "mΩ", "0.5 mΩ"),
        ] {
            assert_eq!(with_unit(text, unit), shown);
        }
        assert_eq!(change("3000", "3100", "mV"), "3000 -> 3100 mV");
        assert_eq!(change("550", "600", "0.1°C"), "55.0 °C (550) -> 60.0 °C (600)");
        assert_eq!(pair("0", " to ", "1200", "0.1°C"), "0.0 °C (0) to 120.0 °C (1200)");
        assert_eq!(readable(i64::MIN, "0.1°C").as_deref(), Some("-922337203685477580.8 °C"));
    }
}
