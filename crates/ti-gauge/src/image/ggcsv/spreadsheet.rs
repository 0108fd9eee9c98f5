// SPDX-License-Identifier: MIT

//! Traces of a spreadsheet, which saves texts that look like numbers or dates as it shows them.

use crate::text;

/// What separates thousands somewhere, or stands for the decimal point.
const MARKS: [char; 6] = [',', '.', '\'', ' ', '\u{a0}', '\u{202f}'];
/// Digits that a spreadsheet keeps of a number.
const KEPT: usize = 15;
const MONTHS: [&str; 12] =
    ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// Why a value needs the bytes beside it: it is quoted, or has a spreadsheet's form of a number or a date.
pub(super) fn trace(shown: &str) -> Option<&'static str> {
    let is_in = |quote: char| shown.len() > 1 && shown.starts_with(quote) && shown.ends_with(quote);
    if is_in('"') || is_in('\'') {
        return Some("it is in quotes, which would be written");
    }
    if !shown.is_empty() && shown.chars().all(|letter| letter == '#') {
        return Some(
            "a spreadsheet shows # where a column is too narrow; make it wider, and save the file again",
        );
    }
    if is_rounded(shown) {
        return Some("a spreadsheet has rounded it; import the column as text");
    }
    is_date(shown).then_some("a spreadsheet has made a date of it; import the column as text")
}

/// Two decimals and an exponent of at least two digits, as for an overlong number: `1.23E+05`.
fn is_rounded(shown: &str) -> bool {
    let digits =
        |text: &str, least: usize| text.len() >= least && text.bytes().all(|byte| byte.is_ascii_digit());
    let Some((number, exponent)) = shown.trim_start_matches('-').split_once('E') else { return false };
    let Some((whole, part)) = number.split_once(['.', ',']) else { return false };
    let is_number = whole.len() == 1 && digits(whole, 1) && part.len() == 2 && digits(part, 2);
    is_number && exponent.strip_prefix(['+', '-']).is_some_and(|exponent| digits(exponent, 2))
}

/// A day and a month by name or number, with or without a year: `1-Mar`, `Mar-07`, `03.11.2026`, `2026-03-11`.
fn is_date(shown: &str) -> bool {
    date(shown).is_some()
}

/// The numbers of a date, with its month's first if it has a name.
fn date(shown: &str) -> Option<Vec<u32>> {
    let parts: Vec<&str> = shown.split(['-', '/', '.', ' ']).filter(|part| !part.is_empty()).collect();
    let month = |part: &&str| (1..).zip(MONTHS).find(|(_, name)| part.eq_ignore_ascii_case(name));
    let number =
        |part: &&str| matches!(part.len(), 1 | 2 | 4) && part.bytes().all(|byte| byte.is_ascii_digit());
    let named: Vec<u32> = parts.iter().filter_map(month).map(|(at, _)| at).collect();
    let numbers = parts.iter().filter(|part| number(part)).filter_map(|part| part.parse().ok());
    let all: Vec<u32> = named.iter().copied().chain(numbers).collect();
    let is_one = all.len() == parts.len() && matches!((named.len(), all.len()), (1, 2 | 3) | (0, 3));
    is_one.then_some(all)
}

/// Whether a spreadsheet that takes a text of two numbers for a day and a month, or a month and a year, shows this date.
fn is_date_of(shown: &str, text: &str) -> bool {
    let numbers = text.split(['-', '/', '.']).map(|part| part.parse().ok()).collect::<Option<Vec<u32>>>();
    let (Some(shown), Some([one, other])) = (date(shown), numbers.as_deref()) else { return false };
    let mut two = shown.iter().filter(|number| **number < 32 && [one, other].contains(number));
    let is_year = |number: &u32| shown[1..].contains(&(number % 100)) || shown.contains(number);
    match two.next() {
        Some(first) if one == other => first == one,
        Some(first) => is_year(if first == one { other } else { one }),
        None => false,
    }
}

/// Whether a spreadsheet that takes a text for a number or a date shows it like this, and no person would.
pub(super) fn shows(shown: &str, text: &str) -> bool {
    let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
    let is = |stored: f64| match is_rounded(shown) {
        true => {
            let exact = format!("{stored:.2E}");
            let parts = |text: &str| {
                let (number, exponent) = text.split_once('E')?;
                Some((number.replace(',', "."), exponent.parse::<i32>().ok()?))
            };
            parts(shown) == parts(&exact)
        }
        false => readings(shown).iter().any(|reading| number(reading) == Some(stored)),
    };
    number(text).is_some_and(is) || is_date_of(shown, text)
}

/// The numbers that a cell may stand for. Whether a comma or a point separates thousands depends on the country.
pub(super) fn readings(shown: &str) -> Vec<String> {
    let (sign, number) = shown.strip_prefix('-').map_or(("", shown), |number| ("-", number));
    let marks: Vec<char> = number.chars().filter(|letter| !letter.is_ascii_digit()).collect();
    let groups: Vec<&str> = number.split(MARKS).collect();
    let (Some(parts), Some((last, whole))) = (groups.len().checked_sub(1), groups.split_last()) else {
        return Vec::new();
    };
    if parts != marks.len() || groups.iter().any(|group| group.is_empty()) {
        return Vec::new();
    }
    let in_thousands = grouped(&groups, &marks);
    let before =
        marks.split_last().filter(|(point, before)| [',', '.'].contains(*point) && !before.contains(point));
    let with_point = before.and_then(|(_, before)| Some(format!("{}.{last}", grouped(whole, before)?)));
    in_thousands.into_iter().chain(with_point).map(|number| format!("{sign}{number}")).collect()
}

/// The digits of groups of thousands, or of one group.
fn grouped(groups: &[&str], marks: &[char]) -> Option<String> {
    let (first, others) = groups.split_first()?;
    let is_one = others.is_empty();
    let are_thousands = marks.iter().all(|mark| *mark == marks[0])
        && (1..=3).contains(&first.len())
        && !first.starts_with('0')
        && others.iter().all(|group| group.len() == 3);
    (is_one || are_thousands).then(|| groups.concat())
}

/// The bytes in a column of hexadecimal digits, whose leading zeros a spreadsheet has removed if all digits are decimal.
pub(super) fn bytes(shown: &str, size: usize) -> Option<Vec<u8>> {
    let may_lack =
        shown.len() <= KEPT && shown.bytes().all(|byte| byte.is_ascii_digit()) && !shown.is_empty();
    let width = if may_lack { 2 * size } else { 0 };
    text::unhex(format!("{shown:0>width$}").as_bytes()).filter(|bytes| bytes.len() == size)
}

/// Whether a spreadsheet that takes a text for a number shows it like this: `7` for `007`.
pub(super) fn is_number_of(shown: &str, text: &str) -> bool {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    shown != text && number(shown).is_some() && number(shown) == number(text)
}

/// Whether a number has lost its point, which separates thousands in some countries.
pub(super) fn has_lost_its_point(shown: &str, number: &str) -> bool {
    let digits = |text: &str| {
        let digits = text.trim_start_matches('-').replace('.', "");
        digits.trim_matches('0').to_string()
    };
    !shown.contains('.') && !digits(shown).is_empty() && digits(shown) == digits(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_spreadsheet_has_changed_is_recognised() {
        for (shown, why) in [
            ("1.23E+05", "rounded"),
            ("-1,23E-07", "rounded"),
            ("1.00E+100", "rounded"),
            ("####", "narrow"),
            ("1-Mar", "date"),
            ("Mar-07", "date"),
            ("31.Oct", "date"),
            ("3/11/2026", "date"),
            ("2026-11-03", "date"),
            ("1 Dec 2026", "date"),
            ("\"ACME\"", "quotes"),
            ("'ACME'", "quotes"),
        ] {
            assert!(trace(shown).is_some_and(|found| found.contains(why)), "{shown}");
        }
        for shown in [
            "",
            "ACME",
            "3100",
            "31.1",
            "5.595681e+05",
            "1e10",
            "00E5",
            "1-2",
            "PACK-7",
            "4S-2200",
            "Mar",
            "\"",
            "5\" pack",
            "#1",
            "1.2.3456789",
        ] {
            assert_eq!(trace(shown), None, "{shown}");
        }
        assert!(is_number_of("7", "007") && is_number_of("1.5", "1.50") && is_number_of("100000", "1e5"));
        assert!(!is_number_of("7", "7") && !is_number_of("8", "007") && !is_number_of("ACME", "007"));
        assert!(has_lost_its_point("5006", "5.006") && has_lost_its_point("-3110", "-31.1"));
        assert!(!has_lost_its_point("5.006", "5.006") && !has_lost_its_point("0", "0.000"));
    }

    #[test]
    fn a_cell_stands_for_one_number_or_for_two() {
        for (shown, numbers) in [
            ("3100", &["3100"][..]),
            ("31,1", &["31.1"]),
            ("-0,123", &["-0.123"]),
            ("3,100", &["3100", "3.100"]),
            ("3.100", &["3100", "3.100"]),
            ("1.234,5", &["1234.5"]),
            ("1,234,567", &["1234567"]),
            ("1 234,5", &["1234.5"]),
            ("1\u{202f}234", &["1234"]),
            ("12'345.6", &["12345.6"]),
            ("1,23,456", &[]),
            ("1.2.3", &[]),
            ("1 23", &[]),
            ("0,1,2", &[]),
            (",5", &[]),
            ("3,1V", &[]),
            ("-", &[]),
            ("", &[]),
        ] {
            assert_eq!(readings(shown), numbers, "{shown}");
        }
    }

    #[test]
    fn what_a_spreadsheet_shows_of_a_text_is_recognised() {
        for (shown, text) in [
            ("1.20E+04", "12e3"),
            ("1,23E+05", "123456"),
            ("-1.00E-07", "-0.0000001"),
            ("3,1", "3.100"),
            ("3.100", "3100"),
            ("1 200,5", "1200.50"),
            ("1-Mar", "1-3"),
            ("3-Jan", "1-3"),
            ("03.11.2026", "3.11"),
            ("2026-11-03", "11/3"),
            ("Nov-07", "11.07"),
            ("Mar-07", "3-2007"),
            ("3-Mar", "3.3"),
        ] {
            assert!(shows(shown, text), "{shown} of {text}");
        }
        for (shown, text) in [
            ("1.20E+04", "12500"),
            ("1.20E+05", "12e3"),
            ("3,1", "3.2"),
            ("31", "3.1"),
            ("1-Mar", "1-4"),
            ("03.11.2026", "3.12"),
            ("3-Mar", "3.4"),
            ("ACME", "ACME"),
            ("inf", "inf"),
        ] {
            assert!(!shows(shown, text), "{shown} of {text}");
        }
    }

    #[test]
    fn zeros_in_front_of_bytes_come_back() {
        assert_eq!(bytes("0c1c", 2), Some(vec![0x0c, 0x1c]));
        assert_eq!(bytes("226", 2), Some(vec![0x02, 0x26]));
        assert_eq!(bytes("0", 2), Some(vec![0, 0]));
        for (shown, size) in [("", 2), ("c1c", 2), ("22600", 2), ("2.26E+02", 2), ("1234567890123456", 12)] {
            assert_eq!(bytes(shown, size), None, "{shown}");
        }
    }
}
