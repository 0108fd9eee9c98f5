// SPDX-License-Identifier: MIT

//! Dates as TI packs them into a word: `Day+Mo*32+(Yr-1980)*512`.

/// The unit of a date in the manuals.
pub const UNIT: &str = "Day+Mo*32+(Yr-1980)*512";
const FIRST_YEAR: i64 = 1980;

/// Year, month and day of a stored word; `None` for anything but a date, such as 0.
pub fn of(stored: i64) -> Option<[i64; 3]> {
    let date @ [year, month, day] = [FIRST_YEAR + (stored >> 9), stored >> 5 & 15, stored & 31];
    (0..=0xffff).contains(&stored).then_some(())?;
    (1..=days(year, month)?).contains(&day).then_some(date)
}

/// A stored word as `2026-11-22`, if it is a date.
pub fn text(stored: i64) -> Option<String> {
    of(stored).map(|[year, month, day]| format!("{year}-{month:02}-{day:02}"))
}

/// The word for `2026-11-22`, if the day exists and its year can be stored.
pub fn parse(text: &str) -> Option<i64> {
    let fields: Vec<&str> = text.split('-').collect();
    let [year, month, day] = fields[..] else { return None };
    let number = |text: &str, digits: usize| {
        let is_number = text.len() == digits && text.bytes().all(|byte| byte.is_ascii_digit());
        if is_number { text.parse::<i64>().ok() } else { None }
    };
    let (year, month, day) = (number(year, 4)?, number(month, 2)?, number(day, 2)?);
    let stored = (year - FIRST_YEAR) << 9 | month << 5 | day;
    (of(stored)? == [year, month, day]).then_some(stored)
}

fn days(year: i64, month: i64) -> Option<i64> {
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    Some(match month {
        2 => 28 + i64::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn every_word_is_one_date_or_none() {
        let mut dates = 0;
        for stored in 0..=0xffff {
            let Some(text) = text(stored) else { continue };
            assert_eq!(parse(&text), Some(stored), "{text}");
            dates += 1;
        }
        // The days from 1980 to 2107, of which 31 years are leap years: 2100 is none.
        assert_eq!(dates, 128 * 365 + 31);
        assert_eq!(text(16567).as_deref(), Some("2012-05-23"));
        assert_eq!(parse("2026-11-22"), Some(46 << 9 | 11 << 5 | 22));
    }

    #[test]
    fn what_is_no_date_is_refused() {
        for text in [
            "1979-12-31",
            "2108-01-01",
            "2026-02-29",
            "2100-02-29",
            "2026-13-01",
            "2026-00-01",
            "2026-01-00",
            "2026-1-1",
            "26-01-01",
            "2026-01-32",
            "2026-01",
            "2026-01-01-01",
            "+026-01-01",
            "2026/01/01",
            "",
            "--",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
        for stored in [-1, 0, 0x10000, i64::MAX, i64::MIN] {
            assert_eq!(text(stored), None, "{stored}");
        }
    }
}
