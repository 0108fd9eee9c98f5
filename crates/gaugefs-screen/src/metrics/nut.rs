// SPDX-License-Identifier: MIT

//! A gauge as a file for NUT's driver `dummy-ups` (dummy-ups(8)): a line per variable, with the names and units of
//! NUT's list (docs/nut-names.txt, RFC 9271).
//!
//! The driver keeps a variable that the file lacks, so every variable is in every file, empty while unknown. upsmon
//! takes an empty `ups.status` for a lost UPS.

use std::fmt::Write;

use ti_gauge::text;

use super::page::{Gauge, ordered};

/// A variable: its name, and the source of its text.
type Variable = (&'static str, Origin);

/// The source of a text. A file is read because a row names it here.
enum Origin {
    Fixed(&'static str),
    /// The text of a file.
    Text(&'static str),
    /// The number of a file, divided by this factor.
    Number(&'static str, f64),
    /// Text made by a function from the texts of these files, in their order.
    Made(&'static [&'static str], fn(&[Option<&str>]) -> Option<String>),
}

use Origin::{Fixed, Made, Number, Text};

static VARIABLES: &[Variable] = &[
    ("device.type", Fixed("ups")),
    ("device.mfr", Text("manufacturer")),
    ("device.model", Text("model_name")),
    ("device.serial", Text("serial_number")),
    // The driver has its own ones, which NUT's clients show too.
    ("ups.mfr", Text("manufacturer")),
    ("ups.model", Text("model_name")),
    ("ups.serial", Text("serial_number")),
    ("ups.firmware", Text("gauge/firmware_version")),
    ("battery.type", Made(&["technology"], known)),
    (
        "battery.mfr.date",
        Made(&["manufacture_year", "manufacture_month", "manufacture_day"], |texts| {
            let number = |at: usize| texts[at]?.parse::<u16>().ok();
            Some(format!("{:04}-{:02}-{:02}", number(0)?, number(1)?, number(2)?))
        }),
    ),
    ("battery.charge", Number("capacity", 1.0)),
    ("battery.voltage", Number("voltage_now", 1e6)),
    ("battery.voltage.low", Number("voltage_min_design", 1e6)),
    ("battery.voltage.high", Number("voltage_max_design", 1e6)),
    ("battery.current", Number("current_now", 1e6)),
    ("battery.temperature", Number("temp", 10.0)),
    ("battery.capacity", Number("charge_full", 1e6)),
    ("battery.capacity.nominal", Number("charge_full_design", 1e6)),
    (
        "battery.runtime",
        Made(&["time_to_empty_now", "time_to_empty_avg"], |texts| {
            texts
                .iter()
                .flatten()
                .find_map(|text| text.parse::<u64>().ok())
                .map(|seconds| seconds.to_string())
        }),
    ),
    ("battery.status", Made(&["health"], known)),
    (
        "battery.charger.status",
        Made(&["status"], |texts| {
            let word = match texts[0]? {
                "Charging" => "charging",
                "Discharging" => "discharging",
                "Full" => "resting",
                _ => return None,
            };
            Some(word.into())
        }),
    ),
    ("ups.status", Made(&["status", "capacity_level"], status)),
];

/// A word, unless it means that the value is missing.
fn known(texts: &[Option<&str>]) -> Option<String> {
    texts[0].filter(|word| !["", "Unknown"].contains(word)).map(String::from)
}

/// The words of `ups.status`: on line or on battery, and low when the gauge says critical. Without knowing whether the
/// pack discharges, it is empty.
fn status(texts: &[Option<&str>]) -> Option<String> {
    let words = match texts[0]? {
        "Discharging" => "OB DISCHRG",
        "Charging" => "OL CHRG",
        "Full" | "Not charging" => "OL",
        _ => return None,
    };
    let is_low = texts[1] == Some("Critical");
    Some(format!("{words}{}", if is_low { " LB" } else { "" }))
}

impl Origin {
    fn files(&self) -> Vec<&'static str> {
        match self {
            Self::Fixed(_) => Vec::new(),
            Self::Text(file) | Self::Number(file, _) => vec![file],
            Self::Made(files, _) => files.to_vec(),
        }
    }

    fn text(&self, gauge: &Gauge) -> Option<String> {
        match self {
            Self::Fixed(text) => Some(text.to_string()),
            Self::Text(file) => gauge.text(file).filter(|text| !text.is_empty()).map(String::from),
            Self::Number(file, divisor) => gauge.number(file).map(|number| (number / divisor).to_string()),
            Self::Made(files, text) => text(&gauge.texts_of(files)),
        }
    }
}

/// The file that says whether there is anything to show.
const PRESENT: &str = "present";

/// The files behind the variables.
pub(super) fn files() -> Vec<String> {
    ordered(VARIABLES.iter().flat_map(|(_, origin)| origin.files()).chain([PRESENT]))
}

/// The file for a gauge, or for a missing one.
pub(super) fn render(gauge: Option<&Gauge>) -> String {
    let mut file = String::new();
    let present = gauge.filter(|gauge| gauge.flag(PRESENT) == Some(1.0));
    for (name, origin) in VARIABLES {
        let text = present.and_then(|gauge| origin.text(gauge)).unwrap_or_default();
        // Writing to a String does not fail. An empty line would get the previous line's word.
        let _ = writeln!(file, "{name}: {}", quoted(&text));
    }
    file
}

/// A value of NUT's files: plain words, or quoted.
fn quoted(value: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || ".,:+-/_ ".contains(letter);
    if !value.is_empty() && value.chars().all(is_plain) {
        return value.to_string();
    }
    format!("\"{}\"", text::printable(value).replace('\\', "\\\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gauge(rows: &[(&str, &str)]) -> Gauge {
        let texts = rows.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect();
        Gauge { name: "BAT0".into(), texts }
    }

    fn value<'a>(file: &'a str, name: &str) -> &'a str {
        let found = file.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
        found.unwrap_or_else(|| panic!("{name} is not in:\n{file}"))
    }

    #[test]
    fn values_have_the_names_and_units_of_nut() {
        let file = render(Some(&gauge(&[
            ("present", "1"),
            ("model_name", "bq34z100-G1"),
            ("status", "Discharging"),
            ("capacity", "60"),
            ("voltage_now", "3855000"),
            ("current_now", "-500000"),
            ("temp", "253"),
            ("charge_full", "1000000"),
            ("time_to_empty_avg", "4320"),
            ("technology", "Li-ion"),
            ("manufacture_year", "2026"),
            ("manufacture_month", "1"),
            ("manufacture_day", "22"),
            ("manufacturer", "Texas Instruments"),
        ])));
        for (name, wanted) in [
            ("ups.status", "OB DISCHRG"),
            ("ups.model", "bq34z100-G1"),
            ("device.mfr", "Texas Instruments"),
            ("battery.charge", "60"),
            ("battery.voltage", "3.855"),
            ("battery.current", "-0.5"),
            ("battery.temperature", "25.3"),
            ("battery.capacity", "1"),
            ("battery.runtime", "4320"),
            ("battery.type", "Li-ion"),
            ("battery.mfr.date", "2026-01-22"),
            ("battery.charger.status", "discharging"),
            ("battery.voltage.high", "\"\""),
        ] {
            assert_eq!(value(&file, name), wanted, "{name}");
        }
    }

    #[test]
    fn the_files_are_those_of_the_variables() {
        let files = files();
        assert!(
            ["present", "capacity_level", "manufacture_day"]
                .iter()
                .all(|file| files.contains(&file.to_string()))
        );
        // The others are attributes, which are one file.
        let others: Vec<_> = files.iter().filter(|file| file.contains('/')).collect();
        assert_eq!(others, ["gauge/firmware_version"]);
    }

    #[test]
    fn the_status_follows_the_gauge_and_is_empty_while_that_is_unknown() {
        for (status, level, wanted) in [
            ("Charging", "Normal", "OL CHRG"),
            ("Full", "Full", "OL"),
            ("Not charging", "Low", "OL"),
            ("Discharging", "Low", "OB DISCHRG"),
            ("Discharging", "Critical", "OB DISCHRG LB"),
            ("Charging", "Critical", "OL CHRG LB"),
            ("Unknown", "Critical", "\"\""),
        ] {
            let rows = [("present", "1"), ("status", status), ("capacity_level", level)];
            assert_eq!(value(&render(Some(&gauge(&rows))), "ups.status"), wanted, "{status} {level}");
        }
        // Of a gauge that is gone nothing remains, neither a charge nor a status.
        let absent = gauge(&[("present", "0"), ("status", "Discharging"), ("capacity", "60")]);
        for file in [render(Some(&absent)), render(None)] {
            assert_eq!((value(&file, "ups.status"), value(&file, "battery.charge")), ("\"\"", "\"\""));
            assert_eq!(file.lines().count(), VARIABLES.len());
        }
    }

    #[test]
    fn a_text_of_a_gauge_is_one_value() {
        let evil = "a\"b\\ # c\nups.status: OL\u{1b}";
        let file = render(Some(&gauge(&[("present", "1"), ("model_name", evil)])));
        assert_eq!(file.lines().count(), VARIABLES.len(), "{file}");
        assert!(value(&file, "ups.model").starts_with("\"a\\\"b\\\\"), "{file}");
    }
}
