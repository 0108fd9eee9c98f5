// SPDX-License-Identifier: MIT

//! Values of options, checked alike on the command line and in a configuration file.

use std::str::FromStr;
use std::time::Duration;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use clap::error::{ContextKind, ContextValue};
use gauge_bus::{AdapterModel, GAUGE_ADDRESS};
use gauge_owner::SimKey;
use gauge_sim::Level;
use gaugefs_client::condition::Condition;
use gaugefs_host::seconds;
use ti_gauge::authentication::Order;
use ti_gauge::chip::{Chip, kernel};
use ti_gauge::keys::{self, Name, Secret};
use ti_gauge::{text, unit};

pub(crate) fn chip_names() -> PossibleValuesParser {
    PossibleValuesParser::new(chip_values().map(|(_, value)| value))
}

/// All chips, with their other names.
pub(crate) fn chip_values() -> impl Iterator<Item = (&'static Chip, PossibleValue)> {
    let value = |chip: &Chip| kernel::aliases(chip).fold(PossibleValue::new(chip.name), PossibleValue::alias);
    Chip::all().map(move |chip: &'static Chip| (chip, value(chip)))
}

/// The chips for clap, which lists them in errors and completes them in shells.
pub(crate) fn chips() -> impl TypedValueParser<Value = &'static Chip> {
    chip_names().map(|name| chip(&name).expect("clap accepts only names of chips"))
}

pub(super) fn chip(name: &str) -> Result<&'static Chip, String> {
    Chip::by_name(name).ok_or_else(|| {
        // With clap's suggestion.
        let refused = clap::Command::new("")
            .no_binary_name(true)
            .arg(clap::Arg::new("chip").value_parser(chip_names()));
        let refused = refused.try_get_matches_from([name]).err();
        let meant = match refused.as_ref().and_then(|error| error.get(ContextKind::SuggestedValue)) {
            Some(ContextValue::String(meant)) => format!("did you mean {meant}? "),
            _ => String::new(),
        };
        format!("unknown chip `{name}`; {meant}`gaugefs chips` lists the known ones")
    })
}

pub(super) fn condition(text: &str) -> Result<Condition, String> {
    text.parse().map_err(|error: <Condition as FromStr>::Err| error.to_string())
}

pub(crate) fn count<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    text::unsigned(text).ok_or_else(|| format!("{text} is not a whole number of the range"))
}

pub(crate) fn integer(text: &str) -> Result<i64, String> {
    let number = text.parse().ok().or_else(|| text::unsigned(text));
    number.ok_or_else(|| "expected a whole number".into())
}

/// The value that a word stands for.
pub(crate) fn one_of<T: Copy>(text: &str, words: &[(&str, T)]) -> Result<T, String> {
    let known = || words.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", ");
    let found = words.iter().find(|(word, _)| *word == text);
    found.map(|(_, value)| *value).ok_or_else(|| format!("expected one of: {}", known()))
}

pub(super) fn key(text: &str) -> Result<SimKey, String> {
    let key = Secret::parse(Name::Unseal, text).map(|key| SimKey(key.words()));
    key.ok_or_else(|| "expected two words, such as '0414 3672'".into())
}

pub(super) fn order(text: &str) -> Result<Order, String> {
    Order::by_name(text).ok_or_else(|| "expected lsb-first or as-sent".into())
}

pub(crate) fn seal(text: &str) -> Result<Level, String> {
    one_of(text, &[("sealed", Level::Sealed), ("unsealed", Level::Unsealed)])
}

/// The models of adapters, by their names.
pub(crate) fn adapter(text: &str) -> Result<&'static AdapterModel, String> {
    one_of(text, &AdapterModel::all().map(|model| (model.name, model)).collect::<Vec<_>>())
}

pub(crate) fn address(text: &str) -> Result<u8, String> {
    const FORM: &str = "expected a 7-bit address, 0x08 to 0x77";
    // Data sheets write addresses in hexadecimal.
    let as_hex = u8::from_str_radix(text, 16).ok().filter(|&address| address == GAUGE_ADDRESS);
    match (text::unsigned::<u8>(text), as_hex) {
        (Some(address), Some(meant)) if address != meant => Err(format!(
            "{text} is 0x{address:02x}; did you mean 0x{meant:02x}? Write it in hexadecimal, with 0x"
        )),
        (Some(address @ 0x08..=0x77), _) => Ok(address),
        // An address with the read/write bit, as on the wire.
        (Some(wire @ 0x78..), _) if wire >> 1 == GAUGE_ADDRESS => {
            Err(format!("{FORM}; {text} is the 8-bit form of 0x{:02x}: write that", wire >> 1))
        }
        _ => Err(FORM.into()),
    }
}

/// A word in hexadecimal, as documents print it, with or without 0x.
pub(super) fn hexadecimal(text: &str) -> Result<u16, String> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    u16::from_str_radix(digits, 16)
        .map_err(|_| "expected up to four hexadecimal digits, such as 0x1202".into())
}

pub(super) fn number(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| "expected a number".into())
}

pub(super) fn interval(text: &str) -> Result<Duration, String> {
    seconds(text, (0.5, 3600.0))
}

pub(super) fn hold(text: &str) -> Result<Duration, String> {
    seconds(text, (0.0, 86400.0))
}

/// A pack voltage on a meter, in mV.
pub(crate) fn pack_voltage(text: &str) -> Result<f64, String> {
    shown(text, "mV", |millivolts| (1000.0..=1_000_000.0).contains(&millivolts))
}

/// A current on a meter, in mA.
pub(crate) fn meter_current(text: &str) -> Result<f64, String> {
    shown(text, "mA", |milliamperes| (100.0..=1_000_000.0).contains(&milliamperes.abs()))
}

/// Tolerance of a measured value, in its unit.
pub(crate) fn tolerance(text: &str) -> Result<f64, String> {
    let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| "expected a number from 0 on".into())
}

/// A temperature, in degrees Celsius.
pub(crate) fn celsius(text: &str) -> Result<f64, String> {
    let degrees = text.parse().ok().or_else(|| unit::measured(text, "°C"));
    let degrees = degrees.filter(|degrees| (-40.0..=125.0).contains(degrees));
    degrees.ok_or_else(|| "expected -40 to 125 degrees Celsius, such as 23.5 or 23.5C".into())
}

/// A Voltage Divider in whole mV.
pub(crate) fn divider(text: &str) -> Result<u16, String> {
    let millivolts = shown(text, "mV", |millivolts| (1000.0..=65535.0).contains(&millivolts))?;
    if millivolts.fract() != 0.0 {
        return Err("it is stored in steps of 1 mV, and this is none; it is not rounded".into());
    }
    let whole = Some(millivolts).filter(|millivolts| (0.0..=65535.0).contains(millivolts));
    whole.map(|millivolts| millivolts as u16).ok_or_else(|| "expected at most 65535 mV".into())
}

/// A number with a unit, or without one in `own`, that must be plausible: it may come from a meter in another unit, or
/// from a file of the mount.
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

pub(super) fn factor(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor @ 0.001..=1000.0) => Ok(factor),
        _ => Err("expected a factor from 0.001 to 1000".into()),
    }
}

/// A folder's name, which also appears in uevent, in paths and in users' shell scripts.
pub(super) fn name(text: &str) -> Result<String, String> {
    if keys::is_name(text) {
        Ok(text.to_string())
    } else {
        Err("expected letters, digits and . _ + -, at most 64, not beginning with a dot or dash".into())
    }
}

pub(super) fn group(text: &str) -> Result<u32, String> {
    if let Ok(gid) = text.parse() {
        return Ok(gid);
    }
    match nix::unistd::Group::from_name(text) {
        Ok(Some(group)) => Ok(group.gid.as_raw()),
        _ => Err("no such group".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_has_the_name_that_the_kernels_driver_gives_it_as_well() {
        let parsed = |name: &str| {
            let command = clap::Command::new("test").arg(clap::Arg::new("chip").value_parser(chips()));
            let matches = command.try_get_matches_from(["test", name]).ok()?;
            matches.get_one::<&'static Chip>("chip").map(|chip| chip.name)
        };
        let names =
            ["bq27441-g1", "bq27441", "bq27510g3", "bq27200", "bq27500-1", "bq27500", "bq2750x", "bq27999"];
        let found =
            ["bq27441-g1", "bq27441-g1", "bq27510-g3", "bq27000", "bq27500", "bq27500", "bq2750x", ""];
        assert_eq!(names.map(|name| parsed(name).unwrap_or_default()), found);
    }

    #[test]
    fn values_are_checked() {
        assert_eq!(address("0x55"), Ok(0x55));
        assert_eq!(address("85"), Ok(0x55));
        assert!(["0x07", "0x78", "0xaa", "55h", ""].iter().all(|text| address(text).is_err()));
        let refused = |text: &str| address(text).expect_err(text);
        assert!(refused("55").starts_with("55 is 0x37; did you mean 0x55?"), "{}", refused("55"));
        for text in ["0xaa", "0xab", "170"] {
            assert!(refused(text).ends_with("is the 8-bit form of 0x55: write that"), "{}", refused(text));
        }
        assert_eq!(refused("0x78"), "expected a 7-bit address, 0x08 to 0x77");
        assert_eq!(address("0x37"), Ok(0x37));
        assert_eq!(
            chip("bq34z10-g1").expect_err("unknown").split("; ").nth(1),
            Some("did you mean bq34z100-g1? `gaugefs chips` lists the known ones")
        );
        assert_eq!(interval("0.5"), Ok(Duration::from_millis(500)));
        assert!(["0.4", "3601", "NaN", "-1", "inf"].iter().all(|text| interval(text).is_err()));
        assert!(["0", "-1", "NaN", "1e9"].iter().all(|text| factor(text).is_err()));
        assert!(["", "..", "a/b", "a b", "-x", "BAT\n"].iter().all(|text| name(text).is_err()));
        assert_eq!(name("BAT_1.2"), Ok("BAT_1.2".into()));
    }

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

    #[test]
    fn a_time_is_in_seconds_or_has_a_unit() {
        assert_eq!(interval("2min"), Ok(Duration::from_secs(120)));
        assert_eq!(interval("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!((hold("1h"), hold("60s")), (Ok(Duration::from_secs(3600)), Ok(Duration::from_secs(60))));
        assert!(["2h", "400ms", "5V", "s", "1e400"].iter().all(|text| interval(text).is_err()));
    }
}
