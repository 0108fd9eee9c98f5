//! `gaugefs probe`: what answers on a bus.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use serde::Serialize;

use super::{align, print, print_json};
use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::Role;
use crate::clock::{Clock, RealClock};
use crate::config::address;
use crate::error::{Error, Result};
use crate::probe::{self, ROM_ADDRESS, Reading};

const PROBE: &str = "\
Without --address only registers are read, at 0x55 and for a gauge in ROM mode at 0x0b;
that harms no other device. With --address, what reads like a gauge is asked who it is.
An address that a kernel driver has is not touched.

Examples:
  gaugefs probe --bus /dev/i2c-1
  gaugefs probe --bus /dev/i2c-1 --address 0x55";

/// Look what answers on a bus, without harm to what is no gauge
#[derive(Args, Debug)]
#[command(after_help = PROBE)]
pub(super) struct Probe {
    /// The I2C bus, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE")]
    bus: PathBuf,
    /// Ask what is at this 7-bit address who it is
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    address: Option<u8>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What answers at one address.
#[derive(Serialize)]
struct Found {
    address: u8,
    state: State,
    chips: Vec<&'static str>,
    details: String,
}

/// What kind of device answers at an address.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    /// A gauge that has said which part it is, or may be one of a few parts.
    Gauge,
    /// It reads like a gauge and was not asked which.
    Maybe,
    /// It may be a gauge in ROM mode.
    Rom,
    /// A kernel driver is bound to the address.
    Driver,
    /// Another process of gaugefs uses the gauge.
    Busy,
    /// Not a gauge that gaugefs knows.
    Other,
    /// No answer.
    Nothing,
}

/// What the whole command found, for --json.
#[derive(Serialize)]
struct Report {
    bus: String,
    adapter: String,
    found: Vec<Found>,
}

impl Probe {
    pub(super) fn run(self) -> Result<ExitCode> {
        let adapter = Adapter::find(&self.bus)?;
        let found = match self.address {
            Some(address) => vec![look(&adapter, address, true)?],
            None => vec![look(&adapter, GAUGE_ADDRESS, false)?, look_for_rom(&adapter)?],
        };
        let any = found.iter().any(|found| !matches!(found.state, State::Other | State::Nothing));
        if self.json {
            let (bus, adapter) = (adapter.to_string(), adapter.name().unwrap_or_default());
            print_json(&Report { bus, adapter, found });
        } else {
            print(&self.table(&adapter, &found));
        }
        Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    fn table(&self, adapter: &Adapter, found: &[Found]) -> String {
        let mut rows = vec![["ADDRESS", "ANSWERS", "DETAILS"].map(String::from)];
        for found in found {
            let who = match found.state {
                State::Nothing => "no".to_string(),
                State::Gauge => found.chips.join(" or "),
                State::Maybe => format!("maybe {}", found.chips.join(" or ")),
                State::Rom => "a gauge in ROM mode?".to_string(),
                State::Driver => "the kernel's".to_string(),
                State::Busy => "in use".to_string(),
                State::Other => "something else".to_string(),
            };
            rows.push([format!("0x{:02x}", found.address), who, found.details.clone()]);
        }
        let mut table = align(&rows);
        if self.address.is_none() && found.iter().any(|found| found.state == State::Maybe) {
            // Writing to a String does not fail.
            let _ = writeln!(table, "To ask it who it is: gaugefs probe --bus {adapter} --address 0x55");
        }
        table
    }
}

/// What is at an address; asked who it is only where the user has named it.
fn look(adapter: &Adapter, address: u8, named: bool) -> Result<Found> {
    let found = |state, chips, details| Ok(Found { address, state, chips, details });
    if let Some(driver) = adapter.driver(address) {
        let details = format!("driver {} ({}) has it; not touched", driver.name, driver.device);
        return found(State::Driver, Vec::new(), details);
    }
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let open = || {
        let bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
        Ok(Box::new(bus) as Box<dyn Bus>)
    };
    let plausible = match probe::candidates(&open, &clock).map_err(Error::from) {
        Ok(plausible) => plausible,
        Err(error) => match error.errno() {
            nix::errno::Errno::ENXIO => return found(State::Nothing, Vec::new(), String::new()),
            nix::errno::Errno::EBUSY => {
                return found(State::Busy, Vec::new(), "another gaugefs has it".into());
            }
            _ => return Err(error),
        },
    };
    let Some(first) = plausible.first() else {
        return found(
            State::Other,
            Vec::new(),
            "does not read like a gauge; nothing was written to it".into(),
        );
    };
    let reads = reads(first);
    if !named {
        let chips = plausible.iter().map(|reading| reading.chip.name).collect();
        return found(State::Maybe, chips, reads);
    }
    let who = probe::identify(&plausible, &open, &clock)?;
    let answers = who.answers;
    let told = format!(
        "device type 0x{:04x}, firmware 0x{:04x}, hardware 0x{:04x}",
        answers.device_type, answers.firmware_version, answers.hardware_version
    );
    let chips = who.chips.iter().map(|chip| chip.name).collect::<Vec<_>>();
    match who.sibling {
        _ if !chips.is_empty() => found(State::Gauge, chips, format!("{told}; {reads}")),
        Some(sibling) => {
            let what = match sibling.like {
                Some(like) => format!("mounts as a {}, without data flash", like.name),
                None => "not supported".to_string(),
            };
            found(State::Other, chips, format!("{told}: a {}; {what}", sibling.name))
        }
        None => found(State::Other, chips, format!("{told}: no part that gaugefs knows")),
    }
}

/// A gauge in ROM mode answers at an address of its own.
fn look_for_rom(adapter: &Adapter) -> Result<Found> {
    let address = ROM_ADDRESS;
    let found =
        |state, details: &str| Ok(Found { address, state, chips: Vec::new(), details: details.into() });
    if let Some(driver) = adapter.driver(address) {
        return found(
            State::Driver,
            &format!("driver {} ({}) has it; not touched", driver.name, driver.device),
        );
    }
    let mut bus = LinuxBus::open(adapter.clone(), address, Arc::new(RealClock::new()))?;
    match probe::answers_in_rom(&mut bus) {
        Ok(true) => {
            found(State::Rom, "a gauge whose flash was being programmed, unless another device lives there")
        }
        Ok(false) => found(State::Nothing, ""),
        Err(error) => Err(error.about(format!("{adapter} address 0x{address:02x}")).into()),
    }
}

/// What a person recognises a pack by.
fn reads(reading: &Reading) -> String {
    let mut parts = Vec::new();
    let mut add = |role, show: &dyn Fn(f64) -> String| {
        if let Some(value) = reading.value(role) {
            parts.push(show(value as f64));
        }
    };
    add(Role::VoltageNow, &|mv| format!("{:.3} V", mv / 1000.0));
    add(Role::CurrentNow, &|ma| format!("{:.3} A", ma / 1000.0));
    add(Role::Capacity, &|percent| format!("{percent} %"));
    add(Role::Temp, &|kelvin| format!("{:.1} °C", (kelvin - 2731.0) / 10.0));
    parts.join(", ")
}
