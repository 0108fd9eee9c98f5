// SPDX-License-Identifier: MIT

//! Conditions on the files of a gauge's folder, such as `capacity<20 && status==Discharging`.
//!
//! A condition is parsed strictly: a misspelt name would never come true, nor would `voltage_now<3.9`, because the file
//! is in microvolts. The texts of one poll decide; a missing value makes no condition true.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use ti_gauge::chip::CHIPS;
use ti_gauge::{text, unit};

use crate::names::{attribute, attributes, files};

/// Decides by whether the gauge is missing, not by its values.
const MISSING: &str = "missing";
/// Attributes with a few fixed words. A misspelt one would never come true.
const WORDS: [(&str, &[&str]); 3] = [
    ("status", &["Charging", "Discharging", "Not charging", "Full", "Unknown"]),
    ("capacity_level", &["Full", "Normal", "Low", "Critical", "Unknown"]),
    (
        "health",
        &[
            "Good",
            "Overheat",
            "Cold",
            "Over voltage",
            "Under voltage",
            "Dead",
            "Calibration required",
            "Unknown",
        ],
    ),
];
/// The files of a gauge's folder, by their names in it.
pub type Texts = BTreeMap<String, String>;

/// A condition: terms that must all be true.
#[derive(Clone, Debug)]
pub struct Condition {
    text: String,
    terms: Vec<Term>,
}

#[derive(Clone, Debug, PartialEq)]
enum Term {
    Missing,
    Compare { name: String, by: Operator, with: Operand },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Operator {
    Less,
    AtMost,
    More,
    AtLeast,
    Equal,
    Unequal,
    Has,
}

#[derive(Clone, Debug, PartialEq)]
enum Operand {
    /// In the unit of the file; the text as written is for files without a number.
    Number(f64, String),
    Text(String),
}

/// Operators as written; a longer one comes before its prefix.
const OPERATORS: [(&str, Operator); 8] = [
    ("<=", Operator::AtMost),
    (">=", Operator::AtLeast),
    ("==", Operator::Equal),
    ("!=", Operator::Unequal),
    ("<", Operator::Less),
    (">", Operator::More),
    ("=", Operator::Equal),
    (" has ", Operator::Has),
];

impl Condition {
    /// The files that it compares, each once.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.terms.iter().filter_map(|term| match term {
            Term::Compare { name, .. } => Some(name.as_str()),
            Term::Missing => None,
        })
    }

    /// Whether it is true for these files, or without any for a missing gauge; `None` if a missing value leaves it open.
    pub fn holds(&self, texts: Option<&Texts>) -> Option<bool> {
        let mut all = Some(true);
        for term in &self.terms {
            match term.holds(texts) {
                Some(true) => {}
                Some(false) => return Some(false),
                None => all = None,
            }
        }
        all
    }

    /// The compared values, for a message.
    pub fn values(&self, texts: Option<&Texts>) -> String {
        let value = |name: &str| match texts.and_then(|texts| texts.get(name)) {
            Some(text) => format!("{name} {text}"),
            None => format!("{name} missing"),
        };
        let values: Vec<_> = self.names().map(value).collect();
        if values.is_empty() { MISSING.into() } else { values.join(", ") }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let terms = text.split("&&").map(|term| Term::parse(term.trim())).collect::<Result<Vec<_>, _>>()?;
        if terms.len() > 1 && terms.contains(&Term::Missing) {
            return Err("`missing` stands alone: a gauge that is missing has no values".into());
        }
        Ok(Self { text: text.trim().to_string(), terms })
    }
}

impl Term {
    fn parse(term: &str) -> Result<Self, String> {
        if term == MISSING {
            return Ok(Self::Missing);
        }
        // The first operator in the text: a word on the right may contain one.
        let found = OPERATORS.iter().filter_map(|&(sign, by)| Some((term.find(sign)?, sign, by)));
        let Some((at, sign, by)) = found.min_by_key(|&(at, sign, _)| (at, usize::MAX - sign.len())) else {
            return Err(format!(
                "`{}`: no comparison; write for instance capacity<20, status==Full, \
                 'gauge/flags has FC' or missing",
                term.escape_debug()
            ));
        };
        let (name, value) = (term[..at].trim(), term[at + sign.len()..].trim());
        let value = value.strip_prefix('"').and_then(|value| value.strip_suffix('"')).unwrap_or(value);
        if value.is_empty() {
            return Err(format!("`{}`: nothing to compare with", term.escape_debug()));
        }
        let with = match name.strip_prefix("gauge/") {
            Some(file) => of_gauge((name, sign), file, by, value)?,
            None => of_attribute((name, sign), by, value)?,
        };
        Ok(Self::Compare { name: name.into(), by, with })
    }

    fn holds(&self, texts: Option<&Texts>) -> Option<bool> {
        let Self::Compare { name, by, with } = self else { return Some(texts.is_none()) };
        let text = texts?.get(name)?;
        match (with, number(text)) {
            (Operand::Number(with, _), Some(number)) => Some(match by {
                Operator::Less => number < *with,
                Operator::AtMost => number <= *with,
                Operator::More => number > *with,
                Operator::AtLeast => number >= *with,
                Operator::Equal => number == *with,
                Operator::Unequal => number != *with,
                Operator::Has => return None,
            }),
            (Operand::Number(_, word) | Operand::Text(word), _) => match by {
                Operator::Equal => Some(text == word),
                Operator::Unequal => Some(text != word),
                Operator::Has => Some(text.split_whitespace().any(|one| one == word)),
                _ => None,
            },
        }
    }
}

fn number(text: &str) -> Option<f64> {
    let word = text::unsigned::<u64>(text).map(|word| word as f64);
    word.or_else(|| text.parse().ok().filter(|number: &f64| number.is_finite()))
}

fn of_attribute((name, sign): (&str, &str), by: Operator, value: &str) -> Result<Operand, String> {
    let attribute = attribute(name).ok_or_else(|| unknown(name))?;
    if name == "present" {
        return Err("write `missing`: a gauge that is not present has no values to compare".into());
    }
    if attribute.is_number() {
        if by == Operator::Has {
            return Err(format!("{name} is a number; compare it with < <= > >= == or !="));
        }
        let number = measured(name, sign, value, attribute.unit())?;
        return Ok(Operand::Number(number, value.into()));
    }
    if !matches!(by, Operator::Equal | Operator::Unequal) {
        return Err(format!("{name} is a text; compare it with == or !="));
    }
    let Some((_, words)) = WORDS.iter().find(|(of, _)| *of == name) else {
        return Ok(Operand::Text(value.into()));
    };
    let word = words.iter().find(|word| word.eq_ignore_ascii_case(value));
    let word = word.ok_or_else(|| {
        format!("{name} is never `{}`; it is one of: {}", value.escape_debug(), words.join(", "))
    })?;
    Ok(Operand::Text((*word).into()))
}

fn of_gauge((name, sign): (&str, &str), file: &str, by: Operator, value: &str) -> Result<Operand, String> {
    let files: Vec<_> = files().filter(|known| known.name == file).collect();
    let Some(first) = files.first() else { return Err(unknown(name)) };
    let bits = || files.iter().flat_map(|file| file.bits.iter().map(|bit| bit.name));
    if by == Operator::Has {
        if bits().next().is_none() {
            return Err(format!("{name} is not a word of flags; compare it with < <= > >= == or !="));
        }
        if !bits().any(|bit| bit == value) {
            let hint =
                text::nearest(value, bits()).map_or(String::new(), |bit| format!("; did you mean {bit}?"));
            return Err(format!("no gauge has a flag `{}` in {name}{hint}", value.escape_debug()));
        }
        return Ok(Operand::Text(value.into()));
    }
    if bits().next().is_some() {
        return Err(format!("{name} lists flags; write '{name} has FLAG'"));
    }
    // Where parts differ in a register's unit, a number is compared as it is.
    let own = if files.iter().all(|file| file.unit == first.unit) { first.unit } else { "" };
    let may_be_text = !unit::is_known(own) && matches!(by, Operator::Equal | Operator::Unequal);
    match measured(name, sign, value, own) {
        Ok(number) => Ok(Operand::Number(number, value.into())),
        Err(_) if may_be_text => Ok(Operand::Text(value.into())),
        Err(why) => Err(why),
    }
}

/// The number in the unit of its file. Without a unit it is refused, as people mean another one, but for percent.
fn measured(name: &str, sign: &str, value: &str, own: &str) -> Result<f64, String> {
    let shown = value.escape_debug();
    let (has_unit, bare) = (unit::is_known(own), number(value));
    if let Some(number) = bare.filter(|_| !has_unit || own == "%") {
        return Ok(number);
    }
    if let Some(number) = unit::measured(value, own) {
        return Ok(number);
    }
    let units = unit::accepted_for(own);
    match bare.and_then(|number| unit::likely(number, own)) {
        Some(likely) => {
            // A unit such as 0.1°C cannot be written behind a number.
            let same = unit::measured(&likely, own)
                .filter(|_| !own.starts_with(|first: char| first.is_ascii_digit()));
            let same = same.map(|number| format!("{number}{own}")).filter(|same| *same != likely);
            let same = same.map_or(String::new(), |same| {
                format!("; in the unit of the file that is {name}{sign}{same}")
            });
            Err(format!(
                "{name}: `{shown}` has no unit: write {name}{sign}{likely} if it means {likely}, or another number \
                 with {units}{same}"
            ))
        }
        None if has_unit => Err(format!("{name}: `{shown}` is not a number of {units}")),
        None => Err(format!("{name}: `{shown}` is not a number")),
    }
}

fn unknown(name: &str) -> String {
    let attributes = attributes().map(|attribute| attribute.name.to_string());
    let names: Vec<_> = attributes.chain(files().map(|file| format!("gauge/{}", file.name))).collect();
    let shown = name.escape_debug();
    let what = format!("no gauge has a file `{shown}`");
    let parameter = || CHIPS.iter().find_map(|chip| Some(chip.name_of(*chip.with_parts(name).first()?)));
    match (text::nearest(name, names.iter().map(String::as_str)), parameter()) {
        (Some(meant), _) => format!("{what}; did you mean {meant}?"),
        (None, Some(parameter)) => {
            format!("{what}, and {parameter} is a parameter of data flash: `gaugefs get` shows it")
        }
        (None, None) => format!("{what}; name one of its folder, such as capacity or gauge/flags"),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn texts(rows: &[(&str, &str)]) -> Texts {
        rows.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect()
    }

    #[test]
    fn numbers_are_compared_in_the_unit_of_the_file() {
        let pack = texts(&[
            ("capacity", "19"),
            ("voltage_now", "3100000"),
            ("current_now", "-500000"),
            ("charge_now", "1800000"),
            ("temp", "-55"),
            ("time_to_empty_now", "600"),
            ("gauge/age_ms", "1500"),
            ("gauge/registers/voltage", "3100"),
            ("gauge/chem_id", "0x0107"),
            ("gauge/poll_interval", "0.5"),
        ]);
        let holds = |text: &str| text.parse::<Condition>().expect(text).holds(Some(&pack)).expect(text);
        for text in [
            "capacity<20",
            "capacity <= 19 %",
            "voltage_now==3.1V",
            "voltage_now == 3100 mV",
            "voltage_now<=3100000uV",
            "current_now==-0.5A",
            "current_now < -499mA",
            "current_now==-500000uA",
            "charge_now>1799mAh",
            "temp<-5.4°C",
            "temp==-5.5 C",
            "temp!=0C",
            "time_to_empty_now<=10min",
            "gauge/age_ms>1.4s",
            "gauge/registers/voltage==3.1V",
            "gauge/registers/voltage==3100mV",
            "gauge/chem_id==0x0107",
            "gauge/chem_id==263",
            "gauge/poll_interval<1s",
            "capacity<20 && voltage_now>3V && temp!=0C",
        ] {
            assert!(holds(text), "{text}");
        }
        for text in ["capacity<19", "voltage_now>3.1V", "capacity<20 && voltage_now<3V", "temp>0C", "missing"]
        {
            assert!(!holds(text), "{text}");
        }
    }

    #[test]
    fn regression_a_bare_number_of_a_quantity_is_refused_with_the_unit_that_was_probably_meant() {
        for (text, likely) in [
            ("voltage_now<3.9", "write voltage_now<3.9V if it means 3.9V"),
            ("voltage_now<3.9", "in the unit of the file that is voltage_now<3900000uV"),
            ("voltage_now<3900", "write voltage_now<3900mV"),
            ("voltage_now<=3900000", "write voltage_now<=3900000uV"),
            ("voltage_now<0x100", "write voltage_now<256mV"),
            ("voltage_now<3.9e6", "write voltage_now<3900000uV"),
            ("temp>45", "write temp>45C if it means 45C, or another number with degC"),
            ("temp>450", "write temp>45C"),
            ("temp>0", "write temp>0C"),
            ("current_now<-2", "write current_now<-2A"),
            ("current_avg!=-500", "write current_avg!=-500mA"),
            ("charge_now>2200", "write charge_now>2200mAh"),
            ("energy_now<7.4", "write energy_now<7.4Wh"),
            ("power_avg>5", "write power_avg>5W"),
            ("internal_resistance>0.2", "write internal_resistance>0.2ohm"),
            ("time_to_empty_now<600", "write time_to_empty_now<600s"),
            ("gauge/age_ms>60", "write gauge/age_ms>60s"),
            ("gauge/age_ms>60000", "write gauge/age_ms>60000ms"),
            ("gauge/poll_interval==30", "write gauge/poll_interval==30s"),
            ("gauge/registers/voltage<3.9", "write gauge/registers/voltage<3.9V"),
            ("gauge/registers/internal_temperature>300", "write gauge/registers/internal_temperature>300K"),
            ("gauge/registers/average_time_to_empty<10", "write gauge/registers/average_time_to_empty<10min"),
        ] {
            let refused = text.parse::<Condition>().expect_err(text);
            assert!(refused.contains("has no unit: ") && refused.contains(likely), "{text}: {refused}");
        }
        let compared = |text: &str| match &*text.parse::<Condition>().expect(text).terms {
            [Term::Compare { with: Operand::Number(number, _), .. }] => *number,
            other => panic!("{text}: {other:?}"),
        };
        // Every suggestion is a condition, for every file that has a unit.
        let attributes = attributes().map(|one| (one.name.to_string(), one.unit()));
        let files = files().map(|file| (format!("gauge/{}", file.name), file.unit));
        let with_unit = attributes.chain(files).filter(|(_, own)| unit::is_known(own) && *own != "%");
        let mut count = 0;
        for name in with_unit.map(|(name, _)| name).collect::<BTreeSet<_>>() {
            for number in ["-7", "450", "3900000"] {
                let text = format!("{name}<{number}");
                let Err(refused) = text.parse::<Condition>() else {
                    // Parts differ in its unit.
                    assert!(name.starts_with("gauge/registers/"), "{text}");
                    continue;
                };
                let (_, told) = refused.split_once(": write ").expect(&refused);
                let (likely, rest) = told.split_once(" if ").expect(&refused);
                let meant = compared(likely);
                if let Some((_, same)) = rest.split_once("that is ") {
                    assert_eq!(compared(same), meant, "{refused}");
                }
                count += 1;
            }
        }
        assert!(count > 100, "{count}");
        for text in ["capacity<20", "cycle_count>300", "gauge/statistics/polls>5", "state_of_health<80"] {
            text.parse::<Condition>().expect(text);
        }
    }

    #[test]
    fn texts_and_flags_are_compared_as_words() {
        let pack = texts(&[
            ("status", "Not charging"),
            ("serial_number", "0a10"),
            ("gauge/flags", "CHG OCVTAKEN"),
            ("gauge/seal", "sealed"),
        ]);
        let holds = |text: &str| text.parse::<Condition>().expect(text).holds(Some(&pack)).expect(text);
        for text in [
            "status==Not charging",
            "status==\"not Charging\"",
            "status!=Full",
            "serial_number==0a10",
            "gauge/flags has CHG",
            "gauge/seal==sealed",
        ] {
            assert!(holds(text), "{text}");
        }
        assert!(!holds("gauge/flags has FC") && !holds("status==Full") && !holds("gauge/seal!=sealed"));
    }

    #[test]
    fn a_missing_value_makes_nothing_true() {
        let holds = |text: &str, texts| text.parse::<Condition>().expect(text).holds(texts);
        let empty = Texts::new();
        for text in ["capacity<20", "capacity!=20", "status!=Full", "gauge/flags has FC"] {
            assert_eq!(holds(text, Some(&empty)), None, "{text}");
            assert_eq!(holds(text, None), None, "{text}");
        }
        // What is false already does not become open again.
        let low = texts(&[("capacity", "50")]);
        assert_eq!(holds("capacity<20 && status==Full", Some(&low)), Some(false));
        assert_eq!(holds("missing", None), Some(true));
        assert_eq!(holds("missing", Some(&empty)), Some(false));
    }

    #[test]
    fn what_could_never_come_true_is_refused_with_a_suggestion() {
        for (text, words) in [
            ("capcity<20", "did you mean capacity?"),
            ("voltage<3V", "no gauge has a file `voltage`; did you mean voltage_now?"),
            ("registers/voltage<3", "did you mean gauge/registers/voltage?"),
            ("terminate-voltage<3V", "voltage is a parameter of data flash: `gaugefs get` shows it"),
            ("volatge_now<3", "did you mean voltage_now?"),
            ("gauge/flag has FC", "did you mean gauge/flags?"),
            ("gauge/registers/voltag<3", "did you mean gauge/registers/voltage?"),
            ("gauge/flags has OCVTAKN", "did you mean OCVTAKEN?"),
            ("gauge/flags==FC", "write 'gauge/flags has FLAG'"),
            ("zzz<3", "no gauge has a file `zzz`"),
            ("status==full up", "it is one of: Charging"),
            ("status<3", "is a text; compare it with == or !="),
            ("capacity==Full", "`Full` is not a number of %"),
            ("capacity<20V", "not a number of %"),
            ("capacity has 3", "is a number"),
            ("voltage_now<3.1A", "`3.1A` is not a number of uV, mV or V"),
            ("voltage_now<3.1.1V", "is not a number"),
            ("voltage_now<3.1V/cell", "is not a number"),
            ("gauge/age_ms==old", "is not a number of s, min or h"),
            ("time_to_empty_now<3V", "not a number of s, min or h"),
            ("cycle_count>3x", "`3x` is not a number"),
            ("gauge/seal<sealed", "is not a number"),
            ("capacity", "no comparison"),
            ("", "no comparison"),
            ("capacity<", "nothing to compare with"),
            ("capacity<20 &&", "no comparison"),
            ("missing && capacity<20", "`missing` stands alone"),
            ("present==0", "write `missing`"),
            ("capa\ncity<20", "`capa\\ncity`"),
        ] {
            let refused = text.parse::<Condition>().expect_err(text);
            assert!(refused.contains(words), "{text}: {refused}");
        }
        // Larger than any number: it would always be true.
        for name in ["voltage_now", "time_to_empty_now"] {
            let unit = if name == "voltage_now" { "V" } else { "h" };
            let refused = format!("{name}<1{:0<320}{unit}", "").parse::<Condition>().expect_err(name);
            assert!(refused.contains("is not a number"), "{refused}");
        }
    }
}
