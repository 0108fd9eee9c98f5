// SPDX-License-Identifier: MIT

//! Text: notations of numbers and bytes, and safe display. Pure: no bus, no file.

/// A number without a sign, as in file names: decimal, or hexadecimal after `0x`.
pub fn unsigned<T: TryFrom<u64>>(text: &str) -> Option<T> {
    let (radix, digits) = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => (16, digits),
        None => (10, text),
    };
    let number =
        digits.chars().all(|digit| digit.is_digit(radix)).then(|| u64::from_str_radix(digits, radix).ok());
    number.flatten()?.try_into().ok()
}

/// Longest text of a message, in characters.
const LONGEST: usize = 2000;

/// Whether a character neither begins a line, nor controls a terminal, nor reorders text.
pub fn is_plain(letter: char) -> bool {
    let reorders = matches!(
        letter,
        '\u{61c}'
            | '\u{200e}'
            | '\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2066}'..='\u{2069}'
            | '\u{feff}'
    );
    !(letter.is_control() || reorders)
}

fn push(shown: &mut String, letter: char) {
    if is_plain(letter) { shown.push(letter) } else { shown.extend(letter.escape_default()) }
}

/// A text of unknown origin made safe for a terminal or a log: a character that would begin a line, control a terminal or
/// reorder text becomes an escape. A text that is too long ends with `...`. Applying it twice changes nothing.
pub fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    text.chars().take(LONGEST + 4).for_each(|letter| push(&mut shown, letter));
    if shown.chars().nth(LONGEST + 3).is_some() {
        let end = shown.char_indices().nth(LONGEST).map_or(shown.len(), |(at, _)| at);
        shown.replace_range(end.., "...");
    }
    shown
}

/// Like [`printable`], but line ends and tabs remain.
pub fn lines(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        if matches!(letter, '\n' | '\t') { shown.push(letter) } else { push(&mut shown, letter) }
    }
    shown
}

/// Two hexadecimal digits per byte.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The reverse of [`hex`]; `None` for any other text.
pub fn unhex(digits: &[u8]) -> Option<Vec<u8>> {
    let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
    let byte = |pair: &[u8]| Some(digit(pair[0])? << 4 | digit(pair[1])?);
    if digits.len().is_multiple_of(2) { digits.chunks_exact(2).map(byte).collect() } else { None }
}

/// The known name closest to a misspelt word, if one is close enough: first by its parts, then by its letters.
pub fn nearest<'a>(word: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let names: Vec<&str> = names.collect();
    let parts = with_parts(word, names.iter().map(|&name| (name, name)));
    parts.into_iter().next().or_else(|| {
        let tolerated = 1 + word.len() / 4;
        // Too many letters are also wrong letters, and there may be very many.
        let names = names.into_iter().filter(|name| word.chars().count().abs_diff(name.len()) <= tolerated);
        let (wrong, name) = names.map(|name| (strsim::damerau_levenshtein(word, name), name)).min()?;
        (wrong <= tolerated).then_some(name)
    })
}

/// Names with all parts of a text, words or their beginnings: `voltage_now` for `voltage`; fewest other parts first.
pub fn with_parts<'a, T>(text: &str, names: impl Iterator<Item = (&'a str, T)>) -> Vec<T> {
    const LONGEST: usize = 64;
    const SHORTEST: usize = 3;
    let parts = |text: &str| -> Vec<String> {
        let words = text.split(|letter: char| !letter.is_ascii_alphanumeric());
        words.filter(|word| !word.is_empty()).map(str::to_ascii_lowercase).collect()
    };
    if text.len() > LONGEST || text.chars().filter(char::is_ascii_alphanumeric).count() < SHORTEST {
        return Vec::new();
    }
    let wanted = parts(text);
    let mut found: Vec<((usize, usize), T)> = names
        .filter_map(|(name, named)| {
            let words = parts(name);
            let whole = wanted.iter().filter(|part| words.contains(part)).count();
            let begins = |part: &String| words.iter().any(|word| word.starts_with(part.as_str()));
            let has_all = wanted.iter().all(begins);
            has_all.then(|| ((words.len().saturating_sub(wanted.len()), wanted.len() - whole), named))
        })
        .collect();
    found.sort_by_key(|(others, _)| *others);
    found.into_iter().map(|(_, named)| named).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cases(cases: u32) -> ProptestConfig {
        ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
    }

    #[test]
    fn the_name_that_was_meant_has_the_parts_or_the_letters() {
        let names = ["voltage_min_design", "voltage_now", "gauge/registers/voltage", "capacity", "status"];
        for (word, meant) in [
            ("voltage", Some("voltage_now")),
            ("Voltage Now", Some("voltage_now")),
            ("registers/voltage", Some("gauge/registers/voltage")),
            ("design-volt", Some("voltage_min_design")),
            ("capcity", Some("capacity")),
            ("volatge_now", Some("voltage_now")),
            ("voltage_elsewhere", None),
            ("no", None),
            ("", None),
        ] {
            assert_eq!(nearest(word, names.into_iter()), meant, "{word}");
        }
        assert_eq!(with_parts(&"voltage".repeat(1000), names.iter().map(|name| (*name, ()))), []);
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn printable_text_is_one_line_without_control_characters() {
        let text = "Größe 5 µV ✓\n\r\t\x1b[2J\x07\0\x7f\u{85}\u{9b}\u{202e}\u{2028}\\n";
        let shown = "Größe 5 µV ✓\\n\\r\\t\\u{1b}[2J\\u{7}\\u{0}\\u{7f}\\u{85}\\u{9b}\\u{202e}\\u{2028}\\n";
        assert_eq!(printable(text), shown);
        proptest!(cases(256), |(text: String)| {
            let shown = printable(&text);
            prop_assert!(!shown.contains(char::is_control));
            prop_assert_eq!(printable(&shown), shown);
        });
        for length in [LONGEST - 1, LONGEST, LONGEST + 3, LONGEST + 4, 10 * LONGEST] {
            let shown = printable(&"é".repeat(length));
            assert_eq!(shown.chars().count(), length.min(LONGEST + 3));
            assert_eq!(shown.ends_with("..."), length > LONGEST + 3);
            assert_eq!(printable(&shown), shown);
        }
        assert_eq!(printable(&"\x1b".repeat(LONGEST)).chars().count(), LONGEST + 3);
    }
}
