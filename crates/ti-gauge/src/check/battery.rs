// SPDX-License-Identifier: MIT

//! A battery as its owner knows it: chemistry, cells and capacity, and what else the data sheet has.

use std::fmt;
use std::str::FromStr;

use toml::de::{DeTable, DeValue};

use crate::text;
use crate::unit;

/// A value in mV for each cell: what is usual, and the least and the most that any cell of the chemistry has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Typical {
    /// What a battery has if nothing else is known of it.
    pub usual: u16,
    /// The limits.
    pub limits: (u16, u16),
}

impl Typical {
    const fn of(usual: u16, low: u16, high: u16) -> Self {
        Self { usual, limits: (low, high) }
    }

    /// Whether a cell can have that.
    pub fn covers(self, mv: f64) -> bool {
        (f64::from(self.limits.0)..=f64::from(self.limits.1)).contains(&mv)
    }
}

/// How a gauge must treat a chemistry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// Lithium-ion with an oxide cathode, which the gauges for one cell know.
    Lithium,
    /// Lithium iron phosphate.
    Phosphate,
    /// Nickel or lead.
    Other,
    /// It cannot be charged.
    Primary,
}

/// A chemistry, with what its cells have.
#[derive(Debug, PartialEq, Eq)]
pub struct Chemistry {
    /// Its name in the text of a battery.
    pub name: &'static str,
    /// Other names: the kernel's of a device tree, and what people write.
    others: &'static [&'static str],
    /// How a gauge treats it.
    pub family: Family,
    /// The voltage with which capacity becomes energy.
    pub nominal: Typical,
    /// The voltage at which charging ends; `None` where another sign ends it.
    pub charge: Option<Typical>,
    /// The voltage of an empty cell.
    pub terminate: Typical,
}

/// The chemistries. Lithium-ion has the defaults of TI's tables (SLUUAC9A Table 6-3, SLUSBZ5D Table 7-11), the others what
/// the data sheets of cells have.
#[rustfmt::skip]
pub static CHEMISTRIES: &[Chemistry] = &[
    Chemistry { name: "li-ion", family: Family::Lithium,
        others: &["lithium-ion", "lion", "li-po", "li-poly", "lithium-ion-polymer", "lithium-ion-manganese-oxide", "limn", "nmc", "nca", "lco"],
        nominal: Typical::of(3700, 3500, 3900), charge: Some(Typical::of(4200, 4000, 4500)), terminate: Typical::of(3000, 2500, 3700) },
    Chemistry { name: "lifepo4", family: Family::Phosphate,
        others: &["lfp", "life", "lithium-ion-iron-phosphate"],
        nominal: Typical::of(3200, 3100, 3350), charge: Some(Typical::of(3600, 3400, 3800)), terminate: Typical::of(2500, 2000, 3000) },
    Chemistry { name: "nimh", family: Family::Other,
        others: &["nickel-metal-hydride"],
        nominal: Typical::of(1200, 1150, 1300), charge: None, terminate: Typical::of(1000, 900, 1200) },
    Chemistry { name: "nicd", family: Family::Other,
        others: &["nickel-cadmium"],
        nominal: Typical::of(1200, 1150, 1300), charge: None, terminate: Typical::of(1000, 900, 1200) },
    Chemistry { name: "lead-acid", family: Family::Other,
        others: &["pb", "pba", "sla", "agm", "vrla"],
        nominal: Typical::of(2000, 1950, 2150), charge: Some(Typical::of(2400, 2200, 2600)), terminate: Typical::of(1750, 1600, 2000) },
    Chemistry { name: "li-socl2", family: Family::Primary,
        others: &["lithium-thionyl-chloride"],
        nominal: Typical::of(3600, 3500, 3700), charge: None, terminate: Typical::of(2000, 1800, 3200) },
    Chemistry { name: "li-mno2", family: Family::Primary,
        others: &["lithium-manganese-dioxide"],
        nominal: Typical::of(3000, 2900, 3100), charge: None, terminate: Typical::of(2000, 1800, 2600) },
];

impl Chemistry {
    /// The chemistry of a name; capitals and dashes do not matter.
    pub fn by_name(name: &str) -> Option<&'static Self> {
        let plain = |name: &str| name.to_ascii_lowercase().replace(['-', '_'], "");
        let is_it = |known: &&str| plain(known) == plain(name);
        CHEMISTRIES.iter().find(|row| is_it(&row.name) || row.others.iter().any(is_it))
    }
}

/// A battery.
#[derive(Clone, Debug, PartialEq)]
pub struct Battery {
    /// Its chemistry.
    pub chemistry: &'static Chemistry,
    /// A device tree does not say it, and lithium-ion is taken.
    pub is_assumed: bool,
    /// Cells in series.
    pub series: u8,
    /// Cells in parallel, which are as one.
    pub parallel: u16,
    /// Capacity of all in mAh.
    pub capacity_mah: f64,
    /// Energy of all in mWh, where the data sheet has it.
    pub energy_mwh: Option<f64>,
    /// Voltage in mV at which charging of a cell ends, where it is known.
    pub charge_mv: Option<f64>,
    /// Current in mA below which the charger stops, where it is known.
    pub taper_ma: Option<f64>,
    /// Voltage in mV at which a cell is empty, where it is known.
    pub terminate_mv: Option<f64>,
}

const CHEMISTRY: &str = "chemistry";
const CELLS: &str = "cells";
const CAPACITY: &str = "capacity";
const ENERGY: &str = "energy";
const CHARGE: &str = "charge-voltage";
const TAPER: &str = "taper-current";
const TERMINATE: &str = "terminate-voltage";

/// What can be said of a battery: its name, its unit, whether it must be said, and an example.
const KEYS: [(&str, &str, bool, &str); 7] = [
    (CHEMISTRY, "", true, "li-ion"),
    (CELLS, "", true, "3s or 3s2p"),
    (CAPACITY, "mAh", true, "5200mAh or 5.2Ah"),
    (ENERGY, "mWh", false, "57.7Wh"),
    (CHARGE, "mV", false, "4.2V, of a cell"),
    (TAPER, "mA", false, "260mA"),
    (TERMINATE, "mV", false, "3V, of a cell"),
];

/// What has been said so far.
#[derive(Default)]
struct Said(Vec<(&'static str, String)>);

impl Said {
    fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let Some((key, ..)) = KEYS.iter().find(|(key, ..)| *key == name) else {
            let known: Vec<_> = KEYS.iter().map(|(key, ..)| *key).collect();
            return Err(format!(
                "{}: no value of a battery; use {}",
                text::printable(name),
                known.join(", ")
            ));
        };
        if let Some((_, before)) = self.0.iter().find(|(known, _)| known == key) {
            let [before, value] = [before.as_str(), value].map(text::printable);
            return Err(format!("{key}: it is given twice, as {before} and as {value}"));
        }
        self.0.push((key, value.trim().into()));
        Ok(())
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(key, _)| *key == name).map(|(_, value)| value.as_str())
    }

    /// A number with a unit.
    fn number(&self, name: &str) -> Result<Option<f64>, String> {
        let Some(value) = self.get(name) else { return Ok(None) };
        let (_, unit, _, example) = KEYS.iter().find(|(key, ..)| *key == name).expect("a key of the table");
        if let Some(number) = unit::measured(value, unit).filter(|number| *number > 0.0) {
            return Ok(Some(number));
        }
        let why = match value.parse::<f64>() {
            Ok(_) => "has no unit",
            Err(_) => "is not a number with that unit",
        };
        Err(format!("{name}: {} {why}; write it as {example}", text::printable(value)))
    }

    fn battery(&self) -> Result<Battery, String> {
        let missing: Vec<String> = KEYS
            .iter()
            .filter(|(key, _, is_needed, _)| *is_needed && self.get(key).is_none())
            .map(|(key, _, _, example)| format!("the {key}, such as {example}"))
            .collect();
        if !missing.is_empty() {
            return Err(format!("it lacks {}", missing.join(", and ")));
        }
        let name = self.get(CHEMISTRY).unwrap_or_default();
        let chemistry = Chemistry::by_name(name).ok_or_else(|| unknown(name))?;
        let count = self.get(CELLS).unwrap_or_default();
        let (series, parallel) = cells(count).ok_or_else(|| {
            format!("cells: {} is not a number of cells, such as 3s or 3s2p", text::printable(count))
        })?;
        let each = self.get(CAPACITY).and_then(|text| unit::measured(text, "mAh/cell"));
        let capacity_mah = match each.filter(|each| *each > 0.0) {
            Some(each) => each * f64::from(parallel),
            None => self.number(CAPACITY)?.unwrap_or_default(),
        };
        let battery = Battery {
            chemistry,
            is_assumed: false,
            series,
            parallel,
            capacity_mah,
            energy_mwh: self.number(ENERGY)?,
            charge_mv: self.number(CHARGE)?,
            taper_ma: self.number(TAPER)?,
            terminate_mv: self.number(TERMINATE)?,
        };
        battery.checked()
    }
}

/// The key of a line of TOML.
fn name_of(line: &str) -> &str {
    line.split('=').next().unwrap_or_default().trim()
}

fn unknown(word: &str) -> String {
    let names: Vec<_> = CHEMISTRIES.iter().map(|chemistry| chemistry.name).collect();
    let word = text::printable(word);
    format!(
        "{word} is neither a chemistry ({}), nor cells (3s, 3s2p), nor a capacity (5200mAh)",
        names.join(", ")
    )
}

/// `3s` or `3s2p`.
fn cells(text: &str) -> Option<(u8, u16)> {
    let text = text.to_ascii_lowercase();
    let (series, rest) = text.split_once('s')?;
    let parallel = match rest {
        "" => 1,
        rest => rest.strip_suffix('p')?.parse().ok().filter(|count| (1..=1000).contains(count))?,
    };
    Some((series.parse().ok().filter(|count| (1..=100).contains(count))?, parallel))
}

impl Battery {
    /// Refuses what no battery of the chemistry has: a voltage of the whole pack, or a slip in a unit.
    pub(super) fn checked(self) -> Result<Self, String> {
        let Self { chemistry, series, .. } = self;
        let voltages = [
            (CHARGE, self.charge_mv, chemistry.charge),
            (TERMINATE, self.terminate_mv, Some(chemistry.terminate)),
        ];
        for (name, mv, typical) in voltages {
            let Some(mv) = mv else { continue };
            let Some(typical) = typical else {
                return Err(format!("{name}: the charge of {} does not end at a voltage", chemistry.name));
            };
            if typical.covers(mv) {
                continue;
            }
            let each = mv / f64::from(series);
            let (low, high) = typical.limits;
            return Err(match series > 1 && typical.covers(each) {
                true => format!("{name}: {mv} mV are of {series} cells; write those of one, {each:.0}mV"),
                false => format!("{name}: {mv} mV; a {} cell has {low} to {high} mV", chemistry.name),
            });
        }
        if !(1.0..=10_000_000.0).contains(&self.capacity_mah) {
            return Err(format!("{CAPACITY}: {} mAh is no battery's", self.capacity_mah));
        }
        if let Some(energy) = self.energy_mwh {
            let mv = energy * 1000.0 / self.capacity_mah / f64::from(series);
            if !chemistry.nominal.covers(mv) {
                let (low, high) = chemistry.nominal.limits;
                return Err(format!(
                    "{ENERGY}: {energy} mWh of {} mAh are {mv:.0} mV for each cell; a {} cell has {low} to {high} mV",
                    self.capacity_mah, chemistry.name
                ));
            }
        }
        Ok(self)
    }

    /// Energy of all in mWh, by the data sheet or by the usual voltage.
    pub fn energy(&self) -> f64 {
        let usual = f64::from(self.chemistry.nominal.usual) / 1000.0;
        self.energy_mwh.unwrap_or(self.capacity_mah * usual * f64::from(self.series))
    }

    /// From TOML: the keys of a battery's text, with values in quotes, at the top or in a table `battery`.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let line = |at: usize| 1 + text[..at.min(text.len())].matches('\n').count();
        let document = DeTable::parse(text).map_err(|error| {
            let number = line(error.span().map_or(0, |span| span.start));
            let names: Vec<&str> = text.lines().take(number).map(name_of).collect();
            match names.split_last() {
                Some((last, before)) if before.contains(last) => {
                    format!("line {number}: {}: it is given twice", text::printable(last))
                }
                _ => format!("line {number}: not TOML: {}", error.message()),
            }
        })?;
        let mut table = document.get_ref();
        if let (1, Some(DeValue::Table(inner))) =
            (table.len(), table.get("battery").map(|value| value.get_ref()))
        {
            table = inner;
        }
        let mut said = Said::default();
        for (key, value) in table {
            let number = line(key.span().start);
            let name = key.get_ref();
            let value = match value.get_ref() {
                DeValue::String(value) => said.set(name, value),
                // An unknown name is told as that.
                _ => said
                    .set(name, "")
                    .and_then(|()| Err(format!("{name}: write it in quotes, with its unit"))),
            };
            value.map_err(|why| format!("line {number}: {why}"))?;
        }
        said.battery()
    }
}

impl FromStr for Battery {
    type Err = String;

    /// `li-ion 3s 5200mAh`, in any order; more as `charge-voltage=4.35V`.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut said = Said::default();
        let mut words = text.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let begins = |letter: char| letter.is_ascii_digit() || letter == '.';
            let (number, symbol) = unit::split(word);
            if let Some((name, value)) = word.split_once('=') {
                said.set(name, value)?;
            } else if Chemistry::by_name(word).is_some() {
                said.set(CHEMISTRY, word)?;
            } else if !word.starts_with(begins) {
                return Err(unknown(word));
            } else if symbol.starts_with(['s', 'S']) {
                said.set(CELLS, word)?;
            } else {
                let next = if symbol.is_empty() {
                    words.next_if(|next| ['m', 'A', 'W'].iter().any(|first| next.starts_with(*first)))
                } else {
                    None
                };
                let whole = format!("{number}{}", next.unwrap_or(symbol));
                match whole.parse::<f64>() {
                    Ok(_) => {
                        return Err(format!(
                            "{whole} has no unit; write a capacity as {whole}mAh or {whole}Ah, and cells as {whole}s"
                        ));
                    }
                    Err(_) if whole.ends_with("Wh") => said.set(ENERGY, &whole)?,
                    Err(_) => said.set(CAPACITY, &whole)?,
                }
            }
        }
        said.battery()
    }
}

impl fmt::Display for Battery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}s", self.chemistry.name, self.series)?;
        if self.parallel > 1 {
            write!(f, "{}p", self.parallel)?;
        }
        write!(f, " {}mAh", self.capacity_mah)?;
        let more = [
            (ENERGY, self.energy_mwh, "mWh"),
            (CHARGE, self.charge_mv, "mV"),
            (TAPER, self.taper_ma, "mA"),
            (TERMINATE, self.terminate_mv, "mV"),
        ];
        for (name, value, unit) in more {
            if let Some(value) = value {
                write!(f, " {name}={value}{unit}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_battery_is_said_in_words_in_any_order() {
        for (text, shown) in [
            ("li-ion 3s 5200mAh", "li-ion 3s 5200mAh"),
            ("5.2Ah 3S LiPo", "li-ion 3s 5200mAh"),
            ("Li-Ion 3s2p 5200 mAh", "li-ion 3s2p 5200mAh"),
            ("lfp 4s2p 50Ah/cell", "lifepo4 4s2p 100000mAh"),
            ("lithium-ion-iron-phosphate 1s 1500mAh", "lifepo4 1s 1500mAh"),
            ("pb 6s 7Ah 84Wh", "lead-acid 6s 7000mAh energy=84000mWh"),
            (
                "li-ion 1s 2Ah charge-voltage=4.35V taper-current=100mA terminate-voltage=3.1V energy=7.6Wh",
                "li-ion 1s 2000mAh energy=7600mWh charge-voltage=4350mV taper-current=100mA terminate-voltage=3100mV",
            ),
        ] {
            let battery: Battery = text.parse().expect(text);
            assert_eq!(battery.to_string(), shown, "{text}");
            assert_eq!(shown.parse(), Ok(battery), "{shown}");
        }
        assert_eq!("li-ion 3s 5200mAh".parse::<Battery>().expect("one").energy(), 57_720.0);
    }

    #[test]
    fn what_is_wrong_with_a_text_is_named() {
        for (text, says) in [
            (
                "",
                "it lacks the chemistry, such as li-ion, and the cells, such as 3s or 3s2p, and the capacity, such as 5200mAh or 5.2Ah",
            ),
            ("li-ion 3s", "it lacks the capacity, such as 5200mAh or 5.2Ah"),
            ("li-ion 5200mAh", "it lacks the cells, such as 3s or 3s2p"),
            ("3s 5200mAh", "it lacks the chemistry, such as li-ion"),
            ("li-ion 3s 5200", "5200 has no unit; write a capacity as 5200mAh or 5200Ah, and cells as 5200s"),
            ("li-ion 3 5200mAh", "3 has no unit; write a capacity as 3mAh or 3Ah, and cells as 3s"),
            ("li-ion 3s 5200mAh 5.2Ah", "capacity: it is given twice, as 5200mAh and as 5.2Ah"),
            ("li-ion 3s 2s 5200mAh", "cells: it is given twice, as 3s and as 2s"),
            ("li-ion lfp 3s 5200mAh", "chemistry: it is given twice, as li-ion and as lfp"),
            (
                "li-ion 3s 5200mA",
                "capacity: 5200mA is not a number with that unit; write it as 5200mAh or 5.2Ah",
            ),
            ("li-ion 3s capacity=5200", "capacity: 5200 has no unit; write it as 5200mAh or 5.2Ah"),
            ("li-ion 3s 0mAh", "capacity: 0mAh is not a number with that unit; write it as 5200mAh or 5.2Ah"),
            ("li-ion 0s 5200mAh", "cells: 0s is not a number of cells, such as 3s or 3s2p"),
            ("li-ion 3s2 5200mAh", "cells: 3s2 is not a number of cells, such as 3s or 3s2p"),
            (
                "unobtainium 3s 5200mAh",
                "unobtainium is neither a chemistry (li-ion, lifepo4, nimh, nicd, lead-acid, li-socl2, li-mno2), nor cells (3s, 3s2p), nor a capacity (5200mAh)",
            ),
            (
                "li-ion 3s 5200mAh qmax=1",
                "qmax: no value of a battery; use chemistry, cells, capacity, energy, charge-voltage, taper-current, terminate-voltage",
            ),
            (
                "li-ion 3s 5200mAh charge-voltage=12.6V",
                "charge-voltage: 12600 mV are of 3 cells; write those of one, 4200mV",
            ),
            (
                "lfp 1s 5200mAh charge-voltage=4.2V",
                "charge-voltage: 4200 mV; a lifepo4 cell has 3400 to 3800 mV",
            ),
            (
                "nimh 1s 2Ah charge-voltage=1.5V",
                "charge-voltage: the charge of nimh does not end at a voltage",
            ),
            (
                "li-ion 3s 5200mAh energy=57Ah",
                "energy: 57Ah is not a number with that unit; write it as 57.7Wh",
            ),
            (
                "li-ion 3s 5200mAh energy=20Wh",
                "energy: 20000 mWh of 5200 mAh are 1282 mV for each cell; a li-ion cell has 3500 to 3900 mV",
            ),
        ] {
            assert_eq!(text.parse::<Battery>(), Err(says.into()), "{text}");
        }
    }

    #[test]
    fn a_file_has_the_same_names() {
        let text =
            "chemistry = \"li-ion\"\ncells = \"3s\"\ncapacity = \"5200mAh\"\ntaper-current = \"0.26A\"\n";
        let battery = Battery::from_toml(text).expect("a battery");
        assert_eq!(battery.to_string(), "li-ion 3s 5200mAh taper-current=260mA");
        assert_eq!(Battery::from_toml(&format!("[battery]\n{text}")), Ok(battery));
        for (text, says) in [
            (
                "chemistry = \"li-ion\"\ncapacity = 5200\n",
                "line 2: capacity: write it in quotes, with its unit",
            ),
            ("cells = \"3s\"\ncells = \"3s\"\n", "line 2: cells: it is given twice"),
            (
                "cells = \"3s\"\n",
                "it lacks the chemistry, such as li-ion, and the capacity, such as 5200mAh or 5.2Ah",
            ),
            (
                "series = 4\n",
                "line 1: series: no value of a battery; use chemistry, cells, capacity, energy, charge-voltage, taper-current, terminate-voltage",
            ),
            (
                "volts = \"3V\"\n",
                "line 1: volts: no value of a battery; use chemistry, cells, capacity, energy, charge-voltage, taper-current, terminate-voltage",
            ),
        ] {
            assert_eq!(Battery::from_toml(text), Err(says.into()), "{text}");
        }
        assert!(Battery::from_toml("cells =").expect_err("no value").starts_with("line 1: not TOML: "));
    }
}
