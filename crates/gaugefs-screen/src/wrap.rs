// SPDX-License-Identifier: MIT

use std::mem::take;

/// The lines of a text at this width. Longer words are broken.
pub(super) fn wrapped(text: &str, width: usize) -> Vec<String> {
    let (width, count) = (width.max(1), |line: &str| line.chars().count());
    let (mut lines, mut line) = (Vec::new(), String::new());
    for word in text.split(' ') {
        if !line.is_empty() && count(&line) + 1 + count(word) > width {
            lines.push(take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        for letter in word.chars() {
            if count(&line) == width {
                lines.push(take(&mut line));
            }
            line.push(letter);
        }
    }
    lines.push(line);
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_as_wide_as_allowed_and_nothing_is_lost() {
        assert_eq!(wrapped("", 5), [""]);
        assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
        assert_eq!(wrapped("a /var/lib/gaugefs", 6), ["a", "/var/l", "ib/gau", "gefs"]);
        assert_eq!(wrapped("one", 0), ["o", "n", "e"]);
    }
}
