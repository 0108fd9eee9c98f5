// SPDX-License-Identifier: MIT

//! The older `.gg`, of bqEVSW and of bqStudio's first versions: `[Subclass(Class)]`, then a line `Name = value` for each
//! parameter.
//!
//! It has neither units nor formats, and TI's tools show some values in other units than the stored ones. So a value is
//! read where that makes no difference, and left out elsewhere.

use super::{Header, NAMED, add_hints, string, unscaled, version, wanted};
use crate::chip::{CHIPS, Chip, Parameter, Subclass, kebab_case};
use crate::error::{Cause, Error, Result};
use crate::image::target::{chip_of, fits, versions};
use crate::image::{Faults, Group, Image, at_line};
use crate::notation;
use crate::text::printable;
use crate::value::{Type, Value};

/// What to do about a value that is left out.
const EXPORT: &str = "the file does not give the conversion; left out: a .gg.csv of bqStudio has it";

/// Whether a text has its sections, behind a header of either tool.
pub(in crate::image) fn is_one(text: &str) -> bool {
    let mut lines = text.split(['\r', '\n']).map(str::trim);
    let first = lines.find(|line| !line.is_empty() && !line.starts_with(['*', ';']));
    first.is_some_and(|line| line == HEADER || section(line).is_some())
}

const HEADER: &str = "[Header]";

/// Subclass and class of a section.
fn section(line: &str) -> Option<[&str; 2]> {
    let (subclass, class) = line.strip_prefix('[')?.strip_suffix(")]")?.rsplit_once('(')?;
    Some([subclass.trim(), class.trim()])
}

pub(super) fn read(text: &str, told: Option<&'static Chip>, faults: &mut Faults) -> Option<Image> {
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    let (mut header, mut device) = (Header::default(), None);
    let (mut in_section, mut rows) = (None, Vec::new());
    for (number, line) in (1..).zip(text.lines().map(str::trim)) {
        let assigned = line.split_once('=').map(|(name, value)| (name.trim(), value.trim()));
        if line.is_empty() || line.starts_with(';') {
            continue;
        }
        if let Some(head) = line.strip_prefix('*') {
            if let Err(why) = header.take(head.trim(), &[line.to_string()], number, faults) {
                faults.at(number, why);
            }
        } else if line.starts_with('[') {
            in_section = section(line);
            if in_section.is_none() && line != HEADER {
                faults.at(number, "not a section; they are named [Subclass(Class)]");
            }
        } else if let (Some(section), Some(assigned)) = (in_section, assigned) {
            rows.push((number, section, assigned));
        } else if in_section.is_some() {
            faults.at(number, "neither a section nor a line `Name = value`");
        } else if let Some(("DeviceName", name)) = assigned {
            device = Some((number, name));
        }
    }
    let chip = match device {
        Some((number, name)) => {
            faults.keep(number, of_device(name, told).map_err(|why| at_line(number, why)))
        }
        None => faults.keep(0, chip_of(header.named.or(told), header.device_type, header.firmware)),
    }?;
    let firmware = header.firmware.or(device.and_then(|(_, name)| split(name).1));
    let mut image = Image::new(chip, firmware);
    image.names_chip = device.is_some() || header.device_type.is_some();
    let mut unknown = Vec::new();
    for (number, [subclass, class], (name, shown)) in rows {
        let (subclass, parameter) = match wanted(&mut image, number, [class, subclass, name]) {
            Ok(found) => found,
            Err(Some(name)) if unknown.len() < NAMED => {
                unknown.push((image.left_out.len() - 1, name));
                continue;
            }
            Err(_) => continue,
        };
        match value(subclass, parameter, shown) {
            Ok(Read::Value(value)) => image.add(subclass, parameter, value, number),
            Ok(Read::None) => {}
            Ok(Read::LeftOut(why, group)) => {
                image.leave_out(number, format_args!("{}: {why}", parameter.name), group);
            }
            Err(error) => faults.add(number, error.within(&format!("line {number}"))),
        }
    }
    add_hints(&mut image, unknown);
    Some(image)
}

/// Name and firmware of a device, such as `bq27500 v1.30`.
fn split(device: &str) -> (&str, Option<u16>) {
    let found = device.rsplit_once(" v").and_then(|(name, text)| Some((name.trim(), version(text)?)));
    found.map_or((device, None), |(name, firmware)| (name, Some(firmware)))
}

/// The chip of a device's name and firmware.
fn of_device(device: &str, told: Option<&'static Chip>) -> Result<&'static Chip, String> {
    let (name, firmware) = split(device);
    let plain = |name: &str| kebab_case(name).replace('-', "");
    let name = plain(name);
    let is = |chip: &&Chip| {
        let model = plain(chip.model);
        let alike = !name.is_empty() && (model.starts_with(&name) || name.starts_with(&model));
        alike && chip.has_table() && firmware.is_none_or(|code| fits(chip.identity.firmware, code))
    };
    let shown = printable(device);
    if let Some(told) = told {
        return if is(&told) {
            Ok(told)
        } else {
            Err(format!("it is for a {shown}, not for a {}", told.model))
        };
    }
    match &CHIPS.iter().copied().filter(is).collect::<Vec<_>>()[..] {
        [chip] => Ok(chip),
        [] => Err(format!("it is for a {shown}, whose data flash gaugefs does not know")),
        several => Err(format!("it is for a {shown}: {}; choose with --chip", versions(several))),
    }
}

enum Read {
    Value(Value),
    /// The file has no value of it.
    None,
    LeftOut(String, Option<Group>),
}

/// What a file shows of a parameter.
fn value(subclass: &Subclass, parameter: &Parameter, shown: &str) -> Result<Read> {
    let bad = |why: String| Err(Error::new(parameter.name, Cause::Invalid, why));
    let left_out = |what: &str, group| Ok(Read::LeftOut(format!("{what}, and {EXPORT}"), group));
    if let Type::S(_) = parameter.kind {
        return string(parameter, shown, None).map(|(value, _)| Read::Value(value));
    }
    if shown.is_empty() {
        return Ok(Read::None);
    }
    if subclass.class == "Calibration" {
        return left_out("shown in a unit of TI's tools", Some(Group::Calibration));
    }
    if parameter.is_date() {
        return left_out("shown as a date", Some(Group::Serial));
    }
    let parse = |text: &str| notation::parse_stored(parameter, text.as_bytes()).map(Read::Value);
    if let Type::H(_) = parameter.kind {
        return parse(&format!("0x{}", shown.strip_prefix("0x").unwrap_or(shown)));
    }
    let is_zero = shown.chars().all(|letter| matches!(letter, '0' | '.'));
    let point = shown.split_once('.').map(|(_, after)| after.len());
    match (decimals(parameter), point) {
        (Some(0), None) => parse(shown),
        (Some(_), _) if is_zero => parse("0"),
        (Some(decimals), Some(shown_decimals)) if decimals == shown_decimals && decimals > 0 => {
            match unscaled(shown, decimals) {
                Some(text) => parse(&text),
                None => bad(format!("`{shown}` is not a number")),
            }
        }
        _ if shown.parse::<f64>().is_err() => bad(format!("`{shown}` is not a number")),
        _ => left_out(&format!("stored in {}, and shown without a unit", parameter.unit), None),
    }
}

/// Decimals of a value that is shown in the unit without its factor, such as 0.1; `None` if that is no power of ten.
fn decimals(parameter: &Parameter) -> Option<usize> {
    let (factor, unit) = crate::unit::split(parameter.unit);
    match (parameter.kind, factor) {
        (Type::F4, _) => None,
        // Zero degrees Celsius are no zero of these.
        _ if unit.trim() == "K" => None,
        (_, "" | "-") => Some(0),
        (_, "0.1") => Some(1),
        (_, "0.01") => Some(2),
        (_, "0.001") => Some(3),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As bqEVSW writes one, with a time that is no UTF-8.
    const FILE: &[u8] = b"[Header]\r\nbq EVSW Version = 0.9.62\r\nDeviceName = bq27500 v1.20\r\n\
        Time = 2009\xb3\xe2 3\xbf\xf9\r\n\r\n\
        [Safety(Configuration)]\r\nOT Chg = 55.5\r\nOT Chg Time = 2\r\nOT Dsg = 60\r\n\r\n\
        [Charge Inhibit Config(Configuration)]\r\nCharge Inhibit Temp Low = 0.0\r\nTemp Hys = 5.0\r\n\r\n\
        [Data(Configuration)]\r\nDesign Capacity = 1340\r\nDevice Name = P = 7\r\nInitial Standby Current = -10\r\n\r\n\
        [Registers(Configuration)]\r\nOperation Configuration = 0979\r\n\r\n\
        [IT Cfg(Fuel Gauging)]\r\nTerminate Volt = 3000\r\n\r\n\
        [Data(Calibration)]\r\nCC Gain = 10.123\r\n\r\n\
        [Codes(Security)]\r\nUnseal Key 0 = 36720414\r\n";

    fn examine(text: &[u8], chip: Option<&str>) -> (Option<Image>, Vec<String>) {
        let told = chip.map(|chip| Chip::by_name(chip).expect("a chip"));
        let reading = Image::examine("pack.gg", text, told);
        (reading.image, reading.faults.iter().map(ToString::to_string).collect())
    }

    fn assert_refused(text: &str, chip: Option<&str>, says: &str) {
        let (_, told) = examine(text.as_bytes(), chip);
        assert!(told.first().is_some_and(|first| first.starts_with(says)), "{says}: {told:?}");
    }

    #[test]
    fn a_value_is_read_where_no_unit_can_matter() {
        for chip in [None, Some("bq27500")] {
            let (image, faults) = examine(FILE, chip);
            let image = image.expect("an image");
            assert_eq!((faults.len(), image.chip.name, image.firmware), (0, "bq27500", Some(0x0120)));
            assert!(image.names_chip);
            let values: Vec<_> =
                image.entries.iter().map(|entry| (image.name(entry), entry.text(), entry.line)).collect();
            let values: Vec<_> =
                values.iter().map(|(name, value, line)| (name.as_str(), value.as_str(), *line)).collect();
            assert_eq!(
                values,
                [
                    ("safety/ot-chg", "555", 7),
                    ("safety/ot-chg-time", "2", 8),
                    ("charge-inhibit-config/charge-inhibit-temp-low", "0", 12),
                    ("charge-inhibit-config/temp-hys", "50", 13),
                    ("configuration-data/initial-standby-current", "-10", 18),
                    ("configuration-data/design-capacity", "1340", 16),
                    ("configuration-data/device-name", "P = 7", 17),
                    ("registers/operation-configuration", "0x0979", 21),
                ]
            );
            let told: Vec<_> = image.left_out.iter().map(|left| left.text.as_str()).collect();
            let why = "and the file does not give the conversion; left out: a .gg.csv of bqStudio has it";
            let degrees = format!("line 9: OT Dsg: stored in 0.1°C, and shown without a unit, {why}");
            let gain = format!("line 27: CC Gain: shown in a unit of TI's tools, {why}");
            let voltage = "line 24: Fuel Gauging/IT Cfg/Terminate Volt: not in the table; left out; did you mean Fuel \
                           Gauging/IT Cfg/Terminate Voltage?";
            assert_eq!(told, [&*degrees, voltage, &*gain, "line 30: Unseal Key 0: a key; left out"]);
        }
    }

    /// The gauge's type stands in the header of bqStudio's first versions.
    #[test]
    fn the_header_of_bqstudio_is_read_too() {
        let head =
            "* Texas Instruments Data Flash File\n*\n* Device Number 100\n* Firmware Version 0.16\n*\n";
        let (image, faults) =
            examine(format!("{head}[IT Cfg(Gas Gauging)]\nRa Filter = 500\n").as_bytes(), None);
        let image = image.expect("an image");
        assert_eq!((faults.len(), image.chip.name, image.firmware), (0, "bq34z100-g1", Some(0x0016)));
        assert_eq!((image.entries[0].text(), image.entries[0].line), ("500".into(), 7));
    }

    #[test]
    fn the_device_and_its_firmware_decide() {
        let of = |device: &str| {
            format!("[Header]\nDeviceName = {device}\n[Safety(Configuration)]\nOT Chg Time = 3\n")
        };
        for (device, chip) in [
            ("bq27500 v1.30", "bq27500-v130"),
            ("bq27500 v1.06", "bq27500"),
            ("BQ34Z100-G1 v0.16", "bq34z100-g1"),
        ] {
            let (image, faults) = examine(of(device).as_bytes(), None);
            assert_eq!(image.map(|image| image.chip.name), Some(chip), "{device}: {faults:?}");
        }
        for (device, chip, says) in [
            (
                "bq30z55R3 v0.36",
                None,
                "line 2: it is for a bq30z55R3 v0.36, whose data flash gaugefs does not know",
            ),
            ("bq27500 v1.10", None, "line 2: it is for a bq27500 v1.10, whose data flash"),
            (
                "bq27500",
                None,
                "line 2: it is for a bq27500: bq27500 with firmware 0x0106 or 0x0120 and a bq27500-V130",
            ),
            ("bq27500 v1.30", Some("bq27500"), "line 2: it is for a bq27500 v1.30, not for a bq27500"),
            ("bq30z55R3", Some("bq27500"), "line 2: it is for a bq30z55R3, not for a bq27500"),
            ("", Some("bq27500"), "line 2: it is for a , not for a bq27500"),
        ] {
            assert_refused(&of(device), chip, says);
        }
        let without = "[Safety(Configuration)]\nOT Chg Time = 3\n";
        assert_refused(without, None, "it does not say which gauge it is for; name it with --chip");
        let (image, _) = examine(without.as_bytes(), Some("bq27500"));
        assert!(image.is_some_and(|image| !image.names_chip && image.firmware.is_none()));
    }

    #[test]
    fn a_wrong_line_is_named() {
        let head = "[Header]\nDeviceName = bq27500 v1.20\n[Safety(Configuration)]\n";
        for (line, says) in [
            ("OT Chg", "line 4: neither a section nor a line"),
            ("OT Chg Time = soon", "line 4: OT Chg Time: the value is not a whole number"),
            ("OT Chg = warm", "line 4: OT Chg: `warm` is not a number"),
            ("[Safety]", "line 4: not a section"),
            ("OT Chg Time = 2\nOT Chg Time = 2", "line 5: safety/ot-chg-time is also in line 4"),
            (
                "[Registers(Configuration)]\nOperation Configuration = 0g79",
                "line 5: Operation Configuration: ",
            ),
        ] {
            assert_refused(&format!("{head}{line}\n"), None, says);
        }
        // What a value of a number with a point is stored in is not known.
        let (image, faults) = examine(format!("{head}OT Chg Time = 2.0\n").as_bytes(), None);
        assert!(image.is_some_and(|image| image.left_out.len() == 1) && faults.len() == 1, "{faults:?}");
    }
}
