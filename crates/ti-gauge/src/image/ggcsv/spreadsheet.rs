// SPDX-License-Identifier: MIT

//! Traces of a spreadsheet, which saves texts that look like numbers or dates as it shows them.

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
    const MONTHS: [&str; 12] =
        ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
    let parts: Vec<&str> = shown.split(['-', '/', '.', ' ']).filter(|part| !part.is_empty()).collect();
    let month = |part: &str| {
        let part = part.to_lowercase();
        part.len() == 3 && MONTHS.contains(&&*part)
    };
    let number =
        |part: &str| matches!(part.len(), 1 | 2 | 4) && part.bytes().all(|byte| byte.is_ascii_digit());
    let named = parts.iter().filter(|part| month(part)).count();
    let numbers = parts.iter().filter(|part| number(part)).count();
    named + numbers == parts.len() && matches!((named, numbers), (1, 1 | 2) | (0, 3))
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
}
