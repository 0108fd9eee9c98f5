//! TI's names as file names.

/// TI's name as a file name of `gauge/`: words of lower-case letters and digits joined by `_`, an
/// upper-case letter after a lower-case one or a digit starting a new word (`StateOfCharge` is
/// `state_of_charge`, `DOD@EOC` is `dod_at_eoc`).
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

/// A name from the manual as a file name of `df/by-name`: lower case, `%` as `pct`, every other run of
/// characters as `-`.
pub fn kebab_case(name: &str) -> String {
    let lower = name.to_lowercase().replace('%', " pct ");
    let words = lower.split(|letter: char| !letter.is_ascii_alphanumeric());
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_follow_from_the_manuals_names() {
        assert_eq!(snake_case("StateOfCharge"), "state_of_charge");
        assert_eq!(snake_case("DOD@EOC"), "dod_at_eoc");
        assert_eq!(snake_case("DOD0Time"), "dod0_time");
        assert_eq!(snake_case("FlagsB"), "flags_b");
        assert_eq!(snake_case("CONTROL_STATUS"), "control_status");
        assert_eq!(kebab_case("Cell Terminate Voltage"), "cell-terminate-voltage");
        assert_eq!(kebab_case("TCA Set %"), "tca-set-pct");
        assert_eq!(kebab_case("IT Cfg"), "it-cfg");
        assert_eq!(kebab_case("Cell Charge Voltage T1-T2"), "cell-charge-voltage-t1-t2");
    }
}
