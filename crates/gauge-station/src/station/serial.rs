// SPDX-License-Identifier: MIT

//! Serial numbers, from a counter, a list or a person. None is given twice: the record has the given ones.

use std::collections::BTreeMap;
use std::path::Path;

use ti_gauge::chip::{Chip, kebab_case};
use ti_gauge::dataflash::Row;
use ti_gauge::text;
use ti_gauge::value::{Type, Value};

use super::record::Record;
use crate::error::{Cause, Error, Result};
use crate::options::{Options, SerialFrom};
use gauge_bus::regular;
use ti_gauge::notation;

pub(super) enum Serials {
    None,
    Counter {
        first: i64,
        last: i64,
        is_hex: bool,
    },
    /// Each with its text in the list.
    List(Vec<(Value, String)>),
    Input,
}

/// The parameter with that name in `df/by-name`.
pub(super) fn named(chip: &'static Chip, name: &str) -> Option<Row> {
    let all = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |found| (row, found)));
    let is_it = |(row, found): &Row| format!("{}/{}", chip.class_dir(row), kebab_case(found.name)) == name;
    all.into_iter().find(is_it)
}

/// The parameter with that name of TI's.
pub(super) fn called(chip: &'static Chip, name: &str) -> Option<Row> {
    let all = chip.subclasses.iter().flat_map(|row| row.parameters.iter().map(move |found| (row, found)));
    all.into_iter().find(|(_, found)| found.name == name)
}

pub(super) fn row(chip: &'static Chip, station: &Options) -> Result<Option<Row>> {
    let refuse = |key: &str, why: String| Err(Error::new(key, Cause::Invalid, why));
    match &station.serial_parameter {
        Some(name) => match named(chip, name) {
            Some(row) => Ok(Some(row)),
            None => refuse(
                "serial-parameter",
                format!("a {} has no parameter {}", chip.model, text::printable(name)),
            ),
        },
        None => match called(chip, "Serial Number") {
            None if station.serial.is_some() => {
                let why =
                    format!("a {} has no parameter for it; name another with serial-parameter", chip.model);
                refuse("serial", why)
            }
            row => Ok(row),
        },
    }
}

pub(super) fn label_row(chip: &'static Chip, station: &Options) -> Result<Option<Row>> {
    let Some(name) = &station.label_parameter else { return Ok(None) };
    let refuse = |why: String| Err(Error::new("label-parameter", Cause::Invalid, why));
    match named(chip, name) {
        Some(row) if matches!(row.1.kind, Type::S(_)) => Ok(Some(row)),
        Some(_) => refuse("a label needs a parameter that is a string".into()),
        None => refuse(format!("a {} has no parameter {}", chip.model, text::printable(name))),
    }
}

/// A serial number in the record's form, which is the form for comparisons.
pub(super) fn shown(row: Row, value: &Value) -> String {
    notation::render(row.1.kind, value)
}

impl Serials {
    pub(super) fn of(station: &Options, row: Option<Row>) -> Result<Self> {
        let (Some(from), Some(row)) = (station.serial, row) else { return Ok(Self::None) };
        let refuse = |key: &str, why: &'static str| Err(Error::new(key, Cause::Invalid, why));
        match from {
            SerialFrom::Counter => {
                if matches!(row.1.kind, Type::S(_) | Type::F4) {
                    return refuse("serial", "a counter needs a parameter that is a whole number");
                }
                let first = station.first_serial.unwrap_or(1);
                let most = row.1.kind.bounds().map_or(i64::MAX, |(_, most)| most);
                let last = station.last_serial.unwrap_or(most);
                for (key, number) in [("first-serial", first), ("last-serial", last.min(most))] {
                    notation::parse(row.1, number.to_string().as_bytes())
                        .map_err(|error| error.within(key))?;
                }
                Ok(Self::Counter { first, last: last.min(most), is_hex: station.serial_is_hex })
            }
            SerialFrom::List => {
                let path = station.serial_list.as_deref().unwrap_or(Path::new(""));
                list(path, row).map(Self::List)
            }
            SerialFrom::Input => Ok(Self::Input),
        }
    }

    pub(super) fn are_scanned(&self) -> bool {
        matches!(self, Self::Input)
    }

    pub(super) fn scanned(row: Row, line: &str) -> std::result::Result<Value, String> {
        notation::parse(row.1, line.as_bytes()).map_err(|error| error.to_string())
    }

    pub(super) fn next(&self, row: Row, record: &Record) -> Result<Option<Value>> {
        let used_up = |what: &str| {
            let why = format!("{what}: all serial numbers were given");
            Err(Error::new("serial number", Cause::OutOfRange, why))
        };
        match self {
            Self::None | Self::Input => Ok(None),
            Self::Counter { first, last, .. } => {
                let given =
                    record.given().filter_map(|text| match notation::parse_stored(row.1, text.as_bytes()) {
                        Ok(Value::Int(number)) if (*first..=*last).contains(&number) => Some(number),
                        _ => None,
                    });
                match given.max().map_or(*first, |number| number + 1) {
                    next if next > *last => used_up("the counter has reached last-serial"),
                    next => Ok(Some(Value::Int(next))),
                }
            }
            Self::List(list) => match list.iter().find(|(value, _)| !record.is_given(&shown(row, value))) {
                Some((value, _)) => Ok(Some(value.clone())),
                None => used_up("the end of serial-list"),
            },
        }
    }

    /// A serial number of the record, written as in the station's file or list, where people look for it.
    pub(super) fn as_written(&self, row: Row, recorded: &str) -> String {
        let value = notation::parse_stored(row.1, recorded.as_bytes()).ok();
        let text = match (self, &value) {
            (Self::Counter { is_hex: false, .. }, Some(Value::Int(number))) => Some(number.to_string()),
            (Self::Counter { is_hex: true, .. }, Some(Value::Int(number))) => {
                Some(notation::render(Type::H(row.1.kind.size() as u8), &Value::Int(*number)))
            }
            (Self::List(list), Some(value)) => {
                list.iter().find(|(listed, _)| listed == value).map(|(_, text)| text.clone())
            }
            _ => None,
        };
        text.unwrap_or_else(|| recorded.into())
    }
}

/// Larger than a list of all serial numbers that fit.
const LONGEST: u64 = 16 << 20;

fn list(path: &Path, row: Row) -> Result<Vec<(Value, String)>> {
    let name = path.display().to_string();
    let text = regular::read_text(path, LONGEST)
        .map_err(|error| Error::io(&name, "cannot read the list", &error))?;
    let (mut values, mut lines) = (Vec::new(), BTreeMap::new());
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let at = |error: Error| error.within(&format!("{name}: line {number}"));
        let value = notation::parse(row.1, line.as_bytes()).map_err(at)?;
        if let Some(first) = lines.insert(shown(row, &value), number) {
            let why = format!("the serial number is also in line {first}; remove one of the two");
            return Err(at(Error::new("", Cause::Invalid, why)));
        }
        values.push((value, line.into()));
    }
    if values.is_empty() {
        return Err(Error::new(name, Cause::Invalid, "the list has no serial number"));
    }
    Ok(values)
}
