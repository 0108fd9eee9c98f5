// SPDX-License-Identifier: MIT

//! An image as TOML: a table per class and a key per parameter, named as in `df/by-name`.

use std::borrow::Cow;
use std::collections::BTreeSet;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{Faults, Image, NAMED, Reading, at_line, check_count, chip_of, twice};
use crate::chip::{Chip, Kind, Parameter, Subclass, kebab_case};
use crate::date;
use crate::error::{Cause, Error, Result};
use crate::notation;
use crate::value::{Type, Value};

/// The image as text.
pub fn write(image: &Image) -> String {
    let chip = image.chip;
    let mut text = String::from("# A gauge's configuration, by gaugefs export. Keys are never in it.\n");
    text += &format!("chip = \"{}\"\ndevice_type = 0x{:04x}\n", chip.name, chip.identity.device_type);
    if let Some(firmware) = image.firmware {
        text += &format!("firmware = 0x{firmware:04x}\n");
    }
    text += &format!("parameters = {}\n", image.entries.len());
    for (_, subclass) in chip.classes() {
        let is_of_class = |group: &Subclass| chip.class_of(subclass).any(|(_, one)| std::ptr::eq(one, group));
        let entries: Vec<_> = image.entries.iter().filter(|entry| is_of_class(entry.subclass)).collect();
        if !entries.is_empty() {
            text += &format!("\n[{}]\n", chip.class_dir(subclass));
        }
        for entry in entries {
            let (parameter, shown) = (entry.parameter, entry.shown());
            let shown = match (parameter.kind, &entry.value) {
                (_, Value::Text(string)) => quoted(string),
                // A float may have more digits than a TOML integer.
                (Type::F4, _) if !shown.contains('.') => shown + ".0",
                _ => shown,
            };
            let marks = [
                (parameter.unit, !parameter.unit.is_empty() && entry.shown() == entry.text()),
                ("learned", parameter.learned),
                ("unproven: not imported", parameter.unproven),
            ];
            let marks: Vec<_> = marks.iter().filter(|(_, set)| *set).map(|(mark, _)| *mark).collect();
            let remark = if marks.is_empty() { String::new() } else { format!("  # {}", marks.join(", ")) };
            text += &format!("{} = {shown}{remark}\n", kebab_case(parameter.name));
        }
    }
    text
}

/// A string of any bytes, each as the character with its number.
fn quoted(string: &[u8]) -> String {
    let letters = string.iter().map(|&byte| match byte {
        b'"' | b'\\' => format!("\\{}", char::from(byte)),
        b' '..=b'~' => char::from(byte).to_string(),
        _ => format!("\\u{byte:04x}"),
    });
    format!("\"{}\"", letters.collect::<String>())
}

fn is_meant(text: &str) -> bool {
    let begins = |line: &str| line.starts_with(['[', '#']) || line.starts_with("chip");
    text.lines().map(str::trim_start).any(begins)
}

/// Reads an image. Unknown tables and keys, and values of the wrong type, are errors.
pub fn parse(text: &str, told: Option<&'static Chip>) -> Result<Image> {
    let mut faults = Faults::default();
    let image = read(text, told, &mut faults);
    Reading { image, faults }.whole()
}

/// In a longer text only the first syntax error is reported; there could be one per character.
const LONGEST: usize = 256 << 10;

pub(super) fn read(text: &str, told: Option<&'static Chip>, faults: &mut Faults) -> Option<Image> {
    let ends: Vec<usize> = text.match_indices('\n').map(|(at, _)| at).collect();
    let line = |at: usize| 1 + ends.partition_point(|end| *end < at);
    let (document, mut errors) = match text.len() <= LONGEST {
        true => DeTable::parse_recoverable(text),
        false => match DeTable::parse(text) {
            Ok(document) => (document, Vec::new()),
            Err(error) => (Spanned::new(0..0, DeTable::new()), vec![error]),
        },
    };
    if !errors.is_empty() && !is_meant(text) {
        let why = "none of the formats that gaugefs reads: TOML as `gaugefs export` writes it, gg.csv, or FlashStream \
                   (.gm.fs, .df.fs)";
        return faults.stop(0, Error::new("", Cause::Invalid, why));
    }
    let start = |error: &toml::de::Error| error.span().map_or(0, |span| span.start);
    errors.sort_by_key(start);
    // The grammar may see one mistake as several.
    errors.dedup_by_key(|error| line(start(error)));
    for (at, error) in errors.iter().enumerate() {
        let number = line(start(error));
        let why = error.message().lines().collect::<Vec<_>>().join(", ");
        let twice = if at < NAMED { duplicate(text, number) } else { None };
        faults.add(number, twice.unwrap_or_else(|| at_line(number, format!("not TOML: {why}"))));
    }
    // A line that is not TOML may give its key any value.
    let broken: BTreeSet<usize> = errors.iter().map(|error| line(start(error))).collect();
    let mut file = File { faults, broken, line: &line, count: 0, unknown: 0 };
    let (mut named, mut device_type, mut firmware, mut count) = (None, None, None, None);
    let mut tables = Vec::new();
    for (key, value) in document.get_ref() {
        let mut bad = |why: &str| file.refuse(key, format!("{}: {why}", key.get_ref()));
        match (key.get_ref().as_ref(), value.get_ref()) {
            ("chip", DeValue::String(name)) => match Chip::by_name(name) {
                Some(chip) => named = Some(chip),
                None => bad(&format!("{name} is not in the list of `gaugefs chips`")),
            },
            ("device_type" | "firmware", number @ DeValue::Integer(_)) => {
                match plain(number).and_then(|text| text.parse::<u16>().ok()) {
                    None => bad("not a 16-bit number"),
                    code if key.get_ref() == "firmware" => firmware = code,
                    code => device_type = code,
                }
            }
            ("parameters", number @ DeValue::Integer(_)) => {
                count = plain(number).and_then(|text| text.parse::<usize>().ok());
                if count.is_none() {
                    bad("not a number of parameters");
                }
            }
            (_, DeValue::Table(table)) => tables.push((key, table)),
            _ => bad("only chip, device_type, firmware and parameters may be outside a table"),
        }
    }
    if let (Some(named), Some(told)) = (named, told)
        && !std::ptr::eq(named, told)
    {
        let why = format!("it is for a {}, not for a {}", named.model, told.model);
        return file.faults.stop(0, Error::new("", Cause::Invalid, why));
    }
    let chip = chip_of(named.or(told), device_type, firmware);
    let chip = if file.faults.is_empty() { file.faults.keep(0, chip) } else { chip.ok() }?;
    let mut image = Image::new(chip, firmware);
    image.names_chip = named.is_some() || device_type.is_some();
    for (key, table) in tables {
        file.add_table(&mut image, key, table);
    }
    // A broken line may or may not contain a parameter.
    if file.broken.is_empty() {
        let counted = check_count(text, count, file.count, "parameters (`parameters = `)");
        file.faults.keep(0, counted);
    }
    Some(image)
}

fn duplicate(text: &str, number: usize) -> Option<Error> {
    let name = |line: &str| line.split(['=', '#']).next().unwrap_or_default().trim().to_string();
    let lines: Vec<String> = text.lines().take(number).map(name).collect();
    let (this, before) = lines.split_last().filter(|(this, _)| !this.is_empty())?;
    let is_table = |line: &String| line.starts_with('[');
    // A key may be in several tables.
    let start = if is_table(this) { 0 } else { before.iter().rposition(is_table).unwrap_or(0) };
    let first = start + before[start..].iter().position(|line| line == this)?;
    Some(twice(this, first + 1, number))
}

type Key<'a> = Spanned<Cow<'a, str>>;

struct File<'a> {
    faults: &'a mut Faults,
    broken: BTreeSet<usize>,
    line: &'a dyn Fn(usize) -> usize,
    count: usize,
    unknown: usize,
}

impl File<'_> {
    fn refuse(&mut self, key: &Key<'_>, why: String) {
        let line = (self.line)(key.span().start);
        if !self.broken.contains(&line) {
            self.faults.at(line, why);
        }
    }

    fn add_table(&mut self, image: &mut Image, class: &Key<'_>, table: &DeTable<'_>) {
        let (chip, name) = (image.chip, class.get_ref());
        self.count += table.len();
        let of_name = |name: &str| chip.subclasses.iter().find(|subclass| chip.class_dir(subclass) == name);
        let found = of_name(name);
        let meant = || {
            let keys = table.keys().take(NAMED);
            keys.filter_map(|key| chip.nearest(&format!("{name}/{}", key.get_ref()))).next()
        };
        let Some(subclass) = found.or_else(|| meant().map(|(subclass, _)| subclass)) else {
            return self.refuse(class, format!("a {} has no class {name}", chip.model));
        };
        if found.is_none() {
            let meant = chip.class_dir(subclass);
            let why = format!("a {} has no class {name}; did you mean [{meant}]?", chip.model);
            self.refuse(class, why);
        }
        if subclass.kind == Kind::Security {
            if found.is_some() {
                self.refuse(class, format!("{name}: images never contain keys; remove the table"));
            }
            return;
        }
        for (key, value) in table {
            let whole = format!("{}/{}", chip.class_dir(subclass), key.get_ref());
            let mut rows =
                chip.class_of(subclass).flat_map(|(_, one)| one.parameters.iter().map(move |row| (one, row)));
            let Some((subclass, parameter)) = rows.find(|(_, row)| kebab_case(row.name) == *key.get_ref())
            else {
                self.unknown += 1;
                let nearest = if self.unknown <= NAMED { chip.nearest(&whole) } else { None };
                // A guessed class leaves open whether this is its parameter.
                if found.is_none() && !nearest.is_some_and(|(of, _)| std::ptr::eq(of, subclass)) {
                    continue;
                }
                let hint =
                    nearest.map_or(String::new(), |row| format!("; did you mean {}?", chip.name_of(row)));
                self.refuse(key, format!("a {} has no parameter {whole}{hint}", chip.model));
                continue;
            };
            let number = (self.line)(key.span().start);
            if self.broken.contains(&number) {
                continue;
            }
            match value_of(parameter, &whole, value.get_ref(), number) {
                Ok(value) => image.add(subclass, parameter, value, number),
                Err(error) => self.faults.add(number, error),
            }
        }
    }
}

fn value_of(parameter: &Parameter, name: &str, found: &DeValue<'_>, number: usize) -> Result<Value> {
    let is_text = matches!(found, DeValue::String(_));
    let is_for_text = matches!(parameter.kind, Type::S(_));
    let is_date = matches!(found, DeValue::Datetime(_));
    let is_one = is_text == is_for_text && (!is_date || parameter.is_date());
    let text = plain(found).filter(|_| is_one);
    let Some(text) = text else {
        let remedy = match found {
            DeValue::String(text) if !is_for_text => match notation::parse(parameter, text.as_bytes()) {
                Ok(_) => "; write it without quotes".into(),
                Err(error) => format!("; {}", error.reason()),
            },
            _ => String::new(),
        };
        let (found, kind) = (found.type_str(), parameter.kind);
        return Err(at_line(number, format!("{name}: {found}, but {kind} is expected{remedy}")));
    };
    let value = if is_text {
        let bytes: Option<Vec<u8>> = text.chars().map(|letter| u8::try_from(letter).ok()).collect();
        let why = || at_line(number, format!("{name}: a character above \\u00ff is not a byte"));
        notation::string(parameter, bytes.ok_or_else(why)?)
    } else {
        let day = date::parse(&text).filter(|_| parameter.is_date()).map(|day| day.to_string());
        notation::parse_stored(parameter, day.unwrap_or(text).as_bytes())
    };
    value.map_err(|error| error.within(&format!("line {number}")))
}

fn plain(value: &DeValue<'_>) -> Option<String> {
    match value {
        DeValue::String(text) => Some(text.to_string()),
        DeValue::Integer(number) => {
            i64::from_str_radix(number.as_str(), number.radix()).ok().map(|number| number.to_string())
        }
        DeValue::Float(number) => Some(number.as_str().to_string()),
        DeValue::Datetime(date) => Some(date.to_string()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "chip = \"bq34z100-g1\"\n";

    #[test]
    fn a_part_of_a_configuration_is_enough() {
        let text = format!(
            "{HEAD}[it-cfg]\ncell-terminate-voltage = 3_100 # mV\n[registers]\npack-configuration = 0x0161\n"
        );
        let image = parse(&text, None).expect("an image");
        let values: Vec<_> =
            image.entries.iter().map(|entry| (image.name(entry), entry.text(), entry.line)).collect();
        assert_eq!(
            values,
            [
                ("it-cfg/cell-terminate-voltage".into(), "3100".into(), 3),
                ("registers/pack-configuration".into(), "0x0161".into(), 5)
            ]
        );
    }

    #[test]
    fn a_date_is_written_as_one_and_read_as_one_or_as_its_number() {
        for (written, text) in [("2026-11-22", "23926"), ("23926", "23926"), ("0", "0")] {
            let image = parse(&format!("{HEAD}[configuration-data]\nmanufacture-date = {written}\n"), None)
                .expect(written);
            assert_eq!(image.entries[0].text(), text);
            let again = write(&image);
            let shown = if text == "0" { "0  # Day" } else { "2026-11-22\n" };
            assert!(again.contains(&format!("\nmanufacture-date = {shown}")), "{again}");
        }
    }

    #[test]
    fn an_error_names_its_line() {
        for (text, says) in [
            ("[it-cfg]\nno-such = 1", "line 3: a bq34z100-G1 has no parameter it-cfg/no-such"),
            ("[no-such]\n", "line 2: a bq34z100-G1 has no class no-such"),
            ("[codes]\n", "line 2: codes: images never contain keys; remove the table"),
            (
                "[it-cfg]\n\ncell-terminate-voltage = \"3\"",
                "line 4: it-cfg/cell-terminate-voltage: string, but I2 is expected; the value is outside 1000 to 3700 mV",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = \"3100\"",
                "line 3: it-cfg/cell-terminate-voltage: string, but I2 is expected; write it without quotes",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = \"3.1 V\"",
                "line 3: it-cfg/cell-terminate-voltage: string, but I2 is expected; the value has a unit; write the \
                 number in mV: 3100",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = true",
                "line 3: it-cfg/cell-terminate-voltage: boolean, but I2 is expected",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = 1.5",
                "line 3: Cell Terminate Voltage: the value is not a whole number",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = 40000",
                "line 3: Cell Terminate Voltage: the value is outside",
            ),
            (
                "[configuration-data]\ndevice-name = \"\\u0100\"",
                "line 3: configuration-data/device-name: a character above \\u00ff is not a byte",
            ),
            (
                "[configuration-data]\ndevice-name = \"twelve bytes\"",
                "line 3: Device Name: 12 characters, but only 11 fit",
            ),
            (
                "[it-cfg]\ncell-terminate-voltage = 2026-11-22",
                "line 3: it-cfg/cell-terminate-voltage: datetime, but I2 is expected",
            ),
            (
                "[configuration-data]\nmanufacture-date = 2026-11-22T08:00:00",
                "line 3: Manufacture Date: the value is not a whole number",
            ),
            (
                "[configuration-data]\nmanufacture-date = 1979-12-31",
                "line 3: Manufacture Date: the value is not a whole number",
            ),
            ("x = 1", "line 2: x: only chip, device_type, firmware and parameters"),
            ("[it-cfg\n", "line 2: not TOML"),
            (
                "[it-cfg]\nload-select = 1\n\n[safety]\not-chg = 1\n[it-cfg]\n",
                "line 7: [it-cfg] is also in line 2; remove one of the two",
            ),
            (
                "[it-cfg]\nra-filter = 1\ncell-terminate-voltage = 1 # mV\nra-filter = 2",
                "line 5: ra-filter is also in line 3; remove one of the two",
            ),
            ("parameters = -1", "line 2: parameters: not a number of parameters"),
            ("firmware = 70000", "line 2: firmware: not a 16-bit number"),
        ] {
            let error = parse(&format!("{HEAD}{text}\n"), None).expect_err(text).to_string();
            assert!(error.starts_with(says), "{text}: {error}");
        }
    }
}
