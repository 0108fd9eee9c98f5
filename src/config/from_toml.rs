//! The values of options in TOML, where each may be a number or a string. The checks are those of the
//! command line.

use std::time::Duration;

use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::values::{self, Key};
use gaugefs_client::condition::Condition;
use gaugefs_host::word;
use ti_gauge::authentication::Order;
use ti_gauge::chip::Chip;

/// `true` for the usual name, `false` for none, or a name.
pub(super) fn ac<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected true, false or a name")]
    enum Ac {
        Shown(bool),
        Name(String),
    }
    Ok(match Ac::deserialize(from)? {
        Ac::Shown(shown) => shown.then_some(None),
        Ac::Name(text) => Some(Some(values::name(&text).map_err(D::Error::custom)?)),
    })
}

/// TOML's numbers do not say how they were written; the file is asked for that.
pub(super) fn address<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u8>, D::Error> {
    word(from, |text| match text.parse::<u8>() {
        Ok(number) => values::address(&format!("{number:#04x}")),
        Err(_) => values::address(text),
    })
}

pub(super) fn condition<'de, D: Deserializer<'de>>(from: D) -> Result<Condition, D::Error> {
    String::deserialize(from)?.parse().map_err(D::Error::custom)
}

pub(super) fn clear<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Condition>, D::Error> {
    condition(from).map(Some)
}

pub(super) fn chip<'de, D: Deserializer<'de>>(from: D) -> Result<Option<&'static Chip>, D::Error> {
    word(from, values::chip)
}

pub(super) fn factor<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    word(from, values::factor)
}

pub(super) fn group<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    word(from, values::group)
}

pub(super) fn hold<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
    word(from, values::hold)
}

pub(super) fn interval<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
    word(from, values::interval)
}

pub(super) fn key<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Key>, D::Error> {
    word(from, values::key)
}

pub(super) fn name<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    word(from, values::name)
}

pub(super) fn order<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Order>, D::Error> {
    word(from, values::order)
}
