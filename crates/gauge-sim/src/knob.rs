// SPDX-License-Identifier: MIT

//! The knobs of a simulated gauge: their names, and how their texts are read.

use std::time::Duration;

use gauge_bus::error::{Error, ErrorKind, Result};

/// Knobs that also act on gauges without data flash.
pub(super) const OF_REGISTERS: &[&str] = &[
    "load_ma",
    "temperature",
    "speed",
    "clock",
    "soc",
    "voltage_mv",
    "power",
    "mode",
    "first_ms",
    "single_byte",
    "bus_free_us",
    "watchdog",
];

/// Knobs of all gauges that also act on a Smart Battery.
pub(super) const OF_PACKS: &[&str] =
    &["load_ma", "temperature", "speed", "clock", "soc", "voltage_mv", "power", "mode"];

/// One file of the folder `sim/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Knob {
    /// Name of the file.
    pub name: &'static str,
    /// Describes what the knob shows or does.
    pub help: &'static str,
    /// Whether it can be written.
    pub writable: bool,
    pub(super) of: Of,
}

/// Which gauges have a knob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    Bus,
    Gauge,
    Block,
    Mac,
    /// A gauge that drives FETs.
    Fets,
    /// A gauge that counts the voltage of its sense resistor.
    Volts,
    /// A Smart Battery.
    Smart,
    /// A gauge of TI's in one.
    Ti,
}

impl Of {
    const fn set(self, name: &'static str, help: &'static str) -> Knob {
        Knob { name, help, writable: true, of: self }
    }

    const fn show(self, name: &'static str, help: &'static str) -> Knob {
        Knob { name, help, writable: false, of: self }
    }
}

/// All knobs.
pub(super) static KNOBS: &[Knob] = &[
    Of::Bus.set("fault", "faults that are still to come, with `;` between"),
    Of::Bus.show("transfers", "transfers that passed on the bus"),
    Of::Bus.show("bytes", "bytes that passed on the bus, address bytes included"),
    Of::Bus.show("bus_us", "time those took at 100 kHz, in microseconds, without waits"),
    Of::Bus.show("stretched_us", "time the gauge held the clock, in microseconds"),
    Of::Bus.show("nacks", "transfers that were not acknowledged"),
    Of::Gauge.set("load_ma", "current drawn from the pack in mA; negative charges"),
    Of::Gauge.set("temperature", "ambient temperature in 0.1 degrees Celsius"),
    Of::Gauge.set("speed", "seconds of battery time to a second; 0 freezes it"),
    Of::Gauge.show("clock", "battery time, in seconds since 1970; it begins as the host's, and `speed` applies to it"),
    Of::Gauge.set("soc", "state of charge in percent"),
    Of::Gauge
        .set("voltage_mv", "what Voltage() shows in mV with the present calibration; `auto` for the model's"),
    Of::Block.set("cells", "cells in series that the pack really has; `auto` for as many as data flash says"),
    Of::Block.set("real_mah", "charge of the full pack in mAh, whatever data flash says; `auto` for Qmax there"),
    Of::Block.show("real_soc", "what the pack really has left of that, in percent"),
    Of::Block.set(
        "board_divider",
        "the Voltage Divider that fits the board in mV, with the internal divider off; `auto` if data flash fits it",
    ),
    Of::Block.set("shunt_error", "by how much the shunt is larger than data flash says, in thousandths"),
    Of::Gauge.set("cell_mohm", "resistance of a cell at 25 degrees Celsius in milliohms"),
    Of::Gauge.set(
        "thermistor",
        "`in` or `out`: without it a gauge that uses it shows the lowest temperature; `short` the highest",
    ),
    Of::Gauge.set(
        "keeps_full",
        "`on`: FullChargeCapacity() does not follow what is written to data memory, until a RESET or a loss of power; `off`",
    ),
    Of::Block.set(
        "board_offset_ma",
        "current in mA that the board adds, from which Board Offset is subtracted; `auto` if that fits",
    ),
    Of::Block
        .set("cc_offset_ma", "current in mA that the gauge adds, from which CC Offset is subtracted; `auto` if that fits"),
    Of::Block.set("bat_det", "`in` or `out`: whether the gauge's pin detects a battery; the gauge keeps its power"),
    Of::Block.set("temperature_error", "error of the temperature sensors in 0.1 K"),
    Of::Block.set("noise_mv", "largest noise of Voltage() in mV"),
    Of::Block.set("noise_ma", "largest noise of Current() in mA"),
    Of::Gauge.set("power", "`on` or `off`: without it the gauge loses its RAM and does not answer"),
    Of::Gauge.show("mode", "normal, reset, calibration, config-update, rom, dead, hdq or off"),
    Of::Block.set("protocol", "`i2c` or `hdq`: the interface the gauge listens on"),
    Of::Gauge.set("seal", "seal state of the gauge: `sealed`, `unsealed` or `full-access`"),
    Of::Gauge.show("wear", "blocks that were programmed and how often: subclass/block count ..."),
    Of::Gauge.show("programmed", "how often any flash block was programmed"),
    Of::Gauge.show("dropped", "commits that were acknowledged and not stored"),
    Of::Gauge.show("resets", "full resets since power came"),
    Of::Gauge.show("state", "`ok`, or why the state file could not be written"),
    Of::Gauge
        .set("reset_ms", "from a RESET to the first answer, or to the reset itself if `reset_busy` is `old`"),
    Of::Gauge.set(
        "reset_busy",
        "`nack`, `stretch` or `old`: what the gauge does while it resets; `old` answers as before",
    ),
    Of::Block
        .set("sealed_writes", "`nack` or `ignore`: what a sealed gauge does with registers it withholds"),
    Of::Gauge.set("load_ms", "from selecting a block until it can be read"),
    Of::Block.set("sealed_load_ms", "the same for the blocks that a sealed gauge shows"),
    Of::Gauge.set("cfgupdate_ms", "from SET_CFGUPDATE until CONFIG UPDATE begins"),
    Of::Gauge.set("cfgexit_ms", "from the way out of CONFIG UPDATE until it has ended"),
    Of::Block.set("cc_gain_inverted", "`on`: CC Gain is negative in ROM, as many parts have it; `off`"),
    Of::Block.set("auth_ms", "from the challenge's checksum until the digest can be read"),
    Of::Block.set("auth_order", "`lsb-first` or `as-sent`: order of challenge and digest on the wire"),
    Of::Gauge.set("word_ms", "time to program a 16-bit word of flash; the clock is held meanwhile"),
    Of::Gauge.set("commit_ms", "time that a commit takes besides that of its words"),
    Of::Gauge.set(
        "commit_busy",
        "`nack`, `stretch` or `old`: what the gauge does meanwhile; `old` loads the block as it was",
    ),
    Of::Gauge
        .set("block_ms", "longest time by which a block can be read later than others; each has its own"),
    Of::Gauge.set(
        "early",
        "`previous` or `blank`: what is read of a block that is not loaded, with a valid checksum",
    ),
    Of::Gauge.set(
        "uncommitted",
        "`written` or `stored`: what is read of a block that was written, before its checksum commits it",
    ),
    Of::Gauge.set(
        "tear",
        "`rest-old`, `rest-erased`, `old`, `erased` or `neighbour`: what a loss of power leaves of a commit",
    ),
    Of::Gauge
        .set("first_ms", "time after the first answer in which Voltage() is 0 and predictions are wrong"),
    Of::Gauge.set("first_values", "`old` or `nonsense`: what the predictions are meanwhile"),
    Of::Gauge.set("no_initcomp", "`on`: [INITCOMP] never comes, and predictions stay as before it; `off`"),
    Of::Gauge.set("reset_every_s", "seconds after which the gauge loses its power for a moment, again and again; 0 never"),
    Of::Gauge.set("status_ms", "time by which CONTROL_STATUS shows a change of the seal state late"),
    Of::Block.set("lock_ms", "how long a gauge that has sealed itself refuses keys"),
    Of::Block.set(
        "key_lock",
        "`on`: a gauge with RAM refuses keys for that time after a wrong or interrupted key too; `off`",
    ),
    Of::Gauge.set("drop_resets", "how many RESETs the gauge ignores from now on"),
    Of::Gauge.set("drop_seals", "how many SEAL commands it ignores"),
    Of::Gauge.set("drop_keys", "how many right keys it refuses"),
    Of::Gauge.set("drop_updates", "how often it has the first block that was written again after CONFIG UPDATE"),
    Of::Block.set("reseals", "`on`: a gauge that was sealed seals itself after CONFIG UPDATE without its bit; `off`"),
    Of::Gauge.set(
        "rewrite_ms",
        "interval at which the gauge changes one of its own values and programs its row; 0 never",
    ),
    Of::Gauge.set("rewrite_every", "the same interval in transfers; 0 never"),
    Of::Bus.set("nack_as", "`enxio`, `eio`, `etimedout` or `eagain`: what the adapter reports for a NACK"),
    Of::Gauge.set("firmware", "FW_VERSION in hexadecimal, or `printed`"),
    Of::Gauge.set("hardware", "HW_VERSION in hexadecimal, or `printed`"),
    Of::Gauge.set(
        "watchdog",
        "`on`: a standard command more than twice a second for some seconds resets the gauge; `off`",
    ),
    Of::Gauge.set(
        "single_byte",
        "`on`: the second data byte of a write is not acknowledged, as above 100 kHz; `off`",
    ),
    Of::Gauge.set("bus_free_us", "time after STOP in microseconds within which START is not acknowledged"),
    Of::Gauge.set("endurance", "how often a block can be programmed until some of its bits stay 0; 0 always"),
    Of::Mac.set("cal_enable", "`on`: a bq35100 enters calibration mode only after CAL_ENABLE; `off`"),
    Of::Mac.set("df_shift", "bytes by which data flash lies lower than printed from 0x4100 on: 0 or 1"),
    Of::Fets.show(
        "fets",
        "`closed`, or what has opened them since the gauge was made, for a moment or longer: `reset`, `checksum`, `test`, \
         `shutdown`, `over-voltage`, `under-voltage`, `hot-charge`, `hot-discharge`",
    ),
    Of::Volts.set("battery", "`out`: nothing is behind the registers, and all of them read 0xff; `in`"),
    Of::Smart.set("series", "cells in series, 1 to 16; words 0x3c to 0x3f have the first four"),
    Of::Smart.set(
        "specification",
        "SpecificationInfo() in hexadecimal: 0x0031 has PEC, 0x0021 has none; the upper digits are powers of ten",
    ),
    Of::Smart.set("battery_mode", "BatteryMode() in hexadecimal: 0x8000 has capacities in 10 mWh, 0x0000 in mAh"),
    Of::Smart.set(
        "pec",
        "`right`, `missing`, or `split`: the packet error code as behind an adapter that splits a transfer with a STOP",
    ),
    Of::Smart.set(
        "answers",
        "`own`, or codes and the bytes sent in place of the pack's answers: `0d=6400 1b=-`, where `-` is no acknowledgement, \
         and `all=1717`",
    ),
    Of::Smart.set("sleeps", "`on`: after 10 s of silence it answers only 1 s after it was addressed; `off`"),
    Of::Smart.set("failed", "`on`: a permanent failure, after which its switches stay open for good; `off`"),
    Of::Smart.show("written", "messages that were more than a command and a read"),
    Of::Ti.set("device_type", "DeviceType() in hexadecimal, of another part; or `printed`"),
    Of::Ti.set("ti_firmware", "the version of its firmware in hexadecimal, two digits behind the point; or `printed`"),
    Of::Ti.set("pf_status", "PFStatus() in hexadecimal: the reasons of a permanent failure; 0x00000000 for none"),
    Of::Ti.set("sealed", "`on`; `off`: unsealed, where every command works"),
    Of::Ti.set("unknown", "codes in hexadecimal that its firmware does not have, or `none`"),
    Of::Ti.set(
        "mac",
        "`right`, `silent` for no acknowledgement, `echo` for another code before the answer, `noise` for other bytes",
    ),
    Of::Ti.set("stale", "how many of the next answers are the block before, as while it programs its flash"),
    Of::Ti.show("harm", "commands that did more than answer"),
    Of::Gauge.set("key_quiet_ms", "silence on the bus without which a key is refused"),
    Of::Gauge.set("full_access_quiet_ms", "the same for the key to FULL ACCESS"),
    Of::Gauge.set("refused_quiet_ms", "the same after a key was refused"),
];

/// A value of a knob.
pub(super) trait KnobValue {
    fn show(&self) -> String;
    /// Takes a text. A bad text changes nothing.
    fn turn(&mut self, name: &str, text: &str) -> Result<()>;
}

/// A value with a word for each position.
pub(super) trait KnobChoice: Copy + PartialEq + 'static {
    const WORDS: &'static [(&'static str, Self)];
}

impl<C: KnobChoice> KnobValue for C {
    fn show(&self) -> String {
        Self::WORDS.iter().find(|(_, value)| value == self).map_or("", |(word, _)| word).into()
    }

    fn turn(&mut self, name: &str, text: &str) -> Result<()> {
        let found = Self::WORDS.iter().find(|(word, _)| *word == text);
        let words = || Self::WORDS.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", ");
        *self = found.ok_or_else(|| none_of(name, &words()))?.1;
        Ok(())
    }
}

impl KnobChoice for bool {
    const WORDS: &'static [(&'static str, Self)] = &[("off", false), ("on", true)];
}

impl KnobValue for Duration {
    fn show(&self) -> String {
        self.as_millis().to_string()
    }

    fn turn(&mut self, name: &str, text: &str) -> Result<()> {
        *self = Duration::from_millis(number(name, text, 0.0, 60_000.0)? as u64);
        Ok(())
    }
}

impl KnobValue for u32 {
    fn show(&self) -> String {
        self.to_string()
    }

    fn turn(&mut self, name: &str, text: &str) -> Result<()> {
        *self = number(name, text, 0.0, 1_000_000.0)? as u32;
        Ok(())
    }
}

/// A word in place of the documented one.
impl KnobValue for Option<u16> {
    fn show(&self) -> String {
        self.map_or_else(|| "printed".into(), |word| format!("0x{word:04X}"))
    }

    fn turn(&mut self, name: &str, text: &str) -> Result<()> {
        let bad = || {
            Error::new(
                name,
                ErrorKind::Invalid,
                "neither `printed` nor a hexadecimal word; write one such as 0x0100",
            )
        };
        *self = match text {
            "printed" => None,
            _ => {
                let digits = text
                    .strip_prefix("0x")
                    .filter(|digits| digits.bytes().all(|byte| byte.is_ascii_hexdigit()));
                Some(digits.and_then(|digits| u16::from_str_radix(digits, 16).ok()).ok_or_else(bad)?)
            }
        };
        Ok(())
    }
}

#[derive(Debug)]
pub(super) struct Switch([&'static str; 2]);

pub(super) const POWER: Switch = Switch(["off", "on"]);
pub(super) const BATTERY: Switch = Switch(["in", "out"]);
pub(super) const PROTOCOL: Switch = Switch(["i2c", "hdq"]);
pub(super) const SEALED_WRITES: Switch = Switch(["nack", "ignore"]);
pub(super) const CC_GAIN_INVERTED: Switch = Switch(["off", "on"]);
pub(super) const AUTH_ORDER: Switch = Switch(["lsb-first", "as-sent"]);

impl Switch {
    pub(super) fn show(&self, second: bool) -> String {
        self.0[usize::from(second)].into()
    }

    /// Whether `text` is the second position.
    pub(super) fn read(&self, name: &str, text: &str) -> Result<bool> {
        let found = self.0.iter().position(|word| *word == text);
        found.map(|at| at == 1).ok_or_else(|| none_of(name, &self.0.join(", ")))
    }
}

// The text is not repeated: it may be a key that somebody typed into the wrong file.
fn none_of(name: &str, words: &str) -> Error {
    Error::new(name, ErrorKind::Invalid, format!("no such setting; write one of: {words}"))
}

pub(super) fn or_auto(name: &str, text: &str, min: f64, max: f64) -> Result<Option<f64>> {
    if text == "auto" {
        return Ok(None);
    }
    number(name, text, min, max).map(Some).map_err(|error| {
        let text = format!("{}, or auto", error.text);
        Error { text, ..error }
    })
}

pub(super) fn show_or_auto(value: Option<f64>) -> String {
    value.map_or_else(|| "auto".into(), |value| value.to_string())
}

pub(super) fn number(name: &str, text: &str, min: f64, max: f64) -> Result<f64> {
    let bad = || Error::new(name, ErrorKind::Invalid, format!("not a number; write one from {min} to {max}"));
    // `f64` also parses `inf` and `1e9`.
    if !text.bytes().all(|byte| byte.is_ascii_digit() || b"+-.".contains(&byte)) {
        return Err(bad());
    }
    let value: f64 = text.parse().map_err(|_| bad())?;
    if value < min || value > max {
        return Err(Error::new(name, ErrorKind::OutOfRange, format!("write a number from {min} to {max}")));
    }
    Ok(value)
}
