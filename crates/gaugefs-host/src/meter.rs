//! What a meter shows, as a person types it: checked alike on the command line and in a file.

use ti_gauge::unit;

/// The voltage of a pack that a meter shows, in mV.
pub fn pack_voltage(text: &str) -> Result<f64, String> {
    shown(text, "mV", |millivolts| (1000.0..=1_000_000.0).contains(&millivolts))
}

/// The current that a meter shows, in mA.
pub fn meter_current(text: &str) -> Result<f64, String> {
    shown(text, "mA", |milliamperes| (100.0..=1_000_000.0).contains(&milliamperes.abs()))
}

/// A temperature, in degrees Celsius.
pub fn celsius(text: &str) -> Result<f64, String> {
    let degrees = text.parse().ok().or_else(|| unit::measured(text, "°C"));
    let degrees = degrees.filter(|degrees| (-40.0..=125.0).contains(degrees));
    degrees.ok_or_else(|| "expected -40 to 125 degrees Celsius, such as 23.5 or 23.5C".into())
}

/// A Voltage Divider, in whole mV.
pub fn divider(text: &str) -> Result<u16, String> {
    let millivolts = shown(text, "mV", |millivolts| (1000.0..=65535.0).contains(&millivolts))?;
    if millivolts.fract() != 0.0 {
        return Err("it is stored in steps of 1 mV, and this is none; it is not rounded".into());
    }
    let whole = Some(millivolts).filter(|millivolts| (0.0..=65535.0).contains(millivolts));
    whole.map(|millivolts| millivolts as u16).ok_or_else(|| "expected at most 65535 mV".into())
}

/// A number with a unit in `own`, or a bare one in it, which must be plausible: it may have been read from a meter that shows
/// another unit, or from a file of the mount.
fn shown(text: &str, own: &str, is_plausible: impl Fn(f64) -> bool) -> Result<f64, String> {
    if let Some(number) = unit::measured(text, own) {
        return Ok(number);
    }
    let accepted = unit::accepted_for(own);
    let expected = || format!("expected a number with {accepted}");
    let bare = text.trim().parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(expected)?;
    if is_plausible(bare) {
        return Ok(bare);
    }
    let likely = unit::likely(bare, own).unwrap_or_default();
    Err(format!("without a unit it is in {own}: write {likely} if it means {likely}, or {bare}{own}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_meter_shows_has_a_unit_or_is_plausible_without_one() {
        for (text, millivolts) in [
            ("15420", 15420.0),
            ("15.42V", 15420.0),
            ("15420.5 mV", 15420.5),
            ("15420000uV", 15420.0),
            ("500mV", 500.0),
            ("-3V", -3000.0),
        ] {
            assert_eq!(pack_voltage(text), Ok(millivolts), "{text}");
        }
        for (text, likely) in [
            ("15.42", "write 15.42V if it means 15.42V, or 15.42mV"),
            ("15420000", "write 15420000uV"),
            ("0", "write 0V"),
            ("-15420", "write -15420mV"),
            ("15.42A", "expected a number with mV or V"),
            ("NaN", "expected a number"),
            ("inf", "expected a number"),
            ("", "expected a number"),
        ] {
            let refused = pack_voltage(text).expect_err(text);
            assert!(refused.contains(likely), "{text}: {refused}");
        }
        assert_eq!((meter_current("-2000"), meter_current("-2A")), (Ok(-2000.0), Ok(-2000.0)));
        assert!(meter_current("-2").is_err_and(|why| why.contains("write -2A")));
        assert_eq!((celsius("-5"), celsius("23.5C"), celsius("25degC")), (Ok(-5.0), Ok(23.5), Ok(25.0)));
        assert!(["235", "298.15", "300K", "NaN"].iter().all(|text| celsius(text).is_err()));
        assert_eq!((divider("33000"), divider("33V"), divider("5000mV")), (Ok(33000), Ok(33000), Ok(5000)));
        for text in ["33", "33.0005V", "70V", "-5V", "33000000", "33000.5"] {
            assert!(divider(text).is_err(), "{text}");
        }
    }
}
