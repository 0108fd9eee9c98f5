// SPDX-License-Identifier: MIT

//! A learning cycle, watched through the files of a mount.

use jiff::Timestamp;

use gaugefs_client::sample::Sample;
use ti_gauge::chip::{Chip, Role, snake_case};
use ti_gauge::learning::{Bits, Cycle, Learns, Limits, Reading, State};

/// The chip of a sample.
pub(super) fn chip(sample: &Sample) -> Option<&'static Chip> {
    let model = sample.attribute("model_name")?;
    Chip::by_model(model)
}

/// A cycle for a sample's part; `None` if its learning cycle is unknown.
pub(super) fn cycle(sample: &Sample) -> Option<Cycle> {
    Some(Cycle::new(Learns::of(chip(sample)?)?, Limits::default()))
}

/// A sample's facts about learning. Registers are used because attributes may be scaled, and data flash's thresholds
/// are not.
pub(super) fn reading(sample: &Sample) -> Option<Reading> {
    let chip = chip(sample).filter(|_| sample.present())?;
    let register =
        |name: &str| sample.registers.iter().find(|(found, _)| found == name).map(|(_, value)| *value);
    let value = |role: Role| {
        let row = chip.registers.iter().find(|row| row.role == Some(role))?;
        register(&snake_case(row.name)).map(|value| value as f64)
    };
    Some(Reading {
        time: seconds(sample.time),
        bits: Bits::named(sample.words.iter().flat_map(|(_, bits)| bits.split_whitespace())),
        current_ma: value(Role::CurrentNow).or_else(|| value(Role::CurrentAvg))?,
        voltage_mv: value(Role::VoltageNow),
        degrees: value(Role::Temp).map(|tenths| (tenths - 2731.0) / 10.0),
        design_mah: value(Role::ChargeFullDesign),
        percent: value(Role::Capacity),
        has_learned_status: sample.words.iter().any(|(name, _)| name == "learned_status"),
    })
}

fn seconds(time: Timestamp) -> f64 {
    time.as_millisecond() as f64 / 1000.0
}

/// The line of a state, with UTC times.
pub(super) fn line(state: &State) -> String {
    state.line(clock)
}

pub(super) fn clock(seconds: f64) -> String {
    Timestamp::from_second(seconds as i64).unwrap_or_default().to_string()
}
