// SPDX-License-Identifier: MIT

//! A gauge as NUT's driver `dummy-ups` reads it from a file (dummy-ups(8)): one line for each variable, with the names and
//! units of NUT's list (docs/nut-names.txt, RFC 9271).
//!
//! The driver keeps a variable that the file lacks, so each is there each time, and is empty while it is not known. An
//! empty `ups.status` is what upsmon takes for a UPS that is gone.

use std::fmt::Write;

use ti_gauge::text;

use super::page::Gauge;

/// A variable: its name, and its text if the gauge has it.
type Variable = (&'static str, fn(&Gauge) -> Option<String>);

static VARIABLES: &[Variable] = &[
    ("device.type", |_| Some("ups".into())),
    ("device.mfr", |gauge| gauge.named("manufacturer")),
    ("device.model", |gauge| gauge.named("model_name")),
    ("device.serial", |gauge| gauge.named("serial_number")),
    // The driver has others of its own for these, which NUT's clients show beside them.
    ("ups.mfr", |gauge| gauge.named("manufacturer")),
    ("ups.model", |gauge| gauge.named("model_name")),
    ("ups.serial", |gauge| gauge.named("serial_number")),
    ("ups.firmware", |gauge| gauge.named("gauge/firmware_version")),
    ("battery.type", |gauge| gauge.named("technology").filter(|name| name != "Unknown")),
    ("battery.mfr.date", |gauge| {
        let number = |end: &str| gauge.number(&format!("manufacture_{end}"));
        Some(format!("{:04}-{:02}-{:02}", number("year")?, number("month")?, number("day")?))
    }),
    ("battery.charge", |gauge| gauge.scaled("capacity", 1.0)),
    ("battery.voltage", |gauge| gauge.scaled("voltage_now", 1e6)),
    ("battery.voltage.low", |gauge| gauge.scaled("voltage_min_design", 1e6)),
    ("battery.voltage.high", |gauge| gauge.scaled("voltage_max_design", 1e6)),
    ("battery.current", |gauge| gauge.scaled("current_now", 1e6)),
    ("battery.temperature", |gauge| gauge.scaled("temp", 10.0)),
    ("battery.capacity", |gauge| gauge.scaled("charge_full", 1e6)),
    ("battery.capacity.nominal", |gauge| gauge.scaled("charge_full_design", 1e6)),
    ("battery.runtime", |gauge| {
        gauge.scaled("time_to_empty_now", 1.0).or_else(|| gauge.scaled("time_to_empty_avg", 1.0))
    }),
    ("battery.status", |gauge| gauge.named("health").filter(|word| word != "Unknown")),
    ("battery.charger.status", |gauge| {
        let word = match gauge.text("status")? {
            "Charging" => "charging",
            "Discharging" => "discharging",
            "Full" => "resting",
            _ => return None,
        };
        Some(word.into())
    }),
    ("ups.status", status),
];

/// The words of `ups.status`: on line or on battery, and low when the gauge says that it is critical. A gauge that cannot
/// say whether its pack discharges has none.
fn status(gauge: &Gauge) -> Option<String> {
    let words = match gauge.text("status")? {
        "Discharging" => "OB DISCHRG",
        "Charging" => "OL CHRG",
        "Full" | "Not charging" => "OL",
        _ => return None,
    };
    let is_low = gauge.text("capacity_level") == Some("Critical");
    Some(format!("{words}{}", if is_low { " LB" } else { "" }))
}

impl Gauge {
    fn named(&self, file: &str) -> Option<String> {
        self.text(file).filter(|text| !text.is_empty()).map(str::to_string)
    }

    /// A number in the unit that so many of the file's are.
    fn scaled(&self, file: &str, divisor: f64) -> Option<String> {
        self.number(file).map(|number| (number / divisor).to_string())
    }
}

/// The file for a gauge, or for one that is gone.
pub(super) fn render(gauge: Option<&Gauge>) -> String {
    let mut file = String::new();
    let present = gauge.filter(|gauge| gauge.flag("present") == Some(1.0));
    for (name, value) in VARIABLES {
        let text = present.and_then(value).unwrap_or_default();
        // Writing to a String does not fail. Without a word of its own, a line gets that of the line before it.
        let _ = writeln!(file, "{name}: {}", quoted(&text));
    }
    file
}

/// A value of NUT's files: its words as they are, or else in quotes.
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
