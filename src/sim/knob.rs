//! The knobs of a simulated gauge: their names, and how their texts are read.

use super::fault::SYNTAX;
use crate::error::{Cause, Error, Result};

/// One file of the folder `sim/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Knob {
    /// Name of the file.
    pub name: &'static str,
    /// What it shows or does.
    pub help: &'static str,
    /// Whether it can be written.
    pub writable: bool,
}

const fn set(name: &'static str, help: &'static str) -> Knob {
    Knob { name, help, writable: true }
}

const fn show(name: &'static str, help: &'static str) -> Knob {
    Knob { name, help, writable: false }
}

/// All of them; the first ones belong to the bus, the others to the gauge.
pub(super) static KNOBS: &[Knob] = &[
    set("fault", SYNTAX),
    show("transfers", "transfers that passed on the bus"),
    show("bytes", "bytes that passed on the bus, address bytes included"),
    show("bus_us", "time those took at 100 kHz, in microseconds, without waits"),
    show("stretched_us", "time the gauge held the clock, in microseconds"),
    show("nacks", "transfers that were not acknowledged"),
    set("load_ma", "current drawn from the pack in mA; negative charges"),
    set("temperature", "ambient temperature in 0.1 degrees Celsius"),
    set("speed", "seconds of battery time to a second; 0 freezes it"),
    set("soc", "state of charge in percent"),
    set("voltage_mv", "what Voltage() shows in mV; `auto` for the model's"),
    set("power", "`on` or `off`: without it the gauge loses its RAM and does not answer"),
    show("mode", "normal, reset, calibration, config-update, rom, hdq or off"),
    set("protocol", "`i2c` or `hdq`: the interface the gauge listens on"),
    show("seal", "sealed, unsealed or full-access"),
    show("wear", "blocks that were programmed and how often: subclass/block count ..."),
    show("programmed", "how often any flash block was programmed"),
    show("dropped", "commits that were acknowledged and not stored"),
    show("resets", "full resets since power came"),
    show("state", "`ok`, or why the state file could not be written"),
    set("reset_busy", "`nack` or `stretch`: what the gauge does while it resets"),
    set("sealed_writes", "`nack` or `ignore`: what a sealed gauge does with registers it withholds"),
    set("load_ms", "from selecting a block until it can be read"),
    set("sealed_load_ms", "the same for the blocks that a sealed gauge shows"),
    set("cfgupdate_ms", "from SET_CFGUPDATE until CONFIG UPDATE begins"),
    set("cfgexit_ms", "from the way out of CONFIG UPDATE until it has ended"),
    set("cc_gain_inverted", "`on`: CC Gain is negative in ROM, as many parts have it; `off`"),
    set("auth_ms", "from the challenge's checksum until the digest can be read"),
    set("auth_order", "`lsb-first` or `as-sent`: order of challenge and digest on the wire"),
    set("word_ms", "time to program a 16-bit word of flash; the clock is held meanwhile"),
    set("df_shift", "bytes by which data flash lies lower than printed from 0x4100 on: 0 or 1"),
    set("key_quiet_ms", "silence on the bus without which a key is refused"),
];

/// A number within bounds.
pub(super) fn number(name: &str, text: &str, min: f64, max: f64) -> Result<f64> {
    let bad = || Error::new(name, Cause::Invalid(format!("`{text}` is not a number")));
    // What `f64` reads besides decimal numbers, such as `inf` and `1e9`, is not meant.
    if !text.bytes().all(|byte| byte.is_ascii_digit() || b"+-.".contains(&byte)) {
        return Err(bad());
    }
    let value: f64 = text.parse().map_err(|_| bad())?;
    if value < min || value > max {
        return Err(Error::new(name, Cause::OutOfRange(format!("{text} is not within {min} and {max}"))));
    }
    Ok(value)
}

/// Which of the words it is.
pub(super) fn choice(name: &str, text: &str, words: &[&str]) -> Result<usize> {
    let found = words.iter().position(|word| *word == text);
    let expected = || format!("`{text}` is not one of: {}", words.join(", "));
    found.ok_or_else(|| Error::new(name, Cause::Invalid(expected())))
}

pub(super) fn read_only(name: &str) -> Error {
    Error::new(name, Cause::NotPermitted("it can only be read".into()))
}
