// SPDX-License-Identifier: MIT

//! Values of a gauge's files, with their units.

use std::fmt;

use ti_gauge::{quantity, text, unit};

/// A file's text, and its unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value {
    /// The text, without its line end.
    pub text: String,
    /// The unit of the number, such as `uV`, `mA` or `0.1°C`; empty without one.
    pub unit: &'static str,
}

impl Value {
    /// The number in the file's unit; `None` for a text.
    pub fn number(&self) -> Option<f64> {
        let word = text::unsigned::<u64>(&self.text).map(|word| word as f64);
        word.or_else(|| self.text.parse().ok().filter(|number: &f64| number.is_finite()))
    }

    /// The number in another unit of the same quantity, such as `V`; `None` for a text or another quantity.
    pub fn in_unit(&self, other: &str) -> Option<f64> {
        let one = unit::measured(&format!("1{other}"), self.unit)?;
        Some(self.number()? / one)
    }
}

/// The text, a space and the unit.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&quantity::with_unit(&self.text, self.unit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_converted_to_units_of_its_quantity() {
        let value = |text: &str, unit| Value { text: text.into(), unit };
        assert_eq!(value("3855000", "uV").in_unit("V"), Some(3.855));
        assert_eq!(value("-250", "mA").in_unit("A"), Some(-0.25));
        assert_eq!(value("251", "0.1°C").in_unit("C"), Some(25.1));
        assert_eq!(value("4320", "s").in_unit("min"), Some(72.0));
        assert_eq!(value("3855000", "uV").in_unit("A"), None);
        assert_eq!(value("Full", "").in_unit("V"), None);
        assert_eq!(value("0x0107", "").number(), Some(263.0));
        assert_eq!(value("3855000", "uV").to_string(), "3855000 uV");
        assert_eq!(value("251", "0.1°C").to_string(), "25.1 °C (251)");
    }
}
