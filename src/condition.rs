//! Conditions on the files of a gauge's folder, such as `capacity<20 && status==Discharging`.
//!
//! A condition is parsed strictly, and names are those that the tree can have: one that is misspelt would never come
//! true. Whether it is true follows from the texts of one poll. A missing value makes no condition true.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::Deserialize;
use strsim::levenshtein;
use ti_gauge::text;

use crate::fs::{Attribute, file_names};

/// What decides whether a gauge is missing, instead of its values.
const MISSING: &str = "missing";
/// The kernel's words for the attributes that have a few. A misspelt one would never come true.
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
/// Units of attributes: the beginning of their names, the unit in which a number may be written, and the exponent of 10
/// of that unit in the file's.
const UNITS: [(&str, &str, i32); 12] = [
    ("voltage_", "V", 6),
    ("constant_charge_voltage", "V", 6),
    ("current_", "A", 6),
    ("constant_charge_current", "A", 6),
    ("charge_", "Ah", 6),
    ("energy_", "Wh", 6),
    ("power_", "W", 6),
    ("internal_resistance", "Ohm", 6),
    ("temp", "C", 1),
    ("capacity", "%", 0),
    ("state_of_health", "%", 0),
    ("gauge/age_ms", "s", 3),
];
const PREFIXES: [(&str, i32); 6] = [("", 0), ("m", -3), ("u", -6), ("µ", -6), ("μ", -6), ("k", 3)];
/// Units of the attributes that are in seconds.
const TIMES: [(&str, f64); 4] = [("s", 1.0), ("min", 60.0), ("h", 3600.0), ("d", 86400.0)];

/// The files of a gauge's folder, by their names in it.
pub(crate) type Texts = BTreeMap<String, String>;

/// One condition: terms of which all must be true.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct Condition {
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
    /// The file lists the word.
    Has,
}

#[derive(Clone, Debug, PartialEq)]
enum Operand {
    /// In the unit of the file; and as it was written, for a file that does not hold a number.
    Number(f64, String),
    Text(String),
}

/// Operators as they are written, a longer one before its beginning.
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
    /// The files that it compares, without those that are compared twice.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.terms.iter().filter_map(|term| match term {
            Term::Compare { name, .. } => Some(name.as_str()),
            Term::Missing => None,
        })
    }

    /// Whether it is true of a gauge with these files, of which `None` is missing. `None` where a missing value leaves
    /// that open.
    pub(crate) fn holds(&self, texts: Option<&Texts>) -> Option<bool> {
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

    /// The values that it compares, for a message.
    pub(crate) fn values(&self, texts: Option<&Texts>) -> String {
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

impl TryFrom<String> for Condition {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
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
            Some(file) => of_gauge(name, file, by, value)?,
            None => of_attribute(name, by, value)?,
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

/// A decimal or hexadecimal number.
fn number(text: &str) -> Option<f64> {
    let word = text::unsigned::<u64>(text).map(|word| word as f64);
    word.or_else(|| text.parse().ok().filter(|number: &f64| number.is_finite()))
}

fn of_attribute(name: &str, by: Operator, value: &str) -> Result<Operand, String> {
    let attribute = Attribute::by_name(name).ok_or_else(|| unknown(name))?;
    if name == "present" {
        return Err("write `missing`: a gauge that is not present has no values to compare".into());
    }
    if attribute.is_number() {
        if by == Operator::Has {
            return Err(format!("{name} is a number; compare it with < <= > >= == or !="));
        }
        return measured(name, value).map(|number| Operand::Number(number, value.into()));
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

fn of_gauge(name: &str, file: &str, by: Operator, value: &str) -> Result<Operand, String> {
    let files: Vec<_> = file_names().filter(|(known, _)| known == file).collect();
    if files.is_empty() {
        return Err(unknown(name));
    }
    let bits = || files.iter().flat_map(|(_, bits)| bits.iter().map(|bit| bit.name));
    if by == Operator::Has {
        if bits().next().is_none() {
            return Err(format!("{name} is not a word of flags; compare it with < <= > >= == or !="));
        }
        if !bits().any(|bit| bit == value) {
            let hint = nearest(value, bits()).map_or(String::new(), |bit| format!("; did you mean {bit}?"));
            return Err(format!("no gauge has a flag `{}` in {name}{hint}", value.escape_debug()));
        }
        return Ok(Operand::Text(value.into()));
    }
    if bits().next().is_some() {
        return Err(format!("{name} lists flags; write '{name} has FLAG'"));
    }
    match measured(name, value) {
        Ok(number) => Ok(Operand::Number(number, value.into())),
        Err(_) if matches!(by, Operator::Equal | Operator::Unequal) => Ok(Operand::Text(value.into())),
        Err(why) => Err(why),
    }
}

/// A number in the unit of a file: without a unit as the file has it, or with a unit that fits.
fn measured(name: &str, value: &str) -> Result<f64, String> {
    if let Some(number) = number(value) {
        return Ok(number);
    }
    let refuse = |what: &str| Err(format!("{name}: `{}` is not a number{what}", value.escape_debug()));
    let end = value.find(|letter: char| !letter.is_ascii_digit() && !"+-.".contains(letter));
    let (digits, unit) = value.split_at(end.unwrap_or(value.len()));
    let (digits, unit) = (digits.trim(), unit.trim().trim_start_matches('°'));
    if name.starts_with("time_to_") {
        let found = TIMES.iter().find(|(known, _)| *known == unit);
        return match (digits.parse::<f64>(), found) {
            (Ok(number), Some((_, seconds))) if (number * seconds).is_finite() => Ok(number * seconds),
            _ => refuse(" of s, min or h"),
        };
    }
    let Some((_, base, exponent)) = UNITS.iter().find(|(of, ..)| name.starts_with(of)) else {
        return refuse("");
    };
    let prefix =
        unit.strip_suffix(base).and_then(|prefix| PREFIXES.iter().find(|(known, _)| *known == prefix));
    // A percentage has no prefixes, and no thousandths.
    let prefix = prefix.filter(|(prefix, _)| prefix.is_empty() || !matches!(*base, "%" | "C"));
    // Written as an exponent, the decimal is exact.
    let number = prefix.and_then(|(_, scale)| {
        digits.parse::<f64>().ok()?;
        format!("{digits}e{}", exponent + scale).parse().ok().filter(|number: &f64| number.is_finite())
    });
    match number {
        Some(number) => Ok(number),
        None if matches!(*base, "%" | "C") => refuse(&format!(" of {base}")),
        None => refuse(&format!(" of {base} or m{base}")),
    }
}

fn unknown(name: &str) -> String {
    let attributes = Attribute::all().map(|attribute| attribute.name().to_string());
    let names: Vec<_> = attributes.chain(file_names().map(|(file, _)| format!("gauge/{file}"))).collect();
    let shown = name.escape_debug();
    match nearest(name, names.iter().map(String::as_str)) {
        Some(meant) => format!("no gauge has a file `{shown}`; did you mean {meant}?"),
        None => {
            format!("no gauge has a file `{shown}`; name one of its folder, such as capacity or gauge/flags")
        }
    }
}

/// The name that was probably meant.
fn nearest<'a>(word: &str, names: impl Iterator<Item = &'a str>) -> Option<String> {
    let tolerated = 1 + word.len() / 4;
    // At least as many letters are wrong as are too many, and there may be very many.
    let names = names.filter(|name| word.chars().count().abs_diff(name.len()) <= tolerated);
    let (wrong, name) = names.map(|name| (levenshtein(word, name), name)).min()?;
    (wrong <= tolerated).then(|| name.to_string())
}

#[cfg(test)]
mod tests {
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
            "voltage_now<=3100000",
            "current_now==-0.5A",
            "current_now < -499mA",
            "current_now==-500000uA",
            "charge_now>1799mAh",
            "temp<-5.4°C",
            "temp==-5.5 C",
            "temp==-55",
            "time_to_empty_now<=10min",
            "gauge/age_ms>1.4s",
            "gauge/registers/voltage==3100",
            "gauge/chem_id==0x0107",
            "gauge/chem_id==263",
            "gauge/poll_interval<1",
            "capacity<20 && voltage_now>3V && temp!=0",
        ] {
            assert!(holds(text), "{text}");
        }
        for text in ["capacity<19", "voltage_now>3.1V", "capacity<20 && voltage_now<3V", "temp>0", "missing"]
        {
            assert!(!holds(text), "{text}");
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
            ("voltage_now<3.1A", "`3.1A` is not a number of V or mV"),
            ("voltage_now<3.1.1V", "is not a number"),
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
