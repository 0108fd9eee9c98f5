//! The values of options, checked alike on the command line and in a configuration file.

use std::fmt;
use std::ptr;
use std::time::Duration;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use clap::error::{ContextKind, ContextValue};
use gauge_bus::GAUGE_ADDRESS;
use gaugefs_host::seconds;
use ti_gauge::authentication::Order;
use ti_gauge::chip::{Chip, kernel};
use ti_gauge::keys::{self, Name, Secret};
use ti_gauge::text;

/// Key words, which are not shown again.
#[derive(Clone)]
pub(crate) struct Key(pub(crate) [u16; 2]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("hidden")
    }
}

pub(crate) fn chip_names() -> PossibleValuesParser {
    PossibleValuesParser::new(Chip::all().map(|chip| {
        // A name of the kernel's driver that is also the name of another chip here is that chip's.
        let alias = kernel::driver_name(chip)
            .filter(|name| Chip::by_name(name).is_some_and(|one| ptr::eq(one, chip)));
        alias.into_iter().fold(PossibleValue::new(chip.name), PossibleValue::alias)
    }))
}

/// The chips as clap takes them, which lists them in errors and completes them in shells.
pub(crate) fn chips() -> impl TypedValueParser<Value = &'static Chip> {
    chip_names().map(|name| chip(&name).expect("clap accepts only names of chips"))
}

pub(super) fn chip(name: &str) -> Result<&'static Chip, String> {
    Chip::by_name(name).ok_or_else(|| {
        // As the command line suggests one.
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

pub(super) fn key(text: &str) -> Result<Key, String> {
    let key = Secret::parse(Name::Unseal, text).map(|key| Key(key.words()));
    key.ok_or_else(|| "expected two words, such as '0414 3672'".into())
}

pub(super) fn order(text: &str) -> Result<Order, String> {
    Order::by_name(text).ok_or_else(|| "expected lsb-first or as-sent".into())
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
        // With the bit that says whether a byte is read or written, as it is on the wire.
        (Some(wire @ 0x78..), _) if wire >> 1 == GAUGE_ADDRESS => {
            Err(format!("{FORM}; {text} is the 8-bit form of 0x{:02x}: write that", wire >> 1))
        }
        _ => Err(FORM.into()),
    }
}

pub(super) fn interval(text: &str) -> Result<Duration, String> {
    seconds(text, (0.5, 3600.0))
}

pub(super) fn hold(text: &str) -> Result<Duration, String> {
    seconds(text, (0.0, 86400.0))
}

pub(super) fn factor(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor @ 0.001..=1000.0) => Ok(factor),
        _ => Err("expected a factor from 0.001 to 1000".into()),
    }
}

/// The name of a folder, which also appears in uevent, in paths and in other people's shell scripts.
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
    fn a_time_is_in_seconds_or_has_a_unit() {
        assert_eq!(interval("2min"), Ok(Duration::from_secs(120)));
        assert_eq!(interval("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!((hold("1h"), hold("60s")), (Ok(Duration::from_secs(3600)), Ok(Duration::from_secs(60))));
        assert!(["2h", "400ms", "5V", "s", "1e400"].iter().all(|text| interval(text).is_err()));
    }
}
