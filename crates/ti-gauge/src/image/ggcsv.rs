// SPDX-License-Identifier: MIT

//! An image as bqStudio's gg.csv: header lines with `*`, the last one with columns, then a line per parameter. The older
//! `.gg` has sections instead of columns.

mod rows;
pub(super) mod sections;
mod spreadsheet;

use super::{Entry, Faults, Group, Image, NAMED, Reading, at_line, check_count, chip_of, cut_short, word};
use crate::chip::{Chip, FLAT, Kind, Parameter, Range, Subclass, kebab_case};
use crate::codec::Layout;
use crate::error::{Cause, Error, Result};
use crate::notation;
use crate::text;
use crate::value::{Type, Value};

const COLUMNS: [&str; 18] = [
    "Class name",
    "SubClass name",
    "Parameter name",
    "Parameter Value",
    "Data Type",
    "Data Length",
    "Address Offset",
    "Default Value",
    "Minimum Value",
    "Maximum Value",
    "Display Format",
    "Read Formula",
    "Write Formula",
    "Flags",
    "Display Units",
    "Help",
    "Native Units",
    "Data Flash Raw Value",
];
/// Start of a flat address space; bqStudio counts offsets from here.
const FLAT_BASE: u16 = 0x4000;
const ORDER_LINE: &str = "Field Order:";
const NEEDED: [&str; 4] = ["class-name", "subclass-name", "parameter-name", "parameter-value"];
/// The header line with the chip, because bqStudio's own lines do not distinguish all chips.
const CHIP_LINE: &str = "gaugefs chip";
/// The header line with the number of rows, because the format has no end mark.
const COUNT_LINE: &str = "gaugefs parameters";

/// The image as text.
pub fn write(image: &Image) -> String {
    let rows: Vec<[String; 18]> = image.entries.iter().map(|entry| row(image.chip.layout, entry)).collect();
    // Not every reader knows quotes: if a value contains a comma, tabs separate the columns.
    let tabs = rows.iter().flatten().any(|field| field.contains(','));
    let (comma, gap) = if tabs { ("\t", "\t") } else { (",", ", ") };
    let chip = image.chip;
    let mut text =
        String::from("* Texas Instruments Data Flash File\n* By gaugefs export, without keys\n*\n");
    text += &format!("* {CHIP_LINE} {}\n* Device Number {:x}\n", chip.name, chip.identity.device_type);
    if let Some(firmware) = image.firmware {
        text += &format!("* Firmware Version {:x}.{:02x}\n", firmware >> 8, firmware & 0xff);
    }
    text += &format!("* {COUNT_LINE} {}\n", rows.len());
    text += &format!("*\n* Field Order: {}\n", COLUMNS.join(gap));
    for row in rows {
        text += &(row.map(|field| rows::quoted(&field)).join(comma) + "\n");
    }
    text
}

fn row(layout: Layout, entry: &Entry) -> [String; 18] {
    let Entry { subclass, parameter, value, .. } = entry;
    let show = |value: &Value| match (parameter.kind, value) {
        (_, Value::Text(string)) => notation::shown(string),
        (Type::H(_), _) => notation::render(parameter.kind, value).replacen("0x", "", 1),
        _ => notation::render(parameter.kind, value),
    };
    let (letter, format) = match parameter.kind {
        Type::I(_) => ("I", "dddd".to_string()),
        Type::U(_) => ("U", "dddd".to_string()),
        Type::H(size) => ("H", "h".repeat(2 * usize::from(size))),
        Type::F4 => ("F", "f.fff".to_string()),
        Type::S(_) => ("S", "s".to_string()),
    };
    let (default, min, max) = match &parameter.range {
        // An image lacks the DM_CODE.
        Range::Int { .. } if parameter.unprinted => (parameter.int_default(None).map(Value::Int), None, None),
        Range::Int { min, max, .. } => {
            (parameter.int_default(None).map(Value::Int), Some(Value::Int(*min)), Some(Value::Int(*max)))
        }
        Range::Float { min, max, default } => {
            (default.map(Value::Float), Some(Value::Float(*min)), Some(Value::Float(*max)))
        }
        Range::Text { default } => (default.map(|text| Value::Text(text.into())), None, None),
    };
    let shown = |value: Option<Value>| value.map_or(String::new(), |value| show(&value));
    let base = if subclass.id == FLAT { FLAT_BASE } else { 0 };
    let raw = layout.encode(parameter.kind, value).unwrap_or_default();
    [
        subclass.class.to_string(),
        subclass.name.to_string(),
        parameter.name.to_string(),
        show(value),
        letter.to_string(),
        parameter.kind.size().to_string(),
        parameter.offset.saturating_sub(base).to_string(),
        shown(default),
        shown(min),
        shown(max),
        format,
        "x".to_string(),
        "x".to_string(),
        String::new(),
        parameter.unit.to_string(),
        String::new(),
        parameter.unit.to_string(),
        text::hex(&raw),
    ]
}

/// Reads an image. Unknown parameters and keys are left out with a note: bqStudio and manuals differ in names.
pub fn parse(text: &str, told: Option<&'static Chip>) -> Result<Image> {
    let mut faults = Faults::default();
    let image = read(text, told, &mut faults);
    Reading { image, faults }.whole()
}

#[derive(Default)]
struct Header {
    named: Option<&'static Chip>,
    device_type: Option<u16>,
    firmware: Option<u16>,
    count: Option<usize>,
    order: Option<Vec<String>>,
}

impl Header {
    /// Takes a header line without its `*`. An error prevents reading the rest.
    fn take(
        &mut self,
        head: &str,
        fields: &[String],
        number: usize,
        faults: &mut Faults,
    ) -> Result<(), String> {
        let mut need = |is_right: bool, why| {
            if !is_right {
                faults.at(number, why);
            }
        };
        if let Some(name) = head.strip_prefix(CHIP_LINE) {
            self.named = Chip::by_name(name.trim());
            need(self.named.is_some(), "not in the list of `gaugefs chips`");
        } else if let Some(rows) = head.strip_prefix(COUNT_LINE) {
            self.count = rows.trim().parse().ok();
            need(self.count.is_some(), "not a number of parameters");
        } else if let Some(code) = head.strip_prefix("Device Number") {
            self.device_type = word(code.trim());
            need(self.device_type.is_some(), "Device Number: not a hexadecimal word");
        } else if let Some(version) = head.strip_prefix("Firmware Version") {
            let word = self::version(version);
            need(word.is_some(), "Firmware Version: not two or three numbers");
            self.firmware = word.or(self.firmware);
        } else if let Some(first) = head.strip_prefix(ORDER_LINE) {
            let names = std::iter::once(first).chain(fields[1..].iter().map(String::as_str));
            let mut names: Vec<String> = names.map(kebab_case).collect();
            // A spreadsheet makes all rows as long as the longest.
            while names.pop_if(|name| name.is_empty()).is_some() {}
            if let Some(missing) = NEEDED.iter().find(|name| !names.iter().any(|known| known == *name)) {
                return Err(format!(
                    "no column `{missing}`; `* {ORDER_LINE}` names the columns, with commas, semicolons or tabs \
                     between them"
                ));
            }
            self.order = Some(names);
        }
        Ok(())
    }
}

/// A firmware's version: two numbers, and perhaps that of a build.
fn version(text: &str) -> Option<u16> {
    let parts: Option<Vec<u8>> =
        text.trim().split('.').map(|part| u8::from_str_radix(part, 16).ok()).collect();
    match parts.as_deref() {
        Some([high, low] | [high, low, _]) => Some(u16::from_be_bytes([*high, *low])),
        _ => None,
    }
}

pub(super) fn read(text: &str, told: Option<&'static Chip>, faults: &mut Faults) -> Option<Image> {
    if sections::is_one(text) {
        return sections::read(text, told, faults);
    }
    let mut header = Header::default();
    let mut rows = Vec::new();
    let comma = rows::separator(text.split_once(ORDER_LINE).map_or("", |(_, names)| names));
    for row in rows::rows(text, comma) {
        let number = row.number;
        let fields = match row.fields {
            Ok(fields) => fields,
            Err(why) => {
                faults.at(number, why);
                continue;
            }
        };
        if let Some(head) = fields[0].trim().strip_prefix('*').map(str::trim) {
            if let Err(why) = header.take(head, &fields, number, faults) {
                return faults.stop(number, at_line(number, why));
            }
        } else {
            rows.push((number, fields));
        }
    }
    let Header { named, device_type, firmware, count, order } = header;
    if let (Some(named), Some(told)) = (named, told)
        && !std::ptr::eq(named, told)
    {
        let why = format!("it is for a {}, not for a {}", named.model, told.model);
        return faults.stop(1, at_line(1, why));
    }
    let chip = chip_of(named.or(told), device_type, firmware);
    // A mistake in the line that names it is listed already.
    let chip = if faults.is_empty() { faults.keep(0, chip) } else { chip.ok() }?;
    let Some(order) = order else {
        let why = format!("no line `* {ORDER_LINE}`, which names the columns");
        return faults.stop(1, at_line(1, why));
    };
    faults.keep(0, check_count(text, count, rows.len(), "parameters"));
    let cut = rows.last().filter(|(_, fields)| !text.ends_with(['\n', '\r']) && fields.len() < order.len());
    let cut = cut.map(|(number, _)| *number);
    if let Some(number) = cut {
        let why = format!("the last line has fewer fields than the header names ({})", order.len());
        faults.add(number, cut_short(why).within(&format!("line {number}")));
    }
    let mut image = Image::new(chip, firmware);
    image.names_chip = named.is_some() || device_type.is_some();
    rows.retain(|(number, _)| cut != Some(*number));
    add_rows(&mut image, &order, rows, faults);
    Some(image)
}

/// A row, with the columns of the file.
struct Row<'a> {
    number: usize,
    order: &'a [String],
    fields: &'a [String],
}

impl<'a> Row<'a> {
    fn field(&self, name: &str) -> Option<&'a str> {
        let at = self.order.iter().position(|column| column == name)?;
        self.fields.get(at).map(String::as_str)
    }

    /// Where a field is, as a spreadsheet names its columns.
    fn place(&self, name: &str) -> String {
        let line = format!("line {}", self.number);
        let at = self.order.iter().position(|column| column == name);
        match at.and_then(|at| ('A'..='Z').nth(at)) {
            Some(letter) => format!("{line}, column {letter}"),
            None => line,
        }
    }
}

fn add_rows(image: &mut Image, order: &[String], rows: Vec<(usize, Vec<String>)>, faults: &mut Faults) {
    let mut unknown = Vec::new();
    for (number, fields) in rows {
        if fields.iter().skip(order.len()).any(|field| !field.trim().is_empty()) {
            let why = format!("{} fields, but the header names {}", fields.len(), order.len());
            faults.at(number, why);
            continue;
        }
        match add_row(image, &Row { number, order, fields: &fields }) {
            Ok(None) => {}
            Ok(Some(name)) if unknown.len() < NAMED => unknown.push((image.left_out.len() - 1, name)),
            Ok(Some(_)) => {}
            Err(error) => faults.add(number, error),
        }
    }
    add_hints(image, unknown);
}

/// Names what those rows may mean that the table does not have, each by its place in what is left out.
fn add_hints(image: &mut Image, unknown: Vec<(usize, String)>) {
    // A parameter with its own row is not meant by another one.
    let meant = |(at, name): (usize, String)| {
        let (subclass, parameter) = image.chip.nearest(&name)?;
        let is_it = |entry: &Entry| std::ptr::eq(entry.parameter, parameter);
        let name = format!("{}/{}/{}", subclass.class, subclass.name, parameter.name);
        (!image.entries.iter().any(is_it)).then_some((at, name))
    };
    for (at, name) in unknown.into_iter().filter_map(meant).collect::<Vec<_>>() {
        image.left_out[at].text += &format!("; did you mean {name}?");
    }
}

/// The row of the table that has these names, in whatever manner they are written.
fn named(chip: &'static Chip, [class, subclass, parameter]: [&str; 3]) -> Option<crate::chip::Row> {
    let alike = |one: &str, other: &str| kebab_case(one) == kebab_case(other);
    let of_name = |row: &&Subclass| alike(row.name, subclass) && alike(row.class, class);
    chip.subclasses.iter().filter(of_name).find_map(|subclass| {
        let parameter = subclass.parameters.iter().find(|row| alike(row.name, parameter))?;
        Some((subclass, parameter))
    })
}

/// The parameter of a row. An unknown one and a key are left out; returns class and name of an unknown one.
fn wanted(
    image: &mut Image,
    number: usize,
    [class, name, parameter]: [&str; 3],
) -> std::result::Result<crate::chip::Row, Option<String>> {
    let Some((subclass, parameter)) = named(image.chip, [class, name, parameter]) else {
        image.leave_out(number, format_args!("{class}/{name}/{parameter}: not in the table; left out"), None);
        return Err(Some(format!("{name}/{parameter}")));
    };
    if subclass.kind == Kind::Security {
        image.leave_out(number, format_args!("{}: a key; left out", parameter.name), Some(Group::Keys));
        return Err(None);
    }
    Ok((subclass, parameter))
}

/// Adds a row's parameter. Returns class and name if there is no such parameter.
fn add_row(image: &mut Image, row: &Row<'_>) -> Result<Option<String>> {
    let number = row.number;
    let need = |name: &str| row.field(name).ok_or_else(|| at_line(number, format!("no field `{name}`")));
    let names = [need("class-name")?, need("subclass-name")?, need("parameter-name")?];
    let shown = need("parameter-value")?;
    let (subclass, parameter) = match wanted(image, number, names) {
        Ok(found) => found,
        Err(unknown) => return Ok(unknown),
    };
    let is_string = matches!(parameter.kind, Type::S(_));
    if shown.trim().is_empty() && !is_string {
        return Ok(None);
    }
    let bad = |column: &str, why: String| {
        Err(Error::new(parameter.name, Cause::Invalid, why).within(&row.place(column)))
    };
    let formula = row.field("write-formula").map(str::trim);
    if let Some(formula) = formula.filter(|formula| !matches!(*formula, "" | "x" | "X")) {
        let why = format!("its value is converted by the formula {formula}, which gaugefs does not support");
        return bad("write-formula", why);
    }
    let format = row.field("display-format").unwrap_or_default().trim();
    let unit = row.field("display-units").or(row.field("units")).map(str::trim);
    let unit = unit.filter(|_| row.field("display-format").is_none());
    let Some(decimals) = unit.map_or_else(|| Some(decimals(format)), |unit| short_form(parameter, unit))
    else {
        let (name, unit, stored) = (parameter.name, unit.unwrap_or_default(), parameter.unit);
        let why = format!(
            "shown in {unit}, stored in {stored}, and the file does not give the conversion; left out"
        );
        image.leave_out(number, format_args!("{name}: {why}"), None);
        return Ok(None);
    };
    let bytes = row.field("data-flash-raw-value").unwrap_or_default().trim();
    let raw = spreadsheet::bytes(bytes, parameter.kind.size());
    let raw = raw.map(|raw| image.chip.layout.decode(parameter.kind, &raw));
    if is_string && shown.contains('_') && raw.is_none() && !bytes.is_empty() {
        let why = "its bytes in Data Flash Raw Value are damaged, and _ may stand for any of them";
        return bad("data-flash-raw-value", why.into());
    }
    let read = match is_string {
        true => string(parameter, shown, raw),
        false => numeric(parameter, shown.trim(), raw, &Shown { format, decimals, unit }),
    };
    let (value, note) = read.map_err(|error| error.within(&row.place("parameter-value")))?;
    image.notes.extend(note.map(|note| format!("{}: {note}", row.place("parameter-value"))));
    image.add(subclass, parameter, value, number);
    Ok(None)
}

/// How a row shows its number.
struct Shown<'a> {
    format: &'a str,
    decimals: usize,
    unit: Option<&'a str>,
}

impl Shown<'_> {
    fn is_hexadecimal(&self, kind: Type) -> bool {
        match kind {
            Type::H(_) => !self.format.starts_with(['d', 'D']),
            _ => self.format.starts_with(['h', 'H']),
        }
    }

    /// A stored number as the file has it.
    fn text(&self, kind: Type, stored: &Value) -> String {
        match stored {
            Value::Float(number) => format!("{number:.*}", self.decimals),
            Value::Int(number) if self.is_hexadecimal(kind) => format!("{number:x}"),
            Value::Int(number) => {
                format!("{:.*}", self.decimals, *number as f64 / 10_f64.powi(self.decimals as i32))
            }
            Value::Text(_) => String::new(),
        }
    }

    /// The text as a number of the table, or why it cannot be; `None` if it does not match the format.
    fn plain(&self, kind: Type, shown: &str) -> Result<String, Option<&'static str>> {
        if let Some(why) = spreadsheet::trace(shown) {
            return Err(Some(why));
        }
        if shown.contains(',') {
            return Err(Some("a comma in a number; write a decimal point, and nothing between thousands"));
        }
        match kind {
            Type::F4 => Ok(shown.to_string()),
            _ if self.is_hexadecimal(kind) => Ok(format!("0x{}", shown.strip_prefix("0x").unwrap_or(shown))),
            _ => unscaled(shown, self.decimals).ok_or(None),
        }
    }
}

/// A row's number, and a note if its bytes say what stood there before a spreadsheet.
fn numeric(
    parameter: &Parameter,
    shown: &str,
    raw: Option<Value>,
    how: &Shown<'_>,
) -> Result<(Value, Option<String>)> {
    let kind = parameter.kind;
    let bad = |why: String| Error::new(parameter.name, Cause::Invalid, why);
    let read = |shown: &str| {
        let text = how.plain(kind, shown).map_err(|why| match why {
            Some(why) => bad(why.into()),
            None => {
                let format = if how.format.is_empty() { how.unit.unwrap_or_default() } else { how.format };
                bad(format!("`{shown}` does not match the format {format}"))
            }
        })?;
        notation::parse_stored(parameter, text.as_bytes())
    };
    let stood = raw.as_ref().map(|stored| how.text(kind, stored));
    let value = match (raw.clone(), read(shown)) {
        // The format shows fewer digits than are stored.
        (Some(stored @ Value::Float(_)), _) if stood.as_deref() == Some(shown) => stored,
        (_, Ok(value)) => value,
        (Some(stored), Err(_)) if stood.as_ref().is_some_and(|text| spreadsheet::shows(shown, text)) => {
            return Ok((stored, stood.map(|text| from_bytes(parameter, shown, &text))));
        }
        (_, Err(error)) => {
            let may_be_read = !how.is_hexadecimal(kind)
                && spreadsheet::trace(shown).is_none()
                && shown.contains(|letter: char| !letter.is_ascii_digit() && !matches!(letter, '.' | '-'));
            let readings = if may_be_read { spreadsheet::readings(shown) } else { Vec::new() };
            match &readings.iter().filter_map(|reading| read(reading).ok()).collect::<Vec<_>>()[..] {
                [one] => one.clone(),
                _ => return Err(error),
            }
        }
    };
    let has_point = how.decimals > 0 || kind == Type::F4;
    if let Some(stored) = raw.filter(|stored| has_point && *stored != value)
        && spreadsheet::has_lost_its_point(shown, &notation::render(kind, &stored))
    {
        let why =
            "a spreadsheet has removed the point from it; empty its Data Flash Raw Value if it is right";
        return Err(bad(why.into()));
    }
    Ok((value, None))
}

fn from_bytes(parameter: &Parameter, shown: &str, stood: &str) -> String {
    format!("{}: its bytes are those of {stood}, which a spreadsheet shows as {shown}", parameter.name)
}

/// A string from the row's bytes if they match the shown text, else the text, edited by somebody but a spreadsheet.
fn string(parameter: &Parameter, shown: &str, raw: Option<Value>) -> Result<(Value, Option<String>)> {
    let bad = |why: &'static str| Err(Error::new(parameter.name, Cause::Invalid, why));
    let trace = spreadsheet::trace(shown);
    if let Some(Value::Text(stored)) = raw {
        let text = notation::shown(&stored);
        if text.trim() == shown.trim() {
            return Ok((Value::Text(stored), None));
        }
        if trace.is_some() && spreadsheet::shows(shown, text.trim()) {
            let note = from_bytes(parameter, shown, &text);
            return Ok((Value::Text(stored), Some(note)));
        }
        if spreadsheet::is_number_of(shown, &text) {
            return bad(
                "a spreadsheet has made a number of it; empty its Data Flash Raw Value if it is right",
            );
        }
    }
    if let Some(why) = trace {
        return bad(why);
    }
    if !shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        let why = "only printable ASCII is accepted here; other bytes are in the column Data Flash Raw Value";
        return bad(why);
    }
    Ok((notation::string(parameter, shown.into())?, None))
}

fn decimals(format: &str) -> usize {
    format.split_once('.').map_or(0, |(_, after)| after.len())
}

/// Decimals of a value without format, by its unit; `None` if it shows another quantity, such as a resistance.
fn short_form(parameter: &Parameter, unit: &str) -> Option<usize> {
    let plain = |unit: &str| unit.to_lowercase().replace([' ', '\u{fffd}'], "").replace('°', "deg");
    // A cell's voltage may lack the words.
    let plain = |unit: &str| plain(unit).replace("percell", "/cell").trim_end_matches("/cell").to_string();
    let (shown, stored) = (plain(unit), plain(parameter.unit));
    let none = |unit: &str| matches!(unit, "" | "-" | "num" | "number" | "counts" | "hex" | "flg" | "flags");
    match parameter.kind {
        Type::H(_) | Type::S(_) => Some(0),
        _ if shown == stored || none(&shown) => Some(0),
        _ if shown == "degc" && stored == "0.1degc" => Some(1),
        _ => None,
    }
}

fn unscaled(shown: &str, decimals: usize) -> Option<String> {
    if decimals == 0 {
        return Some(shown.to_string());
    }
    let (whole, fraction) = shown.split_once('.').unwrap_or((shown, ""));
    (fraction.len() <= decimals).then(|| format!("{whole}{fraction:0<decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Name, value and line.
    type Found = (String, String, usize);

    fn entries(text: &str) -> Result<(Vec<Found>, Vec<String>)> {
        let image = parse(text, Chip::by_name("bq34z100-g1"))?;
        let entries = image.entries.iter().map(|entry| (image.name(entry), entry.text(), entry.line));
        let left_out = image.left_out.iter().map(|left| left.text.clone());
        Ok((entries.collect(), left_out.collect()))
    }

    /// The short form, as exports of other parts show it.
    #[test]
    fn the_short_form_is_read() {
        let text = "* Texas Instruments Data Flash File\r\n* Device Number 100\r\n* Firmware Version 0.16\r\n\
                    * Field Order: Class name, Subclass name, Parameter name, Parameter Value, Units\r\n\
                    Gas Gauging,IT Cfg,Cell Terminate Voltage,3100,mV\r\n\
                    Gas Gauging,IT Cfg,Something Else,1,-\r\n\
                    Security,Codes,Sealed to Unsealed,36720414,-\r\n\
                    Configuration,Registers,Pack Configuration,0161,flg,\r\n";
        let (entries, notes) = entries(text).expect("an image");
        assert_eq!(
            entries,
            [
                ("it-cfg/cell-terminate-voltage".into(), "3100".into(), 5),
                ("registers/pack-configuration".into(), "0x0161".into(), 8)
            ]
        );
        assert_eq!(
            notes,
            [
                "line 6: Gas Gauging/IT Cfg/Something Else: not in the table; left out",
                "line 7: Sealed to Unsealed: a key; left out"
            ]
        );
    }

    #[test]
    fn values_are_read_as_their_format_shows_them() {
        let text = "* Field Order: Class name\tSubClass name\tParameter name\tParameter Value\tDisplay Format\tWrite Formula\n\
                    Gas Gauging\tIT Cfg\tCell Terminate Voltage\t31.1\tdd.dd\tx\n";
        assert_eq!(entries(text).expect("an image").0[0].1, "3110");
        let error = entries(&text.replace("31.1", "31.111")).expect_err("too many decimals").to_string();
        assert_eq!(
            error,
            "line 2, column D: Cell Terminate Voltage: `31.111` does not match the format dd.dd"
        );
        let error = entries(&text.replace("\tx\n", "\tx/10\n")).expect_err("a formula").to_string();
        assert!(error.starts_with(
            "line 2, column F: Cell Terminate Voltage: its value is converted by the formula x/10"
        ));
    }

    /// bqStudio shows temperatures in degrees where tenths are stored, and a resistance where a gain is stored;
    /// only the long form gives the conversion.
    #[test]
    fn a_short_form_is_read_where_its_units_are_clear() {
        for (comma, unit) in [(",", "Units"), ("\t", "Display Units")] {
            let rows = [
                ["Class name", "Subclass name", "Parameter name", "Parameter Value", unit],
                ["Configuration", "Safety", "OT Chg", "55.5", "degC"],
                ["Configuration", "Safety", "OT Dsg", "60", "°C"],
                ["Configuration", "Safety", "OT Chg Recovery", "500", "0.1degC"],
                ["Calibration", "Data", "CC Gain", "5.006", "mOhm"],
                ["Gas Gauging", "IT Cfg", "Cell Terminate Voltage", "3100", "mV"],
                ["Gas Gauging", "IT Cfg", "Load Select", "1", "-"],
            ];
            let rows = rows.map(|row| row.join(comma)).join("\r\n");
            let (entries, notes) = entries(&format!("* Field Order: {rows}\r\n")).expect("an image");
            let values: Vec<_> = entries.iter().map(|(name, value, _)| format!("{name} {value}")).collect();
            assert_eq!(
                values,
                [
                    "safety/ot-chg 555",
                    "safety/ot-dsg 600",
                    "safety/ot-chg-recovery 500",
                    "it-cfg/cell-terminate-voltage 3100",
                    "it-cfg/load-select 1"
                ]
            );
            let why = "shown in mOhm, stored in Num, and the file does not give the conversion; left out";
            assert_eq!(notes, [format!("line 5: CC Gain: {why}")]);
        }
    }

    /// Whether a file says that a voltage is a cell's or not, the number is the same.
    #[test]
    fn a_voltage_per_cell_is_read_in_either_unit() {
        let chip = Chip::by_name("bq34110").expect("a chip");
        for unit in ["mV", "mV/cell", "mV per cell"] {
            let order = "* Field Order: Class name, SubClass name, Parameter name, Parameter Value, Units";
            let text = format!("{order}\nGas Gauging,CEDV Profile,Voltage 0% DOD,4173,{unit}\n");
            let image = parse(&text, Some(chip)).expect("an image");
            let values: Vec<_> = image.entries.iter().map(|entry| entry.text()).collect();
            assert_eq!((values, image.left_out.len()), (vec!["4173".to_string()], 0), "{unit}");
        }
    }

    const ORDER: &str = "* Field Order: Class name, SubClass name, Parameter name, Parameter Value, Data Type, Display \
                         Format, Write Formula, Data Flash Raw Value";

    #[test]
    fn regression_a_quote_around_a_string_was_written_to_the_gauge() {
        let rows = [
            ["Configuration", "Data", "Manufacturer Name", "ACME", "S", "s", "x", ""],
            ["Configuration", "Data", "Device Name", "Pack, \"7\"", "S", "s", "x", ""],
            ["Gas Gauging", "IT Cfg", "Cell Terminate Voltage", "3100", "I", "dddd", "x", "0c1c"],
        ];
        let quoted = rows.map(|row| row.map(|field| format!("\"{}\"", field.replace('"', "\"\""))).join(","));
        let names = ORDER.split(": ").nth(1).expect("names").replace(", ", "\",\"");
        for order in [ORDER, &format!("\"* Field Order: {names}\""), &format!("* Field Order: \"{names}\"")] {
            let (entries, _) = entries(&format!("{order}\n{}\n", quoted.join("\n"))).expect("an image");
            let values: Vec<_> = entries.into_iter().map(|(_, value, _)| value).collect();
            assert_eq!(values, ["ACME", "Pack, %227%22", "3100"], "{order}");
        }
    }

    /// A file as another program saves it: how it quotes, separates, ends lines, and what it does to the header.
    fn resaved(text: &str, quotes: csv::QuoteStyle, comma: char, end: &str, header_too: bool) -> String {
        let rows = rows::rows(text, rows::separator(text.split_once(ORDER_LINE).expect("it has one").1));
        let width = COLUMNS.len();
        let mut saved = String::new();
        for row in rows {
            let mut fields = row.fields.expect("a row");
            if fields[0].starts_with('*') && !header_too {
                saved += &(fields.join(&comma.to_string()) + end);
                continue;
            }
            // All rows of a spreadsheet have the same length.
            fields.resize(width, String::new());
            let mut writer = csv::WriterBuilder::new();
            let mut writer = writer.quote_style(quotes).delimiter(comma as u8).from_writer(Vec::new());
            writer.write_record(&fields).expect("memory is written to");
            let bytes = writer.into_inner().expect("memory is written to");
            saved += &(String::from_utf8(bytes).expect("text").trim_end_matches('\n').to_string() + end);
        }
        saved
    }

    #[test]
    fn a_file_is_read_however_another_program_has_saved_it() {
        for chip in crate::chip::CHIPS {
            let image = super::super::tests::defaults(chip);
            let text = write(&image);
            for (quotes, comma, end, header_too) in [
                (csv::QuoteStyle::Always, ',', "\r\n", false),
                (csv::QuoteStyle::Always, ',', "\n", true),
                (csv::QuoteStyle::Necessary, ';', "\r\n", true),
                (csv::QuoteStyle::Always, '\t', "\r", true),
                (csv::QuoteStyle::Necessary, '\t', "\n", true),
                (csv::QuoteStyle::Necessary, ',', "\r", true),
            ] {
                let saved = resaved(&text, quotes, comma, end, header_too);
                let marked = format!("\u{feff}{saved}");
                let wide: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
                let swapped: Vec<u8> = marked.encode_utf16().flat_map(u16::to_be_bytes).collect();
                for bytes in [saved.as_bytes(), marked.as_bytes(), &wide, &swapped] {
                    let again = Image::read("pack.gg.csv", bytes, None);
                    let again = again.unwrap_or_else(|error| panic!("{}: {error}\n{saved}", chip.name));
                    assert!(again.left_out.is_empty(), "{:?}", again.left_out);
                    let compared = image.compare(&again, &[]).expect("one chip");
                    let differences: Vec<_> = compared.differences.iter().map(ToString::to_string).collect();
                    assert!(differences.is_empty() && compared.only_first.is_empty(), "{differences:?}");
                }
            }
        }
    }

    /// A value of a row, or why there is none.
    fn value_of(row: &str) -> String {
        match entries(&format!("{ORDER}\n{row}\n")) {
            Ok((entries, _)) => entries.into_iter().map(|(_, value, _)| value).collect(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn what_a_spreadsheet_has_changed_is_refused_with_the_cause() {
        let gain = Layout::TI.encode(Type::F4, &Value::Float(5.006)).expect("it fits");
        let gain = format!("Calibration,Data,CC Gain,5006,F,f.fff,x,{}", text::hex(&gain));
        for (row, says) in [
            ("Configuration,Data,Device Name,\"ACME", "line 2: a quote that is opened is never closed"),
            ("Configuration,Data,Device Name,\"AC\"ME,S,s,x,", "line 2: text behind a closing quote"),
            ("Configuration,Data,Device Name,\"\"\"ACME\"\"\",S,s,x,", "it is in quotes"),
            ("Configuration,Data,Device Name,'ACME',S,s,x,", "it is in quotes"),
            ("Configuration,Data,Device Name,1-Mar,S,s,x,", "made a date of it"),
            ("Configuration,Data,Device Name,1.00E+10,S,s,x,", "rounded it"),
            ("Configuration,Data,Device Name,7,S,s,x,033030370000000000000000", "made a number of it"),
            ("Configuration,Data,Device Name,_CME,S,s,x,4.41E+10", "_ may stand for any of them"),
            ("Configuration,Registers,Pack Configuration,1.20E+04,H,hhhh,x,12f3", "rounded it"),
            ("Configuration,Registers,Pack Configuration,1.20E+04,H,hhhh,x,", "rounded it"),
            ("Configuration,Registers,Pack Configuration,####,H,hhhh,x,12e3", "column is too narrow"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,\"3,10\",I,dddd,x,", "a comma in a number"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,3.100,I,dddd,x,", "not a whole number"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,3.Nov,I,d.dd,x,", "made a date of it"),
            ("Calibration,Data,CC Gain,\"5,006\",F,f.fff,x,", "a comma in a number"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,311,I,dd.d,x,0137", "removed the point"),
            (&gain, "removed the point"),
            ("Calibration,Data,CC Delta,5.60E+05,F,f.fff,x,", "rounded it"),
        ] {
            let told = value_of(row);
            // The cell, except in a row that has none.
            let at = if says.starts_with("line 2") { says } else { "line 2, column " };
            assert!(told.contains(says) && told.starts_with(at), "{row}: {told}");
        }
        // A person has edited these.
        for (row, value) in [
            ("Configuration,Data,Device Name,ACME 2,S,s,x,0441434d4500000000000000", "ACME 2"),
            ("Configuration,Data,Device Name,\"\"\"A\"\"\",S,s,x,032241220000000000000000", "%22A%22"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,310,I,dddd,x,0c1c", "310"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,3.2,I,d.ddd,x,0c1c", "3200"),
        ] {
            assert_eq!(value_of(row), value, "{row}");
        }
        let whole = format!("\"{ORDER}\"\n\"Gas Gauging,IT Cfg,Cell Terminate Voltage,3100\"\n");
        let error = entries(&whole).expect_err("a line in one field").to_string();
        assert!(error.starts_with("line 1: no column `class-name`; `* Field Order:` names"), "{error}");
    }

    /// The bytes beside a value tell what stood there, or no other number can be meant.
    #[test]
    fn what_a_spreadsheet_has_changed_is_read_where_it_is_certain() {
        let gain = |shown: &str| {
            let bytes = Layout::TI.encode(Type::F4, &Value::Float(5.006)).expect("it fits");
            value_of(&format!("Calibration,Data,CC Gain,{shown},F,f.fff,x,{}", text::hex(&bytes)))
        };
        let exact = gain("5.006");
        for shown in ["\"5,006\"", "5.006"] {
            assert_eq!(gain(shown), exact, "{shown}");
        }
        for (row, value) in [
            ("Configuration,Registers,Pack Configuration,1.20E+04,H,hhhh,x,12e3", "0x12e3"),
            ("Configuration,Registers,Pack Configuration,161,H,hhhh,x,161", "0x0161"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,\"3,100\",I,dddd,x,", "3100"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,3.100,I,dddd,x,0c1c", "3100"),
            // Three thousand volts do not fit.
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,\"3,100\",I,d.ddd,x,", "3100"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,\"31,1\",I,dd.dd,x,", "3110"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,\"1 234,5\",I,d.d,x,", "12345"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,03.11.2026,I,d.dd,x,137", "311"),
            ("Gas Gauging,IT Cfg,Ra Filter,\"0,5\",I,d.ddd,x,", "500"),
            ("Configuration,Data,Device Name,3-Jan,S,s,x,03312d330000000000000000", "1-3"),
            ("Calibration,Data,CC Delta,\"559,5\",F,f.fff,x,", "559.5"),
        ] {
            assert_eq!(value_of(row), value, "{row}");
        }
        let row = "Configuration,Registers,Pack Configuration,1.20E+04,H,hhhh,x,12e3";
        let image = parse(&format!("{ORDER}\n{row}\n"), Chip::by_name("bq34z100-g1")).expect("an image");
        let note = "line 2, column D: Pack Configuration: its bytes are those of 12e3, which a spreadsheet shows as 1.20E+04";
        assert_eq!(image.notes, [note]);
    }

    /// What a country writes for a point, with its separator of columns.
    #[test]
    fn a_file_with_decimal_commas_is_read() {
        let order = ORDER.replace(", ", ";");
        let rows = [
            "Gas Gauging;IT Cfg;Cell Terminate Voltage;31,1;I;dd.dd;x;0C26;;;",
            "Configuration;Safety;OT Chg;55,5;I;dd.d;x;;;;",
            "Configuration;Data;Device Name;Pack, 7;S;s;x;;;;",
        ];
        let text = format!("\u{feff}{order};;;\r\n{}\r\n", rows.join("\r\n"));
        let image = Image::parse(&text, Chip::by_name("bq34z100-g1")).expect("an image");
        let values: Vec<_> = image.entries.iter().map(Entry::text).collect();
        assert_eq!(values, ["555", "Pack, 7", "3110"]);
    }

    /// A format shows three decimals, and the gauge stores more.
    #[test]
    fn a_number_that_is_shown_rounded_is_read_from_its_bytes() {
        let gain = 0.010_123_4_f64;
        let bytes = Layout::TI.encode(Type::F4, &Value::Float(gain)).expect("it fits");
        let row = |shown: &str| {
            value_of(&format!("Calibration,Data,CC Gain,{shown},F,f.fff,x,{}", text::hex(&bytes)))
        };
        assert_eq!(row("0.010"), notation::render(Type::F4, &Layout::TI.decode(Type::F4, &bytes)));
        assert_eq!(row("0.011"), "0.011");
    }

    #[test]
    fn an_error_names_its_line() {
        let order = "* Field Order: Class name, SubClass name, Parameter name, Parameter Value\n";
        for (text, says) in [
            ("* Device Number 27441-G1\n", "line 1: Device Number: not a hexadecimal word"),
            ("* Firmware Version 1\n", "line 1: Firmware Version: not two or three numbers"),
            ("* Device Number 421\n", "it is for device type 0x0421, which a bq34z100-G1 is not"),
            ("Gas Gauging,IT Cfg,Cell Terminate Voltage,3100\n", "line 1: no line `* Field Order:`"),
            (&format!("{order}Gas Gauging,IT Cfg\n"), "line 2: no field `parameter-name`"),
            (&format!("{order}a,b,c,d,e\n"), "line 2: 5 fields, but the header names 4"),
            (
                &format!("{order}Gas Gauging,IT Cfg,Cell Terminate Voltage,low\n"),
                "line 2, column D: Cell Terminate Voltage: the value is not a whole number",
            ),
        ] {
            let error = entries(text).expect_err(text).to_string();
            assert!(error.starts_with(says), "{text}: {error}");
        }
    }
}
