// SPDX-License-Identifier: MIT

//! `gaugefs probe`: scans a bus. [`ti_gauge::probe`] decides what may be sent to an unknown
//! device.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use nix::errno::Errno;
use serde::Serialize;

use super::align;
use crate::config::address;
use crate::error::{Cause, Error, Result};
use crate::output::{print, print_json};
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::linux::{Adapter, LinuxBus, adapters, described};
use gauge_bus::{Bus, BusError, GAUGE_ADDRESS, Reach};
use gauge_owner::GaugeOptions;
use ti_gauge::chip::Role;
use ti_gauge::codec::FREEZING;
use ti_gauge::probe::{self, ROM_ADDRESS, Reading, Target};
use ti_gauge::rom::{self, Beside, Device};

const PROBE: &str = "\
Without --address it only reads registers: at 0x55, at 0x0b where a Smart Battery or a gauge in ROM
mode answers, and at 0x09 and 0x0a, where a charger or a manager of Smart Batteries does. That is
harmless to other devices. With --address, a device that reads like a gauge is also asked
for its type. An address that a kernel driver uses is not touched. Without --bus, the answer names
each bus that was skipped, and why.

Examples:
  gaugefs probe
  gaugefs probe --bus /dev/i2c-1
  gaugefs probe --bus /dev/i2c-1 --address 0x55";

/// Scan buses for gauges without disturbing other devices
#[derive(Args, Debug)]
#[command(after_help = PROBE)]
pub(super) struct Probe {
    /// The I2C bus, such as /dev/i2c-1 [default: all buses that this user may use]
    #[arg(long, value_name = "DEVICE")]
    bus: Option<PathBuf>,
    /// Identify the gauge at this 7-bit address
    #[arg(long, value_name = "ADDRESS", value_parser = address, requires = "bus")]
    address: Option<u8>,
    /// Write one byte a transfer, for a bus above 100 kHz
    #[arg(long, requires = "address")]
    byte_writes: bool,
    /// Print JSON, one object per line for each bus
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Found {
    address: u8,
    state: State,
    chips: Vec<&'static str>,
    details: String,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    /// A supported gauge, identified.
    Gauge,
    /// Its registers read like a gauge's; it was not asked for its type.
    Maybe,
    /// Perhaps a gauge in ROM mode.
    Rom,
    /// A Smart Battery.
    Pack,
    /// The charger of a Smart Battery.
    Charger,
    /// A manager of Smart Batteries.
    Manager,
    /// A kernel driver is bound to the address.
    Driver,
    /// Another gaugefs uses it.
    Busy,
    /// Any other device.
    Other,
    /// The address is not acknowledged.
    Nothing,
    /// The address is not acknowledged, or something else that the adapter reports alike.
    Silent,
    /// A transfer failed otherwise.
    Failed,
}

/// The findings of the whole command, for --json.
#[derive(Serialize)]
struct Report {
    bus: String,
    adapter: String,
    found: Vec<Found>,
    /// The muxes on it, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    mux: Option<String>,
}

/// A bus that was skipped, for --json.
#[derive(Serialize)]
struct Skipped<'a> {
    bus: &'a str,
    adapter: &'a str,
    skipped: &'a str,
}

impl Probe {
    pub(super) fn run(self) -> Result<ExitCode> {
        let any = match &self.bus {
            Some(bus) => {
                let report = self.look(&Adapter::find(bus)?)?;
                if self.json {
                    print_json(&report)?;
                } else {
                    print(&self.table(&report))?;
                }
                report.any()
            }
            None => self.all()?,
        };
        Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    /// Looks at every bus that this user may use. Returns whether it has found something.
    fn all(&self) -> Result<bool> {
        let mut any = false;
        let buses = adapters(Path::new("/"));
        if buses.is_empty() {
            let why = "this machine has no I2C bus; `gaugefs doctor` says why";
            return Err(Error::host("", Errno::ENOENT, why));
        }
        for (number, name) in buses {
            let bus = format!("/dev/i2c-{number}");
            let adapter = Adapter::find(Path::new(&bus)).map_err(Error::from);
            let looked = adapter.and_then(|adapter| self.look(&adapter));
            match (looked, self.json) {
                (Ok(report), true) => {
                    any |= report.any();
                    print_json(&report)?;
                }
                (Ok(report), false) => {
                    any |= report.any();
                    print(&format!("{bus} ({name})\n{}", self.table(&report)))?;
                }
                (Err(why), true) => {
                    print_json(&Skipped { bus: &bus, adapter: &name, skipped: &why.to_string() })?;
                }
                (Err(why), false) => print(&format!("{bus} ({name})\nskipped: {why}\n"))?,
            }
        }
        Ok(any)
    }

    fn look(&self, adapter: &Adapter) -> Result<Report> {
        let options = GaugeOptions { byte_writes: self.byte_writes, ..GaugeOptions::default() };
        let found = match self.address.map(|address| (address, Beside::at(address))) {
            // What a Smart Battery takes for a command is sent to no device there.
            Some((ROM_ADDRESS, _)) => vec![examine_rom(adapter)?],
            Some((address, Some(one))) => {
                vec![examine_beside(adapter, one)?.unwrap_or_else(|| Found::none(address))]
            }
            Some((address, None)) => vec![examine(adapter, address, true, options.reach())?],
            None => {
                let mut found = side_by_side(vec![
                    (GAUGE_ADDRESS, examine(adapter, GAUGE_ADDRESS, false, Reach::FULL)),
                    (ROM_ADDRESS, examine_rom(adapter)),
                ])?;
                // Most buses have none of them.
                found.extend(Beside::ALL.into_iter().filter_map(|one| examine_beside(adapter, one).ok()?));
                found
            }
        };
        let mux = described(adapter.number(), &adapter.muxes());
        Ok(Report { bus: adapter.to_string(), adapter: adapter.name().unwrap_or_default(), found, mux })
    }

    fn table(&self, Report { bus, found, mux, .. }: &Report) -> String {
        let mut rows = vec![["ADDRESS", "DEVICE", "DETAILS"].map(String::from)];
        for found in found {
            let who = match found.state {
                State::Nothing => "none".to_string(),
                State::Gauge => found.chips.join(" or "),
                State::Maybe => format!("maybe {}", found.chips.join(" or ")),
                State::Rom => "maybe a gauge in ROM mode".to_string(),
                State::Pack => "Smart Battery".to_string(),
                State::Charger => "charger of a Smart Battery".to_string(),
                State::Manager => "manager of Smart Batteries".to_string(),
                State::Driver => "kernel driver".to_string(),
                State::Busy => "in use".to_string(),
                State::Other => "other device".to_string(),
                State::Silent => "no answer".to_string(),
                State::Failed => "failed".to_string(),
            };
            rows.push([format!("0x{:02x}", found.address), who, found.details.clone()]);
        }
        let mut table = align(&rows);
        table.extend(mux.iter().map(|mux| format!("{mux}\n")));
        if self.address.is_none() || found.iter().any(|found| found.state == State::Pack) {
            table += &advice(found, bus);
        }
        table
    }
}

impl Found {
    fn none(address: u8) -> Self {
        Self { address, state: State::Nothing, chips: Vec::new(), details: String::new() }
    }
}

impl Report {
    /// Whether some device is, or may be, a gauge.
    fn any(&self) -> bool {
        use State::{Charger, Failed, Manager, Nothing, Other, Silent};
        let is_none = |state| matches!(state, Other | Nothing | Silent | Failed | Charger | Manager);
        self.found.iter().any(|found| !is_none(found.state))
    }
}

/// What was found at each address. A transfer that fails at one of them hides no other, unless all fail.
fn side_by_side(looks: Vec<(u8, Result<Found>)>) -> Result<Vec<Found>> {
    let is_bus = |look: &Result<Found>| matches!(look, Err(error) if matches!(error.cause(), Cause::Bus(_)));
    if looks.iter().all(|(_, look)| is_bus(look)) {
        return looks.into_iter().map(|(_, look)| look).collect();
    }
    let found = looks.into_iter().map(|(address, look)| match look {
        Err(error) if matches!(error.cause(), Cause::Bus(_)) => {
            let details = error.reason().to_string();
            Ok(Found { address, state: State::Failed, chips: Vec::new(), details })
        }
        look => look,
    });
    found.collect()
}

/// What a failure says of an address, if it is that nothing answers there.
fn unanswered(error: &Error) -> Option<(State, String)> {
    match error.cause() {
        Cause::Bus(BusError::NoAck) => Some((State::Nothing, String::new())),
        Cause::Bus(maybe @ BusError::MaybeNoAck(_)) => Some((State::Silent, maybe.to_string())),
        _ => None,
    }
}

/// What to do next.
fn advice(found: &[Found], bus: &str) -> String {
    let at = |address, states: &[State]| {
        found.iter().any(|found| found.address == address && states.contains(&found.state))
    };
    if at(ROM_ADDRESS, &[State::Pack]) {
        format!("To read it, and nothing else: gaugefs mount --bus {bus} --chip sbs FOLDER\n")
    } else if at(GAUGE_ADDRESS, &[State::Maybe]) {
        format!("To identify it: gaugefs probe --bus {bus} --address 0x55\n")
    } else if at(GAUGE_ADDRESS, &[State::Nothing]) && at(ROM_ADDRESS, &[State::Rom]) {
        format!(
            "If it is a gauge, it answers at 0x0b only because its firmware is not whole. Switch its power off and on; if that\n\
             does not help: gaugefs rescue FILE.bq.fs --bus {bus} --chip CHIP\n\
             CHIP is {}; other parts take TI's tools.\n",
            rom::supported()
        )
    } else {
        String::new()
    }
}

/// Looks at an address. Asks for the type only if the user has named the address.
fn examine(adapter: &Adapter, address: u8, named: bool, reach: Reach) -> Result<Found> {
    let found = |state, chips, details| Ok(Found { address, state, chips, details });
    if let Some(details) = driver(adapter, address) {
        return found(State::Driver, Vec::new(), details);
    }
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let open = || {
        let bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
        Ok(Box::new(bus) as Box<dyn Bus>)
    };
    let target = Target { open: &open, clock: &clock, reach, clock_hz: adapter.clock_hz() };
    let plausible = match probe::candidates(&target) {
        Ok(plausible) => plausible,
        Err(error) => match (unanswered(&error), Errno::from_raw(error.errno())) {
            (Some((state, details)), _) => return found(state, Vec::new(), details),
            (None, Errno::EBUSY) => return found(State::Busy, Vec::new(), error.reason().to_string()),
            _ => return Err(error),
        },
    };
    let Some(first) = plausible.first() else {
        return found(State::Other, Vec::new(), stranger(address));
    };
    let reads = reads(first);
    if !named {
        let chips = plausible.iter().map(|reading| reading.chip.name).collect();
        return found(State::Maybe, chips, reads);
    }
    let who = probe::identify(&plausible, &target)?;
    let answers = who.answers;
    let versions = format!(
        "device type 0x{:04x}, firmware 0x{:04x}, hardware 0x{:04x}",
        answers.device_type, answers.firmware_version, answers.hardware_version
    );
    let chips = who.chips.iter().map(|chip| chip.name).collect::<Vec<_>>();
    match who.sibling {
        _ if !chips.is_empty() => found(State::Gauge, chips, format!("{versions}; {reads}")),
        Some(sibling) => {
            let what = match sibling.like {
                Some(like) => format!("can be mounted as {}, without data flash", like.name),
                None => "not supported".to_string(),
            };
            found(State::Other, chips, format!("{versions}: {}; {what}", sibling.name))
        }
        None => match &who.unproven[..] {
            [] => found(State::Other, chips, format!("{versions}: {}", answers.unknown())),
            unproven => {
                let names: Vec<_> = unproven.iter().map(|chip| chip.name).collect();
                let what = format!(
                    "{versions}: versions for which no table was proven; can be mounted as {}, without data \
                     flash; {reads}",
                    names.join(" or ")
                );
                found(State::Other, chips, what)
            }
        },
    }
}

/// A gauge in ROM mode answers at another address.
fn examine_rom(adapter: &Adapter) -> Result<Found> {
    let address = ROM_ADDRESS;
    let found = |state, details| Ok(Found { address, state, chips: Vec::new(), details });
    if let Some(details) = driver(adapter, address) {
        return found(State::Driver, details);
    }
    let clock = Arc::new(RealClock::new());
    let mut bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
    match rom::find(&mut bus, &*clock) {
        Ok(Some(device)) => {
            let (state, details) = at_rom(device);
            found(state, details.into())
        }
        Ok(None) => found(State::Nothing, String::new()),
        Err(error) => {
            let error = error.about(format!("{adapter} address 0x{address:02x}"));
            unanswered(&error).map_or(Err(error), |(state, details)| found(state, details))
        }
    }
}

/// A charger or a manager at its address; `None` without an answer there.
fn examine_beside(adapter: &Adapter, one: Beside) -> Result<Option<Found>> {
    let address = one.address();
    let found = |state, details| Ok(Some(Found { address, state, chips: Vec::new(), details }));
    if let Some(details) = driver(adapter, address) {
        return found(State::Driver, details);
    }
    let clock = Arc::new(RealClock::new());
    let mut bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
    if !probe::answers_in_rom(&mut bus)? {
        return Ok(None);
    }
    match (one.reads_like(&mut bus, &*clock), one) {
        (Ok(true), Beside::Charger) => found(State::Charger, String::new()),
        (Ok(true), Beside::Manager) => found(
            State::Manager,
            "with the kernel's sbs-manager each of its packs is a bus of its own".into(),
        ),
        _ => found(State::Other, stranger(address)),
    }
}

/// What is said of a device that reads like none that is known.
fn stranger(address: u8) -> String {
    let whose = match address {
        0x50..=0x57 => "an EEPROM has such an address; ",
        _ => "",
    };
    format!("{whose}its registers do not read like a gauge's; nothing was written to it")
}

/// What a device at that address is, in words.
fn at_rom(device: Device) -> (State, &'static str) {
    match device {
        Device::BootLoader => (State::Rom, "it reads like one; its firmware update was interrupted"),
        Device::SmartBattery => (State::Pack, ""),
        Device::Unclear => (State::Rom, "or a Smart Battery, which is not told apart by reading"),
    }
}

/// The kernel driver bound to an address.
fn driver(adapter: &Adapter, address: u8) -> Option<String> {
    let driver = adapter.driver(address)?;
    let place = match driver.bus == adapter.number() {
        true => String::new(),
        false => format!(" on i2c-{}, on the other side of a mux", driver.bus),
    };
    Some(format!(
        "the driver {} ({}) uses it{place}; not touched; to release it, as root: {}",
        driver.name,
        driver.device,
        driver.remedy(address)
    ))
}

/// Measurements by which a person recognises a pack.
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
    add(Role::Temp, &|kelvin| format!("{:.1} °C", (kelvin - FREEZING as f64) / 10.0));
    parts.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gauge_in_rom_mode_is_followed_by_the_way_out() {
        let at = |address, state| Found { address, state, chips: Vec::new(), details: String::new() };
        let advice = |gauge, rom| advice(&[at(GAUGE_ADDRESS, gauge), at(ROM_ADDRESS, rom)], "/dev/i2c-1");
        assert!(
            advice(State::Nothing, State::Rom).contains("gaugefs rescue FILE.bq.fs --bus /dev/i2c-1 --chip")
        );
        assert!(advice(State::Maybe, State::Rom).contains("probe"), "a smart battery beside a gauge");
        assert_eq!(advice(State::Driver, State::Rom), "");
        assert_eq!(advice(State::Nothing, State::Nothing), "");
        assert_eq!(advice(State::Silent, State::Rom), "", "a gauge may be there");
        let pack = advice(State::Nothing, at_rom(Device::SmartBattery).0);
        assert!(pack.contains("mount --bus /dev/i2c-1 --chip sbs"), "{pack}");
        assert!(!advice(State::Nothing, at_rom(Device::Unclear).0).is_empty());
    }

    #[test]
    fn an_eeprom_is_named_by_its_address() {
        assert!(stranger(0x50).starts_with("an EEPROM") && stranger(0x57).starts_with("an EEPROM"));
        assert!(stranger(0x4f).starts_with("its registers") && stranger(0x58).starts_with("its registers"));
    }

    /// A CP2112 reports a missing acknowledge as it does a bus that is held low.
    #[test]
    fn a_failure_at_one_address_hides_no_other() {
        let rom = || (ROM_ADDRESS, Err(Error::from(BusError::Timeout)));
        let gauge =
            |state| Found { address: GAUGE_ADDRESS, state, chips: Vec::new(), details: String::new() };
        let found = side_by_side(vec![(GAUGE_ADDRESS, Ok(gauge(State::Maybe))), rom()]).expect("a gauge");
        assert!(found[0].state == State::Maybe && found[1].state == State::Failed);
        assert!(found[1].details.contains("timed out"), "{}", found[1].details);
        let report = |found| Report { bus: String::new(), adapter: String::new(), found, mux: None };
        assert!(report(found).any() && !report(vec![gauge(State::Silent)]).any());
        // A bus on which nothing works is a failure.
        assert!(side_by_side(vec![rom(), rom()]).is_err());
        let silent = |bus: BusError| unanswered(&Error::from(bus));
        assert!(silent(BusError::NoAck).is_some_and(|(state, _)| state == State::Nothing));
        let (state, details) = silent(BusError::MaybeNoAck(110)).expect("it may be absent");
        assert!(state == State::Silent && details.contains("or the bus timed out"), "{details}");
        assert!(silent(BusError::Timeout).is_none());
    }
}
