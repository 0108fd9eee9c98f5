// SPDX-License-Identifier: MIT

//! A simulated gauge on a bus, and the commands that change it or ask what has passed.

use gauge_sim::Knob;

use crate::gauge::Gauge;
use crate::wire::{Counters, Message, Wire};

/// A gauge and the wire to it, shared between the adapter and the control connections.
#[derive(Debug)]
pub(crate) struct Bench {
    pub(crate) gauge: Gauge,
    pub(crate) wire: Wire,
    /// Another one on the same bus.
    pub(crate) beside: Option<Box<Bench>>,
}

impl Bench {
    /// A new gauge at its own address.
    pub(crate) fn new(chip: &str) -> Result<Self, String> {
        let gauge = Gauge::new(chip)?;
        let wire = Wire { address: gauge.bus.address().into(), ..Wire::default() };
        Ok(Self { gauge, wire, beside: None })
    }

    /// A request goes to one of the gauges as a whole.
    pub(crate) fn request(&mut self, messages: &mut [Message]) {
        let is_for = |bench: &Self| messages.first().is_some_and(|first| first.address == bench.wire.address);
        match &mut self.beside {
            Some(beside) if is_for(beside) => beside.request(messages),
            _ => self.wire.request(&mut self.gauge.bus, messages),
        }
    }

    /// Carries out a command of a control line. Returns what it prints.
    pub(crate) fn command(&mut self, words: &[&str]) -> Result<String, String> {
        let Self { gauge, wire, beside } = self;
        match *words {
            ["beside", chip, address] if address.starts_with("0x") => {
                let address = u16::from_str_radix(&address[2..], 16);
                let address = address.map_err(|_| "not an address".to_owned())?;
                let mut other = Self::new(chip)?;
                other.wire.address = address;
                *beside = Some(Box::new(other));
            }
            ["beside", ref command @ ..] => {
                return beside.as_mut().ok_or("there is no gauge beside it")?.command(command);
            }
            ["set", knob, ref value @ ..] if !value.is_empty() => {
                gauge.sim.set(knob, &value.join(" ")).map_err(|error| error.to_string())?;
            }
            ["get", knob] => {
                let value = gauge.sim.get(knob).ok_or_else(|| format!("{knob}: there is no such knob"))?;
                return Ok(value + "\n");
            }
            ["gauge", chip] => *gauge = Gauge::new(chip)?,
            ["knobs"] => {
                let line = |knob: &Knob| format!("{}: {}\n", knob.name, knob.help);
                return Ok(gauge.sim.knobs().iter().map(line).collect());
            }
            ["pass", seconds] => {
                gauge.clock.pass(seconds.parse().map_err(|_| format!("{seconds}: not a time"))?);
            }
            ["pace", "on"] => gauge.clock.pace(true),
            ["pace", "off"] => gauge.clock.pace(false),
            ["strange", "on"] => wire.strange = true,
            ["strange", "off"] => wire.strange = false,
            ["counters"] => {
                let Counters { transfers, bytes, bits, refused } = wire.counters;
                return Ok(format!("transfers {transfers}\nbytes {bytes}\nbits {bits}\nrefused {refused}\n"));
            }
            ["counters", "reset"] => wire.counters = Counters::default(),
            ["log"] => return Ok(gauge.sim.log().iter().map(|record| format!("{record}\n")).collect()),
            ["log", "clear"] => gauge.sim.clear_log(),
            _ => return Err(format!("{}: no such command", words.join(" "))),
        }
        Ok(String::new())
    }
}
