// SPDX-License-Identifier: MIT

//! Rows of a gg.csv. The crate `csv` would accept an open quote, text after a quote, and a blank before one.

/// A row: its first line, and its fields or why they are unreadable.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Row {
    pub(super) number: usize,
    pub(super) fields: Result<Vec<String>, &'static str>,
}

const QUOTE: char = '"';
const ENDS: [char; 2] = ['\r', '\n'];

const OPEN: &str = "a quote that is opened is never closed";
const BEHIND: &str = "text behind a closing quote; a quote within a field is written twice";

/// The separator of a row's fields, by the row that names the columns, whose names contain none of these.
pub(super) fn separator(names: &str) -> char {
    names.chars().find(|letter| [',', ';', '\t'].contains(letter)).unwrap_or(',')
}

/// All rows with content. A comment, `*` without a quote, ends with its line: its text closes no quote.
pub(super) fn rows(text: &str, comma: char) -> Vec<Row> {
    let (mut rows, mut rest, mut number) = (Vec::new(), text, 1);
    while !rest.is_empty() {
        let line = rest.split(ENDS).next().unwrap_or_default();
        let is_comment = line.trim_start().starts_with('*');
        let (fields, read) = row(if is_comment { line } else { rest }, comma);
        let fields = fields.or_else(|why| if is_comment { Ok(vec![line.into()]) } else { Err(why) });
        let read = if is_comment { line.len() } else { read };
        if !fields.as_ref().is_ok_and(|fields| fields.iter().all(|field| field.trim().is_empty())) {
            rows.push(Row { number, fields });
        }
        let (before, behind) = rest.split_at(read);
        let end = if behind.starts_with("\r\n") { 2 } else { 1 };
        rest = behind.get(end..).unwrap_or_default();
        number += 1 + lines_in(before);
    }
    rows
}

/// A field as it is written: in quotes only if a reader would misread it otherwise.
pub(super) fn quoted(field: &str) -> String {
    if field.contains(QUOTE) { format!("\"{}\"", field.replace(QUOTE, "\"\"")) } else { field.into() }
}

fn lines_in(text: &str) -> usize {
    text.matches(ENDS).count() - text.matches("\r\n").count()
}

fn row(text: &str, comma: char) -> (Result<Vec<String>, &'static str>, usize) {
    let (mut fields, mut rest) = (Vec::new(), text);
    loop {
        match field(rest, comma) {
            Ok((field, behind)) => {
                fields.push(field);
                let Some(next) = behind.strip_prefix(comma) else {
                    return (Ok(fields), text.len() - behind.len());
                };
                rest = next;
            }
            // The rest would all be in this field.
            Err((OPEN, _)) => return (Err(OPEN), text.len()),
            Err((why, at)) => return (Err(why), text.len() - at.len() + at.find(ENDS).unwrap_or(at.len())),
        }
    }
}

fn field(text: &str, comma: char) -> Result<(String, &str), (&'static str, &str)> {
    let is_blank = |letter: char| letter == ' ' || (letter == '\t' && letter != comma);
    let Some(mut rest) = text.trim_start_matches(is_blank).strip_prefix(QUOTE) else {
        let (field, behind) = text.split_at(text.find([comma, ENDS[0], ENDS[1]]).unwrap_or(text.len()));
        return Ok((field.trim().into(), behind));
    };
    let mut field = String::new();
    loop {
        let (inside, behind) = rest.split_once(QUOTE).ok_or((OPEN, rest))?;
        field += inside;
        let Some(more) = behind.strip_prefix(QUOTE) else {
            let behind = behind.trim_start_matches(is_blank);
            let ends = behind.is_empty() || behind.starts_with([comma, ENDS[0], ENDS[1]]);
            return if ends { Ok((field, behind)) } else { Err((BEHIND, behind)) };
        };
        field.push(QUOTE);
        rest = more;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Vec<(usize, Result<Vec<String>, &'static str>)> {
        rows(text, ',').into_iter().map(|row| (row.number, row.fields)).collect()
    }

    fn fields(fields: &[&str]) -> Result<Vec<String>, &'static str> {
        Ok(fields.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn a_row_is_read_with_and_without_quotes() {
        for (text, row) in [
            ("a, b ,c", &["a", "b", "c"][..]),
            ("\"a\",\"b\",\"c\"", &["a", "b", "c"]),
            (" \"a\" , \"b, \"\"b\"\"\",c\t", &["a", "b, \"b\"", "c"]),
            ("\" a \",5\" pack,\"\"", &[" a ", "5\" pack", ""]),
            ("\"a\r\nb\",c", &["a\r\nb", "c"]),
            ("\"\"\"a\"\"\",b", &["\"a\"", "b"]),
        ] {
            assert_eq!(read(text), [(1, fields(row))], "{text}");
        }
    }

    #[test]
    fn lines_end_as_any_system_ends_them_and_are_counted() {
        for end in ["\n", "\r\n", "\r"] {
            let text =
                ["* it's \"a comment\", \"open", "a,\"b", "b\",c", ",,", "\"x\"y,z", "e", "\"f"].join(end);
            let b = format!("b{end}b");
            let expected = [
                (1, fields(&["* it's \"a comment\", \"open"])),
                (2, fields(&["a", &b, "c"])),
                (5, Err(BEHIND)),
                (6, fields(&["e"])),
                (7, Err(OPEN)),
            ];
            assert_eq!(read(&text), expected, "{end:?}");
        }
    }

    #[test]
    fn a_separator_is_found_in_quotes_and_without() {
        for (names, comma) in [
            (" Class name, SubClass name", ','),
            (" Class name;SubClass name", ';'),
            (" Class name\tSubClass name", '\t'),
            (" Class name\",\"SubClass name\"", ','),
            ("Class name", ','),
        ] {
            assert_eq!(separator(names), comma, "{names}");
        }
    }

    /// What the crate `csv` writes, in whatever manner of quoting, is read as it was.
    #[test]
    fn what_another_writer_has_quoted_is_read_as_it_was() {
        let cell = "[a-z0-9 ,;\"\t.%_]{0,6}";
        let table = prop::collection::vec(prop::collection::vec(cell, 1..5), 1..5);
        let config = ProptestConfig { failure_persistence: None, ..ProptestConfig::default() };
        proptest!(config, |(table in table, always: bool, at in 0_usize..3)| {
            let comma = [',', ';', '\t'][at];
            let quotes = if always { csv::QuoteStyle::Always } else { csv::QuoteStyle::Necessary };
            let mut writer = csv::WriterBuilder::new();
            let writer = writer.delimiter(comma as u8).quote_style(quotes).flexible(true);
            let mut writer = writer.from_writer(Vec::new());
            for row in &table {
                writer.write_record(row).expect("memory is written to");
            }
            let text = String::from_utf8(writer.into_inner().expect("memory is written to")).expect("text");
            let found: Vec<_> = rows(&text, comma).into_iter().map(|row| row.fields.expect("valid")).collect();
            let trimmed = |rows: &[Vec<String>]| -> Vec<Vec<String>> {
                let trim = |row: &Vec<String>| row.iter().map(|field| field.trim().to_string()).collect();
                let full = |row: &Vec<String>| row.iter().any(|field| !field.is_empty());
                rows.iter().map(trim).filter(full).collect()
            };
            prop_assert_eq!(trimmed(&found), trimmed(&table), "{}", text);
            if always {
                let full = table.iter().filter(|row| row.iter().any(|field| !field.trim().is_empty()));
                prop_assert_eq!(found, full.cloned().collect::<Vec<_>>(), "{}", text);
            }
        });
    }
}
