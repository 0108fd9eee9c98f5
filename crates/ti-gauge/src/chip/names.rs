// SPDX-License-Identifier: MIT

//! TI's names as file names, and parameters by these names.

use super::{Chip, FLAT, Row};
use crate::text;

/// Similarity above which a name is suggested, from 0 to 1.
const ALIKE: f64 = 0.85;

/// Why a name is not a parameter's.
#[derive(Clone, Debug)]
pub enum Unnamed {
    /// No parameter has it; [`Chip::nearest`] may suggest one.
    Unknown,
    /// Several classes have one of this name: their full names.
    Several(Vec<String>),
}

impl Chip {
    /// All parameters, in the table's order.
    pub fn rows(&self) -> impl Iterator<Item = Row> + use<> {
        self.subclasses.iter().flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)))
    }

    /// The full name of a parameter, as in `df/by-name`: `it-cfg/cell-terminate-voltage`.
    pub fn name_of(&self, (subclass, parameter): Row) -> String {
        format!("{}/{}", self.class_dir(subclass), kebab_case(parameter.name))
    }

    /// The parameter in a text: by place, `80/53`, by full name, or by its own name if that is unique.
    pub fn find(&self, name: &str) -> Result<Row, Unnamed> {
        if let Some((class, own)) = name.strip_prefix("by-name/").unwrap_or(name).split_once('/') {
            let by_place = self.row(class, own);
            let by_name =
                || self.named(own).find(|(subclass, _)| self.class_dir(subclass) == kebab_case(class));
            if let Some(row) = by_place.or_else(by_name) {
                return Ok(row);
            }
        }
        // TI has names with a slash.
        let found: Vec<Row> = self.named(name).collect();
        match found[..] {
            [] => Err(Unnamed::Unknown),
            [row] => Ok(row),
            _ => Err(Unnamed::Several(found.into_iter().map(|row| self.name_of(row)).collect())),
        }
    }

    fn named(&self, name: &str) -> impl Iterator<Item = Row> + use<> {
        let name = kebab_case(name);
        self.rows().filter(move |(_, row)| is_named(row.name, &name))
    }

    /// The parameters whose names contain all parts of this one; those with the fewest other parts first.
    pub fn with_parts(&self, name: &str) -> Vec<Row> {
        let rows: Vec<(String, Row)> = self.rows().map(|row| (self.name_of(row), row)).collect();
        let is_whole = name.contains('/');
        let own = |name: &str| if is_whole { 0 } else { name.find('/').map_or(0, |slash| slash + 1) };
        let names = rows.iter().map(|(name, row)| (&name[own(name)..], *row));
        text::with_parts(name, names)
    }

    /// The parameter with the most words, at least two, that are all in a name: another part may have a longer name.
    fn within(&self, name: &str) -> Option<Row> {
        const LONGEST: usize = 64;
        let words = |name: &str| kebab_case(name).split('-').map(String::from).collect::<Vec<_>>();
        let given = if name.len() > LONGEST { Vec::new() } else { words(name) };
        let rows = self.rows().map(|row| (words(row.1.name), row));
        let found = rows.filter(|(own, _)| own.len() > 1 && own.iter().all(|word| given.contains(word)));
        found.max_by_key(|(own, _)| own.len()).map(|(_, row)| row)
    }

    /// The parameter probably meant: nearest in the same subclass, with all parts of the name, or with a similar name.
    pub fn nearest(&self, name: &str) -> Option<Row> {
        let (class, own) = name.rsplit_once('/').unwrap_or(("", name));
        if let Some(at) = text::unsigned::<u16>(own) {
            let id = if class == "flash" { FLAT } else { text::unsigned(class)? };
            let near = self.rows().filter(|(subclass, _)| subclass.id == id);
            return near.min_by_key(|(_, row)| row.offset.abs_diff(at));
        }
        if let Some(row) = self.with_parts(name).into_iter().next().or_else(|| self.within(own)) {
            return Some(row);
        }
        let (own, whole) = (kebab_case(own), format!("{}/{}", kebab_case(class), kebab_case(own)));
        // A text four times as long is never similar, and may be very long.
        let names = self.rows().map(|row| (kebab_case(row.1.name), row));
        let names = names.filter(|(name, _)| own.len() <= 4 * name.len());
        let alone = names.map(|(name, row)| (strsim::jaro_winkler(&name, &own), row));
        let rows = alone.filter(|(alone, _)| *alone >= ALIKE).map(|(alone, row)| {
            // The class decides between parameters of the same name.
            let with_class = if class.is_empty() { 0.0 } else { strsim::jaro(&self.name_of(row), &whole) };
            ((alone, with_class), row)
        });
        let best = rows.reduce(|best, row| if row.0 > best.0 { row } else { best });
        best.map(|(_, row)| row)
    }
}

/// TI's name as a file name of `gauge/`: `StateOfCharge` is `state_of_charge`, `DOD@EOC` is `dod_at_eoc`.
pub fn snake_case(name: &str) -> String {
    let mut words = String::new();
    let mut before = ' ';
    for letter in name.replace('@', "_at_").chars() {
        if !letter.is_ascii_alphanumeric() {
            words.push('_');
        } else {
            if letter.is_ascii_uppercase() && (before.is_ascii_lowercase() || before.is_ascii_digit()) {
                words.push('_');
            }
            words.push(letter.to_ascii_lowercase());
        }
        before = letter;
    }
    words.split('_').filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_")
}

/// The manual's name as a file name of `df/by-name`: lower case, `%` as `pct`, every other run of characters as `-`.
pub fn kebab_case(name: &str) -> String {
    let mut words = String::with_capacity(name.len());
    let mut in_word = false;
    for letter in name.chars() {
        let goes_on = letter.is_ascii_alphanumeric();
        let (begins, is_percent) = (goes_on && !in_word, letter == '%');
        if (begins || is_percent) && !words.is_empty() {
            words.push('-');
        }
        if is_percent {
            words.push_str("pct");
        } else if goes_on {
            words.push(letter.to_ascii_lowercase());
        }
        in_word = goes_on;
    }
    words
}

/// Whether [`kebab_case`] of TI's name is this one. Of many names, few are compared as a whole.
pub(super) fn is_named(name: &str, kebab: &str) -> bool {
    let first = name.chars().find(|letter| letter.is_ascii_alphanumeric() || *letter == '%');
    let first = first.map(|letter| if letter == '%' { 'p' } else { letter.to_ascii_lowercase() });
    first == kebab.chars().next() && kebab_case(name) == kebab
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::CHIPS;

    fn chip() -> &'static Chip {
        Chip::by_name("bq34z100-g1").expect("it has a table")
    }

    #[test]
    fn every_parameter_is_found_by_its_place_and_its_name() {
        for chip in CHIPS {
            for row in chip.rows() {
                let name = chip.name_of(row);
                let whole = chip.find(&name).unwrap_or_else(|_| panic!("{}: {name}", chip.name));
                assert!(
                    std::ptr::eq(whole.0, row.0) && std::ptr::eq(whole.1, row.1),
                    "{}: {name}",
                    chip.name
                );
                match chip.find(row.1.name) {
                    Ok(alone) => assert!(std::ptr::eq(alone.1, row.1), "{}: {name}", chip.name),
                    Err(Unnamed::Several(names)) => {
                        assert!(names.contains(&name), "{}: {names:?}", chip.name)
                    }
                    Err(Unnamed::Unknown) => panic!("{}: {name}", chip.name),
                }
            }
        }
    }

    #[test]
    fn a_name_is_found_however_it_is_written() {
        for name in [
            "80/53",
            "it-cfg/cell-terminate-voltage",
            "by-name/it-cfg/cell-terminate-voltage",
            "cell-terminate-voltage",
            "Cell Terminate Voltage",
            "IT Cfg/Cell Terminate Voltage",
        ] {
            let (subclass, row) = chip().find(name).unwrap_or_else(|why| panic!("{name}: {why:?}"));
            assert_eq!((subclass.id, row.offset), (80, 53), "{name}");
        }
    }

    #[test]
    fn a_name_that_does_not_exist_is_answered_with_the_one_that_was_meant() {
        for (name, meant) in [
            ("it-cfg/cell-terminate-voltag", Some("it-cfg/cell-terminate-voltage")),
            ("it-cfg/cell-treminate-voltage", Some("it-cfg/cell-terminate-voltage")),
            ("power/cell-terminate-voltage", Some("it-cfg/cell-terminate-voltage")),
            ("terminate-voltage", Some("it-cfg/cell-terminate-voltage")),
            ("it-cfg/terminate-volt", Some("it-cfg/cell-terminate-voltage")),
            ("cell-terminate-volts", Some("it-cfg/cell-terminate-voltage")),
            ("serial-numbr", Some("configuration-data/serial-number")),
            ("80/54", Some("it-cfg/cell-terminate-voltage")),
            ("nonsense", None),
            ("xyz/nonsense", None),
            ("80/xyz", None),
            ("99/0", None),
            ("", None),
            ("/", None),
        ] {
            assert!(matches!(chip().find(name), Err(Unnamed::Unknown)), "{name} is found");
            let found = chip().nearest(name);
            assert_eq!(found.map(|row| chip().name_of(row)).as_deref(), meant, "{name}");
        }
    }

    #[test]
    fn file_names_follow_from_the_manuals_names() {
        assert_eq!(snake_case("StateOfCharge"), "state_of_charge");
        assert_eq!(snake_case("DOD@EOC"), "dod_at_eoc");
        assert_eq!(snake_case("DOD0Time"), "dod0_time");
        assert_eq!(snake_case("FlagsB"), "flags_b");
        assert_eq!(snake_case("CONTROL_STATUS"), "control_status");
        assert_eq!(kebab_case("Cell Terminate Voltage"), "cell-terminate-voltage");
        assert_eq!(kebab_case("TCA Set %"), "tca-set-pct");
        assert_eq!(kebab_case("%50%x -- 9µ_A "), "pct-50-pct-x-9-a");
        assert_eq!(kebab_case(" - "), "");
        assert_eq!(kebab_case("IT Cfg"), "it-cfg");
        assert_eq!(kebab_case("Cell Charge Voltage T1-T2"), "cell-charge-voltage-t1-t2");
    }

    #[test]
    fn a_longer_name_of_another_part_means_the_one_that_it_has_the_words_of() {
        let chip = Chip::by_name("bq27441-g1").expect("it has a table");
        let near = |name: &str| chip.nearest(name).map(|row| chip.name_of(row));
        assert_eq!(near("cell-terminate-voltage").as_deref(), Some("state/terminate-voltage"));
        assert_eq!(near("it-cfg/cell-terminate-voltage").as_deref(), Some("state/terminate-voltage"));
        assert_eq!(near(&"voltage-".repeat(5000)), None);
    }
}
